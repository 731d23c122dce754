/* SPDX-License-Identifier: BSD-3-Clause */
#include "merge.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "merge_state.h"

static inline double at(const struct gd_count *c, int x, int y)
{
	return c->plane.v ? (double)gd_row(c->plane, y)[x] : c->all;
}

static inline float narrow(double v)
{
	return (float)(v > FLT_MAX ? FLT_MAX : v < -FLT_MAX ? -FLT_MAX : v);
}

/*
 * The variance of the mean from the collected squares; negative where one part alone tells nothing.
 */
static double variance(const struct merge_layer *l, bool counted, double m2, int x, int y)
{
	double n = at(&l->count, x, y), parts = at(&l->parts, x, y);

	if (!(n > 0))
		return -1;
	if (l->spread)
		return parts > 1 ? m2 / ((parts - 1) * n) : -1;
	if (!counted)
		return m2 / (n * n);
	return n > 1 ? m2 / (n * (n - 1)) : -1;
}

/*
 * Turns the squares of channel c into variances. A pixel with a single part gets the mean variance
 * of one sample over the image, divided by its own samples: 0 would mean that it is exact. Returns
 * the number of such pixels, -1 if no pixel knows its variance, -2 if memory is short.
 */
static long finish_variance(struct gd_merge *m, struct merge_layer *l, int c)
{
	double *sum = calloc((size_t)m->h, sizeof *sum), total = 0;
	long *known = calloc((size_t)m->h, sizeof *known), nknown = 0;
	long all = (long)m->w * m->h;

	if (!sum || !known) {
		free(sum);
		free(known);
		return -2;
	}
#pragma omp parallel for schedule(static) if (GD_ACCUM_MANY(m->weight))
	for (int y = 0; y < m->h; y++) {
		float *row = gd_row(l->m2[c], y);

		for (int x = 0; x < m->w; x++) {
			double v = variance(l, m->counted, (double)row[x], x, y);

			row[x] = v < 0 ? -1 : narrow(v);
			if (v < 0)
				continue;
			sum[y] += (double)row[x] * at(&l->count, x, y);
			known[y]++;
		}
	}
	for (int y = 0; y < m->h; y++) {
		total += sum[y];
		nknown += known[y];
	}
	for (int y = 0; y < m->h && nknown && nknown < all; y++)
		for (int x = 0; x < m->w; x++) {
			double n = at(&l->count, x, y);
			float *v = gd_row(l->m2[c], y) + x;

			if (*v < 0)
				*v = narrow(total / (double)nknown / (n > 0 ? n : 1));
		}
	free(sum);
	free(known);
	return nknown ? all - nknown : -1;
}

static bool all_zero(struct gd_plane p)
{
	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++)
			if (gd_row(p, y)[x] != 0)
				return false;
	return true;
}

/* Drops the channel whose pixels are p's. */
static void drop_plane(struct gd_image *im, struct gd_plane *p)
{
	for (int i = 0; i < im->nchan; i++)
		if (im->chan[i].v && im->chan[i].v == p->v) {
			gd_image_drop(im, im->chan[i].name);
			break;
		}
	p->v = NULL;
}

static int finish_layer_variance(struct gd_merge *m, struct merge_layer *l,
				 const struct gd_report *report, struct gd_err *err)
{
	const char *name = *l->name ? l->name : "the colour";
	bool exact = !l->binned && !l->half, unknown = false;
	long alone = 0;

	for (int c = 0; c < l->n; c++) {
		long n = finish_variance(m, l, c);

		if (n == -2)
			return gd_fail(err, GD_ENOMEM, "out of memory");
		unknown = unknown || n == -1;
		alone = n > alone ? n : alone;
		exact = exact && all_zero(l->m2[c]);
	}
	if (alone)
		gd_note(report,
			"%s: %ld pixels have one part only; their variance is the image's mean",
			name, alone);
	for (int c = 0; (exact || unknown) && c < l->n; c++)
		drop_plane(&m->out, &l->m2[c]);
	if (exact && !unknown)
		gd_note(report, "%s: without noise, no variance is written", name);
	if (exact || unknown)
		l->has_variance = false;
	return GD_OK;
}

/* Samples that the even (0) or odd (1) bins of a layer have at a pixel. */
static double side_samples(const struct gd_merge *m, const struct merge_layer *l, int side, int x,
			   int y)
{
	double n = 0;

	for (int b = side; b < m->bins; b += 2)
		n += at(&l->bin_count[b], x, y);
	return n;
}

