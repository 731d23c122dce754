/* SPDX-License-Identifier: BSD-3-Clause */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <cmocka.h>

#include <omp.h>

#include "../support/poisson_case.h"

static struct gd_poisson_result solve(struct problem *p, enum gd_poisson_method method,
				      double tolerance)
{
	struct gd_poisson_conf conf = GD_POISSON_DEFAULTS;
	struct gd_poisson_result result;
	struct gd_err err = { 0 };

	conf.method = method;
	conf.tolerance = tolerance;
	if (gd_poisson_solve(p->out, &p->in, &conf, &result, NULL, &err) != GD_OK)
		fail_msg("%s", err.text);
	return result;
}

/* Exact gradients of an image give it back: a manufactured solution for every method. */
static void test_exact_gradients_give_the_image(void **state)
{
	(void)state;
	for (int m = GD_OLS; m <= GD_L1; m++) {
		struct problem p = problem_new(120, 77, 0, 1);

		solve(&p, (enum gd_poisson_method)m, 3e-6);
		for (int c = 0; c < 3; c++)
			assert_true(largest_difference(p.out[c], p.truth[c]) < 3e-5);
		problem_free(&p);
	}
}

static void test_the_mean_is_the_primal_s(void **state)
{
	(void)state;
	for (int m = GD_OLS; m <= GD_L2; m++) {
		struct problem p = problem_new(64, 50, 0.3, 2);

		solve(&p, (enum gd_poisson_method)m, 3e-6);
		for (int c = 0; c < 3; c++)
			assert_true(fabs(mean_of(p.out[c]) - mean_of(p.in.primal[c])) < 1e-5);
		problem_free(&p);
	}
}

static void test_no_primal_means_mean_zero(void **state)
{
	struct problem p = problem_new(40, 30, 0.1, 3);

	(void)state;
	for (int c = 0; c < 3; c++) {
		free(p.in.primal[c].v);
		p.in.primal[c] = (struct gd_plane){ 0 };
	}
	solve(&p, GD_WLS, 1e-5);
	for (int c = 0; c < 3; c++)
		assert_true(fabs(mean_of(p.out[c])) < 1e-6);
	problem_free(&p);
}

static void scale_plane(struct gd_plane p, double k)
{
	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++)
			gd_row(p, y)[x] = (float)((double)gd_row(p, y)[x] * k);
}

static void scale_problem(struct problem *p, double k)
{
	for (int c = 0; c < 3; c++) {
		scale_plane(p->in.primal[c], k);
		scale_plane(p->in.dx[c], k);
		scale_plane(p->in.dy[c], k);
		scale_plane(p->in.dxvar[c], k * k);
		scale_plane(p->in.dyvar[c], k * k);
	}
}

/* A power of two moves exponents only: the result is the same to the last bit, times it. */
static void test_a_scaled_input_gives_the_scaled_output(void **state)
{
	static const double k[] = { 0x1p-20, 0x1p30, 3.7, 1e-12, 1e15 };

	(void)state;
	for (int m = GD_OLS; m <= GD_L1; m++)
		for (size_t i = 0; i < sizeof(k) / sizeof(*k); i++) {
			struct problem p = problem_new(50, 41, 0.2, 4),
				       q = problem_new(50, 41, 0.2, 4);
			const double limit = i < 2 ? 0 : m == GD_L1 ? 1e-3 : 1e-5;

			scale_problem(&q, k[i]);
			solve(&p, (enum gd_poisson_method)m, 1e-5);
			solve(&q, (enum gd_poisson_method)m, 1e-5);
			for (int c = 0; c < 3; c++) {
				scale_plane(p.out[c], k[i]);
				if (!(largest_difference(p.out[c], q.out[c]) <= limit * k[i]))
					fail_msg("method %d, scale %g: %g", m, k[i],
						 largest_difference(p.out[c], q.out[c]) / k[i]);
			}
			problem_free(&p);
			problem_free(&q);
		}
}

