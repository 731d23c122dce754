/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Time of the sparse linear predictions: bench_lwr [width height features repeats [dense|paper]].
 * The processor's seconds of all threads are less noisy than those on the clock when others run.
 */
#include <math.h>
#include <omp.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "isa.h"
#include "lwr.h"

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

/* Regions, a shade, and a texture that no feature tells of, under noise; then the features. */
static void paint(struct gd_plane *p, int w, int h, int nf)
{
	for (int y = 0; y < h; y++)
		for (int x = 0; x < w; x++) {
			int region = (x / 40 + y / 30) % 5;
			float shade = 0.5f + 0.2f * sinf(0.02f * (float)x) +
				      ((x / 9 + y / 7) % 11 == 0 ? 0.3f : 0);

			for (int c = 0; c < 6; c++)
				gd_row(p[c], y)[x] =
					shade * (1 + (float)(region * (c % 3)) * 0.2f) +
					0.3f * noise();
			for (int a = 0; a < nf; a++)
				gd_row(p[9 + a], y)[x] =
					(float)((region + a) % 5) * 0.2f + 0.02f * noise();
		}
}

int main(int argc, char **argv)
{
	const int w = argc > 1 ? atoi(argv[1]) : 1024, h = argc > 2 ? atoi(argv[2]) : 1024;
	const int nf = argc > 3 ? atoi(argv[3]) : 10, repeats = argc > 4 ? atoi(argv[4]) : 5;
	const size_t size = gd_stride(w) * (size_t)h;
	float *v = gd_calloc(size, (size_t)(9 + nf) * sizeof *v);
	double best = 1e30, least = 1e30;
	struct gd_plane p[9 + GD_LWR_FEATURES];
	struct gd_lwr_conf conf = GD_LWR_DEFAULTS;
	struct gd_lwr_in in = { .ny = 3, .nfeat = nf, .y = p, .twin = p + 3, .feat = p + 9 };
	struct gd_lwr_out out = { .est = p + 6 };
	struct gd_lwr_result result = { 0 };
	struct gd_err err = { 0 };

	if (!v || nf < 0 || nf > GD_LWR_FEATURES)
		return 2;
	conf.dense = argc > 5 && !strcmp(argv[5], "dense");
	conf.paper = argc > 5 && !strcmp(argv[5], "paper");
	for (int i = 0; i < 9 + nf; i++)
		p[i] = gd_plane_of(v + size * (size_t)i, w, h);
	paint(p, w, h, nf);
	for (int i = 0; i < repeats; i++) {
		double clock = gd_seconds(), cpu = processor();

		if (gd_lwr_fit(&out, &in, &conf, &result, NULL, &err) != GD_OK) {
			fprintf(stderr, "%s\n", err.text);
			return 2;
		}
		clock = gd_seconds() - clock;
		cpu = processor() - cpu;
		best = clock < best ? clock : best;
		least = cpu < least ? cpu : least;
	}
	printf("%dx%d, %d features, %d threads, %s: %.3f s, %.3f s of processor time; %.2f %% of "
	       "the pixels are centres, mean radius %.2f, %.2f us a model\n",
	       w, h, nf, omp_get_max_threads(), gd_isa_name(), best, least,
	       100.0 * (double)result.models / w / h, result.mean_radius,
	       1e6 * least / (double)result.models);
	free(v);
	return 0;
}
