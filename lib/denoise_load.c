/* SPDX-License-Identifier: BSD-3-Clause */
/* Planes of the channels chosen: views, copies where they are to stay, halves, mended. */
#include "denoise_job.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "apr_prep.h"

/*
 * Most copies: features and their variances, both halves of what is denoised; variances of the
 * colour (3), positions (3), counts (2), both halves of the crossed feature (8).
 */
#define COPIES (2 * GD_APR_FEATURES + 2 * GD_APR_RHS + 16)

int gd_denoise_new_planes(struct gd_plane *p, int n, struct gd_plane like, struct gd_err *err)
{
	size_t size = gd_stride(like.w) * (size_t)like.h;

	for (int c = 0; c < n; c++) {
		p[c] = gd_plane_of(gd_alloc(size, sizeof(float)), like.w, like.h);
		if (!p[c].v)
			return gd_fail(err, GD_ENOMEM, "out of memory");
	}
	return GD_OK;
}

void gd_denoise_copy_planes(struct gd_plane *to, const struct gd_plane *from, int n)
{
	for (int c = 0; c < n; c++)
		for (int y = 0; y < to[c].h; y++)
			memcpy(gd_row(to[c], y), gd_row(from[c], y),
			       (size_t)to[c].w * sizeof(float));
}

/* A copy of a plane, kept as long as the job is, takes its place. */
static int copy(struct denoise_job *job, struct gd_plane *p, struct gd_err *err)
{
	struct gd_plane from = *p;
	int rc = gd_denoise_new_planes(p, 1, from, err);

	if (rc == GD_OK) {
		gd_denoise_copy_planes(p, &from, 1);
		job->copy[job->ncopy++] = p->v;
	}
	return rc;
}

/*
 * Planes that are going to be mended, filtered or scaled in place: copies of them where the
 * image's are to stay.
 */
static int own(struct denoise_job *job, struct gd_plane *p, int n, struct gd_err *err)
{
	int rc = GD_OK;

	for (int c = 0; c < n && job->keep && rc == GD_OK; c++)
		rc = copy(job, &p[c], err);
	return rc;
}

static int fill_features(struct denoise_job *job, struct gd_apr_frame *f, struct gd_err *err)
{
	const int most = gd_denoise_crossfit(job) ? GD_CROSSFIT_FEATURES : GD_APR_FEATURES;
	int rc = GD_OK;

	for (int i = 0; i < job->features.n && rc == GD_OK; i++) {
		const char *name = job->features.name[i];
		struct gd_plane feat[GD_LAYER_PLANES], var[GD_LAYER_PLANES] = { 0 };
		int n = gd_layer_find(job->im, name).n;

		if (gd_denoise_crossed(job, name))
			continue;
		if (f->nfeat + n > most)
			return gd_fail(err, GD_EARG, "more than %d feature planes", most);
		n = gd_layer_planes(job->im, name, feat);
		rc = own(job, feat, n, err);
		if (rc == GD_OK)
			rc = own(job, var, gd_layer_variance_planes(job->im, name, var), err);
		for (int k = 0; k < n; k++) {
			f->feat[f->nfeat] = feat[k];
			f->feat_var[f->nfeat] = var[k];
			f->layer[f->nfeat] = i;
			f->filtered[f->nfeat++] = job->conf->no_filter || !strcmp(name, "feature");
		}
	}
	return rc;
}

/* The whole image: colour, layers, and what they are judged by. */
int gd_denoise_frame(struct denoise_job *job, struct gd_apr_frame *f, struct gd_plane (*bin)[3],
		     struct gd_err *err)
{
	const struct gd_image *im = job->im;
	struct gd_plane plane[GD_LAYER_PLANES];
	char name[256];
	int rc;

