/* SPDX-License-Identifier: BSD-3-Clause */
/* gdmerge: several renders of one frame into one gd buffer. */
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "cli.h"
#include "merge.h"

#define NAMES_LINE 2048

/* An input that was opened for its header and cannot be opened twice. */
struct held {
	struct gd_exr *file;
	struct gd_image im;
};

/* --spp 16 is for all inputs, --spp 16,16,64 for one each. */
static int parse_spp(const char *text, double *spp, int n, struct gd_err *err)
{
	const char *s = text;
	int k = 0;

	while (s && k < n) {
		char *end;

		errno = 0;
		spp[k] = strtod(s, &end);
		if (end == s || errno || !(spp[k] > 0) || !(spp[k] <= 1e9) || (*end && *end != ','))
			return gd_fail(err, GD_EARG, "option --spp: '%s' is no list of numbers "
				       "above 0, up to 1e9", text);
		k++;
		s = *end ? end + 1 : NULL;
	}
	if (text && (s || (k != 1 && k != n)))
		return gd_fail(err, GD_EARG, "option --spp: '%s' is not one number, nor %d of them",
			       text, n);
	for (int i = 1; k == 1 && i < n; i++)
		spp[i] = spp[0];
	return GD_OK;
}

/*
 * Which channel was taken for what: in full with -v; line is for where names had to be translated,
 * else "".
 */
static int tell_names(struct gd_cli *cli, const struct gd_image *im,
		      const struct gd_names_conf *conf, char line[NAMES_LINE], struct gd_err *err)
{
	struct gd_names names = { 0 };
	char what[600];
	size_t used = 0, head;
	int rc = gd_names_resolve(&names, im, conf, err);

	head = used = (size_t)snprintf(line, NAMES_LINE, "names of %s: ",
				       gd_preset_name(names.preset));
	for (int k = 0; k < names.n; k++) {
		const struct gd_named *l = &names.layer[k];
		const char *name = *l->layer ? l->layer : "colour";
		const char *role = l->role == GD_ROLE_VARIANCE ? " variance" : "";

		gd_named_describe(l, im, what, sizeof what);
		if (l->role == GD_ROLE_MEAN || l->role == GD_ROLE_VARIANCE ||
		    l->role == GD_ROLE_SAMPLES)
			gd_note(&cli->report, "%s%s from %s", name, role, what);
		else
			gd_note(&cli->report, "%s %s", what,
				l->role == GD_ROLE_PASS ? "passes as it is in the first input"
							: "is dropped");
		if (l->renamed && l->role != GD_ROLE_DROP && used < NAMES_LINE)
			used += (size_t)snprintf(line + used, NAMES_LINE - used, "%s%s%s from %s",
						 used > head ? ", " : "", name, role, what);
	}
	if (used == head)
		*line = 0;
	else if (used < NAMES_LINE)
		snprintf(line + used, NAMES_LINE - used, " (variance: %s)",
			 gd_variance_name(names.variance));
	gd_cli_stat_text(cli, "names", gd_preset_name(names.preset));
	gd_names_free(&names);
	return rc;
}

static int survey(struct gd_cli *cli, struct gd_merge *m, const struct gd_merge_conf *conf,
		  char **input, int n, const double *spp, struct held *held,
		  char line[NAMES_LINE], struct gd_err *err)
{
	int rc = GD_OK;

	for (int i = 0; i < n && rc == GD_OK; i++) {
		struct gd_image im = { 0 };
		struct gd_exr *file = NULL;

		if (!strcmp(input[i], "-") && held->file)
			return gd_fail(err, GD_EARG, "standard input is named twice");
		rc = gd_cli_open(cli, &file, &im, input[i], err);
		if (rc == GD_OK)
			rc = gd_merge_survey(m, &im, strcmp(input[i], "-") ? input[i] : "stdin",
					     spp[i], err);
		if (rc == GD_OK && i == 0)
			rc = tell_names(cli, &im, &conf->names, line, err);
		if (rc == GD_OK && !strcmp(input[i], "-")) {
			*held = (struct held){ file, im };
			continue;
		}
		gd_exr_close(file);
		gd_image_free(&im);
	}
	return rc;
}

static int add_all(struct gd_cli *cli, struct gd_merge *m, char **input, int n, struct held *held,
		   struct gd_err *err)
{
	int rc = GD_OK;

	for (int i = 0; i < n && rc == GD_OK; i++) {
		struct held now = { 0 };

		if (!strcmp(input[i], "-")) {
			now = *held;
			*held = (struct held){ 0 };
		} else {
			rc = gd_cli_open(cli, &now.file, &now.im, input[i], err);
		}
		if (rc == GD_OK)
			rc = gd_merge_want(m, i, &now.im, err);
		if (rc == GD_OK)
			rc = gd_cli_load(cli, now.file, &now.im, err);
		else
			gd_exr_close(now.file);
		if (rc == GD_OK)
			rc = gd_merge_add(m, i, &now.im, &cli->report, err);
		gd_image_free(&now.im);
		gd_progress(&cli->report, "merging", (i + 1.0) / n);
	}
	return rc;
}

