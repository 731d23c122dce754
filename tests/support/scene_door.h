/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * door: a room without a lamp, lit by what comes through a door ajar from the bright room behind.
 * Nearly all that is seen is indirect light, which few paths find.
 */
#ifndef SCENE_DOOR_H
#define SCENE_DOOR_H

#include "scene_room.h"

static void wallpaper(double u, double v, double c[3])
{
	const double x = u * 2, y = v * 2 + (((int)floor(x) & 1) ? 0.5 : 0), a = x - floor(x) - 0.5;
	const double b = y - floor(y) - 0.5, r = hypot(a * 1.5, b), t = atan2(b, a * 1.5);
	const double flower = smooth(0.02, -0.02, r - 0.24 - 0.10 * cos(5 * t));
	const double heart = smooth(0.02, -0.02, r - 0.09),
		     line = smooth(0.03, 0.015, fabs(a) < 0.25 ? 1 : 0.5 - fabs(a));

	c[0] = mix(mix(0.84, 0.60, line), mix(0.55, 0.88, heart), flower);
	c[1] = mix(mix(0.80, 0.66, line), mix(0.62, 0.72, heart), flower);
	c[2] = mix(mix(0.66, 0.56, line), mix(0.52, 0.35, heart), flower);
}

static void rug(double u, double v, double c[3])
{
	const double edge = fmin(fmin(u, 1 - u), fmin(v, 1 - v)), a = fabs(u - 0.5),
		     b = fabs(v - 0.5);
	const double ring = sin((a + b) * 50),
		     knot_ = 0.85 + 0.15 * noise_at((int)(u * 128), (int)(v * 128), 4);
	const double border = edge < 0.10 ? 1 : 0, dots = sin(u * 60) * sin(v * 60) > 0.3 ? 1 : 0;

	c[0] = knot_ * mix(mix(0.66, 0.82, ring > 0.2), mix(0.20, 0.80, dots), border);
	c[1] = knot_ * mix(mix(0.18, 0.66, ring > 0.2), mix(0.22, 0.66, dots), border);
	c[2] = knot_ * mix(mix(0.14, 0.42, ring > 0.2), mix(0.40, 0.40, dots), border);
}

/* The wall with the doorway; hinge at x = 0, lock at x = 0.85, the door opens towards -z. */
static void door_wall(struct scene *s, int paper, int white, int brass, double open)
{
	const struct p3 handle[] = { { 0, 0, 0.02 },
				     { 0, 0, 0.055 },
				     { -0.02, 0, 0.065 },
				     { -0.06, 0, 0.065 },
				     { -0.11, 0, 0.06 } };
	const struct place hinge = turned(at(0.0, 0, -1.55), 'y', open);
	struct mesh m = { 0 };

	block(s, paper, p3(-1.8, 0, -1.56), p3(-0.01, 2.5, -1.44), 0);
	block(s, paper, p3(0.86, 0, -1.56), p3(1.4, 2.5, -1.44), 0);
	block(s, paper, p3(-0.01, 2.04, -1.56), p3(0.86, 2.5, -1.44), 0);
	block(s, white, p3(-0.08, 0, -1.58), p3(0.0, 2.10, -1.42), 0.006);
	block(s, white, p3(0.85, 0, -1.58), p3(0.93, 2.10, -1.42), 0.006);
	block(s, white, p3(0.0, 2.03, -1.58), p3(0.85, 2.10, -1.42), 0.006);
	box(&m, at(0.425, 1.015, 0), p3(0.42, 1.005, 0.018), 0.004, 2, 1);
	for (int i = 0; i < 4; i++) /* panels */
		box(&m, at(i & 1 ? 0.62 : 0.23, i & 2 ? 1.48 : 0.56, 0),
		    p3(0.13, i & 2 ? 0.36 : 0.38, 0.026), 0.008, 2, 1);
	thing(s, &m, white, hinge);
	tube(&m, at(0.78, 1.02, 0), handle, COUNT(handle), 0.010, 0.008, 4, 12);
	tube(&m, turned(at(0.78, 1.02, 0), 'z', 0),
	     (const struct p3[]){
		     { 0, 0, -0.02 }, { 0, 0, -0.055 }, { -0.02, 0, -0.065 }, { -0.11, 0, -0.06 } },
	     4, 0.010, 0.008, 4, 12);
	thing(s, &m, brass, hinge);
}

