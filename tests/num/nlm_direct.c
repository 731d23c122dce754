/* SPDX-License-Identifier: BSD-3-Clause */
/* Non-local means against the formula of nlm.h written down in double, pixel by pixel. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <math.h>
#include <stdlib.h>

#include "nlm.h"

#define MAX_PLANES 4

/* n planes of w x h with all that a job needs. */
struct problem {
	int w, h, nguide, n;
	struct gd_plane guide[MAX_PLANES], guide_var[MAX_PLANES];
	struct gd_plane in[MAX_PLANES], in_var[MAX_PLANES];
	struct gd_plane out[MAX_PLANES], out_var[MAX_PLANES];
	float *block;
	const struct problem *frame;	/* others, NULL behind the last; window: of theirs */
	struct gd_plane known;
	int window;
};

static uint32_t state;

static double uniform(void)
{
	state = state * 1664525u + 1013904223u;
	return (double)(state >> 8) / 16777216.0;
}

static double normal(void)
{
	return sqrt(-2.0 * log(1.0 - uniform())) * cos(6.283185307179586 * uniform());
}

static void build(struct problem *p, int w, int h, int nguide, int n)
{
	const size_t size = gd_stride(w) * (size_t)h;
	struct gd_plane *group[] = { p->guide, p->guide_var, p->in, p->in_var, p->out, p->out_var };

	*p = (struct problem){ .w = w, .h = h };
	p->nguide = nguide;
	p->n = n;
	p->block = gd_calloc(6 * MAX_PLANES * size, sizeof(float));
	assert_non_null(p->block);
	for (int i = 0; i < 6 * MAX_PLANES; i++)
		group[i / MAX_PLANES][i % MAX_PLANES] =
			gd_plane_of(p->block + (size_t)i * size, w, h);
}

/* Edges, a ramp and noise whose variance changes over the image, 0 in some columns. */
static void fill(struct problem *p, double scale)
{
	for (int c = 0; c < MAX_PLANES; c++)
		for (int y = 0; y < p->h; y++)
			for (int x = 0; x < p->w; x++) {
				double truth = (x / 7 + y / 5) % 3 + 0.02 * x + 0.3 * c;
				double sd = x % 16 == 3 ? 0.0 : 0.1 + 0.2 * (y % 11) / 11.0;

				gd_row(p->guide[c], y)[x] =
					(float)(scale * (truth + sd * normal()));
				gd_row(p->guide_var[c], y)[x] = (float)(scale * scale * sd * sd);
				gd_row(p->in[c], y)[x] = (float)(scale * (truth + sd * normal()));
				gd_row(p->in_var[c], y)[x] = (float)(scale * scale * sd * sd);
			}
}

static int by_value(const void *a, const void *b)
{
	double x = *(const double *)a, y = *(const double *)b;

	return (x > y) - (x < y);
}

/* Variance of the values between the percentiles 1 and 99. */
static double spread(struct gd_plane p)
{
	size_t n = (size_t)p.w * (size_t)p.h;
	double *v = malloc(n * sizeof *v), lo, hi, mean = 0.0, var = 0.0;

	assert_non_null(v);
	for (size_t i = 0; i < n; i++)
		v[i] = gd_row(p, (int)(i / (size_t)p.w))[i % (size_t)p.w];
	qsort(v, n, sizeof *v, by_value);
	hi = v[n > 2 ? (size_t)(0.99 * (double)(n - 1)) : n - 1];
	lo = v[n - 1 - (n > 2 ? (size_t)(0.99 * (double)(n - 1)) : n - 1)];
	for (size_t i = 0; i < n; i++)
		mean += fmin(fmax(v[i], lo), hi) / (double)n;
	for (size_t i = 0; i < n; i++)
		var += pow(fmin(fmax(v[i], lo), hi) - mean, 2.0) / (double)n;
	free(v);
	return var;
}

static int inside(const struct problem *p, int x, int y)
{
	return x >= 0 && y >= 0 && x < p->w && y < p->h;
}

static int in_window(const struct gd_nlm_conf *conf, int dx, int dy)
{
	return !conf->round || dx * dx + dy * dy <= conf->window * conf->window + 1;
}

static double weight(const struct problem *p, const struct problem *from,
		     const struct gd_nlm_conf *conf, const double *eps, int px, int py, int qx,
		     int qy)
{
	const double k2 = conf->k * conf->k;
	double sum = 0.0;
	int count = 0;

	for (int oy = -conf->patch; oy <= conf->patch; oy++)
		for (int ox = -conf->patch; ox <= conf->patch; ox++) {
			int ax = px + ox, ay = py + oy, bx = qx + ox, by = qy + oy;

			if (!inside(p, ax, ay) || !inside(p, bx, by))
				continue;
			for (int c = 0; c < p->nguide; c++) {
				double a = gd_row(p->guide[c], ay)[ax];
				double b = gd_row(from->guide[c], by)[bx];
				double va = 0.0, vb = 0.0;

				if (p->guide_var[c].v) {
					va = gd_row(p->guide_var[c], ay)[ax];
					vb = gd_row(from->guide_var[c], by)[bx];
				}
				sum += fmin(1e7, ((a - b) * (a - b) - va - fmin(va, vb)) /
						 (eps[c] + k2 * (va + vb)));
			}
			count += p->nguide;
		}
	return exp(-fmax(0.0, sum / count));
}

