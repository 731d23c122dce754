/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Conjugate gradients with the diagonal as preconditioner: alpha keeps the condition number near
 * 1 + 8 / alpha^2, and a graph that follows the textures of an image has no coarse grid.
 * The recursion runs in float and starts afresh, from a residual in double, whenever it has gained
 * five digits; the solution is in double.
 */
#include "pairsolve.h"

#include <float.h>
#include <limits.h>
#include <math.h>
#include <omp.h>
#include <stdlib.h>
#include <string.h>

#include "field.h"
#include "kernel/pair_rows.h"
#include "kernel/poisson_prep.h"

#define REACH (2 * GD_PAIR_REACH + 1)
#define GAIN 1e-5	/* of the residual by one recursion in float */
#define RESTARTS 20
#define L1_STEP 0.1	/* as in poisson.c: relative residual of each reweighted system, */
#define L1_FIRST 0.05	/* regularisation of the weights, of the typical brightness */
#define L1_LAST 5e-3

struct solver {
	const struct gd_pairsolve_in *in;
	const struct gd_poisson_conf *conf;
	const struct gd_pair_kernels *k;
	struct gd_field field;
	struct gd_pair_graph g;
	ptrdiff_t jump[REACH * REACH + 1];
	size_t row, pixels;
	double *x, *partial;		/* the solution; four sums for each row */
	float *r, *p, *q;
	double level, tolerance;
	double bound;			/* of the residual's norm over the energy's: see worst() */
	struct gd_poisson_result result;
};

static int check(const struct gd_plane *out, const struct gd_pairsolve_in *in,
		 const struct gd_poisson_conf *conf, struct gd_err *err)
{
	const int w = in->pairs->w, h = in->pairs->h;
	int rc;

	if (in->n < 1 || in->n > 3 || w < 1 || h < 1)
		return gd_fail(err, GD_EARG, "pairs: %d channels of %dx%d", in->n, w, h);
	if ((long)w * h > INT_MAX / 4)
		return gd_fail(err, GD_ENOMEM, "pairs: %dx%d pixels are too many", w, h);
	if ((conf->method != GD_L2 && conf->method != GD_L1) ||
	    !(conf->alpha >= 1e-3 && conf->alpha <= 1e3) ||
	    !(conf->tolerance >= 1e-12 && conf->tolerance <= 1) || conf->max_iterations < 1 ||
	    conf->reweight < 1)
		return gd_fail(err, GD_EARG, "pairs: a setting is out of its range");
	for (int c = 0; c < in->n; c++)
		if (!in->primal[c].v)
			return gd_fail(err, GD_EARG, "pairs: no primal image");
	rc = gd_field_check(in->primal, in->n, w, h, "primal", err);
	for (int k = 0; k < GD_PAIRS && rc == GD_OK; k++)
		rc = gd_field_check(in->value[k], in->n, w, h, "pair", err);
	return rc == GD_OK ? gd_field_check(out, in->n, w, h, "output", err) : rc;
}

static int allocate(struct solver *s, struct gd_err *err)
{
	const size_t n = s->pixels;

	s->g.link = gd_calloc(n, GD_PAIR_LINKS);
	s->g.weight = gd_calloc(n, GD_PAIR_LINKS * sizeof(float));
	s->g.a = gd_calloc(n, sizeof(float));
	s->g.invd = gd_calloc(n, sizeof(float));
	s->g.value = gd_calloc(n, GD_PAIR_LINKS * 4 * sizeof(float));
	s->g.primal = gd_calloc(n, 4 * sizeof(float));
	s->x = gd_calloc(n, 4 * sizeof(double));
	s->r = gd_calloc(n, 4 * sizeof(float));
	s->p = gd_calloc(n, 4 * sizeof(float));
	s->q = gd_calloc(n, 4 * sizeof(float));
	s->partial = gd_calloc((size_t)s->field.h, 4 * sizeof(double));
	if (s->g.link && s->g.weight && s->g.a && s->g.invd && s->g.value && s->g.primal && s->x &&
	    s->r && s->p && s->q && s->partial)
		return GD_OK;
	return gd_fail(err, GD_ENOMEM, "pairs: out of memory for %dx%d", s->field.w, s->field.h);
}

