/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Images from noisy differences of any pairs of pixels (Manzi et al. 2014, Eq. 8): poisson.h over
 * the edges of pairs.h instead of the neighbours right and below. For every channel f minimises
 *	sum over pairs w_e (f_j - f_i - v_e)^2  +  sum over pixels a_i (f_i - y_i)^2
 * with poisson.h's weights, floors and treatment of values that are no numbers; each pair counts
 * once. A pixel in no pair keeps its y.
 *
 * In the paper alpha is the row's weight in Eq. 8 and its square in Eq. 9; here the row's, as in
 * poisson.h.
 */
#ifndef GD_PAIRSOLVE_H
#define GD_PAIRSOLVE_H

#include "pairs.h"
#include "poisson.h"

/* All planes of the size of pairs. */
struct gd_pairsolve_in {
	int n;				/* channels, 1 .. 3 */
	const struct gd_pairs *pairs;
	struct gd_plane value[GD_PAIRS][3];	/* I(there) - I(here), read where there is a pair;
						   v = NULL: no pixel has so many pairs */
	struct gd_plane primal[3];
};

/*
 * conf->method: GD_L2 or GD_L1. result->parts: connected parts of the pairs with weight; dropped:
 * pairs without one. The rest is as gd_poisson_solve().
 */
int gd_pairsolve(const struct gd_plane *out, const struct gd_pairsolve_in *in,
		 const struct gd_poisson_conf *conf, struct gd_poisson_result *result,
		 const struct gd_report *report, struct gd_err *err);

#endif
