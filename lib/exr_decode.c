/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Decoding. The library finds chunks and decompresses them; rows are taken out of a decompressed
 * chunk here, because its own unpacking crashes on skipped channels of some layouts and cannot
 * leave a channel as it is. Every chunk is looked up before memory for pixels is taken, so that a
 * file too short for its header fails at once; only uncompressed streams are decoded as they come.
 */
#include "exr_file.h"

#include <stdlib.h>
#include <string.h>

#include "half.h"
#include "turn.h"

#define MAX_RATIO	2048	/* more than any codec packs into a byte; deflate: 1032 */
#define LEADER		8	/* bytes before the data of a scanline chunk: row and size */
#define SMALL		((size_t)256 << 10)	/* bytes; done before threads wake up */
#define STREAM_BYTES	((size_t)512 << 10)	/* of a stream, read at a time */

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
	size_t row_bytes;		/* of a row in a stream, with its leader */
	size_t failed;			/* lowest chunk that failed, or SIZE_MAX */
	exr_result_t code;		/* and how */
};

static size_t type_bytes(enum gd_type type)
{
	return type == GD_HALF ? 2 : 4;
}

static void row_float(float *restrict out, const unsigned char *restrict in, enum gd_type type,
		      int n)
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
			out[x] = gd_half_float(h);
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
	size_t y0 =
		job->tile_w ? (size_t)k->start_y * job->tile_h : (size_t)(k->start_y - im->data.y0);
	size_t stride = gd_stride(im->w), w = (size_t)im->w;

	for (size_t y = y0; y < y0 + (size_t)k->height; y++)
		for (int c = 0; c < job->file->nfile; c++) {
			const struct target *t = &job->target[c];
			size_t n = (size_t)k->width * t->bytes;
			if (t->chan && t->chan->v) {
				float *row = t->chan->v + y * stride;
				row_float(row + x0, in, t->type, k->width);
				if (x0 + (size_t)k->width == w)	/* the padding is defined */
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
static exr_result_t decode_packed(struct job *job, exr_decode_pipeline_t *pipe,
				  const exr_chunk_info_t *k)
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
static exr_result_t decode_raw(struct job *job, unsigned char **buf, size_t *room,
			       const exr_chunk_info_t *k)
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
	uint64_t bytes = 0;

	for (size_t i = 0; i < job->nchunk; i++)
		bytes += job->chunk[i].unpacked_size;
#pragma omp parallel if (bytes > SMALL)
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
		       gd_exr_codec[file->compression], job->tile_w ? "tile" : "rows", k->start_x,
		       k->start_y);
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
	if (k->unpacked_size / MAX_RATIO > k->packed_size)
		return false;
	if (job->file->compression == EXR_COMPRESSION_NONE && k->packed_size != k->unpacked_size)
		return false;
	if (k->data_offset > job->file->in.size ||
	    k->packed_size > job->file->in.size - k->data_offset)
		return false;
	x0 = job->tile_w ? (uint64_t)k->start_x * job->tile_w : 0;
	y0 = job->tile_w ? (uint64_t)k->start_y * job->tile_h
			 : (uint64_t)((int64_t)k->start_y - im->data.y0);
	return x0 + (uint64_t)k->width <= (uint64_t)im->w &&
	       y0 + (uint64_t)k->height <= (uint64_t)im->h;
}

/* Width and height of the file's chunks. */
static int chunk_size(struct job *job, int *w, int *h, struct gd_err *err)
{
	struct gd_exr *file = job->file;
	exr_tile_level_mode_t level;
	exr_tile_round_mode_t round;
	exr_result_t code;
	int32_t rows = 0;

	if (file->storage == EXR_STORAGE_TILED) {
		code = exr_get_tile_descriptor(file->ctx, file->part, &job->tile_w, &job->tile_h,
					       &level, &round);
		if (code == EXR_ERR_SUCCESS &&
		    (job->tile_w < 1 || job->tile_h < 1 || job->tile_w > GD_MAX_SIDE ||
		     job->tile_h > GD_MAX_SIDE))
			code = EXR_ERR_INVALID_ATTR;
		*w = (int)job->tile_w;
		*h = (int)job->tile_h;
	} else {
		code = exr_get_scanlines_per_chunk(file->ctx, file->part, &rows);
		if (code == EXR_ERR_SUCCESS && rows < 1)
			code = EXR_ERR_INVALID_ATTR;
		*w = job->im->w;
		*h = rows;
	}
	return code == EXR_ERR_SUCCESS ? GD_OK : gd_exr_fail_library(file, code, err);
}

