/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Conjugate gradients with a multigrid preconditioner for the weighted five-point operator
 *	(A f)_i = sum_j w_ij (f_i - f_j) + a_i f_i,	w_ij >= 0, a_i >= 0
 * for up to three right-hand sides at once. Semi-definite A (no a, several parts) is
 * welcome as long as the right-hand side sums to 0 over each part; the constants of
 * the parts are then arbitrary.
 *
 * The preconditioner is one V(1,1)-cycle: Gauss-Seidel in four colours, on the finest grid black -
 * red - black with the red diagonal of the Schur complement (an incomplete factorisation, really),
 * coarsening by 2 with interpolation that follows the weights (J. Dendy, Black box multigrid, 1982)
 * and Galerkin coarse operators, kept as edges: a coarse edge is the sum of the energies of the
 * fine ones, so jumps of the weights by any factor do no harm to the operator itself. The coarsest
 * grid, 64 points or fewer, is solved directly.
 *
 * Use: gd_mg_new(); fill e, s (and a) of grid(mg); gd_mg_setup(); fill r and x; gd_mg_solve(); and
 * again from any of these steps. Elements are float, or double if wide. Rows y of plane c start at
 * (element *)v + c * plane + y * stride; only w of each row may be written.
 */
#ifndef GD_MULTIGRID_H
#define GD_MULTIGRID_H

#include <stdbool.h>

#include "gd.h"
#include "kernel/poisson_mg.h"

struct gd_mg;

struct gd_mg_result {
	int iterations;
	double residual;	/* sqrt(r'Mr) over that of the start, worst right-hand side */
};

/* n right-hand sides of w x h; screened: there will be an a. */
int gd_mg_new(struct gd_mg **mg, int w, int h, int n, bool wide, bool screened, struct gd_err *err);
void gd_mg_free(struct gd_mg *mg);		/* takes NULL */

/* The finest level: e, s, a to be filled by the caller (last column of e and last row
 * of s with 0), r = the residual to start from. z is free for the caller between calls,
 * and so is gd_mg_spare(). */
const struct gd_mg_level *gd_mg_grid(const struct gd_mg *mg);
void *gd_mg_x(const struct gd_mg *mg);		/* n planes: the solution */
void *gd_mg_spare(const struct gd_mg *mg);	/* n planes */

/* Builds the coarse grids from e, s and a. */
void gd_mg_setup(struct gd_mg *mg);

/*
 * Adds the solution of A x = r to x; r is used up. Stops when
 * sqrt(r'Mr) (the error in the energy norm, nearly) has fallen by
 * tolerance for every right-hand side, or when rounding does not let it.
 */
struct gd_mg_result gd_mg_solve(struct gd_mg *mg, double tolerance, int max_iterations);

/* The same from a residual computed afresh after gd_mg_solve(), relative
 * to the start of that call: what rounding had kept it from. */
struct gd_mg_result gd_mg_resume(struct gd_mg *mg, double tolerance, int max_iterations);

/* z = M r: one V-cycle, for tests and measurements. */
void gd_mg_cycle(struct gd_mg *mg);

#endif
