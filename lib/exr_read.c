/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Reading. The library parses the header, finds the chunks and decompresses them; rows are taken out
 * of a decompressed chunk here, because its own unpacking crashes on skipped channels of some layouts
 * and cannot leave a channel as it is. Every chunk is looked up before memory for pixels is taken, so
 * that a file too short for its header fails at once.
 */
#include "exr.h"

#include <openexr.h>
#include <stdlib.h>
#include <string.h>

#include "exr_header.h"
#include "input.h"
#include "plugin.h"

#pragma weak gd_plugin_check
#pragma weak gd_plugin_open
#pragma weak gd_plugin_load
#pragma weak gd_plugin_close

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "EXR is little-endian and so must we be");

#define MAGIC		"\x76\x2f\x31\x01"
#define MAX_RATIO	2048	/* no codec packs more into a byte: deflate's limit is 1032, PIZ's about 400 */

struct gd_exr {
	struct gd_input in;
	exr_context_t ctx;
	int part;
	exr_storage_t storage;
	exr_compression_t compression;
	struct gd_plugin_file *plugin;	/* pixels come from here if set */
	int nfile;			/* channels in the file, */
	char **name;			/* in the order of the file, */
	enum gd_type *type;		/* and their types */
	char message[200];		/* first complaint of the library */
};

/* Where the rows of a file's channel go. */
struct target {
	struct gd_channel *chan;	/* NULL: nowhere */
	enum gd_type type;
	size_t bytes;			/* per value in the file */
};

/* What the threads share while they decode. */
struct job {
	struct gd_exr *file;
	struct gd_image *im;
	struct target *target;		/* per channel of the file */
	exr_chunk_info_t *chunk;
	size_t nchunk;
	uint32_t tile_w, tile_h;	/* 0 in scanline files */
	size_t failed;			/* lowest chunk that failed, or SIZE_MAX */
	exr_result_t code;		/* and how */
};

static const char *const codec[] = { "uncompressed", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "B44A",
				     "DWAA", "DWAB" };

static size_t type_bytes(enum gd_type type)
{
	return type == GD_HALF ? 2 : 4;
}

/* Texts of the library may quote the file: nothing but printable ASCII goes on. */
static void keep_message(exr_const_context_t ctx, exr_result_t code, const char *text)
{
	void *user = NULL;

	(void)code;
	if (!ctx || exr_get_user_data(ctx, &user) != EXR_ERR_SUCCESS || !user)
		return;
	struct gd_exr *file = user;
	if (file->message[0])
		return;
	size_t n = 0;
	for (; text[n] && n < sizeof(file->message) - 1; n++)
		file->message[n] = text[n] >= ' ' && text[n] <= '~' ? text[n] : '?';
	file->message[n] = '\0';
}


static int64_t read_fn(exr_const_context_t ctx, void *user, void *buf, uint64_t n, uint64_t offset,
		       exr_stream_error_func_ptr_t error)
{
	struct gd_exr *file = user;

	(void)ctx;
	(void)error;
	return gd_input_read(&file->in, buf, n, offset);
}

static int64_t size_fn(exr_const_context_t ctx, void *user)
{
	struct gd_exr *file = user;

	(void)ctx;
	return (int64_t)file->in.size;
}

static int fail_library(struct gd_exr *file, exr_result_t code, struct gd_err *err)
{
	int status = code == EXR_ERR_OUT_OF_MEMORY ? GD_ENOMEM : code == EXR_ERR_READ_IO ? GD_EIO : GD_EFORMAT;
	const char *text = file->message[0] ? file->message : exr_get_default_error_message(code);

	return gd_fail(err, status, "%s: %s", file->in.label, text);
}

static bool is_exr(const unsigned char *head, size_t n)
{
	return n >= 4 && memcmp(head, MAGIC, 4) == 0;
}

/* An endless pipe of something else must not fill the memory before it is looked at. */
static int accept_pipe(const struct gd_input *in, const unsigned char *head, size_t n, struct gd_err *err)
{
	if (n == 0 || is_exr(head, n))
		return GD_OK;
	return gd_fail(err, GD_EFORMAT, "%s: not an OpenEXR file (a pipe must carry one)", in->label);
}

