/* SPDX-License-Identifier: BSD-3-Clause */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>

#include "kernel/poisson_boot.h"
#include "rng.h"

enum { N = 65536 };

/* Chi-squared of 256 equal cells has mean 255 and standard deviation 22.6: six of them are 390. */
static void assert_uniform(const unsigned *cell)
{
	double chi = 0;

	for (int i = 0; i < 256; i++)
		chi += pow((double)cell[i] - N / 256.0, 2) / (N / 256.0);
	assert_true(chi < 390);
	assert_true(chi > 140);		/* too even is not random either */
}

static void test_every_byte_is_uniform(void **state)
{
	const struct gd_rng_key key = gd_rng_key(1, 0);

	(void)state;
	for (int shift = 0; shift < 32; shift += 8) {
		unsigned along[256] = {0}, draws[256] = {0}, streams[256] = {0}, seeds[256] = {0};

		for (unsigned i = 0; i < N; i++) {
			along[gd_rng_u32(key, i, 0) >> shift & 255]++;
			draws[gd_rng_u32(key, 7, i) >> shift & 255]++;
			streams[gd_rng_u32(gd_rng_key(1, i), 7, 0) >> shift & 255]++;
			seeds[gd_rng_u32(gd_rng_key(i, 0), 7, 0) >> shift & 255]++;
		}
		assert_uniform(along);
		assert_uniform(draws);
		assert_uniform(streams);
		assert_uniform(seeds);
	}
}

static void test_neighbours_are_independent(void **state)
{
	const struct gd_rng_key key = gd_rng_key(1, 0), next = gd_rng_key(1, 1);
	double pixel = 0, word = 0, stream = 0;

	(void)state;
	for (unsigned i = 0; i < N; i++) {
		double v = (double)gd_rng_float(key, i, 0) - 0.5;

		pixel += v * ((double)gd_rng_float(key, i + 1, 0) - 0.5);
		word += v * ((double)gd_rng_float(key, i, 1) - 0.5);
		stream += v * ((double)gd_rng_float(next, i, 0) - 0.5);
	}
	/* The correlation of N independent pairs has a standard deviation of 1/sqrt(N) = 0.004. */
	assert_true(fabs(pixel * 12 / N) < 0.02);
	assert_true(fabs(word * 12 / N) < 0.02);
	assert_true(fabs(stream * 12 / N) < 0.02);
}

static void test_a_flipped_bit_flips_half(void **state)
{
	(void)state;
	for (int bit = 0; bit < 32; bit++) {
		double flips = 0;

		for (uint32_t i = 0; i < 4096; i++) {
			uint32_t v = i * 2654435761U;

			flips += __builtin_popcount(gd_rng_mix(v) ^ gd_rng_mix(v ^ 1U << bit));
		}
		assert_true(fabs(flips / 4096 - 16) < 1.0);
	}
}

static void test_floats_stay_below_one(void **state)
{
	const struct gd_rng_key key = gd_rng_key(UINT64_MAX, UINT64_MAX);
	double sum = 0;

	(void)state;
	for (unsigned i = 0; i < N; i++) {
		float v = gd_rng_float(key, i, 3);

		assert_true(v >= 0 && v < 1);
		sum += (double)v;
	}
	assert_true(fabs(sum / N - 0.5) < 6 * 0.2887 / 256);
}

/* Counts of a multinomial: they add up, each has mean
 * 1, variance 1 - 1/B, and any B is served alike. */
static void test_draws_are_multinomial(void **state)
{
	static float count[64][4096];
	const struct gd_boot_kernels *k = GD_PICK(gd_boot_rows);
	static const int bins[] = { 1, 2, 3, 7, 8, 9, 16, 64 };

	(void)state;
	for (size_t i = 0; i < sizeof(bins) / sizeof(*bins); i++) {
		float *row[64];
		double square = 0;

		for (int b = 0; b < bins[i]; b++) {
			row[b] = count[b];
			for (int x = 0; x < 4096; x++)
				count[b][x] = 0;
		}
		k->draw(row, bins[i], gd_rng_key(5, 2), 1000, 4096);
		for (int x = 0; x < 4096; x++) {
			float sum = 0;

			for (int b = 0; b < bins[i]; b++) {
				sum += count[b][x];
				square += ((double)count[b][x] - 1) * ((double)count[b][x] - 1);
			}
			assert_true(sum == (float)bins[i]);
		}
		square /= 4096.0 * bins[i];
		assert_true(fabs(square - (1 - 1.0 / bins[i])) < 0.06);
	}
}

/* A pixel draws the same wherever its row is cut. */
static void test_draws_depend_on_the_pixel_only(void **state)
{
	const struct gd_boot_kernels *k = GD_PICK(gd_boot_rows);
	float whole[8][300] = { { 0 } }, part[8][100] = { { 0 } };
	float *a[8], *b[8];

	(void)state;
	for (int i = 0; i < 8; i++) {
		a[i] = whole[i];
		b[i] = part[i];
	}
	k->draw(a, 8, gd_rng_key(1, 1), 0, 300);
	k->draw(b, 8, gd_rng_key(1, 1), 150, 100);
	for (int i = 0; i < 8; i++)
		for (int x = 0; x < 100; x++)
			assert_true(whole[i][150 + x] == part[i][x]);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_every_byte_is_uniform),
		cmocka_unit_test(test_neighbours_are_independent),
		cmocka_unit_test(test_a_flipped_bit_flips_half),
		cmocka_unit_test(test_floats_stay_below_one),
		cmocka_unit_test(test_draws_are_multinomial),
		cmocka_unit_test(test_draws_depend_on_the_pixel_only),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
