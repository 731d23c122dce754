/* SPDX-License-Identifier: BSD-3-Clause */
#include "halves.h"

#include <stdlib.h>
#include <string.h>

#include "blur.h"

#define SAMPLES		128	/* per axis, for percentiles */
#define DARK		0.1	/* of the image's level: below it errors count as they are */
#define DISAGREE	2.0	/* squared error per variance of the models about their mean */
#define DISAGREE_SELF	6.0	/* the same where no halves tell what noise does */
#define GAIN_LIMIT	1.25	/* a mean further off is ruled by fireflies, not by misfit */
#define FIREFLY		1000.0	/* times as bright as it should be */

/* ---- planes ---- */

int gd_halves_planes(struct gd_plane *p, int n, struct gd_plane like, struct gd_err *err)
{
	size_t size = gd_stride(like.w) * (size_t)like.h;

	for (int i = 0; i < n; i++) {
		p[i] = gd_plane_of(gd_alloc(size, sizeof(float)), like.w, like.h);
		if (!p[i].v)
			return gd_fail(err, GD_ENOMEM, "out of memory");
	}
	return GD_OK;
}

void gd_halves_free(struct gd_plane *p, int n)
{
	for (int i = 0; i < n; i++) {
		free(p[i].v);
		p[i].v = NULL;
	}
}

void gd_halves_clear(const struct gd_plane *p, int n)
{
	for (int c = 0; c < n; c++)
		for (int y = 0; y < p[c].h; y++)
			memset(gd_row(p[c], y), 0, (size_t)p[c].w * sizeof(float));
}

int gd_halves_smooth(struct gd_plane *p, int n, struct gd_plane spare, int side,
		     struct gd_err *err)
{
	struct gd_blur box = gd_blur_box(side);
	int rc = GD_OK;

	for (int c = 0; c < n && rc == GD_OK; c++)
		rc = gd_blur_plane(p[c], spare, &box, err);
	return rc;
}

bool gd_halves_constant(struct gd_plane p)
{
	float lo = p.v[0], hi = lo;

	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++) {
			float v = gd_row(p, y)[x];

			lo = v < lo ? v : lo;
			hi = v > hi ? v : hi;
		}
	return (double)hi - (double)lo <= 1e-5 * fmax(fabs((double)lo), fabs((double)hi));
}

double gd_halves_mean(struct gd_plane p)
{
	double sum = 0;

	for (int y = 0; y < p.h; y++) {
		double row = 0;

		for (int x = 0; x < p.w; x++)
			row += (double)gd_row(p, y)[x];
		sum += row;
	}
	return sum / ((double)p.w * p.h);
}

/* ---- what goes in ---- */

int gd_halves_check(struct gd_crossfit_in *in, struct gd_err *err)
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
	if (in->nframe < 0 || in->nframe > GD_CROSSFIT_FRAMES)
		return gd_fail(err, GD_EARG, "%d other frames, at most %d", in->nframe,
			       GD_CROSSFIT_FRAMES);
	if (in->share[0] == 0 && in->share[1] == 0)
		in->share[0] = in->share[1] = 0.5;
	if (!(in->share[0] > 0 && in->share[1] > 0 &&
	      fabs(in->share[0] + in->share[1] - 1) < 1e-6))
		return gd_fail(err, GD_EARG, "halves hold %g and %g of the samples, expected "
			       "shares of 1", in->share[0], in->share[1]);
	return GD_OK;
}

static int compare(const void *a, const void *b)
{
	float x = *(const float *)a, y = *(const float *)b;

	return (x > y) - (x < y);
}

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
			gd_row(p, y)[x] = gd_halves_float(((double)gd_row(p, y)[x] - minus) *
							  times);
}

/* As fminf() and fmaxf() of finite values, which are calls. */
static inline float least(float a, float b)
{
	return a < b ? a : b;
}

static inline float most(float a, float b)
{
	return a > b ? a : b;
}

/* Rows of a plane around the pixels in question. */
struct rows {
	const float *up, *row, *down;
};

/* Pixel x cut to the range of its neighbours: a before, b after, and those above and below. */
static inline float cut(struct rows r, int a, int x, int b)
{
	float low = least(least(least(r.up[a], r.up[x]), least(r.up[b], r.row[a])),
			  least(least(r.down[a], r.down[x]), least(r.down[b], r.row[b])));
	float high = most(most(most(r.up[a], r.up[x]), most(r.up[b], r.row[a])),
			  most(most(r.down[a], r.down[x]), most(r.down[b], r.row[b])));

	return least(most(r.row[x], low), high);
}

