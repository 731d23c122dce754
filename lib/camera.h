/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * The camera behind a frame, found from the world positions that its pixels show: the projection
 *	(x w, y w, w)' = M (X, Y, Z, 1)'
 * of least squares over the pixels. With it a point seen in one frame is found in another.
 */
#ifndef GD_CAMERA_H
#define GD_CAMERA_H

#include <stdbool.h>

#include "gd.h"
#include "plane.h"

struct gd_camera {
	double m[3][4];
	double rms;	/* typical distance of points from where they are projected to, pixels */
};

/*
 * position: X Y Z of the surface in each pixel, in any unit; 0 0 0 or not finite: none. Pixels that
 * mix surfaces may be far off, as long as most do not. Returns false if fewer than 12 pixels have a
 * position. Lenses that bend straight lines show in rms.
 */
bool gd_camera_fit(struct gd_camera *camera, const struct gd_plane position[3]);

/* The pixel (centre of pixel 0: 0) that shows point p. Returns false if p is behind the camera. */
bool gd_camera_project(const struct gd_camera *camera, const double p[3], double *x, double *y);

#endif
