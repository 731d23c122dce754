/* SPDX-License-Identifier: BSD-3-Clause */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "image.h"

static void test_empty(void **state)
{
	struct gd_image im = { 0 };
	struct gd_plane p;

	(void)state;
	assert_int_equal(gd_image_find(&im, "R"), -1);
	assert_false(gd_image_plane(&im, "R", &p));
	assert_null(gd_attr_find(&im, "owner"));
	gd_image_drop(&im, "R");
	gd_image_free(&im);
	gd_image_free(&im);
}

static void test_channels(void **state)
{
	struct gd_err err = { 0 };
	struct gd_plane p, q;
	struct gd_image im;

	(void)state;
	gd_image_init(&im, 17, 5);
	assert_int_equal(im.data.x1, 16);
	assert_int_equal(im.display.y1, 4);
	assert_int_equal(gd_image_add(&im, "a.R", &p, &err), GD_OK);
	assert_int_equal(gd_image_add(&im, "a.G", &q, &err), GD_OK);
	for (int y = 0; y < 5; y++)
		for (size_t x = 0; x < p.stride; x++)
			assert_true(gd_row(p, y)[x] == 0);
	assert_true((uintptr_t)p.v % 64 == 0 && p.stride >= 17 && p.stride % 16 == 0);
	gd_row(p, 4)[16] = 3;
	assert_int_equal(gd_image_add(&im, "a.R", &p, &err), GD_OK);	/* replaced, zero again */
	assert_true(gd_row(p, 4)[16] == 0);
	assert_int_equal(im.nchan, 2);
	assert_int_equal(gd_image_find(&im, "a.G"), 1);
	assert_int_equal(gd_image_find(&im, "a."), -1);
	assert_true(gd_image_plane(&im, "a.G", &p) && p.v == q.v && p.w == 17 && p.h == 5);
	gd_image_drop(&im, im.chan[0].name);	/* by its own name */
	assert_int_equal(im.nchan, 1);
	assert_int_equal(gd_image_find(&im, "a.G"), 0);
	assert_int_equal(gd_image_append(&im, "id", GD_UINT, &err), GD_OK);
	assert_false(gd_image_plane(&im, "id", &p));	/* has no pixels */
	gd_image_free(&im);
}

static bool starts(const char *name, void *user)
{
	return strncmp(name, user, strlen(user)) == 0;
}

static void test_drop_if(void **state)
{
	static const char *const name[] = { "bin0.R", "R", "bin1.R", "G", "bin2.R" };
	struct gd_err err = { 0 };
	char bin[] = "bin";
	struct gd_image im;

	(void)state;
	gd_image_init(&im, 1, 1);
	for (int i = 0; i < 5; i++)
		assert_int_equal(gd_image_add(&im, name[i], NULL, &err), GD_OK);
	gd_image_drop_if(&im, starts, bin);
	assert_int_equal(im.nchan, 2);
	assert_string_equal(im.chan[0].name, "R");
	assert_string_equal(im.chan[1].name, "G");
	gd_image_free(&im);
}

static void test_attributes(void **state)
{
	struct gd_err err = { 0 };
	struct gd_image im = { 0 }, to = { 0 };
	char text[16];
	double v;

	(void)state;
	assert_int_equal(gd_attr_set_string(&im, "owner", "someone with a long name", &err), GD_OK);
	assert_true(gd_attr_string(&im, "owner", text, sizeof text));
	assert_string_equal(text, "someone with a ");
	assert_false(gd_attr_number(&im, "owner", &v));
	assert_int_equal(gd_attr_set_int(&im, "n", -7, &err), GD_OK);
	assert_true(gd_attr_number(&im, "n", &v) && v == -7);
	assert_false(gd_attr_string(&im, "n", text, sizeof text));
	assert_int_equal(gd_attr_set_number(&im, "n", 0.1, &err), GD_OK);	/* another type */
	assert_true(gd_attr_number(&im, "n", &v) && v == 0.1);
	assert_int_equal(gd_attr_set_number(&im, "half", 0.5, &err), GD_OK);
	assert_string_equal(gd_attr_find(&im, "half")->type, "float");
	assert_true(gd_attr_number(&im, "half", &v) && v == 0.5);
	assert_int_equal(im.nattr, 3);
	assert_int_equal(gd_attr_set_string(&to, "n", "mine", &err), GD_OK);
	assert_int_equal(gd_attr_copy(&to, &im, &err), GD_OK);
	assert_int_equal(to.nattr, 3);
	assert_true(gd_attr_string(&to, "n", text, sizeof text));
	assert_string_equal(text, "mine");
	gd_image_free(&im);
	gd_image_free(&to);
}

static void test_numbers_in_strings(void **state)
{
	static const struct {
		const char *text;
		bool ok;
		double v;
	} list[] = { { "64", true, 64 },   { " 1.5e3\n", true, 1500 }, { "", false, 0 },
		     { "12 px", false, 0 }, { "nan", false, 0 },	{ "1e999", false, 0 } };
	struct gd_image im = { 0 };
	struct gd_err err = { 0 };

	(void)state;
	for (size_t i = 0; i < sizeof list / sizeof *list; i++) {
		double v = -1;
		assert_int_equal(gd_attr_set_string(&im, "x", list[i].text, &err), GD_OK);
		assert_true(gd_attr_number(&im, "x", &v) == list[i].ok);
		if (list[i].ok)
			assert_true(v == list[i].v);
	}
	gd_image_free(&im);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_empty),
		cmocka_unit_test(test_channels),
		cmocka_unit_test(test_drop_if),
		cmocka_unit_test(test_attributes),
		cmocka_unit_test(test_numbers_in_strings),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
