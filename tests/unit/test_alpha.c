/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * The weight that suits the noise. Truth: for noise that is independent everywhere the best linear
 * estimate weighs by variances (Gauss and Markov), alpha^2 = var(gradient) / var(colour); for any
 * other noise, a scan of solutions compared with the image behind them.
 */
#include <float.h>
#include <omp.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "../support/pairs_case.h"
#include "alpha.h"

#define SCAN 25

/* A made image, its values with noise, and the noise of the difference of two halves. */
struct noisy {
	struct paired graph;
	struct gd_alpha_in in;
	struct gd_plane truth;
	int w, h;
};

static double at(struct gd_plane p, int x, int y)
{
	return (double)gd_row(p, y)[x];
}

static bool edge_of(const struct noisy *p, int k, int x, int y, int *dx, int *dy)
{
	const size_t i = (size_t)(y * p->w + x);

	*dx = p->in.pairs ? p->in.pairs->dx[k][i] : !k;
	*dy = p->in.pairs ? p->in.pairs->dy[k][i] : k;
	return (*dx || *dy) && x + *dx < p->w && y + *dy < p->h;
}

static struct noisy noisy_new(int w, int h, bool pairs)
{
	struct noisy p = { .w = w, .h = h };

	p.in.edges = 2;
	if (pairs) {
		p.graph = paired_new(w, h, 0, 0, 5);
		p.in.edges = GD_PAIRS;
	}
	p.in.source = GD_ALPHA_HALVES;
	p.truth = blank(w, h);
	p.in.colour = blank(w, h);
	p.in.colour_noise = blank(w, h);
	for (int k = 0; k < p.in.edges; k++) {
		p.in.edge[k] = blank(w, h);
		p.in.edge_noise[k] = blank(w, h);
	}
	for (int y = 0; y < h; y++)
		for (int x = 0; x < w; x++)
			gd_row(p.truth, y)[x] = (float)(1 + 0.5 * sin(0.1 * x) * cos(0.13 * y) +
							(3 * x + 2 * y > 2 * w ? 0.7 : 0));
	return p;
}

static void noisy_free(struct noisy *p)
{
	free(p->truth.v);
	free(p->in.colour.v);
	free(p->in.colour_noise.v);
	for (int k = 0; k < p->in.edges; k++) {
		free(p->in.edge[k].v);
		free(p->in.edge_noise[k].v);
	}
	if (p->in.edges == GD_PAIRS)
		paired_free(&p->graph);
}

/* To two values, the errors of two halves, their mean and half their difference. */
static void put(struct gd_plane value, struct gd_plane noise, int x, int y, double truth,
		const double half[2])
{
	gd_row(value, y)[x] = (float)(truth + (half[0] + half[1]) / 2);
	gd_row(noise, y)[x] = (float)((half[0] - half[1]) / 2);
}

/* Independent noise of the mean, of these standard deviations. */
static void white(struct noisy *p, double colour, double gradient, uint64_t seed)
{
	struct noise n = { seed };
	int dx, dy;

	p->in.pairs = p->in.edges == GD_PAIRS ? &p->graph.pairs : NULL;
	for (int y = 0; y < p->h; y++)
		for (int x = 0; x < p->w; x++) {
			double half[2] = { M_SQRT2 * colour * normal(&n),
					   M_SQRT2 * colour * normal(&n) };

			put(p->in.colour, p->in.colour_noise, x, y, at(p->truth, x, y), half);
			for (int k = 0; k < p->in.edges; k++) {
				half[0] = M_SQRT2 * gradient * normal(&n);
				half[1] = M_SQRT2 * gradient * normal(&n);
				if (edge_of(p, k, x, y, &dx, &dy))
					put(p->in.edge[k], p->in.edge_noise[k], x, y,
					    at(p->truth, x + dx, y + dy) - at(p->truth, x, y), half);
			}
		}
}

/*
 * As renders have it: few pixels carry most of the noise, colours share theirs with neighbours, and
 * a part of that of the gradients is the difference of noise in pixels.
 */
