/* SPDX-License-Identifier: BSD-3-Clause */
/* What several of the test scenes have: rooms and things that stand in them. */
#ifndef SCENE_ROOM_H
#define SCENE_ROOM_H

#include "scene_texture.h"

enum side { FLOOR, CEILING, LEFT, RIGHT, BACK, FRONT, SIDES }; /* left is -x, back is -z */

static void wall(struct scene *s, int finish, struct p3 p, struct p3 a, struct p3 b, double scale)
{
	struct mesh m = { 0 };

	if (finish < 0)
		return;
	quad(&m, p, a, b, scale);
	thing(s, &m, finish, at(0, 0, 0));
}

/* Walls that face inwards, each of its finish (below 0: none). scale: texture repeats a metre. */
static void room(struct scene *s, struct p3 l, struct p3 h, const int finish[SIDES], double scale)
{
	const struct p3 d = sub(h, l);
	const struct p3 x = p3(d.x, 0, 0), y = p3(0, d.y, 0), z = p3(0, 0, d.z);

	wall(s, finish[FLOOR], p3(l.x, l.y, h.z), x, p3(0, 0, -d.z), scale);
	wall(s, finish[CEILING], p3(l.x, h.y, l.z), x, z, 1);
	wall(s, finish[LEFT], p3(l.x, l.y, h.z), p3(0, 0, -d.z), y, scale);
	wall(s, finish[RIGHT], p3(h.x, l.y, l.z), z, y, scale);
	wall(s, finish[BACK], l, x, y, scale);
	wall(s, finish[FRONT], p3(h.x, l.y, h.z), p3(-d.x, 0, 0), y, scale);
}

static void block(struct scene *s, int finish, struct p3 low, struct p3 high, double radius)
{
	const struct p3 h = mad(p3(0, 0, 0), 0.5, sub(high, low)), c = mad(low, 1, h);
	struct mesh m = { 0 };

	box(&m, at(0, 0, 0), h, radius, radius > 0 ? 2 : 0, 1);
	thing(s, &m, finish, at(c.x, c.y, c.z));
}

/* A tumbler of thickness 3 mm and a thick bottom, standing at y = 0. */
static int tumbler(struct scene *s, int finish, double r, double h)
{
	const double w = 0.003;
	const struct knot k[] = {
		{ 0, 0, 1 },
		{ r * 0.74, 0, 0 },
		{ r * 0.80, 0.005, 0 },
		{ r * 0.9, h * 0.5, 0 },
		{ r, h - 0.002, 0 },
		{ r - w / 2, h, 0 },
		{ r - w, h - 0.002, 0 },
		{ r * 0.9 - w, h * 0.5, 0 },
		{ r * 0.80 - w, 0.020, 0 },
		{ r * 0.7 - w, 0.013, 0 },
		{ 0, 0.012, 1 },
	};
	struct mesh m = { 0 };

	lathe(&m, at(0, 0, 0), k, COUNT(k), 2, 28);
	return shape(s, &m, finish);
}

static int wine_glass(struct scene *s, int finish)
{
	const struct knot k[] = {
		{ 0, 0, 1 },          { 0.034, 0, 0 },      { 0.036, 0.002, 0 },
		{ 0.033, 0.004, 0 },  { 0.008, 0.008, 0 },  { 0.004, 0.02, 0 },
		{ 0.0035, 0.07, 0 },  { 0.008, 0.085, 0 },  { 0.034, 0.115, 0 },
		{ 0.038, 0.145, 0 },  { 0.031, 0.195, 0 },  { 0.0303, 0.1958, 0 },
		{ 0.0296, 0.195, 0 }, { 0.0362, 0.145, 0 }, { 0.032, 0.117, 0 },
		{ 0.012, 0.0925, 0 }, { 0, 0.09, 1 },
	};
	struct mesh m = { 0 };

	lathe(&m, at(0, 0, 0), k, COUNT(k), 2, 28);
	return shape(s, &m, finish);
}

