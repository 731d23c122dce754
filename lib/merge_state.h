/* SPDX-License-Identifier: BSD-3-Clause */
/* What merge.c (looking and adding) and merge_out.c (the result) share. */
#ifndef GD_MERGE_STATE_H
#define GD_MERGE_STATE_H

#include <stdint.h>

#include "accum.h"
#include "merge.h"

#define MERGE_COMP GD_NAMED_MAX	/* channels of a layer */
#define MERGE_EDGES 6			/* layers of gradients: dx, dy, pair0 .. pair3 */

struct merge_layer {
	char name[256];			/* "" is the colour */
	int n;				/* channels */
	char out[MERGE_COMP][256];	/* their names in the result */
	bool binned;		/* the colour and its gradients: what bins are made of */
	bool half;			/* half0 or half1: half the samples */
	int edge;			/* which gradients it holds, whole or of a half; or -1 */
	bool place, placed;		/* where pairs lead: no mean, the same in all inputs */
	bool wanted;
	int carriers, with_variance;	/* inputs that have it; that have its variance */
	bool spread;			/* its variance comes from the spread of parts */
	bool has_variance;
	struct gd_plane mean[MERGE_COMP], m2[MERGE_COMP];
	struct gd_plane bin[GD_MAX_BINS][MERGE_COMP];
	struct gd_count count;		/* samples so far */
	struct gd_count parts;		/* independent parts so far, if spread */
	struct gd_count *bin_count;	/* samples of each bin so far, unless in lockstep */
	size_t dropped, empty;
};

struct merge_input {
	char *label;
	double spp;			/* 0: not known from --spp or attributes */
	bool per_pixel;			/* has a channel "samples" */
	bool sided;			/* tells the samples of either half, too */
	int units;			/* bins it holds, else 1 */
	int first_unit;
	uint64_t digest;		/* of the bits of its colour; 0: all pixels are alike */
};

struct gd_merge {
	struct gd_merge_conf conf;
	int w, h, ninput, nlayer;
	int x0, y0;			/* where the data windows begin */
	struct merge_input *input;
	struct merge_layer *layer;
	const char *wants_counts;	/* label of an input whose variances need sample counts */
	bool counted;			/* sample counts are known */
	int bins;			/* being made */
	bool keep_bins, make_halves;
	bool lockstep;			/* every input's bin b goes into bin b */
	bool sided;			/* an input is: bins are counted one by one */
	int *unit_bin;			/* bin of each unit of each input */
	double bin_samples[GD_MAX_BINS];	/* of each bin so far, mean over the image */
	struct gd_names names;		/* of the input being added, ... */
	char **source;			/* ... and its channels' names */
	int nsource;
	struct gd_plane side[2];	/* of the input being added, if it is sided */
	struct gd_plane worth[MERGE_EDGES];	/* in samples, of its gradients, if it tells */
	struct gd_plane place[MERGE_EDGES - 2][2];	/* pairK.x, pairK.y, of the result */
	struct gd_plane weight, within;	/* work space */
	int twins;
	struct gd_image out;
};

/* Is name prefix, digits and then nothing or a dot: "bin12", "bin0.dx" of the family "bin"? */
bool gd_merge_in_family(const char *name, const char *prefix);
/* Is it the name of the samples of either half? */
bool gd_merge_is_side(const char *name);
/* ... of what a gradient is worth in samples, "dx.samples"? */
bool gd_merge_is_worth(const char *name);
/* Which gradients a layer holds, 0 .. MERGE_EDGES - 1 of dx, dy, pair0 ...; or -1. */
int gd_merge_edge_of(const char *name);
struct merge_layer *gd_merge_layer(struct gd_merge *m, const char *name);	/* or NULL */
/* The layer of bin b, e.g. "bin3.dx" of "dx", or NULL. */
const struct gd_named *gd_merge_bin_of(const struct gd_names *names, const struct gd_named *layer,
				       int b);
void gd_merge_forget_names(struct gd_merge *m);

/* --- merge_weigh.c --- */

/* Two pixels of a and b samples: what the gradient between them is worth. */
static inline double gd_merge_harmonic(double a, double b)
{
	return a > 0 && b > 0 ? 2 * (a / (a + b)) * b : 0;
}

/* The pixel at the other end of the edge that a pixel has in gradients `edge`; itself if none. */
void gd_merge_other_end(const struct gd_merge *m, int edge, int *x, int *y);

/*
 * The samples behind a layer's means: count of the pixel, half of them for a half unless the input
 * tells how many; gradients: what they are worth. bad: a plane in any case (m->weight).
 */
void gd_merge_weigh(struct gd_merge *m, const struct merge_layer *l, const struct gd_count *count,
		    bool bad, struct gd_count *w);
/* Those of the even (0) or odd (1) bins of a sided input, times scale: a plane. */
void gd_merge_weigh_side(struct gd_merge *m, const struct merge_layer *l, int side, float scale,
			 struct gd_count *w);

#endif