static int open_plugin(struct gd_exr *file, struct gd_image *im, struct gd_err *err)
{
	const struct gd_input *in = &file->in;

	if (!gd_plugin_open)
		return gd_fail(err, GD_EFORMAT, "%s: not an OpenEXR file", in->label);
	return gd_plugin_open(&file->plugin, im, in->mem ? "stdin.exr" : in->path, in->mem, in->size,
			      file->part, err);
}

static int parse_header(struct gd_exr *file, struct gd_err *err)
{
	exr_context_initializer_t init = EXR_DEFAULT_CONTEXT_INITIALIZER;
	exr_result_t code;

	init.error_handler_fn = keep_message;
	init.user_data = file;
	init.read_fn = read_fn;
	init.size_fn = size_fn;
	init.max_image_width = init.max_image_height = GD_MAX_SIDE;
	init.max_tile_width = init.max_tile_height = GD_MAX_SIDE;
	init.flags = EXR_CONTEXT_FLAG_DISABLE_CHUNK_RECONSTRUCTION;
	code = exr_start_read(&file->ctx, file->in.label, &init);
	return code == EXR_ERR_SUCCESS ? GD_OK : fail_library(file, code, err);
}

static int check_part(struct gd_exr *file, struct gd_err *err)
{
	exr_result_t code;
	int count = 0;

	code = exr_get_count(file->ctx, &count);
	if (code == EXR_ERR_SUCCESS && (file->part < 0 || file->part >= count))
		return gd_fail(err, GD_EARG, "%s: no part %d, parts are 0 to %d", file->in.label, file->part,
			       count - 1);
	if (code == EXR_ERR_SUCCESS)
		code = exr_get_storage(file->ctx, file->part, &file->storage);
	if (code == EXR_ERR_SUCCESS)
		code = exr_get_compression(file->ctx, file->part, &file->compression);
	if (code != EXR_ERR_SUCCESS)
		return fail_library(file, code, err);
	if (file->storage != EXR_STORAGE_SCANLINE && file->storage != EXR_STORAGE_TILED)
		return gd_fail(err, GD_EFORMAT, "%s: deep images are not supported", file->in.label);
	if (file->compression < 0 || file->compression >= EXR_COMPRESSION_LAST_TYPE)
		return gd_fail(err, GD_EFORMAT, "%s: unknown compression %d", file->in.label,
			       (int)file->compression);
	return GD_OK;
}

/* Both windows into im; the library has checked that they are not empty. */
static int read_windows(struct gd_exr *file, struct gd_image *im, struct gd_err *err)
{
	exr_attr_box2i_t data, display;
	exr_result_t code = exr_get_data_window(file->ctx, file->part, &data);

	if (code == EXR_ERR_SUCCESS)
		code = exr_get_display_window(file->ctx, file->part, &display);
	if (code != EXR_ERR_SUCCESS)
		return fail_library(file, code, err);
	int64_t w = (int64_t)data.max.x - data.min.x + 1, h = (int64_t)data.max.y - data.min.y + 1;
	if (w < 1 || h < 1 || w > GD_MAX_SIDE || h > GD_MAX_SIDE)
		return gd_fail(err, GD_EFORMAT, "%s: %lldx%lld pixels, expected 1 to %d on a side",
			       file->in.label, (long long)w, (long long)h, GD_MAX_SIDE);
	gd_image_init(im, (int)w, (int)h);
	im->data = (struct gd_box){ data.min.x, data.min.y, data.max.x, data.max.y };
	im->display = (struct gd_box){ display.min.x, display.min.y, display.max.x, display.max.y };
	return GD_OK;
}

