/* SPDX-License-Identifier: BSD-3-Clause */
/* Frames of a sequence against what is known of them: where things are, how they differ. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include <omp.h>

#include "apr.h"
#include "gather.h"
#include "halves.h"

#define W 61
#define H 47
#define FRAMES 4

struct job {
	int w, h;
	struct gd_crossfit_in in;
	struct gd_crossfit_frame frame[FRAMES];
	struct gd_plane count[2];
};

/* What frames show: their pan in pixels, light, noise, whether something unrelated. */
struct shot {
	int pan;
	double light, sigma;
	bool other;
};

static double draw(unsigned seed, int c, int x, int y)
{
	uint64_t k = ((uint64_t)seed << 40) ^ ((uint64_t)c << 32) ^ ((uint64_t)(x + 9000) << 16) ^
		     (uint64_t)y;
	double sum = 0;

	for (int i = 0; i < 4; i++) {	/* variance 1 */
		k += 0x9e3779b97f4a7c15u;
		k = (k ^ (k >> 30)) * 0xbf58476d1ce4e5b9u;
		k = (k ^ (k >> 27)) * 0x94d049bb133111ebu;
		k ^= k >> 31;
		sum += (double)(k >> 11) / 9007199254740992.0 - 0.5;
	}
	return sum * 1.7320508;
}

static struct gd_plane plane(int w, int h)
{
	return gd_plane_of(gd_calloc(gd_stride(w) * (size_t)h, sizeof(float)), w, h);
}

static double radiance(int c, double x, double y, bool other)
{
	if (other)
		return 3 + sin(0.7 * x + c) * cos(0.5 * y);
	return 1.5 + 0.3 * c + 0.5 * sin(0.31 * x) * cos(0.23 * y) + (sin(0.05 * x * y) > 0.5);
}

/* The surface seen through pixel x (of the first frame's raster), y: a corrugated wall. */
static void point(double x, double y, int pan, double p[3])
{
	double z = 6 + 0.5 * sin(0.2 * x);

	(void)pan;
	p[0] = z * (x - 30) / 80;
	p[1] = z * (y - 23) / 80;
	p[2] = z;
}

static void shoot(const struct shot *s, unsigned seed, struct gd_plane y[2][GD_APR_RHS],
		  struct gd_plane position[3], int w, int h)
{
	for (int c = 0; c < 3; c++)
		position[c] = plane(w, h);
	for (int half = 0; half < 2; half++)
		for (int c = 0; c < 3; c++)
			y[half][c] = plane(w, h);
	for (int j = 0; j < h; j++)
		for (int i = 0; i < w; i++) {
			double p[3];

			point(i + s->pan, j, s->pan, p);
			for (int c = 0; c < 3; c++) {
				double v = s->light * radiance(c, i + s->pan, j, s->other);

				gd_row(position[c], j)[i] = (float)p[c];
				for (int half = 0; half < 2; half++)
					gd_row(y[half][c], j)[i] =
						(float)(v + s->sigma * draw(seed + (unsigned)half,
									    c, i, j));
			}
		}
}

static struct job *make(const struct shot *shot, int n)
{
	struct job *j = calloc(1, sizeof *j);

	*j = (struct job){ .w = W, .h = H,
			   .in = { .ny = 3, .nframe = n - 1, .share = { .5, .5 } } };
	j->in.frame = j->frame;
	shoot(shot, 1, j->in.y, j->in.position, W, H);
	for (int k = 0; k < n - 1; k++)
		shoot(shot + 1 + k, (unsigned)(11 + 10 * k), j->frame[k].y, j->frame[k].position, W,
		      H);
	return j;
}

static void no_positions(struct job *j)
{
	for (int c = 0; c < 3; c++) {
		free(j->in.position[c].v);
		j->in.position[c].v = NULL;
		for (int k = 0; k < FRAMES; k++) {
			free(j->frame[k].position[c].v);
			j->frame[k].position[c].v = NULL;
		}
	}
}

