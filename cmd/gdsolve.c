/* SPDX-License-Identifier: BSD-3-Clause */
/* gdsolve: the image behind noisy gradients, by one Poisson solve. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "alpha.h"
#include "buffers.h"
#include "cli.h"
#include "pairsolve.h"
#include "poisson.h"

struct job {
	struct gd_cli cli;
	struct gd_image im;
	struct gd_poisson_conf conf;
	struct gd_poisson_in in;
	struct gd_pairs edges;
	struct gd_pairsolve_in paired;
	struct gd_poisson_result result;
	struct gd_alpha alpha;
	const char *method, *layer, *weight;
	bool pairs, keep, seek;		/* seek: l2 with the weight that suits the noise */
};

static int choose_method(struct job *job, struct gd_err *err)
{
	static const char *const names[] = { "ols", "wls", "l2", "l1" };

	for (int i = 0; i < 4; i++)
		if (!strcmp(job->method, names[i])) {
			job->conf.method = (enum gd_poisson_method)i;
			return GD_OK;
		}
	return gd_fail(err, GD_EARG, "--method \"%s\": expected ols, wls, l2 or l1", job->method);
}

/* A number, or else "auto". */
static int choose_alpha(struct job *job, struct gd_err *err)
{
	const bool any = !strcmp(job->weight, "auto");
	char *end;

	job->seek = any && job->conf.method == GD_L2;
	job->alpha.value = job->conf.alpha = any ? GD_ALPHA_PUBLISHED : strtod(job->weight, &end);
	if (!any && (end == job->weight || *end ||
		     !(job->conf.alpha >= 1e-3 && job->conf.alpha <= 1e3)))
		return gd_fail(err, GD_EARG, "--alpha %s: expected 0.001 to 1000, or auto",
			       job->weight);
	return GD_OK;
}

/*
 * Gradients, bins and variances are used up; with --layer the colour is not touched and a denoiser
 * may follow.
 */
static void drop_used(struct gd_image *im)
{
	static const char *const layer[] = { "dx", "dy" };

	gd_layer_want_variance(im, "", GD_DROP);
	for (int i = 0; i < 2; i++) {
		gd_layer_want(im, layer[i], GD_DROP);
		gd_layer_want_variance(im, layer[i], GD_DROP);
	}
	gd_family_want(im, "pair", GD_DROP);
	gd_family_want(im, "bin", GD_DROP);
	gd_family_want(im, "half", GD_DROP);
}

/* The first of prefix.R, .G, .B that the image lacks. */
static const char *lacking(const struct gd_image *im, const char *prefix, char name[32])
{
	for (const char *c = "RGB"; *c; c++) {
		snprintf(name, 32, "%s%c", prefix, *c);
		if (gd_image_find(im, name) < 0)
			break;
	}
	return name;
}

static int choose_pairs(struct job *job, struct gd_err *err)
{
	struct gd_image *im = &job->im;
	const int layers = gd_pairs_layers(im);
	char prefix[16], name[32];

	if (!layers)
		return gd_fail(err, GD_ESHAPE, "no channel pair0.x");
	gd_pairs_want(im);
	for (int k = 0; k < layers; k++) {
		snprintf(prefix, sizeof(prefix), "pair%d.", k);
		if (!gd_layer_want(im, prefix, GD_READ))
			return gd_fail(err, GD_ESHAPE, "no channel %s", lacking(im, prefix, name));
	}
	if (!gd_layer_want(im, "", GD_READ))
		return gd_fail(err, GD_ESHAPE, "no channel %s, which pairs need",
			       lacking(im, "", name));
	return GD_OK;
}

static int choose_channels(struct job *job, struct gd_err *err)
{
	const bool screened = job->conf.method == GD_L2 || job->conf.method == GD_L1;
	struct gd_image *im = &job->im;
	char name[32];

	if (!job->keep && !*job->layer)
		drop_used(im);
	if (!gd_layer_find(im, "dx").n && gd_pairs_layers(im))
		job->pairs = true;
	if (job->pairs && !screened)
		return gd_fail(err, GD_EARG, "--method %s: pairs are solved by l2 or l1",
			       job->method);
	if (job->pairs)
		return choose_pairs(job, err);
	if (!gd_layer_want(im, "dx", GD_READ))
		return gd_fail(err, GD_ESHAPE, "no channel %s", lacking(im, "dx.", name));
	if (!gd_layer_want(im, "dy", GD_READ))
		return gd_fail(err, GD_ESHAPE, "no channel %s", lacking(im, "dy.", name));
	if (!gd_layer_want(im, "", GD_READ)) {
		if (screened)
			return gd_fail(err, GD_ESHAPE, "no channel %s, which --method %s needs",
				       lacking(im, "", name), job->method);
		gd_cli_warn(&job->cli, "%s: no channel %s: the mean of the result is 0",
			    job->cli.input, lacking(im, "", name));
	}
	if (job->conf.method == GD_WLS && !gd_layer_want_variance(im, "dx", GD_READ))
		return gd_fail(err, GD_ESHAPE, "no channel %s, which --method wls needs",
			       lacking(im, "dx.variance.", name));
	if (job->conf.method == GD_WLS && !gd_layer_want_variance(im, "dy", GD_READ))
		return gd_fail(err, GD_ESHAPE, "no channel %s, which --method wls needs",
			       lacking(im, "dy.variance.", name));
	return GD_OK;
}

