/* SPDX-License-Identifier: BSD-3-Clause */
/* relMSE and its kin against closed forms, and the estimate that is free of the reference's noise.
 */
#include <math.h>
#include <omp.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "relmse.h"
#include "select.h"

#define W 37
#define H 23

/* Planes of a comparison, with storage. */
struct fixture {
	struct gd_relmse_in in;
	float *v;
};

static struct gd_plane take(float **v, int w, int h)
{
	struct gd_plane p = gd_plane_of(*v, w, h);

	*v += (size_t)h * gd_stride(w);
	return p;
}

static struct fixture make(int n, int w, int h)
{
	struct fixture f = { .in = { .n = n } };
	float *v;

	f.v = gd_calloc((size_t)h * gd_stride(w) * 17, sizeof(float));
	assert_non_null(f.v);
	v = f.v;
	for (int c = 0; c < n; c++) {
		f.in.x[c] = take(&v, w, h);
		f.in.r[c] = take(&v, w, h);
		f.in.a[c] = take(&v, w, h);
		f.in.b[c] = take(&v, w, h);
	}
	return f;
}

static void fill(struct gd_plane p, float value)
{
	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++)
			gd_row(p, y)[x] = value;
}

static void assert_close(double found, double wanted, double relative)
{
	if (!(fabs(found - wanted) <= relative * fabs(wanted)))
		fail_msg("found %.17g, wanted %.17g", found, wanted);
}

/* A small generator of the test's own: uniform in 0 .. 1, and nearly normal. */
static double uniform(uint64_t *s)
{
	*s = *s * 6364136223846793005u + 1442695040888963407u;
	return (double)(*s >> 33) / 2147483648.0;
}

static double normal(uint64_t *s)
{
	double sum = 0;

	for (int i = 0; i < 12; i++)
		sum += uniform(s);
	return sum - 6;
}

static struct gd_relmse measure(const struct gd_relmse_in *in, enum gd_relmse_form form, double eps,
				double trim)
{
	struct gd_relmse_conf conf = { .eps = eps, .form = form, .trim = trim };
	struct gd_relmse m;
	struct gd_err err = { 0 };

	if (gd_relmse(&m, NULL, in, &conf, &err) != GD_OK)
		fail_msg("%s", err.text);
	return m;
}

/* x = 3, 2, 1 and r = 2, 2, 0.5 in every pixel: all figures by hand. */
static void closed_forms(void **state)
{
	struct fixture f = make(3, W, H);
	const float x[3] = { 3, 2, 1 }, r[3] = { 2, 2, 0.5f };
	double lum = 0.2126 * 2 + 0.7152 * 2 + 0.0722 * 0.5, mean = 1.5, e = 0.01;
	struct gd_relmse m;

	(void)state;
	for (int c = 0; c < 3; c++) {
		fill(f.in.x[c], x[c]);
		fill(f.in.r[c], r[c]);
	}
	m = measure(&f.in, GD_REL_R2_EPS, e, 0.001);
	assert_close(m.relmse, (1 / 4.01 + 0 + 0.25 / 0.26) / 3, 1e-13);
	assert_close(m.channel[0], 1 / 4.01, 1e-13);
	assert_close(m.channel[1], 0, 0);
	assert_close(m.channel[2], 0.25 / 0.26, 1e-13);
	assert_close(m.mse, 1.25 / 3, 1e-13);
	assert_close(m.mae, 0.5, 1e-13);
	assert_close(m.mape, (1 / 2.01 + 0.5 / 0.51) / 3, 1e-13);
	assert_close(m.smape, (1 / 5.01 + 0.5 / 1.51) / 3, 1e-13);
	assert_close(m.mean - m.reference, 0.5, 1e-13);
	assert_close(m.p50, m.relmse, 1e-13);
	assert_close(m.trimmed, m.relmse, 1e-13);
	assert_int_equal(m.pixels, W * H);
	assert_close(measure(&f.in, GD_REL_R_EPS_2, e, 0).relmse,
		     (1 / (2.01 * 2.01) + 0.25 / (0.51 * 0.51)) / 3, 1e-13);
	assert_close(measure(&f.in, GD_REL_LUM, e, 0).relmse, 1.25 / 3 / (lum * lum + e), 1e-13);
	assert_close(measure(&f.in, GD_REL_MEAN, e, 0).relmse, 1.25 / 3 / (mean * mean + e), 1e-13);
	assert_close(measure(&f.in, GD_REL_HALF, e, 0).relmse, m.relmse / 2, 1e-13);
	assert_close(measure(&f.in, GD_REL_R2_EPS, 1, 0).relmse, (1 / 5.0 + 0.25 / 1.25) / 3,
		     1e-13);
	free(f.v);
}

