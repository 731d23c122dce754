/* SPDX-License-Identifier: BSD-3-Clause */
#include "denoise.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apr_prep.h"
#include "crossfit.h"

#define LAYERS 48	/* most layers of features, or to denoise along with the colour */

static const char *const known[] = { "albedo", "N", "Z", "P", "ao", "feature" };

/* Names cut from a list. */
struct names {
	int n;
	char *text;
	const char *name[LAYERS];
};

/* Where the independent halves of the samples are. */
enum source { NO_HALVES, HALVES, BINS };

struct job {
	struct gd_image *im;
	const struct gd_denoise_conf *conf;
	struct names features, layers;
	enum source source;
	int bins;		/* of the colour, with source BINS */
	bool layer_halves;	/* all layers come in halves (or bins), as the colour does */
};

/* ---- which channels ---- */

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

/* "half0.diffuse", "bin3", ...: the share of a layer ("": the colour) in half or bin i. */
static const char *part_name(char name[256], const char *part, int i, const char *layer)
{
	snprintf(name, 256, *layer ? "%s%d.%s" : "%s%d", part, i, layer);
	return name;
}

static bool has_halves(const struct gd_image *im, const char *layer, int n)
{
	char name[256];

	return gd_layer_find(im, part_name(name, "half", 0, layer)).n == n &&
	       gd_layer_find(im, part_name(name, "half", 1, layer)).n == n;
}

/*
 * Lists the features: those named, or the known ones that the file has but for P: with depth, normal and the
 * polynomial of the pixel position there, world positions did not lower any error measured (by 1 %, either way).
 */
static int choose_features(struct job *job, struct gd_err *err)
{
	const char *list = job->conf->features;

	if (!strcmp(list, "none"))
		return GD_OK;
	if (strcmp(list, "auto"))
		return split(&job->features, list, err);
	for (size_t i = 0; i < sizeof known / sizeof *known; i++)
		if (strcmp(known[i], "P") != 0 && gd_layer_find(job->im, known[i]).n)
			job->features.name[job->features.n++] = known[i];
	return GD_OK;
}

static int choose(struct job *job, struct gd_err *err)
{
	const struct gd_image *im = job->im;
	char name[256];
	int rc;

	if (gd_layer_find(im, "").n != 3) {
		const char *missing = gd_image_find(im, "R") < 0 ? "R" : gd_image_find(im, "G") < 0 ? "G" : "B";

		return gd_fail(err, GD_ESHAPE, "no channel %s", missing);
	}
	rc = choose_features(job, err);
	if (rc == GD_OK && job->conf->layers)
		rc = split(&job->layers, job->conf->layers, err);
	for (int i = 0; i < job->features.n && rc == GD_OK; i++)
		if (!gd_layer_find(im, job->features.name[i]).n)
			rc = gd_fail(err, GD_ESHAPE, "no feature layer %s", job->features.name[i]);
	for (int i = 0; i < job->layers.n && rc == GD_OK; i++)
		if (!gd_layer_find(im, job->layers.name[i]).n)
			rc = gd_fail(err, GD_ESHAPE, "no layer %s", job->layers.name[i]);
	if (rc != GD_OK)
		return rc;
	job->bins = gd_bins(im, "");
	job->source = has_halves(im, "", 3) ? HALVES : job->bins >= 2 ? BINS : NO_HALVES;
	job->layer_halves = true;
	for (int i = 0; i < job->layers.n; i++) {
		const char *layer = job->layers.name[i];
		int n = gd_layer_find(im, layer).n;

		if (job->source == HALVES)
			job->layer_halves = job->layer_halves && has_halves(im, layer, n);
		for (int b = 0; b < job->bins && job->source == BINS; b++)
			job->layer_halves = job->layer_halves &&
					    gd_layer_find(im, part_name(name, "bin", b, layer)).n == n;
	}
	return GD_OK;
}

/* Marks the halves or bins of a layer. */
static void want_parts(struct job *job, const char *layer, enum gd_want want)
{
	char name[256];

	for (int h = 0; h < 2 && job->source == HALVES; h++)
		gd_layer_want(job->im, part_name(name, "half", h, layer), want);
	for (int b = 0; b < job->bins && job->source == BINS; b++)
		gd_layer_want(job->im, part_name(name, "bin", b, layer), want);
}

static bool crossfit(const struct job *job)
{
	return !job->conf->single;
}

/* A feature whose halves know different noise: cross-fitted rather than taken from all samples. */
static bool crossed(const struct job *job, const char *feature)
{
	return crossfit(job) && job->source != NO_HALVES && !strcmp(feature, "feature") &&
	       has_halves(job->im, feature, 3);
}

