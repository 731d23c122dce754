/* SPDX-License-Identifier: BSD-3-Clause */
/* Merged buffers against sums over the very samples that the inputs were made of. */
#include <stdlib.h>
#include <string.h>

#include "merge_make.h"

#define MAXIN 24

/* Sample k of channel c at a pixel: a skewed value that depends on nothing else. */
static double sample(int x, int y, int c, int k)
{
	uint32_t s = (uint32_t)(x + 31 * y + 977 * c + 7919 * k) * 2654435761u;

	s = (s ^ (s >> 15)) * 2246822519u;
	s = (s ^ (s >> 13)) * 3266489917u;
	return exp(3 * ((s >> 8) / 16777216.0)) / 5;
}

static bool has(const struct gd_image *im, const char *name)
{
	return gd_image_find(im, name) >= 0;
}

/* Samples first .. first + n - 1 as a render of them: means, and variances of a kind. */
static void render(struct gd_image *im, const char *layer, const char *variances, int c, int x,
		   int y, int first, int n, enum gd_variance kind)
{
	double sum = 0, sum2 = 0, mean, s2;
	char name[64];
	struct gd_plane p;

	for (int k = first; k < first + n; k++) {
		sum += sample(x, y, c, k);
		sum2 += sample(x, y, c, k) * sample(x, y, c, k);
	}
	mean = n ? sum / n : 0;
	s2 = n > 1 ? (sum2 - n * mean * mean) / (n - 1) : 0;
	snprintf(name, sizeof name, "%s%s", layer, rgb[c]);
	if (!gd_image_plane(im, name, &p))
		p = put(im, name);
	gd_row(p, y)[x] = (float)mean;
	if (!variances)
		return;
	snprintf(name, sizeof name, "%s%s%s", variances, kind == GD_VARIANCE_M2 ? layer : "",
		 rgb[c]);
	if (!gd_image_plane(im, name, &p))
		p = put(im, name);
	gd_row(p, y)[x] = (float)(kind == GD_VARIANCE_MEAN     ? s2 / n
				  : kind == GD_VARIANCE_SAMPLE ? s2
							       : sum2 / n);
}

/* Samples of input i at a pixel of an adaptive pass: 2 to 12. */
static int adaptive(int i, int x, int y)
{
	return i ? 2 + (3 * x + 5 * y + i) % 11 : 4;
}

static void make_adaptive(struct gd_image *in, int n, const char *variances, enum gd_variance kind)
{
	int first[H][W] = { { 0 } };

	for (int i = 0; i < n; i++) {
		gd_image_init(&in[i], W, H);
		put(&in[i], "samples");
		for (int y = 0; y < H; y++)
			for (int x = 0; x < W; x++) {
				int k = adaptive(i, x, y);
				struct gd_plane p;

				gd_image_plane(&in[i], "samples", &p);
				gd_row(p, y)[x] = (float)k;
				for (int c = 0; c < 3; c++)
					render(&in[i], "", variances, c, x, y, first[y][x], k,
					       kind);
				first[y][x] += k;
			}
	}
}

/* The merged passes must be what one render of all the samples would have given. */
static void check_pooled(const struct gd_image *out, int n, double tolerance)
{
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++)
			for (int c = 0; c < 3; c++) {
				double sum = 0, sum2 = 0, mean;
				char name[32];
				int k = 0;

				for (int i = 0; i < n; i++)
					k += adaptive(i, x, y);
				for (int j = 0; j < k; j++)
					sum += sample(x, y, c, j);
				mean = sum / k;
				for (int j = 0; j < k; j++)
					sum2 += (sample(x, y, c, j) - mean) *
						(sample(x, y, c, j) - mean);
				near(value(out, rgb[c], x, y), mean, rgb[c]);
				near(value(out, "samples", x, y), k, "samples");
				snprintf(name, sizeof name, "variance.%s", rgb[c]);
				if (fabs(value(out, name, x, y) * k * (k - 1) - sum2) >
				    tolerance * sum2)
					fail_msg("%s: %g, expected %g", name,
						 value(out, name, x, y), sum2 / k / (k - 1));
			}
}