static int read_channels(struct gd_exr *file, struct gd_image *im, struct gd_err *err)
{
	static const enum gd_type type[] = { GD_UINT, GD_HALF, GD_FLOAT };
	const exr_attr_chlist_t *list = NULL;
	exr_result_t code = exr_get_channels(file->ctx, file->part, &list);
	int rc = GD_OK;

	if (code != EXR_ERR_SUCCESS)
		return fail_library(file, code, err);
	if (list->num_channels < 1)
		return gd_fail(err, GD_EFORMAT, "%s: no channels", file->in.label);
	file->name = calloc((size_t)list->num_channels, sizeof(*file->name));
	file->type = calloc((size_t)list->num_channels, sizeof(*file->type));
	if (!file->name || !file->type)
		return gd_fail(err, GD_ENOMEM, "%s: out of memory", file->in.label);
	for (int c = 0; c < list->num_channels && rc == GD_OK; c++) {
		const exr_attr_chlist_entry_t *e = &list->entries[c];
		if (e->x_sampling != 1 || e->y_sampling != 1)
			return gd_fail(err, GD_EFORMAT, "%s: channel %s is sub-sampled (%dx%d), expected 1x1",
				       file->in.label, e->name.str, e->x_sampling, e->y_sampling);
		if (e->pixel_type < 0 || e->pixel_type > EXR_PIXEL_FLOAT)
			return gd_fail(err, GD_EFORMAT, "%s: channel %s has unknown type %d",
				       file->in.label, e->name.str, (int)e->pixel_type);
		rc = gd_image_append(im, e->name.str, type[e->pixel_type], err);
		if (rc == GD_OK && !(file->name[c] = strdup(e->name.str)))
			rc = gd_fail(err, GD_ENOMEM, "%s: out of memory", file->in.label);
		file->type[c] = type[e->pixel_type];
		file->nfile = c + 1;
	}
	return rc;
}

static bool needs_plugin(const struct gd_exr *file)
{
	return !file->ctx || file->compression >= EXR_COMPRESSION_DWAA;
}

/* What the C library cannot decode: better said before anything is computed. */
static int check_codec(const struct gd_exr *file, struct gd_err *err)
{
	if (!needs_plugin(file) || (gd_plugin_check && gd_plugin_check(NULL) == GD_OK))
		return GD_OK;
	return gd_fail(err, GD_EFORMAT, "%s: %s compression needs the OpenImageIO plug-in; or convert it by "
		       "\"oiiotool in.exr --compression zip -o out.exr\"", file->in.label,
		       codec[file->compression]);
}

static int open_exr(struct gd_exr *file, struct gd_image *im, struct gd_err *err)
{
	int rc = parse_header(file, err);

	if (rc == GD_OK)
		rc = check_part(file, err);
	if (rc == GD_OK)
		rc = check_codec(file, err);
	if (rc == GD_OK)
		rc = read_windows(file, im, err);
	if (rc == GD_OK)
		rc = read_channels(file, im, err);
	if (rc == GD_OK)
		rc = gd_exr_header_attrs(im, &file->in, file->part, err);
	return rc;
}

int gd_exr_open(struct gd_exr **out, struct gd_image *im, const char *path,
		const struct gd_read_conf *conf, struct gd_err *err)
{
	struct gd_exr *file = calloc(1, sizeof(*file));
	unsigned char head[4];
	int rc;

	*out = NULL;
	if (!file)
		return gd_fail(err, GD_ENOMEM, "%s: out of memory", path);
	file->part = conf ? conf->part : 0;
	rc = gd_input_open(&file->in, path, accept_pipe, err);
	if (rc == GD_OK && gd_input_read(&file->in, head, 4, 0) < 0)
		rc = gd_fail(err, GD_EIO, "%s: cannot read", file->in.label);
	if (rc == GD_OK) {
		if (is_exr(head, file->in.size < 4 ? 0 : 4))
			rc = open_exr(file, im, err);
		else
			rc = open_plugin(file, im, err);
	}
	if (rc != GD_OK) {
		gd_image_free(im);
		gd_exr_close(file);
		return rc;
	}
	*out = file;
	return GD_OK;
}

void gd_exr_close(struct gd_exr *file)
{
	if (!file)
		return;
	if (file->plugin)
		gd_plugin_close(file->plugin);
	if (file->ctx)
		exr_finish(&file->ctx);
	gd_input_close(&file->in);
	for (int c = 0; c < file->nfile; c++)
		free(file->name[c]);
	free(file->name);
	free(file->type);
	free(file);
}

/* Half to float, exact: the exponent is rebased by a multiplication, which takes denormals along. */
static float half_float(uint16_t h)
{
	uint32_t m = (uint32_t)(h & 0x7fff) << 13;
	float f;

	memcpy(&f, &m, sizeof(f));
	f *= 0x1p112f;
	memcpy(&m, &f, sizeof(m));
	if ((h & 0x7c00) == 0x7c00)
		m |= 0x7f800000;
	m |= (uint32_t)(h & 0x8000) << 16;
	memcpy(&f, &m, sizeof(f));
	return f;
}

