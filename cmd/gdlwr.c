/* SPDX-License-Identifier: BSD-3-Clause */
/* gdlwr: denoise a frame by sparse linear predictions in windows of adaptive size. */
#include <string.h>

#include "cli.h"
#include "denoise.h"

#define WIDEST (2 * GD_LWR_RADIUS + 1)

struct options {
	bool paper, state;
	int granularity;
	const char *previous;
};

/* The published method has settings of its own; a grid wider than the windows leaves gaps. */
static void settle_models(struct gd_lwr_conf *lwr, const struct options *opt)
{
	if (opt->paper) {
		lwr->paper = true;
		lwr->granularity = lwr->per_column = 0;
	}
	if (lwr->granularity > 2 * lwr->radius + 1)
		lwr->granularity = 2 * lwr->radius + 1;
	if (opt->granularity >= 0)
		lwr->granularity = opt->granularity;
}

/* What was asked for, or why it cannot be. */
static int settle(struct gd_denoise_conf *conf, const struct options *opt, const struct gd_cli *cli,
		  struct gd_err *err)
{
	const int widest = 2 * conf->lwr.radius + 1;

	settle_models(&conf->lwr, opt);
	conf->time.paper = opt->paper;
	conf->method = opt->paper ? GD_DENOISE_LWR_WHOLE : GD_DENOISE_LWR;
	conf->sequence = opt->state || opt->previous;
	if (opt->previous && !strcmp(opt->previous, "-") && !strcmp(cli->input, "-"))
		return gd_fail(err, GD_EARG,
			       "--previous -: standard input is the frame to denoise");
	if (opt->granularity >= 0 && conf->lwr.dense)
		return gd_fail(err, GD_EARG,
			       "--granularity is for sparse models: it does not go with --dense");
	if (opt->granularity > widest)
		return gd_fail(err, GD_EARG,
			       "--granularity %d leaves gaps between windows of radius %d",
			       opt->granularity, conf->lwr.radius);
	return GD_OK;
}

static void tell(struct gd_cli *cli, const struct gd_denoise_conf *conf,
		 const struct gd_denoise_result *result)
{
	if (result->mended)
		gd_cli_warn(cli, "%zu values that were NaN or Inf were filled in", result->mended);
	gd_note(&cli->report, "%.3f s for features, %.3f s for the models", result->filter_seconds,
		result->fit_seconds);
	gd_cli_stat_text(cli, "method", !result->crossfit ? "paper" :
			 result->halves ? "crossfit" : "whole");
	gd_cli_stat(cli, "models", (double)result->models);
	gd_cli_stat(cli, "share", result->share);
	gd_cli_stat(cli, "meanRadius", result->mean_radius);
	gd_cli_stat(cli, "meanFeatures", result->mean_features);
	gd_cli_stat(cli, "mended", (double)result->mended);
	gd_cli_stat(cli, "filterSeconds", result->filter_seconds);
	gd_cli_stat(cli, "fitSeconds", result->fit_seconds);
	if (!conf->sequence)
		return;
	gd_cli_stat(cli, "followed", result->followed);
	gd_cli_stat(cli, "meanFrames", result->mean_frames);
	gd_cli_stat(cli, "timeSeconds", result->time_seconds);
}

/* The state that the frame before left; its size must be that of im. */
static int load_previous(struct gd_cli *cli, struct gd_image *before, const struct gd_image *im,
			 const char *path, struct gd_err *err)
{
	struct gd_exr *file;
	int rc;

	cli->about = path;
	rc = gd_cli_open(cli, &file, before, path, err);
	if (rc == GD_OK && (before->w != im->w || before->h != im->h))
		rc = gd_fail(err, GD_ESHAPE, "%d x %d pixels, expected %d x %d", before->w,
			     before->h, im->w, im->h);
	if (rc == GD_OK)
		rc = gd_temporal_want(before, err);
	if (rc == GD_OK)
		rc = gd_cli_load(cli, file, before, err);
	else
		gd_exr_close(file);
	if (rc == GD_OK)
		cli->about = NULL;
	return rc;
}

static int run(struct gd_cli *cli, struct gd_image *im, struct gd_image *before,
	       struct gd_denoise_conf *conf, const struct options *opt, struct gd_err *err)
{
	struct gd_denoise_result result;
	struct gd_exr *file;
	int rc = gd_cli_open(cli, &file, im, cli->input, err);

	if (rc == GD_OK)
		rc = gd_denoise_want(im, conf, err);
	if (rc == GD_OK && opt->previous) {
		conf->previous = before;
		rc = load_previous(cli, before, im, opt->previous, err);
	}
	if (rc != GD_OK) {
		gd_exr_close(file);
		return rc;
	}
	rc = gd_cli_load(cli, file, im, err);
	if (rc == GD_OK)
		rc = gd_denoise_run(im, conf, &result, &cli->report, err);
	if (rc != GD_OK)
		return rc;
	tell(cli, conf, &result);
	return gd_cli_write(cli, im, err);
}

int main(int argc, char **argv)
{
	struct gd_denoise_conf conf = GD_DENOISE_DEFAULTS;
	struct options opt = { .granularity = -1 };
	const struct gd_opt opts[] = {
		GD_OPT('f', "features", "LIST", &conf.features,
		       "layers to explain the image by, or auto, or none"),
		GD_OPT('l', "layers", "LIST", &conf.layers,
		       "layers to denoise along with the colour, alike"),
		GD_NUM('r', "radius", "PIXELS", &conf.lwr.radius, 1, GD_LWR_RADIUS,
		       "largest window radius"),
		GD_NUM(0, "granularity", "PIXELS", &opt.granularity, -1, WIDEST,
		       "distance of the first models; 0: the width of the largest window; -1: 5"),
		GD_FLAG(0, "dense", &conf.lwr.dense, "a model at every pixel"),
		GD_FLAG(0, "paper", &opt.paper,
			"the method as published: all samples, its own error"),
		GD_FLAG(0, "state", &opt.state,
			"first frame of a sequence: write the state for the next, too"),
		GD_OPT(0, "previous", "FILE", &opt.previous,
		       "later frame of a sequence: FILE is the result of the one before"),
		GD_NUM(0, "forget", "FACTOR", &conf.time.forget, 0.5, 1,
		       "what a frame counts one frame later"),
		GD_FLAG(0, "no-filter", &conf.no_filter, "take noisy features as they are"),
		GD_FLAG(0, "keep", &conf.keep, "write features, variances, bins and gradients too"),
		GD_OPT_END
	};
	const struct gd_cmd cmd = {
		.name = "gdlwr",
		.operands = "[input.exr [output.exr]]",
		.summary = "denoise by linear predictions in windows of adaptive size",
		.opts = opts,
		.min_operands = 0,
		.max_operands = 2,
		.filter = true
	};
	struct gd_cli cli = { 0 };
	struct gd_image im = { 0 }, before = { 0 };
	struct gd_err err = { 0 };
	int rc;

	gd_cli_parse(&cli, &cmd, argc, argv);
	rc = settle(&conf, &opt, &cli, &err);
	if (rc == GD_OK)
		rc = run(&cli, &im, &before, &conf, &opt, &err);
	gd_image_free(&before);
	gd_image_free(&im);
	return gd_cli_finish(&cli, rc, &err);
}
