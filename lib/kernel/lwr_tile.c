/* SPDX-License-Identifier: BSD-3-Clause */
/* The centres of one tile: collected into batches, fitted, predicted. */
#include "../lwr_impl.h"
#include "kernel/lwr_batch.h"

#define LANES GD_LWR_LANES
typedef gd_lwr_vec vec;

/* Lays the arrays of a batch out in `work`, or with work = NULL only counts; returns doubles. */
static size_t lay_out(const struct gd_lwr_plan *p, struct gd_lwr_batch *t, double *work)
{
	const size_t np = (size_t)p->p, nc = (size_t)p->nc, rows = np + nc;
	const size_t pitch = (size_t)gd_lwr_pitch(p->q);
	const size_t others = (size_t)(p->ny - p->nc);
	const size_t ring = p->radius > 1 ? 8 * (size_t)p->radius : 9;
	const size_t sums = (size_t)(p->nc + p->nvar + p->nfv);
	size_t n = 0;

#define TAKE(to, count) \
	do { \
		to = work ? (void *)(work + n) : NULL; \
		n += count; \
	} while (0)
	TAKE(t->z, ring * pitch + LANES);
	for (int l = 0; l < LANES; l++) {
		TAKE(t->m[l], np * pitch);
		TAKE(t->sums[l], (size_t)gd_lwr_pitch((int)sums));
		TAKE(t->ref[l], pitch);
	}
	TAKE(t->first, 9 * (size_t)p->q * LANES);
	TAKE(t->ring, np * (size_t)p->q * LANES);
	TAKE(t->rs, sums * LANES);
	TAKE(t->a, np * (size_t)p->q * LANES);
	TAKE(t->s, sums * LANES);
	TAKE(t->l, np * rows * LANES);
	TAKE(t->inv, np * LANES);
	TAKE(t->b, np * nc * LANES);
	TAKE(t->acc, nc * LANES);
	TAKE(t->xi, nc * LANES);
	TAKE(t->scale, nc * LANES);
	TAKE(t->best, np * nc * LANES);
	if (others > 0) {
		TAKE(t->best_l, np * rows * LANES);
		TAKE(t->best_inv, np * LANES);
		TAKE(t->other, np * others * LANES);
		TAKE(t->other_b, np * others * LANES);
	}
	if (p->paper) {
		TAKE(t->rings, (size_t)p->radius * gd_lwr_ring_size(p));
		TAKE(t->start, 9 * pitch);
	}
	TAKE(t->model, ((size_t)p->ny * np + nc + LANES) / LANES * LANES);
#undef TAKE
	return (n + 7) / 8 * 8;
}

static void predict_batch(const struct gd_lwr_plan *p, struct gd_lwr_batch *t,
			  struct gd_lwr_count *count)
{
	const int others = p->ny - p->nc;

	for (int l = 0; l < t->n; l++) {
		double *b = t->model, *xi = b + p->ny * p->p;
		struct gd_lwr_model m = {
			.x = t->x[l], .y = t->y[l], .radius = (int)t->radius[l],
			.features = (int)t->features[l], .ref = t->ref[l], .b = b, .xi = xi,
		};

		for (int c = 0; c < p->ny; c++)
			for (int j = 0; j < p->p; j++)
				b[c * p->p + j] = c < p->nc ? t->best[j * p->nc + c][l] :
						t->other_b[j * others + c - p->nc][l];
		for (int c = 0; c < p->nc; c++)
			xi[c] = t->xi[c][l];
		gd_lwr_predict(p, &m);
		count->models++;
		count->radii += m.radius;
	}
}

static void flush(const struct gd_lwr_plan *p, struct gd_lwr_batch *t, struct gd_lwr_count *count)
{
	if (t->n == 0)
		return;
	if (p->paper)
		gd_lwr_fit_paper(p, t);
	else
		gd_lwr_fit_batch(p, t);
	if (!p->paper && p->ny > p->nc)
		gd_lwr_fit_others(p, t);
	predict_batch(p, t, count);
	t->n = 0;
}

static size_t size(const struct gd_lwr_plan *p)
{
	struct gd_lwr_batch t;

	return lay_out(p, &t, NULL);
}

/* The first of n increasing numbers that is at least x. */
static int from(const int *at, int n, int x)
{
	int low = 0;

	while (low < n) {
		int middle = (low + n) / 2;

		if (at[middle] < x)
			low = middle + 1;
		else
			n = middle;
	}
	return low;
}

static void tile(const struct gd_lwr_plan *p, int x0, int y0, int x1, int y1, double *work,
		 struct gd_lwr_count *count)
{
	struct gd_lwr_batch t = { 0 };
	const int first = from(p->cx, p->nx, x0), last = from(p->cx, p->nx, x1);
	const int end = from(p->cy, p->nrow, y1);

	lay_out(p, &t, work);
	for (int j = from(p->cy, p->nrow, y0); j < end; j++) {
		const unsigned char *mark = p->mark + (size_t)p->cy[j] * (size_t)p->w;

		for (int i = first; i < last; i++) {
			if (!mark[p->cx[i]])
				continue;
			t.x[t.n] = p->cx[i];
			t.y[t.n] = p->cy[j];
			if (++t.n == LANES)
				flush(p, &t, count);
		}
	}
	flush(p, &t, count);
}

const struct gd_lwr_kernels GD_KERNEL(gd_lwr_kernels) = { size, tile };
