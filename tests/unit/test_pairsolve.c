/* SPDX-License-Identifier: BSD-3-Clause */
/* What a solution over pairs must do, whatever its numbers. */
#include <float.h>
#include <omp.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "../support/pairs_case.h"

static void map(struct gd_plane p, double scale, double shift)
{
	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++)
			gd_row(p, y)[x] = (float)((double)gd_row(p, y)[x] * scale + shift);
}

static struct gd_plane copy(struct gd_plane p)
{
	struct gd_plane q = blank(p.w, p.h);

	for (int y = 0; y < p.h; y++)
		memcpy(gd_row(q, y), gd_row(p, y), (size_t)p.w * sizeof(float));
	return q;
}

static void test_exact_gradients_give_the_truth(void **state)
{
	struct paired p = paired_new(70, 50, 0, 0, 1);

	(void)state;
	for (int m = GD_L2; m <= GD_L1; m++) {
		const struct gd_poisson_result r =
			paired_solve(&p, (enum gd_poisson_method)m, 0.2, 1e-6);

		assert_true(r.converged);
		for (int c = 0; c < 3; c++)
			assert_true(largest_difference(p.out[c], p.truth[c]) < 1e-5);
	}
	paired_free(&p);
}

/* A noisy colour, exact gradients and a small alpha:
 * nearly the truth but for the mean of each part. */
static void test_gradients_outweigh_the_colour(void **state)
{
	struct paired p = paired_new(70, 50, 0, 0, 1);
	struct noise n = { 3 };

	(void)state;
	for (int c = 0; c < 3; c++)
		for (int y = 0; y < p.h; y++)
			for (int x = 0; x < p.w; x++)
				gd_row(p.in.primal[c], y)[x] += (float)(0.3 * normal(&n));
	assert_int_equal(paired_solve(&p, GD_L2, 0.001, 1e-6).parts, 1);
	for (int c = 0; c < 3; c++)
		assert_true(largest_difference(p.out[c], p.truth[c]) < 0.03);
	paired_free(&p);
}

static void test_pixels_in_no_pair_keep_their_colour(void **state)
{
	struct paired p = paired_new(40, 30, 0.97, 0.2, 4);
	int alone = 0;

	(void)state;
	for (int m = GD_L2; m <= GD_L1; m++) {
		paired_solve(&p, (enum gd_poisson_method)m, 0.2, 1e-6);
		for (int i = 0; i < 40 * 30; i++) {
			bool lonely = true;

			for (int k = 0; k < GD_PAIRS; k++)
				lonely &= !p.pairs.dx[k][i] && !p.pairs.dy[k][i];
			for (int j = 0; j < 40 * 30; j++)
				for (int k = 0; k < GD_PAIRS; k++)
					lonely &= j == i ||
						  j + p.pairs.dy[k][j] * 40 + p.pairs.dx[k][j] != i;
			alone += lonely;
			for (int c = 0; c < 3 && lonely; c++)
				assert_true(gd_row(p.out[c], i / 40)[i % 40] ==
					    gd_row(p.in.primal[c], i / 40)[i % 40]);
		}
	}
	assert_true(alone > 50);
	paired_free(&p);
}

static void test_linear_and_shifted(void **state)
{
	struct paired p = paired_new(45, 31, 0, 0.3, 5);
	struct gd_plane was[3];

	(void)state;
	for (int m = GD_L2; m <= GD_L1; m++) {
		/* the level of l1's weights is a power of 2 of the brightness */
		const double scale = m == GD_L2 ? 3.7 : 0x1p20;

		paired_solve(&p, (enum gd_poisson_method)m, 0.2, 1e-8);
		for (int c = 0; c < 3; c++) {
			was[c] = copy(p.out[c]);
			map(was[c], scale, 0);
			map(p.in.primal[c], scale, 0);
			for (int k = 0; k < GD_PAIRS; k++)
				map(p.in.value[k][c], scale, 0);
		}
		paired_solve(&p, (enum gd_poisson_method)m, 0.2, 1e-8);
		for (int c = 0; c < 3; c++) {
			assert_true(largest_difference(p.out[c], was[c]) <= 1e-5 * scale);
			map(p.in.primal[c], 1 / scale, 0);
			for (int k = 0; k < GD_PAIRS; k++)
				map(p.in.value[k][c], 1 / scale, 0);
			map(was[c], 1 / scale, 5);
		}
		if (m == GD_L2) {
			for (int c = 0; c < 3; c++)
				map(p.in.primal[c], 1, 5);
			paired_solve(&p, GD_L2, 0.2, 1e-8);
			for (int c = 0; c < 3; c++) {
				assert_true(largest_difference(p.out[c], was[c]) <= 2e-5);
				map(p.in.primal[c], 1, -5);
			}
		}
		for (int c = 0; c < 3; c++)
			free(was[c].v);
	}
	paired_free(&p);
}

