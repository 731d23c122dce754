/* SPDX-License-Identifier: BSD-3-Clause */
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

#define SUFFIX "RGB"

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

/* The image behind it all: blocks and a ramp. */
static double truth(int x, int y, int c)
{
	return (x / 11 + y / 8) % 3 + 0.03 * (c + 1) * x;
}

struct scene {
	int w, h, bins;
	double sd, scale;	/* of the noise of a bin's gradient, and of all values */
	bool transposed;
};

static void plane_of(struct gd_image *im, const char *layer, int c, struct gd_plane *p)
{
	char name[64];
	struct gd_err err = { 0 };

	snprintf(name, sizeof name, "%s%s%c", layer, *layer ? "." : "", SUFFIX[c]);
	if (gd_image_add(im, name, p, &err) != GD_OK)
		fail_msg("%s", err.text);
}

/* One bin, or (bin = -1) what the means would be without noise. */
static void fill_set(struct gd_image *im, const struct scene *s, const char *colour, const char *dx,
		     const char *dy, int bin)
{
	const double sd = bin < 0 ? 0.0 : s->sd;

	for (int c = 0; c < 3; c++) {
		struct gd_plane p, gx, gy;

		plane_of(im, colour, c, &p);
		plane_of(im, s->transposed ? dy : dx, c, &gx);
		plane_of(im, s->transposed ? dx : dy, c, &gy);
		for (int y = 0; y < s->h; y++)
			for (int x = 0; x < s->w; x++) {
				double u = truth(x, y, c) + 3.0 * sd * noise(x, y, c, 3 * bin);
				double a = truth(x + 1, y, c) - truth(x, y, c) +
					   sd * noise(x, y, c, 3 * bin + 1);
				double b = truth(x, y + 1, c) - truth(x, y, c) +
					   sd * noise(x, y, c, 3 * bin + 2);
				int i = s->transposed ? y : x, j = s->transposed ? x : y;

				gd_row(p, j)[i] = (float)(s->scale * u);
				gd_row(gx, j)[i] = (float)(x + 1 < s->w ? s->scale * a : 0.0);
				gd_row(gy, j)[i] = (float)(y + 1 < s->h ? s->scale * b : 0.0);
			}
	}
}

static void make(struct gd_image *im, const struct scene *s)
{
	char colour[32], dx[32], dy[32];

	gd_image_init(im, s->transposed ? s->h : s->w, s->transposed ? s->w : s->h);
	fill_set(im, s, "", "dx", "dy", -1);
	for (int b = 0; b < s->bins; b++) {
		snprintf(colour, sizeof colour, "bin%d", b);
		snprintf(dx, sizeof dx, "bin%d.dx", b);
		snprintf(dy, sizeof dy, "bin%d.dy", b);
		fill_set(im, s, colour, dx, dy, b);
	}
}

static struct gd_feature_result run(struct gd_image *im, const struct gd_feature_conf *conf)
{
	struct gd_feature_result res;
	struct gd_err err = { 0 };

	if (gd_feature_want(im, conf, &err) != GD_OK ||
	    gd_feature_run(im, conf, &res, NULL, &err) != GD_OK)
		fail_msg("%s", err.text);
	return res;
}

static struct gd_plane plane(const struct gd_image *im, const char *name)
{
	struct gd_plane p;

	if (!gd_image_plane(im, name, &p))
		fail_msg("no channel %s", name);
	return p;
}

static void close_to(const char *what, int x, int y, double found, double wanted, double tolerance)
{
	if (!(fabs(found - wanted) <= tolerance))
		fail_msg("%s at (%d, %d): %.9g, expected %.9g (+- %.3g)", what, x, y, found, wanted,
			 tolerance);
}

static void all_finite(const struct gd_image *im)
{
	for (int i = 0; i < im->nchan; i++) {
		const char *name = im->chan[i].name;
		struct gd_plane p = plane(im, name);

		if (!strstr(name, "feature") && strncmp(name, "half", 4))
			continue;
		for (int y = 0; y < p.h; y++)
			for (int x = 0; x < p.w; x++) {
				float v = gd_row(p, y)[x];

				if (!isfinite(v) || (strstr(name, "variance") && v < 0.0f))
					fail_msg("%s at (%d, %d): %g", name, x, y, v);
			}
	}
}

static const char *const layers[] = { "feature", "half0.feature", "half1.feature" };

