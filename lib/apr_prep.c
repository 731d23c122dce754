/* SPDX-License-Identifier: BSD-3-Clause */
#include "apr_prep.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define CLEAN_RADIUS 8		/* pixels; a hole wider than that is black inside */
#define SPATIAL_RADIUS 3
#define SPIKE_RADIUS 2
#define SPIKE_SIDE (2 * SPIKE_RADIUS + 1)
#define SPIKE_DEVIATIONS 3.0

static inline int imin(int a, int b)
{
	return a < b ? a : b;
}

static inline int imax(int a, int b)
{
	return a > b ? a : b;
}

static int compare(const void *a, const void *b)
{
	float x = *(const float *)a, y = *(const float *)b;

	return (x > y) - (x < y);
}

static float to_float(double v)
{
	return v > (double)FLT_MAX ? FLT_MAX : v < -(double)FLT_MAX ? -FLT_MAX : (float)v;
}

/* ---- values that are no numbers ---- */

struct mend {
	int x, y;
	float value, var;
};

/* Median of the finite values, largest of the finite variances in the smallest window with any. */
static struct mend mend_at(struct gd_plane value, struct gd_plane var, int x, int y)
{
	float v[(2 * CLEAN_RADIUS + 1) * (2 * CLEAN_RADIUS + 1)];
	struct mend m = { x, y, 0, 0 };
	int n = 0;

	for (int r = 1; r <= CLEAN_RADIUS && n == 0; r++)
		for (int j = imax(y - r, 0); j <= imin(y + r, value.h - 1); j++)
			for (int i = imax(x - r, 0); i <= imin(x + r, value.w - 1); i++) {
				if (isfinite(gd_row(value, j)[i]))
					v[n++] = gd_row(value, j)[i];
				if (var.v && isfinite(gd_row(var, j)[i]))
					m.var = fmaxf(m.var, gd_row(var, j)[i]);
			}
	if (n > 0) {
		qsort(v, (size_t)n, sizeof *v, compare);
		m.value = n % 2 ? v[n / 2] : 0.5f * v[n / 2 - 1] + 0.5f * v[n / 2];
	}
	return m;
}

static bool sound(struct gd_plane value, struct gd_plane var, int x, int y)
{
	return isfinite(gd_row(value, y)[x]) && (!var.v || isfinite(gd_row(var, y)[x]));
}

int gd_apr_clean(struct gd_plane value, struct gd_plane var, size_t *count, struct gd_err *err)
{
	struct mend *m;
	size_t bad = 0, k = 0;

	for (int y = 0; y < value.h; y++)
		for (int x = 0; x < value.w; x++)
			bad += !sound(value, var, x, y);
	m = bad ? gd_alloc(bad, sizeof *m) : NULL;
	if (bad && !m)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	for (int y = 0; y < value.h && bad; y++)
		for (int x = 0; x < value.w; x++)
			if (!sound(value, var, x, y))
				m[k++] = mend_at(value, var, x, y);
	for (size_t i = 0; i < bad; i++) {
		float *v = gd_row(value, m[i].y) + m[i].x,
		      *s = var.v ? gd_row(var, m[i].y) + m[i].x : NULL;
		bool good = isfinite(*v);

		if (s)
			*s = good && *s == INFINITY ? FLT_MAX : m[i].var;
		if (!good)
			*v = m[i].value;
		*count += !good;
	}
	free(m);
	for (int y = 0; y < var.h && var.v; y++)
		for (int x = 0; x < var.w; x++)
			gd_row(var, y)[x] = fmaxf(gd_row(var, y)[x], 0);
	return GD_OK;
}

/* ---- variances where none were given ---- */

void gd_apr_bin_variance(struct gd_plane var, const struct gd_plane *bin, int n)
{
#pragma omp parallel for schedule(static)
	for (int y = 0; y < var.h; y++)
		for (int x = 0; x < var.w; x++) {
			double mean = 0, sum = 0;

			for (int b = 0; b < n; b++)
				mean += (double)gd_row(bin[b], y)[x] / n;
			for (int b = 0; b < n; b++) {
				double d = (double)gd_row(bin[b], y)[x] - mean;

				sum += d * d;
			}
			sum /= (double)n * (n - 1);
			gd_row(var, y)[x] = isfinite(sum) ? to_float(sum) : FLT_MAX;
		}
}

