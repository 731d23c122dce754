/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * What the windows predict: sum_c K_c(i) b_c' z_i / sum_c K_c(i), without visiting every window for
 * every pixel. As K is a product of a function of x and one of y, and z holds the same features for
 * all windows, the coefficients are spread instead: first along y (to the pixel row, where powers of
 * v become numbers), then along x (with K(u) u^k), and the features are multiplied once per pixel.
 */
#include <float.h>
#include <string.h>

#include "../apr_impl.h"

/* One pixel row's work space. Per right-hand side nt = 1 + nf + order spread coefficients. */
struct space {
	double *t;	/* [ny * nt + extras][nx]: coefficients spread along y */
	double *row;	/* [ny * (1 + nf) + extras][width]: spread along x */
	int nt, extras, width;
};

static size_t lay_out(struct space *s, const struct gd_apr_plan *p, double *work)
{
	size_t n;

	s->nt = 1 + p->nf + p->order;
	s->extras = p->nv + 2;
	s->width = (p->w + 2 * GD_APR_PAD + 7) / 8 * 8;
	n = (size_t)(p->ny * s->nt + s->extras) * p->nx;
	s->t = work;
	s->row = work ? work + (n + 7) / 8 * 8 : NULL;
	return (n + 7) / 8 * 8 + (size_t)(p->ny * (1 + p->nf) + s->extras) * s->width;
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
		add_scaled(t + (size_t)e * n, p->k1[0][at], gd_apr_model(p, row, p->ny * p->p + e), n);
}

/* Adds, for each centre j, t[j] times its kernel to a row. */
static void spread_x(double *restrict row, const struct gd_apr_plan *p, const double *restrict t, int power)
{
	int r = p->radius;

	for (int j = 0; j < p->nx; j++) {
		int x0 = p->cx[j] - r > 0 ? p->cx[j] - r : 0;
		int x1 = p->cx[j] + r < p->w - 1 ? p->cx[j] + r : p->w - 1;
		const double *k = p->k1[power] + GD_APR_PAD + r + x0 - p->cx[j];
		double *to = row + x0;
		gd_vec v = t[j] - (gd_vec){ 0 };

		/* whole vectors: the kernel's padding and the row's absorb what is beyond x1 */
		for (int i = 0; i <= x1 - x0; i += GD_LANES)
			*(gd_vec_any *)(to + i) += v * *(const gd_vec_any *)(k + i);
	}
}

static void finish(struct gd_plane out, int y, const double *restrict row, const struct gd_apr_plan *p)
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
static void add_feature(double *restrict row, const double *restrict coefficient, const float *restrict f,
			double ref, int n)
{
	for (int x = 0; x < n; x++)
		row[x] += coefficient[x] * ((double)f[x] - ref);
}

void gd_apr_predict_row(const struct gd_apr_plan *p, const struct gd_apr_out *out, int y, double *work)
{
	struct space s;
	const double *t;
	double *row;

	memset(work, 0, lay_out(&s, p, work) * sizeof *work);
	for (int i = 0; i < p->nrow; i++)
		if (y - p->cy[i] <= p->radius && p->cy[i] - y <= p->radius)
			spread_y(&s, p, i, y);
	t = s.t;
	row = s.row;
	for (int c = 0; c < p->ny; c++, row += (size_t)(1 + p->nf) * s.width) {
		for (int a = 0; a <= p->nf; a++, t += p->nx)
			spread_x(row + (size_t)a * s.width, p, t, 0);
		for (int k = 1; k <= p->order; k++, t += p->nx)
			spread_x(row, p, t, k);
		for (int a = 0; a < p->nf; a++)
			add_feature(row, row + (size_t)(1 + a) * s.width, gd_row(p->feat[a], y), p->ref[a], p->w);
		finish(out->est[c], y, row, p);
	}
	for (int e = 0; e < s.extras; e++, row += s.width, t += p->nx) {
		struct gd_plane to = e < p->nv ? (out->mse ? out->mse[e] : (struct gd_plane){ 0 }) :
				     e == p->nv ? out->order : out->columns;

		if (!to.v)
			continue;
		spread_x(row, p, t, 0);
		finish(to, y, row, p);
	}
}
