/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Four numbers, or four vectors, side by side: one for each offset path. A mask is -1 in the lanes
 * that it holds and 0 in the others. Lanes that hold no path are computed all the same: whatever
 * comes of that, infinite or no number, gd_pick4() must leave behind.
 */
#ifndef GD_RENDER_FOUR_H
#define GD_RENDER_FOUR_H

#include <stdint.h>

#include "render/vec.h"

typedef float gd_f4 __attribute__((vector_size(16)));
typedef int32_t gd_i4 __attribute__((vector_size(16)));

struct gd_v34 {
	gd_f4 x, y, z;
};

static inline gd_f4 gd_all4(float a)
{
	return (gd_f4){ a, a, a, a };
}

/* The lanes of a mask as bits, and bits as a mask. */
static inline unsigned gd_bits4(gd_i4 m)
{
#ifdef __SSE2__
	return (unsigned)__builtin_ia32_movmskps((gd_f4)m);
#else
	return (unsigned)((m[0] & 1) | (m[1] & 2) | (m[2] & 4) | (m[3] & 8));
#endif
}

static inline gd_i4 gd_mask4(unsigned bits)
{
	const int32_t b = (int32_t)bits;

	return ((gd_i4){ b, b, b, b } & (gd_i4){ 1, 2, 4, 8 }) != 0;
}

static inline bool gd_any4(gd_i4 m)
{
	return gd_bits4(m) != 0;
}

/* a where m holds a lane, else b. */
static inline gd_f4 gd_pick4(gd_i4 m, gd_f4 a, gd_f4 b)
{
	return (gd_f4)((m & (gd_i4)a) | (~m & (gd_i4)b));
}

/* a where m holds a lane, else 0. */
static inline gd_f4 gd_only4(gd_i4 m, gd_f4 a)
{
	return (gd_f4)(m & (gd_i4)a);
}

/* NaN: limit. */
static inline gd_f4 gd_at_least4(gd_f4 a, gd_f4 limit)
{
	return gd_pick4(a > limit, a, limit);
}

static inline gd_f4 gd_at_most4(gd_f4 a, gd_f4 limit)
{
	return gd_pick4(a < limit, a, limit);
}

static inline gd_f4 gd_abs4(gd_f4 a)
{
	return (gd_f4)((gd_i4)a & INT32_MAX);
}

static inline gd_f4 gd_sqrt4(gd_f4 a)
{
	return (gd_f4){ sqrtf(a[0]), sqrtf(a[1]), sqrtf(a[2]), sqrtf(a[3]) };
}

static inline struct gd_v34 gd_v34(gd_f4 x, gd_f4 y, gd_f4 z)
{
	return (struct gd_v34){ x, y, z };
}

static inline struct gd_v34 gd_v34_all(struct gd_v3 a)
{
	return gd_v34(gd_all4(a.x), gd_all4(a.y), gd_all4(a.z));
}

static inline struct gd_v3 gd_v34_lane(const struct gd_v34 *a, int k)
{
	return gd_v3(a->x[k], a->y[k], a->z[k]);
}

static inline void gd_v34_put(struct gd_v34 *to, int k, struct gd_v3 a)
{
	to->x[k] = a.x;
	to->y[k] = a.y;
	to->z[k] = a.z;
}

static inline struct gd_v34 gd_add4(struct gd_v34 a, struct gd_v34 b)
{
	return gd_v34(a.x + b.x, a.y + b.y, a.z + b.z);
}

static inline struct gd_v34 gd_sub4(struct gd_v34 a, struct gd_v34 b)
{
	return gd_v34(a.x - b.x, a.y - b.y, a.z - b.z);
}

static inline struct gd_v34 gd_mul4(struct gd_v34 a, struct gd_v34 b)
{
	return gd_v34(a.x * b.x, a.y * b.y, a.z * b.z);
}

static inline struct gd_v34 gd_scale4(struct gd_v34 a, gd_f4 s)
{
	return gd_v34(a.x * s, a.y * s, a.z * s);
}

static inline gd_f4 gd_dot4(struct gd_v34 a, struct gd_v34 b)
{
	return a.x * b.x + a.y * b.y + a.z * b.z;
}

static inline struct gd_v34 gd_v34_pick(gd_i4 m, struct gd_v34 a, struct gd_v34 b)
{
	return gd_v34(gd_pick4(m, a.x, b.x), gd_pick4(m, a.y, b.y), gd_pick4(m, a.z, b.z));
}

static inline struct gd_v34 gd_v34_only(gd_i4 m, struct gd_v34 a)
{
	return gd_v34(gd_only4(m, a.x), gd_only4(m, a.y), gd_only4(m, a.z));
}

static inline gd_i4 gd_black4(struct gd_v34 a)
{
	return (a.x == 0) & (a.y == 0) & (a.z == 0);
}

static inline gd_i4 gd_finite4(struct gd_v34 a)
{
	return (a.x - a.x == 0) & (a.y - a.y == 0) & (a.z - a.z == 0);
}

static inline gd_f4 gd_largest4(struct gd_v34 a)
{
	return gd_at_least4(a.x, gd_at_least4(a.y, a.z));
}

static inline gd_f4 gd_luma4(struct gd_v34 a)
{
	return 0.2126f * a.x + 0.7152f * a.y + 0.0722f * a.z;
}

#endif