/* Sums of inputs give sums of outputs (ols, l2 and wls of equal variances). */
static void test_linearity(void **state)
{
	static const enum gd_poisson_method method[] = { GD_OLS, GD_L2, GD_WLS };

	(void)state;
	for (int m = 0; m < 3; m++) {
		struct problem p = problem_new(60, 40, 0.2, 5), q = problem_new(60, 40, 0.5, 6),
			       s = problem_new(60, 40, 0.2, 5);

		for (int c = 0; c < 3; c++)
			for (int y = 0; y < 40; y++)
				for (int x = 0; x < 60; x++) {
					gd_row(q.in.dxvar[c], y)[x] = gd_row(p.in.dxvar[c], y)[x];
					gd_row(q.in.dyvar[c], y)[x] = gd_row(p.in.dyvar[c], y)[x];
					gd_row(s.in.dx[c], y)[x] += gd_row(q.in.dx[c], y)[x];
					gd_row(s.in.dy[c], y)[x] += gd_row(q.in.dy[c], y)[x];
					gd_row(s.in.primal[c], y)[x] +=
						gd_row(q.in.primal[c], y)[x];
				}
		solve(&p, method[m], 3e-6);
		solve(&q, method[m], 3e-6);
		solve(&s, method[m], 3e-6);
		for (int c = 0; c < 3; c++)
			for (int y = 0; y < 40; y++)
				for (int x = 0; x < 60; x++)
					assert_true(fabs((double)gd_row(p.out[c], y)[x] +
							 (double)gd_row(q.out[c], y)[x] -
							 (double)gd_row(s.out[c], y)[x]) < 1e-4);
		problem_free(&p);
		problem_free(&q);
		problem_free(&s);
	}
}

/* The mirrored problem: x runs backwards, so dx changes its sign and moves by one. */
static void mirror(struct problem *to, const struct problem *p)
{
	const int w = p->w, h = p->h;

	for (int c = 0; c < 3; c++)
		for (int y = 0; y < h; y++)
			for (int x = 0; x < w; x++) {
				gd_row(to->in.primal[c], y)[x] =
					gd_row(p->in.primal[c], y)[w - 1 - x];
				gd_row(to->in.dy[c], y)[x] = gd_row(p->in.dy[c], y)[w - 1 - x];
				gd_row(to->in.dyvar[c], y)[x] =
					gd_row(p->in.dyvar[c], y)[w - 1 - x];
				gd_row(to->in.dx[c], y)[x] =
					x + 1 < w ? -gd_row(p->in.dx[c], y)[w - 2 - x] : 0;
				gd_row(to->in.dxvar[c], y)[x] =
					x + 1 < w ? gd_row(p->in.dxvar[c], y)[w - 2 - x] : 0;
			}
}

static void transpose(struct problem *to, const struct problem *p)
{
	for (int c = 0; c < 3; c++)
		for (int y = 0; y < p->h; y++)
			for (int x = 0; x < p->w; x++) {
				gd_row(to->in.primal[c], x)[y] = gd_row(p->in.primal[c], y)[x];
				gd_row(to->in.dx[c], x)[y] = gd_row(p->in.dy[c], y)[x];
				gd_row(to->in.dy[c], x)[y] = gd_row(p->in.dx[c], y)[x];
				gd_row(to->in.dxvar[c], x)[y] = gd_row(p->in.dyvar[c], y)[x];
				gd_row(to->in.dyvar[c], x)[y] = gd_row(p->in.dxvar[c], y)[x];
			}
}

static void test_symmetries(void **state)
{
	(void)state;
	for (int m = GD_OLS; m <= GD_L1; m++) {
		struct problem p = problem_new(45, 38, 0.2, 7), f = problem_new(45, 38, 0, 1),
			       t = problem_new(38, 45, 0, 1);
		const double limit = m == GD_L1 ? 2e-2 : 5e-5;
		struct problem q = p;

		mirror(&f, &p);
		transpose(&t, &p);
		solve(&p, (enum gd_poisson_method)m, 3e-6);
		solve(&f, (enum gd_poisson_method)m, 3e-6);
		solve(&t, (enum gd_poisson_method)m, 3e-6);
		for (int c = 0; c < 3; c++)
			for (int y = 0; y < 38; y++)
				for (int x = 0; x < 45; x++) {
					double v = (double)gd_row(p.out[c], y)[x];

					assert_true(fabs(v - (double)gd_row(f.out[c], y)[44 - x]) <
						    limit);
					assert_true(fabs(v - (double)gd_row(t.out[c], x)[y]) <
						    limit);
				}
		for (int c = 0; c < 3; c++) {	/* channels in another order */
			q.in.primal[c] = p.in.primal[(c + 1) % 3];
			q.in.dx[c] = p.in.dx[(c + 1) % 3];
			q.in.dy[c] = p.in.dy[(c + 1) % 3];
			q.in.dxvar[c] = p.in.dxvar[(c + 1) % 3];
			q.in.dyvar[c] = p.in.dyvar[(c + 1) % 3];
			q.out[c] = f.out[c];
		}
		solve(&q, (enum gd_poisson_method)m, 3e-6);
		for (int c = 0; c < 3; c++)
			assert_true(largest_difference(q.out[c], p.out[(c + 1) % 3]) < limit);
		problem_free(&p);
		problem_free(&f);
		problem_free(&t);
	}
}

