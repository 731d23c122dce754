/* SPDX-License-Identifier: BSD-3-Clause */
/* What cross-fitted regressions share, against sums written out. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "apr.h"
#include "halves.h"
#include "pilot.h"

#define W 37
#define H 23

static double draw(unsigned *seed)
{
	double sum = 0;

	for (int i = 0; i < 4; i++) {	/* variance 1 */
		*seed = *seed * 1664525u + 1013904223u;
		sum += (double)(*seed >> 8) / (1 << 24) - 0.5;
	}
	return sum * 1.7320508;
}

static void new_planes(struct gd_plane *p, int n)
{
	const struct gd_plane like = { NULL, W, H, 0 };
	struct gd_err err = { 0 };

	assert_int_equal(gd_halves_planes(p, n, like, &err), GD_OK);
	gd_halves_clear(p, n);
}

static void fill(struct gd_plane p, double v)
{
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++)
			gd_row(p, y)[x] = (float)v;
}

static void close_to(double a, double b, double tolerance)
{
	if (!(fabs(a - b) <= tolerance))
		fail_msg("%.9g, expected %.9g", a, b);
}

static void test_floats(void **state)
{
	(void)state;
	assert_true(gd_halves_float(1e300) == FLT_MAX && gd_halves_float(-1e300) == -FLT_MAX);
	assert_true(gd_halves_float(0.5) == 0.5f && gd_halves_square(1e300) == 1e38f);
	assert_true(isfinite(gd_halves_square(1e77) + gd_halves_square(1e77)));
}

static void test_level(void **state)
{
	struct gd_plane p[3];
	double level;

	(void)state;
	new_planes(p, 3);
	for (int c = 0; c < 3; c++)
		fill(p[c], c + 1);
	assert_int_equal(gd_halves_level(&level, p, NULL), GD_OK);
	close_to(level, 2, 1e-6);
	for (int c = 0; c < 3; c++)
		gd_row(p[c], 9)[9] = 1e30f;	/* a firefly does not move it */
	fill(p[0], -5);				/* and what is negative counts 0 */
	assert_int_equal(gd_halves_level(&level, p, NULL), GD_OK);
	close_to(level, 5.0 / 3, 1e-6);
	gd_halves_free(p, 3);
	assert_null(p[0].v);
}

static void test_weight(void **state)
{
	struct gd_plane p[3], weight;

	(void)state;
	new_planes(p, 3);
	new_planes(&weight, 1);
	for (int c = 0; c < 3; c++) {
		fill(p[c], 1);
		gd_row(p[c], 3)[4] = 0;
		gd_row(p[c], 3)[5] = 30;
	}
	assert_int_equal(gd_halves_weight(weight, p, NULL), GD_OK);
	close_to((double)gd_row(weight, 3)[4], 1, 0);
	close_to((double)gd_row(weight, 9)[9] * 101, 1, 0.03);	/* level 1, within a few % */
	close_to((double)gd_row(weight, 3)[5] / (double)gd_row(weight, 9)[9], 1.0 / 900, 2e-5);
	gd_halves_free(p, 3);
	gd_halves_free(&weight, 1);
}

static void test_scale(void **state)
{
	struct gd_plane p[4];
	int which[3], n;

	(void)state;
	new_planes(p, 4);
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++) {
			gd_row(p[0], y)[x] = (float)(100 + 7 * x);
			gd_row(p[1], y)[x] = 3;
			gd_row(p[2], y)[x] = (float)(1e-3 * y);
			gd_row(p[3], y)[x] = (float)y;
		}
	assert_int_equal(gd_halves_scale(which, &n, p, 4, 2, NULL), GD_OK);
	assert_int_equal(n, 2);
	assert_int_equal(which[0], 0);
	assert_int_equal(which[1], 2);
	close_to((double)gd_row(p[0], 0)[W - 1] - (double)gd_row(p[0], 0)[0], 1, 0.05);
	close_to((double)gd_row(p[0], 0)[W / 2], 0, 1e-6);
	close_to((double)gd_row(p[3], 5)[0], 5, 0);	/* one too many: left alone */
	gd_halves_free(p, 4);
}

