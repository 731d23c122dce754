/* SPDX-License-Identifier: BSD-3-Clause */
/* What the files behind scene.h share, and nobody else. */
#ifndef GD_RENDER_IMPL_H
#define GD_RENDER_IMPL_H

#include "image.h"
#include "render/scene.h"

/*
 * Distribution of n weights (>= 0, finite) as a step function for numbers of 24 bits: cdf[n + 1],
 * from 0 to 1, is made of whole multiples of 2^-24, and every weight above 0 has at least one of
 * them while there are less than 2^24 of those. cdf[i + 1] - cdf[i] is thus the exact probability
 * of i. If no weight is above 0, all is 0. Returns their sum.
 */
double gd_cdf_fill(float *cdf, const double *weight, size_t n);
/* The i with cdf[i] <= x < cdf[i + 1]; x in [0, 1). */
size_t gd_cdf_find(const float *cdf, size_t n, float x);

/* Steps of gd_scene_finish(). */
int gd_environment_prepare(struct gd_scene *scene, struct gd_err *err);
int gd_light_prepare(struct gd_scene *scene, struct gd_err *err);
int gd_ray_prepare(struct gd_scene *scene, struct gd_err *err);
void gd_ray_drop(struct gd_scene *scene);

/* The channels R G B of an image, or Y three times; false if it has neither. */
bool gd_find_rgb(const struct gd_image *im, int channel[3]);

/* Fills w, h and rgb. */
int gd_environment_read(struct gd_environment *e, const char *path, const struct gd_report *report,
			struct gd_err *err);
/* Sum of luminance x solid angle over all directions. */
double gd_environment_flux(const struct gd_scene *scene);
/* A direction drawn from the environment; density without the choice of the light. */
struct gd_v3 gd_environment_draw(const struct gd_scene *scene, float u, float v);
float gd_environment_density(const struct gd_scene *scene, struct gd_v3 d);

#define GD_FARTHEST 1e15f	/* metres: products of three coordinates do not overflow */

/* (b - a) x (c - a): along the normal, twice the area long. In doubles: that of a needle, too, is
 * exact. */
static inline void gd_triangle_cross(const struct gd_scene *s, const uint32_t vertex[3],
				     double n[3])
{
	const struct gd_v3 a = s->vertex[vertex[0]], b = s->vertex[vertex[1]],
			   c = s->vertex[vertex[2]];
	const double e[3] = { (double)b.x - a.x, (double)b.y - a.y, (double)b.z - a.z },
		     f[3] = { (double)c.x - a.x, (double)c.y - a.y, (double)c.z - a.z };

	n[0] = e[1] * f[2] - e[2] * f[1];
	n[1] = e[2] * f[0] - e[0] * f[2];
	n[2] = e[0] * f[1] - e[1] * f[0];
}

/* Of length 1; false, and out alone, for a triangle without area. */
static inline bool gd_triangle_normal(const struct gd_scene *s, const struct gd_triangle *t,
				      struct gd_v3 *n)
{
	double c[3], l;

	gd_triangle_cross(s, t->vertex, c);
	l = sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2]);
	if (!(l > 1e-36 && l < 1e36))	/* square metres */
		return false;
	*n = gd_v3((float)(c[0] / l), (float)(c[1] / l), (float)(c[2] / l));
	return true;
}

/* The point a + u (b - a) + v (c - a), rounded once: rays know by that that they start on it. */
static inline struct gd_v3 gd_point_in(const struct gd_scene *s, const struct gd_triangle *t,
				       float u, float v)
{
	const struct gd_v3 a = s->vertex[t->vertex[0]], b = s->vertex[t->vertex[1]],
			   c = s->vertex[t->vertex[2]];
	const double p = (double)u, q = (double)v;

	return gd_v3((float)(a.x + p * ((double)b.x - a.x) + q * ((double)c.x - a.x)),
		     (float)(a.y + p * ((double)b.y - a.y) + q * ((double)c.y - a.y)),
		     (float)(a.z + p * ((double)b.z - a.z) + q * ((double)c.z - a.z)));
}

/* Texture coordinates of a point of a triangle; b: weight of its corners. 0 without any. */
static inline void gd_uv_at(const struct gd_scene *s, const struct gd_triangle *t, const float b[3],
			    float uv[2])
{
	for (int k = 0; k < 2; k++)
		uv[k] = s->uv ? b[0] * s->uv[2 * (size_t)t->vertex[0] + k] +
					b[1] * s->uv[2 * (size_t)t->vertex[1] + k] +
					b[2] * s->uv[2 * (size_t)t->vertex[2] + k] :
				0;
}

#endif