/* The same, but for as much as the other half's pixel sticks out in the same direction. */
static inline float calm_pixel(struct rows r, struct rows other, int a, int x, int b)
{
	float to = cut(r, a, x, b), v = r.row[x];
	float out = other.row[x] - cut(other, a, x, b);
	float both = v > to ? most(out, 0) : least(out, 0);

	return v > to ? least(to + both, v) : v < to ? most(to + both, v) : v;
}

static void calm_row(float *restrict to, struct rows r, struct rows other, int w)
{
	to[0] = calm_pixel(r, other, 1, 0, 1);
	for (int x = 1; x < w - 1; x++)
		to[x] = calm_pixel(r, other, x - 1, x, x + 1);
	to[w - 1] = calm_pixel(r, other, w - 2, w - 1, w - 2);
}

static struct rows rows_at(struct gd_plane p, int y)
{
	int up = y > 0 ? y - 1 : y + 1, down = y < p.h - 1 ? y + 1 : y - 1;

	return (struct rows){ gd_row(p, up), gd_row(p, y), gd_row(p, down) };
}

/* Both halves of a plane, in place; with n = 1 there is only the first. */
static void calm(const struct gd_plane *p, int n, const struct gd_plane *spare)
{
	for (int half = 0; half < n; half++) {
#pragma omp parallel for schedule(static)
		for (int y = 0; y < p[0].h; y++) {
			struct rows r = rows_at(p[half], y);
			struct rows other = rows_at(p[n - 1 - half], y);

			/* nobody confirms what sticks out: no pixel is cut beside itself */
			if (n == 1)
				other = (struct rows){ r.row, r.row, r.row };
			calm_row(gd_row(spare[half], y), r, other, p[0].w);
		}
	}
	for (int half = 0; half < n; half++) {
#pragma omp parallel for schedule(static)
		for (int y = 0; y < p[0].h; y++)
			memcpy(gd_row(p[half], y), gd_row(spare[half], y),
			       (size_t)p[0].w * sizeof(float));
	}
}

int gd_halves_calm(struct gd_crossfit_in *in, struct gd_err *err)
{
	const int n = gd_halves_count(in);
	struct gd_plane spare[2] = { { 0 } };
	int rc;

	if (in->nfeature == 0 || in->y[0][0].w < 2 || in->y[0][0].h < 2)
		return GD_OK;
	rc = gd_halves_planes(spare, n, in->y[0][0], err);
	for (int c = 0; c < in->nfeature && rc == GD_OK; c++) {
		const struct gd_plane both[2] = { in->feature[0][c], in->feature[1][c] };

		calm(both, n, spare);
		for (int f = 0; f < in->nframe; f++) {
			const struct gd_crossfit_frame *frame = in->frame + f;

			calm((const struct gd_plane[]){ frame->feature[0][c],
							frame->feature[1][c] },
			     n, spare);
		}
	}
	gd_halves_free(spare, 2);
	return rc;
}

int gd_halves_scale(int *which, int *n, const struct gd_plane *feat, int nfeat, int most,
		    struct gd_err *err)
{
	float *v = gd_alloc((size_t)SAMPLES * SAMPLES, sizeof *v);

	if (!v)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	*n = 0;
	for (int a = 0; a < nfeat && *n < most; a++) {
		double median, range;

		feature_range(feat[a], v, &median, &range);
		if (range > 0) {
			scale_plane(feat[a], median, 1 / range);
			which[(*n)++] = a;
		}
	}
	free(v);
	return GD_OK;
}

int gd_halves_level(double *level, const struct gd_plane *rgb, struct gd_err *err)
{
	float *v = gd_alloc((size_t)SAMPLES * SAMPLES, sizeof *v);
	struct gd_plane p = rgb[0];
	int nx = p.w < SAMPLES ? p.w : SAMPLES, ny = p.h < SAMPLES ? p.h : SAMPLES, n = 0;
	double sum = 0;

	if (!v)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	for (int j = 0; j < ny; j++)
		for (int i = 0; i < nx; i++)
			v[n++] = gd_halves_float(gd_halves_luminance(rgb, place(i, nx, p.w),
								     place(j, ny, p.h)));
	qsort(v, (size_t)n, sizeof *v, compare);
	for (int i = 0; i < n; i++)
		sum += (double)v[i < n - 1 - n / 100 ? i : n - 1 - n / 100];
	free(v);
	*level = sum / n;
	return GD_OK;
}

/* Luminance of p's brightest pixel of the 3x3 around x, y; of those around it only, if apart. */
static double brightest_near(const struct gd_plane *p, int x, int y, bool apart)
{
	double most = 0;

	for (int j = y > 0 ? y - 1 : 0; j <= y + 1 && j < p->h; j++)
		for (int i = x > 0 ? x - 1 : 0; i <= x + 1 && i < p->w; i++)
			if (!apart || i != x || j != y)
				most = fmax(most, gd_halves_luminance(p, i, j));
	return most;
}