/* Mean and squared distances of fits as if they were all at hand. */
static void test_add(void **state)
{
	struct gd_plane mean[4], square[3], fit[4];
	double v[6], sum = 0, squares = 0;
	unsigned seed = 1;

	(void)state;
	new_planes(mean, 4);
	new_planes(square, 3);
	new_planes(fit, 4);
	for (int k = 0; k < 6; k++) {
		v[k] = 5 + draw(&seed);
		for (int c = 0; c < 4; c++)
			fill(fit[c], (c + 1) * v[k]);
		sum += v[k] / 6;
		gd_halves_add(mean, square, fit, 4, k + 1);
	}
	for (int k = 0; k < 6; k++)
		squares += (v[k] - sum) * (v[k] - sum);
	for (int c = 0; c < 4; c++)
		close_to((double)gd_row(mean[c], 7)[7], (c + 1) * sum, 1e-5);
	for (int c = 0; c < 3; c++)
		close_to((double)gd_row(square[c], 7)[7], (c + 1) * (c + 1) * squares, 1e-4);
	gd_halves_free(mean, 4);
	gd_halves_free(square, 3);
	gd_halves_free(fit, 4);
}

struct job {
	struct gd_crossfit_in in;
	struct gd_plane est[3], other[3], mse[3], spare;
};

static struct job *new_job(void)
{
	struct job *j = calloc(1, sizeof *j);

	j->in.ny = 3;
	for (int h = 0; h < 2; h++) {
		new_planes(j->in.y[h], 3);
		new_planes(&j->in.count[h], 1);
	}
	new_planes(j->est, 3);
	new_planes(j->other, 3);
	new_planes(j->mse, 3);
	new_planes(&j->spare, 1);
	return j;
}

static void free_job(struct job *j)
{
	for (int h = 0; h < 2; h++) {
		gd_halves_free(j->in.y[h], 3);
		gd_halves_free(&j->in.count[h], 1);
	}
	gd_halves_free(j->est, 3);
	gd_halves_free(j->other, 3);
	gd_halves_free(j->mse, 3);
	gd_halves_free(&j->spare, 1);
	free(j);
}

/* Fits 4 and 6, shares 3/4 and 1/4: by in->share, and by counts of any unit. */
static void test_finish(void **state)
{
	(void)state;
	for (int counts = 0; counts < 2; counts++) {
		struct job *j = new_job();
		struct gd_crossfit_out out = { .est = j->est, .mse = j->mse };
		double gain;

		for (int c = 0; c < 3; c++) {
			fill(j->in.y[0][c], 4);
			fill(j->in.y[1][c], 6);
			fill(j->est[c], 4);
			fill(j->other[c], 6);
			fill(j->mse[c], 0.5);
		}
		fill(j->in.count[0], 21);
		fill(j->in.count[1], 7);
		if (!counts) {
			gd_halves_free(j->in.count, 2);
			j->in.share[0] = 0.75;
			j->in.share[1] = 0.25;
		}
		assert_int_equal(gd_halves_check(&j->in, NULL), GD_OK);
		assert_int_equal(gd_halves_finish(&out, j->other, &j->in, 2, j->spare, &gain, NULL),
				 GD_OK);
		close_to(gain, 1, 1e-6);
		for (int c = 0; c < 3; c++) {
			close_to((double)gd_row(j->est[c], 5)[5], 4.5, 1e-5);
			close_to((double)gd_row(j->mse[c], 5)[5], 0.1875 * 4 + 1, 1e-5);
		}
		free_job(j);
	}
}

