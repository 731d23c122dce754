/* SPDX-License-Identifier: BSD-3-Clause */
#include "poisson_prep.h"

#include <float.h>
#include <math.h>
#include <string.h>

#define LIMIT 1e30f	/* of scaled radiance: times weights <= 1, and in small sums, finite */

static int clean(float *restrict out, const float *restrict in, float scale, int w)
{
	int bad = 0;

	for (int x = 0; x < w; x++) {
		float v = in[x];
		int ok = fabsf(v) <= FLT_MAX;

		v = ok ? v * scale : 0;
		v = v < LIMIT ? v : LIMIT;
		out[x] = v > -LIMIT ? v : -LIMIT;
		bad += !ok;
	}
	return bad;
}

static void variance(float *restrict out, const float *const *v, const float *const *var, int n,
		     float scale, int w)
{
	const float part = 1.0f / (float)n;

	memset(out, 0, (size_t)w * sizeof(*out));
	for (int c = 0; c < n; c++) {
		const float *restrict g = v[c], *restrict s = var[c];

		for (int x = 0; x < w; x++)
			out[x] += fabsf(g[x]) <= FLT_MAX ? 0 : INFINITY;
		if (!s)
			continue;
		for (int x = 0; x < w; x++) {
			float t = s[x] > 0 ? s[x] * scale * scale * part : 0;

			out[x] += s[x] <= FLT_MAX ? t : INFINITY;
		}
	}
}

static inline float bounded(float v, float cap)
{
	float b = v < cap ? v : cap;

	return v <= FLT_MAX ? b : 0;
}

static void blur_down(float *restrict out, const float *const *row, const float *tap, int taps,
		      float cap, int w)
{
	float sum = 0;

	memset(out, 0, (size_t)w * sizeof(*out));
	for (int i = 0; i < taps; i++) {
		const float *restrict v = row[i];
		const float k = tap[i];

		if (!v)
			continue;
		sum += k;
		for (int x = 0; x < w; x++)
			out[x] += k * bounded(v[x], cap);
	}
	sum = 1 / sum;
	for (int x = 0; x < w; x++)
		out[x] *= sum;
}

static void blur_along(float *restrict out, const float *restrict in, const float *tap, int taps,
		       float *restrict pad, int w)
{
	const int r = taps / 2;

	memset(pad, 0, (size_t)r * sizeof(*pad));
	memcpy(pad + r, in, (size_t)w * sizeof(*pad));
	memset(pad + r + w, 0, (size_t)r * sizeof(*pad));
	memset(out, 0, (size_t)w * sizeof(*out));
	for (int i = 0; i < taps; i++) {
		const float k = tap[i];

		for (int x = 0; x < w; x++)
			out[x] += k * pad[x + i];
	}
	for (int x = 0; x < w; x++) {		/* near the ends part of the taps is missing */
		float sum = 0;

		if (x >= r && x + r < w) {
			x = w - r - 1;
			continue;
		}
		for (int i = 0; i < taps; i++)
			sum += x + i >= r && x + i < w + r ? tap[i] : 0;
		out[x] /= sum;
	}
}

static void merge(float *restrict var, const float *restrict smooth, float cap, int w)
{
	for (int x = 0; x < w; x++) {
		float rest = var[x] - cap;

		var[x] = smooth[x] + (rest > 0 ? rest : 0);
	}
}

static int weigh(float *restrict var, float phi, int w)
{
	const float most = phi * 1e12f, inv = 1 / phi;
	int none = 0;

	for (int x = 0; x < w; x++) {
		int ok = var[x] <= most;

		var[x] = ok ? 1 / (var[x] * inv + 1) : 0;
		none += !ok;
	}
	return none;
}

const struct gd_prep_kernels GD_KERNEL(gd_prep) = {clean,      variance, blur_down,
						   blur_along, merge,	 weigh};
