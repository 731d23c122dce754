/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Below, o and i are wo and wi in the frame mirrored so that o.z > 0: eta alone knows which side
 * of the surface that is.
 */
#include "render/bsdf_impl.h"

#define PI	GD_BSDF_PI
#define STRAIGHT 1e-3f	/* refracting by less than this times a tangent is not refracting */
#define INDEX	100.0f	/* nothing refracts more */

static inline float clamp01(float x)
{
	return gd_at_most(gd_at_least(x, 0), 1);
}

static inline struct gd_v3 colour(struct gd_v3 a)
{
	return gd_v3(clamp01(a.x), clamp01(a.y), clamp01(a.z));
}

static inline struct gd_v3 to_near(const struct gd_bsdf *b, struct gd_v3 w)
{
	struct gd_v3 v = gd_to_local(&b->frame, w);

	v.z *= b->up;
	return v;
}

static inline struct gd_v3 from_near(const struct gd_bsdf *b, struct gd_v3 v)
{
	v.z *= b->up;
	return gd_to_world(&b->frame, v);
}

static inline struct gd_v3 near_wo(const struct gd_bsdf *b)
{
	return gd_v3(b->wo.x, b->wo.y, b->up * b->wo.z);
}

/* Do both normals find wi (near: i) on the same side of the surface? */
static inline bool sides_agree(const struct gd_bsdf *b, struct gd_v3 wi, float iz)
{
	return b->up * gd_dot(b->ng, wi) * iz > 0;
}

/* D: share of unpolarised light that a dielectric reflects; c: cosine, eta: far index over near. */
static inline float fresnel(float c, float eta)
{
	const float e = eta * eta, g2 = e - 1 + c * c;

	if (eta == 1)
		return 0;
	if (!(g2 > 0))
		return 1;
	const float g = sqrtf(g2), a = c + g, p = e * c + g, r = 1 / (a * p);
	const float rs = (c - g) * p * r, rp = (e * c - g) * a * r;

	return 0.5f * (rs * rs + rp * rp);
}

/* F, given D. */
static inline struct gd_v3 reflectance(const struct gd_bsdf *b, float c, float d)
{
	const float a = (1 - b->metallic) * d;

	if (b->metallic == 0)
		return gd_v3(a, a, a);
	const float k = gd_at_least(1 - c, 0), k5 = k * k * k * k * k, g = a + b->metallic * k5;

	return gd_mad(gd_v3(g, g, g), 1 - k5, b->f0);
}

static inline float slant(float a2, float z)
{
	return sqrtf(a2 + (1 - a2) * z * z);
}

/* --- GGX. t = 1 / (h.x^2 + h.y^2 + alpha^2 h.z^2), so that D = alpha^2 t^2 / pi --- */

/*
 * With s = slant(): G1(o) = 2 o.z / (o.z + s_o), G2(o, i) = 2 o.z i.z / (i.z s_o + o.z s_i).
 * Returns value times cosine, sets the density of i.
 */
static inline struct gd_v3 ggx_reflect(const struct gd_bsdf *b, float oz, float iz, float oh,
				       float t, float *pdf)
{
	const float a2 = b->alpha * b->alpha, d = 0.5f * a2 * t * t / PI;

	*pdf = d / (oz + b->slant);
	return gd_scale(reflectance(b, oh, b->metallic < 1 ? fresnel(oh, b->eta) : 0),
			d * iz / (iz * b->slant + oz * slant(a2, iz)));
}

/* iz = |i.z|, ih = |i.h|, v2 = |o + eta i|^2 */
static inline struct gd_v3 ggx_refract(const struct gd_bsdf *b, float oz, float iz, float oh,
				       float ih, float v2, float t, float *pdf)
{
	const float a2 = b->alpha * b->alpha;
	const float d = 2 * a2 * t * t / PI * oh * ih * b->eta * b->eta / v2;

	*pdf = d / (oz + b->slant);
	return gd_scale(b->pass, (1 - fresnel(oh, b->eta)) * d * iz /
				 (iz * b->slant + oz * slant(a2, iz)));
}

