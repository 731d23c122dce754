/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Scattering against a second writing of the model in doubles from the papers' formulae, and
 * against what must hold for any model: energy, reciprocity, sides, Snell's law.
 */
#include "bsdf_case.h"

/* --- the second writing --- */

struct ref {
	double m, t, ior, alpha, base;
};

static struct ref reference(const struct bsdf_kind *k)
{
	return (struct ref){ k->metallic, k->transmission, k->ior,
			    (double)k->roughness * k->roughness, k->base };
}

/* From Snell's law and angles. */
static double ref_fresnel(double c, double eta)
{
	const double a = acos(fmin(c, 1)), s = sin(a) / eta;

	if (eta == 1)
		return 0;
	if (s >= 1)
		return 1;
	const double b = asin(s);

	if (a < 1e-6)
		return pow((eta - 1) / (eta + 1), 2);
	return 0.5 * (pow(sin(a - b) / sin(a + b), 2) + pow(tan(a - b) / tan(a + b), 2));
}

static double ref_d(double alpha, double hz)
{
	const double tan2 = (1 - hz * hz) / (hz * hz);

	return 1 / (PI * alpha * alpha * pow(hz, 4) * pow(1 + tan2 / (alpha * alpha), 2));
}

static double ref_lambda(double alpha, double z)
{
	return 0.5 * (sqrt(1 + alpha * alpha * (1 - z * z) / (z * z)) - 1);
}

