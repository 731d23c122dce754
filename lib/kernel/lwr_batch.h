/* SPDX-License-Identifier: BSD-3-Clause */
/* A batch of centres, one per lane, between the kernel files of one instruction set. */
#ifndef GD_LWR_BATCH_H
#define GD_LWR_BATCH_H

#include "lwr_impl.h"

#define GD_LWR_SHARE 0.5	/* of a window's pixels: the most columns of its model */

/* Per-lane arrays first; then one vector per number. */
struct gd_lwr_batch {
	int n;				/* lanes in use */
	int x[GD_LWR_LANES], y[GD_LWR_LANES];
	int done[GD_LWR_LANES];		/* this window grows no more */
	double *z;			/* pixels of a ring */
	double *m[GD_LWR_LANES], *sums[GD_LWR_LANES], *ref[GD_LWR_LANES];
	gd_lwr_vec *first;		/* columns of the 9 pixels of the first window */
	gd_lwr_vec *ring, *rs;		/* ring: [i * q + j] = sum z_i z_j, j >= i; plain sums */
	gd_lwr_vec *a, *s;		/* window */
	gd_lwr_vec *l, *inv;		/* [i * (p + nc) + j] = L_ji; L_j = L^-1 c, j >= p */
	gd_lwr_vec *b;			/* model: [j * nc + c] */
	gd_lwr_vec *acc, *xi, *scale;	/* nc: error so far; of the best; weight in the choice */
	gd_lwr_vec *best, *best_l, *best_inv;
	gd_lwr_vec *other, *other_b;	/* of the planes beyond the colour */
	gd_lwr_vec least, radius, features;	/* of the best: error, its features in use */
	gd_lwr_vec pixels, used, helping;	/* columns in use, the features among them */
	double *rings, *start;	/* as published: moments and sums of each ring; 9 pixels */
	double *model;			/* one lane's: ny * p, then nc */
};

/* Doubles of a ring's moments and sums, in whole vectors. */
static inline size_t gd_lwr_ring_size(const struct gd_lwr_plan *p)
{
	return (size_t)(p->p * gd_lwr_pitch(p->q) + gd_lwr_pitch(p->nc + p->nvar + p->nfv));
}

#define gd_lwr_fit_batch GD_KERNEL(gd_lwr_fit_batch)
#define gd_lwr_other_sums GD_KERNEL(gd_lwr_other_sums)
#define gd_lwr_fit_paper GD_KERNEL(gd_lwr_fit_paper)
#define gd_lwr_fit_others GD_KERNEL(gd_lwr_fit_others)
void gd_lwr_fit_batch(const struct gd_lwr_plan *p, struct gd_lwr_batch *t);
/* As published: the planes beyond the colour, too. */
void gd_lwr_fit_paper(const struct gd_lwr_plan *p, struct gd_lwr_batch *t);
/* Sums of the columns with the planes beyond the colour, over the window of lane l's model. */
void gd_lwr_other_sums(const struct gd_lwr_plan *p, struct gd_lwr_batch *t, int l);
void gd_lwr_fit_others(const struct gd_lwr_plan *p, struct gd_lwr_batch *t);

#endif
