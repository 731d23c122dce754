/* SPDX-License-Identifier: BSD-3-Clause */
#include "gather.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "follow.h"
#include "halves.h"

#define SIDE	7
#define SMOOTH	7
#define NOISE	2.5	/* of neighbouring pixels hangs together: times the variance of a mean */
#define PIXELS	15.0	/* whose noise a regression averages at least */
#define DETAIL	2.0	/* times their noise are squares of differences, where heavy tails are */
#define DARK	0.3	/* of the image's level: below it, differences count as they are */
#define ROUNDING 1e-8	/* squared: light that differs by 1e-4 is the same */

enum { U = 0, V = 3, D = 6, E = 9, Q = 12, COVER = 15, SPARE, WEIGHT, PLANES };

/*
 * Work space. u, v: the frame's logarithms and their variances in a pixel; d, q, e: difference to
 * another frame, its square, the variance of that one; cover: 1 where it shows the same surface.
 */
struct work {
	struct gd_plane plane[PLANES];
	int *at;		/* the other frame's pixel y * w + x, -1: none */
	double dark;
};

/* Where pixel x, y is in the other frame. */
static int *pixel_at(const struct work *w, int x, int y)
{
	return w->at + (size_t)y * (size_t)w->plane[COVER].w + (size_t)x;
}

/* ---- where a pixel is in another frame ---- */

/* Fills w->at, and the plane COVER with 0 and 1. */
static void find(struct work *w, const struct gd_crossfit_in *in,
		 const struct gd_crossfit_frame *frame)
{
	const struct gd_plane *here = in->position, *there = frame->position;
	struct gd_plane cover = w->plane[COVER];
	bool known = here[0].v && there[0].v;

	if (known)
		gd_follow(w->at, here, there);
#pragma omp parallel for schedule(static)
	for (int y = 0; y < cover.h; y++)
		for (int x = 0; x < cover.w; x++) {
			int *at = pixel_at(w, x, y);

			if (!known)
				*at = y * cover.w + x;
			gd_row(cover, y)[x] = *at >= 0;
		}
}

/* ---- how far frames agree ---- */

static double squash(double v, double dark)
{
	return log(1 + fmax(v, 0) / dark);
}

/*
 * Mean of the halves' logarithms in a pixel, and the variance of that mean as their difference
 * tells it (without halves: as var does).
 */
static void tell(const struct gd_plane *a, const struct gd_plane *b, const struct gd_plane *var,
		 double dark, int c, int x, int y, double *u, double *v)
{
	double p = squash((double)gd_row(a[c], y)[x], dark), q;

	if (b) {
		q = squash((double)gd_row(b[c], y)[x], dark);
		*u = (p + q) / 2;
		*v = (p - q) * (p - q) / 4;
	} else {
		q = dark + fmax((double)gd_row(a[c], y)[x], 0);
		*u = p;
		*v = (double)gd_row(var[c], y)[x] / (q * q);
	}
}

/* The frame's own logarithms. */
static int prepare(struct work *w, const struct gd_crossfit_in *in, struct gd_err *err)
{
	const struct gd_plane *b = in->self ? NULL : in->y[1];
	double level;
	int rc = gd_halves_level(&level, in->y[0], err);

	if (rc == GD_OK)
		w->dark = fmax(DARK * level, (double)FLT_MIN);
	for (int c = 0; c < 3 && rc == GD_OK; c++) {
		struct gd_plane to = w->plane[U + c], var = w->plane[V + c];

#pragma omp parallel for schedule(static)
		for (int y = 0; y < to.h; y++)
			for (int x = 0; x < to.w; x++) {
				double u, v;

				tell(in->y[0], b, in->var, w->dark, c, x, y, &u, &v);
				gd_row(to, y)[x] = (float)u;
				gd_row(var, y)[x] = gd_halves_square(v);
			}
	}
	return rc == GD_OK ? gd_halves_smooth(w->plane + V, 3, w->plane[SPARE], SMOOTH, err) : rc;
}

