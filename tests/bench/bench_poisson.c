/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Seconds of the Poisson solver and of bagging without I/O, medians of 5 runs, at 1280x720 (or
 * WIDTH HEIGHT): a line each of "what<TAB>seconds<TAB>megapixels", next to the memory bandwidth
 * of a STREAM triad. With EXR files as further arguments the first one's bins are tiled over
 * the image; else they are made up, with noise whose deviation varies by five orders and a
 * firefly in every thousandth pixel.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "boot.h"
#include "buffers.h"
#include "exr.h"
#include "poisson.h"
#include "rng.h"

enum { RUNS = 5, BINS = 8, STREAM = 1 << 24 };

struct input {
	int w, h;
	struct gd_plane dx[BINS][3], dy[BINS][3];
	struct gd_poisson_in in;
	struct gd_plane out[9];
};

static int by_value(const void *a, const void *b)
{
	double x = *(const double *)a, y = *(const double *)b;

	return (x > y) - (x < y);
}

static void print(const char *what, double *seconds, double megapixels)
{
	qsort(seconds, RUNS, sizeof(*seconds), by_value);
	printf("%s\t%.4f\t%.3f\n", what, seconds[RUNS / 2], megapixels);
	fflush(stdout);
}

static struct gd_plane blank(const struct input *i)
{
	float *v = gd_calloc(gd_stride(i->w) * (size_t)i->h, sizeof(float));

	if (!v)
		exit(2);
	return gd_plane_of(v, i->w, i->h);
}

static double truth(int x, int y, int c)
{
	return 1 + 0.5 * sin(0.02 * x + c) * cos(0.013 * y) + ((x / 90 + y / 70) % 3) * 0.4;
}

/* Roughly normal: four uniform numbers. */
static double noise(struct gd_rng_key key, uint32_t at, uint32_t draw)
{
	double s = -2;

	for (uint32_t k = 0; k < 4; k++)
		s += (double)gd_rng_float(key, at, 4 * draw + k);
	return s * 1.732;
}

static void make_bins(struct input *i)
{
	const struct gd_rng_key key = gd_rng_key(1, 0);

#pragma omp parallel for schedule(static)
	for (int y = 0; y < i->h; y++)
		for (int x = 0; x < i->w; x++) {
			const uint32_t at = (uint32_t)y * (uint32_t)i->w + (uint32_t)x;
			double sigma = pow(10, 1.5 * sin(0.05 * x) * cos(0.04 * y) - 1.5);

			if (gd_rng_float(key, at, 1000) < 0.001f)
				sigma = 30;
			for (int c = 0; c < 3; c++) {
				gd_row(i->in.primal[c], y)[x] =
					(float)(truth(x, y, c) + 0.1 * noise(key, at, (uint32_t)c));
				for (int b = 0; b < BINS; b++) {
					uint32_t draw = (uint32_t)(3 + 6 * b + 2 * c);

					gd_row(i->dx[b][c], y)[x] =
						(float)(truth(x + 1, y, c) - truth(x, y, c) +
							sigma * noise(key, at, draw));
					gd_row(i->dy[b][c], y)[x] =
						(float)(truth(x, y + 1, c) - truth(x, y, c) +
							sigma * noise(key, at, draw + 1));
				}
			}
		}
}

static void tile(struct gd_plane to, struct gd_plane from)
{
	for (int y = 0; y < to.h;
	     y++) /* every other copy mirrored would need other gradients: just repeated */
		for (int x = 0; x < to.w; x++)
			gd_row(to, y)[x] = gd_row(from, y % from.h)[x % from.w];
}

static int tile_bins(struct input *i, const char *path, struct gd_err *err)
{
	struct gd_read_conf conf = { 0 };
	struct gd_image im = { 0 };
	struct gd_plane p[GD_LAYER_PLANES];
	struct gd_exr *file;
	int rc = gd_exr_open(&file, &im, path, &conf, err);

	if (rc != GD_OK)
		return rc;
	for (int k = 0; k < im.nchan; k++)
		im.chan[k].want = GD_READ;
	rc = gd_exr_load(file, &im, err);
	gd_exr_close(file);
	if (rc == GD_OK && (gd_bins(&im, "dx") < BINS || gd_layer_planes(&im, "", p) != 3))
		rc = gd_fail(err, GD_ESHAPE, "%s: needs R, G, B and %d bins", path, BINS);
	for (int c = 0; rc == GD_OK && c < 3; c++)
		tile(i->in.primal[c], p[c]);
	for (int b = 0; rc == GD_OK && b < BINS; b++) {
		char name[32];

		snprintf(name, sizeof(name), "bin%d.dx", b);
		gd_layer_planes(&im, name, p);
		for (int c = 0; c < 3; c++)
			tile(i->dx[b][c], p[c]);
		snprintf(name, sizeof(name), "bin%d.dy", b);
		gd_layer_planes(&im, name, p);
		for (int c = 0; c < 3; c++)
			tile(i->dy[b][c], p[c]);
	}
	gd_image_free(&im);
	return rc;
}

