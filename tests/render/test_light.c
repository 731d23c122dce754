/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Lights: densities against integrals and solid angles known in closed form, samples against rays,
 * chances against counts, environments against sums over their pixels.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <stdio.h>

#include "render/impl.h"
#include "scene_make.h"

static void finish(struct gd_scene *s)
{
	struct gd_err err = { 0 };

	if (gd_scene_finish(s, &err) != GD_OK)
		fail_msg("%s", err.text);
}

/* |got - want| within 5 standard errors of a mean of n with that sum of squares. */
static void near_mean(const char *what, double sum, double squares, int n, double want)
{
	const double mean = sum / n, var = fmax(squares / n - mean * mean, 0);
	const double error = sqrt(var / n) + 1e-6 * fabs(want);

	if (!(fabs(mean - want) < 5 * error))
		fail_msg("%s: %g, wanted %g, standard error %g", what, mean, want, error);
}

static bool close_to(double a, double b, double tolerance)
{
	return fabs(a - b) <= tolerance * (fabs(a) + fabs(b));
}

/* Solid angle of a triangle (Van Oosterom and Strackee 1983). */
static double solid_angle(struct gd_v3 p, const struct gd_v3 v[3])
{
	const struct gd_v3 a = gd_sub(v[0], p), b = gd_sub(v[1], p), c = gd_sub(v[2], p);
	const double x = (double)gd_length(a), y = (double)gd_length(b), z = (double)gd_length(c);
	const double above = fabs((double)gd_dot(a, gd_cross(b, c)));
	const double below = x * y * z + (double)gd_dot(a, b) * z + (double)gd_dot(b, c) * x +
			     (double)gd_dot(c, a) * y;

	return 2 * atan2(above, below);
}

static const struct gd_v3 corner[3] = { { -1, 2, 0.3f },
					{ 1.5f, 2.2f, -0.4f },
					{ 0.2f, 1.8f, 1.3f } };

static struct gd_scene *one_triangle(void)
{
	struct gd_scene *s = scene_new(1, 3);

	scene_add(s, corner[0], corner[1], corner[2], 0);
	s->material[0].emission = gd_v3(1, 2, 4);
	finish(s);
	return s;
}

/* The density integrates to 1, and its inverse to the solid angle. */
static void area_density(void **state)
{
	struct gd_scene *s = one_triangle();
	const struct gd_v3 p = gd_v3(0.1f, 0.2f, 0.3f);
	double sum = 0, squares = 0, inverse = 0, inverse2 = 0;
	const int n = 100000;

	(void)state;
	assert_int_equal(s->nlight, 1);
	assert_true(s->light[0].chance == 1);
	for (int i = 0; i < n; i++) {
		const struct gd_v3 d = rnd_direction();
		struct gd_light_sample l;
		struct gd_hit hit;
		double pdf = 0;

		if (gd_ray_hit(s, p, d, &hit))
			pdf = 4 * PI * (double)gd_light_pdf(s, &hit, d);
		sum += pdf;
		squares += pdf * pdf;
		assert_true(gd_light_sample(s, p, (float)rnd(), (float)rnd(), (float)rnd(), &l));
		inverse += 1 / (double)l.pdf;
		inverse2 += 1 / ((double)l.pdf * (double)l.pdf);
	}
	near_mean("integral of the density", sum, squares, n, 1);
	near_mean("solid angle", inverse, inverse2, n, solid_angle(p, corner));
	gd_scene_free(s);
}

