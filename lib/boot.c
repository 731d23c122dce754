/* SPDX-License-Identifier: BSD-3-Clause */
#include "boot.h"

#include <float.h>
#include <limits.h>
#include <math.h>
#include <omp.h>
#include <stdlib.h>
#include <string.h>

#include "blur.h"
#include "edges.h"
#include "field.h"
#include "kernel/poisson_boot.h"
#include "multigrid.h"
#include "rng.h"

#define MAX_ITERATIONS 1000

/*
 * Variance of a solution's detail (what a blur by 2 px leaves) over that of the edges, for equal
 * weights and independent edges: the mean over all frequencies of (1 - G)^2 / L, with G the
 * transform of the blur and L that of the Laplacian.
 */
#define DETAIL 0.318

struct boot {
	const struct gd_boot_in *in;
	const struct gd_boot_conf *conf;
	struct gd_field field;
	struct gd_mg *mg;
	const struct gd_mg_level *grid;
	float *start; /* the solution without resampling, n planes as the grid's */
	float *work;			/* blurring, per thread */
	size_t work_size;
	double phi;			/* scaled */
	struct gd_boot_result result;
};

static int check(const struct gd_boot_in *in, const struct gd_boot_conf *conf, struct gd_err *err)
{
	int rc = GD_OK, w, h;

	if (in->n < 1 || in->n > 3 || in->bins < 1 || in->bins > GD_BOOT_MAX_BINS)
		return gd_fail(err, GD_EARG, "bagging: %d bins of %d channels", in->bins, in->n);
	if (conf->replicates < 2 || conf->replicates > 1000 ||
	    !(conf->floor >= 1e-6 && conf->floor <= 1e6) ||
	    !(conf->smooth_px >= 0 && conf->smooth_px <= 8) ||
	    !(conf->tolerance > 0 && conf->tolerance <= 1) ||
	    !(conf->tolerance_t > 0 && conf->tolerance_t <= 1) ||
	    !(conf->local_px > 0 && conf->local_px <= 10))
		return gd_fail(err, GD_EARG, "bagging: a setting is out of its range");
	w = in->dx[0][0].w;
	h = in->dx[0][0].h;
	if (w < 1 || h < 1 || (long)w * h > INT_MAX / 2)
		return gd_fail(err, GD_ENOMEM, "bagging: cannot work on %dx%d pixels", w, h);
	for (int b = 0; b < in->bins; b++)
		for (int c = 0; c < in->n; c++)
			if (!in->dx[b][c].v || !in->dy[b][c].v)
				return gd_fail(err, GD_EARG, "bagging: bin %d lacks a gradient", b);
	for (int b = 0; b < in->bins && rc == GD_OK; b++) {
		rc = gd_field_check(in->dx[b], in->n, w, h, "dx of a bin", err);
		if (rc == GD_OK)
			rc = gd_field_check(in->dy[b], in->n, w, h, "dy of a bin", err);
	}
	return rc == GD_OK ? gd_field_check(in->primal, in->n, w, h, "primal", err) : rc;
}

static float *plane_row(const struct boot *b, void *planes, int c, int y)
{
	return (float *)planes + c * b->grid->plane + (size_t)y * b->grid->stride;
}

static void resample_row(const struct boot *b, const struct gd_plane (*from)[3], void *to,
			 void *var, int y, const struct gd_rng_key *key)
{
	struct gd_boot_rows rows = { b->in->bins, b->in->n, { { NULL } } };
	float *v[3];

	for (int c = 0; c < b->in->n; c++) {
		v[c] = plane_row(b, to, c, y);
		for (int i = 0; i < b->in->bins; i++)
			rows.bin[i][c] = gd_row(from[i][c], y);
	}
	GD_PICK(gd_boot_rows)
		->resample(v, plane_row(b, var, 0, y), &rows, key,
			   (uint32_t)y * (uint32_t)b->grid->w, b->field.scale, b->grid->w);
}

