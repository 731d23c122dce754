/* SPDX-License-Identifier: BSD-3-Clause */
#include "temporal.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define NOWHERE (-1)	/* no pixel of the previous frame shows this place */

static const double paper_delta = 1e-3;	/* 1 / first variance, of both coefficients */
static const double cap = 2e3;		/* most that variances may be, in those of one frame's */
static const double same_place = 3;	/* pixels: farther apart are two places */
static const double slope_prior = 0.02;	/* of the colour, per frame: how light changes */
static const double doubt = 1.0;	/* squared misfit over its expectation that is still chance */

/* What a pixel of the previous frame says of this one. */
struct guess {
	float v[3], slope[3];
	float p[3];		/* 00, 01, 11 */
	float at[3];		/* world position */
	float frames;		/* 0: it says nothing */
};

struct work {
	int w, h;
	struct guess *guess;	/* w * h */
	int *match;		/* index of the guess taken, or NOWHERE */
	float *misfit;		/* squared, mean of the channels; then of the pixels around */
	float *row;		/* a copy of it */
};

static const char *const channel[GD_TEMPORAL_PLANES] = {
	"state.value.R", "state.value.G", "state.value.B",
	"state.slope.R", "state.slope.G", "state.slope.B",
	"state.P.00", "state.P.01", "state.P.11",
	"state.position.X", "state.position.Y", "state.position.Z", "state.frames"
};

/* ---- the state as channels ---- */

const char *gd_temporal_channel(int i)
{
	return i >= 0 && i < GD_TEMPORAL_PLANES ? channel[i] : NULL;
}

int gd_temporal_want(struct gd_image *im, struct gd_err *err)
{
	for (int c = 0; c < im->nchan; c++)
		im->chan[c].want = GD_DROP;
	for (int i = 0; i < GD_TEMPORAL_PLANES; i++) {
		int c = gd_image_find(im, channel[i]);

		if (c < 0)
			return gd_fail(err, GD_ESHAPE, "no channel %s: it holds no state",
				       channel[i]);
		im->chan[c].want = GD_READ;
	}
	return GD_OK;
}

int gd_temporal_view(struct gd_temporal_state *state, const struct gd_image *im,
		     struct gd_err *err)
{
	for (int i = 0; i < GD_TEMPORAL_PLANES; i++)
		if (!gd_image_plane(im, channel[i], &state->plane[i]))
			return gd_fail(err, GD_ESHAPE, "no channel %s: it holds no state",
				       channel[i]);
	return GD_OK;
}

int gd_temporal_add(struct gd_temporal_state *state, struct gd_image *im, struct gd_err *err)
{
	int rc = GD_OK;

	for (int i = 0; i < GD_TEMPORAL_PLANES && rc == GD_OK; i++)
		rc = gd_image_add(im, channel[i], &state->plane[i], err);
	return rc;
}

/* ---- what the previous frame foretells ---- */

static bool sound(const struct guess *g)
{
	float sum = 0;

	for (int c = 0; c < 3; c++)
		sum += fabsf(g->v[c]) + fabsf(g->slope[c]) + fabsf(g->p[c]) + fabsf(g->at[c]);
	return sum < FLT_MAX && g->frames >= 1 && g->frames < FLT_MAX && g->p[0] >= 0 &&
	       g->p[2] >= 0 && g->p[1] * g->p[1] <= 1.01f * g->p[0] * g->p[2] + FLT_MIN;
}

/* One frame on: t is counted from the new one, so that value and slope mix. */
static void move_on(struct guess *g)
{
	for (int c = 0; c < 3; c++)
		g->v[c] += g->slope[c];
	g->p[0] += 2 * g->p[1] + g->p[2];
	g->p[1] += g->p[2];
	g->p[0] = fmaxf(g->p[0], 0);
}

