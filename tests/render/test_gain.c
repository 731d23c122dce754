/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * What gradients are for: how much less the difference of two neighbours varies if it comes from
 * offset paths than if it comes from their colours, at equal
 * samples; and what that is worth once an image has been made of it.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <cmocka.h>

#include "../support/render_room.h"
#include "../support/render_shot.h"
#include "poisson.h"

#define W 16
#define H 12
#define WIDE 320
#define HIGH 240

struct tile {
	const char *name;
	struct room room;
	int x, y;		/* of its first pixel, of WIDE x HIGH */
	double least;		/* gain that it must have */
};

/* Sum of the variances of all differences of neighbours: from colours over from halves. */
static double gain(const struct tile *t)
{
	struct gd_scene *scene = room_new(&t->room);
	struct shot s = { .w = W, .h = H, .x0 = t->x, .y0 = t->y, .wide = WIDE, .high = HIGH,
			  .scene = scene, .ring = NEXT, .spp = 256, .seed = 4 };
	double colours = 0, halves = 0;

	s.conf = (struct gd_path_conf){ .depth = 8, .shift_ratio = 20, .mis = true };
	shoot(&s);
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++)
			for (int k = 0; k < 2; k++) {
				const struct spot *i = &s.spot[y * W + x], *j;

				if (x + NEXT[k][0] >= W || y + NEXT[k][1] >= H)
					continue;
				j = &s.spot[(y + NEXT[k][1]) * W + x + NEXT[k][0]];
				colours += variance(i->colour) + variance(j->colour);
				halves += variance(i->half[k]) + variance(j->half[k + 2]);
			}
	free(s.spot);
	gd_scene_free(scene);
	return colours / halves;
}

#define TILE(called, of, holds, lit, at_x, at_y, want)                                             \
	{ .name = called, .room.floor = of, .room.ball = holds, .room.light = lit, .x = at_x,      \
	  .y = at_y, .least = want }

static void test_halves_vary_less_than_colours(void **state)
{
	const struct gd_material paint = matter(0.7f), grey = matter(0.5f);
	const struct tile t[] = {
		TILE("floor", paint, grey, LAMP, 60, 200, 5),
		TILE("wall", paint, grey, LAMP, 220, 60, 5),
		TILE("edge of the ball", paint, grey, LAMP, 200, 130, 1),
		TILE("point light", paint, grey, POINT | SPOT, 60, 200, 5),
		TILE("sky", paint, grey, SKY, 60, 200, 5),
		TILE("silk floor", plastic(0.4f, 0.4f), grey, LAMP, 150, 215, 3),
		TILE("varnished floor", plastic(0.4f, 0.15f), grey, LAMP, 150, 215, 3),
		TILE("brushed floor", metal(0.8f, 0.3f), grey, LAMP, 150, 215, 3),
		TILE("polished floor", metal(0.8f, 0.15f), grey, LAMP, 150, 215, 3),
		TILE("mirror floor", metal(0.8f, 0), grey, LAMP, 60, 200, 3),
		TILE("mirror ball", paint, metal(0.8f, 0), POINT, 176, 164, 3),
		TILE("varnish, a point", plastic(0.4f, 0.15f), grey, POINT, 150, 215, 3),
		TILE("frosted ball, sun", paint, glass(0.15f), SUN, 170, 120, 1),
		TILE("caustic", paint, glass(0), LAMP, 190, 190, 1),
		TILE("glass ball", paint, glass(0), LAMP, 170, 120, 1),
		TILE("sharp glass ball", paint, glass(0.15f), LAMP, 170, 120, 1),
		TILE("rough glass ball", paint, glass(0.5f), LAMP, 170, 120, 1),
		TILE("lens", paint, grey, LAMP, 60, 200, 5),
	};

	(void)state;
	for (size_t i = 0; i < sizeof t / sizeof t[0]; i++) {
		struct tile one = t[i];
		double g;

		if (i + 1 == sizeof t / sizeof t[0])
			one.room.lens = 0.05f;
		g = gain(&one);
		print_message("%-18s gain %.1f\n", one.name, g);
		if (!(g > one.least) && !getenv("KEEP"))
			fail_msg("%s: %.2f, should be above %.1f", one.name, g, one.least);
	}
}

/* --- images from gradients --- */

#define SEEDS 128

