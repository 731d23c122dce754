/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * The image is cut into tiles of centres that fit, with the pixels around them, into the
 * second-level cache. A tile's centres predict the pixels of a frame around it, too: every tile
 * keeps its sums, frame included, and in a second pass each pixel adds up those of the tiles that
 * reach it, always in the same order. Here: scales, tiles, hygiene; the arithmetic is in
 * kernel/nlr_*.c.
 */
#include "nlr.h"

#include <float.h>
#include <math.h>
#include <omp.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "kernel/nlr_tile.h"

#define PITCH	GD_NLR_PITCH
#define BATCH	64		/* tiles between two progress reports */
#define GUIDE_LIMIT	5e5f	/* guides are cut here, in their standard deviations, so that
				 * three squared differences multiplied are no infinity */
#define VALUE_LIMIT	64	/* exponent of the largest y after scaling: slopes stay in range */
#define FIT_LIMIT	1e9f	/* fit weights are cut here, in units of their median */
#define FEATURE_LIMIT	1e3f

struct run {
	const struct gd_nlr_in *in;
	const struct gd_nlr_conf *conf;
	const struct gd_nlr_kernel *kernel;
	int w, h, tile_w, across, down;
	float guide_scale, y_scale[3], fit_scale;	/* square roots of powers of 4 */
	float noise;
	float *sums;		/* of all tiles: rows of 4 planes of tile_w + 2 window */
	size_t tile_size;	/* floats per tile in sums */
};

/* Counts of the binary exponents of the finite values that are not 0. */
static void exponents(struct gd_plane p, int64_t count[256])
{
	int64_t n[256] = { 0 };

#pragma omp parallel for schedule(static) reduction(+ : n[:256])
	for (int y = 0; y < p.h; y++) {
		const float *row = gd_row(p, y);

		for (int x = 0; x < p.w; x++) {
			uint32_t bits;

			memcpy(&bits, row + x, sizeof bits);
			n[bits >> 23 & 255]++;
		}
	}
	n[0] = n[255] = 0;
	memcpy(count, n, sizeof n);
}

/* Exponents of the median and the largest; 0 if there are none. */
static int middle(const int64_t count[256], int *largest)
{
	int64_t all = 0, below = 0;
	int e = 0;

	*largest = 0;
	for (int i = 0; i < 256; i++) {
		all += count[i];
		if (count[i])
			*largest = i - 127;
	}
	if (!all)
		return 0;
	while (below + count[e] <= all / 2)
		below += count[e++];
	return e - 127;
}

static float thousand_medians(const int64_t count[256])
{
	int largest, e = middle(count, &largest) + 10;

	return ldexpf(1.0f, e < 127 ? e : 127);
}

/* 2^e as the square of the float that comes back; e is made even. */
static float root_scale(int e)
{
	e = e > 124 ? 124 : e < -124 ? -124 : e;
	return ldexpf(1.0f, e >= 0 ? e / 2 : -(-e / 2));
}

/* Variance of the values of p cut to -cut .. cut; row has room for 2 h numbers. */
static double clipped_variance(struct gd_plane p, float cut, double *row)
{
	double sum = 0.0, square = 0.0, n = (double)p.w * p.h;

#pragma omp parallel for schedule(static)
	for (int y = 0; y < p.h; y++) {
		const float *from = gd_row(p, y);
		double s = 0.0, q = 0.0;

		for (int x = 0; x < p.w; x++) {
			float v = fabsf(from[x]) <= FLT_MAX ? from[x] : 0.0f;
			double d = v > cut ? cut : v < -cut ? -cut : v;

			s += d;
			q += d * d;
		}
		row[2 * y] = s;
		row[2 * y + 1] = q;
	}
	for (int y = 0; y < p.h; y++) {
		sum += row[2 * y];
		square += row[2 * y + 1];
	}
	return fmax(square / n - sum / n * (sum / n), 0.0);
}

static int scale_guide(struct run *r, struct gd_err *err)
{
	double *row = gd_alloc((size_t)r->h, 2 * sizeof *row), var = 0.0;
	int64_t count[256];
	int e = 0;

	if (!row)
		return gd_fail(err, GD_ENOMEM, "regression: out of memory");
	for (int c = 0; c < 3; c++) {
		exponents(r->in->guide[c], count);
		var += clipped_variance(r->in->guide[c], thousand_medians(count), row) / 3.0;
	}
	free(row);
	if (var > 0.0)
		e = -2 * (int)lrint(0.25 * log2(var));
	r->guide_scale = root_scale(e);
	r->noise =
		(float)(r->conf->eps * var * pow(r->guide_scale, 4.0) / (r->conf->k * r->conf->k));
	r->noise = fmaxf(r->noise, 1e-12f);
	return GD_OK;
}

