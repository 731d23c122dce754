/* SPDX-License-Identifier: BSD-3-Clause */
/* The denoiser with other frames of a sequence, and with samples that differ per pixel. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include <omp.h>

#include "crossfit.h"
#include "halves.h"

#define W 80
#define H 60

static double draw(unsigned seed, int c, int x, int y)
{
	uint64_t k =
		((uint64_t)seed << 40) ^ ((uint64_t)c << 32) ^ ((uint64_t)x << 16) ^ (uint64_t)y;
	double sum = 0;

	for (int i = 0; i < 4; i++) {	/* variance 1 */
		k += 0x9e3779b97f4a7c15u;
		k = (k ^ (k >> 30)) * 0xbf58476d1ce4e5b9u;
		k = (k ^ (k >> 27)) * 0x94d049bb133111ebu;
		k ^= k >> 31;
		sum += (double)(k >> 11) / 9007199254740992.0 - 0.5;
	}
	return sum * 1.7320508;
}

struct job {
	struct gd_plane truth[3], est[3], mse[3], feat[2], count[2];
	struct gd_crossfit_in in;
	struct gd_crossfit_frame frame[GD_CROSSFIT_FRAMES];
	struct gd_crossfit_result result;
};

static void planes(struct gd_plane *p, int n)
{
	const struct gd_plane like = { NULL, W, H, 0 };

	assert_int_equal(gd_halves_planes(p, n, like, NULL), GD_OK);
	gd_halves_clear(p, n);
}

/* G-buffers explain the checker board and the waves, not the disc of light. */
static double truth(int c, int x, int y)
{
	double disc = (x - 40) * (x - 40) + (y - 30) * (y - 30) < 200;

	return 1 + 0.5 * ((x / 10 + y / 8) % 2) + 0.2 * c * sin(0.3 * x) + 0.8 * disc;
}

static void shoot(struct gd_plane y[2][GD_APR_RHS], unsigned seed, double sigma, bool other)
{
	for (int h = 0; h < 2; h++) {
		planes(y[h], 3);
		for (int c = 0; c < 3; c++)
			for (int j = 0; j < H; j++)
				for (int i = 0; i < W; i++) {
					double t = other ? 2 + sin(0.9 * j) : truth(c, i, j);

					gd_row(y[h][c], j)[i] =
						(float)(t + sigma * draw(seed + (unsigned)h, c, i,
									 j));
				}
	}
}

/* frames in all, of the same noise; the last one of something else if other. */
static struct job *make(int frames, double sigma, bool other, unsigned seed)
{
	struct job *j = calloc(1, sizeof *j);

	j->in = (struct gd_crossfit_in){ .ny = 3, .nfeat = 2, .nframe = frames - 1,
					 .frame = j->frame };
	planes(j->truth, 3);
	planes(j->est, 3);
	planes(j->mse, 3);
	planes(j->feat, 2);
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++) {
			for (int c = 0; c < 3; c++)
				gd_row(j->truth[c], y)[x] = (float)truth(c, x, y);
			gd_row(j->feat[0], y)[x] = (float)((x / 10 + y / 8) % 2);
			gd_row(j->feat[1], y)[x] = (float)sin(0.3 * x);
		}
	memcpy(j->in.feat, j->feat, sizeof j->feat);
	shoot(j->in.y, seed, sigma, false);
	for (int k = 0; k < frames - 1; k++)
		shoot(j->frame[k].y, seed + 10 + 2 * (unsigned)k, sigma,
		      other && k == frames - 2);
	return j;
}

static void run(struct job *j)
{
	const struct gd_crossfit_conf conf = { .fast = false };
	const struct gd_crossfit_out out = { j->est, j->mse, { 0 } };
	struct gd_err err = { 0 };

	assert_int_equal(gd_crossfit_run(&out, &j->in, &conf, &j->result, NULL, &err), GD_OK);
}

