/* SPDX-License-Identifier: BSD-3-Clause */
/* Rays against all triangles one by one in doubles, rays that graze, textures, chances. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <omp.h>
#include <stdio.h>

#include "render/impl.h"
#include "scene_make.h"

static void finish(struct gd_scene *s)
{
	struct gd_err err = { 0 };

	s->environment.constant = gd_v3(1, 1, 1);
	if (gd_scene_finish(s, &err) != GD_OK)
		fail_msg("%s", err.text);
}

/* Distance to a triangle in doubles (Moeller and Trumbore), INFINITY: it is missed. */
static double meet(const struct gd_scene *s, size_t i, struct gd_v3 o, struct gd_v3 d)
{
	const uint32_t *k = s->triangle[i].vertex;
	const struct gd_v3 v[3] = { s->vertex[k[0]], s->vertex[k[1]], s->vertex[k[2]] };
	const double dx = (double)d.x, dy = (double)d.y, dz = (double)d.z;
	const double ax = (double)v[1].x - v[0].x, ay = (double)v[1].y - v[0].y,
		     az = (double)v[1].z - v[0].z, bx = (double)v[2].x - v[0].x,
		     by = (double)v[2].y - v[0].y, bz = (double)v[2].z - v[0].z;
	const double px = dy * bz - dz * by, py = dz * bx - dx * bz, pz = dx * by - dy * bx;
	const double det = ax * px + ay * py + az * pz;
	const double tx = (double)o.x - v[0].x, ty = (double)o.y - v[0].y,
		     tz = (double)o.z - v[0].z;
	const double qx = ty * az - tz * ay, qy = tz * ax - tx * az, qz = tx * ay - ty * ax;
	const double u = (tx * px + ty * py + tz * pz) / det,
		     w = (dx * qx + dy * qy + dz * qz) / det,
		     t = (bx * qx + by * qy + bz * qz) / det;

	return u >= 0 && w >= 0 && u + w <= 1 && t > 0 ? t : (double)INFINITY;
}

static struct gd_scene *soup(size_t n)
{
	struct gd_scene *s = scene_new(n, 3 * n);

	for (size_t i = 0; i < n; i++) {
		const struct gd_v3 c = gd_v3((float)(4 * rnd()), (float)(3 * rnd()),
					     (float)(2 * rnd()));

		scene_add(s, gd_mad(c, (float)rnd(), rnd_direction()),
			  gd_mad(c, (float)rnd(), rnd_direction()),
			  gd_mad(c, (float)rnd(), rnd_direction()), (uint32_t)(i % 4));
	}
	finish(s);
	return s;
}

static void nearest(void **state)
{
	struct gd_scene *s = soup(200);
	int hits = 0;

	(void)state;
	for (int ray = 0; ray < 4000; ray++) {
		const struct gd_v3 o = gd_v3((float)(8 * rnd() - 2), (float)(7 * rnd() - 2),
					     (float)(6 * rnd() - 2)), d = rnd_direction();
		struct gd_hit hit;
		double best = (double)INFINITY;
		size_t which = 0;
		const bool found = gd_ray_hit(s, o, d, &hit);

		for (size_t i = 0; i < s->ntriangle; i++) {
			const double t = meet(s, i, o, d);

			if (t < best) {
				best = t;
				which = i;
			}
		}
		assert_int_equal(found, isfinite(best));
		if (!found)
			continue;
		hits++;
		assert_int_equal(hit.triangle, which);
		assert_true(fabs((double)hit.t - best) < 1e-5 * (1 + best));
		/* the point is on the ray, the normal of length 1 at right angles to the edges */
		assert_true(gd_length(gd_sub(hit.p, gd_mad(o, hit.t, d))) < 1e-5f * (1 + hit.t));
		assert_true(fabsf(gd_length(hit.ng) - 1) < 1e-6f);
		for (int k = 0; k < 3; k++) {
			const uint32_t *v = s->triangle[which].vertex;
			const struct gd_v3 e = gd_sub(s->vertex[v[k]], s->vertex[v[(k + 1) % 3]]);

			assert_true(fabsf(gd_dot(e, hit.ng)) < 1e-5f * gd_length(e));
		}
		/* no normals were given: the shading normal is the triangle's */
		assert_true(gd_dot(hit.ns, hit.ng) > 0.99999f);
	}
	assert_in_range(hits, 300, 3500);
	gd_scene_free(s);
}

