/* SPDX-License-Identifier: BSD-3-Clause */
/* gdbag: a feature image and its variance from bins of gradients. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "boot.h"
#include "buffers.h"
#include "cli.h"

struct job {
	struct gd_cli cli;
	struct gd_image im;
	struct gd_boot_conf conf;
	struct gd_boot_in in;
	struct gd_boot_result result;
	struct gd_plane dx[GD_BOOT_MAX_BINS][3], dy[GD_BOOT_MAX_BINS][3];
	const char *layer;
	bool keep, local;
};

/* Without bins the gradients themselves are the one bin. */
static void bin_layer(char *name, size_t size, const struct job *job, int bin, const char *layer)
{
	if (job->in.bins > 1)
		snprintf(name, size, "bin%d.%s", bin, layer);
	else
		snprintf(name, size, "%s", layer);
}

static int choose_channels(struct job *job, struct gd_err *err)
{
	const int x = gd_bins(&job->im, "dx"), y = gd_bins(&job->im, "dy");

	if (x != y)
		return gd_fail(err, GD_ESHAPE, "%d bins of dx, but %d of dy", x, y);
	if (x > GD_BOOT_MAX_BINS)
		return gd_fail(err, GD_ESHAPE, "%d bins, at most %d are supported", x,
			       GD_BOOT_MAX_BINS);
	job->in.bins = x > 1 ? x : 1;
	for (int b = 0; b < job->in.bins; b++) {
		char dx[32], dy[32];

		bin_layer(dx, sizeof(dx), job, b, "dx");
		bin_layer(dy, sizeof(dy), job, b, "dy");
		if (!gd_layer_want(&job->im, dx, GD_READ))
			return gd_fail(err, GD_ESHAPE, "no channel %s.R", dx);
		if (!gd_layer_want(&job->im, dy, GD_READ))
			return gd_fail(err, GD_ESHAPE, "no channel %s.R", dy);
	}
	if (x < 2)
		gd_cli_warn(&job->cli,
			    "%s: no bins of gradients (bin0.dx.R, bin1.dx.R): no resampling",
			    job->cli.input);
	if (!gd_layer_want(&job->im, "", GD_READ))
		gd_cli_warn(&job->cli, "%s: no channel R: the mean of the feature is 0",
			    job->cli.input);
	return GD_OK;
}

static int take_layer(struct job *job, const char *layer, struct gd_plane *to, struct gd_err *err)
{
	struct gd_plane plane[GD_LAYER_PLANES];
	const int n = gd_layer_planes(&job->im, layer, plane);

	if (job->in.n == 0)
		job->in.n = n;
	if (n != job->in.n)
		return gd_fail(err, GD_ESHAPE, "layer %s has %d channels, expected %d",
			       *layer ? layer : "R G B", n, job->in.n);
	memcpy(to, plane, (size_t)n * sizeof(*plane));
	return GD_OK;
}

static int collect(struct job *job, struct gd_err *err)
{
	struct gd_plane colour[GD_LAYER_PLANES];
	int rc = GD_OK;

	for (int b = 0; b < job->in.bins && rc == GD_OK; b++) {
		char dx[32], dy[32];

		bin_layer(dx, sizeof(dx), job, b, "dx");
		bin_layer(dy, sizeof(dy), job, b, "dy");
		rc = take_layer(job, dx, job->dx[b], err);
		if (rc == GD_OK)
			rc = take_layer(job, dy, job->dy[b], err);
	}
	if (rc == GD_OK && gd_layer_planes(&job->im, "", colour))
		rc = take_layer(job, "", job->in.primal, err);
	job->in.dx = (const struct gd_plane (*)[3])job->dx;
	job->in.dy = (const struct gd_plane (*)[3])job->dy;
	return rc;
}

