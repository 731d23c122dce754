/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Hostile input: the broken files of testdata/damaged, and good files of every codec and layout
 * with bytes changed, cut out or doubled. Each is read, or refused in one line; the sanitizers
 * watch.
 */
#include "../unit/exr_make.h"

#include <dirent.h>
#include <sys/resource.h>

#define MUTANTS	60	/* of each layout */

static char *temp_dir, data_dir[4096];

static int setup(void **state)
{
	const char *data = getenv("GD_TESTDATA");
	char *here = realpath(data ? data : "testdata", NULL);

	(void)state;
	snprintf(data_dir, sizeof data_dir, "%s/damaged", here ? here : "testdata");
	free(here);
	temp_dir = enter_temp();
	return 0;
}

static int teardown(void **state)
{
	(void)state;
	return leave_temp(temp_dir);
}

/* Returns whether it was read. */
static bool check(const char *path, const char *label, bool piped, enum gd_want want)
{
	struct gd_err err = { 0 };
	struct gd_image im = { 0 };
	int rc = piped ? read_piped(&im, path, want, &err) : read_all(&im, path, 0, want, &err);

	if (rc == GD_OK && gd_exr_write(&im, "/dev/null", NULL, &err) != GD_OK)
		fail_msg("read but not writable: %s", err.text);
	if (rc != GD_OK) {
		if (rc != GD_EFORMAT && rc != GD_ENOMEM)
			fail_msg("%s: status %d: %s", path, rc, err.text);
		assert_int_equal(err.code, rc);
		assert_memory_equal(err.text, label, strlen(label));
		for (const char *t = err.text; *t; t++)
			assert_true((unsigned char)*t >= ' ');
	}
	gd_image_free(&im);
	return rc == GD_OK;
}

static void test_collection(void **state)
{
	DIR *dir = opendir(data_dir);
	struct dirent *e;
	int n = 0, good = 0;

	(void)state;
	if (!dir)
		fail_msg("no directory %s", data_dir);
	while ((e = readdir(dir))) {
		char path[8192];
		if (e->d_name[0] == '.' || strcmp(e->d_name, "README") == 0 ||
		    strcmp(e->d_name, "LICENSE") == 0)
			continue;
		snprintf(path, sizeof path, "%s/%s", data_dir, e->d_name);
		bool ok = check(path, path, false, GD_READ);
		assert_true(check(path, path, false, GD_PASS) == ok);
		assert_true(check(path, "stdin", true, GD_READ) == ok);
		good += ok;
		n++;
	}
	closedir(dir);
	assert_in_range(n, 160, 1000);
	print_message("%d files, %d of them readable\n", n, good);
}

/* A small pseudo-random generator of the test's own. */
static uint32_t next(uint32_t *seed)
{
	return make_hash(*seed += 0x9e3779b9u);
}

/* Most damage goes to the header and the table behind it, where it does most. */
static size_t mutate(unsigned char *v, size_t n, uint32_t *seed)
{
	size_t head = n < 700 ? n : 700;
	int times = 1 + (int)(next(seed) % 4);

	for (int i = 0; i < times; i++) {
		size_t at = next(seed) % (next(seed) % 4 ? head : n);
		switch (next(seed) % 5) {
		case 0:
			v[at] ^= (unsigned char)(1u << next(seed) % 8);
			break;
		case 1:
			v[at] = (unsigned char)next(seed);
			break;
		case 2:
			v[at] = next(seed) % 2 ? 255 : 0;
			break;
		case 3:	/* a copied run */
			memmove(v + at, v + next(seed) % n, (n - at < 16 ? n - at : 16) / 2);
			break;
		default:
			if (next(seed) % 4 == 0)
				n = at + 1;
			break;
		}
		if (head > n)
			head = n;
	}
	return n;
}

static void mutants(const char *seed_path, uint32_t seed)
{
	size_t n;
	unsigned char *v = slurp_file(seed_path, &n), *w = malloc(2 * n);

	for (int i = 0; i < MUTANTS; i++) {
		memcpy(w, v, n);
		memcpy(w + n, v, n);
		spill_file("mutant.exr", w, mutate(w, n, &seed));
		check("mutant.exr", "mutant.exr", false, i % 2 ? GD_READ : GD_PASS);
		if (i % 4 == 0)
			check("mutant.exr", "stdin", true, GD_READ);
	}
	free(v);
	free(w);
}

static void test_mutants(void **state)
{
	(void)state;
	for (int k = EXR_COMPRESSION_NONE; k <= EXR_COMPRESSION_B44A; k++)
		for (int layout = 0; layout < 3; layout++) {
			/*
			 * in tiles narrower than 4 the library's own B44 grows beyond what it reads
			 */
			struct make_part p[2] = {
				{.storage = layout == 1 ? EXR_STORAGE_TILED : EXR_STORAGE_SCANLINE,
				 .compression = (exr_compression_t)k,
				 .data = make_box(-2, 3, 29, 40),
				 .display = make_box(0, 0, 40, 40),
				 .tile = 16,
				 .nchan = 4,
				 .chan = {{"R", EXR_PIXEL_HALF, 1},
					  {"G", EXR_PIXEL_HALF, 1},
					  {"Z", EXR_PIXEL_FLOAT, 1},
					  {"id", EXR_PIXEL_UINT, 1}}}};
			p[1] = p[0];
			if (layout == 2) {
				p[0].name = "a";
				p[1].name = "b";
			}
			make_exr("seed.exr", p, layout == 2 ? 2 : 1, false);
			if (!check("seed.exr", "seed.exr", false, GD_READ))
				fail_msg("codec %d, layout %d", k, layout);
			mutants("seed.exr", (uint32_t)(k * 3 + layout));
		}
}

