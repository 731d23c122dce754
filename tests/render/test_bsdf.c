/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Scattering against a second writing of the model in doubles from the papers' formulae, and
 * against what must hold for any model: energy, reciprocity, densities, inverses.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "render/bsdf.h"

#define PI 3.14159265358979

struct kind {
	const char *name;
	float metallic, roughness, transmission, ior, base;
};

static const struct kind kind[] = {
	{ "chalk", 0, 1, 0, 1.5f, 1 },
	{ "matte without coat", 0, 1, 0, 1, 1 },
	{ "plastic", 0, 0.5f, 0, 1.5f, 1 },
	{ "satin", 0, 0.3f, 0, 1.5f, 0.6f },
	{ "shiny plastic", 0, 0.2f, 0, 1.5f, 1 },
	{ "varnish", 0, 0, 0, 1.5f, 1 },
	{ "diamond paint", 0, 0.6f, 0, 3, 1 },
	{ "mirror", 1, 0, 0, 1.5f, 1 },
	{ "polished metal", 1, 0.15f, 0, 1.5f, 1 },
	{ "brushed metal", 1, 0.4f, 0, 1.5f, 0.8f },
	{ "cast metal", 1, 1, 0, 1.5f, 1 },
	{ "black metal", 1, 0.5f, 0, 1.5f, 0 },
	{ "half metal", 0.5f, 0.5f, 0, 1.5f, 1 },
	{ "glass", 0, 0, 1, 1.5f, 1 },
	{ "bathroom glass", 0, 0.15f, 1, 1.5f, 1 },
	{ "frosted glass", 0, 0.4f, 1, 1.5f, 1 },
	{ "rough glass", 0, 1, 1, 1.5f, 1 },
	{ "rough diamond", 0, 0.7f, 1, 2.4f, 0.9f },
	{ "no glass", 0, 0.5f, 1, 1, 1 },
	{ "milk glass", 0, 0.5f, 0.5f, 1.4f, 1 },
	{ "varnished milk glass", 0, 0.1f, 0.5f, 1.4f, 1 },
	{ "half metal glass", 0.5f, 0.3f, 0.7f, 1.5f, 1 },
};
#define KINDS (sizeof kind / sizeof *kind)

static const float slope[] = { 1, 0.8f, 0.4f, 0.1f, 0.02f, -0.05f, -0.3f, -0.7f, -0.95f };
#define SLOPES (sizeof slope / sizeof *slope)

static uint64_t seed;

static double draw(void)
{
	seed = seed * 6364136223846793005u + 1442695040888963407u;
	return (double)(seed >> 40) / (1 << 24);
}

static void draws(float u[3])
{
	for (int k = 0; k < 3; k++)
		u[k] = (float)draw();
}

static struct gd_v3 direction(void)
{
	const double z = 2 * draw() - 1, r = sqrt(1 - z * z), p = 2 * PI * draw();

	return gd_v3((float)(r * cos(p)), (float)(r * sin(p)), (float)z);
}

static const struct gd_v3 unturned = { 0, 0, 1 };

static bool at(struct gd_bsdf *b, const struct gd_material *m, struct gd_v3 ng, struct gd_v3 ns,
	       struct gd_v3 wo)
{
	struct gd_material mat = *m;
	struct gd_triangle triangle = { .light = GD_NO_INDEX };
	const struct gd_scene scene = {
		.material = &mat, .nmaterial = 1, .triangle = &triangle, .ntriangle = 1
	};
	const struct gd_hit hit = { .ng = ng, .ns = ns };

	mat.base_map = mat.rough_map = mat.emission_map = GD_NO_INDEX;
	return gd_bsdf_at(b, &scene, &hit, wo);
}

static struct gd_material material(const struct kind *k)
{
	return (struct gd_material){
		.base = { k->base, k->base, k->base }, .metallic = k->metallic,
		.roughness = k->roughness, .transmission = k->transmission, .ior = k->ior
	};
}

/* A surface whose normal is (0, 0, 1), seen at the cosine z. */
static bool seen(struct gd_bsdf *b, const struct kind *k, float z)
{
	const struct gd_material m = material(k);

	return at(b, &m, unturned, unturned, gd_v3(0.6f * sqrtf(1 - z * z), 0.8f * sqrtf(1 - z * z), z));
}

