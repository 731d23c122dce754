/* SPDX-License-Identifier: BSD-3-Clause */
/* Two estimates, and which of them the samples speak for. */
#include "../support/halves_case.h"

#include <omp.h>

#include "gate.h"
#include "halves.h"

#define W 128
#define H 72
#define SIGMA 0.3	/* of the noise of either half */

/* Estimates of either half: of a the left is right and the right is off, of b the other way. */
struct pair {
	struct job *job;
	struct gd_plane a[2][3], b[2][3], share, spare[2];
	double mean;
};

static double wave(int c, int x, int y)
{
	return 0.4 * sin(0.5 * x + c) * cos(0.4 * y);
}

static struct pair pair(double off_a, double off_b)
{
	struct pair p = { .job = make(W, H, 3, SIGMA, 0.5), .share = plane(W, H),
			  .spare = { plane(W, H), plane(W, H) } };

	for (unsigned half = 0; half < 2; half++)
		for (int c = 0; c < 3; c++) {
			p.a[half][c] = plane(W, H);
			p.b[half][c] = plane(W, H);
			for (int y = 0; y < H; y++)
				for (int x = 0; x < W; x++) {
					double t = (double)gd_row(p.job->truth[c], y)[x];
					double off = wave(c, x, y);

					gd_row(p.a[half][c], y)[x] =
						(float)(t + (x < W / 2 ? 0 : off_a) * off);
					gd_row(p.b[half][c], y)[x] =
						(float)(t + (x < W / 2 ? off_b : 0) * off);
				}
		}
	return p;
}

static void pair_done(struct pair *p)
{
	for (int half = 0; half < 2; half++)
		for (int c = 0; c < 3; c++) {
			drop(&p->a[half][c]);
			drop(&p->b[half][c]);
		}
	drop(&p->share);
	drop(&p->spare[0]);
	drop(&p->spare[1]);
	done(p->job);
}

static void map(struct pair *p, double leverage)
{
	const struct gd_gate gate = { .in = &p->job->in, .a = { p->a[0], p->a[1] },
				      .b = { p->b[0], p->b[1] }, .leverage = leverage };
	struct gd_err err = { 0 };

	assert_int_equal(gd_halves_check(&p->job->in, &err), GD_OK);
	assert_int_equal(gd_gate_map(p->share, &p->mean, &gate, p->spare, &err), GD_OK);
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++) {
			float s = gd_row(p->share, y)[x];

			assert_true(s >= 0 && s <= 1);
		}
}

static double mean_of(struct gd_plane p, int x0, int x1)
{
	double s = 0;

	for (int y = 0; y < p.h; y++)
		for (int x = x0; x < x1; x++)
			s += (double)gd_row(p, y)[x];
	return s / (x1 - x0) / p.h;
}

static void test_each_side_its_own(void **state)
{
	struct pair p = pair(1, 1);

	(void)state;
	map(&p, 0);
	below(0.85, mean_of(p.share, 0, 48));
	below(mean_of(p.share, 80, W), 0.15);
	below(fabs(p.mean - mean_of(p.share, 0, W)), 1e-6);
	for (int y = 0; y < H; y++)	/* no seams: noise and border of a Gaussian of 5 pixels */
		for (int x = 1; x < W; x++)
			below(fabs((double)gd_row(p.share, y)[x] -
				   (double)gd_row(p.share, y)[x - 1]), 0.12);
	pair_done(&p);
}

/* Where a is off by 1 and b by -1 times the same, the middle is best; by 1 and -3, a quarter b. */
static void test_best_mixture(void **state)
{
	static const double off[][2] = { { 1, 1 }, { 1, 3 }, { 3, 1 } };

	(void)state;
	for (int i = 0; i < 3; i++) {
		struct pair p = pair(0, 0);

		for (int half = 0; half < 2; half++)
			for (int c = 0; c < 3; c++)
				for (int y = 0; y < H; y++)
					for (int x = 0; x < W; x++) {
						float o = (float)wave(c, x, y);

						gd_row(p.a[half][c], y)[x] += (float)off[i][0] * o;
						gd_row(p.b[half][c], y)[x] -= (float)off[i][1] * o;
					}
		map(&p, 0);
		below(fabs(p.mean - off[i][1] / (off[i][0] + off[i][1])), 0.04);
		pair_done(&p);
	}
}

