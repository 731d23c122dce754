/* SPDX-License-Identifier: BSD-3-Clause */
/* How far an image is from a reference: relative mean squared error and its kin. */
#ifndef GD_RELMSE_H
#define GD_RELMSE_H

#include "buffers.h"

/* What the squared error of a channel is divided by; c is one channel of the reference r. */
enum gd_relmse_form {
	GD_REL_R2_EPS,		/* "r2+eps":    r_c^2 + eps		the default */
	GD_REL_R_EPS_2,		/* "(r+eps)2":  (|r_c| + eps)^2	pbrt's imgtool */
	GD_REL_LUM,		/* "lum":       Y(r)^2 + eps, Y of Rec. 709 */
	GD_REL_MEAN,		/* "mean":      (mean over channels of r)^2 + eps */
	GD_REL_HALF,		/* "half":      2 (r_c^2 + eps)	a common training loss */
	GD_REL_FORMS
};

struct gd_relmse_conf {
	double eps;		/* > 0, radiance squared ("(r+eps)2": radiance) */
	enum gd_relmse_form form;
	double trim;		/* share of the pixels left out of the trimmed mean, 0 .. 0.5 */
};
#define GD_RELMSE_DEFAULTS { .eps = 0.01, .form = GD_REL_R2_EPS, .trim = 0.001 }

/*
 * All planes are of one size. x is the image, n channels. The reference is r, or, free of its own
 * noise, two independent estimates a and b of it (halves); then r means their mean and r[] is
 * unused: E[(x - a)(x - b)] = (x - truth)^2 if the errors of a and b are independent of x and of
 * each other. mask.v may be NULL; else only pixels with mask >= 0.5 count.
 */
struct gd_relmse_in {
	int n;			/* 1 .. GD_LAYER_PLANES */
	bool halves;
	struct gd_plane x[GD_LAYER_PLANES], r[GD_LAYER_PLANES];
	struct gd_plane a[GD_LAYER_PLANES], b[GD_LAYER_PLANES];
	struct gd_plane mask;
};

/*
 * Let e be a pixel's error, the mean over its channels of (x - r)^2 / divisor, with halves of
 * (x - a)(x - b) / divisor. Values of x that are not finite enter every figure as 0, which is an
 * error of about 1 wherever the reference is bright; pixels whose reference is not finite are left
 * out.
 */
struct gd_relmse {
	double relmse;				/* mean of e */
	double channel[GD_LAYER_PLANES];	/* the same for each channel */
	double trimmed;				/* mean of e without the ntrimmed largest */
	double p50, p95, p99, max;		/* of e, nearest rank */
	double mse;			/* mean of (x - r)^2, with halves of (x - a)(x - b) */
	/* These three with r even where there are halves: they hold its noise. */
	double mae;			/* mean of |x - r| */
	double mape;			/* of |x - r| / (|r| + eps) */
	double smape;			/* of |x - r| / (|x| + |r| + eps) */
	double mean, reference;		/* means of x and r; the bias is their difference */
	size_t pixels, ntrimmed;	/* compared, left out of trimmed */
	size_t nonfinite;		/* compared pixels with a value of x that is not finite */
	size_t nonfinite_reference;	/* left out for the reference's sake */
};

const char *gd_relmse_form_name(enum gd_relmse_form form);
/* False if there is no form of that name. */
bool gd_relmse_form_find(const char *name, enum gd_relmse_form *form);
/* "(x - r)^2 / (r^2 + eps)"; halves: "(x - a)(x - b) / (r^2 + eps)". */
const char *gd_relmse_formula(enum gd_relmse_form form, bool halves);

/*
 * e   out  NULL, or h x w values of e in row order (NaN where a pixel is left out)
 * Sums are in double, in row order: the same for any number of threads.
 * GD_EARG, GD_ESHAPE (no channels, sizes differ), GD_ENUMERIC (no pixel to compare), GD_ENOMEM.
 */
int gd_relmse(struct gd_relmse *res, double *e, const struct gd_relmse_in *in,
	      const struct gd_relmse_conf *conf, struct gd_err *err);

/*
 * A map for the eye: root of the mean over channels of (x - r)^2 / divisor, the relative error of
 * each pixel. Against halves too r is their mean, with its noise: (x - a)(x - b) of one pixel alone
 * may be negative.
 * map   out  h x w; NaN where the pixel is left out or x is not finite
 */
int gd_relmse_map(struct gd_plane map, const struct gd_relmse_in *in,
		  const struct gd_relmse_conf *conf, struct gd_err *err);

struct gd_relmse_rank {
	double rho;	/* Spearman's, ties at their mean rank; NaN if either is constant */
	double ratio;		/* mean estimate / mean true squared error */
	size_t blocks;
};
/*
 * Does an estimate of the squared error (in->n planes est, each that of a channel of x) tell where
 * the error is? Both are averaged over blocks of side x side pixels (partial ones at the right and
 * lower border too) and over channels; the truth is (x - r)^2, with halves (x - a)(x - b).
 */
int gd_relmse_rank(struct gd_relmse_rank *res, const struct gd_relmse_in *in,
		   const struct gd_plane *est, int side, struct gd_err *err);

#endif
