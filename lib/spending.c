/* SPDX-License-Identifier: BSD-3-Clause */
#include "spending.h"

#include <math.h>
#include <stdlib.h>

#include "blur.h"
#include "buffers.h"
#include "halves.h"
#include "spending_trial.h"

#define DARK	0.25	/* of the mean luminance: errors below count as they are */
#define MOST	1000.0	/* of a pixel's squared relative error. Not lower, and the same for d and e:
			 * rare bright samples tell against images that are too dark, and those with
			 * few samples have none */
#define LEAST	0.25	/* of the mean of e: the least that d is compared with */

/* What is known of a pixel, and becomes known of its region by blurring. */
enum { D, D2, E, F, PLANES };	/* D2: the other way round, B against A */

struct job {
	const struct gd_spending_conf *conf;
	struct gd_plane p[PLANES], spare;
	double *part;		/* a few sums for each row */
	double cheaper;		/* log of what plain samples make of the error in the same time */
	double mean_e;
	double prior, kept;	/* M and t / (t + s) */
};

int gd_spending_want(struct gd_image *im, struct gd_err *err)
{
	return gd_trial_want(im, err);
}

static int check(const struct gd_spending_conf *conf, struct gd_plane share,
		 const struct gd_image *im, struct gd_err *err)
{
	if (!(conf->cost >= 1 && conf->cost <= 100))
		return gd_fail(err, GD_EARG, "cost of gradients: %g, expected 1 to 100",
			       conf->cost);
	if (!(conf->dimension >= 0 && conf->dimension <= 100))
		return gd_fail(err, GD_EARG, "dimension: %g, expected 0 to 100", conf->dimension);
	if (!(conf->blur_px >= 1 && conf->blur_px <= 10) || !(conf->width > 0) ||
	    !isfinite(conf->grows))
		return gd_fail(err, GD_EARG, "blur %g px, width %g: out of range", conf->blur_px,
			       conf->width);
	if (share.w != im->w || share.h != im->h)
		return gd_fail(err, GD_ESHAPE, "is %dx%d, expected %dx%d", im->w, im->h, share.w,
			       share.h);
	return GD_OK;
}

/* ---- from denoised halves to d and e ---- */

struct colours {
	struct gd_plane y[2][GD_LAYER_PLANES], with[2][GD_LAYER_PLANES];
	struct gd_plane without[2][GD_LAYER_PLANES];
	struct gd_plane with_error[2][GD_LAYER_PLANES], error[2][GD_LAYER_PLANES];
};

static void colours_of(struct colours *c, const struct gd_trial *t)
{
	for (int h = 0; h < 2; h++) {
		gd_layer_planes(&t->half[h], "", c->y[h]);
		gd_layer_planes(&t->with[h], "", c->with[h]);
		gd_layer_planes(&t->without[h], "", c->without[h]);
		gd_layer_planes(&t->with[h], "error", c->with_error[h]);
		gd_layer_planes(&t->without[h], "error", c->error[h]);
	}
}

static double bounded(double v)
{
	return v > MOST ? MOST : v < -MOST ? -MOST : v == v ? v : 0;	/* NaN: 0 */
}

/* d either way, and the estimated errors without (e) and with the feature (f), of one pixel. */
static void compare(double v[PLANES], const struct colours *c, int x, int y, double dark)
{
	v[D] = v[D2] = v[E] = v[F] = 0;
	for (int k = 0; k < 3; k++) {
		double f[2], g[2], l = 0;

		for (int h = 0; h < 2; h++) {
			f[h] = (double)gd_row(c->with[h][k], y)[x];
			g[h] = (double)gd_row(c->without[h][k], y)[x];
			l += (f[h] + g[h]) / 4;
		}
		for (int h = 0; h < 2; h++) {
			double there = (double)gd_row(c->y[1 - h][k], y)[x];
			double unit = l * l + dark * dark;

			v[h ? D2 : D] += bounded((f[h] - g[h]) * (f[h] + g[h] - 2 * there) /
						 unit) / 3;
			v[E] += bounded((double)gd_row(c->error[h][k], y)[x] / unit) / 6;
			v[F] += bounded((double)gd_row(c->with_error[h][k], y)[x] / unit) / 6;
		}
	}
}

static int compare_all(struct job *j, const struct gd_trial *t, struct gd_err *err)
{
	struct gd_plane rgb[GD_LAYER_PLANES];
	struct colours c;
	double level, dark, sum = 0;
	int rc;

	colours_of(&c, t);
	gd_layer_planes(&t->without[0], "", rgb);
	rc = gd_halves_level(&level, rgb, err);
	if (rc != GD_OK)
		return rc;
	dark = level > 0 ? DARK * level : 1;	/* a black image has no unit */
#pragma omp parallel for schedule(static)
	for (int y = 0; y < j->spare.h; y++) {
		j->part[y] = 0;
		for (int x = 0; x < j->spare.w; x++) {
			double v[PLANES];

			compare(v, &c, x, y, dark);
			for (int k = 0; k < PLANES; k++)
				gd_row(j->p[k], y)[x] = (float)v[k];
			j->part[y] += v[E];
		}
	}
	for (int y = 0; y < j->spare.h; y++)
		sum += j->part[y];
	j->mean_e = sum / j->spare.w / j->spare.h;
	return GD_OK;
}

