/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * A glTF 2.0 file that is being loaded: what the files gltf*.c share, and nobody else.
 *
 * The JSON is read here and says what there is: nodes, cameras, lights, materials, textures. assimp
 * decodes the geometry and places the nodes. What it gets to see is a file made for it, of meshes
 * and nodes alone, checked, with names that are unique ("n<node>", "m<mesh>"): it matches cameras
 * and lights by names that need not be unique, orders materials by their first use, and trusts
 * counts and offsets.
 */
#ifndef GD_RENDER_GLTF_H
#define GD_RENDER_GLTF_H

#include <cjson/cJSON.h>

#include "render/scene.h"

struct gd_bytes {
	unsigned char *data;
	size_t size;
	enum { GD_BYTES_BORROWED, GD_BYTES_OWNED, GD_BYTES_MAPPED } kind;
};

/* The items of a JSON array, for access by number. */
struct gd_gltf_list {
	const cJSON **item;
	size_t n;
};

/* A node that is in the scene, with its place in it. */
struct gd_gltf_node {
	const cJSON *json;
	size_t mesh;			/* SIZE_MAX: none */
	bool used, root;		/* is in the scene; is below no other */
	double m[3][4];			/* to world space; filled by gd_gltf_geometry() */
};

/* How the texture coordinates of a material come from the file's. */
struct gd_gltf_uv {
	int set;			/* TEXCOORD_<set>, or -1: it has no textures */
	float m[2][3];			/* KHR_texture_transform: u' = m (u, v, 1) */
};

struct gd_gltf {
	const char *path;		/* for messages */
	char *folder;			/* with the slash at its end; "" if there is none */
	struct gd_bytes file;
	cJSON *json;
	const unsigned char *bin;	/* of a .glb */
	size_t bin_size;
	struct gd_gltf_list accessors, views, meshes, materials, textures, images, samplers;
	struct gd_bytes *buffer;
	size_t nbuffer;
	struct gd_gltf_node *node;
	size_t nnode;
	size_t *order;			/* nodes of the scene as the file has them, parents first */
	size_t norder;
	struct gd_gltf_uv *uv;		/* of each material, and of the default one */
	const struct gd_report *report;
};

/* --- gltf_json.c --- */

static inline const cJSON *gd_json_get(const cJSON *o, const char *name)
{
	return cJSON_GetObjectItemCaseSensitive(o, name);
}
/* A member of o.extensions.name, or NULL. */
const cJSON *gd_json_extension(const cJSON *o, const char *name);
double gd_json_double(const cJSON *o, const char *name, double otherwise);
/* n numbers of an array; false, and out alone, if it is anything else. */
bool gd_json_numbers(const cJSON *array, double *out, int n);
/* An index or count; false if there is none. SIZE_MAX, and true, if it is no whole number >= 0. */
bool gd_json_index(const cJSON *o, const char *name, size_t *i);
const char *gd_json_text(const cJSON *o, const char *name);	/* NULL if absent */
/* GD_OK or GD_ENOMEM; an empty list if absent. */
int gd_json_list(struct gd_gltf_list *list, const cJSON *o, const char *name);

/* --- gltf_file.c --- */

/* Opens, parses, loads buffers. { 0 } is closed. */
int gd_gltf_open(struct gd_gltf *g, const char *path, const struct gd_report *report,
		 struct gd_err *err);
void gd_gltf_close(struct gd_gltf *g);
/* The bytes of a uri (file or data:) of the glTF file. */
int gd_gltf_uri(const struct gd_gltf *g, const char *uri, struct gd_bytes *bytes,
		struct gd_err *err);
/* The path of a uri that names a file, freed by free(); NULL without memory. */
char *gd_gltf_path(const struct gd_gltf *g, const char *uri);
void gd_bytes_free(struct gd_bytes *b);
/* A piece of a buffer; checks the numbers. */
int gd_gltf_view(const struct gd_gltf *g, size_t view, struct gd_bytes *bytes, struct gd_err *err);

/* --- gltf_nodes.c --- */

/* Fills node and order; no node may be reached twice. */
int gd_gltf_nodes(struct gd_gltf *g, struct gd_err *err);

/* --- gltf_accessor.c --- */

enum { GD_GLTF_BYTE = 5120, GD_GLTF_UBYTE, GD_GLTF_SHORT, GD_GLTF_USHORT, GD_GLTF_UINT = 5125,
       GD_GLTF_FLOAT };

/* An array of vectors in a buffer; everything it refers to is there. */
struct gd_gltf_accessor {
	const unsigned char *data;	/* NULL: all 0 but for sparse values */
	size_t stride, count;
	int type, n;			/* of a component, components */
	bool normalized;
	const cJSON *sparse;		/* NULL: none */
	size_t buffer, offset, length;	/* where data is */
};

/* bare: data may be missing, it is compressed elsewhere. */
int gd_gltf_accessor(const struct gd_gltf *g, size_t i, bool bare, struct gd_gltf_accessor *a,
		     struct gd_err *err);
/* Element k of an accessor of unsigned whole numbers, such as indices. */
uint32_t gd_gltf_whole(const struct gd_gltf_accessor *a, size_t k);
/* Component c of element k, without sparse values; whole numbers to 0 .. 1 where normalized. */
float gd_gltf_value(const struct gd_gltf_accessor *a, size_t k, int c);
/* All of it as count x n floats, malloc'ed; sparse values included. */
int gd_gltf_floats(const struct gd_gltf *g, const struct gd_gltf_accessor *a, float **out,
		   struct gd_err *err);

/* --- gltf_import.c --- */

/* A primitive that assimp is given. */
struct gd_gltf_part {
	size_t mesh, material;		/* material: of the default one if it has none */
	size_t triangles;		/* in the file */
};

struct gd_gltf_import {
	struct gd_gltf_part *part;
	size_t npart;
	size_t *first;			/* first part of each mesh; nmesh + 1 */
	size_t points;			/* primitives of points or lines, which are left out */
	size_t lost;			/* triangles of primitives that have none that is whole */
	const struct aiScene *ai;	/* calls meshes "m<part>" and nodes "n<node>" */
};

/* Decodes the meshes that nodes of the scene use. */
int gd_gltf_import(struct gd_gltf *g, struct gd_gltf_import *im, struct gd_err *err);
void gd_gltf_import_free(struct gd_gltf_import *im);

/* --- gltf_geometry.c --- */

/* Fills vertex, normal, uv, triangle of the scene and the places of nodes. */
int gd_gltf_geometry(struct gd_gltf *g, struct gd_scene *scene, struct gd_err *err);

/* --- gltf_material.c --- */

/* Fills material and texture, and g->uv. The default material is the last. */
int gd_gltf_materials(struct gd_gltf *g, struct gd_scene *scene, struct gd_err *err);

/* --- gltf_image.c --- */

/*
 * Reads an image as a texture. bytes->data NULL: from path, else from memory, with path to name it.
 * data: numbers, not colours: as they are in the file. rgb stays NULL on failure.
 */
int gd_texture_read(struct gd_texture *t, const char *path, const struct gd_bytes *bytes, bool data,
		    struct gd_err *err);

#endif
