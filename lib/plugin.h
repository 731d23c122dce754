/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * What needs OpenImageIO and OpenColorIO: other file formats (and DWA-compressed EXR), PNG, display
 * transforms. Both live in gd-plugin.so, which is loaded when one of these routines is first
 * called: linking them would cost every tool half a second before main().
 * Searched for as "gd-plugin.so" in the directories of $GD_PLUGIN_PATH (divided by ':'); if that is
 * not set, in ../lib/gd beside the directory of the executable, that directory itself, and
 * GD_PLUGDIR. Where it is missing, or made for another version, each routine returns GD_EIO with a
 * text that says so.
 */
#ifndef GD_PLUGIN_H
#define GD_PLUGIN_H

#include "image.h"

/* GD_OK if the plug-in is there and fits. */
int gd_plugin_check(struct gd_err *err);

struct gd_plugin_file;		/* an image file opened through OpenImageIO */

/*
 * Opens an image file of any format and fills im (which must be empty) with all but pixels: sizes,
 * windows, channels (want = GD_PASS) and the attributes that are numbers or texts.
 * path   names the file; its suffix is a hint at the format
 * data   NULL: path is opened; else the whole file in memory, size bytes that must stay until
 *        gd_plugin_close() (for standard input: give a path like "stdin.exr")
 * part   of a multi-part file, from 0
 * Formats of integer pixels give float channels in 0 .. 1; where the file says that it is
 * sRGB-encoded (PNG, JPEG, ...) R, G and B are linearised, and not multiplied by alpha.
 * On failure *file is NULL and im is empty.
 */
int gd_plugin_open(struct gd_plugin_file **file, struct gd_image *im, const char *path,
		   const void *data, size_t size, int part, struct gd_err *err);
/*
 * Decodes each channel of im as its want says (v, raw of its type, or nothing), found by name;
 * drops GD_DROP channels from im. im is that of gd_plugin_open(), or one whose header another
 * reader filled from the same file: GD_ESHAPE if its size or channels are not the file's.
 */
int gd_plugin_load(struct gd_plugin_file *file, struct gd_image *im, struct gd_err *err);
void gd_plugin_close(struct gd_plugin_file *file);	/* takes NULL */

/*
 * Encodes a PNG into memory: *png is malloc'ed, *size its bytes.
 * pixel  h x w x n interleaved, n = 1 (grey) or 3; bits = 8: unsigned char, 16: unsigned short
 */
int gd_plugin_png(unsigned char **png, size_t *size, const void *pixel, int w, int h, int n,
		  int bits, struct gd_err *err);

/*
 * Scene-linear RGB to what a display shows, 0 .. 1, in place.
 * rgb      n pixels of three interleaved floats
 * display  NULL: the configuration's default; view: NULL: that display's default
 * The configuration is $OCIO's; without one, a built-in: display "sRGB" with the views "Standard"
 * (the sRGB curve) and "Raw" (no change), for radiance with Rec. 709 primaries. An $OCIO that
 * cannot be read is an error, and so is a display or view that it does not have (the text lists
 * them).
 */
int gd_plugin_display(float *rgb, size_t n, const char *display, const char *view,
		      struct gd_err *err);

#endif
