/* SPDX-License-Identifier: BSD-3-Clause */
/* gdrender: a gradient-domain path tracer. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "cli.h"
#include "crop.h"
#include "render/render.h"

#define WIDTH	640
#define HEIGHT	480
#define SPP	16

enum { SAMPLING, GRADIENTS, PAIRS, MAPS };

struct options {
	const char *size, *crop, *gradients, *camera, *environment, *sky;
	const char *map[MAPS];		/* paths, or NULL */
	int spp, bins, depth;
	double time, share, ratio, ambient, aperture, focus;
	uint64_t seed;
	bool reuse;
};

struct job {
	struct gd_cli cli;
	struct options opt;
	struct gd_image file[MAPS];
	const struct gd_image *map[MAPS];	/* the file it came in */
	struct gd_pairs pairs;
	struct gd_scene_options scene;
	struct gd_render_conf conf;
};

static const char *const map_channel[] = { "sampling", "gradients", "pairs" };

/* ---- options ---- */

static int parse_size(int *w, int *h, const char *text, struct gd_err *err)
{
	int end = -1;

	if (sscanf(text, "%9dx%9d%n", w, h, &end) != 2 || end < 0 || text[end])
		return gd_fail(err, GD_EARG, "--size \"%s\" is not WIDTHxHEIGHT", text);
	if (*w < 1 || *h < 1 || *w > GD_MAX_SIDE || *h > GD_MAX_SIDE)
		return gd_fail(err, GD_EARG, "--size %s: expected sides of 1 to %d", text,
			       GD_MAX_SIDE);
	return GD_OK;
}

/* One number, or three with commas between them. */
static int parse_sky(struct gd_v3 *sky, const char *text, struct gd_err *err)
{
	int end = -1;
	bool good;

	if (sscanf(text, "%f,%f,%f%n", &sky->x, &sky->y, &sky->z, &end) != 3) {
		end = -1;
		if (sscanf(text, "%f%n", &sky->x, &end) != 1)
			end = -1;
		sky->y = sky->z = sky->x;
	}
	good = end >= 0 && !text[end];
	if (!good)
		return gd_fail(err, GD_EARG, "--sky \"%s\" is neither a number nor R,G,B", text);
	if (!(sky->x >= 0 && sky->y >= 0 && sky->z >= 0 && gd_largest(*sky) <= GD_SKY_MAX))
		return gd_fail(err, GD_EARG, "--sky %s: expected radiance from 0 to %g", text,
			       (double)GD_SKY_MAX);
	return GD_OK;
}

/* A share, or else the name of a map. */
static int parse_gradients(struct options *opt, struct gd_err *err)
{
	char *end;

	opt->share = 1;
	if (!opt->gradients)
		return GD_OK;
	opt->share = strtod(opt->gradients, &end);
	if (end == opt->gradients || *end) {
		opt->share = 0;
		opt->map[GRADIENTS] = opt->gradients;
	} else if (!(opt->share >= 0 && opt->share <= 1)) {
		return gd_fail(err, GD_EARG, "--gradients %s: expected 0 to 1, or a map",
			       opt->gradients);
	}
	return GD_OK;
}

static int settle(struct job *job, struct gd_err *err)
{
	struct options *opt = &job->opt;
	struct gd_render_conf *conf = &job->conf;
	int rc = parse_gradients(opt, err);

	if (rc == GD_OK && opt->size)
		rc = parse_size(&conf->w, &conf->h, opt->size, err);
	if (rc == GD_OK && opt->sky)
		rc = parse_sky(&job->scene.sky, opt->sky, err);
	if (rc != GD_OK)
		return rc;
	if (!strcmp(job->cli.input, "-"))
		return gd_fail(err, GD_EARG,
			       "a scene is not read from standard input: name its file");
	if (opt->environment && opt->sky)
		return gd_fail(err, GD_EARG, "--environment and --sky are two skies: give one");
	if (opt->focus > 0 && !(opt->aperture > 0))
		return gd_fail(err, GD_EARG, "--focus without an --aperture changes nothing");
	if (opt->map[PAIRS] && !opt->map[GRADIENTS] && !(opt->share > 0))
		return gd_fail(err, GD_EARG,
			       "--pairs tells where gradients are, and --gradients 0 takes none");
	if (opt->bins == 1)
		return gd_fail(err, GD_EARG, "--bins 1: expected 0, or 2 to %d", GD_RENDER_BINS);
	if (opt->map[SAMPLING] && opt->spp)
		return gd_fail(err, GD_EARG,
			       "--spp and --sampling both tell the samples: give one");
	conf->spp = opt->spp || opt->time > 0 ? opt->spp : SPP;
	conf->share = opt->share;
	conf->bins = opt->bins;
	if (!opt->map[SAMPLING] && !(opt->time > 0) && conf->spp < conf->bins) {
		conf->bins = conf->spp > 1 ? conf->spp : 0;
		gd_note(&job->cli.report, "%d bins, as there are no more samples", conf->bins);
	}
	conf->seconds = opt->time;
	conf->reuse = opt->reuse;
	conf->seed = opt->seed;
	conf->path = (struct gd_path_conf){ .depth = opt->depth, .shift_ratio = (float)opt->ratio,
					    .ambient = (float)opt->ambient, .mis = true };
	return GD_OK;
}

