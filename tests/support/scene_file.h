/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Writes test scenes as glTF 2.0: NAME.gltf, a .bin beside it, and NAME.args, a line of options
 * for gdrender. Positions and texture coordinates are multiples of 2^-15 and 2^-12, so that they
 * compress.
 */
#ifndef SCENE_FILE_H
#define SCENE_FILE_H

#include <limits.h>
#include <stdarg.h>
#include <stdint.h>

#include "scene_shapes.h"

#define SCENE_ROOM 64 /* materials, textures */
#define SCENE_MESHES 256
#define SCENE_NODES 1024

struct finish {
	double r, g, b; /* base colour, linear */
	double metallic, roughness;
	double transmission, ior; /* ior 0: 1.5 */
	double glow; /* emitted radiance is glow times r g b, and the base is black */
	const char *texture; /* PNG beside the scene, or NULL */
};

struct piece {
	int finish, ncorner, nindex, textured;
	long offset; /* into the .bin */
	double low[3], high[3];
};

struct node {
	struct place place;
	int mesh;
};

struct camera {
	struct p3 from, to;
	double yfov; /* degrees */
};

struct scene {
	const char *folder, *name;
	FILE *bin;
	long size;
	char bin_name[64];
	struct finish finish[SCENE_ROOM];
	struct piece piece[SCENE_MESHES];
	struct node node[SCENE_NODES];
	int nfinish, npiece, nnode;
	struct camera camera;
};

static int room_for(int n, int room, const char *what)
{
	if (n >= room) {
		fprintf(stderr, "mkscenes: more than %d %s\n", room, what);
		exit(2);
	}
	return n;
}

static FILE *create(const char *folder, const char *name)
{
	char path[PATH_MAX];
	FILE *f;

	snprintf(path, sizeof path, "%s/%s", folder, name);
	f = fopen(path, "wb");
	if (!f) {
		perror(path);
		exit(2);
	}
	return f;
}

static void done(FILE *f)
{
	const int bad = ferror(f);

	if (fclose(f) || bad) {
		perror("mkscenes");
		exit(2);
	}
}

static void scene_open(struct scene *s, const char *folder, const char *name)
{
	*s = (struct scene){ .folder = folder, .name = name };
	snprintf(s->bin_name, sizeof s->bin_name, "%s.bin", name);
	s->bin = create(folder, s->bin_name);
}

static int paint(struct scene *s, struct finish f)
{
	const int n = room_for(s->nfinish, SCENE_ROOM, "materials");

	s->finish[n] = f;
	s->nfinish++;
	return n;
}

static int matte(struct scene *s, double r, double g, double b)
{
	return paint(s, (struct finish){ .r = r, .g = g, .b = b, .roughness = 1 });
}

/* Paint, plastic, china, lacquer: diffuse under a coat that reflects. */
static int gloss(struct scene *s, double r, double g, double b, double roughness)
{
	return paint(s, (struct finish){ .r = r, .g = g, .b = b, .roughness = roughness });
}

static int metal(struct scene *s, double r, double g, double b, double roughness)
{
	return paint(s, (struct finish){
				.r = r, .g = g, .b = b, .metallic = 1, .roughness = roughness });
}

static int glass(struct scene *s, double r, double g, double b, double roughness)
{
	return paint(s,
		     (struct finish){
			     .r = r, .g = g, .b = b, .roughness = roughness, .transmission = 1 });
}

static int textured(struct scene *s, const char *png, double roughness)
{
	return paint(s, (struct finish){
				.r = 1, .g = 1, .b = 1, .roughness = roughness, .texture = png });
}

static int light(struct scene *s, double r, double g, double b, double radiance)
{
	return paint(s,
		     (struct finish){ .r = r, .g = g, .b = b, .roughness = 1, .glow = radiance });
}

static void put_float(struct scene *s, double v, double grid)
{
	const float f = (float)(nearbyint(v * grid) / grid) + 0.0f; /* no -0 */
	uint32_t bits;

	memcpy(&bits, &f, sizeof bits);
	for (int k = 0; k < 4; k++)
		putc((int)(bits >> 8 * k & 255), s->bin);
	s->size += 4;
}

static void put_index(struct scene *s, unsigned v)
{
	putc((int)(v & 255), s->bin);
	putc((int)(v >> 8), s->bin);
	s->size += 2;
}