static void rough(struct noisy *p, double sigma, double shared, uint64_t seed)
{
	struct noise n = { seed };
	struct gd_plane spike[2], smooth[2];

	p->in.pairs = NULL;
	for (int i = 0; i < 2; i++) {
		spike[i] = blank(p->w, p->h);
		smooth[i] = blank(p->w, p->h);
		for (int y = 0; y < p->h; y++)
			for (int x = 0; x < p->w; x++) {
				const double size = uniform(&n) < 0.03 ? 8 : 0.3;

				gd_row(spike[i], y)[x] = (float)(sigma * size * normal(&n));
			}
		for (int y = 0; y < p->h; y++)
			for (int x = 0; x < p->w; x++)
				for (int k = 0; k < 9; k++) {
					const int u = x + k % 3 - 1, v = y + k / 3 - 1;

					if (u >= 0 && u < p->w && v >= 0 && v < p->h)
						gd_row(smooth[i], y)[x] +=
							(float)(at(spike[i], u, v) / 6);
				}
	}
	for (int y = 0; y < p->h; y++)
		for (int x = 0; x < p->w; x++) {
			double half[2] = { at(smooth[0], x, y), at(smooth[1], x, y) };

			put(p->in.colour, p->in.colour_noise, x, y, at(p->truth, x, y), half);
			for (int k = 0; k < 2; k++) {
				const int u = x + !k, v = y + k;

				for (int i = 0; i < 2 && u < p->w && v < p->h; i++)
					half[i] = shared * (at(spike[i], u, v) - at(spike[i], x, y)) +
						  0.4 * fabs(at(spike[i], x, y)) * normal(&n);
				if (u < p->w && v < p->h)
					put(p->in.edge[k], p->in.edge_noise[k], x, y,
					    at(p->truth, u, v) - at(p->truth, x, y), half);
			}
		}
	for (int i = 0; i < 2; i++) {
		free(spike[i].v);
		free(smooth[i].v);
	}
}

static struct gd_alpha choose(const struct noisy *p)
{
	struct gd_alpha alpha;
	struct gd_err err = { 0 };

	if (gd_alpha_choose(&alpha, &p->in, 1e-4, NULL, &err) != GD_OK)
		fail_msg("%s", err.text);
	assert_true(alpha.value >= GD_ALPHA_LEAST - 1e-3 && alpha.value <= GD_ALPHA_MOST);
	return alpha;
}

/* relMSE of l2 with a weight. */
static double error_of(const struct noisy *p, double alpha)
{
	struct gd_poisson_conf conf = GD_POISSON_DEFAULTS;
	struct gd_poisson_in grid = { .n = 1, .primal = { p->in.colour } };
	struct gd_pairsolve_in paired = { .n = 1, .pairs = p->in.pairs, .primal = { p->in.colour } };
	struct gd_plane out = blank(p->w, p->h);
	struct gd_err err = { 0 };
	double sum = 0;
	int rc;

	conf.method = GD_L2;
	conf.alpha = alpha;
	grid.dx[0] = p->in.edge[0];
	grid.dy[0] = p->in.edge[1];
	for (int k = 0; k < p->in.edges; k++)
		paired.value[k][0] = p->in.edge[k];
	rc = p->in.pairs ? gd_pairsolve(&out, &paired, &conf, NULL, NULL, &err)
			 : gd_poisson_solve(&out, &grid, &conf, NULL, NULL, &err);
	assert_int_equal(rc, GD_OK);
	for (int y = 0; y < p->h; y++)
		for (int x = 0; x < p->w; x++) {
			const double r = at(p->truth, x, y), d = at(out, x, y) - r;

			sum += d * d / (r * r + 0.01);
		}
	free(out.v);
	return sum / (p->w * p->h);
}

static double best_error(const struct noisy *p)
{
	double best = INFINITY;

	for (int i = 0; i < SCAN; i++)
		best = fmin(best, error_of(p, GD_ALPHA_LEAST * pow(GD_ALPHA_MOST / GD_ALPHA_LEAST,
								   i / (SCAN - 1.0))));
	return best;
}

/*
 * The valley is less steep towards small weights, which moves the least of the parabola there by up
 * to 15 %, and one image of this size tells the least to 10 %.
 */
static void check_white(bool pairs)
{
	static const double ratio[] = { 0.2, 0.5, 1, 2.5 };
	struct noisy p = noisy_new(160, 120, pairs);

	for (int i = 0; i < 4; i++) {
		struct gd_alpha alpha;

		white(&p, 0.1, 0.1 * ratio[i], 10 + (uint64_t)i);
		alpha = choose(&p);
		assert_int_equal(alpha.source, GD_ALPHA_HALVES);
		if (fabs(log(alpha.value / ratio[i])) > 0.25 ||
		    error_of(&p, alpha.value) > 1.03 * best_error(&p))
			fail_msg("alpha %g, expected %g; error %g, best %g", alpha.value, ratio[i],
				 error_of(&p, alpha.value), best_error(&p));
	}
	noisy_free(&p);
}