static void release(struct solver *s)
{
	free(s->g.link);
	free(s->g.weight);
	free(s->g.a);
	free(s->g.invd);
	free(s->g.value);
	free(s->g.primal);
	free(s->x);
	free(s->r);
	free(s->p);
	free(s->q);
	free(s->partial);
}

/* The link of an offset; 0 is no link, and no jump. */
static int link_of(int dx, int dy)
{
	return 1 + (dy + GD_PAIR_REACH) * REACH + dx + GD_PAIR_REACH;
}

static bool add_link(const struct solver *s, size_t i, int dx, int dy, const float value[4],
		     float weight)
{
	for (size_t k = i * GD_PAIR_LINKS; k < (i + 1) * GD_PAIR_LINKS; k++) {
		if (s->g.link[k])
			continue;
		s->g.link[k] = (unsigned char)link_of(dx, dy);
		s->g.weight[k] = weight;
		memcpy(s->g.value + 4 * k, value, 4 * sizeof(*value));
		return true;
	}
	return false;
}

/* Both ends of pair k of a pixel. */
static bool add_pair(struct solver *s, int x, int y, int k)
{
	const size_t i = (size_t)y * s->row + (size_t)x;
	const int dx = s->in->pairs->dx[k][i], dy = s->in->pairs->dy[k][i];
	float there[4] = { 0 }, back[4] = { 0 }, weight = 1;

	if (!dx && !dy)
		return true;
	if (abs(dx) > GD_PAIR_REACH || abs(dy) > GD_PAIR_REACH || x + dx < 0 ||
	    x + dx >= s->field.w || y + dy < 0 || y + dy >= s->field.h)
		return false;
	for (int c = 0; c < s->in->n; c++) {
		const struct gd_plane v = s->in->value[k][c];
		const float none = NAN;

		if (GD_PICK(gd_prep)->clean(&there[c], v.v ? gd_row(v, y) + x : &none,
					    s->field.scale, 1))
			weight = 0;
		back[c] = -there[c];
	}
	s->result.dropped += weight == 0;
	return add_link(s, i, dx, dy, there, weight) &&
	       add_link(s, i + (size_t)(dy * (ptrdiff_t)s->row + dx), -dx, -dy, back, weight);
}

static int link_all(struct solver *s, struct gd_err *err)
{
	for (int dy = -GD_PAIR_REACH; dy <= GD_PAIR_REACH; dy++)
		for (int dx = -GD_PAIR_REACH; dx <= GD_PAIR_REACH; dx++)
			s->jump[link_of(dx, dy)] = dy * (ptrdiff_t)s->row + dx;
	s->g.jump = s->jump;
	for (int y = 0; y < s->field.h; y++)
		for (int x = 0; x < s->field.w; x++)
			for (int k = 0; k < GD_PAIRS; k++)
				if (!add_pair(s, x, y, k))
					return gd_fail(err, GD_EARG,
						       "pairs: out of the image, or more than "
						       "%d at pixel %d,%d",
						       GD_PAIR_LINKS, x, y);
	return GD_OK;
}

/* The colour, cleaned, is where the search starts. */
static int screen(struct solver *s, struct gd_err *err)
{
	const double weight = s->conf->alpha * s->conf->alpha;
	float *work = gd_alloc(s->row, sizeof(*work));

	if (!work)
		return gd_fail(err, GD_ENOMEM, "pairs: out of memory");
	for (int y = 0; y < s->field.h; y++) {
		const size_t at = (size_t)y * s->row;

		for (size_t x = 0; x < s->row; x++)
			s->g.a[at + x] = (float)weight;
		for (int c = 0; c < s->in->n; c++) {
			const float *clean = gd_field_primal(&s->field, c, y, work);
			const float *raw = gd_row(s->in->primal[c], y);

			for (size_t x = 0; x < s->row; x++) {
				s->g.primal[4 * (at + x) + c] = clean[x];
				s->x[4 * (at + x) + c] = (double)clean[x];
				if (!isfinite(raw[x]))
					s->g.a[at + x] = (float)(1e-4 * weight);
			}
		}
	}
	free(work);
	return GD_OK;
}

