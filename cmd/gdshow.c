/* SPDX-License-Identifier: BSD-3-Clause */
/* gdshow: layers of images as PNG. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "buffers.h"
#include "cli.h"
#include "crop.h"
#include "plugin.h"
#include "show.h"

struct options {
	const char *output, *layers, *as, *scale, *range, *labels, *crop, *display, *view;
	double exposure;
	bool sheet, legend;
	int columns, zoom, bits;
};

struct job {
	struct gd_cli cli;
	struct options opt;
	enum gd_show_as as;
	int scale;			/* -1: by the layer's name */
	int nlayer, nimage;
	char **layer;
	struct gd_show_range *range;	/* one a layer; hi == lo: not yet known */
	struct gd_picture *pic;		/* nlayer rows of nimage */
	size_t pixels;			/* of all of them so far */
	char **label;
};

static const char *shown(const char *path)
{
	return strcmp(path, "-") ? path : "standard input";
}

static int check_range(struct job *job, struct gd_err *err)
{
	float lo, hi;
	int end = -1;

	if (!job->opt.range)
		return GD_OK;
	if (sscanf(job->opt.range, "%f,%f%n", &lo, &hi, &end) != 2 || end < 0 ||
	    job->opt.range[end] || !(hi > lo) || !isfinite(lo) || !isfinite(hi))
		return gd_fail(err, GD_EARG, "--range: \"%s\" is not LO,HI with LO below HI",
			       job->opt.range);
	for (int i = 0; i < job->nlayer; i++) {
		job->range[i].lo = lo;
		job->range[i].hi = hi;
	}
	return GD_OK;
}

static int check_options(struct job *job, struct gd_err *err)
{
	static const char *const scales[] = { "linear", "sqrt", "log", "auto" };
	struct options *opt = &job->opt;
	int scale = 0;

	if (!gd_show_as_find(opt->as, &job->as))
		return gd_fail(err, GD_EARG, "--as: \"%s\" is none of auto, colour, scalar, "
			       "signed, normal, position", opt->as);
	while (scale < 4 && strcmp(opt->scale, scales[scale]))
		scale++;
	if (scale == 4)
		return gd_fail(err, GD_EARG, "--scale: \"%s\" is none of auto, linear, sqrt, log",
			       opt->scale);
	job->scale = scale == 3 ? -1 : scale;
	if (opt->bits != 8 && opt->bits != 16)
		return gd_fail(err, GD_EARG, "--bits: %d is neither 8 nor 16", opt->bits);
	if (!opt->sheet && (job->nlayer > 1 || opt->labels))
		return gd_fail(err, GD_EARG, "several layers and labels need --sheet");
	if (!strcmp(opt->output, "-") && isatty(STDOUT_FILENO))
		return gd_fail(err, GD_EARG, "a PNG is not written to a terminal; see -o");
	if (gd_picture_misnamed(opt->output))	/* more likely an image to be shown */
		return gd_fail(err, GD_EARG, "%s: a PNG does not get the name of an EXR; to show "
			       "several images use --sheet", opt->output);
	return check_range(job, err);
}

/* The k-th (from 0) part of a list divided by commas, malloc'ed; "" beyond its end. */
static char *item(const char *list, int k)
{
	while (list && k--) {
		list = strchr(list, ',');
		list += list ? 1 : 0;
	}
	return list ? strndup(list, strcspn(list, ",")) : strdup("");
}

/* With --sheet every operand is an image, else the second is the output. */
static int set_up(struct job *job, struct gd_err *err)
{
	struct options *opt = &job->opt;
	size_t pictures;

	job->nlayer = 1;
	for (const char *p = opt->layers; *p; p++)
		job->nlayer += *p == ',';
	job->nimage = job->cli.noperand ? job->cli.noperand : 1;
	if (!opt->sheet && job->nimage == 2 && !strcmp(opt->output, "-"))
		opt->output = job->cli.operand[--job->nimage];
	if (!opt->sheet && job->nimage > 1)
		return gd_fail(err, GD_EARG, "%d images need --sheet", job->nimage);
	pictures = (size_t)job->nlayer * (size_t)job->nimage;
	job->layer = calloc((size_t)job->nlayer, sizeof(*job->layer));
	job->range = calloc((size_t)job->nlayer, sizeof(*job->range));
	job->pic = calloc(pictures, sizeof(*job->pic));
	job->label = calloc(pictures, sizeof(*job->label));
	if (!job->layer || !job->range || !job->pic || !job->label)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	for (int i = 0; i < job->nlayer; i++) {
		job->layer[i] = item(opt->layers, i);
		if (!job->layer[i])
			return gd_fail(err, GD_ENOMEM, "out of memory");
		if (!strcmp(job->layer[i], "colour"))
			*job->layer[i] = '\0';
	}
	return check_options(job, err);
}

static void free_job(struct job *job)
{
	for (int i = 0; i < job->nlayer * job->nimage; i++) {
		if (job->pic)
			gd_picture_free(&job->pic[i]);
		if (job->label)
			free(job->label[i]);
	}
	free(job->pic);
	free(job->label);
	for (int i = 0; job->layer && i < job->nlayer; i++)
		free(job->layer[i]);
	free(job->range);
	free(job->layer);
}

