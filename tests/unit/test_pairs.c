/* SPDX-License-Identifier: BSD-3-Clause */
/* Which pixels are compared: affinities, the choice, and what a file may say. */
#include <math.h>
#include <omp.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "buffers.h"
#include "pairs.h"

#define W 37
#define H 29

static uint64_t state = 1;

static double uniform(void)
{
	state = state * 6364136223846793005U + 1442695040888963407U;
	return ((double)(state >> 11) + 0.5) * 0x1p-53;
}

/* An image with the three features; look() gives them from a position. */
static void image(struct gd_image *im, int w, int h,
		  void (*look)(double n[3], double albedo[3], double *z, double u, double v))
{
	struct gd_plane n[GD_LAYER_PLANES], a[GD_LAYER_PLANES], z[GD_LAYER_PLANES];
	struct gd_err err = { 0 };

	gd_image_init(im, w, h);
	assert_int_equal(gd_image_add(im, "N.X", &n[0], &err), GD_OK);
	assert_int_equal(gd_image_add(im, "N.Y", &n[1], &err), GD_OK);
	assert_int_equal(gd_image_add(im, "N.Z", &n[2], &err), GD_OK);
	assert_int_equal(gd_layer_add(im, "albedo", 3, a, &err), GD_OK);
	assert_int_equal(gd_layer_add(im, "Z", 1, z, &err), GD_OK);
	for (int y = 0; y < h; y++)
		for (int x = 0; x < w; x++) {
			double nn[3] = { 0, 0, 1 }, aa[3] = { 0.5, 0.5, 0.5 }, zz = 1;

			if (look)
				look(nn, aa, &zz, x + 0.5 - w / 2.0, y + 0.5 - h / 2.0);
			for (int c = 0; c < 3; c++) {
				gd_row(n[c], y)[x] = (float)nn[c];
				gd_row(a[c], y)[x] = (float)aa[c];
			}
			gd_row(z[0], y)[x] = (float)zz;
		}
}

static float *at(const struct gd_image *im, const char *name, int x, int y)
{
	struct gd_plane p;

	assert_true(gd_image_plane(im, name, &p));
	return gd_row(p, y) + x;
}

static void variance(struct gd_image *im, const char *layer, const char *axes, float value)
{
	char name[64];

	for (; *axes; axes++) {
		struct gd_plane p;

		if (*axes == '-')
			snprintf(name, sizeof(name), "%s.variance", layer);
		else
			snprintf(name, sizeof(name), "%s.variance.%c", layer, *axes);
		assert_int_equal(gd_image_add(im, name, &p, NULL), GD_OK);
		for (int y = 0; y < p.h; y++)
			for (int x = 0; x < p.w; x++)
				gd_row(p, y)[x] = value;
	}
}

static void pairs_of(struct gd_pairs *pairs, const struct gd_image *im)
{
	struct gd_err err = { 0 };

	if (gd_pairs_from_image(pairs, im, &err) != GD_OK)
		fail_msg("%s", err.text);
}

static bool joined(const struct gd_pairs *p, int x, int y, int dx, int dy)
{
	if (dy < 0 || (dy == 0 && dx < 0)) {
		x += dx;
		y += dy;
		dx = -dx;
		dy = -dy;
	}
	if (x < 0 || x >= p->w || y < 0 || y >= p->h)
		return false;
	for (int k = 0; k < GD_PAIRS; k++)
		if (p->dx[k][y * p->w + x] == dx && p->dy[k][y * p->w + x] == dy)
			return true;
	return false;
}

static int degree(const struct gd_pairs *p, int x, int y)
{
	int n = 0;

	for (int dy = -2; dy <= 2; dy++)
		for (int dx = -2; dx <= 2; dx++)
			n += (dx || dy) && joined(p, x, y, dx, dy);
	return n;
}

static int degrees(const struct gd_pairs *p, int most[static 1])
{
	int sum = 0;

	*most = 0;
	for (int y = 0; y < p->h; y++)
		for (int x = 0; x < p->w; x++) {
			const int n = degree(p, x, y);

			sum += n;
			*most = n > *most ? n : *most;
		}
	return sum;
}

static void wavy(double n[3], double albedo[3], double *z, double u, double v)
{
	const double t = 0.4 * sin(0.7 * u + 0.2 * v);

	n[0] = sin(t);
	n[2] = cos(t);
	albedo[0] = 0.5 + 0.2 * sin(0.5 * u) * cos(0.6 * v);
	albedo[1] = fabs(sin(u * v * 0.01));
	albedo[2] = u * u + v * v < 60 ? 0.9 : 0.1;
	*z = 3 + 0.05 * v + (u > 4 ? 2 : 0);
}

