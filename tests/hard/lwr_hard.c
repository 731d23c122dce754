/* SPDX-License-Identifier: BSD-3-Clause */
/* Sparse linear predictions on hostile input: all outputs finite, estimates within sane bounds. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>

#include "lwr.h"

#define NF 6

static struct gd_plane plane(int w, int h)
{
	return gd_plane_of(gd_calloc(gd_stride(w) * (size_t)h, sizeof(float)), w, h);
}

static double rnd(unsigned *s)
{
	*s = *s * 1664525u + 1013904223u;
	return (double)(*s >> 8) / (1 << 24);
}

enum how { TWIN, VAR, PAPER, PLAIN, HOWS };

struct frame {
	int w, h;
	struct gd_plane y[4], twin[3], var[3], feat[NF], feat_var[NF], weight;
	struct gd_plane est[4], mse[3], spread[3], radius, features;
};

static struct frame frame(int w, int h)
{
	struct frame f = { .w = w, .h = h, .weight = plane(w, h), .radius = plane(w, h),
			   .features = plane(w, h) };
	unsigned s = 1;

	for (int c = 0; c < 4; c++) {
		f.y[c] = plane(w, h);
		f.est[c] = plane(w, h);
	}
	for (int c = 0; c < 3; c++) {
		f.twin[c] = plane(w, h);
		f.var[c] = plane(w, h);
		f.mse[c] = plane(w, h);
		f.spread[c] = plane(w, h);
	}
	for (int a = 0; a < NF; a++) {
		f.feat[a] = plane(w, h);
		f.feat_var[a] = plane(w, h);
	}
	for (int y = 0; y < h; y++)
		for (int x = 0; x < w; x++) {
			gd_row(f.weight, y)[x] = 1;
			for (int a = 0; a < NF; a++)
				gd_row(f.feat[a], y)[x] = (float)(rnd(&s) + a * x);
			for (int c = 0; c < 4; c++)
				gd_row(f.y[c], y)[x] = (float)(1 + 0.3 * rnd(&s));
			for (int c = 0; c < 3; c++) {
				gd_row(f.twin[c], y)[x] = (float)(1 + 0.3 * rnd(&s));
				gd_row(f.var[c], y)[x] = 0.01f;
			}
		}
	return f;
}

static void release(struct frame *f)
{
	for (int c = 0; c < 4; c++) {
		free(f->y[c].v);
		free(f->est[c].v);
	}
	for (int c = 0; c < 3; c++) {
		free(f->twin[c].v);
		free(f->var[c].v);
		free(f->mse[c].v);
		free(f->spread[c].v);
	}
	for (int a = 0; a < NF; a++) {
		free(f->feat[a].v);
		free(f->feat_var[a].v);
	}
	free(f->weight.v);
	free(f->radius.v);
	free(f->features.v);
}

static void all_finite(const struct frame *f, struct gd_plane p, const char *what, enum how how,
		       double low, double high)
{
	for (int y = 0; y < f->h; y++)
		for (int x = 0; x < f->w; x++) {
			double v = (double)gd_row(p, y)[x];

			if (!isfinite(v) || v < low || v > high)
				fail_msg("%s at %d,%d of %dx%d is %g, expected %g to %g (way %d)",
					 what, x, y, f->w, f->h, v, low, high, (int)how);
		}
}

/* Fits in every way; estimates have to lie in low .. high. */
static void survive(struct frame *f, double low, double high)
{
	for (enum how how = 0; how < HOWS; how++)
		for (int dense = 0; dense < 1 + (how != PAPER); dense++) {
			struct gd_lwr_conf conf = GD_LWR_DEFAULTS;
			struct gd_lwr_in in = { .ny = 4, .nfeat = NF, .y = f->y, .feat = f->feat,
						.feat_var = f->feat_var };
			struct gd_lwr_out out = { .est = f->est, .mse = f->mse,
						  .spread = f->spread, .radius = f->radius,
						  .features = f->features };
			struct gd_err err = { 0 };

			conf.paper = how == PAPER;
			conf.dense = dense;
			if (how == PLAIN)
				conf.per_column = conf.granularity = 0;
			if (how == PLAIN)
				conf.ridge = conf.flat = conf.feature_noise = 0;
			if (how == TWIN)
				in.twin = f->twin;
			if (how == VAR || how == PAPER)
				in.var = f->var;
			if (how == TWIN)
				in.weight = f->weight;
			assert_int_equal(gd_lwr_fit(&out, &in, &conf, NULL, NULL, &err), GD_OK);
			for (int c = 0; c < 4; c++)
				all_finite(f, f->est[c], "estimate", how, low, high);
			for (int c = 0; c < 3; c++) {
				all_finite(f, f->mse[c], "error", how, 0, (double)FLT_MAX);
				all_finite(f, f->spread[c], "spread", how, 0, (double)FLT_MAX);
			}
			all_finite(f, f->radius, "radius", how, 0, 15);
			all_finite(f, f->features, "features", how, 0, 3 + NF + 1e-3);
		}
}

