/* SPDX-License-Identifier: BSD-3-Clause */
/* The bottom layer: errors, memory, strides, instruction sets, JSON. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "gd.h"
#include "isa.h"
#include "json.h"
#include "plane.h"

static void test_first_error_stays(void **state)
{
	struct gd_err err = { 0 };

	(void)state;
	assert_int_equal(gd_fail(&err, GD_EIO, "%s: %d", "in.exr", 3), GD_EIO);
	assert_int_equal(gd_fail(&err, GD_ENOMEM, "later"), GD_ENOMEM);
	assert_int_equal(err.code, GD_EIO);
	assert_string_equal(err.text, "in.exr: 3");
	assert_int_equal(gd_fail(NULL, GD_EARG, "nobody listens"), GD_EARG);
}

static void test_long_text_is_cut(void **state)
{
	struct gd_err err = { 0 };
	char name[2000];

	(void)state;
	memset(name, 'n', sizeof name - 1);
	name[sizeof name - 1] = 0;
	gd_fail(&err, GD_EIO, "%s", name);
	assert_int_equal(strlen(err.text), sizeof err.text - 1);
}

static double seen;

static void remember(void *user, const char *text)
{
	strcpy(user, text);
}

static void remember_warning(void *user, const char *text)
{
	sprintf(user, "warning: %s", text);
}

static void remember_progress(void *user, const char *stage, double done)
{
	strcpy(user, stage);
	seen = done;
}

static void test_reports(void **state)
{
	char text[1100] = "";
	struct gd_report report = { .note = remember, .user = text };

	(void)state;
	gd_note(NULL, "x");
	gd_progress(NULL, "x", 1);
	gd_progress(&report, "x", 1);
	gd_note(&report, "%d bins", 4);
	assert_string_equal(text, "4 bins");
	gd_warn(NULL, "x");
	gd_warn(&report, "%d warnings", 2);	/* a note, if nobody takes warnings */
	assert_string_equal(text, "2 warnings");
	report.warn = remember_warning;
	gd_warn(&report, "%s", "look");
	assert_string_equal(text, "warning: look");
	report = (struct gd_report){ .progress = remember_progress, .user = text };
	gd_warn(&report, "nothing");
	gd_note(&report, "nothing");
	gd_progress(&report, "solve", 1.5);
	assert_string_equal(text, "solve");
	assert_true(seen == 1);
}

static void test_memory(void **state)
{
	(void)state;
	for (size_t n = 0; n < 300; n += 7) {
		unsigned char *p = gd_calloc(n, 3);

		assert_non_null(p);
		assert_int_equal((uintptr_t)p % 64, 0);
		for (size_t i = 0; i < 3 * n; i++)
			assert_int_equal(p[i], 0);
		free(p);
	}
	/* what does not fit must fail, not wrap around */
	volatile size_t huge = SIZE_MAX / 4 + 2;

	assert_null(gd_alloc(huge, 4));
	assert_null(gd_alloc(SIZE_MAX - 10, 1));
	assert_null(gd_calloc(huge, 8));
}

static void test_strides(void **state)
{
	(void)state;
	for (int w = 0; w < 70000; w++) {
		size_t s = gd_stride(w);

		assert_true(s >= (size_t)w && s < (size_t)w + 48 && s % 16 == 0 && s % 1024 != 0);
	}
}

static void test_clock(void **state)
{
	double a = gd_seconds(), b = gd_seconds();

	(void)state;
	assert_true(b >= a && b - a < 5);
}

static void test_instruction_set(void **state)
{
	(void)state;
	assert_true(gd_isa() >= GD_ISA_BASE && gd_isa() <= GD_ISA_V4);
	assert_string_equal(gd_isa_name(), gd_isa() == GD_ISA_V4   ? "v4"
					   : gd_isa() == GD_ISA_V3 ? "v3"
								   : "base");
	if (getenv("GD_ISA") && !strcmp(getenv("GD_ISA"), "base"))
		assert_int_equal(gd_isa(), GD_ISA_BASE);
}

static void test_json_numbers(void **state)
{
	static const double v[] = { 0, 1, -2.5, 0.1, 1e300, 1.0 / 3, 5e-324, 123456789 };
	char text[32];

	(void)state;
	for (size_t i = 0; i < sizeof v / sizeof *v; i++) {
		gd_json_number(text, v[i]);
		assert_true(strtod(text, NULL) == v[i]);
	}
	gd_json_number(text, 0.1);
	assert_string_equal(text, "0.1");
	gd_json_number(text, (double)NAN);
	assert_string_equal(text, "null");
	gd_json_number(text, (double)-INFINITY);
	assert_string_equal(text, "null");
}

static void test_json_file(void **state)
{
	char path[] = "/tmp/gd-json-XXXXXX", line[200];
	struct gd_json o = { 0 };
	struct gd_err err = { 0 };
	int fd = mkstemp(path);
	FILE *f;

	(void)state;
	assert_true(fd >= 0);
	close(fd);
	assert_int_equal(gd_json_add_text(&o, "a \"b\"", "tab\tback\\ \xc3\xa9"), GD_OK);
	assert_int_equal(gd_json_add_number(&o, "n", 2), GD_OK);
	assert_int_equal(gd_json_save(&o, path, &err), GD_OK);
	f = fopen(path, "r");
	assert_non_null(f);
	assert_non_null(fgets(line, sizeof line, f));
	fclose(f);
	assert_string_equal(line, "{\"a \\\"b\\\"\": \"tab\\u0009back\\\\ \xc3\xa9\", \"n\": 2}\n");
	assert_int_equal(gd_json_save(&o, "/nowhere/at/all.json", &err), GD_EIO);
	assert_string_equal(err.text, "/nowhere/at/all.json: No such file or directory");
	err = (struct gd_err){ 0 };
	assert_int_equal(gd_json_save(&o, "/dev/full", &err), GD_EIO);
	gd_json_free(&o);
	unlink(path);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_first_error_stays), cmocka_unit_test(test_long_text_is_cut),
		cmocka_unit_test(test_reports),		  cmocka_unit_test(test_memory),
		cmocka_unit_test(test_strides),		  cmocka_unit_test(test_clock),
		cmocka_unit_test(test_instruction_set),	  cmocka_unit_test(test_json_numbers),
		cmocka_unit_test(test_json_file),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
