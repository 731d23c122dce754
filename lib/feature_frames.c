/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * The feature over several frames. Each is solved from gradients of its own, so that it drifts by
 * itself; what frames have in common is the detail. A neighbour is therefore moved, slowly varying
 * in space, to where the frame itself is; then patches tell where both show the same.
 */
#include "feature_frames.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "blur.h"
#include "follow.h"

/*
 * Standard deviation of the blur that tells slow parts from detail, pixels. With 2 the error of the
 * denoised frames is 1 % larger; with 8 it is the same, but what is lit otherwise is felt as far
 * around.
 */
#define DRIFT_PX 4.0

static const char *const layer[3] = { "feature", "half0.feature", "half1.feature" };

bool gd_feature_set_want(struct gd_image *im)
{
	int found = 0;

	for (int i = 0; i < 3; i++) {
		int n = gd_layer_find(im, layer[i]).n;

		found += n && gd_layer_variance(im, layer[i]).n == n;
	}
	/* one without the other is no set: made by a denoiser, or by hand */
	if (found != 3 && !(found == 1 && gd_layer_variance(im, layer[0]).n))
		return false;
	for (int i = 0; i < found; i++) {
		gd_layer_want(im, layer[i], GD_READ);
		gd_layer_want_variance(im, layer[i], GD_READ);
	}
	return true;
}

static int find_layer(struct gd_plane *value, struct gd_plane *var, const struct gd_image *im,
		      const char *name)
{
	struct gd_plane p[GD_LAYER_PLANES], v[GD_LAYER_PLANES];
	int n = gd_layer_planes(im, name, p);

	if (!n || n > 3 || gd_layer_variance_planes(im, name, v) != n)
		return 0;
	memcpy(value, p, (size_t)n * sizeof *p);
	memcpy(var, v, (size_t)n * sizeof *v);
	return n;
}

bool gd_feature_set_find(struct gd_feature_set *set, const struct gd_image *im)
{
	*set = (struct gd_feature_set){ 0 };
	set->n = find_layer(set->whole, set->whole_var, im, layer[0]);
	set->halves = set->n > 0;
	for (int i = 0; i < 2; i++)
		set->halves = set->halves && find_layer(set->half[i], set->half_var[i], im,
							layer[1 + i]) == set->n;
	return set->n > 0;
}

static void copy_plane(struct gd_plane to, struct gd_plane from)
{
	for (int y = 0; y < to.h; y++)
		memcpy(gd_row(to, y), gd_row(from, y), (size_t)to.w * sizeof(float));
}

void gd_feature_set_copy(const struct gd_feature_set *to, const struct gd_feature_set *from)
{
	for (int c = 0; c < from->n; c++) {
		copy_plane(to->whole[c], from->whole[c]);
		if (from->whole_var[c].v)
			copy_plane(to->whole_var[c], from->whole_var[c]);
		for (int i = 0; i < 2 && from->halves; i++) {
			copy_plane(to->half[i][c], from->half[i][c]);
			copy_plane(to->half_var[i][c], from->half_var[i][c]);
		}
	}
}

/* ---- the filter ---- */

/* to = part a + part b */
static void mix(struct gd_plane to, struct gd_plane a, struct gd_plane b, float part)
{
#pragma omp parallel for schedule(static)
	for (int y = 0; y < to.h; y++)
		for (int x = 0; x < to.w; x++)
			gd_row(to, y)[x] = part * gd_row(a, y)[x] + part * gd_row(b, y)[x];
}

/* What is filtered with the weights of half 1 - i: half i, and the feature of all bins. */
struct inputs {
	struct gd_plane in[6], var[6];
};

static void gather(struct inputs *to, const struct gd_feature_set *set, int i)
{
	memset(to, 0, sizeof *to);
	for (int c = 0; c < set->n; c++) {
		to->in[c] = set->half[i][c];
		to->var[c] = set->half_var[i][c];
		to->in[set->n + c] = set->whole[c];
	}
}