/* The mean of a side's bins at a pixel; of all samples, if it has none. */
static float side_mean(const struct gd_merge *m, const struct merge_layer *l, int c, int side,
		       int x, int y)
{
	double sum = 0, n = side_samples(m, l, side, x, y);

	for (int b = side; b < m->bins && n > 0; b += 2)
		sum += at(&l->bin_count[b], x, y) / n * (double)gd_row(l->bin[b][c], y)[x];
	return n > 0 ? narrow(sum) : gd_row(l->mean[c], y)[x];
}

/*
 * Bins that have no part at a pixel take the mean of those on their side, so that the halves stay
 * independent; or else the mean of all.
 */
static void finish_bins(struct gd_merge *m, struct merge_layer *l)
{
	for (int b = 0; l->bin_count && b < m->bins; b++) {
		if (!l->bin_count[b].plane.v && l->bin_count[b].all > 0)
			continue;
#pragma omp parallel for schedule(static) if (GD_ACCUM_MANY(m->weight))
		for (int y = 0; y < m->h; y++)
			for (int x = 0; x < m->w; x++)
				for (int c = 0; c < l->n && !(at(&l->bin_count[b], x, y) > 0); c++)
					gd_row(l->bin[b][c], y)[x] =
						side_mean(m, l, c, b % 2, x, y);
	}
}

/* A gradient that no input has traced at a pixel, between two that have samples. */
static bool untraced(const struct gd_merge *m, const struct merge_layer *l,
		     const struct merge_layer *colour, int x, int y, int *u, int *v)
{
	*u = x;
	*v = y;
	if (l->edge < 0 || !colour || at(&l->count, x, y) > 0)
		return false;
	gd_merge_other_end(m, l->edge, u, v);
	return (*u != x || *v != y) && at(&colour->count, x, y) > 0 &&
	       at(&colour->count, *u, *v) > 0;
}

static inline float difference(struct gd_plane p, int x, int y, int u, int v)
{
	return narrow((double)gd_row(p, v)[u] - (double)gd_row(p, y)[x]);
}

/* Such gradients are differences of the merged colours. */
static void finish_untraced(struct gd_merge *m, struct merge_layer *l,
			    const struct merge_layer *colour)
{
	if (l->edge < 0 || !colour || !l->count.plane.v)
		return;
#pragma omp parallel for schedule(static) if (GD_ACCUM_MANY(m->weight))
	for (int y = 0; y < m->h; y++)
		for (int x = 0; x < m->w; x++) {
			int u, v;

			if (!untraced(m, l, colour, x, y, &u, &v))
				continue;
			for (int c = 0; c < l->n; c++) {
				gd_row(l->mean[c], y)[x] = difference(colour->mean[c], x, y, u, v);
				if (l->has_variance && colour->has_variance)
					gd_row(l->m2[c], y)[x] =
						narrow((double)gd_row(colour->m2[c], y)[x] +
						       (double)gd_row(colour->m2[c], v)[u]);
				for (int b = 0; b < m->bins && l->binned; b++)
					gd_row(l->bin[b][c], y)[x] =
						difference(colour->bin[b][c], x, y, u, v);
			}
		}
}

static void count_empty(struct gd_merge *m, struct merge_layer *l,
			const struct merge_layer *colour, const struct gd_report *report)
{
	int u, v;

	if (!l->count.plane.v)
		return;
	for (int y = 0; y < m->h; y++)
		for (int x = 0; x < m->w; x++)
			l->empty += !(at(&l->count, x, y) > 0) &&
				    !untraced(m, l, colour, x, y, &u, &v);
	if (l->empty)
		gd_note(report, "%s: %zu pixels without any sample are 0",
			*l->name ? l->name : "the colour", l->empty);
}

/* half0 = the even bins, half1 = the odd ones, each bin with its samples. */
static int add_half(struct gd_merge *m, struct merge_layer *l, int c, int half, struct gd_err *err)
{
	struct gd_plane out;
	char name[300];
	int rc;

	snprintf(name, sizeof name, "half%d.%s", half, l->out[c]);
	rc = gd_image_add(&m->out, name, &out, err);
	if (rc != GD_OK)
		return rc;
#pragma omp parallel for schedule(static) if (GD_ACCUM_MANY(m->weight))
	for (int y = 0; y < m->h; y++)
		for (int x = 0; x < m->w; x++) {
			const bool empty = l->bin_count && !(side_samples(m, l, half, x, y) > 0);
			double sum = 0, weight = 0;

			/* bins without samples hold something all the same */
			for (int b = half; b < m->bins; b += 2) {
				double n = l->bin_count && !empty ? at(&l->bin_count[b], x, y) : 1;

				sum += n * gd_row(l->bin[b][c], y)[x];
				weight += n;
			}
			gd_row(out, y)[x] =
				weight > 0 ? narrow(sum / weight) : gd_row(l->mean[c], y)[x];
		}
	return GD_OK;
}

