/* SPDX-License-Identifier: BSD-3-Clause */
/* The feature stage of one image: which channels, in what order, and what is freed when. */
#include "feature.h"

#include <ctype.h>
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "feature_frames.h"
#include "poisson.h"

#define BINS GD_BOOT_MAX_BINS

struct stage {
	struct gd_image *im;
	const struct gd_feature_conf *conf;
	struct gd_feature_result *result;
	const struct gd_report *report;
	struct gd_err *err;
	int n, bins;			/* channels; bins of the gradients, 0 or 2 and more */
	const char *family;			/* "bin", or "half" where a file has halves only */
	struct gd_plane (*dx)[3], (*dy)[3];	/* [bins], or the mean where there are none */
	struct gd_plane primal[3], half_primal[2][3];
	struct gd_image tmp;			/* solutions before the filter */
	struct gd_feature_set made;		/* whole_var[0].v = NULL: unknown */
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
	if (!gd_layer_find(im, "dx").n && !gd_layer_find(im, "dy").n && gd_feature_set_want(im))
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
	if (rc == GD_OK && conf->neighbours)
		gd_layer_want(im, "P", GD_READ);
	return rc;
}

int gd_feature_want_neighbour(struct gd_image *neighbour, const struct gd_image *im,
			      const struct gd_feature_conf *conf, struct gd_err *err)
{
	if (neighbour->w != im->w || neighbour->h != im->h)
		return gd_fail(err, GD_ESHAPE, "is %dx%d, expected %dx%d", neighbour->w,
			       neighbour->h, im->w, im->h);
	for (int i = 0; i < neighbour->nchan; i++)
		neighbour->chan[i].want = GD_DROP;
	gd_layer_want(neighbour, "P", GD_READ);
	if (gd_feature_set_want(neighbour))
		return GD_OK;
	return want_gradients(neighbour, conf, err);
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
	memcpy(out.mean, s->made.whole, sizeof out.mean);
	return gd_boot_run(&out, &in, &s->conf->boot, NULL, s->report, s->err);
}

static int solve_without_bins(struct stage *s)
{
	struct gd_poisson_in in = { .n = s->n };
	struct gd_plane p[GD_LAYER_PLANES];

	memcpy(in.dx, s->dx[0], sizeof in.dx);
	memcpy(in.dy, s->dy[0], sizeof in.dy);
	memcpy(in.primal, s->primal, sizeof in.primal);
	if (gd_layer_variance(s->im, "dx").n == s->n && gd_layer_variance(s->im, "dy").n == s->n) {
		gd_layer_variance_planes(s->im, "dx", p);
		memcpy(in.dxvar, p, sizeof in.dxvar);
		gd_layer_variance_planes(s->im, "dy", p);
		memcpy(in.dyvar, p, sizeof in.dyvar);
		for (int c = 0; c < s->n; c++)
			gd_boot_edges(s->made.whole_var[c], in.dxvar[c], in.dyvar[c]);
	} else {
		memset(s->made.whole_var, 0, sizeof s->made.whole_var);
		gd_note(s->report,
			"neither bins nor variances of dx and dy: equal weights, no filter");
	}
	return poisson(s, s->made.whole, &in);
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
	struct gd_feature_set *made = &s->made;
	double start = gd_seconds();
	int rc = tmp_layer(s, "half0", made->half[0]);

	if (rc == GD_OK)
		rc = tmp_layer(s, "half1", made->half[1]);
	if (rc == GD_OK)
		rc = tmp_layer(s, "half.local", made->half_var[0]);
	for (int i = 0; i < 2 && rc == GD_OK; i++)
		rc = solve_bins(s, made->half[i], s->half_primal[i], i, 2);
	if (rc == GD_OK)
		rc = gd_boot_halves(made->whole_var, made->half[0], made->half[1], s->n,
				    s->conf->boot.local_px, s->err);
	for (int c = 0; c < s->n && rc == GD_OK; c++)
		twice(made->half_var[0][c], made->whole_var[c]);
	memcpy(made->half_var[1], made->half_var[0], sizeof made->half_var[1]);
	made->halves = true;
	s->result->half_seconds = gd_seconds() - start;
	return rc;
}

static int solve(struct stage *s)
{
	double start = gd_seconds();
	int rc = tmp_layer(s, "whole", s->made.whole);

	if (rc == GD_OK)
		rc = tmp_layer(s, "local", s->made.whole_var);
	if (rc != GD_OK)
		return rc;
	s->made.n = s->n;
	s->result->bagged = s->bins && s->conf->bagging && s->conf->solve == GD_FEATURE_WLS;
	if (!s->bins)
		rc = solve_without_bins(s);
	else if (s->result->bagged)
		rc = solve_bagged(s);
	else
		rc = solve_bins(s, s->made.whole, s->primal, 0, 1);
	s->result->solve_seconds = gd_seconds() - start;
	if (rc == GD_OK && s->bins)
		rc = solve_halves(s);
	return rc;
}

/* ---- all frames ---- */

/* Planes in tmp, under names of their own. */
static int tmp_set(struct stage *s, struct gd_feature_set *set, const char *name)
{
	struct gd_plane *to[] = { set->whole, set->whole_var, set->half[0], set->half[1],
				  set->half_var[0], set->half_var[1] };
	int rc = GD_OK;

	set->n = s->n;
	set->halves = s->made.halves;
	for (int i = 0; i < (set->halves ? 6 : 2) && rc == GD_OK; i++) {
		char layer[64];

		snprintf(layer, sizeof layer, "%s%d", name, i);
		rc = tmp_layer(s, layer, to[i]);
	}
	return rc;
}