/*
 * A sample of the gradients (all bins once if key is NULL) into planes that the solver has not
 * begun to use: dx into spare, dy into z; its variances into e and s. Beyond the border: no
 * variance, which counts nowhere.
 */
static void resample(const struct boot *b, const struct gd_rng_key *key)
{
	const struct gd_mg_level *l = b->grid;

#pragma omp parallel for schedule(static)
	for (int y = 0; y < l->h; y++) {
		resample_row(b, b->in->dx, gd_mg_spare(b->mg), l->e, y, key);
		resample_row(b, b->in->dy, l->z, l->s, y, key);
		plane_row(b, l->e, 0, y)[l->w - 1] = 0;
		if (y + 1 == l->h)
			memset(plane_row(b, l->s, 0, y), 0, (size_t)l->w * sizeof(float));
	}
}

/* Variances to weights; phi comes from the gradients
 * without resampling, and serves all replicates. */
static int weights(struct boot *b, bool first, size_t *dropped, struct gd_err *err)
{
	int rc;

	if (first) {
		double median = gd_edges_median(b->grid);
		double unscale = 1 / (double)b->field.scale;

		b->phi = median > 0 ? fmin(fmax(b->conf->floor * median, 1e-30), 1e30) : 1;
		b->result.phi = median > 0 ? b->phi * unscale * unscale : 0;
	}
	rc = gd_edges_smooth(b->grid, b->grid->r, b->conf->smooth_px, GD_EDGES_CAP * b->phi, err);
	if (rc == GD_OK)
		*dropped = gd_edges_weigh(b->grid, b->phi);
	return rc;
}

/* r = G'W (v - G start) from the sample that resample() left. */
static void residual(const struct boot *b)
{
	const struct gd_mg_kernels *k = GD_PICK(gd_mg_f32);

#pragma omp parallel for schedule(static)
	for (int y = 0; y < b->grid->h; y++) {
		struct gd_mg_rows rows = { { NULL }, { NULL }, { NULL }, { NULL } };

		for (int c = 0; c < b->in->n; c++) {
			rows.dx[c] = plane_row(b, gd_mg_spare(b->mg), c, y);
			rows.dy[c] = plane_row(b, b->grid->z, c, y);
			rows.up[c] = plane_row(b, b->grid->z, c, y - 1);
		}
		k->residual(b->grid, b->in->n, b->start, &rows, y);
	}
}

/*
 * One solution: x = what is to be added to start. A replicate differs from the solution of
 * all bins by noise only, so its system starts there and needs a relative residual no
 * better than the spread deserves.
 */
static int solve(struct boot *b, const struct gd_rng_key *key, struct gd_err *err)
{
	const double tolerance = key ? b->conf->tolerance_t : b->conf->tolerance;
	struct gd_mg_result done;
	size_t dropped = 0;
	int rc;

	resample(b, key);
	rc = weights(b, !key, &dropped, err);
	if (rc != GD_OK)
		return rc;
	gd_mg_setup(b->mg);
	residual(b);
	memset(gd_mg_x(b->mg), 0,
	       ((size_t)(b->in->n - 1) * b->grid->plane + (size_t)b->grid->h * b->grid->stride) *
		       sizeof(float));
	done = gd_mg_solve(b->mg, tolerance, MAX_ITERATIONS);
	b->result.iterations += done.iterations;
	b->result.residual = fmax(b->result.residual, done.residual / tolerance);
	return gd_field_anchor(&b->field, b->grid, false, gd_mg_x(b->mg), !key, dropped == 0,
			       key ? NULL : &b->result.parts, err);
}

static int prepare(struct boot *b, const struct gd_boot_in *in, const struct gd_boot_conf *conf,
		   struct gd_err *err)
{
	const int w = in->dx[0][0].w, h = in->dx[0][0].h;
	int rc;

