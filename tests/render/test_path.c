/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Radiance that is known otherwise: furnaces, closed forms of light on a point, form factors,
 * quadrature in double precision from the equations alone. Limits are in standard errors, which
 * must be small beside the number itself, and a share of it for the camera's rounding.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <cmocka.h>

#include "../support/render_room.h"
#include "../support/render_shot.h"

#define SIGMA 4.5
#define SIDE 8		/* pixels */

struct measure {
	double value, error;
};

static struct measure measure_as(struct gd_scene *scene, int depth, int spp, bool mis)
{
	struct shot s = { .w = SIDE, .h = SIDE, .scene = scene, .spp = spp + 1, .seed = 5 };
	struct measure m = { 0, 0 };

	s.conf = (struct gd_path_conf){ .depth = depth, .shift_ratio = 20, .mis = mis };
	shoot(&s);
	for (int i = 0; i < SIDE * SIDE; i++) {
		assert_false(s.spot[i].broken);
		m.value += mean(s.spot[i].colour) / (SIDE * SIDE);
		m.error += variance(s.spot[i].colour) / pow(SIDE, 4);
	}
	m.error = sqrt(m.error);
	free(s.spot);
	return m;
}

/* Mean of the image of a scene, which is freed. */
static struct measure measure(struct gd_scene *scene, int depth, int spp)
{
	const struct measure m = measure_as(scene, depth, spp, true);

	gd_scene_free(scene);
	return m;
}

static void expect(struct measure m, double truth, double slack, const char *what, double where)
{
	if (getenv("SHOW"))
		print_message("%s (%g): %.6f +- %.6f, should be %.6f\n", what, where, m.value,
			      m.error, truth);
	if (!(fabs(m.value - truth) <= SIGMA * m.error + slack * fabs(truth)))
		fail_msg("%s (%g): %.6f +- %.6f, should be %.6f", what, where, m.value, m.error,
			 truth);
	if (!(m.error <= 0.01 * fabs(truth)))
		fail_msg("%s (%g): an error of %.6f says nothing of %.6f", what, where, m.error,
			 truth);
}

/* All pixels look at one point. */
static struct gd_scene *peer(struct gd_scene *s, struct gd_v3 from, struct gd_v3 to)
{
	look_at(s, from, to, 1e-5f, 1);
	return finished(s);
}

/* --- furnaces --- */

static void test_closed_furnace_has_the_geometric_sum(void **state)
{
	const int depth[] = { 1, 2, 3, 6, 255 };
	const double e = 0.5, a = 0.6;

	(void)state;
	for (size_t i = 0; i < 5; i++) {
		struct gd_scene *s = scene_new();
		struct gd_material m = matter((float)a);

		m.emission = gd_v3(0.5f, 0.5f, 0.5f);
		const uint32_t k = add_material(s, m), six[6] = { k, k, k, k, k, k };

		add_box(s, gd_v3(-1, -1, -1), gd_v3(1, 2, 3), six, true);
		look_at(s, gd_v3(0.2f, 0, 0), gd_v3(1, 0.3f, 0.4f), 0.5f, 1);
		expect(measure(finished(s), depth[i], 600), e * (1 - pow(a, depth[i])) / (1 - a),
		       1e-5, "furnace", depth[i]);
	}
}

/* Nothing is lost at an object of albedo 1 under a sky of 1. */
static void test_white_objects_vanish(void **state)
{
	const struct gd_material m[] = { matter(1), metal(1, 0), glass(0), glass(0.02f) };

	(void)state;
	for (size_t i = 0; i < 5; i++) {
		struct gd_scene *s = scene_new();
		struct gd_material last = glass(0.5f);

		last.ior = 1;
		const uint32_t k = add_material(s, i < 4 ? m[i] : last),
			       six[6] = { k, k, k, k, k, k };

		if (i & 1)
			add_ball(s, gd_v3(0, 0, 0), 1, 8, false, k);
		else
			add_box(s, gd_v3(-1, -1, -1), gd_v3(1, 1, 1), six, false);
		add_sky(s, 1);
		look_at(s, gd_v3(2, 1.5f, 4), gd_v3(0, 0, 0), 0.2f, 1);
		expect(measure(finished(s), 255, 200), 1, 1e-5, "white object", (double)i);
	}
}

