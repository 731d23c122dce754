/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * sequence: a desk in 8 frames. The camera pans and moves, a hanging lamp swings and takes its
 * shadows with it, a toy car drives; the files share their meshes.
 */
#ifndef SCENE_SEQUENCE_H
#define SCENE_SEQUENCE_H

#include "scene_room.h"

#define SEQUENCE_FRAMES 8

static void globe_map(double u, double v, double c[3])
{
	const double land = smooth(0.50, 0.53, clouds(u, v, 4, 5, 71)),
		     ice = smooth(0.12, 0.08, fmin(v, 1 - v));
	const double net =
		fmin(fabs(u * 12 - nearbyint(u * 12)), fabs(v * 8 - nearbyint(v * 8))) < 0.03 ? 0.75
											      : 1;
	const double high = clouds(u, v, 12, 3, 72);

	c[0] = net * mix(mix(0.20, mix(0.45, 0.75, high), land), 0.92, ice);
	c[1] = net * mix(mix(0.42, mix(0.58, 0.62, high), land), 0.94, ice);
	c[2] = net * mix(mix(0.66, mix(0.30, 0.36, high), land), 0.95, ice);
}

/* Indices of the nodes that move. */
struct sequence {
	int lamp, disc, car, wheels;
};

static void sequence_books(struct scene *s, struct p3 from, int n, unsigned seed)
{
	double x = from.x;

	for (int i = 0; i < n; i++) {
		const double w = 0.018 + 0.028 * noise_at(i, 0, seed),
			     h = 0.17 + 0.08 * noise_at(i, 1, seed);
		const double a = noise_at(i, 2, seed), b = noise_at(i, 3, seed),
			     l = 0.15 + 0.4 * noise_at(i, 4, seed);
		const int cover = gloss(s, l * (0.4 + a), l * (0.35 + 0.5 * b), l * (1.2 - a),
					0.35 + 0.2 * b);
		struct mesh m = { 0 };

		box(&m, at(0, 0, 0), p3(w / 2, h / 2, 0.075), 0.003, 1, 1);
		thing(s, &m, cover, at(x + w / 2, from.y + h / 2, from.z + 0.01 * b));
		x += w + 0.0015;
	}
}

static void sequence_desk(struct scene *s, struct sequence *q)
{
	const int wood_ = textured(s, "wood.png", 0.3), brass = metal(s, 0.85, 0.65, 0.32, 0.25),
		  map = textured(s, "globe.png", 0.3);
	const int china = gloss(s, 0.80, 0.79, 0.76, 0.2), red = gloss(s, 0.70, 0.07, 0.05, 0.2),
		  rubber = gloss(s, 0.03, 0.03, 0.03, 0.5);
	const int steel = metal(s, 0.68, 0.67, 0.66, 0.3), page = textured(s, "check.png", 0.9),
		  clear = glass(s, 1, 1, 1, 0);
	const struct knot foot[] = { { 0, 0, 1 },       { 0.07, 0, 1 },     { 0.07, 0.008, 0 },
				     { 0.03, 0.02, 0 }, { 0.010, 0.05, 0 }, { 0.010, 0.08, 1 } };
	struct p3 arc[9];
	struct mesh m = { 0 };

	block(s, wood_, p3(-0.9, 0.70, -0.95), p3(0.9, 0.74, -0.15), 0.006);
	block(s, wood_, p3(-0.9, 0, -0.95), p3(-0.5, 0.70, -0.2), 0.004);
	block(s, wood_, p3(0.5, 0, -0.95), p3(0.9, 0.70, -0.2), 0.004);
	block(s, wood_, p3(-0.7, 1.22, -0.99), p3(0.7, 1.245, -0.80), 0.004);
	sequence_books(s, p3(-0.62, 1.245, -0.89), 17, 5);
	sequence_books(s, p3(0.36, 0.74, -0.82), 9, 9);
	stand(s, cup(s, china, 1), turned(at(0.14, 1.245, -0.88), 'y', -50));
	stand(s, bowl(s, brass, 0.09, 0.06), at(0.40, 1.245, -0.89));
	lathe(&m, at(0, 0, 0), foot, COUNT(foot), 3, 32);
	for (int i = 0; i < 9; i++) {
		const double a = PI * (-0.5 + i / 8.0) - 0.4;

		arc[i] = p3(0.128 * cos(a), 0.20 + 0.128 * sin(a), 0);
	}
	tube(&m, at(0, 0, 0), arc, 9, 0.005, 0.005, 3, 10);
	thing(s, &m, brass, at(-0.42, 0.74, -0.66));
	ball(&m, at(0, 0, 0), 0.115, 48);
	thing(s, &m, map, turned(turned(at(-0.42, 0.94, -0.66), 'z', -23), 'y', 60));
	stand(s, cup(s, red, 1), turned(at(0.20, 0.74, -0.62), 'y', -30));
	stand(s, tumbler(s, clear, 0.036, 0.11), at(0.02, 0.74, -0.72));
	box(&m, at(0, 0, 0), p3(0.15, 0.002, 0.105), 0.001, 1, 3);
	thing(s, &m, page, turned(at(-0.12, 0.742, -0.36), 'y', 12));
	ball(&m, at(0, 0, 0), 0.03, 32);
	thing(s, &m, steel, at(-0.18, 0.77, -0.58));
	q->car = s->nnode;
	box(&m, at(0, 0.030, 0), p3(0.070, 0.016, 0.030), 0.008, 2, 1);
	box(&m, at(-0.008, 0.055, 0), p3(0.036, 0.016, 0.026), 0.010, 2, 1);
	thing(s, &m, red, at(0, 0, 0));
	q->wheels = s->nnode;
	for (int i = 0; i < 4; i++) {
		const struct knot wheel[] = { { 0, -0.006, 1 },
					      { 0.014, -0.006, 0 },
					      { 0.017, 0, 0 },
					      { 0.014, 0.006, 0 },
					      { 0, 0.006, 1 } };

		lathe(&m,
		      turned(at(i & 1 ? 0.042 : -0.042, 0.017, i & 2 ? 0.031 : -0.031), 'x', 90),
		      wheel, COUNT(wheel), 3, 20);
	}
	thing(s, &m, rubber, at(0, 0, 0));
}

