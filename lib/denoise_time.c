/* SPDX-License-Identifier: BSD-3-Clause */
/* A frame of a sequence: its denoised colour is filtered along time. */
#include <string.h>

#include "denoise_job.h"

int gd_denoise_time(struct denoise_job *job, const struct gd_plane *colour,
		    const struct gd_plane *mse, struct gd_denoise_result *result,
		    const struct gd_report *report, struct gd_err *err)
{
	const size_t three = 3 * sizeof *colour;
	const struct gd_denoise_conf *conf = job->conf;
	struct gd_temporal_state before;
	struct gd_temporal_result time = { 0 };
	struct gd_temporal_in in = { .previous = conf->previous ? &before : NULL };
	struct gd_temporal_out out;
	double start = gd_seconds();
	int rc = gd_temporal_add(&out.state, job->im, err);

	if (rc == GD_OK && conf->previous)
		rc = gd_temporal_view(&before, conf->previous, err);
	memcpy(in.y, colour, three);
	memcpy(in.mse, mse, three);
	memcpy(in.position, job->position, three);
	memcpy(out.est, colour, three);
	memcpy(out.mse, mse, three);
	if (rc == GD_OK)
		rc = gd_temporal_run(&out, &in, &conf->time, &time, report, err);
	result->followed = 1 - (double)time.fresh / ((double)colour->w * (double)colour->h);
	result->mean_frames = time.mean_frames;
	result->time_seconds = gd_seconds() - start;
	return rc;
}
