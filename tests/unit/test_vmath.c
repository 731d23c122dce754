/* SPDX-License-Identifier: BSD-3-Clause */
/* Exponential and logarithm for kernels against those of the C library, over all of its range. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <math.h>

#include "kernel/vmath.h"

static void close_to(double x, double found, double wanted)
{
	if (!(fabs(found / wanted - 1.0) <= 3e-7))
		fail_msg("exp(%.9g): %.9g, expected %.9g", x, found, wanted);
}

static void both_signs(void **unused)
{
	(void)unused;
	for (int i = -870000; i <= 880000; i++) {
		float x = (float)(i * 1e-4);

		if (x >= -87.0f)
			close_to(x, gd_expf(x), exp((double)x));
	}
	assert_true(gd_expf(0.0f) == 1.0f);
	assert_true(gd_expf(-87.1f) == 0.0f);
	assert_true(gd_expf(-1e30f) == 0.0f);
	assert_true(gd_expf(-INFINITY) == 0.0f);
	assert_true(gd_expf(1e30f) == gd_expf(88.0f) && isfinite(gd_expf(88.0f)));
}

static void minus(void **unused)
{
	(void)unused;
	for (int i = 0; i < 870000; i++) {
		float x = (float)(i * 1e-4);

		close_to(-x, gd_expf_minus(x), exp(-(double)x));
	}
	for (float x = 1e-30f; x < 1e-4f; x *= 1.1f)
		close_to(-x, gd_expf_minus(x), exp(-(double)x));
	assert_true(gd_expf_minus(0.0f) == 1.0f);
	for (float x = 87.0f; x < 1e38f; x *= 1.001f)
		assert_true(gd_expf_minus(x) == 0.0f);
	assert_true(gd_expf_minus(INFINITY) == 0.0f);
}

static void logarithm(void **unused)
{
	(void)unused;
	for (float x = 1.2e-38f; x < 3e38f; x *= 1.00003f) {
		double wanted = log((double)x), found = gd_logf(x);

		if (!(fabs(found - wanted) <= 2e-7 * fmax(1.0, fabs(wanted))))
			fail_msg("log(%.9g): %.9g, expected %.9g", x, found, wanted);
	}
	for (int i = -1000; i <= 1000; i++) {
		float x = 1.0f + (float)i * 0x1p-20f;

		if (!(fabs(gd_logf(x) - log((double)x)) <= 2e-7 * fabs(log((double)x)) + 1e-10))
			fail_msg("log(%.9g): %.9g", x, gd_logf(x));
	}
	assert_true(gd_logf(1.0f) == 0.0f);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(both_signs),
		cmocka_unit_test(minus),
		cmocka_unit_test(logarithm),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
