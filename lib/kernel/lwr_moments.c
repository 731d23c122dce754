/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Sums of products of the columns over one ring of pixels around a centre. The pixels of the ring
 * are first lined up, widened and centred; then blocks of a few rows of the matrix of moments by a
 * few vectors of its columns, as many as the registers hold, run over them.
 */
#include "../lwr_impl.h"

#define LANES GD_LWR_LANES
#define FIRST ((3 + LANES - 1) / LANES)	/* vectors that hold 1 u v */
#define MOST ((GD_LWR_COLUMNS + 6 + LANES - 1) / LANES)
typedef gd_lwr_vec vec;

#define splat gd_lwr_splat

/* The compiler makes one instruction of this loop, but several of a conversion of vectors. */
GD_LWR_INLINE vec widen(const float *v)
{
	double x[LANES] __attribute__((aligned(8 * LANES)));

	for (int l = 0; l < LANES; l++)
		x[l] = (double)v[l];
	return *(const vec *)x;
}

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
	for (int k = 0; p->paper && k < p->q - 3; k++)
		ref[3 + k] = (double)row[1][(size_t)x * pitch + (size_t)k];
	for (int k = 0; !p->paper && k < p->q - 3; k++)
		ref[3 + k] = (double)middle(at[0][k], at[1][k], at[2][k], at[3][k], at[4][k],
					    at[5][k], at[6][k], at[7][k], at[8][k]);
	for (int k = p->q; k < gd_lwr_pitch(p->q); k++)
		ref[k] = 0;
	/* one level for a colour and its twin: their difference stays what it is */
	for (int c = 0; p->twin && c < p->nc; c++)
		ref[p->p + p->nc + c] = ref[p->p + c];
}

/* A line of pixels of a ring: from (x,y) on, n of them, to the right or down. */
struct strip {
	int x, y, n;
	bool down;
};

/* Lines up the columns of a strip in n * vectors vectors. */
GD_LWR_INLINE void line_up(const struct gd_lwr_plan *p, const struct strip *s, int x, int y,
			   const double *ref, double *z, const int vectors)
{
	const size_t step = s->down ? (size_t)p->w * p->pitch : p->pitch;
	const float *px = p->pixel + ((size_t)s->y * (size_t)p->w + (size_t)s->x) * p->pitch;
	vec less[MOST], keep[FIRST] = {{ 0 }}, move[FIRST] = {{ 0 }};

	for (int k = 0; k < vectors; k++)
		less[k] = -*(const gd_lwr_any *)(ref + k * LANES);
	for (int k = 0; k < FIRST; k++) {
		for (int l = 0; l < LANES; l++) {
			keep[k][l] = k * LANES + l >= 3;
			move[k][l] = k * LANES + l == (s->down ? 2 : 1);
		}
	}
	less[0][0] = 1;
	less[0][1] = s->x - x;
	less[2 / LANES][2 % LANES] = s->y - y;
	for (int i = 0; i < s->n; i++, px += step, z += vectors * LANES) {
		vec v[MOST];

		/* what lies before a pixel's first feature is of no meaning, but finite */
		for (int k = 0; k < vectors; k++) {
			v[k] = widen(px - 3 + k * LANES);
			v[k] = k < FIRST ? v[k] * keep[k] + less[k] : v[k] + less[k];
		}
		if (p->root > 0) {
			vec root = splat((double)px[p->root]);

			for (int k = 0; k < vectors; k++)
				v[k] *= root;
		}
		for (int k = 0; k < vectors; k++)
			*(vec *)(z + k * LANES) = v[k];
		for (int k = 0; k < FIRST; k++)
			less[k] += move[k];
	}
}

#define LINE_UP(v) \
	case v: \
		for (int i = 0; i < count; z += strip[i++].n * (v) * LANES) \
			line_up(p, strip + i, x, y, ref, z, v); \
		break

/* With the number of vectors known to the compiler, where it is small enough to matter. */
static void line_up_all(const struct gd_lwr_plan *p, const struct strip *strip, int count, int x,
			int y, const double *ref, double *z)
{
	const int vectors = gd_lwr_pitch(p->q) / LANES;

	switch (vectors) {
	LINE_UP(2);
	LINE_UP(3);
	LINE_UP(4);
	LINE_UP(5);
	LINE_UP(6);
	default:
		for (int i = 0; i < count; z += strip[i++].n * vectors * LANES)
			line_up(p, strip + i, x, y, ref, z, vectors);
	}
}

