/* SPDX-License-Identifier: BSD-3-Clause */
#include "names.h"

#include <fnmatch.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

/* ---- the renderers ---- */

/* A layer of a gd buffer (its variance if the name ends so) and what a renderer calls it. */
struct rule {
	enum gd_preset preset;
	const char *layer, *base;
};

/*
 * Of several rules for one layer the first that finds its channels holds. A base stands for
 * base.R .G .B, base.X .Y .Z and the like, or for a single channel. An asterisk in front stands
 * for the name of Blender's view layer.
 */
static const struct rule rules[] = {
	{ GD_NAMES_PBRT, "variance", "Variance" },
	{ GD_NAMES_PBRT, "albedo", "Albedo" },
	{ GD_NAMES_PBRT, "N", "Ns" },
	{ GD_NAMES_PBRT, "Ng", "N" },
	{ GD_NAMES_PBRT, "P", "P" },
	{ GD_NAMES_PBRT, "drop", "RelativeVariance" },
	{ GD_NAMES_CYCLES, "", "*Noisy Image" },
	{ GD_NAMES_CYCLES, "", "*Combined" },
	{ GD_NAMES_CYCLES, "A", "*Combined.A" },
	{ GD_NAMES_CYCLES, "variance", "*Denoising Variance" },
	{ GD_NAMES_CYCLES, "albedo", "*Denoising Albedo" },
	{ GD_NAMES_CYCLES, "albedo", "*DiffCol" },
	{ GD_NAMES_CYCLES, "albedo.variance", "*Denoising Albedo Variance" },
	{ GD_NAMES_CYCLES, "N", "*Denoising Normal" },
	{ GD_NAMES_CYCLES, "N", "*Normal" },
	{ GD_NAMES_CYCLES, "N.variance", "*Denoising Normal Variance" },
	{ GD_NAMES_CYCLES, "Z", "*Denoising Depth" },
	{ GD_NAMES_CYCLES, "Z", "*Depth" },
	{ GD_NAMES_CYCLES, "Z.variance", "*Denoising Depth Variance" },
	{ GD_NAMES_CYCLES, "P", "*Position" },
	{ GD_NAMES_CYCLES, "ao", "*AO" },
	{ GD_NAMES_CYCLES, "samples", "*Debug Sample Count" },
	{ GD_NAMES_TUNGSTEN, "", "color" },
	{ GD_NAMES_TUNGSTEN, "variance", "colorVariance" },
	{ GD_NAMES_TUNGSTEN, "half0", "colorA" },
	{ GD_NAMES_TUNGSTEN, "half1", "colorB" },
	{ GD_NAMES_TUNGSTEN, "albedo", "albedo" },
	{ GD_NAMES_TUNGSTEN, "albedo.variance", "albedoVariance" },
	{ GD_NAMES_TUNGSTEN, "half0.albedo", "albedoA" },
	{ GD_NAMES_TUNGSTEN, "half1.albedo", "albedoB" },
	{ GD_NAMES_TUNGSTEN, "N", "normal" },
	{ GD_NAMES_TUNGSTEN, "N.variance", "normalVariance" },
	{ GD_NAMES_TUNGSTEN, "half0.N", "normalA" },
	{ GD_NAMES_TUNGSTEN, "half1.N", "normalB" },
	{ GD_NAMES_TUNGSTEN, "Z", "depth" },
	{ GD_NAMES_TUNGSTEN, "Z.variance", "depthVariance" },
	{ GD_NAMES_TUNGSTEN, "half0.Z", "depthA" },
	{ GD_NAMES_TUNGSTEN, "half1.Z", "depthB" },
	{ GD_NAMES_ARNOLD, "", "RGBA" },
	{ GD_NAMES_ARNOLD, "A", "RGBA.A" },
	{ GD_NAMES_ARNOLD, "variance", "variance" },
	{ GD_NAMES_ARNOLD, "albedo", "denoise_albedo" },
	{ GD_NAMES_ARNOLD, "albedo", "diffuse_albedo" },
	{ GD_NAMES_ARNOLD, "N", "N_denoise" },
	{ GD_NAMES_ARNOLD, "N", "N_noice" },
	{ GD_NAMES_ARNOLD, "N", "N" },
	{ GD_NAMES_ARNOLD, "Z", "Z_noice" },
	{ GD_NAMES_ARNOLD, "P", "P" },
	{ GD_NAMES_RENDERMAN, "", "Ci" },
	{ GD_NAMES_RENDERMAN, "A", "Ci.a" },
	{ GD_NAMES_RENDERMAN, "variance", "mse" },
	{ GD_NAMES_RENDERMAN, "albedo", "albedo" },
	{ GD_NAMES_RENDERMAN, "albedo.variance", "albedo_mse" },
	{ GD_NAMES_RENDERMAN, "albedo.variance", "albedo_var" },
	{ GD_NAMES_RENDERMAN, "N", "normal" },
	{ GD_NAMES_RENDERMAN, "N", "Nn" },
	{ GD_NAMES_RENDERMAN, "N.variance", "normal_mse" },
	{ GD_NAMES_RENDERMAN, "N.variance", "normal_var" },
	{ GD_NAMES_RENDERMAN, "Z", "zfiltered" },
	{ GD_NAMES_RENDERMAN, "Z", "z" },
	{ GD_NAMES_RENDERMAN, "Z.variance", "zfiltered_mse" },
	{ GD_NAMES_RENDERMAN, "Z.variance", "zfiltered_var" },
	{ GD_NAMES_RENDERMAN, "samples", "sampleCount" },
	/* for every file whose own names leave them open */
	{ GD_NAMES_AUTO, "", "Y" },
	{ GD_NAMES_AUTO, "albedo", "Albedo" },
	{ GD_NAMES_AUTO, "N", "Normal" },
	{ GD_NAMES_AUTO, "N", "normal" },
	{ GD_NAMES_AUTO, "Z", "Depth" },
	{ GD_NAMES_AUTO, "Z", "depth" },
	{ GD_NAMES_AUTO, "P", "Position" },
	{ GD_NAMES_AUTO, "P", "position" },
};

