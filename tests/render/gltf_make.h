/* SPDX-License-Identifier: BSD-3-Clause */
/* glTF files written by hand into a folder of their own, and what loading says of them. */
#ifndef GLTF_MAKE_H
#define GLTF_MAKE_H

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <stdio.h>
#include <unistd.h>

#include "plugin.h"
#include "scene_make.h"

/* --- files --- */

static char folder[] = "/tmp/gd-gltf-XXXXXX";
static char notes[8192];
static int nnotes;

static inline void keep_note(void *user, const char *text)
{
	(void)user;
	nnotes++;
	strncat(notes, text, sizeof(notes) - strlen(notes) - 2);
	strncat(notes, "\n", sizeof(notes) - strlen(notes) - 1);
}

static const struct gd_report report = { .note = keep_note };

static char *path_of(const char *name)
{
	static char path[4][500];
	static int k;

	k = (k + 1) % 4;
	snprintf(path[k], sizeof(path[k]), "%s/%s", folder, name);
	return path[k];
}

static inline void put(const char *name, const void *data, size_t size)
{
	FILE *f = fopen(path_of(name), "wb");

	assert_non_null(f);
	assert_int_equal(fwrite(data, 1, size, f), size);
	assert_int_equal(fclose(f), 0);
}

__attribute__((format(printf, 2, 3)))
static inline void say(const char *name, const char *format, ...)
{
	static char text[1 << 16];
	va_list ap;

	va_start(ap, format);
	assert_true(vsnprintf(text, sizeof(text), format, ap) < (int)sizeof(text));
	va_end(ap);
	put(name, text, strlen(text));
}

/* The buffer of most files: the corners of a unit square in z = 0, looking at +z. */
struct square {
	float position[4][3], normal[4][3], uv[4][2];
	uint16_t index[6], spare[2];
};

static const struct square square = {
	{ { 0, 0, 0 }, { 1, 0, 0 }, { 1, 1, 0 }, { 0, 1, 0 } },
	{ { 0, 0, 1 }, { 0, 0, 1 }, { 0, 0, 1 }, { 0, 0, 1 } },
	{ { 0, 1 }, { 1, 1 }, { 1, 0 }, { 0, 0 } },
	{ 0, 1, 2, 0, 2, 3 },
	{ 0, 0 },
};

#define HEAD "{\"asset\":{\"version\":\"2.0\"},"
#define CAMERA                                                                                     \
	"\"cameras\":[{\"type\":\"perspective\",\"perspective\":{\"yfov\":0.8,\"znear\":0.1}}],"
#define ACCESSORS                                                                                  \
	"\"accessors\":["                                                                          \
	"{\"bufferView\":0,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\"},"                 \
	"{\"bufferView\":0,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\","                  \
	"\"byteOffset\":48},"                                                                      \
	"{\"bufferView\":0,\"componentType\":5126,\"count\":4,\"type\":\"VEC2\","                  \
	"\"byteOffset\":96},"                                                                      \
	"{\"bufferView\":0,\"componentType\":5123,\"count\":6,\"type\":\"SCALAR\","                \
	"\"byteOffset\":128}],"
#define BUFFERS                                                                                    \
	"\"bufferViews\":[{\"buffer\":0,\"byteLength\":140}],"                                     \
	"\"buffers\":[{\"byteLength\":140,\"uri\":\"square.bin\"}]}"
#define SQUARE                                                                                     \
	"{\"attributes\":{\"POSITION\":0,\"NORMAL\":1,\"TEXCOORD_0\":2},\"indices\":3,"            \
	"\"material\":0}"
#define MESH "\"meshes\":[{\"primitives\":[" SQUARE "]}],"
#define GLOW "\"materials\":[{\"emissiveFactor\":[1,1,1]}],"
#define SCENE "\"scenes\":[{\"nodes\":[0,1]}],\"scene\":0,"
#define NODES "\"nodes\":[{\"mesh\":0},{\"camera\":0,\"translation\":[0.5,0.5,3]}],"
#define REST CAMERA ACCESSORS BUFFERS

