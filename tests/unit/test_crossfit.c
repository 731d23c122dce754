/* SPDX-License-Identifier: BSD-3-Clause */
/* Cross-fitted regression against images whose truth is known. */
#include "../support/halves_case.h"

#include <omp.h>

#define W 70
#define H 54

static struct gd_crossfit_result run(struct job *j, bool fast)
{
	struct gd_crossfit_conf conf = { fast };
	struct gd_crossfit_out out = { j->est, j->mse, j->spread };
	struct gd_crossfit_result result;
	struct gd_err err = { 0 };

	assert_int_equal(gd_crossfit_run(&out, &j->in, &conf, &result, NULL, &err), GD_OK);
	return result;
}

static void test_linear_image_is_reproduced(void **state)
{
	struct job *j = make(W, H, 3, 0, 0);

	(void)state;
	assert_int_equal(run(j, false).models, 4);
	for (int c = 0; c < 3; c++)
		below(most_off(j->est[c], j->truth[c]), 2e-3);
	done(j);
	j = make(W, H, 3, 0, 0);
	assert_int_equal(run(j, true).models, 1);
	for (int c = 0; c < 3; c++)
		below(most_off(j->est[c], j->truth[c]), 2e-3);
	assert_true(mean(j->spread) == 0);	/* of one model */
	done(j);
}

static void test_constant_image(void **state)
{
	struct job *j = make(W, H, 3, 0, 0);

	(void)state;
	fill(j, 0.25f, 0.25f, 0);
	for (int c = 0; c < 3; c++)
		memcpy(j->truth[c].v, j->in.y[0][c].v, j->truth[c].stride * H * sizeof(float));
	run(j, false);
	for (int c = 0; c < 3; c++) {
		below(most_off(j->est[c], j->truth[c]), 1e-5);
		below(mean(j->mse[c]), 1e-9);
	}
	done(j);
}

/* Where the model is right only noise counts: four times the variance, four times the error. */
static void test_error_falls_with_noise(void **state)
{
	double e[2], sigma[2] = { 0.2, 0.4 }, own[2];

	(void)state;
	for (int i = 0; i < 2; i++) {
		struct job *j = make(W, H, 3, sigma[i], 0);

		run(j, false);
		e[i] = square_error(j);
		own[i] = (mean(j->mse[0]) + mean(j->mse[1]) + mean(j->mse[2])) / 3;
		below(e[i], sigma[i] * sigma[i] / 2 / 15);	/* of the mean of both halves */
		below(own[i],
		      4 * e[i]); /* models that err alike are not told from ones that do not */
		below(e[i], 2 * own[i]);
		for (int c = 0; c < 3; c++)
			below(fabs(mean(j->est[c]) / mean(j->truth[c]) - 1), 0.005 + sigma[i] / 50);
		done(j);
	}
	below(e[1] / e[0], 5);
	below(3, e[1] / e[0]);
}

static void test_what_features_miss(void **state)
{
	struct job *j = make(W, H, 3, 0.2, 1);
	double sum = 0, all = 0;

	(void)state;
	for (int c = 0; c < 3; c++)
		sum += (mean(j->in.y[0][c]) + mean(j->in.y[1][c])) / 2;
	run(j, false);
	for (int c = 0; c < 3; c++)
		all += mean(j->est[c]);
	below(square_error(j), 0.02 / 4);
	below(fabs(all / sum - 1), 1e-5);	/* no firefly, so the mean is kept to rounding */
	below(0, mean(j->spread));
	done(j);
}

/* A feature that shows it, too. */
static void test_feature_of_the_other_half(void **state)
{
	struct job *a = make(W, H, 3, 0.2, 1), *b = make(W, H, 3, 0.2, 1);
	double own, e;

	(void)state;
	add_feature(b, 0.06);
	run(a, false);
	run(b, false);
	e = square_error_of(b, 0, W, &own);
	below(e, 0.7 * square_error(a));
	below(own, 4 * e);
	below(e, 2 * own);
	done(a);
	done(b);
}

static void test_halves_swapped(void **state)
{
	struct job *a = make(W, H, 3, 0.3, 0.5), *b = make(W, H, 3, 0.3, 0.5);

	(void)state;
	for (int c = 0; c < 3; c++)
		swap(&b->in.y[0][c], &b->in.y[1][c]);
	run(a, false);
	run(b, false);
	for (int c = 0; c < 3; c++) {
		below(most_off(a->est[c], b->est[c]), 2e-6 * 4);
		below(most_off(a->mse[c], b->mse[c]), 1e-6);
	}
	done(a);
	done(b);
}

static void test_turned(void **state)
{
	struct job *a = make(W, H, 3, 0.3, 0.5);

	(void)state;
	run(a, false);
	for (int how = 1; how <= 3; how++) {
		struct job *b = make(W, H, 3, 0.3, 0.5);

		turn_all(b, how);
		run(b, false);
		turn_all(b, how);
		for (int c = 0; c < 3; c++)
			below(most_off(a->est[c], b->est[c]), 1e-4);
		done(b);
	}
	done(a);
}

