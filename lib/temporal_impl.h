/* SPDX-License-Identifier: BSD-3-Clause */
/* Between the parts of the filter along time (temporal.h): not for others. */
#ifndef GD_TEMPORAL_IMPL_H
#define GD_TEMPORAL_IMPL_H

#include "temporal.h"

#define GD_TEMPORAL_NOWHERE (-1)	/* no pixel of the frame before shows this place */

/* A model; of the frame before, one frame on: what it foretells. */
struct gd_temporal_model {
	float v[3], slope[3];
	float p[3];		/* variance of value, covariance, variance of slope */
	float at[3];		/* world position */
	float frames;		/* 0: there is none */
};

/* A pixel of this frame. */
struct gd_temporal_here {
	float y[3];
	float at[3];		/* world position, its noise smoothed */
	float s2;		/* squared error of y, mean of the channels */
	float size2;		/* squared distance to the positions of pixels around */
};

struct gd_temporal_work {
	int w, h;
	struct gd_temporal_here *here;
	struct gd_temporal_model *before;	/* of each pixel of the frame before */
	struct gd_temporal_model *model;	/* of each pixel of this one: the match */
	int *match;				/* index into before, or GD_TEMPORAL_NOWHERE */
	float *change;	/* misfit in excess, over what errors explain; 0: none */
};

static inline size_t gd_temporal_index(const struct gd_temporal_work *k, int x, int y)
{
	return (size_t)y * (size_t)k->w + (size_t)x;
}

static inline float gd_temporal_distance2(const float a[3], const float b[3])
{
	const float d0 = a[0] - b[0], d1 = a[1] - b[1], d2 = a[2] - b[2];

	return d0 * d0 + d1 * d1 + d2 * d2;
}

static inline bool gd_temporal_nothing(const float at[3])
{
	return at[0] == 0 && at[1] == 0 && at[2] == 0;
}

/* temporal_match.c: fills here[].at and size2; then match[] from here[] and before[]. */
int gd_temporal_locate(struct gd_temporal_work *k, const struct gd_plane position[3],
		       struct gd_err *err);
int gd_temporal_match(struct gd_temporal_work *k, const struct gd_temporal_conf *conf,
		      struct gd_err *err);

/* temporal_change.c: models follow a change of all light; then change[] from here[] and model[]. */
int gd_temporal_light(struct gd_temporal_work *k, struct gd_err *err);
int gd_temporal_change(struct gd_temporal_work *k, double forget, struct gd_err *err);

#endif
