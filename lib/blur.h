/* SPDX-License-Identifier: BSD-3-Clause */
/* Separable blur of planes with borders by normalisation: taps beyond the border are left out. */
#ifndef GD_BLUR_H
#define GD_BLUR_H

#include "gd.h"
#include "kernel/poisson_prep.h"
#include "plane.h"

struct gd_blur {
	int taps;
	float tap[GD_PREP_TAPS];
};

struct gd_blur gd_blur_gauss(double sigma);	/* sigma in pixels, up to 10; 0: does nothing */
struct gd_blur gd_blur_box(int side);		/* odd */

/* Rows of work space for one thread, in floats. */
size_t gd_blur_work(int w);

/* to = in blurred downwards, then row by row: call gd_blur_row(). to must not overlap in. */
void gd_blur_down(struct gd_plane to, struct gd_plane in, const struct gd_blur *blur);

/* Row y of the blurred plane, from what gd_blur_down()
 * left; valid until the next call with this work. */
const float *gd_blur_row(struct gd_plane down, int y, const struct gd_blur *blur, float *work);

/* p = p blurred, by way of spare (of the same size). */
int gd_blur_plane(struct gd_plane p, struct gd_plane spare, const struct gd_blur *blur,
		  struct gd_err *err);

#endif