/* Eq. 7 written out in double, with the ranges found by looking at all values. */
static double direct(const struct gd_image *im, int x, int y, int i, int j)
{
	static const struct { const char *name[3]; double tau; } feature[3] = {
		{ { "N.X", "N.Y", "N.Z" }, 0.02 },
		{ { "albedo.R", "albedo.G", "albedo.B" }, 0.001 },
		{ { "Z", NULL, NULL }, 0.01 },
	};
	double least = 0;

	for (int k = 0; k < 3; k++) {
		double low = INFINITY, high = -INFINITY, d2 = 0, log_omega;

		for (int c = 0; c < 3 && feature[k].name[c]; c++)
			for (int q = 0; q < im->h; q++)
				for (int p = 0; p < im->w; p++) {
					const double v = (double)*at(im, feature[k].name[c], p, q);

					low = fmin(low, v);
					high = fmax(high, v);
				}
		if (k == 0) {
			low = -1;
			high = 1;
		}
		for (int c = 0; c < 3 && feature[k].name[c]; c++) {
			const double d = (double)*at(im, feature[k].name[c], x, y) -
					 (double)*at(im, feature[k].name[c], i, j);

			d2 += d * d / ((high - low) * (high - low));
		}
		log_omega = -fmax(0, d2 - feature[k].tau) / (0.01 * 0.01);
		least = fmin(least, log_omega);
	}
	return least;
}

static void test_affinity_is_equation_7(void **unused)
{
	struct gd_look *looks;
	struct gd_image im;

	(void)unused;
	image(&im, 17, 13, wavy);	/* too small for its tails to be cut */
	assert_int_equal(gd_pairs_looks(&looks, &im, NULL), GD_OK);
	for (int y = 0; y < 13; y += 3)
		for (int x = 0; x < 17; x++)
			for (int o = 0; o < GD_PAIR_OFFSETS; o++) {
				const int i = x + gd_pair_offset[o][0],
					  j = y + gd_pair_offset[o][1];
				double want, got, back;

				if (i < 0 || i >= 17 || j >= 13)
					continue;
				want = direct(&im, x, y, i, j);
				got = (double)gd_pairs_affinity(&looks[y * 17 + x],
								&looks[j * 17 + i]);
				back = (double)gd_pairs_affinity(&looks[j * 17 + i],
								 &looks[y * 17 + x]);
				assert_true(got == back);
				if (!(fabs(got - want) <= 1e-5 * fabs(want) + 5e-3))
					fail_msg("%d,%d to %d,%d: %g, expected %g", x, y, i, j, got,
						 want);
			}
	free(looks);
	gd_image_free(&im);
}

static void test_flat_image_gives_the_grid(void **unused)
{
	struct gd_pairs p;
	struct gd_image im;

	(void)unused;
	image(&im, W, H, NULL);
	pairs_of(&p, &im);
	for (int y = 2; y < H - 2; y++)
		for (int x = 2; x < W - 2; x++) {
			assert_int_equal(degree(&p, x, y), 4);
			assert_true(joined(&p, x, y, 1, 0));
			assert_true(joined(&p, x, y, 0, 1));
		}
	gd_pairs_free(&p);
	gd_image_free(&im);
}

static int root(const int *part, int i)
{
	while (part[i] != i)
		i = part[i];
	return i;
}

/* The smallest connected part. */
static int smallest_part(const struct gd_pairs *p)
{
	const int n = p->w * p->h;
	int *part = calloc((size_t)n, sizeof(int)), *size = calloc((size_t)n, sizeof(int)),
	    least = n;

	for (int i = 0; i < n; i++)
		part[i] = i;
	for (int i = 0; i < n; i++)
		for (int k = 0; k < GD_PAIRS; k++)
			part[root(part, i)] = root(part, i + p->dy[k][i] * p->w + p->dx[k][i]);
	for (int i = 0; i < n; i++)
		size[root(part, i)]++;
	for (int i = 0; i < n; i++)
		least = size[i] && size[i] < least ? size[i] : least;
	free(part);
	free(size);
	return least;
}

/*
 * Edges that were left out: its ends are hardly alike, or one of them has its
 * four, none of them less alike (but for the few that keep parts together).
 */
