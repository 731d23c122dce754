/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Sums of products over the windows of one row of centres.
 *
 * Blocks of GD_LANES pixel columns run from left to right. In each, the products are summed down
 * the window's rows ("vertical sums"), and those are added, times the kernel, to every window
 * that reaches the block. A finished window goes into a batch, a full batch to the solver.
 *
 * K stands for the kernel times the pixel's weight. Order of the vertical sums with weight K: [1*z | 1*y | 1*var | 1*feat_var | y*y], then for each
 * vertical column a >= 1: [a*z_b, b >= a | a*y]. With weight K^2 var: for each a [a*z_b, b >= a].
 * A window keeps them all with the plain kernel, then the leading `first` ones with each power
 * u .. u^order, then sum 0 with u^(order+1) .. u^(2 order).
 */
#include <string.h>

#include "../apr_impl.h"

/* The layout of one kind of sums. */
struct sums {
	int first, nvert, total;
};

/* One thread's work space. */
struct space {
	gd_vec *z, *o, *wt, *wa;	/* window rows: vertical columns; y, var, feat_var; pixel weights;
					 * weighted column */
	gd_vec *vert;			/* vertical sums of one block */
	gd_vec *acc;			/* slots of sums of windows under way */
	int *map_a, *map_b, *map_m;	/* where the solver's entries are in a window's sums */
	int slots;
	struct sums one, two;		/* weight K, and K^2 var for each of nv */
	size_t slot;			/* vectors per window */
	struct gd_apr_batch batch;
};

static struct sums sums_plain(const struct gd_apr_plan *p)
{
	struct sums s;

	s.first = p->pv + p->ny;
	s.nvert = p->pv + p->ny + 2 * p->nv + p->nfv;
	for (int a = 1; a < p->pv; a++)
		s.nvert += p->pv - a + p->ny;
	s.total = s.nvert + p->order * s.first + p->order;
	return s;
}

static struct sums sums_noise(const struct gd_apr_plan *p)
{
	struct sums s = { p->pv, p->pv * (p->pv + 1) / 2, 0 };

	s.total = s.nvert + p->order * s.first + p->order;
	return s;
}

/* Windows that can be under way at once: those that reach a block of GD_LANES columns. */
static int most_windows(const struct gd_apr_plan *p)
{
	int most = 1;

	for (int j = 0, k = 0; j < p->nx; j++) {
		while (p->cx[j] - p->cx[k] > 2 * p->radius + 2 * GD_LANES)
			k++;
		if (j - k + 1 > most)
			most = j - k + 1;
	}
	return most;
}

/* Cuts the work space up, or only counts it (work NULL). Returns its size in doubles. */
static size_t lay_out(struct space *s, const struct gd_apr_plan *p, double *work)
{
	size_t rows = 2 * (size_t)p->radius + 1, tri = (size_t)p->p * (p->p + 1) / 2, n = 0;
	size_t no = (size_t)(p->ny + p->nv + p->nfv);

	s->one = sums_plain(p);
	s->two = sums_noise(p);
	s->slots = most_windows(p);
	s->slot = (size_t)s->one.total + (size_t)p->nv * s->two.total;
#define TAKE(ptr, count) (ptr = (void *)(work ? work + n : NULL), n += ((size_t)(count) + 7) / 8 * 8)
	TAKE(s->z, rows * p->pv * GD_LANES);
	TAKE(s->o, rows * no * GD_LANES);
	TAKE(s->wt, rows * GD_LANES);
	TAKE(s->wa, rows * GD_LANES);
	TAKE(s->vert, (size_t)(s->one.nvert + s->two.nvert) * GD_LANES);
	TAKE(s->acc, (size_t)s->slots * s->slot * GD_LANES);
	TAKE(s->batch.a, tri * GD_LANES);
	TAKE(s->batch.b, (size_t)p->p * p->ny * GD_LANES);
	TAKE(s->batch.m, (size_t)p->nv * tri * GD_LANES);
	TAKE(s->batch.s, (size_t)(2 * p->nv + p->nfv) * GD_LANES);
	TAKE(s->batch.work, gd_apr_solve_size(p));
	TAKE(s->map_a, tri);		/* ints: half of it */
	TAKE(s->map_b, (size_t)p->p * p->ny);
	TAKE(s->map_m, tri);
#undef TAKE
	return n;
}

