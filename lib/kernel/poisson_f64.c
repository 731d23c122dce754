/* SPDX-License-Identifier: BSD-3-Clause */
/* The rows of the multigrid solver in double. */
#define REAL double
#define TINY 1e-200	/* weights have a median of 1: a sum below this is no edge at all */
#define SQRT sqrt
#define TABLE GD_KERNEL(gd_mg_f64)

#include "poisson_mg_rows.h"