	b->in = in;
	b->conf = conf;
	b->field = (struct gd_field){ w, h, in->n, 1, in->primal, in->dx[0], in->dy[0] };
	b->field.scale = gd_field_scale(gd_field_level(&b->field));
	rc = gd_mg_new(&b->mg, w, h, in->n, false, false, err);
	if (rc != GD_OK)
		return rc;
	b->grid = gd_mg_grid(b->mg);
	b->work_size = gd_blur_work(w);
	b->work = gd_alloc((size_t)omp_get_max_threads() * b->work_size, sizeof(*b->work));
	b->start = gd_calloc((size_t)in->n * b->grid->plane + 2 * b->grid->stride + 32,
			     sizeof(*b->start));
	if (!b->work || !b->start)
		return gd_fail(err, GD_ENOMEM, "bagging: out of memory");
	b->start += b->grid->stride + 16;
	return GD_OK;
}

static void finish(struct boot *b, struct gd_boot_result *result)
{
	if (result)
		*result = b->result;
	if (b->start)
		free(b->start - b->grid->stride - 16);
	free(b->work);
	gd_mg_free(b->mg);
}

static struct gd_plane grid_plane(const struct boot *b, void *planes, int c)
{
	return (struct gd_plane){plane_row(b, planes, c, 0), b->grid->w, b->grid->h,
				 b->grid->stride};
}

/* Adds the replicate in x, its square, and the square of
 * what is left of it after blurring, to the outputs. */
static void accumulate(const struct boot *b, const struct gd_boot_out *out,
		       const struct gd_blur *blur)
{
	for (int c = 0; c < b->in->n; c++) {
		const struct gd_plane d = grid_plane(b, gd_mg_x(b->mg), c),
				      low = grid_plane(b, gd_mg_spare(b->mg), c);
		const bool local = out->local[c].v;

		if (local)
			gd_blur_down(low, d, blur);
#pragma omp parallel for schedule(static)
		for (int y = 0; y < d.h; y++) {
			float *work = b->work + (size_t)omp_get_thread_num() * b->work_size;

			GD_PICK(gd_boot_rows)
				->add(gd_row(out->mean[c], y),
				      out->var[c].v ? gd_row(out->var[c], y) : NULL,
				      local ? gd_row(out->local[c], y) : NULL, gd_row(d, y),
				      local ? gd_blur_row(low, y, blur, work) : NULL, d.w);
		}
	}
}

static float limited(double v)
{
	return v >= (double)FLT_MAX    ? FLT_MAX
	       : v <= -(double)FLT_MAX ? -FLT_MAX
	       : v == v		       ? (float)v
				       : 0;
}

static float variance_of(double squares, double sum, double n, double unit)
{
	double v = (squares - sum * sum / n) / (n - 1);

	return v > 0 ? limited(v * unit) : 0;
}

/* Sums to means and variances. The blur is linear, so
 * the sum of the high-pass parts is that of the sum. */
static int conclude(const struct boot *b, const struct gd_boot_out *out, const struct gd_blur *blur,
		    struct gd_err *err)
{
	const double unscale = 1 / (double)b->field.scale, unit = unscale * unscale,
		     n = b->conf->replicates;
	const struct gd_blur box = gd_blur_box(3);
	const struct gd_plane low = grid_plane(b, gd_mg_spare(b->mg), 0);
	int rc = GD_OK;

	for (int c = 0; c < b->in->n && rc == GD_OK; c++) {
		const bool local = out->local[c].v, var = out->var[c].v;

		if (local)
			gd_blur_down(low, out->mean[c], blur);
#pragma omp parallel for schedule(static)
		for (int y = 0; y < low.h; y++) {
			float *work = b->work + (size_t)omp_get_thread_num() * b->work_size,
			      *sum = gd_row(out->mean[c], y);
			const float *smooth = local ? gd_blur_row(low, y, blur, work) : NULL,
				    *f = plane_row(b, b->start, c, y);

			for (int x = 0; x < low.w; x++) {
				const double s = (double)sum[x];

				if (var)
					gd_row(out->var[c], y)[x] = variance_of(
						(double)gd_row(out->var[c], y)[x], s, n, unit);
				if (local)
					gd_row(out->local[c], y)[x] =
						variance_of((double)gd_row(out->local[c], y)[x],
							    s - (double)smooth[x], n, unit);
				sum[x] = limited(((double)f[x] + s / n) * unscale);
			}
		}
		if (local)
			rc = gd_blur_plane(out->local[c], low, &box, err);
	}
	return rc;
}