static void foretell(struct work *k, const struct gd_temporal_state *prev)
{
#pragma omp parallel for schedule(static)
	for (int y = 0; y < k->h; y++) {
		const float *row[GD_TEMPORAL_PLANES];

		for (int i = 0; i < GD_TEMPORAL_PLANES; i++)
			row[i] = gd_row(prev->plane[i], y);
		for (int x = 0; x < k->w; x++) {
			struct guess *g = &k->guess[(size_t)y * (size_t)k->w + (size_t)x];

			for (int c = 0; c < 3; c++) {
				g->v[c] = row[GD_TEMPORAL_VALUE + c][x];
				g->slope[c] = row[GD_TEMPORAL_SLOPE + c][x];
				g->p[c] = row[GD_TEMPORAL_P + c][x];
				g->at[c] = row[GD_TEMPORAL_POSITION + c][x];
			}
			g->frames = row[GD_TEMPORAL_FRAMES][x];
			if (!sound(g)) {
				*g = (struct guess){ 0 };
				continue;
			}
			move_on(g);
			if (!sound(g))
				*g = (struct guess){ 0 };
		}
	}
}

/* ---- the same place in the previous frame ---- */

struct here {
	float y[3], at[3];
	float s2;		/* squared error of y, mean of the channels */
	float size2;		/* squared distance of neighbouring pixels' positions */
	bool nothing;		/* no position: it is the sky */
};

static bool is_nothing(const float at[3])
{
	return at[0] == 0 && at[1] == 0 && at[2] == 0;
}

static float distance2(const float a[3], const float b[3])
{
	const float d0 = a[0] - b[0], d1 = a[1] - b[1], d2 = a[2] - b[2];

	return d0 * d0 + d1 * d1 + d2 * d2;
}

static void position(const struct gd_temporal_in *in, int x, int y, float at[3])
{
	for (int c = 0; c < 3; c++) {
		at[c] = gd_row(in->position[c], y)[x];
		if (!(fabsf(at[c]) < 1e18f))
			at[c] = 0;
	}
}

/* How far apart neighbouring pixels are, squared: across and down, the nearer of two each. */
static float footprint2(const struct gd_temporal_in *in, const struct work *k, int x, int y)
{
	static const int step[2][2] = { { 1, 0 }, { 0, 1 } };
	float at[3], other[3], sum = 0;

	position(in, x, y, at);
	for (int a = 0; a < 2; a++) {
		float least = FLT_MAX;

		for (int s = -1; s <= 1; s += 2) {
			const int x1 = x + s * step[a][0], y1 = y + s * step[a][1];

			if (x1 < 0 || y1 < 0 || x1 >= k->w || y1 >= k->h)
				continue;
			position(in, x1, y1, other);
			if (!is_nothing(other))
				least = fminf(least, distance2(at, other));
		}
		sum += least < FLT_MAX ? least : 0;
	}
	return fmaxf(sum, FLT_MIN);
}

/* Squared error of a pixel, mean of the channels; unknown: the spread of the pixels around. */
static float noise2(const struct gd_temporal_in *in, const struct work *k, int x, int y)
{
	double sum = 0, level = 0;

	for (int c = 0; c < 3; c++) {
		const double v = (double)gd_row(in->y[c], y)[x];

		level += v * v / 3;
		if (in->mse[c].v) {
			sum += (double)gd_row(in->mse[c], y)[x] / 3;
			continue;
		}
		for (int j = -1; j <= 1; j++)
			for (int i = -1; i <= 1; i++) {
				const int x1 = x + i < 0 ? 0 : x + i < k->w ? x + i : k->w - 1;
				const int y1 = y + j < 0 ? 0 : y + j < k->h ? y + j : k->h - 1;

				sum += pow((double)gd_row(in->y[c], y1)[x1] - v, 2) / 27;
			}
	}
	if (!(sum >= 0))
		sum = level;
	return (float)fmin(fmax(sum, 1e-8 * level), FLT_MAX / 1e6);
}

static struct here look(const struct gd_temporal_in *in, const struct work *k, int x, int y)
{
	struct here p = { .s2 = noise2(in, k, x, y), .size2 = footprint2(in, k, x, y) };

