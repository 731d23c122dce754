/* SPDX-License-Identifier: BSD-3-Clause */
/* gdfeature: an image made from the gradients, bagged and filtered, for a regression to lean on. */
#include <string.h>

#include "cli.h"
#include "feature.h"

static int choose_solve(const char *text, enum gd_feature_solve *solve, struct gd_err *err)
{
	static const char *const names[] = { "wls", "ols", "none" };

	for (int i = 0; i < 3; i++)
		if (!strcmp(text, names[i])) {
			*solve = (enum gd_feature_solve)i;
			return GD_OK;
		}
	return gd_fail(err, GD_EARG, "--solve: \"%s\" is none of wls, ols, none", text);
}

static void tell(struct gd_cli *cli, const struct gd_feature_conf *conf,
		 const struct gd_feature_result *res)
{
	const char *solver =
		conf->solve == GD_FEATURE_OLS ? "equal weights" : "weights from variances";

	if (conf->solve == GD_FEATURE_NONE)
		gd_note(&cli->report, "no feature asked for");
	else if (res->made_before)
		gd_note(&cli->report, "feature: that of the input");
	else if (res->bagged)
		gd_note(&cli->report, "feature: %d replicates of %d bins, %s, %.3f s",
			conf->boot.replicates, res->bins, solver, res->solve_seconds);
	else
		gd_note(&cli->report, "feature: one solve, %s, %.3f s", solver, res->solve_seconds);
	if (res->halves && !res->made_before)
		gd_note(&cli->report, "halves: even and odd bins, %.3f s", res->half_seconds);
	if (res->followed)
		gd_note(&cli->report, "%d neighbours, %.1f %% of the pixels found there, %.3f s",
			res->frames, 100 * res->found, res->frame_seconds);
	if (res->frames > res->followed)
		gd_note(&cli->report,
			"%d neighbours without world positions (the layer P in all frames): "
			"windows of the filter span all frames", res->frames - res->followed);
	if (res->filtered)
		gd_note(&cli->report, "filter: %dx%d patches, round window of %dx%d, k %g, %.3f s",
			2 * conf->nlm.patch + 1, 2 * conf->nlm.patch + 1, 2 * conf->nlm.window + 1,
			2 * conf->nlm.window + 1, conf->nlm.k, res->filter_seconds);
	if (conf->layers)
		gd_note(&cli->report, "other layers: %d filtered, %.3f s", res->layers,
			res->layer_seconds);
	gd_cli_stat(cli, "bins", res->bins);
	gd_cli_stat(cli, "replicates", res->bagged ? conf->boot.replicates : 0);
	gd_cli_stat(cli, "halves", res->halves);
	gd_cli_stat(cli, "filtered", res->filtered);
	gd_cli_stat(cli, "layers", res->layers);
	gd_cli_stat(cli, "frames", res->frames + 1);
	gd_cli_stat(cli, "found", res->found);
	gd_cli_stat(cli, "solve_seconds", res->solve_seconds);
	gd_cli_stat(cli, "half_seconds", res->half_seconds);
	gd_cli_stat(cli, "filter_seconds", res->filter_seconds);
	gd_cli_stat(cli, "layer_seconds", res->layer_seconds);
	gd_cli_stat(cli, "frame_seconds", res->frame_seconds);
}

/* The other frames, whole in memory; conf->neighbours counts them. */
static int load_neighbours(struct gd_cli *cli, const struct gd_image *im,
			   struct gd_feature_conf *conf, const struct gd_list *list,
			   struct gd_err *err)
{
	int rc = GD_OK;

	for (int i = 0; i < list->n && rc == GD_OK; i++) {
		struct gd_image *to = &conf->neighbour[i];
		struct gd_exr *file;

		cli->about = list->v[i];
		rc = gd_cli_open(cli, &file, to, list->v[i], err);
		if (rc == GD_OK)
			rc = gd_feature_want_neighbour(to, im, conf, err);
		if (rc == GD_OK)
			rc = gd_cli_load(cli, file, to, err);
		else
			gd_exr_close(file);
	}
	conf->neighbours = list->n;
	if (rc == GD_OK)
		cli->about = NULL;
	return rc;
}