static struct gd_err err;

static inline struct gd_scene *load_with(const char *name, const struct gd_scene_options *o)
{
	struct gd_scene *s = (void *)1;
	int rc;

	err = (struct gd_err){ 0 };
	notes[0] = '\0';
	nnotes = 0;
	rc = gd_scene_load(&s, name[0] == '/' || name[0] == '.' ? name : path_of(name), o, &report,
			   &err);
	if (rc != GD_OK) {
		assert_null(s);
		assert_int_equal(err.code, rc);
		assert_true(err.text[0] && !strchr(err.text, '\n'));
	} else {
		assert_non_null(s);
	}
	return s;
}

static inline struct gd_scene *load(const char *name)
{
	const struct gd_scene_options o = { .w = 300, .h = 200 };

	return load_with(name, &o);
}

static inline struct gd_scene *load_well(const char *name)
{
	struct gd_scene *s = load(name);

	if (!s)
		fail_msg("%s", err.text);
	return s;
}

/* Loading fails with that code, a text that names the file and has that in it. */
static inline void refused(const char *name, int code, const char *with)
{
	struct gd_scene *s = load(name);

	if (s || err.code != code || !strstr(err.text, with) || !strstr(err.text, name))
		fail_msg("%s: code %d, text \"%s\"; wanted %d and \"%s\"", name, err.code, err.text,
			 code, with);
}

static inline void noted(const char *what)
{
	if (!strstr(notes, what))
		fail_msg("no note \"%s\" in \"%s\"", what, notes);
}

static inline void at(struct gd_v3 v, double x, double y, double z)
{
	if (!(fabs((double)v.x - x) < 1e-5 && fabs((double)v.y - y) < 1e-5 &&
	      fabs((double)v.z - z) < 1e-5))
		fail_msg("%g %g %g, wanted %g %g %g", (double)v.x, (double)v.y, (double)v.z, x, y,
			 z);
}

static inline struct gd_v3 corner(const struct gd_scene *s, size_t triangle, int k)
{
	return s->vertex[s->triangle[triangle].vertex[k]];
}

static inline struct gd_v3 normal(const struct gd_scene *s, size_t t)
{
	return gd_unit(gd_cross(gd_sub(corner(s, t, 1), corner(s, t, 0)),
				gd_sub(corner(s, t, 2), corner(s, t, 0))));
}

/* --- the plug-in --- */

static inline bool have_plugin(void)
{
	struct gd_err e = { 0 };

	return gd_plugin_check(&e) == GD_OK;
}

static inline void need_plugin(void)
{
	if (!have_plugin()) {
		print_message("not tested: there is no plug-in\n");
		skip();
	}
}

static inline unsigned char *make_png(size_t *size, const void *pixel, int w, int h, int n,
				      int bits)
{
	struct gd_err e = { 0 };
	unsigned char *png;

	if (gd_plugin_png(&png, size, pixel, w, h, n, bits, &e) != GD_OK)
		fail_msg("%s", e.text);
	return png;
}

static inline void put_png(const char *name, const void *pixel, int w, int h, int n, int bits)
{
	size_t size;
	unsigned char *png = make_png(&size, pixel, w, h, n, bits);

	put(name, png, size);
	free(png);
}

static inline int make_folder(void **state)
{
	const unsigned char grey = 255;

	(void)state;
	if (!mkdtemp(folder))
		return 1;
	put("square.bin", &square, sizeof(square));
	if (have_plugin())
		put_png("grey.png", &grey, 1, 1, 1, 8);
	return 0;
}

static inline int remove_folder(void **state)
{
	char command[100];

	(void)state;
	snprintf(command, sizeof(command), "rm -r %s", folder);
	return system(command);
}

#endif
