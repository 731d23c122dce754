/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * The feature stage: an image made from the gradients, for the regression to lean on.
 *
 *	feature		from all bins, bagged (boot.h) or a single solve, then non-local means with
 *			the weights of either half, and the mean of the two
 *	half0.feature	from the even bins, filtered with weights from the odd ones
 *	half1.feature	the other way round
 *	half0.R ...	means of the even and odd bins of the colour
 * and the variances of all of these. The noise of half1.feature is independent of that of half0.R,
 * so a regression of the one on the other cannot fit noise to itself.
 *
 * Neighbours are other frames of a sequence, whose features (of which the drift has been taken out,
 * as far as it differs) are averaged with those of the image before they are filtered. Where all
 * frames tell world positions, pixels are averaged with those that show the same surface, weighted
 * by patches as in nlm.h; without these the windows of the filter itself span the frames.
 *
 * Which variance is told: that of the feature's detail. An image solved from gradients drifts, as
 * a random walk does, but the drift is common to a window, and a regression with a constant takes
 * it out.
 */
#ifndef GD_FEATURE_H
#define GD_FEATURE_H

#include <stdbool.h>

#include "boot.h"
#include "buffers.h"
#include "nlm.h"

#define GD_FEATURE_FRAMES 4	/* most neighbours */

enum gd_feature_solve { GD_FEATURE_WLS, GD_FEATURE_OLS, GD_FEATURE_NONE };

struct gd_feature_conf {
	enum gd_feature_solve solve;	/* ols: equal weights, no bagging; none: only the layers */
	bool bagging, filter;
	bool keep;			/* gradients, their variances and their bins stay */
	struct gd_boot_conf boot;
	struct gd_nlm_conf nlm;		/* of the feature */
	struct gd_nlm_conf nlm_frames;	/* of pixels in several frames: its window is 0 */
	struct gd_nlm_conf nlm_layers;	/* of the layers below */
	const char *layers;		/* noisy layers to prefilter, "albedo,N,Z", or NULL */
	struct gd_image *neighbour;	/* other frames, marked by ..._want_neighbour(); used up */
	int neighbours;			/* 0 .. GD_FEATURE_FRAMES */
};

/*
 * Of a solution for a regression 1e-3 is enough: at 1e-2 the denoised image is 1 % worse, below
 * 3e-3 nothing changes any more. A round window is as good as a square one, and a quarter smaller.
 */
#define GD_FEATURE_DEFAULTS ((struct gd_feature_conf){ \
	.solve = GD_FEATURE_WLS, .bagging = true, .filter = true, \
	.boot = { 10, 1, 0.1, 1.0, 1e-3, 1e-1, 2.0 }, \
	.nlm = { .patch = 3, .window = 5, .k = 0.5, .eps = 1e-6, .round = true }, \
	.nlm_frames = { .patch = 3, .window = 0, .k = 0.7, .eps = 1e-6 }, \
	.nlm_layers = { .patch = 3, .window = 5, .k = 0.85, .eps = 1e-6 } })

struct gd_feature_result {
	int bins;		/* of the gradients, 0: none */
	bool bagged, halves, filtered;
	int layers;		/* filtered layers */
	bool made_before;	/* the feature was in the image already */
	int frames, followed;	/* neighbours; those whose pixels were found by world position */
	int solved;		/* neighbours whose feature was not made before */
	double found;		/* share of the image's pixels found in these, 0 .. 1 */
	double solve_seconds, half_seconds, filter_seconds, layer_seconds;
	double frame_seconds;	/* of the neighbours: solving, following, averaging */
};

/*
 * Marks what gd_feature_run() reads and what it will not hand on, in an image of which only the
 * header is known. GD_ESHAPE names a channel that is missing. An image without gradients, but with
 * the feature and its variances, is one whose feature waits to be filtered.
 */
int gd_feature_want(struct gd_image *im, const struct gd_feature_conf *conf, struct gd_err *err);

/*
 * The same for a neighbour of im; everything else is dropped. If it has features with variances
 * these are taken, else they are made as those of im are. GD_ESHAPE, too, for another size.
 */
int gd_feature_want_neighbour(struct gd_image *neighbour, const struct gd_image *im,
			      const struct gd_feature_conf *conf, struct gd_err *err);

/*
 * Adds the channels above to im and frees those that no later stage needs. Without bins: one solve
 * from means and variances (equal weights where these are missing, too), no halves. All outputs are
 * finite. result and report may be NULL. Returns GD_OK, GD_EARG, GD_ESHAPE or GD_ENOMEM.
 */
int gd_feature_run(struct gd_image *im, const struct gd_feature_conf *conf,
		   struct gd_feature_result *result, const struct gd_report *report,
		   struct gd_err *err);

/*
 * The part of the above that deals with conf->layers, a comma-separated list or NULL: each layer is
 * replaced by itself filtered; with the weights of its halves, if the image has half0.<layer> and
 * half1.<layer>, which are filtered, too. Layers without noise stay; *filtered counts the others.
 */
int gd_feature_layers_want(struct gd_image *im, const char *layers, struct gd_err *err);
int gd_feature_layers_run(struct gd_image *im, const struct gd_feature_conf *conf, int *filtered,
			  const struct gd_report *report, struct gd_err *err);

#endif