/* Reflection at i, i.z > 0. */
static inline struct gd_v3 reflection_at(const struct gd_bsdf *b, struct gd_v3 o, struct gd_v3 i,
					 float *pdf)
{
	const struct gd_v3 v = gd_add(o, i);
	const float v2 = gd_dot(v, v), q = v.x * v.x + v.y * v.y + b->alpha * b->alpha * v.z * v.z;

	*pdf = 0;
	if (!(q > 1e-20f))	/* both within the surface, opposite */
		return gd_v3(0, 0, 0);
	return ggx_reflect(b, o.z, i.z, gd_at_most(0.5f * sqrtf(v2), 1), v2 / q, pdf);
}

/* Transmission at i, i.z < 0. */
static inline struct gd_v3 transmission_at(const struct gd_bsdf *b, struct gd_v3 o, struct gd_v3 i,
					   float *pdf)
{
	struct gd_v3 v = gd_mad(o, b->eta, i);
	const float v2 = gd_dot(v, v), q = v.x * v.x + v.y * v.y + b->alpha * b->alpha * v.z * v.z;

	*pdf = 0;
	if (!(q > 1e-20f))
		return gd_v3(0, 0, 0);
	const float k = copysignf(1, v.z) / sqrtf(v2), oh = k * gd_dot(o, v), ih = k * gd_dot(i, v);

	if (!(oh > 0 && ih < 0))	/* no microfacet refracts so */
		return gd_v3(0, 0, 0);
	return ggx_refract(b, o.z, -i.z, gd_at_most(oh, 1), -ih, v2, v2 / q, pdf);
}

/* A microfacet normal among those that o sees (Dupuy and Benyoub 2023). */
static struct gd_v3 visible_normal(float alpha, struct gd_v3 o, float u, float v)
{
	const struct gd_v3 w = gd_unit(gd_v3(alpha * o.x, alpha * o.y, o.z));
	const float hz = (1 - v) * (1 + w.z), z = hz - w.z, r = sqrtf(gd_at_least(1 - z * z, 0));
	float sine, cosine;

	sincosf(2 * PI * u, &sine, &cosine);
	return gd_unit(gd_v3(alpha * (r * cosine + w.x), alpha * (r * sine + w.y), hz));
}

static inline bool reflect(struct gd_v3 o, struct gd_v3 h, struct gd_v3 *i)
{
	const float c = gd_dot(o, h);

	*i = gd_sub(gd_scale(h, 2 * c), o);
	return c > 0 && i->z > 0;
}

static inline bool refract(float eta, struct gd_v3 o, struct gd_v3 h, struct gd_v3 *i)
{
	const float c = gd_dot(o, h), g2 = eta * eta - 1 + c * c, r = 1 / eta;

	if (!(c > 0 && g2 > 0))
		return false;
	*i = gd_mad(gd_scale(o, -r), r * (c - sqrtf(g2)), h);
	return i->z < 0;
}

/* --- the material --- */

/*
 * D on rough glass, roughly: at the microfacet in the middle of those that wo sees, half a lobe
 * either way, as there is nothing between hardly any and total reflection from the inside.
 */
static float usual_reflected(const struct gd_bsdf *b, float z)
{
	const float a = b->alpha, rho2 = gd_at_least(1 - z * z, 0), l = sqrtf(a * a * rho2 + z * z);
	const float hz = 0.5f * (l + z), c = (a * a * rho2 + z * hz) /
					     sqrtf(a * a * a * a * rho2 + hz * hz);

	return 0.5f * (fresnel(gd_at_least(c - 0.5f * a, 0), b->eta) +
		       fresnel(gd_at_most(c + 0.5f * a, 1), b->eta));
}

/*
 * Labels get samples by the energy that each lobe sends to wo, roughly. It may be more than that,
 * or go where the estimate says there is nothing: hence the least.
 */