/* Reflectance of a dielectric by Fresnel's equations; eta: far index over near. */
static double fresnel(double c, double eta)
{
	const double s2 = (1 - c * c) / (eta * eta);

	if (eta == 1)
		return 0;
	if (s2 >= 1)
		return 1;
	const double t = sqrt(1 - s2), rs = (c - eta * t) / (c + eta * t);
	const double rp = (eta * c - t) / (eta * c + t);

	return 0.5 * (rs * rs + rp * rp);
}

static double lambda(double a, double c)
{
	return 0.5 * (sqrt(1 + a * a * (1 / (c * c) - 1)) - 1);
}

/*
 * Share of light from everywhere that a material of grey base sends to cosine c, by Walter's
 * normals: the mean over u, v of what each microfacet of that slope adds.
 */
static double albedo(const struct gd_material *m, double c, bool inside)
{
	const int n = 600;
	const double r = (double)m->roughness, a = r * r, base = (double)m->base.x;
	const double metallic = (double)m->metallic,
		     pass = (1 - metallic) * (double)m->transmission;
	const double eta = inside && pass > 0 ? 1 / (double)m->ior : (double)m->ior,
		     so = sqrt(1 - c * c);
	const double diffuse = (1 - metallic) * (1 - (double)m->transmission) * base;
	double sum = 0, even = 0;

	for (int i = 0; i < n; i++)
		for (int j = 0; j < n; j++) {
			/* du = 2 left: even steps at u = 1 */
			const double left = (i + 0.5) / n, u = 1 - left * left;
			const double t2 = a * a * u / (1 - u), hz = 1 / sqrt(1 + t2);
			const double hx = sqrt(t2) * hz * cos(2 * PI_ * (j + 0.5) / n);
			const double oh = so * hx + c * hz, d = oh > 0 ? fresnel(oh, eta) : 0;
			const double f = (1 - metallic) * d +
					 metallic * (base + (1 - base) * pow(1 - oh, 5));
			const double iz = 2 * oh * hz - c, w = 2 * left * oh / (c * hz);
			const double tz =
				c / eta -
				(oh / eta - sqrt(fmax(1 - (1 - oh * oh) / eta / eta, 0))) * hz;

			if (oh <= 0)
				continue;
			if (iz > 0)
				sum += f * w / (1 + lambda(a, c) + lambda(a, iz));
			if (d < 1 && tz > 0)
				sum += pass * base * (1 - d) * w /
				       (1 + lambda(a, c) + lambda(a, tz));
		}
	for (int i = 0; i < 10000; i++) {
		const double z = (i + 0.5) / 10000;

		even += 2 * z * (1 - fresnel(z, eta)) / 10000;
	}
	return sum / (n * n) + diffuse * (1 - fresnel(c, eta)) * even;
}

static struct gd_material blend(float metallic, float transmission, float roughness)
{
	struct gd_material m = plastic(0.6f, roughness);

	m.metallic = metallic;
	m.transmission = transmission;
	return m;
}

static void test_surface_under_an_even_sky_has_its_albedo(void **state)
{
	const struct gd_material m[] = {
		plastic(0.8f, 1), plastic(0.8f, 0.5f), plastic(0.8f, 0.2f), metal(0.9f, 0.8f),
		metal(0.5f, 0.4f), metal(0.9f, 0.15f), glass(0.9f), glass(0.4f), glass(0.15f),
		blend(0.5f, 0, 0.5f), blend(0, 0.5f, 0.3f), blend(0.3f, 0.6f, 0.6f),
		blend(0.3f, 0.6f, 0.2f),
	};
	const double angle[] = { 0.2, 1.0, 1.35 };

	(void)state;
	for (size_t i = 0; i < sizeof m / sizeof m[0]; i++)
		for (int k = 0; k < 6; k++) {
			const double t = angle[k % 3], side = k < 3 ? 1 : -1;
			struct gd_scene *s = scene_new();

			add_quad(s, gd_v3(-1, 0, 1), gd_v3(2, 0, 0), gd_v3(0, 0, -2),
				 add_material(s, m[i]));
			add_sky(s, 1);
			peer(s, gd_v3((float)sin(t), (float)(side * cos(t)), 0), gd_v3(0, 0, 0));
			expect(measure(s, 2, 1200), albedo(&m[i], cos(t), k >= 3), 1e-3, "albedo",
			       (double)i + 0.1 * k);
		}
}

