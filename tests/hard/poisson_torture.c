/* SPDX-License-Identifier: BSD-3-Clause */
/* Hostile input to the solver and to bagging: nothing
 * but finite numbers may come out, and sensible ones. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <cmocka.h>

#include "../support/poisson_case.h"
#include "boot.h"

static void set_all(struct gd_plane *plane, float v)
{
	for (int c = 0; c < 3; c++)
		for (int y = 0; y < plane[c].h; y++)
			for (int x = 0; x < plane[c].w; x++)
				gd_row(plane[c], y)[x] = v;
}

static struct gd_poisson_result solve(struct problem *p, int method, const char *what)
{
	struct gd_poisson_conf conf = GD_POISSON_DEFAULTS;
	struct gd_poisson_result result;
	struct gd_err err = { 0 };

	conf.method = (enum gd_poisson_method)method;
	if (gd_poisson_solve(p->out, &p->in, &conf, &result, NULL, &err) != GD_OK)
		fail_msg("%s: %s", what, err.text);
	for (int c = 0; c < 3; c++)
		if (!all_finite(p->out[c]))
			fail_msg("%s, method %d: not finite", what, method);
	return result;
}

/* Far from the damage the result is that of the sound problem. */
static double far_difference(const struct problem *p, const struct problem *sound, int x0, int y0,
			     int away)
{
	double most = 0;

	for (int c = 0; c < 3; c++)
		for (int y = 0; y < p->h; y++)
			for (int x = 0; x < p->w; x++)
				if (abs(x - x0) > away || abs(y - y0) > away)
					most = fmax(most,
						    fabs((double)gd_row(p->out[c], y)[x] -
							 (double)gd_row(sound->out[c], y)[x]));
	return most;
}

static void test_tiny_and_odd_sizes(void **state)
{
	static const int size[][2] = {{1, 1},	 {1, 2},   {2, 1},  {1, 1021},
				      {1021, 1}, {3, 499}, {65, 1}, {127, 131}};

	(void)state;
	for (size_t i = 0; i < sizeof(size) / sizeof(*size); i++)
		for (int m = GD_OLS; m <= GD_L1; m++) {
			struct problem p = problem_new(size[i][0], size[i][1], 0.1, 1);

			assert_true(solve(&p, m, "size").converged);
			problem_free(&p);
		}
}

static void test_all_black_and_constants(void **state)
{
	(void)state;
	for (int m = GD_OLS; m <= GD_L1; m++) {
		struct problem p = problem_new(33, 29, 0.1, 2);

		set_all(p.in.primal, 0);
		set_all(p.in.dx, 0);
		set_all(p.in.dy, 0);
		set_all(p.in.dxvar, 0);
		set_all(p.in.dyvar, 0);
		solve(&p, m, "black");
		for (int c = 0; c < 3; c++)
			assert_true(mean_of(p.out[c]) == 0);
		set_all(p.in.primal, -2.5f);	/* all gradients zero: the mean everywhere */
		solve(&p, m, "constant");
		for (int c = 0; c < 3; c++)
			for (int y = 0; y < p.h; y++)
				for (int x = 0; x < p.w; x++)
					assert_true(fabsf(gd_row(p.out[c], y)[x] + 2.5f) < 1e-4f);
		problem_free(&p);
	}
}

static void test_zero_variances(void **state)
{
	struct problem p = problem_new(60, 50, 0.1, 3), q = problem_new(60, 50, 0.1, 3);

	(void)state;
	set_all(p.in.dxvar, 0);
	set_all(p.in.dyvar, 0);
	solve(&p, GD_WLS, "no variance");
	solve(&q, GD_OLS, "ols");
	for (int c = 0; c < 3; c++)
		assert_true(largest_difference(p.out[c], q.out[c]) < 1e-5);
	for (int c = 0; c < 3; c++)
		for (int y = 0; y < 50; y++)
			for (int x = 0; x < 60; x++)
				gd_row(p.in.dxvar[c], y)[x] = gd_row(p.in.dyvar[c], y)[x] =
					x % 4 < 2 ? 0 : 0.01f;
	assert_true(solve(&p, GD_WLS, "stripes").converged);
	problem_free(&p);
	problem_free(&q);
}

