/* SPDX-License-Identifier: BSD-3-Clause */
/* Adaptive polynomial rendering: checks, the choice of columns, and the two loops over rows. */
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include <omp.h>

#include "apr.h"
#include "apr_impl.h"

#define SAMPLES 64	/* per axis, for the median of a feature and the level of the image */

int gd_apr_centres(int *centre, int n, int step)
{
	int count;

	if (n <= 1 || step < 1) {
		if (centre && n == 1)
			centre[0] = 0;
		return n == 1;
	}
	count = (n - 1 + step - 1) / step + 1;
	if (n % 2 == 0 && count % 2 == 1) /* an odd number cannot be symmetric about half a pixel */
		count++;
	for (int j = 0; centre && 2 * j < count; j++) {
		int x = (int)(((long)j * (n - 1) + (count - 1) / 2) / (count - 1));

		centre[j] = x;
		centre[count - 1 - j] = n - 1 - x;
	}
	return count;
}

static int compare(const void *a, const void *b)
{
	double x = *(const double *)a, y = *(const double *)b;

	return (x > y) - (x < y);
}

/* The k-th of SAMPLES places spread evenly over n pixels, first and last included. */
static int sample_at(int k, int n)
{
	return (int)((long)k * (n - 1) / (SAMPLES - 1));
}

/*
 * Median of a feature, and the lower quartile of its distance from that where there is any: where
 * the zero of the feature lies and how far its values reach at least, both untouched by a sky at
 * 1e10; range is that between the percentiles 0.5 and 99.5.
 */
static void feature_scale(struct gd_plane f, double *median, double *scale, double *range)
{
	double v[SAMPLES * SAMPLES];
	int n = 0, far = 0;

	for (int j = 0; j < SAMPLES; j++)
		for (int i = 0; i < SAMPLES; i++)
			v[n++] = (double)gd_row(f, sample_at(j, f.h))[sample_at(i, f.w)];
	qsort(v, (size_t)n, sizeof *v, compare);
	*median = v[n / 2];
	*range = v[n - 1 - n / 200] - v[n / 200];
	for (int i = 0; i < n; i++)
		if (v[i] != *median)
			v[far++] = fabs(v[i] - *median);
	qsort(v, (size_t)far, sizeof *v, compare);
	*scale = far > 0 ? v[far / 4] : 0.0;
}

static bool constant(struct gd_plane f)
{
	float first = f.v[0];

	for (int y = 0; y < f.h; y++)
		for (int x = 0; x < f.w; x++)
			if (gd_row(f, y)[x] != first)
				return false;
	return true;
}

static bool same(struct gd_plane a, struct gd_plane b)
{
	for (int y = 0; y < a.h; y++)
		if (memcmp(gd_row(a, y), gd_row(b, y), (size_t)a.w * sizeof(float)) != 0)
			return false;
	return true;
}

/* Takes the features that vary and are not a copy of an earlier one. */
static void take_features(struct gd_apr_plan *p, const struct gd_apr_in *in,
			  const struct gd_apr_conf *conf, const struct gd_report *report)
{
	for (int a = 0; a < in->nfeat; a++) {
		double scale, range;
		int k = 0;

		while (k < p->nf && !same(p->feat[k], in->feat[a]))
			k++;
		if (k < p->nf || constant(in->feat[a])) {
			gd_note(report, "feature plane %d is %s: left out", a,
				k < p->nf ? "a copy" : "constant");
			continue;
		}
		feature_scale(in->feat[a], &p->ref[k], &scale, &range);
		p->flat[k] = conf->flat * range * range;
		/* float rounding of a renderer's sums: 1e-6 of the scale */
		p->floor[k] = 1e-12 * scale * scale;
		p->feat[k] = in->feat[a];
		if (conf->feature_noise > 0 && in->feat_var && in->feat_var[a].v) {
			p->noisy[p->nfv] = k;
			p->feat_var[p->nfv++] = in->feat_var[a];
		}
		p->nf++;
	}
}

/*
 * 1 % of the squared mean level of the planes: what is added to a squared mean where channels are
 * weighed against each other, so that dark ones do not rule. Scales with the image.
 */