/* Difference to another frame, and its variance; 0 where that does not show the surface. */
static int compare(struct work *w, const struct gd_crossfit_in *in,
		   const struct gd_crossfit_frame *frame, struct gd_err *err)
{
	const struct gd_plane *b = in->self ? NULL : frame->y[1];
	int width = w->plane[D].w, rc;

	for (int c = 0; c < 3; c++) {
		struct gd_plane diff = w->plane[D + c], var = w->plane[E + c];

#pragma omp parallel for schedule(static)
		for (int y = 0; y < diff.h; y++)
			for (int x = 0; x < width; x++) {
				int at = *pixel_at(w, x, y);
				double u = 0, v = 0;

				if (at >= 0) {
					tell(frame->y[0], b, frame->var, w->dark, c, at % width,
					     at / width, &u, &v);
					u -= (double)gd_row(w->plane[U + c], y)[x];
				}
				gd_row(diff, y)[x] = (float)u;
				gd_row(w->plane[Q + c], y)[x] = (float)(u * u);
				gd_row(var, y)[x] = gd_halves_square(v);
			}
	}
	rc = gd_halves_smooth(w->plane + E, 3, w->plane[SPARE], SMOOTH, err);
	if (rc == GD_OK)
		rc = gd_halves_smooth(w->plane + Q, 3, w->plane[SPARE], SIDE, err);
	return rc == GD_OK ? gd_halves_smooth(w->plane + D, 3, w->plane[SPARE], SIDE, err) : rc;
}

/* The squared difference of the frames beyond their noise; n: share of the window that is there. */
static double bias2(const struct work *w, int x, int y, double n)
{
	double sum = 0;

	for (int c = 0; c < 3; c++) {
		double d = (double)gd_row(w->plane[D + c], y)[x] / n;
		double v = (double)gd_row(w->plane[E + c], y)[x] / n +
			   (double)gd_row(w->plane[V + c], y)[x];
		double q = (double)gd_row(w->plane[Q + c], y)[x] / n;

		d = d * d - NOISE * v / (SIDE * SIDE * n);
		q -= DETAIL * v;
		sum += fmax(0, fmax(d, q));
	}
	return sum;
}

/* Fills the plane WEIGHT. */
static int weigh(struct work *w, struct gd_err *err)
{
	struct gd_plane to = w->plane[WEIGHT], cover = w->plane[COVER];
	int rc = gd_halves_smooth(&cover, 1, w->plane[SPARE], SIDE, err);

	if (rc != GD_OK)
		return rc;
#pragma omp parallel for schedule(static)
	for (int y = 0; y < to.h; y++)
		for (int x = 0; x < to.w; x++) {
			bool there = *pixel_at(w, x, y) >= 0;
			double noise = ROUNDING, bias = 0;

			for (int c = 0; c < 3; c++)
				noise += (double)gd_row(w->plane[V + c], y)[x] / PIXELS;
			if (there)
				bias = bias2(w, x, y, (double)gd_row(cover, y)[x]);
			gd_row(to, y)[x] = there ? (float)(noise / (noise + bias)) : 0;
		}
	return gd_halves_smooth(&to, 1, w->plane[SPARE], 3, err);
}

/* ---- taking the samples in ---- */

/* What a pixel of a half counts, in samples. */
static double samples(const struct gd_plane count[2], const double share[2], int half, int x, int y)
{
	return count[half].v ? (double)gd_row(count[half], y)[x] : share[half];
}

/*
 * to += (from - to) times, so that what is constant stays so, or (square) the variance of such a
 * mean: by the squared weights.
 */
static void blend(struct gd_plane to, struct gd_plane from, int x, int y, int u, int v,
		  double times, bool square)
{
	double a = (double)gd_row(to, y)[x], b = (double)gd_row(from, v)[u], keep = 1 - times;

	gd_row(to, y)[x] = square ? gd_halves_square(keep * keep * a + times * times * b) :
				    gd_halves_float(a + times * (b - a));
}

/* One pixel u, v of a frame, of weight w, into pixel x, y: each half, and what both share. */
static void take(struct gd_crossfit_in *in, const struct gd_crossfit_frame *f,
		 struct gd_plane count[2], double w, int x, int y, int u, int v)
{
	double have[2], more[2];