/* ---- from regions to shares ---- */

struct region {
	double r[2], e;		/* R either way, what d is compared with */
};

static struct region region(const struct job *j, int x, int y)
{
	double d[2] = { (double)gd_row(j->p[D], y)[x], (double)gd_row(j->p[D2], y)[x] };
	double e = (double)gd_row(j->p[E], y)[x], f = (double)gd_row(j->p[F], y)[x];

	e = fmax(fmax(e, f - (d[0] + d[1]) / 2), LEAST * j->mean_e);
	return (struct region){ { d[0] / e, d[1] / e }, e };
}

/*
 * M, and what of R - M is to be believed. The two ways know no common noise, so that what they vary
 * by together is t, the variance of R, and the noise of their mean is a quarter of their squared
 * difference. Regions count by their errors.
 */
static void learn(struct job *j)
{
	double sum[4] = { 0 }, t, s;

#pragma omp parallel for schedule(static)
	for (int y = 0; y < j->spare.h; y++) {
		double *part = j->part + 4 * (size_t)y;

		part[0] = part[1] = part[2] = part[3] = 0;
		for (int x = 0; x < j->spare.w; x++) {
			struct region a = region(j, x, y);
			double apart = a.r[0] - a.r[1];

			part[0] += a.e;
			part[1] += a.e * (a.r[0] + a.r[1]) / 2;
			part[2] += a.e * a.r[0] * a.r[1];
			part[3] += a.e * apart * apart / 4;
		}
	}
	for (int y = 0; y < j->spare.h; y++)
		for (int k = 0; k < 4; k++)
			sum[k] += j->part[4 * (size_t)y + (size_t)k];
	j->prior = sum[1] / sum[0];
	t = fmax(sum[2] / sum[0] - j->prior * j->prior, 0);
	s = sum[3] / sum[0];
	j->kept = t + s > 0 ? t / (t + s) : 0;
}

/* The logarithm of the error with gradients over that with plain samples, in the same time. */
static double disadvantage(const struct job *j, struct region a)
{
	double r = (a.r[0] + a.r[1]) / 2;

	r = j->prior + (r - j->prior) * j->kept;
	return log(fmax(1 + r, 0.05)) - j->conf->grows + j->cheaper;
}

static void decide(struct job *j, struct gd_plane share, struct gd_spending_result *result)
{
	double sum[4] = { 0 };

#pragma omp parallel for schedule(static)
	for (int y = 0; y < share.h; y++) {
		double *part = j->part + 4 * (size_t)y;

		part[0] = part[1] = part[2] = part[3] = 0;
		for (int x = 0; x < share.w; x++) {
			struct region a = region(j, x, y);
			double lost = disadvantage(j, a);
			double s = fmin(fmax(-lost / j->conf->width, 0), 1);

			gd_row(share, y)[x] = (float)s;
			part[0] += s;
			part[1] += a.e;
			part[2] += a.e * (1 - s + s * exp(lost));
			part[3] += a.e * exp(lost);
		}
	}
	for (int y = 0; y < share.h; y++)
		for (int k = 0; k < 4; k++)
			sum[k] += j->part[4 * (size_t)y + (size_t)k];
	result->share = sum[0] / share.w / share.h;
	result->change = j->prior;
	result->gain = sum[2] / sum[1];
	result->everywhere = sum[3] / sum[1];
}

static int run(struct job *j, struct gd_plane share, const struct gd_image *im,
	       struct gd_spending_result *result, const struct gd_report *report,
	       struct gd_err *err)
{
	const struct gd_blur blur = gd_blur_gauss(j->conf->blur_px);
	struct gd_trial trial = { 0 };
	int rc = gd_trial_run(&trial, im, report, err);

	if (rc == GD_OK)
		rc = gd_halves_planes(j->p, PLANES, share, err);
	if (rc == GD_OK)
		rc = gd_halves_planes(&j->spare, 1, share, err);
	if (rc == GD_OK)
		rc = compare_all(j, &trial, err);
	gd_trial_free(&trial);
	for (int k = 0; k < PLANES && rc == GD_OK; k++)
		rc = gd_blur_plane(j->p[k], j->spare, &blur, err);
	if (rc != GD_OK)
		return rc;
	if (j->mean_e > 0) {
		learn(j);
		decide(j, share, result);
	} else {	/* nothing to gain */
		gd_halves_clear(&share, 1);
		*result = (struct gd_spending_result){ .gain = 1, .everywhere = 1 };
	}
	return GD_OK;
}

int gd_spending_map(struct gd_plane share, const struct gd_image *im,
		    const struct gd_spending_conf *conf, struct gd_spending_result *result,
		    const struct gd_report *report, struct gd_err *err)
{
	struct job j = { .conf = conf };
	struct gd_spending_result mine;
	int rc = check(conf, share, im, err);

	if (rc != GD_OK)
		return rc;
	j.cheaper = 4 / (conf->dimension + 4) * log(conf->cost);
	j.part = gd_alloc((size_t)im->h, 4 * sizeof *j.part);
	rc = j.part ? run(&j, share, im, result ? result : &mine, report, err) :
		      gd_fail(err, GD_ENOMEM, "out of memory");
	gd_halves_free(j.p, PLANES);
	gd_halves_free(&j.spare, 1);
	free(j.part);
	return rc;
}
