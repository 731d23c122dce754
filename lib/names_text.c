/* SPDX-License-Identifier: BSD-3-Clause */
#include "names.h"

#include <stdio.h>
#include <string.h>

static const char *const presets[] = {
	"auto", "gd", "pbrt", "mitsuba", "cycles", "tungsten", "arnold", "renderman"
};
static const char *const variances[] = { "auto", "none", "mean", "sample", "m2" };

static int find_word(const char *const *list, int n, const char *word)
{
	for (int i = 0; i < n; i++)
		if (!strcmp(list[i], word))
			return i;
	return -1;
}

bool gd_preset_parse(const char *name, enum gd_preset *preset)
{
	int i = find_word(presets, 8, strcmp(name, "noice") ? name : "arnold");

	if (i >= 0)
		*preset = (enum gd_preset)i;
	return i >= 0;
}

const char *gd_preset_name(enum gd_preset preset)
{
	return presets[preset];
}

bool gd_variance_parse(const char *name, enum gd_variance *variance)
{
	int i = find_word(variances, 5, name);

	if (i >= 0)
		*variance = (enum gd_variance)i;
	return i >= 0;
}

const char *gd_variance_name(enum gd_variance variance)
{
	return variances[variance];
}

/* Length of what all n names begin with. */
static size_t in_common(const char *const *name, int n)
{
	size_t len = 0;

	for (;; len++)
		for (int i = 0; i < n; i++)
			if (!name[i][len] || name[i][len] != name[0][len])
				return len;
}

void gd_named_describe(const struct gd_named *l, const struct gd_image *im, char *text, size_t size)
{
	const char *name[GD_NAMED_MAX];
	size_t used, first;

	for (int i = 0; i < l->n; i++)
		name[i] = im->chan[l->chan[i]].name;
	if (l->n == 1 || l->chan[0] == l->chan[1]) {
		snprintf(text, size, "%s", name[0]);
		return;
	}
	first = in_common(name, l->n);
	used = (size_t)snprintf(text, size, "%.*s{", (int)first, name[0]);
	for (int i = 0; i < l->n && used < size; i++)
		used += (size_t)snprintf(text + used, size - used, "%s%s", i ? "," : "",
					 name[i] + first);
	if (used < size)
		snprintf(text + used, size - used, "}");
}
