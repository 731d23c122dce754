/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * What lib/apr.c and its kernels share; nobody else includes it.
 *
 * A window's model has p columns: [1 | features | u v | u^2 v^2 | ...]. Sums are taken first down
 * the pixel columns of a centre row, of the pv "vertical" columns [1 | features | v v^2 ...]; the
 * powers of u come in with the kernel of the pass along the row, because
 *	sum_{u,v} K(u)K(v) u^k g = sum_u K(u) u^k ( sum_v K(v) g ).
 */
#ifndef GD_APR_IMPL_H
#define GD_APR_IMPL_H

#include "apr.h"
#include "isa.h"

#define GD_APR_POWERS (2 * GD_APR_ORDER + 1)
#define GD_APR_PAD 16	/* zeros on each side of a kernel table, >= two of the widest vectors */
#define GD_APR_TAPS (2 * (GD_APR_RADIUS + GD_APR_PAD) + 1)

struct gd_apr_plan {
	int w, h;
	int radius, order_min, order;	/* order: the largest */
	int nf, ny, nv, nfv;	/* features; planes y, those with variance; noisy features */
	int pv, p;			/* vertical columns; all columns */
	const struct gd_plane *y, *var;	/* ny, nv */
	struct gd_plane weight;		/* v = NULL: 1 everywhere */
	struct gd_plane feat[GD_APR_FEATURES];		/* nf */
	struct gd_plane feat_var[GD_APR_FEATURES];	/* nfv, of the features noisy[] */
	int noisy[GD_APR_FEATURES];
	double ref[GD_APR_FEATURES];	/* subtracted from a feature: its median */
	double floor[GD_APR_FEATURES];	/* mean square below which a feature's spread is rounding */
	double ridge;			/* as in struct gd_apr_conf */
	double flat[GD_APR_FEATURES];	/* the same, times the square of the feature's range */
	double noise;			/* feature_noise */
	double correlation;
	double level2;		/* added to a squared mean where channels are weighed; > 0 */
	int nx, nrow;			/* centres along x and y */
	const int *cx, *cy;
	/* Kernel times power: k1[q][PAD + R + u] = K(u) (u/R)^q, k2: K(u)^2; 0 where |u| > R. */
	double k1[GD_APR_POWERS][GD_APR_TAPS];
	double k2[GD_APR_POWERS][GD_APR_TAPS];
	double *sumx, *sumy;		/* w, h: sum over centres of K */
	/*
	 * Fitted models, nmodel rows of nx numbers per centre row. Row c*p + i: coefficient i of
	 * right-hand side c; then nv estimated errors, the order, the number of columns.
	 */
	int nmodel;
	double *model;
};

static inline double *gd_apr_model(const struct gd_apr_plan *plan, int row, int m)
{
	return plan->model + ((size_t)row * plan->nmodel + m) * (size_t)plan->nx;
}

/* Sums of a batch of windows, one per lane: number e of window l at [e * lanes + l]. */
struct gd_apr_batch {
	int n;			/* windows in it */
	int at[GD_APR_PAD];	/* their places in the row of centres */
	double *a;		/* sum K z z', lower triangle row by row: p(p+1)/2 */
	double *b;		/* sum K z_i y_c: p * ny, c fastest */
	double *m;		/* sum K^2 var_c z z': nv * p(p+1)/2 */
	double *s;		/* sum K y_c^2: nv; sum K var_c: nv; sum K feat_var: nfv */
	double *work;		/* gd_apr_solve_size() */
};

struct gd_apr_kernels {
	int lanes;
	/* Doubles of work space per thread, to fit a centre row and to predict a pixel row. */
	size_t (*fit_size)(const struct gd_apr_plan *plan);
	void (*fit_row)(const struct gd_apr_plan *plan, int row, double *work);
	size_t (*predict_size)(const struct gd_apr_plan *plan);
	void (*predict_row)(const struct gd_apr_plan *plan, const struct gd_apr_out *out, int y,
			    double *work);
};

GD_KERNEL_TABLE(struct gd_apr_kernels, gd_apr_kernels);

/* Between kernel files of one instruction set. */
#define gd_apr_solve GD_KERNEL(gd_apr_solve)
#define gd_apr_solve_size GD_KERNEL(gd_apr_solve_size)
#define gd_apr_predict_row GD_KERNEL(gd_apr_predict_row)
#define gd_apr_predict_size GD_KERNEL(gd_apr_predict_size)
size_t gd_apr_solve_size(const struct gd_apr_plan *plan);
void gd_apr_solve(const struct gd_apr_plan *plan, int row, struct gd_apr_batch *batch);
size_t gd_apr_predict_size(const struct gd_apr_plan *plan);
void gd_apr_predict_row(const struct gd_apr_plan *plan, const struct gd_apr_out *out, int y,
			double *work);

/* Vectors of doubles as wide as the registers; everything is laid out in multiples of them. */
#if defined(__AVX512F__)
#define GD_LANES 8
#elif defined(__AVX__)
#define GD_LANES 4
#else
#define GD_LANES 2
#endif
typedef double gd_vec __attribute__((vector_size(8 * GD_LANES)));
typedef double gd_vec_any __attribute__((vector_size(8 * GD_LANES), aligned(8)));

#endif
