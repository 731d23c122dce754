/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Scattering events: that directions come as often as their densities say; copies to other
 * surfaces and back, Jacobians, what copies add up to; that nothing leads to infinities.
 */
#include "bsdf_case.h"

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
	while (row < ROWS - 1 && (rough ? th >= inclination((row + 1.0) / ROWS, &rate)
					: t / (1 + t) * ROWS >= row + 1))
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

static void check_density(const struct bsdf_kind *k, float z, enum gd_event event)
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
		fail_msg("%s at %g, label %d: chi square %g of %d bins", k->name, (double)z,
			 (int)event, chi, df);
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

/* |d wi / d h| by differences: wi of half vectors a little off h. < 0: there are none. */
static double difference(const struct gd_bsdf *b, const struct gd_scatter *s, double step)
{
	const struct gd_frame f = gd_frame(s->copy);
	struct gd_v3 d[2];

	for (int k = 0; k < 2; k++) {
		struct gd_scatter to[2];

		for (int j = 0; j < 2; j++) {
			struct gd_scatter from = *s;

			from.copy =
				gd_unit(gd_mad(s->copy, (float)(j ? step : -step), k ? f.x : f.y));
			if (!gd_bsdf_copy(b, &from, &to[j]))
				return -1;
		}
		d[k] = gd_sub(to[1].wi, to[0].wi);
	}
	return (double)gd_length(gd_cross(d[0], d[1])) / (4 * step * step);
}

static void check_copy(const struct gd_bsdf *a, const struct gd_bsdf *b, const char *name,
		       int *tried)
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
				other.ior = other.ior > 1 ? 1.7f : 1; /* another glass */
			if (n % 5 == 0)
				other = material(&kind[(size_t)(draw() * KINDS)]);
			if (at(&a, &m, za, za, direction()) && at(&b, &other, zb, zb, direction()))
				check_copy(&a, &b, kind[k].name, &tried);
			/* one surface, directions near each other */
			if (at(&a, &m, unturned, unturned, upper(0.7f, 1)) &&
			    gd_bsdf_turn(&b, &a, upper(0.72f, 1.02)))
				check_copy(&a, &b, kind[k].name, &tried);
			if (at(&a, &m, unturned, unturned, upper(-0.9f, 1)) &&
			    gd_bsdf_turn(&b, &a, upper(-0.92f, 1.02)))
				check_copy(&a, &b, kind[k].name, &tried);
		}
	if (tried < 15000)
		fail_msg("%d Jacobians only", tried);
}

/* The half vectors of the sharp lobes are what they are called: of wo and wi. */
static void test_half_vector(void **state)
{
	static const struct bsdf_kind glass = { "", 0, 0.18f, 1, 1.5f, 1 };
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
		near("half vector", "glass", apart(c, s.copy), 0,
		     3e-6 / fabsf(1 - eta + (eta == 1)) + 1e-4);
		n[s.event]++;
	}
	assert_true(n[GD_REFLECT] > 1000 && n[GD_TRANSMIT] > 1000);
}

/*
 * Energy at wo' from samples at wo: E[f'(to) |J| / pdf(from)] is the label's albedo at wo', if all
 * that is sampled there is sampled here, too.
 */
static void check_shift(const struct bsdf_kind *k, float za, float zb, unsigned label)
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
	const double lost =
		label == GD_ROUGH && k->transmission > 0 && k->roughness > 0.4f ? 0.05 : 0;

	near("energy of copies", k->name, sum + 0.5 * lost, own,
	     0.5 * lost + 4 * sqrt(fmax(sum2 / n - sum * sum, 0) / n + se * se) + 1e-3);
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
			if (label == GD_ROUGH ||
			    (kind[k].roughness > 0 && kind[k].transmission == 0))
				check_shift(&kind[k], 0.9f, -0.87f, label);
		}
}

/* --- whatever comes in --- */

static float wild(void)
{
	static const float odd[] = { 0,	   1,	   -1,	     0.5f,	2,   1e-8f,
				    1e30f, -1e30f, INFINITY, -INFINITY, NAN, 1.5f };

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
			assert_true(finite3(f) && isfinite(pdf) && pdf >= 0 &&
				    finite3(gd_bsdf_sharp(b, wi)));
	}
	draws(u);
	if (draw() < 0.2)
		u[(int)(3 * draw())] = draw() < 0.5 ? 0 : 0.99999994f;
	for (int k = 0; k < 2; k++) {
		if (!(k ? gd_bsdf_copy(b, &last, &s) : gd_bsdf_sample(b, u, &s)))
			continue;
		assert_true(finite3(s.f) && isfinite(s.pdf) && s.pdf > 0 && isfinite(s.dw) &&
			    s.dw > 0);
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
		const struct gd_material m = { .base = { wild(), wild(), wild() },
					      .metallic = wild(),
					      .roughness = wild(),
					      .transmission = wild(),
					      .ior = 1 + 2 * wild() };
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
	static const struct bsdf_kind black = { "black", 0, 0.5f, 0, 1, 0 };
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
		cmocka_unit_test(test_density),	    cmocka_unit_test(test_copy),
		cmocka_unit_test(test_half_vector), cmocka_unit_test(test_shift),
		cmocka_unit_test(test_wild),	    cmocka_unit_test(test_black),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
