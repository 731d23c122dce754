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

static int load(float *to, const float *from, int n, float offset, float scale, float scale2,
		float lo, float hi)
{
	int found = 0;

#pragma omp simd reduction(| : found)
	for (int i = 0; i < n; i++) {
		float x = from[i];
		float y = (x - offset) * scale * scale2;

		found |= fabsf(x) <= FLT_MAX ? 0 : GD_NLM_BAD;
		found |= fabsf(x) <= GD_NLM_ROOM ? 0 : GD_NLM_HUGE;
		y = y > lo ? y : lo;
		to[i] = y < hi ? y : hi;
	}
	return found;
}

/* One plane's share of a distance is above / below, for below = noise + v_p + v_q > 0. */
INLINE float above(float u, float v, float uq, float vq, float below, float far)
{
	float diff = u - uq, least = v < vq ? v : vq;
	float a = diff * diff - (v + least), most = far * below;

	return a < most ? a : most;
}

/* d (+)= distances of n pixels in one plane of the guide; all pointers at the first of them. */
INLINE void distances(float *d, bool add, const float *u, const float *v, const float *uq,
		      const float *vq, int n, float noise, float far)
{
#pragma omp simd
	for (int x = 0; x < n; x++) {
		float b = noise + (v[x] + vq[x]);

		d[x] = (add ? d[x] : 0.0f) + above(u[x], v[x], uq[x], vq[x], b, far) / b;
	}
}

/*
 * The same for the three planes of a colour at once, over their common denominator: divisions are
 * what takes long. The limits of guides and noise keep the product of three in the range of floats.
 */
INLINE void distances3(float *d, const struct gd_nlm_tile *t, ptrdiff_t p, ptrdiff_t q, int n)
{
	const float *u0 = t->guide[0] + p, *u1 = t->guide[1] + p, *u2 = t->guide[2] + p;
	const float *v0 = t->guide_var[0] + p, *v1 = t->guide_var[1] + p, *v2 = t->guide_var[2] + p;
	const float *s0 = t->other[0] + q, *s1 = t->other[1] + q, *s2 = t->other[2] + q;
	const float *r0 = t->other_var[0] + q, *r1 = t->other_var[1] + q, *r2 = t->other_var[2] + q;
	const float e0 = t->noise[0], e1 = t->noise[1], e2 = t->noise[2];
	const float far = t->far;

#pragma omp simd
	for (int x = 0; x < n; x++) {
		float b0 = e0 + (v0[x] + r0[x]), b1 = e1 + (v1[x] + r1[x]);
		float b2 = e2 + (v2[x] + r2[x]);
		float a0 = above(u0[x], v0[x], s0[x], r0[x], b0, far);
		float a1 = above(u1[x], v1[x], s1[x], r1[x], b1, far);
		float a2 = above(u2[x], v2[x], s2[x], r2[x], b2, far);
		float b01 = b0 * b1;

		d[x] = ((a0 * b1 + a1 * b0) * b2 + a2 * b01) / (b01 * b2);
	}
}

/* dist[x0 .. x1] of row y against the row shifted by (dx, dy); 0 where either pixel is outside. */
static void distance_row(const struct gd_nlm_tile *t, int y, int dx, int dy, int x0, int x1)
{
	int lo = t->left - (dx < 0 ? dx : 0), hi = t->right - (dx > 0 ? dx : 0), n;
	float *d = t->dist;

	lo = lo > x0 ? lo : x0;
	hi = hi < x1 ? hi : x1;

	ptrdiff_t p = y * (ptrdiff_t)t->stride + lo, q = p + dy * (ptrdiff_t)t->stride + dx;

	n = (hi - lo + 7) & ~7;		/* whole vectors; the rows have room for it */
	if (t->nguide == 3) {
		distances3(d + lo, t, p, q, n);
	} else {
		for (int c = 0; c < t->nguide; c++)
			distances(d + lo, c > 0, t->guide[c] + p, t->guide_var[c] + p,
				  t->other[c] + q, t->other_var[c] + q, n, t->noise[c], t->far);
	}
	for (int x = x0; x < lo; x++)
		d[x] = 0.0f;
	for (int x = hi; x < x1; x++)
		d[x] = 0.0f;
}

