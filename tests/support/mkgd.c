/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * A synthetic gd buffer: a smooth image with edges, its gradients, features and bins of noise.
 *	mkgd OUT.exr WIDTH HEIGHT [NAME=VALUE ...] [CASE ...]
 * bins=8 (0: variances without bins), seed=1, scale=1 (of radiance), type=float or half,
 * turn=x, y (mirrored) or t (transposed: WIDTH and HEIGHT are those of the result), drop=PREFIX
 * (channels to leave out), position=1 (world positions, too; of the cases those after it spoil
 * them, too). Noise is a function of seed, channel, bin and the pixel before turning.
 * Cases: see spoil().
 */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "buffers.h"
#include "exr.h"

#define MAX_BINS 16

struct scene {
	int w, h;		/* of the result */
	int bins, draws;
	unsigned seed;
	double scale;
	char turn;
	bool half;
};

static double noise(const struct scene *s, unsigned a, unsigned b, int x, int y)
{
	uint64_t k = ((uint64_t)s->seed << 48) ^ ((uint64_t)a << 40) ^ ((uint64_t)b << 32) ^
		     ((uint64_t)x << 16) ^ (uint64_t)y;
	double sum = 0;

	for (int i = 0; i < 4; i++) {	/* a sum of four is near enough to a Gaussian */
		k += 0x9e3779b97f4a7c15u;
		k = (k ^ (k >> 30)) * 0xbf58476d1ce4e5b9u;
		k = (k ^ (k >> 27)) * 0x94d049bb133111ebu;
		k ^= k >> 31;
		sum += (double)(k >> 11) / 9007199254740992.0 - 0.5;
	}
	return sum * 1.7320508;
}

static double radiance(int c, int x, int y)
{
	double v = 0.5 + 0.3 * sin(0.31 * x + c) * cos(0.23 * y);

	if (x > 5 && y > 3)
		v += 0.7;
	return v * (1 + 0.2 * c) + 0.02 * y;
}

/* Draw b of one plane in base coordinates: 0 colour, 1 dx, 2 dy; w0 x h0 is the base size. */
static double draw(const struct scene *s, int plane, int c, int b, int x, int y)
{
	const int w0 = s->turn == 't' ? s->h : s->w, h0 = s->turn == 't' ? s->w : s->h;
	const double here = radiance(c, x, y);

	if (plane == 0)
		return here * (1 + 0.5 * noise(s, (unsigned)c, (unsigned)b, x, y));
	if (plane == 1 ? x >= w0 - 1 : y >= h0 - 1)
		return 0;
	return radiance(c, x + (plane == 1), y + (plane == 2)) - here +
	       0.1 * noise(s, (unsigned)(c + 3 * plane), (unsigned)b, x, y);
}

/* The same in coordinates of the result. */
static double turned(const struct scene *s, int plane, int c, int b, int x, int y)
{
	double v;

	if ((plane == 1 && x == s->w - 1) || (plane == 2 && y == s->h - 1))
		return 0;
	if (s->turn == 't')
		v = draw(s, plane ? 3 - plane : 0, c, b, y, x);
	else if (s->turn == 'x')
		v = plane == 1 ? -draw(s, 1, c, b, s->w - 2 - x, y)
			       : draw(s, plane, c, b, s->w - 1 - x, y);
	else if (s->turn == 'y')
		v = plane == 2 ? -draw(s, 2, c, b, x, s->h - 2 - y)
			       : draw(s, plane, c, b, x, s->h - 1 - y);
	else
		v = draw(s, plane, c, b, x, y);
	return v * s->scale;
}