/* What a denoiser uses up and no later stage needs. */
static void drop_used(struct gd_image *im)
{
	gd_layer_want_variance(im, "", GD_DROP);
	for (size_t i = 0; i < sizeof known / sizeof *known; i++) {
		gd_layer_want_variance(im, known[i], GD_DROP);
		gd_layer_want(im, known[i], GD_DROP);
	}
	gd_layer_want_variance(im, "dx", GD_DROP);
	gd_layer_want_variance(im, "dy", GD_DROP);
	gd_layer_want(im, "dx", GD_DROP);
	gd_layer_want(im, "dy", GD_DROP);
	gd_family_want(im, "bin", GD_DROP);
	gd_family_want(im, "half", GD_DROP);
}

static void mark(struct job *job)
{
	struct gd_image *im = job->im;
	bool variance;

	if (!job->conf->keep)
		drop_used(im);
	gd_layer_want(im, "", GD_READ);
	variance = gd_layer_want_variance(im, "", GD_READ) == 3;
	if (job->source == HALVES || crossfit(job) || !variance)
		want_parts(job, "", GD_READ);
	for (int i = 0; i < job->features.n; i++) {
		const char *name = job->features.name[i];
		char part[256];

		gd_layer_want(im, name, GD_READ);
		gd_layer_want_variance(im, name, GD_READ);
		for (int h = 0; h < 2 && crossed(job, name); h++)
			gd_layer_want(im, part_name(part, "half", h, name), GD_READ);
	}
	for (int i = 0; i < job->layers.n; i++) {
		gd_layer_want(im, job->layers.name[i], GD_READ);
		if (job->layer_halves && crossfit(job))
			want_parts(job, job->layers.name[i], GD_READ);
	}
}

static void free_job(struct job *job)
{
	free(job->features.text);
	free(job->layers.text);
}

int gd_denoise_want(struct gd_image *im, const struct gd_denoise_conf *conf, struct gd_err *err)
{
	struct job job = { .im = im, .conf = conf };
	int rc = choose(&job, err);

	if (rc == GD_OK)
		mark(&job);
	free_job(&job);
	return rc;
}

/* ---- planes ---- */

static int fill_features(struct job *job, struct gd_apr_frame *f, struct gd_err *err)
{
	for (int i = 0; i < job->features.n; i++) {
		const char *name = job->features.name[i];
		int n;

		if (crossed(job, name))
			continue;
		if (f->nfeat + GD_LAYER_PLANES > GD_APR_FEATURES)
			return gd_fail(err, GD_EARG, "more than %d feature planes", GD_APR_FEATURES);
		n = gd_layer_planes(job->im, name, f->feat + f->nfeat);
		gd_layer_variance_planes(job->im, name, f->feat_var + f->nfeat);
		for (int k = 0; k < n; k++) {
			f->layer[f->nfeat] = i;
			f->filtered[f->nfeat++] = job->conf->no_filter || !strcmp(name, "feature");
		}
	}
	return GD_OK;
}

/* The whole image: colour, layers, and what they are judged by. */
static int fill_frame(struct job *job, struct gd_apr_frame *f, struct gd_plane (*bin)[3], struct gd_err *err)
{
	const struct gd_image *im = job->im;
	char name[256];

	f->ny = gd_layer_planes(im, "", f->y);
	for (int i = 0; i < job->layers.n; i++) {
		if (f->ny + GD_LAYER_PLANES > GD_APR_RHS)
			return gd_fail(err, GD_EARG, "more than %d channels to denoise", GD_APR_RHS);
		f->ny += gd_layer_planes(im, job->layers.name[i], f->y + f->ny);
	}
	for (int h = 0; h < 2 && job->source == HALVES; h++)
		gd_layer_planes(im, part_name(name, "half", h, ""), f->half[h]);
	if (!gd_layer_variance_planes(im, "", f->var)) {
		memset(f->var, 0, sizeof f->var);
		f->bin = bin;
		for (int b = 0; b < job->bins; b++)
			f->nbin += gd_layer_planes(im, part_name(name, "bin", b, ""), bin[b]) == 3;
	}
	return fill_features(job, f, err);
}

static void release(struct gd_image *im, const char *layer)
{
	struct gd_layer found = gd_layer_find(im, layer);

	for (int i = 0; i < found.n; i++)
		gd_image_drop(im, found.name[i]);
}