static void test_sum_of_two_problems(void **state)
{
	struct paired p = paired_new(33, 27, 0, 0.3, 6), q = paired_new(33, 27, 0, 0.7, 6);
	struct gd_plane sum[3];

	(void)state;
	paired_solve(&p, GD_L2, 0.2, 1e-8);
	paired_solve(&q, GD_L2, 0.2, 1e-8);
	for (int c = 0; c < 3; c++) {
		sum[c] = copy(p.out[c]);
		for (int y = 0; y < p.h; y++)
			for (int x = 0; x < p.w; x++) {
				gd_row(sum[c], y)[x] += gd_row(q.out[c], y)[x];
				gd_row(p.in.primal[c], y)[x] += gd_row(q.in.primal[c], y)[x];
				for (int k = 0; k < GD_PAIRS; k++)
					gd_row(p.in.value[k][c], y)[x] +=
						gd_row(q.in.value[k][c], y)[x];
			}
	}
	paired_solve(&p, GD_L2, 0.2, 1e-8);
	for (int c = 0; c < 3; c++) {
		assert_true(largest_difference(p.out[c], sum[c]) < 1e-5);
		free(sum[c].v);
	}
	paired_free(&p);
	paired_free(&q);
}

static void test_l1_resists_an_outlier(void **state)
{
	struct paired p = paired_new(40, 30, 0, 0.01, 7);
	double off[2] = { 0 };

	(void)state;
	gd_row(p.in.value[0][1], 15)[20] += 10;
	for (int m = GD_L2; m <= GD_L1; m++) {
		paired_solve(&p, (enum gd_poisson_method)m, 0.2, 1e-6);
		off[m - GD_L2] = largest_difference(p.out[1], p.truth[1]);
	}
	assert_true(off[0] > 1);
	assert_true(off[1] < 0.1);
	paired_free(&p);
}

static void test_wild_values(void **state)
{
	struct paired p = paired_new(40, 30, 0, 0.05, 8);

	(void)state;
	gd_row(p.in.primal[0], 3)[4] = 1e30f;
	gd_row(p.in.primal[1], 9)[9] = NAN;
	gd_row(p.in.primal[2], 0)[0] = -INFINITY;
	gd_row(p.in.value[0][0], 20)[20] = FLT_MAX;
	gd_row(p.in.value[0][1], 21)[20] = -FLT_MAX;
	gd_row(p.in.value[0][2], 22)[20] = NAN;
	for (int m = GD_L2; m <= GD_L1; m++) {
		paired_solve(&p, (enum gd_poisson_method)m, m == GD_L2 ? 0.2 : 1000, 1e-4);
		for (int c = 0; c < 3; c++)
			assert_true(all_finite(p.out[c]));
		paired_solve(&p, (enum gd_poisson_method)m, 0.2, 1e-4);
		for (int c = 0; c < 3; c++)
			assert_true(all_finite(p.out[c]));
	}
	/* by l1, none of it spreads; the pixel without a number takes its neighbours' */
	for (int y = 0; y < 30; y++)
		for (int x = 0; x < 40; x++)
			if (abs(x - 9) <= 1 && abs(y - 9) <= 1)
				assert_true(fabs((double)gd_row(p.out[1], y)[x] -
						 (double)gd_row(p.truth[1], y)[x]) < 0.3);
	paired_free(&p);
}

