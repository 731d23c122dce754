/* SPDX-License-Identifier: BSD-3-Clause */
/* How many samples stand behind a mean. */
#include <string.h>

#include "merge_state.h"

/* The layer without "half0." or "half1." in front. */
static const char *whole_name(const char *name)
{
	const char *dot = gd_merge_in_family(name, "half") ? strchr(name, '.') : NULL;

	return dot ? dot + 1 : name;
}

int gd_merge_edge_of(const char *name)
{
	name = whole_name(name);
	if (!strcmp(name, "dx") || !strcmp(name, "dy"))
		return name[1] == 'y';
	if (!strncmp(name, "pair", 4) && name[4] >= '0' && name[4] < '0' + MERGE_EDGES - 2 &&
	    !name[5])
		return 2 + name[4] - '0';
	return -1;
}

bool gd_merge_is_worth(const char *name)
{
	const char *dot = strrchr(name, '.');
	char layer[16];

	if (!dot || strcmp(dot, ".samples") || (size_t)(dot - name) >= sizeof layer)
		return false;
	memcpy(layer, name, (size_t)(dot - name));
	layer[dot - name] = 0;
	return gd_merge_edge_of(layer) >= 0 && !gd_merge_in_family(layer, "half");
}

void gd_merge_other_end(const struct gd_merge *m, int edge, int *x, int *y)
{
	int u = *x + (edge == 0), v = *y + (edge == 1);

	if (edge > 1) {
		const struct gd_plane *at = m->place[edge - 2];
		const float dx = at[0].v ? gd_row(at[0], *y)[*x] : 0;
		const float dy = at[1].v ? gd_row(at[1], *y)[*x] : 0;

		u = dx > -100 && dx < 100 ? *x + (int)dx : -1;
		v = dy > -100 && dy < 100 ? *y + (int)dy : -1;
	}
	if (u < 0 || v < 0 || u >= m->w || v >= m->h)
		return;
	*x = u;
	*y = v;
}

/* What counts say of a gradient. */
static float worth_of(const struct gd_merge *m, int edge, struct gd_plane count, int x, int y)
{
	int u = x, v = y;

	gd_merge_other_end(m, edge, &u, &v);
	return (float)gd_merge_harmonic((double)gd_row(count, y)[x], (double)gd_row(count, v)[u]);
}

static void weigh(struct gd_merge *m, const struct merge_layer *l, const struct gd_count *count,
		  float scale, bool bad, struct gd_count *w)
{
	const struct gd_plane told = l->edge >= 0 ? m->worth[l->edge] : (struct gd_plane){ 0 };
	const bool edge = l->edge >= 0 && !m->conf.own_edges && count->plane.v;

	*w = (struct gd_count){ .all = count->all * (double)scale };
	if (!count->plane.v && !told.v && !bad)
		return;
	w->plane = m->weight;
#pragma omp parallel for schedule(static) if (GD_ACCUM_MANY(m->weight))
	for (int y = 0; y < m->h; y++) {
		const float *a = told.v ? gd_row(told, y) :
				 count->plane.v ? gd_row(count->plane, y) : NULL;
		float *row = gd_row(w->plane, y);

		for (int x = 0; x < m->w; x++)
			row[x] = !a ? (float)w->all : edge && !told.v ?
				 scale * worth_of(m, l->edge, count->plane, x, y) : scale * a[x];
	}
}

void gd_merge_weigh_side(struct gd_merge *m, const struct merge_layer *l, int side, float scale,
			 struct gd_count *w)
{
	const struct gd_plane told = l->edge >= 0 ? m->worth[l->edge] : (struct gd_plane){ 0 };
	const struct gd_plane *count = m->side;

	if (!told.v) {
		const struct gd_count c = { .plane = count[side] };

		weigh(m, l, &c, scale, true, w);
		return;
	}
	/* the side's share of what the gradient is worth */
	*w = (struct gd_count){ .plane = m->weight };
#pragma omp parallel for schedule(static) if (GD_ACCUM_MANY(m->weight))
	for (int y = 0; y < m->h; y++)
		for (int x = 0; x < m->w; x++) {
			const float a = worth_of(m, l->edge, count[side], x, y);
			const float b = worth_of(m, l->edge, count[1 - side], x, y);

			gd_row(w->plane, y)[x] =
				a > 0 ? scale * gd_row(told, y)[x] * (a / (a + b)) : 0;
		}
}

void gd_merge_weigh(struct gd_merge *m, const struct merge_layer *l, const struct gd_count *count,
		    bool bad, struct gd_count *w)
{
	if (l->half && m->side[0].v)
		gd_merge_weigh_side(m, l, l->name[4] == '1', 1, w);
	else
		weigh(m, l, count, l->half ? 0.5f : 1, bad, w);
}
