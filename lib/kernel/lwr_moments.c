/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Sums of products of the columns over one ring of pixels around a centre. The pixels of the ring
 * are first lined up, widened and centred; then blocks of a few rows of the matrix of moments by a
 * few vectors of its columns, as many as the registers hold, run over them.
 */
#include <math.h>

#include "../lwr_impl.h"

#define LANES GD_LWR_LANES
typedef gd_lwr_vec vec;

/* Doubles from one pixel of a ring to the next, and between rows of its moments. */
int gd_lwr_pitch(int columns)
{
	return (columns + LANES - 1) / LANES * LANES;
}

static inline int clamp(int x, int low, int high)
{
	return x < low ? low : x > high ? high : x;
}

#define ORDER(a, b) \
	do { \
		float low = a < b ? a : b, high = a < b ? b : a; \
		a = low; \
		b = high; \
	} while (0)

/* The middle of nine, by 19 comparisons. */
GD_LWR_INLINE float middle(float a, float b, float c, float d, float e, float f, float g, float h,
			   float i)
{
	ORDER(b, c); ORDER(e, f); ORDER(h, i);
	ORDER(a, b); ORDER(d, e); ORDER(g, h);
	ORDER(b, c); ORDER(e, f); ORDER(h, i);
	a = a < d ? d : a; g = a < g ? g : a;
	f = f < i ? f : i; c = c < f ? c : f;
	ORDER(b, e); e = e < h ? e : h; e = b < e ? e : b;
	ORDER(e, c);
	ORDER(g, e); e = e < c ? e : c;
	return e;
}

void gd_lwr_reference(const struct gd_lwr_plan *p, int x, int y, double *ref)
{
	const float *row[3], *at[9];
	const size_t pitch = p->pitch;

	for (int j = 0; j < 3; j++)
		row[j] = p->pixel + (size_t)clamp(y + j - 1, 0, p->h - 1) * (size_t)p->w * pitch;
	for (int j = 0; j < 9; j++)
		at[j] = row[j / 3] + (size_t)clamp(x + j % 3 - 1, 0, p->w - 1) * pitch;
	ref[0] = ref[1] = ref[2] = 0;
	for (int k = 0; k < p->q - 3; k++)
		ref[3 + k] = (double)middle(at[0][k], at[1][k], at[2][k], at[3][k], at[4][k],
					    at[5][k], at[6][k], at[7][k], at[8][k]);
	for (int k = p->q; k < gd_lwr_pitch(p->q); k++)
		ref[k] = 0;
	/* one level for a colour and its twin: their difference stays what it is */
	for (int c = 0; p->twin && c < p->nc; c++)
		ref[p->p + p->nc + c] = ref[p->p + c];
}

/* Columns of n pixels side by side from (x,y) on, with u from u0 on. */
static void line_up(const struct gd_lwr_plan *p, int x, int y, int n, int u0, int v,
		    const double *ref, struct gd_lwr_ring *ring)
{
	const int pitch = gd_lwr_pitch(p->q), summed = p->nvar + p->nfv;
	const float *px = p->pixel + ((size_t)y * (size_t)p->w + (size_t)x) * p->pitch;
	double *z = ring->z + (size_t)ring->n * (size_t)pitch;

	for (int i = 0; i < n; i++, px += p->pitch, z += pitch) {
		double weight = 1;

		/* the three columns before the first feature come from elsewhere */
		for (int k = 0; k < pitch; k += LANES)
			*(vec *)(z + k) =
				__builtin_convertvector(*(const gd_lwr_float *)(px - 3 + k), vec) -
				*(const gd_lwr_any *)(ref + k);
		z[0] = 1;
		z[1] = u0 + i;
		z[2] = v;
		if (p->weight.v) {
			double root = sqrt(weight = (double)gd_row(p->weight, y)[x + i]);

			for (int k = 0; k < pitch; k++)
				z[k] *= root;
		}
		for (int k = 0; k < summed; k++)
			ring->s[p->nc + k] += weight * (double)px[p->q - 3 + k];
	}
	ring->n += n;
}