static bool starts(const char *s, const char *with)
{
	return !strncmp(s, with, strlen(with));
}

static bool ends(const char *s, const char *with)
{
	size_t n = strlen(s), k = strlen(with);

	return n >= k && !strcmp(s + n - k, with);
}

static enum gd_preset recognise(const struct gd_image *im)
{
	static const struct { enum gd_preset preset; const char *pattern; } marks[] = {
		{ GD_NAMES_CYCLES, "*Combined.R" }, { GD_NAMES_CYCLES, "*Noisy Image.R" },
		{ GD_NAMES_CYCLES, "*Denoising *" },
		{ GD_NAMES_GD, "bin0.*" }, { GD_NAMES_GD, "dx.[Rr]" },
		{ GD_NAMES_PBRT, "Variance.R" }, { GD_NAMES_PBRT, "RelativeVariance.R" },
		{ GD_NAMES_PBRT, "Ns.X" }, { GD_NAMES_PBRT, "Nsx" },
		{ GD_NAMES_MITSUBA, "m2_*" }, { GD_NAMES_MITSUBA, "?*.T" },
		{ GD_NAMES_RENDERMAN, "Ci.[rR]" }, { GD_NAMES_RENDERMAN, "mse.[rR]" },
		{ GD_NAMES_RENDERMAN, "sampleCount*" }, { GD_NAMES_RENDERMAN, "zfiltered*" },
		{ GD_NAMES_TUNGSTEN, "colorVariance*" }, { GD_NAMES_TUNGSTEN, "color.R" },
		{ GD_NAMES_ARNOLD, "denoise_albedo*" }, { GD_NAMES_ARNOLD, "diffuse_albedo*" },
		{ GD_NAMES_ARNOLD, "*_noice.*" }, { GD_NAMES_ARNOLD, "*_denoise.*" },
	};

	for (size_t k = 0; k < sizeof marks / sizeof *marks; k++)
		for (int i = 0; i < im->nchan; i++)
			if (!fnmatch(marks[k].pattern, im->chan[i].name, 0))
				return marks[k].preset;
	for (int i = 0; i < im->nattr; i++)
		if (starts(im->attr[i].name, "arnold/"))
			return GD_NAMES_ARNOLD;
	return GD_NAMES_GD;
}

