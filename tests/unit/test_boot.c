/* SPDX-License-Identifier: BSD-3-Clause */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <cmocka.h>

#include <omp.h>

#include "../support/poisson_case.h"
#include "boot.h"

struct bins {
	int n, w, h;
	struct gd_plane dx[64][3], dy[64][3];
	struct gd_plane mean[3], var[3], local[3];
	struct problem p;	/* the means */
	struct gd_boot_in in;
	struct gd_boot_out out;
};

static struct bins *bins_new(int w, int h, int n, double sigma, uint64_t seed)
{
	struct bins *b = calloc(1, sizeof(*b));
	struct noise noise = { seed };

	b->n = n;
	b->w = w;
	b->h = h;
	b->p = problem_new(w, h, 0, 1);
	for (int k = 0; k < n; k++)
		for (int c = 0; c < 3; c++) {
			b->dx[k][c] = blank(w, h);
			b->dy[k][c] = blank(w, h);
			for (int y = 0; y < h; y++)
				for (int x = 0; x < w; x++) {
					gd_row(b->dx[k][c], y)[x] =
						(float)((double)gd_row(b->p.in.dx[c], y)[x] +
							sigma * normal(&noise));
					gd_row(b->dy[k][c], y)[x] =
						(float)((double)gd_row(b->p.in.dy[c], y)[x] +
							sigma * normal(&noise));
				}
		}
	b->in = (struct gd_boot_in){3,
				    n,
				    (const struct gd_plane(*)[3])b->dx,
				    (const struct gd_plane(*)[3])b->dy,
				    {b->p.in.primal[0], b->p.in.primal[1], b->p.in.primal[2]}};
	for (int c = 0; c < 3; c++) {
		b->out.mean[c] = b->mean[c] = blank(w, h);
		b->out.var[c] = b->var[c] = blank(w, h);
		b->out.local[c] = b->local[c] = blank(w, h);
	}
	return b;
}

static void bins_free(struct bins *b)
{
	for (int c = 0; c < 3; c++) {
		for (int k = 0; k < b->n; k++) {
			free(b->dx[k][c].v);
			free(b->dy[k][c].v);
		}
		free(b->mean[c].v);
		free(b->var[c].v);
		free(b->local[c].v);
	}
	problem_free(&b->p);
	free(b);
}

static struct gd_boot_result run(struct bins *b, const struct gd_boot_conf *conf)
{
	struct gd_boot_result result;
	struct gd_err err = { 0 };

	if (gd_boot_run(&b->out, &b->in, conf, &result, NULL, &err) != GD_OK)
		fail_msg("%s", err.text);
	return result;
}

/* Without noise all replicates agree: the image comes back and its variance is rounding. */
static void test_exact_bins(void **state)
{
	struct gd_boot_conf conf = GD_BOOT_DEFAULTS;
	struct bins *b = bins_new(70, 50, 8, 0, 1);

	(void)state;
	conf.tolerance = 1e-6;
	run(b, &conf);
	for (int c = 0; c < 3; c++) {
		assert_true(largest_difference(b->mean[c], b->p.truth[c]) < 1e-4);
		assert_true(mean_of(b->var[c]) < 1e-9);
		assert_true(mean_of(b->local[c]) < 1e-9);
	}
	bins_free(b);
}

/* Squared error against the truth, free of the constant. */
static double error_of(struct gd_plane f, struct gd_plane truth, bool local)
{
	double s = 0;
	int n = 0;

	for (int y = 4; y < f.h - 4; y++)
		for (int x = 4; x < f.w - 4; x++) {
			double d = (double)gd_row(f, y)[x] - (double)gd_row(truth, y)[x], low = 0;

			for (int j = -4; j <= 4 && local; j++)
				for (int i = -4; i <= 4; i++)
					low += ((double)gd_row(f, y + j)[x + i] -
						(double)gd_row(truth, y + j)[x + i]) /
					       81;
			s += (d - low) * (d - low);
			n++;
		}
	return s / n;
}

/*
 * Over many noise seeds the bootstrap's variance agrees with the true squared error, up to
 * (B - 1) / B, which resampling B values with replacement loses, and the spread of ten replicates.
 */
