/* SPDX-License-Identifier: BSD-3-Clause */
#include "spending_trial.h"

#include <stdio.h>
#include <string.h>

#include "buffers.h"
#include "denoise.h"
#include "feature.h"
#include "spending.h"

static const char *const binned[] = { "", "dx", "dy" };
static const char *const gbuffers[] = { "albedo", "N", "Z", "ao" };

#define COUNT(a) (sizeof(a) / sizeof *(a))

static const char *bin_name(char name[256], int b, const char *layer)
{
	snprintf(name, 256, *layer ? "bin%d.%s" : "bin%d", b, layer);
	return name;
}

int gd_trial_bins(int *bins, const struct gd_image *im, struct gd_err *err)
{
	*bins = GD_MAX_BINS;
	for (size_t k = 0; k < COUNT(binned); k++) {
		int n = gd_bins(im, binned[k]);

		if (n < GD_SPENDING_BINS)
			return gd_fail(err, GD_ESHAPE, "%d bins of %s, at least %d are needed", n,
				       *binned[k] ? binned[k] : "the colour", GD_SPENDING_BINS);
		*bins = n < *bins ? n : *bins;
	}
	return GD_OK;
}

int gd_trial_want(struct gd_image *im, struct gd_err *err)
{
	char name[256];
	int bins, rc = gd_trial_bins(&bins, im, err);

	for (int i = 0; i < im->nchan; i++)
		im->chan[i].want = GD_DROP;
	for (int b = 0; b < bins && rc == GD_OK; b++)
		for (size_t k = 0; k < COUNT(binned); k++)
			gd_layer_want(im, bin_name(name, b, binned[k]), GD_READ);
	for (size_t k = 0; k < COUNT(gbuffers) && rc == GD_OK; k++) {
		gd_layer_want(im, gbuffers[k], GD_READ);
		gd_layer_want_variance(im, gbuffers[k], GD_READ);
	}
	return rc;
}

/* ---- images of a half ---- */

static int copy_channel(struct gd_image *to, const char *name, struct gd_plane from,
			struct gd_err *err)
{
	struct gd_plane p;
	int rc = gd_image_add(to, name, &p, err);

	for (int y = 0; y < from.h && rc == GD_OK; y++)
		memcpy(gd_row(p, y), gd_row(from, y), (size_t)from.w * sizeof(float));
	return rc;
}

static int copy_layer(struct gd_image *to, const struct gd_image *from, struct gd_layer layer,
		      struct gd_err *err)
{
	struct gd_plane p;
	int rc = GD_OK;

	for (int i = 0; i < layer.n && rc == GD_OK; i++)
		if (gd_image_plane(from, layer.name[i], &p))
			rc = copy_channel(to, layer.name[i], p, err);
	return rc;
}

/* Bins half, half + 2, ... of a layer become bins 0, 1, ... */
static int copy_bins(struct gd_image *to, const struct gd_image *from, const char *layer, int bins,
		     int half, struct gd_err *err)
{
	static const char *const suffix[] = { "R", "G", "B" };
	struct gd_plane p[GD_LAYER_PLANES];
	char name[256], full[300];
	int rc = GD_OK;

	for (int b = half; b < bins && rc == GD_OK; b += 2) {
		if (gd_layer_planes(from, bin_name(name, b, layer), p) != 3)
			return gd_fail(err, GD_ESHAPE, "no layer %s", name);
		bin_name(name, b / 2, layer);
		for (int c = 0; c < 3 && rc == GD_OK; c++) {
			snprintf(full, sizeof full, "%s.%s", name, suffix[c]);
			rc = copy_channel(to, full, p[c], err);
		}
	}
	return rc;
}

/* The mean of a half's bins of the colour. */
static int average(struct gd_image *to, const struct gd_image *im, int bins, int half,
		   struct gd_err *err)
{
	struct gd_plane mean[GD_LAYER_PLANES], bin[GD_LAYER_PLANES];
	const int n = (bins + 1 - half) / 2;
	char name[256];
	int rc = gd_layer_add(to, "", 3, mean, err);

	for (int b = half; b < bins && rc == GD_OK; b += 2) {
		if (gd_layer_planes(im, bin_name(name, b, ""), bin) != 3)
			return gd_fail(err, GD_ESHAPE, "no layer %s", name);
		for (int c = 0; c < 3; c++)
			for (int y = 0; y < im->h; y++) {
				float *m = gd_row(mean[c], y);
				const float *v = gd_row(bin[c], y);

				for (int x = 0; x < im->w; x++)
					m[x] += v[x] / (float)n;
			}
	}
	return rc;
}

/* What a denoiser reads: the colour's bins, G-buffers, and the gradients' bins if asked for. */
static int make_input(struct gd_image *to, const struct gd_trial *t, const struct gd_image *im,
		      int bins, int half, bool gradients, struct gd_err *err)
{
	int rc;

	gd_image_init(to, im->w, im->h);
	rc = copy_layer(to, &t->half[half], gd_layer_find(&t->half[half], ""), err);
	for (size_t k = 0; k < (gradients ? COUNT(binned) : 1) && rc == GD_OK; k++)
		rc = copy_bins(to, im, binned[k], bins, half, err);
	for (size_t k = 0; k < COUNT(gbuffers) && rc == GD_OK; k++) {
		rc = copy_layer(to, im, gd_layer_find(im, gbuffers[k]), err);
		if (rc == GD_OK)
			rc = copy_layer(to, im, gd_layer_variance(im, gbuffers[k]), err);
	}
	return rc;
}

static int denoise(struct gd_image *to, const struct gd_trial *t, const struct gd_image *im,
		   int bins, int half, bool gradients, struct gd_err *err)
{
	const struct gd_feature_conf feature = GD_FEATURE_DEFAULTS;
	struct gd_denoise_conf conf = GD_DENOISE_DEFAULTS;
	struct gd_denoise_result result;
	int rc = make_input(to, t, im, bins, half, gradients, err);

	conf.fast = true;
	if (rc == GD_OK && gradients)
		rc = gd_feature_run(to, &feature, NULL, NULL, err);
	if (rc == GD_OK)
		rc = gd_denoise_run(to, &conf, &result, NULL, err);
	return rc;
}

int gd_trial_run(struct gd_trial *t, const struct gd_image *im, const struct gd_report *report,
		 struct gd_err *err)
{
	int bins, rc = gd_trial_bins(&bins, im, err);

	for (int half = 0; half < 2 && rc == GD_OK; half++) {
		gd_image_init(&t->half[half], im->w, im->h);
		rc = average(&t->half[half], im, bins, half, err);
	}
	for (int half = 0; half < 2 && rc == GD_OK; half++) {
		gd_progress(report, "trying gradients", half / 2.0);
		rc = denoise(&t->with[half], t, im, bins, half, true, err);
		if (rc == GD_OK)
			rc = denoise(&t->without[half], t, im, bins, half, false, err);
	}
	gd_progress(report, "trying gradients", 1);
	return rc;
}

void gd_trial_free(struct gd_trial *t)
{
	for (int half = 0; half < 2; half++) {
		gd_image_free(&t->half[half]);
		gd_image_free(&t->with[half]);
		gd_image_free(&t->without[half]);
	}
}
