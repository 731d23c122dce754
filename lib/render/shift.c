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

struct rays {
	struct gd_v3 o[4], d[4];
	float t[4];
	unsigned active;
};

static void ray(struct rays *r, int k, struct gd_v3 o, struct gd_v3 d)
{
	r->o[k] = o;
	r->d[k] = d;
	r->active |= 1U << k;
}

/* Those of the lanes of active between which and their ends, t along d, there is nothing. */
static gd_i4 are_free(const struct gd_walk *w, const struct gd_v34 *from, const struct gd_v34 *d,
		      gd_f4 t, gd_i4 active)
{
	struct rays r;

	for (int k = 0; k < 4; k++) {
		r.o[k] = gd_v34_lane(from, k);
		r.d[k] = gd_v34_lane(d, k);
		r.t[k] = t[k];
	}
	return gd_mask4(gd_ray_free4(w->scene, r.o, r.d, r.t, gd_bits4(active)));
}

static void nothing(struct gd_offsets *o)
{
	const gd_f4 zero = gd_all4(0);

	o->fy = gd_v34(zero, zero, zero);
	o->qy = zero;
}

/* Probabilities that paths of throughput t / q scatter at their vertices. */
static gd_f4 survival(const struct gd_walk *w, struct gd_v34 t, gd_f4 q)
{
	const gd_f4 one = gd_all4(1);

	if (w->segments < GD_ROULETTE_FROM)
		return one;
	return gd_at_most4(gd_at_least4(gd_largest4(t) / q, gd_all4(GD_SURVIVAL_LEAST)), one);
}

static const struct gd_bsdf4 *own_side(struct gd_offsets *o)
{
	if (!o->gathered)
		gd_bsdf4_gather(&o->side, o->b);
	o->gathered = true;
	return &o->side;
}

/* Lane k has a vertex of its own now. */
static void settle(struct gd_offsets *o, int k, struct gd_v3 p, const struct gd_bsdf *b)
{
	o->own[k] = -1;
	gd_v34_put(&o->p, k, p);
	o->b[k] = b;
	o->gathered = false;
}

/* --- ends of a path --- */

/* Adds to sum, but for what would make it infinite or no number. */
static inline void gather(struct gd_v34 *sum, struct gd_v34 a)
{
	const struct gd_v34 s = gd_add4(*sum, a);

	*sum = gd_v34_pick(gd_finite4(s), s, *sum);
}

void gd_shift_add(struct gd_walk *w, struct gd_v3 fx, float p)
{
	struct gd_offsets *o = &w->o;

	if (gd_black(fx) && !gd_any4(~gd_black4(o->fy)))
		return;

	const float ratio = w->conf->shift_ratio;
	const gd_f4 x = gd_all4(gd_luma(fx)), y = gd_luma4(o->fy);
	/* Do f(x) and J f(y) differ by more than a factor, neither of them 0? */
	const gd_i4 apart = (x > 0) & (y > 0) & ((x > ratio * y) | (y > ratio * x));
	const gd_f4 d = 1 / (p + gd_only4(~apart, o->r * o->qy));

	gather(&o->mine, gd_scale4(gd_v34_all(fx), d));
	gather(&o->theirs, gd_v34_only(~apart, gd_scale4(o->fy, d)));
}

/* --- rays to vertices of their own --- */

/* The radiance that a ray of the lane finds, and what it then stands at. */
static void arrive(struct gd_walk *w, int k, bool met, const struct rays *r,
		   const struct gd_hit *hit)
{
	struct gd_offsets *o = &w->o;
	const struct gd_v3 back = gd_scale(r->d[k], -1);
	const struct gd_v3 light = met ? gd_light_emitted(w->scene, hit) :
					 gd_environment_at(w->scene, r->d[k]);

	gd_v34_put(&o->fy, k, gd_mul(gd_v34_lane(&o->t, k), light));
	o->qy[k] = o->q[k];
	if (met && gd_bsdf_at(&o->found[k], w->scene, hit, back))
		settle(o, k, hit->p, &o->found[k]);
}

static void trace(struct gd_walk *w, const struct rays *r)
{
	struct gd_hit hit[4];
	unsigned met;

	if (!r->active)
		return;
	met = gd_ray_hit4(w->scene, r->o, r->d, r->active, hit);
	for (int k = 0; k < 4; k++)
		if (r->active >> k & 1)
			arrive(w, k, met >> k & 1, r, &hit[k]);
}

