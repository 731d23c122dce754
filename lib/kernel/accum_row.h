/* SPDX-License-Identifier: BSD-3-Clause */
/* Between accum.c and its kernels: rows of n pixels. */
#ifndef GD_ACCUM_ROW_H
#define GD_ACCUM_ROW_H

#include <stdbool.h>

#include "isa.h"

/* Row of gd_accum_add(). A weight is w[i], or all_w where w is NULL; old alike. m2 and within may
 * be NULL. */
struct gd_accum_row {
	float *mean, *m2;
	const float *x, *within, *w, *old;
	double all_w, all_old;
};

struct gd_accum_kernel {
	bool (*finite)(const float *v, int n);		/* all of them */
	void (*add)(const struct gd_accum_row *r, int n);
};

GD_KERNEL_TABLE(struct gd_accum_kernel, gd_accum_kernel);

#endif
