/* SPDX-License-Identifier: BSD-3-Clause */
/* Sampling maps against what can be counted, and against the best that whole numbers can do. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <float.h>
#include <math.h>
#include <omp.h>
#include <stdlib.h>
#include <string.h>

#include "sampling.h"

struct frame {
	int w, h;
	struct gd_sampling_in in;
	struct gd_plane map;
};

static struct gd_plane plane(int w, int h)
{
	struct gd_plane p = gd_plane_of(gd_calloc(gd_stride(w) * (size_t)h, sizeof(float)), w, h);

	assert_non_null(p.v);
	return p;
}

static double uniform(uint64_t *state)
{
	uint64_t z = *state += 0x9e3779b97f4a7c15u;

	z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
	z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
	z ^= z >> 31;
	return (double)(z >> 11) * 0x1p-53;
}

/* A grey image of 0.3 to 1.3 with errors from 1e-6 to 1e-2, and 4 to 12 samples. */
static struct frame make(int w, int h, uint64_t seed)
{
	struct frame f = { .w = w, .h = h, .in = { .n = 3 } };

	f.map = plane(w, h);
	f.in.samples = plane(w, h);
	for (int c = 0; c < 3; c++) {
		f.in.colour[c] = plane(w, h);
		f.in.error[c] = plane(w, h);
	}
	for (int y = 0; y < h; y++)
		for (int x = 0; x < w; x++) {
			float v = (float)(0.3 + uniform(&seed));
			float e = (float)pow(10, -6 + 4 * uniform(&seed));

			for (int c = 0; c < 3; c++) {
				gd_row(f.in.colour[c], y)[x] = v;
				gd_row(f.in.error[c], y)[x] = e;
			}
			gd_row(f.in.samples, y)[x] = (float)floor(4 + 9 * uniform(&seed));
		}
	return f;
}

static void drop(struct frame *f)
{
	for (int c = 0; c < 3; c++) {
		free(f->in.colour[c].v);
		free(f->in.error[c].v);
	}
	free(f->in.samples.v);
	free(f->map.v);
}

static float *at(struct gd_plane p, int i)
{
	return &gd_row(p, i / p.w)[i % p.w];
}

static void fill(struct frame *f, struct gd_plane *p, float v)
{
	for (int c = 0; c < 3; c++)
		for (int i = 0; i < f->w * f->h; i++)
			*at(p[c], i) = v;
}

static struct gd_sampling_result run(struct frame *f, const struct gd_sampling_conf *conf)
{
	struct gd_sampling_result r;
	struct gd_err err = { 0 };

	if (gd_sampling_map(f->map, &f->in, conf, &r, &err) != GD_OK)
		fail_msg("%s", err.text);
	return r;
}

static void refused(struct frame *f, const struct gd_sampling_conf *conf, const char *text)
{
	struct gd_err err = { 0 };

	assert_int_equal(gd_sampling_map(f->map, &f->in, conf, NULL, &err), GD_EARG);
	assert_string_equal(err.text, text);
}

/* Whole multiples between the bounds that add up to the total. */
static void check_counts(const struct frame *f, const struct gd_sampling_conf *conf)
{
	double sum = 0;

	for (int i = 0; i < f->w * f->h; i++) {
		double v = (double)*at(f->map, i);

		if (!(v >= conf->min && v <= conf->max && fmod(v, conf->multiple) == 0))
			fail_msg("%dx%d, total %.17g: pixel %d gets %.17g", f->w, f->h,
				 conf->total, i, v);
		sum += v;
	}
	if (sum != conf->total)
		fail_msg("%dx%d: %.17g samples of %.17g", f->w, f->h, sum, conf->total);
}

static void sums_are_exact(void **unused)
{
	static const int size[][2] = { { 1, 1 }, { 1, 97 }, { 131, 1 }, { 64, 64 }, { 65, 63 },
				       { 129, 70 }, { 200, 7 } };
	uint64_t seed = 7;

	(void)unused;
	for (size_t k = 0; k < sizeof size / sizeof *size; k++) {
		struct frame f = make(size[k][0], size[k][1], k + 1);
		double pixels = (double)f.w * f.h;

		for (int i = 0; i < 60; i++) {
			struct gd_sampling_conf conf = GD_SAMPLING_DEFAULTS;
			double low, high;

			conf.paper = i % 3 == 1;
			conf.floor = i % 4 == 3 ? 0 : uniform(&seed);
			conf.blur_px = i % 5 ? 1 : 0;
			conf.dimension = 10 * uniform(&seed);
			conf.trust = 1 - 0.9 * uniform(&seed);
			conf.seed = (uint64_t)i;
			conf.multiple = i % 2 ? 1 : floor(1 + 5 * uniform(&seed));
			if (i % 3) {
				conf.max = floor(1 + 20 * uniform(&seed)) * conf.multiple;
				conf.min = floor(uniform(&seed) * conf.max);
			}
			low = ceil(conf.min / conf.multiple) * pixels;
			high = fmin(floor(conf.max / conf.multiple), 1000) * pixels;
			/* now and then at the very ends */
			conf.total = conf.multiple *
				     floor(low + (i % 10 == 1   ? 0
						  : i % 10 == 2 ? 1
								: uniform(&seed)) *
							 (high - low));
			run(&f, &conf);
			check_counts(&f, &conf);
		}
		drop(&f);
	}
}

