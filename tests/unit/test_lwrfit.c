/* SPDX-License-Identifier: BSD-3-Clause */
/* Cross-fitted linear predictions against images whose truth is known. */
#include "../support/halves_case.h"

#include <omp.h>

#include "halves.h"
#include "lwrfit.h"

#define W 70
#define H 54

static int run_with(struct job *j, const struct gd_lwr_conf *conf,
		    struct gd_lwrfit_result *result, struct gd_err *err)
{
	const struct gd_crossfit_out out = { j->est, j->mse, j->spread };
	const struct gd_lwrfit_model model = { j->model[0], j->model[1], j->model[2] };

	return gd_lwrfit_run(&out, &model, &j->in, conf, result, NULL, err);
}

static struct gd_lwrfit_result run(struct job *j)
{
	struct gd_lwrfit_result result;
	struct gd_lwr_conf conf = GD_LWR_DEFAULTS;
	struct gd_err err = { 0 };

	if (run_with(j, &conf, &result, &err) != GD_OK)
		fail_msg("%s", err.text);
	return result;
}

/* With the pilot, or with a feature of either half. */
static struct job *make_one(double sigma, double bend, bool by_feature)
{
	struct job *j = make(W, H, 3, sigma, bend);

	if (by_feature)
		add_feature(j, 0.3 * sigma);
	return j;
}

static void test_linear_image_is_reproduced(void **state)
{
	(void)state;
	for (int i = 0; i < 2; i++) {
		struct job *j = make_one(0, 0, i);

		run(j);
		for (int c = 0; c < 3; c++) {
			below(most_off(j->est[c], j->truth[c]), 2e-3);
			below(rms_off(j->est[c], j->truth[c]), 1e-3);
		}
		done(j);
	}
}

static void test_constant_image(void **state)
{
	(void)state;
	for (int i = 0; i < 2; i++) {
		struct job *j = make_one(0, 0, i);

		fill(j, 0.25f, 0.25f, 0);
		for (int c = 0; c < 3; c++)
			memcpy(j->truth[c].v, j->in.y[0][c].v,
			       j->truth[c].stride * H * sizeof(float));
		run(j);
		for (int c = 0; c < 3; c++) {
			below(most_off(j->est[c], j->truth[c]), 1e-5);
			below(mean(j->mse[c]), 1e-9);
		}
		done(j);
	}
}

/* Where the model is right only noise counts: four times the variance, four times the error. */
static void test_error_falls_with_noise(void **state)
{
	(void)state;
	for (int i = 0; i < 2; i++) {
		double e[2], sigma[2] = { 0.2, 0.4 }, own;

		for (int k = 0; k < 2; k++) {
			struct job *j = make_one(sigma[k], 0, i);

			run(j);
			e[k] = square_error_of(j, 0, W, &own);
			below(e[k], sigma[k] * sigma[k] / 2 / 40); /* of the mean of both halves */
			below(own, 4 * e[k]);
			below(e[k], own);
			for (int c = 0; c < 3; c++)
				below(fabs(mean(j->est[c]) / mean(j->truth[c]) - 1), sigma[k] / 60);
			done(j);
		}
		below(e[1] / e[0], 5);
		below(3, e[1] / e[0]);
	}
}

/* A feature that shows what G-buffers miss beats the pilot. No firefly: the mean is kept. */
static void test_what_features_miss(void **state)
{
	double e[2];

	(void)state;
	for (int i = 0; i < 2; i++) {
		struct job *j = make_one(0.2, 1, i);
		double sum = 0, all = 0, own, gain = run(j).gain;

		for (int c = 0; c < 3; c++) {
			sum += (mean(j->in.y[0][c]) + mean(j->in.y[1][c])) / 2;
			all += mean(j->est[c]);
		}
		e[i] = square_error_of(j, 0, W, &own);
		below(e[i], 0.02 / 10);
		below(own, 4 * e[i]);
		below(e[i], 2 * own);
		below(fabs(all / sum - 1), 1e-5);
		below(fabs(gain - 1), 0.01);
		below(0, mean(j->spread));
		done(j);
	}
	below(e[1], 0.7 * e[0]);
}

