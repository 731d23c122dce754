/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * caustic: solid and blown glass on a matte table under a small bright lamp. What the glass focuses
 * can only be found by paths that hit the lamp by chance.
 */
#ifndef SCENE_CAUSTIC_H
#define SCENE_CAUSTIC_H

#include "scene_room.h"

/* Floor that rises to a wall behind. */
static struct p3 backdrop(double u, double v, const void *arg)
{
	const double l = 4.2 * v, flat = 2.2, r = 0.6, bend = r * PI / 2, x = 4 * (u - 0.5);
	const double a = fmin(fmax((l - flat) / r, 0), PI / 2), up = fmax(l - flat - bend, 0);

	(void)arg;
	return p3(x, r * (1 - cos(a)) + up, -fmin(l, flat) - r * sin(a));
}

/* A drop of glass, twisted by lobes. */
static struct p3 twist(double u, double v, const void *arg)
{
	const double h = 0.24, t = PI * v, a = 2 * PI * u;
	const double lobe = 1 + 0.10 * cos(5 * a + 4 * v) * sin(t) * sin(t);
	const double r = 0.058 * sin(t) * (1 - 0.45 * v) * 1.25 * lobe, *scale = arg;

	return p3(*scale * r * cos(a), *scale * h * 0.5 * (1 - cos(t)), *scale * -r * sin(a));
}

static void caustic_glass(struct scene *s)
{
	const int clear = glass(s, 1, 1, 1, 0), rough = glass(s, 0.97, 0.99, 1, 0.36),
		  amber = glass(s, 0.95, 0.55, 0.12, 0);
	const int blue = glass(s, 0.25, 0.50, 0.95, 0.16), green = glass(s, 0.45, 0.85, 0.55, 0);
	const struct knot weight[] = { { 0, 0, 1 },         { 0.055, 0, 0 },
				       { 0.064, 0.012, 0 }, { 0.058, 0.035, 0 },
				       { 0.030, 0.062, 0 }, { 0, 0.070, 0 } };
	const struct knot vase[] = {
		{ 0, 0, 1 },         { 0.038, 0, 0 },     { 0.043, 0.006, 0 }, { 0.062, 0.06, 0 },
		{ 0.055, 0.12, 0 },  { 0.034, 0.165, 0 }, { 0.044, 0.20, 0 },  { 0.041, 0.202, 0 },
		{ 0.029, 0.165, 0 }, { 0.049, 0.12, 0 },  { 0.055, 0.06, 0 },  { 0.036, 0.018, 0 },
		{ 0, 0.014, 1 },
	};
	const double large = 1;
	struct mesh m = { 0 };

	ball(&m, at(0, 0, 0), 0.07, 56);
	thing(s, &m, clear, at(-0.10, 0.0702, -0.02));
	stand(s, wine_glass(s, clear), at(0.10, 0, -0.06));
	sheet(&m, at(0, 0, 0), 56, 28, twist, &large, 1, 1);
	thing(s, &m, amber, at(0.24, 0, -0.16));
	lathe(&m, at(0, 0, 0), vase, COUNT(vase), 3, 40);
	thing(s, &m, blue, at(-0.27, 0, -0.20));
	box(&m, at(0, 0, 0), p3(0.045, 0.045, 0.045), 0.006, 2, 1);
	thing(s, &m, rough, turned(at(0.04, 0.0452, 0.13), 'y', 32));
	lathe(&m, at(0, 0, 0), weight, COUNT(weight), 4, 40);
	thing(s, &m, green, at(-0.21, 0.0002, 0.13));
	stand(s, tumbler(s, clear, 0.038, 0.10), at(0.23, 0.0002, 0.07));
}

static void caustic(const char *folder)
{
	struct mesh m = { 0 };
	struct scene s;
	int paper, grey, lamp, fill, pearl, brass;

	scene_open(&s, folder, "caustic");
	paper = matte(&s, 0.62, 0.58, 0.52);
	lamp = light(&s, 1, 0.90, 0.76, 165);
	fill = light(&s, 0.75, 0.87, 1, 1.6);
	grey = matte(&s, 0.35, 0.36, 0.40);
	pearl = gloss(&s, 0.80, 0.30, 0.25, 0.2);
	brass = metal(&s, 0.85, 0.65, 0.32, 0.25);
	sheet(&m, at(0, 0, 0), 1, 96, backdrop, NULL, 1, 1);
	thing(&s, &m, paper, at(0, 0, 1.4));
	room(&s, p3(-1.9, -0.02, -1.3), p3(1.9, 2.4, 1.8),
	     (const int[]){ grey, paper, grey, grey, grey, grey }, 1);
	glowing_disc(&s, lamp, p3(-0.55, 1.05, -0.45), 0.08);
	wall(&s, fill, p3(1.2, 0.6, 0.9), p3(0, 0, -1.4), p3(-0.4, 1.0, 0), 1);
	ball(&m, at(0, 0, 0), 0.022, 28);
	thing(&s, &m, pearl, at(0.0, 0.022, -0.16));
	{
		const struct knot ring[] = { { 0.030, 0.004, 0 },
					     { 0.034, 0, 0 },
					     { 0.038, 0.004, 0 },
					     { 0.034, 0.010, 0 },
					     { 0.030, 0.004, 0 } };

		lathe(&m, at(0, 0, 0), ring, COUNT(ring), 4, 48);
		thing(&s, &m, brass, at(-0.06, 0, 0.20));
	}
	caustic_glass(&s);
	s.camera = (struct camera){ { 0.04, 0.44, 0.82 }, { 0.0, 0.055, -0.02 }, 36 };
	scene_write(&s, "caustic", "--depth 12");
	scene_close(&s);
}

#endif