static void test_passes_merge_to_one_render(void **state)
{
	struct gd_image in[3], out = { 0 };
	struct gd_merge_conf conf = usual;

	(void)state;
	make_adaptive(in, 3, "variance.", GD_VARIANCE_MEAN);
	merge(&out, in, 3, conf, 0);
	check_pooled(&out, 3, 1e-5);
	gd_image_free(&out);

	make_adaptive(in, 3, "Variance.", GD_VARIANCE_SAMPLE);
	merge(&out, in, 3, conf, 0);
	check_pooled(&out, 3, 1e-5);
	gd_image_free(&out);

	/*
	 * second moments lose what cancels: mean^2 is here up to 50 times the variance of the mean
	 */
	make_adaptive(in, 3, "m2_", GD_VARIANCE_M2);
	merge(&out, in, 3, conf, 0);
	check_pooled(&out, 3, 1e-4);
	gd_image_free(&out);
}

static void test_spread_of_inputs(void **state)
{
	static const double n[] = { 4, 4, 8, 16 };
	struct gd_image in[4], out = { 0 };
	double mean = 0, m2 = 0;

	(void)state;
	for (int i = 0; i < 4; i++) {
		gd_image_init(&in[i], W, H);
		fill_rgb(&in[i], (float)sample(0, 0, 0, i));
		fill(&in[i], "Z", 7);
		gd_attr_set_number(&in[i], "gd:samplesPerPixel", n[i], NULL);
		mean += n[i] * (double)(float)sample(0, 0, 0, i) / 32;
	}
	for (int i = 0; i < 4; i++)
		m2 += n[i] * (sample(0, 0, 0, i) - mean) * (sample(0, 0, 0, i) - mean);
	struct gd_merge_result r = merge(&out, in, 4, usual, 0);

	near(value(&out, "G", 1, 1), mean, "G");
	near(value(&out, "variance.G", 1, 1), m2 / (3 * 32), "variance.G");
	near(value(&out, "samples", 4, 2), 32, "samples");
	assert_int_equal(r.bins, 4);
	near(r.bin_ratio, 4, "bin_ratio");
	near(value(&out, "bin3.B", 0, 0), (float)sample(0, 0, 0, 3), "bin3.B");
	/* a feature without noise is not given a variance */
	near(value(&out, "Z", 0, 0), 7, "Z");
	assert_false(has(&out, "Z.variance"));
	gd_image_free(&out);
}

/*
 * Two adaptive passes that hold four bins each: bin by bin, and the mean of the bins is the mean.
 */
static void test_bins_one_by_one(void **state)
{
	struct gd_image in[2], out = { 0 };
	struct gd_merge_result r;

	(void)state;
	for (int i = 0; i < 2; i++) {
		gd_image_init(&in[i], W, H);
		fill(&in[i], "samples", i ? 12 : 4);
		for (int c = 0; c < 3; c++) {
			double sum = 0;
			char name[32];

			for (int b = 0; b < 4; b++) {
				snprintf(name, sizeof name, "bin%d.%s", b, rgb[c]);
				fill(&in[i], name, (float)(b + 10 * i + c));
				sum += b + 10 * i + c;
			}
			fill(&in[i], rgb[c], (float)(sum / 4));
		}
	}
	r = merge(&out, in, 2, usual, 0);
	assert_int_equal(r.bins, 4);
	for (int b = 0; b < 4; b++) {
		char name[32];

		snprintf(name, sizeof name, "bin%d.G", b);
		near(value(&out, name, 2, 1), (4.0 * (b + 1) + 12.0 * (b + 11)) / 16, name);
	}
	near(value(&out, "G", 2, 1), (4 * 2.5 + 12 * 12.5) / 16, "G");
	/* eight parts, of 1 and of 3 samples; both inputs spread by 5 around their means */
	double mean = (4 * 2.5 + 12 * 12.5) / 16, m2 = 5 * 1 + 5 * 3;

	m2 += 4 * (2.5 - mean) * (2.5 - mean) + 12 * (12.5 - mean) * (12.5 - mean);
	near(value(&out, "variance.G", 0, 0), m2 / (7 * 16), "variance.G");
	gd_image_free(&out);
}

