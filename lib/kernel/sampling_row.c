/* SPDX-License-Identifier: BSD-3-Clause */
#include "sampling_row.h"

#include <float.h>

#include "vmath.h"

/* NaN: none */
static inline float samples_of(float n)
{
	float most = n < GD_SAMPLING_MANY ? n : GD_SAMPLING_MANY;

	return n > 0 ? most : 0;
}

static void relative(float *restrict rho, const float *const *error, const float *const *colour,
		     int channels, double dark2, double most, int n)
{
	double share = 1.0 / channels;

	for (int c = 0; c < channels; c++) {
		const float *restrict e = error[c], *restrict v = colour[c];

		for (int x = 0; x < n; x++) {
			double s = v[x] >= -FLT_MAX && v[x] <= FLT_MAX ? (double)v[x] : 0;
			double r = (double)e[x] / (s * s + dark2);
			double cut = r < most ? r : most;

			cut = share * (r > 0 ? cut : 0);	/* NaN: 0 */
			rho[x] = (float)(c ? (double)rho[x] + cut : cut);
		}
	}
}

static float demand(float *restrict u, const float *restrict rho, const float *restrict samples,
		    float a, float b, int n)
{
	float most = 0;

	for (int x = 0; x < n; x++) {
		float m = samples_of(samples[x]), at_least = m > 1 ? m : 1;
		float r = rho[x] > FLT_MIN ? rho[x] : FLT_MIN;
		float v = gd_expf(b * (gd_logf(r) + a * gd_logf(at_least)));

		u[x] = rho[x] > 0 ? v : 0;
	}
#pragma omp simd reduction(max : most)
	for (int x = 0; x < n; x++)
		most = u[x] > most ? u[x] : most;
	return most;
}

static void scale(float *restrict u, float times, float faint, int n)
{
	for (int x = 0; x < n; x++) {
		float v = u[x] * times;

		u[x] = v > faint ? v : faint;
	}
}

static inline double given(float u, float samples, const struct gd_sampling_rule *r)
{
	double a = r->c * (double)u - r->taken * (double)samples_of(samples);
	double at_least = a > r->lo ? a : r->lo;

	return at_least < r->hi ? at_least : r->hi;
}

/* Lanes in a fixed order: the sum does not depend on how many threads there are. */
static void spend(double sum[2], const float *restrict u, const float *restrict samples,
		  const struct gd_sampling_rule *rule, int n)
{
	const struct gd_sampling_rule r = *rule;
	double all = 0, slope = 0;

#pragma omp simd reduction(+ : all, slope)
	for (int x = 0; x < n; x++) {
		double a = given(u[x], samples[x], &r);

		all += a;
		slope += a > r.lo && a < r.hi ? (double)u[x] : 0;
	}
	sum[0] = all;
	sum[1] = slope;
}

static double allot(float *restrict whole, float *restrict u, const float *restrict samples,
		    const struct gd_sampling_rule *rule, int n)
{
	const struct gd_sampling_rule r = *rule;
	double all = 0;

#pragma omp simd reduction(+ : all)
	for (int x = 0; x < n; x++) {
		double a = given(u[x], samples[x], &r);
		int32_t k = (int32_t)a;		/* a is 0 to 2^24 */

		u[x] = (float)(a - (double)k);
		whole[x] = (float)k;
		all += (double)k;
	}
	return all;
}

static void foresee(double sum[3], const float *restrict rho, const float *restrict map,
		    const float *restrict samples, float even, float p, int n)
{
	double before = 0, after = 0, evenly = 0;

#pragma omp simd reduction(+ : before, after, evenly)
	for (int x = 0; x < n; x++) {
		float m = samples_of(samples[x]), at_least = m > 1 ? m : 1;
		float more = gd_expf(-p * gd_logf(1 + map[x] / at_least));
		float same = gd_expf(-p * gd_logf(1 + even / at_least));

		before += (double)rho[x];
		after += (double)(rho[x] * more);
		evenly += (double)(rho[x] * same);
	}
	sum[0] = before;
	sum[1] = after;
	sum[2] = evenly;
}

const struct gd_sampling_kernel GD_KERNEL(gd_sampling_kernel) = { relative, demand, scale, spend,
								 allot, foresee };
