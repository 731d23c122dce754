/* SPDX-License-Identifier: BSD-3-Clause */
#include "render/scene.h"

#include <stdlib.h>
#include <string.h>

#include "render/impl.h"

#define PI 3.14159265358979323846
#define PDF_MAX 1e30f	/* densities stay finite */
#define PARTS 4		/* a textured emitter is looked at in PARTS^2 parts */
#define EVEN 0.02	/* share of the chances that all lights get alike: a weak one may be near */

/* --- the list --- */

static float area_of(const struct gd_scene *s, const struct gd_triangle *t)
{
	double c[3];

	gd_triangle_cross(s, t->vertex, c);
	return (float)(0.5 * sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2]));
}

static struct gd_v3 emission_at(const struct gd_scene *s, const struct gd_material *m, float u,
				float v)
{
	if (m->emission_map == GD_NO_INDEX || gd_black(m->emission))
		return m->emission;
	return gd_mul(m->emission, gd_texture_at(&s->texture[m->emission_map], u, v));
}

/* Mean luminance of what a triangle emits, from the centres of PARTS^2 equal parts. */
static double mean_emission(const struct gd_scene *s, const struct gd_triangle *t)
{
	const struct gd_material *m = &s->material[t->material];
	double sum = 0;

	if (m->emission_map == GD_NO_INDEX || gd_black(m->emission) || !s->uv)
		return (double)gd_luma(emission_at(s, m, 0, 0));
	for (int i = 0; i < PARTS; i++)
		for (int j = 0; j < 2 * i + 1; j++) {
			const float step = 1.f / (3 * PARTS);
			const float x = (float)(j / 2 * 3 + 1 + j % 2) * step,
				    y = (float)((PARTS - 1 - i) * 3 + 1 + j % 2) * step;
			const float b[3] = { 1 - x - y, x, y };
			float uv[2];

			gd_uv_at(s, t, b, uv);
			sum += (double)gd_luma(emission_at(s, m, uv[0], uv[1]));
		}
	return sum / (PARTS * PARTS);
}

/* Mean luminance of the emission of each material, over all its texture. */
static void mean_of_materials(const struct gd_scene *s, double *mean)
{
	for (size_t i = 0; i < s->nmaterial; i++) {
		const struct gd_material *m = &s->material[i];
		const struct gd_texture *t;
		double sum = 0;

		mean[i] = (double)gd_luma(m->emission);
		if (m->emission_map == GD_NO_INDEX || !(mean[i] > 0))
			continue;
		t = &s->texture[m->emission_map];
		for (size_t k = 0; k < (size_t)t->w * (size_t)t->h; k++)
			sum += (double)gd_luma(gd_mul(m->emission, gd_v3(t->rgb[3 * k],
									 t->rgb[3 * k + 1],
									 t->rgb[3 * k + 2])));
		mean[i] = sum / ((double)t->w * t->h);
	}
}

static double usable(double power)
{
	return power > 0 && power < (double)INFINITY ? power : 0;
}

/* Power of a light other than an area light; disc: that of the scene, in square metres. */
static double power_of(const struct gd_scene *s, const struct gd_light *l, double disc)
{
	const double luma = (double)gd_luma(l->intensity);

	switch (l->kind) {
	case GD_POINT:
		return 4 * PI * luma;
	case GD_SPOT:
		return 2 * PI * (1 - 0.5 * ((double)l->cos_inner + (double)l->cos_outer)) * luma;
	case GD_DIRECTIONAL:
		return disc * luma;
	case GD_ENVIRONMENT:
		return disc * gd_environment_flux(s);
	default:
		return 0;
	}
}

static double disc_of(const struct gd_scene *s)
{
	const double x = (double)s->high.x - s->low.x, y = (double)s->high.y - s->low.y,
		     z = (double)s->high.z - s->low.z;

	return PI * 0.25 * (x * x + y * y + z * z);
}

/* Emissive triangles to the list; weight NULL: they are only counted. */
static size_t add_areas(struct gd_scene *s, const double *mean, struct gd_light *light,
			double *weight)
{
	size_t n = 0;

	for (size_t i = 0; i < s->ntriangle; i++) {
		struct gd_triangle *t = &s->triangle[i];

		t->light = GD_NO_INDEX;
		if (!(mean[t->material] > 0))
			continue;
		if (light) {
			const float area = area_of(s, t);
			/* a hundredth of the texture's mean: no point of it is overlooked */
			const double m = 0.99 * mean_emission(s, t) + 0.01 * mean[t->material];

			light[n] = (struct gd_light){ .kind = GD_AREA, .triangle = (uint32_t)i,
						      .area = area };
			weight[n] = usable(2 * PI * (double)area * m);
		}
		n++;
	}
	return n;
}