static void test_variance_is_the_squared_error(void **state)
{
	struct gd_boot_conf conf = GD_BOOT_DEFAULTS;
	double var = 0, local = 0, error = 0, high = 0;

	(void)state;
	for (uint64_t seed = 1; seed <= 12; seed++) {
		struct bins *b = bins_new(48, 40, 8, 0.3, seed);

		conf.seed = seed;
		run(b, &conf);
		for (int c = 0; c < 3; c++) {
			var += mean_of(b->var[c]);
			local += mean_of(b->local[c]);
			error += error_of(b->mean[c], b->p.truth[c], false);
			high += error_of(b->mean[c], b->p.truth[c], true);
		}
		bins_free(b);
	}
	if (!(var / error > 0.55 && var / error < 1.3))
		fail_msg("variance %g, squared error %g", var / 36, error / 36);
	if (!(local / high > 0.5 && local / high < 1.5))
		fail_msg("local variance %g, squared error %g", local / 36, high / 36);
	assert_true(local < 0.7 * var);
}

static void test_seed_and_threads(void **state)
{
	static const int threads[3] = { 1, 2, 7 };
	const int before = omp_get_max_threads();
	struct gd_boot_conf conf = GD_BOOT_DEFAULTS;
	struct bins *b[3], *other = bins_new(150, 120, 8, 0.2, 3);

	(void)state;
	for (int i = 0; i < 3; i++) {
		b[i] = bins_new(150, 120, 8, 0.2, 3);
		omp_set_num_threads(threads[i]);
		run(b[i], &conf);
	}
	omp_set_num_threads(before);
	conf.seed = 2;
	run(other, &conf);
	for (int c = 0; c < 3; c++) {
		for (int i = 1; i < 3; i++) {
			assert_true(largest_difference(b[0]->mean[c], b[i]->mean[c]) == 0);
			assert_true(largest_difference(b[0]->var[c], b[i]->var[c]) == 0);
			assert_true(largest_difference(b[0]->local[c], b[i]->local[c]) == 0);
		}
		assert_true(largest_difference(b[0]->mean[c], other->mean[c]) > 0);
	}
	for (int i = 0; i < 3; i++)
		bins_free(b[i]);
	bins_free(other);
}

/* The plain feature is wls of the mean with the variance of the mean. */
static void test_plain_is_wls(void **state)
{
	struct gd_boot_conf conf = GD_BOOT_DEFAULTS;
	struct gd_poisson_conf wls = GD_POISSON_DEFAULTS;
	struct gd_err err = { 0 };
	struct bins *b = bins_new(61, 47, 6, 0.2, 4);

	(void)state;
	for (int c = 0; c < 3; c++)
		for (int y = 0; y < b->h; y++)
			for (int x = 0; x < b->w; x++)
				for (int d = 0; d < 2; d++) {
					double sum = 0, square = 0;

					for (int k = 0; k < 6; k++)
						sum += (double)gd_row(d ? b->dy[k][c] : b->dx[k][c],
								      y)[x] /
						       6;
					for (int k = 0; k < 6; k++)
						square += pow((double)gd_row(d ? b->dy[k][c]
									       : b->dx[k][c],
									     y)[x] -
								      sum,
							      2) /
							  30;
					gd_row(d ? b->p.in.dy[c] : b->p.in.dx[c], y)[x] =
						(float)sum;
					gd_row(d ? b->p.in.dyvar[c] : b->p.in.dxvar[c], y)[x] =
						(float)square;
				}
	conf.tolerance = wls.tolerance = 3e-6;
	wls.method = GD_WLS;
	assert_int_equal(gd_boot_plain(b->mean, &b->in, &conf, NULL, NULL, &err), GD_OK);
	assert_int_equal(gd_poisson_solve(b->p.out, &b->p.in, &wls, NULL, NULL, &err), GD_OK);
	for (int c = 0; c < 3; c++)
		assert_true(largest_difference(b->mean[c], b->p.out[c]) < 1e-4);
	bins_free(b);
}

static void test_few_bins(void **state)
{
	struct gd_boot_conf conf = GD_BOOT_DEFAULTS;

	(void)state;
	for (int n = 1; n <= 3; n++) {
		struct bins *b = bins_new(40, 30, n, 0.1, 5);

		run(b, &conf);
		for (int c = 0; c < 3; c++) {
			assert_true(all_finite(b->mean[c]) && all_finite(b->var[c]) &&
				    all_finite(b->local[c]));
			assert_true(mean_of(b->var[c]) > 0 && mean_of(b->local[c]) > 0);
			assert_true(error_of(b->mean[c], b->p.truth[c], false) < 0.1);
		}
		bins_free(b);
	}
}