static void exact_gradients_give_the_image(void **unused)
{
	struct scene s = { .w = 45, .h = 31, .bins = 4, .sd = 0.0, .scale = 1.0 };
	struct gd_feature_conf conf = GD_FEATURE_DEFAULTS;
	struct gd_image im;

	(void)unused;
	for (int solve = 0; solve < 2; solve++) {
		make(&im, &s);
		conf.solve = (enum gd_feature_solve)solve;
		run(&im, &conf);
		for (int i = 0; i < 3; i++)
			for (int c = 0; c < 3; c++) {
				char name[64];
				struct gd_plane p;

				snprintf(name, sizeof name, "%s.%c", layers[i], SUFFIX[c]);
				p = plane(&im, name);
				for (int y = 0; y < s.h; y++)
					for (int x = 0; x < s.w; x++)
						close_to(name, x, y, gd_row(p, y)[x],
							 truth(x, y, c), 1e-3);
			}
		gd_image_free(&im);
	}
}

/* Squared error of a layer after its mean has been set right. */
static double error_of(const struct gd_image *im, const char *layer, const struct scene *s)
{
	double sum = 0.0;

	for (int c = 0; c < 3; c++) {
		char name[64];
		struct gd_plane p;
		double mean = 0.0, square = 0.0, n = (double)s->w * s->h;

		snprintf(name, sizeof name, "%s.%c", layer, SUFFIX[c]);
		p = plane(im, name);
		for (int y = 0; y < s->h; y++)
			for (int x = 0; x < s->w; x++) {
				double d = gd_row(p, y)[x] - truth(x, y, c);

				mean += d / n;
				square += d * d / n;
			}
		sum += square - mean * mean;
	}
	return sum / 3.0;
}

static void noise_falls_from_halves_to_whole_to_filtered(void **unused)
{
	struct scene s = { .w = 88, .h = 64, .bins = 8, .sd = 0.4, .scale = 1.0 };
	struct gd_feature_conf conf = GD_FEATURE_DEFAULTS;
	struct gd_image im;
	double raw[3];

	(void)unused;
	conf.filter = false;
	make(&im, &s);
	assert_false(run(&im, &conf).filtered);
	for (int i = 0; i < 3; i++)
		raw[i] = error_of(&im, layers[i], &s);
	gd_image_free(&im);
	if (!(raw[0] < 0.8 * (raw[1] + raw[2]) / 2.0))
		fail_msg("errors: whole %g, halves %g and %g", raw[0], raw[1], raw[2]);
	conf.filter = true;
	make(&im, &s);
	assert_true(run(&im, &conf).filtered);
	for (int i = 0; i < 3; i++)
		if (!(error_of(&im, layers[i], &s) < 0.95 * raw[i]))
			fail_msg("%s: error %g filtered, %g before", layers[i],
				 error_of(&im, layers[i], &s), raw[i]);
	gd_image_free(&im);
}

/* The half of the even bins must not change with the odd ones, unless by the filter's weights. */
static void halves_are_independent(void **unused)
{
	struct scene s = { .w = 40, .h = 30, .bins = 6, .sd = 0.2, .scale = 1.0 };
	struct gd_feature_conf conf = GD_FEATURE_DEFAULTS;
	struct gd_image a, b;

	(void)unused;
	conf.filter = false;
	make(&a, &s);
	make(&b, &s);
	for (int i = 0; i < b.nchan; i++)
		if (!strncmp(b.chan[i].name, "bin3.", 5))
			for (int y = 0; y < s.h; y++)
				for (int x = 0; x < s.w; x++)
					gd_row(plane(&b, b.chan[i].name), y)[x] += 5.0f;
	run(&a, &conf);
	run(&b, &conf);
	for (int y = 0; y < s.h; y++) {
		const size_t row = (size_t)s.w * sizeof(float);

		assert_memory_equal(gd_row(plane(&a, "half0.feature.R"), y),
				    gd_row(plane(&b, "half0.feature.R"), y), row);
		assert_memory_equal(gd_row(plane(&a, "half0.R"), y),
				    gd_row(plane(&b, "half0.R"), y), row);
	}
	gd_image_free(&b);
	gd_image_free(&a);
}

static void colour_halves_have_mean_and_variance_of_their_bins(void **unused)
{
	struct scene s = { .w = 13, .h = 9, .bins = 5, .sd = 0.3, .scale = 1.0 };
	struct gd_feature_conf conf = GD_FEATURE_DEFAULTS;
	struct gd_image im;

	(void)unused;
	make(&im, &s);
	gd_row(plane(&im, "bin1.G"), 4)[6] = NAN;
	run(&im, &conf);
	for (int y = 0; y < s.h; y++)
		for (int x = 0; x < s.w; x++) {
			double b[5], mean, var;

			for (int i = 0; i < 5; i++) {
				char name[16];

				snprintf(name, sizeof name, "bin%d.G", i);
				b[i] = gd_row(plane(&im, name), y)[x];
			}
			mean = (b[0] + b[2] + b[4]) / 3.0;
			var = (pow(b[0] - mean, 2) + pow(b[2] - mean, 2) + pow(b[4] - mean, 2)) /
			      6.0;
			close_to("half0", x, y, gd_row(plane(&im, "half0.G"), y)[x], mean, 1e-5);
			close_to("half0.variance", x, y,
				 gd_row(plane(&im, "half0.variance.G"), y)[x], var, 1e-5);
			if (x == 6 && y == 4)	/* one bin is left in this half */
				mean = b[3];
			else
				mean = (b[1] + b[3]) / 2.0;
			close_to("half1", x, y, gd_row(plane(&im, "half1.G"), y)[x], mean, 1e-5);
		}
	gd_image_free(&im);
}

