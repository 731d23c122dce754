/* SPDX-License-Identifier: BSD-3-Clause */
#include "plane.h"

/* Rows 4096 bytes apart would all fall into the same few sets of a first-level cache. */
size_t gd_stride(int w)
{
	size_t stride = ((size_t)(w > 0 ? w : 0) + 15) / 16 * 16;

	return stride % 1024 ? stride : stride + 16;
}

int gd_planes_check(const char *method, const char *what, const struct gd_plane *p, int n, int w,
		    int h, bool may_lack, struct gd_err *err)
{
	for (int i = 0; i < n; i++) {
		if (!p[i].v && may_lack)
			continue;
		if (!p[i].v)
			return gd_fail(err, GD_EARG, "%s: %s plane %d is missing", method, what, i);
		if (p[i].w != w || p[i].h != h)
			return gd_fail(err, GD_ESHAPE, "%s: %s plane %d is %dx%d, expected %dx%d",
				       method, what, i, p[i].w, p[i].h, w, h);
	}
	return GD_OK;
}
