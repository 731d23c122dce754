/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * What the windows predict: sum_c K_c(i) b_c' z_i / sum_c K_c(i), without visiting every window for
 * every pixel. As K is a product of a function of x and one of y, and z holds the same features for
 * all windows, the coefficients are spread instead: first along y (to the pixel row, where powers
 * of v become numbers), then along x (with K(u) u^k), and the features are multiplied once per
 * pixel.
 */
#include <float.h>
#include <string.h>

#include "../apr_impl.h"

/* One pixel row's work space. Per right-hand side nt = 1 + nf + order spread coefficients. */
struct space {
	double *t;	/* [ny * nt + extras][nx]: coefficients spread along y */
	double *row;	/* [1 + nf][width]: those of one right-hand side, spread along x */
	int nt, extras;
	size_t width;
};

static size_t lay_out(struct space *s, const struct gd_apr_plan *p, double *work)
{
	size_t n;

	s->nt = 1 + p->nf + p->order;
	s->extras = p->nv + 2;
	s->width = ((size_t)p->w + 7) / 8 * 8;
	n = (size_t)(p->ny * s->nt + s->extras) * p->nx;
	s->t = work;
	s->row = work ? work + (n + 7) / 8 * 8 : NULL;
	return (n + 7) / 8 * 8 + (size_t)(1 + p->nf) * s->width;
}

size_t gd_apr_predict_size(const struct gd_apr_plan *plan)
{
	struct space s;

	return lay_out(&s, plan, NULL);
}

static inline void add_scaled(double *restrict to, double k, const double *restrict from, int n)
{
	for (int j = 0; j < n; j++)
		to[j] += k * from[j];
}

/* Adds one row of centres to s->t, at pixel row y. */
static void spread_y(struct space *s, const struct gd_apr_plan *p, int row, int y)
{
	int at = GD_APR_PAD + p->radius + y - p->cy[row], n = p->nx;
	double *t = s->t;

	for (int c = 0; c < p->ny; c++, t += (size_t)s->nt * n) {
		const double *b = gd_apr_model(p, row, c * p->p);

		for (int a = 0; a <= p->nf; a++)
			add_scaled(t + (size_t)a * n, p->k1[0][at], b + (size_t)a * n, n);
		b += (size_t)(1 + p->nf) * n;
		for (int k = 1; k <= p->order; k++, b += 2 * (size_t)n) {
			add_scaled(t + (size_t)(p->nf + k) * n, p->k1[0][at], b, n);	/* u^k */
			add_scaled(t, p->k1[k][at], b + n, n);				/* v^k */
		}
	}
	for (int e = 0; e < s->extras; e++)
		add_scaled(t + (size_t)e * n, p->k1[0][at], gd_apr_model(p, row, p->ny * p->p + e),
			   n);
}

/* Centres whose windows reach the vector of pixels at x: *lo .. *hi - 1. Call with growing x. */
static inline void reach(const struct gd_apr_plan *p, int x, int *lo, int *hi)
{
	while (*hi < p->nx && p->cx[*hi] - p->radius < x + GD_LANES)
		++*hi;
	while (p->cx[*lo] + p->radius < x)
		++*lo;
}

/* row[i][x ..] = sum over centres j of K t[i][j], n <= 4 planes (a constant where it is called). */
static inline __attribute__((always_inline)) void
gather(double *restrict row, size_t width, const double *restrict t, const struct gd_apr_plan *p,
       int x, int lo, int hi, int n)
{
	const double *k = p->k1[0] + GD_APR_PAD + p->radius + x;
	gd_vec sum[4] = { { 0 } };

	for (int j = lo; j < hi; j++) {
		gd_vec kj = *(const gd_vec_any *)(k - p->cx[j]);

		for (int i = 0; i < n; i++)
			sum[i] += kj * t[(size_t)i * p->nx + j];
	}
	for (int i = 0; i < n; i++)
		*(gd_vec *)(row + (size_t)i * width + x) = sum[i];
}

/* Spreads n planes along x. */
static void spread_x(double *row, size_t width, const double *t, const struct gd_apr_plan *p, int n)
{
	size_t nx = (size_t)p->nx;

	for (int x = 0, lo = 0, hi = 0; x < p->w; x += GD_LANES) {
		int i = 0;

		reach(p, x, &lo, &hi);
		for (; i + 4 <= n; i += 4)
			gather(row + i * width, width, t + i * nx, p, x, lo, hi, 4);
		for (; i + 2 <= n; i += 2)
			gather(row + i * width, width, t + i * nx, p, x, lo, hi, 2);
		if (i < n)
			gather(row + i * width, width, t + i * nx, p, x, lo, hi, 1);
	}
}

/* row += the planes of powers u .. u^order, spread along x. */
static void spread_powers(double *restrict row, const double *restrict t,
			  const struct gd_apr_plan *p)
{
	for (int x = 0, lo = 0, hi = 0; x < p->w; x += GD_LANES) {
		gd_vec sum = *(gd_vec *)(row + x);

		reach(p, x, &lo, &hi);
		for (int k = 1; k <= p->order; k++) {
			const double *table = p->k1[k] + GD_APR_PAD + p->radius + x;
			const double *tk = t + (size_t)(k - 1) * p->nx;

			for (int j = lo; j < hi; j++)
				sum += *(const gd_vec_any *)(table - p->cx[j]) * tk[j];
		}
		*(gd_vec *)(row + x) = sum;
	}
}

static void finish(struct gd_plane out, int y, const double *restrict row,
		   const struct gd_apr_plan *p)
{
	float *restrict to = gd_row(out, y);
	double sy = p->sumy[y];

	for (int x = 0; x < p->w; x++) {
		double v = row[x] / (p->sumx[x] * sy);

		v = v < -(double)FLT_MAX ? -(double)FLT_MAX : v;
		to[x] = (float)(v > (double)FLT_MAX ? (double)FLT_MAX : v);
	}
}

/* row += (f - ref) * coefficient */
static void add_feature(double *restrict row, const double *restrict coefficient,
			const float *restrict f, double ref, int n)
{
	for (int x = 0; x < n; x++)
		row[x] += coefficient[x] * ((double)f[x] - ref);
}

void gd_apr_predict_row(const struct gd_apr_plan *p, const struct gd_apr_out *out, int y,
			double *work)
{
	struct space s;
	const double *t;

	lay_out(&s, p, work);
	memset(s.t, 0, (size_t)(p->ny * s.nt + s.extras) * p->nx * sizeof *s.t);
	for (int i = 0; i < p->nrow; i++)
		if (y - p->cy[i] <= p->radius && p->cy[i] - y <= p->radius)
			spread_y(&s, p, i, y);
	t = s.t;
	for (int c = 0; c < p->ny; c++) {
		spread_x(s.row, s.width, t, p, 1 + p->nf);
		t += (size_t)(1 + p->nf) * p->nx;
		spread_powers(s.row, t, p);
		t += (size_t)p->order * p->nx;
		for (int a = 0; a < p->nf; a++)
			add_feature(s.row, s.row + (size_t)(1 + a) * s.width, gd_row(p->feat[a], y),
				    p->ref[a], p->w);
		finish(out->est[c], y, s.row, p);
	}
	for (int e = 0; e < s.extras; e++, t += p->nx) {
		struct gd_plane to = e < p->nv ? (out->mse ? out->mse[e] : (struct gd_plane){ 0 }) :
				     e == p->nv ? out->order : out->columns;

		if (!to.v)
			continue;
		spread_x(s.row, s.width, t, p, 1);
		finish(to, y, s.row, p);
	}
}