/* Means of the even and the odd bins of a layer, put where bins 0 and 1 are; the other bins are freed. */
static void halve_bins(struct job *job, const char *layer)
{
	struct gd_plane half[2][GD_LAYER_PLANES], bin[GD_LAYER_PLANES];
	char name[256];
	int n = 0;

	for (int h = 0; h < 2; h++)
		n = gd_layer_planes(job->im, part_name(name, "bin", h, layer), half[h]);
	for (int b = 2; b < job->bins; b++) {
		gd_layer_planes(job->im, part_name(name, "bin", b, layer), bin);
		for (int c = 0; c < n; c++)
			for (int y = 0; y < bin[c].h; y++)
				for (int x = 0; x < bin[c].w; x++) {
					float *to = gd_row(half[b % 2][c], y) + x;
					int have = b / 2;

					*to = (float)(((double)*to * have + (double)gd_row(bin[c], y)[x]) / (have + 1));
				}
		if (!job->conf->keep)
			release(job->im, name);
	}
}

/* Views of both halves of a layer. */
static int half_planes(struct job *job, const char *layer, struct gd_plane *a, struct gd_plane *b)
{
	const char *part = job->source == BINS ? "bin" : "half";
	char name[256];

	if (job->source == BINS)
		halve_bins(job, layer);
	gd_layer_planes(job->im, part_name(name, part, 0, layer), a);
	return gd_layer_planes(job->im, part_name(name, part, 1, layer), b);
}

static int new_planes(struct gd_plane *p, int n, struct gd_plane like, struct gd_err *err)
{
	for (int c = 0; c < n; c++) {
		p[c] = gd_plane_of(gd_alloc(gd_stride(like.w) * (size_t)like.h, sizeof(float)), like.w, like.h);
		if (!p[c].v)
			return gd_fail(err, GD_ENOMEM, "out of memory");
	}
	return GD_OK;
}

static void copy_planes(struct gd_plane *to, const struct gd_plane *from, int n)
{
	for (int c = 0; c < n; c++)
		for (int y = 0; y < to[c].h; y++)
			memcpy(gd_row(to[c], y), gd_row(from[c], y), (size_t)to[c].w * sizeof(float));
}

/* ---- the two ways ---- */

static int run_single(struct job *job, struct gd_apr_frame *f, struct gd_plane *est, struct gd_plane *mse,
		      struct gd_denoise_result *result, const struct gd_report *report, struct gd_err *err)
{
	struct gd_apr_out out = { .est = est, .mse = mse };
	struct gd_apr_paper_result paper;
	const struct gd_apr_conf *apr = &job->conf->apr;
	double start = gd_seconds();
	int rc = gd_image_add(job->im, "model.order", &out.order, err);

	if (rc == GD_OK)
		rc = gd_image_add(job->im, "model.columns", &out.columns, err);
	gd_note(report, "windows of %dx%d every %d pixels, orders %d to %d", 2 * apr->radius + 1,
		2 * apr->radius + 1, apr->step, apr->order_min, apr->order_max);
	if (rc == GD_OK)
		rc = gd_apr_paper(&out, f, apr, job->conf->spikes, &paper, report, err);
	if (rc != GD_OK)
		return rc;
	gd_note(report, "noise of neighbours: %.2f times the variance of independent pixels", paper.correlation);
	gd_note(report, "%d spikes, %d of them too bright to give all of it back", paper.spikes, paper.capped);
	result->mended = paper.mended;
	result->spikes = paper.spikes;
	result->models = 1;
	result->fit_seconds = gd_seconds() - start;
	return GD_OK;
}

/* Fills in the halves: colour and layers, and the crossed features. */
static int fill_halves(struct job *job, struct gd_crossfit_in *in, struct gd_apr_frame *f, size_t *mended,
		       struct gd_err *err)
{
	char name[256];
	int rc = GD_OK;

	if (job->source == NO_HALVES) {
		in->self = true;
		in->ny = f->ny;
		memcpy(in->y[0], f->y, sizeof f->y);
		return GD_OK;	/* mended already */
	}
	if (job->layer_halves) {
		in->ny = half_planes(job, "", in->y[0], in->y[1]);
		for (int i = 0; i < job->layers.n; i++)
			in->ny += half_planes(job, job->layers.name[i], in->y[0] + in->ny, in->y[1] + in->ny);
	} else {
		in->ny = half_planes(job, "", in->y[0], in->y[1]);
		in->nwhole = f->ny;
		memcpy(in->whole, f->y, sizeof f->y);
	}
	for (int h = 0; h < 2; h++) {
		for (int c = 0; c < in->ny && rc == GD_OK; c++)
			rc = gd_apr_clean(in->y[h][c], (struct gd_plane){ 0 }, mended, err);
		for (int i = 0; i < job->features.n; i++)
			if (crossed(job, job->features.name[i]))
				in->nfeature = gd_layer_planes(job->im, part_name(name, "half", h, "feature"),
							       in->feature[h]);
		for (int c = 0; c < in->nfeature && rc == GD_OK; c++)
			rc = gd_apr_clean(in->feature[h][c], (struct gd_plane){ 0 }, mended, err);
	}
	return rc;
}