	job->copy = gd_calloc(COPIES, sizeof *job->copy);
	if (!job->copy)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	f->ny = gd_layer_planes(im, "", f->y);
	for (int i = 0; i < job->layers.n; i++) {
		if (f->ny + GD_LAYER_PLANES > GD_APR_RHS)
			return gd_fail(err, GD_EARG, "more than %d channels to denoise",
				       GD_APR_RHS);
		f->ny += gd_layer_planes(im, job->layers.name[i], f->y + f->ny);
	}
	for (int h = 0; h < 2 && job->source == HALVES; h++)
		gd_layer_planes(im, gd_denoise_part(name, "half", h, ""), f->half[h]);
	rc = own(job, f->var, gd_layer_variance_planes(im, "", f->var), err);
	if (rc == GD_OK && !f->var[0].v && job->bins >= 2) {
		f->bin = bin;
		for (int b = 0; b < job->bins; b++)
			if (gd_layer_planes(im, gd_denoise_part(name, "bin", b, ""), plane) == 3)
				memcpy(bin[f->nbin++], plane, sizeof *bin);
	}
	return rc == GD_OK ? fill_features(job, f, err) : rc;
}

/* to += (from - to) / n: takes the n-th plane into a mean. */
static void add_to_mean(struct gd_plane to, struct gd_plane from, int n)
{
#pragma omp parallel for schedule(static)
	for (int y = 0; y < to.h; y++) {
		const float *restrict v = gd_row(from, y);
		float *restrict mean = gd_row(to, y);

		for (int x = 0; x < to.w; x++)
			mean[x] = (float)(((double)mean[x] * (n - 1) + (double)v[x]) / n);
	}
}

/* Adds the bins from the third on to the means of the even and the odd ones, and frees them. */
static void add_bins(struct denoise_job *job, const char *layer, struct gd_plane *const half[2])
{
	struct gd_plane bin[GD_LAYER_PLANES];
	char name[256];

	for (int b = 2; b < job->bins; b++) {
		int n = gd_layer_planes(job->im, gd_denoise_part(name, "bin", b, layer), bin);

		for (int c = 0; c < n; c++)
			add_to_mean(half[b % 2][c], bin[c], b / 2 + 1);
		if (!job->keep)
			gd_denoise_release(job->im, name);
	}
}

/* Both halves of a layer; a and b have room for GD_LAYER_PLANES. Their number goes to *n. */
static int half_planes(struct denoise_job *job, const char *layer, struct gd_plane *a,
		       struct gd_plane *b, int *n, struct gd_err *err)
{
	const char *part = job->source == BINS ? "bin" : "half";
	struct gd_plane *const half[2] = { a, b };
	char name[256];
	int rc = GD_OK;

	for (int h = 0; h < 2 && rc == GD_OK; h++) {
		*n = gd_layer_planes(job->im, gd_denoise_part(name, part, h, layer), half[h]);
		rc = own(job, half[h], *n, err);
	}
	if (rc == GD_OK && job->source == BINS)
		add_bins(job, layer, half);
	return rc;
}

/* Both halves of the crossed feature, once, however often it is named. */
static int fill_crossed(struct denoise_job *job, struct gd_crossfit_in *in, struct gd_err *err)
{
	bool crossed = false;
	char name[256];
	int rc = GD_OK;

	for (int i = 0; i < job->features.n; i++)
		crossed = crossed || gd_denoise_crossed(job, job->features.name[i]);
	for (int h = 0; h < 2 && crossed && rc == GD_OK; h++) {
		gd_denoise_part(name, "half", h, "feature");
		in->nfeature = gd_layer_planes(job->im, name, in->feature[h]);
		rc = own(job, in->feature[h], in->nfeature, err);
	}
	return rc;
}

/* Fills in the halves: colour and layers, and the crossed feature. */
static int fill_halves(struct denoise_job *job, struct gd_crossfit_in *in, size_t *mended,
		       struct gd_err *err)
{
	int n, rc = half_planes(job, "", in->y[0], in->y[1], &in->ny, err);

	for (int i = 0; i < job->layers.n && job->layer_halves && rc == GD_OK; i++) {
		rc = half_planes(job, job->layers.name[i], in->y[0] + in->ny, in->y[1] + in->ny, &n,
				 err);
		in->ny += n;
	}
	if (rc == GD_OK)
		rc = fill_crossed(job, in, err);
	for (int h = 0; h < 2; h++) {
		for (int c = 0; c < in->ny && rc == GD_OK; c++)
			rc = gd_apr_clean(in->y[h][c], (struct gd_plane){ 0 }, mended, err);
		for (int c = 0; c < in->nfeature && rc == GD_OK; c++)
			rc = gd_apr_clean(in->feature[h][c], (struct gd_plane){ 0 }, mended, err);
	}
	return rc;
}

