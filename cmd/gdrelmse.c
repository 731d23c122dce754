/* SPDX-License-Identifier: BSD-3-Clause */
/* gdrelmse: images against a reference, as numbers. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "cli.h"
#include "crop.h"
#include "file.h"
#include "plugin.h"
#include "relmse.h"
#include "show.h"
#include "table.h"

enum windows { SAME, OVERLAP, IGNORE };
enum format { TEXT, TSV, JSON };

struct options {
	const char *reference, *form, *layer, *reference_layer, *windows, *crop, *mask;
	const char *error, *heatmap, *format, *output;
	struct gd_relmse_conf conf;
	double max, heatmap_max;
	int block;
	bool plain, channels, rank;
	enum windows window_rule;
	enum format out;
};

/* A file, and the planes of it that are compared. */
struct source {
	struct gd_image im;
	int n;
	bool halves;
	struct gd_plane v[GD_LAYER_PLANES], a[GD_LAYER_PLANES], b[GD_LAYER_PLANES];
	struct gd_layer layer;
};

struct result {
	const char *name;
	struct gd_relmse m;
	struct gd_relmse_rank rank;
	double seconds, render;		/* NaN where the file does not say */
	struct gd_picture heatmap;	/* with --heatmap */
};

struct job {
	struct gd_cli cli;
	struct options opt;
	struct source ref, mask;
	bool masked;
	int nresult;
	struct result *result;
	char channel[GD_LAYER_PLANES][32];	/* names of their columns */
};

static int choose(const char *what, const char *text, const char *const names[], int *value,
		  struct gd_err *err)
{
	for (int i = 0; names[i]; i++)
		if (!strcmp(text, names[i])) {
			*value = i;
			return GD_OK;
		}
	return gd_fail(err, GD_EARG, "--%s: \"%s\" is none of %s, %s, %s", what, text, names[0],
		       names[1], names[2]);
}

static int check_options(struct options *opt, struct gd_err *err)
{
	static const char *const rules[] = { "same", "overlap", "ignore", NULL };
	static const char *const formats[] = { "text", "tsv", "json", NULL };
	int rule = 0, format = 0, rc;

	if (!gd_relmse_form_find(opt->form, &opt->conf.form))
		return gd_fail(err, GD_EARG,
			       "--form: \"%s\" is none of r2+eps, (r+eps)2, lum, mean, half",
			       opt->form);
	rc = choose("windows", opt->windows, rules, &rule, err);
	if (rc == GD_OK)
		rc = choose("format", opt->format, formats, &format, err);
	opt->window_rule = (enum windows)rule;
	opt->out = (enum format)format;
	if (!strcmp(opt->layer, "colour"))
		opt->layer = "";
	if (!opt->reference_layer)
		opt->reference_layer = opt->layer;
	else if (!strcmp(opt->reference_layer, "colour"))
		opt->reference_layer = "";
	return rc;
}

static const char *shown(const char *path)
{
	return strcmp(path, "-") ? path : "standard input";
}

static int open_source(struct job *job, struct gd_exr **file, struct source *s, const char *path,
		       struct gd_err *err)
{
	int rc = gd_cli_open(&job->cli, file, &s->im, path, err);

	for (int i = 0; rc == GD_OK && i < s->im.nchan; i++)
		s->im.chan[i].want = GD_DROP;
	return rc;
}

static int no_layer(const char *path, const char *layer, struct gd_err *err)
{
	return gd_fail(err, GD_ESHAPE, "%s: no channel %s%s", shown(path), *layer ? layer : "R",
		       *layer ? " (nor .R .G .B, .X .Y .Z of it)" : "");
}

static void half_name(char *name, size_t size, int half, const char *layer)
{
	snprintf(name, size, "half%d%s%s", half, *layer ? "." : "", layer);
}