static double level_squared(const struct gd_apr_in *in)
{
	double sum = 0;

	for (int c = 0; c < in->nvar; c++) {
		double level[SAMPLES];

		for (int j = 0; j < SAMPLES; j++) {
			level[j] = 0;
			for (int i = 0; i < SAMPLES; i++)
				level[j] += fabs((double)gd_row(in->y[c], sample_at(j, in->y[c].h))
							[sample_at(i, in->y[c].w)]);
		}
		qsort(level, SAMPLES, sizeof *level, compare);	/* a firefly spoils one row */
		for (int j = SAMPLES / 4; j < SAMPLES * 3 / 4; j++)
			sum += level[j];
	}
	if (in->nvar > 0)
		sum /= (double)in->nvar * SAMPLES * SAMPLES / 2;
	return fmax(0.01 * sum * sum, 1e-280);
}

static void kernel_tables(struct gd_apr_plan *p, enum gd_apr_kernel kernel)
{
	int r = p->radius;

	for (int i = -r; i <= r; i++) {
		double u = r > 0 ? (double)i / r : 0, power = 1;
		double k = kernel == GD_APR_GAUSS ? exp(-2 * u * u) : 1;	/* deviation R/2 */

		for (int q = 0; q < GD_APR_POWERS; q++, power *= u) {
			p->k1[q][GD_APR_PAD + r + i] = k * power;
			p->k2[q][GD_APR_PAD + r + i] = k * k * power;
		}
	}
}

/* Sum over centres of K at each pixel of an axis. */
static void kernel_sums(double *sum, int n, const struct gd_apr_plan *p, const int *centre,
			int count)
{
	memset(sum, 0, (size_t)n * sizeof *sum);
	for (int j = 0; j < count; j++)
		for (int i = -p->radius; i <= p->radius; i++)
			if (centre[j] + i >= 0 && centre[j] + i < n)
				sum[centre[j] + i] += p->k1[0][GD_APR_PAD + p->radius + i];
}

static int check_planes(const struct gd_plane *plane, int n, struct gd_plane like, const char *what,
			struct gd_err *err)
{
	for (int i = 0; i < n; i++) {
		if (!plane[i].v)
			return gd_fail(err, GD_EARG, "apr: %s plane %d is missing", what, i);
		if (plane[i].w != like.w || plane[i].h != like.h)
			return gd_fail(err, GD_ESHAPE, "apr: %s plane %d is %dx%d, expected %dx%d",
				       what, i, plane[i].w, plane[i].h, like.w, like.h);
	}
	return GD_OK;
}

static int check(const struct gd_apr_out *out, const struct gd_apr_in *in,
		 const struct gd_apr_conf *c, struct gd_err *err)
{
	struct gd_plane like;
	int rc;

	if (in->ny < 1 || in->ny > GD_APR_RHS || in->nvar < 0 || in->nvar > in->ny)
		return gd_fail(err, GD_EARG, "apr: %d planes with %d variances, expected 1 to %d",
			       in->ny, in->nvar, GD_APR_RHS);
	if (in->nfeat < 0 || in->nfeat > GD_APR_FEATURES)
		return gd_fail(err, GD_EARG, "apr: %d feature planes, at most %d", in->nfeat,
			       GD_APR_FEATURES);
	if (c->radius < 0 || c->radius > GD_APR_RADIUS)
		return gd_fail(err, GD_EARG, "apr: radius %d, expected 0 to %d", c->radius,
			       GD_APR_RADIUS);
	if (c->step < 1 || c->step > 2 * c->radius + 1)
		return gd_fail(err, GD_EARG, "apr: step %d, expected 1 to %d", c->step,
			       2 * c->radius + 1);
	if (c->order_min < 0 || c->order_min > c->order_max || c->order_max > GD_APR_ORDER)
		return gd_fail(err, GD_EARG, "apr: orders %d to %d, expected 0 to %d", c->order_min,
			       c->order_max, GD_APR_ORDER);
	if (c->order_min < c->order_max && in->nvar < 1)
		return gd_fail(err, GD_EARG, "apr: no variance to choose the order by");
	if (!(c->ridge >= 0 && c->flat >= 0))
		return gd_fail(err, GD_EARG, "apr: ridge %g and flat %g, expected 0 or more",
			       c->ridge, c->flat);
	if (!(c->correlation > 0))
		return gd_fail(err, GD_EARG, "apr: correlation %g, expected above 0",
			       c->correlation);
	if (!in->y[0].v || in->y[0].w < 1 || in->y[0].h < 1)
		return gd_fail(err, GD_ESHAPE, "apr: empty image");
	like = in->y[0];
	rc = check_planes(in->y, in->ny, like, "input", err);
	if (rc == GD_OK)
		rc = check_planes(in->var, in->nvar, like, "variance", err);
	if (rc == GD_OK)
		rc = check_planes(in->feat, in->nfeat, like, "feature", err);
	if (rc == GD_OK && in->weight.v)
		rc = check_planes(&in->weight, 1, like, "weight", err);
	for (int a = 0; rc == GD_OK && in->feat_var && a < in->nfeat; a++)
		if (in->feat_var[a].v)
			rc = check_planes(in->feat_var + a, 1, like, "feature variance", err);
	if (rc == GD_OK)
		rc = check_planes(out->est, in->ny, like, "output", err);
	if (rc == GD_OK && out->mse)
		rc = check_planes(out->mse, in->nvar, like, "error", err);
	return rc;
}

