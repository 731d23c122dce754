/* SPDX-License-Identifier: BSD-3-Clause */
#include "sampling.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>

#include "blur.h"
#include "kernel/sampling_row.h"
#include "rng.h"
#include "select.h"

#define SIDE	64		/* of a tile, pixels; a power of 2 */
#define TILE	(SIDE * SIDE)
#define PLACES	256		/* per axis, where the level is measured */
#define FAINT	1e-6f		/* of the largest u: the least, so that any total can be spent */
#define CLOSE	1e-7		/* of a pixel: a total is met when each misses by no more */
#define ROUNDS	200		/* most steps of the search for c; 10 are usual */

struct job {
	const struct gd_sampling_in *in;
	const struct gd_sampling_conf *conf;
	const struct gd_sampling_kernel *kernel;
	struct gd_plane rho, u;		/* u: later the fractions */
	float *even;			/* a row of in->even_samples, without in->samples */
	double power;			/* p */
	double unit;			/* samples; the next three are numbers of units */
	double total, min, max;		/* whole */
	struct gd_sampling_rule rule;	/* in units, too */
	double *part;			/* three for each row, or one for each tile */
	int tx, ty;			/* tiles across and down */
};

static const float *samples_row(const struct job *j, int y)
{
	return j->in->samples.v ? gd_row(j->in->samples, y) : j->even;
}

/* ---- relative errors ---- */

static double luminance(const struct gd_sampling_in *in, int x, int y)
{
	double sum = 0;

	for (int c = 0; c < in->n; c++) {
		float v = gd_row(in->colour[c], y)[x];

		sum += v > 0 && v <= FLT_MAX ? (double)v : 0;
	}
	return sum / in->n;
}

/* The mean luminance at up to PLACES^2 pixels spread evenly, the brightest hundredth cut. */
static int find_level(double *level, const struct gd_sampling_in *in, struct gd_err *err)
{
	const struct gd_plane like = in->colour[0];
	size_t nx = (size_t)(like.w < PLACES ? like.w : PLACES), n = 0;
	size_t ny = (size_t)(like.h < PLACES ? like.h : PLACES);
	double *v = gd_alloc(nx * ny, sizeof *v), sum = 0, cut;

	if (!v)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	for (size_t k = 0; k < ny; k++)
		for (size_t i = 0; i < nx; i++) {
			size_t x = (2 * i + 1) * (size_t)like.w / (2 * nx);
			size_t y = (2 * k + 1) * (size_t)like.h / (2 * ny);

			v[n++] = luminance(in, (int)x, (int)y);
		}
	cut = gd_select(v, 0, n, gd_quantile_index(0.99, n));
	for (size_t i = 0; i < n; i++)
		sum += v[i] < cut ? v[i] : cut;
	*level = sum / (double)n;
	free(v);
	return GD_OK;
}

static void relative_errors(const struct job *j, double level)
{
	const struct gd_sampling_in *in = j->in;
	/* a black image has no unit: errors count as they are */
	double dark = level > 0 ? j->conf->dark * level : 1;
	double most = j->conf->paper ? (double)FLT_MAX / 4 : 1;

#pragma omp parallel for schedule(static)
	for (int y = 0; y < j->rho.h; y++) {
		const float *error[4], *colour[4];

		for (int c = 0; c < in->n; c++) {
			error[c] = gd_row(in->error[c], y);
			colour[c] = gd_row(in->colour[c], y);
		}
		j->kernel->relative(gd_row(j->rho, y), error, colour, in->n, dark * dark, most,
				    j->rho.w);
	}
}

/* u, its largest scaled to 1. False if no pixel has an error. */
static bool make_u(const struct job *j)
{
	bool paper = j->conf->paper;
	double trust = j->conf->trust;
	float a = (float)((paper ? -j->power : j->power) / trust);
	float b = (float)(trust * (paper ? 1 : 1 / (1 + j->power)));
	double most = 0;

#pragma omp parallel for schedule(static)
	for (int y = 0; y < j->u.h; y++)
		j->part[y] = (double)j->kernel->demand(gd_row(j->u, y), gd_row(j->rho, y),
						       samples_row(j, y), a, b, j->u.w);
	for (int y = 0; y < j->u.h; y++)
		most = fmax(most, j->part[y]);
#pragma omp parallel for schedule(static)
	for (int y = 0; y < j->u.h; y++) {
		float *u = gd_row(j->u, y);

		/* in two steps: 1 / most may be no float */
		if (most > 0)
			j->kernel->scale(u, (float)(1 / sqrt(most)), 0, j->u.w);
		j->kernel->scale(u, most > 0 ? (float)(1 / sqrt(most)) : 0, FAINT, j->u.w);
	}
	return most > 0;
}

