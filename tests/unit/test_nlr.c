/* SPDX-License-Identifier: BSD-3-Clause */
/* What the nonlinearly weighted regression must keep, whatever the image. */
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

#include "nlr.h"

#define PLANES (13 + GD_NLR_FEATURES)

struct frame {
	int w, h;
	struct gd_plane plane[PLANES];
	struct gd_nlr_in in;		/* y is the guide unless a test says otherwise */
	struct gd_plane out[3];
	struct gd_nlr_conf conf;
	float *block;
	size_t size;			/* floats per plane */
};

static void frame_new(struct frame *f, int w, int h, int nfeat)
{
	*f = (struct frame){ .w = w, .h = h, .in.nfeat = nfeat, .conf = GD_NLR_DEFAULTS };
	f->size = gd_stride(w) * (size_t)h;
	f->block = gd_calloc(PLANES * f->size, sizeof(float));
	assert_non_null(f->block);
	for (int i = 0; i < PLANES; i++)
		f->plane[i] = gd_plane_of(f->block + (size_t)i * f->size, w, h);
	for (int c = 0; c < 3; c++) {
		f->in.y[c] = f->in.guide[c] = f->plane[c];
		f->in.guide_var[c] = f->plane[3 + c];
		f->out[c] = f->plane[6 + c];
	}
	for (int j = 0; j < nfeat; j++)
		f->in.feat[j] = f->plane[13 + j];
}

/* Repeatable noise in -1 .. 1 that depends on the coordinates alone. */
static double noise(int x, int y, int c)
{
	uint32_t s =
		(uint32_t)x * 374761393u + (uint32_t)y * 668265263u + (uint32_t)c * 2246822519u;

	s = (s ^ (s >> 13)) * 1274126177u;
	s = (s ^ (s >> 16)) * 2654435761u;
	return (double)(s >> 8) / 8388608.0 - 1.0;
}

static double truth(int x, int y, int c)
{
	return (x / 9 + y / 6 + c) % 3 + 0.5;
}

static void fill(struct frame *f, double scale)
{
	for (int y = 0; y < f->h; y++)
		for (int x = 0; x < f->w; x++) {
			double sd = 0.1 + 0.02 * ((x + y) % 7);

			for (int c = 0; c < 3; c++) {
				gd_row(f->plane[c], y)[x] =
					(float)(scale *
						(truth(x, y, c) + 1.7 * sd * noise(x, y, c)));
				gd_row(f->plane[3 + c], y)[x] = (float)(scale * scale * sd * sd);
			}
			for (int j = 0; j < f->in.nfeat; j++)
				gd_row(f->plane[13 + j], y)[x] =
					(float)(j % 2 ? 0.3 * truth(x, y, j) :
							0.02 * x + 0.01 * y * j) +
					0.02f * (float)noise(x, y, 9 + j);
		}
}

static void regress(struct frame *f)
{
	struct gd_err err = { 0 };

	if (gd_nlr_run(f->out, &f->in, &f->conf, NULL, &err) != GD_OK)
		fail_msg("%s", err.text);
}

static void assert_finite(const struct frame *f)
{
	for (int c = 0; c < 3; c++)
		for (int y = 0; y < f->h; y++)
			for (int x = 0; x < f->w; x++)
				if (!isfinite(gd_row(f->out[c], y)[x]))
					fail_msg("plane %d pixel %d,%d: %g", c, x, y,
						 gd_row(f->out[c], y)[x]);
}

static void close_to(double got, double want, double tolerance, int c, int x, int y)
{
	if (!(fabs(got - want) <= tolerance))
		fail_msg("plane %d pixel %d,%d: %.9g, expected %.9g", c, x, y, got, want);
}

/* All weights 1, no noise, no feature or a constant one: the image comes back. */
static void test_constant(void **unused)
{
	struct frame f;

	(void)unused;
	for (int nf = 0; nf < 3; nf++) {
		frame_new(&f, 37, 23, nf);
		for (size_t i = 0; i < PLANES * f.size; i++)
			f.block[i] = 0.7f;
		regress(&f);
		for (int c = 0; c < 3; c++)
			for (int i = 0; i < f.w * f.h; i++)
				close_to(gd_row(f.out[c], i / f.w)[i % f.w], 0.7, 1e-6, c, i % f.w,
					 i / f.w);
		free(f.block);
	}
}