static int filter_crossed(const struct gd_feature_set *to, const struct gd_feature_set *from,
			  const struct gd_feature_set *frame, int count, int window,
			  const struct gd_plane *other, const struct gd_nlm_conf *conf,
			  const struct gd_report *report, struct gd_err *err)
{
	const int n = from->n;
	struct inputs own, out, in[GD_FEATURE_FRAMES];
	struct gd_nlm_frame f[GD_FEATURE_FRAMES];
	int rc = GD_OK;

	for (int i = 0; i < 2 && rc == GD_OK; i++) {
		const struct gd_nlm_job job = { n, 2 * n, from->half[1 - i], from->half_var[1 - i],
						own.in, own.var, out.in, out.var };

		gather(&own, from, i);
		gather(&out, to, i);
		for (int c = 0; c < n && i; c++)
			out.in[n + c] = other[c];
		for (int k = 0; k < count; k++) {
			gather(&in[k], &frame[k], i);
			f[k] = (struct gd_nlm_frame){ frame[k].half[1 - i],
						      frame[k].half_var[1 - i], in[k].in,
						      in[k].var, frame[k].known, window };
		}
		rc = gd_nlm_frames(&job, f, count, conf, report, err);
	}
	for (int c = 0; c < n && rc == GD_OK; c++) {
		mix(to->whole[c], to->whole[c], other[c], 0.5f);
		mix(to->whole_var[c], to->half_var[0][c], to->half_var[1][c], 0.25f);
	}
	return rc;
}

int gd_feature_set_filter(const struct gd_feature_set *to, const struct gd_feature_set *from,
			  const struct gd_feature_set *frame, int count, int window,
			  const struct gd_plane *other, const struct gd_nlm_conf *conf,
			  const struct gd_report *report, struct gd_err *err)
{
	const struct gd_nlm_job job = { from->n, from->n, from->whole, from->whole_var,
					from->whole, from->whole_var, to->whole, to->whole_var };
	struct gd_nlm_frame f[GD_FEATURE_FRAMES];

	if (from->halves)
		return filter_crossed(to, from, frame, count, window, other, conf, report, err);
	for (int k = 0; k < count; k++)
		f[k] = (struct gd_nlm_frame){ frame[k].whole, frame[k].whole_var, frame[k].whole,
					      frame[k].whole_var, frame[k].known, window };
	return gd_nlm_frames(&job, f, count, conf, report, err);
}

/* ---- neighbours ---- */

struct bring {
	const int *at;
	struct gd_plane known, moved, share, spare;	/* share: of what is known, blurred */
	struct gd_blur blur;
};

static float sound(float v)
{
	return isfinite(v) ? v : 0.0f;
}

/* moved = frame where it is found; elsewhere, and where it is no number, what takes its place */
static void move(const struct bring *b, struct gd_plane frame, struct gd_plane instead)
{
	const int w = frame.w;

#pragma omp parallel for schedule(static)
	for (int y = 0; y < frame.h; y++)
		for (int x = 0; x < w; x++) {
			int at = b->at ? b->at[(size_t)y * (size_t)w + (size_t)x] : y * w + x;
			float v = at >= 0 ? gd_row(frame, at / w)[at % w] : NAN;

			gd_row(b->moved, y)[x] = isfinite(v) ? v : sound(gd_row(instead, y)[x]);
		}
}

/* frame = moved + mean of (own - moved) around the pixel, over what is known */
static int move_value(const struct bring *b, struct gd_plane frame, struct gd_plane own,
		      struct gd_err *err)
{
	int rc;

	move(b, frame, own);
#pragma omp parallel for schedule(static)
	for (int y = 0; y < frame.h; y++)
		for (int x = 0; x < frame.w; x++) {
			float d = 0.5f * sound(gd_row(own, y)[x]) -
				  0.5f * gd_row(b->moved, y)[x];

			gd_row(frame, y)[x] = gd_row(b->known, y)[x] * d;
		}
	rc = gd_blur_plane(frame, b->spare, &b->blur, err);
#pragma omp parallel for schedule(static)
	for (int y = 0; y < frame.h; y++)
		for (int x = 0; x < frame.w; x++) {
			float share = fmaxf(gd_row(b->share, y)[x], 1e-6f);
			float v = 0.5f * gd_row(b->moved, y)[x] + gd_row(frame, y)[x] / share;

			v = fminf(fmaxf(v, -0.5f * FLT_MAX), 0.5f * FLT_MAX);
			gd_row(frame, y)[x] = 2.0f * v;
		}
	return rc;
}

static int bring_planes(const struct bring *b, struct gd_plane *value, struct gd_plane *var,
			const struct gd_plane *own, const struct gd_plane *own_var, int n,
			struct gd_err *err)
{
	int rc = GD_OK;

