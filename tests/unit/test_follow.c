/* SPDX-License-Identifier: BSD-3-Clause */
/* Following what a camera sees, on a made wall. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdbool.h>
#include <stdint.h>
#include <cmocka.h>
#include <math.h>
#include <stdlib.h>

#include "follow.h"

#define W 90
#define H 70

struct view {
	struct gd_plane p[3];
	float *block;
};

static void view_new(struct view *v)
{
	const size_t size = gd_stride(W) * H;

	v->block = gd_calloc(3 * size, sizeof(float));
	assert_non_null(v->block);
	for (int c = 0; c < 3; c++)
		v->p[c] = gd_plane_of(v->block + (size_t)c * size, W, H);
}

/* A pinhole camera at (cx, 0, 0) that looks along Z at a wavy wall; by bisection along the ray. */
static void look(struct view *v, double cx, double unit)
{
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++) {
			const double a = (x - W / 2) / 80.0, b = (y - H / 2) / 80.0;
			double lo = 1, hi = 100;

			for (int i = 0; i < 60; i++) {
				double z = (lo + hi) / 2, u = cx + a * z;

				if (z < 20 + sin(0.4 * u) + cos(0.5 * b * z))
					lo = z;
				else
					hi = z;
			}
			gd_row(v->p[0], y)[x] = (float)(unit * (cx + a * lo));
			gd_row(v->p[1], y)[x] = (float)(unit * b * lo);
			gd_row(v->p[2], y)[x] = (float)(unit * lo);
		}
}

/* Moving by 1 at a distance of 20 is 4 pixels. */
static void a_camera_moves(void **unused)
{
	struct view here, there;
	int *at = malloc(sizeof *at * W * H);

	(void)unused;
	assert_non_null(at);
	view_new(&here);
	view_new(&there);
	for (int k = 0; k < 3; k++) {
		const double unit = pow(10.0, 3 * k - 3), step = k == 1 ? -2 : 1;
		int lost = 0;

		look(&here, 0, unit);
		look(&there, step, unit);
		gd_follow(at, here.p, there.p);
		for (int y = 0; y < H; y++)
			for (int x = 0; x < W; x++) {
				int q = at[y * W + x];
				double z = gd_row(here.p[2], y)[x] / unit;
				double wanted = x - 80.0 * step / z;

				if (q < 0) {
					lost += wanted > 1 && wanted < W - 2;
					continue;
				}
				if (abs(q / W - y) > 1 || fabs(q % W - wanted) > 1.5)
					fail_msg("(%d, %d) is at (%d, %d), expected (%g, %d)", x, y,
						 q % W, q / W, wanted, y);
			}
		assert_in_range(lost, 0, W * H / 50);
	}
	free(at);
	free(here.block);
	free(there.block);
}

static void nothing_and_something_else(void **unused)
{
	struct view here, there;
	int *at = malloc(sizeof *at * W * H);

	(void)unused;
	assert_non_null(at);
	view_new(&here);
	view_new(&there);
	gd_follow(at, here.p, there.p);		/* all sky: where it was */
	for (int i = 0; i < W * H; i++)
		assert_int_equal(at[i], i);
	look(&here, 0, 1);
	gd_follow(at, here.p, there.p);
	for (int i = 0; i < W * H; i++)
		assert_int_equal(at[i], -1);
	look(&there, 500, 1);
	gd_follow(at, here.p, there.p);
	for (int i = 0; i < W * H; i++)
		assert_int_equal(at[i], -1);
	look(&there, 0, 1);
	for (int y = 20; y < 40; y++)		/* something that moved, a hole, no number */
		for (int x = 20; x < 40; x++) {
			gd_row(there.p[2], y)[x] -= 3;
			gd_row(there.p[0], y)[x + 30] = NAN;
			gd_row(there.p[1], y)[x + 30] = INFINITY;
		}
	gd_follow(at, here.p, there.p);
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++) {
			bool there_still = y < 20 || y >= 40 || x < 20 || x >= 70 ||
					   (x >= 40 && x < 50);

			assert_int_equal(at[y * W + x], there_still ? y * W + x : -1);
		}
	free(at);
	free(here.block);
	free(there.block);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(a_camera_moves),
		cmocka_unit_test(nothing_and_something_else),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
