/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Where the next samples go: from the estimated error of a denoised image, a whole number of new
 * samples for each pixel of a given total.
 *
 * The relative error of pixel i after n_i samples is
 *	rho_i = mean over channels of error / (colour^2 + (dark level)^2),
 * at most 1 (an estimate that says more knows nothing) and blurred a little. With a further a_i
 * samples a denoiser of local dimension d brings it down to
 *	rho_i (1 + a_i / n_i)^-p,	p = 4 / (d + 4)		(Moon et al. 2014, 2015)
 * The a_i of the least sum, between the bounds lo and hi, are
 *	a_i = min(hi, max(lo, c u_i - n_i)),	u_i = (rho_i n_i^p)^(1 / (1 + p)),
 * with the one c that spends the total. Estimates of the error scatter more than errors do, so what
 * rho_i is to be expected, given its estimate, lies nearer to the others: the power `trust` of the
 * estimate stands for rho_i in u_i (regression to the mean, of logarithms). lo is a share of the
 * even map, so that regions whose error was under-estimated do not starve. Source: the constrained
 * minimum is ours; Moon et al. 2015, section 5.2, have a_i = c rho_i n_i^-p without bounds, which
 * paper asks for.
 *
 * Whole numbers: the fractions of a_i are rounded systematically along a path that visits the
 * pixels of a tile by a Hilbert curve, so that the counts of any neighbourhood add up to what they
 * should: each count is less than 1 away from a_i, right on average over seeds, and the sum is
 * exact.
 */
#ifndef GD_SAMPLING_H
#define GD_SAMPLING_H

#include <stdbool.h>
#include <stdint.h>

#include "gd.h"
#include "plane.h"

#define GD_SAMPLING_MOST 16777216.0	/* 2^24 samples of a pixel: what a float counts by ones */

struct gd_sampling_conf {
	double total;		/* new samples in all, a whole number from 0 */
	double min, max;	/* new samples of a pixel, whole; max up to GD_SAMPLING_MOST */
	double multiple;	/* counts, and total, are whole multiples of it; from 1 */
	double floor;		/* share of the total that is spread evenly, 0 .. 1 */
	double blur_px;		/* standard deviation of the blur of rho, 0 .. 10 */
	double dark;		/* of the mean luminance: errors below count as they are, > 0 */
	double dimension;	/* d, 0 .. 100 */
	double trust;		/* of differences between estimates, 0.01 (none) .. 1 */
	uint64_t seed;
	bool paper;		/* in proportion to rho n^-p; no bound on rho */
};
#define GD_SAMPLING_DEFAULTS ((struct gd_sampling_conf){ \
	.max = GD_SAMPLING_MOST, .multiple = 1, .floor = 0.1, .blur_px = 1, .dark = 0.5, \
	.dimension = 4, .trust = 0.75, .seed = 1 })
/* As published: 0.001 beside the squared colour of an image whose level is mid-grey, 0.18. */
#define GD_SAMPLING_PAPER ((struct gd_sampling_conf){ \
	.max = GD_SAMPLING_MOST, .multiple = 1, .floor = 0, .blur_px = 0, .dark = 0.18, \
	.dimension = 4, .trust = 1, .seed = 1, .paper = true })

/*
 * Planes of one size.
 * colour, error	n of each, 1 .. 4: the denoised image, radiance; its mean squared error
 * samples		drawn so far, of each pixel; v = NULL: even_samples everywhere
 * A pixel counts at least one sample where its error is judged. Errors below 0 and NaN count as 0,
 * Inf as the largest.
 */
struct gd_sampling_in {
	int n;
	struct gd_plane colour[4], error[4], samples;
	double even_samples;
};

struct gd_sampling_result {
	double level;		/* mean luminance, without its brightest hundredth */
	double before;		/* mean of rho */
	double after, even;	/* what it should become with this map, and with an even one */
	double least, most;	/* new samples of a pixel */
	bool blind;		/* no error anywhere: the map is even */
};

/*
 * map gets the counts; it must overlap nothing. result may be NULL.
 * Needs 8 bytes a pixel. Returns GD_OK, GD_EARG (settings out of range, or bounds that do not let
 * the total be spent), GD_ENOMEM. The same for any number of threads, and for input that is scaled
 * by a power of 2.
 */
int gd_sampling_map(struct gd_plane map, const struct gd_sampling_in *in,
		    const struct gd_sampling_conf *conf, struct gd_sampling_result *result,
		    struct gd_err *err);

#endif
