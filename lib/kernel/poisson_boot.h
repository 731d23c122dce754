/* SPDX-License-Identifier: BSD-3-Clause */
/* Row kernels of bootstrap aggregation. */
#ifndef GD_POISSON_BOOT_H
#define GD_POISSON_BOOT_H

#include <stdint.h>

#include "isa.h"
#include "rng.h"

#define GD_BOOT_ROW_BINS 64

/* One row of all bins: bin b of plane k, k = 0 .. planes - 1. */
struct gd_boot_rows {
	int bins, planes;
	const float *bin[GD_BOOT_ROW_BINS][3];
};

struct gd_boot_kernels {
	/*
	 * For pixels first .. first + w - 1: mean of the drawn bins to v[k], and the variance of
	 * that mean, averaged over planes, to var: at least a tenth of the variance without draws,
	 * infinite where no bin is finite. Values are multiplied by scale. key NULL: every bin
	 * once. Pixels are numbered by index.
	 */
	void (*resample)(float *const *v, float *var, const struct gd_boot_rows *rows,
			 const struct gd_rng_key *key, uint32_t index, float scale, int w);
	/* count[b] = how often bin b is drawn, for w pixels:
	 * what resample draws. count[b] has w floats. */
	void (*draw)(float *const *count, int bins, struct gd_rng_key key, uint32_t index, int w);
	/* sum += d, square += d^2, high += (d - low)^2. square, high may be NULL. */
	void (*add)(float *sum, float *square, float *high, const float *d, const float *low,
		    int w);
};

GD_KERNEL_TABLE(struct gd_boot_kernels, gd_boot_rows);

#endif