static int run_crossfit(struct job *job, struct gd_apr_frame *f, struct gd_plane *est, struct gd_plane *mse,
			struct gd_denoise_result *result, const struct gd_report *report, struct gd_err *err)
{
	struct gd_crossfit_out out = { est, mse };
	struct gd_crossfit_conf conf = { .fast = job->conf->fast };
	struct gd_crossfit_result cross;
	struct gd_crossfit_in *in = gd_calloc(1, sizeof *in);
	bool variance = f->var[0].v != NULL;
	float *made[3] = { 0 };
	double start = gd_seconds();
	int rc;

	if (!in)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	rc = gd_apr_frame_mend(f, made, &result->mended, report, err);
	if (rc == GD_OK)
		rc = gd_apr_frame_filter(f, report, err);
	result->filter_seconds = gd_seconds() - start;
	if (rc == GD_OK)
		rc = fill_halves(job, in, f, &result->mended, err);
	in->nfeat = f->nfeat;
	memcpy(in->feat, f->feat, sizeof in->feat);
	memcpy(in->var, f->var, sizeof in->var);
	if (!variance && job->source == HALVES)
		memset(in->var, 0, sizeof in->var);
	if (rc == GD_OK)
		rc = gd_crossfit_run(&out, in, &conf, &cross, report, err);
	if (rc == GD_OK) {
		gd_note(report, "%d cross-fitted regressions of either half averaged; brightest pixels times %.4f to keep the mean",
			cross.models, cross.gain);
		result->models = cross.models;
		result->pilot_seconds = cross.pilot_seconds;
		result->fit_seconds = cross.fit_seconds;
	}
	for (int c = 0; c < 3; c++)
		free(made[c]);
	free(in);
	return rc;
}

/* ---- all of it ---- */

/* Removes a layer's variances from the image, and the layer. */
static void drop_layer(struct gd_image *im, const char *layer, bool values)
{
	struct gd_layer variance = gd_layer_variance(im, layer);

	for (int i = 0; i < variance.n; i++)
		gd_image_drop(im, variance.name[i]);
	if (values)
		release(im, layer);
}

/* What was read only to be used. */
static void drop_read(struct job *job)
{
	char name[256];

	drop_layer(job->im, "", false);
	for (int i = 0; i < job->features.n; i++) {
		drop_layer(job->im, job->features.name[i], true);
		for (int h = 0; h < 2; h++)
			release(job->im, part_name(name, "half", h, job->features.name[i]));
	}
	for (int i = -1; i < job->layers.n; i++) {
		const char *layer = i < 0 ? "" : job->layers.name[i];

		for (int b = 0; b < job->bins; b++)
			release(job->im, part_name(name, "bin", b, layer));
		for (int h = 0; h < 2; h++)
			release(job->im, part_name(name, "half", h, layer));
	}
}

int gd_denoise_run(struct gd_image *im, const struct gd_denoise_conf *conf, struct gd_denoise_result *result,
		   const struct gd_report *report, struct gd_err *err)
{
	struct job job = { .im = im, .conf = conf };
	struct gd_apr_frame *f = gd_calloc(1, sizeof *f);
	struct gd_plane est[GD_APR_RHS] = { 0 }, mse[GD_LAYER_PLANES], (*bin)[3];
	int rc;

	*result = (struct gd_denoise_result){ 0 };
	bin = gd_calloc(GD_MAX_BINS, sizeof *bin);
	rc = f && bin ? choose(&job, err) : gd_fail(err, GD_ENOMEM, "out of memory");
	if (rc == GD_OK)
		rc = fill_frame(&job, f, bin, err);
	if (rc == GD_OK)
		rc = new_planes(est, f->ny, f->y[0], err);
	if (rc == GD_OK)
		rc = gd_layer_add(im, "error", 3, mse, err);
	for (int i = 0; i < job.features.n && rc == GD_OK; i++)
		gd_note(report, "feature %s%s", job.features.name[i],
			crossed(&job, job.features.name[i]) ? ", of either half" : "");
	result->crossfit = crossfit(&job);
	if (rc == GD_OK)
		rc = crossfit(&job) ? run_crossfit(&job, f, est, mse, result, report, err) :
				      run_single(&job, f, est, mse, result, report, err);
	if (rc == GD_OK)
		copy_planes(f->y, est, f->ny);
	if (rc == GD_OK && !conf->keep)
		drop_read(&job);
	for (int c = 0; c < GD_APR_RHS; c++)
		free(est[c].v);
	free(bin);
	free(f);
	free_job(&job);
	return rc;
}