/* --- light on a point --- */

/*
 * Form factor from a small surface at p of normal n to a convex polygon above its horizon
 * (Lambert's formula).
 */
static double to_polygon(struct gd_v3 p, struct gd_v3 n, const struct gd_v3 *v, int corners)
{
	double sum = 0;

	for (int k = 0; k < corners; k++) {
		const struct gd_v3 a = gd_unit(gd_sub(v[k], p));
		const struct gd_v3 b = gd_unit(gd_sub(v[(k + 1) % corners], p)), x = gd_cross(a, b);
		const double s = (double)gd_length(x), c = (double)gd_dot(a, b);

		if (s > 0)
			sum += atan2(s, c) * (double)gd_dot(x, n) / s;
	}
	return fabs(sum) / (2 * PI_);
}

static void test_rectangle_lights_a_point(void **state)
{
	const struct gd_v3 at[3] = { { 0, 0, 0 }, { 0.7f, 0, -0.3f }, { -2, 0, 1 } };
	const struct gd_v3 e[3] = { { 0.8f, 0, 0 }, { 0, 0.9f, 0.2f }, { 0.5f, 0.6f, -0.4f } };
	const struct gd_v3 o = { 0.4f, 0.5f, -0.2f }, f = { 0.1f, 0, 0.7f };

	(void)state;
	for (int i = 0; i < 9; i++) {
		const struct gd_v3 d = e[i / 3], p = at[i % 3];
		const struct gd_v3 v[4] = { o, gd_add(o, d), gd_add(gd_add(o, d), f),
					    gd_add(o, f) };
		struct gd_scene *s = scene_new();

		add_quad(s, gd_v3(-5, 0, 5), gd_v3(10, 0, 0), gd_v3(0, 0, -10),
			 add_material(s, matter(0.5f)));
		add_quad(s, o, d, f, add_material(s, lamp(3)));
		peer(s, gd_add(p, gd_v3(-0.02f, 0.1f, 0.05f)), p);
		expect(measure(s, 2, 1000), 1.5 * to_polygon(p, gd_v3(0, 1, 0), v, 4), 1e-4,
		       "rectangle", i);
	}
}

static struct gd_scene *floor_alone(void)
{
	struct gd_scene *s = scene_new();

	add_quad(s, gd_v3(-5, 0, 5), gd_v3(10, 0, 0), gd_v3(0, 0, -10),
		 add_material(s, matter(0.5f)));
	return s;
}

static struct measure seen_at_origin(struct gd_scene *s, int spp)
{
	return measure(peer(s, gd_v3(0.1f, 0.3f, -0.2f), gd_v3(0, 0, 0)), 2, spp);
}

static void test_points_spots_and_suns_light_a_point(void **state)
{
	const struct gd_v3 at = { 0.4f, 0.8f, -0.3f };
	const double d2 = 0.16 + 0.64 + 0.09, direct = 0.5 / PI_ * 0.8 / (d2 * sqrt(d2));
	const double angle[] = { 0.1, 0.35, 0.5 };
	struct gd_scene *s = floor_alone();

	(void)state;
	add_point(s, at, 7);
	expect(seen_at_origin(s, 4), 7 * direct, 1e-5, "point", 0);
	s = floor_alone();
	add_sun(s, gd_scale(at, -1), 7);
	expect(seen_at_origin(s, 4), 7 * 0.5 / PI_ * 0.8 / sqrt(d2), 1e-5, "sun", 0);
	for (int i = 0; i < 3; i++) {	/* aside by an angle: full, partly, not at all */
		const double c = (cos(angle[i]) - cos(0.4)) / (cos(0.3) - cos(0.4));
		const double part = fmin(fmax(c, 0), 1);
		const struct gd_v3 down = gd_unit(gd_scale(at, -1));
		const struct gd_v3 aside = gd_unit(gd_cross(down, gd_v3(0, 1, 0)));
		const struct gd_v3 aim = gd_add(gd_scale(down, (float)cos(angle[i])),
						gd_scale(aside, (float)sin(angle[i])));

		s = floor_alone();
		add_spot(s, at, gd_add(at, aim), 0.3f, 0.4f, 7);
		if (part > 0)
			expect(seen_at_origin(s, 4), 7 * direct * part * part, 2e-4, "spot",
			       angle[i]);
		else
			assert_true(seen_at_origin(s, 4).value == 0);
	}
}

