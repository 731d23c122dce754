/* SPDX-License-Identifier: BSD-3-Clause */
/* Noisy layers other than the feature, each filtered by itself or by its halves. */
#include "feature.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

struct job {
	struct gd_image *im, tmp;	/* tmp: the filtered planes of one layer */
	const struct gd_feature_conf *conf;
	const struct gd_report *report;
	struct gd_err *err;
	int done;			/* layers filtered */
};

static bool half_name(char name[256], int i, const char *layer)
{
	return snprintf(name, 256, "half%d.%s", i, layer) < 256;
}

static int no_layer(const char *layer, struct gd_err *err)
{
	return gd_fail(err, GD_ESHAPE, "no channel %s (nor .R .G .B, .X .Y .Z of it)", layer);
}

/* Calls use() for each name of a comma-separated list. */
static int each_layer(const char *list,
		      int (*use)(const char *layer, void *user, struct gd_err *err), void *user,
		      struct gd_err *err)
{
	int rc = GD_OK;

	while (list && *list && rc == GD_OK) {
		size_t n = strcspn(list, ",");
		char layer[240];

		if (!n || n >= sizeof layer)
			return gd_fail(err, GD_EARG, "layers \"%s\": an empty or overlong name",
				       list);
		memcpy(layer, list, n);
		layer[n] = 0;
		rc = use(layer, user, err);
		list += n + (list[n] == ',');
	}
	return rc;
}

static int want_layer(const char *layer, void *user, struct gd_err *err)
{
	struct gd_image *im = user;
	char half[256];

	if (!gd_layer_want(im, layer, GD_READ))
		return no_layer(layer, err);
	gd_layer_want_variance(im, layer, GD_READ);
	for (int i = 0; i < 2; i++) {
		half_name(half, i, layer);
		gd_layer_want(im, half, GD_READ);
		gd_layer_want_variance(im, half, GD_READ);
	}
	return GD_OK;
}

int gd_feature_layers_want(struct gd_image *im, const char *layers, struct gd_err *err)
{
	return each_layer(layers, want_layer, im, err);
}

static void copy_plane(struct gd_plane to, struct gd_plane from)
{
	for (int y = 0; y < to.h; y++)
		memcpy(gd_row(to, y), gd_row(from, y), (size_t)to.w * sizeof(float));
}

/* to = a part + b part, cut to what a float holds */
static void mix(struct gd_plane to, struct gd_plane a, struct gd_plane b, float part)
{
	for (int y = 0; y < to.h; y++)
		for (int x = 0; x < to.w; x++)
			gd_row(to, y)[x] =
				fminf(part * gd_row(a, y)[x] + part * gd_row(b, y)[x], FLT_MAX);
}

/* A layer, or a half of one, and what replaces it. */
struct noisy {
	int n;
	bool has_var;
	struct gd_plane in[GD_LAYER_PLANES], var[GD_LAYER_PLANES];
	struct gd_plane out[GD_LAYER_PLANES], out_var[GD_LAYER_PLANES];
};

/* Looks layer up and makes room for the result in tmp; n = 0 if there is no such layer. */
static int open_noisy(struct job *s, struct noisy *f, const char *layer)
{
	char name[300];
	int rc;

	*f = (struct noisy){ 0 };
	f->n = gd_layer_planes(s->im, layer, f->in);
	if (!f->n)
		return GD_OK;
	f->has_var = gd_layer_variance_planes(s->im, layer, f->var) == f->n;
	rc = gd_layer_add(&s->tmp, layer, f->n, f->out, s->err);
	snprintf(name, sizeof name, "%s.filtered.variance", layer);
	if (rc == GD_OK)
		rc = gd_layer_add(&s->tmp, name, f->n, f->out_var, s->err);
	return rc;
}

static bool all_zero(const struct gd_plane *p, int n)
{
	for (int c = 0; c < n; c++)
		for (int y = 0; y < p[c].h; y++)
			for (int x = 0; x < p[c].w; x++)
				if (gd_row(p[c], y)[x] != 0.0f)
					return false;
	return true;
}