/* out[x] = sum of row[x - radius .. x + radius] */
INLINE void sum_along(float *restrict out, const float *restrict row, int radius, int x0, int x1)
{
#pragma omp simd
	for (int x = x0; x < x1; x++) {
		float s = row[x];

		for (int o = 1; o <= radius; o++)
			s += row[x - o] + row[x + o];
		out[x] = s;
	}
}

/*
 * w[x] = exp(-max(0, mean distance of the patch around x)) for x0 <= x < x1; ring holds the patch's
 * rows of sums; share has the half of their mean's factor, since 2 max(0, s) = s + |s|.
 */
INLINE void weigh(float *restrict w, const struct gd_nlm_tile *t, const float *restrict ring,
		  const float *restrict share, int rows, float share_y, int x0, int x1)
{
	const size_t stride = t->stride;

#pragma omp simd
	for (int x = x0; x < x1; x++) {
		float s = ring[x];

		for (int o = 1; o < rows; o += 2)
			s += ring[(size_t)o * stride + x] + ring[(size_t)(o + 1) * stride + x];
		s *= share[x] * share_y;
		w[x] = gd_expf_minus(s + fabsf(s));
	}
}

/* Adds the pixels q of count shifts in a row, dx, dx + 1 ..., to a row of sums. */
INLINE void add_values(float *restrict sum, const float *restrict u, const float *restrict q,
		       const float *restrict w, size_t stride, int count, int n)
{
#pragma omp simd
	for (int x = 0; x < n; x++) {
		float s = sum[x], centre = u[x];

		for (int i = 0; i < count; i++)
			s += w[(size_t)i * stride + x] * (q[x + i] - centre);
		sum[x] = s;
	}
}

INLINE void add_variances(float *restrict sum, const float *restrict q, const float *restrict w,
			  size_t stride, int count, int n)
{
#pragma omp simd
	for (int x = 0; x < n; x++) {
		float s = sum[x];

		for (int i = 0; i < count; i++)
			s += w[(size_t)i * stride + x] * (w[(size_t)i * stride + x] * q[x + i]);
		sum[x] = s;
	}
}

INLINE void add_weights(float *restrict sum, const float *restrict w, size_t stride, int count,
			int n)
{
#pragma omp simd
	for (int x = 0; x < n; x++) {
		float s = sum[x];

		for (int i = 0; i < count; i++)
			s += w[(size_t)i * stride + x];
		sum[x] = s;
	}
}