/* Pixel i has e = i: percentiles, maximum and trimmed mean are those of 0 .. n - 1. */
static void order_statistics(void **state)
{
	struct fixture f = make(1, 40, 25);
	struct gd_relmse m;

	(void)state;
	for (int i = 0; i < 1000; i++)
		gd_row(f.in.x[0], i * 7 % 1000 / 40)[i * 7 % 1000 % 40] = (float)sqrt((double)i);
	m = measure(&f.in, GD_REL_R2_EPS, 1, 0.01);
	assert_close(m.p50, 499, 1e-6);
	assert_close(m.p95, 949, 1e-6);
	assert_close(m.p99, 989, 1e-6);
	assert_close(m.max, 999, 1e-6);
	assert_int_equal(m.ntrimmed, 10);
	assert_close(m.trimmed, 989.0 / 2, 1e-6);
	assert_close(m.relmse, 999.0 / 2, 1e-6);
	free(f.v);
}

static void selects(void **state)
{
	uint64_t s = 5;

	(void)state;
	for (int round = 0; round < 200; round++) {
		double v[101];
		size_t n = 1 + (size_t)(uniform(&s) * 100), k = (size_t)(uniform(&s) * (double)n),
		       below = 0, equal = 0;
		double found;

		for (size_t i = 0; i < n; i++)
			v[i] = floor(uniform(&s) * (round % 2 ? 5 : 1000));
		found = gd_select(v, 0, n, k);
		for (size_t i = 0; i < n; i++) {
			below += v[i] < found;
			equal += v[i] == found;
			if (i < k)
				assert_true(v[i] <= found);
			if (i > k)
				assert_true(v[i] >= found);
		}
		assert_true(below <= k && k < below + equal);
	}
}

/* Moving pixels about and swapping channels changes nothing but rounding. */
static void permutation(void **state)
{
	struct fixture f = make(3, W, H), g = make(3, W, H);
	struct gd_relmse m, p;
	uint64_t s = 1;

	(void)state;
	for (int c = 0; c < 3; c++)
		for (int i = 0; i < W * H; i++) {
			int k = i * 11 % (W * H);	/* 11 and 851 have no common factor */
			float x = (float)uniform(&s), r = (float)uniform(&s);

			gd_row(f.in.x[c], i / W)[i % W] = x;
			gd_row(f.in.r[c], i / W)[i % W] = r;
			gd_row(g.in.x[2 - c], k / W)[k % W] = x;
			gd_row(g.in.r[2 - c], k / W)[k % W] = r;
		}
	m = measure(&f.in, GD_REL_R2_EPS, 0.01, 0.02);
	p = measure(&g.in, GD_REL_R2_EPS, 0.01, 0.02);
	assert_close(p.relmse, m.relmse, 1e-12);
	assert_close(p.trimmed, m.trimmed, 1e-12);
	assert_close(p.p95, m.p95, 1e-12);
	assert_close(p.smape, m.smape, 1e-12);
	assert_close(p.channel[0], m.channel[2], 1e-12);
	free(f.v);
	free(g.v);
}

/*
 * Truth 1 everywhere, image 1.1, halves of standard deviation 0.3. Against their mean the squared
 * error is 0.01 + 0.045; without its noise 0.01. (x - a)(x - b) has variance 2 0.01 0.09 + 0.09^2 =
 * 0.0099, so over 3 x 256 x 256 values its mean has a standard deviation of 2.2e-4.
 */
static void free_of_noise(void **state)
{
	struct fixture f = make(3, 256, 256);
	uint64_t s = 42;
	struct gd_relmse m;

	(void)state;
	for (int c = 0; c < 3; c++) {
		fill(f.in.x[c], 1.1f);
		for (int y = 0; y < 256; y++)
			for (int x = 0; x < 256; x++) {
				float a = (float)(1 + 0.3 * normal(&s)),
				      b = (float)(1 + 0.3 * normal(&s));

				gd_row(f.in.a[c], y)[x] = a;
				gd_row(f.in.b[c], y)[x] = b;
				gd_row(f.in.r[c], y)[x] = (a + b) / 2;
			}
	}
	m = measure(&f.in, GD_REL_R2_EPS, 1e6, 0);
	assert_close(m.mse, 0.055, 0.02);
	f.in.halves = true;
	m = measure(&f.in, GD_REL_R2_EPS, 1e6, 0);
	assert_true(fabs(m.mse - 0.01) < 4 * 2.2e-4);
	assert_close(m.relmse * 1e6, m.mse, 1e-4);
	free(f.v);
}

