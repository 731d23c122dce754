/* SPDX-License-Identifier: BSD-3-Clause */
/* The border to OpenImageIO and OpenColorIO. Skipped, and said so, where the plug-in is not built.
 */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

#include "exr.h"
#include "plugin.h"
#include "show.h"

/*
 * For builds with the leak checker: where a PNG ends early, libpng jumps over OpenImageIO's frames,
 * and a text of theirs is lost. The whole stack is needed to know it.
 */
const char *__asan_default_options(void);
const char *__asan_default_options(void)
{
	return "fast_unwind_on_malloc=0";
}

const char *__lsan_default_suppressions(void);
const char *__lsan_default_suppressions(void)
{
	return "leak:PNGInput::PngReadCallback\n";
}

static double to_srgb(double v)
{
	return v <= 0.0031308 ? 12.92 * v : 1.055 * pow(v, 1 / 2.4) - 0.055;
}

static double to_linear(double v)
{
	return v <= 0.04045 ? v / 12.92 : pow((v + 0.055) / 1.055, 2.4);
}

static void need_plugin(void)
{
	struct gd_err err = { 0 };

	if (gd_plugin_check(&err) != GD_OK) {
		print_message("not tested: %s\n", err.text);
		skip();
	}
}

static void missing(void **state)
{
	char *path = strdup(getenv("GD_PLUGIN_PATH"));
	struct gd_err err = { 0 };
	struct gd_plugin_file *file = (void *)1;
	struct gd_image im = { 0 };
	float rgb[3] = { 0 };

	(void)state;
	setenv("GD_PLUGIN_PATH", "/nowhere:/nowhere/else", 1);
	assert_int_equal(gd_plugin_check(&err), GD_EIO);
	assert_non_null(strstr(err.text, "gd-plugin.so"));
	assert_int_equal(gd_plugin_open(&file, &im, "a.png", NULL, 0, 0, &err), GD_EIO);
	assert_null(file);
	assert_int_equal(gd_plugin_display(rgb, 1, NULL, NULL, &err), GD_EIO);
	setenv("GD_PLUGIN_PATH", path, 1);
	free(path);
}

/* Encodes bytes, decodes them: sRGB-encoded values come back linear. */
static void png(int n, int bits)
{
	enum { W = 16, H = 5 };
	unsigned char pixel[2 * W * H * 3], *data;
	uint16_t wide[W * H * 3];
	const char *names[3] = { n < 3 ? "Y" : "R", "G", "B" };
	const double top = bits == 16 ? 65535 : 255;
	struct gd_plugin_file *file;
	struct gd_image im = { 0 };
	struct gd_err err = { 0 };
	size_t size;

	for (int i = 0; i < W * H * n; i++)
		wide[i] = (uint16_t)(bits == 16 ? i * 211 : i * 7 % 256);
	for (int i = 0; i < W * H * n; i++)
		pixel[i] = (unsigned char)wide[i];
	assert_int_equal(
		gd_plugin_png(&data, &size, bits == 16 ? (void *)wide : pixel, W, H, n, bits, &err),
		GD_OK);
	assert_memory_equal(data, "\x89PNG\r\n\x1a\n", 8);
	assert_memory_equal(data + 16, "\0\0\0\x10\0\0\0\x05", 8);
	assert_int_equal(data[24], bits);
	assert_int_equal(gd_plugin_open(&file, &im, "memory.png", data, size, 0, &err), GD_OK);
	assert_true(im.w == W && im.h == H && im.nchan == n);
	for (int c = 0; c < n; c++)
		im.chan[c].want = GD_READ;
	assert_int_equal(gd_plugin_load(file, &im, &err), GD_OK);
	for (int c = 0; c < n; c++) {
		struct gd_plane p;

		assert_true(gd_image_plane(&im, names[c], &p));
		for (int i = 0; i < W * H; i++) {
			double wanted = to_linear(wide[i * n + c] / top);

			if (fabs((double)gd_row(p, i / W)[i % W] - wanted) > 1e-6)
				fail_msg("%d bits, channel %s, pixel %d: %g, wanted %g", bits,
					 names[c], i, (double)gd_row(p, i / W)[i % W], wanted);
		}
	}
	gd_plugin_close(file);
	gd_image_free(&im);
	free(data);
}

