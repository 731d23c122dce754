/* SPDX-License-Identifier: BSD-3-Clause */
#include "denoise.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apr_prep.h"
#include "crossfit.h"

#define LAYERS 48	/* most layers of features, or to denoise along with the colour */
#define COPIES (2 * GD_APR_FEATURES + 2 * GD_APR_RHS + 16)

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
	int bins;		/* of the colour */
	double share[2];	/* of the samples, in either half */
	bool layer_halves;	/* all layers come in halves (or bins), as the colour does */
	int ncopy;
	float **copy;		/* of planes that stay as they were read, COPIES of them */
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

/* A feature of all samples beside halves of the colour: it knows the very noise it is to remove. */
static bool knows_noise(const struct job *job, const char *feature)
{
	return crossfit(job) && job->source != NO_HALVES && !strcmp(feature, "feature") &&
	       !crossed(job, feature);
}

/* The halves of a crossed feature are enough: what all samples say is not read. */
static bool has_feature(const struct job *job, const char *layer)
{
	return crossed(job, layer) || gd_layer_find(job->im, layer).n;
}

/*
 * Lists the features: those named, or the known ones that the file has but for P: with depth,
 * normal and the polynomial of the pixel position there, world positions did not lower any error
 * measured (by 1 %, either way).
 */
static int choose_features(struct job *job, struct gd_err *err)
{
	const char *list = job->conf->features;

	if (!strcmp(list, "none"))
		return GD_OK;
	if (strcmp(list, "auto"))
		return split(&job->features, list, err);
	for (size_t i = 0; i < sizeof known / sizeof *known; i++)
		if (strcmp(known[i], "P") != 0 && has_feature(job, known[i]) &&
		    !knows_noise(job, known[i]))
			job->features.name[job->features.n++] = known[i];
	return GD_OK;
}

/* No layer twice, and none that is a feature, too: either is changed in place. */
static int check_layers(const struct job *job, struct gd_err *err)
{
	for (int i = 0; i < job->layers.n; i++) {
		const char *layer = job->layers.name[i];

		if (!gd_layer_find(job->im, layer).n)
			return gd_fail(err, GD_ESHAPE, "no layer %s", layer);
		for (int k = 0; k < i; k++)
			if (!strcmp(layer, job->layers.name[k]))
				return gd_fail(err, GD_EARG, "layer %s is named twice", layer);
		for (int k = 0; k < job->features.n; k++)
			if (!strcmp(layer, job->features.name[k]))
				return gd_fail(err, GD_EARG,
					       "layer %s is a feature: it cannot be denoised, too",
					       layer);
	}
	return GD_OK;
}

/*
 * Where the halves are, and how much they hold: the even and the odd ones of an odd number of bins
 * are not as many.
 */
static void choose_source(struct job *job)
{
	const struct gd_image *im = job->im;
	char name[256];
	double bins = 0;

	while (job->bins < GD_MAX_BINS &&
	       gd_layer_find(im, part_name(name, "bin", job->bins, "")).n == 3)
		job->bins++;
	job->source = has_halves(im, "", 3) ? HALVES : job->bins >= 2 ? BINS : NO_HALVES;
	if (job->source == BINS || !gd_attr_number(im, "gd:bins", &bins))
		bins = job->bins;
	bins = bins >= 2 && bins <= GD_MAX_BINS ? floor(bins) : 2;
	job->share[0] = ceil(bins / 2) / bins;
	job->share[1] = 1 - job->share[0];
}

/* Whether all layers have the parts that the colour has. */
static bool layers_have_halves(const struct job *job)
{
	bool all = true;
	char name[256];

	for (int i = 0; i < job->layers.n; i++) {
		const char *layer = job->layers.name[i];
		int n = gd_layer_find(job->im, layer).n;

		if (job->source == HALVES)
			all = all && has_halves(job->im, layer, n);
		for (int b = 0; b < job->bins && job->source == BINS; b++)
			all = all &&
			      gd_layer_find(job->im, part_name(name, "bin", b, layer)).n == n;
	}
	return all;
}

