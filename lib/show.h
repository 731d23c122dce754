/* SPDX-License-Identifier: BSD-3-Clause */
/* Pictures of layers: what a display shows, false colours, sheets of several with labels. */
#ifndef GD_SHOW_H
#define GD_SHOW_H

#include <stdbool.h>

#include "gd.h"
#include "plane.h"

#define GD_PICTURE_SIDE		65536		/* pixels; larger pictures are refused ... */
#define GD_PICTURE_PIXELS	(1 << 28)	/* ... and such that need over 3 GiB */

/* w x h pixels of interleaved RGB, as a display shows it (0 .. 1, encoded). { 0 } is empty. */
struct gd_picture {
	int w, h;
	float *rgb;
};

void gd_picture_free(struct gd_picture *pic);

/* How a layer is shown. */
enum gd_show_as {
	GD_SHOW_AUTO = 0,	/* by the layer's name: gd_show_guess() */
	GD_SHOW_COLOUR,		/* radiance through exposure and display transform */
	GD_SHOW_SCALAR,		/* mean over channels in false colours, dark to bright */
	GD_SHOW_SIGNED,		/* mean over channels: blue below 0, white, red above */
	GD_SHOW_NORMAL,		/* -1 .. 1 as 0 .. 1 in red, green, blue */
	GD_SHOW_POSITION,	/* each channel over its own range */
	GD_SHOW_AS
};
const char *gd_show_as_name(enum gd_show_as as);	/* "auto", "colour", "scalar", ... */
bool gd_show_as_find(const char *name, enum gd_show_as *as);
/* What layer of n channels is by the convention of gd-buffers(5): n = 1 is a scalar, except dx.R
 * and its like, which are signed; dx and dy are signed; N and normal, normals; P and position,
 * positions; variances and errors, scalars; the rest, colour. */
enum gd_show_as gd_show_guess(const char *layer, int n);

/* What is between a value and its place in the false colours. */
enum gd_show_scale { GD_SHOW_LINEAR, GD_SHOW_SQRT, GD_SHOW_LOG };

struct gd_show_range {
	float lo, hi;
	enum gd_show_scale scale;
};

/*
 * The default range of n planes shown as "as" (scalar, signed, position): the 1st to the 99th
 * percentile of the finite values of their mean; signed: -m .. m, m the 99th percentile of |mean|;
 * a logarithmic scale begins at the smallest of them above 0, at most 6 decades below its end.
 * Never empty: hi > lo.
 */
int gd_show_range(struct gd_show_range *range, const struct gd_plane *v, int n, enum gd_show_as as,
		  enum gd_show_scale scale, struct gd_err *err);

struct gd_show_conf {
	enum gd_show_as as;		/* not AUTO */
	double exposure;		/* stops, for COLOUR */
	const char *display, *view;	/* NULL: the configuration's; see gd_plugin_display() */
	struct gd_show_range range;	/* for SCALAR and SIGNED */
};

/*
 * The picture of n planes (1 or 3 of one size; more are left out). pic must be empty. COLOUR of one
 * plane is grey. Pixels with NaN are shown in pure magenta, *nan (may be NULL) is their number;
 * infinities lie at the ends of the range. GD_ESHAPE: NORMAL or POSITION of fewer than 3 planes.
 */
int gd_show(struct gd_picture *pic, size_t *nan, const struct gd_plane *v, int n,
	    const struct gd_show_conf *conf, struct gd_err *err);

/* Each pixel as factor x factor ones. */
int gd_picture_zoom(struct gd_picture *pic, int factor, struct gd_err *err);

/* Text from its upper left corner (x, y), each of its pixels size x size, cut at the borders. */
void gd_picture_text(struct gd_picture *pic, int x, int y, int size, const char *text);

/*
 * A sheet: n pictures in rows of at most columns, a line of text (which may be NULL or empty) under
 * each. Cells are as large as the largest picture; text that does not fit is cut in the middle
 * ("...").
 */
int gd_picture_sheet(struct gd_picture *sheet, const struct gd_picture *pic,
		     const char *const *label, int n, int columns, struct gd_err *err);

/* A bar of the false colours of SCALAR or SIGNED below the picture, with the ends of the range. */
int gd_picture_legend(struct gd_picture *pic, const struct gd_show_conf *conf, struct gd_err *err);

/* Does path end in .exr, so that a PNG there would be a mistake? */
bool gd_picture_misnamed(const char *path);

/* Writes a PNG of 8 or 16 bits, whole or not at all; "-" is standard output. Needs the plug-in. */
int gd_picture_write(const struct gd_picture *pic, const char *path, int bits, struct gd_err *err);

#endif
