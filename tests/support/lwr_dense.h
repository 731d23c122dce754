/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * The sparse linear predictions against a slow version that owes them nothing: the design matrix of
 * every window is written out and orthonormalised by Gram-Schmidt, twice, in double; every pixel of
 * a ring is predicted by itself; where a pixel is left out the window is fitted again without it;
 * and every window predicts its pixels one after the other.
 */
#ifndef LWR_DENSE_H
#define LWR_DENSE_H

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "lwr.h"

#define MAXP 16		/* columns */
#define MAXN (31 * 31)	/* pixels of a window */

struct scene {
	int w, h, ny, nc, nfeat;
	bool twin, var, weighted;
	struct gd_plane y[6], twins[3], vars[3], feat[8], feat_var[8], weight;
	double range[8], floor[8];	/* of the features, see spread() */
};

static inline double rnd(unsigned *s)
{
	*s = *s * 1664525u + 1013904223u;
	return (double)(*s >> 8) / (1 << 24);
}

static inline double bell(unsigned *s)
{
	return 2 * (rnd(s) + rnd(s) + rnd(s) - 1.5);	/* variance 1 */
}

static inline struct gd_plane plane(int w, int h)
{
	return gd_plane_of(gd_calloc(gd_stride(w) * (size_t)h, sizeof(float)), w, h);
}

static inline void spread(struct gd_plane f, double *range, double *floor);

static inline struct scene make(int w, int h, int ny, int nfeat, unsigned seed)
{
	struct scene s = { .w = w, .h = h, .ny = ny, .nc = ny < 3 ? 1 : 3, .nfeat = nfeat,
			   .weight = plane(w, h) };

	for (int c = 0; c < ny; c++)
		s.y[c] = plane(w, h);
	for (int c = 0; c < 3; c++) {
		s.twins[c] = plane(w, h);
		s.vars[c] = plane(w, h);
	}
	for (int a = 0; a < nfeat; a++) {
		s.feat[a] = plane(w, h);
		s.feat_var[a] = plane(w, h);
	}
	for (int y = 0; y < h; y++)
		for (int x = 0; x < w; x++) {
			double u = (double)x / w, v = (double)y / h, edge = x + 2 * y > w ? 1 : 0;
			double noise = 0.05 + 0.2 * edge;

			gd_row(s.weight, y)[x] = (float)(0.2 + rnd(&seed));
			for (int a = 0; a < nfeat; a++) {
				const double smooth[3] = { edge, sin(9 * u) + v, u * v };
				double f = (a < 3 ? smooth[a] : 0) + 0.1 * rnd(&seed);

				gd_row(s.feat[a], y)[x] = (float)f;
				gd_row(s.feat_var[a], y)[x] = a == 1 ? 1e-4f : 0;
			}
			for (int c = 0; c < ny; c++) {
				double truth = 1 + c * u + edge + u * u * v +
					       (c == 1 ? sin(20 * v) : 0);

				gd_row(s.y[c], y)[x] = (float)(truth + noise * bell(&seed));
				if (c < 3) {
					gd_row(s.twins[c], y)[x] =
						(float)(truth + noise * bell(&seed));
					gd_row(s.vars[c], y)[x] =
						(float)(noise * noise * (0.5 + rnd(&seed)));
				}
			}
		}
	for (int a = 0; a < nfeat; a++)
		spread(s.feat[a], s.range + a, s.floor + a);
	return s;
}

static inline void drop(struct scene *s)
{
	free(s->weight.v);
	for (int c = 0; c < s->ny; c++)
		free(s->y[c].v);
	for (int c = 0; c < 3; c++) {
		free(s->twins[c].v);
		free(s->vars[c].v);
	}
	for (int a = 0; a < s->nfeat; a++) {
		free(s->feat[a].v);
		free(s->feat_var[a].v);
	}
}

static inline int ascending(const void *a, const void *b)
{
	return (*(const double *)a > *(const double *)b) -
	       (*(const double *)a < *(const double *)b);
}

/* The i-th of 64 places spread over n pixels, the second half a mirror image of the first. */
static inline int place(int i, int n)
{
	return i < 32 ? i * (n - 1) / 63 : n - 1 - (63 - i) * (n - 1) / 63;
}

/* 1 % of the squared level, the mean over the middle half of 64 rows' means of 64 magnitudes. */
static inline double level2(const struct scene *s)
{
	double sum = 0;

	for (int c = 0; c < s->nc; c++) {
		double row[64] = { 0 };

		for (int i = 0; i < 64 * 64; i++)
			row[i / 64] += fabs((double)gd_row(s->y[c], place(i / 64, s->h))
						[place(i % 64, s->w)]) / 64;
		qsort(row, 64, sizeof *row, ascending);
		for (int i = 16; i < 48; i++)
			sum += row[i] / 32 / s->nc;
	}
	return 0.01 * sum * sum;
}

