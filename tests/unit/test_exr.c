/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Reading: every layout, codec and type against files made and decoded by OpenEXR's own routines.
 */
#include "exr_make.h"

#include <omp.h>
#include <sys/resource.h>
#include <sys/wait.h>

static char *temp_dir;

static int setup(void **state)
{
	(void)state;
	temp_dir = enter_temp();
	return 0;
}

static int teardown(void **state)
{
	(void)state;
	return leave_temp(temp_dir);
}

static float float_of_half(uint32_t h)
{
	int e = (int)(h >> 10 & 31), m = (int)(h & 1023);
	double v = e == 0    ? ldexp(m, -24)
		   : e == 31 ? (m ? (double)NAN : (double)INFINITY)
			     : ldexp(1024 + m, e - 25);

	return (float)(h >> 15 ? -v : v);
}

static float float_of(exr_pixel_type_t type, uint32_t bits)
{
	float f;

	if (type == EXR_PIXEL_UINT)
		return (float)bits;
	if (type == EXR_PIXEL_HALF)
		return float_of_half(bits);
	memcpy(&f, &bits, sizeof f);
	return f;
}

/* Checks a channel in either form against make_bits(). */
static void check_channel(const struct gd_image *im, const struct make_part *p, int c)
{
	int i = gd_image_find(im, p->chan[c].name);
	exr_pixel_type_t type = p->chan[c].type;
	size_t bytes = type == EXR_PIXEL_HALF ? 2 : 4, stride = gd_stride(im->w);

	assert_true(i >= 0);
	const struct gd_channel *k = &im->chan[i];
	assert_int_equal(k->type, type == EXR_PIXEL_HALF   ? GD_HALF
				  : type == EXR_PIXEL_UINT ? GD_UINT
							   : GD_FLOAT);
	assert_true((k->v != NULL) != (k->raw != NULL));
	for (int y = 0; y < im->h; y++) {
		for (int x = 0; x < im->w; x++) {
			uint32_t want = make_bits(type, c, x, y), got = 0;
			if (k->raw)
				memcpy(&got,
				       k->raw + bytes * ((size_t)y * (size_t)im->w + (size_t)x),
				       bytes);
			if (k->raw && got != want)
				fail_msg("%s at %d,%d: %08x, expected %08x", k->name, x, y, got,
					 want);
			if (k->v && k->v[(size_t)y * stride + (size_t)x] != float_of(type, want))
				fail_msg("%s at %d,%d: %g, expected %g", k->name, x, y,
					 (double)k->v[(size_t)y * stride + (size_t)x],
					 (double)float_of(type, want));
		}
		for (size_t x = (size_t)im->w; k->v && x < stride; x++)
			assert_true(k->v[(size_t)y * stride + x] == 0);
	}
}

static void check_image(const struct gd_image *im, const struct make_part *p)
{
	assert_int_equal(im->nchan, p->nchan);
	assert_int_equal(im->w, p->data.max.x - p->data.min.x + 1);
	assert_int_equal(im->h, p->data.max.y - p->data.min.y + 1);
	assert_true(im->data.x0 == p->data.min.x && im->data.y0 == p->data.min.y);
	assert_true(im->data.x1 == p->data.max.x && im->data.y1 == p->data.max.y);
	assert_true(im->display.x0 == p->display.min.x && im->display.y1 == p->display.max.y);
	for (int c = 0; c < p->nchan; c++)
		check_channel(im, p, c);
}

static void read_three_ways(const struct make_part *p)
{
	struct gd_err err = { 0 };
	struct gd_image im;

	make_exr("in.exr", p, 1, false);
	for (int want = GD_PASS; want <= GD_READ; want++) {
		read_ok(&im, "in.exr", 0, want);
		check_image(&im, p);
		gd_image_free(&im);
		if (read_piped(&im, "in.exr", want, &err) != GD_OK)
			fail_msg("%s", err.text);
		check_image(&im, p);
		gd_image_free(&im);
	}
}