static void test_choice_is_stable(void **unused)
{
	struct gd_look *looks;
	struct gd_pairs p;
	struct gd_image im;
	int most, odd = 0;

	(void)unused;
	image(&im, W, H, wavy);
	assert_int_equal(gd_pairs_looks(&looks, &im, NULL), GD_OK);
	pairs_of(&p, &im);
	assert_true(degrees(&p, &most) > 2.5 * W * H);
	assert_int_equal(most, 4);
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++)
			for (int o = 0; o < GD_PAIR_OFFSETS; o++) {
				const int dx = gd_pair_offset[o][0], dy = gd_pair_offset[o][1];
				const int end[2][2] = { { x, y }, { x + dx, y + dy } };
				float worst[2], mine;

				if (x + dx < 0 || x + dx >= W || y + dy >= H ||
				    joined(&p, x, y, dx, dy))
					continue;
				mine = gd_pairs_affinity(&looks[y * W + x],
							 &looks[(y + dy) * W + x + dx]);
				if (mine < -199)
					continue;
				for (int e = 0; e < 2; e++) {
					const int u = end[e][0], v = end[e][1];

					worst[e] = degree(&p, u, v) < 4 ? -INFINITY : 0;
					for (int j = -2; j <= 2; j++)
						for (int i = -2; i <= 2; i++)
							if ((i || j) && joined(&p, u, v, i, j))
								worst[e] = fminf(
									worst[e],
									gd_pairs_affinity(
										&looks[v * W + u],
										&looks[(v + j) * W +
										       u + i]));
				}
				/* the order has steps of 1 / 128 */
				odd += fmaxf(worst[0], worst[1]) < mine * 1.01f - 0.01f;
			}
	if (odd >= 0.05 * W * H)
		fail_msg("%d of %d", odd, W * H);
	free(looks);
	gd_pairs_free(&p);
	gd_image_free(&im);
}

/* Continuous random looks: no ties but at affinities above
 * 0.992, so the mirror image has the mirrored edges. */
static void rough(double n[3], double albedo[3], double *z, double u, double v)
{
	(void)n;
	(void)u;
	(void)v;
	for (int c = 0; c < 3; c++)
		albedo[c] = uniform();
	*z = 1;
}

static void test_no_islands(void **unused)
{
	struct gd_pairs p;
	struct gd_image im;

	(void)unused;
	for (int i = 0; i < 5; i++) {
		image(&im, W, H, rough);
		pairs_of(&p, &im);
		assert_true(smallest_part(&p) >= 25);
		gd_pairs_free(&p);
		gd_image_free(&im);
	}
	image(&im, 3, 2, rough);
	pairs_of(&p, &im);
	assert_int_equal(smallest_part(&p), 6);
	gd_pairs_free(&p);
	gd_image_free(&im);
}

static void test_mirrored(void **unused)
{
	struct gd_pairs p, q;
	struct gd_image im, mirror;
	int same = 0, all = 0;

	(void)unused;
	image(&im, W, H, rough);
	image(&mirror, W, H, NULL);
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++)
			for (int c = 0; c < 3; c++) {
				const char name[] = {
					'a', 'l', 'b', 'e', 'd', 'o', '.', "RGB"[c], 0
				};

				*at(&mirror, name, x, y) = *at(&im, name, W - 1 - x, y);
			}
	pairs_of(&p, &im);
	pairs_of(&q, &mirror);
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++)
			for (int o = 0; o < GD_PAIR_OFFSETS; o++) {
				const int dx = gd_pair_offset[o][0], dy = gd_pair_offset[o][1];
				const bool a = joined(&p, x, y, dx, dy);

				all += a;
				same += a && joined(&q, W - 1 - x, y, -dx, dy);
			}
	assert_true(same > 0.97 * all);
	gd_pairs_free(&p);
	gd_pairs_free(&q);
	gd_image_free(&im);
	gd_image_free(&mirror);
}

static void halves(double n[3], double albedo[3], double *z, double u, double v)
{
	(void)n;
	(void)z;
	albedo[0] = 3 * u + v > 1 ? 0.9 : 0.2;
}

/* An edge in the albedo is crossed only where two pixels find nothing better that is free. */
static void test_edge_is_not_crossed(void **unused)
{
	struct gd_pairs p;
	struct gd_image im;
	int crossing = 0, along = 0;

	(void)unused;
	image(&im, W, H, halves);
	pairs_of(&p, &im);
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++)
			for (int o = 0; o < GD_PAIR_OFFSETS; o++) {
				const int dx = gd_pair_offset[o][0], dy = gd_pair_offset[o][1];

				if (!joined(&p, x, y, dx, dy))
					continue;
				if (*at(&im, "albedo.R", x, y) ==
				    *at(&im, "albedo.R", x + dx, y + dy))
					along++;
				else
					crossing++;
			}
	assert_int_equal(crossing, 0);	/* of a grid some 40 would */
	assert_true(along > 1.9 * W * H);
	gd_pairs_free(&p);
	gd_image_free(&im);
}

