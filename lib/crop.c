/* SPDX-License-Identifier: BSD-3-Clause */
#include "crop.h"

#include <stdio.h>

int gd_crop_parse(struct gd_box *box, const char *text, int w, int h, struct gd_err *err)
{
	long long x0, x1, y0, y1;
	int end = -1;

	*box = (struct gd_box){ 0, 0, w - 1, h - 1 };
	if (!text)
		return GD_OK;
	if (sscanf(text, "%9lld,%9lld,%9lld,%9lld%n", &x0, &x1, &y0, &y1, &end) != 4 || end < 0 ||
	    text[end])
		return gd_fail(err, GD_EARG, "crop \"%s\" is not X0,X1,Y0,Y1", text);
	if (x1 < 0)
		x1 = x0 - x1;
	if (y1 < 0)
		y1 = y0 - y1;
	if (x1 <= x0 || y1 <= y0)
		return gd_fail(err, GD_EARG, "crop \"%s\" is empty", text);
	if (x0 < 0 || y0 < 0 || x1 > w || y1 > h)
		return gd_fail(err, GD_ESHAPE, "crop \"%s\" is not inside the %dx%d pixels", text,
			       w, h);
	*box = (struct gd_box){ (int)x0, (int)y0, (int)x1 - 1, (int)y1 - 1 };
	return GD_OK;
}

struct gd_plane gd_crop_plane(struct gd_plane p, struct gd_box box)
{
	p.v = gd_row(p, box.y0) + box.x0;
	p.w = box.x1 - box.x0 + 1;
	p.h = box.y1 - box.y0 + 1;
	return p;
}
