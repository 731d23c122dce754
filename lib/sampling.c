/* SPDX-License-Identifier: BSD-3-Clause */
#include "sampling.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "blur.h"
#include "rng.h"
#include "select.h"

#define SIDE	64		/* of a tile, pixels; a power of 2 */
#define TILE	(SIDE * SIDE)
#define PLACES	256		/* per axis, where the level is measured */
#define FAINT	1e-6f		/* of the largest u: nothing is below, so that any total can be spent */
#define MANY	1e9		/* samples of a pixel beyond which more make no difference */
#define ROUNDS	200		/* most steps of the search for c; 10 are usual */

struct job {
	const struct gd_sampling_in *in;
	const struct gd_sampling_conf *conf;
	struct gd_plane rho, u;		/* u is the blur's spare plane before */
	double power;			/* p */
	double unit;			/* samples; the next four are numbers of units */
	double total, min, max;		/* whole */
	bool flat;			/* a = c u: samples at hand are not taken off */
	double lo;			/* least a, no less than min */
	double c;
	double *part;			/* a double for each row, and two for each tile */
	int tx, ty;			/* tiles across and down */
};

static double samples_at(const struct gd_sampling_in *in, int x, int y)
{
	double n = in->samples.v ? (double)gd_row(in->samples, y)[x] : in->even_samples;

	return n > 0 ? fmin(n, MANY) : 0;	/* NaN: none */
}

/* ---- relative errors ---- */

static double number(float v)
{
	return isfinite(v) ? (double)v : 0;
}

/* The mean luminance at up to PLACES^2 pixels spread evenly, the brightest hundredth cut. */
static int find_level(double *level, const struct gd_sampling_in *in, struct gd_err *err)
{
	const struct gd_plane like = in->colour[0];
	size_t nx = (size_t)(like.w < PLACES ? like.w : PLACES), n = 0, top;
	size_t ny = (size_t)(like.h < PLACES ? like.h : PLACES);
	double *v = gd_alloc(nx * ny, sizeof *v), sum = 0, cut;

	if (!v)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	for (size_t j = 0; j < ny; j++)
		for (size_t i = 0; i < nx; i++) {
			size_t x = (2 * i + 1) * (size_t)like.w / (2 * nx);
			size_t y = (2 * j + 1) * (size_t)like.h / (2 * ny);

			v[n] = 0;
			for (int c = 0; c < in->n; c++)
				v[n] += fmax(number(gd_row(in->colour[c], (int)y)[x]), 0) / in->n;
			n++;
		}
	top = gd_quantile_index(0.99, n);
	cut = gd_select(v, 0, n, top);
	for (size_t i = 0; i < n; i++)
		sum += fmin(v[i], cut);
	*level = sum / (double)n;
	free(v);
	return GD_OK;
}

/* The relative error of one value; dark: squared, added to the square of the colour. */
static double relative(float error, float colour, double dark, double most)
{
	double c = number(colour), r = (double)error / (c * c + dark);

	return !(r > 0) ? 0 : r < most ? r : most;
}

static void relative_errors(const struct job *j, double level)
{
	const struct gd_sampling_in *in = j->in;
	/* a black image: any unit will do, and errors count as they are */
	double dark = level > 0 ? j->conf->dark * level : 1;
	double most = j->conf->paper ? (double)FLT_MAX / 4 : 1;

#pragma omp parallel for schedule(static)
	for (int y = 0; y < j->rho.h; y++) {
		float *rho = gd_row(j->rho, y);

		for (int x = 0; x < j->rho.w; x++) {
			double sum = 0;

			for (int c = 0; c < in->n; c++)
				sum += relative(gd_row(in->error[c], y)[x],
						gd_row(in->colour[c], y)[x], dark * dark, most);
			rho[x] = (float)(sum / in->n);
		}
	}
}

/*
 * What a is linear in. Scaled so that the largest is 1; none is below FAINT. False if no pixel has
 * an error.
 */
