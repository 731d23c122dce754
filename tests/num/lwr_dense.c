/* SPDX-License-Identifier: BSD-3-Clause */
/* The sparse linear predictions against dense least squares: image sizes, settings, inputs. */
#include "../support/lwr_dense.h"

static const struct gd_lwr_conf plain = { .radius = 5, .feature_noise = 1 };

static void test_sizes(void **state)
{
	static const int size[][2] = {{27, 29}, {16, 16}, {1, 1}, {1, 23},
				      {31, 1},	{2, 3},	  {5, 34}};

	(void)state;
	for (size_t i = 0; i < sizeof size / sizeof *size; i++) {
		struct scene s = make(size[i][0], size[i][1], 3, 3, 7);

		s.var = true;
		against_dense(s, plain);
	}
}

static void test_radii(void **state)
{
	(void)state;
	for (int r = 1; r <= 9; r++) {
		struct gd_lwr_conf conf = plain;
		struct scene s = make(31, 22, 3, 3, 8 + r);

		conf.radius = r;
		s.twin = r % 2;
		s.weighted = r % 3 == 0;
		against_dense(s, conf);
	}
}

static void test_inputs(void **state)
{
	(void)state;
	for (int i = 0; i < 16; i++) {
		struct scene s = make(23, 20, i % 2 ? 1 : i % 4 ? 3 : 5, i % 3 ? 4 : 0, 20 + i);
		struct gd_lwr_conf conf = plain;

		s.twin = i & 1;
		s.var = i & 2;
		s.weighted = i & 4;
		if (i & 8) {
			conf.ridge = 1e-2;
			conf.flat = 1e-3;
		}
		conf.granularity = i % 4 * 3;
		against_dense(s, conf);
	}
}

static void test_every_pixel(void **state)
{
	struct gd_lwr_conf conf = plain;
	struct scene s = make(19, 17, 3, 3, 5);

	(void)state;
	conf.dense = true;
	conf.radius = 4;
	s.twin = true;
	assert_int_equal(against_dense(s, conf), 19 * 17);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_sizes), cmocka_unit_test(test_radii),
		cmocka_unit_test(test_inputs), cmocka_unit_test(test_every_pixel)};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
