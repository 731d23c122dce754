/* SPDX-License-Identifier: BSD-3-Clause */
/* Properties of the regression engine that hold whatever the window; numbers are in tests/num. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <float.h>
#include <math.h>
#include <omp.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apr.h"

#define MAXY 6
#define MAXF 8

struct frame {
	int w, h, ny, nvar, nfeat;
	struct gd_plane y[MAXY], var[MAXY], feat[MAXF];
	struct gd_plane est[MAXY], mse[MAXY], order, columns;
};

static struct gd_plane plane(int w, int h)
{
	return gd_plane_of(gd_calloc(gd_stride(w) * (size_t)h, sizeof(float)), w, h);
}

static struct frame frame(int w, int h, int ny, int nvar, int nfeat)
{
	struct frame f = { .w = w, .h = h, .ny = ny, .nvar = nvar, .nfeat = nfeat,
			   .order = plane(w, h), .columns = plane(w, h) };

	for (int c = 0; c < MAXY; c++) {
		f.y[c] = plane(w, h);
		f.var[c] = plane(w, h);
		f.est[c] = plane(w, h);
		f.mse[c] = plane(w, h);
	}
	for (int a = 0; a < MAXF; a++)
		f.feat[a] = plane(w, h);
	return f;
}

static void release(struct frame *f)
{
	for (int c = 0; c < MAXY; c++) {
		free(f->y[c].v);
		free(f->var[c].v);
		free(f->est[c].v);
		free(f->mse[c].v);
	}
	for (int a = 0; a < MAXF; a++)
		free(f->feat[a].v);
	free(f->order.v);
	free(f->columns.v);
}

static float *px(struct gd_plane p, int x, int y)
{
	return gd_row(p, y) + x;
}

static double rnd(uint32_t key)
{
	key = (key ^ 61) ^ (key >> 16);
	key *= 9;
	key ^= key >> 4;
	key *= 0x27d4eb2d;
	key ^= key >> 15;
	return (double)key / 4294967296.0 - 0.5;
}

/* A picture with two regions, a smooth shade, noise of two strengths; features: region, ramp,
 * noise. */
static void paint(struct frame *f)
{
	for (int y = 0; y < f->h; y++)
		for (int x = 0; x < f->w; x++) {
			uint32_t key = (uint32_t)(y * f->w + x) * 64;
			int side = 2 * x + y > f->w;
			double s = side ? 0.3 : 0.1;

			for (int c = 0; c < f->ny; c++) {
				*px(f->y[c], x, y) = (float)(1 + side + 0.02 * c * x +
							     sin(0.2 * y) + s * rnd(key + c));
				*px(f->var[c], x, y) = (float)(s * s / 12);
			}
			for (int a = 0; a < f->nfeat; a++)
				*px(f->feat[a], x, y) = (float)(a == 0	 ? side
								: a == 1 ? 0.1 * x + side
									 : rnd(key + 32 + a));
		}
}

static void fit(struct frame *f, struct gd_apr_conf conf)
{
	struct gd_apr_in in = { f->ny, f->nvar, f->nfeat, f->y, f->var, f->feat, NULL, { 0 } };
	struct gd_apr_out out = { f->est, f->mse, f->order, f->columns };
	struct gd_err err = { 0 };

	assert_int_equal(gd_apr_fit(&out, &in, &conf, NULL, &err), GD_OK);
}

static const struct gd_apr_conf settings = { 7, 3, 0, 3, GD_APR_GAUSS, 1, 1, 0, 0 };

/* Largest difference of two planes, b seen through a map of coordinates, relative to the largest
 * value. */
static double apart(struct gd_plane a, struct gd_plane b, int map)
{
	double worst = 0, most = 0;

	for (int y = 0; y < a.h; y++)
		for (int x = 0; x < a.w; x++) {
			int i = map == 1   ? a.w - 1 - x
				: map == 3 ? y
					   : x,
			    j = map == 2   ? a.h - 1 - y
				: map == 3 ? x
					   : y;
			double d = fabs((double)*px(a, x, y) - (double)*px(b, i, j));

			worst = d > worst || isnan(d) ? d : worst;
			most = fmax(most, fabs((double)*px(a, x, y)));
		}
	return worst / (most > 0 ? most : 1);
}

/* What the model can express comes back, noise or not in the variances: to a few float roundings.
 */
