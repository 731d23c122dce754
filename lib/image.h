/* SPDX-License-Identifier: BSD-3-Clause */
/* An image: the owner of named planar channels on one pixel grid, with its attributes. */
#ifndef GD_IMAGE_H
#define GD_IMAGE_H

#include <stdbool.h>

#include "gd.h"
#include "plane.h"

enum gd_type { GD_UINT, GD_HALF, GD_FLOAT };		/* as in the file; 4, 2 and 4 bytes */
enum gd_want { GD_PASS, GD_READ, GD_DROP };

/*
 * A channel holds its pixels in one of two forms. want = GD_READ: v, as float.
 * want = GD_PASS: raw, rows of w values of the file's type without padding, native byte order,
 * never interpreted, so that it leaves bit-exact. GD_DROP: neither; it is not written.
 */
struct gd_channel {
	char *name;		/* full EXR name, e.g. "half0.dx.R" */
	enum gd_type type;	/* in the file; channels with v are written as GD_FLOAT */
	enum gd_want want;
	float *v;		/* h rows of gd_stride(w) floats, or NULL */
	unsigned char *raw;	/* h * w * size of type bytes, or NULL */
};

/* An attribute in the serialisation of the EXR file format (little-endian bytes). */
struct gd_attr {
	char *name, *type;	/* e.g. "gd:bins", "int" */
	size_t size;
	unsigned char *data;
};

struct gd_box { int x0, y0, x1, y1; };	/* inclusive, as in EXR */

/* { 0 } is a valid empty image. w and h are those of the data window. */
struct gd_image {
	int w, h;
	struct gd_box data, display;
	int nchan;
	struct gd_channel *chan;
	int nattr;
	struct gd_attr *attr;
};

/* An empty image of w x h with both windows at the origin. */
void gd_image_init(struct gd_image *im, int w, int h);
void gd_image_free(struct gd_image *im);	/* takes { 0 } and half-built ones */

/* Index of a channel by its full name, or -1. */
int gd_image_find(const struct gd_image *im, const char *name);

/* A view of a float channel; false if there is none of that name or it was not read. */
bool gd_image_plane(const struct gd_image *im, const char *name, struct gd_plane *plane);

/* A zeroed float channel, replacing one of that name. */
int gd_image_add(struct gd_image *im, const char *name, struct gd_plane *plane, struct gd_err *err);

/* A channel without pixels at the end of the list; want = GD_PASS. The name must be new. */
int gd_image_append(struct gd_image *im, const char *name, enum gd_type type, struct gd_err *err);

/* Frees one channel, or all for which drop() holds. Indices change. */
void gd_image_drop(struct gd_image *im, const char *name);
void gd_image_drop_if(struct gd_image *im, bool (*drop)(const char *name, void *user), void *user);

/* Attributes; setters replace one of that name, whatever its type. Getters return false if absent
 * or of a type that does not convert (numbers: int, float, double, strings that hold a number). */
int gd_attr_set(struct gd_image *im, const char *name, const char *type, const void *data,
		size_t size, struct gd_err *err);
int gd_attr_set_string(struct gd_image *im, const char *name, const char *text, struct gd_err *err);
int gd_attr_set_number(struct gd_image *im, const char *name, double value, struct gd_err *err);
int gd_attr_set_int(struct gd_image *im, const char *name, int value, struct gd_err *err);
const struct gd_attr *gd_attr_find(const struct gd_image *im, const char *name);
bool gd_attr_number(const struct gd_image *im, const char *name, double *value);
/* Copies at most size - 1 bytes of a string attribute into text. */
bool gd_attr_string(const struct gd_image *im, const char *name, char *text, size_t size);
/* Copies all attributes of from that to does not have. */
int gd_attr_copy(struct gd_image *to, const struct gd_image *from, struct gd_err *err);

#endif
