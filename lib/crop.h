/* SPDX-License-Identifier: BSD-3-Clause */
/* A part of an image that a command line asks for. */
#ifndef GD_CROP_H
#define GD_CROP_H

#include "image.h"

/*
 * Reads "X0,X1,Y0,Y1" for an image of w x h: columns X0 .. X1 - 1, rows Y0 .. Y1 - 1, counted from
 * its upper left pixel. X1 or Y1 below 0 is a size: "10,-64,20,-48" are 64 x 48 pixels from
 * (10, 20). box is inclusive. NULL asks for all. GD_EARG if it is not that or empty, GD_ESHAPE if
 * it is not inside.
 */
int gd_crop_parse(struct gd_box *box, const char *text, int w, int h, struct gd_err *err);

/* The part of p inside box. */
struct gd_plane gd_crop_plane(struct gd_plane p, struct gd_box box);

#endif
