/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * kitchen: a worktop before a tiled wall. Steel, copper, glazed tiles, lacquer and polished stone,
 * alpha 0.02 to 0.2, show blurred reflections of each other and of the window: their edges are in
 * no G-buffer. The room is closed; much of the light is indirect.
 */
#ifndef SCENE_KITCHEN_H
#define SCENE_KITCHEN_H

#include "scene_room.h"

struct kitchen_paint {
	int plaster, ceiling, floor, stone, lacquer, cream, tile, blue_tile, steel, satin, copper,
		black, china;
	int wood, check, glass, frost, green, red, orange, apple, window, lamp, white;
};

static void kitchen_paint(struct scene *s, struct kitchen_paint *p)
{
	p->plaster = matte(s, 0.72, 0.68, 0.60);
	p->ceiling = matte(s, 0.82, 0.82, 0.80);
	p->floor = textured(s, "boards.png", 0.35);
	p->stone = textured(s, "granite.png", 0.22);
	p->lacquer = gloss(s, 0.16, 0.30, 0.34, 0.25);
	p->cream = gloss(s, 0.70, 0.64, 0.50, 0.30);
	p->tile = gloss(s, 0.72, 0.74, 0.72, 0.17);
	p->blue_tile = gloss(s, 0.14, 0.28, 0.46, 0.17);
	p->steel = metal(s, 0.66, 0.65, 0.63, 0.28);
	p->satin = metal(s, 0.60, 0.59, 0.57, 0.42);
	p->copper = metal(s, 0.90, 0.56, 0.38, 0.25);
	p->black = gloss(s, 0.02, 0.02, 0.022, 0.16);
	p->china = gloss(s, 0.80, 0.79, 0.76, 0.2);
	p->wood = textured(s, "wood.png", 0.5);
	p->check = textured(s, "check.png", 0.9);
	p->glass = glass(s, 1, 1, 1, 0);
	p->frost = glass(s, 0.95, 0.98, 1, 0.38);
	p->green = glass(s, 0.55, 0.85, 0.60, 0);
	p->red = gloss(s, 0.62, 0.08, 0.06, 0.35);
	p->orange = gloss(s, 0.85, 0.38, 0.06, 0.4);
	p->apple = gloss(s, 0.42, 0.55, 0.10, 0.3);
	p->window = light(s, 0.82, 0.92, 1.0, 14);
	p->lamp = light(s, 1.0, 0.80, 0.56, 12.7);
	p->white = gloss(s, 0.78, 0.78, 0.76, 0.35);
}

/* Tiles of 10 cm on the back wall, each a little out of true. */
static void kitchen_tiles(struct scene *s, const struct kitchen_paint *p)
{
	struct mesh m = { 0 };
	int plain, blue;

	box(&m, at(0, 0, 0), p3(0.0735, 0.0735, 0.006), 0.004, 1, 1);
	plain = shape(s, &m, p->tile);
	box(&m, at(0, 0, 0), p3(0.0735, 0.0735, 0.006), 0.004, 1, 1);
	blue = shape(s, &m, p->blue_tile);
	for (int j = 0; j < 4; j++)
		for (int i = 0; i < 20; i++) {
			const double tilt = noise_at(i, j, 1) - 0.5, yaw = noise_at(i, j, 2) - 0.5;
			const int odd = noise_at(i, j, 3) < 0.16;
			const struct place here = at(-1.425 + 0.15 * i, 0.99 + 0.15 * j, -1.196);

			stand(s, odd ? blue : plain,
			      turned(turned(here, 'x', 1.6 * tilt), 'y', 1.6 * yaw));
		}
}

static int kitchen_handle(struct scene *s, int finish, double length)
{
	const double l = length / 2;
	const struct p3 k[] = { { -l, 0, 0 },           { -l, 0, 0.014 }, { -l + 0.014, 0, 0.03 },
				{ l - 0.014, 0, 0.03 }, { l, 0, 0.014 },  { l, 0, 0 } };
	struct mesh m = { 0 };

	tube(&m, at(0, 0, 0), k, COUNT(k), 0.005, 0.005, 3, 8);
	return shape(s, &m, finish);
}

