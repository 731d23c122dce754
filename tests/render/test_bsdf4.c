/* SPDX-License-Identifier: BSD-3-Clause */
/* Four materials at once against one after the other. */
#include "bsdf_case.h"

#include "render/bsdf4.h"

/* A few roundings, amplified where lobes are narrow. */
static void alike(const char *what, const char *name, float a, float b)
{
	near(what, name, (double)a, (double)b, 1e-4 * fabs((double)b) + 1e-7);
}

/* Lane k of f, pdf against gd_bsdf_rough(); one NULL: it scatters nothing. */
static void compare(const char *what, const char *name, const struct gd_bsdf *one,
		    const struct gd_v34 *wi, const struct gd_v34 *f, gd_f4 pdf, int k)
{
	float want = 0;
	const struct gd_v3 v = one ? gd_bsdf_rough(one, gd_v34_lane(wi, k), &want) :
				     gd_v3(0, 0, 0);

	alike(what, name, f->x[k], v.x);
	alike(what, name, f->y[k], v.y);
	alike(what, name, f->z[k], v.z);
	alike(what, name, pdf[k], want);
}

/* A normal that may lie on either side of ng, mostly near it. */
static struct gd_v3 tilted(struct gd_v3 ng)
{
	return gd_unit(gd_mad(ng, (float)draw(), direction()));
}

/* Towards the light, or where b sends it. */
static struct gd_v3 drawn(const struct gd_bsdf *b)
{
	struct gd_scatter s;
	float u[3];

	draws(u);
	return draw() < 0.5 && gd_bsdf_sample(b, u, &s) ? s.wi : direction();
}

static void test_gathered(void **state)
{
	(void)state;
	seed = 11;
	for (int n = 0; n < 40000; n++) {
		const struct bsdf_kind *const any = &kind[(size_t)(draw() * KINDS)];
		const struct gd_bsdf *from[4] = { NULL };
		struct gd_bsdf one[4], zero = { 0 };
		struct gd_bsdf4 four;
		struct gd_v34 wi, f;
		gd_f4 pdf;

		for (int k = 0; k < 4; k++) {
			const size_t other = (size_t)(draw() * KINDS);
			const struct gd_material m = material(k ? &kind[other] : any);
			const struct gd_v3 ng = direction();

			if (draw() > 0.1 && at(&one[k], &m, ng, tilted(ng), direction()))
				from[k] = &one[k];
			gd_v34_put(&wi, k, drawn(from[k] ? from[k] : &zero));
		}
		gd_bsdf4_gather(&four, from);
		f = gd_bsdf4_rough(&four, &wi, &pdf);
		for (int k = 0; k < 4; k++)
			compare("gathered", any->name, from[k], &wi, &f, pdf, k);
	}
}

static void test_turned(void **state)
{
	int scattered = 0, black = 0;

	(void)state;
	seed = 12;
	for (int n = 0; n < 40000; n++) {
		const struct bsdf_kind *const any = &kind[(size_t)(draw() * KINDS)];
		const struct gd_material m = material(any);
		const struct gd_v3 ng = direction();
		struct gd_bsdf base, one[4];
		struct gd_bsdf4 four;
		struct gd_v34 wo, wi, f;
		gd_f4 pdf;
		gd_i4 ok;

		at(&base, &m, ng, tilted(ng), direction());
		for (int k = 0; k < 4; k++) {
			const struct gd_v3 o = direction();

			gd_v34_put(&wo, k, o);
			gd_bsdf_turn(&one[k], &base, o);
			gd_v34_put(&wi, k, drawn(&one[k]));
		}
		ok = gd_bsdf4_turn(&four, &base, &wo);
		f = gd_bsdf4_rough(&four, &wi, &pdf);
		for (int k = 0; k < 4; k++) {
			const bool want = gd_bsdf_turn(&one[k], &base, gd_v34_lane(&wo, k));

			assert_int_equal(ok[k], want ? -1 : 0);
			scattered += want;
			black += !want;
			compare("turned", any->name, &one[k], &wi, &f, pdf, k);
			if (want && four.wo.z[k] > 1e-3f)
				near("wo", any->name, apart(gd_bsdf4_wo(&four, k),
							    gd_v34_lane(&wo, k)), 0, 1e-4);
		}
	}
	assert_true(scattered > 100000 && black > 0);
}

/* Lanes that hold nothing do not spoil the others. */
static void test_empty_lanes(void **state)
{
	const struct gd_v3 wo = { 0.6f, 0, 0.8f };

	(void)state;
	seed = 13;
	for (size_t i = 0; i < KINDS; i++) {
		const struct gd_material m = material(&kind[i]);
		struct gd_bsdf one;
		struct gd_bsdf4 four;
		struct gd_v34 d = gd_v34_all(gd_v3(NAN, INFINITY, 0)), f;
		gd_f4 pdf;

		at(&one, &m, unturned, unturned, wo);
		gd_v34_put(&d, 2, wo);
		assert_int_equal(gd_bits4(gd_bsdf4_turn(&four, &one, &d)) & 4, 4);
		gd_v34_put(&d, 2, drawn(&one));
		f = gd_bsdf4_rough(&four, &d, &pdf);
		compare("beside nothing", kind[i].name, &one, &d, &f, pdf, 2);
		for (int k = 0; k < 4; k++)
			assert_true(isfinite(pdf[k]) && gd_finite(gd_v34_lane(&f, k)));
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_gathered),
		cmocka_unit_test(test_turned),
		cmocka_unit_test(test_empty_lanes),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
