/* SPDX-License-Identifier: BSD-3-Clause */
#include "plugin.h"

#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "exr.h"
#include "plugin/shim.h"

#ifndef GD_PLUGDIR
#define GD_PLUGDIR "/usr/local/lib/gd"
#endif
#define PLUGIN "gd-plugin.so"
#define MAX_PATH 4096

struct gd_plugin_file {
	const struct gd_shim *shim;
	void *file;
	struct gd_shim_info info;
	char *path;
};

/* NULL if there is no such file; else the table, or NULL with err set. */
static const struct gd_shim *load_from(const char *dir, size_t length, struct gd_err *err)
{
	char path[MAX_PATH];
	const struct gd_shim *shim;
	void *handle;
	int n = snprintf(path, sizeof(path), "%.*s/" PLUGIN, (int)length, dir);

	if (!length || n < 0 || n >= (int)sizeof(path) || access(path, R_OK))
		return NULL;
	/* Never closed: the libraries behind it start threads. The loader counts and keeps it. */
	handle = dlopen(path, RTLD_NOW | RTLD_LOCAL);
	if (!handle) {
		gd_fail(err, GD_EIO, "%s", dlerror());
		return NULL;
	}
	shim = dlsym(handle, GD_SHIM_SYMBOL);
	if (!shim || shim->abi != GD_SHIM_ABI) {
		gd_fail(err, GD_EIO, "%s belongs to another version of gd", path);
		return NULL;
	}
	return shim;
}

/* Each directory of a list divided by ':'. */
static const struct gd_shim *load_from_list(const char *list, struct gd_err *err)
{
	const struct gd_shim *shim = NULL;
	const char *next = list;

	while (next && !shim) {
		const char *end = strchr(next, ':');

		shim = load_from(next, end ? (size_t)(end - next) : strlen(next), err);
		next = end ? end + 1 : NULL;
	}
	return shim;
}

/* Beside the executable: as installed, then as built. */
static const struct gd_shim *load_from_here(struct gd_err *err)
{
	char exe[MAX_PATH], near[MAX_PATH + 16];
	const struct gd_shim *shim;
	ssize_t n = readlink("/proc/self/exe", exe, sizeof(exe) - 1);
	char *slash;

	if (n <= 0)
		return NULL;
	exe[n] = '\0';
	slash = strrchr(exe, '/');
	if (!slash)
		return NULL;
	*slash = '\0';
	snprintf(near, sizeof(near), "%s/../lib/gd", exe);
	shim = load_from(near, strlen(near), err);
	return shim ? shim : load_from(exe, strlen(exe), err);
}

static const struct gd_shim *load(struct gd_err *err)
{
	struct gd_err found = { 0 };	/* what was wrong with a plug-in that is there */
	const char *path = getenv("GD_PLUGIN_PATH");
	const struct gd_shim *shim;

	if (path && *path) {
		shim = load_from_list(path, &found);
	} else {
		shim = load_from_here(&found);
		if (!shim)
			shim = load_from(GD_PLUGDIR, strlen(GD_PLUGDIR), &found);
	}
	if (!shim && found.code)
		gd_fail(err, found.code, "%s", found.text);
	else if (!shim)
		gd_fail(err, GD_EIO, "needs the OpenImageIO plug-in, and %s is not %s%s", PLUGIN,
			path && *path ? "in " : "installed", path && *path ? path : "");
	return shim;
}

int gd_plugin_check(struct gd_err *err)
{
	return load(err) ? GD_OK : GD_EIO;
}

/* Sizes that the reader of EXR would refuse too. */
static int check_size(const struct gd_shim_info *f, const char *path, struct gd_err *err)
{
	double w = (double)f->x1 - f->x0 + 1, h = (double)f->y1 - f->y0 + 1;

	if (!(w >= 1 && h >= 1 && w <= GD_MAX_SIDE && h <= GD_MAX_SIDE) ||
	    w * h * 4 * f->nchan > (double)GD_MAX_BYTES)
		return gd_fail(err, GD_ENOMEM,
			       "%s: %g x %g pixels of %d channels are beyond the limits", path, w,
			       h, f->nchan);
	return GD_OK;
}

static int fill_channels(struct gd_image *im, const struct gd_plugin_file *file, struct gd_err *err)
{
	im->chan = calloc((size_t)file->info.nchan, sizeof(*im->chan));
	if (!im->chan)
		return gd_fail(err, GD_ENOMEM, "%s: out of memory", file->path);
	for (int i = 0; i < file->info.nchan; i++) {
		struct gd_channel *c = &im->chan[i];
		int type;
		const char *name = file->shim->channel(file->file, i, &type);

		c->name = strdup(name);
		c->type = (enum gd_type)type;
		if (!c->name)
			return gd_fail(err, GD_ENOMEM, "%s: out of memory", file->path);
		im->nchan++;
	}
	return GD_OK;
}

static int fill_attributes(struct gd_image *im, const struct gd_plugin_file *file,
			   struct gd_err *err)
{
	int rc = GD_OK;

	for (int i = 0; rc == GD_OK && i < file->info.nattr; i++) {
		struct gd_shim_attr a;

		if (!file->shim->attr(file->file, i, &a))
			continue;
		if (a.type == 'i')
			rc = gd_attr_set_int(im, a.name, a.i, err);
		else if (a.type == 'f')
			rc = gd_attr_set_number(im, a.name, (double)a.f, err);
		else
			rc = gd_attr_set_string(im, a.name, a.s, err);
	}
	return rc;
}

