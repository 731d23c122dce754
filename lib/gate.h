/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Which of two cross-fitted estimates of one image to believe where, by the samples themselves.
 *
 * Estimate a leans on fewer regressors than b. Of either half h the residuals of its own samples
 * y_h are compared; what explains them comes from the other half and does not know their noise, the
 * coefficients do, and more of it where there are more of them: by the leverage of the regressors
 * that only b has. With d = a_h - b_h the mixture b + s d that errs least has
 *	s = sum u (d (y_h - b_h) + leverage v_h) / sum u d^2,
 *	u = samples / (l^2 + (level / 10)^2),	l = luminance of the estimates of the other half,
 * over the neighbourhood (a Gaussian of 5 pixels), both halves and the channels; v_h is the
 * variance of y_h, the share of the other half times the squared difference of the halves. Without
 * the last term s would be too small: b follows the noise by as much more. (That is Mallows' C_p,
 * for a mixture.) A neighbourhood that tells little follows the image.
 */
#ifndef GD_GATE_H
#define GD_GATE_H

#include "crossfit.h"

/*
 * in        as it was fitted; has halves
 * a, b      estimates from half 0 and half 1; three planes or more each, the colour first
 * leverage  variance that the regressors which only b has make of a pixel's variance 1, in the
 *	     pixel itself; for noise that hangs together that of gd_apr_correlation() times as much
 */
struct gd_gate {
	const struct gd_crossfit_in *in;
	const struct gd_plane *a[2], *b[2];
	double leverage;
};

/*
 * share: what to take of a, 0 to 1, the rest of b; 0.5 where they do not differ anywhere. *mean:
 * that of the image. Work space: two planes.
 * Returns GD_OK, GD_ENOMEM. The result does not depend on the number of threads, and not on the
 * scale of the image.
 */
int gd_gate_map(struct gd_plane share, double *mean, const struct gd_gate *gate,
		const struct gd_plane spare[2], struct gd_err *err);

/*
 * b[half] of n planes becomes the mixture. square: what gd_halves_add() left for the first three
 * planes of both estimates' models, each about its own mean and as many of a as of b; becomes that
 * about the mixture.
 */
void gd_gate_mix(const struct gd_plane *b, const struct gd_plane *a, int n, struct gd_plane share,
		 const struct gd_plane square[3], int models);

#endif
