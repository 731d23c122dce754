/* SPDX-License-Identifier: BSD-3-Clause */
#include "relmse.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "select.h"

static const struct form {
	const char *name, *plain, *halves;
} forms[GD_REL_FORMS] = {
	[GD_REL_R2_EPS] = { "r2+eps", "(x - r)^2 / (r^2 + eps)", "(x - a)(x - b) / (r^2 + eps)" },
	[GD_REL_R_EPS_2] = { "(r+eps)2", "(x - r)^2 / (|r| + eps)^2",
			     "(x - a)(x - b) / (|r| + eps)^2" },
	[GD_REL_LUM] = { "lum", "(x - r)^2 / (Y(r)^2 + eps), Y = 0.2126 R + 0.7152 G + 0.0722 B",
			 "(x - a)(x - b) / (Y(r)^2 + eps), Y = 0.2126 R + 0.7152 G + 0.0722 B" },
	[GD_REL_MEAN] = { "mean", "(x - r)^2 / (m(r)^2 + eps), m = mean over channels",
			  "(x - a)(x - b) / (m(r)^2 + eps), m = mean over channels" },
	[GD_REL_HALF] = { "half", "0.5 (x - r)^2 / (r^2 + eps)",
			  "0.5 (x - a)(x - b) / (r^2 + eps)" },
};

const char *gd_relmse_form_name(enum gd_relmse_form form)
{
	return forms[form].name;
}

bool gd_relmse_form_find(const char *name, enum gd_relmse_form *form)
{
	for (int i = 0; i < GD_REL_FORMS; i++)
		if (!strcmp(name, forms[i].name)) {
			*form = (enum gd_relmse_form)i;
			return true;
		}
	return false;
}

const char *gd_relmse_formula(enum gd_relmse_form form, bool halves)
{
	return halves ? forms[form].halves : forms[form].plain;
}

/* Pointers to row y of everything that is compared. */
struct rows {
	int n;
	bool halves;
	const float *x[GD_LAYER_PLANES], *r[GD_LAYER_PLANES];
	const float *a[GD_LAYER_PLANES], *b[GD_LAYER_PLANES];
	const float *mask;
};

static struct rows rows_at(const struct gd_relmse_in *in, int y)
{
	struct rows at = { .n = in->n, .halves = in->halves };

	for (int c = 0; c < in->n; c++) {
		at.x[c] = gd_row(in->x[c], y);
		if (in->halves) {
			at.a[c] = gd_row(in->a[c], y);
			at.b[c] = gd_row(in->b[c], y);
		} else {
			at.r[c] = gd_row(in->r[c], y);
		}
	}
	at.mask = in->mask.v ? gd_row(in->mask, y) : NULL;
	return at;
}

/* One pixel: values, reference, squared errors. */
struct pixel {
	double x[GD_LAYER_PLANES], r[GD_LAYER_PLANES], square[GD_LAYER_PLANES];
	bool nonfinite;
};

enum verdict { COMPARED, MASKED, NO_REFERENCE };

static enum verdict pixel_at(struct pixel *p, const struct rows *at, int i)
{
	if (at->mask && !(at->mask[i] >= 0.5f))
		return MASKED;
	p->nonfinite = false;
	for (int c = 0; c < at->n; c++) {
		double x = at->x[c][i];
		double a = at->halves ? at->a[c][i] : at->r[c][i];
		double b = at->halves ? at->b[c][i] : a;

		if (!isfinite(a) || !isfinite(b))
			return NO_REFERENCE;
		if (!isfinite(x)) {
			p->nonfinite = true;
			x = 0;
		}
		p->x[c] = x;
		p->r[c] = at->halves ? 0.5 * (a + b) : a;
		p->square[c] = (x - a) * (x - b);
	}
	return COMPARED;
}

/* The number that stands for the whole pixel in the divisors of some forms. */
static double grey(const struct pixel *p, int n, enum gd_relmse_form form)
{
	double sum = 0;

	if (form == GD_REL_LUM && n == 3)
		return 0.2126 * p->r[0] + 0.7152 * p->r[1] + 0.0722 * p->r[2];
	for (int c = 0; c < n; c++)
		sum += p->r[c];
	return sum / n;
}

static double divisor(const struct pixel *p, int c, double g, const struct gd_relmse_conf *conf)
{
	double r = p->r[c], s = fabs(r) + conf->eps;

	switch (conf->form) {
	case GD_REL_R_EPS_2:
		return s * s;
	case GD_REL_LUM:
	case GD_REL_MEAN:
		return g * g + conf->eps;
	case GD_REL_HALF:
		return 2 * (r * r + conf->eps);
	default:
		return r * r + conf->eps;
	}
}

