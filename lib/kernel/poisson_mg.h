/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Row kernels of the multigrid solver, in float and in double (see multigrid.h for the method).
 * All planes of a level have the same padded layout: element (0,0) is where the pointer points,
 * stride elements between rows, at least two zeros right of each row, and a row of zeros above and
 * below, so that no kernel needs to know where the border is: what lies beyond has weight 0.
 *
 * Edges are conductances: e to (x+1,y), s to (x,y+1),
 * se to (x+1,y+1), sw to (x-1,y+1). The operator is
 *	(A z)_i = sum_j w_ij (z_i - z_j) + a_i z_i
 * and is always evaluated in differences, never as "diagonal times value minus sum": for smooth
 * z that would cancel. Level 0 has e and s only.
 */
#ifndef GD_POISSON_MG_H
#define GD_POISSON_MG_H

#include <stddef.h>

#include "isa.h"

struct gd_mg_level {
	int w, h;
	size_t stride;		/* elements from row to row */
	size_t plane;		/* elements from one right-hand side to the next */
	void *e, *s, *se, *sw;	/* edges; se, sw NULL on level 0 */
	void *a;		/* a_i, or NULL */
	void *invd;		/* 1 / (sum of the edges of i + a_i), 0 where that is 0 */
	void *px, *py; /* interpolation from this level to the finer one: see interpolate() */
	void *m00, *m10, *m01;
	void *z, *r;		/* correction and right-hand side, n planes each */
};

/* Cleaned rows of the input for one row y: dx, dy, dy
 * of row y - 1 (zeros for y = 0), primal (or NULL). */
struct gd_mg_rows {
	const float *dx[3], *dy[3], *up[3], *primal[3];
};

/* n: right-hand sides. fine and coarse: neighbouring levels. y: a row of the level written to. */
struct gd_mg_kernels {
	size_t size;		/* of an element */
	/* Set-up. */
	void (*diagonal)(const struct gd_mg_level *l, int y);
	void (*schur)(const struct gd_mg_level *l, int y);	/* after diagonal() of all rows */
	void (*interpolate)(const struct gd_mg_level *fine, const struct gd_mg_level *coarse,
			    int y);
	void (*galerkin)(const struct gd_mg_level *fine, const struct gd_mg_level *coarse, int y);
	void (*combine)(const struct gd_mg_level *coarse, int y);
	/* One right-hand-side plane: coarse = transposed interpolation of fine, added up. */
	void (*restrict_plane)(void *to, const void *from, const struct gd_mg_level *fine,
			       const struct gd_mg_level *coarse, int y);
	/* Level 0, red-black. */
	void (*start)(const struct gd_mg_level *l, int n, int y);
	void (*relax)(const struct gd_mg_level *l, int n, int y, int colour);
	void (*correct)(const struct gd_mg_level *l, int n, int y);
	void (*restrict_red)(const struct gd_mg_level *fine, const struct gd_mg_level *coarse,
			     int n, int y, void *work);
	void (*prolong_red)(const struct gd_mg_level *fine, const struct gd_mg_level *coarse, int n,
			    int y);
	/* Coarser levels, four colours. */
	void (*relax9)(const struct gd_mg_level *l, int n, int y, int first);
	void (*restrict_full)(const struct gd_mg_level *fine, const struct gd_mg_level *coarse,
			      int n, int y, void *work);
	void (*prolong)(const struct gd_mg_level *fine, const struct gd_mg_level *coarse, int n,
			int y);
	/* Conjugate gradients on level 0: p = z + beta p;
	 * z = A p, sum[c] = p . z; x += alpha p, r -= alpha z. */
	void (*dot)(double *sum, const void *u, const void *v, const struct gd_mg_level *l, int n,
		    int y);
	void (*direction)(void *p, const struct gd_mg_level *l, int n, const double *beta, int y);
	void (*apply)(double *sum, const void *p, const struct gd_mg_level *l, int n, int y);
	/* r = G'W (v - G x) + a (primal - x), flux by flux. */
	void (*residual)(const struct gd_mg_level *l, int n, const void *x,
			 const struct gd_mg_rows *rows, int y);
	/* Weights of the next l1 system: e, s, a = alpha^2
	 * or 1 over (norm of the row's residual + reg). */
	void (*reweight)(const struct gd_mg_level *l, int n, const void *x,
			 const struct gd_mg_rows *rows, double alpha, double reg, int y);
	void (*step)(void *x, const void *p, const struct gd_mg_level *l, int n,
		     const double *alpha, int y);
};

GD_KERNEL_TABLE(struct gd_mg_kernels, gd_mg_f32);
GD_KERNEL_TABLE(struct gd_mg_kernels, gd_mg_f64);

#endif