/* Worktop with a sink, drawers below, cupboards above, a hood between them. */
static void kitchen_units(struct scene *s, const struct kitchen_paint *p)
{
	const int bar = kitchen_handle(s, p->steel, 0.16);
	struct mesh m = { 0 };
	int door, drawer;

	block(s, p->stone, p3(-1.5, 0.86, -1.2), p3(0.45, 0.90, -0.58), 0.004);
	block(s, p->stone, p3(1.0, 0.86, -1.2), p3(1.5, 0.90, -0.58), 0.004);
	block(s, p->stone, p3(0.45, 0.86, -1.2), p3(1.0, 0.90, -1.06), 0.004);
	block(s, p->stone, p3(0.45, 0.86, -0.68), p3(1.0, 0.90, -0.58), 0.004);
	block(s, p->satin, p3(0.44, 0.70, -1.07), p3(1.01, 0.71, -0.67), 0); /* sink */
	block(s, p->satin, p3(0.44, 0.70, -1.07), p3(0.455, 0.903, -0.67), 0.001);
	block(s, p->satin, p3(0.995, 0.70, -1.07), p3(1.01, 0.903, -0.67), 0.001);
	block(s, p->satin, p3(0.44, 0.70, -1.07), p3(1.01, 0.903, -1.055), 0.001);
	block(s, p->satin, p3(0.44, 0.70, -0.685), p3(1.01, 0.903, -0.67), 0.001);
	block(s, p->cream, p3(-1.5, 0.1, -1.2), p3(0.42, 0.86, -0.62), 0);
	block(s, p->cream, p3(1.03, 0.1, -1.2), p3(1.5, 0.86, -0.62), 0);
	box(&m, at(0, 0, 0), p3(0.295, 0.085, 0.01), 0.005, 2, 1);
	drawer = shape(s, &m, p->lacquer);
	box(&m, at(0, 0, 0), p3(0.295, 0.275, 0.01), 0.005, 2, 1);
	door = shape(s, &m, p->lacquer);
	for (int i = 0; i < 5; i++) {
		const double x = -1.2 + 0.6 * i;

		stand(s, drawer, at(x, 0.755, -0.61));
		stand(s, bar, at(x, 0.765, -0.60));
		stand(s, door, at(x, 0.385, -0.61));
		stand(s, bar, at(x, 0.60, -0.60));
	}
	block(s, p->white, p3(-1.5, 1.58, -1.2), p3(-0.75, 2.2, -0.88), 0); /* cupboards above */
	block(s, p->white, p3(0.15, 1.58, -1.2), p3(1.5, 2.2, -0.88), 0);
	box(&m, at(0, 0, 0), p3(0.222, 0.305, 0.01), 0.006, 2, 1);
	door = shape(s, &m, p->cream);
	for (int i = 0; i < 5; i++) {
		const double x = i < 2 ? -1.275 + 0.45 * i : 0.375 + 0.45 * (i - 2);

		stand(s, door, at(i < 2 ? x + 0.03 - 0.02 * i : x, 1.89, -0.87));
		stand(s, bar, at(x, 1.63, -0.86));
	}
	block(s, p->satin, p3(-0.68, 1.62, -1.2), p3(0.08, 1.70, -0.72), 0.006); /* hood */
	block(s, p->satin, p3(-0.46, 1.70, -1.2), p3(-0.14, 2.5, -0.92), 0.004);
	block(s, p->black, p3(-0.58, 0.90, -1.12), p3(-0.02, 0.906, -0.66), 0.002); /* hob */
}

static void kitchen_tap(struct scene *s, const struct kitchen_paint *p)
{
	const struct knot foot[] = { { 0.028, 0, 1 },
				     { 0.028, 0.006, 1 },
				     { 0.016, 0.02, 0 },
				     { 0.014, 0.10, 1 },
				     { 0, 0.10, 1 } };
	const struct p3 neck[] = { { 0, 0.05, 0 },    { 0, 0.24, 0 },    { 0, 0.31, 0.04 },
				   { 0, 0.33, 0.10 }, { 0, 0.31, 0.16 }, { 0, 0.26, 0.18 } };
	const struct p3 lever[] = {
		{ 0.01, 0.07, 0 }, { 0.035, 0.075, 0 }, { 0.06, 0.10, 0.01 }, { 0.075, 0.14, 0.02 }
	};
	struct mesh m = { 0 };

	lathe(&m, at(0, 0, 0), foot, COUNT(foot), 4, 24);
	tube(&m, at(0, 0, 0), neck, COUNT(neck), 0.012, 0.011, 6, 16);
	tube(&m, at(0, 0, 0), lever, COUNT(lever), 0.008, 0.006, 4, 12);
	thing(s, &m, p->steel, turned(at(0.74, 0.90, -1.10), 'y', -12));
}