/* ---- maps ---- */

static const char *called(const char *path)
{
	return strcmp(path, "-") ? path : "stdin";
}

/* Marks what a file is read for: it may be several maps in one. */
static int want_maps(struct job *job, const char *path, struct gd_image *im, struct gd_err *err)
{
	for (int i = 0; i < im->nchan; i++)
		im->chan[i].want = GD_DROP;
	for (int i = 0; i < MAPS; i++) {
		int found;

		if (!job->opt.map[i] || strcmp(job->opt.map[i], path))
			continue;
		job->map[i] = im;
		if (i == PAIRS) {
			gd_pairs_want(im);
			continue;
		}
		found = gd_image_find(im, map_channel[i]);
		if (found < 0)
			return gd_fail(err, GD_ESHAPE, "no channel %s", map_channel[i]);
		im->chan[found].want = GD_READ;
	}
	return GD_OK;
}

static int load_map(struct job *job, int which, struct gd_err *err)
{
	const char *path = job->opt.map[which];
	struct gd_image *im = &job->file[which];
	struct gd_exr *file = NULL;
	int rc = GD_OK;

	if (!path || job->map[which])
		return GD_OK;
	job->cli.about = called(path);
	rc = gd_cli_open(&job->cli, &file, im, path, err);
	if (rc != GD_OK)
		return rc;
	rc = want_maps(job, path, im, err);
	if (rc == GD_OK)
		rc = gd_cli_load(&job->cli, file, im, err);
	else
		gd_exr_close(file);
	if (rc == GD_OK && job->map[PAIRS] == im)
		rc = gd_pairs_from_image(&job->pairs, im, err);
	if (rc == GD_OK)
		job->cli.about = NULL;
	return rc;
}

/* The size of the image and what of it is rendered: as asked for, or as the maps have it. */
static int find_size(struct job *job, struct gd_err *err)
{
	struct gd_render_conf *conf = &job->conf;
	const struct gd_image *like = NULL;
	const char *crop = job->opt.crop;
	int rc;

	for (int i = 0; i < MAPS && !conf->w && !like; i++)
		like = job->map[i];
	if (!conf->w) {
		conf->w = like ? like->display.x1 - like->display.x0 + 1 : WIDTH;
		conf->h = like ? like->display.y1 - like->display.y0 + 1 : HEIGHT;
	}
	rc = gd_crop_parse(&conf->crop, crop, conf->w, conf->h, err);
	if (rc == GD_OK && like && !crop) {
		const struct gd_box b = { like->data.x0 - like->display.x0,
					  like->data.y0 - like->display.y0,
					  like->data.x1 - like->display.x0,
					  like->data.y1 - like->display.y0 };

		if (b.x0 >= 0 && b.y0 >= 0 && b.x1 < conf->w && b.y1 < conf->h)
			conf->crop = b;
	}
	if (rc == GD_ESHAPE)	/* not the scene's fault */
		err->code = rc = GD_EARG;
	job->scene.w = conf->w;
	job->scene.h = conf->h;
	return rc;
}