static bool chances(struct gd_bsdf *b)
{
	const float z = b->up * b->wo.z;
	const bool shines = b->metallic > 0 || b->eta != 1;
	const bool frosted = b->through >= GD_SMOOTH && !gd_black(b->pass);
	const float usual = frosted ? usual_reflected(b, z) : b->reflected;
	float e[3] = { (1 - b->reflected) * gd_luma(b->diffuse), gd_luma(reflectance(b, z, usual)),
		       (1 - usual) * gd_luma(b->pass) };

	if (b->alpha >= GD_SMOOTH && shines)
		e[GD_REFLECTION] = gd_at_least(e[GD_REFLECTION], GD_BSDF_FAINT);
	if (frosted)
		e[GD_TRANSMISSION] = gd_at_least(e[GD_TRANSMISSION], GD_BSDF_FAINT);

	const float least = GD_BSDF_LEAST * (e[0] + e[1] + e[2]);

	for (int k = 0; k < 3; k++)
		e[k] = e[k] > 0 ? gd_at_least(e[k], least) : 0;

	const float all = e[0] + e[1] + e[2], r = all > 0 ? 1 / all : 0;
	const bool rough[3] = { true, b->alpha >= GD_SHARP, b->through >= GD_SHARP };
	float joint = 0;

	for (int k = 0; k < 3; k++) {
		joint += rough[k] ? e[k] : 0;
		b->chance[k] = rough[k] ? 0 : e[k] * r;
	}
	b->chance[GD_ROUGH] = joint * r;
	for (int k = 0; k < 3; k++)
		b->share[k] = joint > 0 && rough[k] ? e[k] / joint : 0;
	return all > 0;
}

/* All that depends on wo. */
static bool look(struct gd_bsdf *b, struct gd_v3 wo)
{
	const float side = gd_dot(b->ng, wo) < 0 ? -1 : 1;
	const bool fits = side * gd_dot(b->ns, wo) > 0;

	b->frame = gd_bsdf_frame(fits ? b->ns : b->ng);
	b->wo = gd_to_local(&b->frame, wo);
	b->up = side;
	b->eta = side < 0 && !gd_black(b->pass) ? 1 / b->ior : b->ior;
	if (!(side * b->wo.z >= GD_BSDF_FLAT)) {
		for (int k = 0; k < 3; k++)
			b->chance[k] = b->share[k] = 0;
		return false;
	}
	b->wo.z = side * gd_at_most(side * b->wo.z, 1);
	b->reflected = b->metallic < 1 ? fresnel(side * b->wo.z, b->eta) : 0;
	b->slant = slant(b->alpha * b->alpha, b->wo.z);
	return chances(b);
}

static struct gd_v3 texel(const struct gd_scene *scene, uint32_t map, const struct gd_hit *hit)
{
	return map < scene->ntexture ? gd_texture_at(&scene->texture[map], hit->u, hit->v) :
				       gd_v3(1, 1, 1);
}

/* n of length 1, or instead if it is none. */
static struct gd_v3 normal(struct gd_v3 n, struct gd_v3 instead)
{
	const float n2 = gd_dot(n, n);

	if (fabsf(n2 - 1) < 1e-5f)
		return n;
	return n2 > 1e-20f && n2 < 1e20f ? gd_scale(n, 1 / sqrtf(n2)) : instead;
}

bool gd_bsdf_at(struct gd_bsdf *b, const struct gd_scene *scene, const struct gd_hit *hit,
		struct gd_v3 wo)
{
	const struct gd_material *mat = &scene->material[scene->triangle[hit->triangle].material];
	const struct gd_v3 rough = texel(scene, mat->rough_map, hit);
	const struct gd_v3 base = colour(gd_mul(mat->base, texel(scene, mat->base_map, hit)));
	const float m = clamp01(mat->metallic * rough.z), r = clamp01(mat->roughness * rough.y);
	const float t = clamp01(mat->transmission);

