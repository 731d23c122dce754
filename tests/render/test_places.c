/* SPDX-License-Identifier: BSD-3-Clause */
/* Where in their pixels samples lie. */
#include "film_world.h"

#define PLACED 64
#define SEEDS 200

/* What positions the samples of pixels had, in the order of a pixel's samples. */
struct places {
	float at[H][W][PLACED][2];
	int n[H][W];
};

static void placed(const void *user, const struct gd_path_conf *conf, const struct gd_path_in *in,
		   struct gd_draw *draw, struct gd_path_out *out)
{
	static const struct world even = { 0 };
	struct places *p = *(struct places *const *)user;
	const int n = p->n[in->y][in->x]++;

	assert_true(n < PLACED);
	assert_true(in->at[0] >= 0 && in->at[0] < 1 && in->at[1] >= 0 && in->at[1] < 1);
	p->at[in->y][in->x][n][0] = in->at[0];
	p->at[in->y][in->x][n][1] = in->at[1];
	sample(&even, conf, in, draw, out);
}

/* The largest difference between the share of points in a box from the corner and its area. */
static double discrepancy(float at[PLACED][2], int first, int step)
{
	const int n = (PLACED - first + step - 1) / step;
	double most = 0;

	for (int i = 1; i <= 16; i++)
		for (int k = 1; k <= 16; k++) {
			int in = 0;

			for (int s = first; s < PLACED; s += step)
				in += at[s][0] * 16 < (float)i && at[s][1] * 16 < (float)k;
			most = fmax(most, fabs((double)in / n - i * k / 256.0));
		}
	return most;
}

/* The same at every pixel, even over the pixel in all, in each half and, less so, in each bin; the
 * halves are independent. */
static void test_places(void **state)
{
	struct gd_render_conf conf = usual();
	struct places *p = calloc(1, sizeof *p);
	double mean[2] = { 0 }, all = 0, half = 0, bin = 0, square[2] = { 0 }, product = 0;

	(void)state;
	assert_non_null(p);
	conf.spp = PLACED;
	for (conf.seed = 1; conf.seed <= SEEDS; conf.seed++) {
		struct gd_image im = { 0 };

		memset(p->n, 0, sizeof p->n);
		assert_int_equal(gd_render_samples(&im, placed, &p, &conf, NULL, NULL), GD_OK);
		gd_image_free(&im);
		for (int i = 0; i < W * H; i++)
			assert_memory_equal(p->at[i / W][i % W], p->at[0][0], sizeof p->at[0][0]);
		all += discrepancy(p->at[0][0], 0, 1) / SEEDS;
		for (int k = 0; k < 2; k++)
			half += discrepancy(p->at[0][0], k, 2) / (2 * SEEDS);
		for (int b = 0; b < 8; b++)
			bin += discrepancy(p->at[0][0], b, 8) / (8 * SEEDS);
		for (int c = 0; c < 2; c++)
			mean[c] += (double)p->at[0][0][0][c] / SEEDS;
		/* an edge through the pixel, as 16 samples see it */
		double e[2] = { -0.4, -0.4 };

		for (int s = 0; s < 16; s++)
			e[s % 2] += (p->at[0][0][s][0] < 0.4f) / 8.0;
		for (int k = 0; k < 2; k++)
			square[k] += e[k] * e[k];
		product += e[0] * e[1];
	}
	/* random points: .118, .172 and .354 */
	if (!(all < 0.07 && half < 0.11 && bin < 0.28))
		fail_msg("%.3f in all, %.3f in a half, %.3f in a bin", all, half, bin);
	/* each by itself is uniform: 1 / sqrt(12 * 200) */
	for (int c = 0; c < 2; c++)
		assert_true(fabs(mean[c] - 0.5) < 4 * 0.0204);
	/* halves are independent: 1 / sqrt(200) */
	if (!(fabs(product) < 4 * 0.071 * sqrt(square[0] * square[1])))
		fail_msg("halves correlate by %.2f", product / sqrt(square[0] * square[1]));
	free(p);
}

int main(void)
{
	const struct CMUnitTest tests[] = { cmocka_unit_test(test_places) };

	return cmocka_run_group_tests(tests, NULL, NULL);
}
