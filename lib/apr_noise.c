/* SPDX-License-Identifier: BSD-3-Clause */
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "apr_prep.h"

#define BLOCK 5		/* pixels a side: wider than the paths that neighbours share */
#define NEAR 4		/* radius of what counts as here, pixels */
#define EVERYWHERE 0.1	/* share of the error that does not follow the noise */

static inline int imin(int a, int b)
{
	return a < b ? a : b;
}

static inline int imax(int a, int b)
{
	return a > b ? a : b;
}

/* (sum d)^2 / sum d^2 of a block; false if d is 0 or too large throughout. */
static bool block_ratio(const struct gd_plane *a, const struct gd_plane *b, int x0, int y0,
			double *ratio)
{
	static const double weight[3] = { 0.2126, 0.7152, 0.0722 };
	double s = 0, s2 = 0;

	for (int y = y0; y < y0 + BLOCK; y++)
		for (int x = x0; x < x0 + BLOCK; x++) {
			double d = 0;

			for (int c = 0; c < 3; c++)
				d += weight[c] *
				     ((double)gd_row(a[c], y)[x] - (double)gd_row(b[c], y)[x]);
			s += d;
			s2 += d * d;
		}
	*ratio = s * s / s2;
	return s2 > 0 && isfinite(*ratio);
}

double gd_apr_correlation(const struct gd_plane *a, const struct gd_plane *b)
{
	double sum = 0, ratio;
	size_t n = 0;

	for (int y = 0; y + BLOCK <= a[0].h; y += BLOCK)
		for (int x = 0; x + BLOCK <= a[0].w; x += BLOCK)
			if (block_ratio(a, b, x, y, &ratio)) {
				sum += ratio;
				n++;
			}
	return n > 0 ? fmax(sum / (double)n, 1) : 1;
}

/* mean[x] of p over (2r+1)^2 pixels around row y, cut at the border; column: width of p. */
static void row_means(double *restrict mean, double *restrict column, struct gd_plane p, int y,
		      int r)
{
	int y0 = imax(y - r, 0), y1 = imin(y + r, p.h - 1);

	memset(column, 0, (size_t)p.w * sizeof *column);
	for (int j = y0; j <= y1; j++) {
		const float *row = gd_row(p, j);

		for (int x = 0; x < p.w; x++)
			column[x] += (double)row[x];
	}
	memset(mean, 0, (size_t)p.w * sizeof *mean);
	for (int i = -r; i <= r; i++) {
		int x0 = imax(-i, 0), x1 = imin(p.w - i, p.w);

		for (int x = x0; x < x1; x++)
			mean[x] += column[x + i];
	}
	for (int x = 0; x < p.w; x++)
		mean[x] /= (double)(y1 - y0 + 1) * (imin(x + r, p.w - 1) - imax(x - r, 0) + 1);
}

int gd_apr_error_local(struct gd_plane mse, struct gd_plane var, int radius, struct gd_err *err)
{
	size_t w = (size_t)mse.w;
	bool failed = false;

#pragma omp parallel for schedule(static)
	for (int y = 0; y < mse.h; y++) {
		double *here = gd_alloc(3 * w, sizeof *here), *wide = here + w;
		float *row = gd_row(mse, y);

		if (!here) {
#pragma omp atomic write
			failed = true;
			continue;
		}
		row_means(here, here + 2 * w, var, y, NEAR);
		row_means(wide, here + 2 * w, var, y, imax(radius, NEAR));
		for (int x = 0; x < mse.w; x++) {
			double follow = wide[x] > 0 ? here[x] / wide[x] : 1;
			double e = (double)row[x] * (EVERYWHERE + (1 - EVERYWHERE) * follow);

			row[x] = e < (double)FLT_MAX ? (float)e : FLT_MAX;
		}
		free(here);
	}
	return failed ? gd_fail(err, GD_ENOMEM, "out of memory") : GD_OK;
}
