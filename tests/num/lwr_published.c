/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * The setting `paper` against the recursion as it was printed (recursive least squares over the
 * pixels of one ring after the other, equations 3 to 5 and 7), in double; and what becomes of the
 * recursion in float.
 */
#include "../support/lwr_dense.h"

#define DELTA 1e-3

struct recursion {
	int n;
	double p[MAXP][MAXP], b[3][MAXP];
};

/* Columns of a pixel about the centre: 1, position over R, the feature in its deviations. */
static int columns(const struct scene *s, int radius, int x, int y, int u, int v, double scale,
		   double *z)
{
	z[0] = 1;
	z[1] = (double)u / radius;
	z[2] = (double)v / radius;
	if (s->nfeat == 0 || scale == 0)
		return 3;
	z[3] = (value(s->feat[0], s->w, (y + v) * s->w + x + u) -
		value(s->feat[0], s->w, y * s->w + x)) / scale;
	return 4;
}

static double inverse_form(const struct recursion *o, const double *z)
{
	double sum = 0;

	for (int i = 0; i < o->n; i++)
		for (int j = 0; j < o->n; j++)
			sum += z[i] * o->p[i][j] * z[j];
	return sum;
}

static double model_at(const struct recursion *o, int c, const double *z)
{
	double sum = 0;

	for (int j = 0; j < o->n; j++)
		sum += o->b[c][j] * z[j];
	return sum;
}

/* One pixel. */
static void learn(struct recursion *o, const double *z, const double *y, int nc)
{
	double gain[MAXP], over = 1 / (1 + inverse_form(o, z)), pz[MAXP];

	for (int i = 0; i < o->n; i++) {
		pz[i] = 0;
		for (int j = 0; j < o->n; j++)
			pz[i] += o->p[i][j] * z[j];
		gain[i] = pz[i] * over;
	}
	for (int c = 0; c < nc; c++) {
		double e = y[c] - model_at(o, c, z);

		for (int i = 0; i < o->n; i++)
			o->b[c][i] += gain[i] * e;
	}
	for (int i = 0; i < o->n; i++)
		for (int j = 0; j < o->n; j++)
			o->p[i][j] -= gain[i] * pz[j];
}

static bool inside(const struct scene *s, int x, int y)
{
	return x >= 0 && y >= 0 && x < s->w && y < s->h;
}

/* Deviation of the feature over the largest window, 0 where it is left out. */
static double deviation(const struct scene *s, int radius, int x, int y)
{
	double sum = 0, square = 0, noise = 0, n = 0, range, floor;

	if (s->nfeat == 0)
		return 0;
	for (int v = -radius; v <= radius; v++)
		for (int u = -radius; u <= radius; u++) {
			double f;

			if (!inside(s, x + u, y + v))
				continue;
			f = value(s->feat[0], s->w, (y + v) * s->w + x + u);
			noise += value(s->feat_var[0], s->w, (y + v) * s->w + x + u);
			sum += f;
			square += f * f;
			n++;
		}
	square -= sum * sum / n;
	spread(s->feat[0], &range, &floor);
	return square > noise && square > 1e-9 ? sqrt(square / n) : 0;
}

