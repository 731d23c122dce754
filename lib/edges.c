/* SPDX-License-Identifier: BSD-3-Clause */
#include "edges.h"

#include <float.h>
#include <math.h>
#include <omp.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "kernel/poisson_prep.h"

/*
 * Bits of positive floats sort as the floats do: the upper half picks a bucket, the lower
 * half a value in it. One table of counts for each thread, added up afterwards: whole
 * numbers, so the order does not matter.
 */
#define BUCKETS 65536

struct census {
	int threads;
	size_t *bucket;		/* of each thread */
	float *work;
};

/* upper < 0: counts upper halves; else lower halves of
 * the values whose upper half it is. Returns the sum. */
static size_t count_bits(const struct gd_rows *rows, const struct census *c, long upper)
{
	size_t n = 0;

	memset(c->bucket, 0, (size_t)c->threads * BUCKETS * sizeof(*c->bucket));
#pragma omp parallel for schedule(static) num_threads(c->threads)
	for (int i = 0; i < rows->count; i++) {
		const int id = omp_get_thread_num();
		const float *v = rows->row(rows, i, c->work + (size_t)id * (size_t)rows->w);
		size_t *bucket = c->bucket + (size_t)id * BUCKETS;

		for (int x = 0; x < rows->w; x++) {
			uint32_t bits;

			memcpy(&bits, v + x, sizeof(bits));
			if (bits - 1 >= 0x7f7fffffU)		/* 0, negative, or not finite */
				continue;
			if (upper < 0)
				bucket[bits >> 16]++;
			else if (bits >> 16 == (uint32_t)upper)
				bucket[bits & 0xffff]++;
		}
	}
	for (int t = 1; t < c->threads; t++)
		for (size_t i = 0; i < BUCKETS; i++)
			c->bucket[i] += c->bucket[(size_t)t * BUCKETS + i];
	for (size_t i = 0; i < BUCKETS; i++)
		n += c->bucket[i];
	return n;
}

static uint32_t find_rank(const size_t *bucket, size_t *rank)
{
	uint32_t i = 0;

	while (i < BUCKETS - 1 && *rank >= bucket[i])
		*rank -= bucket[i++];
	return i;
}

double gd_median_positive(const struct gd_rows *rows)
{
	struct census c = { .threads = omp_get_max_threads() };
	size_t rank = 0;
	uint32_t bits = 0;
	float v = 0;

	c.threads = c.threads < 16 ? c.threads : 16;
	c.bucket = gd_alloc((size_t)c.threads * BUCKETS, sizeof(*c.bucket));
	c.work = gd_alloc((size_t)c.threads * (size_t)rows->w, sizeof(*c.work));
	if (c.bucket && c.work)
		rank = count_bits(rows, &c, -1);
	if (rank > 0) {
		rank = (rank - 1) / 2;
		bits = find_rank(c.bucket, &rank) << 16;
		count_bits(rows, &c, (long)(bits >> 16));
		bits |= find_rank(c.bucket, &rank);
		memcpy(&v, &bits, sizeof(v));
	}
	free(c.bucket);
	free(c.work);
	return (double)v;
}

static const float *edge_row(const struct gd_rows *rows, int i, float *work)
{
	const struct gd_mg_level *l = rows->user;

	(void)work;
	return (const float *)(i & 1 ? l->s : l->e) + (size_t)(i / 2) * l->stride;
}

double gd_edges_median(const struct gd_mg_level *l)
{
	return gd_median_positive(&(struct gd_rows){ 2 * l->h, l->w, edge_row, l });
}

int gd_gauss_taps(float *tap, double sigma)
{
	int r = (int)ceil(3 * sigma);
	double sum = 0;

	r = r < GD_PREP_TAPS / 2 ? r : GD_PREP_TAPS / 2;
	for (int i = -r; i <= r; i++)
		sum += exp(-0.5 * i * i / (sigma * sigma));
	for (int i = -r; i <= r; i++)
		tap[i + r] = (float)(exp(-0.5 * i * i / (sigma * sigma)) / sum);
	return 2 * r + 1;
}

