/* SPDX-License-Identifier: BSD-3-Clause */
#include "render/gltf.h"

#include <assimp/cfileio.h>
#include <assimp/cimport.h>
#include <assimp/scene.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* --- the file that assimp is given --- */

struct out {
	struct gd_gltf *g;
	struct gd_gltf_import *im;
	cJSON *root, *accessors, *views, *buffers, *meshes, *nodes;
	float **made;			/* buffers of converted attributes, after the file's own */
	size_t *made_size;
	size_t nmade;
	size_t naccessor, nview, nmesh;
	size_t *mesh;			/* new number of each mesh, SIZE_MAX: nothing is left */
	char *text;			/* all of it as JSON */
	struct gd_err *err;
};

static int no_memory(const struct out *o)
{
	return gd_fail(o->err, GD_ENOMEM, "%s: out of memory", o->g->path);
}

static void put(cJSON *o, const char *name, size_t v)
{
	cJSON_AddNumberToObject(o, name, (double)v);
}

/* Number of a new view. */
static size_t add_view(struct out *o, size_t buffer, size_t offset, size_t length, size_t stride)
{
	cJSON *v = cJSON_CreateObject();

	put(v, "buffer", buffer);
	put(v, "byteOffset", offset);
	put(v, "byteLength", length);
	if (stride)
		put(v, "byteStride", stride);
	cJSON_AddItemToArray(o->views, v);
	return o->nview++;
}

static size_t add_accessor(struct out *o, size_t view, int type, size_t count, int n)
{
	static const char *const name[] = { "", "SCALAR", "VEC2", "VEC3", "VEC4" };
	cJSON *v = cJSON_CreateObject();

	if (view != SIZE_MAX)
		put(v, "bufferView", view);
	put(v, "componentType", (size_t)type);
	put(v, "count", count);
	cJSON_AddStringToObject(v, "type", name[n]);
	cJSON_AddItemToArray(o->accessors, v);
	return o->naccessor++;
}

/* Keeps a float array as a buffer of its own. */
static int add_made(struct out *o, float *v, size_t size, size_t *buffer)
{
	float **made = realloc(o->made, (o->nmade + 1) * sizeof(*made));
	size_t *sizes;

	if (made)
		o->made = made;
	sizes = made ? realloc(o->made_size, (o->nmade + 1) * sizeof(*sizes)) : NULL;
	if (!sizes) {
		free(v);
		return no_memory(o);
	}
	o->made_size = sizes;
	made[o->nmade] = v;
	sizes[o->nmade] = size;
	*buffer = o->g->nbuffer + o->nmade++;
	return GD_OK;
}

/* An attribute; what is not plain floats is converted. */
static int add_attribute(struct out *o, cJSON *to, const char *name,
			 const struct gd_gltf_accessor *a, bool bare)
{
	const size_t size = a->count * (size_t)a->n * sizeof(float);
	size_t buffer = 0, view = SIZE_MAX;
	float *v;
	int rc;

	if (!bare && (a->type != GD_GLTF_FLOAT || a->sparse)) {
		rc = gd_gltf_floats(o->g, a, &v, o->err);
		if (rc == GD_OK)
			rc = add_made(o, v, size, &buffer);
		if (rc != GD_OK)
			return rc;
		view = add_view(o, buffer, 0, size, 0);
	} else if (!bare) {
		const bool tight = a->stride == (size_t)a->n * sizeof(float);

		view = add_view(o, a->buffer, a->offset, a->length, tight ? 0 : a->stride);
	}
	put(to, name, add_accessor(o, view, GD_GLTF_FLOAT, a->count, a->n));
	return GD_OK;
}

static size_t triangles_of(size_t mode, size_t count)
{
	return mode == 4 ? count / 3 : count < 2 ? 0 : count - 2;
}

/* Is there any triangle whose corners all exist? (assimp fails on a mesh without.) */
static bool any_whole(const struct gd_gltf_accessor *a, size_t mode, size_t vertices)
{
	const size_t n = triangles_of(mode, a->count);

	for (size_t i = 0; i < n; i++) {
		const size_t k = mode == 4 ? 3 * i : i, first = mode == 6 ? 0 : k;

		if (gd_gltf_whole(a, first) < vertices && gd_gltf_whole(a, k + 1) < vertices &&
		    gd_gltf_whole(a, k + 2) < vertices)
			return true;
	}
	return false;
}