void gd_lwr_ring_pixel(const struct gd_lwr_plan *p, int x, int y, int u, int v, const double *ref,
		       struct gd_lwr_ring *ring)
{
	line_up(p, x, y, 1, u, v, ref, ring);
}

void gd_lwr_ring_pixels(const struct gd_lwr_plan *p, int x, int y, int r, const double *ref,
			struct gd_lwr_ring *ring)
{
	const int left = clamp(x - r, 0, x), right = clamp(x + r, x, p->w - 1);
	const int top = clamp(y - r, 0, y), bottom = clamp(y + r, y, p->h - 1);

	ring->n = 0;
	for (int k = 0; k < p->nc + p->nvar + p->nfv; k++)
		ring->s[k] = 0;
	for (int j = top; j <= bottom; j++) {
		if (r == 1 || j == y - r || j == y + r) {
			line_up(p, left, j, right - left + 1, left - x, j - y, ref, ring);
			continue;
		}
		if (left == x - r)
			line_up(p, left, j, 1, -r, j - y, ref, ring);
		if (right == x + r)
			line_up(p, right, j, 1, r, j - y, ref, ring);
	}
}

/* na rows of the moments by nb vectors; z: the first vector, row: the first row's column */
GD_LWR_INLINE void block(const double *z, const double *row, int n, int pitch, double *m,
			 const int na, const int nb)
{
	vec sum[4][3];

	for (int i = 0; i < na; i++)
		for (int j = 0; j < nb; j++)
			sum[i][j] = (vec){ 0 };
	for (int k = 0; k < n; k++, z += pitch, row += pitch) {
		vec b[3];

		for (int j = 0; j < nb; j++)
			b[j] = *(const vec *)(z + j * LANES);
		for (int i = 0; i < na; i++) {
			vec a = row[i] - (vec){ 0 };

			for (int j = 0; j < nb; j++)
				sum[i][j] += a * b[j];
		}
	}
	for (int i = 0; i < na; i++)
		for (int j = 0; j < nb; j++)
			*(vec *)(m + i * pitch + j * LANES) = sum[i][j];
}

#define BLOCK(na, nb) \
	__attribute__((noinline)) static void block_##na##_##nb( \
		const double *z, const double *row, int n, int pitch, double *m) \
	{ \
		block(z, row, n, pitch, m, na, nb); \
	}
BLOCK(1, 1) BLOCK(1, 2) BLOCK(1, 3)
BLOCK(2, 1) BLOCK(2, 2) BLOCK(2, 3)
BLOCK(3, 1) BLOCK(3, 2) BLOCK(3, 3)
BLOCK(4, 1) BLOCK(4, 2) BLOCK(4, 3)

static void (*const blocks[4][3])(const double *, const double *, int, int, double *) = {
	{ block_1_1, block_1_2, block_1_3 },
	{ block_2_1, block_2_2, block_2_3 },
	{ block_3_1, block_3_2, block_3_3 },
	{ block_4_1, block_4_2, block_4_3 },
};

void gd_lwr_ring_sums(const struct gd_lwr_plan *p, struct gd_lwr_ring *ring)
{
	const int pitch = gd_lwr_pitch(p->q), vectors = pitch / LANES, other = p->twin ? p->nc : 0;

	for (int i = 0, na; i < p->p; i += na) {
		int first = i / LANES, parts = (vectors - first + 2) / 3;

		na = p->p - i < 4 ? p->p - i : 4;
		for (int part = 0, b = first; part < parts; part++) {
			int nb = (vectors - b + parts - part - 1) / (parts - part);

			blocks[na - 1][nb - 1](ring->z + b * LANES, ring->z + i, ring->n, pitch,
					       ring->m + i * pitch + b * LANES);
			b += nb;
		}
	}
	for (int k = 0; k < ring->n; k++) {
		const double *y = ring->z + (size_t)k * (size_t)pitch + p->p;

		for (int c = 0; c < p->nc; c++)
			ring->s[c] += y[c] * y[c + other];
	}
}
