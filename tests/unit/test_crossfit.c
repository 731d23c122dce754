/* SPDX-License-Identifier: BSD-3-Clause */
/* Cross-fitted regression against images whose truth is known. */
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

#define W 70
#define H 54
#define FEATURES 3

static float draw(unsigned seed, int c, int x, int y)
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
	return (float)(sum * 1.7320508);
}

struct job {
	int w, h;
	struct gd_plane truth[3], est[9], mse[3], spread;
	struct gd_crossfit_in in;
	struct gd_crossfit_result result;
};

static struct gd_plane plane(int w, int h)
{
	return gd_plane_of(gd_calloc(gd_stride(w) * (size_t)h, sizeof(float)), w, h);
}

static double feature(int a, int x, int y)
{
	return a == 0	? (x / 9 + y / 7) % 3
	       : a == 1 ? sin(0.2 * x) * cos(0.15 * y)
			: 0.02 * (x + y);
}

/* Radiance that G-buffers explain wholly (bend 0), or less and less. */
static double truth(int c, int x, int y, double bend)
{
	double v = 1.5 + 0.4 * feature(0, x, y) + 0.2 * (c + 1) * feature(1, x, y);

	return v + bend * ((x - 30) * (x - 30) + (y - 20) * (y - 20) < 150) + 0.1 * c;
}

static struct job *make(int w, int h, int ny, double sigma, double bend)
{
	struct job *j = calloc(1, sizeof *j);

	*j = (struct job){ .w = w, .h = h, .in = { .ny = ny, .nfeat = FEATURES }, .spread = plane(w, h) };
	for (int c = 0; c < ny; c++) {
		j->est[c] = plane(w, h);
		j->in.y[0][c] = plane(w, h);
		j->in.y[1][c] = plane(w, h);
	}
	for (int a = 0; a < FEATURES; a++)
		j->in.feat[a] = plane(w, h);
	for (int c = 0; c < 3; c++) {
		j->truth[c] = plane(w, h);
		j->mse[c] = plane(w, h);
		j->in.var[c] = plane(w, h);
	}
	for (int y = 0; y < h; y++)
		for (int x = 0; x < w; x++) {
			for (int a = 0; a < FEATURES; a++)
				gd_row(j->in.feat[a], y)[x] = (float)feature(a, x, y);
			for (int c = 0; c < 3; c++) {
				double t = truth(c, x, y, bend);

				gd_row(j->truth[c], y)[x] = (float)t;
				gd_row(j->in.var[c], y)[x] = (float)(sigma * sigma / 2);
				for (int half = 0; half < 2; half++)
					gd_row(j->in.y[half][c], y)[x] =
						(float)(t + sigma * (double)draw((unsigned)half, c,
										 x, y));
			}
		}
	return j;
}

static void run(struct job *j, bool fast)
{
	struct gd_crossfit_conf conf = { fast };
	struct gd_crossfit_out out = { j->est, j->mse, j->spread };
	struct gd_err err = { 0 };

	assert_int_equal(gd_crossfit_run(&out, &j->in, &conf, &j->result, NULL, &err), GD_OK);
}

static void done(struct job *j)
{
	for (int c = 0; c < 9; c++)
		free(j->est[c].v);
	for (int c = 0; c < 9; c++) {
		free(j->in.y[0][c].v);
		free(j->in.y[1][c].v);
	}
	for (int a = 0; a < FEATURES; a++)
		free(j->in.feat[a].v);
	for (int c = 0; c < 3; c++) {
		free(j->truth[c].v);
		free(j->mse[c].v);
		free(j->in.var[c].v);
	}
	free(j->spread.v);
	free(j);
}

static double mean(struct gd_plane p)
{
	double s = 0;

	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++)
			s += (double)gd_row(p, y)[x];
	return s / p.w / p.h;
}

static double square_error(const struct job *j)
{
	double s = 0;

	for (int c = 0; c < 3; c++)
		for (int y = 0; y < j->h; y++)
			for (int x = 0; x < j->w; x++)
				s += pow((double)gd_row(j->est[c], y)[x] -
					 (double)gd_row(j->truth[c], y)[x], 2);
	return s / (3.0 * j->w * j->h);
}

static double most_off(struct gd_plane a, struct gd_plane b)
{
	double most = 0;

	for (int y = 0; y < a.h; y++)
		for (int x = 0; x < a.w; x++)
			most = fmax(most, fabs((double)gd_row(a, y)[x] - (double)gd_row(b, y)[x]));
	return most;
}