static void row_float(float *restrict out, const unsigned char *restrict in, enum gd_type type, int n)
{
	uint32_t u;
	uint16_t h;

	switch (type) {
	case GD_FLOAT:
		memcpy(out, in, (size_t)n * sizeof(*out));
		break;
	case GD_HALF:
#pragma omp simd private(h)
		for (int x = 0; x < n; x++) {
			memcpy(&h, in + 2 * x, sizeof(h));
			out[x] = half_float(h);
		}
		break;
	case GD_UINT:
		for (int x = 0; x < n; x++) {
			memcpy(&u, in + 4 * (size_t)x, sizeof(u));
			out[x] = (float)u;
		}
		break;
	}
}

/* Takes the rows of all channels out of a decompressed chunk at (x0, y0) of the image. */
static void unpack(const struct job *job, const exr_chunk_info_t *k, const unsigned char *in)
{
	const struct gd_image *im = job->im;
	size_t x0 = job->tile_w ? (size_t)k->start_x * job->tile_w : 0;
	size_t y0 = job->tile_w ? (size_t)k->start_y * job->tile_h : (size_t)(k->start_y - im->data.y0);
	size_t stride = gd_stride(im->w), w = (size_t)im->w;

	for (size_t y = y0; y < y0 + (size_t)k->height; y++)
		for (int c = 0; c < job->file->nfile; c++) {
			const struct target *t = &job->target[c];
			size_t n = (size_t)k->width * t->bytes;
			if (t->chan && t->chan->v) {
				float *row = t->chan->v + y * stride;
				row_float(row + x0, in, t->type, k->width);
				if (x0 + (size_t)k->width == w)		/* the padding is defined */
					memset(row + w, 0, (stride - w) * sizeof(*row));
			} else if (t->chan) {
				memcpy(t->chan->raw + (y * w + x0) * t->bytes, in, n);
			}
			in += n;
		}
}

static exr_result_t unpack_fn(exr_decode_pipeline_t *pipe)
{
	unpack(pipe->decoding_user_data, &pipe->chunk, pipe->unpacked_buffer);
	return EXR_ERR_SUCCESS;
}

/* A chunk through the library's pipeline, which is set up at the thread's first chunk. */
static exr_result_t decode_packed(struct job *job, exr_decode_pipeline_t *pipe, const exr_chunk_info_t *k)
{
	exr_context_t ctx = job->file->ctx;
	exr_result_t code;

	if (!pipe->context) {
		code = exr_decoding_initialize(ctx, job->file->part, k, pipe);
		if (code == EXR_ERR_SUCCESS)
			code = exr_decoding_choose_default_routines(ctx, job->file->part, pipe);
		pipe->unpack_and_convert_fn = unpack_fn;
		pipe->decoding_user_data = job;
	} else {
		code = exr_decoding_update(ctx, job->file->part, k, pipe);
	}
	if (code == EXR_ERR_SUCCESS)
		code = exr_decoding_run(ctx, job->file->part, pipe);
	return code;
}

/* An uncompressed chunk: from memory without a copy in between, else through buf. */
static exr_result_t decode_raw(struct job *job, unsigned char **buf, size_t *room, const exr_chunk_info_t *k)
{
	const struct gd_input *in = &job->file->in;
	const unsigned char *v;

	if (!in->mem && *room < k->packed_size) {
		free(*buf);
		*buf = malloc(k->packed_size);
		*room = *buf ? k->packed_size : 0;
		if (!*buf)
			return EXR_ERR_OUT_OF_MEMORY;
	}
	v = gd_input_view(in, *buf, k->packed_size, k->data_offset);
	if (!v)
		return EXR_ERR_READ_IO;
	unpack(job, k, v);
	return EXR_ERR_SUCCESS;
}

static void decode_failed(struct job *job, size_t i, exr_result_t code)
{
#pragma omp critical(gd_exr_decode_failed)
	if (i < job->failed) {
		job->failed = i;
		job->code = code;
	}
}