/* An image of one grey channel has its colour there. */
static const char *layer_of(const struct gd_image *im, const char *layer)
{
	return !*layer && !gd_layer_find(im, "").n && gd_image_find(im, "Y") >= 0 ? "Y" : layer;
}

static int load(struct job *job, struct gd_image *im, const char *path, struct gd_err *err)
{
	struct gd_exr *file = NULL;
	int rc = gd_cli_open(&job->cli, &file, im, path, err);

	for (int i = 0; rc == GD_OK && i < im->nchan; i++)
		im->chan[i].want = GD_DROP;
	for (int i = 0; rc == GD_OK && i < job->nlayer; i++) {
		const char *layer = layer_of(im, job->layer[i]);

		if (!gd_layer_want(im, layer, GD_READ))
			rc = gd_fail(err, GD_ESHAPE, "%s: no channel %s%s", shown(path),
				     *layer ? layer : "R",
				     *layer ? " (nor .R .G .B, .X .Y .Z of it)" : "");
	}
	if (rc == GD_OK)
		return gd_cli_load(&job->cli, file, im, err);
	gd_exr_close(file);
	return rc;
}

/* Variances and errors are squares, so their root is what the eye can compare. */
static enum gd_show_scale scale_of(const struct job *job, const char *layer)
{
	bool square = gd_show_guess(layer, 3) == GD_SHOW_SCALAR;

	if (job->scale >= 0)
		return (enum gd_show_scale)job->scale;
	return square ? GD_SHOW_SQRT : GD_SHOW_LINEAR;
}

/* The first image sets the range of a layer for all, so that one colour means one value. */
static int choose_range(struct job *job, int l, const struct gd_plane *v, int n,
			const struct gd_show_conf *conf, struct gd_err *err)
{
	struct gd_show_range *r = &job->range[l];
	const char *origin = job->opt.range ? "--range" : "percentiles of the first image";
	static const char *const names[] = { "linear", "square-root", "logarithmic" };
	int rc = GD_OK;

	if (r->lo == r->hi)
		rc = gd_show_range(r, v, n, conf->as, scale_of(job, job->layer[l]), err);
	r->scale = scale_of(job, job->layer[l]);
	if (rc == GD_OK)
		gd_note(&job->cli.report, "layer %s: %s, %g to %g (%s), %s scale",
			*job->layer[l] ? job->layer[l] : "colour", gd_show_as_name(conf->as),
			(double)r->lo, (double)r->hi, origin, names[r->scale]);
	return rc;
}

static int draw(struct job *job, struct gd_picture *pic, const struct gd_image *im, int l,
		const char *path, struct gd_err *err)
{
	struct gd_plane v[GD_LAYER_PLANES];
	const char *layer = layer_of(im, job->layer[l]);
	int n = gd_layer_planes(im, layer, v);
	struct gd_show_conf conf = { .as = job->as ? job->as : gd_show_guess(layer, n),
				     .exposure = job->opt.exposure,
				     .display = job->opt.display,
				     .view = job->opt.view };
	bool coloured = conf.as == GD_SHOW_SCALAR || conf.as == GD_SHOW_SIGNED;
	struct gd_box box;
	size_t nan;
	int rc = gd_crop_parse(&box, job->opt.crop, im->w, im->h, err);

	for (int c = 0; rc == GD_OK && c < n; c++)
		v[c] = gd_crop_plane(v[c], box);
	if (rc == GD_OK && coloured)
		rc = choose_range(job, l, v, n, &conf, err);
	conf.range = job->range[l];
	if (rc == GD_OK)
		rc = gd_show(pic, &nan, v, n, &conf, err);
	if (rc == GD_OK && nan)
		gd_cli_warn(&job->cli, "%s: %zu pixels with NaN in %s, shown in magenta",
			    shown(path), nan, *layer ? layer : "the colour");
	if (rc == GD_OK && job->opt.zoom > 1)
		rc = gd_picture_zoom(pic, job->opt.zoom, err);
	if (rc == GD_OK && coloured && job->opt.legend)
		rc = gd_picture_legend(pic, &conf, err);
	job->pixels += (size_t)pic->w * (size_t)pic->h;
	if (rc == GD_OK && job->pixels > GD_PICTURE_PIXELS)
		rc = gd_fail(err, GD_ESHAPE, "the sheet is beyond %d megapixels",
			     GD_PICTURE_PIXELS >> 20);
	return rc;
}

/* What tells an operand from the others: its base name, if another has the same its folder too. */
static const char *short_name(const struct job *job, const char *path)
{
	const char *base = strrchr(path, '/'), *dir;
	int same = 0;

	if (!base)
		return path;
	for (int i = 0; i < job->nimage; i++) {
		const char *other = strrchr(job->cli.operand[i], '/');

		same += !strcmp(base + 1, other ? other + 1 : job->cli.operand[i]);
	}
	if (same < 2)
		return base + 1;
	for (dir = base; dir > path && dir[-1] != '/'; dir--)
		;
	return dir;
}