/* The halves if the file has both and they may be used, else the layer itself. */
static int load_reference(struct job *job, const char *path, struct gd_err *err)
{
	struct source *s = &job->ref;
	const char *layer = job->opt.reference_layer;
	struct gd_exr *file = NULL;
	char half[2][256];
	int n[2], rc = open_source(job, &file, s, path, err);

	if (rc != GD_OK)
		return rc;
	for (int i = 0; i < 2; i++) {
		half_name(half[i], sizeof(half[i]), i, layer);
		n[i] = gd_layer_find(&s->im, half[i]).n;
	}
	s->halves = !job->opt.plain && n[0] > 0 && n[0] == n[1];
	s->layer = gd_layer_find(&s->im, s->halves ? half[0] : layer);
	if (s->halves) {
		gd_layer_want(&s->im, half[0], GD_READ);
		gd_layer_want(&s->im, half[1], GD_READ);
	} else if (!gd_layer_want(&s->im, layer, GD_READ)) {
		gd_exr_close(file);
		return no_layer(path, layer, err);
	}
	rc = gd_cli_load(&job->cli, file, &s->im, err);
	if (rc != GD_OK)
		return rc;
	s->n = s->halves ? gd_layer_planes(&s->im, half[0], s->a) :
			   gd_layer_planes(&s->im, layer, s->v);
	if (s->halves)
		gd_layer_planes(&s->im, half[1], s->b);
	return GD_OK;
}

/* FILE or FILE:channel; the channel defaults to mask, Y, R, or the only one. */
static int mask_channel(const struct gd_image *im, const char *path, const char *channel, int *i,
			struct gd_err *err)
{
	static const char *const usual[] = { "mask", "Y", "R" };

	*i = channel ? gd_image_find(im, channel) : -1;
	for (int k = 0; !channel && *i < 0 && k < 3; k++)
		*i = gd_image_find(im, usual[k]);
	if (*i < 0 && !channel && im->nchan == 1)
		*i = 0;
	if (*i < 0)
		return gd_fail(err, GD_ESHAPE, "%s: no channel %s for the mask", path,
			       channel ? channel : "mask, Y or R");
	return GD_OK;
}

static int load_mask(struct job *job, struct gd_err *err)
{
	char path[4096], *channel = NULL;
	struct gd_exr *file = NULL;
	struct source *s = &job->mask;
	int i, rc;

	if (!job->opt.mask)
		return GD_OK;
	snprintf(path, sizeof(path), "%s", job->opt.mask);
	if (access(path, F_OK) && (channel = strrchr(path, ':')))
		*channel++ = '\0';
	rc = open_source(job, &file, s, path, err);
	if (rc != GD_OK)
		return rc;
	rc = mask_channel(&s->im, path, channel, &i, err);
	if (rc != GD_OK) {
		gd_exr_close(file);
		return rc;
	}
	s->im.chan[i].want = GD_READ;
	rc = gd_cli_load(&job->cli, file, &s->im, err);
	if (rc == GD_OK)
		s->v[0] = gd_plane_of(s->im.chan[0].v, s->im.w, s->im.h);
	job->masked = rc == GD_OK;
	s->n = 1;
	return rc;
}

/* The pixels of u and v that are compared, each in its own rows and columns. */
static int match_windows(struct gd_box *u_box, struct gd_box *v_box, const struct gd_image *u,
			 const struct gd_image *v, enum windows rule, const char *name,
			 struct gd_err *err)
{
	struct gd_box p = u->data, q = v->data;
	int x0 = p.x0 > q.x0 ? p.x0 : q.x0, x1 = p.x1 < q.x1 ? p.x1 : q.x1;
	int y0 = p.y0 > q.y0 ? p.y0 : q.y0, y1 = p.y1 < q.y1 ? p.y1 : q.y1;
	bool moved = p.x0 != q.x0 || p.y0 != q.y0;

	if (rule == OVERLAP) {
		if (x1 < x0 || y1 < y0)
			return gd_fail(err, GD_ESHAPE,
				       "%s: its data window and the reference's do not overlap",
				       name);
		*u_box = (struct gd_box){ x0 - p.x0, y0 - p.y0, x1 - p.x0, y1 - p.y0 };
		*v_box = (struct gd_box){ x0 - q.x0, y0 - q.y0, x1 - q.x0, y1 - q.y0 };
		return GD_OK;
	}
	if (u->w != v->w || u->h != v->h)
		return gd_fail(err, GD_ESHAPE, "%s is %dx%d, the reference %dx%d", name, u->w, u->h,
			       v->w, v->h);
	if (rule == SAME && moved)
		return gd_fail(err, GD_ESHAPE, "%s: its data window begins at (%d, %d), the "
			       "reference's at (%d, %d); see --windows", name, p.x0, p.y0, q.x0,
			       q.y0);
	*u_box = *v_box = (struct gd_box){ 0, 0, u->w - 1, u->h - 1 };
	return GD_OK;
}

static struct gd_box inside(struct gd_box outer, struct gd_box inner)
{
	return (struct gd_box){ outer.x0 + inner.x0, outer.y0 + inner.y0, outer.x0 + inner.x1,
				outer.y0 + inner.y1 };
}