struct total {
	double w, u[MAX_PLANES], v[MAX_PLANES];
};

/* Adds what the pixels of a frame around (x, y) give. */
static void add_window(const struct problem *p, const struct problem *from,
		       const struct gd_nlm_conf *conf, int window, const double *eps, int x, int y,
		       struct total *t)
{
	struct gd_nlm_conf size = *conf;

	size.window = window;
	for (int qy = y - window; qy <= y + window; qy++)
		for (int qx = x - window; qx <= x + window; qx++) {
			if (!inside(p, qx, qy) || !in_window(&size, qx - x, qy - y))
				continue;

			double w = weight(p, from, conf, eps, x, y, qx, qy);

			if (from->known.v)
				w *= gd_row(from->known, qy)[qx];
			t->w += w;
			for (int c = 0; c < p->n; c++) {
				t->u[c] += w * gd_row(from->in[c], qy)[qx];
				t->v[c] += w * w * gd_row(from->in_var[c], qy)[qx];
			}
		}
}

/* Is any guide's variance above what is negligible, here or in five of the pixels around? */
static int noisy(const struct problem *p, const struct gd_nlm_conf *conf, const double *eps, int x,
		 int y)
{
	int found = conf->negligible <= 0.0;

	for (int c = 0; c < p->nguide; c++) {
		int around = 0;

		for (int i = 0; i < 9 && p->guide_var[c].v; i++) {
			int u = x + i % 3 - 1, v = y + i / 3 - 1;

			if (inside(p, u, v) && gd_row(p->guide_var[c], v)[u] >
			    conf->negligible / conf->eps * eps[c])
				around += i == 4 ? 9 : 1;
		}
		found |= around >= 5;
	}
	return found;
}

/* |a - b| against a tolerance that says which pixel fails. */
static void close_to(const char *what, int c, int x, int y, double found, double wanted,
		     double tolerance)
{
	if (!(fabs(found - wanted) <= tolerance))
		fail_msg("%s %d at (%d, %d): %.9g, expected %.9g (+- %.3g)", what, c, x, y, found,
			 wanted, tolerance);
}

/*
 * The kernel's distances are float: relative error of some 1e-6 in the sum over a patch, whose
 * weighty values are below 20, hence 1e-4 in a weight; the output is a mean of values whose
 * spread inside a window is below 6 scales.
 */
static int compare(const struct problem *p, const struct gd_nlm_conf *conf, double scale)
{
	double eps[MAX_PLANES];
	int kept = 0;

	for (int c = 0; c < p->nguide; c++)
		eps[c] = conf->eps * spread(p->guide[c]);
	for (int y = 0; y < p->h; y++)
		for (int x = 0; x < p->w; x++) {
			struct total t = { 0 };

			if (!noisy(p, conf, eps, x, y)) {
				for (int c = 0; c < p->n; c++) {
					assert_true(gd_row(p->out[c], y)[x] ==
						    gd_row(p->in[c], y)[x]);
					assert_true(gd_row(p->out_var[c], y)[x] ==
						    gd_row(p->in_var[c], y)[x]);
				}
				kept++;
				continue;
			}
			add_window(p, p, conf, conf->window, eps, x, y, &t);
			for (const struct problem *f = p->frame; f; f = f->frame)
				add_window(p, f, conf, f->window, eps, x, y, &t);
			for (int c = 0; c < p->n; c++) {
				close_to("mean", c, x, y, gd_row(p->out[c], y)[x], t.u[c] / t.w,
					 1e-4 * scale);
				close_to("variance", c, x, y, gd_row(p->out_var[c], y)[x],
					 t.v[c] / (t.w * t.w),
					 2e-4 * t.v[c] / (t.w * t.w) + 1e-12 * scale * scale);
			}
		}
	return kept;
}

/* Returns how many pixels were left as they are. */
static int check(int w, int h, int nguide, int n, struct gd_nlm_conf conf, double scale)
{
	struct problem p;
	struct gd_err err = { 0 };

	state = (uint32_t)(w * 1000 + h);
	build(&p, w, h, nguide, n);
	fill(&p, scale);
	struct gd_nlm_job job = { nguide, n, p.guide, p.guide_var,
				  p.in, p.in_var, p.out, p.out_var };

	if (gd_nlm_run(&job, &conf, NULL, &err) != GD_OK)
		fail_msg("%s", err.text);
	const int kept = compare(&p, &conf, scale);

	free(p.block);
	return kept;
}

