/* SPDX-License-Identifier: BSD-3-Clause */
#include "merge.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "merge_state.h"

#define HALF_MAX 65504.0f	/* largest half: what an overflowed variance was at least */

static bool starts(const char *s, const char *with)
{
	return !strncmp(s, with, strlen(with));
}

int gd_merge_begin(struct gd_merge **m, const struct gd_merge_conf *conf, struct gd_err *err)
{
	*m = calloc(1, sizeof **m);
	if (!*m)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	(*m)->conf = *conf;
	return GD_OK;
}

void gd_merge_forget_names(struct gd_merge *m)
{
	gd_names_free(&m->names);
	for (int i = 0; i < m->nsource; i++)
		free(m->source[i]);
	free(m->source);
	m->source = NULL;
	m->nsource = 0;
}

void gd_merge_free(struct gd_merge *m)
{
	if (!m)
		return;
	for (int k = 0; k < m->nlayer; k++) {
		struct merge_layer *l = &m->layer[k];

		gd_count_free(&l->count);
		gd_count_free(&l->parts);
		for (int b = 0; l->bin_count && b < m->bins; b++)
			gd_count_free(&l->bin_count[b]);
		free(l->bin_count);
	}
	for (int i = 0; i < m->ninput; i++)
		free(m->input[i].label);
	gd_merge_forget_names(m);
	gd_image_free(&m->out);
	free(m->input);
	free(m->layer);
	free(m->unit_bin);
	free(m->weight.v);
	free(m->within.v);
	free(m);
}

int gd_merge_want(struct gd_merge *m, int i, struct gd_image *im, struct gd_err *err)
{
	int rc;

	gd_merge_forget_names(m);
	rc = gd_names_resolve(&m->names, im, &m->conf.names, err);
	if (rc != GD_OK)
		return rc;
	m->source = calloc((size_t)im->nchan + 1, sizeof *m->source);
	if (!m->source)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	for (int c = 0; c < im->nchan; c++) {
		m->source[c] = strdup(im->chan[c].name);
		if (!m->source[c])
			return gd_fail(err, GD_ENOMEM, "out of memory");
		m->nsource++;
		im->chan[c].want = GD_DROP;
	}
	for (int k = 0; k < m->names.n; k++) {
		const struct gd_named *l = &m->names.layer[k];
		const struct merge_layer *known = gd_merge_layer(m, l->layer);
		bool wanted = known && known->wanted, read = false;

		if (l->role == GD_ROLE_MEAN)
			read = wanted || gd_merge_in_family(l->layer, "bin") ||
			       (m->input[i].sided && gd_merge_is_side(l->layer)) ||
			       (m->input[i].per_pixel && gd_merge_is_worth(l->layer));
		else if (l->role == GD_ROLE_VARIANCE)
			read = wanted && known->has_variance && !known->spread;
		else if (l->role == GD_ROLE_SAMPLES)
			read = m->input[i].per_pixel;

		for (int c = 0; c < l->n; c++)
			im->chan[l->chan[c]].want = l->role == GD_ROLE_PASS && i == 0 ? GD_PASS :
				read ? GD_READ : GD_DROP;
	}
	return GD_OK;
}

/* Views of a layer's channels in the loaded image, in the order of the result. */
static int planes_of(const struct gd_merge *m, const struct gd_image *im, const struct gd_named *l,
		     struct gd_plane *plane, const char *label, struct gd_err *err)
{
	for (int c = 0; c < l->n; c++)
		if (!gd_image_plane(im, m->source[l->chan[c]], &plane[c]))
			return gd_fail(err, GD_ESHAPE, "%s: no channel %s", label,
				       m->source[l->chan[c]]);
	return GD_OK;
}