/* A bottle with a wall of glass, open above. */
static int bottle(struct scene *s, int finish, double scale)
{
	struct knot k[] = {
		{ 0, 0.012, 1 },      { 0.020, 0.004, 0 }, { 0.033, 0, 0 },
		{ 0.037, 0.006, 0 },  { 0.037, 0.17, 0 },  { 0.034, 0.195, 0 },
		{ 0.018, 0.225, 0 },  { 0.0135, 0.25, 0 }, { 0.0135, 0.285, 0 },
		{ 0.016, 0.288, 0 },  { 0.016, 0.297, 0 }, { 0.013, 0.3, 0 },
		{ 0.0105, 0.297, 0 }, { 0.0105, 0.25, 0 }, { 0.0150, 0.223, 0 },
		{ 0.0310, 0.194, 0 }, { 0.034, 0.17, 0 },  { 0.034, 0.012, 0 },
		{ 0.03, 0.008, 0 },   { 0, 0.018, 1 },
	};
	struct mesh m = { 0 };

	for (int i = 0; i < COUNT(k); i++)
		k[i].r *= scale, k[i].y *= scale;
	lathe(&m, at(0, 0, 0), k, COUNT(k), 2, 28);
	return shape(s, &m, finish);
}

/* A cup with a handle at +x, of china; about 9 cm across. */
static int cup(struct scene *s, int finish, double scale)
{
	struct knot k[] = {
		{ 0, 0.003, 1 },     { 0.024, 0.003, 0 },   { 0.026, 0, 0 },
		{ 0.028, 0.003, 0 }, { 0.037, 0.025, 0 },   { 0.041, 0.06, 0 },
		{ 0.043, 0.085, 0 }, { 0.0415, 0.0865, 0 }, { 0.04, 0.085, 0 },
		{ 0.038, 0.06, 0 },  { 0.034, 0.026, 0 },   { 0.022, 0.008, 0 },
		{ 0, 0.007, 1 },
	};
	struct p3 handle[] = { { 0.036, 0.07, 0 },
			       { 0.058, 0.074, 0 },
			       { 0.068, 0.05, 0 },
			       { 0.055, 0.026, 0 },
			       { 0.034, 0.022, 0 } };
	struct mesh m = { 0 };

	for (int i = 0; i < COUNT(k); i++)
		k[i].r *= scale, k[i].y *= scale;
	for (int i = 0; i < COUNT(handle); i++)
		handle[i] = mad(p3(0, 0, 0), scale, handle[i]);
	lathe(&m, at(0, 0, 0), k, COUNT(k), 2, 32);
	tube(&m, at(0, 0, 0), handle, COUNT(handle), 0.005 * scale, 0.005 * scale, 4, 10);
	return shape(s, &m, finish);
}

static int bowl(struct scene *s, int finish, double r, double h)
{
	const struct knot k[] = {
		{ 0, 0.004, 1 },
		{ r * 0.35, 0.004, 0 },
		{ r * 0.37, 0, 0 },
		{ r * 0.40, 0.004, 0 },
		{ r * 0.75, h * 0.4, 0 },
		{ r, h - 0.002, 0 },
		{ r - 0.002, h, 0 },
		{ r - 0.004, h - 0.002, 0 },
		{ r * 0.75 - 0.005, h * 0.42, 0 },
		{ r * 0.36, 0.012, 0 },
		{ 0, 0.010, 1 },
	};
	struct mesh m = { 0 };

	lathe(&m, at(0, 0, 0), k, COUNT(k), 2, 36);
	return shape(s, &m, finish);
}

/* An apple or an orange: a ball with a dent above. */
static int fruit(struct scene *s, int finish, double r, double dent)
{
	const struct knot k[] = {
		{ 0, 0.06 * r, 0 },          { 0.45 * r, 0.02 * r, 0 }, { 0.9 * r, 0.6 * r, 0 },
		{ r, 1.1 * r, 0 },           { 0.78 * r, 1.65 * r, 0 }, { 0.35 * r, 1.85 * r, 0 },
		{ 0, (1.84 - dent) * r, 0 },
	};
	struct mesh m = { 0 };

	lathe(&m, at(0, 0, 0), k, COUNT(k), 3, 24);
	return shape(s, &m, finish);
}

/* A disc that faces down and glows. */
static void glowing_disc(struct scene *s, int finish, struct p3 centre, double r)
{
	const struct knot k[] = { { 0, 0, 1 }, { r, 0, 1 } };
	struct mesh m = { 0 };

	lathe(&m, at(0, 0, 0), k, COUNT(k), 1, 16);
	thing(s, &m, finish, at(centre.x, centre.y, centre.z));
}

#endif
