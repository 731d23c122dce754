/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * The models of a batch of centres, one centre per lane, for growing windows: from the sums of
 * each ring follow the error of the model before it, then the next model.
 *
 * With A = sum w z z' = L L' and c = sum w z y the model is b = A^-1 c. On a ring with moments
 * A_r, c_r, s_r its squared error is b'A_r b - 2 b'c_r + s_r; against an independent twin t of y it
 * is b'A_r b - b'(c_r + ct_r) + sum w y t. On the first window, where nothing is left to test on,
 * each pixel is predicted without itself: its misfit e becomes e / (1 - h), h = w |L^-1 z|^2.
 */
#include <math.h>

#include "../lwr_impl.h"
#include "kernel/lwr_batch.h"

#define LANES GD_LWR_LANES
typedef gd_lwr_vec vec;

/*
 * A column is left out where what remains of it, after those before it, is rounding: below RAW of
 * its own square (products of doubles cancel to a few 1e-16 of that) or COLLINEAR of its square
 * about the window's mean (1e-4 of its spread: less cannot be told from float rounding once
 * coefficients multiply it).
 */
#define RAW 1e-12
#define COLLINEAR 1e-8
#define LEFT 1e-6	/* 1 - h below this is no prediction: the pixel alone carries a column */

#define splat gd_lwr_splat
#define larger gd_lwr_larger
#define pick gd_lwr_pick
typedef gd_lwr_mask mask;

/*
 * A window three rings beyond the best one, with so many times its error, grows no further. Found
 * on renders: the same error, a sixth less time. 2 ends too early, and costs models and accuracy.
 */
#define HOPELESS 4.0

GD_LWR_INLINE vec inverse_root(vec d)
{
	double x[LANES] __attribute__((aligned(8 * LANES)));

	*(vec *)x = d;
	for (int l = 0; l < LANES; l++)
		x[l] = 1.0 / sqrt(x[l]);
	return *(vec *)x;
}

/* Noise of column j in the windows, times feature_noise; 0 for exact and other columns. */
static vec column_noise(const struct gd_lwr_plan *p, const vec *s, int j)
{
	for (int a = 0; a < p->nfv; a++)
		if (p->noisy[a] == j - 3)
			return p->noise * s[p->nc + p->nvar + a];
	return (vec){ 0 };
}

/*
 * Whether column i, of which d is left, takes part: 1 / L_ii, or 0 where it is without substance
 * or beyond the share of the pixels that a model may use. d comes with the column's pulls.
 */
static void take(const struct gd_lwr_plan *p, struct gd_lwr_batch *t, int i, vec d)
{
	vec least = RAW * t->a[i * p->q + i];
	mask in;

	if (i > 0) {
		vec spread = t->a[i * p->q + i] - t->l[i] * t->l[i];

		least = larger(least, COLLINEAR * spread);
		if (i >= 3) {
			least = larger(least, column_noise(p, t->s, i));
			least = larger(least, p->floor[i - 3] * t->a[0]);
		}
	}
	in = (d > least) & (t->used < GD_LWR_SHARE * t->pixels);
	t->inv[i] = pick(in, inverse_root(pick(in, d, splat(1))), (vec){ 0 });
	t->used -= __builtin_convertvector(in, vec);
	if (i >= 3)
		t->helping -= __builtin_convertvector(in, vec);
}

/* Entries j .. j+n-1 of column i of L. */
GD_LWR_INLINE void entries(const vec *a, vec *l, int m, int i, int j, vec inv, const int n)
{
	vec x[8];

	for (int e = 0; e < n; e++)
		x[e] = a[j + e];
	for (int k = 0; k < i; k++) {
		vec y = l[k * m + i];

		for (int e = 0; e < n; e++)
			x[e] -= y * l[k * m + j + e];
	}
	for (int e = 0; e < n; e++)
		l[i * m + j + e] = x[e] * inv;
}

/*
 * A = L L', column by column; the right-hand sides are taken along as more rows of A, which leaves
 * L^-1 c in their place.
 */