static int add_planes(struct gd_merge *m, struct merge_layer *l, struct gd_err *err)
{
	int rc = GD_OK;

	for (int c = 0; c < l->n && rc == GD_OK; c++) {
		const char *suffix = strlen(l->out[c]) > strlen(l->name) + 1 || !*l->name ?
			l->out[c] + strlen(l->name) + !!*l->name : "";
		char name[600];

		rc = gd_image_add(&m->out, l->out[c], &l->mean[c], err);
		snprintf(name, sizeof name, "%s%svariance%s%s", l->name, *l->name ? "." : "",
			 *suffix ? "." : "", suffix);
		if (rc == GD_OK && l->has_variance)
			rc = gd_image_add(&m->out, name, &l->m2[c], err);
		for (int b = 0; b < m->bins && l->binned && rc == GD_OK; b++) {
			snprintf(name, sizeof name, "bin%d.%s", b, l->out[c]);
			rc = gd_image_add(&m->out, name, &l->bin[b][c], err);
		}
	}
	if (l->place && rc == GD_OK)
		m->place[l->name[4] - '0'][l->name[6] == 'y'] = l->mean[0];
	if (rc == GD_OK && l->binned && m->bins && (!m->lockstep || m->sided)) {
		l->bin_count = calloc((size_t)m->bins, sizeof *l->bin_count);
		rc = l->bin_count ? GD_OK : gd_fail(err, GD_ENOMEM, "out of memory");
	}
	return rc;
}

/* The result takes windows, attributes and what cannot be averaged from the first input. */
static int start_output(struct gd_merge *m, struct gd_image *im, struct gd_err *err)
{
	size_t floats = (size_t)m->h * gd_stride(m->w);
	int rc;

	gd_image_init(&m->out, im->w, im->h);
	m->out.data = im->data;
	m->out.display = im->display;
	m->weight = gd_plane_of(gd_alloc(floats, sizeof(float)), m->w, m->h);
	m->within = gd_plane_of(gd_alloc(floats, sizeof(float)), m->w, m->h);
	rc = GD_OK;
	if (!m->weight.v || !m->within.v)
		rc = gd_fail(err, GD_ENOMEM, "out of memory for %d x %d", m->w, m->h);
	if (rc == GD_OK)
		rc = gd_attr_copy(&m->out, im, err);
	for (int c = 0; c < im->nchan && rc == GD_OK; c++) {
		if (!im->chan[c].raw)
			continue;
		rc = gd_image_append(&m->out, im->chan[c].name, im->chan[c].type, err);
		if (rc == GD_OK) {
			m->out.chan[m->out.nchan - 1].want = GD_PASS;
			m->out.chan[m->out.nchan - 1].raw = im->chan[c].raw;
			im->chan[c].raw = NULL;
		}
	}
	for (int k = 0; k < m->nlayer && rc == GD_OK; k++)
		if (m->layer[k].wanted)
			rc = add_planes(m, &m->layer[k], err);
	return rc;
}

/*
 * Seconds of rendering and of earlier stages add up; histories are joined without repeating lines.
 */
static int join_attributes(struct gd_merge *m, const struct gd_image *im, struct gd_err *err)
{
	const struct gd_attr *old = gd_attr_find(&m->out, "gd:history");
	const struct gd_attr *more = gd_attr_find(im, "gd:history");
	int rc = GD_OK;

	for (int i = 0; i < im->nattr && rc == GD_OK; i++) {
		const char *name = im->attr[i].name;
		double a = 0, b;

		if ((strcmp(name, "gd:renderSeconds") && !starts(name, "gd:seconds.")) ||
		    !gd_attr_number(im, name, &b))
			continue;
		gd_attr_number(&m->out, name, &a);
		rc = gd_attr_set_number(&m->out, name, a + b, err);
	}
	if (rc == GD_OK && more && !strcmp(more->type, "string")) {
		char *add = strndup((const char *)more->data, more->size);
		char *text, *line, *save = NULL;
		size_t n = old && !strcmp(old->type, "string") ? old->size : 0;

		text = add ? malloc(n + more->size + 2) : NULL;
		if (!text) {
			free(add);
			return gd_fail(err, GD_ENOMEM, "out of memory");
		}
		if (n)
			memcpy(text, old->data, n);
		text[n] = 0;
		for (line = strtok_r(add, "\n", &save); line; line = strtok_r(NULL, "\n", &save))
			if (!strstr(text, line))
				sprintf(text + strlen(text), "%s%s", *text ? "\n" : "", line);
		rc = gd_attr_set_string(&m->out, "gd:history", text, err);
		free(text);
		free(add);
	}
	return rc;
}

