/* SPDX-License-Identifier: BSD-3-Clause */
/* Scenes that no one would build, and huge, tiny and blinding ones: all numbers stay finite. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <cmocka.h>

#include "../support/render_room.h"
#include "../support/render_shot.h"

#define W 16
#define H 12

static struct shot picture(const struct gd_scene *scene, int spp, float ratio)
{
	struct shot s = { .w = W, .h = H, .scene = scene, .ring = NEXT, .spp = spp + 1, .seed = 9 };

	s.conf = (struct gd_path_conf){
		.depth = 8, .shift_ratio = ratio, .ambient = 0.01f, .mis = true
	};
	shoot(&s);
	return s;
}

static bool sound(const struct spot *p)
{
	bool ok = !p->broken && p->colour.s >= 0;

	for (int k = 0; k < 4; k++)
		ok &= p->mine[k].s >= 0 && p->theirs[k].s >= 0;
	return ok;
}

/* The mean of a picture in which everything is finite and nothing negative. */
static double check(struct gd_scene *scene, int spp)
{
	const float ratio[] = { 20, INFINITY };
	double sum = 0;

	for (int k = 0; k < 2; k++) {
		const struct shot s = picture(scene, spp, ratio[k]);

		sum = 0;
		for (int i = 0; i < W * H; i++) {
			assert_true(sound(&s.spot[i]));
			sum += mean(s.spot[i].colour) / (W * H);
		}
		free(s.spot);
	}
	gd_scene_free(scene);
	return sum;
}

#define NO_MAPS                                                                                    \
	.base_map = GD_NO_INDEX, .rough_map = GD_NO_INDEX, .emission_map = GD_NO_INDEX

static const struct room ROOMS[] = {
	{ .floor = { .base = { 0.7f, 0.7f, 0.7f }, .roughness = 0.4f, .ior = 1.5f, NO_MAPS },
	  .ball = { .base = { 1, 1, 1 }, .roughness = 0.15f, .ior = 1.5f, .transmission = 1,
		    NO_MAPS },
	  .light = LAMP },
	{ .floor = { .base = { 0.7f, 0.7f, 0.7f }, .roughness = 0.1f, .metallic = 1, .ior = 1.5f,
		     NO_MAPS },
	  .ball = { .base = { 1, 1, 1 }, .roughness = 0, .ior = 1.5f, .transmission = 1, NO_MAPS },
	  .light = LAMP | MAP, .lens = 0.05f },
};

static void resize(struct gd_scene *s, float k)
{
	for (size_t i = 0; i < s->nvertex; i++)
		s->vertex[i] = gd_scale(s->vertex[i], k);
	for (size_t i = 0; i < s->nlight; i++) {
		s->light[i].position = gd_scale(s->light[i].position, k);
		if (s->light[i].kind == GD_POINT || s->light[i].kind == GD_SPOT)
			s->light[i].intensity = gd_scale(s->light[i].intensity, k * k);
	}
	s->view.origin = gd_scale(s->view.origin, k);
	s->view.lens *= k;
	s->view.focus *= k;
}

static void brighten(struct gd_scene *s, float k)
{
	for (size_t i = 0; i < s->nmaterial; i++)
		s->material[i].emission = gd_scale(s->material[i].emission, k);
	for (size_t i = 0; i < s->nlight; i++)
		s->light[i].intensity = gd_scale(s->light[i].intensity, k);
	for (int i = 0; i < s->environment.w * s->environment.h * 3; i++)
		s->environment.rgb[i] *= k;
}

static struct gd_scene *room_in_units(const struct room *r, float length, float light)
{
	struct gd_scene *s = room_start(r);

	resize(s, length);
	brighten(s, light);
	return finished(s);
}

/* Sizes and brightness are units: the picture is the same but for them. */
static void test_units_do_not_matter(void **state)
{
	const float size[] = { 1e6f, 1e-6f, 1000 }, light[] = { 1e30f, 1e-30f };

	(void)state;
	for (int r = 0; r < 2; r++) {
		const double truth = check(room_in_units(&ROOMS[r], 1, 1), 64);

		for (int k = 0; k < 3; k++) {
			const double m = check(room_in_units(&ROOMS[r], size[k], 1), 64);

			if (!(fabs(m / truth - 1) < 0.01))
				fail_msg("size %g: %.5f, should be %.5f", (double)size[k], m,
					 truth);
		}
		for (int k = 0; k < 2; k++) {
			const double m =
				check(room_in_units(&ROOMS[r], 1, light[k]), 64) / (double)light[k];

			if (!(fabs(m / truth - 1) < 0.001))
				fail_msg("light %g: %.5f, should be %.5f", (double)light[k], m,
					 truth);
		}
	}
}