static void done(struct job *j)
{
	gd_halves_free(j->truth, 3);
	gd_halves_free(j->est, 3);
	gd_halves_free(j->mse, 3);
	gd_halves_free(j->feat, 2);
	gd_halves_free(j->count, 2);
	for (int h = 0; h < 2; h++) {
		gd_halves_free(j->in.y[h], 3);
		for (int k = 0; k < GD_CROSSFIT_FRAMES; k++)
			gd_halves_free(j->frame[k].y[h], 3);
	}
	free(j);
}

static double error(const struct job *j)
{
	double s = 0;

	for (int c = 0; c < 3; c++)
		for (int y = 0; y < H; y++)
			for (int x = 0; x < W; x++)
				s += pow((double)(gd_row(j->est[c], y)[x] -
						  gd_row(j->truth[c], y)[x]), 2);
	return s / (3.0 * W * H);
}

static double mean(struct gd_plane p)
{
	double s = 0;

	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++)
			s += (double)gd_row(p, y)[x] / W / H;
	return s;
}

static void below(double a, double b)
{
	if (!(a < b))
		fail_msg("%g, expected below %g", a, b);
}

/*
 * Frames of the same image with noise of their own do what one frame of that many more samples
 * does, nearly: within 15 % of the error of a frame whose variance is that of the mean.
 */
static void test_frames_are_samples(void **state)
{
	double one[2] = { 0 }, five[2] = { 0 }, best[2] = { 0 };

	(void)state;
	for (unsigned seed = 1; seed < 4; seed++)
		for (int i = 0; i < 3; i++) {
			double sigma = i == 2 ? 0.4 / sqrt(5) : 0.4;
			struct job *j = make(i == 1 ? 5 : 1, sigma, false, 100 * seed);
			double *to = i == 0 ? one : i == 1 ? five : best;

			run(j);
			to[0] += error(j);
			to[1] += (mean(j->mse[0]) + mean(j->mse[1]) + mean(j->mse[2])) / 3;
			done(j);
		}
	below(five[0], 1.15 * best[0]);
	below(five[0], 0.4 * one[0]);
	below(five[1], 0.6 * one[1]);	/* the error estimate knows it */
	below(five[0], 2.5 * five[1]);
}

static void test_unrelated_frame_does_no_harm(void **state)
{
	double alone = 0, beside = 0;

	(void)state;
	for (unsigned seed = 1; seed < 6; seed++) {
		struct job *a = make(1, 0.3, false, 100 * seed);
		struct job *b = make(2, 0.3, true, 100 * seed);

		run(a);
		run(b);
		alone += error(a);
		beside += error(b);
		done(a);
		done(b);
	}
	below(beside, 1.03 * alone);
}

static void test_order_and_threads(void **state)
{
	struct job *a = make(4, 0.3, true, 7), *b = make(4, 0.3, true, 7);
	struct job *c = make(4, 0.3, true, 7);
	struct gd_crossfit_frame t = b->frame[0];
	int was = omp_get_max_threads();

	(void)state;
	b->frame[0] = b->frame[2];
	b->frame[2] = t;
	omp_set_num_threads(2);
	run(a);
	run(b);
	omp_set_num_threads(5);
	run(c);
	omp_set_num_threads(was);
	for (int k = 0; k < 3; k++)
		for (int y = 0; y < H; y++) {
			assert_memory_equal(gd_row(a->est[k], y), gd_row(c->est[k], y),
					    W * sizeof(float));
			for (int x = 0; x < W; x++)
				below(fabs((double)(gd_row(a->est[k], y)[x] -
						    gd_row(b->est[k], y)[x])), 1e-5);
		}
	done(a);
	done(b);
	done(c);
}