static int fill(struct gd_image *im, const struct gd_plugin_file *file, struct gd_err *err)
{
	const struct gd_shim_info *f = &file->info;
	int rc = check_size(f, file->path, err);

	if (rc != GD_OK)
		return rc;
	gd_image_init(im, f->x1 - f->x0 + 1, f->y1 - f->y0 + 1);
	im->data = (struct gd_box){ f->x0, f->y0, f->x1, f->y1 };
	im->display = (struct gd_box){ f->display_x0, f->display_y0, f->display_x1, f->display_y1 };
	rc = fill_channels(im, file, err);
	return rc == GD_OK ? fill_attributes(im, file, err) : rc;
}

int gd_plugin_open(struct gd_plugin_file **file, struct gd_image *im, const char *path,
		   const void *data, size_t size, int part, struct gd_err *err)
{
	const struct gd_shim *shim = load(err);
	struct gd_plugin_file *f;
	int rc;

	*file = NULL;
	if (!shim)
		return GD_EIO;
	f = calloc(1, sizeof(*f));
	if (!f)
		return gd_fail(err, GD_ENOMEM, "%s: out of memory", path);
	f->shim = shim;
	f->path = strdup(path);
	if (f->path)
		rc = shim->open(&f->file, &f->info, path, data, size, part, err);
	else
		rc = gd_fail(err, GD_ENOMEM, "%s: out of memory", path);
	if (rc == GD_OK)
		rc = fill(im, f, err);
	if (rc != GD_OK) {
		gd_image_free(im);
		gd_plugin_close(f);
		return rc;
	}
	*file = f;
	return GD_OK;
}

static int find_channel(const struct gd_plugin_file *f, const char *name, int *type)
{
	for (int i = 0; i < f->info.nchan; i++)
		if (!strcmp(f->shim->channel(f->file, i, type), name))
			return i;
	return -1;
}

static int copy_channel(struct gd_channel *c, const struct gd_image *im,
			const struct gd_plugin_file *f, struct gd_err *err)
{
	static const size_t bytes[] = { [GD_UINT] = 4, [GD_HALF] = 2, [GD_FLOAT] = 4 };
	size_t stride = gd_stride(im->w);
	int type, i = find_channel(f, c->name, &type);

	if (i < 0)
		return gd_fail(err, GD_ESHAPE, "%s: no channel %s", f->path, c->name);
	if (c->want == GD_READ) {
		c->v = gd_calloc((size_t)im->h, stride * sizeof(float));
		if (!c->v)
			return gd_fail(err, GD_ENOMEM, "%s: out of memory", f->path);
		return f->shim->copy(f->file, i, 1, c->v, stride * sizeof(float), err);
	}
	if ((int)c->type != type)
		return gd_fail(err, GD_EFORMAT, "%s: channel %s changes its type", f->path,
			       c->name);
	c->raw = gd_alloc((size_t)im->h, (size_t)im->w * bytes[type]);
	if (!c->raw)
		return gd_fail(err, GD_ENOMEM, "%s: out of memory", f->path);
	return f->shim->copy(f->file, i, 0, c->raw, (size_t)im->w * bytes[type], err);
}

static void drop_unwanted(struct gd_image *im)
{
	int n = 0;

	for (int i = 0; i < im->nchan; i++) {
		if (im->chan[i].want == GD_DROP)
			free(im->chan[i].name);
		else
			im->chan[n++] = im->chan[i];
	}
	im->nchan = n;
}

int gd_plugin_load(struct gd_plugin_file *file, struct gd_image *im, struct gd_err *err)
{
	const struct gd_shim_info *f = &file->info;
	int rc;

	if (im->w != f->x1 - f->x0 + 1 || im->h != f->y1 - f->y0 + 1)
		return gd_fail(err, GD_ESHAPE, "%s: its size changes while it is read", file->path);
	drop_unwanted(im);
	rc = file->shim->load(file->file, err);
	for (int i = 0; rc == GD_OK && i < im->nchan; i++)
		rc = copy_channel(&im->chan[i], im, file, err);
	return rc;
}

void gd_plugin_close(struct gd_plugin_file *file)
{
	if (!file)
		return;
	if (file->file)
		file->shim->close(file->file);
	free(file->path);
	free(file);
}

int gd_plugin_png(unsigned char **png, size_t *size, const void *pixel, int w, int h, int n,
		  int bits, struct gd_err *err)
{
	const struct gd_shim *shim;

	*png = NULL;
	if (w < 1 || h < 1 || (n != 1 && n != 3) || (bits != 8 && bits != 16))
		return gd_fail(err, GD_EARG, "PNG: %dx%d, %d channels of %d bits", w, h, n, bits);
	shim = load(err);
	return shim ? shim->png(png, size, pixel, w, h, n, bits, err) : GD_EIO;
}

int gd_plugin_display(float *rgb, size_t n, const char *display, const char *view,
		      struct gd_err *err)
{
	const struct gd_shim *shim = load(err);

	return shim ? shim->display(rgb, n, display, view, err) : GD_EIO;
}
