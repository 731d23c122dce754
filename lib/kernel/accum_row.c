/* SPDX-License-Identifier: BSD-3-Clause */
#include "accum_row.h"

#include <float.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

static bool finite_row(const float *v, int n)
{
	int bad = 0;

	for (int i = 0; i < n; i++) {
		uint32_t bits;

		memcpy(&bits, v + i, sizeof bits);
		bad |= (bits & 0x7f800000u) == 0x7f800000u;
	}
	return !bad;
}

static inline float narrow(double v)
{
	v = v > FLT_MAX ? FLT_MAX : v;
	return (float)(v < -FLT_MAX ? -FLT_MAX : v);
}

/* The same weights for the whole row. */
static void add_same(const struct gd_accum_row *r, int n)
{
	const double share = r->all_w / (r->all_w + r->all_old), spread = share * r->all_old;
	const float *restrict x = r->x, *restrict within = r->within;
	float *restrict mean = r->mean, *restrict m2 = r->m2;

	if (!(r->all_w > 0))
		return;
	if (!(r->all_old > 0)) {
		memcpy(mean, x, (size_t)n * sizeof *mean);
		for (int i = 0; m2 && within && i < n; i++)
			m2[i] = narrow((double)m2[i] + (double)within[i]);
		return;
	}
	if (m2 && within) {
#pragma omp simd
		for (int i = 0; i < n; i++) {
			double d = (double)x[i] - (double)mean[i];

			m2[i] = narrow((double)m2[i] + spread * d * d + (double)within[i]);
		}
	} else if (m2) {
#pragma omp simd
		for (int i = 0; i < n; i++) {
			double d = (double)x[i] - (double)mean[i];

			m2[i] = narrow((double)m2[i] + spread * d * d);
		}
	}
#pragma omp simd
	for (int i = 0; i < n; i++)
		mean[i] = narrow((double)mean[i] + share * ((double)x[i] - (double)mean[i]));
}

/* Weights of the pixels' own. Where w = 0, x may be anything, and nothing changes. */
static inline __attribute__((always_inline)) void
add_each(const struct gd_accum_row *r, int n, bool each_w, bool each_old, bool spread, bool parts)
{
	const float *restrict x = r->x, *restrict within = r->within;
	const float *restrict w = r->w, *restrict old = r->old;
	float *restrict mean = r->mean, *restrict m2 = r->m2;

#pragma omp simd
	for (int i = 0; i < n; i++) {
		double a = each_w ? (double)w[i] : r->all_w;
		double b = each_old ? (double)old[i] : r->all_old;
		double d = (double)x[i] - (double)mean[i], share = a / (a + b);
		float m = b > 0 ? narrow((double)mean[i] + share * d) : x[i];

		if (spread) {
			double s = (double)m2[i] + share * b * d * d;

			s += parts ? (double)within[i] : 0;
			m2[i] = a > 0 ? narrow(s) : m2[i];
		}
		mean[i] = a > 0 ? m : mean[i];
	}
}

static void add(const struct gd_accum_row *r, int n)
{
	if (!r->w && !r->old)
		add_same(r, n);
	else if (!r->m2)
		r->w ? r->old ? add_each(r, n, true, true, false, false)
			      : add_each(r, n, true, false, false, false)
		     : add_each(r, n, false, true, false, false);
	else if (!r->within)
		r->w ? r->old ? add_each(r, n, true, true, true, false)
			      : add_each(r, n, true, false, true, false)
		     : add_each(r, n, false, true, true, false);
	else
		r->w ? r->old ? add_each(r, n, true, true, true, true)
			      : add_each(r, n, true, false, true, true)
		     : add_each(r, n, false, true, true, true);
}

const struct gd_accum_kernel GD_KERNEL(gd_accum_kernel) = { finite_row, add };
