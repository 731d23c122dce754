/* SPDX-License-Identifier: BSD-3-Clause */
#include "render/gltf.h"

#include <ctype.h>
#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

/* --- bytes --- */

static int map_file(const char *path, struct gd_bytes *b, struct gd_err *err)
{
	struct stat st;
	int fd = open(path, O_RDONLY | O_CLOEXEC);
	int rc = GD_OK;

	if (fd < 0)
		return gd_fail(err, GD_EIO, "%s: %s", path, strerror(errno));
	if (fstat(fd, &st))
		rc = gd_fail(err, GD_EIO, "%s: %s", path, strerror(errno));
	else if (!S_ISREG(st.st_mode))
		rc = gd_fail(err, GD_EIO, "%s: %s", path,
			     S_ISDIR(st.st_mode) ? strerror(EISDIR) : "not a regular file");
	else if (st.st_size > 0) {
		void *p = mmap(NULL, (size_t)st.st_size, PROT_READ, MAP_PRIVATE, fd, 0);

		if (p == MAP_FAILED)
			rc = gd_fail(err, GD_EIO, "%s: %s", path, strerror(errno));
		else
			*b = (struct gd_bytes){ p, (size_t)st.st_size, GD_BYTES_MAPPED };
	}
	close(fd);
	return rc;
}

void gd_bytes_free(struct gd_bytes *b)
{
	if (b->kind == GD_BYTES_OWNED)
		free(b->data);
	else if (b->kind == GD_BYTES_MAPPED)
		munmap(b->data, b->size);
	*b = (struct gd_bytes){ 0 };
}

static int hex(char c)
{
	if (c >= '0' && c <= '9')
		return c - '0';
	return isxdigit((unsigned char)c) ? (c | 32) - 'a' + 10 : -1;
}

/* Percent-decoding in place. */
static void unescape(char *s)
{
	char *to = s;

	for (; *s; s++) {
		if (*s == '%' && hex(s[1]) >= 0 && hex(s[2]) >= 0) {
			*to++ = (char)(hex(s[1]) * 16 + hex(s[2]));
			s += 2;
		} else {
			*to++ = *s;
		}
	}
	*to = '\0';
}

char *gd_gltf_path(const struct gd_gltf *g, const char *uri)
{
	const size_t folder = uri[0] == '/' ? 0 : strlen(g->folder), n = strlen(uri) + 1;
	char *path = malloc(folder + n);

	if (!path)
		return NULL;
	memcpy(path, g->folder, folder);
	memcpy(path + folder, uri, n);
	unescape(path + folder);
	return path;
}

static int digit64(char c)
{
	return c >= 'A' && c <= 'Z' ? c - 'A' :
	       c >= 'a' && c <= 'z' ? c - 'a' + 26 :
	       c >= '0' && c <= '9' ? c - '0' + 52 :
	       c == '+' || c == '-' ? 62 :
	       c == '/' || c == '_' ? 63 : -1;
}

/* data:[type][;base64],... */
static int decode_data(const struct gd_gltf *g, const char *uri, struct gd_bytes *b,
		       struct gd_err *err)
{
	const char *from = strchr(uri, ',');
	unsigned word = 0;
	int bits = 0;
	size_t n = 0;

	if (!from || from - uri < 7 || strncasecmp(from - 7, ";base64", 7))
		return gd_fail(err, GD_EFORMAT, "%s: a data: URI that is not base64", g->path);
	from++;
	b->data = malloc(strlen(from) / 4 * 3 + 4);
	if (!b->data)
		return gd_fail(err, GD_ENOMEM, "%s: out of memory", g->path);
	b->kind = GD_BYTES_OWNED;
	for (; *from && *from != '='; from++) {
		const int d = digit64(*from);

		if (d < 0)
			return gd_fail(err, GD_EFORMAT, "%s: a data: URI that is not base64",
				       g->path);
		word = (word << 6 | (unsigned)d) & 0xffffff;
		bits += 6;
		if (bits >= 8) {
			bits -= 8;
			b->data[n++] = (unsigned char)(word >> bits);
		}
	}
	b->size = n;
	return GD_OK;
}

int gd_gltf_uri(const struct gd_gltf *g, const char *uri, struct gd_bytes *bytes,
		struct gd_err *err)
{
	char *path;
	int rc;

