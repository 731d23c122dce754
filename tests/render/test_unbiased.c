/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * What the samples of two pixels say of their difference is true on average: in each pixel and in
 * the whole image, for all that can happen to an offset path. Limits are in standard errors; those
 * of sums over the image come from independent rounds.
 */
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
#define ROUNDS 20
#if defined(__SANITIZE_ADDRESS__)
#define STEP 3		/* cases; the numbers are judged without the sanitizers */
#else
#define STEP 1
#endif
#ifndef SPP
#define SPP 400
#endif

struct test_case {
	const char *name;
	struct room room;
	struct gd_scene *(*make)(const struct room *room);	/* NULL: room_new */
	int depth;
	float ratio;		/* 0: INFINITY */
	const int (*ring)[2];	/* NULL: NEXT */
	bool uneven;
	bool off;		/* no light sampling */
	int spp;		/* 0: 400 */
};

/* One round: paths with offset paths, and others without. */
struct pair {
	struct shot a, b;
};

struct outcome {
	struct chi2 difference, sum;
	struct stat all_differences, slope, all_sums;
	double gain;
};

/* The pixel that offset k of pixel x, y is in, or NULL. */
static const struct spot *other(const struct shot *s, const struct shot *of, int x, int y, int k)
{
	x += s->ring[k][0];
	y += s->ring[k][1];
	return x < 0 || y < 0 || x >= W || y >= H ? NULL : &of->spot[y * W + x];
}

struct number {
	double value, variance;
};

/* I_j - I_i from the halves less that of the other samples' colours. */
static struct number difference(const struct pair *p, int x, int y, int k)
{
	const struct spot *i = &p->a.spot[y * W + x], *j = other(&p->a, &p->a, x, y, k);
	const struct spot *ci = &p->b.spot[y * W + x], *cj = other(&p->a, &p->b, x, y, k);

	return (struct number){ mean(i->half[k]) - mean(j->half[k + 2]) - mean(cj->colour) +
					mean(ci->colour),
				variance(i->half[k]) + variance(j->half[k + 2]) +
					variance(ci->colour) + variance(cj->colour) };
}

/* I_i from its share of its own samples and from the
 * offset paths of the other pixel's, less I_i. */
static struct number sum(const struct shot *a, int x, int y, int k)
{
	const struct spot *i = &a->spot[y * W + x], *j = other(a, a, x, y, k);
	const int back = (k + 2) & 3;

	return (struct number){ mean(i->lost[k]) + mean(j->theirs[back]),
				variance(i->lost[k]) + variance(j->theirs[back]) };
}

static void judge_all(struct outcome *o, const struct pair *p)
{
	double va = 0, vb = 0;

	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++)
			for (int k = 0; k < 4; k++) {
				const struct spot *i = &p->a.spot[y * W + x],
						  *j = other(&p->a, &p->a, x, y, k);
				struct number n;

				if (!j)
					continue;
				n = sum(&p->a, x, y, k);
				judge(&o->sum, n.value, n.variance);
				if (k >= 2)
					continue;
				n = difference(p, x, y, k);
				judge(&o->difference, n.value, n.variance);
				va += variance(i->half[k]) + variance(j->half[k + 2]);
				vb += variance(i->colour) + variance(j->colour);
			}
	o->gain = vb / va;
}

static void judge_round(struct outcome *o, const struct pair *p, const struct shot *truth)
{
	double d = 0, dg = 0, s = 0;

	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++)
			for (int k = 0; k < 4; k++) {
				const struct spot *j = other(&p->a, truth, x, y, k);
				double one;

				if (!j)
					continue;
				s += sum(&p->a, x, y, k).value;
				if (k >= 2)
					continue;
				one = difference(p, x, y, k).value;
				d += one;
				dg += one * (mean(j->colour) - mean(truth->spot[y * W + x].colour));
			}
	note(&o->all_differences, d);
	note(&o->slope, dg);
	note(&o->all_sums, s);
}

static struct shot base(const struct test_case *t, const struct gd_scene *scene)
{
	struct shot s = { .w = W, .h = H, .scene = scene, .uneven = t->uneven };

	s.spp = ((t->spp ? t->spp : SPP) + ROUNDS - 1) / ROUNDS;
	s.conf = (struct gd_path_conf){ .depth = t->depth ? t->depth : 8, .mis = !t->off,
					.shift_ratio = t->ratio > 0 ? t->ratio : INFINITY };
	return s;
}

