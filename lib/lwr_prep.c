/* SPDX-License-Identifier: BSD-3-Clause */
/* Sparse linear predictions: what is known of the image as a whole before any window is fitted. */
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "lwr_impl.h"

#define SAMPLES 64	/* per axis, for the median of a feature and the level of the image */

static int compare(const void *a, const void *b)
{
	double x = *(const double *)a, y = *(const double *)b;

	return (x > y) - (x < y);
}

/* The k-th of SAMPLES places spread evenly over n pixels, symmetric, first and last included. */
static int sample_at(int k, int n)
{
	if (2 * k < SAMPLES)
		return (int)((long)k * (n - 1) / (SAMPLES - 1));
	return n - 1 - sample_at(SAMPLES - 1 - k, n);
}

/*
 * scale: the lower quartile of the distance from the median, where there is any: how far values
 * reach at least, untouched by a sky at 1e10. range: between the percentiles 0.5 and 99.5.
 */
static void feature_scale(struct gd_plane f, double *scale, double *range)
{
	double v[SAMPLES * SAMPLES], median;
	int n = 0, far = 0;

	for (int j = 0; j < SAMPLES; j++)
		for (int i = 0; i < SAMPLES; i++)
			v[n++] = (double)gd_row(f, sample_at(j, f.h))[sample_at(i, f.w)];
	qsort(v, (size_t)n, sizeof *v, compare);
	median = v[n / 2];
	*range = v[n - 1 - n / 200] - v[n / 200];
	for (int i = 0; i < n; i++)
		if (v[i] != median)
			v[far++] = fabs(v[i] - median);
	qsort(v, (size_t)far, sizeof *v, compare);
	*scale = far > 0 ? v[far / 4] : 0.0;
}

static bool constant(struct gd_plane f)
{
	float first = f.v[0];

	for (int y = 0; y < f.h; y++)
		for (int x = 0; x < f.w; x++)
			if (gd_row(f, y)[x] != first)
				return false;
	return true;
}

static bool same(struct gd_plane a, struct gd_plane b)
{
	for (int y = 0; y < a.h; y++)
		if (memcmp(gd_row(a, y), gd_row(b, y), (size_t)a.w * sizeof(float)) != 0)
			return false;
	return true;
}

/* Takes the features that vary and are not a copy of an earlier one; kept[k]: which it was. */
void gd_lwr_features(struct gd_lwr_plan *p, const struct gd_lwr_in *in,
		     const struct gd_lwr_conf *conf, const struct gd_report *report, int *kept)
{
	for (int a = 0; a < in->nfeat; a++) {
		double scale, range;
		int k = 0;

		while (k < p->nf && !same(p->feat[k], in->feat[a]))
			k++;
		if (k < p->nf || constant(in->feat[a])) {
			gd_note(report, "feature plane %d is %s: left out", a,
				k < p->nf ? "a copy" : "constant");
			continue;
		}
		feature_scale(in->feat[a], &scale, &range);
		p->range[k] = range > 0 ? range : scale;
		p->flat[k] = conf->flat * range * range;
		/* float rounding of a renderer's sums: 1e-6 of the scale */
		p->floor[k] = 1e-12 * scale * scale;
		p->feat[k] = in->feat[a];
		if ((conf->feature_noise > 0 || conf->paper) && in->feat_var && in->feat_var[a].v)
			p->noisy[p->nfv++] = k;
		kept[p->nf++] = a;
	}
}

/*
 * 1 % of the squared mean level of the planes: what is added to a squared mean where channels are
 * weighed against each other, so that dark ones do not rule. Scales with the image.
 */
double gd_lwr_level(const struct gd_plane *y, int n)
{
	double sum = 0;

	for (int c = 0; c < n; c++) {
		double level[SAMPLES];

		for (int j = 0; j < SAMPLES; j++) {
			const float *row = gd_row(y[c], sample_at(j, y[c].h));

			level[j] = 0;
			for (int i = 0; i < SAMPLES; i++)
				level[j] += fabs((double)row[sample_at(i, y[c].w)]);
		}
		qsort(level, SAMPLES, sizeof *level, compare);	/* a firefly spoils one row */
		for (int j = SAMPLES / 4; j < SAMPLES * 3 / 4; j++)
			sum += level[j];
	}
	sum /= (double)n * SAMPLES * SAMPLES / 2;
	return fmax(0.01 * sum * sum, 1e-280);
}

int gd_lwr_grid(int *centre, int n, int step)
{
	int count = (n - 1) / step + 1;

	if (n % 2 == 0 && count % 2 == 1) /* an odd number cannot be symmetric about half a pixel */
		count++;
	for (int j = 0; centre && 2 * j < count; j++) {
		int x = (int)(((2L * j + 1) * n - count) / (2L * count));

		centre[j] = x;
		centre[count - 1 - j] = n - 1 - x;
	}
	return count;
}

/* n pixels of row y from x on, of one plane, into place `at`. */
static void pack_plane(const struct gd_lwr_plan *p, int at, struct gd_plane from, int y, int x,
		       int n)
{
	float *to = p->pixel + ((size_t)y * (size_t)p->w + (size_t)x) * p->pitch + at;
	const float *row = gd_row(from, y) + x;

	for (int i = 0; i < n; i++)
		to[(size_t)i * p->pitch] = row[i];
}

static void pack_root(const struct gd_lwr_plan *p, struct gd_plane weight, int y, int x, int n)
{
	float *to = p->pixel + ((size_t)y * (size_t)p->w + (size_t)x) * p->pitch + p->root;
	const float *row = gd_row(weight, y) + x;

	for (int i = 0; i < n; i++)
		to[(size_t)i * p->pitch] = sqrtf(row[i]);
}

#define RUN 64	/* pixels laid out at a time: they stay in the nearest cache */

/* Lays the pixels out as described at struct gd_lwr_plan. */
int gd_lwr_pack(struct gd_lwr_plan *p, const struct gd_lwr_in *in, const int *kept)
{
	struct gd_plane from[GD_LWR_FEATURES * 2 + 9];
	size_t n = (size_t)p->w * (size_t)p->h, pad = 64;
	int planes = 0;

	for (int a = 0; a < p->nf; a++)
		from[planes++] = in->feat[kept[a]];
	for (int c = 0; c < p->nc; c++)
		from[planes++] = in->y[c];
	for (int c = 0; p->twin && c < p->nc; c++)
		from[planes++] = in->twin[c];
	for (int c = 0; c < p->nvar; c++)
		from[planes++] = in->var[c];
	for (int a = 0; a < p->nfv; a++)
		from[planes++] = in->feat_var[kept[p->noisy[a]]];
	p->root = in->weight.v ? planes : 0;
	p->pitch = (size_t)planes + (in->weight.v != NULL);
	p->block = gd_alloc(n * p->pitch + 2 * pad, sizeof(float));
	if (!p->block)
		return GD_ENOMEM;
	memset(p->block, 0, pad * sizeof(float));
	p->pixel = p->block + pad;
	memset(p->pixel + n * p->pitch, 0, pad * sizeof(float));
#pragma omp parallel for schedule(static)
	for (int y = 0; y < p->h; y++)
		for (int x = 0; x < p->w; x += RUN) {
			int run = p->w - x < RUN ? p->w - x : RUN;

			for (int k = 0; k < planes; k++)
				pack_plane(p, k, from[k], y, x, run);
			if (p->root)
				pack_root(p, in->weight, y, x, run);
		}
	return GD_OK;
}
