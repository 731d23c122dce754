/* SPDX-License-Identifier: BSD-3-Clause */
/* The feature stage of one image: which channels, in what order, and what is freed when. */
#include "feature.h"

#include <ctype.h>
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "poisson.h"

#define BINS GD_BOOT_MAX_BINS

/*
 * Variance of a solution's detail (what a blur by 2 px leaves) over that of the edges, for equal
 * weights and independent edges: the mean over all frequencies of (1 - G)^2 / L, with G the
 * transform of the blur and L that of the Laplacian.
 */
#define DETAIL 0.318

struct stage {
	struct gd_image *im;
	const struct gd_feature_conf *conf;
	struct gd_feature_result *result;
	const struct gd_report *report;
	struct gd_err *err;
	int n, bins; /* channels; bins of the gradients, 0 or 2 and more */
	const char *family;			/* "bin", or "half" where a file has halves only */
	struct gd_plane (*dx)[3], (*dy)[3];	/* [bins], or the mean where there are none */
	struct gd_plane primal[3], half_primal[2][3];
	struct gd_image tmp;			/* solutions before the filter */
	struct gd_plane whole[3], half[2][3], local[3], half_local[3];
	bool has_local; /* local, the variance of whole's detail, is known */
};

/* ---- channels ---- */

/* dx, dy, and what carries them in a bin or half: bin3.dx.R, dy.variance.G, half0.dx.B */
static bool is_gradient(const char *name)
{
	const char *at = name;

	if (!strncmp(name, "bin", 3) || !strncmp(name, "half", 4)) {
		at += name[0] == 'b' ? 3 : 4;
		while (isdigit((unsigned char)*at))
			at++;
		at = *at == '.' ? at + 1 : name;
	}
	return at[0] == 'd' && (at[1] == 'x' || at[1] == 'y') && (at[2] == '.' || !at[2]);
}

static bool drop_gradient(const char *name, void *user)
{
	(void)user;
	return is_gradient(name);
}

static bool layer_name(char name[256], const char *family, int i, const char *layer)
{
	return snprintf(name, 256, "%s%d%s%s", family, i, *layer ? "." : "", layer) < 256;
}

/* Bins of the gradients (2 or more, else 0) and the family of channels that they are. */
static int count_bins(const struct gd_image *im, const char **family)
{
	int x = gd_bins(im, "dx"), y = gd_bins(im, "dy"), n = x < y ? x : y;

	*family = "bin";
	if (n >= 2)
		return n < BINS ? n : BINS;
	*family = "half";
	return gd_layer_find(im, "half0.dx").n && gd_layer_find(im, "half0.dy").n &&
	       gd_layer_find(im, "half1.dx").n && gd_layer_find(im, "half1.dy").n ? 2 : 0;
}

static int missing(const struct gd_image *im, const char *layer, struct gd_err *err)
{
	/* the first of the three that is not there, if another is */
	const char *suffix[] = { ".R", ".G", ".B" };
	char name[256];

	for (int i = 0; i < 3; i++) {
		snprintf(name, sizeof name, "%.250s%s", layer, suffix[i]);
		if (gd_image_find(im, name) < 0)
			break;
	}
	return gd_fail(err, GD_ESHAPE, "no channel %s", name);
}

static int want_gradients(struct gd_image *im, const struct gd_feature_conf *conf,
			  struct gd_err *err)
{
	const char *family;
	int bins = count_bins(im, &family);
	char name[256];

	for (int i = 0; i < im->nchan; i++)
		if (is_gradient(im->chan[i].name))
			im->chan[i].want = conf->keep ? GD_PASS : GD_DROP;
	gd_layer_want(im, "", GD_READ);
	for (int b = 0; b < bins; b++) {
		layer_name(name, family, b, "dx");
		gd_layer_want(im, name, GD_READ);
		layer_name(name, family, b, "dy");
		gd_layer_want(im, name, GD_READ);
		layer_name(name, family, b, "");
		gd_layer_want(im, name, GD_READ);
	}
	if (bins)
		return GD_OK;
	if (!gd_layer_want(im, "dx", GD_READ))
		return missing(im, "dx", err);
	if (!gd_layer_want(im, "dy", GD_READ))
		return missing(im, "dy", err);
	gd_layer_want_variance(im, "dx", GD_READ);
	gd_layer_want_variance(im, "dy", GD_READ);
	return GD_OK;
}

