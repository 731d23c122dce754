/* SPDX-License-Identifier: BSD-3-Clause */
/* Pictures: ranges, false colours, normals, sheets, letters. What needs the plug-in is in
 * test_plugin.c. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "font.h"
#include "show.h"

#define W 40
#define H 25

static struct gd_plane plane(int w, int h)
{
	float *v = gd_calloc((size_t)h * gd_stride(w), sizeof(float));

	assert_non_null(v);
	return gd_plane_of(v, w, h);
}

static const float *at(const struct gd_picture *pic, int x, int y)
{
	return pic->rgb + 3 * (y * pic->w + x);
}

static void assert_rgb(const float *found, float r, float g, float b)
{
	if (fabsf(found[0] - r) > 2e-3f || fabsf(found[1] - g) > 2e-3f ||
	    fabsf(found[2] - b) > 2e-3f)
		fail_msg("found %g %g %g, wanted %g %g %g", (double)found[0], (double)found[1],
			 (double)found[2], (double)r, (double)g, (double)b);
}

static double brightness(const float *rgb)
{
	return 0.2126 * pow(rgb[0], 2.2) + 0.7152 * pow(rgb[1], 2.2) + 0.0722 * pow(rgb[2], 2.2);
}

static void guesses(void **state)
{
	(void)state;
	assert_int_equal(gd_show_guess("", 3), GD_SHOW_COLOUR);
	assert_int_equal(gd_show_guess("albedo", 3), GD_SHOW_COLOUR);
	assert_int_equal(gd_show_guess("half0.feature", 3), GD_SHOW_COLOUR);
	assert_int_equal(gd_show_guess("Z", 1), GD_SHOW_SCALAR);
	assert_int_equal(gd_show_guess("Y", 1), GD_SHOW_COLOUR);
	assert_int_equal(gd_show_guess("N", 3), GD_SHOW_NORMAL);
	assert_int_equal(gd_show_guess("P", 3), GD_SHOW_POSITION);
	assert_int_equal(gd_show_guess("dx", 3), GD_SHOW_SIGNED);
	assert_int_equal(gd_show_guess("bin3.dy", 3), GD_SHOW_SIGNED);
	assert_int_equal(gd_show_guess("dx.R", 1), GD_SHOW_SIGNED);
	assert_int_equal(gd_show_guess("dx.variance", 3), GD_SHOW_SCALAR);
	assert_int_equal(gd_show_guess("variance", 3), GD_SHOW_SCALAR);
	assert_int_equal(gd_show_guess("error", 3), GD_SHOW_SCALAR);
	assert_int_equal(gd_show_guess("N.variance", 3), GD_SHOW_SCALAR);
	for (int i = 0; i < GD_SHOW_AS; i++) {
		enum gd_show_as as = GD_SHOW_AS;

		assert_true(gd_show_as_find(gd_show_as_name((enum gd_show_as)i), &as));
		assert_int_equal(as, i);
	}
}

/* 0, 1 .. 999, in any order, with a NaN and an infinity that do not count. */
static void ranges(void **state)
{
	struct gd_plane v = plane(W + 1, H);
	struct gd_show_range r;
	struct gd_err err = { 0 };

	(void)state;
	for (int i = 0; i < 1000; i++)
		gd_row(v, i * 7 % 1000 / W)[i * 7 % 1000 % W] = (float)i;
	for (int y = 0; y < H; y++)
		gd_row(v, y)[W] = y % 2 ? NAN : INFINITY;
	assert_int_equal(gd_show_range(&r, &v, 1, GD_SHOW_SCALAR, GD_SHOW_LINEAR, &err), GD_OK);
	assert_true(r.lo == 9 && r.hi == 989);
	assert_int_equal(gd_show_range(&r, &v, 1, GD_SHOW_SIGNED, GD_SHOW_LINEAR, &err), GD_OK);
	assert_true(r.lo == -989 && r.hi == 989);
	assert_int_equal(gd_show_range(&r, &v, 1, GD_SHOW_SCALAR, GD_SHOW_LOG, &err), GD_OK);
	assert_true(r.lo == 10 && r.hi == 990);
	free(v.v);
}