static void near(const char *what, const char *name, double a, double b, double most)
{
	if (!(fabs(a - b) <= most))
		fail_msg("%s, %s: %.9g and %.9g, %.3g apart, %.3g allowed", name, what, a, b,
			 fabs(a - b), most);
}

/* --- the second writing --- */

struct ref {
	double m, t, ior, alpha, base;
};

static struct ref reference(const struct kind *k)
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
	return (1 - r->m) * ref_fresnel(c, eta) +
	       r->m * (r->base + (1 - r->base) * pow(1 - c, 5));
}

/* Is the lobe in question part of the sum? sharp: those with alpha < GD_SHARP, without smooth. */
static bool counts(double alpha, bool sharp)
{
	return sharp ? alpha >= GD_SMOOTH && alpha < GD_SHARP : alpha >= GD_SHARP;
}

/* Value times cosine; the normal is z. */
static double ref_value(const struct ref *r, const struct gd_v3 wo, const struct gd_v3 wi, bool sharp)
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
		     (o[2] * -i[2]) * eta * eta * g2 * ref_d(r->alpha, h[2]) / pow(oh + eta * ih, 2);
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
			/* h from float directions: 1e-7 of an alpha of 0.01, and at grazing angles more */
			near("sharp", kind[k].name, gd_bsdf_sharp(&b, wi).x, sharp, 2e-2 * sharp + 1e-4);
			if (drawn && s.event == GD_ROUGH) {
				near("f", kind[k].name, s.f.x, f.x, 1e-4 * f.x + 1e-6);
				near("pdf", kind[k].name, s.pdf, pdf, 1e-4 * pdf + 1e-6);
			}
		}
	}
}

/* --- energy --- */

/* Albedo of labels (bits) by sampling, with the standard error of it. */
static double sampled(const struct gd_bsdf *b, int n, unsigned labels, double *se)
{
	double sum = 0, sum2 = 0;

	for (int k = 0; k < n; k++) {
		struct gd_scatter s;
		float u[3];

		draws(u);
		if (!gd_bsdf_sample(b, u, &s) || !(labels >> s.event & 1))
			continue;
		assert_true(s.pdf > 0);
		sum += (double)s.f.x / s.pdf;
		sum2 += pow((double)s.f.x / s.pdf, 2);
	}
	sum /= n;
	*se = sqrt(fmax(sum2 / n - sum * sum, 0) / n);
	return sum;
}

/*
 * x in 0 .. 1 to an angle about the normal; dense where wo's plane is, as lobes are narrow there
 * when seen from near the surface. *rate: its derivative.
 */
static double azimuth(double x, double *rate)
{
	*rate = 2 * PI * (1 - 0.95 * cos(4 * PI * x));
	return atan2(0.8, 0.6) + 2 * PI * x - 0.5 * 0.95 * sin(4 * PI * x);
}

/* The same for the angle from the normal; dense about the poles and where the sides meet. */
static double inclination(double x, double *rate)
{
	*rate = PI * (1 - 0.8 * cos(4 * PI * x));
	return PI * x - 0.2 * sin(4 * PI * x);
}

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
			const struct gd_v3 f = gd_bsdf_rough(b, gd_v3((float)(sin(th) * cos(ph)),
								      (float)(sin(th) * sin(ph)),
								      (float)cos(th)), &q);

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
			near("chances", kind[k].name, (double)b.chance[0] + b.chance[1] + b.chance[2], 1, 1e-6);
			const double all = sampled(&b, 30000, 7, &se);

			if (!(all <= 1 + 4 * se + 1e-5))
				fail_msg("%s at %g sends back %g (%g)", kind[k].name, (double)slope[z], all, se);
			if (kind[k].roughness == 0 && kind[k].base == 1 &&
			    (kind[k].metallic == 1 || kind[k].transmission == 1))
				near("albedo", kind[k].name, all, 1, 4 * se + 1e-5);
			if (!(b.chance[GD_ROUGH] > 0))
				continue;
			const double rough = sampled(&b, 30000, 1, &se), whole = integrated(&b, &pdf);

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

			if (fabsf(a.z) < 0.01f || fabsf(c.z) < 0.01f || !at(&ba, &m, unturned, unturned, a) ||
			    !gd_bsdf_turn(&bc, &ba, c))
				continue;
			const double ac = ka * ka * gd_bsdf_rough(&ba, c, &pdf).x / fabsf(c.z);
			const double ca = kc * kc * gd_bsdf_rough(&bc, a, &pdf).x / fabsf(a.z);

			near("both ways", kind[k].name, ac, ca, 3e-4 * ac + 1e-5);
		}
}

