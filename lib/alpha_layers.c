/* SPDX-License-Identifier: BSD-3-Clause */
/* The weight of the colour, out of an image's channels. */
#include "alpha.h"

#include <math.h>
#include <omp.h>
#include <stdio.h>
#include <stdlib.h>

#include "buffers.h"
#include "half.h"

/* A term of a plane: the mean over the channels of a layer, times factor. */
struct term {
	struct gd_layer layer;
	double factor;
};

static const char *edge_layer(char name[16], bool pairs, int k)
{
	snprintf(name, 16, pairs ? "pair%d" : k ? "dy" : "dx", k);
	return name;
}

static int edge_layers(const struct gd_image *im, bool pairs)
{
	const int n = pairs ? gd_pairs_layers(im) : 2;

	return n > GD_PAIRS ? GD_PAIRS : n;
}

/* "bin3.dx", "half0": the share of a layer ("": the colour) in a part of the samples. */
static struct gd_layer share(const struct gd_image *im, const char *part, int i, const char *layer)
{
	char name[48];

	snprintf(name, sizeof(name), "%s%d%s%s", part, i, *layer ? "." : "", layer);
	return gd_layer_find(im, name);
}

static int parts_of(const struct gd_image *im, const char *part, const char *layer)
{
	int n = 0;

	while (n < GD_MAX_BINS && share(im, part, n, layer).n)
		n++;
	return n;
}

/* How many parts all layers have, if that is an equal number of at least two, else 0. */
static int common_parts(const struct gd_image *im, const char *part, bool pairs)
{
	const int n = parts_of(im, part, "");
	char name[16];

	for (int k = 0; k < edge_layers(im, pairs); k++)
		if (parts_of(im, part, edge_layer(name, pairs, k)) != n)
			return 0;
	return n < 2 ? 0 : n;
}

static const char *family(const struct gd_image *im, bool pairs, int *parts)
{
	*parts = common_parts(im, "half", pairs);
	if (*parts == 2)
		return "half";
	*parts = common_parts(im, "bin", pairs);
	return *parts ? "bin" : NULL;
}

static bool all_variances(const struct gd_image *im, bool pairs)
{
	char name[16];

	for (int k = 0; k < edge_layers(im, pairs); k++)
		if (!gd_layer_variance(im, edge_layer(name, pairs, k)).n)
			return false;
	return gd_layer_variance(im, "").n > 0;
}

/* Half of the mean over the even parts less that over the odd ones. */
static int differ(struct term term[GD_MAX_BINS], const struct gd_image *im, const char *layer,
		  bool pairs)
{
	int parts;
	const char *part = family(im, pairs, &parts);

	for (int i = 0; i < parts; i++) {
		const int many = i % 2 ? parts / 2 : (parts + 1) / 2;

		term[i] = (struct term){ share(im, part, i, layer), (i % 2 ? -0.5 : 0.5) / many };
	}
	return parts;
}

static void keep(struct gd_image *im, const struct gd_layer *layer)
{
	for (int c = 0; c < layer->n; c++) {
		struct gd_channel *chan = &im->chan[gd_image_find(im, layer->name[c])];

		if (chan->want == GD_DROP)
			chan->want = GD_PASS;
	}
}

static int noise_of(struct term term[GD_MAX_BINS], const struct gd_image *im, const char *layer,
		    bool pairs, enum gd_alpha_source source)
{
	if (source == GD_ALPHA_HALVES)
		return differ(term, im, layer, pairs);
	term[0] = (struct term){ gd_layer_variance(im, layer), 1 };
	return 1;
}

static enum gd_alpha_source source_of(const struct gd_image *im, bool pairs)
{
	int parts;

	if (!gd_layer_find(im, "").n || !edge_layers(im, pairs))
		return GD_ALPHA_NONE;
	if (family(im, pairs, &parts))
		return GD_ALPHA_HALVES;
	return all_variances(im, pairs) ? GD_ALPHA_VARIANCES : GD_ALPHA_NONE;
}

enum gd_alpha_source gd_alpha_want(struct gd_image *im, bool pairs)
{
	const enum gd_alpha_source source = source_of(im, pairs);
	struct term term[GD_MAX_BINS];
	char name[16];

	if (source == GD_ALPHA_NONE)
		return source;
	for (int k = -1; k < edge_layers(im, pairs); k++) {
		const char *layer = k < 0 ? "" : edge_layer(name, pairs, k);
		const int n = noise_of(term, im, layer, pairs, source);

		for (int i = 0; i < n; i++)
			keep(im, &term[i].layer);
	}
	return source;
}