int gd_feature_want(struct gd_image *im, const struct gd_feature_conf *conf, struct gd_err *err)
{
	int rc = GD_OK;

	if (conf->solve != GD_FEATURE_NONE)
		rc = want_gradients(im, conf, err);
	if (rc == GD_OK)
		rc = gd_feature_layers_want(im, conf->layers, err);
	return rc;
}

/* ---- bins ---- */

static float finite_float(double x)
{
	return (float)(x > FLT_MAX ? FLT_MAX : x > -FLT_MAX ? x : -FLT_MAX);
}

#define BLOCK 64	/* pixels of a row that are averaged together */

/* Of the finite values of a pixel: how many, their mean, and squared distances to it added up. */
struct moments {
	float n[BLOCK];
	double mean[BLOCK], square[BLOCK];
};

static void moments_of(struct moments *m, const struct gd_plane *bin, int bins, int first, int step,
		       int x0, int y, int n)
{
	*m = (struct moments){ 0 };
	for (int b = first; b < bins; b += step) {
		const float *v = gd_row(bin[b], y) + x0;

#pragma omp simd
		for (int x = 0; x < n; x++) {
			float there = fabsf(v[x]) <= FLT_MAX ? 1.0f : 0.0f;

			m->n[x] += there;
			m->mean[x] += there > 0.0f ? v[x] : 0.0f;
		}
	}
#pragma omp simd
	for (int x = 0; x < n; x++)
		m->mean[x] /= m->n[x] > 0.0f ? m->n[x] : 1.0f;
	for (int b = first; b < bins; b += step) {
		const float *v = gd_row(bin[b], y) + x0;

#pragma omp simd
		for (int x = 0; x < n; x++) {
			double d = v[x] - m->mean[x];

			m->square[x] += fabsf(v[x]) <= FLT_MAX ? d * d : 0.0;
		}
	}
}

/*
 * Mean of the bins first, first + step, ... and the variance of that mean; with fewer than two
 * finite ones the variance comes from the spread of all bins, with none the mean does, too.
 */
static void average_block(float *mean, float *var, const struct gd_plane *bin, int bins, int first,
			  int step, int x0, int y, int n)
{
	struct moments part, all;
	bool known = false;

	moments_of(&part, bin, bins, first, step, x0, y, n);
	for (int x = 0; x < n; x++) {
		double square = part.square[x], m = part.mean[x], spread_n = part.n[x];

		if (part.n[x] < 2.0f) {
			if (!known)
				moments_of(&all, bin, bins, 0, 1, x0, y, n);
			known = true;
			square = all.square[x];
			spread_n = all.n[x];
			m = part.n[x] > 0.0f ? m : all.mean[x];
		}
		mean[x] = finite_float(m);
		if (var)
			var[x] = spread_n < 2.0 ? 0.0f :
				finite_float(square / ((spread_n - 1.0) * fmax(part.n[x], 1.0)));
	}
}

static void average(struct gd_plane mean, struct gd_plane var, const struct gd_plane *bin, int bins,
		    int first, int step)
{
#pragma omp parallel for schedule(static)
	for (int y = 0; y < mean.h; y++)
		for (int x = 0; x < mean.w; x += BLOCK)
			average_block(gd_row(mean, y) + x, var.v ? gd_row(var, y) + x : NULL, bin,
				      bins, first, step, x, y,
				      mean.w - x < BLOCK ? mean.w - x : BLOCK);
}

/* The planes of one channel, bin by bin. */
static void channel_of(struct gd_plane *bin, const struct gd_plane (*set)[3], int bins, int c)
{
	for (int b = 0; b < bins; b++)
		bin[b] = set[b][c];
}

static int check_layer(struct stage *s, const char *name, int found)
{
	if (!found)
		return missing(s->im, name, s->err);
	if (found != s->n)
		return gd_fail(s->err, GD_ESHAPE, "%s: %d channels, expected %d", name, found,
			       s->n);
	return GD_OK;
}