static void kitchen_kettle(struct scene *s, const struct kitchen_paint *p, struct place where)
{
	const struct knot body[] = {
		{ 0, 0, 1 },         { 0.100, 0, 0 },     { 0.108, 0.006, 0 }, { 0.110, 0.03, 0 },
		{ 0.098, 0.09, 0 },  { 0.070, 0.135, 0 }, { 0.050, 0.148, 1 }, { 0.046, 0.150, 0 },
		{ 0.030, 0.160, 0 }, { 0, 0.164, 0 },
	};
	const struct p3 spout[] = {
		{ 0.075, 0.06, 0 }, { 0.115, 0.085, 0 }, { 0.135, 0.125, 0 }, { 0.165, 0.150, 0 }
	};
	const struct p3 grip[] = { { -0.078, 0.12, 0 }, { -0.088, 0.19, 0 }, { -0.05, 0.235, 0 },
				   { 0.0, 0.245, 0 },   { 0.05, 0.235, 0 },  { 0.085, 0.19, 0 },
				   { 0.077, 0.12, 0 } };
	struct mesh m = { 0 };

	lathe(&m, at(0, 0, 0), body, COUNT(body), 4, 40);
	tube(&m, at(0, 0, 0), spout, COUNT(spout), 0.024, 0.011, 5, 20);
	thing(s, &m, p->steel, where);
	tube(&m, at(0, 0, 0), grip, COUNT(grip), 0.008, 0.008, 5, 14);
	ball(&m, at(0, 0.172, 0), 0.013, 16);
	thing(s, &m, p->black, where);
}

/* With a lid if lid, a long handle if not. */
static void kitchen_pot(struct scene *s, int finish, int black, double r, double h, int lid,
			struct place where)
{
	const struct knot body[] = {
		{ 0, 0, 1 },
		{ r - 0.008, 0, 0 },
		{ r, 0.008, 0 },
		{ r, h - 0.008, 0 },
		{ r + 0.003, h - 0.003, 0 },
		{ r + 0.001, h, 0 },
		{ r - 0.003, h - 0.003, 0 },
		{ r - 0.004, h - 0.01, 0 },
		{ r - 0.004, 0.012, 0 },
		{ r - 0.012, 0.004, 0 },
		{ 0, 0.004, 1 },
	};
	const struct knot top[] = { { r - 0.006, h - 0.002, 1 },
				    { r - 0.001, h + 0.004, 1 },
				    { r * 0.9, h + 0.014, 0 },
				    { r * 0.5, h + 0.028, 0 },
				    { 0, h + 0.034, 0 } };
	const struct p3 loop[] = { { r - 0.002, h * 0.75, -0.04 },
				   { r + 0.030, h * 0.78, -0.035 },
				   { r + 0.035, h * 0.78, 0 },
				   { r + 0.030, h * 0.78, 0.035 },
				   { r - 0.002, h * 0.75, 0.04 } };
	const struct p3 stick[] = { { r - 0.002, h * 0.8, 0 },
				    { r + 0.06, h * 0.86, 0 },
				    { r + 0.20, h * 1.05, 0 } };
	struct mesh m = { 0 };

	lathe(&m, at(0, 0, 0), body, COUNT(body), 2, 40);
	if (lid) {
		lathe(&m, at(0, 0, 0), top, COUNT(top), 3, 40);
		tube(&m, at(0, 0, 0), loop, COUNT(loop), 0.006, 0.006, 4, 10);
		tube(&m, turned(at(0, 0, 0), 'y', 180), loop, COUNT(loop), 0.006, 0.006, 4, 10);
		ball(&m, at(0, h + 0.044, 0), 0.014, 16);
	}
	thing(s, &m, finish, where);
	if (lid)
		return;
	tube(&m, at(0, 0, 0), stick, COUNT(stick), 0.009, 0.012, 5, 12);
	thing(s, &m, black, where);
}

