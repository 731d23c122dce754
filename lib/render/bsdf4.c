/* SPDX-License-Identifier: BSD-3-Clause */
/* As bsdf.c has it, which tells the mathematics; branches there are masks here. */
#include "render/bsdf4.h"

#include "render/bsdf_impl.h"

#define PI GD_BSDF_PI

static inline gd_f4 fresnel(gd_f4 c, gd_f4 eta)
{
	const gd_f4 e = eta * eta, g2 = e - 1 + c * c, g = gd_sqrt4(gd_at_least4(g2, gd_all4(0)));
	const gd_f4 a = c + g, p = e * c + g, r = 1 / (a * p);
	const gd_f4 rs = (c - g) * p * r, rp = (e * c - g) * a * r;
	const gd_f4 d = gd_pick4(g2 > 0, 0.5f * (rs * rs + rp * rp), gd_all4(1));

	return gd_only4(eta != 1, d);
}

/* Where metallic is 0 f0 is black. */
static inline struct gd_v34 reflectance(gd_f4 metallic, struct gd_v34 f0, gd_f4 c, gd_f4 d)
{
	const gd_f4 k = gd_at_least4(1 - c, gd_all4(0)), k5 = k * k * k * k * k;
	const gd_f4 g = (1 - metallic) * d + metallic * k5, s = 1 - k5;

	return gd_v34(g + s * f0.x, g + s * f0.y, g + s * f0.z);
}

static inline gd_f4 slant(gd_f4 a2, gd_f4 z)
{
	return gd_sqrt4(a2 + (1 - a2) * z * z);
}

/* --- set-up --- */

#define LANES(field) \
	((gd_f4){ from[0]->field, from[1]->field, from[2]->field, from[3]->field })
#define VECTORS(field) gd_v34(LANES(field.x), LANES(field.y), LANES(field.z))

void gd_bsdf4_gather(struct gd_bsdf4 *b, const struct gd_bsdf *const given[4])
{
	static const struct gd_bsdf none;
	const struct gd_bsdf *from[4];

	for (int k = 0; k < 4; k++)
		from[k] = given[k] ? given[k] : &none;
	b->x = VECTORS(frame.x);
	b->y = VECTORS(frame.y);
	b->n = VECTORS(frame.n);
	b->ng = VECTORS(ng);
	b->up = LANES(up);
	b->wo = VECTORS(wo);
	b->wo.z *= b->up;
	b->diffuse = VECTORS(diffuse);
	b->f0 = VECTORS(f0);
	b->pass = VECTORS(pass);
	b->metallic = LANES(metallic);
	b->alpha = LANES(alpha);
	b->eta = LANES(eta);
	b->reflected = LANES(reflected);
	b->slant = LANES(slant);
	b->chance = LANES(chance[GD_ROUGH]);
	for (int k = 0; k < 3; k++)
		b->share[k] = LANES(share[k]);
}

static gd_f4 usual_reflected(const struct gd_bsdf4 *b)
{
	const gd_f4 a = b->alpha, z = b->wo.z, rho2 = gd_at_least4(1 - z * z, gd_all4(0));
	const gd_f4 hz = 0.5f * (gd_sqrt4(a * a * rho2 + z * z) + z);
	const gd_f4 c = (a * a * rho2 + z * hz) / gd_sqrt4(a * a * a * a * rho2 + hz * hz);

	return 0.5f * (fresnel(gd_at_least4(c - 0.5f * a, gd_all4(0)), b->eta) +
		       fresnel(gd_at_most4(c + 0.5f * a, gd_all4(1)), b->eta));
}

