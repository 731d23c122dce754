/* SPDX-License-Identifier: BSD-3-Clause */
/* gdapr: denoise a frame by adaptive polynomial rendering. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apr_paper.h"
#include "buffers.h"
#include "cli.h"

#define LAYERS 48	/* most layers of features, or to denoise along with the colour */

struct options {
	bool paper, keep, no_filter;
	int radius, step, order_min, order;
	const char *features, *layers, *kernel, *spikes;
};

/* Names cut from a list, and where each layer's planes are among the frame's. */
struct names {
	int n;
	char *text;
	const char *name[LAYERS];
};

struct job {
	struct gd_cli cli;
	struct options opt;
	struct gd_image im;
	struct names features, layers;
	struct gd_apr_conf conf;
	enum gd_apr_spike_mode spikes;
	struct gd_apr_frame frame;
	struct gd_plane bin[GD_MAX_BINS][3];
	struct gd_plane est[GD_APR_RHS];
};

static int split(struct names *names, const char *list, struct gd_err *err)
{
	char *save = NULL;

	names->text = strdup(list);
	if (!names->text)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	for (char *s = strtok_r(names->text, ",", &save); s; s = strtok_r(NULL, ",", &save)) {
		if (names->n == LAYERS)
			return gd_fail(err, GD_EARG, "more than %d layers in '%s'", LAYERS, list);
		names->name[names->n++] = s;
	}
	return GD_OK;
}

/* Settings from options: those of the method, unless given. */
static int settle(struct job *job, struct gd_err *err)
{
	const struct options *opt = &job->opt;
	struct gd_apr_conf conf = GD_APR_DEFAULTS, paper = GD_APR_PAPER;

	job->conf = opt->paper ? paper : conf;
	if (opt->radius >= 0) {
		job->conf.radius = opt->radius;
		job->conf.step = opt->radius > 1 ? (opt->radius + 1) / 2 : 1;
	}
	if (opt->step == 0)
		return gd_fail(err, GD_EARG, "--step 0: expected at least 1");
	if (opt->step > 0)
		job->conf.step = opt->step;
	if (opt->order >= 0)
		job->conf.order_max = opt->order;
	if (opt->order_min >= 0)
		job->conf.order_min = opt->order_min;
	if (job->conf.order_min > job->conf.order_max)
		return gd_fail(err, GD_EARG, "--order-min %d is above --order %d", job->conf.order_min,
			       job->conf.order_max);
	if (job->conf.step > 2 * job->conf.radius + 1)
		return gd_fail(err, GD_EARG, "--step %d leaves gaps between windows of radius %d", job->conf.step,
			       job->conf.radius);
	if (!strcmp(opt->kernel, "gauss") || !strcmp(opt->kernel, "box"))
		job->conf.kernel = *opt->kernel == 'g' ? GD_APR_GAUSS : GD_APR_BOX;
	else
		return gd_fail(err, GD_EARG, "--kernel '%s': expected gauss or box", opt->kernel);
	if (!strcmp(opt->spikes, "return"))
		job->spikes = GD_SPIKES_RETURN;
	else if (!strcmp(opt->spikes, "drop"))
		job->spikes = GD_SPIKES_DROP;
	else if (!strcmp(opt->spikes, "keep"))
		job->spikes = GD_SPIKES_KEEP;
	else
		return gd_fail(err, GD_EARG, "--spikes '%s': expected return, drop or keep", opt->spikes);
	return GD_OK;
}

/* What a denoiser uses up and no later stage needs. */
static void drop_used(struct gd_image *im)
{
	static const char *const used[] = { "albedo", "N", "Z", "P", "ao", "feature", "dx", "dy" };

	gd_layer_want_variance(im, "", GD_DROP);
	for (size_t i = 0; i < sizeof used / sizeof *used; i++) {
		gd_layer_want_variance(im, used[i], GD_DROP);
		gd_layer_want(im, used[i], GD_DROP);
	}
	gd_family_want(im, "bin", GD_DROP);
	gd_family_want(im, "half", GD_DROP);
}

/* The features to use: those named, or all of the known ones that the file has. */
static int choose_features(struct job *job, struct gd_err *err)
{
	static const char *const known[] = { "albedo", "N", "Z", "P", "ao", "feature" };
	const char *list = job->opt.features;

	if (!strcmp(list, "none"))
		return GD_OK;
	if (strcmp(list, "auto"))
		return split(&job->features, list, err);
	for (size_t i = 0; i < sizeof known / sizeof *known; i++)
		if (gd_layer_find(&job->im, known[i]).n)
			job->features.name[job->features.n++] = known[i];
	return GD_OK;
}

