/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * From a scene to a gd buffer: which samples each pixel gets, on all threads, and what they add up
 * to.
 *
 * Sample s of a pixel goes to bin s mod bins. Of the samples of a pixel in a bin the first
 * ceil(share * number) trace offset paths, so that with a share above 0 each bin that has a sample
 * has one that does. The gradient of an edge is the difference of two means, one over the samples
 * of each of its pixels that trace offset paths (path.h), whatever their numbers. Where one of the
 * two has none, in the image or in a bin, it is the difference of the two colours there: unbiased,
 * too, with the colours' variances.
 *
 * Pixels are computed one by one from random numbers of their own: the same seed gives the same
 * bits with any number of threads, and a crop the same pixels as the whole (but for the gradients
 * at its edge).
 */
#ifndef GD_RENDER_RENDER_H
#define GD_RENDER_RENDER_H

#include "image.h"
#include "pairs.h"
#include "render/path.h"

#define GD_RENDER_BINS 64

struct gd_render_conf {
	int w, h;			/* of the whole image */
	struct gd_box crop;		/* inclusive; what is rendered and becomes the data window */
	int spp;			/* samples a pixel, unless counts is given; >= 1 */
	struct gd_plane counts;		/* of the crop's size, v = NULL: spp everywhere; whole numbers >= 0 */
	double share;			/* of the samples that trace offset paths, 0 .. 1 */
	struct gd_plane shares;		/* the same for each pixel of the crop; v = NULL: share */
	const struct gd_pairs *pairs;	/* gradients along these instead of dx and dy, or NULL */
	int bins;			/* 2 .. GD_RENDER_BINS; 0: none are written */
	double seconds;			/* > 0: stops at the end of the first pass after so long; passes go on
					   beyond spp until then. 0: no limit */
	bool reuse;			/* the colour uses the offset paths of the neighbours, too */
	uint64_t seed;
	struct gd_path_conf path;
};

/*
 * Fills im (must be empty) with R G B, variance, dx, dy (or pairK), their variances, albedo, N, Z,
 * P with variances, samples (where they differ), bins, half0.samples half1.samples (where they
 * differ), and the attributes gd:samplesPerPixel, gd:bins, gd:renderSeconds (CPU seconds).
 * Without any gradient sample (share 0 everywhere) there are no gradients.
 * Progress is told with the stage's name and the share that is done.
 */
int gd_render(struct gd_image *im, const struct gd_scene *scene, const struct gd_render_conf *conf,
	      const struct gd_report *report, struct gd_err *err);

#endif
