/* SPDX-License-Identifier: BSD-3-Clause */
/* From a film to the channels of a gd buffer. */
#include <float.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "buffers.h"
#include "render/film.h"

#define SAME 1e-4	/* of a number of samples: rounding */

static const char *const g_name[GD_FILM_G] = {
	"albedo.R", "albedo.G", "albedo.B", "N.X", "N.Y", "N.Z", "P.X", "P.Y", "P.Z", "Z",
};
static const char *const g_variance[GD_FILM_G] = {
	"albedo.variance.R", "albedo.variance.G", "albedo.variance.B",
	"N.variance.X", "N.variance.Y", "N.variance.Z",
	"P.variance.X", "P.variance.Y", "P.variance.Z", "Z.variance",
};

static inline float narrow(double v)
{
	return (float)(v > FLT_MAX ? FLT_MAX : v < -FLT_MAX ? -FLT_MAX : v);
}

/* ---- channels ---- */

static bool has_gradients(const struct gd_plan *plan)
{
	for (int y = 0; y < plan->h; y++)
		for (int x = 0; x < plan->w; x++)
			if (gd_plan_share(plan, x, y) > 0 && gd_plan_samples(plan, x, y) > 0)
				return true;
	return false;
}

static const char *layer_name(const struct gd_plan *plan, int k, char name[16])
{
	if (plan->conf->pairs)
		snprintf(name, 16, "pair%d", k);
	else
		snprintf(name, 16, k ? "dy" : "dx");
	return name;
}

/* A colour-like layer with its variances and bins. */
static int add_layer(struct gd_image *im, const char *layer, int bins, struct gd_err *err)
{
	struct gd_plane unused[GD_LAYER_PLANES];
	const char *dot = *layer ? "." : "";
	char name[64];
	int rc = gd_layer_add(im, layer, 3, unused, err);

	snprintf(name, sizeof name, "%s%svariance", layer, dot);
	if (rc == GD_OK)
		rc = gd_layer_add(im, name, 3, unused, err);
	for (int b = 0; b < bins && rc == GD_OK; b++) {
		snprintf(name, sizeof name, "bin%d%s%s", b, dot, layer);
		rc = gd_layer_add(im, name, 3, unused, err);
	}
	return rc;
}

static int add_gradients(struct gd_image *im, const struct gd_plan *plan, int bins,
			 struct gd_err *err)
{
	const int n = has_gradients(plan) ? gd_plan_layers(plan) : 0;
	char layer[16], name[32];
	int rc = GD_OK;

	for (int k = 0; k < n && rc == GD_OK; k++) {
		rc = add_layer(im, layer_name(plan, k, layer), bins, err);
		snprintf(name, sizeof name, "%s.samples", layer);
		if (rc == GD_OK)
			rc = gd_image_add(im, name, NULL, err);
		for (int i = 0; i < 2 && plan->conf->pairs && rc == GD_OK; i++) {
			snprintf(name, sizeof name, "%s.%c", layer, "xy"[i]);
			rc = gd_image_add(im, name, NULL, err);
		}
	}
	return rc;
}

int gd_film_channels(struct gd_image *im, const struct gd_plan *plan, struct gd_err *err)
{
	static const char *const samples[] = { "samples", "half0.samples", "half1.samples" };
	const struct gd_render_conf *conf = plan->conf;
	const int bins = conf->bins > 1 ? conf->bins : 0;
	int rc;

	gd_image_init(im, plan->w, plan->h);
	im->data = conf->crop;
	im->display = (struct gd_box){ 0, 0, conf->w - 1, conf->h - 1 };
	rc = add_layer(im, "", bins, err);
	for (int i = 0; i < GD_FILM_G && rc == GD_OK; i++) {
		rc = gd_image_add(im, g_name[i], NULL, err);
		if (rc == GD_OK)
			rc = gd_image_add(im, g_variance[i], NULL, err);
	}
	for (int i = 0; i < (bins ? 3 : 1) && rc == GD_OK; i++)
		rc = gd_image_add(im, samples[i], NULL, err);
	return rc == GD_OK ? add_gradients(im, plan, bins, err) : rc;
}

/* A layer's planes in the image, as gd_film_channels() made them. */
struct layer {
	struct gd_plane mean[GD_LAYER_PLANES], var[GD_LAYER_PLANES], samples, x, y;
	struct gd_plane bin[GD_RENDER_BINS][GD_LAYER_PLANES];
};

