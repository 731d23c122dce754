/* SPDX-License-Identifier: BSD-3-Clause */
/* Solutions over pairs of pixels against dense normal equations in long double. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "../support/pairs_case.h"

/* A x = b for symmetric positive definite A, by Cholesky; both are used up. */
static void dense_solve(long double *a, long double *b, int n)
{
	for (int j = 0; j < n; j++) {
		for (int k = 0; k < j; k++)
			a[j * n + j] -= a[j * n + k] * a[j * n + k];
		a[j * n + j] = sqrtl(a[j * n + j]);
		for (int i = j + 1; i < n; i++) {
			for (int k = 0; k < j; k++)
				a[i * n + j] -= a[i * n + k] * a[j * n + k];
			a[i * n + j] /= a[j * n + j];
		}
	}
	for (int i = 0; i < n; i++) {
		for (int k = 0; k < i; k++)
			b[i] -= a[i * n + k] * b[k];
		b[i] /= a[i * n + i];
	}
	for (int i = n - 1; i >= 0; i--) {
		for (int k = i + 1; k < n; k++)
			b[i] -= a[k * n + i] * b[k];
		b[i] /= a[i * n + i];
	}
}

/* The weight of a row of the system: that of pair k at
 * pixel i, or of the colour there (k = GD_PAIRS). */
typedef double weight_of(const struct paired *p, int k, int i, void *user);

static long double *dense(const struct paired *p, int c, weight_of *weight, void *user)
{
	const int n = p->w * p->h;
	long double *a = calloc((size_t)n * (size_t)n, sizeof(*a)),
		    *b = calloc((size_t)n, sizeof(*b));

	for (int i = 0; i < n; i++) {
		const int x = i % p->w, y = i / p->w;
		const long double s = weight(p, GD_PAIRS, i, user);

		a[i * n + i] += s;
		b[i] += s * gd_row(p->in.primal[c], y)[x];
		for (int k = 0; k < GD_PAIRS; k++) {
			const int dx = p->pairs.dx[k][i], dy = p->pairs.dy[k][i];
			const int j = i + dy * p->w + dx;
			const long double w = weight(p, k, i, user),
					  v = gd_row(p->in.value[k][c], y)[x];

			if (!(w > 0) || j == i)
				continue;
			a[i * n + i] += w;
			a[j * n + j] += w;
			a[i * n + j] -= w;
			a[j * n + i] -= w;
			b[i] -= w * v;
			b[j] += w * v;
		}
	}
	dense_solve(a, b, n);
	free(a);
	return b;
}

static void same(const struct paired *p, int c, const long double *want, double tolerance)
{
	for (int i = 0; i < p->w * p->h; i++) {
		const double got = (double)gd_row(p->out[c], i / p->w)[i % p->w];

		if (!(fabs(got - (double)want[i]) <= tolerance))
			fail_msg("pixel %d,%d of channel %d: %.9g, expected %.9g", i % p->w,
				 i / p->w, c, got, (double)want[i]);
	}
}

static double even(const struct paired *p, int k, int i, void *user)
{
	const double alpha = *(double *)user;

	if (k == GD_PAIRS)
		return alpha * alpha;
	for (int c = 0; c < 3; c++)
		if (!isfinite(gd_row(p->in.value[k][c], i / p->w)[i % p->w]))
			return 0;
	return 1;
}

static void test_l2(void **state)
{
	static const int size[][2] = {
		{ 13, 11 }, { 1, 1 }, { 17, 1 }, { 1, 9 }, { 5, 3 }, { 2, 2 }
	};
	double alphas[] = { 0.2, 0.003, 30 };

	(void)state;
	for (size_t s = 0; s < sizeof(size) / sizeof(size[0]); s++)
		for (int a = 0; a < 3; a++) {
			struct paired p = paired_new(size[s][0], size[s][1], a == 1 ? 0.8 : 0, 0.3,
						     10 * s + (size_t)a);
			const struct gd_poisson_result r = paired_solve(&p, GD_L2, alphas[a], 1e-9);

			assert_true(r.converged);
			for (int c = 0; c < 3; c++) {
				long double *want = dense(&p, c, even, &alphas[a]);

				same(&p, c, want, 2e-6);
				free(want);
			}
			paired_free(&p);
		}
}

static void test_default_tolerance(void **state)
{
	double alpha = 0.2;
	struct paired p = paired_new(23, 19, 0, 0.3, 5);

	(void)state;
	paired_solve(&p, GD_L2, alpha, 1e-4);
	for (int c = 0; c < 3; c++) {
		long double *want = dense(&p, c, even, &alpha);

		same(&p, c, want, 3e-4);
		free(want);
	}
	paired_free(&p);
}

static void test_pairs_without_a_number_weigh_nothing(void **state)
{
	double alpha = 0.2;
	struct paired p = paired_new(13, 11, 0, 0.3, 6);
	struct noise n = { 9 };
	size_t dropped = 0;

	(void)state;
	for (int i = 0; i < 13 * 11; i++)
		for (int k = 0; k < GD_PAIRS; k++)
			if ((p.pairs.dx[k][i] || p.pairs.dy[k][i]) && uniform(&n) < 0.3) {
				gd_row(p.in.value[k][i % 3], i / 13)[i % 13] =
					i % 2 ? NAN : -INFINITY;
				dropped++;
			}
	assert_int_equal(paired_solve(&p, GD_L2, alpha, 1e-9).dropped, dropped);
	for (int c = 0; c < 3; c++) {
		long double *want = dense(&p, c, even, &alpha);

		same(&p, c, want, 2e-6);
		free(want);
	}
	paired_free(&p);
}

