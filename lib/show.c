/* SPDX-License-Identifier: BSD-3-Clause */
#include "show.h"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "file.h"
#include "font.h"
#include "plugin.h"
#include "select.h"

static const char *const as_names[GD_SHOW_AS] = {
	"auto", "colour", "scalar", "signed", "normal", "position",
};

const char *gd_show_as_name(enum gd_show_as as)
{
	return as_names[as];
}

bool gd_show_as_find(const char *name, enum gd_show_as *as)
{
	for (int i = 0; i < GD_SHOW_AS; i++)
		if (!strcmp(name, as_names[i])) {
			*as = (enum gd_show_as)i;
			return true;
		}
	return false;
}

/* Is one of the dot-divided parts of layer in the list? */
static bool has_part(const char *layer, const char *const *list)
{
	for (const char *p = layer; p; p = strchr(p, '.')) {
		p += *p == '.';
		for (int i = 0; list[i]; i++) {
			size_t n = strlen(list[i]);

			if (!strncmp(p, list[i], n) && (!p[n] || p[n] == '.'))
				return true;
		}
	}
	return false;
}

enum gd_show_as gd_show_guess(const char *layer, int n)
{
	static const char *const squares[] = { "variance", "Variance", "error", "mse", NULL };
	static const char *const signs[] = { "dx", "dy", NULL };
	static const char *const normals[] = { "N", "Ns", "normal", "Normal", "normals", NULL };
	static const char *const positions[] = { "P", "position", "Position", NULL };

	if (has_part(layer, squares))
		return GD_SHOW_SCALAR;
	if (has_part(layer, signs))
		return GD_SHOW_SIGNED;
	if (n < 3)
		return strcmp(layer, "Y") ? GD_SHOW_SCALAR : GD_SHOW_COLOUR;
	if (has_part(layer, normals))
		return GD_SHOW_NORMAL;
	return has_part(layer, positions) ? GD_SHOW_POSITION : GD_SHOW_COLOUR;
}

/* ---- ranges ---- */

static double mean_at(const struct gd_plane *v, int n, int x, int y)
{
	double sum = 0;

	for (int c = 0; c < n; c++)
		sum += gd_row(v[c], y)[x];
	return sum / n;
}

/* Finite means of the n planes, magnitudes if asked for, those above 0 only if asked for. */
static size_t collect(double *to, const struct gd_plane *v, int n, bool magnitude, bool positive)
{
	size_t found = 0;

	for (int y = 0; y < v[0].h; y++)
		for (int x = 0; x < v[0].w; x++) {
			double m = mean_at(v, n, x, y);

			if (magnitude)
				m = fabs(m);
			if (isfinite(m) && (!positive || m > 0))
				to[found++] = m;
		}
	return found;
}

/* A range must have a width, even in an image of one value. */
static void widen(struct gd_show_range *range)
{
	float step = fabsf(range->lo) * 1e-3f;

	if (range->hi > range->lo)
		return;
	range->hi = range->lo + (step > 1e-6f ? step : 1e-6f);
	if (!(range->hi > range->lo))
		range->lo = nextafterf(range->hi, -INFINITY);
}

static float clamp_float(double v)
{
	return v > 3e38 ? 3e38f : v < -3e38 ? -3e38f : (float)v;
}

static int find_range(struct gd_show_range *range, const struct gd_plane *v, int n, bool symmetric,
		      struct gd_err *err)
{
	size_t pixels = (size_t)v[0].w * (size_t)v[0].h, found;
	double *value = gd_alloc(pixels, sizeof(*value)), lo = 0, hi = 1;

	if (!value)
		return gd_fail(err, GD_ENOMEM, "out of memory (%zu pixels)", pixels);
	found = collect(value, v, n, symmetric, range->scale == GD_SHOW_LOG && !symmetric);
	if (found) {
		lo = gd_select(value, 0, found, gd_quantile_index(0.01, found));
		hi = gd_select(value, 0, found, gd_quantile_index(0.99, found));
	}
	free(value);
	if (range->scale == GD_SHOW_LOG && !symmetric)
		lo = !found ? 1e-6 : lo > 1e-6 * hi ? lo : 1e-6 * hi;
	range->lo = clamp_float(symmetric ? -hi : lo);
	range->hi = clamp_float(hi);
	widen(range);
	return GD_OK;
}

