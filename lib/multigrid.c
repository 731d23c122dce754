/* SPDX-License-Identifier: BSD-3-Clause */
#include "multigrid.h"

#include "plane.h"

#include <math.h>
#include <omp.h>
#include <stdlib.h>
#include <string.h>

#define MAX_LEVELS 20		/* 2^17 halves to 1 in 17 steps */
#define COARSEST 64		/* points solved directly: 64^2 doubles, 87000 multiplications */
#define GROWTH 1e4		/* of the residual: the method itself may show it before a fall */
#define PARALLEL_POINTS 16384	/* below, waking the threads costs more than the work */

struct gd_mg {
	const struct gd_mg_kernels *k;
	int n, levels;
	struct gd_mg_level level[MAX_LEVELS];
	void *x, *p;
	void *block;
	unsigned char *work;		/* three rows per thread */
	size_t work_size;
	int threads;
	double *partial;		/* n sums per row */
	double reference[3];		/* r'Mr of the start */
	int points;			/* of the coarsest grid */
	double factor[COARSEST][COARSEST], pivot[COARSEST];
};

enum phase { PRE, POST };
enum colour { RED, BLACK };	/* x + y even, odd */

static bool worth_threads(const struct gd_mg_level *l)
{
	return (size_t)l->w * (size_t)l->h >= PARALLEL_POINTS;
}

/* A loop over the rows of l on all threads. */
#define PRAGMA(text) _Pragma(#text)
#define FOR_ROWS(l, y)							\
	PRAGMA(omp parallel for schedule(static) if (worth_threads(l)))	\
	for (int y = 0; y < (l)->h; y++)

/*
 * Takes count planes from the block: *at is the number of elements
 * handed out. The first call, with a NULL block, only counts.
 */
static void *take(void *block, size_t *at, size_t count, const struct gd_mg_level *l, size_t size)
{
	size_t start = *at + l->stride + 16;

	*at += count * l->plane + 32;
	return block ? (unsigned char *)block + start * size : NULL;
}

static void lay_out(struct gd_mg *mg, void *block, bool screened, size_t *at)
{
	const size_t size = mg->k->size;

	*at = 0;
	for (int i = 0; i < mg->levels; i++) {
		struct gd_mg_level *l = &mg->level[i];

		l->e = take(block, at, 1, l, size);
		l->s = take(block, at, 1, l, size);
		l->invd = take(block, at, 1, l, size);
		l->a = screened ? take(block, at, 1, l, size) : NULL;
		l->z = take(block, at, mg->n, l, size);
		l->r = take(block, at, mg->n, l, size);
		if (i == 0) {
			mg->x = take(block, at, mg->n, l, size);
			mg->p = take(block, at, mg->n, l, size);
			continue;
		}
		l->se = take(block, at, 1, l, size);
		l->sw = take(block, at, 1, l, size);
		l->px = take(block, at, 1, l, size);
		l->py = take(block, at, 1, l, size);
		l->m00 = take(block, at, 1, l, size);
		l->m10 = take(block, at, 1, l, size);
		l->m01 = take(block, at, 1, l, size);
	}
}

/* Zeros on all threads, so that each finds its rows in pages it touched first. */
static void clear(void *block, size_t bytes)
{
	const size_t piece = (size_t)1 << 21;

#pragma omp parallel for schedule(static) if (bytes > 8 * piece)
	for (size_t i = 0; i < (bytes + piece - 1) / piece; i++)
		memset((unsigned char *)block + i * piece, 0,
		       i * piece + piece < bytes ? piece : bytes - i * piece);
}

int gd_mg_new(struct gd_mg **out, int w, int h, int n, bool wide, bool screened, struct gd_err *err)
{
	struct gd_mg *mg = gd_calloc(1, sizeof(*mg));
	size_t count;

	*out = NULL;
	if (!mg)
		return gd_fail(err, GD_ENOMEM, "multigrid: out of memory");
	mg->k = wide ? GD_PICK(gd_mg_f64) : GD_PICK(gd_mg_f32);
	mg->n = n;
	mg->threads = omp_get_max_threads();
	for (int i = 0; i < MAX_LEVELS; i++) {
		struct gd_mg_level *l = &mg->level[mg->levels++];

		l->w = w;
		l->h = h;
		l->stride = gd_stride(w + 2);
		l->plane = l->stride * ((size_t)h + 2);
		if ((size_t)w * (size_t)h <= COARSEST)
			break;
		w = (w + 1) / 2;
		h = (h + 1) / 2;
	}
	lay_out(mg, NULL, screened, &count);
	mg->work_size = (3 * mg->level[0].stride + 32) * mg->k->size;
	mg->block = gd_alloc(count, mg->k->size);
	mg->work = gd_calloc((size_t)mg->threads, mg->work_size);
	mg->partial = gd_calloc((size_t)mg->level[0].h, (size_t)n * sizeof(double));
	if (!mg->block || !mg->work || !mg->partial) {
		gd_mg_free(mg);
		return gd_fail(err, GD_ENOMEM, "multigrid: out of memory for %zu elements", count);
	}
	clear(mg->block, count * mg->k->size);
	lay_out(mg, mg->block, screened, &count);
	*out = mg;
	return GD_OK;
}

