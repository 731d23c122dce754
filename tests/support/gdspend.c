/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Spends samples that were drawn beforehand: of a buffer with bins, each pixel of the result knows
 * the first BASE bins and as many more as a sampling map says, and no others.
 *	gdspend [-a] [-p] [-e both|mean|either] BINS.exr OUT.exr BASE [MAP.exr|COUNT]
 * MAP.exr: its channel "sampling", in bins; COUNT: the same for all pixels; neither: none.
 * The bins beyond BASE know nothing of the map, so that every mean stays unbiased.
 *
 * A gradient joins two pixels. It gets as many bins as both have, or with -e as they have in the
 * mean (a half: rounded up on black squares of a chessboard, down on white ones), or as either has.
 *
 * Written: means, the variance of the mean from the spread of the bins at hand, half0 and half1
 * (the even and the odd bins at hand), the halves again as bin0 and bin1, and samples, those of the
 * halves, too. A bin is on the same side everywhere: neighbours share noise in gradient-domain
 * renders, and halves must not.
 * With -a and equal counts everywhere the bins stay apart.
 * -p: a pass of its own, which knows the bins beyond BASE only; 0 where there are none.
 * G-buffers have no bins: they stay.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "buffers.h"
#include "exr.h"

enum edges { BOTH, MEAN, EITHER };

struct spend {
	struct gd_image *in, out;
	int bins;
	double spp;		/* samples of a bin */
	enum edges edges;
	int first;		/* bin of a pass: those before are left out */
	int apart;		/* bins written one by one; 0: the halves again as two */
	int *count;		/* bins of each pixel */
};

static int at(const struct spend *s, int x, int y)
{
	int w = s->in->w, h = s->in->h;

	return s->count[(size_t)(y < h ? y : h - 1) * (size_t)w + (size_t)(x < w ? x : w - 1)];
}

/* Bins of pixel x, y of a layer. */
static int bins_at(const struct spend *s, const char *layer, int x, int y)
{
	int a = at(s, x, y), b = !strcmp(layer, "dx") ? at(s, x + 1, y) :
				 !strcmp(layer, "dy") ? at(s, x, y + 1) : a;

	if (s->edges == MEAN)
		return (a + b + (x + y) % 2) / 2;
	return s->edges == BOTH ? (a < b ? a : b) : a > b ? a : b;
}

static int add(struct spend *s, const char *part, const char *layer, struct gd_plane p[4],
	       struct gd_err *err)
{
	char name[256];

	snprintf(name, sizeof name, "%s%s%s", part, *part && *layer ? "." : "", layer);
	return gd_layer_add(&s->out, name, 3, p, err);
}

static int copy_bin(struct spend *s, const char *name, const struct gd_plane *from,
		    struct gd_err *err)
{
	struct gd_plane to[4];
	int rc = gd_layer_add(&s->out, name, 3, to, err);

	for (int c = 0; c < 3 && rc == GD_OK; c++)
		for (int y = 0; y < to[c].h; y++)
			memcpy(gd_row(to[c], y), gd_row(from[c], y),
			       (size_t)to[c].w * sizeof(float));
	return rc;
}

/* What becomes of one channel of a layer. */
struct spent {
	struct gd_plane bin[GD_MAX_BINS], mean, var, half[2], copy[2];
};

/* Pixel x, y from the n bins from first on. */
static void spend_pixel(const struct spent *to, int first, int n, int x, int y)
{
	double sum[2] = { 0 }, square = 0, mean;

	for (int b = 0; b < n; b++)
		sum[b % 2] += (double)gd_row(to->bin[first + b], y)[x];
	mean = n ? (sum[0] + sum[1]) / n : 0;
	for (int b = 0; b < n; b++)
		square += pow((double)gd_row(to->bin[first + b], y)[x] - mean, 2);
	gd_row(to->mean, y)[x] = (float)mean;
	gd_row(to->var, y)[x] = n > 1 ? (float)(square / n / (n - 1)) : 0;
	for (int h = 0; h < 2; h++) {
		int k = (n + 1 - h) / 2;
		float v = k ? (float)(sum[h] / k) : 0;

		gd_row(to->half[h], y)[x] = v;
		if (to->copy[h].v)
			gd_row(to->copy[h], y)[x] = v;
	}
}

