/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * The image is cut into tiles that fit, with the pixels around them, into the second-level cache;
 * there nlm_tile.c runs through all shifts of the window. Here: scales, tiles, hygiene.
 */
#include "nlm.h"

#include <float.h>
#include <math.h>
#include <omp.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "kernel/nlm_tile.h"

#define TILE_W 128
#define TILE_H 32
#define MAX_PATCH 16
#define MAX_WINDOW 32
#define NO_ROOM (-20)	/* 2^NO_ROOM leaves room for sums over 65 x 65 values */
#define BATCH 256	/* tiles between two reports of progress */
#define BUCKETS 65536
#define MAX_COUNTS 16	/* more threads would rather wait for the adding up */

/* How a plane goes into a tile: less an offset, multiplied by the two powers of two, then cut. */
struct scaling {
	float offset, by, by2, lo, hi;
};

struct run {
	const struct gd_nlm_job *job;
	const struct gd_nlm_frame *frame;
	int frames;			/* others */
	const struct gd_nlm_conf *conf;
	const struct gd_nlm_kernel *kernel;
	int w, h, across, down;		/* pixels; tiles */
	struct scaling guide[GD_NLM_PLANES], guide_var[GD_NLM_PLANES];
	float noise[GD_NLM_PLANES];	/* e / k^2 of the scaled guides */
	float negligible[GD_NLM_PLANES];	/* variance of a scaled guide, or -1 */
	size_t stride;			/* floats per row of a tile with what is around it */
};

/* Floats as integers of the same order. */
static uint32_t key_of(float x)
{
	uint32_t i;

	memcpy(&i, &x, sizeof i);
	return i ^ ((i >> 31) ? 0xffffffffu : 0x80000000u);
}

static float float_of(uint32_t key)
{
	uint32_t i = key ^ ((key >> 31) ? 0x80000000u : 0xffffffffu);
	float x;

	memcpy(&x, &i, sizeof x);
	return x;
}

/* Finds the bucket of rank *rank and makes the rank that inside the bucket. */
static uint32_t bucket_of(const uint32_t *count, uint64_t *rank)
{
	uint32_t b = 0;

	while (b < BUCKETS - 1 && *rank >= count[b])
		*rank -= count[b++];
	return b;
}

/* Counts of a thread: by the upper halves of keys, and by the lower ones below two of these. */
struct counts {
	uint32_t upper[BUCKETS], lower[2][BUCKETS];
};

/* Work space to judge a plane by: counts of each thread, sums of each row. */
struct judge {
	int threads;
	struct counts *count;
	double (*row)[3];
};

static void count_upper(struct gd_plane p, float skip, const struct judge *j)
{
#pragma omp parallel num_threads(j->threads)
	{
		uint32_t *count = j->count[omp_get_thread_num()].upper;

		memset(count, 0, BUCKETS * sizeof *count);
#pragma omp for schedule(static)
		for (int y = 0; y < p.h; y++) {
			const float *row = gd_row(p, y);

			for (int x = 0; x < p.w; x++)
				if (isfinite(row[x]) && row[x] != skip)
					count[key_of(row[x]) >> 16]++;
		}
	}
}

static void count_lower(struct gd_plane p, float skip, const uint32_t upper[2],
			const struct judge *j)
{
#pragma omp parallel num_threads(j->threads)
	{
		uint32_t(*count)[BUCKETS] = j->count[omp_get_thread_num()].lower;

		memset(count, 0, 2 * sizeof *count);
#pragma omp for schedule(static)
		for (int y = 0; y < p.h; y++) {
			const float *row = gd_row(p, y);

			for (int x = 0; x < p.w; x++) {
				uint32_t key = key_of(row[x]);

				for (int i = 0; i < 2; i++)
					if (key >> 16 == upper[i] && row[x] != skip)
						count[i][key & 0xffff]++;
			}
		}
	}
}

