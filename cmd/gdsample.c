/* SPDX-License-Identifier: BSD-3-Clause */
/* gdsample: where the next samples go. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "buffers.h"
#include "cli.h"
#include "names.h"
#include "plugin.h"
#include "sampling.h"
#include "show.h"
#include "spending.h"

#define CLOSE	0.002	/* of the budget: what a map with gradients may miss it by */
#define ROUNDS	8	/* most maps that are tried for that; 3 are usual */

struct options {
	double spp, total, samples, floor, blur, dimension, cost;
	int min, max, multiple;
	uint64_t seed;
	const char *png, *gradients;
	bool paper;
};

static int settle(struct gd_sampling_conf *conf, const struct options *opt,
		  const struct gd_cli *cli, struct gd_err *err)
{
	const struct gd_sampling_conf own = GD_SAMPLING_DEFAULTS, paper = GD_SAMPLING_PAPER;

	*conf = opt->paper ? paper : own;
	if (opt->floor >= 0)
		conf->floor = opt->floor;
	if (opt->blur >= 0)
		conf->blur_px = opt->blur;
	conf->dimension = opt->dimension;
	conf->min = opt->min;
	conf->max = opt->max;
	conf->multiple = opt->multiple;
	conf->seed = opt->seed;
	if (opt->spp > 0 && opt->total > 0)
		return gd_fail(err, GD_EARG, "--spp and --total are two budgets: give one");
	if (!(opt->spp > 0) && !(opt->total > 0))
		return gd_fail(err, GD_EARG, "no budget: give --spp or --total");
	if (fmod(opt->total, opt->multiple) != 0)
		return gd_fail(err, GD_EARG, "--total %.17g: expected a multiple of %d", opt->total,
			       opt->multiple);
	if (opt->floor < 0 && opt->floor != -1)
		return gd_fail(err, GD_EARG, "--floor %g: expected 0 to 1, or -1", opt->floor);
	if (opt->blur < 0 && opt->blur != -1)
		return gd_fail(err, GD_EARG, "--blur %g: expected 0 to 10, or -1", opt->blur);
	if (opt->min > opt->max)
		return gd_fail(err, GD_EARG, "--min %d is above --max %d", opt->min, opt->max);
	if (opt->gradients && !strcmp(opt->gradients, "-") && !strcmp(cli->input, "-"))
		return gd_fail(err, GD_EARG, "--gradients -: standard input is the denoised image");
	if (opt->png && gd_picture_misnamed(opt->png))
		return gd_fail(err, GD_EARG, "--png: %s: a PNG does not get the name of an EXR",
			       opt->png);
	if (opt->png && !strcmp(opt->png, cli->output))
		return gd_fail(err, GD_EARG, "--png %s: the output of the map itself", opt->png);
	return opt->png ? gd_plugin_check(err) : GD_OK;
}

/* The first channel of a layer of three that is missing, by name. */
static int want_layer(struct gd_image *im, const char *layer, struct gd_err *err)
{
	static const char *const suffix[] = { "R", "G", "B" };
	char name[64];

	for (int c = 0; c < 3; c++) {
		snprintf(name, sizeof name, "%s%s%s", layer, *layer ? "." : "", suffix[c]);
		if (gd_image_find(im, name) < 0)
			return gd_fail(err, GD_ESHAPE, "no channel %s", name);
	}
	gd_layer_want(im, layer, GD_READ);
	return GD_OK;
}

static int load(struct gd_cli *cli, struct gd_image *im, struct gd_err *err)
{
	struct gd_exr *file = NULL;
	int rc = gd_cli_open(cli, &file, im, cli->input, err);

	if (rc != GD_OK)
		return rc;
	rc = want_layer(im, "", err);
	if (rc == GD_OK)
		rc = want_layer(im, "error", err);
	if (rc != GD_OK) {
		gd_exr_close(file);
		return rc;
	}
	gd_layer_want(im, "samples", GD_READ);
	gd_layer_want(im, "sampling", GD_DROP);
	gd_layer_want(im, "gradients", GD_DROP);
	return gd_cli_load(cli, file, im, err);
}

/* Samples so far: of each pixel, or of all. */
static void find_samples(struct gd_sampling_in *in, struct gd_cli *cli, const struct gd_image *im,
			 const struct options *opt)
{
	double spp = opt->samples;

	if (!(spp > 0) && gd_image_plane(im, "samples", &in->samples))
		return;
	if (!(spp > 0) && !gd_names_spp(im, &spp)) {
		gd_cli_warn(cli, "the file does not say how many samples it has: taken for 1 a "
			    "pixel (see --samples)");
		spp = 1;
	}
	in->samples = (struct gd_plane){ 0 };
	in->even_samples = spp;
	gd_note(&cli->report, "%g samples a pixel so far", spp);
}