/* A ray along the sample finds the same light, density and radiance; from both sides. */
static void sample_and_ray(void **state)
{
	struct gd_scene *s = scene_new(20, 60);
	int tries = 0;

	(void)state;
	for (int i = 0; i < 20; i++) {
		const struct gd_v3 c = gd_scale(rnd_direction(), 3);

		scene_add(s, gd_mad(c, 0.7f, rnd_direction()), gd_mad(c, 0.7f, rnd_direction()),
			  gd_mad(c, 0.7f, rnd_direction()), (uint32_t)(i % 3));
	}
	s->material[0].emission = gd_v3(1, 2, 4);
	s->material[1].emission = gd_v3(0, 0, 0.01f);
	finish(s);
	assert_int_equal(s->nlight, 14);
	for (int i = 0; i < 20000; i++) {
		const struct gd_v3 p = gd_scale(rnd_direction(), (float)(6 * rnd()));
		struct gd_light_sample l;
		struct gd_hit hit;

		if (!gd_light_sample(s, p, (float)rnd(), (float)rnd(), (float)rnd(), &l))
			continue;
		assert_true(l.pdf > 0 && !l.delta && fabsf(gd_length(l.d) - 1) < 1e-6f);
		assert_true(gd_length(gd_sub(l.point, gd_mad(p, l.t, l.d))) < 1e-5f * (1 + l.t));
		if (!gd_ray_free(s, p, l.d, l.t) || fabsf(gd_dot(l.d, l.normal)) < 0.05f)
			continue;
		if (!gd_ray_hit(s, p, l.d, &hit) ||
		    hit.triangle != s->light[l.light].triangle)
			continue;	/* at an edge */
		tries++;
		assert_true(close_to((double)gd_light_pdf(s, &hit, l.d), (double)l.pdf, 1e-4));
		assert_true(gd_light_emitted(s, &hit).z == l.radiance.z);
		assert_int_equal(s->triangle[hit.triangle].light, l.light);
	}
	assert_true(tries > 10000);
	/* what does not emit is no light */
	for (size_t i = 0; i < s->ntriangle; i++)
		assert_int_equal(s->triangle[i].light != GD_NO_INDEX, s->triangle[i].material < 2);
	gd_scene_free(s);
}

/* One light of each kind, and a sky. */
static struct gd_scene *all_kinds(void)
{
	struct gd_scene *s = one_triangle();
	const struct gd_light given[3] = {
		{ .kind = GD_POINT, .position = { 0, 3, 0 }, .intensity = { 5, 6, 7 } },
		{ .kind = GD_SPOT, .position = { 1, 4, 0 }, .direction = { 0, -1, 0 },
		  .intensity = { 9, 9, 9 }, .cos_inner = 0.9f, .cos_outer = 0.7f },
		{ .kind = GD_DIRECTIONAL, .direction = { 0, -0.6f, 0.8f },
		  .intensity = { 0.5f, 0.4f, 0.3f } },
	};

	gd_ray_drop(s);
	free(s->light);
	free(s->light_cdf);
	s->light = calloc(3, sizeof(*s->light));
	memcpy(s->light, given, sizeof(given));
	s->nlight = 3;
	s->environment.constant = gd_v3(0.1f, 0.2f, 0.3f);
	finish(s);
	assert_int_equal(s->nlight, 5);
	return s;
}

/* A choice that picks light i. */
static float choice_of(const struct gd_scene *s, size_t i)
{
	return s->light_cdf[i];
}

/* again() from the same point gives the same bits, from another what sampling there would give. */
static void again(void **state)
{
	struct gd_scene *s = all_kinds();

	(void)state;
	for (int i = 0; i < 5000; i++) {
		const struct gd_v3 p = gd_scale(rnd_direction(), (float)(3 * rnd())),
				   q = gd_scale(rnd_direction(), (float)(3 * rnd()));
		const float c = choice_of(s, (size_t)i % 5), u = (float)rnd(), v = (float)rnd();
		struct gd_light_sample a, b, same, other;
		const bool fa = gd_light_sample(s, p, c, u, v, &a),
			   fb = gd_light_sample(s, q, c, u, v, &b);

		assert_int_equal(a.light, i % 5);
		assert_int_equal(gd_light_again(s, p, &a, &same), fa);
		if (fa)
			assert_memory_equal(&a, &same, sizeof(a));
		assert_int_equal(gd_light_again(s, q, &a, &other), fb);
		if (fb)
			assert_memory_equal(&b, &other, sizeof(b));
		else
			assert_true(other.pdf == 0);
	}
	gd_scene_free(s);
}