static int choose(struct job *job, struct gd_err *err)
{
	const struct gd_image *im = job->im;
	int rc;

	if (gd_layer_find(im, "").n != 3) {
		const char *missing = gd_image_find(im, "R") < 0 ? "R" :
				      gd_image_find(im, "G") < 0 ? "G" : "B";

		return gd_fail(err, GD_ESHAPE, "no channel %s", missing);
	}
	choose_source(job);
	rc = choose_features(job, err);
	if (rc == GD_OK && job->conf->layers)
		rc = split(&job->layers, job->conf->layers, err);
	for (int i = 0; i < job->features.n && rc == GD_OK; i++)
		if (!has_feature(job, job->features.name[i]))
			rc = gd_fail(err, GD_ESHAPE, "no feature layer %s", job->features.name[i]);
	if (rc == GD_OK)
		rc = check_layers(job, err);
	job->layer_halves = rc == GD_OK && layers_have_halves(job);
	return rc;
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

		for (int h = 0; h < 2 && crossed(job, name); h++)
			gd_layer_want(im, part_name(part, "half", h, name), GD_READ);
		if (!crossed(job, name)) {
			gd_layer_want(im, name, GD_READ);
			gd_layer_want_variance(im, name, GD_READ);
		}
	}
	for (int i = 0; i < job->layers.n; i++) {
		gd_layer_want(im, job->layers.name[i], GD_READ);
		if (job->layer_halves && crossfit(job))
			want_parts(job, job->layers.name[i], GD_READ);
	}
}