/* The extension of a compressed primitive, with its view renumbered. */
static int add_draco(struct out *o, cJSON *primitive, const cJSON *draco)
{
	const cJSON *ids = gd_json_get(draco, "attributes");
	cJSON *e = cJSON_AddObjectToObject(cJSON_AddObjectToObject(primitive, "extensions"),
					   "KHR_draco_mesh_compression");
	struct gd_bytes b;
	size_t view = SIZE_MAX, buffer = 0;
	int rc;

	gd_json_index(draco, "bufferView", &view);
	rc = gd_gltf_view(o->g, view, &b, o->err);
	if (rc != GD_OK)
		return rc;
	gd_json_index(o->g->views.item[view], "buffer", &buffer);
	put(e, "bufferView", add_view(o, buffer, (size_t)(b.data - o->g->buffer[buffer].data),
				      b.size, 0));
	cJSON_AddItemToObject(e, "attributes", cJSON_Duplicate(ids, 1));
	return GD_OK;
}

/* One of the optional attributes: left out if it does not fit. */
static int add_optional(struct out *o, cJSON *to, const cJSON *from, const char *name,
			const char *as, int n, size_t count, bool bare)
{
	struct gd_gltf_accessor a;
	size_t i;
	int rc;

	if (!gd_json_index(from, name, &i))
		return GD_OK;
	rc = gd_gltf_accessor(o->g, i, bare, &a, o->err);
	if (rc != GD_OK)
		return rc;
	if (a.count != count || a.n != n) {
		gd_warn(o->g->report, "%s: %s of %zu elements for %zu vertices: left out",
			o->g->path, name, a.count, count);
		return GD_OK;
	}
	return add_attribute(o, to, as, &a, bare);
}

static int add_indices(struct out *o, cJSON *to, const cJSON *primitive, size_t mode, bool bare,
		       size_t vertices, size_t *triangles, bool *any)
{
	struct gd_gltf_accessor a;
	size_t i, view = SIZE_MAX;
	int rc;

	if (!gd_json_index(primitive, "indices", &i)) {
		*triangles = triangles_of(mode, vertices);
		*any = *triangles > 0;
		return GD_OK;
	}
	rc = gd_gltf_accessor(o->g, i, bare, &a, o->err);
	if (rc != GD_OK)
		return rc;
	if (a.n != 1 || a.sparse || (a.type != GD_GLTF_UBYTE && a.type != GD_GLTF_USHORT &&
				     a.type != GD_GLTF_UINT))
		return gd_fail(o->err, GD_EFORMAT, "%s: accessor %zu cannot be indices",
			       o->g->path, i);
	*triangles = triangles_of(mode, a.count);
	*any = bare ? *triangles > 0 : any_whole(&a, mode, vertices);
	if (!*any)
		return GD_OK;
	if (a.data)
		view = add_view(o, a.buffer, a.offset, a.length, 0);
	put(to, "indices", add_accessor(o, view, a.type, a.count, 1));
	return GD_OK;
}

/* A primitive of triangles to the list, if it has any that is whole. */
static int add_primitive(struct out *o, cJSON *list, size_t mesh, const cJSON *from, size_t mode)
{
	struct gd_gltf *g = o->g;
	const cJSON *attributes = gd_json_get(from, "attributes"),
		    *draco = gd_json_extension(from, "KHR_draco_mesh_compression");
	cJSON *p = cJSON_CreateObject(), *to = cJSON_AddObjectToObject(p, "attributes");
	struct gd_gltf_part part = { mesh, g->materials.n, 0 };
	struct gd_gltf_accessor a = { 0 };
	size_t position = SIZE_MAX;
	char set[32];
	bool any = false;
	int rc;

	if (gd_json_index(from, "material", &part.material) && part.material >= g->materials.n)
		part.material = g->materials.n;
	gd_json_index(attributes, "POSITION", &position);
	rc = gd_gltf_accessor(g, position, draco != NULL, &a, o->err);
	if (rc == GD_OK && a.n != 3)
		rc = gd_fail(o->err, GD_EFORMAT, "%s: the positions of mesh %zu are not VEC3",
			     g->path, mesh);
	if (rc == GD_OK)
		rc = add_indices(o, p, from, mode, draco != NULL, a.count, &part.triangles, &any);
	if (rc == GD_OK && any)
		rc = add_attribute(o, to, "POSITION", &a, draco != NULL);
	if (rc == GD_OK && any)
		rc = add_optional(o, to, attributes, "NORMAL", "NORMAL", 3, a.count, draco != NULL);
	if (rc == GD_OK && any && g->uv[part.material].set >= 0) {
		snprintf(set, sizeof(set), "TEXCOORD_%d", g->uv[part.material].set);
		rc = add_optional(o, to, attributes, set, draco ? set : "TEXCOORD_0", 2, a.count,
				  draco != NULL);
	}
	if (rc == GD_OK && any && draco)
		rc = add_draco(o, p, draco);
	if (rc != GD_OK || !any) {
		o->im->lost += part.triangles;
		cJSON_Delete(p);
		return rc;
	}
	put(p, "mode", mode);
	cJSON_AddItemToArray(list, p);
	o->im->part[o->im->npart++] = part;
	return GD_OK;
}