static void run(struct job *j)
{
	struct gd_err err = { 0 };

	assert_int_equal(gd_gather(&j->in, j->count, NULL, &err), GD_OK);
	assert_int_equal(j->in.nframe, 0);
	assert_ptr_equal(j->in.count[0].v, j->count[0].v);
}

static void done(struct job *j)
{
	for (int c = 0; c < 3; c++) {
		free(j->in.position[c].v);
		for (int half = 0; half < 2; half++)
			free(j->in.y[half][c].v);
		for (int k = 0; k < FRAMES; k++) {
			free(j->frame[k].position[c].v);
			free(j->frame[k].y[0][c].v);
			free(j->frame[k].y[1][c].v);
		}
	}
	gd_halves_free(j->count, 2);
	free(j);
}

static double mean(struct gd_plane p, int x0, int x1)
{
	double s = 0;

	for (int y = 0; y < p.h; y++)
		for (int x = x0; x < x1; x++)
			s += (double)gd_row(p, y)[x];
	return s / p.h / (x1 - x0);
}

/* Mean squared distance of both halves to the truth. */
static double error(const struct job *j, int x0, int x1)
{
	double s = 0;

	for (int half = 0; half < 2; half++)
		for (int c = 0; c < 3; c++)
			for (int y = 0; y < H; y++)
				for (int x = x0; x < x1; x++)
					s += pow((double)gd_row(j->in.y[half][c], y)[x] -
						 radiance(c, x, y, false), 2);
	return s / (6.0 * H * (x1 - x0));
}

static void between(double lo, double v, double hi)
{
	if (!(v >= lo && v <= hi))
		fail_msg("%g, expected %g to %g", v, lo, hi);
}

static void test_nothing_to_do(void **state)
{
	const struct shot shot = { 0, 1, 0.2, false };
	struct job *j = make(&shot, 1);
	struct gd_err err = { 0 };

	(void)state;
	assert_int_equal(gd_gather(&j->in, j->count, NULL, &err), GD_OK);
	assert_null(j->count[0].v);
	assert_null(j->in.count[0].v);
	done(j);
}

static void test_copies_count_in_full(void **state)
{
	const struct shot shot[3] = { { 0, 1, 0.2, false }, { 0, 1, 0.2, false },
				      { 0, 1, 0.2, false } };
	struct job *j = make(shot, 3);

	(void)state;
	for (int k = 0; k < 2; k++)
		for (int half = 0; half < 2; half++)
			for (int c = 0; c < 3; c++)
				memcpy(j->frame[k].y[half][c].v, j->in.y[half][c].v,
				       j->in.y[0][0].stride * H * sizeof(float));
	run(j);
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++)
			between(1.5 - 1e-5, (double)gd_row(j->count[0], y)[x], 1.5 + 1e-5);
	done(j);
}

/* Independent noise, the same image: variance falls nearly as the number of frames. */
static void test_noise_averages(void **state)
{
	struct shot shot[5];
	struct job *j;

	(void)state;
	for (int positions = 0; positions < 2; positions++)
		for (int n = 2; n <= 5; n++) {
			for (int k = 0; k < n; k++)
				shot[k] = (struct shot){ 0, 1, 0.3, false };
			j = make(shot, n);
			if (!positions)
				no_positions(j);
			run(j);
			between(0.09 / n * 0.95, error(j, 0, W), 0.09 / n * 1.15);
			between(0.8 * n / 2, mean(j->count[0], 0, W), 0.5 * n);
			done(j);
		}
}

/* Pixels are found where the camera moved; what it had not in view brings nothing. */
static void test_pan(void **state)
{
	for (int pan = -12; pan <= 12; pan += 4) {
		const struct shot shot[2] = { { 0, 1, 0, false }, { pan, 1, 0, false } };
		struct job *j = make(shot, 2);

		(void)state;
		run(j);
		between(0, error(j, 0, W), 1e-12);
		for (int y = 0; y < H; y++)
			for (int x = 0; x < W; x++) {
				bool seen = x - pan >= 0 && x - pan < W;
				bool rim = x - pan == 0 || x - pan == W - 1;	/* smoothed */

				double n = (double)gd_row(j->count[0], y)[x];

				double least = !seen ? 0.5 : rim ? 0.8 : 0.99;

				if (!(n >= least && n <= (seen ? 1.001 : 0.5)))
					fail_msg("pan %d: %g samples at %d %d", pan, n, x, y);
			}
		done(j);
	}
}