static void delta_lights(void **state)
{
	struct gd_scene *s = all_kinds();
	const struct gd_v3 p = gd_v3(0, -1, 0);
	struct gd_light_sample l;

	(void)state;
	assert_true(gd_light_sample(s, p, choice_of(s, 0), 0.3f, 0.3f, &l));
	assert_true(l.delta && l.d.y == 1 && l.t == 4 && l.pdf == s->light[0].chance);
	assert_true(close_to((double)l.radiance.y, 6. / 16, 1e-6));
	assert_true(gd_light_sample(s, p, choice_of(s, 2), 0.3f, 0.3f, &l));
	assert_true(l.delta && isinf(l.t) && l.pdf == s->light[2].chance);
	assert_true(l.d.y == 0.6f && l.d.z == -0.8f && l.radiance.x == 0.5f);
	/* the spot: full inside the inner cone, a square
	 * of a line between the cones, none outside */
	for (double x = 0; x < 3; x += 0.01) {
		const struct gd_v3 below = gd_v3((float)(1 + x), 3, 0);
		const double c = 1 / sqrt(1 + x * x), f = fmin(fmax((c - 0.7) / 0.2, 0), 1);
		const bool lit = gd_light_sample(s, below, choice_of(s, 1), 0, 0, &l);

		if (fabs(c - 0.7) < 1e-4)
			continue;
		assert_int_equal(lit, c > 0.7);
		if (lit)
			assert_true(fabs((double)l.radiance.x - 9 * f * f * c * c) < 1e-4);
	}
	/* on the light itself: nothing, and nothing that is not finite */
	assert_false(gd_light_sample(s, gd_v3(0, 3, 0), choice_of(s, 0), 0, 0, &l));
	assert_false(gd_light_sample(s, gd_v3(1e-30f, 3, 0), choice_of(s, 0), 0, 0, &l));
	gd_scene_free(s);
}

/* Lights are picked as often as they say, and each that shines can be. */
static void chances(void **state)
{
	struct gd_scene *s = scene_new(300, 900);
	enum { N = 300000 };
	static int count[400];
	double sum = 0, chi = 0;
	int cells = 0;

	(void)state;
	for (int i = 0; i < 300; i++) {
		const struct gd_v3 c = gd_scale(rnd_direction(), 3);
		const float size = powf(10, (float)(-5 * rnd()));

		scene_add(s, gd_mad(c, size, rnd_direction()), gd_mad(c, size, rnd_direction()),
			  gd_mad(c, size, rnd_direction()), (uint32_t)(i % 3));
	}
	s->material[0].emission = gd_v3(1, 2, 4);
	s->material[1].emission = gd_v3(0, 0, 1e-9f);
	s->light = calloc(2, sizeof(*s->light));
	s->light[0] = (struct gd_light){ .kind = GD_POINT, .intensity = { 1e-12f, 0, 0 } };
	s->light[1] = (struct gd_light){ .kind = GD_POINT, .intensity = { 0, 0, 0 } };
	s->nlight = 2;
	s->environment.constant = gd_v3(1e-6f, 0, 0);
	finish(s);
	assert_int_equal(s->nlight, 203);
	assert_int_equal(s->environment_light, 202);
	for (size_t i = 0; i < s->nlight; i++) {
		sum += (double)s->light[i].chance;
		assert_true(i == 1 ? s->light[i].chance == 0 : s->light[i].chance > 0);
	}
	assert_true(fabs(sum - 1) < 1e-9);
	for (int i = 0; i < N; i++) {
		struct gd_light_sample l;

		gd_light_sample(s, gd_v3(9, 9, 9), (float)rnd(), 0.5f, 0.5f, &l);
		count[l.light]++;
	}
	for (size_t i = 0; i < s->nlight; i++) {
		const double want = N * (double)s->light[i].chance;

		if (want > 5) {
			chi += (count[i] - want) * (count[i] - want) / want;
			cells++;
		}
	}
	assert_true(chi < cells + 5 * sqrt(2. * cells));
	/* in proportion to power: the largest emitters of a material */
	for (uint32_t i = 0; i < 300; i += 3)
		for (uint32_t j = 0; j < 300; j += 3) {
			const struct gd_light *a = &s->light[s->triangle[i].light],
					      *b = &s->light[s->triangle[j].light];

			if (a->chance > 0.01f && b->chance > 0.01f)
				assert_true(close_to((double)(a->chance / b->chance),
						     (double)(a->area / b->area), 0.02));
		}
	gd_scene_free(s);
}

