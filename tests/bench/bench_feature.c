/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Seconds of the feature stage on 1280x720 (or WIDTH HEIGHT) with 8 bins of noise whose strength
 * changes from pixel to pixel by orders of magnitude,
 * as rendered gradients have it: medians of 5 runs.
 */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#include "feature.h"

#define BINS 8
#define RUNS 5

enum { SOLVE, HALVES, FILTER, ALL, TIMES };

static uint64_t state = 1;

static double uniform(void)
{
	state = state * 6364136223846793005u + 1442695040888963407u;
	return (double)(state >> 11) / 9007199254740992.0;
}

static int by_value(const void *a, const void *b)
{
	double x = *(const double *)a, y = *(const double *)b;

	return (x > y) - (x < y);
}

/* One channel of a bin of dx, dy or colour; the image itself is black. */
static int fill(struct gd_image *im, int bin, const char *layer, char c)
{
	char name[64];
	struct gd_plane p;
	struct gd_err err = { 0 };

	snprintf(name, sizeof name, "bin%d.%s%c", bin, layer, c);
	if (gd_image_add(im, name, &p, &err) != GD_OK)
		return 1;
	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++) {
			unsigned place = (unsigned)(y * p.w + x) * 2654435761u;
			double sd = exp((double)(place >> 8) / 4194304.0 - 4.0);

			gd_row(p, y)[x] = (float)(sd * (2.0 * uniform() - 1.0));
		}
	return 0;
}

static int run(struct gd_image *im, double *seconds)
{
	struct gd_feature_conf conf = GD_FEATURE_DEFAULTS;
	struct gd_feature_result res;
	struct gd_err err = { 0 };
	double start = gd_seconds();

	conf.keep = true;
	if (gd_feature_run(im, &conf, &res, NULL, &err) != GD_OK) {
		fprintf(stderr, "%s\n", err.text);
		return 1;
	}
	seconds[ALL] = gd_seconds() - start;
	seconds[SOLVE] = res.solve_seconds;
	seconds[HALVES] = res.half_seconds;
	seconds[FILTER] = res.filter_seconds;
	return 0;
}

int main(int argc, char **argv)
{
	static const char *const layer[] = { "dx.", "dy.", "" };
	static const char *const name[TIMES] = { "bagging", "halves", "filter", "all" };
	const int w = argc > 2 ? atoi(argv[1]) : 1280, h = argc > 2 ? atoi(argv[2]) : 720;
	double seconds[RUNS][TIMES], column[RUNS];
	struct gd_image im;
	int failed = 0;

	gd_image_init(&im, w, h);
	for (int b = 0; b < BINS; b++)
		for (int i = 0; i < 9; i++)
			failed |= fill(&im, b, layer[i / 3], "RGB"[i % 3]);
	for (int i = 0; i < RUNS && !failed; i++)
		failed = run(&im, seconds[i]);
	for (int t = 0; t < TIMES && !failed; t++) {
		for (int i = 0; i < RUNS; i++)
			column[i] = seconds[i][t];
		qsort(column, RUNS, sizeof *column, by_value);
		printf("feature, %s\t%dx%d\tbest %.3f s\tmedian %.3f s\n", name[t], w, h, column[0],
		       column[RUNS / 2]);
	}
	gd_image_free(&im);
	return failed ? 2 : 0;
}
