/* SPDX-License-Identifier: BSD-3-Clause */
#include "json.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

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

/* Writes to fd and closes it; 0 or an errno. */
static int print(const struct gd_json *o, int fd)
{
	FILE *f = fdopen(fd, "w");
	int bad = 0;

	if (!f) {
		bad = errno;
		close(fd);
		return bad;
	}
	fputc('{', f);
	for (int i = 0; i < o->n; i++)
		fprintf(f, "%s%s: %s", i ? ", " : "", o->name[i], o->value[i]);
	fputs("}\n", f);
	if (fflush(f))
		bad = errno;
	if (fclose(f) && !bad)
		bad = errno;
	return bad;
}

static int save_whole(const struct gd_json *o, const char *path)
{
	char *real = realpath(path, NULL), *temp = NULL;
	const char *target = real ? real : path;
	int fd = -1, bad = 0;

	if (asprintf(&temp, "%s.XXXXXX", target) < 0)
		temp = NULL;
	if (temp)
		fd = mkstemp(temp);
	if (fd < 0) {
		bad = errno;
	} else {
		mode_t mask = umask(0);

		umask(mask);
		(void)!fchmod(fd, 0666 & ~mask);
		bad = print(o, fd);
		if (!bad && rename(temp, target))
			bad = errno;
		if (bad)
			unlink(temp);
	}
	free(temp);
	free(real);
	return bad;
}

int gd_json_save(const struct gd_json *o, const char *path, struct gd_err *err)
{
	struct stat st;
	/* a rename would put a file in the place of /dev/stderr */
	bool direct = !strncmp(path, "/dev/", 5) || (!stat(path, &st) && !S_ISREG(st.st_mode));
	int fd, bad;

	if (direct) {
		fd = open(path, O_WRONLY | O_APPEND);
		bad = fd < 0 ? errno : print(o, fd);
	} else {
		bad = save_whole(o, path);
	}
	return bad ? gd_fail(err, GD_EIO, "%s: %s", path, strerror(bad)) : GD_OK;
}
