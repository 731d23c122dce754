/* SPDX-License-Identifier: BSD-3-Clause */
#include "render/gltf.h"

#include <stdlib.h>
#include <string.h>

static size_t bytes_of(int type)
{
	switch (type) {
	case GD_GLTF_BYTE:
	case GD_GLTF_UBYTE:
		return 1;
	case GD_GLTF_SHORT:
	case GD_GLTF_USHORT:
		return 2;
	case GD_GLTF_UINT:
	case GD_GLTF_FLOAT:
		return 4;
	default:
		return 0;
	}
}

static int components_of(const char *type)
{
	static const char *const name[] = { "SCALAR", "VEC2", "VEC3", "VEC4" };

	for (int i = 0; type && i < 4; i++)
		if (!strcmp(type, name[i]))
			return i + 1;
	return 0;
}

/* The elements of a within view; stride 0: one after the other. */
static int place(const struct gd_gltf *g, const cJSON *json, size_t i, struct gd_gltf_accessor *a,
		 struct gd_err *err)
{
	const size_t size = bytes_of(a->type) * (size_t)a->n;
	struct gd_bytes b;
	size_t view, offset = 0, stride = 0, length;
	int rc;

	gd_json_index(json, "bufferView", &view);
	gd_json_index(json, "byteOffset", &offset);
	rc = gd_gltf_view(g, view, &b, err);
	if (rc != GD_OK)
		return rc;
	gd_json_index(g->views.item[view], "byteStride", &stride);
	a->stride = stride ? stride : size;
	if (stride > 65536 || (stride && stride < size))
		return gd_fail(err, GD_EFORMAT, "%s: accessor %zu: stride %zu for elements of %zu "
						"bytes", g->path, i, stride, size);
	if (__builtin_mul_overflow(a->stride, a->count - 1, &length) ||
	    __builtin_add_overflow(length, size, &length) || offset > b.size ||
	    length > b.size - offset)
		return gd_fail(err, GD_EFORMAT,
			       "%s: accessor %zu of %zu elements does not fit into its buffer view "
			       "of %zu bytes", g->path, i, a->count, b.size);
	gd_json_index(g->views.item[view], "buffer", &a->buffer);
	a->data = b.data + offset;
	a->offset = (size_t)(a->data - g->buffer[a->buffer].data);
	a->length = length;
	return GD_OK;
}

int gd_gltf_accessor(const struct gd_gltf *g, size_t i, bool bare, struct gd_gltf_accessor *a,
		     struct gd_err *err)
{
	const cJSON *json;
	size_t type = 0, view;

	*a = (struct gd_gltf_accessor){ 0 };
	if (i >= g->accessors.n)
		return gd_fail(err, GD_EFORMAT, "%s: there is no accessor %zu", g->path, i);
	json = g->accessors.item[i];
	gd_json_index(json, "componentType", &type);
	a->type = type < 10000 ? (int)type : 0;
	a->n = components_of(gd_json_text(json, "type"));
	a->normalized = cJSON_IsTrue(gd_json_get(json, "normalized"));
	if (!bytes_of(a->type) || !a->n || !gd_json_index(json, "count", &a->count))
		return gd_fail(err, GD_EFORMAT, "%s: accessor %zu has no usable type or count",
			       g->path, i);
	if (a->count < 1 || a->count >= GD_NO_INDEX)
		return gd_fail(err, GD_EFORMAT, "%s: accessor %zu has %.15g elements", g->path, i,
			       gd_json_double(json, "count", NAN));
	a->sparse = gd_json_get(json, "sparse");
	if (gd_json_index(json, "bufferView", &view))
		return place(g, json, i, a, err);
	if (!bare && !a->sparse)
		return gd_fail(err, GD_EFORMAT, "%s: accessor %zu has no data", g->path, i);
	return GD_OK;
}

uint32_t gd_gltf_whole(const struct gd_gltf_accessor *a, size_t k)
{
	const unsigned char *p = a->data + k * a->stride;

	if (a->type == GD_GLTF_UBYTE)
		return p[0];
	if (a->type == GD_GLTF_USHORT)
		return p[0] | (uint32_t)p[1] << 8;
	return p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}

float gd_gltf_value(const struct gd_gltf_accessor *a, size_t k, int c)
{
	const unsigned char *p;
	float scale = 0, v = 0;

	if (!a->data)
		return 0;
	p = a->data + k * a->stride + bytes_of(a->type) * (size_t)c;
	switch (a->type) {
	case GD_GLTF_BYTE:
		v = (float)(int8_t)*p;
		scale = 127;
		break;
	case GD_GLTF_UBYTE:
		v = (float)*p;
		scale = 255;
		break;
	case GD_GLTF_SHORT:
		v = (float)(int16_t)(p[0] | p[1] << 8);
		scale = 32767;
		break;
	case GD_GLTF_USHORT:
		v = (float)(p[0] | p[1] << 8);
		scale = 65535;
		break;
	case GD_GLTF_UINT:
		return (float)gd_gltf_whole(a, k);
	default:
		memcpy(&v, p, sizeof(v));
		return v;
	}
	return a->normalized ? fmaxf(v / scale, -1) : v;
}

/* Overwrites the elements that a sparse accessor names. */
static int patch(const struct gd_gltf *g, const struct gd_gltf_accessor *a, float *out,
		 struct gd_err *err)
{
	const cJSON *indices = gd_json_get(a->sparse, "indices"),
		    *values = gd_json_get(a->sparse, "values");
	struct gd_gltf_accessor at = { .n = 1 }, v = { .n = a->n, .type = a->type };
	size_t type = 0, view;
	int rc;

	gd_json_index(indices, "componentType", &type);
	at.type = type < 10000 ? (int)type : 0;
	if (!gd_json_index(a->sparse, "count", &at.count) || at.count < 1 || at.count > a->count ||
	    !bytes_of(at.type) || !gd_json_index(indices, "bufferView", &view) ||
	    !gd_json_index(values, "bufferView", &view))
		return gd_fail(err, GD_EFORMAT, "%s: damaged sparse accessor", g->path);
	v.count = at.count;
	v.normalized = a->normalized;
	rc = place(g, indices, 0, &at, err);
	if (rc == GD_OK)
		rc = place(g, values, 0, &v, err);
	for (size_t k = 0; rc == GD_OK && k < at.count; k++) {
		const size_t i = gd_gltf_whole(&at, k);

		if (i >= a->count)
			rc = gd_fail(err, GD_EFORMAT, "%s: damaged sparse accessor", g->path);
		for (int c = 0; rc == GD_OK && c < a->n; c++)
			out[i * (size_t)a->n + (size_t)c] = gd_gltf_value(&v, k, c);
	}
	return rc;
}

int gd_gltf_floats(const struct gd_gltf *g, const struct gd_gltf_accessor *a, float **out,
		   struct gd_err *err)
{
	int rc = GD_OK;

	*out = gd_alloc(a->count, (size_t)a->n * sizeof(**out));
	if (!*out)
		return gd_fail(err, GD_ENOMEM, "%s: out of memory for %zu vertices", g->path,
			       a->count);
	for (size_t k = 0; k < a->count; k++)
		for (int c = 0; c < a->n; c++)
			(*out)[k * (size_t)a->n + (size_t)c] = gd_gltf_value(a, k, c);
	if (a->sparse)
		rc = patch(g, a, *out, err);
	if (rc != GD_OK) {
		free(*out);
		*out = NULL;
	}
	return rc;
}