	for (int c = 0; c < 3; c++)
		p.y[c] = gd_row(in->y[c], y)[x];
	position(in, x, y, p.at);
	p.nothing = is_nothing(p.at);
	return p;
}

static float colour2(const float a[3], const float b[3])
{
	return distance2(a, b) / 3;
}

/*
 * The guess of the search window around (x, y) that fits best in position and colour, as an index;
 * both distances have a floor, so that none rules alone.
 */
static int search(const struct work *k, const struct here *p, int x, int y, int radius)
{
	const int x0 = x > radius ? x - radius : 0, x1 = x + radius < k->w ? x + radius : k->w - 1;
	const int y0 = y > radius ? y - radius : 0, y1 = y + radius < k->h ? y + radius : k->h - 1;
	const float far2 = (float)(same_place * same_place);
	float best = FLT_MAX;
	int at = NOWHERE;

	for (int j = y0; j <= y1; j++)
		for (int i = x0; i <= x1; i++) {
			const int o = j * k->w + i;
			const struct guess *g = &k->guess[o];
			const float screen2 = (float)((i - x) * (i - x) + (j - y) * (j - y));
			float d2, cost;

			if (g->frames < 1 || is_nothing(g->at) != p->nothing)
				continue;
			d2 = p->nothing ? screen2 : distance2(p->at, g->at) / p->size2;
			if (!(d2 <= far2))
				continue;
			cost = (d2 + 1e-3f * screen2 + 0.25f) * (colour2(p->y, g->v) + p->s2 + g->p[0]);
			if (cost < best) {
				best = cost;
				at = o;
			}
		}
	return at;
}

static void match(struct work *k, const struct gd_temporal_in *in, int radius)
{
#pragma omp parallel for schedule(dynamic, 4)
	for (int y = 0; y < k->h; y++)
		for (int x = 0; x < k->w; x++) {
			const size_t i = (size_t)y * (size_t)k->w + (size_t)x;
			const struct here p = look(in, k, x, y);

			k->match[i] = search(k, &p, x, y, radius);
			k->misfit[i] = k->match[i] < 0 ? 0 :
				       fminf(colour2(p.y, k->guess[k->match[i]].v), FLT_MAX / 1e6f);
		}
}

/* Means of the squared misfit over the 5x5 pixels around that have one. */
static void blur_misfit(struct work *k)
{
	memcpy(k->row, k->misfit, (size_t)k->w * (size_t)k->h * sizeof *k->row);
#pragma omp parallel for schedule(static)
	for (int y = 0; y < k->h; y++)
		for (int x = 0; x < k->w; x++) {
			double sum = 0;
			int n = 0;

			for (int j = y > 2 ? y - 2 : 0; j <= y + 2 && j < k->h; j++)
				for (int i = x > 2 ? x - 2 : 0; i <= x + 2 && i < k->w; i++) {
					const size_t o = (size_t)j * (size_t)k->w + (size_t)i;

					n += k->match[o] >= 0;
					sum += (double)k->row[o];
				}
			k->misfit[(size_t)y * (size_t)k->w + (size_t)x] = n ? (float)(sum / n) : 0;
		}
}

/* ---- the recursion ---- */

/* A model of one frame. */
static void start(struct guess *m, const struct here *p, bool paper)
{
	const double value2 = ((double)p->y[0] * (double)p->y[0] + (double)p->y[1] * (double)p->y[1] +
			       (double)p->y[2] * (double)p->y[2]) / 3;

	*m = (struct guess){ .frames = 1 };
	memcpy(m->v, p->y, sizeof m->v);
	m->p[0] = paper ? (float)(1 / (1 + paper_delta)) : p->s2;
	m->p[2] = paper ? (float)(1 / paper_delta) :
			  (float)fmin(slope_prior * slope_prior * value2, FLT_MAX / 1e6);
}

/*
 * Takes one frame of variance s2 into the model, in Joseph's form: a sum of squares stays one
 * whatever the rounding.
 */