static void find_layer(struct layer *l, const struct gd_image *im, const char *layer, int bins)
{
	const char *dot = *layer ? "." : "";
	char name[64];

	*l = (struct layer){ 0 };
	gd_layer_planes(im, layer, l->mean);
	gd_layer_variance_planes(im, layer, l->var);
	for (int b = 0; b < bins; b++) {
		snprintf(name, sizeof name, "bin%d%s%s", b, dot, layer);
		gd_layer_planes(im, name, l->bin[b]);
	}
	snprintf(name, sizeof name, "%s%ssamples", layer, dot);
	gd_image_plane(im, name, &l->samples);
	snprintf(name, sizeof name, "%s.x", layer);
	gd_image_plane(im, name, &l->x);
	snprintf(name, sizeof name, "%s.y", layer);
	gd_image_plane(im, name, &l->y);
}

/* ---- colours ---- */

/* A pixel with what is needed to know its colour and its gradients. */
struct pixel {
	const struct gd_film *film;
	int x, y, n, used;		/* edges; those that are traced */
	uint32_t colour, traced;	/* samples of either class */
	struct gd_edge edge[GD_PAIRS];
	int back[GD_PAIRS];		/* the edge's place at its other end; -1: not traced, or
					   not looked up yet */
};

/* The place of edge k at its other end. */
static void look_back(struct pixel *p, const struct gd_plan *plan, int k)
{
	const struct gd_edge *e = &p->edge[k];
	struct gd_edge there[GD_PAIRS];
	int n;

	if (!(e->r > 0))
		return;
	n = gd_plan_edges(plan, p->x + e->x, p->y + e->y, there);
	p->back[k] = gd_plan_find(there, n, -e->x, -e->y);
}

static void look(struct pixel *p, const struct gd_film *film, const struct gd_plan *plan, int x,
		 int y)
{
	const uint32_t *count = gd_film_count(film, x, y);

	*p = (struct pixel){ .film = film, .x = x, .y = y, .colour = count[0], .traced = count[1],
			     .back = { -1, -1, -1, -1 } };
	p->n = gd_plan_edges(plan, x, y, p->edge);
	for (int k = 0; k < p->n; k++)
		p->used += p->edge[k].r > 0;
	for (int k = 0; k < p->n && film->reuse; k++)
		look_back(p, plan, k);
}

/* The mean of a pixel, or of its bin b. */
static inline const float *mean_of(const struct gd_film *film, int x, int y, int b)
{
	return b < 0 ? gd_film_mean(film, x, y) : gd_film_bin(film, x, y, b);
}

/* Channel c of the colour from the base paths and the neighbours' offset paths. */
static double reused(const struct pixel *p, int c, int b)
{
	const float *own = mean_of(p->film, p->x, p->y, b);
	const double n = (double)p->colour + p->traced;
	double sum = 0;

	for (int k = 0; k < p->n; k++)
		if (p->back[k] >= 0)
			sum += (double)mean_of(p->film, p->x + p->edge[k].x, p->y + p->edge[k].y,
					       b)[GD_FILM_THEIRS + 3 * p->back[k] + c];
	sum = (double)own[GD_FILM_MINE + c] + sum / p->used;
	return (p->traced * sum + p->colour * (double)own[GD_FILM_COLOUR + c]) / n;
}

/* Its variance: samples of other pixels are independent of each other. Negative: unknown. */
static double reused_variance(const struct pixel *p, int c)
{
	const struct gd_film *film = p->film;
	const double n = (double)p->colour + p->traced;
	double own = gd_film_variance(film, p->x, p->y, GD_FILM_MINE + c, p->traced), theirs = 0;
	double rest = gd_film_variance(film, p->x, p->y, GD_FILM_COLOUR + c, p->colour);

	if (own < 0 || (p->colour && rest < 0))
		return -1;
	for (int k = 0; k < p->n; k++) {
		const int x = p->x + p->edge[k].x, y = p->y + p->edge[k].y;
		double v;

		if (p->back[k] < 0)
			continue;
		v = gd_film_variance(film, x, y, GD_FILM_THEIRS + 3 * p->back[k] + c,
				     gd_film_count(film, x, y)[1]);
		if (v < 0)
			return -1;
		theirs += v / p->used / p->used;
	}
	own = (own + theirs) * p->traced * p->traced;
	return (own + (p->colour ? rest * p->colour * p->colour : 0)) / n / n;
}

