/* SPDX-License-Identifier: BSD-3-Clause */
#include "render/impl.h"

#include "exr.h"

bool gd_find_rgb(const struct gd_image *im, int channel[3])
{
	static const char *const name[] = { "R", "G", "B" };

	for (int k = 0; k < 3; k++)
		channel[k] = gd_image_find(im, name[k]);
	if (channel[0] >= 0 && channel[1] >= 0 && channel[2] >= 0)
		return true;
	channel[0] = gd_image_find(im, "Y");
	channel[1] = channel[2] = channel[0];
	return channel[0] >= 0;
}

/* Returns how many numbers had to be mended. */
static size_t take(struct gd_environment *e, const struct gd_image *im, const int channel[3])
{
	const size_t stride = gd_stride(im->w);
	size_t mended = 0;

	e->w = im->w;
	e->h = im->h;
	for (int k = 0; k < 3; k++)
		for (int y = 0; y < im->h; y++) {
			const float *v = im->chan[channel[k]].v + (size_t)y * stride;

			for (int x = 0; x < im->w; x++) {
				const bool good = v[x] >= 0 && v[x] <= 1e30f;

				e->rgb[3 * ((size_t)y * (size_t)im->w + (size_t)x) + (size_t)k] =
					good ? v[x] : 0;
				mended += !good;
			}
		}
	return mended;
}

int gd_environment_read(struct gd_environment *e, const char *path, const struct gd_report *report,
			struct gd_err *err)
{
	struct gd_exr *file = NULL;
	struct gd_image im = { 0 };
	int channel[3], rc = gd_exr_open(&file, &im, path, NULL, err);
	size_t mended;

	if (rc == GD_OK && !gd_find_rgb(&im, channel))
		rc = gd_fail(err, GD_ESHAPE, "%s: no channels R G B", path);
	for (int i = 0; rc == GD_OK && i < im.nchan; i++)
		im.chan[i].want = i == channel[0] || i == channel[1] || i == channel[2] ? GD_READ :
											  GD_DROP;
	if (rc == GD_OK)
		rc = gd_exr_load(file, &im, err);
	if (rc == GD_OK) {
		e->rgb = gd_alloc((size_t)im.w * (size_t)im.h, 3 * sizeof(float));
		if (!e->rgb)
			rc = gd_fail(err, GD_ENOMEM, "%s: out of memory", path);
	}
	if (rc == GD_OK && gd_find_rgb(&im, channel)) {
		mended = take(e, &im, channel);
		if (mended)
			gd_warn(report, "%s: %zu numbers that are negative, not finite or above "
					"1e30 count as 0", path, mended);
	}
	gd_exr_close(file);
	gd_image_free(&im);
	return rc;
}