static void update(struct guess *m, const struct here *p, double s2, double forget, double extra)
{
	double p00 = (double)m->p[0] / forget + extra, p01 = (double)m->p[1] / forget;
	double p11 = (double)m->p[2] / forget;
	const double sum = p00 + s2, g0 = sum > 0 ? p00 / sum : 1, g1 = sum > 0 ? p01 / sum : 0;
	const double most = cap * s2;

	for (int c = 0; c < 3; c++) {
		const double e = (double)p->y[c] - (double)m->v[c];

		m->v[c] = (float)((double)m->v[c] + g0 * e);
		m->slope[c] = (float)((double)m->slope[c] + g1 * e);
	}
	p11 += g1 * (g1 * sum - 2 * p01);
	p01 = (1 - g0) * (p01 - g1 * p00) + g0 * g1 * s2;
	p00 = (1 - g0) * (1 - g0) * p00 + g0 * g0 * s2;
	if (p00 + p11 > most && s2 > 0) {
		const double f = most / (p00 + p11);

		p00 *= f;
		p01 *= f;
		p11 *= f;
	}
	m->p[0] = (float)p00;
	m->p[1] = (float)p01;
	m->p[2] = (float)fmax(p11, 0);
	m->frames += 1;
}

/* What the misfit around shows of change beyond what errors explain; a variance. */
static double change(const struct guess *m, const struct here *p, double misfit, double forget)
{
	return fmax(0, misfit / doubt - (double)p->s2 - (double)m->p[0] / forget);
}

static void store(const struct gd_temporal_out *out, const struct gd_temporal_in *in,
		  const struct guess *m, const struct here *p, bool paper, int x, int y)
{
	const struct gd_plane *s = out->state.plane;
	const double unit = paper ? 1 : (double)p->s2;
	const double left = unit > 0 ? fmin((double)m->p[0] / unit, 1) : 1;

	for (int c = 0; c < 3; c++) {
		if (out->mse[c].v)
			gd_row(out->mse[c], y)[x] = in->mse[c].v ?
				(float)(left * (double)gd_row(in->mse[c], y)[x]) :
				(float)(left * (double)p->s2);
		gd_row(out->est[c], y)[x] = m->v[c];
		gd_row(s[GD_TEMPORAL_VALUE + c], y)[x] = m->v[c];
		gd_row(s[GD_TEMPORAL_SLOPE + c], y)[x] = m->slope[c];
		gd_row(s[GD_TEMPORAL_P + c], y)[x] = m->p[c];
		gd_row(s[GD_TEMPORAL_POSITION + c], y)[x] = p->at[c];
	}
	gd_row(s[GD_TEMPORAL_FRAMES], y)[x] = m->frames;
}

struct tally {
	size_t fresh, changed;
	double frames;
};

static void filter_row(const struct gd_temporal_out *out, const struct gd_temporal_in *in,
		       const struct work *k, const struct here *here, int y,
		       const struct gd_temporal_conf *conf, struct tally *tally)
{
	for (int x = 0; x < k->w; x++) {
		const size_t i = (size_t)y * (size_t)k->w + (size_t)x;
		const struct here *p = here + x;
		struct guess m;
		double extra = 0;

		if (k->match && k->match[i] >= 0) {
			m = k->guess[k->match[i]];
			if (!conf->paper)
				extra = change(&m, p, (double)k->misfit[i], conf->forget);
			update(&m, p, conf->paper ? 1 : (double)p->s2, conf->forget, extra);
		} else {
			start(&m, p, conf->paper);
		}
		tally->fresh += m.frames < 2;
		tally->changed += extra > 0;
		tally->frames += (double)m.frames;
		store(out, in, &m, p, conf->paper, x, y);
	}
}

/* A row is looked at as a whole before it is overwritten: results may go where the input is. */
static int filter(const struct gd_temporal_out *out, const struct gd_temporal_in *in,
		  const struct work *k, const struct gd_temporal_conf *conf,
		  struct gd_temporal_result *result, struct gd_err *err)
{
	struct here *here = gd_alloc((size_t)k->w * (size_t)k->h, sizeof *here);
	struct tally *tally = gd_calloc((size_t)k->h, sizeof *tally);
	const bool ok = here && tally;

