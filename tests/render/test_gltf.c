/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Loading glTF: places, cameras, lights, materials and textures against what was written by hand,
 * and files that are damaged in all manner of ways. Textures need the plug-in: skipped, and said
 * so, without.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <fcntl.h>
#include <stdio.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include "exr.h"
#include "plugin.h"
#include "scene_make.h"

/* --- files --- */

static char folder[] = "/tmp/gd-gltf-XXXXXX";
static char notes[8192];
static int nnotes;

static void keep_note(void *user, const char *text)
{
	(void)user;
	nnotes++;
	strncat(notes, text, sizeof(notes) - strlen(notes) - 2);
	strncat(notes, "\n", sizeof(notes) - strlen(notes) - 1);
}

static const struct gd_report report = { .note = keep_note };

static char *path_of(const char *name)
{
	static char path[4][300];
	static int k;

	k = (k + 1) % 4;
	snprintf(path[k], sizeof(path[k]), "%s/%s", folder, name);
	return path[k];
}

static void put(const char *name, const void *data, size_t size)
{
	FILE *f = fopen(path_of(name), "wb");

	assert_non_null(f);
	assert_int_equal(fwrite(data, 1, size, f), size);
	assert_int_equal(fclose(f), 0);
}

static void say(const char *name, const char *format, ...) __attribute__((format(printf, 2, 3)));
static void say(const char *name, const char *format, ...)
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
#define CAMERA "\"cameras\":[{\"type\":\"perspective\",\"perspective\":{\"yfov\":0.8,\"znear\":0.1}}],"
#define ACCESSORS                                                                                  \
	"\"accessors\":["                                                                          \
	"{\"bufferView\":0,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\"},"                 \
	"{\"bufferView\":0,\"byteOffset\":48,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\"}," \
	"{\"bufferView\":0,\"byteOffset\":96,\"componentType\":5126,\"count\":4,\"type\":\"VEC2\"}," \
	"{\"bufferView\":0,\"byteOffset\":128,\"componentType\":5123,\"count\":6,\"type\":\"SCALAR\"}],"
#define BUFFERS                                                                                    \
	"\"bufferViews\":[{\"buffer\":0,\"byteLength\":140}],"                                     \
	"\"buffers\":[{\"byteLength\":140,\"uri\":\"square.bin\"}]}"
#define SQUARE "{\"attributes\":{\"POSITION\":0,\"NORMAL\":1,\"TEXCOORD_0\":2},\"indices\":3,\"material\":0}"
#define MESH "\"meshes\":[{\"primitives\":[" SQUARE "]}],"
#define GLOW "\"materials\":[{\"emissiveFactor\":[1,1,1]}],"
#define SCENE "\"scenes\":[{\"nodes\":[0,1]}],\"scene\":0,"
#define NODES "\"nodes\":[{\"mesh\":0},{\"camera\":0,\"translation\":[0.5,0.5,3]}],"
#define REST CAMERA ACCESSORS BUFFERS

static struct gd_err err;

static struct gd_scene *load_with(const char *name, const struct gd_scene_options *o)
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

static struct gd_scene *load(const char *name)
{
	const struct gd_scene_options o = { .w = 300, .h = 200 };

	return load_with(name, &o);
}

static struct gd_scene *load_well(const char *name)
{
	struct gd_scene *s = load(name);

	if (!s)
		fail_msg("%s", err.text);
	return s;
}

/* Loading fails with that code, a text that names the file and has that in it. */
static void refused(const char *name, int code, const char *with)
{
	struct gd_scene *s = load(name);

	if (s || err.code != code || !strstr(err.text, with) || !strstr(err.text, name))
		fail_msg("%s: code %d, text \"%s\"; wanted %d and \"%s\"", name, err.code, err.text,
			 code, with);
}

static void noted(const char *what)
{
	if (!strstr(notes, what))
		fail_msg("no note \"%s\" in \"%s\"", what, notes);
}

static void at(struct gd_v3 v, double x, double y, double z)
{
	if (!(fabs((double)v.x - x) < 1e-5 && fabs((double)v.y - y) < 1e-5 &&
	      fabs((double)v.z - z) < 1e-5))
		fail_msg("%g %g %g, wanted %g %g %g", (double)v.x, (double)v.y, (double)v.z, x, y,
			 z);
}

static struct gd_v3 corner(const struct gd_scene *s, size_t triangle, int k)
{
	return s->vertex[s->triangle[triangle].vertex[k]];
}

static struct gd_v3 normal(const struct gd_scene *s, size_t t)
{
	return gd_unit(gd_cross(gd_sub(corner(s, t, 1), corner(s, t, 0)),
				gd_sub(corner(s, t, 2), corner(s, t, 0))));
}

/* --- the plug-in --- */

static bool have_plugin(void)
{
	struct gd_err e = { 0 };

	return gd_plugin_check(&e) == GD_OK;
}

static void need_plugin(void)
{
	if (!have_plugin()) {
		print_message("not tested: there is no plug-in\n");
		skip();
	}
}

static unsigned char *make_png(size_t *size, const void *pixel, int w, int h, int n, int bits)
{
	struct gd_err e = { 0 };
	unsigned char *png;

	if (gd_plugin_png(&png, size, pixel, w, h, n, bits, &e) != GD_OK)
		fail_msg("%s", e.text);
	return png;
}

static void put_png(const char *name, const void *pixel, int w, int h, int n, int bits)
{
	size_t size;
	unsigned char *png = make_png(&size, pixel, w, h, n, bits);

	put(name, png, size);
	free(png);
}

/* --- geometry --- */

static void plain(void **state)
{
	struct gd_scene *s;

	(void)state;
	say("plain.gltf", HEAD SCENE NODES MESH GLOW REST);
	s = load_well("plain.gltf");
	assert_int_equal(nnotes, 0);
	assert_int_equal(s->ntriangle, 2);
	assert_int_equal(s->nlight, 2);
	at(corner(s, 0, 0), 0, 0, 0);
	at(corner(s, 0, 1), 1, 0, 0);
	at(corner(s, 1, 2), 0, 1, 0);
	at(s->normal[0], 0, 0, 1);
	at(s->low, 0, 0, 0);
	at(s->high, 1, 1, 0);
	assert_int_equal(s->environment_light, GD_NO_INDEX);
	/* no focus was asked for: what the centre shows */
	assert_true(fabsf(s->view.focus - 3) < 1e-6f && s->view.lens == 0);
	gd_scene_free(s);
}

