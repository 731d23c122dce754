/* SPDX-License-Identifier: BSD-3-Clause */
#include "image.h"

#include <errno.h>
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

void gd_image_init(struct gd_image *im, int w, int h)
{
	*im = (struct gd_image){ .w = w, .h = h };
	im->data = (struct gd_box){ 0, 0, w - 1, h - 1 };
	im->display = im->data;
}

static void channel_free(struct gd_channel *c)
{
	free(c->name);
	free(c->v);
	free(c->raw);
}

static void attr_free(struct gd_attr *a)
{
	free(a->name);
	free(a->type);
	free(a->data);
}

void gd_image_free(struct gd_image *im)
{
	for (int i = 0; i < im->nchan; i++)
		channel_free(&im->chan[i]);
	for (int i = 0; i < im->nattr; i++)
		attr_free(&im->attr[i]);
	free(im->chan);
	free(im->attr);
	*im = (struct gd_image){ 0 };
}

int gd_image_find(const struct gd_image *im, const char *name)
{
	for (int i = 0; i < im->nchan; i++)
		if (strcmp(im->chan[i].name, name) == 0)
			return i;
	return -1;
}

bool gd_image_plane(const struct gd_image *im, const char *name, struct gd_plane *plane)
{
	int i = gd_image_find(im, name);

	if (i < 0 || !im->chan[i].v)
		return false;
	*plane = gd_plane_of(im->chan[i].v, im->w, im->h);
	return true;
}

int gd_image_append(struct gd_image *im, const char *name, enum gd_type type, struct gd_err *err)
{
	struct gd_channel *chan = realloc(im->chan, ((size_t)im->nchan + 1) * sizeof(*chan));
	char *copy = strdup(name);

	if (chan)
		im->chan = chan;
	if (!chan || !copy) {
		free(copy);
		return gd_fail(err, GD_ENOMEM, "out of memory for channel %s", name);
	}
	chan[im->nchan++] = (struct gd_channel){ .name = copy, .type = type };
	return GD_OK;
}

int gd_image_add(struct gd_image *im, const char *name, struct gd_plane *plane, struct gd_err *err)
{
	size_t n = (size_t)im->h * gd_stride(im->w);
	float *v = gd_calloc(n, sizeof(*v));
	int i = gd_image_find(im, name), rc = GD_OK;

	if (!v)
		return gd_fail(err, GD_ENOMEM, "out of memory for channel %s (%dx%d)", name, im->w,
			       im->h);
	if (i < 0) {
		i = im->nchan;
		rc = gd_image_append(im, name, GD_FLOAT, err);
	}
	if (rc != GD_OK) {
		free(v);
		return rc;
	}
	struct gd_channel *c = &im->chan[i];
	free(c->v);
	free(c->raw);
	c->v = v;
	c->raw = NULL;
	c->type = GD_FLOAT;
	c->want = GD_READ;
	if (plane)
		*plane = gd_plane_of(v, im->w, im->h);
	return GD_OK;
}

void gd_image_drop_if(struct gd_image *im, bool (*drop)(const char *name, void *user), void *user)
{
	int n = 0;

	for (int i = 0; i < im->nchan; i++) {
		if (drop(im->chan[i].name, user))
			channel_free(&im->chan[i]);
		else
			im->chan[n++] = im->chan[i];
	}
	im->nchan = n;
}

static bool same_name(const char *name, void *user)
{
	return strcmp(name, user) == 0;
}

void gd_image_drop(struct gd_image *im, const char *name)
{
	char *copy = strdup(name);	/* name may be the channel's own */

	if (copy)
		gd_image_drop_if(im, same_name, copy);
	free(copy);
}

const struct gd_attr *gd_attr_find(const struct gd_image *im, const char *name)
{
	for (int i = 0; i < im->nattr; i++)
		if (strcmp(im->attr[i].name, name) == 0)
			return &im->attr[i];
	return NULL;
}

int gd_attr_set(struct gd_image *im, const char *name, const char *type, const void *data,
		size_t size, struct gd_err *err)
{
	struct gd_attr a = { strdup(name), strdup(type), size, malloc(size ? size : 1) };
	struct gd_attr *old = (struct gd_attr *)gd_attr_find(im, name);

	if (!a.name || !a.type || !a.data)
		goto fail;
	if (size)
		memcpy(a.data, data, size);
	if (!old) {
		struct gd_attr *attr = realloc(im->attr, ((size_t)im->nattr + 1) * sizeof(*attr));
		if (!attr)
			goto fail;
		im->attr = attr;
		attr[im->nattr++] = a;
	} else {
		attr_free(old);
		*old = a;
	}
	return GD_OK;
fail:
	attr_free(&a);
	return gd_fail(err, GD_ENOMEM, "out of memory for attribute %s", name);
}

int gd_attr_set_string(struct gd_image *im, const char *name, const char *text, struct gd_err *err)
{
	return gd_attr_set(im, name, "string", text, strlen(text), err);
}

/* As float where that keeps the value, else as double. */
int gd_attr_set_number(struct gd_image *im, const char *name, double value, struct gd_err *err)
{
	float f = (float)value;

	if ((double)f == value)
		return gd_attr_set(im, name, "float", &f, sizeof(f), err);
	return gd_attr_set(im, name, "double", &value, sizeof(value), err);
}

int gd_attr_set_int(struct gd_image *im, const char *name, int value, struct gd_err *err)
{
	int32_t i = value;

	return gd_attr_set(im, name, "int", &i, sizeof(i), err);
}

/* The whole text must be one finite number, with white space around it allowed. */
static bool number_of_text(const char *text, double *value)
{
	char *end;

	errno = 0;
	*value = strtod(text, &end);
	if (end == text || errno == ERANGE || !isfinite(*value))
		return false;
	return end[strspn(end, " \t\r\n")] == '\0';
}

bool gd_attr_number(const struct gd_image *im, const char *name, double *value)
{
	const struct gd_attr *a = gd_attr_find(im, name);
	char text[64];
	int32_t i;
	float f;

	if (!a)
		return false;
	if (strcmp(a->type, "int") == 0 && a->size == sizeof(i)) {
		memcpy(&i, a->data, sizeof(i));
		*value = i;
	} else if (strcmp(a->type, "float") == 0 && a->size == sizeof(f)) {
		memcpy(&f, a->data, sizeof(f));
		*value = (double)f;
	} else if (strcmp(a->type, "double") == 0 && a->size == sizeof(*value)) {
		memcpy(value, a->data, sizeof(*value));
	} else if (a->size < sizeof(text) && gd_attr_string(im, name, text, sizeof(text))) {
		return number_of_text(text, value);
	} else {
		return false;
	}
	return true;
}

bool gd_attr_string(const struct gd_image *im, const char *name, char *text, size_t size)
{
	const struct gd_attr *a = gd_attr_find(im, name);

	if (!a || strcmp(a->type, "string") != 0 || size == 0)
		return false;
	size_t n = a->size < size - 1 ? a->size : size - 1;
	memcpy(text, a->data, n);
	text[n] = '\0';
	return true;
}

int gd_attr_copy(struct gd_image *to, const struct gd_image *from, struct gd_err *err)
{
	int rc = GD_OK;

	for (int i = 0; i < from->nattr && rc == GD_OK; i++) {
		const struct gd_attr *a = &from->attr[i];
		if (!gd_attr_find(to, a->name))
			rc = gd_attr_set(to, a->name, a->type, a->data, a->size, err);
	}
	return rc;
}
