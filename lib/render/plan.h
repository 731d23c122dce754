/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * What a render spends where: the samples of each pixel, which of them trace offset paths, and
 * along which edges. Coordinates are those of the crop, from (0, 0).
 *
 * Sample s of a pixel is number t = s / bins of bin s mod bins (without bins: number s of the one
 * there is). It traces offset paths if ceil(share (t + 1)) > ceil(share t): so the first of every
 * bin does, and ceil(share m) of its first m, whatever m will be in the end.
 */
#ifndef GD_RENDER_PLAN_H
#define GD_RENDER_PLAN_H

#include <stdint.h>

#include "render/render.h"

struct gd_plan {
	const struct gd_render_conf *conf;
	int w, h;		/* of the crop */
};

struct gd_plan gd_plan(const struct gd_render_conf *conf);

/* Samples of a pixel in one round: those of the map, or conf->spp, or 1 if time alone decides. */
uint32_t gd_plan_samples(const struct gd_plan *p, int x, int y);

/* The share of them that traces offset paths, 0 .. 1. */
double gd_plan_share(const struct gd_plan *p, int x, int y);

/* Of the first m samples of a bin, how many trace offset paths. */
uint32_t gd_plan_traced(double share, uint32_t m);

/* Of the first n samples of a pixel, how many do. */
uint32_t gd_plan_traced_of(const struct gd_plan *p, double share, uint32_t n);

/*
 * An edge at a pixel: to the pixel (x, y) away. r: samples that trace offset paths there over those
 * here (with a time limit: in the long run); 0: one of the two pixels has none, and nobody does.
 */
struct gd_edge {
	int x, y;
	float r;
};

/* The edges at a pixel, in an order that depends on nothing but their directions; the number. */
int gd_plan_edges(const struct gd_plan *p, int x, int y, struct gd_edge edge[GD_PAIRS]);

/* Its place among the edges of a pixel, or -1. */
int gd_plan_find(const struct gd_edge *edge, int n, int x, int y);

/* Gradient layers: dx and dy, or one for each K of pairK in use; at most GD_PAIRS. */
int gd_plan_layers(const struct gd_plan *p);

/* The edge that layer k has at a pixel; false if it has none. */
bool gd_plan_edge(const struct gd_plan *p, int k, int x, int y, int *dx, int *dy);

#endif