int gd_show_range(struct gd_show_range *range, const struct gd_plane *v, int n, enum gd_show_as as,
		  enum gd_show_scale scale, struct gd_err *err)
{
	range->scale = scale;
	return find_range(range, v, n, as == GD_SHOW_SIGNED, err);
}

/* ---- false colours ---- */

/* sRGB-encoded control points, evenly spaced, with straight lines between them. */
static const float dark_to_bright[][3] = {
	{ 0.001f, 0.000f, 0.014f }, { 0.078f, 0.054f, 0.211f }, { 0.232f, 0.059f, 0.437f },
	{ 0.390f, 0.100f, 0.502f }, { 0.550f, 0.161f, 0.506f }, { 0.716f, 0.215f, 0.475f },
	{ 0.869f, 0.288f, 0.409f }, { 0.967f, 0.440f, 0.360f }, { 0.995f, 0.624f, 0.427f },
	{ 0.996f, 0.813f, 0.573f }, { 0.987f, 0.991f, 0.750f },
};
static const float blue_to_red[][3] = {
	{ 0.020f, 0.188f, 0.380f }, { 0.130f, 0.400f, 0.675f }, { 0.410f, 0.680f, 0.830f },
	{ 0.780f, 0.875f, 0.930f }, { 0.970f, 0.970f, 0.970f }, { 0.985f, 0.830f, 0.740f },
	{ 0.930f, 0.560f, 0.450f }, { 0.760f, 0.160f, 0.200f }, { 0.404f, 0.000f, 0.122f },
};

static void interpolate(float rgb[3], const float point[][3], int n, float t)
{
	float at = t * (float)(n - 1);
	int i = at >= (float)(n - 1) ? n - 2 : (int)at;
	float f = at - (float)i;

	for (int c = 0; c < 3; c++)
		rgb[c] = point[i][c] + f * (point[i + 1][c] - point[i][c]);
}

static double clamp01(double t)
{
	return t > 0 ? (t < 1 ? t : 1) : 0;
}

/* 0 .. 1; v may be infinite. */
static double place(double v, const struct gd_show_range *r)
{
	double lo = r->lo, hi = r->hi;

	if (r->scale == GD_SHOW_LOG)
		return v > lo ? clamp01(log(v / lo) / log(hi / lo)) : 0;
	v = clamp01((v - lo) / (hi - lo));
	return r->scale == GD_SHOW_SQRT ? sqrt(v) : v;
}

/*
 * -1 .. 1, 0 in the middle; the end of larger magnitude counts on both sides. A logarithm has 3
 * decades.
 */
static double place_signed(double v, const struct gd_show_range *r)
{
	double end = fmax(fabs((double)r->lo), fabs((double)r->hi));
	double t = clamp01(fabs(v) / end);

	if (r->scale == GD_SHOW_SQRT)
		t = sqrt(t);
	else if (r->scale == GD_SHOW_LOG)
		t = t > 1e-3 ? 1 + log10(t) / 3 : 0;
	return v < 0 ? -t : t;
}

static void false_colour(float rgb[3], double v, const struct gd_show_conf *conf)
{
	if (conf->as == GD_SHOW_SIGNED)
		interpolate(rgb, blue_to_red, (int)(sizeof(blue_to_red) / sizeof(*blue_to_red)),
			    (float)(0.5 + 0.5 * place_signed(v, &conf->range)));
	else
		interpolate(rgb, dark_to_bright,
			    (int)(sizeof(dark_to_bright) / sizeof(*dark_to_bright)),
			    (float)place(v, &conf->range));
}

/* ---- pictures ---- */

void gd_picture_free(struct gd_picture *pic)
{
	free(pic->rgb);
	*pic = (struct gd_picture){ 0 };
}