static int settle_alpha(struct job *job, struct gd_err *err)
{
	int rc = gd_alpha_of_image(&job->alpha, &job->im, job->pairs ? &job->edges : NULL,
				   job->conf.tolerance, &job->cli.report, err);

	if (rc == GD_OK)
		job->conf.alpha = job->alpha.value;
	return rc;
}

static int collect(struct job *job, struct gd_err *err)
{
	struct gd_plane dx[GD_LAYER_PLANES], dy[GD_LAYER_PLANES], y[GD_LAYER_PLANES];
	struct gd_plane vx[GD_LAYER_PLANES] = { { 0 } }, vy[GD_LAYER_PLANES] = { { 0 } };
	const int n = gd_layer_planes(&job->im, "dx", dx), m = gd_layer_planes(&job->im, "", y);

	if (gd_layer_planes(&job->im, "dy", dy) != n || (m && m != n))
		return gd_fail(
			err, GD_ESHAPE,
			"the layers dx, dy and the colour differ in their number of channels");
	if (job->conf.method == GD_WLS) {
		if (gd_layer_variance_planes(&job->im, "dx", vx) != n ||
		    gd_layer_variance_planes(&job->im, "dy", vy) != n)
			return gd_fail(
				err, GD_ESHAPE,
				"dx, dy and their variances differ in their number of channels");
	}
	job->in.n = n;
	for (int c = 0; c < n; c++) {
		job->in.dx[c] = dx[c];
		job->in.dy[c] = dy[c];
		job->in.dxvar[c] = vx[c];
		job->in.dyvar[c] = vy[c];
		if (m)
			job->in.primal[c] = y[c];
	}
	return GD_OK;
}

static int collect_pairs(struct job *job, struct gd_err *err)
{
	const int layers = gd_pairs_layers(&job->im);
	struct gd_plane plane[GD_LAYER_PLANES];
	struct gd_err bad = { 0 };
	int rc = gd_pairs_from_image(&job->edges, &job->im, &bad);

	if (rc == GD_EFORMAT)
		return gd_fail(err, rc, "%s: %s", job->cli.input, bad.text);
	if (rc != GD_OK)
		return gd_fail(err, rc, "%s", bad.text);
	job->paired.pairs = &job->edges;
	job->paired.n = gd_layer_planes(&job->im, "", plane);
	for (int c = 0; c < job->paired.n; c++)
		job->paired.primal[c] = plane[c];
	for (int k = 0; k < layers; k++) {
		char layer[16];

		snprintf(layer, sizeof(layer), "pair%d", k);
		if (gd_layer_planes(&job->im, layer, plane) != job->paired.n)
			return gd_fail(err, GD_ESHAPE,
				       "%s and the colour differ in their number of channels",
				       layer);
		for (int c = 0; c < job->paired.n; c++)
			job->paired.value[k][c] = plane[c];
	}
	return GD_OK;
}

/* The result takes the place of the colour, or becomes a layer of its own. */
static int solve(struct job *job, struct gd_err *err)
{
	struct gd_plane out[GD_LAYER_PLANES], to[GD_LAYER_PLANES];
	const int n = job->pairs ? job->paired.n : job->in.n, w = job->im.w, h = job->im.h;
	const size_t size = (size_t)h * gd_stride(w);
	float *block = gd_alloc((size_t)n * size, sizeof(*block));
	int rc;

	if (!block)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	for (int c = 0; c < n; c++)
		out[c] = gd_plane_of(block + (size_t)c * size, w, h);
	rc = job->pairs ? gd_pairsolve(out, &job->paired, &job->conf, &job->result,
				       &job->cli.report, err)
			: gd_poisson_solve(out, &job->in, &job->conf, &job->result,
					   &job->cli.report, err);
	if (rc == GD_OK)
		rc = gd_layer_add(&job->im, job->layer, n, to, err);
	for (int c = 0; rc == GD_OK && c < n; c++)
		for (int y = 0; y < h; y++)
			memcpy(gd_row(to[c], y), gd_row(out[c], y), (size_t)w * sizeof(float));
	free(block);
	return rc;
}

