/* SPDX-License-Identifier: BSD-3-Clause */
/* The feature over several frames of a made sequence whose truth is known. */
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

#include "feature.h"

#define W 120
#define H 90
#define BINS 4
#define SD 0.02		/* of the noise of a bin's gradient */

/* Repeatable noise of variance 1 that depends on all its arguments. */
static double noise(int x, int y, int c, int stream)
{
	uint32_t s = (uint32_t)x * 374761393u + (uint32_t)y * 668265263u +
		     (uint32_t)c * 2246822519u + (uint32_t)stream * 3266489917u;

	s = (s ^ (s >> 13)) * 1274126177u;
	s = (s ^ (s >> 16)) * 2654435761u;
	s ^= s >> 15;
	return 1.7320508 * ((double)(s >> 8) / 8388608.0 - 1.0);
}

/* What a frame shows. */
struct shot {
	int number;	/* noise of its own */
	int shift;	/* pixels that the camera moved to the right */
	double light;	/* 0: black */
	bool position, unrelated;
};

static double truth(const struct shot *f, int x, int y, int c)
{
	int u = x + f->shift + 1000;

	if (f->unrelated)
		return ((u / 7 + y / 5) % 2 ? 3.0 : 0.5) * (1 + 0.2 * c);
	return f->light * ((u / 11 + y / 8) % 3 + 0.03 * (c + 1) * (u - 1000));
}

static void fill(struct gd_plane p, const struct shot *f, int c, int dx, int dy, int stream)
{
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++) {
			bool last = (dx && x == W - 1) || (dy && y == H - 1);
			double d = truth(f, x + dx, y + dy, c) - (dx || dy ? truth(f, x, y, c) : 0);

			gd_row(p, y)[x] = last ? 0.0f : (float)(d + SD * noise(x, y, c, stream));
		}
}

static struct gd_plane channel(struct gd_image *im, const char *name)
{
	struct gd_err err = { 0 };
	struct gd_plane p;

	if (gd_image_add(im, name, &p, &err) != GD_OK)
		fail_msg("%s", err.text);
	return p;
}

/* A wavy wall, seen from a camera that moves along it: where a pixel looks, in the world. */
static void add_position(struct gd_image *im, const struct shot *f)
{
	struct gd_plane p[3] = { channel(im, "P.X"), channel(im, "P.Y"), channel(im, "P.Z") };

	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++) {
			double u = x + f->shift;

			gd_row(p[0], y)[x] = (float)(0.1 * u);
			gd_row(p[1], y)[x] = (float)(0.1 * y);
			gd_row(p[2], y)[x] = (float)(20 + 2 * sin(0.05 * u) + 2 * cos(0.07 * y));
		}
}

static void make(struct gd_image *im, const struct shot *f)
{
	gd_image_init(im, W, H);
	for (int b = 0; b < BINS; b++)
		for (int i = 0; i < 9; i++) {
			static const char *const layer[] = { "", "dx.", "dy." };
			char name[32];

			snprintf(name, sizeof name, "bin%d.%s%c", b, layer[i / 3], "RGB"[i % 3]);
			fill(channel(im, name), f, i % 3, i / 3 == 1, i / 3 == 2,
			     100 * f->number + 3 * b + i / 3);
		}
	for (int c = 0; c < 3; c++)
		fill(channel(im, (char[]){ "RGB"[c], 0 }), f, c, 0, 0, 100 * f->number + 50);
	if (f->position)
		add_position(im, f);
}

static struct gd_plane plane(const struct gd_image *im, const char *name)
{
	struct gd_plane p;

	if (!gd_image_plane(im, name, &p))
		fail_msg("no channel %s", name);
	return p;
}

/* The window of the filter is 0 unless asked for: what neighbours do is then all there is. */
static struct gd_feature_conf no_window(void)
{
	struct gd_feature_conf conf = GD_FEATURE_DEFAULTS;

	conf.nlm.window = 0;
	return conf;
}

/* The feature of the first of n frames, the others being its neighbours. */
static struct gd_feature_result run(struct gd_image *im, const struct shot *shot, int n,
				    struct gd_feature_conf conf)
{
	struct gd_image other[GD_FEATURE_FRAMES] = { 0 };
	struct gd_feature_result res;
	struct gd_err err = { 0 };
	int rc;

