/* SPDX-License-Identifier: BSD-3-Clause */
/* Passes of different counts and shares, merged. */
#include "film_world.h"

#include "merge.h"

/* n images become one, and are freed. */
static void merge(struct gd_image *out, struct gd_image *in, int n)
{
	const struct gd_merge_conf conf = { .bins = -1 };
	struct gd_merge *m = NULL;
	struct gd_err err = { 0 };
	int rc = gd_merge_begin(&m, &conf, &err);

	*out = (struct gd_image){ 0 };
	for (int i = 0; i < n && rc == GD_OK; i++)
		rc = gd_merge_survey(m, &in[i], "pass", 0, &err);
	if (rc == GD_OK)
		rc = gd_merge_plan(m, NULL, &err);
	for (int i = 0; i < n && rc == GD_OK; i++) {
		rc = gd_merge_want(m, i, &in[i], &err);
		if (rc == GD_OK)
			rc = gd_merge_add(m, i, &in[i], NULL, &err);
	}
	if (rc == GD_OK)
		rc = gd_merge_finish(m, out, NULL, NULL, &err);
	if (rc != GD_OK)
		fail_msg("%s", err.text);
	gd_merge_free(m);
	for (int i = 0; i < n; i++)
		gd_image_free(&in[i]);
}

/* Counts of another pattern, with runs of holes. */
static void turn(struct maps *m, int by)
{
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++) {
			const int k = (by * x + 7 * y + by * x * y) % 11;

			gd_row(m->counts, y)[x] = (float)(k < 4 ? 0 : k - 3);
			gd_row(m->shares, y)[x] = k % 3 ? 1 : 0.3f;
		}
}

/* What is seen and told of one channel over seeds. */
struct seen {
	double n, bias, square, told;
};

static void see(struct seen *s, const struct gd_image *im, const char *layer,
		const struct world *w, int dx, int dy)
{
	const struct gd_plane p = plane(im, name_of(layer, 1));
	struct gd_plane var;
	char variance[32];

	snprintf(variance, sizeof variance, "%s%svariance", layer, *layer ? "." : "");
	var = plane(im, name_of(variance, 1));
	for (int y = 0; y < H - dy; y++)
		for (int x = 0; x < W - dx; x++) {
			const double here = dx || dy ? level(w, x, y, 1) : 0;
			const double d =
				(double)gd_row(p, y)[x] + here - level(w, x + dx, y + dy, 1);

			s->n++;
			s->bias += d;
			s->square += d * d;
			s->told += (double)gd_row(var, y)[x];
		}
}

/* The sum of a bin's errors. */
static double bin_bias(const struct gd_image *im, const char *name, const struct world *w, int dx,
		       int dy)
{
	const struct gd_plane p = plane(im, name);
	double sum = 0;

	for (int y = 0; y < H - dy; y++)
		for (int x = 0; x < W - dx; x++)
			sum += (double)gd_row(p, y)[x] + level(w, x, y, 1) -
			       level(w, x + dx, y + dy, 1);
	return sum;
}

static void check_seen(const struct seen *s, const char *what)
{
	near(s->bias / s->n, 0, 4.5 * sqrt(s->square) / s->n, what, 0, 0);
	near(s->told / s->square, 1, 0.06, what, 1, 1);
}

/*
 * Three adaptive passes, merged as they come: colours, gradients and bins stay right, variances
 * honest, and no pass makes a gradient worse.
 */
static void test_adaptive_passes(void **state)
{
	const struct world w = { .slope = 0.1, .noise = 2, .curve = 0.5 };
	struct maps second = uneven(W, H, true), third = uneven(W, H, true);
	struct seen colour = { 0 }, dx = { 0 }, dy = { 0 }, first = { 0 };
	struct gd_render_conf conf = usual();
	double bins = 0, half = 0;

	(void)state;
	turn(&third, 3);
	for (int seed = 0; seed < 20; seed++) {
		struct gd_image in[2], out;

		conf.spp = 8;
		conf.counts.v = conf.shares.v = NULL;
		conf.seed = (uint64_t)(100 + 3 * seed);
		render(&in[0], &w, &conf);
		see(&first, &in[0], "dx", &w, 1, 0);
		for (int pass = 0; pass < 2; pass++) {
			conf.counts = (pass ? third : second).counts;
			conf.shares = (pass ? third : second).shares;
			conf.seed++;
			render(&in[1], &w, &conf);
			merge(&out, in, 2);
			in[0] = out;
		}
		assert_true(has(&out, "dx.samples"));
		see(&colour, &out, "", &w, 0, 0);
		see(&dx, &out, "dx", &w, 1, 0);
		see(&dy, &out, "dy", &w, 0, 1);
		bins += bin_bias(&out, "bin5.dx.G", &w, 1, 0);
		half += bin_bias(&out, "bin2.dy.G", &w, 0, 1);
		gd_image_free(&out);
	}
	check_seen(&colour, "colour");
	check_seen(&dx, "dx");
	check_seen(&dy, "dy");
	near(bins / dx.n, 0, 4.5 * sqrt(8 * 2 * dx.square) / dx.n, "bin5.dx", 0, 0);
	near(half / dy.n, 0, 4.5 * sqrt(8 * 2 * dy.square) / dy.n, "bin2.dy", 0, 0);
	assert_true(dx.square / dx.n < 0.9 * first.square / first.n);
	free_maps(&second);
	free_maps(&third);
}

/* Two even passes are the mean of both; pairs have to be the same. */
static void test_even_passes(void **state)
{
	const struct world w = { .slope = 0.1, .noise = 2, .curve = 0.5 };
	static const char *const name[] = { "R", "bin3.G", "pair0.R", "bin4.pair1.B", "albedo.B" };
	struct gd_pairs pairs = chessboard(W, H);
	struct gd_render_conf conf = usual();
	struct gd_image in[2], out;
	double want[5][2];

	(void)state;
	conf.pairs = &pairs;
	for (int i = 0; i < 2; i++) {
		conf.seed = (uint64_t)(i + 1);
		render(&in[i], &w, &conf);
		for (int k = 0; k < 5; k++)
			want[k][i] = value(&in[i], name[k], 7, 5);
	}
	merge(&out, in, 2);
	for (int k = 0; k < 5; k++)
		near(value(&out, name[k], 7, 5), (want[k][0] + want[k][1]) / 2, 1e-6, name[k], 7,
		     5);
	near(value(&out, "samples", 7, 5), 32, 0, "samples", 7, 5);
	near(value(&out, "pair0.x", 7, 5), 1, 0, "pair0.x", 7, 5);
	near(value(&out, "pair0.y", 7, 5), 2, 0, "pair0.y", 7, 5);
	assert_true(has(&out, "pair0.variance.R"));
	assert_false(has(&out, "pair0.samples"));
	gd_image_free(&out);
	free_chessboard(&pairs);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_adaptive_passes),
		cmocka_unit_test(test_even_passes),
	};

	return cmocka_run_group_tests_name("passes", tests, NULL, NULL);
}
