/* SPDX-License-Identifier: BSD-3-Clause */
#include "pairs.h"

#include <limits.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "buffers.h"
#include "select.h"

#define SIGMA 0.01f	/* bandwidth of all features; with tau from section 5 of the paper */
#define TAU_NORMAL 0.02f
#define TAU_ALBEDO 0.001f
#define TAU_DEPTH 0.01f
/*
 * Times the expected squared distance of two equal pixels: of normal noise, 1 % (three components)
 * to 5 % (one) of the pairs are beyond.
 */
#define NOISE 4
/* Log affinity, a squared distance of 0.02: there a gradient's variance is about a colour's. */
#define LIMIT -200.0f
#define LEAST 2		/* pairs of a pixel, if there is room for them */
#define ENOUGH 25	/* pixels, 1 / alpha^2: more hardly share their colours in the solution */
#define TAIL 0.001	/* share of values that may lie beyond a feature's range, at either end */
#define FAR 1e20f	/* some renderers write such a depth where nothing was hit */
#define UNLIKE -16.0f	/* noise of a pixel that is like no other: distances are 3 at most */

/*
 * Keys of the order: 0 for log affinities above -2^-7 (affinity > 0.992), then 128 steps a power of
 * 2 up to 2^22, which is beyond (3 + NOISE x 32) / SIGMA^2.
 */
#define KEY_FIRST -7
#define KEY_STEPS 7
#define KEY_LAST 22
#define KEYS (((KEY_LAST - KEY_FIRST) << KEY_STEPS) + 1)

const signed char gd_pair_offset[GD_PAIR_OFFSETS][2] = {
	{ 1, 0 },  { 0, 1 },  { -1, 1 }, { 1, 1 },  { 2, 0 },  { 0, 2 },
	{ -2, 1 }, { 2, 1 },  { -1, 2 }, { 1, 2 },  { -2, 2 }, { 2, 2 },
};
const char *const gd_pair_features[GD_PAIR_FEATURES] = { "N", "albedo", "Z" };
/* Where the next distance starts. */
static const int ring[] = { 0, 2, 4, 6, 10, 12 };
#define RINGS 5

int gd_pairs_new(struct gd_pairs *pairs, int w, int h, struct gd_err *err)
{
	const size_t n = (size_t)w * (size_t)h;

	*pairs = (struct gd_pairs){ .w = w, .h = h };
	for (int k = 0; k < GD_PAIRS; k++) {
		pairs->dx[k] = gd_calloc(n, 1);
		pairs->dy[k] = gd_calloc(n, 1);
		if (!pairs->dx[k] || !pairs->dy[k]) {
			gd_pairs_free(pairs);
			return gd_fail(err, GD_ENOMEM, "pairs: out of memory for %dx%d", w, h);
		}
	}
	return GD_OK;
}

void gd_pairs_free(struct gd_pairs *pairs)
{
	for (int k = 0; k < GD_PAIRS; k++) {
		free(pairs->dx[k]);
		free(pairs->dy[k]);
	}
	*pairs = (struct gd_pairs){ 0 };
}

/* The range of count planes without its tails; false if nothing in them is finite. */
static bool range_of(const struct gd_plane *plane, int count, double *work, float *low, float *high)
{
	size_t n = 0, tail;

	for (int c = 0; c < count; c++)
		for (int y = 0; y < plane[c].h; y++) {
			const float *v = gd_row(plane[c], y);

			for (int x = 0; x < plane[c].w; x++)
				if (fabsf(v[x]) < FAR)
					work[n++] = (double)v[x];
		}
	if (n == 0)
		return false;
	tail = (size_t)(TAIL * (double)n);
	*low = (float)gd_select(work, 0, n, tail);
	*high = (float)gd_select(work, tail, n, n - 1 - tail);
	return true;
}

/* One of the features: where its components stand in struct gd_look. */
struct part {
	int n, noise;		/* planes; index of their noise */
	size_t at;		/* of the first component */
	struct gd_plane plane[GD_LAYER_PLANES], var[GD_LAYER_PLANES];
	bool noisy;
	float low, scale;
};

