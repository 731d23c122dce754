/* SPDX-License-Identifier: BSD-3-Clause */
/* The weight of the colour from an image's channels: which are used, and what is made of them. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>

#include <cmocka.h>

#include "../support/poisson_case.h"
#include "alpha.h"
#include "buffers.h"

#define W 40
#define H 30

static const char *const layers[] = { "", "dx", "dy" };

static double truth(int x, int y)
{
	return 1 + 0.4 * sin(0.2 * x) * cos(0.15 * y);
}

static double layer_truth(int l, int x, int y)
{
	if (l == 0)
		return truth(x, y);
	return truth(x + (l == 1), y + (l == 2)) - truth(x, y);
}

static struct gd_plane add(struct gd_image *im, const char *prefix, const char *layer, char c)
{
	const bool dot = *prefix && *layer, end = *prefix || *layer;
	struct gd_plane p;
	char name[64];

	snprintf(name, sizeof(name), "%s%s%s%s%c", prefix, dot ? "." : "", layer, end ? "." : "", c);
	assert_int_equal(gd_image_add(im, name, &p, NULL), GD_OK);
	return p;
}

/* Bins with noise of their own in each channel, and their means. */
static struct gd_image image_new(int bins, double colour, double gradient)
{
	struct noise n = { 7 };
	struct gd_image im;

	gd_image_init(&im, W, H);
	for (int l = 0; l < 3; l++)
		for (const char *c = "RGB"; *c; c++) {
			struct gd_plane mean = add(&im, "", layers[l], *c);

			for (int b = 0; b < bins; b++) {
				struct gd_plane bin;
				char prefix[16];

				snprintf(prefix, sizeof(prefix), "bin%d", b);
				bin = add(&im, prefix, layers[l], *c);
				for (int y = 0; y < H; y++)
					for (int x = 0; x < W; x++) {
						const double sd = l ? gradient : colour;

						gd_row(bin, y)[x] = (float)(layer_truth(l, x, y) +
									    sd * normal(&n));
						gd_row(mean, y)[x] += gd_row(bin, y)[x] / (float)bins;
					}
			}
		}
	return im;
}

static struct gd_alpha alpha_of(const struct gd_image *im)
{
	struct gd_alpha alpha;
	struct gd_err err = { 0 };

	if (gd_alpha_of_image(&alpha, im, NULL, 1e-4, NULL, &err) != GD_OK)
		fail_msg("%s", err.text);
	return alpha;
}

static void drop(struct gd_image *im, const char *name)
{
	assert_true(gd_image_find(im, name) >= 0);
	gd_image_drop(im, name);
}

/* A channel becomes one that passes, as type has it. */
static void pack(struct gd_channel *chan, enum gd_type type)
{
	const size_t bytes = type == GD_HALF ? 2 : 4;

	chan->raw = gd_alloc((size_t)W * H, bytes);
	for (size_t i = 0; i < (size_t)W * H; i++) {
		const float v = chan->v[i / W * gd_stride(W) + i % W];
		const uint32_t whole = (uint32_t)v;
		uint32_t bits;
		uint16_t half;

		memcpy(&bits, &v, sizeof(bits));
		half = v == 0 ? 0 : (uint16_t)((bits >> 16 & 0x8000) | ((bits >> 13 & 0x3ffff) - 0x1c000));
		memcpy(chan->raw + i * bytes,
		       type == GD_HALF ? (const void *)&half : type == GD_UINT ? (const void *)&whole : &v,
		       bytes);
	}
	free(chan->v);
	chan->v = NULL;
	chan->type = type;
	chan->want = GD_PASS;
}

static void test_channels_that_pass_tell_as_much(void **state)
{
	struct gd_image im = image_new(5, 0.3, 0.2);
	struct gd_alpha before;

	(void)state;
	for (int i = 0; i < im.nchan; i++) {	/* values that a half holds, too; all of bin3 whole */
		if (strncmp(im.chan[i].name, "bin", 3))
			continue;
		for (size_t k = 0; k < H * gd_stride(W); k++) {
			const float v = im.chan[i].v[k];

			im.chan[i].v[k] = im.chan[i].name[3] == '3' ? (float)fmax(0, rint((double)v))
								    : rintf(64 * v) / 64;
		}
	}
	before = alpha_of(&im);
	assert_int_equal(before.source, GD_ALPHA_HALVES);
	for (int i = 0; i < im.nchan; i++)
		if (!strncmp(im.chan[i].name, "bin", 3))
			pack(&im.chan[i], im.chan[i].name[3] == '3'    ? GD_UINT
					  : im.chan[i].name[3] == '1' ? GD_FLOAT
								      : GD_HALF);
	assert_true(alpha_of(&im).value == before.value);
	gd_image_free(&im);
}

