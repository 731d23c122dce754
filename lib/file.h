/* SPDX-License-Identifier: BSD-3-Clause */
/* Small files that are made in memory: pictures and tables. */
#ifndef GD_FILE_H
#define GD_FILE_H

#include "gd.h"

/* Writes size bytes to path, whole or not at all, as gd_output_open() and its kin do. */
int gd_file_write(const char *path, const void *data, size_t size, struct gd_err *err);

#endif
