/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Rays through Embree. A ray must not hit the surface on which it starts or ends. Offsets along the
 * ray alone fail where it grazes the surface, so whatever hit is found is held against the plane of
 * its triangle: if that goes through the ray's start (or end), as near as floats can tell, it is no
 * hit, for a ray that starts in a plane does not meet it again.
 */
#include "render/scene.h"

#include <embree3/rtcore.h>
#include <fenv.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "render/impl.h"

#define MANY 2000000		/* triangles beyond which the best tree takes too long to build */
#define NEAR 0x1p-22f		/* of the largest coordinate: rays start so far off, which only
				   saves tests of planes */
#define START 0x1p-23		/* points on surfaces are rounded once: 2^-24 of each coordinate */
#define END 0x1p-21		/* of distance and coordinates: d and t were rounded, too */
#define INSIDE 1e-3f		/* barycentric: clearly no edge; all roundings are less by far */
#define TURNS 64		/* hits that one ray may have to pass by: triangles in one plane */

/* Rows of the arrays that a filter gets, N wide: the order of the members of RTCRay and RTCHit. */
#define RAY(member) (offsetof(struct RTCRay, member) / sizeof(unsigned))
#define HIT_PRIMITIVE (offsetof(struct RTCHit, primID) / sizeof(unsigned))

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

static inline float largest(struct gd_v3 v)
{
	return gd_largest(gd_v3(fabsf(v.x), fabsf(v.y), fabsf(v.z)));
}

/*
 * Is p clearly off the plane of a triangle? Floats tell for nearly all, far, the length of the ray,
 * apart. 1e-5 is some ten times what roundings of p, of the normal and of products add up to.
 */
static inline bool off_plane(const struct gd_scene *s, uint32_t triangle, struct gd_v3 p, float far)
{
	const struct gd_triangle *t = &s->triangle[triangle];
	const struct gd_v3 a = s->vertex[t->vertex[0]];

	return fabsf(gd_dot(t->normal, gd_sub(p, a))) > 1e-5f * (largest(p) + largest(a) + far);
}

/*
 * Does p lie in the plane of a triangle? p is exact to the share each of its coordinates, and to
 * most in all directions.
 */
static bool exactly_in_plane(const struct gd_scene *s, uint32_t triangle, struct gd_v3 p,
			     double share, double most)
{
	const uint32_t *k = s->triangle[triangle].vertex;
	const struct gd_v3 a = s->vertex[k[0]];
	double n[3], d, slack;

	gd_triangle_cross(s, k, n);
	d = n[0] * ((double)p.x - a.x) + n[1] * ((double)p.y - a.y) + n[2] * ((double)p.z - a.z);
	slack = fabs(n[0] * (double)p.x) + fabs(n[1] * (double)p.y) + fabs(n[2] * (double)p.z);
	return fabs(d) <= share * slack + most * (fabs(n[0]) + fabs(n[1]) + fabs(n[2]));
}

/* Does a ray start, or after a length of t end, in the plane of a triangle that it hits? */
static inline bool starts_in(const struct gd_scene *s, uint32_t triangle, struct gd_v3 o)
{
	return !off_plane(s, triangle, o, 0) && exactly_in_plane(s, triangle, o, START, 0);
}

static inline bool ends_in(const struct gd_scene *s, uint32_t triangle, struct gd_v3 end, float t)
{
	return isfinite(t) && !off_plane(s, triangle, end, t) &&
	       exactly_in_plane(s, triangle, end, END, END * (double)t);
}

/* What shadow rays carry along: Embree hands the context to the filter. */
struct shadow {
	struct RTCIntersectContext context;
	const struct gd_scene *scene;
	const float *t;			/* length of each ray, by its id; INFINITY: it has no end */
	uint32_t blocker;		/* what a ray hit last */
};

/* Vector of ray i of n, whose rows begin with row. */
static inline struct gd_v3 of_ray(const float *rows, size_t row, unsigned i, unsigned n)
{
	return gd_v3(rows[row * n + i], rows[(row + 1) * n + i], rows[(row + 2) * n + i]);
}