static void times_pixel(const struct gd_plane *p, int n, int x, int y, double times)
{
	for (int c = 0; c < n; c++)
		gd_row(p[c], y)[x] = gd_halves_float(times * (double)gd_row(p[c], y)[x]);
}

/* Cuts pixel x, y of one half, all its planes alike; the image of all samples loses its share. */
static void cut_firefly(struct gd_crossfit_in *in, int half, int x, int y, double limit)
{
	double here = gd_halves_luminance(in->y[half], x, y);
	double share = gd_halves_share(in, half, x, y);
	double other = in->nwhole ? gd_halves_luminance(in->y[1 - half], x, y) : 0;
	double times = limit / here, rest = (1 - share) * other, all = share * here + rest;

	times_pixel(in->y[half], in->ny, x, y, times);
	if (all > 0)	/* or the half has no samples here, and the other one no light */
		times_pixel(in->whole, in->nwhole, x, y, (share * limit + rest) / all);
}

/* Cuts those of one frame. */
static int cut_frame(struct gd_crossfit_in *in, struct gd_err *err)
{
	double level = 0;

	for (int half = 0; half < gd_halves_count(in); half++) {
		double l;
		int rc = gd_halves_level(&l, in->y[half], err);

		if (rc != GD_OK)
			return rc;
		level += l / gd_halves_count(in);
	}
	for (int half = 0; half < gd_halves_count(in) && level > 0; half++) {
		const struct gd_plane *p = in->y[half], *other = in->y[gd_halves_other(in, half)];

		/* without halves neighbours are read that may just be cut: in order then */
#pragma omp parallel for schedule(static) if (!in->self)
		for (int y = 0; y < p->h; y++)
			for (int x = 0; x < p->w; x++) {
				double here = gd_halves_luminance(p, x, y), limit = FIREFLY * level;

				if (here > limit)
					limit = FIREFLY *
						(level + brightest_near(other, x, y, in->self));
				if (here > limit)
					cut_firefly(in, half, x, y, limit);
			}
	}
	return GD_OK;
}

int gd_halves_cut(struct gd_crossfit_in *in, struct gd_err *err)
{
	struct gd_crossfit_in other = *in;	/* planes are borrowed */
	int rc = cut_frame(in, err);

	for (int k = 0; k < in->nframe && rc == GD_OK; k++) {
		memcpy(other.y, in->frame[k].y, sizeof other.y);
		memcpy(other.whole, in->frame[k].whole, sizeof other.whole);
		memcpy(other.count, in->frame[k].count, sizeof other.count);
		rc = cut_frame(&other, err);
	}
	return rc;
}

int gd_halves_weight(struct gd_plane weight, const struct gd_plane *rgb, struct gd_err *err)
{
	double level, dark;
	int rc = gd_halves_level(&level, rgb, err);

	if (rc != GD_OK)
		return rc;
	dark = fmax(DARK * level, (double)FLT_MIN);
#pragma omp parallel for schedule(static)
	for (int y = 0; y < weight.h; y++)
		for (int x = 0; x < weight.w; x++) {
			double l = gd_halves_luminance(rgb, x, y) / dark;

			gd_row(weight, y)[x] = (float)(1 / (1 + fmin(l * l, 1e30)));
		}
	return GD_OK;
}

void gd_halves_weigh_count(struct gd_plane weight, const struct gd_crossfit_in *in, int half)
{
	struct gd_plane count = in->count[half];
	double mean, least;

	if (!count.v)
		return;
	mean = gd_halves_mean(count);
	mean = mean > 0 ? mean : 1;
	least = 1e-6 * mean;
#pragma omp parallel for schedule(static)
	for (int y = 0; y < weight.h; y++)
		for (int x = 0; x < weight.w; x++) {
			double n = fmax((double)gd_row(count, y)[x], least) / mean;

			gd_row(weight, y)[x] = (float)((double)gd_row(weight, y)[x] * n);
		}
}

/* ---- what comes out ---- */

void gd_halves_add(const struct gd_plane *mean, const struct gd_plane *square,
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

				m[x] = gd_halves_float((double)m[x] + off / k);
				if (s)
					s[x] = gd_halves_square((double)s[x] +
								off * (off - off / k));
			}
		}
	}
}

/* Sum of a half's colour, times its share of the samples, and whether nothing in it is negative. */
static double total(const struct gd_crossfit_in *in, int half, bool *negative)
{
	const struct gd_plane *rgb = in->y[half];
	const bool local = in->count[0].v && !in->self;
	double sum = 0;

	for (int c = 0; c < 3; c++)
		for (int y = 0; y < rgb[c].h; y++) {
			double row = 0;

			for (int x = 0; x < rgb[c].w; x++) {
				double v = (double)gd_row(rgb[c], y)[x];

				row += local ? gd_halves_share(in, half, x, y) * v : v;
				*negative = *negative || v < 0;
			}
			sum += row;
		}
	return in->self || local ? sum : in->share[half] * sum;
}

