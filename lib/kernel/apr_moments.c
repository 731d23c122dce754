/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Sums of products over the windows of one row of centres.
 *
 * Blocks of GD_LANES pixel columns run from left to right. In each, the products are summed down
 * the window's rows ("vertical sums"), and those of two blocks at a time are added, times the
 * kernel, to every window that reaches them. A finished window goes into a batch, a full batch to
 * the solver.
 *
 * K stands for the kernel times the pixel's weight.
 * Order of the vertical sums with weight K: [1*z | 1*y | 1*var | 1*feat_var | y*y], then for each
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
	gd_vec *z[2], *o[2]; /* window rows of two blocks: vertical columns; y, var, feat_var */
	gd_vec *weight[2];		/* and the pixels' weights, 0 beyond the image */
	gd_vec *kw, *wa;		/* weights of the rows of a sum, and times a column */
	gd_vec *vert[2];		/* vertical sums of two blocks, of all weights */
	gd_vec *acc;			/* slots of sums of windows under way */
	int *map_a, *map_b, *map_m;	/* where the solver's entries are in a window's sums */
	int slots;
	struct sums one, two;		/* weight K, and K^2 var for each of nv */
	size_t slot, nvert;		/* vectors per window, and per block */
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

/* Windows that can be under way at once: those that reach two blocks of GD_LANES columns. */
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
	s->nvert = (size_t)s->one.nvert + (size_t)p->nv * s->two.nvert;
#define TAKE(ptr, count) \
	(ptr = (void *)(work ? work + n : NULL), n += ((size_t)(count) + 7) / 8 * 8)
	for (int b = 0; b < 2; b++) {
		TAKE(s->z[b], rows * p->pv * GD_LANES);
		TAKE(s->o[b], rows * no * GD_LANES);
		TAKE(s->weight[b], rows * GD_LANES);
	}
	TAKE(s->kw, rows * GD_LANES);
	TAKE(s->wa, rows * GD_LANES);
	TAKE(s->vert[0], s->nvert * GD_LANES);
	TAKE(s->vert[1], s->nvert * GD_LANES);
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

/* Where the sum of two model columns' product is. ny: planes y between the columns' rows. */
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

typedef float floats __attribute__((vector_size(4 * GD_LANES), aligned(4)));

/* Reads a block of a plane row, less a constant; pixels beyond the image are 0. */
static inline gd_vec load(struct gd_plane plane, int x, int y, double minus)
{
	const float *row = gd_row(plane, y) + x;
	gd_vec v;

	if (x + GD_LANES <= plane.w)
		return __builtin_convertvector(*(const floats *)row, gd_vec) - minus;
	for (int l = 0; l < GD_LANES; l++)
		v[l] = x + l < plane.w ? (double)row[l] - minus : 0.0;
	return v;
}

/* Reads the window rows of a plane at columns x .. into every step-th vector of both blocks. */
static void load_plane(gd_vec *to0, gd_vec *to1, size_t step, struct gd_plane plane, int x, int y0,
		       int y1, double minus)
{
	for (int y = y0; y <= y1; y++, to0 += step, to1 += step) {
		*to0 = load(plane, x, y, minus);
		*to1 = load(plane, x + GD_LANES, y, minus);
	}
}

/* Fills s->z, s->o and s->weight with the window rows y0 .. y1 at columns x .. */
static void load_blocks(struct space *s, const struct gd_apr_plan *p, int row, int x, int y0,
			int y1)
{
	size_t nz = (size_t)p->pv, no = (size_t)(p->ny + p->nv + p->nfv);
	double over_r = 1.0 / (p->radius > 0 ? p->radius : 1);

	for (int b = 0; b < 2; b++)
		for (int y = y0; y <= y1; y++) {
			gd_vec *z = s->z[b] + (size_t)(y - y0) * nz, one = { 0 };

			for (int l = 0; l < GD_LANES; l++)
				one[l] = x + b * GD_LANES + l < p->w ? 1.0 : 0.0;
			z[0] = s->weight[b][y - y0] = one;
			for (int k = 1; k <= p->order; k++)
				z[p->nf + k] = one = one * ((y - p->cy[row]) * over_r);
		}
	if (p->weight.v)
		load_plane(s->weight[0], s->weight[1], 1, p->weight, x, y0, y1, 0);
	for (int a = 0; a < p->nf; a++)
		load_plane(s->z[0] + 1 + a, s->z[1] + 1 + a, nz, p->feat[a], x, y0, y1, p->ref[a]);
	for (int c = 0; c < p->ny; c++)
		load_plane(s->o[0] + c, s->o[1] + c, no, p->y[c], x, y0, y1, 0);
	for (int c = 0; c < p->nv; c++)
		load_plane(s->o[0] + p->ny + c, s->o[1] + p->ny + c, no, p->var[c], x, y0, y1, 0);
	for (int a = 0; a < p->nfv; a++)
		load_plane(s->o[0] + p->ny + p->nv + a, s->o[1] + p->ny + p->nv + a, no,
			   p->feat_var[a], x, y0, y1, 0);
}

/* out[i] = sum over rows of wa * z[i], n <= 8 (a constant where it is called). */
static inline __attribute__((always_inline)) void
dot(gd_vec *restrict out, const gd_vec *restrict wa, const gd_vec *restrict z, int rows,
    int stride, int n)
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

/* wa = kw times a column of the window rows. */
static void weigh(gd_vec *restrict wa, const gd_vec *restrict kw, const gd_vec *restrict column,
		  int stride, int rows)
{
	for (int y = 0; y < rows; y++)
		wa[y] = kw[y] * column[(size_t)y * stride];
}

