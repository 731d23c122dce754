/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Weights of one row of centres for all shifts of the window. For every shift the sums of distances
 * along the rows of the patch are kept in a ring, so that a new row of centres costs one new row of
 * distances. Sums are direct: what a pixel gets does not depend on where its tile begins.
 */
#include "kernel/nlr_tile.h"

#include <math.h>
#include <string.h>

#include "kernel/vmath.h"

#define PITCH GD_NLR_PITCH

/* A plane's share of a distance is above / below, below = noise + v_p + v_q. */
GD_NLR_INLINE float above(float u, float v, float uq, float vq, float below, float far)
{
	float diff = u - uq, least = v < vq ? v : vq;
	float a = diff * diff - (v + least), cut = far * below;

	return a < cut ? a : cut;
}

/*
 * d = sum over the three planes of their shares, over a common denominator: divisions are what
 * takes long. The limits of guide and noise keep the product of three in the range of floats.
 */
GD_NLR_INLINE void distances(float *restrict d, const float *restrict p, const float *restrict q,
			     int n, float noise, float far)
{
#pragma omp simd
	for (int x = 0; x < n; x++) {
		float v0 = p[3 * PITCH + x], v1 = p[4 * PITCH + x], v2 = p[5 * PITCH + x];
		float r0 = q[3 * PITCH + x], r1 = q[4 * PITCH + x], r2 = q[5 * PITCH + x];
		float b0 = (noise + v0) + r0, b1 = (noise + v1) + r1, b2 = (noise + v2) + r2;
		float a0 = above(p[x], v0, q[x], r0, b0, far);
		float a1 = above(p[PITCH + x], v1, q[PITCH + x], r1, b1, far);
		float a2 = above(p[2 * PITCH + x], v2, q[2 * PITCH + x], r2, b2, far);
		float b01 = b0 * b1;

		d[x] = ((a0 * b1 + a1 * b0) * b2 + a2 * b01) / (b01 * b2);
	}
}

/* The sums along a row that come in with guide row y. */
GD_NLR_INLINE void next_sums(const struct gd_nlr_tile *t, float *restrict sums, int y, int dx,
			     int dy, const int f)
{
	const ptrdiff_t row = 6 * PITCH;
	const int n = (t->w + 2 * f + 15) & ~15;
	const int lo = t->left - (dx < 0 ? dx : 0), hi = t->right - (dx > 0 ? dx : 0);
	float dist[PITCH + 16];
	float *d = dist + GD_NLR_PAD;

	if (y < t->top || y >= t->bottom || y + dy < t->top || y + dy >= t->bottom || hi <= lo) {
		memset(sums, 0, GD_NLR_TILE_W * sizeof *sums);
		return;
	}
	distances(d - f, t->guide + y * row - f, t->guide + (y + dy) * row + dx - f, n, t->noise,
		  t->far);
	for (int x = -f; x < lo && x < t->w + f; x++)
		d[x] = 0.0f;
	for (int x = hi > -f ? hi : -f; x < t->w + f; x++)
		d[x] = 0.0f;
#pragma omp simd
	for (int x = 0; x < ((t->w + 15) & ~15); x++) {
		float s = d[x - f];

		for (int o = 1 - f; o <= f; o++)
			s += d[x + o];
		sums[x] = s;
	}
}

GD_NLR_INLINE void weigh(float *restrict w, const float *restrict ring, const float *restrict share,
			 float share_y, int n, const int rows)
{
#pragma omp simd
	for (int x = 0; x < n; x++) {
		float s = ring[x], twice;

		for (int o = 1; o < rows; o++)
			s += ring[o * GD_NLR_TILE_W + x];
		s *= share[x] * share_y;
		twice = s + fabsf(s);	/* of the positive part; the other half is in the share */
		w[x] = twice <= GD_NLR_FAR_OUT ? gd_expf_minus(twice) : 0.0f;
	}
}

/* Rows of the patch around y that lie in the image together with their partners. */
static int patch_rows(const struct gd_nlr_tile *t, int y, int dy)
{
	int lo = t->top - (dy < 0 ? dy : 0), hi = t->bottom - (dy > 0 ? dy : 0);

	lo = lo > y - t->patch ? lo : y - t->patch;
	hi = hi < y + t->patch + 1 ? hi : y + t->patch + 1;
	return hi - lo;
}

/* Weights 0 for centres without a partner at dx, and for what lies outside the tile. */
static void clear_ends(const struct gd_nlr_tile *t, float *w, int n, int dx)
{
	int lo = t->left - dx > 0 ? t->left - dx : 0;
	int hi = t->right - dx < t->w ? t->right - dx : t->w;

	for (int x = 0; x < lo && x < n; x++)
		w[x] = 0.0f;
	for (int x = hi > 0 ? hi : 0; x < n; x++)
		w[x] = 0.0f;
}

static void times_fit(const struct gd_nlr_tile *t, int s, const float *m, int n)
{
	const float *restrict w = t->weight + (size_t)s * GD_NLR_WPITCH;
	float *restrict to = t->fit + (size_t)s * GD_NLR_WPITCH;

#pragma omp simd
	for (int x = 0; x < n; x++)
		to[x] = w[x] * m[x];
}

GD_NLR_INLINE void shift(const struct gd_nlr_tile *t, int y, int dx, int dy, const int f)
{
	const int side = 2 * t->window + 1, rows = 2 * f + 1, n = (t->w + 15) & ~15;
	const int s = (dy + t->window) * side + dx + t->window, centre = y - f;
	float *ring = t->ring + (size_t)(s * rows) * GD_NLR_TILE_W;
	float *w = t->weight + (size_t)s * GD_NLR_WPITCH;

	next_sums(t, ring + (size_t)((y + f) % rows) * GD_NLR_TILE_W, y, dx, dy, f);
	if (centre < 0)
		return;
	if (centre + dy < t->top || centre + dy >= t->bottom) {
		memset(w, 0, (size_t)n * sizeof *w);
	} else {
		weigh(w, ring, t->share + (dx + t->window) * GD_NLR_TILE_W,
		      1.0f / (float)patch_rows(t, centre, dy), n, rows);
		clear_ends(t, w, n, dx);
	}
	if (t->fit != t->weight)
		times_fit(t, s,
			  t->col + ((centre + dy) * (ptrdiff_t)t->ncol + t->ncol - 1) * PITCH + dx,
			  n);
}

void gd_nlr_weights(const struct gd_nlr_tile *t, int y)
{
	for (int dy = -t->window; dy <= t->window; dy++)
		for (int dx = -t->window; dx <= t->window; dx++) {
			if (t->patch == 2)
				shift(t, y, dx, dy, 2);
			else
				shift(t, y, dx, dy, t->patch);
		}
}