static void test_exact(void **state)
{
	struct frame f = frame(53, 41, 3, 3, 3);

	(void)state;
	paint(&f);
	for (int y = 0; y < f.h; y++)
		for (int x = 0; x < f.w; x++)
			for (int c = 0; c < 3; c++) {
				double u = x / 26.0 - 1, v = y / 20.0 - 1;

				*px(f.y[c], x, y) =
					(float)(2 + u - 0.7 * v * v + c * u * u * u +
						0.3 * v * v * v + 3 * (double)*px(f.feat[0], x, y) -
						0.5 * (double)*px(f.feat[2], x, y));
				*px(f.var[c], x, y) = 0;
			}
	fit(&f, settings);
	for (int c = 0; c < 3; c++) {
		assert_true(apart(f.y[c], f.est[c], 0) < 1e-6);
		for (int i = 0; i < f.w; i++)
			assert_true(*px(f.mse[c], i, 7) >= 0 && *px(f.mse[c], i, 7) < 1e-9f);
	}
	release(&f);
}

/* A flipped, transposed, permuted, scaled frame gives that of the result. */
static void test_symmetry(void **state)
{
	static const int size[][2] = { { 52, 37 }, { 37, 52 }, { 40, 40 } };

	(void)state;
	for (int s = 0; s < 3; s++)
		for (int map = 1; map <= 3; map++) {
			int w = size[s][0], h = size[s][1];
			struct frame a = frame(w, h, 3, 3, 3),
				     b = map == 3 ? frame(h, w, 3, 3, 3) : frame(w, h, 3, 3, 3);

			paint(&a);
			for (int y = 0; y < b.h; y++)
				for (int x = 0; x < b.w; x++) {
					int i = map == 1   ? w - 1 - x
						: map == 3 ? y
							   : x,
					    j = map == 2   ? h - 1 - y
						: map == 3 ? x
							   : y;

					for (int c = 0; c < 3; c++) {
						int d = map == 2 ? (c + 1) % 3
								 : c; /* and the channels turned
									 round */

						*px(b.y[d], x, y) = 64 * *px(a.y[c], i, j);
						*px(b.var[d], x, y) = 4096 * *px(a.var[c], i, j);
						*px(b.feat[c], x, y) = 1024 * *px(a.feat[c], i, j);
					}
				}
			fit(&a, settings);
			fit(&b, settings);
			for (int y = 0; y < b.h; y++)
				for (int x = 0; x < b.w; x++)
					for (int c = 0; c < 3; c++) {
						*px(b.est[c], x, y) /= 64;
						*px(b.mse[c], x, y) /= 4096;
					}
			for (int c = 0; c < 3; c++) {
				int d = map == 2 ? (c + 1) % 3 : c;

				assert_true(apart(a.est[c], b.est[d], map) < 1e-6);
				assert_true(apart(a.mse[c], b.mse[d], map) < 1e-5);
			}
			assert_true(apart(a.order, b.order, map) < 1e-6);
			release(&a);
			release(&b);
		}
}

/* Layers that add up to the colour still do, and do not change it. */
static void test_layers(void **state)
{
	struct frame a = frame(45, 33, 3, 3, 2), b = frame(45, 33, 5, 3, 2);
	double worst = 0;

	(void)state;
	paint(&a);
	paint(&b);
	for (int y = 0; y < b.h; y++)
		for (int x = 0; x < b.w; x++) {
			*px(b.y[3], x, y) = 0.25f * (float)(1 + x % 4) * *px(b.y[1], x, y);
			*px(b.y[4], x, y) = *px(b.y[1], x, y) - *px(b.y[3], x, y);
		}
	fit(&a, settings);
	fit(&b, settings);
	for (int c = 0; c < 3; c++)
		assert_true(apart(a.est[c], b.est[c], 0) < 1e-6);
	for (int y = 0; y < b.h; y++)
		for (int x = 0; x < b.w; x++)
			worst = fmax(worst, fabs((double)*px(b.est[3], x, y) +
						 (double)*px(b.est[4], x, y) -
						 (double)*px(b.est[1], x, y)));
	assert_true(worst < 2e-6);
	release(&a);
	release(&b);
}

