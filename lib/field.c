/* SPDX-License-Identifier: BSD-3-Clause */
#include "field.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "edges.h"
#include "kernel/poisson_prep.h"

int gd_field_check(const struct gd_plane *plane, int n, int w, int h, const char *name,
		   struct gd_err *err)
{
	for (int c = 0; c < n; c++)
		if (plane[c].v && (plane[c].w != w || plane[c].h != h))
			return gd_fail(err, GD_ESHAPE, "%s: plane %d is %dx%d, expected %dx%d",
				       name, c, plane[c].w, plane[c].h, w, h);
	return GD_OK;
}

static const float *magnitude_row(const struct gd_rows *rows, int i, float *work)
{
	const struct gd_plane *plane = rows->user, p = plane[i / plane[0].h];
	const float *v = gd_row(p, i % p.h);

	for (int x = 0; x < p.w; x++)
		work[x] = fabsf(v[x]);
	return work;
}

/* part: a sum for each row. */
static double level_of(const struct gd_plane *plane, int n, double *part)
{
	const struct gd_rows rows = { n * plane[0].h, plane[0].w, magnitude_row, plane };
	const float cap = (float)fmin(100 * gd_median_positive(&rows), (double)FLT_MAX);
	double sum = 0;

#pragma omp parallel for schedule(static)
	for (int i = 0; i < rows.count; i++) {
		const struct gd_plane p = plane[i / plane[0].h];
		const float *v = gd_row(p, i % p.h);
		double s = 0;

#pragma omp simd reduction(+:s)
		for (int x = 0; x < rows.w; x++) {
			float a = fabsf(v[x]), b = a < cap ? a : cap;

			s += a <= FLT_MAX ? (double)b : 0;
		}
		part[i] = s;
	}
	for (int i = 0; i < rows.count; i++)
		sum += part[i];
	return sum / ((double)rows.count * rows.w);
}

double gd_field_level(const struct gd_field *field)
{
	double *work = gd_alloc((size_t)field->n * (size_t)field->h, sizeof(*work)), level = 0;

	if (!work)
		return 0;
	if (field->primal && field->primal[0].v)
		level = level_of(field->primal, field->n, work);
	if (!(level > 0) && field->dx)
		level = level_of(field->dx, field->n, work);
	if (!(level > 0) && field->dy)
		level = level_of(field->dy, field->n, work);
	free(work);
	return level;
}

float gd_field_scale(double level)
{
	int exponent = level > 0 ? -ilogb(level) : 0;

	return ldexpf(1, exponent > 120 ? 120 : exponent < -120 ? -120 : exponent);
}

static size_t row_size(const struct gd_field *field)
{
	return gd_stride(field->w + 2) + 16;
}

size_t gd_field_work(const struct gd_field *field)
{
	return 12 * row_size(field);
}

static int ascending(const void *a, const void *b)
{
	const float u = *(const float *)a, v = *(const float *)b;

	return (u > v) - (u < v);
}

static float neighbour_median(struct gd_plane p, int x, int y)
{
	float v[9];
	int n = 0;

	for (int j = y > 0 ? y - 1 : y; j <= y + 1 && j < p.h; j++)
		for (int i = x > 0 ? x - 1 : x; i <= x + 1 && i < p.w; i++)
			if (fabsf(gd_row(p, j)[i]) <= FLT_MAX)
				v[n++] = gd_row(p, j)[i];
	if (n == 0)
		return 0;
	qsort(v, (size_t)n, sizeof(*v), ascending);
	return v[n / 2];
}

const float *gd_field_primal(const struct gd_field *field, int c, int y, float *out)
{
	const struct gd_prep_kernels *k = GD_PICK(gd_prep);
	const struct gd_plane p = field->primal[c];

	if (k->clean(out, gd_row(p, y), field->scale, p.w) == 0)
		return out;
	for (int x = 0; x < p.w; x++) {
		if (fabsf(gd_row(p, y)[x]) <= FLT_MAX)
			continue;
		float v = neighbour_median(p, x, y);

		k->clean(out + x, &v, field->scale, 1);
	}
	return out;
}

/* A row of work space with zeros around it: kernels look at dx[-1]. */
static float *slot(const struct gd_field *field, float *work, int i)
{
	float *v = work + (size_t)i * row_size(field) + 16;

	v[-1] = v[field->w] = v[field->w + 1] = 0;
	return v;
}

struct gd_mg_rows gd_field_rows(const struct gd_field *field, int y, float *work)
{
	const struct gd_prep_kernels *k = GD_PICK(gd_prep);
	struct gd_mg_rows rows = { { NULL }, { NULL }, { NULL }, { NULL } };

	for (int c = 0; c < field->n; c++) {
		float *dx = slot(field, work, c), *dy = slot(field, work, 3 + c),
		      *up = slot(field, work, 6 + c);

		k->clean(dx, gd_row(field->dx[c], y), field->scale, field->w);
		k->clean(dy, gd_row(field->dy[c], y), field->scale, field->w);
		if (y > 0)
			k->clean(up, gd_row(field->dy[c], y - 1), field->scale, field->w);
		else
			memset(up, 0, (size_t)field->w * sizeof(*up));
		rows.dx[c] = dx;
		rows.dy[c] = dy;
		rows.up[c] = up;
		if (field->primal && field->primal[c].v)
			rows.primal[c] = gd_field_primal(field, c, y, slot(field, work, 9 + c));
	}
	return rows;
}

