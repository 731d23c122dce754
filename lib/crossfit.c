/* SPDX-License-Identifier: BSD-3-Clause */
#include "crossfit.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "blur.h"
#include "nlr.h"

#define PILOT_FEATURES	7	/* albedo, normal, depth: more cost time and did not lower the error */
#define RIDGE		1e-4	/* of a column's spread: 1e-3 is as good, 1e-2 worse by 1 %, none by 6 % */
#define FLAT		1e-5	/* of a feature's squared range, 0.3 % of the range: below is noise, not
				 * shape; 1e-4 loses 5 % (texture), none 5 % (door: up to 22 %) */
#define DARK		0.1	/* of the image's level: below it errors count as they are */
#define DISAGREE	2.0	/* squared error per variance of the models about their mean */
#define DISAGREE_SELF	6.0	/* the same where no halves tell what noise does */
#define GAIN_LIMIT	1.25	/* a mean further off is ruled by fireflies, not by misfit */
#define FIREFLY		1000.0	/* times as bright as it should be */
#define SQUARE_LIMIT	1e38	/* squares are cut here: sums of them stay floats */

/* A regression: windows of 2R+1, centres step apart, a polynomial of that order. */
struct model {
	bool feature, pilot;
	int radius, step, order;
};

/* A pilot, and the models that lean on it. Unlike pilots err differently: the mean gains. */
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

/*
 * Work space. The pilot is of the half that is not being fitted; fit holds its variances while it
 * is made, weight is the blurs' spare plane then.
 */
struct work {
	struct gd_plane pilot[3], sum[GD_APR_RHS], fit[GD_APR_RHS], weight;
	int nscaled, scaled[PILOT_FEATURES];	/* features of in that a pilot may lean on */
};

