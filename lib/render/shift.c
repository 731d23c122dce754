/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Offset paths (Kettunen et al. 2015, section 5): reconnection and copied events, their Jacobians,
 * and the densities that the balance heuristic needs.
 *
 * A path with a factor f = 0 of its own (a surface that scatters nothing there) is never made by
 * any technique, so it has q = 0, too; one whose light is merely hidden is made by light sampling,
 * and counts with that density.
 */
#include "render/walk.h"

static const struct gd_v3 black = { 0, 0, 0 };

struct rays {
	struct gd_v3 o[4], d[4];
	float t[4];
	unsigned active;
};

static void ray(struct rays *r, int k, struct gd_v3 o, struct gd_v3 d, float t)
{
	r->o[k] = o;
	r->d[k] = d;
	r->t[k] = t;
	r->active |= 1U << k;
}

static void nothing(struct gd_offset *o)
{
	o->fy = black;
	o->qy = 0;
}

static void die(struct gd_offset *o)
{
	o->stand = GD_DEAD;
	nothing(o);
}

/* Probability that a path of throughput t / q scatters at its vertex. */
static float survival(const struct gd_walk *w, struct gd_v3 t, float q)
{
	return gd_walk_survival(w, gd_scale(t, 1 / q));
}

/* The offset path has found a vertex of its own, or left the scene: it may end there in light. */
static void arrive(const struct gd_walk *w, struct gd_offset *o, bool hit, struct gd_v3 d,
		   const struct gd_hit *at)
{
	const struct gd_v3 back = gd_scale(d, -1);

	o->fy = gd_mul(o->t, hit ? gd_light_emitted(w->scene, at, back)
				 : gd_environment_at(w->scene, d));
	o->qy = o->q;
	o->stand = GD_DEAD;
	if (!hit)
		return;
	o->hit = *at;
	if (gd_bsdf_at(&o->b, w->scene, at, back))
		o->stand = GD_OWN;
}

/* Its first vertex is known. */
static void start_at(struct gd_offset *o, const struct gd_vertex *first)
{
	o->fy = first->radiance;
	o->qy = 1;
	o->stand = GD_DEAD;
	if (!first->solid)
		return;
	o->stand = GD_OWN;
	o->hit = first->hit;
	o->b = first->b;
}

void gd_shift_start(struct gd_walk *w, const float at[2], const float lens[2])
{
	const struct gd_path_in *in = w->in;
	struct rays r = { .active = 0 };
	struct gd_hit hit[4];
	unsigned met;

	for (int k = 0; k < w->n; k++) {
		struct gd_v3 o, d;

		w->o[k].t = gd_v3(1, 1, 1);
		w->o[k].q = 1;
		if (in->others[k]) {
			start_at(&w->o[k], in->others[k]);
			continue;
		}
		d = gd_walk_camera(&w->scene->view, in->w, in->h,
				   (float)(in->x + in->dx[k]) + at[0],
				   (float)(in->y + in->dy[k]) + at[1], lens, &o);
		ray(&r, k, o, d, INFINITY);
	}
	if (!r.active)
		return;
	met = gd_ray_hit4(w->scene, r.o, r.d, r.active, hit);
	for (int k = 0; k < w->n; k++)
		if (r.active >> k & 1)
			arrive(w, &w->o[k], met >> k & 1, r.d[k], &hit[k]);
}

/* --- light sampling --- */

/* x_k itself, seen along another direction. */
static void light_joined(const struct gd_walk *w, struct gd_offset *o,
			 const struct gd_light_sample *s, bool seen)
{
	const struct gd_v3 t = o->stand == GD_PENDING ? o->join_t : o->t;
	const float q = o->stand == GD_PENDING ? o->join_q : o->q;
	float pdf;
	const struct gd_v3 f = gd_walk_reflect(&o->turned, s, &pdf);

	nothing(o);
	if (gd_black(f))
		return;
	if (seen)
		o->fy = gd_mul(t, gd_mul(f, s->radiance));
	o->qy = q * (s->pdf + (seen ? survival(w, t, q) * pdf : 0));
}

/* The same light seen from a vertex of its own; fy as if nothing were between, and the density of
 * BSDF sampling beside it. */
static void light_own(struct gd_walk *w, int k, const struct gd_light_sample *s,
		      struct rays *r, float by_bsdf[4])
{
	struct gd_offset *o = &w->o[k];
	struct gd_light_sample again;
	struct gd_v3 f;
	float jacobian, pdf;

	nothing(o);
	if (!gd_light_again(w->scene, o->hit.p, s, &again) || !(again.pdf > 0))
		return;
	f = gd_walk_reflect(&o->b, &again, &pdf);
	if (gd_black(f) || gd_black(again.radiance))
		return;
	jacobian = s->pdf / again.pdf;
	o->fy = gd_mul(gd_scale(o->t, jacobian), gd_mul(f, again.radiance));
	o->qy = o->q * s->pdf;
	by_bsdf[k] = o->q * survival(w, o->t, o->q) * jacobian * pdf;
	ray(r, k, o->hit.p, again.d, again.t);
}