static void crop_all(struct gd_plane *out, const struct gd_plane *p, int n, struct gd_box box)
{
	for (int c = 0; c < n; c++)
		out[c] = gd_crop_plane(p[c], box);
}

/* What is compared of image s and the reference, after windows, crop and mask. */
static int line_up(struct gd_relmse_in *in, struct gd_plane *est, const struct job *job,
		   const struct source *s, const char *name, struct gd_err *err)
{
	const struct source *ref = &job->ref;
	struct gd_box u, v, part, m;
	int rc = match_windows(&u, &v, &s->im, &ref->im, job->opt.window_rule, name, err);

	if (rc == GD_OK)
		rc = gd_crop_parse(&part, job->opt.crop, u.x1 - u.x0 + 1, u.y1 - u.y0 + 1, err);
	if (rc != GD_OK)
		return rc;
	if (job->masked && (job->mask.im.w != ref->im.w || job->mask.im.h != ref->im.h))
		return gd_fail(err, GD_ESHAPE, "mask %s is %dx%d, the reference %dx%d",
			       job->opt.mask, job->mask.im.w, job->mask.im.h, ref->im.w, ref->im.h);
	u = inside(u, part);
	m = v = inside(v, part);
	*in = (struct gd_relmse_in){ .n = s->n, .halves = ref->halves };
	crop_all(in->x, s->v, s->n, u);
	crop_all(est, s->a, s->n, u);
	if (ref->halves) {
		crop_all(in->a, ref->a, s->n, v);
		crop_all(in->b, ref->b, s->n, v);
	} else {
		crop_all(in->r, ref->v, s->n, v);
	}
	if (job->masked)
		in->mask = gd_crop_plane(job->mask.v[0], m);
	return GD_OK;
}

/* v: the layer; a: with --rank the estimate of its error. */
static int load_image(struct job *job, struct source *s, const char *path, struct gd_err *err)
{
	const struct options *opt = &job->opt;
	struct gd_exr *file = NULL;
	int n, ne = 0, rc = open_source(job, &file, s, path, err);

	if (rc != GD_OK)
		return rc;
	n = gd_layer_want(&s->im, opt->layer, GD_READ);
	if (opt->rank)
		ne = gd_layer_want(&s->im, opt->error, GD_READ);
	if (!n)
		rc = no_layer(path, opt->layer, err);
	else if (n != job->ref.n)
		rc = gd_fail(err, GD_ESHAPE, "%s: %d channels, the reference has %d", shown(path),
			     n, job->ref.n);
	else if (opt->rank && !ne)
		rc = no_layer(path, opt->error, err);
	else if (opt->rank && ne != n)
		rc = gd_fail(err, GD_ESHAPE, "%s: layer %s has %d channels, expected %d",
			     shown(path), opt->error, ne, n);
	if (rc != GD_OK) {
		gd_exr_close(file);
		return rc;
	}
	rc = gd_cli_load(&job->cli, file, &s->im, err);
	if (rc == GD_OK)
		s->n = gd_layer_planes(&s->im, opt->layer, s->v);
	if (rc == GD_OK && opt->rank)
		gd_layer_planes(&s->im, opt->error, s->a);
	return rc;
}

/* Seconds of all stages, as the tools added them to the file. */
static double sum_seconds(const struct gd_image *im)
{
	double sum = NAN, one;

	for (int i = 0; i < im->nattr; i++)
		if (!strncmp(im->attr[i].name, "gd:seconds.", 11) &&
		    gd_attr_number(im, im->attr[i].name, &one))
			sum = isnan(sum) ? one : sum + one;
	return sum;
}

static int draw(struct gd_picture *pic, const struct job *job, const struct gd_relmse_in *in,
		struct gd_err *err)
{
	const int w = in->x[0].w, h = in->x[0].h;
	struct gd_show_conf conf = { .as = GD_SHOW_SCALAR };
	struct gd_plane map = gd_plane_of(gd_alloc((size_t)h, gd_stride(w) * sizeof(float)), w, h);
	int rc;

	conf.range = (struct gd_show_range){ 0, (float)job->opt.heatmap_max, GD_SHOW_LINEAR };
	if (map.v)
		rc = gd_relmse_map(map, in, &job->opt.conf, err);
	else
		rc = gd_fail(err, GD_ENOMEM, "out of memory (%dx%d pixels)", w, h);
	if (rc == GD_OK)
		rc = gd_show(pic, NULL, &map, 1, &conf, err);
	if (rc == GD_OK)
		rc = gd_picture_legend(pic, &conf, err);
	free(map.v);
	return rc;
}

