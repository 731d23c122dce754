/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Where a frame is not what the frames before foretold: light that changed for all, which models
 * can follow, and change here and there, for which they must forget.
 */
#include "temporal_impl.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "blur.h"
#include "select.h"

#define BLOCK 8		/* pixels; about as far as a denoised pixel's error reaches */
#define SCALES 2

/* A change of all light counts as far as it is beyond this many standard deviations, squared. */
static const double sure = 40;
static const int least = 16;	/* blocks that must be there to tell */
/*
 * Windows in which a pixel's squared misfit is held against what errors explain: the small one sees
 * an edge go by, the large one a change of shading. The past counts less from so many times the
 * usual misfit on. Smaller thresholds give back flicker (1.5 and 1: a third more of it) for little
 * less error where things move.
 */
static const int side[SCALES] = { 5, 17 };
static const double chance[SCALES] = { 3, 1.2 };
/* Most that a pixel's squared misfit counts, over what errors explain: none rules a window. */
static const double clip[SCALES] = { 1e4, 100 };
/* Errors may be estimated this much too high or too low all over the image. */
static const double low = 0.5, high = 3;

/* ---- all light ---- */

/* Sums over a block of what was foretold and of what is, for each channel. */
struct block {
	double told[3], seen[3];
};

/* In units of its brightness, so that dark blocks say as much as bright ones. */
static struct block sum_block(const struct gd_temporal_work *k, int bx, int by)
{
	struct block b = { 0 };
	double level = 0;

	for (int y = by * BLOCK; y < (by + 1) * BLOCK && y < k->h; y++)
		for (int x = bx * BLOCK; x < (bx + 1) * BLOCK && x < k->w; x++) {
			const size_t i = gd_temporal_index(k, x, y);

			for (int c = 0; c < 3 && k->model[i].frames > 0; c++) {
				b.told[c] += (double)k->model[i].v[c];
				b.seen[c] += (double)k->here[i].y[c];
			}
		}
	for (int c = 0; c < 3; c++)
		level += fabs(b.told[c]) + fabs(b.seen[c]);
	for (int c = 0; c < 3 && level > 0; c++) {
		b.told[c] /= level;
		b.seen[c] /= level;
	}
	return b;
}

/*
 * Factor of a channel's light since the frame before: 1 but for what is beyond chance. The scatter
 * of the blocks, whose errors hardly know of each other, tells what chance can do.
 */
static double find_gain(const struct block *b, int n, int c)
{
	double told = 0, seen = 0, scatter = 0, gain, off2;
	int used = 0;

	for (int i = 0; i < n; i++) {
		told += b[i].told[c];
		seen += b[i].seen[c];
		used += b[i].told[c] > 0;
	}
	if (!(told > 0 && seen > 0) || used < least)
		return 1;
	gain = seen / told;
	for (int i = 0; i < n; i++) {
		const double e = b[i].seen[c] - gain * b[i].told[c];

		scatter += e * e;
	}
	off2 = (gain - 1) * (gain - 1) * told * told;
	gain = off2 > 0 ? 1 + (gain - 1) * fmax(0, 1 - sure * scatter / off2) : 1;
	return fmin(fmax(gain, 0.01), 100);
}

int gd_temporal_light(struct gd_temporal_work *k, struct gd_err *err)
{
	const int bw = (k->w + BLOCK - 1) / BLOCK, bh = (k->h + BLOCK - 1) / BLOCK;
	struct block *b = gd_alloc((size_t)bw * (size_t)bh, sizeof *b);
	float gain[3], gain2 = 0;

	if (!b)
		return gd_fail(err, GD_ENOMEM, "out of memory");
#pragma omp parallel for schedule(static)
	for (int i = 0; i < bw * bh; i++)
		b[i] = sum_block(k, i % bw, i / bw);
	for (int c = 0; c < 3; c++) {
		gain[c] = (float)find_gain(b, bw * bh, c);
		gain2 += gain[c] * gain[c] / 3;
	}
	free(b);
	if (gain[0] == 1 && gain[1] == 1 && gain[2] == 1)
		return GD_OK;
#pragma omp parallel for schedule(static)
	for (int y = 0; y < k->h; y++)
		for (int x = 0; x < k->w; x++) {
			struct gd_temporal_model *m = k->model + gd_temporal_index(k, x, y);

			for (int c = 0; c < 3; c++) {
				m->v[c] *= gain[c];
				m->slope[c] *= gain[c];
				m->p[c] *= gain2;
			}
		}
	return GD_OK;
}

