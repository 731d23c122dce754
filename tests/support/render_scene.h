/* SPDX-License-Identifier: BSD-3-Clause */
/* Scenes made by hand, in memory. Running out of memory ends the test program. */
#ifndef RENDER_SCENE_H
#define RENDER_SCENE_H

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "render/scene.h"

#define PI_ 3.14159265358979323846

static inline void *grown(void *p, size_t n, size_t size)
{
	p = realloc(p, n * size);
	if (!p)
		abort();
	return p;
}

static inline struct gd_scene *scene_new(void)
{
	struct gd_scene *s = calloc(1, sizeof *s);

	if (!s)
		abort();
	s->environment_light = GD_NO_INDEX;
	return s;
}

/* --- materials --- */

/* Grey and of index 1: without a reflection, a Lambert surface if nothing else is said. */
static inline struct gd_material matter(float base)
{
	return (struct gd_material){ .base = { base, base, base }, .roughness = 1, .ior = 1,
				     .base_map = GD_NO_INDEX, .rough_map = GD_NO_INDEX,
				     .emission_map = GD_NO_INDEX };
}

static inline struct gd_material tinted(float r, float g, float b)
{
	struct gd_material m = matter(0);

	m.base = gd_v3(r, g, b);
	return m;
}

static inline struct gd_material plastic(float base, float roughness)
{
	struct gd_material m = matter(base);

	m.ior = 1.5f;
	m.roughness = roughness;
	return m;
}

static inline struct gd_material metal(float base, float roughness)
{
	struct gd_material m = plastic(base, roughness);

	m.metallic = 1;
	return m;
}

static inline struct gd_material glass(float roughness)
{
	struct gd_material m = plastic(1, roughness);

	m.transmission = 1;
	return m;
}

/* Black but for its light. */
static inline struct gd_material lamp(float radiance)
{
	struct gd_material m = matter(0);

	m.emission = gd_v3(radiance, radiance, radiance);
	return m;
}

static inline uint32_t add_material(struct gd_scene *s, struct gd_material m)
{
	s->material = grown(s->material, s->nmaterial + 1, sizeof *s->material);
	s->material[s->nmaterial] = m;
	return (uint32_t)s->nmaterial++;
}

/* --- shapes --- */

static inline uint32_t add_vertex(struct gd_scene *s, struct gd_v3 p, struct gd_v3 n)
{
	s->vertex = grown(s->vertex, s->nvertex + 1, sizeof *s->vertex);
	s->normal = grown(s->normal, s->nvertex + 1, sizeof *s->normal);
	s->vertex[s->nvertex] = p;
	s->normal[s->nvertex] = n;
	return (uint32_t)s->nvertex++;
}

static inline void add_triangle(struct gd_scene *s, uint32_t a, uint32_t b, uint32_t c, uint32_t m)
{
	s->triangle = grown(s->triangle, s->ntriangle + 1, sizeof *s->triangle);
	s->triangle[s->ntriangle++] = (struct gd_triangle){ .vertex = { a, b, c }, .material = m,
							     .light = GD_NO_INDEX };
}

/* A parallelogram from corner o along e and f; its normal is e x f. */
static inline void add_quad(struct gd_scene *s, struct gd_v3 o, struct gd_v3 e, struct gd_v3 f,
			    uint32_t m)
{
	const struct gd_v3 n = gd_unit(gd_cross(gd_unit(e), gd_unit(f)));
	const uint32_t a = add_vertex(s, o, n), b = add_vertex(s, gd_add(o, e), n);
	const uint32_t c = add_vertex(s, gd_add(gd_add(o, e), f), n);
	const uint32_t d = add_vertex(s, gd_add(o, f), n);

	add_triangle(s, a, b, c, m);
	add_triangle(s, a, c, d, m);
}

/* A box from low to high; m: materials of -x +x -y +y -z +z; normals outwards, or inwards. */
static inline void add_box(struct gd_scene *s, struct gd_v3 low, struct gd_v3 high,
			   const uint32_t m[6], bool inwards)
{
	const struct gd_v3 d = gd_sub(high, low);
	const struct gd_v3 e[3] = { gd_v3(d.x, 0, 0), gd_v3(0, d.y, 0), gd_v3(0, 0, d.z) };

	for (int k = 0; k < 6; k++) {
		const struct gd_v3 o = k & 1 ? gd_add(low, e[k / 2]) : low;
		const struct gd_v3 f = e[(k / 2 + 1) % 3], g = e[(k / 2 + 2) % 3];

		if ((k & 1) != inwards)
			add_quad(s, o, f, g, m[k]);
		else
			add_quad(s, o, g, f, m[k]);
	}
}