	b->ng = normal(hit->ng, gd_v3(0, 0, 1));
	b->ns = normal(hit->ns, b->ng);
	if (gd_dot(b->ns, b->ng) < 0)
		b->ns = gd_scale(b->ns, -1);
	b->albedo = base;
	b->diffuse = gd_scale(base, (1 - m) * (1 - t));
	b->pass = gd_scale(base, (1 - m) * t);
	b->f0 = gd_scale(base, m);
	b->metallic = m;
	b->ior = gd_at_most(gd_at_least(mat->ior, 1), INDEX);
	if (b->ior < 1 + STRAIGHT)
		b->ior = 1;
	b->alpha = r * r;
	b->through = b->ior == 1 ? 0 : b->alpha;
	return look(b, wo);
}

bool gd_bsdf_turn(struct gd_bsdf *turned, const struct gd_bsdf *b, struct gd_v3 wo)
{
	if (turned != b)
		*turned = *b;
	return look(turned, wo);
}

/* --- values --- */

/* GD_ROUGH at i. */
static inline struct gd_v3 rough_at(const struct gd_bsdf *b, struct gd_v3 i, float *pdf)
{
	const struct gd_v3 o = near_wo(b);
	struct gd_v3 f = gd_v3(0, 0, 0);
	float p = 0, q;

	if (i.z > 0) {
		if (b->share[GD_DIFFUSE] > 0) {
			const float c = i.z / PI;
			const float d = fresnel(gd_at_most(i.z, 1), b->eta);

			f = gd_scale(b->diffuse, c * (1 - b->reflected) * (1 - d));
			p = b->share[GD_DIFFUSE] * c;
		}
		if (b->share[GD_REFLECTION] > 0) {
			f = gd_add(f, reflection_at(b, o, i, &q));
			p += b->share[GD_REFLECTION] * q;
		}
	} else if (i.z < 0 && b->share[GD_TRANSMISSION] > 0) {
		f = transmission_at(b, o, i, &q);
		p = b->share[GD_TRANSMISSION] * q;
	}
	*pdf = b->chance[GD_ROUGH] * p;
	return f;
}

struct gd_v3 gd_bsdf_rough(const struct gd_bsdf *b, struct gd_v3 wi, float *pdf)
{
	const struct gd_v3 i = to_near(b, wi);

	*pdf = 0;
	if (!(b->chance[GD_ROUGH] > 0 && sides_agree(b, wi, i.z)))
		return gd_v3(0, 0, 0);
	return rough_at(b, i, pdf);
}

struct gd_v3 gd_bsdf_sharp(const struct gd_bsdf *b, struct gd_v3 wi)
{
	const bool mirror = b->chance[GD_REFLECT] > 0 && b->alpha >= GD_SMOOTH;
	const bool pane = b->chance[GD_TRANSMIT] > 0 && b->through >= GD_SMOOTH;
	float pdf;

	if (!mirror && !pane)
		return gd_v3(0, 0, 0);
	const struct gd_v3 i = to_near(b, wi);

	if (!sides_agree(b, wi, i.z))
		return gd_v3(0, 0, 0);
	if (i.z > 0)
		return mirror ? reflection_at(b, near_wo(b), i, &pdf) : gd_v3(0, 0, 0);
	return pane ? transmission_at(b, near_wo(b), i, &pdf) : gd_v3(0, 0, 0);
}

/* --- events --- */

static inline bool is_smooth(const struct gd_bsdf *b, enum gd_event event)
{
	return event != GD_ROUGH &&
	       (event == GD_REFLECT ? b->alpha : b->through) < GD_SMOOTH;
}

/* Value, density and |d i / d h| of the sharp lobes at i, whose half vector is h. */
static bool sharp_event(const struct gd_bsdf *b, struct gd_v3 o, struct gd_v3 i,
			struct gd_scatter *s)
{
	const struct gd_v3 h = s->copy;
	const float oh = gd_at_most(gd_dot(o, h), 1);
	const float t = 1 / (h.x * h.x + h.y * h.y + b->alpha * b->alpha * h.z * h.z);