static void ranges_of_little(void **state)
{
	const float values[] = { 0, 1, -5, 1e30f, 1e-40f, NAN, INFINITY };

	(void)state;
	for (size_t i = 0; i < sizeof(values) / sizeof(*values); i++)
		for (int scale = 0; scale < 3; scale++)
			for (int s = GD_SHOW_SCALAR; s <= GD_SHOW_SIGNED; s++) {
				struct gd_plane v = plane(1, 1);
				struct gd_show_conf conf = { .as = (enum gd_show_as)s };
				struct gd_picture pic = { 0 };
				struct gd_err err = { 0 };

				v.v[0] = values[i];
				assert_int_equal(gd_show_range(&conf.range, &v, 1, conf.as,
							       (enum gd_show_scale)scale, &err),
						 GD_OK);
				assert_true(isfinite(conf.range.lo) && isfinite(conf.range.hi));
				assert_true(conf.range.hi > conf.range.lo);
				assert_int_equal(gd_show(&pic, NULL, &v, 1, &conf, &err), GD_OK);
				for (int c = 0; c < 3; c++)
					assert_true(pic.rgb[c] >= 0 && pic.rgb[c] <= 1);
				gd_picture_free(&pic);
				free(v.v);
			}
}

/* Brightness rises all along the map; its ends are nearly black and pale yellow. */
static void scalar_colours(void **state)
{
	struct gd_plane v = plane(256, 1);
	struct gd_show_conf conf = { .as = GD_SHOW_SCALAR, .range = { 0, 1, GD_SHOW_LINEAR } };
	struct gd_picture pic = { 0 }, root = { 0 };
	struct gd_err err = { 0 };

	(void)state;
	for (int x = 0; x < 256; x++)
		v.v[x] = (float)x / 255;
	assert_int_equal(gd_show(&pic, NULL, &v, 1, &conf, &err), GD_OK);
	for (int x = 1; x < 256; x++)
		assert_true(brightness(at(&pic, x, 0)) > brightness(at(&pic, x - 1, 0)));
	assert_rgb(at(&pic, 0, 0), 0.001f, 0, 0.014f);
	assert_rgb(at(&pic, 255, 0), 0.987f, 0.991f, 0.75f);
	conf.range.scale = GD_SHOW_SQRT;
	for (int x = 0; x < 256; x++)
		v.v[x] *= v.v[x];
	assert_int_equal(gd_show(&root, NULL, &v, 1, &conf, &err), GD_OK);
	for (int x = 0; x < 256; x++)
		assert_rgb(at(&root, x, 0), at(&pic, x, 0)[0], at(&pic, x, 0)[1],
			   at(&pic, x, 0)[2]);
	gd_picture_free(&pic);
	gd_picture_free(&root);
	free(v.v);
}

static void signed_colours(void **state)
{
	struct gd_plane v = plane(5, 1);
	struct gd_show_conf conf = { .as = GD_SHOW_SIGNED, .range = { -2, 2, GD_SHOW_LINEAR } };
	const float values[5] = { -9, -1, 0, 1, INFINITY };
	struct gd_picture pic = { 0 };
	struct gd_err err = { 0 };

	(void)state;
	memcpy(v.v, values, sizeof(values));
	assert_int_equal(gd_show(&pic, NULL, &v, 1, &conf, &err), GD_OK);
	assert_rgb(at(&pic, 0, 0), 0.02f, 0.188f, 0.38f);
	assert_true(at(&pic, 1, 0)[2] > at(&pic, 1, 0)[0]);
	assert_rgb(at(&pic, 2, 0), 0.97f, 0.97f, 0.97f);
	assert_true(at(&pic, 3, 0)[0] > at(&pic, 3, 0)[2]);
	assert_rgb(at(&pic, 4, 0), 0.404f, 0, 0.122f);
	gd_picture_free(&pic);
	free(v.v);
}

static void normals(void **state)
{
	struct gd_plane v[3] = { plane(3, 1), plane(3, 1), plane(3, 1) };
	struct gd_show_conf conf = { .as = GD_SHOW_NORMAL };
	struct gd_picture pic = { 0 };
	struct gd_err err = { 0 };
	size_t nan;

	(void)state;
	v[0].v[0] = 1;
	v[1].v[0] = -1;
	v[2].v[1] = 0.5f;
	v[1].v[2] = NAN;
	assert_int_equal(gd_show(&pic, &nan, v, 3, &conf, &err), GD_OK);
	assert_rgb(at(&pic, 0, 0), 1, 0, 0.5f);
	assert_rgb(at(&pic, 1, 0), 0.5f, 0.5f, 0.75f);
	assert_rgb(at(&pic, 2, 0), 1, 0, 1);
	assert_int_equal(nan, 1);
	gd_picture_free(&pic);
	assert_int_equal(gd_show(&pic, &nan, v, 1, &conf, &err), GD_ESHAPE);
	assert_null(pic.rgb);
	for (int c = 0; c < 3; c++)
		free(v[c].v);
}

static struct gd_picture solid(int w, int h, float grey)
{
	struct gd_picture pic = { .w = w,
				  .h = h,
				  .rgb = gd_calloc((size_t)w * (size_t)h, 3 * sizeof(float)) };