static void test_threads_do_not_change_a_bit(void **state)
{
	static const int threads[3] = { 1, 2, 7 };
	const int before = omp_get_max_threads();

	(void)state;
	for (int m = GD_OLS; m <= GD_L1; m++) {
		struct problem p[3];

		for (int i = 0; i < 3; i++) {
			omp_set_num_threads(threads[i]);
			p[i] = problem_new(211, 163, 0.2, 8);
			solve(&p[i], (enum gd_poisson_method)m, 1e-4);
		}
		for (int i = 1; i < 3; i++)
			for (int c = 0; c < 3; c++)
				assert_true(largest_difference(p[0].out[c], p[i].out[c]) == 0);
		for (int i = 0; i < 3; i++)
			problem_free(&p[i]);
	}
	omp_set_num_threads(before);
}

static void test_wls_beats_ols_on_uneven_noise(void **state)
{
	struct problem p = problem_new(90, 70, 0.02, 9);
	struct noise n = { 10 };
	double ols = 0, wls = 0;

	(void)state;
	for (int c = 0; c < 3; c++)
		for (int y = 20; y < 40; y++)
			for (int x = 30; x < 60; x++) {
				gd_row(p.in.dx[c], y)[x] += (float)(0.5 * normal(&n));
				gd_row(p.in.dxvar[c], y)[x] = 0.25f;
			}
	solve(&p, GD_OLS, 1e-5);
	for (int c = 0; c < 3; c++)
		ols += largest_difference(p.out[c], p.truth[c]);
	solve(&p, GD_WLS, 1e-5);
	for (int c = 0; c < 3; c++)
		wls += largest_difference(p.out[c], p.truth[c]);
	assert_true(wls < 0.5 * ols);
	problem_free(&p);
}

static void test_wrong_calls_are_refused(void **state)
{
	struct problem p = problem_new(20, 20, 0.1, 11);
	struct gd_poisson_conf conf = GD_POISSON_DEFAULTS;
	struct gd_poisson_in in = p.in;
	struct gd_err err = { 0 };

	(void)state;
	conf.tolerance = NAN;
	assert_int_equal(gd_poisson_solve(p.out, &in, &conf, NULL, NULL, &err), GD_EARG);
	conf = (struct gd_poisson_conf)GD_POISSON_DEFAULTS;
	in.primal[1].v = NULL;
	assert_int_equal(gd_poisson_solve(p.out, &in, &conf, NULL, NULL, NULL), GD_EARG);
	in = p.in;
	conf.method = GD_WLS;
	in.dyvar[2].v = NULL;
	assert_int_equal(gd_poisson_solve(p.out, &in, &conf, NULL, NULL, NULL), GD_EARG);
	in = p.in;
	in.dy[0].h--;
	assert_int_equal(gd_poisson_solve(p.out, &in, &conf, NULL, NULL, NULL), GD_ESHAPE);
	problem_free(&p);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_exact_gradients_give_the_image),
		cmocka_unit_test(test_the_mean_is_the_primal_s),
		cmocka_unit_test(test_no_primal_means_mean_zero),
		cmocka_unit_test(test_a_scaled_input_gives_the_scaled_output),
		cmocka_unit_test(test_linearity),
		cmocka_unit_test(test_symmetries),
		cmocka_unit_test(test_threads_do_not_change_a_bit),
		cmocka_unit_test(test_wls_beats_ols_on_uneven_noise),
		cmocka_unit_test(test_wrong_calls_are_refused),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
