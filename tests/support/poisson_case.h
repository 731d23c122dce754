/* SPDX-License-Identifier: BSD-3-Clause */
/* Gradient problems to solve: made images, their
 * gradients with noise, variances; and comparisons. */
#ifndef POISSON_CASE_H
#define POISSON_CASE_H

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "gd.h"
#include "plane.h"
#include "poisson.h"

struct noise {
	uint64_t state;
};

static inline double uniform(struct noise *n)
{
	n->state = n->state * 6364136223846793005U + 1442695040888963407U;
	return ((double)(n->state >> 11) + 0.5) * 0x1p-53;
}

static inline double normal(struct noise *n)
{
	double r = sqrt(-2 * log(uniform(n)));

	return r * cos(6.283185307179586 * uniform(n));
}

static inline struct gd_plane blank(int w, int h)
{
	return gd_plane_of(gd_calloc(gd_stride(w) * (size_t)h, sizeof(float)), w, h);
}

struct problem {
	struct gd_poisson_in in;
	struct gd_plane out[3], truth[3];
	int w, h;
};

/* A smooth image with an edge and different channels;
 * noise of the given deviation on everything. */
static inline struct problem problem_new(int w, int h, double sigma, uint64_t seed)
{
	struct problem p = { .w = w, .h = h };
	struct noise n = { seed };

	p.in.n = 3;
	for (int c = 0; c < 3; c++) {
		p.truth[c] = blank(w, h);
		p.out[c] = blank(w, h);
		p.in.primal[c] = blank(w, h);
		p.in.dx[c] = blank(w, h);
		p.in.dy[c] = blank(w, h);
		p.in.dxvar[c] = blank(w, h);
		p.in.dyvar[c] = blank(w, h);
		for (int y = 0; y < h; y++)
			for (int x = 0; x < w; x++)
				gd_row(p.truth[c], y)[x] =
					(float)(1 + 0.3 * sin(0.2 * x + c) * cos(0.15 * y) +
						(3 * x + 2 * y > 2 * w ? 0.7 : 0));
		for (int y = 0; y < h; y++)
			for (int x = 0; x < w; x++) {
				double t = (double)gd_row(p.truth[c], y)[x];

				gd_row(p.in.primal[c], y)[x] = (float)(t + sigma * normal(&n));
				if (x + 1 < w)
					gd_row(p.in.dx[c], y)[x] =
						(float)((double)gd_row(p.truth[c], y)[x + 1] - t +
							sigma * normal(&n));
				if (y + 1 < h)
					gd_row(p.in.dy[c], y)[x] =
						(float)((double)gd_row(p.truth[c], y + 1)[x] - t +
							sigma * normal(&n));
				gd_row(p.in.dxvar[c], y)[x] =
					(float)(sigma * sigma * (0.5 + uniform(&n)));
				gd_row(p.in.dyvar[c], y)[x] =
					(float)(sigma * sigma * (0.5 + uniform(&n)));
			}
	}
	return p;
}

static inline void problem_free(struct problem *p)
{
	for (int c = 0; c < 3; c++) {
		free(p->truth[c].v);
		free(p->out[c].v);
		free(p->in.primal[c].v);
		free(p->in.dx[c].v);
		free(p->in.dy[c].v);
		free(p->in.dxvar[c].v);
		free(p->in.dyvar[c].v);
	}
}

static inline double largest_difference(struct gd_plane a, struct gd_plane b)
{
	double most = 0;

	for (int y = 0; y < a.h; y++)
		for (int x = 0; x < a.w; x++) {
			double d = fabs((double)gd_row(a, y)[x] - (double)gd_row(b, y)[x]);

			if (!(d <= most))	/* a NaN is the largest */
				most = d;
		}
	return most;
}

static inline double mean_of(struct gd_plane p)
{
	double s = 0;

	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++)
			s += (double)gd_row(p, y)[x];
	return s / ((double)p.w * p.h);
}

static inline bool all_finite(struct gd_plane p)
{
	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++)
			if (!isfinite(gd_row(p, y)[x]))
				return false;
	return true;
}

#endif
