/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Non-local means in one tile: for each shift of the window the distances of all pixels to their
 * shifted partners, row by row, summed over the patch by two passes of direct sums (no running
 * ones: what a pixel gets must not depend on where its tile begins).
 */
#include "kernel/nlm_tile.h"

#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <string.h>

#include "kernel/vmath.h"

#define INLINE static inline __attribute__((always_inline))

static int load(float *to, const float *from, int n, float scale, float scale2, float lo, float hi)
{
	int found = 0;

#pragma omp simd reduction(| : found)
	for (int i = 0; i < n; i++) {
		float x = from[i];
		float y = x * scale * scale2;

		found |= fabsf(x) <= FLT_MAX ? 0 : GD_NLM_BAD;
		found |= fabsf(x) <= GD_NLM_ROOM ? 0 : GD_NLM_HUGE;
		y = y > lo ? y : lo;
		to[i] = y < hi ? y : hi;
	}
	return found;
}

INLINE float distance(float u, float v, float uq, float vq, float k2, float eps)
{
	float diff = u - uq;
	float least = v < vq ? v : vq;
	float d = (diff * diff - (v + least)) / (eps + k2 * (v + vq));

	return d < GD_NLM_FAR ? d : GD_NLM_FAR;
}

/* d (+)= distances of n pixels in one plane of the guide; all pointers at the first of them. */
INLINE void distances(float *d, bool add, const float *u, const float *v, const float *uq,
		      const float *vq, int n, float k2, float eps)
{
#pragma omp simd
	for (int x = 0; x < n; x++)
		d[x] = (add ? d[x] : 0.0f) + distance(u[x], v[x], uq[x], vq[x], k2, eps);
}

/* The same for the three planes of a colour at once. */
INLINE void distances3(float *d, const struct gd_nlm_tile *t, ptrdiff_t p, ptrdiff_t q, int n)
{
	const float *u0 = t->guide[0] + p, *u1 = t->guide[1] + p, *u2 = t->guide[2] + p;
	const float *v0 = t->guide_var[0] + p, *v1 = t->guide_var[1] + p, *v2 = t->guide_var[2] + p;
	const float *s0 = t->guide[0] + q, *s1 = t->guide[1] + q, *s2 = t->guide[2] + q;
	const float *r0 = t->guide_var[0] + q, *r1 = t->guide_var[1] + q, *r2 = t->guide_var[2] + q;
	const float k2 = t->k2, e0 = t->eps[0], e1 = t->eps[1], e2 = t->eps[2];

#pragma omp simd
	for (int x = 0; x < n; x++)
		d[x] = distance(u0[x], v0[x], s0[x], r0[x], k2, e0) +
		       distance(u1[x], v1[x], s1[x], r1[x], k2, e1) +
		       distance(u2[x], v2[x], s2[x], r2[x], k2, e2);
}

/* dist[x0 .. x1] of row y against the row shifted by (dx, dy); 0 where either pixel is outside. */
static void distance_row(const struct gd_nlm_tile *t, int y, int dx, int dy, int x0, int x1)
{
	int lo = t->left - (dx < 0 ? dx : 0), hi = t->right - (dx > 0 ? dx : 0);
	float *d = t->dist;

	lo = lo > x0 ? lo : x0;
	hi = hi < x1 ? hi : x1;
	for (int x = x0; x < lo; x++)
		d[x] = 0.0f;
	for (int x = hi; x < x1; x++)
		d[x] = 0.0f;

	ptrdiff_t p = y * (ptrdiff_t)t->stride + lo, q = p + dy * (ptrdiff_t)t->stride + dx;

	if (t->nguide == 3) {
		distances3(d + lo, t, p, q, hi - lo);
		return;
	}
	distances(d + lo, false, t->guide[0] + p, t->guide_var[0] + p, t->guide[0] + q,
		  t->guide_var[0] + q, hi - lo, t->k2, t->eps[0]);
	for (int c = 1; c < t->nguide; c++)
		distances(d + lo, true, t->guide[c] + p, t->guide_var[c] + p, t->guide[c] + q,
			  t->guide_var[c] + q, hi - lo, t->k2, t->eps[c]);
}

/* out[x] = sum of row[x - radius .. x + radius] */
INLINE void sum_along(float *restrict out, const float *restrict row, int radius, int x0, int x1)
{
#pragma omp simd
	for (int x = x0; x < x1; x++) {
		float s = row[x - radius];

		for (int o = 1 - radius; o <= radius; o++)
			s += row[x + o];
		out[x] = s;
	}
}

/* weight[x] = exp(-max(0, mean distance of the patch around x)); ring holds the rows of the patch. */
INLINE void weigh(const struct gd_nlm_tile *t, int rows, float share_y, int x0, int x1)
{
	const float *restrict ring = t->ring, *restrict share = t->share;
	float *restrict w = t->weight;
	const size_t stride = t->stride;

#pragma omp simd
	for (int x = x0; x < x1; x++) {
		float s = ring[x];

		for (int o = 1; o < rows; o++)
			s += ring[(size_t)o * stride + x];
		s *= share[x] * share_y;
		w[x] = gd_expf(s > 0.0f ? -s : 0.0f);
	}
}

