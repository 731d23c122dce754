/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * The method as published (Back, Yoon, Moon 2018, section 5): features filtered by non-local means
 * where they have a variance, spikes taken out of the colour, one adaptive polynomial regression on
 * all of it, the spikes' energy given back.
 */
#ifndef GD_APR_PAPER_H
#define GD_APR_PAPER_H

#include <stdbool.h>

#include "apr.h"

enum gd_apr_spike_mode {
	GD_SPIKES_RETURN,	/* take them out, give their energy back around them */
	GD_SPIKES_DROP,		/* take them out: darker, less error */
	GD_SPIKES_KEEP		/* leave them in */
};

/*
 * A frame to denoise; planes of one size. Those of y, var, feat and feat_var are mended and
 * filtered in place.
 * y        ny planes: the colour R G B, then any that share its weights
 * var      variances of the colour's mean; v = NULL: found from the bins, else from the image
 * bin      nbin >= 2 bins of the colour, [b][c]; nbin may be 0
 * half     two independent halves of the colour, [0..1][c]; v = NULL: none. Used to measure how
 *          the noise of neighbouring pixels hangs together
 * feat     nfeat planes; feat_var may hold v = NULL for exact ones
 * layer    nfeat numbers: planes of one layer (the same number, side by side, at most 4) are
 *          filtered together, by the distance in all of them
 * filtered nfeat flags: the layer is not to be filtered (any more)
 */
struct gd_apr_frame {
	int ny, nbin, nfeat;
	struct gd_plane y[GD_APR_RHS], var[4];	/* the last one is not used */
	struct gd_plane (*bin)[3];
	struct gd_plane half[2][4];
	struct gd_plane feat[GD_APR_FEATURES], feat_var[GD_APR_FEATURES];
	int layer[GD_APR_FEATURES];
	bool filtered[GD_APR_FEATURES];
};

struct gd_apr_paper_result {
	size_t mended;		/* values that were NaN or Inf */
	int spikes, capped;	/* taken out; of those, given back only in part */
	double correlation;	/* as in struct gd_apr_conf */
};

/*
 * Mends all planes and finds variances where there are none (allocated into made, to be freed;
 * made = NULL: there stay none).
 */
int gd_apr_frame_mend(struct gd_apr_frame *frame, float *made[3], size_t *mended,
		      const struct gd_report *report, struct gd_err *err);

/* Filters the layers of features that carry a variance other than 0. */
int gd_apr_frame_filter(struct gd_apr_frame *frame, const struct gd_report *report,
			struct gd_err *err);

/*
 * All of it. out as for gd_apr_fit(), with 3 planes of mse. conf->correlation counts where the
 * frame has no halves. Returns what gd_apr_fit() and gd_nlm_run() return.
 */
int gd_apr_paper(const struct gd_apr_out *out, struct gd_apr_frame *frame,
		 const struct gd_apr_conf *conf, enum gd_apr_spike_mode spikes,
		 struct gd_apr_paper_result *result, const struct gd_report *report,
		 struct gd_err *err);

#endif
