/* SPDX-License-Identifier: BSD-3-Clause */
#include "render/impl.h"

#define STEPS 0x1p24

double gd_cdf_fill(float *cdf, const double *weight, size_t n)
{
	double sum = 0, part = 0, top = STEPS;

	for (size_t i = 0; i < n; i++)
		sum += weight[i];
	cdf[0] = 0;
	for (size_t i = 0; i < n; i++) {
		const double least = (double)cdf[i] + (weight[i] > 0);
		double k;

		part += weight[i];
		k = sum > 0 ? nearbyint(part / sum * STEPS) : 0;
		cdf[i + 1] = (float)fmin(k > least ? k : least, STEPS);
	}
	/* Those at the end that found no step left take one from what is before them. */
	for (size_t i = n; i > 0; i--) {
		cdf[i] = (float)fmin((double)cdf[i], top);
		top = fmax((double)cdf[i] - (weight[i - 1] > 0), 0);
	}
	for (size_t i = 0; i <= n; i++)
		cdf[i] *= (float)(1 / STEPS);
	return sum;
}

size_t gd_cdf_find(const float *cdf, size_t n, float x)
{
	size_t low = 0, high = n;	/* cdf[low] <= x, and x < cdf[high] or high = n */

	while (high - low > 1) {
		const size_t mid = low + (high - low) / 2;

		if (cdf[mid] <= x)
			low = mid;
		else
			high = mid;
	}
	return low;
}