/* The lossless codecs, rows and tiles, both row orders, from files and from pipes. */
static void test_lossless(void **state)
{
	(void)state;
	for (int k = EXR_COMPRESSION_NONE; k <= EXR_COMPRESSION_PIZ; k++)
		for (int tiled = 0; tiled < 2; tiled++)
			for (int order = 0; order <= !tiled; order++) {
				struct make_part p = make_plain();
				p.compression = (exr_compression_t)k;
				p.storage = tiled ? EXR_STORAGE_TILED : EXR_STORAGE_SCANLINE;
				p.order = order ? EXR_LINEORDER_DECREASING_Y
						: EXR_LINEORDER_INCREASING_Y;
				read_three_ways(&p);
			}
}

/* Decodes a channel by the library's own routines, in its own type. */
static void *library_channel(const char *path, const char *name, size_t *bytes)
{
	exr_context_initializer_t init = EXR_DEFAULT_CONTEXT_INITIALIZER;
	exr_attr_box2i_t box;
	exr_context_t ctx;
	int step;

	init.error_handler_fn = make_quiet;
	make_ok(exr_start_read(&ctx, path, &init));
	make_ok(exr_get_data_window(ctx, 0, &box));
	make_ok(exr_get_scanlines_per_chunk(ctx, 0, &step));
	int w = box.max.x - box.min.x + 1, h = box.max.y - box.min.y + 1;
	uint8_t *v = calloc((size_t)w * (size_t)h, 4);
	for (int y = 0; y < h; y += step) {
		exr_decode_pipeline_t dec = EXR_DECODE_PIPELINE_INITIALIZER;
		exr_chunk_info_t info;
		make_ok(exr_read_scanline_chunk_info(ctx, 0, box.min.y + y, &info));
		make_ok(exr_decoding_initialize(ctx, 0, &info, &dec));
		for (int c = 0; c < dec.channel_count; c++) {
			exr_coding_channel_info_t *k = &dec.channels[c];
			k->user_pixel_stride = k->bytes_per_element;
			k->user_line_stride = w * k->bytes_per_element;
			if (strcmp(k->channel_name, name) != 0)
				continue;
			*bytes = (size_t)k->bytes_per_element;
			k->decode_to_ptr = v + (size_t)y * (size_t)w * *bytes;
		}
		make_ok(exr_decoding_choose_default_routines(ctx, 0, &dec));
		make_ok(exr_decoding_run(ctx, 0, &dec));
		make_ok(exr_decoding_destroy(ctx, &dec));
	}
	exr_finish(&ctx);
	*bytes *= (size_t)w * (size_t)h;
	return v;
}

static void test_lossy(void **state)
{
	(void)state;
	for (int k = EXR_COMPRESSION_PXR24; k <= EXR_COMPRESSION_B44A; k++) {
		struct make_part p = make_plain();
		struct gd_image im;
		p.compression = (exr_compression_t)k;
		make_exr("in.exr", &p, 1, false);
		read_ok(&im, "in.exr", 0, GD_PASS);
		for (int c = 0; c < im.nchan; c++) {
			size_t bytes = 0;
			void *truth = library_channel("in.exr", im.chan[c].name, &bytes);
			assert_true(bytes > 0);
			assert_memory_equal(im.chan[c].raw, truth, bytes);
			free(truth);
		}
		gd_image_free(&im);
	}
}

static void test_half_values(void **state)
{
	struct gd_err err = { 0 };
	struct gd_image im, back;
	uint16_t all[65536];

	(void)state;
	for (int i = 0; i < 65536; i++)
		all[i] = (uint16_t)i;
	gd_image_init(&im, 256, 256);
	add_raw(&im, "h", GD_HALF, all);
	assert_int_equal(gd_exr_write(&im, "half.exr", NULL, &err), GD_OK);
	read_ok(&back, "half.exr", 0, GD_READ);
	for (int i = 0; i < 65536; i++) {
		float want = float_of_half((uint32_t)i),
		      got = back.chan[0].v[(size_t)(i / 256) * gd_stride(256) + (size_t)(i % 256)];
		assert_true(isnan(want) ? isnan(got)
					: want == got && signbit(want) == signbit(got));
	}
	gd_image_free(&im);
	gd_image_free(&back);
}

