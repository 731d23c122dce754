/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Non-local means guided by the variance: a pixel becomes the mean of the pixels of a window around
 * it, weighted by how well the patches around both agree in the guide, once the noise that its
 * variances predict is taken away (Rousselle, Knaus, Zwicker 2012, section 4; the parameters are
 * those of Back, Yoon, Moon 2018, section 4). With p the pixel, q another, o an offset in the
 * patch, and d for each guide plane:
 *	d(p,q) = min(1e7, ((g_p - g_q)^2 - v_p - min(v_p, v_q)) / (e + k^2 (v_p + v_q)))
 *	w(p,q) = exp(-max(0, mean over planes and o of d(p+o, q+o)))
 *	out_p  = sum_q w u_q / sum_q w		out_var_p = sum_q w^2 var_q / (sum_q w)^2
 * Patches and windows are cut at the image's border; e = eps times the variance of the guide plane
 * over the image (between its percentiles 1 and 99, so that a firefly does not blind it).
 */
#ifndef GD_NLM_H
#define GD_NLM_H

#include <stdbool.h>

#include "gd.h"
#include "plane.h"

#define GD_NLM_PLANES 16	/* most guide planes, and most input planes */
#define GD_NLM_FRAMES 16	/* most other frames */

struct gd_nlm_conf {
	int patch;	/* radius of the patches in pixels, 0 .. 16; 3: 7x7 */
	int window;	/* radius of the window in pixels, 0 .. 32; 5: 11x11 */
	double k;	/* distance that counts as 1, in standard deviations, 0.01 .. 100 */
	double eps;	/* variance that is always there, relative to the guide's, 1e-12 .. 1 */
	/* A pixel stays as it is where the variances of all guide planes are at most this, relative
	 * to the guides' own, and those of five neighbours are not more; 0 .. 1; 0: every pixel is
	 * filtered. */
	double negligible;
	bool round;	/* the window is a disc: dx^2 + dy^2 <= window^2 + 1 */
};

#define GD_NLM_DEFAULTS ((struct gd_nlm_conf){ .patch = 3, .window = 5, .k = 0.5, .eps = 1e-6 })

/*
 * For noisy features of a regression, quickly: it takes averages itself, so that a window of 21
 * pixels is enough, and feels no noise of 3 % of what a feature does over the image. On scenes with
 * noise at edges and through a lens the denoised image has 2.5 % less error than with all pixels
 * filtered at k 1 in windows of 11x11 (none is more than 0.7 % worse), in a fifth of the time.
 */
#define GD_NLM_PREFILTER ((struct gd_nlm_conf){ .patch = 3, .window = 2, .k = 1.5, .eps = 1e-4, \
	.negligible = 1e-3, .round = true })

/*
 * What to filter and by which weights. All planes have one size; v = NULL in a variance plane
 * means exact (variance 0). For a plain filter the guide is the input; for a crossed one, whose
 * weights do not know the noise that they average, it is the other half of the samples.
 * Outputs must not overlap inputs, guides or each other; out_var may be NULL, and so may v in some
 * of its planes: that variance is not wanted.
 */
struct gd_nlm_job {
	int nguide, n;			/* 1 .. GD_NLM_PLANES */
	const struct gd_plane *guide, *guide_var;	/* nguide planes, any unit; its square */
	const struct gd_plane *in, *in_var;	/* n planes; in_var may be NULL if out_var is */
	const struct gd_plane *out, *out_var;	/* n planes */
};

/*
 * Any float goes in, only finite ones come out: a value that is not finite counts as the median of
 * its finite neighbours (0 if there are none) with the largest of their variances; a variance below
 * 0 counts as 0, an infinite one as the largest float. Scaling a plane scales the result.
 * The bytes that come out do not depend on the number of threads.
 * report may be NULL. Returns GD_OK, GD_EARG, GD_ESHAPE or GD_ENOMEM.
 */
int gd_nlm_run(const struct gd_nlm_job *job, const struct gd_nlm_conf *conf,
	       const struct gd_report *report, struct gd_err *err);

/* Another frame: planes of the same kinds and sizes as those of the job. */
struct gd_nlm_frame {
	const struct gd_plane *guide, *guide_var, *in, *in_var;
	struct gd_plane known;	/* what its pixels count, 0 .. 1; v = NULL: 1 */
	int window;	/* radius of the window in this frame, 0 .. that of the job's own */
};

/*
 * The same with windows that span other frames, too (0 .. GD_NLM_FRAMES): q is any pixel in the
 * window in any frame, p always one of the job's (Back, Yoon, Moon 2018, section 4).
 */
int gd_nlm_frames(const struct gd_nlm_job *job, const struct gd_nlm_frame *frame, int frames,
		  const struct gd_nlm_conf *conf, const struct gd_report *report,
		  struct gd_err *err);

#endif