/* Four bands, each of four times the variance of the one before it. */
static void test_error_of_regions(void **state)
{
	(void)state;
	for (int i = 0; i < 2; i++) {
		struct job *j = make_one(0.1, 0, i);
		double last = 0;

		drop_var(j);
		for (int k = 1; k < 4; k++)
			for (int half = 0; half < 2; half++)
				more_noise(j, half, k * 18, k == 3 ? W : k * 18 + 18, 1 << k);
		run(j);
		for (int k = 0; k < 4; k++) {
			double own, e = square_error_of(j, k * 18, k == 3 ? W : k * 18 + 18, &own);

			below(own, 5 * e);
			below(e, 2 * own);
			below(2 * last, own);
			last = own;
		}
		done(j);
	}
}

static void test_halves_swapped(void **state)
{
	(void)state;
	for (int i = 0; i < 2; i++) {
		struct job *a = make_one(0.3, 0.5, i), *b = make_one(0.3, 0.5, i);

		for (int c = 0; c < 3; c++) {
			swap(&b->in.y[0][c], &b->in.y[1][c]);
			swap(&b->in.feature[0][c], &b->in.feature[1][c]);
		}
		run(a);
		run(b);
		for (int c = 0; c < 3; c++) {
			below(most_off(a->est[c], b->est[c]), 1e-5);
			below(most_off(a->mse[c], b->mse[c]), 1e-6);
			below(most_off(a->model[c], b->model[c]), 1e-6);
		}
		below(most_off(a->spread, b->spread), 1e-6);
		done(a);
		done(b);
	}
}

/*
 * Sums in another order decide here and there for another radius, where two are as good: some
 * percent of the pixels then differ by a fraction of the noise that is left (0.03).
 */
static void test_turned(void **state)
{
	(void)state;
	for (int how = 1; how <= 3; how++)
		for (int i = 0; i < 2; i++) {
			struct job *a = make_one(0.3, 0.5, i), *b = make_one(0.3, 0.5, i);

			turn_all(b, how);
			run(a);
			run(b);
			turn_all(b, how);
			for (int c = 0; c < 3; c++) {
				below(rms_off(a->est[c], b->est[c]), 1e-3);
				below(rms_off(a->mse[c], b->mse[c]), 1e-4);
				below(rms_off(a->model[c], b->model[c]), 0.05);
			}
			done(a);
			done(b);
		}
}

/* Of the channels of a feature the first comes first, where a window is too small for all. */
static void test_channels_permuted(void **state)
{
	struct job *a = make_one(0.3, 0.5, true), *b = make_one(0.3, 0.5, true);

	(void)state;
	for (int half = 0; half < 2; half++) {
		swap(&b->in.y[half][0], &b->in.y[half][2]);
		swap(&b->in.feature[half][0], &b->in.feature[half][2]);
	}
	run(a);
	run(b);
	for (int c = 0; c < 3; c++)
		below(rms_off(a->est[c], b->est[2 - c]), 2e-3);
	done(a);
	done(b);
}

static void test_scaled(void **state)
{
	static const float scales[] = { 1e-12f, 1e-3f, 1024, 1e12f };

	(void)state;
	for (int i = 0; i < 2; i++) {
		struct job *a = make_one(0.3, 0.5, i);

		run(a);
		for (int k = i; k < 4; k += 2) {
			struct job *b = make_one(0.3, 0.5, i);
			float s = scales[k];

			for (int c = 0; c < 3; c++) {
				for (int half = 0; half < 2; half++) {
					times(b->in.y[half][c], s);
					if (i)
						times(b->in.feature[half][c], s);
				}
				times(b->in.var[c], s * s);
			}
			run(b);
			for (int c = 0; c < 3; c++) {
				times(b->est[c], 1 / s);
				below(most_off(a->est[c], b->est[c]), 2e-4);
				below(fabs(mean(b->mse[c]) / ((double)s * (double)s) /
					   mean(a->mse[c]) - 1), 1e-3);
			}
			times(b->spread, 1 / s);
			below(most_off(a->spread, b->spread), 2e-4);
			done(b);
		}
		done(a);
	}
}

static void test_threads(void **state)
{
	int was = omp_get_max_threads();

	(void)state;
	for (int i = 0; i < 2; i++) {
		struct job *a = make_one(0.3, 0.5, i);

		omp_set_num_threads(1);
		run(a);
		for (int n = 2; n <= 7; n += 5) {
			struct job *b = make_one(0.3, 0.5, i);

			omp_set_num_threads(n);
			run(b);
			for (int c = 0; c < 3; c++) {
				assert_true(most_off(a->est[c], b->est[c]) == 0);
				assert_true(most_off(a->mse[c], b->mse[c]) == 0);
				assert_true(most_off(a->model[c], b->model[c]) == 0);
			}
			assert_true(most_off(a->spread, b->spread) == 0);
			done(b);
		}
		done(a);
	}
	omp_set_num_threads(was);
}

