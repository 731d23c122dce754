/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Where a result goes. A file appears whole or not at all: it is written without a name (or, where
 * the file system cannot do that, under a temporary one in the same directory), synchronised, and
 * renamed into place by gd_output_commit(). A pipe, a device or standard output takes the bytes as
 * they come, or at the end if something before them is still to be changed.
 */
#ifndef GD_OUTPUT_H
#define GD_OUTPUT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "gd.h"

struct gd_output;

/*
 * "-" is standard output. stream: gd_output_patch() will not be called. A file that exists keeps
 * its permissions, and a symbolic link to it stays one. On failure *out is NULL.
 */
int gd_output_open(struct gd_output **out, const char *path, bool stream, struct gd_err *err);
int gd_output_add(struct gd_output *out, const void *data, size_t n, struct gd_err *err);
uint64_t gd_output_size(const struct gd_output *out);	/* bytes added so far */
/* Overwrites n bytes at offset, which have been added. */
int gd_output_patch(struct gd_output *out, const void *data, size_t n, uint64_t offset,
		    struct gd_err *err);
/* All errors are GD_EIO with errno's text, and with an empty text for a broken pipe. */
int gd_output_commit(struct gd_output *out, struct gd_err *err);
/* Takes NULL; leaves nothing behind if the output was not committed. */
void gd_output_close(struct gd_output *out);

#endif