static int decode_all(struct job *job, struct gd_err *err)
{
	struct gd_exr *file = job->file;

#pragma omp parallel
	{
		exr_decode_pipeline_t pipe = EXR_DECODE_PIPELINE_INITIALIZER;
		unsigned char *buf = NULL;
		size_t room = 0;
#pragma omp for schedule(dynamic)
		for (size_t i = 0; i < job->nchunk; i++) {
			const exr_chunk_info_t *k = &job->chunk[i];
			exr_result_t code;
			if (k->packed_size == k->unpacked_size)
				code = decode_raw(job, &buf, &room, k);
			else
				code = decode_packed(job, &pipe, k);
			if (code != EXR_ERR_SUCCESS)
				decode_failed(job, i, code);
			gd_input_done(&file->in, k->packed_size, k->data_offset);
		}
		free(buf);
		exr_decoding_destroy(file->ctx, &pipe);
	}
	if (job->failed == SIZE_MAX)
		return GD_OK;
	const exr_chunk_info_t *k = &job->chunk[job->failed];
	if (job->code == EXR_ERR_OUT_OF_MEMORY)
		return gd_fail(err, GD_ENOMEM, "%s: out of memory", file->in.label);
	return gd_fail(err, GD_EFORMAT, "%s: damaged %s data in the %s at %d,%d", file->in.label,
		       codec[file->compression], job->tile_w ? "tile" : "rows", k->start_x, k->start_y);
}

/* Refuses chunks that cannot hold what they claim, before memory for it is taken. */
static bool plausible(const struct job *job, const exr_chunk_info_t *k)
{
	const struct gd_image *im = job->im;
	uint64_t pixel = 0, x0, y0;

	for (int c = 0; c < job->file->nfile; c++)
		pixel += job->target[c].bytes;
	if (k->width < 1 || k->height < 1 || k->packed_size < 1 ||
	    k->unpacked_size != (uint64_t)k->width * (uint64_t)k->height * pixel)
		return false;
	if (k->packed_size > k->unpacked_size || k->unpacked_size / MAX_RATIO > k->packed_size)
		return false;
	if (job->file->compression == EXR_COMPRESSION_NONE && k->packed_size != k->unpacked_size)
		return false;
	if (k->data_offset > job->file->in.size || k->packed_size > job->file->in.size - k->data_offset)
		return false;
	x0 = job->tile_w ? (uint64_t)k->start_x * job->tile_w : 0;
	y0 = job->tile_w ? (uint64_t)k->start_y * job->tile_h : (uint64_t)((int64_t)k->start_y - im->data.y0);
	return x0 + (uint64_t)k->width <= (uint64_t)im->w && y0 + (uint64_t)k->height <= (uint64_t)im->h;
}

/* Looks all chunks of the image up. */
static int find_chunks(struct job *job, struct gd_err *err)
{
	struct gd_exr *file = job->file;
	const struct gd_image *im = job->im;
	int32_t step_x = im->w, step_y = 1;
	exr_tile_level_mode_t level;
	exr_tile_round_mode_t round;
	exr_result_t code;
	int rc = GD_OK;

	if (file->storage == EXR_STORAGE_TILED) {
		code = exr_get_tile_descriptor(file->ctx, file->part, &job->tile_w, &job->tile_h, &level,
					       &round);
		if (code == EXR_ERR_SUCCESS && (job->tile_w < 1 || job->tile_h < 1 ||
						job->tile_w > GD_MAX_SIDE || job->tile_h > GD_MAX_SIDE))
			code = EXR_ERR_INVALID_ATTR;
		step_x = (int32_t)job->tile_w;
		step_y = (int32_t)job->tile_h;
	} else {
		code = exr_get_scanlines_per_chunk(file->ctx, file->part, &step_y);
		if (code == EXR_ERR_SUCCESS && step_y < 1)
			code = EXR_ERR_INVALID_ATTR;
	}
	if (code != EXR_ERR_SUCCESS)
		return fail_library(file, code, err);
	size_t nx = ((size_t)im->w + (size_t)step_x - 1) / (size_t)step_x;
	size_t ny = ((size_t)im->h + (size_t)step_y - 1) / (size_t)step_y;
	if (nx * ny > file->in.size / sizeof(uint64_t))
		return gd_fail(err, GD_EFORMAT, "%s: shorter than its own table of contents", file->in.label);
	job->nchunk = nx * ny;
	job->chunk = calloc(job->nchunk, sizeof(*job->chunk));
	if (!job->chunk)
		return gd_fail(err, GD_ENOMEM, "%s: out of memory", file->in.label);
	for (size_t i = 0; i < job->nchunk && rc == GD_OK; i++) {
		exr_chunk_info_t *k = &job->chunk[i];
		int x = (int)(i % nx), y = (int)(i / nx);
		if (job->tile_w)
			code = exr_read_tile_chunk_info(file->ctx, file->part, x, y, 0, 0, k);
		else
			code = exr_read_scanline_chunk_info(file->ctx, file->part,
							    im->data.y0 + y * step_y, k);
		if (code != EXR_ERR_SUCCESS || !plausible(job, k))
			rc = gd_fail(err, GD_EFORMAT, "%s: truncated or damaged: no valid %s data at %d,%d",
				     file->in.label, codec[file->compression], x * step_x, y * step_y);
		else
			rc = gd_input_need(&file->in, k->packed_size, k->data_offset, err);
	}
	return rc;
}

