/* SPDX-License-Identifier: BSD-3-Clause */
#include "render/render.h"

#include <omp.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "render/film.h"
#include "rng.h"

#define TILE 8			/* side of a tile in pixels */
#define REACH GD_PAIR_REACH	/* of edges, in pixels: what a tile sees beyond its side */
#define SEEN (TILE + 2 * REACH)
#define PLACES UINT64_MAX	/* stream of random numbers; those of pixels are y << 32 | x */
#define TILES_A_THREAD 128	/* so that waiting for the last tile costs less than 1 % */

struct job {
	gd_render_sample *sample;
	const void *user;
	const struct gd_scene *pinhole;	/* whose paths have their first vertices in common; or NULL */
	const struct gd_render_conf *conf;
	struct gd_plan plan;
	struct gd_film film;
	double round;			/* samples of one round */
	double start;
	uint32_t most;			/* samples that any pixel has in a round */
	uint32_t rounds;		/* done so far */
	double done;			/* samples in them */
	const struct gd_report *report;
};

/* A pixel of a tile, and what its samples in these rounds bring. */
struct seat {
	struct gd_path_in in;
	int slot[GD_PAIRS], edges;
	uint32_t first, n;		/* its samples: first .. first + n - 1 */
	double share;
	struct gd_visit visit;
};

/* What a thread has for the tile under way. */
struct tile {
	int x0, y0, side;
	struct seat seat[TILE * TILE];
	/* First vertices, of pixels from (x0 - REACH, y0 - REACH) on; beside each the sample whose
	 * position it is for, plus 1. */
	struct gd_vertex vertex[SEEN * SEEN];
	uint32_t known[SEEN * SEEN];
};