/* Chances in proportion to power, but for a small part that all share. */
static int choose_chances(struct gd_scene *s, double *weight, struct gd_err *err)
{
	const size_t n = s->nlight;
	double sum = 0;
	size_t lit = 0;

	s->light_cdf = gd_calloc(n + 1, sizeof(*s->light_cdf));
	if (!s->light_cdf)
		return gd_fail(err, GD_ENOMEM, "out of memory for %zu lights", n);
	for (size_t i = 0; i < n; i++) {
		sum += weight[i];
		lit += weight[i] > 0;
	}
	for (size_t i = 0; i < n; i++)
		if (weight[i] > 0)
			weight[i] = (1 - EVEN) * weight[i] / sum + EVEN / (double)lit;
	gd_cdf_fill(s->light_cdf, weight, n);
	for (size_t i = 0; i < n; i++)
		s->light[i].chance = s->light_cdf[i + 1] - s->light_cdf[i];
	return GD_OK;
}

static int list(struct gd_scene *s, const double *mean, struct gd_err *err)
{
	const size_t given = s->nlight, areas = add_areas(s, mean, NULL, NULL);
	const bool sky = gd_environment_flux(s) > 0;
	const size_t n = given + areas + sky;
	struct gd_light *light = gd_calloc(n + 1, sizeof(*light));
	double *weight = gd_calloc(n + 1, sizeof(*weight));
	const double disc = disc_of(s);
	int rc = GD_OK;

	if (!light || !weight || n >= GD_NO_INDEX) {
		free(light);
		free(weight);
		return gd_fail(err, GD_ENOMEM, "out of memory for %zu lights", n);
	}
	if (given)
		memcpy(light, s->light, given * sizeof(*light));
	add_areas(s, mean, light + given, weight + given);
	for (size_t i = 0; i < areas; i++)
		s->triangle[light[given + i].triangle].light = (uint32_t)(given + i);
	if (sky)
		light[n - 1].kind = GD_ENVIRONMENT;
	s->environment_light = sky ? (uint32_t)(n - 1) : GD_NO_INDEX;
	for (size_t i = 0; i < n; i++)
		if (light[i].kind != GD_AREA)
			weight[i] = usable(power_of(s, &light[i], disc));
	free(s->light);
	s->light = light;
	s->nlight = n;
	rc = choose_chances(s, weight, err);
	free(weight);
	return rc;
}

int gd_light_prepare(struct gd_scene *scene, struct gd_err *err)
{
	double *mean = gd_calloc(scene->nmaterial + 1, sizeof(*mean));
	int rc;

	if (!mean)
		return gd_fail(err, GD_ENOMEM, "out of memory for %zu materials", scene->nmaterial);
	mean_of_materials(scene, mean);
	rc = list(scene, mean, err);
	free(mean);
	return rc;
}

/* --- sampling --- */

/* Density by solid angle of a density 1 / area on a surface, at distance t under cosine c. */
static float area_pdf(const struct gd_light *l, float t, float c)
{
	const double pdf = (double)l->chance * t * t / ((double)l->area * fabsf(c));

	return pdf < (double)PDF_MAX ? (float)pdf : PDF_MAX;
}

/* d and t from p to the light's point; false if they are one. */
static bool towards(struct gd_v3 p, struct gd_light_sample *s)
{
	const double x = (double)s->point.x - p.x, y = (double)s->point.y - p.y,
		     z = (double)s->point.z - p.z, t = sqrt(x * x + y * y + z * z);

	s->t = (float)t;
	s->d = t > 0 ? gd_v3((float)(x / t), (float)(y / t), (float)(z / t)) : gd_v3(0, 0, 1);
	return t * t > 1e-37;
}

/* Share of a spot's intensity that goes along d, as KHR_lights_punctual has it. */
static float cone(const struct gd_light *l, struct gd_v3 d)
{
	const float scale = 1 / fmaxf(0.001f, l->cos_inner - l->cos_outer);
	const float f = fminf(fmaxf((gd_dot(d, l->direction) - l->cos_outer) * scale, 0), 1);

	return f * f;
}

/* The finite lights, as seen from p: s->point is known, for an area light radiance, too. */
static bool seen(const struct gd_scene *scene, struct gd_v3 p, struct gd_light_sample *s)
{
	const struct gd_light *l = &scene->light[s->light];

	s->pdf = 0;
	if (!towards(p, s))
		return false;
	if (l->kind == GD_AREA) {
		const float c = gd_dot(s->d, s->normal);

		if (c == 0)
			return false;
		s->pdf = area_pdf(l, s->t, c);
		return s->pdf > 0;
	}
	s->radiance = gd_scale(l->intensity, 1 / (s->t * s->t));
	if (l->kind == GD_SPOT)
		s->radiance = gd_scale(s->radiance, cone(l, gd_scale(s->d, -1)));
	if (gd_black(s->radiance) || !gd_finite(s->radiance))
		return false;
	s->pdf = l->chance;
	return true;
}

static void point_on(const struct gd_scene *scene, const struct gd_light *l, float u, float v,
		     struct gd_light_sample *s)
{
	const struct gd_triangle *t = &scene->triangle[l->triangle];
	const float r = sqrtf(u), b[3] = { 1 - r, r * (1 - v), r * v };
	float uv[2];

	s->point = gd_point_in(scene, t, b[1], b[2]);
	s->normal = t->normal;
	gd_uv_at(scene, t, b, uv);
	s->radiance = emission_at(scene, &scene->material[t->material], uv[0], uv[1]);
}

