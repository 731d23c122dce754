/* SPDX-License-Identifier: BSD-3-Clause */
/* Properties of the sparse linear predictions; numbers are in tests/num. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <omp.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "lwr.h"

#define MAXY 6
#define MAXF 6

struct frame {
	int w, h, ny, nfeat;
	bool twin;
	struct gd_plane y[MAXY], twins[3], feat[MAXF], weight;
	struct gd_plane est[MAXY], mse[3], spread[3], radius, features, centre;
	struct gd_lwr_result result;
};

static struct gd_plane plane(int w, int h)
{
	return gd_plane_of(gd_calloc(gd_stride(w) * (size_t)h, sizeof(float)), w, h);
}

static struct frame frame(int w, int h, int ny, int nfeat)
{
	struct frame f = { .w = w, .h = h, .ny = ny, .nfeat = nfeat, .twin = true,
			   .weight = plane(w, h), .radius = plane(w, h), .features = plane(w, h),
			   .centre = plane(w, h) };

	for (int c = 0; c < MAXY; c++) {
		f.y[c] = plane(w, h);
		f.est[c] = plane(w, h);
	}
	for (int c = 0; c < 3; c++) {
		f.twins[c] = plane(w, h);
		f.mse[c] = plane(w, h);
		f.spread[c] = plane(w, h);
	}
	for (int a = 0; a < MAXF; a++)
		f.feat[a] = plane(w, h);
	return f;
}

static void release(struct frame *f)
{
	for (int c = 0; c < MAXY; c++) {
		free(f->y[c].v);
		free(f->est[c].v);
	}
	for (int c = 0; c < 3; c++) {
		free(f->twins[c].v);
		free(f->mse[c].v);
		free(f->spread[c].v);
	}
	for (int a = 0; a < MAXF; a++)
		free(f->feat[a].v);
	free(f->weight.v);
	free(f->radius.v);
	free(f->features.v);
	free(f->centre.v);
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

/* Two regions, a smooth shade, noise of deviation 0.1; features: region, ramp, a rough one. */
static void paint(struct frame *f)
{
	for (int y = 0; y < f->h; y++)
		for (int x = 0; x < f->w; x++) {
			uint32_t k = (uint32_t)(y * f->w + x) * 16;
			double in = (x - 20) * (x - 20) + (y - 18) * (y - 18) < 130;
			double shade = 1 + 0.02 * x + 0.3 * sin(0.2 * y);

			*px(f->feat[0], x, y) = (float)in;
			*px(f->feat[1], x, y) = (float)(0.01 * x * y);
			*px(f->feat[2], x, y) = (float)rnd(k + 15);
			*px(f->weight, x, y) = (float)(0.5 + 0.4 * cos(0.3 * x));
			for (int c = 0; c < f->ny; c++)
				*px(f->y[c], x, y) = (float)(shade * (1 + in * (c + 1)) +
							     0.35 * rnd(k + (uint32_t)c));
			for (int c = 0; c < 3; c++)
				*px(f->twins[c], x, y) = (float)(shade * (1 + in * (c + 1)) +
								 0.35 * rnd(k + 8 + (uint32_t)c));
		}
}

static int fit(struct frame *f, const struct gd_lwr_conf *conf)
{
	struct gd_lwr_in in = { .ny = f->ny, .nfeat = f->nfeat, .y = f->y, .feat = f->feat,
				.weight = f->weight };
	struct gd_lwr_out out = { .est = f->est, .mse = f->mse, .spread = f->spread,
				  .radius = f->radius, .features = f->features,
				  .centre = f->centre };
	struct gd_err err = { 0 };

	in.twin = f->twin ? f->twins : NULL;
	return gd_lwr_fit(&out, &in, conf, &f->result, NULL, &err);
}

static struct frame fitted(int w, int h, int ny, int nfeat, const struct gd_lwr_conf *conf)
{
	struct frame f = frame(w, h, ny, nfeat);

	paint(&f);
	assert_int_equal(fit(&f, conf), GD_OK);
	return f;
}

static double difference(struct gd_plane a, struct gd_plane b, double scale)
{
	double most = 0;

	for (int y = 0; y < a.h; y++)
		for (int x = 0; x < a.w; x++)
			most = fmax(most, fabs((double)*px(a, x, y) -
					       scale * (double)*px(b, x, y)));
	return most;
}

static const struct gd_lwr_conf *defaults(void)
{
	static struct gd_lwr_conf conf;

	conf = GD_LWR_DEFAULTS;
	return &conf;
}

