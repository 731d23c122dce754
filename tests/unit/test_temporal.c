/* SPDX-License-Identifier: BSD-3-Clause */
/* The filter along time against batch least squares, closed forms, and what it must survive. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <float.h>
#include <math.h>
#include <omp.h>
#include <stdlib.h>
#include <string.h>

#include "rng.h"
#include "temporal.h"

#define SLOPE 0.003	/* share of the colour by which light usually changes per frame */

/* Two states that take turns, and what goes in and out. */
struct seq {
	int w, h, t;
	struct gd_temporal_in in;
	struct gd_temporal_out out;
	struct gd_temporal_state state[2];
	struct gd_temporal_conf conf;
	struct gd_temporal_result result;
	float *block;
};

static void seq_new(struct seq *s, int w, int h)
{
	const size_t size = gd_stride(w) * (size_t)h;
	float *v;

	*s = (struct seq){ .w = w, .h = h, .conf = GD_TEMPORAL_DEFAULTS };
	v = s->block = gd_calloc(size * (15 + 2 * GD_TEMPORAL_PLANES), sizeof *v);
	assert_non_null(v);
	for (int c = 0; c < 3; c++, v += 5 * size) {
		s->in.y[c] = gd_plane_of(v, w, h);
		s->in.mse[c] = gd_plane_of(v + size, w, h);
		s->in.position[c] = gd_plane_of(v + 2 * size, w, h);
		s->out.est[c] = gd_plane_of(v + 3 * size, w, h);
		s->out.mse[c] = gd_plane_of(v + 4 * size, w, h);
	}
	for (int i = 0; i < 2 * GD_TEMPORAL_PLANES; i++, v += size)
		s->state[i / GD_TEMPORAL_PLANES].plane[i % GD_TEMPORAL_PLANES] =
			gd_plane_of(v, w, h);
}

static double noise(int x, int y, int c, int t)
{
	const struct gd_rng_key key = gd_rng_key(7, (uint64_t)t);
	double sum = 0;

	for (uint32_t i = 0; i < 12; i++)
		sum += (double)gd_rng_float(key, (uint32_t)(x * 1024 + y), (uint32_t)c * 12 + i);
	return sum - 6;
}

/* A frame of one colour and error, seen from a place (cx, cy) pixels aside. */
static void fill(struct seq *s, float y, float mse, int cx, int cy)
{
	for (int j = 0; j < s->h; j++)
		for (int i = 0; i < s->w; i++) {
			const float at[] = { 0.1f * (float)(i + cx), 0.1f * (float)(j + cy), 5 };

			for (int c = 0; c < 3; c++) {
				gd_row(s->in.y[c], j)[i] = y;
				gd_row(s->in.mse[c], j)[i] = mse;
				gd_row(s->in.position[c], j)[i] = at[c];
			}
		}
}

static void add_noise(struct seq *s, double sd)
{
	for (int c = 0; c < 3; c++)
		for (int j = 0; j < s->h; j++)
			for (int i = 0; i < s->w; i++)
				gd_row(s->in.y[c], j)[i] += (float)(sd * noise(i, j, c, s->t));
}

static int try_step(struct seq *s, struct gd_err *err)
{
	int rc;

	s->in.previous = s->t ? &s->state[(s->t + 1) % 2] : NULL;
	s->out.state = s->state[s->t % 2];
	rc = gd_temporal_run(&s->out, &s->in, &s->conf, &s->result, NULL, err);
	s->t++;
	return rc;
}

static void step(struct seq *s)
{
	struct gd_err err = { 0 };

	assert_int_equal(try_step(s, &err), GD_OK);
}

static void close_to(double got, double want, double tolerance, const char *what)
{
	if (!(fabs(got - want) <= tolerance))
		fail_msg("%s: %.9g, expected %.9g to within %.2g", what, got, want, tolerance);
}