/* Returns the radius; best: its model, xi its error, scale of the feature. */
static int published(struct recursion *best, const struct scene *s, int radius, int x, int y,
		     double *xi, double *scale)
{
	struct recursion o = { 0 }, before;
	double acc[3] = { 0 }, rel[3], least = 0;
	int chosen = 0, seen = 0;
	double z[MAXP], yc[3];

	*scale = deviation(s, radius, x, y);
	o.n = columns(s, radius, x, y, 0, 0, *scale, z);
	for (int i = 0; i < o.n; i++)
		o.p[i][i] = 1 / DELTA;
	for (int c = 0; c < s->nc; c++) {
		double sum = 0;
		int n = 0;

		o.b[c][0] = value(s->y[c], s->w, y * s->w + x);
		xi[c] = value(s->vars[c], s->w, y * s->w + x);
		for (int v = -1; v <= 1; v++)
			for (int u = -1; u <= 1; u++)
				if (inside(s, x + u, y + v)) {
					sum += value(s->y[c], s->w, (y + v) * s->w + x + u);
					n++;
				}
		rel[c] = 1 / (sum / n * (sum / n) + level2(s));
		least += rel[c] * xi[c];
	}
	*best = o;
	for (int r = 0; r <= radius; r++) {
		double cost = 0, mean[3];
		int ring = 0;

		before = o;
		for (int pass = 0; pass < 2; pass++)	/* learn the ring, then test */
			for (int v = -r; v <= r; v++)
				for (int u = -r; u <= r; u++) {
					bool test = r == 1 || (abs(u) == r || abs(v) == r);
					bool new = abs(u) == r || abs(v) == r;

					if (!inside(s, x + u, y + v))
						continue;
					columns(s, radius, x, y, u, v, *scale, z);
					for (int c = 0; c < s->nc; c++)
						yc[c] = value(s->y[c], s->w,
							      (y + v) * s->w + x + u);
					if (pass == 0 && new) {
						learn(&o, z, yc, s->nc);
						ring++;
					}
					if (pass == 0 || r == 0 || !test)
						continue;
					for (int c = 0; c < s->nc; c++) {
						double e = model_at(r == 1 ? &o : &before, c, z) -
							   yc[c];

						if (r == 1)
							e /= fmax(1 - inverse_form(&o, z), 1e-3);
						acc[c] += e * e;
					}
				}
		if (r == 0) {
			seen = 1;
			continue;
		}
		if (ring == 0)
			break;
		seen += ring;
		for (int c = 0; c < s->nc; c++) {
			mean[c] = acc[c] / seen;
			cost += rel[c] * mean[c];
		}
		if (cost < least) {
			least = cost;
			chosen = r;
			*best = o;
			for (int c = 0; c < s->nc; c++)
				xi[c] = mean[c];
		}
	}
	return chosen;
}

static void against_published(struct scene s, int radius)
{
	const struct gd_lwr_conf conf = { .radius = radius, .feature_noise = 1, .paper = true };
	struct gd_plane est[6], mse[3];
	struct gd_lwr_in in = { .ny = s.ny, .nfeat = s.nfeat, .y = s.y, .var = s.vars,
				.feat = s.feat, .feat_var = s.feat_var };
	struct gd_lwr_out out = { .est = est, .mse = mse };
	struct gd_lwr_result result;
	struct gd_err err = { 0 };
	double *sum = calloc((size_t)s.w * (size_t)s.h * 7, sizeof *sum);
	int *cx = calloc((size_t)s.w + 1, sizeof *cx), *cy = calloc((size_t)s.h + 1, sizeof *cy);
	size_t models = 0;

	for (int c = 0; c < 6; c++)
		est[c] = plane(s.w, s.h);
	for (int c = 0; c < 3; c++)
		mse[c] = plane(s.w, s.h);
	assert_int_equal(gd_lwr_fit(&out, &in, &conf, &result, NULL, &err), GD_OK);
	for (int step = 2 * radius + 1; step >= 1; step /= 2) {
		int nx = grid(cx, s.w, step), ny = grid(cy, s.h, step);
		bool *uncovered = calloc((size_t)s.w * (size_t)s.h, sizeof *uncovered);

		for (int i = 0; i < s.w * s.h; i++)
			uncovered[i] = !(sum[i * 7] > 0);
		for (int k = 0; k < nx * ny; k++) {
			int x = cx[k % nx], y = cy[k / nx], r;
			struct recursion best;
			double xi[3], scale, z[MAXP];

			if (!uncovered[y * s.w + x])
				continue;
			models++;
			r = published(&best, &s, radius, x, y, xi, &scale);
			for (int v = -r; v <= r; v++)
				for (int u = -r; u <= r; u++) {
					double *to = sum + ((y + v) * s.w + x + u) * 7;

					if (!inside(&s, x + u, y + v))
						continue;
					columns(&s, radius, x, y, u, v, scale, z);
					to[0]++;
					for (int c = 0; c < s.nc; c++) {
						to[1 + c] += model_at(&best, c, z);
						to[4 + c] += xi[c];
					}
				}
		}
		free(uncovered);
	}
	assert_int_equal(models, result.models);
	for (int i = 0; i < s.w * s.h; i++)
		for (int c = 0; c < s.nc; c++) {
			double want = sum[i * 7 + 1 + c] / sum[i * 7], got = value(est[c], s.w, i);
			double error = sum[i * 7 + 4 + c] / sum[i * 7];

			if (fabs(got - want) > 1e-6 * fmax(fabs(want), 1))
				fail_msg("pixel %d,%d plane %d: %.9g, expected %.9g", i % s.w,
					 i / s.w, c, got, want);
			if (fabs(value(mse[c], s.w, i) - error) > 1e-5 * error)
				fail_msg("pixel %d,%d error %d: %.9g, expected %.9g", i % s.w,
					 i / s.w, c, value(mse[c], s.w, i), error);
		}
	free(sum);
	free(cx);
	free(cy);
	for (int c = 0; c < 6; c++)
		free(est[c].v);
	for (int c = 0; c < 3; c++)
		free(mse[c].v);
	drop(&s);
}