/* Looks the chunk at (x, y) of the image up. */
static int find_chunk(struct job *job, exr_chunk_info_t *k, int x, int y, struct gd_err *err)
{
	struct gd_exr *file = job->file;
	exr_result_t code;

	if (job->tile_w)
		code = exr_read_tile_chunk_info(file->ctx, file->part, x / (int)job->tile_w,
						y / (int)job->tile_h, 0, 0, k);
	else
		code = exr_read_scanline_chunk_info(file->ctx, file->part, job->im->data.y0 + y, k);
	if (code == EXR_ERR_SUCCESS && plausible(job, k))
		return gd_input_need(&file->in, k->packed_size, k->data_offset, err);
	return gd_fail(err, GD_EFORMAT, "%s: truncated or damaged: no valid %s data at %d,%d",
		       file->in.label, gd_exr_codec[file->compression], x, y);
}

static int find_chunks(struct job *job, struct gd_err *err)
{
	struct gd_exr *file = job->file;
	int w = 0, h = 0, rc = chunk_size(job, &w, &h, err);

	if (rc != GD_OK)
		return rc;
	size_t nx = ((size_t)job->im->w + (size_t)w - 1) / (size_t)w;
	size_t ny = ((size_t)job->im->h + (size_t)h - 1) / (size_t)h;
	if (nx * ny > file->in.size / sizeof(uint64_t))
		return gd_fail(err, GD_EFORMAT, "%s: shorter than its own table of contents",
			       file->in.label);
	job->chunk = calloc(nx * ny, sizeof(*job->chunk));
	if (!job->chunk)
		return gd_fail(err, GD_ENOMEM, "%s: out of memory", file->in.label);
	for (size_t i = 0; i < nx * ny && rc == GD_OK; i++)
		rc = find_chunk(job, &job->chunk[i], (int)(i % nx) * w, (int)(i / nx) * h, err);
	job->nchunk = nx * ny;
	return rc;
}

