/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Hostile input: the broken files of testdata/damaged, and good files of every codec and layout
 * with bytes changed, cut out or doubled. Each is read, or refused in one line; the sanitizers
 * watch.
 */
#include "../unit/exr_make.h"

#include <dirent.h>

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

int main(void)
{
	const struct CMUnitTest tests[] = {cmocka_unit_test(test_collection),
					   cmocka_unit_test(test_mutants)};

	return cmocka_run_group_tests(tests, setup, teardown);
}
