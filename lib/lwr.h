/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Sparse local linear models on prediction windows of adaptive size. Around a centre c, and for
 * every radius r = 1 .. R, the model is
 *	mu(i) = b0 + b1 u + b2 v + sum_a b_a (f_a(i) - f_a(c)),   (u,v) = (i - c) / R,
 * fitted by weighted least squares to the (2r+1)^2 pixels around c. Its error is accumulated ring
 * by ring on pixels that it has not seen: the model of radius r-1 predicts the ring r; the start
 * at 3x3 leaves one out. From the squares the noise of the pixels tested is subtracted. The radius
 * of least mean error is the prediction window: the model predicts all of its pixels.
 * Centres are placed coarse to fine: on a grid of `granularity` pixels, then of half of that, and
 * so on to 1, wherever no window covers the pixel yet. A pixel is the mean of its predictions.
 * A window grows no further once it is three rings beyond the best and has four times its error.
 * Columns come in the order above; one of which no more than rounding, or than the noise of the
 * feature, is left in the window after those before it is not used there, nor are more columns than
 * half the pixels.
 * Source: Moon, Iglesias-Guitian, Yoon, Mitchell, Adaptive Rendering with Linear Predictions
 * (2015), sections 4 and 5. Differs: nested sums of moments and a scaled factorisation in place of
 * the recursive update of an inverse (the same estimates, to rounding, where that is stable); one
 * radius for all channels; no window of the centre alone but in `paper`; centres in the middle of
 * equal parts of the image.
 */
#ifndef GD_LWR_H
#define GD_LWR_H

#include <stdbool.h>
#include <stddef.h>

#include "gd.h"
#include "plane.h"

#define GD_LWR_RADIUS	15	/* largest window radius, pixels */
#define GD_LWR_FEATURES	32	/* most feature planes of one fit */
#define GD_LWR_RHS	64	/* most planes fitted at once */

struct gd_lwr_conf {
	int radius;		/* R, pixels; 1 .. GD_LWR_RADIUS; 9: windows up to 19x19 */
	int per_column;		/* a window may be chosen that has so many pixels for each column
				 * of the model; 0: any. Errors are counted from r = 1 on anyway */
	int granularity;	/* spacing of the first centres, pixels; 1 .. 2R+1; 0: 2R+1 */
	bool dense;		/* a model at every pixel, whether covered or not */
	bool paper;		/* the error as printed (noise is not subtracted for r >= 1; the
				 * centre alone, r = 0, has var), slopes pulled to 0 by 1e-3,
				 * truncated SVD of the features in the window; twin, ridge and
				 * flat are not used */
	double feature_noise;	/* as in struct gd_apr_conf: drop a feature whose spread in a
				 * window, after those before it, is below this many times its
				 * noise; 0: never */
	double ridge;		/* pull of every slope, relative to the spread in the window */
	double flat;		/* pull of feature slopes, in squares of the feature's range */
};
#define GD_LWR_DEFAULTS ((struct gd_lwr_conf){ \
	.radius = 9, .per_column = 5, .granularity = 5, .feature_noise = 1, .ridge = 1e-3, \
	.flat = 3e-5 })

/*
 * Planes of one size, all finite (gd_apr_clean() makes them so).
 * y        ny planes to denoise; all get the same windows; the first three (or the one, if ny < 3)
 *          are the colour, which chooses the radius
 * twin     NULL, or as many planes as the colour has: an independent estimate of the same colour,
 *          the other half of the samples. An error is then the product of both misfits,
 *          (prediction - y) (prediction - twin), which holds no noise of the tested pixel, and var
 *          is not needed
 * var      NULL, or the variance of the mean of the colour, >= 0: subtracted from squared misfits
 * feat, feat_var, weight	as in struct gd_apr_in; the weight counts in the error, too
 */
struct gd_lwr_in {
	int ny, nfeat;
	const struct gd_plane *y, *twin, *var, *feat, *feat_var;
	struct gd_plane weight;
};

/*
 * est      ny planes
 * mse      NULL, or as many planes as the colour has: estimated mean squared error, the mean of
 *          what the models covering the pixel have in their prediction windows; >= 0
 * radius, features   v = NULL, or the prediction radius and the number of features in use
 *          (as published: of their components), averaged over the models that cover the pixel
 * centre   v = NULL, or 1 where a model stands, else 0
 * spread   NULL, or as many planes as the colour has: variance of the predictions that cover the
 *          pixel about their mean; 0 where there is one
 * Must not overlap the input.
 */
struct gd_lwr_out {
	struct gd_plane *est, *mse, *spread;
	struct gd_plane radius, features, centre;
};

struct gd_lwr_result {
	size_t models;		/* built; pixels / models is the sparsity */
	double mean_radius;	/* of their prediction windows */
};

/*
 * Returns GD_OK, GD_EARG, GD_ESHAPE, GD_ENOMEM. The result does not depend on the number of
 * threads; scaling y (and twin, and var by the square) does the same to the result, shifting or
 * scaling a feature nothing, to rounding.
 */
int gd_lwr_fit(const struct gd_lwr_out *out, const struct gd_lwr_in *in,
	       const struct gd_lwr_conf *conf, struct gd_lwr_result *result,
	       const struct gd_report *report, struct gd_err *err);

#endif