/* What is linear in the features comes back, but for the small ridge; duplicates do no harm. */
static void test_linear(void **unused)
{
	struct frame f;

	(void)unused;
	frame_new(&f, 75, 44, 5);
	f.conf.ridge = 1e-6;
	for (int c = 0; c < 3; c++)
		f.in.guide[c] = f.plane[9 + c];		/* constant: all weights are 1 */
	for (int y = 0; y < f.h; y++)
		for (int x = 0; x < f.w; x++) {
			for (int j = 0; j < 4; j++)
				gd_row(f.plane[13 + j], y)[x] =
					(float)(0.5 * noise(x, y, j) + 0.3 * j);
			gd_row(f.plane[17], y)[x] = gd_row(f.plane[14], y)[x];
			for (int c = 0; c < 3; c++) {
				double v = 3.0 + c;

				for (int j = 0; j < 4; j++)
					v += (0.5 * j - c) * gd_row(f.plane[13 + j], y)[x];
				gd_row(f.plane[c], y)[x] = (float)v;
			}
		}
	regress(&f);
	for (int c = 0; c < 3; c++)
		for (int i = 0; i < f.w * f.h; i++)
			close_to(gd_row(f.out[c], i / f.w)[i % f.w],
				 gd_row(f.plane[c], i / f.w)[i % f.w], 2e-3, c, i % f.w, i / f.w);
	free(f.block);
}

/* Of noise between edges that the features do not tell of, a tenth is left at most. */
static void test_denoises(void **unused)
{
	struct frame f;
	double before = 0.0, after = 0.0;

	(void)unused;
	frame_new(&f, 96, 70, 3);
	fill(&f, 1.0);
	for (int c = 0; c < 3; c++)
		for (int y = 0; y < f.h; y++)
			for (int x = 0; x < f.w; x++) {
				gd_row(f.plane[c], y)[x] =
					(float)(truth(x / 4, y / 6, c) + 0.3 * noise(x, y, c));
				gd_row(f.plane[3 + c], y)[x] = 0.03f;
			}
	regress(&f);
	for (int c = 0; c < 3; c++)
		for (int y = 0; y < f.h; y++)
			for (int x = 0; x < f.w; x++) {
				before +=
					pow(gd_row(f.plane[c], y)[x] - truth(x / 4, y / 6, c), 2.0);
				after += pow(gd_row(f.out[c], y)[x] - truth(x / 4, y / 6, c), 2.0);
			}
	assert_true(after < 0.1 * before);
	free(f.block);
}

enum turn { FLIP_X, FLIP_Y, TRANSPOSE };

static void turned(struct frame *to, const struct frame *from, enum turn turn)
{
	frame_new(to, turn == TRANSPOSE ? from->h : from->w, turn == TRANSPOSE ? from->w : from->h,
		  from->in.nfeat);
	for (int i = 0; i < PLANES; i++)
		for (int y = 0; y < from->h; y++)
			for (int x = 0; x < from->w; x++) {
				int u = turn == TRANSPOSE ? y : x, v = turn == TRANSPOSE ? x : y;

				u = turn == FLIP_X ? from->w - 1 - x : u;
				v = turn == FLIP_Y ? from->h - 1 - y : v;

				gd_row(to->plane[i], v)[u] = gd_row(from->plane[i], y)[x];
			}
}

static void test_turns(void **unused)
{
	struct frame f, g, back;

	(void)unused;
	frame_new(&f, 139, 35, 4);
	fill(&f, 1.0);
	regress(&f);
	for (int turn = FLIP_X; turn <= TRANSPOSE; turn++) {
		turned(&g, &f, turn);
		regress(&g);
		turned(&back, &g, turn);
		for (int c = 0; c < 3; c++)
			for (int i = 0; i < f.w * f.h; i++)
				close_to(gd_row(back.plane[6 + c], i / f.w)[i % f.w],
					 gd_row(f.out[c], i / f.w)[i % f.w], 1e-4, c, i % f.w,
					 i / f.w);
		free(g.block);
		free(back.block);
	}
	free(f.block);
}

static void test_scales(void **unused)
{
	static const double scale[] = { 4.0, 0.0625, 3.7, 1e-6, 1e9 };
	struct frame f, g;

	(void)unused;
	frame_new(&f, 60, 40, 3);
	fill(&f, 1.0);
	regress(&f);
	for (size_t s = 0; s < sizeof scale / sizeof *scale; s++) {
		frame_new(&g, 60, 40, 3);
		fill(&g, scale[s]);
		regress(&g);
		for (int c = 0; c < 3; c++)
			for (int i = 0; i < f.w * f.h; i++) {
				double want = scale[s] * gd_row(f.out[c], i / f.w)[i % f.w];

				/* powers of 4 scale every step exactly */
				close_to(gd_row(g.out[c], i / f.w)[i % f.w], want,
					 s < 2 ? 0.0 : 1e-4 * scale[s], c, i % f.w, i / f.w);
			}
		free(g.block);
	}
	free(f.block);
}

