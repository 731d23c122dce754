/* SPDX-License-Identifier: BSD-3-Clause */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "apr_prep.h"

static struct gd_plane plane(int w, int h, float value)
{
	struct gd_plane p = gd_plane_of(gd_calloc(gd_stride(w) * (size_t)h, sizeof(float)), w, h);

	for (int y = 0; y < h; y++)
		for (int x = 0; x < w; x++)
			gd_row(p, y)[x] = value;
	return p;
}

static double total(struct gd_plane p)
{
	double s = 0;

	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++)
			s += (double)gd_row(p, y)[x];
	return s;
}

static void test_clean(void **state)
{
	struct gd_plane v = plane(30, 20, 0), var = plane(30, 20, 0);
	size_t count = 0;

	(void)state;
	for (int y = 0; y < 20; y++)
		for (int x = 0; x < 30; x++) {
			gd_row(v, y)[x] = (float)x;
			gd_row(var, y)[x] = (float)y;
		}
	gd_row(v, 5)[7] = NAN;
	gd_row(v, 0)[0] = INFINITY;
	gd_row(var, 9)[9] = -1;
	gd_row(var, 12)[20] = NAN;
	gd_row(var, 12)[25] = INFINITY;
	for (int y = 14; y < 17; y++)
		for (int x = 3; x < 6; x++)
			gd_row(v, y)[x] = -INFINITY;
	assert_int_equal(gd_apr_clean(v, var, &count, NULL), GD_OK);
	assert_int_equal(count, 11);
	assert_float_equal(gd_row(v, 5)[7], 7, 0);	/* 6 6 6 7 7 8 8 8 */
	assert_float_equal(gd_row(var, 5)[7], 6, 0);
	assert_float_equal(gd_row(v, 0)[0], 1, 0);	/* 0 1 1 */
	assert_float_equal(gd_row(var, 0)[0], 1, 0);
	assert_float_equal(gd_row(var, 9)[9], 0, 0);
	assert_float_equal(gd_row(var, 12)[20], 13, 0);
	assert_float_equal(gd_row(v, 12)[20], 20, 0);
	assert_true(gd_row(var, 12)[25] == FLT_MAX);
	assert_float_equal(gd_row(v, 15)[4], 4, 0);	/* from the 5x5 ring */
	for (int y = 0; y < 20; y++)
		for (int x = 0; x < 30; x++)
			gd_row(v, y)[x] = NAN;
	assert_int_equal(gd_apr_clean(v, (struct gd_plane){ 0 }, &count, NULL), GD_OK);
	assert_float_equal(gd_row(v, 10)[10], 0, 0);
	free(v.v);
	free(var.v);
}

static void test_bin_variance(void **state)
{
	struct gd_plane bin[3] = {plane(4, 3, 1), plane(4, 3, 2), plane(4, 3, 6)},
			var = plane(4, 3, 0);

	(void)state;
	gd_apr_bin_variance(var, bin, 3);
	assert_float_equal(gd_row(var, 2)[3], 14 / 6.f, 1e-6);
	gd_row(bin[1], 0)[0] = 3e38f;
	gd_row(bin[2], 0)[0] = NAN;
	gd_row(bin[2], 0)[1] = 3e38f;
	gd_apr_bin_variance(var, bin, 3);
	assert_true(gd_row(var, 0)[0] == FLT_MAX && gd_row(var, 0)[1] == FLT_MAX);
	for (int b = 0; b < 3; b++)
		free(bin[b].v);
	free(var.v);
}

/* Independent noise of variance 1/12: the mean of the estimates is that. */
static void test_spatial_variance(void **state)
{
	struct gd_plane v = plane(64, 64, 0), var = plane(64, 64, 0), one = plane(1, 1, 5),
			none = plane(1, 1, 5);
	uint32_t s = 1;

	(void)state;
	for (int y = 0; y < 64; y++)
		for (int x = 0; x < 64; x++) {
			s = s * 1664525u + 1013904223u;
			gd_row(v, y)[x] = (float)(s >> 8) / (1 << 24);
		}
	assert_int_equal(gd_apr_spatial_variance(var, v, NULL), GD_OK);
	assert_true(fabs(total(var) / 4096 * 12 - 1) < 0.03);
	assert_int_equal(gd_apr_spatial_variance(none, one, NULL), GD_OK);
	assert_float_equal(none.v[0], 0, 0);
	free(v.v);
	free(var.v);
	free(one.v);
	free(none.v);
}

/* Four planes: the colour and a layer that is half its green. Spikes at a corner, an edge and
 * inside. */