/* a less than b, with both in the message. */
static void below(double a, double b)
{
	if (!(a < b))
		fail_msg("%g, expected below %g", a, b);
}

static void assert_sane(const struct job *j)
{
	for (int y = 0; y < j->h; y++)
		for (int x = 0; x < j->w; x++) {
			for (int c = 0; c < 3; c++) {
				assert_true(isfinite(gd_row(j->est[c], y)[x]));
				assert_true(isfinite(gd_row(j->mse[c], y)[x]));
				assert_true(gd_row(j->mse[c], y)[x] >= 0);
			}
			assert_true(isfinite(gd_row(j->spread, y)[x]));
		}
}

static void test_linear_image_is_reproduced(void **state)
{
	struct job *j = make(W, H, 3, 0, 0);

	(void)state;
	run(j, false);
	for (int c = 0; c < 3; c++)
		below(most_off(j->est[c], j->truth[c]), 2e-3);
	assert_int_equal(j->result.models, 4);
	done(j);
	j = make(W, H, 3, 0, 0);
	run(j, true);
	for (int c = 0; c < 3; c++)
		below(most_off(j->est[c], j->truth[c]), 2e-3);
	assert_int_equal(j->result.models, 1);
	assert_true(mean(j->spread) == 0);	/* of one model */
	done(j);
}

static void test_constant_image(void **state)
{
	struct job *j = make(W, H, 3, 0, 0);

	(void)state;
	for (int c = 0; c < 3; c++)
		for (int y = 0; y < H; y++)
			for (int x = 0; x < W; x++) {
				gd_row(j->in.y[0][c], y)[x] = gd_row(j->in.y[1][c], y)[x] = 0.25f;
				gd_row(j->truth[c], y)[x] = 0.25f;
			}
	run(j, false);
	for (int c = 0; c < 3; c++) {
		below(most_off(j->est[c], j->truth[c]), 1e-5);
		below(mean(j->mse[c]), 1e-9);
	}
	done(j);
}

/* Where the model is right, only the noise counts: four times the variance, four times the error. */
static void test_error_falls_with_noise(void **state)
{
	double e[2], sigma[2] = { 0.2, 0.4 }, own[2];

	(void)state;
	for (int i = 0; i < 2; i++) {
		struct job *j = make(W, H, 3, sigma[i], 0);

		run(j, false);
		e[i] = square_error(j);
		own[i] = (mean(j->mse[0]) + mean(j->mse[1]) + mean(j->mse[2])) / 3;
		below(e[i], sigma[i] * sigma[i] / 2 / 15);	/* of the mean of both halves */
		below(own[i],
		      4 * e[i]); /* models that err alike are not told from ones that do not */
		below(e[i], 2 * own[i]);
		for (int c = 0; c < 3; c++)
			below(fabs(mean(j->est[c]) / mean(j->truth[c]) - 1), 0.005 + sigma[i] / 50);
		done(j);
	}
	below(e[1] / e[0], 5);
	below(3, e[1] / e[0]);
}

static void test_what_features_miss(void **state)
{
	struct job *j = make(W, H, 3, 0.2, 1);
	double sum = 0, all = 0;

	(void)state;
	for (int c = 0; c < 3; c++)
		sum += (mean(j->in.y[0][c]) + mean(j->in.y[1][c])) / 2;
	run(j, false);
	for (int c = 0; c < 3; c++)
		all += mean(j->est[c]);
	below(square_error(j), 0.02 / 4);
	below(fabs(all / sum - 1), 1e-5);	/* no firefly, so the mean is kept to rounding */
	below(0, mean(j->spread));
	done(j);
}

static void swap(struct gd_plane *a, struct gd_plane *b)
{
	struct gd_plane t = *a;

	*a = *b;
	*b = t;
}

static void test_halves_swapped(void **state)
{
	struct job *a = make(W, H, 3, 0.3, 0.5), *b = make(W, H, 3, 0.3, 0.5);

	(void)state;
	for (int c = 0; c < 3; c++)
		swap(&b->in.y[0][c], &b->in.y[1][c]);
	run(a, false);
	run(b, false);
	for (int c = 0; c < 3; c++) {
		below(most_off(a->est[c], b->est[c]), 2e-6 * 4);
		below(most_off(a->mse[c], b->mse[c]), 1e-6);
	}
	done(a);
	done(b);
}

