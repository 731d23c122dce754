/* SPDX-License-Identifier: BSD-3-Clause */
#include "render/gltf.h"

#include <stdlib.h>

#define DEEPEST 500	/* levels of nodes: assimp calls itself for each */

struct walk {
	struct gd_gltf *g;
	struct gd_err *err;
};

static int check_transform(const struct gd_gltf *g, size_t i, struct gd_err *err)
{
	static const struct { const char *name; int n; } part[] = {
		{ "matrix", 16 }, { "translation", 3 }, { "rotation", 4 }, { "scale", 3 },
	};
	double x[16];

	for (int k = 0; k < 4; k++) {
		const cJSON *v = gd_json_get(g->node[i].json, part[k].name);

		if (v && !gd_json_numbers(v, x, part[k].n))
			return gd_fail(err, GD_EFORMAT, "%s: the %s of node %zu is not %d numbers",
				       g->path, part[k].name, i, part[k].n);
	}
	return GD_OK;
}

/* A node and all below it. */
static int visit(struct walk *w, const cJSON *index, int depth)
{
	struct gd_gltf *g = w->g;
	const cJSON *child;
	size_t i;
	int rc;

	if (!cJSON_IsNumber(index) || !(index->valuedouble >= 0) ||
	    !(index->valuedouble < (double)g->nnode))
		return gd_fail(w->err, GD_EFORMAT, "%s: a node that does not exist is in the scene",
			       g->path);
	i = (size_t)index->valuedouble;
	if (g->node[i].used)
		return gd_fail(w->err, GD_EFORMAT, "%s: node %zu is in the scene twice", g->path,
			       i);
	if (depth > DEEPEST)
		return gd_fail(w->err, GD_EFORMAT, "%s: more than %d levels of nodes", g->path,
			       DEEPEST);
	g->node[i].used = true;
	g->node[i].root = depth == 0;
	g->order[g->norder++] = i;
	if (gd_json_index(g->node[i].json, "mesh", &g->node[i].mesh) &&
	    g->node[i].mesh >= g->meshes.n)
		return gd_fail(w->err, GD_EFORMAT, "%s: node %zu uses a mesh that is not there",
			       g->path, i);
	rc = check_transform(g, i, w->err);
	cJSON_ArrayForEach(child, gd_json_get(g->node[i].json, "children")) {
		if (rc != GD_OK)
			break;
		rc = visit(w, child, depth + 1);
	}
	return rc;
}

/* Without any scene in the file: all nodes that are nobody's child. */
static int visit_roots(struct walk *w)
{
	struct gd_gltf *g = w->g;
	bool *child = calloc(g->nnode + 1, sizeof(*child));
	int rc = GD_OK;

	if (!child)
		return gd_fail(w->err, GD_ENOMEM, "%s: out of memory", g->path);
	for (size_t i = 0; i < g->nnode; i++) {
		const cJSON *c;

		cJSON_ArrayForEach(c, gd_json_get(g->node[i].json, "children"))
			if (cJSON_IsNumber(c) && c->valuedouble >= 0 &&
			    c->valuedouble < (double)g->nnode)
				child[(size_t)c->valuedouble] = true;
	}
	for (size_t i = 0; rc == GD_OK && i < g->nnode; i++) {
		const cJSON index = { .type = cJSON_Number, .valuedouble = (double)i };

		if (!child[i])
			rc = visit(w, &index, 0);
	}
	free(child);
	return rc;
}

int gd_gltf_nodes(struct gd_gltf *g, struct gd_err *err)
{
	const cJSON *scenes = gd_json_get(g->json, "scenes"), *root;
	struct gd_gltf_list list;
	struct walk w = { g, err };
	size_t which = 0;
	int rc = GD_OK;

	if (gd_json_list(&list, g->json, "nodes") != GD_OK)
		return gd_fail(err, GD_ENOMEM, "%s: out of memory", g->path);
	g->nnode = list.n;
	g->node = calloc(list.n + 1, sizeof(*g->node));
	g->order = calloc(list.n + 1, sizeof(*g->order));
	for (size_t i = 0; g->node && i < list.n; i++)
		g->node[i] = (struct gd_gltf_node){ .json = list.item[i], .mesh = SIZE_MAX };
	free(list.item);
	if (!g->node || !g->order)
		return gd_fail(err, GD_ENOMEM, "%s: out of memory", g->path);
	if (cJSON_GetArraySize(scenes) < 1)
		return visit_roots(&w);
	gd_json_index(g->json, "scene", &which);
	if (which >= (size_t)cJSON_GetArraySize(scenes))
		return gd_fail(err, GD_EFORMAT, "%s: its scene does not exist", g->path);
	cJSON_ArrayForEach(root, gd_json_get(cJSON_GetArrayItem(scenes, (int)which), "nodes")) {
		if (rc != GD_OK)
			break;
		rc = visit(&w, root, 0);
	}
	return rc;
}
