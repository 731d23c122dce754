/* SPDX-License-Identifier: BSD-3-Clause */
#include "render/gltf.h"

#include <stdlib.h>

const cJSON *gd_json_extension(const cJSON *o, const char *name)
{
	return gd_json_get(gd_json_get(o, "extensions"), name);
}

double gd_json_double(const cJSON *o, const char *name, double otherwise)
{
	const cJSON *v = gd_json_get(o, name);

	return cJSON_IsNumber(v) && isfinite(v->valuedouble) ? v->valuedouble : otherwise;
}

bool gd_json_numbers(const cJSON *array, double *out, int n)
{
	const cJSON *v;
	double x[16];
	int i = 0;

	if (!cJSON_IsArray(array) || cJSON_GetArraySize(array) != n)
		return false;
	cJSON_ArrayForEach(v, array) {
		if (!cJSON_IsNumber(v) || !isfinite(v->valuedouble))
			return false;
		x[i++] = v->valuedouble;
	}
	for (i = 0; i < n; i++)
		out[i] = x[i];
	return true;
}

bool gd_json_index(const cJSON *o, const char *name, size_t *i)
{
	const cJSON *v = gd_json_get(o, name);

	if (!v)
		return false;
	*i = SIZE_MAX;
	if (cJSON_IsNumber(v) && v->valuedouble >= 0 && v->valuedouble < 0x1p53 &&
	    v->valuedouble == floor(v->valuedouble))
		*i = (size_t)v->valuedouble;
	return true;
}

const char *gd_json_text(const cJSON *o, const char *name)
{
	return cJSON_GetStringValue(gd_json_get(o, name));
}

int gd_json_list(struct gd_gltf_list *list, const cJSON *o, const char *name)
{
	const cJSON *array = gd_json_get(o, name), *v;
	const int n = cJSON_IsArray(array) ? cJSON_GetArraySize(array) : 0;

	list->item = malloc(((size_t)n + 1) * sizeof(*list->item));
	if (!list->item)
		return GD_ENOMEM;
	list->n = 0;
	if (n)
		cJSON_ArrayForEach(v, array)
			list->item[list->n++] = v;
	return GD_OK;
}
