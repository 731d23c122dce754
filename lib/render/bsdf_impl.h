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

/* The frame about n; see bsdf.c. */
struct gd_frame gd_bsdf_frame(struct gd_v3 n);

#endif