static int check_neighbours(const struct gd_cli *cli, const struct gd_feature_conf *conf,
			    const struct gd_list *list, struct gd_err *err)
{
	if (list->n > GD_FEATURE_FRAMES)
		return gd_fail(err, GD_EARG, "--neighbours: %d files, expected %d at most", list->n,
			       GD_FEATURE_FRAMES);
	if (list->n && (!conf->filter || conf->solve == GD_FEATURE_NONE))
		return gd_fail(err, GD_EARG, "--neighbours: only the filter of the feature uses "
			       "them, and %s leaves it out",
			       conf->filter ? "--solve none" : "--no-filter");
	for (int i = 0; i < list->n; i++)
		if (!strcmp(list->v[i], "-"))
			return gd_fail(err, GD_EARG, "--neighbours -: %s",
				       strcmp(cli->input, "-") ? "a neighbour must be a file" :
				       "standard input is the frame itself");
	return gd_cli_check_neighbours(cli, list, err);
}

static int run(struct gd_cli *cli, struct gd_image *im, struct gd_feature_conf *conf,
	       const struct gd_list *neighbours, struct gd_err *err)
{
	struct gd_feature_result res;
	struct gd_exr *file = NULL;
	int rc = gd_cli_open(cli, &file, im, cli->input, err);

	if (rc != GD_OK)
		return rc;
	conf->neighbours = neighbours->n;
	rc = gd_feature_want(im, conf, err);
	if (rc == GD_OK)
		rc = load_neighbours(cli, im, conf, neighbours, err);
	if (rc != GD_OK) {
		gd_exr_close(file);
		return rc;
	}
	rc = gd_cli_load(cli, file, im, err);
	if (rc == GD_OK)
		rc = gd_feature_run(im, conf, &res, &cli->report, err);
	if (rc != GD_OK)
		return rc;
	tell(cli, conf, &res);
	return gd_cli_write(cli, im, err);
}

int main(int argc, char **argv)
{
	struct gd_feature_conf conf = GD_FEATURE_DEFAULTS;
	struct gd_image neighbour[GD_FEATURE_FRAMES] = { 0 };
	struct gd_list neighbours = { 0 };
	const char *solve = "wls";
	bool no_bagging = false, no_filter = false;
	const struct gd_opt opts[] = {
		GD_NUM('B', "replicates", "COUNT", &conf.boot.replicates, 2, 1000,
		       "bootstrap replicates"),
		GD_OPT('s', "seed", "NUMBER", &conf.boot.seed, "seed of the bootstrap draws"),
		GD_OPT(0, "solve", "METHOD", &solve,
		       "wls, ols (equal weights, no bagging) or none"),
		GD_FLAG(0, "no-bagging", &no_bagging, "solve once, from the bins as they are"),
		GD_FLAG(0, "no-filter", &no_filter, "leave out non-local means"),
		GD_NUM('k', "strength", "VALUE", &conf.nlm.k, 0.01, 100, "strength of the filter"),
		GD_NUM(0, "patch", "RADIUS", &conf.nlm.patch, 0, 16,
		       "radius of the filter's patches, pixels"),
		GD_NUM(0, "window", "RADIUS", &conf.nlm.window, 0, 32,
		       "radius of the filter's window, pixels"),
		GD_OPT(0, "filter", "LAYERS", &conf.layers,
		       "noisy layers to filter too: albedo,N,Z"),
		GD_WORDS(0, "neighbours", "FILE...", &neighbours,
			 "other frames of the sequence, up to four, to average the feature with"),
		GD_FLAG(0, "keep", &conf.keep, "keep gradients and their bins"),
		GD_OPT_END
	};
	const struct gd_cmd cmd = {
		.name = "gdfeature", .operands = "[input.exr [output.exr]]",
		.summary = "make the feature image from bins of gradients",
		.opts = opts, .max_operands = 2, .filter = true
	};
	struct gd_cli cli = { 0 };
	struct gd_image im = { 0 };
	struct gd_err err = { 0 };
	int rc;

	gd_cli_parse(&cli, &cmd, argc, argv);
	conf.bagging = !no_bagging;
	conf.filter = !no_filter;
	conf.neighbour = neighbour;
	rc = choose_solve(solve, &conf.solve, &err);
	if (rc == GD_OK)
		rc = check_neighbours(&cli, &conf, &neighbours, &err);
	if (rc == GD_OK)
		rc = run(&cli, &im, &conf, &neighbours, &err);
	for (int i = 0; i < GD_FEATURE_FRAMES; i++)
		gd_image_free(&neighbour[i]);
	gd_image_free(&im);
	return gd_cli_finish(&cli, rc, &err);
}
