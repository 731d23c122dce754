/* SPDX-License-Identifier: BSD-3-Clause */
/* Where gradients are asked for, in images of which it is known where they help. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <omp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "buffers.h"
#include "spending.h"

#define BINS 8

static double uniform(uint64_t *state)
{
	uint64_t z = *state += 0x9e3779b97f4a7c15u;

	z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
	z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
	z ^= z >> 31;
	return (double)(z >> 11) * 0x1p-53;
}

static double normal(uint64_t *state)
{
	return sqrt(-2 * log(1 - uniform(state))) * cos(2 * M_PI * uniform(state));
}

/* Fine stripes and waves: hard to see in the noise, and in no G-buffer. */
static double truth(int x, int y)
{
	return 0.5 + 0.2 * sin(0.9 * x + 0.05 * y * y) + ((x / 3 + y / 4) % 2 ? 0.1 : 0);
}

/*
 * Bins with noise of 0.5 in the colour, and in the gradients left[0] left of the middle, right[0]
 * right of it.
 */
static struct gd_image make(int w, int h, double left, double right, double scale)
{
	struct gd_image im;
	struct gd_plane p[3][GD_LAYER_PLANES];
	uint64_t seed = 7;
	char name[32];

	gd_image_init(&im, w, h);
	for (int b = 0; b < BINS; b++) {
		static const char *const layer[] = { "bin%d", "bin%d.dx", "bin%d.dy" };

		for (int k = 0; k < 3; k++) {
			snprintf(name, sizeof name, layer[k], b);
			assert_int_equal(gd_layer_add(&im, name, 3, p[k], NULL), GD_OK);
		}
		for (int y = 0; y < h; y++)
			for (int x = 0; x < w; x++)
				for (int c = 0; c < 3; c++) {
					double s = x < w / 2 ? left : right, v = truth(x, y);
					double dx = truth(x + 1, y) - v, dy = truth(x, y + 1) - v;

					v += 0.5 * normal(&seed);
					dx = x + 1 < w ? dx + s * normal(&seed) : 0;
					dy = y + 1 < h ? dy + s * normal(&seed) : 0;
					gd_row(p[0][c], y)[x] = (float)(scale * v);
					gd_row(p[1][c], y)[x] = (float)(scale * dx);
					gd_row(p[2][c], y)[x] = (float)(scale * dy);
				}
	}
	return im;
}

static struct gd_plane plane(int w, int h)
{
	struct gd_plane p = gd_plane_of(gd_calloc(gd_stride(w) * (size_t)h, sizeof(float)), w, h);

	assert_non_null(p.v);
	return p;
}

static double mean(struct gd_plane p, int x0, int x1)
{
	double sum = 0;

	for (int y = 0; y < p.h; y++)
		for (int x = x0; x < x1; x++) {
			float v = gd_row(p, y)[x];

			assert_true(v >= 0 && v <= 1);
			sum += (double)v;
		}
	return sum / (x1 - x0) / p.h;
}

static struct gd_spending_result run(struct gd_plane share, const struct gd_image *im, double cost)
{
	struct gd_spending_conf conf = GD_SPENDING_DEFAULTS;
	struct gd_spending_result r;
	struct gd_err err = { 0 };

	conf.cost = cost;
	if (gd_spending_map(share, im, &conf, &r, NULL, &err) != GD_OK)
		fail_msg("%s", err.text);
	return r;
}

#ifndef __SANITIZE_ADDRESS__
static void all_or_nothing(void **state)
{
	struct gd_plane share = plane(96, 64);
	struct gd_image im = make(96, 64, 0.02, 0.02, 1);
	struct gd_spending_result r = run(share, &im, 2);

	(void)state;
	assert_true(mean(share, 0, 96) > 0.9);
	assert_true(r.share > 0.9 && r.change < -0.4 && r.gain < 0.8 && r.everywhere < 0.8);
	gd_image_free(&im);
	im = make(96, 64, 6, 6, 1);
	r = run(share, &im, 2);
	assert_true(mean(share, 0, 96) < 0.02);
	assert_true(r.share < 0.02 && r.gain > 0.99 && r.gain <= 1.001 && r.everywhere > 1.1);
	gd_image_free(&im);
	free(share.v);
}

/* Samples without gradients gain the less, the more gradients cost. */
static void cost(void **state)
{
	struct gd_plane share = plane(96, 64);
	struct gd_image im = make(96, 64, 1, 1, 1);
	double was = 2, costs[] = { 1, 2, 4, 16 };

	(void)state;
	for (int i = 0; i < 4; i++) {
		struct gd_spending_result r = run(share, &im, costs[i]);

		assert_true(r.share <= was && r.gain <= 1.001 + 0.05);
		was = r.share;
	}
	assert_true(was < 0.01);
	gd_image_free(&im);
	free(share.v);
}
#endif

