/* SPDX-License-Identifier: BSD-3-Clause */
/* Sparse linear predictions: checks, the placement of centres, and the loop over tiles. */
#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include <omp.h>

#include "lwr.h"
#include "lwr_impl.h"

static int check_planes(const struct gd_plane *plane, int n, struct gd_plane like, const char *what,
			struct gd_err *err)
{
	return gd_planes_check("lwr", what, plane, n, like.w, like.h, false, err);
}

/* Of planes that may be left out. */
static int check_optional(struct gd_plane plane, struct gd_plane like, const char *what,
			  struct gd_err *err)
{
	return gd_planes_check("lwr", what, &plane, 1, like.w, like.h, true, err);
}

static int check_conf(const struct gd_lwr_conf *c, struct gd_err *err)
{
	if (c->radius < 1 || c->radius > GD_LWR_RADIUS)
		return gd_fail(err, GD_EARG, "lwr: radius %d, expected 1 to %d", c->radius,
			       GD_LWR_RADIUS);
	if (c->per_column < 0)
		return gd_fail(err, GD_EARG, "lwr: %d pixels for each column, expected 0 or more",
			       c->per_column);
	if (c->granularity < 0 || c->granularity > 2 * c->radius + 1)
		return gd_fail(err, GD_EARG, "lwr: granularity %d, expected 0 to %d",
			       c->granularity, 2 * c->radius + 1);
	if (!(c->ridge >= 0 && c->flat >= 0 && c->feature_noise >= 0))
		return gd_fail(err, GD_EARG,
			       "lwr: ridge %g, flat %g, feature noise %g, expected 0 or more",
			       c->ridge, c->flat, c->feature_noise);
	return GD_OK;
}

static int colours(const struct gd_lwr_in *in)
{
	return in->ny < 3 ? 1 : 3;
}

static int check(const struct gd_lwr_out *out, const struct gd_lwr_in *in,
		 const struct gd_lwr_conf *conf, struct gd_err *err)
{
	int rc = check_conf(conf, err), nc = colours(in);
	struct gd_plane like;

	if (rc != GD_OK)
		return rc;
	if (in->ny < 1 || in->ny > GD_LWR_RHS)
		return gd_fail(err, GD_EARG, "lwr: %d planes, expected 1 to %d", in->ny,
			       GD_LWR_RHS);
	if (in->nfeat < 0 || in->nfeat > GD_LWR_FEATURES)
		return gd_fail(err, GD_EARG, "lwr: %d feature planes, at most %d", in->nfeat,
			       GD_LWR_FEATURES);
	if (!in->y[0].v || in->y[0].w < 1 || in->y[0].h < 1)
		return gd_fail(err, GD_ESHAPE, "lwr: empty image");
	like = in->y[0];
	rc = check_planes(in->y, in->ny, like, "input", err);
	if (rc == GD_OK && in->twin)
		rc = check_planes(in->twin, nc, like, "twin", err);
	if (rc == GD_OK && in->var)
		rc = check_planes(in->var, nc, like, "variance", err);
	if (rc == GD_OK)
		rc = check_planes(in->feat, in->nfeat, like, "feature", err);
	for (int a = 0; rc == GD_OK && in->feat_var && a < in->nfeat; a++)
		rc = check_optional(in->feat_var[a], like, "feature variance", err);
	if (rc == GD_OK)
		rc = check_optional(in->weight, like, "weight", err);
	if (rc == GD_OK)
		rc = check_planes(out->est, in->ny, like, "output", err);
	if (rc == GD_OK && out->mse)
		rc = check_planes(out->mse, nc, like, "error", err);
	if (rc == GD_OK && out->spread)
		rc = check_planes(out->spread, nc, like, "spread", err);
	if (rc == GD_OK)
		rc = check_optional(out->radius, like, "radius", err);
	if (rc == GD_OK)
		rc = check_optional(out->features, like, "features", err);
	if (rc == GD_OK)
		rc = check_optional(out->centre, like, "centre", err);
	return rc;
}

