/* SPDX-License-Identifier: BSD-3-Clause */
/* What samples add up to, against sums over them and closed forms. */
#include "film_world.h"

#include <omp.h>

/* Gradients of an image without noise are its differences, and nothing varies. */
static void test_exact(void **state)
{
	const struct world w = { .slope = 0.25 };
	const struct gd_render_conf conf = usual();
	struct gd_image im;

	(void)state;
	render(&im, &w, &conf);
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++)
			for (int c = 0; c < 3; c++) {
				assert_true(value(&im, rgb[c], x, y) == level(&w, x, y, c));
				assert_true(value(&im, name_of("variance", c), x, y) == 0);
				assert_true(value(&im, name_of("bin5", c), x, y) ==
					    level(&w, x, y, c));
				assert_true(value(&im, name_of("dx", c), x, y) ==
					    (x < W - 1 ? 0.25 : 0));
				assert_true(value(&im, name_of("dy", c), x, y) ==
					    (y < H - 1 ? 0.5 : 0));
				assert_true(value(&im, name_of("bin7.dy", c), x, y) ==
					    (y < H - 1 ? 0.5 : 0));
				assert_true(value(&im, name_of("dx.variance", c), x, y) == 0);
			}
	assert_true(value(&im, "albedo.R", 3, 4) == 0.25);
	assert_true(value(&im, "N.Y", 3, 4) == 1);
	assert_true(value(&im, "Z", 3, 4) == 3);
	assert_true(value(&im, "P.X", 3, 4) == 3);
	assert_true(has(&im, "albedo.variance.B"));
	assert_false(has(&im, "N.variance.X"));
	assert_false(has(&im, "Z.variance"));
	assert_false(has(&im, "samples"));
	assert_false(has(&im, "half0.samples"));
	assert_false(has(&im, "dx.samples"));
	gd_image_free(&im);
}

/* Means, variances and bins against sums over the very samples. */
static void check_pixel(const struct gd_image *im, const struct world *w, uint64_t seed, int x,
			int y, int n, int bins)
{
	double sum[3] = { 0 }, square[3] = { 0 }, bin[64][3] = { { 0 } };
	char layer[16];

	for (int s = 0; s < n; s++)
		for (int c = 0; c < 3; c++) {
			const double v =
				(double)(float)contribution(w, x, y, c, drawn(seed, x, y, s));

			sum[c] += v / n;
			bin[s % bins][c] += v / (n / bins + (s % bins < n % bins));
		}
	for (int s = 0; s < n; s++)
		for (int c = 0; c < 3; c++) {
			const double v =
				(double)(float)contribution(w, x, y, c, drawn(seed, x, y, s));

			square[c] += (v - sum[c]) * (v - sum[c]) / n / (n - 1);
		}
	for (int c = 0; c < 3; c++) {
		near(value(im, rgb[c], x, y), sum[c], 1e-6, rgb[c], x, y);
		near(value(im, name_of("variance", c), x, y), square[c], 1e-6 * square[c] + 1e-12,
		     "variance", x, y);
		for (int b = 0; b < bins; b++) {
			snprintf(layer, sizeof layer, "bin%d", b);
			near(value(im, name_of(layer, c), x, y), bin[b][c], 1e-6, layer, x, y);
		}
	}
}

/* The same for the gradient to the right: the difference of two means over their own samples. */
static double half_sum(const struct world *w, uint64_t seed, int x, int y, int to, int n, double r,
		       int c, double *variance)
{
	double sum = 0, square = 0;

	for (int s = 0; s < n; s++) {
		const double u = drawn(seed, x, y, s);

		sum += (contribution(w, x + to, y, c, u) - contribution(w, x, y, c, u)) / (1 + r) /
		       n;
	}
	for (int s = 0; s < n; s++) {
		const double u = drawn(seed, x, y, s);
		const double d = (contribution(w, x + to, y, c, u) - contribution(w, x, y, c, u)) /
				 (1 + r) - sum;

		square += d * d / n / (n - 1);
	}
	*variance = square;
	return sum;
}

