/* SPDX-License-Identifier: BSD-3-Clause */
/* Order statistics without sorting. */
#ifndef GD_SELECT_H
#define GD_SELECT_H

#include <stddef.h>

/*
 * The k-th smallest (from 0) of v[lo .. n - 1], lo <= k < n, which it reorders so that none before
 * k is larger and none after k smaller. No NaN. Linear time; runs of equal values cost one pass.
 */
double gd_select(double *v, size_t lo, size_t n, size_t k);

/* Index of the q-quantile of n values, sorted: the smallest that a share q are not above. */
size_t gd_quantile_index(double q, size_t n);

#endif