static void sequence_lamp(struct scene *s, struct sequence *q)
{
	const int enamel = gloss(s, 0.10, 0.30, 0.22, 0.25), glow = light(s, 1, 0.82, 0.58, 130);
	const struct knot shade[] = { { 0.02, 0.13, 1 },   { 0.05, 0.12, 0 },  { 0.12, 0.06, 0 },
				      { 0.15, 0, 1 },      { 0.147, 0, 1 },    { 0.116, 0.055, 0 },
				      { 0.047, 0.114, 0 }, { 0.018, 0.125, 1 } };
	const struct knot disc[] = { { 0, 0.03, 1 }, { 0.075, 0.03, 1 } };
	const struct p3 cord[] = { { 0, 0.12, 0 }, { 0, 0.5, 0 }, { 0, 0.9, 0 } };
	struct mesh m = { 0 };

	q->lamp = s->nnode;
	lathe(&m, at(0, 0, 0), shade, COUNT(shade), 3, 36);
	tube(&m, at(0, 0, 0), cord, COUNT(cord), 0.004, 0.004, 1, 6);
	thing(s, &m, enamel, at(0, 0, 0));
	q->disc = s->nnode;
	lathe(&m, at(0, 0, 0), disc, COUNT(disc), 1, 16);
	thing(s, &m, glow, at(0, 0, 0));
}

static void sequence(const char *folder)
{
	struct sequence q;
	struct scene s;
	int plaster, paper, floor_, window, white;

	scene_open(&s, folder, "sequence");
	plaster = matte(&s, 0.78, 0.75, 0.70);
	paper = textured(&s, "wallpaper.png", 0.9);
	floor_ = textured(&s, "boards.png", 0.4);
	window = light(&s, 0.70, 0.85, 1, 14);
	white = gloss(&s, 0.80, 0.78, 0.74, 0.4);
	room(&s, p3(-1.6, 0, -1.0), p3(1.6, 2.4, 1.6),
	     (const int[]){ floor_, plaster, plaster, plaster, paper, plaster }, 1.5);
	wall(&s, window, p3(1.595, 1.0, -0.5), p3(0, 0, 1.0), p3(0, 1.0, 0), 1);
	block(&s, white, p3(1.57, 0.93, -0.57), p3(1.6, 1.0, 0.57), 0.004);
	block(&s, white, p3(1.57, 2.0, -0.57), p3(1.6, 2.07, 0.57), 0.004);
	block(&s, white, p3(1.575, 1.0, -0.02), p3(1.6, 2.0, 0.02), 0.004);
	sequence_desk(&s, &q);
	sequence_lamp(&s, &q);
	for (int f = 0; f < SEQUENCE_FRAMES; f++) {
		const double t = f / (SEQUENCE_FRAMES - 1.0), swing = 24 * (t - 0.4);
		const struct place hook = turned(at(0.05, 2.29, -0.42), 'z', swing);
		const struct place lamp = turned(
			(struct place){ placed(hook, p3(0, -0.9, 0)), { 0, 0, 0, 1 } }, 'z', swing);
		const struct place car =
			turned(at(0.36 - 0.16 * t, 0.74, -0.34 + 0.05 * t), 'y', 160 + 8 * t);
		char name[32];

		s.node[q.lamp].place = s.node[q.disc].place = lamp;
		s.node[q.car].place = s.node[q.wheels].place = car;
		s.camera = (struct camera){ { 0.06 + 0.20 * t, 1.27, 0.86 },
					    { -0.12 + 0.14 * t, 1.01, -0.60 },
					    42 };
		snprintf(name, sizeof name, "sequence%d", f);
		scene_write(&s, name, "--depth 8");
	}
	scene_close(&s);
}

#endif
