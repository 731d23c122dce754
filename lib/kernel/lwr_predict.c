/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Adds the predictions of one model to the sums of the pixels of its window. Three planes are
 * predicted at a time: each gets a vector of products of features and slopes, and the vectors are
 * then added up crosswise, so that a pixel's three values come out side by side, as they are kept.
 */
#include "../lwr_impl.h"

/* Vectors wider than the registers are passed to inlined functions only. */
#pragma GCC diagnostic ignored "-Wpsabi"

#define SIDE 4		/* of the values kept side by side: three and one more */
typedef double quad __attribute__((vector_size(8 * SIDE)));
typedef double quad_any __attribute__((vector_size(8 * SIDE), aligned(8), may_alias));
typedef float quad_float __attribute__((vector_size(4 * SIDE), aligned(4), may_alias));
typedef int64_t quad_mask __attribute__((vector_size(8 * SIDE)));

#define MOST (GD_LWR_FEATURES / SIDE)	/* vectors of features */

/* Three planes of a model: value at a pixel = at + u * along + v * down + features. */
struct three {
	quad at, along, down;		/* the last lane counts predictions: 1 0 0 */
	quad slope[3][MOST];
};

GD_LWR_INLINE void limit(quad *v)
{
	const quad high = (double)GD_LWR_LIMIT - (quad){ 0 };
	quad_mask above = *v < high, below = *v > -high;

	/* what is no number compares as neither */
	*v = (quad)(((quad_mask)*v & above) | ((quad_mask)high & ~above));
	*v = (quad)(((quad_mask)*v & below) | ((quad_mask)-high & ~below));
}

GD_LWR_INLINE void widen(quad *to, const float *v)
{
	double x[SIDE] __attribute__((aligned(8 * SIDE)));

	for (int l = 0; l < SIDE; l++)
		x[l] = (double)v[l];
	*to = *(const quad *)x;
}

GD_LWR_INLINE void add(float *to, const quad *v)
{
	*(quad_float *)to += __builtin_convertvector(*v, quad_float);
}

/* The sums of three vectors, and 0. */
GD_LWR_INLINE void across(quad *to, const quad *a, const quad *b, const quad *c)
{
	const quad none = { 0 };
	quad ab = __builtin_shuffle(*a, *b, (quad_mask){ 0, 4, 2, 6 }) +
		  __builtin_shuffle(*a, *b, (quad_mask){ 1, 5, 3, 7 });
	quad cd = __builtin_shuffle(*c, none, (quad_mask){ 0, 4, 2, 6 }) +
		  __builtin_shuffle(*c, none, (quad_mask){ 1, 5, 3, 7 });

	*to = __builtin_shuffle(ab, cd, (quad_mask){ 0, 1, 4, 5 }) +
	      __builtin_shuffle(ab, cd, (quad_mask){ 2, 3, 6, 7 });
}

/* Planes c, c+1, c+2, as far as there are any. */
static void gather_three(struct three *t, const struct gd_lwr_plan *p, const struct gd_lwr_model *m,
			 int c)
{
	*t = (struct three){ .at = { 0, 0, 0, 1 } };
	for (int k = 0; k < 3 && c + k < p->ny; k++) {
		const double *b = m->b + (c + k) * p->p;

		t->at[k] = b[0] + (c + k < p->nc ? m->ref[p->p + c + k] : 0);
		t->along[k] = b[1];
		t->down[k] = b[2];
		for (int a = 0; a < p->nf; a++) {
			t->slope[k][a / SIDE][a % SIDE] = b[3 + a];
			t->at[k] -= b[3 + a] * m->ref[3 + a];
		}
	}
}

/* What is added to the sums of a pixel for the model as such. */
struct maps {
	quad error;
	double features;
};

GD_LWR_INLINE void predict_row(const struct gd_lwr_plan *p, const struct three *t,
			       const quad *start, const float *px, float *sum, int n,
			       const struct maps *maps, const int vectors)
{
	const quad along = t->along;
	quad slope[3][MOST], base = *start;

	for (int k = 0; k < 3; k++)
		for (int j = 0; j < vectors; j++)
			slope[k][j] = t->slope[k][j];
	for (int i = 0; i < n; i++, px += p->pitch, sum += p->sums, base += along) {
		quad a = { 0 }, b = { 0 }, c = { 0 }, v;

		for (int j = 0; j < vectors; j++) {
			quad z;

			widen(&z, px + SIDE * j);	/* slopes are 0 beyond the features */
			a += slope[0][j] * z;
			b += slope[1][j] * z;
			c += slope[2][j] * z;
		}
		across(&v, &a, &b, &c);
		v += base;
		limit(&v);
		add(sum, &v);
		if (!maps)
			continue;
		if (p->at_error)
			add(sum + p->at_error, &maps->error);
		if (p->at_spread) {
			v *= v;
			v[3] = maps->features;
			limit(&v);
			add(sum + p->at_spread, &v);
		}
	}
}

#define ROWS(n) \
	case n: \
		for (; y < y1; y++, v += t->down, px += row, sum += sums) \
			predict_row(p, t, &v, px, sum, x1 - x0, maps, n); \
		break

static void predict_three(const struct gd_lwr_plan *p, const struct gd_lwr_model *m,
			  const struct three *t, int x0, int y0, int x1, int y1, int c,
			  const struct maps *maps)
{
	const size_t row = (size_t)p->w * p->pitch, sums = (size_t)p->w * p->sums;
	const size_t first = (size_t)y0 * (size_t)p->w + (size_t)x0;
	const float *px = p->pixel + first * p->pitch;
	float *sum = p->sum + first * p->sums + c / 3 * SIDE;
	quad v = t->at + (double)(x0 - m->x) * t->along + (double)(y0 - m->y) * t->down;
	const int vectors = (p->nf + SIDE - 1) / SIDE;
	int y = y0;

	switch (vectors) {
	ROWS(1);
	ROWS(2);
	ROWS(3);
	ROWS(4);
	default:
		for (; y < y1; y++, v += t->down, px += row, sum += sums)
			predict_row(p, t, &v, px, sum, x1 - x0, maps, vectors);
	}
}

void gd_lwr_predict(const struct gd_lwr_plan *p, const struct gd_lwr_model *m)
{
	const int r = m->radius;
	const int x0 = m->x > r ? m->x - r : 0, x1 = m->x + r < p->w ? m->x + r + 1 : p->w;
	const int y0 = m->y > r ? m->y - r : 0, y1 = m->y + r < p->h ? m->y + r + 1 : p->h;
	struct maps maps = { .error = { 0, 0, 0, m->radius }, .features = m->features };
	struct three t;

	for (int c = 0; c < p->nc; c++)
		maps.error[c] = m->xi[c] > 0 ? m->xi[c] : 0;
	limit(&maps.error);
	for (int c = 0; c < p->ny; c += 3) {
		gather_three(&t, p, m, c);
		predict_three(p, m, &t, x0, y0, x1, y1, c,
			      c == 0 && (p->at_error || p->at_spread) ? &maps : NULL);
	}
	if (p->out_centre.v)
		gd_row(p->out_centre, m->y)[m->x] = 1;
}
