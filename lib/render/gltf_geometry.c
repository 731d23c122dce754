/* SPDX-License-Identifier: BSD-3-Clause */
#include "render/gltf.h"

#include <assimp/scene.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "render/impl.h"

struct build {
	struct gd_gltf *g;
	struct gd_gltf_import im;
	struct gd_scene *s;
	size_t nvertex, ntriangle;	/* so far */
	size_t broken, flat, outside;	/* triangles left out */
	bool fill;			/* else only counted */
};

struct matrix {
	double m[3][4];
};

static struct matrix times(const struct matrix *a, const struct aiMatrix4x4 *b)
{
	const double r[4][4] = { { (double)b->a1, (double)b->a2, (double)b->a3, (double)b->a4 },
				 { (double)b->b1, (double)b->b2, (double)b->b3, (double)b->b4 },
				 { (double)b->c1, (double)b->c2, (double)b->c3, (double)b->c4 },
				 { 0, 0, 0, 1 } };
	struct matrix p;

	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 4; j++) {
			p.m[i][j] = 0;
			for (int k = 0; k < 4; k++)
				p.m[i][j] += a->m[i][k] * r[k][j];
		}
	return p;
}

/* Cofactors: they take normals along, of the mesh's triangles, too, whatever the determinant. */
static double cofactors(const struct matrix *a, double c[3][3])
{
	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++) {
			const int p = (i + 1) % 3, q = (i + 2) % 3;
			const int r = (j + 1) % 3, s = (j + 2) % 3;

			c[i][j] = a->m[p][r] * a->m[q][s] - a->m[p][s] * a->m[q][r];
		}
	return a->m[0][0] * c[0][0] + a->m[0][1] * c[0][1] + a->m[0][2] * c[0][2];
}

static struct gd_v3 move(const struct matrix *a, const struct aiVector3D *v)
{
	const double x = (double)v->x, y = (double)v->y, z = (double)v->z;
	double r[3];

	for (int i = 0; i < 3; i++)
		r[i] = a->m[i][0] * x + a->m[i][1] * y + a->m[i][2] * z + a->m[i][3];
	return gd_v3((float)r[0], (float)r[1], (float)r[2]);
}

/* Of length 1, or 0 where there is no direction. */
static struct gd_v3 turn(double c[3][3], double sign, const struct aiVector3D *v)
{
	const double x = (double)v->x, y = (double)v->y, z = (double)v->z;
	double r[3], most = 0, l;

	for (int i = 0; i < 3; i++) {
		r[i] = sign * (c[i][0] * x + c[i][1] * y + c[i][2] * z);
		most = fmax(most, fabs(r[i]));
	}
	if (!(most > 0) || !isfinite(r[0]) || !isfinite(r[1]) || !isfinite(r[2]))
		return gd_v3(0, 0, 0);
	l = most * sqrt(r[0] / most * (r[0] / most) + r[1] / most * (r[1] / most) +
			r[2] / most * (r[2] / most));
	return gd_v3((float)(r[0] / l), (float)(r[1] / l), (float)(r[2] / l));
}

static void add_vertices(struct build *b, const struct aiMesh *ai, const struct matrix *m,
			 const struct gd_gltf_uv *uv)
{
	struct gd_scene *s = b->s;
	double c[3][3];
	const double sign = cofactors(m, c) < 0 ? -1 : 1;
	const unsigned set = ai->mTextureCoords[0] ? 0 : uv->set > 0 && uv->set < 8 ? uv->set : 0;
	const struct aiVector3D *from = ai->mTextureCoords[set];

	for (size_t i = 0; i < ai->mNumVertices; i++) {
		const size_t k = b->nvertex + i;

		s->vertex[k] = move(m, &ai->mVertices[i]);
		s->normal[k] = ai->mNormals ? turn(c, sign, &ai->mNormals[i]) : gd_v3(0, 0, 0);
		if (s->uv && from && uv->set >= 0) {
			/* assimp turns v round */
			const float u = from[i].x, v = 1 - from[i].y;

			for (int r = 0; r < 2; r++)
				s->uv[2 * k + (size_t)r] =
					uv->m[r][0] * u + uv->m[r][1] * v + uv->m[r][2];
		}
	}
}

static bool usable(struct gd_v3 v)
{
	return fabsf(v.x) <= GD_FARTHEST && fabsf(v.y) <= GD_FARTHEST && fabsf(v.z) <= GD_FARTHEST;
}

static void add_faces(struct build *b, const struct aiMesh *ai, bool mirrored, uint32_t material)
{
	struct gd_scene *s = b->s;
	struct gd_v3 n;

	for (size_t i = 0; i < ai->mNumFaces; i++) {
		const struct aiFace *f = &ai->mFaces[i];
		struct gd_triangle t = { .material = material, .light = GD_NO_INDEX };

		if (f->mNumIndices != 3)
			continue;
		for (int k = 0; k < 3; k++)
			t.vertex[k] = (uint32_t)b->nvertex + f->mIndices[mirrored && k ? 3 - k : k];
		if (!usable(s->vertex[t.vertex[0]]) || !usable(s->vertex[t.vertex[1]]) ||
		    !usable(s->vertex[t.vertex[2]]))
			b->broken++;
		else if (!gd_triangle_normal(s, &t, &n))
			b->flat++;
		else
			s->triangle[b->ntriangle++] = t;
	}
}

