/* SPDX-License-Identifier: BSD-3-Clause */
/* Inside bsdf.c and bsdf4.c. */
#ifndef GD_RENDER_BSDF_IMPL_H
#define GD_RENDER_BSDF_IMPL_H

#include "render/bsdf.h"

#define GD_BSDF_PI	3.14159265f
#define GD_BSDF_FLAT	1e-6f	/* cosine; floats do not tell the sides of a surface apart below */
#define GD_BSDF_LEAST	0.05f	/* of all energy: what a lobe that is there gets of the samples */
#define GD_BSDF_FAINT	1e-4f	/* energy of a lobe that is there but not in the direction looked
				   at */

enum gd_lobe { GD_DIFFUSE, GD_REFLECTION, GD_TRANSMISSION };

/* v mirrored at the plane through 0 that r is normal to. */
static inline struct gd_v3 gd_bsdf_mirrored(struct gd_v3 v, struct gd_v3 r, float r2)
{
	return gd_mad(v, -2 * gd_dot(v, r) / r2, r);
}

/*
 * The frame that the shortest turn from a fixed frame to n gives. It is continuous but around one
 * direction, which no plane of a model is likely to have: neighbouring points of a flat floor,
 * whose normals differ by rounding, must have nearly the same frame if copies shall be alike.
 * Mirroring at n + z takes z to -n, and x and y to where they belong, without cancellation.
 */
static inline struct gd_frame gd_bsdf_frame(struct gd_v3 n)
{
	static const struct gd_v3 x = { 0.8f, 0, -0.6f }, y = { -0.36f, 0.8f, -0.48f };
	static const struct gd_v3 z = { 0.48f, 0.6f, 0.64f };
	struct gd_v3 r = gd_add(n, z);
	float r2 = gd_dot(r, r), s = 1;

	if (r2 < 1e-6f) {	/* n = -z: from the frame x, -y, -z */
		r = gd_sub(n, z);
		r2 = gd_dot(r, r);
		s = -1;
	}
	return (struct gd_frame){ gd_bsdf_mirrored(x, r, r2),
				  gd_scale(gd_bsdf_mirrored(y, r, r2), s), n };
}

#endif