static void pngs(void **state)
{
	(void)state;
	need_plugin();
	png(3, 8);
	png(3, 16);
	png(1, 8);
}

static void damaged(void **state)
{
	unsigned char pixel[300] = { 0 }, *data;
	struct gd_plugin_file *file;
	struct gd_image im = { 0 };
	struct gd_err err = { 0 };
	size_t size;

	(void)state;
	need_plugin();
	assert_int_equal(gd_plugin_png(&data, &size, pixel, 10, 10, 3, 8, &err), GD_OK);
	for (size_t cut = 0; cut < size - 12; cut += 29) {
		struct gd_err why = { 0 };
		int rc = gd_plugin_open(&file, &im, "memory.png", data, cut, 0, &why);

		if (rc != GD_OK) {
			assert_null(file);
			assert_true(im.nchan == 0 && why.text[0] && !strchr(why.text, '\n'));
			continue;
		}
		im.chan[0].want = GD_READ;
		(void)gd_plugin_load(file, &im, &why);	/* a decoder may fill what is missing */
		gd_plugin_close(file);
		gd_image_free(&im);
	}
	assert_int_equal(gd_plugin_open(&file, &im, "memory.png", data, size, 3, &err), GD_EARG);
	free(data);
}

/* What OpenEXR's C library wrote comes back through OpenImageIO: pixels of all types, windows,
 * attributes. */
static void exr(void **state)
{
	char path[] = "/tmp/gd-test-plugin-XXXXXX.exr";
	const uint16_t halves[6] = {
		0x3c00, 0x0001, 0x7c00, 0xfe01, 0x8000, 0x5640
	}; /* 1, tiny, inf, NaN, -0, 100 */
	const uint32_t ids[6] = { 0, 1, 0xffffffffu, 0x80000001u, 7, 123456789 };
	struct gd_image im = { 0 }, back = { 0 };
	struct gd_write_conf conf = { GD_ZIP };
	struct gd_plugin_file *file;
	struct gd_plane p;
	struct gd_err err = { 0 };
	char text[64];
	double number;
	int fd = mkstemps(path, 4);

	(void)state;
	assert_true(fd >= 0);
	close(fd);
	need_plugin();
	gd_image_init(&im, 3, 2);
	im.data = (struct gd_box){ -4, 7, -2, 8 };
	im.display = (struct gd_box){ -10, 0, 20, 30 };
	for (int i = 0; i < 3; i++)
		assert_int_equal(
			gd_image_add(&im, (const char *[]){ "half0.dx.R", "id", "Z" }[i], &p, &err),
			GD_OK);
	for (int i = 0; i < 6; i++)
		gd_row(p, i / 3)[i % 3] = (float)i + 0.1f;
	for (int i = 0; i < 2; i++) {
		struct gd_channel *c = &im.chan[gd_image_find(&im, i ? "id" : "half0.dx.R")];

		free(c->v);
		c->v = NULL;
		c->type = i ? GD_UINT : GD_HALF;
		c->want = GD_PASS;
		c->raw = gd_alloc(6, 4);
		memcpy(c->raw, i ? (const void *)ids : halves, i ? sizeof(ids) : sizeof(halves));
	}
	assert_int_equal(gd_attr_set_number(&im, "gd:renderSeconds", 2.5, &err), GD_OK);
	assert_int_equal(gd_attr_set_string(&im, "gd:history", "a b", &err), GD_OK);
	assert_int_equal(gd_exr_write(&im, path, &conf, &err), GD_OK);

	assert_int_equal(gd_plugin_open(&file, &back, path, NULL, 0, 0, &err), GD_OK);
	back.chan[gd_image_find(&back, "Z")].want = GD_READ;
	assert_int_equal(gd_plugin_load(file, &back, &err), GD_OK);
	gd_plugin_close(file);
	assert_memory_equal(&back.data, &im.data, sizeof(im.data));
	assert_memory_equal(&back.display, &im.display, sizeof(im.display));
	assert_int_equal(back.nchan, 3);
	assert_memory_equal(back.chan[gd_image_find(&back, "half0.dx.R")].raw, halves,
			    sizeof(halves));
	assert_memory_equal(back.chan[gd_image_find(&back, "id")].raw, ids, sizeof(ids));
	assert_true(gd_image_plane(&back, "Z", &p));
	for (int i = 0; i < 6; i++)
		assert_true(gd_row(p, i / 3)[i % 3] == (float)i + 0.1f);
	assert_true(gd_attr_number(&back, "gd:renderSeconds", &number) && number == 2.5);
	assert_true(gd_attr_string(&back, "gd:history", text, sizeof(text)) &&
		    !strcmp(text, "a b"));
	gd_image_free(&back);

	assert_int_equal(gd_plugin_open(&file, &back, path, NULL, 0, 0, &err), GD_OK);
	for (int i = 0; i < 3; i++)
		back.chan[i].want = strcmp(back.chan[i].name, "Z") ? GD_READ : GD_DROP;
	assert_int_equal(gd_plugin_load(file, &back, &err), GD_OK);
	gd_plugin_close(file);
	assert_int_equal(back.nchan, 2);
	assert_true(gd_image_plane(&back, "half0.dx.R", &p));
	assert_true(gd_row(p, 0)[0] == 1 && isinf(gd_row(p, 0)[2]) && isnan(gd_row(p, 1)[0]) &&
		    gd_row(p, 1)[2] == 100);
	assert_true(gd_image_plane(&back, "id", &p));
	assert_true(gd_row(p, 0)[1] == 1 && gd_row(p, 0)[2] == 4294967296.0f &&
		    gd_row(p, 1)[2] == 123456789.0f);
	gd_image_free(&back);
	gd_image_free(&im);
	unlink(path);
}

