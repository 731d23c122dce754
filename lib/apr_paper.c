/* SPDX-License-Identifier: BSD-3-Clause */
#include "apr_paper.h"

#include <stdlib.h>
#include <string.h>

#include "apr_prep.h"
#include "nlm.h"

#define MOST_RETURNED 1.0	/* a spike at most doubles the light of its window */

static struct gd_plane new_plane(struct gd_plane like)
{
	float *v = gd_alloc(gd_stride(like.w) * (size_t)like.h, sizeof *v);

	return gd_plane_of(v, like.w, like.h);
}

static void copy_plane(struct gd_plane to, struct gd_plane from)
{
	for (int y = 0; y < to.h; y++)
		memcpy(gd_row(to, y), gd_row(from, y), (size_t)to.w * sizeof(float));
}

static bool all_zero(struct gd_plane p)
{
	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++)
			if (gd_row(p, y)[x] != 0)
				return false;
	return true;
}

int gd_apr_frame_mend(struct gd_apr_frame *f, float *made[3], size_t *mended,
		      const struct gd_report *report, struct gd_err *err)
{
	bool spatial = made && !f->var[0].v && f->nbin < 2;
	int rc = GD_OK;

	for (int c = 0; made && c < 3; c++)
		made[c] = NULL;
	for (int c = 0; made && c < 3 && rc == GD_OK && !f->var[c].v; c++) {
		struct gd_plane bin[GD_APR_RHS];

		f->var[c] = new_plane(f->y[c]);
		made[c] = f->var[c].v;
		if (!made[c])
			rc = gd_fail(err, GD_ENOMEM, "out of memory");
		else if (spatial)
			memset(made[c], 0,
			       gd_stride(f->y[c].w) * (size_t)f->y[c].h * sizeof(float));
		for (int b = 0; b < f->nbin && b < GD_APR_RHS; b++)
			bin[b] = f->bin[b][c];
		if (rc == GD_OK && !spatial)
			gd_apr_bin_variance(f->var[c], bin,
					    f->nbin < GD_APR_RHS ? f->nbin : GD_APR_RHS);
	}
	for (int c = 0; c < f->ny && rc == GD_OK; c++)
		rc = gd_apr_clean(f->y[c], c < 3 ? f->var[c] : (struct gd_plane){ 0 }, mended, err);
	for (int a = 0; a < f->nfeat && rc == GD_OK; a++)
		rc = gd_apr_clean(f->feat[a], f->feat_var[a], mended, err);
	for (int c = 0; c < 3 && rc == GD_OK && spatial; c++)
		rc = gd_apr_spatial_variance(f->var[c], f->y[c], err);
	if (rc == GD_OK && spatial)
		gd_note(report,
			"no variance and no bins: noise judged from 7x7 windows of the image");
	return rc;
}

/* Filters planes a .. a+n-1 by non-local means, guided by themselves. */
static int filter_layer(struct gd_apr_frame *f, int a, int n, struct gd_plane *spare,
			const struct gd_report *report, struct gd_err *err)
{
	struct gd_nlm_conf conf = GD_NLM_PREFILTER;
	struct gd_nlm_job job = { n, n, f->feat + a, f->feat_var + a, f->feat + a, f->feat_var + a,
				  spare, spare + n };
	int rc = gd_nlm_run(&job, &conf, report, err);

	for (int i = 0; i < n && rc == GD_OK; i++) {
		copy_plane(f->feat[a + i], spare[i]);
		if (f->feat_var[a + i].v)
			copy_plane(f->feat_var[a + i], spare[n + i]);
	}
	return rc;
}

int gd_apr_frame_filter(struct gd_apr_frame *f, const struct gd_report *report, struct gd_err *err)
{
	struct gd_plane spare[8] = { 0 };
	int rc = GD_OK, filtered = 0;

	for (int a = 0, n; a < f->nfeat && rc == GD_OK; a += n) {
		bool noisy = false;

		for (n = 0; a + n < f->nfeat && n < 4 && f->layer[a + n] == f->layer[a]; n++)
			noisy = noisy || (f->feat_var[a + n].v && !all_zero(f->feat_var[a + n]));
		if (!noisy || f->filtered[a])
			continue;
		for (int i = 0; i < 2 * n && rc == GD_OK; i++)
			if (!spare[i].v) {
				spare[i] = new_plane(f->feat[a]);
				rc = spare[i].v ? GD_OK : gd_fail(err, GD_ENOMEM, "out of memory");
			}
		if (rc == GD_OK)
			rc = filter_layer(f, a, n, spare, report, err);
		for (int i = 0; i < n; i++)
			f->filtered[a + i] = true;
		filtered += n;
	}
	if (filtered > 0)
		gd_note(report, "%d noisy feature planes filtered", filtered);
	for (int i = 0; i < 8; i++)
		free(spare[i].v);
	return rc;
}

int gd_apr_paper(const struct gd_apr_out *out, struct gd_apr_frame *f,
		 const struct gd_apr_conf *conf, enum gd_apr_spike_mode mode,
		 struct gd_apr_paper_result *result, const struct gd_report *report,
		 struct gd_err *err)
{
	struct gd_apr_in in = { f->ny, 3, f->nfeat, f->y, f->var, f->feat, f->feat_var, { 0 } };
	struct gd_apr_spikes spikes = { 0 };
	bool trust = f->var[0].v || f->nbin >= 2;
	struct gd_apr_conf used = *conf;
	float *made[3];
	int rc;

	*result = (struct gd_apr_paper_result){ 0 };
	gd_progress(report, "preparing", 0);
	rc = gd_apr_frame_mend(f, made, &result->mended, report, err);
	if (rc == GD_OK && mode != GD_SPIKES_KEEP)
		rc = gd_apr_spikes_take(&spikes, f->y, f->ny, f->var, trust, err);
	if (rc == GD_OK)
		rc = gd_apr_frame_filter(f, report, err);
	gd_progress(report, "fitting", 0.4);
	if (f->half[0][0].v && f->half[1][0].v)
		used.correlation = gd_apr_correlation(f->half[0], f->half[1]);
	if (rc == GD_OK)
		rc = gd_apr_fit(out, &in, &used, report, err);
	for (int c = 0; c < 3 && rc == GD_OK; c++)
		rc = gd_apr_error_local(out->mse[c], f->var[c], conf->radius, err);
	if (rc == GD_OK && mode == GD_SPIKES_RETURN)
		rc = gd_apr_spikes_return(&spikes, out->est, conf->radius, MOST_RETURNED,
					  &result->capped, err);
	result->spikes = spikes.n;
	result->correlation = used.correlation;
	gd_progress(report, "fitting", 1);
	gd_apr_spikes_free(&spikes);
	for (int c = 0; c < 3; c++)
		free(made[c]);
	return rc;
}