static void develop_colour(const struct layer *l, const struct pixel *p, int c)
{
	const struct gd_film *film = p->film;
	const bool reuse = film->reuse && p->used && p->traced;
	const int x = p->x, y = p->y;

	gd_row(l->mean[c], y)[x] = reuse ? narrow(reused(p, c, -1)) :
					   gd_film_mean(film, x, y)[GD_FILM_COLOUR + c];
	gd_row(l->var[c], y)[x] = narrow(reuse ? reused_variance(p, c) :
		gd_film_variance(film, x, y, GD_FILM_COLOUR + c, p->colour));
	for (int b = 0; b < film->bins; b++)
		gd_row(l->bin[b][c], y)[x] = reuse ? narrow(reused(p, c, b)) :
			gd_film_bin(film, x, y, b)[GD_FILM_COLOUR + c];
}

/* Samples of the pixel, and of either half. */
static void develop_samples(const struct gd_film *film, const struct gd_plane out[3], int x, int y)
{
	const uint32_t *count = gd_film_count(film, x, y);

	gd_row(out[0], y)[x] = (float)gd_film_samples(film, count);
	for (int b = 0; b < film->bins; b++)
		gd_row(out[1 + b % 2], y)[x] += (float)gd_film_samples(film, count + 2 + 2 * b);
}

static void develop_pixels(struct gd_image *im, const struct gd_film *film,
			   const struct gd_plan *plan, const struct layer *colour)
{
	struct gd_plane samples[3] = { { 0 } }, g[GD_FILM_G], var[GD_FILM_G];

	gd_image_plane(im, "samples", &samples[0]);
	gd_image_plane(im, "half0.samples", &samples[1]);
	gd_image_plane(im, "half1.samples", &samples[2]);
	for (int i = 0; i < GD_FILM_G; i++) {
		gd_image_plane(im, g_name[i], &g[i]);
		gd_image_plane(im, g_variance[i], &var[i]);
	}
#pragma omp parallel for schedule(static)
	for (int y = 0; y < film->h; y++)
		for (int x = 0; x < film->w; x++) {
			const uint32_t n = gd_film_samples(film, gd_film_count(film, x, y));
			struct pixel p;

			look(&p, film, plan, x, y);
			for (int c = 0; c < 3; c++)
				develop_colour(colour, &p, c);
			develop_samples(film, samples, x, y);
			for (int i = 0; i < GD_FILM_G; i++) {
				gd_row(g[i], y)[x] = gd_film_mean(film, x, y)[film->binned + i];
				gd_row(var[i], y)[x] = narrow(
					gd_film_variance(film, x, y, film->binned + i, n));
			}
		}
}

/* ---- gradients ---- */

/* Channel c of edge k of p, whole and in bins. */
static void develop_traced(const struct layer *l, const struct pixel *p, int k, int c)
{
	const struct gd_film *film = p->film;
	const int x = p->x + p->edge[k].x, y = p->y + p->edge[k].y;
	const int here = GD_FILM_HALF + 3 * k + c, there = GD_FILM_HALF + 3 * p->back[k] + c;
	const double a = gd_film_variance(film, p->x, p->y, here, p->traced);
	const double b = gd_film_variance(film, x, y, there, gd_film_count(film, x, y)[1]);

	gd_row(l->mean[c], p->y)[p->x] = narrow((double)gd_film_mean(film, p->x, p->y)[here] -
						(double)gd_film_mean(film, x, y)[there]);
	gd_row(l->var[c], p->y)[p->x] = a < 0 || b < 0 ? -1 : narrow(a + b);
	for (int i = 0; i < film->bins; i++)
		gd_row(l->bin[i][c], p->y)[p->x] =
			narrow((double)gd_film_bin(film, p->x, p->y, i)[here] -
			       (double)gd_film_bin(film, x, y, i)[there]);
}

static inline void subtract(struct gd_plane out, struct gd_plane in, const struct pixel *p, int x,
			    int y)
{
	gd_row(out, p->y)[p->x] =
		narrow((double)gd_row(in, y)[x] - (double)gd_row(in, p->y)[p->x]);
}

/* The same without offset paths: the difference of the colours. */
static void develop_plain(const struct layer *l, const struct layer *colour, const struct pixel *p,
			  int k, int c)
{
	const int x = p->x + p->edge[k].x, y = p->y + p->edge[k].y;

	subtract(l->mean[c], colour->mean[c], p, x, y);
	for (int b = 0; b < p->film->bins; b++)
		subtract(l->bin[b][c], colour->bin[b][c], p, x, y);
	gd_row(l->var[c], p->y)[p->x] = !colour->var[c].v ? -1 :
		narrow((double)gd_row(colour->var[c], p->y)[p->x] +
		       (double)gd_row(colour->var[c], y)[x]);
}