/* One direction's edges: w x h of them. */
static void smooth(float *v, int w, int h, size_t stride, float *spare, const float *tap, int taps,
		   float cap, float *work, size_t work_size)
{
	const struct gd_prep_kernels *k = GD_PICK(gd_prep);

#pragma omp parallel
	{
		float *pad = work + (size_t)omp_get_thread_num() * work_size,
		      *out = pad + work_size / 2;

#pragma omp for schedule(static)
		for (int y = 0; y < h; y++) {
			const float *row[GD_PREP_TAPS];

			for (int i = 0; i < taps; i++) {
				int at = y + i - taps / 2;

				row[i] = at >= 0 && at < h ? v + (size_t)at * stride : NULL;
			}
			k->blur_down(spare + (size_t)y * stride, row, tap, taps, cap, w);
		}
#pragma omp for schedule(static)
		for (int y = 0; y < h; y++) {
			k->blur_along(out, spare + (size_t)y * stride, tap, taps, pad, w);
			k->merge(v + (size_t)y * stride, out, cap, w);
		}
	}
}

int gd_edges_smooth(const struct gd_mg_level *l, float *spare, double sigma, double cap,
		    struct gd_err *err)
{
	const size_t work_size = 2 * (l->stride + GD_PREP_TAPS + 15);
	float tap[GD_PREP_TAPS], *work;
	int taps;

	if (!(sigma > 0))
		return GD_OK;
	work = gd_alloc((size_t)omp_get_max_threads() * work_size, sizeof(*work));
	if (!work)
		return gd_fail(err, GD_ENOMEM, "edges: out of memory");
	taps = gd_gauss_taps(tap, sigma);
	cap = cap < (double)FLT_MAX ? cap : (double)FLT_MAX;
	if (l->w > 1)
		smooth(l->e, l->w - 1, l->h, l->stride, spare, tap, taps, (float)cap, work,
		       work_size);
	if (l->h > 1)
		smooth(l->s, l->w, l->h - 1, l->stride, spare, tap, taps, (float)cap, work,
		       work_size);
	free(work);
	return GD_OK;
}

size_t gd_edges_weigh(const struct gd_mg_level *l, double phi)
{
	const struct gd_prep_kernels *k = GD_PICK(gd_prep);
	size_t none = 0;

	/* of whole numbers: any order gives the same */
#pragma omp parallel for schedule(static) reduction(+:none)
	for (int y = 0; y < l->h; y++) {
		float *e = (float *)l->e + (size_t)y * l->stride,
		      *s = (float *)l->s + (size_t)y * l->stride;

		none += (size_t)k->weigh(e, (float)phi, l->w - 1);
		e[l->w - 1] = 0;
		if (y + 1 < l->h)
			none += (size_t)k->weigh(s, (float)phi, l->w);
		else
			memset(s, 0, (size_t)l->w * sizeof(*s));
	}
	return none;
}

static bool linked(const void *plane, bool wide, double least, size_t i)
{
	return (wide ? ((const double *)plane)[i] : (double)((const float *)plane)[i]) > least;
}

static int root(int *label, int i)
{
	while (label[i] != i)
		i = label[i] = label[label[i]];
	return i;
}

/* The lower index becomes the root, so that a part's root is its first pixel. */
static void join(int *label, int i, int j)
{
	i = root(label, i);
	j = root(label, j);
	if (i < j)
		label[j] = i;
	else
		label[i] = j;
}

int gd_edges_parts(const struct gd_mg_level *l, bool wide, double least, int *label)
{
	const int w = l->w, n = w * l->h;
	int parts = 0;

	for (int i = 0; i < n; i++) {
		const int x = i % w, y = i / w;

		label[i] = i;
		if (x > 0 && linked(l->e, wide, least, (size_t)y * l->stride + (size_t)x - 1))
			join(label, i, i - 1);
		if (y > 0 && linked(l->s, wide, least, (size_t)(y - 1) * l->stride + (size_t)x))
			join(label, i, i - w);
	}
	for (int i = 0; i < n; i++)
		label[i] = root(label, i);
	for (int i = 0; i < n;
	     i++) /* a root comes before all of its part: it is numbered already */
		label[i] = label[i] == i ? parts++ : label[label[i]];
	return parts;
}