static enum gd_variance usual_variance(enum gd_preset preset)
{
	return preset == GD_NAMES_PBRT ? GD_VARIANCE_SAMPLE :
	       preset == GD_NAMES_MITSUBA ? GD_VARIANCE_M2 : GD_VARIANCE_MEAN;
}

/* ---- finding channels ---- */

/* The channels of base, n = 0 if there are none: a triple of components, or a single channel. */
struct found {
	int n;
	int chan[3];
};

static int channel(const struct gd_image *im, const bool *taken, const char *a, const char *b,
		   const char *c)
{
	char name[512];
	int i;

	if (snprintf(name, sizeof name, "%s%s%s", a, b, c) >= (int)sizeof name)
		return -1;
	i = gd_image_find(im, name);
	return i >= 0 && !taken[i] && im->chan[i].type != GD_UINT ? i : -1;
}

static struct found find_base(const struct gd_image *im, const bool *taken, const char *prefix,
			      const char *base)
{
	static const char *const triples[][3] = {
		{ ".R", ".G", ".B" }, { ".r", ".g", ".b" },
		{ ".X", ".Y", ".Z" }, { ".x", ".y", ".z" }, { "x", "y", "z" },
	};
	static const char *const singles[] = { "", ".Z", ".X", ".V", ".A", ".R", ".T", ".Y",
					       ".r", ".z", ".y" };
	struct found f;

	for (size_t t = 0; t < sizeof triples / sizeof *triples; t++) {
		int skip = !*base && t < 2;	/* the colour has no layer: R, not .R */

		if (!*base && t >= 2)
			return (struct found){ 0 };
		for (f.n = 0; f.n < 3; f.n++) {
			f.chan[f.n] = channel(im, taken, prefix, base, triples[t][f.n] + skip);
			if (f.chan[f.n] < 0)
				break;
		}
		if (f.n == 3)
			return f;
	}
	f.n = 1;
	for (size_t s = 0; s < sizeof singles / sizeof *singles; s++)
		if ((f.chan[0] = channel(im, taken, prefix, base, singles[s])) >= 0)
			return f;
	return (struct found){ 0 };
}

/* ---- building the list ---- */

struct builder {
	struct gd_names *names;
	const struct gd_image *im;
	bool *taken;		/* channels that have a layer */
	struct gd_err *err;
};

/* Is it "variance" or "<layer>.variance"? Then layer is cut to what it belongs to. */
static bool cut_variance(char layer[256])
{
	if (!strcmp(layer, "variance")) {
		layer[0] = 0;
		return true;
	}
	if (!ends(layer, ".variance"))
		return false;
	layer[strlen(layer) - strlen(".variance")] = 0;
	return true;
}

static bool has_layer(const struct builder *b, enum gd_role role, const char *layer)
{
	return gd_names_find(b->names, role, layer) != NULL;
}

/* "N" in "N", "half0.N": vectors have X Y Z. */
static bool is_vector(const char *layer)
{
	const char *dot = strrchr(layer, '.'), *last = dot ? dot + 1 : layer;

	return !strcmp(last, "N") || !strcmp(last, "P") || !strcmp(last, "Ng");
}

/* The name of component i of n in the gd buffer. */
static void buffer_name(char name[256], const char *layer, enum gd_role role, int i, int n)
{
	static const char *const rgb[] = { "R", "G", "B" }, *const xyz[] = { "X", "Y", "Z" };
	const char *c = n == 1 ? "" : is_vector(layer) ? xyz[i] : rgb[i];
	char stem[256] = "";

	if (role == GD_ROLE_VARIANCE)
		snprintf(stem, sizeof stem, "%.200s%s%s", layer, *layer ? "." : "", "variance");
	else
		snprintf(stem, sizeof stem, "%s", layer);
	snprintf(name, 256, "%.250s%s%s", stem, *stem && *c ? "." : "", c);
}

static struct gd_named *append(struct builder *b)
{
	struct gd_names *names = b->names;
	struct gd_named *list = realloc(names->layer, (size_t)(names->n + 1) * sizeof *list);

	if (!list) {
		gd_fail(b->err, GD_ENOMEM, "out of memory");
		return NULL;
	}
	names->layer = list;
	memset(&list[names->n], 0, sizeof *list);
	return &list[names->n++];
}

