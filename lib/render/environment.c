/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Radiance is bilinear in (longitude, latitude) between the centres of pixels. The density is
 * constant over each pixel by solid angle, in proportion to the mean of the radiance there: the
 * kernel [1 6 1] / 8 both ways, so that it is 0 only where all of the pixel is black.
 */
#include "render/scene.h"

#include <stdlib.h>

#include "render/impl.h"

#define PI 3.14159265358979323846
#define EVEN 0.01	/* share of the density that does not depend on what the image shows */

static bool constant(const struct gd_environment *e)
{
	return e->w < 1 || e->h < 1 || !e->rgb;
}

static double luma(const struct gd_environment *e, int x, int y)
{
	const float *c = e->rgb + 3 * ((size_t)y * (size_t)e->w + (size_t)x);

	return (double)gd_luma(gd_v3(c[0], c[1], c[2]));
}

/* Cosine of the angle from +y to the upper edge of row y. */
static double edge(const struct gd_environment *e, int y)
{
	return y == 0 ? 1 : y == e->h ? -1 : cos(PI * y / e->h);
}

/* Solid angle of a whole row. */
static double row_angle(const struct gd_environment *e, int y)
{
	return 4 * PI * sin(PI * (y + 0.5) / e->h) * sin(PI * 0.5 / e->h);
}

static double smooth(const struct gd_environment *e, int x, int y)
{
	static const double k[3] = { 1. / 8, 6. / 8, 1. / 8 };
	double sum = 0;

	for (int j = -1; j <= 1; j++)
		for (int i = -1; i <= 1; i++) {
			const int xx = (x + i + e->w) % e->w;
			const int yy = y + j < 0 ? 0 : y + j > e->h - 1 ? e->h - 1 : y + j;

			sum += k[i + 1] * k[j + 1] * luma(e, xx, yy);
		}
	return sum;
}

double gd_environment_flux(const struct gd_scene *scene)
{
	const struct gd_environment *e = &scene->environment;
	double sum = 0;

	if (constant(e))
		return 4 * PI * (double)gd_luma(e->constant);
	for (int y = 0; y < e->h; y++) {
		double row = 0;

		for (int x = 0; x < e->w; x++)
			row += luma(e, x, y);
		sum += row * row_angle(e, y) / e->w;
	}
	return sum;
}

int gd_environment_prepare(struct gd_scene *scene, struct gd_err *err)
{
	struct gd_environment *e = &scene->environment;
	const double mean = gd_environment_flux(scene) / (4 * PI);
	double *row, *column;

	if (constant(e) || e->row_cdf)
		return GD_OK;
	e->row_cdf = gd_calloc((size_t)e->h + 1, sizeof(float));
	e->column_cdf = gd_calloc((size_t)e->h, ((size_t)e->w + 1) * sizeof(float));
	row = gd_calloc((size_t)e->h, sizeof(*row));
	column = gd_calloc((size_t)e->w, sizeof(*column));
	if (e->row_cdf && e->column_cdf && row && column && mean > 0) {
		for (int y = 0; y < e->h; y++) {
			for (int x = 0; x < e->w; x++) {
				const double l = smooth(e, x, y);

				column[x] = l > 0 ? (1 - EVEN) * l + EVEN * mean : 0;
			}
			row[y] = row_angle(e, y) *
				 gd_cdf_fill(e->column_cdf + (size_t)y * ((size_t)e->w + 1), column,
					     (size_t)e->w);
		}
		gd_cdf_fill(e->row_cdf, row, (size_t)e->h);
	}
	free(row);
	free(column);
	if (!e->row_cdf || !e->column_cdf || !row || !column)
		return gd_fail(err, GD_ENOMEM, "out of memory for an environment of %dx%d", e->w,
			       e->h);
	return GD_OK;
}

/* Position in pixels of the direction d: columns 0 .. w, rows 0 .. h. */
static void place(const struct gd_environment *e, struct gd_v3 d, float *x, float *y)
{
	const float phi = atan2f(d.x, -d.z), theta = atan2f(hypotf(d.x, d.z), d.y);

	*x = (0.5f + phi * (float)(0.5 / PI)) * (float)e->w;
	*y = theta * (float)(1 / PI) * (float)e->h;
}

static int within(float x, int n)
{
	const int i = (int)x;

	return i < 0 ? 0 : i > n - 1 ? n - 1 : i;
}

struct gd_v3 gd_environment_at(const struct gd_scene *scene, struct gd_v3 d)
{
	const struct gd_environment *e = &scene->environment;
	const struct gd_texture t = { e->w, e->h, e->rgb, false, true };
	float x, y;

	if (constant(e))
		return e->constant;
	place(e, d, &x, &y);
	return gd_texture_at(&t, x / (float)e->w, y / (float)e->h);
}

float gd_environment_density(const struct gd_scene *scene, struct gd_v3 d)
{
	const struct gd_environment *e = &scene->environment;
	const float *column;
	float x, y;
	int i, j;

	if (constant(e))
		return (float)(0.25 / PI);
	place(e, d, &x, &y);
	i = within(x, e->w);
	j = within(y, e->h);
	column = e->column_cdf + (size_t)j * ((size_t)e->w + 1);
	return (e->row_cdf[j + 1] - e->row_cdf[j]) * (column[i + 1] - column[i]) * (float)e->w /
	       (float)row_angle(e, j);
}

float gd_environment_pdf(const struct gd_scene *scene, struct gd_v3 d)
{
	if (scene->environment_light == GD_NO_INDEX)
		return 0;
	return scene->light[scene->environment_light].chance * gd_environment_density(scene, d);
}

/* Direction with cosine c to +y and longitude phi, 0 at the left edge of the image. */
static struct gd_v3 direction(double c, double phi)
{
	const double s = sqrt(fmax(0, (1 - c) * (1 + c)));

	return gd_v3((float)(-s * sin(phi)), (float)c, (float)(s * cos(phi)));
}

/* What is left of x within its step of a cdf, 0 .. 1. */
static double rest(const float *cdf, size_t i, float x)
{
	const double step = (double)cdf[i + 1] - (double)cdf[i];

	return step > 0 ? fmin(((double)x - (double)cdf[i]) / step, 1) : 0.5;
}

struct gd_v3 gd_environment_draw(const struct gd_scene *scene, float u, float v)
{
	const struct gd_environment *e = &scene->environment;
	const float *column;
	size_t i, j;
	double up, down;

	if (constant(e))
		return direction(1 - 2 * (double)u, 2 * PI * (double)v);
	j = gd_cdf_find(e->row_cdf, (size_t)e->h, u);
	column = e->column_cdf + j * ((size_t)e->w + 1);
	i = gd_cdf_find(column, (size_t)e->w, v);
	up = edge(e, (int)j);
	down = edge(e, (int)j + 1);
	return direction(up + (down - up) * rest(e->row_cdf, j, u),
			 2 * PI * ((double)i + rest(column, i, v)) / e->w);
}