static bool make_u(const struct job *j)
{
	double n_power = j->conf->paper ? -j->power : j->power;
	double power = j->conf->paper ? 1 : 1 / (1 + j->power);
	bool even = !j->in->samples.v;
	double most = 0;

#pragma omp parallel for schedule(static)
	for (int y = 0; y < j->u.h; y++) {
		const float *rho = gd_row(j->rho, y);
		float *u = gd_row(j->u, y), top = 0;

		for (int x = 0; x < j->u.w; x++) {
			double n = fmax(samples_at(j->in, x, y), 1), r = (double)rho[x];

			if (!even)
				r *= pow(n, n_power);
			u[x] = (float)fmin(power < 1 ? pow(r, power) : r, (double)FLT_MAX);
			top = fmaxf(top, u[x]);
		}
		j->part[y] = (double)top;
	}
	for (int y = 0; y < j->u.h; y++)
		most = fmax(most, j->part[y]);
#pragma omp parallel for schedule(static)
	for (int y = 0; y < j->u.h; y++)
		for (int x = 0; x < j->u.w; x++) {
			double v = most > 0 ? (double)gd_row(j->u, y)[x] / most : 1;

			gd_row(j->u, y)[x] = fmaxf((float)v, FAINT);
		}
	return most > 0;
}

/* ---- the allocation ---- */

static double wanted(const struct job *j, double c, int x, int y)
{
	double a = c * (double)gd_row(j->u, y)[x];

	if (!j->flat)
		a -= samples_at(j->in, x, y) / j->unit;

	return a < j->lo ? j->lo : a > j->max ? j->max : a;
}

/* What c spends beyond the total, and how fast that grows with c. */
static double excess(const struct job *j, double c, double *slope)
{
	int h = j->u.h;
	double whole = 0, rest = 0;

#pragma omp parallel for schedule(static)
	for (int y = 0; y < h; y++) {
		const float *u = gd_row(j->u, y);
		double sum = 0, down = 0, fraction = 0;

		for (int x = 0; x < j->u.w; x++) {
			double a = wanted(j, c, x, y), base = floor(a);

			sum += base;
			fraction += a - base;
			if (a > j->lo && a < j->max)
				down += (double)u[x];
		}
		j->part[y] = sum;
		j->part[h + y] = fraction;
		j->part[2 * h + y] = down;
	}
	*slope = 0;
	for (int y = 0; y < h; y++) {
		whole += j->part[y];
		rest += j->part[h + y];
		*slope += j->part[2 * h + y];
	}
	return (whole - j->total) + rest;
}

/*
 * The c that spends the total: Newton's steps on a function made of straight pieces, halving the
 * bracket where they leave it. Fractions are summed apart from whole numbers, so that sums of 1e12
 * lose nothing.
 */
static void find_c(struct job *j)
{
	double low = 0, high = 2 * (MANY + j->max) / (double)FAINT, slope;
	double mean = j->total / ((double)j->u.w * j->u.h);
	double close = 1e-9 * (double)j->u.w;

	j->c = mean + 1;
	for (int i = 0; i < ROUNDS; i++) {
		double off = excess(j, j->c, &slope), next;

		if (fabs(off) <= close)
			break;
		if (off > 0)
			high = j->c;
		else
			low = j->c;
		next = slope > 0 ? j->c - off / slope : -1;
		if (!(next > low && next < high))
			next = low > 0 ? sqrt(low) * sqrt(high) : high / 2 > 1 ? sqrt(high) : high / 2;
		if (!(next > low && next < high))
			break;
		j->c = next;
	}
}

/* ---- whole numbers ---- */

/* Place d of a Hilbert curve over SIDE x SIDE pixels. */
static void hilbert(int d, int *x, int *y)
{
	*x = *y = 0;
	for (int s = 1; s < SIDE; s *= 2) {
		int rx = d / 2 & 1, ry = (d ^ rx) & 1;

		if (!ry) {
			int t = *x;

			if (rx) {
				t = s - 1 - *x;
				*y = s - 1 - *y;
				*x = t;
			}
			t = *x;
			*x = *y;
			*y = t;
		}
		*x += s * rx;
		*y += s * ry;
		d /= 4;
	}
}

