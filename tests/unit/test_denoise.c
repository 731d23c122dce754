/* SPDX-License-Identifier: BSD-3-Clause */
/* Which channels the denoiser takes, and what becomes of them. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "denoise_job.h"

#define W 33
#define H 21

static double draw(unsigned *state)
{
	double sum = 0;

	for (int i = 0; i < 4; i++) {
		*state = *state * 1664525u + 1013904223u;
		sum += (double)(*state >> 8) / (1 << 24) - 0.5;
	}
	return sum * 1.7320508;
}

/* A layer of value + x/8 with noise. */
static void add(struct gd_image *im, const char *layer, int n, double value, double noise,
		unsigned seed)
{
	struct gd_plane p[GD_LAYER_PLANES];
	unsigned state = seed * 7919 + 1;

	assert_int_equal(gd_layer_add(im, layer, n, p, NULL), GD_OK);
	for (int c = 0; c < n; c++)
		for (int y = 0; y < H; y++)
			for (int x = 0; x < W; x++)
				gd_row(p[c], y)[x] =
					(float)(value + x / 8.0 + noise * draw(&state));
}

/* Colour as the mean of its parts part0 .. part<n-1>, with variances, albedo and a noisy depth. */
static void frame(struct gd_image *im, const char *part, int n)
{
	struct gd_plane mean[GD_LAYER_PLANES], p[GD_LAYER_PLANES];
	char name[32];

	gd_image_init(im, W, H);
	assert_int_equal(gd_layer_add(im, "", 3, mean, NULL), GD_OK);
	for (int b = 0; b < n; b++) {
		snprintf(name, sizeof name, "%s%d", part, b);
		add(im, name, 3, 1, 0.2, (unsigned)b + 1);
		assert_int_equal(gd_layer_planes(im, name, p), 3);
		for (int c = 0; c < 3; c++)
			for (int y = 0; y < H; y++)
				for (int x = 0; x < W; x++)
					gd_row(mean[c], y)[x] += gd_row(p[c], y)[x] / (float)n;
	}
	add(im, "variance", 3, 0.04 / n, 0, 9);
	add(im, "albedo", 3, 0.5, 0, 10);
	add(im, "Z", 1, 4, 0.1, 11);
	add(im, "Z.variance", 1, 0.01, 0, 12);
}

static int run(struct gd_image *im, const struct gd_denoise_conf *conf, struct gd_err *err)
{
	struct gd_denoise_result result;

	return gd_denoise_run(im, conf, &result, NULL, err);
}

static struct gd_plane plane(const struct gd_image *im, const char *name)
{
	struct gd_plane p = { 0 };

	if (!gd_image_plane(im, name, &p))
		fail_msg("no channel %s", name);
	return p;
}

static double off(struct gd_plane a, struct gd_plane b)
{
	double most = 0;

	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++)
			most = fmax(most, fabs((double)gd_row(a, y)[x] - (double)gd_row(b, y)[x]));
	return most;
}

static void test_missing(void **state)
{
	struct gd_denoise_conf conf = GD_DENOISE_DEFAULTS;
	struct gd_image im = { 0 };
	struct gd_err err = { 0 };

	(void)state;
	frame(&im, "half", 2);
	gd_image_drop(&im, "G");
	assert_int_equal(gd_denoise_want(&im, &conf, &err), GD_ESHAPE);
	assert_string_equal(err.text, "no channel G");
	assert_int_equal(run(&im, &conf, NULL), GD_ESHAPE);
	gd_image_free(&im);
}

static void test_refused(void **state)
{
	static const struct { const char *features, *layers, *text; } bad[] = {
		{ "auto", "albedo", "layer albedo is a feature: it cannot be denoised, too" },
		{ "none", "Z,Z", "layer Z is named twice" },
		{ "none", "fog", "no layer fog" },
		{ "P", NULL, "no feature layer P" },
		{ "error", NULL, "error is no layer of its own: a denoiser uses that name" },
		{ "Z,Z.variance", NULL, "Z.variance is no layer of its own: a denoiser uses that "
					"name" },
		{ "none", "bin2", "bin2 is no layer of its own: a denoiser uses that name" },
		{ "model.radius", NULL, "model.radius is no layer of its own: a denoiser uses that "
					"name" },
	};
	struct gd_image im = { 0 };

	(void)state;
	frame(&im, "half", 2);
	for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
		struct gd_denoise_conf conf = GD_DENOISE_DEFAULTS;
		struct gd_err err = { 0 };

		conf.features = bad[i].features;
		conf.layers = bad[i].layers;
		assert_int_not_equal(gd_denoise_want(&im, &conf, &err), GD_OK);
		assert_string_equal(err.text, bad[i].text);
	}
	gd_image_free(&im);
}