/* ---- the allocation ---- */

/* What the rule spends beyond the total, and how fast that grows with c. */
static double excess(const struct job *j, double *slope)
{
	double sum = 0;

#pragma omp parallel for schedule(static)
	for (int y = 0; y < j->u.h; y++)
		j->kernel->spend(j->part + 2 * y, gd_row(j->u, y), samples_row(j, y), &j->rule,
				 j->u.w);
	*slope = 0;
	for (int y = 0; y < j->u.h; y++) {
		sum += j->part[2 * y];
		*slope += j->part[2 * y + 1];
	}
	return sum - j->total;
}

/* Between low and high, by orders of magnitude where they are far apart. */
static double between(double low, double high)
{
	if (high - low <= 2 * low)
		return low + (high - low) / 2;
	if (low > 1e-9)
		return sqrt(low) * sqrt(high);
	return high > 1e-8 ? 1e-9 * sqrt(high * 1e9) : 0;
}

/*
 * The c that spends the total: Newton's steps on a function made of straight pieces, halving the
 * bracket where they leave it.
 */
static void find_c(struct job *j)
{
	double pixels = (double)j->u.w * j->u.h, slope;
	double low = 0, high = 4 * ((double)GD_SAMPLING_MANY + j->max) / (double)FAINT;

	j->rule.c = 2 * j->total / pixels + 1;
	for (int i = 0; i < ROUNDS; i++) {
		double off = excess(j, &slope), next;

		if (fabs(off) <= CLOSE * pixels)
			break;
		if (off > 0)
			high = j->rule.c;
		else
			low = j->rule.c;
		next = slope > 0 ? j->rule.c - off / slope : -1;
		if (!(next > low && next < high))
			next = between(low, high);
		if (!(next > low && next < high))
			break;
		j->rule.c = next;
	}
}

/* ---- whole numbers ---- */

/* Place d of a Hilbert curve over SIDE x SIDE pixels, as y SIDE + x. */
static int hilbert(int d)
{
	int x = 0, y = 0;

	for (int s = 1; s < SIDE; s *= 2, d /= 4) {
		int rx = d / 2 & 1, ry = (d ^ rx) & 1, t = x;

		if (!ry) {
			x = rx ? s - 1 - y : y;
			y = rx ? s - 1 - t : t;
		}
		x += s * rx;
		y += s * ry;
	}
	return y * SIDE + x;
}

/* A tile, and one of the eight ways to lay the curve into it: no pattern repeats. */
struct path {
	const short *place;
	int x0, y0, w, h, turn;
};

static struct path path_of(const struct job *j, const short *place, int tile,
			   struct gd_rng_key key)
{
	return (struct path){ place, tile % j->tx * SIDE, tile / j->tx * SIDE, j->u.w, j->u.h,
			      (int)(gd_rng_u32(key, (uint32_t)tile, 1) >> 29) };
}

/* The k-th pixel of the path; false if the image does not reach there. */
static inline bool step(const struct path *p, int k, int *x, int *y)
{
	int a = p->place[k] % SIDE, b = p->place[k] / SIDE;

	a = p->turn & 1 ? SIDE - 1 - a : a;
	b = p->turn & 2 ? SIDE - 1 - b : b;
	*x = p->x0 + (p->turn & 4 ? b : a);
	*y = p->y0 + (p->turn & 4 ? a : b);
	return *x < p->w && *y < p->h;
}

/* The sum of a tile's fractions, in the order of its path. */
static double tile_sum(const struct job *j, const struct path *p)
{
	double sum = 0;
	int x, y;

	for (int k = 0; k < TILE; k++)
		if (step(p, k, &x, &y))
			sum += (double)gd_row(j->u, y)[x];
	return sum;
}

/* How running sums of fractions become counts: stretched to a whole total, from a random start. */
struct ladder {
	double stretch, start;
};

/*
 * Rounds a tile: a pixel gets one more where the running sum passes a whole number. before: the
 * sum of the tiles before.
 */
static void round_tile(const struct job *j, struct gd_plane map, const struct path *p,
		       const struct ladder *l, double before)
{
	double sum = 0, have = floor(before * l->stretch + l->start);
	int x, y;

	for (int k = 0; k < TILE; k++) {
		float part;
		double now;

		if (!step(p, k, &x, &y))
			continue;
		part = gd_row(j->u, y)[x];
		if (!(part > 0))
			continue;
		sum += (double)part;
		now = floor((before + sum) * l->stretch + l->start);
		if (now > have) {
			gd_row(map, y)[x] += 1;
			have += 1;
		}
	}
}