/* Weighted least squares of value and slope at time n - 1, with a prior at time 0. */
static void batch(const double *y, const double *weight, int n, const double prior[2],
		  double *value, double *slope)
{
	double a00 = 0, a01 = 0, a11 = 0, b0 = 0, b1 = 0, det;

	for (int t = 0; t < n; t++) {
		const double z = t - (n - 1);

		a00 += weight[t];
		a01 += weight[t] * z;
		a11 += weight[t] * z * z;
		b0 += weight[t] * y[t];
		b1 += weight[t] * y[t] * z;
	}
	/* The prior holds (1, 1 - n) of the coefficients at y[0], the slope at 0. */
	a00 += prior[0];
	a01 += prior[0] * (1 - n);
	a11 += prior[0] * (1 - n) * (1 - n) + prior[1];
	b0 += prior[0] * y[0];
	b1 += prior[0] * y[0] * (1 - n);
	det = a00 * a11 - a01 * a01;
	*value = (a11 * b0 - a01 * b1) / det;
	*slope = (a00 * b1 - a01 * b0) / det;
}

/*
 * The recursion is the batch solution with weights lambda^(n-1-t) / s2(t), and what is known at the
 * first frame as old as that.
 */
static void check_batch(bool paper)
{
	enum { N = 40, W = 5, H = 3 };
	static double y[W * H][N];
	double weight[N], prior[W * H], value, slope;
	struct seq s;

	seq_new(&s, W, H);
	s.conf.paper = paper;
	s.conf.radius = s.conf.reach = 0;
	for (int t = 0; t < N; t++) {
		fill(&s, 2, 0.09f * (float)(1 + t % 3), 0, 0);
		add_noise(&s, 0.05);
		for (int i = 0; i < W * H; i++) {
			float *v = &gd_row(s.in.y[1], i / W)[i % W];

			*v += 0.01f * (float)(t * (i % W));
			y[i][t] = (double)*v;
			for (int c = 0; c < 3 && !t; c++)
				prior[i] = (c ? prior[i] : 0) +
					   pow((double)gd_row(s.in.y[c], i / W)[i % W], 2) / 3;
		}
		step(&s);
		assert_int_equal(s.result.changed, 0);
		for (int k = 0; k <= t; k++)
			weight[k] = pow(0.98, t - k) /
				    (paper ? 1 : (double)(0.09f * (float)(1 + k % 3)));
		for (int i = 0; i < W * H; i++) {
			const double of_slope = paper ? 1e-3 : 1 / (SLOPE * SLOPE * prior[i]);
			const double known[] = { (paper ? 1e-3 : 0) * pow(0.98, t),
						 of_slope * pow(0.98, t) };

			batch(y[i], weight, t + 1, known, &value, &slope);
			close_to((double)gd_row(s.out.est[1], i / W)[i % W], value, 1e-6 * value,
				 "value");
			close_to((double)gd_row(s.out.state.plane[GD_TEMPORAL_SLOPE + 1],
						i / W)[i % W], slope, 1e-6 * value, "slope");
		}
	}
	free(s.block);
}

static void test_batch(void **state)
{
	(void)state;
	check_batch(true);
	check_batch(false);
}

/*
 * Still scene: the variance of the value of a line, fitted with weights lambda^k to endless noise,
 * is (1 - l)(1 + 4 l + 5 l^2) / (1 + l)^3 of one frame's.
 */
static void test_variance(void **state)
{
	enum { N = 300, W = 40, H = 30 };
	const double l = 0.98, want = (1 - l) * (1 + 4 * l + 5 * l * l) / pow(1 + l, 3);
	double sum2 = 0;
	struct seq s;

	(void)state;
	seq_new(&s, W, H);
	s.conf.paper = true;
	s.conf.radius = 0;
	for (int t = 0; t < N; t++) {
		fill(&s, 3, 0.01f, 0, 0);
		add_noise(&s, 0.1);
		step(&s);
	}
	for (int i = 0; i < 3 * W * H; i++)
		sum2 += pow((double)gd_row(s.out.est[i % 3], i / 3 / W)[i / 3 % W] - 3, 2);
	/* 3600 samples: their variance is uncertain by 2.4 %. */
	close_to(sum2 / (3 * W * H) / 0.01, want, 0.1 * want, "variance");
	/* What it reckons with is 1 - l^2: that old frames are less sure, not only weigh less. */
	close_to((double)gd_row(s.out.mse[0], 9)[9] / 0.01, 1 - l * l, 0.05 * (1 - l * l),
		 "its error");
	free(s.block);
}

