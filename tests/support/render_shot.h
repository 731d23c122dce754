/* SPDX-License-Identifier: BSD-3-Clause */
/* Pictures of base and offset paths, and their statistics: luminance in double precision. */
#ifndef RENDER_SHOT_H
#define RENDER_SHOT_H

#include <math.h>
#include <stdlib.h>

#include "render/path.h"
#include "render_scene.h"

struct stat {
	double n, s, s2;
};

static inline void note(struct stat *a, double x)
{
	a->n++;
	a->s += x;
	a->s2 += x * x;
}

static inline double mean(struct stat a)
{
	return a.n > 0 ? a.s / a.n : 0;
}

/* Of the mean. */
static inline double variance(struct stat a)
{
	const double m = mean(a);

	return a.n > 1 ? fmax(a.s2 / a.n - m * m, 0) / (a.n - 1) : 0;
}

/* What one pixel's samples say. Offset pixel k is at ring[k], and the way back is (k + 2) % 4. */
struct spot {
	struct stat colour;
	struct stat half[4], mine[4], theirs[4];
	struct stat lost[4];	/* mine - colour */
	bool broken;		/* something was not finite */
};

struct shot {
	int w, h;		/* of what is looked at */
	int x0, y0, wide, high;	/* where it is in an image of wide x high; wide 0: it is all */
	const struct gd_scene *scene;
	struct gd_path_conf conf;
	const int (*ring)[2];	/* NULL: no offset paths */
	int spp;
	bool uneven;		/* 1, 2 or 4 times as many samples in different pixels */
	uint64_t seed;
	struct spot *spot;
};

static const int NEXT[4][2] = { { 1, 0 }, { 0, 1 }, { -1, 0 }, { 0, -1 } };
static const int KNIGHT[4][2] = { { 2, 1 }, { -1, 2 }, { -2, -1 }, { 1, -2 } };

static inline int samples_at(const struct shot *s, int x, int y)
{
	return s->uneven ? s->spp << (unsigned)((x * 7 + y * 5 + 70) % 3) : s->spp;
}

static inline bool finite_all(const struct gd_path_out *o)
{
	const struct gd_v3 *v = &o->colour;
	bool ok = isfinite(o->z);

	for (size_t i = 0; i < offsetof(struct gd_path_out, z) / sizeof *v; i++)
		ok &= isfinite(v[i].x) && isfinite(v[i].y) && isfinite(v[i].z);
	return ok;
}

static inline void shoot_spot(const struct shot *s, int x, int y)
{
	struct spot *p = &s->spot[y * s->w + x];
	struct gd_path_in in = { .w = s->wide ? s->wide : s->w, .h = s->wide ? s->high : s->h,
				 .x = s->x0 + x, .y = s->y0 + y, .n = s->ring ? 4 : 0 };
	const int n = samples_at(s, x, y);

	memset(p, 0, sizeof *p);
	for (int k = 0; k < in.n; k++) {
		in.dx[k] = s->ring[k][0];
		in.dy[k] = s->ring[k][1];
		in.r[k] = (float)samples_at(s, x + in.dx[k], y + in.dy[k]) / (float)n;
	}
	for (int i = 0; i < n; i++) {
		struct gd_draw d = gd_draw_start(s->seed, (uint32_t)x, (uint32_t)y, (uint32_t)i);
		struct gd_path_out o;
		double c;

		gd_path_trace(s->scene, &s->conf, &in, &d, &o);
		p->broken |= !finite_all(&o);
		c = (double)gd_luma(o.colour);
		note(&p->colour, c);
		for (int k = 0; k < in.n; k++) {
			const double m = (double)gd_luma(o.mine[k]),
				     t = (double)gd_luma(o.theirs[k]);

			note(&p->half[k], (double)gd_luma(o.half[k]));
			note(&p->mine[k], m);
			note(&p->theirs[k], t);
			note(&p->lost[k], m - c);
		}
	}
}

static inline void shoot(struct shot *s)
{
	s->spot = grown(NULL, (size_t)(s->w * s->h), sizeof *s->spot);
#pragma omp parallel for schedule(dynamic)
	for (int i = 0; i < s->w * s->h; i++)
		shoot_spot(s, i % s->w, i / s->w);
}

/* The numbers of another shot with the same layout, other samples. */
static inline void pool(struct stat *a, struct stat b)
{
	a->n += b.n;
	a->s += b.s;
	a->s2 += b.s2;
}

static inline void pool_shot(struct shot *a, const struct shot *b)
{
	for (int i = 0; i < a->w * a->h; i++) {
		struct spot *p = &a->spot[i];
		const struct spot *q = &b->spot[i];

		pool(&p->colour, q->colour);
		for (int k = 0; k < 4; k++) {
			pool(&p->half[k], q->half[k]);
			pool(&p->mine[k], q->mine[k]);
			pool(&p->theirs[k], q->theirs[k]);
			pool(&p->lost[k], q->lost[k]);
		}
		p->broken |= q->broken;
	}
}

/* --- how far apart two sets of estimates of the same numbers are --- */

/* Pixel by pixel: mean and largest of (difference / standard error)^2, each about 1. */
struct chi2 {
	double sum, worst;
	int n;
};

static inline void judge(struct chi2 *c, double d, double v)
{
	if (!(v > 0) && d == 0)
		return;
	c->n++;
	c->sum += v > 0 ? d * d / v : 1e6;
	c->worst = fmax(c->worst, v > 0 ? fabs(d) / sqrt(v) : 1e3);
}

static inline double chi2_mean(struct chi2 c)
{
	return c.n ? c.sum / c.n : 1;
}

/* Mean over its standard error, of numbers that are 0 on average. */
static inline double score(struct stat a)
{
	return mean(a) == 0 ? 0 : mean(a) / sqrt(variance(a));
}

#endif
