/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Collaborative prediction: pixel i gets from the centres c of one row
 *	sum_c w_c(i) b_c' z_i = z_i' sum_c w_c(i) b_c,
 * so the weighted coefficients are summed along the row first, in registers, with a vector of
 * neighbouring pixels i, and multiplied by the features of i once.
 */
#include "kernel/nlr_tile.h"

#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <string.h>

typedef gd_nlr_vec vec;

#define PITCH GD_NLR_PITCH
#define MOST 12				/* coefficients at a time */

/* What the pixels at z get: w and b belong to the centre furthest to the right. */
GD_NLR_INLINE void gather(float *sum, float *total, const float *z, const float *w, const float *b,
			  int side, const int n)
{
	vec s[MOST], all = { 0 }, out = gd_nlr_load(sum);

	for (int k = 0; k < n; k++)
		s[k] = (vec){ 0 };
	for (int i = 0; i < side; i++, w += GD_NLR_WPITCH - 1, b--) {
		vec v = gd_nlr_load(w);

		if (total)
			all += v;
		for (int k = 0; k < n; k++)
			s[k] += v * gd_nlr_load(b + k * GD_NLR_WPITCH);
	}
	for (int k = 0; k < n; k++)
		out += s[k] * gd_nlr_load(z + k * PITCH);
	gd_nlr_store(sum, out);
	if (total)
		gd_nlr_store(total, gd_nlr_load(total) + all);
}

GD_NLR_INLINE void gather_n(float *sum, float *total, const float *z, const float *w,
			    const float *b, int side, int n)
{
	switch (n) {
	case 1: gather(sum, total, z, w, b, side, 1); break;
	case 2: gather(sum, total, z, w, b, side, 2); break;
	case 3: gather(sum, total, z, w, b, side, 3); break;
	case 4: gather(sum, total, z, w, b, side, 4); break;
	case 5: gather(sum, total, z, w, b, side, 5); break;
	case 6: gather(sum, total, z, w, b, side, 6); break;
	case 7: gather(sum, total, z, w, b, side, 7); break;
	case 8: gather(sum, total, z, w, b, side, 8); break;
	case 9: gather(sum, total, z, w, b, side, 9); break;
	case 10: gather(sum, total, z, w, b, side, 10); break;
	case 11: gather(sum, total, z, w, b, side, 11); break;
	default: gather(sum, total, z, w, b, side, 12); break;
	}
}

/* Adds to the pixels of row y + dy. */
static void predict(const struct gd_nlr_tile *t, int y, int dy)
{
	const int side = 2 * t->window + 1;
	const int reach = (t->window + GD_NLR_LANES - 1) / GD_NLR_LANES * GD_NLR_LANES;
	const int parts = (t->terms + MOST - 1) / MOST;
	const float *col = t->col + (y + dy) * (ptrdiff_t)t->ncol * PITCH;
	const float *w = t->weight + (size_t)((dy + t->window) * side) * GD_NLR_WPITCH + t->window;
	float *sum = t->sum + (y + dy) * (ptrdiff_t)(4 * PITCH);

	for (int c = 0; c < 3; c++)
		for (int part = 0, k = 0, n; part < parts; part++, k += n) {
			const float *b =
				t->slope + (size_t)(c * t->terms + k) * GD_NLR_WPITCH + t->window;
			bool first = c == 0 && part == 0;

			n = (t->terms - k + parts - part - 1) / (parts - part);
			if (first)
				for (int x = -reach; x < t->w + t->window; x += GD_NLR_LANES)
					gather_n(sum + x, sum + 3 * PITCH + x, col + x, w + x,
						 b + x, side, n);
			else
				for (int x = -reach; x < t->w + t->window; x += GD_NLR_LANES)
					gather_n(sum + c * PITCH + x, NULL, col + k * PITCH + x,
						 w + x, b + x, side, n);
		}
}

void gd_nlr_predict_row(const struct gd_nlr_tile *t, int y)
{
	for (int dy = -t->window; dy <= t->window; dy++)
		if (y + dy >= t->top && y + dy < t->bottom)
			predict(t, y, dy);
}

static void tile(const struct gd_nlr_tile *t)
{
	const int side = 2 * t->window + 1;

	memset(t->weight - GD_NLR_WPAD, 0,
	       (size_t)(side * side) * GD_NLR_WPITCH * sizeof *t->weight);
	for (int y = -t->window; y < t->h + t->window; y++)
		memset(t->sum + y * (ptrdiff_t)(4 * PITCH) - GD_NLR_PAD, 0,
		       4 * PITCH * sizeof *t->sum);
	for (int y = -t->patch; y < t->h + t->patch; y++) {
		gd_nlr_weights(t, y);
		if (y < t->patch)
			continue;
		gd_nlr_fit_row(t, y - t->patch);
		gd_nlr_predict_row(t, y - t->patch);
	}
}

static void load(float *to, const float *from, int n, float scale, float lo, float hi)
{
#pragma omp simd
	for (int i = 0; i < n; i++) {
		float x = fabsf(from[i]) <= FLT_MAX || lo == 0.0f ? from[i] : 0.0f;

		x *= scale;
		x *= scale;
		x = x > lo ? x : lo;
		to[i] = x < hi ? x : hi;
	}
}

static void finish(float *out, const float *sum, const float *total, const float *y, int n,
		   float scale)
{
	for (int i = 0; i < n; i++) {
		float x = sum[i] / (total[i] > 0.0f ? total[i] : 1.0f) * scale * scale;

		x = total[i] > 0.0f ? x : fabsf(y[i]) <= FLT_MAX ? y[i] : 0.0f;
		x = x > -FLT_MAX ? x : -FLT_MAX;
		out[i] = x < FLT_MAX ? x : FLT_MAX;
	}
}

const struct gd_nlr_kernel GD_KERNEL(gd_nlr_kernel) = { load, tile, finish };
