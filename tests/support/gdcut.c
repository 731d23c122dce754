/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * A rectangle of a gd buffer, of any size: beyond its borders the buffer repeats. Types and
 * attributes stay as they are, but gd:renderSeconds, which becomes these pixels' share. Made
 * testdata/, and makes large inputs of real noise for measurements.
 *	gdcut IN.exr OUT.exr X0 Y0 WIDTH HEIGHT [CHANNEL-PREFIX-TO-DROP ...]
 */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "exr.h"

/* Does the last column ('x') or row ('y') of this
 * channel carry no gradient? "bin3.dx.variance.R" */
static bool is_gradient(const char *name, char axis)
{
	const char part[] = { 'd', axis, '.', 0 };
	const char *s = strstr(name, part);

	return s && (s == name || s[-1] == '.');
}

static int cut(struct gd_channel *c, int w, int h, const int rect[4])
{
	const size_t size = c->type == GD_HALF ? 2 : 4, row = (size_t)rect[2] * size;
	unsigned char *raw = malloc(row * (size_t)rect[3]);

	if (!raw)
		return GD_ENOMEM;
	for (int y = 0; y < rect[3]; y++)
		for (int x = 0; x < rect[2]; x++)
			memcpy(raw + (size_t)y * row + (size_t)x * size,
			       c->raw + ((size_t)((rect[1] + y) % h) * (size_t)w +
					 (size_t)((rect[0] + x) % w)) *
						size,
			       size);
	for (int y = 0; is_gradient(c->name, 'x') && y < rect[3]; y++)
		memset(raw + (size_t)(y + 1) * row - size, 0, size);
	if (is_gradient(c->name, 'y'))
		memset(raw + (size_t)(rect[3] - 1) * row, 0, row);
	free(c->raw);
	c->raw = raw;
	return GD_OK;
}

int main(int argc, char **argv)
{
	struct gd_write_conf conf = { GD_ZIP };
	struct gd_image im = { 0 };
	struct gd_exr *file = NULL;
	struct gd_err err = { 0 };
	double seconds;
	int rect[4], rc;

	if (argc < 7)
		return fprintf(stderr,
			       "usage: gdcut IN.exr OUT.exr X0 Y0 WIDTH HEIGHT [PREFIX ...]\n"),
		       2;
	for (int i = 0; i < 4; i++)
		rect[i] = atoi(argv[3 + i]);
	if (rect[0] < 0 || rect[1] < 0 || rect[2] < 1 || rect[3] < 1)
		return fprintf(stderr, "gdcut: no rectangle\n"), 2;
	if (!strcmp(argv[2], "-") || !strcmp(argv[2], "/dev/null"))
		conf.compression = GD_NONE;
	rc = gd_exr_open(&file, &im, argv[1], &(struct gd_read_conf){ 0 }, &err);
	for (int c = 0; c < im.nchan; c++)
		for (int i = 7; i < argc; i++)
			if (!strncmp(im.chan[c].name, argv[i], strlen(argv[i])))
				im.chan[c].want = GD_DROP;
	if (rc == GD_OK)
		rc = gd_exr_load(file, &im, &err);
	gd_exr_close(file);
	for (int c = 0; c < im.nchan && rc == GD_OK; c++)
		rc = cut(&im.chan[c], im.w, im.h, rect);
	if (rc == GD_OK && gd_attr_number(&im, "gd:renderSeconds", &seconds))
		rc = gd_attr_set_number(&im, "gd:renderSeconds",
					seconds * rect[2] * rect[3] / ((double)im.w * im.h), &err);
	if (rc == GD_OK) {
		im.w = rect[2];
		im.h = rect[3];
		im.data = im.display = (struct gd_box){ 0, 0, rect[2] - 1, rect[3] - 1 };
		rc = gd_exr_write(&im, argv[2], &conf, &err);
	}
	gd_image_free(&im);
	if (rc != GD_OK)
		fprintf(stderr, "gdcut: %s\n", err.text);
	return rc == GD_OK ? 0 : 2;
}
