/* SPDX-License-Identifier: BSD-3-Clause */
/* Materials and points of view that the tests of scattering share. */
#ifndef GD_TEST_BSDF_CASE_H
#define GD_TEST_BSDF_CASE_H

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>

#include "render/bsdf.h"

#define PI 3.14159265358979

struct bsdf_kind {
	const char *name;
	float metallic, roughness, transmission, ior, base;
};

static const struct bsdf_kind kind[] = {
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

static inline double draw(void)
{
	seed = seed * 6364136223846793005u + 1442695040888963407u;
	return (double)(seed >> 40) / (1 << 24);
}

static inline void draws(float u[3])
{
	for (int k = 0; k < 3; k++)
		u[k] = (float)draw();
}

static inline struct gd_v3 direction(void)
{
	const double z = 2 * draw() - 1, r = sqrt(1 - z * z), p = 2 * PI * draw();

	return gd_v3((float)(r * cos(p)), (float)(r * sin(p)), (float)z);
}

static const struct gd_v3 unturned = { 0, 0, 1 };

static inline bool at(struct gd_bsdf *b, const struct gd_material *m, struct gd_v3 ng,
		      struct gd_v3 ns, struct gd_v3 wo)
{
	struct gd_material mat = *m;
	struct gd_triangle triangle = { .light = GD_NO_INDEX };
	const struct gd_scene scene = {
		.material = &mat, .nmaterial = 1, .triangle = &triangle, .ntriangle = 1 };
	const struct gd_hit hit = { .ng = ng, .ns = ns };

	mat.base_map = mat.rough_map = mat.emission_map = GD_NO_INDEX;
	return gd_bsdf_at(b, &scene, &hit, wo);
}

static inline struct gd_material material(const struct bsdf_kind *k)
{
	return (struct gd_material){ .base = { k->base, k->base, k->base },
				    .metallic = k->metallic,
				    .roughness = k->roughness,
				    .transmission = k->transmission,
				    .ior = k->ior };
}

/* A surface whose normal is (0, 0, 1), seen at the cosine z. */
static inline bool seen(struct gd_bsdf *b, const struct bsdf_kind *k, float z)
{
	const struct gd_material m = material(k);

	return at(b, &m, unturned, unturned,
		  gd_v3(0.6f * sqrtf(1 - z * z), 0.8f * sqrtf(1 - z * z), z));
}

static inline void near(const char *what, const char *name, double a, double b, double most)
{
	if (!(fabs(a - b) <= most))
		fail_msg("%s, %s: %.9g and %.9g, %.3g apart, %.3g allowed", name, what, a, b,
			 fabs(a - b), most);
}

/* Albedo of labels (bits) by sampling, with the standard error of it. */
static inline double sampled(const struct gd_bsdf *b, int n, unsigned labels, double *se)
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
static inline double azimuth(double x, double *rate)
{
	*rate = 2 * PI * (1 - 0.95 * cos(4 * PI * x));
	return atan2(0.8, 0.6) + 2 * PI * x - 0.5 * 0.95 * sin(4 * PI * x);
}

/* The same for the angle from the normal; dense about the poles and where the sides meet. */
static inline double inclination(double x, double *rate)
{
	*rate = PI * (1 - 0.8 * cos(4 * PI * x));
	return PI * x - 0.2 * sin(4 * PI * x);
}

static inline double apart(struct gd_v3 a, struct gd_v3 b)
{
	return (double)gd_length(gd_sub(a, b));
}

static inline struct gd_v3 upper(float z, double turn)
{
	const double r = sqrt(1 - z * z);

	return gd_v3((float)(r * cos(turn)), (float)(r * sin(turn)), z);
}

#endif