static void by_region(void **state)
{
	struct gd_plane share = plane(160, 64);
	struct gd_image im = make(160, 64, 0.02, 6, 1);
	struct gd_spending_result r = run(share, &im, 2);

	(void)state;
	assert_true(mean(share, 0, 60) > 0.8);
	assert_true(mean(share, 100, 160) < 0.1);
	assert_true(r.gain < 1 && r.gain < r.everywhere);
	gd_image_free(&im);
	free(share.v);
}

/* Neither threads nor the unit of radiance matter. */
static void same(void **state)
{
	struct gd_plane one = plane(80, 48), other = plane(80, 48);
	struct gd_image im = make(80, 48, 0.1, 6, 1);
	const size_t size = (size_t)one.h * one.stride * sizeof(float);

	(void)state;
	omp_set_num_threads(1);
	run(one, &im, 2);
	omp_set_num_threads(3);
	run(other, &im, 2);
	assert_memory_equal(one.v, other.v, size);
	gd_image_free(&im);
	im = make(80, 48, 0.1, 6, 4096);
	run(other, &im, 2);
	for (int y = 0; y < 48; y++)
		for (int x = 0; x < 80; x++)
			assert_true(fabsf(gd_row(one, y)[x] - gd_row(other, y)[x]) < 0.02f);
	gd_image_free(&im);
	free(one.v);
	free(other.v);
}

/* Values that are no radiance do no harm; a black image needs no gradients. */
static void hard(void **state)
{
	static const int sizes[][2] = { { 1, 1 }, { 1, 9 }, { 7, 1 }, { 33, 29 } };

	(void)state;
	for (int i = 0; i < 4; i++) {
		int w = sizes[i][0], h = sizes[i][1];
		struct gd_plane share = plane(w, h), p;
		struct gd_image im = make(w, h, 0.1, 0.1, 1);

		gd_image_plane(&im, "bin0.R", &p);
		gd_row(p, 0)[0] = 1e30f;
		gd_image_plane(&im, "bin1.G", &p);
		gd_row(p, h / 2)[w / 2] = NAN;
		gd_image_plane(&im, "bin3.dx.B", &p);
		gd_row(p, h - 1)[w - 1] = INFINITY;
		run(share, &im, 2);
		mean(share, 0, w);
		gd_image_free(&im);
		im = make(w, h, 0.1, 0.1, 0);
		assert_true(run(share, &im, 2).gain <= 1);
		assert_true(mean(share, 0, w) == 0);
		gd_image_free(&im);
		free(share.v);
	}
}

static void refused(void **state)
{
	struct gd_spending_conf conf = GD_SPENDING_DEFAULTS;
	struct gd_plane share = plane(8, 8), small = plane(7, 8);
	struct gd_image im = make(8, 8, 0.1, 0.1, 1);
	struct gd_err err = { 0 };

	(void)state;
	assert_int_equal(gd_spending_map(small, &im, &conf, NULL, NULL, &err), GD_ESHAPE);
	conf.cost = 0.5;
	assert_int_equal(gd_spending_map(share, &im, &conf, NULL, NULL, NULL), GD_EARG);
	conf.cost = NAN;
	assert_int_equal(gd_spending_map(share, &im, &conf, NULL, NULL, NULL), GD_EARG);
	conf.cost = 2;
	conf.dimension = -1;
	assert_int_equal(gd_spending_map(share, &im, &conf, NULL, NULL, NULL), GD_EARG);
	conf.dimension = 4;
	gd_image_drop(&im, "bin3.dy.G");
	err = (struct gd_err){ 0 };
	assert_int_equal(gd_spending_map(share, &im, &conf, NULL, NULL, &err), GD_ESHAPE);
	assert_string_equal(err.text, "3 bins of dy, at least 4 are needed");
	assert_int_equal(gd_spending_want(&im, NULL), GD_ESHAPE);
	gd_image_free(&im);
	free(share.v);
	free(small.v);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
#ifndef __SANITIZE_ADDRESS__	/* minutes there, of code that the others run, too */
		cmocka_unit_test(all_or_nothing), cmocka_unit_test(cost),
#endif
		cmocka_unit_test(by_region),	  cmocka_unit_test(same),
		cmocka_unit_test(hard),		  cmocka_unit_test(refused),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
