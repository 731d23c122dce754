/* SPDX-License-Identifier: BSD-3-Clause */
/* gdapr: denoise a frame by local regression on features. */
#include <string.h>

#include "cli.h"
#include "denoise.h"

struct options {
	bool paper, single;
	int radius, step, order_min, order;
	const char *kernel, *spikes;
	struct gd_list neighbours;
};

/* Of a single regression: the method's own settings, unless given; any given asks for one. */
static int settle(struct gd_denoise_conf *conf, const struct options *opt, struct gd_err *err)
{
	struct gd_apr_conf own = GD_APR_DEFAULTS, paper = GD_APR_PAPER;
	struct gd_apr_conf *apr = &conf->apr;

	*apr = opt->paper ? paper : own;
	if (opt->paper || opt->single || opt->radius >= 0 || opt->step > 0 || opt->order >= 0 ||
	    opt->order_min >= 0 || opt->kernel || opt->spikes)
		conf->method = GD_DENOISE_SINGLE;
	if (conf->method == GD_DENOISE_SINGLE && conf->fast)
		return gd_fail(
			err, GD_EARG,
			"--fast is for cross-fitting: it does not go with a single regression");
	if (conf->method == GD_DENOISE_SINGLE && opt->neighbours.n)
		return gd_fail(err, GD_EARG, "--neighbours is for cross-fitting: it does not go "
			       "with a single regression");
	if (opt->neighbours.n > GD_CROSSFIT_FRAMES)
		return gd_fail(err, GD_EARG, "--neighbours: %d files, at most %d",
			       opt->neighbours.n, GD_CROSSFIT_FRAMES);
	if (opt->radius >= 0) {
		apr->radius = opt->radius;
		apr->step = opt->radius > 1 ? (opt->radius + 1) / 2 : 1;
	}
	if (opt->step == 0)
		return gd_fail(err, GD_EARG, "--step 0: expected at least 1");
	if (opt->step > 0)
		apr->step = opt->step;
	if (opt->order >= 0)
		apr->order_max = opt->order;
	if (opt->order_min >= 0)
		apr->order_min = opt->order_min;
	if (apr->order_min > apr->order_max)
		return gd_fail(err, GD_EARG, "--order-min %d is above --order %d", apr->order_min,
			       apr->order_max);
	if (apr->step > 2 * apr->radius + 1)
		return gd_fail(err, GD_EARG, "--step %d leaves gaps between windows of radius %d",
			       apr->step, apr->radius);
	if (!opt->kernel || !strcmp(opt->kernel, "gauss") || !strcmp(opt->kernel, "box"))
		apr->kernel = !opt->kernel || *opt->kernel == 'g' ? GD_APR_GAUSS : GD_APR_BOX;
	else
		return gd_fail(err, GD_EARG, "--kernel '%s': expected gauss or box", opt->kernel);
	if (!opt->spikes || !strcmp(opt->spikes, "return"))
		conf->spikes = GD_SPIKES_RETURN;
	else if (!strcmp(opt->spikes, "drop"))
		conf->spikes = GD_SPIKES_DROP;
	else if (!strcmp(opt->spikes, "keep"))
		conf->spikes = GD_SPIKES_KEEP;
	else
		return gd_fail(err, GD_EARG, "--spikes '%s': expected return, drop or keep",
			       opt->spikes);
	return GD_OK;
}

static void tell(struct gd_cli *cli, const struct gd_denoise_conf *conf,
		 const struct gd_denoise_result *result)
{
	if (result->mended)
		gd_cli_warn(cli, "%zu values that were NaN or Inf were filled in", result->mended);
	gd_cli_stat_text(cli, "method", result->crossfit ? "crossfit" : "single");
	gd_cli_stat(cli, "models", (double)result->models);
	gd_cli_stat(cli, "frames", conf->nneighbour + 1);
	gd_cli_stat(cli, "spikes", result->spikes);
	gd_cli_stat(cli, "mended", (double)result->mended);
	gd_cli_stat(cli, "filterSeconds", result->filter_seconds);
	gd_cli_stat(cli, "gatherSeconds", result->gather_seconds);
	gd_cli_stat(cli, "pilotSeconds", result->pilot_seconds);
	gd_cli_stat(cli, "fitSeconds", result->fit_seconds);
}

static int load_neighbours(struct gd_cli *cli, struct gd_image *other, const struct gd_image *im,
			   const struct gd_list *list, const struct gd_denoise_conf *conf,
			   struct gd_err *err)
{
	int rc = GD_OK;