static int gather_gradients(struct stage *s, struct gd_plane (*to)[3], const char *layer)
{
	struct gd_plane p[GD_LAYER_PLANES];
	char name[256];
	int rc = GD_OK;

	for (int b = 0; b < (s->bins ? s->bins : 1) && rc == GD_OK; b++) {
		if (s->bins)
			layer_name(name, s->family, b, layer);
		else
			snprintf(name, sizeof name, "%s", layer);

		int n = gd_layer_planes(s->im, name, p);

		if (!s->n)
			s->n = n;
		rc = check_layer(s, name, n);
		if (rc == GD_OK)
			memcpy(to[b], p, (size_t)n * sizeof *p);
	}
	return rc;
}

static int gather(struct stage *s)
{
	struct gd_plane p[GD_LAYER_PLANES];
	int rc;

	s->bins = count_bins(s->im, &s->family);
	s->dx = calloc(2 * BINS, sizeof *s->dx);
	if (!s->dx)
		return gd_fail(s->err, GD_ENOMEM, "out of memory");
	s->dy = s->dx + BINS;
	rc = gather_gradients(s, s->dx, "dx");
	if (rc == GD_OK)
		rc = gather_gradients(s, s->dy, "dy");
	if (rc == GD_OK && gd_layer_planes(s->im, "", p) == s->n)
		memcpy(s->primal, p, sizeof s->primal);
	else if (rc == GD_OK)
		gd_note(s->report, "no colour to take the mean of the feature from: it will be 0");
	for (int i = 0; i < 2; i++)
		memcpy(s->half_primal[i], s->primal, sizeof s->primal);
	return rc;
}

/* half0.R ... and half1.R ... with their variances, from as many bins of the colour as of dx. */
static int colour_halves(struct stage *s)
{
	struct gd_plane mean[GD_LAYER_PLANES], var[GD_LAYER_PLANES], bin[BINS], p[GD_LAYER_PLANES];
	char name[256];
	int rc = GD_OK;

	for (int i = 0; i < 2; i++) {
		layer_name(name, "half", i, "");
		if (!strcmp(s->family, "half") && gd_layer_planes(s->im, name, p) == s->n)
			memcpy(s->half_primal[i], p, sizeof s->half_primal[i]);
	}
	if (strcmp(s->family, "bin") || gd_bins(s->im, "") < s->bins || s->n != 3)
		return GD_OK;
	for (int i = 0; i < 2 && rc == GD_OK; i++) {
		layer_name(name, "half", i, "");
		rc = gd_layer_add(s->im, name, s->n, mean, s->err);
		layer_name(name, "half", i, "variance");
		if (rc == GD_OK)
			rc = gd_layer_add(s->im, name, s->n, var, s->err);
		for (int c = 0; c < s->n && rc == GD_OK; c++) {
			for (int b = 0; b < s->bins; b++) {
				layer_name(name, "bin", b, "");
				gd_layer_planes(s->im, name, p);
				bin[b] = p[c];
			}
			average(mean[c], var[c], bin, s->bins, i, 2);
			s->half_primal[i][c] = mean[c];
		}
	}
	return rc;
}

/* ---- solutions ---- */

static int tmp_layer(struct stage *s, const char *layer, struct gd_plane plane[3])
{
	struct gd_plane p[GD_LAYER_PLANES];
	int rc = gd_layer_add(&s->tmp, layer, s->n, p, s->err);

	if (rc == GD_OK)
		memcpy(plane, p, (size_t)s->n * sizeof *p);
	return rc;
}

static int poisson(struct stage *s, const struct gd_plane *out, const struct gd_poisson_in *in)
{
	struct gd_poisson_conf conf = GD_POISSON_DEFAULTS;

	conf.method = in->dxvar[0].v && s->conf->solve == GD_FEATURE_WLS ? GD_WLS : GD_OLS;
	conf.floor = s->conf->boot.floor;
	conf.smooth_px = s->conf->boot.smooth_px;
	conf.tolerance = s->conf->boot.tolerance;
	return gd_poisson_solve(out, in, &conf, NULL, s->report, s->err);
}

static bool is_scratch(const char *name, void *user)
{
	(void)user;
	return !strncmp(name, "g.", 2);
}

