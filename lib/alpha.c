/* SPDX-License-Identifier: BSD-3-Clause */
#include "alpha.h"

#include <math.h>
#include <stdlib.h>

#include "field.h"
#include "pairsolve.h"

#define STEPS 7		/* alpha = LEAST x 2^k: 0.0625 .. 4 */
#define START 3		/* 0.5 */
#define SHARE 0.7	/* of the root of the ratio of the variances: see alpha.h */
#define DARK 0.2	/* of the typical brightness: below it errors count no more than there */

struct choice {
	const struct gd_alpha_in *in;
	double tolerance, level;
	struct gd_plane image, noise, weight;	/* solutions, and what their squares count */
	double *part;			/* sums of each row */
	double error[STEPS];		/* NAN: not tried */
	int solutions;
};

static void add(struct gd_poisson_in *grid, struct gd_pairsolve_in *paired,
		const struct gd_alpha_in *in, struct gd_plane colour, const struct gd_plane *edge)
{
	const int c = grid->n++;

	paired->n++;
	grid->primal[c] = paired->primal[c] = colour;
	for (int k = 0; k < in->edges; k++)
		paired->value[k][c] = edge[k];
	grid->dx[c] = edge[0];
	grid->dy[c] = edge[1];
}

/* The image, its noise, or both, as they share the work. */
static int solve(struct choice *c, bool image, bool noise, double alpha, struct gd_err *err)
{
	const struct gd_alpha_in *in = c->in;
	struct gd_poisson_conf conf = GD_POISSON_DEFAULTS;
	struct gd_pairsolve_in paired = { .pairs = in->pairs };
	struct gd_poisson_in grid = { 0 };
	struct gd_plane out[2];
	int n = 0;

	conf.method = GD_L2;
	conf.alpha = alpha;
	conf.tolerance = in->pairs ? c->tolerance : sqrt(c->tolerance);
	if (image) {
		out[n++] = c->image;
		add(&grid, &paired, in, in->colour, in->edge);
	}
	if (noise) {
		out[n++] = c->noise;
		add(&grid, &paired, in, in->colour_noise, in->edge_noise);
	}
	c->solutions += n;
	return in->pairs ? gd_pairsolve(out, &paired, &conf, NULL, NULL, err)
			 : gd_poisson_solve(out, &grid, &conf, NULL, NULL, err);
}

static double total(const struct choice *c)
{
	double sum = 0;

	for (int y = 0; y < c->weight.h; y++)
		sum += c->part[y];
	return sum;
}

/* Mean over 3x3 pixels, those of the image. */
static double around(struct gd_plane p, int x, int y)
{
	double sum = 0;
	int n = 0;

	for (int j = y > 0 ? y - 1 : y; j <= y + 1 && j < p.h; j++)
		for (int i = x > 0 ? x - 1 : x; i <= x + 1 && i < p.w; i++, n++)
			sum += (double)gd_row(p, j)[i];
	return sum / n;
}

/*
 * What a squared error counts, of that in a pixel as dark as DARK. The brightness is that of the
 * darker half: a firefly, which one half has, must not excuse itself.
 */
static void weigh(const struct choice *c)
{
	const double dark = DARK * c->level;
	const bool halves = c->in->source == GD_ALPHA_HALVES;

#pragma omp parallel for schedule(static)
	for (int y = 0; y < c->weight.h; y++)
		for (int x = 0; x < c->weight.w; x++) {
			const double off = halves ? fabs(around(c->noise, x, y)) : 0;
			const double l = fmax(fabs(around(c->image, x, y)) - off, 0) / dark;

			gd_row(c->weight, y)[x] = (float)(1 / (l * l + 1));
		}
}

static double squares(const struct choice *c)
{
#pragma omp parallel for schedule(static)
	for (int y = 0; y < c->noise.h; y++) {
		const float *o = gd_row(c->noise, y), *weight = gd_row(c->weight, y);
		double sum = 0;

		for (int x = 0; x < c->noise.w; x++) {
			const double v = (double)o[x] / c->level;

			sum += (double)weight[x] * v * v;
		}
		c->part[y] = sum;
	}
	return total(c);
}

/* The error at step k, tried once. */
static int try(struct choice *c, int k, struct gd_err *err)
{
	int rc = GD_OK;

	if (!isnan(c->error[k]))
		return GD_OK;
	rc = solve(c, false, true, ldexp(GD_ALPHA_LEAST, k), err);
	if (rc == GD_OK)
		c->error[k] = squares(c);
	return rc;
}

/* How far off the middle of three points, in steps, a parabola through them has its least. */
static double vertex(const double e[3])
{
	const double a = log(e[0]), b = log(e[1]), c = log(e[2]), bend = a - 2 * b + c;

	return bend > 0 && isfinite(bend) ? 0.5 * (a - c) / bend : 0;
}

/* Downhill from 0.5, which is solved, as the error has one valley; 0 without an error. */
static int search(double *alpha, struct choice *c, const struct gd_report *report,
		  struct gd_err *err)
{
	int k = START, step = 1, rc;

