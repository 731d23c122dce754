/* SPDX-License-Identifier: BSD-3-Clause */
/* Which pixel of the frame before shows the place that a pixel shows now. */
#include "temporal_impl.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>

#define BLOCK 8		/* pixels; motion is looked for in the middle of each block */
#define COARSE 2	/* pixels, between the places looked at */

/* Squared, in distances of neighbouring pixels: farther apart are two places. */
static const float far2 = 9;
/* A distance below which nearer hardly counts, in the same unit. */
static const float near2 = 0.06f;
/* Share of near2 that a pixel's step on the screen counts, squared: settles ties. */
static const float step2 = 0.02f;
/* Colour tells places apart only where it misses by more than this many errors, squared. */
static const float blind = 16;

/* ---- where pixels are ---- */

static void read_position(const struct gd_plane position[3], int x, int y, float at[3])
{
	for (int c = 0; c < 3; c++) {
		at[c] = gd_row(position[c], y)[x];
		if (!(fabsf(at[c]) < 1e18f))
			at[c] = 0;
	}
}

/* The two pixels beside (x, y) along an axis; false at a border, or where one sees nothing. */
static bool beside(const struct gd_plane position[3], int x, int y, int axis, float a[3],
		   float b[3])
{
	const int dx = !axis, dy = axis;

	if (x < dx || y < dy || x + dx >= position[0].w || y + dy >= position[0].h)
		return false;
	read_position(position, x - dx, y - dy, a);
	read_position(position, x + dx, y + dy, b);
	return !gd_temporal_nothing(a) && !gd_temporal_nothing(b);
}

/*
 * Variance of a position's noise, from how far it is off the middle of its neighbours: the smaller
 * of both axes, as an edge is seldom one along both.
 */
static float noise_at(const struct gd_plane position[3], int x, int y)
{
	float at[3], a[3], b[3], least = FLT_MAX;

	read_position(position, x, y, at);
	for (int axis = 0; axis < 2; axis++) {
		float sum = 0;

		if (!beside(position, x, y, axis, a, b))
			continue;
		for (int c = 0; c < 3; c++) {
			const float e = at[c] - 0.5f * (a[c] + b[c]);

			sum += e * e / 1.5f;	/* the variance of e is that of noise times 1.5 */
		}
		least = fminf(least, sum);
	}
	return least < FLT_MAX ? least : 0;
}

/* Mean position of the pixels around that see something. */
static void smooth(const struct gd_plane position[3], int x, int y, float mean[3])
{
	double sum[3] = { 0 };
	int n = 0;

	for (int j = y > 2 ? y - 2 : 0; j <= y + 2 && j < position[0].h; j++)
		for (int i = x > 2 ? x - 2 : 0; i <= x + 2 && i < position[0].w; i++) {
			float at[3];

			read_position(position, i, j, at);
			if (gd_temporal_nothing(at))
				continue;
			for (int c = 0; c < 3; c++)
				sum[c] += (double)at[c];
			n++;
		}
	for (int c = 0; c < 3 && n; c++)
		mean[c] = (float)(sum[c] / n);
}

/*
 * Squared distance of neighbouring pixels, from pixels two apart: noise hardly shows in it. As far
 * as can be told; in a corner of the image it cannot.
 */
static float spread2(const struct gd_plane position[3], int x, int y)
{
	float a[3], b[3], sum = 0;
	int axes = 0;

	for (int axis = 0; axis < 2; axis++)
		if (beside(position, x, y, axis, a, b)) {
			sum += gd_temporal_distance2(a, b) / 4;
			axes++;
		}
	return axes ? sum * 2 / (float)axes : FLT_MAX;
}

/*
 * Means over samples of a moving or unsharp thing are noisy. A position moves towards the mean of
 * those around as far as its noise is larger than the step from pixel to pixel.
 */
static void locate(struct gd_temporal_work *k, const struct gd_plane position[3],
		   const float *noise, int x, int y)
{
	struct gd_temporal_here *p = k->here + gd_temporal_index(k, x, y);
	float sum = 0, mean[3] = { 0 }, share;
	int n = 0;

	read_position(position, x, y, p->at);
	if (gd_temporal_nothing(p->at))
		return;
	for (int j = y > 1 ? y - 1 : 0; j <= y + 1 && j < k->h; j++)
		for (int i = x > 1 ? x - 1 : 0; i <= x + 1 && i < k->w; i++) {
			sum += noise[gd_temporal_index(k, i, j)];
			n++;
		}
	sum /= (float)n;
	share = sum > 0 ? sum / (sum + spread2(position, x, y)) : 0;
	if (share < 0.01f)
		return;
	smooth(position, x, y, mean);
	for (int c = 0; c < 3; c++)
		p->at[c] += share * (mean[c] - p->at[c]);
}