/* The value at x, y of the image mirrored (1: x, 2: y). */
static void mirror(struct gd_plane p, int how)
{
	struct gd_plane t = plane(p.w, p.h);

	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++)
			gd_row(t, y)[x] =
				gd_row(p, how == 2 ? p.h - 1 - y : y)[how == 1 ? p.w - 1 - x : x];
	memcpy(p.v, t.v, p.stride * (size_t)p.h * sizeof(float));
	free(t.v);
}

static void transpose(struct gd_plane *p)
{
	struct gd_plane t = plane(p->h, p->w);

	for (int y = 0; y < p->h; y++)
		for (int x = 0; x < p->w; x++)
			gd_row(t, x)[y] = gd_row(*p, y)[x];
	free(p->v);
	*p = t;
}

static void turn(struct gd_plane *p, int how)
{
	if (how == 3)
		transpose(p);
	else
		mirror(*p, how);
}

static void test_turned(void **state)
{
	struct job *a = make(W, H, 3, 0.3, 0.5);

	(void)state;
	run(a, false);
	for (int how = 1; how <= 3; how++) {
		struct job *b = make(W, H, 3, 0.3, 0.5);

		for (int c = 0; c < 3; c++) {
			turn(&b->in.y[0][c], how);
			turn(&b->in.y[1][c], how);
			turn(&b->in.var[c], how);
			turn(&b->in.feat[c], how);
			turn(&b->est[c], how);
			turn(&b->mse[c], how);
		}
		turn(&b->spread, how);
		run(b, false);
		for (int c = 0; c < 3; c++) {
			turn(&b->est[c], how);
			below(most_off(a->est[c], b->est[c]), 1e-4);
		}
		done(b);
	}
	done(a);
}

static void test_channels_permuted(void **state)
{
	struct job *a = make(W, H, 3, 0.3, 0.5), *b = make(W, H, 3, 0.3, 0.5);

	(void)state;
	for (int half = 0; half < 2; half++)
		swap(&b->in.y[half][0], &b->in.y[half][2]);
	run(a, false);
	run(b, false);
	for (int c = 0; c < 3; c++)
		below(most_off(a->est[c], b->est[2 - c]), 1e-4);
	done(a);
	done(b);
}

static void test_scaled(void **state)
{
	static const float scales[] = { 1e-12f, 1e-3f, 1024, 1e12f };
	struct job *a = make(W, H, 3, 0.3, 0.5);

	(void)state;
	run(a, false);
	for (int i = 0; i < 4; i++) {
		struct job *b = make(W, H, 3, 0.3, 0.5);
		float s = scales[i];

		for (int c = 0; c < 3; c++)
			for (int y = 0; y < H; y++)
				for (int x = 0; x < W; x++) {
					gd_row(b->in.y[0][c], y)[x] *= s;
					gd_row(b->in.y[1][c], y)[x] *= s;
					gd_row(b->in.var[c], y)[x] *= s * s;
				}
		run(b, false);
		for (int c = 0; c < 3; c++) {
			for (int y = 0; y < H; y++)
				for (int x = 0; x < W; x++)
					gd_row(b->est[c], y)[x] /= s;
			below(most_off(a->est[c], b->est[c]), 2e-4);
			below(fabs(mean(b->mse[c]) / ((double)s * (double)s) / mean(a->mse[c]) - 1),
			      1e-3);
		}
		done(b);
	}
	done(a);
}

static void test_threads(void **state)
{
	struct job *a = make(W, H, 3, 0.3, 0.5);
	int was = omp_get_max_threads();

	(void)state;
	omp_set_num_threads(1);
	run(a, false);
	for (int n = 2; n <= 7; n += 5) {
		struct job *b = make(W, H, 3, 0.3, 0.5);

		omp_set_num_threads(n);
		run(b, false);
		for (int c = 0; c < 3; c++) {
			assert_true(most_off(a->est[c], b->est[c]) == 0);
			assert_true(most_off(a->mse[c], b->mse[c]) == 0);
		}
		done(b);
	}
	omp_set_num_threads(was);
	done(a);
}