/* A texture of emission: chances follow it, and a bright spot of it is never overlooked. */
static void textured(void **state)
{
	struct gd_scene *s = scene_new(3, 9);
	float *rgb = calloc(3 * 64 * 64, sizeof(*rgb));
	static const float uv[3][6] = {
		{ 0.1f, 0.1f, 0.4f, 0.1f, 0.1f, 0.4f },		/* the black half */
		{ 0.6f, 0.1f, 0.9f, 0.1f, 0.6f, 0.4f },		/* the white half */
		{ 0.2f, 0.6f, 0.4f, 0.6f, 0.2f, 0.9f },		/* black, but for one texel */
	};
	struct gd_hit hit;
	struct gd_light_sample l;

	(void)state;
	for (int y = 0; y < 64; y++)
		for (int x = 32; x < 64; x++)
			rgb[3 * (64 * y + x) + 1] = 1;
	rgb[3 * (64 * 41 + 15) + 1] = 1;
	s->texture = calloc(1, sizeof(*s->texture));
	s->texture[0] = (struct gd_texture){ 64, 64, rgb, true, true };
	s->ntexture = 1;
	s->uv = calloc(2 * 9, sizeof(float));
	for (int i = 0; i < 3; i++) {
		const float x = 3 * (float)i;

		scene_add(s, gd_v3(x, 0, 0), gd_v3(x + 1, 0, 0), gd_v3(x, 1, 0), 0);
		memcpy(s->uv + 6 * i, uv[i], sizeof(uv[i]));
	}
	s->material[0].emission = gd_v3(3, 3, 3);
	s->material[0].emission_map = 0;
	finish(s);
	assert_int_equal(s->nlight, 3);
	assert_true(s->light[1].chance > 0.9f);
	assert_true(s->light[0].chance > 0.001f && s->light[2].chance > 0.001f);
	assert_true(gd_ray_hit(s, gd_v3(3.5f, 0.25f, 1), gd_v3(0, 0, -1), &hit));
	assert_true(gd_light_emitted(s, &hit).y == 3);
	assert_true(gd_light_emitted(s, &hit).x == 0);
	assert_true(gd_light_sample(s, gd_v3(0, 0, 1), choice_of(s, 1), 0.5f, 0.5f, &l));
	assert_true(l.radiance.y == 3 && l.radiance.x == 0);
	/* black there: false, but the point is known */
	assert_false(gd_light_sample(s, gd_v3(0, 0, 1), choice_of(s, 0), 0.5f, 0.5f, &l));
	assert_true(l.light == 0 && l.point.x > 0 && gd_black(l.radiance));
	gd_scene_free(s);
}

/* --- environments --- */

static struct gd_scene *sky(int w, int h, bool black_part)
{
	struct gd_scene *s = one_triangle();
	struct gd_environment *e = &s->environment;