/* A render of 2 samples that has no bins, and one of 16 in 8 bins that tells so pixel by pixel. */
static void test_bins_beside_a_whole(void **state)
{
	struct gd_image in[2], out = { 0 };
	struct gd_merge_result r;

	(void)state;
	for (int i = 0; i < 2; i++) {
		gd_image_init(&in[i], W, H);
		fill_rgb(&in[i], i ? 3.5f : 9);
	}
	gd_attr_set_number(&in[0], "gd:samplesPerPixel", 2, NULL);
	fill(&in[1], "samples", 16);
	for (int b = 0; b < 8; b++)
		for (int c = 0; c < 3; c++) {
			char name[32];

			snprintf(name, sizeof name, "bin%d.%s", b, rgb[c]);
			fill(&in[1], name, (float)b);
		}
	r = merge(&out, in, 2, usual, 0);
	assert_int_equal(r.bins, 8);
	near(r.bin_ratio, 2, "bin_ratio");
	near(value(&out, "R", 0, 0), (2 * 9 + 16 * 3.5) / 18, "R");
	/* the odd bins of the second go into the odd ones,
	 * the even where there is room on their side */
	near(value(&out, "bin0.R", 0, 0), (9 + 6) / 2.0, "bin0.R");
	near(value(&out, "bin7.G", 0, 0), 7, "bin7.G");
	/* nine parts of 2 samples */
	near(value(&out, "variance.B", 0, 0),
	     (2 * 42 + 2 * (9 - 74.0 / 18) * (9 - 74.0 / 18) +
	      16 * (3.5 - 74.0 / 18) * (3.5 - 74.0 / 18)) /
		     (8 * 18),
	     "variance.B");
	gd_image_free(&out);
}

static void test_many_inputs_are_grouped(void **state)
{
	struct gd_image in[MAXIN], out = { 0 };
	struct gd_merge_result r;
	double sum = 0;

	(void)state;
	for (int i = 0; i < MAXIN; i++) {
		gd_image_init(&in[i], W, H);
		fill_rgb(&in[i], (float)i);
		fill(&in[i], "dx.R", (float)-i);
		fill(&in[i], "dx.G", 0);
		fill(&in[i], "dx.B", 0);
	}
	r = merge(&out, in, MAXIN, usual, 2);
	assert_int_equal(r.bins, 8);
	near(r.bin_ratio, 1, "bin_ratio");
	assert_false(has(&out, "bin8.R"));
	for (int b = 0; b < 8; b++) {
		char name[32];

		snprintf(name, sizeof name, "bin%d.R", b);
		sum += value(&out, name, 0, 0) / 8;
	}
	near(sum, 11.5, "mean of the bins");
	near(value(&out, "bin0.dx.R", 0, 0), -(0 + 8 + 16) / 3.0, "bin0.dx.R");
	near(value(&out, "variance.R", 0, 0), (24 * 24 - 1) / 12.0 / 23, "variance.R");
	gd_image_free(&out);
}

static void test_asked_bins(void **state)
{
	struct gd_merge_conf conf = { .bins = 2, .halves = true };
	struct gd_image in[MAXIN], out = { 0 };
	struct gd_err err = { 0 };

	(void)state;
	for (int i = 0; i < 6; i++) {
		gd_image_init(&in[i], W, H);
		fill_rgb(&in[i], (float)i);
	}
	merge(&out, in, 6, conf, 4);
	near(value(&out, "bin1.R", 0, 0), 3, "bin1.R");
	near(value(&out, "half0.G", 0, 0), 2, "half0.G");
	near(value(&out, "half1.G", 0, 0), 3, "half1.G");
	gd_image_free(&out);

	conf = (struct gd_merge_conf){ .bins = 0, .halves = true };
	for (int i = 0; i < 2; i++) {
		gd_image_init(&in[i], W, H);
		fill_rgb(&in[i], (float)i);
	}
	assert_int_equal(merge(&out, in, 2, conf, 4).bins, 0);
	assert_false(has(&out, "bin0.R"));
	near(value(&out, "half1.B", 0, 0), 1, "half1.B");
	gd_image_free(&out);

	conf = (struct gd_merge_conf){ .bins = 3 };
	gd_image_init(&in[0], W, H);
	fill_rgb(&in[0], 1);
	assert_int_equal(merge_err(&out, in, 1, conf, 4, NULL, &err), GD_EARG);
	assert_string_equal(err.text, "3 bins cannot be made of 1 independent part");
}

