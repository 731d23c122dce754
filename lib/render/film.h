/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Where samples add up: for each pixel of the crop the mean and the summed squared deviations of
 * everything a sample brings, and the means of its bins.
 *
 * A thread collects the samples of one visit to a pixel in a struct gd_visit, in double; storing it
 * joins it to what the pixel has (Chan, Golub and LeVeque 1983), in float: one visit is exact to a
 * rounding, several differ from it by a few. What overflows float is stored as the largest float.
 */
#ifndef GD_RENDER_FILM_H
#define GD_RENDER_FILM_H

#include <stdint.h>

#include "render/plan.h"

/* What a sample brings; offsets of floats. The first film->binned of them are kept of bins, too. */
enum {
	GD_FILM_COLOUR = 0,			/* 3, of samples of class 0 */
	GD_FILM_HALF = 3,			/* 3 of each edge, as gd_plan_edges() has them */
	GD_FILM_MINE = GD_FILM_HALF + 3 * GD_PAIRS,	/* 3, mean over edges; only with reuse */
	GD_FILM_THEIRS = GD_FILM_MINE + 3,	/* 3 of each edge; only with reuse */
	GD_FILM_BINNED = GD_FILM_THEIRS + 3 * GD_PAIRS,
	GD_FILM_G = 10,				/* albedo, N, P, Z; behind what bins keep */
	GD_FILM_MOST = GD_FILM_BINNED + GD_FILM_G
};

/*
 * Counts are of two classes: 0, samples for the colour, and 1, samples that trace offset paths.
 * Each sample is of class 0, and those that trace of class 1 as well; with reuse of one of the two.
 */
struct gd_film {
	int w, h, bins;			/* bins: 0, or 2 .. GD_RENDER_BINS */
	bool reuse;
	int binned, total;		/* floats of a mean: those that bins keep, and all */
	size_t floats, counts;		/* of a pixel */
	float *v;			/* mean, squares, mean of each bin */
	uint32_t *count;		/* 2, and 2 of each bin */
};

/* Bytes that a film of that size takes. */
double gd_film_bytes(int w, int h, int bins, bool reuse);

/* GD_ENOMEM. film must be { 0 }; gd_film_free() takes it in any case. */
int gd_film_begin(struct gd_film *film, int w, int h, int bins, bool reuse, struct gd_err *err);
void gd_film_free(struct gd_film *film);

struct gd_visit {
	uint32_t n[2];
	double mean[GD_FILM_MOST], square[GD_FILM_MOST];
	uint32_t bin_n[GD_RENDER_BINS][2];
	double bin[GD_RENDER_BINS][GD_FILM_BINNED];	/* sums */
};

void gd_visit_begin(struct gd_visit *v, const struct gd_film *film);

/* A sample for bin (without bins: 0), that traced n offset paths; the k-th along edge slot[k]. */
void gd_visit_add(struct gd_visit *v, const struct gd_film *film, const struct gd_path_out *out,
		  int n, const int *slot, int bin);

void gd_film_store(struct gd_film *film, int x, int y, const struct gd_visit *v);

/*
 * Once all is stored: a bin without a sample of its class takes the mean of the bins on its side,
 * the even or the odd ones, and if these have none, the mean of the pixel.
 */
void gd_film_fill_bins(struct gd_film *film);

static inline size_t gd_film_index(const struct gd_film *film, int x, int y)
{
	return (size_t)y * (size_t)film->w + (size_t)x;
}

static inline float *gd_film_mean(const struct gd_film *film, int x, int y)
{
	return film->v + gd_film_index(film, x, y) * film->floats;
}

static inline float *gd_film_square(const struct gd_film *film, int x, int y)
{
	return gd_film_mean(film, x, y) + film->total;
}

static inline float *gd_film_bin(const struct gd_film *film, int x, int y, int b)
{
	return gd_film_mean(film, x, y) + 2 * film->total + b * film->binned;
}

static inline uint32_t *gd_film_count(const struct gd_film *film, int x, int y)
{
	return film->count + gd_film_index(film, x, y) * film->counts;
}

/* Samples of a pixel, from its counts or those of a bin: count + 2 + 2 b. */
static inline uint32_t gd_film_samples(const struct gd_film *film, const uint32_t *count)
{
	return count[0] + (film->reuse ? count[1] : 0);
}

/* The variance of mean i of a pixel, which has n samples; negative: unknown. */
static inline double gd_film_variance(const struct gd_film *film, int x, int y, int i, uint32_t n)
{
	return n < 2 ? -1 : (double)gd_film_square(film, x, y)[i] / ((double)n * (n - 1));
}

/* --- develop.c --- */

/* Adds to im the channels that gd_film_develop() will fill, so that memory is known to suffice. */
int gd_film_channels(struct gd_image *im, const struct gd_plan *plan, struct gd_err *err);

/* The film as gd-buffers(5) has it; drops channels that say nothing. Spoils empty bins. */
int gd_film_develop(struct gd_image *im, struct gd_film *film, const struct gd_plan *plan,
		    struct gd_err *err);

/*
 * An edge between pixels of a and b samples is worth as many as their harmonic mean: its variance
 * is the sum of two that fall with one number each.
 */
static inline double gd_film_worth(double a, double b)
{
	return a > 0 && b > 0 ? 2 * a * b / (a + b) : 0;
}

#endif