static void scale_values(struct run *r)
{
	int64_t count[256];
	int e, largest;

	for (int c = 0; c < 3; c++) {
		exponents(r->in->y[c], count);
		e = -middle(count, &largest);
		r->y_scale[c] = root_scale(e + largest > VALUE_LIMIT ? VALUE_LIMIT - largest : e);
	}
	if (r->in->weight.v) {
		exponents(r->in->weight, count);
		r->fit_scale = root_scale(-middle(count, &largest));
	}
}

/* A thread's work space: the tile's arrays one after the other. */
static float *take(float **work, size_t rows, size_t above, size_t pitch, size_t left)
{
	float *first = *work + above * pitch + left;

	*work += (rows + 2 * above) * pitch;
	return first;
}

static struct gd_nlr_tile lay_out(const struct run *r, float *work, size_t *size)
{
	const struct gd_nlr_conf *conf = r->conf;
	const size_t f = (size_t)conf->patch, s = (size_t)conf->window, side = 2 * s + 1;
	struct gd_nlr_tile t = {
		.window = conf->window, .patch = conf->patch,
		.terms = r->in->nfeat + 1, .ncol = r->in->nfeat + 4 + (r->in->weight.v != NULL),
		.noise = r->noise, .far = (float)(GD_NLR_FAR * conf->k * conf->k),
		.scale = (float)(1.0 / (conf->k * conf->k)), .ridge = (float)conf->ridge,
	};
	float *at = work;

	t.guide = take(&at, 6 * GD_NLR_TILE_ROWS, 6 * (f + s), PITCH, GD_NLR_PAD);
	t.col = take(&at, (size_t)t.ncol * GD_NLR_TILE_ROWS, (size_t)t.ncol * s, PITCH, GD_NLR_PAD);
	t.sum = take(&at, 4 * GD_NLR_TILE_ROWS, 4 * s, PITCH, GD_NLR_PAD);
	t.weight = take(&at, side * side, 0, GD_NLR_WPITCH, GD_NLR_WPAD);
	t.fit = r->in->weight.v ? take(&at, side * side, 0, GD_NLR_WPITCH, GD_NLR_WPAD) : t.weight;
	t.slope = take(&at, 3 * (size_t)t.terms, 0, GD_NLR_WPITCH, GD_NLR_WPAD);
	t.ring = take(&at, side * side * (2 * f + 1), 0, GD_NLR_TILE_W, 0);
	t.share = take(&at, side, 0, GD_NLR_TILE_W, 0);
	*size = (size_t)(at - work) + 256;	/* vectors may read beyond the last row */
	return t;
}

/* Copies the part of a plane around the tile, 0 outside the image. The tile begins at x0, y0. */
static void load(const struct run *r, const struct gd_nlr_tile *t, float *to, ptrdiff_t step,
		 int halo, struct gd_plane from, float scale, float lo, float hi)
{
	const int left = -halo > t->left ? -halo : t->left;
	const int right = t->w + halo < t->right ? t->w + halo : t->right;

	for (int y = -halo; y < t->h + halo; y++) {
		float *row = to + y * step;

		memset(row - GD_NLR_PAD, 0, PITCH * sizeof *row);
		if (from.v && y >= t->top && y < t->bottom)
			r->kernel->load(row + left, gd_row(from, y - t->top) + left - t->left,
					right - left, scale, lo, hi);
	}
}

static void load_tile(const struct run *r, const struct gd_nlr_tile *t)
{
	const struct gd_nlr_in *in = r->in;
	const ptrdiff_t step = (ptrdiff_t)t->ncol * PITCH;
	float *guide = (float *)t->guide, *col = (float *)t->col;

	for (int c = 0; c < 3; c++) {
		load(r, t, guide + c * PITCH, 6 * PITCH, t->window + t->patch, in->guide[c],
		     r->guide_scale, -GUIDE_LIMIT, GUIDE_LIMIT);
		load(r, t, guide + (c + 3) * PITCH, 6 * PITCH, t->window + t->patch,
		     in->guide_var[c], r->guide_scale * r->guide_scale, 0.0f,
		     GUIDE_LIMIT * GUIDE_LIMIT);
	}
	for (int y = -t->window; y < t->h + t->window; y++)
		for (int x = -GD_NLR_PAD; x < PITCH - GD_NLR_PAD; x++)
			col[y * step + x] = 1.0f;
	for (int j = 0; j < in->nfeat; j++)
		load(r, t, col + (j + 1) * PITCH, step, t->window, in->feat[j], 1.0f,
		     -FEATURE_LIMIT, FEATURE_LIMIT);
	for (int c = 0; c < 3; c++)
		load(r, t, col + (t->terms + c) * PITCH, step, t->window, in->y[c], r->y_scale[c],
		     -FLT_MAX, FLT_MAX);
	if (in->weight.v)
		load(r, t, col + (t->terms + 3) * PITCH, step, t->window, in->weight, r->fit_scale,
		     0.0f, FIT_LIMIT);
}

