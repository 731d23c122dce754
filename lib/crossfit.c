/* SPDX-License-Identifier: BSD-3-Clause */
#include "crossfit.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "blur.h"
#include "nlr.h"

#define PILOT_FEATURES	7	/* albedo, normal, depth: more cost time and did not lower the error */
#define RIDGE		1e-4
#define FLAT		1e-5
#define DARK		0.1	/* of the image's level: below it errors count as they are, not relatively */
#define DISAGREE	2.0	/* squared error per variance of the models about their mean */
#define DISAGREE_SELF	6.0	/* the same where no halves tell what noise does */
#define GAIN_LIMIT	1.25	/* a mean that is further off is ruled by fireflies, not by misfit */

/* A regression: windows of 2R+1, centres step apart, a polynomial of that order. */
struct model {
	bool feature, pilot;
	int radius, step, order;
};

/* A pilot of either half, and the models that lean on it. Unlike pilots err differently: the mean gains. */
struct stage {
	struct gd_nlr_conf pilot;
	int n;
	struct model model[4];
};

#define NARROW	{ .window = 3, .patch = 1, .k = 0.8, .eps = 1e-6, .ridge = 1e-3 }
#define WIDE	{ .window = 6, .patch = 2, .k = 0.5, .eps = 1e-6, .ridge = 1e-3 }

static const struct stage with_feature[] = {
	{ NARROW, 2, { { true, false, 10, 5, 1 }, { true, true, 10, 5, 1 } } },
	{ WIDE, 2, { { true, true, 21, 8, 2 }, { true, false, 21, 8, 2 } } },
};
static const struct stage without_feature[] = {
	{ NARROW, 2, { { false, true, 10, 5, 1 }, { false, true, 21, 8, 2 } } },
	{ WIDE, 2, { { false, true, 7, 3, 0 }, { false, true, 21, 8, 2 } } },
};
#define STAGES 2

/* Work space; planes that were not made have v = NULL. */
struct work {
	struct gd_plane pilot[2][3], sum[GD_APR_RHS], fit[GD_APR_RHS], weight;
};

static int new_plane(struct gd_plane *p, struct gd_plane like, struct gd_err *err)
{
	*p = gd_plane_of(gd_alloc(gd_stride(like.w) * (size_t)like.h, sizeof(float)), like.w, like.h);
	return p->v ? GD_OK : gd_fail(err, GD_ENOMEM, "out of memory");
}

static int new_planes(struct gd_plane *p, int n, struct gd_plane like, struct gd_err *err)
{
	int rc = GD_OK;

	for (int i = 0; i < n && rc == GD_OK; i++)
		rc = new_plane(p + i, like, err);
	return rc;
}

static void free_planes(struct gd_plane *p, int n)
{
	for (int i = 0; i < n; i++) {
		free(p[i].v);
		p[i].v = NULL;
	}
}

static float to_float(double v)
{
	return v > (double)FLT_MAX ? FLT_MAX : v < -(double)FLT_MAX ? -FLT_MAX : (float)v;
}

/* Independent parts of the samples, and the one that explains a part. */
static int halves(const struct gd_crossfit_in *in)
{
	return in->self ? 1 : 2;
}

static int other(const struct gd_crossfit_in *in, int half)
{
	return in->self ? 0 : 1 - half;
}

/* ---- the pilots ---- */

static int compare(const void *a, const void *b)
{
	float x = *(const float *)a, y = *(const float *)b;

	return (x > y) - (x < y);
}

#define SAMPLES 128	/* per axis, for percentiles */

/* The k-th of n places spread evenly over size pixels. */
static int place(int k, int n, int size)
{
	return (int)((2 * (long)k + 1) * size / (2 * n));
}

