/* SPDX-License-Identifier: BSD-3-Clause */
#include "lwrfit.h"

#include <math.h>

#include "halves.h"
#include "pilot.h"

#define BIAS_SELF	6.0	/* squared error per variance of the predictions, where no halves
				 * tell what noise does */

_Static_assert(GD_APR_RHS <= GD_LWR_RHS && GD_CROSSFIT_FEATURES + 4 <= GD_LWR_FEATURES,
	       "what gd_halves_check() lets pass fits into a model");

/*
 * Work space. other, spread, map: of the second half, for which the first has the output. fit: of a
 * half's colour, where `whole` is what is wanted. pilot: where there is no feature; its variances
 * are in the planes that the half's spread then takes.
 */
struct work {
	struct gd_plane other[GD_LWR_RHS], spread[3], map[3], fit[3], pilot[3], weight;
	struct gd_pilot_features scaled;
};

/* A half has nothing else to lean on than the colour itself. */
static bool needs_pilot(const struct gd_crossfit_in *in)
{
	return in->nfeature < 3;
}

/* With layers of all samples the half's colour is fitted, too: it chooses the windows. */
static int check(const struct gd_crossfit_in *in, struct gd_err *err)
{
	if (in->nwhole > GD_LWR_RHS - 3)
		return gd_fail(err, GD_EARG, "%d planes of all samples, at most %d", in->nwhole,
			       GD_LWR_RHS - 3);
	return GD_OK;
}

static int new_work(struct work *w, const struct gd_lwrfit_model *model,
		    const struct gd_crossfit_in *in, struct gd_err *err)
{
	struct gd_plane like = in->y[0][0];
	const struct gd_plane map[3] = { model->radius, model->features, model->centre };
	int rc = gd_halves_planes(&w->weight, 1, like, err);

	if (rc == GD_OK && !in->self)
		rc = gd_halves_planes(w->other, gd_halves_nest(in), like, err);
	if (rc == GD_OK && !in->self)
		rc = gd_halves_planes(w->spread, 3, like, err);
	for (int i = 0; i < 3 && rc == GD_OK && !in->self; i++)
		if (map[i].v)
			rc = gd_halves_planes(w->map + i, 1, like, err);
	if (rc == GD_OK && in->nwhole)
		rc = gd_halves_planes(w->fit, 3, like, err);
	if (rc == GD_OK && needs_pilot(in))
		rc = gd_halves_planes(w->pilot, 3, like, err);
	return rc;
}

static void free_work(struct work *w)
{
	gd_halves_free(w->other, GD_LWR_RHS);
	gd_halves_free(w->spread, 3);
	gd_halves_free(w->map, 3);
	gd_halves_free(w->fit, 3);
	gd_halves_free(w->pilot, 3);
	gd_halves_free(&w->weight, 1);
}

/* What a half leans on beside G-buffers: n planes by, made of the other half, three at least. */
static int explain(const struct gd_plane **by, int *n, struct work *w, struct gd_crossfit_in *in,
		   int half, struct gd_plane var[3], struct gd_err *err)
{
	static const struct gd_nlr_conf narrow = GD_PILOT_NARROW;
	int other = gd_halves_other(in, half), rc = GD_OK;

	*by = in->feature[other];
	*n = in->nfeature;
	if (needs_pilot(in)) {
		*by = w->pilot;
		*n = 3;
		rc = gd_pilot_make(w->pilot, in, other, &w->scaled, &narrow, var, w->weight, err);
	}
	if (rc == GD_OK)
		rc = gd_halves_weight(w->weight, *by, err);
	if (rc == GD_OK)
		gd_halves_weigh_count(w->weight, in, half);
	return rc;
}

static int fit_half(const struct gd_plane *est, struct gd_plane *spread,
		    const struct gd_lwrfit_model *model, struct work *w, struct gd_crossfit_in *in,
		    int half, const struct gd_lwr_conf *conf, struct gd_lwr_result *result,
		    const struct gd_report *report, struct gd_err *err)
{
	struct gd_plane feat[GD_LWR_FEATURES], y[GD_LWR_RHS], to[GD_LWR_RHS];
	struct gd_lwr_in lwr = { .y = y, .feat = feat };
	struct gd_lwr_out out = { .est = to, .spread = spread, .radius = model->radius,
				  .features = model->features, .centre = model->centre };
	const struct gd_plane *by;
	int n, rc = explain(&by, &n, w, in, half, spread, err);

	if (rc != GD_OK)
		return rc;
	for (int c = 0; c < 3 && in->nwhole; c++) {
		y[lwr.ny] = in->y[half][c];
		to[lwr.ny++] = w->fit[c];
	}
	for (int c = 0; c < gd_halves_nest(in); c++) {
		y[lwr.ny] = in->nwhole ? in->whole[c] : in->y[half][c];
		to[lwr.ny++] = est[c];
	}
	for (int a = 0; a < in->nfeat; a++)
		feat[lwr.nfeat++] = in->feat[a];
	for (int c = 0; c < n; c++)
		if (!gd_halves_constant(by[c]))
			feat[lwr.nfeat++] = by[c];
	if (in->self)
		lwr.var = in->var;
	else
		lwr.twin = in->y[1 - half];
	lwr.weight = w->weight;
	return gd_lwr_fit(&out, &lwr, conf, result, report, err);
}

