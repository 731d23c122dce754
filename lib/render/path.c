/* SPDX-License-Identifier: BSD-3-Clause */
/* The base path: camera ray, light sampling, scattering, roulette; and what paths add up to. */
#include "render/path.h"

#include <string.h>

#include "render/walk.h"
#include "rng.h"

struct gd_draw gd_draw_start(uint64_t seed, uint32_t x, uint32_t y, uint32_t sample)
{
	const struct gd_rng_key key = gd_rng_key(seed, (uint64_t)y << 32 | x);
	struct gd_draw d = {
		.state = (uint64_t)gd_rng_u32(key, sample, 0) << 32 | gd_rng_u32(key, sample, 1),
		.step = (uint64_t)gd_rng_u32(key, sample, 2) << 32 | gd_rng_u32(key, sample, 3) | 1,
	};

	return d;
}

/* PCG-XSH-RR (O'Neill 2014). */
float gd_draw(struct gd_draw *d)
{
	const uint64_t s = d->state;
	const uint32_t x = (uint32_t)((s >> 18 ^ s) >> 27), turn = (uint32_t)(s >> 59);

	d->state = s * 6364136223846793005ULL + d->step;
	return (float)((x >> turn | x << (-turn & 31)) >> 8) * 0x1p-24f;
}

/* Probability to go on from x_k with throughput t (f / p). It is a factor of the density of BSDF
 * sampling there, not of that of light sampling. */
static float survival(const struct gd_walk *w)
{
	if (w->segments < GD_ROULETTE_FROM)
		return 1;
	return gd_at_most(gd_at_least(gd_largest(w->t), GD_SURVIVAL_LEAST), 1);
}

struct gd_v3 gd_walk_camera(const struct gd_view *view, int w, int h, float px, float py,
			    const float lens[2], struct gd_v3 *origin)
{
	const float x = (2 * px / (float)w - 1) * view->tan_x;
	const float y = (1 - 2 * py / (float)h) * view->tan_y;
	const struct gd_v3 through = gd_mad(gd_mad(view->forward, x, view->right), y, view->up);
	struct gd_v3 shift;

	*origin = view->origin;
	if (view->lens <= 0)
		return gd_unit(through);
	shift = gd_mad(gd_scale(view->right, view->lens * lens[0]), view->lens * lens[1], view->up);
	*origin = gd_add(view->origin, shift);
	return gd_unit(gd_sub(gd_scale(through, view->focus), shift));
}

/* Value times cosine of b for light from s, and the density with which b would have sampled it. */
static struct gd_v3 reflect(const struct gd_bsdf *b, const struct gd_light_sample *s, float *pdf)
{
	struct gd_v3 f = gd_bsdf_rough(b, s->d, pdf);

	if (!s->delta)
		return f;
	*pdf = 0;
	return gd_add(f, gd_bsdf_sharp(b, s->d));
}

/* Leaves out what would make the sum infinite or no number. */
static void gather(struct gd_v3 *sum, struct gd_v3 a)
{
	const struct gd_v3 s = gd_add(*sum, a);

	if (gd_finite(s))
		*sum = s;
}

static void add_path(struct gd_walk *w, struct gd_v3 fx, float p)
{
	gather(&w->out->colour, gd_scale(fx, 1 / p));
	if (w->n)
		gd_shift_add(w, fx, p);
}

/* The ray from o along d: where a path may end, or go on. */
static void look(const struct gd_scene *scene, struct gd_v3 o, struct gd_v3 d, struct gd_vertex *to)
{
	to->miss = !gd_ray_hit(scene, o, d, &to->hit);
	to->solid = false;
	if (to->miss) {
		to->radiance = gd_environment_at(scene, d);
		return;
	}
	to->radiance = gd_light_emitted(scene, &to->hit);
	to->solid = gd_bsdf_at(&to->b, scene, &to->hit, gd_scale(d, -1));
}

void gd_path_first(const struct gd_scene *scene, int w, int h, float px, float py,
		   struct gd_vertex *first)
{
	static const float centre[2] = { 0, 0 };
	struct gd_v3 o;
	const struct gd_v3 d = gd_walk_camera(&scene->view, w, h, px, py, centre, &o);

	look(scene, o, d, first);
}

/* G-buffers: of the first surface that is not a mirror or a pane. */
static void note_surface(const struct gd_walk *w, const struct gd_arrival *a, float z)
{
	const struct gd_vertex *x = a->to;
	struct gd_path_out *out = w->out;
	const bool clear = x->solid && x->b.chance[GD_ROUGH] == 0 && x->b.alpha < GD_SMOOTH;

	if (out->hits || x->miss || clear)
		return;
	out->hits = 1;
	out->z = z;
	out->normal = x->hit.ns;
	out->position = x->hit.p;
	if (x->solid) {
		const struct gd_v3 c = gd_mul(x->b.albedo, w->t);

		out->albedo = gd_v3(gd_at_most(c.x, 1), gd_at_most(c.y, 1), gd_at_most(c.z, 1));
	}
}

static void sample_light(struct gd_walk *w)
{
	const float choice = gd_draw(w->draw), u = gd_draw(w->draw), v = gd_draw(w->draw);
	struct gd_light_sample s;
	struct gd_v3 f;
	uint32_t blocker;
	float pdf;
	bool seen;

	if (!gd_light_sample(w->scene, w->at->hit.p, choice, u, v, &s) || !(s.pdf > 0))
		return;
	if (!w->conf->mis && !s.delta)
		return;
	f = reflect(&w->at->b, &s, &pdf);
	if (gd_black(f) || gd_black(s.radiance))
		return;
	blocker = gd_ray_blocker(w->scene, w->at->hit.p, s.d, s.t);
	seen = blocker == GD_NO_INDEX;
	if (w->n)
		gd_shift_light(w, &s, f, pdf, blocker);
	else if (!seen)
		return;
	add_path(w, seen ? gd_mul(w->t, gd_mul(f, s.radiance)) : gd_v3(0, 0, 0),
		 s.pdf + (seen ? w->survive * pdf : 0));
}

