/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * From a scene to a gd buffer: which samples each pixel gets, on all threads, and what they add up
 * to.
 *
 * Sample s of a pixel goes to bin s mod bins. Of the samples of a pixel in a bin a given share
 * traces offset paths, rounded up: ceil(share * number), so that with a share above 0 each bin that
 * has a sample has one that does. (With as many bins as samples any share is all.)
 *
 * The gradient of an edge is the difference of two means, one over the samples of each of its
 * pixels that trace offset paths (path.h), whatever their numbers: unbiased, as the ratio r that
 * both use is known before a sample is drawn, and best where it is that of these numbers. Where one
 * of the two traces none the gradient is the difference of the two colours, unbiased, too, and has
 * the variances of both; nobody traces offset paths along such an edge. Where one of the two has no
 * sample at all there is no gradient: 0, worth 0 samples.
 *
 * A bin without samples at a pixel takes the mean of those on its side, the even or the odd ones,
 * and if these have none, the mean of the pixel: as gd_merge does.
 *
 * Variances are those of means, from all samples. A pixel with one sample has none to tell: it
 * gets the mean variance of one sample over the image, and so does one without, by as many samples
 * as it has. If no pixel has two samples there are no variances.
 *
 * Sample i lies at the same position in every pixel, one of a sequence that fills the pixel evenly
 * in each bin and half (all of them; those that trace offset paths need not, if they are few); the
 * sequences of the halves are independent. With a pinhole, offset paths
 * then begin at the first vertices that the base paths of their pixels have found, for no ray of
 * their own.
 *
 * Beyond that pixels are computed one by one from random numbers of their own: the same seed gives
 * the same bits with any number of threads, and a crop the same pixels as the whole (but for the
 * gradients at its edge, with reuse the colours there, and variances that a pixel has none of its
 * own to tell). A limit of time leaves the number of samples to the clock.
 */
#ifndef GD_RENDER_RENDER_H
#define GD_RENDER_RENDER_H

#include "image.h"
#include "pairs.h"
#include "render/path.h"

#define GD_RENDER_BINS 64
#define GD_RENDER_SAMPLES 16777216	/* most of a pixel: what a float counts by ones */

struct gd_render_conf {
	int w, h;			/* of the whole image */
	struct gd_box crop;		/* inclusive; what is rendered, and the data window */
	int spp;			/* samples a pixel, unless counts is given; >= 1. With
					   seconds: the most, 0: no matter how many */
	struct gd_plane counts;		/* of the crop's size, whole numbers >= 0; v = NULL: spp */
	double share;			/* of the samples that trace offset paths, 0 .. 1 */
	struct gd_plane shares;		/* the same for each pixel of the crop; v = NULL: share */
	const struct gd_pairs *pairs;	/* gradients along these instead of dx and dy, or NULL;
					   of the size of the whole image or of the crop, none
					   longer than GD_PAIR_REACH either way */
	int bins;			/* 2 .. GD_RENDER_BINS; 0: none are written */
	double seconds;			/* > 0: renders as many rounds, of one sample a pixel or of
					   what counts has, as can be expected to end in that time,
					   and one at least. 0: no limit, and one round of spp */
	bool reuse;			/* the colour uses the offset paths of the neighbours, too:
					   the mean over the edges of E_i[mine] + E_j[theirs] */
	uint64_t seed;
	struct gd_path_conf path;
};

/* What makes a sample: gd_path_trace() for a scene; tests have their own. */
typedef void gd_render_sample(const void *user, const struct gd_path_conf *conf,
			      const struct gd_path_in *in, struct gd_draw *draw,
			      struct gd_path_out *out);

/*
 * Fills im (must be empty) with R G B, variance, dx, dy (or pairK), their variances, albedo, N, Z,
 * P with variances, bins, samples, half0.samples and half1.samples, dx.samples and dy.samples (all
 * of these where they say something: gd-buffers(5)), and the attributes gd:samplesPerPixel,
 * gd:bins, gd:renderSeconds (CPU seconds of all threads).
 * Without any gradient sample (share 0 everywhere) there are no gradients.
 * Progress is told with the share that is done, by the calling thread, from between its samples.
 * All memory is taken before the first sample. Returns GD_OK, GD_EARG (what does not fit together,
 * or counts and shares out of range), GD_ENOMEM.
 */
int gd_render(struct gd_image *im, const struct gd_scene *scene, const struct gd_render_conf *conf,
	      const struct gd_report *report, struct gd_err *err);
int gd_render_samples(struct gd_image *im, gd_render_sample *sample, const void *user,
		      const struct gd_render_conf *conf, const struct gd_report *report,
		      struct gd_err *err);

/* Bytes that a render takes beside the scene. */
double gd_render_bytes(const struct gd_render_conf *conf);

#endif
