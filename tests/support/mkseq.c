/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * A sequence of frames made from one rendered frame that comes in bins: each frame takes its colour
 * (and gradients) from bins of its own, so that the noise of any two frames is independent, and
 * shows a part of the image that moves, changes its light, or is partly hidden by a moving object.
 *	mkseq SCENE OUTDIR KIND [NAME=VALUE ...]
 * SCENE has gpt16.exr and reference.exr (and path16eq.exr for input=plain). Written are
 * OUTDIR/frame0.exr ... and OUTDIR/ref0.exr ...
 * KIND, several joined by '+':
 *	static			nothing moves
 *	pan			the camera moves sideways, `step` pixels per frame
 *	object			a disc of another scene (object=DIR) in front moves 4 pixels per
 *				frame
 *	shadow			the edge of a shadow (light times 0.4) moves 3 pixels per frame
 *	ramp			all light times 1 + 0.05 t
 *	lamp			light around the middle grows by 8 % a frame, falling off in a bell
 *	sudden			all light times 1.6 in the second half of the sequence
 * input=gpt16		4 frames of 2 bins each, with gradients; only gpt16.exr is needed
 * input=plain		8 frames of 2 bins each, one of path16eq.exr, one of gpt16.exr (without its
 *			gradients); features are those of gpt16.exr
 * step=3, width=232, height=192: of the part shown
 * shrink=1: pixels averaged into one, each way; with shrink=2 and step=3 motion is 1.5 pixels
 * Features have variances; to them noise is added, other in each frame, as much as fewer samples
 * would have. Not real: the features of all frames share the noise that they had to begin with;
 * the world positions of the disc are those of a board in front of the camera, under which its
 * picture moves.
 * Channels of a ref: R G B and halves (noise-free light); source.X source.Y: the pixel of the scene
 * shown here; object: 1 on the disc; light: what the scene was multiplied by; edge: 1 within 5
 * pixels of the disc's rim, where the disc was one frame ago, and near a moving shadow's edge.
 */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "buffers.h"
#include "exr.h"

#define BINS 2

struct scene {
	struct gd_image gpt, path, ref;
};

struct seq {
	struct scene back, disc;
	bool pan, object, shadow, ramp, lamp, sudden, plain;
	int frames, step, w, h, shrink;
};

/* ---- what is where ---- */

static double disc_x(const struct seq *s, int t)
{
	return s->w * s->shrink * 0.3 + 4.0 * t;
}

static bool on_disc(const struct seq *s, int t, int x, int y)
{
	const double dx = x - disc_x(s, t), dy = y - s->h * s->shrink * 0.55 - t;

	return s->object && dx * dx + dy * dy < 34.0 * 34.0;
}

static double shadow_x(const struct seq *s, int t, int y)
{
	return s->w * s->shrink * 0.4 + 3.0 * t + 0.2 * y;
}

static double light(const struct seq *s, int t, int x, int y)
{
	double l = 1;

	if (s->ramp)
		l *= 1 + 0.05 * t;
	if (s->lamp)
		l *= 1 + 0.08 * t * exp(-(pow(x - 0.5 * s->w * s->shrink, 2) +
					  pow(y - 0.5 * s->h * s->shrink, 2)) / (2 * 50.0 * 50.0));
	if (s->sudden && 2 * t >= s->frames)
		l *= 1.6;
	if (s->shadow && x > shadow_x(s, t, y))
		l *= 0.4;
	return l;
}

static bool on_edge(const struct seq *s, int t, int x, int y)
{
	if (s->shadow && x > shadow_x(s, t, y) - 6 && x < shadow_x(s, t, y) + 6)
		return true;
	if (!s->object)
		return false;
	if (!on_disc(s, t, x, y) && t && on_disc(s, t - 1, x, y))
		return true;
	for (int dy = -5; dy <= 5; dy++)
		for (int dx = -5; dx <= 5; dx++)
			if (on_disc(s, t, x + dx, y + dy) != on_disc(s, t, x, y))
				return true;
	return false;
}

/* Pixel of the scene that (x, y) of frame t shows; the disc moves with its picture. */
static void source(const struct seq *s, int t, bool disc, int x, int y, int at[2])
{
	at[0] = disc ? x - 4 * t : x + (s->pan ? s->step * t : 0);
	at[1] = disc ? y - t : y;
}