static size_t root_of(unsigned *parent, size_t i)
{
	while (parent[i] != i) {
		parent[i] = parent[parent[i]];
		i = parent[i];
	}
	return i;
}

/* Connected parts by pairs that weigh something. */
static int count_parts(struct solver *s, struct gd_err *err)
{
	unsigned *parent = gd_alloc(s->pixels, sizeof(*parent));
	size_t parts = s->pixels;

	if (!parent)
		return gd_fail(err, GD_ENOMEM, "pairs: out of memory");
	for (size_t i = 0; i < s->pixels; i++)
		parent[i] = (unsigned)i;
	for (size_t k = 0; k < s->pixels * GD_PAIR_LINKS; k++) {
		const size_t i = k / GD_PAIR_LINKS;

		if (s->g.weight[k] > 0) {
			const size_t a = root_of(parent, i);
			const size_t b = root_of(parent, i + (size_t)s->jump[s->g.link[k]]);

			parent[a > b ? a : b] = (unsigned)(a > b ? b : a);
			parts -= a != b;
		}
	}
	free(parent);
	s->result.parts = (int)parts;
	return GD_OK;
}

#define FOR_ROWS(s, y, from, to)					\
	_Pragma("omp parallel for schedule(static)")			\
	for (int y = 0; y < (s)->field.h; y++)				\
		for (size_t from = (size_t)y * (s)->row, to = from + (s)->row; from < to; from = to)

static void add_partial(const struct solver *s, double sum[4])
{
	memset(sum, 0, 4 * sizeof(*sum));
	for (int y = 0; y < s->field.h; y++)
		for (int c = 0; c < 4; c++)
			sum[c] += s->partial[4 * y + c];
}

/*
 * The norm of the residual over the diagonal, relative to the start. The error in the energy norm,
 * which is what low frequencies show in, is at most 1 / sqrt(least eigenvalue) times that, about
 * 2 / alpha: hence bound.
 */
static double worst(const struct solver *s, const double rz[4], const double reference[4])
{
	double most = 0;

	for (int c = 0; c < 3; c++) {
		const double v = reference[c] > 0 ? sqrt(rz[c] / reference[c]) : 0;

		most = v > most || isnan(v) ? v : most;
	}
	return isnan(most) ? HUGE_VAL : most / s->bound;
}

static void true_residual(const struct solver *s, double rz[4])
{
	FOR_ROWS(s, y, from, to)
		s->k->residual(s->partial + 4 * y, s->r, &s->g, s->x, from, to);
	add_partial(s, rz);
}

/* One recursion, until the residual relative to reference is at most target; the steps it took. */
static int recur(struct solver *s, double rz[4], const double reference[4], double target,
		 int steps)
{
	double beta[4] = { 0 }, alpha[4] = { 0 }, pq[4], old[4];
	int n = 0;

	for (; n < steps && worst(s, rz, reference) > target; n++) {
		FOR_ROWS(s, y, from, to)
			s->k->direction(s->p, &s->g, s->r, beta, from, to);
		FOR_ROWS(s, y, from, to)
			s->k->apply(s->partial + 4 * y, s->q, &s->g, s->p, from, to);
		add_partial(s, pq);
		for (int c = 0; c < 3; c++)
			alpha[c] = pq[c] > 0 ? rz[c] / pq[c] : 0;
		memcpy(old, rz, sizeof(old));
		FOR_ROWS(s, y, from, to)
			s->k->step(s->partial + 4 * y, s->x, s->r, &s->g, s->p, s->q, alpha, from,
				   to);
		add_partial(s, rz);
		for (int c = 0; c < 3; c++)
			beta[c] = old[c] > 0 ? rz[c] / old[c] : 0;
	}
	return n;
}