/* Neighbours as they are to be averaged with the frame. */
static int bring_frames(struct stage *s, struct gd_feature_set *frame)
{
	struct gd_plane position[GD_LAYER_PLANES] = { 0 }, known;
	int rc = GD_OK;

	if (gd_layer_planes(s->im, "P", position) != 3)
		position[0].v = NULL;
	for (int i = 0; i < s->conf->neighbours && rc == GD_OK; i++) {
		char name[64];

		snprintf(name, sizeof name, "known%d", i);
		rc = gd_image_add(&s->tmp, name, &known, s->err);
		if (rc == GD_OK)
			rc = gd_feature_set_neighbour(&frame[i], &s->conf->neighbour[i], known,
						      &s->made, position, s->conf, s->result,
						      s->report, s->err);
	}
	if (s->result->followed)
		s->result->found /= s->result->followed;
	return rc;
}

/* ---- the filter ---- */

/* A layer of the result with its variances, where there are any. */
static int add_feature(struct stage *s, const char *layer, struct gd_plane *out,
		       struct gd_plane *out_var)
{
	struct gd_plane p[GD_LAYER_PLANES], v[GD_LAYER_PLANES] = { 0 };
	char name[64];
	int rc = gd_layer_add(s->im, layer, s->n, p, s->err);

	snprintf(name, sizeof name, "%s.variance", layer);
	if (rc == GD_OK && s->made.whole_var[0].v)
		rc = gd_layer_add(s->im, name, s->n, v, s->err);
	for (int c = 0; c < s->n && rc == GD_OK; c++) {
		out[c] = p[c];
		out_var[c] = v[c];
	}
	return rc;
}

static int add_features(struct stage *s, struct gd_feature_set *out)
{
	int rc = add_feature(s, "feature", out->whole, out->whole_var);

	out->n = s->n;
	out->halves = s->made.halves;
	if (rc == GD_OK && out->halves)
		rc = add_feature(s, "half0.feature", out->half[0], out->half_var[0]);
	if (rc == GD_OK && out->halves)
		rc = add_feature(s, "half1.feature", out->half[1], out->half_var[1]);
	return rc;
}

/*
 * Pixels averaged with those that show the same in other frames, then the filter itself; or, if
 * they cannot be followed, the filter in windows that span all frames.
 */
static int filter_frames(struct stage *s, const struct gd_feature_set *out,
			 const struct gd_plane *other)
{
	const struct gd_nlm_conf *nlm = &s->conf->nlm;
	struct gd_feature_set frame[GD_FEATURE_FRAMES], mean = { 0 };
	double start = gd_seconds();
	int rc = bring_frames(s, frame), n = s->conf->neighbours;

	if (rc == GD_OK && s->result->followed == n) {
		rc = tmp_set(s, &mean, "mean");
		if (rc == GD_OK)
			rc = gd_feature_set_filter(&mean, &s->made, frame, n, 0, other,
						   &s->conf->nlm_frames, s->report, s->err);
		s->result->frame_seconds = gd_seconds() - start;
		return rc != GD_OK ? rc : gd_feature_set_filter(out, &mean, NULL, 0, 0, other, nlm,
								 s->report, s->err);
	}
	s->result->frame_seconds = gd_seconds() - start;
	return rc != GD_OK ? rc : gd_feature_set_filter(out, &s->made, frame, n, nlm->window, other,
							 nlm, s->report, s->err);
}

static int write_features(struct stage *s)
{
	struct gd_feature_set out = { 0 };
	struct gd_plane other[3];
	double start = gd_seconds();
	int rc = add_features(s, &out);

	if (rc == GD_OK)
		rc = tmp_layer(s, "other", other);
	if (rc != GD_OK)
		return rc;
	s->result->halves = s->made.halves;
	s->result->filtered = s->conf->filter && s->made.whole_var[0].v;
	if (!s->result->filtered)
		gd_feature_set_copy(&out, &s->made);
	else if (s->conf->neighbours)
		rc = filter_frames(s, &out, other);
	else
		rc = gd_feature_set_filter(&out, &s->made, NULL, 0, 0, other, &s->conf->nlm,
					   s->report, s->err);
	s->result->filter_seconds = gd_seconds() - start - s->result->frame_seconds;
	return rc;
}

/* A feature that was made before, out of the way of what will take its place. */
static int take_feature(struct stage *s, const struct gd_feature_set *found)
{
	int rc;

	s->n = found->n;
	s->made.halves = found->halves;
	rc = tmp_set(s, &s->made, "made");
	if (rc == GD_OK)
		gd_feature_set_copy(&s->made, found);
	s->result->made_before = true;
	return rc;
}

static int make_feature(struct stage *s)
{
	struct gd_feature_set found;
	bool before = !gd_layer_find(s->im, "dx").n && gd_feature_set_find(&found, s->im) &&
		      !count_bins(s->im, &s->family);
	int rc = before ? GD_OK : gather(s);

	gd_image_init(&s->tmp, s->im->w, s->im->h);
	if (before) {
		rc = take_feature(s, &found);
	} else {
		if (rc == GD_OK && s->bins)
			rc = colour_halves(s);
		if (rc == GD_OK)
			rc = solve(s);
	}
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
	if (conf->neighbours < 0 || conf->neighbours > GD_FEATURE_FRAMES)
		return gd_fail(err, GD_EARG, "%d neighbours, expected 0 to %d", conf->neighbours,
			       GD_FEATURE_FRAMES);
	if (conf->solve != GD_FEATURE_NONE)
		rc = make_feature(&s);
	start = gd_seconds();
	if (rc == GD_OK)
		rc = gd_feature_layers_run(im, conf, &s.result->layers, report, err);
	s.result->layer_seconds = gd_seconds() - start;
	return rc;
}
