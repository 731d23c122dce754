/* SPDX-License-Identifier: BSD-3-Clause */
/* Loading glTF: places, cameras, lights and materials against what was written by hand. */
#include "gltf_make.h"

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
	    "\"nodes\":[{\"name\":\"a\",\"scale\":[2,3,1],\"translation\":[0,0,-2],"
	    "\"children\":[1]},"
	    "{\"name\":\"a\",\"mesh\":0,\"translation\":[1,0,0],"
	    "\"rotation\":[0,0.70710678,0,0.70710678],\"scale\":[-1,1,1]},"
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
	    "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":3,"
	    "\"material\":0}]}],"
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
	    "{\"attributes\":{\"POSITION\":0},\"mode\":0},{\"attributes\":{\"POSITION\":0},"
	    "\"mode\":3},"
	    "{\"attributes\":{\"POSITION\":0},\"mode\":6,\"indices\":1,\"material\":0},"
	    "{\"attributes\":{\"POSITION\":0},\"indices\":2},"
	    "{\"attributes\":{\"POSITION\":0}}]}],"
	    "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":5,"
	    "\"type\":\"VEC3\"},"
	    "{\"bufferView\":1,\"componentType\":5121,\"count\":4,\"type\":\"SCALAR\"},"
	    "{\"bufferView\":1,\"byteOffset\":8,\"componentType\":5125,\"count\":6,"
	    "\"type\":\"SCALAR\"}],"
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
	    "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0,\"TEXCOORD_0\":1},"
	    "\"material\":0},"
	    "{\"attributes\":{\"POSITION\":2},\"material\":0}]}],"
	    "\"accessors\":[{\"bufferView\":0,\"componentType\":5122,\"normalized\":true,"
	    "\"count\":3,\"type\":\"VEC3\"},"
	    "{\"bufferView\":1,\"componentType\":5121,\"normalized\":true,\"count\":3,"
	    "\"type\":\"VEC2\"},"
	    "{\"bufferView\":0,\"componentType\":5122,\"count\":3,\"type\":\"VEC3\","
	    "\"normalized\":true,\"sparse\":"
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
	} data = { { { 0, 0, 0 }, { 1, 0, 0 }, { 0, 1, 0 },
		     { NAN, 0, 0 }, { 0, 1e30f, 0 }, { 2, 0, 0 } },
		   { 0, 1, 2, 0, 1, 3, 0, 1, 4, 0, 1, 5, 0, 0, 2, 0, 1, 6 } };
	static const char *const text = HEAD SCENE NODES GLOW CAMERA
		"\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":1,"
		"\"material\":0}]}],"
		"\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":6,"
		"\"type\":\"VEC3\"},"
		"{\"bufferView\":0,\"byteOffset\":72,\"componentType\":5123,\"count\":18,"
		"\"type\":\"SCALAR\"}],"
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
	    "\"cameras\":[{\"type\":\"perspective\",\"perspective\":{\"yfov\":0.8,"
	    "\"aspectRatio\":1.5,\"znear\":1}},"
	    "{\"type\":\"perspective\",\"name\":\"lens B\",\"perspective\":{\"yfov\":1.2,"
	    "\"znear\":1}},"
	    "{\"type\":\"orthographic\",\"orthographic\":{\"xmag\":1,\"ymag\":1,\"znear\":1,"
	    "\"zfar\":2}}],"
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
			const float x = (float)(2 * (px + i) / 300 - 1) * s->view.tan_x;
			const float y = (float)(1 - 2 * (py - i) / 200) * s->view.tan_y;
			const struct gd_v3 d = gd_unit(gd_mad(
				gd_mad(s->view.forward, x, s->view.right), y, s->view.up));

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
	    "{\"type\":\"spot\",\"intensity\":2,\"spot\":{\"innerConeAngle\":0.2,"
	    "\"outerConeAngle\":0.5}},"
	    "{\"type\":\"directional\",\"name\":\"sun\"},{\"type\":\"point\",\"intensity\":0},"
	    "{\"type\":\"spot\"}]}},"
	    "\"scenes\":[{\"nodes\":[0,1,2,3,5,6,7]}],"
	    "\"nodes\":[{\"mesh\":0},{\"camera\":0,\"translation\":[0,0,5]},"
	    "{\"translation\":[1,2,3],\"extensions\":{\"KHR_lights_punctual\":{\"light\":0}}},"
	    "{\"translation\":[0,9,0],\"rotation\":[-0.70710678,0,0,0.70710678],\"children\":[4]},"
	    "{\"translation\":[0,0,-1],\"scale\":[3,3,3],"
	    "\"extensions\":{\"KHR_lights_punctual\":{\"light\":1}}},"
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
	    "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":3,"
	    "\"material\":2},"
	    "{\"attributes\":{\"POSITION\":0},\"indices\":3,\"material\":1},"
	    "{\"attributes\":{\"POSITION\":0},\"indices\":3},"
	    "{\"attributes\":{\"POSITION\":0},\"indices\":3,\"material\":77}]}],"
	    "\"materials\":[{\"name\":\"x\",\"normalTexture\":{\"index\":0},"
	    "\"alphaMode\":\"BLEND\"},"
	    "{\"name\":\"x\",\"pbrMetallicRoughness\":{\"baseColorFactor\":[0.1,0.2,0.3,1],"
	    "\"metallicFactor\":0.25,\"roughnessFactor\":0.5},\"emissiveFactor\":[1,0.5,0.25],"
	    "\"extensions\":{\"KHR_materials_emissive_strength\":{\"emissiveStrength\":12}}},"
	    "{\"name\":\"x\",\"pbrMetallicRoughness\":{\"metallicFactor\":-3,"
	    "\"roughnessFactor\":1e9,"
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

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(plain),
		cmocka_unit_test(transforms),
		cmocka_unit_test(normals),
		cmocka_unit_test(primitives),
		cmocka_unit_test(compact),
		cmocka_unit_test(bad_triangles),
		cmocka_unit_test(cameras),
		cmocka_unit_test(lights),
		cmocka_unit_test(materials),
	};

	return cmocka_run_group_tests_name("gltf", tests, make_folder, remove_folder);
}