/* Across and down, the nearer of two neighbours each. */
static float size2(const struct gd_temporal_work *k, int x, int y)
{
	const float *at = k->here[gd_temporal_index(k, x, y)].at;
	float sum = 0;

	for (int axis = 0; axis < 2; axis++) {
		float least = FLT_MAX;

		for (int s = -1; s <= 1; s += 2) {
			const int x1 = axis ? x : x + s, y1 = axis ? y + s : y;
			const float *other;

			if (x1 < 0 || y1 < 0 || x1 >= k->w || y1 >= k->h)
				continue;
			other = k->here[gd_temporal_index(k, x1, y1)].at;
			if (!gd_temporal_nothing(other))
				least = fminf(least, gd_temporal_distance2(at, other));
		}
		sum += least < FLT_MAX ? least : 0;
	}
	return fmaxf(sum, FLT_MIN);
}

int gd_temporal_locate(struct gd_temporal_work *k, const struct gd_plane position[3],
		       struct gd_err *err)
{
	float *noise = gd_alloc((size_t)k->w * (size_t)k->h, sizeof *noise);

	if (!noise)
		return gd_fail(err, GD_ENOMEM, "out of memory");
#pragma omp parallel for schedule(static)
	for (int y = 0; y < k->h; y++)
		for (int x = 0; x < k->w; x++)
			noise[gd_temporal_index(k, x, y)] = noise_at(position, x, y);
#pragma omp parallel for schedule(static)
	for (int y = 0; y < k->h; y++)
		for (int x = 0; x < k->w; x++)
			locate(k, position, noise, x, y);
#pragma omp parallel for schedule(static)
	for (int y = 0; y < k->h; y++)
		for (int x = 0; x < k->w; x++)
			k->here[gd_temporal_index(k, x, y)].size2 = size2(k, x, y);
	free(noise);
	return GD_OK;
}

/* What is looked at of a pixel of the frame before, close together. */
struct place {
	float at[3], v[3];
	float errors;		/* variance foretold, times what colour may miss by */
	enum { NONE, SKY, THING } what;
};

struct search {
	const struct gd_temporal_work *k;
	const struct place *place;	/* of the frame before */
	int radius;
	float blind;
};

static void list_places(const struct gd_temporal_work *k, struct place *place, float errors)
{
#pragma omp parallel for schedule(static)
	for (int y = 0; y < k->h; y++)
		for (int x = 0; x < k->w; x++) {
			const size_t i = gd_temporal_index(k, x, y);
			const struct gd_temporal_model *o = k->before + i;

			place[i] = (struct place){ { o->at[0], o->at[1], o->at[2] },
						   { o->v[0], o->v[1], o->v[2] },
						   errors * o->p[0],
						   o->frames < 1 ? NONE :
						   gd_temporal_nothing(o->at) ? SKY : THING };
		}
}

/* ---- motion, roughly ---- */

struct motion {
	int x, y;	/* pixels, from this frame to the one before */
};

struct field {
	int w, h;	/* blocks */
	struct motion *m;
};

/* Squared distance of what two pixels see, in steps of neighbouring pixels; far if nothing. */
static float apart2(const struct search *s, const struct gd_temporal_here *p, int x, int y)
{
	const struct place *o;

	if (x < 0 || y < 0 || x >= s->k->w || y >= s->k->h)
		return FLT_MAX;
	o = s->place + gd_temporal_index(s->k, x, y);
	return o->what == THING ? gd_temporal_distance2(p->at, o->at) / p->size2 : FLT_MAX;
}

static struct motion find_motion(const struct search *s, int bx, int by, int reach)
{
	const struct gd_temporal_work *k = s->k;
	const int x = bx * BLOCK + BLOCK / 2 < k->w ? bx * BLOCK + BLOCK / 2 : k->w - 1;
	const int y = by * BLOCK + BLOCK / 2 < k->h ? by * BLOCK + BLOCK / 2 : k->h - 1;
	const struct gd_temporal_here *p = k->here + gd_temporal_index(k, x, y);
	struct motion best = { 0, 0 };
	float least = FLT_MAX;

