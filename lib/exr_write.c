/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Writing. The library makes the header (required attributes; ours are put in behind them as they
 * are) and compresses; rows are packed and chunks are laid out here, because the library can only
 * write to what it can seek in, packs under a lock, and since an uncompressed picture's table of
 * contents is known beforehand: that goes straight into a pipe. Layout: header, offsets of all
 * chunks, chunks of { row, bytes, data } from the top.
 */
#include "exr.h"

#include <openexr.h>
#include <stdlib.h>
#include <string.h>

#include "exr_header.h"
#include "output.h"
#include "turn.h"

#define ZIP_LEVEL	4		/* nearly the size of level 6 for half the time */
#define LEADER		8		/* bytes before a chunk's data */
#define SMALL		((size_t)256 << 10)	/* bytes; done before threads wake up */
#define RAW_BYTES	((size_t)1 << 20)	/* uncompressed rows handed over at a time */

struct writer {
	const struct gd_image *im;
	const char *label;
	exr_context_t ctx;
	const struct gd_channel **chan;		/* in the order of the file */
	struct gd_bytes head;
	uint64_t *offset;			/* of each chunk */
	int nchunk, rows;			/* rows per chunk */
	size_t row_bytes;
	bool raw;				/* not compressed */
	struct gd_output *out;
};

static void quiet(exr_const_context_t ctx, exr_result_t code, const char *text)
{
	(void)ctx;
	(void)code;
	(void)text;
}

/* Catches what the library writes: the header. */
static int64_t write_fn(exr_const_context_t ctx, void *user, const void *buf, uint64_t n,
			uint64_t offset, exr_stream_error_func_ptr_t error)
{
	struct writer *w = user;

	(void)ctx;
	(void)error;
	if (offset != w->head.n || gd_bytes_add(&w->head, buf, n, NULL) != GD_OK)
		return -1;
	return (int64_t)n;
}

static int fail_library(const struct writer *w, exr_result_t code, struct gd_err *err)
{
	return gd_fail(err, code == EXR_ERR_OUT_OF_MEMORY ? GD_ENOMEM : GD_EIO, "%s: %s", w->label,
		       exr_get_default_error_message(code));
}

static enum gd_type written_type(const struct gd_channel *c)
{
	return c->v ? GD_FLOAT : c->type;
}

static size_t written_bytes(const struct gd_channel *c)
{
	return written_type(c) == GD_HALF ? 2 : 4;
}

static bool has_pixels(const struct gd_channel *c)
{
	return c->want != GD_DROP && (c->v || c->raw);
}

/* Long names need a flag that some readers do not know: only where there are any. */
static bool has_long_names(const struct gd_image *im)
{
	for (int i = 0; i < im->nchan; i++)
		if (has_pixels(&im->chan[i]) && strlen(im->chan[i].name) > GD_EXR_SHORT)
			return true;
	for (int i = 0; i < im->nattr; i++)
		if (strlen(im->attr[i].name) > GD_EXR_SHORT ||
		    strlen(im->attr[i].type) > GD_EXR_SHORT)
			return true;
	return false;
}

/* Floats of a required attribute that the image may carry, else their default. */
static void required_floats(const struct gd_image *im, const char *name, const char *type, float *v,
			    size_t n)
{
	const struct gd_attr *a = gd_attr_find(im, name);

	if (a && strcmp(a->type, type) == 0 && a->size == n * sizeof(*v))
		memcpy(v, a->data, a->size);
}

static bool is_required(const char *name)
{
	return strcmp(name, "pixelAspectRatio") == 0 || strcmp(name, "screenWindowCenter") == 0 ||
	       strcmp(name, "screenWindowWidth") == 0;
}

static exr_result_t required_attrs(struct writer *w, enum gd_compression compression)
{
	static const exr_compression_t code[] = { EXR_COMPRESSION_NONE, EXR_COMPRESSION_RLE,
						  EXR_COMPRESSION_ZIPS, EXR_COMPRESSION_ZIP,
						  EXR_COMPRESSION_PIZ };
	const struct gd_box *d = &w->im->data, *s = &w->im->display;
	exr_attr_box2i_t data = {.min = {.x = d->x0, .y = d->y0}, .max = {.x = d->x1, .y = d->y1}};
	exr_attr_box2i_t display = {.min = {.x = s->x0, .y = s->y0},
				    .max = {.x = s->x1, .y = s->y1}};
	float aspect = 1, width = 1, center[2] = { 0, 0 };

	required_floats(w->im, "pixelAspectRatio", "float", &aspect, 1);
	required_floats(w->im, "screenWindowWidth", "float", &width, 1);
	required_floats(w->im, "screenWindowCenter", "v2f", center, 2);
	exr_attr_v2f_t c = { .x = center[0], .y = center[1] };
	return exr_initialize_required_attr(w->ctx, 0, &display, &data, aspect, &c, width,
					    EXR_LINEORDER_INCREASING_Y, code[compression]);
}

