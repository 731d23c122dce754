/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * One sample of gradient-domain path tracing (Kettunen et al. 2015): a base path x through pixel i
 * and, for up to four other pixels j, the offset path y = T_ij(x) that sees the same light in
 * nearly the same way.
 *
 * Every path is known by what made it: label of each scattering (bsdf.h) and directions. P(x) is
 * the sum of the densities of all techniques that make x from pixel i (light sampling and BSDF
 * sampling: multiple importance sampling with the balance heuristic), Q(y) the same from pixel j;
 * f the contribution; J = |dT/dx|; r = samples of j over samples of i. Russian roulette, from the
 * third segment on, is a factor of the density of BSDF sampling alone, of either path by its own
 * throughput. Then
 *	colour_i  = E_i[ f(x) / P(x) ]
 *	half_ij   = E_i[ (J f(y) - f(x)) / (P(x) + r J Q(y)) ]
 *	I_j - I_i = half_ij - half_ji
 * the sum of two means, one of pixel i's samples and one of j's, each over its own number: unbiased
 * with any numbers above 0, best with r as said. If T_ij(x) does not exist, J f(y) = J Q(y) = 0.
 *
 * The shift keeps the position within the pixel and on the lens. At a vertex whose label is
 * GD_ROUGH, if the next vertex's is too (or the path ends there), the offset path joins the base
 * path at that next vertex; else it copies the event (half vector, or direction) and goes on by
 * itself. Light sampling keeps the point on the light.
 * Where J f(y) and f(x) differ by more than shift_ratio the pair counts as not shifted (the binary
 * multiple weighted gradient integral of Manzi et al. 2014, section 3.3).
 */
#ifndef GD_RENDER_PATH_H
#define GD_RENDER_PATH_H

#include "render/bsdf.h"
#include "render/scene.h"

struct gd_path_conf {
	int depth;		/* longest path in segments: 1 sees emitters only; 1 .. 255 */
	float shift_ratio;	/* > 1; INFINITY: never */
	float ambient;		/* radiance of the ambient light of the gradients' paths, >= 0 */
	bool mis;		/* false: BSDF sampling alone, but for delta lights (for tests) */
};

/* A small generator of its own for each sample (PCG32). */
struct gd_draw {
	uint64_t state, step;
};
struct gd_draw gd_draw_start(uint64_t seed, uint32_t x, uint32_t y, uint32_t sample);
float gd_draw(struct gd_draw *d);	/* uniform in [0, 1), 24 bits */

/* Where a ray has led: what a path that ends or goes on there needs. */
struct gd_vertex {
	bool miss;		/* nothing was hit: hit and b are not filled */
	bool solid;		/* something scatters there: b is filled */
	struct gd_hit hit;
	struct gd_bsdf b;
	struct gd_v3 radiance;	/* what comes from there */
};

/*
 * With a pinhole all paths through one point of the image have their first vertex in common, be
 * they base paths of one pixel or offset paths of another: who renders many pixels at one position
 * within them, (at[0], at[1]), finds each first vertex once (gd_path_first()) and hands it over.
 */
struct gd_path_in {
	int w, h;		/* of the whole image */
	int x, y;		/* base pixel */
	int n;			/* offset pixels, 0 .. 4 */
	int dx[4], dy[4];	/* where they are, relative to the base; also outside the image */
	float r[4];		/* samples of the offset pixel over those of the base pixel, > 0 */
	const float *at;	/* position within the pixel, [0, 1) x [0, 1), y down; NULL: drawn */
	const struct gd_vertex *first;		/* of the base path, for at; NULL: looked for */
	const struct gd_vertex *others[4];	/* of the offset paths, likewise; not with a lens */
};

struct gd_path_out {
	struct gd_v3 colour;		/* f(x) / P(x) */
	struct gd_v3 half[4];		/* (J f(y) - f(x)) / (P + r J Q) */
	struct gd_v3 mine[4];		/* its two terms, f(x) / (P + r J Q) */
	struct gd_v3 theirs[4];		/* and J f(y) / (P + r J Q): I_i is E_i[mine] + E_j[theirs of
					   the way back] as well */
	/* G-buffers, of the first surface that is no mirror or clear pane; 0 on a miss. */
	struct gd_v3 albedo;		/* 0 .. 1, times what mirrors and panes before it let by */
	struct gd_v3 normal;		/* shading normal, length 1, as gd_hit has it */
	struct gd_v3 position;		/* world space */
	float z;			/* length of the path up to there, metres */
	int hits;			/* 1 if there was such a surface, else 0 */
};

/* What the ray from a pinhole through (px, py) finds; pixels from the upper left corner of an image
 * of w x h, y down, also outside of it. */
void gd_path_first(const struct gd_scene *scene, int w, int h, float px, float py,
		   struct gd_vertex *first);

/* All of out is finite. Arrays hold in->n values, the rest is 0. */
void gd_path_trace(const struct gd_scene *scene, const struct gd_path_conf *conf,
		   const struct gd_path_in *in, struct gd_draw *draw, struct gd_path_out *out);

#endif
