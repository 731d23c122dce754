/* SPDX-License-Identifier: BSD-3-Clause */
#include "poisson.h"

#include <limits.h>
#include <math.h>
#include <omp.h>
#include <stdlib.h>
#include <string.h>

#include "edges.h"
#include "field.h"
#include "kernel/poisson_prep.h"
#include "multigrid.h"

#define FLOAT_TOLERANCE 3e-6	/* below this relative residual the rounding of float shows */
#define FLOAT_SPAN 1e-7		/* a part hanging on the rest by less than this times the largest */
				/* weight: rounding inside outweighs the pull on its constant */
#define WIDE_TOLERANCE 1e-9	/* where double is needed: the norm hardly sees such constants */
#define RESTARTS 10		/* from the true residual, where rounding stops the recursion */
#define L1_STEP 0.1	/* relative residual of each system: the next has other weights anyway */
#define L1_FIRST 0.05	/* regularisation of the weights, of the typical brightness */
#define L1_LAST 5e-3

struct solver {
	struct gd_field field;
	const struct gd_poisson_conf *conf;
	const struct gd_poisson_in *in;
	struct gd_mg *mg;
	bool wide;
	double level;			/* typical brightness, scaled */
	double tolerance;
	float *work;			/* rows of each thread */
	struct gd_poisson_result result;
};

static int check(const struct gd_poisson_in *in, const struct gd_poisson_conf *conf,
		 const struct gd_plane *out, struct gd_err *err)
{
	const int w = in->dx[0].w, h = in->dx[0].h;
	const bool screened = conf->method == GD_L2 || conf->method == GD_L1;
	int rc;

	if (in->n < 1 || in->n > 3 || w < 1 || h < 1)
		return gd_fail(err, GD_EARG, "poisson: %d channels of %dx%d", in->n, w, h);
	if ((long)w * h > INT_MAX / 2)
		return gd_fail(err, GD_ENOMEM, "poisson: %dx%d pixels are too many", w, h);
	if (!(conf->alpha >= 1e-3 && conf->alpha <= 1e3) ||
	    !(conf->tolerance >= 1e-12 && conf->tolerance <= 1) ||
	    !(conf->floor >= 1e-6 && conf->floor <= 1e6) ||
	    !(conf->smooth_px >= 0 && conf->smooth_px <= 8) || conf->max_iterations < 1 ||
	    conf->reweight < 1)
		return gd_fail(err, GD_EARG, "poisson: a setting is out of its range");
	for (int c = 0; c < in->n; c++) {
		if (!in->dx[c].v || !in->dy[c].v)
			return gd_fail(err, GD_EARG, "poisson: no gradients");
		if (screened && !in->primal[c].v)
			return gd_fail(err, GD_EARG, "poisson: no primal image");
		if (conf->method == GD_WLS && (!in->dxvar[c].v || !in->dyvar[c].v))
			return gd_fail(err, GD_EARG, "poisson: no variances of the gradients");
	}
	rc = gd_field_check(in->dx, in->n, w, h, "dx", err);
	if (rc == GD_OK)
		rc = gd_field_check(in->dy, in->n, w, h, "dy", err);
	if (rc == GD_OK)
		rc = gd_field_check(in->primal, in->n, w, h, "primal", err);
	if (rc == GD_OK)
		rc = gd_field_check(in->dxvar, in->n, w, h, "dx.variance", err);
	if (rc == GD_OK)
		rc = gd_field_check(in->dyvar, in->n, w, h, "dy.variance", err);
	if (rc == GD_OK)
		rc = gd_field_check(out, in->n, w, h, "output", err);
	return rc;
}

/* e and s: the variance of each edge, infinite where its gradient is not finite. */
static void variances(const struct solver *s, const struct gd_mg_level *l)
{
	const struct gd_prep_kernels *k = GD_PICK(gd_prep);
	const struct gd_poisson_in *in = s->in;
	const bool weighted = s->conf->method == GD_WLS;

#pragma omp parallel for schedule(static)
	for (int y = 0; y < l->h; y++) {
		const float *dx[3], *dy[3], *vx[3], *vy[3];

		for (int c = 0; c < in->n; c++) {
			dx[c] = gd_row(in->dx[c], y);
			dy[c] = gd_row(in->dy[c], y);
			vx[c] = weighted ? gd_row(in->dxvar[c], y) : NULL;
			vy[c] = weighted ? gd_row(in->dyvar[c], y) : NULL;
		}
		k->variance((float *)l->e + (size_t)y * l->stride, dx, vx, in->n, s->field.scale,
			    l->w - 1);
		if (y + 1 < l->h)
			k->variance((float *)l->s + (size_t)y * l->stride, dy, vy, in->n,
				    s->field.scale, l->w);
	}
}