/* Four at once are the same as one after the other. */
static void packets(void **state)
{
	struct gd_scene *s = soup(300);

	(void)state;
	for (int ray = 0; ray < 2000; ray++) {
		const unsigned active = (unsigned)ray % 16;
		struct gd_v3 o[4], d[4];
		float t[4];
		struct gd_hit four[4], one;
		unsigned hits, is_free;

		for (int k = 0; k < 4; k++) {
			o[k] = gd_v3((float)(4 * rnd()), (float)(3 * rnd()), (float)(2 * rnd()));
			d[k] = rnd_direction();
			t[k] = k == 3 ? INFINITY : (float)(3 * rnd());
		}
		hits = gd_ray_hit4(s, o, d, active, four);
		is_free = gd_ray_free4(s, o, d, t, active);
		assert_int_equal(hits & ~active, 0);
		assert_int_equal(is_free & ~active, 0);
		for (int k = 0; k < 4; k++) {
			if (!(active >> k & 1))
				continue;
			assert_int_equal(hits >> k & 1, gd_ray_hit(s, o[k], d[k], &one));
			assert_int_equal(is_free >> k & 1, gd_ray_free(s, o[k], d[k], t[k]));
			if (!(hits >> k & 1)) {
				assert_true(is_free >> k & 1);
				continue;
			}
			assert_int_equal(four[k].triangle, one.triangle);
			assert_true(fabsf(four[k].t - one.t) < 1e-5f * (1 + one.t));
			/* occlusion is a hit that is nearer */
			if (fabsf(one.t - t[k]) > 1e-3f)
				assert_int_equal(is_free >> k & 1, one.t > t[k]);
		}
	}
	gd_scene_free(s);
}

/* What blocks a ray blocks its neighbours, or there is doubt about it. */
static void blockers(void **state)
{
	struct gd_scene *s = soup(300);
	int blocked = 0, without = 0;

	(void)state;
	for (int ray = 0; ray < 4000; ray++) {
		const float x = (float)(4 * rnd()), y = (float)(3 * rnd()), z = (float)(2 * rnd());
		const struct gd_v3 o = gd_v3(x, y, z), d = rnd_direction();
		const float t = ray % 4 ? (float)(3 * rnd()) : INFINITY;
		const uint32_t triangle = gd_ray_blocker(s, o, d, t);
		struct gd_v34 from, to;
		unsigned sure;

		assert_int_equal(triangle == GD_NO_INDEX, gd_ray_free(s, o, d, t));
		if (triangle == GD_NO_INDEX)
			continue;
		for (int k = 0; k < 4; k++) {
			const float spread = 0.05f * (float)k;

			gd_v34_put(&from, k, gd_mad(o, spread, rnd_direction()));
			gd_v34_put(&to, k, gd_unit(gd_mad(d, spread, rnd_direction())));
		}
		sure = gd_bits4(gd_ray_blocked4(s, triangle, &from, &to, gd_all4(t)));
		without += !(sure & 1);
		for (int k = 0; k < 4; k++) {
			if (!(sure >> k & 1))
				continue;
			blocked++;
			assert_false(gd_ray_free(s, gd_v34_lane(&from, k), gd_v34_lane(&to, k), t));
		}
	}
	assert_true(blocked > 1000);
	/* lane 0 is the ray itself: no doubt but near edges */
	assert_true(without < 50);
	gd_scene_free(s);
}

/* A direction at slope (sine of the angle) to the plane of n. */
static struct gd_v3 grazing(struct gd_v3 n, double slope)
{
	const struct gd_frame f = gd_frame(n);
	const double phi = 2 * PI * rnd(), c = sqrt(1 - slope * slope);

	return gd_unit(gd_to_world(&f, gd_v3((float)(c * cos(phi)), (float)(c * sin(phi)),
					     (float)slope)));
}

/* Slopes go down to 1e-3: below, the rounding of a point near an edge decides which side it is on.
 * Rays from a convex surface: outwards they meet nothing, inwards always another triangle; and all
 * of its points see one another through the inside, and none through the outside. */