/* Memory for the channels, and which channel of the file goes where. */
static int make_targets(struct job *job, struct gd_err *err)
{
	const struct gd_exr *file = job->file;
	size_t w = (size_t)job->im->w, h = (size_t)job->im->h, stride = gd_stride(job->im->w),
	       total = 0;

	for (int c = 0; c < file->nfile; c++) {
		int i = gd_image_find(job->im, file->name[c]);
		if (i < 0 || job->im->chan[i].want == GD_DROP)
			continue;
		struct gd_channel *chan = &job->im->chan[i];
		total += chan->want == GD_READ ? h * stride * sizeof(float)
					       : h * w * job->target[c].bytes;
		job->target[c].chan = chan;
	}
	if (total > GD_MAX_BYTES)
		return gd_fail(err, GD_ENOMEM, "%s: %zu GiB of pixels, the limit is %zu",
			       file->in.label, total >> 30, GD_MAX_BYTES >> 30);
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

/*
 * Whether the rest of a stream can be decoded as it comes: uncompressed rows, each a chunk of one
 * size, in the order of the image. The table that tells is kept.
 */
static int check_stream(struct job *job, bool *flows, struct gd_err *err)
{
	struct gd_exr *file = job->file;
	uint64_t size = LEADER, n = (uint64_t)job->im->h,
		 end = file->head_end + n * sizeof(uint64_t), at;
	int parts = 0, rc;

	*flows = false;
	if (!file->in.stream || exr_get_count(file->ctx, &parts) != EXR_ERR_SUCCESS || parts != 1 ||
	    file->storage != EXR_STORAGE_SCANLINE || file->compression != EXR_COMPRESSION_NONE)
		return GD_OK;
	rc = gd_input_keep(&file->in, end, err);
	if (rc != GD_OK || file->in.size < end)
		return rc;
	for (int c = 0; c < file->nfile; c++)
		size += (uint64_t)job->im->w * job->target[c].bytes;
	for (uint64_t i = 0; i < n; i++) {
		memcpy(&at, file->in.mem + file->head_end + i * sizeof(at), sizeof(at));
		if (at != end + i * size)
			return GD_OK;
	}
	file->in.at = end;
	job->row_bytes = (size_t)size;
	*flows = size - LEADER <= INT32_MAX;
	return GD_OK;
}

/* Rows with their leaders, from y on, as they came out of the stream. */
static exr_result_t unpack_rows(const struct job *job, const unsigned char *v, int y, int n)
{
	for (int end = y + n; y < end; y++, v += job->row_bytes) {
		exr_chunk_info_t k = {
			.start_y = job->im->data.y0 + y, .width = job->im->w, .height = 1};
		int32_t leader[2];
		memcpy(leader, v, sizeof leader);
		if (leader[0] != k.start_y || (size_t)leader[1] != job->row_bytes - LEADER)
			return EXR_ERR_BAD_CHUNK_LEADER;
		unpack(job, &k, v + LEADER);
	}
	return EXR_ERR_SUCCESS;
}

/* Threads take turns in reading a group of rows, and unpack it while the next one reads on. */
static int decode_stream(struct job *job, struct gd_err *err)
{
	struct gd_exr *file = job->file;
	int h = job->im->h, group = (int)(STREAM_BYTES / job->row_bytes) + 1, rc = GD_OK;
	struct gd_turn turn = GD_TURN_START;

#pragma omp parallel if ((size_t)h * job->row_bytes > SMALL)
	{
		unsigned char *buf = malloc((size_t)group * job->row_bytes);
#pragma omp for schedule(monotonic : dynamic, 1)
		for (int g = 0; g < (h + group - 1) / group; g++) {
			int y = g * group, n = h - y < group ? h - y : group;
			gd_turn_wait(&turn, g);
			if (rc == GD_OK && !buf)
				rc = gd_fail(err, GD_ENOMEM, "%s: out of memory", file->in.label);
			if (rc == GD_OK)
				rc = gd_input_next(&file->in, buf, (size_t)n * job->row_bytes, err);
			bool got = rc == GD_OK;
			gd_turn_pass(&turn);
			exr_result_t code = got ? unpack_rows(job, buf, y, n) : EXR_ERR_SUCCESS;
			if (code != EXR_ERR_SUCCESS)
				decode_failed(job, (size_t)y, code);
		}
		free(buf);
	}
	if (rc == GD_OK && job->failed != SIZE_MAX)
		rc = gd_fail(err, GD_EFORMAT, "%s: damaged data in the rows from %zu",
			     file->in.label, job->failed);
	return rc;
}

int gd_exr_decode(struct gd_exr *file, struct gd_image *im, struct gd_err *err)
{
	struct job job = { .file = file, .im = im, .failed = SIZE_MAX };
	bool flows = false;
	int rc = GD_OK;

	job.target = calloc((size_t)file->nfile, sizeof(*job.target));
	if (!job.target)
		return gd_fail(err, GD_ENOMEM, "%s: out of memory", file->in.label);
	for (int c = 0; c < file->nfile; c++) {
		job.target[c].type = file->type[c];
		job.target[c].bytes = type_bytes(file->type[c]);
	}
	rc = check_stream(&job, &flows, err);
	if (rc == GD_OK && !flows)
		rc = gd_exr_keep_stream(file, err);
	if (rc == GD_OK && !flows)
		rc = find_chunks(&job, err);
	if (rc == GD_OK)
		rc = make_targets(&job, err);
	if (rc == GD_OK)
		rc = flows ? decode_stream(&job, err) : decode_all(&job, err);
	free(job.target);
	free(job.chunk);
	return rc;
}