static void decompose(const struct gd_lwr_plan *p, struct gd_lwr_batch *t)
{
	const int m = p->p + p->nc;

	t->used = t->helping = (vec){ 0 };
	for (int i = 0; i < p->p; i++) {
		const vec *a = t->a + i * p->q;
		vec d = a[i];
		int j = i + 1;

		if (i > 0)
			d += p->ridge * larger(d - t->l[i] * t->l[i], (vec){ 0 });
		if (i >= 3)
			d += p->flat[i - 3] * t->a[0];
		for (int k = 0; k < i; k++)
			d -= t->l[k * m + i] * t->l[k * m + i];
		take(p, t, i, d);
		t->l[i * m + i] = d * t->inv[i];
		for (; j + 6 <= m; j += 6)
			entries(a, t->l, m, i, j, t->inv[i], 6);
		for (; j + 3 <= m; j += 3)
			entries(a, t->l, m, i, j, t->inv[i], 3);
		for (; j < m; j++)
			entries(a, t->l, m, i, j, t->inv[i], 1);
	}
}

/* b = L'^-1 t with t = L^-1 c in rows p .. of L, n right-hand sides. */
GD_LWR_INLINE void solve_back(const struct gd_lwr_plan *p, const vec *l, const vec *inv, vec *b,
			      const int n)
{
	const int m = p->p + n;

	for (int j = p->p - 1; j >= 0; j--) {
		const vec *lj = l + j * m;
		vec x[3];

		for (int c = 0; c < n; c++)
			x[c] = lj[p->p + c];
		for (int k = j + 1; k < p->p; k++)
			for (int c = 0; c < n; c++)
				x[c] -= lj[k] * b[k * n + c];
		for (int c = 0; c < n; c++)
			b[j * n + c] = x[c] * inv[j];
	}
}

/* The same from c itself, for n right-hand sides at [j * n + c]; m: between columns of L. */
static void substitute(const struct gd_lwr_plan *p, const vec *l, int m, const vec *inv,
		       const vec *c, vec *b, int n)
{
	for (int j = 0; j < p->p; j++)
		for (int q = 0; q < n; q++) {
			vec x = c[j * n + q];

			for (int k = 0; k < j; k++)
				x -= l[k * m + j] * b[k * n + q];
			b[j * n + q] = x * inv[j];
		}
	for (int j = p->p - 1; j >= 0; j--)
		for (int q = 0; q < n; q++) {
			vec x = b[j * n + q];

			for (int k = j + 1; k < p->p; k++)
				x -= l[j * m + k] * b[k * n + q];
			b[j * n + q] = x * inv[j];
		}
}

/* Adds to the error what the models miss the ring by, squared, with the noise taken off. */
GD_LWR_INLINE void ring_error(const struct gd_lwr_plan *p, struct gd_lwr_batch *t, const int nc)
{
	vec sum[3];

	for (int c = 0; c < nc; c++)
		sum[c] = p->nvar ? t->rs[c] - t->rs[nc + c] : t->rs[c];
	for (int i = 0; i < p->p; i++) {
		const vec *a = t->ring + i * p->q, *b = t->b + i * nc, *r = a + p->p;
		const vec *other = p->twin ? r + nc : r;
		vec x[3];

		for (int c = 0; c < nc; c++)
			x[c] = 0.5 * a[i] * b[c];
		for (int j = i + 1; j < p->p; j++)
			for (int c = 0; c < nc; c++)
				x[c] += a[j] * t->b[j * nc + c];
		for (int c = 0; c < nc; c++)
			sum[c] += b[c] * (2.0 * x[c] - (r[c] + other[c]));
	}
	for (int c = 0; c < nc; c++)
		t->acc[c] += sum[c];
}

/* The same on the first window, each pixel predicted by the others. */
static void first_error(const struct gd_lwr_plan *p, struct gd_lwr_batch *t)
{
	const int nc = p->nc, m = p->p + nc;
	vec x[GD_LWR_COLUMNS];

	for (int c = 0; c < nc; c++)
		t->acc[c] = p->nvar ? -t->s[nc + c] : (vec){ 0 };
	for (int k = 0; k < 9; k++) {
		const vec *z = t->first + (size_t)k * p->q;
		vec h = { 0 };

		for (int j = 0; j < p->p; j++)
			x[j] = z[j];
		for (int j = 0; j < p->p; j++) {
			const vec *lj = t->l + j * m;
			vec y = x[j] * t->inv[j];

			h += y * y;
			for (int i = j + 1; i < p->p; i++)
				x[i] -= lj[i] * y;
		}
		for (int c = 0; c < nc; c++) {
			vec y = z[p->p + c], e = -y, other;

			for (int j = 0; j < p->p; j++)
				e += t->b[j * nc + c] * z[j];
			e = pick(1.0 - h > LEFT, e / larger(1.0 - h, splat(LEFT)), -y);
			other = p->twin ? e + y - z[p->p + nc + c] : e;
			t->acc[c] += e * other;
		}
	}
}

