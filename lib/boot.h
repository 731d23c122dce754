/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * The feature image: weighted least squares on gradients, bootstrap-aggregated over bins
 * (Back, Yoon, Moon 2018, algorithm 1). For each replicate t every pixel draws B of its B bins
 * with replacement (one draw for dx, dy and all channels; c_b times bin b):
 *	v(t) = sum c_b v_b / B,   var(t) = sum c_b (v_b - v(t))^2 / (B (B - 1)),
 *	f(t) = wls solution with weights 1 / (max(var(t), var / 10) + phi)
 * and f = mean of f(t), Var f = sum (f(t) - f)^2 / (T - 1). phi and the smoothing of the variances
 * are those of poisson.h, phi from the variances of the unresampled bins. Each f(t) has the mean of
 * the primal image, per connected part, else the variance would hold a random constant.
 *
 * Var f is dominated by slow drift that neighbouring pixels share. What matters to a window (and to
 * patch distances) is the rest: local = 3x3 box of the variance over t of f(t) - blur(f(t)).
 */
#ifndef GD_BOOT_H
#define GD_BOOT_H

#include <stdbool.h>
#include <stdint.h>

#include "gd.h"
#include "plane.h"

#define GD_BOOT_MAX_BINS 64

struct gd_boot_conf {
	int replicates;		/* T, 2 .. 1000 */
	uint64_t seed;
	double floor;		/* as in struct gd_poisson_conf */
	double smooth_px;	/* as in struct gd_poisson_conf */
	double tolerance;	/* relative residual of the solution from all bins */
	/*
	 * Of each replicate's difference to it, relative. At 0.1 the variance is off by 24 to 35 %,
	 * where ten replicates leave it uncertain by 47 %, and f by less than 1 % of its error.
	 */
	double tolerance_t;
	double local_px;	/* standard deviation of the blur that separates drift from noise */
};
#define GD_BOOT_DEFAULTS { 10, 1, 0.1, 1.0, 1e-4, 1e-1, 2.0 }

/*
 * Any set of bins: dx[b][c], dy[b][c] for b < bins, c < n; planes of w x h, all of one size.
 * A non-finite bin value is replaced by the mean of the finite ones of its pixel; none: weight 0.
 */
struct gd_boot_in {
	int n;					/* channels, 1 .. 3 */
	int bins;				/* 1 .. GD_BOOT_MAX_BINS */
	const struct gd_plane (*dx)[3], (*dy)[3];
	struct gd_plane primal[3];		/* v = NULL: mean 0 */
};

/* Planes of w x h that overlap nothing; var and local may have v = NULL. Always finite. */
struct gd_boot_out {
	struct gd_plane mean[3], var[3], local[3];
};

struct gd_boot_result {
	int iterations;		/* of conjugate gradients, all systems together */
	double residual;	/* worst relative residual reached, against its tolerance: <= 1 is
				   converged */
	int parts;		/* connected parts of the unresampled problem */
	double phi;		/* radiance squared */
};

/*
 * Bootstrap aggregation. One bin: no draws are possible; mean is the ols solution and both
 * variances are 7x7 means of the squared high-pass part of it, which overestimates.
 * Returns GD_OK, GD_EARG, GD_ESHAPE, GD_ENOMEM. Independent of the number of threads.
 */
int gd_boot_run(const struct gd_boot_out *out, const struct gd_boot_in *in,
		const struct gd_boot_conf *conf, struct gd_boot_result *result,
		const struct gd_report *report, struct gd_err *err);

/*
 * The same without resampling: wls with the mean and the variance of the mean of the given bins
 * (ols for one bin). One solve. This is the feature of one half in cross-fitting.
 */
int gd_boot_plain(const struct gd_plane *mean, const struct gd_boot_in *in,
		  const struct gd_boot_conf *conf, struct gd_boot_result *result,
		  const struct gd_report *report, struct gd_err *err);

/*
 * local[c], as above, from two independent solutions a and b whose average is the feature: 5x5 mean
 * of ((a - b) - blur(a - b))^2 / 4, the variance of the average's high-pass part.
 */
int gd_boot_halves(const struct gd_plane *local, const struct gd_plane *a, const struct gd_plane *b,
		   int n, double local_px, struct gd_err *err);

/* The same, roughly, of a solution of equal weights, from the variances of its gradients. */
void gd_boot_edges(struct gd_plane local, struct gd_plane dxvar, struct gd_plane dyvar);

#endif