static void test_arguments(void **state)
{
	struct frame f = frame(20, 10, 3, 3), small = frame(10, 10, 3, 1);
	struct gd_plane broken[3] = { f.twins[0], f.twins[1], small.y[0] };
	struct gd_lwr_in in = { .ny = 3, .nfeat = 3, .y = f.y, .feat = f.feat };
	struct gd_lwr_out out = { .est = f.est };
	struct gd_lwr_conf conf;
	struct gd_err err = { 0 };

	(void)state;
#define REFUSED(change, code, words) \
	do { \
		conf = GD_LWR_DEFAULTS; \
		err = (struct gd_err){ 0 }; \
		change; \
		assert_int_equal(gd_lwr_fit(&out, &in, &conf, NULL, NULL, &err), code); \
		if (!strstr(err.text, words)) \
			fail_msg("\"%s\" does not say \"%s\"", err.text, words); \
	} while (0)
	REFUSED(conf.radius = 0, GD_EARG, "radius 0, expected 1 to 15");
	REFUSED(conf.radius = 16, GD_EARG, "radius 16");
	REFUSED(conf.granularity = 20, GD_EARG, "granularity 20, expected 0 to 19");
	REFUSED(conf.per_column = -1, GD_EARG, "-1 pixels");
	REFUSED(conf.ridge = NAN, GD_EARG, "ridge nan");
	REFUSED(conf.flat = -1, GD_EARG, "flat -1");
	REFUSED(conf.feature_noise = -1, GD_EARG, "feature noise -1");
	REFUSED(in.ny = 0, GD_EARG, "0 planes");
	REFUSED(in.ny = 65, GD_EARG, "65 planes");
	in.ny = 3;
	REFUSED(in.nfeat = 33, GD_EARG, "33 feature planes");
	in.nfeat = 3;
	REFUSED(in.twin = broken, GD_ESHAPE, "twin plane 2 is 10x10, expected 20x10");
	in.twin = NULL;
	REFUSED(in.var = broken, GD_ESHAPE, "variance plane 2");
	in.var = NULL;
	REFUSED(in.weight = small.y[0], GD_ESHAPE, "weight plane 0");
	in.weight.v = NULL;
	REFUSED(out.mse = broken, GD_ESHAPE, "error plane 2");
	out.mse = NULL;
	REFUSED(out.radius = small.y[0], GD_ESHAPE, "radius plane 0");
	out.radius.v = NULL;
	REFUSED(broken[2].v = NULL; in.feat = broken, GD_EARG, "feature plane 2 is missing");
	in.feat = f.feat;
	assert_int_equal(gd_lwr_fit(&out, &in, defaults(), NULL, NULL, NULL), GD_OK);
	release(&f);
	release(&small);
}

/* A whole image that the columns explain comes back, by few models. */
static void test_exact(void **state)
{
	struct frame f = frame(90, 70, 3, 3);
	struct gd_lwr_conf conf = { .radius = 9 };

	(void)state;
	paint(&f);
	f.twin = false;
	for (int y = 0; y < f.h; y++)
		for (int x = 0; x < f.w; x++)
			for (int c = 0; c < 3; c++)
				*px(f.y[c], x, y) = 2 + 0.01f * (float)x - 0.02f * (float)(c * y) +
						    *px(f.feat[0], x, y) +
						    0.5f * *px(f.feat[1], x, y) -
						    *px(f.feat[2], x, y);
	assert_int_equal(fit(&f, &conf), GD_OK);
	for (int c = 0; c < 3; c++)
		assert_true(difference(f.est[c], f.y[c], 1) < 2e-5);
	release(&f);
}

/* A step that no feature explains stays as sharp as it is; away from it windows grow. */
static void test_step(void **state)
{
	struct frame f = frame(96, 48, 3, 0);
	struct gd_lwr_conf conf = { .radius = 9, .dense = true };
	double far = 0, left = 0, right = 0;

	(void)state;
	for (int y = 0; y < f.h; y++)
		for (int x = 0; x < f.w; x++)
			for (int c = 0; c < 3; c++) {
				double v = x < 48 ? 1 : 3;
				uint32_t k = (uint32_t)(y * f.w + x) * 8 + (uint32_t)c;

				*px(f.y[c], x, y) = (float)(v + 0.2 * rnd(k));
				*px(f.twins[c], x, y) = (float)(v + 0.2 * rnd(k + 4));
				*px(f.weight, x, y) = 1;
			}
	assert_int_equal(fit(&f, &conf), GD_OK);
	for (int y = 10; y < 38; y++) {
		far += (double)*px(f.radius, 20, y) / 28;
		left += (double)*px(f.est[0], 47, y) / 28;
		right += (double)*px(f.est[0], 48, y) / 28;
	}
	assert_true(far > 8);
	/* of a window centred beside the step one side is always beyond it */
	assert_true(left < 1.35 && right > 2.65);
	release(&f);
}