/* Passes by the surfaces on which a shadow ray starts or ends. */
static void pass_by(const struct RTCFilterFunctionNArguments *a)
{
	struct shadow *s = (struct shadow *)a->context;
	const float *rays = (const float *)a->ray;

	for (unsigned i = 0; i < a->N; i++) {
		const uint32_t triangle = ((const unsigned *)a->hit)[HIT_PRIMITIVE * a->N + i];

		if (!a->valid[i])
			continue;

		const struct gd_v3 o = of_ray(rays, RAY(org_x), i, a->N);
		const struct gd_v3 d = of_ray(rays, RAY(dir_x), i, a->N);
		const float t = s->t[((const unsigned *)a->ray)[RAY(id) * a->N + i]];

		if (starts_in(s->scene, triangle, o) ||
		    ends_in(s->scene, triangle, gd_mad(o, t, d), t))
			a->valid[i] = 0;
		else
			s->blocker = triangle;
	}
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
	rtcSetGeometryOccludedFilterFunction(g, pass_by);
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

static struct gd_v3 mix(const float b[3], struct gd_v3 p, struct gd_v3 q, struct gd_v3 r)
{
	return gd_mad(gd_mad(gd_scale(p, b[0]), b[1], q), b[2], r);
}

static void describe(const struct gd_scene *s, uint32_t triangle, float t, float u, float v,
		     struct gd_hit *hit)
{
	const struct gd_triangle *tri = &s->triangle[triangle];
	const uint32_t *k = tri->vertex;
	const float w[3] = { 1 - u - v, u, v };
	float uv[2];
	struct gd_v3 n;

	hit->triangle = triangle;
	hit->t = t;
	hit->p = gd_point_in(s, tri, u, v);
	hit->ng = tri->normal;
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

/* Where a ray ends, short of the surface there. */
static float stop(float t)
{
	return t * (1 - NEAR);
}

#define LANES(v, member) ((gd_f4){ v[0] member, v[1] member, v[2] member, v[3] member })
#define VECTORS(v) gd_v34(LANES(v, .x), LANES(v, .y), LANES(v, .z))

static inline gd_f4 largest4(struct gd_v34 v)
{
	return gd_largest4(gd_v34(gd_abs4(v.x), gd_abs4(v.y), gd_abs4(v.z)));
}

static inline void put4(float to[4], gd_f4 v)
{
	memcpy(to, &v, sizeof v);
}

/* Returns which of the rays there are. */
static inline gd_i4 fill4(struct RTCRay4 *r, const struct gd_v3 o[4], const struct gd_v3 d[4],
			  gd_f4 far, unsigned active)
{
	const struct gd_v34 from = VECTORS(o), to = VECTORS(d);
	const gd_f4 near = NEAR * largest4(from);

	put4(r->org_x, from.x);
	put4(r->org_y, from.y);
	put4(r->org_z, from.z);
	put4(r->tnear, near);
	put4(r->dir_x, to.x);
	put4(r->dir_y, to.y);
	put4(r->dir_z, to.z);
	put4(r->tfar, far);
	memset(r->time, 0, sizeof r->time);
	memset(r->flags, 0, sizeof r->flags);
	memset(r->mask, -1, sizeof r->mask);
	for (unsigned k = 0; k < 4; k++)
		r->id[k] = k;
	return gd_mask4(active) & (far > near);
}

/* The nearest hit beyond near. */
static bool trace(const struct gd_scene *scene, struct gd_v3 o, struct gd_v3 d, float near,
		  struct gd_hit *hit)
{
	for (int turn = 0; turn < TURNS; turn++) {
		struct RTCIntersectContext context;
		struct RTCRayHit r = {
			.ray = { .org_x = o.x, .org_y = o.y, .org_z = o.z, .tnear = near,
				 .dir_x = d.x, .dir_y = d.y, .dir_z = d.z, .tfar = INFINITY,
				 .mask = UINT32_MAX },
			.hit = { .geomID = RTC_INVALID_GEOMETRY_ID },
		};

		rtcInitIntersectContext(&context);
		rtcIntersect1(scene->rays, &context, &r);
		if (r.hit.geomID == RTC_INVALID_GEOMETRY_ID)
			return false;
		if (!starts_in(scene, r.hit.primID, o)) {
			describe(scene, r.hit.primID, r.ray.tfar, r.hit.u, r.hit.v, hit);
			return true;
		}
		near = nextafterf(r.ray.tfar * (1 + 2e-7f), INFINITY);
	}
	return false;
}

bool gd_ray_hit(const struct gd_scene *scene, struct gd_v3 o, struct gd_v3 d, struct gd_hit *hit)
{
	return trace(scene, o, d, NEAR * largest(o), hit);
}

unsigned gd_ray_hit4(const struct gd_scene *scene, const struct gd_v3 o[4], const struct gd_v3 d[4],
		     unsigned active, struct gd_hit hit[4])
{
	struct RTCIntersectContext context;
	struct RTCRayHit4 r;
	const gd_i4 valid = fill4(&r.ray, o, d, gd_all4(INFINITY), active);
	unsigned found = 0;

	memset(r.hit.geomID, -1, sizeof r.hit.geomID);		/* RTC_INVALID_GEOMETRY_ID */
	rtcInitIntersectContext(&context);
	rtcIntersect4((const int *)&valid, scene->rays, &context, &r);
	for (int k = 0; k < 4; k++) {
		bool is_hit = valid[k] && r.hit.geomID[k] != RTC_INVALID_GEOMETRY_ID;

		if (is_hit && starts_in(scene, r.hit.primID[k], o[k]))
			is_hit = trace(scene, o[k], d[k],
				       nextafterf(r.ray.tfar[k] * (1 + 2e-7f), INFINITY), &hit[k]);
		else if (is_hit)
			describe(scene, r.hit.primID[k], r.ray.tfar[k], r.hit.u[k], r.hit.v[k],
				 &hit[k]);
		found |= (unsigned)is_hit << k;
	}
	return found;
}

uint32_t gd_ray_blocker(const struct gd_scene *scene, struct gd_v3 o, struct gd_v3 d, float t)
{
	struct shadow shadow = { .scene = scene, .t = &t, .blocker = GD_NO_INDEX };
	struct RTCRay r = { .org_x = o.x, .org_y = o.y, .org_z = o.z, .tnear = NEAR * largest(o),
			    .dir_x = d.x, .dir_y = d.y, .dir_z = d.z, .tfar = stop(t),
			    .mask = UINT32_MAX };

	if (!(r.tfar > r.tnear))
		return GD_NO_INDEX;
	rtcInitIntersectContext(&shadow.context);
	rtcOccluded1(scene->rays, &shadow.context, &r);
	return r.tfar >= 0 ? GD_NO_INDEX : shadow.blocker;
}

bool gd_ray_free(const struct gd_scene *scene, struct gd_v3 o, struct gd_v3 d, float t)
{
	return gd_ray_blocker(scene, o, d, t) == GD_NO_INDEX;
}

static inline struct gd_v34 cross4(struct gd_v34 a, struct gd_v34 b)
{
	return gd_v34(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}

/* Rays that start on one side of a triangle's plane and end on the other, both off_plane(). */
static gd_i4 cross_plane4(struct gd_v3 normal, struct gd_v3 a, const struct gd_v34 *o,
			  const struct gd_v34 *d, gd_f4 t)
{
	const struct gd_v34 n = gd_v34_all(normal), start = gd_sub4(*o, gd_v34_all(a));
	const gd_f4 from = gd_dot4(n, start), along = gd_dot4(n, *d);
	const gd_f4 far = largest4(*o) + largest(a);
	const gd_i4 endless = t == INFINITY;
	const gd_f4 to = gd_pick4(endless, along, from + t * along);
	const gd_f4 most = gd_pick4(endless, gd_all4(1), 2 * (far + t));

	return (from * to < 0) & (gd_abs4(from) > 1e-5f * far) & (gd_abs4(to) > 1e-5f * most);
}

/* Barycentric coordinates as Moeller and Trumbore (1997) have them, with edges f and e. */
gd_i4 gd_ray_blocked4(const struct gd_scene *scene, uint32_t triangle, const struct gd_v34 *o,
		      const struct gd_v34 *d, gd_f4 t)
{
	const struct gd_triangle *tri = &scene->triangle[triangle];
	const struct gd_v3 a = scene->vertex[tri->vertex[0]];
	const struct gd_v3 f = gd_sub(scene->vertex[tri->vertex[1]], a),
			   e = gd_sub(scene->vertex[tri->vertex[2]], a);
	const struct gd_v34 f4 = gd_v34_all(f), s = gd_sub4(*o, gd_v34_all(a));
	const struct gd_v34 p = cross4(*d, gd_v34_all(e)), q = cross4(s, f4);
	const gd_f4 det = gd_dot4(f4, p), u = gd_dot4(s, p) / det, v = gd_dot4(*d, q) / det;
	/* what roundings of u and v grow with; a thousand times their unit stays below INSIDE */
	const gd_i4 exact = largest4(s) * (largest(e) + largest(f)) < 1e3f * gd_abs4(det);

	return exact & (u > INSIDE) & (v > INSIDE) & (u + v < 1 - INSIDE) &
	       cross_plane4(tri->normal, a, o, d, t);
}

unsigned gd_ray_free4(const struct gd_scene *scene, const struct gd_v3 o[4],
		      const struct gd_v3 d[4], const float t[4], unsigned active)
{
	struct shadow shadow = { .scene = scene, .t = t };
	struct RTCRay4 r;
	const gd_i4 valid = fill4(&r, o, d, LANES(t, ) * (1 - NEAR), active);
	gd_f4 left;

	rtcInitIntersectContext(&shadow.context);
	if (gd_bits4(valid) == 15)
		shadow.context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
	rtcOccluded4((const int *)&valid, scene->rays, &shadow.context, &r);
	memcpy(&left, r.tfar, sizeof left);
	return active & gd_bits4(~(valid & (left < 0)));
}