/* Columns of the patch around x that lie in the image together with their partners, as a factor. */
static void fill_share(const struct gd_nlr_tile *t)
{
	for (int dx = -t->window; dx <= t->window; dx++)
		for (int x = 0; x < GD_NLR_TILE_W; x++) {
			int lo = t->left - (dx < 0 ? dx : 0), hi = t->right - (dx > 0 ? dx : 0);

			lo = lo > x - t->patch ? lo : x - t->patch;
			hi = hi < x + t->patch + 1 ? hi : x + t->patch + 1;
			t->share[(dx + t->window) * GD_NLR_TILE_W + x] =
				hi > lo ? t->scale / (float)(6 * (hi - lo)) : 0.0f;
		}
}

static void place(const struct run *r, struct gd_nlr_tile *t, int index)
{
	const int x0 = index % r->across * r->tile_w, y0 = index / r->across * GD_NLR_TILE_ROWS;

	t->w = r->w - x0 < r->tile_w ? r->w - x0 : r->tile_w;
	t->h = r->h - y0 < GD_NLR_TILE_ROWS ? r->h - y0 : GD_NLR_TILE_ROWS;
	t->left = -x0;
	t->right = r->w - x0;
	t->top = -y0;
	t->bottom = r->h - y0;
}

static void run_tile(const struct run *r, struct gd_nlr_tile *t, int index)
{
	const int reach = r->conf->window, wide = r->tile_w + 2 * reach;
	float *to = r->sums + r->tile_size * (size_t)index;

	place(r, t, index);
	load_tile(r, t);
	fill_share(t);
	r->kernel->tile(t);
	for (int y = -reach; y < t->h + reach; y++)
		for (int c = 0; c < 4; c++, to += wide)
			memcpy(to, t->sum + (y * (ptrdiff_t)4 + c) * PITCH - reach,
			       (size_t)(t->w + 2 * reach) * sizeof *to);
}

/* Adds to row y of tile `index` (4 planes) what tile (i, j) has for it. */
static void add_row(const struct run *r, float *sum, int index, int y, int i, int j)
{
	const int reach = r->conf->window, wide = r->tile_w + 2 * reach;
	const int here = index % r->across, image_y = index / r->across * GD_NLR_TILE_ROWS + y;
	const int row = image_y - (j * GD_NLR_TILE_ROWS - reach);
	const int rows = (r->h - j * GD_NLR_TILE_ROWS < GD_NLR_TILE_ROWS ?
			  r->h - j * GD_NLR_TILE_ROWS : GD_NLR_TILE_ROWS) + 2 * reach;
	const int from = (here - i) * r->tile_w + reach; /* of the tile's first pixel in (i, j) */
	const int last = r->w - i * r->tile_w < r->tile_w ? r->w - i * r->tile_w : r->tile_w;
	const int end = last + 2 * reach - from;
	const int x0 = from < 0 ? -from : 0, x1 = end < r->tile_w ? end : r->tile_w;

	if (row < 0 || row >= rows)
		return;
	for (int c = 0; c < 4; c++) {
		const float *p = r->sums + r->tile_size * (size_t)(j * r->across + i) +
				 (size_t)(row * 4 + c) * (size_t)wide;

		for (int x = x0; x < x1; x++)
			sum[c * GD_NLR_TILE_W + x] += p[from + x];
	}
}

static void finish_tile(const struct run *r, const struct gd_plane out[3], int index)
{
	const int i0 = index % r->across, j0 = index / r->across;
	struct gd_nlr_tile t = { 0 };
	float sum[4 * GD_NLR_TILE_W];

	place(r, &t, index);
	for (int y = 0; y < t.h; y++) {
		memset(sum, 0, sizeof sum);
		for (int j = j0 > 0 ? j0 - 1 : 0; j <= j0 + 1 && j < r->down; j++)
			for (int i = i0 > 0 ? i0 - 1 : 0; i <= i0 + 1 && i < r->across; i++)
				add_row(r, sum, index, y, i, j);
		for (int c = 0; c < 3; c++)
			r->kernel->finish(gd_row(out[c], y - t.top) - t.left,
					  sum + c * GD_NLR_TILE_W, sum + 3 * GD_NLR_TILE_W,
					  gd_row(r->in->y[c], y - t.top) - t.left, t.w,
					  1.0f / r->y_scale[c]);
	}
}

static int regress(struct run *r, const struct gd_plane out[3], const struct gd_report *report,
		   struct gd_err *err)
{
	const int tiles = r->across * r->down, threads = omp_get_max_threads();
	float *work = NULL;
	size_t size;
	int rc = GD_OK;