/* Values of p at up to SAMPLES^2 places spread evenly, sorted. Returns how many. */
static int sample(float *v, struct gd_plane p)
{
	int nx = p.w < SAMPLES ? p.w : SAMPLES, ny = p.h < SAMPLES ? p.h : SAMPLES, n = 0;

	for (int j = 0; j < ny; j++)
		for (int i = 0; i < nx; i++)
			v[n++] = gd_row(p, place(j, ny, p.h))[place(i, nx, p.w)];
	qsort(v, (size_t)n, sizeof *v, compare);
	return n;
}

/* Median and range (percentiles 0.5 to 99.5) of a feature; range 0 if it hardly varies. */
static void feature_range(struct gd_plane p, float *v, double *median, double *range)
{
	int n = sample(v, p);
	double lo = (double)v[n / 200], hi = (double)v[n - 1 - n / 200];

	*median = (double)v[n / 2];
	*range = hi - lo > 1e-6 * fmax(fabs(lo), fabs(hi)) ? hi - lo : 0;
}

static void scale_plane(struct gd_plane p, double minus, double times, double plus)
{
#pragma omp parallel for schedule(static)
	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++)
			gd_row(p, y)[x] = to_float(((double)gd_row(p, y)[x] - minus) * times + plus);
}

/* p = mean over side x side windows */
static int smooth(struct gd_plane *p, int n, struct gd_plane spare, int side, struct gd_err *err)
{
	struct gd_blur box = gd_blur_box(side);
	int rc = GD_OK;

	for (int c = 0; c < n && rc == GD_OK; c++)
		rc = gd_blur_plane(p[c], spare, &box, err);
	return rc;
}

/* The variance of a half's colour, as the distances of patches want it: smooth. */
static int pilot_variance(struct gd_plane var[3], struct gd_plane spare, const struct gd_crossfit_in *in,
			  struct gd_err *err)
{
	for (int c = 0; c < 3; c++) {
#pragma omp parallel for schedule(static)
		for (int y = 0; y < var[c].h; y++) {
			const float *a = gd_row(in->var[c].v ? in->var[c] : in->y[0][c], y);
			const float *b = gd_row(in->var[c].v ? in->var[c] : in->y[1][c], y);

			for (int x = 0; x < var[c].w; x++) {
				double d = (double)a[x] - (double)b[x];

				gd_row(var[c], y)[x] = to_float(in->var[c].v ? 2 * (double)a[x] : d * d / 2);
			}
		}
	}
	return smooth(var, 3, spare, in->var[0].v ? 3 : 7, err);
}

static int make_pilots(struct work *w, struct gd_crossfit_in *in, const struct gd_nlr_conf *conf,
		       const struct gd_report *report, struct gd_err *err)
{
	struct gd_plane var[3] = { 0 };
	double median[PILOT_FEATURES], range[PILOT_FEATURES];
	int index[PILOT_FEATURES], rc, n = 0;
	float *v = gd_alloc((size_t)SAMPLES * SAMPLES, sizeof *v);

	rc = v ? new_planes(var, 3, in->y[0][0], err) : gd_fail(err, GD_ENOMEM, "out of memory");
	if (rc == GD_OK)
		rc = pilot_variance(var, w->pilot[0][0], in, err);
	for (int a = 0; a < in->nfeat && n < PILOT_FEATURES && rc == GD_OK; a++) {
		feature_range(in->feat[a], v, &median[n], &range[n]);
		if (range[n] > 0) {
			scale_plane(in->feat[a], median[n], 1 / range[n], 0);
			index[n++] = a;
		}
	}
	for (int half = 0; half < halves(in) && rc == GD_OK; half++) {
		struct gd_nlr_in nlr = { .nfeat = n };

		for (int c = 0; c < 3; c++) {
			nlr.y[c] = nlr.guide[c] = in->y[half][c];
			nlr.guide_var[c] = var[c];
		}
		for (int i = 0; i < n; i++)
			nlr.feat[i] = in->feat[index[i]];
		rc = gd_nlr_run(w->pilot[half], &nlr, conf, report, err);
	}
	for (int i = 0; i < n; i++)
		scale_plane(in->feat[index[i]], 0, range[i], median[i]);
	free_planes(var, 3);
	free(v);
	return rc;
}

