/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Input planes as the solver sees them: finite, scaled to about 1, row by row on the
 * fly, so that nothing is stored twice. And the way back: unscaling, and setting the
 * constants that gradients leave free.
 */
#ifndef GD_FIELD_H
#define GD_FIELD_H

#include "gd.h"
#include "multigrid.h"
#include "plane.h"

#define GD_FIELD_MAX 3

struct gd_field {
	int w, h, n;
	float scale;				/* what radiance is multiplied by: a power of 2 */
	const struct gd_plane *primal;		/* n planes; v = NULL: none */
	const struct gd_plane *dx, *dy;		/* NULL: no use is made of them */
};

/* GD_ESHAPE unless all n planes are w x h; name says which they are. v = NULL is passed over. */
int gd_field_check(const struct gd_plane *plane, int n, int w, int h, const char *name,
		   struct gd_err *err);

/*
 * Typical brightness, radiance: the mean of min(|v|, 100 x median of the positive |v|) over
 * the primal, or over the gradients where there is no primal or it is 0; 0 if everything
 * is. Proportional to the input.
 */
double gd_field_level(const struct gd_field *field);

/* Power of 2 that brings level near 1, within what float can multiply by. */
float gd_field_scale(double level);

/* Floats of work space that gd_field_rows() needs per thread. */
size_t gd_field_work(const struct gd_field *field);

/* Cleaned rows for row y (row -1 of dy: zeros). A non-finite primal
 * pixel becomes the median of its finite neighbours (0 without any). */
struct gd_mg_rows gd_field_rows(const struct gd_field *field, int y, float *work);

/* The primal's part of that: row y of channel c, in work (w floats). */
const float *gd_field_primal(const struct gd_field *field, int c, int y, float *work);

/* Sets a_i: weight where the primal is finite, 1e-4 weight elsewhere. */
void gd_field_screen(const struct gd_field *field, const struct gd_mg_level *l, bool wide,
		     double weight);

/*
 * Adds to each connected part of x the constant that gives it the mean of the primal (mean 0 if
 * target is false or there is no primal). all: the edges are known to connect everything. parts
 * (may be NULL): their number.
 */
int gd_field_anchor(const struct gd_field *field, const struct gd_mg_level *l, bool wide, void *x,
		    bool target, bool all, int *parts, struct gd_err *err);

/* to = x / scale, limited to finite floats. */
void gd_field_store(const struct gd_field *field, const struct gd_plane *to,
		    const struct gd_mg_level *l, bool wide, const void *x);

#endif