static void look_row(struct gd_look *look, const struct part *part, int y)
{
	for (int c = 0; c < part->n; c++) {
		const float *v = gd_row(part->plane[c], y);
		const float *var = part->noisy ? gd_row(part->var[c], y) : NULL;

		for (int x = 0; x < part->plane[c].w; x++) {
			float *to = (float *)((char *)(look + x) + part->at) + c;
			float t = (v[x] - part->low) * part->scale;

			*to = t > 1 ? 1 : t > 0 ? t : 0;
			if (isnan(t))
				look[x].noise[part->noise] = UNLIKE;
			else if (var && var[x] > 0 && look[x].noise[part->noise] >= 0)
				look[x].noise[part->noise] +=
					fminf(var[x] * part->scale * part->scale, 1);
		}
	}
}

static bool find_part(struct part *part, const struct gd_image *im, const char *layer)
{
	part->n = gd_layer_planes(im, layer, part->plane);
	part->noisy = part->n && gd_layer_variance_planes(im, layer, part->var) == part->n;
	return part->n == 1 || part->n == 3;
}

int gd_pairs_looks(struct gd_look **looks, const struct gd_image *im, struct gd_err *err)
{
	struct part part[3] = {
		{ .at = offsetof(struct gd_look, n), .noise = 0, .low = -1, .scale = 0.5f },
		{ .at = offsetof(struct gd_look, albedo), .noise = 1 },
		{ .at = offsetof(struct gd_look, z), .noise = 2 },
	};
	const size_t size = (size_t)im->w * (size_t)im->h;
	double *work;
	int found = 0;

	*looks = NULL;
	for (int k = 0; k < GD_PAIR_FEATURES; k++) {
		if (!find_part(&part[k], im, gd_pair_features[k]))
			part[k].n = 0;
		found += part[k].n;
	}
	if (!found)
		return gd_fail(err, GD_ESHAPE,
			       "no channel pair0.x, and no albedo, N or Z to choose pairs by");
	part[2].n = part[2].n ? 1 : 0;
	work = gd_alloc(3 * size, sizeof(*work));
	*looks = gd_calloc(size, sizeof(**looks));
	if (!work || !*looks) {
		free(work);
		free(*looks);
		*looks = NULL;
		return gd_fail(err, GD_ENOMEM, "pairs: out of memory for %dx%d", im->w, im->h);
	}
	for (int k = 1; k < 3; k++) {
		float high = 0;

		if (part[k].n && range_of(part[k].plane, part[k].n, work, &part[k].low, &high) &&
		    high > part[k].low)
			part[k].scale = 1 / (high - part[k].low);
	}
	free(work);
#pragma omp parallel for schedule(static)
	for (int y = 0; y < im->h; y++)
		for (int k = 0; k < GD_PAIR_FEATURES; k++)
			look_row(*looks + (size_t)y * (size_t)im->w, &part[k], y);
	return GD_OK;
}

static inline float square(float v)
{
	return v * v;
}

static inline float beyond(float d2, const struct gd_look *a, const struct gd_look *b, int k,
			   float tau, float worst)
{
	const float d = d2 - NOISE * (a->noise[k] + b->noise[k]) - tau;

	return d > worst ? d : worst;
}

float gd_pairs_affinity(const struct gd_look *a, const struct gd_look *b)
{
	float normal = 0, albedo = 0, worst = 0;

	for (int c = 0; c < 3; c++) {
		normal += square(a->n[c] - b->n[c]);
		albedo += square(a->albedo[c] - b->albedo[c]);
	}
	worst = beyond(normal, a, b, 0, TAU_NORMAL, worst);
	worst = beyond(albedo, a, b, 1, TAU_ALBEDO, worst);
	worst = beyond(square(a->z - b->z), a, b, 2, TAU_DEPTH, worst);
	return worst / -(SIGMA * SIGMA);
}

