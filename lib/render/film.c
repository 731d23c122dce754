/* SPDX-License-Identifier: BSD-3-Clause */
#include "render/film.h"

#include <float.h>
#include <stdlib.h>
#include <string.h>

static inline float narrow(double v)
{
	return (float)(v > FLT_MAX ? FLT_MAX : v < -FLT_MAX ? -FLT_MAX : v);
}

static struct gd_film shape(int w, int h, int bins, bool reuse)
{
	struct gd_film f = { .w = w, .h = h, .bins = bins > 1 ? bins : 0, .reuse = reuse };

	f.binned = reuse ? GD_FILM_BINNED : GD_FILM_MINE;
	f.total = f.binned + GD_FILM_G;
	f.floats = (size_t)(2 * f.total + f.bins * f.binned);
	f.counts = (size_t)(2 + 2 * f.bins);
	return f;
}

double gd_film_bytes(int w, int h, int bins, bool reuse)
{
	const struct gd_film f = shape(w, h, bins, reuse);

	return (double)w * h * (double)(f.floats * sizeof *f.v + f.counts * sizeof *f.count);
}

int gd_film_begin(struct gd_film *film, int w, int h, int bins, bool reuse, struct gd_err *err)
{
	const size_t n = (size_t)w * (size_t)h;

	*film = shape(w, h, bins, reuse);
	film->v = gd_alloc(n, film->floats * sizeof *film->v);
	film->count = gd_alloc(n, film->counts * sizeof *film->count);
	if (!film->v || !film->count)
		return gd_fail(err, GD_ENOMEM,
			       "out of memory: %d x %d pixels with %d bins take %.1f GB", w, h,
			       film->bins, 1e-9 * gd_film_bytes(w, h, bins, reuse));
#pragma omp parallel for schedule(static)
	for (int y = 0; y < h; y++) {
		memset(gd_film_mean(film, 0, y), 0, (size_t)w * film->floats * sizeof *film->v);
		memset(gd_film_count(film, 0, y), 0,
		       (size_t)w * film->counts * sizeof *film->count);
	}
	return GD_OK;
}

void gd_film_free(struct gd_film *film)
{
	free(film->v);
	free(film->count);
	*film = (struct gd_film){ 0 };
}

/* ---- one visit ---- */

void gd_visit_begin(struct gd_visit *v, const struct gd_film *film)
{
	v->n[0] = v->n[1] = 0;
	memset(v->mean, 0, sizeof v->mean);
	memset(v->square, 0, sizeof v->square);
	memset(v->bin_n, 0, sizeof v->bin_n);
	memset(v->bin, 0, (size_t)film->bins * sizeof v->bin[0]);
}

static inline void put(float *at, struct gd_v3 v)
{
	at[0] = v.x;
	at[1] = v.y;
	at[2] = v.z;
}

/* Values first to last - 1 of the n-th sample of their class; bin may be NULL. */
static inline void take(struct gd_visit *v, const float *value, int first, int last, uint32_t n,
			double *restrict bin)
{
	const double share = 1.0 / n;

	for (int i = first; i < last; i++) {
		const double d = (double)value[i] - v->mean[i];

		v->mean[i] += d * share;
		v->square[i] += d * ((double)value[i] - v->mean[i]);
	}
	for (int i = first; i < last && bin; i++)
		bin[i] += (double)value[i];
}

/* What the offset paths bring. */
static void take_offsets(struct gd_visit *v, const struct gd_film *film, float *value,
			 const struct gd_path_out *out, int n, const int *slot, double *bin)
{
	struct gd_v3 mine = { 0, 0, 0 };

	memset(value + GD_FILM_HALF, 0, (size_t)(film->binned - GD_FILM_HALF) * sizeof *value);
	for (int k = 0; k < n; k++) {
		put(value + GD_FILM_HALF + 3 * slot[k], out->half[k]);
		mine = gd_mad(mine, 1 / (float)n, out->mine[k]);
		if (film->reuse)
			put(value + GD_FILM_THEIRS + 3 * slot[k], out->theirs[k]);
	}
	if (film->reuse)
		put(value + GD_FILM_MINE, mine);
	take(v, value, GD_FILM_HALF, film->binned, ++v->n[1], bin);
}

