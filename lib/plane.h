/* SPDX-License-Identifier: BSD-3-Clause */
/* A plane: a borrowed view of h rows of w floats. It never owns memory. */
#ifndef GD_PLANE_H
#define GD_PLANE_H

#include <stdbool.h>
#include <stddef.h>

#include "gd.h"

struct gd_plane {
	float *v;
	int w, h;
	size_t stride;	/* floats from one row to the next, >= w */
};

/* Floats between rows for width w: a multiple of 16 (64 bytes) that is not a multiple of 1024. */
size_t gd_stride(int w);

static inline float *gd_row(struct gd_plane p, int y)
{
	return p.v + (size_t)y * p.stride;
}

static inline struct gd_plane gd_plane_of(float *v, int w, int h)
{
	return (struct gd_plane){ v, w, h, gd_stride(w) };
}

/*
 * Are these n planes of a method's input or output there, and w x h? may_lack: any may be absent
 * (v = NULL). GD_EARG "METHOD: WHAT plane 2 is missing", GD_ESHAPE "... is 3x4, expected 5x6".
 */
int gd_planes_check(const char *method, const char *what, const struct gd_plane *p, int n, int w,
		    int h, bool may_lack, struct gd_err *err);

#endif
