/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Stretches of pixels for the solver of pairsolve.c: the operator
 *	(A f)_i = sum_j w_ij (f_i - f_j) + a_i f_i
 * of a graph with up to GD_PAIR_LINKS edges at a pixel. Vectors hold four floats a pixel, one for
 * each channel (those beyond n are 0).
 */
#ifndef GD_PAIR_ROWS_H
#define GD_PAIR_ROWS_H

#include <stddef.h>

#include "isa.h"

#define GD_PAIR_LINKS 4

struct gd_pair_graph {
	const ptrdiff_t *jump;		/* from a pixel to the other end, by link */
	unsigned char *link;		/* 4 a pixel; 0: none, whose weight is 0 */
	float *weight;			/* 4 a pixel, the same seen from both ends */
	float *a, *invd;		/* 1 / (sum of the weights + a), 0 where that is 0 */
	float *value;			/* 4 x 4 a pixel: f there less f here */
	float *primal;
};

/* All for pixels from .. to - 1. x: doubles, four a pixel. */
struct gd_pair_kernels {
	void (*diagonal)(const struct gd_pair_graph *g, size_t from, size_t to);
	/* r = G'W (v - G x) + a (primal - x), in double; sum[c] = r . r / diagonal */
	void (*residual)(double *sum, float *r, const struct gd_pair_graph *g, const double *x,
			 size_t from, size_t to);
	/* Weights of the next l1 system: w, a become 1,
	 * alpha^2 over (the residual's norm + reg). */
	void (*reweight)(const struct gd_pair_graph *g, const double *x, double alpha, double reg,
			 size_t from, size_t to);
	/* p = r / diagonal + beta p */
	void (*direction)(float *p, const struct gd_pair_graph *g, const float *r,
			  const double *beta, size_t from, size_t to);
	/* q = A p; sum[c] = p . q */
	void (*apply)(double *sum, float *q, const struct gd_pair_graph *g, const float *p,
		      size_t from, size_t to);
	/* x += alpha p, r -= alpha q; sum[c] = r . r / diagonal */
	void (*step)(double *sum, double *x, float *r, const struct gd_pair_graph *g,
		     const float *p, const float *q, const double *alpha, size_t from, size_t to);
};

GD_KERNEL_TABLE(struct gd_pair_kernels, gd_pair);

#endif