bool gd_light_sample(const struct gd_scene *scene, struct gd_v3 p, float choice, float u, float v,
		     struct gd_light_sample *s)
{
	const struct gd_light *l;
	size_t i;

	memset(s, 0, sizeof(*s));
	s->light = GD_NO_INDEX;
	if (!scene->nlight)
		return false;
	i = gd_cdf_find(scene->light_cdf, scene->nlight, choice);
	l = &scene->light[i];
	if (!(l->chance > 0))
		return false;
	s->light = (uint32_t)i;
	s->delta = l->kind != GD_AREA && l->kind != GD_ENVIRONMENT;
	switch (l->kind) {
	case GD_AREA:
		point_on(scene, l, u, v, s);
		return seen(scene, p, s) && !gd_black(s->radiance);
	case GD_POINT:
	case GD_SPOT:
		s->point = l->position;
		return seen(scene, p, s);
	case GD_DIRECTIONAL:
		s->d = gd_scale(l->direction, -1);
		s->radiance = l->intensity;
		s->pdf = l->chance;
		break;
	case GD_ENVIRONMENT:
		s->d = gd_environment_draw(scene, u, v);
		s->radiance = gd_environment_at(scene, s->d);
		s->pdf = gd_environment_pdf(scene, s->d);
		break;
	}
	s->t = INFINITY;
	return s->pdf > 0 && !gd_black(s->radiance);
}

bool gd_light_again(const struct gd_scene *scene, struct gd_v3 p, const struct gd_light_sample *s,
		    struct gd_light_sample *again)
{
	enum gd_light_kind kind;

	*again = *s;
	if (s->light == GD_NO_INDEX)
		return false;
	kind = scene->light[s->light].kind;
	if (kind == GD_DIRECTIONAL || kind == GD_ENVIRONMENT)
		return s->pdf > 0 && !gd_black(s->radiance);
	return seen(scene, p, again) && !gd_black(again->radiance);
}

/* towards() and area_pdf() of a point on an area light. */
static gd_i4 area_again4(const struct gd_light *l, const struct gd_v34 *from,
			 const struct gd_light_sample *s, struct gd_light_sample4 *again)
{
	_Alignas(32) double x[4], y[4], z[4], t[4];
	struct gd_v34 d;
	gd_f4 c;

	for (int k = 0; k < 4; k++) {
		x[k] = (double)s->point.x - from->x[k];
		y[k] = (double)s->point.y - from->y[k];
		z[k] = (double)s->point.z - from->z[k];
		t[k] = sqrt(x[k] * x[k] + y[k] * y[k] + z[k] * z[k]);
		d.x[k] = (float)(x[k] / t[k]);
		d.y[k] = (float)(y[k] / t[k]);
		d.z[k] = (float)(z[k] / t[k]);
		again->t[k] = (float)t[k];
	}
	c = gd_abs4(gd_dot4(d, gd_v34_all(s->normal)));
	for (int k = 0; k < 4; k++) {
		const double pdf = (double)l->chance * t[k] * t[k] / ((double)l->area * c[k]);

		again->pdf[k] = pdf < (double)PDF_MAX ? (float)pdf : PDF_MAX;
	}
	again->d = d;
	again->radiance = gd_v34_all(s->radiance);
	return (again->t > 3.2e-19f) & (c > 0) & (again->pdf > 0);
}

gd_i4 gd_light_again4(const struct gd_scene *scene, const struct gd_v34 *from,
		      const struct gd_light_sample *s, gd_i4 active,
		      struct gd_light_sample4 *again)
{
	const struct gd_light *l = s->light == GD_NO_INDEX ? NULL : &scene->light[s->light];

	if (!l || (l->kind == GD_AREA && gd_black(s->radiance)))
		return gd_mask4(0);
	if (l->kind == GD_AREA)
		return active & area_again4(l, from, s, again);
	for (int k = 0; k < 4; k++) {
		struct gd_light_sample one;

		if (!active[k])
			continue;
		active[k] = gd_light_again(scene, gd_v34_lane(from, k), s, &one) ? -1 : 0;
		gd_v34_put(&again->d, k, one.d);
		gd_v34_put(&again->radiance, k, one.radiance);
		again->t[k] = one.t;
		again->pdf[k] = one.pdf;
	}
	return active;
}

/* --- what a ray meets --- */

struct gd_v3 gd_light_emitted(const struct gd_scene *scene, const struct gd_hit *hit)
{
	const struct gd_material *m = &scene->material[scene->triangle[hit->triangle].material];

	return emission_at(scene, m, hit->u, hit->v);
}

float gd_light_pdf(const struct gd_scene *scene, const struct gd_hit *hit, struct gd_v3 d)
{
	const uint32_t i = scene->triangle[hit->triangle].light;
	const float c = gd_dot(d, hit->ng);

	if (i == GD_NO_INDEX)
		return 0;
	return c == 0 ? PDF_MAX : area_pdf(&scene->light[i], hit->t, c);
}
