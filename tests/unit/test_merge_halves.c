/* SPDX-License-Identifier: BSD-3-Clause */
/* Merged halves whose samples differ from pixel to pixel, against sums by hand. */
#include "merge_make.h"

/* Samples 5 of pixel x: 3 in the first half, 2 in the other; another input's are 2 and 0. */
static void test_uneven_halves(void **state)
{
	static const char *const layer[] = { "bin0", "bin1", "half0", "half1" };
	struct gd_image in[2], out = { 0 };
	struct gd_merge_result r;

	(void)state;
	for (int i = 0; i < 2; i++) {
		float n[2] = { i ? 3 : 2, i ? 2 : 0 };

		gd_image_init(&in[i], W, H);
		fill_rgb(&in[i], (n[0] * (float)(10 + i) + n[1] * (float)(20 + i)) / (n[0] + n[1]));
		fill(&in[i], "samples", n[0] + n[1]);
		fill(&in[i], "half0.samples", n[0]);
		fill(&in[i], "half1.samples", n[1]);
		for (int k = 0; k < 4; k++)
			for (int c = 0; c < 3; c++) {
				char name[32];

				/* where there is no sample, nobody looks */
				snprintf(name, sizeof name, "%s.%s", layer[k], rgb[c]);
				fill(&in[i], name, k % 2 ? (n[1] > 0 ? (float)(20 + i) : -7) :
							   (float)(10 + i));
			}
	}
	r = merge(&out, in, 2, usual, 0);
	assert_int_equal(r.bins, 2);
	assert_int_equal(r.one_sided, 0);
	near(value(&out, "R", 1, 1), (2 * 10 + 3 * 11 + 2 * 21) / 7.0, "R");
	near(value(&out, "samples", 1, 1), 7, "samples");
	near(value(&out, "half0.samples", 1, 1), 5, "half0.samples");
	near(value(&out, "half1.samples", 1, 1), 2, "half1.samples");
	for (int k = 0; k < 4; k++) {
		char name[32];

		snprintf(name, sizeof name, "%s.G", layer[k]);
		near(value(&out, name, 2, 1), k % 2 ? 21 : (2 * 10 + 3 * 11) / 5.0, name);
	}
	gd_image_free(&out);
}

/* Three passes without bins, the second and third with samples in some pixels only. */
static void test_empty_bins(void **state)
{
	static const float n[3][3] = { { 4, 4, 4 }, { 0, 2, 0 }, { 6, 0, 0 } };
	struct gd_image in[3], out = { 0 };
	struct gd_merge_result r;

	(void)state;
	for (int i = 0; i < 3; i++) {
		struct gd_plane p;

		gd_image_init(&in[i], W, H);
		fill_rgb(&in[i], (float)(1 << i));
		p = put(&in[i], "samples");
		for (int y = 0; y < H; y++)
			for (int x = 0; x < W; x++)
				gd_row(p, y)[x] = n[i][x % 3];
	}
	r = merge(&out, in, 3, usual, 0);
	assert_int_equal(r.bins, 3);
	/* bin 1, alone on its side, is empty in columns 0, 2 and 3 */
	assert_int_equal(r.one_sided, 3 * H);
	near(value(&out, "half0.samples", 0, 0), 10, "half0.samples");
	near(value(&out, "half1.samples", 0, 0), 0, "half1.samples");
	near(value(&out, "half0.samples", 1, 0), 4, "half0.samples");
	near(value(&out, "half1.samples", 1, 0), 2, "half1.samples");
	/* an empty bin takes the mean of its side: bin 2 that of bin 0 */
	near(value(&out, "bin2.R", 1, 0), 1, "bin2.R");
	near(value(&out, "bin1.R", 1, 0), 2, "bin1.R");
	near(value(&out, "bin1.R", 0, 0), (4 * 1 + 6 * 4) / 10.0, "bin1.R");
	gd_image_free(&out);
}