	gd_ray_drop(s);
	free(s->light);
	free(s->light_cdf);
	s->light = NULL;
	s->nlight = 0;
	s->material[0].emission = gd_v3(0, 0, 0);
	e->w = w;
	e->h = h;
	e->rgb = calloc((size_t)(w * h), 3 * sizeof(*e->rgb));
	for (int i = 0; i < w * h; i++)
		for (int k = 0; k < 3; k++)
			e->rgb[3 * i + k] = black_part && i % w < w / 2 ?
						    0 : (float)(rnd() < 0.1 ? 50 * rnd() : rnd());
	finish(s);
	assert_int_equal(s->nlight, 1);
	return s;
}

/* The middle of a part of a pixel as a direction. */
static struct gd_v3 towards(double x, double y, int w, int h)
{
	const double phi = 2 * PI * (x / w - 0.5), theta = PI * y / h;

	return gd_v3((float)(sin(theta) * sin(phi)), (float)cos(theta),
		     (float)(-sin(theta) * cos(phi)));
}

static void orientation(void **state)
{
	struct gd_scene *s = sky(8, 4, false);
	const float *rgb = s->environment.rgb;

	(void)state;
	for (int y = 0; y < 4; y++)
		for (int x = 0; x < 8; x++) {
			const struct gd_v3 c =
				gd_environment_at(s, towards(x + 0.5, y + 0.5, 8, 4));

			assert_true(close_to((double)c.x, (double)rgb[3 * (8 * y + x)], 1e-4));
			assert_true(close_to((double)c.z, (double)rgb[3 * (8 * y + x) + 2], 1e-4));
		}
	/* up is the mean of the top row's neighbours, -z between columns 3 and 4, +x after them */
	assert_true(close_to((double)gd_environment_at(s, gd_v3(0, 0, -1)).x,
			     (double)(rgb[3 * (8 + 3)] + rgb[3 * (8 + 4)] + rgb[3 * (16 + 3)] +
				      rgb[3 * (16 + 4)]) / 4, 1e-5));
	assert_true(close_to((double)gd_environment_at(s, towards(6, 1.5, 8, 4)).y,
			     (double)gd_environment_at(s, gd_unit(gd_v3(1, tanf(0.3926991f), 0))).y,
			     1e-4));
	gd_scene_free(s);
}

/* Directions fall as the density says (chi-square over pixels), and estimate the flux. */
static void distribution(int w, int h, bool black_part)
{
	struct gd_scene *s = sky(w, h, black_part);
	int *count = calloc((size_t)(w * h), sizeof(*count)), cells = 0;
	double sum = 0, squares = 0, chi = 0, total = 0, flux = 0;
	const int n = 200000;

	for (int i = 0; i < n; i++) {
		struct gd_light_sample l;
		double x, y, f;

		assert_true(gd_light_sample(s, gd_v3(0, 0, 0), (float)rnd(), (float)rnd(),
					    (float)rnd(), &l) || l.pdf > 0);
		assert_true(isinf(l.t) && !l.delta && l.pdf == gd_environment_pdf(s, l.d));
		x = (0.5 + atan2((double)l.d.x, -(double)l.d.z) / (2 * PI)) * w;
		y = acos(fmin(fmax((double)l.d.y, -1), 1)) / PI * h;
		count[(int)fmin(y, h - 1) * w + (int)fmin(x, w - 1)]++;
		f = (double)gd_luma(l.radiance) / (double)l.pdf;
		sum += f;
		squares += f * f;
	}
	for (int y = 0; y < h; y++)
		for (int x = 0; x < w; x++) {
			const double angle = 2 * PI / w * (cos(PI * y / h) - cos(PI * (y + 1) / h));
			const double pdf =
				(double)gd_environment_pdf(s, towards(x + 0.5, y + 0.5, w, h));
			const double want = n * pdf * angle;

			total += pdf * angle;
			if (want > 5) {
				chi += (count[y * w + x] - want) * (count[y * w + x] - want) / want;
				cells++;
			}
			for (int i = 0; i < 256; i++) {
				const double c = (i / 16 + 0.5) / 16, a = cos(PI * y / h),
					     b = cos(PI * (y + 1) / h);
				const struct gd_v3 d =
					towards(x + (i % 16 + 0.5) / 16,
						acos(a + c * (b - a)) / PI * h, w, h);
				const double r = (double)gd_luma(gd_environment_at(s, d));

				flux += r * angle / 256;
				/* never 0 where there is light */
				assert_true(!(r > 0) || gd_environment_pdf(s, d) > 0);
			}
		}
	assert_true(fabs(total - 1) < 1e-4);
	if (!(chi < cells + 5 * sqrt(2. * cells)))
		fail_msg("%dx%d: chi-square %g of %d cells", w, h, chi, cells);
	assert_true(
		close_to(sum / n, flux,
			 5 * sqrt(fmax(squares / n / (sum / n) / (sum / n) - 1, 0) / n) + 1e-3));
	free(count);
	gd_scene_free(s);
}

