/* SPDX-License-Identifier: BSD-3-Clause */
#include "blur.h"

#include <math.h>
#include <omp.h>
#include <stdlib.h>
#include <string.h>

#include "edges.h"

struct gd_blur gd_blur_gauss(double sigma)
{
	struct gd_blur blur = { 1, { 1 } };

	if (sigma > 0)
		blur.taps = gd_gauss_taps(blur.tap, sigma);
	return blur;
}

struct gd_blur gd_blur_box(int side)
{
	struct gd_blur blur = { side, { 0 } };

	for (int i = 0; i < side; i++)
		blur.tap[i] = 1.0f / (float)side;
	return blur;
}

size_t gd_blur_work(int w)
{
	return 2 * (gd_stride(w + GD_PREP_TAPS));
}

void gd_blur_down(struct gd_plane to, struct gd_plane in, const struct gd_blur *blur)
{
	const struct gd_prep_kernels *k = GD_PICK(gd_prep);

#pragma omp parallel for schedule(static)
	for (int y = 0; y < in.h; y++) {
		const float *row[GD_PREP_TAPS];

		for (int i = 0; i < blur->taps; i++) {
			int at = y + i - blur->taps / 2;

			row[i] = at >= 0 && at < in.h ? gd_row(in, at) : NULL;
		}
		k->blur_down(gd_row(to, y), row, blur->tap, blur->taps, INFINITY, in.w);
	}
}

const float *gd_blur_row(struct gd_plane down, int y, const struct gd_blur *blur, float *work)
{
	float *out = work + gd_blur_work(down.w) / 2;

	GD_PICK(gd_prep)->blur_along(out, gd_row(down, y), blur->tap, blur->taps, work, down.w);
	return out;
}

int gd_blur_plane(struct gd_plane p, struct gd_plane spare, const struct gd_blur *blur,
		  struct gd_err *err)
{
	const size_t size = gd_blur_work(p.w);
	float *work = gd_alloc((size_t)omp_get_max_threads() * size, sizeof(*work));

	if (!work)
		return gd_fail(err, GD_ENOMEM, "blur: out of memory");
	gd_blur_down(spare, p, blur);
#pragma omp parallel for schedule(static)
	for (int y = 0; y < p.h; y++)
		memcpy(gd_row(p, y),
		       gd_blur_row(spare, y, blur, work + (size_t)omp_get_thread_num() * size),
		       (size_t)p.w * sizeof(float));
	free(work);
	return GD_OK;
}