	for (int c = 0; c < n && rc == GD_OK; c++) {
		move(b, var[c], own_var[c]);
		copy_plane(var[c], b->moved);
		rc = move_value(b, value[c], own[c], err);
	}
	return rc;
}

/*
 * Brings a neighbour's feature, in place, to the pixels and to the slow parts of `own`. at: where
 * each pixel is in the neighbour, y * w + x or -1; NULL: where it is here.
 */
static int bring(struct gd_feature_set *frame, const int *at, const struct gd_feature_set *own,
		 struct gd_err *err)
{
	const struct gd_plane known = frame->known;
	const size_t size = gd_stride(known.w) * (size_t)known.h;
	struct bring b = { .at = at, .known = known, .blur = gd_blur_gauss(DRIFT_PX) };
	float *block = gd_alloc(3 * size, sizeof *block);
	int rc;

	if (!block)
		return gd_fail(err, GD_ENOMEM, "neighbours: out of memory");
	b.moved = gd_plane_of(block, known.w, known.h);
	b.share = gd_plane_of(block + size, known.w, known.h);
	b.spare = gd_plane_of(block + 2 * size, known.w, known.h);
	for (int y = 0; y < known.h; y++)
		for (int x = 0; x < known.w; x++)
			gd_row(known, y)[x] = gd_row(b.share, y)[x] =
				!at || at[(size_t)y * (size_t)known.w + (size_t)x] >= 0;
	rc = gd_blur_plane(b.share, b.spare, &b.blur, err);
	if (rc == GD_OK)
		rc = bring_planes(&b, frame->whole, frame->whole_var, own->whole, own->whole_var,
				  own->n, err);
	for (int i = 0; i < 2 && own->halves && rc == GD_OK; i++)
		rc = bring_planes(&b, frame->half[i], frame->half_var[i], own->half[i],
				  own->half_var[i], own->n, err);
	free(block);
	return rc;
}

/* The feature of another frame, made as that of this one unless it has one. */
static int find_or_make(struct gd_feature_set *set, struct gd_image *im,
			const struct gd_feature_set *own, const struct gd_feature_conf *conf,
			struct gd_feature_result *result, const struct gd_report *report,
			struct gd_err *err)
{
	const int number = (int)(im - conf->neighbour) + 1;
	struct gd_feature_conf plain = *conf;
	int rc;

	plain.filter = plain.keep = false;
	plain.layers = NULL;
	plain.neighbours = 0;
	if (!gd_feature_set_find(set, im)) {
		rc = gd_feature_run(im, &plain, NULL, report, err);
		if (rc != GD_OK)
			return rc;
		result->solved++;
		if (!gd_feature_set_find(set, im))
			return gd_fail(err, GD_ESHAPE, "neighbour %d has neither bins nor "
				       "variances of its gradients: it cannot be compared",
				       number);
	}
	if (set->n != own->n || set->halves < own->halves)
		return gd_fail(err, GD_ESHAPE,
			       "neighbour %d has a feature of %d channels%s, expected %d%s",
			       number, set->n, set->halves ? " and halves" : "", own->n,
			       own->halves ? " and halves" : "");
	return GD_OK;
}

int gd_feature_set_neighbour(struct gd_feature_set *frame, struct gd_image *neighbour,
			     struct gd_plane known, const struct gd_feature_set *own,
			     const struct gd_plane *position, const struct gd_feature_conf *conf,
			     struct gd_feature_result *result, const struct gd_report *report,
			     struct gd_err *err)
{
	const size_t n = (size_t)known.w * (size_t)known.h;
	struct gd_plane there[GD_LAYER_PLANES];
	int *at = NULL, rc = find_or_make(frame, neighbour, own, conf, result, report, err);

	if (rc != GD_OK)
		return rc;
	if (position[0].v && gd_layer_planes(neighbour, "P", there) == 3) {
		size_t found = 0;

		at = gd_alloc(n, sizeof *at);
		if (!at)
			return gd_fail(err, GD_ENOMEM, "neighbours: out of memory");
		gd_follow(at, position, there);
		for (size_t i = 0; i < n; i++)
			found += at[i] >= 0;
		result->found += (double)found / (double)n;
		result->followed++;
	}
	result->frames++;
	frame->known = known;
	rc = bring(frame, at, own, err);
	free(at);
	return rc;
}