/* Bytes do not depend on threads. */
static void test_threads(void **state)
{
	struct gd_lwr_conf conf = GD_LWR_DEFAULTS;
	int most = omp_get_max_threads();

	(void)state;
	for (int dense = 0; dense < 2; dense++) {
		struct frame one, more;

		conf.dense = dense;
		omp_set_num_threads(1);
		one = fitted(150, 140, 3, 3, &conf);
		for (int n = 2; n < 8; n += 5) {
			omp_set_num_threads(n);
			more = fitted(150, 140, 3, 3, &conf);
			for (int c = 0; c < 3; c++)
				for (int y = 0; y < one.h; y++) {
					size_t row = (size_t)one.w * sizeof(float);

					assert_memory_equal(gd_row(one.est[c], y),
							    gd_row(more.est[c], y), row);
					assert_memory_equal(gd_row(one.mse[c], y),
							    gd_row(more.mse[c], y), row);
				}
			release(&more);
		}
		release(&one);
	}
	omp_set_num_threads(most);
}

static void scale_plane(struct gd_plane p, float by, float plus)
{
	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++)
			*px(p, x, y) = *px(p, x, y) * by + plus;
}

static void test_units(void **state)
{
	struct frame a = fitted(70, 60, 3, 3, defaults()), b = frame(70, 60, 3, 3);

	(void)state;
	for (int k = 0; k < 2; k++) {
		float by = k ? 0x1p-40f : 0x1p20f;

		paint(&b);
		for (int c = 0; c < 3; c++) {
			scale_plane(b.y[c], by, 0);
			scale_plane(b.twins[c], by, 0);
		}
		assert_int_equal(fit(&b, defaults()), GD_OK);
		for (int c = 0; c < 3; c++) {
			assert_true(difference(b.est[c], a.est[c], (double)by) < 1e-6 * (double)by);
			assert_true(difference(b.mse[c], a.mse[c], (double)(by * by)) <
				    1e-6 * (double)(by * by));
		}
	}
	paint(&b);
	scale_plane(b.feat[0], 0x1p30f, 0);
	scale_plane(b.feat[1], -0x1p-30f, 0);
	scale_plane(b.feat[2], 4, 64);
	scale_plane(b.weight, 8, 0);
	scale_plane(a.feat[2], 1, 16);	/* the rounding of the shift */
	scale_plane(a.feat[2], 1, -16);
	assert_int_equal(fit(&a, defaults()), GD_OK);
	assert_int_equal(fit(&b, defaults()), GD_OK);
	for (int c = 0; c < 3; c++)
		assert_true(difference(b.est[c], a.est[c], 1) < 1e-5);
	release(&a);
	release(&b);
}

/* Flipped both ways, and with the channels in another order. */
static void test_symmetry(void **state)
{
	struct frame a = fitted(69, 58, 3, 3, defaults()), b = frame(69, 58, 3, 3);
	static const int other[3] = { 2, 0, 1 };
	double worst = 0;

	(void)state;
	for (int y = 0; y < a.h; y++)
		for (int x = 0; x < a.w; x++) {
			int i = a.w - 1 - x, j = a.h - 1 - y;

			for (int c = 0; c < 3; c++) {
				*px(b.y[other[c]], i, j) = *px(a.y[c], x, y);
				*px(b.twins[other[c]], i, j) = *px(a.twins[c], x, y);
				*px(b.feat[c], i, j) = *px(a.feat[c], x, y);
			}
			*px(b.weight, i, j) = *px(a.weight, x, y);
		}
	assert_int_equal(fit(&b, defaults()), GD_OK);
	assert_int_equal(a.result.models, b.result.models);
	for (int y = 0; y < a.h; y++)
		for (int x = 0; x < a.w; x++)
			for (int c = 0; c < 3; c++)
				worst = fmax(worst, fabs((double)*px(a.est[c], x, y) -
							 (double)*px(b.est[other[c]], a.w - 1 - x,
								     a.h - 1 - y)));
	assert_true(worst < 1e-5);
	release(&a);
	release(&b);
}

/* Layers that add up to the colour do so afterwards. */
static void test_layers(void **state)
{
	struct gd_lwr_conf conf = GD_LWR_DEFAULTS;
	struct frame f = frame(70, 60, 5, 3);

	(void)state;
	for (int paper = 0; paper < 2; paper++) {
		paint(&f);
		for (int y = 0; y < f.h; y++)
			for (int x = 0; x < f.w; x++) {
				*px(f.y[3], x, y) = 0.25f * *px(f.y[0], x, y) + (float)(x % 3);
				*px(f.y[4], x, y) = *px(f.y[0], x, y) - *px(f.y[3], x, y);
			}
		conf.paper = paper;
		assert_int_equal(fit(&f, &conf), GD_OK);
		for (int y = 0; y < f.h; y++)
			for (int x = 0; x < f.w; x++)
				assert_true(fabsf(*px(f.est[3], x, y) + *px(f.est[4], x, y) -
						  *px(f.est[0], x, y)) < 1e-5f);
	}
	release(&f);
}