static void huge_totals(void **unused)
{
	struct frame f = make(512, 400, 3);
	struct gd_sampling_conf conf = GD_SAMPLING_DEFAULTS;

	(void)unused;
	for (int i = 0; i < 6; i++) {
		conf.total = 1e12 + 12345 * i;
		conf.seed = (uint64_t)i;
		conf.paper = i == 5;
		run(&f, &conf);
		check_counts(&f, &conf);
	}
	conf.total = GD_SAMPLING_MOST * 512 * 400;
	run(&f, &conf);
	check_counts(&f, &conf);
	conf.total++;
	refused(&f, &conf,
		"3435973836801 samples are more than 16777216 for each of 204800 pixels");
	drop(&f);
}

static void few_samples(void **unused)
{
	struct frame f = make(100, 90, 5);
	struct gd_sampling_conf conf = GD_SAMPLING_DEFAULTS;

	(void)unused;
	for (int total = 0; total < 40; total++) {
		conf.total = total;
		run(&f, &conf);
		check_counts(&f, &conf);
	}
	drop(&f);
}

/* The mean relative error after a map, as documented; grey images only. */
static double objective(const struct frame *f, const double *add, double level, double dark,
			double p)
{
	double sum = 0;

	for (int i = 0; i < f->w * f->h; i++) {
		double v = (double)*at(f->in.colour[0], i), e = (double)*at(f->in.error[0], i);
		double n = (double)*at(f->in.samples, i);
		double rho = fmin(e / (v * v + dark * dark * level * level), 1);

		sum += rho * pow(1 + add[i] / n, -p);
	}
	return sum / (f->w * f->h);
}

static double level_of(const struct frame *f)
{
	double sum = 0;

	for (int i = 0; i < f->w * f->h; i++)
		sum += (double)*at(f->in.colour[0], i) / (f->w * f->h);
	return sum;
}

/* One sample after the other where it gains most, which is best for convex functions. */
static double greedy(const struct frame *f, int total, double max, double level, double dark,
		     double p)
{
	int pixels = f->w * f->h;
	double *add = calloc((size_t)pixels, sizeof *add), best;

	assert_non_null(add);
	for (int k = 0; k < total; k++) {
		int where = -1;
		double most = -1;

		for (int i = 0; i < pixels; i++) {
			double v = (double)*at(f->in.colour[0], i);
			double e = (double)*at(f->in.error[0], i);
			double n = (double)*at(f->in.samples, i);
			double rho = e / (v * v + dark * dark * level * level);
			double gain = rho * (pow(1 + add[i] / n, -p) -
					     pow(1 + (add[i] + 1) / n, -p));

			if (add[i] < max && gain > most) {
				most = gain;
				where = i;
			}
		}
		add[where]++;
	}
	best = objective(f, add, level, dark, p);
	free(add);
	return best;
}

static void no_map_is_better(void **unused)
{
	(void)unused;
	for (int k = 0; k < 4; k++) {
		struct frame f = make(20, 15, (uint64_t)k + 11);
		struct gd_sampling_conf conf = GD_SAMPLING_DEFAULTS;
		struct gd_sampling_result r;
		double p = 4 / (4 + 3.0 * k), best, add[300];

		conf.total = 1800;
		conf.max = k == 1 ? 12 : GD_SAMPLING_MOST;
		conf.floor = conf.blur_px = 0;
		conf.dimension = 3.0 * k;
		conf.trust = 1;
		r = run(&f, &conf);
		check_counts(&f, &conf);
		/* 300 pixels: the brightest hundredth is 3 of them, next to nothing here */
		assert_true(fabs(r.level / level_of(&f) - 1) < 0.002);
		best = greedy(&f, 1800, conf.max, r.level, conf.dark, p);
		for (int i = 0; i < 300; i++)
			add[i] = (double)*at(f.map, i);
		assert_true(fabs(objective(&f, add, r.level, conf.dark, p) / r.after - 1) < 1e-5);
		/* rounding at random costs a little, of second order */
		if (!(r.after < 1.01 * best && r.after > best * (1 - 1e-5)))
			fail_msg("d = %g: %g, the best is %g", conf.dimension, r.after, best);
		assert_true(r.after < 0.9 * r.even && r.even < r.before);
		drop(&f);
	}
}