static int draw(struct gd_plane map, const char *path, struct gd_err *err)
{
	struct gd_show_conf conf = { .as = GD_SHOW_SCALAR };
	struct gd_picture pic = { 0 };
	int rc = gd_show_range(&conf.range, &map, 1, conf.as, GD_SHOW_LINEAR, err);

	conf.range.lo = 0;
	conf.range.hi = fmaxf(conf.range.hi, 1);
	if (rc == GD_OK)
		rc = gd_show(&pic, NULL, &map, 1, &conf, err);
	if (rc == GD_OK)
		rc = gd_picture_legend(&pic, &conf, err);
	if (rc == GD_OK)
		rc = gd_picture_write(&pic, path, 8, err);
	gd_picture_free(&pic);
	return rc;
}

static void tell(struct gd_cli *cli, const struct gd_sampling_conf *conf,
		 const struct gd_sampling_result *r)
{
	if (r->blind)
		gd_cli_warn(cli, "no error anywhere: the map is even");
	gd_note(&cli->report, "%.0f samples, %.0f to %.0f a pixel, at least %g %% of them spread "
		"evenly", conf->total, r->least, r->most, 100 * conf->floor);
	gd_note(&cli->report, "mean relative error %.4g, should become %.4g; %.4g with an even map",
		r->before, r->after, r->even);
	gd_cli_stat(cli, "total", conf->total);
	gd_cli_stat(cli, "least", r->least);
	gd_cli_stat(cli, "most", r->most);
	gd_cli_stat(cli, "level", r->level);
	gd_cli_stat(cli, "relative_error", r->before);
	gd_cli_stat(cli, "expected", r->after);
	gd_cli_stat(cli, "expected_even", r->even);
}

/* ---- gradients ---- */

static void tell_gradients(struct gd_cli *cli, const struct gd_spending_conf *conf,
			   const struct gd_spending_result *r)
{
	gd_note(&cli->report, "gradients change the relative error by %+.0f %%, at %g times the "
		"cost", 100 * r->change, conf->cost);
	gd_note(&cli->report, "gradients for %.1f %% of the pixels' samples: the error should be "
		"%.2f times that of plain samples in the same time; %.2f with gradients everywhere",
		100 * r->share, r->gain, r->everywhere);
	gd_cli_stat(cli, "gradients", r->share);
	gd_cli_stat(cli, "gradients_change", r->change);
	gd_cli_stat(cli, "gradients_gain", r->gain);
	gd_cli_stat(cli, "gradients_everywhere", r->everywhere);
}

/* Adds the channel gradients, from the buffer that --gradients names. */
static int add_gradients(struct gd_cli *cli, struct gd_image *im, struct gd_plane *share,
			 const struct options *opt, struct gd_err *err)
{
	struct gd_spending_conf conf = GD_SPENDING_DEFAULTS;
	struct gd_spending_result result;
	struct gd_image buffer = { 0 };
	struct gd_exr *file = NULL;
	int rc = gd_image_add(im, "gradients", share, err);

	conf.cost = opt->cost;
	conf.dimension = opt->dimension;
	cli->about = opt->gradients;
	if (rc == GD_OK)
		rc = gd_cli_open(cli, &file, &buffer, opt->gradients, err);
	if (rc == GD_OK)
		rc = gd_spending_want(&buffer, err);
	if (rc == GD_OK)
		rc = gd_cli_load(cli, file, &buffer, err);
	else
		gd_exr_close(file);
	if (rc == GD_OK)
		rc = gd_spending_map(*share, &buffer, &conf, &result, &cli->report, err);
	if (rc == GD_OK) {
		tell_gradients(cli, &conf, &result);
		cli->about = NULL;
	}
	gd_image_free(&buffer);
	return rc;
}

/* What a map costs, in plain samples. */
static double cost_of(struct gd_plane map, struct gd_plane share, double cost)
{
	double sum = 0;

	for (int y = 0; y < map.h; y++)
		for (int x = 0; x < map.w; x++)
			sum += (double)gd_row(map, y)[x] *
			       (1 + (double)gd_row(share, y)[x] * (cost - 1));
	return sum;
}

/* Fewer samples, as some cost more, until what they cost is the budget. */
static int fit_budget(struct gd_plane map, const struct gd_sampling_in *in,
		      struct gd_sampling_conf *conf, struct gd_plane share, double each,
		      struct gd_sampling_result *result, double *cost, struct gd_err *err)
{
	const double budget = conf->total, unit = conf->multiple;
	int rc = GD_OK;

	for (int i = 0; i < ROUNDS && rc == GD_OK; i++) {
		rc = gd_sampling_map(map, in, conf, result, err);
		*cost = cost_of(map, share, each);
		if (rc != GD_OK || fabs(*cost - budget) <= CLOSE * budget || i == ROUNDS - 1)
			break;
		conf->total = fmax(unit * round(conf->total * budget / *cost / unit), unit);
	}
	return rc;
}

/* ---- all of it ---- */