/* A parent's scale, a child turned, shifted and mirrored; names alike everywhere. */
static void transforms(void **state)
{
	struct gd_scene *s;

	(void)state;
	say("tree.gltf", HEAD "\"scenes\":[{},{\"nodes\":[3,2,0]}],\"scene\":1,"
	    "\"nodes\":[{\"name\":\"a\",\"scale\":[2,3,1],\"translation\":[0,0,-2],\"children\":[1]},"
	    "{\"name\":\"a\",\"mesh\":0,\"translation\":[1,0,0],\"rotation\":[0,0.70710678,0,0.70710678],"
	    "\"scale\":[-1,1,1]},"
	    "{\"name\":\"a\",\"mesh\":0,\"matrix\":[0,1,0,0, -1,0,0,0, 0,0,1,0, 5,6,7,1]},"
	    "{\"name\":\"a\",\"camera\":0,\"translation\":[0,0,5]},{\"mesh\":0}]," MESH GLOW REST);
	s = load_well("tree.gltf");
	assert_int_equal(s->ntriangle, 4);
	/* node 2: (x, y, z) to (5 - y, 6 + x, 7 + z) */
	at(corner(s, 0, 0), 5, 6, 7);
	at(corner(s, 0, 1), 5, 7, 7);
	at(corner(s, 0, 2), 4, 7, 7);
	at(s->normal[s->triangle[0].vertex[0]], 0, 0, 1);
	/* node 1: (x, y, 0) to (-x, y, 0), turned to (0, y, x), shifted to (1, y, x), scaled to
	 * (2, 3 y, x - 2); the normal to (1, 0, 0) */
	at(corner(s, 2, 0), 2, 0, -2);
	at(s->normal[s->triangle[2].vertex[0]], 1, 0, 0);
	for (size_t t = 2; t < 4; t++) {
		at(normal(s, t), 1, 0, 0);
		for (int k = 0; k < 3; k++)
			assert_true(fabsf(corner(s, t, k).x - 2) < 1e-6f);
	}
	at(s->low, 2, 0, -2);
	at(s->high, 5, 7, 7);
	gd_scene_free(s);
}

/* Normals go by the inverse transpose: a sphere's become an ellipsoid's. */
static void normals(void **state)
{
	struct square tilted = square;
	struct gd_scene *s;

	(void)state;
	for (int i = 0; i < 4; i++)
		memcpy(tilted.normal[i], (const float[]){ 0.6f, 0, 0.8f }, 12);
	memset(tilted.normal[3], 0, 12);	/* none: the triangle's own */
	put("tilted.bin", &tilted, sizeof(tilted));
	say("tilted.gltf", HEAD SCENE "\"nodes\":[{\"mesh\":0,\"scale\":[3,1,4]},{\"camera\":0}],"
	    MESH GLOW CAMERA ACCESSORS
	    "\"bufferViews\":[{\"buffer\":0,\"byteLength\":140}],"
	    "\"buffers\":[{\"byteLength\":140,\"uri\":\"tilted.bin\"}]}");
	s = load_well("tilted.gltf");
	/* (0.6 / 3, 0, 0.8 / 4) */
	at(s->normal[0], sqrt(0.5), 0, sqrt(0.5));
	at(s->normal[3], 0, 0, 0);
	gd_scene_free(s);
	/* none at all */
	say("flat.gltf", HEAD SCENE NODES
	    "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":3,\"material\":0}]}],"
	    GLOW REST);
	s = load_well("flat.gltf");
	{
		struct gd_hit hit;

		assert_true(gd_ray_hit(s, gd_v3(0.3f, 0.2f, 1), gd_v3(0, 0, -1), &hit));
		at(hit.ns, 0, 0, 1);
	}
	gd_scene_free(s);
}

/* Strips, fans, no indices, indices of all sizes; points and lines are left out. */
static void primitives(void **state)
{
	static const struct {
		float position[5][3];
		uint8_t small[8];
		uint32_t large[6];
	} data = { { { 0, 0, 0 }, { 1, 0, 0 }, { 0, 1, 0 }, { 1, 1, 0 }, { 0, 2, 0 } },
		   { 0, 1, 3, 2, 9, 9, 9, 9 }, { 2, 1, 0, 0, 1, 3 } };
	struct gd_scene *s;

	(void)state;
	put("prim.bin", &data, sizeof(data));
	say("prim.gltf", HEAD SCENE NODES GLOW CAMERA
	    "\"meshes\":[{\"primitives\":["
	    "{\"attributes\":{\"POSITION\":0},\"mode\":5,\"material\":0},"
	    "{\"attributes\":{\"POSITION\":0},\"mode\":0},{\"attributes\":{\"POSITION\":0},\"mode\":3},"
	    "{\"attributes\":{\"POSITION\":0},\"mode\":6,\"indices\":1,\"material\":0},"
	    "{\"attributes\":{\"POSITION\":0},\"indices\":2},"
	    "{\"attributes\":{\"POSITION\":0}}]}],"
	    "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":5,\"type\":\"VEC3\"},"
	    "{\"bufferView\":1,\"componentType\":5121,\"count\":4,\"type\":\"SCALAR\"},"
	    "{\"bufferView\":1,\"byteOffset\":8,\"componentType\":5125,\"count\":6,\"type\":\"SCALAR\"}],"
	    "\"bufferViews\":[{\"buffer\":0,\"byteLength\":60},"
	    "{\"buffer\":0,\"byteOffset\":60,\"byteLength\":32}],"
	    "\"buffers\":[{\"byteLength\":92,\"uri\":\"prim.bin\"}]}");
	s = load_well("prim.gltf");
	noted("2 primitives of points or lines");
	assert_int_equal(nnotes, 1);
	/* 3 of the strip, all facing +z; 2 of the fan; 2 with the wrong and right winding; 1 */
	assert_int_equal(s->ntriangle, 8);
	for (size_t t = 0; t < 8; t++)
		at(normal(s, t), 0, 0, t == 5 ? -1 : 1);
	at(corner(s, 4, 0), 0, 0, 0);
	at(corner(s, 4, 1), 1, 1, 0);
	at(corner(s, 4, 2), 0, 1, 0);
	assert_int_equal(s->triangle[4].material, 0);
	assert_int_equal(s->triangle[7].material, 1);	/* the default one */
	gd_scene_free(s);
}

