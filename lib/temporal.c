/* SPDX-License-Identifier: BSD-3-Clause */
#include "temporal_impl.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>

/* Brighter pixels are cut to that; models beyond start anew: a change of light may take them up. */
static const float most = FLT_MAX / 1e4f;
static const double paper_delta = 1e-3;	/* 1 / first variance, of both coefficients */
static const double cap = 2e3;		/* most that variances may be, in those of one frame's */
static const double slope_prior = 0.003; /* of the colour, per frame: how light usually changes */

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

static bool sound(const struct gd_temporal_model *g)
{
	const double variances = (double)g->p[0] * (double)g->p[2];
	float sum = 0;

	for (int c = 0; c < 3; c++)
		sum += fabsf(g->v[c]) + fabsf(g->slope[c]) + fabsf(g->p[c]) + fabsf(g->at[c]);
	return sum < most && g->frames >= 1 && g->frames < FLT_MAX && g->p[0] >= 0 &&
	       g->p[2] >= 0 && fabs((double)g->p[1]) <= 1.01 * sqrt(variances);
}

/* One frame on: t is counted from the new one, so that value and slope mix. */
static void move_on(struct gd_temporal_model *g)
{
	for (int c = 0; c < 3; c++)
		g->v[c] += g->slope[c];
	g->p[0] += 2 * g->p[1] + g->p[2];
	g->p[1] += g->p[2];
	g->p[0] = fmaxf(g->p[0], 0);
}

static void foretell(struct gd_temporal_work *k, const struct gd_temporal_state *prev)
{
#pragma omp parallel for schedule(static)
	for (int y = 0; y < k->h; y++) {
		const float *row[GD_TEMPORAL_PLANES];

		for (int i = 0; i < GD_TEMPORAL_PLANES; i++)
			row[i] = gd_row(prev->plane[i], y);
		for (int x = 0; x < k->w; x++) {
			struct gd_temporal_model g;

			for (int c = 0; c < 3; c++) {
				g.v[c] = row[GD_TEMPORAL_VALUE + c][x];
				g.slope[c] = row[GD_TEMPORAL_SLOPE + c][x];
				g.p[c] = row[GD_TEMPORAL_P + c][x];
				g.at[c] = row[GD_TEMPORAL_POSITION + c][x];
			}
			g.frames = row[GD_TEMPORAL_FRAMES][x];
			if (sound(&g))
				move_on(&g);
			k->before[gd_temporal_index(k, x, y)] =
				sound(&g) ? g : (struct gd_temporal_model){ 0 };
		}
	}
}

/* ---- this frame ---- */

static float number(float v)
{
	return isnan(v) ? 0 : fminf(fmaxf(v, -most), most);
}

/* Squared error of a pixel, mean of the channels; unknown: the spread of the pixels around. */
static float noise2(const struct gd_temporal_in *in, const struct gd_temporal_work *k, int x, int y)
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
	return (float)fmin(fmax(sum, 1e-8 * level), (double)most);
}

static void look(struct gd_temporal_work *k, const struct gd_temporal_in *in)
{
#pragma omp parallel for schedule(static)
	for (int y = 0; y < k->h; y++)
		for (int x = 0; x < k->w; x++) {
			struct gd_temporal_here *p = k->here + gd_temporal_index(k, x, y);

			p->s2 = noise2(in, k, x, y);
			for (int c = 0; c < 3; c++)
				p->y[c] = number(gd_row(in->y[c], y)[x]);
		}
}

/* Hands every pixel the model that is its match. */
static void hand_on(struct gd_temporal_work *k)
{
#pragma omp parallel for schedule(static)
	for (int y = 0; y < k->h; y++)
		for (int x = 0; x < k->w; x++) {
			const size_t i = gd_temporal_index(k, x, y);

			k->model[i] = k->match[i] == GD_TEMPORAL_NOWHERE ?
				(struct gd_temporal_model){ 0 } : k->before[k->match[i]];
		}
}

/* ---- the recursion ---- */

/* A model of one frame: its colour, standing still as far as is known. */
static struct gd_temporal_model start(const struct gd_temporal_here *p, bool paper)
{
	struct gd_temporal_model m = { .v = { p->y[0], p->y[1], p->y[2] }, .frames = 1 };
	double value2 = 0;

	for (int c = 0; c < 3; c++)
		value2 += (double)p->y[c] * (double)p->y[c] / 3;
	m.p[0] = paper ? (float)(1 / (1 + paper_delta)) : p->s2;
	m.p[2] = paper ? (float)(1 / paper_delta) :
			 (float)fmin(slope_prior * slope_prior * value2, (double)most);
	return m;
}

/*
 * Takes a frame of variance s2 into the model; extra is added to the variance of the past. In
 * Joseph's form, sums of what cannot be negative: whatever the rounding, P stays a covariance.
 */