/* Adds the counts of the other threads to those of the first, from member at on; their number. */
static uint64_t gather(const struct judge *j, size_t at)
{
	uint32_t *sum = (uint32_t *)j->count + at;
	uint64_t n = 0;

	for (int i = 0; i < BUCKETS; i++) {
		for (int t = 1; t < j->threads; t++)
			sum[i] += ((uint32_t *)(j->count + t) + at)[i];
		n += sum[i];
	}
	return n;
}

/*
 * The values of p whose ranks are at 1 % and 99 % of all finite ones other than skip (NaN: none),
 * exactly, by counting twice 16 bits of the keys. Returns how many there are; 0: none.
 */
static uint64_t percentiles(struct gd_plane p, float skip, const struct judge *j, float edge[2])
{
	uint64_t rank[2], n;
	uint32_t upper[2];

	count_upper(p, skip, j);
	n = gather(j, 0);
	if (!n)
		return 0;
	rank[1] = n > 2 ? (uint64_t)(0.99 * (double)(n - 1)) : n - 1;
	rank[0] = n - 1 - rank[1];
	for (int i = 0; i < 2; i++)
		upper[i] = bucket_of(j->count->upper, &rank[i]);
	count_lower(p, skip, upper, j);
	for (int i = 0; i < 2; i++) {
		gather(j, (size_t)(i + 1) * BUCKETS);
		edge[i] = float_of(upper[i] << 16 | bucket_of(j->count->lower[i], &rank[i]));
	}
	return n;
}

/* Mean of the finite values of p, each first cut to lo .. hi; their variance in *var. */
static double moments(struct gd_plane p, double lo, double hi, const struct judge *j, double *var)
{
	double sum = 0.0, square = 0.0, n = 0.0, middle = 0.5 * (lo + hi);

#pragma omp parallel for schedule(static) num_threads(j->threads)
	for (int y = 0; y < p.h; y++) {
		const float *row = gd_row(p, y);
		double s = 0.0, q = 0.0, k = 0.0;

		for (int x = 0; x < p.w; x++) {
			double d = row[x];

			if (!isfinite(row[x]))
				continue;
			d = (d < lo ? lo : d > hi ? hi : d) - middle;
			s += d;
			q += d * d;
			k += 1.0;
		}
		j->row[y][0] = s;
		j->row[y][1] = q;
		j->row[y][2] = k;
	}
	for (int y = 0; y < p.h; y++) {
		sum += j->row[y][0];
		square += j->row[y][1];
		n += j->row[y][2];
	}
	if (n > 0.0) {
		sum /= n;
		square = fmax(square / n - sum * sum, 0.0);
	}
	*var = square;
	return n > 0.0 ? middle + sum : 0.0;
}

/*
 * Variance of the plane between its percentiles; where these coincide (most of the image black),
 * between those of the rest; where there is no rest, the mean of the noise variance. *middle lies
 * between the percentiles.
 */
static double spread(struct gd_plane p, struct gd_plane noise, const struct judge *j, float *middle)
{
	float edge[2] = { 0.0f, 0.0f };
	double var = 0.0;

	if (percentiles(p, NAN, j, edge) && edge[0] == edge[1])
		percentiles(p, edge[0], j, edge);
	*middle = 0.5f * edge[0] + 0.5f * edge[1];
	if (edge[0] < edge[1])
		moments(p, edge[0], edge[1], j, &var);
	if (var <= 0.0 && noise.v)
		return moments(noise, 0.0, FLT_MAX, j, &var);
	return var;
}

/* Multiplication by 2^e in two steps, each of which is a normal float. */
static struct scaling scaling_of(float offset, int e, float lo, float hi)
{
	return (struct scaling){ offset, ldexpf(1.0f, e / 2), ldexpf(1.0f, e - e / 2), lo, hi };
}

