/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Adds the predictions of one model to the sums, and what it tells of itself to the maps. Rows of
 * the window are taken in vectors of pixels, from the planes as they came; vectors that would end
 * beyond the image start earlier, and lanes outside the window weigh 0.
 */
#include <math.h>

#include "../lwr_impl.h"

#define LANES GD_LWR_LANES
#define AT_ONCE 3	/* planes predicted together */
typedef gd_lwr_vec vec;

GD_LWR_INLINE vec splat(double x)
{
	return x - (vec){ 0 };
}

GD_LWR_INLINE vec limit(vec v)
{
	vec low = splat(-(double)GD_LWR_LIMIT), high = splat((double)GD_LWR_LIMIT);

	for (int l = 0; l < LANES; l++) {
		double x = v[l] > low[l] ? v[l] : low[l];

		v[l] = x < high[l] ? x : high[l];
	}
	return v;
}

/* One vector of pixels from x on, planes c .. c+n-1. */
GD_LWR_INLINE void group(const struct gd_lwr_plan *p, const struct gd_lwr_model *m,
			 const float *const *feat, int x, int v, vec weight, int c, const int n,
			 float *const *est, float *const *square)
{
	vec u = { 0 }, sum[AT_ONCE];

	for (int l = 0; l < LANES; l++)
		u[l] = x + l - m->x;
	for (int k = 0; k < n; k++) {
		const double *b = m->b + (c + k) * p->p;

		sum[k] = (b[0] + b[2] * v) + b[1] * u;
	}
	for (int a = 0; a < p->nf; a++) {
		vec z = __builtin_convertvector(*(const gd_lwr_float *)(feat[a] + x), vec) -
			m->ref[3 + a];

		for (int k = 0; k < n; k++)
			sum[k] += m->b[(c + k) * p->p + 3 + a] * z;
	}
	for (int k = 0; k < n; k++) {
		gd_lwr_float *to = (gd_lwr_float *)(est[c + k] + x);
		vec level = splat(c + k < p->nc ? m->ref[p->p + c + k] : 0);

		vec value = limit(sum[k] + level);

		*to += __builtin_convertvector(weight * value, gd_lwr_float);
		if (p->spread && c + k < p->nc) {
			to = (gd_lwr_float *)(square[c + k] + x);
			*to += __builtin_convertvector(weight * limit(value * value), gd_lwr_float);
		}
	}
}

/* The same for an image narrower than a vector. */
static void single(const struct gd_lwr_plan *p, const struct gd_lwr_model *m,
		   const float *const *feat, int x, int v, float *const *est, float *const *square)
{
	for (int c = 0; c < p->ny; c++) {
		const double *b = m->b + c * p->p;
		double sum = b[0] + b[1] * (x - m->x) + b[2] * v;

		for (int a = 0; a < p->nf; a++)
			sum += b[3 + a] * ((double)feat[a][x] - m->ref[3 + a]);
		sum += c < p->nc ? m->ref[p->p + c] : 0;
		sum = sum > -(double)GD_LWR_LIMIT ? sum : -(double)GD_LWR_LIMIT;
		sum = sum < (double)GD_LWR_LIMIT ? sum : (double)GD_LWR_LIMIT;
		est[c][x] += (float)(m->weight * sum);
		if (p->spread && c < p->nc)
			square[c][x] += (float)(m->weight * fmin(sum * sum, (double)GD_LWR_LIMIT));
	}
}

static void predict_row(const struct gd_lwr_plan *p, const struct gd_lwr_model *m, int y, int x0,
			int x1)
{
	const float *feat[GD_LWR_FEATURES];
	float *est[GD_LWR_RHS], *square[3] = { 0 };

	for (int a = 0; a < p->nf; a++)
		feat[a] = gd_row(p->feat[a], y);
	for (int c = 0; c < p->ny; c++)
		est[c] = gd_row(p->est[c], y);
	for (int c = 0; p->spread && c < p->nc; c++)
		square[c] = gd_row(p->spread[c], y);
	if (p->w < LANES) {
		for (int x = x0; x < x1; x++)
			single(p, m, feat, x, y - m->y, est, square);
		return;
	}
	for (int start = x0; start < x1; start += LANES) {
		int x = start + LANES <= p->w ? start : p->w - LANES, c = 0;
		vec weight;

		for (int l = 0; l < LANES; l++)
			weight[l] = x + l >= start && x + l < x1 ? m->weight : 0;
		for (; c + AT_ONCE <= p->ny; c += AT_ONCE)
			group(p, m, feat, x, y - m->y, weight, c, AT_ONCE, est,
			      square);
		for (; c < p->ny; c++)
			group(p, m, feat, x, y - m->y, weight, c, 1, est, square);
	}
}

static void add(struct gd_plane to, int y, int x0, int x1, float v)
{
	float *row = to.v ? gd_row(to, y) : NULL;

	for (int x = x0; row && x < x1; x++)
		row[x] += v;
}

void gd_lwr_predict(const struct gd_lwr_plan *p, const struct gd_lwr_model *m)
{
	const int r = m->radius;
	const int x0 = m->x > r ? m->x - r : 0, x1 = m->x + r < p->w ? m->x + r + 1 : p->w;
	const int y0 = m->y > r ? m->y - r : 0, y1 = m->y + r < p->h ? m->y + r + 1 : p->h;

	for (int y = y0; y < y1; y++) {
		predict_row(p, m, y, x0, x1);
		add(p->total, y, x0, x1, (float)m->weight);
		for (int c = 0; p->mse && c < p->nc; c++) {
			double xi = m->xi[c] > 0 ? m->xi[c] : 0;

			xi = xi < (double)GD_LWR_LIMIT ? xi : (double)GD_LWR_LIMIT;
			add(p->mse[c], y, x0, x1, (float)(m->weight * xi));
		}
		add(p->out_radius, y, x0, x1, (float)(m->weight * r));
		add(p->out_features, y, x0, x1, (float)(m->weight * m->features));
	}
	if (p->out_centre.v)
		gd_row(p->out_centre, m->y)[m->x] = 1;
}