/*
 * Blender writes its samples per pixel as a share of those asked for: none is above 1 then, and
 * this is what a share of 1 stands for.
 */
static double share_of(const struct gd_merge *m, const struct merge_input *in, struct gd_plane p)
{
	if (m->names.preset != GD_NAMES_CYCLES || !(in->spp > 1))
		return 1;
	for (int y = 0; y < p.h; y++)
		for (int x = 0; x < p.w; x++)
			if (gd_row(p, y)[x] > 1)
				return 1;
	return in->spp;
}

#define MOST_SAMPLES 1e15f	/* sums of counts and of their squares stay finite */

/* A plane of counts, in units of one, made fit for weights, with their mean. */
static struct gd_count make_count(struct gd_plane p, float one)
{
	struct gd_count count = { .plane = p };

	for (int y = 0; y < p.h; y++) {
		float *row = gd_row(p, y);

		for (int x = 0; x < p.w; x++) {
			row[x] = isfinite(row[x]) && row[x] > 0 ?
					 fminf(one * row[x], MOST_SAMPLES) : 0;
			count.all += (double)row[x];
		}
	}
	count.all /= (double)p.w * p.h;
	return count;
}

/*
 * Samples per pixel of the whole input: a plane of its "samples", made fit for weights, with their
 * mean in all; or one number.
 */
static int input_count(struct gd_merge *m, int i, const struct gd_image *im, struct gd_count *count,
		       struct gd_err *err)
{
	const struct merge_input *in = &m->input[i];
	const struct gd_named *samples = gd_names_find(&m->names, GD_ROLE_SAMPLES, "samples");
	struct gd_plane plane[GD_NAMED_MAX];
	float one;
	int rc = GD_OK;

	*count = (struct gd_count){ .all = in->spp > 0 ? in->spp : 1 };
	if (!in->per_pixel)
		return GD_OK;
	rc = planes_of(m, im, samples, plane, in->label, err);
	if (rc != GD_OK)
		return rc;
	one = (float)share_of(m, in, plane[0]);
	*count = make_count(plane[0], one);
	return GD_OK;
}

/* The same of either half, if the input tells. */
static int side_counts(struct gd_merge *m, int i, const struct gd_image *im, struct gd_err *err)
{
	int rc = GD_OK;

	memset(m->side, 0, sizeof m->side);
	for (int h = 0; h < 2 && m->input[i].sided && rc == GD_OK; h++) {
		const struct gd_named *samples = gd_names_find(
			&m->names, GD_ROLE_MEAN, h ? "half1.samples" : "half0.samples");
		struct gd_plane plane[GD_NAMED_MAX];

		rc = planes_of(m, im, samples, plane, m->input[i].label, err);
		if (rc == GD_OK)
			m->side[h] = make_count(plane[0], 1).plane;
	}
	return rc;
}

/* What the gradients are worth, where the input tells. */
static int edge_counts(struct gd_merge *m, int i, const struct gd_image *im, struct gd_err *err)
{
	int rc = GD_OK;

	memset(m->worth, 0, sizeof m->worth);
	for (int k = 0; k < m->nlayer && m->input[i].per_pixel && rc == GD_OK; k++) {
		const struct merge_layer *l = &m->layer[k];
		const struct gd_named *named;
		struct gd_plane plane[GD_NAMED_MAX];
		char name[300];

		if (l->half || l->edge < 0)
			continue;
		snprintf(name, sizeof name, "%s.samples", l->name);
		named = gd_names_find(&m->names, GD_ROLE_MEAN, name);
		if (!named)
			continue;
		rc = planes_of(m, im, named, plane, m->input[i].label, err);
		if (rc == GD_OK)
			m->worth[l->edge] = make_count(plane[0], 1).plane;
	}
	return rc;
}

