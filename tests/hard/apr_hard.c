/* SPDX-License-Identifier: BSD-3-Clause */
/* Input that breaks regressions: against dense least squares in double, and through the stage. */
#include "../support/apr_dense.h"

#include "apr_paper.h"

enum kind {
	BLACK,
	NEGATIVE,
	FIREFLY,
	DENORMAL,
	NO_VARIANCE,
	STRIPES,
	ALL_SAME,
	CONSTANT,
	COPY,
	COLLINEAR,
	FAR_OFF,
	HUGE_RANGE,
	KINDS
};

/* A frame of the given kind; three colour planes, four features. */
static struct scene hard(int w, int h, enum kind kind)
{
	struct scene s = make(w, h, 3, 3, 4, 5);

	for (int y = 0; y < h; y++)
		for (int x = 0; x < w; x++) {
			float *f[4];

			for (int a = 0; a < 4; a++) {
				f[a] = gd_row(s.feat[a], y) + x;
				gd_row(s.feat_var[a], y)[x] = 0;
			}
			*f[3] = (float)((x * 5 + y * 3) % 7);
			for (int c = 0; c < 3; c++) {
				float *v = gd_row(s.y[c], y) + x, *var = gd_row(s.var[c], y) + x;

				if (kind == BLACK || kind == ALL_SAME)
					*v = kind == BLACK ? 0 : 0.7f;
				if (kind == BLACK || kind == NO_VARIANCE || kind == ALL_SAME ||
				    (kind == STRIPES && x / 3 % 2))
					*var = 0;
				if (kind == NEGATIVE)
					*v -= 3;
				if (kind == FIREFLY && x == w / 2 && y == h / 2) {
					*v = 1e30f;
					*var = FLT_MAX;
				}
				if (kind == DENORMAL) {
					*v *= 1e-40f;
					*var = 0;
				}
			}
			if (kind == CONSTANT)
				*f[1] = *f[2] = 3;
			if (kind == COPY)
				*f[1] = *f[2] = *f[3];
			if (kind == COLLINEAR)
				*f[2] = 2 * *f[3] - (float)x;
			if (kind == FAR_OFF)
				*f[3] = 1e8f + 8 * *f[3];
			if (kind == HUGE_RANGE)
				*f[0] = x > 3 * w / 4 ? 1e10f : *f[0];
		}
	return s;
}

static void test_dense(void **state)
{
	static const int size[][2] = { { 1, 1 }, { 1, 17 }, { 19, 1 }, { 31, 23 } };

	(void)state;
	for (int i = 0; i < 4; i++)
		for (enum kind k = 0; k < KINDS; k++) {
			against_dense(hard(size[i][0], size[i][1], k),
				      (struct gd_apr_conf){6, 3, 0, 3, GD_APR_GAUSS, 1, 1, 0, 0},
				      false);
			against_dense(hard(size[i][0], size[i][1], k),
				      (struct gd_apr_conf){3, 2, 0, 0, GD_APR_BOX, 1, 1, 0, 0},
				      true);
		}
}

/* The whole stage: finite whatever comes in; a scaled frame gives the scaled result. */
static void run_stage(struct scene *s, struct gd_plane est[3], struct gd_plane mse[3],
		      bool variance)
{
	static struct gd_apr_frame f;
	struct gd_apr_conf conf = { 5, 3, 0, 3, GD_APR_GAUSS, 1, 1, 0, 0 };
	struct gd_apr_out out = { est, mse, { 0 }, { 0 } };
	struct gd_apr_paper_result result;
	struct gd_err err = { 0 };

	f = (struct gd_apr_frame){ .ny = 3, .nfeat = s->nfeat };
	for (int c = 0; c < 3; c++) {
		f.y[c] = s->y[c];
		f.var[c] = variance ? s->var[c] : (struct gd_plane){ 0 };
	}
	for (int a = 0; a < s->nfeat; a++) {
		f.feat[a] = s->feat[a];
		f.feat_var[a] = s->feat_var[a];
		f.layer[a] = a;
	}
	assert_int_equal(gd_apr_paper(&out, &f, &conf, GD_SPIKES_RETURN, &result, NULL, &err),
			 GD_OK);
	for (int y = 0; y < s->h; y++)
		for (int x = 0; x < s->w; x++)
			for (int c = 0; c < 3; c++) {
				assert_true(isfinite(gd_row(est[c], y)[x]));
				assert_true(isfinite(gd_row(mse[c], y)[x]) &&
					    gd_row(mse[c], y)[x] >= 0);
			}
}

static void outputs(struct gd_plane p[3], int w, int h)
{
	for (int c = 0; c < 3; c++)
		p[c] = plane(w, h);
}

static void release(struct gd_plane p[3])
{
	for (int c = 0; c < 3; c++)
		free(p[c].v);
}