/* Errors and their estimates, both log-normal: what is left of the errors by estimates trusted so far. */
static double left_by(const struct frame *f, const double *truth, double trust)
{
	struct gd_sampling_conf conf = GD_SAMPLING_DEFAULTS;
	struct frame g = *f;
	double sum = 0;

	conf.total = 10.0 * f->w * f->h;
	conf.floor = conf.blur_px = 0;
	conf.trust = trust;
	run(&g, &conf);
	for (int i = 0; i < f->w * f->h; i++)
		sum += truth[i] * pow(1 + (double)*at(f->map, i) / 2, -0.5);
	return sum;
}

static double normal(uint64_t *seed)
{
	double sum = -6;

	for (int i = 0; i < 12; i++)
		sum += uniform(seed);
	return sum;
}

static void estimates_are_trusted_in_part(void **unused)
{
	enum { SIDE = 120 };
	struct frame f = make(SIDE, SIDE, 12);
	double *truth = malloc(SIDE * SIDE * sizeof *truth), some, all, none;
	uint64_t seed = 5;

	(void)unused;
	assert_non_null(truth);
	fill(&f, f.in.colour, 0.5f);
	for (int i = 0; i < SIDE * SIDE; i++) {
		double log_error = 0.8 * normal(&seed), estimate = log_error + 0.5 * normal(&seed);

		truth[i] = 1e-3 * exp(log_error);
		*at(f.in.samples, i) = 2;
		for (int c = 0; c < 3; c++)
			*at(f.in.error[c], i) = (float)(1e-3 * exp(estimate));
	}
	/* given the estimate, the logarithm is 0.8^2 / (0.8^2 + 0.5^2) = 0.72 times as far off */
	some = left_by(&f, truth, 0.72);
	all = left_by(&f, truth, 1);
	none = left_by(&f, truth, 0.01);
	if (!(some < 0.995 * all && all < none))
		fail_msg("left with trust 0.72: %g, 1: %g, none: %g", some, all, none);
	free(truth);
	drop(&f);
}

static void published_rule(void **unused)
{
	struct frame f = make(40, 30, 21);
	struct gd_sampling_conf conf = GD_SAMPLING_PAPER;
	struct gd_sampling_result r;
	double sum = 0, share[1200];

	(void)unused;
	conf.total = 100000;
	r = run(&f, &conf);
	check_counts(&f, &conf);
	for (int i = 0; i < 1200; i++) {
		double v = (double)*at(f.in.colour[0], i), e = (double)*at(f.in.error[0], i);

		share[i] = e / (v * v + pow(0.18 * r.level, 2)) /
			   sqrt((double)*at(f.in.samples, i));
		sum += share[i];
	}
	for (int i = 0; i < 1200; i++)
		if (!(fabs((double)*at(f.map, i) - 1e5 * share[i] / sum) < 1.001))
			fail_msg("pixel %d: %g, expected %g", i, (double)*at(f.map, i),
				 1e5 * share[i] / sum);
	drop(&f);
}

static void floor_is_kept(void **unused)
{
	struct frame f = make(80, 70, 4);
	struct gd_sampling_conf conf = GD_SAMPLING_DEFAULTS;

	(void)unused;
	*at(f.in.error[0], 1234) = *at(f.in.error[1], 1234) = 100;
	conf.total = 20.0 * f.w * f.h;
	conf.floor = 0.25;
	run(&f, &conf);
	for (int i = 0; i < f.w * f.h; i++)
		assert_true(*at(f.map, i) >= 5);
	conf.floor = 1;
	run(&f, &conf);
	for (int i = 0; i < f.w * f.h; i++)
		assert_true(*at(f.map, i) == 20);
	drop(&f);
}