GD_LWR_INLINE void take_over(vec *to, const vec *from, mask better, int n)
{
	for (int i = 0; i < n; i++)
		to[i] = pick(better, from[i], to[i]);
}

/* Lanes in which the error is the least so far take the model. */
static void compare(const struct gd_lwr_plan *p, struct gd_lwr_batch *t, int r)
{
	vec cost = { 0 }, over = 1.0 / larger(t->a[0], splat(1e-300));
	int any = 0;
	mask better;

	for (int c = 0; c < p->nc; c++)
		cost += t->scale[c] * t->acc[c];
	cost *= over;
	better = r == 1 || r <= p->radius_min ? (mask){ 0 } == 0 : cost < t->least;
	for (int l = 0; l < LANES; l++) {
		better[l] = t->done[l] ? 0 : better[l];
		any |= better[l] != 0;
		t->done[l] |= t->least[l] > 0 && cost[l] > HOPELESS * t->least[l] &&
			      r >= t->radius[l] + 3;
	}
	if (!any)
		return;
	t->least = pick(better, cost, t->least);
	t->radius = pick(better, splat(r), t->radius);
	t->features = pick(better, t->helping, t->features);
	for (int c = 0; c < p->nc; c++)
		t->xi[c] = pick(better, t->acc[c] * over, t->xi[c]);
	take_over(t->best, t->b, better, p->p * p->nc);
	if (p->ny == p->nc)
		return;
	take_over(t->best_l, t->l, better, p->p * (p->p + p->nc));
	take_over(t->best_inv, t->inv, better, p->p);
}

/* Weights of the channels in the choice: by their squared mean in the first window. */
static void weigh(const struct gd_lwr_plan *p, struct gd_lwr_batch *t)
{
	vec over = 1.0 / larger(t->a[0], splat(1e-300));

	for (int c = 0; c < p->nc; c++) {
		vec mean = t->a[p->p + c] * over;

		for (int l = 0; l < LANES; l++)
			mean[l] += t->ref[l][p->p + c];
		t->scale[c] = 1.0 / (mean * mean + p->level2);
	}
}

/* One vector of each lane becomes one vector of lanes for each number. */
GD_LWR_INLINE void turn(const double *const *from, size_t at, vec *to)
{
#if GD_LWR_LANES == 4
	typedef long long pick __attribute__((vector_size(32)));
	vec a = *(const gd_lwr_any *)(from[0] + at), b = *(const gd_lwr_any *)(from[1] + at);
	vec c = *(const gd_lwr_any *)(from[2] + at), d = *(const gd_lwr_any *)(from[3] + at);
	vec ab0 = __builtin_shuffle(a, b, (pick){ 0, 4, 2, 6 });
	vec ab1 = __builtin_shuffle(a, b, (pick){ 1, 5, 3, 7 });
	vec cd0 = __builtin_shuffle(c, d, (pick){ 0, 4, 2, 6 });
	vec cd1 = __builtin_shuffle(c, d, (pick){ 1, 5, 3, 7 });

	to[0] = __builtin_shuffle(ab0, cd0, (pick){ 0, 1, 4, 5 });
	to[1] = __builtin_shuffle(ab1, cd1, (pick){ 0, 1, 4, 5 });
	to[2] = __builtin_shuffle(ab0, cd0, (pick){ 2, 3, 6, 7 });
	to[3] = __builtin_shuffle(ab1, cd1, (pick){ 2, 3, 6, 7 });
#else
	for (int e = 0; e < LANES; e++)
		for (int l = 0; l < LANES; l++)
			to[e][l] = from[l][at + (size_t)e];
#endif
}

/* n numbers of every lane from `at` on. */
static void turn_all(double *const *from, size_t at, int n, vec *to)
{
	const double *lane[LANES];
	vec last[LANES];
	int k = 0;

	for (int l = 0; l < LANES; l++)
		lane[l] = from[l] + at;
	for (; k + LANES <= n; k += LANES)
		turn(lane, (size_t)k, to + k);
	if (k == n)
		return;
	turn(lane, (size_t)k, last);
	for (int e = 0; k < n; k++, e++)
		to[k] = last[e];
}

