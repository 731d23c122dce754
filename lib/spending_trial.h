/* SPDX-License-Identifier: BSD-3-Clause */
/* Either half of a buffer's bins, denoised with gradients and without: what spending.c compares. */
#ifndef GD_SPENDING_TRIAL_H
#define GD_SPENDING_TRIAL_H

#include "gd.h"
#include "image.h"

struct gd_trial {
	struct gd_image half[2];	/* R G B: the mean of the half's bins */
	struct gd_image with[2];	/* R G B denoised, and error.R G B: with the feature */
	struct gd_image without[2];	/* with G-buffers alone */
};

/* Bins that colour and gradients of im have; GD_ESHAPE names what is missing. */
int gd_trial_bins(int *bins, const struct gd_image *im, struct gd_err *err);

/* Marks what gd_trial_run() reads. */
int gd_trial_want(struct gd_image *im, struct gd_err *err);

/* Fills t, which must be empty; to be freed in any case. */
int gd_trial_run(struct gd_trial *t, const struct gd_image *im, const struct gd_report *report,
		 struct gd_err *err);
void gd_trial_free(struct gd_trial *t);

#endif