/* Adds the weighted pixels of row y + dy, shifted by dx, to the sums of row y. */
static void accumulate(const struct gd_nlm_tile *t, int y, int dx, int dy, int x0, int x1)
{
	const ptrdiff_t at = y * (ptrdiff_t)t->stride, to = at + dy * (ptrdiff_t)t->stride + dx;
	const float *restrict w = t->weight;
	float *restrict sum_weight = t->sum_weight + at;

#pragma omp simd
	for (int x = x0; x < x1; x++)
		sum_weight[x] += w[x];
	for (int c = 0; c < t->n; c++) {
		const float *restrict u = t->in[c] + at, *restrict q = t->in[c] + to;
		float *restrict sum = t->sum[c] + at;

#pragma omp simd
		for (int x = x0; x < x1; x++)
			sum[x] += w[x] * (q[x] - u[x]);
		if (!t->in_var[c])
			continue;

		const float *restrict v = t->in_var[c] + to;
		float *restrict sum_var = t->sum_var[c] + at;

#pragma omp simd
		for (int x = x0; x < x1; x++)
			sum_var[x] += w[x] * w[x] * v[x];
	}
}

/* Pixels of a patch (in one direction) that lie in the image together with their partners. */
static int patch_pixels(int at, int radius, int first, int end, int shift)
{
	int lo = first - (shift < 0 ? shift : 0), hi = end - (shift > 0 ? shift : 0);

	lo = lo > at - radius ? lo : at - radius;
	hi = hi < at + radius + 1 ? hi : at + radius + 1;
	return hi - lo;
}

static void shift_sums(const struct gd_nlm_tile *t, int dx, int dy)
{
	const int f = t->patch, rows = 2 * f + 1;
	const int x0 = t->left - dx > 0 ? t->left - dx : 0;
	const int x1 = t->right - dx < t->w ? t->right - dx : t->w;
	const int y0 = t->top - dy > 0 ? t->top - dy : 0;
	const int y1 = t->bottom - dy < t->h ? t->bottom - dy : t->h;

	if (x0 >= x1 || y0 >= y1)
		return;
	for (int x = x0; x < x1; x++)
		t->share[x] = 1.0f / (float)(t->nguide * patch_pixels(x, f, t->left, t->right, dx));
	for (int y = y0 - f; y < y1 + f; y++) {
		float *sums = t->ring + (size_t)((y - y0 + f) % rows) * t->stride;

		if (y < t->top || y >= t->bottom || y + dy < t->top || y + dy >= t->bottom) {
			memset(sums + x0, 0, (size_t)(x1 - x0) * sizeof *sums);
		} else {
			distance_row(t, y, dx, dy, x0 - f, x1 + f);
			if (f == 3)
				sum_along(sums, t->dist, 3, x0, x1);
			else
				sum_along(sums, t->dist, f, x0, x1);
		}
		if (y < y0 + f)
			continue;

		float share_y = 1.0f / (float)patch_pixels(y - f, f, t->top, t->bottom, dy);

		if (f == 3)
			weigh(t, 7, share_y, x0, x1);
		else
			weigh(t, rows, share_y, x0, x1);
		accumulate(t, y - f, dx, dy, x0, x1);
	}
}

static void sums(const struct gd_nlm_tile *t)
{
	for (int y = 0; y < t->h; y++) {
		size_t at = (size_t)y * t->stride, bytes = (size_t)t->w * sizeof(float);

		memset(t->sum_weight + at, 0, bytes);
		for (int c = 0; c < t->n; c++) {
			memset(t->sum[c] + at, 0, bytes);
			if (t->in_var[c])
				memset(t->sum_var[c] + at, 0, bytes);
		}
	}
	for (int dy = -t->window; dy <= t->window; dy++)
		for (int dx = -t->window; dx <= t->window; dx++)
			shift_sums(t, dx, dy);
}

static void mean(const struct gd_nlm_tile *t, int plane, int y, float scale, float *restrict out)
{
	const size_t at = (size_t)y * t->stride;
	const float *restrict w = t->sum_weight + at, *restrict sum = t->sum[plane] + at;
	const float *restrict in = t->in[plane] + y * (ptrdiff_t)t->stride;

#pragma omp simd
	for (int x = 0; x < t->w; x++)
		out[x] = (in[x] + sum[x] / w[x]) * scale;
}

static void mean_var(const struct gd_nlm_tile *t, int plane, int y, float scale, float *restrict out)
{
	const size_t at = (size_t)y * t->stride;
	const float *restrict w = t->sum_weight + at, *restrict var = t->sum_var[plane] + at;

#pragma omp simd
	for (int x = 0; x < t->w; x++)
		out[x] = var[x] / (w[x] * w[x]) * scale;
}

const struct gd_nlm_kernel GD_KERNEL(gd_nlm_kernel) = { load, sums, mean, mean_var };
