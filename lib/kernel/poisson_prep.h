/* SPDX-License-Identifier: BSD-3-Clause */
/* Row kernels around the solver: cleaning input, variances,
 * weights, bootstrap samples. All rows are of w floats. */
#ifndef GD_POISSON_PREP_H
#define GD_POISSON_PREP_H

#include <stdint.h>

#include "isa.h"

#define GD_PREP_TAPS 65		/* widest blur: radius 32 */

struct gd_prep_kernels {
	/* out = in * scale, limited to +-1e30, 0 where
	 * in is not finite; returns how many are not. */
	int (*clean)(float *out, const float *in, float scale, int w);
	/* Mean over n channels of the variances times scale^2; infinite
	 * where any v or variance is not finite. var[c] may be NULL (0). */
	void (*variance)(float *out, const float *const *v, const float *const *var, int n,
			 float scale, int w);
	/* out = sum of tap[i] min(row[i], cap), infinite values counting 0;
	 * rows NULL are left out, the sum is divided by the taps used. */
	void (*blur_down)(float *out, const float *const *row, const float *tap, int taps,
			  float cap, int w);
	/* Along the row, the same border rule. pad: work space of w + taps floats. */
	void (*blur_along)(float *out, const float *in, const float *tap, int taps, float *pad,
			   int w);
	/* var += smooth - min(var, cap): the smoothed part in place of what it was made of. */
	void (*merge)(float *var, const float *smooth, float cap, int w);
	/* In place: phi / (var + phi), 0 beyond 1e12 phi; returns the number of zeros. */
	int (*weigh)(float *var, float phi, int w);
};

GD_KERNEL_TABLE(struct gd_prep_kernels, gd_prep);

#endif