/* Constant, copied, collinear and far shifted features change nothing. */
static void test_useless_features(void **state)
{
	struct frame a = frame(44, 35, 3, 3, 2), b = frame(44, 35, 3, 3, 6);

	(void)state;
	paint(&a);
	paint(&b);
	for (int y = 0; y < b.h; y++)
		for (int x = 0; x < b.w; x++) {
			*px(a.feat[1], x, y) = *px(b.feat[1], x, y) =
				(float)(x % 8) + (float)(y % 3);
			*px(b.feat[2], x, y) = 7;
			*px(b.feat[3], x, y) = *px(b.feat[1], x, y);
			*px(b.feat[4], x, y) = 3 * *px(b.feat[0], x, y) - 2 * *px(b.feat[1], x, y);
			*px(b.feat[5], x, y) = 1e8f + 8 * *px(b.feat[1], x, y);
		}
	fit(&a, settings);
	fit(&b, settings);
	for (int c = 0; c < 3; c++)
		assert_true(apart(a.est[c], b.est[c], 0) < 1e-6);
	assert_true(apart(a.columns, b.columns, 0) < 1e-6);
	release(&a);
	release(&b);
}

/* A feature at 1e8 that varies by units is as good as at 0. */
static void test_shifted_feature(void **state)
{
	struct frame a = frame(44, 35, 3, 3, 1), b = frame(44, 35, 3, 3, 1);

	(void)state;
	paint(&a);
	paint(&b);
	for (int y = 0; y < b.h; y++)
		for (int x = 0; x < b.w; x++) {
			*px(a.feat[0], x, y) = (float)(8 * (2 * x + y > 44) + 8 * (x % 5));
			*px(b.feat[0], x, y) = 1e8f + *px(a.feat[0], x, y);
		}
	fit(&a, settings);
	fit(&b, settings);
	for (int c = 0; c < 3; c++)
		assert_true(apart(a.est[c], b.est[c], 0) < 1e-6);
	release(&a);
	release(&b);
}

/* A noisy feature below its own noise is left out. */
static void test_noisy_feature(void **state)
{
	struct frame a = frame(44, 35, 3, 3, 1), b = frame(44, 35, 3, 3, 2);
	struct gd_plane noise[2] = { { 0 }, plane(44, 35) };
	struct gd_apr_in in = { 3, 3, 2, b.y, b.var, b.feat, noise, { 0 } };
	struct gd_apr_out out = { b.est, b.mse, b.order, b.columns };

	(void)state;
	paint(&a);
	paint(&b);
	for (int y = 0; y < b.h; y++)
		for (int x = 0; x < b.w; x++) {
			*px(b.feat[1], x, y) = (float)rnd((uint32_t)(977 * y + x));
			*px(noise[1], x, y) = 0.2f;	/* its variance is 1/12 */
		}
	fit(&a, settings);
	assert_int_equal(gd_apr_fit(&out, &in, &settings, NULL, NULL), GD_OK);
	for (int c = 0; c < 3; c++)
		assert_true(apart(a.est[c], b.est[c], 0) < 1e-6);
	release(&a);
	release(&b);
	free(noise[1].v);
}

static void test_threads(void **state)
{
	static const int threads[] = { 1, 2, 7 };
	struct frame f[3];

	(void)state;
	for (int i = 0; i < 3; i++) {
		f[i] = frame(61, 47, 3, 3, 3);
		paint(&f[i]);
		omp_set_num_threads(threads[i]);
		fit(&f[i], settings);
		for (int c = 0; i > 0 && c < 3; c++)
			for (int y = 0; y < 47; y++) {
				assert_memory_equal(gd_row(f[0].est[c], y), gd_row(f[i].est[c], y),
						    61 * sizeof(float));
				assert_memory_equal(gd_row(f[0].mse[c], y), gd_row(f[i].mse[c], y),
						    61 * sizeof(float));
			}
	}
	for (int i = 0; i < 3; i++)
		release(&f[i]);
}

/* Any finite input: finite output. */
static void test_extremes(void **state)
{
	static const float value[] = { 0, 1e30f, -1e30f, FLT_MAX, 1e-42f, -0.0f };

	(void)state;
	for (size_t i = 0; i < sizeof value / sizeof *value; i++)
		for (int kind = 0; kind < 4; kind++) {
			struct frame f = frame(29, 23, 3, 3, 3);

			paint(&f);
			for (int y = 0; y < f.h; y++)
				for (int x = 0; x < f.w; x++) {
					bool here = kind == 3 || (x == 11 && y == 9);

					if (here && kind != 1)
						*px(f.y[0], x, y) = *px(f.y[2], x, y) = value[i];
					if (here && kind != 2)
						*px(f.feat[1], x, y) = value[i];
					if (here)
						*px(f.var[0], x, y) = fabsf(value[i]);
				}
			fit(&f, settings);
			for (int y = 0; y < f.h; y++)
				for (int x = 0; x < f.w; x++)
					for (int c = 0; c < 3; c++) {
						assert_true(isfinite(*px(f.est[c], x, y)));
						assert_true(isfinite(*px(f.mse[c], x, y)) &&
							    *px(f.mse[c], x, y) >= 0);
					}
			release(&f);
		}
}