void gd_visit_add(struct gd_visit *v, const struct gd_film *film, const struct gd_path_out *out,
		  int n, const int *slot, int bin)
{
	float value[GD_FILM_MOST], *g = value + film->binned;
	double *sums = film->bins ? v->bin[bin] : NULL;

	put(value, out->colour);
	put(g, out->albedo);
	put(g + 3, out->normal);
	put(g + 6, out->position);
	g[9] = out->z;
	if (n > 0) {
		take_offsets(v, film, value, out, n, slot, sums);
		v->bin_n[bin][1]++;
	}
	if (n == 0 || !film->reuse) {
		take(v, value, GD_FILM_COLOUR, GD_FILM_HALF, ++v->n[0], sums);
		v->bin_n[bin][0]++;
	}
	take(v, value, film->binned, film->total, gd_film_samples(film, v->n), NULL);
}

/* ---- joining visits ---- */

/* Values first to last - 1, of old samples so far and n new ones. */
static void join(const struct gd_film *film, float *mean, const struct gd_visit *v, int first,
		 int last, double old, double n)
{
	float *square = mean + film->total;

	if (!(n > 0))
		return;
	for (int i = first; i < last; i++) {
		const double d = v->mean[i] - (double)mean[i];

		square[i] = narrow((double)square[i] + v->square[i] + d * d * old * n / (old + n));
		mean[i] = narrow(old > 0 ? (double)mean[i] + d * n / (old + n) : v->mean[i]);
	}
}

static void join_bin(float *mean, const double *sum, int first, int last, double old, double n)
{
	for (int i = first; i < last && n > 0; i++)
		mean[i] = narrow(((double)mean[i] * old + sum[i]) / (old + n));
}

void gd_film_store(struct gd_film *film, int x, int y, const struct gd_visit *v)
{
	float *mean = gd_film_mean(film, x, y);
	uint32_t *count = gd_film_count(film, x, y);

	join(film, mean, v, GD_FILM_COLOUR, GD_FILM_HALF, count[0], v->n[0]);
	join(film, mean, v, GD_FILM_HALF, film->binned, count[1], v->n[1]);
	join(film, mean, v, film->binned, film->total, gd_film_samples(film, count),
	     gd_film_samples(film, v->n));
	count[0] += v->n[0];
	count[1] += v->n[1];
	for (int b = 0; b < film->bins; b++) {
		float *bin = gd_film_bin(film, x, y, b);
		uint32_t *old = count + 2 + 2 * b;
		const uint32_t *n = v->bin_n[b];

		join_bin(bin, v->bin[b], GD_FILM_COLOUR, GD_FILM_HALF, old[0], n[0]);
		join_bin(bin, v->bin[b], GD_FILM_HALF, film->binned, old[1], n[1]);
		old[0] += n[0];
		old[1] += n[1];
	}
}

/* ---- empty bins ---- */

/* Values first to last - 1 of the bins of one side, which are of a class. */
static void fill_side(const struct gd_film *film, int x, int y, int side, int class, int first,
		      int last)
{
	const uint32_t *count = gd_film_count(film, x, y);
	double all = 0;
	bool empty = false;

	for (int b = side; b < film->bins; b += 2) {
		all += count[2 + 2 * b + class];
		empty = empty || !count[2 + 2 * b + class];
	}
	if (!empty)
		return;
	for (int i = first; i < last; i++) {
		double sum = 0;
		float fill = gd_film_mean(film, x, y)[i];

		for (int b = side; b < film->bins; b += 2)
			sum += count[2 + 2 * b + class] * (double)gd_film_bin(film, x, y, b)[i];
		if (all > 0)
			fill = narrow(sum / all);
		for (int b = side; b < film->bins; b += 2)
			if (!count[2 + 2 * b + class])
				gd_film_bin(film, x, y, b)[i] = fill;
	}
}

void gd_film_fill_bins(struct gd_film *film)
{
	if (!film->bins)
		return;
#pragma omp parallel for schedule(static)
	for (int y = 0; y < film->h; y++)
		for (int x = 0; x < film->w; x++)
			for (int side = 0; side < 2; side++) {
				fill_side(film, x, y, side, 0, GD_FILM_COLOUR, GD_FILM_HALF);
				fill_side(film, x, y, side, 1, GD_FILM_HALF, film->binned);
			}
}
