/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Images whose truth is known, with two halves of noise: what cross-fitted regressions are tested
 * on. Radiance is linear in the features, but for a disc of height `bend` that only a feature of
 * the halves shows. A test includes this once.
 */
#ifndef HALVES_CASE_H
#define HALVES_CASE_H

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "crossfit.h"

#define FEATURES 3
#define PLANES 9	/* most that are estimated */

/* model: maps that some fits fill. All planes are the case's own. */
struct job {
	int w, h;
	struct gd_plane truth[3], est[PLANES], mse[3], spread, model[3];
	struct gd_crossfit_in in;
};

/* Noise of mean 0 and variance 1, bounded by 3.5. */
static inline double draw(unsigned seed, int c, int x, int y)
{
	uint64_t k =
		((uint64_t)seed << 40) ^ ((uint64_t)c << 32) ^ ((uint64_t)x << 16) ^ (uint64_t)y;
	double sum = 0;

	for (int i = 0; i < 4; i++) {
		k += 0x9e3779b97f4a7c15u;
		k = (k ^ (k >> 30)) * 0xbf58476d1ce4e5b9u;
		k = (k ^ (k >> 27)) * 0x94d049bb133111ebu;
		k ^= k >> 31;
		sum += (double)(k >> 11) / 9007199254740992.0 - 0.5;
	}
	return sum * 1.7320508;
}

static inline struct gd_plane plane(int w, int h)
{
	return gd_plane_of(gd_calloc(gd_stride(w) * (size_t)h, sizeof(float)), w, h);
}

static inline double feature(int a, int x, int y)
{
	return a == 0	? (x / 9 + y / 7) % 3
	       : a == 1 ? sin(0.2 * x) * cos(0.15 * y)
			: 0.02 * (x + y);
}

static inline double truth(int c, int x, int y, double bend)
{
	double v = 1.5 + 0.4 * feature(0, x, y) + 0.2 * (c + 1) * feature(1, x, y);

	return v + bend * ((x - 30) * (x - 30) + (y - 20) * (y - 20) < 150) + 0.1 * c;
}

/* Either half has noise of standard deviation sigma; var is that of their mean. */
static inline struct job *make(int w, int h, int ny, double sigma, double bend)
{
	struct job *j = calloc(1, sizeof *j);

	*j = (struct job){ .w = w, .h = h, .in = { .ny = ny, .nfeat = FEATURES } };
	j->spread = plane(w, h);
	for (int c = 0; c < ny; c++) {
		j->est[c] = plane(w, h);
		j->in.y[0][c] = plane(w, h);
		j->in.y[1][c] = plane(w, h);
	}
	for (int a = 0; a < FEATURES; a++)
		j->in.feat[a] = plane(w, h);
	for (int c = 0; c < 3; c++) {
		j->truth[c] = plane(w, h);
		j->mse[c] = plane(w, h);
		j->model[c] = plane(w, h);
		j->in.var[c] = plane(w, h);
	}
	for (int y = 0; y < h; y++)
		for (int x = 0; x < w; x++) {
			for (int a = 0; a < FEATURES; a++)
				gd_row(j->in.feat[a], y)[x] = (float)feature(a, x, y);
			for (int c = 0; c < 3; c++) {
				double t = truth(c, x, y, bend);

				gd_row(j->truth[c], y)[x] = (float)t;
				gd_row(j->in.var[c], y)[x] = (float)(sigma * sigma / 2);
				for (unsigned half = 0; half < 2; half++)
					gd_row(j->in.y[half][c], y)[x] =
						(float)(t + sigma * draw(half, c, x, y));
			}
		}
	return j;
}

/* A feature of either half: the truth, with noise of its own of deviation sigma. */
static inline void add_feature(struct job *j, double sigma)
{
	j->in.nfeature = 3;
	for (unsigned half = 0; half < 2; half++)
		for (int c = 0; c < 3; c++) {
			j->in.feature[half][c] = plane(j->w, j->h);
			for (int y = 0; y < j->h; y++)
				for (int x = 0; x < j->w; x++)
					gd_row(j->in.feature[half][c], y)[x] =
						(float)((double)gd_row(j->truth[c], y)[x] +
							sigma * draw(4 + half, c, x, y));
		}
}

/* Planes 3..5 and 6..8 become two layers that add up to the colour of the half. */
static inline void split_layers(struct job *j)
{
	for (int half = 0; half < 2; half++)
		for (int c = 0; c < 3; c++)
			for (int y = 0; y < j->h; y++)
				for (int x = 0; x < j->w; x++) {
					float all = gd_row(j->in.y[half][c], y)[x];
					float part = 0.3f * all + 0.1f * (float)draw(9, c, x, y);

					gd_row(j->in.y[half][3 + c], y)[x] = part;
					gd_row(j->in.y[half][6 + c], y)[x] = all - part;
				}
}