/* Where pairs lead has to be the same in all inputs: the first tells, the others are compared. */
static int join_places(struct gd_merge *m, int i, const struct gd_image *im, struct gd_err *err)
{
	int rc = GD_OK;

	for (int k = 0; k < m->nlayer && rc == GD_OK; k++) {
		struct merge_layer *l = &m->layer[k];
		const struct gd_named *named = gd_names_find(&m->names, GD_ROLE_MEAN, l->name);
		struct gd_plane p[GD_NAMED_MAX];

		if (!l->place || !l->wanted || !named)
			continue;
		rc = planes_of(m, im, named, p, m->input[i].label, err);
		for (int y = 0; y < m->h && rc == GD_OK; y++)
			for (int x = 0; x < m->w && rc == GD_OK; x++) {
				float *at = gd_row(l->mean[0], y) + x, v = gd_row(p[0], y)[x];

				if (!l->placed)
					*at = v;
				else if (!(*at == v))
					rc = gd_fail(err, GD_EFORMAT, "%s: %s is %g at (%d, %d), "
						     "before it was %g: pairs have to be the same",
						     m->input[i].label, l->name, (double)v, x, y,
						     (double)*at);
			}
		l->placed = true;
	}
	return rc;
}

/*
 * Each unit of the input goes into the bin with the fewest samples so far (in the mean over the
 * image); equal units go round in turn. Bins of an input stay on their side, even or odd: those of
 * a side may hold the same samples.
 */
static void assign_units(struct gd_merge *m, int i, double samples)
{
	const struct merge_input *in = &m->input[i];

	for (int u = 0; u < in->units && m->bins; u++) {
		const int step = in->units > 1 ? 2 : 1;
		int least = m->lockstep ? u : u % step;

		for (int b = least + step; b < m->bins && !m->lockstep; b += step)
			if (m->bin_samples[b] < m->bin_samples[least] * (1 - 1e-9))
				least = b;
		m->bin_samples[least] += samples / in->units;
		m->unit_bin[in->first_unit + u] = least;
	}
}

/* parts += n wherever w > 0. */
static int count_parts(struct gd_merge *m, struct gd_count *parts, const struct gd_count *w, int n,
		       struct gd_err *err)
{
	int rc;

	if (!w->plane.v && !parts->plane.v) {
		parts->all += n;
		return GD_OK;
	}
	rc = gd_count_spread(parts, m->w, m->h, err);
	if (rc != GD_OK)
		return rc;
	for (int y = 0; y < m->h; y++)
		for (int x = 0; x < m->w; x++)
			if (!w->plane.v || gd_row(w->plane, y)[x] > 0)
				gd_row(parts->plane, y)[x] += (float)n;
	return GD_OK;
}

/* One layer of one input: its channels, its bins (n of them, 1: none) and variances. */
struct source {
	const struct merge_input *in;
	int n;
	struct gd_plane mean[GD_NAMED_MAX], var[GD_NAMED_MAX];
	/* bin b, channel c at b * MERGE_COMP + c */
	struct gd_plane part[GD_MAX_BINS * MERGE_COMP];
	enum gd_variance kind;
	float limit;
	bool has_variance;
};

static int find_source(struct gd_merge *m, struct merge_layer *l, const struct gd_image *im,
		       const struct gd_named *named, struct source *s, struct gd_err *err)
{
	const struct gd_named *var = gd_names_find(&m->names, GD_ROLE_VARIANCE, l->name);
	int rc = planes_of(m, im, named, s->mean, s->in->label, err), i;

	s->n = l->binned ? s->in->units : 1;
	for (int b = 0; b < s->n && s->n > 1 && rc == GD_OK; b++)
		rc = planes_of(m, im, gd_merge_bin_of(&m->names, named, b),
			       &s->part[b * MERGE_COMP], s->in->label, err);
	s->has_variance = l->has_variance && !l->spread && var;
	if (rc != GD_OK || !s->has_variance)
		return rc;
	rc = planes_of(m, im, var, s->var, s->in->label, err);
	for (int c = var->n; c < l->n; c++)
		s->var[c] = s->var[0];
	s->kind = m->names.variance;
	i = gd_image_find(im, m->source[var->chan[0]]);
	s->limit = i >= 0 && im->chan[i].type == GD_HALF ? HALF_MAX : 1e30f;
	return rc;
}