static int add_estimates(struct gd_image *im, const struct scene *s, int plane, struct gd_err *err)
{
	static const char *const layers[] = { "", "dx", "dy" };
	struct gd_plane mean[GD_LAYER_PLANES], var[GD_LAYER_PLANES], bin[GD_LAYER_PLANES];
	char name[64];
	int rc;

	snprintf(name, sizeof name, "%s%svariance", layers[plane], plane ? "." : "");
	rc = gd_layer_add(im, layers[plane], 3, mean, err);
	if (rc == GD_OK && s->draws > 1)
		rc = gd_layer_add(im, name, 3, var, err);
	for (int c = 0; rc == GD_OK && c < 3; c++)
		for (int y = 0; y < s->h; y++)
			for (int x = 0; x < s->w; x++) {
				double sum = 0, sum2 = 0;

				for (int b = 0; b < s->draws; b++)
					sum += turned(s, plane, c, b, x, y) / s->draws;
				for (int b = 0; b < s->draws; b++)
					sum2 += pow(turned(s, plane, c, b, x, y) - sum, 2);
				gd_row(mean[c], y)[x] = (float)sum;
				if (s->draws > 1)
					gd_row(var[c], y)[x] =
						(float)(sum2 / s->draws / (s->draws - 1));
			}
	for (int b = 0; rc == GD_OK && b < s->bins; b++) {
		snprintf(name, sizeof name, "bin%d%s%s", b, plane ? "." : "", layers[plane]);
		rc = gd_layer_add(im, name, 3, bin, err);
		for (int c = 0; rc == GD_OK && c < 3; c++)
			for (int y = 0; y < s->h; y++)
				for (int x = 0; x < s->w; x++)
					gd_row(bin[c], y)[x] = (float)turned(s, plane, c, b, x, y);
	}
	return rc;
}

static int add_feature(struct gd_image *im, const char *name, const struct scene *s, int kind,
		       struct gd_err *err)
{
	struct gd_plane p;
	int rc = gd_image_add(im, name, &p, err);

	for (int y = 0; rc == GD_OK && y < s->h; y++)
		for (int x = 0; x < s->w; x++) {
			const int bx = s->turn == 't' ? y : s->turn == 'x' ? s->w - 1 - x : x;
			const int by = s->turn == 't' ? x : s->turn == 'y' ? s->h - 1 - y : y;
			const double edge = bx > 5 && by > 3;

			gd_row(p, y)[x] =
				(float)(kind == 0   ? 2 + edge + 0.01 * by
					: kind < 4  ? 0.2 * kind + 0.5 * edge + 0.1 * sin(0.5 * bx)
					: kind == 4 ? edge
					: kind == 5 ? 1 - edge
						    : 0.1 * bx);
		}
	return rc;
}

static void each(struct gd_image *im, const char *prefix,
		 double (*f)(double v, int x, int y, int w, int h))
{
	for (int i = 0; i < im->nchan; i++) {
		struct gd_plane p = gd_plane_of(im->chan[i].v, im->w, im->h);

		if (strncmp(im->chan[i].name, prefix, strlen(prefix)))
			continue;
		for (int y = 0; y < im->h; y++)
			for (int x = 0; x < im->w; x++)
				gd_row(p, y)[x] = (float)f(gd_row(p, y)[x], x, y, im->w, im->h);
	}
}

static double zero(double v, int x, int y, int w, int h)
{
	(void)v; (void)x; (void)y; (void)w; (void)h;
	return 0;
}

static double stripes(double v, int x, int y, int w, int h)
{
	(void)y; (void)w; (void)h;
	return x % 8 < 4 ? 0 : v;
}

static double one_nan(double v, int x, int y, int w, int h)
{
	return x == w / 2 && y == h / 2 ? NAN : v;
}

static double all_nan(double v, int x, int y, int w, int h)
{
	(void)v; (void)x; (void)y; (void)w; (void)h;
	return NAN;
}

static double one_inf(double v, int x, int y, int w, int h)
{
	return x == w / 3 && y == h / 3 ? (x % 2 ? INFINITY : -INFINITY) : v;
}

static double firefly(double v, int x, int y, int w, int h)
{
	return x == w / 2 && y == h / 2 ? 1e30 : v;
}

static double denormal(double v, int x, int y, int w, int h)
{
	(void)x; (void)y; (void)w; (void)h;
	return v * 1e-40;
}

static double negative(double v, int x, int y, int w, int h)
{
	(void)w; (void)h;
	return (x + y) % 3 ? v : -v;
}

static double range(double v, int x, int y, int w, int h)	/* over 24 orders */
{
	(void)h;
	return (v + 1e-3) * pow(10, -12 + 24.0 * x / w) * (y % 2 ? 1 : 1e-3);
}

static double constant(double v, int x, int y, int w, int h)
{
	(void)v; (void)x; (void)y; (void)w; (void)h;
	return 0.7;
}

static double offset(double v, int x, int y, int w, int h)
{
	(void)x; (void)y; (void)w; (void)h;
	return v + 1e8;
}

/* A thousandth of it varies. */
static double wide_offset(double v, int x, int y, int w, int h)
{
	(void)x; (void)y; (void)w; (void)h;
	return 1e8 + 1e5 * v;
}