/* Over seeds a count takes at most two neighbouring values, and any square's sum hardly moves. */
static void rounding_is_fair(void **unused)
{
	enum { SEEDS = 400, SIDE = 64 };
	struct frame f = make(SIDE, SIDE, 8);
	struct gd_sampling_conf conf = GD_SAMPLING_DEFAULTS, many = GD_SAMPLING_DEFAULTS;
	static double mean[SIDE * SIDE], low[SIDE * SIDE], high[SIDE * SIDE];
	double square[2] = { 1e9, 0 }, off = 0;

	(void)unused;
	many.total = 1000.0 * 1.7 * SIDE * SIDE;
	conf.total = floor(1.7 * SIDE * SIDE);
	for (int i = 0; i < SIDE * SIDE; i++) {
		mean[i] = high[i] = 0;
		low[i] = 1e9;
	}
	for (int s = 0; s < SEEDS; s++) {
		double sum = 0;

		conf.seed = (uint64_t)s;
		run(&f, &conf);
		for (int i = 0; i < SIDE * SIDE; i++) {
			double v = (double)*at(f.map, i);

			mean[i] += v / SEEDS;
			low[i] = fmin(low[i], v);
			high[i] = fmax(high[i], v);
			if (i / SIDE >= 8 && i / SIDE < 16 && i % SIDE >= 24 && i % SIDE < 32)
				sum += v;
		}
		square[0] = fmin(square[0], sum);
		square[1] = fmax(square[1], sum);
	}
	for (int i = 0; i < SIDE * SIDE; i++)
		assert_true(high[i] - low[i] <= 1);
	assert_true(square[1] - square[0] <= 2);	/* 64 independent draws: 15 or so */
	/* what is rounded does not depend on the seed: a thousand of the same samples tell it */
	for (int i = 0; i < SIDE * SIDE; i++)
		*at(f.in.samples, i) *= 1000;
	run(&f, &many);
	for (int i = 0; i < SIDE * SIDE; i++)
		off += fabs(mean[i] - 1e-3 * (double)*at(f.map, i)) / (SIDE * SIDE);
	if (!(off < 0.02))	/* a mean of 400 of variance 1/4 at most: 0.02 */
		fail_msg("means over seeds are off by %g", off);
	drop(&f);
}

static void exposure(void **unused)
{
	struct frame f = make(90, 50, 9);
	struct gd_sampling_conf conf = GD_SAMPLING_DEFAULTS;
	struct gd_plane first = plane(90, 50);
	static const float scale[] = { 1024, 0x1p-30f, 3, 1e-9f };

	(void)unused;
	conf.total = 9.0 * 90 * 50;
	run(&f, &conf);
	memcpy(first.v, f.map.v, gd_stride(90) * 50 * sizeof(float));
	for (int k = 0; k < 4; k++) {
		double off = 0;

		for (int i = 0; i < 90 * 50; i++)
			for (int c = 0; c < 3; c++) {
				*at(f.in.colour[c], i) *= scale[k];
				*at(f.in.error[c], i) *= scale[k] * scale[k];
			}
		run(&f, &conf);
		check_counts(&f, &conf);
		for (int i = 0; i < 90 * 50; i++)
			off += fabs((double)(*at(f.map, i) - *at(first, i)));
		assert_true(k < 2 ? off == 0 : off < 20);
		for (int i = 0; i < 90 * 50; i++)
			for (int c = 0; c < 3; c++) {
				*at(f.in.colour[c], i) /= scale[k];
				*at(f.in.error[c], i) /= scale[k] * scale[k];
			}
	}
	free(first.v);
	drop(&f);
}

static void threads(void **unused)
{
	struct frame f = make(300, 200, 10);
	struct gd_sampling_conf conf = GD_SAMPLING_DEFAULTS;
	struct gd_plane first = plane(300, 200);
	int before = omp_get_max_threads();

	(void)unused;
	conf.total = 4.5 * 300 * 200;
	for (int n = 1; n <= 7; n += 3) {
		omp_set_num_threads(n);
		run(&f, &conf);
		for (int y = 0; y < 200; y++)
			if (n == 1)
				memcpy(gd_row(first, y), gd_row(f.map, y), 300 * sizeof(float));
			else
				assert_memory_equal(gd_row(first, y), gd_row(f.map, y),
						    300 * sizeof(float));
	}
	omp_set_num_threads(before);
	free(first.v);
	drop(&f);
}

static void nothing_to_go_by(void **unused)
{
	struct frame f = make(50, 40, 12);
	struct gd_sampling_conf conf = GD_SAMPLING_DEFAULTS;
	struct gd_sampling_result r;

	(void)unused;
	fill(&f, f.in.error, 0);
	conf.total = 2 * 50 * 40;
	r = run(&f, &conf);
	assert_true(r.blind && r.before == 0 && r.least == 2 && r.most == 2);
	fill(&f, f.in.error, NAN);
	assert_true(run(&f, &conf).most == 2);
	fill(&f, f.in.error, -1);
	assert_true(run(&f, &conf).most == 2);
	/* everything alike, even if all is infinite or black */
	for (int i = 0; i < 50 * 40; i++)
		*at(f.in.samples, i) = 8;
	fill(&f, f.in.error, INFINITY);
	r = run(&f, &conf);
	assert_true(!r.blind && r.least == 2 && r.most == 2);
	fill(&f, f.in.colour, 0);
	fill(&f, f.in.error, 1e-20f);
	r = run(&f, &conf);
	assert_true(r.least == 2 && r.most == 2);
	drop(&f);
}