static float value(const struct gd_plane p, const int at[2])
{
	const int x = at[0] < 0 ? 0 : at[0] >= p.w ? p.w - 1 : at[0];
	const int y = at[1] < 0 ? 0 : at[1] >= p.h ? p.h - 1 : at[1];

	return gd_row(p, y)[x];
}

/* ---- planes of a frame, before it is made smaller ---- */

enum kind { COLOUR, DX, DY, FEATURE, VARIANCE };

struct layer {
	struct gd_plane back, disc;	/* the channel in either scene */
	struct gd_plane back_colour, disc_colour;	/* of DX, DY: the colour of that bin */
	enum kind kind;
};

static double colour_at(const struct seq *s, int t, struct gd_plane back, struct gd_plane disc,
			int x, int y)
{
	const bool d = on_disc(s, t, x, y);
	int at[2];

	source(s, t, d, x, y, at);
	return (double)value(d ? disc : back, at) * light(s, t, x, y);
}

static double sample(const struct seq *s, int t, const struct layer *l, int x, int y)
{
	const int x1 = x + (l->kind == DX), y1 = y + (l->kind == DY);
	const bool d = on_disc(s, t, x, y);
	int at[2];

	if (l->kind == COLOUR)
		return colour_at(s, t, l->back, l->disc, x, y);
	source(s, t, d, x, y, at);
	if (l->kind >= FEATURE)
		return (double)value(d ? l->disc : l->back, at);
	if (d == on_disc(s, t, x1, y1)) {
		const double here = light(s, t, x, y), there = light(s, t, x1, y1);
		const double next = here == there ? 0 :
			colour_at(s, t, l->back_colour, l->disc_colour, x1, y1) / there;

		return (double)value(d ? l->disc : l->back, at) * here + next * (there - here);
	}
	return colour_at(s, t, l->back_colour, l->disc_colour, x1, y1) -
	       colour_at(s, t, l->back_colour, l->disc_colour, x, y);
}

static void fill(const struct seq *s, int t, const struct layer *l, struct gd_plane to)
{
	const int k = s->shrink;

	for (int y = 0; y < s->h; y++)
		for (int x = 0; x < s->w; x++) {
			const bool last = (l->kind == DX && x == s->w - 1) ||
					  (l->kind == DY && y == s->h - 1);
			double sum = 0;

			for (int j = 0; j < k && !last; j++)
				for (int i = 0; i < k; i++)
					for (int m = 0; m < (l->kind <= DY && l->kind ? k : 1); m++)
						sum += sample(s, t, l,
							      k * x + i + (l->kind == DX ? m : 0),
							      k * y + j + (l->kind == DY ? m : 0));
			sum /= k * k;
			gd_row(to, y)[x] = (float)(l->kind == VARIANCE ? sum / (k * k) : sum);
		}
}

/* ---- layers ---- */

static int add_bin(const struct seq *s, struct gd_image *im, int t, int b, enum kind kind,
		   struct gd_err *err)
{
	static const char *const suffix[] = { "", ".dx", ".dy" };
	const bool path = s->plain && !b;
	const struct gd_image *back = path ? &s->back.path : &s->back.gpt;
	const struct gd_image *disc = path ? &s->disc.path : &s->disc.gpt;
	const int from = s->plain ? t : BINS * t + b;
	struct gd_plane to[GD_LAYER_PLANES], p[4][GD_LAYER_PLANES];
	char name[64];
	int rc;

	snprintf(name, sizeof name, "bin%d", from);
	gd_layer_planes(back, name, p[2]);
	gd_layer_planes(disc, name, p[3]);
	snprintf(name, sizeof name, "bin%d%s", from, suffix[kind]);
	if (gd_layer_planes(back, name, p[0]) != 3 || gd_layer_planes(disc, name, p[1]) != 3)
		return gd_fail(err, GD_ESHAPE, "no layer %s", name);
	snprintf(name, sizeof name, "bin%d%s", b, suffix[kind]);
	rc = gd_layer_add(im, name, 3, to, err);
	for (int c = 0; c < 3 && rc == GD_OK; c++)
		fill(s, t, &(struct layer){ p[0][c], p[1][c], p[2][c], p[3][c], kind }, to[c]);
	return rc;
}