static void test_unrelated_frame_brings_nothing(void **state)
{
	const struct shot shot[2] = { { 0, 1, 0.2, false }, { 0, 1, 0.2, true } };
	struct job *j = make(shot, 2);

	(void)state;
	run(j);
	between(0.5, mean(j->count[0], 0, W), 0.502);
	between(0.04 * 0.96, error(j, 0, W), 0.04 * 1.04);
	done(j);
}

/* Half of the image changes its light: there a frame must not count, beyond it must. */
static void test_light(void **state)
{
	const struct shot shot[2] = { { 0, 1, 0.2, false }, { 0, 1, 0.2, false } };
	struct job *j = make(shot, 2);

	(void)state;
	for (int half = 0; half < 2; half++)
		for (int c = 0; c < 3; c++)
			for (int y = 0; y < H; y++)
				for (int x = W / 2; x < W; x++)
					gd_row(j->frame[0].y[half][c], y)[x] *= 0.6f;
	run(j);
	between(0.94, mean(j->count[0], 0, W / 2 - 6), 1);
	between(0.5, mean(j->count[0], W / 2, W), 0.53);
	done(j);
}

static void test_light_that_changes_slowly_is_told_by_few_noise(void **state)
{
	double count[2];

	(void)state;
	for (int i = 0; i < 2; i++) {	/* a change of 4 % against noise of 4 and of 40 % */
		const double sigma = i ? 0.8 : 0.08;
		const struct shot shot[2] = { { 0, 1, sigma, false }, { 0, 1.04, sigma, false } };
		struct job *j = make(shot, 2);

		run(j);
		count[i] = mean(j->count[0], 0, W) - 0.5;
		done(j);
	}
	between(0, count[0], 0.15);
	between(0.35, count[1], 0.5);
}

static void test_order_of_frames(void **state)
{
	const struct shot a[4] = { { 0, 1, .3, false }, { 3, 1, .2, false }, { 0, 1.2, .3, false },
				   { -5, 1, .3, false } };
	struct job *j = make(a, 4), *k = make(a, 4);
	struct gd_crossfit_frame t = k->frame[0];

	(void)state;
	k->frame[0] = k->frame[2];
	k->frame[2] = t;
	run(j);
	run(k);
	for (int half = 0; half < 2; half++)
		for (int c = 0; c < 3; c++)
			for (int y = 0; y < H; y++)
				for (int x = 0; x < W; x++)
					between(-1e-6, (double)(gd_row(j->in.y[half][c], y)[x] -
								gd_row(k->in.y[half][c], y)[x]),
						1e-6);
	done(j);
	done(k);
}

static void test_threads(void **state)
{
	const struct shot a[3] = { { 0, 1, .3, false }, { 3, 1, .2, false },
				   { 0, 1.2, .3, false } };
	struct job *j = make(a, 3);
	int was = omp_get_max_threads();

	(void)state;
	omp_set_num_threads(1);
	run(j);
	for (int n = 2; n <= 7; n += 5) {
		struct job *k = make(a, 3);

		omp_set_num_threads(n);
		run(k);
		for (int half = 0; half < 2; half++)
			for (int c = 0; c < 3; c++)
				for (int y = 0; y < H; y++)
					assert_memory_equal(gd_row(j->in.y[half][c], y),
							    gd_row(k->in.y[half][c], y),
							    W * sizeof(float));
		done(k);
	}
	omp_set_num_threads(was);
	done(j);
}