static void test_stage(void **state)
{
	static const int size[][2] = { { 1, 1 }, { 2, 1 }, { 1, 13 }, { 29, 31 } };

	(void)state;
	for (int i = 0; i < 4; i++)
		for (enum kind k = 0; k < KINDS; k++)
			for (int variance = 0; variance < 2; variance++) {
				struct scene s = hard(size[i][0], size[i][1], k);
				struct gd_plane est[3], mse[3];

				outputs(est, s.w, s.h);
				outputs(mse, s.w, s.h);
				run_stage(&s, est, mse, variance);
				release(est);
				release(mse);
				drop(&s);
			}
}

/* NaN and Inf in every kind of plane, single and in blocks, and everywhere. */
static void test_not_numbers(void **state)
{
	static const float bad[] = { NAN, INFINITY, -INFINITY };

	(void)state;
	for (int k = 0; k < 3; k++)
		for (int where = 0; where < 16; where++) {
			struct scene s = hard(33, 27, where % 4 == 3 ? FIREFLY : STRIPES);
			struct gd_plane est[3], mse[3];

			for (int y = 0; y < s.h; y++)
				for (int x = 0; x < s.w; x++) {
					if (where < 8 && (x * 3 + y * 7) % 29)
						continue;
					if (where >= 8 && where < 12 && (x < 10 || y < 5))
						continue;
					if (where % 4 == 0 || where % 4 == 3)
						gd_row(s.y[1], y)[x] = bad[k];
					if (where % 4 == 1 || where % 4 == 3)
						gd_row(s.var[2], y)[x] = bad[k];
					if (where % 4 == 2 || where % 4 == 3) {
						gd_row(s.feat[1], y)[x] = bad[k];
						gd_row(s.feat_var[1], y)[x] = bad[k];
					}
				}
			outputs(est, s.w, s.h);
			outputs(mse, s.w, s.h);
			run_stage(&s, est, mse, true);
			release(est);
			release(mse);
			drop(&s);
		}
}

/* A firefly leaves no more than a doubling of the light around it. */
static void test_firefly(void **state)
{
	struct scene s = hard(31, 31, FIREFLY);
	struct gd_plane est[3], mse[3];

	(void)state;
	outputs(est, 31, 31);
	outputs(mse, 31, 31);
	run_stage(&s, est, mse, true);
	for (int y = 0; y < 31; y++)
		for (int x = 0; x < 31; x++)
			assert_true(fabsf(gd_row(est[1], y)[x]) < 20);
	release(est);
	release(mse);
	drop(&s);
}

/* Powers of two, so that only the arithmetic's own thresholds could tell. */
static void test_scale(void **state)
{
	static const int power[] = { -40, 40 };

	(void)state;
	for (int i = 0; i < 2; i++)
		for (int variance = 0; variance < 2; variance++) {
			struct scene a = hard(37, 33, STRIPES), b = hard(37, 33, STRIPES);
			struct gd_plane ea[3], ma[3], eb[3], mb[3];

			outputs(ea, 37, 33);
			outputs(ma, 37, 33);
			outputs(eb, 37, 33);
			outputs(mb, 37, 33);
			for (int y = 0; y < 33; y++)
				for (int x = 0; x < 37; x++) {
					for (int c = 0; c < 3; c++) {
						gd_row(b.y[c], y)[x] =
							ldexpf(gd_row(b.y[c], y)[x], power[i]);
						gd_row(b.var[c], y)[x] = ldexpf(
							gd_row(b.var[c], y)[x], 2 * power[i]);
					}
					for (int k = 0; k < 4; k++)
						gd_row(b.feat[k], y)[x] =
							ldexpf(gd_row(b.feat[k], y)[x], -power[i]);
				}
			run_stage(&a, ea, ma, variance);
			run_stage(&b, eb, mb, variance);
			for (int y = 0; y < 33; y++)
				for (int x = 0; x < 37; x++)
					for (int c = 0; c < 3; c++) {
						float e = ldexpf(gd_row(eb[c], y)[x], -power[i]),
						      m = ldexpf(gd_row(mb[c], y)[x],
								 -2 * power[i]);

						assert_true(fabsf(e - gd_row(ea[c], y)[x]) <=
							    4e-6f);
						assert_true(fabsf(m - gd_row(ma[c], y)[x]) <=
							    1e-5f * gd_row(ma[c], y)[x] + 1e-12f);
					}
			release(ea);
			release(ma);
			release(eb);
			release(mb);
			drop(&a);
			drop(&b);
		}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_dense),	    cmocka_unit_test(test_stage),
		cmocka_unit_test(test_not_numbers), cmocka_unit_test(test_firefly),
		cmocka_unit_test(test_scale),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
