/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Images from noisy gradients. For every channel the image f minimises
 *	sum over edges w_e (f_j - f_i - v_e)^2  +  sum over pixels a_i (f_i - y_i)^2
 * with edges to the right (v = dx) and downwards (v = dy), and the primal image y.
 *
 *	method	w_e			a_i
 *	ols	1			0
 *	wls	1 / (var_e + phi)	0		Back, Yoon, Moon 2018, eq. 8
 *	l2	1			alpha^2		screened least squares
 *	l1	reweighted		alpha^2 x reweighted	sum of unsquared residual norms
 *
 * The channels share one operator: var_e is the mean of the channels' variances, and the
 * l1 residual is the norm over the channels. ols and wls leave a constant free; it is
 * set so that the mean of f equals that of y, per connected part of the edges (by 0
 * where there is no primal image).
 *
 * phi = floor x median of var_e (and var_e is smoothed by a Gaussian first, see conf.smooth_px): a
 * variance estimated from a few bins has an error of 50 % and is often exactly 0 by chance, so it
 * must not decide alone. An edge over 1e12 phi says nothing and weighs 0.
 * A non-finite gradient weighs 0; a non-finite or missing variance counts as the
 * largest; a non-finite primal pixel is replaced by the median of its finite neighbours
 * and weighs 1e-4 of the others.
 */
#ifndef GD_POISSON_H
#define GD_POISSON_H

#include <stdbool.h>

#include "gd.h"
#include "plane.h"

enum gd_poisson_method { GD_OLS, GD_WLS, GD_L2, GD_L1 };

struct gd_poisson_conf {
	enum gd_poisson_method method;
	double alpha;		/* weight of the primal image's rows in l2 and l1, 1e-3 .. 1e3 */
	double tolerance; /* relative residual to reach, in the norm of the preconditioner; 1e-12
			     .. 1. At 1e-4 */
			  /* renders differ from the exact solution by a relMSE of 1e-8 to 1e-6 */
	double floor;		/* phi over the median variance, 1e-6 .. 1e6 */
	double smooth_px;	/* standard deviation of the blur of var_e; 0 (none) .. 8 */
	int max_iterations;	/* of conjugate gradients, per linear system */
	int reweight;		/* linear systems solved for l1 */
};
#define GD_POISSON_DEFAULTS { GD_L1, 0.2, 1e-4, 0.1, 1.0, 1000, 20 }

/* All planes w x h, radiance or its square. dx's last column and dy's last row are never read. */
struct gd_poisson_in {
	int n;			/* channels, 1 .. 3 */
	struct gd_plane dx[3], dy[3];
	struct gd_plane primal[3];		/* v = NULL: none (l2 and l1 need it) */
	struct gd_plane dxvar[3], dyvar[3]; /* of the mean; wls needs them, v = NULL otherwise */
};

struct gd_poisson_result {
	int iterations;		/* of conjugate gradients, all systems together */
	double residual;	/* relative residual reached by the last system, worst channel */
	bool converged;		/* it is at most the tolerance */
	int parts;		/* connected parts of the edges with weight (ols and wls) */
	size_t dropped;		/* edges of weight 0 */
	double phi;		/* floor of wls, radiance squared */
	bool wide;		/* solved in double, since the weights span too much for float */
};

/*
 * out: in->n planes of w x h; must not overlap the inputs. Always finite.
 * result may be NULL. Returns GD_OK, GD_EARG, GD_ESHAPE, GD_ENOMEM. Not reaching the tolerance is
 * GD_OK. Independent of the number of threads; n threads of OpenMP work inside.
 */
int gd_poisson_solve(const struct gd_plane *out, const struct gd_poisson_in *in,
		     const struct gd_poisson_conf *conf, struct gd_poisson_result *result,
		     const struct gd_report *report, struct gd_err *err);

#endif
