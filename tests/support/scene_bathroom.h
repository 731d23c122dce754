/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * bathroom: tiles, folded towels, wood, a mirror over the basin and a lamp over the mirror. Texture
 * and geometry carry the edges, half of them seen in the mirror.
 */
#ifndef SCENE_BATHROOM_H
#define SCENE_BATHROOM_H

#include "scene_room.h"

/* A square of 2 x 2 glazed tiles with veins and joints. */
static void tiles(double u, double v, double c[3])
{
	const double x = u * 2 - floor(u * 2), y = v * 2 - floor(v * 2);
	const double joint = smooth(0.015, 0.03, fmin(fmin(x, 1 - x), fmin(y, 1 - y)));
	const double vein = smooth(0.06, 0, fabs(clouds(u, v, 3, 4, 41) - 0.5));
	const int i = (int)(u * 2), j = (int)(v * 2);
	const double shade = 0.93 + 0.07 * noise_at(i, j, 17) - 0.16 * vein;

	c[0] = mix(0.50, 0.86 * shade, joint), c[1] = mix(0.49, 0.93 * shade, joint);
	c[2] = mix(0.47, 0.92 * shade, joint);
}

/* 8 x 8 little stones. */
static void mosaic(double u, double v, double c[3])
{
	const double x = u * 8 - floor(u * 8), y = v * 8 - floor(v * 8);
	const double joint = smooth(0.05, 0.10, fmin(fmin(x, 1 - x), fmin(y, 1 - y)));
	const double a = noise_at((int)(u * 8), (int)(v * 8), 5),
		     b = noise_at((int)(u * 8), (int)(v * 8), 6);
	const double l = 0.35 + 0.5 * b;

	c[0] = mix(0.6, l * mix(0.35, 0.9, a), joint),
	c[1] = mix(0.58, l * mix(0.62, 0.85, a), joint);
	c[2] = mix(0.55, l * mix(0.75, 0.70, a), joint);
}

/* Terry cloth with a woven border every turn of v. */
static void terry(double u, double v, double c[3])
{
	const double loop = 0.80 + 0.20 * noise_at((int)(u * 96), (int)(v * 96), 77);
	const double band = v > 0.80 && v < 0.95 ? 1 : 0,
		     line = band && sin(u * 2 * PI * 12) > 0 ? 1 : 0;
	const double stripe = band && ((v > 0.82 && v < 0.845) || (v > 0.905 && v < 0.93)) ? 1 : 0;

	c[0] = loop * mix(0.83, mix(0.90, 0.45, line), band),
	c[1] = loop * mix(0.55, mix(0.88, 0.30, line), band);
	c[2] = loop * mix(0.42, mix(0.80, 0.25, line), band);
	for (int k = 0; k < 3; k++)
		c[k] = mix(c[k], 0.2, stripe);
}

/* A towel over a rail along x: up the back, over, and down the front, in folds. */
struct towel {
	double width, front, back, folds, phase;
};

static struct p3 towel_at(double u, double v, const void *arg)
{
	const struct towel *t = arg;
	const double round = 0.05, all = t->front + t->back + round, l = v * all - t->front;
	const double down = l < 0 ? -l : l > round ? l - round : 0, loose = smooth(0, 0.35, down);
	const double fold = sin(u * t->folds + t->phase + 0.6 * sin(3 * down)) * 0.5 +
			    0.3 * sin(u * t->folds * 1.7 + 2 * t->phase);
	const double a = fmin(fmax(l / round, 0), 1) * PI,
		     bulge = 0.016 + 0.004 * loose + 0.016 * loose * fold;

	return p3((u - 0.5) * t->width * (1 - 0.06 * loose) + 0.006 * loose * fold,
		  -down + 0.014 * sin(a), cos(a) * bulge + (l < 0 ? 0.01 * loose : 0));
}

static struct p3 curtain_at(double u, double v, const void *arg)
{
	const double a = u * 26 + 0.7 * sin(v * 4);