/* Where the fits took 2 % of the light it comes back; where they took half, nothing does. */
static void test_mean_is_kept(void **state)
{
	(void)state;
	for (int far = 0; far < 2; far++) {
		struct job *j = new_job();
		struct gd_crossfit_out out = { .est = j->est, .mse = j->mse };
		double gain, sum = 0;

		for (int c = 0; c < 3; c++)
			for (int h = 0; h < 2; h++) {
				fill(j->in.y[h][c], 1);
				fill(h ? j->other[c] : j->est[c], far ? 0.5 : 0.98);
				fill(j->in.count[h], 1);
			}
		assert_int_equal(gd_halves_check(&j->in, NULL), GD_OK);
		assert_int_equal(gd_halves_finish(&out, j->other, &j->in, 0, j->spare, &gain, NULL),
				 GD_OK);
		for (int y = 0; y < H; y++)
			for (int x = 0; x < W; x++)
				sum += (double)gd_row(j->est[1], y)[x] / W / H;
		close_to(sum, far ? 0.5 : 1, 1e-5);
		close_to(gain, far ? 1 : 1 + 2 * 0.02 / 0.98, 1e-4);
		free_job(j);
	}
}

static void test_cut(void **state)
{
	struct job *j = new_job();
	struct gd_crossfit_frame frame = { 0 };
	double all;

	(void)state;
	new_planes(j->in.whole, 3);
	j->in.nwhole = 3;
	j->in.nframe = 1;
	j->in.frame = &frame;
	for (int h = 0; h < 2; h++) {
		new_planes(frame.y[h], 3);
		fill(j->in.count[h], 1);
	}
	new_planes(frame.whole, 3);
	for (int c = 0; c < 3; c++) {
		for (int h = 0; h < 2; h++) {
			fill(j->in.y[h][c], 1);
			fill(frame.y[h][c], 1);
		}
		fill(j->in.whole[c], 1);
		fill(frame.whole[c], 1);
		gd_row(j->in.y[0][c], 4)[4] = 1e6f;
		gd_row(j->in.whole[c], 4)[4] = 5e5f;
		gd_row(j->in.y[0][c], 8)[8] = 900;	/* bright, but no firefly */
		gd_row(frame.y[1][c], 6)[6] = 1e30f;
	}
	assert_int_equal(gd_halves_check(&j->in, NULL), GD_OK);
	assert_int_equal(gd_halves_cut(&j->in, NULL), GD_OK);
	all = (double)gd_row(j->in.y[0][0], 4)[4];
	assert_true(all > 1000 && all < 3000);
	close_to((double)gd_row(j->in.whole[0], 4)[4], (all + 1) / 2, 5);
	close_to((double)gd_row(j->in.y[0][0], 8)[8], 900, 0);
	assert_true(gd_row(frame.y[1][2], 6)[6] < 3000);
	for (int h = 0; h < 2; h++)
		gd_halves_free(frame.y[h], 3);
	gd_halves_free(frame.whole, 3);
	gd_halves_free(j->in.whole, 3);
	free_job(j);
}

/*
 * Unequal samples: half of the pixels have 5 times as many. A flat window's fit with these weights
 * is sum n y / sum n, and its variance over many draws sigma^2 / sum n, the least there is; pixels
 * weighed alike would have 9/5 of it.
 */
static void test_counts_are_optimal(void **state)
{
	struct job *j = new_job();
	struct gd_plane weight, est;
	struct gd_apr_conf conf = { 64, 129, 0, 0, GD_APR_BOX, 0, 1, 0, 0 };
	struct gd_apr_in apr = { .ny = 1, .y = j->in.y[0] };
	struct gd_apr_out out = { .est = &est };
	const int draws = 400;
	double square = 0, all = 0;
	unsigned seed = 17;

	(void)state;
	new_planes(&weight, 1);
	new_planes(&est, 1);
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++) {
			gd_row(j->in.count[0], y)[x] = (x + y) % 2 ? 10 : 2;
			all += (double)gd_row(j->in.count[0], y)[x];
		}
	for (int i = 0; i < draws; i++) {
		double sum = 0, v;

		for (int y = 0; y < H; y++)
			for (int x = 0; x < W; x++) {
				double n = (double)gd_row(j->in.count[0], y)[x];

				v = 3 + draw(&seed) / sqrt(n);
				gd_row(j->in.y[0][0], y)[x] = (float)v;
				sum += n * v;
			}
		fill(weight, 1);
		gd_halves_weigh_count(weight, &j->in, 0);
		apr.weight = weight;
		assert_int_equal(gd_apr_fit(&out, &apr, &conf, NULL, NULL), GD_OK);
		v = (double)gd_row(est, 11)[11];
		close_to(v, sum / all, 1e-6 * 3);
		square += (v - 3) * (v - 3) / draws;
	}
	close_to(square * all, 1, 4 * sqrt(2.0 / draws));
	gd_halves_free(&weight, 1);
	gd_halves_free(&est, 1);
	free_job(j);
}