static void test_moments(void **state)
{
	const struct world w = { .slope = 0.1, .noise = 2, .curve = 0.5 };
	const struct gd_render_conf conf = usual();
	struct gd_image im;

	(void)state;
	render(&im, &w, &conf);
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W - 1; x++) {
			check_pixel(&im, &w, conf.seed, x, y, 16, 8);
			for (int c = 0; c < 3; c++) {
				double a, b,
					d = half_sum(&w, conf.seed, x, y, 1, 16, 1, c, &a) -
					    half_sum(&w, conf.seed, x + 1, y, -1, 16, 1, c, &b);

				near(value(&im, name_of("dx", c), x, y), d, 2e-6, "dx", x, y);
				near(value(&im, name_of("dx.variance", c), x, y), a + b,
				     1e-5 * (a + b) + 1e-9, "dx.variance", x, y);
			}
		}
	gd_image_free(&im);
}

static void test_bins_average_to_the_mean(void **state)
{
	const struct world w = { .slope = 0.1, .noise = 2, .curve = 0.5 };
	static const char *const layer[] = { "", "dx", "dy" };
	struct gd_render_conf conf = usual();
	struct gd_image im;

	(void)state;
	conf.bins = 4;
	render(&im, &w, &conf);
	for (int k = 0; k < 3; k++)
		for (int c = 0; c < 3; c++)
			for (int y = 0; y < H; y++)
				for (int x = 0; x < W; x++) {
					double sum = 0;
					char name[40];

					for (int b = 0; b < 4; b++) {
						snprintf(name, sizeof name, "bin%d%s%s", b,
							 *layer[k] ? "." : "", layer[k]);
						sum += value(&im, name_of(name, c), x, y) / 4;
					}
					near(sum, value(&im, name_of(layer[k], c), x, y), 2e-6,
					     layer[k], x, y);
				}
	gd_image_free(&im);
}

static void same(const struct gd_image *a, const struct gd_image *b, int x0, int y0, int skip)
{
	assert_int_equal(a->nchan, b->nchan);
	for (int i = 0; i < b->nchan; i++) {
		const char *name = b->chan[i].name;
		const struct gd_plane p = plane(a, name), q = plane(b, name);

		for (int y = 0; y < b->h - skip; y++)
			for (int x = 0; x < b->w - skip; x++)
				if (gd_row(p, y + y0)[x + x0] != gd_row(q, y)[x])
					fail_msg("%s differs at (%d, %d)", name, x, y);
	}
}

static void test_same_bits(void **state)
{
	const struct world w = { .slope = 0.1, .noise = 2, .curve = 0.5 };
	struct maps m = uneven(W, H, true);
	struct gd_render_conf conf = usual();
	struct gd_image one, im;
	int threads = omp_get_max_threads();

	(void)state;
	conf.counts = m.counts;
	conf.shares = m.shares;
	omp_set_num_threads(1);
	render(&one, &w, &conf);
	for (int n = 2; n < 5; n++) {
		omp_set_num_threads(n);
		render(&im, &w, &conf);
		same(&one, &im, 0, 0, 0);
		gd_image_free(&im);
	}
	omp_set_num_threads(threads);
	gd_image_free(&one);
	free_maps(&m);
}

static void test_crop(void **state)
{
	const struct world w = { .slope = 0.1, .noise = 2, .curve = 0.5 };
	struct gd_render_conf conf = usual();
	struct gd_image whole, part;

	(void)state;
	render(&whole, &w, &conf);
	conf.crop = (struct gd_box){ 5, 3, 14, 11 };
	render(&part, &w, &conf);
	assert_int_equal(part.w, 10);
	assert_int_equal(part.h, 9);
	assert_int_equal(part.data.x0, 5);
	assert_int_equal(part.data.y1, 11);
	assert_int_equal(part.display.x1, W - 1);
	same(&whole, &part, 5, 3, 1);
	assert_true(value(&part, "dx.R", 9, 0) == 0);
	assert_true(value(&part, "dy.G", 0, 8) == 0);
	near(value(&part, "B", 9, 8), value(&whole, "B", 14, 11), 0, "B", 9, 8);
	gd_image_free(&whole);
	gd_image_free(&part);
}