/* --- densities --- */

#define ROWS 12
#define COLUMNS 16
#define DRAWS 60000

/*
 * Rows and columns of directions are even in y and x of 0 .. 1. y: for GD_ROUGH inclination(); for
 * the half vectors of the others the share of microfacets that lean less,
 * tan^2 = alpha^2 y / (1 - y). x: azimuth().
 */
static struct gd_v3 spread(double x, double y, double alpha, bool rough, double *weight)
{
	const double a2 = alpha * alpha;
	double slant, rate, z, r;

	if (rough) {
		const double th = inclination(y, &slant);

		z = cos(th);
		r = sin(th);
		slant *= r;
	} else {
		z = 1 / sqrt(1 + a2 * y / (1 - y));
		r = z * sqrt(a2 * y / (1 - y));
		slant = 0.5 * z * z * z * a2 / pow(1 - y, 2);
	}
	const double p = azimuth(x, &rate);

	*weight = rate * slant;
	return gd_v3((float)(r * cos(p)), (float)(r * sin(p)), (float)z);
}

static int bin(const struct gd_bsdf *b, struct gd_v3 v, bool rough)
{
	const double r2 = (double)v.x * v.x + (double)v.y * v.y, a2 = (double)b->alpha * b->alpha;
	const double t = r2 / fmax((double)v.z * v.z, 1e-12) / a2, th = atan2(sqrt(r2), v.z);
	double rate, p = atan2(v.y, v.x);
	int column = 0, row = 0;

	while (p < azimuth(0, &rate))
		p += 2 * PI;
	while (column < COLUMNS - 1 && p >= azimuth((column + 1.0) / COLUMNS, &rate))
		column++;
	while (row < ROWS - 1 && (rough ? th >= inclination((row + 1.0) / ROWS, &rate) :
					  t / (1 + t) * ROWS >= row + 1))
		row++;
	return row * COLUMNS + column;
}

/* As seen in the frame of the surface itself, which is turned: (x, y) of the tests' axes. */
static struct gd_v3 in_frame(const struct gd_bsdf *b, struct gd_v3 v)
{
	struct gd_v3 l = gd_to_local(&b->frame, gd_v3(v.x, v.y, 0));

	l.z = v.z;
	return l;
}

static struct gd_v3 out_of_frame(const struct gd_bsdf *b, struct gd_v3 v)
{
	struct gd_v3 w = gd_to_world(&b->frame, v);

	w.z = v.z;
	return w;
}

/* What gd_bsdf_sample() says the density of copy is, 0 where there is none. */
static double density(const struct gd_bsdf *b, enum gd_event event, struct gd_v3 copy)
{
	const struct gd_scatter from = { .event = event, .copy = copy };
	struct gd_scatter to;
	float pdf;

	if (!gd_bsdf_copy(b, &from, &to))
		return 0;
	if (event != GD_ROUGH)
		return (double)to.pdf * to.dw;
	gd_bsdf_rough(b, to.wi, &pdf);
	return pdf;
}

/* Integral of the density over a bin. */
static double expected(const struct gd_bsdf *b, enum gd_event event, int at_bin)
{
	const int sub = 16, row = at_bin / COLUMNS, column = at_bin % COLUMNS;
	double sum = 0;

	for (int j = 0; j < sub; j++)
		for (int i = 0; i < sub; i++) {
			double weight;
			const struct gd_v3 v = spread((column + (i + 0.5) / sub) / COLUMNS,
						      (row + (j + 0.5) / sub) / ROWS, b->alpha,
						      event == GD_ROUGH, &weight);

			sum += weight * density(b, event, in_frame(b, v));
		}
	return sum / (ROWS * COLUMNS * sub * sub);
}