static int set_budget(struct gd_sampling_conf *conf, const struct gd_image *im,
		      const struct options *opt, struct gd_err *err)
{
	conf->total = opt->multiple * round(opt->spp / opt->multiple * im->w * im->h);
	if (opt->total > 0)
		conf->total = opt->total;
	if (!(conf->total > 0))
		return gd_fail(err, GD_EARG, "--spp %g: rounded to a multiple of %d, no sample in "
			       "all %d x %d pixels", opt->spp, opt->multiple, im->w, im->h);
	return GD_OK;
}

static int run(struct gd_cli *cli, struct gd_image *im, struct gd_sampling_conf *conf,
	       const struct options *opt, struct gd_err *err)
{
	struct gd_sampling_result result;
	struct gd_sampling_in in = { .n = 3 };
	struct gd_plane map, share = { 0 };
	double cost = 0;
	int rc = load(cli, im, err);

	if (rc == GD_OK)
		rc = gd_image_add(im, "sampling", &map, err);
	if (rc == GD_OK && opt->gradients)
		rc = add_gradients(cli, im, &share, opt, err);
	if (rc != GD_OK)
		return rc;
	gd_layer_planes(im, "", in.colour);
	gd_layer_planes(im, "error", in.error);
	find_samples(&in, cli, im, opt);
	rc = set_budget(conf, im, opt, err);
	if (rc == GD_OK && opt->gradients) {
		rc = fit_budget(map, &in, conf, share, opt->cost, &result, &cost, err);
		gd_cli_stat(cli, "cost", cost);
	} else if (rc == GD_OK) {
		rc = gd_sampling_map(map, &in, conf, &result, err);
	}
	if (rc != GD_OK)
		return rc;
	tell(cli, conf, &result);
	rc = opt->png ? draw(map, opt->png, err) : GD_OK;
	return rc == GD_OK ? gd_cli_write(cli, im, err) : rc;
}

int main(int argc, char **argv)
{
	struct options opt = { .floor = -1, .blur = -1, .dimension = 4, .seed = 1, .multiple = 1,
			       .cost = 2,
			       .max = (int)GD_SAMPLING_MOST };
	const struct gd_opt opts[] = {
		GD_NUM(0, "spp", "N", &opt.spp, 0, GD_SAMPLING_MOST,
		       "budget: new samples a pixel, in the mean"),
		GD_NUM(0, "total", "N", &opt.total, 0, 9e15, "budget: new samples in all"),
		GD_NUM(0, "min", "N", &opt.min, 0, GD_SAMPLING_MOST,
		       "least new samples of a pixel"),
		GD_NUM(0, "max", "N", &opt.max, 0, GD_SAMPLING_MOST,
		       "most new samples of a pixel"),
		GD_NUM(0, "multiple", "N", &opt.multiple, 1, GD_SAMPLING_MOST,
		       "make every count a multiple of N: as many as the bins of a pass"),
		GD_NUM(0, "samples", "N", &opt.samples, 0, 1e9,
		       "samples a pixel so far; 0: as the file says"),
		GD_NUM(0, "floor", "SHARE", &opt.floor, -1, 1,
		       "share of the budget that is spread evenly; -1: the method's own"),
		GD_NUM(0, "blur", "PIXELS", &opt.blur, -1, 10,
		       "standard deviation of the blur of errors; -1: the method's own"),
		GD_NUM(0, "dimension", "D", &opt.dimension, 0, 100,
		       "errors fall with the samples to the power -4 / (D + 4)"),
		GD_FLAG(0, "paper", &opt.paper,
			"the method as published: in proportion to what one more sample gains"),
		GD_OPT(0, "gradients", "FILE", &opt.gradients,
		       "say which samples should trace gradients, too, from this buffer's bins"),
		GD_NUM(0, "gradient-cost", "C", &opt.cost, 1, 100,
		       "cost of a sample with gradients, in plain samples"),
		GD_OPT('s', "seed", "NUMBER", &opt.seed, "seed of the rounding to whole numbers"),
		GD_OPT(0, "png", "FILE.png", &opt.png, "write a picture of the map, too"),
		GD_OPT_END
	};
	const struct gd_cmd cmd = { .name = "gdsample",
				    .operands = "[input.exr [output.exr]]",
				    .summary = "where the next samples go, for a budget",
				    .opts = opts,
				    .max_operands = 2,
				    .filter = true };
	struct gd_sampling_conf conf;
	struct gd_cli cli = { 0 };
	struct gd_image im = { 0 };
	struct gd_err err = { 0 };
	int rc;

	gd_cli_parse(&cli, &cmd, argc, argv);
	rc = settle(&conf, &opt, &cli, &err);
	if (rc == GD_OK)
		rc = run(&cli, &im, &conf, &opt, &err);
	gd_image_free(&im);
	return gd_cli_finish(&cli, rc, &err);
}
