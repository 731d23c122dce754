/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * The border between lib/plugin.c and gd-plugin.so, in C: plain types and function pointers only,
 * so that the plug-in needs nothing of libgd.a. No entry throws; those with an err return a
 * gd_status.
 */
#ifndef GD_SHIM_H
#define GD_SHIM_H

#include "gd.h"

#ifdef __cplusplus
extern "C" {
#endif

#define GD_SHIM_ABI 1
#define GD_SHIM_SYMBOL "gd_shim_table"

/* Windows as in EXR (inclusive), parts from 0. */
struct gd_shim_info {
	int x0, y0, x1, y1;
	int display_x0, display_y0, display_x1, display_y1;
	int nchan, nattr;
};

struct gd_shim_attr {
	const char *name;
	char type;		/* 'i' int, 'f' float, 's' string */
	int i;
	float f;
	const char *s;
};

struct gd_shim {
	int abi;
	/* path, or size bytes of data (NULL: none) that stay until close(). */
	int (*open)(void **file, struct gd_shim_info *info, const char *path, const void *data,
		    size_t size, int part, struct gd_err *err);
	/* Name and type (0 uint, 1 half, 2 float, as enum gd_type) of a channel. */
	const char *(*channel)(void *file, int i, int *type);
	/* False for an attribute that is neither a number nor a text. */
	int (*attr)(void *file, int i, struct gd_shim_attr *attr);
	/* Decodes all pixels; then copy() hands out channels, as float or in their own type. */
	int (*load)(void *file, struct gd_err *err);
	int (*copy)(void *file, int channel, int as_float, void *to, size_t row_bytes,
		    struct gd_err *err);
	void (*close)(void *file);
	/* See lib/plugin.h. */
	int (*png)(unsigned char **png, size_t *size, const void *pixel, int w, int h, int n,
		   int bits, struct gd_err *err);
	int (*display)(float *rgb, size_t n, const char *display, const char *view,
		       struct gd_err *err);
};

#ifdef __cplusplus
}
#endif
#endif