static int bag(struct job *job, struct gd_err *err)
{
	struct gd_boot_out out = { 0 };
	struct gd_plane mean[GD_LAYER_PLANES], var[GD_LAYER_PLANES];
	char name[256];
	int rc;

	snprintf(name, sizeof(name), "%s.variance", job->layer);
	rc = gd_layer_add(&job->im, job->layer, job->in.n, mean, err);
	if (rc == GD_OK)
		rc = gd_layer_add(&job->im, name, job->in.n, var, err);
	if (rc == GD_OK)
		rc = collect(job, err);
	for (int c = 0; rc == GD_OK && c < job->in.n; c++) {
		out.mean[c] = mean[c];
		*(job->local ? &out.local[c] : &out.var[c]) = var[c];
	}
	if (rc == GD_OK)
		rc = gd_boot_run(&out, &job->in, &job->conf, &job->result, &job->cli.report, err);
	return rc;
}

/* bin<n>.dx.* and bin<n>.dy.*: used up. */
static bool used(const char *name, void *user)
{
	const char *p = name + 3;

	(void)user;
	if (strncmp(name, "bin", 3) || *p < '0' || *p > '9')
		return false;
	p += strspn(p, "0123456789");
	return !strncmp(p, ".dx.", 4) || !strncmp(p, ".dy.", 4);
}

static int run(struct job *job, struct gd_err *err)
{
	struct gd_exr *file = NULL;
	int rc = gd_cli_open(&job->cli, &file, &job->im, job->cli.input, err);

	if (rc == GD_OK)
		rc = choose_channels(job, err);
	if (rc == GD_OK)
		rc = gd_cli_load(&job->cli, file, &job->im, err);
	else
		gd_exr_close(file);
	if (rc == GD_OK)
		rc = collect(job, err);
	if (rc == GD_OK)
		rc = bag(job, err);
	if (rc != GD_OK)
		return rc;
	if (!job->keep)
		gd_image_drop_if(&job->im, used, NULL);
	gd_cli_stat(&job->cli, "bins", job->in.bins);
	gd_cli_stat(&job->cli, "replicates", job->in.bins > 1 ? job->conf.replicates : 0);
	gd_cli_stat(&job->cli, "iterations", job->result.iterations);
	gd_cli_stat(&job->cli, "parts", job->result.parts);
	if (job->result.residual > 1) {
		gd_cli_warn(&job->cli, "%s: a relative residual is %.2g times what was asked for",
			    job->cli.input, job->result.residual);
		job->cli.limit_missed = true;
	}
	return gd_cli_write(&job->cli, &job->im, err);
}

int main(int argc, char **argv)
{
	struct job job = { .conf = GD_BOOT_DEFAULTS, .layer = "feature" };
	struct gd_boot_conf *conf = &job.conf;
	const struct gd_opt opts[] = {
		GD_NUM('B', "replicates", "N", &conf->replicates, 2, 1000, "bootstrap replicates"),
		GD_OPT('s', "seed", "NUMBER", &conf->seed, "seed of the draws"),
		GD_NUM(0, "floor", "RATIO", &conf->floor, 1e-6, 1e6,
		       "added to each variance, times the median variance"),
		GD_NUM(0, "smooth", "PIXELS", &conf->smooth_px, 0, 8,
		       "standard deviation of the blur of the variances"),
		GD_FLAG(0, "local", &job.local,
			"write the variance without the drift that neighbours share"),
		GD_NUM(0, "local-sigma", "PIXELS", &conf->local_px, 0.3, 10,
		       "standard deviation of the blur that is the drift"),
		GD_NUM(0, "tolerance", "RESIDUAL", &conf->tolerance_t, 1e-6, 1,
		       "relative residual of a replicate's difference"),
		GD_OPT('l', "layer", "LAYER", &job.layer, "write to LAYER and its variance"),
		GD_FLAG(0, "keep", &job.keep, "write the bins of gradients too"),
		GD_OPT_END};
	const struct gd_cmd cmd = {.name = "gdbag",
				   .operands = "[input.exr [output.exr]]",
				   .summary = "feature image from bins of gradients, by bagging",
				   .opts = opts,
				   .min_operands = 0,
				   .max_operands = 2,
				   .filter = true};
	struct gd_err err = { 0 };
	int rc;

	gd_cli_parse(&job.cli, &cmd, argc, argv);
	rc = run(&job, &err);
	gd_image_free(&job.im);
	return gd_cli_finish(&job.cli, rc, &err);
}
