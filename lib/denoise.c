/* SPDX-License-Identifier: BSD-3-Clause */
#include "denoise_job.h"

#include <stdlib.h>

static int fit_crossfit(struct denoise_job *job, struct gd_crossfit_out *out,
			struct gd_crossfit_in *in, struct gd_denoise_result *result,
			const struct gd_report *report, struct gd_err *err)
{
	const struct gd_crossfit_conf conf = { .fast = job->conf->fast };
	struct gd_crossfit_result cross = { 0 };
	int rc = GD_OK;

	if (!conf.fast)
		rc = gd_image_add(job->im, "model.spread", &out->spread, err);
	if (rc == GD_OK)
		rc = gd_crossfit_run(out, in, &conf, &cross, report, err);
	if (rc == GD_OK)
		gd_note(report, "%d %sregression%s%s; brightest pixels times %.4f to keep the mean",
			cross.models, in->self ? "" : "cross-fitted ", cross.models > 1 ? "s" : "",
			in->self ? "" : " of either half", cross.gain);
	result->models = (size_t)cross.models;
	result->gather_seconds = cross.gather_seconds;
	result->pilot_seconds = cross.pilot_seconds;
	result->fit_seconds = cross.fit_seconds;
	return rc;
}

/*
 * A method that wants halves. The colour of all samples is no more needed, unless it is what is
 * regressed: the result's place.
 */
static int run_halves(struct denoise_job *job, struct gd_apr_frame *f, struct gd_plane *mse,
		      struct gd_denoise_result *result, const struct gd_report *report,
		      struct gd_err *err)
{
	const bool lwr = job->conf->method == GD_DENOISE_LWR;
	const bool in_place = job->layer_halves && job->source != NO_HALVES;
	struct gd_plane made_est[GD_APR_RHS] = { 0 };
	struct gd_crossfit_out out = { .est = in_place ? f->y : made_est, .mse = mse };
	struct gd_crossfit_in *in = gd_calloc(1, sizeof *in);
	struct denoise_frames *frames = NULL;
	float *made[3] = { 0 };
	double start = gd_seconds();
	int rc = in ? GD_OK : gd_fail(err, GD_ENOMEM, "out of memory");

	if (rc == GD_OK)
		rc = gd_denoise_halves(job, f, in, made, &result->mended, report, err);
	if (rc == GD_OK && job->conf->nneighbour)
		rc = gd_denoise_frames(&frames, job, in, &result->mended, report, err);
	result->filter_seconds = gd_seconds() - start;
	if (rc == GD_OK && !in_place)
		rc = gd_denoise_new_planes(made_est, f->ny, f->y[0], err);
	if (rc == GD_OK)
		rc = lwr ? gd_denoise_lwr_halves(job, &out, in, result, report, err) :
			   fit_crossfit(job, &out, in, result, report, err);
	if (rc == GD_OK && !in_place)
		gd_denoise_copy_planes(f->y, made_est, f->ny);
	for (int c = 0; c < GD_APR_RHS; c++)
		free(made_est[c].v);
	for (int c = 0; c < 3; c++)
		free(made[c]);
	gd_denoise_frames_free(frames);
	free(in);
	return rc;
}

static int fit_single(struct denoise_job *job, struct gd_plane *est, struct gd_plane *mse,
		      struct gd_apr_frame *f, struct gd_denoise_result *result,
		      const struct gd_report *report, struct gd_err *err)
{
	const struct gd_apr_conf *apr = &job->conf->apr;
	struct gd_apr_out out = { .est = est, .mse = mse };
	struct gd_apr_paper_result paper;
	int rc = gd_image_add(job->im, "model.order", &out.order, err);

	if (rc == GD_OK)
		rc = gd_image_add(job->im, "model.columns", &out.columns, err);
	gd_note(report, "one regression in windows of %dx%d every %d pixels, orders %d to %d",
		2 * apr->radius + 1, 2 * apr->radius + 1, apr->step, apr->order_min,
		apr->order_max);
	if (rc == GD_OK)
		rc = gd_apr_paper(&out, f, apr, job->conf->spikes, &paper, report, err);
	if (rc != GD_OK)
		return rc;
	gd_note(report, "noise of neighbours: %.2f times the variance of independent pixels",
		paper.correlation);
	gd_note(report, "%d spikes, %d of them too bright to give all of it back", paper.spikes,
		paper.capped);
	result->mended += paper.mended;
	result->spikes = paper.spikes;
	result->models = 1;
	return GD_OK;
}

/* A method that takes all samples as one. */
static int run_whole(struct denoise_job *job, struct gd_apr_frame *f, struct gd_plane *mse,
		     struct gd_denoise_result *result, const struct gd_report *report,
		     struct gd_err *err)
{
	const bool lwr = job->conf->method == GD_DENOISE_LWR_WHOLE;
	struct gd_plane est[GD_APR_RHS] = { 0 };
	double start = gd_seconds();
	int rc = gd_denoise_new_planes(est, f->ny, f->y[0], err);

	if (rc == GD_OK)
		rc = lwr ? gd_denoise_lwr_whole(job, est, mse, f, result, report, err) :
			   fit_single(job, est, mse, f, result, report, err);
	if (rc == GD_OK)
		gd_denoise_copy_planes(f->y, est, f->ny);
	result->fit_seconds = gd_seconds() - start;
	for (int c = 0; c < GD_APR_RHS; c++)
		free(est[c].v);
	return rc;
}

static int run(struct denoise_job *job, struct gd_apr_frame *f, struct gd_plane (*bin)[3],
	       struct gd_denoise_result *result, const struct gd_report *report, struct gd_err *err)
{
	struct gd_plane mse[GD_LAYER_PLANES];
	int rc = gd_denoise_frame(job, f, bin, err);

	if (rc == GD_OK)
		rc = gd_layer_add(job->im, "error", 3, mse, err);
	if (rc != GD_OK)
		return rc;
	for (int i = 0; i < job->features.n; i++)
		gd_note(report, "feature %s%s", job->features.name[i],
			gd_denoise_crossed(job, job->features.name[i]) ? ", of either half" : "");
	result->crossfit = gd_denoise_crossfit(job);
	result->halves = result->crossfit && job->source != NO_HALVES;
	if (gd_denoise_follows(job))
		rc = gd_denoise_position(job, &result->mended, err);
	if (rc == GD_OK)
		rc = result->crossfit ? run_halves(job, f, mse, result, report, err) :
					run_whole(job, f, mse, result, report, err);
	if (rc == GD_OK && job->conf->sequence)
		rc = gd_denoise_time(job, f->y, mse, result, report, err);
	return rc;
}

int gd_denoise_run(struct gd_image *im, const struct gd_denoise_conf *conf,
		   struct gd_denoise_result *result, const struct gd_report *report,
		   struct gd_err *err)
{
	struct denoise_job job = { .im = im, .conf = conf, .keep = conf->keep };
	struct gd_apr_frame *f = gd_calloc(1, sizeof *f);
	struct gd_plane(*bin)[3] = gd_calloc(GD_MAX_BINS, sizeof *bin);
	int rc = GD_OK;

	*result = (struct gd_denoise_result){ 0 };
	if (!f || !bin)
		rc = gd_fail(err, GD_ENOMEM, "out of memory");
	if (rc == GD_OK)
		rc = gd_denoise_choose(&job, err);
	if (rc == GD_OK)
		rc = run(&job, f, bin, result, report, err);
	if (rc == GD_OK && !conf->keep)
		gd_denoise_release_used(&job);
	free(bin);
	free(f);
	gd_denoise_free(&job);
	return rc;
}
