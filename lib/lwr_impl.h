/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * What lib/lwr*.c and their kernels share; nobody else includes it.
 *
 * A window's model has p columns, [1 | u v | features], in the order in which they are offered to
 * the fit; u and v are in pixels here. After them come the colour and, if there is one, its twin:
 * q columns, whose sums of products over a set of pixels hold all that fits and errors need.
 */
#ifndef GD_LWR_IMPL_H
#define GD_LWR_IMPL_H

#include <stdint.h>

#include "isa.h"
#include "lwr.h"

#define GD_LWR_TILE	64	/* pixels; > 2 * GD_LWR_RADIUS: tiles a tile apart never touch */
#define GD_LWR_COLUMNS	(3 + GD_LWR_FEATURES)
#define GD_LWR_LIMIT	1e35f	/* predictions are cut to that: sums of them stay finite */

struct gd_lwr_plan {
	int w, h, radius, radius_min;
	int nf, nc, ny;			/* features, colour planes, planes */
	int p, q;			/* model columns; with colour and twin */
	bool twin, paper;
	const struct gd_plane *y;	/* ny */
	struct gd_plane feat[GD_LWR_FEATURES];	/* nf */
	/*
	 * Pixels, `pitch` floats each: features, colour, twin; then what is only summed: var of the
	 * colour (nvar = nc or 0) and the variances of the features noisy[] (nfv); and at `root`,
	 * where that is above 0, the root of the weight.
	 */
	float *block, *pixel;		/* what is allocated; the first pixel */
	size_t pitch;
	int root;
	int nvar, nfv;
	int noisy[GD_LWR_FEATURES];
	double noise;			/* feature_noise */
	double floor[GD_LWR_FEATURES];	/* mean square below which a feature's spread is rounding */
	double range[GD_LWR_FEATURES];	/* percentiles 0.5 to 99.5 over the image */
	double flat[GD_LWR_FEATURES];	/* flat, times the square of the feature's range */
	double ridge;
	double level2;			/* added to squared means where channels are weighed; > 0 */
	const struct gd_plane *est, *mse, *spread;	/* mse, spread: NULL: not wanted */
	/*
	 * Sums over the models that cover a pixel; `sums` floats a pixel, in fours: estimates by
	 * threes, the first with the number of models; from at_error on (0: not wanted) errors and
	 * radius; from at_spread on squared estimates and features.
	 */
	float *sum;
	size_t sums, at_error, at_spread;
	struct gd_plane out_radius, out_features, out_centre;	/* v = NULL: not wanted */
	unsigned char *mark;		/* w * h: a centre of this pass */
	int nx, nrow, *cx, *cy;		/* the grid of this pass */
};

/* Of one tile in one pass. */
struct gd_lwr_count {
	long models, radii;
};

struct gd_lwr_kernels {
	size_t (*size)(const struct gd_lwr_plan *plan);	/* doubles of work space per thread */
	/* Fits and predicts the marked centres in x0 <= x < x1, y0 <= y < y1. */
	void (*tile)(const struct gd_lwr_plan *plan, int x0, int y0, int x1, int y1, double *work,
		     struct gd_lwr_count *count);
};

GD_KERNEL_TABLE(struct gd_lwr_kernels, gd_lwr_kernels);

/* Numbers of the image as a whole (lwr_prep.c). */
void gd_lwr_features(struct gd_lwr_plan *plan, const struct gd_lwr_in *in,
		     const struct gd_lwr_conf *conf, const struct gd_report *report, int *kept);
double gd_lwr_level(const struct gd_plane *y, int n);
/* n pixels of an axis in parts of at most `step`: the middles, symmetric; returns their number. */
int gd_lwr_grid(int *centre, int n, int step);
int gd_lwr_pack(struct gd_lwr_plan *plan, const struct gd_lwr_in *in, const int *kept);

/* Vectors of doubles as wide as the registers. */
#if defined(__AVX512F__)
#define GD_LWR_LANES 8
#elif defined(__AVX__)
#define GD_LWR_LANES 4
#else
#define GD_LWR_LANES 2
#endif
typedef double gd_lwr_vec __attribute__((vector_size(8 * GD_LWR_LANES)));
typedef double gd_lwr_any __attribute__((vector_size(8 * GD_LWR_LANES), aligned(8), may_alias));
typedef float gd_lwr_float __attribute__((vector_size(4 * GD_LWR_LANES), aligned(4), may_alias));

typedef int64_t gd_lwr_mask __attribute__((vector_size(8 * GD_LWR_LANES)));

#define GD_LWR_INLINE static inline __attribute__((always_inline))

GD_LWR_INLINE gd_lwr_vec gd_lwr_splat(double x)
{
	return x - (gd_lwr_vec){ 0 };
}

GD_LWR_INLINE gd_lwr_vec gd_lwr_pick(gd_lwr_mask m, gd_lwr_vec a, gd_lwr_vec b)
{
	return (gd_lwr_vec)(((gd_lwr_mask)a & m) | ((gd_lwr_mask)b & ~m));
}

GD_LWR_INLINE gd_lwr_vec gd_lwr_larger(gd_lwr_vec a, gd_lwr_vec b)
{
	return gd_lwr_pick(a > b, a, b);
}

/* Sums over one ring of one window: m[i * mpitch + j] = sum z_i z_j, i < p, j >= i. */
struct gd_lwr_ring {
	int n;			/* pixels */
	double *z;		/* n rows of gd_lwr_pitch(): columns times root of the weight */
	double *m;
	double *s;		/* nc: sum of y^2, or y twin; nvar; nfv */
};

#define gd_lwr_pitch GD_KERNEL(gd_lwr_pitch)
#define gd_lwr_reference GD_KERNEL(gd_lwr_reference)
#define gd_lwr_ring_sums GD_KERNEL(gd_lwr_ring_sums)
#define gd_lwr_ring_pixel GD_KERNEL(gd_lwr_ring_pixel)
#define gd_lwr_ring_pixels GD_KERNEL(gd_lwr_ring_pixels)
#define gd_lwr_predict GD_KERNEL(gd_lwr_predict)
int gd_lwr_pitch(int columns);
/*
 * What is subtracted from the columns: 0 for the first three, for others the median of 3x3 pixels,
 * or, as published, the centre.
 */
void gd_lwr_reference(const struct gd_lwr_plan *plan, int x, int y, double *ref);
/* The pixels at distance r (r = 1: at most 1) of (x,y). */
void gd_lwr_ring_pixels(const struct gd_lwr_plan *plan, int x, int y, int r, const double *ref,
			struct gd_lwr_ring *ring);
/* The columns of one pixel (px,py). */
void gd_lwr_ring_pixel(const struct gd_lwr_plan *plan, int px, int py, int x, int y,
		       const double *ref, double *z);
void gd_lwr_ring_sums(const struct gd_lwr_plan *plan, struct gd_lwr_ring *ring);

/* A fitted model. */
struct gd_lwr_model {
	int x, y, radius, features;
	const double *ref;	/* q */
	const double *b;	/* ny * p */
	const double *xi;	/* nc */
};

void gd_lwr_predict(const struct gd_lwr_plan *plan, const struct gd_lwr_model *m);

#endif