/* Several lights of all kinds add up. */
static void test_lights_add_up(void **state)
{
	struct gd_scene *s = floor_alone();
	double sum = 0;

	(void)state;
	for (int i = 0; i < 7; i++) {
		struct gd_scene *one = floor_alone();

		for (int k = 0; k < 2; k++) {
			struct gd_scene *to = k ? one : s;

			if (i < 3)
				add_point(to, gd_v3(0.3f * (float)i, 0.5f, 0.2f), 0.3f);
			else if (i == 3)
				add_sun(to, gd_v3(1, -2, 0), 2);
			else if (i == 4)
				add_sky(to, 0.4f);
			else
				add_quad(to, gd_v3(-1, (float)i - 4, -1), gd_v3(0.5f, 0, 0),
					 gd_v3(0, 0, 0.5f), add_material(to, lamp(4)));
		}
		sum += seen_at_origin(one, 2000).value;
	}
	expect(seen_at_origin(s, 3000), sum, 2e-3, "lights", 7);
}

static void test_sky_lights_a_point(void **state)
{
	const int n = 512;
	struct gd_scene *s = floor_alone();
	double sum = 0;

	(void)state;
	add_sky_map(s, 64);
	peer(s, gd_v3(0.1f, 0.3f, -0.2f), gd_v3(0, 0, 0));
	for (int i = 0; i < n; i++)
		for (int k = 0; k < 4 * n; k++) {
			const double z = (i + 0.5) / n, r = sqrt(1 - z * z),
				     p = PI_ * (k + 0.5) / (2 * n);
			const struct gd_v3 d =
				gd_v3((float)(r * cos(p)), (float)z, (float)(r * sin(p)));

			sum += (double)gd_luma(gd_environment_at(s, d)) * z;
		}
	expect(measure(s, 2, 1500), 0.5 * 2 * sum / (4.0 * n * n), 1e-3, "sky", 0);
}

/* --- form factors --- */

/* Unit squares face to face at distance 1, and at
 * right angles along an edge (Howell's catalogue). */
static void test_squares_have_their_form_factors(void **state)
{
	const double r2 = sqrt(2);
	const double facing = 2 / PI_ * (log(sqrt(4.0 / 3)) + 2 * r2 * atan(1 / r2) - 2 * atan(1));
	const double edge = (2 * atan(1) - r2 * atan(1 / r2) + 0.25 * log(0.75)) / PI_;

	(void)state;
	assert_true(fabs(facing - 0.199825) < 1e-6 && fabs(edge - 0.200044) < 1e-6);
	for (int i = 0; i < 2; i++) {
		struct gd_scene *s = scene_new();
		const uint32_t light = add_material(s, lamp(2));

		add_quad(s, gd_v3(0, 0, 1), gd_v3(1, 0, 0), gd_v3(0, 0, -1),
			 add_material(s, matter(0.5f)));
		if (i)
			add_quad(s, gd_v3(0, 0, 0), gd_v3(1, 0, 0), gd_v3(0, 1, 0), light);
		else
			add_quad(s, gd_v3(0, 1, 0), gd_v3(1, 0, 0), gd_v3(0, 0, 1), light);
		look_at(s, gd_v3(0.5f, 0.5f, 0.5f), gd_v3(0.5f, 0, 0.5f), 1, 1);
		expect(measure(finished(s), 2, 1500), i ? edge : facing, 1e-4, "squares", i);
	}
}

/* Irradiance over L at p of normal n in the unit cube, from its ceiling y = 1. */
static double from_ceiling(struct gd_v3 p, struct gd_v3 n)
{
	const struct gd_v3 v[4] = { { 0, 1, 0 }, { 1, 1, 0 }, { 1, 1, 1 }, { 0, 1, 1 } };

	return PI_ * to_polygon(p, n, v, 4);
}

