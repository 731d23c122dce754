/* SPDX-License-Identifier: BSD-3-Clause */
/* Which channels a denoiser reads, what they are to it, and what becomes of them. */
#include "denoise_job.h"

#include <ctype.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char *const known[] = { "albedo", "N", "Z", "P", "ao", "feature" };

static int split(struct denoise_names *names, const char *list, struct gd_err *err)
{
	char *save = NULL;

	names->text = strdup(list);
	if (!names->text)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	for (char *s = strtok_r(names->text, ",", &save); s; s = strtok_r(NULL, ",", &save)) {
		if (names->n == DENOISE_LAYERS)
			return gd_fail(err, GD_EARG, "more than %d layers in '%s'", DENOISE_LAYERS,
				       list);
		names->name[names->n++] = s;
	}
	return GD_OK;
}

/* "half0.diffuse", "bin3", ...: the share of a layer ("": the colour) in half or bin i. */
const char *gd_denoise_part(char name[256], const char *part, int i, const char *layer)
{
	snprintf(name, 256, *layer ? "%s%d.%s" : "%s%d", part, i, layer);
	return name;
}

static bool has_halves(const struct gd_image *im, const char *layer, int n)
{
	char name[256];

	return gd_layer_find(im, gd_denoise_part(name, "half", 0, layer)).n == n &&
	       gd_layer_find(im, gd_denoise_part(name, "half", 1, layer)).n == n;
}

bool gd_denoise_crossfit(const struct denoise_job *job)
{
	return job->conf->method == GD_DENOISE_CROSSFIT || job->conf->method == GD_DENOISE_LWR;
}

bool gd_denoise_follows(const struct denoise_job *job)
{
	return job->conf->sequence ||
	       (job->conf->nneighbour && gd_layer_find(job->im, "P").n == 3);
}

bool gd_denoise_crossed(const struct denoise_job *job, const char *feature)
{
	if (job->like)
		return gd_denoise_crossed(job->like, feature);
	return gd_denoise_crossfit(job) && job->source != NO_HALVES &&
	       !strcmp(feature, "feature") && has_halves(job->im, feature, 3);
}

/* A feature of all samples beside halves of the colour: it knows the very noise it is to remove. */
static bool knows_noise(const struct denoise_job *job, const char *feature)
{
	return gd_denoise_crossfit(job) && job->source != NO_HALVES &&
	       !strcmp(feature, "feature") && !gd_denoise_crossed(job, feature);
}

/* The halves of a crossed feature are enough: what all samples say is not read. */
static bool has_feature(const struct denoise_job *job, const char *layer)
{
	return gd_denoise_crossed(job, layer) || gd_layer_find(job->im, layer).n;
}

/*
 * Lists the features: those named, or the known ones that the file has but for P: with depth,
 * normal and the polynomial of the pixel position there, world positions did not lower any error
 * measured (by 1 %, either way).
 */
static int choose_features(struct denoise_job *job, struct gd_err *err)
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

/* Whether layers a and b ("" is the colour) have a channel in common: albedo and albedo.R have. */
static bool overlap(const struct gd_image *im, const char *a, const char *b)
{
	const struct gd_layer first = gd_layer_find(im, a), second = gd_layer_find(im, b);

	for (int i = 0; i < first.n; i++)
		for (int k = 0; k < second.n; k++)
			if (!strcmp(first.name[i], second.name[k]))
				return true;
	return false;
}

/* Is a name that of a family of layers, "bin3" of "bin", "model.radius" of "model", or in one? */
static bool in_family(const char *name, const char *family)
{
	const size_t n = strlen(family);

	if (strncmp(name, family, n) != 0)
		return false;
	for (name += n; isdigit((unsigned char)*name); name++)
		;
	return !*name || *name == '.';
}

/*
 * What a denoiser uses or writes for itself can be neither a feature nor a layer: it is freed when
 * it has been used, or replaced, or changed in place.
 */