static int picture_init(struct gd_picture *pic, long long w, long long h, struct gd_err *err)
{
	if (w < 1 || h < 1 || w > GD_PICTURE_SIDE || h > GD_PICTURE_SIDE ||
	    w * h > GD_PICTURE_PIXELS)
		return gd_fail(err, GD_ESHAPE, "a picture of %lldx%lld pixels is beyond %d a side "
			       "or %d megapixels", w, h, GD_PICTURE_SIDE, GD_PICTURE_PIXELS >> 20);
	pic->rgb = gd_calloc((size_t)w * (size_t)h, 3 * sizeof(float));
	if (!pic->rgb)
		return gd_fail(err, GD_ENOMEM, "out of memory (a picture of %lldx%lld)", w, h);
	pic->w = (int)w;
	pic->h = (int)h;
	return GD_OK;
}

static float *pixel(const struct gd_picture *pic, int x, int y)
{
	return pic->rgb + 3 * ((size_t)y * (size_t)pic->w + (size_t)x);
}

static void show_false(struct gd_picture *pic, const struct gd_plane *v, int n,
		       const struct gd_show_conf *conf)
{
#pragma omp parallel for schedule(static)
	for (int y = 0; y < pic->h; y++)
		for (int x = 0; x < pic->w; x++) {
			double m = mean_at(v, n, x, y);

			false_colour(pixel(pic, x, y), isnan(m) ? 0 : m, conf);
		}
}

/* Each channel over its own range: -1 .. 1 for normals, its percentiles for positions. */
static int show_channels(struct gd_picture *pic, const struct gd_plane *v,
			 const struct gd_show_conf *conf, struct gd_err *err)
{
	for (int c = 0; c < 3; c++) {
		struct gd_show_range r = { -1, 1, GD_SHOW_LINEAR };
		int rc =
			conf->as == GD_SHOW_POSITION ? find_range(&r, &v[c], 1, false, err) : GD_OK;

		if (rc != GD_OK)
			return rc;
#pragma omp parallel for schedule(static)
		for (int y = 0; y < pic->h; y++)
			for (int x = 0; x < pic->w; x++)
				pixel(pic, x, y)[c] = (float)place((double)gd_row(v[c], y)[x], &r);
	}
	return GD_OK;
}

static int show_colour(struct gd_picture *pic, const struct gd_plane *v, int n,
		       const struct gd_show_conf *conf, struct gd_err *err)
{
	const double gain = exp2(conf->exposure);

#pragma omp parallel for schedule(static)
	for (int y = 0; y < pic->h; y++)
		for (int x = 0; x < pic->w; x++)
			for (int c = 0; c < 3; c++) {
				double t = gd_row(v[n < 3 ? 0 : c], y)[x] * gain;

				pixel(pic, x, y)[c] = isnan(t) ? 0 :
								 (float)(t > 1e30  ? 1e30 :
									 t < -1e30 ? -1e30 :
										     t);
			}
	return gd_plugin_display(pic->rgb, (size_t)pic->w * (size_t)pic->h, conf->display,
				 conf->view, err);
}

/* Pure magenta, which none of the maps has. */
static size_t mark_nan(struct gd_picture *pic, const struct gd_plane *v, int n)
{
	size_t count = 0;

	for (int y = 0; y < pic->h; y++)
		for (int x = 0; x < pic->w; x++) {
			bool bad = false;

			for (int c = 0; c < n; c++)
				bad = bad || isnan(gd_row(v[c], y)[x]);
			if (bad) {
				memcpy(pixel(pic, x, y), (const float[3]){ 1, 0, 1 },
				       3 * sizeof(float));
				count++;
			}
		}
	return count;
}

int gd_show(struct gd_picture *pic, size_t *nan, const struct gd_plane *v, int n,
	    const struct gd_show_conf *conf, struct gd_err *err)
{
	bool channels = conf->as == GD_SHOW_NORMAL || conf->as == GD_SHOW_POSITION;
	size_t marked;
	int rc;

	if (n < 1 || (channels && n < 3))
		return gd_fail(err, GD_ESHAPE, "%d channels cannot be shown as %s", n,
			       as_names[conf->as]);
	n = n < 3 ? 1 : 3;
	rc = picture_init(pic, v[0].w, v[0].h, err);
	if (rc != GD_OK)
		return rc;
	if (channels)
		rc = show_channels(pic, v, conf, err);
	else if (conf->as == GD_SHOW_COLOUR || conf->as == GD_SHOW_AUTO)
		rc = show_colour(pic, v, n, conf, err);
	else
		show_false(pic, v, n, conf);
	marked = mark_nan(pic, v, n);
	if (nan)
		*nan = marked;
	if (rc != GD_OK)
		gd_picture_free(pic);
	return rc;
}