/* The channels of a layer, old and new. */
static int open_layer(struct spend *s, const char *layer, struct spent *to, struct gd_err *err)
{
	struct gd_plane mean[4], var[4], half[2][4], copy[2][4] = { { { 0 } } }, bin[4];
	char name[256];
	int rc = add(s, "", layer, mean, err);

	snprintf(name, sizeof name, *layer ? "%s.variance" : "variance%s", layer);
	if (rc == GD_OK)
		rc = add(s, "", name, var, err);
	for (int h = 0; h < 2 && rc == GD_OK; h++) {
		rc = add(s, h ? "half1" : "half0", layer, half[h], err);
		if (rc == GD_OK && !s->apart)
			rc = add(s, h ? "bin1" : "bin0", layer, copy[h], err);
	}
	for (int c = 0; c < 3 && rc == GD_OK; c++)
		to[c] = (struct spent){ .mean = mean[c], .var = var[c],
					.half = { half[0][c], half[1][c] },
					.copy = { copy[0][c], copy[1][c] } };
	for (int b = 0; b < s->bins && rc == GD_OK; b++) {
		snprintf(name, sizeof name, *layer ? "bin%d.%s" : "bin%d", b, layer);
		if (gd_layer_planes(s->in, name, bin) != 3)
			return gd_fail(err, GD_ESHAPE, "no layer %s", name);
		for (int c = 0; c < 3; c++)
			to[c].bin[b] = bin[c];
		if (b < s->apart)
			rc = copy_bin(s, name, bin, err);
	}
	return rc;
}

static int spend_layer(struct spend *s, const char *layer, struct gd_err *err)
{
	struct spent to[3];
	int rc = open_layer(s, layer, to, err);

	for (int c = 0; c < 3 && rc == GD_OK; c++)
		for (int y = 0; y < s->in->h; y++)
			for (int x = 0; x < s->in->w; x++)
				spend_pixel(&to[c], s->first, bins_at(s, layer, x, y), x, y);
	return rc;
}


static int read_all(struct gd_image *im, const char *path, const char *only, struct gd_err *err)
{
	struct gd_exr *file = NULL;
	int rc = gd_exr_open(&file, im, path, NULL, err);

	for (int i = 0; i < im->nchan; i++)
		im->chan[i].want = !only || !strcmp(im->chan[i].name, only) ? GD_READ : GD_DROP;
	if (rc == GD_OK)
		rc = gd_exr_load(file, im, err);
	gd_exr_close(file);
	return rc;
}

static int count_bins(struct spend *s, int base, const char *more, struct gd_err *err)
{
	struct gd_plane map = { 0 };
	struct gd_image im = { 0 };
	char *end = NULL;
	long even = more ? strtol(more, &end, 10) : 0;
	bool file = more && (end == more || *end);
	int rc = file ? read_all(&im, more, "sampling", err) : GD_OK;

	if (rc == GD_OK && file &&
	    (!gd_image_plane(&im, "sampling", &map) || map.w != s->in->w || map.h != s->in->h))
		rc = gd_fail(err, GD_ESHAPE, "%s: no channel sampling of this size", more);
	s->count = calloc((size_t)s->in->w * (size_t)s->in->h, sizeof *s->count);
	if (rc == GD_OK && !s->count)
		rc = gd_fail(err, GD_ENOMEM, "out of memory");
	for (int y = 0; y < s->in->h && rc == GD_OK; y++)
		for (int x = 0; x < s->in->w && rc == GD_OK; x++) {
			int n = base + (file ? (int)lround((double)gd_row(map, y)[x]) : (int)even);

			if ((n < 2 && !s->first) || n < s->first || n > s->bins)
				rc = gd_fail(err, GD_ESHAPE, "%d bins wanted at %d,%d of %d", n, x,
					     y, s->bins);
			s->count[(size_t)y * (size_t)s->in->w + (size_t)x] = n - s->first;
		}
	gd_image_free(&im);
	return rc;
}

