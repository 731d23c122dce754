/* SPDX-License-Identifier: BSD-3-Clause */
/* Cameras found again from the positions that their pixels show. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <stdlib.h>

#include "camera.h"

#define W 90
#define H 61

struct view {
	double eye[3], turn, focal;	/* turned about the upright axis, radians; pixels */
};

static struct gd_plane plane(void)
{
	return gd_plane_of(gd_calloc(gd_stride(W) * H, sizeof(float)), W, H);
}

static double draw(unsigned *seed)
{
	*seed = *seed * 1664525u + 1013904223u;
	return (double)(*seed >> 8) / (1 << 24) - 0.5;
}

/* The world point at depth z behind pixel x, y (z along the axis of view). */
static void point(const struct view *v, double x, double y, double z, double p[3])
{
	double a = (x - 0.5 * (W - 1)) / v->focal * z, b = (y - 0.5 * (H - 1)) / v->focal * z;

	p[0] = v->eye[0] + cos(v->turn) * a + sin(v->turn) * z;
	p[1] = v->eye[1] + b;
	p[2] = v->eye[2] - sin(v->turn) * a + cos(v->turn) * z;
}

static double depth(double x, double y, int kind)
{
	if (kind == 0)
		return 5;	/* a wall */
	return 4 + 0.02 * x + (x + y > 70 ? 1.5 : 0) + 0.3 * sin(0.2 * y);
}

/* jitter: pixels, of where a pixel's point really is; lost: every lost-th pixel is a miss. */
static void fill(struct gd_plane p[3], const struct view *v, int kind, double scale, double jitter,
		 int lost)
{
	unsigned seed = 5;

	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++) {
			double q[3];

			point(v, x + jitter * draw(&seed), y + jitter * draw(&seed),
			      depth(x, y, kind), q);
			for (int c = 0; c < 3; c++)
				gd_row(p[c], y)[x] =
					lost && (x + y * W) % lost == 0 ? 0 : (float)(scale * q[c]);
		}
}

static void check(const struct view *v, int kind, double scale, double jitter, int lost,
		  double most)
{
	struct gd_plane p[3] = { plane(), plane(), plane() };
	struct gd_camera camera;

	fill(p, v, kind, scale, jitter, lost);
	assert_true(gd_camera_fit(&camera, p));
	if (!(camera.rms <= 0.8 * jitter + 4e-3))
		fail_msg("rms %g", camera.rms);
	for (int y = 0; y < H; y += 7)
		for (int x = 0; x < W; x += 7) {
			double q[3], u, w;

			point(v, x, y, depth(x, y, kind), q);
			for (int c = 0; c < 3; c++)
				q[c] *= scale;
			assert_true(gd_camera_project(&camera, q, &u, &w));
			if (!(hypot(u - x, w - y) < most))
				fail_msg("%d %d found at %g %g", x, y, u, w);
		}
	for (int c = 0; c < 3; c++)
		free(p[c].v);
}

static const struct view views[] = {
	{ { 0, 0, 0 }, 0, 80 }, { { 3, -1, 20 }, 1.1, 60 }, { { 1000, 2000, -500 }, 2.5, 200 }
};

static void test_exact(void **state)
{
	(void)state;
	for (int i = 0; i < 3; i++)
		for (int kind = 0; kind < 2; kind++)
			check(&views[i], kind, 1, 0, 0, i == 2 ? 0.02 : 1e-3);
}

static void test_units(void **state)
{
	(void)state;
	check(&views[1], 1, 1e-6, 0, 0, 1e-3);
	check(&views[1], 1, 1e9, 0, 0, 1e-3);
}

static void test_jitter_and_misses(void **state)
{
	(void)state;
	check(&views[0], 1, 1, 1, 5, 0.15);
	check(&views[1], 1, 1, 0.5, 2, 0.1);
}

/* A fifth of the pixels show what belongs elsewhere. */
static void test_outliers(void **state)
{
	struct gd_plane p[3] = { plane(), plane(), plane() };
	struct gd_camera camera;
	unsigned seed = 3;

	(void)state;
	fill(p, &views[1], 1, 1, 0.3, 0);
	for (int i = 0; i < W * H / 5; i++) {
		int x = (int)((draw(&seed) + 0.5) * W), y = (int)((draw(&seed) + 0.5) * H);

		int u = (int)((draw(&seed) + 0.5) * W), v = (int)((draw(&seed) + 0.5) * H);

		for (int c = 0; c < 3; c++)
			gd_row(p[c], y)[x] = gd_row(p[c], v)[u];
	}
	assert_true(gd_camera_fit(&camera, p));
	for (int y = 0; y < H; y += 9)
		for (int x = 0; x < W; x += 9) {
			double q[3], u, v;

			point(&views[1], x, y, depth(x, y, 1), q);
			assert_true(gd_camera_project(&camera, q, &u, &v));
			if (!(hypot(u - x, v - y) < 0.5))
				fail_msg("%d %d found at %g %g, rms %g", x, y, u, v, camera.rms);
		}
	for (int c = 0; c < 3; c++)
		free(p[c].v);
}

static void test_behind(void **state)
{
	struct gd_plane p[3] = { plane(), plane(), plane() };
	struct gd_camera camera;
	double q[3], x, y;

	(void)state;
	fill(p, &views[0], 1, 1, 0, 0);
	assert_true(gd_camera_fit(&camera, p));
	point(&views[0], 40, 30, -3, q);
	assert_false(gd_camera_project(&camera, q, &x, &y));
	for (int c = 0; c < 3; c++)
		free(p[c].v);
}

static void test_no_positions(void **state)
{
	struct gd_plane p[3] = { plane(), plane(), plane() };
	struct gd_camera camera;

	(void)state;
	assert_false(gd_camera_fit(&camera, p));
	gd_row(p[0], 4)[4] = 1;
	assert_false(gd_camera_fit(&camera, p));
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++)
			gd_row(p[1], y)[x] = NAN;
	assert_false(gd_camera_fit(&camera, p));
	for (int c = 0; c < 3; c++)
		free(p[c].v);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_exact), cmocka_unit_test(test_units),
		cmocka_unit_test(test_jitter_and_misses), cmocka_unit_test(test_outliers),
		cmocka_unit_test(test_behind), cmocka_unit_test(test_no_positions)
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