static int check_names(const struct denoise_names *names, struct gd_err *err)
{
	static const char *const own[] = { "bin", "half", "variance", "error", "model", "state" };

	for (int i = 0; i < names->n; i++) {
		bool taken = strstr(names->name[i], ".variance");

		for (size_t k = 0; k < sizeof own / sizeof *own; k++)
			taken = taken || in_family(names->name[i], own[k]);
		if (taken)
			return gd_fail(err, GD_EARG, "%s is no layer of its own: a denoiser uses "
				       "that name", names->name[i]);
	}
	return GD_OK;
}

/* No channel twice, and none of the colour or of a feature, too: all are changed in place. */
static int check_layers(const struct denoise_job *job, struct gd_err *err)
{
	if (job->conf->sequence && job->layers.n)
		return gd_fail(err, GD_EARG, "layers of a sequence: only the colour can be "
			       "filtered along time");
	for (int i = 0; i < job->layers.n; i++) {
		const char *layer = job->layers.name[i];

		if (!gd_layer_find(job->im, layer).n)
			return gd_fail(err, GD_ESHAPE, "no layer %s", layer);
		if (overlap(job->im, layer, ""))
			return gd_fail(err, GD_EARG, "layer %s is the colour", layer);
		for (int k = 0; k < i; k++)
			if (overlap(job->im, layer, job->layers.name[k]))
				return gd_fail(err, GD_EARG, "layer %s is named twice", layer);
		for (int k = 0; k < job->features.n; k++)
			if (overlap(job->im, layer, job->features.name[k]))
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
static void choose_source(struct denoise_job *job)
{
	const struct gd_image *im = job->im;
	char name[256];
	double bins = 0;

	while (job->bins < GD_MAX_BINS &&
	       gd_layer_find(im, gd_denoise_part(name, "bin", job->bins, "")).n == 3)
		job->bins++;
	job->source = has_halves(im, "", 3) ? HALVES : job->bins >= 2 ? BINS : NO_HALVES;
	if (job->source == BINS || !gd_attr_number(im, "gd:bins", &bins))
		bins = job->bins;
	bins = bins >= 2 && bins <= GD_MAX_BINS ? floor(bins) : 2;
	job->share[0] = ceil(bins / 2) / bins;
	job->share[1] = 1 - job->share[0];
}

/* Whether all layers have the parts that the colour has. */
static bool layers_have_halves(const struct denoise_job *job)
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
			      gd_layer_find(job->im, gd_denoise_part(name, "bin", b, layer)).n == n;
	}
	return all;
}

static int no_colour(const struct gd_image *im, struct gd_err *err)
{
	const char *missing = gd_image_find(im, "R") < 0 ? "R" :
			      gd_image_find(im, "G") < 0 ? "G" : "B";

	return gd_fail(err, GD_ESHAPE, "no channel %s", missing);
}

int gd_denoise_choose(struct denoise_job *job, struct gd_err *err)
{
	const struct gd_image *im = job->im;
	int rc;

	if (gd_layer_find(im, "").n != 3)
		return no_colour(im, err);
	if (job->conf->sequence && gd_layer_find(im, "P").n != 3)
		return gd_fail(err, GD_ESHAPE,
			       "no layer P: frames of a sequence are joined by world positions");
	choose_source(job);
	rc = choose_features(job, err);
	if (rc == GD_OK && job->conf->layers)
		rc = split(&job->layers, job->conf->layers, err);
	if (rc == GD_OK)
		rc = check_names(&job->features, err);
	if (rc == GD_OK)
		rc = check_names(&job->layers, err);
	for (int i = 0; i < job->features.n && rc == GD_OK; i++)
		if (!has_feature(job, job->features.name[i]))
			rc = gd_fail(err, GD_ESHAPE, "no feature layer %s", job->features.name[i]);
		else if (overlap(im, job->features.name[i], ""))
			rc = gd_fail(err, GD_EARG, "feature %s is the colour",
				     job->features.name[i]);
	if (rc == GD_OK)
		rc = check_layers(job, err);
	job->layer_halves = rc == GD_OK && layers_have_halves(job);
	return rc;
}