static void test_scaled(void **state)
{
	static const float scales[] = { 1e-12f, 1024, 1e12f };
	const struct shot a[3] = { { 0, 1, .3, false }, { 3, 1, .2, false },
				   { 0, 1.2, .3, false } };
	struct job *j = make(a, 3);

	(void)state;
	run(j);
	for (int i = 0; i < 3; i++) {
		struct job *k = make(a, 3);

		for (int half = 0; half < 2; half++)
			for (int c = 0; c < 3; c++)
				for (int p = 0; p < W * H; p++) {
					gd_row(k->in.y[half][c], p / W)[p % W] *= scales[i];
					for (int f = 0; f < 2; f++)
						gd_row(k->frame[f].y[half][c], p / W)[p % W] *=
							scales[i];
				}
		run(k);
		for (int p = 0; p < W * H; p++)
			between(-1e-4, (double)(gd_row(j->in.y[0][1], p / W)[p % W] -
						gd_row(k->in.y[0][1], p / W)[p % W] / scales[i]),
				1e-4);
		done(k);
	}
	done(j);
}

/* The weight as the header has it, summed pixel by pixel, without positions. */
static double direct_weight(const struct job *j, double dark, int x, int y)
{
	double sum = 0, bias = 0, noise = 0;
	int n = 0;

	for (int c = 0; c < 3; c++) {
		double d = 0, q = 0, v = 0, own = 0;

		n = 0;
		for (int b = -3; b <= 3; b++)
			for (int a = -3; a <= 3; a++) {
				double u[2][2];

				if (x + a < 0 || x + a >= W || y + b < 0 || y + b >= H)
					continue;
				for (int h = 0; h < 2; h++) {
					u[0][h] = (double)gd_row(j->in.y[h][c], y + b)[x + a];
					u[1][h] = (double)gd_row(j->frame[0].y[h][c], y + b)[x + a];
					for (int f = 0; f < 2; f++)
						u[f][h] = log(1 + fmax(u[f][h], 0) / dark);
				}
				sum = (u[1][0] + u[1][1] - u[0][0] - u[0][1]) / 2;
				d += sum;
				q += sum * sum;
				own += pow(u[0][0] - u[0][1], 2) / 4;
				v += pow(u[1][0] - u[1][1], 2) / 4;
				n++;
			}
		sum = d / n;
		bias += fmax(fmax(0, sum * sum - 2.5 * (v + own) / n / 49),
			     q / n - 2 * (v + own) / n);
		noise += own / n / 15;
	}
	return noise / (noise + bias);
}

static void test_weight(void **state)
{
	const struct shot shot[2] = { { 0, 1, 0.2, false }, { 0, 1.1, 0.3, false } };
	struct job *j = make(shot, 2), *k = make(shot, 2);
	struct gd_err err = { 0 };
	double level;

	(void)state;
	no_positions(j);
	assert_int_equal(gd_halves_level(&level, k->in.y[0], &err), GD_OK);
	run(j);
	for (int y = 1; y < H - 1; y += 5)
		for (int x = 1; x < W - 1; x += 7) {
			double want = 0, w;

			for (int b = -1; b <= 1; b++)
				for (int a = -1; a <= 1; a++)
					want += direct_weight(k, 0.3 * level, x + a, y + b) / 9;
			w = 2 * (double)gd_row(j->count[0], y)[x] - 1;
			between(want - 2e-4, w, want + 2e-4);
			w = ((double)gd_row(k->in.y[1][2], y)[x] +
			     w * (double)gd_row(k->frame[0].y[1][2], y)[x]) / (1 + w);
			between(w - 1e-5, (double)gd_row(j->in.y[1][2], y)[x], w + 1e-5);
		}
	done(j);
	done(k);
}

/* Solves a (n x n, symmetric) x = b by elimination. */
static void solve(int n, double a[6][6], double b[6])
{
	for (int i = 0; i < n; i++)
		for (int k = i + 1; k < n; k++) {
			double f = a[k][i] / a[i][i];

			for (int m = i; m < n; m++)
				a[k][m] -= f * a[i][m];
			b[k] -= f * b[i];
		}
	for (int i = n - 1; i >= 0; i--) {
		for (int m = i + 1; m < n; m++)
			b[i] -= a[i][m] * b[m];
		b[i] /= a[i][i];
	}
}

/*
 * The regression of what was gathered against one that sees both frames' pixels one by one, in one
 * window over the whole image: features x y and sin, with weights as gathered.
 */