/* Percentiles 0.5 to 99.5 and lower quartile of the
 * distance from the median, of 64 x 64 samples. */
static inline void spread(struct gd_plane f, double *range, double *floor)
{
	double v[64 * 64], d[64 * 64];
	int n = 0;

	for (int i = 0; i < 64 * 64; i++)
		v[i] = (double)gd_row(f, place(i / 64, f.h))[place(i % 64, f.w)];
	qsort(v, 64 * 64, sizeof *v, ascending);
	*range = v[64 * 64 - 1 - 20] - v[20];
	for (int i = 0; i < 64 * 64; i++)
		if (v[i] != v[2048])
			d[n++] = fabs(v[i] - v[2048]);
	qsort(d, (size_t)n, sizeof *d, ascending);
	*floor = n ? 1e-12 * d[n / 4] * d[n / 4] : 0;
}

struct window {
	int n, p;			/* pixels, columns */
	int at[MAXN];			/* y * w + x */
	double z[MAXN][MAXP];		/* times root of the weight */
	double root[MAXN], pull[MAXP];	/* ridge rows: pull_j on column j */
	bool in[MAXP];
	double b[6][MAXP];
};

static inline double value(struct gd_plane p, int w, int at)
{
	return (double)gd_row(p, at / w)[at % w];
}

/* The pixels up to distance r of (x,y), nearest rings first. */
static inline void open_window(struct window *o, const struct scene *s, int x, int y, int r)
{
	o->n = 0;
	o->p = 3 + s->nfeat;
	for (int ring = 0; ring <= r; ring++)
		for (int v = -ring; v <= ring; v++)
			for (int u = -ring; u <= ring; u++) {
				double *z = o->z[o->n];

				if ((abs(u) < ring && abs(v) < ring) || x + u < 0 ||
				    x + u >= s->w || y + v < 0 || y + v >= s->h)
					continue;
				o->at[o->n] = (y + v) * s->w + x + u;
				o->root[o->n] = s->weighted ? sqrt(value(s->weight, s->w,
									 o->at[o->n])) : 1;
				z[0] = 1;
				z[1] = u;
				z[2] = v;
				for (int a = 0; a < s->nfeat; a++)
					z[3 + a] = value(s->feat[a], s->w, o->at[o->n]) -
						   value(s->feat[a], s->w, y * s->w + x);
				for (int j = 0; j < o->p; j++)
					z[j] *= o->root[o->n];
				o->n++;
			}
}

/* Row i of the design matrix with its ridge rows below. */
static inline double entry(const struct window *o, int i, int j)
{
	return i < o->n ? o->z[i][j] : i - o->n == j ? o->pull[j] : 0;
}

/* Least squares by Gram-Schmidt of the columns in use, without pixel `leave` (-1: none). */
static inline void solve(struct window *o, const struct scene *s, int c, int leave, double *b)
{
	static double q[MAXP][MAXN + MAXP];
	double t[MAXN + MAXP], r[MAXP][MAXP] = {{0}}, qty[MAXP];
	int rows = o->n + o->p;

	for (int i = 0; i < rows; i++)
		t[i] = i >= o->n || i == leave ? 0 : o->root[i] * value(s->y[c], s->w, o->at[i]);
	for (int j = 0; j < o->p; j++) {
		double norm = 0;

		if (!o->in[j])
			continue;
		for (int i = 0; i < rows; i++)
			q[j][i] = i == leave ? 0 : entry(o, i, j);
		for (int pass = 0; pass < 2; pass++)
			for (int k = 0; k < j; k++) {
				double dot = 0;

				if (!o->in[k])
					continue;
				for (int i = 0; i < rows; i++)
					dot += q[j][i] * q[k][i];
				r[k][j] += dot;
				for (int i = 0; i < rows; i++)
					q[j][i] -= dot * q[k][i];
			}
		for (int i = 0; i < rows; i++)
			norm += q[j][i] * q[j][i];
		r[j][j] = sqrt(norm);
		qty[j] = 0;
		for (int i = 0; i < rows; i++) {
			q[j][i] /= r[j][j];
			qty[j] += q[j][i] * t[i];
		}
		for (int i = 0; i < rows; i++)
			t[i] -= qty[j] * q[j][i];
	}
	for (int j = o->p - 1; j >= 0; j--) {
		b[j] = 0;
		if (!o->in[j])
			continue;
		for (int k = j + 1; k < o->p; k++)
			if (o->in[k])
				qty[j] -= r[j][k] * b[k];
		b[j] = qty[j] / r[j][j];
	}
}