/* A layer has as many planes as in the frame to denoise. */
static int alike(const struct denoise_job *job, const char *layer, struct gd_err *err)
{
	const int n = gd_layer_find(job->im, layer).n;
	const int want = gd_layer_find(job->like->im, layer).n;

	if (n == want)
		return GD_OK;
	if (!n)
		return gd_fail(err, GD_ESHAPE, "no layer %s, which the frame to denoise has",
			       layer);
	return gd_fail(err, GD_ESHAPE, "layer %s has %d channels, expected %d", layer, n, want);
}

/* Takes the choice of the frame to denoise: what that has, a neighbour must have, too. */
int gd_denoise_choose_alike(struct denoise_job *job, const struct denoise_job *like,
			    struct gd_err *err)
{
	char name[256];
	int rc = GD_OK;

	job->like = like;
	job->features = like->features;
	job->layers = like->layers;
	job->features.text = job->layers.text = NULL;
	if (gd_layer_find(job->im, "").n != 3)
		return no_colour(job->im, err);
	choose_source(job);
	if (like->source == NO_HALVES)
		job->source = NO_HALVES;
	else if (job->source == NO_HALVES)
		return gd_fail(err, GD_ESHAPE, "no halves and no bins, which the frame to denoise "
			       "has");
	for (int i = 0; i < job->features.n && rc == GD_OK; i++)
		for (int h = 0; h < 2 && rc == GD_OK; h++)
			rc = alike(job, gd_denoise_crossed(job, job->features.name[i]) ?
				   gd_denoise_part(name, "half", h, job->features.name[i]) :
				   job->features.name[i], err);
	for (int i = 0; i < job->layers.n && rc == GD_OK; i++)
		rc = alike(job, job->layers.name[i], err);
	job->layer_halves = like->layer_halves;
	if (rc == GD_OK && job->layer_halves && !layers_have_halves(job))
		rc = gd_fail(err, GD_ESHAPE, "layers without halves or bins, which those of the "
			     "frame to denoise have");
	return rc;
}

/* Marks the halves or bins of a layer. */
static void want_parts(struct denoise_job *job, const char *layer, enum gd_want want)
{
	char name[256];

	for (int h = 0; h < 2 && job->source == HALVES; h++)
		gd_layer_want(job->im, gd_denoise_part(name, "half", h, layer), want);
	for (int b = 0; b < job->bins && job->source == BINS; b++)
		gd_layer_want(job->im, gd_denoise_part(name, "bin", b, layer), want);
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
	gd_layer_want(im, "dx.samples", GD_DROP);
	gd_layer_want(im, "dy.samples", GD_DROP);
	gd_family_want(im, "bin", GD_DROP);
	gd_family_want(im, "half", GD_DROP);
	gd_family_want(im, "pair", GD_DROP);
}

static void mark(struct denoise_job *job)
{
	struct gd_image *im = job->im;
	bool variance;

	if (!job->keep && !job->like)
		drop_used(im);
	gd_layer_want(im, "", GD_READ);
	variance = gd_layer_want_variance(im, "", GD_READ) == 3;
	if (job->source == HALVES || gd_denoise_crossfit(job) || !variance)
		want_parts(job, "", GD_READ);
	for (int i = 0; i < job->features.n; i++) {
		const char *name = job->features.name[i];
		char part[256];

		for (int h = 0; h < 2 && gd_denoise_crossed(job, name); h++)
			gd_layer_want(im, gd_denoise_part(part, "half", h, name), GD_READ);
		if (!gd_denoise_crossed(job, name)) {
			gd_layer_want(im, name, GD_READ);
			gd_layer_want_variance(im, name, GD_READ);
		}
	}
	if (gd_denoise_follows(job))
		gd_layer_want(im, "P", GD_READ);
	if (gd_denoise_crossfit(job)) {
		gd_layer_want(im, "samples", GD_READ);
		gd_layer_want(im, "half0.samples", GD_READ);
		gd_layer_want(im, "half1.samples", GD_READ);
	}
	for (int i = 0; i < job->layers.n; i++) {
		gd_layer_want(im, job->layers.name[i], GD_READ);
		if (job->layer_halves && gd_denoise_crossfit(job))
			want_parts(job, job->layers.name[i], GD_READ);
	}
}