/*
 * By default a slope is held back, and the variance lower: that of the batch solution, the sum of
 * the squared weights that frames have in it.
 */
static void test_still(void **state)
{
	enum { N = 16, W = 40, H = 30 };
	const double prior[] = { 0, pow(0.98, N - 1) * 0.01 / pow(SLOPE * 3, 2) };
	double sum2 = 0, want = 0, weight[N], slope;
	struct seq s;

	(void)state;
	for (int t = 0; t < N; t++)
		weight[t] = pow(0.98, N - 1 - t);
	for (int t = 0; t < N; t++) {
		double impulse[N] = { 0 }, value;

		impulse[t] = 1;
		batch(impulse, weight, N, prior, &value, &slope);
		want += value * value;
	}
	seq_new(&s, W, H);
	for (int t = 0; t < N; t++) {
		fill(&s, 3, 0.01f, 0, 0);
		add_noise(&s, 0.1);
		step(&s);
	}
	for (int i = 0; i < 3 * W * H; i++)
		sum2 += pow((double)gd_row(s.out.est[i % 3], i / 3 / W)[i / 3 % W] - 3, 2);
	sum2 /= 3 * W * H;
	close_to(sum2 / 0.01, want, 0.15 * want, "variance");
	close_to((double)gd_row(s.out.mse[0], 9)[9], sum2, 0.3 * sum2, "estimated error");
	free(s.block);
}

/* A line in time: as printed to within what delta holds back, by default within a lag. */
static void test_ramp(void **state)
{
	(void)state;
	for (int paper = 0; paper < 2; paper++) {
		struct seq s;

		seq_new(&s, 12, 9);
		s.conf.paper = paper;
		for (int t = 0; t < 30; t++) {
			const double y = 1 + 0.05 * t;

			fill(&s, (float)y, 1e-4f, 0, 0);
			step(&s);
			if (t > 2)
				close_to((double)gd_row(s.out.est[0], 4)[5], y,
					 (paper ? 1e-4 : 0.02) * y, "ramp");
		}
		if (paper)
			close_to((double)gd_row(s.out.state.plane[GD_TEMPORAL_SLOPE], 4)[5], 0.05,
				 1e-4, "slope");
		free(s.block);
	}
}

/* Everything gets brighter at once: followed, without giving up what was averaged. */
static void test_light(void **state)
{
	enum { W = 96, H = 64 };
	double sum2 = 0, sum = 0;
	struct seq s;

	(void)state;
	seq_new(&s, W, H);
	for (int t = 0; t < 16; t++) {
		fill(&s, 1, 0.01f, 0, 0);
		add_noise(&s, 0.1);
		for (int i = 0; i < 3 * W * H && t == 15; i++) {
			gd_row(s.in.y[i % 3], i / 3 / W)[i / 3 % W] *= 2;
			gd_row(s.in.mse[i % 3], i / 3 / W)[i / 3 % W] *= 4;
		}
		step(&s);
	}
	for (int i = 0; i < 3 * W * H; i++) {
		const double e = (double)gd_row(s.out.est[i % 3], i / 3 / W)[i / 3 % W] / 2 - 1;

		sum += e / (3 * W * H);
		sum2 += e * e / (3 * W * H);
	}
	close_to(sum, 0, 0.005, "mean");
	assert_true(sum2 < 0.01 / 6);
	free(s.block);
}

/* A part that changes is followed within a frame or two, the rest goes on as it was. */
static void test_change(void **state)
{
	enum { W = 80, H = 60 };
	double rest = 0, before = 0;
	struct seq s;

	(void)state;
	seq_new(&s, W, H);
	for (int t = 0; t < 17; t++) {
		fill(&s, 1, 0.01f, 0, 0);
		add_noise(&s, 0.1);
		for (int y = 20; y < 40; y++)
			for (int x = 20; x < 40 && t > 14; x++)
				gd_row(s.in.y[0], y)[x] += 2;
		step(&s);
		rest = 0;
		for (int x = 60; x < 80; x++)
			rest += pow((double)gd_row(s.out.est[0], 5)[x] - 1, 2) / 20;
		if (t == 14)
			before = rest;
	}
	close_to((double)gd_row(s.out.est[0], 30)[30], 3, 0.3, "changed");
	assert_true(rest < 2 * before);
	free(s.block);
}

