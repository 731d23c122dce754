/* SPDX-License-Identifier: BSD-3-Clause */
/* Vectors of three floats: positions, directions and linear RGB alike. */
#ifndef GD_RENDER_VEC_H
#define GD_RENDER_VEC_H

#include <math.h>
#include <stdbool.h>

struct gd_v3 {
	float x, y, z;
};

static inline struct gd_v3 gd_v3(float x, float y, float z)
{
	return (struct gd_v3){ x, y, z };
}

static inline struct gd_v3 gd_add(struct gd_v3 a, struct gd_v3 b)
{
	return gd_v3(a.x + b.x, a.y + b.y, a.z + b.z);
}

static inline struct gd_v3 gd_sub(struct gd_v3 a, struct gd_v3 b)
{
	return gd_v3(a.x - b.x, a.y - b.y, a.z - b.z);
}

static inline struct gd_v3 gd_mul(struct gd_v3 a, struct gd_v3 b)
{
	return gd_v3(a.x * b.x, a.y * b.y, a.z * b.z);
}

static inline struct gd_v3 gd_scale(struct gd_v3 a, float s)
{
	return gd_v3(a.x * s, a.y * s, a.z * s);
}

/* a + s b */
static inline struct gd_v3 gd_mad(struct gd_v3 a, float s, struct gd_v3 b)
{
	return gd_v3(a.x + s * b.x, a.y + s * b.y, a.z + s * b.z);
}

static inline float gd_dot(struct gd_v3 a, struct gd_v3 b)
{
	return a.x * b.x + a.y * b.y + a.z * b.z;
}

static inline struct gd_v3 gd_cross(struct gd_v3 a, struct gd_v3 b)
{
	return gd_v3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}

static inline float gd_length(struct gd_v3 a)
{
	return sqrtf(gd_dot(a, a));
}

/* Of length 1; a must not be 0. */
static inline struct gd_v3 gd_unit(struct gd_v3 a)
{
	return gd_scale(a, 1 / gd_length(a));
}

/* One instruction each, which fminf() and fmaxf() are not. x NaN: limit. */
static inline float gd_at_least(float x, float limit)
{
	return x > limit ? x : limit;
}

static inline float gd_at_most(float x, float limit)
{
	return x < limit ? x : limit;
}

static inline float gd_largest(struct gd_v3 a)
{
	return gd_at_least(a.x, gd_at_least(a.y, a.z));
}

static inline bool gd_finite(struct gd_v3 a)
{
	return isfinite(a.x) && isfinite(a.y) && isfinite(a.z);
}

static inline bool gd_black(struct gd_v3 a)
{
	return a.x == 0 && a.y == 0 && a.z == 0;
}

/* Rec. 709 */
static inline float gd_luma(struct gd_v3 a)
{
	return 0.2126f * a.x + 0.7152f * a.y + 0.0722f * a.z;
}

/* An orthonormal right-handed frame; x and y depend on n alone. */
struct gd_frame {
	struct gd_v3 x, y, n;
};

/* n of length 1. Continuous but for n.z = 0 (Duff et al. 2017). */
static inline struct gd_frame gd_frame(struct gd_v3 n)
{
	const float s = copysignf(1, n.z), a = -1 / (s + n.z), b = n.x * n.y * a;

	return (struct gd_frame){ gd_v3(1 + s * n.x * n.x * a, s * b, -s * n.x),
				  gd_v3(b, s + n.y * n.y * a, -n.y), n };
}

static inline struct gd_v3 gd_to_local(const struct gd_frame *f, struct gd_v3 v)
{
	return gd_v3(gd_dot(v, f->x), gd_dot(v, f->y), gd_dot(v, f->n));
}

static inline struct gd_v3 gd_to_world(const struct gd_frame *f, struct gd_v3 v)
{
	return gd_mad(gd_mad(gd_scale(f->x, v.x), v.y, f->y), v.z, f->n);
}

#endif