struct weights {
	double *w;	/* of GD_PAIRS + 1 rows a pixel */
	double alpha;
};

static double stored(const struct paired *p, int k, int i, void *user)
{
	(void)p;
	return ((struct weights *)user)->w[i * (GD_PAIRS + 1) + k];
}

/* Norm over the channels of a row's residual. */
static double norm_of(const struct paired *p, long double *const f[3], int k, int i, double alpha)
{
	const int j = k < GD_PAIRS ? i + p->pairs.dy[k][i] * p->w + p->pairs.dx[k][i] : i;
	double s = 0;

	for (int c = 0; c < 3; c++) {
		const struct gd_plane v = k < GD_PAIRS ? p->in.value[k][c] : p->in.primal[c];
		const double want = (double)gd_row(v, i / p->w)[i % p->w];
		const double e = k < GD_PAIRS ? want - (double)(f[c][j] - f[c][i])
					      : alpha * (want - (double)f[c][i]);

		s += e * e;
	}
	return sqrt(s);
}

/* The same reweighting with exact solutions. The library solves each system to 0.1. */
static void test_l1_against_exact_reweighting(void **state)
{
	struct paired p = paired_new(15, 12, 0, 0.1, 8);
	const int n = p.w * p.h;
	struct weights w = { calloc((size_t)n * (GD_PAIRS + 1), sizeof(double)), 0.2 };
	long double *f[3] = { NULL };
	double level = 0, ours = 0, exact = 0;

	(void)state;
	for (int i = 0; i < n; i += 7)	/* outliers */
		gd_row(p.in.value[i % 2][1], i / p.w)[i % p.w] += 20;
	for (int c = 0; c < 3; c++)
		level += mean_of(p.in.primal[c]) / 3;
	for (int pass = 0; pass < 20; pass++) {
		const double reg = level * fmax(0.05 * pow(0.5, pass - 1), 5e-3);

		for (int i = 0; i < n; i++)
			for (int k = 0; k <= GD_PAIRS; k++) {
				const double square = k < GD_PAIRS ? 1 : w.alpha * w.alpha;
				const double e = pass ? norm_of(&p, f, k, i, w.alpha) + reg : 1;
				const bool none = k < GD_PAIRS && !p.pairs.dx[k][i] &&
						  !p.pairs.dy[k][i];

				w.w[i * (GD_PAIRS + 1) + k] = none ? 0 : square / e;
			}
		for (int c = 0; c < 3; c++) {
			free(f[c]);
			f[c] = NULL;
		}
		for (int c = 0; c < 3; c++)
			f[c] = dense(&p, c, stored, &w);
	}
	assert_true(paired_solve(&p, GD_L1, 0.2, 1e-4).converged);
	for (int i = 0; i < n; i++)
		for (int k = 0; k <= GD_PAIRS; k++)
			exact += norm_of(&p, f, k, i, w.alpha);
	for (int c = 0; c < 3; c++) {
		double off = 0;

		for (int i = 0; i < n; i++)
			off += fabs((double)(f[c][i] - gd_row(p.out[c], i / p.w)[i % p.w])) / n;
		assert_true(off < 0.005);
	}
	for (int c = 0; c < 3; c++)
		for (int i = 0; i < n; i++)
			f[c][i] = (long double)gd_row(p.out[c], i / p.w)[i % p.w];
	for (int i = 0; i < n; i++)
		for (int k = 0; k <= GD_PAIRS; k++)
			ours += norm_of(&p, f, k, i, w.alpha);
	assert_true(fabs(ours / exact - 1) < 0.005);
	for (int c = 0; c < 3; c++)
		free(f[c]);
	free(w.w);
	paired_free(&p);
}

/* Pairs that are the neighbours right and below: the same problem as that of gd_poisson_solve(). */
static void test_grid_is_the_poisson_problem(void **state)
{
	struct problem g = problem_new(61, 43, 0.2, 3);
	struct paired p = { .w = 61, .h = 43 };

	(void)state;
	gd_pairs_new(&p.pairs, 61, 43, NULL);
	for (int i = 0; i < 61 * 43; i++) {
		p.pairs.dx[0][i] = i % 61 < 60;
		p.pairs.dy[1][i] = i / 61 < 42;
	}
	p.in.n = 3;
	for (int c = 0; c < 3; c++) {
		p.in.primal[c] = g.in.primal[c];
		p.in.value[0][c] = g.in.dx[c];
		p.in.value[1][c] = g.in.dy[c];
		p.out[c] = blank(61, 43);
	}
	for (int m = GD_L2; m <= GD_L1; m++) {
		struct gd_poisson_conf conf = GD_POISSON_DEFAULTS;

		conf.method = (enum gd_poisson_method)m;
		conf.tolerance = 1e-6;
		assert_int_equal(gd_poisson_solve(g.out, &g.in, &conf, NULL, NULL, NULL), GD_OK);
		paired_solve(&p, (enum gd_poisson_method)m, 0.2, 1e-6);
		for (int c = 0; c < 3; c++)
			assert_true(largest_difference(g.out[c], p.out[c]) <
				    (m == GD_L2 ? 1e-5 : 0.03));
	}
	for (int c = 0; c < 3; c++)
		free(p.out[c].v);
	gd_pairs_free(&p.pairs);
	problem_free(&g);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_l2),
		cmocka_unit_test(test_default_tolerance),
		cmocka_unit_test(test_pairs_without_a_number_weigh_nothing),
		cmocka_unit_test(test_l1_against_exact_reweighting),
		cmocka_unit_test(test_grid_is_the_poisson_problem),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