/* One firefly, in the colour and in its four gradients. */
static void light(struct problem *p, int x, int y, float v)
{
	for (int c = 0; c < 3; c++) {
		gd_row(p->in.primal[c], y)[x] = v;
		gd_row(p->in.dx[c], y)[x] = gd_row(p->in.dy[c], y)[x] = -v;
		gd_row(p->in.dx[c], y)[x - 1] = gd_row(p->in.dy[c], y - 1)[x] = v;
		gd_row(p->in.dxvar[c], y)[x] = gd_row(p->in.dyvar[c], y)[x] = v * v;
		gd_row(p->in.dxvar[c], y)[x - 1] = gd_row(p->in.dyvar[c], y - 1)[x] = v * v;
	}
}

static void test_fireflies(void **state)
{
	static const float v[] = { 1e6f, 1e15f, 1e30f };

	(void)state;
	for (int i = 0; i < 3; i++) {
		struct problem p = problem_new(64, 64, 0.1, 4), sound = problem_new(64, 64, 0.1, 4);

		light(&p, 30, 31, v[i]);
		for (int m = GD_OLS; m <= GD_L1; m++)
			solve(&p, m, "firefly");
		solve(&p, GD_L1, "firefly");
		solve(&sound, GD_L1, "sound");
		if (!(far_difference(&p, &sound, 30, 31, 12) < 0.1))
			fail_msg("l1, %g: %g", (double)v[i],
				 far_difference(&p, &sound, 30, 31, 12));
		for (int c = 0; c < 3; c++)		/* else the constant is the firefly's */
			gd_row(p.in.primal[c], 31)[30] = gd_row(sound.in.primal[c], 31)[30];
		solve(&p, GD_WLS, "firefly");
		solve(&sound, GD_WLS, "sound");
		if (!(far_difference(&p, &sound, 30, 31, 12) < 0.3))
			fail_msg("wls, %g: %g", (double)v[i],
				 far_difference(&p, &sound, 30, 31, 12));
		problem_free(&p);
		problem_free(&sound);
	}
}

static void test_pixels_that_are_no_numbers(void **state)
{
	static const float bad[3] = { NAN, INFINITY, -INFINITY };

	(void)state;
	for (int m = GD_OLS; m <= GD_L1; m++)
		for (int i = 0; i < 3; i++) {
			struct problem p = problem_new(50, 50, 0.1, 5),
				       sound = problem_new(50, 50, 0.1, 5);

			gd_row(p.in.primal[0], 20)[20] = bad[i];
			gd_row(p.in.dx[1], 21)[20] = bad[i];
			gd_row(p.in.dy[2], 20)[22] = bad[i];
			gd_row(p.in.dxvar[1], 23)[20] = bad[i];
			solve(&p, m, "bad pixel");
			solve(&sound, m, "sound");
			assert_true(far_difference(&p, &sound, 21, 21, 10) < 0.2);
			problem_free(&p);
			problem_free(&sound);
		}
	for (int m = GD_OLS; m <= GD_L1; m++) {
		struct problem p = problem_new(20, 20, 0.1, 6);

		set_all(p.in.dx, NAN);
		set_all(p.in.dy, NAN);
		solve(&p, m, "no gradient at all");
		for (int c = 0; c < 3; c++)		/* every pixel is a part of its own */
			assert_true(largest_difference(p.out[c], p.in.primal[c]) < 1e-4);
		set_all(p.in.primal, NAN);
		solve(&p, m, "nothing at all");
		problem_free(&p);
	}
}

static void test_denormals(void **state)
{
	struct problem p = problem_new(30, 30, 0.1, 7);

	(void)state;
	for (int c = 0; c < 3; c++)
		for (int y = 0; y < 30; y++)
			for (int x = 0; x < 30; x++) {
				gd_row(p.in.primal[c], y)[x] *= 1e-40f;
				gd_row(p.in.dx[c], y)[x] *= 1e-40f;
				gd_row(p.in.dy[c], y)[x] *= 1e-40f;
				gd_row(p.in.dxvar[c], y)[x] = gd_row(p.in.dyvar[c], y)[x] = 1e-45f;
			}
	for (int m = GD_OLS; m <= GD_L1; m++) {
		solve(&p, m, "denormal");
		for (int c = 0; c < 3; c++)
			assert_true(fabs(mean_of(p.out[c]) - mean_of(p.in.primal[c])) < 1e-42);
	}
	problem_free(&p);
}