static void develop_edge(const struct layer *l, const struct layer *colour, const struct pixel *p,
			 int k)
{
	const struct gd_film *film = p->film;
	const int x = p->x + p->edge[k].x, y = p->y + p->edge[k].y;
	const uint32_t *there = gd_film_count(film, x, y);
	const uint32_t n = gd_film_samples(film, gd_film_count(film, p->x, p->y));
	const uint32_t m = gd_film_samples(film, there);
	const bool traced = p->back[k] >= 0;

	gd_row(l->samples, p->y)[p->x] =
		traced ? (float)gd_film_worth(p->traced, there[1]) : 0;
	for (int c = 0; c < 3; c++) {
		if (traced)
			develop_traced(l, p, k, c);
		else if (n && m)
			develop_plain(l, colour, p, k, c);
		else
			gd_row(l->var[c], p->y)[p->x] = -1;
	}
}

static void develop_gradients(const struct layer *l, const struct layer *colour, int layer,
			      const struct gd_film *film, const struct gd_plan *plan)
{
#pragma omp parallel for schedule(static)
	for (int y = 0; y < film->h; y++)
		for (int x = 0; x < film->w; x++) {
			struct pixel p;
			int dx, dy, k;

			gd_row(l->samples, y)[x] = gd_row(colour->samples, y)[x];
			for (int c = 0; c < 3; c++)
				gd_row(l->var[c], y)[x] = NAN;
			if (!gd_plan_edge(plan, layer, x, y, &dx, &dy))
				continue;
			look(&p, film, plan, x, y);
			k = gd_plan_find(p.edge, p.n, dx, dy);
			if (k < 0)
				continue;
			look_back(&p, plan, k);
			develop_edge(l, colour, &p, k);
			if (l->x.v) {
				gd_row(l->x, y)[x] = (float)dx;
				gd_row(l->y, y)[x] = (float)dy;
			}
		}
}

/* ---- variances that are not known ---- */

/*
 * Where one sample alone tells nothing (-1), the mean variance of one sample over the image,
 * divided by the samples there; where there is nothing to vary (NaN), 0. *known: whether any
 * pixel knows.
 */
static int fill_unknown(struct gd_plane var, struct gd_plane samples, bool *known,
			struct gd_err *err)
{
	double *sum = gd_calloc((size_t)var.h, sizeof *sum), total = 0, n = 0;
	double *number = gd_calloc((size_t)var.h, sizeof *number);
	int rc = sum && number ? GD_OK : gd_fail(err, GD_ENOMEM, "out of memory");

#pragma omp parallel for schedule(static)
	for (int y = 0; y < (rc == GD_OK ? var.h : 0); y++)
		for (int x = 0; x < var.w; x++) {
			const double v = (double)gd_row(var, y)[x];

			if (!(v >= 0))
				continue;
			sum[y] += v * (double)gd_row(samples, y)[x];
			number[y]++;
		}
	for (int y = 0; y < var.h && rc == GD_OK; y++) {
		total += sum[y];
		n += number[y];
	}
	*known = n > 0;
#pragma omp parallel for schedule(static)
	for (int y = 0; y < (n > 0 ? var.h : 0); y++)
		for (int x = 0; x < var.w; x++)
			if (!(gd_row(var, y)[x] >= 0))
				gd_row(var, y)[x] = isnan(gd_row(var, y)[x]) ? 0 : narrow(
					total / n / fmax((double)gd_row(samples, y)[x], 1));
	free(sum);
	free(number);
	return rc;
}

static void drop_plane(struct gd_image *im, struct gd_plane p)
{
	for (int i = 0; i < im->nchan; i++)
		if (im->chan[i].v == p.v) {
			gd_image_drop(im, im->chan[i].name);
			return;
		}
}

static int finish_variances(struct gd_image *im, struct layer *l, struct gd_plane samples,
			    struct gd_err *err)
{
	bool known = true;
	int rc = GD_OK;

	for (int c = 0; c < 3 && rc == GD_OK; c++)
		rc = fill_unknown(l->var[c], samples, &known, err);
	for (int c = 0; c < 3 && rc == GD_OK && !known; c++) {
		drop_plane(im, l->var[c]);
		l->var[c].v = NULL;
	}
	return rc;
}

static bool all_zero(struct gd_plane p)
{
	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++)
			if (gd_row(p, y)[x] != 0)
				return false;
	return true;
}

