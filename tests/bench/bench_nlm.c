/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Seconds of non-local means on 1280x720 (or WIDTH HEIGHT), three planes, 7 runs: of
 * a feature whose pixels are all noisy, and as the denoisers filter features, with
 * noise everywhere and at edges.
 */
#include <stdbool.h>
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
static void fill(struct gd_plane u, struct gd_plane v, unsigned seed, bool edges)
{
	for (int y = 0; y < u.h; y++)
		for (int x = 0; x < u.w; x++) {
			const float noisy = !edges || x % 40 == 0 || y % 40 == 0 ? 1.0f : 0.0f;

			seed = seed * 1664525u + 1013904223u;
			gd_row(u, y)[x] = (float)((x / 40 + y / 40) % 5) +
					  0.3f * noisy * ((float)(seed >> 8) / 8388608.0f - 1.0f);
			gd_row(v, y)[x] = 0.03f * noisy;
		}
}

static int measure(const char *name, const struct gd_nlm_job *job, const struct gd_nlm_conf *conf)
{
	struct gd_err err = { 0 };
	double seconds[RUNS];

	for (int i = 0; i < RUNS; i++) {
		double start = gd_seconds();

		if (gd_nlm_run(job, conf, NULL, &err) != GD_OK) {
			fprintf(stderr, "%s\n", err.text);
			return 2;
		}
		seconds[i] = gd_seconds() - start;
	}
	qsort(seconds, RUNS, sizeof *seconds, by_value);
	printf("%s\t%dx%d\tbest %.3f s\tmedian %.3f s\n", name, job->guide[0].w, job->guide[0].h,
	       seconds[0], seconds[RUNS / 2]);
	return 0;
}

int main(int argc, char **argv)
{
	const int w = argc > 2 ? atoi(argv[1]) : 1280, h = argc > 2 ? atoi(argv[2]) : 720;
	const size_t size = gd_stride(w) * (size_t)h;
	struct gd_plane p[4][PLANES];
	struct gd_nlm_conf plain = GD_NLM_DEFAULTS, quick = GD_NLM_PREFILTER;
	struct gd_nlm_job job = { PLANES, PLANES, p[0], p[1], p[0], p[1], p[2], p[3] };
	float *block = gd_calloc(size, 4 * PLANES * sizeof *block);
	int failed;

	if (!block)
		return 2;
	for (int i = 0; i < 4 * PLANES; i++)
		p[i / PLANES][i % PLANES] = gd_plane_of(block + (size_t)i * size, w, h);
	for (int c = 0; c < PLANES; c++)
		fill(p[0][c], p[1][c], (unsigned)c + 1, false);
	failed = measure("nlm", &job, &plain);
	failed |= measure("nlm, prefilter", &job, &quick);
	for (int c = 0; c < PLANES; c++)
		fill(p[0][c], p[1][c], (unsigned)c + 1, true);
	failed |= measure("nlm, prefilter of edges", &job, &quick);
	free(block);
	return failed;
}