	*bytes = (struct gd_bytes){ 0 };
	if (!strncasecmp(uri, "data:", 5)) {
		rc = decode_data(g, uri, bytes, err);
	} else {
		path = gd_gltf_path(g, uri);
		rc = path ? map_file(path, bytes, err) :
			    gd_fail(err, GD_ENOMEM, "%s: out of memory", g->path);
		free(path);
	}
	if (rc != GD_OK)
		gd_bytes_free(bytes);
	return rc;
}

/* --- the file --- */

static uint32_t word_at(const unsigned char *p)
{
	return p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}

/* Finds the JSON, and of a .glb the binary chunk. */
static int split(struct gd_gltf *g, const char **text, size_t *length, struct gd_err *err)
{
	const unsigned char *p = g->file.data;
	size_t at = 12, size = g->file.size;

	*text = (const char *)p;
	*length = size;
	if (size < 4 || memcmp(p, "glTF", 4))
		return GD_OK;
	*length = 0;
	if (size < 20)
		return gd_fail(err, GD_EFORMAT, "%s: incomplete", g->path);
	if (word_at(p + 4) != 2)
		return gd_fail(err, GD_EFORMAT, "%s: glTF %u, wanted 2", g->path, word_at(p + 4));
	if (word_at(p + 8) > size)
		return gd_fail(err, GD_EFORMAT, "%s: incomplete: %zu bytes of %u", g->path, size,
			       word_at(p + 8));
	while (size - at >= 8) {
		const size_t n = word_at(p + at);
		const uint32_t kind = word_at(p + at + 4);

		at += 8;
		if (n > size - at)
			return gd_fail(err, GD_EFORMAT, "%s: incomplete", g->path);
		if (kind == 0x4e4f534a && !*length) {
			*text = (const char *)p + at;
			*length = n;
		} else if (kind == 0x004e4942 && !g->bin) {
			g->bin = p + at;
			g->bin_size = n;
		}
		at += (n + 3) / 4 * 4;
		if (at > size)
			break;
	}
	return GD_OK;
}

static int parse(struct gd_gltf *g, struct gd_err *err)
{
	const char *text, *end = NULL, *version;
	size_t length;
	int rc = split(g, &text, &length, err);

	if (rc != GD_OK)
		return rc;
	if (length)
		g->json = cJSON_ParseWithLengthOpts(text, length, &end, 0);
	if (!cJSON_IsObject(g->json)) {
		if (length && text[0] == '{' && end && end > text)
			return gd_fail(err, GD_EFORMAT, "%s: damaged JSON near byte %zu", g->path,
				       (size_t)(end - (const char *)g->file.data));
		return gd_fail(err, GD_EFORMAT, "%s: not a glTF file", g->path);
	}
	version = gd_json_text(gd_json_get(g->json, "asset"), "version");
	if (!version)
		return gd_fail(err, GD_EFORMAT, "%s: not a glTF file: no asset.version", g->path);
	if (strncmp(version, "2", 1) || (version[1] && version[1] != '.'))
		return gd_fail(err, GD_EFORMAT, "%s: glTF %s, wanted 2", g->path, version);
	return GD_OK;
}

/* Extensions without which the file says it cannot be shown, and which are not known here. */
static int check_required(const struct gd_gltf *g, struct gd_err *err)
{
	static const char *const known[] = {
		"KHR_draco_mesh_compression", "KHR_lights_punctual", "KHR_materials_clearcoat",
		"KHR_materials_emissive_strength", "KHR_materials_ior", "KHR_materials_sheen",
		"KHR_materials_specular", "KHR_materials_transmission", "KHR_materials_unlit",
		"KHR_materials_variants", "KHR_materials_volume", "KHR_mesh_quantization",
		"KHR_texture_transform",
	};
	const cJSON *name;

	cJSON_ArrayForEach(name, gd_json_get(g->json, "extensionsRequired")) {
		const char *text = cJSON_GetStringValue(name);
		size_t k = 0;

		while (text && k < sizeof(known) / sizeof(*known) && strcmp(text, known[k]))
			k++;
		if (text && k == sizeof(known) / sizeof(*known))
			return gd_fail(err, GD_EFORMAT, "%s: needs the extension %s, which is not "
							"supported", g->path, text);
	}
	return GD_OK;
}