/* Which columns are in, and the pull on them. */
static inline void choose_columns(struct window *o, const struct scene *s,
				  const struct gd_lwr_conf *conf)
{
	static double q[MAXP][MAXN + MAXP];
	double weight = 0;
	int used = 0, rows = o->n + o->p;

	for (int i = 0; i < o->n; i++)
		weight += o->root[i] * o->root[i];
	for (int j = 0; j < o->p; j++) {
		double sum = 0, square = 0, about, noise = 0, norm = 0, least;

		for (int i = 0; i < o->n; i++) {
			sum += o->root[i] * o->z[i][j];
			square += o->z[i][j] * o->z[i][j];
			if (j >= 3)
				noise += o->root[i] * o->root[i] *
					 value(s->feat_var[j - 3], s->w, o->at[i]);
		}
		about = j == 0 ? square : square - sum * sum / weight;
		if (about < 1e-12 * square)
			about = 0;
		o->pull[j] = j > 0 ? conf->ridge * about : 0;
		least = 1e-8 * about;
		if (j >= 3) {
			double range = s->range[j - 3];

			o->pull[j] += conf->flat * range * range * weight;
			least = fmax(least, fmax(conf->feature_noise * noise,
						 s->floor[j - 3] * weight));
		}
		o->pull[j] = sqrt(o->pull[j]);
		for (int i = 0; i < rows; i++)
			q[j][i] = entry(o, i, j);
		for (int pass = 0; pass < 2; pass++)
			for (int k = 0; k < j; k++) {
				double dot = 0;

				for (int i = 0; o->in[k] && i < rows; i++)
					dot += q[j][i] * q[k][i];
				for (int i = 0; o->in[k] && i < rows; i++)
					q[j][i] -= dot * q[k][i];
			}
		for (int i = 0; i < rows; i++)
			norm += q[j][i] * q[j][i];
		o->in[j] = norm > least && norm > 1e-12 * square && used < 0.5 * o->n;
		used += o->in[j];
		for (int i = 0; i < rows; i++)
			q[j][i] /= sqrt(norm);
	}
}

static inline double at_pixel(const struct window *o, int i, const double *b)
{
	double sum = 0;

	for (int j = 0; j < o->p; j++)
		sum += b[j] * o->z[i][j] / o->root[i];
	return sum;
}

/* What a prediction of pixel i is off by, squared, free of noise, times the pixel's weight. */
static inline double misfit(const struct window *o, const struct scene *s, int c, int i, double v)
{
	double e = v - value(s->y[c], s->w, o->at[i]), sum = e * e;

	if (s->twin)
		sum = e * (v - value(s->twins[c], s->w, o->at[i]));
	else if (s->var)
		sum -= value(s->vars[c], s->w, o->at[i]);
	return o->root[i] * o->root[i] * sum;
}

/* The model of least error at (x,y), into best; xi[c]: its error. Returns its radius. */
static inline int fit_centre(struct window *best, const struct scene *s,
			     const struct gd_lwr_conf *conf, int x, int y, double *xi)
{
	static struct window o, before;
	double acc[3] = { 0 }, scale[3] = { 0 }, least = 0;
	int radius = 0;

	for (int r = 1; r <= conf->radius; r++) {
		double weight = 0, cost = 0;

		before = o;
		open_window(&o, s, x, y, r);
		if (r > 1 && o.n == before.n)
			break;
		choose_columns(&o, s, conf);
		for (int c = 0; c < s->ny; c++)
			solve(&o, s, c, -1, o.b[c]);
		for (int i = 0; i < o.n; i++)
			weight += o.root[i] * o.root[i];
		for (int c = 0; c < s->nc; c++) {
			for (int i = r > 1 ? before.n : 0; i < o.n; i++) {
				double b[MAXP];

				if (r == 1)
					solve(&o, s, c, i, b);
				acc[c] += misfit(&o, s, c, i,
						 at_pixel(&o, i, r == 1 ? b : before.b[c]));
			}
			if (r == 1) {
				double sum = 0;

				for (int i = 0; i < o.n; i++)
					sum += o.root[i] * o.root[i] *
					       value(s->y[c], s->w, o.at[i]);
				scale[c] = 1 / (sum / weight * (sum / weight) + level2(s));
			}
			cost += scale[c] * acc[c] / weight;
		}
		if (r == 1 || cost < least) {
			least = cost;
			radius = r;
			*best = o;
			for (int c = 0; c < s->nc; c++)
				xi[c] = acc[c] / weight;
		} else if (r >= radius + 3 && least > 0 && cost > 4 * least) {
			break;
		}
	}
	return radius;
}