/* One of the eight ways to lay the curve into a tile: no pattern repeats from tile to tile. */
struct path {
	const short (*place)[2];
	int x0, y0, turn;
};

static bool step(const struct job *j, const struct path *p, int k, int *x, int *y)
{
	int a = p->place[k][0], b = p->place[k][1];

	if (p->turn & 1)
		a = SIDE - 1 - a;
	if (p->turn & 2)
		b = SIDE - 1 - b;
	*x = p->x0 + (p->turn & 4 ? b : a);
	*y = p->y0 + (p->turn & 4 ? a : b);
	return *x < j->u.w && *y < j->u.h;
}

static struct path path_of(const struct job *j, const short (*place)[2], int tile,
			   struct gd_rng_key key)
{
	return (struct path){ place, tile % j->tx * SIDE, tile / j->tx * SIDE,
			      (int)(gd_rng_u32(key, (uint32_t)tile, 1) >> 29) };
}

/* Whole numbers of a tile, and the sum of its fractions in the order of the path. */
static void add_tile(const struct job *j, int tile, const struct path *p)
{
	double whole = 0, rest = 0;
	int x, y;

	for (int k = 0; k < TILE; k++)
		if (step(j, p, k, &x, &y)) {
			double a = wanted(j, j->c, x, y), base = floor(a);

			whole += base;
			rest += a - base;
		}
	j->part[2 * tile] = whole;
	j->part[2 * tile + 1] = rest;
}

/*
 * Rounds a tile: a pixel gets one more wherever the running sum of the fractions, begun at a
 * random place in 0 .. 1 and stretched to its whole total, passes a whole number.
 */
static void round_tile(const struct job *j, struct gd_plane map, const struct path *p,
		       double before, double stretch, double start)
{
	const double below_one = 1 - 0x1p-30;
	double sum = before * stretch + start, given = floor(sum), rest = 0;
	int x, y;

	for (int k = 0; k < TILE; k++)
		if (step(j, p, k, &x, &y)) {
			double a = wanted(j, j->c, x, y), base = floor(a), now;

			rest += fmin(a - base, below_one);
			now = floor((before + rest) * stretch + start);
			now = now < given ? given : now > given + 1 ? given + 1 : now;
			gd_row(map, y)[x] = (float)(a > base ? base + (now - given) : base);
			given = a > base ? now : given;
		}
}

/* What rounding errors of sums may have left, one by one to the first that may take them. */
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

static int round_all(const struct job *j, struct gd_plane map, struct gd_err *err)
{
	short (*place)[2] = gd_alloc(TILE, sizeof *place);
	struct gd_rng_key key = gd_rng_key(j->conf->seed, 0);
	double start = ((gd_rng_u32(key, 0, 0) >> 16) + 0.5) / 65536, sum = 0, whole = 0, extra;
	int tiles = j->tx * j->ty;

	if (!place)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	for (int k = 0; k < TILE; k++) {
		int x, y;

		hilbert(k, &x, &y);
		place[k][0] = (short)x;
		place[k][1] = (short)y;
	}
#pragma omp parallel for schedule(static)
	for (int t = 0; t < tiles; t++) {
		struct path p = path_of(j, place, t, key);

		add_tile(j, t, &p);
	}
	for (int t = 0; t < tiles; t++) {	/* sums of fractions: from here on, those before */
		double rest = j->part[2 * t + 1];

		whole += j->part[2 * t];
		j->part[2 * t + 1] = sum;
		sum += rest;
	}
	extra = fmax(j->total - whole, 0);
#pragma omp parallel for schedule(static)
	for (int t = 0; t < tiles; t++) {
		struct path p = path_of(j, place, t, key);

		round_tile(j, map, &p, j->part[2 * t + 1], sum > 0.5 ? extra / sum : 0, start);
	}
	free(place);
	settle(j, map);
	for (int y = 0; y < map.h && j->unit > 1; y++)
		for (int x = 0; x < map.w; x++)
			gd_row(map, y)[x] *= (float)j->unit;
	return GD_OK;
}