	if (ok) {
#pragma omp parallel for schedule(static)
		for (int y = 0; y < k->h; y++)
			for (int x = 0; x < k->w; x++)
				here[(size_t)y * (size_t)k->w + (size_t)x] = look(in, k, x, y);
#pragma omp parallel for schedule(static)
		for (int y = 0; y < k->h; y++)
			filter_row(out, in, k, here + (size_t)y * (size_t)k->w, y, conf, tally + y);
		for (int y = 0; y < k->h; y++) {
			result->fresh += tally[y].fresh;
			result->changed += tally[y].changed;
			result->mean_frames += tally[y].frames / ((double)k->w * k->h);
		}
	}
	free(tally);
	free(here);
	return ok ? GD_OK : gd_fail(err, GD_ENOMEM, "out of memory");
}

/* ---- all of it ---- */

static int check(const struct gd_temporal_in *in, const struct gd_temporal_conf *conf,
		 struct gd_err *err)
{
	const struct gd_temporal_state *prev = in->previous;
	const int w = in->y[0].w, h = in->y[0].h;

	if (!(conf->forget >= 0.5 && conf->forget <= 1))
		return gd_fail(err, GD_EARG, "forgetting factor %g: expected 0.5 .. 1",
			       conf->forget);
	if (conf->radius < 0 || conf->radius > GD_TEMPORAL_RADIUS)
		return gd_fail(err, GD_EARG, "search radius %d: expected 0 .. %d", conf->radius,
			       GD_TEMPORAL_RADIUS);
	if (conf->reach < 0 || conf->reach > GD_TEMPORAL_REACH)
		return gd_fail(err, GD_EARG, "reach %d: expected 0 .. %d", conf->reach,
			       GD_TEMPORAL_REACH);
	for (int c = 0; c < 3; c++)
		if (in->y[c].w != w || in->y[c].h != h || in->position[c].w != w ||
		    in->position[c].h != h)
			return gd_fail(err, GD_ESHAPE, "positions and colour differ in size");
	for (int i = 0; prev && i < GD_TEMPORAL_PLANES; i++)
		if (prev->plane[i].w != w || prev->plane[i].h != h)
			return gd_fail(err, GD_ESHAPE, "%s is %dx%d, expected %dx%d", channel[i],
				       prev->plane[i].w, prev->plane[i].h, w, h);
	return GD_OK;
}

static int prepare(struct work *k, const struct gd_temporal_in *in, struct gd_err *err)
{
	const size_t n = (size_t)in->y[0].w * (size_t)in->y[0].h;

	k->w = in->y[0].w;
	k->h = in->y[0].h;
	if (!in->previous)
		return GD_OK;
	k->guess = gd_alloc(n, sizeof *k->guess);
	k->match = gd_alloc(n, sizeof *k->match);
	k->misfit = gd_alloc(n, sizeof *k->misfit);
	k->row = gd_alloc(n, sizeof *k->row);
	if (!k->guess || !k->match || !k->misfit || !k->row)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	return GD_OK;
}

int gd_temporal_run(const struct gd_temporal_out *out, const struct gd_temporal_in *in,
		    const struct gd_temporal_conf *conf, struct gd_temporal_result *result,
		    const struct gd_report *report, struct gd_err *err)
{
	struct work k = { 0 };
	int rc = check(in, conf, err);

	*result = (struct gd_temporal_result){ 0 };
	if (rc == GD_OK)
		rc = prepare(&k, in, err);
	if (rc == GD_OK && in->previous) {
		foretell(&k, in->previous);
		match(&k, in, conf->radius);
		blur_misfit(&k);
	}
	if (rc == GD_OK)
		rc = filter(out, in, &k, conf, result, err);
	if (rc == GD_OK)
		gd_note(report, "followed for %.1f frames on average; %zu pixels are new, the past "
			"counts less in %zu", result->mean_frames, result->fresh, result->changed);
	free(k.row);
	free(k.misfit);
	free(k.match);
	free(k.guess);
	return rc;
}
