/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * A scene ready for rays: triangles in world space, materials with textures, lights and a camera.
 * It comes from a glTF 2.0 file (.gltf or .glb); lengths are metres, radiance is in any unit.
 *
 * Read-only after loading: every routine below that takes a const struct gd_scene may be called
 * from any number of threads.
 */
#ifndef GD_RENDER_SCENE_H
#define GD_RENDER_SCENE_H

#include <stdint.h>

#include "gd.h"
#include "render/four.h"

#define GD_NO_INDEX UINT32_MAX
#define GD_SKY_MAX 1e30f	/* radiance; sums over directions and paths stay finite */

/*
 * glTF's metallic-roughness material. Colours are linear. Texture indices may be GD_NO_INDEX; a
 * factor multiplies its texture.
 */
struct gd_material {
	struct gd_v3 base;		/* 0 .. 1 */
	struct gd_v3 emission;		/* radiance, strength included */
	float metallic, roughness;	/* 0 .. 1; as in the file: GGX alpha is roughness^2 */
	float transmission;		/* share of what is not reflected that passes; 0 .. 1 */
	float ior;			/* of the inside over the outside, >= 1 */
	uint32_t base_map;		/* RGB */
	uint32_t rough_map;		/* G: roughness, B: metallic */
	uint32_t emission_map;		/* RGB */
};

/* Pixels of 3 interleaved linear floats, row 0 at v = 0 (glTF: top). */
struct gd_texture {
	int w, h;
	float *rgb;
	bool clamp_u, clamp_v;		/* else it repeats */
};

/* A triangle, with what a hit needs. Corner k has the index vertex[k]. */
struct gd_triangle {
	uint32_t vertex[3];
	uint32_t material;
	uint32_t light;			/* index into scene.light, or GD_NO_INDEX */
	struct gd_v3 normal;		/* geometric, length 1; gd_scene_finish() fills it, with
					   (0, 0, 1) where there is no area */
};

enum gd_light_kind { GD_AREA, GD_POINT, GD_SPOT, GD_DIRECTIONAL, GD_ENVIRONMENT };

struct gd_light {
	enum gd_light_kind kind;
	uint32_t triangle;		/* GD_AREA */
	float area;			/* GD_AREA, square metres */
	struct gd_v3 position;		/* GD_POINT, GD_SPOT */
	struct gd_v3 direction;		/* GD_SPOT, GD_DIRECTIONAL: the light's way, length 1 */
	struct gd_v3 intensity;		/* GD_POINT, GD_SPOT: radiant intensity; GD_DIRECTIONAL:
					   irradiance of a surface it falls on at right angles */
	float cos_inner, cos_outer;	/* GD_SPOT */
	float chance;			/* probability that gd_light_sample() picks it */
};

/* Radiance from all around: latitude-longitude, row 0 is +y, column w/2 is -z; or constant. */
struct gd_environment {
	int w, h;			/* 0 x 0: constant, or none if it is black */
	float *rgb;			/* h x w x 3 */
	struct gd_v3 constant;
	float *row_cdf, *column_cdf;	/* h + 1; h x (w + 1): in proportion to luminance times
					   solid angle, in the main */
};

/* Looks along forward; pixel (px, py) of w x h, y down, is at
 * forward + right * (2 px / w - 1) * tan_x + up * (1 - 2 py / h) * tan_y. */
struct gd_view {
	struct gd_v3 origin, right, up, forward;	/* the last three: orthonormal */
	float tan_x, tan_y;		/* tangents of half the field of view */
	float lens;			/* radius of the aperture in metres, 0: a pinhole */
	float focus;			/* distance of the plane in focus along forward, metres */
};

struct gd_scene {
	struct gd_v3 *vertex, *normal;	/* world space; length 1, or 0: the triangle's normal */
	float *uv;			/* 2 a vertex, or NULL */
	struct gd_triangle *triangle;
	size_t nvertex, ntriangle;
	struct gd_material *material;
	size_t nmaterial;
	struct gd_texture *texture;
	size_t ntexture;
	struct gd_light *light;
	float *light_cdf;		/* nlight + 1 */
	size_t nlight;
	struct gd_environment environment;
	uint32_t environment_light;	/* index into light, or GD_NO_INDEX */
	struct gd_view view;
	struct gd_v3 low, high;		/* bounding box */
	void *rays;			/* Embree's scene, owned by ray.c */
	void *device;
};

struct gd_scene_options {
	int w, h;			/* of the image: tan_x is tan_y times w / h */
	const char *camera;		/* name; NULL: the first */
	const char *environment;	/* EXR, HDR or any other image file; NULL: none */
	struct gd_v3 sky;		/* constant radiance, 0 .. GD_SKY_MAX; not beside an
					   environment */
	float aperture;			/* lens radius in metres, 0: pinhole */
	float focus;			/* metres; 0: that of what the centre of the image shows */
};

/*
 * Reads a scene and builds what rays need. Notes (report) tell of what was left out: textures that
 * are missing (their factor alone is used), triangles with an index out of range, a NaN vertex or
 * without area, features that are not modelled. Fails with one clear line: no such file, no glTF,
 * no triangles, no camera, a camera name that does not exist (lists them), and no light at all
 * (neither emission nor punctual light nor environment).
 * On failure *scene is NULL.
 */
int gd_scene_load(struct gd_scene **scene, const char *path, const struct gd_scene_options *options,
		  const struct gd_report *report, struct gd_err *err);