/* ---- the regressions ---- */

/* Luminance of an image that may be negative in places. */
static double luminance(const struct gd_plane *rgb, int x, int y)
{
	double l = 0;

	for (int c = 0; c < 3; c++)
		l += fmax((double)gd_row(rgb[c], y)[x], 0) / 3;
	return l;
}

/* The mean luminance, values beyond the 99th percentile cut to it: a firefly does not move it. */
static double level_of(const struct gd_plane *rgb, float *v)
{
	struct gd_plane p = rgb[0];
	int nx = p.w < SAMPLES ? p.w : SAMPLES, ny = p.h < SAMPLES ? p.h : SAMPLES, n = 0;
	double sum = 0;

	for (int j = 0; j < ny; j++)
		for (int i = 0; i < nx; i++)
			v[n++] = to_float(luminance(rgb, place(i, nx, p.w), place(j, ny, p.h)));
	qsort(v, (size_t)n, sizeof *v, compare);
	for (int i = 0; i < n; i++)
		sum += (double)v[i < n - 1 - n / 100 ? i : n - 1 - n / 100];
	return sum / n;
}

/* What a pixel counts: about 1 where dark, 1 / luminance^2 where bright. */
static int make_weight(struct gd_plane weight, const struct gd_plane *pilot, struct gd_err *err)
{
	float *v = gd_alloc((size_t)SAMPLES * SAMPLES, sizeof *v);
	double dark;

	if (!v)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	dark = fmax(DARK * level_of(pilot, v), (double)FLT_MIN);
	free(v);
#pragma omp parallel for schedule(static)
	for (int y = 0; y < weight.h; y++)
		for (int x = 0; x < weight.w; x++) {
			double l = luminance(pilot, x, y) / dark;

			gd_row(weight, y)[x] = (float)(1 / (1 + fmin(l * l, 1e30)));
		}
	return GD_OK;
}

/* Takes the k-th fit (from 1) into the mean of the fits, and into the sum of their squared distances to it. */
static void add_fit(const struct gd_plane *mean, const struct gd_plane *square, const struct gd_plane *fit, int n, int k)
{
	for (int c = 0; c < n; c++) {
#pragma omp parallel for schedule(static)
		for (int y = 0; y < mean[c].h; y++) {
			float *restrict m = gd_row(mean[c], y), *restrict s = c < 3 ? gd_row(square[c], y) : NULL;
			const float *restrict f = gd_row(fit[c], y);

			for (int x = 0; x < mean[c].w; x++) {
				double was = (double)m[x], is = was + ((double)f[x] - was) / k;

				m[x] = to_float(is);
				if (s)
					s[x] = to_float((double)s[x] + ((double)f[x] - was) * ((double)f[x] - is));
			}
		}
	}
}

/* Planes to estimate. */
static int planes(const struct gd_crossfit_in *in)
{
	return in->nwhole ? in->nwhole : in->ny;
}

static int fit_model(struct work *w, const struct gd_crossfit_in *in, int half, const struct model *m,
		     const struct gd_report *report, struct gd_err *err)
{
	struct gd_apr_conf conf = GD_APR_DEFAULTS;
	struct gd_plane feat[GD_APR_FEATURES];
	struct gd_apr_in apr = { .ny = planes(in), .y = in->nwhole ? in->whole : in->y[half], .feat = feat,
				 .weight = w->weight };
	struct gd_apr_out out = { .est = w->fit };

	for (int a = 0; a < in->nfeat && apr.nfeat < GD_APR_FEATURES - 7; a++)
		feat[apr.nfeat++] = in->feat[a];
	for (int c = 0; c < 3 && m->pilot; c++)
		feat[apr.nfeat++] = w->pilot[other(in, half)][c];
	for (int c = 0; c < in->nfeature && m->feature; c++)
		feat[apr.nfeat++] = in->feature[other(in, half)][c];
	conf.ridge = RIDGE;
	conf.flat = FLAT;
	conf.radius = m->radius;
	conf.step = m->step;
	conf.order_min = conf.order_max = m->order;
	return gd_apr_fit(&out, &apr, &conf, report, err);
}