	if (gd_temporal_nothing(p->at))
		return best;
	for (int j = -reach; j <= reach; j += COARSE)
		for (int i = -reach; i <= reach; i += COARSE) {
			const float far = (float)(i * i + j * j);
			const float d2 = apart2(s, p, x + i, y + j) + near2 * step2 * far;

			if (d2 < least) {
				least = d2;
				best = (struct motion){ i, j };
			}
		}
	return best;
}

/* ---- the place itself ---- */

/* The motion of a block near by that brings the pixel nearest to its place. */
static struct motion choose_motion(const struct search *s, const struct field *f, int x, int y)
{
	const struct gd_temporal_here *p = s->k->here + gd_temporal_index(s->k, x, y);
	const int bx = x / BLOCK, by = y / BLOCK;
	struct motion best = { 0, 0 };
	float least = apart2(s, p, x, y);

	if (gd_temporal_nothing(p->at))
		return best;
	for (int j = by > 0 ? by - 1 : 0; j <= by + 1 && j < f->h; j++)
		for (int i = bx > 0 ? bx - 1 : 0; i <= bx + 1 && i < f->w; i++) {
			const struct motion m = f->m[j * f->w + i];
			const float d2 = apart2(s, p, x + m.x, y + m.y);

			if (d2 < least) {
				least = d2;
				best = m;
			}
		}
	return best;
}

/*
 * The pixel of the search window that fits best in position and colour. Both have a floor, so that
 * neither rules alone: a choice by colour below what errors explain would follow the noise.
 */
static int search(const struct search *s, int x, int y, struct motion m)
{
	const struct gd_temporal_work *k = s->k;
	const struct gd_temporal_here *p = k->here + gd_temporal_index(k, x, y);
	const int what = gd_temporal_nothing(p->at) ? SKY : THING, r = s->radius;
	const int x0 = x + m.x, y0 = y + m.y;
	const float errors = s->blind * p->s2;
	float best = FLT_MAX;
	int at = GD_TEMPORAL_NOWHERE;

	for (int oy = y0 > r ? y0 - r : 0; oy <= y0 + r && oy < k->h; oy++)
		for (int ox = x0 > r ? x0 - r : 0; ox <= x0 + r && ox < k->w; ox++) {
			const struct place *o = s->place + gd_temporal_index(k, ox, oy);
			const float step = (float)((ox - x0) * (ox - x0) + (oy - y0) * (oy - y0));
			float d2, cost;

			if ((int)o->what != what)
				continue;
			d2 = what == SKY ? step : gd_temporal_distance2(p->at, o->at) / p->size2;
			if (!(d2 <= far2))
				continue;
			cost = (d2 + near2 * (1 + step2 * step)) *
			       (gd_temporal_distance2(p->y, o->v) / 3 + errors + o->errors);
			if (cost < best) {
				best = cost;
				at = (int)gd_temporal_index(k, ox, oy);
			}
		}
	return at;
}

int gd_temporal_match(struct gd_temporal_work *k, const struct gd_temporal_conf *conf,
		      struct gd_err *err)
{
	const int reach = conf->paper ? 0 : conf->reach / COARSE * COARSE;
	struct place *place = gd_alloc((size_t)k->w * (size_t)k->h, sizeof *place);
	struct field f = { (k->w + BLOCK - 1) / BLOCK, (k->h + BLOCK - 1) / BLOCK, NULL };
	const struct search s = { k, place, conf->radius, conf->paper ? 1 : blind };

	f.m = gd_calloc((size_t)f.w * (size_t)f.h, sizeof *f.m);
	if (!f.m || !place) {
		free(f.m);
		free(place);
		return gd_fail(err, GD_ENOMEM, "out of memory");
	}
	list_places(k, place, s.blind);
#pragma omp parallel for schedule(dynamic, 1)
	for (int by = 0; by < f.h; by++)
		for (int bx = 0; bx < f.w && reach > conf->radius; bx++)
			f.m[by * f.w + bx] = find_motion(&s, bx, by, reach);
#pragma omp parallel for schedule(dynamic, 4)
	for (int y = 0; y < k->h; y++)
		for (int x = 0; x < k->w; x++)
			k->match[gd_temporal_index(k, x, y)] =
				search(&s, x, y, choose_motion(&s, &f, x, y));
	free(f.m);
	free(place);
	return GD_OK;
}