/* The image that samples of one seed give: screened least squares. */
static void reconstruct(double *image, const struct gd_scene *scene, uint64_t seed)
{
	struct shot s = { .w = W, .h = H, .scene = scene, .ring = NEXT, .spp = 4, .seed = seed };
	struct gd_poisson_conf conf = GD_POISSON_DEFAULTS;
	struct gd_poisson_in in = { .n = 1 };
	float room[4][H * W];
	struct gd_plane p[4];
	struct gd_err err = { 0 };

	s.conf = (struct gd_path_conf){ .depth = 8, .shift_ratio = 20, .mis = true };
	shoot(&s);
	for (int i = 0; i < 4; i++)
		p[i] = (struct gd_plane){ room[i], W, H, W };
	in.primal[0] = p[0];
	in.dx[0] = p[1];
	in.dy[0] = p[2];
	for (int i = 0; i < W * H; i++) {
		const struct spot *q = &s.spot[i];

		room[0][i] = (float)mean(q->colour);
		room[1][i] = room[2][i] = 0;
		if (i % W + 1 < W)
			room[1][i] = (float)(mean(q->half[0]) - mean(q[1].half[2]));
		if (i / W + 1 < H)
			room[2][i] = (float)(mean(q->half[1]) - mean(q[W].half[3]));
	}
	conf.method = GD_L2;
	conf.tolerance = 1e-7;
	assert_int_equal(gd_poisson_solve(&p[3], &in, &conf, NULL, NULL, &err), GD_OK);
	for (int i = 0; i < W * H; i++)
		image[i] = (double)room[3][i];
	free(s.spot);
}

/* Mean squared error of means of n seeds, less that of what is held for the truth. */
static double error_of(double (*image)[W * H], int n, const struct shot *truth)
{
	double sum = 0, known = 0;

	for (int g = 0; g < SEEDS / n; g++)
		for (int i = 0; i < W * H; i++) {
			double m = 0;

			for (int k = 0; k < n; k++)
				m += image[g * n + k][i] / n;
			m -= mean(truth->spot[i].colour);
			sum += m * m / (SEEDS / n);
		}
	for (int i = 0; i < W * H; i++)
		known += variance(truth->spot[i].colour);
	return (sum - known) / (W * H);
}

/* The mean over seeds comes to the truth, with the square root of their number. */
static void test_images_from_gradients_are_unbiased(void **state)
{
	static double image[SEEDS][W * H];
	const struct room room = { plastic(0.4f, 0.15f), metal(0.8f, 0.3f), LAMP, 0 };
	struct gd_scene *scene = room_new(&room);
	struct shot truth = { .w = W, .h = H, .scene = scene, .spp = 6000, .seed = 1 };
	struct chi2 chi = { 0 };
	double x = 0, y = 0, xx = 0, xy = 0, slope, raw = 0;
	int n = 0;

	(void)state;
	truth.conf = (struct gd_path_conf){ .depth = 8, .shift_ratio = 20, .mis = true };
	shoot(&truth);
	for (int i = 0; i < SEEDS; i++)
		reconstruct(image[i], scene, 100 + (uint64_t)i);
	for (int k = 1; k <= SEEDS / 4; k *= 2) {
		const double u = log(k), v = 0.5 * log(error_of(image, k, &truth));

		x += u;
		y += v;
		xx += u * u;
		xy += u * v;
		n++;
	}
	slope = (n * xy - x * y) / (n * xx - x * x);
	for (int i = 0; i < W * H; i++) {
		const struct stat t = truth.spot[i].colour;
		struct stat s = { 0 };

		for (int k = 0; k < SEEDS; k++)
			note(&s, image[k][i]);
		judge(&chi, mean(s) - mean(t), variance(s) + variance(t));
		raw += variance(t) * t.n / 4 / (W * H);
	}
	print_message("reconstruction: slope %.3f, chi2 %.3f (worst %.1f), squared error %.3f of "
		      "the colours'\n",
		      slope, chi2_mean(chi), chi.worst, error_of(image, 1, &truth) / raw);
	free(truth.spot);
	gd_scene_free(scene);
	assert_true(fabs(slope + 0.5) < 0.1);
	/* errors of neighbours are alike here */
	assert_true(chi2_mean(chi) < 3 && chi.worst < 5);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_halves_vary_less_than_colours),
		cmocka_unit_test(test_images_from_gradients_are_unbiased),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
