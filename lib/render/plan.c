/* SPDX-License-Identifier: BSD-3-Clause */
#include "render/plan.h"

/* Shares come from files of floats: 0.1f * 10 is no more than 1 sample. */
#define ROUNDING 1e-6

struct gd_plan gd_plan(const struct gd_render_conf *conf)
{
	return (struct gd_plan){ conf, conf->crop.x1 - conf->crop.x0 + 1,
				 conf->crop.y1 - conf->crop.y0 + 1 };
}

uint32_t gd_plan_samples(const struct gd_plan *p, int x, int y)
{
	if (p->conf->counts.v)
		return (uint32_t)gd_row(p->conf->counts, y)[x];
	return p->conf->seconds > 0 ? 1 : (uint32_t)p->conf->spp;
}

double gd_plan_share(const struct gd_plan *p, int x, int y)
{
	return p->conf->shares.v ? (double)gd_row(p->conf->shares, y)[x] : p->conf->share;
}

uint32_t gd_plan_traced(double share, uint32_t m)
{
	if (share >= 1)
		return m;
	return share > 0 && m ? (uint32_t)ceil(share * m * (1 - ROUNDING)) : 0;
}

uint32_t gd_plan_traced_of(const struct gd_plan *p, double share, uint32_t n)
{
	const uint32_t bins = p->conf->bins > 1 ? (uint32_t)p->conf->bins : 1;
	const uint32_t m = n / bins, more = n % bins;

	if (share >= 1)
		return n;
	return more * gd_plan_traced(share, m + 1) + (bins - more) * gd_plan_traced(share, m);
}

/* ---- edges ---- */

static bool inside(const struct gd_plan *p, int x, int y)
{
	return x >= 0 && y >= 0 && x < p->w && y < p->h;
}

/* Where a pixel's pairs are: of the whole image, or of the crop. */
static size_t pair_index(const struct gd_plan *p, int x, int y)
{
	const struct gd_pairs *pairs = p->conf->pairs;
	const bool whole = pairs->w == p->conf->w && pairs->h == p->conf->h;

	if (whole) {
		x += p->conf->crop.x0;
		y += p->conf->crop.y0;
	}
	return (size_t)y * (size_t)pairs->w + (size_t)x;
}

int gd_plan_layers(const struct gd_plan *p)
{
	const struct gd_pairs *pairs = p->conf->pairs;
	int n = 0;

	if (!pairs)
		return 2;
	for (int k = 0; k < GD_PAIRS; k++)
		for (int y = 0; y < p->h && n <= k; y++)
			for (int x = 0; x < p->w && n <= k; x++) {
				const size_t i = pair_index(p, x, y);

				if (pairs->dx[k][i] || pairs->dy[k][i])
					n = k + 1;
			}
	return n;
}

bool gd_plan_edge(const struct gd_plan *p, int k, int x, int y, int *dx, int *dy)
{
	*dx = k == 0;
	*dy = k == 1;
	if (p->conf->pairs) {
		const size_t i = pair_index(p, x, y);

		*dx = p->conf->pairs->dx[k][i];
		*dy = p->conf->pairs->dy[k][i];
	}
	return (*dx || *dy) && inside(p, x + *dx, y + *dy);
}

/* Samples of a pixel that trace offset paths; in the long run, if only time decides on them. */
static double traced(const struct gd_plan *p, int x, int y)
{
	const uint32_t n = gd_plan_samples(p, x, y);
	const double share = gd_plan_share(p, x, y);

	return p->conf->seconds > 0 ? share * n : gd_plan_traced_of(p, share, n);
}

static int add_edge(const struct gd_plan *p, int x, int y, int dx, int dy, double here,
		    struct gd_edge edge[GD_PAIRS], int n)
{
	double there;

	if (n == GD_PAIRS || !inside(p, x + dx, y + dy))
		return n;
	there = traced(p, x + dx, y + dy);
	edge[n] = (struct gd_edge){ dx, dy, here > 0 ? (float)(there / here) : 0 };
	return n + 1;
}

/* Those that stand here, then those that stand at a pixel before and lead here. */
static int pair_edges(const struct gd_plan *p, int x, int y, double here,
		      struct gd_edge edge[GD_PAIRS])
{
	int n = 0, back_x, back_y;

	for (int k = 0; k < GD_PAIRS; k++) {
		int dx, dy;

		if (gd_plan_edge(p, k, x, y, &dx, &dy))
			n = add_edge(p, x, y, dx, dy, here, edge, n);
	}
	for (int dy = -GD_PAIR_REACH; dy <= 0; dy++)
		for (int dx = -GD_PAIR_REACH; dx <= (dy ? GD_PAIR_REACH : -1); dx++)
			for (int k = 0; k < GD_PAIRS && inside(p, x + dx, y + dy); k++)
				if (gd_plan_edge(p, k, x + dx, y + dy, &back_x, &back_y) &&
				    back_x == -dx && back_y == -dy)
					n = add_edge(p, x, y, dx, dy, here, edge, n);
	return n;
}

int gd_plan_edges(const struct gd_plan *p, int x, int y, struct gd_edge edge[GD_PAIRS])
{
	static const int grid[4][2] = { { 1, 0 }, { 0, 1 }, { -1, 0 }, { 0, -1 } };
	const double here = traced(p, x, y);
	int n = 0;

	if (p->conf->pairs)
		return pair_edges(p, x, y, here, edge);
	for (int k = 0; k < 4; k++)
		n = add_edge(p, x, y, grid[k][0], grid[k][1], here, edge, n);
	return n;
}

int gd_plan_find(const struct gd_edge *edge, int n, int x, int y)
{
	for (int k = 0; k < n; k++)
		if (edge[k].x == x && edge[k].y == y)
			return k;
	return -1;
}