/* The unit of the fit weight does not matter; y may have another than the guide, and an offset. */
static void test_units(void **unused)
{
	struct frame f, g;

	(void)unused;
	frame_new(&f, 50, 40, 3);
	frame_new(&g, 50, 40, 3);
	fill(&f, 1.0);
	fill(&g, 1.0);
	f.in.weight = f.plane[12];
	g.in.weight = g.plane[12];
	for (int c = 0; c < 3; c++)
		g.in.y[c] = g.plane[9 + c];
	for (int y = 0; y < f.h; y++)
		for (int x = 0; x < f.w; x++) {
			float m = 1.1f + (float)noise(x, y, 77);

			gd_row(f.plane[12], y)[x] = m;
			gd_row(g.plane[12], y)[x] = m * 1e-20f;
			for (int c = 0; c < 3; c++)
				gd_row(g.plane[9 + c], y)[x] =
					1e5f * (gd_row(f.plane[c], y)[x] + 2.0f);
		}
	regress(&f);
	regress(&g);
	for (int c = 0; c < 3; c++)
		for (int i = 0; i < f.w * f.h; i++)
			close_to(gd_row(g.out[c], i / f.w)[i % f.w],
				 1e5 * (gd_row(f.out[c], i / f.w)[i % f.w] + 2.0), 1e-4 * 1e5, c,
				 i % f.w, i / f.w);
	free(f.block);
	free(g.block);
}

static void test_permuted(void **unused)
{
	struct frame f, g;

	(void)unused;
	frame_new(&f, 50, 40, 4);
	frame_new(&g, 50, 40, 4);
	fill(&f, 1.0);
	fill(&g, 1.0);
	for (int c = 0; c < 3; c++) {
		g.in.y[c] = g.in.guide[c] = g.plane[(c + 1) % 3];
		g.in.guide_var[c] = g.plane[3 + (c + 1) % 3];
	}
	for (int j = 0; j < 4; j++)
		g.in.feat[j] = g.plane[13 + (j + 3) % 4];
	regress(&f);
	regress(&g);
	for (int c = 0; c < 3; c++)
		for (int i = 0; i < f.w * f.h; i++)
			close_to(gd_row(g.out[c], i / f.w)[i % f.w],
				 gd_row(f.out[(c + 1) % 3], i / f.w)[i % f.w], 1e-4, c, i % f.w,
				 i / f.w);
	free(f.block);
	free(g.block);
}

static void test_threads(void **unused)
{
	static const int threads[] = { 1, 2, 7 };
	struct frame f;
	float *first = NULL;
	int before = omp_get_max_threads();

	(void)unused;
	frame_new(&f, 300, 101, 7);
	fill(&f, 1.0);
	for (int i = 0; i < 3; i++) {
		omp_set_num_threads(threads[i]);
		memset(f.block + 6 * f.size, 0, 3 * f.size * sizeof(float));
		regress(&f);
		if (!first) {
			first = gd_alloc(3 * f.size, sizeof(float));
			assert_non_null(first);
			memcpy(first, f.block + 6 * f.size, 3 * f.size * sizeof(float));
		}
		assert_memory_equal(first, f.block + 6 * f.size, 3 * f.size * sizeof(float));
	}
	omp_set_num_threads(before);
	free(first);
	free(f.block);
}

/* Every plane in turn gets every sort of extreme value; far away nothing changes. */
static void test_extremes(void **unused)
{
	static const float bad[] = { 1e30f, -1e30f,   FLT_MAX,	 -FLT_MAX,
				     NAN,   INFINITY, -INFINITY, 1e-42f };
	struct frame f;

	(void)unused;
	for (int i = 0; i < 16; i++) {
		if (i >= 6 && i < 12)
			continue;
		for (size_t b = 0; b < sizeof bad / sizeof *bad; b++) {
			frame_new(&f, 45, 30, 3);
			fill(&f, 1.0);
			f.in.weight = f.plane[12];
			for (int y = 0; y < f.h; y++)
				for (int x = 0; x < f.w; x++)
					gd_row(f.plane[12], y)[x] = 1.0f;
			gd_row(f.plane[i], 12)[14] = bad[b];
			gd_row(f.plane[i], 0)[0] = bad[b];
			regress(&f);
			assert_finite(&f);
			for (int c = 0; c < 3; c++)
				close_to(gd_row(f.out[c], 27)[40], truth(40, 27, c), 0.3, c, 40,
					 27);
			free(f.block);
		}
	}
}

static void fill_all(struct frame *f, int first, int n, float v)
{
	for (size_t i = (size_t)first * f->size; i < (size_t)(first + n) * f->size; i++)
		f->block[i] = v;
}