static double mask(double v, int x, int y, int w, int h)
{
	(void)x; (void)y; (void)w; (void)h;
	return v > 0.35;
}

static double dots(double v, int x, int y, int w, int h)	/* lone pixels */
{
	(void)v; (void)w; (void)h;
	return x % 7 == 3 && y % 5 == 2;
}

static bool is_variance(const char *name)
{
	return strstr(name, "variance");
}

/* Applies f to all variances. */
static void each_variance(struct gd_image *im, double (*f)(double v, int x, int y, int w, int h))
{
	for (int i = 0; i < im->nchan; i++)
		if (is_variance(im->chan[i].name))
			each(im, im->chan[i].name, f);
}

static void same_as(struct gd_image *im, const char *to, const char *from, double factor)
{
	struct gd_plane a, b;

	if (!gd_image_plane(im, to, &a) || !gd_image_plane(im, from, &b))
		return;
	for (int y = 0; y < im->h; y++)
		for (int x = 0; x < im->w; x++)
			gd_row(a, y)[x] = (float)factor * gd_row(b, y)[x];
}

static bool spoil(struct gd_image *im, const char *what)
{
	static const char *const features[] = { "albedo", "N.", "Z" };
	const struct {
		const char *name, *prefix;
		double (*f)(double v, int x, int y, int w, int h);
	} simple[] = {
		{"black", "", zero},
		{"nan", "", one_nan},
		{"inf", "", one_inf},
		{"nan-colour", "R", one_nan},
		{"nan-dx", "dx.R", one_nan},
		{"nan-bin", "bin0.", one_nan},
		{"all-nan", "", all_nan},
		{"firefly", "R", firefly},
		{"firefly-bin", "bin1", firefly},
		{"firefly-dx", "dx.R", firefly},
		{"denormal", "", denormal},
		{"negative", "", negative},
		{"constant-albedo", "albedo", constant},
		{"offset-z", "Z", offset},
		{"wide-offset", "N.", wide_offset},
		{"nan-albedo", "albedo.G", one_nan},
		{"inf-n", "N.X", one_inf},
	};

	for (size_t i = 0; i < sizeof simple / sizeof *simple; i++)
		if (!strcmp(what, simple[i].name))
			return each(im, simple[i].prefix, simple[i].f), true;
	if (!strcmp(what, "zero-variance"))
		each_variance(im, zero);
	else if (!strcmp(what, "striped-variance"))
		each_variance(im, stripes);
	else if (!strcmp(what, "wide-variance"))
		each_variance(im, range);
	else if (!strcmp(what, "nan-variance"))
		each_variance(im, one_nan);
	else if (!strcmp(what, "inf-variance"))
		each_variance(im, one_inf);
	else if (!strcmp(what, "flat")) {	/* all gradients zero */
		for (int i = 0; i < im->nchan; i++)
			if (strstr(im->chan[i].name, "dx.") || strstr(im->chan[i].name, "dy."))
				each(im, im->chan[i].name, zero);
	} else if (!strcmp(what, "constant-features")) {
		for (int i = 0; i < 3; i++)
			each(im, features[i], constant);
	} else if (!strcmp(what, "masks")) {
		each(im, "albedo", mask);
		each(im, "Z", dots);
	} else if (!strcmp(what, "collinear-features")) {
		same_as(im, "albedo.G", "albedo.R", 1);
		same_as(im, "albedo.B", "albedo.R", 3);
		same_as(im, "N.X", "albedo.R", -1);
		same_as(im, "Z", "albedo.R", 1e6);
	} else
		return false;
	return true;
}

/* World positions of a wall with a step. */
static int add_position(struct gd_image *im, struct gd_err *err)
{
	struct gd_plane p[3];
	int rc = gd_image_add(im, "P.X", &p[0], err);

	if (rc == GD_OK)
		rc = gd_image_add(im, "P.Y", &p[1], err);
	if (rc == GD_OK)
		rc = gd_image_add(im, "P.Z", &p[2], err);
	for (int y = 0; rc == GD_OK && y < im->h; y++)
		for (int x = 0; x < im->w; x++) {
			gd_row(p[0], y)[x] = 0.1f * (float)x;
			gd_row(p[1], y)[x] = 0.1f * (float)y;
			gd_row(p[2], y)[x] = x > 5 && y > 3 ? 3 : 2;
		}
	return rc;
}