/* A camera that pans: what is seen again goes on, also beyond the search window. */
static void test_pan(void **state)
{
	(void)state;
	for (int pan = 2; pan <= 22; pan += 5) {
		struct seq s;
		int old = 0;

		seq_new(&s, 90, 40);
		for (int t = 0; t < 3; t++) {
			fill(&s, 1, 0.01f, pan * t, 0);
			for (int i = 0; i < 90 * 40; i++) {
				const int x = i % 90 + pan * t, y = i / 90;

				gd_row(s.in.y[0], y)[i % 90] = (float)(1 + (x / 7 + y / 5) % 2);
			}
			step(&s);
		}
		for (int i = 0; i < 90 * 40; i++) {
			const float n =
				gd_row(s.out.state.plane[GD_TEMPORAL_FRAMES], i / 90)[i % 90];

			old += n == 3;
			if (i % 90 < 90 - 2 * pan - 3)	/* seen in all frames */
				close_to((double)gd_row(s.out.est[0], i / 90)[i % 90],
					 (double)gd_row(s.in.y[0], i / 90)[i % 90], 1e-5, "panned");
		}
		assert_true(old >= (90 - 2 * pan) * 40);
		assert_true(s.result.fresh >= (size_t)((pan > 4 ? pan - 4 : 0) * 40));
		free(s.block);
	}
}

/* What was hidden starts anew, and knows as much of its error as the frame alone. */
static void test_uncovered(void **state)
{
	struct seq s;

	(void)state;
	seq_new(&s, 30, 20);
	for (int t = 0; t < 5; t++) {
		fill(&s, 1, 0.01f, 0, 0);
		for (int y = 5; y < 15; y++)
			for (int x = 10; x < 20; x++) {
				gd_row(s.in.position[2], y)[x] = t < 4 ? 2 : 50;
				gd_row(s.in.y[0], y)[x] = t < 4 ? 1 : 9;
			}
		step(&s);
	}
	/* corners may be smoothed */
	assert_true(s.result.fresh >= 88 && s.result.fresh <= 100);
	close_to((double)gd_row(s.out.est[0], 9)[14], 9, 0, "uncovered");
	close_to((double)gd_row(s.out.mse[0], 9)[14], 0.01, 1e-8, "its error");
	close_to((double)gd_row(s.out.mse[0], 18)[29], 0.002, 0.001, "error elsewhere");
	free(s.block);
}

static void check_finite(const struct seq *s)
{
	for (int y = 0; y < s->h; y++)
		for (int x = 0; x < s->w; x++) {
			for (int c = 0; c < 3; c++) {
				assert_true(isfinite(gd_row(s->out.est[c], y)[x]));
				assert_true(isfinite(gd_row(s->out.mse[c], y)[x]));
				assert_true(gd_row(s->out.mse[c], y)[x] >= 0);
			}
			for (int i = 0; i < GD_TEMPORAL_PLANES; i++)
				assert_true(isfinite(gd_row(s->out.state.plane[i], y)[x]));
			assert_true(gd_row(s->out.state.plane[GD_TEMPORAL_P], y)[x] >= 0);
			assert_true(gd_row(s->out.state.plane[GD_TEMPORAL_P + 2], y)[x] >= 0);
		}
}

/* Thousands of frames, some of them without error or beyond all measure: nothing runs away. */
static void test_endless(void **state)
{
	(void)state;
	for (int paper = 0; paper < 2; paper++) {
		struct seq s;

		seq_new(&s, 7, 5);
		s.conf.paper = paper;
		s.conf.reach = 0;
		for (int t = 0; t < 3000; t++) {
			fill(&s, 1, t % 50 ? 0.04f : 0, t % 3, 0);
			add_noise(&s, 0.2);
			if (t % 997 == 500)
				gd_row(s.in.y[1], 2)[3] = 1e30f;
			step(&s);
			check_finite(&s);
			if (t % 997 < 500 && !paper)
				for (int x = 0; x < 7; x++)
					assert_true(fabsf(gd_row(s.out.est[0], 2)[x] - 1) < 1.5f);
		}
		free(s.block);
	}
}