static void test_bad_pixels(void **state)
{
	struct gd_image in[3], out = { 0 };
	struct gd_merge_result r;
	struct gd_plane p;

	(void)state;
	for (int i = 0; i < 3; i++) {
		gd_image_init(&in[i], W, H);
		fill_rgb(&in[i], (float)(i + 1));
		fill(&in[i], "Z", (float)(i + 1));
		gd_image_plane(&in[i], "G", &p);
		gd_row(p, 1)[1] = i == 1 ? NAN : gd_row(p, 1)[1];
		gd_row(p, 2)[2] = i == 0 ? gd_row(p, 2)[2] : -INFINITY;
		gd_row(p, 0)[0] = NAN;
		gd_image_plane(&in[i], "Z", &p);
		gd_row(p, 2)[4] = i == 2 ? INFINITY : gd_row(p, 2)[4];
	}
	r = merge(&out, in, 3, usual, 2);
	assert_int_equal(r.dropped, 1 + 2 + 3 + 1);
	assert_int_equal(r.empty, 1);
	/* the other two inputs, in all channels of the layer */
	for (int c = 0; c < 3; c++)
		near(value(&out, rgb[c], 1, 1), 2, rgb[c]);
	near(value(&out, "samples", 1, 1), 4, "samples");
	near(value(&out, "Z", 1, 1), 2, "Z");
	near(value(&out, "bin1.R", 1, 1), 2, "bin1.R");
	near(value(&out, "variance.R", 1, 1), 1, "variance.R");
	/* one input is left: its value, and not the variance 0 */
	near(value(&out, "R", 2, 2), 1, "R");
	assert_true(value(&out, "variance.R", 2, 2) > 0);
	near(value(&out, "G", 0, 0), 0, "G");
	near(value(&out, "samples", 0, 0), 0, "samples");
	near(value(&out, "Z", 4, 2), 1.5, "Z");
	gd_image_free(&out);
}

static void test_fireflies_and_scale(void **state)
{
	struct gd_image in[3], out[2] = { { 0 }, { 0 } };

	(void)state;
	for (int k = 0; k < 2; k++) {
		for (int i = 0; i < 3; i++) {
			struct gd_plane p;

			gd_image_init(&in[i], W, H);
			fill_rgb(&in[i], (float)ldexp(1.0 + i, k ? 40 : 0));
			gd_image_plane(&in[i], "B", &p);
			gd_row(p, 0)[0] = i ? 1e30f : -1e30f;
		}
		merge(&out[k], in, 3, usual, 1);
	}
	assert_true(value(&out[0], "variance.B", 0, 0) > 1e37);
	near(value(&out[1], "G", 2, 2), ldexp(value(&out[0], "G", 2, 2), 40), "scaled mean");
	near(value(&out[1], "variance.G", 2, 2), ldexp(value(&out[0], "variance.G", 2, 2), 80),
	     "scaled variance");
	gd_image_free(&out[0]);
	gd_image_free(&out[1]);
}