/* Means and spread. */
static size_t add_means(struct gd_merge *m, struct merge_layer *l, const struct source *s,
			const struct gd_count *w)
{
	const struct gd_plane none = { 0 };
	size_t bad = 0;

	for (int c = 0; c < l->n; c++) {
		struct gd_plane within = none, m2 = l->has_variance ? l->m2[c] : none;

		if (s->has_variance) {
			within = m->within;
			bad += gd_accum_within_variance(within, s->var[c], s->mean[c], s->kind,
							m->counted, s->limit, w);
		} else if (l->has_variance && s->n > 1) {
			struct gd_plane part[GD_MAX_BINS];

			for (int b = 0; b < s->n; b++)
				part[b] = s->part[b * MERGE_COMP + c];
			within = m->within;
			gd_accum_within_parts(within, part, s->n, w);
		}
		/* the spread of means of unknown counts tells nothing */
		if (s->has_variance && !m->counted) {
			gd_accum_sum(m2, within);
			m2 = within = none;
		}
		gd_accum_add(l->mean[c], m2, s->mean[c], within, w, &l->count);
	}
	return bad;
}

/* Bins first, first + step, ... of the source, each with weight w. */
static int add_units(struct gd_merge *m, struct merge_layer *l, const struct source *s, int first,
		     int step, const struct gd_count *w, struct gd_err *err)
{
	const struct gd_plane none = { 0 };
	int rc = GD_OK;

	for (int u = first; u < s->n && rc == GD_OK; u += step) {
		int b = m->unit_bin[s->in->first_unit + u];
		const struct gd_count *old = l->bin_count ? &l->bin_count[b] : &l->count;

		for (int c = 0; c < l->n; c++)
			gd_accum_add(l->bin[b][c], none,
				     s->n > 1 ? s->part[u * MERGE_COMP + c] : s->mean[c], none, w,
				     old);
		if (l->bin_count)
			rc = gd_count_add(&l->bin_count[b], w, err);
	}
	return rc;
}

/* The bins of the source share its samples evenly. */
static int add_bins(struct gd_merge *m, struct merge_layer *l, const struct source *s,
		    struct gd_count *w, struct gd_err *err)
{
	bool each = l->bin_count && s->n > 1;
	int rc;

	if (each)
		gd_count_scale(w, 1.0 / s->n);
	rc = add_units(m, l, s, 0, 1, w, err);
	if (each)
		gd_count_scale(w, s->n);
	return rc;
}

/* Even bins share the samples of one half, odd ones those of the other. Spoils m->weight. */
static int add_sides(struct gd_merge *m, struct merge_layer *l, const struct source *s,
		     const struct gd_plane *all, int nall, struct gd_err *err)
{
	int rc = GD_OK;

	for (int h = 0; h < 2 && rc == GD_OK; h++) {
		struct gd_count w;

		gd_merge_weigh_side(m, l, h, 1.0f / (float)((s->n + 1 - h) / 2), &w);
		gd_accum_mask(all, nall, &w);
		rc = add_units(m, l, s, h, 2, &w, err);
	}
	return rc;
}

static uint64_t digest(const struct gd_plane *plane, int n)
{
	uint64_t h = 0xcbf29ce484222325U;	/* FNV-1a, of words */
	bool alike = true;

	for (int c = 0; c < n; c++)
		for (int y = 0; y < plane[c].h; y++)
			for (int x = 0; x < plane[c].w; x++) {
				uint32_t bits;

				memcpy(&bits, gd_row(plane[c], y) + x, sizeof bits);
				h = (h ^ bits) * 0x100000001b3U;
				alike = alike && !memcmp(&bits, gd_row(plane[c], 0), sizeof bits);
			}
	return alike ? 0 : h;
}

