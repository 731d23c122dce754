/* SPDX-License-Identifier: BSD-3-Clause */
/* The solver against a direct solution in long double,
 * for every method and for weights of many orders. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <cmocka.h>

#include <omp.h>

#include "../support/poisson_case.h"
#include "../support/poisson_dense.h"

static int ascending(const void *a, const void *b)
{
	const double u = *(const double *)a, v = *(const double *)b;

	return (u > v) - (u < v);
}

/* Weights as poisson.h defines them, without smoothing. */
static void oracle_weights(struct dense *d, const struct problem *p,
			   const struct gd_poisson_conf *conf)
{
	const int n = p->w * p->h;
	double *vx = calloc((size_t)n, sizeof(double)), *vy = calloc((size_t)n, sizeof(double));
	double *all = malloc(2 * (size_t)n * sizeof(double)), phi;
	int count = 0;

	for (int i = 0; i < n; i++) {
		int x = i % p->w, y = i / p->w;

		for (int c = 0; c < 3; c++) {
			vx[i] += (double)gd_row(p->in.dxvar[c], y)[x] / 3;
			vy[i] += (double)gd_row(p->in.dyvar[c], y)[x] / 3;
		}
		if (x + 1 < p->w && vx[i] > 0)
			all[count++] = vx[i];
		if (y + 1 < p->h && vy[i] > 0)
			all[count++] = vy[i];
	}
	qsort(all, (size_t)count, sizeof(double), ascending);
	phi = count ? conf->floor * all[(count - 1) / 2] : 1;
	for (int i = 0; i < n; i++) {
		d->wx[i] = conf->method != GD_WLS ? 1
			   : vx[i] <= 1e12 * phi  ? phi / (vx[i] + phi)
						  : 0;
		d->wy[i] = conf->method != GD_WLS ? 1
			   : vy[i] <= 1e12 * phi  ? phi / (vy[i] + phi)
						  : 0;
		d->a[i] = conf->method == GD_L2 ? conf->alpha * conf->alpha : 0;
		if (i % p->w + 1 == p->w)
			d->wx[i] = 0;
		if (i / p->w + 1 == p->h)
			d->wy[i] = 0;
	}
	free(all);
	free(vx);
	free(vy);
}

static void flatten(double *to, struct gd_plane p)
{
	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++)
			to[y * p.w + x] = (double)gd_row(p, y)[x];
}

/* Largest difference to the oracle over all channels. */
static double compare(struct problem *p, const struct gd_poisson_conf *conf,
		      struct gd_poisson_result *result)
{
	const size_t n = (size_t)p->w * (size_t)p->h;
	struct dense d = dense_new(p->w, p->h);
	double *vx = malloc(n * sizeof(double)), *vy = malloc(n * sizeof(double)),
	       *y = malloc(n * sizeof(double));
	double *f = malloc(n * sizeof(double)), most = 0;
	struct gd_err err = { 0 };

	assert_int_equal(gd_poisson_solve(p->out, &p->in, conf, result, NULL, &err), GD_OK);
	oracle_weights(&d, p, conf);
	for (int c = 0; c < 3; c++) {
		flatten(vx, p->in.dx[c]);
		flatten(vy, p->in.dy[c]);
		flatten(y, p->in.primal[c]);
		assert_int_equal(dense_solve(&d, vx, vy, y, f),
				 conf->method == GD_L2 ? 1 : result->parts);
		for (size_t i = 0; i < n; i++) {
			double e = fabs((double)gd_row(p->out[c], (int)i / p->w)[(int)i % p->w] -
					f[i]);

			if (!(e <= most))
				most = e;
		}
	}
	dense_free(&d);
	free(vx);
	free(vy);
	free(y);
	free(f);
	return most;
}

static const int sizes[][2] = {{1, 1}, {2, 1},	 {1, 7},   {97, 1},  {1, 97},  {2, 2},	{8, 8},
			       {9, 8}, {13, 17}, {31, 37}, {64, 16}, {16, 65}, {53, 47}};