	for (int i = 0; i < STEPS; i++)
		c->error[i] = NAN;
	c->error[k] = squares(c);
	rc = try(c, k + 1, err);
	if (rc != GD_OK)
		return rc;
	if (!(c->error[k + 1] < c->error[k]))
		step = -1;
	for (int next = k + step; next >= 0 && next < STEPS; next += step) {
		rc = try(c, next, err);
		if (rc != GD_OK)
			return rc;
		gd_progress(report, "alpha", c->solutions / (STEPS + 1.0));
		if (!(c->error[next] < c->error[k]))
			break;
		k = next;
	}
	*alpha = ldexp(GD_ALPHA_LEAST, k);
	if (k > 0 && k < STEPS - 1)
		*alpha *= exp2(vertex(c->error + k - 1));
	if (!(c->error[START] > 0))
		*alpha = 0;
	return GD_OK;
}

static bool is_edge(const struct gd_alpha_in *in, int k, int x, int y)
{
	const size_t i = (size_t)y * (size_t)in->colour.w + (size_t)x;

	if (in->pairs)
		return in->pairs->dx[k][i] || in->pairs->dy[k][i];
	return k ? y + 1 < in->colour.h : x + 1 < in->colour.w;
}

/* Weighted mean of a variance where it is a number, over the pixels or over edges. */
static double mean_variance(const struct choice *c, const struct gd_plane *var, int planes,
			    bool edges)
{
	double sum = 0;

	for (int pass = 0; pass < 2; pass++) {
#pragma omp parallel for schedule(static)
		for (int y = 0; y < c->weight.h; y++) {
			double part = 0;

			for (int k = 0; k < planes; k++)
				for (int x = 0; x < c->weight.w; x++) {
					const double v = (double)gd_row(var[k], y)[x];

					if (isfinite(v) && v >= 0 &&
					    (!edges || is_edge(c->in, k, x, y)))
						part += (double)gd_row(c->weight, y)[x] *
							(pass ? 1 : v);
				}
			c->part[y] = part;
		}
		if (pass)
			sum /= fmax(total(c), 1e-300);
		else
			sum = total(c);
	}
	return sum;
}

static double by_variances(const struct choice *c)
{
	const struct gd_alpha_in *in = c->in;
	const double colour = mean_variance(c, &in->colour_noise, 1, false);
	const double gradient = mean_variance(c, in->edge_noise, in->edges, true);

	if (!(colour > 0))
		return gradient > 0 ? GD_ALPHA_MOST : 0;
	return fmin(fmax(SHARE * sqrt(gradient / colour), GD_ALPHA_LEAST), GD_ALPHA_MOST);
}

static int choose(double *alpha, struct choice *c, const struct gd_report *report,
		  struct gd_err *err)
{
	const struct gd_field field = {
		c->in->colour.w, c->in->colour.h, 1, 1, &c->in->colour, &c->in->edge[0], NULL
	};
	const bool halves = c->in->source == GD_ALPHA_HALVES;
	int rc;

	c->level = gd_field_level(&field);
	if (!(c->level > 0))
		return GD_OK;
	rc = solve(c, true, halves, ldexp(GD_ALPHA_LEAST, START), err);
	if (rc != GD_OK)
		return rc;
	weigh(c);
	if (halves)
		return search(alpha, c, report, err);
	*alpha = by_variances(c);
	return GD_OK;
}

const char *gd_alpha_source_name(enum gd_alpha_source source)
{
	static const char *const name[] = { "published", "variances", "halves" };

	return name[source];
}

static void tell(const struct gd_alpha *alpha, const struct gd_report *report)
{
	static const char *const from[] = { "the published one, as nothing tells the noise",
					    "from the variances",
					    "from the difference of two halves of the samples" };

	gd_note(report, "alpha %.4g, %s", alpha->value, from[alpha->source]);
}

static int allocate(struct choice *c, int w, int h, struct gd_err *err)
{
	const size_t size = (size_t)h * gd_stride(w);
	float *block = gd_alloc(3 * size, sizeof(*block));

	c->image = gd_plane_of(block, w, h);
	c->noise = gd_plane_of(block ? block + size : NULL, w, h);
	c->weight = gd_plane_of(block ? block + 2 * size : NULL, w, h);
	c->part = gd_alloc((size_t)h, sizeof(*c->part));
	if (!block || !c->part)
		return gd_fail(err, GD_ENOMEM, "alpha: out of memory for %dx%d", w, h);
	return GD_OK;
}

int gd_alpha_choose(struct gd_alpha *alpha, const struct gd_alpha_in *in, double tolerance,
		    const struct gd_report *report, struct gd_err *err)
{
	struct choice c = { .in = in, .tolerance = tolerance };
	const int w = in->colour.w, h = in->colour.h;
	double value = 0;
	int rc = GD_OK;

	if (in->source != GD_ALPHA_NONE) {
		rc = allocate(&c, w, h, err);
		if (rc == GD_OK)
			rc = choose(&value, &c, report, err);
		free(c.part);
		free(c.image.v);
	}
	*alpha = (struct gd_alpha){ value > 0 ? round(1e3 * value) / 1e3 : GD_ALPHA_PUBLISHED,
				    value > 0 ? in->source : GD_ALPHA_NONE, c.solutions };
	if (rc == GD_OK)
		tell(alpha, report);
	return rc;
}