/* A state that was damaged on its way: those pixels are new, the others go on. */
static void test_damaged(void **state)
{
	static const float bad[] = { NAN, INFINITY, -INFINITY, FLT_MAX };
	struct seq s;

	(void)state;
	seq_new(&s, 40, 30);
	for (int t = 0; t < 3; t++) {
		fill(&s, 1, 0.01f, 0, 0);
		add_noise(&s, 0.1);
		step(&s);
	}
	for (int i = 0; i < GD_TEMPORAL_PLANES; i++)
		for (int x = 0; x < 40; x++)
			gd_row(s.out.state.plane[i], 2 * i)[x] = bad[i % 4];
	for (int x = 0; x < 40; x++)
		gd_row(s.out.state.plane[GD_TEMPORAL_P], 28)[x] = -1;
	step(&s);
	check_finite(&s);
	for (int y = 0; y < 30; y++)
		for (int x = 0; x < 40; x++)
			assert_true(fabsf(gd_row(s.out.est[1], y)[x] - 1) < 0.6f);
	for (int i = 0; i < GD_TEMPORAL_PLANES * 40 * 30; i++)
		gd_row(s.out.state.plane[i / 1200], i / 40 % 30)[i % 40] = NAN;
	step(&s);
	check_finite(&s);
	assert_int_equal(s.result.fresh, 40 * 30);
	free(s.block);
}

/* A state whose variances a change of all light would take beyond floats. */
static void test_too_uncertain(void **state)
{
	struct seq s;

	(void)state;
	seq_new(&s, 64, 64);
	fill(&s, 1e17f, 1e32f, 0, 0);
	step(&s);
	for (int y = 0; y < 64; y++)
		for (int x = 0; x < 64; x++)
			gd_row(s.out.state.plane[GD_TEMPORAL_P], y)[x] = 1e36f;
	fill(&s, 5e18f, 1e32f, 0, 0);
	step(&s);
	check_finite(&s);
	free(s.block);
}

/* Input that is no number, and images of any size and kind. */
static void test_extremes(void **state)
{
	static const int size[][2] = { { 1, 1 }, { 1, 13 }, { 13, 1 }, { 2, 2 }, { 37, 23 } };
	static const float value[] = { 0, 1e30f, -1, NAN, INFINITY, 1e-40f, FLT_MAX };

	(void)state;
	for (size_t i = 0; i < 5 * 7 * 3; i++) {
		const float v = value[i / 5 % 7];
		struct seq s;

		seq_new(&s, size[i % 5][0], size[i % 5][1]);
		for (int t = 0; t < 4; t++) {
			fill(&s, 1, 0.01f, 0, 0);
			add_noise(&s, 0.1);
			for (int k = 0; k < s.w * s.h; k += 1 + (int)(i / 35) * 3) {
				const int x = k % s.w, y = k / s.w;

				gd_row(s.in.y[k % 3], y)[x] = v;
				gd_row(s.in.mse[0], y)[x] = t % 2 ? v : 0;
				gd_row(s.in.position[t % 3], y)[x] = v;
			}
			step(&s);
			check_finite(&s);
		}
		free(s.block);
	}
}

/* The sky has no positions: it is followed by its place. Nor has a wall that is one point. */
static void test_nowhere(void **state)
{
	(void)state;
	for (int sky = 0; sky < 2; sky++) {
		struct seq s;

		seq_new(&s, 20, 16);
		for (int t = 0; t < 8; t++) {
			fill(&s, 1, 0.01f, 0, 0);
			for (int i = 0; i < 3 * 20 * 16; i++)
				gd_row(s.in.position[i % 3], i / 60)[i / 3 % 20] = sky ? 0 : 3;
			for (int y = 0; y < 16; y++)
				gd_row(s.in.y[0], y)[7] = 5;
			step(&s);
		}
		assert_int_equal(s.result.fresh, 0);
		close_to((double)gd_row(s.out.est[0], 3)[7], 5, 0.01, "bright column");
		close_to((double)gd_row(s.out.est[0], 3)[8], 1, 0.01, "beside it");
		free(s.block);
	}
}