/* Even and odd bins are the halves: the same weight, with as many bins in each. */
static void test_halves_are_the_even_and_the_odd_bins(void **state)
{
	struct gd_image im = image_new(4, 0.3, 0.2);
	const double before = alpha_of(&im).value;

	(void)state;
	assert_true(fabs(log(before / (0.2 / 0.3))) < 0.35);
	for (int l = 0; l < 3; l++)
		for (const char *c = "RGB"; *c; c++)
			for (int h = 0; h < 2; h++) {
				char prefix[16], name[64];
				struct gd_plane half, bin;

				snprintf(prefix, sizeof(prefix), "half%d", h);
				half = add(&im, prefix, layers[l], *c);
				for (int b = h; b < 4; b += 2) {
					snprintf(name, sizeof(name), "bin%d.%s%s%c", b, layers[l],
						 l ? "." : "", *c);
					assert_true(gd_image_plane(&im, name, &bin));
					for (int y = 0; y < H; y++)
						for (int x = 0; x < W; x++)
							gd_row(half, y)[x] += gd_row(bin, y)[x] / 2;
				}
			}
	drop(&im, "bin2.dx.G");
	assert_int_equal(alpha_of(&im).source, GD_ALPHA_HALVES);
	assert_true(fabs(alpha_of(&im).value - before) < 1.5e-3);
	drop(&im, "half1.B");
	assert_int_equal(alpha_of(&im).source, GD_ALPHA_NONE);
	gd_image_free(&im);
}

static void test_what_is_not_complete_is_not_used(void **state)
{
	struct gd_image im = image_new(2, 0.3, 0.1);
	char name[64];

	(void)state;
	assert_int_equal(alpha_of(&im).source, GD_ALPHA_HALVES);
	drop(&im, "bin1.dy.R");
	assert_int_equal(alpha_of(&im).source, GD_ALPHA_NONE);
	assert_true(alpha_of(&im).value == GD_ALPHA_PUBLISHED);
	for (int l = 0; l < 3; l++)
		for (const char *c = "RGB"; *c; c++) {
			struct gd_plane p;

			snprintf(name, sizeof(name), "%s%svariance.%c", layers[l], l ? "." : "", *c);
			assert_int_equal(gd_image_add(&im, name, &p, NULL), GD_OK);
			for (int y = 0; y < H; y++)
				for (int x = 0; x < W; x++)
					gd_row(p, y)[x] = l ? 0.01F : 0.09F;
		}
	assert_int_equal(alpha_of(&im).source, GD_ALPHA_VARIANCES);
	assert_true(fabs(alpha_of(&im).value - 0.7 / 3) < 1.5e-3);
	drop(&im, "dy.variance.B");
	assert_int_equal(alpha_of(&im).source, GD_ALPHA_NONE);
	gd_image_free(&im);
}

static void test_only_what_is_needed_is_kept(void **state)
{
	struct gd_image im = image_new(3, 0.1, 0.1);
	struct gd_plane p;

	(void)state;
	assert_int_equal(gd_image_add(&im, "bin0.albedo.R", &p, NULL), GD_OK);
	assert_int_equal(gd_image_add(&im, "variance.R", &p, NULL), GD_OK);
	for (int i = 0; i < im.nchan; i++)
		im.chan[i].want = strncmp(im.chan[i].name, "dx", 2) ? GD_DROP : GD_READ;
	assert_int_equal(gd_alpha_want(&im, false), GD_ALPHA_HALVES);
	assert_int_equal(im.chan[gd_image_find(&im, "bin2.dy.G")].want, GD_PASS);
	assert_int_equal(im.chan[gd_image_find(&im, "bin0.B")].want, GD_PASS);
	assert_int_equal(im.chan[gd_image_find(&im, "dx.R")].want, GD_READ);
	assert_int_equal(im.chan[gd_image_find(&im, "bin0.albedo.R")].want, GD_DROP);
	assert_int_equal(im.chan[gd_image_find(&im, "variance.R")].want, GD_DROP);
	assert_int_equal(gd_alpha_want(&im, true), GD_ALPHA_NONE);
	gd_image_free(&im);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_channels_that_pass_tell_as_much),
		cmocka_unit_test(test_halves_are_the_even_and_the_odd_bins),
		cmocka_unit_test(test_what_is_not_complete_is_not_used),
		cmocka_unit_test(test_only_what_is_needed_is_kept),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
