/* SPDX-License-Identifier: BSD-3-Clause */
/* Seconds of the prefilter on 1280x720 (or WIDTH HEIGHT), three planes: 7 runs. */
#include <stdio.h>
#include <stdlib.h>

#include "nlm.h"

#define RUNS 7
#define PLANES 3

static int by_value(const void *a, const void *b)
{
	double x = *(const double *)a, y = *(const double *)b;

	return (x > y) - (x < y);
}

/* Blocks of constant colour with noise of known variance. */
static void fill(struct gd_plane u, struct gd_plane v, unsigned seed)
{
	for (int y = 0; y < u.h; y++)
		for (int x = 0; x < u.w; x++) {
			seed = seed * 1664525u + 1013904223u;
			gd_row(u, y)[x] = (float)((x / 40 + y / 40) % 5) +
					  0.3f * ((float)(seed >> 8) / 8388608.0f - 1.0f);
			gd_row(v, y)[x] = 0.03f;
		}
}

int main(int argc, char **argv)
{
	const int w = argc > 2 ? atoi(argv[1]) : 1280, h = argc > 2 ? atoi(argv[2]) : 720;
	const size_t size = gd_stride(w) * (size_t)h;
	struct gd_plane p[4][PLANES];
	struct gd_nlm_conf conf = GD_NLM_DEFAULTS;
	struct gd_nlm_job job = { PLANES, PLANES, p[0], p[1], p[0], p[1], p[2], p[3] };
	struct gd_err err = { 0 };
	double seconds[RUNS];
	float *block = gd_calloc(size, 4 * PLANES * sizeof *block);

	if (!block)
		return 2;
	for (int i = 0; i < 4 * PLANES; i++)
		p[i / PLANES][i % PLANES] = gd_plane_of(block + (size_t)i * size, w, h);
	for (int c = 0; c < PLANES; c++)
		fill(p[0][c], p[1][c], (unsigned)c + 1);
	for (int i = 0; i < RUNS; i++) {
		double start = gd_seconds();

		if (gd_nlm_run(&job, &conf, NULL, &err) != GD_OK) {
			fprintf(stderr, "%s\n", err.text);
			return 2;
		}
		seconds[i] = gd_seconds() - start;
	}
	qsort(seconds, RUNS, sizeof *seconds, by_value);
	printf("nlm\t%dx%d\tbest %.3f s\tmedian %.3f s\n", w, h, seconds[0], seconds[RUNS / 2]);
	free(block);
	return 0;
}