void gd_scene_free(struct gd_scene *scene);	/* takes NULL */

/* For gd_scene_load() and tests that build a scene by hand: the light list (area lights from
 * emissive materials, environment) and its cdf, the bounding box, Embree's tree. vertex, normal,
 * triangle (light, normal: anything), material, texture, environment's pixels or constant, the
 * punctual lights in light[0 .. nlight) must be there. GD_ESHAPE: no triangles, or an index out of
 * range; GD_ENOMEM; GD_EARG: Embree fails. gd_scene_free() takes the scene in any case. */
int gd_scene_finish(struct gd_scene *scene, struct gd_err *err);

/* --- ray.c: rays --- */

struct gd_hit {
	struct gd_v3 p;			/* position */
	struct gd_v3 ng, ns;		/* geometric and shading normal, length 1; as the triangle
					   has them, not turned to the ray; ns on ng's side */
	float u, v;			/* texture coordinates */
	float t;			/* distance */
	uint32_t triangle;
};

/* Nearest hit from o along d (length 1). o may lie on a surface: triangles in whose plane a ray
 * starts are passed by. */
bool gd_ray_hit(const struct gd_scene *scene, struct gd_v3 o, struct gd_v3 d, struct gd_hit *hit);
/* Up to 4 at once; active: bit k is ray k. Returns the bits that hit. The others are read, too, but
 * may be anything. */
unsigned gd_ray_hit4(const struct gd_scene *scene, const struct gd_v3 o[4], const struct gd_v3 d[4],
		     unsigned active, struct gd_hit hit[4]);
/* Is nothing between o and o + t d? Both ends may lie on surfaces, which do not count; t may be
 * INFINITY. */
bool gd_ray_free(const struct gd_scene *scene, struct gd_v3 o, struct gd_v3 d, float t);
/* A triangle that is between, or GD_NO_INDEX. */
uint32_t gd_ray_blocker(const struct gd_scene *scene, struct gd_v3 o, struct gd_v3 d, float t);
unsigned gd_ray_free4(const struct gd_scene *scene, const struct gd_v3 o[4],
		      const struct gd_v3 d[4], const float t[4], unsigned active);

/* The lanes that a triangle blocks beyond doubt: gd_ray_free4() would say so, too. */
gd_i4 gd_ray_blocked4(const struct gd_scene *scene, uint32_t triangle, const struct gd_v34 *o,
		      const struct gd_v34 *d, gd_f4 t);

/* --- texture.c --- */

/* Bilinear; row 0 is at v = 0, and beyond 0 .. 1 the image repeats or is clamped. */
struct gd_v3 gd_texture_at(const struct gd_texture *t, float u, float v);

/* --- light.c: lights --- */

/* A point on a light, as seen from p. */
struct gd_light_sample {
	struct gd_v3 d;			/* direction from p to it, length 1 */
	float t;			/* distance; INFINITY: environment, directional */
	struct gd_v3 radiance;		/* arriving at p if nothing is between; divided by nothing.
					   GD_POINT, GD_SPOT: intensity / t^2; GD_DIRECTIONAL:
					   irradiance */
	float pdf;			/* by solid angle at p, choice of the light included;
					   where delta: the probability of the choice */
	bool delta;			/* no direction sampled by a surface can hit it */
	uint32_t light;
	struct gd_v3 point, normal;	/* GD_AREA: for gd_light_again(); point also for the other
					   finite ones */
};

/* choice, u, v: uniform in [0, 1). false: nothing comes from there (p lies in the plane of the
 * emitter, or outside a spot's cone; a chance of 0; black). */
bool gd_light_sample(const struct gd_scene *scene, struct gd_v3 p, float choice, float u, float v,
		     struct gd_light_sample *s);
/*
 * The same point on the same light as seen from another p: fills d, t, radiance, pdf. Also when s
 * came with false because its p lay in the emitter's plane: s->light, point and normal are filled
 * then.
 * false: it cannot be seen from p; pdf is 0 then.
 */
bool gd_light_again(const struct gd_scene *scene, struct gd_v3 p, const struct gd_light_sample *s,
		    struct gd_light_sample *again);

/* gd_light_again() from the lanes of from that active holds; the lanes where it returns true. What
 * the others have is undefined. */
struct gd_light_sample4 {
	struct gd_v34 d, radiance;
	gd_f4 t, pdf;
};
gd_i4 gd_light_again4(const struct gd_scene *scene, const struct gd_v34 *from,
		      const struct gd_light_sample *s, gd_i4 active,
		      struct gd_light_sample4 *again);

/* Radiance that leaves an emissive triangle at hit, 0 if it does not emit: the same on both sides
 * and in all directions, as glTF's emission does. */
struct gd_v3 gd_light_emitted(const struct gd_scene *scene, const struct gd_hit *hit);
/* Density, by solid angle at the point where the ray d (length 1) to hit started, with which
 * gd_light_sample() would have made it; 0 for triangles that are not lights. */
float gd_light_pdf(const struct gd_scene *scene, const struct gd_hit *hit, struct gd_v3 d);

/* Radiance from direction d, and the density with which gd_light_sample() takes it (choice of the
 * light included). */
struct gd_v3 gd_environment_at(const struct gd_scene *scene, struct gd_v3 d);
float gd_environment_pdf(const struct gd_scene *scene, struct gd_v3 d);

#endif