/* Mean and variance of the mean from the two bins. */
static int add_mean(struct gd_image *im, enum kind kind, struct gd_err *err)
{
	static const char *const mean[] = { "", "dx", "dy" }, *const bin[] = { "", ".dx", ".dy" };
	struct gd_plane m[GD_LAYER_PLANES], v[GD_LAYER_PLANES], p[BINS][GD_LAYER_PLANES];
	char name[64];
	int rc = gd_layer_add(im, mean[kind], 3, m, err);

	snprintf(name, sizeof name, "%s%svariance", mean[kind], *mean[kind] ? "." : "");
	if (rc == GD_OK)
		rc = gd_layer_add(im, name, 3, v, err);
	for (int b = 0; b < BINS; b++) {
		snprintf(name, sizeof name, "bin%d%s", b, bin[kind]);
		gd_layer_planes(im, name, p[b]);
	}
	for (int i = 0; i < 3 * im->h && rc == GD_OK; i++)
		for (int c = i / im->h, y = i % im->h, x = 0; x < im->w; x++) {
			const float a = gd_row(p[0][c], y)[x], b = gd_row(p[1][c], y)[x];

			gd_row(m[c], y)[x] = 0.5f * (a + b);
			gd_row(v[c], y)[x] = 0.25f * (a - b) * (a - b);
		}
	return rc;
}

/* A sum of four uniform numbers, variance 1, a function of its arguments. */
static double noise(int t, int c, int x, int y)
{
	uint64_t k = ((uint64_t)t << 56) ^ ((uint64_t)c << 48) ^ ((uint64_t)x << 24) ^ (uint64_t)y;
	double sum = 0;

	for (int i = 0; i < 4; i++) {
		k += 0x9e3779b97f4a7c15u;
		k = (k ^ (k >> 30)) * 0xbf58476d1ce4e5b9u;
		k = (k ^ (k >> 27)) * 0x94d049bb133111ebu;
		k ^= k >> 31;
		sum += (double)(k >> 11) / 9007199254740992.0 - 0.5;
	}
	return sum * 1.7320508;
}

/*
 * World positions on the disc: a board nearer than everything behind it, of the same place for the
 * same place on the screen.
 */
static void board(const struct seq *s, int t, const struct gd_plane *p)
{
	double mean[3] = { 0 }, var[3] = { 0 };
	const double n = (double)s->w * s->h;

	for (int c = 0; c < 3; c++) {
		for (int i = 0; i < s->w * s->h; i++)
			mean[c] += (double)gd_row(p[c], i / s->w)[i % s->w] / n;
		for (int i = 0; i < s->w * s->h; i++)
			var[c] += pow((double)gd_row(p[c], i / s->w)[i % s->w] - mean[c], 2) / n;
	}
	for (int y = 0; y < s->h; y++)
		for (int x = 0; x < s->w; x++) {
			if (!on_disc(s, t, x * s->shrink, y * s->shrink))
				continue;
			gd_row(p[0], y)[x] =
				(float)(mean[0] + sqrt(var[0]) * (3.0 * x / s->w - 1.5));
			gd_row(p[1], y)[x] =
				(float)(mean[1] + sqrt(var[1]) * (3.0 * y / s->h - 1.5));
			gd_row(p[2], y)[x] = (float)(mean[2] + 3 * sqrt(var[2]));
		}
}

static int add_feature(const struct seq *s, struct gd_image *im, int t, int at, const char *layer,
		       struct gd_err *err)
{
	static const char *const xyz[] = { "X", "Y", "Z" }, *const rgb[] = { "R", "G", "B" };
	/* 8 bins, 2 in a frame */
	const double fewer = s->plain ? 1 : 4.0 / s->shrink / s->shrink;
	struct gd_layer names = gd_layer_find(&s->back.gpt, layer);
	struct gd_plane p[GD_LAYER_PLANES], q[GD_LAYER_PLANES], pv[GD_LAYER_PLANES],
		qv[GD_LAYER_PLANES], to[GD_LAYER_PLANES], tv[GD_LAYER_PLANES];
	int n = gd_layer_planes(&s->back.gpt, layer, p), rc = GD_OK;