static void test_channels_permuted(void **state)
{
	struct job *a = make(W, H, 3, 0.3, 0.5), *b = make(W, H, 3, 0.3, 0.5);

	(void)state;
	for (int half = 0; half < 2; half++)
		swap(&b->in.y[half][0], &b->in.y[half][2]);
	run(a, false);
	run(b, false);
	for (int c = 0; c < 3; c++)
		below(most_off(a->est[c], b->est[2 - c]), 1e-4);
	done(a);
	done(b);
}

static void test_scaled(void **state)
{
	static const float scales[] = { 1e-12f, 1e-3f, 1024, 1e12f };
	struct job *a = make(W, H, 3, 0.3, 0.5);

	(void)state;
	run(a, false);
	for (int i = 0; i < 4; i++) {
		struct job *b = make(W, H, 3, 0.3, 0.5);
		float s = scales[i];

		for (int c = 0; c < 3; c++) {
			times(b->in.y[0][c], s);
			times(b->in.y[1][c], s);
			times(b->in.var[c], s * s);
		}
		run(b, false);
		for (int c = 0; c < 3; c++) {
			times(b->est[c], 1 / s);
			below(most_off(a->est[c], b->est[c]), 2e-4);
			below(fabs(mean(b->mse[c]) / ((double)s * (double)s) / mean(a->mse[c]) - 1),
			      1e-3);
		}
		done(b);
	}
	done(a);
}

static void test_threads(void **state)
{
	struct job *a = make(W, H, 3, 0.3, 0.5);
	int was = omp_get_max_threads();

	(void)state;
	omp_set_num_threads(1);
	run(a, false);
	for (int n = 2; n <= 7; n += 5) {
		struct job *b = make(W, H, 3, 0.3, 0.5);

		omp_set_num_threads(n);
		run(b, false);
		for (int c = 0; c < 3; c++) {
			assert_true(most_off(a->est[c], b->est[c]) == 0);
			assert_true(most_off(a->mse[c], b->mse[c]) == 0);
		}
		done(b);
	}
	omp_set_num_threads(was);
	done(a);
}

/* Planes 3..5 and 6..8 add up to the colour before and after. */
static void test_layers_add_up(void **state)
{
	(void)state;
	for (int whole = 0; whole < 2; whole++) {
		struct job *j = make(W, H, PLANES, 0.3, 0.5);

		split_layers(j);
		if (whole)
			make_whole(j);
		run(j, false);
		below(most_missing(j), 2e-5);
		done(j);
	}
}

/* A half of twice the samples counts twice. */
static void test_shares(void **state)
{
	struct job *even = make(W, H, 3, 0.3, 0), *odd = make(W, H, 3, 0.3, 0);
	struct gd_crossfit_conf conf = { false };
	struct gd_crossfit_result result;

	(void)state;
	more_noise(even, 1, 0, W, 2);
	more_noise(odd, 1, 0, W, 2);
	odd->in.share[0] = 0.8;
	odd->in.share[1] = 0.2;
	drop_var(even);
	drop_var(odd);
	run(even, false);
	run(odd, false);
	below(square_error(odd), 0.85 * square_error(even)); /* 0.072 against 0.1125 of the noise */
	below(mean(odd->mse[0]), 4 * square_error(odd));
	below(square_error(odd), 2 * mean(odd->mse[0]));
	odd->in.share[0] = 0.9;
	assert_int_equal(gd_crossfit_run(&(struct gd_crossfit_out){odd->est, odd->mse, odd->spread},
					 &odd->in, &conf, &result, NULL, NULL),
			 GD_EARG);
	done(even);
	done(odd);
}

static void test_counts(void **state)
{
	(void)state;
	for (int i = 0; i < 2; i++) {
		struct job *j = make(W, H, 3, 0.2, 0.5);
		double own, e;

		if (i)
			add_feature(j, 0.06);
		count_samples(j);
		run(j, false);
		e = square_error_of(j, 0, W, &own);
		below(e, i ? 0.0008 : 0.004);
		below(e, 5 * own);
		below(own, 4 * e);
		done(j);
	}
}

static void test_no_halves(void **state)
{
	struct job *j = make(W, H, 3, 0.2, 0.5);

	(void)state;
	j->in.self = true;
	for (int c = 0; c < 3; c++)
		times(j->in.var[c], 2);	/* of the samples that are used */
	run(j, false);
	below(square_error(j), 0.04 / 4);
	below(mean(j->mse[0]), 4 * square_error(j));
	below(square_error(j), 4 * mean(j->mse[0]));
	done(j);
}

/* ---- what renders may hold ---- */

