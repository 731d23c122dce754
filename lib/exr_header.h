/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * The attributes of an EXR header as bytes. OpenEXR's C library unpacks those whose type it knows
 * and would have to pack them again; taken from the file and put into the file as they are, they
 * stay bit-exact whatever their type.
 */
#ifndef GD_EXR_HEADER_H
#define GD_EXR_HEADER_H

#include "image.h"
#include "input.h"

#define GD_EXR_NAME	255	/* longest name in bytes; over 31 needs a flag in the header */
#define GD_EXR_SHORT	31

/*
 * True for attributes that say how a file is laid out rather than what the picture is: they belong
 * to the file they were read from and are never copied to another one.
 */
bool gd_exr_structural(const char *name);

/*
 * Copies the other attributes of a part (from 0) into im. The header must have passed the library.
 */
int gd_exr_header_attrs(struct gd_image *im, const struct gd_input *in, int part,
			struct gd_err *err);

/*
 * Keeps a stream up to the end of its header and returns that offset in *end; a stream that ends
 * before is no failure here: the library will name what is missing.
 */
int gd_exr_header_keep(struct gd_input *in, uint64_t *end, struct gd_err *err);

/* Bytes that grow. */
struct gd_bytes {
	unsigned char *v;
	size_t n, room;
};

int gd_bytes_add(struct gd_bytes *b, const void *data, size_t n, struct gd_err *err);

/* Serialises an attribute. */
int gd_bytes_attr(struct gd_bytes *b, const struct gd_attr *a, struct gd_err *err);

#endif