/* Its first vertex is known. */
static void start_at(struct gd_offsets *o, int k, const struct gd_vertex *first)
{
	gd_v34_put(&o->fy, k, first->radiance);
	o->qy[k] = 1;
	if (first->solid)
		settle(o, k, first->hit.p, &first->b);
}

void gd_shift_start(struct gd_walk *w, const float at[2], const float lens[2])
{
	const struct gd_path_in *in = w->in;
	struct gd_offsets *o = &w->o;
	const gd_i4 no = gd_mask4(0);
	struct rays r = { .active = 0 };

	nothing(o);
	o->own = o->pending = o->fresh = o->shared = o->join = no;
	o->t = gd_v34_all(gd_v3(1, 1, 1));
	o->q = o->r = gd_all4(1);
	o->mine = o->theirs = o->p = o->fy;
	o->gathered = false;
	for (int k = 0; k < 4; k++)
		o->b[k] = NULL;
	for (int k = 0; k < w->n; k++) {
		struct gd_v3 from, d;

		o->r[k] = in->r[k];
		if (in->others[k]) {
			start_at(o, k, in->others[k]);
			continue;
		}
		d = gd_walk_camera(&w->scene->view, in->w, in->h,
				   (float)(in->x + in->dx[k]) + at[0],
				   (float)(in->y + in->dy[k]) + at[1], lens, &from);
		ray(&r, k, from, d);
	}
	trace(w, &r);
}

/* --- light sampling --- */

/* Value times cosine of the sharp label's lobes, which a delta light sees, too; x: the base path's
 * vertex, which lanes that join see along turned, or NULL: they are at their own. */
static struct gd_v34 sharp_values(const struct gd_offsets *o, const struct gd_bsdf *x,
				  const struct gd_v34 *d, gd_i4 active)
{
	struct gd_v34 f = gd_v34_all(gd_v3(0, 0, 0));

	for (int k = 0; k < 4; k++) {
		const struct gd_bsdf *b = o->b[k];
		struct gd_bsdf turned;

		if (!active[k])
			continue;
		if (x) {
			gd_bsdf_turn(&turned, x, gd_bsdf4_wo(&o->turned, k));
			b = &turned;
		}
		gd_v34_put(&f, k, gd_bsdf_sharp(b, gd_v34_lane(d, k)));
	}
	return f;
}

/* The base path's vertex, seen as it is or from another side. */
static void light_there(struct gd_walk *w, const struct gd_light_sample *s, struct gd_v3 f,
			float pdf_bsdf, bool seen)
{
	struct gd_offsets *o = &w->o;
	const gd_i4 joins = o->pending & o->join, all = o->shared | joins;
	struct gd_v34 t = o->t, g = gd_v34_all(f);
	gd_f4 q = o->q, pdf = gd_all4(pdf_bsdf);
	gd_i4 there = all;

	if (gd_any4(joins)) {
		const struct gd_v34 d = gd_v34_all(s->d);
		gd_f4 pdf_turned;
		struct gd_v34 turned = gd_bsdf4_rough(&o->turned, &d, &pdf_turned);

		if (s->delta) {
			pdf_turned = gd_all4(0);
			turned = gd_add4(turned, sharp_values(o, &w->at->b, &d, joins));
		}
		g = gd_v34_pick(joins, turned, g);
		pdf = gd_pick4(joins, pdf_turned, pdf);
		t = gd_v34_pick(joins, o->join_t, t);
		q = gd_pick4(joins, o->join_q, q);
		there &= ~gd_black4(g);
	}
	pdf = s->pdf + (seen ? survival(w, t, q) * pdf : gd_all4(0));
	if (seen)
		o->fy = gd_v34_only(there, gd_mul4(t, gd_mul4(g, gd_v34_all(s->radiance))));
	o->qy = gd_only4(there, q * pdf);
}