static int load_buffer(struct gd_gltf *g, const cJSON *json, struct gd_err *err)
{
	struct gd_bytes *b = &g->buffer[g->nbuffer];
	const char *uri = gd_json_text(json, "uri");
	size_t want;
	int rc = GD_OK;

	if (!gd_json_index(json, "byteLength", &want) || want == SIZE_MAX)
		return gd_fail(err, GD_EFORMAT, "%s: buffer %zu has no byteLength", g->path,
			       g->nbuffer);
	if (uri)
		rc = gd_gltf_uri(g, uri, b, err);
	else if (g->nbuffer == 0 && g->bin)
		*b = (struct gd_bytes){ (unsigned char *)g->bin, g->bin_size, GD_BYTES_BORROWED };
	if (rc != GD_OK)
		return rc;
	g->nbuffer++;
	if (b->size < want)
		return gd_fail(err, GD_EFORMAT, "%s: %s%.200s has %zu bytes, wanted %zu", g->path,
			       "buffer ", uri && strncasecmp(uri, "data:", 5) ? uri : "(inside)",
			       b->size, want);
	return GD_OK;
}

static int load_buffers(struct gd_gltf *g, struct gd_err *err)
{
	const cJSON *list = gd_json_get(g->json, "buffers"), *json;
	int rc = GD_OK;

	g->buffer = calloc((size_t)cJSON_GetArraySize(list) + 1, sizeof(*g->buffer));
	if (!g->buffer)
		return gd_fail(err, GD_ENOMEM, "%s: out of memory", g->path);
	cJSON_ArrayForEach(json, list) {
		rc = load_buffer(g, json, err);
		if (rc != GD_OK)
			break;
	}
	return rc;
}

static int make_lists(struct gd_gltf *g, struct gd_err *err)
{
	if (gd_json_list(&g->accessors, g->json, "accessors") != GD_OK ||
	    gd_json_list(&g->views, g->json, "bufferViews") != GD_OK ||
	    gd_json_list(&g->meshes, g->json, "meshes") != GD_OK ||
	    gd_json_list(&g->materials, g->json, "materials") != GD_OK ||
	    gd_json_list(&g->textures, g->json, "textures") != GD_OK ||
	    gd_json_list(&g->images, g->json, "images") != GD_OK ||
	    gd_json_list(&g->samplers, g->json, "samplers") != GD_OK)
		return gd_fail(err, GD_ENOMEM, "%s: out of memory", g->path);
	return GD_OK;
}

int gd_gltf_view(const struct gd_gltf *g, size_t view, struct gd_bytes *bytes, struct gd_err *err)
{
	size_t buffer, offset = 0, length;
	const cJSON *v;

	if (view >= g->views.n)
		return gd_fail(err, GD_EFORMAT, "%s: there is no buffer view %zu", g->path, view);
	v = g->views.item[view];
	gd_json_index(v, "byteOffset", &offset);
	if (!gd_json_index(v, "buffer", &buffer) || buffer >= g->nbuffer ||
	    !gd_json_index(v, "byteLength", &length) || offset > g->buffer[buffer].size ||
	    length > g->buffer[buffer].size - offset)
		return gd_fail(err, GD_EFORMAT, "%s: buffer view %zu is not within its buffer",
			       g->path, view);
	*bytes = (struct gd_bytes){ g->buffer[buffer].data + offset, length, GD_BYTES_BORROWED };
	return GD_OK;
}

int gd_gltf_open(struct gd_gltf *g, const char *path, const struct gd_report *report,
		 struct gd_err *err)
{
	const char *slash = strrchr(path, '/');
	int rc;

	*g = (struct gd_gltf){ .path = path, .report = report };
	g->folder = strndup(path, slash ? (size_t)(slash - path) + 1 : 0);
	rc = g->folder ? map_file(path, &g->file, err) :
			 gd_fail(err, GD_ENOMEM, "%s: out of memory", path);
	if (rc == GD_OK)
		rc = parse(g, err);
	if (rc == GD_OK)
		rc = check_required(g, err);
	if (rc == GD_OK)
		rc = load_buffers(g, err);
	if (rc == GD_OK)
		rc = make_lists(g, err);
	if (rc != GD_OK)
		gd_gltf_close(g);
	return rc;
}

void gd_gltf_close(struct gd_gltf *g)
{
	for (size_t i = 0; i < g->nbuffer; i++)
		gd_bytes_free(&g->buffer[i]);
	free(g->buffer);
	free(g->accessors.item);
	free(g->views.item);
	free(g->meshes.item);
	free(g->materials.item);
	free(g->textures.item);
	free(g->images.item);
	free(g->samplers.item);
	free(g->node);
	free(g->order);
	free(g->uv);
	cJSON_Delete(g->json);
	gd_bytes_free(&g->file);
	free(g->folder);
	*g = (struct gd_gltf){ 0 };
}
