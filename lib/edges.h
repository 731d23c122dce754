/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * From variances of gradients to weights of edges, and back from edges to the connected parts of an
 * image. Works on the e and s planes of a float multigrid level: first they hold var_e, then w_e.
 */
#ifndef GD_EDGES_H
#define GD_EDGES_H

#include "gd.h"
#include "multigrid.h"
#include "plane.h"

/* Exact median of the positive finite values among count rows of w; 0 if there is none
 * (or no memory). row(i) gives a row, for which it may use work, w floats; it is
 * called from many threads. */
struct gd_rows {
	int count, w;
	const float *(*row)(const struct gd_rows *rows, int i, float *work);
	const void *user;
};
double gd_median_positive(const struct gd_rows *rows);

/* The median of all var_e of l. */
double gd_edges_median(const struct gd_mg_level *l);

/*
 * Variances above this times phi are not spread by smoothing. Renders want their fireflies
 * spread, as the neighbours of a path that was found once are where it was missed: a cap of 1e4
 * trebles the error of the worst.
 */
#define GD_EDGES_CAP 1e8

/*
 * Blurs var_e by a Gaussian of sigma pixels (none if 0) over edges of the same direction. What a
 * variance has above cap stays where it is: one firefly must not silence its whole neighbourhood.
 * spare: one plane of the level.
 */
int gd_edges_smooth(const struct gd_mg_level *l, float *spare, double sigma, double cap,
		    struct gd_err *err);

/* var_e becomes phi / (var_e + phi), 0 beyond 1e12 phi and at the border.
 * Returns the number of edges of weight 0 (the border's apart). */
size_t gd_edges_weigh(const struct gd_mg_level *l, double phi);

/* Taps of a Gaussian, radius ceil(3 sigma); returns
 * their odd number, at most GD_PREP_TAPS. Sum 1. */
int gd_gauss_taps(float *tap, double sigma);

/*
 * Connected parts by edges of more than least (0: any positive weight). label: h x w integers (row
 * after row). Parts are numbered from 0 in the order of their first pixel. Returns their number.
 */
int gd_edges_parts(const struct gd_mg_level *l, bool wide, double least, int *label);

#endif