/* Positions and texture coordinates of few bits; sparse values. */
static void compact(void **state)
{
	static const struct {
		int16_t position[3][4];
		uint8_t uv[3][4];
		uint16_t which[2];
		float value[3];
	} data = { { { 0, 0, 0, 0 }, { 32767, 0, 0, 0 }, { 0, -32767, 0, 0 } },
		   { { 0, 0, 0, 0 }, { 255, 0, 0, 0 }, { 0, 51, 0, 0 } },
		   { 1, 0 }, { 7, 8, 9 } };
	struct gd_scene *s;

	(void)state;
	put("few.bin", &data, sizeof(data));
	say("few.gltf", HEAD "\"extensionsRequired\":[\"KHR_mesh_quantization\"],"
	    SCENE NODES CAMERA
	    "\"materials\":[{\"emissiveFactor\":[1,1,1],\"emissiveTexture\":{\"index\":0}}],"
	    "\"textures\":[{\"source\":0}],\"images\":[{\"uri\":\"grey.png\"}],"
	    "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0,\"TEXCOORD_0\":1},\"material\":0},"
	    "{\"attributes\":{\"POSITION\":2},\"material\":0}]}],"
	    "\"accessors\":[{\"bufferView\":0,\"componentType\":5122,\"normalized\":true,\"count\":3,\"type\":\"VEC3\"},"
	    "{\"bufferView\":1,\"componentType\":5121,\"normalized\":true,\"count\":3,\"type\":\"VEC2\"},"
	    "{\"bufferView\":0,\"componentType\":5122,\"count\":3,\"type\":\"VEC3\",\"normalized\":true,\"sparse\":"
	    "{\"count\":1,\"indices\":{\"bufferView\":2,\"componentType\":5123},"
	    "\"values\":{\"bufferView\":3}}}],"
	    "\"bufferViews\":[{\"buffer\":0,\"byteLength\":24,\"byteStride\":8},"
	    "{\"buffer\":0,\"byteOffset\":24,\"byteLength\":12,\"byteStride\":4},"
	    "{\"buffer\":0,\"byteOffset\":36,\"byteLength\":2},"
	    "{\"buffer\":0,\"byteOffset\":16,\"byteLength\":6}],"
	    "\"buffers\":[{\"byteLength\":52,\"uri\":\"few.bin\"}]}");
	s = load_well("few.gltf");
	at(corner(s, 0, 1), 1, 0, 0);
	at(corner(s, 0, 2), 0, -1, 0);
	if (have_plugin()) {
		assert_true(fabsf(s->uv[2 * s->triangle[0].vertex[1]] - 1) < 1e-6f);
		assert_true(fabsf(s->uv[2 * s->triangle[0].vertex[2] + 1] - 0.2f) < 1e-6f);
	}
	/* the sparse one has the third corner twice: no area */
	assert_int_equal(s->ntriangle, 1);
	noted("1 without area");
	gd_scene_free(s);
}

/* NaN, no area, indices out of range: left out and counted. */
static void bad_triangles(void **state)
{
	static struct {
		float position[6][3];
		uint16_t index[18];
	} data = { { { 0, 0, 0 }, { 1, 0, 0 }, { 0, 1, 0 }, { NAN, 0, 0 }, { 0, 1e30f, 0 }, { 2, 0, 0 } },
		   { 0, 1, 2, 0, 1, 3, 0, 1, 4, 0, 1, 5, 0, 0, 2, 0, 1, 6 } };
	static const char *const text = HEAD SCENE NODES GLOW CAMERA
		"\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":1,\"material\":0}]}],"
		"\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":6,\"type\":\"VEC3\"},"
		"{\"bufferView\":0,\"byteOffset\":72,\"componentType\":5123,\"count\":18,\"type\":\"SCALAR\"}],"
		"\"bufferViews\":[{\"buffer\":0,\"byteLength\":108}],"
		"\"buffers\":[{\"byteLength\":108,\"uri\":\"bad.bin\"}]}";
	struct gd_scene *s;

	(void)state;
	put("bad.bin", &data, sizeof(data));
	say("bad.gltf", "%s", text);
	s = load_well("bad.gltf");
	assert_int_equal(s->ntriangle, 1);
	assert_int_equal(nnotes, 1);
	noted("5 triangles are left out: 1 with an index out of range, 2 with a vertex that is not "
	      "finite or too far away, 2 without area");
	at(s->high, 1, 1, 0);
	gd_scene_free(s);
	/* nothing is left */
	for (int i = 0; i < 18; i++)
		data.index[i] = i % 2 ? 3 : 60000;
	put("bad.bin", &data, sizeof(data));
	refused("bad.gltf", GD_ESHAPE, "no triangles");
	noted("6 with an index out of range");
}

/* --- cameras and lights --- */

static void cameras(void **state)
{
	const struct gd_scene_options wide = { .w = 400, .h = 100, .camera = "side" },
				      by_camera = { .w = 1, .h = 1, .camera = "lens B" },
				      none = { .w = 1, .h = 1, .camera = "else" },
				      open = { .w = 300, .h = 200, .aperture = 0.25f, .focus = 7 };
	struct gd_scene *s;
	struct gd_hit hit;

	(void)state;
	say("cam.gltf", HEAD "\"scenes\":[{\"nodes\":[0,1,2,3,4]}],"
	    "\"nodes\":[{\"mesh\":0},{\"name\":\"front\",\"camera\":0,\"translation\":[0.5,0.5,3]},"
	    "{\"name\":\"side\",\"camera\":1,\"translation\":[4,0.5,-1],"
	    "\"rotation\":[0,0.70710678,0,0.70710678],\"scale\":[2,2,2]},"
	    "{\"name\":\"flat\",\"camera\":2},{\"camera\":1}],"
	    "\"cameras\":[{\"type\":\"perspective\",\"perspective\":{\"yfov\":0.8,\"aspectRatio\":1.5,\"znear\":1}},"
	    "{\"type\":\"perspective\",\"name\":\"lens B\",\"perspective\":{\"yfov\":1.2,\"znear\":1}},"
	    "{\"type\":\"orthographic\",\"orthographic\":{\"xmag\":1,\"ymag\":1,\"znear\":1,\"zfar\":2}}],"
	    MESH GLOW ACCESSORS BUFFERS);
	s = load_well("cam.gltf");
	at(s->view.origin, 0.5, 0.5, 3);
	at(s->view.forward, 0, 0, -1);
	at(s->view.right, 1, 0, 0);
	at(s->view.up, 0, 1, 0);
	assert_true(fabsf(s->view.tan_y - tanf(0.4f)) < 1e-6f);
	assert_true(fabsf(s->view.tan_x - 1.5f * tanf(0.4f)) < 1e-6f);
	/* the corner (1, 1, 0) is at pixel (150 + x, 100 - y) with x = y, both of one size */
	{
		const double f = 0.5 / 3 / tan(0.4);	/* of half the height */
		const double px = 150 + 100 * f, py = 100 - 100 * f;

		for (int i = -1; i <= 1; i += 2) {
			const struct gd_v3 d = gd_unit(gd_mad(
				gd_mad(s->view.forward, (float)(2 * (px + i) / 300 - 1) * s->view.tan_x,
				       s->view.right),
				(float)(1 - 2 * (py - i) / 200) * s->view.tan_y, s->view.up));

			assert_int_equal(gd_ray_hit(s, s->view.origin, d, &hit), i < 0);
		}
	}
	gd_scene_free(s);
	s = load_with("cam.gltf", &wide);
	at(s->view.origin, 4, 0.5, -1);
	at(s->view.forward, -1, 0, 0);
	at(s->view.right, 0, 0, -1);
	at(s->view.up, 0, 1, 0);
	assert_true(fabsf(s->view.tan_y - tanf(0.6f)) < 1e-6f);
	assert_true(fabsf(s->view.tan_x - 4 * tanf(0.6f)) < 1e-5f);
	/* it looks past the square: some focus all the same */
	assert_true(s->view.focus > 3 && s->view.focus < 6);
	gd_scene_free(s);
	s = load_with("cam.gltf", &by_camera);
	at(s->view.origin, 4, 0.5, -1);
	gd_scene_free(s);
	s = load_with("cam.gltf", &open);
	assert_true(s->view.lens == 0.25f && s->view.focus == 7);
	gd_scene_free(s);
	assert_null(load_with("cam.gltf", &none));
	assert_int_equal(err.code, GD_EARG);
	assert_non_null(strstr(err.text, "\"else\""));
	assert_non_null(strstr(err.text, "\"front\", \"side\", \"flat\", \"lens B\""));
}