/* Sums over the pixels of a row, added up in row order. */
struct sums {
	double e, channel[GD_LAYER_PLANES], square, abs, mape, smape, x, r;
	size_t pixels, nonfinite, nonfinite_reference;
};

static double add_pixel(struct sums *s, const struct pixel *p, int n,
			const struct gd_relmse_conf *conf)
{
	double g = grey(p, n, conf->form), e = 0;

	for (int c = 0; c < n; c++) {
		double x = p->x[c], r = p->r[c], d = fabs(x - r);
		double rel = p->square[c] / divisor(p, c, g, conf);

		e += rel;
		s->channel[c] += rel;
		s->square += p->square[c];
		s->abs += d;
		s->mape += d / (fabs(r) + conf->eps);
		s->smape += d / (fabs(x) + fabs(r) + conf->eps);
		s->x += x;
		s->r += r;
	}
	e /= n;
	s->e += e;
	s->pixels++;
	s->nonfinite += p->nonfinite;
	return e;
}

static void sum_row(struct sums *s, double *e, const struct rows *at, int w,
		    const struct gd_relmse_conf *conf)
{
	struct pixel p;

	memset(s, 0, sizeof(*s));
	for (int i = 0; i < w; i++) {
		enum verdict v = pixel_at(&p, at, i);

		e[i] = v == COMPARED ? add_pixel(s, &p, at->n, conf) : (double)NAN;
		s->nonfinite_reference += v == NO_REFERENCE;
	}
}

static void add_sums(struct sums *to, const struct sums *s)
{
	to->e += s->e;
	for (int c = 0; c < GD_LAYER_PLANES; c++)
		to->channel[c] += s->channel[c];
	to->square += s->square;
	to->abs += s->abs;
	to->mape += s->mape;
	to->smape += s->smape;
	to->x += s->x;
	to->r += s->r;
	to->pixels += s->pixels;
	to->nonfinite += s->nonfinite;
	to->nonfinite_reference += s->nonfinite_reference;
}

/*
 * Percentiles and trimmed mean of the n values in v (reordered). The trimmed sum runs over e in
 * pixel order, so that it does not depend on how v was reordered; of values equal to the bound, as
 * many are kept as the count asks for.
 */
static void order_statistics(struct gd_relmse *res, double *v, size_t n, const double *e, size_t ne,
			     double trim)
{
	size_t keep = n - (size_t)(trim * (double)n), below = 0;
	double bound, sum = 0;

	res->p50 = gd_select(v, 0, n, gd_quantile_index(0.50, n));
	res->p95 = gd_select(v, gd_quantile_index(0.50, n), n, gd_quantile_index(0.95, n));
	res->p99 = gd_select(v, gd_quantile_index(0.95, n), n, gd_quantile_index(0.99, n));
	res->max = gd_select(v, gd_quantile_index(0.99, n), n, n - 1);
	bound = gd_select(v, 0, n, keep - 1);
	for (size_t i = 0; i < ne; i++)
		if (e[i] < bound) {
			sum += e[i];
			below++;
		}
	sum += (double)(keep - below) * bound;
	res->trimmed = sum / (double)keep;
	res->ntrimmed = n - keep;
}

static bool same_size(struct gd_plane p, struct gd_plane q)
{
	return p.v && p.w == q.w && p.h == q.h;
}

static int check(const struct gd_relmse_in *in, struct gd_err *err)
{
	if (in->n < 1 || in->n > GD_LAYER_PLANES)
		return gd_fail(err, GD_ESHAPE, "relmse: %d channels, need 1 to %d", in->n,
			       GD_LAYER_PLANES);
	for (int c = 0; c < in->n; c++) {
		struct gd_plane x = in->x[c];
		bool fits = x.v && same_size(x, in->x[0]);

		if (in->halves)
			fits = fits && same_size(in->a[c], x) && same_size(in->b[c], x);
		else
			fits = fits && same_size(in->r[c], x);
		if (!fits)
			return gd_fail(err, GD_ESHAPE,
				       "relmse: channel %d: image and reference differ in size", c);
	}
	if (in->mask.v && !same_size(in->mask, in->x[0]))
		return gd_fail(err, GD_ESHAPE, "relmse: the mask is %dx%d, the image %dx%d",
			       in->mask.w, in->mask.h, in->x[0].w, in->x[0].h);
	return GD_OK;
}

