/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Where the surface that a pixel shows is in another frame of a sequence: its world position,
 * projected by the camera that the other frame's world positions tell of (camera.h). What moves by
 * itself, or is hidden there, is not found.
 */
#ifndef GD_FOLLOW_H
#define GD_FOLLOW_H

#include "gd.h"
#include "plane.h"

/*
 * here, there: X Y Z of the surface in each pixel of the two frames, of one size, any unit; 0 0 0:
 * nothing, which is taken to be where it was. at: for each pixel, row by row, y * w + x in the
 * other frame, or -1. A pixel counts as found if the two points are within 2 sizes of a pixel here.
 * Frames whose cameras positions do not tell (rms above 2 pixels) are compared pixel by pixel.
 */
void gd_follow(int *at, const struct gd_plane here[3], const struct gd_plane there[3]);

#endif