static size_t fit_size(const struct gd_apr_plan *plan)
{
	struct space s;

	return lay_out(&s, plan, NULL);
}

/* A model column: the power of u it carries, and its vertical column (0 if it is a power of u). */
static void column_of(const struct gd_apr_plan *p, int c, int *power, int *vertical)
{
	int q = c - 1 - p->nf;

	*power = q >= 0 && q % 2 == 0 ? q / 2 + 1 : 0;
	*vertical = q < 0 ? c : q % 2 ? p->nf + q / 2 + 1 : 0;
}

/* Where the sum of the product of two model columns is. ny: right-hand sides between the columns' rows. */
static int place(const struct gd_apr_plan *p, struct sums s, int ny, int lead, int i, int j)
{
	int ui, vi, uj, vj, k, a, b, at;

	column_of(p, i, &ui, &vi);
	column_of(p, j, &uj, &vj);
	k = ui + uj;
	if (k > p->order)
		return s.nvert + p->order * s.first + k - p->order - 1;
	if (k > 0)	/* one of vi, vj is column 0 */
		return s.nvert + (k - 1) * s.first + vi + vj;
	a = vi < vj ? vi : vj;
	b = vi < vj ? vj : vi;
	at = a == 0 ? 0 : lead;
	for (int t = 1; t < a; t++)
		at += p->pv - t + ny;
	return at + b - a;
}

static void make_maps(struct space *s, const struct gd_apr_plan *p)
{
	int lead = p->pv + p->ny + 2 * p->nv + p->nfv;

	for (int i = 0, e = 0; i < p->p; i++) {
		int power, vertical;

		for (int j = 0; j <= i; j++, e++) {
			s->map_a[e] = place(p, s->one, p->ny, lead, i, j);
			s->map_m[e] = place(p, s->two, 0, p->pv, i, j);
		}
		column_of(p, i, &power, &vertical);
		for (int c = 0; c < p->ny; c++) {
			int at = p->pv + c;

			if (power > 0)
				at = s->one.nvert + (power - 1) * s->one.first + p->pv + c;
			else if (vertical > 0)
				at = place(p, s->one, p->ny, lead, i, i) + p->pv - vertical + c;
			s->map_b[i * p->ny + c] = at;
		}
	}
}

/* Reads a block of a plane row, less a constant; pixels beyond the image are 0. */
static inline gd_vec load(struct gd_plane plane, int x, int y, double minus)
{
	const float *row = gd_row(plane, y) + x;
	gd_vec v;

	for (int l = 0; l < GD_LANES; l++)
		v[l] = x + l < plane.w ? (double)row[l] - minus : 0.0;
	return v;
}

/* Fills s->z, s->o and s->wt with the window rows y0 .. y1 at columns x .. */
static void load_block(struct space *s, const struct gd_apr_plan *p, int row, int x, int y0, int y1)
{
	int no = p->ny + p->nv + p->nfv;
	double over_r = 1.0 / (p->radius > 0 ? p->radius : 1);

	for (int y = y0; y <= y1; y++) {
		gd_vec *z = s->z + (size_t)(y - y0) * p->pv, *o = s->o + (size_t)(y - y0) * no;
		double v = (y - p->cy[row]) * over_r;
		gd_vec one = { 0 };

		for (int l = 0; l < GD_LANES; l++)
			one[l] = x + l < p->w ? 1.0 : 0.0;
		z[0] = one;
		s->wt[y - y0] = p->weight.v ? load(p->weight, x, y, 0) : one;
		for (int a = 0; a < p->nf; a++)
			z[1 + a] = load(p->feat[a], x, y, p->ref[a]);
		for (int k = 1; k <= p->order; k++)
			z[p->nf + k] = one = one * v;
		for (int c = 0; c < p->ny; c++)
			*o++ = load(p->y[c], x, y, 0);
		for (int c = 0; c < p->nv; c++)
			*o++ = load(p->var[c], x, y, 0);
		for (int a = 0; a < p->nfv; a++)
			*o++ = load(p->feat_var[a], x, y, 0);
	}
}