static void test_noise_is_not_structure(void **unused)
{
	struct gd_pairs p;
	struct gd_image im;
	int grid = 0;

	(void)unused;
	for (int pass = 0; pass < 2; pass++) {
		state = 7;
		image(&im, W, H, rough);
		if (pass)
			variance(&im, "albedo", "RGB", 1.0f / 12);	/* of a uniform number */
		pairs_of(&p, &im);
		grid = 0;
		for (int y = 0; y < H; y++)
			for (int x = 0; x < W; x++)
				grid += joined(&p, x, y, 1, 0) + joined(&p, x, y, 0, 1);
		if (pass)
			assert_true(grid > 0.9 * 2 * W * H);
		else
			assert_true(grid < 0.5 * 2 * W * H);
		gd_pairs_free(&p);
		gd_image_free(&im);
	}
}

static void test_wild_features(void **unused)
{
	struct gd_pairs p;
	struct gd_image im;
	int most;

	(void)unused;
	image(&im, W, H, wavy);
	*at(&im, "Z", 10, 10) = INFINITY;
	*at(&im, "Z", 20, 10) = 1e30f;
	*at(&im, "albedo.G", 5, 5) = -1e30f;
	*at(&im, "N.X", 30, 20) = NAN;
	variance(&im, "Z", "-", 1e-3f);
	*at(&im, "Z.variance", 3, 3) = NAN;
	*at(&im, "Z.variance", 4, 3) = INFINITY;
	pairs_of(&p, &im);
	assert_true(degrees(&p, &most) > 2.5 * W * H);
	assert_int_equal(most, 4);
	gd_pairs_free(&p);
	gd_image_free(&im);
}

static void test_one_feature_is_enough(void **unused)
{
	struct gd_pairs p;
	struct gd_image im;
	struct gd_err err = { 0 };

	(void)unused;
	image(&im, 9, 1, NULL);
	assert_true(gd_pairs_want(&im));
	gd_image_drop(&im, "albedo.R");
	gd_image_drop(&im, "N.X");
	pairs_of(&p, &im);
	gd_pairs_free(&p);
	gd_image_drop(&im, "Z");
	assert_int_equal(gd_pairs_from_image(&p, &im, &err), GD_ESHAPE);
	assert_string_equal(err.text,
			    "no channel pair0.x, and no albedo, N or Z to choose pairs by");
	assert_false(gd_pairs_want(&im));
	gd_pairs_free(&p);
	gd_image_free(&im);
}

static void test_threads(void **unused)
{
	const int threads = omp_get_max_threads();
	struct gd_pairs p[2];
	struct gd_image im;

	(void)unused;
	image(&im, W, H, wavy);
	for (int i = 0; i < 2; i++) {
		omp_set_num_threads(i ? 5 : 1);
		pairs_of(&p[i], &im);
	}
	omp_set_num_threads(threads);
	for (int k = 0; k < GD_PAIRS; k++) {
		assert_memory_equal(p[0].dx[k], p[1].dx[k], W * H);
		assert_memory_equal(p[0].dy[k], p[1].dy[k], W * H);
	}
	gd_pairs_free(&p[0]);
	gd_pairs_free(&p[1]);
	gd_image_free(&im);
}

static void add_layers(struct gd_image *im, int layers)
{
	char name[16];

	for (int k = 0; k < layers; k++)
		for (const char *a = "xy"; *a; a++) {
			snprintf(name, sizeof(name), "pair%d.%c", k, *a);
			assert_int_equal(gd_image_add(im, name, NULL, NULL), GD_OK);
		}
}

