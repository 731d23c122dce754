/* SPDX-License-Identifier: BSD-3-Clause */
/* One flat JSON object: numbers and texts under names, in the order they are added. */
#ifndef GD_JSON_H
#define GD_JSON_H

#include "gd.h"

struct gd_json {
	int n;
	char **name, **value;	/* value: ready JSON */
};

/* The shortest decimal that reads back as v; "null" if v is not finite. */
void gd_json_number(char text[32], double v);
/*
 * A quoted string, freed by free(); NULL without memory. Bytes above 127 stay as they are (UTF-8).
 */
char *gd_json_string(const char *s);

/* GD_ENOMEM or GD_OK. */
int gd_json_add_number(struct gd_json *o, const char *name, double value);
int gd_json_add_text(struct gd_json *o, const char *name, const char *value);
void gd_json_free(struct gd_json *o);

/*
 * Writes the object and a newline with gd_file_write(): whole or not at all. What lies under /dev
 * is appended to. GD_EIO with errno's text.
 */
int gd_json_save(const struct gd_json *o, const char *path, struct gd_err *err);

#endif