static void test_too_many_features(void **state)
{
	struct gd_denoise_conf conf = GD_DENOISE_DEFAULTS;
	struct gd_image im = { 0 };
	struct gd_err err = { 0 };
	char list[128] = "", name[16];

	(void)state;
	frame(&im, "half", 2);
	for (int i = 0; i < 26; i++) {
		snprintf(name, sizeof name, "f%d", i);
		add(&im, name, 1, i, 1, (unsigned)i);
		snprintf(list + strlen(list), sizeof list - strlen(list), "%s%s", i ? "," : "",
			 name);
	}
	conf.features = list;
	assert_int_equal(run(&im, &conf, &err), GD_EARG);
	assert_string_equal(err.text, "more than 25 feature planes");
	gd_image_free(&im);
}

/* Two bins are two halves. */
static void test_bins_as_halves(void **state)
{
	struct gd_denoise_conf conf = GD_DENOISE_DEFAULTS;
	struct gd_image a = { 0 }, b = { 0 };

	(void)state;
	for (int known = 0; known < 2; known++) {
		frame(&a, "half", 2);
		frame(&b, "bin", 2);
		for (int c = 0; c < 3 && !known; c++) {
			gd_image_drop(&a, c == 0   ? "variance.R"
					  : c == 1 ? "variance.G"
						   : "variance.B");
			gd_image_drop(&b, c == 0   ? "variance.R"
					  : c == 1 ? "variance.G"
						   : "variance.B");
		}
		assert_int_equal(run(&a, &conf, NULL), GD_OK);
		assert_int_equal(run(&b, &conf, NULL), GD_OK);
		assert_true(off(plane(&a, "R"), plane(&b, "R")) == 0);
		assert_true(off(plane(&a, "error.B"), plane(&b, "error.B")) == 0);
		gd_image_free(&a);
		gd_image_free(&b);
	}
}

/* Halves of two bins and one, as channels or as an attribute of halves made before. */
static void test_odd_bins(void **state)
{
	struct gd_denoise_conf conf = GD_DENOISE_DEFAULTS;
	struct gd_image a = { 0 }, b = { 0 };
	struct gd_plane bin[3], half[2];

	(void)state;
	frame(&a, "bin", 3);
	frame(&b, "half", 2);
	for (int c = 0; c < 3; c++) {
		char name[16];

		for (int i = 0; i < 3; i++) {
			snprintf(name, sizeof name, "bin%d.%c", i, "RGB"[c]);
			bin[i] = plane(&a, name);
		}
		for (int i = 0; i < 2; i++) {
			snprintf(name, sizeof name, "half%d.%c", i, "RGB"[c]);
			half[i] = plane(&b, name);
		}
		for (int y = 0; y < H; y++)
			for (int x = 0; x < W; x++) {
				gd_row(half[0], y)[x] = (float)(((double)gd_row(bin[0], y)[x] +
								 (double)gd_row(bin[2], y)[x]) / 2);
				gd_row(half[1], y)[x] = gd_row(bin[1], y)[x];
			}
	}
	for (int c = 0; c < 3; c++) {
		char name[16];

		snprintf(name, sizeof name, "variance.%c", "RGB"[c]);
		for (int y = 0; y < H; y++)
			memcpy(gd_row(plane(&b, name), y), gd_row(plane(&a, name), y),
			       W * sizeof(float));
	}
	assert_int_equal(gd_attr_set_int(&b, "gd:bins", 3, NULL), GD_OK);
	assert_int_equal(run(&a, &conf, NULL), GD_OK);
	assert_int_equal(run(&b, &conf, NULL), GD_OK);
	assert_true(off(plane(&a, "R"), plane(&b, "R")) == 0);
	gd_image_free(&a);
	gd_image_free(&b);
}