static void convex(double scale, double offset)
{
	struct gd_scene *s = scene_sphere(gd_v3((float)(offset * scale), (float)(-offset * scale),
						0), (float)scale, 24);
	const struct gd_v3 centre = gd_v3((float)(offset * scale), (float)(-offset * scale), 0);
	int escaped = 0, struck = 0, blind = 0, leaks = 0, pairs = 0, tries = 0;

	finish(s);
	for (int ray = 0; ray < 4000; ray++) {
		const double slope = pow(10, -3 * rnd());
		struct gd_hit a, b, hit;
		struct gd_v3 d;
		float t;

		if (!gd_ray_hit(s, centre, rnd_direction(), &a) ||
		    !gd_ray_hit(s, centre, rnd_direction(), &b))
			fail_msg("the inside is not closed");
		assert_true(gd_dot(a.ng, gd_sub(a.p, centre)) > 0);
		d = grazing(a.ng, slope);
		tries++;
		struck += gd_ray_hit(s, a.p, d, &hit) || !gd_ray_free(s, a.p, d, INFINITY);
		d = grazing(gd_scale(a.ng, -1), slope);
		escaped += !gd_ray_hit(s, a.p, d, &hit) || hit.triangle == a.triangle;
		d = gd_sub(b.p, a.p);
		t = gd_length(d);
		if (!(t > 0.01f * (float)scale) || a.triangle == b.triangle)
			continue;
		d = gd_scale(d, 1 / t);
		blind += !gd_ray_free(s, a.p, d, t);
		/* the same two from a little outside of the
		 * sphere, beyond what coordinates round */
		pairs++;
		if (t > 0.5f * (float)scale) {
			const float off = 1e-3f * (float)scale;
			const struct gd_v3 p = gd_mad(a.p, off, a.ng), q = gd_mad(b.p, off, b.ng);
			const struct gd_v3 e = gd_sub(q, p);

			leaks += gd_ray_free(s, p, gd_unit(e), gd_length(e));
		}
	}
	/* a point within rounding of an edge may be on either side of it */
	assert_true(tries == 4000 && pairs > 3000);
	if (struck > 4 || escaped > 4 || blind > 0 || leaks > 0)
		fail_msg("scale %g, offset %g: %d outward rays struck, %d inward escaped, "
			 "%d blind, %d leaks", scale, offset, struck, escaped, blind, leaks);
	gd_scene_free(s);
}

static void no_self_hits(void **state)
{
	(void)state;
	convex(1, 0);
	convex(1, 10);
	convex(1e-3, 0);
	convex(1e-3, 10);
	convex(1e4, 0);
	convex(1e4, 3);
}

/* Two coplanar triangles and a box corner: a plane does not shade itself, at any angle. */
static void flat_floor(void **state)
{
	struct gd_scene *s = scene_new(2, 6);
	const struct gd_v3 c[4] = { { -1e3f, 0.3f, -900 }, { 800, 11.7f, -1e3f },
				    { 1e3f, -20, 900 }, { -800, -31.4f, 1e3f } };

	(void)state;
	scene_add(s, c[0], c[2], c[1], 0);
	scene_add(s, c[0], c[3], c[2], 0);
	finish(s);
	for (int i = 0; i < 3000; i++) {
		struct gd_hit hit, other;
		struct gd_v3 d;

		if (!gd_ray_hit(s,
				gd_v3((float)(1000 * rnd() - 500), 300, (float)(900 * rnd() - 450)),
				gd_v3(0, -1, 0), &hit))
			continue;
		d = grazing(gd_scale(hit.ng, hit.ng.y < 0 ? -1 : 1), pow(10, -7 * rnd()));
		assert_false(gd_ray_hit(s, hit.p, d, &other));
		assert_true(gd_ray_free(s, hit.p, d, INFINITY));
	}
	gd_scene_free(s);
}

/* Needles, a hundred thousand times as long as wide, are not hit by rays that start on them. */
static void needles(void **state)
{
	enum { N = 400 };
	struct gd_scene *s = scene_new(N, 3 * N);
	int tries = 0;

	(void)state;
	for (int i = 0; i < N; i++) {
		const struct gd_v3 c = gd_v3((float)(5 * (i % 20)), (float)(5 * (i / 20)), 3);
		const struct gd_v3 d = rnd_direction(), e = rnd_direction();

		scene_add(s, gd_mad(c, -1, d), gd_mad(c, 1, d),
			  gd_mad(gd_mad(c, (float)rnd(), d), 2e-5f, e), 0);
	}
	finish(s);
	for (uint32_t i = 0; i < N; i++)
		for (int k = 0; k < 20; k++) {
			const struct gd_v3 p = gd_point_in(s, &s->triangle[i], 0.5f * (float)rnd(),
							   0.5f * (float)rnd());
			const struct gd_v3 d = grazing(s->triangle[i].normal, pow(10, -4 * rnd()));
			struct gd_hit hit;

			tries++;
			assert_false(gd_ray_hit(s, p, d, &hit) && hit.triangle == i);
			assert_false(gd_ray_hit(s, p, gd_scale(d, -1), &hit) && hit.triangle == i);
			assert_true(gd_ray_free(s, p, d, 2));
		}
	assert_int_equal(tries, 20 * N);
	gd_scene_free(s);
}

