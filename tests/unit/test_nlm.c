/* SPDX-License-Identifier: BSD-3-Clause */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <math.h>
#include <omp.h>
#include <stdlib.h>
#include <string.h>

#include "nlm.h"

#define N 3

struct frame {
	struct gd_plane u[N], v[N], out[N], out_var[N];
	float *block;
	size_t size;	/* floats per plane */
};

static void frame_new(struct frame *f, int w, int h)
{
	struct gd_plane *group[] = { f->u, f->v, f->out, f->out_var };

	f->size = gd_stride(w) * (size_t)h;
	f->block = gd_calloc(4 * N * f->size, sizeof(float));
	assert_non_null(f->block);
	for (int i = 0; i < 4 * N; i++)
		group[i / N][i % N] = gd_plane_of(f->block + (size_t)i * f->size, w, h);
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

static void fill(struct frame *f, double scale)
{
	for (int c = 0; c < N; c++)
		for (int y = 0; y < f->u[0].h; y++)
			for (int x = 0; x < f->u[0].w; x++) {
				double sd = 0.1 + 0.02 * ((x + y) % 7);
				double truth = (x / 9 + y / 6) % 3;

				gd_row(f->u[c], y)[x] =
					(float)(scale * (truth + 1.7 * sd * noise(x, y, c)));
				gd_row(f->v[c], y)[x] = (float)(scale * scale * sd * sd);
			}
}

static void filter_with(struct frame *f, struct gd_nlm_conf conf)
{
	struct gd_nlm_job job = { N, N, f->u, f->v, f->u, f->v, f->out, f->out_var };
	struct gd_err err = { 0 };

	if (gd_nlm_run(&job, &conf, NULL, &err) != GD_OK)
		fail_msg("%s", err.text);
}

static void filter(struct frame *f)
{
	filter_with(f, GD_NLM_DEFAULTS);
}

static void all_finite(const struct frame *f)
{
	for (int c = 0; c < N; c++)
		for (int y = 0; y < f->u[0].h; y++)
			for (int x = 0; x < f->u[0].w; x++) {
				float u = gd_row(f->out[c], y)[x], v = gd_row(f->out_var[c], y)[x];

				if (!isfinite(u) || !isfinite(v) || v < 0.0f)
					fail_msg("plane %d at (%d, %d): %g, variance %g", c, x, y,
						 u, v);
			}
}

static void close_to(const char *what, int c, int x, int y, double found, double wanted,
		     double tolerance)
{
	if (!(fabs(found - wanted) <= tolerance))
		fail_msg("%s %d at (%d, %d): %.9g, expected %.9g (+- %.3g)", what, c, x, y, found,
			 wanted, tolerance);
}

static void constants_stay(void **unused)
{
	const float value[] = { 0.0f, 1.0f, -3.7f, 1e-40f, 1e30f, 3.3e38f };
	struct frame f;

	(void)unused;
	frame_new(&f, 140, 37);
	for (int i = 0; i < (int)(sizeof value / sizeof *value); i++)
		for (int noisy = 0; noisy < 2; noisy++) {
			for (int c = 0; c < N; c++)
				for (int y = 0; y < 37; y++)
					for (int x = 0; x < 140; x++) {
						gd_row(f.u[c], y)[x] = value[i];
						gd_row(f.v[c], y)[x] = noisy ? 0.5f : 0.0f;
					}
			filter(&f);
			for (int c = 0; c < N; c++)
				for (int y = 0; y < 37; y++)
					for (int x = 0; x < 140; x++)
						assert_true(gd_row(f.out[c], y)[x] == value[i]);
			/* all 121 pixels of an inner window weigh the same */
			close_to("variance", 0, 70, 18, gd_row(f.out_var[0], 18)[70],
				 noisy ? 0.5 / 121 : 0.0, 1e-8);
		}
	free(f.block);
}

static void exact_pixels_stay(void **unused)
{
	struct frame f;

	(void)unused;
	frame_new(&f, 50, 30);
	fill(&f, 1.0);
	memset(f.v[0].v, 0, N * f.size * sizeof(float));
	filter(&f);
	assert_memory_equal(f.out[0].v, f.u[0].v, N * f.size * sizeof(float));
	for (int c = 0; c < N; c++)
		f.v[c].v = NULL;
	memset(f.out[0].v, 0, N * f.size * sizeof(float));
	filter(&f);
	assert_memory_equal(f.out[0].v, f.u[0].v, N * f.size * sizeof(float));
	free(f.block);
}

static void noise_goes_edges_stay(void **unused)
{
	double before = 0.0, after = 0.0;
	struct frame f;

	(void)unused;
	frame_new(&f, 90, 60);
	for (int c = 0; c < N; c++)
		for (int y = 0; y < 60; y++)
			for (int x = 0; x < 90; x++) {
				gd_row(f.u[c], y)[x] =
					(float)((x / 30 + y / 20) % 3 + 0.3 * noise(x, y, c));
				gd_row(f.v[c], y)[x] = 0.03f;	/* that of the noise: 0.3^2 / 3 */
			}
	filter(&f);
	for (int c = 0; c < N; c++)
		for (int y = 0; y < 60; y++)
			for (int x = 0; x < 90; x++) {
				double truth = (x / 30 + y / 20) % 3;

				before += pow(gd_row(f.u[c], y)[x] - truth, 2.0);
				after += pow(gd_row(f.out[c], y)[x] - truth, 2.0);
			}
	if (!(after < before / 10.0))
		fail_msg("squared error %g, was %g", after, before);
	free(f.block);
}

/* A guide that knows nothing makes a mean over the window; one that knows all makes none. */
static void guide_decides(void **unused)
{
	struct frame f, g;
	struct gd_nlm_conf conf = GD_NLM_DEFAULTS;
	struct gd_err err = { 0 };
	struct gd_nlm_job job = { 1, N, g.u, g.v, f.u, f.v, f.out, f.out_var };
	double sum = 0.0;

	(void)unused;
	frame_new(&f, 40, 40);
	frame_new(&g, 40, 40);
	fill(&f, 1.0);
	assert_int_equal(gd_nlm_run(&job, &conf, NULL, &err), GD_OK);
	for (int y = 15; y <= 25; y++)
		for (int x = 15; x <= 25; x++)
			sum += gd_row(f.u[1], y)[x] / 121.0;
	close_to("mean", 1, 20, 20, gd_row(f.out[1], 20)[20], sum, 1e-6);
	for (int y = 0; y < 40; y++)
		for (int x = 0; x < 40; x++)
			gd_row(g.u[0], y)[x] = (float)noise(x, y, 9);
	assert_int_equal(gd_nlm_run(&job, &conf, NULL, &err), GD_OK);
	assert_memory_equal(f.out[0].v, f.u[0].v, N * f.size * sizeof(float));
	free(g.block);
	free(f.block);
}

static void scale_goes_through(void **unused)
{
	struct frame a, b;

	(void)unused;
	frame_new(&a, 61, 47);
	frame_new(&b, 61, 47);
	fill(&a, 1.0);
	filter(&a);
	for (int e = -50; e <= 50; e += 25) {	/* powers of two: to the bit */
		fill(&b, ldexp(1.0, e));
		filter(&b);
		for (int y = 0; y < 47; y++)
			for (int x = 0; x < 61; x++) {
				assert_true(gd_row(b.out[0], y)[x] ==
					    ldexpf(gd_row(a.out[0], y)[x], e));
				assert_true(gd_row(b.out_var[0], y)[x] ==
					    ldexpf(gd_row(a.out_var[0], y)[x], 2 * e));
			}
	}
	fill(&b, 1234.5);
	filter(&b);
	for (int y = 0; y < 47; y++)
		for (int x = 0; x < 61; x++)
			close_to("mean", 0, x, y, gd_row(b.out[0], y)[x] / 1234.5,
				 gd_row(a.out[0], y)[x], 2e-5);
	free(b.block);
	free(a.block);
}

static void offset_goes_through(void **unused)
{
	struct frame a, b;

	(void)unused;
	frame_new(&a, 40, 30);
	frame_new(&b, 40, 30);
	fill(&a, 1.0);
	for (int c = 0; c < N; c++)
		for (int y = 0; y < 30; y++)
			for (int x = 0; x < 40; x++) {	/* exact in float after the addition */
				float u = rintf(gd_row(a.u[c], y)[x] * 8.0f) / 8.0f;

				gd_row(a.u[c], y)[x] = u;
				gd_row(b.u[c], y)[x] = u + 1048576.0f;
				gd_row(b.v[c], y)[x] = gd_row(a.v[c], y)[x];
			}
	filter(&a);
	filter(&b);
	for (int y = 0; y < 30; y++)
		for (int x = 0; x < 40; x++)
			close_to("mean", 0, x, y, gd_row(b.out[0], y)[x] - 1048576.0,
				 gd_row(a.out[0], y)[x], 0.0625);
	free(b.block);
	free(a.block);
}

static void mirror_transpose_and_order(struct gd_nlm_conf conf)
{
	const int w = 150, h = 43;
	struct frame a, b, t;

	frame_new(&a, w, h);
	frame_new(&b, w, h);
	frame_new(&t, h, w);
	fill(&a, 1.0);
	for (int c = 0; c < N; c++)
		for (int y = 0; y < h; y++)
			for (int x = 0; x < w; x++) {
				gd_row(b.u[N - 1 - c], y)[w - 1 - x] = gd_row(a.u[c], y)[x];
				gd_row(b.v[N - 1 - c], y)[w - 1 - x] = gd_row(a.v[c], y)[x];
				gd_row(t.u[c], x)[y] = gd_row(a.u[c], y)[x];
				gd_row(t.v[c], x)[y] = gd_row(a.v[c], y)[x];
			}
	filter_with(&a, conf);
	filter_with(&b, conf);
	filter_with(&t, conf);
	for (int c = 0; c < N; c++)
		for (int y = 0; y < h; y++)
			for (int x = 0; x < w; x++) {
				double wanted = gd_row(a.out[c], y)[x];

				close_to("mirrored", c, x, y,
					 gd_row(b.out[N - 1 - c], y)[w - 1 - x], wanted, 2e-5);
				close_to("transposed", c, x, y, gd_row(t.out[c], x)[y], wanted,
					 2e-5);
			}
	free(t.block);
	free(b.block);
	free(a.block);
}

/* Three of seven pixels of fill() have a noise that is not negligible. */
static struct gd_nlm_conf some_pixels(void)
{
	struct gd_nlm_conf conf = GD_NLM_PREFILTER;

	conf.negligible = 0.04;
	return conf;
}

static void mirror_transpose_and_order_of_planes(void **unused)
{
	(void)unused;
	mirror_transpose_and_order(GD_NLM_DEFAULTS);
	mirror_transpose_and_order(some_pixels());
}

/* Which pixels stay does not depend on where the image is cut into tiles or what is around it. */
static void a_part_alone_is_as_in_the_whole(void **unused)
{
	const int x0 = 19, y0 = 7, w = 140, h = 60;
	struct frame a, b;
	int stayed = 0, changed = 0;

	(void)unused;
	frame_new(&a, 200, 90);
	frame_new(&b, w, h);
	fill(&a, 1.0);
	for (int c = 0; c < N; c++)
		for (int y = 0; y < h; y++)
			for (int x = 0; x < w; x++) {
				gd_row(b.u[c], y)[x] = gd_row(a.u[c], y0 + y)[x0 + x];
				gd_row(b.v[c], y)[x] = gd_row(a.v[c], y0 + y)[x0 + x];
			}
	filter_with(&a, some_pixels());
	filter_with(&b, some_pixels());
	for (int y = 6; y < h - 6; y++)
		for (int x = 6; x < w - 6; x++) {
			bool stays = gd_row(a.out[0], y0 + y)[x0 + x] ==
				     gd_row(a.u[0], y0 + y)[x0 + x];

			assert_true(stays == (gd_row(b.out[0], y)[x] == gd_row(b.u[0], y)[x]));
			/* the noise floor is relative to the variance of each */
			close_to("part", 0, x, y, gd_row(b.out[0], y)[x],
				 gd_row(a.out[0], y0 + y)[x0 + x], 1e-3);
			stayed += stays;
			changed += !stays;
		}
	assert_true(stayed > 1000 && changed > 1000);
	free(b.block);
	free(a.block);
}

static void threads_do_not_matter_with(struct gd_nlm_conf conf)
{
	const int threads[] = { 2, 7, 33 }, before = omp_get_max_threads();
	struct frame a, b;

	frame_new(&a, 300, 101);
	frame_new(&b, 300, 101);
	fill(&a, 1.0);
	fill(&b, 1.0);
	omp_set_num_threads(1);
	filter_with(&a, conf);
	for (int i = 0; i < 3; i++) {
		omp_set_num_threads(threads[i]);
		memset(b.out[0].v, 0, 2 * N * b.size * sizeof(float));
		filter_with(&b, conf);
		assert_memory_equal(a.out[0].v, b.out[0].v, 2 * N * a.size * sizeof(float));
	}
	omp_set_num_threads(before);
	free(b.block);
	free(a.block);
}

static void threads_do_not_matter(void **unused)
{
	(void)unused;
	threads_do_not_matter_with(GD_NLM_DEFAULTS);
	threads_do_not_matter_with(some_pixels());
}

/* Exact pixels with one noisy one, bad ones here and
 * there: all that is not noisy comes out as is. */
static void one_noisy_pixel(void **unused)
{
	struct frame f;

	(void)unused;
	frame_new(&f, 300, 70);
	for (int c = 0; c < N; c++) {
		for (int y = 0; y < 70; y++)
			for (int x = 0; x < 300; x++)
				gd_row(f.u[c], y)[x] = x / 150 ? 1.0f : 0.0f;
		gd_row(f.u[c], 33)[130] = 0.1f;
		gd_row(f.v[c], 33)[130] = 0.01f;
	}
	gd_row(f.u[1], 60)[290] = NAN;
	gd_row(f.u[2], 3)[3] = 1e38f;
	gd_row(f.v[0], 50)[20] = INFINITY;
	filter_with(&f, GD_NLM_PREFILTER);
	all_finite(&f);
	for (int c = 0; c < N; c++)
		for (int y = 0; y < 70; y++)
			for (int x = 0; x < 300; x++) {
				bool noisy = (x == 130 && y == 33) || (x == 20 && y == 50) ||
					     (x == 290 && y == 60);

				if (!noisy && gd_row(f.out[c], y)[x] != gd_row(f.u[c], y)[x])
					fail_msg("plane %d at (%d, %d) is touched", c, x, y);
				if (!noisy && gd_row(f.out_var[c], y)[x] != gd_row(f.v[c], y)[x])
					fail_msg("variance %d at (%d, %d)", c, x, y);
			}
	assert_true(gd_row(f.out[0], 33)[130] != gd_row(f.u[0], 33)[130]);
	free(f.block);
}

static void no_variance_wanted(void **unused)
{
	struct frame a, b;
	struct gd_nlm_conf conf = GD_NLM_DEFAULTS;
	struct gd_err err = { 0 };
	struct gd_nlm_job job = { N, N, b.u, b.v, b.u, NULL, b.out, NULL };

	(void)unused;
	frame_new(&a, 70, 33);
	frame_new(&b, 70, 33);
	fill(&a, 1.0);
	fill(&b, 1.0);
	filter(&a);
	assert_int_equal(gd_nlm_run(&job, &conf, NULL, &err), GD_OK);
	assert_memory_equal(a.out[0].v, b.out[0].v, N * a.size * sizeof(float));
	job.in_var = b.v;
	job.out_var = b.out_var;
	b.out_var[1].v = NULL;
	assert_int_equal(gd_nlm_run(&job, &conf, NULL, &err), GD_OK);
	assert_memory_equal(a.out[0].v, b.out[0].v, N * a.size * sizeof(float));
	assert_memory_equal(a.out_var[0].v, b.out_var[0].v, a.size * sizeof(float));
	assert_memory_equal(a.out_var[2].v, b.out_var[2].v, a.size * sizeof(float));
	free(b.block);
	free(a.block);
}

static void bad_pixels_count_as_their_neighbours(void **unused)
{
	struct frame f;

	(void)unused;
	frame_new(&f, 64, 48);
	fill(&f, 1.0);
	gd_row(f.u[0], 20)[20] = NAN;
	gd_row(f.u[1], 0)[0] = INFINITY;
	gd_row(f.u[2], 47)[63] = -INFINITY;
	gd_row(f.v[0], 10)[10] = NAN;
	gd_row(f.v[1], 10)[11] = INFINITY;
	gd_row(f.v[2], 10)[12] = -1.0f;
	filter(&f);
	all_finite(&f);
	for (int c = 0; c < N; c++)
		for (int y = 0; y < 48; y++)
			for (int x = 0; x < 64; x++)
				if (fabsf(gd_row(f.out[c], y)[x]) > 4.0f)
					fail_msg("plane %d at (%d, %d): %g", c, x, y,
						 gd_row(f.out[c], y)[x]);
	free(f.block);
}

static void nothing_but_bad_pixels(void **unused)
{
	const float value[] = { NAN, INFINITY, -INFINITY };
	struct frame f;

	(void)unused;
	frame_new(&f, 33, 17);
	for (int i = 0; i < 9; i++) {
		for (int c = 0; c < N; c++)
			for (int y = 0; y < 17; y++)
				for (int x = 0; x < 33; x++) {
					gd_row(f.u[c], y)[x] = value[i % 3];
					gd_row(f.v[c], y)[x] = value[i / 3];
				}
		filter(&f);
		all_finite(&f);
	}
	free(f.block);
}

static void fireflies(void **unused)
{
	const float u[] = {1e30f, -1e30f, 3.4e38f, 1e20f}, v[] = {0.0f, 1e38f, INFINITY, 1e-30f};
	struct frame f;

	(void)unused;
	frame_new(&f, 150, 40);
	for (int i = 0; i < 16; i++) {
		fill(&f, 1.0);
		for (int c = 0; c < N; c++) {
			gd_row(f.u[c], 20)[70] = u[i % 4];
			gd_row(f.v[c], 20)[70] = v[i / 4];
			gd_row(f.u[c], 3)[127] = -u[i % 4];
			gd_row(f.v[c], 3)[127] = v[i / 4];
		}
		filter(&f);
		all_finite(&f);
		if (i / 4 == 0) {	/* one that is certain stays and touches nobody */
			assert_true(gd_row(f.out[0], 20)[70] == u[i % 4]);
			assert_true(fabsf(gd_row(f.out[0], 20)[69]) < 4.0f);
		}
		assert_true(fabsf(gd_row(f.out[0], 20)[20]) < 4.0f);
	}
	free(f.block);
}

static void a_few_lit_pixels(void **unused)
{
	struct frame f;

	(void)unused;
	frame_new(&f, 100, 100);	/* all else is 0: percentiles coincide */
	for (int i = 0; i < 5; i++)
		gd_row(f.u[0], 50)[50 + i] = 1.0f + 0.1f * (float)i;
	gd_row(f.u[0], 10)[10] = 1e30f;
	filter(&f);
	assert_memory_equal(f.out[0].v, f.u[0].v, f.size * sizeof(float));
	free(f.block);
}

static void stripes_without_variance(void **unused)
{
	struct frame f;

	(void)unused;
	frame_new(&f, 64, 64);
	fill(&f, 1.0);
	for (int c = 0; c < N; c++)
		for (int y = 0; y < 64; y++)
			for (int x = 0; x < 64; x++)
				if (y / 4 % 2)
					gd_row(f.v[c], y)[x] = 0.0f;
	filter(&f);
	all_finite(&f);
	free(f.block);
}

static void denormals(void **unused)
{
	struct frame f;

	(void)unused;
	frame_new(&f, 40, 20);
	fill(&f, 1e-40);
	filter(&f);
	all_finite(&f);
	free(f.block);
}

static void single_pixel(void **unused)
{
	struct frame f;

	(void)unused;
	frame_new(&f, 1, 1);
	for (int c = 0; c < N; c++) {
		f.u[c].v[0] = 2.5f;
		f.v[c].v[0] = 0.25f;
	}
	filter(&f);
	assert_true(f.out[0].v[0] == 2.5f);
	assert_true(f.out_var[0].v[0] == 0.25f);
	free(f.block);
}

static void refusals(void **unused)
{
	struct frame f;
	struct gd_nlm_conf conf = GD_NLM_DEFAULTS;
	struct gd_err err = { 0 };

	(void)unused;
	frame_new(&f, 8, 8);
	struct gd_nlm_job job = { N, N, f.u, f.v, f.u, f.v, f.out, f.out_var };

	conf.patch = 17;
	assert_int_equal(gd_nlm_run(&job, &conf, NULL, &err), GD_EARG);
	assert_non_null(strstr(err.text, "17"));
	conf = GD_NLM_DEFAULTS;
	conf.k = NAN;
	assert_int_equal(gd_nlm_run(&job, &conf, NULL, NULL), GD_EARG);
	conf = GD_NLM_DEFAULTS;
	conf.eps = 0.0;
	assert_int_equal(gd_nlm_run(&job, &conf, NULL, NULL), GD_EARG);
	conf = GD_NLM_DEFAULTS;
	conf.negligible = 1.5;
	assert_int_equal(gd_nlm_run(&job, &conf, NULL, NULL), GD_EARG);
	conf = GD_NLM_DEFAULTS;
	job.nguide = 0;
	assert_int_equal(gd_nlm_run(&job, &conf, NULL, NULL), GD_EARG);
	job.nguide = N;
	f.out[1].w = 7;
	err = (struct gd_err){ 0 };
	assert_int_equal(gd_nlm_run(&job, &conf, NULL, &err), GD_ESHAPE);
	assert_non_null(strstr(err.text, "7x8"));
	free(f.block);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(constants_stay),
		cmocka_unit_test(exact_pixels_stay),
		cmocka_unit_test(noise_goes_edges_stay),
		cmocka_unit_test(guide_decides),
		cmocka_unit_test(scale_goes_through),
		cmocka_unit_test(offset_goes_through),
		cmocka_unit_test(mirror_transpose_and_order_of_planes),
		cmocka_unit_test(a_part_alone_is_as_in_the_whole),
		cmocka_unit_test(threads_do_not_matter),
		cmocka_unit_test(one_noisy_pixel),
		cmocka_unit_test(no_variance_wanted),
		cmocka_unit_test(bad_pixels_count_as_their_neighbours),
		cmocka_unit_test(nothing_but_bad_pixels),
		cmocka_unit_test(fireflies),
		cmocka_unit_test(a_few_lit_pixels),
		cmocka_unit_test(stripes_without_variance),
		cmocka_unit_test(denormals),
		cmocka_unit_test(single_pixel),
		cmocka_unit_test(refusals),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