static void kitchen_jar(struct scene *s, const struct kitchen_paint *p, struct place where)
{
	const struct knot jar[] = {
		{ 0, 0, 1 },       { 0.048, 0, 0 },    { 0.052, 0.006, 0 }, { 0.056, 0.07, 0 },
		{ 0.05, 0.14, 0 }, { 0.052, 0.15, 0 }, { 0.049, 0.152, 0 }, { 0.046, 0.14, 0 },
		{ 0.05, 0.07, 0 }, { 0.045, 0.01, 0 }, { 0, 0.008, 1 },
	};
	struct mesh m = { 0 };

	lathe(&m, at(0, 0, 0), jar, COUNT(jar), 3, 32);
	thing(s, &m, p->red, where);
	for (int i = 0; i < 4; i++) {
		const double a = i * 1.7 + 0.4, x = cos(a), z = sin(a);
		const struct p3 rod[] = { { 0.02 * x, 0.02, 0.02 * z },
					  { 0.04 * x, 0.16, 0.04 * z },
					  { 0.062 * x, 0.27, 0.062 * z } };
		const struct place top =
			turned(at(where.t.x + 0.064 * x, where.t.y + 0.285, where.t.z + 0.064 * z),
			       'y', 57 * a);

		tube(&m, at(0, 0, 0), rod, COUNT(rod), 0.004, 0.005, 4, 8);
		thing(s, &m, i & 1 ? p->wood : p->steel, where);
		box(&m, at(0, 0, 0), p3(0.022, 0.034, 0.005), 0.004, 2, 8);
		thing(s, &m, i & 1 ? p->wood : p->steel, top);
	}
}

static struct p3 towel_surface(double u, double v, const void *arg)
{
	const double fold = 0.010 * sin(u * 19 + 0.8 * sin(v * 3)) * (0.3 + 0.7 * v);

	(void)arg;
	return p3(0.28 * (u - 0.5) * (1 - 0.1 * v), -0.42 * v, fold + 0.006 * sin(9 * v));
}

static void kitchen_things(struct scene *s, const struct kitchen_paint *p)
{
	const int small = tumbler(s, p->glass, 0.036, 0.10), white = cup(s, p->china, 1),
		  red = cup(s, p->red, 1);
	const int orange = fruit(s, p->orange, 0.038, 0.03),
		  apple = fruit(s, p->apple, 0.037, 0.22);
	struct mesh m = { 0 };

	kitchen_kettle(s, p, turned(at(-0.42, 0.906, -0.80), 'y', -35));
	kitchen_pot(s, p->steel, p->black, 0.10, 0.13, 1, turned(at(-0.16, 0.906, -0.97), 'y', 20));
	kitchen_pot(s, p->copper, p->black, 0.08, 0.085, 0,
		    turned(at(0.15, 0.90, -0.72), 'y', -68));
	stand(s, small, at(0.30, 0.90, -0.88));
	stand(s, small, at(0.365, 0.90, -0.80));
	stand(s, tumbler(s, p->frost, 0.04, 0.12), at(0.26, 0.90, -1.02));
	stand(s, bottle(s, p->green, 1), at(-0.72, 0.90, -1.08));
	stand(s, bottle(s, p->glass, 0.9), at(-0.80, 0.90, -1.02));
	stand(s, bowl(s, p->china, 0.13, 0.08), at(-0.86, 0.90, -0.78));
	stand(s, orange, at(-0.90, 0.925, -0.79));
	stand(s, orange, turned(at(-0.82, 0.925, -0.75), 'x', 40));
	stand(s, apple, turned(at(-0.84, 0.927, -0.84), 'z', 14));
	stand(s, apple, turned(at(-0.86, 0.985, -0.79), 'x', -25));
	stand(s, wine_glass(s, p->glass), at(0.41, 0.90, -0.96));
	stand(s, white, turned(at(0.12, 0.90, -1.06), 'y', -30));
	stand(s, red, turned(at(0.40, 0.90, -1.11), 'y', -110));
	kitchen_jar(s, p, at(-0.66, 0.90, -0.96));
	box(&m, at(0, 0, 0), p3(0.13, 0.19, 0.011), 0.008, 2, 3);
	thing(s, &m, p->wood, turned(turned(at(0.30, 1.083, -1.145), 'x', -12), 'z', 3));
	sheet(&m, at(0, 0, 0), 36, 28, towel_surface, NULL, 1, 1.5);
	thing(s, &m, p->check, at(-0.0, 0.765, -0.555));
}

