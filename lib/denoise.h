/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * A buffer of gd-buffers(5) in, a clean image with its estimated error out: chooses the channels,
 * mends what is no number, filters noisy features, and runs one of
 *	several regressions on pilots, features and G-buffers (crossfit.h), the default:
 *	cross-fitted where the samples come in halves or bins; over other frames, too
 *	one adaptive polynomial regression on all samples (apr_paper.h)
 *	sparse linear predictions (lwrfit.h), cross-fitted alike
 *	sparse linear predictions of all samples, as published (lwr.h)
 * and filters the result along time (temporal.h), if asked for.
 */
#ifndef GD_DENOISE_H
#define GD_DENOISE_H

#include <stdbool.h>

#include "apr_paper.h"
#include "buffers.h"
#include "crossfit.h"
#include "lwr.h"
#include "temporal.h"

enum gd_denoise_method {
	GD_DENOISE_CROSSFIT,	/* several regressions, of either half of the samples */
	GD_DENOISE_SINGLE,	/* one regression on all samples */
	GD_DENOISE_LWR,		/* linear predictions, of either half of the samples */
	GD_DENOISE_LWR_WHOLE	/* linear predictions of all samples, noisy features as they are */
};

struct gd_denoise_conf {
	enum gd_denoise_method method;
	struct gd_apr_conf apr;		/* of the one regression, as are the spikes */
	enum gd_apr_spike_mode spikes;
	struct gd_lwr_conf lwr;		/* of the linear predictions */
	bool sequence;			/* filter along time, too; needs the layer P */
	const struct gd_image *previous; /* state of the frame before, or NULL: the first */
	struct gd_temporal_conf time;	/* of the filter along time */
	int nneighbour;			/* other frames, at most GD_CROSSFIT_FRAMES */
	struct gd_image *neighbour;	/* used up; marked by gd_denoise_want_neighbour() */
	bool fast;			/* cross-fitted: one model of either half */
	bool no_filter;			/* features are taken as they are */
	bool keep;			/* what was used stays in the image, as it was read */
	const char *features;		/* layers, "albedo,N,feature"; or "auto", "none" */
	const char *layers;		/* to denoise along with the colour, or NULL */
};
#define GD_DENOISE_DEFAULTS ((struct gd_denoise_conf){ \
	.apr = GD_APR_DEFAULTS, .spikes = GD_SPIKES_RETURN, .lwr = GD_LWR_DEFAULTS, \
	.time = GD_TEMPORAL_DEFAULTS, .features = "auto" })

struct gd_denoise_result {
	bool crossfit;			/* a method that takes halves apart, */
	bool halves;			/* and the samples came in halves */
	size_t mended;			/* values that were NaN or Inf */
	int spikes;			/* of the one regression */
	size_t models;			/* averaged; linear predictions: built, for all halves */
	double share;			/* of these, for a pixel and half */
	double mean_radius;		/* of their windows */
	double mean_features;		/* in use, over the pixels */
	double followed;		/* share of pixels known from the frame before */
	double mean_frames;		/* that a pixel was followed */
	double filter_seconds, gather_seconds, pilot_seconds, fit_seconds, time_seconds;
};

/*
 * Marks what gd_denoise_run() reads and what it does not hand on, in an image of which only the
 * header is known. GD_ESHAPE names a channel or layer that is missing.
 */
int gd_denoise_want(struct gd_image *im, const struct gd_denoise_conf *conf, struct gd_err *err);

/*
 * The same for a neighbour in the sequence, of which only what is used is to be read; im after
 * gd_denoise_want(), before its pixels are there. GD_ESHAPE: its size or its layers differ.
 */
int gd_denoise_want_neighbour(struct gd_image *other, const struct gd_image *im,
			      const struct gd_denoise_conf *conf, struct gd_err *err);

/*
 * Replaces R G B (and the layers), adds error.* and, with several models, model.spread (with one
 * regression model.order and model.columns; with linear predictions model.radius, model.features,
 * model.centre and, of halves, model.spread; in a sequence state.* for the next frame), drops what
 * was used. All outputs are finite.
 * Halves hold equal shares of the samples but where the attribute gd:bins, or the bins they are
 * made of, are odd in number.
 * Layers that add up to the colour do so afterwards; those that come without halves or bins of
 * their own make the colour be smoothed whole, too, with the weights that the halves gave.
 * Returns GD_OK, GD_EARG, GD_ESHAPE, GD_ENOMEM.
 */
int gd_denoise_run(struct gd_image *im, const struct gd_denoise_conf *conf,
		   struct gd_denoise_result *result, const struct gd_report *report,
		   struct gd_err *err);

#endif
