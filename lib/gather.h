/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Windows that span the frames of a sequence. A pixel of another frame is found by the world
 * position it shows; it brings its own samples to the pixel of the frame to denoise, weighed by how
 * far both agree. As all frames' samples of a surface point then have the same regressors, those of
 * the frame to denoise, the moments of a window over all frames,
 *	sum_k sum_i w_k(i) z_i z_i',	sum_k sum_i w_k(i) z_i y_k(i),
 * are those of the weighted mean over the frames with weight sum_k w_k, and this is what is made
 * here: a regression in 3-D windows costs no more than one in the frame alone, and pilots, features
 * and error estimates gain from all frames, too.
 *
 * The weight: with u = log(1 + y / (0.3 level)), d and q the means over 7x7 pixels of the
 * difference of u between the frames and of its square, v the variance that the halves predict it,
 *	w = s / (s + max(0, d^2 - 2.5 v / 49, q - 2 v)),	s = variance of u in a pixel / 15,
 * summed over channels, smoothed over 3x3: what a pixel with a bias d weighs beside one without,
 * if 15 pixels' noise is averaged anyway. In the logarithm a firefly is one bright pixel of 49, and
 * a shadow is not hidden by it. w looks at either frame alike, so that it takes no side in their
 * noise.
 */
#ifndef GD_GATHER_H
#define GD_GATHER_H

#include "crossfit.h"

/*
 * Does this to in, of which y, whole, feature and var become means over the frames (var: of the
 * mean's noise), in place, and count the samples behind them: planes of `count`, which are to be
 * freed by gd_halves_free(count, 2). in->frame is read only, and not needed any more. Does nothing
 * without frames. Call gd_halves_check() and gd_halves_cut() before.
 * Needs 18 planes while it runs. Returns GD_OK, GD_ENOMEM; independent of the number of threads.
 */
int gd_gather(struct gd_crossfit_in *in, struct gd_plane count[2], const struct gd_report *report,
	      struct gd_err *err);

#endif