/*
 * Gives the channels found to a layer of the gd buffer; a colour, or a variance of one, has three.
 */
static int add(struct builder *b, const char *target, struct found f)
{
	struct gd_named *l = append(b);
	bool colour, same = true;

	if (!l)
		return GD_ENOMEM;
	snprintf(l->layer, sizeof l->layer, "%s", target);
	l->role = cut_variance(l->layer) ? GD_ROLE_VARIANCE :
		  !strcmp(target, "samples") ? GD_ROLE_SAMPLES :
		  !strcmp(target, "drop") ? GD_ROLE_DROP : GD_ROLE_MEAN;
	colour = !*l->layer || !strcmp(l->layer, "half0") || !strcmp(l->layer, "half1");
	l->n = colour && f.n == 1 ? 3 : f.n;
	for (int i = 0; i < l->n; i++) {
		l->chan[i] = f.chan[f.n == 1 ? 0 : i];
		buffer_name(l->name[i], l->layer, l->role, i, l->n);
		b->taken[l->chan[i]] = true;
		same = same && !strcmp(l->name[i], b->im->chan[l->chan[i]].name);
	}
	l->renamed = !same;
	return GD_OK;
}

static int apply_rules(struct builder *b, enum gd_preset preset, const char *prefix)
{
	int rc = GD_OK;

	for (size_t r = 0; r < sizeof rules / sizeof *rules && rc == GD_OK; r++) {
		bool star = rules[r].base[0] == '*';
		char layer[256];
		enum gd_role role;
		struct found f;

		if (rules[r].preset != preset)
			continue;
		snprintf(layer, sizeof layer, "%s", rules[r].layer);
		role = cut_variance(layer) ? GD_ROLE_VARIANCE :
		       !strcmp(layer, "samples") ? GD_ROLE_SAMPLES : GD_ROLE_MEAN;
		if (has_layer(b, role, role == GD_ROLE_SAMPLES ? "samples" : layer))
			continue;
		if (!strcmp(layer, "Ng") && !has_layer(b, GD_ROLE_MEAN, "N"))
			continue;	/* no shading normal: the geometric one is the normal */
		f = find_base(b->im, b->taken, star ? prefix : "", rules[r].base + star);
		if (f.n)
			rc = add(b, rules[r].layer, f);
	}
	return rc;
}

/* Blender: "<view layer>." of the first view layer with a combined image. */
static void view_layer(const struct gd_image *im, char prefix[256])
{
	static const char *const marks[] = { ".Noisy Image.R", ".Combined.R" };

	prefix[0] = 0;
	for (int k = 0; k < 2; k++)
		for (int i = 0; i < im->nchan; i++) {
			const char *name = im->chan[i].name;

			if (ends(name, marks[k])) {
				snprintf(prefix, 256, "%.*s",
					 (int)(strlen(name) - strlen(marks[k]) + 1), name);
				return;
			}
		}
}

/* ---- Mitsuba: the user picks the layers' names, so their words and suffixes must do ---- */

static bool has_word(const char *name, const char *const *words)
{
	for (; *words; words++)
		if (strcasestr(name, *words))
			return true;
	return false;
}

static const char *mitsuba_layer(const char *base, const char *suffix)
{
	static const char *const normal[] = { "norm", "nn", "sn", NULL };
	static const char *const place[] = { "pos", "point", NULL };
	static const char *const albedo[] = { "alb", "reflectance", NULL };

	if (!strcmp(suffix, ".T"))
		return "Z";
	if (!strcmp(suffix, ".X"))
		return has_word(base, normal) || !strcasecmp(base, "n") ? "N" :
		       has_word(base, place) || !strcasecmp(base, "p") ? "P" : NULL;
	if (!strcmp(suffix, ".R"))
		return has_word(base, albedo) ? "albedo" : "";
	return NULL;
}