/*
 * Mean standard deviation by the inputs' own variances over that by the spread of the bins. The
 * root of a variance from K parts is too small in the mean, by about 1 / (4 (K - 1)).
 */
static double spread_ratio(struct gd_merge *m, const struct merge_layer *l, double bin_ratio)
{
	double told = 0, seen = 0;
	int k = m->bins;

	if (l->spread || !l->has_variance || k < 2 || bin_ratio > 1.01)
		return 0;
	for (int c = 0; c < l->n; c++)
		for (int y = 0; y < m->h; y++)
			for (int x = 0; x < m->w; x++) {
				double mean = 0, sum = 0;

				for (int b = 0; b < k; b++)
					mean += (double)gd_row(l->bin[b][c], y)[x] / k;
				for (int b = 0; b < k; b++) {
					double d = gd_row(l->bin[b][c], y)[x] - mean;

					sum += d * d;
				}
				told += sqrt((double)gd_row(l->m2[c], y)[x]);
				seen += sqrt(sum / k / (k - 1)) / (1 - 0.25 / (k - 1));
			}
	return seen > 0 && isfinite(told / seen) ? told / seen : 0;
}

/* Samples of the fullest bin over those of the emptiest. */
static double bin_ratio(const struct gd_merge *m)
{
	double low = m->bin_samples[0], high = low;

	for (int b = 1; b < m->bins; b++) {
		low = fmin(low, m->bin_samples[b]);
		high = fmax(high, m->bin_samples[b]);
	}
	return low > 0 ? high / low : 1;
}

/* Writes the samples used and tells their mean. */
static int add_samples(struct gd_merge *m, const struct merge_layer *colour, double *mean,
		       struct gd_err *err)
{
	struct gd_plane out;
	double sum = 0, old;
	int rc = gd_image_add(&m->out, "samples", &out, err);

	if (rc != GD_OK)
		return rc;
	for (int y = 0; y < m->h; y++)
		for (int x = 0; x < m->w; x++) {
			gd_row(out, y)[x] = (float)at(&colour->count, x, y);
			sum += (double)gd_row(out, y)[x];
		}
	*mean = sum / ((double)m->w * m->h);
	rc = gd_attr_set_number(&m->out, "gd:samplesPerPixel", *mean, err);
	if (rc == GD_OK && gd_attr_number(&m->out, "gd:samples", &old))
		rc = gd_attr_set_number(&m->out, "gd:samples", *mean, err);
	if (rc == GD_OK && gd_attr_number(&m->out, "samplesPerPixel", &old))
		rc = gd_attr_set_int(&m->out, "samplesPerPixel", (int)lround(fmin(*mean, 2e9)),
				     err);
	return rc;
}

/*
 * Writes what gradients are worth, where this is not what the samples at their two ends say: after
 * passes whose counts differ, or with some that told.
 */
static int add_worth(struct gd_merge *m, const struct merge_layer *colour, struct merge_layer *l,
		     struct gd_err *err)
{
	struct gd_plane out;
	bool differ = false;
	char name[300];
	int rc = GD_OK;

	for (int y = 0; y < m->h && !differ; y++)
		for (int x = 0; x < m->w && !differ; x++) {
			int u = x, v = y;
			double n;

			gd_merge_other_end(m, l->edge, &u, &v);
			n = gd_merge_harmonic(at(&colour->count, x, y), at(&colour->count, u, v));
			differ = fabs(at(&l->count, x, y) - n) > 1e-4 * n;
		}
	snprintf(name, sizeof name, "%s.samples", l->name);
	if (differ)
		rc = gd_image_add(&m->out, name, &out, err);
	for (int y = 0; y < m->h && differ && rc == GD_OK; y++)
		for (int x = 0; x < m->w; x++)
			gd_row(out, y)[x] = (float)at(&l->count, x, y);
	return rc;
}

/* Samples of either half, from the bins or from the halves that were merged; false if unknown. */
static bool sides_at(struct gd_merge *m, double n[2], int x, int y)
{
	const struct merge_layer *colour = gd_merge_layer(m, "");
	const struct merge_layer *half[2] = { gd_merge_layer(m, "half0"),
					      gd_merge_layer(m, "half1") };
	bool halves = half[0] && half[1] && half[0]->wanted && half[1]->wanted;

	for (int h = 0; h < 2; h++)
		n[h] = colour->bin_count ? side_samples(m, colour, h, x, y) :
		       halves		 ? at(&half[h]->count, x, y) : 0;
	return colour->bin_count || halves;
}

