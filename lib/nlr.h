/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * First-order regression with nonlinear weights, collaborative (Bitterli, Rousselle, Moon and
 * others 2016, section 4; Rousselle, Knaus, Zwicker 2012 for the distances). Around each pixel c,
 * the centre:
 *	d_c(i) = mean over patch offsets o and guide planes, with p = c + o and q = i + o, of
 *		min(1e4, ((g_p - g_q)^2 - v_p - min(v_p, v_q)) / (e + k^2 (v_p + v_q)))
 *	w_c(i) = exp(-max(0, d_c(i))) for i in the window, 0 where that is below 1e-4
 *	b_c    = argmin_b  sum_i w_c(i) m_i |y_i - b' z_i|^2 + sum_{j>0} (ridge sum_i w_c(i) m_i
 *		 + 1e-4 sum_i w_c(i) m_i z_ij^2) b_j^2,   z_i = [1 | f(i) - f(c)]
 *	out_i  = sum_c w_c(i) b_c' z_i / sum_c w_c(i)
 * Patches and windows are cut at the image's border; e = eps times the mean of the variances of the
 * three guide planes over the image (values beyond about a thousand times the median cut to that).
 */
#ifndef GD_NLR_H
#define GD_NLR_H

#include "gd.h"
#include "plane.h"

#define GD_NLR_FEATURES	16
#define GD_NLR_WINDOW	8	/* largest radius of the window */
#define GD_NLR_PATCH	4	/* largest radius of a patch */

struct gd_nlr_conf {
	int window;	/* radius of the window in pixels, 0 .. GD_NLR_WINDOW; 5: 11x11 */
	int patch;	/* radius of the patches in pixels, 0 .. GD_NLR_PATCH; 2: 5x5 */
	double k;	/* distance that counts as 1, in standard deviations, 0.01 .. 100 */
	double eps;	/* variance that is always there, relative to the guide's, 1e-10 .. 1 */
	double ridge;	/* pull of the slopes towards 0, 1e-6 .. 1: where the mean square of a
			 * feature about the centre is this much, its slope is halved */
};

#define GD_NLR_DEFAULTS ((struct gd_nlr_conf){ \
	.window = 5, .patch = 2, .k = 0.45, .eps = 1e-6, .ridge = 1e-3 })

/* All planes have one size. Inputs may be the same planes, the outputs overlap none but y. */
struct gd_nlr_in {
	struct gd_plane y[3];		/* to regress: radiance, scene-linear */
	struct gd_plane guide[3];	/* decides on the weights; may be y */
	struct gd_plane guide_var[3];	/* its variance, smoothed, unit squared; v = NULL: 0 */
	int nfeat;			/* 0 .. GD_NLR_FEATURES */
	struct gd_plane feat[GD_NLR_FEATURES];	/* range about 1; cut to -1000 .. 1000 */
	struct gd_plane weight;		/* m above, >= 0, any unit; v = NULL: 1 */
};

/*
 * out: the three fitted planes; they may be those of y. Only finite values come out. What comes in
 * and is not finite counts as 0, but for variances and weights that are infinite (very large) or
 * negative (0). A centre whose fit weights are all 0 predicts nothing; a pixel that nobody predicts
 * keeps its y. Scaling y scales the result; scaling the guide by s and its variances by s^2
 * does not change it. The bytes that come out do not depend on the number of threads.
 * With the default radii it takes about 23 bytes a pixel and 1 MiB a thread while it runs.
 * report may be NULL. Returns GD_OK, GD_EARG, GD_ESHAPE or GD_ENOMEM.
 */
int gd_nlr_run(const struct gd_plane out[3], const struct gd_nlr_in *in,
	       const struct gd_nlr_conf *conf, const struct gd_report *report, struct gd_err *err);

#endif
