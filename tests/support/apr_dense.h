/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * The regression engine against a slow one that owes it nothing: every window's weighted design
 * matrix is written out, orthonormalised by Gram-Schmidt, twice, in double, the noise of each
 * column summed pixel by pixel, and every window predicts every one of its pixels one after the
 * other.
 */
#ifndef APR_DENSE_H
#define APR_DENSE_H

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

#include "apr.h"

#define MAXP 24

struct scene {
	int w, h, ny, nvar, nfeat;
	struct gd_plane y[6], var[6], feat[8], feat_var[8], weight;
};

static inline double rnd(unsigned *s)
{
	*s = *s * 1664525u + 1013904223u;
	return (double)(*s >> 8) / (1 << 24);
}

static inline struct gd_plane plane(int w, int h)
{
	return gd_plane_of(gd_calloc(gd_stride(w) * (size_t)h, sizeof(float)), w, h);
}

static inline struct scene make(int w, int h, int ny, int nvar, int nfeat, unsigned seed)
{
	struct scene s = {
		.w = w, .h = h, .ny = ny, .nvar = nvar, .nfeat = nfeat, .weight = plane(w, h)};

	for (int c = 0; c < ny; c++)
		s.y[c] = plane(w, h);
	for (int c = 0; c < nvar; c++)
		s.var[c] = plane(w, h);
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
				double f = a < 3 ? smooth[a] : rnd(&seed);

				gd_row(s.feat[a], y)[x] = (float)f;
				gd_row(s.feat_var[a], y)[x] = a == 1 ? 1e-3f : 0;
			}
			for (int c = 0; c < ny; c++) {
				double n = noise * (rnd(&seed) + rnd(&seed) + rnd(&seed) - 1.5) * 2;

				gd_row(s.y[c], y)[x] = (float)(1 + c * u + edge + u * u * v +
							       (c == 1 ? sin(20 * v) : 0) + n);
				if (c < nvar)
					gd_row(s.var[c], y)[x] =
						(float)(noise * noise * (0.5 + rnd(&seed)));
			}
		}
	return s;
}