static void scale_guide(struct run *r, int c, const struct judge *j)
{
	float middle;
	double var = spread(r->job->guide[c], r->job->guide_var[c], j, &middle);
	int e = var > 0.0 ? -(int)lrint(0.5 * log2(var)) : 0;
	double unit = var > 0.0 ? ldexp(var, 2 * e) : 1.0;

	r->guide[c] = scaling_of(middle, e, -GD_NLM_LIMIT, GD_NLM_LIMIT);
	r->guide_var[c] = scaling_of(0.0f, 2 * e, 0.0f, GD_NLM_LIMIT * GD_NLM_LIMIT);
	r->negligible[c] = r->conf->negligible > 0.0 ? (float)(r->conf->negligible * unit) : -1.0f;
	r->noise[c] = (float)(r->conf->eps / (r->conf->k * r->conf->k) * unit);
	r->noise[c] = r->noise[c] > GD_NLM_NOISE ? r->noise[c] : GD_NLM_NOISE;
}

static int scale_guides(struct run *r, struct gd_err *err)
{
	struct judge j = { .threads = omp_get_max_threads() };
	int rc = GD_OK;

	j.threads = j.threads < MAX_COUNTS ? j.threads : MAX_COUNTS;
	j.count = gd_alloc((size_t)j.threads, sizeof *j.count);
	j.row = gd_alloc((size_t)r->h, sizeof *j.row);
	if (!j.count || !j.row)
		rc = gd_fail(err, GD_ENOMEM, "non-local means: out of memory");
	for (int c = 0; c < r->job->nguide && rc == GD_OK; c++)
		scale_guide(r, c, &j);
	free(j.row);
	free(j.count);
	return rc;
}

/* The median of the finite values around a pixel (of two: their mean), 0 if there are none. */
static float median_around(struct gd_plane p, int x, int y)
{
	float v[8];
	int n = 0;

	for (int j = y - 1; j <= y + 1; j++)
		for (int i = x - 1; i <= x + 1; i++) {
			if (i < 0 || j < 0 || i >= p.w || j >= p.h || !isfinite(gd_row(p, j)[i]))
				continue;

			float a = gd_row(p, j)[i];
			int at = n++;

			for (; at > 0 && v[at - 1] > a; at--)
				v[at] = v[at - 1];
			v[at] = a;
		}
	return n ? 0.5f * v[(n - 1) / 2] + 0.5f * v[n / 2] : 0.0f;
}

/* The largest variance (not NaN) around a pixel. */
static float largest_around(struct gd_plane p, int x, int y)
{
	float most = 0.0f;

	for (int j = y > 0 ? y - 1 : 0; j <= y + 1 && j < p.h; j++)
		for (int i = x > 0 ? x - 1 : 0; i <= x + 1 && i < p.w; i++)
			if (!(i == x && j == y) && gd_row(p, j)[i] > most)
				most = gd_row(p, j)[i];
	return most;
}

static float scaled(float x, const struct scaling *s)
{
	float y = (x - s->offset) * s->by * s->by2;

	y = y > s->lo ? y : s->lo;
	return y < s->hi ? y : s->hi;
}

/* A rectangle of pixels around the tile, and where it begins in the image. */
struct region {
	int x, y;			/* of the tile in the image */
	int x0, x1, y0, y1;		/* relative to the tile */
};

static struct region region_of(const struct gd_nlm_tile *t, int halo)
{
	struct region g = { -t->left, -t->top, -halo, t->w + halo, -halo, t->h + halo };

	g.x0 = g.x0 > t->left ? g.x0 : t->left;
	g.x1 = g.x1 < t->right ? g.x1 : t->right;
	g.y0 = g.y0 > t->top ? g.y0 : t->top;
	g.y1 = g.y1 < t->bottom ? g.y1 : t->bottom;
	return g;
}

static int load_plane(const struct run *r, const struct region *g, float *to, struct gd_plane from,
		      const struct scaling *s)
{
	int found = 0;

	for (int y = g->y0; y < g->y1; y++) {
		float *row = to + y * (ptrdiff_t)r->stride + g->x0;

		if (from.v)
			found |= r->kernel->load(row, gd_row(from, g->y + y) + g->x + g->x0,
						 g->x1 - g->x0, s->offset, s->by, s->by2, s->lo,
						 s->hi);
		else
			memset(row, 0, (size_t)(g->x1 - g->x0) * sizeof *row);
	}
	return found;
}

