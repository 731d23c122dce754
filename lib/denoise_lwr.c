/* SPDX-License-Identifier: BSD-3-Clause */
/* The denoiser's linear predictions: cross-fitted, or of all samples. */
#include <stdlib.h>
#include <string.h>

#include "denoise_job.h"
#include "halves.h"
#include "lwrfit.h"

static int add_model(struct gd_image *im, struct gd_lwrfit_model *model, struct gd_err *err)
{
	int rc = gd_image_add(im, "model.radius", &model->radius, err);

	if (rc == GD_OK)
		rc = gd_image_add(im, "model.features", &model->features, err);
	if (rc == GD_OK)
		rc = gd_image_add(im, "model.centre", &model->centre, err);
	return rc;
}

/* What was built, for a report and for figures. */
static void tell(const struct gd_lwrfit_model *model, size_t models, double mean_radius,
		 struct gd_denoise_result *result, const struct gd_report *report)
{
	const double pixels = (double)model->radius.w * (double)model->radius.h;

	result->models = models;
	result->share = (double)models / (result->halves ? 2 * pixels : pixels);
	result->mean_radius = mean_radius;
	result->mean_features = gd_halves_mean(model->features);
	gd_note(report, "%zu models%s: one for %.1f %% of the pixels; mean radius %.2f, "
		"%.1f features in use", models, result->halves ? " of both halves" : "",
		100 * result->share, mean_radius, result->mean_features);
}

int gd_denoise_lwr_halves(struct denoise_job *job, struct gd_crossfit_out *out,
			  struct gd_crossfit_in *in, struct gd_denoise_result *result,
			  const struct gd_report *report, struct gd_err *err)
{
	struct gd_lwrfit_model model;
	struct gd_lwrfit_result fit = { 0 };
	int rc = add_model(job->im, &model, err);

	if (rc == GD_OK)
		rc = gd_image_add(job->im, "model.spread", &out->spread, err);
	if (rc == GD_OK)
		rc = gd_lwrfit_run(out, &model, in, &job->conf->lwr, &fit, report, err);
	if (rc != GD_OK)
		return rc;
	result->fit_seconds = fit.fit_seconds;
	tell(&model, fit.models, fit.mean_radius, result, report);
	gd_note(report, "brightest pixels times %.4f to keep the mean", fit.gain);
	return GD_OK;
}

int gd_denoise_lwr_whole(struct denoise_job *job, struct gd_plane *est, struct gd_plane *mse,
			 struct gd_apr_frame *f, struct gd_denoise_result *result,
			 const struct gd_report *report, struct gd_err *err)
{
	struct gd_lwrfit_model model;
	struct gd_lwr_result fit = { 0 };
	float *made[3] = { 0 };
	int rc = add_model(job->im, &model, err);

	if (rc == GD_OK)
		rc = gd_apr_frame_mend(f, made, &result->mended, report, err);
	if (rc == GD_OK) {
		const struct gd_lwr_out out = {
			.est = est, .mse = mse, .radius = model.radius,
			.features = model.features, .centre = model.centre };
		const struct gd_lwr_in in = {
			.ny = f->ny, .nfeat = f->nfeat, .y = f->y, .var = f->var, .feat = f->feat,
			.feat_var = job->conf->no_filter ? NULL : f->feat_var };

		rc = gd_lwr_fit(&out, &in, &job->conf->lwr, &fit, report, err);
	}
	if (rc == GD_OK)
		tell(&model, fit.models, fit.mean_radius, result, report);
	for (int c = 0; c < 3; c++)
		free(made[c]);
	return rc;
}
