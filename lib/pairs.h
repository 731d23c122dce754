/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Structure-adaptive gradients (Manzi et al. 2014, section 3.5): which pixels are compared. Instead
 * of the neighbours right and below, pixels of a 5x5 neighbourhood that look alike in the feature
 * buffers (Eq. 7). The affinity is symmetric, and so is the choice: edges are taken in the order of
 * falling affinity (ties: the nearer, then in scan order) as long as both ends have fewer than
 * GD_PAIRS, so that each pixel traces at most that many offset paths.
 *
 * In a buffer: pairK.x pairK.y (K from 0) hold the offset of the K-th pixel that this pixel is
 * compared with, both 0 where there is none; an edge stands at the one of its two ends that comes
 * first in scan order (offsets with y > 0, or y = 0 and x > 0). pairK.R G B is I(there) - I(here),
 * pairK.variance.* the variance of that mean; bins hold binB.pairK.*.
 */
#ifndef GD_PAIRS_H
#define GD_PAIRS_H

#include "gd.h"
#include "image.h"

#define GD_PAIRS 4	/* n of the paper */
#define GD_PAIR_REACH 2	/* 5x5 */

/* Edge k of pixel p goes to (x + dx[k][p], y + dy[k][p]); 0 0: no edge. Row stride: w. */
struct gd_pairs {
	int w, h;
	signed char *dx[GD_PAIRS], *dy[GD_PAIRS];
};

/* From pairK.x, pairK.y of im, checked (GD_EFORMAT: not whole, out of reach or of the image, not
 * in scan order, an edge twice, more than GD_PAIRS at a pixel); if it has none, from its albedo, N
 * and Z. GD_ESHAPE if it has neither. */
int gd_pairs_from_image(struct gd_pairs *pairs, const struct gd_image *im, struct gd_err *err);
void gd_pairs_free(struct gd_pairs *pairs);

#endif