static int filter_noisy(struct job *s, struct noisy *f, const struct noisy *guide)
{
	struct gd_nlm_job job = { f->n, f->n, guide->in, guide->var,
				  f->in, f->var, f->out, f->out_var };

	return gd_nlm_run(&job, &s->conf->nlm_layers, s->report, s->err);
}

static void keep_noisy(struct noisy *f)
{
	for (int c = 0; c < f->n; c++) {
		copy_plane(f->in[c], f->out[c]);
		if (f->has_var)
			copy_plane(f->var[c], f->out_var[c]);
	}
}

/* Variances of halves that come without: from their difference, for want of better. */
static int halves_variance(struct job *s, struct noisy half[2], const char *layer)
{
	struct gd_plane var[GD_LAYER_PLANES];
	char name[300];
	int rc;

	if (half[0].has_var && half[1].has_var)
		return GD_OK;
	snprintf(name, sizeof name, "%s.halves.variance", layer);
	rc = gd_layer_add(&s->tmp, name, half[0].n, var, s->err);
	if (rc == GD_OK)
		rc = gd_boot_halves(var, half[0].in, half[1].in, half[0].n, s->conf->boot.local_px,
				    s->err);
	/* the variance of the mean of two is half of what each has */
	for (int c = 0; c < half[0].n && rc == GD_OK; c++)
		mix(var[c], var[c], var[c], 1.0f);
	for (int i = 0; i < 2 && rc == GD_OK; i++) {
		memcpy(half[i].var, var, sizeof var);
		half[i].has_var = false;
	}
	return rc;
}

/* Each half with weights from the other; the layer becomes the mean of the two. */
static int filter_halves(struct job *s, struct noisy *whole, struct noisy half[2],
			 const char *layer)
{
	int rc = halves_variance(s, half, layer);

	for (int i = 0; i < 2 && rc == GD_OK; i++)
		rc = filter_noisy(s, &half[i], &half[1 - i]);
	for (int c = 0; c < whole->n && rc == GD_OK; c++) {
		mix(whole->out[c], half[0].out[c], half[1].out[c], 0.5f);
		mix(whole->out_var[c], half[0].out_var[c], half[1].out_var[c], 0.25f);
	}
	for (int i = 0; i < 2 && rc == GD_OK; i++)
		keep_noisy(&half[i]);
	return rc;
}

static int filter_layer(const char *layer, void *user, struct gd_err *err)
{
	struct job *s = user;
	struct noisy whole, half[2];
	char name[2][256];
	int rc;

	gd_image_init(&s->tmp, s->im->w, s->im->h);
	rc = open_noisy(s, &whole, layer);
	if (rc == GD_OK && !whole.n)
		rc = no_layer(layer, err);
	for (int i = 0; i < 2 && rc == GD_OK; i++) {
		half_name(name[i], i, layer);
		rc = open_noisy(s, &half[i], name[i]);
	}
	if (rc != GD_OK)
		goto done;
	if (half[0].n == whole.n && half[1].n == whole.n) {
		rc = filter_halves(s, &whole, half, layer);
	} else if (whole.has_var && !all_zero(whole.var, whole.n)) {
		rc = filter_noisy(s, &whole, &whole);
	} else {
		gd_note(s->report, "%s has no variance and no halves: it counts as exact and stays",
			layer);
		goto done;
	}
	if (rc == GD_OK) {
		keep_noisy(&whole);
		s->done++;
	}
done:
	gd_image_free(&s->tmp);
	return rc;
}

int gd_feature_layers_run(struct gd_image *im, const struct gd_feature_conf *conf, int *filtered,
			  const struct gd_report *report, struct gd_err *err)
{
	struct job s = { .im = im, .conf = conf, .report = report, .err = err };
	int rc = each_layer(conf->layers, filter_layer, &s, err);

	*filtered = s.done;
	return rc;
}
