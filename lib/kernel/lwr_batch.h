/* SPDX-License-Identifier: BSD-3-Clause */
/* A batch of centres, one per lane, between the kernel files of one instruction set. */
#ifndef GD_LWR_BATCH_H
#define GD_LWR_BATCH_H

#include "lwr_impl.h"

#define GD_LWR_SHARE 0.5	/* of a window's pixels: the most columns of its model */

/* Per-lane arrays first; then one vector per number, matrices as lower triangles by rows. */
struct gd_lwr_batch {
	int n;				/* lanes in use */
	int x[GD_LWR_LANES], y[GD_LWR_LANES];
	int radius[GD_LWR_LANES], features[GD_LWR_LANES];	/* of the best; columns in use */
	int done[GD_LWR_LANES];		/* this window grows no more */
	double pixels[GD_LWR_LANES];
	double *z;			/* pixels of a ring */
	double *m[GD_LWR_LANES], *sums[GD_LWR_LANES], *ref[GD_LWR_LANES];
	gd_lwr_vec *first;		/* columns of the 9 pixels of the first window */
	gd_lwr_vec *ra, *rc, *rs;	/* ring: z z', z (y, twin), sums */
	gd_lwr_vec *a, *c, *s;		/* window */
	gd_lwr_vec *l, *inv, *b;	/* factor, model: b[j * nc + c] */
	gd_lwr_vec *acc, *xi, *scale;	/* nc: error so far; of the best; weight in the choice */
	gd_lwr_vec *best, *best_l, *best_inv;
	gd_lwr_vec *other, *other_b;	/* of the planes beyond the colour */
	gd_lwr_vec least, used;
	double *model;			/* one lane's: ny * p, then nc */
};

#define gd_lwr_fit_batch GD_KERNEL(gd_lwr_fit_batch)
#define gd_lwr_fit_others GD_KERNEL(gd_lwr_fit_others)
void gd_lwr_fit_batch(const struct gd_lwr_plan *p, struct gd_lwr_batch *t);
void gd_lwr_fit_others(const struct gd_lwr_plan *p, struct gd_lwr_batch *t);

#endif