static void test_windows(void **state)
{
	static const int at[][4] = {{-7, -9, 100, 200}, {5, 1000, 0, 0}, {-100000, 7, -3, -3}};

	(void)state;
	for (size_t i = 0; i < 3; i++)
		for (int tiled = 0; tiled < 2; tiled++) {
			struct make_part p = make_plain();
			p.data = make_box(at[i][0], at[i][1], at[i][0] + 30, at[i][1] + 40);
			p.display = make_box(at[i][2], at[i][3], at[i][2] + 64, at[i][3] + 64);
			p.storage = tiled ? EXR_STORAGE_TILED : EXR_STORAGE_SCANLINE;
			p.compression = EXR_COMPRESSION_ZIP;
			read_three_ways(&p);
		}
}

static void test_sizes(void **state)
{
	static const int size[][2] = { { 1, 1 }, { 1, 37 }, { 41, 1 }, { 16, 16 }, { 17, 33 } };

	(void)state;
	for (size_t i = 0; i < 5; i++)
		for (int k = 0; k <= EXR_COMPRESSION_PIZ; k++)
			for (int tiled = 0; tiled < 2; tiled++) {
				struct make_part p = make_plain();
				p.data = p.display = make_box(0, 0, size[i][0] - 1, size[i][1] - 1);
				p.storage = tiled ? EXR_STORAGE_TILED : EXR_STORAGE_SCANLINE;
				p.compression = (exr_compression_t)k;
				read_three_ways(&p);
			}
}

static void test_mip_maps(void **state)
{
	struct make_part p = make_plain();
	struct gd_image im;

	(void)state;
	p.storage = EXR_STORAGE_TILED;
	p.compression = EXR_COMPRESSION_ZIPS;
	p.mip = 1;
	make_exr("mip.exr", &p, 1, false);
	read_ok(&im, "mip.exr", 0, GD_READ);
	check_image(&im, &p);
	gd_image_free(&im);
}

static void test_parts(void **state)
{
	struct make_part p[3] = { make_plain(), make_plain(), make_plain() };
	struct gd_err err = { 0 };
	struct gd_image im;

	(void)state;
	p[0].name = "left";
	p[1].name = "right";
	p[1].data = make_box(3, -4, 22, 19);
	p[1].nchan = 2;
	p[1].storage = EXR_STORAGE_TILED;
	p[1].compression = EXR_COMPRESSION_RLE;
	p[2].name = "last";
	p[2].compression = EXR_COMPRESSION_PIZ;
	make_exr("parts.exr", p, 3, false);
	for (int i = 0; i < 3; i++) {
		read_ok(&im, "parts.exr", i, GD_PASS);
		check_image(&im, &p[i]);
		assert_null(gd_attr_find(&im, "name"));
		assert_null(gd_attr_find(&im, "chunkCount"));
		gd_image_free(&im);
	}
	assert_int_equal(read_piped(&im, "parts.exr", GD_READ, &err), GD_OK);
	check_image(&im, &p[0]);
	gd_image_free(&im);
	assert_int_equal(read_all(&im, "parts.exr", 3, GD_PASS, &err), GD_EARG);
	assert_string_equal(err.text, "parts.exr: no part 3, parts are 0 to 2");
}

static void test_refused(void **state)
{
	struct make_part p = make_plain();
	struct gd_err err = { 0 };
	struct gd_image im = { 0 };

	(void)state;
	p.nchan = 3;
	p.chan[1].sampling = 2;
	p.data = p.display = make_box(0, 0, 35, 69);
	make_exr("sub.exr", &p, 1, true);
	assert_int_equal(read_all(&im, "sub.exr", 0, GD_READ, &err), GD_EFORMAT);
	assert_string_equal(err.text, "sub.exr: channel N.X is sub-sampled (2x2), expected 1x1");
	p = make_plain();
	p.storage = EXR_STORAGE_DEEP_SCANLINE;
	make_exr("deep.exr", &p, 1, true);
	err = (struct gd_err){ 0 };
	assert_int_equal(read_all(&im, "deep.exr", 0, GD_READ, &err), GD_EFORMAT);
	assert_string_equal(err.text, "deep.exr: deep images are not supported");
	err = (struct gd_err){ 0 };
	assert_int_equal(read_all(&im, "none.exr", 0, GD_READ, &err), GD_EIO);
	assert_string_equal(err.text, "none.exr: No such file or directory");
	err = (struct gd_err){ 0 };
	assert_int_equal(read_all(&im, ".", 0, GD_READ, &err), GD_EIO);
	spill_file("empty.exr", "", 0);
	err = (struct gd_err){ 0 };
	assert_int_equal(read_all(&im, "empty.exr", 0, GD_READ, &err), GD_EFORMAT);
	assert_string_equal(err.text, "empty.exr: empty");
	assert_int_equal(im.nchan, 0);
}

