/* SPDX-License-Identifier: BSD-3-Clause */
#include "render/scene.h"

#include <stdlib.h>

#include "render/impl.h"

/* Corners and material of every triangle exist, and so do the textures of every material. */
static int check(const struct gd_scene *s, struct gd_err *err)
{
	if (!s->ntriangle || !s->nvertex)
		return gd_fail(err, GD_ESHAPE, "the scene has no triangles");
	if (s->ntriangle >= GD_NO_INDEX || s->nvertex >= GD_NO_INDEX)
		return gd_fail(err, GD_ESHAPE, "%zu triangles of %zu vertices, at most %u each",
			       s->ntriangle, s->nvertex, GD_NO_INDEX - 1);
	for (size_t i = 0; i < s->ntriangle; i++) {
		const struct gd_triangle *t = &s->triangle[i];

		if (t->vertex[0] >= s->nvertex || t->vertex[1] >= s->nvertex ||
		    t->vertex[2] >= s->nvertex || t->material >= s->nmaterial)
			return gd_fail(err, GD_ESHAPE, "triangle %zu uses a vertex or material "
				       "that is not there", i);
	}
	for (size_t i = 0; i < s->nmaterial; i++) {
		const struct gd_material *m = &s->material[i];
		const uint32_t map[3] = { m->base_map, m->rough_map, m->emission_map };

		for (int k = 0; k < 3; k++)
			if (map[k] != GD_NO_INDEX && map[k] >= s->ntexture)
				return gd_fail(err, GD_ESHAPE,
					       "material %zu uses a texture that is not there", i);
	}
	return GD_OK;
}

static void bound(struct gd_scene *s)
{
	struct gd_v3 low = gd_v3(INFINITY, INFINITY, INFINITY), high = gd_scale(low, -1);

	for (size_t i = 0; i < s->ntriangle; i++)
		for (int k = 0; k < 3; k++) {
			const struct gd_v3 v = s->vertex[s->triangle[i].vertex[k]];

			low = gd_v3(fminf(low.x, v.x), fminf(low.y, v.y), fminf(low.z, v.z));
			high = gd_v3(fmaxf(high.x, v.x), fmaxf(high.y, v.y), fmaxf(high.z, v.z));
		}
	s->low = low;
	s->high = high;
}

static void find_normals(struct gd_scene *scene)
{
	for (size_t i = 0; i < scene->ntriangle; i++) {
		struct gd_triangle *t = &scene->triangle[i];

		t->normal = gd_v3(0, 0, 1);
		gd_triangle_normal(scene, t, &t->normal);
	}
}

int gd_scene_finish(struct gd_scene *scene, struct gd_err *err)
{
	int rc = check(scene, err);

	if (rc != GD_OK)
		return rc;
	bound(scene);
	find_normals(scene);
	rc = gd_environment_prepare(scene, err);
	if (rc == GD_OK)
		rc = gd_light_prepare(scene, err);
	if (rc == GD_OK)
		rc = gd_ray_prepare(scene, err);
	return rc;
}

void gd_scene_free(struct gd_scene *scene)
{
	if (!scene)
		return;
	gd_ray_drop(scene);
	for (size_t i = 0; i < scene->ntexture; i++)
		free(scene->texture[i].rgb);
	free(scene->texture);
	free(scene->environment.rgb);
	free(scene->environment.row_cdf);
	free(scene->environment.column_cdf);
	free(scene->vertex);
	free(scene->normal);
	free(scene->uv);
	free(scene->triangle);
	free(scene->material);
	free(scene->light);
	free(scene->light_cdf);
	free(scene);
}