	conf.bagging = false;	/* nothing here depends on it */
	make(im, &shot[0]);
	conf.neighbour = other;
	conf.neighbours = n - 1;
	rc = gd_feature_want(im, &conf, &err);
	for (int i = 0; i + 1 < n && rc == GD_OK; i++) {
		make(&other[i], &shot[i + 1]);
		rc = gd_feature_want_neighbour(&other[i], im, &conf, &err);
	}
	if (rc == GD_OK)
		rc = gd_feature_run(im, &conf, &res, NULL, &err);
	if (rc != GD_OK)
		fail_msg("%s", err.text);
	for (int i = 0; i < GD_FEATURE_FRAMES; i++)
		gd_image_free(&other[i]);
	return res;
}

/* Mean squared error of the differences of neighbouring pixels, away from the border. */
static double error_of(const struct gd_image *im, const struct shot *f, const char *name)
{
	struct gd_plane p = plane(im, name);
	double sum = 0.0;
	int n = 0;

	for (int y = 12; y < H - 12; y++)
		for (int x = 12; x < W - 12; x++, n++) {
			double d = gd_row(p, y)[x + 1] - gd_row(p, y)[x];

			d -= truth(f, x + 1, y, 1) - truth(f, x, y, 1);
			sum += d * d;
		}
	return sum / n;
}

static double mean_of(const struct gd_image *im, const char *name)
{
	struct gd_plane p = plane(im, name);
	double sum = 0.0;

	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++)
			sum += gd_row(p, y)[x];
	return sum / (W * H);
}

static const char *const names[] = { "feature.G", "half0.feature.G", "half1.feature.G" };

/*
 * The error with n - 1 neighbours over that without any. The mean of n has 1 / n of the noise; the
 * part that goes to the slow difference, which stays the frame's own, is a blur by 4 pixels, of
 * whose differences next to nothing is left. Weights are not all equal, but near to it.
 */
static double gain(const struct shot *shot, int n, int layer)
{
	struct gd_image alone, with;
	double ratio;

	run(&alone, shot, 1, no_window());
	run(&with, shot, n, no_window());
	ratio = error_of(&with, shot, names[layer]) / error_of(&alone, shot, names[layer]);
	gd_image_free(&alone);
	gd_image_free(&with);
	return ratio;
}

static void in_range(const char *what, double found, double lo, double hi)
{
	if (!(found >= lo && found <= hi))
		fail_msg("%s: %.4g, expected %.4g to %.4g", what, found, lo, hi);
}

static void independent_noise_averages_out(void **unused)
{
	const struct shot shot[] = { { 0, 0, 1, true, false }, { 1, 0, 1, true, false },
		{ 2, 0, 1, true, false }, { 3, 0, 1, true, false }, { 4, 0, 1, true, false } };

	(void)unused;
	for (int i = 0; i < 3; i++) {
		in_range("two frames", gain(shot, 2, i), 0.45, 0.62);
		in_range("five frames", gain(shot, 5, i), 0.17, 0.30);
	}
}

static void variances_tell_it(void **unused)
{
	const struct shot shot[] = { { 0, 0, 1, true, false }, { 1, 0, 1, true, false },
		{ 2, 0, 1, true, false } };
	struct gd_image alone, with;

	(void)unused;
	run(&alone, shot, 1, no_window());
	run(&with, shot, 3, no_window());
	in_range("variance", mean_of(&with, "half0.feature.variance.G") /
		 mean_of(&alone, "half0.feature.variance.G"), 0.3, 0.45);
	in_range("variance", mean_of(&with, "feature.variance.G") /
		 mean_of(&alone, "feature.variance.G"), 0.3, 0.45);
	gd_image_free(&alone);
	gd_image_free(&with);
}