static void test_sizes(void **state)
{
	static const int size[][2] = {{1, 1}, {1, 2}, {2, 1},	{1, 50}, {50, 1}, {2, 2},
				      {3, 3}, {2, 40}, {33, 17}, {65, 3}, {66, 67}};

	(void)state;
	for (size_t i = 0; i < sizeof size / sizeof *size; i++) {
		struct frame f = frame(size[i][0], size[i][1]);

		survive(&f, -1, 4);
		release(&f);
	}
}

static void fill(struct gd_plane p, float v)
{
	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++)
			gd_row(p, y)[x] = v;
}

static void test_flat(void **state)
{
	static const float level[] = {0, 1, -3, 1e-38f, 1e-42f, 1e30f, -1e30f};

	(void)state;
	for (size_t i = 0; i < sizeof level / sizeof *level; i++) {
		struct frame f = frame(26, 21);
		double v = (double)level[i], slack = 1e-5 * fabs(v) + 1e-44;

		for (int c = 0; c < 4; c++)
			fill(f.y[c], level[i]);
		for (int c = 0; c < 3; c++)
			fill(f.twin[c], level[i]);
		survive(&f, v - slack, v + slack);
		release(&f);
	}
}

/* Pixels of far too much light, also where models are centred, and at the corners. */
static void test_fireflies(void **state)
{
	static const float energy[] = {1e6f, 1e18f, 1e30f, -1e30f};

	(void)state;
	for (size_t i = 0; i < sizeof energy / sizeof *energy; i++) {
		struct frame f = frame(34, 29);

		for (int y = 0; y < f.h; y += 9)
			for (int x = 0; x < f.w; x += 11)
				for (int c = 0; c < 3; c++) {
					gd_row(f.y[c], y)[x] = energy[i];
					gd_row(f.var[c], y)[x] = FLT_MAX;
				}
		survive(&f, -1.01 * fabs((double)energy[i]), 1.01 * fabs((double)energy[i]));
		release(&f);
	}
}

static void test_largest(void **state)
{
	struct frame f = frame(31, 29);

	(void)state;
	for (int c = 0; c < 4; c++)
		for (int y = 0; y < f.h; y++)
			for (int x = 0; x < f.w; x++)
				gd_row(f.y[c], y)[x] = (x + y) % 2 ? FLT_MAX : -FLT_MAX;
	for (int c = 0; c < 3; c++)
		fill(f.var[c], FLT_MAX);
	survive(&f, -(double)FLT_MAX, (double)FLT_MAX);
	release(&f);
}

/* Feature planes of every bad kind; the image is sound and has to stay so. */
static void test_features(void **state)
{
	(void)state;
	for (int kind = 0; kind < 10; kind++) {
		struct frame f = frame(36, 25);
		unsigned s = 5;

		for (int y = 0; y < f.h; y++)
			for (int x = 0; x < f.w; x++) {
				float *v[NF];
				float r = (float)rnd(&s), one = x > 20;

				for (int a = 0; a < NF; a++)
					v[a] = gd_row(f.feat[a], y) + x;
				switch (kind) {
				case 0: *v[0] = *v[1] = *v[2] = r; break;
				case 1: *v[0] = one; *v[1] = 1 - one; *v[2] = one + (float)y; break;
				case 2: *v[0] = 1e8f + 1e-3f * r; *v[1] = 1e8f + 10 * r; break;
				case 3: *v[0] = x == 18 && y == 12 ? 1e30f : r; break;
				case 4: *v[0] = y < 12 ? 1e30f : 1 + r; break;
				case 5: *v[0] = 1e-30f * r; *v[1] = 1e30f * r; break;
				case 6: *v[0] = FLT_MAX; *v[1] = -FLT_MAX * r; break;
				case 7: *v[0] = r; *v[1] = r * (1 + 1e-7f * (float)x); break;
				case 8: *v[0] = (float)x; *v[1] = (float)y; break;
				default: *v[0] = x % 2 ? FLT_MAX : -FLT_MAX; break;
				}
				if (kind == 5)
					gd_row(f.feat_var[1], y)[x] = FLT_MAX;
			}
		survive(&f, -2, 5);
		release(&f);
	}
}

/* Weights of a wide range: the brightest pixels have next to no say. */
static void test_weights(void **state)
{
	struct frame f = frame(34, 30);
	unsigned s = 9;

	(void)state;
	for (int y = 0; y < f.h; y++)
		for (int x = 0; x < f.w; x++) {
			bool bright = rnd(&s) < 0.05;

			gd_row(f.weight, y)[x] = bright ? 1e-12f : 1;
			for (int c = 0; bright && c < 3; c++)
				gd_row(f.y[c], y)[x] = 1e4f;
		}
	survive(&f, -1e4, 1.1e4);
	release(&f);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_sizes),	 cmocka_unit_test(test_flat),
		cmocka_unit_test(test_fireflies), cmocka_unit_test(test_largest),
		cmocka_unit_test(test_features), cmocka_unit_test(test_weights)};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