/* The image is of size 1; a float has 6e-8 of that, and the residual is stopped at 1e-6. */
static void test_all_sizes_and_linear_methods(void **state)
{
	(void)state;
	for (size_t i = 0; i < sizeof(sizes) / sizeof(*sizes); i++)
		for (int m = GD_OLS; m <= GD_L2; m++) {
			struct gd_poisson_conf conf = GD_POISSON_DEFAULTS;
			struct gd_poisson_result result;
			struct problem p = problem_new(sizes[i][0], sizes[i][1], 0.1, i + 1);
			double e;

			conf.method = (enum gd_poisson_method)m;
			conf.smooth_px = 0;
			conf.tolerance = 3e-6;
			e = compare(&p, &conf, &result);
			if (!(e < 2e-5))
				fail_msg("%dx%d method %d: %g", p.w, p.h, m, e);
			assert_true(result.converged);
			assert_int_equal(result.parts, 1);
			problem_free(&p);
		}
}

static void spread_variances(struct problem *p, double orders, double floor, uint64_t seed)
{
	struct noise n = { seed };

	(void)floor;
	for (int y = 0; y < p->h; y++)
		for (int x = 0; x < p->w; x++) {
			double vx = pow(10, orders * (uniform(&n) - 0.5)),
			       vy = pow(10, orders * (uniform(&n) - 0.5));

			for (int c = 0; c < 3; c++) {
				gd_row(p->in.dxvar[c], y)[x] = (float)vx;
				gd_row(p->in.dyvar[c], y)[x] = (float)vy;
			}
		}
}

/* Each edge by itself anywhere within 12 orders,
 * inconsistent gradients, exact where the floor lets it. */
static void test_weights_over_orders(void **state)
{
	static const struct { double orders, floor, limit;
	} cases[] = {{4, 1e-6, 1e-4},
		     {8, 1e-6, 1e-4},
		     {12, 1e-6, 1e-4},
		     {24, 1e-6, 1e-3},
		     {24, 0.1, 1e-3}};

	(void)state;
	for (size_t i = 0; i < sizeof(cases) / sizeof(*cases); i++) {
		struct gd_poisson_conf conf = GD_POISSON_DEFAULTS;
		struct gd_poisson_result result;
		struct problem p = problem_new(37, 29, 0.1, 3);
		double e;

		conf.method = GD_WLS;
		conf.smooth_px = 0;
		conf.floor = cases[i].floor;
		conf.tolerance = 1e-12;
		conf.max_iterations = 20000;
		spread_variances(&p, cases[i].orders, conf.floor, 11);
		e = compare(&p, &conf, &result);
		if (!(e < cases[i].limit))
			fail_msg("%g orders: off by %g, residual %g, %d iterations, %d parts",
				 cases[i].orders, e, result.residual, result.iterations,
				 result.parts);
		problem_free(&p);
	}
}

/* Islands that hang on the rest by weights of 1e-9 only: their constants are what is hard. */
static void test_islands(void **state)
{
	struct gd_poisson_conf conf = GD_POISSON_DEFAULTS;
	struct gd_poisson_result result;
	struct problem p = problem_new(41, 43, 0.1, 5);
	double e;

	(void)state;
	for (int c = 0; c < 3; c++)
		for (int y = 0; y < p.h; y++)
			for (int x = 0; x < p.w; x++) {
				gd_row(p.in.dxvar[c], y)[x] = x % 10 == 4 ? 1e6f : 1e-2f;
				gd_row(p.in.dyvar[c], y)[x] = y % 9 == 7 ? 1e6f : 1e-2f;
			}
	conf.method = GD_WLS;
	conf.smooth_px = 0;
	e = compare(&p, &conf, &result);
	assert_true(result.wide);
	assert_true(result.converged);
	if (!(e < 1e-5))
		fail_msg("off by %g", e);
	problem_free(&p);
}

/* Parts without any edge between them: each gets its own mean. */
static void test_disconnected_parts(void **state)
{
	struct gd_poisson_conf conf = GD_POISSON_DEFAULTS;
	struct gd_poisson_result result;
	struct problem p = problem_new(30, 20, 0.1, 6);

	(void)state;
	for (int c = 0; c < 3; c++)
		for (int y = 0; y < p.h; y++)
			for (int x = 0; x < p.w; x++) {
				gd_row(p.in.dxvar[c], y)[x] = x == 11 ? 3e38f : 1;
				gd_row(p.in.dyvar[c], y)[x] = y == 4 && x < 12 ? 3e38f : 1;
			}
	conf.method = GD_WLS;
	conf.smooth_px = 0;
	conf.tolerance = 3e-6;
	assert_true(compare(&p, &conf, &result) < 3e-5);
	assert_int_equal(result.parts, 3);
	assert_int_equal(result.dropped, 20 + 12);
	problem_free(&p);
}