static int add_mesh(struct out *o, size_t mesh)
{
	cJSON *m = cJSON_CreateObject(), *list = cJSON_AddArrayToObject(m, "primitives");
	const cJSON *p;
	char name[32];
	int rc = GD_OK;

	cJSON_ArrayForEach(p, gd_json_get(o->g->meshes.item[mesh], "primitives")) {
		size_t mode = 4;

		gd_json_index(p, "mode", &mode);
		if (mode < 4 || mode > 6)
			o->im->points++;
		else if (rc == GD_OK)
			rc = add_primitive(o, list, mesh, p, mode);
	}
	snprintf(name, sizeof(name), "m%zu", o->im->first[mesh]);
	cJSON_AddStringToObject(m, "name", name);
	if (rc != GD_OK || !cJSON_GetArraySize(list)) {
		cJSON_Delete(m);
		return rc;
	}
	cJSON_AddItemToArray(o->meshes, m);
	o->mesh[mesh] = o->nmesh++;
	return GD_OK;
}

/* The nodes, all of them, so that their numbers stay; those outside the scene are empty. */
static void add_nodes(struct out *o)
{
	static const char *const kept[] = { "matrix", "translation", "rotation", "scale",
					    "children" };
	struct gd_gltf *g = o->g;

	for (size_t i = 0; i < g->nnode; i++) {
		const struct gd_gltf_node *from = &g->node[i];
		cJSON *n = cJSON_CreateObject();
		char name[32];

		snprintf(name, sizeof(name), "n%zu", i);
		cJSON_AddStringToObject(n, "name", name);
		for (size_t k = 0; from->used && k < sizeof(kept) / sizeof(*kept); k++) {
			const cJSON *v = gd_json_get(from->json, kept[k]);

			if (v && !(cJSON_IsArray(v) && cJSON_GetArraySize(v) == 0))
				cJSON_AddItemToObject(n, kept[k], cJSON_Duplicate(v, 1));
		}
		if (from->used && from->mesh != SIZE_MAX && o->mesh[from->mesh] != SIZE_MAX)
			put(n, "mesh", o->mesh[from->mesh]);
		cJSON_AddItemToArray(o->nodes, n);
	}
}

/* All roots: the nodes of the scene that are not below another. */
static void add_scene(struct out *o)
{
	struct gd_gltf *g = o->g;
	cJSON *scene = cJSON_CreateObject(), *roots = cJSON_AddArrayToObject(scene, "nodes");
	cJSON *list = cJSON_AddArrayToObject(o->root, "scenes");

	for (size_t i = 0; i < g->norder; i++)
		if (g->node[g->order[i]].root)
			cJSON_AddItemToArray(roots, cJSON_CreateNumber((double)g->order[i]));
	cJSON_AddItemToArray(list, scene);
	put(o->root, "scene", 0);
}

static void add_buffers(struct out *o)
{
	for (size_t i = 0; i < o->g->nbuffer + o->nmade; i++) {
		cJSON *b = cJSON_CreateObject();
		char name[32];

		snprintf(name, sizeof(name), "b%zu.bin", i);
		cJSON_AddStringToObject(b, "uri", name);
		put(b, "byteLength", i < o->g->nbuffer ? o->g->buffer[i].size :
							 o->made_size[i - o->g->nbuffer]);
		cJSON_AddItemToArray(o->buffers, b);
	}
}

static int make_text(struct out *o)
{
	struct gd_gltf *g = o->g;
	cJSON *extensions;
	int rc = GD_OK;

	o->root = cJSON_CreateObject();
	cJSON_AddStringToObject(cJSON_AddObjectToObject(o->root, "asset"), "version", "2.0");
	extensions = cJSON_AddArrayToObject(o->root, "extensionsUsed");
	cJSON_AddItemToArray(extensions, cJSON_CreateString("KHR_draco_mesh_compression"));
	o->accessors = cJSON_AddArrayToObject(o->root, "accessors");
	o->views = cJSON_AddArrayToObject(o->root, "bufferViews");
	o->buffers = cJSON_AddArrayToObject(o->root, "buffers");
	o->meshes = cJSON_AddArrayToObject(o->root, "meshes");
	o->nodes = cJSON_AddArrayToObject(o->root, "nodes");
	for (size_t k = 0; k < g->norder; k++)
		if (g->node[g->order[k]].mesh != SIZE_MAX)
			o->mesh[g->node[g->order[k]].mesh] = 1;		/* is used */
	for (size_t i = 0; i < g->meshes.n; i++) {
		const bool used = o->mesh[i];

		o->mesh[i] = SIZE_MAX;
		o->im->first[i] = o->im->npart;
		if (used)
			rc = add_mesh(o, i);
		if (rc != GD_OK)
			return rc;
	}
	o->im->first[g->meshes.n] = o->im->npart;
	add_nodes(o);
	add_scene(o);
	add_buffers(o);
	o->text = cJSON_PrintUnformatted(o->root);
	return o->text ? GD_OK : no_memory(o);
}