void gd_field_screen(const struct gd_field *field, const struct gd_mg_level *l, bool wide,
		     double weight)
{
#pragma omp parallel for schedule(static)
	for (int y = 0; y < l->h; y++)
		for (int x = 0; x < l->w; x++) {
			const size_t at = (size_t)y * l->stride + (size_t)x;
			double a = weight;

			for (int c = 0; c < field->n; c++)
				if (!(fabsf(gd_row(field->primal[c], y)[x]) <= FLT_MAX))
					a = 1e-4 * weight;
			if (wide)
				((double *)l->a)[at] = a;
			else
				((float *)l->a)[at] = (float)a;
		}
}

static double get(const void *v, bool wide, size_t i)
{
	return wide ? ((const double *)v)[i] : (double)((const float *)v)[i];
}

static void add_row(void *v, bool wide, size_t at, int w, double by)
{
	if (wide)
		for (int x = 0; x < w; x++)
			((double *)v)[at + (size_t)x] += by;
	else
		for (int x = 0; x < w; x++)
			((float *)v)[at + (size_t)x] += (float)by;
}

/* What the primal's row sums to less what the solution's does. */
static double row_gap(const struct gd_field *field, int c, int y, const void *x, bool wide,
		      size_t at, bool target, float *work)
{
	double gap = 0;

	if (target && field->primal && field->primal[c].v) {
		const float *p = gd_field_primal(field, c, y, work);

		for (int i = 0; i < field->w; i++)
			gap += (double)p[i];
	}
	for (int i = 0; i < field->w; i++)
		gap -= get(x, wide, at + (size_t)i);
	return gap;
}

static int anchor_whole(const struct gd_field *field, const struct gd_mg_level *l, bool wide,
			void *x, bool target, struct gd_err *err)
{
	double *gap = gd_alloc((size_t)l->h, sizeof(*gap));

	if (!gap)
		return gd_fail(err, GD_ENOMEM, "anchor: out of memory");
	for (int c = 0; c < field->n; c++) {
		double sum = 0;

#pragma omp parallel
		{
			float *work = gd_alloc((size_t)l->w, sizeof(*work));

#pragma omp for schedule(static)
			for (int y = 0; y < l->h; y++)
				gap[y] = work ? row_gap(field, c, y, x, wide,
							c * l->plane + (size_t)y * l->stride,
							target, work)
					      : NAN;
			free(work);
		}
		for (int y = 0; y < l->h; y++)
			sum += gap[y];
		if (isnan(sum)) {
			free(gap);
			return gd_fail(err, GD_ENOMEM, "anchor: out of memory");
		}
		sum /= (double)l->w * l->h;
#pragma omp parallel for schedule(static)
		for (int y = 0; y < l->h; y++)
			add_row(x, wide, c * l->plane + (size_t)y * l->stride, l->w, sum);
	}
	free(gap);
	return GD_OK;
}

struct part {
	double gap[GD_FIELD_MAX];
	double pixels;
};

static void anchor_row(const struct gd_field *field, const struct gd_mg_level *l, bool wide,
		       void *x, bool target, const int *label, struct part *part, int y,
		       float *work)
{
	for (int c = 0; c < field->n; c++) {
		const size_t at = c * l->plane + (size_t)y * l->stride;
		const float *p = target && field->primal && field->primal[c].v
					 ? gd_field_primal(field, c, y, work)
					 : NULL;

		for (int i = 0; i < l->w; i++) {
			part[label[i]].gap[c] +=
				(p ? (double)p[i] : 0) - get(x, wide, at + (size_t)i);
			part[label[i]].pixels += c == 0;
		}
	}
}

int gd_field_anchor(const struct gd_field *field, const struct gd_mg_level *l, bool wide, void *x,
		    bool target, bool all, int *parts, struct gd_err *err)
{
	const size_t n = (size_t)l->w * (size_t)l->h;
	struct part *part = NULL;
	int *label, count;
	float *work;

	if (parts)
		*parts = 1;
	if (all)
		return anchor_whole(field, l, wide, x, target, err);
	label = gd_alloc(n, sizeof(*label));
	work = gd_alloc((size_t)l->w, sizeof(*work));
	if (label && work) {
		count = gd_edges_parts(l, wide, 0, label);
		part = gd_calloc((size_t)count, sizeof(*part));
	}
	if (part) {
		for (int y = 0; y < l->h; y++)
			anchor_row(field, l, wide, x, target, label + (size_t)y * (size_t)l->w,
				   part, y, work);
		for (int c = 0; c < field->n; c++)
			for (size_t i = 0; i < n; i++)
				add_row(x, wide,
					c * l->plane + i / (size_t)l->w * l->stride +
						i % (size_t)l->w,
					1, part[label[i]].gap[c] / part[label[i]].pixels);
		if (parts)
			*parts = count;
	}
	free(label);
	free(work);
	if (!part)
		return gd_fail(err, GD_ENOMEM, "anchor: out of memory");
	free(part);
	return GD_OK;
}

void gd_field_store(const struct gd_field *field, const struct gd_plane *to,
		    const struct gd_mg_level *l, bool wide, const void *x)
{
	const double unscale = 1 / (double)field->scale, most = (double)FLT_MAX;

#pragma omp parallel for schedule(static)
	for (int y = 0; y < l->h; y++)
		for (int c = 0; c < field->n; c++) {
			const size_t at = c * l->plane + (size_t)y * l->stride;
			float *out = gd_row(to[c], y);

			for (int i = 0; i < l->w; i++) {
				double v = get(x, wide, at + (size_t)i) * unscale;

				out[i] = v > most    ? FLT_MAX
					 : v < -most ? -FLT_MAX
					 : v == v    ? (float)v
						     : 0;
			}
		}
}
