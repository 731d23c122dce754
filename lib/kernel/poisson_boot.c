/* SPDX-License-Identifier: BSD-3-Clause */
#include "poisson_boot.h"

#include <float.h>
#include <math.h>
#include <string.h>

#define BLOCK 128	/* pixels at a time: 8 bins of them and their counts are 8 kB */
#define LIMIT 1e30f
#define TAME 1e18f	/* its square, times 64, is finite */

/* Draw number j of a pixel is one half of word j / 2,
 * times the number of bins, above the 16 bits. */
static inline uint32_t bin_of(uint32_t half, uint32_t bins)
{
	return (half * bins) >> 16;
}

/* Up to 8 bins: counters of 4 bits, all of them in one word. */
static void draw_few(float *const *count, int bins, struct gd_rng_key key, uint32_t index, int w)
{
	uint32_t packed[BLOCK];

	memset(packed, 0, (size_t)w * sizeof(*packed));
	for (int j = 0; j < bins; j += 2) {
		const uint32_t second = j + 1 < bins;

		for (int x = 0; x < w; x++) {
			uint32_t word = gd_rng_u32(key, index + (uint32_t)x, (uint32_t)j / 2);

			packed[x] += 1U << (4 * bin_of(word & 0xffff, (uint32_t)bins));
			packed[x] += second << (4 * bin_of(word >> 16, (uint32_t)bins));
		}
	}
	for (int b = 0; b < bins; b++)
		for (int x = 0; x < w; x++)
			count[b][x] = (float)(int)(packed[x] >> (4 * b) & 15);
}

static void draw_many(float *const *count, int bins, struct gd_rng_key key, uint32_t index, int w)
{
	for (int b = 0; b < bins; b++)
		memset(count[b], 0, (size_t)w * sizeof(**count));
	for (int x = 0; x < w; x++)
		for (int j = 0; j < bins; j += 2) {
			uint32_t word = gd_rng_u32(key, index + (uint32_t)x, (uint32_t)j / 2);

			count[bin_of(word & 0xffff, (uint32_t)bins)][x] += 1;
			if (j + 1 < bins)
				count[bin_of(word >> 16, (uint32_t)bins)][x] += 1;
		}
}

static void draw(float *const *count, int bins, struct gd_rng_key key, uint32_t index, int w)
{
	for (int x = 0; x < w; x += BLOCK) {
		float *part[GD_BOOT_ROW_BINS];

		for (int b = 0; b < bins; b++)
			part[b] = count[b] + x;
		if (bins <= 8)
			draw_few(part, bins, key, index + (uint32_t)x,
				 w - x < BLOCK ? w - x : BLOCK);
		else
			draw_many(part, bins, key, index + (uint32_t)x,
				  w - x < BLOCK ? w - x : BLOCK);
	}
}

/* Scaled values of one plane's bins and their sum;
 * returns how many are not finite or beyond the limit. */
static int load(float (*restrict buf)[BLOCK], float *restrict sum, const struct gd_boot_rows *rows,
		int plane, int x0, float scale, int n)
{
	int bad = 0;

	memset(sum, 0, (size_t)n * sizeof(*sum));
	for (int b = 0; b < rows->bins; b++) {
		const float *restrict in = rows->bin[b][plane] + x0;
		float *restrict out = buf[b];

		for (int x = 0; x < n; x++) {
			float v = in[x] * scale;

			bad += !(fabsf(v) <= LIMIT);
			out[x] = v;
			sum[x] += v;
		}
	}
	return bad;
}

/*
 * Limits what is too large, and puts the mean of the finite bins in
 * place of the others; without any, 0, and var becomes infinite.
 */
static void mend(float (*restrict buf)[BLOCK], float *restrict total,
		 const struct gd_boot_rows *rows, int plane, int x0, float *restrict var, int n)
{
	for (int x = 0; x < n; x++) {
		float sum = 0;
		int good = 0;

		for (int b = 0; b < rows->bins; b++)
			if (fabsf(rows->bin[b][plane][x0 + x]) <= FLT_MAX) {
				buf[b][x] = buf[b][x] < LIMIT ? buf[b][x] : LIMIT;
				buf[b][x] = buf[b][x] > -LIMIT ? buf[b][x] : -LIMIT;
				sum += buf[b][x];
				good++;
			}
		if (good == 0)
			var[x] = INFINITY;
		for (int b = 0; b < rows->bins; b++)
			if (!(fabsf(rows->bin[b][plane][x0 + x]) <= FLT_MAX))
				buf[b][x] = good ? sum / (float)good : 0;
		total[x] = good ? sum / (float)good * (float)rows->bins : 0;
	}
}

