/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Cross-fitted regression: the default denoiser. The samples come as two independent halves. From
 * each half alone a guess of the image is made, the pilot (nlr.h), and where there are gradients
 * the feature (feature.h). Then the colour of either half is regressed on what the OTHER half says:
 *	y_A ~ G-buffers + pilot_B + feature_B + polynomial of the position		(apr.h)
 * with a narrow pilot (7x7 windows, patches of 3x3) and a wide one (13x13, 5x5) and windows of
 * several sizes, and all fits of both halves are averaged. As the regressors do not know the noise
 * of what they explain, a fit cannot reproduce it, and slopes shrink by themselves where pilot or
 * feature are poor. With a feature half of the models do without the pilot; what they count, half
 * of the mean or more or less, the samples decide from place to place (gate.h). The pixels of a fit
 * weigh
 *	1 / (l^2 + (level / 10)^2),	l = luminance of the pilot of the other half,
 * so that relative errors count and the brightest pixel of a window does not rule it; as l does
 * not know the noise either, this does not darken the image. What the misfit of a linear model
 * still takes from the mean of the image, or adds to it, is given back:
 *	times 1 + a l / (l + level), with l of the result, and one a for all pixels.
 */
#ifndef GD_CROSSFIT_H
#define GD_CROSSFIT_H

#include <stdbool.h>

#include "apr.h"

#define GD_CROSSFIT_FEATURES (GD_APR_FEATURES - 7)	/* beside a half's pilot and feature */

struct gd_crossfit_conf {
	bool fast;	/* one model in place of several */
};

/*
 * Another frame of a sequence, before or after the one to denoise: see gather.h. Its planes are the
 * same layers in the same order, unit and number as those of struct gd_crossfit_in, of the same
 * size, and finite; fireflies are cut in place. y, whole, var, feature, count, position: see there.
 * Frames come in any order.
 */
struct gd_crossfit_frame {
	struct gd_plane y[2][GD_APR_RHS], whole[GD_APR_RHS], var[3];
	struct gd_plane feature[2][4], position[3], count[2];
};

#define GD_CROSSFIT_FRAMES 4

/*
 * Planes of one size, finite.
 * y        ny >= 3 planes of either half: the colour R G B, then any that share its weights
 * self     there are no halves: all samples are in y[0], var is needed, and the pilot made of them
 *          explains them (y[1], share and feature[1] are not used). A pilot is smooth enough for
 *          that to cost little where noise is even, more where fine texture is all that G-buffers
 *          miss
 * whole    nwhole planes of all samples to estimate in place of y (the colour first), where layers
 *          have no halves of their own: smoothed with the mean of the weights that either half
 *          gets; 0: none
 *          Pixels of a half 1000 times brighter than image and other half are cut to that, in place
 * share    of the samples that each half holds; both 0: 0.5
 * var      variance of the mean of all samples' colour, >= 0; v = NULL: from the difference of the
 *          halves
 * feat     nfeat <= GD_CROSSFIT_FEATURES planes common to both halves (G-buffers), filtered where
 *          they were noisy; shifted and scaled in place, and left so
 * feature  of either half, n planes; n = 0: none
 * count    samples of either half in each pixel, where that differs between pixels, >= 0; v = NULL:
 *          the same everywhere
 * position world position (the layer P), which tells what moved where between frames; v = NULL: not
 *          known, the same pixels of other frames are looked at
 * frame    nframe <= GD_CROSSFIT_FRAMES other frames of the sequence; var, feature and count are
 *          there in all of them if they are here
 * y, whole, feature and var become means over the frames, in place, where there are any.
 */
struct gd_crossfit_in {
	bool self;
	int ny, nwhole, nfeat, nfeature;
	double share[2];
	struct gd_plane y[2][GD_APR_RHS], whole[GD_APR_RHS], var[3];
	struct gd_plane feat[GD_APR_FEATURES], feature[2][4];
	struct gd_plane count[2], position[3];
	int nframe;
	struct gd_crossfit_frame *frame;
};

/*
 * est      ny (nwhole) planes; not negative where no plane of y is (with 3 planes; more are left
 *          as they are, so that layers still add up to the colour)
 * mse      3 planes: estimated mean squared error of the colour, of the scale of 5x5 pixels
 * spread   v = NULL, or the standard deviation of the models about their mean, the root of the mean
 *          square of the three channels; 0 with one model
 * Must not overlap the input.
 */
struct gd_crossfit_out {
	struct gd_plane *est, *mse, spread;
};

struct gd_crossfit_result {
	int models;			/* regressions averaged, of either half */
	double gather_seconds;		/* fireflies, other frames */
	double pilot_seconds, fit_seconds;
	double gain;			/* 1 + a above: what the brightest pixels are times */
};

/*
 * Needs 40 bytes a pixel beside its input and output, and 8 for each plane beyond the third; with a
 * feature 8 more for each plane; while it makes a pilot, what gd_nlr_run() takes; with other frames
 * 8 more, and 80 while those are taken in.
 * Returns GD_OK, GD_EARG, GD_ESHAPE, GD_ENOMEM. The result does not depend on the number of
 * threads; with the halves swapped it is the same to rounding.
 */
int gd_crossfit_run(const struct gd_crossfit_out *out, struct gd_crossfit_in *in,
		    const struct gd_crossfit_conf *conf, struct gd_crossfit_result *result,
		    const struct gd_report *report, struct gd_err *err);

#endif