	assert_non_null(pic.rgb);
	for (int i = 0; i < 3 * w * h; i++)
		pic.rgb[i] = grey;
	return pic;
}

static void zooms(void **state)
{
	struct gd_picture pic = solid(3, 2, 0);
	struct gd_err err = { 0 };

	(void)state;
	for (int i = 0; i < 6; i++)
		pic.rgb[3 * i] = (float)i;
	assert_int_equal(gd_picture_zoom(&pic, 4, &err), GD_OK);
	assert_true(pic.w == 12 && pic.h == 8);
	for (int y = 0; y < 8; y++)
		for (int x = 0; x < 12; x++)
			assert_true(at(&pic, x, y)[0] == (float)(y / 4 * 3 + x / 4));
	assert_int_equal(gd_picture_zoom(&pic, 30000, &err), GD_ESHAPE);
	gd_picture_free(&pic);
}

/* Every letter has ink (but for the space), and no two are alike. */
static void letters(void **state)
{
	unsigned long long form[95] = { 0 };

	(void)state;
	for (int c = ' '; c <= '~'; c++) {
		for (int y = 0; y < GD_FONT_HEIGHT; y++)
			for (int x = 0; x < 5; x++)
				form[c - ' '] = form[c - ' '] << 1 | gd_font_pixel((char)c, x, y);
		assert_true((form[c - ' '] != 0) == (c != ' '));
		for (int d = ' '; d < c; d++)
			assert_true(form[d - ' '] != form[c - ' ']);
	}
	assert_int_equal(gd_font_pixel('\xff', 1, 0), gd_font_pixel('?', 1, 0));
}

/* Text beyond the picture is cut, not written elsewhere. */
static void text_at_the_border(void **state)
{
	struct gd_picture pic = solid(20, 12, 0);

	(void)state;
	gd_picture_text(&pic, -8, -3, 3, "Wxyz");
	gd_picture_text(&pic, 15, 8, 2, "Wxyz");
	gd_picture_free(&pic);
}

static void sheets(void **state)
{
	struct gd_picture pic[3] = { solid(30, 20, 0.25f), solid(10, 40, 0.5f),
				     solid(30, 40, 0.75f) },
			  sheet = { 0 };
	const char *label[3] = { "one", NULL,
				 "a label that is far too long for so small a picture" };
	struct gd_err err = { 0 };

	(void)state;
	assert_int_equal(gd_picture_sheet(&sheet, pic, label, 3, 2, &err), GD_OK);
	assert_true(sheet.w == 3 + 2 * 33 && sheet.h == 3 + 2 * (40 + 12 + 3));
	assert_rgb(at(&sheet, 3, 3), 0.25f, 0.25f, 0.25f);
	assert_rgb(at(&sheet, 32, 22), 0.25f, 0.25f, 0.25f);
	assert_rgb(at(&sheet, 32, 23), 0.13f, 0.13f, 0.13f);
	assert_rgb(at(&sheet, 36, 3), 0.5f, 0.5f, 0.5f);
	assert_rgb(at(&sheet, 3, 58), 0.75f, 0.75f, 0.75f);
	gd_picture_free(&sheet);
	assert_int_equal(gd_picture_sheet(&sheet, pic, NULL, 3, 9, &err), GD_OK);
	assert_true(sheet.w == 3 + 3 * 33 && sheet.h == 46);
	gd_picture_free(&sheet);
	for (int i = 0; i < 3; i++)
		gd_picture_free(&pic[i]);
}

static void legends(void **state)
{
	struct gd_picture pic = solid(100, 10, 0.5f);
	struct gd_show_conf conf = { .as = GD_SHOW_SCALAR, .range = { 0, 2, GD_SHOW_LOG } };
	struct gd_err err = { 0 };

	(void)state;
	assert_int_equal(gd_picture_legend(&pic, &conf, &err), GD_OK);
	assert_true(pic.w == 100 && pic.h == 10 + 6 + 12);
	assert_rgb(at(&pic, 50, 9), 0.5f, 0.5f, 0.5f);
	assert_rgb(at(&pic, 0, 10), 0.001f, 0, 0.014f);
	assert_rgb(at(&pic, 99, 15), 0.987f, 0.991f, 0.75f);
	gd_picture_free(&pic);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(guesses),
		cmocka_unit_test(ranges),
		cmocka_unit_test(ranges_of_little),
		cmocka_unit_test(scalar_colours),
		cmocka_unit_test(signed_colours),
		cmocka_unit_test(normals),
		cmocka_unit_test(zooms),
		cmocka_unit_test(letters),
		cmocka_unit_test(text_at_the_border),
		cmocka_unit_test(sheets),
		cmocka_unit_test(legends),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