void gd_mg_free(struct gd_mg *mg)
{
	if (!mg)
		return;
	free(mg->block);
	free(mg->work);
	free(mg->partial);
	free(mg);
}

const struct gd_mg_level *gd_mg_grid(const struct gd_mg *mg)
{
	return &mg->level[0];
}

void *gd_mg_x(const struct gd_mg *mg)
{
	return mg->x;
}

void *gd_mg_spare(const struct gd_mg *mg)
{
	return mg->p;
}

static double element(const struct gd_mg *mg, const void *plane, size_t i)
{
	return mg->k->size == sizeof(double) ? ((const double *)plane)[i]
					     : (double)((const float *)plane)[i];
}

/* Adds edge weight v between points i and j of the coarsest grid. */
static void couple(struct gd_mg *mg, int i, int j, double v)
{
	mg->factor[i][i] += v;
	mg->factor[j][j] += v;
	mg->factor[i > j ? i : j][i > j ? j : i] -= v;
}

/*
 * L D L' of the coarsest operator. A pivot that has lost all but rounding belongs to the constant
 * of a part that is tied down nowhere: that unknown is set to 0.
 */
static void factorise(struct gd_mg *mg)
{
	const struct gd_mg_level *l = &mg->level[mg->levels - 1];
	double diagonal[COARSEST];

	mg->points = l->w * l->h;
	memset(mg->factor, 0, sizeof(mg->factor));
	for (int i = 0; i < mg->points; i++) {
		int x = i % l->w, y = i / l->w;
		size_t at = (size_t)y * l->stride + (size_t)x;

		if (x + 1 < l->w)
			couple(mg, i, i + 1, element(mg, l->e, at));
		if (y + 1 < l->h)
			couple(mg, i, i + l->w, element(mg, l->s, at));
		if (l->se && y + 1 < l->h && x + 1 < l->w)
			couple(mg, i, i + l->w + 1, element(mg, l->se, at));
		if (l->sw && y + 1 < l->h && x > 0)
			couple(mg, i, i + l->w - 1, element(mg, l->sw, at));
		if (l->a)
			mg->factor[i][i] += element(mg, l->a, at);
	}
	for (int i = 0; i < mg->points; i++)
		diagonal[i] = mg->factor[i][i];
	for (int j = 0; j < mg->points; j++) {
		double d = mg->factor[j][j];

		for (int k = 0; k < j; k++)
			d -= mg->factor[j][k] * mg->factor[j][k] * mg->pivot[k];
		mg->pivot[j] = d > 1e-12 * diagonal[j] ? d : 0;
		for (int i = j + 1; i < mg->points; i++) {
			double v = mg->factor[i][j];

			for (int k = 0; k < j; k++)
				v -= mg->factor[i][k] * mg->factor[j][k] * mg->pivot[k];
			mg->factor[i][j] = mg->pivot[j] > 0 ? v / mg->pivot[j] : 0;
		}
	}
}

static void solve_coarsest(const struct gd_mg *mg)
{
	const struct gd_mg_level *l = &mg->level[mg->levels - 1];

	for (int c = 0; c < mg->n; c++) {
		double v[COARSEST];

		for (int i = 0; i < mg->points; i++) {
			v[i] = element(mg, l->r,
				       c * l->plane + (size_t)(i / l->w) * l->stride +
					       (size_t)(i % l->w));
			for (int k = 0; k < i; k++)
				v[i] -= mg->factor[i][k] * v[k];
		}
		for (int i = mg->points - 1; i >= 0; i--) {
			size_t at =
				c * l->plane + (size_t)(i / l->w) * l->stride + (size_t)(i % l->w);

			v[i] = mg->pivot[i] > 0 ? v[i] / mg->pivot[i] : 0;
			for (int k = i + 1; k < mg->points; k++)
				v[i] -= mg->factor[k][i] * v[k];
			if (!(mg->pivot[i] > 0))
				v[i] = 0;
			if (mg->k->size == sizeof(double))
				((double *)l->z)[at] = v[i];
			else
				((float *)l->z)[at] = (float)v[i];
		}
	}
}

