/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * EXR files made by OpenEXR's own C library, and small helpers, for the tests of reading and
 * writing.
 */
#ifndef EXR_MAKE_H
#define EXR_MAKE_H

#include <fcntl.h>
#include <math.h>
#include <openexr.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

#include "exr.h"

#define MAKE_MAX 16

struct make_channel {
	const char *name;
	exr_pixel_type_t type;
	int sampling;			/* 0 and 1 are the same */
};

/* One part. Pixels are make_bits() of (channel, x, y) relative to the data window. */
struct make_part {
	const char *name;		/* NULL: a single part */
	exr_storage_t storage;
	exr_compression_t compression;
	exr_attr_box2i_t data, display;
	int tile, mip;			/* tile side; mip maps */
	exr_lineorder_t order;
	int nchan;
	struct make_channel chan[MAKE_MAX];
	void (*extra)(exr_context_t ctx, int part);
};

static inline uint32_t make_hash(uint32_t v)
{
	v = (v ^ (v >> 16)) * 0x7feb352du;
	v = (v ^ (v >> 15)) * 0x846ca68bu;
	return v ^ (v >> 16);
}

/*
 * Finite values for floats, any bits for uints; smooth enough that every codec finds something to
 * do.
 */
static inline uint32_t make_bits(exr_pixel_type_t type, int c, int x, int y)
{
	uint32_t r = make_hash((uint32_t)(c * 7919 + y * 131 + x / 3));
	float f = 0.25f * (float)(x + 2 * y) + (float)(r & 15) / 16.0f + (float)c;
	uint32_t u;

	if (type == EXR_PIXEL_UINT)
		return make_hash((uint32_t)(c + 1000 * (x / 4) + 77777 * (y / 2)));
	if (type == EXR_PIXEL_HALF)
		return 0x3000u + ((uint32_t)(x + y) & 0xfffu) + (r & 3u);
	memcpy(&u, &f, sizeof u);
	return u;
}

static inline void make_ok(exr_result_t code)
{
	if (code != EXR_ERR_SUCCESS)
		fail_msg("OpenEXR: %s", exr_get_default_error_message(code));
}

static inline void make_pixels(const struct make_part *p, exr_encode_pipeline_t *enc, int x0,
			       int y0)
{
	for (int c = 0; c < enc->channel_count; c++) {
		exr_coding_channel_info_t *k = &enc->channels[c];
		size_t bytes = (size_t)k->bytes_per_element;
		uint8_t *v = malloc((size_t)k->width * (size_t)k->height * bytes + 1);
		int id = 0;
		while (strcmp(p->chan[id].name, k->channel_name) != 0)
			id++;
		for (int y = 0; y < k->height; y++)
			for (int x = 0; x < k->width; x++) {
				uint32_t u = make_bits((exr_pixel_type_t)k->data_type, id, x0 + x,
						       y0 + y);
				memcpy(v + bytes * ((size_t)y * (size_t)k->width + (size_t)x), &u,
				       bytes);
			}
		k->encode_from_ptr = v;
		k->user_pixel_stride = (int32_t)bytes;
		k->user_line_stride = (int32_t)(bytes * (size_t)k->width);
	}
}

static inline void make_chunk(exr_context_t ctx, int part, const struct make_part *p,
			      const exr_chunk_info_t *info, int x0, int y0)
{
	exr_encode_pipeline_t enc = EXR_ENCODE_PIPELINE_INITIALIZER;

	make_ok(exr_encoding_initialize(ctx, part, info, &enc));
	make_pixels(p, &enc, x0, y0);
	make_ok(exr_encoding_choose_default_routines(ctx, part, &enc));
	make_ok(exr_encoding_run(ctx, part, &enc));
	for (int c = 0; c < enc.channel_count; c++)
		free((void *)(uintptr_t)enc.channels[c].encode_from_ptr);
	make_ok(exr_encoding_destroy(ctx, &enc));
}

static inline void make_tiles(exr_context_t ctx, int part, const struct make_part *p)
{
	int nx = 1, ny = 1, w, h;
	exr_chunk_info_t info;

	if (p->mip)
		make_ok(exr_get_tile_levels(ctx, part, &nx, &ny));
	for (int l = 0; l < nx; l++) {
		make_ok(exr_get_level_sizes(ctx, part, l, l, &w, &h));
		for (int y = 0; y * p->tile < h; y++)
			for (int x = 0; x * p->tile < w; x++) {
				make_ok(exr_write_tile_chunk_info(ctx, part, x, y, l, l, &info));
				make_chunk(ctx, part, p, &info, x * p->tile, y * p->tile);
			}
	}
}