static int apply_mitsuba(struct builder *b)
{
	int rc = GD_OK;
	struct found f = find_base(b->im, b->taken, "", "");

	if (f.n && !has_layer(b, GD_ROLE_MEAN, ""))
		rc = add(b, "", f);
	for (int i = 0; i < b->im->nchan && rc == GD_OK; i++) {
		const char *name = b->im->chan[i].name, *dot = strrchr(name, '.'), *layer;
		char base[256];

		if (!dot || b->taken[i] || starts(name, "m2_"))
			continue;
		snprintf(base, sizeof base, "%.*s", (int)(dot - name), name);
		layer = mitsuba_layer(base, dot);
		if (!layer || has_layer(b, GD_ROLE_MEAN, layer))
			continue;
		f = find_base(b->im, b->taken, "", base);
		if (f.n)
			rc = add(b, layer, f);
	}
	return rc;
}

/* Second moments are named after the channel they belong to. */
static int add_moments(struct builder *b)
{
	int rc = GD_OK, n = b->names->n;

	for (int k = 0; k < n && rc == GD_OK; k++) {
		struct gd_named l = b->names->layer[k];
		char target[300];
		struct found f = { l.n == 3 ? 3 : 1, { 0 } };
		int i;

		if (l.role != GD_ROLE_MEAN || l.n > 3 || has_layer(b, GD_ROLE_VARIANCE, l.layer))
			continue;
		for (i = 0; i < f.n; i++)
			if ((f.chan[i] = channel(b->im, b->taken, "m2_",
						 b->im->chan[l.chan[i]].name, "")) < 0)
				break;
		snprintf(target, sizeof target, "%s%svariance", l.layer, *l.layer ? "." : "");
		if (i == f.n)
			rc = add(b, target, f);
	}
	return rc;
}

/* ---- --map ---- */

/* Copies up to an unescaped end character (or the end) and returns what follows it, or NULL. */
static const char *word(char *dst, size_t size, const char *s, const char *stop, char *end)
{
	size_t n = 0;

	while (*s && !strchr(stop, *s)) {
		if (*s == '\\' && s[1])
			s++;
		if (n + 1 < size)
			dst[n++] = *s;
		s++;
	}
	dst[n] = 0;
	*end = *s;
	return *s ? s + 1 : s;
}

/* "pre{a,b,c}post" or "a,b,c" or "a" into full names; the number of names, 0 for nonsense. */
static int expand(const char *spec, char name[3][256])
{
	char pre[256], post[256], part[3][256], end;
	int n = 0;

	spec = word(pre, sizeof pre, spec, "{,", &end);
	if (end != '{') {
		snprintf(name[n++], 256, "%s", pre);
		while (end == ',' && n < 4) {
			spec = word(pre, sizeof pre, spec, ",", &end);
			if (n < 3)
				snprintf(name[n], 256, "%s", pre);
			n++;
		}
		return (n == 1 || n == 3) && *name[0] ? n : 0;
	}
	do {
		spec = word(post, sizeof post, spec, ",}", &end);
		if (n < 3)
			snprintf(part[n], 256, "%s", post);
		n++;
	} while (end == ',' && n < 4);
	if (end != '}' || (n != 1 && n != 3))
		return 0;
	word(post, sizeof post, spec, "", &end);
	for (int i = 0; i < n; i++)
		if (snprintf(name[i], 256, "%s%s%s", pre, part[i], post) >= 256)
			return 0;
	return n;
}

static int apply_map(struct builder *b, const char *map)
{
	char target[256], name[3][256], end;
	const char *spec = word(target, sizeof target, map, "=", &end);
	struct found f = { 0 };

	if (end != '=' || (f.n = expand(spec, name)) == 0)
		return gd_fail(b->err, GD_EARG,
			       "--map '%s': wanted is LAYER=CHANNEL or LAYER=NAME.{R,G,B}", map);
	if (!strcmp(target, "color") || !strcmp(target, "colour"))
		target[0] = 0;
	for (int i = 0; i < f.n; i++) {
		f.chan[i] = channel(b->im, b->taken, name[i], "", "");
		if (f.chan[i] < 0 && f.n > 1)
			return gd_fail(b->err, GD_ESHAPE, "no channel %s (--map %s)", name[i], map);
	}
	if (f.chan[0] < 0)
		f = find_base(b->im, b->taken, "", name[0]);
	if (!f.n)
		return gd_fail(b->err, GD_ESHAPE, "no channel %s (--map %s)", name[0], map);
	return add(b, target, f);
}