/* Marks what is to be read and what is to go; names what is missing. */
static int choose_channels(struct job *job, struct gd_err *err)
{
	struct gd_image *im = &job->im;
	int rc;

	if (gd_layer_find(im, "").n != 3) {
		const char *missing = gd_image_find(im, "R") < 0 ? "R" : gd_image_find(im, "G") < 0 ? "G" : "B";

		return gd_fail(err, GD_ESHAPE, "no channel %s", missing);
	}
	rc = choose_features(job, err);
	if (rc == GD_OK && job->opt.layers)
		rc = split(&job->layers, job->opt.layers, err);
	if (rc != GD_OK)
		return rc;
	if (!job->opt.keep)
		drop_used(im);
	gd_layer_want(im, "", GD_READ);
	if (!gd_layer_want_variance(im, "", GD_READ) && gd_bins(im, "") > 1)
		for (int b = 0; b < gd_bins(im, ""); b++) {
			char name[32];

			snprintf(name, sizeof name, "bin%d", b);
			gd_layer_want(im, name, GD_READ);
		}
	gd_layer_want(im, "half0", GD_READ);
	gd_layer_want(im, "half1", GD_READ);
	for (int i = 0; i < job->features.n; i++) {
		if (!gd_layer_want(im, job->features.name[i], GD_READ))
			return gd_fail(err, GD_ESHAPE, "no feature layer %s", job->features.name[i]);
		gd_layer_want_variance(im, job->features.name[i], GD_READ);
	}
	for (int i = 0; i < job->layers.n; i++)
		if (!gd_layer_want(im, job->layers.name[i], GD_READ))
			return gd_fail(err, GD_ESHAPE, "no layer %s", job->layers.name[i]);
	return GD_OK;
}

/* Views of what was read, in the order the library takes. */
static int fill_frame(struct job *job, struct gd_err *err)
{
	struct gd_apr_frame *f = &job->frame;
	struct gd_image *im = &job->im;

	f->ny = gd_layer_planes(im, "", f->y);
	gd_layer_planes(im, "half0", f->half[0]);
	gd_layer_planes(im, "half1", f->half[1]);
	for (int i = 0; i < job->layers.n; i++) {
		if (f->ny + GD_LAYER_PLANES > GD_APR_RHS)
			return gd_fail(err, GD_EARG, "more than %d channels to denoise", GD_APR_RHS);
		f->ny += gd_layer_planes(im, job->layers.name[i], f->y + f->ny);
	}
	if (!gd_layer_variance_planes(im, "", f->var)) {
		f->bin = job->bin;
		for (int b = 0; b < gd_bins(im, ""); b++) {
			char name[32];

			snprintf(name, sizeof name, "bin%d", b);
			f->nbin += gd_layer_planes(im, name, job->bin[b]) == 3;
		}
	}
	for (int i = 0; i < job->features.n; i++) {
		const char *name = job->features.name[i];
		int n;

		if (f->nfeat + GD_LAYER_PLANES > GD_APR_FEATURES)
			return gd_fail(err, GD_EARG, "more than %d feature planes", GD_APR_FEATURES);
		n = gd_layer_planes(im, name, f->feat + f->nfeat);
		gd_layer_variance_planes(im, name, f->feat_var + f->nfeat);
		for (int k = 0; k < n; k++) {
			f->layer[f->nfeat] = i;
			f->filtered[f->nfeat++] = job->opt.no_filter || !strcmp(name, "feature");
		}
	}
	return GD_OK;
}

static int new_planes(struct job *job, struct gd_err *err)
{
	for (int c = 0; c < job->frame.ny; c++) {
		float *v = gd_alloc(gd_stride(job->im.w) * (size_t)job->im.h, sizeof *v);

		if (!v)
			return gd_fail(err, GD_ENOMEM, "out of memory");
		job->est[c] = gd_plane_of(v, job->im.w, job->im.h);
	}
	return GD_OK;
}

static int denoise(struct job *job, struct gd_err *err)
{
	const struct gd_report *report = &job->cli.report;
	struct gd_apr_frame *f = &job->frame;
	struct gd_plane mse[GD_LAYER_PLANES];
	struct gd_apr_out out = { .est = job->est, .mse = mse };
	struct gd_apr_paper_result result;
	int rc = new_planes(job, err);

	if (rc == GD_OK)
		rc = gd_layer_add(&job->im, "error", 3, mse, err);
	if (rc == GD_OK)
		rc = gd_image_add(&job->im, "model.order", &out.order, err);
	if (rc == GD_OK)
		rc = gd_image_add(&job->im, "model.columns", &out.columns, err);
	for (int i = 0; i < job->features.n; i++)
		gd_note(report, "feature %s", job->features.name[i]);
	gd_note(report, "windows of %dx%d every %d pixels, orders %d to %d", 2 * job->conf.radius + 1,
		2 * job->conf.radius + 1, job->conf.step, job->conf.order_min, job->conf.order_max);
	if (rc == GD_OK)
		rc = gd_apr_paper(&out, f, &job->conf, job->spikes, &result, report, err);
	if (rc != GD_OK)
		return rc;
	for (int c = 0; c < f->ny; c++)
		for (int y = 0; y < f->y[c].h; y++)
			memcpy(gd_row(f->y[c], y), gd_row(job->est[c], y), (size_t)f->y[c].w * sizeof(float));
	gd_note(report, "noise of neighbours: %.2f times the variance of independent pixels", result.correlation);
	gd_note(report, "%d spikes, %d of them too bright to give all of it back", result.spikes, result.capped);
	if (result.mended)
		gd_cli_warn(&job->cli, "%zu values that were NaN or Inf were filled in", result.mended);
	gd_cli_stat(&job->cli, "spikes", result.spikes);
	gd_cli_stat(&job->cli, "mended", (double)result.mended);
	return GD_OK;
}