/* Sums of what is expected to be 0 with variance 1. */
struct chi {
	double n, sum, square;
};

static void add(struct chi *c, double error, double variance)
{
	assert_true(variance > 0);
	c->n++;
	c->sum += error / sqrt(variance);
	c->square += error * error / variance;
}

/* The mean of n squares of a distribution of kurtosis below 3 varies by less than 2 / n. */
static void check_chi(const struct chi *c, const char *what)
{
	if (fabs(c->sum) > 4.5 * sqrt(c->n))
		fail_msg("%s: off by %.2f standard errors", what, c->sum / sqrt(c->n));
	if (fabs(c->square / c->n - 1) > 4.5 * sqrt(2 / c->n))
		fail_msg("%s: squares of %.4f, expected 1 +- %.4f", what, c->square / c->n,
			 sqrt(2 / c->n));
}

/* Variance of the mean of n halves of the edge from one pixel to another. */
static double half_variance(const struct world *w, int x, int y, int u, int v, int c, double r,
			    double n)
{
	const double d = spread(w, u, v, c) - spread(w, x, y, c);

	return d * d / 12 / (1 + r) / (1 + r) / n;
}

/* Gradients of one direction with any counts and
 * shares: against what they are and how they vary. */
static void check_gradients(const struct gd_image *im, const struct world *w,
			    const struct gd_render_conf *conf, int dx, struct chi *chi)
{
	const struct gd_plan plan = gd_plan(conf);
	const char *layer = dx ? "dx" : "dy";
	const int dy = !dx;
	struct gd_plane got[3];

	for (int c = 0; c < 3; c++)
		got[c] = plane(im, name_of(layer, c));
	for (int y = 0; y < im->h - dy; y++)
		for (int x = 0; x < im->w - dx; x++) {
			const int u = x + dx, v = y + dy;
			const double n = gd_plan_samples(&plan, x, y),
				     m = gd_plan_samples(&plan, u, v);
			const double a = gd_plan_traced_of(&plan, gd_plan_share(&plan, x, y),
							   (uint32_t)n);
			const double b = gd_plan_traced_of(&plan, gd_plan_share(&plan, u, v),
							   (uint32_t)m);

			if (!(n > 0 && m > 0)) {
				near((double)gd_row(got[0], y)[x], 0, 0, layer, x, y);
				continue;
			}
			for (int c = 0; c < 3; c++) {
				const double s = spread(w, x, y, c), t = spread(w, u, v, c);
				const double error = (double)gd_row(got[c], y)[x] -
						     (level(w, u, v, c) - level(w, x, y, c));

				add(chi, error, a > 0 && b > 0 ?
					half_variance(w, x, y, u, v, c, b / a, a) +
					half_variance(w, u, v, x, y, c, a / b, b) :
					s * s / 12 / n + t * t / 12 / m);
			}
		}
}

/* Unbiased, whatever the counts and shares of neighbours, and as noisy as the theory says. */
static void test_uneven_gradients(void **state)
{
	const struct world w = { .slope = 0.1, .noise = 2, .curve = 0.5 };

	(void)state;
	for (int holes = 0; holes < 2; holes++) {
		struct maps m = uneven(W, H, holes);
		struct gd_render_conf conf = usual();
		struct chi dx = { 0 }, dy = { 0 };

		conf.counts = m.counts;
		conf.shares = m.shares;
		for (conf.seed = 1; conf.seed <= 20; conf.seed++) {
			struct gd_image im;

			render(&im, &w, &conf);
			check_gradients(&im, &w, &conf, 1, &dx);
			check_gradients(&im, &w, &conf, 0, &dy);
			gd_image_free(&im);
		}
		check_chi(&dx, "dx");
		check_chi(&dy, "dy");
		free_maps(&m);
	}
}

