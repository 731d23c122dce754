/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Where gradients pay: for each pixel the share of its next samples that should trace offset paths,
 * from a buffer with bins of colour and gradients.
 *
 * A sample that traces them costs as much as c plain ones, and what counts is the error after the
 * whole chain: gradients help where they show edges that G-buffers lack, wherever else more plain
 * samples do better, however little noise the gradients have. So both ways are tried. The bins come
 * as two halves A and B. Half A alone is denoised with a feature made from its gradients, to f_A,
 * and without, to g_A; half B knows nothing of the noise in either, so that
 *	d = (f_A - y_B)^2 - (g_A - y_B)^2
 * is, in the mean, what the feature adds to the squared error; the same with A and B swapped. What
 * it is added to is less sure: e is the error that the denoiser estimates of g, or what it does of
 * f less d if that is more, and a quarter of the mean of e at least. Both are divided by
 * colour^2 + dark^2, averaged over channels and halves, and blurred. Of R = d / e, the relative
 * change of the error, one region tells little more than
 * its noise; it is drawn towards the R of the whole image,
 *	R* = M + (R - M) t / (t + s),
 * t: what the R of A and that of B vary by together over the image, s: half of what they differ by
 * (the variance of the mean of both).
 *
 * Plain samples would bring the error down by c^-p, p = 4 / (d + 4), in the same time (sampling.h).
 * Gradients pay where (1 + R*) c^p exp(-`grows`) < 1; the share of samples goes from 0 to 1 where
 * the logarithm of that goes from 0 to -`width`. Most regions have all or nothing: a feature made
 * from a few gradients costs more than it gains.
 */
#ifndef GD_SPENDING_H
#define GD_SPENDING_H

#include "gd.h"
#include "image.h"
#include "plane.h"

#define GD_SPENDING_BINS 4	/* the fewest: two in each half */

struct gd_spending_conf {
	double cost;		/* c, 1 .. 100 */
	double dimension;	/* d, 0 .. 100, as in sampling.h */
	double blur_px;		/* standard deviation of the blur of d and e, 1 .. 10 */
	double width;		/* of the step from none to all, > 0, in log error */
	double grows;		/* what the log of 1 + R* is taken to fall by until the last pass:
				 * more samples make better features */
};
#define GD_SPENDING_DEFAULTS ((struct gd_spending_conf){ \
	.cost = 2, .dimension = 4, .blur_px = 8, .width = 0.2, .grows = 0.15 })

struct gd_spending_result {
	double share;		/* mean of the map */
	double change;		/* M: relative change of the error by gradients, equal samples */
	double gain;		/* error with the map over that of plain samples, at equal time */
	double everywhere;	/* the same with gradients everywhere */
};

/* Marks what gd_spending_map() reads, in an image of which only the header is known. GD_ESHAPE:
 * a channel is missing, or there are too few bins. */
int gd_spending_want(struct gd_image *im, struct gd_err *err);

/*
 * share becomes 0 .. 1, of the size of im, which is only read. result may be NULL.
 * Needs the planes of half of the bins once more, and what gd_feature_run() and gd_denoise_run()
 * need. Returns GD_OK, GD_EARG, GD_ESHAPE or GD_ENOMEM. The same for any number of threads.
 */
int gd_spending_map(struct gd_plane share, const struct gd_image *im,
		    const struct gd_spending_conf *conf, struct gd_spending_result *result,
		    const struct gd_report *report, struct gd_err *err);

#endif