/* Replaces values that are not finite, and their variances, and variances that are NaN. */
static void mend(const struct run *r, const struct region *g, float *to, float *to_var,
		 struct gd_plane from, struct gd_plane var, const struct scaling *s,
		 const struct scaling *s_var)
{
	for (int y = g->y0; y < g->y1; y++)
		for (int x = g->x0; x < g->x1; x++) {
			ptrdiff_t at = y * (ptrdiff_t)r->stride + x;
			bool bad = !isfinite(gd_row(from, g->y + y)[g->x + x]);

			if (bad)
				to[at] = scaled(median_around(from, g->x + x, g->y + y), s);
			if (var.v && (bad || isnan(gd_row(var, g->y + y)[g->x + x])))
				to_var[at] = scaled(largest_around(var, g->x + x, g->y + y), s_var);
		}
}

static void load_guide(const struct run *r, const struct gd_nlm_tile *t, int c, float *to,
		       float *to_var, struct gd_plane from, struct gd_plane var)
{
	struct region g = region_of(t, t->patch + t->window);
	int found = load_plane(r, &g, to, from, &r->guide[c]) |
		    load_plane(r, &g, to_var, var, &r->guide_var[c]);

	if (found & GD_NLM_BAD)
		mend(r, &g, to, to_var, from, var, &r->guide[c], &r->guide_var[c]);
}

/* Values and variances multiplied by 2^e. Returns whether there were any without room for that. */
static bool load_input(const struct run *r, const struct gd_nlm_tile *t, float *to, float *to_var,
		       struct gd_plane from, struct gd_plane var, int e)
{
	const struct gd_plane none = { 0 };
	const struct scaling s = { 0.0f, ldexpf(1.0f, e), 1.0f, -FLT_MAX, FLT_MAX };
	const struct scaling s_var = { 0.0f, ldexpf(1.0f, e), 1.0f, 0.0f, ldexpf(FLT_MAX, e) };
	struct region g = region_of(t, t->window);
	int found = load_plane(r, &g, to, from, &s);

	if (to_var)
		found |= load_plane(r, &g, to_var, var, &s_var);
	if (found & GD_NLM_BAD)
		mend(r, &g, to, to_var, from, to_var ? var : none, &s, &s_var);
	return found & GD_NLM_HUGE;
}

/* The frame itself. e[c]: the power of two by which plane c is multiplied for want of room. */
static void load_frame(const struct run *r, const struct gd_nlm_tile *t, int *e)
{
	const struct gd_nlm_job *job = r->job;

	for (int c = 0; c < t->nguide; c++)
		load_guide(r, t, c, t->guide[c], t->guide_var[c], job->guide[c],
			   job->guide_var[c]);
	for (int c = 0; c < t->n; c++) {
		const struct gd_plane var = job->in_var ? job->in_var[c] : (struct gd_plane){ 0 };

		e[c] = r->frames ? NO_ROOM : 0;
		while (load_input(r, t, t->in[c], t->in_var[c], job->in[c], var, e[c]) && !e[c])
			e[c] = NO_ROOM;
	}
}

static void load_other(const struct run *r, const struct gd_nlm_tile *t, int i, const int *e)
{
	const struct gd_nlm_frame *f = &r->frame[i];
	const struct scaling as_is = { 0.0f, 1.0f, 1.0f, 0.0f, 1.0f };
	const struct region g = region_of(t, t->window);

	load_plane(r, &g, t->known, f->known, &as_is);
	for (int c = 0; c < t->nguide; c++)
		load_guide(r, t, c, t->other[c], t->other_var[c], f->guide[c], f->guide_var[c]);
	for (int c = 0; c < t->n; c++)
		load_input(r, t, t->from[c], t->from_var[c], f->in[c],
			   f->in_var ? f->in_var[c] : (struct gd_plane){ 0 }, e[c]);
}

