/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Meshes for the test scenes: boxes with round edges, surfaces of revolution, tubes, sheets of
 * cloth. Metres, y is up, counter-clockwise from outside, normals of length 1. All numbers are
 * doubles here; scene_file.h rounds them to a grid, so that other mathematical libraries, which
 * differ in the last bit, give the same files.
 */
#ifndef SCENE_SHAPES_H
#define SCENE_SHAPES_H

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define PI 3.14159265358979323846
#define COUNT(a) ((int)(sizeof(a) / sizeof *(a)))

struct p3 {
	double x, y, z;
};

/* Where something stands: rotated by the quaternion q (x y z w), then moved by t. */
struct place {
	struct p3 t;
	double q[4];
};

struct corner {
	struct p3 p, n;
	double u, v;
};

struct mesh {
	struct corner *corner;
	unsigned *index;
	int ncorner, nindex, room_corner, room_index;
};

/* A point of a profile: radius and height. */
struct knot {
	double r, y;
	int sharp; /* an edge; else the profile is smooth there */
};

static void *need(void *p)
{
	if (!p) {
		fprintf(stderr, "mkscenes: no memory\n");
		exit(2);
	}
	return p;
}

static struct p3 p3(double x, double y, double z)
{
	return (struct p3){ x, y, z };
}

static struct p3 mad(struct p3 a, double s, struct p3 b)
{
	return p3(a.x + s * b.x, a.y + s * b.y, a.z + s * b.z);
}

static struct p3 sub(struct p3 a, struct p3 b)
{
	return mad(a, -1, b);
}

static double dot(struct p3 a, struct p3 b)
{
	return a.x * b.x + a.y * b.y + a.z * b.z;
}

static struct p3 cross(struct p3 a, struct p3 b)
{
	return p3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}

static struct p3 unit(struct p3 a)
{
	const double l = sqrt(dot(a, a));

	return l > 0 ? p3(a.x / l, a.y / l, a.z / l) : p3(0, 1, 0);
}

static struct p3 turn(const double q[4], struct p3 v)
{
	const struct p3 a = p3(q[0], q[1], q[2]), b = cross(a, v);

	return mad(mad(v, 2 * q[3], b), 2, cross(a, b));
}

static struct place at(double x, double y, double z)
{
	return (struct place){ { x, y, z }, { 0, 0, 0, 1 } };
}

/* The same place, what stands there turned first by degrees about axis 'x', 'y' or 'z'. */
static struct place turned(struct place p, char axis, double degrees)
{
	const double a = degrees * PI / 360, s = sin(a), w = cos(a);
	const double x = axis == 'x' ? s : 0, y = axis == 'y' ? s : 0, z = axis == 'z' ? s : 0;
	const double *q = p.q;
	const double r[4] = { q[3] * x + q[0] * w + q[1] * z - q[2] * y,
			      q[3] * y - q[0] * z + q[1] * w + q[2] * x,
			      q[3] * z + q[0] * y - q[1] * x + q[2] * w,
			      q[3] * w - q[0] * x - q[1] * y - q[2] * z };

	memcpy(p.q, r, sizeof r);
	return p;
}

static struct p3 placed(struct place p, struct p3 v)
{
	return mad(turn(p.q, v), 1, p.t);
}

static unsigned corner(struct mesh *m, struct place where, struct p3 p, struct p3 n, double u,
		       double v)
{
	if (m->ncorner == m->room_corner) {
		m->room_corner = m->room_corner * 2 + 64;
		m->corner = need(realloc(m->corner, sizeof *m->corner * (size_t)m->room_corner));
	}
	m->corner[m->ncorner] = (struct corner){ placed(where, p), turn(where.q, unit(n)), u, v };
	return (unsigned)m->ncorner++;
}

/* Leaves triangles without area out. */
static void triangle(struct mesh *m, unsigned a, unsigned b, unsigned c)
{
	const struct p3 p = m->corner[a].p, e = sub(m->corner[b].p, p), f = sub(m->corner[c].p, p);
	const struct p3 n = cross(e, f);

	if (dot(n, n) < 1e-20)
		return;
	if (m->nindex + 3 > m->room_index) {
		m->room_index = m->room_index * 2 + 192;
		m->index = need(realloc(m->index, sizeof *m->index * (size_t)m->room_index));
	}
	m->index[m->nindex++] = a;
	m->index[m->nindex++] = b;
	m->index[m->nindex++] = c;
}

/* Corners first .. of nv + 1 rows of nu + 1; u x v points to the front. */
static void weave(struct mesh *m, unsigned first, int nu, int nv)
{
	const unsigned row = (unsigned)nu + 1;

	for (unsigned v = 0; v < (unsigned)nv; v++)
		for (unsigned u = 0; u < (unsigned)nu; u++) {
			const unsigned a = first + v * row + u;

			triangle(m, a, a + 1, a + row + 1);
			triangle(m, a, a + row + 1, a + row);
		}
}