/* The same render twice, or two with the same seed. */
static void find_twin(struct gd_merge *m, int i, uint64_t colour, const struct gd_report *report)
{
	m->input[i].digest = colour;
	for (int k = 0; k < i && colour; k++)
		if (m->input[k].digest == colour) {
			gd_note(report, "%s: the same colours as %s", m->input[i].label,
				m->input[k].label);
			m->twins++;
			return;
		}
}

static int add_layer(struct gd_merge *m, struct merge_layer *l, const struct gd_image *im,
		     struct source *s, const struct gd_count *count, const struct gd_report *report,
		     struct gd_err *err)
{
	const struct gd_named *named = gd_names_find(&m->names, GD_ROLE_MEAN, l->name);
	struct gd_count w;
	size_t bad, bad_variance;
	bool sides;
	int rc, nall = 0;
	struct gd_plane all[(GD_MAX_BINS + 1) * MERGE_COMP];

	if (!named)
		return GD_OK;
	rc = find_source(m, l, im, named, s, err);
	if (rc != GD_OK)
		return rc;
	for (int c = 0; c < l->n; c++) {
		all[nall++] = s->mean[c];
		for (int b = 0; b < s->n && s->n > 1; b++)
			all[nall++] = s->part[b * MERGE_COMP + c];
	}
	gd_merge_weigh(m, l, count, false, &w);
	bad = gd_accum_bad(all, nall, &w);
	if (bad) {
		gd_merge_weigh(m, l, count, true, &w);
		gd_accum_mask(all, nall, &w);
		l->dropped += bad;
		gd_note(report, "%s: %zu pixels of %s with NaN or Inf left out", s->in->label, bad,
			*l->name ? l->name : "the colour");
	}
	bad_variance = add_means(m, l, s, &w);
	if (bad_variance)
		gd_note(report, "%s: %zu NaN in the variance of %s taken for 0", s->in->label,
			bad_variance, *l->name ? l->name : "the colour");
	sides = l->binned && m->bins && s->n > 1 && m->side[0].v;
	if (l->binned && m->bins && !sides)
		rc = add_bins(m, l, s, &w, err);
	if (rc == GD_OK && l->has_variance && l->spread)
		rc = count_parts(m, &l->parts, &w, s->n, err);
	if (rc == GD_OK)
		rc = gd_count_add(&l->count, &w, err);
	return rc == GD_OK && sides ? add_sides(m, l, s, all, nall, err) : rc;
}

int gd_merge_add(struct gd_merge *m, int i, struct gd_image *im, const struct gd_report *report,
		 struct gd_err *err)
{
	struct source *s = calloc(1, sizeof *s);
	struct gd_count count;
	int rc = s ? GD_OK : gd_fail(err, GD_ENOMEM, "out of memory");

	if (rc == GD_OK && (im->w != m->w || im->h != m->h))
		rc = gd_fail(err, GD_ESHAPE, "%s: has changed while it was read",
			     m->input[i].label);
	if (rc == GD_OK)
		rc = m->out.nchan ? join_attributes(m, im, err) : start_output(m, im, err);
	if (rc == GD_OK)
		rc = input_count(m, i, im, &count, err);
	if (rc == GD_OK)
		rc = side_counts(m, i, im, err);
	if (rc == GD_OK)
		rc = edge_counts(m, i, im, err);
	if (rc == GD_OK)
		rc = join_places(m, i, im, err);
	if (rc == GD_OK)
		assign_units(m, i, count.all);
	for (int k = 0; k < m->nlayer && rc == GD_OK; k++) {
		*s = (struct source){ .in = &m->input[i] };
		if (m->layer[k].wanted && !m->layer[k].place)
			rc = add_layer(m, &m->layer[k], im, s, &count, report, err);
		if (rc == GD_OK && !*m->layer[k].name)
			find_twin(m, i, digest(s->mean, m->layer[k].n), report);
	}
	free(s);
	return rc;
}
