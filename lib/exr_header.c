/* SPDX-License-Identifier: BSD-3-Clause */
#include "exr_header.h"

#include <stdlib.h>
#include <string.h>

#define PROLOGUE	8		/* magic number and version */
#define VERSION_AT	4
#define MULTIPART	0x1000u		/* in the version: parts, ended by an empty one */
#define MAX_HEADER	((uint64_t)1 << 28)
#define FIRST_BYTES	65536		/* nearly every header is shorter */

bool gd_exr_structural(const char *name)
{
	static const char *const list[] = {"channels",
					   "compression",
					   "dataWindow",
					   "displayWindow",
					   "lineOrder",
					   "type",
					   "name",
					   "tiles",
					   "chunkCount",
					   "version",
					   "maxSamplesPerPixel"};

	for (size_t i = 0; i < sizeof list / sizeof *list; i++)
		if (strcmp(name, list[i]) == 0)
			return true;
	return false;
}

/* A place in the header's bytes; the walk stops where they end. */
struct walk {
	const unsigned char *v;
	size_t n, at;
};

static const char *walk_name(struct walk *w)
{
	const char *name = (const char *)w->v + w->at;
	const unsigned char *end = memchr(name, 0, w->n - w->at);

	if (!end)
		return NULL;
	w->at = (size_t)(end - w->v) + 1;
	return name;
}

enum step { STEP_ATTR, STEP_END, STEP_SHORT };

/* The next attribute, or the end of the part; STEP_SHORT if more bytes are needed to tell. */
static enum step walk_attr(struct walk *w, struct gd_attr *a)
{
	uint32_t size;

	a->name = (char *)walk_name(w);
	if (!a->name)
		return STEP_SHORT;
	if (!a->name[0])
		return STEP_END;
	a->type = (char *)walk_name(w);
	if (!a->type || w->n - w->at < sizeof(size))
		return STEP_SHORT;
	memcpy(&size, w->v + w->at, sizeof(size));
	w->at += sizeof(size);
	if (w->n - w->at < size)
		return STEP_SHORT;
	a->data = (unsigned char *)w->v + w->at;
	a->size = size;
	w->at += size;
	return STEP_ATTR;
}

/* STEP_END: done. Attributes already in im (from a shorter try) are left alone. */
static int walk_part(struct gd_image *im, struct walk *w, int part, enum step *step,
		     struct gd_err *err)
{
	struct gd_attr a;
	int rc = GD_OK;

	*step = STEP_SHORT;
	for (int p = 0; p <= part; p++)
		while ((*step = walk_attr(w, &a)) != STEP_END) {
			if (*step == STEP_SHORT)
				return GD_OK;
			if (p < part || gd_exr_structural(a.name) || gd_attr_find(im, a.name))
				continue;
			rc = gd_attr_set(im, a.name, a.type, a.data, a.size, err);
			if (rc != GD_OK)
				return rc;
		}
	return rc;
}

int gd_exr_header_attrs(struct gd_image *im, const struct gd_input *in, int part,
			struct gd_err *err)
{
	uint64_t n = in->size < FIRST_BYTES ? in->size : FIRST_BYTES;
	unsigned char *buf = NULL;
	enum step step = STEP_SHORT;
	int rc = GD_OK;

	while (rc == GD_OK && step != STEP_END) {
		unsigned char *more = realloc(buf, n);
		if (!more) {
			rc = gd_fail(err, GD_ENOMEM, "%s: out of memory", in->label);
			break;
		}
		buf = more;
		struct walk w = { buf, n, PROLOGUE };
		if (n <= PROLOGUE || gd_input_read(in, buf, n, 0) != (int64_t)n)
			rc = gd_fail(err, GD_EIO, "%s: cannot read the header", in->label);
		else
			rc = walk_part(im, &w, part, &step, err);
		if (rc == GD_OK && step != STEP_END && n == in->size)
			rc = gd_fail(err, GD_EFORMAT, "%s: the header does not end", in->label);
		n = n < in->size / 4 ? 4 * n : in->size;
	}
	free(buf);
	return rc;
}

/* STEP_END: w->at is behind the header of all parts. */
static enum step walk_header(struct walk *w)
{
	struct gd_attr a;
	uint32_t version;
	enum step step;

	if (w->n < PROLOGUE)
		return STEP_SHORT;
	memcpy(&version, w->v + VERSION_AT, sizeof(version));
	w->at = PROLOGUE;
	for (;;) {
		int attrs = 0;
		while ((step = walk_attr(w, &a)) == STEP_ATTR)
			attrs++;
		if (step == STEP_SHORT || !(version & MULTIPART) || attrs == 0)
			return step;
	}
}

int gd_exr_header_keep(struct gd_input *in, uint64_t *end, struct gd_err *err)
{
	uint64_t n = FIRST_BYTES;
	int rc = GD_OK;

	for (*end = 0; rc == GD_OK; n = 2 * in->size) {
		rc = gd_input_keep(in, n, err);
		struct walk w = { in->mem, in->size, 0 };
		if (rc != GD_OK || !in->mem)
			break;
		if (walk_header(&w) == STEP_END)
			*end = w.at;
		if (*end || !in->stream)
			break;
		if (in->size > MAX_HEADER)
			rc = gd_fail(err, GD_EFORMAT, "%s: a header of more than %d MiB", in->label,
				     (int)(MAX_HEADER >> 20));
	}
	return rc;
}

int gd_bytes_add(struct gd_bytes *b, const void *data, size_t n, struct gd_err *err)
{
	if (n > b->room - b->n) {
		size_t room = b->room + b->room / 2 + n + 4096;
		unsigned char *v = realloc(b->v, room);
		if (!v)
			return gd_fail(err, GD_ENOMEM, "out of memory for %zu bytes of output",
				       room);
		b->v = v;
		b->room = room;
	}
	if (n)
		memcpy(b->v + b->n, data, n);
	b->n += n;
	return GD_OK;
}

int gd_bytes_attr(struct gd_bytes *b, const struct gd_attr *a, struct gd_err *err)
{
	uint32_t size = (uint32_t)a->size;
	int rc;

	if (a->size > INT32_MAX || strlen(a->name) > GD_EXR_NAME || strlen(a->type) > GD_EXR_NAME)
		return gd_fail(err, GD_ESHAPE, "attribute %.64s does not fit into an EXR header",
			       a->name);
	rc = gd_bytes_add(b, a->name, strlen(a->name) + 1, err);
	if (rc == GD_OK)
		rc = gd_bytes_add(b, a->type, strlen(a->type) + 1, err);
	if (rc == GD_OK)
		rc = gd_bytes_add(b, &size, sizeof(size), err);
	if (rc == GD_OK)
		rc = gd_bytes_add(b, a->data, a->size, err);
	return rc;
}
