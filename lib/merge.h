/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Several renders of one frame into one gd buffer, one input in memory at a time:
 *
 *	gd_merge_begin(&m, &conf, &err)
 *	for each input:       gd_merge_survey(m, header, "run0.exr", 0, &err)
 *	gd_merge_plan(m, &report, &err)
 *	for each input again: gd_merge_want(m, i, &im, &err), load its pixels,
 *	                      gd_merge_add(m, i, &im, &report, &err)
 *	gd_merge_finish(m, &out, &result, &report, &err)
 *	gd_merge_free(m)
 *
 * Let input p have n_p samples at a pixel and the means m_p there, each the mean of its n_p.
 * The merged mean is
 *	m = sum n_p m_p / n,  n = sum n_p.
 * Its variance, for a layer that carries variances v_p (of the mean) in every input:
 *	sum [ v_p n_p (n_p - 1) + n_p (m_p - m)^2 ] / (n (n - 1)),
 * which is what one render of n samples would have told; without sample counts, sum v_p / N^2 of N
 * inputs. For a layer without, from the spread of U independent parts u of n_u samples (inputs, or
 * the bins that they hold):
 *	sum n_u (m_u - m)^2 / ((U - 1) n).
 * All are unbiased when n_p does not depend on m_p.
 *
 * A gradient between pixels of a and b samples counts 2ab / (a + b), or what its channel dx.samples
 * says (pair0.samples ...): its variance is the sum of two that fall with one number each, and
 * without samples at one end there is none. One that counts 0 in all inputs is the
 * difference of the merged colours. The result tells these counts where they are not
 * 2ab / (a + b) of its samples.
 *
 * Inputs that tell the samples of either half (half0.samples, half1.samples) have these in their
 * even and odd bins, others as many in each. The result tells them where they are not the same
 * share of the samples in every pixel.
 */
#ifndef GD_MERGE_H
#define GD_MERGE_H

#include "buffers.h"
#include "names.h"

struct gd_merge_conf {
	struct gd_names_conf names;
	int bins;		/* to write; < 0: as gd_merge_plan() finds best; 0: none */
	bool halves;		/* write half0, half1: the even and the odd bins */
	bool own_edges;		/* a gradient has the samples of its own pixel, not of both it
				 * joins */
};

struct gd_merge_result {
	int inputs, bins;
	double samples;		/* per pixel, mean over the image; 0 if not known */
	size_t dropped;		/* pixels of inputs left out for NaN or Inf, of each layer */
	size_t empty;		/* pixels of the colour without any sample: 0 */
	size_t one_sided;	/* pixels with samples in the even or in the odd bins only */
	int twins;		/* inputs with the colours of an earlier one, bit by bit: no
				 * independent noise. Images of one colour are not counted */
	double bin_ratio;	/* samples of the fullest bin over those of the emptiest */
	double spread_ratio; /* standard deviation by the inputs' variances over that by the spread
			      * of the bins, in the mean over the image; 0 if not known */
};

struct gd_merge;

int gd_merge_begin(struct gd_merge **m, const struct gd_merge_conf *conf, struct gd_err *err);
void gd_merge_free(struct gd_merge *m);		/* takes NULL */

/*
 * Looks at an input's header. label names it in messages; spp is its sample count, 0: its channel
 * "samples" or an attribute tells. GD_ESHAPE if its data window is not that of the first or it
 * has no colour.
 */
int gd_merge_survey(struct gd_merge *m, const struct gd_image *im, const char *label, double spp,
		    struct gd_err *err);

/*
 * Decides layers, variances and bins. Bins: the inputs' own, bin by bin, where all hold the same
 * number; else one for each input up to 16; else 8 of nearly equal sample counts. conf.bins asks
 * for another number. GD_EARG if sample counts are needed and not known.
 */
int gd_merge_plan(struct gd_merge *m, const struct gd_report *report, struct gd_err *err);

/* Sets im's wants for input i. To be followed by loading and gd_merge_add() of that input. */
int gd_merge_want(struct gd_merge *m, int i, struct gd_image *im, struct gd_err *err);
int gd_merge_add(struct gd_merge *m, int i, struct gd_image *im, const struct gd_report *report,
		 struct gd_err *err);

/* Gives the merged buffer to out (which must be empty). result may be NULL. */
int gd_merge_finish(struct gd_merge *m, struct gd_image *out, struct gd_merge_result *result,
		    const struct gd_report *report, struct gd_err *err);

#endif