/* From the moments of each lane's ring to one vector per number. */
static void gather(const struct gd_lwr_plan *p, struct gd_lwr_batch *t)
{
	const int pitch = gd_lwr_pitch(p->q);

	for (int i = 0; i < p->p; i++) {
		int first = i / LANES * LANES;

		turn_all(t->m, (size_t)(i * pitch + first), p->q - first,
			 t->ring + i * p->q + first);
	}
	turn_all(t->sums, 0, p->nc + p->nvar + p->nfv, t->rs);
}

/* Sums of the ring r of every lane that still grows; returns how many have any pixels. */
static int measure(const struct gd_lwr_plan *p, struct gd_lwr_batch *t, int r)
{
	const int pitch = gd_lwr_pitch(p->q);
	int growing = 0;

	for (int l = 0; l < LANES; l++) {
		struct gd_lwr_ring ring = { .z = t->z, .m = t->m[l], .s = t->sums[l] };

		if (t->done[l])
			continue;
		gd_lwr_ring_pixels(p, t->x[l], t->y[l], r, t->ref[l], &ring);
		gd_lwr_ring_sums(p, &ring);
		t->pixels[l] += ring.n;
		growing += ring.n > 0;
		for (int k = 0; r == 1 && k < 9; k++)
			for (int j = 0; j < p->q; j++)
				t->first[k * p->q + j][l] = k < ring.n ? ring.z[k * pitch + j] : 0;
	}
	if (growing)
		gather(p, t);
	return growing;
}

static void total(const struct gd_lwr_plan *p, struct gd_lwr_batch *t, int first)
{
	const int sums = p->nc + p->nvar + p->nfv;

	for (int i = 0; i < p->p; i++)
		for (int j = i; j < p->p + p->nc; j++)
			t->a[i * p->q + j] = first ? t->ring[i * p->q + j] :
						     t->a[i * p->q + j] + t->ring[i * p->q + j];
	for (int i = 0; i < sums; i++)
		t->s[i] = first ? t->rs[i] : t->s[i] + t->rs[i];
}

void gd_lwr_fit_batch(const struct gd_lwr_plan *p, struct gd_lwr_batch *t)
{
	for (int l = 0; l < LANES; l++) {
		t->done[l] = l >= t->n;
		t->pixels[l] = 0;
		if (l < t->n)
			gd_lwr_reference(p, t->x[l], t->y[l], t->ref[l]);
	}
	for (int r = 1; r <= p->radius && measure(p, t, r); r++) {
		if (r > 1 && p->nc == 3)
			ring_error(p, t, 3);
		else if (r > 1)
			ring_error(p, t, 1);
		total(p, t, r == 1);
		decompose(p, t);
		if (p->nc == 3)
			solve_back(p, t->l, t->inv, t->b, 3);
		else
			solve_back(p, t->l, t->inv, t->b, 1);
		if (r == 1) {
			weigh(p, t);
			first_error(p, t);
		}
		compare(p, t, r);
	}
}

void gd_lwr_other_sums(const struct gd_lwr_plan *p, struct gd_lwr_batch *t, int l)
{
	const int others = p->ny - p->nc, r = (int)t->radius[l];

	for (int i = 0; i < p->p * others; i++)
		t->other[i][l] = 0;
	for (int y = t->y[l] - r; y <= t->y[l] + r; y++) {
		if (y < 0 || y >= p->h)
			continue;
		for (int x = t->x[l] - r; x <= t->x[l] + r; x++) {
			if (x < 0 || x >= p->w)
				continue;
			gd_lwr_ring_pixel(p, x, y, t->x[l], t->y[l], t->ref[l], t->z);
			for (int j = 0; j < p->p; j++)
				for (int c = 0; c < others; c++)
					t->other[j * others + c][l] +=
						t->z[j] * t->z[0] *
						(double)gd_row(p->y[p->nc + c], y)[x];
		}
	}
}

void gd_lwr_fit_others(const struct gd_lwr_plan *p, struct gd_lwr_batch *t)
{
	const int others = p->ny - p->nc;

	for (int l = 0; l < t->n; l++)
		gd_lwr_other_sums(p, t, l);
	substitute(p, t->best_l, p->p + p->nc, t->best_inv, t->other, t->other_b, others);
}
