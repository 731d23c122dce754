/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * One run of gd_denoise_run(), in parts: which channels (denoise_channels.c), their planes, mended
 * and as halves (denoise_load.c), the methods (denoise.c, denoise_lwr.c) and
 * sequences (denoise_frames.c, denoise_time.c).
 */
#ifndef GD_DENOISE_JOB_H
#define GD_DENOISE_JOB_H

#include "crossfit.h"
#include "denoise.h"

#define DENOISE_LAYERS 48	/* most layers of features, or to denoise along with the colour */

/* Names cut from a list. */
struct denoise_names {
	int n;
	char *text;
	const char *name[DENOISE_LAYERS];
};

/* Where the independent halves of the samples are. */
enum denoise_source { NO_HALVES, HALVES, BINS };

struct denoise_job {
	struct gd_image *im;
	const struct gd_denoise_conf *conf;
	const struct denoise_job *like;	/* of a neighbour: the frame to denoise */
	bool keep;			/* planes that are used stay as they were read */
	struct denoise_names features, layers;
	enum denoise_source source;
	int bins;		/* of the colour */
	double share[2];	/* of the samples, in either half */
	bool layer_halves;	/* all layers come in halves (or bins), as the colour does */
	struct gd_plane position[3];	/* of a sequence, or v = NULL */
	int ncopy;
	float **copy;		/* of planes that stay as they were read */
};

/* ---- denoise_channels.c ---- */

/* Features, layers, halves: what there is of what was asked for. */
int gd_denoise_choose(struct denoise_job *job, struct gd_err *err);
/* The same in a neighbour of a frame of which that is known, and whose job outlives it. */
int gd_denoise_choose_alike(struct denoise_job *job, const struct denoise_job *like,
			    struct gd_err *err);
/* Whether world positions are read. */
bool gd_denoise_follows(const struct denoise_job *job);
/* Whether halves, if there are any, are used as such. */
bool gd_denoise_crossfit(const struct denoise_job *job);
/* A feature whose halves know different noise: cross-fitted rather than taken from all samples. */
bool gd_denoise_crossed(const struct denoise_job *job, const char *feature);
/* "half0.diffuse", "bin3", ...: the share of a layer ("": the colour) in half or bin i. */
const char *gd_denoise_part(char name[256], const char *part, int i, const char *layer);
/* Frees a layer's channels, its variances, all that was read only to be used. */
void gd_denoise_release(struct gd_image *im, const char *layer);
void gd_denoise_release_variance(struct gd_image *im, const char *layer);
void gd_denoise_release_used(struct denoise_job *job);
/* Frees what the job holds itself. */
void gd_denoise_free(struct denoise_job *job);

/* ---- denoise_load.c ---- */

/* n planes like one, not zeroed; those made before a failure are to be freed, too. */
int gd_denoise_new_planes(struct gd_plane *p, int n, struct gd_plane like, struct gd_err *err);
void gd_denoise_copy_planes(struct gd_plane *to, const struct gd_plane *from, int n);
/*
 * The whole image: colour, layers, and what they are judged by. bin: room for GD_MAX_BINS.
 * GD_EARG: too many planes.
 */
int gd_denoise_frame(struct denoise_job *job, struct gd_apr_frame *f, struct gd_plane (*bin)[3],
		     struct gd_err *err);
/*
 * Mends and filters what both halves share, fills in the halves: the input of a cross-fitted
 * method. made: variances that had to be made, to be freed. Feature variances are done with then.
 */
int gd_denoise_halves(struct denoise_job *job, struct gd_apr_frame *f, struct gd_crossfit_in *in,
		      float *made[3], size_t *mended, const struct gd_report *report,
		      struct gd_err *err);

/* The world positions of a sequence, mended, into job->position. */
int gd_denoise_position(struct denoise_job *job, size_t *mended, struct gd_err *err);

/* ---- denoise_frames.c ---- */

/*
 * Mends, filters and fills in the neighbours of a frame; in is that frame's, after
 * gd_denoise_halves(), and points to them until they are freed. The latter takes NULL.
 */
struct denoise_frames;
int gd_denoise_frames(struct denoise_frames **frames, struct denoise_job *job,
		      struct gd_crossfit_in *in, size_t *mended, const struct gd_report *report,
		      struct gd_err *err);
void gd_denoise_frames_free(struct denoise_frames *frames);

/* ---- denoise_lwr.c ---- */

/* Linear predictions of halves, and of all samples: into est and mse (3 planes). */
int gd_denoise_lwr_halves(struct denoise_job *job, struct gd_crossfit_out *out,
			  struct gd_crossfit_in *in, struct gd_denoise_result *result,
			  const struct gd_report *report, struct gd_err *err);
int gd_denoise_lwr_whole(struct denoise_job *job, struct gd_plane *est, struct gd_plane *mse,
			 struct gd_apr_frame *f, struct gd_denoise_result *result,
			 const struct gd_report *report, struct gd_err *err);

/* ---- denoise_time.c ---- */

/* Filters the denoised colour and its error along time, in place, and adds state.* to the image. */
int gd_denoise_time(struct denoise_job *job, const struct gd_plane *colour,
		    const struct gd_plane *mse, struct gd_denoise_result *result,
		    const struct gd_report *report, struct gd_err *err);

#endif