static void shading(void **state)
{
	struct gd_scene *s = scene_new(1, 3);
	struct gd_hit hit;

	(void)state;
	scene_add(s, gd_v3(0, 0, 0), gd_v3(1, 0, 0), gd_v3(0, 1, 0), 0);
	s->normal[0] = gd_v3(0, 0, -1);	/* on the other side than the winding says */
	s->normal[1] = gd_unit(gd_v3(0.5f, 0, -1));
	s->normal[2] = gd_unit(gd_v3(0, 0.5f, -1));
	s->uv = calloc(6, sizeof(float));
	memcpy(s->uv, (const float[]){ 0, 1, 2, 1, 0, -3 }, 6 * sizeof(float));
	finish(s);
	assert_true(gd_ray_hit(s, gd_v3(0.25f, 0.5f, 2), gd_v3(0, 0, -1), &hit));
	assert_true(hit.ng.z > 0.9999f && hit.ns.z > 0.8f && hit.ns.x < -0.05f && hit.ns.y < -0.1f);
	assert_true(fabsf(gd_length(hit.ns) - 1) < 1e-6f);
	assert_true(fabsf(hit.u - 0.5f) < 1e-6f && fabsf(hit.v + 1) < 1e-6f);
	assert_true(fabsf(hit.t - 2) < 1e-6f);
	assert_true(gd_ray_hit(s, gd_v3(0.25f, 0.5f, -2), gd_v3(0, 0, 1), &hit));
	assert_true(hit.ng.z > 0.9999f);	/* as the triangle has it, not turned to the ray */
	assert_true(s->low.x == 0 && s->low.z == 0 && s->high.x == 1 && s->high.y == 1);
	gd_scene_free(s);
}

static void threads(void **state)
{
	struct gd_scene *s = soup(300);
	enum { N = 4000 };
	static struct gd_v3 o[N], d[N];
	static struct gd_hit a[N], b[N];
	static bool found[2][N];

	(void)state;
	for (int i = 0; i < N; i++) {
		o[i] = gd_v3((float)(4 * rnd()), (float)(3 * rnd()), (float)(2 * rnd()));
		d[i] = rnd_direction();
	}
	memset(a, 0, sizeof(a));
	memset(b, 0, sizeof(b));
	for (int i = 0; i < N; i++)
		found[0][i] = gd_ray_hit(s, o[i], d[i], &a[i]);
#pragma omp parallel for num_threads(3) schedule(dynamic, 7)
	for (int i = 0; i < N; i++)
		found[1][i] = gd_ray_hit(s, o[i], d[i], &b[i]);
	assert_memory_equal(found[0], found[1], sizeof(found[0]));
	assert_memory_equal(a, b, sizeof(a));
	gd_scene_free(s);
}

/* Embree likes to flush denormals to 0 in its threads; that must not reach ours. */
static void denormals(void **state)
{
	struct gd_scene *s = soup(50);
	volatile float tiny = 1e-39f;
	struct gd_hit hit;

	(void)state;
	gd_ray_hit(s, gd_v3(0, 0, 0), gd_v3(0, 0, 1), &hit);
	assert_true(tiny * 0.5f > 0);
	gd_scene_free(s);
	assert_true(tiny * 0.5f > 0);
}

static void refused(void **state)
{
	struct gd_scene *s = scene_new(1, 3);
	struct gd_err err = { 0 };

	(void)state;
	assert_int_equal(gd_scene_finish(s, &err), GD_ESHAPE);
	scene_add(s, gd_v3(0, 0, 0), gd_v3(1, 0, 0), gd_v3(0, 1, 0), 7);
	err.code = GD_OK;
	assert_int_equal(gd_scene_finish(s, &err), GD_ESHAPE);
	assert_non_null(strstr(err.text, "material"));
	s->triangle[0].material = 0;
	s->material[0].rough_map = 3;
	err.code = GD_OK;
	assert_int_equal(gd_scene_finish(s, &err), GD_ESHAPE);
	gd_scene_free(s);
	gd_scene_free(NULL);
}