void gd_denoise_free(struct denoise_job *job)
{
	for (int i = 0; i < job->ncopy; i++)
		free(job->copy[i]);
	free(job->copy);
	free(job->features.text);
	free(job->layers.text);
}

int gd_denoise_want(struct gd_image *im, const struct gd_denoise_conf *conf, struct gd_err *err)
{
	struct denoise_job job = { .im = im, .conf = conf, .keep = conf->keep };
	int rc = gd_denoise_choose(&job, err);

	if (rc == GD_OK)
		mark(&job);
	gd_denoise_free(&job);
	return rc;
}

/* Only what is used is read of a neighbour. */
int gd_denoise_want_neighbour(struct gd_image *other, const struct gd_image *im,
			      const struct gd_denoise_conf *conf, struct gd_err *err)
{
	struct gd_image head = *im;
	struct denoise_job job = { .im = &head, .conf = conf };
	struct denoise_job neighbour = { .im = other, .conf = conf };
	int rc = gd_denoise_choose(&job, err);

	if (rc == GD_OK && (other->w != im->w || other->h != im->h))
		rc = gd_fail(err, GD_ESHAPE, "%d x %d pixels, expected %d x %d", other->w, other->h,
			     im->w, im->h);
	if (rc == GD_OK)
		rc = gd_denoise_choose_alike(&neighbour, &job, err);
	for (int i = 0; i < other->nchan; i++)
		other->chan[i].want = GD_DROP;
	if (rc == GD_OK)
		mark(&neighbour);
	gd_denoise_free(&neighbour);
	gd_denoise_free(&job);
	return rc;
}

/* ---- the end ---- */

void gd_denoise_release(struct gd_image *im, const char *layer)
{
	struct gd_layer found = gd_layer_find(im, layer);

	for (int i = 0; i < found.n; i++)
		gd_image_drop(im, found.name[i]);
}

void gd_denoise_release_variance(struct gd_image *im, const char *layer)
{
	struct gd_layer found = gd_layer_variance(im, layer);

	for (int i = 0; i < found.n; i++)
		gd_image_drop(im, found.name[i]);
}

/* What was read only to be used. */
void gd_denoise_release_used(struct denoise_job *job)
{
	char name[256];

	gd_denoise_release_variance(job->im, "");
	gd_denoise_release(job->im, "half0.samples");
	gd_denoise_release(job->im, "half1.samples");
	if (gd_denoise_follows(job))
		gd_denoise_release(job->im, "P");
	for (int i = 0; i < job->features.n; i++) {
		gd_denoise_release_variance(job->im, job->features.name[i]);
		gd_denoise_release(job->im, job->features.name[i]);
		for (int h = 0; h < 2; h++)
			gd_denoise_release(job->im,
					   gd_denoise_part(name, "half", h, job->features.name[i]));
	}
	for (int i = -1; i < job->layers.n; i++) {
		const char *layer = i < 0 ? "" : job->layers.name[i];

		for (int b = 0; b < job->bins; b++)
			gd_denoise_release(job->im, gd_denoise_part(name, "bin", b, layer));
		for (int h = 0; h < 2; h++)
			gd_denoise_release(job->im, gd_denoise_part(name, "half", h, layer));
	}
}