/* A map is of the whole image, or of what is rendered. */
static int check_shape(const struct job *job, int which, struct gd_err *err)
{
	const struct gd_render_conf *conf = &job->conf;
	const struct gd_image *im = job->map[which];
	const int w = conf->crop.x1 - conf->crop.x0 + 1, h = conf->crop.y1 - conf->crop.y0 + 1;

	if ((im->w == conf->w && im->h == conf->h) || (im->w == w && im->h == h))
		return GD_OK;
	return gd_fail(err, GD_EARG, "%s: %s is %d x %d, expected %d x %d",
		       called(job->opt.map[which]), map_channel[which], im->w, im->h, conf->w,
		       conf->h);
}

static int take_map(const struct job *job, int which, struct gd_plane *plane, double most,
		    bool whole, struct gd_err *err)
{
	const struct gd_render_conf *conf = &job->conf;
	const char *name = map_channel[which];
	int rc = check_shape(job, which, err);

	if (rc != GD_OK)
		return rc;
	gd_image_plane(job->map[which], name, plane);
	if (plane->w == conf->w && plane->h == conf->h)
		*plane = gd_crop_plane(*plane, conf->crop);
	for (int y = 0; y < plane->h; y++)
		for (int x = 0; x < plane->w; x++) {
			const double v = (double)gd_row(*plane, y)[x];

			if (!(v >= 0 && v <= most) || (whole && v != floor(v)))
				return gd_fail(err, GD_EARG, "%s: %s is %g at (%d, %d), expected "
					       "%s0 to %.10g", called(job->opt.map[which]), name, v,
					       x + conf->crop.x0, y + conf->crop.y0,
					       whole ? "a whole number, " : "", most);
		}
	return GD_OK;
}

static int take_maps(struct job *job, struct gd_err *err)
{
	struct gd_render_conf *conf = &job->conf;
	int rc = GD_OK;

	if (job->opt.map[SAMPLING])
		rc = take_map(job, SAMPLING, &conf->counts, GD_RENDER_SAMPLES, true, err);
	if (rc == GD_OK && job->opt.map[GRADIENTS])
		rc = take_map(job, GRADIENTS, &conf->shares, 1, false, err);
	if (rc == GD_OK && job->opt.map[PAIRS]) {
		rc = check_shape(job, PAIRS, err);
		conf->pairs = &job->pairs;
	}
	return rc;
}

/* ---- the run ---- */

static void drop_attribute(struct gd_image *im, const char *name)
{
	for (int i = 0; i < im->nattr; i++)
		if (!strcmp(im->attr[i].name, name)) {
			free(im->attr[i].name);
			free(im->attr[i].type);
			free(im->attr[i].data);
			im->attr[i] = im->attr[--im->nattr];
			return;
		}
}

static void tell(struct job *job, const struct gd_image *im, double load, double render)
{
	struct gd_cli *cli = &job->cli;
	double spp = 0, cpu = 0;

	gd_attr_number(im, "gd:samplesPerPixel", &spp);
	gd_attr_number(im, "gd:renderSeconds", &cpu);
	gd_note(&cli->report, "%d x %d pixels, %.6g samples a pixel, %.3f s, %.3f s of processors",
		im->w, im->h, spp, render, cpu);
	gd_cli_stat(cli, "width", im->w);
	gd_cli_stat(cli, "height", im->h);
	gd_cli_stat(cli, "samples", spp);
	gd_cli_stat(cli, "load_seconds", load);
	gd_cli_stat(cli, "render_seconds", render);
	gd_cli_stat(cli, "cpu_seconds", cpu);
	gd_cli_stat(cli, "samples_per_second", spp * im->w * im->h / fmax(render, 1e-9));
}

static int run(struct job *job, struct gd_image *im, struct gd_err *err)
{
	const struct gd_report *report = &job->cli.report;
	struct gd_scene *scene = NULL;
	double start, load = 0;
	int rc = GD_OK;

	for (int i = 0; i < MAPS && rc == GD_OK; i++)
		rc = load_map(job, i, err);
	if (rc == GD_OK)
		rc = find_size(job, err);
	if (rc == GD_OK)
		rc = take_maps(job, err);
	start = gd_seconds();
	if (rc == GD_OK)
		rc = gd_scene_load(&scene, job->cli.input, &job->scene, report, err);
	load = gd_seconds() - start;
	job->cli.io_seconds += load;
	start = gd_seconds();
	if (rc == GD_OK)
		rc = gd_render(im, scene, &job->conf, report, err);
	if (rc == GD_OK)
		tell(job, im, load, gd_seconds() - start);
	gd_scene_free(scene);
	if (rc == GD_OK && getenv("SOURCE_DATE_EPOCH"))
		drop_attribute(im, "gd:renderSeconds");
	return rc == GD_OK ? gd_cli_write(&job->cli, im, err) : rc;
}