	(void)arg;
	return p3(1.1 * (u - 0.5) + 0.012 * cos(a), 1.9 * v,
		  (0.035 + 0.01 * v) * sin(a) + 0.01 * sin(5 * u + 3 * v));
}

static void bathroom_basin(struct scene *s, int china, int steel)
{
	const struct knot basin[] = {
		{ 0, 0, 1 },         { 0.10, 0, 0 },      { 0.13, 0.01, 0 },   { 0.20, 0.09, 0 },
		{ 0.225, 0.135, 0 }, { 0.220, 0.142, 0 }, { 0.212, 0.137, 0 }, { 0.19, 0.09, 0 },
		{ 0.12, 0.025, 0 },  { 0.03, 0.016, 0 },  { 0, 0.015, 1 },
	};
	const struct p3 spout[] = { { 0, 0, 0 },       { 0, 0.14, 0 },     { 0, 0.235, 0.02 },
				    { 0, 0.26, 0.08 }, { 0, 0.245, 0.14 }, { 0, 0.215, 0.155 } };
	const struct knot foot[] = {
		{ 0.026, 0, 1 }, { 0.026, 0.008, 1 }, { 0.017, 0.02, 0 }, { 0.016, 0.05, 1 }
	};
	const struct knot knob[] = { { 0.016, 0, 1 },     { 0.012, 0.02, 0 }, { 0.012, 0.035, 0 },
				     { 0.024, 0.045, 0 }, { 0.024, 0.06, 0 }, { 0, 0.066, 0 } };
	struct mesh m = { 0 };

	lathe(&m, at(0, 0, 0), basin, COUNT(basin), 4, 48);
	thing(s, &m, china, at(-0.05, 0.80, -0.80));
	lathe(&m, at(0, 0, 0), foot, COUNT(foot), 3, 20);
	tube(&m, at(0, 0, 0), spout, COUNT(spout), 0.012, 0.011, 5, 16);
	lathe(&m, at(-0.11, 0, 0), knob, COUNT(knob), 3, 20);
	lathe(&m, at(0.11, 0, 0), knob, COUNT(knob), 3, 20);
	thing(s, &m, steel, at(-0.05, 0.80, -1.06));
}