/* out[i] = sum over rows of wa * z[i], n <= 8 (a constant where it is called). */
static inline __attribute__((always_inline)) void
dot(gd_vec *restrict out, const gd_vec *restrict wa, const gd_vec *restrict z, int rows, int stride, int n)
{
	gd_vec s[8] = { { 0 } };

	for (int y = 0; y < rows; y++) {
		gd_vec w = wa[y];

		for (int i = 0; i < n; i++)
			s[i] += w * z[(size_t)y * stride + i];
	}
	for (int i = 0; i < n; i++)
		out[i] = s[i];
}

static void dots(gd_vec *restrict out, const gd_vec *restrict wa, const gd_vec *restrict z,
		 int rows, int stride, int n)
{
	for (; n >= 8; n -= 8, out += 8, z += 8)
		dot(out, wa, z, rows, stride, 8);
	if (n >= 4) {
		dot(out, wa, z, rows, stride, 4);
		n -= 4;
		out += 4;
		z += 4;
	}
	if (n == 3)
		dot(out, wa, z, rows, stride, 3);
	else if (n == 2)
		dot(out, wa, z, rows, stride, 2);
	else if (n == 1)
		dot(out, wa, z, rows, stride, 1);
}

/* Vertical sums with weight kv (K along y). */
static void vertical_plain(struct space *s, const struct gd_apr_plan *p, const double *kv, int rows)
{
	int no = p->ny + p->nv + p->nfv;
	gd_vec *out = s->vert;

	for (int y = 0; y < rows; y++)
		s->wa[y] = kv[y] * s->wt[y];
	dots(out, s->wa, s->z, rows, p->pv, p->pv);
	dots(out + p->pv, s->wa, s->o, rows, no, no);
	out += p->pv + no;
	for (int c = 0; c < p->nv; c++) {
		for (int y = 0; y < rows; y++)
			s->wa[y] = kv[y] * s->wt[y] * s->o[(size_t)y * no + c];
		dots(out++, s->wa, s->o + c, rows, no, 1);
	}
	for (int a = 1; a < p->pv; a++) {
		for (int y = 0; y < rows; y++)
			s->wa[y] = kv[y] * s->wt[y] * s->z[(size_t)y * p->pv + a];
		dots(out, s->wa, s->z + a, rows, p->pv, p->pv - a);
		out += p->pv - a;
		dots(out, s->wa, s->o, rows, no, p->ny);
		out += p->ny;
	}
}

/* Vertical sums with weight kv (K^2 along y) times variance c. */
static void vertical_noise(struct space *s, const struct gd_apr_plan *p, const double *kv, int rows, int c)
{
	int no = p->ny + p->nv + p->nfv;
	gd_vec *out = s->vert;

	for (int a = 0; a < p->pv; a++) {
		for (int y = 0; y < rows; y++)
			s->wa[y] = kv[y] * s->wt[y] * s->wt[y] * s->o[(size_t)y * no + p->ny + c] * s->z[(size_t)y * p->pv + a];
		dots(out, s->wa, s->z + a, rows, p->pv, p->pv - a);
		out += p->pv - a;
	}
}

/* Adds the vertical sums of a block to one window's sums; k: kernel tables at the block's first column. */
static void add_block(gd_vec *restrict acc, const gd_vec *restrict vert, struct sums s, int order,
		      const double (*table)[GD_APR_TAPS], int at)
{
	gd_vec k = *(const gd_vec_any *)(table[0] + at);

	for (int e = 0; e < s.nvert; e++)
		acc[e] += k * vert[e];
	acc += s.nvert;
	for (int q = 1; q <= order; q++, acc += s.first) {
		k = *(const gd_vec_any *)(table[q] + at);
		for (int e = 0; e < s.first; e++)
			acc[e] += k * vert[e];
	}
	for (int q = order + 1; q <= 2 * order; q++)
		*acc++ += *(const gd_vec_any *)(table[q] + at) * vert[0];
}

