/* SPDX-License-Identifier: BSD-3-Clause */
/* Reading: the header, and who decodes the pixels. */
#include "exr_file.h"

#include <stdlib.h>
#include <string.h>

#include "exr_header.h"
#include "plugin.h"

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "EXR is little-endian and so must we be");

#define MAGIC		"\x76\x2f\x31\x01"

const char *const gd_exr_codec[] = {"uncompressed", "RLE", "ZIPS", "ZIP",  "PIZ",
				    "PXR24",	    "B44", "B44A", "DWAA", "DWAB"};

/* Texts of the library may quote the file: nothing but printable ASCII goes on. */
static void keep_message(exr_const_context_t ctx, exr_result_t code, const char *text)
{
	void *user = NULL;

	(void)code;
	if (!ctx || exr_get_user_data(ctx, &user) != EXR_ERR_SUCCESS || !user)
		return;
	struct gd_exr *file = user;
	if (file->quiet || file->message[0])
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

int gd_exr_fail_library(struct gd_exr *file, exr_result_t code, struct gd_err *err)
{
	int status = code == EXR_ERR_OUT_OF_MEMORY ? GD_ENOMEM : GD_EFORMAT;
	const char *text = file->message[0] ? file->message : exr_get_default_error_message(code);

	return gd_fail(err, status, "%s: %s", file->in.label, text);
}

static bool is_exr(const unsigned char *head, uint64_t n)
{
	return n >= 4 && memcmp(head, MAGIC, 4) == 0;
}

static int open_plugin(struct gd_exr *file, struct gd_image *im, struct gd_err *err)
{
	const struct gd_input *in = &file->in;
	struct gd_err why = { 0 };

	if (in->mem && !file->ctx)
		return gd_fail(err, GD_EFORMAT, "%s: not an OpenEXR file (a pipe must carry one)",
			       in->label);
	if (gd_plugin_check(&why) != GD_OK)
		return gd_fail(err, GD_EFORMAT, "%s: not an OpenEXR file, and any other %s",
			       in->label, why.text);
	return gd_plugin_open(&file->plugin, im, in->mem ? "stdin.exr" : in->path, in->mem,
			      in->size, file->part, err);
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
	return code == EXR_ERR_SUCCESS ? GD_OK : gd_exr_fail_library(file, code, err);
}

static int check_part(struct gd_exr *file, struct gd_err *err)
{
	exr_result_t code;
	int count = 0;

	code = exr_get_count(file->ctx, &count);
	if (code == EXR_ERR_SUCCESS && (file->part < 0 || file->part >= count))
		return gd_fail(err, GD_EARG, "%s: no part %d, parts are 0 to %d", file->in.label,
			       file->part, count - 1);
	if (code == EXR_ERR_SUCCESS)
		code = exr_get_storage(file->ctx, file->part, &file->storage);
	if (code == EXR_ERR_SUCCESS)
		code = exr_get_compression(file->ctx, file->part, &file->compression);
	if (code != EXR_ERR_SUCCESS)
		return gd_exr_fail_library(file, code, err);
	if (file->storage != EXR_STORAGE_SCANLINE && file->storage != EXR_STORAGE_TILED)
		return gd_fail(err, GD_EFORMAT, "%s: deep images are not supported",
			       file->in.label);
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
		return gd_exr_fail_library(file, code, err);
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
		return gd_exr_fail_library(file, code, err);
	if (list->num_channels < 1)
		return gd_fail(err, GD_EFORMAT, "%s: no channels", file->in.label);
	file->name = calloc((size_t)list->num_channels, sizeof(*file->name));
	file->type = calloc((size_t)list->num_channels, sizeof(*file->type));
	if (!file->name || !file->type)
		return gd_fail(err, GD_ENOMEM, "%s: out of memory", file->in.label);
	for (int c = 0; c < list->num_channels && rc == GD_OK; c++) {
		const exr_attr_chlist_entry_t *e = &list->entries[c];
		if (e->x_sampling != 1 || e->y_sampling != 1)
			return gd_fail(err, GD_EFORMAT,
				       "%s: channel %s is sub-sampled (%dx%d), expected 1x1",
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
	if (!needs_plugin(file) || gd_plugin_check(NULL) == GD_OK)
		return GD_OK;
	return gd_fail(err, GD_EFORMAT,
		       "%s: %s compression needs the OpenImageIO plug-in; or convert it by "
		       "\"oiiotool in.exr --compression zip -o out.exr\"",
		       file->in.label, gd_exr_codec[file->compression]);
}

static int open_exr(struct gd_exr *file, struct gd_image *im, struct gd_err *err)
{
	int rc = gd_exr_header_keep(&file->in, &file->head_end, err);

	if (rc == GD_OK)
		rc = parse_header(file, err);
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
	rc = gd_input_open(&file->in, path, err);
	if (rc == GD_OK)
		rc = gd_input_keep(&file->in, sizeof head, err);
	if (rc == GD_OK && gd_input_read(&file->in, head, sizeof head, 0) < 0)
		rc = gd_fail(err, GD_EIO, "%s: cannot read", file->in.label);
	if (rc == GD_OK) {
		if (is_exr(head, file->in.size))
			rc = open_exr(file, im, err);
		else
			rc = open_plugin(file, im, err);
	}
	if (rc != GD_OK) {
		gd_image_free(im);
		gd_exr_close(file);
		return rc;
	}
	file->quiet = true;
	*out = file;
	return GD_OK;
}

void gd_exr_close(struct gd_exr *file)
{
	if (!file)
		return;
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

int gd_exr_keep_stream(struct gd_exr *file, struct gd_err *err)
{
	int rc = GD_OK;

	if (!file->in.stream)
		return GD_OK;
	rc = gd_input_keep(&file->in, UINT64_MAX, err);
	if (file->ctx)
		exr_finish(&file->ctx);
	return rc == GD_OK ? parse_header(file, err) : rc;
}

/* The header is the one read already: its attributes and types are exact. */
static int load_plugin(struct gd_exr *file, struct gd_image *im, struct gd_err *err)
{
	struct gd_image header = { 0 };
	int rc = GD_OK;

	if (!file->plugin)
		rc = gd_exr_keep_stream(file, err);
	if (rc == GD_OK && !file->plugin)
		rc = open_plugin(file, &header, err);
	if (rc == GD_OK)
		rc = gd_plugin_load(file->plugin, im, err);
	gd_image_free(&header);
	return rc;
}

int gd_exr_load(struct gd_exr *file, struct gd_image *im, struct gd_err *err)
{
	int rc = needs_plugin(file) ? load_plugin(file, im, err) : gd_exr_decode(file, im, err);

	for (int i = im->nchan - 1; i >= 0; i--)
		if (im->chan[i].want == GD_DROP)
			gd_image_drop(im, im->chan[i].name);
	return rc;
}