/*
 * Floats on either side of a tile's rows: what patches and shifts reach, and a vector more, since
 * distances are computed for whole vectors. They hold finite numbers from the start.
 */
static size_t margin(const struct gd_nlm_conf *conf)
{
	return (size_t)(conf->patch + conf->window + 8 + 15) / 16 * 16;
}

/* Rows of floats that lay_out() hands out. */
static size_t work_rows(const struct run *r)
{
	const size_t f = (size_t)r->conf->patch, reach = (size_t)r->conf->window;
	const size_t inputs = (size_t)r->job->n * (r->job->out_var ? 2 : 1);
	const size_t loaded = 2 * (size_t)r->job->nguide * (TILE_H + 2 * (f + reach)) +
			      inputs * (TILE_H + 2 * reach);

	return loaded + (r->frames ? loaded + TILE_H + 2 * reach : 0) + (inputs + 2) * TILE_H + 1 +
	       GD_NLM_GROUP * (2 * f + 3);
}

/* The next rows of the work space; the pointer is that of the first pixel below the rows above. */
static float *rows_of(const struct run *r, float **work, size_t rows, size_t above)
{
	float *first = *work + above * r->stride + margin(r->conf);

	*work += (rows + 2 * above) * r->stride;
	return first;
}

static bool wants_variance(const struct gd_nlm_job *job, int c)
{
	return job->out_var && job->out_var[c].v;
}

/* Room for what is loaded of one frame. */
static void lay_out_frame(const struct run *r, float **work, float **guide, float **guide_var,
			  float **in, float **in_var)
{
	const size_t f = (size_t)r->conf->patch, reach = (size_t)r->conf->window;

	for (int c = 0; c < r->job->nguide; c++) {
		guide[c] = rows_of(r, work, TILE_H, f + reach);
		guide_var[c] = rows_of(r, work, TILE_H, f + reach);
	}
	for (int c = 0; c < r->job->n; c++) {
		in[c] = rows_of(r, work, TILE_H, reach);
		if (wants_variance(r->job, c))
			in_var[c] = rows_of(r, work, TILE_H, reach);
	}
}

/* Lays the tile's arrays out in a thread's work space. */
static void lay_out(const struct run *r, struct gd_nlm_tile *t, float *work)
{
	lay_out_frame(r, &work, t->guide, t->guide_var, t->in, t->in_var);
	if (r->frames) {
		lay_out_frame(r, &work, t->other, t->other_var, t->from, t->from_var);
		t->known = rows_of(r, &work, TILE_H, (size_t)r->conf->window);
	}
	for (int c = 0; c < r->job->n; c++) {
		t->sum[c] = rows_of(r, &work, TILE_H, 0);
		if (wants_variance(r->job, c))
			t->sum_var[c] = rows_of(r, &work, TILE_H, 0);
	}
	t->sum_weight = rows_of(r, &work, TILE_H, 0);
	t->noisy = rows_of(r, &work, TILE_H, 0);
	t->dist = rows_of(r, &work, 1, 0);
	t->ring = rows_of(r, &work, GD_NLM_GROUP * (2 * (size_t)r->conf->patch + 1), 0);
	t->weight = rows_of(r, &work, GD_NLM_GROUP, 0);
	t->share = rows_of(r, &work, GD_NLM_GROUP, 0);
}

/* All shifts of a window, which is a square or a disc. */
static void sum_window(const struct run *r, const struct gd_nlm_tile *t, int window)
{
	for (int dy = -window; dy <= window; dy++) {
		int dx = window;

		while (r->conf->round && dx > 0 && dx * dx + dy * dy > window * window + 1)
			dx--;
		r->kernel->sums(t, dy, dx);
	}
}