/* The same light seen from vertices of their own. */
static void light_own(struct gd_walk *w, const struct gd_light_sample *s, uint32_t blocker)
{
	struct gd_offsets *o = &w->o;
	struct gd_light_sample4 again;
	gd_i4 at = gd_light_again4(w->scene, &o->p, s, o->own, &again), open;
	struct gd_v34 f;
	gd_f4 pdf, jacobian, by_bsdf;

	if (!gd_any4(at))
		return;
	f = gd_bsdf4_rough(own_side(o), &again.d, &pdf);
	if (s->delta) {
		pdf = gd_all4(0);
		f = gd_add4(f, sharp_values(o, NULL, &again.d, at));
	}
	at &= (again.pdf > 0) & ~gd_black4(f) & ~gd_black4(again.radiance);
	if (!gd_any4(at))
		return;
	jacobian = s->pdf / again.pdf;
	f = gd_mul4(gd_scale4(o->t, jacobian), gd_mul4(f, again.radiance));
	by_bsdf = o->q * survival(w, o->t, o->q) * jacobian * pdf;
	open = at;
	if (blocker != GD_NO_INDEX)	/* most often it is in their way as well */
		open &= ~gd_ray_blocked4(w->scene, blocker, &o->p, &again.d, again.t);
	if (gd_any4(open))
		open &= are_free(w, &o->p, &again.d, again.t, open);
	o->fy = gd_v34_pick(o->own, gd_v34_only(open, f), o->fy);
	o->qy = gd_pick4(at, o->q * s->pdf + gd_only4(open, by_bsdf), o->qy);
}

void gd_shift_light(struct gd_walk *w, const struct gd_light_sample *s, struct gd_v3 f,
		    float pdf_bsdf, uint32_t blocker)
{
	struct gd_offsets *o = &w->o;

	nothing(o);
	if (gd_any4(o->shared | (o->pending & o->join)))
		light_there(w, s, f, pdf_bsdf, blocker == GD_NO_INDEX);
	if (gd_any4(o->own))
		light_own(w, s, blocker);
}

/* --- scattering --- */

/* Copies event s, of density s->pdf, at the vertices of which: its factors go into t and q. */
static void copy_event(struct gd_walk *w, gd_i4 which, const struct gd_scatter *s)
{
	struct gd_offsets *o = &w->o;
	struct rays r = { .active = 0 };

	for (int k = 0; k < 4; k++) {
		struct gd_scatter to;
		float jacobian;

		if (!which[k] || !gd_bsdf_copy(o->b[k], s, &to) || gd_black(to.f))
			continue;
		jacobian = to.dw / s->dw;
		gd_v34_put(&o->t, k, gd_mul(gd_v34_lane(&o->t, k),
					    gd_scale(to.f, jacobian / s->pdf)));
		o->q[k] *= jacobian * to.pdf / s->pdf;
		ray(&r, k, gd_v34_lane(&o->p, k), to.wi);
	}
	trace(w, &r);
}

static void join_pending(struct gd_offsets *o)
{
	const gd_i4 joins = o->pending & o->join;

	o->t = gd_v34_pick(joins, o->join_t, o->t);
	o->q = gd_pick4(joins, o->join_q, o->q);
	o->fresh |= joins;
}

void gd_shift_resolve(struct gd_walk *w, const struct gd_scatter *s)
{
	struct gd_offsets *o = &w->o;
	const gd_i4 pending = o->pending;
	gd_i4 alive;

	if (gd_any4(pending) && s->event == GD_ROUGH)
		join_pending(o);
	else if (gd_any4(pending))
		copy_event(w, pending, &w->last);
	o->pending = gd_mask4(0);
	alive = o->q > 0;
	o->own &= alive;
	o->fresh &= alive;
	o->shared &= alive;
	o->survive = survival(w, o->t, o->q);
	o->t = gd_scale4(o->t, gd_all4(1 / w->survive));
	o->q *= o->survive / w->survive;
}

/* Paths that scatter at the base path's vertex. */
static void follow_there(struct gd_offsets *o, const struct gd_scatter *s,
			 const struct gd_arrival *a)
{
	struct gd_v34 f = gd_v34_all(s->f);
	gd_f4 pdf = gd_all4(s->pdf);

	if (gd_any4(o->fresh)) {
		const struct gd_v34 wi = gd_v34_all(s->wi);
		gd_f4 pdf_turned;
		const struct gd_v34 turned = gd_bsdf4_rough(&o->turned, &wi, &pdf_turned);

		f = gd_v34_pick(o->fresh, turned, f);
		pdf = gd_pick4(o->fresh, pdf_turned, pdf);
		o->shared |= o->fresh & ~gd_black4(turned);
		o->fresh = gd_mask4(0);
	}
	f = gd_mul4(o->t, gd_scale4(f, gd_all4(1 / s->pdf)));
	o->t = gd_v34_pick(o->shared, f, o->t);
	o->fy = gd_v34_only(o->shared, gd_mul4(f, gd_v34_all(a->to->radiance)));
	o->qy = gd_only4(o->shared, o->q * (pdf + a->pdf_light / o->survive) / s->pdf);
	o->q = gd_pick4(o->shared, o->q * (pdf / s->pdf), o->q);
}