/* --- what assimp reads with --- */

struct cursor {
	struct aiFile file;
	const unsigned char *data;
	size_t size, at;
};

static size_t cursor_read(struct aiFile *f, char *to, size_t size, size_t n)
{
	struct cursor *c = (struct cursor *)f->UserData;
	const size_t left = size ? (c->size - c->at) / size : 0;

	n = n < left ? n : left;
	memcpy(to, c->data + c->at, n * size);
	c->at += n * size;
	return n;
}

static size_t cursor_write(struct aiFile *f, const char *from, size_t size, size_t n)
{
	(void)f;
	(void)from;
	(void)size;
	(void)n;
	return 0;
}

static size_t cursor_tell(struct aiFile *f)
{
	return ((struct cursor *)f->UserData)->at;
}

static size_t cursor_size(struct aiFile *f)
{
	return ((struct cursor *)f->UserData)->size;
}

static enum aiReturn cursor_seek(struct aiFile *f, size_t offset, enum aiOrigin from)
{
	struct cursor *c = (struct cursor *)f->UserData;
	const size_t base = from == aiOrigin_SET ? 0 : from == aiOrigin_CUR ? c->at : c->size;

	if (base + offset > c->size)
		return aiReturn_FAILURE;
	c->at = base + offset;
	return aiReturn_SUCCESS;
}

static void cursor_flush(struct aiFile *f)
{
	(void)f;
}

/* "scene.gltf" and "b<number>.bin", in whatever folder. */
static struct aiFile *open_cursor(struct aiFileIO *io, const char *name, const char *mode)
{
	const struct out *o = (const struct out *)io->UserData;
	const char *slash = strrchr(name, '/');
	struct cursor *c;
	size_t i;

	(void)mode;
	name = slash ? slash + 1 : name;
	c = calloc(1, sizeof(*c));
	if (!c)
		return NULL;
	if (!strcmp(name, "scene.gltf")) {
		c->data = (const unsigned char *)o->text;
		c->size = strlen(o->text);
	} else if (sscanf(name, "b%zu.bin", &i) == 1 && i < o->g->nbuffer) {
		c->data = o->g->buffer[i].data;
		c->size = o->g->buffer[i].size;
	} else if (sscanf(name, "b%zu.bin", &i) == 1 && i - o->g->nbuffer < o->nmade) {
		c->data = (const unsigned char *)o->made[i - o->g->nbuffer];
		c->size = o->made_size[i - o->g->nbuffer];
	} else {
		free(c);
		return NULL;
	}
	c->file = (struct aiFile){ cursor_read, cursor_write, cursor_tell, cursor_size,
				   cursor_seek, cursor_flush, (char *)c };
	return &c->file;
}

static void close_cursor(struct aiFileIO *io, struct aiFile *f)
{
	(void)io;
	if (f)
		free((struct cursor *)f->UserData);
}

static int decode(struct out *o)
{
	struct aiFileIO io = { open_cursor, close_cursor, (char *)o };

	o->im->ai = aiImportFileEx("scene.gltf", 0, &io);
	if (o->im->ai)
		return GD_OK;
	return gd_fail(o->err, GD_EFORMAT, "%s: %s", o->g->path, aiGetErrorString());
}

int gd_gltf_import(struct gd_gltf *g, struct gd_gltf_import *im, struct gd_err *err)
{
	struct out o = { .g = g, .im = im, .err = err };
	size_t n = 0;
	int rc;

	*im = (struct gd_gltf_import){ 0 };
	for (size_t i = 0; i < g->meshes.n; i++)
		n += (size_t)cJSON_GetArraySize(gd_json_get(g->meshes.item[i], "primitives"));
	im->part = calloc(n + 1, sizeof(*im->part));
	im->first = calloc(g->meshes.n + 1, sizeof(*im->first));
	o.mesh = calloc(g->meshes.n + 1, sizeof(*o.mesh));
	rc = im->part && im->first && o.mesh ? make_text(&o) : no_memory(&o);
	if (rc == GD_OK && im->npart)
		rc = decode(&o);
	cJSON_Delete(o.root);
	cJSON_free(o.text);
	for (size_t i = 0; i < o.nmade; i++)
		free(o.made[i]);
	free(o.made);
	free(o.made_size);
	free(o.mesh);
	if (rc != GD_OK)
		gd_gltf_import_free(im);
	return rc;
}

void gd_gltf_import_free(struct gd_gltf_import *im)
{
	if (im->ai)
		aiReleaseImport(im->ai);
	free(im->part);
	free(im->first);
	*im = (struct gd_gltf_import){ 0 };
}