static void test_keep_and_drop(void **state)
{
	static const char *const used[] = {"albedo.R", "Z",	 "Z.variance", "variance.G",
					   "bin0.R",   "bin1.G", "bin2.B"};
	struct gd_denoise_conf conf = GD_DENOISE_DEFAULTS;

	(void)state;
	for (int single = 0; single < 2; single++) {
		struct gd_image im = { 0 }, was = { 0 };

		conf.method = single ? GD_DENOISE_SINGLE : GD_DENOISE_CROSSFIT;
		conf.keep = true;
		frame(&im, "bin", 3);
		frame(&was, "bin", 3);
		gd_row(plane(&im, "Z"), 3)[4] = gd_row(plane(&was, "Z"), 3)[4] = 1e9f;
		assert_int_equal(run(&im, &conf, NULL), GD_OK);
		for (size_t i = 0; i < sizeof used / sizeof *used; i++)
			assert_true(off(plane(&im, used[i]), plane(&was, used[i])) == 0);
		gd_image_free(&im);
		frame(&im, "bin", 3);
		conf.keep = false;
		assert_int_equal(run(&im, &conf, NULL), GD_OK);
		for (size_t i = 0; i < sizeof used / sizeof *used; i++)
			assert_int_equal(gd_image_find(&im, used[i]), -1);
		assert_true(gd_image_find(&im, "error.R") >= 0);
		assert_int_equal(gd_image_find(&im, "model.spread") >= 0, !single);
		assert_int_equal(gd_image_find(&im, "model.order") >= 0, single);
		gd_image_free(&im);
		gd_image_free(&was);
	}
}

/* A feature of either half that is named as often as a list can: there is one of it. */
static void test_named_often(void **state)
{
	struct gd_denoise_conf conf = GD_DENOISE_DEFAULTS;
	struct gd_image im[2] = { { 0 } };
	char list[8 * 48] = "feature";

	(void)state;
	conf.keep = true;
	conf.fast = true;
	for (int often = 0; often < 2; often++) {
		frame(&im[often], "half", 2);
		add(&im[often], "half0.feature", 3, 1, 0.1, 21);
		add(&im[often], "half1.feature", 3, 1, 0.1, 22);
		for (int i = 1; i < 48 && often; i++)
			strcat(list, ",feature");
		conf.features = list;
		assert_int_equal(run(&im[often], &conf, NULL), GD_OK);
	}
	assert_true(off(plane(&im[0], "R"), plane(&im[1], "R")) == 0);
	gd_image_free(&im[0]);
	gd_image_free(&im[1]);
}

/* Scalar channels of those names are no bins; half a set of halves is none. */
static void test_look_alikes(void **state)
{
	struct gd_denoise_conf conf = GD_DENOISE_DEFAULTS;
	struct gd_denoise_result result;
	struct gd_image im = { 0 };

	(void)state;
	frame(&im, "half", 2);
	add(&im, "bin0", 1, 1, 1, 3);
	add(&im, "bin1", 1, 1, 1, 4);
	gd_image_drop(&im, "half1.B");
	assert_int_equal(gd_denoise_run(&im, &conf, &result, NULL, NULL), GD_OK);
	assert_true(off(plane(&im, "R"), plane(&im, "R")) == 0);
	gd_image_free(&im);
}

static void test_no_numbers(void **state)
{
	struct gd_denoise_conf conf = GD_DENOISE_DEFAULTS;
	struct gd_denoise_result result;
	struct gd_image im = { 0 };

	(void)state;
	frame(&im, "half", 2);
	gd_row(plane(&im, "half0.R"), 5)[5] = NAN;
	gd_row(plane(&im, "half1.G"), 6)[6] = INFINITY;
	gd_row(plane(&im, "albedo.B"), 7)[7] = -INFINITY;
	gd_row(plane(&im, "variance.B"), 8)[8] = NAN;
	assert_int_equal(gd_denoise_run(&im, &conf, &result, NULL, NULL), GD_OK);
	assert_int_equal(result.mended, 3);
	for (int i = 0; i < im.nchan; i++)
		for (int y = 0; y < H; y++)
			for (int x = 0; x < W; x++)
				assert_true(isfinite(gd_row(plane(&im, im.chan[i].name), y)[x]));
	gd_image_free(&im);
}

static void positions(struct gd_image *im)
{
	static const char *const name[] = { "P.X", "P.Y", "P.Z" };
	struct gd_plane p[3];

	for (int c = 0; c < 3; c++)
		assert_int_equal(gd_image_add(im, name[c], &p[c], NULL), GD_OK);
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++) {
			gd_row(p[0], y)[x] = (float)x;
			gd_row(p[1], y)[x] = (float)y;
			gd_row(p[2], y)[x] = 1;
		}
}

static double mean_of(struct gd_plane p)
{
	double sum = 0;

	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++)
			sum += (double)gd_row(p, y)[x] / W / H;
	return sum;
}

static void assert_finite(const struct gd_image *im)
{
	for (int i = 0; i < im->nchan; i++)
		for (int y = 0; y < H; y++)
			for (int x = 0; x < W; x++)
				assert_true(isfinite(gd_row(plane(im, im->chan[i].name), y)[x]));
}

