/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * How a surface scatters. One material model, glTF's metallic-roughness with transmission, is a sum
 * of up to three lobes; m = metallic, t = transmission, D = Fresnel reflectance of a dielectric
 * (unpolarised, exact), F = (1 - m) D + m Schlick(base), h = half vector:
 *	diffuse		(1 - m) (1 - t) base / pi * (1 - D(n.o)) (1 - D(n.i))
 *	reflection	F(o.h) through GGX with visible normals
 *	transmission	(1 - m) t base (1 - D(o.h)) through GGX, refracted by ior
 * so that nothing reflects more than it gets. Masking is Smith's, correlated by height, in all of
 * GGX. alpha = roughness^2; below GD_SMOOTH the reflection and transmission are mirrors and panes
 * (delta functions). Where ior is 1 (to 1e-3) light passes straight on whatever the roughness is.
 * A material that lets nothing pass looks alike from both sides.
 *
 * Radiance is basic radiance, L / n^2: right wherever camera and lights stand in air. Reflection is
 * symmetric then, f(o, i) = f(i, o); transmission has n_o^2 f(o, i) = n_i^2 f(i, o), n_x: index of
 * the medium on x's side (Walter et al. 2007, equation 21, without the n^2 of radiance).
 *
 * Sides are those of the geometric normal. Directions on different sides of shading and geometric
 * normal scatter nothing; but where wo is such a direction the geometric normal is the frame, so
 * that no black rims appear.
 *
 * For gradient-domain path tracing each scattering event carries a label, a part of the path:
 *	GD_ROUGH	all lobes of alpha >= GD_SHARP together, and the diffuse one
 *	GD_REFLECT	the reflection, if its alpha < GD_SHARP
 *	GD_TRANSMIT	the transmission, if its alpha < GD_SHARP or it goes straight on
 * An offset path takes the label of its base path; values and densities are those of the label.
 * Their sum over labels is the whole BSDF.
 */
#ifndef GD_RENDER_BSDF_H
#define GD_RENDER_BSDF_H

#include "render/scene.h"

#define GD_SMOOTH 1e-3f	/* alpha below which a lobe narrower than float angles resolve is a delta */
#define GD_SHARP 0.05f	/* alpha (about the lobe's half width in radians) below which neighbouring
			   pixels see different reflections: joining paths there loses them */

enum gd_event { GD_ROUGH, GD_REFLECT, GD_TRANSMIT };

/* The material at one point, as seen along wo. */
struct gd_bsdf {
	struct gd_frame frame;		/* n: shading normal on the geometric normal's side, or the
					   geometric normal itself where wo demands it */
	struct gd_v3 ng, ns;		/* geometric and shading normal, ns on ng's side */
	struct gd_v3 wo;		/* where the path comes from, in the frame; z < 0: inside */
	struct gd_v3 diffuse;		/* albedo of the diffuse lobe, without (1 - D)(1 - D) */
	struct gd_v3 f0;		/* Schlick colour of the metal: m base */
	struct gd_v3 pass;		/* (1 - m) t base */
	float metallic, ior, alpha;
	float chance[3];		/* of each label, they sum to 1, or to 0 if all is black */
	float share[3];			/* of diffuse, reflection, transmission inside GD_ROUGH */
	struct gd_v3 albedo;		/* for G-buffers: the base colour of any lobes; 0 .. 1 */
	float through;			/* alpha of the transmission: alpha, or 0 if ior is 1 */
	float up;			/* 1 if wo.z > 0, else -1 */
	float eta;			/* index of the far side, seen from wo, over the near one */
	float reflected;		/* D(n.wo) */
	float slant;			/* sqrt(alpha^2 + (1 - alpha^2) wo.z^2), for masking */
};

struct gd_scatter {
	enum gd_event event;
	struct gd_v3 wi;		/* world space, length 1 */
	struct gd_v3 f;			/* value times |cos(n, wi)|, of the label alone;
					   smooth: factor of the delta function */
	float pdf;			/* times the chance, by solid angle; smooth: probability */
	bool smooth;
	struct gd_v3 copy;		/* what copies keep, in the frame mirrored so that wo.z > 0:
					   GD_ROUGH wi; else the half vector, z > 0 */
	float dw;			/* |d wi / d copy|, solid angles; 1 if smooth or GD_ROUGH */
};

/* hit on the surface of scene; wo in world space, length 1. false: nothing is scattered towards wo
 * (black, or wo within the surface to 1e-6); albedo, ng and ns are filled all the same. */
bool gd_bsdf_at(struct gd_bsdf *b, const struct gd_scene *scene, const struct gd_hit *hit,
		struct gd_v3 wo);

/* b, also one that came with false, as seen along another wo (world space, length 1). turned may
 * be b. */
bool gd_bsdf_turn(struct gd_bsdf *turned, const struct gd_bsdf *b, struct gd_v3 wo);

/* Draws a label, then a direction. u: uniform in [0, 1). false: absorbed. */
bool gd_bsdf_sample(const struct gd_bsdf *b, const float u[3], struct gd_scatter *s);

/* Value times cosine, and density with the label's chance, of label GD_ROUGH; wi in world space.
 * Both 0 where shading and geometric normal disagree about the side. */
struct gd_v3 gd_bsdf_rough(const struct gd_bsdf *b, struct gd_v3 wi, float *pdf);

/* Value times cosine of the sharp labels together, without the smooth: what a delta light sees. */
struct gd_v3 gd_bsdf_sharp(const struct gd_bsdf *b, struct gd_v3 wi);

/*
 * The event of another vertex taken over by this one: same label, same smoothness, same copy.
 * The Jacobian of the map from from->wi to to->wi is to->dw / from->dw. It is its own inverse:
 * copying back gives from. false where that does not exist.
 */
bool gd_bsdf_copy(const struct gd_bsdf *b, const struct gd_scatter *from, struct gd_scatter *to);

#endif