static void test_white_noise_is_weighed_by_its_variances(void **state)
{
	(void)state;
	check_white(false);
}

static void test_white_noise_of_pairs(void **state)
{
	(void)state;
	check_white(true);
}

static void test_rough_noise_comes_near_the_best(void **state)
{
	static const double sigma[] = { 0.02, 0.1, 0.4 }, shared[] = { 0, 0.3, 1 };
	struct noisy p = noisy_new(160, 120, false);
	double most = 0;

	(void)state;
	for (int i = 0; i < 9; i++) {
		double ratio;

		rough(&p, sigma[i / 3], shared[i % 3], 30 + (uint64_t)i);
		ratio = error_of(&p, choose(&p).value) / best_error(&p);
		most = fmax(most, ratio);
		if (ratio > 1.05)
			fail_msg("sigma %g, shared %g: alpha %g, error %g of the best", sigma[i / 3],
				 shared[i % 3], choose(&p).value, ratio);
	}
	assert_true(most >= 1 - 1e-3);
	noisy_free(&p);
}

static void fill(struct gd_plane p, double v)
{
	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++)
			gd_row(p, y)[x] = (float)v;
}

static void set_variances(struct noisy *p, double colour, double gradient)
{
	p->in.source = GD_ALPHA_VARIANCES;
	fill(p->in.colour_noise, colour);
	for (int k = 0; k < p->in.edges; k++)
		fill(p->in.edge_noise[k], gradient);
}

static void test_variances_alone(void **state)
{
	(void)state;
	for (int pairs = 0; pairs < 2; pairs++) {
		struct noisy p = noisy_new(60, 50, pairs);

		white(&p, 0.1, 0.05, 3);
		set_variances(&p, 1e-2, 25e-4);
		assert_int_equal(choose(&p).source, GD_ALPHA_VARIANCES);
		assert_true(fabs(choose(&p).value - 0.7 * 0.5) < 1.1e-3);
		assert_true(error_of(&p, choose(&p).value) < 1.1 * best_error(&p));
		if (!pairs) {	/* nothing is said of what leads out of the image, or is no number */
			gd_row(p.in.edge_noise[0], 7)[59] = 1e9F;
			gd_row(p.in.edge_noise[1], 49)[8] = 1e9F;
			gd_row(p.in.edge_noise[1], 9)[8] = NAN;
			gd_row(p.in.colour_noise, 3)[3] = INFINITY;
			assert_true(fabs(choose(&p).value - 0.7 * 0.5) < 1.1e-3);
		}
		noisy_free(&p);
	}
}

static void test_what_says_nothing_is_the_published_weight(void **state)
{
	struct noisy p = noisy_new(40, 30, false);

	(void)state;
	white(&p, 0, 0, 1);
	assert_int_equal(choose(&p).source, GD_ALPHA_NONE);
	assert_true(choose(&p).value == GD_ALPHA_PUBLISHED);
	set_variances(&p, 0, 0);
	assert_true(choose(&p).value == GD_ALPHA_PUBLISHED);
	set_variances(&p, NAN, 1);
	assert_true(choose(&p).value == GD_ALPHA_MOST);
	p.in.source = GD_ALPHA_NONE;
	assert_true(choose(&p).value == GD_ALPHA_PUBLISHED);
	fill(p.in.colour, 0);
	fill(p.in.edge[0], 0);
	fill(p.in.edge[1], 0);
	p.in.source = GD_ALPHA_HALVES;
	assert_true(choose(&p).value == GD_ALPHA_PUBLISHED);
	noisy_free(&p);
}

static void test_exact_colours_or_gradients_are_trusted(void **state)
{
	struct noisy p = noisy_new(50, 40, false);

	(void)state;
	white(&p, 0.1, 0, 4);
	assert_true(choose(&p).value < 1.05 * GD_ALPHA_LEAST);
	white(&p, 0, 0.1, 4);
	assert_true(choose(&p).value == GD_ALPHA_MOST);
	set_variances(&p, 1, 0);
	assert_true(choose(&p).value < 1.05 * GD_ALPHA_LEAST);
	set_variances(&p, 0, 1);
	assert_true(choose(&p).value == GD_ALPHA_MOST);
	noisy_free(&p);
}

