/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Textures of glTF, from files and from inside, names, and environments. Textures need the plug-in:
 * skipped, and said so, without.
 */
#include "gltf_make.h"

#include <sys/stat.h>

#include "exr.h"

/* --- textures --- */

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
	    "{\"pbrMetallicRoughness\":{\"metallicRoughnessTexture\":{\"index\":1},"
	    "\"baseColorTexture\":{\"index\":2}}}],"
	    "\"textures\":[{\"source\":0,\"sampler\":0},{\"source\":1},{\"source\":1,"
	    "\"sampler\":1}],"
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
		 "\"images\":[{\"uri\":\"data:image/png;base64,%s\"},{\"bufferView\":1,"
		 "\"mimeType\":\"image/png\"}],"
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
	    "\"materials\":[{\"emissiveFactor\":[1,1,1],\"emissiveTexture\":{\"index\":0,"
	    "\"extensions\":"
	    "{\"KHR_texture_transform\":{\"offset\":[0,1],\"rotation\":1.57079632679,"
	    "\"scale\":[0.5,0.25]}}}}],"
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
	    "{\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":2},"
	    "\"metallicRoughnessTexture\":{}}}],"
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
		assert_int_equal(gd_image_add(&im, (char[2]){ "RGB"[k] }, &p[k], NULL), GD_OK);
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

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(colour_or_data),
		cmocka_unit_test(embedded),
		cmocka_unit_test(texture_transform),
		cmocka_unit_test(missing_textures),
		cmocka_unit_test(elsewhere),
		cmocka_unit_test(environment_file),
	};

	return cmocka_run_group_tests_name("gltf textures", tests, make_folder, remove_folder);
}