/*
 * From y_k to the base path's next vertex: join_t, join_q as if nothing were between.
 * dw'/dw = (cos' / d'^2) / (cos / d^2), with the angles at that vertex; 1 if it is far away.
 * Those that can reach it: d, t of the rays there.
 */
static gd_i4 reach(struct gd_offsets *o, const struct gd_scatter *s, const struct gd_vertex *to,
		   struct gd_v34 *d, gd_f4 *t)
{
	gd_f4 jacobian = gd_all4(1), pdf;
	struct gd_v34 f;

	*d = gd_v34_all(s->wi);
	*t = gd_all4(INFINITY);
	if (!to->miss) {
		const struct gd_v34 way = gd_sub4(gd_v34_all(to->hit.p), o->p);
		const struct gd_v34 ng = gd_v34_all(to->hit.ng);
		const float cosine = fabsf(gd_dot(to->hit.ng, s->wi));

		*t = gd_sqrt4(gd_dot4(way, way));
		*d = gd_scale4(way, 1 / *t);
		jacobian = gd_abs4(gd_dot4(ng, *d)) * (to->hit.t * to->hit.t) / (cosine * *t * *t);
	}
	f = gd_bsdf4_rough(own_side(o), d, &pdf);
	o->join_t = gd_mul4(o->t, gd_scale4(f, jacobian / s->pdf));
	o->join_q = o->q * jacobian * pdf / s->pdf;
	return (*t > 0) & (jacobian > 0) & (jacobian < INFINITY) & ~gd_black4(f);
}

/* Offset paths that reach for x_{k+1} (event GD_ROUGH); they are pending from then on. */
static void follow_rough(struct gd_walk *w, const struct gd_scatter *s, const struct gd_arrival *a)
{
	const bool goes_on = a->to->solid && !a->last;
	struct gd_offsets *o = &w->o;
	const gd_i4 own = o->own;
	struct gd_v34 d;
	gd_i4 at, open;
	gd_f4 t;

	o->own = o->join = gd_mask4(0);
	if (!goes_on && gd_black(a->to->radiance))
		return;
	o->pending = own;
	at = own & reach(o, s, a->to, &d, &t);
	if (!gd_any4(at))
		return;
	open = at & are_free(w, &o->p, &d, t, at);
	/* The light at its end is as dense for y as for x: J q'(light) = p(light). */
	o->qy = gd_pick4(at, o->q * (a->pdf_light / (o->survive * s->pdf)) +
				     gd_only4(open, o->join_q), o->qy);
	o->fy = gd_v34_pick(open, gd_mul4(o->join_t, gd_v34_all(a->to->radiance)), o->fy);
	if (!goes_on || !gd_any4(open))
		return;
	d = gd_scale4(d, gd_all4(-1));
	o->join = open & (o->join_q > 0) & gd_bsdf4_turn(&o->turned, &a->to->b, &d);
}

/* Offset paths that copy a sharp event and look for a vertex of their own. */
static void follow_sharp(struct gd_walk *w, const struct gd_scatter *s, const struct gd_arrival *a)
{
	struct gd_offsets *o = &w->o;
	const gd_i4 own = o->own;

	o->own = gd_mask4(0);
	copy_event(w, own, s);
	if (!a->to->solid || a->last)
		o->own = gd_mask4(0);
}

void gd_shift_follow(struct gd_walk *w, const struct gd_scatter *s, const struct gd_arrival *a)
{
	struct gd_offsets *o = &w->o;

	nothing(o);
	if (gd_any4(o->shared | o->fresh))
		follow_there(o, s, a);
	if (!gd_any4(o->own))
		return;
	if (s->event == GD_ROUGH)
		follow_rough(w, s, a);
	else
		follow_sharp(w, s, a);
}

void gd_shift_ambient(struct gd_walk *w, const struct gd_arrival *a)
{
	struct gd_offsets *o = &w->o;
	const gd_i4 joins = o->pending & o->join, at = o->own | o->shared | joins;
	const struct gd_v34 t = gd_v34_pick(joins, o->join_t, o->t);
	struct gd_v34 c = gd_v34_all(a->to->b.albedo);

	for (int k = 0; k < 4; k++)
		if (o->own[k])
			gd_v34_put(&c, k, o->b[k]->albedo);
	c = gd_mul4(t, gd_scale4(c, gd_all4(w->conf->ambient)));
	o->fy = gd_v34_only(at, c);
	o->qy = gd_only4(at, gd_pick4(joins, o->join_q, o->q));
}