static void test_firefly_in_another_frame(void **state)
{
	static const float bright[] = { 1e4f, 1e30f, FLT_MAX };

	(void)state;
	for (int i = 0; i < 3; i++) {
		struct job *a = make(3, 0.3, false, 7), *b = make(3, 0.3, false, 7);

		for (int c = 0; c < 3; c++) {
			gd_row(a->in.y[1][c], 20)[33] = bright[i];
			gd_row(b->frame[1].y[1][c], 20)[33] = bright[i];
		}
		run(a);
		run(b);
		for (int c = 0; c < 3; c++)
			for (int y = 0; y < H; y++)
				for (int x = 0; x < W; x++)
					assert_true(isfinite(gd_row(b->est[c], y)[x]));
		below(error(b), error(a));	/* than one in the frame itself */
		done(a);
		done(b);
	}
}

static void test_no_halves(void **state)
{
	double e[2];

	(void)state;
	for (int i = 0; i < 2; i++) {
		struct job *j = make(i ? 5 : 1, 0.2, false, 7);

		j->in.self = true;
		for (int c = 0; c < 3; c++) {
			planes(j->in.var + c, 1);
			for (int k = 0; k < GD_CROSSFIT_FRAMES; k++) {
				planes(j->frame[k].var + c, 1);
				for (int y = 0; y < H; y++)
					for (int x = 0; x < W; x++)
						gd_row(j->frame[k].var[c], y)[x] = 0.04f;
			}
			for (int y = 0; y < H; y++)
				for (int x = 0; x < W; x++)
					gd_row(j->in.var[c], y)[x] = 0.04f;
		}
		run(j);
		e[i] = error(j);
		gd_halves_free(j->in.var, 3);
		for (int k = 0; k < GD_CROSSFIT_FRAMES; k++)
			gd_halves_free(j->frame[k].var, 3);
		done(j);
	}
	below(e[1], 0.5 * e[0]);
}

/*
 * Every second pixel has 9 times the samples of the others. Told so, the denoiser has a lower
 * error: in a flat fit the variance would be 1/5 in place of 5/9 of that of the few.
 */
static void test_counts(void **state)
{
	double e[2] = { 0 };

	(void)state;
	for (unsigned seed = 1; seed < 4; seed++)
		for (int told = 0; told < 2; told++) {
			struct job *j = make(1, 0, false, 7);

			planes(j->count, 2);
			for (int h = 0; h < 2; h++)
				for (int y = 0; y < H; y++)
					for (int x = 0; x < W; x++) {
						double n = (x + y) % 2 ? 18 : 2;

						gd_row(j->count[h], y)[x] = (float)n;
						for (int c = 0; c < 3; c++)
							gd_row(j->in.y[h][c], y)[x] += (float)
								(0.7 / sqrt(n) *
								 draw(7 * seed + (unsigned)h, c, x,
								      y));
					}
			if (told)
				memcpy(j->in.count, j->count, sizeof j->count);
			run(j);
			e[told] += error(j);
			done(j);
		}
	below(e[1], 0.85 * e[0]);
}

/* Counts that are the same everywhere are none. */
static void test_even_counts(void **state)
{
	struct job *a = make(1, 0.3, false, 7), *b = make(1, 0.3, false, 7);

	(void)state;
	planes(b->count, 2);
	for (int h = 0; h < 2; h++)
		for (int y = 0; y < H; y++)
			for (int x = 0; x < W; x++)
				gd_row(b->count[h], y)[x] = h ? 4 : 12;
	a->in.share[0] = 0.75;
	a->in.share[1] = 0.25;
	memcpy(b->in.count, b->count, sizeof b->count);
	run(a);
	run(b);
	for (int c = 0; c < 3; c++)
		for (int y = 0; y < H; y++)
			for (int x = 0; x < W; x++)
				below(fabs((double)(gd_row(a->est[c], y)[x] -
						    gd_row(b->est[c], y)[x])), 1e-4);
	done(a);
	done(b);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_frames_are_samples),
		cmocka_unit_test(test_unrelated_frame_does_no_harm),
		cmocka_unit_test(test_order_and_threads),
		cmocka_unit_test(test_firefly_in_another_frame), cmocka_unit_test(test_no_halves),
		cmocka_unit_test(test_counts), cmocka_unit_test(test_even_counts)
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