/* Sums of v and v^2 down the columns of rows y-r .. y+r. */
static void column_sums(double *sum, double *sum2, struct gd_plane v, int y, int r)
{
	memset(sum, 0, (size_t)v.w * sizeof *sum);
	memset(sum2, 0, (size_t)v.w * sizeof *sum2);
	for (int j = imax(y - r, 0); j <= imin(y + r, v.h - 1); j++) {
		const float *row = gd_row(v, j);

		for (int x = 0; x < v.w; x++) {
			sum[x] += (double)row[x];
			sum2[x] += (double)row[x] * (double)row[x];
		}
	}
}

int gd_apr_spatial_variance(struct gd_plane var, struct gd_plane value, struct gd_err *err)
{
	const int r = SPATIAL_RADIUS;
	bool failed = false;

#pragma omp parallel for schedule(static)
	for (int y = 0; y < value.h; y++) {
		double *sum = gd_alloc(2 * (size_t)value.w, sizeof *sum), *sum2 = sum + value.w;
		int rows = imin(y + r, value.h - 1) - imax(y - r, 0) + 1;

		if (!sum) {
#pragma omp atomic write
			failed = true;
			continue;
		}
		column_sums(sum, sum2, value, y, r);
		for (int x = 0; x < value.w; x++) {
			int x0 = imax(x - r, 0), x1 = imin(x + r, value.w - 1),
			    n = rows * (x1 - x0 + 1);
			double s = 0, s2 = 0;

			for (int i = x0; i <= x1; i++) {
				s += sum[i];
				s2 += sum2[i];
			}
			gd_row(var, y)[x] = n > 1 ? to_float(fmax(s2 - s * s / n, 0) / (n - 1)) : 0;
		}
		free(sum);
	}
	return failed ? gd_fail(err, GD_ENOMEM, "out of memory") : GD_OK;
}

/* ---- spikes ---- */

static inline double luminance(double r, double g, double b)
{
	return 0.2126 * r + 0.7152 * g + 0.0722 * b;
}

static void luminance_plane(struct gd_plane lum, const struct gd_plane *rgb)
{
#pragma omp parallel for schedule(static)
	for (int y = 0; y < lum.h; y++)
		for (int x = 0; x < lum.w; x++)
			gd_row(lum, y)[x] = (float)luminance((double)gd_row(rgb[0], y)[x],
							     (double)gd_row(rgb[1], y)[x],
							     (double)gd_row(rgb[2], y)[x]);
}

/* One spike, and the neighbour that takes its place. */
struct spike {
	int at, from;
};

struct neighbour {
	float lum;
	int at;
};

static int by_luminance(const void *a, const void *b)
{
	const struct neighbour *p = a, *q = b;

	return p->lum != q->lum ? (p->lum > q->lum) - (p->lum < q->lum)
				: (p->at > q->at) - (p->at < q->at);
}

/* The neighbour of median luminance; of two, the darker. */
static int median_neighbour(struct gd_plane lum, int x, int y)
{
	struct neighbour v[SPIKE_SIDE * SPIKE_SIDE];
	const int r = SPIKE_RADIUS;
	int n = 0;

	for (int j = imax(y - r, 0); j <= imin(y + r, lum.h - 1); j++)
		for (int i = imax(x - r, 0); i <= imin(x + r, lum.w - 1); i++)
			if (i != x || j != y) {
				v[n].lum = gd_row(lum, j)[i];
				v[n++].at = j * lum.w + i;
			}
	qsort(v, (size_t)n, sizeof *v, by_luminance);
	return v[(n - 1) / 2].at;
}

/* Deviation of the luminance, of fully correlated channels; a variance beyond float is none. */
static double deviation(const struct gd_plane *var, int x, int y)
{
	double d[3];

	for (int c = 0; c < 3; c++) {
		float v = gd_row(var[c], y)[x];

		d[c] = v < FLT_MAX ? sqrt((double)v) : INFINITY;
	}
	return luminance(d[0], d[1], d[2]);
}

/*
 * The test of one row; sum, sum2: column sums of its window rows. The neighbours' deviation is
 * taken without the pixel. A millionth of the mean is rounding.
 */
