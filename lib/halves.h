/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * What regressions that are cross-fitted on two halves of the samples have in common, whichever way
 * they fit (crossfit.h, lwrfit.h): what goes in is made fit to use, pixels are weighed, the fits of
 * a half are averaged, and the halves joined to an image with its error.
 *
 * The order of calls: gd_halves_check(), gd_halves_cut(), gd_halves_calm(), gd_gather() of gather.h
 * for other frames, gd_halves_scale(); for either half gd_halves_weight() from what explains it and
 * gd_halves_weigh_count(), the fits, gd_halves_add() for each; at last gd_halves_spread() and
 * gd_halves_finish(). Planes are of one size; nothing depends on the number of threads.
 */
#ifndef GD_HALVES_H
#define GD_HALVES_H

#include <float.h>
#include <math.h>

#include "crossfit.h"

/* ---- planes ---- */

/* n new planes of the size of like, not cleared. GD_ENOMEM: some may be there, free them all. */
int gd_halves_planes(struct gd_plane *p, int n, struct gd_plane like, struct gd_err *err);

/* Frees n planes made by gd_halves_planes(), or with v = NULL, and sets v = NULL. */
void gd_halves_free(struct gd_plane *p, int n);

void gd_halves_clear(const struct gd_plane *p, int n);

/* n planes become the mean over side x side windows (side odd), with one spare plane. */
int gd_halves_smooth(struct gd_plane *p, int n, struct gd_plane spare, int side,
		     struct gd_err *err);

/* The nearest float that is not infinite. */
static inline float gd_halves_float(double v)
{
	return v > (double)FLT_MAX ? FLT_MAX : v < -(double)FLT_MAX ? -FLT_MAX : (float)v;
}

/* The same of a square, cut at 1e38: sums of a few of them stay floats. */
static inline float gd_halves_square(double v)
{
	return v > 1e38 ? 1e38f : (float)v;
}

/* Mean of the three channels of an image, of those that are not negative. */
static inline double gd_halves_luminance(const struct gd_plane *rgb, int x, int y)
{
	double l = 0;

	for (int c = 0; c < 3; c++) {
		double v = (double)gd_row(rgb[c], y)[x];

		l += (v > 0 ? v : 0) / 3;	/* not fmax(): that is a call */
	}
	return l;
}

/*
 * Whether a plane of radiance that was computed is constant but for rounding (1e-5 of it): what is
 * left then is no shape, and a regression should not lean on it.
 */
bool gd_halves_constant(struct gd_plane p);

/* The mean of a plane, added up row by row. */
double gd_halves_mean(struct gd_plane p);

/* ---- what goes in ---- */

/* Independent parts of the samples: 2, or 1 with in->self. */
static inline int gd_halves_count(const struct gd_crossfit_in *in)
{
	return in->self ? 1 : 2;
}

/* The part whose pilot and feature explain part `half`: the other one, where there is one. */
static inline int gd_halves_other(const struct gd_crossfit_in *in, int half)
{
	return in->self ? 0 : 1 - half;
}

/* Planes to estimate: those of whole where given, else those of y. */
static inline int gd_halves_nest(const struct gd_crossfit_in *in)
{
	return in->nwhole ? in->nwhole : in->ny;
}

/* Refuses what struct gd_crossfit_in does not allow (GD_EARG), and fills in equal shares. */
int gd_halves_check(struct gd_crossfit_in *in, struct gd_err *err);

/*
 * Cuts, in place, fireflies that would blind whole windows: pixels of a half a thousand times
 * brighter than the image and than what the other half (in->self: the neighbours) has there. All
 * planes of the half take it alike, and those of whole lose the half's share. In other frames, too.
 */
int gd_halves_cut(struct gd_crossfit_in *in, struct gd_err *err);

/*
 * Takes spikes of one pixel out of the features of the halves, in place: what is beyond all of its
 * 8 neighbours becomes the nearest of them, but for as much as both halves stick out by. A Poisson
 * solve leaves such pixels, and a regression hands them on to the image.
 */
int gd_halves_calm(struct gd_crossfit_in *in, struct gd_err *err);

/*
 * Brings features that vary to median 0 and range (percentiles 0.5 to 99.5) 1, in place, the first
 * `most` of them: which[i] is the place of the i-th one in feat, and *n is how many. Others are
 * left as they are. No linear fit is changed by this.
 */
int gd_halves_scale(int *which, int *n, const struct gd_plane *feat, int nfeat, int most,
		    struct gd_err *err);

/* *level: the mean luminance of an image, values beyond the 99th percentile cut to it. */
int gd_halves_level(double *level, const struct gd_plane *rgb, struct gd_err *err);

/*
 * What pixels count in a fit: 1 / (1 + (l / dark)^2), l = luminance of rgb, dark = 0.1 level. rgb
 * must not know the noise of what is fitted: take the pilot, or any smooth estimate, of the other
 * half.
 */
int gd_halves_weight(struct gd_plane weight, const struct gd_plane *rgb, struct gd_err *err);

/*
 * weight *= the samples that `half` has in a pixel, where that differs (in->count): as many
 * observations. Known before any noise is drawn, so that no bias comes of it. A pixel without
 * samples counts 1e-6 of the mean: its value is of no use, but every window has to know one.
 */
void gd_halves_weigh_count(struct gd_plane weight, const struct gd_crossfit_in *in, int half);

/* The share of a pixel's samples that `half` holds. */
static inline double gd_halves_share(const struct gd_crossfit_in *in, int half, int x, int y)
{
	double n[2];

	if (in->self || !in->count[0].v)
		return in->share[half];
	for (int h = 0; h < 2; h++)
		n[h] = (double)gd_row(in->count[h], y)[x];
	return n[0] + n[1] > 0 ? n[half] / (n[0] + n[1]) : 0.5;
}

/* ---- what comes out ---- */

/*
 * Takes the k-th fit (from 1) of n planes into the mean of the fits, and that of the first three
 * into square[3], the sum of squared distances to the mean. Clear both before the first. The same
 * square serves both halves.
 */
void gd_halves_add(const struct gd_plane *mean, const struct gd_plane *square,
		   const struct gd_plane *fit, int n, int k);

/*
 * The models' standard deviation, of what gd_halves_add() left in square after `models` fits of
 * either half: the root of the mean square of the three channels; 0 with one model.
 */
void gd_halves_spread(struct gd_plane spread, const struct gd_plane *square,
		      const struct gd_crossfit_in *in, int models);

/* What `bias` of gd_halves_finish() is to be, as measured, where out->mse is that square. */
double gd_halves_disagree(const struct gd_crossfit_in *in, int models);

/*
 * Makes the result of the halves: out->est holds the mean fit of half 0 and becomes the estimate,
 * other is that of half 1 (in->self: out->est again). out->mse holds a measure of the squared bias
 * (a square of gd_halves_add(), a window's error, or 0), and becomes the error of the estimate:
 * share_0 share_1 (difference of the halves)^2, which their noise makes of the mean (shares: of
 * in->share, or of in->count in 9x9 pixels, as a window's fit knows them), and `bias` times what it
 * held; smoothed over 5x5 pixels. At last what the fits took from the mean of the image is given
 * back: *gain as in struct gd_crossfit_result, 1 where nothing was.
 * in: as it was fitted; spare: one plane. out->spread is not touched.
 */
int gd_halves_finish(const struct gd_crossfit_out *out, const struct gd_plane *other,
		     const struct gd_crossfit_in *in, double bias, struct gd_plane spare,
		     double *gain, struct gd_err *err);

#endif