static void solve_once(struct solver *s)
{
	double rz[4], reference[4], now = 1;
	int left = s->conf->max_iterations;

	FOR_ROWS(s, y, from, to)
		s->k->diagonal(&s->g, from, to);
	true_residual(s, reference);
	memcpy(rz, reference, sizeof(rz));
	now = worst(s, rz, reference);
	for (int i = 0; i < RESTARTS && now > s->tolerance && left > 0; i++) {
		int n = recur(s, rz, reference, fmax(s->tolerance, GAIN * now), left);

		s->result.iterations += n;
		left -= n;
		now = worst(s, rz, reference);
		if (now <= s->tolerance && s->tolerance > GAIN)
			break;
		true_residual(s, rz);
		now = worst(s, rz, reference);
		memset(s->p, 0, 4 * s->pixels * sizeof(*s->p));
	}
	s->result.residual = now;
}

static void solve_l1(struct solver *s, const struct gd_report *report)
{
	const double alpha = s->conf->alpha;

	for (int i = 0; i < s->conf->reweight; i++) {
		const double reg = s->level * fmax(L1_FIRST * pow(0.5, i - 1), L1_LAST);

		if (i > 0)
			FOR_ROWS(s, y, from, to)
				s->k->reweight(&s->g, s->x, alpha, reg, from, to);
		solve_once(s);
		gd_progress(report, "l1", (i + 1.0) / s->conf->reweight);
	}
}

static void store(const struct solver *s, const struct gd_plane *out)
{
	const double unscale = 1 / (double)s->field.scale, most = (double)FLT_MAX;

#pragma omp parallel for schedule(static)
	for (int y = 0; y < s->field.h; y++)
		for (int c = 0; c < s->in->n; c++)
			for (int x = 0; x < s->field.w; x++) {
				const double v =
					s->x[4 * ((size_t)y * s->row + (size_t)x) + c] * unscale;

				gd_row(out[c], y)[x] = v > most	   ? FLT_MAX
						       : v < -most ? -FLT_MAX
						       : v == v	   ? (float)v
								   : 0;
			}
}

int gd_pairsolve(const struct gd_plane *out, const struct gd_pairsolve_in *in,
		 const struct gd_poisson_conf *conf, struct gd_poisson_result *result,
		 const struct gd_report *report, struct gd_err *err)
{
	struct solver s = { .in = in, .conf = conf, .k = GD_PICK(gd_pair) };
	int rc = check(out, in, conf, err);

	if (rc != GD_OK)
		return rc;
	s.field = (struct gd_field){ in->pairs->w, in->pairs->h, in->n, 1, in->primal, NULL, NULL };
	s.row = (size_t)s.field.w;
	s.pixels = s.row * (size_t)s.field.h;
	if (in->value[0][0].v)
		s.field.dx = in->value[0];
	s.level = gd_field_level(&s.field);
	s.field.scale = gd_field_scale(s.level);
	s.level = s.level > 0 ? s.level * (double)s.field.scale : 1;
	s.tolerance = conf->method == GD_L1 ? fmax(conf->tolerance, L1_STEP) : conf->tolerance;
	s.bound = conf->method == GD_L1 ? 1 : fmin(1, conf->alpha);
	rc = allocate(&s, err);
	if (rc == GD_OK)
		rc = link_all(&s, err);
	if (rc == GD_OK)
		rc = screen(&s, err);
	if (rc == GD_OK)
		rc = count_parts(&s, err);
	if (rc == GD_OK) {
		if (conf->method == GD_L1)
			solve_l1(&s, report);
		else
			solve_once(&s);
		store(&s, out);
		s.result.converged = s.result.residual <= s.tolerance;
		gd_note(report,
			"%d iterations, relative residual %.2g, %d part%s, %zu pairs without "
			"weight",
			s.result.iterations, s.result.residual, s.result.parts,
			s.result.parts == 1 ? "" : "s", s.result.dropped);
		if (result)
			*result = s.result;
	}
	release(&s);
	return rc;
}