static void lights(void **state)
{
	struct gd_scene *s;

	(void)state;
	say("lamp.gltf", HEAD "\"extensions\":{\"KHR_lights_punctual\":{\"lights\":["
	    "{\"type\":\"point\",\"color\":[1,0.5,0.25],\"intensity\":8,\"range\":3},"
	    "{\"type\":\"spot\",\"intensity\":2,\"spot\":{\"innerConeAngle\":0.2,\"outerConeAngle\":0.5}},"
	    "{\"type\":\"directional\",\"name\":\"sun\"},{\"type\":\"point\",\"intensity\":0},{\"type\":\"spot\"}]}},"
	    "\"scenes\":[{\"nodes\":[0,1,2,3,5,6,7]}],"
	    "\"nodes\":[{\"mesh\":0},{\"camera\":0,\"translation\":[0,0,5]},"
	    "{\"translation\":[1,2,3],\"extensions\":{\"KHR_lights_punctual\":{\"light\":0}}},"
	    "{\"translation\":[0,9,0],\"rotation\":[-0.70710678,0,0,0.70710678],\"children\":[4]},"
	    "{\"translation\":[0,0,-1],\"scale\":[3,3,3],\"extensions\":{\"KHR_lights_punctual\":{\"light\":1}}},"
	    "{\"translation\":[-1,0,0],\"extensions\":{\"KHR_lights_punctual\":{\"light\":0}}},"
	    "{\"rotation\":[0,1,0,0],\"extensions\":{\"KHR_lights_punctual\":{\"light\":2}}},"
	    "{\"extensions\":{\"KHR_lights_punctual\":{\"light\":3}}}],"
	    "\"materials\":[{}]," MESH REST);
	s = load_well("lamp.gltf");
	assert_int_equal(s->nlight, 4);
	noted("a light that is black or damaged");
	assert_int_equal(s->light[0].kind, GD_POINT);
	at(s->light[0].position, 1, 2, 3);
	at(s->light[0].intensity, 8, 4, 2);
	/* turned by -90 degrees about x: -z looks down */
	assert_int_equal(s->light[1].kind, GD_SPOT);
	at(s->light[1].position, 0, 8, 0);
	at(s->light[1].direction, 0, -1, 0);
	assert_true(fabsf(s->light[1].cos_inner - cosf(0.2f)) < 1e-6f);
	assert_true(fabsf(s->light[1].cos_outer - cosf(0.5f)) < 1e-6f);
	/* the same light at a second node */
	at(s->light[2].position, -1, 0, 0);
	at(s->light[2].intensity, 8, 4, 2);
	assert_int_equal(s->light[3].kind, GD_DIRECTIONAL);
	at(s->light[3].direction, 0, 0, 1);
	at(s->light[3].intensity, 1, 1, 1);
	gd_scene_free(s);
}

/* --- materials and textures --- */

/* Materials are those the file numbers, whatever their names and the order of their use. */
static void materials(void **state)
{
	struct gd_scene *s;

	(void)state;
	say("mat.gltf", HEAD SCENE NODES
	    "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":3,\"material\":2},"
	    "{\"attributes\":{\"POSITION\":0},\"indices\":3,\"material\":1},"
	    "{\"attributes\":{\"POSITION\":0},\"indices\":3},"
	    "{\"attributes\":{\"POSITION\":0},\"indices\":3,\"material\":77}]}],"
	    "\"materials\":[{\"name\":\"x\",\"normalTexture\":{\"index\":0},\"alphaMode\":\"BLEND\"},"
	    "{\"name\":\"x\",\"pbrMetallicRoughness\":{\"baseColorFactor\":[0.1,0.2,0.3,1],"
	    "\"metallicFactor\":0.25,\"roughnessFactor\":0.5},\"emissiveFactor\":[1,0.5,0.25],"
	    "\"extensions\":{\"KHR_materials_emissive_strength\":{\"emissiveStrength\":12}}},"
	    "{\"name\":\"x\",\"pbrMetallicRoughness\":{\"metallicFactor\":-3,\"roughnessFactor\":1e9,"
	    "\"baseColorFactor\":[2,-1,0.5,1]},\"extensions\":{\"KHR_materials_transmission\":"
	    "{\"transmissionFactor\":0.75},\"KHR_materials_ior\":{\"ior\":1.33},"
	    "\"KHR_materials_clearcoat\":{\"clearcoatFactor\":1},"
	    "\"KHR_materials_sheen\":{}}}],\"animations\":[{}]," REST);
	s = load_well("mat.gltf");
	assert_int_equal(s->nmaterial, 4);
	assert_int_equal(nnotes, 1);
	noted("not modelled and left out: normal maps, alpha, clearcoat, sheen, animations");
	assert_int_equal(s->triangle[0].material, 2);
	assert_int_equal(s->triangle[2].material, 1);
	assert_int_equal(s->triangle[4].material, 3);
	assert_int_equal(s->triangle[6].material, 3);
	at(s->material[1].base, 0.1, 0.2, 0.3);
	at(s->material[1].emission, 12, 6, 3);
	assert_true(s->material[1].metallic == 0.25f && s->material[1].roughness == 0.5f);
	assert_true(s->material[1].transmission == 0 && s->material[1].ior == 1.5f);
	at(s->material[2].base, 1, 0, 0.5);
	assert_true(s->material[2].metallic == 0 && s->material[2].roughness == 1);
	assert_true(s->material[2].transmission == 0.75f && s->material[2].ior == 1.33f);
	/* glTF's defaults */
	at(s->material[3].base, 1, 1, 1);
	assert_true(s->material[3].metallic == 1 && s->material[3].roughness == 1);
	assert_true(gd_black(s->material[3].emission) && gd_black(s->material[0].emission));
	assert_int_equal(s->material[3].base_map, GD_NO_INDEX);
	assert_int_equal(s->nlight, 2);
	gd_scene_free(s);
}