static void check_density(const struct kind *k, float z, enum gd_event event)
{
	int count[ROWS * COLUMNS] = { 0 }, df = 0;
	double chi = 0, rest = 0, left = 0, total = 0, n = 0;
	struct gd_bsdf b;

	assert_true(seen(&b, k, z));
	if (b.chance[event] == 0 || (event != GD_ROUGH && b.alpha < GD_SMOOTH) ||
	    (event == GD_TRANSMIT && b.through < GD_SMOOTH))
		return;
	for (int j = 0; j < DRAWS; j++) {
		struct gd_scatter s;
		float u[3];

		draws(u);
		if (!gd_bsdf_sample(&b, u, &s) || s.event != event)
			continue;
		count[bin(&b, out_of_frame(&b, s.copy), event == GD_ROUGH)]++;
		n++;
	}
	for (int j = 0; j < ROWS * COLUMNS; j++) {
		const double e = DRAWS * expected(&b, event, j);

		total += e;
		if (e < 20) {
			rest += e;
			left += count[j];
			continue;
		}
		/* 1 %: what midpoints may be wrong by where the density changes much */
		chi += pow(fmax(fabs(count[j] - e) - 0.01 * e, 0), 2) / e;
		df++;
	}
	near("drawn", k->name, n, total, 5 * sqrt(total) + 0.004 * total + 5);
	near("rarely drawn", k->name, left, rest, 5 * sqrt(rest) + 0.05 * rest + 5);
	if (!(chi < df + 5 * sqrt(2 * df) + 5))
		fail_msg("%s at %g, label %d: chi square %g of %d bins", k->name, (double)z, (int)event, chi,
			 df);
}

static void test_density(void **state)
{
	(void)state;
	seed = 5;
	for (size_t k = 0; k < KINDS; k++)
		for (size_t z = 0; z < SLOPES; z += 2)
			for (int e = GD_ROUGH; e <= GD_TRANSMIT; e++)
				check_density(&kind[k], slope[z], (enum gd_event)e);
}

/* --- copies --- */

static double apart(struct gd_v3 a, struct gd_v3 b)
{
	return (double)gd_length(gd_sub(a, b));
}

/* |d wi / d h| by differences: wi of half vectors a little off h. < 0: there are none. */
static double difference(const struct gd_bsdf *b, const struct gd_scatter *s, double step)
{
	const struct gd_frame f = gd_frame(s->copy);
	struct gd_v3 d[2];

	for (int k = 0; k < 2; k++) {
		struct gd_scatter to[2];

		for (int j = 0; j < 2; j++) {
			struct gd_scatter from = *s;

			from.copy = gd_unit(gd_mad(s->copy, (float)(j ? step : -step), k ? f.x : f.y));
			if (!gd_bsdf_copy(b, &from, &to[j]))
				return -1;
		}
		d[k] = gd_sub(to[1].wi, to[0].wi);
	}
	return (double)gd_length(gd_cross(d[0], d[1])) / (4 * step * step);
}

static struct gd_v3 upper(float z, double turn)
{
	const double r = sqrt(1 - z * z);

	return gd_v3((float)(r * cos(turn)), (float)(r * sin(turn)), z);
}

static void check_copy(const struct gd_bsdf *a, const struct gd_bsdf *b, const char *name, int *tried)
{
	struct gd_scatter s, to, back;
	float u[3];

	draws(u);
	if (!gd_bsdf_sample(a, u, &s) || !gd_bsdf_copy(b, &s, &to))
		return;
	assert_true(to.event == s.event && to.smooth == s.smooth);
	assert_true(gd_bsdf_copy(a, &to, &back));
	near("wi copied back", name, apart(back.wi, s.wi), 0, 1e-6);
	near("f copied back", name, back.f.x, s.f.x, 1e-4 * s.f.x);
	near("pdf copied back", name, back.pdf, s.pdf, 1e-4 * s.pdf);
	near("dw copied back", name, back.dw, s.dw, 1e-4 * s.dw);
	near("length", name, gd_length(to.wi), 1, 1e-5);
	if (s.event == GD_ROUGH || s.smooth) {
		near("dw", name, s.dw, 1, 0);
		return;
	}
	const double fine = difference(b, &to, 2e-3), coarse = difference(b, &to, 4e-3);

	/* not where differences see more than the derivative: next to total reflection */
	if (fine > 0 && coarse > 0 && fabs(fine - coarse) < 3e-3 * fine) {
		near("dw by differences", name, fine, to.dw, 4e-3 * to.dw);
		++*tried;
	}
}

