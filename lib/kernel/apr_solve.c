/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * The fits of a batch of windows, one window per lane, from their sums.
 *
 * With A = sum K z z' = L L' and t = L^-1 sum K z y, column q of the orthonormal form explains
 * t_q^2 of the window's weighted square and carries noise V_q = (L^-1 M L^-T)_qq, where
 * M = sum K^2 var z z'. Using it changes the expected error by V_q - (t_q^2 - V_q). The columns
 * come in the order of the polynomial's, so all orders share one factor and an order's cost is a
 * partial sum.
 */
#include <math.h>
#include <stdint.h>

#include "../apr_impl.h"

typedef int64_t mask __attribute__((vector_size(8 * GD_LANES)));

/*
 * A column is left out where what remains of it, after those before it, is rounding: below RAW of
 * its own square about the image's median (products of doubles cancel to a few 1e-16 of that) or
 * COLLINEAR of its square about the window's mean (1e-4 of its spread: less cannot be told from
 * float rounding once coefficients multiply it).
 */
#define RAW 1e-12
#define COLLINEAR 1e-8

struct factor {
	gd_vec *inv;	/* p: 1 / L_jj, 0 for a column left out */
	gd_vec *t;	/* p * ny */
	gd_vec *w;	/* L^-1, lower triangle */
	gd_vec *noise;	/* p * nv: V */
};

static inline gd_vec pick(mask m, gd_vec a, gd_vec b)
{
	return (gd_vec)(((mask)a & m) | ((mask)b & ~m));
}

static inline gd_vec splat(double x)
{
	return x - (gd_vec){ 0 };
}

static inline gd_vec larger(gd_vec a, gd_vec b)
{
	return pick(a > b, a, b);
}

static inline gd_vec *tri_row(gd_vec *a, int i)
{
	return a + (size_t)i * (i + 1) / 2;
}

size_t gd_apr_solve_size(const struct gd_apr_plan *plan)
{
	size_t p = (size_t)plan->p;

	return GD_LANES * (p + p * plan->ny + p * (p + 1) / 2 + p * plan->nv);
}

static struct factor lay_out(const struct gd_apr_plan *plan, gd_vec *work)
{
	struct factor f;
	size_t p = (size_t)plan->p;

	f.inv = work;
	f.t = f.inv + p;
	f.w = f.t + p * plan->ny;
	f.noise = f.w + p * (p + 1) / 2;
	return f;
}

/* Noise of feature column j in the window, times feature_noise; 0 for exact and other columns. */
static gd_vec feature_noise(const struct gd_apr_plan *p, const gd_vec *s, int j)
{
	for (int a = 0; a < p->nfv; a++)
		if (p->noisy[a] == j - 1)
			return p->noise * s[2 * p->nv + a];
	return (gd_vec){ 0 };
}

/* A = L L', in place, leaving out columns without substance; f->inv as described. */
static void decompose(const struct gd_apr_plan *p, gd_vec *a, const gd_vec *s, struct factor *f)
{
	gd_vec weight = a[0];

	for (int j = 0; j < p->p; j++) {
		gd_vec *lj = tri_row(a, j), d = lj[j], least;

		for (int i = 0; i < j; i++) {
			gd_vec *li = tri_row(a, i), x = lj[i];

			for (int k = 0; k < i; k++)
				x -= lj[k] * li[k];
			lj[i] = x * f->inv[i];
		}
		least = RAW * d;
		if (j > 0) {
			gd_vec spread = d - lj[0] * lj[0];

			least = larger(least, COLLINEAR * spread);
			d += p->ridge * larger(spread, (gd_vec){ 0 });
			if (j <= p->nf)
				d += p->flat[j - 1] * weight;
			least = larger(least, feature_noise(p, s, j));
			if (j <= p->nf)
				least = larger(least, p->floor[j - 1] * weight);
		}
		for (int k = 0; k < j; k++)
			d -= lj[k] * lj[k];
		for (int l = 0; l < GD_LANES; l++)
			f->inv[j][l] = d[l] > least[l] ? 1.0 / sqrt(d[l]) : 0.0;
	}
}

/* t = L^-1 b */
static void project(const struct gd_apr_plan *p, gd_vec *l, const gd_vec *b, struct factor *f)
{
	for (int j = 0; j < p->p; j++)
		for (int c = 0; c < p->ny; c++) {
			gd_vec x = b[j * p->ny + c];
			const gd_vec *lj = tri_row(l, j);

			for (int k = 0; k < j; k++)
				x -= lj[k] * f->t[k * p->ny + c];
			f->t[j * p->ny + c] = x * f->inv[j];
		}
}