/* Every thread its share of the pages, as of the work. */
static void clear(const struct gd_lwr_plan *p)
{
	const size_t row = (size_t)p->w * p->sums;

#pragma omp parallel for schedule(static)
	for (int y = 0; y < p->h; y++) {
		memset(p->sum + row * (size_t)y, 0, row * sizeof *p->sum);
		if (p->out_centre.v)
			memset(gd_row(p->out_centre, y), 0, (size_t)p->w * sizeof(float));
	}
}

/* Number k of the sums of row y, over the number of models, into a plane. */
static void means(const struct gd_lwr_plan *p, struct gd_plane to, size_t k, int y)
{
	const float *sum = p->sum + (size_t)y * (size_t)p->w * p->sums;

	for (int x = 0; to.v && x < p->w; x++, sum += p->sums)
		gd_row(to, y)[x] = sum[k] / sum[3];
}

/* The mean square, less the square of the mean. */
static void spread_of(struct gd_plane square, struct gd_plane mean, int y)
{
	float *row = gd_row(square, y);
	const float *m = gd_row(mean, y);

	for (int x = 0; x < mean.w; x++) {
		double v = (double)row[x] - (double)m[x] * (double)m[x];

		row[x] = v > 0 ? (float)v : 0;
	}
}

/* From sums to means: every pixel has a model of its own if no other covers it. */
static void finish(const struct gd_lwr_plan *p)
{
#pragma omp parallel for schedule(static)
	for (int y = 0; y < p->h; y++) {
		for (int c = 0; c < p->ny; c++)
			means(p, p->est[c], (size_t)(c / 3 * 4 + c % 3), y);
		for (int c = 0; p->mse && c < p->nc; c++)
			means(p, p->mse[c], p->at_error + (size_t)c, y);
		for (int c = 0; p->spread && c < p->nc; c++) {
			means(p, p->spread[c], p->at_spread + (size_t)c, y);
			spread_of(p->spread[c], p->est[c], y);
		}
		means(p, p->out_radius, p->at_error + 3, y);
		means(p, p->out_features, p->at_spread + 3, y);
	}
}

/* Marks the places of the pass's grid that no window covers, or all. */
static void mark(const struct gd_lwr_plan *p, bool all)
{
#pragma omp parallel for schedule(static)
	for (int j = 0; j < p->nrow; j++) {
		unsigned char *row = p->mark + (size_t)p->cy[j] * (size_t)p->w;
		const float *models = p->sum + (size_t)p->cy[j] * (size_t)p->w * p->sums + 3;

		for (int i = 0; i < p->nx; i++)
			row[p->cx[i]] = all || !(models[(size_t)p->cx[i] * p->sums] > 0);
	}
}

/*
 * All tiles, in four turns so that no two at work at a time are neighbours; what a pixel gets then
 * comes in an order that does not depend on the threads.
 */
static void run_tiles(const struct gd_lwr_plan *p, const struct gd_lwr_kernels *k, double *work,
		      size_t size, struct gd_lwr_count *count)
{
	const int across = (p->w - 1) / GD_LWR_TILE + 1, down = (p->h - 1) / GD_LWR_TILE + 1;

	for (int turn = 0; turn < 4; turn++) {
		const int tx = turn % 2, ty = turn / 2;
		const int nx = (across - tx + 1) / 2, ny = (down - ty + 1) / 2;

#pragma omp parallel for schedule(dynamic)
		for (int i = 0; i < nx * ny; i++) {
			int x = 2 * (i % nx) + tx, y = 2 * (i / nx) + ty;

			k->tile(p, x * GD_LWR_TILE, y * GD_LWR_TILE, (x + 1) * GD_LWR_TILE,
				(y + 1) * GD_LWR_TILE, work + size * (size_t)omp_get_thread_num(),
				count + y * across + x);
		}
	}
}

static int run_passes(struct gd_lwr_plan *p, const struct gd_lwr_conf *conf,
		      struct gd_lwr_result *result, const struct gd_report *report)
{
	const struct gd_lwr_kernels *k = GD_PICK(gd_lwr_kernels);
	const size_t tiles = (size_t)((p->w - 1) / GD_LWR_TILE + 1) *
			     (size_t)((p->h - 1) / GD_LWR_TILE + 1);
	const size_t size = k->size(p);
	double *work = gd_alloc(size * (size_t)omp_get_max_threads(), sizeof *work);
	struct gd_lwr_count *count = gd_calloc(tiles, sizeof *count), sum = { 0 };
	int step = conf->granularity ? conf->granularity : 2 * p->radius + 1;
	int rc = work && count ? GD_OK : GD_ENOMEM;