void gd_mg_setup(struct gd_mg *mg)
{
	const struct gd_mg_kernels *k = mg->k;

	FOR_ROWS(&mg->level[0], y)
		k->diagonal(&mg->level[0], y);
	FOR_ROWS(&mg->level[0], y)
		k->schur(&mg->level[0], y);
	for (int i = 1; i < mg->levels; i++) {
		const struct gd_mg_level *fine = &mg->level[i - 1], *coarse = &mg->level[i];

		FOR_ROWS(coarse, y)
			k->interpolate(fine, coarse, y);
		FOR_ROWS(coarse, y)
			k->galerkin(fine, coarse, y);
		if (coarse->a) {
			FOR_ROWS(coarse, y)
				k->restrict_plane(coarse->a, fine->a, fine, coarse, y);
		}
		FOR_ROWS(coarse, y)
			k->combine(coarse, y);
	}
	factorise(mg);
}

/*
 * Part k of a sweep at row y. Level 0: black, red by its reduced diagonal, black again; this is
 * symmetric, so the same sweep goes before and after. Coarser levels: one half of the rows, then
 * the other half, in the opposite order after.
 */
static void sweep_row(const struct gd_mg *mg, int i, enum phase phase, int k, int y)
{
	const struct gd_mg_level *l = &mg->level[i];
	const struct gd_mg_kernels *f = mg->k;

	if (i > 0 && (y & 1) == (phase == PRE ? k : 1 - k))
		f->relax9(l, mg->n, y, phase == PRE ? 0 : 1);
	if (i > 0)
		return;
	if (k == 0 && phase == PRE)
		f->start(l, mg->n, y);
	else if (k == 1 && phase == POST)
		f->correct(l, mg->n, y);
	else
		f->relax(l, mg->n, y, k == 1 ? RED : BLACK);
	if (k == 2 && phase == POST)
		f->dot(mg->partial + (size_t)y * mg->n, l->r, l->z, l, mg->n, y);
}

/*
 * One sweep of Gauss-Seidel, its two or three parts in one pass over memory: part k of row y - k
 * follows the first part of row y. Rows near the ends of a thread's band wait until the neighbours
 * are done with the part before. Every point sees the same values as without bands.
 */
static void sweep(const struct gd_mg *mg, int i, enum phase phase)
{
	const struct gd_mg_level *l = &mg->level[i];
	const int parts = i == 0 ? 3 : 2;

#pragma omp parallel if (worth_threads(l))
	{
		const int threads = omp_get_num_threads(), id = omp_get_thread_num();
		const int y0 = (int)((long)l->h * id / threads),
			  y1 = (int)((long)l->h * (id + 1) / threads);

		for (int y = y0; y < y1 + parts - 1; y++)
			for (int k = 0; k < parts; k++)
				if (y - k >= y0 + k && y - k < y1 - k)
					sweep_row(mg, i, phase, k, y - k);
		for (int k = 1; k < parts; k++) {
#pragma omp barrier
			for (int y = y0; y < y1; y++)
				if (y < y0 + k || y >= y1 - k)
					sweep_row(mg, i, phase, k, y);
		}
	}
}

static void go_down(const struct gd_mg *mg, int i)
{
	const struct gd_mg_level *fine = &mg->level[i], *coarse = &mg->level[i + 1];
	const struct gd_mg_kernels *k = mg->k;

	if (i == 0) {
		FOR_ROWS(coarse, y)
			k->restrict_red(fine, coarse, mg->n, y,
					mg->work + (size_t)omp_get_thread_num() * mg->work_size);
		return;
	}
	FOR_ROWS(coarse, y)
	k->restrict_full(fine, coarse, mg->n, y,
			 mg->work + (size_t)omp_get_thread_num() * mg->work_size);
}

static void go_up(const struct gd_mg *mg, int i)
{
	const struct gd_mg_level *fine = &mg->level[i], *coarse = &mg->level[i + 1];

	if (i == 0) {
		FOR_ROWS(fine, y)
			mg->k->prolong_red(fine, coarse, mg->n, y);
	} else {
		FOR_ROWS(fine, y)
			mg->k->prolong(fine, coarse, mg->n, y);
	}
}