/* Vertical sums with weight K; kv: the kernel along y. */
static void vertical_plain(gd_vec *out, struct space *s, int block, const struct gd_apr_plan *p,
			   const double *kv, int rows)
{
	int no = p->ny + p->nv + p->nfv;
	const gd_vec *z = s->z[block], *o = s->o[block];

	for (int y = 0; y < rows; y++)
		s->kw[y] = kv[y] * s->weight[block][y];
	dots(out, s->kw, z, rows, p->pv, p->pv);
	dots(out + p->pv, s->kw, o, rows, no, no);
	out += p->pv + no;
	for (int c = 0; c < p->nv; c++) {
		weigh(s->wa, s->kw, o + c, no, rows);
		dots(out++, s->wa, o + c, rows, no, 1);
	}
	for (int a = 1; a < p->pv; a++) {
		weigh(s->wa, s->kw, z + a, p->pv, rows);
		dots(out, s->wa, z + a, rows, p->pv, p->pv - a);
		out += p->pv - a;
		dots(out, s->wa, o, rows, no, p->ny);
		out += p->ny;
	}
}

/* Vertical sums with weight K^2 var of plane c; kv: the kernel's square along y. */
static void vertical_noise(gd_vec *out, struct space *s, int block, const struct gd_apr_plan *p,
			   const double *kv, int rows, int c)
{
	int no = p->ny + p->nv + p->nfv;
	const gd_vec *z = s->z[block], *var = s->o[block] + p->ny + c, *w = s->weight[block];

	for (int y = 0; y < rows; y++)
		s->kw[y] = kv[y] * w[y] * w[y] * var[(size_t)y * no];
	for (int a = 0; a < p->pv; a++) {
		weigh(s->wa, s->kw, z + a, p->pv, rows);
		dots(out, s->wa, z + a, rows, p->pv, p->pv - a);
		out += p->pv - a;
	}
}

static inline void add_scaled(gd_vec *restrict acc, const gd_vec *restrict v0,
			      const gd_vec *restrict v1, const double *k, int n)
{
	gd_vec k0 = *(const gd_vec_any *)k, k1 = *(const gd_vec_any *)(k + GD_LANES);

	for (int e = 0; e < n; e++)
		acc[e] += k0 * v0[e] + k1 * v1[e];
}

/* Adds the vertical sums of two blocks to one window's; at: their place in the kernel tables. */
static void add_blocks(gd_vec *restrict acc, const gd_vec *v0, const gd_vec *v1, struct sums s,
		       int order, const double (*table)[GD_APR_TAPS], int at)
{
	add_scaled(acc, v0, v1, table[0] + at, s.nvert);
	acc += s.nvert;
	for (int q = 1; q <= order; q++, acc += s.first)
		add_scaled(acc, v0, v1, table[q] + at, s.first);
	for (int q = order + 1; q <= 2 * order; q++, acc++)
		add_scaled(acc, v0, v1, table[q] + at, 1);
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

/* All vertical sums of the two blocks from column x; what is beyond the image counts 0. */
static void sum_blocks(struct space *s, const struct gd_apr_plan *p, int row, int x)
{
	int r = p->radius, cy = p->cy[row];
	int y0 = cy - r > 0 ? cy - r : 0, y1 = cy + r < p->h - 1 ? cy + r : p->h - 1,
	    rows = y1 - y0 + 1;
	int at = GD_APR_PAD + r + y0 - cy;

	load_blocks(s, p, row, x, y0, y1);
	for (int b = 0; b < 2; b++) {
		gd_vec *vert = s->vert[b];

		vertical_plain(vert, s, b, p, p->k1[0] + at, rows);
		vert += s->one.nvert;
		for (int c = 0; c < p->nv; c++, vert += s->two.nvert)
			vertical_noise(vert, s, b, p, p->k2[0] + at, rows, c);
	}
}

/* Adds the sums of the two blocks from column x to windows lo .. hi - 1, weight by weight. */
static void spread_blocks(struct space *s, const struct gd_apr_plan *p, int x, int lo, int hi)
{
	size_t from = 0, to = 0;

	for (int c = -1; c < p->nv; c++) {
		struct sums kind = c < 0 ? s->one : s->two;

		for (int j = lo; j < hi; j++)
			add_blocks(s->acc + (size_t)(j % s->slots) * s->slot + to,
				   s->vert[0] + from, s->vert[1] + from, kind, p->order,
				   c < 0 ? p->k1 : p->k2, GD_APR_PAD + p->radius + x - p->cx[j]);
		from += kind.nvert;
		to += kind.total;
	}
}

static void fit_row(const struct gd_apr_plan *p, int row, double *work)
{
	const int wide = 2 * GD_LANES, r = p->radius;
	struct space s;
	int lo = 0, hi = 0;	/* windows under way: lo .. hi - 1 */

	lay_out(&s, p, work);
	/* a last batch that is not full has lanes of nothing */
	memset(s.batch.a, 0, (size_t)(s.batch.work - s.batch.a) * sizeof(double));
	s.batch.n = 0;
	make_maps(&s, p);
	for (int x = 0; x < p->w; x += wide) {
		for (; hi < p->nx && p->cx[hi] - r < x + wide; hi++)
			memset(s.acc + (size_t)(hi % s.slots) * s.slot, 0, s.slot * sizeof *s.acc);
		sum_blocks(&s, p, row, x);
		spread_blocks(&s, p, x, lo, hi);
		for (; lo < hi && (p->cx[lo] + r < x + wide || x + wide >= p->w); lo++) {
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