/* A cube whose ceiling shines: light that bounced once at the walls, at a point of the floor. */
static void test_one_bounce_in_a_box(void **state)
{
	const struct gd_v3 p = { 0.4f, 0, 0.7f };
	const int n = 200;
	const double a = 0.5;
	double bounced = 0;
	struct gd_scene *s = scene_new();
	const uint32_t wall = add_material(s, matter((float)a)), light = add_material(s, lamp(1));
	const uint32_t six[6] = { wall, wall, wall, light, wall, wall };

	(void)state;
	for (int k = 0; k < 4; k++)	/* x = 0, x = 1, z = 0, z = 1 */
		for (int i = 0; i < n * n; i++) {
			const float u = ((float)(i % n) + 0.5f) / (float)n,
				    y = ((float)(i / n) + 0.5f) / (float)n;
			const float at = (float)(k & 1);
			const struct gd_v3 q = k < 2 ? gd_v3(at, y, u) : gd_v3(u, y, at);
			const struct gd_v3 m =
				k < 2 ? gd_v3(1 - 2 * at, 0, 0) : gd_v3(0, 0, 1 - 2 * at);
			const struct gd_v3 d = gd_sub(q, p);
			const double d2 = (double)gd_dot(d, d);

			bounced += a / PI_ * from_ceiling(q, m) * (double)d.y *
				   fabs((double)gd_dot(d, m)) / (d2 * d2) / (n * n);
		}
	add_box(s, gd_v3(0, 0, 0), gd_v3(1, 1, 1), six, true);
	peer(s, gd_v3(0.45f, 0.4f, 0.6f), p);
	expect(measure(s, 3, 3000), a / PI_ * (from_ceiling(p, gd_v3(0, 1, 0)) + bounced), 3e-4,
	       "bounce", 0);
}

/* --- mirrors, panes, lenses --- */

static void test_mirrors_reflect_by_their_angle(void **state)
{
	const double angle[] = { 0.1, 0.8, 1.3 };

	(void)state;
	for (int i = 0; i < 6; i++) {
		const double t = angle[i % 3], c = cos(t);
		const struct gd_v3 up = gd_v3((float)sin(t), (float)c, 0);
		struct gd_scene *s = scene_new();

		add_quad(s, gd_v3(-1, 0, 1), gd_v3(2, 0, 0), gd_v3(0, 0, -2),
			 add_material(s, i < 3 ? metal(0.6f, 0) : plastic(0, 0)));
		add_quad(s, gd_v3(-40, 3, -2), gd_v3(80, 0, 0), gd_v3(0, 0, 4),
			 add_material(s, lamp(1)));
		peer(s, up, gd_v3(0, 0, 0));
		expect(measure(s, 3, 400), i < 3 ? 0.6 + 0.4 * pow(1 - c, 5) : fresnel(c, 1.5),
		       1e-4, "mirror", t);
	}
}

static void test_pane_lets_through_what_two_faces_leave(void **state)
{
	const double angle[] = { 0.1, 0.8, 1.2 };

	(void)state;
	for (int i = 0; i < 3; i++) {
		const double r = fresnel(cos(angle[i]), 1.5);
		struct gd_scene *s = scene_new();
		const uint32_t pane = add_material(s, glass(0));

		add_quad(s, gd_v3(-9, 0, 9), gd_v3(18, 0, 0), gd_v3(0, 0, -18), pane);
		add_quad(s, gd_v3(-9, -0.1f, -9), gd_v3(18, 0, 0), gd_v3(0, 0, 18), pane);
		add_quad(s, gd_v3(-40, -3, -40), gd_v3(80, 0, 0), gd_v3(0, 0, 80),
			 add_material(s, lamp(1)));
		peer(s, gd_v3((float)sin(angle[i]), (float)cos(angle[i]), 0), gd_v3(0, 0, 0));
		expect(measure(s, 255, 800), (1 - r) / (1 + r), 1e-4, "pane", angle[i]);
	}
}