static int add_channels(struct writer *w, struct gd_err *err)
{
	static const exr_pixel_type_t type[] = { EXR_PIXEL_UINT, EXR_PIXEL_HALF, EXR_PIXEL_FLOAT };
	int n = 0;

	for (int i = 0; i < w->im->nchan; i++) {
		const struct gd_channel *c = &w->im->chan[i];
		if (!has_pixels(c))
			continue;
		if (strlen(c->name) > GD_EXR_NAME)
			return gd_fail(err, GD_ESHAPE,
				       "%s: channel %.32s...: name of %zu bytes, the limit is %d",
				       w->label, c->name, strlen(c->name), GD_EXR_NAME);
		exr_result_t code = exr_add_channel(w->ctx, 0, c->name, type[written_type(c)],
						    EXR_PERCEPTUALLY_LOGARITHMIC, 1, 1);
		if (code != EXR_ERR_SUCCESS)
			return gd_fail(err, GD_ESHAPE, "%s: channel %s: %s", w->label, c->name,
				       exr_get_default_error_message(code));
		n++;
	}
	return n ? GD_OK : gd_fail(err, GD_ESHAPE, "%s: no channel to write", w->label);
}

/* The library sorts channels by name; pixels must come in its order. */
static int order_channels(struct writer *w, struct gd_err *err)
{
	const exr_attr_chlist_t *list = NULL;
	exr_result_t code = exr_get_channels(w->ctx, 0, &list);

	if (code != EXR_ERR_SUCCESS)
		return fail_library(w, code, err);
	w->chan = calloc((size_t)list->num_channels + 1, sizeof(*w->chan));
	if (!w->chan)
		return gd_fail(err, GD_ENOMEM, "%s: out of memory", w->label);
	for (int c = 0; c < list->num_channels; c++) {
		w->chan[c] = &w->im->chan[gd_image_find(w->im, list->entries[c].name.str)];
		w->row_bytes += (size_t)w->im->w * written_bytes(w->chan[c]);
	}
	return GD_OK;
}

/* Ends the header: the library's, then the image's own attributes, then the final zero byte. */
static int finish_header(struct writer *w, struct gd_err *err)
{
	int rc = GD_OK;

	w->head.n--;
	for (int i = 0; i < w->im->nattr && rc == GD_OK; i++) {
		const struct gd_attr *a = &w->im->attr[i];
		if (!gd_exr_structural(a->name) && !is_required(a->name))
			rc = gd_bytes_attr(&w->head, a, err);
	}
	return rc == GD_OK ? gd_bytes_add(&w->head, "", 1, err) : rc;
}

static int make_header(struct writer *w, enum gd_compression compression, struct gd_err *err)
{
	exr_context_initializer_t init = EXR_DEFAULT_CONTEXT_INITIALIZER;
	exr_result_t code;
	int32_t rows = 0;
	int part, rc;

	init.error_handler_fn = quiet;
	init.user_data = w;
	init.write_fn = write_fn;
	init.zip_level = ZIP_LEVEL;
	code = exr_start_write(&w->ctx, w->label, EXR_WRITE_FILE_DIRECTLY, &init);
	if (code == EXR_ERR_SUCCESS && has_long_names(w->im))
		code = exr_set_longname_support(w->ctx, 1);
	if (code == EXR_ERR_SUCCESS)
		code = exr_add_part(w->ctx, NULL, EXR_STORAGE_SCANLINE, &part);
	if (code == EXR_ERR_SUCCESS)
		code = required_attrs(w, compression);
	if (code != EXR_ERR_SUCCESS)
		return fail_library(w, code, err);
	rc = add_channels(w, err);
	if (rc != GD_OK)
		return rc;
	code = exr_write_header(w->ctx);
	if (code == EXR_ERR_SUCCESS)
		code = exr_get_scanlines_per_chunk(w->ctx, 0, &rows);
	if (code != EXR_ERR_SUCCESS || rows < 1)
		return fail_library(w, code, err);
	w->rows = rows;
	w->nchunk = (w->im->h + rows - 1) / rows;
	w->raw = compression == GD_NONE;
	rc = order_channels(w, err);
	if (rc == GD_OK && w->row_bytes * (size_t)rows > INT32_MAX)
		rc = gd_fail(err, GD_ESHAPE,
			     "%s: %zu bytes in a chunk of %d rows, the limit is %d: "
			     "try another compression",
			     w->label, w->row_bytes * (size_t)rows, rows, INT32_MAX);
	return rc == GD_OK ? finish_header(w, err) : rc;
}

