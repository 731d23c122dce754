/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Seconds of the regression engine on made-up planes, as a table: bench_apr [width height].
 * 13 features (what cross-fitting offers), 3 channels with variances; the best of three runs.
 */
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "apr.h"

static struct gd_plane plane(int w, int h, unsigned seed, double period)
{
	struct gd_plane p = gd_plane_of(gd_calloc(gd_stride(w) * (size_t)h, sizeof(float)), w, h);

	if (!p.v) {
		fputs("bench_apr: out of memory\n", stderr);
		exit(2);
	}
	for (int y = 0; y < h; y++)
		for (int x = 0; x < w; x++) {
			seed = seed * 1664525u + 1013904223u;
			gd_row(p, y)[x] = (float)(1 + sin(x / period) * cos(y / period)) +
					  (float)(seed >> 8) / (1 << 24) * 0.1f;
		}
	return p;
}

int main(int argc, char **argv)
{
	static const struct {
		const char *name;
		int nfeat;
		bool choose;
		struct gd_apr_conf conf;
	} run[] = {
		{"paper, 13 features", 13, true, GD_APR_PAPER},
		{"paper, 7 features", 7, true, GD_APR_PAPER},
		{"R=21 step 8, orders 0..3", 13, true, {21, 8, 0, 3, GD_APR_GAUSS, 1, 1, 0, 0}},
		{"R=10 step 5, orders 0..3", 13, true, GD_APR_DEFAULTS},
		{"R=10 step 5, order 0, error", 13, true, {10, 5, 0, 0, GD_APR_GAUSS, 1, 1, 0, 0}},
		{"R=10 step 5, order 0", 13, false, {10, 5, 0, 0, GD_APR_GAUSS, 1, 1, 0, 0}},
		{"R=6 step 3, order 0", 13, false, {6, 3, 0, 0, GD_APR_BOX, 1, 1, 0, 0}},
	};
	int w = argc > 2 ? atoi(argv[1]) : 1280, h = argc > 2 ? atoi(argv[2]) : 720;
	struct gd_plane y[3], var[3], feat[13], est[3], mse[3];

	for (unsigned c = 0; c < 3; c++) {
		y[c] = plane(w, h, c, 40);
		var[c] = plane(w, h, 9 + c, 70);
		est[c] = plane(w, h, 0, 1);
		mse[c] = plane(w, h, 0, 1);
	}
	for (unsigned a = 0; a < 13; a++)
		feat[a] = plane(w, h, 20 + a, 10 + 9 * a);
	for (size_t i = 0; i < sizeof run / sizeof *run; i++) {
		struct gd_apr_in in = { 3, 3, run[i].nfeat, y, var, feat, NULL, { 0 } };
		struct gd_apr_out out = { est, run[i].choose ? mse : NULL, { 0 }, { 0 } };
		double best = 1e30, cpu = 1e30;

		for (int k = 0; k < 3; k++) {
			double start = gd_seconds();
			clock_t busy = clock();
			struct gd_err err = { 0 };

			if (gd_apr_fit(&out, &in, &run[i].conf, NULL, &err) != GD_OK) {
				fprintf(stderr, "bench_apr: %s\n", err.text);
				return 2;
			}
			best = fmin(best, gd_seconds() - start);
			cpu = fmin(cpu, (double)(clock() - busy) / CLOCKS_PER_SEC);
		}
		printf("apr\t%s\t%dx%d\t%.3f s\t%.3f CPU s\n", run[i].name, w, h, best, cpu);
	}
	return 0;
}
