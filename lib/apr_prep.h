/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Before and after a regression: pixels that are no numbers, variances where none were given,
 * single pixels of far too much energy (apr_prep.c); what the noise is like (apr_noise.c).
 */
#ifndef GD_APR_PREP_H
#define GD_APR_PREP_H

#include <stdbool.h>

#include "gd.h"
#include "plane.h"

/*
 * Mends a plane in place. A value that is NaN or Inf becomes the median of the finite ones in the
 * smallest window, 3x3 to 17x17, that has any, else 0; its variance (var.v may be NULL) the largest
 * finite one there. Of a sound value, a variance that is NaN becomes that too, Inf the largest
 * float (the square of a firefly), and what is below 0 becomes 0. Adds the number of values mended
 * to *count.
 */
int gd_apr_clean(struct gd_plane value, struct gd_plane var, size_t *count, struct gd_err *err);

/*
 * Variance of the mean of n >= 2 bins of equal weight, sum (b - mean)^2 / (n (n-1)). Not very sure
 * of itself: its relative standard deviation is sqrt(2 / (n-1)).
 */
void gd_apr_bin_variance(struct gd_plane var, const struct gd_plane *bin, int n);

/* The sample variance of 7x7 pixels around each: takes detail for noise. The last resort. */
int gd_apr_spatial_variance(struct gd_plane var, struct gd_plane value, struct gd_err *err);

/*
 * Spikes: pixels brighter than the mean of the 24 around them by more than 3 of their standard
 * deviations, but by no more than 2 of the pixel's own: one that most samples agree on is no spike
 * (all light from one bin of n: the deviation is the excess; from three of eight: half of it).
 */
struct gd_apr_spikes {
	int n;		/* spikes */
	int ny;		/* planes */
	int *at;	/* n: y * w + x */
	double *energy;	/* n * ny: what was removed, plane fastest */
};

/*
 * Takes the spikes out of the planes y[0] .. y[ny-1], in place: each gets the values, and the
 * variances (var[0] .. var[2]), of the neighbour of median luminance. y[0..2] are the colour, which
 * decides. trust_var: the variances come from samples, not from gd_apr_spatial_variance().
 * Source: Moon et al. 2016 as described in later work. Differs: a pixel's own variance has a say.
 */
int gd_apr_spikes_take(struct gd_apr_spikes *spikes, const struct gd_plane *y, int ny,
		       const struct gd_plane *var, bool trust_var, struct gd_err *err);

/*
 * Gives the energy back to the estimates est[0] .. est[ny-1]: each spike's to the window of the
 * given radius around it, in proportion to the luminance estimated there. A spike whose luminance
 * is more than `most` times that of its window gives back only that much of each plane; the number
 * of those is *capped. Linear in the energies but for that, and the same for all planes, so that
 * layers still add up.
 */
int gd_apr_spikes_return(const struct gd_apr_spikes *spikes, const struct gd_plane *est, int radius,
			 double most, int *capped, struct gd_err *err);

void gd_apr_spikes_free(struct gd_apr_spikes *spikes);	/* takes { 0 } */

/*
 * How noise adds up over neighbouring pixels: the mean over 5x5 blocks of (sum d)^2 / sum d^2,
 * where d is the luminance of the difference of two independent halves a and b (3 planes each) of
 * the samples. 1 for independent pixels; 2 to 3 for gradient-domain colour, whose pixels share
 * paths. At least 1, and 1 where the halves do not differ.
 */
double gd_apr_correlation(const struct gd_plane *a, const struct gd_plane *b);

/*
 * Gives an error estimate that a window of the given radius made, and that is blurred as widely,
 * the detail of the noise: nine tenths of it are multiplied by the mean variance over 9x9 pixels
 * over that over the window. In place; the planes may not overlap.
 */
int gd_apr_error_local(struct gd_plane mse, struct gd_plane var, int radius, struct gd_err *err);

#endif
