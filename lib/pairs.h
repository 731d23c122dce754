/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Structure-adaptive gradients (Manzi et al. 2014, section 3.5): which pixels are compared. Instead
 * of the neighbours right and below, pixels of a 5x5 neighbourhood that look alike in the feature
 * buffers (Eq. 7). The affinity is symmetric, and so is the choice: edges are taken in the order of
 * falling affinity (ties: the nearer, then in scan order) as long as both ends have fewer than
 * GD_PAIRS, so that each pixel traces at most that many offset paths. Pixels that are hardly alike
 * are compared only where a part of the graph would else have fewer than 25, or a pixel fewer than
 * two edges.
 *
 * Differs from the paper, where each pixel names its own four, may be named by any number of
 * others, and draws among all of these at random. There are 2.2 to 2.3 edges for each
 * pixel then, and at most 2 here; at the same noise of each edge, the errors of l2
 * are within 10 % of each other.
 *
 * In a buffer: pairK.x pairK.y (K from 0) hold the offset of the K-th pixel that this pixel is
 * compared with, both 0 where there is none; an edge stands at the one of its two ends that comes
 * first in scan order (offsets with y > 0, or y = 0 and x > 0). pairK.R G B is I(there) - I(here),
 * pairK.variance.* the variance of that mean; bins hold binB.pairK.*.
 */
#ifndef GD_PAIRS_H
#define GD_PAIRS_H

#include <stdbool.h>

#include "gd.h"
#include "image.h"

#define GD_PAIRS 4	/* n of the paper */
#define GD_PAIR_REACH 2	/* 5x5 */
#define GD_PAIR_OFFSETS 12	/* half of the neighbourhood: every edge once */

/* x, y: the nearest first, those as near in scan order. */
extern const signed char gd_pair_offset[GD_PAIR_OFFSETS][2];

/* The layers that pairs are chosen by. */
#define GD_PAIR_FEATURES 3
extern const char *const gd_pair_features[GD_PAIR_FEATURES];

/* Edge k of pixel p goes to (x + dx[k][p], y + dy[k][p]); 0 0: no edge. Row stride: w. */
struct gd_pairs {
	int w, h;
	signed char *dx[GD_PAIRS], *dy[GD_PAIRS];
};

/* No edges at all. */
int gd_pairs_new(struct gd_pairs *pairs, int w, int h, struct gd_err *err);
void gd_pairs_free(struct gd_pairs *pairs);	/* takes { 0 } */

/* What a pixel looks like: of each feature (N, albedo, Z) the components in 0 .. 1, and the sum of
 * their variances. */
struct gd_look {
	float n[3], albedo[3], z;
	float noise[3];
};

/*
 * h x w looks, row after row, from those of albedo, N and Z that im has (an absent one is 0) and
 * their variances of the mean; free() them. N maps -1 .. 1 to 0 .. 1; albedo (all channels alike)
 * and Z their range without the least and the largest 0.1 %, and values beyond it are cut: one wild
 * value must not make all others equal. GD_ESHAPE if im has none of the three.
 */
int gd_pairs_looks(struct gd_look **looks, const struct gd_image *im, struct gd_err *err);

/*
 * Natural logarithm of Eq. 7: -infinity .. 0. The squared distance that noise alone would make is
 * subtracted. A pixel with NaN is like no other.
 */
float gd_pairs_affinity(const struct gd_look *a, const struct gd_look *b);

/* The choice among h x w looks. */
int gd_pairs_choose(struct gd_pairs *pairs, const struct gd_look *looks, int w, int h,
		    struct gd_err *err);

/* From pairK.x, pairK.y of im, checked (GD_EFORMAT: not whole, out of reach or of the image, not
 * in scan order, an edge twice, more than GD_PAIRS at a pixel); if it has none, from its albedo, N
 * and Z. GD_ESHAPE if it has neither. Independent of the number of threads. */
int gd_pairs_from_image(struct gd_pairs *pairs, const struct gd_image *im, struct gd_err *err);

/* Sets want = GD_READ for the channels gd_pairs_from_image() takes; false if there are none. */
bool gd_pairs_want(struct gd_image *im);

/* Number of layers pair0 pair1 ... whose x im has, whether read or not. */
int gd_pairs_layers(const struct gd_image *im);

#endif
