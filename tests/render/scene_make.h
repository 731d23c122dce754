/* SPDX-License-Identifier: BSD-3-Clause */
/* Scenes made by hand, and random numbers, for tests of the renderer. */
#ifndef SCENE_MAKE_H
#define SCENE_MAKE_H

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "render/scene.h"

#define PI 3.14159265358979323846

static uint64_t scene_seed = 1;

static inline double rnd(void)
{
	scene_seed = scene_seed * 6364136223846793005u + 1442695040888963407u;
	return (double)(scene_seed >> 40) * 0x1p-24;
}

static inline struct gd_v3 rnd_direction(void)
{
	const double z = 2 * rnd() - 1, phi = 2 * PI * rnd(), r = sqrt(1 - z * z);

	return gd_v3((float)(r * cos(phi)), (float)(r * sin(phi)), (float)z);
}

/* Room for triangles; one grey material; no texture coordinates. */
static inline struct gd_scene *scene_new(size_t triangles, size_t vertices)
{
	struct gd_scene *s = calloc(1, sizeof(*s));

	s->vertex = calloc(vertices + 1, sizeof(*s->vertex));
	s->normal = calloc(vertices + 1, sizeof(*s->normal));
	s->triangle = calloc(triangles + 1, sizeof(*s->triangle));
	s->material = calloc(4, sizeof(*s->material));
	for (int i = 0; i < 4; i++)
		s->material[i] = (struct gd_material){ .base = { 0.5f, 0.5f, 0.5f },
						       .ior = 1.5f,
						       .roughness = 1,
						       .base_map = GD_NO_INDEX,
						       .rough_map = GD_NO_INDEX,
						       .emission_map = GD_NO_INDEX };
	s->nmaterial = 4;
	return s;
}

/* A triangle with corners of its own. */
static inline uint32_t scene_add(struct gd_scene *s, struct gd_v3 a, struct gd_v3 b, struct gd_v3 c,
				 uint32_t material)
{
	const uint32_t k = (uint32_t)s->nvertex;

	s->vertex[k] = a;
	s->vertex[k + 1] = b;
	s->vertex[k + 2] = c;
	s->nvertex += 3;
	s->triangle[s->ntriangle] = (struct gd_triangle){ .vertex = { k, k + 1, k + 2 },
							 .material = material };
	return (uint32_t)s->ntriangle++;
}

/* A sphere of 4 n (n - 1) triangles, outward, with shared corners and the sphere's normals. */
static inline struct gd_scene *scene_sphere(struct gd_v3 centre, float radius, int n)
{
	struct gd_scene *s = scene_new((size_t)(4 * n * n), (size_t)((n + 1) * 2 * n));

	for (int i = 0; i <= n; i++)
		for (int j = 0; j < 2 * n; j++) {
			const double a = PI * i / n, b = PI * j / n;
			const struct gd_v3 d = i == 0 ? gd_v3(0, 1, 0) :
					       i == n ? gd_v3(0, -1, 0) :
							gd_v3((float)(sin(a) * cos(b)),
							      (float)cos(a),
							      (float)(-sin(a) * sin(b)));

			s->normal[s->nvertex] = d;
			s->vertex[s->nvertex++] = gd_mad(centre, radius, d);
		}
	for (int i = 0; i < n; i++)
		for (int j = 0; j < 2 * n; j++) {
			const uint32_t w = (uint32_t)(2 * n), a = (uint32_t)i * w + (uint32_t)j,
				       b = (uint32_t)i * w + (uint32_t)((j + 1) % (2 * n));

			if (i > 0)
				s->triangle[s->ntriangle++] =
					(struct gd_triangle){ .vertex = { a, b + w, b } };
			if (i < n - 1)
				s->triangle[s->ntriangle++] =
					(struct gd_triangle){ .vertex = { a, a + w, b + w } };
		}
	return s;
}

#endif