/* One solve from the means of the bins first, first + step ..., and variances of all bins. */
static int solve_means(struct stage *s, const struct gd_plane *out, const struct gd_plane *primal,
		       int first, int step)
{
	struct gd_poisson_in in = { .n = s->n };
	struct gd_plane bin[BINS];
	struct gd_plane *to[] = { in.dx, in.dy, in.dxvar, in.dyvar };
	static const char *const name[] = { "g.dx", "g.dy", "g.dxvar", "g.dyvar" };
	int rc = GD_OK;

	for (int i = 0; i < 4 && rc == GD_OK; i++)
		rc = tmp_layer(s, name[i], to[i]);
	for (int c = 0; c < s->n && rc == GD_OK; c++) {
		in.primal[c] = primal[c];
		channel_of(bin, s->dx, s->bins, c);
		average(in.dx[c], in.dxvar[c], bin, s->bins, first, step);
		channel_of(bin, s->dy, s->bins, c);
		average(in.dy[c], in.dyvar[c], bin, s->bins, first, step);
	}
	if (rc == GD_OK)
		rc = poisson(s, out, &in);
	gd_image_drop_if(&s->tmp, is_scratch, NULL);
	return rc;
}

/* The bins first, first + step ... as they are: weighted by their own spread. */
static int solve_bins(struct stage *s, const struct gd_plane *out, const struct gd_plane *primal,
		      int first, int step)
{
	struct gd_plane (*set)[3];
	struct gd_boot_in in = { .n = s->n };
	int rc;

	in.bins = (s->bins - first + step - 1) / step;
	if (s->conf->solve == GD_FEATURE_OLS || in.bins < 2)
		return solve_means(s, out, primal, first, step);
	set = calloc(2 * (size_t)in.bins, sizeof *set);
	if (!set)
		return gd_fail(s->err, GD_ENOMEM, "out of memory");
	for (int b = 0; b < in.bins; b++) {
		memcpy(set[b], s->dx[first + b * step], sizeof *set);
		memcpy(set[in.bins + b], s->dy[first + b * step], sizeof *set);
	}
	in.dx = (const struct gd_plane (*)[3])set;
	in.dy = (const struct gd_plane (*)[3])(set + in.bins);
	memcpy(in.primal, primal, sizeof in.primal);
	rc = gd_boot_plain(out, &in, &s->conf->boot, NULL, s->report, s->err);
	free(set);
	return rc;
}

static int solve_bagged(struct stage *s)
{
	struct gd_boot_in in = { .n = s->n, .bins = s->bins };
	struct gd_boot_out out = { 0 };

	in.dx = (const struct gd_plane (*)[3])s->dx;
	in.dy = (const struct gd_plane (*)[3])s->dy;
	memcpy(in.primal, s->primal, sizeof in.primal);
	memcpy(out.mean, s->whole, sizeof out.mean);
	return gd_boot_run(&out, &in, &s->conf->boot, NULL, s->report, s->err);
}

/* The variance of the detail from that of the edges, where there are no bins to tell it. */
static void local_from_edges(struct gd_plane out, struct gd_plane dxvar, struct gd_plane dyvar)
{
#pragma omp parallel for schedule(static)
	for (int y = 0; y < out.h; y++)
		for (int x = 0; x < out.w; x++) {
			double sum = 0.0;
			int n = 0;

			for (int j = y > 2 ? y - 2 : 0; j <= y + 2 && j < out.h; j++)
				for (int i = x > 2 ? x - 2 : 0; i <= x + 2 && i < out.w; i++) {
					float a = gd_row(dxvar, j)[i], b = gd_row(dyvar, j)[i];

					sum += (isfinite(a) && a > 0.0f ? a : 0.0) +
					       (isfinite(b) && b > 0.0f ? b : 0.0);
					n += 2;
				}
			gd_row(out, y)[x] = finite_float(DETAIL * sum / n);
		}
}

