/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * The pilot: a guess of the image from one half of the samples alone, by regression with patch
 * weights (nlr.h), for the other half to be regressed on and weighed by (crossfit.h, lwrfit.h).
 */
#ifndef GD_PILOT_H
#define GD_PILOT_H

#include "crossfit.h"
#include "nlr.h"

#define GD_PILOT_FEATURES 7	/* albedo, normal, depth: more cost time, and gained nothing */

/* Windows of 7x7 and patches of 3x3; of 13x13 and 5x5. */
#define GD_PILOT_NARROW	{ .window = 3, .patch = 1, .k = 0.8, .eps = 1e-6, .ridge = 1e-3 }
#define GD_PILOT_WIDE	{ .window = 6, .patch = 2, .k = 0.5, .eps = 1e-6, .ridge = 1e-3 }

/* What a pilot leans on: n places in in->feat, as gd_halves_scale() names them. */
struct gd_pilot_features {
	int n, at[GD_PILOT_FEATURES];
};

/*
 * Makes the pilot of a half, three planes, from in->y[half]. Work space: var (three planes) and
 * spare, of the size of the image. Returns what gd_nlr_run() does.
 */
int gd_pilot_make(const struct gd_plane pilot[3], const struct gd_crossfit_in *in, int half,
		  const struct gd_pilot_features *features, const struct gd_nlr_conf *conf,
		  struct gd_plane var[3], struct gd_plane spare, struct gd_err *err);

#endif