/* p + u a + v b for u, v in 0 .. 1; a x b points to the front. Texture coordinates: metres times
 * scale. */
static void quad(struct mesh *m, struct p3 p, struct p3 a, struct p3 b, double scale)
{
	const double u = sqrt(dot(a, a)) * scale, v = sqrt(dot(b, b)) * scale;
	const struct place here = at(0, 0, 0);
	const unsigned first = (unsigned)m->ncorner;

	for (int k = 0; k < 4; k++)
		corner(m, here, mad(mad(p, k & 1, a), k >> 1, b), cross(a, b), (k & 1) * u,
		       (1 - (k >> 1)) * v);
	weave(m, first, 1, 1);
}

/*
 * A surface over (u, v) in 0 .. 1. Normals by differences, a little off
 * v = 0 and 1, where poles may be poles; texture coordinates su u, sv v.
 */
typedef struct p3 surface(double u, double v, const void *arg);

static void sheet(struct mesh *m, struct place where, int nu, int nv, surface *f, const void *arg,
		  double su, double sv)
{
	const double h = 1e-4;
	const unsigned first = (unsigned)m->ncorner;

	for (int j = 0; j <= nv; j++)
		for (int i = 0; i <= nu; i++) {
			const double u = (double)i / nu, v = (double)j / nv;
			const double w = fmin(fmax(v, 10 * h), 1 - 10 * h);
			const struct p3 du = sub(f(u + h, w, arg), f(u - h, w, arg));
			const struct p3 dv = sub(f(u, w + h, arg), f(u, w - h, arg));

			corner(m, where, f(u, v, arg), cross(du, dv), u * su, (1 - v) * sv);
		}
	weave(m, first, nu, nv);
}

/*
 * A box of half sizes h around the origin with edges rounded by radius; steps: quads from an edge
 * to the flat part, 0: sharp edges. Texture coordinates: metres times scale.
 */
static void box(struct mesh *m, struct place where, struct p3 h, double radius, int steps,
		double scale)
{
	const double half[3] = { h.x, h.y, h.z };
	const int n = 2 * steps + 1;

	for (int face = 0; face < 6; face++) {
		const int a = face / 2, b = (a + 1) % 3, c = (a + 2) % 3, side = face & 1 ? -1 : 1;
		const unsigned first = (unsigned)m->ncorner;

		for (int j = 0; j <= n; j++)
			for (int i = 0; i <= n; i++) {
				double p[3], d[3] = { 0 };
				const int k[2] = { side > 0 ? i : n - i, j }, axis[2] = { b, c };

				d[a] = side;
				for (int e = 0; e < 2; e++) {
					const int low = k[e] <= steps,
						  step = low ? steps - k[e] : k[e] - steps - 1;
					const double t = steps ? tan(PI / 4 * step / steps) : 0;

					p[axis[e]] = (low ? -1 : 1) * (half[axis[e]] - radius);
					d[axis[e]] = (low ? -1 : 1) * t;
				}
				p[a] = side * (half[a] - radius);
				const struct p3 dir = unit(p3(d[0], d[1], d[2]));
				const struct p3 q = mad(p3(p[0], p[1], p[2]), radius, dir);
				const double w[3] = { q.x, q.y, q.z };
				const double u = a == 0 ? w[2] : w[0], v = a == 1 ? w[2] : w[1];

				corner(m, where, q, dir, (u + h.x) * scale, (h.y - v) * scale);
			}
		weave(m, first, n, n);
	}
}

/* Direction of a smooth profile at its knot k, from both neighbours. */
static void along(const struct knot *k, int i, int n, double d[2])
{
	struct knot before = i ? k[i - 1] : k[0], after = i < n - 1 ? k[i + 1] : k[n - 1];
	double l;

	if (!i)
		before = (struct knot){ -k[1].r, k[1].y, 0 };
	if (i == n - 1)
		after = (struct knot){ -k[n - 2].r, k[n - 2].y, 0 };
	d[0] = after.r - before.r, d[1] = after.y - before.y;
	l = hypot(d[0], d[1]);
	d[0] /= l, d[1] /= l;
}

/* Point and direction at t in 0 .. 1 between knots i and i + 1. */
static void between(const struct knot *k, int i, int n, double t, double p[2], double d[2])
{
	const double s[2] = { k[i + 1].r - k[i].r, k[i + 1].y - k[i].y }, l = hypot(s[0], s[1]);
	const double from[2] = { k[i].r, k[i].y }, to[2] = { k[i + 1].r, k[i + 1].y };
	double a[2], b[2];

	along(k, i, n, a);
	along(k, i + 1, n, b);
	for (int c = 0; c < 2; c++) {
		const double line = s[c] / l;
		const double ta =
			l * (k[i].sharp ? (k[i + 1].sharp ? line : 2 * line - b[c]) : a[c]);
		const double tb =
			l * (k[i + 1].sharp ? (k[i].sharp ? line : 2 * line - a[c]) : b[c]);
		const double t2 = t * t, t3 = t2 * t;

		p[c] = (2 * t3 - 3 * t2 + 1) * from[c] + (t3 - 2 * t2 + t) * ta +
		       (3 * t2 - 2 * t3) * to[c] + (t3 - t2) * tb;
		d[c] = 6 * (t2 - t) * (from[c] - to[c]) + (3 * t2 - 4 * t + 1) * ta +
		       (3 * t2 - 2 * t) * tb;
	}
	if (p[0] < 0)
		p[0] = 0;
}