static void scale_by(struct gd_plane p, double factor)
{
	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++)
			gd_row(p, y)[x] = (float)((double)gd_row(p, y)[x] * factor);
}

static void test_scale_does_not_matter(void **state)
{
	static const double factor[] = { 1000, 1e-20, 1e25 };

	(void)state;
	for (int i = 0; i < 6; i++) {
		struct noisy p = noisy_new(70, 50, i >= 3);
		double before;

		white(&p, 0.1, 0.07, 6);
		before = choose(&p).value;
		scale_by(p.in.colour, factor[i % 3]);
		scale_by(p.in.colour_noise, factor[i % 3]);
		for (int k = 0; k < p.in.edges; k++) {
			scale_by(p.in.edge[k], factor[i % 3]);
			scale_by(p.in.edge_noise[k], factor[i % 3]);
		}
		assert_true(fabs(choose(&p).value - before) < 1.5e-3);
		noisy_free(&p);
	}
}

/* Left and right, or the top and the bottom, change places: differences change their sign. */
static void mirror(struct gd_plane p, bool upright, bool along)
{
	struct gd_plane q = blank(p.w, p.h);

	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++) {
			const int u = upright ? x : p.w - 1 - x - along;
			const int v = upright ? p.h - 1 - y - along : y;

			gd_row(q, y)[x] = u < 0 || v < 0 ? 0 : (along ? -1 : 1) * gd_row(p, v)[u];
		}
	for (int y = 0; y < p.h; y++)
		memcpy(gd_row(p, y), gd_row(q, y), (size_t)p.w * sizeof(float));
	free(q.v);
}

static void test_flips_do_not_matter(void **state)
{
	(void)state;
	for (int upright = 0; upright < 2; upright++) {
		struct noisy p = noisy_new(75, 53, false);
		double before;

		rough(&p, 0.1, 0.3, 8);
		before = choose(&p).value;
		mirror(p.in.colour, upright, false);
		mirror(p.in.colour_noise, upright, false);
		for (int k = 0; k < 2; k++) {
			mirror(p.in.edge[k], upright, k == upright);
			mirror(p.in.edge_noise[k], upright, k == upright);
		}
		assert_true(fabs(choose(&p).value / before - 1) < 0.01);
		noisy_free(&p);
	}
}

static void test_threads_do_not_matter(void **state)
{
	(void)state;
	for (int pairs = 0; pairs < 2; pairs++) {
		struct noisy p = noisy_new(90, 61, pairs);
		const int most = omp_get_max_threads();
		double one;

		white(&p, 0.1, 0.06, 9);
		omp_set_num_threads(1);
		one = choose(&p).value;
		omp_set_num_threads(7);
		assert_true(choose(&p).value == one);
		omp_set_num_threads(most);
		noisy_free(&p);
	}
}

static void test_wild_values_and_small_images(void **state)
{
	static const int side[][2] = { { 1, 1 }, { 1, 17 }, { 17, 1 }, { 2, 2 }, { 13, 7 } };
	static const float wild[] = { NAN, INFINITY, 1e30F, FLT_MAX, -1e30F, 1e-42F };

	(void)state;
	for (int i = 0; i < 5; i++) {
		struct noisy p = noisy_new(side[i][0], side[i][1], false);

		for (int k = 0; k < 24; k++) {
			struct gd_plane to[] = { p.in.colour, p.in.colour_noise, p.in.edge[1],
						 p.in.edge_noise[0] };

			white(&p, 0.1, 0.05, (uint64_t)k);
			p.in.source = k % 2 ? GD_ALPHA_HALVES : GD_ALPHA_VARIANCES;
			gd_row(to[k / 6], p.h / 2)[p.w / 2] = wild[k % 6];
			choose(&p);
			fill(to[k / 6], (double)wild[k % 6]);
			choose(&p);
		}
		noisy_free(&p);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_white_noise_is_weighed_by_its_variances),
		cmocka_unit_test(test_white_noise_of_pairs),
		cmocka_unit_test(test_rough_noise_comes_near_the_best),
		cmocka_unit_test(test_variances_alone),
		cmocka_unit_test(test_what_says_nothing_is_the_published_weight),
		cmocka_unit_test(test_exact_colours_or_gradients_are_trusted),
		cmocka_unit_test(test_scale_does_not_matter),
		cmocka_unit_test(test_flips_do_not_matter),
		cmocka_unit_test(test_threads_do_not_matter),
		cmocka_unit_test(test_wild_values_and_small_images),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