static double linear(double v)
{
	return v <= 0.04045 ? v / 12.92 : pow((v + 0.055) / 1.055, 2.4);
}

/* Colours are linearised, numbers are not; both from the same PNG of every 8-bit level. */
static void colour_or_data(void **state)
{
	unsigned char level[256][3];
	uint16_t fine[1024][3];
	struct gd_scene *s;
	const struct gd_texture *t;

	(void)state;
	need_plugin();
	for (int i = 0; i < 256; i++)
		for (int k = 0; k < 3; k++)
			level[i][k] = (unsigned char)(k == 1 ? i : k == 2 ? 255 - i : i / 2);
	for (int i = 0; i < 1024; i++)
		for (int k = 0; k < 3; k++)
			fine[i][k] = (uint16_t)(k == 1 ? 64 * i + 7 : i);
	put_png("all levels.png", level, 16, 16, 3, 8);
	put_png("fine.png", fine, 32, 32, 3, 16);
	say("map.gltf", HEAD SCENE NODES MESH
	    "\"materials\":[{\"emissiveFactor\":[1,1,1],\"pbrMetallicRoughness\":{"
	    "\"baseColorTexture\":{\"index\":0},\"metallicRoughnessTexture\":{\"index\":0}}},"
	    "{\"pbrMetallicRoughness\":{\"metallicRoughnessTexture\":{\"index\":1},\"baseColorTexture\":{\"index\":2}}}],"
	    "\"textures\":[{\"source\":0,\"sampler\":0},{\"source\":1},{\"source\":1,\"sampler\":1}],"
	    "\"samplers\":[{\"wrapS\":33071},{\"wrapT\":33071}],"
	    "\"images\":[{\"uri\":\"all%%20levels.png\"},{\"uri\":\"fine.png\"}]," REST);
	s = load_well("map.gltf");
	assert_int_equal(nnotes, 0);
	assert_int_equal(s->ntexture, 4);
	t = &s->texture[s->material[0].base_map];
	assert_true(t->w == 16 && t->h == 16 && t->clamp_u && !t->clamp_v);
	for (int i = 0; i < 256; i++)
		for (int k = 0; k < 3; k++)
			assert_true(fabs((double)t->rgb[3 * i + k] - linear(level[i][k] / 255.)) <
				    1e-6);
	t = &s->texture[s->material[0].rough_map];
	for (int i = 0; i < 256; i++)
		for (int k = 0; k < 3; k++)
			assert_true(t->rgb[3 * i + k] == (float)level[i][k] / 255);
	t = &s->texture[s->material[1].rough_map];
	assert_true(!t->clamp_u && !t->clamp_v);
	for (int i = 0; i < 1024; i++)
		for (int k = 0; k < 3; k++)
			assert_true(t->rgb[3 * i + k] == (float)fine[i][k] / 65535);
	t = &s->texture[s->material[1].base_map];
	assert_true(!t->clamp_u && t->clamp_v);
	for (int i = 0; i < 1024; i++)
		assert_true(fabs((double)t->rgb[3 * i + 1] - linear(fine[i][1] / 65535.)) < 1e-6);
	/* the top left corner of the image is at uv 0 0: the square's corner (0, 1, 0) */
	assert_true(s->uv[2 * 3] == 0 && s->uv[2 * 3 + 1] == 0);
	assert_true(s->uv[2 * 0] == 0 && s->uv[2 * 0 + 1] == 1);
	gd_scene_free(s);
}

static void base64(char *to, const unsigned char *from, size_t n)
{
	static const char digit[] =
		"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

	for (size_t i = 0; i < n; i += 3) {
		const unsigned w = (unsigned)from[i] << 16 |
				   (i + 1 < n ? (unsigned)from[i + 1] << 8 : 0) |
				   (i + 2 < n ? (unsigned)from[i + 2] : 0);

		*to++ = digit[w >> 18];
		*to++ = digit[w >> 12 & 63];
		*to++ = i + 1 < n ? digit[w >> 6 & 63] : '=';
		*to++ = i + 2 < n ? digit[w & 63] : '=';
	}
	*to = '\0';
}

/* A .glb of a JSON text and a binary chunk; returns its size. */
static size_t make_glb(unsigned char *to, const char *json, const void *bin, size_t bin_size)
{
	const size_t text = (strlen(json) + 3) / 4 * 4, data = (bin_size + 3) / 4 * 4;
	const uint32_t head[5] = { 0x46546c67, 2, (uint32_t)(12 + 8 + text + 8 + data),
				   (uint32_t)text, 0x4e4f534a };
	const uint32_t chunk[2] = { (uint32_t)data, 0x004e4942 };

	memcpy(to, head, 20);
	memset(to + 20, ' ', text);
	memcpy(to + 20, json, strlen(json));
	memcpy(to + 20 + text, chunk, 8);
	memset(to + 28 + text, 0, data);
	memcpy(to + 28 + text, bin, bin_size);
	return 28 + text + data;
}