/* one: the material, the same in all lanes. Returns those that scatter anything. */
static gd_i4 chances(struct gd_bsdf4 *b, const struct gd_bsdf *one)
{
	const bool shines = one->metallic > 0 || one->ior != 1;
	const bool frosted = one->through >= GD_SMOOTH && !gd_black(one->pass);
	const bool rough[3] = { true, one->alpha >= GD_SHARP, one->through >= GD_SHARP };
	const gd_f4 usual = frosted ? usual_reflected(b) : b->reflected, none = gd_all4(0);
	gd_f4 e[3] = { (1 - b->reflected) * gd_luma(one->diffuse),
		       gd_luma4(reflectance(b->metallic, b->f0, b->wo.z, usual)),
		       (1 - usual) * gd_luma(one->pass) };
	gd_f4 least, all, joint = none;

	if (one->alpha >= GD_SMOOTH && shines)
		e[GD_REFLECTION] = gd_at_least4(e[GD_REFLECTION], gd_all4(GD_BSDF_FAINT));
	if (frosted)
		e[GD_TRANSMISSION] = gd_at_least4(e[GD_TRANSMISSION], gd_all4(GD_BSDF_FAINT));
	least = GD_BSDF_LEAST * (e[0] + e[1] + e[2]);
	for (int k = 0; k < 3; k++)
		e[k] = gd_only4(e[k] > 0, gd_at_least4(e[k], least));
	all = e[0] + e[1] + e[2];
	for (int k = 0; k < 3; k++)
		joint += rough[k] ? e[k] : none;
	b->chance = gd_only4(all > 0, joint / all);
	for (int k = 0; k < 3; k++)
		b->share[k] = rough[k] ? gd_only4(joint > 0, e[k] / joint) : none;
	return all > 0;
}

static void set_frame(struct gd_bsdf4 *b, const struct gd_frame *f)
{
	b->x = gd_v34_all(f->x);
	b->y = gd_v34_all(f->y);
	b->n = gd_v34_all(f->n);
}

static bool same(struct gd_v3 a, struct gd_v3 b)
{
	return a.x == b.x && a.y == b.y && a.z == b.z;
}

/* The frames are about the shading normal, but about the geometric one in the lanes not in fits. */
static void choose_frames(struct gd_bsdf4 *b, const struct gd_bsdf *one, gd_i4 fits)
{
	struct gd_frame f;

	if (same(one->frame.n, one->ns)) {
		set_frame(b, &one->frame);
	} else {
		f = gd_bsdf_frame(one->ns);
		set_frame(b, &f);
	}
	if (!gd_any4(~fits))
		return;
	f = gd_bsdf_frame(one->ng);
	b->x = gd_v34_pick(fits, b->x, gd_v34_all(f.x));
	b->y = gd_v34_pick(fits, b->y, gd_v34_all(f.y));
	b->n = gd_v34_pick(fits, b->n, gd_v34_all(f.n));
}

gd_i4 gd_bsdf4_turn(struct gd_bsdf4 *b, const struct gd_bsdf *one, const struct gd_v34 *wo)
{
	const struct gd_v34 ng = gd_v34_all(one->ng), ns = gd_v34_all(one->ns);
	const gd_f4 up = gd_pick4(gd_dot4(ng, *wo) < 0, gd_all4(-1), gd_all4(1));
	const float inside = gd_black(one->pass) ? one->ior : 1 / one->ior;
	gd_i4 ok;

	choose_frames(b, one, up * gd_dot4(ns, *wo) > 0);
	b->ng = ng;
	b->up = up;
	b->wo = gd_v34(gd_dot4(*wo, b->x), gd_dot4(*wo, b->y), up * gd_dot4(*wo, b->n));
	ok = b->wo.z >= GD_BSDF_FLAT;
	b->wo.z = gd_at_most4(b->wo.z, gd_all4(1));
	b->diffuse = gd_v34_all(one->diffuse);
	b->f0 = gd_v34_all(one->f0);
	b->pass = gd_v34_all(one->pass);
	b->metallic = gd_all4(one->metallic);
	b->alpha = gd_all4(one->alpha);
	b->eta = gd_pick4(up < 0, gd_all4(inside), gd_all4(one->ior));
	b->reflected = one->metallic < 1 ? fresnel(b->wo.z, b->eta) : gd_all4(0);
	b->slant = slant(b->alpha * b->alpha, b->wo.z);
	ok &= chances(b, one);
	b->chance = gd_only4(ok, b->chance);
	return ok;
}

struct gd_v3 gd_bsdf4_wo(const struct gd_bsdf4 *b, int k)
{
	const struct gd_frame f = { gd_v34_lane(&b->x, k), gd_v34_lane(&b->y, k),
				    gd_v34_lane(&b->n, k) };
	struct gd_v3 v = gd_v34_lane(&b->wo, k);

	v.z *= b->up[k];
	return gd_unit(gd_to_world(&f, v));
}

/* --- values --- */