int gd_picture_zoom(struct gd_picture *pic, int factor, struct gd_err *err)
{
	struct gd_picture out = { 0 };
	int rc;

	if (factor < 1)
		return gd_fail(err, GD_EARG, "zoom by %d, need 1 or more", factor);
	rc = picture_init(&out, (long long)pic->w * factor, (long long)pic->h * factor, err);
	if (rc != GD_OK)
		return rc;
	for (int y = 0; y < out.h; y++)
		for (int x = 0; x < out.w; x++)
			memcpy(pixel(&out, x, y), pixel(pic, x / factor, y / factor),
			       3 * sizeof(float));
	gd_picture_free(pic);
	*pic = out;
	return GD_OK;
}

/* Values 0 .. 1 to whole numbers 0 .. top, to the nearest. */
static void quantise(void *to, const float *from, size_t n, int bits)
{
	float top = bits == 16 ? 65535.0f : 255.0f;

	for (size_t i = 0; i < n; i++) {
		float v = from[i] > 0 ? (from[i] < 1 ? from[i] : 1) : 0;

		if (bits == 16)
			((uint16_t *)to)[i] = (uint16_t)(v * top + 0.5f);
		else
			((uint8_t *)to)[i] = (uint8_t)(v * top + 0.5f);
	}
}

bool gd_picture_misnamed(const char *path)
{
	const char *dot = strrchr(path, '.');

	return dot && !strcasecmp(dot, ".exr");
}

int gd_picture_write(const struct gd_picture *pic, const char *path, int bits, struct gd_err *err)
{
	size_t n = 3 * (size_t)pic->w * (size_t)pic->h, size = 0;
	unsigned char *png = NULL;
	void *pixels;
	int rc;

	if (bits != 8 && bits != 16)
		return gd_fail(err, GD_EARG, "PNG of %d bits, need 8 or 16", bits);
	pixels = gd_alloc(n, (size_t)bits / 8);
	if (!pixels)
		return gd_fail(err, GD_ENOMEM, "out of memory (a picture of %dx%d)", pic->w,
			       pic->h);
	quantise(pixels, pic->rgb, n, bits);
	rc = gd_plugin_png(&png, &size, pixels, pic->w, pic->h, 3, bits, err);
	free(pixels);
	if (rc == GD_OK)
		rc = gd_file_write(path, png, size, err);
	free(png);
	return rc;
}

/* ---- letters, legends, sheets ---- */

void gd_picture_text(struct gd_picture *pic, int x, int y, int size, const char *text)
{
	static const float ink[3] = { 0.92f, 0.92f, 0.92f };

	for (; *text; text++, x += GD_FONT_WIDTH * size)
		for (int j = 0; j < GD_FONT_HEIGHT * size; j++)
			for (int i = 0; i < GD_FONT_WIDTH * size; i++)
				if (x + i >= 0 && x + i < pic->w && y + j >= 0 && y + j < pic->h &&
				    gd_font_pixel(*text, i / size, j / size))
					memcpy(pixel(pic, x + i, y + j), ink, sizeof(ink));
}

static void fill(struct gd_picture *pic, int x0, int y0, int w, int h, const float rgb[3])
{
	for (int y = y0; y < y0 + h; y++)
		for (int x = x0; x < x0 + w; x++)
			memcpy(pixel(pic, x, y), rgb, 3 * sizeof(float));
}

static void paste(struct gd_picture *to, int x, int y, const struct gd_picture *pic)
{
	for (int j = 0; j < pic->h; j++)
		memcpy(pixel(to, x, y + j), pixel(pic, 0, j), 3 * sizeof(float) * (size_t)pic->w);
}

static const float paper[3] = { 0.13f, 0.13f, 0.13f };

