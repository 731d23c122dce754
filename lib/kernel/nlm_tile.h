/* SPDX-License-Identifier: BSD-3-Clause */
/* Between nlm.c and its kernels: one tile of the image with the pixels around it that it needs. */
#ifndef GD_NLM_TILE_H
#define GD_NLM_TILE_H

#include <stdbool.h>
#include <stdint.h>

#include "isa.h"
#include "nlm.h"

#define GD_NLM_FAR	1e7f	/* distances of pixels are cut here: one such in a patch is enough,
				 * even with 16 planes of 33 x 33, since exp(-1e7 / 17424) is 0 */
#define GD_NLM_LIMIT	1e5f	/* guides are cut here, in their own standard deviations, and their
				 * variances at its square: products of three stay floats */
#define GD_NLM_NOISE	1e-10f	/* the least noise, for the same reason */
#define GD_NLM_GROUP	5	/* neighbouring shifts that are treated together */
#define GD_NLM_CHUNK	8	/* pixels of a row that are worked on, or left out, together */
#define GD_NLM_BAD	1
#define GD_NLM_HUGE	2
#define GD_NLM_ROOM	1e33f	/* above it 65 x 65 values could exceed the largest float */

/* Every pointer to pixels is that of the tile's first pixel, rows are stride floats apart. */
struct gd_nlm_tile {
	int w, h;			/* pixels to filter */
	int left, right, top, bottom;	/* the image is left <= x < right, top <= y < bottom */
	int patch, window, nguide, n;
	size_t stride;
	float scale, far;		/* of all distances: 1 / k^2, and GD_NLM_FAR before that */
	float noise[GD_NLM_PLANES];	/* e / k^2 */
	/* patch + window more pixels around */
	float *guide[GD_NLM_PLANES], *guide_var[GD_NLM_PLANES];
	/* window more pixels around; a variance may be NULL */
	float *in[GD_NLM_PLANES], *in_var[GD_NLM_PLANES];
	/* the same of the frame that the pixels to average are from; may be those above */
	float *other[GD_NLM_PLANES], *other_var[GD_NLM_PLANES];
	float *from[GD_NLM_PLANES], *from_var[GD_NLM_PLANES];
	float *known;			/* what its pixels count; NULL: all 1 */
	/* w x h, sums of weighted values */
	float *sum[GD_NLM_PLANES], *sum_var[GD_NLM_PLANES];
	float *sum_weight;
	float *noisy;			/* w x h: 1 for a pixel to filter, 0 for one that stays */
	uint32_t *active;		/* [h]: a bit for each chunk of a row with any to filter */
	uint32_t *needed;		/* [-patch .. h + patch): chunks that their patches reach */
	float *dist, *ring, *weight, *share;	/* scratch rows: 1, and for each shift of a group
						 * 2 patch + 1, 1 and 1 */
};

struct gd_nlm_kernel {
	/* to = scale * scale2 * (from - offset), cut to lo .. hi; returns GD_NLM_BAD if a value is
	 * not finite, with GD_NLM_HUGE if one is so large that sums could overflow. */
	int (*load)(float *to, const float *from, int n, float offset, float scale, float scale2,
		    float lo, float hi);
	/* noisy = 1 where any guide's variance is above most[c]; fills active and needed, too.
	 * Returns whether there is any such pixel. */
	bool (*mark)(const struct gd_nlm_tile *t, const float *most);
	void (*clear)(const struct gd_nlm_tile *t);	/* the sums */
	/* Adds up the shifts by dy and -last .. last. */
	void (*sums)(const struct gd_nlm_tile *t, int dy, int last);
	/* out = scale (centre + sum / weight), without the latter where the pixel stays */
	void (*mean)(const struct gd_nlm_tile *t, int plane, int y, float scale, float *out);
	/* out_var = scale sum_var / weight^2, or scale in_var */
	void (*mean_var)(const struct gd_nlm_tile *t, int plane, int y, float scale,
			 float *out_var);
};

GD_KERNEL_TABLE(struct gd_nlm_kernel, gd_nlm_kernel);

#endif