static int solve_without_bins(struct stage *s)
{
	struct gd_poisson_in in = { .n = s->n };
	struct gd_plane p[GD_LAYER_PLANES];

	memcpy(in.dx, s->dx[0], sizeof in.dx);
	memcpy(in.dy, s->dy[0], sizeof in.dy);
	memcpy(in.primal, s->primal, sizeof in.primal);
	s->has_local = gd_layer_variance(s->im, "dx").n == s->n &&
		       gd_layer_variance(s->im, "dy").n == s->n;
	if (s->has_local) {
		gd_layer_variance_planes(s->im, "dx", p);
		memcpy(in.dxvar, p, sizeof in.dxvar);
		gd_layer_variance_planes(s->im, "dy", p);
		memcpy(in.dyvar, p, sizeof in.dyvar);
		for (int c = 0; c < s->n; c++)
			local_from_edges(s->local[c], in.dxvar[c], in.dyvar[c]);
	} else {
		gd_note(s->report,
			"neither bins nor variances of dx and dy: equal weights, no filter");
	}
	return poisson(s, s->whole, &in);
}

/* The variance of the mean of two is half of what each has. */
static void twice(struct gd_plane to, struct gd_plane from)
{
#pragma omp parallel for schedule(static)
	for (int y = 0; y < to.h; y++)
		for (int x = 0; x < to.w; x++)
			gd_row(to, y)[x] = finite_float(2.0 * gd_row(from, y)[x]);
}

static int solve_halves(struct stage *s)
{
	double start = gd_seconds();
	int rc = tmp_layer(s, "half0", s->half[0]);

	if (rc == GD_OK)
		rc = tmp_layer(s, "half1", s->half[1]);
	if (rc == GD_OK)
		rc = tmp_layer(s, "half.local", s->half_local);
	for (int i = 0; i < 2 && rc == GD_OK; i++)
		rc = solve_bins(s, s->half[i], s->half_primal[i], i, 2);
	if (rc == GD_OK)
		rc = gd_boot_halves(s->local, s->half[0], s->half[1], s->n, s->conf->boot.local_px,
				    s->err);
	for (int c = 0; c < s->n && rc == GD_OK; c++)
		twice(s->half_local[c], s->local[c]);
	s->has_local = true;
	s->result->halves = rc == GD_OK;
	s->result->half_seconds = gd_seconds() - start;
	return rc;
}

static int solve(struct stage *s)
{
	double start = gd_seconds();
	int rc = tmp_layer(s, "whole", s->whole);

	if (rc == GD_OK)
		rc = tmp_layer(s, "local", s->local);
	if (rc != GD_OK)
		return rc;
	s->result->bagged = s->bins && s->conf->bagging && s->conf->solve == GD_FEATURE_WLS;
	if (!s->bins)
		rc = solve_without_bins(s);
	else if (s->result->bagged)
		rc = solve_bagged(s);
	else
		rc = solve_bins(s, s->whole, s->primal, 0, 1);
	s->result->solve_seconds = gd_seconds() - start;
	if (rc == GD_OK && s->bins)
		rc = solve_halves(s);
	return rc;
}

/* ---- the filter ---- */

/* A layer of the result with its variances, where there are any. */
static int add_feature(struct stage *s, const char *layer, struct gd_plane *out,
		       struct gd_plane *out_var)
{
	struct gd_plane p[GD_LAYER_PLANES], v[GD_LAYER_PLANES];
	char name[64];
	int rc = gd_layer_add(s->im, layer, s->n, p, s->err);

	snprintf(name, sizeof name, "%s.variance", layer);
	if (rc == GD_OK && s->has_local)
		rc = gd_layer_add(s->im, name, s->n, v, s->err);
	for (int c = 0; c < s->n && rc == GD_OK; c++) {
		out[c] = p[c];
		if (s->has_local)
			out_var[c] = v[c];
	}
	return rc;
}

static void copy_plane(struct gd_plane to, struct gd_plane from)
{
	for (int y = 0; y < to.h; y++)
		memcpy(gd_row(to, y), gd_row(from, y), (size_t)to.w * sizeof(float));
}

static void copy_feature(struct stage *s, struct gd_plane *out, struct gd_plane *out_var,
			 const struct gd_plane *in, const struct gd_plane *var)
{
	for (int c = 0; c < s->n; c++) {
		copy_plane(out[c], in[c]);
		if (s->has_local)
			copy_plane(out_var[c], var[c]);
	}
}