static void spike_frame(struct gd_plane y[4], struct gd_plane var[3], float height)
{
	static const int at[3][2] = { { 0, 0 }, { 39, 12 }, { 17, 20 } };

	for (int c = 0; c < 4; c++) {
		y[c] = plane(40, 32, 0);
		for (int j = 0; j < 32; j++)
			for (int i = 0; i < 40; i++)
				gd_row(y[c], j)[i] = (c == 3 ? 0.5f : 1) *
						     (1 + 0.01f * (float)((i * 7 + j * 13) % 10));
		for (int k = 0; k < 3; k++)
			gd_row(y[c], at[k][1])[at[k][0]] = (c == 3 ? 0.5f : 1) * height;
	}
	for (int c = 0; c < 3; c++) {
		var[c] = plane(40, 32, 0.01f);
		for (int k = 0; k < 3; k++)
			gd_row(var[c], at[k][1])[at[k][0]] =
				height < 1e18f ? height * height : FLT_MAX;
	}
}

static void test_spikes(void **state)
{
	struct gd_plane y[4], var[3];
	struct gd_apr_spikes spikes;
	double before[4];
	int capped;

	(void)state;
	spike_frame(y, var, 50);
	for (int c = 0; c < 4; c++)
		before[c] = total(y[c]);
	assert_int_equal(gd_apr_spikes_take(&spikes, y, 4, var, true, NULL), GD_OK);
	assert_int_equal(spikes.n, 3);
	for (int k = 0; k < 3; k++)
		for (int c = 0; c < 4; c++) {
			assert_true(fabs(spikes.energy[k * 4 + c] - (c == 3 ? 24.5 : 49)) < 0.1);
			assert_true(gd_row(y[c], spikes.at[k] / 40)[spikes.at[k] % 40] < 1.2f);
		}
	assert_float_equal(gd_row(var[1], 20)[17], 0.01, 1e-6);
	assert_int_equal(gd_apr_spikes_return(&spikes, y, 8, 1.0, &capped, NULL), GD_OK);
	assert_int_equal(capped, 0);
	for (int c = 0; c < 4; c++)
		assert_true(fabs(total(y[c]) / before[c] - 1) < 1e-6);
	for (int j = 0; j < 32; j++)
		for (int i = 0; i < 40; i++)
			assert_true(fabs((double)gd_row(y[3], j)[i] -
					 0.5 * (double)gd_row(y[1], j)[i]) < 1e-6);
	gd_apr_spikes_free(&spikes);
	for (int c = 0; c < 4; c++)
		free(y[c].v);
	for (int c = 0; c < 3; c++)
		free(var[c].v);
}

/* A firefly of 1e30 gives back no more than its window has. */
static void test_capped(void **state)
{
	struct gd_plane y[4], var[3];
	struct gd_apr_spikes spikes;
	int capped;

	(void)state;
	spike_frame(y, var, 1e30f);
	assert_int_equal(gd_apr_spikes_take(&spikes, y, 4, var, true, NULL), GD_OK);
	assert_int_equal(spikes.n, 3);
	assert_int_equal(gd_apr_spikes_return(&spikes, y, 8, 1.0, &capped, NULL), GD_OK);
	assert_int_equal(capped, 3);
	for (int c = 0; c < 4; c++)
		for (int j = 0; j < 32; j++)
			for (int i = 0; i < 40; i++)
				assert_true(gd_row(y[c], j)[i] > 0.4f && gd_row(y[c], j)[i] < 5);
	gd_apr_spikes_free(&spikes);
	for (int c = 0; c < 4; c++)
		free(y[c].v);
	for (int c = 0; c < 3; c++)
		free(var[c].v);
}

/* A light that the samples agree on is no spike; without a variance to say so, it is. */
static void test_certain_light(void **state)
{
	struct gd_plane y[4], var[3];
	struct gd_apr_spikes spikes;

	(void)state;
	spike_frame(y, var, 50);
	for (int c = 0; c < 3; c++)
		gd_row(var[c], 20)[17] = 4;
	assert_int_equal(gd_apr_spikes_take(&spikes, y, 4, var, true, NULL), GD_OK);
	assert_int_equal(spikes.n, 2);
	gd_apr_spikes_free(&spikes);
	assert_int_equal(gd_apr_spikes_take(&spikes, y, 4, var, false, NULL), GD_OK);
	assert_int_equal(spikes.n, 1);
	gd_apr_spikes_free(&spikes);
	assert_int_equal(gd_apr_spikes_take(&spikes, y, 4, var, false, NULL), GD_OK);
	assert_int_equal(spikes.n, 0);
	gd_apr_spikes_free(&spikes);
	for (int c = 0; c < 4; c++)
		free(y[c].v);
	for (int c = 0; c < 3; c++)
		free(var[c].v);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_clean), cmocka_unit_test(test_bin_variance),
		cmocka_unit_test(test_spatial_variance), cmocka_unit_test(test_spikes),
		cmocka_unit_test(test_capped), cmocka_unit_test(test_certain_light),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
