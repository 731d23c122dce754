/* SPDX-License-Identifier: BSD-3-Clause */
/* Four materials at once: what bsdf.h says of label GD_ROUGH, to a few roundings. */
#ifndef GD_RENDER_BSDF4_H
#define GD_RENDER_BSDF4_H

#include "render/bsdf.h"
#include "render/four.h"

/* What values of GD_ROUGH take, as struct gd_bsdf has it; wo mirrored so that wo.z > 0. */
struct gd_bsdf4 {
	struct gd_v34 x, y, n;		/* frame */
	struct gd_v34 ng, wo, diffuse, f0, pass;
	gd_f4 metallic, alpha, up, eta, reflected, slant;
	gd_f4 chance, share[3];		/* of GD_ROUGH; inside it */
};

/* Those of four vertices; NULL: one that scatters nothing. */
void gd_bsdf4_gather(struct gd_bsdf4 *b, const struct gd_bsdf *const from[4]);

/* gd_bsdf_turn() to four directions; the lanes where it returns true. */
gd_i4 gd_bsdf4_turn(struct gd_bsdf4 *turned, const struct gd_bsdf *b, const struct gd_v34 *wo);

/* gd_bsdf_rough() of each lane, towards its wi. */
struct gd_v34 gd_bsdf4_rough(const struct gd_bsdf4 *b, const struct gd_v34 *wi, gd_f4 *pdf);

/* Where the lane comes from, in world space, length 1. */
struct gd_v3 gd_bsdf4_wo(const struct gd_bsdf4 *b, int k);

#endif