static inline void make_rows(exr_context_t ctx, int part, const struct make_part *p)
{
	int step, h = p->data.max.y - p->data.min.y + 1;
	exr_chunk_info_t info;

	make_ok(exr_get_scanlines_per_chunk(ctx, part, &step));
	int n = (h + step - 1) / step;
	for (int i = 0; i < n; i++) {
		int y = (p->order == EXR_LINEORDER_DECREASING_Y ? n - 1 - i : i) * step;
		make_ok(exr_write_scanline_chunk_info(ctx, part, p->data.min.y + y, &info));
		make_chunk(ctx, part, p, &info, 0, y);
	}
}

static inline void make_head(exr_context_t ctx, const struct make_part *p)
{
	exr_attr_v2f_t center = { .x = 0.5f, .y = -0.25f };
	int part;

	make_ok(exr_add_part(ctx, p->name, p->storage, &part));
	make_ok(exr_initialize_required_attr(ctx, part, &p->display, &p->data, 1.5f, &center, 2.0f,
					     p->order == EXR_LINEORDER_INCREASING_Y ? p->order :
									EXR_LINEORDER_RANDOM_Y,
					     p->compression));
	if (p->storage == EXR_STORAGE_DEEP_SCANLINE)
		make_ok(exr_set_version(ctx, part, 1));
	if (p->storage == EXR_STORAGE_TILED || p->storage == EXR_STORAGE_DEEP_TILED)
		make_ok(exr_set_tile_descriptor(
			ctx, part, (uint32_t)p->tile, (uint32_t)p->tile,
			p->mip ? EXR_TILE_MIPMAP_LEVELS : EXR_TILE_ONE_LEVEL, EXR_TILE_ROUND_DOWN));
	for (int c = 0; c < p->nchan; c++) {
		int s = p->chan[c].sampling ? p->chan[c].sampling : 1;
		make_ok(exr_add_channel(ctx, part, p->chan[c].name, p->chan[c].type,
					EXR_PERCEPTUALLY_LOGARITHMIC, s, s));
	}
	if (p->extra)
		p->extra(ctx, part);
}

static inline void make_quiet(exr_const_context_t ctx, exr_result_t code, const char *text)
{
	(void)ctx;
	(void)code;
	(void)text;
}

/*
 * The library can read rows stored from the bottom up but not write them: told "random", it does.
 */
static inline void make_decreasing(const char *path)
{
	static const char key[] = "lineOrder\0lineOrder\0\1\0\0";
	unsigned char head[4096], *at;
	int fd = open(path, O_RDWR);
	ssize_t n = pread(fd, head, sizeof head, 0);

	assert_true(n > 0);
	at = memmem(head, (size_t)n, key, sizeof key);
	assert_non_null(at);
	at[sizeof key] = EXR_LINEORDER_DECREASING_Y;
	assert_int_equal(pwrite(fd, head, (size_t)n, 0), n);
	close(fd);
}

static inline int64_t make_write(exr_const_context_t ctx, void *user, const void *v, uint64_t n,
				 uint64_t at, exr_stream_error_func_ptr_t error)
{
	(void)ctx;
	(void)error;
	return pwrite(*(int *)user, v, n, (off_t)at);
}

/* Writes the parts; with header_only, no pixels. */
static inline void make_exr(const char *path, const struct make_part *p, int n, bool header_only)
{
	exr_context_initializer_t init = EXR_DEFAULT_CONTEXT_INITIALIZER;
	int fd = open(path, O_RDWR | O_CREAT | O_TRUNC, 0666);
	exr_context_t ctx;

	assert_true(fd >= 0);
	init.error_handler_fn = make_quiet;
	init.write_fn = make_write;
	init.user_data = &fd;
	make_ok(exr_start_write(&ctx, path, EXR_WRITE_FILE_DIRECTLY, &init));
	make_ok(exr_set_longname_support(ctx, 1));
	for (int i = 0; i < n; i++)
		make_head(ctx, &p[i]);
	make_ok(exr_write_header(ctx));
	for (int i = 0; i < n && !header_only; i++) {
		if (p[i].storage == EXR_STORAGE_TILED)
			make_tiles(ctx, i, &p[i]);
		else
			make_rows(ctx, i, &p[i]);
	}
	make_ok(exr_finish(&ctx));
	close(fd);
	if (p->order == EXR_LINEORDER_DECREASING_Y)
		make_decreasing(path);
}

static inline exr_attr_box2i_t make_box(int x0, int y0, int x1, int y1)
{
	return (exr_attr_box2i_t){ .min = { .x = x0, .y = y0 }, .max = { .x = x1, .y = y1 } };
}