/* The edge of a lamp out of focus: the share of the lens that sees the lamp, in every column. */
static void test_lens_blurs_as_its_disc_says(void **state)
{
	const double lens = 0.2, focus = 2, distance = 3, width = 0.3;
	struct gd_scene *s = scene_new();
	struct shot a = { .w = 16, .h = 12, .spp = 800, .seed = 3 };

	(void)state;
	add_quad(s, gd_v3(0, -9, (float)-distance), gd_v3(9, 0, 0), gd_v3(0, 18, 0),
		 add_material(s, lamp(1)));
	look_at(s, gd_v3(0, 0, 0), gd_v3(0, 0, -1), (float)width, 1);
	s->view.lens = (float)lens;
	s->view.focus = (float)focus;
	a.scene = finished(s);
	a.conf = (struct gd_path_conf){ .depth = 1, .shift_ratio = 20, .mis = true };
	shoot(&a);
	for (int x = 0; x < a.w; x++) {
		struct stat all = { 0 };
		double truth = 0;

		for (int k = 0; k < 1000; k++) {
			const double u = (2 * (x + (k + 0.5) / 1000) / a.w - 1) * width * distance;
			const double e = fmin(fmax(u / (lens * (distance / focus - 1)), -1), 1);

			truth += (0.5 + (asin(e) + e * sqrt(1 - e * e)) / PI_) / 1000;
		}
		for (int y = 0; y < a.h; y++)
			pool(&all, a.spot[y * a.w + x].colour);
		assert_true(fabs(mean(all) - truth) <= SIGMA * sqrt(variance(all)) + 1e-4);
	}
	free(a.spot);
	gd_scene_free(s);
}

/* --- the same by other means --- */

static void compare(const struct room *room, int spp)
{
	struct gd_scene *s = room_new(room);
	struct chi2 chi = { 0 };
	struct shot on = { .w = 16, .h = 12, .scene = s, .spp = spp, .seed = 1 }, off;
	double d = 0, v = 0, all = 0;

	on.conf = (struct gd_path_conf){ .depth = 6, .shift_ratio = 20, .mis = true };
	off = on;
	off.conf.mis = false;
	off.spp *= 4;
	off.seed = 2;
	shoot(&on);
	shoot(&off);
	for (int i = 0; i < on.w * on.h; i++) {
		const struct stat a = on.spot[i].colour, b = off.spot[i].colour;

		judge(&chi, mean(a) - mean(b), variance(a) + variance(b));
		d += mean(a) - mean(b);
		v += variance(a) + variance(b);
		all += mean(a);
	}
	if (getenv("SHOW"))
		print_message("mis: chi2 %.3f (worst %.1f), all %+.1f, error %.4f\n",
			      chi2_mean(chi), chi.worst, d / sqrt(v), sqrt(v) / all);
	assert_true(chi2_mean(chi) < 1.6);
	assert_true(fabs(d) < SIGMA * sqrt(v));
	assert_true(sqrt(v) < 0.03 * all);
	free(on.spot);
	free(off.spot);
	gd_scene_free(s);
}

static void test_light_sampling_changes_nothing(void **state)
{
	const struct room diffuse = { matter(0.7f), matter(0.4f), LAMP, 0 };
	const struct room glossy = { plastic(0.5f, 0.4f), metal(0.7f, 0.15f), LAMP | POINT, 0 };
	const struct room clear = { plastic(0.5f, 0.2f), glass(0.4f), LAMP | MAP | SUN, 0 };

	(void)state;
	compare(&diffuse, 400);
	compare(&glossy, 400);
	compare(&clear, 400);
}

/* Ambient light adds its sum in a closed grey box to the halves and nothing to the colour. */
static void test_ambient_light_stays_in_the_halves(void **state)
{
	const double a = 0.6;
	const int depth = 4;
	struct gd_scene *s = scene_new();
	struct gd_material m = matter((float)a);
	struct shot with = { .w = 6, .h = 6, .scene = s, .ring = NEXT, .spp = 400, .seed = 8 },
		    none;
	double sum = 0, v = 0, truth = 0;

	(void)state;
	m.emission = gd_v3(0.3f, 0.3f, 0.3f);
	const uint32_t k = add_material(s, m), six[6] = { k, k, k, k, k, k };

	add_box(s, gd_v3(-1, -1, -1), gd_v3(1, 1, 1), six, true);
	look_at(s, gd_v3(0.2f, 0, 0), gd_v3(1, 0.3f, 0.4f), 0.5f, 1);
	finished(s);
	with.conf = (struct gd_path_conf){ .depth = depth, .shift_ratio = 20, .mis = true };
	none = with;
	with.conf.ambient = 0.25f;
	shoot(&with);
	shoot(&none);
	for (int i = 0; i < 36; i++)
		assert_true(with.spot[i].colour.s == none.spot[i].colour.s);
	for (int y = 0; y < 6; y++)
		for (int x = 0; x < 5; x++) {
			const struct spot *p = &with.spot[y * 6 + x], *q = p + 1;

			sum += (mean(p->mine[0]) + mean(q->theirs[2])) / 30;
			v += (variance(p->mine[0]) + variance(q->theirs[2])) / 900;
		}
	for (int i = 1; i <= depth; i++)
		truth += 0.3 * pow(a, i - 1) + 0.25 * pow(a, i);
	v *= 4;		/* one pixel's samples are in two pairs */
	expect((struct measure){ sum, sqrt(v) }, truth, 1e-5, "ambient", 0);
	free(with.spot);
	free(none.spot);
	gd_scene_free(s);
}