	for (int i = 0; i < list->n && rc == GD_OK; i++) {
		struct gd_exr *file;

		if (!strcmp(list->v[i], "-") && !strcmp(cli->input, "-"))
			return gd_fail(err, GD_EARG,
				       "--neighbours -: standard input is the frame to denoise");
		cli->about = list->v[i];
		rc = gd_cli_open(cli, &file, &other[i], list->v[i], err);
		if (rc == GD_OK)
			rc = gd_denoise_want_neighbour(&other[i], im, conf, err);
		if (rc == GD_OK)
			rc = gd_cli_load(cli, file, &other[i], err);
		else
			gd_exr_close(file);
	}
	if (rc == GD_OK)
		cli->about = NULL;
	return rc;
}

static int run(struct gd_cli *cli, struct gd_image *im, struct gd_denoise_conf *conf,
	       const struct gd_list *neighbours, struct gd_err *err)
{
	struct gd_denoise_result result;
	struct gd_exr *file;
	int rc = gd_cli_open(cli, &file, im, cli->input, err);

	if (rc == GD_OK)
		rc = gd_denoise_want(im, conf, err);
	if (rc == GD_OK)
		rc = load_neighbours(cli, conf->neighbour, im, neighbours, conf, err);
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
	struct options opt = { .radius = -1, .step = -1, .order_min = -1, .order = -1 };
	struct gd_denoise_conf conf = GD_DENOISE_DEFAULTS;
	const struct gd_opt opts[] = {
		GD_OPT('f', "features", "LIST", &conf.features,
		       "layers to explain the image by, or auto, or none"),
		GD_OPT('l', "layers", "LIST", &conf.layers,
		       "layers to denoise along with the colour, alike"),
		GD_WORDS(0, "neighbours", "FILE...", &opt.neighbours,
			 "other frames of the sequence, up to four, to denoise with"),
		GD_FLAG(0, "fast", &conf.fast, "one cross-fitted model in place of several"),
		GD_FLAG(0, "paper", &opt.paper,
			"the method as published: one regression, 43x43 windows, all samples"),
		GD_FLAG(0, "single", &opt.single,
			"one regression on all samples; so do the next six"),
		GD_NUM('r', "radius", "PIXELS", &opt.radius, -1, GD_APR_RADIUS,
		       "windows of 2r+1 pixels; -1: the method's own"),
		GD_NUM(0, "step", "PIXELS", &opt.step, -1, 2 * GD_APR_RADIUS + 1,
		       "distance of window centres; -1: half the radius"),
		GD_NUM(0, "order", "K", &opt.order, -1, GD_APR_ORDER,
		       "largest order of the polynomial; -1: 3"),
		GD_NUM(0, "order-min", "K", &opt.order_min, -1, GD_APR_ORDER,
		       "smallest order of the polynomial; -1: 0"),
		GD_OPT(0, "kernel", "NAME", &opt.kernel,
		       "weights in a window: gauss (the default) or box"),
		GD_OPT(0, "spikes", "WHAT", &opt.spikes,
		       "return (the default), drop or keep the energy of single bright pixels"),
		GD_FLAG(0, "no-filter", &conf.no_filter, "take noisy features as they are"),
		GD_FLAG(0, "keep", &conf.keep, "write features, variances, bins and gradients too"),
		GD_OPT_END};
	const struct gd_cmd cmd = {.name = "gdapr",
				   .operands = "[input.exr [output.exr]]",
				   .summary = "denoise by local regression on features",
				   .opts = opts,
				   .min_operands = 0,
				   .max_operands = 2,
				   .filter = true};
	struct gd_cli cli = { 0 };
	struct gd_image im = { 0 }, neighbour[GD_CROSSFIT_FRAMES] = { { 0 } };
	struct gd_err err = { 0 };
	int rc;

	gd_cli_parse(&cli, &cmd, argc, argv);
	rc = settle(&conf, &opt, &err);
	if (rc == GD_OK)
		rc = gd_cli_check_neighbours(&cli, &opt.neighbours, &err);
	conf.neighbour = neighbour;
	conf.nneighbour = rc == GD_OK ? opt.neighbours.n : 0;
	if (rc == GD_OK)
		rc = run(&cli, &im, &conf, &opt.neighbours, &err);
	for (int i = 0; i < GD_CROSSFIT_FRAMES; i++)
		gd_image_free(&neighbour[i]);
	gd_image_free(&im);
	return gd_cli_finish(&cli, rc, &err);
}
