/* SPDX-License-Identifier: BSD-3-Clause */
#include "select.h"

#include <math.h>

/* Three-way partition about a median of three. */
double gd_select(double *v, size_t lo, size_t n, size_t k)
{
	while (n - lo > 1) {
		double a = v[lo], b = v[lo + (n - lo) / 2], c = v[n - 1];
		double mid = a < b ? (b < c ? b : a < c ? c : a) : (a < c ? a : b < c ? c : b);
		size_t less = lo, i = lo, more = n;

		while (i < more) {
			double t = v[i];

			if (t < mid) {
				v[i++] = v[less];
				v[less++] = t;
			} else if (t > mid) {
				v[i] = v[--more];
				v[more] = t;
			} else {
				i++;
			}
		}
		if (k < less)
			n = less;
		else if (k >= more)
			lo = more;
		else
			return mid;
	}
	return v[lo];
}

size_t gd_quantile_index(double q, size_t n)
{
	double k = ceil(q * (double)n);

	return k < 1 ? 0 : k > (double)n ? n - 1 : (size_t)k - 1;
}