static void test_copy(void **state)
{
	int tried = 0;

	(void)state;
	seed = 6;
	for (size_t k = 0; k < KINDS; k++)
		for (int n = 0; n < 3000; n++) {
			const struct gd_material m = material(&kind[k]);
			struct gd_material other = m;
			const struct gd_v3 za = direction(), zb = direction();
			struct gd_bsdf a, b;

			if (n % 3 == 0)
				other.ior = other.ior > 1 ? 1.7f : 1;	/* another glass */
			if (at(&a, &m, za, za, direction()) && at(&b, &other, zb, zb, direction()))
				check_copy(&a, &b, kind[k].name, &tried);
			/* one surface, directions near each other */
			if (at(&a, &m, unturned, unturned, upper(0.7f, 1)) && gd_bsdf_turn(&b, &a, upper(0.72f, 1.02)))
				check_copy(&a, &b, kind[k].name, &tried);
			if (at(&a, &m, unturned, unturned, upper(-0.9f, 1)) && gd_bsdf_turn(&b, &a, upper(-0.92f, 1.02)))
				check_copy(&a, &b, kind[k].name, &tried);
		}
	if (tried < 15000)
		fail_msg("%d Jacobians only", tried);
}

/* The half vectors of the sharp lobes are what they are called: of wo and wi. */
static void test_half_vector(void **state)
{
	static const struct kind glass = { "", 0, 0.18f, 1, 1.5f, 1 };
	const struct gd_material m = material(&glass);
	int n[3] = { 0 };

	(void)state;
	seed = 7;
	for (int k = 0; k < 20000; k++) {
		const struct gd_v3 wo = direction();
		struct gd_scatter s;
		struct gd_bsdf b;
		float u[3];

		draws(u);
		if (!at(&b, &m, unturned, unturned, wo) || !gd_bsdf_sample(&b, u, &s))
			continue;
		const float eta = s.event == GD_REFLECT ? 1 : wo.z > 0 ? 1.5f : 1 / 1.5f;
		struct gd_v3 h = gd_unit(gd_mad(wo, eta, s.wi)), c = gd_to_local(&b.frame, h);

		c.z *= wo.z < 0 ? -1.0f : 1.0f;
		c = gd_scale(c, c.z < 0 ? -1.0f : 1.0f);
		near("half vector", "glass", apart(c, s.copy), 0, 3e-6 / fabsf(1 - eta + (eta == 1)) + 1e-4);
		n[s.event]++;
	}
	assert_true(n[GD_REFLECT] > 1000 && n[GD_TRANSMIT] > 1000);
}

/*
 * Energy at wo' from samples at wo: E[f'(to) |J| / pdf(from)] is the label's albedo at wo', if all
 * that is sampled there is sampled here, too.
 */
static void check_shift(const struct kind *k, float za, float zb, unsigned label)
{
	const struct gd_material m = material(k);
	const struct gd_v3 tilt = gd_unit(gd_v3(0.02f, 0.01f, 1));
	double sum = 0, sum2 = 0, se;
	struct gd_bsdf a, b;
	const int n = 40000;

	assert_true(at(&a, &m, unturned, unturned, upper(za, 0.3)));
	assert_true(at(&b, &m, tilt, tilt, upper(zb, 0.33)));
	if (!(a.chance[label] > 0))
		return;
	for (int j = 0; j < n; j++) {
		struct gd_scatter s, to;
		float u[3];

		draws(u);
		if (!gd_bsdf_sample(&a, u, &s) || s.event != label || !gd_bsdf_copy(&b, &s, &to))
			continue;
		const double w = (double)to.f.x * to.dw / s.dw / s.pdf;

		sum += w;
		sum2 += w * w;
	}
	sum /= n;
	const double own = sampled(&b, n, 1U << label, &se);

	/* what refracts at large angles depends on wo: not all of it can be copied */
	const double lost = label == GD_ROUGH && k->transmission > 0 && k->roughness > 0.4f ? 0.05 : 0;

	near("energy of copies", k->name, sum + 0.5 * lost, own, 0.5 * lost +
	     4 * sqrt(fmax(sum2 / n - sum * sum, 0) / n + se * se) + 1e-3);
}