static int new_plane(struct gd_plane *p, struct gd_plane like, struct gd_err *err)
{
	size_t size = gd_stride(like.w) * (size_t)like.h;

	*p = gd_plane_of(gd_alloc(size, sizeof(float)), like.w, like.h);
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

static int explains(const struct gd_crossfit_in *in, int half)
{
	return in->self ? 0 : 1 - half;
}

static float square_to_float(double v)
{
	return v > SQUARE_LIMIT ? (float)SQUARE_LIMIT : (float)v;
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

static void scale_plane(struct gd_plane p, double minus, double times)
{
#pragma omp parallel for schedule(static)
	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++)
			gd_row(p, y)[x] = to_float(((double)gd_row(p, y)[x] - minus) * times);
}

/* Brings the features that pilots use to median 0 and range 1, which changes no other fit. */
static int scale_features(struct work *w, const struct gd_crossfit_in *in, struct gd_err *err)
{
	float *v = gd_alloc((size_t)SAMPLES * SAMPLES, sizeof *v);

	if (!v)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	for (int a = 0; a < in->nfeat && w->nscaled < PILOT_FEATURES; a++) {
		double median, range;

		feature_range(in->feat[a], v, &median, &range);
		if (range > 0) {
			scale_plane(in->feat[a], median, 1 / range);
			w->scaled[w->nscaled++] = a;
		}
	}
	free(v);
	return GD_OK;
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
static int pilot_variance(struct gd_plane var[3], struct gd_plane spare,
			  const struct gd_crossfit_in *in, int half, struct gd_err *err)
{
	double more = 1 / in->share[half], of_square = in->share[1 - half];

	for (int c = 0; c < 3; c++) {
#pragma omp parallel for schedule(static)
		for (int y = 0; y < var[c].h; y++) {
			const float *known = in->var[c].v ? gd_row(in->var[c], y) : NULL;
			const float *a = gd_row(in->y[0][c], y);
			const float *b = known ? a : gd_row(in->y[1][c], y);
			float *to = gd_row(var[c], y);

			for (int x = 0; x < var[c].w; x++) {
				double d = (double)a[x] - (double)b[x];

				to[x] = square_to_float(known ? more * (double)known[x] :
							of_square * d * d);
			}
		}
	}
	return smooth(var, 3, spare, in->var[0].v ? 3 : 7, err);
}

static int make_pilot(struct work *w, const struct gd_crossfit_in *in, int half,
		      const struct gd_nlr_conf *conf, const struct gd_report *report,
		      struct gd_err *err)
{
	struct gd_nlr_in nlr = { .nfeat = w->nscaled };
	int rc = pilot_variance(w->fit, w->weight, in, half, err);

	for (int c = 0; c < 3; c++) {
		nlr.y[c] = nlr.guide[c] = in->y[half][c];
		nlr.guide_var[c] = w->fit[c];
	}
	for (int i = 0; i < w->nscaled; i++)
		nlr.feat[i] = in->feat[w->scaled[i]];
	return rc == GD_OK ? gd_nlr_run(w->pilot, &nlr, conf, report, err) : rc;
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

/* Luminance of p's brightest pixel of the 3x3 around x, y; of those around it only, if apart. */
static double brightest_near(const struct gd_plane *p, int x, int y, bool apart)
{
	double most = 0;

	for (int j = y > 0 ? y - 1 : 0; j <= y + 1 && j < p->h; j++)
		for (int i = x > 0 ? x - 1 : 0; i <= x + 1 && i < p->w; i++)
			if (!apart || i != x || j != y)
				most = fmax(most, luminance(p, i, j));
	return most;
}

static void times_pixel(const struct gd_plane *p, int n, int x, int y, double times)
{
	for (int c = 0; c < n; c++)
		gd_row(p[c], y)[x] = to_float(times * (double)gd_row(p[c], y)[x]);
}

/* Cuts pixel x, y of one half, by all its planes alike; the image of all samples loses its share. */
static void cut_firefly(struct gd_crossfit_in *in, int half, int x, int y, double limit)
{
	double here = luminance(in->y[half], x, y), share = in->share[half];
	double other = in->nwhole ? luminance(in->y[1 - half], x, y) : 0;
	double times = limit / here, rest = (1 - share) * other;

	times_pixel(in->y[half], in->ny, x, y, times);
	times_pixel(in->whole, in->nwhole, x, y,
		    (share * limit + rest) / (share * here + rest));
}

/*
 * Fireflies that would blind whole windows: pixels of a half a thousand times brighter than the
 * image and than what the other half (without: the neighbours) has there.
 */
static int cut_fireflies(struct gd_crossfit_in *in, struct gd_err *err)
{
	float *v = gd_alloc((size_t)SAMPLES * SAMPLES, sizeof *v);
	double level = 0;

	if (!v)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	for (int half = 0; half < halves(in); half++)
		level += level_of(in->y[half], v) / halves(in);
	free(v);
	for (int half = 0; half < halves(in) && level > 0; half++) {
		const struct gd_plane *p = in->y[half], *other = in->y[explains(in, half)];

		/* without halves neighbours are read that may just be cut: in order then */
#pragma omp parallel for schedule(static) if (!in->self)
		for (int y = 0; y < p->h; y++)
			for (int x = 0; x < p->w; x++) {
				double here = luminance(p, x, y), limit = FIREFLY * level;

				if (here > limit)
					limit = FIREFLY *
						(level + brightest_near(other, x, y, in->self));
				if (here > limit)
					cut_firefly(in, half, x, y, limit);
			}
	}
	return GD_OK;
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

/*
 * Takes the k-th fit (from 1) into the mean of the fits, and into the sum of their squared
 * distances to it.
 */
static void add_fit(const struct gd_plane *mean, const struct gd_plane *square,
		    const struct gd_plane *fit, int n, int k)
{
	for (int c = 0; c < n; c++) {
#pragma omp parallel for schedule(static)
		for (int y = 0; y < mean[c].h; y++) {
			float *restrict m = gd_row(mean[c], y);
			float *restrict s = c < 3 ? gd_row(square[c], y) : NULL;
			const float *restrict f = gd_row(fit[c], y);

			for (int x = 0; x < mean[c].w; x++) {
				double off = (double)f[x] - (double)m[x];

				m[x] = to_float((double)m[x] + off / k);
				if (s)
					s[x] = square_to_float((double)s[x] +
							       off * (off - off / k));
			}
		}
	}
}

/* Planes to estimate. */
static int planes(const struct gd_crossfit_in *in)
{
	return in->nwhole ? in->nwhole : in->ny;
}

static int fit_model(struct work *w, const struct gd_crossfit_in *in, int half,
		     const struct model *m, const struct gd_report *report, struct gd_err *err)
{
	struct gd_apr_conf conf = GD_APR_DEFAULTS;
	struct gd_plane feat[GD_APR_FEATURES];
	struct gd_apr_in apr = { .ny = planes(in), .y = in->nwhole ? in->whole : in->y[half],
				 .feat = feat, .weight = w->weight };
	struct gd_apr_out out = { .est = w->fit };

	for (int a = 0; a < in->nfeat; a++)
		feat[apr.nfeat++] = in->feat[a];
	for (int c = 0; c < 3 && m->pilot; c++)
		feat[apr.nfeat++] = w->pilot[c];
	for (int c = 0; c < in->nfeature && m->feature; c++)
		feat[apr.nfeat++] = in->feature[explains(in, half)][c];
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

/* Where a half's models go: mean and square as add_fit() has them; done: models in them already. */
struct half {
	const struct gd_plane *mean, *square;
	int half, done;
};

static int fit_half(const struct half *to, struct work *w, const struct gd_crossfit_in *in,
		    const struct model *model, int n, const struct gd_report *report,
		    struct gd_err *err)
{
	int rc = make_weight(w->weight, w->pilot, err);

	for (int i = 0; i < n && rc == GD_OK; i++) {
		bool first = to->done + i + to->half == 0;	/* says once what holds for all */

		rc = fit_model(w, in, to->half, &model[i], first ? report : NULL, err);
		if (rc == GD_OK)
			add_fit(to->mean, to->square, w->fit, planes(in), to->done + i + 1);
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

/* The models' standard deviation; square: their squared distances to the mean, n the divisor. */
static void make_spread(struct gd_plane spread, const struct gd_plane *square, int n)
{
#pragma omp parallel for schedule(static)
	for (int y = 0; y < spread.h; y++)
		for (int x = 0; x < spread.w; x++) {
			double sum = 0;

			for (int c = 0; c < 3; c++)
				sum += (double)gd_row(square[c], y)[x];
			gd_row(spread, y)[x] = n > 0 ? to_float(sqrt(sum / (3.0 * n))) : 0;
		}
}

/*
 * est and mse from the fits of the halves: est holds the first, other the second, and mse the
 * squared distances of the models' fits to their mean. The error of the mean is what the halves'
 * noise makes of it, and its bias; of the bias, how far the models disagree is a measure: disagree
 * times those distances (factor: as measured). clip: nothing below 0.
 */
static int join(const struct gd_crossfit_out *out, const struct gd_plane *other, int n,
		const double share[2], double disagree, bool clip, struct gd_plane spare,
		struct gd_err *err)
{
	for (int c = 0; c < n; c++) {
#pragma omp parallel for schedule(static)
		for (int y = 0; y < other[c].h; y++) {
			const float *b = gd_row(other[c], y);	/* a again, where there are no halves */
			float *a = gd_row(out->est[c], y);
			float *m = c < 3 ? gd_row(out->mse[c], y) : NULL;

			for (int x = 0; x < other[c].w; x++) {
				double d = (double)a[x] - (double)b[x];
				double e = share[0] * (double)a[x] + share[1] * (double)b[x];

				a[x] = clip && e < 0 ? 0 : to_float(e);
				if (m)
					m[x] = square_to_float(share[0] * share[1] * d * d +
							       disagree * (double)m[x]);
			}
		}
	}
	return smooth(out->mse, 3, spare, 5, err);
}

/*
 * Gives back what the fits took from the mean of the image, or added: each pixel times
 * 1 + a l / (l + level). Bright pixels take it: they are where a relative fit is free to be off,
 * and where it shows least. *gain: the factor of the brightest pixels, 1 if the mean is so far off
 * that fireflies rule it.
 */
static int keep_mean(const struct gd_plane *est, int n, double sum, double *gain,
		     struct gd_err *err)
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
		return GD_OK;
	*gain = 1 + a;
#pragma omp parallel for schedule(static)
	for (int y = 0; y < like.h; y++)
		for (int x = 0; x < like.w; x++) {
			double l = luminance(est, x, y), times = 1 + a * (l / (l + level));

			for (int c = 0; c < n; c++)
				gd_row(est[c], y)[x] =
					to_float(times * (double)gd_row(est[c], y)[x]);
		}
	return GD_OK;
}

static int run_stage(const struct gd_crossfit_out *out, struct work *w,
		     const struct gd_crossfit_in *in, const struct stage *stage, int n,
		     struct gd_crossfit_result *result, const struct gd_report *report,
		     struct gd_err *err)
{
	int rc = GD_OK;

	for (int half = 0; half < halves(in) && rc == GD_OK; half++) {
		struct half to = { half ? w->sum : out->est, out->mse, half, result->models };
		double start = gd_seconds(), pilot;

		rc = make_pilot(w, in, explains(in, half), &stage->pilot, NULL, err);
		pilot = gd_seconds();
		if (rc == GD_OK)
			rc = fit_half(&to, w, in, stage->model, n, report, err);
		result->pilot_seconds += pilot - start;
		result->fit_seconds += gd_seconds() - pilot;
	}
	result->models += n;
	return rc;
}

static int run_stages(const struct gd_crossfit_out *out, struct work *w,
		      const struct gd_crossfit_in *in, const struct gd_crossfit_conf *conf,
		      struct gd_crossfit_result *result, const struct gd_report *report,
		      struct gd_err *err)
{
	const struct stage *stage = in->nfeature ? with_feature : without_feature;
	int rc = scale_features(w, in, err), stages = conf->fast ? 1 : STAGES;

	for (int i = 0; i < stages && rc == GD_OK; i++) {
		gd_progress(report, "fitting", (double)i / stages);
		rc = run_stage(out, w, in, stage + i, conf->fast ? 1 : stage[i].n, result, report,
			       err);
	}
	gd_progress(report, "fitting", 1);
	return rc;
}

static int check(struct gd_crossfit_in *in, struct gd_err *err)
{
	if (in->ny < 3 || in->ny > GD_APR_RHS || in->nwhole < 0 || in->nwhole > GD_APR_RHS ||
	    (in->nwhole > 0 && in->nwhole < 3))
		return gd_fail(err, GD_EARG, "%d planes of either half and %d of all samples, "
			       "expected 3 to %d", in->ny, in->nwhole, GD_APR_RHS);
	if (in->nfeat < 0 || in->nfeat > GD_CROSSFIT_FEATURES || in->nfeature < 0 ||
	    in->nfeature > 4)
		return gd_fail(err, GD_EARG, "%d feature planes and %d of either half, at most %d "
			       "and 4", in->nfeat, in->nfeature, GD_CROSSFIT_FEATURES);
	if (in->self && (!in->var[0].v || in->nwhole))
		return gd_fail(err, GD_EARG, "no halves: the variance of the colour is needed");
	if (in->share[0] == 0 && in->share[1] == 0)
		in->share[0] = in->share[1] = 0.5;
	if (!(in->share[0] > 0 && in->share[1] > 0 &&
	      fabs(in->share[0] + in->share[1] - 1) < 1e-6))
		return gd_fail(err, GD_EARG, "halves hold %g and %g of the samples, expected shares "
			       "of 1", in->share[0], in->share[1]);
	return GD_OK;
}

/* What is made of the models of all halves. */
static int finish(const struct gd_crossfit_out *out, struct work *w,
		  const struct gd_crossfit_in *in, struct gd_crossfit_result *result,
		  struct gd_err *err)
{
	const struct gd_plane *other = in->self ? out->est : w->sum;
	int n = planes(in), degrees = halves(in) * (result->models - 1), rc;
	double disagree = degrees ? (in->self ? DISAGREE_SELF : DISAGREE) / degrees : 0, sum = 0;
	bool negative = false;

	for (int half = 0; half < halves(in); half++)
		sum += (in->self ? 1 : in->share[half]) * total(in->y[half], &negative);
	if (out->spread.v)
		make_spread(out->spread, out->mse, degrees);
	rc = join(out, other, n, in->share, disagree, !negative && n == 3, w->weight, err);
	return rc == GD_OK ? keep_mean(out->est, n, sum, &result->gain, err) : rc;
}

static int new_work(struct work *w, const struct gd_crossfit_in *in, struct gd_err *err)
{
	struct gd_plane like = in->y[0][0];
	int n = planes(in);
	int rc = new_plane(&w->weight, like, err);

	if (rc == GD_OK)
		rc = new_planes(w->pilot, 3, like, err);
	if (rc == GD_OK && !in->self)
		rc = new_planes(w->sum, n, like, err);
	if (rc == GD_OK)
		rc = new_planes(w->fit, n, like, err);
	return rc;
}

int gd_crossfit_run(const struct gd_crossfit_out *out, struct gd_crossfit_in *in,
		    const struct gd_crossfit_conf *conf, struct gd_crossfit_result *result,
		    const struct gd_report *report, struct gd_err *err)
{
	struct work w = { 0 };
	int rc = check(in, err);

	*result = (struct gd_crossfit_result){ .gain = 1 };
	if (rc != GD_OK)
		return rc;
	rc = cut_fireflies(in, err);
	if (rc == GD_OK)
		rc = new_work(&w, in, err);
	if (rc == GD_OK) {
		clear(out->est, planes(in));
		clear(w.sum, in->self ? 0 : planes(in));
		clear(out->mse, 3);
		rc = run_stages(out, &w, in, conf, result, report, err);
	}
	if (rc == GD_OK)
		rc = finish(out, &w, in, result, err);
	free_planes(w.pilot, 3);
	free_planes(&w.weight, 1);
	free_planes(w.sum, GD_APR_RHS);
	free_planes(w.fit, GD_APR_RHS);
	return rc;
}