/* ---- here and there ---- */

/* Squared misfit, and the square that errors explain, both in squares of the brightness. */
static void misfit(const struct gd_temporal_work *k, struct gd_plane seen, struct gd_plane may,
		   double forget, double times)
{
	static const float black[3];

#pragma omp parallel for schedule(static)
	for (int y = 0; y < k->h; y++)
		for (int x = 0; x < k->w; x++) {
			const size_t i = gd_temporal_index(k, x, y);
			const struct gd_temporal_model *m = k->model + i;
			const double e2 = (double)gd_temporal_distance2(k->here[i].y, m->v) / 3;
			const double s2 = (double)k->here[i].s2 + (double)m->p[0] / forget;
			const double unit = s2 + (double)gd_temporal_distance2(m->v, black) / 3;
			const bool is = m->frames > 0 && unit > 0;

			gd_row(seen, y)[x] = is ? (float)(fmin(e2, times * s2) / unit) : 0;
			gd_row(may, y)[x] = is ? (float)(s2 / unit) : 0;
		}
}

/* seen / may into ratio, pixel by pixel; -1 where no pixel around was followed. */
static void divide(const struct gd_temporal_work *k, float *ratio, struct gd_plane seen,
		   struct gd_plane may)
{
#pragma omp parallel for schedule(static)
	for (int y = 0; y < k->h; y++)
		for (int x = 0; x < k->w; x++) {
			const float d = gd_row(may, y)[x];

			ratio[gd_temporal_index(k, x, y)] = d > 0 ? gd_row(seen, y)[x] / d : -1;
		}
}

/* The middle one of the ratios: what is usual, as most of an image does not change. */
static double usual(const struct gd_temporal_work *k, const float *ratio, double *spare)
{
	const size_t pixels = (size_t)k->w * (size_t)k->h;
	size_t n = 0;

	for (size_t i = 0; i < pixels; i++)
		if (ratio[i] >= 0 && k->model[i].frames > 0)
			spare[n++] = (double)ratio[i];
	return n ? fmin(fmax(gd_select(spare, 0, n, n / 2), low), high) : 1;
}

int gd_temporal_change(struct gd_temporal_work *k, double forget, struct gd_err *err)
{
	const size_t plane = gd_stride(k->w) * (size_t)k->h, n = (size_t)k->w * (size_t)k->h;
	float *block = gd_alloc(3 * plane, sizeof *block), *ratio = gd_alloc(n, sizeof *ratio);
	double *spare = gd_alloc(n, sizeof *spare), unit = 1;
	int rc = block && ratio && spare ? GD_OK : gd_fail(err, GD_ENOMEM, "out of memory");

	memset(k->change, 0, n * sizeof *k->change);
	for (int l = SCALES - 1; l >= 0 && rc == GD_OK; l--) {
		const struct gd_plane seen = gd_plane_of(block, k->w, k->h);
		const struct gd_plane may = gd_plane_of(block + plane, k->w, k->h);
		const struct gd_plane work = gd_plane_of(block + 2 * plane, k->w, k->h);
		const struct gd_blur blur = gd_blur_box(side[l]);

		misfit(k, seen, may, forget, unit * clip[l]);
		rc = gd_blur_plane(seen, work, &blur, err);
		if (rc == GD_OK)
			rc = gd_blur_plane(may, work, &blur, err);
		if (rc != GD_OK)
			break;
		divide(k, ratio, seen, may);
		if (l == SCALES - 1)
			unit = usual(k, ratio, spare);
		for (size_t i = 0; i < n; i++)
			k->change[i] = fmaxf(k->change[i],
					     (float)((double)ratio[i] / (unit * chance[l]) - 1));
	}
	free(spare);
	free(ratio);
	free(block);
	return rc;
}
