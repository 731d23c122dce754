/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Between nlr.c and its kernels: one tile of centres with the pixels around them. Rows of all
 * planes of a kind lie one after the other (row 0 of each plane, then row 1 of each ...),
 * GD_NLR_PITCH floats apart, so that one pointer and constant distances reach them all; pointers
 * are those of plane 0 at the tile's first pixel. What lies outside the image is 0.
 */
#ifndef GD_NLR_TILE_H
#define GD_NLR_TILE_H

#include "isa.h"
#include "nlr.h"

#define GD_NLR_TILE_W	128
#define GD_NLR_TILE_ROWS	32
#define GD_NLR_PAD	16	/* to either side: >= window + patch, >= the widest vector */
#define GD_NLR_PITCH	(GD_NLR_TILE_W + 2 * GD_NLR_PAD)
#define GD_NLR_WPAD	24	/* >= window + the widest vector */
#define GD_NLR_WPITCH	(GD_NLR_TILE_W + 2 * GD_NLR_WPAD)
#define GD_NLR_TERMS	(GD_NLR_FEATURES + 1)	/* of a model: constant, features */

#define GD_NLR_FAR	1e4f	/* where a pixel's distance is cut */
#define GD_NLR_FAR_OUT	9.21034f	/* mean distances beyond have weight 0 instead of 1e-4 */

struct gd_nlr_tile {
	int w, h;		/* centres; w <= GD_NLR_TILE_W */
	int left, right, top, bottom;	/* the image is left <= x < right, top <= y < bottom */
	int window, patch;
	int terms, ncol;	/* 1 + features; columns: terms, 3 of y, and the weight if any */
	float noise;		/* e / k^2, above 0 */
	float far;		/* 1e4 k^2 */
	float scale;		/* 1 / k^2 */
	float ridge;
	const float *guide;	/* 6 planes: guide, variances; window + patch more rows around */
	const float *col;	/* ncol planes: 1, features, y, weight; window more rows around */
	float *weight;		/* of shift s = (dy + window) * side + dx + window: s * WPITCH */
	float *fit;		/* times the fit weight; the same as weight if there is none */
	float *ring;		/* for each shift 2 patch + 1 rows of sums of distances */
	float *share;		/* for each dx: scale / columns of the patch that count / 2 */
	float *slope;		/* coefficient j of plane c: (c * terms + j) * WPITCH */
	float *sum;		/* 4 planes: predictions, weights; window more rows around */
};

struct gd_nlr_kernel {
	/* to = scale * scale * from, cut to lo .. hi; what is not finite becomes 0, unless lo is 0:
	 * then infinity becomes hi. */
	void (*load)(float *to, const float *from, int n, float scale, float lo, float hi);
	/* Fills sum. */
	void (*tile)(const struct gd_nlr_tile *t);
	/* n pixels of a plane: out = sum / total * scale * scale, y where the total is 0 */
	void (*finish)(float *out, const float *sum, const float *total, const float *y, int n,
		       float scale);
};

GD_KERNEL_TABLE(struct gd_nlr_kernel, gd_nlr_kernel);

/* Between the kernel files of one instruction set. */
#define gd_nlr_weights GD_KERNEL(gd_nlr_weights)
#define gd_nlr_fit_row GD_KERNEL(gd_nlr_fit_row)
#define gd_nlr_predict_row GD_KERNEL(gd_nlr_predict_row)
/* Takes in guide row y; from the patch'th on also fills weight and fit for centre row y - patch. */
void gd_nlr_weights(const struct gd_nlr_tile *t, int y);
/* Fills slope for centre row y; a centre that cannot be fitted loses its weights. */
void gd_nlr_fit_row(const struct gd_nlr_tile *t, int y);
/* Adds the predictions of centre row y to sum. */
void gd_nlr_predict_row(const struct gd_nlr_tile *t, int y);

/* Vectors of floats as wide as the registers, aligned as any float is. */
#if defined(__AVX512F__)
#define GD_NLR_LANES 16
#elif defined(__AVX__)
#define GD_NLR_LANES 8
#else
#define GD_NLR_LANES 4
#endif
typedef float gd_nlr_vec __attribute__((vector_size(4 * GD_NLR_LANES)));
typedef float gd_nlr_any __attribute__((vector_size(4 * GD_NLR_LANES), aligned(4), may_alias));

#define GD_NLR_INLINE static inline __attribute__((always_inline))

GD_NLR_INLINE gd_nlr_vec gd_nlr_load(const float *p)
{
	return *(const gd_nlr_any *)p;
}

GD_NLR_INLINE void gd_nlr_store(float *p, gd_nlr_vec v)
{
	*(gd_nlr_any *)p = v;
}

#endif