/* Equal halves are a plain reference. */
static void equal_halves(void **state)
{
	struct fixture f = make(2, W, H);
	struct gd_relmse m, p;
	uint64_t s = 3;

	(void)state;
	for (int c = 0; c < 2; c++)
		for (int i = 0; i < W * H; i++) {
			float r = (float)uniform(&s);

			gd_row(f.in.x[c], i / W)[i % W] = (float)uniform(&s);
			gd_row(f.in.r[c], i / W)[i % W] = r;
			gd_row(f.in.a[c], i / W)[i % W] = r;
			gd_row(f.in.b[c], i / W)[i % W] = r;
		}
	m = measure(&f.in, GD_REL_R2_EPS, 0.01, 0.001);
	f.in.halves = true;
	p = measure(&f.in, GD_REL_R2_EPS, 0.01, 0.001);
	assert_memory_equal(&m, &p, sizeof(m));
	free(f.v);
}

static void not_finite(void **state)
{
	struct fixture f = make(3, 10, 10);
	double e[100];
	struct gd_relmse_conf conf = GD_RELMSE_DEFAULTS;
	struct gd_relmse m;
	struct gd_err err = { 0 };

	(void)state;
	for (int c = 0; c < 3; c++) {
		fill(f.in.x[c], 1);
		fill(f.in.r[c], 1);
	}
	gd_row(f.in.x[1], 2)[3] = NAN;
	gd_row(f.in.x[2], 4)[4] = INFINITY;
	gd_row(f.in.x[0], 4)[4] = -INFINITY;
	gd_row(f.in.r[0], 9)[9] = NAN;
	assert_int_equal(gd_relmse(&m, e, &f.in, &conf, &err), GD_OK);
	assert_int_equal(m.nonfinite, 2);
	assert_int_equal(m.nonfinite_reference, 1);
	assert_int_equal(m.pixels, 99);
	assert_close(m.relmse, 3 / 1.01 / (3 * 99), 1e-12);
	assert_close(e[23], 1 / 1.01 / 3, 1e-12);
	assert_true(isnan(e[99]));
	fill(f.in.r[2], INFINITY);
	assert_int_equal(gd_relmse(&m, NULL, &f.in, &conf, &err), GD_ENUMERIC);
	free(f.v);
}

/* A firefly's square does not fit a float. */
static void fireflies(void **state)
{
	struct fixture f = make(3, 8, 8);
	struct gd_relmse m;

	(void)state;
	gd_row(f.in.x[0], 0)[0] = 1e30f;
	m = measure(&f.in, GD_REL_R2_EPS, 0.01, 0.02);
	assert_close(m.relmse, (double)1e30f * (double)1e30f / 0.01 / 192, 1e-12);
	assert_close(m.trimmed, 0, 0);
	free(f.v);
}

static void masks(void **state)
{
	struct fixture f = make(1, W, H), k = make(1, W, H);

	(void)state;
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++) {
			gd_row(f.in.x[0], y)[x] = x < 10 ? 2 : 100;
			gd_row(k.in.x[0], y)[x] = x < 10 ? 0.5f : x < 20 ? 0.49f : NAN;
		}
	f.in.mask = k.in.x[0];
	assert_close(measure(&f.in, GD_REL_R2_EPS, 1, 0).relmse, 4, 1e-13);
	assert_int_equal(measure(&f.in, GD_REL_R2_EPS, 1, 0).pixels, 10 * H);
	free(f.v);
	free(k.v);
}

static void any_number_of_threads(void **state)
{
	struct fixture f = make(3, 61, 67);
	struct gd_relmse m[3];
	const int threads[3] = { 1, 2, 7 };
	uint64_t s = 9;

	(void)state;
	for (int c = 0; c < 3; c++)
		for (int i = 0; i < 61 * 67; i++) {
			gd_row(f.in.x[c], i / 61)[i % 61] = (float)exp(9 * normal(&s));
			gd_row(f.in.r[c], i / 61)[i % 61] = (float)exp(9 * normal(&s));
		}
	for (int i = 0; i < 3; i++) {
		omp_set_num_threads(threads[i]);
		m[i] = measure(&f.in, GD_REL_R2_EPS, 0.01, 0.001);
	}
	assert_memory_equal(&m[0], &m[1], sizeof(m[0]));
	assert_memory_equal(&m[0], &m[2], sizeof(m[0]));
	free(f.v);
}

static void refusals(void **state)
{
	struct fixture f = make(1, 4, 4);
	struct gd_relmse_conf conf = GD_RELMSE_DEFAULTS;
	struct gd_relmse m;
	struct gd_err err = { 0 };

	(void)state;
	conf.eps = 0;
	assert_int_equal(gd_relmse(&m, NULL, &f.in, &conf, &err), GD_EARG);
	conf.eps = 0.01;
	conf.trim = 0.6;
	assert_int_equal(gd_relmse(&m, NULL, &f.in, &conf, NULL), GD_EARG);
	conf.trim = 0;
	f.in.r[0].w = 3;
	assert_int_equal(gd_relmse(&m, NULL, &f.in, &conf, NULL), GD_ESHAPE);
	f.in.n = 0;
	assert_int_equal(gd_relmse(&m, NULL, &f.in, &conf, NULL), GD_ESHAPE);
	free(f.v);
}

