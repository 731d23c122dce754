/* SPDX-License-Identifier: BSD-3-Clause */
/* Between sampling.c and its kernels: rows of n pixels. */
#ifndef GD_SAMPLING_ROW_H
#define GD_SAMPLING_ROW_H

#include "isa.h"

#define GD_SAMPLING_MANY 1e9f	/* samples of a pixel beyond which more make no difference */

/* What a pixel gets: c u - taken n, no less than lo, no more than hi, with n samples so far. */
struct gd_sampling_rule {
	double c, taken, lo, hi;
};

/* samples: drawn so far; NaN and values below 0 are none. */
struct gd_sampling_kernel {
	/* rho = mean over channels of error / (colour^2 + dark2), each from 0 to most */
	void (*relative)(float *rho, const float *const *error, const float *const *colour,
			 int channels, double dark2, double most, int n);
	/* u = (rho n^a)^b; returns the largest */
	float (*demand)(float *u, const float *rho, const float *samples, float a, float b, int n);
	/* u = max(faint, times u) */
	void (*scale)(float *u, float times, float faint, int n);
	/* sum[0]: of what pixels get; sum[1]: of u where neither bound holds */
	void (*spend)(double sum[2], const float *u, const float *samples,
		      const struct gd_sampling_rule *rule, int n);
	/* the whole part of what pixels get into whole, the fraction in place of u; returns the sum
	 * of whole */
	double (*allot)(float *whole, float *u, const float *samples,
			const struct gd_sampling_rule *rule, int n);
	/* sum[0]: of rho; [1]: of rho (1 + map/n)^-p; [2]: of rho (1 + even/n)^-p; n at least 1 */
	void (*foresee)(double sum[3], const float *rho, const float *map, const float *samples,
			float even, float p, int n);
};

GD_KERNEL_TABLE(struct gd_sampling_kernel, gd_sampling_kernel);

#endif
