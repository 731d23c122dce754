/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Time of the nonlinearly weighted regression: bench_nlr [width height features repeats].
 * The processor's seconds of all threads are less noisy than those on the clock when others run.
 */
#include <omp.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "isa.h"
#include "nlr.h"

static uint32_t seed = 1;

static float noise(void)
{
	seed = seed * 1664525u + 1013904223u;
	return (float)(seed >> 8) * 0x1p-24f - 0.5f;
}

static double processor(void)
{
	struct timespec t;

	clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
	return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

int main(int argc, char **argv)
{
	const int w = argc > 1 ? atoi(argv[1]) : 1280, h = argc > 2 ? atoi(argv[2]) : 720;
	const int nf = argc > 3 ? atoi(argv[3]) : 7, repeats = argc > 4 ? atoi(argv[4]) : 5;
	const int planes = 9 + nf;
	const struct gd_nlr_conf conf = GD_NLR_DEFAULTS;
	const size_t size = gd_stride(w) * (size_t)h;
	float *v = gd_calloc(size, (size_t)planes * sizeof *v);
	double best = 1e30, least = 1e30;
	struct gd_plane p[9 + GD_NLR_FEATURES];
	struct gd_nlr_in in = { .nfeat = nf };
	struct gd_err err = { 0 };

	if (!v || nf < 0 || nf > GD_NLR_FEATURES)
		return 2;
	for (int i = 0; i < planes; i++) {
		p[i] = gd_plane_of(v + size * (size_t)i, w, h);
		for (int y = 0; y < h; y++)
			for (int x = 0; x < w; x++)
				gd_row(p[i], y)[x] = i >= 3 && i < 6 ? 0.01f :
					(float)((x / 40 + y / 30 + i) % 5) * 0.2f + 0.3f * noise();
	}
	for (int c = 0; c < 3; c++) {
		in.y[c] = in.guide[c] = p[c];
		in.guide_var[c] = p[3 + c];
	}
	for (int j = 0; j < nf; j++)
		in.feat[j] = p[9 + j];
	for (int i = 0; i < repeats; i++) {
		double clock = gd_seconds(), cpu = processor();

		if (gd_nlr_run(p + 6, &in, &conf, NULL, &err) != GD_OK) {
			fprintf(stderr, "%s\n", err.text);
			return 2;
		}
		clock = gd_seconds() - clock;
		cpu = processor() - cpu;
		best = clock < best ? clock : best;
		least = cpu < least ? cpu : least;
	}
	printf("%dx%d, %d features, %d threads, %s: %.3f s, %.3f s of processor time (%.2f us a "
	       "pixel)\n",
	       w, h, nf, omp_get_max_threads(), gd_isa_name(), best, least, 1e6 * least / w / h);
	free(v);
	return 0;
}