/* The layout on which the library's own unpacking follows a null pointer: 3 or 4 half channels. */
static void test_skipped_half(void **state)
{
	(void)state;
	for (int n = 3; n <= 4; n++)
		for (int skip = 0; skip < n; skip++)
			for (int k = 0; k <= EXR_COMPRESSION_ZIP; k += 3) {
				struct make_part p = make_plain();
				struct gd_err err = { 0 };
				struct gd_image im = { 0 };
				struct gd_exr *file;
				p.nchan = n;
				p.compression = (exr_compression_t)k;
				for (int c = 0; c < 4; c++)
					p.chan[c] = (struct make_channel){&"R\0G\0B\0A"[2 * c],
									  EXR_PIXEL_HALF, 1};
				make_exr("rgba.exr", &p, 1, false);
				assert_int_equal(gd_exr_open(&file, &im, "rgba.exr", NULL, &err),
						 GD_OK);
				for (int c = 0; c < n; c++)
					im.chan[c].want = GD_READ;
				im.chan[gd_image_find(&im, p.chan[skip].name)].want = GD_DROP;
				assert_int_equal(gd_exr_load(file, &im, &err), GD_OK);
				gd_exr_close(file);
				assert_int_equal(im.nchan, n - 1);
				for (int c = 0; c < n; c++)
					if (c != skip)
						check_channel(&im, &p, c);
				gd_image_free(&im);
			}
}

/* What compresses best is not taken for a false claim. */
static void test_constant(void **state)
{
	(void)state;
	for (int k = EXR_COMPRESSION_NONE; k <= EXR_COMPRESSION_PIZ; k++) {
		struct gd_write_conf conf = { (enum gd_compression)k };
		struct gd_err err = { 0 };
		struct gd_image im, back;
		gd_image_init(&im, 20000, 64);
		for (int c = 0; c < 4; c++)
			assert_int_equal(
				gd_image_add(&im, (char[2]){(char)('A' + c), 0}, NULL, &err),
				GD_OK);
		assert_int_equal(gd_exr_write(&im, "zero.exr", &conf, &err), GD_OK);
		read_ok(&back, "zero.exr", 0, GD_READ);
		for (int c = 0; c < 4; c++)
			assert_memory_equal(back.chan[c].v, im.chan[c].v,
					    64 * gd_stride(20000) * sizeof(float));
		gd_image_free(&back);
		gd_image_free(&im);
	}
}

static void extra_attributes(exr_context_t ctx, int part)
{
	static const unsigned char blob[] = { 0, 1, 2, 255, 10, 0, 7 };
	exr_attr_chromaticities_t chroma = { 0.7f, 0.3f, 0.2f, 0.8f, 0.1f, 0.05f, 0.3f, 0.33f };
	exr_attr_preview_t preview = { .width = 1, .height = 1, .rgba = blob };
	const char *views[] = { "left", "", "right" };
	float list[] = { 1.5f, NAN, -0.0f };

	make_ok(exr_attr_set_user(ctx, part, "deepImageState", "myType", sizeof blob, blob));
	make_ok(exr_attr_set_chromaticities(ctx, part, "chromaticities", &chroma));
	make_ok(exr_attr_set_string(ctx, part, "owner", "line\nline \xc3\xa9"));
	make_ok(exr_attr_set_string_vector(ctx, part, "multiView", 3, views));
	make_ok(exr_attr_set_float_vector(ctx, part, "list", 3, list));
	make_ok(exr_attr_set_preview(ctx, part, "preview", &preview));
	make_ok(exr_attr_set_double(ctx, part, "dbl", 1e300));
	make_ok(exr_attr_set_int(ctx, part,
				 "an attribute whose name is longer than thirty-one bytes", -5));
}