/* What was loaded only to be used up does not leave. */
static bool used(const char *name, void *user)
{
	static const char *const family[] = { "pair", "bin", "half" };

	(void)user;
	for (int i = 0; i < 3; i++)
		if (gd_in_family(name, family[i]))
			return true;
	if (!strncmp(name, "variance.", 9) && name[9] && strchr("RGBXYZ", name[9]) && !name[10])
		return true;
	return !strncmp(name, "dx.", 3) || !strncmp(name, "dy.", 3);
}

static int run(struct job *job, struct gd_err *err)
{
	struct gd_exr *file = NULL;
	int rc = choose_method(job, err);

	if (rc == GD_OK)
		rc = choose_alpha(job, err);
	if (rc == GD_OK)
		rc = gd_cli_open(&job->cli, &file, &job->im, job->cli.input, err);
	if (rc == GD_OK)
		rc = choose_channels(job, err);
	if (rc == GD_OK && job->seek)
		gd_alpha_want(&job->im, job->pairs);
	if (rc == GD_OK)
		rc = gd_cli_load(&job->cli, file, &job->im, err);
	else
		gd_exr_close(file);
	if (rc == GD_OK)
		rc = job->pairs ? collect_pairs(job, err) : collect(job, err);
	if (rc == GD_OK && job->seek)
		rc = settle_alpha(job, err);
	if (rc == GD_OK)
		rc = solve(job, err);
	if (rc != GD_OK)
		return rc;
	if (!job->keep && !*job->layer)
		gd_image_drop_if(&job->im, used, NULL);
	if (job->conf.method == GD_L2 || job->conf.method == GD_L1)
		gd_cli_stat(&job->cli, "alpha", job->conf.alpha);
	if (job->seek)
		gd_cli_stat_text(&job->cli, "alpha_from", gd_alpha_source_name(job->alpha.source));
	gd_cli_stat(&job->cli, "iterations", job->result.iterations);
	gd_cli_stat(&job->cli, "residual", job->result.residual);
	gd_cli_stat(&job->cli, "parts", job->result.parts);
	gd_cli_stat(&job->cli, "dropped_edges", (double)job->result.dropped);
	if (!job->result.converged) {
		gd_cli_warn(&job->cli,
			    "%s: relative residual %.2g after %d iterations, wanted %.2g",
			    job->cli.input, job->result.residual, job->result.iterations,
			    job->conf.tolerance);
		job->cli.limit_missed = true;
	}
	return gd_cli_write(&job->cli, &job->im, err);
}

int main(int argc, char **argv)
{
	struct job job = { .conf = GD_POISSON_DEFAULTS, .method = "l1", .layer = "", .weight = "auto" };
	struct gd_poisson_conf *conf = &job.conf;
	const struct gd_opt opts[] = {
		GD_OPT('m', "method", "METHOD", &job.method, "ols, wls, l2 or l1"),
		GD_OPT('a', "alpha", "WEIGHT", &job.weight,
		       "weight of the colour against the gradients in l2 and l1, 0.001 to 1000; "
		       "auto: 0.2, and in l2 what suits the noise"),
		GD_NUM(0, "tolerance", "RESIDUAL", &conf->tolerance, 1e-12, 1,
		       "relative residual to reach"),
		GD_NUM(0, "iterations", "N", &conf->max_iterations, 1, 1e6,
		       "most conjugate gradient steps of a linear system"),
		GD_NUM(0, "reweight", "N", &conf->reweight, 1, 1000,
		       "linear systems to solve for l1"),
		GD_NUM(0, "floor", "RATIO", &conf->floor, 1e-6, 1e6,
		       "wls: added to each variance, times the median variance"),
		GD_NUM(0, "smooth", "PIXELS", &conf->smooth_px, 0, 8,
		       "wls: standard deviation of the blur of the variances"),
		GD_FLAG(0, "pairs", &job.pairs,
			"take the gradients of pairs of pixels in place of dx and dy"),
		GD_OPT('l', "layer", "LAYER", &job.layer,
		       "write the result to LAYER and leave the rest alone"),
		GD_FLAG(0, "keep", &job.keep, "write gradients, variances and bins too"),
		GD_OPT_END};
	const struct gd_cmd cmd = {.name = "gdsolve",
				   .operands = "[input.exr [output.exr]]",
				   .summary = "solve for the image behind noisy gradients",
				   .opts = opts,
				   .min_operands = 0,
				   .max_operands = 2,
				   .filter = true};
	struct gd_err err = { 0 };
	int rc;

	gd_cli_parse(&job.cli, &cmd, argc, argv);
	rc = run(&job, &err);
	gd_pairs_free(&job.edges);
	gd_image_free(&job.im);
	return gd_cli_finish(&job.cli, rc, &err);
}