/* The window in the frame itself, then in the others. */
static void sum_up(const struct run *r, const struct gd_nlm_tile *t, const int *e)
{
	struct gd_nlm_tile own = *t, frame = *t;

	memcpy(own.other, t->guide, sizeof own.other);
	memcpy(own.other_var, t->guide_var, sizeof own.other_var);
	memcpy(own.from, t->in, sizeof own.from);
	memcpy(own.from_var, t->in_var, sizeof own.from_var);
	own.known = NULL;
	r->kernel->clear(t);
	sum_window(r, &own, r->conf->window);
	for (int i = 0; i < r->frames; i++) {
		load_other(r, t, i, e);
		frame.known = r->frame[i].known.v ? t->known : NULL;
		sum_window(r, &frame, r->frame[i].window);
	}
}

static void filter_tile(const struct run *r, struct gd_nlm_tile *t, int index)
{
	const int x0 = index % r->across * TILE_W, y0 = index / r->across * TILE_H;
	int e[GD_NLM_PLANES];

	t->w = r->w - x0 < TILE_W ? r->w - x0 : TILE_W;
	t->h = r->h - y0 < TILE_H ? r->h - y0 : TILE_H;
	t->left = -x0;
	t->right = r->w - x0;
	t->top = -y0;
	t->bottom = r->h - y0;
	load_frame(r, t, e);
	if (r->kernel->mark(t, r->negligible))
		sum_up(r, t, e);
	for (int c = 0; c < t->n; c++)
		for (int y = 0; y < t->h; y++) {
			float scale = ldexpf(1.0f, -e[c]);

			r->kernel->mean(t, c, y, scale, gd_row(r->job->out[c], y0 + y) + x0);
			if (t->in_var[c])
				r->kernel->mean_var(t, c, y, scale,
						    gd_row(r->job->out_var[c], y0 + y) + x0);
		}
}

static struct gd_nlm_tile tile_of(const struct run *r)
{
	struct gd_nlm_tile t = { .patch = r->conf->patch, .window = r->conf->window,
				 .nguide = r->job->nguide, .n = r->job->n, .stride = r->stride,
				 .scale = (float)(1.0 / (r->conf->k * r->conf->k)),
				 .far = (float)(GD_NLM_FAR * r->conf->k * r->conf->k) };

	memcpy(t.noise, r->noise, sizeof t.noise);
	return t;
}

static int filter(const struct run *r, const struct gd_report *report, struct gd_err *err)
{
	const int tiles = r->across * r->down, threads = omp_get_max_threads();
	const size_t need = work_rows(r) * r->stride;
	float *work = gd_calloc(need, (size_t)threads * sizeof *work);

	if (!work)
		return gd_fail(err, GD_ENOMEM, "non-local means: no memory for %d threads",
			       threads);
	for (int first = 0; first < tiles; first += BATCH) {
		const int end = tiles - first < BATCH ? tiles : first + BATCH;

		gd_progress(report, "filter", (double)first / tiles);
#pragma omp parallel num_threads(threads)
		{
			struct gd_nlm_tile t = tile_of(r);
			uint32_t chunks[2 * TILE_H + 2 * MAX_PATCH];

			t.active = chunks;
			t.needed = chunks + TILE_H + t.patch;
			lay_out(r, &t, work + need * (size_t)omp_get_thread_num());
#pragma omp for schedule(dynamic)
			for (int i = first; i < end; i++)
				filter_tile(r, &t, i);
		}
	}
	gd_progress(report, "filter", 1.0);
	free(work);
	return GD_OK;
}

static int check_planes(const char *what, const struct gd_plane *p, int n, int w, int h,
			bool may_lack, struct gd_err *err)
{
	return gd_planes_check("non-local means", what, p, n, w, h, may_lack, err);
}

static int check_frame(const struct gd_nlm_job *job, const struct gd_nlm_frame *f, int w, int h,
		       struct gd_err *err)
{
	int rc = check_planes("guide", f->guide, job->nguide, w, h, false, err);

	if (rc == GD_OK)
		rc = check_planes("guide variance", f->guide_var, job->nguide, w, h, true, err);
	if (rc == GD_OK)
		rc = check_planes("input", f->in, job->n, w, h, false, err);
	if (rc == GD_OK)
		rc = check_planes("weight", &f->known, 1, w, h, true, err);
	if (rc == GD_OK && job->out_var)
		rc = check_planes("input variance", f->in_var, job->n, w, h, true, err);
	return rc;
}