/* Everything at once, at random, in all planes. */
static void test_random_rubbish(void **state)
{
	static const float value[] = {0,     -0.0f,  1,	     -1,  1e30f,    -1e30f,
				      3e38f, 1e-45f, 1e-30f, NAN, INFINITY, -INFINITY};

	(void)state;
	for (uint64_t seed = 1; seed <= 30; seed++) {
		struct problem p = problem_new(23, 19, 0.1, seed);
		struct noise n = { seed };

		for (int c = 0; c < 3; c++)
			for (int y = 0; y < 19; y++)
				for (int x = 0; x < 23; x++) {
					struct gd_plane *plane[] = {p.in.primal, p.in.dx, p.in.dy,
								    p.in.dxvar, p.in.dyvar};

					for (int k = 0; k < 5; k++)
						if (uniform(&n) < 0.3)
							gd_row(plane[k][c], y)[x] =
								value[(int)(uniform(&n) * 12)];
				}
		for (int m = GD_OLS; m <= GD_L1; m++)
			solve(&p, m, "rubbish");
		problem_free(&p);
	}
}

static void test_rubbish_bins(void **state)
{
	static const float value[] = { 0, 1, -1, 1e30f, -1e30f, 3e38f, 1e-45f, NAN, INFINITY };
	static const int bins[] = { 1, 2, 8, 16 };

	(void)state;
	for (int i = 0; i < 4; i++)
		for (uint64_t seed = 1; seed <= 5; seed++) {
			struct gd_boot_conf conf = GD_BOOT_DEFAULTS;
			struct gd_plane dx[16][3], dy[16][3];
			struct gd_boot_in in = { 3, bins[i], (const struct gd_plane (*)[3])dx,
						 (const struct gd_plane (*)[3])dy, { { 0 } } };
			struct gd_boot_out out;
			struct gd_err err = { 0 };
			struct noise n = { seed };
			const int w = seed == 5 ? 1 : 21, h = seed == 4 ? 1 : 17;

			conf.replicates = 3;
			for (int c = 0; c < 3; c++) {
				out.mean[c] = blank(w, h);
				out.var[c] = blank(w, h);
				out.local[c] = blank(w, h);
				in.primal[c] = blank(w, h);
				for (int b = 0; b < bins[i]; b++) {
					dx[b][c] = blank(w, h);
					dy[b][c] = blank(w, h);
				}
				for (int y = 0; y < h; y++)
					for (int x = 0; x < w; x++)
						for (int b = 0; b < bins[i]; b++) {
							gd_row(dx[b][c], y)[x] =
								uniform(&n) < 0.2
									? value[(int)(uniform(&n) *
										      9)]
									: (float)normal(&n);
							gd_row(dy[b][c], y)[x] =
								uniform(&n) < 0.2
									? value[(int)(uniform(&n) *
										      9)]
									: (float)normal(&n);
						}
			}
			assert_int_equal(gd_boot_run(&out, &in, &conf, NULL, NULL, &err), GD_OK);
			for (int c = 0; c < 3; c++) {
				assert_true(all_finite(out.mean[c]) && all_finite(out.var[c]) &&
					    all_finite(out.local[c]));
				free(out.mean[c].v);
				free(out.var[c].v);
				free(out.local[c].v);
				free(in.primal[c].v);
				for (int b = 0; b < bins[i]; b++) {
					free(dx[b][c].v);
					free(dy[b][c].v);
				}
			}
		}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_tiny_and_odd_sizes),
		cmocka_unit_test(test_all_black_and_constants),
		cmocka_unit_test(test_zero_variances),
		cmocka_unit_test(test_fireflies),
		cmocka_unit_test(test_pixels_that_are_no_numbers),
		cmocka_unit_test(test_denormals),
		cmocka_unit_test(test_random_rubbish),
		cmocka_unit_test(test_rubbish_bins),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