/* The same layers of all samples: they have no halves then. */
static inline void make_whole(struct job *j)
{
	j->in.ny = 3;
	j->in.nwhole = PLANES;
	for (int c = 0; c < PLANES; c++) {
		j->in.whole[c] = plane(j->w, j->h);
		for (int y = 0; y < j->h; y++)
			for (int x = 0; x < j->w; x++)
				gd_row(j->in.whole[c], y)[x] = (gd_row(j->in.y[0][c], y)[x] +
								gd_row(j->in.y[1][c], y)[x]) / 2;
	}
}

static inline void drop(struct gd_plane *p)
{
	free(p->v);
	p->v = NULL;
}

static inline void done(struct job *j)
{
	for (int c = 0; c < PLANES; c++) {
		drop(&j->est[c]);
		drop(&j->in.y[0][c]);
		drop(&j->in.y[1][c]);
		drop(&j->in.whole[c]);
	}
	for (int c = 0; c < 3; c++) {
		drop(&j->truth[c]);
		drop(&j->mse[c]);
		drop(&j->model[c]);
		drop(&j->in.var[c]);
		drop(&j->in.feat[c]);
		drop(&j->in.feature[0][c]);
		drop(&j->in.feature[1][c]);
	}
	drop(&j->in.count[0]);
	drop(&j->in.count[1]);
	drop(&j->spread);
	free(j);
}

/* ---- what came out ---- */

static inline double mean(struct gd_plane p)
{
	double s = 0;

	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++)
			s += (double)gd_row(p, y)[x];
	return s / p.w / p.h;
}

/* Mean squared error and, into *own, what the fit takes it for; columns x0 <= x < x1. */
static inline double square_error_of(const struct job *j, int x0, int x1, double *own)
{
	double s = 0, n = 3.0 * j->h * (x1 - x0), sum = 0;

	for (int c = 0; c < 3; c++)
		for (int y = 0; y < j->h; y++)
			for (int x = x0; x < x1; x++) {
				s += pow((double)gd_row(j->est[c], y)[x] -
					 (double)gd_row(j->truth[c], y)[x], 2);
				sum += (double)gd_row(j->mse[c], y)[x];
			}
	*own = sum / n;
	return s / n;
}

static inline double square_error(const struct job *j)
{
	double own;

	return square_error_of(j, 0, j->w, &own);
}

static inline double most_off(struct gd_plane a, struct gd_plane b)
{
	double most = 0;

	for (int y = 0; y < a.h; y++)
		for (int x = 0; x < a.w; x++)
			most = fmax(most, fabs((double)gd_row(a, y)[x] - (double)gd_row(b, y)[x]));
	return most;
}

static inline double rms_off(struct gd_plane a, struct gd_plane b)
{
	double sum = 0;

	for (int y = 0; y < a.h; y++)
		for (int x = 0; x < a.w; x++)
			sum += pow((double)gd_row(a, y)[x] - (double)gd_row(b, y)[x], 2);
	return sqrt(sum / a.w / a.h);
}

/* How far layers are from adding up to the colour, at most. */
static inline double most_missing(const struct job *j)
{
	double most = 0;

	for (int c = 0; c < 3; c++)
		for (int y = 0; y < j->h; y++)
			for (int x = 0; x < j->w; x++)
				most = fmax(most, fabs((double)gd_row(j->est[c], y)[x] -
						       (double)gd_row(j->est[3 + c], y)[x] -
						       (double)gd_row(j->est[6 + c], y)[x]));
	return most;
}

/* a less than b, with both in the message. */
static inline void below_at(double a, double b, const char *file, int line)
{
	if (!(a < b)) {
		print_error("%s:%d: %g, expected below %g\n", file, line, a, b);
		fail();
	}
}
#define below(a, b) below_at(a, b, __FILE__, __LINE__)

static inline void assert_sane(const struct job *j)
{
	for (int y = 0; y < j->h; y++)
		for (int x = 0; x < j->w; x++) {
			for (int c = 0; c < PLANES && j->est[c].v; c++)
				assert_true(isfinite(gd_row(j->est[c], y)[x]));
			for (int c = 0; c < 3; c++) {
				assert_true(isfinite(gd_row(j->mse[c], y)[x]));
				assert_true(gd_row(j->mse[c], y)[x] >= 0);
				assert_true(isfinite(gd_row(j->model[c], y)[x]));
			}
			assert_true(isfinite(gd_row(j->spread, y)[x]));
		}
}