static void test_window_spans_frames(void **state)
{
	const struct shot shot[2] = { { 0, 1, 0.2, false }, { 4, 1, 0.2, false } };
	struct job *j = make(shot, 2), *k = make(shot, 2);
	struct gd_plane feat[3] = { plane(W, H), plane(W, H), plane(W, H) }, est = plane(W, H);
	struct gd_apr_conf conf = { 64, 129, 0, 0, GD_APR_BOX, 0, 1, 0, 0 };
	struct gd_apr_in apr = { .ny = 1, .y = &j->in.y[0][1], .nfeat = 3, .feat = feat,
				 .weight = j->count[0] };
	struct gd_apr_out out = { .est = &est };
	struct gd_err err = { 0 };
	double a[6][6] = { { 0 } }, b[6] = { 0 };

	(void)state;
	run(j);
	apr.weight = j->count[0];
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++) {
			double z[4] = { 1, x, y, sin(0.31 * x) * cos(0.23 * y) };
			double w = 2 * (double)gd_row(j->count[0], y)[x] - 1;

			for (int i = 0; i < 3; i++)
				gd_row(feat[i], y)[x] = (float)z[i + 1];
			for (int f = 0; f < 2; f++) {
				double weight = f ? w : 1, v = 0;

				if (!f)
					v = (double)gd_row(k->in.y[0][1], y)[x];
				else if (x >= 4)
					v = (double)gd_row(k->frame[0].y[0][1], y)[x - 4];
				for (int r = 0; r < 4; r++) {
					b[r] += weight * z[r] * v;
					for (int c = 0; c < 4; c++)
						a[r][c] += weight * z[r] * z[c];
				}
			}
		}
	solve(4, a, b);
	assert_int_equal(gd_apr_fit(&out, &apr, &conf, NULL, &err), GD_OK);
	for (int y = 0; y < H; y += 3)
		for (int x = 0; x < W; x += 3) {
			double want = b[0] + b[1] * x + b[2] * y +
				      b[3] * sin(0.31 * x) * cos(0.23 * y);

			between(want - 2e-5, (double)gd_row(est, y)[x], want + 2e-5);
		}
	for (int i = 0; i < 3; i++)
		free(feat[i].v);
	free(est.v);
	done(j);
	done(k);
}

/* Where the other frame has five times the samples, it counts five times. */
static void test_counts(void **state)
{
	const struct shot shot[2] = { { 0, 1, 0.2, false }, { 0, 1, 0.2, false } };
	struct job *j = make(shot, 2);
	struct gd_plane one = plane(W, H), five = plane(W, H);

	(void)state;
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++) {
			gd_row(one, y)[x] = 2;
			gd_row(five, y)[x] = x < 30 ? 10 : 0;
		}
	for (int h = 0; h < 2; h++) {
		j->in.count[h] = one;
		j->frame[0].count[h] = five;
		for (int c = 0; c < 3; c++)
			memcpy(j->frame[0].y[h][c].v, j->in.y[h][c].v,
			       one.stride * H * sizeof(float));
	}
	run(j);
	for (int y = 0; y < H; y++)
		for (int x = 0; x < W; x++)
			between(x < 30 ? 11.99 : 1.999, (double)gd_row(j->count[1], y)[x],
				x < 30 ? 12.001 : 2.001);
	free(one.v);
	free(five.v);
	done(j);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_nothing_to_do), cmocka_unit_test(test_copies_count_in_full),
		cmocka_unit_test(test_noise_averages), cmocka_unit_test(test_pan),
		cmocka_unit_test(test_unrelated_frame_brings_nothing), cmocka_unit_test(test_light),
		cmocka_unit_test(test_light_that_changes_slowly_is_told_by_few_noise),
		cmocka_unit_test(test_order_of_frames), cmocka_unit_test(test_threads),
		cmocka_unit_test(test_scaled), cmocka_unit_test(test_weight),
		cmocka_unit_test(test_window_spans_frames), cmocka_unit_test(test_counts)
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
