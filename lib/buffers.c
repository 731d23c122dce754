/* SPDX-License-Identifier: BSD-3-Clause */
#include "buffers.h"

#include <ctype.h>
#include <stdio.h>
#include <string.h>

/* The suffixes a layer may have, in the order they are looked for. */
static const char *const triples[][3] = { { "R", "G", "B" }, { "X", "Y", "Z" } };

/* dst = layer.suffix, either of which may be empty; false if it does not fit. */
static bool join(char dst[256], const char *layer, const char *suffix)
{
	const char *dot = *layer && *suffix ? "." : "";
	int n = snprintf(dst, 256, "%s%s%s", layer, dot, suffix);

	return n > 0 && n < 256;
}

/* The layer's name without a dot at its end: "half0." is the colour of half0, too. */
static bool bare(char dst[256], const char *layer)
{
	size_t n = strlen(layer);

	if (n && layer[n - 1] == '.')
		n--;
	if (n >= 256)
		return false;
	memcpy(dst, layer, n);
	dst[n] = 0;
	return true;
}

static bool has_triple(const struct gd_image *im, const char *layer, int triple,
		       struct gd_layer *found)
{
	for (int i = 0; i < 3; i++)
		if (!join(found->name[i], layer, triples[triple][i]) ||
		    gd_image_find(im, found->name[i]) < 0)
			return false;
	found->n = 3;
	return true;
}

struct gd_layer gd_layer_find(const struct gd_image *im, const char *layer)
{
	struct gd_layer found = { 0 };
	char name[256];

	if (!bare(name, layer))
		return found;
	/* X Y Z without a layer's name are no colour: Z alone is the depth */
	if (has_triple(im, name, 0, &found) || (*name && has_triple(im, name, 1, &found)))
		return found;
	if (*name && gd_image_find(im, name) >= 0) {
		strcpy(found.name[0], name);
		found.n = 1;
	}
	return found;
}

struct gd_layer gd_layer_variance(const struct gd_image *im, const char *layer)
{
	struct gd_layer base = gd_layer_find(im, layer), found = { 0 };
	char name[256], stem[256];

	if (!base.n || !bare(name, layer) || !join(stem, name, "variance"))
		return found;
	for (int i = 0; i < base.n; i++) {
		const char *suffix = base.n == 1 ? "" : base.name[i] + strlen(base.name[i]) - 1;

		if (!join(found.name[i], stem, suffix) || gd_image_find(im, found.name[i]) < 0)
			return (struct gd_layer){ 0 };
	}
	found.n = base.n;
	return found;
}

static int want_all(struct gd_image *im, const struct gd_layer *layer, enum gd_want want)
{
	for (int i = 0; i < layer->n; i++)
		im->chan[gd_image_find(im, layer->name[i])].want = want;
	return layer->n;
}

int gd_layer_want(struct gd_image *im, const char *layer, enum gd_want want)
{
	struct gd_layer found = gd_layer_find(im, layer);

	return want_all(im, &found, want);
}

int gd_layer_want_variance(struct gd_image *im, const char *layer, enum gd_want want)
{
	struct gd_layer found = gd_layer_variance(im, layer);

	return want_all(im, &found, want);
}

static int planes_of(const struct gd_image *im, const struct gd_layer *layer,
		     struct gd_plane *plane)
{
	for (int i = 0; i < layer->n; i++)
		if (!gd_image_plane(im, layer->name[i], &plane[i]))
			return 0;
	return layer->n;
}

int gd_layer_planes(const struct gd_image *im, const char *layer,
		    struct gd_plane plane[GD_LAYER_PLANES])
{
	struct gd_layer found = gd_layer_find(im, layer);

	return planes_of(im, &found, plane);
}

int gd_layer_variance_planes(const struct gd_image *im, const char *layer,
			     struct gd_plane plane[GD_LAYER_PLANES])
{
	struct gd_layer found = gd_layer_variance(im, layer);

	return planes_of(im, &found, plane);
}

int gd_layer_add(struct gd_image *im, const char *layer, int n,
		 struct gd_plane plane[GD_LAYER_PLANES], struct gd_err *err)
{
	char base[256], name[256];
	int rc = GD_OK;

	if ((n != 1 && n != 3) || !bare(base, layer) || (n == 1 && !*base))
		return gd_fail(err, GD_EARG, "layer '%s': cannot have %d channels", layer, n);
	for (int i = 0; i < n && rc == GD_OK; i++) {
		if (!join(name, base, n == 1 ? "" : triples[0][i]))
			return gd_fail(err, GD_EARG, "layer '%s': its name is too long", layer);
		rc = gd_image_add(im, name, &plane[i], err);
	}
	return rc;
}

int gd_bins(const struct gd_image *im, const char *layer)
{
	char name[256];
	int n = 0;

	while (n < GD_MAX_BINS) {
		int len = snprintf(name, sizeof name, "bin%d%s%s", n, *layer ? "." : "", layer);

		if (len >= (int)sizeof name || !gd_layer_find(im, name).n)
			break;
		n++;
	}
	return n;
}

bool gd_in_family(const char *name, const char *prefix)
{
	size_t n = strlen(prefix);

	if (strncmp(name, prefix, n))
		return false;
	while (isdigit((unsigned char)name[n]))
		n++;
	return name[n] == '.';
}

int gd_family_want(struct gd_image *im, const char *prefix, enum gd_want want)
{
	int n = 0;

	for (int i = 0; i < im->nchan; i++)
		if (gd_in_family(im->chan[i].name, prefix)) {
			im->chan[i].want = want;
			n++;
		}
	return n;
}