static double dot(const double a[3], const double b[3])
{
	return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static double ref_reflectance(const struct ref *r, double c, double eta)
{
	return (1 - r->m) * ref_fresnel(c, eta) + r->m * (r->base + (1 - r->base) * pow(1 - c, 5));
}

/* Is the lobe in question part of the sum? sharp: those with alpha < GD_SHARP, without smooth. */
static bool counts(double alpha, bool sharp)
{
	return sharp ? alpha >= GD_SMOOTH && alpha < GD_SHARP : alpha >= GD_SHARP;
}

/* Value times cosine; the normal is z. */
static double ref_value(const struct ref *r, const struct gd_v3 wo, const struct gd_v3 wi,
			bool sharp)
{
	const double side = wo.z < 0 ? -1 : 1;
	const double o[3] = { wo.x, wo.y, side * wo.z }, i[3] = { wi.x, wi.y, side * wi.z };
	const bool passes = (1 - r->m) * r->t * r->base > 0;
	const double eta = side < 0 && passes ? 1 / r->ior : r->ior;
	double h[3], f = 0, n = 0;

	for (int k = 0; k < 3; k++) {
		h[k] = i[2] > 0 ? o[k] + i[k] : -(o[k] + eta * i[k]);
		n += h[k] * h[k];
	}
	for (int k = 0; k < 3; k++)
		h[k] *= (h[2] < 0 ? -1 : 1) / sqrt(n);

	const double oh = dot(o, h), ih = dot(i, h);
	const double g2 = 1 / (1 + ref_lambda(r->alpha, o[2]) + ref_lambda(r->alpha, i[2]));

	if (i[2] > 0) {
		if (!sharp)
			f += (1 - r->m) * (1 - r->t) * r->base / PI * (1 - ref_fresnel(o[2], eta)) *
			     (1 - ref_fresnel(i[2], eta));
		if (counts(r->alpha, sharp))
			f += ref_reflectance(r, oh, eta) * ref_d(r->alpha, h[2]) * g2 /
			     (4 * o[2] * i[2]);
	} else if (counts(r->ior == 1 ? 0 : r->alpha, sharp) && oh > 0 && ih < 0) {
		f += (1 - r->m) * r->t * r->base * (1 - ref_fresnel(oh, eta)) * oh * -ih /
		     (o[2] * -i[2]) * eta * eta * g2 * ref_d(r->alpha, h[2]) /
		     pow(oh + eta * ih, 2);
	}
	return f * fabs(i[2]);
}

static void test_values(void **state)
{
	(void)state;
	seed = 1;
	for (size_t k = 0; k < KINDS; k++) {
		const struct ref r = reference(&kind[k]);

		for (int n = 0; n < 4000; n++) {
			const struct gd_material m = material(&kind[k]);
			const struct gd_v3 wo = direction();
			struct gd_v3 wi = direction();
			struct gd_bsdf b;
			struct gd_scatter s;
			float u[3], pdf;

			if (!at(&b, &m, unturned, unturned, wo) || fabsf(wo.z) < 1e-3f)
				continue;
			draws(u);
			const bool drawn = n % 2 && gd_bsdf_sample(&b, u, &s) && !s.smooth;

			if (drawn)
				wi = s.wi;
			if (fabsf(wi.z) < 1e-4f)
				continue;
			const double want = ref_value(&r, wo, wi, false);
			const double sharp = ref_value(&r, wo, wi, true);
			const struct gd_v3 f = gd_bsdf_rough(&b, wi, &pdf);

			near("rough", kind[k].name, f.x, want, 2e-4 * want + 1e-6);
			/* h from float directions: 1e-7 of an alpha of 0.01, and at grazing angles
			 * more */
			near("sharp", kind[k].name, gd_bsdf_sharp(&b, wi).x, sharp,
			     2e-2 * sharp + 1e-4);
			if (drawn && s.event == GD_ROUGH) {
				near("f", kind[k].name, s.f.x, f.x, 1e-4 * f.x + 1e-6);
				near("pdf", kind[k].name, s.pdf, pdf, 1e-4 * pdf + 1e-6);
			}
		}
	}
}

/* --- energy --- */

/* Albedo of GD_ROUGH by midpoints; also the integral of its density. */
static double integrated(const struct gd_bsdf *b, double *pdf)
{
	const int nt = 400, np = 400;
	double sum = 0;

	*pdf = 0;
	for (int t = 0; t < nt; t++)
		for (int p = 0; p < np; p++) {
			double dth, dph;
			const double th = inclination((t + 0.5) / nt, &dth);
			const double ph = azimuth((p + 0.5) / np, &dph);
			const double w = sin(th) * dth * dph / (nt * np);
			float q;
			const struct gd_v3 f =
				gd_bsdf_rough(b,
					      gd_v3((float)(sin(th) * cos(ph)),
						    (float)(sin(th) * sin(ph)), (float)cos(th)),
					      &q);

			sum += f.x * w;
			*pdf += q * w;
		}
	return sum;
}

static void test_energy(void **state)
{
	(void)state;
	seed = 2;
	for (size_t k = 0; k < KINDS; k++)
		for (size_t z = 0; z < SLOPES; z++) {
			struct gd_bsdf b;
			double se, pdf;

			assert_true(seen(&b, &kind[k], slope[z]));
			near("chances", kind[k].name,
			     (double)b.chance[0] + b.chance[1] + b.chance[2], 1, 1e-6);
			const double all = sampled(&b, 30000, 7, &se);

			if (!(all <= 1 + 4 * se + 1e-5))
				fail_msg("%s at %g sends back %g (%g)", kind[k].name,
					 (double)slope[z], all, se);
			if (kind[k].roughness == 0 && kind[k].base == 1 &&
			    (kind[k].metallic == 1 || kind[k].transmission == 1))
				near("albedo", kind[k].name, all, 1, 4 * se + 1e-5);
			if (!(b.chance[GD_ROUGH] > 0))
				continue;
			const double rough = sampled(&b, 30000, 1, &se),
				     whole = integrated(&b, &pdf);

			near("rough albedo", kind[k].name, rough, whole, 4 * se + 2e-3);
			assert_true(pdf <= b.chance[GD_ROUGH] + 2e-3);
		}
}

/* A label that can scatter is drawn. */
static void test_chances(void **state)
{
	(void)state;
	seed = 3;
	for (size_t k = 0; k < KINDS; k++) {
		const struct ref r = reference(&kind[k]);

		for (int n = 0; n < 2000; n++) {
			const struct gd_material m = material(&kind[k]);
			const struct gd_v3 wo = direction(), wi = direction();
			struct gd_bsdf b;
			float pdf;

			if (fabsf(wo.z) < 1e-3f)
				continue;
			at(&b, &m, unturned, unturned, wo);
			gd_bsdf_rough(&b, wi, &pdf);
			if (ref_value(&r, wo, wi, false) > 0)
				assert_true(b.chance[GD_ROUGH] > 0.01f && pdf > 0);
			if (ref_value(&r, wo, wi, true) > 0)
				assert_true(b.chance[GD_REFLECT] + b.chance[GD_TRANSMIT] > 0.01f);
		}
	}
}

static void test_reciprocity(void **state)
{
	(void)state;
	seed = 4;
	for (size_t k = 0; k < KINDS; k++)
		for (int n = 0; n < 2000; n++) {
			const struct gd_material m = material(&kind[k]);
			const struct gd_v3 a = direction(), c = direction();
			const double ka = a.z > 0 ? 1 : kind[k].ior, kc = c.z > 0 ? 1 : kind[k].ior;
			struct gd_bsdf ba, bc;
			float pdf;

			if (fabsf(a.z) < 0.01f || fabsf(c.z) < 0.01f ||
			    !at(&ba, &m, unturned, unturned, a) || !gd_bsdf_turn(&bc, &ba, c))
				continue;
			const double ac = ka * ka * gd_bsdf_rough(&ba, c, &pdf).x / fabsf(c.z);
			const double ca = kc * kc * gd_bsdf_rough(&bc, a, &pdf).x / fabsf(a.z);

			near("both ways", kind[k].name, ac, ca, 3e-4 * ac + 1e-5);
		}
}

/* --- sides, normals, frames --- */

static void test_sides(void **state)
{
	(void)state;
	seed = 9;
	for (size_t k = 0; k < KINDS; k++)
		for (int n = 0; n < 500; n++) {
			const struct gd_material m = material(&kind[k]);
			const struct gd_v3 ng = unturned, ns = gd_unit(gd_v3(0.6f, 0, 0.8f));
			const struct gd_v3 wo = direction(), wi = direction(),
					   of = gd_scale(wo, -1);
			const bool passes = kind[k].transmission > 0 && kind[k].metallic < 1;
			struct gd_bsdf b, c;
			struct gd_scatter s;
			float pdf, pdc, u[3];

			if (fabsf(wo.z) < 0.01f || fabsf(gd_dot(wo, ns)) < 0.01f)
				continue;
			assert_true(at(&b, &m, ng, ns, wo));
			assert_true(b.wo.z * wo.z > 0);
			near("normal", kind[k].name,
			     apart(b.frame.n, wo.z * gd_dot(wo, ns) > 0 ? ns : ng), 0, 1e-6);
			draws(u);
			if (gd_bsdf_sample(&b, u, &s)) {
				assert_true(gd_dot(s.wi, b.frame.n) * s.wi.z > 0);
				assert_true((s.event == GD_REFLECT) <= (s.wi.z * wo.z > 0));
				assert_true((s.event == GD_TRANSMIT) <= (s.wi.z * wo.z < 0));
			}
			const struct gd_v3 f = gd_bsdf_rough(&b, wi, &pdf),
					   g = gd_bsdf_sharp(&b, wi);

			if (gd_dot(wi, b.frame.n) * wi.z < 0)
				assert_true(gd_black(f) && gd_black(g) && pdf == 0);
			if (passes)
				continue;
			/* the other side: all directions turned about the centre */
			assert_true(at(&c, &m, gd_scale(ng, -1), gd_scale(ns, -1), wo));
			near("back", kind[k].name, gd_bsdf_rough(&c, wi, &pdc).x, f.x,
			     1e-4 * f.x + 1e-6);
			near("pdf of the back", kind[k].name, pdc, pdf, 1e-4 * pdf + 1e-6);
			assert_true(gd_bsdf_turn(&c, &c, of));
			near("behind", kind[k].name, gd_bsdf_rough(&c, gd_scale(wi, -1), &pdc).x,
			     f.x, 1e-4 * f.x + 1e-6);
		}
}

static void test_straight(void **state)
{
	static const struct bsdf_kind air = { "air", 0, 0.5f, 1, 1, 1 };
	const struct gd_material m = material(&air);

	(void)state;
	seed = 10;
	for (int n = 0; n < 1000; n++) {
		const struct gd_v3 wo = direction(), nrm = direction();
		struct gd_scatter s;
		struct gd_bsdf b;
		float u[3];

		draws(u);
		if (!at(&b, &m, nrm, nrm, wo))
			continue;
		assert_true(gd_bsdf_sample(&b, u, &s));
		assert_true(s.smooth && s.event == GD_TRANSMIT && s.f.x == 1 && s.pdf == 1);
		near("straight on", "air", apart(s.wi, gd_scale(wo, -1)), 0, 2e-5);
	}
}

/* Snell's law, and the mirror's. */
static void test_smooth(void **state)
{
	static const struct bsdf_kind glass = { "glass", 0, 0, 1, 1.5f, 1 };
	const struct gd_material m = material(&glass);
	int total = 0, seen_both[2] = { 0 };

	(void)state;
	seed = 11;
	for (int n = 0; n < 3000; n++) {
		const struct gd_v3 wo = direction(), nrm = direction();
		const double co = gd_dot(wo, nrm), eta = co > 0 ? 1.5 : 1 / 1.5;
		const double sine = sqrt(1 - co * co) / eta, refl = ref_fresnel(fabs(co), eta);
		struct gd_scatter s;
		struct gd_bsdf b;
		float u[3];

		draws(u);
		if (fabs(co) < 1e-3 || !at(&b, &m, nrm, nrm, wo))
			continue;
		assert_true(gd_bsdf_sample(&b, u, &s));
		assert_true(s.smooth);
		const double ci = gd_dot(s.wi, nrm);

		seen_both[s.event == GD_TRANSMIT]++;
		if (s.event == GD_REFLECT) {
			near("mirrored", "glass", ci, co, 1e-5);
			near("F", "glass", s.f.x, refl, 1e-4);
		} else {
			assert_true(sine < 1 && ci * co < 0);
			near("refracted", "glass", sqrt(1 - ci * ci), sine, 1e-4);
			near("1 - F", "glass", s.f.x, 1 - refl, 1e-4);
		}
		near("in the plane", "glass", gd_dot(gd_cross(wo, nrm), s.wi), 0, 1e-5);
		total += sine >= 1;
	}
	assert_true(total > 100 && seen_both[0] > 100 && seen_both[1] > 100);
}

static void test_turn(void **state)
{
	(void)state;
	seed = 12;
	for (size_t k = 0; k < KINDS; k++)
		for (int n = 0; n < 200; n++) {
			const struct gd_material m = material(&kind[k]);
			const struct gd_v3 ng = direction(),
					   ns = gd_unit(gd_mad(ng, 0.5f, direction()));
			const struct gd_v3 wo = direction(), wi = direction();
			struct gd_bsdf a, b, c;
			float pa, pb;

			at(&a, &m, ng, ns, direction());
			const bool turned = gd_bsdf_turn(&b, &a, wo);

			assert_true(turned == at(&c, &m, ng, ns, wo));
			for (int j = 0; j < 3; j++)
				assert_true(b.chance[j] == c.chance[j] && b.share[j] == c.share[j]);
			assert_true(gd_bsdf_rough(&b, wi, &pb).x == gd_bsdf_rough(&c, wi, &pa).x &&
				    pa == pb);
			assert_true(gd_bsdf_sharp(&b, wi).x == gd_bsdf_sharp(&c, wi).x);
		}
}

/* Right-handed and orthonormal; alike where normals are alike, also across the axes' planes. */
static void test_frame(void **state)
{
	const struct gd_material m = material(&kind[0]);
	int jumps = 0;

	(void)state;
	seed = 13;
	for (int n = 0; n < 20000; n++) {
		struct gd_v3 a = direction(), d = gd_scale(direction(), 1e-4f), wo = direction();
		struct gd_bsdf p, q;

		if (n % 4 == 0)
			a.z = 0;
		if (n % 4 == 1)
			a.x = 0;
		if (n % 16 == 2)
			a = gd_v3(0, a.y < 0 ? -1 : 1, 0);
		a = gd_unit(a);
		at(&p, &m, a, a, wo);
		at(&q, &m, gd_unit(gd_add(a, d)), gd_unit(gd_add(a, d)), wo);
		const struct gd_frame *f = &p.frame;

		near("handed", "frame", apart(gd_cross(f->x, f->y), f->n), 0, 2e-5);
		near("x", "frame", gd_length(f->x), 1, 2e-5);
		near("y", "frame", gd_length(f->y), 1, 2e-5);
		near("x y", "frame", gd_dot(f->x, f->y), 0, 2e-5);
		jumps += apart(p.frame.x, q.frame.x) > 0.01;
	}
	if (jumps > 40) /* 1 of 10,000 by chance, about the one direction */
		fail_msg("%d of 20000 frames jump", jumps);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_values),	cmocka_unit_test(test_energy),
		cmocka_unit_test(test_chances), cmocka_unit_test(test_reciprocity),
		cmocka_unit_test(test_sides),	cmocka_unit_test(test_straight),
		cmocka_unit_test(test_smooth),	cmocka_unit_test(test_turn),
		cmocka_unit_test(test_frame),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
