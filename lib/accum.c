/* SPDX-License-Identifier: BSD-3-Clause */
#include "accum.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "kernel/accum_row.h"

static inline double at(const float *plane, double all, int x)
{
	return plane ? (double)plane[x] : all;
}

static inline const float *row_or_null(struct gd_plane p, int y)
{
	return p.v ? gd_row(p, y) : NULL;
}

static inline float narrow(double v)
{
	return (float)(v > FLT_MAX ? FLT_MAX : v < -FLT_MAX ? -FLT_MAX : v);
}

void gd_count_free(struct gd_count *c)
{
	free(c->plane.v);
	*c = (struct gd_count){ 0 };
}

int gd_count_spread(struct gd_count *c, int w, int h, struct gd_err *err)
{
	float *v;

	if (c->plane.v)
		return GD_OK;
	v = gd_alloc((size_t)h * gd_stride(w), sizeof *v);
	if (!v)
		return gd_fail(err, GD_ENOMEM, "out of memory for %d x %d counts", w, h);
	for (size_t i = 0; i < (size_t)h * gd_stride(w); i++)
		v[i] = (float)c->all;
	c->plane = gd_plane_of(v, w, h);
	return GD_OK;
}

int gd_count_add(struct gd_count *c, const struct gd_count *a, struct gd_err *err)
{
	int rc;

	if (!c->plane.v && !a->plane.v) {
		c->all += a->all;
		return GD_OK;
	}
	if (!c->plane.v) {
		rc = gd_count_spread(c, a->plane.w, a->plane.h, err);
		if (rc != GD_OK)
			return rc;
	}
#pragma omp parallel for schedule(static) if (GD_ACCUM_MANY(c->plane))
	for (int y = 0; y < c->plane.h; y++) {
		const float *add = row_or_null(a->plane, y);
		float *sum = gd_row(c->plane, y);

		for (int x = 0; x < c->plane.w; x++)
			sum[x] = narrow(sum[x] + at(add, a->all, x));
	}
	return GD_OK;
}

void gd_count_scale(struct gd_count *c, double factor)
{
	c->all *= factor;
	for (int y = 0; y < c->plane.h; y++)
		for (int x = 0; x < c->plane.w; x++)
			gd_row(c->plane, y)[x] = (float)(gd_row(c->plane, y)[x] * factor);
}

static inline bool is_bad(const struct gd_plane *plane, int n, int x, int y)
{
	for (int i = 0; i < n; i++)
		if (!isfinite(gd_row(plane[i], y)[x]))
			return true;
	return false;
}

static bool all_finite(const struct gd_plane *plane, int n, int y)
{
	const struct gd_accum_kernel *kernel = GD_PICK(gd_accum_kernel);

	for (int i = 0; i < n; i++)
		if (!kernel->finite(gd_row(plane[i], y), plane[i].w))
			return false;
	return true;
}

size_t gd_accum_bad(const struct gd_plane *plane, int n, const struct gd_count *w)
{
	size_t bad = 0;

#pragma omp parallel for schedule(static) reduction(+ : bad) if (GD_ACCUM_MANY(*plane))
	for (int y = 0; y < plane->h; y++) {
		const float *weight = row_or_null(w->plane, y);

		if (all_finite(plane, n, y))
			continue;
		for (int x = 0; x < plane->w; x++)
			bad += is_bad(plane, n, x, y) && at(weight, w->all, x) > 0;
	}
	return bad;
}

void gd_accum_mask(const struct gd_plane *plane, int n, struct gd_count *w)
{
#pragma omp parallel for schedule(static) if (GD_ACCUM_MANY(*plane))
	for (int y = 0; y < plane->h; y++) {
		float *weight = gd_row(w->plane, y);

		for (int x = 0; x < plane->w; x++)
			if (is_bad(plane, n, x, y))
				weight[x] = 0;
	}
}

void gd_accum_add(struct gd_plane mean, struct gd_plane m2, struct gd_plane x,
		  struct gd_plane within, const struct gd_count *w, const struct gd_count *old)
{
	const struct gd_accum_kernel *kernel = GD_PICK(gd_accum_kernel);

#pragma omp parallel for schedule(static) if (GD_ACCUM_MANY(mean))
	for (int y = 0; y < mean.h; y++) {
		const struct gd_accum_row row = {
			.mean = gd_row(mean, y), .m2 = m2.v ? gd_row(m2, y) : NULL,
			.x = gd_row(x, y), .within = row_or_null(within, y),
			.w = row_or_null(w->plane, y), .old = row_or_null(old->plane, y),
			.all_w = w->all, .all_old = old->all
		};

		kernel->add(&row, mean.w);
	}
}

void gd_accum_sum(struct gd_plane sum, struct gd_plane x)
{
#pragma omp parallel for schedule(static) if (GD_ACCUM_MANY(sum))
	for (int j = 0; j < sum.h; j++)
		for (int i = 0; i < sum.w; i++)
			gd_row(sum, j)[i] = narrow((double)gd_row(sum, j)[i] + gd_row(x, j)[i]);
}

/* The variance of the mean of n samples; NaN where it cannot be known. */
static inline double of_mean(double v, double mean, double n, enum gd_variance kind)
{
	if (kind == GD_VARIANCE_SAMPLE)
		return v / n;
	if (kind == GD_VARIANCE_M2)
		return n > 1 ? (v - mean * mean) / (n - 1) : 0;
	return v;
}

size_t gd_accum_within_variance(struct gd_plane out, struct gd_plane v, struct gd_plane mean,
				enum gd_variance kind, bool counted, float limit,
				const struct gd_count *n)
{
	size_t bad = 0;

#pragma omp parallel for schedule(static) reduction(+ : bad) if (GD_ACCUM_MANY(out))
	for (int j = 0; j < out.h; j++) {
		const float *var = gd_row(v, j), *m = gd_row(mean, j),
			    *count = row_or_null(n->plane, j);
		float *o = gd_row(out, j);

		for (int i = 0; i < out.w; i++) {
			double k = at(count, n->all, i),
			       s = var[i] > limit ? (double)limit : (double)var[i];

			bad += isnan(var[i]) && k > 0;
			s = k > 0 ? of_mean(s, m[i], k, kind) : 0;
			o[i] = s > 0 ? narrow(s * k * (counted ? (k > 1 ? k - 1 : 0) : k)) : 0;
		}
	}
	return bad;
}

void gd_accum_within_parts(struct gd_plane out, const struct gd_plane *part, int k,
			   const struct gd_count *n)
{
#pragma omp parallel for schedule(static) if (GD_ACCUM_MANY(out))
	for (int j = 0; j < out.h; j++) {
		const float *count = row_or_null(n->plane, j);
		float *o = gd_row(out, j);

		for (int i = 0; i < out.w; i++) {
			double mean = 0, sum = 0;

			for (int b = 0; b < k; b++)
				mean += gd_row(part[b], j)[i];
			mean /= k;
			for (int b = 0; b < k; b++) {
				double d = gd_row(part[b], j)[i] - mean;

				sum += d * d;
			}
			o[i] = at(count, n->all, i) > 0 ? narrow(sum * at(count, n->all, i) / k)
							: 0;
		}
	}
}