static void clear(struct gd_plane p)
{
	for (int y = 0; p.v && y < p.h; y++)
		memset(gd_row(p, y), 0, (size_t)p.w * sizeof(float));
}

static int check_out(const struct gd_boot_out *out, const struct gd_boot_in *in, struct gd_err *err)
{
	const int w = in->dx[0][0].w, h = in->dx[0][0].h;
	int rc = gd_field_check(out->mean, in->n, w, h, "mean", err);

	if (rc == GD_OK)
		rc = gd_field_check(out->var, in->n, w, h, "variance", err);
	return rc == GD_OK ? gd_field_check(out->local, in->n, w, h, "local variance", err) : rc;
}

/* to = square of the high-pass part of v times factor,
 * averaged over a box. spare: of the same size. */
static int local_power(struct gd_plane to, struct gd_plane v, struct gd_plane spare,
		       double local_px, int side, double factor, struct gd_err *err)
{
	const struct gd_blur blur = gd_blur_gauss(local_px), box = gd_blur_box(side);
	const size_t size = gd_blur_work(v.w);
	float *all = gd_alloc((size_t)omp_get_max_threads() * size, sizeof(*all));
	int rc;

	if (!all)
		return gd_fail(err, GD_ENOMEM, "bagging: out of memory");
	gd_blur_down(spare, v, &blur);
#pragma omp parallel for schedule(static)
	for (int y = 0; y < v.h; y++) {
		const float *low =
			gd_blur_row(spare, y, &blur, all + (size_t)omp_get_thread_num() * size);

		for (int x = 0; x < v.w; x++) {
			double d = (double)gd_row(v, y)[x] - (double)low[x];

			gd_row(to, y)[x] = limited(fmin(d * d * factor, 1e36));
		}
	}
	free(all);
	rc = gd_blur_plane(to, spare, &box, err);
	return rc;
}

/* One bin shows no spread: the high-pass part of the image itself stands for it. */
static int without_draws(const struct boot *b, const struct gd_boot_out *out, struct gd_err *err)
{
	const struct gd_plane spare = grid_plane(b, gd_mg_spare(b->mg), 0);
	int rc = GD_OK;

	gd_field_store(&b->field, out->mean, b->grid, false, gd_mg_x(b->mg));
	for (int c = 0; c < b->in->n && rc == GD_OK; c++) {
		if (out->var[c].v)
			rc = local_power(out->var[c], out->mean[c], spare, b->conf->local_px, 7, 1,
					 err);
		if (rc == GD_OK && out->local[c].v)
			rc = local_power(out->local[c], out->mean[c], spare, b->conf->local_px, 7,
					 1, err);
	}
	return rc;
}