/* Rounds to the nearest half; too large is infinite, below the least normal: steps of 2^-24. */
static uint16_t to_half(float v)
{
	const uint16_t sign = signbit(v) ? 0x8000 : 0;
	int e;
	double m = frexp(fabs((double)v), &e);
	long k;

	if (isnan(v))
		return 0x7e00;
	if (isinf(v) || fabs((double)v) >= 65520)
		return sign | 0x7c00;
	if (e < -13)
		return (uint16_t)(sign | lrint(ldexp(fabs((double)v), 24)));
	k = lrint(ldexp(m, 11)); /* 1024 .. 2048, the carry goes into the exponent by itself */
	return (uint16_t)(sign | (((e + 13) << 10) + k));
}

static int to_halves(struct gd_image *im)
{
	for (int i = 0; i < im->nchan; i++) {
		struct gd_channel *c = &im->chan[i];
		uint16_t *raw = malloc((size_t)im->w * (size_t)im->h * sizeof *raw);

		if (!raw)
			return GD_ENOMEM;
		for (int y = 0; y < im->h; y++)
			for (int x = 0; x < im->w; x++)
				raw[(size_t)y * (size_t)im->w + (size_t)x] =
					to_half(gd_row(gd_plane_of(c->v, im->w, im->h), y)[x]);
		free(c->v);
		c->v = NULL;
		c->raw = (unsigned char *)raw;
		c->type = GD_HALF;
		c->want = GD_PASS;
	}
	return GD_OK;
}

static bool starts(const char *name, void *prefix)
{
	return !strncmp(name, prefix, strlen(prefix));
}

static int build(struct gd_image *im, const struct scene *s, struct gd_err *err)
{
	static const char *const features[] = {"Z",   "albedo.R", "albedo.G", "albedo.B",
					       "N.X", "N.Y",	  "N.Z"};
	int rc = GD_OK;

	gd_image_init(im, s->w, s->h);
	for (int plane = 0; plane < 3 && rc == GD_OK; plane++)
		rc = add_estimates(im, s, plane, err);
	for (int i = 0; i < 7 && rc == GD_OK; i++)
		rc = add_feature(im, features[i], s, i, err);
	if (rc == GD_OK && s->bins)
		rc = gd_attr_set_int(im, "gd:bins", s->bins, err);
	if (rc == GD_OK)
		rc = gd_attr_set_int(im, "gd:samplesPerPixel", 2 * s->draws, err);
	return rc;
}

int main(int argc, char **argv)
{
	struct scene s = { .bins = 8, .seed = 1, .scale = 1 };
	struct gd_write_conf conf = { GD_NONE };
	struct gd_image im = { 0 };
	struct gd_err err = { 0 };
	int rc;

	if (argc < 4 || (s.w = atoi(argv[2])) < 1 || (s.h = atoi(argv[3])) < 1)
		return fprintf(stderr,
			       "usage: mkgd OUT.exr WIDTH HEIGHT [NAME=VALUE ...] [CASE ...]\n"),
		       2;
	for (int i = 4; i < argc; i++) {
		const char *v = strchr(argv[i], '=');

		if (starts(argv[i], "bins="))
			s.bins = atoi(v + 1) < MAX_BINS ? atoi(v + 1) : MAX_BINS;
		else if (starts(argv[i], "seed="))
			s.seed = (unsigned)atoi(v + 1);
		else if (starts(argv[i], "scale="))
			s.scale = atof(v + 1);
		else if (starts(argv[i], "turn="))
			s.turn = v[1];
		else if (starts(argv[i], "type="))
			s.half = !strcmp(v + 1, "half");
	}
	s.draws = s.bins ? s.bins : 8;
	rc = build(&im, &s, &err);
	for (int i = 4; i < argc && rc == GD_OK; i++) {
		if (starts(argv[i], "position="))
			rc = add_position(&im, &err);
		else if (starts(argv[i], "drop="))
			gd_image_drop_if(&im, starts, argv[i] + 5);
		else if (!strchr(argv[i], '=') && !spoil(&im, argv[i]))
			rc = gd_fail(&err, GD_EARG, "no case %s", argv[i]);
	}
	if (rc == GD_OK && s.half)
		rc = to_halves(&im);
	if (rc == GD_OK)
		rc = gd_exr_write(&im, argv[1], &conf, &err);
	gd_image_free(&im);
	if (rc != GD_OK)
		fprintf(stderr, "mkgd: %s\n", err.text);
	return rc == GD_OK ? 0 : 2;
}