static void bathroom_things(struct scene *s, int steel)
{
	const int china = gloss(s, 0.82, 0.82, 0.80, 0.15), pink = gloss(s, 0.75, 0.35, 0.40, 0.35);
	const int yellow = gloss(s, 0.80, 0.62, 0.12, 0.3), blue = gloss(s, 0.10, 0.25, 0.55, 0.3);
	const int clear = glass(s, 1, 1, 1, 0), amber = glass(s, 0.95, 0.65, 0.30, 0.12),
		  leaf = gloss(s, 0.14, 0.34, 0.10, 0.4);
	const int clay = textured(s, "wood.png", 0.8);
	const struct knot pump[] = { { 0, 0, 1 },        { 0.030, 0, 0 },    { 0.034, 0.006, 0 },
				     { 0.034, 0.10, 0 }, { 0.028, 0.12, 0 }, { 0.012, 0.128, 0 },
				     { 0.010, 0.15, 1 }, { 0, 0.15, 1 } };
	const struct p3 nozzle[] = {
		{ 0, 0.14, 0 }, { 0, 0.175, 0 }, { 0.015, 0.18, 0 }, { 0.045, 0.172, 0 }
	};
	const struct p3 brush[] = { { 0, 0.012, 0 },
				    { 0.012, 0.10, 0.01 },
				    { 0.030, 0.19, 0.022 } };
	const struct knot soap[] = { { 0, 0, 1 },
				     { 0.028, 0, 0 },
				     { 0.036, 0.010, 0 },
				     { 0.028, 0.021, 0 },
				     { 0, 0.023, 0 } };
	const struct knot pot[] = { { 0, 0, 1 },        { 0.05, 0, 0 },     { 0.055, 0.005, 0 },
				    { 0.075, 0.12, 1 }, { 0.068, 0.12, 1 }, { 0.062, 0.10, 1 },
				    { 0, 0.10, 1 } };
	struct mesh m = { 0 };

	bathroom_basin(s, china, steel);
	lathe(&m, at(0, 0, 0), pump, COUNT(pump), 3, 24);
	tube(&m, at(0, 0, 0), nozzle, COUNT(nozzle), 0.006, 0.005, 4, 10);
	stand(s, shape(s, &m, yellow), turned(at(0.27, 0.80, -0.98), 'y', -120));
	lathe(&m, at(0, 0, 0), pump, 7, 3, 24);
	thing(s, &m, amber, at(0.36, 0.80, -1.03));
	lathe(&m, at(0, 0, 0), soap, COUNT(soap), 3, 24);
	thing(s, &m, pink, at(0.30, 0.80, -0.78));
	stand(s, tumbler(s, clear, 0.034, 0.10), at(-0.38, 0.80, -0.98));
	for (int i = 0; i < 2; i++) {
		const struct place here = turned(at(-0.38, 0.80, -0.98), 'y', 30 + 150 * i);

		tube(&m, at(0, 0, 0), brush, COUNT(brush), 0.004, 0.004, 4, 8);
		box(&m, turned(at(0.026, 0.185, 0.02), 'z', -20), p3(0.006, 0.016, 0.006), 0.002, 1,
		    1);
		thing(s, &m, i ? blue : pink, here);
	}
	lathe(&m, at(0, 0, 0), pot, COUNT(pot), 2, 28);
	thing(s, &m, clay, at(-0.55, 0.80, -0.92));
	for (int i = 0; i < 14; i++) {
		const double a = 2.4 * i, l = 0.07 + 0.05 * noise_at(i, 0, 8),
			     r = 0.05 + 0.06 * noise_at(i, 1, 8);
		const struct p3 stem[] = { { 0, 0.09, 0 },
					   { 0.4 * r * cos(a), 0.10 + l, 0.4 * r * sin(a) },
					   { r * cos(a), 0.10 + 1.5 * l, r * sin(a) },
					   { 1.7 * r * cos(a), 0.09 + 1.4 * l, 1.7 * r * sin(a) } };

		tube(&m, at(0, 0, 0), stem, COUNT(stem), 0.012, 0.002, 4, 6);
	}
	thing(s, &m, leaf, at(-0.55, 0.80, -0.92));
}