/* Steps of a logarithmic scale, read off the bits of the number. */
static int key_of(float affinity)
{
	float v = -affinity;
	uint32_t bits;

	if (!(v > ldexpf(1, KEY_FIRST)))
		return 0;
	memcpy(&bits, &v, sizeof(bits));
	bits = (bits >> (23 - KEY_STEPS)) - ((uint32_t)(127 + KEY_FIRST) << KEY_STEPS) + 1;
	return bits < KEYS ? (int)bits : KEYS - 1;
}

static bool inside(int x, int y, const signed char *d, int w, int h)
{
	return x + d[0] >= 0 && x + d[0] < w && y + d[1] < h;
}

#define NO_EDGE UINT16_MAX

static void key_row(uint16_t *key, const struct gd_look *looks, int w, int h, int y)
{
	for (int x = 0; x < w; x++)
		for (int o = 0; o < GD_PAIR_OFFSETS; o++) {
			const signed char *d = gd_pair_offset[o];
			const struct gd_look *look = looks + x;
			uint16_t *to = key + (size_t)x * GD_PAIR_OFFSETS + o;

			*to = NO_EDGE;
			if (inside(x, y, d, w, h))
				*to = (uint16_t)key_of(gd_pairs_affinity(
					look, look + d[1] * (ptrdiff_t)w + d[0]));
		}
}

/*
 * Edges are numbered pixel by pixel. The counting sort is stable, and is fed the near ones first.
 * alike: the number of those within LIMIT.
 */
static size_t sort_edges(uint32_t *edge, const uint16_t *key, size_t pixels, size_t *alike)
{
	size_t start[KEYS + 1] = { 0 };

	for (size_t i = 0; i < pixels * GD_PAIR_OFFSETS; i++)
		if (key[i] != NO_EDGE)
			start[key[i] + 1]++;
	for (int k = 0; k < KEYS; k++)
		start[k + 1] += start[k];
	for (int r = 0; r < RINGS; r++)
		for (size_t p = 0; p < pixels; p++)
			for (int o = ring[r]; o < ring[r + 1]; o++) {
				const size_t i = p * GD_PAIR_OFFSETS + (size_t)o;

				if (key[i] != NO_EDGE)
					edge[start[key[i]]++] = (uint32_t)i;
			}
	*alike = start[key_of(LIMIT)];
	return start[KEYS - 1];
}

struct choice {
	const struct gd_pairs *pairs;
	unsigned char *degree;
	bool *settled;		/* pixels known to be in a part that is not small */
	int *part;		/* union-find: the pixel above; at a root, minus the part's size */
	int small;		/* parts of fewer than ENOUGH */
};

static int root_of(int *part, int i)
{
	while (part[i] >= 0) {
		if (part[part[i]] >= 0)
			part[i] = part[part[i]];
		i = part[i];
	}
	return i;
}

/* True if that makes one part of two, of which one was too small. */
static bool joins(struct choice *c, int p, int q)
{
	int *part = c->part, a, b;

	if (c->settled[p] && c->settled[q])
		return false;
	a = root_of(part, p);
	b = root_of(part, q);
	c->settled[p] = part[a] <= -ENOUGH;
	c->settled[q] = part[b] <= -ENOUGH;
	if (a == b || (c->settled[p] && c->settled[q]))
		return false;
	if (part[a] > part[b]) {
		const int t = a;

		a = b;
		b = t;
	}
	c->small -= part[b] > -ENOUGH;
	c->small -= part[a] > -ENOUGH && part[a] + part[b] <= -ENOUGH;
	part[a] += part[b];
	part[b] = a;
	return true;
}

static bool present(const struct gd_pairs *pairs, int p, const signed char *d)
{
	for (int k = 0; k < GD_PAIRS; k++)
		if (pairs->dx[k][p] == d[0] && pairs->dy[k][p] == d[1])
			return true;
	return false;
}