/* ---- the same image otherwise ---- */

static inline void swap(struct gd_plane *a, struct gd_plane *b)
{
	struct gd_plane t = *a;

	*a = *b;
	*b = t;
}

/* how: 1 left and right swapped, 2 top and bottom, 3 x and y. */
static inline void turn(struct gd_plane *p, int how)
{
	struct gd_plane t = how == 3 ? plane(p->h, p->w) : plane(p->w, p->h);

	for (int y = 0; y < p->h; y++)
		for (int x = 0; x < p->w; x++) {
			float v = gd_row(*p, y)[x];

			if (how == 3)
				gd_row(t, x)[y] = v;
			else
				gd_row(t, how == 2 ? p->h - 1 - y : y)[how == 1 ? p->w - 1 - x :
								       x] = v;
		}
	free(p->v);
	*p = t;
}

/* All that three channels have, in and out. */
static inline void turn_all(struct job *j, int how)
{
	for (int c = 0; c < 3; c++) {
		struct gd_plane *all[] = { &j->truth[c], &j->est[c], &j->mse[c], &j->model[c],
					   &j->in.y[0][c], &j->in.y[1][c], &j->in.var[c],
					   &j->in.feat[c], &j->in.feature[0][c],
					   &j->in.feature[1][c] };

		for (size_t i = 0; i < sizeof all / sizeof *all; i++)
			if (all[i]->v)
				turn(all[i], how);
	}
	turn(&j->spread, how);
	if (how == 3) {
		int w = j->w;

		j->w = j->h;
		j->h = w;
	}
}

static inline void times(struct gd_plane p, float s)
{
	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++)
			gd_row(p, y)[x] *= s;
}

/* The noise of columns x0 <= x < x1 of a half, times s: no variance knows of it. */
static inline void more_noise(struct job *j, int half, int x0, int x1, double s)
{
	for (int c = 0; c < 3; c++)
		for (int y = 0; y < j->h; y++)
			for (int x = x0; x < x1; x++) {
				float *v = gd_row(j->in.y[half][c], y) + x;
				double t = (double)gd_row(j->truth[c], y)[x];

				*v = (float)(t + s * ((double)*v - t));
			}
}

static inline void drop_var(struct job *j)
{
	for (int c = 0; c < 3; c++)
		drop(&j->in.var[c]);
}

/* From no sample of a half in a pixel to six, each with the noise that the half had; 0 without. */
static inline void count_samples(struct job *j)
{
	for (unsigned half = 0; half < 2; half++) {
		j->in.count[half] = plane(j->w, j->h);
		for (int y = 0; y < j->h; y++)
			for (int x = 0; x < j->w; x++) {
				double u = draw(20 + half, 0, x, y);
				int n = u < -0.5 ? 0 : u < 0.3 ? 1 : u < 1 ? 3 : 6;

				gd_row(j->in.count[half], y)[x] = (float)n;
				for (int c = 0; c < 3; c++) {
					double t = (double)gd_row(j->truth[c], y)[x];
					float *v = gd_row(j->in.y[half][c], y) + x;

					*v = n ? (float)(t + ((double)*v - t) / sqrt(n)) : 0;
				}
			}
	}
	drop_var(j);
}

#define ODD 5

/* The last feature says nothing, the same as the first, or sits far from 0. */
static inline void spoil_feature(struct job *j, int odd)
{
	for (int y = 0; y < j->h; y++)
		for (int x = 0; x < j->w; x++) {
			float *f = gd_row(j->in.feat[2], y) + x;

			*f = odd == 0	? 7
			     : odd == 1 ? gd_row(j->in.feat[0], y)[x]
			     : odd == 2 ? 1e8f + 64 * (float)x
			     : odd == 3 ? (x < 9 ? 3e38f : *f)
					: 1e-40f * (float)x;
		}
}

/* All pixels alike. */
static inline void fill(struct job *j, float v0, float v1, float var)
{
	for (int c = 0; c < 3; c++)
		for (int y = 0; y < j->h; y++)
			for (int x = 0; x < j->w; x++) {
				gd_row(j->in.y[0][c], y)[x] = v0;
				gd_row(j->in.y[1][c], y)[x] = v1;
				gd_row(j->in.var[c], y)[x] = var;
			}
}

static inline void set(struct job *j, int half, int x, int y, float v)
{
	for (int c = 0; c < 3; c++)
		gd_row(j->in.y[half][c], y)[x] = v;
}

#endif
