/* SPDX-License-Identifier: BSD-3-Clause */
/* Inside the feature stage: features before they are written, and how they are filtered. */
#ifndef GD_FEATURE_FRAMES_H
#define GD_FEATURE_FRAMES_H

#include "feature.h"

/* Views of a feature's planes. */
struct gd_feature_set {
	int n;					/* channels, 1 .. 3 */
	bool halves;				/* half is known */
	struct gd_plane whole[3], whole_var[3];	/* variance of the detail */
	struct gd_plane half[2][3], half_var[2][3];
	struct gd_plane known;			/* what pixels count, 0 .. 1; v = NULL: 1 */
};

/* Marks the feature's channels to be read; false if im lacks any that the filter needs. */
bool gd_feature_set_want(struct gd_image *im);
/* Finds them. false as above. */
bool gd_feature_set_find(struct gd_feature_set *set, const struct gd_image *im);

/*
 * Non-local means of `from`, with windows that span the frames (count may be 0), of radius `window`
 * there. Weights of each half go to the other half and to the feature of all bins, which becomes
 * the mean of the two results: half of its noise is unknown to either set of weights, where weights
 * from itself would know all of it and keep it. Its variance before is half of that of a half,
 * hence after, too, for either set of weights; it is at most the mean of these two. Without halves
 * the feature supplies its own weights. other: n planes of scratch.
 */
int gd_feature_set_filter(const struct gd_feature_set *to, const struct gd_feature_set *from,
			  const struct gd_feature_set *frame, int count, int window,
			  const struct gd_plane *other, const struct gd_nlm_conf *conf,
			  const struct gd_report *report, struct gd_err *err);

void gd_feature_set_copy(const struct gd_feature_set *to, const struct gd_feature_set *from);

/*
 * The feature of a neighbour, one of conf's (made as the frame's own if it has none), to the pixels
 * and to the slow parts of `own`: views of the neighbour's planes, which change. position:
 * X Y Z of the frame itself; position[0].v = NULL, or a neighbour without: pixels stay where they
 * are. known: a plane for what pixels count, 0 where the neighbour shows something else.
 * result: frames, followed and solved count, found adds up.
 */
int gd_feature_set_neighbour(struct gd_feature_set *frame, struct gd_image *neighbour,
			     struct gd_plane known, const struct gd_feature_set *own,
			     const struct gd_plane *position, const struct gd_feature_conf *conf,
			     struct gd_feature_result *result, const struct gd_report *report,
			     struct gd_err *err);

#endif