	if (s->event == GD_REFLECT) {
		s->f = ggx_reflect(b, o.z, i.z, oh, t, &s->pdf);
		s->dw = 4 * oh;
	} else {
		const float ih = -gd_dot(i, h), v = oh - b->eta * ih;

		if (!(ih > 0))
			return false;
		s->f = ggx_refract(b, o.z, -i.z, oh, ih, v * v, t, &s->pdf);
		s->dw = v * v / (b->eta * b->eta * ih);
	}
	s->pdf *= b->chance[s->event];
	return s->pdf > 0;
}

/* The factor of a delta function. */
static bool smooth_event(const struct gd_bsdf *b, float oz, struct gd_scatter *s)
{
	s->dw = 1;
	s->pdf = b->chance[s->event];
	s->f = s->event == GD_REFLECT ? reflectance(b, oz, b->reflected) :
					gd_scale(b->pass, 1 - b->reflected);
	return true;
}

/* Fills s from its event and copy. */
static bool complete(const struct gd_bsdf *b, struct gd_scatter *s)
{
	const struct gd_v3 o = near_wo(b);
	struct gd_v3 i = s->copy;

	if (s->event == GD_REFLECT && !reflect(o, s->copy, &i))
		return false;
	if (s->event == GD_TRANSMIT && !refract(b->eta, o, s->copy, &i))
		return false;
	s->wi = from_near(b, i);
	if (!sides_agree(b, s->wi, i.z))
		return false;
	s->smooth = is_smooth(b, s->event);
	if (s->smooth)
		return smooth_event(b, o.z, s);
	if (s->event != GD_ROUGH)
		return sharp_event(b, o, i, s);
	s->dw = 1;
	s->f = rough_at(b, i, &s->pdf);
	return s->pdf > 0;
}

static bool draw_rough(const struct gd_bsdf *b, float choice, float u, float v, struct gd_v3 *i)
{
	const struct gd_v3 o = near_wo(b);

	if (choice < b->share[GD_DIFFUSE]) {
		const float r = sqrtf(u);
		float sine, cosine;

		sincosf(2 * PI * v, &sine, &cosine);
		*i = gd_v3(r * cosine, r * sine, sqrtf(1 - u));
		return true;
	}
	const struct gd_v3 h = visible_normal(b->alpha, o, u, v);

	if (b->share[GD_TRANSMISSION] == 0 || choice < b->share[GD_DIFFUSE] + b->share[GD_REFLECTION])
		return b->share[GD_REFLECTION] > 0 && reflect(o, h, i);
	return refract(b->eta, o, h, i);
}

bool gd_bsdf_sample(const struct gd_bsdf *b, const float u[3], struct gd_scatter *s)
{
	const float *chance = b->chance;

	if (u[0] < chance[GD_ROUGH]) {
		s->event = GD_ROUGH;
		if (!draw_rough(b, u[0] / chance[GD_ROUGH], u[1], u[2], &s->copy))
			return false;
		return complete(b, s);
	}
	if (chance[GD_REFLECT] + chance[GD_TRANSMIT] == 0)
		return false;
	s->event = chance[GD_TRANSMIT] == 0 ||
		   (u[0] < chance[GD_ROUGH] + chance[GD_REFLECT]) ? GD_REFLECT : GD_TRANSMIT;
	s->copy = is_smooth(b, s->event) ? gd_v3(0, 0, 1) :
					   visible_normal(b->alpha, near_wo(b), u[1], u[2]);
	return complete(b, s);
}

bool gd_bsdf_copy(const struct gd_bsdf *b, const struct gd_scatter *from, struct gd_scatter *to)
{
	if (!(b->chance[from->event] > 0) || is_smooth(b, from->event) != from->smooth)
		return false;
	to->event = from->event;
	to->copy = from->copy;
	return complete(b, to);
}