static void bathroom_fittings(struct scene *s, int steel)
{
	const int mirror = metal(s, 0.93, 0.94, 0.93, 0), wood_ = textured(s, "wood.png", 0.45);
	const int cloth = textured(s, "terry.png", 1), sheet_ = textured(s, "check.png", 0.9);
	const int lamp = light(s, 1, 0.86, 0.68, 20), white = gloss(s, 0.8, 0.8, 0.78, 0.3),
		  ceiling = light(s, 1, 0.95, 0.88, 5.5);
	const struct towel first = { 0.34, 0.62, 0.50, 17, 0.4 },
			   second = { 0.30, 0.44, 0.52, 14, 2.0 };
	const struct p3 rail[] = { { -0.46, 0, -0.06 }, { -0.46, 0, -0.02 }, { -0.43, 0, 0.012 },
				   { 0, 0, 0.012 },     { 0.43, 0, 0.012 },  { 0.46, 0, -0.02 },
				   { 0.46, 0, -0.06 } };
	const struct p3 bulb[] = { { -0.32, 0, 0 }, { 0, 0, 0 }, { 0.32, 0, 0 } };
	struct mesh m = { 0 };

	block(s, wood_, p3(-0.66, 0.76, -1.1), p3(0.50, 0.80, -0.52), 0.006); /* washstand */
	block(s, wood_, p3(-0.62, 0.30, -1.1), p3(-0.58, 0.76, -0.56), 0.004);
	block(s, wood_, p3(0.42, 0.30, -1.1), p3(0.46, 0.76, -0.56), 0.004);
	block(s, white, p3(-0.58, 0.42, -1.09), p3(-0.085, 0.74, -0.57), 0.006);
	block(s, white, p3(-0.075, 0.42, -1.09), p3(0.42, 0.74, -0.57), 0.006);
	wall(s, mirror, p3(-0.50, 1.18, -1.075), p3(0.90, 0, 0), p3(0, 0.72, 0), 1);
	block(s, steel, p3(-0.515, 1.165, -1.099), p3(0.415, 1.18, -1.065), 0.003);
	block(s, steel, p3(-0.515, 1.90, -1.099), p3(0.415, 1.915, -1.065), 0.003);
	block(s, steel, p3(-0.515, 1.18, -1.099), p3(-0.50, 1.90, -1.065), 0.003);
	block(s, steel, p3(0.40, 1.18, -1.099), p3(0.415, 1.90, -1.065), 0.003);
	tube(&m, at(0, 0, 0), bulb, COUNT(bulb), 0.042, 0.042, 1, 12);
	thing(s, &m, lamp, at(-0.05, 2.06, -0.97));
	wall(s, ceiling, p3(-0.6, 2.395, -0.1), p3(1.2, 0, 0), p3(0, 0, 0.9), 1);
	block(s, steel, p3(-0.38, 2.0, -1.1), p3(0.28, 2.02, -1.03), 0.004);
	tube(&m, at(0, 0, 0), rail, COUNT(rail), 0.009, 0.009, 4, 12);
	thing(s, &m, steel, turned(at(1.10, 1.32, -0.42), 'y', -90)); /* towels on the right wall */
	sheet(&m, at(0, 0, 0), 40, 56, towel_at, &first, 2, 3);
	thing(s, &m, cloth, turned(at(1.088, 1.32, -0.63), 'y', -90));
	sheet(&m, at(0, 0, 0), 36, 48, towel_at, &second, 2, 2.5);
	thing(s, &m, sheet_, turned(at(1.088, 1.32, -0.20), 'y', -90));
	sheet(&m, at(0, 0, 0), 72, 24, curtain_at, NULL, 6, 9);
	thing(s, &m, sheet_, turned(at(-0.45, 0.15, 0.95), 'y', 180)); /* shows in the mirror */
	block(s, wood_, p3(0.35, 0, 1.36), p3(1.05, 2.0, 1.4), 0.005);
	block(s, white, p3(-1.2, 0, 1.02), p3(0.1, 0.55, 1.4), 0.04);
}

static void bathroom(const char *folder)
{
	struct scene s;
	int tile, floor_, paint_, band, steel;

	scene_open(&s, folder, "bathroom");
	tile = textured(&s, "tiles.png", 0.25);
	floor_ = textured(&s, "mosaic.png", 0.4);
	paint_ = matte(&s, 0.70, 0.74, 0.70);
	band = textured(&s, "mosaic.png", 0.25);
	steel = metal(&s, 0.68, 0.67, 0.66, 0.2);
	room(&s, p3(-1.2, 0, -1.1), p3(1.2, 1.55, 1.4),
	     (const int[]){ floor_, -1, tile, tile, tile, tile }, 2.5);
	room(&s, p3(-1.2, 1.55, -1.1), p3(1.2, 2.4, 1.4),
	     (const int[]){ -1, paint_, paint_, paint_, paint_, paint_ }, 1);
	wall(&s, band, p3(-1.19, 1.50, -1.092), p3(2.38, 0, 0), p3(0, 0.10, 0), 5);
	wall(&s, band, p3(1.192, 1.50, -1.09), p3(0, 0, 2.48), p3(0, 0.10, 0), 5);
	wall(&s, band, p3(-1.192, 1.50, 1.39), p3(0, 0, -2.48), p3(0, 0.10, 0), 5);
	bathroom_fittings(&s, steel);
	bathroom_things(&s, steel);
	s.camera = (struct camera){ { -0.42, 1.46, 0.88 }, { 0.14, 1.16, -1.0 }, 52 };
	scene_write(&s, "bathroom", "--depth 8");
	scene_close(&s);
}

#endif
