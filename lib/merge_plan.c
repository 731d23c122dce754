/* SPDX-License-Identifier: BSD-3-Clause */
#include "merge.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "merge_state.h"

static bool starts(const char *s, const char *with)
{
	return !strncmp(s, with, strlen(with));
}

bool gd_merge_in_family(const char *name, const char *prefix)
{
	size_t n = strlen(prefix);

	if (!starts(name, prefix) || !strchr("0123456789", name[n]) || !name[n])
		return false;
	n += strspn(name + n, "0123456789");
	return !name[n] || name[n] == '.';
}

bool gd_merge_is_side(const char *name)
{
	return !strcmp(name, "half0.samples") || !strcmp(name, "half1.samples");
}

/* Layers whose noise a denoiser models. */
static bool is_feature(const char *name)
{
	static const char *const list[] = { "", "albedo", "N", "Z", "P", "ao", "feature" };

	if (gd_merge_edge_of(name) >= 0)
		return true;
	if (gd_merge_in_family(name, "half"))
		name = strchr(name, '.') ? strchr(name, '.') + 1 : "";
	for (size_t i = 0; i < sizeof list / sizeof *list; i++)
		if (!strcmp(name, list[i]))
			return true;
	return false;
}

/* "pair0.x", "pair3.y": where pairs lead. */
static bool is_place(const char *name)
{
	return !strncmp(name, "pair", 4) && name[4] >= '0' && name[4] < '0' + MERGE_EDGES - 2 &&
	       (!strcmp(name + 5, ".x") || !strcmp(name + 5, ".y"));
}

/* What a denoiser said about one input is not true of the merged image. */
static bool is_stale(const char *name)
{
	static const char *const list[] = { "error", "model", "sampling" };

	for (size_t i = 0; i < sizeof list / sizeof *list; i++)
		if (starts(name, list[i]) &&
		    (!name[strlen(list[i])] || name[strlen(list[i])] == '.'))
			return true;
	return false;
}

/* ---- survey ---- */

struct merge_layer *gd_merge_layer(struct gd_merge *m, const char *name)
{
	for (int k = 0; k < m->nlayer; k++)
		if (!strcmp(m->layer[k].name, name))
			return &m->layer[k];
	return NULL;
}

static int survey_layer(struct gd_merge *m, const struct gd_named *found, const char *label,
			bool has_variance, struct gd_err *err)
{
	struct merge_layer *l = gd_merge_layer(m, found->layer);

	if (!l) {
		l = realloc(m->layer, (size_t)(m->nlayer + 1) * sizeof *l);
		if (!l)
			return gd_fail(err, GD_ENOMEM, "out of memory");
		m->layer = l;
		l += m->nlayer++;
		*l = (struct merge_layer){ .n = found->n, .wanted = true };
		memcpy(l->name, found->layer, sizeof l->name);
		for (int c = 0; c < found->n; c++)
			memcpy(l->out[c], found->name[c], sizeof l->out[c]);
		l->half = gd_merge_in_family(l->name, "half");
		l->edge = gd_merge_edge_of(l->name);
		l->binned = !*l->name || (l->edge >= 0 && !l->half);
		l->place = is_place(l->name);
	}
	if (l->n != found->n)
		return gd_fail(err, GD_ESHAPE, "%s: %s has %d channels, in other inputs %d", label,
			       *l->name ? l->name : "the colour", found->n, l->n);
	l->carriers++;
	l->with_variance += has_variance;
	return GD_OK;
}

/* The layer of bin b, e.g. "bin3.dx". */
const struct gd_named *gd_merge_bin_of(const struct gd_names *names, const struct gd_named *layer,
				       int b)
{
	char name[300];
	const struct gd_named *bin;

	snprintf(name, sizeof name, "bin%d%s%s", b, *layer->layer ? "." : "", layer->layer);
	bin = gd_names_find(names, GD_ROLE_MEAN, name);
	return bin && bin->n == layer->n ? bin : NULL;
}

/* Bins that every binned layer of the file has; 1 if it holds none. */
static int count_bins(const struct gd_names *names)
{
	static const char *const binned[] = { "", "dx", "dy", "pair0", "pair1", "pair2", "pair3" };
	int bins = GD_MAX_BINS;

	for (size_t k = 0; k < sizeof binned / sizeof *binned; k++) {
		const struct gd_named *layer = gd_names_find(names, GD_ROLE_MEAN, binned[k]);
		int b = 0;

		while (layer && b < bins && gd_merge_bin_of(names, layer, b))
			b++;
		if (layer)
			bins = b;
	}
	return bins > 1 ? bins : 1;
}