/* An edge is sampled from both its pixels, unless the renderer says otherwise. */
static void test_edges(void **state)
{
	for (int own = 0; own < 2; own++) {
		struct gd_merge_conf conf = { .bins = -1, .own_edges = own };
		struct gd_image in[2], out = { 0 };

		for (int i = 0; i < 2; i++) {
			struct gd_plane p;

			gd_image_init(&in[i], W, H);
			fill_rgb(&in[i], (float)i);
			for (int c = 0; c < 3; c++) {
				char name[8] = "dx.R";

				name[3] = *rgb[c];
				fill(&in[i], name, (float)i);
				name[1] = 'y';
				fill(&in[i], name, (float)i);
			}
			p = put(&in[i], "samples");
			for (int y = 0; y < H; y++)
				for (int x = 0; x < W; x++)
					gd_row(p, y)[x] = i ? (float)(1 + x + 2 * y) : 4;
		}
		merge(&out, in, 2, conf, 0);
		for (int y = 0; y < H; y++)
			for (int x = 0; x < W; x++) {
				double here = 1 + x + 2 * y, right = x + 1 < W ? here + 1 : here;
				double below = y + 1 < H ? here + 2 : here;

				right = own ? here : 2 * here * right / (here + right);
				below = own ? here : 2 * here * below / (here + below);
				near(value(&out, "R", x, y), here / (4 + here), "R");
				near(value(&out, "dx.R", x, y), right / (4 + right), "dx.R");
				near(value(&out, "dy.B", x, y), below / (4 + below), "dy.B");
			}
		gd_image_free(&out);
	}
	(void)state;
}

static void put_raw(struct gd_image *im, const char *name, enum gd_type type, unsigned char seed)
{
	size_t bytes = (size_t)im->w * (size_t)im->h * 4;

	assert_int_equal(gd_image_append(im, name, type, NULL), GD_OK);
	im->chan[im->nchan - 1].raw = malloc(bytes);
	for (size_t i = 0; i < bytes; i++)
		im->chan[im->nchan - 1].raw[i] = (unsigned char)(i * 37 + seed);
}

static void test_identifiers_pass(void **state)
{
	struct gd_image in[2], out = { 0 };

	(void)state;
	for (int i = 0; i < 2; i++) {
		gd_image_init(&in[i], W, H);
		put_raw(&in[i], "ViewLayer.CryptoObject00.r", GD_FLOAT, (unsigned char)(1 + i));
		put_raw(&in[i], "objects", GD_UINT, (unsigned char)(5 + i));
		fill_rgb(&in[i], 1);
		gd_attr_set_string(&in[i], "gd:scene", i ? "b" : "a", NULL);
		gd_attr_set_string(&in[i], "gd:history", i ? "render 1\nfix" : "render 0\nfix",
				   NULL);
		gd_attr_set_number(&in[i], "gd:renderSeconds", 2 + i, NULL);
	}
	merge(&out, in, 2, usual, 3);
	int a = gd_image_find(&out, "ViewLayer.CryptoObject00.r"),
	    b = gd_image_find(&out, "objects");

	assert_true(a >= 0 && b >= 0 && out.chan[b].type == GD_UINT);
	for (int i = 0; i < W * H * 4; i++) {
		assert_int_equal(out.chan[a].raw[i], (unsigned char)(i * 37 + 1));
		assert_int_equal(out.chan[b].raw[i], (unsigned char)(i * 37 + 5));
	}
	char text[100];
	double seconds = 0, n = 0;

	assert_true(gd_attr_string(&out, "gd:scene", text, sizeof text));
	assert_string_equal(text, "a");
	assert_true(gd_attr_string(&out, "gd:history", text, sizeof text));
	assert_string_equal(text, "render 0\nfix\nrender 1");
	assert_true(gd_attr_number(&out, "gd:renderSeconds", &seconds) &&
		    gd_attr_number(&out, "gd:samplesPerPixel", &n));
	near(seconds, 5, "gd:renderSeconds");
	near(n, 6, "gd:samplesPerPixel");
	gd_image_free(&out);
}