static int compare(struct job *job, const char *path, struct gd_err *err)
{
	struct source s = { 0 };
	struct gd_relmse_in in;
	struct gd_plane est[GD_LAYER_PLANES] = { 0 };
	struct result *res = &job->result[job->nresult];
	int rc = load_image(job, &s, path, err);

	if (rc == GD_OK)
		rc = line_up(&in, est, job, &s, shown(path), err);
	if (rc == GD_OK)
		rc = gd_relmse(&res->m, NULL, &in, &job->opt.conf, err);
	if (rc == GD_OK && job->opt.rank)
		rc = gd_relmse_rank(&res->rank, &in, est, job->opt.block, err);
	if (rc == GD_OK && job->opt.heatmap)
		rc = draw(&res->heatmap, job, &in, err);
	if (rc == GD_OK) {
		res->name = path;
		res->seconds = sum_seconds(&s.im);
		if (!gd_attr_number(&s.im, "gd:renderSeconds", &res->render))
			res->render = NAN;
		job->nresult++;
	}
	gd_image_free(&s.im);
	return rc;
}

static void warn(struct job *job)
{
	for (int i = 0; i < job->nresult; i++)
		if (job->result[i].m.nonfinite)
			gd_cli_warn(&job->cli, "%s: %zu pixels with NaN or Inf, counted as 0",
				    shown(job->result[i].name), job->result[i].m.nonfinite);
	if (job->nresult && job->result[0].m.nonfinite_reference)
		gd_cli_warn(&job->cli, "the reference has NaN or Inf in %zu pixels, left out",
			    job->result[0].m.nonfinite_reference);
}

static const char *channel_suffix(const struct job *job, int c)
{
	const char *name = job->ref.layer.name[c], *dot = strrchr(name, '.');

	return dot ? dot + 1 : name;
}

static void add(struct gd_table *t, const char *name, const char *heading, struct gd_row *row,
		double value)
{
	t->column[t->ncolumn] = (struct gd_column){ name, heading };
	row->value[t->ncolumn++] = value;
}

/* The columns of the table and the values of one row. */
static void fill_row(struct gd_table *t, struct gd_row *row, struct job *job,
		     const struct result *r)
{
	const struct gd_relmse *m = &r->m;
	double bias = m->mean - m->reference;

	t->ncolumn = 0;
	row->name = r->name;
	add(t, "relmse", "relMSE", row, m->relmse);
	for (int c = 0; job->opt.channels && c < job->ref.n; c++) {
		snprintf(job->channel[c], sizeof(job->channel[c]), "relmse.%.20s",
			 channel_suffix(job, c));
		add(t, job->channel[c], job->channel[c], row, m->channel[c]);
	}
	add(t, "trimmed", "trimmed", row, m->trimmed);
	add(t, "mse", "MSE", row, m->mse);
	add(t, "mae", NULL, row, m->mae);
	add(t, "mape", "MAPE", row, m->mape);
	add(t, "smape", "SMAPE", row, m->smape);
	add(t, "bias", NULL, row, bias);
	add(t, "bias_percent", "bias%", row,
	    m->reference != 0 ? 100 * bias / m->reference : (double)NAN);
	add(t, "p50", "p50", row, m->p50);
	add(t, "p95", "p95", row, m->p95);
	add(t, "p99", "p99", row, m->p99);
	add(t, "max", "max", row, m->max);
	if (job->opt.rank) {
		add(t, "rank", "rank", row, r->rank.rho);
		add(t, "estimate_ratio", "est/true", row, r->rank.ratio);
	}
	add(t, "nonfinite", "nonfinite", row, (double)m->nonfinite);
	add(t, "seconds", "seconds", row, r->seconds);
	add(t, "render_seconds", "render", row, r->render);
	add(t, "pixels", NULL, row, (double)m->pixels);
	add(t, "trimmed_pixels", NULL, row, (double)m->ntrimmed);
	add(t, "nonfinite_reference", NULL, row, (double)m->nonfinite_reference);
}