static int check_conf(const struct gd_relmse_conf *conf, struct gd_err *err)
{
	if (!(conf->eps > 0 && isfinite(conf->eps)))
		return gd_fail(err, GD_EARG, "relmse: eps is %g, need more than 0", conf->eps);
	if (!(conf->trim >= 0 && conf->trim <= 0.5))
		return gd_fail(err, GD_EARG, "relmse: trims a share of %g, need 0 to 0.5",
			       conf->trim);
	if (conf->form >= GD_REL_FORMS)
		return gd_fail(err, GD_EARG, "relmse: no form %d", (int)conf->form);
	return GD_OK;
}

static void fill_means(struct gd_relmse *res, const struct sums *s, int n)
{
	double pixels = (double)s->pixels, values = pixels * n;

	res->relmse = s->e / pixels;
	for (int c = 0; c < n; c++)
		res->channel[c] = s->channel[c] / pixels;
	res->mse = s->square / values;
	res->mae = s->abs / values;
	res->mape = s->mape / values;
	res->smape = s->smape / values;
	res->mean = s->x / values;
	res->reference = s->r / values;
	res->pixels = s->pixels;
	res->nonfinite = s->nonfinite;
	res->nonfinite_reference = s->nonfinite_reference;
}

/* e: h x w, overwritten; v: work space of the same size. */
static int measure(struct gd_relmse *res, double *e, double *v, struct sums *row,
		   const struct gd_relmse_in *in, const struct gd_relmse_conf *conf,
		   struct gd_err *err)
{
	const int w = in->x[0].w, h = in->x[0].h;
	struct sums total = { 0 };
	size_t n = 0, ne = (size_t)w * (size_t)h;

#pragma omp parallel for schedule(static)
	for (int y = 0; y < h; y++) {
		struct rows at = rows_at(in, y);

		sum_row(&row[y], e + (size_t)y * (size_t)w, &at, w, conf);
	}
	for (int y = 0; y < h; y++)
		add_sums(&total, &row[y]);
	if (!total.pixels)
		return gd_fail(err, GD_ENUMERIC,
			       "relmse: no pixel to compare (%zu without a finite reference)",
			       total.nonfinite_reference);
	for (size_t i = 0; i < ne; i++)
		if (!isnan(e[i]))
			v[n++] = e[i];
	fill_means(res, &total, in->n);
	order_statistics(res, v, n, e, ne, conf->trim);
	return GD_OK;
}

int gd_relmse(struct gd_relmse *res, double *e, const struct gd_relmse_in *in,
	      const struct gd_relmse_conf *conf, struct gd_err *err)
{
	double *own = NULL, *v = NULL;
	struct sums *row = NULL;
	size_t n;
	int rc;

	memset(res, 0, sizeof(*res));
	rc = check_conf(conf, err);
	if (rc == GD_OK)
		rc = check(in, err);
	if (rc != GD_OK)
		return rc;
	n = (size_t)in->x[0].w * (size_t)in->x[0].h;
	if (!e)
		e = own = gd_alloc(n, sizeof(*own));
	v = gd_alloc(n, sizeof(*v));
	row = gd_alloc((size_t)in->x[0].h, sizeof(*row));
	if (e && v && row)
		rc = measure(res, e, v, row, in, conf, err);
	else
		rc = gd_fail(err, GD_ENOMEM, "relmse: out of memory (%zu pixels)", n);
	free(own);
	free(v);
	free(row);
	return rc;
}

static float relative_error(const struct pixel *p, int n, const struct gd_relmse_conf *conf)
{
	double g = grey(p, n, conf->form), sum = 0;

	for (int c = 0; c < n; c++)
		sum += (p->x[c] - p->r[c]) * (p->x[c] - p->r[c]) / divisor(p, c, g, conf);
	return (float)sqrt(sum / n);
}

int gd_relmse_map(struct gd_plane map, const struct gd_relmse_in *in,
		  const struct gd_relmse_conf *conf, struct gd_err *err)
{
	int rc = check_conf(conf, err);

	if (rc == GD_OK)
		rc = check(in, err);
	if (rc == GD_OK && !same_size(map, in->x[0]))
		rc = gd_fail(err, GD_ESHAPE, "relmse: the map is %dx%d, the image %dx%d", map.w,
			     map.h, in->x[0].w, in->x[0].h);
	if (rc != GD_OK)
		return rc;
#pragma omp parallel for schedule(static)
	for (int y = 0; y < map.h; y++) {
		struct rows at = rows_at(in, y);
		struct pixel p;

		for (int x = 0; x < map.w; x++) {
			bool shown = pixel_at(&p, &at, x) == COMPARED && !p.nonfinite;

			gd_row(map, y)[x] = shown ? relative_error(&p, in->n, conf) : NAN;
		}
	}
	return GD_OK;
}