/* Whole planes of one value, of extreme ones too. */
static void test_flat_extremes(void **unused)
{
	static const float value[] = {
		0.0f, 1e-42f, 1e-30f, 1e30f, FLT_MAX, -FLT_MAX, NAN, INFINITY
	};
	struct frame f;

	(void)unused;
	for (size_t v = 0; v < sizeof value / sizeof *value; v++) {
		for (int first = 0; first < 16; first += 3) {
			frame_new(&f, 33, 20, 3);
			fill(&f, 1.0);
			fill_all(&f, first, 3, value[v]);
			if (first == 12)
				f.in.weight = f.plane[12];
			regress(&f);
			assert_finite(&f);
			free(f.block);
		}
	}
}

/* Fit weights of 0 everywhere: nothing is predicted, y stays. */
static void test_no_fit(void **unused)
{
	struct frame f;

	(void)unused;
	frame_new(&f, 33, 20, 2);
	fill(&f, 1.0);
	f.in.weight = f.plane[12];
	regress(&f);
	for (int y = 0; y < f.h; y++)
		assert_memory_equal(gd_row(f.out[0], y), gd_row(f.in.y[0], y),
				    (size_t)f.w * sizeof(float));
	free(f.block);
}

/* No variance: weights still are 1 among equals, and edges are kept. */
static void test_no_variance(void **unused)
{
	struct frame f;

	(void)unused;
	frame_new(&f, 40, 40, 2);
	for (int y = 0; y < f.h; y++)
		for (int x = 0; x < f.w; x++)
			for (int c = 0; c < 3; c++)
				gd_row(f.plane[c], y)[x] = (float)truth(x, y, c);
	for (int c = 0; c < 3; c++)
		f.in.guide_var[c].v = NULL;
	regress(&f);
	for (int c = 0; c < 3; c++)
		for (int i = 0; i < f.w * f.h; i++)
			close_to(gd_row(f.out[c], i / f.w)[i % f.w], truth(i % f.w, i / f.w, c),
				 1e-5, c, i % f.w, i / f.w);
	free(f.block);
}

static void test_sizes(void **unused)
{
	static const int size[][2] = { { 1, 1 },    { 1, 200 }, { 200, 1 }, { 2, 3 },
				       { 129, 33 }, { 17, 65 }, { 257, 7 } };
	struct frame f;

	(void)unused;
	for (size_t i = 0; i < sizeof size / sizeof *size; i++) {
		frame_new(&f, size[i][0], size[i][1], 2);
		fill(&f, 1.0);
		f.conf.window = GD_NLR_WINDOW;
		f.conf.patch = GD_NLR_PATCH;
		regress(&f);
		assert_finite(&f);
		free(f.block);
	}
}

static void refused(struct frame *f, int status, const char *word)
{
	struct gd_err err = { 0 };

	assert_int_equal(gd_nlr_run(f->out, &f->in, &f->conf, NULL, &err), status);
	assert_int_equal(err.code, status);
	assert_non_null(strstr(err.text, word));
	f->conf = GD_NLR_DEFAULTS;
}

static void test_refusals(void **unused)
{
	struct frame f;

	(void)unused;
	frame_new(&f, 8, 8, 2);
	f.conf.window = GD_NLR_WINDOW + 1;
	refused(&f, GD_EARG, "window");
	f.conf.patch = -1;
	refused(&f, GD_EARG, "patch");
	f.conf.k = NAN;
	refused(&f, GD_EARG, "k nan");
	f.conf.eps = 0.0;
	refused(&f, GD_EARG, "eps 0");
	f.conf.ridge = 0.0;
	refused(&f, GD_EARG, "ridge 0");
	f.in.feat[1].w = 7;
	refused(&f, GD_ESHAPE, "feature plane 1");
	f.in.feat[1].w = 8;
	f.in.guide[2].v = NULL;
	refused(&f, GD_EARG, "guide plane 2 is missing");
	f.in.guide[2] = f.plane[2];
	f.in.nfeat = GD_NLR_FEATURES + 1;
	refused(&f, GD_EARG, "17 features");
	free(f.block);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_constant),
		cmocka_unit_test(test_linear),
		cmocka_unit_test(test_denoises),
		cmocka_unit_test(test_turns),
		cmocka_unit_test(test_scales),
		cmocka_unit_test(test_units),
		cmocka_unit_test(test_permuted),
		cmocka_unit_test(test_threads),
		cmocka_unit_test(test_extremes),
		cmocka_unit_test(test_flat_extremes),
		cmocka_unit_test(test_no_fit),
		cmocka_unit_test(test_no_variance),
		cmocka_unit_test(test_sizes),
		cmocka_unit_test(test_refusals),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