static void maps(void **state)
{
	struct fixture f = make(2, 3, 1);
	struct gd_relmse_conf conf = { .eps = 1 };
	struct gd_err err = { 0 };

	(void)state;
	f.in.halves = true;
	f.in.x[0].v[0] = 3; /* against 1 and 3: (3 - 2)^2 / (2^2 + 1), and 0 in the other channel */
	f.in.a[0].v[0] = 1;
	f.in.b[0].v[0] = 3;
	f.in.x[1].v[1] = NAN;
	f.in.a[1].v[2] = INFINITY;
	assert_int_equal(gd_relmse_map(f.in.r[0], &f.in, &conf, &err), GD_OK);
	assert_close(f.in.r[0].v[0], sqrt(0.1), 1e-6);
	assert_true(isnan(f.in.r[0].v[1]) && isnan(f.in.r[0].v[2]));
	f.in.r[0].w = 2;
	assert_int_equal(gd_relmse_map(f.in.r[0], &f.in, &conf, &err), GD_ESHAPE);
	free(f.v);
}

/* Blocks of 8 x 8 with errors 1, 2, .. in some order; the last ones are partial. */
static void ranks(void **state)
{
	struct fixture f = make(1, W, H), g = make(1, W, H);
	struct gd_plane est = g.in.x[0];
	struct gd_relmse_rank r;
	struct gd_err err = { 0 };

	(void)state;
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++) {
			int block = y / 8 * 5 + x / 8;

			gd_row(f.in.x[0], y)[x] = (float)((block * 7) % 15 + 1);
			gd_row(est, y)[x] = (float)exp((block * 7) % 15); /* any rising function */
		}
	assert_int_equal(gd_relmse_rank(&r, &f.in, &est, 8, &err), GD_OK);
	assert_int_equal(r.blocks, 15);
	assert_close(r.rho, 1, 1e-12);
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++)
			gd_row(est, y)[x] = -gd_row(f.in.x[0], y)[x];
	assert_int_equal(gd_relmse_rank(&r, &f.in, &est, 8, &err), GD_OK);
	assert_close(r.rho, -1, 1e-12);
	fill(est, 4);
	assert_int_equal(gd_relmse_rank(&r, &f.in, &est, 8, &err), GD_OK);
	assert_true(isnan(r.rho));
	free(f.v);
	free(g.v);
}

/* Ties: values 1 2 2 3 against 1 3 2 4 have ranks 1 2.5 2.5 4 and 1 3 2 4: rho = 4.5 / sqrt(4.5 *
 * 5). */
static void tied_ranks(void **state)
{
	struct fixture f = make(1, 4, 1), g = make(1, 4, 1);
	const float truth[4] = { 1, 2, 2, 3 }, guess[4] = { 1, 3, 2, 4 };
	struct gd_relmse_rank r;
	struct gd_err err = { 0 };

	(void)state;
	memcpy(f.in.x[0].v, truth, sizeof(truth));
	memcpy(g.in.x[0].v, guess, sizeof(guess));
	assert_int_equal(gd_relmse_rank(&r, &f.in, &g.in.x[0], 1, &err), GD_OK);
	assert_close(r.rho, 4.5 / sqrt(4.5 * 5), 1e-12);
	assert_close(r.ratio, 10.0 / 18, 1e-12);
	free(f.v);
	free(g.v);
}

static void names(void **state)
{
	(void)state;
	for (int i = 0; i < GD_REL_FORMS; i++) {
		enum gd_relmse_form form = GD_REL_FORMS;

		assert_true(
			gd_relmse_form_find(gd_relmse_form_name((enum gd_relmse_form)i), &form));
		assert_int_equal(form, i);
		assert_non_null(strstr(gd_relmse_formula(form, true), "(x - a)(x - b)"));
	}
	assert_false(gd_relmse_form_find("r2", &(enum gd_relmse_form){ 0 }));
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(closed_forms),	 cmocka_unit_test(order_statistics),
		cmocka_unit_test(selects),	 cmocka_unit_test(permutation),
		cmocka_unit_test(free_of_noise), cmocka_unit_test(equal_halves),
		cmocka_unit_test(not_finite),	 cmocka_unit_test(fireflies),
		cmocka_unit_test(masks),	 cmocka_unit_test(any_number_of_threads),
		cmocka_unit_test(maps),		 cmocka_unit_test(refusals),
		cmocka_unit_test(ranks),	 cmocka_unit_test(tied_ranks),
		cmocka_unit_test(names),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
