/* SPDX-License-Identifier: BSD-3-Clause */
#include "gate.h"

#include <stdlib.h>

#include "blur.h"
#include "halves.h"

#define SIGMA	5.0	/* pixels. 4 to 12: within 1.5 %; less shows noise, more mixes objects */
#define DARK	0.1	/* of the image's level: below it errors count as they are */
#define VOTE	3.0	/* most that a pixel is for or against a: in d, so that no firefly rules */
#define BOUNDED	1.7	/* leverage, times: the bound cuts what it adds more often than what there
			 * is. 1 to 3: within 0.5 % */
#define WEIGHT	4.0	/* most that a channel counts: d of 2.8 times the luminance */
#define LITTLE	0.1	/* of the image's mean of u d^2: as much of the image's share goes in */

struct votes {
	const struct gd_gate *gate;
	struct gd_plane num, den;
	double dark2, samples;		/* (level / 10)^2; sum of the means of both halves' counts */
	double *part;			/* two sums for each row */
};

/* What a half's pixel counts. */
static double samples_of(const struct votes *v, int half, int x, int y)
{
	const struct gd_crossfit_in *in = v->gate->in;

	return in->count[half].v ? (double)gd_row(in->count[half], y)[x] / v->samples :
				   in->share[half];
}

static void add_pixel(double sum[2], const struct votes *v, int half, int x, int y)
{
	const struct gd_gate *g = v->gate;
	const struct gd_crossfit_in *in = g->in;
	const double share = gd_halves_share(in, half, x, y);
	const double known = BOUNDED * g->leverage * (1 - share) * (in->nwhole ? share : 1);
	const double l = (gd_halves_luminance(g->a[1 - half], x, y) +
			  gd_halves_luminance(g->b[1 - half], x, y)) / 2;
	const double u = samples_of(v, half, x, y) / (l * l + v->dark2);

	for (int c = 0; c < 3; c++) {
		double b = (double)gd_row(g->b[half][c], y)[x];
		double d = (double)gd_row(g->a[half][c], y)[x] - b;
		double here = (double)gd_row(in->y[half][c], y)[x];
		double noise = here - (double)gd_row(in->y[1 - half][c], y)[x];
		double most = u * d * d, vote = u * (d * (here - b) + known * noise * noise);
		double times = most > WEIGHT ? WEIGHT / most : 1;

		vote = vote > VOTE * most ? VOTE * most : vote < -VOTE * most ? -VOTE * most : vote;
		sum[0] += times * vote;
		sum[1] += times * most;
	}
}

static void count_votes(const struct votes *v)
{
#pragma omp parallel for schedule(static)
	for (int y = 0; y < v->num.h; y++) {
		double *row = v->part + 2 * y;

		row[0] = row[1] = 0;
		for (int x = 0; x < v->num.w; x++) {
			double sum[2] = { 0 };

			add_pixel(sum, v, 0, x, y);
			add_pixel(sum, v, 1, x, y);
			gd_row(v->num, y)[x] = (float)sum[0];
			gd_row(v->den, y)[x] = (float)sum[1];
			row[0] += sum[0];
			row[1] += sum[1];
		}
	}
}

static double within(double s)
{
	return s < 0 ? 0 : s > 1 ? 1 : s;
}

/* num becomes the share. */
static void decide(const struct votes *v, double *mean)
{
	double sum[2] = { 0 }, prior, all = 0;

	for (int y = 0; y < v->num.h; y++)
		for (int k = 0; k < 2; k++)
			sum[k] += v->part[2 * y + k];
	prior = sum[1] > 0 ? within(sum[0] / sum[1]) : 0.5;
	sum[1] *= LITTLE / v->num.w / v->num.h;
#pragma omp parallel for schedule(static)
	for (int y = 0; y < v->num.h; y++) {
		const float *den = gd_row(v->den, y);
		float *num = gd_row(v->num, y);

		v->part[y] = 0;
		for (int x = 0; x < v->num.w; x++) {
			double d = (double)den[x] + sum[1];
			double s = d > 0 ? ((double)num[x] + sum[1] * prior) / d : prior;

			num[x] = (float)within(s);
			v->part[y] += (double)num[x];
		}
	}
	for (int y = 0; y < v->num.h; y++)
		all += v->part[y];
	*mean = all / v->num.w / v->num.h;
}

static int set_units(struct votes *v, struct gd_err *err)
{
	const struct gd_crossfit_in *in = v->gate->in;
	double level = 0;

	for (int half = 0; half < 2; half++) {
		double l;
		int rc = gd_halves_level(&l, v->gate->b[half], err);

		if (rc != GD_OK)
			return rc;
		level += l / 2;
		v->samples += in->count[half].v ? gd_halves_mean(in->count[half]) : 0;
	}
	v->samples = v->samples > 0 ? v->samples : 1;
	level = fmax(DARK * level, (double)FLT_MIN);
	v->dark2 = level * level;
	return GD_OK;
}

int gd_gate_map(struct gd_plane share, double *mean, const struct gd_gate *gate,
		const struct gd_plane spare[2], struct gd_err *err)
{
	const struct gd_blur blur = gd_blur_gauss(SIGMA);
	struct votes v = { .gate = gate, .num = share, .den = spare[0] };
	int rc = set_units(&v, err);

	if (rc != GD_OK)
		return rc;
	v.part = gd_alloc((size_t)share.h, 2 * sizeof *v.part);
	if (!v.part)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	count_votes(&v);
	rc = gd_blur_plane(v.num, spare[1], &blur, err);
	if (rc == GD_OK)
		rc = gd_blur_plane(v.den, spare[1], &blur, err);
	if (rc == GD_OK)
		decide(&v, mean);
	free(v.part);
	return rc;
}

void gd_gate_mix(const struct gd_plane *b, const struct gd_plane *a, int n, struct gd_plane share,
		 const struct gd_plane square[3], int models)
{
	for (int c = 0; c < n; c++) {
#pragma omp parallel for schedule(static)
		for (int y = 0; y < share.h; y++) {
			const float *restrict s = gd_row(share, y), *restrict from = gd_row(a[c], y);
			float *restrict to = gd_row(b[c], y);
			float *restrict q = c < 3 ? gd_row(square[c], y) : NULL;

			for (int x = 0; x < share.w; x++) {
				double d = (double)from[x] - (double)to[x], w = (double)s[x];

				to[x] = gd_halves_float((double)to[x] + w * d);
				if (q)
					q[x] = gd_halves_square((double)q[x] +
								models * w * (1 - w) * d * d);
			}
		}
	}
}