/* Planes 3..5 and 6..8 add up to the colour before and after. */
static void test_layers_add_up(void **state)
{
	struct job *j = make(W, H, 9, 0.3, 0.5);

	(void)state;
	for (int whole = 0; whole < 2; whole++) {
		for (int half = 0; half < 2; half++)
			for (int c = 0; c < 3; c++)
				for (int y = 0; y < H; y++)
					for (int x = 0; x < W; x++) {
						float all = gd_row(j->in.y[half][c], y)[x];
						float part = 0.3f * all + draw(9, c, x, y) * 0.1f;

						gd_row(j->in.y[half][3 + c], y)[x] = part;
						gd_row(j->in.y[half][6 + c], y)[x] = all - part;
					}
		if (whole) {
			j->in.ny = 3;
			j->in.nwhole = 9;
			memcpy(j->in.whole, j->in.y[0], sizeof j->in.whole);
		}
		run(j, false);
		for (int c = 0; c < 3; c++)
			for (int y = 0; y < H; y++)
				for (int x = 0; x < W; x++)
					below(fabs((double)gd_row(j->est[c], y)[x] -
						   (double)gd_row(j->est[3 + c], y)[x] -
						   (double)gd_row(j->est[6 + c], y)[x]), 2e-5);
	}
	done(j);
}

/* A half of twice the samples counts twice. */
static void test_shares(void **state)
{
	struct job *even = make(W, H, 3, 0.3, 0), *odd = make(W, H, 3, 0.3, 0);
	struct gd_crossfit_conf conf = { false };

	(void)state;
	for (int i = 0; i < 2; i++) {
		struct job *j = i ? odd : even;

		for (int c = 0; c < 3; c++)
			for (int y = 0; y < H; y++)
				for (int x = 0; x < W; x++) /* the second: 4 times the variance */
					gd_row(j->in.y[1][c], y)[x] += gd_row(j->in.y[1][c], y)[x] -
								       gd_row(j->truth[c], y)[x];
	}
	odd->in.share[0] = 0.8;
	odd->in.share[1] = 0.2;
	for (int c = 0; c < 3; c++) {
		free(even->in.var[c].v);
		free(odd->in.var[c].v);
		even->in.var[c].v = odd->in.var[c].v = NULL;
	}
	run(even, false);
	run(odd, false);
	below(square_error(odd), 0.85 * square_error(even)); /* 0.072 against 0.1125 of the noise */
	below(mean(odd->mse[0]), 4 * square_error(odd));
	below(square_error(odd), 2 * mean(odd->mse[0]));
	odd->in.share[0] = 0.9;
	assert_int_equal(gd_crossfit_run(&(struct gd_crossfit_out){odd->est, odd->mse, odd->spread},
					 &odd->in, &conf, &odd->result, NULL, NULL),
			 GD_EARG);
	done(even);
	done(odd);
}

static void test_no_halves(void **state)
{
	struct job *j = make(W, H, 3, 0.2, 0.5);

	(void)state;
	j->in.self = true;
	for (int c = 0; c < 3; c++)
		for (int y = 0; y < H; y++)
			for (int x = 0; x < W; x++)
				gd_row(j->in.var[c], y)[x] = 0.04f;
	run(j, false);
	below(square_error(j), 0.04 / 4);
	below(mean(j->mse[0]), 4 * square_error(j));
	below(square_error(j), 4 * mean(j->mse[0]));
	done(j);
}

/* ---- what renders may hold ---- */

static void set(struct job *j, int half, int x, int y, float v)
{
	for (int c = 0; c < 3; c++)
		gd_row(j->in.y[half][c], y)[x] = v;
}

static void test_fireflies(void **state)
{
	static const float bright[] = { 1e4f, 1e19f, 1e30f, FLT_MAX };

	(void)state;
	for (int i = 0; i < 4; i++)
		for (int v = 0; v < 2; v++) {
			struct job *j = make(W, H, 3, 0.3, 0);

			set(j, 0, 33, 20, bright[i]);
			set(j, 1, 8, 40, bright[i]);
			for (int c = 0; c < 3; c++) {
				double half = (double)bright[i] / 2;

				gd_row(j->in.var[c], 20)[33] = (float)fmin(half * half, FLT_MAX);
				gd_row(j->in.var[c], 40)[8] = (float)fmin(half * half, FLT_MAX);
				if (v) {
					free(j->in.var[c].v);
					j->in.var[c].v = NULL;
				}
			}
			run(j, false);
			assert_sane(j);
			for (int c = 0; c < 3; c++)	/* cut to some thousands, then spread */
				for (int y = 0; y < H; y++)
					for (int x = 0; x < W; x++)
						below(fabs((double)gd_row(j->est[c], y)[x]), 1000);
			done(j);
		}
}

static void fill(struct job *j, float v0, float v1, float var)
{
	for (int c = 0; c < 3; c++)
		for (int y = 0; y < j->h; y++)
			for (int x = 0; x < j->w; x++) {
				gd_row(j->in.y[0][c], y)[x] = v0;
				gd_row(j->in.y[1][c], y)[x] = v1;
				gd_row(j->in.var[c], y)[x] = var;
			}
}