static const char *const scale_notes[] = { "", " sqrt", " log" };

/* Letters grow with the pictures. */
static int text_size(int w)
{
	return 1 + w / 500;
}

int gd_picture_legend(struct gd_picture *pic, const struct gd_show_conf *conf, struct gd_err *err)
{
	int size = text_size(pic->w), bar = 6 * size, strip = bar + (GD_FONT_HEIGHT + 3) * size;
	const struct gd_show_range *r = &conf->range;
	struct gd_picture out = { 0 };
	char lo[32], hi[32];
	int rc = picture_init(&out, pic->w, (long long)pic->h + strip, err);

	if (rc != GD_OK)
		return rc;
	paste(&out, 0, 0, pic);
	fill(&out, 0, pic->h, out.w, strip, paper);
	for (int x = 0; x < out.w; x++) {
		double t = out.w > 1 ? (double)x / (out.w - 1) : 0;
		struct gd_show_conf even = *conf;

		even.range = (struct gd_show_range){ conf->as == GD_SHOW_SIGNED ? -1 : 0, 1,
						     GD_SHOW_LINEAR };
		for (int y = 0; y < bar; y++)
			false_colour(pixel(&out, x, pic->h + y),
				     conf->as == GD_SHOW_SIGNED ? 2 * t - 1 : t, &even);
	}
	snprintf(lo, sizeof(lo), "%.3g%s", (double)r->lo, scale_notes[r->scale]);
	snprintf(hi, sizeof(hi), "%.3g", (double)r->hi);
	gd_picture_text(&out, size, pic->h + bar + 2 * size, size, lo);
	if ((int)(strlen(lo) + strlen(hi) + 1) * GD_FONT_WIDTH * size < out.w)
		gd_picture_text(&out, out.w - (int)strlen(hi) * GD_FONT_WIDTH * size,
				pic->h + bar + 2 * size, size, hi);
	gd_picture_free(pic);
	*pic = out;
	return GD_OK;
}

/* The text, or its two ends with "..." between them, in at most room letters. */
static void cut(char *to, size_t size, const char *text, int room)
{
	int n = (int)strlen(text), head;

	if (room > (int)size - 1)
		room = (int)size - 1;
	if (n <= room) {
		snprintf(to, size, "%s", text);
	} else if (room < 5) {
		snprintf(to, size, "%.*s", room > 0 ? room : 0, text);
	} else {
		head = (room - 3) / 2;
		snprintf(to, size, "%.*s...%s", head, text, text + n - (room - 3 - head));
	}
}

int gd_picture_sheet(struct gd_picture *sheet, const struct gd_picture *pic,
		     const char *const *label, int n, int columns, struct gd_err *err)
{
	int w = 1, h = 1, rows, size, strip = 0, gap;
	char text[512];
	int rc;

	if (n < 1 || columns < 1)
		return gd_fail(err, GD_EARG, "a sheet of %d pictures in %d columns", n, columns);
	columns = columns < n ? columns : n;
	rows = (n + columns - 1) / columns;
	for (int i = 0; i < n; i++) {
		w = pic[i].w > w ? pic[i].w : w;
		h = pic[i].h > h ? pic[i].h : h;
	}
	size = text_size(w);
	gap = 3 * size;
	for (int i = 0; label && i < n; i++)
		if (label[i] && *label[i])
			strip = (GD_FONT_HEIGHT + 3) * size;
	rc = picture_init(sheet, (long long)columns * (w + gap) + gap,
			  (long long)rows * (h + strip + gap) + gap, err);
	if (rc != GD_OK)
		return rc;
	fill(sheet, 0, 0, sheet->w, sheet->h, paper);
	for (int i = 0; i < n; i++) {
		int x = gap + (i % columns) * (w + gap),
		    y = gap + (i / columns) * (h + strip + gap);

		paste(sheet, x, y, &pic[i]);
		cut(text, sizeof(text), label && label[i] ? label[i] : "",
		    w / (GD_FONT_WIDTH * size));
		gd_picture_text(sheet, x, y + h + 2 * size, size, text);
	}
	return GD_OK;
}
