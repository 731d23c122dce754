/* SPDX-License-Identifier: BSD-3-Clause */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <omp.h>
#include <stdlib.h>
#include <string.h>

#include "multigrid.h"

/* Weights: 0 all 1; 1 random over two orders; 2 a chequerboard of blocks that jump by 100. */
static struct gd_mg *make(int w, int h, int kind, double a)
{
	struct gd_err err = { 0 };
	struct gd_mg *mg;
	const struct gd_mg_level *l;

	assert_int_equal(gd_mg_new(&mg, w, h, 1, true, a > 0, &err), GD_OK);
	l = gd_mg_grid(mg);
	srand48(3);
	for (int y = 0; y < h; y++)
		for (int x = 0; x < w; x++) {
			const size_t i = (size_t)y * l->stride + (size_t)x;
			double e = 1, s = 1;

			if (kind == 1) {
				e = pow(10, 2 * drand48());
				s = pow(10, 2 * drand48());
			} else if (kind == 2) {
				e = s = (x / 7 + y / 5) % 2 ? 100 : 1;
			}
			((double *)l->e)[i] = x + 1 < w ? e : 0;
			((double *)l->s)[i] = y + 1 < h ? s : 0;
			if (a > 0)
				((double *)l->a)[i] = a;
		}
	gd_mg_setup(mg);
	return mg;
}

static void fill(struct gd_mg *mg, long seed, bool mean_free)
{
	const struct gd_mg_level *l = gd_mg_grid(mg);
	double mean = 0;

	srand48(seed);
	for (int y = 0; y < l->h; y++)
		for (int x = 0; x < l->w; x++)
			mean += ((double *)l->r)[(size_t)y * l->stride + (size_t)x] =
				drand48() - 0.5;
	mean /= (double)l->w * l->h;
	for (int y = 0; y < l->h && mean_free; y++)
		for (int x = 0; x < l->w; x++)
			((double *)l->r)[(size_t)y * l->stride + (size_t)x] -= mean;
}

static double product(const struct gd_mg_level *l, const double *u, const double *v)
{
	double s = 0;

	for (int y = 0; y < l->h; y++)
		for (int x = 0; x < l->w; x++)
			s += u[(size_t)y * l->stride + (size_t)x] *
			     v[(size_t)y * l->stride + (size_t)x];
	return s;
}

static double *copy(const struct gd_mg_level *l, const double *v)
{
	double *u = calloc(l->plane, sizeof(double));

	for (int y = 0; y < l->h; y++)
		memcpy(u + (size_t)y * l->stride, v + (size_t)y * l->stride,
		       (size_t)l->w * sizeof(double));
	return u;
}

/* u'Mv = v'Mu and u'Mu > 0: what conjugate gradients need of a preconditioner. */
static void test_the_cycle_is_symmetric_and_positive(void **state)
{
	static const int size[][2] = { { 40, 40 }, { 41, 37 }, { 130, 3 }, { 1, 200 }, { 64, 33 } };

	(void)state;
	for (int kind = 0; kind < 3; kind++)
		for (int i = 0; i < 5; i++) {
			struct gd_mg *mg = make(size[i][0], size[i][1], kind, 0.01);
			const struct gd_mg_level *l = gd_mg_grid(mg);
			double *u, *v, *mu, *mv;

			fill(mg, 1, false);
			u = copy(l, l->r);
			gd_mg_cycle(mg);
			mu = copy(l, l->z);
			fill(mg, 2, false);
			v = copy(l, l->r);
			gd_mg_cycle(mg);
			mv = copy(l, l->z);
			assert_true(product(l, u, mu) > 0 && product(l, v, mv) > 0);
			assert_true(fabs(product(l, u, mv) - product(l, v, mu)) <
				    1e-9 * sqrt(product(l, u, mu) * product(l, v, mv)));
			free(u);
			free(v);
			free(mu);
			free(mv);
			gd_mg_free(mg);
		}
}

/* Iterations to 1e-8 hardly depend on the size, whatever the weights. */
static void test_iterations_do_not_grow(void **state)
{
	static const int limit[3] = { 10, 20, 25 };

	(void)state;
	for (int kind = 0; kind < 3; kind++)
		for (int side = 24; side <= 400; side *= 4) {
			struct gd_mg *mg = make(side, side - 3, kind, 0);
			struct gd_mg_result done;

			fill(mg, 5, true);
			done = gd_mg_solve(mg, 1e-8, 100);
			if (done.iterations > limit[kind] || done.residual > 1e-8)
				fail_msg("kind %d, side %d: %d iterations, %g", kind, side,
					 done.iterations, done.residual);
			gd_mg_free(mg);
		}
}

/* On constant weights one cycle as a method of its own shrinks the error at least fivefold. */
static void test_a_cycle_reduces_the_residual(void **state)
{
	struct gd_mg *mg = make(128, 128, 0, 0.001);
	struct gd_mg_result one, two;

	(void)state;
	fill(mg, 6, true);
	one = gd_mg_solve(mg, 1e-12, 1);
	gd_mg_free(mg);
	mg = make(128, 128, 0, 0.001);
	fill(mg, 6, true);
	two = gd_mg_solve(mg, 1e-12, 2);
	assert_true(one.residual < 0.2);
	assert_true(two.residual < 0.04);
	gd_mg_free(mg);
}

static void test_threads_do_not_change_a_bit(void **state)
{
	static const int threads[3] = { 1, 2, 7 };
	const int before = omp_get_max_threads();
	double *first = NULL;

	(void)state;
	for (int i = 0; i < 3; i++) {
		struct gd_mg *mg;
		double *x;

		omp_set_num_threads(threads[i]);
		mg = make(301, 211, 1, 0);
		fill(mg, 7, true);
		gd_mg_solve(mg, 1e-6, 100);
		x = copy(gd_mg_grid(mg), gd_mg_x(mg));
		if (!first)
			first = x;
		else
			assert_memory_equal(first, x, gd_mg_grid(mg)->plane * sizeof(double));
		if (x != first)
			free(x);
		gd_mg_free(mg);
	}
	free(first);
	omp_set_num_threads(before);
}

static void test_zero_stays_zero(void **state)
{
	struct gd_mg *mg = make(50, 40, 1, 0);
	struct gd_mg_result done = gd_mg_solve(mg, 1e-8, 100);
	const struct gd_mg_level *l = gd_mg_grid(mg);

	(void)state;
	assert_int_equal(done.iterations, 0);
	assert_true(product(l, gd_mg_x(mg), gd_mg_x(mg)) == 0);
	gd_mg_free(mg);
	gd_mg_free(NULL);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_cycle_is_symmetric_and_positive),
		cmocka_unit_test(test_iterations_do_not_grow),
		cmocka_unit_test(test_a_cycle_reduces_the_residual),
		cmocka_unit_test(test_threads_do_not_change_a_bit),
		cmocka_unit_test(test_zero_stays_zero),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