INLINE void accumulate(const struct gd_nlm_tile *t, int y, int dx, int dy, int count, int x0,
		       int x1)
{
	const ptrdiff_t at = y * (ptrdiff_t)t->stride + x0;
	const ptrdiff_t to = at + dy * (ptrdiff_t)t->stride + dx;
	const float *w = t->weight + x0;
	const int n = x1 - x0;

	add_weights(t->sum_weight + at, w, t->stride, count, n);
	for (int c = 0; c < t->n; c++) {
		add_values(t->sum[c] + at, t->in[c] + at, t->from[c] + to, w, t->stride, count, n);
		if (t->in_var[c])
			add_variances(t->sum_var[c] + at, t->from_var[c] + to, w, t->stride, count,
				      n);
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

/* The next run of chunks in bits, as pixels x0 <= x < x1 of a row of w; false if there is none. */
INLINE bool next_run(uint32_t *bits, int w, int *x0, int *x1)
{
	uint32_t rest = *bits, after;
	int first;

	if (!rest)
		return false;
	first = __builtin_ctz(rest);
	after = rest + (1u << first);	/* carries through the run */
	*bits = rest & after;
	*x0 = first * GD_NLM_CHUNK;
	*x1 = after ? __builtin_ctz(after) * GD_NLM_CHUNK : 32 * GD_NLM_CHUNK;
	*x1 = *x1 < w ? *x1 : w;
	return true;
}

/* Cuts x0 <= x < x1 to the pixels that have a partner at dx. */
INLINE void partners(const struct gd_nlm_tile *t, int dx, int *x0, int *x1)
{
	*x0 = t->left - dx > *x0 ? t->left - dx : *x0;
	*x1 = t->right - dx < *x1 ? t->right - dx : *x1;
}

/* The row sums of distances that come in with row y of the guide. */
INLINE void next_row(const struct gd_nlm_tile *t, float *sums, int y, int dx, int dy, int f, int x0,
		     int x1)
{
	partners(t, dx, &x0, &x1);
	if (x0 >= x1)
		return;
	if (y < t->top || y >= t->bottom || y + dy < t->top || y + dy >= t->bottom) {
		memset(sums + x0, 0, (size_t)(x1 - x0) * sizeof *sums);
	} else {
		distance_row(t, y, dx, dy, x0 - f, x1 + f);
		sum_along(sums, t->dist, f, x0, x1);
	}
}

INLINE void weigh_run(const struct gd_nlm_tile *t, const float *known, int dx, int f, int count,
		      float share_y, int x0, int x1)
{
	const int rows = 2 * f + 1;

	for (int i = 0; i < count; i++) {
		float *w = t->weight + (size_t)i * t->stride;
		int lo = x0, hi = x1;

		partners(t, dx + i, &lo, &hi);
		for (int x = x0; x < lo && x < x1; x++)
			w[x] = 0.0f;
		for (int x = hi > x0 ? hi : x0; x < x1; x++)
			w[x] = 0.0f;
		weigh(w, t, t->ring + (size_t)(i * rows) * t->stride,
		      t->share + (size_t)i * t->stride, rows, share_y, lo, hi);
		for (int x = lo; known && x < hi; x++)
			w[x] *= known[x + dx + i];
	}
}

/*
 * Up to GD_NLM_GROUP shifts dx, dx + 1 ... of one dy go together, so that the sums of values need
 * to be loaded and stored only once for all of them.
 */
INLINE void shift_sums(const struct gd_nlm_tile *t, int dx, int dy, int f, int count)
{
	const int rows = 2 * f + 1;
	const int y0 = t->top - dy > 0 ? t->top - dy : 0;
	const int y1 = t->bottom - dy < t->h ? t->bottom - dy : t->h;
	const size_t stride = t->stride;
	int x0, x1;

	for (int i = 0; i < count; i++) {
		x0 = 0;
		x1 = t->w;
		partners(t, dx + i, &x0, &x1);
		for (int x = x0; x < x1; x++)
			t->share[(size_t)i * stride + x] = 0.5f * t->scale /
				(float)(t->nguide * patch_pixels(x, f, t->left, t->right, dx + i));
	}
	for (int y = y0 - f; y < y1 + f; y++) {
		const int slot = (y - y0 + f) % rows;
		uint32_t bits = t->needed[y];

		while (next_run(&bits, t->w, &x0, &x1))
			for (int i = 0; i < count; i++)
				next_row(t, t->ring + (size_t)(i * rows + slot) * stride, y, dx + i,
					 dy, f, x0, x1);
		if (y < y0 + f || !t->active[y - f])
			continue;

		float share_y = 1.0f / (float)patch_pixels(y - f, f, t->top, t->bottom, dy);

		bits = t->active[y - f];
		while (next_run(&bits, t->w, &x0, &x1)) {
			weigh_run(t, t->known ? t->known + (y - f + dy) * (ptrdiff_t)stride : NULL,
				  dx, f, count, share_y, x0, x1);
			accumulate(t, y - f, dx, dy, count, x0, x1);
		}
	}
}

#define REGION 5	/* of 8 neighbours: more than the 3 that a noisy line beside a pixel has */

/* Adds what plane c says of a row: how many of 3x3 pixels are noisy, the middle one for many. */
static void mark_row(const struct gd_nlm_tile *t, int c, int y, float most)
{
	float *restrict count = t->dist, *restrict row = t->noisy + (size_t)y * t->stride;

	memset(count, 0, (size_t)t->w * sizeof *count);
	for (int dy = -1; dy <= 1; dy++)
		for (int dx = -1; dx <= 1; dx++) {
			const float *var = t->guide_var[c] +
					   (ptrdiff_t)(y + dy) * (ptrdiff_t)t->stride + dx;
			const float says = dx == 0 && dy == 0 ? REGION : 1;
			int x0 = 0, x1 = t->w;

			if (y + dy < t->top || y + dy >= t->bottom)
				continue;
			partners(t, dx, &x0, &x1);
#pragma omp simd
			for (int x = x0; x < x1; x++)
				count[x] += var[x] > most ? says : 0.0f;
		}
#pragma omp simd
	for (int x = 0; x < t->w; x++)
		row[x] = count[x] >= REGION ? 1.0f : row[x];
}

/*
 * A pixel of a noisy region whose own few samples happen to agree looks certain: most of its
 * neighbours say that it is not.
 */
static bool mark(const struct gd_nlm_tile *t, const float *most)
{
	const int f = t->patch;
	uint32_t any = 0;

	for (int y = -f; y < t->h + f; y++)
		t->needed[y] = 0;
	for (int y = 0; y < t->h; y++) {
		float *row = t->noisy + (size_t)y * t->stride;

		memset(row, 0, (size_t)t->w * sizeof *row);
		for (int c = 0; c < t->nguide; c++)
			mark_row(t, c, y, most[c]);
		t->active[y] = 0;
		for (int x = 0; x < t->w; x++)
			if (row[x] > 0.0f)
				t->active[y] |= 1u << x / GD_NLM_CHUNK;
		for (int o = -f; o <= f; o++)
			t->needed[y + o] |= t->active[y];
		any |= t->active[y];
	}
	return any != 0;
}

static void clear(const struct gd_nlm_tile *t)
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
}

static void sums(const struct gd_nlm_tile *t, int dy, int last)
{
	int dx = -last;

	/* the usual window of 11 in groups of 4, 4 and 3; other patches one by one */
	for (; t->patch == 3 && dx + 4 == last; dx += 5)
		shift_sums(t, dx, dy, 3, 5);
	for (; t->patch == 3 && dx + 3 <= last; dx += 4)
		shift_sums(t, dx, dy, 3, 4);
	for (; t->patch == 3 && dx + 2 <= last; dx += 3)
		shift_sums(t, dx, dy, 3, 3);
	for (; dx <= last; dx++)
		shift_sums(t, dx, dy, t->patch, 1);
}

static void mean(const struct gd_nlm_tile *t, int plane, int y, float scale, float *restrict out)
{
	const size_t at = (size_t)y * t->stride;
	const float *restrict w = t->sum_weight + at, *restrict sum = t->sum[plane] + at;
	const float *restrict in = t->in[plane] + at, *restrict noisy = t->noisy + at;

#pragma omp simd
	for (int x = 0; x < t->w; x++) {
		float change = sum[x] / w[x];

		out[x] = (noisy[x] > 0.0f ? in[x] + change : in[x]) * scale;
	}
}

static void mean_var(const struct gd_nlm_tile *t, int plane, int y, float scale,
		     float *restrict out)
{
	const size_t at = (size_t)y * t->stride;
	const float *restrict w = t->sum_weight + at, *restrict var = t->sum_var[plane] + at;
	const float *restrict in = t->in_var[plane] + at, *restrict noisy = t->noisy + at;

#pragma omp simd
	for (int x = 0; x < t->w; x++) {
		float less = var[x] / (w[x] * w[x]);

		out[x] = (noisy[x] > 0.0f ? less : in[x]) * scale;
	}
}

const struct gd_nlm_kernel GD_KERNEL(gd_nlm_kernel) = { load, mark, clear, sums, mean, mean_var };