static void a_moving_camera_is_followed(void **unused)
{
	const struct shot shot[] = { { 0, 0, 1, true, false }, { 1, 3, 1, true, false },
		{ 2, -7, 1, true, false } };
	struct gd_feature_result res;
	struct gd_image im;

	(void)unused;
	in_range("three frames", gain(shot, 3, 1), 0.3, 0.5);
	res = run(&im, shot, 3, no_window());
	assert_int_equal(res.followed, 2);
	in_range("found", res.found, 0.9, 1 - 5.0 / W);
	gd_image_free(&im);
}

/* Windows of the filter span the frames: its own 121 pixels and 121 of each neighbour. */
static void without_positions(void **unused)
{
	const struct shot shot[] = { { 0, 0, 1, false, false }, { 1, 0, 1, true, false },
		{ 2, 0, 1, false, false } };
	struct gd_feature_result res;
	struct gd_image alone, with;

	(void)unused;
	run(&alone, shot, 1, GD_FEATURE_DEFAULTS);
	res = run(&with, shot, 3, GD_FEATURE_DEFAULTS);
	assert_int_equal(res.frames, 2);
	assert_int_equal(res.followed, 0);
	in_range("error", error_of(&with, shot, names[1]) / error_of(&alone, shot, names[1]), 0.2,
		 0.9);
	gd_image_free(&alone);
	gd_image_free(&with);
}

/* A neighbour that is black or shows something else leaves things as they were. */
static void what_does_not_fit(void **unused)
{
	const struct shot frame = { 0, 0, 1, true, false };
	const struct shot odd[] = { { 1, 0, 0, true, false }, { 1, 0, 1, true, true },
		{ 1, 0, 1e20, true, false }, { 1, 0, 1e-20, true, false },
		{ 1, 500, 1, true, false } };

	(void)unused;
	for (int i = 0; i < 5; i++) {
		const struct shot shot[] = { frame, odd[i] };

		for (int layer = 0; layer < 3; layer++)
			in_range("odd neighbour", gain(shot, 2, layer), 0.5, 1.05);
	}
}

/* Light that changes as a whole is no reason to leave a neighbour out where nothing else does. */
static void other_light(void **unused)
{
	const struct shot shot[] = { { 0, 0, 1, true, false }, { 1, 0, 1.1, true, false } };

	(void)unused;
	in_range("brighter", gain(shot, 2, 1), 0.4, 1.0);
}

static void same(const struct gd_image *a, const struct gd_image *b, double tolerance)
{
	for (int i = 0; i < 3; i++) {
		struct gd_plane p = plane(a, names[i]), q = plane(b, names[i]);

		for (int y = 0; y < H; y++)
			for (int x = 0; x < W; x++)
				if (!(fabs((double)gd_row(p, y)[x] - gd_row(q, y)[x]) <= tolerance))
					fail_msg("%s at (%d, %d): %.9g and %.9g", names[i], x, y,
						 gd_row(p, y)[x], gd_row(q, y)[x]);
	}
}

static void order_and_threads(void **unused)
{
	const struct shot a[] = { { 0, 0, 1, true, false }, { 1, 3, 1, true, false },
		{ 2, -2, 1, true, false } };
	const struct shot b[] = { a[0], a[2], a[1] };
	const int before = omp_get_max_threads();
	struct gd_image first, second, third;

	(void)unused;
	omp_set_num_threads(1);
	run(&first, a, 3, GD_FEATURE_DEFAULTS);
	omp_set_num_threads(3);
	run(&second, a, 3, GD_FEATURE_DEFAULTS);
	run(&third, b, 3, GD_FEATURE_DEFAULTS);
	omp_set_num_threads(before);
	same(&first, &second, 0.0);
	same(&first, &third, 2e-5);
	gd_image_free(&first);
	gd_image_free(&second);
	gd_image_free(&third);
}