/* What rounding errors of sums may have left goes to the first pixels that may take it. */
static void settle(const struct job *j, struct gd_plane map)
{
	double off = -j->total, one;

	for (int y = 0; y < map.h; y++)
		for (int x = 0; x < map.w; x++)
			off += (double)gd_row(map, y)[x];
	one = off > 0 ? -1 : 1;
	for (int y = 0; y < map.h && off != 0; y++)
		for (int x = 0; x < map.w && off != 0; x++) {
			double v = (double)gd_row(map, y)[x] + one;

			if (v < j->min || v > j->max)
				continue;
			gd_row(map, y)[x] = (float)v;
			off += one;
		}
}

/* Whole parts into map, fractions into u. Returns the sum of the former. */
static double allot(const struct job *j, struct gd_plane map)
{
	double whole = 0;

#pragma omp parallel for schedule(static)
	for (int y = 0; y < map.h; y++)
		j->part[y] = j->kernel->allot(gd_row(map, y), gd_row(j->u, y), samples_row(j, y),
					      &j->rule, map.w);
	for (int y = 0; y < map.h; y++)
		whole += j->part[y];
	return whole;
}

static int round_all(const struct job *j, struct gd_plane map, struct gd_err *err)
{
	short *place = gd_alloc(TILE, sizeof *place);
	struct gd_rng_key key = gd_rng_key(j->conf->seed, 0);
	struct ladder l = { 0, ((gd_rng_u32(key, 0, 0) >> 16) + 0.5) / 65536 };
	double sum = 0, whole = allot(j, map);
	int tiles = j->tx * j->ty;

	if (!place)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	for (int k = 0; k < TILE; k++)
		place[k] = (short)hilbert(k);
#pragma omp parallel for schedule(static)
	for (int t = 0; t < tiles; t++) {
		struct path p = path_of(j, place, t, key);

		j->part[t] = tile_sum(j, &p);
	}
	for (int t = 0; t < tiles; t++) {	/* from here on sums of the tiles before */
		double own = j->part[t];

		j->part[t] = sum;
		sum += own;
	}
	l.stretch = sum > 0 && j->total > whole ? (j->total - whole) / sum : 0;
#pragma omp parallel for schedule(static)
	for (int t = 0; t < tiles; t++) {
		struct path p = path_of(j, place, t, key);

		round_tile(j, map, &p, &l, j->part[t]);
	}
	free(place);
	settle(j, map);
#pragma omp parallel for schedule(static) if (j->unit > 1)
	for (int y = 0; y < map.h; y++)
		if (j->unit > 1)
			j->kernel->scale(gd_row(map, y), (float)j->unit, 0, map.w);
	return GD_OK;
}

/* ---- all of it ---- */

static int check_range(const struct gd_sampling_conf *conf, struct gd_err *err)
{
	if (!(conf->floor >= 0 && conf->floor <= 1 && conf->blur_px >= 0 && conf->blur_px <= 10 &&
	      conf->dark > 0 && conf->dimension >= 0 && conf->dimension <= 100 &&
	      conf->trust >= 0.01 && conf->trust <= 1))
		return gd_fail(err, GD_EARG, "a setting of the map is out of its range");
	if (!(conf->multiple >= 1 && conf->multiple <= GD_SAMPLING_MOST &&
	      conf->multiple == floor(conf->multiple)))
		return gd_fail(err, GD_EARG, "multiples of %.17g samples: expected a whole number",
			       conf->multiple);
	if (!(conf->total >= 0 && conf->total <= 0x1p53 &&
	      fmod(conf->total, conf->multiple) == 0))
		return gd_fail(err, GD_EARG, "%.17g samples: expected a multiple of %.0f",
			       conf->total, conf->multiple);
	if (!(conf->min >= 0 && conf->min <= conf->max && conf->max <= GD_SAMPLING_MOST &&
	      conf->min == floor(conf->min) && conf->max == floor(conf->max)))
		return gd_fail(err, GD_EARG, "%.17g to %.17g samples a pixel: expected whole "
			       "numbers, at most %.0f", conf->min, conf->max, GD_SAMPLING_MOST);
	return GD_OK;
}

