/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * The variance that a feature without bins is given: that of its detail, from the variance of the
 * edges. Against what noise on the gradients does to the solution, and what the filter then leaves.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "feature.h"

#define SIDE 96
#define SIGMA 2.0
#define REACH 6

static uint64_t state = 1;

static double normal(void)
{
	double u[2];

	for (int i = 0; i < 2; i++) {
		state = state * 6364136223846793005u + 1442695040888963407u;
		u[i] = (double)(state >> 11) / 9007199254740992.0;
	}
	return sqrt(-2.0 * log(1.0 - u[0])) * cos(6.283185307179586 * u[1]);
}

static struct gd_plane add(struct gd_image *im, const char *layer, char c)
{
	struct gd_plane p;
	char name[64];

	snprintf(name, sizeof name, "%s%s%c", layer, *layer ? "." : "", c);
	assert_int_equal(gd_image_add(im, name, &p, NULL), GD_OK);
	return p;
}

/* A black image whose gradients are noise of the given standard deviation. */
static void make(struct gd_image *im, double sd)
{
	static const char *const layer[] = { "", "dx", "dy", "dx.variance", "dy.variance" };

	gd_image_init(im, SIDE, SIDE);
	for (int i = 0; i < 5; i++)
		for (int c = 0; c < 3; c++) {
			struct gd_plane p = add(im, layer[i], "RGB"[c]);

			for (int y = 0; y < SIDE; y++)
				for (int x = 0; x < SIDE; x++)
					gd_row(p, y)[x] = i == 0 ? 0.0f :
						(float)(i < 3 ? sd * normal() : sd * sd);
		}
}

/* Mean square of p less its Gaussian mean, away from the border. */
static double detail(struct gd_plane p)
{
	double sum = 0.0;
	int n = 0;

	for (int y = REACH; y < SIDE - REACH; y++)
		for (int x = REACH; x < SIDE - REACH; x++, n++) {
			double mean = 0.0, weight = 0.0;

			for (int j = -REACH; j <= REACH; j++)
				for (int i = -REACH; i <= REACH; i++) {
					double w = exp(-(i * i + j * j) / (2.0 * SIGMA * SIGMA));

					mean += w * gd_row(p, y + j)[x + i];
					weight += w;
				}
			sum += pow(gd_row(p, y)[x] - mean / weight, 2.0);
		}
	return sum / n;
}

static void told_is_found(void **unused)
{
	const double sd[] = { 1e-6, 0.3, 1e6 };
	struct gd_feature_conf conf = GD_FEATURE_DEFAULTS;

	(void)unused;
	conf.filter = false;
	for (int k = 0; k < 3; k++) {
		struct gd_image im;
		struct gd_plane f, v;
		double found = 0.0, told = 0.0;

		make(&im, sd[k]);
		assert_int_equal(gd_feature_want(&im, &conf, NULL), GD_OK);
		assert_int_equal(gd_feature_run(&im, &conf, NULL, NULL, NULL), GD_OK);
		for (int c = 0; c < 3; c++) {
			char name[32];

			snprintf(name, sizeof name, "feature.%c", "RGB"[c]);
			assert_true(gd_image_plane(&im, name, &f));
			snprintf(name, sizeof name, "feature.variance.%c", "RGB"[c]);
			assert_true(gd_image_plane(&im, name, &v));
			found += detail(f) / 3.0;
			told += gd_row(v, SIDE / 2)[SIDE / 2] / 3.0;
		}
		/* 3 x 7056 values that are correlated over a few pixels: some 2 % */
		if (!(fabs(told / found - 1.0) < 0.06))
			fail_msg("noise %g: detail has variance %g, told %g", sd[k], found, told);
		gd_image_free(&im);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(told_is_found),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
