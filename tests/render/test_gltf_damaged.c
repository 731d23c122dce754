/* SPDX-License-Identifier: BSD-3-Clause */
/* glTF that cannot be loaded, and files that are damaged in all manner of ways. */
#include "gltf_make.h"

#include <fcntl.h>

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
	say("need.gltf", HEAD "\"extensionsRequired\":[\"EXT_meshopt_compression\"],"
	    SCENE NODES MESH GLOW REST);
	refused("need.gltf", GD_EFORMAT, "EXT_meshopt_compression");
	say("blind.gltf", HEAD "\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"mesh\":0}],"
	    MESH GLOW REST);
	refused("blind.gltf", GD_ESHAPE, "no camera");
	say("dark.gltf", HEAD SCENE NODES MESH REST);
	refused("dark.gltf", GD_ESHAPE, "no light");
	say("fov.gltf", HEAD SCENE NODES MESH GLOW
	    "\"cameras\":[{\"type\":\"perspective\",\"perspective\":{\"yfov\":4}}],"
	    ACCESSORS BUFFERS);
	refused("fov.gltf", GD_EFORMAT, "field of view");
	say("ring.gltf", HEAD SCENE "\"nodes\":[{\"mesh\":0,\"children\":[2]},{\"camera\":0},"
	    "{\"children\":[0]}],"
	    MESH GLOW REST);
	refused("ring.gltf", GD_EFORMAT, "twice");
	say("child.gltf", HEAD SCENE "\"nodes\":[{\"mesh\":0,\"children\":[7]},{\"camera\":0}],"
	    MESH GLOW REST);
	refused("child.gltf", GD_EFORMAT, "does not exist");
	say("matrix.gltf", HEAD SCENE "\"nodes\":[{\"mesh\":0,\"matrix\":[1,2]},{\"camera\":0}],"
	    MESH GLOW REST);
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
	    "\"buffers\":[{\"byteLength\":140,\"uri\":\"data:application/octet-stream;base64,"
	    "AA*A\"}]}");
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
		{ "\"bufferView\":0,\"count\":4,\"sparse\":{\"count\":1,"
		  "\"indices\":{\"bufferView\":0,\"componentType\":5125,"
		  "\"byteOffset\":12},\"values\":{\"bufferView\":0}}", "" },
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
		say("draco.gltf", HEAD "\"extensionsRequired\":[\"KHR_draco_mesh_compression\"],"
		    SCENE NODES GLOW CAMERA
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
	static const char *const piece[] = { "-1", "1e99", "[]", "{}", "null", "\"\"",
					     "99999999999", "0", "5", "\"x\":", "," };
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

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(refusals),
		cmocka_unit_test(wrong_numbers),
		cmocka_unit_test(draco),
		cmocka_unit_test(deep),
		cmocka_unit_test(mutations),
	};

	return cmocka_run_group_tests_name("damaged gltf", tests, make_folder, remove_folder);
}