static void test_fireflies(void **state)
{
	static const float bright[] = { 1e4f, 1e19f, 1e30f, FLT_MAX };

	(void)state;
	for (int i = 0; i < 4; i++)
		for (int v = 0; v < 2; v++) {
			struct job *j = make(W, H, 3, 0.3, 0);

			set(j, 0, 33, 20, bright[i]);
			set(j, 1, 8, 40, bright[i]);
			if (v)
				drop_var(j);
			for (int c = 0; c < 3 && !v; c++) {
				double half = (double)bright[i] / 2;

				gd_row(j->in.var[c], 20)[33] = (float)fmin(half * half, FLT_MAX);
				gd_row(j->in.var[c], 40)[8] = (float)fmin(half * half, FLT_MAX);
			}
			run(j, false);
			assert_sane(j);
			for (int c = 0; c < 3; c++)	/* cut to some thousands, then spread */
				for (int y = 0; y < H; y++)
					for (int x = 0; x < W; x++)
						below(fabs((double)gd_row(j->est[c], y)[x]), 1000);
			done(j);
		}
}

static void test_extremes(void **state)
{
	static const float value[][3] = {
		{0, 0, 0},	 {1e-40f, 3e-41f, 0},	       {-1, -2, 0.25f},	  {-1, 1, 1},
		{1, 1, FLT_MAX}, {FLT_MAX, -FLT_MAX, FLT_MAX}, {1e30f, 1e30f, 0},
	};

	(void)state;
	for (size_t i = 0; i < sizeof value / sizeof *value; i++) {
		struct job *j = make(20, 17, 3, 0, 0);

		fill(j, value[i][0], value[i][1], value[i][2]);
		run(j, false);
		assert_sane(j);
		if (value[i][0] == 0)
			for (int c = 0; c < 3; c++)
				assert_true(mean(j->est[c]) == 0 && mean(j->mse[c]) == 0);
		done(j);
	}
}

static void test_sizes(void **state)
{
	static const int size[][2] = {{1, 1}, {1, 40}, {40, 1}, {2, 2}, {3, 7}, {129, 5}};

	(void)state;
	for (size_t i = 0; i < sizeof size / sizeof *size; i++) {
		struct job *j = make(size[i][0], size[i][1], 3, 0.1, 0);

		run(j, i % 2);
		assert_sane(j);
		for (int c = 0; c < 3; c++)
			below(fabs(mean(j->est[c]) / mean(j->truth[c]) - 1), 0.2);
		done(j);
	}
}

static void test_odd_features(void **state)
{
	(void)state;
	for (int odd = 0; odd < ODD; odd++) {
		struct job *j = make(W, H, 3, 0.2, 0);

		spoil_feature(j, odd);
		run(j, false);
		assert_sane(j);
		below(square_error(j), 0.02 / 8);
		done(j);
	}
}

static void test_no_features(void **state)
{
	struct job *j = make(W, H, 3, 0.2, 0);

	(void)state;
	j->in.nfeat = 0;
	run(j, false);
	assert_sane(j);
	below(square_error(j), 0.02);
	done(j);
}

static void test_refused(void **state)
{
	struct job *j = make(8, 8, 3, 0.1, 0);
	struct gd_crossfit_out out = { j->est, j->mse, j->spread };
	struct gd_crossfit_conf conf = { false };
	struct gd_crossfit_result result;
	struct gd_err err = { 0 };

	(void)state;
	j->in.nfeat = GD_CROSSFIT_FEATURES + 1;
	assert_int_equal(gd_crossfit_run(&out, &j->in, &conf, &result, NULL, &err), GD_EARG);
	assert_non_null(strstr(err.text, "26 feature planes"));
	j->in.nfeat = 0;
	j->in.ny = 2;
	assert_int_equal(gd_crossfit_run(&out, &j->in, &conf, &result, NULL, NULL), GD_EARG);
	j->in.ny = 3;
	j->in.self = true;
	drop(&j->in.var[0]);
	assert_int_equal(gd_crossfit_run(&out, &j->in, &conf, &result, NULL, NULL), GD_EARG);
	done(j);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_linear_image_is_reproduced),
		cmocka_unit_test(test_constant_image),
		cmocka_unit_test(test_error_falls_with_noise),
		cmocka_unit_test(test_what_features_miss),
		cmocka_unit_test(test_feature_of_the_other_half),
		cmocka_unit_test(test_halves_swapped),
		cmocka_unit_test(test_turned),
		cmocka_unit_test(test_channels_permuted),
		cmocka_unit_test(test_scaled),
		cmocka_unit_test(test_threads),
		cmocka_unit_test(test_layers_add_up),
		cmocka_unit_test(test_shares),
		cmocka_unit_test(test_counts),
		cmocka_unit_test(test_no_halves),
		cmocka_unit_test(test_fireflies),
		cmocka_unit_test(test_extremes),
		cmocka_unit_test(test_sizes),
		cmocka_unit_test(test_odd_features),
		cmocka_unit_test(test_no_features),
		cmocka_unit_test(test_refused),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