static int weights(struct solver *s, struct gd_err *err)
{
	const struct gd_mg_level *l = gd_mg_grid(s->mg);
	const double unscale = 1 / (double)s->field.scale;
	double phi = 1;
	int rc = GD_OK;

	variances(s, l);
	if (s->conf->method == GD_WLS) {
		double median = gd_edges_median(l);

		if (median > 0)		/* else all variances are 0, and all weights equal */
			phi = fmin(fmax(s->conf->floor * median, 1e-30), 1e30);
		rc = gd_edges_smooth(l, gd_mg_spare(s->mg), s->conf->smooth_px, GD_EDGES_CAP * phi,
				     err);
		s->result.phi = median > 0 ? phi * unscale * unscale : 0;
	}
	if (rc == GD_OK)
		s->result.dropped = gd_edges_weigh(l, phi);
	return rc;
}

static double least_weight(const struct gd_mg_level *l)
{
	double least = 1;

#pragma omp parallel for schedule(static) reduction(min:least)	/* a minimum has no rounding */
	for (int y = 0; y < l->h; y++) {
		const float *e = (const float *)l->e + (size_t)y * l->stride;
		const float *s = (const float *)l->s + (size_t)y * l->stride;

		for (int x = 0; x < l->w; x++) {
			least = e[x] > 0 && (double)e[x] < least ? (double)e[x] : least;
			least = s[x] > 0 && (double)s[x] < least ? (double)s[x] : least;
		}
	}
	return least;
}

/* Is there a part of two pixels or more that hangs on the rest by weights that float cannot see? */
static bool needs_double(const struct gd_mg_level *l)
{
	const size_t n = (size_t)l->w * (size_t)l->h;
	int *label, *pixels, many = 0;

	if (least_weight(l) > FLOAT_SPAN)
		return false;
	label = gd_alloc(n, sizeof(*label));
	pixels = gd_calloc(n, sizeof(*pixels));
	if (label && pixels) {
		gd_edges_parts(l, false, FLOAT_SPAN, label);
		for (size_t i = 0; i < n; i++)
			many += ++pixels[label[i]] == 2;
	}
	free(label);
	free(pixels);
	return many > 1;
}

/* Replaces the float grids by double ones with the same weights, for one channel at a time. */
static int widen(struct solver *s, bool screened, struct gd_err *err)
{
	const struct gd_mg_level *from = gd_mg_grid(s->mg), *to;
	struct gd_mg *mg;
	int rc = gd_mg_new(&mg, s->field.w, s->field.h, 1, true, screened, err);

	if (rc != GD_OK)
		return rc;
	to = gd_mg_grid(mg);
	for (int y = 0; y < from->h; y++)
		for (int x = 0; x < from->w; x++) {
			const size_t i = (size_t)y * from->stride + (size_t)x,
				     j = (size_t)y * to->stride + (size_t)x;

			((double *)to->e)[j] = (double)((const float *)from->e)[i];
			((double *)to->s)[j] = (double)((const float *)from->s)[i];
		}
	gd_mg_free(s->mg);
	s->mg = mg;
	s->wide = s->result.wide = true;
	return GD_OK;
}

static void residual(const struct solver *s, const struct gd_field *field)
{
	const struct gd_mg_level *l = gd_mg_grid(s->mg);
	const struct gd_mg_kernels *k = s->wide ? GD_PICK(gd_mg_f64) : GD_PICK(gd_mg_f32);
	const size_t size = gd_field_work(field);

#pragma omp parallel for schedule(static)
	for (int y = 0; y < l->h; y++) {
		struct gd_mg_rows rows =
			gd_field_rows(field, y, s->work + (size_t)omp_get_thread_num() * size);

		k->residual(l, field->n, gd_mg_x(s->mg), &rows, y);
	}
}

static void reweight(const struct solver *s, double reg)
{
	const struct gd_mg_level *l = gd_mg_grid(s->mg);
	const struct gd_mg_kernels *k = s->wide ? GD_PICK(gd_mg_f64) : GD_PICK(gd_mg_f32);
	const size_t size = gd_field_work(&s->field);

#pragma omp parallel for schedule(static)
	for (int y = 0; y < l->h; y++) {
		struct gd_mg_rows rows =
			gd_field_rows(&s->field, y, s->work + (size_t)omp_get_thread_num() * size);

		k->reweight(l, s->field.n, gd_mg_x(s->mg), &rows, s->conf->alpha, reg, y);
	}
}

static void solve_once(struct solver *s, const struct gd_field *field, double tolerance)
{
	struct gd_mg_result done;

	residual(s, field);
	done = gd_mg_solve(s->mg, tolerance, s->conf->max_iterations);
	s->result.iterations += done.iterations;
	for (int i = 0;
	     i < RESTARTS && done.residual > tolerance && done.iterations < s->conf->max_iterations;
	     i++) {
		residual(s, field);
		done = gd_mg_resume(s->mg, tolerance, s->conf->max_iterations);
		s->result.iterations += done.iterations;
	}
	s->result.residual = fmax(s->result.residual, done.residual);
}