/* Variances that are told, in the mean over seeds, against those over seeds. */
static void test_told_variances(void **state)
{
	const struct world w = { .slope = 0.1, .noise = 2, .curve = 0.5 };
	struct maps m = uneven(W, H, false);
	struct gd_render_conf conf = usual();
	double told = 0, seen = 0;

	(void)state;
	conf.counts = m.counts;
	conf.shares = m.shares;
	for (conf.seed = 1; conf.seed <= 20; conf.seed++) {
		struct gd_image im;

		render(&im, &w, &conf);
		for (int y = 0; y < H; y++)
			for (int x = 0; x < W - 1; x++) {
				const double d = value(&im, "dx.G", x, y) -
						 (level(&w, x + 1, y, 1) - level(&w, x, y, 1));

				told += value(&im, "dx.variance.G", x, y);
				seen += d * d;
			}
		gd_image_free(&im);
	}
	near(told / seen, 1, 0.05, "told over seen", 0, 0);
	free_maps(&m);
}

static void test_counts(void **state)
{
	const struct world w = { .slope = 0.1, .noise = 2, .curve = 0.5 };
	struct maps m = uneven(W, H, true);
	struct gd_render_conf conf = usual();
	struct gd_image im;
	double sum = 0, spp = 0;

	(void)state;
	conf.counts = m.counts;
	render(&im, &w, &conf);
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++) {
			const int n = (int)gd_row(m.counts, y)[x];
			int even = 0;

			for (int s = 0; s < n; s++)
				even += s % 8 % 2 == 0;
			near(value(&im, "samples", x, y), n, 0, "samples", x, y);
			near(value(&im, "half0.samples", x, y), even, 0, "half0.samples", x, y);
			near(value(&im, "half1.samples", x, y), n - even, 0, "half1.samples", x, y);
			sum += n;
			if (n == 0) {
				near(value(&im, "R", x, y), 0, 0, "R", x, y);
				near(value(&im, "bin3.R", x, y), 0, 0, "bin3.R", x, y);
				near(value(&im, "albedo.R", x, y), 0, 0, "albedo.R", x, y);
				near(value(&im, "dx.R", x, y), 0, 0, "dx.R", x, y);
			}
			if (n == 1)
				near(value(&im, "bin4.G", x, y), value(&im, "G", x, y), 0, "bin4",
				     x, y);
			/* three samples: bins 0 and 2 of one side, 1 of the other */
			if (n == 3) {
				const double a = value(&im, "bin0.G", x, y),
					     b = value(&im, "bin2.G", x, y);

				near(value(&im, "bin6.G", x, y), (a + b) / 2, 1e-6, "bin6", x, y);
				near(value(&im, "bin5.G", x, y), value(&im, "bin1.G", x, y), 0,
				     "bin5", x, y);
			}
			assert_true(value(&im, "variance.R", x, y) > 0);
		}
	assert_true(gd_attr_number(&im, "gd:samplesPerPixel", &spp));
	near(spp, sum / (W * H), 1e-6, "gd:samplesPerPixel", 0, 0);
	assert_false(has(&im, "dx.samples"));	/* what the samples say already */
	gd_image_free(&im);
	conf.shares = m.shares;
	render(&im, &w, &conf);
	assert_true(has(&im, "dx.samples"));
	gd_image_free(&im);
	conf.shares.v = NULL;
	conf.share = 0;
	render(&im, &w, &conf);
	assert_false(has(&im, "dx.R"));
	assert_false(has(&im, "bin0.dy.R"));
	gd_image_free(&im);
	free_maps(&m);
}

