/* SPDX-License-Identifier: BSD-3-Clause */
#include "render/gltf.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "plugin.h"

/* What a file asks for and does not get, each named once. */
struct missing {
	const char *what[24];
	int n;
};

struct load {
	struct gd_gltf *g;
	struct gd_scene *s;
	uint32_t *colour, *data;	/* texture made of each of the file's, by its use */
	bool no_plugin;			/* told already */
	size_t lost;			/* textures that are left out */
	struct missing missing;
	struct gd_err *err;
};

static void miss(struct missing *m, const char *what)
{
	for (int i = 0; i < m->n; i++)
		if (!strcmp(m->what[i], what))
			return;
	if (m->n < (int)(sizeof(m->what) / sizeof(*m->what)))
		m->what[m->n++] = what;
}

static float clamped(double v, double low, double high)
{
	return (float)(v < low ? low : v > high ? high : v);
}

/* --- textures --- */

static bool starts(const struct gd_bytes *b, const char *magic, size_t n)
{
	return b->size >= n && !memcmp(b->data, magic, n);
}

/* The format of an image in memory, as the end of a file name for the plug-in. */
static const char *name_of(const struct gd_bytes *b)
{
	if (starts(b, "\x89PNG", 4))
		return "image.png";
	if (starts(b, "\xff\xd8", 2))
		return "image.jpg";
	if (starts(b, "RIFF", 4))
		return "image.webp";
	if (starts(b, "\x76\x2f\x31\x01", 4))
		return "image.exr";
	return starts(b, "#?", 2) ? "image.hdr" : "image.png";
}

static int read_image(struct load *l, const cJSON *image, struct gd_texture *t, bool data,
		      struct gd_err *err)
{
	const char *uri = gd_json_text(image, "uri");
	struct gd_bytes b = { 0 };
	char name[1024], *path;
	size_t view;
	int rc;

	if (uri && strncmp(uri, "data:", 5)) {
		path = gd_gltf_path(l->g, uri);
		rc = path ? gd_texture_read(t, path, NULL, data, err) : GD_ENOMEM;
		free(path);
		return rc;
	}
	if (uri)
		rc = gd_gltf_uri(l->g, uri, &b, err);
	else if (gd_json_index(image, "bufferView", &view))
		rc = gd_gltf_view(l->g, view, &b, err);
	else
		rc = gd_fail(err, GD_EFORMAT, "%s: an image without uri or bufferView", l->g->path);
	if (rc == GD_OK) {
		snprintf(name, sizeof(name), "%.1000s#%s", l->g->path, name_of(&b));
		rc = gd_texture_read(t, name, &b, data, err);
	}
	gd_bytes_free(&b);
	return rc;
}

static void set_wrap(struct load *l, const cJSON *texture, struct gd_texture *t)
{
	size_t i, u = 10497, v = 10497;

	if (gd_json_index(texture, "sampler", &i) && i < l->g->samplers.n) {
		gd_json_index(l->g->samplers.item[i], "wrapS", &u);
		gd_json_index(l->g->samplers.item[i], "wrapT", &v);
	}
	if (u == 33648 || v == 33648)
		miss(&l->missing, "mirrored repeat of textures");
	t->clamp_u = u == 33071;
	t->clamp_v = v == 33071;
}

/* The image of a texture: that of an extension, too, if there is no other. */
static const cJSON *image_of(const struct load *l, const cJSON *texture)
{
	size_t i;

	if (gd_json_index(texture, "source", &i) && i < l->g->images.n)
		return l->g->images.item[i];
	if (gd_json_index(gd_json_extension(texture, "EXT_texture_webp"), "source", &i) &&
	    i < l->g->images.n)
		return l->g->images.item[i];
	return NULL;
}

/* The first is warned of, with the reason; the others are counted, and noted one by one. */
static void tell_failure(struct load *l, size_t i, const struct gd_err *why)
{
	struct gd_err none = { 0 };

	if (gd_plugin_check(&none) != GD_OK) {
		if (!l->no_plugin)
			gd_warn(l->g->report, "%s: textures are left out: %s", l->g->path,
				none.text);
		l->no_plugin = true;
		return;
	}
	(l->lost++ ? gd_note : gd_warn)(l->g->report, "%s: texture %zu is left out: %s", l->g->path,
					i, why->code ? why->text : "it has no image");
}