/* A constant feature, and a copy, change nothing but rounding. */
static void test_idle_features(void **state)
{
	struct frame a = fitted(70, 60, 3, 3, defaults()), b = frame(70, 60, 3, 5);

	(void)state;
	paint(&b);
	for (int y = 0; y < b.h; y++)
		for (int x = 0; x < b.w; x++) {
			*px(b.feat[3], x, y) = 7;
			*px(b.feat[4], x, y) = *px(b.feat[1], x, y);
		}
	assert_int_equal(fit(&b, defaults()), GD_OK);
	for (int c = 0; c < 3; c++)
		assert_true(difference(a.est[c], b.est[c], 1) == 0);
	release(&a);
	release(&b);
}

/*
 * A plane under noise: the error falls with the window as the columns over its pixels, or faster,
 * as predictions overlap; few models do; the estimate of the error is of the right size.
 */
static void test_noise(void **state)
{
	double before = INFINITY;

	(void)state;
	for (int r = 2; r <= 8; r *= 2) {
		struct gd_lwr_conf conf = { .radius = r };
		struct frame f = frame(130, 120, 3, 0);
		double error = 0, estimate = 0, sigma2 = 0.01 / 12;

		for (int y = 0; y < f.h; y++)
			for (int x = 0; x < f.w; x++)
				for (int c = 0; c < 3; c++) {
					uint32_t k = (uint32_t)(y * f.w + x) * 8 + (uint32_t)c;
					double v = 1 + 0.01 * x - 0.005 * c * y;

					*px(f.y[c], x, y) = (float)(v + 0.1 * rnd(k));
					*px(f.twins[c], x, y) = (float)(v + 0.1 * rnd(k + 4));
					*px(f.weight, x, y) = 1;
				}
		assert_int_equal(fit(&f, &conf), GD_OK);
		for (int y = 0; y < f.h; y++)
			for (int x = 0; x < f.w; x++)
				for (int c = 0; c < 3; c++) {
					double v = 1 + 0.01 * x - 0.005 * c * y;
					double e = (double)*px(f.est[c], x, y) - v;

					error += e * e / f.w / f.h / 3;
					estimate += (double)*px(f.mse[c], x, y) / f.w / f.h / 3;
				}
		assert_true(error < 3.5 * sigma2 / ((2 * r + 1) * (2 * r + 1)) * 1.7);
		assert_true(error < before / 2);
		/* errors of the windows passed through count, too */
		assert_true(estimate < 0.7 * sigma2 && estimate > error / 2);
		assert_true((double)f.result.models < 0.19 * f.w * f.h);
		before = error;
		release(&f);
	}
}

/* Every pixel of an image is centre of a model if that is asked for; maps are within range. */
static void test_maps(void **state)
{
	struct gd_lwr_conf conf = { .radius = 5, .feature_noise = 1 };

	(void)state;
	for (int dense = 0; dense < 2; dense++) {
		struct frame f;
		size_t centres = 0;

		conf.dense = dense;
		f = fitted(61, 47, 3, 3, &conf);
		for (int y = 0; y < f.h; y++)
			for (int x = 0; x < f.w; x++) {
				float r = *px(f.radius, x, y), n = *px(f.features, x, y);

				centres += *px(f.centre, x, y) == 1;
				assert_true(r >= 0.999f && r < 5.001f && n >= 0 && n < 3.001f);
				for (int c = 0; c < 3; c++)
					assert_true(*px(f.mse[c], x, y) >= 0 &&
						    *px(f.spread[c], x, y) >= 0);
			}
		assert_int_equal(centres, f.result.models);
		assert_true(dense ? centres == 61 * 47 : centres < 61 * 47 / 4);
		assert_true(f.result.mean_radius >= 1 && f.result.mean_radius <= 5);
		release(&f);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_arguments), cmocka_unit_test(test_exact),
		cmocka_unit_test(test_step),	  cmocka_unit_test(test_threads),
		cmocka_unit_test(test_units),	  cmocka_unit_test(test_symmetry),
		cmocka_unit_test(test_layers),	  cmocka_unit_test(test_idle_features),
		cmocka_unit_test(test_noise),	  cmocka_unit_test(test_maps)};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