/*
 * The profile k turned about y. Its outside is to the right of the way from k[0] on: upwards at
 * r > 0 it points outwards; a solid starts at the axis below and ends at the axis above. steps:
 * pieces of a curved part between two knots; sides: of a full turn.
 */
static void lathe(struct mesh *m, struct place where, const struct knot *k, int n, int steps,
		  int sides)
{
	double length = 0, last[2] = { k[0].r, k[0].y };

	for (int i = 0; i < n - 1; i++) {
		const int pieces = k[i].sharp && k[i + 1].sharp ? 1 : steps;
		const unsigned first = (unsigned)m->ncorner;

		for (int j = 0; j <= pieces; j++) {
			double p[2], d[2];

			between(k, i, n, (double)j / pieces, p, d);
			length += hypot(p[0] - last[0], p[1] - last[1]);
			memcpy(last, p, sizeof p);
			for (int s = 0; s <= sides; s++) {
				const double a = s == sides ? 0 : 2 * PI * s / sides, x = cos(a),
					     z = -sin(a);

				corner(m, where, p3(p[0] * x, p[1], p[0] * z),
				       p3(d[1] * x, -d[0], d[1] * z), (double)s / sides, -length);
			}
		}
		weave(m, first, sides, pieces);
	}
}

static void ball(struct mesh *m, struct place where, double r, int sides)
{
	const int rows = sides / 2;
	const unsigned first = (unsigned)m->ncorner;

	for (int j = 0; j <= rows; j++)
		for (int i = 0; i <= sides; i++) {
			const double t = PI * j / rows, a = i == sides ? 0 : 2 * PI * i / sides;
			const double ring = j == 0 || j == rows ? 0 : sin(t);
			const struct p3 n = p3(ring * cos(a), -cos(t), -ring * sin(a));

			corner(m, where, mad(p3(0, 0, 0), r, n), n, (double)i / sides,
			       1 - (double)j / rows);
		}
	weave(m, first, sides, rows);
}

/* A point of the smooth curve through p[0 .. n), t in 0 .. n - 1. */
static struct p3 curve(const struct p3 *p, int n, double t)
{
	const int i = t >= n - 1 ? n - 2 : (int)t;
	const double s = t - i, s2 = s * s, s3 = s2 * s;
	const struct p3 b = p[i], c = p[i + 1], way = sub(c, b);
	const double l = sqrt(dot(way, way));
	const struct p3 db = unit(sub(c, p[i > 0 ? i - 1 : 0]));
	const struct p3 dc = unit(sub(p[i + 2 < n ? i + 2 : n - 1], b));
	const struct p3 r = mad(mad(b, 3 * s2 - 2 * s3, way), (s3 - 2 * s2 + s) * l, db);

	return mad(r, (s3 - s2) * l, dc);
}

/* A tube along the curve through p, from radius r0 to r1, round at both ends. */
static void tube(struct mesh *m, struct place where, const struct p3 *p, int n, double r0,
		 double r1, int steps, int sides)
{
	const int rings = (n - 1) * steps, cap = 3;
	const unsigned first = (unsigned)m->ncorner;
	struct p3 x = p3(0, 0, 0), last = x;

	for (int j = -cap; j <= rings + cap; j++) {
		const int k = j < 0 ? 0 : j > rings ? rings : j;
		const double t = (double)k / steps, h = 1e-3;
		const double bend = (j - k) * PI / 2 / cap, r = r0 + (r1 - r0) * k / rings;
		const struct p3 d =
			unit(sub(curve(p, n, fmin(t + h, n - 1)), curve(p, n, fmax(t - h, 0))));
		const struct p3 c = mad(curve(p, n, t), r * sin(bend), d);

		if (j == -cap)
			x = fabs(d.y) < 0.9 ? unit(cross(d, p3(0, 1, 0)))
					    : unit(cross(d, p3(1, 0, 0)));
		else
			x = unit(mad(x, -dot(x, d), d));
		last = cross(d, x);
		for (int i = 0; i <= sides; i++) {
			const double a = i == sides ? 0 : 2 * PI * i / sides;
			const struct p3 out = mad(mad(p3(0, 0, 0), cos(a), x), sin(a), last);
			const double ring = abs(j - k) == cap ? 0 : cos(bend);

			corner(m, where, mad(c, r * ring, out),
			       mad(mad(p3(0, 0, 0), ring, out), sin(bend), d), (double)i / sides,
			       t);
		}
	}
	weave(m, first, sides, rings + 2 * cap);
}

#endif