int gd_boot_run(const struct gd_boot_out *out, const struct gd_boot_in *in,
		const struct gd_boot_conf *conf, struct gd_boot_result *result,
		const struct gd_report *report, struct gd_err *err)
{
	struct boot b = { 0 };
	struct gd_blur blur;
	int rc = check(in, conf, err);

	if (rc == GD_OK)
		rc = check_out(out, in, err);
	if (rc != GD_OK)
		return rc;
	blur = gd_blur_gauss(conf->local_px);
	rc = prepare(&b, in, conf, err);
	if (rc == GD_OK)
		rc = solve(&b, NULL, err);
	if (rc == GD_OK && in->bins < 2) {
		rc = without_draws(&b, out, err);
		finish(&b, result);
		return rc;
	}
	if (rc == GD_OK) {
		memcpy(b.start, gd_mg_x(b.mg),
		       ((size_t)(in->n - 1) * b.grid->plane + (size_t)b.grid->h * b.grid->stride) *
			       sizeof(float));
		for (int c = 0; c < in->n; c++) {
			clear(out->mean[c]);
			clear(out->var[c]);
			clear(out->local[c]);
		}
	}
	for (int t = 0; t < conf->replicates && rc == GD_OK; t++) {
		const struct gd_rng_key key = gd_rng_key(conf->seed, (uint64_t)t);

		rc = solve(&b, &key, err);
		if (rc == GD_OK)
			accumulate(&b, out, &blur);
		gd_progress(report, "bagging", (t + 1.0) / conf->replicates);
	}
	if (rc == GD_OK)
		rc = conclude(&b, out, &blur, err);
	if (rc == GD_OK)
		gd_note(report, "%d bins, %d replicates, %d iterations, %d part%s", in->bins,
			conf->replicates, b.result.iterations, b.result.parts,
			b.result.parts == 1 ? "" : "s");
	finish(&b, result);
	return rc;
}

int gd_boot_plain(const struct gd_plane *mean, const struct gd_boot_in *in,
		  const struct gd_boot_conf *conf, struct gd_boot_result *result,
		  const struct gd_report *report, struct gd_err *err)
{
	struct boot b = { 0 };
	int rc = check(in, conf, err);

	if (rc == GD_OK)
		rc = gd_field_check(mean, in->n, in->dx[0][0].w, in->dx[0][0].h, "mean", err);
	if (rc == GD_OK)
		rc = prepare(&b, in, conf, err);
	if (rc == GD_OK)
		rc = solve(&b, NULL, err);
	if (rc == GD_OK) {
		gd_field_store(&b.field, mean, b.grid, false, gd_mg_x(b.mg));
		gd_note(report, "%d bins, no replicates, %d iterations, %d part%s", in->bins,
			b.result.iterations, b.result.parts, b.result.parts == 1 ? "" : "s");
	}
	finish(&b, result);
	return rc;
}

int gd_boot_halves(const struct gd_plane *local, const struct gd_plane *a, const struct gd_plane *b,
		   int n, double local_px, struct gd_err *err)
{
	const size_t size = (size_t)a[0].h * gd_stride(a[0].w);
	float *block = gd_alloc(2 * size, sizeof(*block));
	struct gd_plane diff, spare;
	int rc = GD_OK;

	if (!block)
		return gd_fail(err, GD_ENOMEM, "bagging: out of memory");
	diff = gd_plane_of(block, a[0].w, a[0].h);
	spare = gd_plane_of(block + size, a[0].w, a[0].h);
	for (int c = 0; c < n && rc == GD_OK; c++) {
#pragma omp parallel for schedule(static)
		for (int y = 0; y < diff.h; y++)
			for (int x = 0; x < diff.w; x++)
				gd_row(diff, y)[x] = limited((double)gd_row(a[c], y)[x] -
							     (double)gd_row(b[c], y)[x]);
		rc = local_power(local[c], diff, spare, local_px, 5, 0.25, err);
	}
	free(block);
	return rc;
}

void gd_boot_edges(struct gd_plane local, struct gd_plane dxvar, struct gd_plane dyvar)
{
#pragma omp parallel for schedule(static)
	for (int y = 0; y < local.h; y++)
		for (int x = 0; x < local.w; x++) {
			double sum = 0.0;
			int n = 0;

			for (int j = y > 2 ? y - 2 : 0; j <= y + 2 && j < local.h; j++)
				for (int i = x > 2 ? x - 2 : 0; i <= x + 2 && i < local.w; i++) {
					float a = gd_row(dxvar, j)[i], b = gd_row(dyvar, j)[i];

					sum += (isfinite(a) && a > 0.0f ? a : 0.0) +
					       (isfinite(b) && b > 0.0f ? b : 0.0);
					n += 2;
				}
			gd_row(local, y)[x] = limited(DETAIL * sum / n);
		}
}
