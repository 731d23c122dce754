/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Weighted means and spreads that grow by one plane at a time (West 1979), with weights that may
 * differ from pixel to pixel. Arithmetic is double, storage float; what overflows float is stored
 * as the largest float. Every pixel is a computation of its own: results do not depend on threads.
 */
#ifndef GD_ACCUM_H
#define GD_ACCUM_H

#include "names.h"

/* Threads pay off from here: waking them takes as long as some 10,000 pixels of such work. */
#define GD_ACCUM_MANY(p) ((size_t)(p).w * (size_t)(p).h > 100000)

/* A number per pixel, >= 0: the same one everywhere (plane.v = NULL), or a plane of them. */
struct gd_count {
	double all;
	struct gd_plane plane;
};

void gd_count_free(struct gd_count *c);

/* A plane of its own, filled with what c holds so far, unless it has one already. GD_ENOMEM. */
int gd_count_spread(struct gd_count *c, int w, int h, struct gd_err *err);

/* c += a; spreads c if a is a plane. */
int gd_count_add(struct gd_count *c, const struct gd_count *a, struct gd_err *err);

/* c *= factor, which is positive. */
void gd_count_scale(struct gd_count *c, double factor);

/* Number of pixels where any of the n planes is NaN or infinite and w > 0. */
size_t gd_accum_bad(const struct gd_plane *plane, int n, const struct gd_count *w);

/* w (a plane) = 0 there. */
void gd_accum_mask(const struct gd_plane *plane, int n, struct gd_count *w);

/*
 * Takes x, of weight w, into mean, of weight old so far:
 *	mean += (x - mean) w / (old + w)
 *	m2 += within + (x - mean)^2 w old / (old + w)		(mean: as it was before)
 * m2.v and within.v may be NULL. Where w = 0, x and within may be anything.
 */
void gd_accum_add(struct gd_plane mean, struct gd_plane m2, struct gd_plane x,
		  struct gd_plane within, const struct gd_count *w, const struct gd_count *old);

/* sum += x */
void gd_accum_sum(struct gd_plane sum, struct gd_plane x);

/*
 * out = n (n - 1) times the variance of the mean of n samples, which v holds as kind says; with
 * counted = false n^2 times it (kind can only be GD_VARIANCE_MEAN then). Negative and NaN variances
 * become 0, infinite ones limit. Returns the number of NaN.
 */
size_t gd_accum_within_variance(struct gd_plane out, struct gd_plane v, struct gd_plane mean,
				enum gd_variance kind, bool counted, float limit,
				const struct gd_count *n);

/* out = sum over the k parts, each a mean of n / k samples, of (n / k) (part - their mean)^2. */
void gd_accum_within_parts(struct gd_plane out, const struct gd_plane *part, int k,
			   const struct gd_count *n);

#endif
