/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Judges what the tools have written.
 *	gdcheck -c LIST A.exr
 *		no channel that LIST (a regular expression) matches has a NaN or an Inf, and there
 *		is one at least
 *	gdcheck A.exr B.exr [TOL [SCALE [TURN]]]
 *		and B's colour is A's times SCALE (1), mirrored (x, y) or transposed (t), to TOL (0)
 *		of the larger of the pixel and A's mean
 * Exit 0: so it is; 1: it is not, and where; 2: a file cannot be read.
 */
#include <math.h>
#include <regex.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "buffers.h"
#include "exr.h"

static int load(struct gd_image *im, const char *path, struct gd_err *err)
{
	struct gd_exr *file = NULL;
	int rc = gd_exr_open(&file, im, path, &(struct gd_read_conf){ 0 }, err);

	for (int i = 0; i < im->nchan; i++)
		im->chan[i].want = GD_READ;
	if (rc == GD_OK)
		rc = gd_exr_load(file, im, err);
	gd_exr_close(file);
	return rc;
}

static bool finite_all(const struct gd_image *im, const char *path, const char *list)
{
	int bad = 0, seen = 0;
	regex_t match;

	if (regcomp(&match, list, REG_EXTENDED | REG_NOSUB))
		return printf("no regular expression: %s\n", list), false;

	for (int i = 0; i < im->nchan; i++) {
		struct gd_plane p = gd_plane_of(im->chan[i].v, im->w, im->h);
		int here = 0;

		if (regexec(&match, im->chan[i].name, 0, NULL, 0))
			continue;
		seen++;

		for (int y = 0; y < im->h; y++)
			for (int x = 0; x < im->w; x++)
				if (!isfinite(gd_row(p, y)[x]) && !here++)
					printf("%s: %s is %g at %d,%d\n", path, im->chan[i].name,
					       (double)gd_row(p, y)[x], x, y);
		bad += here;
	}
	regfree(&match);
	if (!seen)
		printf("%s: no channel %s\n", path, list);
	return seen && !bad;
}

static double mean(struct gd_plane p)
{
	double sum = 0;

	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++)
			sum += fabs((double)gd_row(p, y)[x]);
	return sum / p.w / p.h;
}

static bool alike(const struct gd_image *a, const struct gd_image *b, double tol, double scale,
		  char turn)
{
	struct gd_plane p[GD_LAYER_PLANES], q[GD_LAYER_PLANES];
	double worst = 0;
	int wx = 0, wy = 0, wc = 0;

	if (gd_layer_planes(a, "", p) != 3 || gd_layer_planes(b, "", q) != 3 ||
	    (turn == 't' ? a->w != b->h || a->h != b->w : a->w != b->w || a->h != b->h))
		return printf("sizes or channels differ\n"), false;
	for (int c = 0; c < 3; c++) {
		const double floor = mean(p[c]);

		for (int y = 0; y < a->h; y++)
			for (int x = 0; x < a->w; x++) {
				const double v = (double)gd_row(p[c], y)[x] * scale;
				const double u =
					turn == 't'
						? gd_row(q[c], x)[y]
						: gd_row(q[c],
							 turn == 'y' ? a->h - 1 - y
								     : y)[turn == 'x' ? a->w - 1 - x
										      : x];
				const double size = fmax(fabs(v), floor * fabs(scale));
				const double d = u == v ? 0 : fabs(u - v) / size;

				if (d > worst)
					worst = d, wx = x, wy = y, wc = c;
			}
	}
	if (worst > tol)
		printf("channel %d differs by %g at %d,%d: %g, expected %g\n", wc, worst, wx, wy,
		       (double)gd_row(q[wc], turn == 't' ? wx : turn == 'y' ? a->h - 1 - wy : wy)
			       [turn == 't' ? wy : turn == 'x' ? a->w - 1 - wx : wx],
		       (double)gd_row(p[wc], wy)[wx] * scale);
	return worst <= tol;
}

int main(int argc, char **argv)
{
	const bool listed = argc == 4 && !strcmp(argv[1], "-c");
	const char *list = listed ? argv[2] : "^(R|G|B)$", *path = listed ? argv[3] : argv[1];
	const bool two = !listed && argc > 2;
	struct gd_image a = { 0 }, b = { 0 };
	struct gd_err err = { 0 };
	int rc;
	bool good;

	if (argc < 3)
		return fprintf(stderr,
			       "usage: gdcheck -c LIST A.exr | A.exr B.exr [TOL [SCALE [TURN]]]\n"),
		       2;
	rc = load(&a, path, &err);
	if (rc == GD_OK && two)
		rc = load(&b, argv[2], &err);
	good = rc == GD_OK && finite_all(&a, path, list);
	if (good && two)
		good = finite_all(&b, argv[2], list) &&
		       alike(&a, &b, argc > 3 ? atof(argv[3]) : 0, argc > 4 ? atof(argv[4]) : 1,
			     argc > 5 ? argv[5][0] : ' ');
	gd_image_free(&a);
	gd_image_free(&b);
	if (rc != GD_OK)
		fprintf(stderr, "gdcheck: %s\n", err.text);
	return rc != GD_OK ? 2 : !good;
}