/* The windows are those of the colour alone, with layers or without. */
static void test_layers_add_up(void **state)
{
	struct job *alone = make(W, H, 3, 0.3, 0.5);

	(void)state;
	run(alone);
	for (int whole = 0; whole < 2; whole++) {
		struct job *j = make(W, H, PLANES, 0.3, 0.5);

		split_layers(j);
		if (whole)
			make_whole(j);
		run(j);
		assert_sane(j);
		below(most_missing(j), 1e-5);
		below(square_error(j), 2 * square_error(alone));
		for (int c = 0; c < 3; c++)
			assert_true(most_off(alone->model[c], j->model[c]) == 0);
		if (!whole)
			for (int c = 0; c < 3; c++)
				below(most_off(alone->est[c], j->est[c]), 1e-5);
		done(j);
	}
	done(alone);
}

/* A half of more samples counts more. */
static void test_shares(void **state)
{
	struct job *even = make(W, H, 3, 0.3, 0), *odd = make(W, H, 3, 0.3, 0);
	double own, e;

	(void)state;
	more_noise(even, 1, 0, W, 2);
	more_noise(odd, 1, 0, W, 2);
	odd->in.share[0] = 0.8;
	odd->in.share[1] = 0.2;
	drop_var(even);
	drop_var(odd);
	run(even);
	run(odd);
	below(square_error(odd), 0.85 * square_error(even)); /* 0.072 against 0.1125 of the noise */
	e = square_error_of(odd, 0, W, &own);
	below(e, 2 * own);
	below(own, 5 * e);
	done(even);
	done(odd);
}

static void test_counts(void **state)
{
	(void)state;
	for (int i = 0; i < 2; i++) {
		struct job *j = make_one(0.2, 0.5, i);
		double e, own;

		count_samples(j);
		run(j);
		e = square_error_of(j, 0, W, &own);
		below(e, i ? 0.0008 : 0.004);
		below(e, 5 * own);
		below(own, 4 * e);
		done(j);
	}
}

/* The same number everywhere is as if nothing was said of it. */
static void test_even_counts(void **state)
{
	struct job *a = make_one(0.3, 0.5, false), *b = make_one(0.3, 0.5, false);

	(void)state;
	for (int half = 0; half < 2; half++) {
		b->in.count[half] = plane(W, H);
		for (int y = 0; y < H; y++)
			for (int x = 0; x < W; x++)
				gd_row(b->in.count[half], y)[x] = 4;
	}
	run(a);
	run(b);
	for (int c = 0; c < 3; c++)
		below(most_off(a->est[c], b->est[c]), 1e-4);
	done(a);
	done(b);
}

static void test_no_halves(void **state)
{
	(void)state;
	for (int i = 0; i < 2; i++) {
		struct job *j = make_one(0.2, 0.5, i);
		double e, own;
		struct gd_lwrfit_result result;

		j->in.self = true;
		for (int c = 0; c < 3; c++)
			times(j->in.var[c], 2);	/* of the samples that are used */
		result = run(j);
		e = square_error_of(j, 0, W, &own);
		below(e, 0.04 / 6);
		below(e, 5 * own);
		below(own, 5 * e);
		below(fabs(mean(j->model[2]) * W * H - (double)result.models), 0.01);
		assert_sane(j);
		done(j);
	}
}

/* ---- what is told of the models ---- */

/* Of wide grids, where the halves place their centres apart, and of narrow ones. */
static void test_model(void **state)
{
	(void)state;
	for (int i = 0; i < 4; i++) {
		struct job *j = make_one(0.05, 0.5, i % 2);
		struct gd_lwr_conf conf = GD_LWR_DEFAULTS;
		struct gd_lwrfit_result result;
		int least = i < 2 ? 3 : 1;	/* 9 columns, 5 pixels for each: 7x7 */

		if (i >= 2)
			conf.granularity = conf.per_column = 0;
		assert_int_equal(run_with(j, &conf, &result, NULL), GD_OK);
		assert_in_range(result.models, 2, W * H);	/* sparse */
		below(fabs(2 * mean(j->model[2]) * W * H - (double)result.models), 0.01);
		below(least, result.mean_radius);
		below(result.mean_radius, 9);
		for (int y = 0; y < H; y++)
			for (int x = 0; x < W; x++) {
				double radius = (double)gd_row(j->model[0], y)[x];
				double used = (double)gd_row(j->model[1], y)[x];
				double centre = (double)gd_row(j->model[2], y)[x];

				assert_true(radius >= least && radius <= 9);
				assert_true(used >= 0 && used <= 3 + FEATURES + 3);
				assert_true(centre == 0 || centre == 0.5 || centre == 1);
			}
		done(j);
	}
}