/* All in units of conf->multiple, for that many pixels. */
static int set_bounds(struct job *j, double pixels, struct gd_err *err)
{
	const struct gd_sampling_conf *conf = j->conf;
	int rc = check_range(conf, err);

	if (rc != GD_OK)
		return rc;
	j->power = 4 / (conf->dimension + 4);
	j->unit = conf->multiple;
	j->total = conf->total / j->unit;
	j->min = ceil(conf->min / j->unit);
	j->max = floor(conf->max / j->unit);
	j->rule.lo = fmax(j->min, conf->floor * j->total / pixels);
	j->rule.hi = j->max;
	if (j->total > j->max * pixels)
		return gd_fail(err, GD_EARG, "%.17g samples are more than %.0f for each of %.0f "
			       "pixels", conf->total, j->max * j->unit, pixels);
	if (j->total < j->min * pixels)
		return gd_fail(err, GD_EARG, "%.17g samples are less than %.0f for each of %.0f "
			       "pixels", conf->total, j->min * j->unit, pixels);
	return GD_OK;
}

static int new_work(struct job *j, struct gd_plane map, struct gd_err *err)
{
	size_t size = gd_stride(map.w) * (size_t)map.h, tiles;
	float even = (float)fmin(j->in->even_samples, (double)GD_SAMPLING_MANY);

	j->tx = (map.w + SIDE - 1) / SIDE;
	j->ty = (map.h + SIDE - 1) / SIDE;
	tiles = (size_t)j->tx * (size_t)j->ty;
	j->rho = gd_plane_of(gd_alloc(size, sizeof(float)), map.w, map.h);
	j->u = gd_plane_of(gd_alloc(size, sizeof(float)), map.w, map.h);
	j->even = gd_alloc((size_t)map.w, sizeof *j->even);
	j->part = gd_alloc(tiles + 3 * (size_t)map.h, sizeof *j->part);
	if (!j->rho.v || !j->u.v || !j->even || !j->part)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	for (int x = 0; x < map.w; x++)
		j->even[x] = even;
	return GD_OK;
}

/* Means of what rho becomes with this map, and with an even one; the map's range. */
static void foresee(const struct job *j, struct gd_plane map, struct gd_sampling_result *r)
{
	double pixels = (double)map.w * map.h;
	float even = (float)(j->conf->total / pixels);

#pragma omp parallel for schedule(static)
	for (int y = 0; y < map.h; y++)
		j->kernel->foresee(j->part + 3 * y, gd_row(j->rho, y), gd_row(map, y),
				   samples_row(j, y), even, (float)j->power, map.w);
	r->least = r->most = (double)gd_row(map, 0)[0];
	for (int y = 0; y < map.h; y++) {
		r->before += j->part[3 * y] / pixels;
		r->after += j->part[3 * y + 1] / pixels;
		r->even += j->part[3 * y + 2] / pixels;
		for (int x = 0; x < map.w; x++) {
			double v = (double)gd_row(map, y)[x];

			r->least = v < r->least ? v : r->least;
			r->most = v > r->most ? v : r->most;
		}
	}
}

static int make_map(struct job *j, struct gd_plane map, struct gd_sampling_result *r,
		    struct gd_err *err)
{
	struct gd_blur blur = gd_blur_gauss(j->conf->blur_px);
	int rc = find_level(&r->level, j->in, err);

	if (rc != GD_OK)
		return rc;
	relative_errors(j, r->level);
	if (j->conf->blur_px > 0)
		rc = gd_blur_plane(j->rho, j->u, &blur, err);
	if (rc != GD_OK)
		return rc;
	r->blind = !make_u(j);
	j->rule.taken = j->conf->paper || r->blind ? 0 : 1 / j->unit;
	find_c(j);
	rc = round_all(j, map, err);
	if (rc == GD_OK)
		foresee(j, map, r);
	return rc;
}

int gd_sampling_map(struct gd_plane map, const struct gd_sampling_in *in,
		    const struct gd_sampling_conf *conf, struct gd_sampling_result *result,
		    struct gd_err *err)
{
	struct job j = { .in = in, .conf = conf, .kernel = GD_PICK(gd_sampling_kernel) };
	struct gd_sampling_result r = { 0 };
	int rc;

	if (in->n < 1 || in->n > 4 || map.w < 1 || map.h < 1)
		return gd_fail(err, GD_EARG, "%d channels of %dx%d pixels", in->n, map.w, map.h);
	rc = set_bounds(&j, (double)map.w * map.h, err);
	if (rc == GD_OK)
		rc = new_work(&j, map, err);
	if (rc == GD_OK)
		rc = make_map(&j, map, &r, err);
	if (rc == GD_OK && result)
		*result = r;
	free(j.rho.v);
	free(j.u.v);
	free(j.even);
	free(j.part);
	return rc;
}