static double objective(const struct problem *p, const struct gd_plane *f, double alpha)
{
	double sum = 0;

	for (int y = 0; y < p->h; y++)
		for (int x = 0; x < p->w; x++) {
			double rx = 0, ry = 0, rp = 0;

			for (int c = 0; c < 3; c++) {
				double v = (double)gd_row(f[c], y)[x];

				rp += pow(alpha * ((double)gd_row(p->in.primal[c], y)[x] - v), 2);
				if (x + 1 < p->w)
					rx += pow((double)gd_row(p->in.dx[c], y)[x] -
							  ((double)gd_row(f[c], y)[x + 1] - v),
						  2);
				if (y + 1 < p->h)
					ry += pow((double)gd_row(p->in.dy[c], y)[x] -
							  ((double)gd_row(f[c], y + 1)[x] - v),
						  2);
			}
			sum += sqrt(rp) + sqrt(rx) + sqrt(ry);
		}
	return sum;
}

/* Many reweightings in long double, with a far smaller regularisation: the least sum there is. */
static double least_objective(struct problem *p, double alpha)
{
	const int n = p->w * p->h;
	struct dense d = dense_new(p->w, p->h);
	double *v[3][3], *f[3];

	for (int c = 0; c < 3; c++) {
		for (int k = 0; k < 3; k++)
			v[c][k] = malloc((size_t)n * sizeof(double));
		flatten(v[c][0], p->in.dx[c]);
		flatten(v[c][1], p->in.dy[c]);
		flatten(v[c][2], p->in.primal[c]);
		f[c] = calloc((size_t)n, sizeof(double));
	}
	for (int it = 0; it < 60; it++) {
		double reg = fmax(0.05 * pow(0.7, it), 1e-6);

		for (int i = 0; i < n; i++) {
			double q[3] = { 0 };

			for (int c = 0; c < 3; c++) {
				q[0] += i % p->w + 1 < p->w
						? pow(v[c][0][i] - (f[c][i + 1] - f[c][i]), 2)
						: 0;
				q[1] += i / p->w + 1 < p->h
						? pow(v[c][1][i] - (f[c][i + p->w] - f[c][i]), 2)
						: 0;
				q[2] += pow(alpha * (v[c][2][i] - f[c][i]), 2);
			}
			d.wx[i] = i % p->w + 1 < p->w ? it ? 1 / (sqrt(q[0]) + reg) : 1 : 0;
			d.wy[i] = i / p->w + 1 < p->h ? it ? 1 / (sqrt(q[1]) + reg) : 1 : 0;
			d.a[i] = alpha * alpha * (it ? 1 / (sqrt(q[2]) + reg) : 1);
		}
		for (int c = 0; c < 3; c++)
			dense_solve(&d, v[c][0], v[c][1], v[c][2], f[c]);
	}
	for (int c = 0; c < 3; c++)
		for (int i = 0; i < n; i++)
			gd_row(p->truth[c], i / p->w)[i % p->w] = (float)f[c][i];
	for (int c = 0; c < 3; c++) {
		for (int k = 0; k < 3; k++)
			free(v[c][k]);
		free(f[c]);
	}
	dense_free(&d);
	return objective(p, p->truth, alpha);
}

/* The regularisation of half a percent of the brightness costs less than half a percent. */
static void test_l1_reaches_the_least_sum(void **state)
{
	struct gd_poisson_conf conf = GD_POISSON_DEFAULTS;
	struct gd_err err = { 0 };
	struct problem p = problem_new(33, 21, 0.1, 8);
	double l1, least;

	(void)state;
	for (int c = 0; c < 3; c++)		/* outliers, which l1 is for */
		for (int i = 0; i < 30; i++)
			gd_row(p.in.dx[c], i % 21)[i * 7 % 32] += 5;
	assert_int_equal(gd_poisson_solve(p.out, &p.in, &conf, NULL, NULL, &err), GD_OK);
	l1 = objective(&p, p.out, conf.alpha);
	least = least_objective(&p, conf.alpha);
	if (!(l1 < 1.005 * least))
		fail_msg("%g, least %g", l1, least);
	problem_free(&p);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_all_sizes_and_linear_methods),
		cmocka_unit_test(test_weights_over_orders),
		cmocka_unit_test(test_islands),
		cmocka_unit_test(test_disconnected_parts),
		cmocka_unit_test(test_l1_reaches_the_least_sum),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