enum why { JOIN, LIKE, LONELY };	/* what an edge is taken for */

static bool wanted(struct choice *c, int p, int q, const signed char *d, enum why why)
{
	if (why == JOIN)
		return joins(c, p, q);
	if (why == LONELY && c->degree[p] >= LEAST && c->degree[q] >= LEAST)
		return false;
	return !present(c->pairs, p, d);
}

/* The edge, if both of its ends have room. */
static void take(struct choice *c, uint32_t edge, enum why why)
{
	const signed char *d = gd_pair_offset[edge % GD_PAIR_OFFSETS];
	const int p = (int)(edge / GD_PAIR_OFFSETS), q = p + d[1] * c->pairs->w + d[0];
	int k = 0;

	if (c->degree[p] >= GD_PAIRS || c->degree[q] >= GD_PAIRS ||
	    !wanted(c, p, q, d, why))
		return;
	c->degree[p]++;
	c->degree[q]++;
	while (c->pairs->dx[k][p] || c->pairs->dy[k][p])
		k++;
	c->pairs->dx[k][p] = d[0];
	c->pairs->dy[k][p] = d[1];
}

/*
 * First the edges of falling affinity that save a part from being too small, however unlike its
 * ends; then all others that are alike enough, or that a pixel needs which has less than two.
 * Without the first, textures leave islands of five pixels, each with its four edges inside.
 * Without the limit, pixels whose like have no room left are compared with anything.
 */
static int take_all(const struct gd_pairs *pairs, const uint32_t *edge, size_t n, size_t alike,
		    struct gd_err *err)
{
	const size_t pixels = (size_t)pairs->w * (size_t)pairs->h;
	struct choice c = { pairs, gd_calloc(pixels, 1), gd_calloc(pixels, sizeof(*c.settled)),
			    gd_alloc(pixels, sizeof(*c.part)), (int)pixels };
	int rc = GD_OK;

	if (!c.degree || !c.settled || !c.part)
		rc = gd_fail(err, GD_ENOMEM, "pairs: out of memory for %dx%d", pairs->w, pairs->h);
	for (size_t i = 0; i < pixels && rc == GD_OK; i++)
		c.part[i] = -1;
	for (size_t i = 0; i < n && c.small > 0 && rc == GD_OK; i++)
		take(&c, edge[i], JOIN);
	for (size_t i = 0; i < n && rc == GD_OK; i++)
		take(&c, edge[i], i < alike ? LIKE : LONELY);
	free(c.degree);
	free(c.settled);
	free(c.part);
	return rc;
}

int gd_pairs_choose(struct gd_pairs *pairs, const struct gd_look *looks, int w, int h,
		    struct gd_err *err)
{
	const size_t n = (size_t)w * (size_t)h;
	uint16_t *key;
	uint32_t *edge;
	size_t all, alike;
	int rc;

	*pairs = (struct gd_pairs){ 0 };
	if (n > INT_MAX / GD_PAIR_OFFSETS)
		return gd_fail(err, GD_ENOMEM, "pairs: %dx%d pixels are too many", w, h);
	rc = gd_pairs_new(pairs, w, h, err);
	key = gd_alloc(n * GD_PAIR_OFFSETS, sizeof(*key));
	edge = gd_alloc(n * GD_PAIR_OFFSETS, sizeof(*edge));
	if (rc == GD_OK && (!key || !edge))
		rc = gd_fail(err, GD_ENOMEM, "pairs: out of memory for %dx%d", w, h);
	if (rc == GD_OK) {
#pragma omp parallel for schedule(static)
		for (int y = 0; y < h; y++) {
			const size_t row = (size_t)y * (size_t)w;

			key_row(key + row * GD_PAIR_OFFSETS, looks + row, w, h, y);
		}
		all = sort_edges(edge, key, n, &alike);
		rc = take_all(pairs, edge, all, alike, err);
	}
	free(key);
	free(edge);
	if (rc != GD_OK)
		gd_pairs_free(pairs);
	return rc;
}