/* Density with which light sampling at x_k would have found what event s found. */
static float density_of_light(const struct gd_walk *w, const struct gd_scatter *s,
			      const struct gd_arrival *a)
{
	if (s->event != GD_ROUGH || !w->conf->mis || gd_black(a->to->radiance))
		return 0;
	return a->to->miss ? gd_environment_pdf(w->scene, s->wi) :
			 gd_light_pdf(w->scene, &a->to->hit, s->wi);
}

/* Ambient light, for the gradients alone. */
static void add_ambient(struct gd_walk *w, const struct gd_arrival *a)
{
	if (!w->n || !a->to->solid || w->conf->ambient <= 0)
		return;
	gd_shift_ambient(w, a);
	gd_shift_add(w, gd_scale(gd_mul(w->t, a->to->b.albedo), w->conf->ambient), 1);
}

/* From x_k to the next vertex. Returns false if the path ends at x_k. */
static bool scatter(struct gd_walk *w, struct gd_arrival *a)
{
	struct gd_vertex *to;
	struct gd_scatter s;
	float u[3];

	if (w->survive < 1 && gd_draw(w->draw) >= w->survive)
		return false;
	for (int i = 0; i < 3; i++)
		u[i] = gd_draw(w->draw);
	if (!gd_bsdf_sample(&w->at->b, u, &s) || gd_black(s.f))
		return false;
	w->t = gd_scale(w->t, 1 / w->survive);
	if (w->n)
		gd_shift_resolve(w, &s);
	to = w->at == &w->room[0] ? &w->room[1] : &w->room[0];
	look(w->scene, w->at->hit.p, s.wi, to);
	a->to = to;
	a->last = w->segments + 1 >= w->conf->depth;
	a->pdf_light = density_of_light(w, &s, a);
	if (w->n)
		gd_shift_follow(w, &s, a);
	w->t = gd_mul(w->t, gd_scale(s.f, 1 / s.pdf));
	w->last = s;
	add_path(w, gd_mul(w->t, a->to->radiance), 1 + a->pdf_light / (w->survive * s.pdf));
	add_ambient(w, a);
	return true;
}

/* A point of the unit disc, from the square (Shirley and Chiu 1997). */
static void to_disc(float u, float v, float lens[2])
{
	const float a = 2 * u - 1, b = 2 * v - 1, quarter = 0.785398163f;
	float r, phi;

	lens[0] = lens[1] = 0;
	if (a == 0 && b == 0)
		return;
	if (fabsf(a) > fabsf(b)) {
		r = a;
		phi = quarter * b / a;
	} else {
		r = b;
		phi = 2 * quarter - quarter * a / b;
	}
	lens[0] = r * cosf(phi);
	lens[1] = r * sinf(phi);
}

static void start(struct gd_walk *w, struct gd_arrival *a)
{
	const struct gd_path_in *in = w->in;
	const struct gd_view *view = &w->scene->view;
	float at[2], lens[2] = { 0, 0 };

	for (int i = 0; i < 2; i++)
		at[i] = in->at ? in->at[i] : gd_draw(w->draw);
	if (view->lens > 0) {
		const float u = gd_draw(w->draw), v = gd_draw(w->draw);

		to_disc(u, v, lens);
	}
	a->to = in->first;
	if (!in->first) {
		struct gd_v3 o;
		const struct gd_v3 d = gd_walk_camera(view, in->w, in->h, (float)in->x + at[0],
						      (float)in->y + at[1], lens, &o);

		look(w->scene, o, d, &w->room[0]);
		a->to = &w->room[0];
	}
	a->pdf_light = 0;
	if (w->n)
		gd_shift_start(w, at, lens);
	add_path(w, a->to->radiance, 1);
	add_ambient(w, a);
}

void gd_path_trace(const struct gd_scene *scene, const struct gd_path_conf *conf,
		   const struct gd_path_in *in, struct gd_draw *draw, struct gd_path_out *out)
{
	struct gd_walk w;
	struct gd_arrival a;
	float z;

	memset(out, 0, sizeof *out);
	w.scene = scene;
	w.conf = conf;
	w.in = in;
	w.draw = draw;
	w.out = out;
	w.n = in->n;
	w.t = gd_v3(1, 1, 1);
	start(&w, &a);
	z = a.to->miss ? 0 : a.to->hit.t;
	note_surface(&w, &a, z);
	for (w.segments = 1; a.to->solid && w.segments < conf->depth; w.segments++) {
		w.at = a.to;
		w.survive = survival(&w);
		if (scene->nlight)
			sample_light(&w);
		if (!scatter(&w, &a))
			break;
		z += a.to->miss ? 0 : a.to->hit.t;
		if (w.last.smooth)
			note_surface(&w, &a, z);
		else
			out->hits |= 2;
	}
	out->hits &= 1;
	for (int k = 0; k < in->n; k++) {
		out->mine[k] = gd_v34_lane(&w.o.mine, k);
		out->theirs[k] = gd_v34_lane(&w.o.theirs, k);
		out->half[k] = gd_sub(out->theirs[k], out->mine[k]);
	}
}