/* to = part a + part b */
static void mix(struct gd_plane to, struct gd_plane a, struct gd_plane b, float part)
{
#pragma omp parallel for schedule(static)
	for (int y = 0; y < to.h; y++)
		for (int x = 0; x < to.w; x++)
			gd_row(to, y)[x] = part * gd_row(a, y)[x] + part * gd_row(b, y)[x];
}

/*
 * The weights of each half go to the other half and to the feature of all bins, which becomes the
 * mean of the two results: half of its noise is unknown to either set of weights, where weights
 * from itself would know all of it and keep it. Its variance before is half of that of a half,
 * hence after, too, for either set of weights; it is at most the mean of these two.
 */
static int filter_crossed(struct stage *s, struct gd_plane (*out)[3], struct gd_plane (*out_var)[3])
{
	const int n = s->n;
	struct gd_plane other[3];
	int rc = tmp_layer(s, "other", other);

	for (int i = 0; i < 2 && rc == GD_OK; i++) {
		struct gd_plane in[6], var[6] = { 0 }, to[6], to_var[6] = { 0 };
		struct gd_nlm_job job = { n, 2 * n, s->half[1 - i], s->half_local,
					  in, var, to, to_var };

		for (int c = 0; c < n; c++) {
			in[c] = s->half[i][c];
			var[c] = s->half_local[c];
			to[c] = out[1 + i][c];
			to_var[c] = out_var[1 + i][c];
			in[n + c] = s->whole[c];
			to[n + c] = i ? other[c] : out[0][c];
		}
		rc = gd_nlm_run(&job, &s->conf->nlm, s->report, s->err);
	}
	for (int c = 0; c < n && rc == GD_OK; c++) {
		mix(out[0][c], out[0][c], other[c], 0.5f);
		mix(out_var[0][c], out_var[1][c], out_var[2][c], 0.25f);
	}
	return rc;
}

static int write_features(struct stage *s)
{
	static const char *const layer[] = { "feature", "half0.feature", "half1.feature" };
	struct gd_plane out[3][3], out_var[3][3];
	struct gd_nlm_job job = { s->n, s->n, s->whole, s->local,
				  s->whole, s->local, out[0], out_var[0] };
	const int layers = s->result->halves ? 3 : 1;
	double start = gd_seconds();
	int rc = GD_OK;

	for (int i = 0; i < layers && rc == GD_OK; i++)
		rc = add_feature(s, layer[i], out[i], out_var[i]);
	if (rc != GD_OK)
		return rc;
	s->result->filtered = s->conf->filter && s->has_local;
	if (s->result->filtered && s->result->halves)
		rc = filter_crossed(s, out, out_var);
	else if (s->result->filtered)
		rc = gd_nlm_run(&job, &s->conf->nlm, s->report, s->err);
	else
		for (int i = 0; i < layers; i++)
			copy_feature(s, out[i], out_var[i], i ? s->half[i - 1] : s->whole,
				     i ? s->half_local : s->local);
	s->result->filter_seconds = gd_seconds() - start;
	return rc;
}

static int make_feature(struct stage *s)
{
	int rc = gather(s);

	gd_image_init(&s->tmp, s->im->w, s->im->h);
	if (rc == GD_OK && s->bins)
		rc = colour_halves(s);
	if (rc == GD_OK)
		rc = solve(s);
	if (rc == GD_OK && !s->conf->keep)
		gd_image_drop_if(s->im, drop_gradient, NULL);
	if (rc == GD_OK)
		rc = write_features(s);
	s->result->bins = s->bins;
	gd_image_free(&s->tmp);
	free(s->dx);
	return rc;
}

int gd_feature_run(struct gd_image *im, const struct gd_feature_conf *conf,
		   struct gd_feature_result *result, const struct gd_report *report,
		   struct gd_err *err)
{
	struct gd_feature_result unused;
	struct stage s = { .im = im, .conf = conf, .report = report, .err = err,
			   .result = result ? result : &unused };
	double start;
	int rc = GD_OK;

	*s.result = (struct gd_feature_result){ 0 };
	if (conf->solve != GD_FEATURE_NONE)
		rc = make_feature(&s);
	start = gd_seconds();
	if (rc == GD_OK)
		rc = gd_feature_layers_run(im, conf, &s.result->layers, report, err);
	s.result->layer_seconds = gd_seconds() - start;
	return rc;
}
