/* SPDX-License-Identifier: BSD-3-Clause */
#include "render/scene.h"

#include <embree3/rtcore.h>
#include <fenv.h>
#include <stdio.h>
#include <stdlib.h>

#include "render/impl.h"

#define MANY 2000000		/* triangles beyond which the best tree takes too long to build */
#define NEAR 4e-6f		/* of the largest coordinate: 32 roundings of it */

struct report {
	enum RTCError code;
	char text[200];
};

static void complain(void *user, enum RTCError code, const char *text)
{
	struct report *r = user;

	if (r->code == RTC_ERROR_NONE) {
		r->code = code;
		snprintf(r->text, sizeof(r->text), "%s", text ? text : "unknown failure");
	}
}

static int failed(const struct report *r, struct gd_err *err)
{
	return gd_fail(err, r->code == RTC_ERROR_OUT_OF_MEMORY ? GD_ENOMEM : GD_EARG, "Embree: %s",
		       r->code == RTC_ERROR_OUT_OF_MEMORY ? "out of memory" : r->text);
}

static void build(struct gd_scene *s, RTCDevice device, RTCScene rays)
{
	const bool many = s->ntriangle > MANY;
	RTCGeometry g = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);

	if (!g)
		return;
	rtcSetSharedGeometryBuffer(g, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, s->vertex, 0,
				   sizeof(*s->vertex), s->nvertex);
	rtcSetSharedGeometryBuffer(g, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, s->triangle,
				   offsetof(struct gd_triangle, vertex), sizeof(*s->triangle),
				   s->ntriangle);
	rtcSetGeometryBuildQuality(g, many ? RTC_BUILD_QUALITY_MEDIUM : RTC_BUILD_QUALITY_HIGH);
	rtcCommitGeometry(g);
	rtcAttachGeometry(rays, g);
	rtcReleaseGeometry(g);
	rtcSetSceneFlags(rays, RTC_SCENE_FLAG_ROBUST);
	rtcSetSceneBuildQuality(rays, many ? RTC_BUILD_QUALITY_MEDIUM : RTC_BUILD_QUALITY_HIGH);
	rtcCommitScene(rays);
}

/* Embree reads 16 bytes at each vertex. */
static int pad(struct gd_scene *s, struct gd_err *err)
{
	struct gd_v3 *v = realloc(s->vertex, (s->nvertex + 1) * sizeof(*v));

	if (!v)
		return gd_fail(err, GD_ENOMEM, "out of memory for %zu vertices", s->nvertex);
	v[s->nvertex] = gd_v3(0, 0, 0);
	s->vertex = v;
	return GD_OK;
}

int gd_ray_prepare(struct gd_scene *scene, struct gd_err *err)
{
	struct report report = { RTC_ERROR_NONE, "" };
	fenv_t env;
	int rc = pad(scene, err);

	if (rc != GD_OK)
		return rc;
	fegetenv(&env);		/* Embree may flush denormals to 0; we do not */
	scene->device = rtcNewDevice(NULL);
	if (!scene->device) {
		fesetenv(&env);
		return gd_fail(err, GD_EARG, "Embree: no device (error %d)",
			       (int)rtcGetDeviceError(NULL));
	}
	rtcSetDeviceErrorFunction(scene->device, complain, &report);
	scene->rays = rtcNewScene(scene->device);
	if (scene->rays)
		build(scene, scene->device, scene->rays);
	rtcSetDeviceErrorFunction(scene->device, NULL, NULL);
	fesetenv(&env);
	return report.code == RTC_ERROR_NONE && scene->rays ? GD_OK : failed(&report, err);
}

void gd_ray_drop(struct gd_scene *scene)
{
	if (scene->rays)
		rtcReleaseScene(scene->rays);
	if (scene->device)
		rtcReleaseDevice(scene->device);
	scene->rays = scene->device = NULL;
}

/* How far from o a ray starts: more than positions on a surface are inexact. */
static float start(const struct gd_scene *s, struct gd_v3 o)
{
	const float size = fmaxf(fmaxf(s->high.x - s->low.x, s->high.y - s->low.y),
				 s->high.z - s->low.z);

	return NEAR * fmaxf(0.1f * size, fmaxf(fmaxf(fabsf(o.x), fabsf(o.y)), fabsf(o.z)));
}

static struct gd_v3 mix(const float b[3], struct gd_v3 p, struct gd_v3 q, struct gd_v3 r)
{
	return gd_mad(gd_mad(gd_scale(p, b[0]), b[1], q), b[2], r);
}

static void describe(const struct gd_scene *s, uint32_t triangle, float t, float u, float v,
		     struct gd_hit *hit)
{
	const struct gd_triangle *tri = &s->triangle[triangle];
	const uint32_t *k = tri->vertex;
	const struct gd_v3 a = s->vertex[k[0]], b = s->vertex[k[1]], c = s->vertex[k[2]];
	const float w[3] = { 1 - u - v, u, v };
	float uv[2];
	struct gd_v3 n;