static void door_table(struct scene *s, int china, int brass)
{
	const int wood_ = textured(s, "wood.png", 0.35), blue = gloss(s, 0.12, 0.20, 0.50, 0.22);
	const int orange = gloss(s, 0.85, 0.38, 0.06, 0.4), cloth = textured(s, "check.png", 0.9);
	const struct knot pot[] = { { 0, 0, 1 },         { 0.045, 0, 0 },     { 0.05, 0.006, 0 },
				    { 0.078, 0.05, 0 },  { 0.074, 0.09, 0 },  { 0.045, 0.118, 0 },
				    { 0.042, 0.12, 1 },  { 0.044, 0.124, 0 }, { 0.025, 0.136, 0 },
				    { 0.008, 0.140, 0 }, { 0.012, 0.152, 0 }, { 0, 0.160, 0 } };
	const struct p3 spout[] = {
		{ 0.06, 0.045, 0 }, { 0.10, 0.06, 0 }, { 0.115, 0.095, 0 }, { 0.14, 0.118, 0 }
	};
	const struct p3 grip[] = { { -0.065, 0.095, 0 },
				   { -0.105, 0.10, 0 },
				   { -0.12, 0.07, 0 },
				   { -0.10, 0.04, 0 },
				   { -0.07, 0.036, 0 } };
	const struct knot vase[] = { { 0, 0, 1 },         { 0.05, 0, 0 },      { 0.054, 0.008, 0 },
				     { 0.085, 0.10, 0 },  { 0.07, 0.19, 0 },   { 0.035, 0.25, 0 },
				     { 0.042, 0.285, 0 }, { 0.039, 0.286, 0 }, { 0.030, 0.25, 0 },
				     { 0.06, 0.19, 0 },   { 0.07, 0.10, 0 },   { 0.04, 0.02, 0 },
				     { 0, 0.018, 1 } };
	const int fruit_ = fruit(s, orange, 0.038, 0.03), cup_ = cup(s, china, 1);
	struct mesh m = { 0 };

	block(s, wood_, p3(-1.15, 0.68, -0.75), p3(-0.15, 0.72, -0.10), 0.008);
	for (int i = 0; i < 4; i++)
		block(s, wood_, p3(i & 1 ? -0.25 : -1.11, 0, i & 2 ? -0.20 : -0.71),
		      p3(i & 1 ? -0.19 : -1.05, 0.68, i & 2 ? -0.14 : -0.65), 0.005);
	lathe(&m, at(0, 0, 0), pot, COUNT(pot), 3, 36);
	tube(&m, at(0, 0, 0), spout, COUNT(spout), 0.016, 0.008, 5, 14);
	tube(&m, at(0, 0, 0), grip, COUNT(grip), 0.006, 0.006, 4, 10);
	thing(s, &m, china, turned(at(-0.50, 0.72, -0.42), 'y', -35));
	lathe(&m, at(0, 0, 0), vase, COUNT(vase), 3, 36);
	thing(s, &m, blue, at(-0.92, 0.72, -0.55));
	stand(s, cup_, turned(at(-0.30, 0.72, -0.28), 'y', -60));
	stand(s, cup_, turned(at(-0.68, 0.72, -0.22), 'y', 160));
	stand(s, bowl(s, brass, 0.11, 0.06), at(-0.82, 0.72, -0.30));
	stand(s, fruit_, at(-0.84, 0.735, -0.31));
	stand(s, fruit_, turned(at(-0.775, 0.735, -0.28), 'x', 30));
	box(&m, at(0, 0, 0), p3(0.16, 0.0015, 0.12), 0.001, 1, 4);
	thing(s, &m, cloth, turned(at(-0.45, 0.7225, -0.40), 'y', 20));
}

static void door(const char *folder)
{
	struct mesh m = { 0 };
	struct scene s;
	int plaster, white, paper, floor_, rug_, brass, china, bright, lamp, art, wood_;

	scene_open(&s, folder, "door");
	plaster = matte(&s, 0.84, 0.82, 0.78);
	white = gloss(&s, 0.80, 0.78, 0.74, 0.4);
	paper = textured(&s, "wallpaper.png", 0.9);
	floor_ = textured(&s, "boards.png", 0.4);
	rug_ = textured(&s, "rug.png", 1);
	brass = metal(&s, 0.85, 0.65, 0.32, 0.3);
	china = gloss(&s, 0.82, 0.80, 0.76, 0.15);
	bright = matte(&s, 0.85, 0.84, 0.80);
	lamp = light(&s, 1, 0.93, 0.80, 150);
	art = textured(&s, "mosaic.png", 0.6);
	wood_ = textured(&s, "wood.png", 0.5);
	room(&s, p3(-1.8, 0, -1.44), p3(1.4, 2.5, 1.6),
	     (const int[]){ floor_, plaster, paper, plaster, -1, plaster }, 1.5);
	room(&s, p3(-1.4, 0, -4.0), p3(1.9, 2.5, -1.56),
	     (const int[]){ floor_, bright, bright, bright, bright, -1 }, 1);
	door_wall(&s, paper, white, brass, 30);
	wall(&s, lamp, p3(0.92, 1.0, -3.98), p3(0.95, 0, 0), p3(0, 1.4, 0), 1);
	block(&s, wood_, p3(0, -0.02, -1.58), p3(0.85, 0.012, -1.42), 0.004); /* threshold */
	block(&s, white, p3(-1.8, 0, -1.46), p3(-0.08, 0.12, -1.42), 0.006); /* skirting */
	block(&s, white, p3(0.93, 0, -1.46), p3(1.4, 0.12, -1.42), 0.006);
	wall(&s, rug_, p3(-1.3, 0.006, 0.4), p3(2.0, 0, 0), p3(0, 0, -1.5), 0.5);
	block(&s, wood_, p3(-1.15, 1.20, -1.44), p3(-0.55, 1.80, -1.415), 0.004);
	block(&s, art, p3(-1.10, 1.25, -1.44), p3(-0.60, 1.75, -1.410), 0.002);
	box(&m, at(0, 0, 0), p3(0.20, 0.45, 0.16), 0.01, 2,
	    1); /* a small cupboard beside the door */
	thing(&s, &m, wood_, at(1.18, 0.45, -1.22));
	ball(&m, at(0, 0, 0), 0.11, 40);
	thing(&s, &m, metal(&s, 0.7, 0.7, 0.7, 0.25), at(1.16, 1.01, -1.2));
	door_table(&s, china, brass);
	s.camera = (struct camera){ { 0.92, 1.42, 1.42 }, { -0.16, 0.93, -0.9 }, 48 };
	scene_write(&s, "door", "--depth 12");
	scene_close(&s);
}

#endif