void gd_shift_light(struct gd_walk *w, const struct gd_light_sample *s, struct gd_v3 f,
		    float pdf_bsdf, bool seen)
{
	struct rays r = { .active = 0 };
	float by_bsdf[4];
	unsigned open;

	for (int k = 0; k < w->n; k++) {
		struct gd_offset *o = &w->o[k];

		if (o->stand == GD_SHARED) {
			o->fy = seen ? gd_mul(o->t, gd_mul(f, s->radiance)) : black;
			o->qy = o->q * s->pdf;
			if (seen)
				o->qy += o->q * survival(w, o->t, o->q) * pdf_bsdf;
		} else if (o->stand == GD_FRESH || (o->stand == GD_PENDING && o->join)) {
			light_joined(w, o, s, seen);
		} else if (o->stand == GD_OWN) {
			light_own(w, k, s, &r, by_bsdf);
		} else {
			nothing(o);
		}
	}
	if (!r.active)
		return;
	open = gd_ray_free4(w->scene, r.o, r.d, r.t, r.active);
	for (int k = 0; k < w->n; k++) {
		if (!(r.active >> k & 1))
			continue;
		if (open >> k & 1)
			w->o[k].qy += by_bsdf[k];
		else
			w->o[k].fy = black;
	}
}

/* --- scattering --- */

/* Copies event s of density s->pdf to vertex y: its factors go into t and q, its ray into r. */
static bool copy_event(struct gd_offset *o, int k, const struct gd_scatter *s, struct rays *r)
{
	struct gd_scatter to;
	float jacobian;

	if (!gd_bsdf_copy(&o->b, s, &to) || gd_black(to.f))
		return false;
	jacobian = to.dw / s->dw;
	o->t = gd_mul(o->t, gd_scale(to.f, jacobian / s->pdf));
	o->q *= jacobian * to.pdf / s->pdf;
	ray(r, k, o->hit.p, to.wi, INFINITY);
	return true;
}

/* Pending offset paths whose base path is sharp at x_k copy the event before it. */
static void copy_pending(struct gd_walk *w)
{
	struct rays r = { .active = 0 };
	struct gd_hit hit[4];
	unsigned met;

	for (int k = 0; k < w->n; k++)
		if (w->o[k].stand == GD_PENDING && !copy_event(&w->o[k], k, &w->last, &r))
			die(&w->o[k]);
	if (!r.active)
		return;
	met = gd_ray_hit4(w->scene, r.o, r.d, r.active, hit);
	for (int k = 0; k < w->n; k++)
		if (r.active >> k & 1)
			arrive(w, &w->o[k], met >> k & 1, r.d[k], &hit[k]);
}

static void join_pending(struct gd_walk *w)
{
	for (int k = 0; k < w->n; k++) {
		struct gd_offset *o = &w->o[k];

		if (o->stand != GD_PENDING)
			continue;
		o->stand = o->join ? GD_FRESH : GD_DEAD;
		o->t = o->join_t;
		o->q = o->join_q;
	}
}

void gd_shift_resolve(struct gd_walk *w, const struct gd_scatter *s)
{
	if (s->event == GD_ROUGH)
		join_pending(w);
	else
		copy_pending(w);
	for (int k = 0; k < w->n; k++) {
		struct gd_offset *o = &w->o[k];

		if (o->stand == GD_DEAD)
			continue;
		if (!(o->q > 0)) {
			die(o);
			continue;
		}
		o->survive = survival(w, o->t, o->q);
		o->t = gd_scale(o->t, 1 / w->survive);
		o->q *= o->survive / w->survive;
	}
}

static void follow_shared(struct gd_offset *o, const struct gd_scatter *s,
			  const struct gd_arrival *a)
{
	o->t = gd_mul(o->t, gd_scale(s->f, 1 / s->pdf));
	o->fy = gd_mul(o->t, a->to.radiance);
	o->qy = o->q * (1 + a->pdf_light / (o->survive * s->pdf));
}

static void follow_fresh(struct gd_offset *o, const struct gd_scatter *s,
			 const struct gd_arrival *a)
{
	float pdf;
	const struct gd_v3 f = gd_bsdf_rough(&o->turned, s->wi, &pdf);

	if (gd_black(f)) {
		die(o);
		return;
	}
	o->t = gd_mul(o->t, gd_scale(f, 1 / s->pdf));
	o->fy = gd_mul(o->t, a->to.radiance);
	o->qy = o->q * (pdf + a->pdf_light / o->survive) / s->pdf;
	o->q *= pdf / s->pdf;
	o->stand = GD_SHARED;
}

/*
 * From y_k to the base path's next vertex: join_t, join_q as if nothing were between.
 * dw'/dw = (cos' / d'^2) / (cos / d^2), with the angles at that vertex; 1 if it is far away.
 */