static void test_shift(void **state)
{
	(void)state;
	seed = 8;
	for (size_t k = 0; k < KINDS; k++)
		for (unsigned label = 0; label < 3; label++) {
			check_shift(&kind[k], 0.8f, 0.75f, label);
			check_shift(&kind[k], 0.6f, 0.63f, label);
			check_shift(&kind[k], -0.95f, -0.9f, label);
			if (label == GD_ROUGH || (kind[k].roughness > 0 && kind[k].transmission == 0))
				check_shift(&kind[k], 0.9f, -0.87f, label);
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
			const struct gd_v3 wo = direction(), wi = direction(), of = gd_scale(wo, -1);
			const bool passes = kind[k].transmission > 0 && kind[k].metallic < 1;
			struct gd_bsdf b, c;
			struct gd_scatter s;
			float pdf, pdc, u[3];

			if (fabsf(wo.z) < 0.01f || fabsf(gd_dot(wo, ns)) < 0.01f)
				continue;
			assert_true(at(&b, &m, ng, ns, wo));
			assert_true(b.wo.z * wo.z > 0);
			near("normal", kind[k].name, apart(b.frame.n, wo.z * gd_dot(wo, ns) > 0 ? ns : ng), 0, 1e-6);
			draws(u);
			if (gd_bsdf_sample(&b, u, &s)) {
				assert_true(gd_dot(s.wi, b.frame.n) * s.wi.z > 0);
				assert_true((s.event == GD_REFLECT) <= (s.wi.z * wo.z > 0));
				assert_true((s.event == GD_TRANSMIT) <= (s.wi.z * wo.z < 0));
			}
			const struct gd_v3 f = gd_bsdf_rough(&b, wi, &pdf), g = gd_bsdf_sharp(&b, wi);

			if (gd_dot(wi, b.frame.n) * wi.z < 0)
				assert_true(gd_black(f) && gd_black(g) && pdf == 0);
			if (passes)
				continue;
			/* the other side: all directions turned about the centre */
			assert_true(at(&c, &m, gd_scale(ng, -1), gd_scale(ns, -1), wo));
			near("back", kind[k].name, gd_bsdf_rough(&c, wi, &pdc).x, f.x, 1e-4 * f.x + 1e-6);
			near("pdf of the back", kind[k].name, pdc, pdf, 1e-4 * pdf + 1e-6);
			assert_true(gd_bsdf_turn(&c, &c, of));
			near("behind", kind[k].name, gd_bsdf_rough(&c, gd_scale(wi, -1), &pdc).x, f.x,
			     1e-4 * f.x + 1e-6);
		}
}

static void test_straight(void **state)
{
	static const struct kind air = { "air", 0, 0.5f, 1, 1, 1 };
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
	static const struct kind glass = { "glass", 0, 0, 1, 1.5f, 1 };
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
			const struct gd_v3 ng = direction(), ns = gd_unit(gd_mad(ng, 0.5f, direction()));
			const struct gd_v3 wo = direction(), wi = direction();
			struct gd_bsdf a, b, c;
			float pa, pb;

			at(&a, &m, ng, ns, direction());
			const bool turned = gd_bsdf_turn(&b, &a, wo);

			assert_true(turned == at(&c, &m, ng, ns, wo));
			for (int j = 0; j < 3; j++)
				assert_true(b.chance[j] == c.chance[j] && b.share[j] == c.share[j]);
			assert_true(gd_bsdf_rough(&b, wi, &pb).x == gd_bsdf_rough(&c, wi, &pa).x && pa == pb);
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
	if (jumps > 40)		/* 1 of 10,000 by chance, about the one direction */
		fail_msg("%d of 20000 frames jump", jumps);
}

/* --- whatever comes in --- */

static float wild(void)
{
	static const float odd[] = { 0, 1, -1, 0.5f, 2, 1e-8f, 1e30f, -1e30f, INFINITY, -INFINITY, NAN, 1.5f };

	return draw() < 0.5 ? odd[(int)(draw() * 12)] : (float)draw();
}

static struct gd_v3 odd_direction(void)
{
	const double what = draw();