/* The diffuse lobe at i, in the lanes of at; the others add theirs. */
static inline void set_diffuse(const struct gd_bsdf4 *b, gd_f4 iz, gd_i4 at, struct gd_v34 *f,
			       gd_f4 *pdf)
{
	const gd_f4 c = iz * (1 / PI), d = fresnel(gd_at_most4(iz, gd_all4(1)), b->eta);

	*f = gd_v34_only(at, gd_scale4(b->diffuse, c * (1 - b->reflected) * (1 - d)));
	*pdf = gd_only4(at, b->share[GD_DIFFUSE] * c);
}

static inline void add_reflection(const struct gd_bsdf4 *b, struct gd_v34 i, gd_i4 at,
				  struct gd_v34 *f, gd_f4 *pdf)
{
	const struct gd_v34 o = b->wo, v = gd_add4(o, i);
	const gd_f4 a2 = b->alpha * b->alpha, v2 = gd_dot4(v, v);
	const gd_f4 q = v.x * v.x + v.y * v.y + a2 * v.z * v.z, t = v2 / q;
	const gd_f4 oh = gd_at_most4(0.5f * gd_sqrt4(v2), gd_all4(1));
	const gd_f4 d = (0.5f / PI) * a2 * t * t;
	const gd_f4 s = d * i.z / (i.z * b->slant + o.z * slant(a2, i.z));
	const struct gd_v34 r = reflectance(b->metallic, b->f0, oh, fresnel(oh, b->eta));

	at &= q > 1e-20f;
	*f = gd_add4(*f, gd_v34_only(at, gd_scale4(r, s)));
	*pdf += gd_only4(at, b->share[GD_REFLECTION] * d / (o.z + b->slant));
}

static inline void add_transmission(const struct gd_bsdf4 *b, struct gd_v34 i, gd_i4 at,
				    struct gd_v34 *f, gd_f4 *pdf)
{
	const struct gd_v34 o = b->wo;
	const struct gd_v34 v = gd_add4(o, gd_scale4(i, b->eta));
	const gd_f4 a2 = b->alpha * b->alpha, v2 = gd_dot4(v, v);
	const gd_f4 q = v.x * v.x + v.y * v.y + a2 * v.z * v.z, t = v2 / q;
	const gd_f4 k = gd_pick4(v.z < 0, gd_all4(-1), gd_all4(1)) / gd_sqrt4(v2);
	const gd_f4 oh = k * gd_dot4(o, v), ih = -k * gd_dot4(i, v);
	const gd_f4 c = gd_at_most4(oh, gd_all4(1));
	const gd_f4 d = (2 / PI) * a2 * t * t * c * ih * b->eta * b->eta / v2;
	const gd_f4 s = (1 - fresnel(c, b->eta)) * d * -i.z /
			(o.z * slant(a2, i.z) - i.z * b->slant);

	at &= (q > 1e-20f) & (oh > 0) & (ih > 0);
	*f = gd_add4(*f, gd_v34_only(at, gd_scale4(b->pass, s)));
	*pdf += gd_only4(at, b->share[GD_TRANSMISSION] * d / (o.z + b->slant));
}

struct gd_v34 gd_bsdf4_rough(const struct gd_bsdf4 *b, const struct gd_v34 *wi, gd_f4 *pdf)
{
	const struct gd_v34 i = gd_v34(gd_dot4(*wi, b->x), gd_dot4(*wi, b->y),
				       b->up * gd_dot4(*wi, b->n));
	const gd_i4 at = (b->up * gd_dot4(b->ng, *wi) * i.z > 0) & (b->chance > 0);
	const gd_i4 above = at & (i.z > 0), below = at & (i.z < 0);
	const gd_i4 diffuse = above & (b->share[GD_DIFFUSE] > 0);
	const gd_i4 shines = above & (b->share[GD_REFLECTION] > 0);
	const gd_i4 lets = below & (b->share[GD_TRANSMISSION] > 0);
	struct gd_v34 f;

	set_diffuse(b, i.z, diffuse, &f, pdf);
	if (gd_any4(shines))
		add_reflection(b, i, shines, &f, pdf);
	if (gd_any4(lets))
		add_transmission(b, i, lets, &f, pdf);
	*pdf *= b->chance;
	return f;
}