static void few_bins(void **unused)
{
	struct gd_feature_conf conf = GD_FEATURE_DEFAULTS;

	(void)unused;
	for (int bins = 0; bins <= 3; bins++) {
		struct scene s = { .w = 37, .h = 29, .bins = bins, .sd = 0.2, .scale = 1.0 };
		struct gd_feature_result res;
		struct gd_image im;

		make(&im, &s);
		res = run(&im, &conf);
		assert_int_equal(res.bins, bins < 2 ? 0 : bins);
		assert_int_equal(res.halves, bins >= 2);
		assert_int_equal(res.bagged, bins >= 2);
		all_finite(&im);
		if (!(error_of(&im, "feature", &s) < 0.05))
			fail_msg("%d bins: error %g", bins, error_of(&im, "feature", &s));
		gd_image_free(&im);
	}
}

static void scale_goes_through(void **unused)
{
	struct scene s = { .w = 50, .h = 33, .bins = 4, .sd = 0.2, .scale = 1.0 };
	const double scale[] = { 1e-12, 1024.0, 3e10 };
	struct gd_feature_conf conf = GD_FEATURE_DEFAULTS;
	struct gd_image a, b;

	(void)unused;
	make(&a, &s);
	run(&a, &conf);
	for (int k = 0; k < 3; k++) {
		s.scale = scale[k];
		make(&b, &s);
		run(&b, &conf);
		for (int i = 0; i < 3; i++) {
			char name[64];

			snprintf(name, sizeof name, "%s.G", layers[i]);
			for (int y = 0; y < s.h; y++)
				for (int x = 0; x < s.w; x++)
					close_to(name, x, y,
						 gd_row(plane(&b, name), y)[x] / scale[k],
						 gd_row(plane(&a, name), y)[x], 5e-3);
		}
		gd_image_free(&b);
	}
	gd_image_free(&a);
}

/* Without draws, which go by pixel, rows and columns are alike. */
static void transpose_goes_through(void **unused)
{
	struct scene s = { .w = 47, .h = 30, .bins = 4, .sd = 0.2, .scale = 1.0 };
	struct gd_feature_conf conf = GD_FEATURE_DEFAULTS;
	struct gd_image a, b;

	(void)unused;
	conf.bagging = false;
	make(&a, &s);
	s.transposed = true;
	make(&b, &s);
	run(&a, &conf);
	run(&b, &conf);
	for (int i = 0; i < 3; i++) {
		char name[64];

		snprintf(name, sizeof name, "%s.B", layers[i]);
		for (int y = 0; y < s.h; y++)
			for (int x = 0; x < s.w; x++)
				close_to(name, x, y, gd_row(plane(&b, name), x)[y],
					 gd_row(plane(&a, name), y)[x], 5e-3);
	}
	gd_image_free(&b);
	gd_image_free(&a);
}

static void threads_do_not_matter(void **unused)
{
	struct scene s = { .w = 150, .h = 70, .bins = 4, .sd = 0.2, .scale = 1.0 };
	const int threads[] = { 1, 2, 7 }, before = omp_get_max_threads();
	struct gd_feature_conf conf = GD_FEATURE_DEFAULTS;
	struct gd_image im[3];

	(void)unused;
	for (int k = 0; k < 3; k++) {
		omp_set_num_threads(threads[k]);
		make(&im[k], &s);
		run(&im[k], &conf);
		assert_int_equal(im[k].nchan, im[0].nchan);
		for (int i = 0; i < im[0].nchan; i++)
			for (int y = 0; y < s.h; y++)
				assert_memory_equal(gd_row(plane(&im[k], im[0].chan[i].name), y),
						    gd_row(plane(&im[0], im[0].chan[i].name), y),
						    (size_t)s.w * sizeof(float));
	}
	omp_set_num_threads(before);
	for (int k = 0; k < 3; k++)
		gd_image_free(&im[k]);
}