static int spikes_of_row(struct spike *found, struct gd_plane lum, const struct gd_plane *var,
			 bool trust_var, int y, const double *sum, const double *sum2)
{
	const int r = SPIKE_RADIUS;
	int rows = imin(y + r, lum.h - 1) - imax(y - r, 0) + 1, count = 0;

	for (int x = 0; x < lum.w; x++) {
		int x0 = imax(x - r, 0), x1 = imin(x + r, lum.w - 1), n = rows * (x1 - x0 + 1) - 1;
		double here = (double)gd_row(lum, y)[x], s = -here, s2 = -here * here, mean, excess;

		if (n < 3)
			continue;
		for (int i = x0; i <= x1; i++) {
			s += sum[i];
			s2 += sum2[i];
		}
		mean = s / n;
		excess = here - mean;
		if (excess <= 1e-6 * fabs(mean) ||
		    excess * excess <= SPIKE_DEVIATIONS * SPIKE_DEVIATIONS * (s2 / n - mean * mean))
			continue;
		if (trust_var && excess > 2 * deviation(var, x, y))
			continue;
		found[count].at = y * lum.w + x;
		found[count++].from = median_neighbour(lum, x, y);
	}
	return count;
}

/* All spikes in scan order: each row writes to its own part of the list, then it is closed up. */
static int find_spikes(struct spike **list, struct gd_plane lum, const struct gd_plane *var,
		       bool trust_var)
{
	size_t w = (size_t)lum.w, most = w;
	struct spike *all = gd_alloc(most * (size_t)lum.h, sizeof *all);
	int *count = gd_calloc((size_t)lum.h, sizeof *count), n = 0;
	bool failed = !all || !count;

#pragma omp parallel for schedule(static)
	for (int y = 0; y < (failed ? 0 : lum.h); y++) {
		double *sum = gd_alloc(2 * w, sizeof *sum);

		if (sum) {
			column_sums(sum, sum + w, lum, y, SPIKE_RADIUS);
			count[y] = spikes_of_row(all + most * (size_t)y, lum, var, trust_var, y,
						 sum, sum + w);
		} else {
			count[y] = -1;
		}
		free(sum);
	}
	for (int y = 0; !failed && y < lum.h; y++) {
		failed = count[y] < 0;
		for (int k = 0; k < count[y]; k++)
			all[n++] = all[most * (size_t)y + (size_t)k];
	}
	free(count);
	if (failed) {
		free(all);
		return -1;
	}
	*list = all;
	return n;
}

int gd_apr_spikes_take(struct gd_apr_spikes *spikes, const struct gd_plane *y, int ny,
		       const struct gd_plane *var, bool trust_var, struct gd_err *err)
{
	struct gd_plane lum = gd_plane_of(
		gd_alloc(gd_stride(y[0].w) * (size_t)y[0].h, sizeof(float)), y[0].w, y[0].h);
	struct spike *list = NULL;
	float *hold = NULL;
	int n = -1, w = y[0].w, rc = GD_ENOMEM;

	*spikes = (struct gd_apr_spikes){ 0 };
	if (!lum.v)
		goto done;
	luminance_plane(lum, y);
	n = find_spikes(&list, lum, var, trust_var);
	if (n < 0)
		goto done;
	spikes->at = gd_alloc((size_t)n, sizeof *spikes->at);
	spikes->energy = gd_alloc((size_t)n * (size_t)ny, sizeof *spikes->energy);
	hold = gd_alloc((size_t)n * (size_t)(ny + 3), sizeof *hold);
	if (!spikes->at || !spikes->energy || !hold)
		goto done;
	spikes->n = n;
	spikes->ny = ny;
	/* read all before writing any: a spike's neighbour may be one too */
	for (int k = 0; k < n; k++)
		for (int c = 0; c < ny + 3; c++)
			hold[k * (ny + 3) + c] = gd_row(c < ny ? y[c] : var[c - ny],
							list[k].from / w)[list[k].from % w];
	for (int k = 0; k < n; k++) {
		int at = spikes->at[k] = list[k].at;

		for (int c = 0; c < ny + 3; c++) {
			float *v = gd_row(c < ny ? y[c] : var[c - ny], at / w) + at % w,
			      new = hold[k * (ny + 3) + c];

			if (c < ny)
				spikes->energy[k * ny + c] = (double)*v - (double)new;
			*v = new;
		}
	}
	rc = GD_OK;
done:
	if (rc != GD_OK) {
		gd_apr_spikes_free(spikes);
		gd_fail(err, rc, "out of memory");
	}
	free(lum.v);
	free(list);
	free(hold);
	return rc;
}