static double cpu_seconds(void)
{
	struct timespec t;

	clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
	return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* ---- what is asked for ---- */

static bool fits(struct gd_plane p, int w, int h)
{
	return !p.v || (p.w == w && p.h == h);
}

/* What a tile keeps of its neighbourhood reaches so far. */
static int check_reach(const struct gd_pairs *pairs, struct gd_err *err)
{
	for (int k = 0; k < GD_PAIRS; k++)
		for (size_t i = 0; i < (size_t)pairs->w * (size_t)pairs->h; i++)
			if (abs(pairs->dx[k][i]) > REACH || abs(pairs->dy[k][i]) > REACH)
				return gd_fail(err, GD_EARG, "pair%d is %d,%d at pixel %zu,%zu: "
					       "expected no more than %d", k, pairs->dx[k][i],
					       pairs->dy[k][i], i % (size_t)pairs->w,
					       i / (size_t)pairs->w, REACH);
	return GD_OK;
}

static int check_maps(const struct gd_plan *plan, struct gd_err *err)
{
	const struct gd_render_conf *c = plan->conf;

	if (!fits(c->counts, plan->w, plan->h) || !fits(c->shares, plan->w, plan->h))
		return gd_fail(err, GD_EARG, "a map of counts or shares is not %d x %d", plan->w,
			       plan->h);
	if (c->pairs && !(c->pairs->w == c->w && c->pairs->h == c->h) &&
	    !(c->pairs->w == plan->w && c->pairs->h == plan->h))
		return gd_fail(err, GD_EARG, "pairs of %d x %d pixels, expected %d x %d",
			       c->pairs->w, c->pairs->h, c->w, c->h);
	if (!(c->share >= 0 && c->share <= 1))
		return gd_fail(err, GD_EARG, "a share of %g: expected 0 to 1", c->share);
	for (int y = 0; y < plan->h && (c->counts.v || c->shares.v); y++)
		for (int x = 0; x < plan->w; x++) {
			const float n = c->counts.v ? gd_row(c->counts, y)[x] : 0;
			const double share = gd_plan_share(plan, x, y);

			if (!(n >= 0 && n <= GD_RENDER_SAMPLES) || n != floorf(n))
				return gd_fail(err, GD_EARG, "%g samples at (%d, %d): expected a "
					       "whole number, 0 to %d", (double)n,
					       x + c->crop.x0, y + c->crop.y0, GD_RENDER_SAMPLES);
			if (!(share >= 0 && share <= 1))
				return gd_fail(err, GD_EARG, "a share of %g at (%d, %d): expected "
					       "0 to 1", share, x + c->crop.x0, y + c->crop.y0);
		}
	return GD_OK;
}

static int check(const struct gd_plan *plan, struct gd_err *err)
{
	const struct gd_render_conf *c = plan->conf;
	const struct gd_box *b = &c->crop;

	if (c->w < 1 || c->h < 1 || b->x0 < 0 || b->y0 < 0 || b->x1 >= c->w || b->y1 >= c->h ||
	    plan->w < 1 || plan->h < 1)
		return gd_fail(err, GD_EARG, "a crop of (%d, %d) to (%d, %d) in %d x %d pixels",
			       b->x0, b->y0, b->x1, b->y1, c->w, c->h);
	if (c->bins && (c->bins < 2 || c->bins > GD_RENDER_BINS))
		return gd_fail(err, GD_EARG, "%d bins: expected 0, or 2 to %d", c->bins,
			       GD_RENDER_BINS);
	if (!c->counts.v && (c->spp > GD_RENDER_SAMPLES || c->spp < (c->seconds > 0 ? 0 : 1)))
		return gd_fail(err, GD_EARG, "%d samples a pixel: expected 1 to %d", c->spp,
			       GD_RENDER_SAMPLES);
	if (c->reuse && c->path.ambient > 0)	/* it would become part of the colour */
		return gd_fail(err, GD_EARG, "ambient light is for the gradients alone: the colour "
			       "cannot reuse their offset paths");
	if (c->pairs && check_reach(c->pairs, err) != GD_OK)
		return GD_EARG;
	return check_maps(plan, err);
}

double gd_render_bytes(const struct gd_render_conf *conf)
{
	const struct gd_plan plan = gd_plan(conf);
	const int layers = 1 + (conf->pairs ? GD_PAIRS : 2);

	/* tiles, film, and the image: means, variances and bins of colours, features, numbers */
	return omp_get_max_threads() * (double)sizeof(struct tile) +
	       gd_film_bytes(plan.w, plan.h, conf->bins, conf->reuse) +
	       (double)plan.h * (double)gd_stride(plan.w) * sizeof(float) *
		       (layers * (9 + 3 * conf->bins) + 2 * GD_FILM_G + 3);
}

/* Memory is granted before it is there; better to say now that it is not. */
static int check_memory(const struct gd_render_conf *conf, struct gd_err *err)
{
	const double need = gd_render_bytes(conf);
	const double have = (double)sysconf(_SC_PHYS_PAGES) * (double)sysconf(_SC_PAGESIZE);

	if (have > 0 && need > have)
		return gd_fail(err, GD_ENOMEM, "out of memory: %d x %d pixels with %d bins take "
			       "%.3g GB, the machine has %.3g (see --crop, --bins)",
			       conf->crop.x1 - conf->crop.x0 + 1, conf->crop.y1 - conf->crop.y0 + 1,
			       conf->bins, 1e-9 * need, 1e-9 * have);
	return GD_OK;
}

/* ---- rendering ---- */

/* Edges that are traced, as the path tracer wants them; their places in slot. */
static struct gd_path_in aim(const struct job *j, int x, int y, int slot[GD_PAIRS])
{
	struct gd_path_in in = { .w = j->conf->w, .h = j->conf->h,
				 .x = j->conf->crop.x0 + x, .y = j->conf->crop.y0 + y };
	struct gd_edge edge[GD_PAIRS];
	const int n = gd_plan_edges(&j->plan, x, y, edge);

	for (int k = 0; k < n; k++) {
		if (!(edge[k].r > 0))
			continue;
		in.dx[in.n] = edge[k].x;
		in.dy[in.n] = edge[k].y;
		in.r[in.n] = edge[k].r;
		slot[in.n++] = k;
	}
	return in;
}

/*
 * Where in its pixel sample i lies: at the same place in all pixels. In each bin they are points of
 * a lattice that fills the square evenly (multiples of 1/g and 1/g^2, g^3 = g + 1; Roberts 2018).
 * The seed shifts it at random, the even bins and the odd ones each by a shift of its own, as
 * halves must be independent; within a half multiples of sqrt(2) and sqrt(3) set the bins apart, so
 * that together they fill the square more evenly still.
 */
static void place(const struct gd_render_conf *conf, uint32_t i, float at[2])
{
	const struct gd_rng_key key = gd_rng_key(conf->seed, PLACES);
	const uint32_t bins = conf->bins > 1 ? (uint32_t)conf->bins : 1, b = i % bins, t = i / bins;
	/* multiples of 2^-32, modulo 1 */
	const uint32_t u = gd_rng_u32(key, b % 2, 0) + t * 3242174889u + b * 1779033704u;
	const uint32_t v = gd_rng_u32(key, b % 2, 1) + t * 2447445414u + b * 3144134277u;

	at[0] = (float)(u >> 8) * 0x1p-24f;
	at[1] = (float)(v >> 8) * 0x1p-24f;
}

/* The first vertex of a pixel for the position of sample i. */
static const struct gd_vertex *first_vertex(const struct job *j, struct tile *t, int x, int y,
					    const float at[2], uint32_t i)
{
	const int k = (y - t->y0 + REACH) * SEEN + x - t->x0 + REACH;
	const struct gd_render_conf *c = j->conf;

	if (t->known[k] != i + 1) {
		gd_path_first(j->pinhole, c->w, c->h, (float)(x + c->crop.x0) + at[0],
			      (float)(y + c->crop.y0) + at[1], &t->vertex[k]);
		t->known[k] = i + 1;
	}
	return &t->vertex[k];
}

/* Takes place at a pixel; the number of its samples in these rounds. */
static uint32_t sit(struct job *j, struct seat *seat, int x, int y, uint32_t rounds)
{
	const uint32_t each = gd_plan_samples(&j->plan, x, y);

	seat->first = each * j->rounds;
	seat->n = each * rounds;
	if (!seat->n)
		return 0;
	seat->in = aim(j, x, y, seat->slot);
	seat->edges = seat->in.n;
	seat->share = gd_plan_share(&j->plan, x, y);
	gd_visit_begin(&seat->visit, &j->film);
	return seat->n;
}

/* Sample s of a pixel. */
static void render_sample(struct job *j, struct tile *t, struct seat *seat, int x, int y,
			  uint32_t s, const float at[2])
{
	const uint32_t bins = j->conf->bins > 1 ? (uint32_t)j->conf->bins : 1, n = s / bins;
	struct gd_path_in *in = &seat->in;
	struct gd_draw draw = gd_draw_start(j->conf->seed, (uint32_t)in->x, (uint32_t)in->y, s);
	struct gd_path_out out;

	in->n = gd_plan_traced(seat->share, n + 1) > gd_plan_traced(seat->share, n) ?
		seat->edges : 0;
	in->at = at;
	if (j->pinhole) {
		in->first = first_vertex(j, t, x, y, at, s);
		for (int k = 0; k < in->n; k++)
			in->others[k] = first_vertex(j, t, x + in->dx[k], y + in->dy[k], at, s);
	}
	j->sample(j->user, &j->conf->path, in, &draw, &out);
	gd_visit_add(&seat->visit, &j->film, &out, in->n, seat->slot, (int)(s % bins));
}

/*
 * Samples of so many rounds at the pixels of a tile; their number. Position after position, at all
 * pixels that have it: offset paths then start where base paths of their pixels do.
 */
static unsigned long long render_tile(struct job *j, struct tile *t, uint32_t rounds)
{
	const int w = t->x0 + t->side > j->plan.w ? j->plan.w - t->x0 : t->side;
	const int h = t->y0 + t->side > j->plan.h ? j->plan.h - t->y0 : t->side;
	unsigned long long sum = 0;
	uint32_t begin = UINT32_MAX, end = 0;

	memset(t->known, 0, sizeof t->known);
	for (int k = 0; k < w * h; k++) {
		struct seat *seat = &t->seat[k];

		if (!sit(j, seat, t->x0 + k % w, t->y0 + k / w, rounds))
			continue;
		sum += seat->n;
		begin = seat->first < begin ? seat->first : begin;
		end = seat->first + seat->n > end ? seat->first + seat->n : end;
	}
	for (uint32_t i = begin; i < end; i++) {
		float at[2];

		place(j->conf, i, at);
		for (int k = 0; k < w * h; k++)
			if (i - t->seat[k].first < t->seat[k].n)
				render_sample(j, t, &t->seat[k], t->x0 + k % w, t->y0 + k / w, i,
					      at);
	}
	for (int k = 0; k < w * h; k++)
		if (t->seat[k].n)
			gd_film_store(&j->film, t->x0 + k % w, t->y0 + k / w, &t->seat[k].visit);
	return sum;
}

static void tell(const struct job *j, double samples, double all)
{
	const double time = j->conf->seconds > 0 ?
		(gd_seconds() - j->start) / j->conf->seconds : 0;

	gd_progress(j->report, "rendering", fmax(time, samples / fmax(all, 1)));
}

/* A side for tiles, such that there are enough of them for all threads. */
static int tile_side(const struct job *j)
{
	const double pixels = (double)j->plan.w * j->plan.h;
	int side = TILE;

	while (side > 1 && pixels / (side * side) < TILES_A_THREAD * (double)omp_get_max_threads())
		side /= 2;
	return side;
}

/* Tiles go to whoever is free. Each pixel is a computation of its own, in one thread. */
static void render_rounds(struct job *j, struct tile *tiles, uint32_t rounds, double all)
{
	const int side = tile_side(j);
	const int across = (j->plan.w + side - 1) / side, down = (j->plan.h + side - 1) / side;
	atomic_long next = 0;
	atomic_ullong samples = 0;

#pragma omp parallel
	{
		struct tile *t = &tiles[omp_get_thread_num()];
		long tile;

		while ((tile = atomic_fetch_add(&next, 1)) < (long)across * down) {
			unsigned long long n;

			t->x0 = (int)(tile % across) * side;
			t->y0 = (int)(tile / across) * side;
			t->side = side;
			n = render_tile(j, t, rounds);
			n += atomic_fetch_add(&samples, n);
			if (omp_get_thread_num() == 0)
				tell(j, j->done + (double)n, all);
		}
	}
	j->rounds += rounds;
	j->done += rounds * j->round;
}

/* Most rounds that counts can count. */
static uint32_t most_rounds(const struct job *j)
{
	if (!j->conf->counts.v && j->conf->spp > 0)
		return (uint32_t)j->conf->spp;
	return GD_RENDER_SAMPLES / (j->most ? j->most : 1);
}

/* Rounds while there is time; half of what the rest would take, so that the last is one of few. */
static void render_for_seconds(struct job *j, struct tile *tiles)
{
	const uint32_t most = most_rounds(j);
	uint32_t rounds = 1;

	while (rounds) {
		double spent, fit;

		render_rounds(j, tiles, rounds, most * j->round);
		spent = gd_seconds() - j->start;
		fit = (j->conf->seconds - spent) / spent * j->rounds;
		rounds = fit >= 2 ? (uint32_t)fmin(fit / 2, most) : fit >= 1;
		if (rounds > most - j->rounds)
			rounds = most - j->rounds;
	}
}

static void count_samples(struct job *j)
{
	for (int y = 0; y < j->plan.h; y++)
		for (int x = 0; x < j->plan.w; x++) {
			const uint32_t n = gd_plan_samples(&j->plan, x, y);

			j->round += n;
			j->most = n > j->most ? n : j->most;
		}
}

static int render(struct gd_image *im, struct job *j, struct gd_err *err)
{
	const struct gd_render_conf *conf = j->conf;
	const double cpu = cpu_seconds();
	struct tile *tiles = NULL;
	int rc = check(&j->plan, err);

	if (rc == GD_OK)
		rc = check_memory(conf, err);
	if (rc != GD_OK)
		return rc;
	rc = gd_film_begin(&j->film, j->plan.w, j->plan.h, conf->bins, conf->reuse, err);
	if (rc == GD_OK)
		rc = gd_film_channels(im, &j->plan, err);
	if (rc == GD_OK) {
		tiles = gd_alloc((size_t)omp_get_max_threads(), sizeof *tiles);
		if (!tiles)
			rc = gd_fail(err, GD_ENOMEM, "out of memory for tiles");
	}
	if (rc == GD_OK) {
		count_samples(j);
		if (conf->seconds > 0)
			render_for_seconds(j, tiles);
		else
			render_rounds(j, tiles, 1, j->round);
		gd_note(j->report, "%.6g samples, %.4g a second", j->done,
			j->done / fmax(gd_seconds() - j->start, 1e-9));
		rc = gd_film_develop(im, &j->film, &j->plan, err);
	}
	if (rc == GD_OK)
		rc = gd_attr_set_number(im, "gd:renderSeconds", cpu_seconds() - cpu, err);
	free(tiles);
	gd_film_free(&j->film);
	if (rc != GD_OK)
		gd_image_free(im);
	return rc;
}

int gd_render_samples(struct gd_image *im, gd_render_sample *sample, const void *user,
		      const struct gd_render_conf *conf, const struct gd_report *report,
		      struct gd_err *err)
{
	struct job j = { .sample = sample, .user = user, .conf = conf, .plan = gd_plan(conf),
			 .start = gd_seconds(), .report = report };

	return render(im, &j, err);
}

static void trace(const void *user, const struct gd_path_conf *conf, const struct gd_path_in *in,
		  struct gd_draw *draw, struct gd_path_out *out)
{
	gd_path_trace(user, conf, in, draw, out);
}

int gd_render(struct gd_image *im, const struct gd_scene *scene, const struct gd_render_conf *conf,
	      const struct gd_report *report, struct gd_err *err)
{
	struct job j = { .sample = trace, .user = scene, .conf = conf, .plan = gd_plan(conf),
			 .pinhole = scene->view.lens > 0 ? NULL : scene, .start = gd_seconds(),
			 .report = report };

	return render(im, &j, err);
}
