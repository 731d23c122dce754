/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * How steady and how right a denoised sequence is, against the noise-free sequence that mkseq made.
 *	flicker SEQUENCE METHOD [METHOD ...]
 * SEQUENCE is a folder of ref0.exr, ref1.exr ..., METHOD the start of the names of results in it:
 * "d" is d0.exr, d1.exr ... One row of tab-separated values each:
 *	flicker	variance over the frames, times 1000: of what a point of the scene looks like,
 *		relative to reference^2 + 0.01, light divided out; mean over the channels and the
 *		points that are seen in half of the frames at least, no moving thing or its edge
 *		near in any of them
 *	late	the same from frame to frame in the second half of the sequence: half the squared
 *		difference of a frame to the one before
 *	relmse	mean over all frames (free of the reference's noise)
 *	last	of the last frame
 *	edge	in pixels near moving edges, or where something was uncovered
 *	object	in pixels of the moving object
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "buffers.h"
#include "exr.h"
#include "relmse.h"

#define FRAMES 64
#define MARGIN 256	/* scene pixels may lie this far outside */

struct refs {
	struct gd_image im[FRAMES];
	struct gd_plane r[FRAMES][3], a[FRAMES][3], b[FRAMES][3];
	struct gd_plane source[FRAMES][2], object[FRAMES], light[FRAMES], edge[FRAMES];
	int n, w, h;
};

/* One point of the scene over time, from 0 at its first frame. */
struct point {
	double sum[3], sum2[3], ref[3], step, last[3];
	int n, steps, seen;	/* seen: number of the last frame, from 1 */
	bool moving;
};

struct score {
	double flicker, late, relmse, last, edge, object;
};

static int load(struct gd_image *im, const char *path, struct gd_err *err)
{
	struct gd_exr *file = NULL;
	int rc = gd_exr_open(&file, im, path, NULL, err);

	for (int c = 0; c < im->nchan; c++)
		im->chan[c].want = GD_READ;
	if (rc == GD_OK)
		rc = gd_exr_load(file, im, err);
	gd_exr_close(file);
	return rc;
}

static int load_refs(struct refs *s, const char *dir, struct gd_err *err)
{
	char path[4096];
	int rc = GD_OK;

	for (s->n = 0; s->n < FRAMES && rc == GD_OK; s->n++) {
		const int t = s->n;
		struct gd_plane p[3][GD_LAYER_PLANES];
		bool ok;

		snprintf(path, sizeof path, "%s/ref%d.exr", dir, t);
		if (t && access(path, R_OK))
			break;
		rc = load(&s->im[t], path, err);
		ok = rc == GD_OK && gd_layer_planes(&s->im[t], "", p[0]) == 3 &&
		     gd_layer_planes(&s->im[t], "half0", p[1]) == 3 &&
		     gd_layer_planes(&s->im[t], "half1", p[2]) == 3 &&
		     gd_image_plane(&s->im[t], "source.X", &s->source[t][0]) &&
		     gd_image_plane(&s->im[t], "source.Y", &s->source[t][1]) &&
		     gd_image_plane(&s->im[t], "object", &s->object[t]) &&
		     gd_image_plane(&s->im[t], "light", &s->light[t]) &&
		     gd_image_plane(&s->im[t], "edge", &s->edge[t]);
		if (rc == GD_OK && !ok)
			rc = gd_fail(err, GD_ESHAPE, "%s is not of mkseq", path);
		memcpy(s->r[t], p[0], sizeof s->r[t]);
		memcpy(s->a[t], p[1], sizeof s->a[t]);
		memcpy(s->b[t], p[2], sizeof s->b[t]);
		s->w = s->im[0].w;
		s->h = s->im[0].h;
	}
	return rc;
}

static void take(struct point *p, const struct refs *s, const struct gd_plane *v, int t, int x,
		 int y)
{
	const double l = (double)gd_row(s->light[t], y)[x];
	const bool next = p->seen == t && 2 * t >= s->n;
	double step = 0;

	p->moving = p->moving || gd_row(s->edge[t], y)[x] > 0;
	for (int c = 0; c < 3; c++) {
		const double out = (double)gd_row(v[c], y)[x] / l;
		const double ref = (double)gd_row(s->r[t][c], y)[x] / l;

		p->sum[c] += out;
		p->sum2[c] += out * out;
		p->ref[c] = ref;
		step += (out - p->last[c]) * (out - p->last[c]) / (ref * ref + 0.01) / 6;
		p->last[c] = out;
	}
	p->step += next ? step : 0;
	p->steps += next;
	p->n++;
	p->seen = t + 1;
}

static int flicker(struct score *score, const struct refs *s, struct gd_plane (*v)[3],
		   struct gd_err *err)
{
	const int w = s->w * 2 + 2 * MARGIN, h = s->h * 2 + 2 * MARGIN;
	struct point *p = gd_calloc((size_t)w * (size_t)h, sizeof *p);
	size_t n = 0, steps = 0;

	if (!p)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	for (int i = 0; i < s->n * s->w * s->h; i++) {
		const int t = i / (s->w * s->h), y = i / s->w % s->h, x = i % s->w;
		const int px = (int)gd_row(s->source[t][0], y)[x] + MARGIN;
		const int py = (int)gd_row(s->source[t][1], y)[x] + MARGIN;

		if (gd_row(s->object[t], y)[x] > 0 || px < 0 || py < 0 || px >= w || py >= h)
			continue;
		take(p + (size_t)py * (size_t)w + (size_t)px, s, v[t], t, x, y);
	}
	for (int i = 0; i < w * h; i++) {
		if (p[i].moving || p[i].n < 2 || 2 * p[i].n < s->n)
			continue;
		for (int c = 0; c < 3; c++)
			score->flicker += (p[i].sum2[c] - p[i].sum[c] * p[i].sum[c] / p[i].n) /
					  (p[i].n - 1) / (p[i].ref[c] * p[i].ref[c] + 0.01) / 3;
		n++;
		score->late += p[i].step;
		steps += (size_t)p[i].steps;
	}
	score->flicker = n ? 1000 * score->flicker / (double)n : NAN;
	score->late = steps ? 1000 * score->late / (double)steps : NAN;
	free(p);
	return GD_OK;
}

/* Mean over the frames, each weighing by its pixels; NaN where there are none. */
static int error(double *mean, const struct refs *s, struct gd_plane (*v)[3], int first,
		 const struct gd_plane *mask, struct gd_err *err)
{
	const struct gd_relmse_conf conf = GD_RELMSE_DEFAULTS;
	double sum = 0, n = 0;

	for (int t = first; t < s->n; t++) {
		struct gd_relmse_in in = { .n = 3, .halves = true };
		struct gd_err none = { 0 };
		struct gd_relmse res;
		int rc;

		for (int c = 0; c < 3; c++) {
			in.x[c] = v[t][c];
			in.a[c] = s->a[t][c];
			in.b[c] = s->b[t][c];
		}
		if (mask)
			in.mask = mask[t];
		rc = gd_relmse(&res, NULL, &in, &conf, &none);
		if (rc == GD_ENUMERIC)
			continue;
		if (rc != GD_OK)
			return gd_fail(err, rc, "%s", none.text);
		sum += res.relmse * (double)res.pixels;
		n += (double)res.pixels;
	}
	*mean = n > 0 ? sum / n : NAN;
	return GD_OK;
}

static int judge(struct score *score, const struct refs *s, const char *dir, const char *method,
		 struct gd_err *err)
{
	struct gd_image im[FRAMES] = { 0 };
	struct gd_plane v[FRAMES][3];
	int rc = GD_OK;

	*score = (struct score){ 0 };
	for (int t = 0; t < s->n && rc == GD_OK; t++) {
		struct gd_plane p[GD_LAYER_PLANES];
		char path[4096];

		snprintf(path, sizeof path, "%s/%s%d.exr", dir, method, t);
		rc = load(&im[t], path, err);
		if (rc == GD_OK && (gd_layer_planes(&im[t], "", p) != 3 || p[0].w != s->w ||
				    p[0].h != s->h))
			rc = gd_fail(err, GD_ESHAPE, "%s: not a frame of this sequence", path);
		memcpy(v[t], p, sizeof v[t]);
	}
	if (rc == GD_OK)
		rc = flicker(score, s, v, err);
	if (rc == GD_OK)
		rc = error(&score->relmse, s, v, 0, NULL, err);
	if (rc == GD_OK)
		rc = error(&score->last, s, v, s->n - 1, NULL, err);
	if (rc == GD_OK)
		rc = error(&score->edge, s, v, 1, s->edge, err);
	if (rc == GD_OK)
		rc = error(&score->object, s, v, 1, s->object, err);
	for (int t = 0; t < s->n; t++)
		gd_image_free(&im[t]);
	return rc;
}

int main(int argc, char **argv)
{
	struct refs *s = calloc(1, sizeof *s);
	struct gd_err err = { 0 };
	struct score score;
	const char *name;
	int rc;

	if (!s || argc < 3)
		return fprintf(stderr, "usage: flicker SEQUENCE METHOD [METHOD ...]\n"), 2;
	name = strrchr(argv[1], '/') ? strrchr(argv[1], '/') + 1 : argv[1];
	rc = load_refs(s, argv[1], &err);
	for (int i = 2; i < argc && rc == GD_OK; i++) {
		rc = judge(&score, s, argv[1], argv[i], &err);
		if (rc == GD_OK)
			printf("%s\t%s\t%.4f\t%.4f\t%.6f\t%.6f\t%.6f\t%.6f\n", name, argv[i],
			       score.flicker, score.late, score.relmse, score.last, score.edge,
			       score.object);
	}
	for (int t = 0; t < FRAMES; t++)
		gd_image_free(&s->im[t]);
	free(s);
	if (rc != GD_OK)
		fprintf(stderr, "flicker: %s\n", err.text);
	return rc == GD_OK ? 0 : 2;
}