static void display_builtin(void **state)
{
	const float in[8] = { 0, 0.001f, 0.0031308f, 0.02f, 0.18f, 0.5f, 0.9f, 1 };
	const float odd[9] = { -1, 2, 1e30f, NAN, -1e30f, INFINITY, -INFINITY, 0, 1 };
	float rgb[24], raw[9];
	struct gd_err err = { 0 };

	(void)state;
	need_plugin();
	unsetenv("OCIO");
	for (int i = 0; i < 24; i++)
		rgb[i] = in[i / 3];
	assert_int_equal(gd_plugin_display(rgb, 8, NULL, NULL, &err), GD_OK);
	for (int i = 0; i < 24; i++)
		if (fabs((double)rgb[i] - to_srgb(in[i / 3])) > 2e-4)
			fail_msg("%g became %g, wanted %g", (double)in[i / 3], (double)rgb[i],
				 to_srgb(in[i / 3]));
	memcpy(raw, odd, sizeof(raw));
	assert_int_equal(gd_plugin_display(raw, 3, "sRGB", "Raw", &err), GD_OK);
	for (int i = 0; i < 9; i++)
		assert_true(raw[i] == (odd[i] > 0 ? (odd[i] < 1 ? odd[i] : 1) : 0));
	memcpy(raw, odd, sizeof(raw));
	assert_int_equal(gd_plugin_display(raw, 3, NULL, "Standard", &err), GD_OK);
	for (int i = 0; i < 9; i++)
		assert_true(raw[i] >= 0 && raw[i] <= 1);
	assert_int_equal(gd_plugin_display(raw, 3, NULL, "Cinema", &err), GD_EARG);
	assert_non_null(strstr(err.text, "\"Standard\", \"Raw\""));
	err = (struct gd_err){ 0 };
	assert_int_equal(gd_plugin_display(raw, 3, "P3", NULL, &err), GD_EARG);
}

/* The default view of this configuration halves; what $OCIO names is obeyed or refused, never
 * passed over. */