/* Whether samples differ between pixels, by more than rounding. */
static bool uneven(struct gd_plane p)
{
	float low = gd_row(p, 0)[0], high = low;

	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++) {
			low = fminf(low, gd_row(p, y)[x]);
			high = fmaxf(high, gd_row(p, y)[x]);
		}
	return high - low > 1e-5f * high;
}

/* What is no number, or below 0, is no sample. */
static void scale_count(struct gd_plane p, double scale)
{
	for (int y = 0; y < p.h; y++) {
		float *v = gd_row(p, y);

		for (int x = 0; x < p.w; x++)
			v[x] = v[x] > 0 && v[x] < FLT_MAX ? (float)(scale * (double)v[x]) : 0;
	}
}

/*
 * Samples of either half, where they differ between pixels: the channels half0.samples and
 * half1.samples, or the half's share of the channel samples.
 */
static int fill_count(struct denoise_job *job, struct gd_crossfit_in *in, struct gd_err *err)
{
	struct gd_plane count[2];
	bool apart = !in->self && gd_image_plane(job->im, "half0.samples", &count[0]) &&
		     gd_image_plane(job->im, "half1.samples", &count[1]);
	int rc = GD_OK;

	if (!apart) {
		if (!gd_image_plane(job->im, "samples", &count[0]))
			return GD_OK;
		count[1] = count[0];
	}
	if (!uneven(count[0]) && !uneven(count[1]))
		return GD_OK;
	for (int h = 0; h < (in->self ? 1 : 2) && rc == GD_OK; h++) {
		rc = copy(job, &count[h], err);
		if (rc == GD_OK)
			scale_count(count[h], apart || in->self ? 1 : job->share[h]);
		in->count[h] = count[h];
	}
	return rc;
}

/* Mends and filters what both halves share, into in; feature variances are done with then. */
int gd_denoise_halves(struct denoise_job *job, struct gd_apr_frame *f, struct gd_crossfit_in *in,
		      float *made[3], size_t *mended, const struct gd_report *report,
		      struct gd_err *err)
{
	/* Two bins know no more of the variance than their difference, which is used anyway. */
	bool find = f->var[0].v || job->source == NO_HALVES || (f->nbin > 2 && job->source == BINS);
	int rc = gd_apr_frame_mend(f, find ? made : NULL, mended, report, err);

	if (rc == GD_OK)
		rc = gd_apr_frame_filter(f, report, err);
	for (int i = 0; i < job->features.n && !job->keep; i++)
		gd_denoise_release_variance(job->im, job->features.name[i]);
	memset(f->feat_var, 0, sizeof f->feat_var);
	in->self = job->source == NO_HALVES;
	if (in->self) {
		in->ny = f->ny;
		memcpy(in->y[0], f->y, sizeof f->y);
	} else if (rc == GD_OK) {
		rc = fill_halves(job, in, mended, err);
	}
	if (!in->self && !job->layer_halves) {
		in->nwhole = f->ny;
		memcpy(in->whole, f->y, sizeof f->y);
	}
	in->nfeat = f->nfeat;
	memcpy(in->feat, f->feat, sizeof in->feat);
	memcpy(in->var, f->var, sizeof in->var);
	memcpy(in->share, job->share, sizeof in->share);
	return rc == GD_OK ? fill_count(job, in, err) : rc;
}

int gd_denoise_position(struct denoise_job *job, size_t *mended, struct gd_err *err)
{
	struct gd_plane p[GD_LAYER_PLANES];
	int n = gd_layer_planes(job->im, "P", p), rc = GD_OK;

	for (int c = 0; c < n && rc == GD_OK; c++) {
		rc = copy(job, &p[c], err);
		if (rc == GD_OK)
			rc = gd_apr_clean(p[c], (struct gd_plane){ 0 }, mended, err);
		job->position[c] = p[c];
	}
	return rc;
}