	if (conf->dense)
		step = 1;
	for (; rc == GD_OK && step >= 1; step /= 2) {
		p->nx = gd_lwr_grid(p->cx, p->w, step);
		p->nrow = gd_lwr_grid(p->cy, p->h, step);
		mark(p, conf->dense);
		run_tiles(p, k, work, size, count);
		gd_progress(report, "linear predictions", 1.0 / step);
	}
	for (size_t i = 0; rc == GD_OK && i < tiles; i++) {
		sum.models += count[i].models;
		sum.radii += count[i].radii;
	}
	if (rc == GD_OK && result) {
		result->models = (size_t)sum.models;
		result->mean_radius = (double)sum.radii / (double)sum.models;
	}
	free(work);
	free(count);
	return rc;
}

/* The radius of the smallest window, of those up to `most`, with at least n pixels. */
static int radius_of(long n, int most)
{
	int r = 1;

	while (r < most && (2L * r + 1) * (2 * r + 1) < n)
		r++;
	return r;
}

static int plan_make(struct gd_lwr_plan *p, const struct gd_lwr_out *out,
		     const struct gd_lwr_in *in, const struct gd_lwr_conf *conf,
		     const struct gd_report *report)
{
	int kept[GD_LWR_FEATURES];
	size_t n;

	p->w = in->y[0].w;
	p->h = in->y[0].h;
	p->radius = conf->radius;
	p->ny = in->ny;
	p->nc = colours(in);
	p->paper = conf->paper;
	p->twin = in->twin && !p->paper;
	p->nvar = in->var && !p->twin ? p->nc : 0;
	p->y = in->y;
	p->noise = conf->feature_noise;
	p->ridge = conf->ridge;
	p->level2 = gd_lwr_level(in->y, p->nc);
	p->est = out->est;
	p->mse = out->mse;
	p->spread = out->spread;
	p->out_radius = out->radius;
	p->out_features = out->features;
	p->out_centre = out->centre;
	gd_lwr_features(p, in, conf, report, kept);
	p->p = 3 + p->nf;
	p->radius_min = radius_of((long)conf->per_column * p->p, p->radius);
	p->q = p->p + p->nc * (p->twin ? 2 : 1);
	n = (size_t)p->w * (size_t)p->h;
	p->mark = gd_alloc(n, 1);
	p->cx = gd_alloc((size_t)p->w + (size_t)p->h, sizeof *p->cx);
	p->sums = 4 * (size_t)((p->ny + 2) / 3);
	if (p->mse || p->out_radius.v) {
		p->at_error = p->sums;
		p->sums += 4;
	}
	if (p->spread || p->out_features.v) {
		p->at_spread = p->sums;
		p->sums += 4;
	}
	p->sum = gd_alloc(n * p->sums, sizeof *p->sum);
	if (!p->mark || !p->cx || !p->sum)
		return GD_ENOMEM;
	p->cy = p->cx + p->w;
	return gd_lwr_pack(p, in, kept);
}

int gd_lwr_fit(const struct gd_lwr_out *out, const struct gd_lwr_in *in,
	       const struct gd_lwr_conf *conf, struct gd_lwr_result *result,
	       const struct gd_report *report, struct gd_err *err)
{
	struct gd_lwr_plan *plan;
	int rc = check(out, in, conf, err);

	if (rc != GD_OK)
		return rc;
	plan = gd_calloc(1, sizeof *plan);
	rc = plan ? plan_make(plan, out, in, conf, report) : GD_ENOMEM;
	if (rc == GD_OK) {
		clear(plan);
		rc = run_passes(plan, conf, result, report);
	}
	if (rc == GD_OK)
		finish(plan);
	if (plan) {
		free(plan->block);
		free(plan->mark);
		free(plan->cx);
		free(plan->sum);
	}
	free(plan);
	return rc == GD_OK ? GD_OK : gd_fail(err, rc, "lwr: out of memory");
}