static void display_configured(void **state)
{
	char path[] = "/tmp/gd-test-plugin-XXXXXX.ocio";
	const char config[] =
		"ocio_profile_version: 2\nroles:\n  scene_linear: lin\n  default: lin\n"
		"file_rules:\n  - !<Rule> {name: Default, colorspace: default}\n"
		"displays:\n  Dim:\n    - !<View> {name: Half, colorspace: half}\n"
		"colorspaces:\n  - !<ColorSpace> {name: lin}\n  - !<ColorSpace>\n    name: half\n"
		"    from_scene_reference: !<MatrixTransform> {matrix: [0.5,0,0,0, 0,0.5,0,0, "
		"0,0,0.5,0, 0,0,0,1]}\n";
	float rgb[3] = { 0.25f, 0.5f, 1 };
	struct gd_err err = { 0 };
	int fd = mkstemps(path, 5);

	(void)state;
	assert_true(fd >= 0 && write(fd, config, sizeof(config) - 1) == sizeof(config) - 1);
	close(fd);
	need_plugin();
	setenv("OCIO", path, 1);
	assert_int_equal(gd_plugin_display(rgb, 1, NULL, NULL, &err), GD_OK);
	assert_true(fabsf(rgb[0] - 0.125f) < 1e-6f && fabsf(rgb[1] - 0.25f) < 1e-6f &&
		    fabsf(rgb[2] - 0.5f) < 1e-6f);
	unlink(path);
	assert_int_not_equal(gd_plugin_display(rgb, 1, NULL, NULL, &err), GD_OK);
	assert_non_null(strstr(err.text, path));
	unsetenv("OCIO");
}

/* From radiance to bytes in a file, twice the same. */
static void picture(void **state)
{
	char path[] = "/tmp/gd-test-plugin-XXXXXX.png";
	float v[3][64] = { { 0 } };
	struct gd_plane p[3] = { gd_plane_of(v[0], 3, 1), gd_plane_of(v[1], 3, 1),
				 gd_plane_of(v[2], 3, 1) },
			back;
	struct gd_show_conf conf = { .as = GD_SHOW_COLOUR, .exposure = 1 };
	struct gd_picture pic = { 0 };
	struct gd_plugin_file *file;
	struct gd_image im = { 0 };
	struct gd_err err = { 0 };
	size_t nan;
	int fd = mkstemps(path, 4);

	(void)state;
	assert_true(fd >= 0);
	close(fd);
	need_plugin();
	v[0][0] = 0.25f;	/* one stop brighter: 0.5 */
	v[1][1] = 7;
	v[2][2] = NAN;
	assert_int_equal(gd_show(&pic, &nan, p, 3, &conf, &err), GD_OK);
	assert_int_equal(nan, 1);
	assert_int_equal(gd_picture_write(&pic, path, 16, &err), GD_OK);
	assert_int_equal(gd_plugin_open(&file, &im, path, NULL, 0, 0, &err), GD_OK);
	for (int c = 0; c < 3; c++)
		im.chan[c].want = GD_READ;
	assert_int_equal(gd_plugin_load(file, &im, &err), GD_OK);
	gd_plugin_close(file);
	assert_true(gd_image_plane(&im, "R", &back));
	assert_true(fabsf(back.v[0] - 0.5f) < 1e-3f && back.v[1] == 0 &&
		    fabsf(back.v[2] - 1) < 1e-6f);
	assert_true(gd_image_plane(&im, "G", &back));
	assert_true(back.v[0] == 0 && fabsf(back.v[1] - 1) < 1e-6f && back.v[2] == 0);
	gd_image_free(&im);
	gd_picture_free(&pic);
	unlink(path);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(missing),	   cmocka_unit_test(pngs),
		cmocka_unit_test(damaged),	   cmocka_unit_test(exr),
		cmocka_unit_test(display_builtin), cmocka_unit_test(display_configured),
		cmocka_unit_test(picture),
	};

	setenv("GD_PLUGIN_PATH", getenv("GD_BIN") ? getenv("GD_BIN") : "bin", 0);
	return cmocka_run_group_tests(tests, NULL, NULL);
}