/* A denormal frame is the ordinary one, scaled: nothing is compared with a fixed number. */
static void test_tiny_scale(void **state)
{
	struct frame a = frame(31, 29, 3, 3, 2), b = frame(31, 29, 3, 3, 2);

	(void)state;
	paint(&a);
	paint(&b);
	for (int y = 0; y < b.h; y++)
		for (int x = 0; x < b.w; x++)
			for (int c = 0; c < 3; c++) {
				*px(a.y[c], x, y) = (float)(int)(*px(a.y[c], x, y) * 65536) / 65536;
				*px(b.y[c], x, y) = ldexpf(*px(a.y[c], x, y), -60);
				*px(b.var[c], x, y) = ldexpf(*px(a.var[c], x, y), -120);
			}
	fit(&a, settings);
	fit(&b, settings);
	for (int c = 0; c < 3; c++) {
		for (int y = 0; y < b.h; y++)
			for (int x = 0; x < b.w; x++)
				*px(b.est[c], x, y) = ldexpf(*px(b.est[c], x, y), 60);
		assert_true(apart(a.est[c], b.est[c], 0) < 1e-6);
	}
	release(&a);
	release(&b);
}

static void test_centres(void **state)
{
	int at[300];

	(void)state;
	for (int n = 1; n < 200; n++)
		for (int step = 1; step < 60; step++) {
			int count = gd_apr_centres(at, n, step);

			assert_true(count >= 1 && count <= n);
			assert_int_equal(at[0], 0);
			assert_int_equal(at[count - 1], n - 1);
			for (int j = 0; j < count; j++) {
				assert_int_equal(at[j], n - 1 - at[count - 1 - j]);
				if (j > 0)
					assert_true(at[j] > at[j - 1] && at[j] - at[j - 1] <= step);
			}
		}
	assert_int_equal(gd_apr_centres(NULL, 1280, 8), gd_apr_centres(NULL, 1280, 8));
}

static void test_arguments(void **state)
{
	struct frame f = frame(8, 8, 3, 3, 1), g = frame(9, 8, 1, 1, 1);
	struct gd_apr_in in = { 3, 3, 1, f.y, f.var, f.feat, NULL, { 0 } }, bad = in;
	struct gd_apr_out out = { f.est, f.mse, { 0 }, { 0 } };
	struct gd_apr_conf conf = settings;
	struct gd_err err = { 0 };

	(void)state;
	assert_int_equal(gd_apr_fit(&out, &in, &conf, NULL, &err), GD_OK);
	conf.step = 16;
	assert_int_equal(gd_apr_fit(&out, &in, &conf, NULL, &err), GD_EARG);
	assert_string_equal(err.text, "apr: step 16, expected 1 to 15");
	conf = settings;
	conf.order_max = 4;
	assert_int_equal(gd_apr_fit(&out, &in, &conf, NULL, NULL), GD_EARG);
	conf = settings;
	conf.radius = 65;
	assert_int_equal(gd_apr_fit(&out, &in, &conf, NULL, NULL), GD_EARG);
	bad.nvar = 0;
	assert_int_equal(gd_apr_fit(&out, &bad, &settings, NULL, NULL), GD_EARG);
	bad = in;
	bad.feat = g.feat;
	assert_int_equal(gd_apr_fit(&out, &bad, &settings, NULL, NULL), GD_ESHAPE);
	bad = in;
	bad.ny = GD_APR_RHS + 1;
	assert_int_equal(gd_apr_fit(&out, &bad, &settings, NULL, NULL), GD_EARG);
	release(&f);
	release(&g);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_exact),		cmocka_unit_test(test_symmetry),
		cmocka_unit_test(test_layers),		cmocka_unit_test(test_useless_features),
		cmocka_unit_test(test_shifted_feature), cmocka_unit_test(test_noisy_feature),
		cmocka_unit_test(test_threads),		cmocka_unit_test(test_extremes),
		cmocka_unit_test(test_tiny_scale),	cmocka_unit_test(test_centres),
		cmocka_unit_test(test_arguments),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
