/* SPDX-License-Identifier: BSD-3-Clause */
/* The rows of the multigrid solver in float. */
#define REAL float
#define TINY 1e-30f	/* weights have a median of 1: a sum below this is no edge at all */
#define SQRT sqrtf
#define TABLE GD_KERNEL(gd_mg_f32)

#include "poisson_mg_rows.h"