/* The window of radius r around pixel `at`, cut at the border. */
static struct window { int x0, x1, y0, y1; } window_at(struct gd_plane p, int at, int r)
{
	int x = at % p.w, y = at / p.w;

	return (struct window){imax(x - r, 0), imin(x + r, p.w - 1), imax(y - r, 0),
			       imin(y + r, p.h - 1)};
}

int gd_apr_spikes_return(const struct gd_apr_spikes *spikes, const struct gd_plane *est, int radius,
			 double most, int *capped, struct gd_err *err)
{
	size_t w = (size_t)est[0].w, h = (size_t)est[0].h;
	struct gd_plane lum =
		gd_plane_of(gd_alloc(gd_stride(est[0].w) * h, sizeof(float)), est[0].w, est[0].h);
	double *scale = gd_alloc((size_t)spikes->n, sizeof *scale);	/* share / window's light */
	double *gain = gd_alloc((w + 1) * (h + 1), sizeof *gain);	/* differences of sums */
	int rc = lum.v && scale && gain ? GD_OK : GD_ENOMEM;

	*capped = 0;
	if (rc == GD_OK) {
		luminance_plane(lum, est);
		for (int y = 0; y < lum.h; y++)
			for (int x = 0; x < lum.w; x++)
				gd_row(lum, y)[x] = fmaxf(gd_row(lum, y)[x], FLT_MIN);
		/* summed-area table: window sums for any radius at one price */
		for (size_t i = 0; i <= w; i++)
			gain[i] = 0;
		for (size_t y = 0; y < h; y++) {
			double row = 0;

			gain[(y + 1) * (w + 1)] = 0;
			for (size_t x = 0; x < w; x++) {
				row += (double)gd_row(lum, (int)y)[x];
				gain[(y + 1) * (w + 1) + x + 1] = gain[y * (w + 1) + x + 1] + row;
			}
		}
	}
	for (int k = 0; rc == GD_OK && k < spikes->n; k++) {
		struct window b = window_at(lum, spikes->at[k], radius);
		const double *top = gain + (size_t)b.y0 * (w + 1),
			     *end = gain + (size_t)(b.y1 + 1) * (w + 1);
		double light = end[b.x1 + 1] - end[b.x0] - top[b.x1 + 1] + top[b.x0];
		const double *e = spikes->energy + (size_t)k * (size_t)spikes->ny;
		double taken = luminance(fabs(e[0]), fabs(e[1]), fabs(e[2]));

		light = fmax(light, (double)FLT_MIN);
		scale[k] = 1 / light;
		if (taken > most * light) {
			scale[k] = most / taken;
			++*capped;
		}
	}
	for (int c = 0; rc == GD_OK && c < spikes->ny; c++) {
		memset(gain, 0, (w + 1) * (h + 1) * sizeof *gain);
		for (int k = 0; k < spikes->n; k++) {
			struct window b = window_at(lum, spikes->at[k], radius);
			double *top = gain + (size_t)b.y0 * (w + 1),
			       *end = gain + (size_t)(b.y1 + 1) * (w + 1);
			double share = spikes->energy[k * spikes->ny + c] * scale[k];

			top[b.x0] += share;
			top[b.x1 + 1] -= share;
			end[b.x0] -= share;
			end[b.x1 + 1] += share;
		}
		for (size_t y = 0; y < h; y++) {
			double sum = 0;

			for (size_t x = 0; x < w; x++) {
				float *v = gd_row(est[c], (int)y) + x;

				sum += gain[y * (w + 1) + x];
				gain[(y + 1) * (w + 1) + x] += gain[y * (w + 1) + x];
				*v = to_float((double)*v + sum * (double)gd_row(lum, (int)y)[x]);
			}
		}
	}
	free(lum.v);
	free(scale);
	free(gain);
	return rc == GD_OK ? GD_OK : gd_fail(err, rc, "out of memory");
}

void gd_apr_spikes_free(struct gd_apr_spikes *spikes)
{
	free(spikes->at);
	free(spikes->energy);
	*spikes = (struct gd_apr_spikes){ 0 };
}