static void expect_refusal(const char *path, bool piped)
{
	struct gd_err err = { 0 };
	struct gd_image im = { 0 };
	int rc = piped ? read_piped(&im, path, GD_READ, &err)
		       : read_all(&im, path, 0, GD_READ, &err);

	assert_true(rc == GD_EFORMAT);
	assert_int_equal(err.code, rc);
	assert_null(strchr(err.text, '\n'));
	assert_memory_equal(err.text, piped ? "stdin: " : path, piped ? 7 : strlen(path));
	gd_image_free(&im);
}

static void test_truncated(void **state)
{
	(void)state;
	for (int k = EXR_COMPRESSION_NONE; k <= EXR_COMPRESSION_B44A; k++)
		for (int tiled = 0; tiled < 2; tiled++) {
			size_t n;
			make_seed("whole.exr", k, tiled);
			unsigned char *v = slurp_file("whole.exr", &n);
			for (size_t i = 0; i < 50; i++) {
				spill_file("cut.exr", v, i * n / 50);
				expect_refusal("cut.exr", false);
				if (i % 7 == 0)
					expect_refusal("cut.exr", true);
			}
			spill_file("cut.exr", v, n - 1);
			expect_refusal("cut.exr", false);
			expect_refusal("cut.exr", true);
			free(v);
		}
}

/* Puts bytes over the value of the attribute that follows key in the header. */
static void patch(unsigned char *v, size_t n, const char *key, size_t key_n, const void *data,
		  size_t size)
{
	unsigned char *at = memmem(v, n, key, key_n);

	assert_non_null(at);
	memcpy(at + key_n, data, size);
}

/*
 * A header of a few hundred bytes that claims any number of pixels costs neither memory nor time.
 */
static void test_claims(void **state)
{
	static const int32_t box[][4] = {{0, 0, 59999, 59999},
					 {0, 0, 100663296, 0},
					 {0, 0, 65535, 65535},
					 {-2147483647, 0, 2147483646, 3},
					 {5, 5, 4, 4}};

	(void)state;
	for (int k = 0; k <= EXR_COMPRESSION_PIZ; k++)
		for (size_t i = 0; i < sizeof box / sizeof *box; i++) {
			struct rusage before, after;
			size_t n;
			make_seed("claim.exr", k, false);
			unsigned char *v = slurp_file("claim.exr", &n);
			patch(v, n, "dataWindow\0box2i\0\20\0\0", 21, box[i], 16);
			spill_file("claim.exr", v, n);
			free(v);
			getrusage(RUSAGE_SELF, &before);
			expect_refusal("claim.exr", false);
			expect_refusal("claim.exr", true);
			getrusage(RUSAGE_SELF, &after);
			assert_true(after.ru_maxrss - before.ru_maxrss < 64 * 1024);
		}
}

/* Without the plug-in, what the C library cannot decode is refused before anything is computed. */
static void test_without_plugin(void **state)
{
	struct gd_err err = { 0 };
	struct gd_image im = { 0 };
	struct gd_exr *file;
	size_t n;

	(void)state;
	assert_int_equal(setenv("GD_PLUGIN_PATH", "/nonexistent", 1), 0);
	make_seed("dwa.exr", EXR_COMPRESSION_NONE, false);
	unsigned char *v = slurp_file("dwa.exr", &n);
	patch(v, n, "compression\0compression\0\1\0\0", 28, "\10", 1);
	spill_file("dwa.exr", v, n);
	free(v);
	assert_int_equal(gd_exr_open(&file, &im, "dwa.exr", NULL, &err), GD_EFORMAT);
	assert_non_null(strstr(err.text, "dwa.exr: DWAA"));
	assert_non_null(strstr(err.text, "oiiotool in.exr --compression zip -o out.exr"));
	err = (struct gd_err){ 0 };
	spill_file("other.png", "\211PNG\r\n\032\n", 8);
	assert_int_equal(gd_exr_open(&file, &im, "other.png", NULL, &err), GD_EFORMAT);
	assert_memory_equal(err.text, "other.png: not an OpenEXR file", 30);
	assert_null(file);
	assert_int_equal(im.nchan, 0);
}

static void test_wrong_rows(void **state)
{
	int32_t wrong = 12345;
	size_t n;

	(void)state;
	make_seed("rows.exr", EXR_COMPRESSION_NONE, false);
	unsigned char *v = slurp_file("rows.exr", &n);
	memcpy(v + n - 37 * 14 - 8, &wrong, sizeof wrong);	/* the last row's own number */
	spill_file("rows.exr", v, n);
	free(v);
	expect_refusal("rows.exr", false);
	expect_refusal("rows.exr", true);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_collection), cmocka_unit_test(test_mutants),
		cmocka_unit_test(test_truncated),  cmocka_unit_test(test_claims),
		cmocka_unit_test(test_wrong_rows), cmocka_unit_test(test_without_plugin),
	};

	return cmocka_run_group_tests(tests, setup, teardown);
}