/* The pairs that were chosen are pairs that a file may have, and are read as they are. */
static void test_there_and_back(void **unused)
{
	struct gd_pairs p, q;
	struct gd_image im;
	int most[2];

	(void)unused;
	image(&im, W, H, wavy);
	pairs_of(&p, &im);
	assert_int_equal(gd_pairs_layers(&im), 0);
	add_layers(&im, GD_PAIRS);
	assert_int_equal(gd_pairs_layers(&im), 4);
	for (int k = 0; k < GD_PAIRS; k++)
		for (int i = 0; i < W * H; i++) {
			char name[16];

			snprintf(name, sizeof(name), "pair%d.x", k);
			*at(&im, name, i % W, i / W) = p.dx[k][i];
			snprintf(name, sizeof(name), "pair%d.y", k);
			*at(&im, name, i % W, i / W) = p.dy[k][i];
		}
	pairs_of(&q, &im);
	assert_int_equal(degrees(&p, most), degrees(&q, most + 1));
	for (int k = 0; k < GD_PAIRS; k++) {
		assert_memory_equal(p.dx[k], q.dx[k], W * H);
		assert_memory_equal(p.dy[k], q.dy[k], W * H);
	}
	gd_pairs_free(&p);
	gd_pairs_free(&q);
	gd_image_free(&im);
}

static void pair_channels(struct gd_image *im, int layers)
{
	gd_image_init(im, 8, 6);
	add_layers(im, layers);
}

static void refused(struct gd_image *im, int code, const char *text)
{
	struct gd_pairs p;
	struct gd_err err = { 0 };

	assert_int_equal(gd_pairs_from_image(&p, im, &err), code);
	assert_string_equal(err.text, text);
	assert_null(p.dx[0]);
	gd_image_free(im);
}

static void test_what_a_file_may_say(void **unused)
{
	struct gd_image im;

	(void)unused;
	pair_channels(&im, 2);
	*at(&im, "pair1.x", 3, 2) = NAN;
	refused(&im, GD_EFORMAT,
		"pair1.x is nan at pixel 3,2, expected a whole number from -2 to 2");
	pair_channels(&im, 2);
	*at(&im, "pair0.y", 3, 2) = 0.5f;
	refused(&im, GD_EFORMAT,
		"pair0.y is 0.5 at pixel 3,2, expected a whole number from -2 to 2");
	pair_channels(&im, 2);
	*at(&im, "pair0.y", 3, 2) = 3;
	refused(&im, GD_EFORMAT, "pair0.y is 3 at pixel 3,2, expected a whole number from -2 to 2");
	pair_channels(&im, 1);
	*at(&im, "pair0.x", 7, 2) = 1;
	refused(&im, GD_EFORMAT, "pair0 is 1,0 at pixel 7,2: there is no pixel in an image of 8x6");
	pair_channels(&im, 1);
	*at(&im, "pair0.x", 7, 2) = -1;
	refused(&im, GD_EFORMAT,
		"pair0 is -1,0 at pixel 7,2: expected at the first of the two pixels in scan "
		"order, as 1,0");
	pair_channels(&im, 1);
	*at(&im, "pair0.x", 3, 2) = 1;
	*at(&im, "pair0.y", 3, 2) = -1;
	refused(&im, GD_EFORMAT,
		"pair0 is 1,-1 at pixel 3,2: expected at the first of the two pixels in scan "
		"order, as -1,1");
	pair_channels(&im, 2);
	*at(&im, "pair0.x", 3, 2) = *at(&im, "pair1.x", 3, 2) = 1;
	refused(&im, GD_EFORMAT, "pair1 is 1,0 at pixel 3,2, as is pair0");
	pair_channels(&im, 2);
	for (int x = 1; x < 6; x++) {
		*at(&im, "pair0.x", x, 2) = (float)(3 - x < -2 ? -2 : 3 - x);
		*at(&im, "pair0.y", x, 2) = 2;
	}
	refused(&im, GD_EFORMAT, "pixel 3,4 is in more than 4 pairs");
	pair_channels(&im, 5);
	refused(&im, GD_EFORMAT, "channel pair4.x: expected 4 pairs at most");
	pair_channels(&im, 2);
	gd_image_drop(&im, "pair1.y");
	refused(&im, GD_ESHAPE, "no channel pair1.y");
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_affinity_is_equation_7),
		cmocka_unit_test(test_flat_image_gives_the_grid),
		cmocka_unit_test(test_choice_is_stable),
		cmocka_unit_test(test_no_islands),
		cmocka_unit_test(test_mirrored),
		cmocka_unit_test(test_edge_is_not_crossed),
		cmocka_unit_test(test_noise_is_not_structure),
		cmocka_unit_test(test_wild_features),
		cmocka_unit_test(test_one_feature_is_enough),
		cmocka_unit_test(test_threads),
		cmocka_unit_test(test_there_and_back),
		cmocka_unit_test(test_what_a_file_may_say),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