/* V = diag(L^-1 M L^-T) for every variance plane. */
static void noise(const struct gd_apr_plan *p, gd_vec *l, gd_vec *m, struct factor *f)
{
	size_t tri = (size_t)p->p * (p->p + 1) / 2;

	for (int j = 0; j < p->p; j++) {
		gd_vec *lj = tri_row(l, j), *wj = tri_row(f->w, j);

		for (int i = 0; i < j; i++)
			wj[i] = (gd_vec){ 0 };
		for (int k = 0; k < j; k++) {
			const gd_vec *wk = tri_row(f->w, k);
			gd_vec x = lj[k] * f->inv[j];

			for (int i = 0; i <= k; i++)
				wj[i] -= x * wk[i];
		}
		wj[j] = f->inv[j];
		for (int c = 0; c < p->nv; c++) {
			gd_vec sum = { 0 };

			for (int i = 0; i <= j; i++) {
				const gd_vec *mi = tri_row(m + c * tri, i);
				gd_vec x = { 0 };

				for (int k = 0; k < i; k++)
					x += mi[k] * wj[k];
				sum += wj[i] * (2.0 * x + mi[i] * wj[i]);
			}
			f->noise[j * p->nv + c] = larger(p->correlation * sum, (gd_vec){ 0 });
		}
	}
}

/* The order of least estimated error, all channels with a variance together; ties: the smaller. */
static gd_vec choose(const struct gd_apr_plan *p, gd_vec weight, const gd_vec *b,
		     const struct factor *f)
{
	gd_vec best = splat(p->order_min), cost = { 0 }, least = { 0 }, scale[GD_APR_RHS];

	if (p->order == p->order_min)
		return best;
	for (int c = 0; c < p->nv; c++) {
		gd_vec mean = b[c] / larger(weight, splat(1e-300));

		scale[c] = 1.0 / (mean * mean + p->level2);
	}
	for (int k = p->order_min + 1; k <= p->order; k++) {
		mask better;

		for (int j = p->nf + 2 * k - 1; j <= p->nf + 2 * k; j++)
			for (int c = 0; c < p->nv; c++) {
				gd_vec t = f->t[j * p->ny + c];

				cost += scale[c] * (2.0 * f->noise[j * p->nv + c] - t * t);
			}
		better = cost < least;
		best = pick(better, splat(k), best);
		least = pick(better, cost, least);
	}
	return best;
}

/* Squared error per pixel of channel c: what the columns in use leave, and the noise they carry. */
static gd_vec error_of(const struct gd_apr_plan *p, gd_vec weight, const gd_vec *s,
		       const struct factor *f, int c)
{
	gd_vec bias = s[c] - s[p->nv + c], carried = { 0 };

	for (int j = 0; j < p->p; j++) {
		gd_vec t = f->t[j * p->ny + c], v = f->noise[j * p->nv + c];

		bias -= t * t - v;
		carried += v;
	}
	return (larger(bias, (gd_vec){ 0 }) + carried) / larger(weight, splat(1e-300));
}

/* b = L^-T t for right-hand side c, into t. */
static void coefficients(const struct gd_apr_plan *p, gd_vec *l, struct factor *f, int c)
{
	for (int j = p->p - 1; j >= 0; j--) {
		gd_vec x = f->t[j * p->ny + c] * f->inv[j];
		const gd_vec *lj = tri_row(l, j);

		f->t[j * p->ny + c] = x;
		for (int i = 0; i < j; i++)
			f->t[i * p->ny + c] -= lj[i] * x;
	}
}

static void store(const struct gd_apr_plan *p, int row, int m, const struct gd_apr_batch *batch,
		  gd_vec v)
{
	double *to = gd_apr_model(p, row, m);

	for (int l = 0; l < batch->n; l++)
		to[batch->at[l]] = v[l];
}

void gd_apr_solve(const struct gd_apr_plan *p, int row, struct gd_apr_batch *batch)
{
	gd_vec *a = (gd_vec *)batch->a, *s = (gd_vec *)batch->s, *b = (gd_vec *)batch->b;
	struct factor f = lay_out(p, (gd_vec *)batch->work);
	gd_vec weight = a[0], order, columns = { 0 };

	decompose(p, a, s, &f);
	project(p, a, b, &f);
	noise(p, a, (gd_vec *)batch->m, &f);
	order = choose(p, weight, b, &f);
	for (int j = 0; j < p->p; j++) {
		mask used = order >= splat(j <= p->nf ? 0 : (j - p->nf + 1) / 2);

		columns += pick(used & (f.inv[j] > 0.0), splat(1), splat(0));
		for (int c = 0; c < p->ny; c++)
			f.t[j * p->ny + c] = pick(used, f.t[j * p->ny + c], splat(0));
		for (int c = 0; c < p->nv; c++)
			f.noise[j * p->nv + c] = pick(used, f.noise[j * p->nv + c], splat(0));
	}
	for (int c = 0; c < p->nv; c++)
		store(p, row, p->ny * p->p + c, batch, error_of(p, weight, s, &f, c));
	store(p, row, p->ny * p->p + p->nv, batch, order);
	store(p, row, p->ny * p->p + p->nv + 1, batch, columns);
	for (int c = 0; c < p->ny; c++) {
		coefficients(p, a, &f, c);
		for (int j = 0; j < p->p; j++)
			store(p, row, c * p->p + j, batch, f.t[j * p->ny + c]);
	}
}