/* ---- what is left keeps its name ---- */

/* Identifiers cannot be averaged. Cryptomatte's layers are also listed in attributes. */
static bool is_identifier(const struct gd_image *im, const struct gd_names_conf *conf,
			  const char *name)
{
	static const char *const patterns[] = {
		"*crypto*", "*[._]id", "id", "id.*", "*objectid*", "*materialid*", "*primid*",
		"*instanceid*", "*indexob*", "*indexma*", "*shape_index*", "*prim_index*",
	};

	for (int i = 0; i < conf->npass; i++)
		if (!fnmatch(conf->pass[i], name, 0))
			return true;
	for (size_t i = 0; i < sizeof patterns / sizeof *patterns; i++)
		if (!fnmatch(patterns[i], name, FNM_CASEFOLD))
			return true;
	for (int i = 0; i < im->nattr; i++) {
		const struct gd_attr *a = &im->attr[i];

		if (starts(a->name, "cryptomatte/") && ends(a->name, "/name") &&
		    !strcmp(a->type, "string") && a->size &&
		    !strncmp(name, (const char *)a->data, a->size))
			return true;
	}
	return false;
}

/* "half0", "bin12": what stands before the layers of a half or a bin. */
static bool is_family(const char *base)
{
	size_t n = starts(base, "half") ? 4 : starts(base, "bin") ? 3 : 0;

	return n && base[n] && !base[n + strspn(base + n, "0123456789")];
}

/* "pair0": its x and y tell where the pair's other pixel is. */
static bool is_pair(const char *base)
{
	return starts(base, "pair") && base[4] && !base[4 + strspn(base + 4, "0123456789")];
}

/*
 * Splits "base.c" where c is one letter of a colour or a vector; else base is the whole name. Alpha
 * is a quantity of its own, and so are the depths Z and half0.Z, and pair0.x.
 */
static const char *split(const char *name, char base[256])
{
	const char *dot = strrchr(name, '.');

	snprintf(base, 256, "%s", name);
	if (!dot)
		return strlen(name) == 1 && strchr("RGB", *name) ? base[0] = 0, name : "";
	if (!dot[1] || dot[2] || strchr("Aa", dot[1]))
		return "";
	base[dot - name] = 0;
	if ((dot[1] == 'Z' && is_family(base)) || (strchr("xy", dot[1]) && is_pair(base))) {
		base[dot - name] = '.';
		return "";
	}
	return dot + 1;
}

/* Has another layer got this name already (a preset or a map put something else there)? */
static bool name_used(const struct gd_names *names, const char *name)
{
	for (int k = 0; k < names->n; k++)
		for (int i = 0; i < names->layer[k].n; i++)
			if (names->layer[k].role != GD_ROLE_DROP &&
			    !strcmp(names->layer[k].name[i], name))
				return true;
	return false;
}

/* Red before green before blue; channels come sorted by name. */
static int component_order(const char *c)
{
	const char *order = "RGBrgbXYZWxyzwUVuv", *p = *c ? strchr(order, *c) : NULL;

	return p ? (int)(p - order) : 99;
}

static void insert_sorted(struct gd_named *l, int chan, const char *name, const char *c)
{
	char base[256];
	int at = l->n;

	while (at > 0 && component_order(split(l->name[at - 1], base)) > component_order(c)) {
		l->chan[at] = l->chan[at - 1];
		memcpy(l->name[at], l->name[at - 1], sizeof l->name[at]);
		at--;
	}
	l->chan[at] = chan;
	snprintf(l->name[at], sizeof l->name[at], "%s", name);
	l->n++;
}