/* The radii of a half, by the engine alone: what one half is, is judged by the other. */
static void radius_of_half(struct gd_plane radius, struct job *j, int half)
{
	struct gd_lwr_conf conf = GD_LWR_DEFAULTS;
	struct gd_plane feat[FEATURES + 3], est[3], weight = plane(W, H);
	const struct gd_lwr_in in = { .ny = 3, .nfeat = FEATURES + 3, .y = j->in.y[half],
				      .twin = j->in.y[1 - half], .feat = feat, .weight = weight };

	memcpy(feat, j->in.feat, FEATURES * sizeof *feat);
	memcpy(feat + FEATURES, j->in.feature[1 - half], 3 * sizeof *feat);
	for (int c = 0; c < 3; c++)
		est[c] = plane(W, H);
	assert_int_equal(gd_halves_weight(weight, feat + FEATURES, NULL), GD_OK);
	assert_int_equal(gd_lwr_fit(&(struct gd_lwr_out){ .est = est, .radius = radius }, &in,
				    &conf, NULL, NULL, NULL), GD_OK);
	for (int c = 0; c < 3; c++)
		free(est[c].v);
	free(weight.v);
}

static void test_windows_are_judged_by_the_other_half(void **state)
{
	struct job *j = make_one(0.05, 0.5, true);
	struct gd_plane radius[2] = { plane(W, H), plane(W, H) };

	(void)state;
	run(j);	/* features are as it left them */
	for (int half = 0; half < 2; half++)
		radius_of_half(radius[half], j, half);
	below(0.1, most_off(radius[0], radius[1]));
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++)
			below(fabs((double)gd_row(j->model[0], y)[x] -
				   ((double)gd_row(radius[0], y)[x] +
				    (double)gd_row(radius[1], y)[x]) / 2), 1e-5);
	free(radius[0].v);
	free(radius[1].v);
	done(j);
}

/* The planes of the model and the spread may be left out. */
static void test_nothing_told(void **state)
{
	struct job *a = make(W, H, 3, 0.3, 0.5), *b = make(W, H, 3, 0.3, 0.5);

	(void)state;
	for (int c = 0; c < 3; c++)
		drop(&b->model[c]);
	drop(&b->spread);
	run(a);
	run(b);
	for (int c = 0; c < 3; c++) {
		assert_true(most_off(a->est[c], b->est[c]) == 0);
		assert_true(most_off(a->mse[c], b->mse[c]) == 0);
	}
	done(a);
	done(b);
}

/* A feature of less than a colour is left aside. */
static void test_narrow_feature(void **state)
{
	struct job *a = make_one(0.3, 0.5, false), *b = make_one(0.3, 0.5, true);

	(void)state;
	b->in.nfeature = 2;
	run(a);
	run(b);
	for (int c = 0; c < 3; c++)
		assert_true(most_off(a->est[c], b->est[c]) == 0);
	done(a);
	done(b);
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
			run(j);
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
	for (size_t i = 0; i < sizeof value / sizeof *value; i++)
		for (int how = 0; how < 3; how++) {
			struct job *j = make(20, 17, 3, 0, 0);

			fill(j, value[i][0], value[i][1], value[i][2]);
			if (how == 1)
				add_feature(j, 0.1);
			j->in.self = how == 2;
			run(j);
			assert_sane(j);
			for (int c = 0; c < 3 && value[i][0] == 0; c++)
				assert_true(mean(j->est[c]) == 0 && mean(j->mse[c]) == 0);
			done(j);
		}
}

