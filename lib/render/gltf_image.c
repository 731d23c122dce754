/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Images become textures. The colours of an image of whole numbers are sRGB-encoded in glTF,
 * whatever the file says, and those of other formats linear; numbers (roughness, metallic) are
 * taken as they are. What the plug-in linearised is brought back where that was wrong.
 */
#include "render/gltf.h"

#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "plugin.h"
#include "render/impl.h"

static float encode(float v)
{
	return v <= 0.0031308f ? 12.92f * v : 1.055f * powf(v, 1 / 2.4f) - 0.055f;
}

static float linear(float v)
{
	return v <= 0.04045f ? v / 12.92f : powf((v + 0.055f) / 1.055f, 2.4f);
}

/* 8 and 16 bits: both are multiples of 1 / 65535, which undoes the rounding of encode(). */
static float encode_exact(float v)
{
	return rintf(encode(v) * 65535) / 65535;
}

/* The channels that are red, green and blue; without such names the first is all three. */
static bool find_channels(const struct gd_image *im, int channel[3])
{
	if (!gd_find_rgb(im, channel))
		channel[0] = channel[1] = channel[2] = 0;
	return im->nchan > 0;
}

static bool ends(const char *path, const char *suffix)
{
	const size_t n = strlen(path), m = strlen(suffix);

	return n >= m && !strcasecmp(path + n - m, suffix);
}

/* What a number of the image is in the texture. */
static float convert(float v, bool linearised, bool whole, bool data)
{
	if (data && linearised)
		v = encode_exact(v);
	else if (!data && whole && !linearised)
		v = linear(v);
	return v > 0 && v < 1e30f ? v : 0;	/* also NaN */
}

static int take(struct gd_texture *t, const struct gd_image *im, const int channel[3], bool whole,
		bool data, const char *path, struct gd_err *err)
{
	const size_t stride = gd_stride(im->w);
	char space[64] = "";
	bool linearised;

	gd_attr_string(im, "oiio:ColorSpace", space, sizeof(space));
	linearised = whole && !strcmp(space, "sRGB");
	t->rgb = gd_alloc((size_t)im->w * (size_t)im->h, 3 * sizeof(float));
	if (!t->rgb)
		return gd_fail(err, GD_ENOMEM, "%s: out of memory", path);
	t->w = im->w;
	t->h = im->h;
	for (int k = 0; k < 3; k++) {
		const float *v = im->chan[channel[k]].v;

		for (int y = 0; y < im->h; y++)
			for (int x = 0; x < im->w; x++)
				t->rgb[3 * ((size_t)y * (size_t)im->w + (size_t)x) + (size_t)k] =
					convert(v[(size_t)y * stride + (size_t)x], linearised,
						whole, data);
	}
	return GD_OK;
}

int gd_texture_read(struct gd_texture *t, const char *path, const struct gd_bytes *bytes, bool data,
		    struct gd_err *err)
{
	struct gd_plugin_file *file;
	struct gd_image im = { 0 };
	const bool whole = !ends(path, ".exr") && !ends(path, ".hdr");
	int channel[3], rc;

	rc = gd_plugin_open(&file, &im, path, bytes ? bytes->data : NULL, bytes ? bytes->size : 0,
			    0, err);
	if (rc != GD_OK)
		return rc;
	if (!find_channels(&im, channel))
		rc = gd_fail(err, GD_EFORMAT, "%s: no channels", path);
	for (int i = 0; i < im.nchan; i++)
		im.chan[i].want = i == channel[0] || i == channel[1] || i == channel[2] ? GD_READ :
											  GD_DROP;
	if (rc == GD_OK)
		rc = gd_plugin_load(file, &im, err);
	if (rc == GD_OK && find_channels(&im, channel))	/* what is dropped has moved them */
		rc = take(t, &im, channel, whole, data, path, err);
	gd_plugin_close(file);
	gd_image_free(&im);
	return rc;
}