/* Halves of gradients weigh as gradients do: by both pixels of an edge. */
static void test_halves_of_edges(void **state)
{
	struct gd_image in[2], out = { 0 };

	(void)state;
	for (int i = 0; i < 2; i++) {
		struct gd_plane p;

		gd_image_init(&in[i], W, H);
		fill_rgb(&in[i], 1);
		for (int h = 0; h < 2; h++)
			for (int c = 0; c < 3; c++) {
				char name[32];

				snprintf(name, sizeof name, "half%d.dx.%s", h, rgb[c]);
				fill(&in[i], name, (float)(i + 1));
				snprintf(name, sizeof name, "half%d.%s", h, rgb[c]);
				fill(&in[i], name, 1);
				snprintf(name, sizeof name, "dx.%s", rgb[c]);
				fill(&in[i], name, (float)(i + 1));
			}
		p = put(&in[i], "samples");
		for (int y = 0; y < H; y++)
			for (int x = 0; x < W; x++)
				gd_row(p, y)[x] = i ? 2 : (float)(2 + 2 * x);
	}
	merge(&out, in, 2, (struct gd_merge_conf){ .bins = 0 }, 0);
	/* between pixels 1 and 2: 4 and 6 samples against 2 */
	near(value(&out, "dx.R", 1, 1), (4.8 * 1 + 2 * 2) / 6.8, "dx.R");
	near(value(&out, "half1.dx.R", 1, 1), (4.8 * 1 + 2 * 2) / 6.8, "half1.dx.R");
	gd_image_free(&out);
}

/* Counts of gradients that the inputs tell; none anywhere: the difference of the colours. */
static void test_told_edges(void **state)
{
	struct gd_image in[2], out = { 0 };
	char name[32];

	(void)state;
	for (int i = 0; i < 2; i++) {
		struct gd_plane samples, worth;

		gd_image_init(&in[i], W, H);
		for (int c = 0; c < 3; c++) {
			snprintf(name, sizeof name, "dx.%s", rgb[c]);
			fill(&in[i], name, (float)(10 * i + 10));
			snprintf(name, sizeof name, "variance.%s", rgb[c]);
			fill(&in[i], name, 0.5f);
			snprintf(name, sizeof name, "dx.variance.%s", rgb[c]);
			fill(&in[i], name, 2);
			samples = put(&in[i], rgb[c]);
			for (int y = 0; y < H; y++)
				for (int x = 0; x < W; x++)
					gd_row(samples, y)[x] = (float)(x * x + i);
		}
		samples = put(&in[i], "samples");
		worth = put(&in[i], "dx.samples");
		for (int y = 0; y < H; y++)
			for (int x = 0; x < W; x++) {
				gd_row(samples, y)[x] = 4;
				gd_row(worth, y)[x] = x == 1 ? 0 : x == 2 ? (i ? 0 : 3) : 4;
			}
	}
	merge(&out, in, 2, (struct gd_merge_conf){ .bins = -1 }, 0);
	near(value(&out, "dx.R", 0, 0), 15, "dx.R");
	near(value(&out, "dx.samples", 0, 0), 8, "dx.samples");
	/* traced by nobody: 4.5 - 1.5, and the variances of both */
	near(value(&out, "dx.R", 1, 1), 3, "dx.R");
	near(value(&out, "dx.variance.R", 1, 1),
	     value(&out, "variance.R", 1, 1) + value(&out, "variance.R", 2, 1), "dx.variance.R");
	near(value(&out, "bin0.dx.R", 1, 1), 3, "bin0.dx.R");
	near(value(&out, "dx.samples", 1, 1), 0, "dx.samples");
	/* traced by one of them */
	near(value(&out, "dx.R", 2, 1), 10, "dx.R");
	near(value(&out, "dx.variance.R", 2, 1), 2, "dx.variance.R");
	near(value(&out, "dx.samples", 2, 1), 3, "dx.samples");
	gd_image_free(&out);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_uneven_halves),
		cmocka_unit_test(test_empty_bins),
		cmocka_unit_test(test_halves_of_edges),
		cmocka_unit_test(test_told_edges),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