static float block_noise(const struct job *j, int half, int c, int x, int y)
{
	float sum = 0;

	for (int by = y / 4 * 4; by < y / 4 * 4 + 4; by++)
		for (int bx = x / 4 * 4; bx < x / 4 * 4 + 4; bx++)
			sum += gd_row(j->in.y[half][c], by)[bx] - gd_row(j->truth[c], by)[bx];
	return sum / 16;
}

/*
 * a is right, b has the mean noise of its own half in 4x4 pixels besides, a sixteenth of a pixel's
 * variance: for those samples it is not worse, and only the leverage tells. (Not all of it, as the
 * vote of a pixel is bounded.)
 */
static void test_leverage(void **state)
{
	(void)state;
	for (int known = 0; known < 2; known++) {
		struct pair p = pair(0, 0);

		for (int half = 0; half < 2; half++)
			for (int c = 0; c < 3; c++)
				for (int y = 0; y < H; y++)
					for (int x = 0; x < W; x++)
						gd_row(p.b[half][c], y)[x] +=
							block_noise(p.job, half, c, x, y);
		map(&p, known / 16.0);
		if (known)
			below(0.25, p.mean);
		else
			below(p.mean, 0.1);
		pair_done(&p);
	}
}

static void test_scaled_turned_swapped(void **state)
{
	static const float scales[] = { 1e-18f, 1e-3f, 1, 1e12f };
	struct pair p = pair(1, 2);

	(void)state;
	map(&p, 0.01);
	for (int i = 0; i < 4; i++) {
		struct pair q = pair(1, 2);
		int how = i % 3;

		for (int half = 0; half < 2; half++)
			for (int c = 0; c < 3; c++) {
				struct gd_plane *all[] = { &q.a[half][c], &q.b[half][c],
							   &q.job->in.y[half][c] };

				for (int k = 0; k < 3; k++) {
					times(*all[k], scales[i]);
					if (how)
						turn(all[k], how);
				}
			}
		for (int c = 0; c < 3 && i == 2; c++) {
			swap(&q.a[0][c], &q.a[1][c]);
			swap(&q.b[0][c], &q.b[1][c]);
			swap(&q.job->in.y[0][c], &q.job->in.y[1][c]);
		}
		map(&q, 0.01);
		if (how)
			turn(&q.share, how);
		below(most_off(p.share, q.share), 1e-4);
		pair_done(&q);
	}
	pair_done(&p);
}

static void test_threads(void **state)
{
	struct pair p = pair(1, 1);
	int was = omp_get_max_threads();

	(void)state;
	omp_set_num_threads(1);
	map(&p, 0.01);
	for (int n = 2; n <= 7; n += 5) {
		struct pair q = pair(1, 1);

		omp_set_num_threads(n);
		map(&q, 0.01);
		assert_true(most_off(p.share, q.share) == 0 && p.mean == q.mean);
		pair_done(&q);
	}
	omp_set_num_threads(was);
	pair_done(&p);
}

/* Nothing to choose, and what renders may hold. */
static void test_extremes(void **state)
{
	static const float value[] = { 0, 1e-40f, 1, 1e30f, FLT_MAX, -FLT_MAX };
	struct pair p = pair(0, 0);

	(void)state;
	map(&p, 0.01);
	assert_true(p.mean == 0.5 && gd_row(p.share, 3)[5] == 0.5f);
	pair_done(&p);
	for (size_t i = 0; i < sizeof value / sizeof *value; i++)
		for (int all = 0; all < 2; all++) {
			p = pair(1, 1);
			for (int c = 0; c < 3; c++)
				for (int y = 0; y < H; y++)
					for (int x = 0; x < W; x++)
						if (all || (x == 20 && y == 30)) {
							gd_row(p.a[0][c], y)[x] = value[i];
							gd_row(p.b[1][c], y)[x] = -value[i];
							gd_row(p.job->in.y[0][c], y)[x] = value[i];
						}
			map(&p, 0.01);
			if (!all) {	/* one pixel in thousands rules nobody but near it */
				below(0.8, mean_of(p.share, 44, 56));
				below(mean_of(p.share, 72, W), 0.2);
			}
			pair_done(&p);
		}
}