/* Of halves and of all samples: what they add, what they say they built. */
static void test_linear(void **state)
{
	static const enum gd_denoise_method method[] = { GD_DENOISE_LWR, GD_DENOISE_LWR_WHOLE };
	struct gd_denoise_result result;

	(void)state;
	for (int i = 0; i < 4; i++) {
		struct gd_denoise_conf conf = GD_DENOISE_DEFAULTS;
		struct gd_image im = { 0 };

		conf.method = method[i / 2];
		conf.lwr.dense = i % 2;
		frame(&im, "bin", 4);
		assert_int_equal(gd_denoise_run(&im, &conf, &result, NULL, NULL), GD_OK);
		assert_int_equal(result.crossfit, i < 2);
		assert_int_equal(result.halves, i < 2);
		assert_int_equal(gd_image_find(&im, "model.spread") >= 0, i < 2);
		assert_int_equal(gd_image_find(&im, "albedo.R"), -1);
		assert_int_equal(gd_image_find(&im, "bin0.R"), -1);
		if (conf.lwr.dense)
			assert_int_equal(result.models, (i < 2 ? 2 : 1) * W * H);
		assert_true(result.share > 0 && result.share <= 1);
		assert_true(fabs(result.share - mean_of(plane(&im, "model.centre"))) < 1e-6);
		assert_true(result.mean_radius > 0 && result.mean_radius <= conf.lwr.radius);
		assert_true(fabs(result.mean_features -
				 mean_of(plane(&im, "model.features"))) < 1e-3);
		assert_finite(&im);
		gd_image_free(&im);
	}
}

static void test_sequence(void **state)
{
	struct gd_denoise_conf conf = GD_DENOISE_DEFAULTS;
	struct gd_denoise_result result;
	struct gd_image first = { 0 }, im = { 0 }, other = { 0 };
	struct gd_err err = { 0 };

	(void)state;
	conf.method = GD_DENOISE_LWR;
	conf.sequence = true;
	frame(&first, "half", 2);
	assert_int_equal(gd_denoise_want(&first, &conf, &err), GD_ESHAPE);
	assert_string_equal(err.text,
			    "no layer P: frames of a sequence are joined by world positions");
	positions(&first);
	assert_int_equal(gd_denoise_run(&first, &conf, &result, NULL, NULL), GD_OK);
	assert_true(off(plane(&first, "R"), plane(&first, "state.value.R")) < 1e-5);
	assert_int_equal(gd_image_find(&first, "P.X"), -1);

	conf.previous = &first;
	conf.keep = true;
	conf.features = "P,albedo";
	frame(&im, "half", 2);
	positions(&im);
	gd_row(plane(&im, "P.X"), 7)[9] = NAN;
	assert_int_equal(gd_denoise_run(&im, &conf, &result, NULL, NULL), GD_OK);
	assert_true(result.followed > 0.9 && result.mean_frames > 1.8);
	assert_true(isnan(gd_row(plane(&im, "P.X"), 7)[9]));	/* as it was read */
	assert_true(gd_row(plane(&im, "P.Y"), 7)[9] == 7);

	gd_image_init(&other, 2, 2);
	conf.previous = &other;
	err = (struct gd_err){ 0 };
	assert_int_equal(run(&im, &conf, &err), GD_ESHAPE);
	conf.layers = "light";
	add(&im, "light", 3, 1, 0, 5);
	assert_int_equal(gd_denoise_want(&im, &conf, NULL), GD_EARG);
	gd_image_free(&first);
	gd_image_free(&im);
	gd_image_free(&other);
}