static int survey_layers(struct gd_merge *m, const struct gd_names *names, const char *label,
			 struct gd_err *err)
{
	const struct gd_named *colour = gd_names_find(names, GD_ROLE_MEAN, "");
	int rc = GD_OK;

	if (!colour)
		return gd_fail(err, GD_ESHAPE,
			       "%s: no colour, neither R G B nor another name that is known",
			       label);
	if (colour->n != 3)
		return gd_fail(err, GD_ESHAPE, "%s: the colour has %d channels, wanted are 3",
			       label, colour->n);
	for (int k = 0; k < names->n && rc == GD_OK; k++) {
		const struct gd_named *l = &names->layer[k], *var;

		if (l->role != GD_ROLE_MEAN || gd_merge_in_family(l->layer, "bin") ||
		    gd_merge_is_side(l->layer) || gd_merge_is_worth(l->layer))
			continue;
		var = names->variance == GD_VARIANCE_NONE ? NULL :
			gd_names_find(names, GD_ROLE_VARIANCE, l->layer);
		var = var && (var->n == l->n || var->n == 1) ? var : NULL;
		if (var && names->variance != GD_VARIANCE_MEAN)
			m->wants_counts = m->input[m->ninput].label;
		rc = survey_layer(m, l, label, var != NULL, err);
	}
	return rc;
}

static int survey_input(struct gd_merge *m, const struct gd_image *im, const char *label,
			double spp, struct gd_err *err)
{
	struct merge_input *in = realloc(m->input, (size_t)(m->ninput + 1) * sizeof *in);
	struct gd_names names = { 0 };
	struct gd_err why = { 0 };
	int rc;

	if (!in)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	m->input = in;
	in += m->ninput;
	*in = (struct merge_input){ .label = strdup(label), .spp = spp };
	if (!in->label)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	rc = gd_names_resolve(&names, im, &m->conf.names, &why);
	if (rc == GD_ESHAPE)
		gd_fail(err, rc, "%s: %s", label, why.text);
	else if (rc != GD_OK)
		gd_fail(err, rc, "%s", why.text);
	if (rc == GD_OK)
		rc = survey_layers(m, &names, label, err);
	if (rc == GD_OK) {
		in->per_pixel = !(spp > 0) && gd_names_find(&names, GD_ROLE_SAMPLES, "samples");
		in->sided = in->per_pixel &&
			    gd_names_find(&names, GD_ROLE_MEAN, "half0.samples") &&
			    gd_names_find(&names, GD_ROLE_MEAN, "half1.samples");
		m->sided = m->sided || in->sided;
		in->units = count_bins(&names);
		if (!(spp > 0) && !gd_names_spp(im, &in->spp))
			in->spp = 0;
	}
	gd_names_free(&names);
	m->ninput++;	/* owns the label, whatever happened */
	return rc;
}

int gd_merge_survey(struct gd_merge *m, const struct gd_image *im, const char *label, double spp,
		    struct gd_err *err)
{
	if (!m->ninput) {
		m->w = im->w;
		m->h = im->h;
		m->x0 = im->data.x0;
		m->y0 = im->data.y0;
	}
	if (im->w != m->w || im->h != m->h)
		return gd_fail(err, GD_ESHAPE, "%s: %d x %d pixels, expected %d x %d as in %s",
			       label, im->w, im->h, m->w, m->h, m->input[0].label);
	if (im->data.x0 != m->x0 || im->data.y0 != m->y0)
		return gd_fail(err, GD_ESHAPE,
			       "%s: data window at (%d, %d), expected (%d, %d) as in %s", label,
			       im->data.x0, im->data.y0, m->x0, m->y0, m->input[0].label);
	return survey_input(m, im, label, spp, err);
}

/* ---- plan ---- */

static int plan_counts(struct gd_merge *m, const struct gd_report *report, struct gd_err *err)
{
	int known = 0, unknown = -1;

	for (int i = 0; i < m->ninput; i++) {
		if (m->input[i].spp > 0 || m->input[i].per_pixel)
			known++;
		else
			unknown = i;
	}
	m->counted = unknown < 0;
	if (unknown >= 0 && known)
		return gd_fail(err, GD_EARG,
			       "%s: no sample count, which other inputs have; give it by --spp",
			       m->input[unknown].label);
	if (!m->counted && m->wants_counts)
		return gd_fail(
			err, GD_EARG,
			"%s: its variances are of single samples; give their number by --spp",
			m->wants_counts);
	if (!m->counted && m->ninput > 1)
		gd_note(report, "no sample counts: all inputs weigh the same");
	return GD_OK;
}