/* A ball of 2 n (n - 1) x 2 triangles; round: its shading normals are those of the sphere. */
static inline void add_ball(struct gd_scene *s, struct gd_v3 c, float radius, int n, bool round,
			    uint32_t m)
{
	const uint32_t first = (uint32_t)s->nvertex;

	for (int i = 0; i <= n; i++)
		for (int j = 0; j <= 2 * n; j++) {
			const double t = PI_ * i / n, p = PI_ * (j % (2 * n)) / n;
			const struct gd_v3 d = gd_v3((float)(sin(t) * cos(p)), (float)cos(t),
						     (float)(sin(t) * sin(p)));

			add_vertex(s, gd_mad(c, radius, d), round ? d : gd_v3(0, 0, 0));
		}
	for (int i = 0; i < n; i++)
		for (int j = 0; j < 2 * n; j++) {
			const uint32_t a = first + (uint32_t)(i * (2 * n + 1) + j);
			const uint32_t b = a + (uint32_t)(2 * n + 1);

			if (i + 1 < n)
				add_triangle(s, a, b + 1, b, m);
			if (i > 0)
				add_triangle(s, a, a + 1, b + 1, m);
		}
}

/* --- lights and views --- */

static inline struct gd_light *add_light(struct gd_scene *s, enum gd_light_kind kind,
					 float intensity)
{
	s->light = grown(s->light, s->nlight + 1, sizeof *s->light);
	s->light[s->nlight] = (struct gd_light){ .kind = kind,
						 .intensity = { intensity, intensity, intensity } };
	return &s->light[s->nlight++];
}

static inline void add_point(struct gd_scene *s, struct gd_v3 at, float intensity)
{
	add_light(s, GD_POINT, intensity)->position = at;
}

static inline void add_spot(struct gd_scene *s, struct gd_v3 at, struct gd_v3 towards, float inner,
			    float outer, float intensity)
{
	struct gd_light *l = add_light(s, GD_SPOT, intensity);

	l->position = at;
	l->direction = gd_unit(gd_sub(towards, at));
	l->cos_inner = cosf(inner);
	l->cos_outer = cosf(outer);
}

static inline void add_sun(struct gd_scene *s, struct gd_v3 direction, float irradiance)
{
	add_light(s, GD_DIRECTIONAL, irradiance)->direction = gd_unit(direction);
}

static inline void add_sky(struct gd_scene *s, float radiance)
{
	s->environment.constant = gd_v3(radiance, radiance, radiance);
}

/* A sky that is brightest around one direction, of w x w / 2 pixels. */
static inline void add_sky_map(struct gd_scene *s, int w)
{
	const int h = w / 2;

	s->environment.w = w;
	s->environment.h = h;
	s->environment.rgb = grown(NULL, (size_t)w * (size_t)h * 3, sizeof(float));
	for (int i = 0; i < w * h; i++) {
		const double t = PI_ * (i / w + 0.5) / h, p = 2 * PI_ * (i % w + 0.5) / w;
		const double c = 0.5 * cos(t) + 0.8 * sin(t) * cos(p - 2);

		s->environment.rgb[3 * i] = (float)(0.1 + 0.3 * exp(4 * c));
		s->environment.rgb[3 * i + 1] = (float)(0.2 + 0.2 * exp(4 * c));
		s->environment.rgb[3 * i + 2] = (float)(0.4 + 0.1 * exp(4 * c));
	}
}

/* tan_y: of half the height of the field of view. */
static inline void look_at(struct gd_scene *s, struct gd_v3 from, struct gd_v3 to, float tan_y,
			   float aspect)
{
	const struct gd_v3 f = gd_unit(gd_sub(to, from));
	const struct gd_v3 up = fabsf(f.y) > 0.999f ? gd_v3(0, 0, -1) : gd_v3(0, 1, 0);

	s->view.origin = from;
	s->view.forward = f;
	s->view.right = gd_unit(gd_cross(f, up));
	s->view.up = gd_cross(s->view.right, f);
	s->view.tan_y = tan_y;
	s->view.tan_x = tan_y * aspect;
	s->view.focus = 1;
}

static inline struct gd_scene *finished(struct gd_scene *s)
{
	struct gd_err err = { 0 };

	if (gd_scene_finish(s, &err) == GD_OK)
		return s;
	fprintf(stderr, "%s\n", err.text);
	abort();
}

#endif
