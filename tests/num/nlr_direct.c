/* SPDX-License-Identifier: BSD-3-Clause */
/* The nonlinearly weighted regression against the formulas of nlr.h written down in double. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <math.h>
#include <stdlib.h>

#include "nlr.h"

#define PLANES (13 + GD_NLR_FEATURES)
#define TERMS (GD_NLR_FEATURES + 1)
#define WINDOW ((2 * GD_NLR_WINDOW + 1) * (2 * GD_NLR_WINDOW + 1))

struct problem {
	int w, h;
	struct gd_nlr_in in;
	struct gd_nlr_conf conf;
	struct gd_plane out[3];
	double eps;		/* e of the header */
	double *want;		/* 3 sums and their weights for each pixel */
	float *block;
};

static uint32_t state;

static double uniform(void)
{
	state = state * 1664525u + 1013904223u;
	return (double)(state >> 8) / 16777216.0;
}

static double normal(void)
{
	return sqrt(-2.0 * log(1.0 - uniform())) * cos(6.283185307179586 * uniform());
}

static double at(struct gd_plane p, int x, int y)
{
	return p.v ? gd_row(p, y)[x] : 0.0;
}

static void build(struct problem *p, int w, int h, int nfeat, int with_weight, int separate_guide)
{
	const size_t size = gd_stride(w) * (size_t)h;
	struct gd_plane v[PLANES];

	p->w = w;
	p->h = h;
	p->block = gd_calloc(PLANES * size, sizeof(float));
	p->want = calloc((size_t)w * h, 4 * sizeof *p->want);
	assert_non_null(p->block);
	assert_non_null(p->want);
	for (int i = 0; i < PLANES; i++)
		v[i] = gd_plane_of(p->block + (size_t)i * size, w, h);
	p->in = (struct gd_nlr_in){ .nfeat = nfeat };
	for (int c = 0; c < 3; c++) {
		p->in.y[c] = v[c];
		p->in.guide[c] = separate_guide ? v[3 + c] : v[c];
		p->in.guide_var[c] = v[6 + c];
		p->out[c] = v[9 + c];
	}
	if (with_weight)
		p->in.weight = v[12];
	for (int j = 0; j < nfeat; j++)
		p->in.feat[j] = v[13 + j];
	p->conf = GD_NLR_DEFAULTS;
}

static void drop(struct problem *p)
{
	free(p->block);
	free(p->want);
}

/* Edges that the features know in part, textures, noise of changing variance, 0 in places. */
static void fill(struct problem *p, double scale)
{
	for (int y = 0; y < p->h; y++)
		for (int x = 0; x < p->w; x++) {
			double edge = (x / 9 + y / 7) % 3, wave = sin(0.3 * x) * cos(0.23 * y);
			double sd = x % 17 == 3 ? 0.0 : 0.1 + 0.2 * (y % 11) / 11.0;

			for (int j = 0; j < p->in.nfeat; j++)
				gd_row(p->in.feat[j], y)[x] =
					(float)(j % 3 == 0 ? 0.4 * edge + 0.02 * normal() :
						j % 3 == 1 ? 0.5 * wave + 0.01 * (x - y) * j :
							     uniform());
			for (int c = 0; c < 3; c++) {
				double truth = edge + 0.4 * (c + 1) * wave + 0.3 * c;

				gd_row(p->in.y[c], y)[x] = (float)(scale * (truth + sd * normal()));
				gd_row(p->in.guide[c], y)[x] =
					(float)(scale * (truth + sd * normal()));
				gd_row(p->in.guide_var[c], y)[x] = (float)(scale * scale * sd * sd);
			}
			if (p->in.weight.v)
				gd_row(p->in.weight, y)[x] = (float)(x == 5 && y < 9 ? 0.0 :
								     1e-3 / (0.1 + edge));
		}
}

static double global_eps(const struct problem *p)
{
	double var = 0.0, n = (double)p->w * p->h;

	for (int c = 0; c < 3; c++) {
		double mean = 0.0, s = 0.0;

		for (int i = 0; i < p->w * p->h; i++)
			mean += at(p->in.guide[c], i % p->w, i / p->w) / n;
		for (int i = 0; i < p->w * p->h; i++)
			s += pow(at(p->in.guide[c], i % p->w, i / p->w) - mean, 2.0) / n;
		var += s / 3.0;
	}
	return p->conf.eps * var;
}

static double weight(const struct problem *p, int cx, int cy, int dx, int dy)
{
	const double k2 = p->conf.k * p->conf.k;
	double sum = 0.0, w;
	int n = 0, f = p->conf.patch;

	for (int y = cy - f; y <= cy + f; y++)
		for (int x = cx - f; x <= cx + f; x++) {
			if (x < 0 || y < 0 || x >= p->w || y >= p->h || x + dx < 0 || y + dy < 0 ||
			    x + dx >= p->w || y + dy >= p->h)
				continue;
			for (int c = 0; c < 3; c++) {
				double d = at(p->in.guide[c], x, y) -
					   at(p->in.guide[c], x + dx, y + dy);
				double v = at(p->in.guide_var[c], x, y);
				double vq = at(p->in.guide_var[c], x + dx, y + dy);

				sum += fmin(1e4,
					    (d * d - v - fmin(v, vq)) / (p->eps + k2 * (v + vq)));
				n++;
			}
		}
	w = exp(-fmax(0.0, sum / n));
	return w < 1e-4 ? 0.0 : w;
}

