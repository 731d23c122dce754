/* SPDX-License-Identifier: BSD-3-Clause */
#include "render/gltf.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "render/impl.h"

#define PI 3.14159265358979323846

/* A direction of a node's space in the world, of length 1; 0 if the node has no such. */
static struct gd_v3 axis(const struct gd_gltf_node *n, int column, double sign)
{
	double v[3], most = 0, l;

	for (int i = 0; i < 3; i++) {
		v[i] = sign * n->m[i][column];
		most = fmax(most, fabs(v[i]));
	}
	if (!(most > 0) || !isfinite(most))
		return gd_v3(0, 0, 0);
	l = most * sqrt(v[0] / most * (v[0] / most) + v[1] / most * (v[1] / most) +
			v[2] / most * (v[2] / most));
	return gd_v3((float)(v[0] / l), (float)(v[1] / l), (float)(v[2] / l));
}

static struct gd_v3 place(const struct gd_gltf_node *n)
{
	return gd_v3((float)n->m[0][3], (float)n->m[1][3], (float)n->m[2][3]);
}

/* --- camera --- */

static const cJSON *item(const cJSON *array, size_t i)
{
	return i < (size_t)cJSON_GetArraySize(array) ? cJSON_GetArrayItem(array, (int)i) : NULL;
}

/* The camera of a node, or NULL. */
static const cJSON *camera_of(const struct gd_gltf *g, const struct gd_gltf_node *n)
{
	size_t i;

	return gd_json_index(n->json, "camera", &i) ? item(gd_json_get(g->json, "cameras"), i) :
						      NULL;
}

static bool is_called(const cJSON *o, const char *name)
{
	const char *text = gd_json_text(o, "name");

	return text && !strcmp(text, name);
}

static int no_such_camera(const struct gd_gltf *g, const char *name, struct gd_err *err)
{
	char list[300] = "";
	size_t n = 0;

	for (size_t k = 0; k < g->norder && n < sizeof(list) - 1; k++) {
		const struct gd_gltf_node *node = &g->node[g->order[k]];
		const cJSON *camera = camera_of(g, node);
		const char *text = gd_json_text(node->json, "name");

		if (!camera)
			continue;
		if (!text)
			text = gd_json_text(camera, "name");
		n += (size_t)snprintf(list + n, sizeof(list) - n, "%s\"%s\"", n ? ", " : "",
				      text ? text : "");
	}
	return gd_fail(err, GD_EARG, "%s: no camera \"%.100s\", there is %s", g->path, name, list);
}

/* By the name of the node or of the camera; nodes first. */
static const struct gd_gltf_node *find_camera(const struct gd_gltf *g, const char *name)
{
	for (int by_node = 1; by_node >= 0; by_node--)
		for (size_t k = 0; k < g->norder; k++) {
			const struct gd_gltf_node *n = &g->node[g->order[k]];
			const cJSON *camera = camera_of(g, n);

			if (camera && (!name || is_called(by_node ? n->json : camera, name)))
				return n;
		}
	return NULL;
}

static int set_view(const struct gd_gltf *g, struct gd_scene *s,
		    const struct gd_scene_options *options, struct gd_err *err)
{
	const struct gd_gltf_node *n = find_camera(g, options->camera);
	struct gd_view *v = &s->view;
	const cJSON *camera;
	double yfov;

	if (!n && options->camera && find_camera(g, NULL))
		return no_such_camera(g, options->camera, err);
	if (!n)
		return gd_fail(err, GD_ESHAPE, "%s: no camera", g->path);
	camera = camera_of(g, n);
	yfov = gd_json_double(gd_json_get(camera, "perspective"), "yfov", 0);
	if (!(yfov > 0 && yfov < PI))
		return gd_fail(err, GD_EFORMAT, "%s: the camera is not a perspective one with a "
						"field of view within 0 .. 180 degrees", g->path);
	v->origin = place(n);
	v->forward = axis(n, 2, -1);
	v->right = gd_cross(v->forward, axis(n, 1, 1));
	if (!(gd_dot(v->right, v->right) > 1e-12f) || !gd_finite(v->origin))
		return gd_fail(err, GD_EFORMAT, "%s: the camera's node has no direction", g->path);
	v->right = gd_unit(v->right);
	v->up = gd_cross(v->right, v->forward);
	v->tan_y = (float)tan(yfov / 2);
	v->tan_x = (float)(tan(yfov / 2) * options->w / options->h);
	v->lens = options->aperture;
	v->focus = options->focus;
	return GD_OK;
}

/* The plane in focus goes through what is seen at the centre of the image. */
static void set_focus(struct gd_scene *s, const struct gd_report *report, const char *path)
{
	struct gd_hit hit;

	if (gd_ray_hit(s, s->view.origin, s->view.forward, &hit)) {
		s->view.focus = hit.t;
		return;
	}
	s->view.focus = fmaxf(gd_length(gd_sub(gd_scale(gd_add(s->low, s->high), 0.5f),
					       s->view.origin)), 1e-6f);
	if (s->view.lens > 0)
		gd_note(report, "%s: nothing at the centre of the image to focus on: the plane in "
				"focus is %g away, like the centre of the scene", path,
			(double)s->view.focus);
}

/* --- lights --- */

