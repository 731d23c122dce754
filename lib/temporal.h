/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Frames of a sequence, each denoised by itself, filtered along time. Every pixel carries a model
 * of its colour, linear in time and fitted recursively with older frames counting less and less:
 *	z = (1, t),  t counted from the newest frame
 *	g = P z / (lambda s2 + z' P z),  P <- (P - g z' P) / lambda,  b <- b + g (y - b' z)
 * and hands it on to the pixel of the next frame that shows the same place: world position and
 * predicted colour agree best within a search window. Where none does (what was hidden, what came
 * into view) a pixel starts anew, and where a frame disagrees with its prediction by more than the
 * errors of both, the past counts less.
 * Source: Moon, Iglesias-Guitian, Yoon, Mitchell, Adaptive Rendering with Linear Predictions
 * (2015), section 6. Differs: time is counted anew at each frame, both factors of the search have
 * floors, frames weigh by their estimated error (s2), a new pixel's slope is held towards 0, models
 * follow a change of the whole image's light, the forgetting adapts, the search follows motion
 * beyond its window; conf.paper takes all but the first two away.
 */
#ifndef GD_TEMPORAL_H
#define GD_TEMPORAL_H

#include <stdbool.h>

#include "image.h"

#define GD_TEMPORAL_RADIUS 16	/* largest radius of the search window, pixels */
#define GD_TEMPORAL_REACH 128	/* farthest motion between two frames, pixels */

struct gd_temporal_conf {
	double forget;	/* lambda: what a frame counts one frame later; 0.5 .. 1 */
	int radius;	/* of the search window, pixels; 0 .. GD_TEMPORAL_RADIUS */
	int reach;	/* motion looked for before that, on a coarse grid, pixels; 0: none */
	bool paper;	/* the recursion as printed */
};
#define GD_TEMPORAL_DEFAULTS ((struct gd_temporal_conf){ .forget = 0.98, .radius = 3, .reach = 32 })

/*
 * What one frame hands to the next: planes of one size, in this order. As an image they are
 * channels of the names that gd_temporal_channel() gives.
 */
enum gd_temporal_plane {
	GD_TEMPORAL_VALUE,		/* state.value.R G B: colour that the model has now */
	GD_TEMPORAL_SLOPE = 3,		/* state.slope.R G B: its change from frame to frame */
	GD_TEMPORAL_P = 6,		/* state.P.00 01 11: variance of value and slope */
	GD_TEMPORAL_POSITION = 9,	/* state.position.X Y Z: the world position seen */
	GD_TEMPORAL_FRAMES = 12,	/* state.frames: frames that a pixel was followed; 1: new */
	GD_TEMPORAL_PLANES
};

struct gd_temporal_state {
	struct gd_plane plane[GD_TEMPORAL_PLANES];
};

/* Full EXR name of the channel of plane i, "state.value.R"; NULL beyond the last. */
const char *gd_temporal_channel(int i);

/*
 * For a front end. want: of an image of which only the header is known, marks the state to be read
 * and everything else to be dropped; GD_ESHAPE names a channel that is missing. view: the planes
 * of an image that was read so. add: zeroed channels for a new state; those of that name that im
 * came with are replaced.
 */
int gd_temporal_want(struct gd_image *im, struct gd_err *err);
int gd_temporal_view(struct gd_temporal_state *state, const struct gd_image *im,
		     struct gd_err *err);
int gd_temporal_add(struct gd_temporal_state *state, struct gd_image *im, struct gd_err *err);

/*
 * Planes of one size.
 * y         R G B of the frame, denoised
 * mse       its estimated mean squared error, unit of y squared, >= 0; v = NULL: unknown (the
 *           frames then weigh alike)
 * position  P.X P.Y P.Z, world position that a pixel sees, any unit; 0 0 0: nothing (the sky),
 *           which is followed by its place in the image
 * previous  the state that the frame before left, or NULL: this is the first one. Pixels of it that
 *           are no state (NaN, 1e34 and more, a variance below 0) count as new
 */
struct gd_temporal_in {
	struct gd_plane y[3], mse[3], position[3];
	const struct gd_temporal_state *previous;
};

/*
 * est       R G B, finite; may be in->y
 * mse       its estimated mean squared error; v = NULL: not wanted; may be in->mse
 * state     what the next frame needs; must not overlap anything else
 */
struct gd_temporal_out {
	struct gd_plane est[3], mse[3];
	struct gd_temporal_state state;
};

struct gd_temporal_result {
	size_t fresh;		/* pixels that started anew */
	size_t changed;		/* followed, but their past was made to count less */
	double mean_frames;	/* that a pixel was followed */
};

/*
 * Returns GD_OK, GD_EARG, GD_ESHAPE (the previous frame's size differs), GD_ENOMEM. The result does
 * not depend on the number of threads; scaling y (and mse by the square) does the same to the
 * result, shifting or scaling positions nothing, to rounding.
 */
int gd_temporal_run(const struct gd_temporal_out *out, const struct gd_temporal_in *in,
		    const struct gd_temporal_conf *conf, struct gd_temporal_result *result,
		    const struct gd_report *report, struct gd_err *err);

#endif