static void environments(void **state)
{
	(void)state;
	distribution(32, 16, false);
	distribution(31, 17, true);
	distribution(4, 2, false);
	distribution(1, 1, false);
	distribution(1, 5, false);
}

/* One sun pixel of 1e6 in a dim sky: nearly all samples go there, the rest is still seen. */
static void sun(void **state)
{
	struct gd_scene *s = sky(64, 32, false);
	struct gd_environment *e = &s->environment;
	int near_sun = 0;

	(void)state;
	gd_ray_drop(s);
	free(s->light);
	free(s->light_cdf);
	free(e->row_cdf);
	free(e->column_cdf);
	s->light = NULL;
	s->nlight = 0;
	s->light_cdf = e->row_cdf = e->column_cdf = NULL;
	e->rgb[3 * (64 * 8 + 40)] = 1e8f;
	finish(s);
	for (int i = 0; i < 2000; i++) {
		struct gd_light_sample l;

		if (gd_light_sample(s, gd_v3(0, 0, 0), 0.5f, (float)rnd(), (float)rnd(), &l))
			near_sun += gd_dot(l.d, towards(40.5, 8.5, 64, 32)) > 0.97f;
	}
	assert_true(near_sun > 1900);
	for (int i = 0; i < 2000; i++)
		assert_true(gd_environment_pdf(s, rnd_direction()) > 0);
	gd_scene_free(s);
}

static void constant_sky(void **state)
{
	struct gd_scene *s = all_kinds();
	const float chance = s->light[s->environment_light].chance;
	struct gd_v3 mean = gd_v3(0, 0, 0);
	const int n = 20000;

	(void)state;
	for (int i = 0; i < n; i++) {
		struct gd_light_sample l;

		assert_true(gd_light_sample(s, gd_v3(0, 0, 0), choice_of(s, 4), (float)rnd(),
					    (float)rnd(), &l));
		assert_true(close_to((double)l.pdf, (double)chance / (4 * PI), 1e-6));
		assert_true(l.radiance.y == 0.2f && fabsf(gd_length(l.d) - 1) < 1e-6f);
		mean = gd_add(mean, l.d);
	}
	assert_true(gd_length(mean) / (float)n < 5 / sqrtf((float)n));
	gd_scene_free(s);
	s = one_triangle();	/* no sky: no density */
	assert_true(gd_environment_pdf(s, gd_v3(0, 1, 0)) == 0);
	assert_true(gd_black(gd_environment_at(s, gd_v3(0, 1, 0))));
	assert_int_equal(s->environment_light, GD_NO_INDEX);
	gd_scene_free(s);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(area_density), cmocka_unit_test(sample_and_ray),
		cmocka_unit_test(again),	cmocka_unit_test(delta_lights),
		cmocka_unit_test(chances),	cmocka_unit_test(textured),
		cmocka_unit_test(orientation),	cmocka_unit_test(environments),
		cmocka_unit_test(sun),		cmocka_unit_test(constant_sky),
	};

	return cmocka_run_group_tests_name("light", tests, NULL, NULL);
}