/* Memory for the channels, and which channel of the file goes where. */
static int make_targets(struct job *job, struct gd_err *err)
{
	const struct gd_exr *file = job->file;
	size_t w = (size_t)job->im->w, h = (size_t)job->im->h, stride = gd_stride(job->im->w), total = 0;

	for (int c = 0; c < file->nfile; c++) {
		int i = gd_image_find(job->im, file->name[c]);
		if (i < 0 || job->im->chan[i].want == GD_DROP)
			continue;
		struct gd_channel *chan = &job->im->chan[i];
		total += chan->want == GD_READ ? h * stride * sizeof(float) : h * w * job->target[c].bytes;
		job->target[c].chan = chan;
	}
	if (total > GD_MAX_BYTES)
		return gd_fail(err, GD_ENOMEM, "%s: %zu GiB of pixels, the limit is %zu", file->in.label,
			       total >> 30, GD_MAX_BYTES >> 30);
	for (int c = 0; c < file->nfile; c++) {
		struct gd_channel *chan = job->target[c].chan;
		if (chan && chan->want == GD_READ)
			chan->v = gd_alloc(h * stride, sizeof(float));
		else if (chan)
			chan->raw = gd_alloc(h * w, job->target[c].bytes);
		if (chan && !chan->v && !chan->raw)
			return gd_fail(err, GD_ENOMEM, "%s: out of memory for %zu MiB of pixels",
				       file->in.label, total >> 20);
	}
	return GD_OK;
}

static int load_exr(struct gd_exr *file, struct gd_image *im, struct gd_err *err)
{
	struct job job = { .file = file, .im = im, .failed = SIZE_MAX };
	int rc = GD_OK;

	job.target = calloc((size_t)file->nfile, sizeof(*job.target));
	if (!job.target)
		return gd_fail(err, GD_ENOMEM, "%s: out of memory", file->in.label);
	for (int c = 0; c < file->nfile; c++) {
		job.target[c].type = file->type[c];
		job.target[c].bytes = type_bytes(file->type[c]);
	}
	rc = find_chunks(&job, err);
	if (rc == GD_OK)
		rc = make_targets(&job, err);
	if (rc == GD_OK)
		rc = decode_all(&job, err);
	free(job.target);
	free(job.chunk);
	return rc;
}

/* The header is the one read already: its attributes and types are exact. */
static int load_plugin(struct gd_exr *file, struct gd_image *im, struct gd_err *err)
{
	struct gd_image header = { 0 };
	int rc = GD_OK;

	if (!file->plugin)
		rc = open_plugin(file, &header, err);
	if (rc == GD_OK)
		rc = gd_plugin_load(file->plugin, im, err);
	gd_image_free(&header);
	return rc;
}

int gd_exr_load(struct gd_exr *file, struct gd_image *im, struct gd_err *err)
{
	int rc = needs_plugin(file) ? load_plugin(file, im, err) : load_exr(file, im, err);

	for (int i = im->nchan - 1; i >= 0; i--)
		if (im->chan[i].want == GD_DROP)
			gd_image_drop(im, im->chan[i].name);
	return rc;
}
