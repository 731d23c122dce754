/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * A path tracer whose every expectation and variance is known: at pixel i a path is one number u,
 * uniform in [0, 1), its contribution
 *	f_i(u) = I_i + a_i (u - 1/2),	P = 1,
 * and the offset path at pixel j is the same u, J = Q = 1.
 */
#ifndef FILM_WORLD_H
#define FILM_WORLD_H

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "render/film.h"
#include "render/render.h"

#define W 24
#define H 17

struct world {
	double noise;		/* 0: every sample is I_i */
	double slope;		/* I = 1 + slope (x + 2 y) + curve sin() */
	double curve;
	unsigned pause;		/* microseconds a sample */
};

static inline double level(const struct world *w, int x, int y, int c)
{
	return 1 + w->slope * (x + 2 * y + c) + w->curve * sin(0.7 * x + 1.3 * y + c);
}

static inline double spread(const struct world *w, int x, int y, int c)
{
	return w->noise * (1 + 0.5 * sin(1.1 * x - 0.6 * y + 2 * c));
}

static inline double contribution(const struct world *w, int x, int y, int c, double u)
{
	return level(w, x, y, c) + spread(w, x, y, c) * (u - 0.5);
}

static inline struct gd_v3 colour_at(const struct world *w, int x, int y, double u)
{
	return gd_v3((float)contribution(w, x, y, 0, u), (float)contribution(w, x, y, 1, u),
		     (float)contribution(w, x, y, 2, u));
}

static inline void sample(const void *user, const struct gd_path_conf *conf,
			  const struct gd_path_in *in, struct gd_draw *draw,
			  struct gd_path_out *out)
{
	const struct world *w = user;
	const float u = gd_draw(draw);

	(void)conf;
	if (w->pause)
		usleep(w->pause);
	memset(out, 0, sizeof *out);
	out->colour = colour_at(w, in->x, in->y, u);
	for (int k = 0; k < in->n; k++) {
		const struct gd_v3 there = colour_at(w, in->x + in->dx[k], in->y + in->dy[k], u);

		assert_true(in->r[k] > 0);
		out->mine[k] = gd_scale(out->colour, 1 / (1 + in->r[k]));
		out->theirs[k] = gd_scale(there, 1 / (1 + in->r[k]));
		out->half[k] = gd_sub(out->theirs[k], out->mine[k]);
	}
	out->albedo = gd_v3(0.25f, 0.5f, u);
	out->normal = gd_v3(0, 1, 0);
	out->position = gd_v3((float)in->x, (float)in->y, u);
	out->z = 3;
	out->hits = 1;
}

static inline struct gd_render_conf usual(void)
{
	return (struct gd_render_conf){ .w = W, .h = H, .crop = { 0, 0, W - 1, H - 1 }, .spp = 16,
					.share = 1, .bins = 8, .seed = 5 };
}

static inline void render(struct gd_image *im, const struct world *w,
			  const struct gd_render_conf *conf)
{
	struct gd_err err = { 0 };

	*im = (struct gd_image){ 0 };
	if (gd_render_samples(im, sample, w, conf, NULL, &err) != GD_OK)
		fail_msg("%s", err.text);
	for (int i = 0; i < im->nchan; i++)
		for (int y = 0; y < im->h; y++)
			for (int x = 0; x < im->w; x++)
				if (!isfinite(im->chan[i].v[(size_t)y * gd_stride(im->w) +
							    (size_t)x]))
					fail_msg("%s is not finite", im->chan[i].name);
}

static inline bool has(const struct gd_image *im, const char *name)
{
	return gd_image_find(im, name) >= 0;
}

static inline struct gd_plane plane(const struct gd_image *im, const char *name)
{
	struct gd_plane p;

	if (!gd_image_plane(im, name, &p))
		fail_msg("no channel %s", name);
	return p;
}

static inline double value(const struct gd_image *im, const char *name, int x, int y)
{
	return (double)gd_row(plane(im, name), y)[x];
}

static inline void near(double got, double want, double tolerance, const char *what, int x, int y)
{
	if (!(fabs(got - want) <= tolerance))
		fail_msg("%s at (%d, %d): %.9g, expected %.9g", what, x, y, got, want);
}

/* u of sample s at a pixel, as gd_render() draws it. */
static inline double drawn(uint64_t seed, int x, int y, int s)
{
	struct gd_draw d = gd_draw_start(seed, (uint32_t)x, (uint32_t)y, (uint32_t)s);

	return (double)gd_draw(&d);
}

static const char *const rgb[] = { "R", "G", "B" };

static inline const char *name_of(const char *layer, int c)
{
	static char text[4][80];
	static int turn;

	turn = (turn + 1) % 4;
	snprintf(text[turn], sizeof text[turn], "%s%s%s", layer, *layer ? "." : "", rgb[c]);
	return text[turn];
}

/* Counts and shares that differ from pixel to pixel. */
struct maps {
	struct gd_plane counts, shares;
};

static inline struct maps uneven(int w, int h, bool holes)
{
	const size_t n = (size_t)h * gd_stride(w);
	struct maps m = { gd_plane_of(gd_calloc(n, 4), w, h), gd_plane_of(gd_calloc(n, 4), w, h) };

	for (int y = 0; y < h; y++)
		for (int x = 0; x < w; x++) {
			const int k = (5 * x + 11 * y + x * y) % 13;

			gd_row(m.counts, y)[x] = (float)(holes ? k - 2 < 0 ? 0 : k - 2 : 3 + k);
			gd_row(m.shares, y)[x] = k % 4 == 0 ? 0 : (float)(k % 4) / 3;
		}
	return m;
}

static inline void free_maps(struct maps *m)
{
	free(m->counts.v);
	free(m->shares.v);
}

/* A knight's move, and two to the right. */
static inline struct gd_pairs chessboard(int w, int h)
{
	struct gd_pairs p = { .w = w, .h = h };

	for (int k = 0; k < GD_PAIRS; k++) {
		p.dx[k] = calloc((size_t)(w * h), 1);
		p.dy[k] = calloc((size_t)(w * h), 1);
	}
	for (int y = 0; y < h; y++)
		for (int x = 0; x < w; x++) {
			if (x + 1 < w && y + 2 < h) {
				p.dx[0][y * w + x] = 1;
				p.dy[0][y * w + x] = 2;
			}
			if (x + 2 < w)
				p.dx[1][y * w + x] = 2;
		}
	return p;
}

static inline void free_chessboard(struct gd_pairs *p)
{
	for (int k = 0; k < GD_PAIRS; k++) {
		free(p->dx[k]);
		free(p->dy[k]);
	}
}

#endif