	if (what < 0.6)
		return direction();
	if (what < 0.8)
		return gd_unit(gd_v3(1, (float)draw(), (float)(draw() - 0.5) * 1e-6f));
	if (what < 0.9)
		return gd_v3((float)(draw() < 0.5), 0, (float)(draw() < 0.5));
	return gd_v3(wild(), wild(), wild());
}

static bool finite3(struct gd_v3 a)
{
	return isfinite(a.x) && isfinite(a.y) && isfinite(a.z) && a.x >= 0 && a.y >= 0 && a.z >= 0;
}

static void check_finite(const struct gd_bsdf *b)
{
	static struct gd_scatter last;
	const bool sane = fabsf(gd_length(b->wo) - 1) < 1e-4f;
	struct gd_scatter s;
	float u[3], pdf;

	assert_true(finite3(b->albedo) && gd_largest(b->albedo) <= 1);
	const double sum = (double)b->chance[0] + b->chance[1] + b->chance[2];

	assert_true(sum == 0 || fabs(sum - 1) < 1e-6);
	for (int k = 0; k < 3; k++)
		assert_true(b->chance[k] >= 0 && b->share[k] >= 0);
	for (int k = 0; k < 3; k++) {
		const struct gd_v3 wi = odd_direction();
		const struct gd_v3 f = gd_bsdf_rough(b, wi, &pdf);

		if (sane && isfinite(wi.x + wi.y + wi.z) && fabsf(gd_length(wi) - 1) < 1e-3f)
			assert_true(finite3(f) && isfinite(pdf) && pdf >= 0 && finite3(gd_bsdf_sharp(b, wi)));
	}
	draws(u);
	if (draw() < 0.2)
		u[(int)(3 * draw())] = draw() < 0.5 ? 0 : 0.99999994f;
	for (int k = 0; k < 2; k++) {
		if (!(k ? gd_bsdf_copy(b, &last, &s) : gd_bsdf_sample(b, u, &s)))
			continue;
		assert_true(finite3(s.f) && isfinite(s.pdf) && s.pdf > 0 && isfinite(s.dw) && s.dw > 0);
		assert_true(!sane || fabsf(gd_length(s.wi) - 1) < 1e-4f);
		if (sane)
			last = s;
	}
}

static void test_wild(void **state)
{
	int ok = 0;

	(void)state;
	seed = 14;
	for (int n = 0; n < 200000; n++) {
		const struct gd_material m = {
			.base = { wild(), wild(), wild() }, .metallic = wild(), .roughness = wild(),
			.transmission = wild(), .ior = 1 + 2 * wild()
		};
		const struct gd_v3 ng = odd_direction();
		struct gd_bsdf b, c;

		ok += at(&b, &m, ng, draw() < 0.7 ? ng : odd_direction(), odd_direction());
		check_finite(&b);
		ok += gd_bsdf_turn(&c, &b, odd_direction());
		check_finite(&c);
	}
	assert_true(ok > 100000);
}

static void test_black(void **state)
{
	static const struct kind black = { "black", 0, 0.5f, 0, 1, 0 };
	struct gd_bsdf b;
	struct gd_scatter s;
	const float u[3] = { 0.3f, 0.5f, 0.7f };
	float pdf;

	(void)state;
	assert_false(seen(&b, &black, 0.7f));
	assert_false(gd_bsdf_sample(&b, u, &s));
	assert_true(gd_black(gd_bsdf_rough(&b, gd_v3(0, 0, 1), &pdf)) && pdf == 0);
	assert_true(gd_black(gd_bsdf_sharp(&b, gd_v3(0, 0, 1))) && gd_black(b.albedo));
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_values), cmocka_unit_test(test_energy),
		cmocka_unit_test(test_chances), cmocka_unit_test(test_reciprocity),
		cmocka_unit_test(test_density), cmocka_unit_test(test_copy),
		cmocka_unit_test(test_half_vector), cmocka_unit_test(test_shift),
		cmocka_unit_test(test_sides), cmocka_unit_test(test_straight),
		cmocka_unit_test(test_smooth), cmocka_unit_test(test_turn),
		cmocka_unit_test(test_frame), cmocka_unit_test(test_wild),
		cmocka_unit_test(test_black),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