/* A mesh of its own; frees m. Returns its number, for stand(). */
static int shape(struct scene *s, struct mesh *m, int finish)
{
	struct piece *p = &s->piece[room_for(s->npiece, SCENE_MESHES, "meshes")];
	const int textures = s->finish[finish].texture != NULL;

	room_for(m->ncorner, 65536, "corners in a mesh");
	*p = (struct piece){ finish,  m->ncorner,        m->nindex,           textures,
			     s->size, { 1e9, 1e9, 1e9 }, { -1e9, -1e9, -1e9 } };
	for (int i = 0; i < m->ncorner; i++) {
		const double v[3] = { m->corner[i].p.x, m->corner[i].p.y, m->corner[i].p.z };

		for (int c = 0; c < 3; c++) {
			const double q = nearbyint(v[c] * 32768) / 32768;

			put_float(s, v[c], 32768);
			p->low[c] = fmin(p->low[c], q);
			p->high[c] = fmax(p->high[c], q);
		}
	}
	for (int i = 0; i < m->ncorner; i++) {
		put_float(s, m->corner[i].n.x, 4096);
		put_float(s, m->corner[i].n.y, 4096);
		put_float(s, m->corner[i].n.z, 4096);
	}
	for (int i = 0; textures && i < m->ncorner; i++) {
		put_float(s, m->corner[i].u, 4096);
		put_float(s, m->corner[i].v, 4096);
	}
	for (int i = 0; i < m->nindex; i++)
		put_index(s, m->index[i]);
	if (m->nindex & 1)
		put_index(s, 0); /* what follows starts at a multiple of 4 */
	free(m->corner);
	free(m->index);
	*m = (struct mesh){ 0 };
	return s->npiece++;
}

static void stand(struct scene *s, int mesh, struct place where)
{
	const int n = room_for(s->nnode, SCENE_NODES, "nodes");

	s->node[n] = (struct node){ where, mesh };
	s->nnode++;
}

/* A mesh that stands in one place only. */
static void thing(struct scene *s, struct mesh *m, int finish, struct place where)
{
	stand(s, shape(s, m, finish), where);
}

/* --- JSON --- */

static const char *comma(int i)
{
	return i ? ",\n" : "\n";
}

static void write_materials(FILE *f, const struct scene *s)
{
	int ntexture = 0;

	fprintf(f, "\"materials\": [");
	for (int i = 0; i < s->nfinish; i++) {
		const struct finish *m = &s->finish[i];
		const double base = m->glow > 0 ? 0 : 1;

		fprintf(f,
			"%s{\"pbrMetallicRoughness\": {\"baseColorFactor\": [%.4g, %.4g, %.4g, 1], "
			"\"metallicFactor\": %.4g, \"roughnessFactor\": %.4g",
			comma(i), base * m->r, base * m->g, base * m->b, m->metallic, m->roughness);
		if (m->texture)
			fprintf(f, ", \"baseColorTexture\": {\"index\": %d}", ntexture++);
		fprintf(f, "}");
		if (m->glow > 0)
			fprintf(f,
				", \"emissiveFactor\": [%.4g, %.4g, %.4g], \"extensions\": "
				"{\"KHR_materials_emissive_strength\": {\"emissiveStrength\": "
				"%.6g}}",
				m->r, m->g, m->b, m->glow);
		if (m->transmission > 0)
			fprintf(f,
				", \"extensions\": {\"KHR_materials_transmission\": "
				"{\"transmissionFactor\": %.4g}, \"KHR_materials_ior\": {\"ior\": "
				"%.4g}}",
				m->transmission, m->ior > 0 ? m->ior : 1.5);
		fprintf(f, "}");
	}
	fprintf(f, "\n],\n");
	if (!ntexture)
		return;
	fprintf(f, "\"textures\": [");
	for (int i = 0; i < ntexture; i++)
		fprintf(f, "%s{\"source\": %d, \"sampler\": 0}", i ? ", " : "", i);
	fprintf(f, "],\n\"samplers\": [{\"wrapS\": 10497, \"wrapT\": 10497}],\n\"images\": [");
	ntexture = 0;
	for (int i = 0; i < s->nfinish; i++)
		if (s->finish[i].texture)
			fprintf(f, "%s{\"uri\": \"%s\"}", ntexture++ ? ", " : "",
				s->finish[i].texture);
	fprintf(f, "],\n");
}