/* A scanline part of 37 x 71 pixels with every type. */
static inline struct make_part make_plain(void)
{
	return (struct make_part){.storage = EXR_STORAGE_SCANLINE,
				  .data = make_box(0, 0, 36, 70),
				  .display = make_box(0, 0, 36, 70),
				  .tile = 16,
				  .nchan = 4,
				  .chan = {{"R", EXR_PIXEL_FLOAT, 1},
					   {"N.X", EXR_PIXEL_HALF, 1},
					   {"id", EXR_PIXEL_UINT, 1},
					   {"Z", EXR_PIXEL_FLOAT, 1}}};
}

/* That as a file, by the number of a codec. */
static inline void make_seed(const char *path, int codec, bool tiled)
{
	struct make_part p = make_plain();

	p.compression = (exr_compression_t)codec;
	p.storage = tiled ? EXR_STORAGE_TILED : EXR_STORAGE_SCANLINE;
	make_exr(path, &p, 1, false);
}

/* Opens and loads path with one want for all channels. */
static inline int read_all(struct gd_image *im, const char *path, int part, enum gd_want want,
			   struct gd_err *err)
{
	struct gd_read_conf conf = { part };
	struct gd_exr *file;
	int rc = gd_exr_open(&file, im, path, &conf, err);

	if (rc != GD_OK)
		return rc;
	for (int i = 0; i < im->nchan; i++)
		im->chan[i].want = want;
	rc = gd_exr_load(file, im, err);
	gd_exr_close(file);
	return rc;
}

static inline void read_ok(struct gd_image *im, const char *path, int part, enum gd_want want)
{
	struct gd_err err = { 0 };

	*im = (struct gd_image){ 0 };
	if (read_all(im, path, part, want, &err) != GD_OK)
		fail_msg("%s", err.text);
}

/* The same from a pipe on standard input. Returns the status. */
static inline int read_piped(struct gd_image *im, const char *path, enum gd_want want,
			     struct gd_err *err)
{
	char command[4200];
	int keep = dup(0), rc;

	snprintf(command, sizeof command, "cat '%s' 2>/dev/null", path);
	FILE *p = popen(command, "r");
	assert_non_null(p);
	dup2(fileno(p), 0);
	rc = read_all(im, "-", 0, want, err);
	dup2(keep, 0);
	close(keep);
	pclose(p);
	return rc;
}

static inline unsigned char *slurp_file(const char *path, size_t *n)
{
	FILE *f = fopen(path, "rb");
	struct stat st;

	assert_non_null(f);
	fstat(fileno(f), &st);
	unsigned char *v = malloc((size_t)st.st_size + 1);
	*n = fread(v, 1, (size_t)st.st_size, f);
	fclose(f);
	return v;
}

static inline void spill_file(const char *path, const void *v, size_t n)
{
	FILE *f = fopen(path, "wb");

	assert_non_null(f);
	assert_int_equal(fwrite(v, 1, n, f), n);
	fclose(f);
}

static inline bool same_files(const char *a, const char *b)
{
	size_t na, nb;
	unsigned char *va = slurp_file(a, &na), *vb = slurp_file(b, &nb);
	bool same = na == nb && memcmp(va, vb, na) == 0;

	free(va);
	free(vb);
	return same;
}

/* A raw channel with the given pixels, h * w values of type. */
static inline void add_raw(struct gd_image *im, const char *name, enum gd_type type, const void *v)
{
	struct gd_err err = { 0 };
	size_t n = (size_t)im->w * (size_t)im->h * (type == GD_HALF ? 2u : 4u);

	assert_int_equal(gd_image_append(im, name, type, &err), GD_OK);
	im->chan[im->nchan - 1].raw = malloc(n);
	memcpy(im->chan[im->nchan - 1].raw, v, n);
}

/* A directory of its own for a test program, removed by leave_temp(). */
static inline char *enter_temp(void)
{
	static char dir[] = "/tmp/gd-test-XXXXXX";

	assert_non_null(mkdtemp(dir));
	assert_int_equal(chdir(dir), 0);
	return dir;
}

static inline int leave_temp(const char *dir)
{
	char command[200];

	snprintf(command, sizeof command, "rm -rf '%s'", dir);
	return chdir("/") != 0 || system(command) != 0;
}

/* Files in the current directory, hidden ones too. */
static inline int count_files(void)
{
	FILE *p = popen("ls -A | wc -l", "r");
	int n = -1;

	assert_non_null(p);
	assert_int_equal(fscanf(p, "%d", &n), 1);
	pclose(p);
	return n;
}

#endif