static void published_sizes(void **unused)
{
	(void)unused;
	check(150, 41, 3, 3, GD_NLM_DEFAULTS, 1.0);	/* two tiles across, two down */
	check(37, 29, 1, 2, GD_NLM_DEFAULTS, 1.0);
	check(31, 37, 4, 1, GD_NLM_DEFAULTS, 1.0);
}

static void other_radii(void **unused)
{
	struct gd_nlm_conf conf = { .patch = 0, .window = 2, .k = 1.0, .eps = 1e-4 };

	(void)unused;
	check(23, 19, 3, 1, conf, 1.0);
	conf = (struct gd_nlm_conf){ .patch = 5, .window = 3, .k = 0.3, .eps = 1e-6 };
	check(29, 17, 2, 3, conf, 1.0);
	conf = (struct gd_nlm_conf){ .patch = 16, .window = 32, .k = 0.5, .eps = 1e-6 };
	check(19, 13, 3, 1, conf, 1.0);
}

static void sizes_below_the_window(void **unused)
{
	(void)unused;
	for (int w = 1; w <= 7; w++)
		for (int h = 1; h <= 5; h++)
			check(w, h, 3, 2, GD_NLM_DEFAULTS, 1.0);
	check(200, 1, 3, 3, GD_NLM_DEFAULTS, 1.0);
	check(1, 67, 3, 3, GD_NLM_DEFAULTS, 1.0);
}

/* Two more frames, one with a weight for each of its pixels. */
static void frames(int w, int h, int nguide, int n, struct gd_nlm_conf conf, double scale)
{
	struct problem p[3];
	struct gd_nlm_frame f[2];
	struct gd_err err = { 0 };

	state = (uint32_t)(w * 1000 + h);
	for (int i = 0; i < 3; i++) {
		build(&p[i], w, h, nguide, n);
		fill(&p[i], scale);
	}
	p[0].frame = &p[1];
	p[1].frame = &p[2];
	p[1].window = conf.window;
	p[2].window = conf.window / 2;
	p[2].known = p[2].out[0];
	for (int y = 0; y < h; y++)
		for (int x = 0; x < w; x++)
			gd_row(p[2].known, y)[x] = (float)((x + y) % 3) / 2.0f;
	for (int i = 0; i < 2; i++)
		f[i] = (struct gd_nlm_frame){ p[i + 1].guide, p[i + 1].guide_var, p[i + 1].in,
					      p[i + 1].in_var, p[i + 1].known, p[i + 1].window };
	struct gd_nlm_job job = { nguide, n, p[0].guide, p[0].guide_var,
				  p[0].in, p[0].in_var, p[0].out, p[0].out_var };

	if (gd_nlm_frames(&job, f, 2, &conf, NULL, &err) != GD_OK)
		fail_msg("%s", err.text);
	compare(&p[0], &conf, scale);
	for (int i = 0; i < 3; i++)
		free(p[i].block);
}

static void windows_span_frames(void **unused)
{
	struct gd_nlm_conf conf = GD_NLM_DEFAULTS;

	(void)unused;
	frames(140, 37, 3, 3, conf, 1.0);
	frames(5, 3, 1, 2, conf, 1.0);
	conf.window = 0;
	frames(40, 35, 3, 2, conf, 1e-12);
	conf = GD_NLM_PREFILTER;
	frames(37, 41, 2, 2, conf, 1e12);
}

static void round_windows(void **unused)
{
	struct gd_nlm_conf conf = { .patch = 3, .k = 1.0, .eps = 1e-4, .round = true };

	(void)unused;
	for (conf.window = 0; conf.window <= 7; conf.window++)
		check(37, 23, 3, 2, conf, 1.0);
}

/* Columns with x % 16 == 3 are exact, but between noisy
 * ones; the noise of others grows with y % 11. */
static void negligible_noise(void **unused)
{
	const double share[] = { 1e-9, 0.01, 0.03 };
	const int least[] = { 1, 148 * 67 / 9, 148 * 67 / 4 };
	struct gd_nlm_conf conf = GD_NLM_PREFILTER;

	(void)unused;
	for (int i = 0; i < 3; i++) {
		conf.negligible = share[i];

		int kept = check(148, 67, 3, 3, conf, i == 1 ? 1e10 : 1.0);

		assert_in_range(kept, least[i], 148 * 67 * 3 / 4);
		check(5, 3, 3, 2, conf, 1.0);
	}
	conf.negligible = 1.0;
	assert_int_equal(check(70, 35, 2, 2, conf, 1.0), 70 * 35);
}

static void any_exposure(void **unused)
{
	(void)unused;
	check(33, 21, 3, 3, GD_NLM_DEFAULTS, 1e-12);
	check(33, 21, 3, 3, GD_NLM_DEFAULTS, 1e12);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(published_sizes),
		cmocka_unit_test(other_radii),
		cmocka_unit_test(sizes_below_the_window),
		cmocka_unit_test(windows_span_frames),
		cmocka_unit_test(round_windows),
		cmocka_unit_test(negligible_noise),
		cmocka_unit_test(any_exposure),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