	if (!n || gd_layer_planes(&s->disc.gpt, layer, q) != n ||
	    gd_layer_variance_planes(&s->back.gpt, layer, pv) != n ||
	    gd_layer_variance_planes(&s->disc.gpt, layer, qv) != n)
		return gd_fail(err, GD_ESHAPE, "no layer %s with variances", layer);
	for (int c = 0; c < n && rc == GD_OK; c++) {
		char name[64];

		rc = gd_image_add(im, names.name[c], to + c, err);
		snprintf(name, sizeof name, "%s.variance%s%s", layer, n > 1 ? "." : "",
			 n == 1 ? "" : strcmp(layer, "albedo") ? xyz[c] : rgb[c]);
		if (rc == GD_OK)
			rc = gd_image_add(im, name, tv + c, err);
		if (rc != GD_OK)
			break;
		fill(s, t, &(struct layer){ .back = p[c], .disc = q[c], .kind = FEATURE }, to[c]);
		fill(s, t, &(struct layer){ .back = pv[c], .disc = qv[c], .kind = VARIANCE },
		     tv[c]);
	}
	if (rc == GD_OK && !strcmp(layer, "P"))
		board(s, t, to);
	for (int i = 0; i < n * s->h && rc == GD_OK; i++)
		for (int c = i / s->h, y = i % s->h, x = 0; x < s->w; x++) {
			float *v = gd_row(tv[c], y) + x;

			if (!strcmp(layer, "P") && on_disc(s, t, x * s->shrink, y * s->shrink))
				*v = 0;
			gd_row(to[c], y)[x] += (float)(sqrt((double)*v * fmax(fewer - 1, 0)) *
						       noise(t, at + c, x, y));
			*v *= (float)fewer;
		}
	return rc;
}

static int make_frame(const struct seq *s, struct gd_image *im, int t, struct gd_err *err)
{
	static const char *const feature[] = { "albedo", "N", "Z", "P" };
	int rc = GD_OK;

	gd_image_init(im, s->w, s->h);
	for (enum kind kind = COLOUR; kind <= (s->plain ? COLOUR : DY) && rc == GD_OK; kind++) {
		for (int b = 0; b < BINS && rc == GD_OK; b++)
			rc = add_bin(s, im, t, b, kind, err);
		if (rc == GD_OK)
			rc = add_mean(im, kind, err);
	}
	for (int i = 0; i < 4 && rc == GD_OK; i++)
		rc = add_feature(s, im, t, 3 * i, feature[i], err);
	if (rc == GD_OK)
		rc = gd_attr_set_int(im, "gd:bins", BINS, err);
	return rc == GD_OK ? gd_attr_set_int(im, "gd:frame", t, err) : rc;
}

static int make_ref(const struct seq *s, struct gd_image *im, int t, struct gd_err *err)
{
	static const char *const layer[] = { "", "half0", "half1" };
	static const char *const extra[] = { "source.X", "source.Y", "object", "light", "edge" };
	struct gd_plane to[GD_LAYER_PLANES], p[GD_LAYER_PLANES], q[GD_LAYER_PLANES], e[5];
	int rc = GD_OK;

	gd_image_init(im, s->w, s->h);
	for (int i = 0; i < 3 && rc == GD_OK; i++) {
		if (gd_layer_planes(&s->back.ref, layer[i], p) != 3 ||
		    gd_layer_planes(&s->disc.ref, layer[i], q) != 3)
			return gd_fail(err, GD_ESHAPE, "no halves in a reference");
		rc = gd_layer_add(im, layer[i], 3, to, err);
		for (int c = 0; c < 3 && rc == GD_OK; c++)
			fill(s, t, &(struct layer){ .back = p[c], .disc = q[c] }, to[c]);
	}
	for (int i = 0; i < 5 && rc == GD_OK; i++)
		rc = gd_image_add(im, extra[i], e + i, err);
	for (int i = 0; i < s->w * s->h && rc == GD_OK; i++) {
		const int x = i % s->w * s->shrink, y = i / s->w * s->shrink;
		const bool d = on_disc(s, t, x, y);
		int at[2];

		source(s, t, d, x, y, at);
		gd_row(e[0], i / s->w)[i % s->w] = (float)at[0];
		gd_row(e[1], i / s->w)[i % s->w] = (float)at[1];
		gd_row(e[2], i / s->w)[i % s->w] = d;
		gd_row(e[3], i / s->w)[i % s->w] = (float)light(s, t, x, y);
		gd_row(e[4], i / s->w)[i % s->w] = on_edge(s, t, x, y);
	}
	return rc;
}