/* Number of the part that a mesh is, from its name. */
static size_t part_of(const struct build *b, const struct aiMesh *ai)
{
	size_t part = 0, more = 0;

	if (sscanf(ai->mName.data, "m%zu-%zu", &part, &more) < 1 || part + more >= b->im.npart)
		return SIZE_MAX;
	return part + more;
}

static int add_mesh(struct build *b, const struct aiMesh *ai, const struct matrix *m,
		    struct gd_err *err)
{
	const size_t p = part_of(b, ai);
	const struct gd_gltf_part *part = &b->im.part[p];
	double c[3][3];

	if (p == SIZE_MAX)
		return gd_fail(err, GD_EFORMAT, "%s: a mesh came out under another name",
			       b->g->path);
	if (b->fill) {
		add_vertices(b, ai, m, &b->g->uv[part->material]);
		add_faces(b, ai, cofactors(m, c) < 0, (uint32_t)part->material);
	} else {
		b->outside += part->triangles - ai->mNumFaces;
		b->ntriangle += ai->mNumFaces;
	}
	b->nvertex += ai->mNumVertices;
	if (b->nvertex >= GD_NO_INDEX || b->ntriangle >= GD_NO_INDEX)
		return gd_fail(err, GD_ENOMEM, "%s: more than %u triangles or vertices",
			       b->g->path, GD_NO_INDEX - 1);
	return GD_OK;
}

static int walk(struct build *b, const struct aiNode *n, const struct matrix *above,
		struct gd_err *err)
{
	const struct matrix m = times(above, &n->mTransformation);
	size_t k;
	int rc = GD_OK;

	if (sscanf(n->mName.data, "n%zu", &k) == 1 && k < b->g->nnode)
		memcpy(b->g->node[k].m, m.m, sizeof(m.m));
	for (unsigned i = 0; rc == GD_OK && i < n->mNumMeshes; i++)
		rc = add_mesh(b, b->im.ai->mMeshes[n->mMeshes[i]], &m, err);
	for (unsigned i = 0; rc == GD_OK && i < n->mNumChildren; i++)
		rc = walk(b, n->mChildren[i], &m, err);
	return rc;
}

static const struct matrix identity = { { { 1, 0, 0, 0 }, { 0, 1, 0, 0 }, { 0, 0, 1, 0 } } };

static int flatten(struct build *b, struct gd_err *err)
{
	struct gd_scene *s = b->s;
	bool textured = false;
	int rc = walk(b, b->im.ai->mRootNode, &identity, err);

	if (rc != GD_OK)
		return rc;
	for (size_t i = 0; i < b->im.npart; i++)
		textured = textured || b->g->uv[b->im.part[i].material].set >= 0;
	s->vertex = gd_alloc(b->nvertex + 1, sizeof(*s->vertex));
	s->normal = gd_alloc(b->nvertex, sizeof(*s->normal));
	s->triangle = gd_alloc(b->ntriangle, sizeof(*s->triangle));
	if (textured)
		s->uv = gd_calloc(b->nvertex, 2 * sizeof(*s->uv));
	if (!s->vertex || !s->normal || !s->triangle || (textured && !s->uv))
		return gd_fail(err, GD_ENOMEM, "%s: out of memory for %zu triangles", b->g->path,
			       b->ntriangle);
	s->nvertex = b->nvertex;
	b->nvertex = b->ntriangle = 0;
	b->fill = true;
	rc = walk(b, b->im.ai->mRootNode, &identity, err);
	s->ntriangle = b->ntriangle;
	return rc;
}

static void tell(const struct build *b)
{
	const size_t outside = b->outside + b->im.lost, all = outside + b->broken + b->flat;

	if (b->im.points)
		gd_warn(b->g->report, "%s: %zu primitives of points or lines are left out",
			b->g->path, b->im.points);
	if (all)	/* those without area are not missed */
		(all > b->flat ? gd_warn : gd_note)(
			b->g->report,
			"%s: %zu triangles are left out: %zu with an index out of range, "
			"%zu with a vertex that is not finite or too far away, %zu without area",
			b->g->path, all, outside, b->broken, b->flat);
}

int gd_gltf_geometry(struct gd_gltf *g, struct gd_scene *scene, struct gd_err *err)
{
	struct build b = { .g = g, .s = scene };
	int rc = gd_gltf_import(g, &b.im, err);

	if (rc != GD_OK)
		return rc;
	if (b.im.ai && b.im.ai->mRootNode)
		rc = flatten(&b, err);
	if (rc == GD_OK)
		tell(&b);
	gd_gltf_import_free(&b.im);
	if (rc == GD_OK && !scene->ntriangle)
		rc = gd_fail(err, GD_ESHAPE, "%s: no triangles", g->path);
	return rc;
}