/* Degrees of freedom of the squared distances that gd_halves_add() left. */
static int degrees(const struct gd_crossfit_in *in, int models)
{
	return gd_halves_count(in) * (models - 1);
}

double gd_halves_disagree(const struct gd_crossfit_in *in, int models)
{
	int n = degrees(in, models);

	return n > 0 ? (in->self ? DISAGREE_SELF : DISAGREE) / n : 0;
}

void gd_halves_spread(struct gd_plane spread, const struct gd_plane *square,
		      const struct gd_crossfit_in *in, int models)
{
	int n = degrees(in, models);

#pragma omp parallel for schedule(static)
	for (int y = 0; y < spread.h; y++)
		for (int x = 0; x < spread.w; x++) {
			double sum = 0;

			for (int c = 0; c < 3; c++)
				sum += (double)gd_row(square[c], y)[x];
			gd_row(spread, y)[x] =
				n > 0 ? gd_halves_float(sqrt(sum / (3.0 * n))) : 0;
		}
}

/* The share of half 0 around each pixel, into share. */
static int local_share(struct gd_plane share, const struct gd_crossfit_in *in,
		       struct gd_plane spare, struct gd_err *err)
{
	for (int y = 0; y < share.h; y++)
		for (int x = 0; x < share.w; x++)
			gd_row(share, y)[x] = (float)gd_halves_share(in, 0, x, y);
	return gd_halves_smooth(&share, 1, spare, 9, err);
}

/*
 * est and mse from the means of the halves: est holds the first, other the second, mse a measure of
 * the bias, bias times which is taken for the square of it. share: of half 0 around each pixel, v =
 * NULL: as in has it. clip: nothing below 0.
 */
static void join(const struct gd_crossfit_out *out, const struct gd_plane *other,
		 const struct gd_crossfit_in *in, struct gd_plane share, double bias, bool clip)
{
	for (int c = 0; c < gd_halves_nest(in); c++) {
#pragma omp parallel for schedule(static)
		for (int y = 0; y < other[c].h; y++) {
			const float *b = gd_row(other[c], y);	/* without halves: a again */
			const float *s = share.v ? gd_row(share, y) : NULL;
			float *a = gd_row(out->est[c], y);
			float *m = c < 3 ? gd_row(out->mse[c], y) : NULL;

			for (int x = 0; x < other[c].w; x++) {
				double s0 = s ? (double)s[x] : in->share[0];
				double s1 = s ? 1 - s0 : in->share[1];
				double d = (double)a[x] - (double)b[x];
				double e = s0 * (double)a[x] + s1 * (double)b[x];

				a[x] = clip && e < 0 ? 0 : gd_halves_float(e);
				if (m)
					m[x] = gd_halves_square(s0 * s1 * d * d +
								bias * (double)m[x]);
			}
		}
	}
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
	double level, have = 0, bright = 0, a;
	int rc = gd_halves_level(&level, est, err);

	if (rc != GD_OK)
		return rc;
	level = fmax(level, (double)FLT_MIN);
	for (int y = 0; y < like.h; y++) {
		double row = 0, row_bright = 0;

		for (int x = 0; x < like.w; x++) {
			double l = gd_halves_luminance(est, x, y), e = 0;

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
			double l = gd_halves_luminance(est, x, y);
			double times = 1 + a * (l / (l + level));

			for (int c = 0; c < n; c++)
				gd_row(est[c], y)[x] =
					gd_halves_float(times * (double)gd_row(est[c], y)[x]);
		}
	return GD_OK;
}

int gd_halves_finish(const struct gd_crossfit_out *out, const struct gd_plane *other,
		     const struct gd_crossfit_in *in, double bias, struct gd_plane spare,
		     double *gain, struct gd_err *err)
{
	struct gd_plane share = { 0 };
	bool negative = false;
	double sum = 0;
	int n = gd_halves_nest(in), rc = GD_OK;

	*gain = 1;
	for (int half = 0; half < gd_halves_count(in); half++)
		sum += total(in, half, &negative);
	if (in->count[0].v && !in->self) {
		rc = gd_halves_planes(&share, 1, out->est[0], err);
		if (rc == GD_OK)
			rc = local_share(share, in, spare, err);
	}
	if (rc == GD_OK) {
		join(out, other, in, share, bias, !negative && n == 3);
		rc = gd_halves_smooth(out->mse, 3, spare, 5, err);
	}
	if (rc == GD_OK)
		rc = keep_mean(out->est, n, sum, gain, err);
	gd_halves_free(&share, 1);
	return rc;
}