/* A half without samples has no say. */
static void test_counts(void **state)
{
	struct pair p = pair(1, 1);

	(void)state;
	for (int half = 0; half < 2; half++) {
		p.job->in.count[half] = plane(W, H);
		for (int y = 0; y < H; y++)
			for (int x = 0; x < W; x++) {
				gd_row(p.job->in.count[half], y)[x] = half ? 4 : 0;
				if (!half)	/* speaks against the truth */
					for (int c = 0; c < 3; c++)
						gd_row(p.job->in.y[0][c], y)[x] =
							gd_row(x < W / 2 ? p.b[0][c] : p.a[0][c],
							       y)[x];
			}
	}
	map(&p, 0);
	below(0.85, mean_of(p.share, 0, 48));
	below(mean_of(p.share, 80, W), 0.15);
	pair_done(&p);
}

/* ---- in the regression ---- */

/* Checks that no G-buffer has, in all samples. */
static struct job *checks(double sigma)
{
	struct job *j = make(W, H, 3, sigma, 0);

	for (int c = 0; c < 3; c++)
		for (int y = 0; y < H; y++)
			for (int x = 0; x < W; x++) {
				float more = (x / 5 + y / 5) % 2 ? 0.35f : -0.35f;

				gd_row(j->truth[c], y)[x] += more;
				gd_row(j->in.y[0][c], y)[x] += more;
				gd_row(j->in.y[1][c], y)[x] += more;
			}
	return j;
}

/* Right of x0 the feature says nothing true: dipoles, other ones in either half. */
static void mislead(struct job *j, int x0)
{
	for (int half = 0; half < 2; half++)
		for (int c = 0; c < 3; c++)
			for (int y = 0; y < H; y++)
				for (int x = x0; x < W; x++)
					gd_row(j->in.feature[half][c], y)[x] =
						(float)(1.5 + 2 * wave(c + 2 * half, x + 3 * y, y));
}

static void denoise(struct job *j)
{
	const struct gd_crossfit_conf conf = { 0 };
	const struct gd_crossfit_out out = { j->est, j->mse, j->spread };
	struct gd_crossfit_result result;
	struct gd_err err = { 0 };

	assert_int_equal(gd_crossfit_run(&out, &j->in, &conf, &result, NULL, &err), GD_OK);
	assert_sane(j);
}

/* About as good as the better choice on either side, and no worse than none where all is wrong. */
static void test_feature_of_half_the_image(void **state)
{
	struct job *good = checks(SIGMA), *none = checks(SIGMA), *half = checks(SIGMA);
	struct job *bad = checks(SIGMA);
	double own;

	(void)state;
	add_feature(good, 0.05);
	add_feature(half, 0.05);
	add_feature(bad, 0.05);
	mislead(half, W / 2);
	mislead(bad, 0);
	denoise(good);
	denoise(none);
	denoise(half);
	denoise(bad);
	below(square_error_of(good, 0, 48, &own), 0.1 * square_error_of(none, 0, 48, &own));
	below(square_error_of(half, 0, 48, &own), 1.15 * square_error_of(good, 0, 48, &own));
	below(square_error_of(half, 80, W, &own), 1.02 * square_error_of(none, 80, W, &own));
	below(square_error(bad), 1.02 * square_error(none));
	done(good);
	done(none);
	done(half);
	done(bad);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_each_side_its_own),
		cmocka_unit_test(test_best_mixture),
		cmocka_unit_test(test_leverage),
		cmocka_unit_test(test_scaled_turned_swapped),
		cmocka_unit_test(test_threads),
		cmocka_unit_test(test_extremes),
		cmocka_unit_test(test_counts),
		cmocka_unit_test(test_feature_of_half_the_image),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