static void clear(const struct gd_plane *p, int n)
{
	for (int c = 0; c < n; c++)
		for (int y = 0; y < p[c].h; y++)
			memset(gd_row(p[c], y), 0, (size_t)p[c].w * sizeof(float));
}

/* Adds the models of a stage to the mean of a half, which has `done` already; square as add_fit() has it. */
static int fit_half(const struct gd_plane *mean, const struct gd_plane *square, struct work *w,
		    const struct gd_crossfit_in *in, int half, const struct model *model, int n, int done,
		    const struct gd_report *report, struct gd_err *err)
{
	int rc = make_weight(w->weight, w->pilot[other(in, half)], err);

	for (int i = 0; i < n && rc == GD_OK; i++) {
		rc = fit_model(w, in, half, &model[i], done + i + half == 0 ? report : NULL, err);
		if (rc == GD_OK)
			add_fit(mean, square, w->fit, planes(in), done + i + 1);
	}
	return rc;
}

/* ---- putting the halves together ---- */

/* Sum of the colour of an image, and whether nothing in it is negative. */
static double total(const struct gd_plane *rgb, bool *negative)
{
	double sum = 0;

	for (int c = 0; c < 3; c++)
		for (int y = 0; y < rgb[c].h; y++) {
			double row = 0;

			for (int x = 0; x < rgb[c].w; x++) {
				row += (double)gd_row(rgb[c], y)[x];
				*negative = *negative || gd_row(rgb[c], y)[x] < 0;
			}
			sum += row;
		}
	return sum;
}

/*
 * est and mse from the fits of the halves: est holds the first, second the
 * second (or est again: self), and mse the squared
 * distances of the models' fits to their mean. The error of the mean is what the halves' noise makes of it,
 * and its bias; of the bias, how far the models disagree is a measure (factor: as measured).
 */
static int join(const struct gd_crossfit_out *out, const struct gd_plane *second, int n, bool self, int models,
		bool negative, struct gd_plane spare, struct gd_err *err)
{
	double disagree = models < 2 ? 0 : self ? DISAGREE_SELF / (models - 1) : DISAGREE / (2.0 * (models - 1));


	for (int c = 0; c < n; c++) {
#pragma omp parallel for schedule(static)
		for (int y = 0; y < second[c].h; y++) {
			const float *b = gd_row(second[c], y);
			float *a = gd_row(out->est[c], y);

			for (int x = 0; x < second[c].w; x++) {
				double e = ((double)a[x] + (double)b[x]) / 2, d = ((double)a[x] - (double)b[x]) / 2;

				a[x] = e < 0 && !negative ? 0 : to_float(e);
				if (c < 3)
					gd_row(out->mse[c], y)[x] =
						to_float(d * d + disagree * (double)gd_row(out->mse[c], y)[x]);
			}
		}
	}
	return smooth(out->mse, 3, spare, 5, err);
}

/*
 * Gives back what the fits took from the mean of the image, or added: each pixel times 1 + a l / (l + level).
 * Bright pixels take it: they are where a relative fit is free to be off, and where it shows least.
 * Returns the factor of the brightest pixels, 1 if the mean is so far off that fireflies rule it.
 */
