/* SPDX-License-Identifier: BSD-3-Clause */
/* Problems of pairs: random graphs with differences along them, and what belongs to them. */
#ifndef PAIRS_CASE_H
#define PAIRS_CASE_H

#include "pairsolve.h"
#include "poisson_case.h"

struct paired {
	struct gd_pairs pairs;
	struct gd_pairsolve_in in;
	struct gd_plane truth[3], out[3];
	int w, h;
};

/* share of the edges that are left out at random;
 * gradients of the truth with noise of deviation sigma. */
static inline struct paired paired_new(int w, int h, double left_out, double sigma, uint64_t seed)
{
	struct paired p = { .w = w, .h = h };
	struct noise n = { seed };
	int *degree = calloc((size_t)w * (size_t)h, sizeof(*degree));

	gd_pairs_new(&p.pairs, w, h, NULL);
	p.in.n = 3;
	for (int i = 0; i < w * h * GD_PAIR_OFFSETS * 2; i++) {
		const int at = (int)(uniform(&n) * w * h), o = (int)(uniform(&n) * GD_PAIR_OFFSETS);
		const int x = at % w + gd_pair_offset[o][0], y = at / w + gd_pair_offset[o][1];
		int k = 0;

		if (uniform(&n) < left_out || x < 0 || x >= w || y >= h || degree[at] >= 4 ||
		    degree[y * w + x] >= 4)
			continue;
		for (; p.pairs.dx[k][at] || p.pairs.dy[k][at]; k++)
			if (p.pairs.dx[k][at] == gd_pair_offset[o][0] &&
			    p.pairs.dy[k][at] == gd_pair_offset[o][1])
				break;
		if (p.pairs.dx[k][at] || p.pairs.dy[k][at])
			continue;
		p.pairs.dx[k][at] = gd_pair_offset[o][0];
		p.pairs.dy[k][at] = gd_pair_offset[o][1];
		degree[at]++;
		degree[y * w + x]++;
	}
	free(degree);
	for (int c = 0; c < 3; c++) {
		p.truth[c] = blank(w, h);
		p.out[c] = blank(w, h);
		p.in.primal[c] = blank(w, h);
		for (int y = 0; y < h; y++)
			for (int x = 0; x < w; x++)
				gd_row(p.truth[c], y)[x] =
					(float)(1 + 0.3 * sin(0.2 * x + c) * cos(0.15 * y) +
						(3 * x + 2 * y > 2 * w ? 0.7 : 0));
		for (int y = 0; y < h; y++)
			for (int x = 0; x < w; x++)
				gd_row(p.in.primal[c], y)[x] =
					(float)((double)gd_row(p.truth[c], y)[x] +
						sigma * normal(&n));
		for (int k = 0; k < GD_PAIRS; k++) {
			p.in.value[k][c] = blank(w, h);
			for (int y = 0; y < h; y++)
				for (int x = 0; x < w; x++) {
					const int dx = p.pairs.dx[k][y * w + x],
						  dy = p.pairs.dy[k][y * w + x];

					gd_row(p.in.value[k][c], y)[x] =
						(float)((double)gd_row(p.truth[c], y + dy)[x + dx] -
							(double)gd_row(p.truth[c], y)[x] +
							sigma * normal(&n));
				}
		}
	}
	return p;
}

static inline void paired_free(struct paired *p)
{
	gd_pairs_free(&p->pairs);
	for (int c = 0; c < 3; c++) {
		free(p->truth[c].v);
		free(p->out[c].v);
		free(p->in.primal[c].v);
		for (int k = 0; k < GD_PAIRS; k++)
			free(p->in.value[k][c].v);
	}
}

/* p->in.pairs is set here, since p may have been copied. */
static inline struct gd_poisson_result paired_solve(struct paired *p, enum gd_poisson_method method,
						    double alpha, double tolerance)
{
	struct gd_poisson_conf conf = GD_POISSON_DEFAULTS;
	struct gd_poisson_result result;
	struct gd_err err = { 0 };

	conf.method = method;
	conf.alpha = alpha;
	conf.tolerance = tolerance;
	conf.max_iterations = 100000;
	p->in.pairs = &p->pairs;
	if (gd_pairsolve(p->out, &p->in, &conf, &result, NULL, &err) != GD_OK)
		fail_msg("%s", err.text);
	return result;
}

#endif