/* Means of the bins and their variances. */
static void average(struct gd_plane mean, struct gd_plane var, struct gd_plane (*bin)[3], int c)
{
#pragma omp parallel for schedule(static)
	for (int y = 0; y < mean.h; y++)
		for (int x = 0; x < mean.w; x++) {
			double sum = 0, square = 0;

			for (int b = 0; b < BINS; b++)
				sum += (double)gd_row(bin[b][c], y)[x] / BINS;
			for (int b = 0; b < BINS; b++)
				square += pow((double)gd_row(bin[b][c], y)[x] - sum, 2);
			gd_row(mean, y)[x] = (float)sum;
			gd_row(var, y)[x] = (float)(square / (BINS * (BINS - 1)));
		}
}

static void bench_stream(void)
{
	float *a = gd_calloc(3 * (size_t)STREAM, sizeof(float)), *b = a + STREAM, *c = b + STREAM;
	double seconds[RUNS];

	if (!a)
		return;
	for (int k = 0; k < RUNS; k++) {
		double start = gd_seconds();

#pragma omp parallel for simd schedule(static)
		for (int i = 0; i < STREAM; i++)
			a[i] = b[i] + 1.5f * c[i];
		seconds[k] = gd_seconds() - start;
	}
	qsort(seconds, RUNS, sizeof(*seconds), by_value);
	printf("# triad %.1f GB/s\n", 12.0 * STREAM / seconds[RUNS / 2] * 1e-9);
	free(a);
}

static int bench_solver(struct input *i, double megapixels, struct gd_err *err)
{
	static const char *const name[] = {"gdsolve ols", "gdsolve wls", "gdsolve l2",
					   "gdsolve l1"};

	for (int m = 0; m < 4; m++) {
		struct gd_poisson_conf conf = GD_POISSON_DEFAULTS;
		struct gd_poisson_result result;
		double seconds[RUNS];

		conf.method = (enum gd_poisson_method)m;
		for (int k = 0; k < RUNS; k++) {
			double start = gd_seconds();

			if (gd_poisson_solve(i->out, &i->in, &conf, &result, NULL, err) != GD_OK)
				return err->code;
			seconds[k] = gd_seconds() - start;
		}
		print(name[m], seconds, megapixels);
		fprintf(stderr, "%s: %d iterations, residual %.2g%s\n", name[m], result.iterations,
			result.residual, result.wide ? ", in double" : "");
	}
	return GD_OK;
}

static int bench_boot(struct input *i, double megapixels, struct gd_err *err)
{
	struct gd_boot_conf conf = GD_BOOT_DEFAULTS;
	struct gd_boot_in in = {3,
				BINS,
				(const struct gd_plane(*)[3])i->dx,
				(const struct gd_plane(*)[3])i->dy,
				{i->in.primal[0], i->in.primal[1], i->in.primal[2]}};
	struct gd_boot_out out;
	struct gd_boot_result result;
	double seconds[RUNS], plain[RUNS];

	memcpy(out.mean, i->out, sizeof(out.mean));
	memcpy(out.var, i->out + 3, sizeof(out.var));
	memcpy(out.local, i->out + 6, sizeof(out.local));
	for (int k = 0; k < RUNS; k++) {
		double start = gd_seconds();

		if (gd_boot_run(&out, &in, &conf, &result, NULL, err) != GD_OK)
			return err->code;
		seconds[k] = gd_seconds() - start;
		start = gd_seconds();
		in.bins = BINS / 2;
		if (gd_boot_plain(out.mean, &in, &conf, NULL, NULL, err) != GD_OK)
			return err->code;
		in.bins = BINS;
		plain[k] = gd_seconds() - start;
	}
	print("gdbag 10 replicates", seconds, megapixels);
	fprintf(stderr, "gdbag: %d iterations\n", result.iterations);
	print("feature of one half", plain, megapixels);
	return GD_OK;
}

int main(int argc, char **argv)
{
	struct input i = {.w = argc > 2 ? atoi(argv[1]) : 1280,
			  .h = argc > 2 ? atoi(argv[2]) : 720};
	struct gd_err err = { 0 };
	const double megapixels = 1e-6 * i.w * i.h;
	int rc = GD_OK;

	if (i.w < 1 || i.h < 1)
		return 2;
	i.in.n = 3;
	for (int c = 0; c < 3; c++) {
		i.in.primal[c] = blank(&i);
		i.in.dx[c] = blank(&i);
		i.in.dy[c] = blank(&i);
		i.in.dxvar[c] = blank(&i);
		i.in.dyvar[c] = blank(&i);
		for (int k = 0; k < 3; k++)
			i.out[3 * k + c] = blank(&i);
		for (int b = 0; b < BINS; b++) {
			i.dx[b][c] = blank(&i);
			i.dy[b][c] = blank(&i);
		}
	}
	if (argc > 3)
		rc = tile_bins(&i, argv[3], &err);
	else
		make_bins(&i);
	for (int c = 0; c < 3; c++) {
		average(i.in.dx[c], i.in.dxvar[c], i.dx, c);
		average(i.in.dy[c], i.in.dyvar[c], i.dy, c);
	}
	printf("what\tseconds\tmegapixels\n");
	bench_stream();
	if (rc == GD_OK)
		rc = bench_solver(&i, megapixels, &err);
	if (rc == GD_OK)
		rc = bench_boot(&i, megapixels, &err);
	if (rc != GD_OK)
		fprintf(stderr, "bench_poisson: %s\n", err.text);
	return rc == GD_OK ? 0 : 2;	/* the memory goes with the process */
}