	hit->triangle = triangle;
	hit->t = t;
	hit->p = mix(w, a, b, c);
	hit->ng = gd_v3(0, 0, 1);
	gd_triangle_normal(s, tri, &hit->ng);
	n = mix(w, s->normal[k[0]], s->normal[k[1]], s->normal[k[2]]);
	if (gd_dot(n, n) > 1e-12f)
		n = gd_unit(n);
	else
		n = hit->ng;
	hit->ns = gd_dot(n, hit->ng) < 0 ? gd_scale(n, -1) : n;
	gd_uv_at(s, tri, w, uv);
	hit->u = uv[0];
	hit->v = uv[1];
}

bool gd_ray_hit(const struct gd_scene *scene, struct gd_v3 o, struct gd_v3 d, struct gd_hit *hit)
{
	struct RTCIntersectContext context;
	struct RTCRayHit r = {
		.ray = { .org_x = o.x, .org_y = o.y, .org_z = o.z, .tnear = start(scene, o),
			 .dir_x = d.x, .dir_y = d.y, .dir_z = d.z, .tfar = INFINITY,
			 .mask = UINT32_MAX },
		.hit = { .geomID = RTC_INVALID_GEOMETRY_ID },
	};

	rtcInitIntersectContext(&context);
	rtcIntersect1(scene->rays, &context, &r);
	if (r.hit.geomID == RTC_INVALID_GEOMETRY_ID)
		return false;
	describe(scene, r.hit.primID, r.ray.tfar, r.hit.u, r.hit.v, hit);
	return true;
}

bool gd_ray_free(const struct gd_scene *scene, struct gd_v3 o, struct gd_v3 d, float t)
{
	struct RTCIntersectContext context;
	const float near = start(scene, o);
	struct RTCRay r = { .org_x = o.x, .org_y = o.y, .org_z = o.z, .tnear = near,
			    .dir_x = d.x, .dir_y = d.y, .dir_z = d.z, .tfar = t - 2 * near,
			    .mask = UINT32_MAX };

	rtcInitIntersectContext(&context);
	if (r.tfar > r.tnear)
		rtcOccluded1(scene->rays, &context, &r);
	return r.tfar >= 0 || t < 4 * near;
}

static void fill4(const struct gd_scene *s, struct RTCRay4 *r, int valid[4], const struct gd_v3 o[4],
		  const struct gd_v3 d[4], unsigned active)
{
	for (int k = 0; k < 4; k++) {
		valid[k] = active >> k & 1 ? -1 : 0;
		if (!valid[k])
			continue;
		r->org_x[k] = o[k].x;
		r->org_y[k] = o[k].y;
		r->org_z[k] = o[k].z;
		r->tnear[k] = start(s, o[k]);
		r->dir_x[k] = d[k].x;
		r->dir_y[k] = d[k].y;
		r->dir_z[k] = d[k].z;
		r->tfar[k] = INFINITY;
		r->mask[k] = UINT32_MAX;
	}
}

unsigned gd_ray_hit4(const struct gd_scene *scene, const struct gd_v3 o[4], const struct gd_v3 d[4],
		     unsigned active, struct gd_hit hit[4])
{
	struct RTCIntersectContext context;
	struct RTCRayHit4 r = { 0 };
	_Alignas(16) int valid[4];
	unsigned found = 0;

	fill4(scene, &r.ray, valid, o, d, active);
	for (int k = 0; k < 4; k++)
		r.hit.geomID[k] = RTC_INVALID_GEOMETRY_ID;
	rtcInitIntersectContext(&context);
	rtcIntersect4(valid, scene->rays, &context, &r);
	for (int k = 0; k < 4; k++)
		if (valid[k] && r.hit.geomID[k] != RTC_INVALID_GEOMETRY_ID) {
			describe(scene, r.hit.primID[k], r.ray.tfar[k], r.hit.u[k], r.hit.v[k],
				 &hit[k]);
			found |= 1u << k;
		}
	return found;
}

unsigned gd_ray_free4(const struct gd_scene *scene, const struct gd_v3 o[4],
		      const struct gd_v3 d[4], const float t[4], unsigned active)
{
	struct RTCIntersectContext context;
	struct RTCRay4 r = { 0 };
	_Alignas(16) int valid[4];
	unsigned free_bits = 0;

	fill4(scene, &r, valid, o, d, active);
	for (int k = 0; k < 4; k++) {
		r.tfar[k] = t[k] - 2 * r.tnear[k];
		if (valid[k] && !(r.tfar[k] > r.tnear[k])) {
			valid[k] = 0;
			free_bits |= 1u << k;
		}
	}
	rtcInitIntersectContext(&context);
	rtcOccluded4(valid, scene->rays, &context, &r);
	for (int k = 0; k < 4; k++)
		if (valid[k] && r.tfar[k] >= 0)
			free_bits |= 1u << k;
	return free_bits;
}