/* Removes a layer and its variances from the image. */
static void drop_layer(struct gd_image *im, const char *layer, bool values)
{
	struct gd_layer variance = gd_layer_variance(im, layer), found = gd_layer_find(im, layer);

	for (int i = 0; i < variance.n; i++)
		gd_image_drop(im, variance.name[i]);
	for (int i = 0; i < found.n && values; i++)
		gd_image_drop(im, found.name[i]);
}

/* What was read only to be used. */
static void drop_read(struct job *job)
{
	char name[32];

	drop_layer(&job->im, "", false);
	for (int i = 0; i < job->features.n; i++)
		drop_layer(&job->im, job->features.name[i], true);
	for (int b = 0; b < job->frame.nbin; b++) {
		snprintf(name, sizeof name, "bin%d", b);
		drop_layer(&job->im, name, true);
	}
	drop_layer(&job->im, "half0", true);
	drop_layer(&job->im, "half1", true);
}

static int run(struct job *job, struct gd_err *err)
{
	struct gd_exr *file;
	int rc = settle(job, err);

	if (rc != GD_OK)
		return rc;
	rc = gd_cli_open(&job->cli, &file, &job->im, job->cli.input, err);
	if (rc != GD_OK)
		return rc;
	rc = choose_channels(job, err);
	if (rc != GD_OK) {
		gd_exr_close(file);
		return rc;
	}
	rc = gd_cli_load(&job->cli, file, &job->im, err);
	if (rc == GD_OK)
		rc = fill_frame(job, err);
	if (rc == GD_OK)
		rc = denoise(job, err);
	if (rc == GD_OK && !job->opt.keep)
		drop_read(job);
	return rc == GD_OK ? gd_cli_write(&job->cli, &job->im, err) : rc;
}

int main(int argc, char **argv)
{
	struct job job = { .opt = { .radius = -1, .step = -1, .order_min = -1, .order = -1, .features = "auto",
				    .kernel = "gauss", .spikes = "return" } };
	struct options *opt = &job.opt;
	const struct gd_opt opts[] = {
		GD_FLAG(0, "paper", &opt->paper, "the method as published: 43x43 windows, one model"),
		GD_OPT('f', "features", "LIST", &opt->features, "layers to explain the image by, or auto, or none"),
		GD_OPT('l', "layers", "LIST", &opt->layers, "layers to denoise along with the colour, alike"),
		GD_NUM('r', "radius", "PIXELS", &opt->radius, -1, GD_APR_RADIUS, "windows of 2r+1 pixels; -1: the method's own"),
		GD_NUM(0, "step", "PIXELS", &opt->step, -1, 2 * GD_APR_RADIUS + 1, "distance of window centres; -1: half the radius"),
		GD_NUM(0, "order", "K", &opt->order, -1, GD_APR_ORDER, "largest order of the polynomial; -1: 3"),
		GD_NUM(0, "order-min", "K", &opt->order_min, -1, GD_APR_ORDER, "smallest order of the polynomial; -1: 0"),
		GD_OPT(0, "kernel", "NAME", &opt->kernel, "weights in a window: gauss or box"),
		GD_OPT(0, "spikes", "WHAT", &opt->spikes, "return, drop or keep the energy of single bright pixels"),
		GD_FLAG(0, "no-filter", &opt->no_filter, "take noisy features as they are"),
		GD_FLAG(0, "keep", &opt->keep, "write features, variances, bins and gradients too"),
		GD_OPT_END
	};
	const struct gd_cmd cmd = { .name = "gdapr", .operands = "[input.exr [output.exr]]",
				    .summary = "denoise by local regression on features", .opts = opts,
				    .min_operands = 0, .max_operands = 2, .filter = true };
	struct gd_err err = { 0 };
	int rc;

	gd_cli_parse(&job.cli, &cmd, argc, argv);
	rc = run(&job, &err);
	for (int c = 0; c < GD_APR_RHS; c++)
		free(job.est[c].v);
	free(job.features.text);
	free(job.layers.text);
	gd_image_free(&job.im);
	return gd_cli_finish(&job.cli, rc, &err);
}