/* Grey and RGBA images; inside a data: URI, a buffer view, a .glb. */
static void embedded(void **state)
{
	const unsigned char grey[4] = { 0, 64, 128, 255 };
	const unsigned char red[3] = { 255, 0, 51 };
	static unsigned char bin[4096], glb[16384];
	static char text[16384], png64[4096];
	struct gd_scene *s;
	unsigned char *png;
	size_t size;

	(void)state;
	need_plugin();
	png = make_png(&size, grey, 2, 2, 1, 8);
	base64(png64, png, size);
	free(png);
	png = make_png(&size, red, 1, 1, 3, 8);
	memcpy(bin, &square, 140);
	memcpy(bin + 140, png, size);
	free(png);
	snprintf(text, sizeof(text), HEAD SCENE NODES MESH
		 "\"materials\":[{\"emissiveFactor\":[1,1,1],\"pbrMetallicRoughness\":{"
		 "\"baseColorTexture\":{\"index\":0},\"metallicRoughnessTexture\":{\"index\":1}}}],"
		 "\"textures\":[{\"source\":0},{\"source\":1}],"
		 "\"images\":[{\"uri\":\"data:image/png;base64,%s\"},{\"bufferView\":1,\"mimeType\":\"image/png\"}],"
		 CAMERA ACCESSORS "\"bufferViews\":[{\"buffer\":0,\"byteLength\":140},"
		 "{\"buffer\":0,\"byteOffset\":140,\"byteLength\":%zu}],"
		 "\"buffers\":[{\"byteLength\":%zu}]}", png64, size, size + 140);
	put("inside.glb", glb, make_glb(glb, text, bin, size + 140));
	s = load_well("inside.glb");
	assert_int_equal(nnotes, 0);
	assert_int_equal(s->ntriangle, 2);
	at(corner(s, 1, 2), 0, 1, 0);
	assert_int_equal(s->ntexture, 2);
	for (int i = 0; i < 4; i++)
		for (int k = 0; k < 3; k++)
			assert_true(fabs((double)s->texture[0].rgb[3 * i + k] -
					 linear(grey[i] / 255.)) < 1e-6);
	at(gd_v3(s->texture[1].rgb[0], s->texture[1].rgb[1], s->texture[1].rgb[2]), 1, 0, 0.2);
	gd_scene_free(s);
	/* every shorter file: an error, never a crash */
	for (size_t n = make_glb(glb, text, bin, size + 140), i = 0; i < n; i += i < 40 ? 1 : 61) {
		put("cut.glb", glb, i);
		assert_null(load("cut.glb"));
	}
}

static void texture_transform(void **state)
{
	struct gd_scene *s;

	(void)state;
	need_plugin();
	say("move.gltf", HEAD SCENE NODES MESH
	    "\"materials\":[{\"emissiveFactor\":[1,1,1],\"emissiveTexture\":{\"index\":0,\"extensions\":"
	    "{\"KHR_texture_transform\":{\"offset\":[0,1],\"rotation\":1.57079632679,\"scale\":[0.5,0.25]}}}}],"
	    "\"textures\":[{\"source\":0}],\"images\":[{\"uri\":\"grey.png\"}]," REST);
	s = load_well("move.gltf");
	assert_int_equal(nnotes, 0);
	/* scaled, turned by 90 degrees, shifted: (u, v) to (v / 4, 1 - u / 2) */
	for (int i = 0; i < 4; i++) {
		assert_true(fabsf(s->uv[2 * i] - square.uv[i][1] / 4) < 1e-6f);
		assert_true(fabsf(s->uv[2 * i + 1] - (1 - square.uv[i][0] / 2)) < 1e-6f);
	}
	gd_scene_free(s);
}

/* A texture that is missing or damaged, or no plug-in: a note, and the factor alone. */
static void missing_textures(void **state)
{
	struct gd_scene *s;
	char *path = getenv("GD_PLUGIN_PATH");

	(void)state;
	path = path ? strdup(path) : NULL;
	say("torn.png", "no image at all");
	say("lost.gltf", HEAD SCENE NODES MESH
	    "\"materials\":[{\"emissiveFactor\":[1,1,1],\"pbrMetallicRoughness\":{"
	    "\"baseColorFactor\":[0.5,0.5,0.5,1],"
	    "\"baseColorTexture\":{\"index\":0},\"metallicRoughnessTexture\":{\"index\":1}},"
	    "\"emissiveTexture\":{\"index\":99}},"
	    "{\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":2},\"metallicRoughnessTexture\":{}}}],"
	    "\"textures\":[{\"source\":0},{\"source\":1},{}],"
	    "\"images\":[{\"uri\":\"nowhere.png\"},{\"uri\":\"torn.png\"}]," REST);
	if (have_plugin()) {
		s = load_well("lost.gltf");
		assert_int_equal(s->ntexture, 0);
		assert_int_equal(s->material[0].base_map, GD_NO_INDEX);
		assert_int_equal(s->material[0].emission_map, GD_NO_INDEX);
		at(s->material[0].base, 0.5, 0.5, 0.5);
		noted("nowhere.png");
		noted("torn.png");
		noted("4 more textures are left out");
		assert_int_equal(nnotes, 6);
		gd_scene_free(s);
	}
	setenv("GD_PLUGIN_PATH", "/nonexistent", 1);
	s = load_well("lost.gltf");
	assert_int_equal(s->ntexture, 0);
	noted("textures are left out: needs the OpenImageIO plug-in");
	gd_scene_free(s);
	if (path)
		setenv("GD_PLUGIN_PATH", path, 1);
	else
		unsetenv("GD_PLUGIN_PATH");
	free(path);
}

/* Relative names start at the glTF's folder, not where the program stands. */
static void elsewhere(void **state)
{
	char here[1000], inside[400];
	struct gd_scene *s;

	(void)state;
	assert_non_null(getcwd(here, sizeof(here)));
	assert_int_equal(mkdir(path_of("sub"), 0700), 0);
	say("sub/up.gltf", HEAD SCENE NODES MESH GLOW CAMERA ACCESSORS
	    "\"bufferViews\":[{\"buffer\":0,\"byteLength\":140}],"
	    "\"buffers\":[{\"byteLength\":140,\"uri\":\"../square.bin\"}]}");
	s = load_well("sub/up.gltf");
	gd_scene_free(s);
	assert_int_equal(chdir(path_of("sub")), 0);
	s = load_well("./up.gltf");
	gd_scene_free(s);
	snprintf(inside, sizeof(inside), "../sub/up.gltf");
	s = load_well(inside);
	gd_scene_free(s);
	assert_int_equal(chdir(here), 0);
}

/* --- environments --- */