/* One sample a pixel tells no variance. */
static void test_one_sample(void **state)
{
	const struct world w = { .slope = 0.1, .noise = 2 };
	struct gd_render_conf conf = usual();
	struct gd_image im;

	(void)state;
	conf.spp = 1;
	render(&im, &w, &conf);
	assert_true(has(&im, "dx.R"));
	assert_false(has(&im, "variance.R"));
	assert_false(has(&im, "dx.variance.R"));
	assert_false(has(&im, "albedo.variance.B"));
	gd_image_free(&im);
	conf.bins = 0;
	render(&im, &w, &conf);
	assert_false(has(&im, "bin0.R"));
	gd_image_free(&im);
}

/* With the neighbours' offset paths: the same image, less noise, and the variance says so. */
static void test_reuse(void **state)
{
	const struct world w = { .slope = 0.1, .noise = 2, .curve = 0.5 };
	struct maps m = uneven(W, H, false);
	struct gd_render_conf conf = usual();
	double told = 0, seen = 0, bins = 0, plain = 0;
	struct chi mean = { 0 };

	(void)state;
	conf.counts = m.counts;
	conf.reuse = true;
	for (int shares = 0; shares < 2; shares++) {
		if (shares)
			conf.shares = m.shares;
		for (conf.seed = 1; conf.seed <= 20; conf.seed++) {
			struct gd_image im;

			render(&im, &w, &conf);
			for (int y = 0; y < H; y++)
				for (int x = 0; x < W; x++) {
					const double d = value(&im, "G", x, y) - level(&w, x, y, 1);
					const double s = spread(&w, x, y, 1);

					told += value(&im, "variance.G", x, y);
					seen += d * d;
					plain += s * s / 12 / (double)gd_row(m.counts, y)[x];
					bins += value(&im, "bin3.G", x, y) - level(&w, x, y, 1);
					mean.n++;
					mean.sum += d;
				}
			gd_image_free(&im);
		}
	}
	near(mean.sum / mean.n, 0, 4.5 * sqrt(seen / mean.n / mean.n * 3), "bias", 0, 0);
	near(bins / mean.n, 0, 4.5 * sqrt(8 * 3 * plain / mean.n / mean.n), "bias of a bin", 0, 0);
	near(told / seen, 1, 0.05, "told over seen", 0, 0);
	assert_true(seen < 0.9 * plain);
	free_maps(&m);
}

static void test_time(void **state)
{
	const struct world w = { .slope = 0.1, .noise = 2, .pause = 50 };
	struct gd_render_conf conf = usual();
	struct gd_image im;
	double start, spent, spp;

	(void)state;
	conf.spp = 0;
	conf.seconds = 1;
	start = gd_seconds();
	render(&im, &w, &conf);
	spent = gd_seconds() - start;
	assert_true(spent > 0.4 && spent < 2.5);	/* machines have other work */
	assert_true(gd_attr_number(&im, "gd:samplesPerPixel", &spp) && spp > 4);
	for (int y = 0; y < H; y++)		/* many rounds: what one of them gives */
		check_pixel(&im, &w, conf.seed, 3, y, (int)spp, 8);
	gd_image_free(&im);
	conf.spp = 3;		/* the most */
	conf.seconds = 100;
	render(&im, &w, &conf);
	assert_true(gd_attr_number(&im, "gd:samplesPerPixel", &spp) && spp == 3);
	gd_image_free(&im);
}

