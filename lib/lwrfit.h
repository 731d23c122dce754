/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Cross-fitted linear predictions: the sparse models of lwr.h on the two independent halves of the
 * samples. The colour of either half is regressed on G-buffers and the feature of the OTHER half,
 * with the weights of crossfit.h taken from the other half, and the halves are averaged.
 */
#ifndef GD_LWRFIT_H
#define GD_LWRFIT_H

#include "crossfit.h"
#include "lwr.h"

/* Maps of what was chosen, averaged over the halves; each with v = NULL or of the image's size. */
struct gd_lwrfit_model {
	struct gd_plane radius, features, centre;
};

struct gd_lwrfit_result {
	size_t models;		/* of both halves */
	double mean_radius, fit_seconds;
	double gain;		/* as in struct gd_crossfit_result */
};

/*
 * in, out: as for gd_crossfit_run(), but for this: other frames are not looked at (temporal.h is
 * for what follows); at most 61 planes of whole; a feature has three planes or four, the first
 * three of which weigh the pixels, or it is left aside for the narrow pilot of either half.
 * out->spread is that of the predictions that cover a pixel, mean square over the halves.
 *
 * Needs 4 bytes a pixel for each plane estimated and each map of the model, 16, 12 for a pilot,
 * 12 with whole, and what gd_lwr_fit() takes. Returns GD_OK, GD_EARG, GD_ESHAPE, GD_ENOMEM. The
 * result does not depend on the number of threads; with the halves swapped it is the same to
 * rounding.
 */
int gd_lwrfit_run(const struct gd_crossfit_out *out, const struct gd_lwrfit_model *model,
		  struct gd_crossfit_in *in, const struct gd_lwr_conf *conf,
		  struct gd_lwrfit_result *result, const struct gd_report *report,
		  struct gd_err *err);

#endif