/* Writes the samples of either half where these are not the same share everywhere. */
static int add_sides(struct gd_merge *m, size_t *one_sided, struct gd_err *err)
{
	double share = m->bins ? (m->bins + 1) / 2 / (double)m->bins : 0.5, n[2];
	struct gd_plane out[2];
	bool differ = false;
	int rc = GD_OK;

	if (!m->counted || !sides_at(m, n, 0, 0))
		return GD_OK;
	for (int y = 0; y < m->h && !differ; y++)
		for (int x = 0; x < m->w && !differ; x++) {
			sides_at(m, n, x, y);
			differ = fabs(n[0] - share * (n[0] + n[1])) > 1e-4 * (n[0] + n[1]);
		}
	for (int h = 0; h < 2 && differ && rc == GD_OK; h++)
		rc = gd_image_add(&m->out, h ? "half1.samples" : "half0.samples", &out[h], err);
	for (int y = 0; y < m->h && differ && rc == GD_OK; y++)
		for (int x = 0; x < m->w; x++) {
			sides_at(m, n, x, y);
			for (int h = 0; h < 2; h++)
				gd_row(out[h], y)[x] = (float)n[h];
			*one_sided += n[0] + n[1] > 0 && !(n[0] > 0 && n[1] > 0);
		}
	return rc;
}

static int finish_layer(struct gd_merge *m, struct merge_layer *l, const struct gd_report *report,
			struct gd_err *err)
{
	const char half[] = { 'h', 'a', 'l', 'f', l->half ? l->name[4] : 0, 0 };
	const struct merge_layer *colour = gd_merge_layer(m, l->half ? half : "");
	int rc = GD_OK;

	count_empty(m, l, colour, report);
	if (l->has_variance)
		rc = finish_layer_variance(m, l, report, err);
	finish_bins(m, l);
	if (rc == GD_OK && colour && colour->wanted && colour->n == l->n)
		finish_untraced(m, l, colour);
	for (int c = 0; c < l->n && l->binned && m->make_halves && rc == GD_OK; c++) {
		rc = add_half(m, l, c, 0, err);
		if (rc == GD_OK)
			rc = add_half(m, l, c, 1, err);
	}
	return rc;
}

static bool is_bin(const char *name, void *user)
{
	(void)user;
	return gd_merge_in_family(name, "bin");
}

int gd_merge_finish(struct gd_merge *m, struct gd_image *out, struct gd_merge_result *result,
		    const struct gd_report *report, struct gd_err *err)
{
	struct merge_layer *colour = gd_merge_layer(m, "");
	struct gd_merge_result r = { .inputs = m->ninput, .bins = m->keep_bins ? m->bins : 0,
				     .bin_ratio = bin_ratio(m), .twins = m->twins };
	int rc = GD_OK;

	/* gradients last: they may come of the colours */
	for (int k = 0; k < 2 * m->nlayer && rc == GD_OK; k++) {
		struct merge_layer *l = &m->layer[k % m->nlayer];

		if (!l->wanted || (l->edge >= 0) != (k >= m->nlayer))
			continue;
		rc = finish_layer(m, l, report, err);
		r.dropped += l->dropped;
	}
	r.empty = colour->empty;
	r.spread_ratio = rc == GD_OK ? spread_ratio(m, colour, r.bin_ratio) : 0;
	if (rc == GD_OK && m->counted)
		rc = add_samples(m, colour, &r.samples, err);
	for (int k = 0; k < m->nlayer && rc == GD_OK && m->counted; k++)
		if (m->layer[k].edge >= 0 && m->layer[k].wanted && !m->layer[k].half)
			rc = add_worth(m, colour, &m->layer[k], err);
	if (rc == GD_OK && (m->keep_bins || m->make_halves || !m->bins))
		rc = add_sides(m, &r.one_sided, err);
	if (rc == GD_OK && (r.bins || gd_attr_find(&m->out, "gd:bins")))
		rc = gd_attr_set_int(&m->out, "gd:bins", r.bins, err);
	if (rc != GD_OK)
		return rc;
	if (!m->keep_bins)
		gd_image_drop_if(&m->out, is_bin, NULL);
	if (result)
		*result = r;
	*out = m->out;
	m->out = (struct gd_image){ 0 };
	return GD_OK;
}