static const struct gd_attr *need_attr(const struct gd_image *im, const char *name,
				       const char *type, size_t size)
{
	const struct gd_attr *a = gd_attr_find(im, name);

	assert_non_null(a);
	assert_string_equal(a->type, type);
	assert_int_equal(a->size, size);
	return a;
}

/* Attributes come through two generations as they are, but for those that describe the file. */
static void test_attributes(void **state)
{
	static const char *const gone[] = {"tiles",	    "chunkCount",  "name",
					   "type",	    "channels",	   "dataWindow",
					   "displayWindow", "compression", "lineOrder"};
	struct make_part p[2] = { make_plain(), make_plain() };
	struct gd_err err = { 0 };
	struct gd_image im, back;
	float aspect;

	(void)state;
	p[0].name = "first";
	p[0].storage = EXR_STORAGE_TILED;
	p[0].extra = extra_attributes;
	p[1].name = "second";
	make_exr("attr.exr", p, 2, false);
	read_ok(&im, "attr.exr", 0, GD_PASS);
	assert_memory_equal(need_attr(&im, "deepImageState", "myType", 7)->data, "\0\1\2\377\n\0\7",
			    7);
	assert_int_equal(gd_attr_set(&im, "empty", "myEmpty", NULL, 0, &err), GD_OK);
	need_attr(&im, "chromaticities", "chromaticities", 32);
	assert_memory_equal(need_attr(&im, "owner", "string", 12)->data, "line\nline \xc3\xa9", 12);
	need_attr(&im, "multiView", "stringvector", 21);
	need_attr(&im, "list", "floatvector", 12);
	need_attr(&im, "preview", "preview", 12);
	need_attr(&im, "dbl", "double", 8);
	memcpy(&aspect, need_attr(&im, "pixelAspectRatio", "float", 4)->data, 4);
	assert_true(aspect == 1.5f);
	for (size_t i = 0; i < sizeof gone / sizeof *gone; i++)
		assert_null(gd_attr_find(&im, gone[i]));
	assert_int_equal(gd_exr_write(&im, "attr2.exr", NULL, &err), GD_OK);
	read_ok(&back, "attr2.exr", 0, GD_PASS);
	check_image(&back, &p[0]);
	assert_int_equal(back.nattr, im.nattr);
	for (int i = 0; i < im.nattr; i++) {
		const struct gd_attr *a = &im.attr[i];
		assert_memory_equal(need_attr(&back, a->name, a->type, a->size)->data, a->data,
				    a->size);
	}
	gd_image_free(&im);
	gd_image_free(&back);
}

/* A header larger than the first look at it. */
static void test_large_header(void **state)
{
	struct gd_err err = { 0 };
	struct gd_image im, back;
	size_t n = 3000000;
	unsigned char *blob = malloc(n);
	struct gd_plane p;

	(void)state;
	for (size_t i = 0; i < n; i++)
		blob[i] = (unsigned char)make_hash((uint32_t)i);
	gd_image_init(&im, 700, 1100);	/* the second look takes some rows along */
	assert_int_equal(gd_image_add(&im, "R", &p, &err), GD_OK);
	for (int y = 0; y < 1100; y++)
		for (int x = 0; x < 700; x++)
			gd_row(p, y)[x] = (float)(x + 1000 * y);
	assert_int_equal(gd_attr_set(&im, "blob", "blob", blob, n, &err), GD_OK);
	assert_int_equal(gd_attr_set_int(&im, "last", 3, &err), GD_OK);
	assert_int_equal(gd_exr_write(&im, "large.exr", NULL, &err), GD_OK);
	read_ok(&back, "large.exr", 0, GD_READ);
	assert_memory_equal(need_attr(&back, "blob", "blob", n)->data, blob, n);
	need_attr(&back, "last", "int", 4);
	gd_image_free(&back);
	assert_int_equal(read_piped(&back, "large.exr", GD_READ, &err), GD_OK);
	assert_memory_equal(need_attr(&back, "blob", "blob", n)->data, blob, n);
	assert_memory_equal(back.chan[0].v, p.v, 1100 * p.stride * sizeof(float));
	gd_image_free(&back);
	gd_image_free(&im);
	free(blob);
}

