/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * dof: a supper table at dusk through an open lens. Only the cup in the middle is in focus; before
 * and behind it fine noisy textures dissolve, and small lamps become large discs.
 */
#ifndef SCENE_DOF_H
#define SCENE_DOF_H

#include "scene_room.h"

static void gravel(double u, double v, double c[3])
{
	const double grain = noise_at((int)(u * 96), (int)(v * 96), 13),
		     big = clouds(u, v, 5, 3, 29);
	const double g = 0.18 + 0.5 * grain * grain + 0.25 * (big - 0.5),
		     hue = noise_at((int)(u * 24), (int)(v * 24), 14);

	c[0] = g * mix(1.0, 1.25, hue), c[1] = g * 1.0, c[2] = g * mix(1.05, 0.8, hue);
}

static void bricks(double u, double v, double c[3])
{
	const double y = v * 8, x = u * 4 + ((int)y & 1 ? 0.5 : 0), a = x - floor(x),
		     b = y - floor(y);
	const double joint =
		smooth(0.03, 0.07, fmin(a, 1 - a)) * smooth(0.08, 0.16, fmin(b, 1 - b));
	const double one = noise_at((int)floor(x) & 3, (int)y, 51),
		     grain = noise_at((int)(u * 96), (int)(v * 96), 52);
	const double l = 0.75 + 0.35 * grain;

	c[0] = l * mix(0.62, mix(0.52, 0.74, one), joint),
	c[1] = l * mix(0.60, mix(0.26, 0.40, one), joint);
	c[2] = l * mix(0.56, mix(0.20, 0.30, one), joint);
}

static struct p3 table_cloth(double u, double v, const void *arg)
{
	const double x = u - 0.5, drop = fmax(fabs(x) - 0.38, 0),
		     wave = 0.004 * clouds(u, v, 4, 2, 61);

	(void)arg;
	return p3(1.5 * x, wave - 3.0 * drop * drop, -1.9 * v);
}

/* Lamps on a cord that hangs from a to b. */
static void dof_lamps(struct scene *s, int lamp, int black, struct p3 a, struct p3 b, double sag,
		      int n)
{
	struct p3 cord[9];
	struct mesh m = { 0 };
	int bulb;

	ball(&m, at(0, 0, 0), 0.012, 10);
	bulb = shape(s, &m, lamp);
	for (int i = 0; i < 9; i++) {
		const double t = i / 8.0;

		cord[i] = mad(a, t, sub(b, a));
		cord[i].y -= 4 * sag * t * (1 - t);
	}
	tube(&m, at(0, 0, 0), cord, 9, 0.003, 0.003, 2, 6);
	thing(s, &m, black, at(0, 0, 0));
	for (int i = 0; i < n; i++) {
		const struct p3 p = curve(cord, 9, 8 * (i + 0.5) / n);

		stand(s, bulb, at(p.x, p.y - 0.018, p.z));
	}
}

/* Two of them, one turned. */
static void dof_shrubs(struct scene *s, int leaf, int clay, struct place one, struct place two)
{
	const struct knot pot[] = { { 0, 0, 1 },        { 0.10, 0, 0 },     { 0.11, 0.01, 0 },
				    { 0.15, 0.26, 1 },  { 0.165, 0.26, 1 }, { 0.165, 0.30, 1 },
				    { 0.145, 0.30, 1 }, { 0.14, 0.27, 1 },  { 0, 0.27, 1 } };
	const unsigned seed = 3;
	struct mesh m = { 0 };
	int pots, leaves;

	lathe(&m, at(0, 0, 0), pot, COUNT(pot), 2, 28);
	pots = shape(s, &m, clay);
	for (int i = 0; i < 90; i++) {
		const double a = 2.399963 * i, r = 0.26 * sqrt(noise_at(i, 1, seed)),
			     h = 0.35 + 0.55 * noise_at(i, 2, seed);
		const struct place here = turned(turned(turned(at(r * cos(a), h, r * sin(a)), 'y',
							       360 * noise_at(i, 3, seed)),
							'x', 130 * noise_at(i, 4, seed)),
						 'z', 60 * noise_at(i, 5, seed));

		box(&m, here, p3(0.020, 0.003, 0.045), 0.003, 1, 1);
	}
	leaves = shape(s, &m, leaf);
	stand(s, pots, one);
	stand(s, leaves, one);
	stand(s, pots, two);
	stand(s, leaves, two);
}

