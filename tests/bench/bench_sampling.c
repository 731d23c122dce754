/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Speed of gd_sampling_map() alone, on errors of heavy tails.
 *	bench_sampling [WIDTH HEIGHT [REPEAT]]		(1024 1024 5)
 * Prints the least and the median wall seconds, and the CPU seconds of one map.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "rng.h"
#include "sampling.h"

static int compare(const void *a, const void *b)
{
	double x = *(const double *)a, y = *(const double *)b;

	return (x > y) - (x < y);
}

static struct gd_plane new_plane(int w, int h)
{
	struct gd_plane p = gd_plane_of(gd_alloc(gd_stride(w) * (size_t)h, sizeof(float)), w, h);

	if (!p.v)
		exit(2);
	return p;
}

static void fill(struct gd_sampling_in *in, int w, int h)
{
	struct gd_rng_key key = gd_rng_key(1, 2);

	in->samples = new_plane(w, h);
	for (int c = 0; c < 3; c++) {
		in->colour[c] = new_plane(w, h);
		in->error[c] = new_plane(w, h);
	}
	for (int y = 0; y < h; y++)
		for (int x = 0; x < w; x++) {
			uint32_t i = (uint32_t)y * (uint32_t)w + (uint32_t)x;

			for (int c = 0; c < 3; c++) {
				float u = gd_rng_float(key, i, (uint32_t)c);

				gd_row(in->colour[c], y)[x] = 0.2f + u * u;
				gd_row(in->error[c], y)[x] = 1e-4f / (1e-4f + u * u);
			}
			gd_row(in->samples, y)[x] = 8 + (float)(i % 5);
		}
}

int main(int argc, char **argv)
{
	int w = argc > 2 ? atoi(argv[1]) : 1024, h = argc > 2 ? atoi(argv[2]) : 1024;
	int repeat = argc > 3 ? atoi(argv[3]) : 5;
	struct gd_sampling_conf conf = GD_SAMPLING_DEFAULTS;
	struct gd_sampling_in in = { .n = 3 };
	struct gd_plane map = new_plane(w, h);
	struct gd_err err = { 0 };
	double *seconds = calloc((size_t)repeat + 1, sizeof *seconds);
	clock_t cpu = clock();

	if (!seconds || repeat < 1)
		return 2;
	fill(&in, w, h);
	conf.total = 4.0 * w * h;
	cpu = clock();
	for (int i = 0; i < repeat; i++) {
		double start = gd_seconds();

		if (gd_sampling_map(map, &in, &conf, NULL, &err) != GD_OK)
			return fprintf(stderr, "%s\n", err.text), 2;
		seconds[i] = gd_seconds() - start;
	}
	cpu = clock() - cpu;
	qsort(seconds, (size_t)repeat, sizeof *seconds, compare);
	printf("%dx%d\tleast %.4f\tmedian %.4f\tcpu %.4f\n", w, h, seconds[0], seconds[repeat / 2],
	       (double)cpu / CLOCKS_PER_SEC / repeat);
	free(seconds);
	return 0;
}
