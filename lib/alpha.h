/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * The weight alpha of the colour against the gradients, for l2 of poisson.h and pairsolve.h, that
 * suits their noise. l2 is linear, and right on average whatever alpha is: all of its error is what
 * it makes of the noise. So half the difference of two halves of the samples, which is noise of the
 * same kind and size without the image, is solved for some alpha, and the one wins whose solution o
 * has the least
 *	sum over pixels of o^2 / (l^2 + (level / 5)^2)
 * where l is the brightness of 3x3 pixels of the solved image, in the darker half, and level that of
 * the image: a relative error. Halvings and doublings of 0.5 are tried, and a parabola put through
 * the least (which for independent noise is up to 15 % low: 1 % of the error).
 *
 * Without halves the variances must do: alpha = 0.7 x root of the ratio of the weighted mean
 * variances of gradients and colour. Without the 0.7 this would be best for noise that is
 * independent everywhere (Gauss and Markov); that of colours in gradient-domain rendering is shared
 * by neighbours, and so worse than its variance says.
 *
 * l1 has no use for this: on real renders it is within 5 % of its best at the published 0.2.
 */
#ifndef GD_ALPHA_H
#define GD_ALPHA_H

#include "image.h"
#include "pairs.h"

#define GD_ALPHA_PUBLISHED 0.2
#define GD_ALPHA_LEAST 0.0625
#define GD_ALPHA_MOST 4.0

enum gd_alpha_source { GD_ALPHA_NONE, GD_ALPHA_VARIANCES, GD_ALPHA_HALVES };

/* "published", "variances", "halves" */
const char *gd_alpha_source_name(enum gd_alpha_source source);

struct gd_alpha {
	double value;			/* a multiple of 0.001, LEAST .. MOST */
	enum gd_alpha_source source;	/* what tells; NONE: nothing does, value is PUBLISHED */
	int solutions;			/* images of one channel that were solved for */
};

/* Planes of one size, each the mean over the channels. */
struct gd_alpha_in {
	const struct gd_pairs *pairs;	/* NULL: edge[0] leads to the right, edge[1] down */
	int edges;			/* planes of them: 2, or up to GD_PAIRS with pairs */
	struct gd_plane colour, edge[GD_PAIRS];
	/* Of source: half the difference of two halves, or variances of the mean. */
	enum gd_alpha_source source;
	struct gd_plane colour_noise, edge_noise[GD_PAIRS];
};

/*
 * tolerance: that of the solution alpha is for. Those here reach its root, and with pairs itself: a
 * search without coarse grids that is stopped early knows no low frequencies. Proportional input
 * gives the same alpha, whatever the number of threads. Values that are no numbers are passed over;
 * no noise at all is source NONE. report (may be NULL) hears of the progress.
 */
int gd_alpha_choose(struct gd_alpha *alpha, const struct gd_alpha_in *in, double tolerance,
		    const struct gd_report *report, struct gd_err *err);

/*
 * What im has to tell: halves (half0, half1, else bins) of the colour and all gradients, else
 * variances. Channels of these that were to be dropped are to pass instead (GD_PASS).
 */
enum gd_alpha_source gd_alpha_want(struct gd_image *im, bool pairs);

/*
 * The same for an image, after gd_alpha_want() and loading, with the colour and the gradients read
 * (GD_READ). pairs: as solved, or NULL for dx and dy.
 */
int gd_alpha_of_image(struct gd_alpha *alpha, const struct gd_image *im,
		      const struct gd_pairs *pairs, double tolerance,
		      const struct gd_report *report, struct gd_err *err);

#endif
