/* SPDX-License-Identifier: BSD-3-Clause */
#include "json.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "file.h"

void gd_json_number(char text[32], double v)
{
	snprintf(text, 32, "null");
	for (int digits = 6; isfinite(v) && digits <= 17; digits++) {
		snprintf(text, 32, "%.*g", digits, v);
		if (strtod(text, NULL) == v)
			break;
	}
}

char *gd_json_string(const char *s)
{
	char *text = malloc(6 * strlen(s) + 3), *p = text;

	if (!text)
		return NULL;
	*p++ = '"';
	for (; *s; s++) {
		if (*s == '"' || *s == '\\')
			p += sprintf(p, "\\%c", *s);
		else if ((unsigned char)*s < 0x20)
			p += sprintf(p, "\\u%04x", *s);
		else
			*p++ = *s;
	}
	strcpy(p, "\"");
	return text;
}

/* Takes value over. */
static int add(struct gd_json *o, const char *name, char *value)
{
	size_t size = (size_t)(o->n + 1) * sizeof *o->name;
	char *key = gd_json_string(name);
	char **names = realloc(o->name, size), **values = realloc(o->value, size);

	if (names)
		o->name = names;
	if (values)
		o->value = values;
	if (!key || !value || !names || !values) {
		free(key);
		free(value);
		return GD_ENOMEM;
	}
	o->name[o->n] = key;
	o->value[o->n++] = value;
	return GD_OK;
}

int gd_json_add_number(struct gd_json *o, const char *name, double value)
{
	char text[32];

	gd_json_number(text, value);
	return add(o, name, strdup(text));
}

int gd_json_add_text(struct gd_json *o, const char *name, const char *value)
{
	return add(o, name, gd_json_string(value));
}

void gd_json_free(struct gd_json *o)
{
	for (int i = 0; i < o->n; i++) {
		free(o->name[i]);
		free(o->value[i]);
	}
	free(o->name);
	free(o->value);
	*o = (struct gd_json){ 0 };
}

static void print(const struct gd_json *o, FILE *f)
{
	fputc('{', f);
	for (int i = 0; i < o->n; i++)
		fprintf(f, "%s%s: %s", i ? ", " : "", o->name[i], o->value[i]);
	fputs("}\n", f);
}

/* /dev/stderr may be a link to a log: it must not be replaced by this file. */
static int append(const char *path, const char *text, size_t size, struct gd_err *err)
{
	int fd = open(path, O_WRONLY | O_APPEND);
	ssize_t n = fd < 0 ? -1 : write(fd, text, size);
	int bad = n < 0 ? errno : (size_t)n < size ? EIO : 0;

	if (fd >= 0 && close(fd) && !bad)
		bad = errno;
	return bad ? gd_fail(err, GD_EIO, "%s: %s", path, strerror(bad)) : GD_OK;
}

int gd_json_save(const struct gd_json *o, const char *path, struct gd_err *err)
{
	char *text = NULL;
	size_t size = 0;
	FILE *f = open_memstream(&text, &size);
	int rc;

	if (f)
		print(o, f);
	if (!f || fclose(f))
		rc = gd_fail(err, GD_ENOMEM, "%s: out of memory", path);
	else if (!strncmp(path, "/dev/", 5))
		rc = append(path, text, size, err);
	else
		rc = gd_file_write(path, text, size, err);
	free(text);
	return rc;
}