/* What stands behind the camera and shows in the reflections; window to the left, lamp. */
static void kitchen_rest(struct scene *s, const struct kitchen_paint *p)
{
	const struct knot shade[] = { { 0.03, 0.16, 1 },   { 0.05, 0.15, 0 },  { 0.12, 0.08, 0 },
				      { 0.17, 0, 1 },      { 0.166, 0, 1 },    { 0.115, 0.075, 0 },
				      { 0.045, 0.145, 0 }, { 0.028, 0.156, 1 } };
	const struct p3 cord[] = { { 0, 0.15, 0 }, { 0, 0.3, 0 }, { 0, 0.45, 0 } };
	struct mesh m = { 0 };

	wall(s, p->window, p3(-1.495, 1.05, 0.75), p3(0, 0, -1.2), p3(0, 1.0, 0), 1);
	block(s, p->white, p3(-1.5, 1.53, -0.45), p3(-1.475, 1.56, 0.75), 0.003);
	block(s, p->white, p3(-1.5, 1.05, 0.135), p3(-1.475, 2.05, 0.165), 0.003);
	block(s, p->white, p3(-1.5, 0.99, -0.52), p3(-1.44, 1.05, 0.82), 0.004);
	block(s, p->white, p3(-1.5, 2.05, -0.52), p3(-1.46, 2.12, 0.82), 0.004);
	block(s, p->white, p3(-1.5, 1.05, -0.52), p3(-1.46, 2.05, -0.45), 0.004);
	block(s, p->white, p3(-1.5, 1.05, 0.75), p3(-1.46, 2.05, 0.82), 0.004);
	lathe(&m, at(0, 0, 0), shade, COUNT(shade), 3, 32);
	thing(s, &m, p->red, at(0.45, 2.0, -0.15));
	tube(&m, at(0, 0, 0), cord, COUNT(cord), 0.004, 0.004, 1, 6);
	thing(s, &m, p->black, at(0.45, 2.05, -0.15));
	glowing_disc(s, p->lamp, p3(0.45, 2.03, -0.15), 0.2);
	block(s, p->wood, p3(-0.9, 0.70, 1.1), p3(0.5, 0.74, 1.9), 0.006); /* table */
	for (int i = 0; i < 4; i++)
		block(s, p->wood, p3(i & 1 ? 0.38 : -0.84, 0, i & 2 ? 1.78 : 1.16),
		      p3(i & 1 ? 0.44 : -0.78, 0.70, i & 2 ? 1.84 : 1.22), 0.004);
	block(s, p->lacquer, p3(0.75, 0, 2.3), p3(1.5, 2.05, 2.4), 0.01);
	block(s, p->red, p3(-1.2, 1.2, 2.37), p3(-0.4, 1.8, 2.39), 0.004);
	block(s, p->cream, p3(0.75, 0, 0.9), p3(1.48, 1.9, 1.5), 0.02);
}

static void kitchen(const char *folder)
{
	struct kitchen_paint p;
	struct scene s;

	scene_open(&s, folder, "kitchen");
	kitchen_paint(&s, &p);
	room(&s, p3(-1.5, 0, -1.2), p3(1.5, 2.5, 2.4),
	     (const int[]){ p.floor, p.ceiling, p.plaster, p.plaster, p.plaster, p.plaster }, 1);
	kitchen_tiles(&s, &p);
	kitchen_units(&s, &p);
	kitchen_tap(&s, &p);
	kitchen_things(&s, &p);
	kitchen_rest(&s, &p);
	s.camera = (struct camera){ { 0.42, 1.40, 0.50 }, { 0.02, 1.04, -0.95 }, 46 };
	scene_write(&s, "kitchen", "--depth 8");
	scene_close(&s);
}

#endif