static void update(struct gd_temporal_model *m, const float y[3], double s2, double forget,
		   double extra)
{
	const double p00 = (double)m->p[0] / forget + extra, p01 = (double)m->p[1] / forget;
	const double p11 = (double)m->p[2] / forget, sum = p00 + s2;
	const double g0 = sum > 0 ? p00 / sum : 1, g1 = sum > 0 ? p01 / sum : 0;
	double q00 = (1 - g0) * (1 - g0) * p00 + g0 * g0 * s2;
	double q01 = (1 - g0) * (p01 - g1 * p00) + g0 * g1 * s2;
	double q11 = p11 - 2 * g1 * p01 + g1 * g1 * sum;
	double scale;

	for (int c = 0; c < 3; c++) {
		const double e = (double)y[c] - (double)m->v[c];

		m->v[c] = (float)((double)m->v[c] + g0 * e);
		m->slope[c] = (float)((double)m->slope[c] + g1 * e);
	}
	q11 = fmax(q11, q00 > 0 ? q01 * q01 / q00 : 0);
	scale = fmin(1, cap * s2 / fmax(q00 + q11, DBL_MIN));
	m->p[0] = (float)(q00 * scale);
	m->p[1] = (float)(q01 * scale);
	m->p[2] = (float)(q11 * scale);
	m->frames = fminf(m->frames + 1, 1e6f);
}

static void store(const struct gd_temporal_out *out, const struct gd_temporal_in *in,
		  const struct gd_temporal_model *m, const struct gd_temporal_here *p, double unit,
		  int x, int y)
{
	const struct gd_plane *s = out->state.plane;
	const double left = unit > 0 ? fmin((double)m->p[0] / unit, 1) : 1;

	for (int c = 0; c < 3; c++) {
		const double mse = in->mse[c].v ? (double)gd_row(in->mse[c], y)[x] : (double)p->s2;

		if (out->mse[c].v)
			gd_row(out->mse[c], y)[x] =
				mse >= 0 ? (float)fmin(left * mse, (double)most) : p->s2;
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
		       const struct gd_temporal_work *k, int y,
		       const struct gd_temporal_conf *conf, struct tally *tally)
{
	for (int x = 0; x < k->w; x++) {
		const size_t i = gd_temporal_index(k, x, y);
		const struct gd_temporal_here *p = k->here + i;
		const double s2 = conf->paper ? 1 : (double)p->s2;
		struct gd_temporal_model m = in->previous ? k->model[i] :
							    (struct gd_temporal_model){ 0 };
		const double change = m.frames > 0 && !conf->paper ? (double)k->change[i] : 0;

		if (m.frames > 0)
			update(&m, p->y, s2, conf->forget,
			       change * (s2 + (double)m.p[0] / conf->forget));
		else
			m = start(p, conf->paper);
		tally->fresh += m.frames < 2;
		tally->changed += change > 0;
		tally->frames += (double)m.frames;
		store(out, in, &m, p, s2, x, y);
	}
}

static int filter(const struct gd_temporal_out *out, const struct gd_temporal_in *in,
		  const struct gd_temporal_work *k, const struct gd_temporal_conf *conf,
		  struct gd_temporal_result *result, struct gd_err *err)
{
	struct tally *tally = gd_calloc((size_t)k->h, sizeof *tally);

	if (!tally)
		return gd_fail(err, GD_ENOMEM, "out of memory");
#pragma omp parallel for schedule(static)
	for (int y = 0; y < k->h; y++)
		filter_row(out, in, k, y, conf, tally + y);
	for (int y = 0; y < k->h; y++) {
		result->fresh += tally[y].fresh;
		result->changed += tally[y].changed;
		result->mean_frames += tally[y].frames / ((double)k->w * k->h);
	}
	free(tally);
	return GD_OK;
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

static int prepare(struct gd_temporal_work *k, const struct gd_temporal_in *in,
		   struct gd_err *err)
{
	const size_t n = (size_t)in->y[0].w * (size_t)in->y[0].h;

	k->w = in->y[0].w;
	k->h = in->y[0].h;
	k->here = gd_calloc(n, sizeof *k->here);
	if (in->previous) {
		k->before = gd_alloc(n, sizeof *k->before);
		k->model = gd_alloc(n, sizeof *k->model);
		k->match = gd_alloc(n, sizeof *k->match);
		k->change = gd_calloc(n, sizeof *k->change);
	}
	if (!k->here || (in->previous && (!k->before || !k->model || !k->match || !k->change)))
		return gd_fail(err, GD_ENOMEM, "out of memory");
	look(k, in);
	return gd_temporal_locate(k, in->position, err);
}

/* Finds every pixel's model, as it foretells this frame, and where it fails to. */
static int recall(struct gd_temporal_work *k, const struct gd_temporal_in *in,
		  const struct gd_temporal_conf *conf, struct gd_err *err)
{
	int rc;

	foretell(k, in->previous);
	rc = gd_temporal_match(k, conf, err);
	if (rc != GD_OK)
		return rc;
	hand_on(k);
	if (conf->paper)
		return GD_OK;
	rc = gd_temporal_light(k, err);
	return rc == GD_OK ? gd_temporal_change(k, conf->forget, err) : rc;
}

int gd_temporal_run(const struct gd_temporal_out *out, const struct gd_temporal_in *in,
		    const struct gd_temporal_conf *conf, struct gd_temporal_result *result,
		    const struct gd_report *report, struct gd_err *err)
{
	struct gd_temporal_work k = { 0 };
	int rc = check(in, conf, err);

	*result = (struct gd_temporal_result){ 0 };
	if (rc == GD_OK)
		rc = prepare(&k, in, err);
	if (rc == GD_OK && in->previous)
		rc = recall(&k, in, conf, err);
	if (rc == GD_OK)
		rc = filter(out, in, &k, conf, result, err);
	if (rc == GD_OK)
		gd_note(report, "followed for %.1f frames on average; %zu pixels are new, the past "
			"counts less in %zu", result->mean_frames, result->fresh, result->changed);
	free(k.change);
	free(k.match);
	free(k.model);
	free(k.before);
	free(k.here);
	return rc;
}