static void test_no_error(void **state)
{
	struct seq s;

	(void)state;
	seq_new(&s, 30, 20);
	for (int c = 0; c < 3; c++)
		s.in.mse[c].v = s.out.mse[c].v = NULL;
	for (int t = 0; t < 8; t++) {
		for (int i = 0; i < 3 * 30 * 20; i++) {
			const int x = i / 3 % 30, y = i / 90;

			gd_row(s.in.y[i % 3], y)[x] = 1;
			gd_row(s.in.position[i % 3], y)[x] =
				(float)(i % 3 == 0 ? x : i % 3 == 1 ? y : 9);
		}
		add_noise(&s, 0.1);
		step(&s);
	}
	close_to(s.result.mean_frames, 8, 1e-9, "followed");
	free(s.block);
}

/* One sequence, seen as it is, mirrored, brighter, and by other numbers of threads. */
static void make(struct seq *s, bool mirror, float scale, int t)
{
	fill(s, 1, 0.01f, 0, 0);
	for (int i = 0; i < 3 * s->w * s->h; i++) {
		const int c = i % 3, x = i / 3 % s->w, y = i / 3 / s->w;
		const int to = mirror ? s->w - 1 - x : x;
		const double moved = x + 2 * t, base = 1 + 0.5 * sin(moved / 4 + c) * cos(y / 3.0);

		gd_row(s->in.y[c], y)[to] = scale * (float)(base + 0.1 * noise(x, y, c, t));
		gd_row(s->in.mse[c], y)[to] = scale * scale * 0.01f;
		gd_row(s->in.position[0], y)[to] = (float)(0.1 * moved);
		gd_row(s->in.position[1], y)[to] = (float)(0.1 * y + 0.013 * x);
		gd_row(s->in.position[2], y)[to] = 4;
	}
}

static void compare(bool mirror, float scale, int threads, double tolerance)
{
	const int before = omp_get_max_threads();
	struct seq a, b;

	seq_new(&a, 50, 33);
	seq_new(&b, 50, 33);
	for (int t = 0; t < 5; t++) {
		make(&a, false, 1, t);
		make(&b, mirror, scale, t);
		step(&a);
		omp_set_num_threads(threads);
		step(&b);
		omp_set_num_threads(before);
		for (int i = 0; i < 3 * 50 * 33; i++) {
			const int c = i % 3, x = i / 3 % 50, y = i / 150, to = mirror ? 49 - x : x;

			close_to((double)gd_row(b.out.est[c], y)[to],
				 (double)(scale * gd_row(a.out.est[c], y)[x]),
				 tolerance * (double)scale, "value");
			close_to((double)gd_row(b.out.mse[c], y)[to],
				 (double)(scale * scale * gd_row(a.out.mse[c], y)[x]),
				 tolerance * (double)(scale * scale), "error");
		}
	}
	free(a.block);
	free(b.block);
}

static void test_alike(void **state)
{
	(void)state;
	compare(true, 1, 2, 1e-5);
	compare(false, 1024, 2, 0);
	compare(false, 0x1p-20f, 2, 0);
	compare(false, 1, 1, 0);
	compare(false, 1, 7, 0);
}

/* The result may go where the input is. */
static void test_in_place(void **state)
{
	struct seq a, b;

	(void)state;
	seq_new(&a, 50, 33);
	seq_new(&b, 50, 33);
	for (int c = 0; c < 3; c++) {
		b.out.est[c] = b.in.y[c];
		b.out.mse[c] = b.in.mse[c];
	}
	for (int t = 0; t < 4; t++) {
		make(&a, false, 1, t);
		make(&b, false, 1, t);
		step(&a);
		step(&b);
		for (int i = 0; i < 3 * 50 * 33; i++) {
			const int x = i / 3 % 50, y = i / 150;

			close_to((double)gd_row(b.in.y[i % 3], y)[x],
				 (double)gd_row(a.out.est[i % 3], y)[x], 0, "in place");
			close_to((double)gd_row(b.in.mse[i % 3], y)[x],
				 (double)gd_row(a.out.mse[i % 3], y)[x], 0, "error in place");
		}
	}
	free(a.block);
	free(b.block);
}

