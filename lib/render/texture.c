/* SPDX-License-Identifier: BSD-3-Clause */
#include "render/scene.h"

/* The two texels of a row (or column) of n around x = u n - 1/2, and the weight of the second. */
static float around(float u, int n, bool clamp, int *a, int *b)
{
	float x, down;

	if (!isfinite(u))
		u = 0;
	u = clamp ? gd_at_most(gd_at_least(u, 0), 1) : u - floorf(u);
	x = u * (float)n - 0.5f;
	*a = (int)x - (x < 0);		/* the floor, as x >= -1/2 */
	down = (float)*a;
	*b = *a + 1;
	if (clamp) {
		*a = *a < 0 ? 0 : *a;
		*b = *b > n - 1 ? n - 1 : *b;
	} else {
		*a = *a < 0 ? n - 1 : *a;
		*b = *b > n - 1 ? 0 : *b;
	}
	return x - down;
}

static struct gd_v3 texel(const struct gd_texture *t, int x, int y)
{
	const float *c = t->rgb + 3 * ((size_t)y * (size_t)t->w + (size_t)x);

	return gd_v3(c[0], c[1], c[2]);
}

static struct gd_v3 mix(struct gd_v3 a, struct gd_v3 b, float f)
{
	return gd_mad(gd_scale(a, 1 - f), f, b);
}

struct gd_v3 gd_texture_at(const struct gd_texture *t, float u, float v)
{
	int x0, x1, y0, y1;
	const float fx = around(u, t->w, t->clamp_u, &x0, &x1);
	const float fy = around(v, t->h, t->clamp_v, &y0, &y1);

	return mix(mix(texel(t, x0, y0), texel(t, x1, y0), fx),
		   mix(texel(t, x0, y1), texel(t, x1, y1), fx), fy);
}