static bool set_light(struct gd_light *l, const struct gd_gltf_node *n, const cJSON *json)
{
	const cJSON *spot = gd_json_get(json, "spot");
	const char *type = gd_json_text(json, "type");
	const double power = gd_json_double(json, "intensity", 1);
	double c[3] = { 1, 1, 1 };

	gd_json_numbers(gd_json_get(json, "color"), c, 3);
	*l = (struct gd_light){ .position = place(n), .direction = axis(n, 2, -1) };
	l->intensity = gd_v3((float)fmin(fmax(c[0] * power, 0), 1e30),
			     (float)fmin(fmax(c[1] * power, 0), 1e30),
			     (float)fmin(fmax(c[2] * power, 0), 1e30));
	l->cos_inner = (float)cos(gd_json_double(spot, "innerConeAngle", 0));
	l->cos_outer = (float)cos(gd_json_double(spot, "outerConeAngle", PI / 4));
	if (type && !strcmp(type, "point"))
		l->kind = GD_POINT;
	else if (type && !strcmp(type, "spot"))
		l->kind = GD_SPOT;
	else if (type && !strcmp(type, "directional"))
		l->kind = GD_DIRECTIONAL;
	else
		return false;
	return !gd_black(l->intensity) && gd_finite(l->position) &&
	       (l->kind == GD_POINT || !gd_black(l->direction));
}

static int add_lights(const struct gd_gltf *g, struct gd_scene *s, struct gd_err *err)
{
	const cJSON *lights = gd_json_get(gd_json_extension(g->json, "KHR_lights_punctual"),
					  "lights");

	s->light = gd_calloc(g->norder + 1, sizeof(*s->light));
	if (!s->light)
		return gd_fail(err, GD_ENOMEM, "%s: out of memory", g->path);
	for (size_t k = 0; k < g->norder; k++) {
		const struct gd_gltf_node *n = &g->node[g->order[k]];
		const cJSON *json;
		size_t i;

		if (!gd_json_index(gd_json_extension(n->json, "KHR_lights_punctual"), "light", &i))
			continue;
		json = item(lights, i);
		if (json && set_light(&s->light[s->nlight], n, json))
			s->nlight++;
		else
			gd_warn(g->report, "%s: a light that is black or damaged is left out",
				g->path);
	}
	return GD_OK;
}

/* --- all of it --- */

static int check_options(const struct gd_scene_options *o, struct gd_err *err)
{
	const struct gd_v3 sky = o->sky;

	if (o->w < 1 || o->h < 1)
		return gd_fail(err, GD_EARG, "an image of %dx%d pixels", o->w, o->h);
	if (!(sky.x >= 0 && sky.y >= 0 && sky.z >= 0 && gd_largest(sky) <= GD_SKY_MAX))
		return gd_fail(err, GD_EARG, "the sky's radiance is %g %g %g, wanted 0 to %g",
			       (double)sky.x, (double)sky.y, (double)sky.z, (double)GD_SKY_MAX);
	if (o->environment && !gd_black(sky))
		return gd_fail(err, GD_EARG, "both an environment and a constant sky");
	if (!(o->aperture >= 0 && o->aperture < 1e15f && o->focus >= 0 && o->focus < 1e15f))
		return gd_fail(err, GD_EARG, "aperture %g and focus %g: wanted lengths >= 0",
			       (double)o->aperture, (double)o->focus);
	return GD_OK;
}

static int read_file(struct gd_gltf *g, struct gd_scene *s, const struct gd_scene_options *o,
		     struct gd_err *err)
{
	int rc = gd_gltf_nodes(g, err);

	if (rc == GD_OK)
		rc = gd_gltf_materials(g, s, err);
	if (rc == GD_OK)
		rc = gd_gltf_geometry(g, s, err);
	if (rc == GD_OK)
		rc = set_view(g, s, o, err);
	return rc == GD_OK ? add_lights(g, s, err) : rc;
}

static int finish(struct gd_scene *s, const char *path, const struct gd_scene_options *o,
		  const struct gd_report *report, struct gd_err *err)
{
	int rc;

	s->environment.constant = o->sky;
	if (o->environment) {
		rc = gd_environment_read(&s->environment, o->environment, report, err);
		if (rc != GD_OK)
			return rc;
	}
	rc = gd_scene_finish(s, err);
	if (rc != GD_OK)
		return rc;
	if (!s->nlight || !(s->light_cdf[s->nlight] > 0))
		return gd_fail(err, GD_ESHAPE, "%s: no light: nothing emits, there is no light "
					       "source, and no environment is given", path);
	if (!(s->view.focus > 0))
		set_focus(s, report, path);
	return GD_OK;
}

int gd_scene_load(struct gd_scene **scene, const char *path, const struct gd_scene_options *options,
		  const struct gd_report *report, struct gd_err *err)
{
	struct gd_gltf g = { 0 };
	struct gd_scene *s;
	int rc = check_options(options, err);

	*scene = NULL;
	if (rc != GD_OK)
		return rc;
	s = calloc(1, sizeof(*s));
	if (!s)
		return gd_fail(err, GD_ENOMEM, "%s: out of memory", path);
	rc = gd_gltf_open(&g, path, report, err);
	if (rc == GD_OK)
		rc = read_file(&g, s, options, err);
	gd_gltf_close(&g);
	if (rc == GD_OK)
		rc = finish(s, path, options, report, err);
	if (rc != GD_OK) {
		gd_scene_free(s);
		return rc;
	}
	*scene = s;
	return GD_OK;
}