/* Sums of what has no products: variances of the colour and of features. */
static void add_up(const struct gd_lwr_plan *p, const struct strip *s, double *sum)
{
	const size_t step = s->down ? (size_t)p->w * p->pitch : p->pitch;
	const float *px = p->pixel + ((size_t)s->y * (size_t)p->w + (size_t)s->x) * p->pitch;
	const int summed = p->nvar + p->nfv;

	for (int k = 0; k < summed; k += LANES) {
		const float *at = px + p->q - 3 + k;
		vec v = { 0 };

		for (int i = 0; i < s->n; i++) {
			vec here = widen(at + (size_t)i * step);

			if (p->root > 0) {
				double root = (double)px[(size_t)i * step + (size_t)p->root];

				here *= root * root;
			}
			v += here;
		}
		for (int l = 0; l < LANES && k + l < summed; l++)
			sum[k + l] += v[l];
	}
}

/* The strips of the ring, or of the whole first window; returns their number. */
static int strips(const struct gd_lwr_plan *p, int x, int y, int r, struct strip *to)
{
	const int x0 = clamp(x - r, 0, x), x1 = clamp(x + r, x, p->w - 1);
	const int y0 = clamp(y - r, 0, y), y1 = clamp(y + r, y, p->h - 1);
	const int top = y - r >= 0, bottom = y + r < p->h;
	const int inner = y1 - y0 + 1 - top - bottom;
	int n = 0;

	if (r == 1) {
		for (int j = y0; j <= y1; j++)
			to[n++] = (struct strip){ x0, j, x1 - x0 + 1, false };
		return n;
	}
	if (top)
		to[n++] = (struct strip){ x0, y0, x1 - x0 + 1, false };
	if (bottom)
		to[n++] = (struct strip){ x0, y1, x1 - x0 + 1, false };
	if (x - r >= 0)
		to[n++] = (struct strip){ x0, y0 + top, inner, true };
	if (x + r < p->w)
		to[n++] = (struct strip){ x1, y0 + top, inner, true };
	return n;
}

/*
 * Asks for the pixels of a ring ahead of time: the sides of rings lie in as many rows, which no
 * processor foresees.
 */
static void fetch(const struct gd_lwr_plan *p, int x, int y, int r)
{
	struct strip strip[4];
	const int count = strips(p, x, y, r, strip);

	for (int i = 0; i < count; i++) {
		const struct strip *s = strip + i;
		const size_t step = s->down ? (size_t)p->w * p->pitch : p->pitch;
		const float *px = p->pixel +
				  ((size_t)s->y * (size_t)p->w + (size_t)s->x) * p->pitch;

		for (int k = 0; k < s->n; k++, px += step) {
			__builtin_prefetch(px);
			__builtin_prefetch(px + p->pitch - 1);
		}
	}
}

void gd_lwr_ring_pixel(const struct gd_lwr_plan *p, int px, int py, int x, int y,
		       const double *ref, double *z)
{
	struct strip one = { px, py, 1, false };

	line_up_all(p, &one, 1, x, y, ref, z);
}

void gd_lwr_ring_pixels(const struct gd_lwr_plan *p, int x, int y, int r, const double *ref,
			struct gd_lwr_ring *ring)
{
	struct strip strip[4];
	const int count = strips(p, x, y, r, strip);

	line_up_all(p, strip, count, x, y, ref, ring->z);
	fetch(p, x, y, r + 1);
	for (int k = 0; k < p->nvar + p->nfv; k++)
		ring->s[p->nc + k] = 0;
	ring->n = 0;
	for (int i = 0; i < count; i++) {
		ring->n += strip[i].n;
		if (p->nvar + p->nfv > 0)
			add_up(p, strip + i, ring->s + p->nc);
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

/* Sums over n pixels of the columns from y on, each times the one `other` columns on. */
static void products(const double *y, int other, int n, int pitch, double *sum, int count)
{
	vec even = { 0 }, odd = { 0 };
	int k = 0;

	for (; k + 2 <= n; k += 2, y += 2 * pitch) {
		even += *(const gd_lwr_any *)y * *(const gd_lwr_any *)(y + other);
		odd += *(const gd_lwr_any *)(y + pitch) * *(const gd_lwr_any *)(y + pitch + other);
	}
	if (k < n)
		even += *(const gd_lwr_any *)y * *(const gd_lwr_any *)(y + other);
	even += odd;
	for (int l = 0; l < count; l++)
		sum[l] = even[l];
}

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
	for (int c = 0; c < p->nc; c += LANES)
		products(ring->z + p->p + c, other, ring->n, pitch, ring->s + c,
			 p->nc - c < LANES ? p->nc - c : LANES);
}