/* Solves a x = b for 3 right-hand sides by Gaussian elimination with pivots on the diagonal. */
static void solve(int n, double a[TERMS][TERMS + 3])
{
	for (int k = 0; k < n; k++)
		for (int i = 0; i < n; i++) {
			double l = a[i][k] / a[k][k];

			for (int j = k; i != k && j < n + 3; j++)
				a[i][j] -= l * a[k][j];
		}
	for (int i = 0; i < n; i++)
		for (int j = n; j < n + 3; j++)
			a[i][j] /= a[i][i];
}

static void columns(const struct problem *p, int x, int y, int cx, int cy, double z[TERMS])
{
	z[0] = 1.0;
	for (int j = 0; j < p->in.nfeat; j++)
		z[1 + j] = at(p->in.feat[j], x, y) - at(p->in.feat[j], cx, cy);
}

static void centre(struct problem *p, int cx, int cy)
{
	const int r = p->conf.window, side = 2 * r + 1, n = p->in.nfeat + 1;
	double a[TERMS][TERMS + 3] = { { 0 } }, w[WINDOW] = { 0 }, z[TERMS];

	for (int s = 0; s < side * side; s++) {
		int x = cx + s % side - r, y = cy + s / side - r;

		if (x < 0 || y < 0 || x >= p->w || y >= p->h)
			continue;
		w[s] = weight(p, cx, cy, x - cx, y - cy);

		double m = w[s] * (p->in.weight.v ? at(p->in.weight, x, y) : 1.0);

		columns(p, x, y, cx, cy, z);
		for (int i = 0; i < n; i++) {
			for (int j = 0; j < n; j++)
				a[i][j] += m * z[i] * z[j];
			for (int c = 0; c < 3; c++)
				a[i][n + c] += m * z[i] * at(p->in.y[c], x, y);
		}
	}
	if (a[0][0] <= 0.0)
		return;
	for (int i = 1; i < n; i++)
		a[i][i] += p->conf.ridge * a[0][0] + 1e-4 * a[i][i];
	solve(n, a);
	for (int s = 0; s < side * side; s++) {
		int x = cx + s % side - r, y = cy + s / side - r;

		if (w[s] == 0.0)
			continue;
		columns(p, x, y, cx, cy, z);

		double *to = p->want + 4 * ((size_t)y * p->w + x);

		for (int c = 0; c < 3; c++)
			for (int i = 0; i < n; i++)
				to[c] += w[s] * a[i][n + c] * z[i];
		to[3] += w[s];
	}
}

static void compare(struct problem *p, double scale)
{
	struct gd_err err = { 0 };

	p->eps = global_eps(p);
	for (int i = 0; i < p->w * p->h; i++)
		centre(p, i % p->w, i / p->w);
	assert_int_equal(gd_nlr_run(p->out, &p->in, &p->conf, NULL, &err), GD_OK);
	for (int c = 0; c < 3; c++)
		for (int i = 0; i < p->w * p->h; i++) {
			const double *s = p->want + 4 * (size_t)i;
			double want = s[3] > 0.0 ? s[c] / s[3] : at(p->in.y[c], i % p->w, i / p->w);
			double got = at(p->out[c], i % p->w, i / p->w);

			/* Floats in the moments, a ridge of 1e-3: 1e-4; and weights that are 0 in
			 * one and 1e-4 in the other. */
			if (!(fabs(got - want) <= 5e-4 * scale))
				fail_msg("plane %d pixel %d,%d: %.9g, expected %.9g", c, i % p->w,
					 i / p->w, got, want);
		}
}

static void run_case(int w, int h, int nfeat, int window, int patch, int with_weight, int guide,
		     double scale)
{
	struct problem p;

	state = (uint32_t)(w * 31 + h * 7 + nfeat);
	build(&p, w, h, nfeat, with_weight, guide);
	p.conf.window = window;
	p.conf.patch = patch;
	fill(&p, scale);
	compare(&p, scale);
	drop(&p);
}

static void test_default(void **unused)
{
	(void)unused;
	run_case(70, 41, 7, 5, 2, 0, 0, 1.0);
	run_case(70, 41, 7, 5, 2, 1, 1, 1.0);
}

static void test_more_tiles(void **unused)
{
	(void)unused;
	run_case(161, 37, 4, 5, 2, 0, 1, 1.0);
	run_case(130, 65, 1, 3, 1, 1, 0, 1.0);
}

static void test_numbers_of_features(void **unused)
{
	(void)unused;
	for (int nf = 0; nf <= GD_NLR_FEATURES; nf++)
		run_case(23, 19, nf, 5, 2, nf % 2, 0, 1.0);
}

static void test_windows(void **unused)
{
	(void)unused;
	for (int window = 0; window <= GD_NLR_WINDOW; window += 2)
		for (int patch = 0; patch <= GD_NLR_PATCH; patch++)
			run_case(33, 25, 3, window, patch, 0, 1, 1.0);
}

static void test_small_images(void **unused)
{
	static const int size[][2] = { { 1, 1 },  { 1, 9 },  { 40, 1 }, { 2, 2 },
				       { 3, 40 }, { 17, 4 }, { 5, 33 } };

	(void)unused;
	for (size_t i = 0; i < sizeof size / sizeof *size; i++)
		run_case(size[i][0], size[i][1], 2, 5, 2, 0, 0, 1.0);
}

static void test_units(void **unused)
{
	(void)unused;
	run_case(40, 30, 5, 5, 2, 1, 0, 3e-12);
	run_case(40, 30, 5, 5, 2, 1, 1, 7e11);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_default),
		cmocka_unit_test(test_more_tiles),
		cmocka_unit_test(test_numbers_of_features),
		cmocka_unit_test(test_windows),
		cmocka_unit_test(test_small_images),
		cmocka_unit_test(test_units),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