static struct outcome observe(const struct test_case *t)
{
	struct gd_scene *scene = t->make ? t->make(&t->room) : room_new(&t->room);
	struct shot truth = base(t, scene);
	struct pair all = { { 0 }, { 0 } }, one;
	struct outcome o = { 0 };

	truth.spp *= ROUNDS;
	truth.seed = 1000;
	shoot(&truth);
	for (int r = 0; r < ROUNDS; r++) {
		one.a = one.b = base(t, scene);
		one.a.ring = t->ring ? t->ring : NEXT;
		one.a.seed = 2 * (uint64_t)r + 1;
		one.b.seed = 2 * (uint64_t)r + 2;
		shoot(&one.a);
		shoot(&one.b);
		judge_round(&o, &one, &truth);
		if (!r) {
			all = one;
			continue;
		}
		pool_shot(&all.a, &one.a);
		pool_shot(&all.b, &one.b);
		free(one.a.spot);
		free(one.b.spot);
	}
	judge_all(&o, &all);
	free(all.a.spot);
	free(all.b.spot);
	free(truth.spot);
	gd_scene_free(scene);
	return o;
}

static double check(const struct test_case *t)
{
	const struct outcome o = observe(t);
	const double d = score(o.all_differences), g = score(o.slope), s = score(o.all_sums);
	const double c = chi2_mean(o.difference), cs = chi2_mean(o.sum);

	print_message("%-16s differences: chi2 %.3f (worst %.1f) all %+.1f slope %+.1f; "
		      "sums: chi2 %.3f (worst %.1f) all %+.1f; gain %.2f\n", t->name, c,
		      o.difference.worst, d, g, cs, o.sum.worst, s, o.gain);
	if (getenv("KEEP"))
		return o.gain;
	assert_true(c < 1.6 && cs < 1.6);
	assert_true(fabs(d) < 5 && fabs(g) < 5 && fabs(s) < 5);
	return o.gain;
}

#define CASE(called, of, holds, lit, ...)                                                       \
	{ .name = called, .room.floor = of, .room.ball = holds, .room.light = lit, ##__VA_ARGS__ }

static void test_all(void **state)
{
	const struct gd_material paint = matter(0.7f), grey = matter(0.5f);
	const struct gd_material varnish = plastic(0.4f, 0.15f), silk = plastic(0.4f, 0.3f);
	struct gd_material half = metal(0.9f, 0.15f);

	half.metallic = 0.5f;
	const struct test_case c[] = {
		CASE("direct", paint, grey, LAMP, .depth = 2),
		CASE("diffuse", paint, grey, LAMP),
		CASE("diffuse, bsdf", paint, grey, LAMP, .off = true),
		CASE("uneven", paint, silk, LAMP, .uneven = true),
		CASE("glossy", silk, metal(0.8f, 0.4f), LAMP),
		CASE("sharp", metal(0.8f, 0.15f), varnish, LAMP),
		CASE("mirror", metal(0.8f, 0), plastic(0.3f, 0), LAMP),
		CASE("glass", paint, glass(0), LAMP),
		CASE("sharp glass", paint, glass(0.15f), LAMP),
		CASE("rough glass", varnish, glass(0.4f), LAMP),
		CASE("lens", varnish, grey, LAMP, .room.lens = 0.1f),
		CASE("delta", varnish, glass(0.3f), POINT | SPOT),
		CASE("sun", silk, glass(0.15f), SUN | POINT),
		CASE("sky", silk, metal(0.6f, 0.2f), SKY),
		CASE("map", varnish, glass(0.1f), MAP | LAMP),
		CASE("ratio 20", varnish, glass(0.2f), LAMP, .ratio = 20),
		CASE("ratio 2", varnish, grey, LAMP, .ratio = 2),
		CASE("stripes", matter(0.9f), matter(0.05f), 0, .make = stripes_new, .spp = 800),
		CASE("glossy stripes", silk, metal(0.05f, 0.5f), 0, .make = stripes_new,
		     .spp = 800),
		CASE("mirror stripes", metal(0.95f, 0), metal(0.05f, 0), 0, .make = stripes_new,
		     .spp = 800),
		CASE("glossy corner", paint, metal(0.9f, 0.3f), 0, .make = corner_new),
		CASE("sharp corner", paint, half, 0, .make = corner_new),
		CASE("knight", varnish, metal(0.6f, 0.3f), LAMP | MAP, .ring = KNIGHT,
		     .uneven = true),
	};

	(void)state;
	for (size_t i = 0; i < sizeof c / sizeof c[0]; i += STEP)
		if (!getenv("ONLY") || strstr(c[i].name, getenv("ONLY")))
			check(&c[i]);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_all),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
