/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * The buffer convention: which channel means what (gd-buffers(5)). Layers are named by dots.
 * A layer "albedo" has channels albedo.R albedo.G albedo.B; the colour is the layer "" with R G B;
 * scalar layers ("Z", "ao", "samples") are a single channel of that name.
 */
#ifndef GD_BUFFERS_H
#define GD_BUFFERS_H

#include "image.h"

#define GD_MAX_BINS 64
#define GD_LAYER_PLANES 4

/* Channel names of a layer that an image has: suffixes R G B, then X Y Z, then none. */
struct gd_layer {
	int n;					/* planes: 0 (absent), 1 or 3 */
	char name[GD_LAYER_PLANES][256];	/* full channel names */
};

/* Finds layer (e.g. "", "dx", "bin3.dx", "half0.feature", "Z") among im's channels. */
struct gd_layer gd_layer_find(const struct gd_image *im, const char *layer);
/* The layer of the variances that belongs to it: "<layer>.variance.<c>" ("variance.<c>" for the
 * colour; with prefix "half0." "half0.variance.<c>"). n = 0 if any channel is missing. */
struct gd_layer gd_layer_variance(const struct gd_image *im, const char *layer);
/* Sets want of the layer's channels; returns the number of channels it set. */
int gd_layer_want(struct gd_image *im, const char *layer, enum gd_want want);
/* The same for its variances. */
int gd_layer_want_variance(struct gd_image *im, const char *layer, enum gd_want want);
/* Views of a layer's planes (read ones only); returns the number, 0 if one is missing. */
int gd_layer_planes(const struct gd_image *im, const char *layer,
		    struct gd_plane plane[GD_LAYER_PLANES]);
int gd_layer_variance_planes(const struct gd_image *im, const char *layer,
			     struct gd_plane plane[GD_LAYER_PLANES]);
/* Adds the float channels of a layer with suffixes ".R" ".G" ".B" (n = 3; "R" "G" "B" for the layer
 * "") or none (n = 1), zeroed. */
int gd_layer_add(struct gd_image *im, const char *layer, int n,
		 struct gd_plane plane[GD_LAYER_PLANES], struct gd_err *err);
/* Number of consecutive bins bin0 .. bin<n-1> that hold layer ("" colour, "dx", ...). */
int gd_bins(const struct gd_image *im, const char *layer);
/* Is a name that prefix, then digits (none is fine), then a dot? */
bool gd_in_family(const char *name, const char *prefix);

/* Sets want for every channel whose name starts with prefix ("bin", "half", ...) followed by a
 * digit and a dot, or prefix and a dot: the whole family. */
int gd_family_want(struct gd_image *im, const char *prefix, enum gd_want want);

#endif