/* Every round in a visit of its own: as good as one visit. */
static void test_rounds(void **state)
{
	const struct world w = { .slope = 0.1, .noise = 2, .curve = 3 };
	struct gd_film film = { 0 };
	struct gd_visit v;
	double sum = 0, square = 0;
	const int slot[4] = { 0, 1, 2, 3 };

	(void)state;
	assert_int_equal(gd_film_begin(&film, 2, 1, 4, false, NULL), GD_OK);
	for (int s = 0; s < 40; s++) {
		struct gd_path_in in = { .w = 2, .h = 1, .x = 1, .n = 4, .r = { 1, 1, 1, 1 } };
		struct gd_draw d = gd_draw_start(1, 1, 0, (uint32_t)s);
		struct gd_path_out out;

		sample(&w, NULL, &in, &d, &out);
		gd_visit_begin(&v, &film);
		gd_visit_add(&v, &film, &out, s % 4 ? 0 : 4, slot, s % 4);
		gd_film_store(&film, 1, 0, &v);
		sum += (double)out.colour.y / 40;
	}
	for (int s = 0; s < 40; s++) {
		const double d = contribution(&w, 1, 0, 1, drawn(1, 1, 0, s)) - sum;

		square += d * d / 40 / 39;
	}
	near((double)gd_film_mean(&film, 1, 0)[1], sum, 1e-6, "mean", 1, 0);
	near(gd_film_variance(&film, 1, 0, 1, 40), square, 1e-5 * square, "variance", 1, 0);
	assert_int_equal(gd_film_count(&film, 1, 0)[0], 40);
	assert_int_equal(gd_film_count(&film, 1, 0)[1], 10);
	assert_int_equal(gd_film_count(&film, 1, 0)[2 + 2 * 3], 10);
	assert_int_equal(gd_film_count(&film, 1, 0)[2 + 2 * 3 + 1], 0);
	assert_int_equal(gd_film_count(&film, 0, 0)[0], 0);
	gd_film_free(&film);
}

/* Fireflies whose squares are beyond floats. */
static void firefly(const void *user, const struct gd_path_conf *conf, const struct gd_path_in *in,
		    struct gd_draw *draw, struct gd_path_out *out)
{
	sample(user, conf, in, draw, out);
	if (in->x == 3 && in->y == 4)
		out->colour.x = gd_draw(draw) < 0.5f ? 1e30f : 3e38f;
	for (int k = 0; k < in->n && in->x == 3; k++)
		out->half[k].x = gd_draw(draw) < 0.5f ? 3e38f : -3e38f;
}

static void test_fireflies(void **state)
{
	const struct world w = { .slope = 0.1, .noise = 2 };
	const struct gd_render_conf conf = usual();
	struct gd_image im = { 0 };
	struct gd_err err = { 0 };

	(void)state;
	assert_int_equal(gd_render_samples(&im, firefly, &w, &conf, NULL, &err), GD_OK);
	for (int i = 0; i < im.nchan; i++)
		for (int y = 0; y < H; y++)
			for (int x = 0; x < W; x++)
				assert_true(isfinite(value(&im, im.chan[i].name, x, y)));
	assert_true(value(&im, "R", 3, 4) > 1e29);
	assert_true(value(&im, "variance.R", 3, 4) > 1e36);
	gd_image_free(&im);
}

/* ---- pairs ---- */