/* ---- all of it ---- */

static int check_range(const struct gd_sampling_conf *conf, struct gd_err *err)
{
	if (!(conf->floor >= 0 && conf->floor <= 1 && conf->blur_px >= 0 && conf->blur_px <= 10 &&
	      conf->dark > 0 && conf->dimension >= 0 && conf->dimension <= 100))
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
	j->lo = fmax(j->min, conf->floor * j->total / pixels);
	if (j->total > j->max * pixels)
		return gd_fail(err, GD_EARG, "%.17g samples are more than %.0f for each of %.0f "
			       "pixels", conf->total, j->max * j->unit, pixels);
	if (j->total < j->min * pixels)
		return gd_fail(err, GD_EARG, "%.17g samples are less than %.0f for each of %.0f "
			       "pixels", conf->total, j->min * j->unit, pixels);
	return GD_OK;
}

/* Means of what rho becomes with this map, and with an even one. */
static void foresee(const struct job *j, struct gd_plane map, struct gd_sampling_result *r)
{
	double pixels = (double)map.w * map.h, mean = j->conf->total / pixels;
	int h = map.h;

	r->before = r->after = r->even = 0;
	r->least = r->most = (double)gd_row(map, 0)[0];
#pragma omp parallel for schedule(static)
	for (int y = 0; y < h; y++) {
		double before = 0, after = 0, even = 0;

		for (int x = 0; x < map.w; x++) {
			double n = fmax(samples_at(j->in, x, y), 1);
			double rho = (double)gd_row(j->rho, y)[x];

			before += rho;
			after += rho * pow(1 + (double)gd_row(map, y)[x] / n, -j->power);
			even += rho * pow(1 + mean / n, -j->power);
		}
		j->part[y] = before;
		j->part[h + y] = after;
		j->part[2 * h + y] = even;
	}
	for (int y = 0; y < h; y++) {
		r->before += j->part[y] / pixels;
		r->after += j->part[h + y] / pixels;
		r->even += j->part[2 * h + y] / pixels;
		for (int x = 0; x < map.w; x++) {
			r->least = fmin(r->least, (double)gd_row(map, y)[x]);
			r->most = fmax(r->most, (double)gd_row(map, y)[x]);
		}
	}
}

static int new_work(struct job *j, struct gd_plane map, struct gd_err *err)
{
	size_t size = gd_stride(map.w) * (size_t)map.h, parts;

	j->tx = (map.w + SIDE - 1) / SIDE;
	j->ty = (map.h + SIDE - 1) / SIDE;
	parts = 2 * (size_t)j->tx * (size_t)j->ty;
	parts = parts > 3 * (size_t)map.h ? parts : 3 * (size_t)map.h;
	j->rho = gd_plane_of(gd_alloc(size, sizeof(float)), map.w, map.h);
	j->u = gd_plane_of(gd_alloc(size, sizeof(float)), map.w, map.h);
	j->part = gd_alloc(parts, sizeof *j->part);
	return j->rho.v && j->u.v && j->part ? GD_OK : gd_fail(err, GD_ENOMEM, "out of memory");
}

static int make_map(struct job *j, struct gd_plane map, struct gd_sampling_result *r,
		    struct gd_err *err)
{
	const struct gd_sampling_conf *conf = j->conf;
	struct gd_blur blur = gd_blur_gauss(conf->blur_px);
	int rc = find_level(&r->level, j->in, err);

	if (rc != GD_OK)
		return rc;
	relative_errors(j, r->level);
	if (conf->blur_px > 0)
		rc = gd_blur_plane(j->rho, j->u, &blur, err);
	if (rc != GD_OK)
		return rc;
	r->blind = !make_u(j);
	j->flat = conf->paper || r->blind;
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
	struct job j = { .in = in, .conf = conf };
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
	free(j.part);
	return rc;
}