/* A bin that is not a number is as if it had the mean of the others. */
static void test_bad_bins_are_replaced(void **state)
{
	struct gd_boot_conf conf = GD_BOOT_DEFAULTS;
	struct bins *a = bins_new(40, 30, 4, 0.1, 6), *b = bins_new(40, 30, 4, 0.1, 6);

	(void)state;
	for (int c = 0; c < 3; c++) {
		gd_row(a->dx[2][c], 9)[8] = NAN;
		gd_row(a->dy[0][c], 20)[31] = INFINITY;
		gd_row(b->dx[2][c], 9)[8] = (gd_row(b->dx[0][c], 9)[8] + gd_row(b->dx[1][c], 9)[8] +
					     gd_row(b->dx[3][c], 9)[8]) /
					    3;
		gd_row(b->dy[0][c], 20)[31] =
			(gd_row(b->dy[1][c], 20)[31] + gd_row(b->dy[2][c], 20)[31] +
			 gd_row(b->dy[3][c], 20)[31]) /
			3;
	}
	run(a, &conf);
	run(b, &conf);
	for (int c = 0; c < 3; c++)
		assert_true(largest_difference(a->mean[c], b->mean[c]) < 1e-5);
	bins_free(a);
	bins_free(b);
}

static void test_scaling(void **state)
{
	struct gd_boot_conf conf = GD_BOOT_DEFAULTS;
	struct bins *a = bins_new(40, 30, 8, 0.1, 7), *b = bins_new(40, 30, 8, 0.1, 7);

	(void)state;
	for (int c = 0; c < 3; c++)
		for (int y = 0; y < 30; y++)
			for (int x = 0; x < 40; x++) {
				for (int k = 0; k < 8; k++) {
					gd_row(b->dx[k][c], y)[x] *= 0x1p24f;
					gd_row(b->dy[k][c], y)[x] *= 0x1p24f;
				}
				gd_row(b->p.in.primal[c], y)[x] *= 0x1p24f;
			}
	run(a, &conf);
	run(b, &conf);
	for (int c = 0; c < 3; c++)
		for (int y = 0; y < 30; y++)
			for (int x = 0; x < 40; x++) {
				assert_true(gd_row(a->mean[c], y)[x] * 0x1p24f ==
					    gd_row(b->mean[c], y)[x]);
				assert_true(gd_row(a->var[c], y)[x] * 0x1p48f ==
					    gd_row(b->var[c], y)[x]);
			}
	bins_free(a);
	bins_free(b);
}

/* Two solutions whose difference is white noise: a quarter
 * of its variance, but for what the blur takes. */
static void test_halves(void **state)
{
	struct gd_plane a[1] = {blank(80, 60)}, b[1] = {blank(80, 60)}, local[1] = {blank(80, 60)};
	struct noise n = { 8 };
	struct gd_err err = { 0 };

	(void)state;
	for (int y = 0; y < 60; y++)
		for (int x = 0; x < 80; x++) {
			gd_row(a[0], y)[x] = (float)(5 + 0.1 * x + 0.2 * normal(&n));
			gd_row(b[0], y)[x] = (float)(3 + 0.2 * normal(&n));
		}
	assert_int_equal(gd_boot_halves(local, a, b, 1, 2, &err), GD_OK);
	/* var(a - b) / 4 = 0.02; the blur of 2 pixels leaves 1 - 2 g0 + sum g^2 = 0.94 of it */
	assert_true(fabs(mean_of(local[0]) - 0.0189) < 0.002);
	free(a[0].v);
	free(b[0].v);
	free(local[0].v);
}

static void test_wrong_calls_are_refused(void **state)
{
	struct gd_boot_conf conf = GD_BOOT_DEFAULTS;
	struct bins *b = bins_new(20, 20, 3, 0.1, 9);
	struct gd_err err = { 0 };

	(void)state;
	conf.replicates = 1;
	assert_int_equal(gd_boot_run(&b->out, &b->in, &conf, NULL, NULL, &err), GD_EARG);
	conf.replicates = 10;
	b->dy[1][2].w--;
	assert_int_equal(gd_boot_run(&b->out, &b->in, &conf, NULL, NULL, NULL), GD_ESHAPE);
	b->dy[1][2].w++;
	b->in.bins = 65;
	assert_int_equal(gd_boot_run(&b->out, &b->in, &conf, NULL, NULL, NULL), GD_EARG);
	bins_free(b);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_exact_bins),
		cmocka_unit_test(test_variance_is_the_squared_error),
		cmocka_unit_test(test_seed_and_threads),
		cmocka_unit_test(test_plain_is_wls),
		cmocka_unit_test(test_few_bins),
		cmocka_unit_test(test_bad_bins_are_replaced),
		cmocka_unit_test(test_scaling),
		cmocka_unit_test(test_halves),
		cmocka_unit_test(test_wrong_calls_are_refused),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