static int fit_rows(const struct gd_apr_plan *plan, const struct gd_apr_kernels *k)
{
	size_t size = k->fit_size(plan), n = (size_t)omp_get_max_threads();
	double *space = gd_alloc(size * n, sizeof *space);

	if (!space)
		return GD_ENOMEM;
#pragma omp parallel for schedule(dynamic)
	for (int i = 0; i < plan->nrow; i++)
		k->fit_row(plan, i, space + size * (size_t)omp_get_thread_num());
	free(space);
	return GD_OK;
}

static int predict_rows(const struct gd_apr_plan *plan, const struct gd_apr_kernels *k,
			const struct gd_apr_out *out)
{
	size_t size = k->predict_size(plan), n = (size_t)omp_get_max_threads();
	double *space = gd_alloc(size * n, sizeof *space);

	if (!space)
		return GD_ENOMEM;
#pragma omp parallel for schedule(dynamic, 8)
	for (int y = 0; y < plan->h; y++)
		k->predict_row(plan, out, y, space + size * (size_t)omp_get_thread_num());
	free(space);
	return GD_OK;
}

int gd_apr_fit(const struct gd_apr_out *out, const struct gd_apr_in *in,
	       const struct gd_apr_conf *conf, const struct gd_report *report, struct gd_err *err)
{
	struct gd_apr_plan *plan = NULL;
	int *centre = NULL, rc = check(out, in, conf, err);

	if (rc != GD_OK)
		return rc;
	rc = GD_ENOMEM;
	plan = gd_calloc(1, sizeof *plan);
	if (!plan)
		goto done;
	plan->w = in->y[0].w;
	plan->h = in->y[0].h;
	plan->radius = conf->radius;
	plan->order_min = conf->order_min;
	plan->order = conf->order_max;
	plan->ny = in->ny;
	/* else the variances are of no use */
	plan->nv = conf->order_min < conf->order_max || out->mse ? in->nvar : 0;
	plan->y = in->y;
	plan->var = in->var;
	plan->weight = in->weight;
	plan->noise = conf->feature_noise;
	plan->ridge = conf->ridge;
	plan->correlation = conf->correlation;
	plan->level2 = level_squared(in);
	take_features(plan, in, conf, report);
	plan->pv = 1 + plan->nf + plan->order;
	plan->p = plan->pv + plan->order;
	plan->nmodel = plan->ny * plan->p + plan->nv + 2;
	plan->nx = gd_apr_centres(NULL, plan->w, conf->step);
	plan->nrow = gd_apr_centres(NULL, plan->h, conf->step);
	centre = gd_alloc((size_t)plan->nx + (size_t)plan->nrow, sizeof *centre);
	plan->model = gd_alloc((size_t)plan->nrow * (size_t)plan->nmodel,
			       sizeof(double) * (size_t)plan->nx);
	plan->sumx = gd_alloc((size_t)plan->w + (size_t)plan->h, sizeof(double));
	if (!centre || !plan->model || !plan->sumx)
		goto done;
	plan->sumy = plan->sumx + plan->w;
	gd_apr_centres(centre, plan->w, conf->step);
	gd_apr_centres(centre + plan->nx, plan->h, conf->step);
	plan->cx = centre;
	plan->cy = centre + plan->nx;
	kernel_tables(plan, conf->kernel);
	kernel_sums(plan->sumx, plan->w, plan, plan->cx, plan->nx);
	kernel_sums(plan->sumy, plan->h, plan, plan->cy, plan->nrow);
	rc = fit_rows(plan, GD_PICK(gd_apr_kernels));
	if (rc == GD_OK)
		rc = predict_rows(plan, GD_PICK(gd_apr_kernels), out);
done:
	if (rc != GD_OK)
		gd_fail(err, rc, "apr: out of memory");
	if (plan) {
		free(plan->model);
		free(plan->sumx);
	}
	free(plan);
	free(centre);
	return rc;
}