static void print_head(FILE *out, const struct job *job)
{
	const struct options *opt = &job->opt;
	const struct gd_relmse *m = &job->result[0].m;

	fprintf(out, "relMSE: mean of %s, eps = %g, over %d channel%s of %zu pixels\n",
		gd_relmse_formula(opt->conf.form, job->ref.halves), opt->conf.eps, job->ref.n,
		job->ref.n > 1 ? "s" : "", m->pixels);
	if (job->ref.halves)
		fputs("x: image; a, b: the reference's two halves; r: their mean.\n"
		      "relMSE, trimmed, MSE, p50 .. max are free of the reference's own noise; "
		      "MAPE and SMAPE are not.\n",
		      out);
	else
		fputs("x: image; r: reference, whose own noise counts as error.\n", out);
	fprintf(out, "trimmed: without the %zu pixels of largest error (%g %%).\n", m->ntrimmed,
		100 * opt->conf.trim);
	if (opt->rank)
		fprintf(out, "rank: Spearman's correlation of %s with the true squared error over "
			"%zu blocks of %dx%d.\n", opt->error, job->result[0].rank.blocks,
			opt->block, opt->block);
	fputc('\n', out);
}

static int print(FILE *out, struct job *job, const char *reference, struct gd_err *err)
{
	char eps[32];
	const struct gd_remark remarks[] = {
		{ "eps", eps, 1 },
		{ "noise_free", job->ref.halves ? "true" : "false", 1 },
		{ "formula", gd_relmse_formula(job->opt.conf.form, job->ref.halves), 0 },
		{ "reference", reference, 0 },
	};
	struct gd_table t = { .row_heading = "image", .rows_name = "images", .nrow = job->nresult,
			      .remark = remarks, .nremark = 4 };
	int rc = GD_OK;

	snprintf(eps, sizeof(eps), "%g", job->opt.conf.eps);
	t.row = calloc((size_t)t.nrow, sizeof(*t.row));
	if (!t.row)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	for (int i = 0; i < t.nrow; i++)
		fill_row(&t, &t.row[i], job, &job->result[i]);
	if (job->opt.out == JSON) {
		rc = gd_table_json(out, &t, err);
	} else if (job->opt.out == TSV) {
		gd_table_tsv(out, &t);
	} else {
		print_head(out, job);
		gd_table_text(out, &t);
	}
	free(t.row);
	return rc;
}

static int report(struct job *job, const char *reference, struct gd_err *err)
{
	char *text = NULL;
	size_t size = 0;
	FILE *out = open_memstream(&text, &size);
	int rc;

	if (!out)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	rc = print(out, job, reference, err);
	if (fclose(out))
		rc = gd_fail(err, GD_ENOMEM, "out of memory");
	if (rc == GD_OK)
		rc = gd_file_write(job->opt.output, text, size, err);
	free(text);
	return rc;
}

static int write_heatmaps(struct job *job, struct gd_err *err)
{
	char (*text)[300] = calloc((size_t)job->nresult, sizeof(*text));
	const char **label = calloc((size_t)job->nresult, sizeof(*label));
	struct gd_picture *pic = calloc((size_t)job->nresult, sizeof(*pic)), sheet = { 0 };
	int rc = GD_OK;

	if (!text || !label || !pic)
		rc = gd_fail(err, GD_ENOMEM, "out of memory");
	for (int i = 0; rc == GD_OK && i < job->nresult; i++) {
		const char *base = strrchr(job->result[i].name, '/');

		pic[i] = job->result[i].heatmap;
		snprintf(text[i], sizeof(text[i]), "%.4g %s", job->result[i].m.relmse,
			 base ? base + 1 : job->result[i].name);
		label[i] = text[i];
	}
	if (rc == GD_OK)
		rc = gd_picture_sheet(&sheet, pic, label, job->nresult, 4, err);
	if (rc == GD_OK)
		rc = gd_picture_write(&sheet, job->opt.heatmap, 8, err);
	gd_picture_free(&sheet);
	free(text);
	free(label);
	free(pic);
	return rc;
}

/* --max; an image with NaN or Inf does not pass, however small its error. */
static void judge(struct job *job)
{
	for (int i = 0; i < job->nresult; i++) {
		const struct gd_relmse *m = &job->result[i].m;

		if (isfinite(job->opt.max) && (!(m->relmse <= job->opt.max) || m->nonfinite))
			job->cli.limit_missed = true;
		if (job->nresult == 1)
			gd_cli_stat(&job->cli, "relmse", m->relmse);
	}
}