static void dof_things(struct scene *s)
{
	const int china = gloss(s, 0.80, 0.78, 0.74, 0.18), steel = metal(s, 0.7, 0.68, 0.66, 0.2);
	const int wood_ = textured(s, "wood.png", 0.4), rough = textured(s, "gravel.png", 0.8);
	const int clear = glass(s, 1, 1, 1, 0), wine = glass(s, 0.75, 0.10, 0.14, 0),
		  green = glass(s, 0.5, 0.8, 0.55, 0);
	const int orange = gloss(s, 0.85, 0.38, 0.06, 0.4), lemon = gloss(s, 0.85, 0.72, 0.10, 0.4);
	const struct knot mill[] = { { 0, 0, 1 },         { 0.030, 0, 0 },     { 0.032, 0.01, 0 },
				     { 0.020, 0.05, 0 },  { 0.024, 0.09, 0 },  { 0.028, 0.12, 0 },
				     { 0.016, 0.135, 0 }, { 0.024, 0.155, 0 }, { 0.016, 0.178, 0 },
				     { 0, 0.184, 0 } };
	const struct knot plate[] = { { 0, 0.004, 1 },     { 0.06, 0.004, 0 },  { 0.065, 0, 0 },
				      { 0.07, 0.004, 0 },  { 0.12, 0.018, 0 },  { 0.123, 0.021, 0 },
				      { 0.119, 0.021, 0 }, { 0.075, 0.009, 0 }, { 0, 0.008, 1 } };
	const struct knot liquid[] = { { 0, 0.0925, 1 },
				       { 0.012, 0.0955, 0 },
				       { 0.0305, 0.117, 0 },
				       { 0.0345, 0.135, 1 },
				       { 0, 0.135, 1 } };
	const struct p3 fork[] = { { 0, 0.004, 0.10 }, { 0, 0.007, 0.0 }, { 0, 0.003, -0.08 } };
	const int stem = wine_glass(s, clear), fruit_ = fruit(s, orange, 0.037, 0.03),
		  cup_ = cup(s, china, 1);
	struct mesh m = { 0 };
	int dish, drop;

	lathe(&m, at(0, 0, 0), plate, COUNT(plate), 3, 40);
	dish = shape(s, &m, china);
	lathe(&m, at(0, 0, 0), liquid, COUNT(liquid), 3, 28);
	drop = shape(s, &m, wine);
	stand(s, cup_, turned(at(0.02, 0.752, -0.42), 'y', -40)); /* in focus */
	stand(s, dish, at(0.02, 0.748, -0.42));
	stand(s, fruit_, at(-0.13, 0.752, -0.47));
	stand(s, fruit(s, lemon, 0.032, 0), turned(at(0.15, 0.78, -0.40), 'z', 80));
	lathe(&m, at(0, 0, 0), mill, COUNT(mill), 3, 28);
	thing(s, &m, wood_, at(-0.21, 0.75, -0.10)); /* near */
	for (int i = 0; i < 3; i++) {
		tube(&m, turned(at(0.035 * i, 0, 0), 'y', 4 * i), fork, 3, 0.006, 0.004, 5, 10);
		box(&m, at(0.035 * i, 0.004, -0.10), p3(0.010, 0.002, 0.03), 0.002, 1, 1);
	}
	thing(s, &m, steel, turned(at(0.17, 0.752, -0.08), 'y', -14));
	box(&m, at(0, 0, 0), p3(0.10, 0.006, 0.07), 0.004, 2, 6);
	thing(s, &m, rough, turned(at(0.0, 0.757, -0.10), 'y', 22)); /* a trivet of stone */
	ball(&m, at(0, 0, 0), 0.018, 24);
	thing(s, &m, steel, at(-0.02, 0.781, -0.09));
	for (int i = 0; i < 2; i++) {
		const struct place here = at(i ? 0.30 : -0.26, 0.75, i ? -0.75 : -0.95);

		stand(s, stem, here);
		stand(s, drop, here);
	}
	stand(s, bottle(s, green, 1.05), at(0.08, 0.75, -1.05));
	stand(s, dish, at(-0.30, 0.75, -0.72));
	stand(s, bowl(s, rough, 0.12, 0.07), at(0.36, 0.75, -1.15));
	stand(s, fruit_, at(0.34, 0.77, -1.14));
	stand(s, fruit_, turned(at(0.41, 0.77, -1.17), 'x', 60));
}

static void dof(const char *folder)
{
	struct mesh m = { 0 };
	struct scene s;
	int brick, ground, cloth, lamp, warm, leaf, clay, black, wood_;

	scene_open(&s, folder, "dof");
	brick = textured(&s, "bricks.png", 0.9);
	ground = textured(&s, "gravel.png", 0.9);
	cloth = textured(&s, "check.png", 0.9);
	lamp = light(&s, 1, 0.72, 0.38, 90);
	warm = light(&s, 1, 0.80, 0.55, 36);
	leaf = gloss(&s, 0.12, 0.28, 0.08, 0.35);
	clay = matte(&s, 0.50, 0.24, 0.14);
	black = matte(&s, 0.03, 0.03, 0.03);
	wood_ = textured(&s, "wood.png", 0.5);
	wall(&s, ground, p3(-4, 0, 2), p3(8, 0, 0), p3(0, 0, -5), 1);
	wall(&s, brick, p3(-4, 0, -2.6), p3(8, 0, 0), p3(0, 3.0, 0), 1);
	sheet(&m, at(0, 0, 0), 48, 48, table_cloth, NULL, 6, 8);
	thing(&s, &m, cloth, at(0, 0.746, 0.30));
	block(&s, wood_, p3(-0.55, 0.70, -1.55), p3(0.55, 0.735, 0.25), 0.005);
	dof_lamps(&s, lamp, black, p3(-1.3, 1.38, -2.45), p3(1.4, 1.42, -2.4), 0.22, 11);
	dof_lamps(&s, lamp, black, p3(-1.2, 1.20, -1.9), p3(1.5, 1.32, -2.1), 0.18, 8);
	dof_shrubs(&s, leaf, clay, at(-0.95, 0, -2.1), turned(at(0.95, 0, -2.25), 'y', 130));
	wall(&s, warm, p3(-1.9, 1.5, -0.1), p3(0.0, 0.0, -0.8), p3(0.25, 0.75, 0), 1);
	dof_things(&s);
	s.camera = (struct camera){ { 0.06, 1.10, 0.52 }, { 0.0, 0.86, -0.42 }, 36 };
	scene_write(&s, "dof", "--depth 8 --aperture 0.022 --focus 0.98 --sky 0.22,0.30,0.46");
	scene_close(&s);
}

#endif
