/* SPDX-License-Identifier: BSD-3-Clause */
/* Inside path.c and shift.c: a base path and its offset paths as they grow, segment by segment. */
#ifndef GD_RENDER_WALK_H
#define GD_RENDER_WALK_H

#include "render/path.h"

#define GD_ROULETTE_FROM 3	/* segments; shorter paths carry most of the light */

/*
 * Where an offset path stands once the base path has reached vertex x_k:
 *	OWN	at a vertex y_k of its own
 *	PENDING	at y_{k-1}: the event there was GD_ROUGH, so it depends on the label at x_k whether
 *		it joins the base path there (join says if it can) or copies the event and goes to
 *		a y_k
 *	FRESH	joined at x_k, coming from y_{k-1}: sees x_k along another direction
 *	SHARED	the last two vertices are the base path's
 *	DEAD	there is no such path
 */
enum gd_stand { GD_OWN, GD_PENDING, GD_FRESH, GD_SHARED, GD_DEAD };

struct gd_offset {
	enum gd_stand stand;
	/* Of the prefix, over the base's density: J f(y) / p(x) and J q(y) / p(x). PENDING: before
	 * the event at y_{k-1}; join_t and join_q with it, if it joins. */
	struct gd_v3 t, join_t;
	float q, join_q;
	float survive;			/* probability of the event under way to scatter at its vertex */
	bool join;
	struct gd_hit hit;		/* OWN, PENDING: its last vertex */
	struct gd_bsdf b;
	struct gd_bsdf turned;		/* FRESH, PENDING that can join: x_k, seen from y_{k-1} */
	/* What it brings to the path that ends now, over the base's density of it: J f, J q. */
	struct gd_v3 fy;
	float qy;
};

struct gd_walk {
	const struct gd_scene *scene;
	const struct gd_path_conf *conf;
	const struct gd_path_in *in;
	struct gd_draw *draw;
	struct gd_path_out *out;
	struct gd_hit hit;		/* x_k */
	struct gd_bsdf b;		/* at x_k */
	struct gd_v3 t;			/* f / p up to the event before x_k */
	struct gd_scatter last;		/* that event */
	int segments;			/* x_k is the end of so many */
	float survive;			/* probability to scatter there */
	int n;
	struct gd_offset o[4];
};

/* The event s at x_k has led to the next vertex, of which the base path knows: what a path that
 * ends there in light would be. */
struct gd_arrival {
	struct gd_vertex to;
	float pdf_light;		/* density of light sampling for it; 0 if it cannot */
	bool last;			/* no light is sampled there and nothing scatters */
};

/* Probability to go on from x_k or y_k with throughput t (f / p). It is a factor of the density of
 * BSDF sampling there, not of that of light sampling. */
float gd_walk_survival(const struct gd_walk *w, struct gd_v3 t);

/* Direction and origin of the camera ray through (px, py) of an image of w x h, lens on the unit
 * disc. */
struct gd_v3 gd_walk_camera(const struct gd_view *view, int w, int h, float px, float py,
			    const float lens[2], struct gd_v3 *origin);

/* Value times cosine of b for light from s, and the density with which b would have sampled it. */
struct gd_v3 gd_walk_reflect(const struct gd_bsdf *b, const struct gd_light_sample *s, float *pdf);

/*
 * What the offset paths do at each stage. Each leaves in fy, qy of every offset path what it
 * contributes to the path that ends there.
 * start: their camera rays, through the same point at of their pixel and of the lens.
 * light: the light sample s of x_k, which the base path sees or does not see; f, pdf_bsdf: what
 *	gd_walk_reflect() says of it there.
 * resolve: the base path goes on, to scatter event s. After its t was divided by survive.
 * follow: event s has led the base path to a. Before the walk's t and last become those of s.
 * ambient: an ambient light at the vertex reached.
 */
void gd_shift_start(struct gd_walk *w, const float at[2], const float lens[2]);
void gd_shift_light(struct gd_walk *w, const struct gd_light_sample *s, struct gd_v3 f,
		    float pdf_bsdf, bool seen);
void gd_shift_resolve(struct gd_walk *w, const struct gd_scatter *s);
void gd_shift_follow(struct gd_walk *w, const struct gd_scatter *s, const struct gd_arrival *a);
void gd_shift_ambient(struct gd_walk *w, const struct gd_arrival *a);

#endif