static void release(struct job *job)
{
	for (int i = 0; i < MAPS; i++)
		gd_image_free(&job->file[i]);
	gd_pairs_free(&job->pairs);
}

int main(int argc, char **argv)
{
	struct job job = { .opt = { .bins = 8, .depth = 8, .ratio = 20, .seed = 1 } };
	struct options *opt = &job.opt;
	const struct gd_opt opts[] = {
		GD_OPT(0, "size", "WxH", &opt->size,
		       "pixels of the image; by default 640x480, or as many as a map has"),
		GD_OPT(0, "crop", "X0,X1,Y0,Y1", &opt->crop,
		       "render columns X0 to X1 - 1 and rows Y0 to Y1 - 1 alone"),
		GD_NUM(0, "spp", "N", &opt->spp, 0, GD_RENDER_SAMPLES,
		       "samples a pixel; 0: 16, or with --time what fits"),
		GD_NUM(0, "time", "SECONDS", &opt->time, 0, 1e9,
		       "render as many samples as fit into so long; 0: no limit"),
		GD_OPT(0, "sampling", "MAP.exr", &opt->map[SAMPLING],
		       "samples of each pixel, as gdsample writes them"),
		GD_OPT(0, "gradients", "SHARE|MAP.exr", &opt->gradients,
		       "share of the samples that trace offset paths, 0 to 1; by default 1"),
		GD_OPT(0, "pairs", "FILE.exr", &opt->map[PAIRS],
		       "gradients between pixels that are alike, as FILE has them or its features"),
		GD_NUM(0, "bins", "N", &opt->bins, 0, GD_RENDER_BINS, "independent parts; 0: none"),
		GD_NUM(0, "depth", "N", &opt->depth, 1, 255, "segments of the longest path"),
		GD_OPT('s', "seed", "NUMBER", &opt->seed, "seed of the random numbers"),
		GD_NUM(0, "shift-ratio", "T", &opt->ratio, 1, 1e9,
		       "paths that differ by more than this factor are not compared"),
		GD_NUM(0, "ambient", "RADIANCE", &opt->ambient, 0, 1e9,
		       "ambient light of the gradients' paths"),
		GD_FLAG(0, "reuse-offsets", &opt->reuse,
			"the colour uses the offset paths of the neighbours, too"),
		GD_OPT(0, "camera", "NAME", &opt->camera, "the camera; by default the first"),
		GD_NUM(0, "aperture", "RADIUS", &opt->aperture, 0, 1e6,
		       "radius of the lens in metres; 0: a pinhole"),
		GD_NUM(0, "focus", "DISTANCE", &opt->focus, 0, 1e9,
		       "metres to what is sharp; 0: what the centre of the image shows"),
		GD_OPT(0, "environment", "FILE", &opt->environment,
		       "light from all around: an image, latitude by longitude"),
		GD_OPT(0, "sky", "R[,G,B]", &opt->sky, "the same radiance from all around"),
		GD_OPT_END
	};
	const struct gd_cmd cmd = { .name = "gdrender",
				    .operands = "scene.gltf [output.exr]",
				    .summary = "render a scene, with the gradients of its image",
				    .opts = opts,
				    .min_operands = 1,
				    .max_operands = 2,
				    .filter = true };
	struct gd_image im = { 0 };
	struct gd_err err = { 0 };
	int rc;

	gd_cli_parse(&job.cli, &cmd, argc, argv);
	job.scene = (struct gd_scene_options){ .camera = opt->camera,
					       .environment = opt->environment,
					       .aperture = (float)opt->aperture,
					       .focus = (float)opt->focus };
	rc = settle(&job, &err);
	if (rc == GD_OK)
		rc = run(&job, &im, &err);
	gd_image_free(&im);
	release(&job);
	return gd_cli_finish(&job.cli, rc, &err);
}