static int run(struct job *job, struct gd_err *err)
{
	struct options *opt = &job->opt;
	int n = job->cli.noperand;
	int rc = check_options(opt, err);
	const char *reference = opt->reference;

	if (rc == GD_OK && opt->heatmap && gd_picture_misnamed(opt->heatmap))
		rc = gd_fail(err, GD_EARG, "--heatmap: %s: a PNG does not get the name of an EXR",
			     opt->heatmap);
	if (rc == GD_OK && !reference && n < 2)
		rc = gd_fail(err, GD_EARG, "need an image and a reference");
	if (rc != GD_OK)
		return rc;
	if (!reference)
		reference = job->cli.operand[--n];
	job->result = calloc((size_t)job->cli.noperand, sizeof(*job->result));
	if (!job->result)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	if (opt->heatmap)
		rc = gd_plugin_check(err);
	if (rc == GD_OK)
		rc = load_reference(job, reference, err);
	if (rc == GD_OK)
		rc = load_mask(job, err);
	for (int i = 0; rc == GD_OK && i < n; i++)
		rc = compare(job, job->cli.operand[i], err);
	if (rc != GD_OK)
		return rc;
	warn(job);
	judge(job);
	if (opt->heatmap)
		rc = write_heatmaps(job, err);
	return rc == GD_OK ? report(job, reference, err) : rc;
}

int main(int argc, char **argv)
{
	struct job job = { .opt = { .form = "r2+eps",
				    .layer = "colour",
				    .windows = "same",
				    .format = "text",
				    .output = "-",
				    .error = "error",
				    .conf = GD_RELMSE_DEFAULTS,
				    .max = INFINITY,
				    .heatmap_max = 0.5,
				    .block = 8 } };
	struct options *opt = &job.opt;
	const struct gd_opt opts[] = {
		GD_OPT('o', "output", "FILE", &opt->output, "write the table to FILE"),
		GD_OPT(0, "format", "FORMAT", &opt->format, "text, tsv or json"),
		GD_OPT('r', "reference", "FILE", &opt->reference,
		       "the reference; then every operand is an image"),
		GD_NUM(0, "eps", "VALUE", &opt->conf.eps, 1e-12, 1e6,
		       "what keeps the divisor from 0"),
		GD_OPT(0, "form", "FORM", &opt->form, "r2+eps, (r+eps)2, lum, mean or half"),
		GD_NUM(0, "trim", "SHARE", &opt->conf.trim, 0, 0.5,
		       "share of the pixels that the trimmed mean drops"),
		GD_FLAG(0, "plain", &opt->plain,
			"compare with the reference itself even if it carries halves"),
		GD_OPT('l', "layer", "LAYER", &opt->layer, "layer of the images to compare"),
		GD_OPT(0, "reference-layer", "LAYER", &opt->reference_layer,
		       "layer of the reference (that of --layer)"),
		GD_FLAG(0, "channels", &opt->channels, "relMSE of each channel too"),
		GD_OPT(0, "crop", "X0,X1,Y0,Y1", &opt->crop,
		       "compare these pixels only; X1 or Y1 below 0 is a size"),
		GD_OPT(0, "mask", "FILE[:CHANNEL]", &opt->mask,
		       "compare pixels only where the mask is 0.5 or more"),
		GD_OPT(0, "windows", "RULE", &opt->windows,
		       "data windows that differ: same, overlap or ignore"),
		GD_FLAG(0, "rank", &opt->rank,
			"does the error layer tell where the error is? rank correlation"),
		GD_OPT(0, "error", "LAYER", &opt->error, "the layer that --rank looks at"),
		GD_NUM(0, "block", "SIDE", &opt->block, 1, 4096,
		       "side of the blocks of --rank, pixels"),
		GD_NUM(0, "max", "VALUE", &opt->max, -1e300, 1e300,
		       "exit with 1 if a relMSE is above VALUE"),
		GD_OPT(0, "heatmap", "FILE.png", &opt->heatmap,
		       "pictures of the relative error of each pixel"),
		GD_NUM(0, "heatmap-max", "VALUE", &opt->heatmap_max, 1e-6, 1e6,
		       "relative error at the bright end"),
		GD_OPT_END
	};
	const struct gd_cmd cmd = { .name = "gdrelmse", .operands = "image.exr... reference.exr",
				    .summary = "compare images with a reference", .opts = opts,
				    .min_operands = 1, .max_operands = -1 };
	struct gd_err err = { 0 };
	int rc;

	gd_cli_parse(&job.cli, &cmd, argc, argv);
	rc = run(&job, &err);
	for (int i = 0; job.result && i < job.cli.noperand; i++)
		gd_picture_free(&job.result[i].heatmap);
	free(job.result);
	gd_image_free(&job.ref.im);
	gd_image_free(&job.mask.im);
	return gd_cli_finish(&job.cli, rc, &err);
}
