/* SPDX-License-Identifier: BSD-3-Clause */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <stdlib.h>
#include <string.h>

#include "buffers.h"

static void image_of(struct gd_image *im, const char *const *names)
{
	gd_image_init(im, 3, 2);
	for (; *names; names++)
		assert_int_equal(gd_image_append(im, *names, GD_HALF, NULL), GD_OK);
}

static void test_layers_are_found(void **state)
{
	static const char *const names[] = {
		"B", "G", "N.X", "N.Y", "N.Z", "N.variance.X", "N.variance.Y", "N.variance.Z",
		"R", "Z", "Z.variance", "albedo.G", "albedo.R", "dx.B", "dx.G", "dx.R",
		"half0.B", "half0.G", "half0.R", "half0.variance.B", "half0.variance.G",
		"half0.variance.R", "variance.B", "variance.G", "variance.R", NULL
	};
	struct gd_image im;
	struct gd_layer l;

	(void)state;
	image_of(&im, names);
	l = gd_layer_find(&im, "");
	assert_int_equal(l.n, 3);
	assert_string_equal(l.name[0], "R");
	assert_string_equal(l.name[2], "B");
	l = gd_layer_find(&im, "N");
	assert_int_equal(l.n, 3);
	assert_string_equal(l.name[1], "N.Y");
	l = gd_layer_find(&im, "Z");
	assert_int_equal(l.n, 1);
	assert_string_equal(l.name[0], "Z");
	assert_int_equal(gd_layer_find(&im, "albedo").n, 0);	/* blue is missing */
	assert_int_equal(gd_layer_find(&im, "dy").n, 0);
	assert_int_equal(gd_layer_find(&im, "half0").n, 3);
	assert_int_equal(gd_layer_find(&im, "half0.").n, 3);
	l = gd_layer_variance(&im, "");
	assert_int_equal(l.n, 3);
	assert_string_equal(l.name[1], "variance.G");
	l = gd_layer_variance(&im, "N");
	assert_string_equal(l.name[2], "N.variance.Z");
	l = gd_layer_variance(&im, "Z");
	assert_int_equal(l.n, 1);
	assert_string_equal(l.name[0], "Z.variance");
	l = gd_layer_variance(&im, "half0");
	assert_int_equal(l.n, 3);
	assert_string_equal(l.name[0], "half0.variance.R");
	assert_int_equal(gd_layer_variance(&im, "dx").n, 0);
	gd_image_free(&im);
}

static void test_long_names(void **state)
{
	static const char *const names[] = {
		"R", NULL
	};
	struct gd_image im;
	char name[400];

	(void)state;
	image_of(&im, names);
	memset(name, 'x', sizeof name - 1);
	name[sizeof name - 1] = 0;
	assert_int_equal(gd_layer_find(&im, name).n, 0);
	assert_int_equal(gd_layer_variance(&im, name).n, 0);
	assert_int_equal(gd_layer_add(&im, name, 3, (struct gd_plane[GD_LAYER_PLANES]){{0}}, NULL),
			 GD_EARG);
	gd_image_free(&im);
}

static void test_wants(void **state)
{
	static const char *const names[] = {
		"R", "G", "B", "variance.R", "variance.G", "variance.B", "bin0.R", "bin10.dx.R",
		"bin.x", "binary.R", "bin0", NULL
	};
	struct gd_image im;

	(void)state;
	image_of(&im, names);
	assert_int_equal(gd_layer_want(&im, "", GD_READ), 3);
	assert_int_equal(gd_layer_want_variance(&im, "", GD_DROP), 3);
	assert_int_equal(gd_layer_want(&im, "Z", GD_READ), 0);
	assert_int_equal(gd_family_want(&im, "bin", GD_DROP), 3);
	for (int i = 0; i < im.nchan; i++)
		assert_int_equal(im.chan[i].want, i < 3 ? GD_READ : i < 9 ? GD_DROP : GD_PASS);
	gd_image_free(&im);
}

static void test_planes_and_bins(void **state)
{
	struct gd_plane p[GD_LAYER_PLANES], q[GD_LAYER_PLANES];
	struct gd_image im;

	(void)state;
	gd_image_init(&im, 3, 2);
	assert_int_equal(gd_layer_add(&im, "", 3, p, NULL), GD_OK);
	assert_int_equal(gd_layer_add(&im, "Z", 1, p, NULL), GD_OK);
	assert_int_equal(gd_layer_add(&im, "bin0.dx", 3, p, NULL), GD_OK);
	assert_int_equal(gd_layer_add(&im, "bin1.dx", 3, p, NULL), GD_OK);
	assert_int_equal(gd_layer_add(&im, "bin3.dx", 3, p, NULL), GD_OK);
	assert_int_equal(gd_layer_add(&im, "bin0", 3, p, NULL), GD_OK);
	assert_int_equal(gd_layer_add(&im, "", 1, p, NULL), GD_EARG);
	assert_int_equal(gd_bins(&im, "dx"), 2);
	assert_int_equal(gd_bins(&im, ""), 1);
	assert_int_equal(gd_bins(&im, "dy"), 0);
	assert_int_equal(gd_layer_planes(&im, "bin0", q), 3);
	assert_true(q[0].v == p[0].v && q[2].v == p[2].v && q[1].w == 3 && q[1].h == 2);
	assert_int_equal(gd_layer_planes(&im, "Z", q), 1);
	assert_int_equal(gd_layer_variance_planes(&im, "Z", q), 0);
	assert_int_equal(gd_image_append(&im, "Z.variance", GD_HALF, NULL), GD_OK);
	assert_int_equal(gd_layer_variance_planes(&im, "Z", q), 0);	/* there, but not read */
	gd_image_free(&im);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_layers_are_found), cmocka_unit_test(test_long_names),
		cmocka_unit_test(test_wants), cmocka_unit_test(test_planes_and_bins),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