static int check(const struct gd_nlm_job *job, const struct gd_nlm_conf *conf, struct gd_err *err)
{
	const struct gd_nlm_frame own = { job->guide, job->guide_var, job->in,
					  job->in_var, { 0 }, 0 };
	int w, h, rc;

	if (job->nguide < 1 || job->nguide > GD_NLM_PLANES || job->n < 1 || job->n > GD_NLM_PLANES)
		return gd_fail(err, GD_EARG,
			       "non-local means: %d guides and %d inputs, expected 1 to %d",
			       job->nguide, job->n, GD_NLM_PLANES);
	if (conf->patch < 0 || conf->patch > MAX_PATCH || conf->window < 0 ||
	    conf->window > MAX_WINDOW)
		return gd_fail(err, GD_EARG,
			       "non-local means: patch radius %d (0 to %d), window %d (0 to %d)",
			       conf->patch, MAX_PATCH, conf->window, MAX_WINDOW);
	if (!(conf->k >= 0.01 && conf->k <= 100.0) || !(conf->eps >= 1e-12 && conf->eps <= 1.0))
		return gd_fail(err, GD_EARG,
			       "non-local means: k %g (0.01 to 100), eps %g (1e-12 to 1)", conf->k,
			       conf->eps);
	if (!(conf->negligible >= 0.0 && conf->negligible <= 1.0))
		return gd_fail(err, GD_EARG, "non-local means: negligible noise %g (0 to 1)",
			       conf->negligible);
	w = job->guide[0].w;
	h = job->guide[0].h;
	if (w < 1 || h < 1)
		return gd_fail(err, GD_ESHAPE, "non-local means: image of %dx%d pixels", w, h);
	rc = check_frame(job, &own, w, h, err);
	if (rc == GD_OK)
		rc = check_planes("output", job->out, job->n, w, h, false, err);
	if (rc == GD_OK && job->out_var)
		rc = check_planes("output variance", job->out_var, job->n, w, h, true, err);
	return rc;
}

int gd_nlm_run(const struct gd_nlm_job *job, const struct gd_nlm_conf *conf,
	       const struct gd_report *report, struct gd_err *err)
{
	return gd_nlm_frames(job, NULL, 0, conf, report, err);
}

int gd_nlm_frames(const struct gd_nlm_job *job, const struct gd_nlm_frame *frame, int frames,
		  const struct gd_nlm_conf *conf, const struct gd_report *report,
		  struct gd_err *err)
{
	struct run r = { .job = job, .frame = frame, .frames = frames, .conf = conf,
			 .kernel = GD_PICK(gd_nlm_kernel) };
	int rc = check(job, conf, err);

	if (rc != GD_OK)
		return rc;
	if (frames < 0 || frames > GD_NLM_FRAMES)
		return gd_fail(err, GD_EARG, "non-local means: %d other frames, expected 0 to %d",
			       frames, GD_NLM_FRAMES);
	r.w = job->guide[0].w;
	r.h = job->guide[0].h;
	for (int i = 0; i < frames && rc == GD_OK; i++) {
		rc = check_frame(job, &frame[i], r.w, r.h, err);
		if (rc == GD_OK && (frame[i].window < 0 || frame[i].window > conf->window))
			rc = gd_fail(err, GD_EARG,
				     "non-local means: window %d of a frame (0 to %d)",
				     frame[i].window, conf->window);
	}
	if (rc != GD_OK)
		return rc;
	r.across = (r.w + TILE_W - 1) / TILE_W;
	r.down = (r.h + TILE_H - 1) / TILE_H;
	r.stride = TILE_W + 2 * margin(conf);
	rc = scale_guides(&r, err);
	if (rc == GD_OK)
		rc = filter(&r, report, err);
	return rc;
}