/* The k-th text of --labels, else the file's name and the layer's; malloc'ed. */
static char *make_label(const struct job *job, int k, const char *path, const char *layer)
{
	const char *name = short_name(job, path);
	char *label = NULL;
	int length;

	if (job->opt.labels)
		return item(job->opt.labels, k);
	length = *layer && job->nimage > 1 ? asprintf(&label, "%s %s", name, layer) :
		asprintf(&label, "%s", *layer ? layer : name);
	return length < 0 ? NULL : label;
}

static int draw_image(struct job *job, int i, const char *path, struct gd_err *err)
{
	struct gd_image im = { 0 };
	int rc = load(job, &im, path, err);

	for (int l = 0; rc == GD_OK && l < job->nlayer; l++) {
		int k = l * job->nimage + i;

		rc = draw(job, &job->pic[k], &im, l, path, err);
		job->label[k] = make_label(job, k, path, job->layer[l]);
		if (rc == GD_OK && !job->label[k])
			rc = gd_fail(err, GD_ENOMEM, "out of memory");
	}
	gd_image_free(&im);
	return rc;
}

static int write_result(struct job *job, struct gd_err *err)
{
	struct gd_picture sheet = { 0 };
	int n = job->nlayer * job->nimage;
	int columns = job->opt.columns ? job->opt.columns : job->nimage > 1 ? job->nimage : 4;
	int rc;

	if (!job->opt.sheet)
		return gd_picture_write(&job->pic[0], job->opt.output, job->opt.bits, err);
	rc = gd_picture_sheet(&sheet, job->pic, (const char *const *)job->label, n, columns, err);
	if (rc == GD_OK)
		rc = gd_picture_write(&sheet, job->opt.output, job->opt.bits, err);
	gd_picture_free(&sheet);
	return rc;
}

static int run(struct job *job, struct gd_err *err)
{
	int rc = set_up(job, err);

	if (rc == GD_OK)
		rc = gd_plugin_check(err);
	for (int i = 0; rc == GD_OK && i < job->nimage; i++)
		rc = draw_image(job, i, job->cli.noperand ? job->cli.operand[i] : "-", err);
	if (rc == GD_OK)
		rc = write_result(job, err);
	free_job(job);
	return rc;
}

int main(int argc, char **argv)
{
	struct job job = { .opt = { .output = "-",
				    .layers = "colour",
				    .as = "auto",
				    .scale = "auto",
				    .zoom = 1,
				    .bits = 8 } };
	struct options *opt = &job.opt;
	const struct gd_opt opts[] = {
		GD_OPT('o', "output", "FILE.png", &opt->output,
		       "write the picture to FILE.png; - is standard output"),
		GD_OPT('l', "layer", "LAYER,...", &opt->layers,
		       "layer to show; several with --sheet"),
		GD_OPT(0, "as", "KIND", &opt->as,
		       "auto, colour, scalar, signed, normal or position"),
		GD_NUM('e', "exposure", "STOPS", &opt->exposure, -64, 64,
		       "brighten colour by STOPS powers of two"),
		GD_OPT(0, "display", "NAME", &opt->display, "OpenColorIO display"),
		GD_OPT(0, "view", "NAME", &opt->view, "OpenColorIO view"),
		GD_OPT(0, "range", "LO,HI", &opt->range,
		       "values at the ends of the false colours (1st and 99th percentile)"),
		GD_OPT(0, "scale", "SCALE", &opt->scale,
		       "of false colours: auto, linear, sqrt or log"),
		GD_FLAG(0, "legend", &opt->legend, "a bar of the false colours below the picture"),
		GD_FLAG(0, "sheet", &opt->sheet, "all images and layers on one sheet, with labels"),
		GD_OPT(0, "labels", "A,B,...", &opt->labels,
		       "labels of the sheet instead of names"),
		GD_NUM(0, "columns", "N", &opt->columns, 0, 1000,
		       "pictures in a row of the sheet; 0: as many as images"),
		GD_OPT(0, "crop", "X0,X1,Y0,Y1", &opt->crop,
		       "show these pixels only; X1 or Y1 below 0 is a size"),
		GD_NUM(0, "zoom", "N", &opt->zoom, 1, 64, "show each pixel as N x N"),
		GD_NUM(0, "bits", "N", &opt->bits, 8, 16, "bits of a PNG channel, 8 or 16"),
		GD_NUM(0, "part", "N", &job.cli.part, 0, 1e6,
		       "read part N of a multi-part file, from 0"),
		GD_OPT_END
	};
	const struct gd_cmd cmd = { .name = "gdshow",
				    .operands = "[input.exr [output.png]] | --sheet image.exr...",
				    .summary = "show layers as PNG",
				    .opts = opts,
				    .min_operands = 0,
				    .max_operands = -1 };
	struct gd_err err = { 0 };
	int rc;

	gd_cli_parse(&job.cli, &cmd, argc, argv);
	rc = run(&job, &err);
	return gd_cli_finish(&job.cli, rc, &err);
}