static void environment_file(void **state)
{
	struct gd_image im = { 0 };
	struct gd_plane p[3];
	struct gd_scene_options o = { .w = 3, .h = 2, .environment = path_of("sky.exr") };
	struct gd_scene *s;

	(void)state;
	gd_image_init(&im, 4, 2);
	for (int k = 0; k < 3; k++)
		assert_int_equal(gd_image_add(&im, (const char *[]){ "R", "G", "B" }[k], &p[k], NULL),
				 GD_OK);
	for (int y = 0; y < 2; y++)
		for (int x = 0; x < 4; x++)
			for (int k = 0; k < 3; k++)
				gd_row(p[k], y)[x] = (float)(4 * y + x + 10 * k);
	gd_row(p[0], 0)[1] = NAN;
	gd_row(p[1], 1)[2] = -5;
	gd_row(p[2], 1)[3] = INFINITY;
	assert_int_equal(gd_exr_write(&im, o.environment, NULL, NULL), GD_OK);
	gd_image_free(&im);
	say("dark.gltf", HEAD SCENE NODES MESH REST);
	s = load_with("dark.gltf", &o);
	if (!s)
		fail_msg("%s", err.text);
	noted("3 numbers that are negative, not finite or above 1e30");
	assert_true(s->environment.w == 4 && s->environment.h == 2);
	assert_true(s->environment.rgb[3 * 1] == 0 && s->environment.rgb[3 * 1 + 1] == 11);
	assert_true(s->environment.rgb[3 * 6 + 1] == 0 && s->environment.rgb[3 * 7 + 2] == 0);
	assert_true(s->environment.rgb[3 * 6 + 2] == 26);
	assert_int_equal(s->environment_light, 0);
	gd_scene_free(s);
	o.environment = NULL;
	o.sky = gd_v3(1, 2, 3);
	s = load_with("dark.gltf", &o);
	assert_true(s->nlight == 1 && s->light[0].kind == GD_ENVIRONMENT);
	gd_scene_free(s);
	o.environment = path_of("nosuch.exr");
	assert_null(load_with("dark.gltf", &o));
	assert_int_equal(err.code, GD_EARG);	/* both */
	o.sky = gd_v3(0, 0, 0);
	assert_null(load_with("dark.gltf", &o));
	assert_int_equal(err.code, GD_EIO);
	assert_non_null(strstr(err.text, "nosuch.exr"));
	o.environment = NULL;
	o.sky.y = NAN;
	assert_null(load_with("dark.gltf", &o));
	assert_int_equal(err.code, GD_EARG);
	o.sky.y = 2e30f;
	assert_null(load_with("dark.gltf", &o));
	assert_string_equal(err.text, "the sky's radiance is 0 2e+30 0, wanted 0 to 1e+30");
}

/* --- what cannot be loaded --- */

static void refusals(void **state)
{
	(void)state;
	refused("nowhere.gltf", GD_EIO, "No such file");
	refused("", GD_EIO, "directory");
	say("empty.gltf", "%s", "");
	refused("empty.gltf", GD_EFORMAT, "not a glTF file");
	say("text.gltf", "Hello, world\n");
	refused("text.gltf", GD_EFORMAT, "not a glTF file");
	say("json.gltf", "{\"a\":1}");
	refused("json.gltf", GD_EFORMAT, "not a glTF file");
	say("half.gltf", HEAD "\"scenes\":[{\"nodes\":[0");
	refused("half.gltf", GD_EFORMAT, "damaged JSON near byte");
	say("old.gltf", "{\"asset\":{\"version\":\"1.0\"}}");
	refused("old.gltf", GD_EFORMAT, "glTF 1.0, wanted 2");
	say("bare.gltf", "{\"asset\":{\"version\":\"2.0\"}}");
	refused("bare.gltf", GD_ESHAPE, "no triangles");
	say("need.gltf", HEAD "\"extensionsRequired\":[\"EXT_meshopt_compression\"]," SCENE NODES MESH
	    GLOW REST);
	refused("need.gltf", GD_EFORMAT, "EXT_meshopt_compression");
	say("blind.gltf", HEAD "\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"mesh\":0}]," MESH GLOW REST);
	refused("blind.gltf", GD_ESHAPE, "no camera");
	say("dark.gltf", HEAD SCENE NODES MESH REST);
	refused("dark.gltf", GD_ESHAPE, "no light");
	say("fov.gltf", HEAD SCENE NODES MESH GLOW
	    "\"cameras\":[{\"type\":\"perspective\",\"perspective\":{\"yfov\":4}}]," ACCESSORS BUFFERS);
	refused("fov.gltf", GD_EFORMAT, "field of view");
	say("ring.gltf", HEAD SCENE "\"nodes\":[{\"mesh\":0,\"children\":[2]},{\"camera\":0},{\"children\":[0]}],"
	    MESH GLOW REST);
	refused("ring.gltf", GD_EFORMAT, "twice");
	say("child.gltf", HEAD SCENE "\"nodes\":[{\"mesh\":0,\"children\":[7]},{\"camera\":0}]," MESH GLOW
	    REST);
	refused("child.gltf", GD_EFORMAT, "does not exist");
	say("matrix.gltf", HEAD SCENE "\"nodes\":[{\"mesh\":0,\"matrix\":[1,2]},{\"camera\":0}]," MESH
	    GLOW REST);
	refused("matrix.gltf", GD_EFORMAT, "the matrix of node 0");
	say("nobin.gltf", HEAD SCENE NODES MESH GLOW CAMERA ACCESSORS
	    "\"bufferViews\":[{\"buffer\":0,\"byteLength\":140}],"
	    "\"buffers\":[{\"byteLength\":140,\"uri\":\"nosuch.bin\"}]}");
	{
		struct gd_scene *s = load("nobin.gltf");

		assert_null(s);
		assert_int_equal(err.code, GD_EIO);
		assert_non_null(strstr(err.text, "nosuch.bin"));
	}
	put("short.bin", &square, 100);
	say("short.gltf", HEAD SCENE NODES MESH GLOW CAMERA ACCESSORS
	    "\"bufferViews\":[{\"buffer\":0,\"byteLength\":140}],"
	    "\"buffers\":[{\"byteLength\":140,\"uri\":\"short.bin\"}]}");
	refused("short.gltf", GD_EFORMAT, "short.bin has 100 bytes, wanted 140");
	say("base.gltf", HEAD SCENE NODES MESH GLOW CAMERA ACCESSORS
	    "\"bufferViews\":[{\"buffer\":0,\"byteLength\":140}],"
	    "\"buffers\":[{\"byteLength\":140,\"uri\":\"data:application/octet-stream;base64,AA*A\"}]}");
	refused("base.gltf", GD_EFORMAT, "not base64");
}