static void textures(void **state)
{
	float rgb[12] = { 0, 0, 0, 1, 2, 3, 10, 20, 30, 100, 200, 300 };
	struct gd_texture t = { .w = 2, .h = 2, .rgb = rgb };

	(void)state;
	/* centres of texels, row 0 at v = 0 */
	assert_true(gd_texture_at(&t, 0.25f, 0.25f).x == 0);
	assert_true(gd_texture_at(&t, 0.75f, 0.25f).y == 2);
	assert_true(gd_texture_at(&t, 0.25f, 0.75f).z == 30);
	assert_true(gd_texture_at(&t, 0.75f, 0.75f).x == 100);
	/* between them: the mean; over the edge: the mean with the other side */
	assert_true(gd_texture_at(&t, 0.5f, 0.25f).x == 0.5f);
	assert_true(fabsf(gd_texture_at(&t, 0.5f, 0.5f).x - 27.75f) < 1e-5f);
	assert_true(gd_texture_at(&t, 0, 0.25f).x == 0.5f);
	assert_true(fabsf(gd_texture_at(&t, -7.75f, 12.25f).x - 0) < 1e-5f);
	assert_true(fabsf(gd_texture_at(&t, 5.75f, -0.25f).x - 100) < 1e-5f);
	t.clamp_u = true;
	assert_true(gd_texture_at(&t, 0, 0.25f).x == 0);
	assert_true(gd_texture_at(&t, -3, 0.25f).x == 0);
	assert_true(gd_texture_at(&t, 17, 0.25f).x == 1);
	t.clamp_v = true;
	assert_true(gd_texture_at(&t, 17, 9).x == 100);
	/* hostile coordinates stay inside */
	for (int i = 0; i < 2; i++) {
		t.clamp_u = t.clamp_v = i;
		assert_true(isfinite(gd_texture_at(&t, NAN, INFINITY).x));
		assert_true(isfinite(gd_texture_at(&t, -1e-9f, 1e30f).x));
		assert_true(isfinite(gd_texture_at(&t, 0.99999994f, -1e30f).x));
	}
	t.w = t.h = 1;
	assert_true(gd_texture_at(&t, 0.1f, 0.9f).x == 0);
}

static void chances(void **state)
{
	enum { N = 1000 };
	double weight[N] = { 0 };
	static float cdf[N + 1];

	(void)state;
	for (int i = 0; i < N; i++)
		weight[i] = i % 7 == 3 ? 0 : i % 5 == 0 ? 1e-300 : i == 501 ? 1e20 : rnd();
	assert_true(gd_cdf_fill(cdf, weight, N) > 1e19);
	assert_true(cdf[0] == 0 && cdf[N] == 1);
	for (int i = 0; i < N; i++) {
		const float p = cdf[i + 1] - cdf[i];

		assert_true(weight[i] > 0 ? p >= 0x1p-24f : p == 0);
		if (weight[i] > 0) {
			assert_int_equal(gd_cdf_find(cdf, N, cdf[i]), i);
			assert_int_equal(gd_cdf_find(cdf, N, nextafterf(cdf[i + 1], 0)), i);
		}
	}
	assert_int_equal(gd_cdf_find(cdf, N, 0), weight[0] > 0 ? 0 : 1);
	/* in proportion, to the step */
	for (int i = 0; i < N; i++)
		weight[i] = i;
	gd_cdf_fill(cdf, weight, N);
	for (int i = 0; i < N; i++)
		assert_true(fabs((double)(cdf[i + 1] - cdf[i]) - i / (N * (N - 1) / 2.)) <=
			    0x1p-23);
	/* nothing at all; everything at the end; only the first */
	memset(weight, 0, sizeof(weight));
	assert_true(gd_cdf_fill(cdf, weight, N) == 0);
	assert_true(cdf[N] == 0);
	weight[N - 1] = 1e-300;
	gd_cdf_fill(cdf, weight, N);
	assert_true(cdf[N - 1] == 0 && cdf[N] == 1);
	weight[0] = 1;
	gd_cdf_fill(cdf, weight, N);
	assert_true(cdf[N - 1] == 1 - 0x1p-24f && cdf[1] == cdf[N - 1] && cdf[N] == 1);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(nearest),	cmocka_unit_test(packets),
		cmocka_unit_test(blockers),
		cmocka_unit_test(no_self_hits), cmocka_unit_test(flat_floor),
		cmocka_unit_test(needles),
		cmocka_unit_test(shading),	cmocka_unit_test(threads),
		cmocka_unit_test(denormals),	cmocka_unit_test(refused),
		cmocka_unit_test(textures),	cmocka_unit_test(chances),
	};

	return cmocka_run_group_tests_name("scene", tests, NULL, NULL);
}
