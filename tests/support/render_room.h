/* SPDX-License-Identifier: BSD-3-Clause */
/* A corner of a room with a ball on its floor: what stands and shines in it is chosen. */
#ifndef RENDER_ROOM_H
#define RENDER_ROOM_H

#include "render_scene.h"

enum room_light { LAMP = 1, POINT = 2, SPOT = 4, SUN = 8, SKY = 16, MAP = 32 };

struct room {
	struct gd_material floor, ball;
	unsigned light;		/* of enum room_light */
	float lens;
};

/* Without what gd_scene_finish() adds. */
static inline struct gd_scene *room_start(const struct room *r)
{
	struct gd_scene *s = scene_new();
	const uint32_t floor = add_material(s, r->floor), ball = add_material(s, r->ball);
	const uint32_t wall = add_material(s, tinted(0.7f, 0.7f, 0.6f));
	const uint32_t red = add_material(s, tinted(0.8f, 0.2f, 0.1f));
	const bool open = r->light & (SUN | SKY | MAP);

	add_quad(s, gd_v3(-1, 0, 1), gd_v3(2, 0, 0), gd_v3(0, 0, -2), floor);
	add_quad(s, gd_v3(-1, 0, -1), gd_v3(2, 0, 0), gd_v3(0, 1.5f, 0), wall);
	add_quad(s, gd_v3(-1, 0, 1), gd_v3(0, 0, -2), gd_v3(0, 1.5f, 0), red);
	if (!open)
		add_quad(s, gd_v3(-1, 1.5f, -1), gd_v3(2, 0, 0), gd_v3(0, 0, 2), wall);
	add_ball(s, gd_v3(0.15f, 0.35f, -0.1f), 0.35f, 10, true, ball);
	if (r->light & LAMP)
		add_quad(s, gd_v3(0.1f, 1.4f, -0.5f), gd_v3(0.5f, 0, 0), gd_v3(0, 0, 0.5f),
			 add_material(s, lamp(6)));
	if (r->light & POINT)
		add_point(s, gd_v3(-0.5f, 1.2f, 0.3f), 0.8f);
	if (r->light & SPOT)
		add_spot(s, gd_v3(0.8f, 1.3f, 0.6f), gd_v3(0, 0, 0), 0.2f, 0.4f, 2);
	if (r->light & SUN)
		add_sun(s, gd_v3(-0.3f, -1, -0.4f), 2);
	if (r->light & SKY)
		add_sky(s, 0.5f);
	if (r->light & MAP)
		add_sky_map(s, 32);
	look_at(s, gd_v3(0.3f, 0.9f, 2.2f), gd_v3(0, 0.4f, -0.2f), 0.4f, 16.f / 12);
	s->view.lens = r->lens;
	s->view.focus = 2.2f;
	return s;
}

static inline struct gd_scene *room_new(const struct room *r)
{
	return finished(room_start(r));
}

/*
 * A closed box whose ceiling shines, seen from above: bright and dark stripes as wide as a pixel of
 * 16, so that paths of neighbours survive with very different chances.
 */
static inline struct gd_scene *stripes_new(const struct room *r)
{
	struct gd_scene *s = scene_new();
	struct gd_material shine = matter(0.3f);

	shine.emission = gd_v3(1, 1, 1);
	const uint32_t stripe[2] = { add_material(s, r->floor), add_material(s, r->ball) };
	const uint32_t wall = add_material(s, matter(0.85f)), top = add_material(s, shine);
	const uint32_t six[6] = { wall, wall, wall, top, wall, wall };

	add_box(s, gd_v3(-1, 0, -1), gd_v3(1, 1, 1), six, true);
	for (int i = 0; i < 16; i++)
		add_quad(s, gd_v3(-0.8f + 0.1f * (float)i, 0.01f, 0.6f), gd_v3(0.1f, 0, 0),
			 gd_v3(0, 0, -1.2f), stripe[i % 2]);
	look_at(s, gd_v3(0, 0.81f, 0), gd_v3(0, 0, 0), 0.75f, 16.f / 12);
	return finished(s);
}

/* A narrow corner under a ceiling that shines: the walls are what the ball is made of elsewhere. */
static inline struct gd_scene *corner_new(const struct room *r)
{
	struct gd_scene *s = scene_new();
	struct gd_material shine = matter(0);

	shine.emission = gd_v3(1, 0.8f, 0.6f);
	const uint32_t floor = add_material(s, r->floor), wall = add_material(s, r->ball);
	const uint32_t six[6] = { wall, wall, floor, add_material(s, shine), wall, wall };

	add_box(s, gd_v3(0, 0, 0), gd_v3(0.5f, 1, 0.4f), six, true);
	look_at(s, gd_v3(0.4f, 0.6f, 0.3f), gd_v3(0, 0, 0), 0.7f, 16.f / 12);
	return finished(s);
}

#endif