	lay_out(r, NULL, &size);
	size = (size + 15) / 16 * 16;
	r->sums = gd_alloc((size_t)tiles, r->tile_size * sizeof *r->sums);
	work = gd_calloc(size, (size_t)threads * sizeof *work);
	if (!r->sums || !work) {
		rc = gd_fail(err, GD_ENOMEM, "regression: no memory for %dx%d pixels", r->w, r->h);
		goto done;
	}
	for (int first = 0; first < tiles; first += BATCH) {
		const int end = tiles - first < BATCH ? tiles : first + BATCH;

		gd_progress(report, "regress", (double)first / tiles);
#pragma omp parallel num_threads(threads)
		{
			size_t unused;
			struct gd_nlr_tile t =
				lay_out(r, work + size * (size_t)omp_get_thread_num(), &unused);

#pragma omp for schedule(dynamic)
			for (int i = first; i < end; i++)
				run_tile(r, &t, i);
		}
	}
#pragma omp parallel for schedule(static)
	for (int i = 0; i < tiles; i++)
		finish_tile(r, out, i);
	gd_progress(report, "regress", 1.0);
done:
	free(work);
	free(r->sums);
	return rc;
}

static int check_planes(const char *what, const struct gd_plane *p, int n, int w, int h,
			bool may_lack, struct gd_err *err)
{
	return gd_planes_check("regression", what, p, n, w, h, may_lack, err);
}

static int check(const struct gd_plane out[3], const struct gd_nlr_in *in,
		 const struct gd_nlr_conf *conf, struct gd_err *err)
{
	const int w = in->y[0].w, h = in->y[0].h;
	int rc;

	if (conf->window < 0 || conf->window > GD_NLR_WINDOW || conf->patch < 0 ||
	    conf->patch > GD_NLR_PATCH)
		return gd_fail(err, GD_EARG,
			       "regression: window radius %d (0 to %d), patch radius %d (0 to %d)",
			       conf->window, GD_NLR_WINDOW, conf->patch, GD_NLR_PATCH);
	if (!(conf->k >= 0.01 && conf->k <= 100.0) || !(conf->eps >= 1e-10 && conf->eps <= 1.0) ||
	    !(conf->ridge >= 1e-6 && conf->ridge <= 1.0))
		return gd_fail(err, GD_EARG, "regression: k %g (0.01 to 100), eps %g (1e-10 to 1), "
			       "ridge %g (1e-6 to 1)", conf->k, conf->eps, conf->ridge);
	if (in->nfeat < 0 || in->nfeat > GD_NLR_FEATURES)
		return gd_fail(err, GD_EARG, "regression: %d features, expected 0 to %d", in->nfeat,
			       GD_NLR_FEATURES);
	if (w < 1 || h < 1)
		return gd_fail(err, GD_ESHAPE, "regression: image of %dx%d pixels", w, h);
	rc = check_planes("input", in->y, 3, w, h, false, err);
	if (rc == GD_OK)
		rc = check_planes("guide", in->guide, 3, w, h, false, err);
	if (rc == GD_OK)
		rc = check_planes("guide variance", in->guide_var, 3, w, h, true, err);
	if (rc == GD_OK)
		rc = check_planes("feature", in->feat, in->nfeat, w, h, false, err);
	if (rc == GD_OK)
		rc = check_planes("weight", &in->weight, 1, w, h, true, err);
	if (rc == GD_OK)
		rc = check_planes("output", out, 3, w, h, false, err);
	return rc;
}

int gd_nlr_run(const struct gd_plane out[3], const struct gd_nlr_in *in,
	       const struct gd_nlr_conf *conf, const struct gd_report *report, struct gd_err *err)
{
	struct run r = {
		.in = in, .conf = conf, .kernel = GD_PICK(gd_nlr_kernel), .fit_scale = 1.0f
	};
	int rc = check(out, in, conf, err);

	if (rc != GD_OK)
		return rc;
	r.w = in->y[0].w;
	r.h = in->y[0].h;
	r.across = (r.w + GD_NLR_TILE_W - 1) / GD_NLR_TILE_W;
	r.tile_w = ((r.w + r.across - 1) / r.across + 15) / 16 * 16;
	r.across = (r.w + r.tile_w - 1) / r.tile_w;
	r.down = (r.h + GD_NLR_TILE_ROWS - 1) / GD_NLR_TILE_ROWS;
	r.tile_size = 4 * (size_t)(r.tile_w + 2 * conf->window) *
		      (size_t)(GD_NLR_TILE_ROWS + 2 * conf->window);
	scale_values(&r);
	rc = scale_guide(&r, err);
	if (rc == GD_OK)
		rc = regress(&r, out, report, err);
	return rc;
}
