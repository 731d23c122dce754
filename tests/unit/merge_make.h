/* SPDX-License-Identifier: BSD-3-Clause */
/* Small images, and what gd_merge makes of them, for tests of it. */
#ifndef MERGE_MAKE_H
#define MERGE_MAKE_H

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <math.h>
#include <stdio.h>

#include "merge.h"

#define W 5
#define H 3

static struct gd_plane put(struct gd_image *im, const char *name)
{
	struct gd_err err = { 0 };
	struct gd_plane p;

	assert_int_equal(gd_image_add(im, name, &p, &err), GD_OK);
	return p;
}

static void fill(struct gd_image *im, const char *name, float v)
{
	struct gd_plane p = put(im, name);

	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++)
			gd_row(p, y)[x] = v;
}

static void fill_rgb(struct gd_image *im, float v)
{
	fill(im, "R", v);
	fill(im, "G", v);
	fill(im, "B", v);
}

static double value(const struct gd_image *im, const char *name, int x, int y)
{
	struct gd_plane p;

	if (!gd_image_plane(im, name, &p))
		fail_msg("no channel %s", name);
	return (double)gd_row(p, y)[x];
}

/* Relative, for the few roundings to float on the way. */
static void near(double got, double want, const char *what)
{
	if (!(fabs(got - want) <= 4e-6 * fabs(want) + 1e-30))
		fail_msg("%s: %.9g, expected %.9g", what, got, want);
}

static int merge_err(struct gd_image *out, struct gd_image *in, int n, struct gd_merge_conf conf,
		     double spp, struct gd_merge_result *result, struct gd_err *err)
{
	struct gd_merge *m = NULL;
	char label[32];
	int rc = gd_merge_begin(&m, &conf, err);

	for (int i = 0; i < n && rc == GD_OK; i++) {
		snprintf(label, sizeof label, "run%d.exr", i);
		rc = gd_merge_survey(m, &in[i], label, spp, err);
	}
	if (rc == GD_OK)
		rc = gd_merge_plan(m, NULL, err);
	for (int i = 0; i < n && rc == GD_OK; i++) {
		rc = gd_merge_want(m, i, &in[i], err);
		if (rc == GD_OK)
			rc = gd_merge_add(m, i, &in[i], NULL, err);
	}
	if (rc == GD_OK)
		rc = gd_merge_finish(m, out, result, NULL, err);
	gd_merge_free(m);
	for (int i = 0; i < n; i++)
		gd_image_free(&in[i]);
	return rc;
}

static struct gd_merge_result merge(struct gd_image *out, struct gd_image *in, int n,
				    struct gd_merge_conf conf, double spp)
{
	struct gd_merge_result result = { 0 };
	struct gd_err err = { 0 };

	if (merge_err(out, in, n, conf, spp, &result, &err) != GD_OK)
		fail_msg("%s", err.text);
	for (int i = 0; i < out->nchan; i++)
		for (int y = 0; y < out->h && out->chan[i].v; y++)
			for (int x = 0; x < out->w; x++)
				if (!isfinite(value(out, out->chan[i].name, x, y)))
					fail_msg("%s is not finite at %d %d", out->chan[i].name, x,
						 y);
	return result;
}

static const struct gd_merge_conf usual = { .bins = -1 };
static const char *const rgb[] = { "R", "G", "B" };

#endif