	for (int h = 0; h < 2; h++) {
		have[h] = (double)gd_row(count[h], y)[x];
		more[h] = w * samples(f->count, in->share, h, u, v);
		gd_row(count[h], y)[x] = (float)(have[h] + more[h]);
	}
	for (int h = 0; h < gd_halves_count(in); h++) {
		double times = more[h] > 0 ? more[h] / (have[h] + more[h]) : 0;

		for (int c = 0; c < in->ny; c++)
			blend(in->y[h][c], f->y[h][c], x, y, u, v, times, false);
		for (int c = 0; c < in->nfeature; c++)
			blend(in->feature[h][c], f->feature[h][c], x, y, u, v, times, false);
	}
	more[0] += more[1];
	more[0] = more[0] > 0 ? more[0] / (have[0] + have[1] + more[0]) : 0;
	for (int c = 0; c < in->nwhole; c++)
		blend(in->whole[c], f->whole[c], x, y, u, v, more[0], false);
	for (int c = 0; c < 3 && in->var[c].v; c++)
		blend(in->var[c], f->var[c], x, y, u, v, more[0], true);
}

static void take_frame(struct gd_crossfit_in *in, const struct gd_crossfit_frame *f,
		       struct gd_plane count[2], const struct work *w)
{
	struct gd_plane weight = w->plane[WEIGHT];

#pragma omp parallel for schedule(static)
	for (int y = 0; y < weight.h; y++)
		for (int x = 0; x < weight.w; x++) {
			int at = *pixel_at(w, x, y);

			if (at >= 0)
				take(in, f, count, (double)gd_row(weight, y)[x], x, y,
				     at % weight.w, at / weight.w);
		}
}

static int new_count(struct gd_plane count[2], const struct gd_crossfit_in *in, struct gd_err *err)
{
	int rc = gd_halves_planes(count, 2, in->y[0][0], err);

	for (int h = 0; h < 2 && rc == GD_OK; h++)
		for (int y = 0; y < count[h].h; y++)
			for (int x = 0; x < count[h].w; x++)
				gd_row(count[h], y)[x] =
					(float)samples(in->count, in->share, h, x, y);
	return rc;
}

static double samples_of(const struct gd_plane count[2])
{
	return gd_halves_mean(count[0]) + gd_halves_mean(count[1]);
}

int gd_gather(struct gd_crossfit_in *in, struct gd_plane count[2], const struct gd_report *report,
	      struct gd_err *err)
{
	struct work *w = in->nframe > 0 ? gd_calloc(1, sizeof *w) : NULL;
	struct gd_plane like = in->y[0][0];
	double before = 1;
	int rc = GD_OK;

	if (in->nframe <= 0)
		return GD_OK;
	if (w)
		w->at = gd_alloc((size_t)like.w * (size_t)like.h, sizeof *w->at);
	if (!w || !w->at)
		rc = gd_fail(err, GD_ENOMEM, "out of memory");
	if (rc == GD_OK)
		rc = gd_halves_planes(w->plane, PLANES, like, err);
	if (rc == GD_OK)
		rc = new_count(count, in, err);
	if (rc == GD_OK)
		rc = prepare(w, in, err);
	if (rc == GD_OK)
		before = fmax(samples_of(count), (double)FLT_MIN);
	for (int k = 0; k < in->nframe && rc == GD_OK; k++) {
		find(w, in, in->frame + k);
		rc = compare(w, in, in->frame + k, err);
		if (rc == GD_OK)
			rc = weigh(w, err);
		if (rc == GD_OK)
			take_frame(in, in->frame + k, count, w);
	}
	if (rc == GD_OK) {
		gd_note(report, "%d other frame%s: %.2f times the samples", in->nframe,
			in->nframe > 1 ? "s" : "", samples_of(count) / before);
		memcpy(in->count, count, sizeof in->count);
		in->nframe = 0;
	}
	if (w) {
		gd_halves_free(w->plane, PLANES);
		free(w->at);
	}
	free(w);
	return rc;
}