static inline double lanes_sum(gd_vec v)
{
	double s = 0;

	for (int l = 0; l < GD_LANES; l++)
		s += v[l];
	return s;
}

/* Moves a finished window into the batch. */
static void finish_window(struct space *s, const struct gd_apr_plan *p, const gd_vec *acc, int j)
{
	struct gd_apr_batch *b = &s->batch;
	int lane = b->n, tri = p->p * (p->p + 1) / 2, no = p->ny + p->nv + p->nfv;

	for (int e = 0; e < tri; e++)
		b->a[e * GD_LANES + lane] = lanes_sum(acc[s->map_a[e]]);
	for (int e = 0; e < p->p * p->ny; e++)
		b->b[e * GD_LANES + lane] = lanes_sum(acc[s->map_b[e]]);
	for (int c = 0; c < p->nv; c++) {
		b->s[c * GD_LANES + lane] = lanes_sum(acc[p->pv + no + c]);
		b->s[(p->nv + c) * GD_LANES + lane] = lanes_sum(acc[p->pv + p->ny + c]);
	}
	for (int a = 0; a < p->nfv; a++)
		b->s[(2 * p->nv + a) * GD_LANES + lane] = lanes_sum(acc[p->pv + p->ny + p->nv + a]);
	acc += s->one.total;
	for (int c = 0; c < p->nv; c++, acc += s->two.total)
		for (int e = 0; e < tri; e++)
			b->m[(c * tri + e) * GD_LANES + lane] = lanes_sum(acc[s->map_m[e]]);
	b->at[b->n++] = j;
}

static void fit_row(const struct gd_apr_plan *p, int row, double *work)
{
	struct space s;
	int r = p->radius, cy = p->cy[row];
	int y0 = cy - r > 0 ? cy - r : 0, y1 = cy + r < p->h - 1 ? cy + r : p->h - 1, rows = y1 - y0 + 1;
	const double *k1 = p->k1[0] + GD_APR_PAD + r + y0 - cy, *k2 = p->k2[0] + GD_APR_PAD + r + y0 - cy;
	int lo = 0, hi = 0;	/* windows under way: lo .. hi - 1 */

	memset(work, 0, lay_out(&s, p, work) * sizeof *work);
	lay_out(&s, p, work);
	s.batch.n = 0;
	make_maps(&s, p);
	for (int x = 0; x < p->w; x += GD_LANES) {
		for (; hi < p->nx && p->cx[hi] - r < x + GD_LANES; hi++)
			memset(s.acc + (size_t)(hi % s.slots) * s.slot, 0, s.slot * sizeof *s.acc);
		load_block(&s, p, row, x, y0, y1);
		for (int c = -1; c < p->nv; c++) {
			struct sums kind = c < 0 ? s.one : s.two;
			size_t skip = c < 0 ? 0 : (size_t)s.one.total + (size_t)c * s.two.total;

			if (c < 0)
				vertical_plain(&s, p, k1, rows);
			else
				vertical_noise(&s, p, k2, rows, c);
			for (int j = lo; j < hi; j++)
				add_block(s.acc + (size_t)(j % s.slots) * s.slot + skip, s.vert, kind, p->order,
					  c < 0 ? p->k1 : p->k2, GD_APR_PAD + r + x - p->cx[j]);
		}
		for (; lo < hi && (p->cx[lo] + r < x + GD_LANES || x + GD_LANES >= p->w); lo++) {
			finish_window(&s, p, s.acc + (size_t)(lo % s.slots) * s.slot, lo);
			if (s.batch.n == GD_LANES || lo == p->nx - 1) {
				gd_apr_solve(p, row, &s.batch);
				s.batch.n = 0;
			}
		}
	}
}

const struct gd_apr_kernels GD_KERNEL(gd_apr_kernels) = {
	GD_LANES, fit_size, fit_row, gd_apr_predict_size, gd_apr_predict_row
};