static void test_published(void **state)
{
	static const int size[][2] = {{40, 31}, {23, 24}, {1, 1}, {19, 1}, {2, 30}};

	(void)state;
	for (size_t i = 0; i < sizeof size / sizeof *size; i++)
		for (int nfeat = 0; nfeat < 2; nfeat++)
			against_published(make(size[i][0], size[i][1], i % 2 ? 1 : 3, nfeat,
					       30 + (unsigned)i), i % 2 ? 9 : 4);
}

/* Pixels of a far wall: depth 1e4 with a relief of 1, its double, and a little noise on that. */
static void wall(struct scene *s, unsigned seed)
{
	for (int y = 0; y < s->h; y++)
		for (int x = 0; x < s->w; x++) {
			double relief = sin(0.7 * x) + cos(0.9 * y);

			gd_row(s->feat[0], y)[x] = (float)(1e4 + relief);
			gd_row(s->feat[1], y)[x] = (float)(2e4 + 2 * relief + 0.01 * bell(&seed));
			for (int c = 0; c < 3; c++)
				gd_row(s->y[c], y)[x] = (float)(1 + 0.3 * relief + 0.01 * x);
		}
}

/*
 * The recursion in float with the columns as they are (no centring: 1, x, y, depths): its matrix
 * loses its sign and the prediction is off, where sums, scaled and centred, give the image back.
 */
static double float_recursion(const struct scene *s)
{
	float p[5][5] = {{ 0 }}, b[5] = { 0 }, worst = 0;

	for (int i = 0; i < 5; i++)
		p[i][i] = 1e3f;
	for (int pass = 0; pass < 2; pass++)
		for (int i = 0; i < s->w * s->h; i++) {
			int x = i % s->w, y = i / s->w;
			float z[5] = { 1, (float)x, (float)y, gd_row(s->feat[0], y)[x],
				       gd_row(s->feat[1], y)[x] };
			float pz[5] = { 0 }, over = 1, e = gd_row(s->y[0], y)[x];

			for (int j = 0; j < 5; j++) {
				for (int k = 0; k < 5; k++)
					pz[j] += p[j][k] * z[k];
				over += z[j] * pz[j];
				e -= b[j] * z[j];
			}
			if (pass) {
				worst = fmaxf(worst, fabsf(e));
				continue;
			}
			for (int j = 0; j < 5; j++) {
				b[j] += pz[j] / over * e;
				for (int k = 0; k < 5; k++)
					p[j][k] -= pz[j] / over * pz[k];
			}
		}
	return isfinite(worst) ? (double)worst : INFINITY;
}

static void test_float_recursion(void **state)
{
	struct scene s = make(19, 19, 3, 2, 1);
	struct gd_plane est[3];
	struct gd_lwr_in in = { .ny = 3, .nfeat = 2, .y = s.y, .feat = s.feat };
	struct gd_lwr_out out = { .est = est };
	const struct gd_lwr_conf conf = { .radius = 9 };
	struct gd_err err = { 0 };
	double worst = 0, recursion;

	(void)state;
	wall(&s, 3);
	for (int c = 0; c < 3; c++)
		est[c] = plane(19, 19);
	assert_int_equal(gd_lwr_fit(&out, &in, &conf, NULL, NULL, &err), GD_OK);
	for (int i = 0; i < 19 * 19; i++)
		worst = fmax(worst, fabs(value(est[0], 19, i) - value(s.y[0], 19, i)));
	recursion = float_recursion(&s);
	printf("worst misfit: recursion in float %g, sums %g\n", recursion, worst);
	assert_true(recursion > 0.05);
	assert_true(worst < 2e-3);	/* float rounding of the depth, 5e-4, times the slope */
	for (int c = 0; c < 3; c++)
		free(est[c].v);
	drop(&s);
}

int main(void)
{
	const struct CMUnitTest tests[] = {cmocka_unit_test(test_published),
					   cmocka_unit_test(test_float_recursion)};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