static void hostile_pixels(void **unused)
{
	static const float evil[] = { NAN, INFINITY, -INFINITY, 1e30f, -1e30f, 3.4e38f, 1e-40f };
	struct scene s = { .w = 33, .h = 21, .bins = 4, .sd = 0.2, .scale = 1.0 };
	struct gd_feature_conf conf = GD_FEATURE_DEFAULTS;
	struct gd_image im;

	(void)unused;
	for (int k = 0; k < 7; k++) {
		make(&im, &s);
		for (int i = 0; i < im.nchan; i++) {	/* a pixel of each, a row of some */
			struct gd_plane p = plane(&im, im.chan[i].name);

			gd_row(p, (i * 5) % s.h)[(i * 7) % s.w] = evil[k];
			for (int x = 0; x < s.w && i % 5 == 0; x++)
				gd_row(p, i % s.h)[x] = evil[k];
		}
		run(&im, &conf);
		all_finite(&im);
		gd_image_free(&im);
	}
}

static void small_and_empty(void **unused)
{
	static const int size[][2] = { { 1, 1 }, { 1, 7 }, { 5, 1 }, { 2, 2 }, { 13, 3 } };
	struct gd_feature_conf conf = GD_FEATURE_DEFAULTS;
	struct gd_image im;

	(void)unused;
	for (int k = 0; k < 5; k++) {
		struct scene s = { .w = size[k][0], .h = size[k][1], .bins = 2 + k % 2,
				   .sd = 0.1, .scale = 1.0 };

		make(&im, &s);
		run(&im, &conf);
		all_finite(&im);
		gd_image_free(&im);
		s.scale = 0.0;		/* all black */
		make(&im, &s);
		run(&im, &conf);
		all_finite(&im);
		for (int y = 0; y < s.h; y++)
			for (int x = 0; x < s.w; x++)
				assert_true(gd_row(plane(&im, "feature.R"), y)[x] == 0.0f);
		gd_image_free(&im);
	}
}

static void wants_and_drops(void **unused)
{
	struct scene s = { .w = 8, .h = 6, .bins = 2, .sd = 0.1, .scale = 1.0 };
	struct gd_feature_conf conf = GD_FEATURE_DEFAULTS;
	struct gd_err err = { 0 };
	struct gd_image im;

	(void)unused;
	make(&im, &s);
	assert_int_equal(gd_feature_want(&im, &conf, &err), GD_OK);
	assert_int_equal(im.chan[gd_image_find(&im, "dx.R")].want, GD_DROP);
	assert_int_equal(im.chan[gd_image_find(&im, "bin1.dy.B")].want, GD_READ);
	assert_int_equal(im.chan[gd_image_find(&im, "bin0.G")].want, GD_READ);
	run(&im, &conf);
	assert_int_equal(gd_image_find(&im, "bin1.dy.B"), -1);
	assert_true(gd_image_find(&im, "bin1.B") >= 0);
	gd_image_free(&im);
	make(&im, &s);
	conf.keep = true;
	assert_int_equal(gd_feature_want(&im, &conf, &err), GD_OK);
	assert_int_equal(im.chan[gd_image_find(&im, "dx.R")].want, GD_PASS);
	gd_image_free(&im);
}

static void refusals(void **unused)
{
	struct scene s = { .w = 8, .h = 6, .bins = 0, .sd = 0.1, .scale = 1.0 };
	struct gd_feature_conf conf = GD_FEATURE_DEFAULTS;
	struct gd_err err = { 0 };
	struct gd_image im;

	(void)unused;
	make(&im, &s);
	gd_image_drop(&im, "dy.G");
	assert_int_equal(gd_feature_want(&im, &conf, &err), GD_ESHAPE);
	assert_string_equal(err.text, "no channel dy.G");
	conf.solve = GD_FEATURE_NONE;
	conf.layers = "albedo";
	err = (struct gd_err){ 0 };
	assert_int_equal(gd_feature_want(&im, &conf, &err), GD_ESHAPE);
	assert_non_null(strstr(err.text, "no channel albedo"));
	conf.layers = "";
	assert_int_equal(gd_feature_want(&im, &conf, NULL), GD_OK);
	gd_image_free(&im);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(exact_gradients_give_the_image),
		cmocka_unit_test(noise_falls_from_halves_to_whole_to_filtered),
		cmocka_unit_test(halves_are_independent),
		cmocka_unit_test(colour_halves_have_mean_and_variance_of_their_bins),
		cmocka_unit_test(few_bins),
		cmocka_unit_test(scale_goes_through),
		cmocka_unit_test(transpose_goes_through),
		cmocka_unit_test(threads_do_not_matter),
		cmocka_unit_test(hostile_pixels),
		cmocka_unit_test(small_and_empty),
		cmocka_unit_test(wants_and_drops),
		cmocka_unit_test(refusals),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