static void zero_guess(const struct gd_mg *mg, int i)
{
	const struct gd_mg_level *l = &mg->level[i];

	FOR_ROWS(l, y)
		for (int c = 0; c < mg->n; c++)
			memset((unsigned char *)l->z +
				       (c * l->plane + (size_t)y * l->stride) * mg->k->size,
			       0, (size_t)l->w * mg->k->size);
}

/* M r, and the row sums of r . M r in partial. */
static void cycle(struct gd_mg *mg)
{
	const int last = mg->levels - 1;
	const struct gd_mg_level *l = &mg->level[0];

	for (int i = 0; i < last; i++) {
		if (i > 0)
			zero_guess(mg, i);
		sweep(mg, i, PRE);
		go_down(mg, i);
	}
	solve_coarsest(mg);
	for (int i = last - 1; i >= 0; i--) {
		go_up(mg, i);
		sweep(mg, i, POST);
	}
	if (last == 0)
		for (int y = 0; y < l->h; y++)
			mg->k->dot(mg->partial + (size_t)y * mg->n, l->r, l->z, l, mg->n, y);
}

void gd_mg_cycle(struct gd_mg *mg)
{
	cycle(mg);
}

static void add_partial(const struct gd_mg *mg, double *sum)
{
	for (int c = 0; c < mg->n; c++)
		sum[c] = 0;
	for (int y = 0; y < mg->level[0].h; y++)
		for (int c = 0; c < mg->n; c++)
			sum[c] += mg->partial[(size_t)y * mg->n + c];
}

/* Worst relative norm; not a number counts as infinite. */
static double worst(const struct gd_mg *mg, const double *rz, const double *rz0)
{
	double most = 0;

	for (int c = 0; c < mg->n; c++) {
		double v = rz0[c] > 0 ? sqrt(fabs(rz[c]) / rz0[c]) : 0;

		most = v > most || isnan(v) ? v : most;
		if (isnan(most))
			return HUGE_VAL;
	}
	return most;
}

/*
 * Rounding bounds what can be reached: when the residual has grown far beyond the least, the
 * recursion has lost touch with the true residual, and going on would diverge. The cycle that finds
 * the residual small enough is also the next correction, and always a good one by itself.
 */
static struct gd_mg_result iterate(struct gd_mg *mg, double tolerance, int max_iterations,
				   bool fresh)
{
	const struct gd_mg_level *l = &mg->level[0];
	const struct gd_mg_kernels *k = mg->k;
	struct gd_mg_result result = { 0, 0 };
	const double one[3] = { 1, 1, 1 };
	double rz[3], old[3], beta[3] = { 0 }, alpha[3], pq[3], least = HUGE_VAL;

	for (;;) {
		cycle(mg);
		add_partial(mg, rz);
		if (fresh && result.iterations == 0)
			memcpy(mg->reference, rz, sizeof(rz));
		result.residual = worst(mg, rz, mg->reference);
		least = fmin(least, result.residual);
		if (!(result.residual > tolerance)) {
			FOR_ROWS(l, y)
				k->step(mg->x, l->z, l, mg->n, one, y);
			return result;
		}
		if (result.residual > GROWTH * least || result.iterations >= max_iterations)
			return result;
		for (int c = 0; c < mg->n; c++)
			beta[c] = result.iterations > 0 && old[c] > 0 ? rz[c] / old[c] : 0;
		memcpy(old, rz, sizeof(old));
		FOR_ROWS(l, y)
			k->direction(mg->p, l, mg->n, beta, y);
		FOR_ROWS(l, y)
			k->apply(mg->partial + (size_t)y * mg->n, mg->p, l, mg->n, y);
		add_partial(mg, pq);
		for (int c = 0; c < mg->n; c++)
			alpha[c] = pq[c] > 0 ? rz[c] / pq[c] : 0;
		FOR_ROWS(l, y)
			k->step(mg->x, mg->p, l, mg->n, alpha, y);
		result.iterations++;
	}
}

struct gd_mg_result gd_mg_solve(struct gd_mg *mg, double tolerance, int max_iterations)
{
	return iterate(mg, tolerance, max_iterations, true);
}

struct gd_mg_result gd_mg_resume(struct gd_mg *mg, double tolerance, int max_iterations)
{
	return iterate(mg, tolerance, max_iterations, false);
}