static double keep_mean(const struct gd_plane *est, int n, double sum, struct gd_err *err)
{
	struct gd_plane like = est[0];
	float *v = gd_alloc((size_t)SAMPLES * SAMPLES, sizeof *v);
	double level, have = 0, bright = 0, a;

	if (!v)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	level = fmax(level_of(est, v), (double)FLT_MIN);
	free(v);
	for (int y = 0; y < like.h; y++) {
		double row = 0, row_bright = 0;

		for (int x = 0; x < like.w; x++) {
			double l = luminance(est, x, y), e = 0;

			for (int c = 0; c < 3; c++)
				e += (double)gd_row(est[c], y)[x];
			row += e;
			row_bright += e * (l / (l + level));
		}
		have += row;
		bright += row_bright;
	}
	a = (sum - have) / bright;
	if (!(a > 1 / GAIN_LIMIT - 1 && a < GAIN_LIMIT - 1))
		return 1;
#pragma omp parallel for schedule(static)
	for (int y = 0; y < like.h; y++)
		for (int x = 0; x < like.w; x++) {
			double l = luminance(est, x, y), gain = 1 + a * (l / (l + level));

			for (int c = 0; c < n; c++)
				gd_row(est[c], y)[x] = to_float(gain * (double)gd_row(est[c], y)[x]);
		}
	return 1 + a;
}

static int run_stages(const struct gd_crossfit_out *out, struct work *w, struct gd_crossfit_in *in,
		      const struct gd_crossfit_conf *conf, struct gd_crossfit_result *result,
		      const struct gd_report *report, struct gd_err *err)
{
	const struct stage *stage = in->nfeature ? with_feature : without_feature;
	int rc = GD_OK, stages = conf->fast ? 1 : STAGES;

	for (int i = 0; i < stages && rc == GD_OK; i++) {
		int n = conf->fast ? 1 : stage[i].n;
		double start = gd_seconds();

		gd_progress(report, "pilot", (double)i / stages);
		rc = make_pilots(w, in, &stage[i].pilot, report, err);
		result->pilot_seconds += gd_seconds() - start;
		start = gd_seconds();
		gd_progress(report, "fitting", (i + 0.5) / stages);
		for (int half = 0; half < halves(in) && rc == GD_OK; half++)
			rc = fit_half(half ? w->sum : out->est, out->mse, w, in, half, stage[i].model, n,
				      result->models, report, err);
		result->fit_seconds += gd_seconds() - start;
		result->models += n;
	}
	gd_progress(report, "fitting", 1);
	return rc;
}

int gd_crossfit_run(const struct gd_crossfit_out *out, struct gd_crossfit_in *in, const struct gd_crossfit_conf *conf,
		    struct gd_crossfit_result *result, const struct gd_report *report, struct gd_err *err)
{
	struct gd_plane like = in->y[0][0];
	struct work w = { 0 };
	bool negative = false;
	double sum;
	int rc;

	*result = (struct gd_crossfit_result){ 0 };
	sum = total(in->y[0], &negative);
	if (!in->self)
		sum = (sum + total(in->y[1], &negative)) / 2;
	negative = negative || planes(in) > 3;
	rc = new_plane(&w.weight, like, err);
	for (int half = 0; half < halves(in) && rc == GD_OK; half++)
		rc = new_planes(w.pilot[half], 3, like, err);
	if (rc == GD_OK && !in->self)
		rc = new_planes(w.sum, planes(in), like, err);
	if (rc == GD_OK)
		rc = new_planes(w.fit, planes(in), like, err);
	if (rc == GD_OK) {
		clear(out->est, planes(in));
		clear(w.sum, in->self ? 0 : planes(in));
		clear(out->mse, 3);
		rc = run_stages(out, &w, in, conf, result, report, err);
	}
	if (rc == GD_OK)
		rc = join(out, in->self ? out->est : w.sum, planes(in), in->self, result->models, negative, w.weight,
			  err);
	if (rc == GD_OK)
		result->gain = keep_mean(out->est, planes(in), sum, err);
	free_planes(w.pilot[0], 3);
	free_planes(w.pilot[1], 3);
	free_planes(&w.weight, 1);
	free_planes(w.sum, GD_APR_RHS);
	free_planes(w.fit, GD_APR_RHS);
	return rc;
}
