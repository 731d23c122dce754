/* SPDX-License-Identifier: BSD-3-Clause */
/* The regression engine against dense least squares: image sizes and settings. */
#include "../support/apr_dense.h"

static void test_sizes(void **state)
{
	static const int size[][2] = {{37, 29}, {16, 16}, {1, 1}, {1, 23},
				      {31, 1},	{2, 3},	  {5, 64}};

	(void)state;
	for (size_t i = 0; i < sizeof size / sizeof *size; i++)
		against_dense(make(size[i][0], size[i][1], 3, 3, 3, 7),
			      (struct gd_apr_conf){ 5, 3, 0, 3, GD_APR_GAUSS, 1, 1, 0, 0 }, i % 2);
}

static void test_settings(void **state)
{
	static const struct gd_apr_conf conf[] = {
		{0, 1, 0, 0, GD_APR_GAUSS, 1, 1, 0, 0},
		{1, 1, 0, 3, GD_APR_BOX, 1, 1, 0, 0},
		{4, 2, 0, 3, GD_APR_BOX, 0, 1, 0, 0},
		{9, 4, 1, 2, GD_APR_GAUSS, 1, 1, 0, 0},
		{6, 13, 2, 2, GD_APR_GAUSS, 1, 1, 0, 0},
		{21, 8, 0, 3, GD_APR_GAUSS, 3, 2.5, 0, 0},
		{8, 4, 0, 3, GD_APR_GAUSS, 1, 1, 0.1, 0},
		{8, 4, 0, 1, GD_APR_BOX, 0, 1, 0.01, 0.02},
	};

	(void)state;
	for (size_t i = 0; i < sizeof conf / sizeof *conf; i++) {
		against_dense(make(41, 26, 4, 2, 3, 11), conf[i], false);
		against_dense(make(33, 30, 3, 3, 0, 12), conf[i], true);
		against_dense(make(30, 27, 1, 1, 5, 13), conf[i], true);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {cmocka_unit_test(test_sizes),
					   cmocka_unit_test(test_settings)};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