static void test_no_samples(void **state)
{
	struct job *j = new_job();
	struct gd_plane weight;

	(void)state;
	new_planes(&weight, 1);
	fill(weight, 1);
	gd_halves_weigh_count(weight, &j->in, 0);	/* none anywhere */
	for (int x = 0; x < W; x++)
		assert_true(gd_row(weight, 3)[x] > 0 && isfinite(gd_row(weight, 3)[x]));
	close_to(gd_halves_share(&j->in, 1, 3, 3), 0.5, 0);
	fill(j->in.count[1], 4);
	gd_row(j->in.count[1], 5)[5] = 0;
	fill(weight, 1);
	gd_halves_weigh_count(weight, &j->in, 1);
	close_to((double)gd_row(weight, 5)[5], 1e-6, 1e-8);
	close_to((double)gd_row(weight, 5)[6], 1, 1e-2);
	close_to(gd_halves_share(&j->in, 1, 3, 3), 1, 0);
	gd_halves_free(&weight, 1);
	free_job(j);
}

/* A pixel that one half has no samples of, nor light in the other: nothing infinite comes of it. */
static void test_one_sided(void **state)
{
	const struct gd_nlr_conf narrow = GD_PILOT_NARROW;
	const struct gd_pilot_features none = { 0 };
	struct job *j = new_job();

	(void)state;
	new_planes(j->in.whole, 3);
	new_planes(j->in.var, 3);
	j->in.nwhole = 3;
	for (int h = 0; h < 2; h++)
		fill(j->in.count[h], 1);
	gd_row(j->in.count[0], 5)[5] = gd_row(j->in.count[0], 9)[9] = 0;
	for (int c = 0; c < 3; c++) {
		for (int h = 0; h < 2; h++)
			fill(j->in.y[h][c], 1);
		fill(j->in.whole[c], 1);
		fill(j->in.var[c], 1);
		gd_row(j->in.y[0][c], 5)[5] = 1e9f;
		gd_row(j->in.y[1][c], 5)[5] = gd_row(j->in.var[c], 5)[5] = 0;
	}
	assert_int_equal(gd_halves_check(&j->in, NULL), GD_OK);
	assert_int_equal(gd_halves_cut(&j->in, NULL), GD_OK);
	close_to((double)gd_row(j->in.whole[0], 5)[5], 1, 0);
	assert_int_equal(gd_pilot_make(j->est, &j->in, 0, &none, &narrow, j->mse, j->spare, NULL),
			 GD_OK);
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++)
			assert_true(gd_row(j->mse[0], y)[x] > 1.5f &&
				    gd_row(j->mse[0], y)[x] < 2.1f);
	gd_halves_free(j->in.whole, 3);
	gd_halves_free(j->in.var, 3);
	free_job(j);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_floats), cmocka_unit_test(test_level),
		cmocka_unit_test(test_weight), cmocka_unit_test(test_scale),
		cmocka_unit_test(test_add), cmocka_unit_test(test_finish),
		cmocka_unit_test(test_mean_is_kept), cmocka_unit_test(test_cut),
		cmocka_unit_test(test_counts_are_optimal), cmocka_unit_test(test_no_samples),
		cmocka_unit_test(test_one_sided)
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
