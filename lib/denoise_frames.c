/* SPDX-License-Identifier: BSD-3-Clause */
/* The other frames of a sequence, for regressions over several of them. */
#include <stdlib.h>
#include <string.h>

#include "denoise_job.h"

struct denoise_frames {
	struct denoise_job job[GD_CROSSFIT_FRAMES];
	float *made[GD_CROSSFIT_FRAMES][3];
	struct gd_crossfit_frame frame[GD_CROSSFIT_FRAMES];
	struct gd_apr_frame f;			/* of the neighbour in work */
	struct gd_crossfit_in in;
	struct gd_plane bin[GD_MAX_BINS][3];
};

static int add(struct denoise_frames *k, int i, const struct denoise_job *like, size_t *mended,
	       const struct gd_report *report, struct gd_err *err)
{
	struct gd_crossfit_frame *frame = &k->frame[i];
	struct denoise_job *job = &k->job[i];
	int rc;

	*job = (struct denoise_job){ .im = &like->conf->neighbour[i], .conf = like->conf };
	memset(&k->f, 0, sizeof k->f);
	memset(&k->in, 0, sizeof k->in);
	rc = gd_denoise_choose_alike(job, like, err);
	if (rc == GD_OK)
		rc = gd_denoise_frame(job, &k->f, k->bin, err);
	k->f.nfeat = 0;	/* what a frame's own G-buffers are is enough: no need to filter these */
	if (rc == GD_OK && gd_denoise_follows(job))
		rc = gd_denoise_position(job, mended, err);
	if (rc == GD_OK)
		rc = gd_denoise_halves(job, &k->f, &k->in, k->made[i], mended, report, err);
	memcpy(frame->y, k->in.y, sizeof frame->y);
	memcpy(frame->whole, k->in.whole, sizeof frame->whole);
	memcpy(frame->var, k->in.var, sizeof frame->var);
	memcpy(frame->feature, k->in.feature, sizeof frame->feature);
	memcpy(frame->count, k->in.count, sizeof frame->count);
	memcpy(frame->position, job->position, sizeof frame->position);
	return rc;
}

/* Variances, positions and counts are known of all frames, or taken to be known of none. */
static void level(struct gd_crossfit_in *in, const struct gd_report *report)
{
	bool var = in->var[0].v, position = in->position[0].v, count = in->count[0].v;

	for (int i = 0; i < in->nframe; i++) {
		var = var && in->frame[i].var[0].v;
		position = position && in->frame[i].position[0].v;
		count = count && in->frame[i].count[0].v;
	}
	if (!position)
		gd_note(report, "without world positions (the layer P in all frames) nothing is "
			"followed: frames are compared pixel by pixel");
	for (int i = -1; i < in->nframe; i++) {
		if (!var)
			memset(i < 0 ? in->var : in->frame[i].var, 0, sizeof in->var);
		if (!position)
			memset(i < 0 ? in->position : in->frame[i].position, 0,
			       sizeof in->position);
		if (!count)
			memset(i < 0 ? in->count : in->frame[i].count, 0, sizeof in->count);
	}
}

int gd_denoise_frames(struct denoise_frames **frames, struct denoise_job *job,
		      struct gd_crossfit_in *in, size_t *mended, const struct gd_report *report,
		      struct gd_err *err)
{
	struct denoise_frames *k;
	int rc = GD_OK;

	*frames = k = gd_calloc(1, sizeof *k);
	if (!k)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	in->nframe = job->conf->nneighbour;
	in->frame = k->frame;
	memcpy(in->position, job->position, sizeof in->position);
	for (int i = 0; i < in->nframe && rc == GD_OK; i++)
		rc = add(k, i, job, mended, report, err);
	level(in, report);
	return rc;
}

void gd_denoise_frames_free(struct denoise_frames *k)
{
	if (!k)
		return;
	for (int i = 0; i < GD_CROSSFIT_FRAMES; i++) {
		for (int c = 0; c < 3; c++)
			free(k->made[i][c]);
		gd_denoise_free(&k->job[i]);
	}
	free(k);
}
