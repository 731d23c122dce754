/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Adaptive polynomial rendering: local regression of a noisy image on feature planes and a
 * polynomial of the pixel position, with the order of the polynomial chosen by estimated error.
 *
 * In the window of radius R around a centre c the model is
 *	mu(i) = b0 + sum_a b_a f_a(i) + sum_{k=1..K} (p_k u^k + q_k v^k),   (u,v) = (i - c) / R,
 * fitted by least squares with kernel weights, K <= order_max by Stein's unbiased risk estimate
 * from the variance planes, all channels together. Each window predicts all of its pixels; a
 * pixel's estimate is the kernel-weighted mean of the predictions that cover it.
 * Sources: Moon, McDonagh, Mitchell, Gross, Adaptive Polynomial Rendering (2016), as described by
 * Back, Yoon and Moon (2018), section 5. Differs: risk estimate instead of the plug-in of the
 * input, centres on a grid, moments by separable filtering.
 */
#ifndef GD_APR_H
#define GD_APR_H

#include "gd.h"
#include "plane.h"

#define GD_APR_RADIUS	64	/* largest window radius, pixels */
#define GD_APR_ORDER	3	/* largest order of the polynomial */
#define GD_APR_FEATURES	32	/* most feature planes of one fit */
#define GD_APR_RHS	64	/* most planes fitted at once */

enum gd_apr_kernel { GD_APR_GAUSS, GD_APR_BOX };	/* standard deviation R/2, cut at R; flat */

struct gd_apr_conf {
	int radius;			/* R, pixels: the window is (2R+1)^2; 0 .. GD_APR_RADIUS */
	int step;			/* most between neighbouring centres, pixels; 1 .. 2R+1 */
	int order_min, order_max;	/* 0 .. GD_APR_ORDER; equal: no variances needed */
	enum gd_apr_kernel kernel;
	/* Drop a feature whose spread in a window, after the features before it, is below this many
	 * times its noise variance; 0: never. */
	double feature_noise;
	/* Variance of a sum of neighbouring pixels' noise over the sum of their variances: 1 where
	 * pixels are independent; > 0. */
	double correlation;
	/* Pull of every slope towards 0, relative to the column's spread in the window: tames
	 * directions with less than that left by earlier columns. */
	double ridge;
	/* Pull of feature slopes: the mean square about the window's mean, in squares of the
	 * feature's range over the image, that halves a slope. */
	double flat;
};
#define GD_APR_DEFAULTS { 10, 5, 0, 3, GD_APR_GAUSS, 1.0, 1.0, 0, 0 }
#define GD_APR_PAPER	{ 21, 6, 0, 3, GD_APR_GAUSS, 1.0, 1.0, 0, 0 }	/* 43 x 43 windows */

/*
 * What goes in: planes of one size, any unit, all finite (gd_apr_clean() makes them so).
 * y        planes to denoise; all get the same windows, columns and order, and as a fit is linear
 *          in y, layers that add up to an image still do so in the estimates
 * var      variance of the mean of y[0] .. y[nvar-1], its unit squared, >= 0; these are the planes
 *          that choose the order and get an error estimate; others may not be
 * feat     feature planes, most trusted first; a feature that is constant, or collinear with the
 *          ones before it, changes nothing, window by window
 * feat_var variances of the features; NULL, or a plane with v = NULL: exact
 * weight   v = NULL, or what a pixel counts in the fits, beside the kernel, > 0, any unit;
 *          predictions are averaged by the kernel alone. It must not know the noise of y (a weight
 *          that falls with the pixel's own value darkens the image): take it from the other half
 *          of the samples
 */
struct gd_apr_in {
	int ny, nvar, nfeat;
	const struct gd_plane *y, *var, *feat, *feat_var;
	struct gd_plane weight;
};

/*
 * What comes out; planes must not overlap the input.
 * est      ny planes
 * mse      NULL, or nvar planes: estimated mean squared error of est, unit of var
 * order    v = NULL, or the order chosen, averaged over the windows that cover a pixel
 * columns  v = NULL, or the number of model columns in use (1 + features + polynomial), averaged
 *          alike
 */
struct gd_apr_out {
	struct gd_plane *est, *mse;
	struct gd_plane order, columns;
};

/*
 * Fits and predicts. Cost grows with pixels * (2R+1)/step * (features + order)^2 * (1 + nvar).
 * Memory: 8 * ny * columns / step^2 bytes per pixel, and about 1 MB per thread.
 * Returns GD_OK, GD_EARG, GD_ESHAPE, GD_ENOMEM. The result does not depend on the number of
 * threads; scaling y (and var by the square) does the same to the result, shifting or scaling a
 * feature nothing, to rounding.
 */
int gd_apr_fit(const struct gd_apr_out *out, const struct gd_apr_in *in,
	       const struct gd_apr_conf *conf, const struct gd_report *report, struct gd_err *err);

/*
 * Centres along an axis of n pixels, at most step apart, first and last pixel included, symmetric
 * about the middle (so that a flipped image has flipped windows). Returns their number; centre may
 * be NULL, or hold n numbers.
 */
int gd_apr_centres(int *centre, int n, int step);

#endif