static void tell_result(struct gd_cli *cli, const struct gd_merge_result *r)
{
	gd_cli_stat(cli, "inputs", r->inputs);
	gd_cli_stat(cli, "samples", r->samples);
	gd_cli_stat(cli, "bins", r->bins);
	gd_cli_stat(cli, "dropped_pixels", (double)r->dropped);
	gd_cli_stat(cli, "empty_pixels", (double)r->empty);
	gd_cli_stat(cli, "one_sided_pixels", (double)r->one_sided);
	gd_cli_stat(cli, "twin_inputs", r->twins);
	if (r->spread_ratio > 0)
		gd_cli_stat(cli, "spread_ratio", r->spread_ratio);
	if (r->dropped)
		gd_cli_warn(cli,
			    "%zu pixels with NaN or Inf in one input left out (-v tells where)",
			    r->dropped);
	if (r->empty)
		gd_cli_warn(cli, "%zu pixels have no sample in any input and are 0", r->empty);
	if (r->one_sided)
		gd_cli_warn(cli, "%zu pixels have samples in the even or the odd bins only: "
			    "render every pass in two parts (gdsample --multiple 2)",
			    r->one_sided);
	if (r->twins)
		gd_cli_warn(cli, "inputs whose colours are those of an earlier one, bit by bit: "
			    "%d; the same seed twice? (-v tells which)", r->twins);
	if (r->bins && r->bin_ratio > 1.5)
		gd_cli_warn(cli, "the fullest bin has %.2g times the samples of the emptiest",
			    r->bin_ratio);
	if (r->spread_ratio > 3 || (r->spread_ratio > 0 && r->spread_ratio < 1.0 / 3))
		gd_cli_warn(cli, "the inputs' own standard deviation is %.2g times what their "
			    "spread tells; is --variance right?", r->spread_ratio);
	if (r->samples > 0)
		gd_note(&cli->report, "%d inputs, %g samples a pixel, %d bins", r->inputs,
			r->samples, r->bins);
	else
		gd_note(&cli->report, "%d inputs of unknown sample counts, %d bins", r->inputs,
			r->bins);
}

int main(int argc, char **argv)
{
	struct gd_merge_conf conf = { .bins = -1 };
	struct gd_list map = { 0 }, pass = { 0 };
	const char *names = "auto", *variance = "auto", *spp_text = NULL;
	const struct gd_opt opts[] = {
		GD_OPT(0, "names", "RENDERER", &names,
		       "whose channel names: auto, gd, pbrt, mitsuba, cycles, tungsten, arnold or "
		       "renderman"),
		GD_OPT(0, "map", "LAYER=CHANNELS", &map,
		       "take CHANNELS (a,b,c or name.{R,G,B}) for LAYER; may be given several "
		       "times"),
		GD_OPT(0, "pass", "PATTERN", &pass,
		       "pass channels that match as the first input has them; may be given several "
		       "times"),
		GD_OPT(0, "variance", "KIND", &variance,
		       "what the inputs' variances are: auto, mean, sample, m2 or none"),
		GD_OPT(0, "spp", "N[,N...]", &spp_text,
		       "samples per pixel of all inputs, or of each"),
		GD_NUM(0, "bins", "N", &conf.bins, -1, GD_MAX_BINS,
		       "write N bins, 0 for none, -1 for the inputs' own, else one for each input "
		       "up to 16, else 8"),
		GD_FLAG(0, "halves", &conf.halves,
			"write half0 and half1, the even and the odd bins"),
		GD_FLAG(0, "own-edges", &conf.own_edges,
			"a gradient has the sample count of its own pixel, not the mean of both it "
			"joins"),
		GD_OPT_END
	};
	const struct gd_cmd cmd = {
		"gdmerge", "[input.exr ...]", "merge renders of one frame into one gd buffer",
		opts, 0, -1, true
	};
	struct gd_cli cli = { 0 };
	struct gd_err err = { 0 };
	struct gd_merge *m = NULL;
	struct gd_merge_result result = { 0 };
	struct gd_image out = { 0 };
	struct held held = { 0 };
	char names_line[NAMES_LINE] = "", dash[] = "-", *standard[] = { dash }, **input;
	double *spp;
	int n, rc = GD_OK;

	gd_cli_parse(&cli, &cmd, argc, argv);
	n = cli.noperand ? cli.noperand : 1;
	input = cli.noperand ? cli.operand : standard;
	spp = calloc((size_t)n, sizeof *spp);
	conf.names.nmap = map.n;
	conf.names.map = map.v;
	conf.names.npass = pass.n;
	conf.names.pass = pass.v;
	if (!spp)
		rc = gd_fail(&err, GD_ENOMEM, "out of memory");
	else if (!gd_preset_parse(names, &conf.names.preset))
		rc = gd_fail(&err, GD_EARG, "option --names: '%s' is none of the renderers known",
			     names);
	else if (!gd_variance_parse(variance, &conf.names.variance))
		rc = gd_fail(&err, GD_EARG,
			     "option --variance: '%s' is none of auto, mean, sample, m2, none",
			     variance);
	if (rc == GD_OK)
		rc = parse_spp(spp_text, spp, n, &err);
	if (rc == GD_OK)
		rc = gd_merge_begin(&m, &conf, &err);
	if (rc == GD_OK)
		rc = survey(&cli, m, &conf, input, n, spp, &held, names_line, &err);
	if (rc == GD_OK)
		rc = gd_merge_plan(m, &cli.report, &err);
	if (rc == GD_OK)
		rc = add_all(&cli, m, input, n, &held, &err);
	if (rc == GD_OK)
		rc = gd_merge_finish(m, &out, &result, &cli.report, &err);
	gd_merge_free(m);
	gd_exr_close(held.file);
	gd_image_free(&held.im);
	free(spp);
	if (rc == GD_OK) {
		if (*names_line && !cli.quiet && !cli.verbose)
			fprintf(stderr, "%s: %s\n", cmd.name, names_line);
		tell_result(&cli, &result);
		rc = gd_cli_write(&cli, &out, &err);
	}
	gd_image_free(&out);
	return gd_cli_finish(&cli, rc, &err);
}