static void test_pairs(void **state)
{
	const struct world w = { .slope = 0.1, .noise = 2, .curve = 0.5 };
	struct maps m = uneven(W, H, false);
	struct gd_pairs pairs = chessboard(W, H);
	struct gd_render_conf conf = usual();
	const struct gd_plan plan = gd_plan(&conf);
	struct gd_image im, part;
	struct chi chi = { 0 };

	(void)state;
	conf.counts = m.counts;
	conf.pairs = &pairs;
	assert_int_equal(gd_plan_layers(&plan), 2);
	for (conf.seed = 1; conf.seed <= 20; conf.seed++) {
		render(&im, &w, &conf);
		assert_false(has(&im, "dx.R"));
		assert_false(has(&im, "pair2.R"));
		for (int y = 0; y < H - 2; y++)
			for (int x = 0; x < W - 1; x++) {
				const double a = (double)gd_row(m.counts, y)[x];
				const double b = (double)gd_row(m.counts, y + 2)[x + 1];
				const double d = level(&w, x + 1, y + 2, 1) - level(&w, x, y, 1);

				near(value(&im, "pair0.x", x, y), 1, 0, "pair0.x", x, y);
				near(value(&im, "pair0.y", x, y), 2, 0, "pair0.y", x, y);
				add(&chi, value(&im, "pair0.G", x, y) - d,
				    half_variance(&w, x, y, x + 1, y + 2, 1, b / a, a) +
				    half_variance(&w, x + 1, y + 2, x, y, 1, a / b, b));
			}
		assert_true(value(&im, "pair1.x", W - 2, 0) == 0);
		gd_image_free(&im);
	}
	check_chi(&chi, "pair0");
	conf.counts.v = NULL;
	conf.seed = 3;
	render(&im, &w, &conf);
	conf.crop = (struct gd_box){ 5, 3, 14, 11 };
	render(&part, &w, &conf);
	assert_true(value(&part, "pair0.G", 2, 2) == value(&im, "pair0.G", 7, 5));
	assert_true(value(&part, "pair0.y", 2, 8) == 0);
	gd_image_free(&im);
	gd_image_free(&part);
	free_chessboard(&pairs);
	free_maps(&m);
}

/* ---- what is refused ---- */

static void refused(struct gd_render_conf conf, int code, const char *words)
{
	const struct world w = { 0 };
	struct gd_image im = { 0 };
	struct gd_err err = { 0 };

	assert_int_equal(gd_render_samples(&im, sample, &w, &conf, NULL, &err), code);
	if (!strstr(err.text, words))
		fail_msg("%s", err.text);
	assert_int_equal(im.nchan, 0);
}

static void test_refused(void **state)
{
	struct gd_render_conf conf = usual();
	struct gd_pairs pairs = chessboard(W, H);
	struct maps m = uneven(W, H, true);

	(void)state;
	conf.bins = 1;
	refused(conf, GD_EARG, "1 bins");
	conf = usual();
	conf.spp = 0;
	refused(conf, GD_EARG, "0 samples a pixel");
	conf = usual();
	conf.crop.x1 = W;
	refused(conf, GD_EARG, "a crop of (0, 0) to (24, 16) in 24 x 17 pixels");
	conf = usual();
	conf.share = 1.5;
	refused(conf, GD_EARG, "a share of 1.5");
	conf = usual();
	conf.counts = m.counts;
	gd_row(m.counts, 2)[1] = 2.5f;
	refused(conf, GD_EARG, "2.5 samples at (1, 2)");
	conf.crop.x0 = 1;
	refused(conf, GD_EARG, "not 23 x 17");
	conf = usual();
	conf.pairs = &pairs;
	pairs.dy[1][2 * W + 3] = -3;
	refused(conf, GD_EARG, "pair1 is 2,-3 at pixel 3,2: expected no more than 2");
	conf = usual();
	conf.w = conf.h = 65536;
	conf.crop.x1 = conf.crop.y1 = 65535;
	refused(conf, GD_ENOMEM, "GB");
	free_chessboard(&pairs);
	free_maps(&m);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_exact),
		cmocka_unit_test(test_moments),
		cmocka_unit_test(test_bins_average_to_the_mean),
		cmocka_unit_test(test_same_bits),
		cmocka_unit_test(test_crop),
		cmocka_unit_test(test_uneven_gradients),
		cmocka_unit_test(test_told_variances),
		cmocka_unit_test(test_counts),
		cmocka_unit_test(test_one_sample),
		cmocka_unit_test(test_reuse),
		cmocka_unit_test(test_time),
		cmocka_unit_test(test_rounds),
		cmocka_unit_test(test_fireflies),
		cmocka_unit_test(test_pairs),
		cmocka_unit_test(test_refused),
	};

	return cmocka_run_group_tests_name("render", tests, NULL, NULL);
}