static void hostile(void **unused)
{
	static const float bad[] = { NAN, INFINITY, -INFINITY, 1e30f, FLT_MAX, -1, 0, 1e-44f };
	uint64_t seed = 99;

	(void)unused;
	for (int k = 0; k < 20; k++) {
		struct frame f = make(70, 66, (uint64_t)k);
		struct gd_sampling_conf conf = GD_SAMPLING_DEFAULTS, paper = GD_SAMPLING_PAPER;

		for (int i = 0; i < 400; i++) {
			int p = (int)(uniform(&seed) * 70 * 66), c = (int)(uniform(&seed) * 7);
			float v = bad[(int)(uniform(&seed) * 8)];

			*at(c < 3 ? f.in.colour[c] : c < 6 ? f.in.error[c - 3] : f.in.samples,
			    p) = v;
		}
		conf.total = paper.total = 3 * 70 * 66;
		conf.max = k % 2 ? 6 : GD_SAMPLING_MOST;
		run(&f, &conf);
		check_counts(&f, &conf);
		run(&f, &paper);
		check_counts(&f, &paper);
		drop(&f);
	}
}

/* A single outlier does not take what others need: no error counts more than 1. */
static void firefly(void **unused)
{
	struct frame f = make(64, 48, 2);
	struct gd_sampling_conf conf = GD_SAMPLING_DEFAULTS;

	(void)unused;
	for (int c = 0; c < 3; c++)
		*at(f.in.error[c], 1000) = 1e30f;
	conf.total = 8 * 64 * 48;
	assert_true(run(&f, &conf).most < 0.05 * conf.total);
	check_counts(&f, &conf);
	drop(&f);
}

/* Pixels without a sample get some, although nothing is known of them. */
static void unsampled(void **unused)
{
	struct frame f = make(64, 48, 2);
	struct gd_sampling_conf conf = GD_SAMPLING_DEFAULTS;

	(void)unused;
	for (int i = 0; i < 64 * 48; i++) {
		*at(f.in.samples, i) = i % 3 ? 8 : 0;
		for (int c = 0; c < 3; c++) {
			*at(f.in.error[c], i) = 0.001f;
			*at(f.in.colour[c], i) = 0.5f;
		}
	}
	conf.total = 4 * 64 * 48;
	run(&f, &conf);
	check_counts(&f, &conf);
	for (int i = 0; i < 64 * 48; i += 3)
		assert_true(*at(f.map, i) >= 1);
	drop(&f);
}

static void refusals(void **unused)
{
	struct frame f = make(10, 10, 2);
	struct gd_sampling_conf conf = GD_SAMPLING_DEFAULTS;

	(void)unused;
	conf.total = 301;
	conf.max = 3;
	refused(&f, &conf, "301 samples are more than 3 for each of 100 pixels");
	conf.total = 99;
	conf.min = 1;
	refused(&f, &conf, "99 samples are less than 1 for each of 100 pixels");
	conf.total = 300;
	run(&f, &conf);
	check_counts(&f, &conf);
	conf.multiple = 2;
	refused(&f, &conf, "300 samples are more than 2 for each of 100 pixels");
	conf.total = 201;
	refused(&f, &conf, "201 samples: expected a multiple of 2");
	conf.total = 0.5;
	conf.multiple = 1;
	refused(&f, &conf, "0.5 samples: expected a multiple of 1");
	conf.total = NAN;
	refused(&f, &conf, "nan samples: expected a multiple of 1");
	conf.total = 10;
	conf.floor = 2;
	refused(&f, &conf, "a setting of the map is out of its range");
	drop(&f);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(sums_are_exact),   cmocka_unit_test(huge_totals),
		cmocka_unit_test(few_samples),	    cmocka_unit_test(no_map_is_better),
		cmocka_unit_test(estimates_are_trusted_in_part),
		cmocka_unit_test(published_rule),   cmocka_unit_test(floor_is_kept),
		cmocka_unit_test(rounding_is_fair), cmocka_unit_test(exposure),
		cmocka_unit_test(threads),	    cmocka_unit_test(nothing_to_go_by),
		cmocka_unit_test(hostile),	    cmocka_unit_test(firefly),
		cmocka_unit_test(unsampled),	    cmocka_unit_test(refusals),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