/* Features made before, by the stage without its filter, give what gradients give. */
static void made_before(void **unused)
{
	const struct shot shot[] = { { 0, 0, 1, true, false }, { 1, 3, 1, true, false } };
	struct gd_feature_conf conf = GD_FEATURE_DEFAULTS;
	struct gd_image now, own, other;
	struct gd_feature_result res;
	struct gd_err err = { 0 };

	(void)unused;
	run(&now, shot, 2, conf);
	conf.filter = false;
	run(&own, &shot[0], 1, conf);
	run(&other, &shot[1], 1, conf);
	conf.filter = true;
	conf.bagging = false;
	conf.neighbour = &other;
	conf.neighbours = 1;
	assert_int_equal(gd_feature_want(&own, &conf, &err), GD_OK);
	assert_int_equal(gd_feature_want_neighbour(&other, &own, &conf, &err), GD_OK);
	assert_int_equal(gd_feature_run(&own, &conf, &res, NULL, &err), GD_OK);
	assert_true(res.made_before);
	assert_int_equal(res.solved, 0);
	same(&now, &own, 0.0);
	gd_image_free(&now);
	gd_image_free(&own);
	gd_image_free(&other);
}

static void all_finite(const struct gd_image *im)
{
	for (int i = 0; i < im->nchan; i++) {
		struct gd_plane p = plane(im, im->chan[i].name);

		for (int y = 0; y < H && strstr(im->chan[i].name, "feature"); y++)
			for (int x = 0; x < W; x++)
				if (!isfinite(gd_row(p, y)[x]))
					fail_msg("%s at (%d, %d)", im->chan[i].name, x, y);
	}
}

static void hostile_neighbours(void **unused)
{
	static const float bad[] = { NAN, INFINITY, -INFINITY, 3e38f, -3e38f, 1e30f, -1.0f };
	const struct shot shot[] = { { 0, 0, 1, true, false }, { 1, 2, 1, true, false } };
	struct gd_feature_conf conf = GD_FEATURE_DEFAULTS;
	struct gd_err err = { 0 };

	(void)unused;
	for (int positions = 0; positions < 2; positions++) {
		struct gd_image own, other;

		conf.filter = false;
		run(&own, &shot[0], 1, conf);
		run(&other, &shot[1], 1, conf);
		for (int i = 0, k = 0; i < other.nchan; i++) {
			struct gd_plane p = plane(&other, other.chan[i].name);

			for (int j = 0; j < 40; j++, k++)
				gd_row(p, (k * 37) % H)[(k * 53) % W] = bad[k % 7];
		}
		if (!positions)
			gd_image_drop(&other, "P.Z");
		conf.filter = true;
		conf.neighbour = &other;
		conf.neighbours = 1;
		assert_int_equal(gd_feature_run(&own, &conf, NULL, NULL, &err), GD_OK);
		all_finite(&own);
		gd_image_free(&own);
		gd_image_free(&other);
		conf.neighbours = 0;
	}
}

static void refusals(void **unused)
{
	const struct shot shot = { 0, 0, 1, false, false };
	struct gd_feature_conf conf = GD_FEATURE_DEFAULTS;
	struct gd_image im, other;
	struct gd_err err = { 0 };

	(void)unused;
	make(&im, &shot);
	gd_image_init(&other, W, H - 1);
	assert_int_equal(gd_feature_want_neighbour(&other, &im, &conf, &err), GD_ESHAPE);
	assert_non_null(strstr(err.text, "is 120x89, expected 120x90"));
	gd_image_free(&other);
	gd_image_init(&other, W, H);
	channel(&other, "R");
	err = (struct gd_err){ 0 };
	assert_int_equal(gd_feature_want_neighbour(&other, &im, &conf, &err), GD_ESHAPE);
	assert_non_null(strstr(err.text, "no channel dx.R"));
	conf.neighbours = GD_FEATURE_FRAMES + 1;
	conf.neighbour = &other;
	err = (struct gd_err){ 0 };
	assert_int_equal(gd_feature_run(&im, &conf, NULL, NULL, &err), GD_EARG);
	gd_image_free(&other);
	gd_image_free(&im);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(independent_noise_averages_out),
		cmocka_unit_test(variances_tell_it),
		cmocka_unit_test(a_moving_camera_is_followed),
		cmocka_unit_test(without_positions),
		cmocka_unit_test(what_does_not_fit),
		cmocka_unit_test(other_light),
		cmocka_unit_test(order_and_threads),
		cmocka_unit_test(made_before),
		cmocka_unit_test(hostile_neighbours),
		cmocka_unit_test(refusals),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