static void test_stdin_file(void **state)
{
	struct make_part p = make_plain();
	struct gd_image im;
	int keep = dup(0), fd;

	(void)state;
	make_exr("stdin.exr", &p, 1, false);
	fd = open("stdin.exr", O_RDONLY);
	dup2(fd, 0);
	read_ok(&im, "-", 0, GD_READ);
	check_image(&im, &p);
	gd_image_free(&im);
	dup2(keep, 0);
	close(fd);
	close(keep);
}

#ifdef __SANITIZE_ADDRESS__
#define MEMORY_SLACK	8	/* the sanitizer keeps what is freed */
#else
#define MEMORY_SLACK	1
#endif

static long child_kib(const char *path, enum gd_want want)
{
	struct rusage use;
	int status;
	pid_t child = fork();

	if (child == 0) {
		struct gd_err err = { 0 };
		struct gd_image im = { 0 };
		omp_set_num_threads(1);	/* the pool of threads is not there after fork */
		_exit(read_piped(&im, path, want, &err) != GD_OK);
	}
	assert_int_equal(wait4(child, &status, 0, &use), child);
	assert_int_equal(status, 0);
	return use.ru_maxrss;
}

/* Decoding a pipe takes the memory of the pixels, not that of the file as well. */
static void test_pipe_memory(void **state)
{
	enum { W = 1000, H = 1000, N = 12 };	/* 48 MB that RLE cannot shrink */
	struct gd_err err = { 0 };
	struct gd_image im;
	uint32_t *v = malloc((size_t)W * H * sizeof(*v));

	(void)state;
	gd_image_init(&im, W, H);
	for (int c = 0; c < N; c++) {
		for (int i = 0; i < W * H; i++)
			v[i] = make_hash((uint32_t)(i + c * W * H));
		add_raw(&im, (char[2]){ (char)('a' + c), 0 }, GD_UINT, v);
	}
	free(v);
	for (int k = GD_NONE; k <= GD_RLE; k++) {
		struct gd_write_conf conf = { (enum gd_compression)k };
		assert_int_equal(gd_exr_write(&im, k ? "rle.exr" : "raw.exr", &conf, &err), GD_OK);
	}
	gd_image_free(&im);
	make_seed("small.exr", EXR_COMPRESSION_NONE, false);
	for (int k = 0; k < 2; k++) {
		long all = child_kib(k ? "rle.exr" : "raw.exr", GD_PASS);
		long nothing = child_kib("small.exr", GD_PASS);
		assert_true(all - nothing < (W * H * N * 4 / 1024 + 12000) * MEMORY_SLACK);
	}
}

/* An endless pipe of something else is refused at its first bytes. */
static void test_endless(void **state)
{
	struct gd_err err = { 0 };
	struct gd_image im = { 0 };

	(void)state;
	assert_int_equal(read_piped(&im, "/dev/zero", GD_READ, &err), GD_EFORMAT);
	assert_string_equal(err.text, "stdin: not an OpenEXR file (a pipe must carry one)");
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_lossless),
		cmocka_unit_test(test_lossy),
		cmocka_unit_test(test_half_values),
		cmocka_unit_test(test_windows),
		cmocka_unit_test(test_sizes),
		cmocka_unit_test(test_mip_maps),
		cmocka_unit_test(test_parts),
		cmocka_unit_test(test_refused),
		cmocka_unit_test(test_skipped_half),
		cmocka_unit_test(test_constant),
		cmocka_unit_test(test_attributes),
		cmocka_unit_test(test_large_header),
		cmocka_unit_test(test_stdin_file),
		cmocka_unit_test(test_endless),
		cmocka_unit_test(test_pipe_memory),
	};

	return cmocka_run_group_tests(tests, setup, teardown);
}