/* Of a neighbour only what is used is read; one that lacks it is refused. */
static void test_neighbours(void **state)
{
	struct gd_denoise_conf conf = GD_DENOISE_DEFAULTS;
	struct gd_image im = { 0 }, other[2] = { { 0 } };
	struct gd_err err = { 0 };

	(void)state;
	conf.neighbour = other;
	conf.nneighbour = 2;
	conf.keep = true;
	frame(&im, "bin", 3);
	positions(&im);
	gd_row(plane(&im, "Z"), 3)[4] = 1e9f;
	for (int i = 0; i < 2; i++) {
		frame(&other[i], i ? "half" : "bin", i ? 2 : 4);
		add(&other[i], "ao", 1, 1, 0, 3);
		gd_row(plane(&other[i], "albedo.R"), 2)[2] = NAN;
	}
	positions(&other[0]);
	for (int i = 0; i < 2; i++) {
		assert_int_equal(gd_denoise_want_neighbour(&other[i], &im, &conf, &err), GD_OK);
		assert_int_equal(other[i].chan[gd_image_find(&other[i], "ao")].want, GD_DROP);
		assert_int_equal(other[i].chan[gd_image_find(&other[i], "Z")].want, GD_READ);
	}
	assert_int_equal(other[0].chan[gd_image_find(&other[0], "P.Y")].want, GD_READ);
	assert_int_equal(run(&im, &conf, &err), GD_OK);
	assert_true(gd_row(plane(&im, "Z"), 3)[4] == 1e9f);
	assert_finite(&im);
	for (int i = 0; i < 2; i++)
		gd_image_free(&other[i]);

	frame(&other[0], "half", 2);
	gd_image_drop(&other[0], "Z");
	assert_int_equal(gd_denoise_want_neighbour(&other[0], &im, &conf, &err), GD_ESHAPE);
	assert_string_equal(err.text, "no layer Z, which the frame to denoise has");
	add(&other[0], "Z", 3, 4, 0, 1);
	err = (struct gd_err){ 0 };
	assert_int_equal(gd_denoise_want_neighbour(&other[0], &im, &conf, &err), GD_ESHAPE);
	assert_string_equal(err.text, "layer Z has 3 channels, expected 1");
	gd_image_free(&other[0]);
	frame(&other[0], "half", 2);
	gd_image_drop(&other[0], "half1.G");
	err = (struct gd_err){ 0 };
	assert_int_equal(gd_denoise_want_neighbour(&other[0], &im, &conf, &err), GD_ESHAPE);
	assert_string_equal(err.text, "no halves and no bins, which the frame to denoise has");
	gd_image_init(&other[1], W, H + 1);
	err = (struct gd_err){ 0 };
	assert_int_equal(gd_denoise_want_neighbour(&other[1], &im, &conf, &err), GD_ESHAPE);
	assert_string_equal(err.text, "33 x 22 pixels, expected 33 x 21");
	gd_image_free(&im);
	gd_image_free(&other[0]);
	gd_image_free(&other[1]);
}

/* The counts that a cross-fitted method gets. */
static void counts(struct gd_image *im, struct gd_crossfit_in *in, float at[2])
{
	struct gd_denoise_conf conf = GD_DENOISE_DEFAULTS;
	struct denoise_job job = { .im = im, .conf = &conf, .keep = true };
	struct gd_apr_frame *f = gd_calloc(1, sizeof *f);
	struct gd_plane (*bin)[3] = gd_calloc(GD_MAX_BINS, sizeof *bin);
	float *made[3] = { 0 };
	size_t mended = 0;

	*in = (struct gd_crossfit_in){ 0 };
	assert_int_equal(gd_denoise_choose(&job, NULL), GD_OK);
	assert_int_equal(gd_denoise_frame(&job, f, bin, NULL), GD_OK);
	assert_int_equal(gd_denoise_halves(&job, f, in, made, &mended, NULL, NULL), GD_OK);
	for (int h = 0; h < 2; h++)
		at[h] = in->count[h].v ? gd_row(in->count[h], 2)[8] : -1;
	for (int c = 0; c < 3; c++)
		free(made[c]);
	free(f);
	free(bin);
	gd_denoise_free(&job);
}

static void test_counts(void **state)
{
	struct gd_crossfit_in *in = gd_calloc(1, sizeof *in);
	struct gd_image im = { 0 };
	float at[2];

	(void)state;
	frame(&im, "bin", 3);
	counts(&im, in, at);
	assert_true(at[0] < 0 && at[1] < 0);
	add(&im, "samples", 1, 5, 0, 1);		/* 5 + x / 8 */
	counts(&im, in, at);
	assert_true(fabsf(at[0] - 4) < 1e-5f && fabsf(at[1] - 2) < 1e-5f);
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++)
			gd_row(plane(&im, "samples"), y)[x] = 16;
	counts(&im, in, at);
	assert_true(at[0] < 0 && at[1] < 0);
	add(&im, "half0.samples", 1, 1, 0, 1);
	add(&im, "half1.samples", 1, 7, 0, 1);
	gd_row(plane(&im, "half1.samples"), 2)[8] = NAN;
	counts(&im, in, at);
	assert_true(at[0] == 2 && at[1] == 0);
	gd_image_free(&im);
	free(in);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_missing), cmocka_unit_test(test_refused),
		cmocka_unit_test(test_too_many_features), cmocka_unit_test(test_bins_as_halves),
		cmocka_unit_test(test_odd_bins), cmocka_unit_test(test_keep_and_drop),
		cmocka_unit_test(test_named_often),
		cmocka_unit_test(test_look_alikes), cmocka_unit_test(test_no_numbers),
		cmocka_unit_test(test_linear), cmocka_unit_test(test_sequence),
		cmocka_unit_test(test_neighbours), cmocka_unit_test(test_counts),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
