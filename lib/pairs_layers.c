/* SPDX-License-Identifier: BSD-3-Clause */
/* Pairs out of an image's channels. */
#include "pairs.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "buffers.h"

static const char *channel(char name[16], int k, char axis)
{
	snprintf(name, 16, "pair%d.%c", k, axis);
	return name;
}

int gd_pairs_layers(const struct gd_image *im)
{
	char name[16];
	int n = 0;

	while (n <= GD_PAIRS && gd_image_find(im, channel(name, n, 'x')) >= 0)
		n++;
	return n;
}

bool gd_pairs_want(struct gd_image *im)
{
	const int n = gd_pairs_layers(im);
	int found = 0;
	char name[16];

	for (int k = 0; k < n; k++)
		for (const char *axis = "xy"; *axis; axis++) {
			const int i = gd_image_find(im, channel(name, k, *axis));

			if (i >= 0)
				im->chan[i].want = GD_READ;
		}
	if (n > 0)
		return true;
	for (int k = 0; k < GD_PAIR_FEATURES; k++) {
		found += gd_layer_want(im, gd_pair_features[k], GD_READ);
		gd_layer_want_variance(im, gd_pair_features[k], GD_READ);
	}
	return found > 0;
}

/* One offset, checked by itself: whole, within reach, of an end that comes later in scan order. */
static int offset(signed char d[2], const struct gd_plane p[2], int k, int x, int y,
		  struct gd_err *err)
{
	for (int i = 0; i < 2; i++) {
		const float v = gd_row(p[i], y)[x];

		if (!(fabsf(v) <= GD_PAIR_REACH) || v != rintf(v))
			return gd_fail(err, GD_EFORMAT,
				       "pair%d.%c is %g at pixel %d,%d, expected a whole number "
				       "from %d to %d",
				       k, "xy"[i], (double)v, x, y, -GD_PAIR_REACH, GD_PAIR_REACH);
		d[i] = (signed char)v;
	}
	if (d[1] < 0 || (d[1] == 0 && d[0] < 0))
		return gd_fail(err, GD_EFORMAT,
			       "pair%d is %d,%d at pixel %d,%d: expected at the first of the two "
			       "pixels in scan order, as %d,%d",
			       k, d[0], d[1], x, y, -d[0], -d[1]);
	if (x + d[0] < 0 || x + d[0] >= p[0].w || y + d[1] >= p[0].h)
		return gd_fail(err, GD_EFORMAT,
			       "pair%d is %d,%d at pixel %d,%d: there is no pixel in an image of "
			       "%dx%d",
			       k, d[0], d[1], x, y, p[0].w, p[0].h);
	return GD_OK;
}

static int add(const struct gd_pairs *pairs, unsigned char *degree, const signed char d[2], int k,
	       int x, int y, struct gd_err *err)
{
	const size_t i = (size_t)y * (size_t)pairs->w + (size_t)x;
	const size_t j = i + (size_t)(d[1] * (ptrdiff_t)pairs->w + d[0]);

	for (int l = 0; l < k; l++)
		if (pairs->dx[l][i] == d[0] && pairs->dy[l][i] == d[1])
			return gd_fail(err, GD_EFORMAT,
				       "pair%d is %d,%d at pixel %d,%d, as is pair%d", k, d[0],
				       d[1], x, y, l);
	if (degree[i] >= GD_PAIRS || degree[j] >= GD_PAIRS)
		return gd_fail(err, GD_EFORMAT, "pixel %d,%d is in more than %d pairs",
			       degree[i] >= GD_PAIRS ? x : x + d[0],
			       degree[i] >= GD_PAIRS ? y : y + d[1], GD_PAIRS);
	degree[i]++;
	degree[j]++;
	pairs->dx[k][i] = d[0];
	pairs->dy[k][i] = d[1];
	return GD_OK;
}

static int read_layer(const struct gd_pairs *pairs, const struct gd_image *im, int k,
		      unsigned char *degree, struct gd_err *err)
{
	struct gd_plane p[2];
	char name[16];

	for (int i = 0; i < 2; i++)
		if (!gd_image_plane(im, channel(name, k, "xy"[i]), &p[i]))
			return gd_fail(err, GD_ESHAPE, "no channel %s", name);
	for (int y = 0; y < im->h; y++)
		for (int x = 0; x < im->w; x++) {
			signed char d[2];
			int rc = offset(d, p, k, x, y, err);

			if (rc == GD_OK && (d[0] || d[1]))
				rc = add(pairs, degree, d, k, x, y, err);
			if (rc != GD_OK)
				return rc;
		}
	return GD_OK;
}

static int read_pairs(struct gd_pairs *pairs, const struct gd_image *im, int n, struct gd_err *err)
{
	unsigned char *degree;
	int rc;

	if (n > GD_PAIRS)
		return gd_fail(err, GD_EFORMAT, "channel pair%d.x: expected %d pairs at most",
			       GD_PAIRS, GD_PAIRS);
	rc = gd_pairs_new(pairs, im->w, im->h, err);
	if (rc != GD_OK)
		return rc;
	degree = gd_calloc((size_t)im->w * (size_t)im->h, 1);
	if (!degree)
		rc = gd_fail(err, GD_ENOMEM, "pairs: out of memory for %dx%d", im->w, im->h);
	for (int k = 0; k < n && rc == GD_OK; k++)
		rc = read_layer(pairs, im, k, degree, err);
	free(degree);
	if (rc != GD_OK)
		gd_pairs_free(pairs);
	return rc;
}

int gd_pairs_from_image(struct gd_pairs *pairs, const struct gd_image *im, struct gd_err *err)
{
	const int n = gd_pairs_layers(im);
	struct gd_look *looks;
	int rc;

	*pairs = (struct gd_pairs){ 0 };
	if (n > 0)
		return read_pairs(pairs, im, n, err);
	rc = gd_pairs_looks(&looks, im, err);
	if (rc == GD_OK)
		rc = gd_pairs_choose(pairs, looks, im->w, im->h, err);
	free(looks);
	return rc;
}