/* to = (to + from) / 2 */
static void average(struct gd_plane to, struct gd_plane from)
{
	if (!to.v)
		return;
#pragma omp parallel for schedule(static)
	for (int y = 0; y < to.h; y++) {
		float *restrict a = gd_row(to, y);
		const float *restrict b = gd_row(from, y);

		for (int x = 0; x < to.w; x++)
			a[x] = a[x] / 2 + b[x] / 2;
	}
}

/* The spread of predictions as one plane: root of the mean of the three channels. */
static void root_mean(struct gd_plane to, const struct gd_plane square[3])
{
#pragma omp parallel for schedule(static)
	for (int y = 0; y < to.h; y++)
		for (int x = 0; x < to.w; x++) {
			double sum = 0;

			for (int c = 0; c < 3; c++)
				sum += (double)gd_row(square[c], y)[x];
			gd_row(to, y)[x] = gd_halves_float(sqrt(sum / 3));
		}
}

static int fit(const struct gd_crossfit_out *out, const struct gd_lwrfit_model *model,
	       struct work *w, struct gd_crossfit_in *in, const struct gd_lwr_conf *conf,
	       struct gd_lwrfit_result *result, const struct gd_report *report, struct gd_err *err)
{
	const struct gd_lwrfit_model second = { w->map[0], w->map[1], w->map[2] };
	struct gd_lwr_result got[2] = { 0 };
	int rc = GD_OK;

	for (int half = 0; half < gd_halves_count(in) && rc == GD_OK; half++) {
		gd_progress(report, "fitting", (double)half / gd_halves_count(in));
		rc = fit_half(half ? w->other : out->est, half ? w->spread : out->mse,
			      half ? &second : model, w, in, half, conf, got + half,
			      half ? NULL : report, err);
	}
	gd_progress(report, "fitting", 1);
	if (rc != GD_OK)
		return rc;
	result->models = got[0].models + got[1].models;
	result->mean_radius = (got[0].mean_radius * (double)got[0].models +
			       got[1].mean_radius * (double)got[1].models) /
			      (double)result->models;
	for (int c = 0; c < 3 && !in->self; c++)
		average(out->mse[c], w->spread[c]);
	if (!in->self) {
		average(model->radius, w->map[0]);
		average(model->features, w->map[1]);
		average(model->centre, w->map[2]);
	}
	return GD_OK;
}

int gd_lwrfit_run(const struct gd_crossfit_out *out, const struct gd_lwrfit_model *model,
		  struct gd_crossfit_in *in, const struct gd_lwr_conf *conf,
		  struct gd_lwrfit_result *result, const struct gd_report *report,
		  struct gd_err *err)
{
	struct work w = { 0 };
	double start = gd_seconds();
	int rc = gd_halves_check(in, err);

	*result = (struct gd_lwrfit_result){ .gain = 1 };
	if (rc == GD_OK)
		rc = check(in, err);
	if (rc == GD_OK)
		rc = gd_halves_cut(in, err);
	if (rc == GD_OK)
		rc = gd_halves_calm(in, err);
	if (rc == GD_OK && needs_pilot(in))
		rc = gd_halves_scale(w.scaled.at, &w.scaled.n, in->feat, in->nfeat,
				     GD_PILOT_FEATURES, err);
	if (rc == GD_OK)
		rc = new_work(&w, model, in, err);
	if (rc == GD_OK)
		rc = fit(out, model, &w, in, conf, result, report, err);
	if (rc == GD_OK && out->spread.v)
		root_mean(out->spread, out->mse);
	if (rc == GD_OK)
		rc = gd_halves_finish(out, in->self ? out->est : w.other, in,
				      in->self ? BIAS_SELF : 1, w.weight, &result->gain, err);
	free_work(&w);
	result->fit_seconds = gd_seconds() - start;
	return rc;
}