static void test_single_input(void **state)
{
	struct gd_image in, out = { 0 };
	struct gd_merge_result r;

	(void)state;
	gd_image_init(&in, W, H);
	for (int c = 0; c < 3; c++)
		for (int y = 0; y < H; y++)
			for (int x = 0; x < W; x++)
				render(&in, "", NULL, c, x, y, 0, 3, GD_VARIANCE_NONE);
	r = merge(&out, &in, 1, usual, 0);
	assert_int_equal(r.bins, 0);
	assert_int_equal(out.nchan, 3);
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++) {
			double sum = sample(x, y, 1, 0) + sample(x, y, 1, 1) + sample(x, y, 1, 2);

			near(value(&out, "G", x, y), sum / 3, "G");
		}
	gd_image_free(&out);

	/* with its variance per sample */
	gd_image_init(&in, W, H);
	fill_rgb(&in, 2);
	fill(&in, "Variance.R", 8);
	fill(&in, "Variance.G", 8);
	fill(&in, "Variance.B", (float)-1e-9);
	gd_attr_set_int(&in, "samplesPerPixel", 16, NULL);
	merge(&out, &in, 1, usual, 0);
	near(value(&out, "variance.R", 0, 0), 0.5, "variance.R");
	near(value(&out, "variance.B", 0, 0), 0, "variance.B");
	gd_image_free(&out);
}

/* Inputs with a variance but without counts weigh the same. */
static void test_without_counts(void **state)
{
	struct gd_image in[2], out = { 0 };

	(void)state;
	for (int i = 0; i < 2; i++) {
		gd_image_init(&in[i], W, H);
		fill_rgb(&in[i], (float)i);
		fill(&in[i], "variance.R", (float)(1 + 2 * i));
		fill(&in[i], "variance.G", INFINITY);
		fill(&in[i], "variance.B", NAN);
	}
	merge(&out, in, 2, usual, 0);
	near(value(&out, "R", 0, 0), 0.5, "R");
	near(value(&out, "variance.R", 0, 0), 1, "variance.R");
	assert_true(value(&out, "variance.G", 0, 0) > 1e29);
	assert_false(has(&out, "samples"));
	gd_image_free(&out);
}

static void expect(struct gd_image *in, int n, double spp, int code, const char *text)
{
	struct gd_image out = { 0 };
	struct gd_err err = { 0 };

	assert_int_equal(merge_err(&out, in, n, usual, spp, NULL, &err), code);
	assert_string_equal(err.text, text);
	assert_int_equal(out.nchan, 0);
}

static void test_refusals(void **state)
{
	struct gd_image in[2];

	(void)state;
	gd_image_init(&in[0], W, H);
	gd_image_init(&in[1], W, H + 1);
	fill_rgb(&in[0], 1);
	fill_rgb(&in[1], 1);
	expect(in, 2, 1, GD_ESHAPE, "run1.exr: 5 x 4 pixels, expected 5 x 3 as in run0.exr");

	gd_image_init(&in[0], W, H);
	fill(&in[0], "Z", 1);
	expect(in, 1, 1, GD_ESHAPE,
	       "run0.exr: no colour, neither R G B nor another name that is known");

	for (int i = 0; i < 2; i++) {
		gd_image_init(&in[i], W, H);
		fill_rgb(&in[i], 1);
	}
	gd_attr_set_int(&in[0], "samplesPerPixel", 4, NULL);
	expect(in, 2, 0, GD_EARG,
	       "run1.exr: no sample count, which other inputs have; give it by --spp");

	gd_image_init(&in[0], W, H);
	fill_rgb(&in[0], 1);
	fill(&in[0], "Variance.R", 1);
	fill(&in[0], "Variance.G", 1);
	fill(&in[0], "Variance.B", 1);
	expect(in, 1, 0, GD_EARG,
	       "run0.exr: its variances are of single samples; give their number by --spp");
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_passes_merge_to_one_render),
		cmocka_unit_test(test_spread_of_inputs),
		cmocka_unit_test(test_bins_one_by_one),
		cmocka_unit_test(test_bins_beside_a_whole),
		cmocka_unit_test(test_many_inputs_are_grouped),
		cmocka_unit_test(test_asked_bins),
		cmocka_unit_test(test_bad_pixels),
		cmocka_unit_test(test_fireflies_and_scale),
		cmocka_unit_test(test_edges),
		cmocka_unit_test(test_identifiers_pass),
		cmocka_unit_test(test_single_input),
		cmocka_unit_test(test_without_counts),
		cmocka_unit_test(test_refusals),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