static void test_channels(void **state)
{
	struct gd_temporal_state made, seen;
	struct gd_image im = { 0 };
	struct gd_err err = { 0 };

	(void)state;
	gd_image_init(&im, 6, 4);
	assert_int_equal(gd_temporal_add(&made, &im, &err), GD_OK);
	assert_int_equal(im.nchan, GD_TEMPORAL_PLANES);
	assert_string_equal(gd_temporal_channel(0), "state.value.R");
	assert_null(gd_temporal_channel(-1));
	assert_null(gd_temporal_channel(GD_TEMPORAL_PLANES));
	assert_int_equal(gd_temporal_view(&seen, &im, &err), GD_OK);
	for (int i = 0; i < GD_TEMPORAL_PLANES; i++) {
		assert_true(gd_image_find(&im, gd_temporal_channel(i)) >= 0);
		assert_ptr_equal(seen.plane[i].v, made.plane[i].v);
	}
	assert_int_equal(gd_image_append(&im, "other", GD_HALF, &err), GD_OK);
	assert_int_equal(gd_temporal_want(&im, &err), GD_OK);
	assert_int_equal(im.chan[gd_image_find(&im, "other")].want, GD_DROP);
	assert_int_equal(im.chan[gd_image_find(&im, "state.P.01")].want, GD_READ);
	gd_image_drop(&im, "state.P.01");
	assert_int_equal(gd_temporal_want(&im, &err), GD_ESHAPE);
	assert_non_null(strstr(err.text, "state.P.01"));
	err = (struct gd_err){ 0 };
	assert_int_equal(gd_temporal_view(&seen, &im, &err), GD_ESHAPE);
	assert_non_null(strstr(err.text, "state.P.01"));
	gd_image_free(&im);
}

static void test_refusals(void **state)
{
	static const struct gd_temporal_conf bad[] = {
		{ .forget = 0.4 }, { .forget = 1.01 }, { .forget = NAN },
		{ .forget = 1, .radius = -1 }, { .forget = 1, .radius = GD_TEMPORAL_RADIUS + 1 },
		{ .forget = 1, .reach = -1 }, { .forget = 1, .reach = GD_TEMPORAL_REACH + 1 }
	};
	struct gd_err err = { 0 };
	struct seq a, b;

	(void)state;
	seq_new(&a, 8, 6);
	seq_new(&b, 5, 4);
	fill(&a, 1, 0.1f, 0, 0);
	for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
		a.conf = bad[i];
		assert_int_equal(try_step(&a, &(struct gd_err){ 0 }), GD_EARG);
	}
	a.conf = GD_TEMPORAL_DEFAULTS;
	a.in.previous = &b.state[0];
	a.out.state = a.state[0];
	assert_int_equal(gd_temporal_run(&a.out, &a.in, &a.conf, &a.result, NULL, &err), GD_ESHAPE);
	assert_non_null(strstr(err.text, "state.value.R is 5x4, expected 8x6"));
	free(a.block);
	free(b.block);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_batch),
		cmocka_unit_test(test_variance),
		cmocka_unit_test(test_still),
		cmocka_unit_test(test_ramp),
		cmocka_unit_test(test_light),
		cmocka_unit_test(test_change),
		cmocka_unit_test(test_pan),
		cmocka_unit_test(test_uncovered),
		cmocka_unit_test(test_endless),
		cmocka_unit_test(test_damaged),
		cmocka_unit_test(test_too_uncertain),
		cmocka_unit_test(test_extremes),
		cmocka_unit_test(test_nowhere),
		cmocka_unit_test(test_no_error),
		cmocka_unit_test(test_alike),
		cmocka_unit_test(test_in_place),
		cmocka_unit_test(test_channels),
		cmocka_unit_test(test_refusals),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
