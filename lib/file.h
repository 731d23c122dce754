/* SPDX-License-Identifier: BSD-3-Clause */
/* Small files that are made in memory: pictures and tables. */
#ifndef GD_FILE_H
#define GD_FILE_H

#include "gd.h"

/*
 * Writes size bytes to path: a temporary name beside it, fsync, rename, so that it appears whole or not
 * at all. "-" is standard output; what exists and is no regular file (/dev/full, a fifo) is written as a
 * stream. GD_EIO with errno's text; a broken pipe sets err->text to "" (end quietly).
 */
int gd_file_write(const char *path, const void *data, size_t size, struct gd_err *err);

#endif