static inline float tame(float v)
{
	v = v < TAME ? v : TAME;
	return v > -TAME ? v : -TAME;
}

/*
 * By deviations d from the mean without draws, which is total / bins: mean of the draws, sum of
 * squares about it added to square, that about the plain mean added to plain. The drawn mean is
 * near the plain one, so sum c d^2 - (sum c d)^2 / bins hardly cancels.
 */
static void moments(float *restrict mean, float *restrict square, float *restrict plain,
		    float *restrict total, float (*restrict buf)[BLOCK],
		    float (*restrict count)[BLOCK], int bins, int n)
{
	const float part = 1.0f / (float)bins;
	float first[BLOCK], second[BLOCK];

	memset(first, 0, (size_t)n * sizeof(*first));
	memset(second, 0, (size_t)n * sizeof(*second));
	for (int x = 0; x < n; x++)
		total[x] *= part;
	for (int b = 0; b < bins; b++) {
		const float *restrict v = buf[b], *restrict c = count[b];

		for (int x = 0; x < n; x++) {
			float d = tame(v[x] - total[x]), cd = c[x] * d;

			first[x] += cd;
			second[x] += cd * d;
			plain[x] += d * d;
		}
	}
	for (int x = 0; x < n; x++) {
		float s = second[x] - first[x] * first[x] * part;

		mean[x] = total[x] + first[x] * part;
		square[x] += s > 0 ? s : 0;
	}
}

static void plain_moments(float *restrict mean, float *restrict square, float *restrict total,
			  float (*restrict buf)[BLOCK], int bins, int n)
{
	const float part = 1.0f / (float)bins;

	for (int x = 0; x < n; x++)
		mean[x] = total[x] * part;
	for (int b = 0; b < bins; b++)
		for (int x = 0; x < n; x++) {
			float d = tame(buf[b][x] - mean[x]);

			square[x] += d * d;
		}
}

static void resample_block(float *const *v, float *restrict var, const struct gd_boot_rows *rows,
			   const struct gd_rng_key *key, uint32_t index, float scale, int x0, int n)
{
	const int bins = rows->bins;
	const float unit =
		bins > 1 ? 1.0f / ((float)bins * (float)(bins - 1) * (float)rows->planes) : 0;
	float buf[GD_BOOT_ROW_BINS][BLOCK], count[GD_BOOT_ROW_BINS][BLOCK];
	float square[BLOCK], plain[BLOCK], lost[BLOCK], total[BLOCK];

	memset(square, 0, (size_t)n * sizeof(*square));
	memset(plain, 0, (size_t)n * sizeof(*plain));
	memset(lost, 0, (size_t)n * sizeof(*lost));
	if (key) {
		float *part[GD_BOOT_ROW_BINS];

		for (int b = 0; b < bins; b++)
			part[b] = count[b];
		draw(part, bins, *key, index + (uint32_t)x0, n);
	}
	for (int k = 0; k < rows->planes; k++) {
		if (load(buf, total, rows, k, x0, scale, n))
			mend(buf, total, rows, k, x0, lost, n);
		if (key)
			moments(v[k] + x0, square, plain, total, buf, count, bins, n);
		else
			plain_moments(v[k] + x0, square, total, buf, bins, n);
	}
	for (int x = 0; x < n; x++) {
		float s = square[x] > 0.1f * plain[x] ? square[x] : 0.1f * plain[x];

		var[x0 + x] = s * unit + lost[x];
	}
}

static void resample(float *const *v, float *var, const struct gd_boot_rows *rows,
		     const struct gd_rng_key *key, uint32_t index, float scale, int w)
{
	for (int x = 0; x < w; x += BLOCK)
		resample_block(v, var, rows, key, index, scale, x, w - x < BLOCK ? w - x : BLOCK);
}

static void add(float *restrict sum, float *restrict square, float *restrict high,
		const float *restrict d, const float *restrict low, int w)
{
	for (int x = 0; x < w; x++)
		sum[x] += d[x];
	if (square)
		for (int x = 0; x < w; x++)
			square[x] += tame(d[x]) * tame(d[x]);
	if (high)
		for (int x = 0; x < w; x++)
			high[x] += tame(d[x] - low[x]) * tame(d[x] - low[x]);
}

const struct gd_boot_kernels GD_KERNEL(gd_boot_rows) = { resample, draw, add };