/* Index into scene.texture of a member such as baseColorTexture, or GD_NO_INDEX. */
static uint32_t texture_of(struct load *l, const cJSON *info, bool data)
{
	struct gd_texture t = { 0 };
	struct gd_err why = { 0 };
	const cJSON *image;
	uint32_t *known;
	size_t i;

	if (!info)
		return GD_NO_INDEX;
	if (!gd_json_index(info, "index", &i) || i >= l->g->textures.n) {
		(l->lost++ ? gd_note : gd_warn)(l->g->report,
						"%s: a texture that is not there is left out",
						l->g->path);
		return GD_NO_INDEX;
	}
	known = data ? &l->data[i] : &l->colour[i];
	if (*known != 0)
		return *known == GD_NO_INDEX ? GD_NO_INDEX : *known - 1;
	*known = GD_NO_INDEX;
	image = image_of(l, l->g->textures.item[i]);
	if (image)
		read_image(l, image, &t, data, &why);
	if (!t.rgb) {
		tell_failure(l, i, &why);
		return GD_NO_INDEX;
	}
	set_wrap(l, l->g->textures.item[i], &t);
	l->s->texture[l->s->ntexture] = t;
	*known = (uint32_t)++l->s->ntexture;
	return *known - 1;
}

/* --- texture coordinates --- */

/* Those of one texture: set and transform. */
static struct gd_gltf_uv coordinates(const cJSON *info)
{
	const cJSON *t = gd_json_extension(info, "KHR_texture_transform");
	double offset[2] = { 0, 0 }, scale[2] = { 1, 1 };
	const double turn = gd_json_double(t, "rotation", 0), c = cos(turn), s = sin(turn);
	size_t set = 0;

	gd_json_index(info, "texCoord", &set);
	gd_json_index(t, "texCoord", &set);
	gd_json_numbers(gd_json_get(t, "offset"), offset, 2);
	gd_json_numbers(gd_json_get(t, "scale"), scale, 2);
	return (struct gd_gltf_uv){
		.set = set < 8 ? (int)set : 0,
		.m = { { (float)(c * scale[0]), (float)(s * scale[1]), (float)offset[0] },
		       { (float)(-s * scale[0]), (float)(c * scale[1]), (float)offset[1] } },
	};
}

/* All maps of a material share the coordinates of the first. */
static void add_coordinates(struct load *l, struct gd_gltf_uv *uv, uint32_t map, const cJSON *info)
{
	struct gd_gltf_uv mine;

	if (map == GD_NO_INDEX)
		return;
	mine = coordinates(info);
	if (uv->set < 0)
		*uv = mine;
	else if (mine.set != uv->set || memcmp(mine.m, uv->m, sizeof(mine.m)))
		miss(&l->missing, "texture coordinates that differ within a material");
}

/* --- materials --- */

static const struct {
	const char *extension, *member, *name;
} unknown[] = {
	{ "KHR_materials_clearcoat", "clearcoatFactor", "clearcoat" },
	{ "KHR_materials_sheen", NULL, "sheen" },
	{ "KHR_materials_specular", NULL, "specular factors" },
	{ "KHR_materials_volume", "thicknessFactor", "absorption in volumes" },
	{ "KHR_materials_iridescence", NULL, "iridescence" },
	{ "KHR_materials_anisotropy", NULL, "anisotropy" },
	{ "KHR_materials_dispersion", NULL, "dispersion" },
	{ "KHR_materials_unlit", NULL, "unlit materials" },
	{ "KHR_materials_pbrSpecularGlossiness", NULL, "specular-glossiness materials" },
};

static void look_for_unknown(struct missing *m, const cJSON *json)
{
	const char *alpha = gd_json_text(json, "alphaMode");
	const cJSON *e;

	if (gd_json_get(json, "normalTexture"))
		miss(m, "normal maps");
	if (gd_json_get(json, "occlusionTexture"))
		miss(m, "occlusion maps");
	if (alpha && strcmp(alpha, "OPAQUE"))
		miss(m, "alpha");
	if (gd_json_get(gd_json_extension(json, "KHR_materials_transmission"),
			"transmissionTexture"))
		miss(m, "transmission maps");
	for (size_t i = 0; i < sizeof(unknown) / sizeof(*unknown); i++) {
		e = gd_json_extension(json, unknown[i].extension);
		if (e && (!unknown[i].member || gd_json_double(e, unknown[i].member, 0) > 0))
			miss(m, unknown[i].name);
	}
}

static void set_colour(struct gd_v3 *to, const cJSON *array, int n, double scale, double high)
{
	double c[4];

	if (gd_json_numbers(array, c, n))
		*to = gd_v3(clamped(c[0] * scale, 0, high), clamped(c[1] * scale, 0, high),
			    clamped(c[2] * scale, 0, high));
}