/* Counts and offsets that do not fit, one at a time. */
static void wrong_numbers(void **state)
{
	static const struct {
		const char *accessor, *view;
	} wrong[] = {
		{ "\"bufferView\":0,\"count\":5000", "" },
		{ "\"bufferView\":0,\"count\":1e18", "" },
		{ "\"bufferView\":0,\"count\":4294967295", "" },
		{ "\"bufferView\":0,\"count\":-4", "" },
		{ "\"bufferView\":0,\"count\":3.5", "" },
		{ "\"bufferView\":0,\"count\":0", "" },
		{ "\"bufferView\":0,\"count\":\"4\"", "" },
		{ "\"bufferView\":9,\"count\":4", "" },
		{ "\"bufferView\":-1,\"count\":4", "" },
		{ "\"count\":4", "" },
		{ "\"bufferView\":0,\"count\":4,\"byteOffset\":139", "" },
		{ "\"bufferView\":0,\"count\":4,\"byteOffset\":1e17", "" },
		{ "\"bufferView\":0,\"count\":4", ",\"byteOffset\":9007199254740991" },
		{ "\"bufferView\":0,\"count\":4", ",\"byteOffset\":100" },
		{ "\"bufferView\":0,\"count\":4", ",\"byteStride\":4" },
		{ "\"bufferView\":0,\"count\":4", ",\"byteStride\":1000000" },
		{ "\"bufferView\":0,\"count\":4", ",\"buffer\":3" },
		{ "\"bufferView\":0,\"count\":4,\"sparse\":{\"count\":1}", "" },
		{ "\"bufferView\":0,\"count\":4,\"sparse\":{\"count\":1,\"indices\":{\"bufferView\":0,"
		  "\"componentType\":5125,\"byteOffset\":12},\"values\":{\"bufferView\":0}}", "" },
	};

	(void)state;
	for (size_t i = 0; i < sizeof(wrong) / sizeof(*wrong); i++) {
		say("wrong.gltf", HEAD SCENE NODES GLOW CAMERA
		    "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0}}]}],"
		    "\"accessors\":[{%s,\"componentType\":5126,\"type\":\"VEC3\"}],"
		    "\"bufferViews\":[{\"byteLength\":140%s%s}],"
		    "\"buffers\":[{\"byteLength\":140,\"uri\":\"square.bin\"}]}", wrong[i].accessor,
		    wrong[i].view, strstr(wrong[i].view, "buffer\"") ? "" : ",\"buffer\":0");
		if (load("wrong.gltf") || err.code != GD_EFORMAT)
			fail_msg("case %zu: %d %s", i, err.code, err.text);
		assert_non_null(strstr(err.text, "wrong.gltf"));
	}
}

/* Compressed geometry that is none. */
static void draco(void **state)
{
	(void)state;
	for (int view = 0; view < 2; view++) {
		say("draco.gltf", HEAD "\"extensionsRequired\":[\"KHR_draco_mesh_compression\"]," SCENE
		    NODES GLOW CAMERA
		    "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":1,"
		    "\"extensions\":{\"KHR_draco_mesh_compression\":{\"bufferView\":%d,"
		    "\"attributes\":{\"POSITION\":0}}}}]}],"
		    "\"accessors\":[{\"componentType\":5126,\"count\":4,\"type\":\"VEC3\"},"
		    "{\"componentType\":5123,\"count\":6,\"type\":\"SCALAR\"}]," BUFFERS, view);
		refused("draco.gltf", GD_EFORMAT, view ? "no buffer view 1" : "raco");
	}
}

/* Nodes within nodes, deeper than any stack likes. */
static void deep(void **state)
{
	enum { N = 60000 };
	char *text = malloc(64 * N), *p = text;
	FILE *f;

	(void)state;
	p += sprintf(p, HEAD "\"scenes\":[{\"nodes\":[0]}],\"nodes\":[");
	for (int i = 0; i < N; i++)
		p += sprintf(p, "{\"children\":[%d]},", i + 1);
	sprintf(p, "{\"mesh\":0}]," MESH GLOW REST);
	f = fopen(path_of("deep.gltf"), "w");
	fputs(text, f);
	fclose(f);
	refused("deep.gltf", GD_EFORMAT, "levels of nodes");
	p = text + sprintf(text, "{\"asset\":");
	for (int i = 0; i < N; i++)
		*p++ = '[';
	*p = '\0';
	f = fopen(path_of("nest.gltf"), "w");
	fputs(text, f);
	fclose(f);
	refused("nest.gltf", GD_EFORMAT, "damaged JSON");
	free(text);
}

#ifndef MUTANTS
#define MUTANTS 200
#endif

/* Bytes changed at random: loaded or refused, never a crash, and not a word to the terminal. */
static void mutations(void **state)
{
	static const char text[] = HEAD SCENE NODES MESH GLOW REST;
	static char copy[sizeof(text)];
	static const char *const piece[] = { "-1", "1e99", "[]", "{}", "null", "\"\"", "99999999999",
					     "0", "5", "\"x\":", "," };
	int out = dup(1), errors = dup(2), file = open(path_of("said"), O_CREAT | O_RDWR, 0600);
	int good = 0;

	(void)state;
	assert_true(out >= 0 && errors >= 0 && file >= 0);
	fflush(NULL);
	dup2(file, 1);
	dup2(file, 2);
	scene_seed = 11;
	for (int i = 0; i < MUTANTS; i++) {
		struct gd_scene *s;

		memcpy(copy, text, sizeof(text));
		for (int k = 0; k <= i % 3; k++) {
			const size_t where = (size_t)(rnd() * (sizeof(text) - 1));

			if (i % 2) {
				copy[where] = (char)(32 + 95 * rnd());
			} else {
				const char *v = piece[(int)(rnd() * 11)];
				/* a number or name is replaced as far as there is room */
				const size_t n = strlen(v);

				if (where + n < sizeof(text) - 1)
					memcpy(copy + where, v, n);
			}
		}
		put("mutant.gltf", copy, strlen(copy));
		s = load("mutant.gltf");
		good += s != NULL;
		gd_scene_free(s);
	}
	fflush(NULL);
	dup2(out, 1);
	dup2(errors, 2);
	close(out);
	close(errors);
	assert_int_equal(lseek(file, 0, SEEK_END), 0);
	close(file);
	assert_in_range(good, 5, MUTANTS - 5);
}

static int make_folder(void **state)
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

static int remove_folder(void **state)
{
	char command[100];

	(void)state;
	snprintf(command, sizeof(command), "rm -r %s", folder);
	return system(command);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(plain),	  cmocka_unit_test(transforms),
		cmocka_unit_test(normals),	  cmocka_unit_test(primitives),
		cmocka_unit_test(compact),	  cmocka_unit_test(bad_triangles),
		cmocka_unit_test(cameras),	  cmocka_unit_test(lights),
		cmocka_unit_test(materials),	  cmocka_unit_test(colour_or_data),
		cmocka_unit_test(embedded),	  cmocka_unit_test(texture_transform),
		cmocka_unit_test(missing_textures), cmocka_unit_test(elsewhere),
		cmocka_unit_test(environment_file), cmocka_unit_test(refusals),
		cmocka_unit_test(wrong_numbers),  cmocka_unit_test(draco),
		cmocka_unit_test(deep),
		cmocka_unit_test(mutations),
	};

	return cmocka_run_group_tests_name("gltf", tests, make_folder, remove_folder);
}