/* Noise so large that its squares, and the products of colour and twin, are no floats. */
static void test_large_noise(void **state)
{
	static const float scales[] = { 1e17f, 1e20f, 1e34f, 5e37f };

	(void)state;
	for (int i = 0; i < 4; i++) {
		struct job *j = make_one(0.3, 0.5, i % 2);

		for (int c = 0; c < 3; c++)
			for (int half = 0; half < 2; half++) {
				times(j->in.y[half][c], scales[i]);
				if (j->in.nfeature)
					times(j->in.feature[half][c], scales[i]);
			}
		drop_var(j);
		run(j);
		assert_sane(j);
		for (int c = 0; c < 3 && i < 3; c++)
			below(fabs(mean(j->est[c]) / (double)scales[i] / mean(j->truth[c]) - 1),
			      0.02);
		done(j);
	}
}

static void test_sizes(void **state)
{
	static const int size[][2] = {{1, 1}, {1, 40}, {40, 1}, {2, 2}, {3, 7}, {129, 5}};

	(void)state;
	for (size_t i = 0; i < sizeof size / sizeof *size; i++)
		for (int how = 0; how < 3; how++) {
			struct job *j = make(size[i][0], size[i][1], 3, 0.1, 0);

			if (how == 1)
				add_feature(j, 0.03);
			j->in.self = how == 2;
			run(j);
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
		run(j);
		assert_sane(j);
		below(square_error(j), 0.02 / 8);
		done(j);
	}
}

static void test_no_features(void **state)
{
	(void)state;
	for (int i = 0; i < 2; i++) {
		struct job *j = make_one(0.2, 0, i);

		j->in.nfeat = 0;
		run(j);
		assert_sane(j);
		below(square_error(j), i ? 0.02 / 8 : 0.02);
		done(j);
	}
}

static void refuse(struct job *j, int rc, const char *text)
{
	struct gd_lwr_conf conf = GD_LWR_DEFAULTS;
	struct gd_lwrfit_result result;
	struct gd_err err = { 0 };

	assert_int_equal(run_with(j, &conf, &result, &err), rc);
	if (!strstr(err.text, text))
		fail_msg("\"%s\", expected \"%s\"", err.text, text);
}

static void test_refused(void **state)
{
	struct job *j = make(8, 8, 3, 0.1, 0);
	struct gd_lwr_conf conf = { .radius = 99 };
	struct gd_lwrfit_result result;

	(void)state;
	assert_int_equal(run_with(j, &conf, &result, NULL), GD_EARG);
	j->in.nfeat = GD_CROSSFIT_FEATURES + 1;
	refuse(j, GD_EARG, "26 feature planes");
	j->in.nfeat = 0;
	j->in.nfeature = 5;
	refuse(j, GD_EARG, "5 of either half");
	j->in.nfeature = 0;
	j->in.ny = 2;
	refuse(j, GD_EARG, "2 planes");
	j->in.ny = GD_LWR_RHS + 1;
	refuse(j, GD_EARG, "65 planes");
	j->in.ny = 3;
	j->in.nwhole = GD_LWR_RHS - 2;	/* the colour of a half comes on top */
	refuse(j, GD_EARG, "62 planes of all samples, at most 61");
	j->in.nwhole = 0;
	j->in.share[0] = 0.9;
	refuse(j, GD_EARG, "shares");
	j->in.share[0] = 0;
	j->in.self = true;
	drop(&j->in.var[0]);
	refuse(j, GD_EARG, "variance");
	done(j);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_linear_image_is_reproduced),
		cmocka_unit_test(test_constant_image),
		cmocka_unit_test(test_error_falls_with_noise),
		cmocka_unit_test(test_what_features_miss),
		cmocka_unit_test(test_error_of_regions),
		cmocka_unit_test(test_halves_swapped),
		cmocka_unit_test(test_turned),
		cmocka_unit_test(test_channels_permuted),
		cmocka_unit_test(test_scaled),
		cmocka_unit_test(test_threads),
		cmocka_unit_test(test_layers_add_up),
		cmocka_unit_test(test_shares),
		cmocka_unit_test(test_counts),
		cmocka_unit_test(test_even_counts),
		cmocka_unit_test(test_no_halves),
		cmocka_unit_test(test_model),
		cmocka_unit_test(test_windows_are_judged_by_the_other_half),
		cmocka_unit_test(test_nothing_told),
		cmocka_unit_test(test_narrow_feature),
		cmocka_unit_test(test_fireflies),
		cmocka_unit_test(test_extremes),
		cmocka_unit_test(test_large_noise),
		cmocka_unit_test(test_sizes),
		cmocka_unit_test(test_odd_features),
		cmocka_unit_test(test_no_features),
		cmocka_unit_test(test_refused),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