/* G-buffers and their variances, as they are. */
static int copy_rest(struct spend *s, struct gd_err *err)
{
	static const char *const layers[] = { "albedo", "N", "Z", "P", "ao" };
	int rc = GD_OK;

	for (int i = 0; i < s->in->nchan && rc == GD_OK; i++)
		for (size_t k = 0; k < sizeof layers / sizeof *layers && rc == GD_OK; k++) {
			const char *name = s->in->chan[i].name;
			size_t n = strlen(layers[k]);
			struct gd_plane to;

			if (strncmp(name, layers[k], n) || (name[n] && name[n] != '.'))
				continue;
			rc = gd_image_add(&s->out, name, &to, err);
			for (int y = 0; y < s->in->h && rc == GD_OK; y++)
				memcpy(gd_row(to, y),
				       gd_row(gd_plane_of(s->in->chan[i].v, to.w, to.h), y),
				       (size_t)to.w * sizeof(float));
		}
	return rc;
}

static int add_samples(struct spend *s, struct gd_err *err)
{
	static const char *const name[] = { "half0.samples", "half1.samples", "samples" };
	int rc = GD_OK;

	for (int i = 0; i < 3 && rc == GD_OK; i++) {
		struct gd_plane p;

		rc = gd_image_add(&s->out, name[i], &p, err);
		for (int y = 0; y < s->in->h && rc == GD_OK; y++)
			for (int x = 0; x < s->in->w; x++) {
				int n = at(s, x, y);

				gd_row(p, y)[x] = (float)(s->spp * (i < 2 ? (n + 1 - i) / 2 : n));
			}
	}
	return rc;
}

static int spend(struct spend *s, struct gd_err *err)
{
	static const char *const layers[] = { "", "dx", "dy" };
	int rc = GD_OK;

	for (int k = 0; k < 3 && rc == GD_OK; k++)
		if (gd_bins(s->in, layers[k]) == s->bins)
			rc = spend_layer(s, layers[k], err);
	if (rc == GD_OK)
		rc = copy_rest(s, err);
	if (rc == GD_OK)
		rc = add_samples(s, err);
	return rc == GD_OK ? gd_attr_set_int(&s->out, "gd:bins", s->apart ? s->apart : 2, err) : rc;
}

int main(int argc, char **argv)
{
	struct gd_image in = { 0 };
	struct spend s = { .in = &in, .edges = BOTH };
	struct gd_err err = { 0 };
	double spp;
	int option, usage = 0, rc;

	while ((option = getopt(argc, argv, "ape:")) != -1) {
		s.apart = s.apart || option == 'a';
		s.first = s.first || option == 'p';
		if (option == 'e')
			s.edges = *optarg == 'm' ? MEAN : *optarg == 'e' ? EITHER : BOTH;
		usage = usage || option == '?';
	}
	argv += optind - 1;
	argc -= optind - 1;
	if (usage || argc < 4 || argc > 5)
		return fprintf(stderr, "usage: gdspend [-a] [-p] [-e both|mean|either] BINS.exr "
				       "OUT.exr BASE [MAP.exr|COUNT]\n"), 2;
	rc = read_all(&in, argv[1], NULL, &err);
	s.bins = gd_bins(&in, "");
	s.spp = 1;
	s.first = s.first ? atoi(argv[3]) : 0;
	if (rc == GD_OK && gd_attr_number(&in, "gd:samplesPerPixel", &spp))
		s.spp = spp / s.bins;
	gd_image_init(&s.out, in.w, in.h);
	if (rc == GD_OK)
		rc = count_bins(&s, atoi(argv[3]), argc > 4 ? argv[4] : NULL, &err);
	if (s.apart && rc == GD_OK)
		s.apart = s.count[0];
	if (rc == GD_OK)
		rc = spend(&s, &err);
	if (rc == GD_OK)
		rc = gd_exr_write(&s.out, argv[2], NULL, &err);
	if (rc != GD_OK)
		fprintf(stderr, "gdspend: %s\n", err.text);
	gd_image_free(&in);
	gd_image_free(&s.out);
	free(s.count);
	return rc == GD_OK ? 0 : 2;
}