/* Row y of the image as it is in the file. */
static unsigned char *pack_row(const struct writer *w, unsigned char *out, int y)
{
	size_t stride = gd_stride(w->im->w);

	for (int c = 0; w->chan[c]; c++) {
		size_t n = (size_t)w->im->w * written_bytes(w->chan[c]);
		if (w->chan[c]->v)
			memcpy(out, w->chan[c]->v + (size_t)y * stride, n);
		else
			memcpy(out, w->chan[c]->raw + (size_t)y * n, n);
		out += n;
	}
	return out;
}

static unsigned char *pack_leader(const struct writer *w, unsigned char *out, int chunk,
				  size_t bytes)
{
	int32_t leader[2] = { w->im->data.y0 + chunk * w->rows, (int32_t)bytes };

	memcpy(out, leader, sizeof leader);
	return out + sizeof leader;
}

static int rows_of(const struct writer *w, int chunk)
{
	int left = w->im->h - chunk * w->rows;

	return left < w->rows ? left : w->rows;
}

static uint64_t table_bytes(const struct writer *w)
{
	return (uint64_t)w->nchunk * sizeof(*w->offset);
}

/*
 * Uncompressed: one row is one chunk and all have one size, so that the table comes first. Rows are
 * packed in groups on all threads and handed over in their order.
 */
static int write_raw(struct writer *w, struct gd_err *err)
{
	uint64_t at = w->head.n + table_bytes(w), size = LEADER + w->row_bytes;
	int group = (int)(RAW_BYTES / size) + 1, ngroup = (w->nchunk + group - 1) / group, rc;
	struct gd_turn turn = GD_TURN_START;

	for (int i = 0; i < w->nchunk; i++)
		w->offset[i] = at + (uint64_t)i * size;
	rc = gd_output_add(w->out, w->head.v, w->head.n, err);
	if (rc == GD_OK)
		rc = gd_output_add(w->out, w->offset, table_bytes(w), err);
	if (rc != GD_OK)
		return rc;
#pragma omp parallel if ((size_t)w->im->h * w->row_bytes > SMALL)
	{
		unsigned char *buf = malloc((size_t)group * size);
#pragma omp for schedule(monotonic : dynamic, 1)
		for (int g = 0; g < ngroup; g++) {
			unsigned char *end = buf;
			for (int y = g * group; buf && y < (g + 1) * group && y < w->nchunk; y++)
				end = pack_row(w, pack_leader(w, end, y, w->row_bytes), y);
			gd_turn_wait(&turn, g);
			if (!buf && rc == GD_OK)
				rc = gd_fail(err, GD_ENOMEM, "%s: out of memory", w->label);
			if (rc == GD_OK)
				rc = gd_output_add(w->out, buf, (size_t)(end - buf), err);
			gd_turn_pass(&turn);
		}
		free(buf);
	}
	return rc;
}

/* Compresses a packed chunk; *data is the smaller of both forms. */
static exr_result_t compress(struct writer *w, exr_encode_pipeline_t *pipe, int chunk,
			     unsigned char *packed, size_t bytes, const void **data, size_t *n)
{
	exr_chunk_info_t info;
	exr_result_t code;

	code = exr_write_scanline_chunk_info(w->ctx, 0, w->im->data.y0 + chunk * w->rows, &info);
	if (code == EXR_ERR_SUCCESS && !pipe->context) {
		code = exr_encoding_initialize(w->ctx, 0, &info, pipe);
		if (code == EXR_ERR_SUCCESS)
			code = exr_encoding_choose_default_routines(w->ctx, 0, pipe);
	} else if (code == EXR_ERR_SUCCESS) {
		code = exr_encoding_update(w->ctx, 0, &info, pipe);
	}
	if (code != EXR_ERR_SUCCESS)
		return code;
	pipe->packed_buffer = packed;
	pipe->packed_bytes = bytes;
	pipe->packed_alloc_size = bytes;
	code = pipe->compress_fn(pipe);
	/*
	 * A reader takes a chunk of its full size for uncompressed. The library stores a deflated
	 * one that happens to have exactly that size, which would come back as noise.
	 */
	bool shrunk = pipe->compressed_bytes < bytes;
	*data = shrunk ? pipe->compressed_buffer : packed;
	*n = shrunk ? pipe->compressed_bytes : bytes;
	pipe->packed_buffer = NULL;	/* ours */
	pipe->packed_alloc_size = 0;
	return code;
}