static inline void drop(struct scene *s)
{
	free(s->weight.v);
	for (int c = 0; c < s->ny; c++)
		free(s->y[c].v);
	for (int c = 0; c < s->nvar; c++)
		free(s->var[c].v);
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

/* What is added to the squared mean where channels are weighed: 1 % of the squared level, which is
 * the mean over the middle half of 64 rows' means of 64 magnitudes each. */
static inline double level2(const struct scene *s)
{
	double sum = 0;

	for (int c = 0; c < s->nvar; c++) {
		double row[64] = { 0 };

		for (int i = 0; i < 64 * 64; i++)
			row[i / 64] += fabs((double)gd_row(s->y[c], i / 64 * (s->h - 1) / 63)
						[i % 64 * (s->w - 1) / 63]) / 64;
		qsort(row, 64, sizeof *row, ascending);
		for (int i = 16; i < 48; i++)
			sum += row[i] / 32 / s->nvar;
	}
	return 0.01 * sum * sum;
}

/* Squared distance of the percentiles 0.5 and 99.5 of a feature, over 64x64 places. */
static inline double range2(struct gd_plane f)
{
	double v[64 * 64];

	for (int i = 0; i < 64 * 64; i++)
		v[i] = (double)gd_row(f, i / 64 * (f.h - 1) / 63)[i % 64 * (f.w - 1) / 63];
	qsort(v, 64 * 64, sizeof *v, ascending);
	return pow(v[4095 - 20] - v[20], 2);
}

/*
 * Dense fit of one window; adds its predictions to est (and the error and order) and its weights to
 * sum. A pull of column j towards 0 is row n + j of the design: its root in that column, no value
 * of y.
 */
static inline void window(const struct scene *s, const struct gd_apr_conf *conf, double level,
			  bool weighted, int cx, int cy, double *est, double *mse, double *order,
			  double *sum)
{
	int r = conf->radius, p = 1 + s->nfeat + 2 * conf->order_max, n = 0, side = 2 * r + 1, best;
	double *x = calloc((size_t)(side * side * p), sizeof *x),
	       *q = calloc((size_t)((side * side + p) * p), sizeof *q);
	double *k = calloc((size_t)(side * side), sizeof *k),
	       *fit = calloc((size_t)(side * side * s->ny), sizeof *fit);
	int *at = calloc((size_t)(side * side), sizeof *at);
	double *spread = calloc((size_t)(side * side), sizeof *spread);	/* the kernel alone */
	double v[MAXP][6], t[MAXP][6], mean[6] = { 0 }, total = 0, cost[4] = { 0 };

	for (int y = cy - r; y <= cy + r; y++)
		for (int xx = cx - r; xx <= cx + r; xx++) {
			double dx = r ? (double)(xx - cx) / r : 0,
			       dy = r ? (double)(y - cy) / r : 0, *z = x + n * p;

			if (xx < 0 || y < 0 || xx >= s->w || y >= s->h)
				continue;
			k[n] = conf->kernel == GD_APR_GAUSS ? exp(-2 * (dx * dx + dy * dy)) : 1;
			spread[n] = k[n];
			k[n] *= weighted ? (double)gd_row(s->weight, y)[xx] : 1;
			at[n] = y * s->w + xx;
			*z++ = 1;
			for (int a = 0; a < s->nfeat; a++)
				*z++ = (double)gd_row(s->feat[a], y)[xx];
			for (int o = 1; o <= conf->order_max; o++) {
				*z++ = pow(dx, o);
				*z++ = pow(dy, o);
			}
			total += k[n];
			for (int c = 0; c < s->ny; c++)
				mean[c] += k[n] * (double)gd_row(s->y[c], y)[xx];
			n++;
		}
	for (int j = 0; j < p; j++) {
		double len = 0, about_mean = 0, noise = 0, raw = 0;

		for (int i = 0; i < n; i++) {
			q[i * p + j] = sqrt(k[i]) * x[i * p + j];
			raw += q[i * p + j] * q[i * p + j];
		}
		for (int pass = 0; pass < 2; pass++)
			for (int l = 0; l < j; l++) {
				double d = 0;

				for (int i = 0; i < n + p; i++)
					d += q[i * p + j] * q[i * p + l];
				for (int i = 0; i < n + p; i++)
					q[i * p + j] -= d * q[i * p + l];
				if (pass == 0 && l == 0)
					for (int i = 0; i < n; i++)
						about_mean += q[i * p + j] * q[i * p + j];
			}
		if (j > 0)
			q[(n + j) * p + j] = sqrt(conf->ridge * about_mean +
				(j <= s->nfeat ? conf->flat * range2(s->feat[j - 1]) * total : 0));
		for (int i = 0; i < n + p; i++)
			len += q[i * p + j] * q[i * p + j];
		for (int i = 0; i < n && j >= 1 && j <= s->nfeat; i++)
			noise += k[i] *
				 (double)gd_row(s->feat_var[j - 1], at[i] / s->w)[at[i] % s->w];
		if (j > 0 && (len <= 1e-8 * about_mean || len <= 1e-12 * total ||
			      len <= 1e-26 * raw || len <= conf->feature_noise * noise))
			len = 0;
		for (int i = 0; i < n + p; i++)
			q[i * p + j] = len > 0 ? q[i * p + j] / sqrt(len) : 0;
		for (int c = 0; c < s->ny; c++) {
			t[j][c] = v[j][c] = 0;
			for (int i = 0; i < n; i++) {
				size_t o = (size_t)(at[i] / s->w) * s->y[c].stride +
					   (size_t)(at[i] % s->w);

				t[j][c] += q[i * p + j] * sqrt(k[i]) * (double)s->y[c].v[o];
				if (c < s->nvar)
					v[j][c] += conf->correlation * q[i * p + j] * q[i * p + j] *
						   k[i] * (double)s->var[c].v[o];
			}
		}
	}
	best = conf->order_min;
	for (int o = conf->order_min + 1; o <= conf->order_max; o++) {
		cost[o] = cost[o - 1];
		for (int j = s->nfeat + 2 * o - 1; j <= s->nfeat + 2 * o; j++)
			for (int c = 0; c < s->nvar; c++)
				cost[o] += (2 * v[j][c] - t[j][c] * t[j][c]) /
					   (pow(mean[c] / total, 2) + level);
		if (cost[o] < cost[best])
			best = o;
	}
	for (int c = 0; c < s->ny; c++) {
		double left = 0, carried = 0;

		for (int i = 0; i < n; i++) {
			double f = 0;

			for (int j = 0; j < 1 + s->nfeat + 2 * best; j++)
				f += q[i * p + j] * t[j][c];
			est[c * s->w * s->h + at[i]] += spread[i] / sqrt(k[i]) * f;
		}
		for (int i = 0; c < s->nvar && i < n; i++) {
			size_t o = (size_t)(at[i] / s->w) * s->y[c].stride + (size_t)(at[i] % s->w);
			double y = (double)s->y[c].v[o];

			left += k[i] * (y * y - (double)s->var[c].v[o]);
		}
		for (int j = 0; c < s->nvar && j < 1 + s->nfeat + 2 * best; j++) {
			left -= t[j][c] * t[j][c] - v[j][c];
			carried += v[j][c];
		}
		for (int i = 0; c < s->nvar && i < n; i++)
			mse[c * s->w * s->h + at[i]] +=
				spread[i] * ((left > 0 ? left : 0) + carried) / total;
	}
	for (int i = 0; i < n; i++) {
		sum[at[i]] += spread[i];
		order[at[i]] += spread[i] * best;
	}
	free(x);
	free(q);
	free(k);
	free(spread);
	free(fit);
	free(at);
}

/* Both results compared, relative to the largest estimate and error. Frees the scene. */
static inline void against_dense(struct scene s, struct gd_apr_conf conf, bool weighted)
{
	int w = s.w, h = s.h, ny = s.ny, nvar = s.nvar, nfeat = s.nfeat;
	struct gd_plane est[6], mse[6];
	struct gd_apr_in in = { ny, nvar, nfeat, s.y, s.var, s.feat, s.feat_var,
				weighted ? s.weight : (struct gd_plane){ 0 } };
	struct gd_apr_out out = { est, mse, plane(w, h), plane(w, h) };
	struct gd_err err = { 0 };
	size_t n = (size_t)(w * h);
	double *want = calloc(n * 6, sizeof *want), *wmse = calloc(n * 6, sizeof *want);
	double *word = calloc(n, sizeof *want), *sum = calloc(n, sizeof *want);
	double worst = 0, most = 0, worst_mse = 0, most_mse = 0, worst_order = 0;
	int *cx = malloc(sizeof *cx * (size_t)w), *cy = malloc(sizeof *cy * (size_t)h);
	int nx = gd_apr_centres(cx, w, conf.step), nrow = gd_apr_centres(cy, h, conf.step);

	for (int c = 0; c < ny; c++) {
		est[c] = plane(w, h);
		mse[c] = plane(w, h);
	}
	assert_int_equal(gd_apr_fit(&out, &in, &conf, NULL, &err), GD_OK);
	for (int j = 0; j < nrow; j++)
		for (int i = 0; i < nx; i++)
			window(&s, &conf, level2(&s), weighted, cx[i], cy[j], want, wmse, word,
			       sum);
	for (int y = 0; y < h; y++)
		for (int x = 0; x < w; x++) {
			size_t i = (size_t)(y * w + x);

			assert_true(sum[i] > 0);
			for (int c = 0; c < ny; c++) {
				double v = want[(size_t)c * n + i] / sum[i];

				assert_true(isfinite(gd_row(est[c], y)[x]));
				worst = fmax(worst, fabs((double)gd_row(est[c], y)[x] - v));
				most = fmax(most, fabs(v));
			}
			for (int c = 0; c < nvar; c++) {
				double v = fmin(wmse[(size_t)c * n + i] / sum[i], (double)FLT_MAX);

				assert_true(isfinite(gd_row(mse[c], y)[x]) &&
					    gd_row(mse[c], y)[x] >= 0);
				worst_mse = fmax(worst_mse, fabs((double)gd_row(mse[c], y)[x] - v));
				most_mse = fmax(most_mse, v);
			}
			worst_order = fmax(worst_order, fabs((double)gd_row(out.order, y)[x] -
							     word[i] / sum[i]));
		}
	/* the estimate is rounded to float (6e-8, denormals 1e-45) and may be a difference of
	 * terms a few times larger; the error is one of squares in double */
	if (!(worst <= 1e-6 * most + 1e-44) ||
	    !(worst_mse <= 1e-5 * most_mse + 1e-13 * most * most + 1e-44) || !(worst_order <= 1e-5))
		print_message(
			"%dx%d R=%d: estimate off by %g of %g, error by %g of %g, order by %g\n", w,
			h, conf.radius, worst, most, worst_mse, most_mse, worst_order);
	assert_true(worst <= 1e-6 * most + 1e-44);
	assert_true(worst_mse <= 1e-5 * most_mse + 1e-13 * most * most + 1e-44);
	assert_true(worst_order <= 1e-5);
	for (int c = 0; c < ny; c++) {
		free(est[c].v);
		free(mse[c].v);
	}
	free(out.order.v);
	free(out.columns.v);
	free(want);
	free(wmse);
	free(word);
	free(sum);
	free(cx);
	free(cy);
	drop(&s);
}

#endif