static void test_nothing_but_zeros(void **state)
{
	struct paired p = paired_new(20, 10, 0, 0, 9);

	(void)state;
	for (int c = 0; c < 3; c++) {
		map(p.in.primal[c], 0, 0);
		for (int k = 0; k < GD_PAIRS; k++)
			map(p.in.value[k][c], 0, 0);
	}
	for (int m = GD_L2; m <= GD_L1; m++) {
		assert_true(paired_solve(&p, (enum gd_poisson_method)m, 0.2, 1e-4).converged);
		for (int c = 0; c < 3; c++)
			assert_true(mean_of(p.out[c]) == 0);
	}
	paired_free(&p);
}

static void test_threads(void **state)
{
	const int threads = omp_get_max_threads();
	struct paired p = paired_new(45, 31, 0, 0.3, 10);
	struct gd_plane was[3];

	(void)state;
	for (int m = GD_L2; m <= GD_L1; m++) {
		omp_set_num_threads(1);
		paired_solve(&p, (enum gd_poisson_method)m, 0.2, 1e-4);
		for (int c = 0; c < 3; c++)
			was[c] = copy(p.out[c]);
		omp_set_num_threads(5);
		paired_solve(&p, (enum gd_poisson_method)m, 0.2, 1e-4);
		for (int c = 0; c < 3; c++) {
			assert_true(largest_difference(p.out[c], was[c]) == 0);
			free(was[c].v);
		}
	}
	omp_set_num_threads(threads);
	paired_free(&p);
}

static void test_one_channel_is_one_of_three(void **state)
{
	struct paired p = paired_new(30, 20, 0, 0.3, 11);
	struct gd_plane was;

	(void)state;
	paired_solve(&p, GD_L2, 0.2, 1e-9);
	was = copy(p.out[0]);
	p.in.n = 1;
	paired_solve(&p, GD_L2, 0.2, 1e-9);
	assert_true(largest_difference(p.out[0], was) < 1e-6);
	free(was.v);
	paired_free(&p);
}

static void test_arguments(void **state)
{
	struct paired p = paired_new(8, 6, 1, 0, 12);
	struct gd_poisson_conf conf = GD_POISSON_DEFAULTS;
	struct gd_pairsolve_in none;
	struct gd_err err = { 0 };

	(void)state;
	p.in.pairs = &p.pairs;
	conf.method = GD_OLS;
	assert_int_equal(gd_pairsolve(p.out, &p.in, &conf, NULL, NULL, &err), GD_EARG);
	assert_string_equal(err.text, "pairs: a setting is out of its range");
	conf.method = GD_L2;
	p.pairs.dx[0][7] = 1;
	err = (struct gd_err){ 0 };
	assert_int_equal(gd_pairsolve(p.out, &p.in, &conf, NULL, NULL, &err), GD_EARG);
	assert_string_equal(err.text, "pairs: out of the image, or more than 4 at pixel 7,0");
	p.pairs.dx[0][7] = 0;
	for (int i = 1; i < 6; i++) {
		p.pairs.dx[0][i] = (signed char)(3 - i < -2 ? -2 : 3 - i);
		p.pairs.dy[0][i] = 2;
	}
	err = (struct gd_err){ 0 };
	assert_int_equal(gd_pairsolve(p.out, &p.in, &conf, NULL, NULL, &err), GD_EARG);
	assert_string_equal(err.text, "pairs: out of the image, or more than 4 at pixel 5,0");
	none = p.in;
	none.primal[1].v = NULL;
	err = (struct gd_err){ 0 };
	assert_int_equal(gd_pairsolve(p.out, &none, &conf, NULL, NULL, &err), GD_EARG);
	assert_string_equal(err.text, "pairs: no primal image");
	paired_free(&p);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_exact_gradients_give_the_truth),
		cmocka_unit_test(test_gradients_outweigh_the_colour),
		cmocka_unit_test(test_pixels_in_no_pair_keep_their_colour),
		cmocka_unit_test(test_linear_and_shifted),
		cmocka_unit_test(test_sum_of_two_problems),
		cmocka_unit_test(test_l1_resists_an_outlier),
		cmocka_unit_test(test_wild_values),
		cmocka_unit_test(test_nothing_but_zeros),
		cmocka_unit_test(test_threads),
		cmocka_unit_test(test_one_channel_is_one_of_three),
		cmocka_unit_test(test_arguments),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