static int add_rest(struct builder *b, const struct gd_names_conf *conf)
{
	struct gd_names *names = b->names;
	int first = names->n;

	for (int i = 0; i < b->im->nchan; i++) {
		const struct gd_channel *ch = &b->im->chan[i];
		char base[256];
		const char *c = split(ch->name, base);
		struct gd_named *l = NULL;
		enum gd_role role;

		if (b->taken[i])
			continue;
		role = ch->type == GD_UINT || is_identifier(b->im, conf, ch->name) ? GD_ROLE_PASS :
		       cut_variance(base) ? GD_ROLE_VARIANCE :
		       !strcmp(ch->name, "samples") ? GD_ROLE_SAMPLES : GD_ROLE_MEAN;
		if (name_used(names, ch->name) || strlen(ch->name) > 255)
			role = strlen(ch->name) > 255 ? GD_ROLE_PASS : GD_ROLE_DROP;
		for (int k = first; k < names->n && !l; k++)
			if (names->layer[k].role == role && !strcmp(names->layer[k].layer, base) &&
			    role != GD_ROLE_PASS && *c)
				l = &names->layer[k];
		if (l && l->n == GD_NAMED_MAX) {	/* a fifth component stands alone */
			snprintf(base, sizeof base, "%s", ch->name);
			if (role == GD_ROLE_VARIANCE)
				role = GD_ROLE_MEAN;
			l = NULL;
		}
		if (!l) {
			l = append(b);
			if (!l)
				return GD_ENOMEM;
			l->role = role;
			snprintf(l->layer, sizeof l->layer, "%s", base);
		}
		insert_sorted(l, i, ch->name, c);
		b->taken[i] = true;
	}
	return GD_OK;
}

int gd_names_resolve(struct gd_names *names, const struct gd_image *im,
		     const struct gd_names_conf *conf, struct gd_err *err)
{
	struct builder b = { names, im, calloc((size_t)im->nchan + 1, sizeof *b.taken), err };
	char prefix[256];
	int rc = b.taken ? GD_OK : gd_fail(err, GD_ENOMEM, "out of memory");

	names->preset = conf->preset == GD_NAMES_AUTO ? recognise(im) : conf->preset;
	names->variance =
		conf->variance == GD_VARIANCE_AUTO ? usual_variance(names->preset) : conf->variance;
	for (int i = 0; i < conf->nmap && rc == GD_OK; i++)
		rc = apply_map(&b, conf->map[i]);
	view_layer(im, prefix);
	if (rc == GD_OK)
		rc = apply_rules(&b, names->preset, prefix);
	if (rc == GD_OK && names->preset == GD_NAMES_MITSUBA)
		rc = apply_mitsuba(&b);
	if (rc == GD_OK && !has_layer(&b, GD_ROLE_MEAN, "")) {
		struct found f = find_base(im, b.taken, "", "");

		rc = f.n ? add(&b, "", f) : GD_OK;
	}
	/* gd's own names come before the guesses */
	for (int i = 0; i < 4 && rc == GD_OK; i++) {
		static const char *const own[] = { "albedo", "N", "Z", "P" };
		struct found f = find_base(im, b.taken, "", own[i]);

		if (f.n && !has_layer(&b, GD_ROLE_MEAN, own[i]))
			rc = add(&b, own[i], f);
	}
	if (rc == GD_OK)
		rc = apply_rules(&b, GD_NAMES_AUTO, "");
	if (rc == GD_OK && names->variance == GD_VARIANCE_M2)
		rc = add_moments(&b);
	if (rc == GD_OK)
		rc = add_rest(&b, conf);
	free(b.taken);
	if (rc != GD_OK)
		gd_names_free(names);
	return rc;
}

void gd_names_free(struct gd_names *names)
{
	free(names->layer);
	*names = (struct gd_names){ 0 };
}

const struct gd_named *gd_names_find(const struct gd_names *names, enum gd_role role,
				     const char *layer)
{
	for (int i = 0; i < names->n; i++)
		if (names->layer[i].role == role && !strcmp(names->layer[i].layer, layer))
			return &names->layer[i];
	return NULL;
}

bool gd_names_spp(const struct gd_image *im, double *spp)
{
	static const char *const known[] = { "gd:samplesPerPixel", "gd:samples",
					     "samplesPerPixel" };

	for (int i = 0; i < 3; i++)
		if (gd_attr_number(im, known[i], spp) && isfinite(*spp) && *spp > 0)
			return true;
	for (int i = 0; i < im->nattr; i++)
		if (starts(im->attr[i].name, "cycles.") && ends(im->attr[i].name, ".samples") &&
		    gd_attr_number(im, im->attr[i].name, spp) && isfinite(*spp) && *spp > 0)
			return true;
	return false;
}