static int linear(struct solver *s, const struct gd_plane *out, struct gd_err *err)
{
	const bool screened = s->conf->method == GD_L2;
	const bool whole = s->result.dropped == 0;
	const int step = s->wide ? 1 : s->field.n;
	int rc = GD_OK;

	if (screened)
		gd_field_screen(&s->field, gd_mg_grid(s->mg), s->wide,
				s->conf->alpha * s->conf->alpha);
	gd_mg_setup(s->mg);
	for (int c = 0; c < s->field.n && rc == GD_OK; c += step) {
		const struct gd_mg_level *l = gd_mg_grid(s->mg);
		struct gd_field field = s->field;

		field.n = step;
		field.primal += c;
		field.dx += c;
		field.dy += c;
		if (c > 0)
			memset(gd_mg_x(s->mg), 0,
			       (size_t)(l->h - 1) * l->stride * sizeof(double) +
				       (size_t)l->w * sizeof(double));
		solve_once(s, &field, s->tolerance);
		if (!screened)
			rc = gd_field_anchor(&field, l, s->wide, gd_mg_x(s->mg), true, whole,
					     &s->result.parts, err);
		gd_field_store(&field, out + c, l, s->wide, gd_mg_x(s->mg));
	}
	return rc;
}

/*
 * Iteratively reweighted least squares: the screened solution first, then every row (an edge or a
 * primal pixel, its residual's norm over the channels) weighs 1 over its last residual. The
 * regularisation of that division falls by half each time, from 5 % of the typical brightness to
 * 0.5 % of it: of residuals below that nothing is seen in the image, and giving them ever more
 * weight makes it worse. Each system starts from the last solution.
 */
static int reweighted(struct solver *s, const struct gd_plane *out, const struct gd_report *report)
{
	const struct gd_mg_level *l = gd_mg_grid(s->mg);

	gd_field_screen(&s->field, l, false, s->conf->alpha * s->conf->alpha);
	for (int i = 0; i < s->conf->reweight; i++) {
		if (i > 0)
			reweight(s, s->level * fmax(L1_FIRST * pow(0.5, i - 1), L1_LAST));
		gd_mg_setup(s->mg);
		s->result.residual = 0;
		solve_once(s, &s->field, s->tolerance);
		gd_progress(report, "l1", (i + 1.0) / s->conf->reweight);
	}
	gd_field_store(&s->field, out, l, false, gd_mg_x(s->mg));
	return GD_OK;
}

int gd_poisson_solve(const struct gd_plane *out, const struct gd_poisson_in *in,
		     const struct gd_poisson_conf *conf, struct gd_poisson_result *result,
		     const struct gd_report *report, struct gd_err *err)
{
	const bool screened = conf->method == GD_L2 || conf->method == GD_L1;
	struct solver s = { .conf = conf, .in = in };
	int rc = check(in, conf, out, err);

	if (rc != GD_OK)
		return rc;
	s.field = (struct gd_field){in->dx[0].w, in->dx[0].h, in->n, 1, in->primal, in->dx, in->dy};
	s.level = gd_field_level(&s.field);
	s.field.scale = gd_field_scale(s.level);
	s.level = s.level > 0 ? s.level * (double)s.field.scale : 1;
	s.result.parts = 1;
	s.work =
		gd_calloc((size_t)omp_get_max_threads() * gd_field_work(&s.field), sizeof(*s.work));
	if (!s.work)
		return gd_fail(err, GD_ENOMEM, "poisson: out of memory");
	rc = gd_mg_new(&s.mg, s.field.w, s.field.h, in->n, false, screened, err);
	if (rc == GD_OK)
		rc = weights(&s, err);
	s.tolerance = conf->method == GD_L1 ? fmax(conf->tolerance, L1_STEP) : conf->tolerance;
	if (rc == GD_OK && conf->method == GD_WLS && needs_double(gd_mg_grid(s.mg))) {
		s.tolerance = fmin(s.tolerance, WIDE_TOLERANCE);
		rc = widen(&s, screened, err);
	} else if (rc == GD_OK && s.tolerance < FLOAT_TOLERANCE) {
		rc = widen(&s, screened, err);
	}
	if (rc == GD_OK)
		rc = conf->method == GD_L1 ? reweighted(&s, out, report) : linear(&s, out, err);
	if (rc == GD_OK) {
		s.result.converged = s.result.residual <= s.tolerance;
		gd_note(report,
			"%d iterations, relative residual %.2g, %d part%s, %zu edges without "
			"weight%s",
			s.result.iterations, s.result.residual, s.result.parts,
			s.result.parts == 1 ? "" : "s", s.result.dropped,
			s.wide ? ", in double" : "");
		if (result)
			*result = s.result;
	}
	gd_mg_free(s.mg);
	free(s.work);
	return rc;
}