/* Middles of the parts of an axis. */
static inline int grid(int *at, int n, int step)
{
	int count = (n - 1) / step + 1;

	if (n % 2 == 0 && count % 2 == 1)
		count++;
	for (int j = 0; j < count; j++) {
		double middle = (2.0 * j + 1) * n / (2.0 * count) - 0.5;

		at[j] = j < count - j ? (int)floor(middle) : (int)ceil(middle);
	}
	return count;
}

/* Both ways, compared at every pixel; returns the models. */
static inline size_t against_dense(struct scene s, struct gd_lwr_conf conf)
{
	static struct window best;
	int *cx = calloc((size_t)s.w + 1, sizeof *cx), *cy = calloc((size_t)s.h + 1, sizeof *cy);
	double *sum = calloc((size_t)s.w * (size_t)s.h * 12, sizeof *sum);
	struct gd_plane est[6], mse[3], radius = plane(s.w, s.h), features = plane(s.w, s.h);
	struct gd_plane centre = plane(s.w, s.h);
	struct gd_lwr_in in = { .ny = s.ny, .nfeat = s.nfeat, .y = s.y, .feat = s.feat,
				.feat_var = s.feat_var };
	struct gd_lwr_out out = { .est = est, .mse = mse, .radius = radius, .features = features,
				  .centre = centre };
	struct gd_lwr_result result;
	struct gd_err err = { 0 };
	size_t models = 0;

	in.twin = s.twin ? s.twins : NULL;
	in.var = s.var ? s.vars : NULL;
	if (s.weighted)
		in.weight = s.weight;
	for (int c = 0; c < 6; c++)
		est[c] = plane(s.w, s.h);
	for (int c = 0; c < 3; c++)
		mse[c] = plane(s.w, s.h);
	assert_int_equal(gd_lwr_fit(&out, &in, &conf, &result, NULL, &err), GD_OK);

	for (int step = conf.dense ? 1 : conf.granularity ? conf.granularity : 2 * conf.radius + 1;
	     step >= 1; step /= 2) {
		int nx = grid(cx, s.w, step), ny = grid(cy, s.h, step);
		bool *free_ = calloc((size_t)s.w * (size_t)s.h, sizeof *free_);

		for (int i = 0; i < s.w * s.h; i++)
			free_[i] = conf.dense || !(sum[i * 12] > 0);
		for (int j = 0; j < ny; j++)
			for (int i = 0; i < nx; i++) {
				double xi[3], rel = 0, weight = 1;
				int r, used = 0;

				if (!free_[cy[j] * s.w + cx[i]])
					continue;
				r = fit_centre(&best, &s, &conf, cx[i], cy[j], xi);
				(void)rel;
				models++;
				for (int k = 0; k < best.p; k++)
					used += k >= 3 && best.in[k];
				sum[(cy[j] * s.w + cx[i]) * 12 + 11] = 1;
				for (int k = 0; k < best.n; k++) {
					double *to = sum + best.at[k] * 12;

					to[0] += weight;
					for (int c = 0; c < s.ny; c++)
						to[1 + c] += at_pixel(&best, k, best.b[c]);
					for (int c = 0; c < s.nc; c++)
						to[6 + c] += fmax(xi[c], 0);
					to[9] += r;
					to[10] += used;
				}
			}
		free(free_);
	}
	assert_int_equal(models, result.models);
	for (int i = 0; i < s.w * s.h; i++) {
		const double *to = sum + i * 12;
		double scale = 0;

		for (int c = 0; c < s.ny && c < 5; c++) {
			double want = to[1 + c] / to[0], got = value(est[c], s.w, i);

			scale = fmax(fabs(want), 1);
			if (fabs(got - want) > 1e-6 * scale)
				fail_msg("pixel %d,%d plane %d: %.9g, expected %.9g", i % s.w,
					 i / s.w, c, got, want);
		}
		for (int c = 0; c < s.nc; c++) {
			double want = to[6 + c] / to[0], got = value(mse[c], s.w, i);

			if (fabs(got - want) > 2e-6 * fabs(want) + 1e-8)
				fail_msg("pixel %d,%d error %d: %.9g, expected %.9g", i % s.w,
					 i / s.w, c, got, want);
		}
		assert_true(fabs(value(radius, s.w, i) - to[9] / to[0]) < 1e-5);
		assert_true(fabs(value(features, s.w, i) - to[10] / to[0]) < 1e-5);
		assert_true(value(centre, s.w, i) == (float)to[11]);
	}
	free(cx);
	free(cy);
	free(sum);
	free(radius.v);
	free(features.v);
	free(centre.v);
	for (int c = 0; c < 6; c++)
		free(est[c].v);
	for (int c = 0; c < 3; c++)
		free(mse[c].v);
	drop(&s);
	return models;
}

#endif