static void test_extremes(void **state)
{
	static const float value[][3] = {
		{0, 0, 0},	 {1e-40f, 3e-41f, 0},	       {-1, -2, 0.25f},	  {-1, 1, 1},
		{1, 1, FLT_MAX}, {FLT_MAX, -FLT_MAX, FLT_MAX}, {1e30f, 1e30f, 0},
	};

	(void)state;
	for (size_t i = 0; i < sizeof value / sizeof *value; i++) {
		struct job *j = make(20, 17, 3, 0, 0);

		fill(j, value[i][0], value[i][1], value[i][2]);
		run(j, false);
		assert_sane(j);
		if (value[i][0] == 0)
			for (int c = 0; c < 3; c++)
				assert_true(mean(j->est[c]) == 0 && mean(j->mse[c]) == 0);
		done(j);
	}
}

static void test_sizes(void **state)
{
	static const int size[][2] = {{1, 1}, {1, 40}, {40, 1}, {2, 2}, {3, 7}, {129, 5}};

	(void)state;
	for (size_t i = 0; i < sizeof size / sizeof *size; i++) {
		struct job *j = make(size[i][0], size[i][1], 3, 0.1, 0);

		run(j, i % 2);
		assert_sane(j);
		for (int c = 0; c < 3; c++)
			below(fabs(mean(j->est[c]) / mean(j->truth[c]) - 1), 0.2);
		done(j);
	}
}

/* Features that say nothing, say it twice, or sit far from 0. */
static void test_odd_features(void **state)
{
	(void)state;
	for (int odd = 0; odd < 5; odd++) {
		struct job *j = make(W, H, 3, 0.2, 0);

		for (int y = 0; y < H; y++)
			for (int x = 0; x < W; x++) {
				float *f = gd_row(j->in.feat[2], y) + x;

				*f = odd == 0	? 7
				     : odd == 1 ? gd_row(j->in.feat[0], y)[x]
				     : odd == 2 ? 1e8f + 64 * (float)x
				     : odd == 3 ? (x < 9 ? 3e38f : *f)
						: 1e-40f * (float)x;
			}
		run(j, false);
		assert_sane(j);
		below(square_error(j), 0.02 / 8);
		done(j);
	}
}

static void test_no_features(void **state)
{
	struct job *j = make(W, H, 3, 0.2, 0);

	(void)state;
	j->in.nfeat = 0;
	run(j, false);
	assert_sane(j);
	below(square_error(j), 0.02);
	done(j);
}

static void test_refused(void **state)
{
	struct job *j = make(8, 8, 3, 0.1, 0);
	struct gd_crossfit_out out = { j->est, j->mse, j->spread };
	struct gd_crossfit_conf conf = { false };
	struct gd_err err = { 0 };

	(void)state;
	j->in.nfeat = GD_CROSSFIT_FEATURES + 1;
	assert_int_equal(gd_crossfit_run(&out, &j->in, &conf, &j->result, NULL, &err), GD_EARG);
	assert_non_null(strstr(err.text, "26 feature planes"));
	j->in.nfeat = 0;
	j->in.ny = 2;
	assert_int_equal(gd_crossfit_run(&out, &j->in, &conf, &j->result, NULL, NULL), GD_EARG);
	j->in.ny = 3;
	j->in.self = true;
	free(j->in.var[0].v);
	j->in.var[0].v = NULL;
	assert_int_equal(gd_crossfit_run(&out, &j->in, &conf, &j->result, NULL, NULL), GD_EARG);
	done(j);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_linear_image_is_reproduced),
		cmocka_unit_test(test_constant_image),
		cmocka_unit_test(test_error_falls_with_noise),
		cmocka_unit_test(test_what_features_miss),
		cmocka_unit_test(test_halves_swapped),
		cmocka_unit_test(test_turned),
		cmocka_unit_test(test_channels_permuted),
		cmocka_unit_test(test_scaled),
		cmocka_unit_test(test_threads),
		cmocka_unit_test(test_layers_add_up),
		cmocka_unit_test(test_shares),
		cmocka_unit_test(test_no_halves),
		cmocka_unit_test(test_fireflies),
		cmocka_unit_test(test_extremes),
		cmocka_unit_test(test_sizes),
		cmocka_unit_test(test_odd_features),
		cmocka_unit_test(test_no_features),
		cmocka_unit_test(test_refused),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