/* First vertices that are handed over are those that a path finds by itself. */
static void test_first_vertices_are_shared(void **state)
{
	const struct room room = { plastic(0.5f, 0.4f), glass(0.2f), LAMP | MAP, 0 };
	const struct gd_path_conf conf = { .depth = 6, .shift_ratio = 20, .mis = true };
	struct gd_scene *s = room_new(&room);
	struct gd_vertex vertex[5];
	double all = 0, gap = 0;
	int misses = 0;

	(void)state;
	for (uint32_t i = 0; i < 16 * 12 * 20; i++) {
		const float at[2] = { 0.37f * (float)(i % 3), 0.04f * (float)(i % 25) };
		struct gd_path_in in = { .w = 16, .h = 12, .x = (int)i % 16, .y = (int)i / 16 % 12,
					 .n = 4, .dx = { 1, 0, -1, 0 }, .dy = { 0, 1, 0, -1 },
					 .r = { 1, 1, 1, 1 }, .at = at };
		struct gd_draw draw = gd_draw_start(7, 0, 0, i), again = draw;
		struct gd_path_out own, shared;

		gd_path_trace(s, &conf, &in, &draw, &own);
		for (int k = 0; k < 5; k++)
			gd_path_first(s, 16, 12, (float)(in.x + (k ? in.dx[k - 1] : 0)) + at[0],
				      (float)(in.y + (k ? in.dy[k - 1] : 0)) + at[1], &vertex[k]);
		in.first = &vertex[0];
		for (int k = 0; k < 4; k++)
			in.others[k] = &vertex[k + 1];
		misses += vertex[0].miss;
		gd_path_trace(s, &conf, &in, &again, &shared);
		assert_memory_equal(&own.colour, &shared.colour, sizeof own.colour);
		assert_memory_equal(&own.normal, &shared.normal, sizeof own.normal);
		assert_true(own.z == shared.z);
		/* rays one by one and rays in fours may round differently */
		for (int k = 0; k < 4; k++) {
			gap += (double)gd_length(gd_sub(own.half[k], shared.half[k]));
			all += (double)gd_length(own.half[k]);
		}
	}
	assert_true(misses > 100);
	assert_true(gap < 1e-3 * all);
	gd_scene_free(s);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_closed_furnace_has_the_geometric_sum),
		cmocka_unit_test(test_white_objects_vanish),
		cmocka_unit_test(test_surface_under_an_even_sky_has_its_albedo),
		cmocka_unit_test(test_rectangle_lights_a_point),
		cmocka_unit_test(test_points_spots_and_suns_light_a_point),
		cmocka_unit_test(test_lights_add_up),
		cmocka_unit_test(test_sky_lights_a_point),
		cmocka_unit_test(test_squares_have_their_form_factors),
		cmocka_unit_test(test_one_bounce_in_a_box),
		cmocka_unit_test(test_mirrors_reflect_by_their_angle),
		cmocka_unit_test(test_pane_lets_through_what_two_faces_leave),
		cmocka_unit_test(test_lens_blurs_as_its_disc_says),
		cmocka_unit_test(test_light_sampling_changes_nothing),
		cmocka_unit_test(test_ambient_light_stays_in_the_halves),
		cmocka_unit_test(test_first_vertices_are_shared),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