/* G-buffers without noise, or of unknown noise, have no variance. Layer by layer. */
static int finish_g_variances(struct gd_image *im, struct gd_plane samples, struct gd_err *err)
{
	static const int first[] = { 0, 3, 6, 9, 10 };
	int rc = GD_OK;

	for (int k = 0; k < 4 && rc == GD_OK; k++) {
		bool known = true, noisy = false;
		struct gd_plane var[3];

		for (int i = first[k]; i < first[k + 1] && rc == GD_OK; i++) {
			gd_image_plane(im, g_variance[i], &var[i - first[k]]);
			rc = fill_unknown(var[i - first[k]], samples, &known, err);
			noisy = noisy || (known && !all_zero(var[i - first[k]]));
		}
		for (int i = first[k]; i < first[k + 1] && rc == GD_OK && !noisy; i++)
			gd_image_drop(im, g_variance[i]);
	}
	return rc;
}

/* ---- numbers of samples ---- */

static bool differs(struct gd_plane p)
{
	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++)
			if (gd_row(p, y)[x] != p.v[0])
				return true;
	return false;
}

/* Do the halves hold other than their share of each pixel's samples? */
static bool lopsided(struct gd_plane samples, struct gd_plane half0, int bins)
{
	const double share = (bins + 1) / 2 / (double)bins;

	for (int y = 0; y < samples.h; y++)
		for (int x = 0; x < samples.w; x++) {
			const double n = (double)gd_row(samples, y)[x];

			if (fabs((double)gd_row(half0, y)[x] - share * n) > SAME * n)
				return true;
		}
	return false;
}

/* Are the gradients worth other than the samples at their two ends say? */
static bool apart(const struct layer *l, int layer, struct gd_plane samples,
		  const struct gd_plan *plan)
{
	for (int y = 0; y < samples.h; y++)
		for (int x = 0; x < samples.w; x++) {
			const double n = (double)gd_row(samples, y)[x];
			double worth = n;
			int dx, dy;

			if (gd_plan_edge(plan, layer, x, y, &dx, &dy))
				worth = gd_film_worth(n, (double)gd_row(samples, y + dy)[x + dx]);
			if (fabs((double)gd_row(l->samples, y)[x] - worth) > SAME * worth)
				return true;
		}
	return false;
}

static double mean(struct gd_plane p)
{
	double sum = 0;

	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++)
			sum += (double)gd_row(p, y)[x];
	return sum / p.w / p.h;
}

static int finish_samples(struct gd_image *im, struct gd_plane samples, int bins,
			  struct gd_err *err)
{
	struct gd_plane half0 = { 0 };
	const double spp = mean(samples);
	bool sides = bins && gd_image_plane(im, "half0.samples", &half0) &&
		     lopsided(samples, half0, bins);
	int rc;

	if (!sides) {
		gd_image_drop(im, "half0.samples");
		gd_image_drop(im, "half1.samples");
	}
	if (!sides && spp > 0 && !differs(samples))	/* the mean tells it, unless it is 0 */
		gd_image_drop(im, "samples");
	rc = gd_attr_set_number(im, "gd:samplesPerPixel", spp, err);
	return rc == GD_OK && bins ? gd_attr_set_int(im, "gd:bins", bins, err) : rc;
}

/* ---- all of it ---- */

int gd_film_develop(struct gd_image *im, struct gd_film *film, const struct gd_plan *plan,
		    struct gd_err *err)
{
	struct layer *colour = malloc(2 * sizeof *colour), *l = colour + 1;
	int rc = colour ? GD_OK : gd_fail(err, GD_ENOMEM, "out of memory");
	char name[16];

	if (rc != GD_OK)
		return rc;
	find_layer(colour, im, "", film->bins);
	gd_film_fill_bins(film);
	develop_pixels(im, film, plan, colour);
	rc = finish_variances(im, colour, colour->samples, err);
	if (rc == GD_OK)
		rc = finish_g_variances(im, colour->samples, err);
	for (int k = 0; k < gd_plan_layers(plan) && rc == GD_OK; k++) {
		char samples[32];

		find_layer(l, im, layer_name(plan, k, name), film->bins);
		if (!l->samples.v)
			break;
		develop_gradients(l, colour, k, film, plan);
		rc = finish_variances(im, l, l->samples, err);
		snprintf(samples, sizeof samples, "%s.samples", name);
		if (rc == GD_OK && !apart(l, k, colour->samples, plan))
			gd_image_drop(im, samples);
	}
	if (rc == GD_OK)
		rc = finish_samples(im, colour->samples, film->bins, err);
	free(colour);
	return rc;
}
