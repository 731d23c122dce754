/* SPDX-License-Identifier: BSD-3-Clause */
#include "camera.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "jacobi.h"

#define SAMPLES	48	/* per axis */
#define ROUNDS	15	/* of weighing by how far off points are */
#define SWEEPS	12	/* of rotations: quadratic convergence takes fewer than 10 */
#define N	12	/* unknowns */
#define THIN	1e-3	/* of the widest extent: points lie in a plane or on a line */

/*
 * Points and pixels about 0 and of size 1, in which sums do not cancel: point = turn (p - at) along
 * the axes of their spread; thin ones, along which they hardly differ, are 0.
 */
struct frame {
	double at[3], turn[3][3];
	bool thin[3];
	double cx, cy, half;	/* of the pixels */
};

struct point {
	double p[4], x, y, weight;
};

static bool usable(const double p[3])
{
	return isfinite(p[0]) && isfinite(p[1]) && isfinite(p[2]) &&
	       (p[0] != 0 || p[1] != 0 || p[2] != 0);
}

/* Pixels spread evenly that show a surface. Returns how many. */
static int collect(struct point *point, const struct gd_plane position[3])
{
	int w = position[0].w, h = position[0].h;
	int nx = w < SAMPLES ? w : SAMPLES, ny = h < SAMPLES ? h : SAMPLES, n = 0;

	for (int j = 0; j < ny; j++)
		for (int i = 0; i < nx; i++) {
			int x = (int)((2 * (long)i + 1) * w / (2 * nx));
			int y = (int)((2 * (long)j + 1) * h / (2 * ny));
			struct point *to = point + n;

			for (int c = 0; c < 3; c++)
				to->p[c] = (double)gd_row(position[c], y)[x];
			to->p[3] = to->weight = 1;
			to->x = x;
			to->y = y;
			n += usable(to->p);
		}
	return n;
}

static int compare(const void *a, const void *b)
{
	double x = *(const double *)a, y = *(const double *)b;

	return (x > y) - (x < y);
}

static double median(double *v, int n)
{
	qsort(v, (size_t)n, sizeof *v, compare);
	return v[n / 2];
}

/* Eigenvectors of a, as columns of v, and eigenvalues, left on a's diagonal: Jacobi's rotations. */
static void eigen(double a[][N], double v[][N], int n)
{
	double size = 0;

	for (int i = 0; i < n; i++) {
		for (int j = 0; j < n; j++)
			v[i][j] = i == j;
		size += a[i][i];
	}
	for (int sweep = 0; sweep < SWEEPS; sweep++)
		for (int p = 0; p < n; p++)
			for (int q = p + 1; q < n; q++)
				if (fabs(a[p][q]) > 1e-18 * size)
					gd_jacobi_turn(N, a, v, n, p, q);
}

/* Centre and size of the points, by medians. Returns the size. */
static double middle(double at[3], const struct point *point, int n, double *spare)
{
	double size = 0;

	for (int c = 0; c < 3; c++) {
		for (int i = 0; i < n; i++)
			spare[i] = point[i].p[c];
		at[c] = median(spare, n);
		for (int i = 0; i < n; i++)
			spare[i] = fabs(point[i].p[c] - at[c]);
		size = fmax(size, median(spare, n));
	}
	return size > 0 ? size : 1;
}

/* The axes along which points spread, each made of size 1; far points count less. */
static void find_axes(struct frame *f, const struct point *point, int n, double size)
{
	double a[3][N] = { { 0 } }, v[3][N], most;

	for (int i = 0; i < n; i++) {
		double d[3], square = 0, weight;

		for (int c = 0; c < 3; c++) {
			d[c] = (point[i].p[c] - f->at[c]) / size;
			square += d[c] * d[c];
		}
		weight = 1 / (n * (1 + square * square / 100));
		for (int r = 0; r < 3; r++)
			for (int c = 0; c < 3; c++)
				a[r][c] += weight * d[r] * d[c];
	}
	eigen(a, v, 3);
	most = sqrt(fmax(a[0][0], fmax(a[1][1], a[2][2])));
	for (int r = 0; r < 3; r++) {
		double extent = sqrt(fmax(a[r][r], 0));

		f->thin[r] = !(extent > THIN * most);
		for (int c = 0; c < 3; c++)
			f->turn[r][c] = f->thin[r] ? 0 : v[c][r] / (size * extent);
	}
}

static void normalise(struct frame *f, struct point *point, int n, int w, int h, double *spare)
{
	double size = middle(f->at, point, n, spare);

	find_axes(f, point, n, size);
	f->cx = 0.5 * (w - 1);
	f->cy = 0.5 * (h - 1);
	f->half = 0.5 * (w > h ? w : h);
	for (int i = 0; i < n; i++) {
		double d[3], far = 0;

		for (int c = 0; c < 3; c++)
			d[c] = point[i].p[c] - f->at[c];
		for (int r = 0; r < 3; r++)
			point[i].p[r] = f->turn[r][0] * d[0] + f->turn[r][1] * d[1] +
					f->turn[r][2] * d[2];
		for (int r = 0; r < 3; r++)
			far += point[i].p[r] * point[i].p[r];
		point[i].weight = 1 / (1 + far * far / 100);	/* levers, until more is known */
		point[i].x = (point[i].x - f->cx) / f->half;
		point[i].y = (point[i].y - f->cy) / f->half;
	}
}