static void write_meshes(FILE *f, const struct scene *s)
{
	int accessor = 0, view = 0;

	fprintf(f, "\"meshes\": [");
	for (int i = 0; i < s->npiece; i++) {
		const struct piece *p = &s->piece[i];

		fprintf(f, "%s{\"primitives\": [{\"attributes\": {\"POSITION\": %d, \"NORMAL\": %d",
			comma(i), accessor, accessor + 1);
		if (p->textured)
			fprintf(f, ", \"TEXCOORD_0\": %d", accessor + 2);
		fprintf(f, "}, \"indices\": %d, \"material\": %d}]}", accessor + 2 + p->textured,
			p->finish);
		accessor += 3 + p->textured;
	}
	fprintf(f, "\n],\n\"accessors\": [");
	for (int i = 0; i < s->npiece; i++) {
		const struct piece *p = &s->piece[i];

		fprintf(f,
			"%s{\"bufferView\": %d, \"componentType\": 5126, \"count\": %d, \"type\": "
			"\"VEC3\", "
			"\"min\": [%.9g, %.9g, %.9g], \"max\": [%.9g, %.9g, %.9g]}",
			comma(i), view, p->ncorner, p->low[0], p->low[1], p->low[2], p->high[0],
			p->high[1], p->high[2]);
		fprintf(f,
			",\n{\"bufferView\": %d, \"componentType\": 5126, \"count\": %d, \"type\": "
			"\"VEC3\"}",
			view + 1, p->ncorner);
		if (p->textured)
			fprintf(f,
				",\n{\"bufferView\": %d, \"componentType\": 5126, \"count\": %d, "
				"\"type\": \"VEC2\"}",
				view + 2, p->ncorner);
		fprintf(f,
			",\n{\"bufferView\": %d, \"componentType\": 5123, \"count\": %d, "
			"\"type\": \"SCALAR\"}",
			view + 2 + p->textured, p->nindex);
		view += 3 + p->textured;
	}
	fprintf(f, "\n],\n\"bufferViews\": [");
	for (int i = 0; i < s->npiece; i++) {
		const struct piece *p = &s->piece[i];
		const long vector = 12L * p->ncorner;
		long here = p->offset;

		for (int k = 0; k < 2 + p->textured; k++, here += vector)
			fprintf(f,
				"%s{\"buffer\": 0, \"byteOffset\": %ld, \"byteLength\": %ld, "
				"\"target\": 34962}",
				comma(i + k), here, k < 2 ? vector : 8L * p->ncorner);
		if (p->textured)
			here -= 4L * p->ncorner;
		fprintf(f,
			",\n{\"buffer\": 0, \"byteOffset\": %ld, \"byteLength\": %ld, \"target\": "
			"34963}",
			here, 2L * p->nindex);
	}
	fprintf(f, "\n],\n\"buffers\": [{\"uri\": \"%s\", \"byteLength\": %ld}]\n", s->bin_name,
		s->size);
}

static void write_place(FILE *f, struct place p)
{
	fprintf(f, "\"translation\": [%.6g, %.6g, %.6g]", p.t.x, p.t.y, p.t.z);
	if (p.q[3] != 1)
		fprintf(f, ", \"rotation\": [%.6g, %.6g, %.6g, %.6g]", p.q[0] + 0.0, p.q[1] + 0.0,
			p.q[2] + 0.0, p.q[3]);
}

static struct place camera_place(const struct camera *c)
{
	const struct p3 d = sub(c->to, c->from);
	const double yaw = atan2(-d.x, -d.z), pitch = atan2(d.y, hypot(d.x, d.z));
	const struct place p = turned(at(c->from.x, c->from.y, c->from.z), 'y', yaw * 180 / PI);

	return turned(p, 'x', pitch * 180 / PI);
}

static void write_nodes(FILE *f, const struct scene *s)
{
	fprintf(f, "\"scene\": 0,\n\"scenes\": [{\"nodes\": [");
	for (int i = 0; i <= s->nnode; i++)
		fprintf(f, "%s%d", i ? ", " : "", i);
	fprintf(f,
		"]}],\n\"cameras\": [{\"name\": \"camera\", \"type\": \"perspective\", "
		"\"perspective\": {\"yfov\": %.6g, \"aspectRatio\": 1.333333, \"znear\": "
		"0.01}}],\n",
		s->camera.yfov * PI / 180);
	fprintf(f, "\"nodes\": [\n{\"name\": \"camera\", \"camera\": 0, ");
	write_place(f, camera_place(&s->camera));
	fprintf(f, "}");
	for (int i = 0; i < s->nnode; i++) {
		fprintf(f, ",\n{\"mesh\": %d, ", s->node[i].mesh);
		write_place(f, s->node[i].place);
		fprintf(f, "}");
	}
	fprintf(f, "\n],\n");
}

static void write_used(FILE *f, const struct scene *s)
{
	int glows = 0, passes = 0;

	for (int i = 0; i < s->nfinish; i++) {
		glows |= s->finish[i].glow > 0;
		passes |= s->finish[i].transmission > 0;
	}
	if (glows || passes)
		fprintf(f, "\"extensionsUsed\": [%s%s%s],\n",
			glows ? "\"KHR_materials_emissive_strength\"" : "",
			glows && passes ? ", " : "",
			passes ? "\"KHR_materials_transmission\", \"KHR_materials_ior\"" : "");
}

/* NAME.gltf, NAME.args, of the meshes so far. */
static void scene_write(struct scene *s, const char *name, const char *args)
{
	char file[128];
	FILE *f;

	snprintf(file, sizeof file, "%s.gltf", name);
	f = create(s->folder, file);
	fprintf(f, "{\n\"asset\": {\"version\": \"2.0\", \"generator\": \"mkscenes\"},\n");
	write_used(f, s);
	write_nodes(f, s);
	write_materials(f, s);
	write_meshes(f, s);
	fprintf(f, "}\n");
	done(f);
	snprintf(file, sizeof file, "%s.args", name);
	f = create(s->folder, file);
	fprintf(f, "%s\n", args);
	done(f);
}

static void scene_close(struct scene *s)
{
	done(s->bin);
}

#endif