static void free_job(struct job *job)
{
	for (int i = 0; i < job->ncopy; i++)
		free(job->copy[i]);
	free(job->copy);
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

static int new_planes(struct gd_plane *p, int n, struct gd_plane like, struct gd_err *err)
{
	size_t size = gd_stride(like.w) * (size_t)like.h;

	for (int c = 0; c < n; c++) {
		p[c] = gd_plane_of(gd_alloc(size, sizeof(float)), like.w, like.h);
		if (!p[c].v)
			return gd_fail(err, GD_ENOMEM, "out of memory");
	}
	return GD_OK;
}

static void copy_planes(struct gd_plane *to, const struct gd_plane *from, int n)
{
	for (int c = 0; c < n; c++)
		for (int y = 0; y < to[c].h; y++)
			memcpy(gd_row(to[c], y), gd_row(from[c], y),
			       (size_t)to[c].w * sizeof(float));
}

/*
 * Planes that are going to be mended, filtered or scaled in place: copies of them where the
 * image's are to stay.
 */
static int own(struct job *job, struct gd_plane *p, int n, struct gd_err *err)
{
	int rc = GD_OK;

	for (int c = 0; c < n && job->conf->keep && rc == GD_OK; c++) {
		struct gd_plane from = p[c];

		rc = new_planes(p + c, 1, from, err);
		if (rc == GD_OK) {
			copy_planes(p + c, &from, 1);
			job->copy[job->ncopy++] = p[c].v;
		}
	}
	return rc;
}

static int fill_features(struct job *job, struct gd_apr_frame *f, struct gd_err *err)
{
	const int most = crossfit(job) ? GD_CROSSFIT_FEATURES : GD_APR_FEATURES;
	int rc = GD_OK;

	for (int i = 0; i < job->features.n && rc == GD_OK; i++) {
		const char *name = job->features.name[i];
		struct gd_plane feat[GD_LAYER_PLANES], var[GD_LAYER_PLANES] = { 0 };
		int n = gd_layer_find(job->im, name).n;

		if (crossed(job, name))
			continue;
		if (f->nfeat + n > most)
			return gd_fail(err, GD_EARG, "more than %d feature planes", most);
		n = gd_layer_planes(job->im, name, feat);
		rc = own(job, feat, n, err);
		if (rc == GD_OK)
			rc = own(job, var, gd_layer_variance_planes(job->im, name, var), err);
		for (int k = 0; k < n; k++) {
			f->feat[f->nfeat] = feat[k];
			f->feat_var[f->nfeat] = var[k];
			f->layer[f->nfeat] = i;
			f->filtered[f->nfeat++] = job->conf->no_filter || !strcmp(name, "feature");
		}
	}
	return rc;
}

/* The whole image: colour, layers, and what they are judged by. */
static int fill_frame(struct job *job, struct gd_apr_frame *f, struct gd_plane (*bin)[3],
		      struct gd_err *err)
{
	const struct gd_image *im = job->im;
	struct gd_plane plane[GD_LAYER_PLANES];
	char name[256];
	int rc;

	f->ny = gd_layer_planes(im, "", f->y);
	for (int i = 0; i < job->layers.n; i++) {
		if (f->ny + GD_LAYER_PLANES > GD_APR_RHS)
			return gd_fail(err, GD_EARG, "more than %d channels to denoise",
				       GD_APR_RHS);
		f->ny += gd_layer_planes(im, job->layers.name[i], f->y + f->ny);
	}
	for (int h = 0; h < 2 && job->source == HALVES; h++)
		gd_layer_planes(im, part_name(name, "half", h, ""), f->half[h]);
	rc = own(job, f->var, gd_layer_variance_planes(im, "", f->var), err);
	if (rc == GD_OK && !f->var[0].v && job->bins >= 2) {
		f->bin = bin;
		for (int b = 0; b < job->bins; b++)
			if (gd_layer_planes(im, part_name(name, "bin", b, ""), plane) == 3)
				memcpy(bin[f->nbin++], plane, sizeof *bin);
	}
	return rc == GD_OK ? fill_features(job, f, err) : rc;
}

static void release(struct gd_image *im, const char *layer)
{
	struct gd_layer found = gd_layer_find(im, layer);

	for (int i = 0; i < found.n; i++)
		gd_image_drop(im, found.name[i]);
}

static void release_variance(struct gd_image *im, const char *layer)
{
	struct gd_layer found = gd_layer_variance(im, layer);

	for (int i = 0; i < found.n; i++)
		gd_image_drop(im, found.name[i]);
}

/* to += (from - to) / n: takes the n-th plane into a mean. */
static void add_to_mean(struct gd_plane to, struct gd_plane from, int n)
{
#pragma omp parallel for schedule(static)
	for (int y = 0; y < to.h; y++) {
		const float *restrict v = gd_row(from, y);
		float *restrict mean = gd_row(to, y);

		for (int x = 0; x < to.w; x++)
			mean[x] = (float)(((double)mean[x] * (n - 1) + (double)v[x]) / n);
	}
}

/* Adds the bins from the third on to the means of the even and the odd ones, and frees them. */
static void add_bins(struct job *job, const char *layer, struct gd_plane *const half[2])
{
	struct gd_plane bin[GD_LAYER_PLANES];
	char name[256];

	for (int b = 2; b < job->bins; b++) {
		int n = gd_layer_planes(job->im, part_name(name, "bin", b, layer), bin);

		for (int c = 0; c < n; c++)
			add_to_mean(half[b % 2][c], bin[c], b / 2 + 1);
		if (!job->conf->keep)
			release(job->im, name);
	}
}

/* Both halves of a layer; a and b have room for GD_LAYER_PLANES. Their number goes to *n. */
static int half_planes(struct job *job, const char *layer, struct gd_plane *a, struct gd_plane *b,
		       int *n, struct gd_err *err)
{
	const char *part = job->source == BINS ? "bin" : "half";
	struct gd_plane *const half[2] = { a, b };
	char name[256];
	int rc = GD_OK;

	for (int h = 0; h < 2 && rc == GD_OK; h++) {
		*n = gd_layer_planes(job->im, part_name(name, part, h, layer), half[h]);
		rc = own(job, half[h], *n, err);
	}
	if (rc == GD_OK && job->source == BINS)
		add_bins(job, layer, half);
	return rc;
}

/* ---- the two ways ---- */

/* Fills in the halves: colour and layers, and the crossed features. */
static int fill_halves(struct job *job, struct gd_crossfit_in *in, size_t *mended,
		       struct gd_err *err)
{
	int n, rc = half_planes(job, "", in->y[0], in->y[1], &in->ny, err);

	for (int i = 0; i < job->layers.n && job->layer_halves && rc == GD_OK; i++) {
		rc = half_planes(job, job->layers.name[i], in->y[0] + in->ny, in->y[1] + in->ny, &n,
				 err);
		in->ny += n;
	}
	for (int h = 0; h < 2; h++) {
		char name[256];

		for (int i = 0; i < job->features.n && rc == GD_OK; i++) {
			if (!crossed(job, job->features.name[i]))
				continue;
			part_name(name, "half", h, "feature");
			in->nfeature = gd_layer_planes(job->im, name, in->feature[h]);
			rc = own(job, in->feature[h], in->nfeature, err);
		}
		for (int c = 0; c < in->ny && rc == GD_OK; c++)
			rc = gd_apr_clean(in->y[h][c], (struct gd_plane){ 0 }, mended, err);
		for (int c = 0; c < in->nfeature && rc == GD_OK; c++)
			rc = gd_apr_clean(in->feature[h][c], (struct gd_plane){ 0 }, mended, err);
	}
	return rc;
}

/* Mends and filters what both halves share, into in; feature variances are done with then. */
static int prepare(struct job *job, struct gd_apr_frame *f, struct gd_crossfit_in *in,
		   float *made[3], size_t *mended, const struct gd_report *report,
		   struct gd_err *err)
{
	/* Two bins know no more of the variance than their difference, which is used anyway. */
	bool find = f->var[0].v || job->source == NO_HALVES || (f->nbin > 2 && job->source == BINS);
	int rc = gd_apr_frame_mend(f, find ? made : NULL, mended, report, err);

	if (rc == GD_OK)
		rc = gd_apr_frame_filter(f, report, err);
	for (int i = 0; i < job->features.n && !job->conf->keep; i++)
		release_variance(job->im, job->features.name[i]);
	memset(f->feat_var, 0, sizeof f->feat_var);
	in->self = job->source == NO_HALVES;
	if (in->self) {
		in->ny = f->ny;
		memcpy(in->y[0], f->y, sizeof f->y);
	} else if (rc == GD_OK) {
		rc = fill_halves(job, in, mended, err);
	}
	if (!in->self && !job->layer_halves) {
		in->nwhole = f->ny;
		memcpy(in->whole, f->y, sizeof f->y);
	}
	in->nfeat = f->nfeat;
	memcpy(in->feat, f->feat, sizeof in->feat);
	memcpy(in->var, f->var, sizeof in->var);
	memcpy(in->share, job->share, sizeof in->share);
	return rc;
}

/* The colour of all samples is no more needed, unless it is what is regressed: the result's place. */
static int run_crossfit(struct job *job, struct gd_apr_frame *f, struct gd_plane *mse,
			struct gd_denoise_result *result, const struct gd_report *report,
			struct gd_err *err)
{
	const bool in_place = job->layer_halves && job->source != NO_HALVES;
	struct gd_plane made_est[GD_APR_RHS] = { 0 };
	struct gd_crossfit_out out = { .est = in_place ? f->y : made_est, .mse = mse };
	struct gd_crossfit_conf conf = { .fast = job->conf->fast };
	struct gd_crossfit_result cross = { 0 };
	struct gd_crossfit_in *in = gd_calloc(1, sizeof *in);
	float *made[3] = { 0 };
	double start = gd_seconds();
	int rc = in ? GD_OK : gd_fail(err, GD_ENOMEM, "out of memory");

	if (rc == GD_OK)
		rc = prepare(job, f, in, made, &result->mended, report, err);
	result->filter_seconds = gd_seconds() - start;
	if (rc == GD_OK && !conf.fast)
		rc = gd_image_add(job->im, "model.spread", &out.spread, err);
	if (rc == GD_OK && !in_place)
		rc = new_planes(made_est, f->ny, f->y[0], err);
	if (rc == GD_OK)
		rc = gd_crossfit_run(&out, in, &conf, &cross, report, err);
	if (rc == GD_OK && !in_place)
		copy_planes(f->y, made_est, f->ny);
	if (rc == GD_OK)
		gd_note(report, "%d %sregression%s%s; brightest pixels times %.4f to keep the mean",
			cross.models, in->self ? "" : "cross-fitted ", cross.models > 1 ? "s" : "",
			in->self ? "" : " of either half", cross.gain);
	result->models = cross.models;
	result->pilot_seconds = cross.pilot_seconds;
	result->fit_seconds = cross.fit_seconds;
	for (int c = 0; c < GD_APR_RHS; c++)
		free(made_est[c].v);
	for (int c = 0; c < 3; c++)
		free(made[c]);
	free(in);
	return rc;
}

static int run_single(struct job *job, struct gd_apr_frame *f, struct gd_plane *mse,
		      struct gd_denoise_result *result, const struct gd_report *report,
		      struct gd_err *err)
{
	struct gd_plane est[GD_APR_RHS] = { 0 };
	struct gd_apr_out out = { .est = est, .mse = mse };
	struct gd_apr_paper_result paper;
	const struct gd_apr_conf *apr = &job->conf->apr;
	double start = gd_seconds();
	int rc = new_planes(est, f->ny, f->y[0], err);

	if (rc == GD_OK)
		rc = gd_image_add(job->im, "model.order", &out.order, err);
	if (rc == GD_OK)
		rc = gd_image_add(job->im, "model.columns", &out.columns, err);
	gd_note(report, "one regression in windows of %dx%d every %d pixels, orders %d to %d",
		2 * apr->radius + 1, 2 * apr->radius + 1, apr->step, apr->order_min,
		apr->order_max);
	if (rc == GD_OK)
		rc = gd_apr_paper(&out, f, apr, job->conf->spikes, &paper, report, err);
	if (rc == GD_OK) {
		gd_note(report,
			"noise of neighbours: %.2f times the variance of independent pixels",
			paper.correlation);
		gd_note(report, "%d spikes, %d of them too bright to give all of it back",
			paper.spikes, paper.capped);
		copy_planes(f->y, est, f->ny);
		result->mended = paper.mended;
		result->spikes = paper.spikes;
		result->models = 1;
	}
	result->fit_seconds = gd_seconds() - start;
	for (int c = 0; c < GD_APR_RHS; c++)
		free(est[c].v);
	return rc;
}

/* ---- all of it ---- */

/* What was read only to be used. */
static void drop_read(struct job *job)
{
	char name[256];

	release_variance(job->im, "");
	for (int i = 0; i < job->features.n; i++) {
		release_variance(job->im, job->features.name[i]);
		release(job->im, job->features.name[i]);
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

static int run(struct job *job, struct gd_apr_frame *f, struct gd_plane (*bin)[3],
	       struct gd_denoise_result *result, const struct gd_report *report, struct gd_err *err)
{
	struct gd_plane mse[GD_LAYER_PLANES];
	int rc = fill_frame(job, f, bin, err);

	if (rc == GD_OK)
		rc = gd_layer_add(job->im, "error", 3, mse, err);
	if (rc != GD_OK)
		return rc;
	for (int i = 0; i < job->features.n; i++)
		gd_note(report, "feature %s%s", job->features.name[i],
			crossed(job, job->features.name[i]) ? ", of either half" : "");
	result->crossfit = crossfit(job);
	return crossfit(job) ? run_crossfit(job, f, mse, result, report, err) :
			       run_single(job, f, mse, result, report, err);
}

int gd_denoise_run(struct gd_image *im, const struct gd_denoise_conf *conf,
		   struct gd_denoise_result *result, const struct gd_report *report,
		   struct gd_err *err)
{
	struct job job = { .im = im, .conf = conf };
	struct gd_apr_frame *f = gd_calloc(1, sizeof *f);
	struct gd_plane (*bin)[3] = gd_calloc(GD_MAX_BINS, sizeof *bin);
	int rc = GD_OK;

	*result = (struct gd_denoise_result){ 0 };
	job.copy = gd_calloc(COPIES, sizeof *job.copy);
	if (!f || !bin || !job.copy)
		rc = gd_fail(err, GD_ENOMEM, "out of memory");
	if (rc == GD_OK)
		rc = choose(&job, err);
	if (rc == GD_OK)
		rc = run(&job, f, bin, result, report, err);
	if (rc == GD_OK && !conf->keep)
		drop_read(&job);
	free(bin);
	free(f);
	free_job(&job);
	return rc;
}