/* Sums of squares of the equations m0 p - x m2 p = 0, m1 p - y m2 p = 0. */
static void normal_matrix(double a[N][N], const struct point *point, int n)
{
	memset(a, 0, sizeof(double[N][N]));
	for (int k = 0; k < n; k++) {
		double row[2][N] = { { 0 } };

		for (int c = 0; c < 4; c++) {
			row[0][c] = row[1][4 + c] = point[k].p[c];
			row[0][8 + c] = -point[k].x * point[k].p[c];
			row[1][8 + c] = -point[k].y * point[k].p[c];
		}
		for (int e = 0; e < 2; e++)
			for (int i = 0; i < N; i++)
				for (int j = 0; j <= i; j++)
					a[i][j] += point[k].weight * row[e][i] * row[e][j];
	}
	for (int i = 0; i < N; i++)
		for (int j = i + 1; j < N; j++)
			a[i][j] = a[j][i];
}

/* m is what the equations leave smallest; what a thin axis counts is not told by them: nothing. */
static void solve(double m[3][4], double a[N][N], const bool thin[3])
{
	double v[N][N], size = 0;
	int best = 0;

	for (int i = 0; i < N; i++)
		size += a[i][i];
	for (int i = 0; i < N; i++)
		if (i % 4 < 3 && thin[i % 4])
			a[i][i] = size;
	eigen(a, v, N);
	for (int i = 1; i < N; i++)
		if (a[i][i] < a[best][best])
			best = i;
	for (int i = 0; i < N; i++)
		m[i / 4][i % 4] = v[i][best];
}

static double dot(const double m[4], const double p[4])
{
	return m[0] * p[0] + m[1] * p[1] + m[2] * p[2] + m[3] * p[3];
}

/*
 * Weighs points by 1 / depth^2, which makes the equations' errors distances in the image, and by
 * how far off they are now. Returns the median distance. m is turned so that most depths are > 0.
 */
static double weigh(struct point *point, int n, double m[3][4], double *spare)
{
	double typical;
	int before = 0;

	for (int i = 0; i < n; i++) {
		double d = dot(m[2], point[i].p);

		before += d > 0 ? 1 : -1;
		spare[i] = point[i].weight = hypot(dot(m[0], point[i].p) / d - point[i].x,
						   dot(m[1], point[i].p) / d - point[i].y);
		if (!isfinite(spare[i]))
			spare[i] = point[i].weight = 1e9;
	}
	for (int i = 0; i < 12 && before < 0; i++)
		m[i / 4][i % 4] = -m[i / 4][i % 4];
	typical = median(spare, n);
	for (int i = 0; i < n; i++) {
		double d = dot(m[2], point[i].p), off = point[i].weight / (3 * typical + 1e-6);

		point[i].weight = 1 / ((d * d + 1e-6) * (1 + off * off * off * off));
	}
	return typical;
}

/* M of the given points and pixels from that of normalised ones. */
static void restore(struct gd_camera *camera, double m[3][4], const struct frame *f)
{
	for (int r = 0; r < 3; r++) {
		double shift = r == 0 ? f->cx : f->cy, row[4];

		for (int c = 0; c < 4; c++)
			row[c] = r < 2 ? m[r][c] * f->half + m[2][c] * shift : m[2][c];
		camera->m[r][3] = row[3];
		for (int c = 0; c < 3; c++) {
			double k = row[0] * f->turn[0][c] + row[1] * f->turn[1][c] +
				   row[2] * f->turn[2][c];

			camera->m[r][c] = k;
			camera->m[r][3] -= k * f->at[c];
		}
	}
}

bool gd_camera_fit(struct gd_camera *camera, const struct gd_plane position[3])
{
	struct point *point = gd_alloc((size_t)SAMPLES * SAMPLES, sizeof *point);
	double *spare = gd_alloc((size_t)SAMPLES * SAMPLES, sizeof *spare);
	double a[N][N], m[3][4];
	struct frame f;
	int n = point && spare ? collect(point, position) : 0;

	if (n >= N) {
		normalise(&f, point, n, position[0].w, position[0].h, spare);
		for (int i = 0; i < ROUNDS; i++) {
			normal_matrix(a, point, n);
			solve(m, a, f.thin);
			camera->rms = weigh(point, n, m, spare) * f.half;
		}
		restore(camera, m, &f);
	}
	free(point);
	free(spare);
	return n >= N;
}

bool gd_camera_project(const struct gd_camera *camera, const double p[3], double *x, double *y)
{
	const double q[4] = { p[0], p[1], p[2], 1 };
	double d = dot(camera->m[2], q);

	*x = dot(camera->m[0], q) / d;
	*y = dot(camera->m[1], q) / d;
	return d > 0 && isfinite(*x) && isfinite(*y);
}