static void read_material(struct load *l, const cJSON *json, struct gd_material *m,
			  struct gd_gltf_uv *uv)
{
	const cJSON *pbr = gd_json_get(json, "pbrMetallicRoughness");
	const cJSON *base = gd_json_get(pbr, "baseColorTexture"),
		    *rough = gd_json_get(pbr, "metallicRoughnessTexture"),
		    *emission = gd_json_get(json, "emissiveTexture");
	const double strength = gd_json_double(
		gd_json_extension(json, "KHR_materials_emissive_strength"), "emissiveStrength", 1);

	*m = (struct gd_material){ .base = { 1, 1, 1 }, .ior = 1.5f };
	*uv = (struct gd_gltf_uv){ .set = -1 };
	set_colour(&m->base, gd_json_get(pbr, "baseColorFactor"), 4, 1, 1);
	set_colour(&m->emission, gd_json_get(json, "emissiveFactor"), 3, strength, 1e30);
	m->metallic = clamped(gd_json_double(pbr, "metallicFactor", 1), 0, 1);
	m->roughness = clamped(gd_json_double(pbr, "roughnessFactor", 1), 0, 1);
	m->transmission = clamped(gd_json_double(gd_json_extension(json,
								   "KHR_materials_transmission"),
						 "transmissionFactor", 0), 0, 1);
	m->ior = clamped(gd_json_double(gd_json_extension(json, "KHR_materials_ior"), "ior", 1.5),
			 1, 100);
	m->base_map = texture_of(l, base, false);
	m->rough_map = texture_of(l, rough, true);
	m->emission_map = gd_black(m->emission) ? GD_NO_INDEX : texture_of(l, emission, false);
	add_coordinates(l, uv, m->base_map, base);
	add_coordinates(l, uv, m->rough_map, rough);
	add_coordinates(l, uv, m->emission_map, emission);
	look_for_unknown(&l->missing, json);
}

/* What there is besides materials. */
static void look_around(struct load *l)
{
	const cJSON *p;

	if (cJSON_GetArraySize(gd_json_get(l->g->json, "animations")))
		miss(&l->missing, "animations");
	if (cJSON_GetArraySize(gd_json_get(l->g->json, "skins")))
		miss(&l->missing, "skins");
	for (size_t i = 0; i < l->g->meshes.n; i++)
		cJSON_ArrayForEach(p, gd_json_get(l->g->meshes.item[i], "primitives")) {
			if (gd_json_get(p, "targets"))
				miss(&l->missing, "morph targets");
			if (gd_json_get(gd_json_get(p, "attributes"), "COLOR_0"))
				miss(&l->missing, "vertex colours");
		}
}

static void tell(const struct load *l)
{
	char text[768] = "";
	size_t n = 0;

	for (int i = 0; i < l->missing.n; i++)
		n += (size_t)snprintf(text + n, sizeof(text) - n, "%s%s", i ? ", " : "",
				      l->missing.what[i]);
	if (l->lost > 1)
		gd_warn(l->g->report, "%s: %zu more textures are left out (-v names them)",
			l->g->path, l->lost - 1);
	if (l->missing.n)
		gd_warn(l->g->report, "%s: not modelled and left out: %s", l->g->path, text);
}

int gd_gltf_materials(struct gd_gltf *g, struct gd_scene *scene, struct gd_err *err)
{
	struct load l = { .g = g, .s = scene, .err = err };
	const size_t n = g->materials.n;
	int rc = GD_OK;

	scene->material = calloc(n + 1, sizeof(*scene->material));
	scene->texture = calloc(2 * g->textures.n + 1, sizeof(*scene->texture));
	g->uv = calloc(n + 1, sizeof(*g->uv));
	l.colour = calloc(g->textures.n + 1, sizeof(*l.colour));
	l.data = calloc(g->textures.n + 1, sizeof(*l.data));
	if (scene->material && scene->texture && g->uv && l.colour && l.data) {
		for (size_t i = 0; i <= n; i++)
			read_material(&l, i < n ? g->materials.item[i] : NULL,
				      &scene->material[i], &g->uv[i]);
		scene->nmaterial = n + 1;
		look_around(&l);
		tell(&l);
	} else {
		rc = gd_fail(err, GD_ENOMEM, "%s: out of memory", g->path);
	}
	free(l.colour);
	free(l.data);
	return rc;
}