static int plan_bins(struct gd_merge *m, struct gd_err *err)
{
	int units = 0, most = 1, least = GD_MAX_BINS, best;

	for (int i = 0; i < m->ninput; i++) {
		int u = m->input[i].units;

		m->input[i].first_unit = units;
		units += u;
		most = u > most ? u : most;
		least = u < least ? u : least;
	}
	best = most > 1 ? most : m->ninput <= 16 ? m->ninput : 8;
	if (m->conf.bins > units || m->conf.bins > GD_MAX_BINS)
		return gd_fail(err, GD_EARG, "%d bins cannot be made of %d independent part%s",
			       m->conf.bins, units, units == 1 ? "" : "s");
	m->bins = m->conf.bins > 0 ? m->conf.bins : m->conf.bins < 0 || m->conf.halves ? best : 0;
	m->bins = m->bins > 1 ? m->bins : 0;
	m->keep_bins = m->conf.bins != 0;
	m->lockstep = m->bins && most == least && most == m->bins;
	if (m->conf.halves && !m->bins)
		return gd_fail(err, GD_EARG, "%s: halves need two inputs, or bins",
			       m->input[0].label);
	m->unit_bin = calloc((size_t)units + 1, sizeof *m->unit_bin);
	return m->unit_bin ? GD_OK : gd_fail(err, GD_ENOMEM, "out of memory");
}

/* Halves of the inputs stay halves only if every input has them and no part changes sides. */
static void plan_halves(struct gd_merge *m, const struct gd_report *report)
{
	bool keep = !m->conf.halves && (!m->bins || (m->lockstep && m->bins % 2 == 0)), any = false;

	for (int k = 0; k < m->nlayer; k++)
		if (m->layer[k].half) {
			any = true;
			keep = keep && m->layer[k].carriers == m->ninput;
		}
	for (int k = 0; any && !keep && k < m->nlayer; k++)
		if (m->layer[k].half)
			m->layer[k].wanted = false;
	m->make_halves = m->bins && (m->conf.halves || (any && !keep));
	if (any && !keep)
		gd_note(report, "the inputs' halves are %s",
			m->make_halves ? "made anew from the bins" : "dropped");
}

static void plan_layer(struct gd_merge *m, struct merge_layer *l, const struct gd_report *report)
{
	bool parts = l->carriers > 1;
	const char *name = *l->name ? l->name : "colour";

	for (int i = 0; i < m->ninput && l->binned; i++)
		parts = parts || m->input[i].units > 1;
	l->spread = l->with_variance < l->carriers;
	l->has_variance = (is_feature(l->name) || l->with_variance) && (!l->spread || parts);
	if (l->spread && l->with_variance)
		gd_note(report, "%s: %d of %d inputs have its variance; taken from the spread %s",
			name, l->with_variance, l->carriers, parts ? "instead" : "nowhere");
	if (l->carriers < m->ninput)
		gd_note(report, "%s: in %d of %d inputs only", name, l->carriers, m->ninput);
	if (m->ninput > 1 && is_stale(l->name)) {
		l->wanted = false;
		gd_note(report, "%s: dropped, it is not true of the merged image", name);
	}
}

int gd_merge_plan(struct gd_merge *m, const struct gd_report *report, struct gd_err *err)
{
	int rc;

	if (!m->ninput)
		return gd_fail(err, GD_EARG, "nothing to merge");
	rc = plan_counts(m, report, err);
	if (rc == GD_OK)
		rc = plan_bins(m, err);
	if (rc != GD_OK)
		return rc;
	plan_halves(m, report);
	for (int k = 0; k < m->nlayer; k++)
		plan_layer(m, &m->layer[k], report);
	if (m->bins)
		gd_note(report, "%d bins, %s", m->bins,
			m->lockstep ? "merged one by one"
			: m->bins == m->ninput &&
					m->input[m->ninput - 1].first_unit == m->ninput - 1
				? "one for each input"
				: "each of several parts");
	return GD_OK;
}