struct ranked {
	double value, rank;
	size_t i;
};

static int by_value(const void *p, const void *q)
{
	const struct ranked *a = p, *b = q;

	return a->value != b->value ? (a->value > b->value) - (a->value < b->value) :
				      (a->i > b->i) - (a->i < b->i);
}

static int by_index(const void *p, const void *q)
{
	const struct ranked *a = p, *b = q;

	return (a->i > b->i) - (a->i < b->i);
}

/* Ranks 1 .. n, equal values at the mean of theirs; leaves v in its order. */
static void rank_values(struct ranked *v, size_t n)
{
	size_t next;

	for (size_t i = 0; i < n; i++)
		v[i].i = i;
	qsort(v, n, sizeof(*v), by_value);
	for (size_t i = 0; i < n; i = next) {
		for (next = i + 1; next < n && v[next].value == v[i].value; next++)
			;
		for (size_t k = i; k < next; k++)
			v[k].rank = 0.5 * (double)(i + 1 + next);
	}
	qsort(v, n, sizeof(*v), by_index);
}

/* Correlation of the ranks; their mean is (n + 1) / 2 whatever the ties. */
static double correlate(const struct ranked *u, const struct ranked *v, size_t n)
{
	double mean = 0.5 * ((double)n + 1), uu = 0, vv = 0, uv = 0;

	for (size_t i = 0; i < n; i++) {
		double du = u[i].rank - mean, dv = v[i].rank - mean;

		uu += du * du;
		vv += dv * dv;
		uv += du * dv;
	}
	return uu > 0 && vv > 0 ? uv / sqrt(uu * vv) : (double)NAN;
}

/* Mean squared error and mean estimate of the block at (x0, y0); false if no pixel counts. */
static bool block_means(double *truth, double *guess, const struct gd_relmse_in *in,
			const struct gd_plane *est, int x0, int y0, int side)
{
	double t = 0, g = 0;
	size_t n = 0;
	struct pixel p;

	for (int y = y0; y < y0 + side && y < in->x[0].h; y++) {
		struct rows at = rows_at(in, y);

		for (int x = x0; x < x0 + side && x < in->x[0].w; x++) {
			if (pixel_at(&p, &at, x) != COMPARED)
				continue;
			for (int c = 0; c < in->n; c++) {
				double v = gd_row(est[c], y)[x];

				t += p.square[c];
				g += isfinite(v) ? v : 0;
			}
			n++;
		}
	}
	*truth = n ? t / (double)n : 0;
	*guess = n ? g / (double)n : 0;
	return n > 0;
}

static size_t rank_blocks(struct ranked *truth, struct ranked *guess, const struct gd_relmse_in *in,
			  const struct gd_plane *est, int side)
{
	size_t n = 0;

	for (int y = 0; y < in->x[0].h; y += side)
		for (int x = 0; x < in->x[0].w; x += side)
			n += block_means(&truth[n].value, &guess[n].value, in, est, x, y, side);
	return n;
}

int gd_relmse_rank(struct gd_relmse_rank *res, const struct gd_relmse_in *in,
		   const struct gd_plane *est, int side, struct gd_err *err)
{
	struct ranked *truth = NULL, *guess = NULL;
	double t = 0, g = 0;
	size_t most, n = 0;
	int rc = check(in, err);

	memset(res, 0, sizeof(*res));
	if (rc != GD_OK)
		return rc;
	if (side < 1)
		return gd_fail(err, GD_EARG, "relmse: blocks of side %d, need 1 or more", side);
	for (int c = 0; c < in->n; c++)
		if (!same_size(est[c], in->x[0]))
			return gd_fail(err, GD_ESHAPE,
				       "relmse: channel %d of the estimated error has another size",
				       c);
	most = (size_t)((in->x[0].w - 1) / side + 1) * (size_t)((in->x[0].h - 1) / side + 1);
	truth = gd_calloc(most, sizeof(*truth));
	guess = gd_calloc(most, sizeof(*guess));
	if (truth && guess)
		n = rank_blocks(truth, guess, in, est, side);
	else
		rc = gd_fail(err, GD_ENOMEM, "relmse: out of memory (%zu blocks)", most);
	for (size_t i = 0; i < n; i++) {
		t += truth[i].value;
		g += guess[i].value;
	}
	if (rc == GD_OK) {
		rank_values(truth, n);
		rank_values(guess, n);
		res->rho = correlate(truth, guess, n);
		res->ratio = t != 0 ? g / t : (double)NAN;
		res->blocks = n;
	}
	free(truth);
	free(guess);
	return rc;
}
