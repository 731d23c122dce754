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

#define splat gd_lwr_splat
#define pick gd_lwr_pick

GD_LWR_INLINE vec limit(vec v)
{
	vec high = splat((double)GD_LWR_LIMIT);

	v = pick(v > -high, v, -high);
	return pick(v < high, v, high);
}

/* Where a row of the window is: features read, estimates and maps written. */
struct rows {
	const float *feat[GD_LWR_FEATURES];
	float *est[GD_LWR_RHS];
	int maps;
	float *map[GD_LWR_MAPS];
	double add[GD_LWR_MAPS];	/* to the maps */
	size_t map_stride[GD_LWR_MAPS];
};

static void add_map(struct rows *r, struct gd_plane map, int y, double v)
{
	if (!map.v)
		return;
	r->map[r->maps] = gd_row(map, y);
	r->map_stride[r->maps] = map.stride;
	r->add[r->maps++] = v;
}

static void open_rows(struct rows *r, const struct gd_lwr_plan *p, const struct gd_lwr_model *m,
		      int y)
{
	for (int a = 0; a < p->nf; a++)
		r->feat[a] = gd_row(p->feat[a], y);
	for (int c = 0; c < p->ny; c++)
		r->est[c] = gd_row(p->est[c], y);
	r->maps = 0;
	add_map(r, p->total, y, 1);
	for (int c = 0; p->mse && c < p->nc; c++) {
		double xi = m->xi[c] > 0 ? m->xi[c] : 0;

		add_map(r, p->mse[c], y, xi < (double)GD_LWR_LIMIT ? xi : (double)GD_LWR_LIMIT);
	}
	add_map(r, p->out_radius, y, m->radius);
	add_map(r, p->out_features, y, m->features);
}

static void next_rows(struct rows *r, const struct gd_lwr_plan *p)
{
	for (int a = 0; a < p->nf; a++)
		r->feat[a] += p->feat[a].stride;
	for (int c = 0; c < p->ny; c++)
		r->est[c] += p->est[c].stride;
	for (int k = 0; k < r->maps; k++)
		r->map[k] += r->map_stride[k];
}

GD_LWR_INLINE void add(float *to, vec v)
{
	*(gd_lwr_float *)to += __builtin_convertvector(v, gd_lwr_float);
}

/* One vector of pixels from x on, planes c .. c+n-1. */
GD_LWR_INLINE void group(const struct gd_lwr_plan *p, const struct gd_lwr_model *m,
			 const struct rows *r, int x, vec u, double v, vec weight, int c,
			 const int n)
{
	const double *b = m->b + c * p->p, *ref = m->ref + 3;
	vec sum[AT_ONCE];

	for (int k = 0; k < n; k++) {
		const double *bk = b + k * p->p;

		sum[k] = (bk[0] + bk[2] * v) + bk[1] * u;
	}
	b += 3;
	for (int a = 0; a < p->nf; a++, b++) {
		vec z = __builtin_convertvector(*(const gd_lwr_float *)(r->feat[a] + x), vec) -
			ref[a];

		for (int k = 0; k < n; k++)
			sum[k] += b[k * p->p] * z;
	}
	for (int k = 0; k < n; k++) {
		double level = c + k < p->nc ? m->ref[p->p + c + k] : 0;

		add(r->est[c + k] + x, weight * limit(sum[k] + level));
	}
}

/* The same for an image narrower than a vector. */
static void single(const struct gd_lwr_plan *p, const struct gd_lwr_model *m,
		   const struct rows *r, int x, int v)
{
	for (int c = 0; c < p->ny; c++) {
		const double *b = m->b + c * p->p;
		double sum = b[0] + b[1] * (x - m->x) + b[2] * v;

		for (int a = 0; a < p->nf; a++)
			sum += b[3 + a] * ((double)r->feat[a][x] - m->ref[3 + a]);
		sum += c < p->nc ? m->ref[p->p + c] : 0;
		sum = sum > -(double)GD_LWR_LIMIT ? sum : -(double)GD_LWR_LIMIT;
		sum = sum < (double)GD_LWR_LIMIT ? sum : (double)GD_LWR_LIMIT;
		r->est[c][x] += (float)(m->weight * sum);
	}
	for (int k = 0; k < r->maps; k++)
		r->map[k][x] += (float)(m->weight * r->add[k]);
}

/* LANES zeros, as many ones, zeros again. */
static const double edge[3 * LANES] = {
	[LANES] = 1, 1,
#if GD_LWR_LANES >= 4
	1, 1,
#endif
#if GD_LWR_LANES >= 8
	1, 1, 1, 1,
#endif
};

static void predict_row(const struct gd_lwr_plan *p, const struct gd_lwr_model *m,
			const struct rows *r, int v, int x0, int x1)
{
	vec lane;

	for (int l = 0; l < LANES; l++)
		lane[l] = l - m->x;
	for (int start = x0; start < x1; start += LANES) {
		int x = start + LANES <= p->w ? start : p->w - LANES, c = 0;
		int before = start - x, from = x1 - x < LANES ? LANES - (x1 - x) : 0;
		vec u = lane + (double)x, weight = m->weight *
			(*(const gd_lwr_any *)(edge + LANES - before) *
			 *(const gd_lwr_any *)(edge + LANES + from));

		for (; c + AT_ONCE <= p->ny; c += AT_ONCE)
			group(p, m, r, x, u, v, weight, c, AT_ONCE);
		for (; c < p->ny; c++)
			group(p, m, r, x, u, v, weight, c, 1);
		for (int k = 0; k < r->maps; k++)
			add(r->map[k] + x, weight * r->add[k]);
	}
}

void gd_lwr_predict(const struct gd_lwr_plan *p, const struct gd_lwr_model *m)
{
	const int r = m->radius;
	const int x0 = m->x > r ? m->x - r : 0, x1 = m->x + r < p->w ? m->x + r + 1 : p->w;
	const int y0 = m->y > r ? m->y - r : 0, y1 = m->y + r < p->h ? m->y + r + 1 : p->h;
	struct rows rows;

	open_rows(&rows, p, m, y0);
	for (int y = y0; y < y1; y++) {
		if (p->w < LANES)
			for (int x = x0; x < x1; x++)
				single(p, m, &rows, x, y - m->y);
		else
			predict_row(p, m, &rows, y - m->y, x0, x1);
		next_rows(&rows, p);
	}
	if (p->out_centre.v)
		gd_row(p->out_centre, m->y)[m->x] = 1;
}