/* A row of a channel, read or not, is added. */
static void add_row(double *to, const struct gd_image *im, const struct gd_channel *chan, int y,
		    double factor)
{
	const size_t w = (size_t)im->w, at = (size_t)y * w;

	if (chan->v) {
		const float *v = chan->v + (size_t)y * gd_stride(im->w);

#pragma omp simd
		for (size_t x = 0; x < w; x++)
			to[x] += factor * (double)v[x];
	} else if (chan->type == GD_HALF) {
		const uint16_t *v = (const uint16_t *)(const void *)chan->raw + at;

#pragma omp simd
		for (size_t x = 0; x < w; x++)
			to[x] += factor * (double)gd_half_float(v[x]);
	} else if (chan->type == GD_FLOAT) {
		const float *v = (const float *)(const void *)chan->raw + at;

#pragma omp simd
		for (size_t x = 0; x < w; x++)
			to[x] += factor * (double)v[x];
	} else {
		const uint32_t *v = (const uint32_t *)(const void *)chan->raw + at;

#pragma omp simd
		for (size_t x = 0; x < w; x++)
			to[x] += factor * (double)v[x];
	}
}

static int channels_of(const struct gd_channel **chan, double *factor, const struct gd_image *im,
		       const struct term *term, int n, struct gd_err *err)
{
	int many = 0;

	for (int i = 0; i < n; i++)
		for (int c = 0; c < term[i].layer.n; c++) {
			const int k = gd_image_find(im, term[i].layer.name[c]);

			if (k < 0 || (!im->chan[k].v && !im->chan[k].raw))
				return gd_fail(err, GD_ESHAPE, "channel %s was not loaded",
					       term[i].layer.name[c]);
			chan[many] = &im->chan[k];
			factor[many++] = term[i].factor / term[i].layer.n;
		}
	if (!many)
		return gd_fail(err, GD_ESHAPE, "a layer that is needed is not there");
	return GD_OK;
}

/* to: a new plane, the sum of n terms. */
static int sum_terms(struct gd_plane *to, const struct gd_image *im, const struct term *term,
		     int n, struct gd_err *err)
{
	const struct gd_channel *chan[GD_MAX_BINS * GD_LAYER_PLANES];
	double factor[GD_MAX_BINS * GD_LAYER_PLANES], *work;
	int many = 0, rc = channels_of(chan, factor, im, term, n, err);

	if (rc != GD_OK)
		return rc;
	for (int i = 0; i < n; i++)
		many += term[i].layer.n;
	*to = gd_plane_of(gd_alloc((size_t)im->h * gd_stride(im->w), sizeof(float)), im->w, im->h);
	work = gd_alloc((size_t)omp_get_max_threads() * (size_t)im->w, sizeof(*work));
	if (!to->v || !work)
		rc = gd_fail(err, GD_ENOMEM, "alpha: out of memory for %dx%d", im->w, im->h);
#pragma omp parallel for schedule(static) if (rc == GD_OK)
	for (int y = 0; y < (rc == GD_OK ? im->h : 0); y++) {
		double *sum = work + (size_t)omp_get_thread_num() * (size_t)im->w;

		for (int x = 0; x < im->w; x++)
			sum[x] = 0;
		for (int i = 0; i < many; i++)
			add_row(sum, im, chan[i], y, factor[i]);
		for (int x = 0; x < im->w; x++)
			gd_row(*to, y)[x] = (float)sum[x];
	}
	free(work);
	return rc;
}

/* The layer itself, and its noise. */
static int take(struct gd_plane *value, struct gd_plane *noise, const struct gd_image *im,
		const char *layer, bool pairs, enum gd_alpha_source source, struct gd_err *err)
{
	struct term term[GD_MAX_BINS];
	int rc;

	term[0] = (struct term){ gd_layer_find(im, layer), 1 };
	rc = sum_terms(value, im, term, 1, err);
	if (rc == GD_OK)
		rc = sum_terms(noise, im, term, noise_of(term, im, layer, pairs, source), err);
	return rc;
}

int gd_alpha_of_image(struct gd_alpha *alpha, const struct gd_image *im,
		      const struct gd_pairs *pairs, double tolerance,
		      const struct gd_report *report, struct gd_err *err)
{
	struct gd_alpha_in in = { .pairs = pairs,
				  .edges = edge_layers(im, pairs != NULL),
				  .source = source_of(im, pairs != NULL) };
	char name[16];
	int rc = GD_OK;

	if (in.source != GD_ALPHA_NONE)
		rc = take(&in.colour, &in.colour_noise, im, "", pairs != NULL, in.source, err);
	for (int k = 0; k < in.edges && in.source != GD_ALPHA_NONE && rc == GD_OK; k++)
		rc = take(&in.edge[k], &in.edge_noise[k], im, edge_layer(name, pairs != NULL, k),
			  pairs != NULL, in.source, err);
	if (rc == GD_OK)
		rc = gd_alpha_choose(alpha, &in, tolerance, report, err);
	free(in.colour.v);
	free(in.colour_noise.v);
	for (int k = 0; k < GD_PAIRS; k++) {
		free(in.edge[k].v);
		free(in.edge_noise[k].v);
	}
	return rc;
}