static int add_chunk(struct writer *w, int chunk, const void *data, size_t n, struct gd_err *err)
{
	unsigned char leader[LEADER];
	int rc;

	pack_leader(w, leader, chunk, n);
	w->offset[chunk] = gd_output_size(w->out);
	rc = gd_output_add(w->out, leader, sizeof leader, err);
	return rc == GD_OK ? gd_output_add(w->out, data, n, err) : rc;
}

static int write_compressed(struct writer *w, struct gd_err *err)
{
	struct gd_turn turn = GD_TURN_START;
	int rc = gd_output_add(w->out, w->head.v, w->head.n, err);

	if (rc == GD_OK)	/* not yet known */
		rc = gd_output_add(w->out, w->offset, table_bytes(w), err);
	if (rc != GD_OK)
		return rc;
#pragma omp parallel if ((size_t)w->im->h * w->row_bytes > SMALL)
	{
		exr_encode_pipeline_t pipe = EXR_ENCODE_PIPELINE_INITIALIZER;
		unsigned char *packed = malloc((size_t)w->rows * w->row_bytes);
#pragma omp for schedule(monotonic : dynamic, 1)
		for (int i = 0; i < w->nchunk; i++) {
			exr_result_t code = packed ? EXR_ERR_SUCCESS : EXR_ERR_OUT_OF_MEMORY;
			unsigned char *end = packed;
			const void *data = NULL;
			size_t n = 0;
			for (int y = 0; packed && y < rows_of(w, i); y++)
				end = pack_row(w, end, i * w->rows + y);
			if (packed)
				code = compress(w, &pipe, i, packed, (size_t)(end - packed), &data,
						&n);
			gd_turn_wait(&turn, i);
			if (code != EXR_ERR_SUCCESS && rc == GD_OK)
				rc = fail_library(w, code, err);
			if (rc == GD_OK)
				rc = add_chunk(w, i, data, n, err);
			gd_turn_pass(&turn);
		}
		exr_encoding_destroy(w->ctx, &pipe);
		free(packed);
	}
	if (rc == GD_OK)
		rc = gd_output_patch(w->out, w->offset, table_bytes(w), w->head.n, err);
	return rc;
}

static int check_image(const struct gd_image *im, const char *label, struct gd_err *err)
{
	int64_t w = (int64_t)im->data.x1 - im->data.x0 + 1,
		h = (int64_t)im->data.y1 - im->data.y0 + 1;

	if (im->w < 1 || im->h < 1 || im->w > GD_MAX_SIDE || im->h > GD_MAX_SIDE)
		return gd_fail(err, GD_ESHAPE, "%s: %dx%d pixels, expected 1 to %d on a side",
			       label, im->w, im->h, GD_MAX_SIDE);
	if (w != im->w || h != im->h)
		return gd_fail(err, GD_ESHAPE, "%s: %dx%d pixels, but a data window of %lldx%lld",
			       label, im->w, im->h, (long long)w, (long long)h);
	return GD_OK;
}

int gd_exr_write(const struct gd_image *im, const char *path, const struct gd_write_conf *conf,
		 struct gd_err *err)
{
	enum gd_compression compression = conf ? conf->compression : GD_NONE;
	struct writer w = { .im = im, .label = strcmp(path, "-") && *path ? path : "stdout" };
	int rc = check_image(im, w.label, err);

	if (rc == GD_OK)
		rc = make_header(&w, compression, err);
	if (rc == GD_OK && !(w.offset = calloc((size_t)w.nchunk, sizeof(*w.offset))))
		rc = gd_fail(err, GD_ENOMEM, "%s: out of memory", w.label);
	if (rc == GD_OK)
		rc = gd_output_open(&w.out, path, w.raw, err);
	if (rc == GD_OK)
		rc = w.raw ? write_raw(&w, err) : write_compressed(&w, err);
	if (rc == GD_OK)
		rc = gd_output_commit(w.out, err);
	gd_output_close(w.out);
	if (w.ctx)
		exr_finish(&w.ctx);
	free(w.offset);
	free(w.chan);
	free(w.head.v);
	return rc;
}