/* As bright as floats can be. */
static void test_blinding_light_stays_finite(void **state)
{
	(void)state;
	for (int r = 0; r < 2; r++)
		check(room_in_units(&ROOMS[r], 1, 5e37f), 16);
}

/* --- odd scenes: each is the room with something in it --- */

static void lamp_in_the_floor(struct gd_scene *s)
{
	add_quad(s, gd_v3(-0.5f, 0, 0.5f), gd_v3(0.6f, 0, 0), gd_v3(0, 0, -0.6f),
		 add_material(s, lamp(2)));
}

static void lamp_standing_on_the_floor(struct gd_scene *s)
{
	add_quad(s, gd_v3(-0.5f, 0, 0.5f), gd_v3(0.6f, 0, 0), gd_v3(0, 0.3f, 0),
		 add_material(s, lamp(2)));
}

static void lamp_edge_on(struct gd_scene *s)
{
	add_quad(s, gd_v3(1.5f, 0, 0.5f), gd_v3(2, 0, 0), gd_v3(0, 0, -1),
		 add_material(s, lamp(500)));
}

static void walls_twice(struct gd_scene *s)
{
	const size_t n = s->ntriangle;

	for (size_t i = 0; i < n; i++)
		add_triangle(s, s->triangle[i].vertex[0], s->triangle[i].vertex[1],
			     s->triangle[i].vertex[2], (s->triangle[i].material + 1) % 4);
}

static void slivers(struct gd_scene *s)
{
	const uint32_t m = add_material(s, lamp(3));
	const uint32_t a = add_vertex(s, gd_v3(-0.5f, 0.2f, 0.4f), gd_v3(0, 0, 0));
	const uint32_t b = add_vertex(s, gd_v3(0.5f, 0.2f, 0.4f), gd_v3(0, 0, 0));
	const uint32_t c = add_vertex(s, gd_v3(0.1f, 0.2000001f, 0.4f), gd_v3(0, 0, 0));

	add_triangle(s, a, b, c, m);
	add_triangle(s, a, a, b, m);
	add_triangle(s, a, a, a, m);
	add_triangle(s, a, b, c, 0);
}

static void normals_anywhere(struct gd_scene *s)
{
	for (size_t i = 0; i < s->nvertex; i++) {
		const double t = (double)i * 1.7, z = cos((double)i * 0.9);

		s->normal[i] = gd_v3((float)(sqrt(1 - z * z) * cos(t)), (float)z,
				     (float)(sqrt(1 - z * z) * sin(t)));
		if (i % 7 == 0)
			s->normal[i] = gd_v3(0, 0, 0);
	}
}

static void lights_on_surfaces(struct gd_scene *s)
{
	add_point(s, gd_v3(0.2f, 0, 0.3f), 1);
	add_point(s, s->view.origin, 1);
	add_spot(s, gd_v3(0.5f, 0, 0.5f), gd_v3(0.5f, 1, 0.5f), 0, 0, 1);
	add_sun(s, gd_v3(1, 0, 0), 1);
}

static void camera_in_the_floor(struct gd_scene *s)
{
	s->view.origin = gd_v3(0.5f, 0, 0.5f);
	s->view.lens = 0.2f;
}

static void camera_in_the_ball(struct gd_scene *s)
{
	s->view.origin = gd_v3(0.15f, 0.35f, -0.1f);
}

static void camera_looks_at_the_lamp(struct gd_scene *s)
{
	look_at(s, gd_v3(0.35f, 1.39999f, -0.25f), gd_v3(0.35f, 1.5f, -0.25f), 0.4f, 1);
}

static void materials_out_of_range(struct gd_scene *s)
{
	s->material[0].base = gd_v3(3, NAN, -1);
	s->material[0].roughness = -2;
	s->material[1].ior = INFINITY;
	s->material[1].metallic = NAN;
	s->material[2].transmission = 7;
	s->material[3].ior = 0.2f;
}

static void test_odd_scenes_stay_finite(void **state)
{
	void (*const odd[])(struct gd_scene *) = {
		lamp_in_the_floor, lamp_standing_on_the_floor, lamp_edge_on, walls_twice, slivers,
		normals_anywhere, lights_on_surfaces, camera_in_the_floor, camera_in_the_ball,
		camera_looks_at_the_lamp, materials_out_of_range,
	};

	(void)state;
	for (size_t i = 0; i < sizeof odd / sizeof odd[0]; i++)
		for (int r = 0; r < 2; r++) {
			struct gd_scene *s = room_start(&ROOMS[r]);

			odd[i](s);
			check(finished(s), 32);
		}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_units_do_not_matter),
		cmocka_unit_test(test_blinding_light_stays_finite),
		cmocka_unit_test(test_odd_scenes_stay_finite),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