static void reach(struct gd_walk *w, int k, const struct gd_scatter *s,
		  const struct gd_arrival *a, struct rays *r)
{
	struct gd_offset *o = &w->o[k];
	struct gd_v3 d = s->wi, f;
	float t = INFINITY, jacobian = 1, pdf;

	o->stand = GD_PENDING;
	o->join = false;
	nothing(o);
	if (!a->to.miss) {
		const struct gd_v3 way = gd_sub(a->to.hit.p, o->hit.p);
		const float cosine = fabsf(gd_dot(a->to.hit.ng, s->wi));

		t = gd_length(way);
		if (!(t > 0))
			return;
		d = gd_scale(way, 1 / t);
		jacobian = fabsf(gd_dot(a->to.hit.ng, d)) * a->to.hit.t * a->to.hit.t / (cosine * t * t);
	}
	if (!(jacobian > 0) || !isfinite(jacobian))
		return;
	f = gd_bsdf_rough(&o->b, d, &pdf);
	if (gd_black(f))
		return;
	o->join_t = gd_mul(o->t, gd_scale(f, jacobian / s->pdf));
	o->join_q = o->q * jacobian * pdf / s->pdf;
	ray(r, k, o->hit.p, d, t);
}

/* Offset paths that reach for x_{k+1} (event GD_ROUGH); they are PENDING from then on. */
static void follow_rough(struct gd_walk *w, const struct gd_scatter *s, const struct gd_arrival *a)
{
	const bool goes_on = a->to.solid && !a->last;
	struct rays r = { .active = 0 };
	unsigned open;

	for (int k = 0; k < w->n; k++) {
		struct gd_offset *o = &w->o[k];

		if (o->stand != GD_OWN)
			continue;
		if (goes_on || !gd_black(a->to.radiance))
			reach(w, k, s, a, &r);
		else
			die(o);
	}
	if (!r.active)
		return;
	open = gd_ray_free4(w->scene, r.o, r.d, r.t, r.active);
	for (int k = 0; k < w->n; k++) {
		struct gd_offset *o = &w->o[k];

		if (!(r.active >> k & 1))
			continue;
		/* The light at its end is as dense for y as for x: J q'(light) = p(light). */
		o->qy = o->q * a->pdf_light / (o->survive * s->pdf);
		if (!(open >> k & 1))
			continue;
		o->qy += o->join_q;
		o->fy = gd_mul(o->join_t, a->to.radiance);
		o->join = goes_on && o->join_q > 0 &&
			  gd_bsdf_turn(&o->turned, &a->to.b,
				       gd_scale(r.d[k], -1));
	}
}

/* Offset paths that copy a sharp event and look for a vertex of their own. */
static void follow_sharp(struct gd_walk *w, const struct gd_scatter *s, const struct gd_arrival *a)
{
	struct rays r = { .active = 0 };
	struct gd_hit hit[4];
	unsigned met;

	for (int k = 0; k < w->n; k++)
		if (w->o[k].stand == GD_OWN && !copy_event(&w->o[k], k, s, &r))
			die(&w->o[k]);
	if (!r.active)
		return;
	met = gd_ray_hit4(w->scene, r.o, r.d, r.active, hit);
	for (int k = 0; k < w->n; k++) {
		struct gd_offset *o = &w->o[k];

		if (!(r.active >> k & 1))
			continue;
		arrive(w, o, met >> k & 1, r.d[k], &hit[k]);
		if (!a->to.solid || a->last)
			o->stand = GD_DEAD;
	}
}

void gd_shift_follow(struct gd_walk *w, const struct gd_scatter *s, const struct gd_arrival *a)
{
	for (int k = 0; k < w->n; k++) {
		struct gd_offset *o = &w->o[k];

		if (o->stand == GD_SHARED)
			follow_shared(o, s, a);
		else if (o->stand == GD_FRESH)
			follow_fresh(o, s, a);
		else if (o->stand == GD_DEAD)
			nothing(o);
	}
	if (s->event == GD_ROUGH)
		follow_rough(w, s, a);
	else
		follow_sharp(w, s, a);
}

void gd_shift_ambient(struct gd_walk *w, const struct gd_arrival *a)
{
	const float radiance = w->conf->ambient;

	for (int k = 0; k < w->n; k++) {
		struct gd_offset *o = &w->o[k];

		nothing(o);
		if (o->stand == GD_OWN || o->stand == GD_SHARED) {
			const struct gd_v3 c = o->stand == GD_OWN ? o->b.albedo : a->to.b.albedo;

			o->fy = gd_scale(gd_mul(o->t, c), radiance);
			o->qy = o->q;
		} else if (o->stand == GD_PENDING && o->join) {
			o->fy = gd_scale(gd_mul(o->join_t, o->turned.albedo), radiance);
			o->qy = o->join_q;
		}
	}
}
