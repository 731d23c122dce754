/* SPDX-License-Identifier: BSD-3-Clause */
/* Inside path.c and shift.c: a base path and its offset paths as they grow, segment by segment. */
#ifndef GD_RENDER_WALK_H
#define GD_RENDER_WALK_H

#include "render/bsdf4.h"
#include "render/path.h"

#define GD_ROULETTE_FROM 3	/* segments; shorter paths carry most of the light */

/*
 * The offset paths, one in each lane, and where each stands once the base path has reached x_k:
 *	own	at a vertex y_k of its own
 *	pending	at y_{k-1}: the event there was GD_ROUGH, so it depends on the label at x_k whether
 *		it joins the base path there (join says if it can) or copies the event and goes to
 *		a y_k
 *	fresh	joined at x_k, coming from y_{k-1}: sees x_k along another direction
 *	shared	the last two vertices are the base path's
 * A lane in none of them has no path.
 */
struct gd_offsets {
	gd_i4 own, pending, fresh, shared;
	gd_i4 join;			/* some of pending */
	/* Of the prefix, over the base's density: J f(y) / p(x) and J q(y) / p(x). Pending: before
	 * the event at y_{k-1}; join_t and join_q with it, if it joins. */
	struct gd_v34 t, join_t;
	gd_f4 q, join_q;
	gd_f4 survive;			/* probability to scatter in the event under way */
	gd_f4 r;			/* samples of its pixel over those of the base's */
	struct gd_v34 p;		/* own, pending: its last vertex */
	const struct gd_bsdf *b[4];
	struct gd_bsdf found[4];	/* b, of a vertex that others do not share */
	bool gathered;			/* side is what b has */
	struct gd_bsdf4 side;
	struct gd_bsdf4 turned;		/* fresh, join: x_k, seen from y_{k-1} */
	/* What it brings to the path that ends now, over the base's density of it: J f, J q. */
	struct gd_v34 fy;
	gd_f4 qy;
	struct gd_v34 mine, theirs;	/* those of gd_path_out */
};

struct gd_walk {
	const struct gd_scene *scene;
	const struct gd_path_conf *conf;
	const struct gd_path_in *in;
	struct gd_draw *draw;
	struct gd_path_out *out;
	const struct gd_vertex *at;	/* x_k; one of room, or a vertex that paths share */
	struct gd_vertex room[2];
	struct gd_v3 t;			/* f / p up to the event before x_k */
	struct gd_scatter last;		/* that event */
	int segments;			/* x_k is the end of so many */
	float survive;			/* probability to scatter there */
	int n;
	struct gd_offsets o;		/* only with n > 0 */
};

/* The event s at x_k has led to the next vertex, of which the base path knows: what a path that
 * ends there in light would be. */
struct gd_arrival {
	const struct gd_vertex *to;
	float pdf_light;		/* density of light sampling for it; 0 if it cannot */
	bool last;			/* no light is sampled there and nothing scatters */
};

#define GD_SURVIVAL_LEAST 0.05f	/* so that a path that survives counts 20 times at most */

/* Direction and origin of the camera ray through (px, py) of an image of w x h, lens on the unit
 * disc. */
struct gd_v3 gd_walk_camera(const struct gd_view *view, int w, int h, float px, float py,
			    const float lens[2], struct gd_v3 *origin);

/*
 * What the offset paths do at each stage. Each leaves in fy, qy of every offset path what it
 * contributes to the path that ends there.
 * start: their camera rays, through the same point at of their pixel and of the lens.
 * light: the light sample s of x_k; f, pdf_bsdf: what the vertex reflects of it, and the density
 *	with which it would have sampled it; blocker: a triangle between, or GD_NO_INDEX.
 * resolve: the base path goes on, to scatter event s. After its t was divided by survive.
 * follow: event s has led the base path to a. Before the walk's t and last become those of s.
 * ambient: an ambient light at the vertex reached.
 * add: the path ends: f of the base path, and P, both over one density.
 */
void gd_shift_start(struct gd_walk *w, const float at[2], const float lens[2]);
void gd_shift_light(struct gd_walk *w, const struct gd_light_sample *s, struct gd_v3 f,
		    float pdf_bsdf, uint32_t blocker);
void gd_shift_resolve(struct gd_walk *w, const struct gd_scatter *s);
void gd_shift_follow(struct gd_walk *w, const struct gd_scatter *s, const struct gd_arrival *a);
void gd_shift_ambient(struct gd_walk *w, const struct gd_arrival *a);
void gd_shift_add(struct gd_walk *w, struct gd_v3 fx, float p);

#endif
