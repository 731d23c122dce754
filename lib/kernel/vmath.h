/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Elementary functions that the compiler can vectorise: no branches, no tables, no errno.
 * For loops in lib/kernel only: they need -fno-trapping-math to become compare-and-select.
 */
#ifndef GD_VMATH_H
#define GD_VMATH_H

#include <stdint.h>
#include <string.h>

static inline int32_t gd_float_bits(float x)
{
	int32_t i;

	memcpy(&i, &x, sizeof i);
	return i;
}

static inline float gd_bits_float(int32_t i)
{
	float x;

	memcpy(&x, &i, sizeof x);
	return x;
}

/*
 * exp(f) for |f| <= ln 2 / 2, relative error 2.6e-9 before rounding: equal ripple, exactly 1 at 0.
 * Pairs of terms are independent of each other, so that they need not wait.
 */
static inline float gd_exp_core(float f)
{
	float f2 = f * f;
	float a = 1.0f + 1.00000005f * f;
	float b = 5.00000044e-1f + 1.66663648e-1f * f;
	float c = 4.16647734e-2f + 8.37905884e-3f * f + 1.40613171e-3f * f2;

	return a + f2 * (b + f2 * c);
}

/*
 * exp(x) with a relative error below 3e-7 for -87 <= x <= 88; exactly 1 at 0, exactly 0 below -87
 * (no denormals), exp(88) above 88. The result for NaN is some number of no meaning.
 * x = n ln 2 + f with |f| <= ln 2 / 2; 2^n goes into the exponent bits.
 */
static inline float gd_expf(float x)
{
	const float round = 12582912.0f;	/* 1.5 * 2^23: leaves the nearest integer */
	float top = x < 88.0f ? x : 88.0f;
	float y = top > -87.0f ? top : -87.0f;
	float shifted = y * 1.44269504f + round;
	float n = shifted - round;
	float f = (y - n * 0.693145752f) - n * 1.42860677e-6f;
	float p = gd_exp_core(f);

	p = gd_bits_float((int32_t)((uint32_t)gd_float_bits(p) +
				    ((uint32_t)gd_float_bits(shifted) << 23)));
	return x >= -87.0f ? p : 0.0f;
}

/*
 * exp(-x) for x >= 0, as above, exactly 0 from 87 on: there the rest of the computation is
 * nonsense, which costs nothing, where a limit to x would.
 */
static inline float gd_expf_minus(float x)
{
	const float round = 12582912.0f;
	float shifted = round - x * 1.44269504f;
	float n = shifted - round;
	float f = -(x + n * 0.693145752f) - n * 1.42860677e-6f;
	float p = gd_exp_core(f);

	p = gd_bits_float((int32_t)((uint32_t)gd_float_bits(p) +
				    ((uint32_t)gd_float_bits(shifted) << 23)));
	return x < 87.0f ? p : 0.0f;
}

/*
 * log(x) for finite normal x > 0, absolute error below 2e-7 where |log x| < 1, relative below 2e-7
 * elsewhere; exactly 0 at 1. The result for other x is some number of no meaning.
 * x = 2^n m with sqrt(1/2) <= m < sqrt(2); log m = 2 artanh((m - 1) / (m + 1)).
 */
static inline float gd_logf(float x)
{
	const int32_t half = 0x3f3504f3;	/* sqrt(1/2) */
	int32_t bits = gd_float_bits(x) - half;
	float n = (float)(bits >> 23);
	float m = gd_bits_float((bits & 0x7fffff) + half);
	float s = (m - 1.0f) / (m + 1.0f), s2 = s * s;
	float t = s2 * (0.333333333f + s2 * (0.2f + s2 * (0.142857143f + s2 * 0.111111111f)));

	return n * 0.693145752f + (n * 1.42860677e-6f + 2.0f * (s + s * t));
}

#endif
