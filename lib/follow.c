/* SPDX-License-Identifier: BSD-3-Clause */
#include "follow.h"

#include <math.h>
#include <stdbool.h>

#include "camera.h"

#define NEAR	2.0	/* pixels' sizes between points that are the same surface */
#define LENS	2.0	/* pixels off: projection does not tell where points are */

struct pair {
	const struct gd_plane *here, *there;
	struct gd_camera own, other;
	bool project;		/* both cameras are known */
};

static bool nothing(const struct gd_plane *p, int x, int y)
{
	return gd_row(p[0], y)[x] == 0 && gd_row(p[1], y)[x] == 0 && gd_row(p[2], y)[x] == 0;
}

static double apart(const struct gd_plane *p, int x, int y, const struct gd_plane *q, int u, int v)
{
	double s = 0;

	for (int c = 0; c < 3; c++) {
		double d = (double)gd_row(p[c], y)[x] - (double)gd_row(q[c], v)[u];

		s += d * d;
	}
	return sqrt(s);
}

/*
 * Size of a pixel on the surface at x, y: the second nearest of the points of the pixels above,
 * below and beside is this far, which at an edge is still the same surface.
 */
static double footprint(const struct gd_plane *p, int x, int y)
{
	static const int step[4][2] = { { -1, 0 }, { 1, 0 }, { 0, -1 }, { 0, 1 } };
	double least = INFINITY, second = INFINITY;

	for (int i = 0; i < 4; i++) {
		int u = x + step[i][0], v = y + step[i][1];
		double d;

		if (u < 0 || v < 0 || u >= p->w || v >= p->h)
			continue;
		d = apart(p, x, y, p, u, v);
		second = fmin(second, fmax(d, least));
		least = fmin(least, d);
	}
	return isfinite(second) ? second : isfinite(least) ? least : 0;
}

/* The pixel of the other frame that looks at what x, y looks at; false if that is outside. */
static bool look(const struct pair *k, int x, int y, int *u, int *v)
{
	const struct gd_plane *here = k->here;
	double p[3], x0, y0, x1, y1;

	*u = x;
	*v = y;
	if (!k->project || nothing(here, x, y))
		return true;
	for (int c = 0; c < 3; c++)
		p[c] = (double)gd_row(here[c], y)[x];
	if (!gd_camera_project(&k->own, p, &x0, &y0) || !gd_camera_project(&k->other, p, &x1, &y1))
		return false;
	/* a pixel's mean position is not where its centre is: the difference counts */
	x1 += x - x0;
	y1 += y - y0;
	if (!(x1 > -0.5 && y1 > -0.5 && x1 < here->w - 0.5 && y1 < here->h - 0.5))
		return false;
	*u = (int)lrint(x1);
	*v = (int)lrint(y1);
	return *u < here->w && *v < here->h && *u >= 0 && *v >= 0;
}

void gd_follow(int *at, const struct gd_plane here[3], const struct gd_plane there[3])
{
	struct pair k = { .here = here, .there = there };
	const int w = here[0].w, h = here[0].h;

	k.project = gd_camera_fit(&k.own, here) && k.own.rms < LENS &&
		    gd_camera_fit(&k.other, there) && k.other.rms < LENS;
#pragma omp parallel for schedule(static)
	for (int y = 0; y < h; y++)
		for (int x = 0; x < w; x++) {
			int u, v;
			bool same = look(&k, x, y, &u, &v) &&
				    nothing(here, x, y) == nothing(there, u, v) &&
				    apart(here, x, y, there, u, v) <= NEAR * footprint(here, x, y);

			at[(size_t)y * (size_t)w + (size_t)x] = same ? v * w + u : -1;
		}
}