/* ---- files ---- */

static int load(struct gd_image *im, const char *dir, const char *name, struct gd_err *err)
{
	struct gd_exr *file = NULL;
	char path[4096];
	int rc;

	snprintf(path, sizeof path, "%s/%s", dir, name);
	rc = gd_exr_open(&file, im, path, NULL, err);
	for (int c = 0; c < im->nchan; c++)
		im->chan[c].want = GD_READ;
	if (rc == GD_OK)
		rc = gd_exr_load(file, im, err);
	gd_exr_close(file);
	return rc;
}

static int load_scene(struct scene *s, const char *dir, bool plain, struct gd_err *err)
{
	int rc = load(&s->gpt, dir, "gpt16.exr", err);

	if (rc == GD_OK && plain)
		rc = load(&s->path, dir, "path16eq.exr", err);
	return rc == GD_OK ? load(&s->ref, dir, "reference.exr", err) : rc;
}

static void free_scene(struct scene *s)
{
	gd_image_free(&s->gpt);
	gd_image_free(&s->path);
	gd_image_free(&s->ref);
}

static int write_frame(const struct seq *s, const char *dir, int t, struct gd_err *err)
{
	int (*const make[])(const struct seq *, struct gd_image *, int, struct gd_err *) = {
		make_frame, make_ref };
	static const char *const name[] = { "frame", "ref" };
	int rc = GD_OK;

	for (int i = 0; i < 2 && rc == GD_OK; i++) {
		struct gd_image im = { 0 };
		char path[4096];

		snprintf(path, sizeof path, "%s/%s%d.exr", dir, name[i], t);
		rc = make[i](s, &im, t, err);
		if (rc == GD_OK)
			rc = gd_exr_write(&im, path, NULL, err);
		gd_image_free(&im);
	}
	return rc;
}

static bool parse(struct seq *s, const char *kind, int n, char **option, const char **object)
{
	*s = (struct seq){ .pan = strstr(kind, "pan"), .object = strstr(kind, "object"),
			   .shadow = strstr(kind, "shadow"), .ramp = strstr(kind, "ramp"),
			   .lamp = strstr(kind, "lamp"), .sudden = strstr(kind, "sudden"),
			   .step = 3, .w = 232, .h = 192, .shrink = 1 };
	for (int i = 0; i < n; i++) {
		if (!strncmp(option[i], "step=", 5))
			s->step = atoi(option[i] + 5);
		else if (!strncmp(option[i], "width=", 6))
			s->w = atoi(option[i] + 6);
		else if (!strncmp(option[i], "height=", 7))
			s->h = atoi(option[i] + 7);
		else if (!strncmp(option[i], "shrink=", 7))
			s->shrink = atoi(option[i] + 7);
		else if (!strncmp(option[i], "object=", 7))
			*object = option[i] + 7;
		else if (!strcmp(option[i], "input=plain"))
			s->plain = true;
		else if (strcmp(option[i], "input=gpt16") != 0)
			return false;
	}
	s->frames = s->plain ? 8 : 4;
	s->w /= s->shrink > 0 ? s->shrink : 1;
	s->h /= s->shrink > 0 ? s->shrink : 1;
	return s->w > 0 && s->h > 0 && s->shrink > 0;
}

int main(int argc, char **argv)
{
	struct seq s = { 0 };
	struct gd_err err = { 0 };
	const char *object = argc > 1 ? argv[1] : "";
	int rc;

	if (argc < 4 || !parse(&s, argv[3], argc - 4, argv + 4, &object))
		return fprintf(stderr, "usage: mkseq SCENE OUTDIR KIND [NAME=VALUE ...]\n"), 2;
	mkdir(argv[2], 0777);
	rc = load_scene(&s.back, argv[1], s.plain, &err);
	if (rc == GD_OK)
		rc = load_scene(&s.disc, s.object ? object : argv[1], s.plain, &err);
	for (int t = 0; t < s.frames && rc == GD_OK; t++)
		rc = write_frame(&s, argv[2], t, &err);
	free_scene(&s.back);
	free_scene(&s.disc);
	if (rc != GD_OK)
		fprintf(stderr, "mkseq: %s\n", err.text);
	return rc == GD_OK ? 0 : 2;
}
