/* SPDX-License-Identifier: BSD-3-Clause */
#include "crossfit.h"

#include "apr_prep.h"
#include "gate.h"
#include "gather.h"
#include "halves.h"
#include "pilot.h"

/* Of a column's spread: 1e-3 is as good, 1e-2 worse by 1 %, none by 6 %. */
#define RIDGE		1e-4
/*
 * Of a feature's squared range, that is 0.3 % of the range: below is noise, not shape. 1e-4 loses
 * 5 % (texture), none 5 % (door: up to 22 %).
 */
#define FLAT		1e-5

/* A regression: windows of 2R+1, centres step apart, a polynomial of that order. */
struct model {
	bool feature, pilot;
	int radius, step, order;
};

/*
 * A pilot, and the models that lean on it. Unlike pilots err differently: the mean gains. The first
 * model alone may do with a pilot of its own: one that only weighs pixels.
 */
struct stage {
	struct gd_nlr_conf pilot, alone;
	int n;
	struct model model[4];
};

/*
 * In windows of 5x5 a pilot takes 0.6 times as long, and weighs as well (relMSE of four scenes
 * -2 to 4 %); no pilot but the feature would cost 30 % where light is rare. To lean on it is too
 * noisy (5 %).
 */
#define GLANCE	{ .window = 2, .patch = 1, .k = 0.8, .eps = 1e-6, .ridge = 1e-3 }

static const struct stage with_feature[] = {
	{ GD_PILOT_NARROW, GLANCE, 2,
	  { { true, false, 10, 5, 1 }, { true, true, 10, 5, 1 } } },
	{ GD_PILOT_WIDE, GD_PILOT_WIDE, 2,
	  { { true, true, 21, 8, 2 }, { true, false, 21, 8, 2 } } },
};
static const struct stage without_feature[] = {
	{ GD_PILOT_NARROW, GD_PILOT_NARROW, 2,
	  { { false, true, 10, 5, 1 }, { false, true, 21, 8, 2 } } },
	{ GD_PILOT_WIDE, GD_PILOT_WIDE, 2,
	  { { false, true, 7, 3, 0 }, { false, true, 21, 8, 2 } } },
};
#define STAGES 2

/*
 * Work space. The pilot is of the half that is not being fitted; fit holds its variances while it
 * is made, weight is the blurs' spare plane then. Of a gate, alone holds either half's models
 * without pilots, and leverage adds up what pilots have more.
 */
struct work {
	struct gd_plane pilot[3], sum[GD_APR_RHS], fit[GD_APR_RHS], weight;
	struct gd_plane alone[2][GD_APR_RHS];
	struct gd_pilot_features scaled;
	double leverage;
};

/* ---- the regressions ---- */

static bool gated(const struct gd_crossfit_in *in, const struct gd_crossfit_conf *conf)
{
	return in->nfeature && !in->self && !conf->fast;
}

static int fit_model(struct work *w, const struct gd_crossfit_in *in, int half,
		     const struct model *m, const struct gd_report *report, struct gd_err *err)
{
	struct gd_apr_conf conf = GD_APR_DEFAULTS;
	struct gd_plane feat[GD_APR_FEATURES];
	struct gd_apr_in apr = { .ny = gd_halves_nest(in),
				 .y = in->nwhole ? in->whole : in->y[half],
				 .feat = feat, .weight = w->weight };
	struct gd_apr_out out = { .est = w->fit };

	for (int a = 0; a < in->nfeat; a++)
		feat[apr.nfeat++] = in->feat[a];
	for (int c = 0; c < 3 && m->pilot; c++)
		if (!gd_halves_constant(w->pilot[c]))
			feat[apr.nfeat++] = w->pilot[c];
	if (m->pilot)	/* a Gaussian of deviation R/2 sums as many pixels as it weighs alike */
		w->leverage += (apr.nfeat - in->nfeat) / (M_PI * m->radius * m->radius);
	for (int c = 0; c < in->nfeature && m->feature; c++)
		feat[apr.nfeat++] = in->feature[gd_halves_other(in, half)][c];
	conf.ridge = RIDGE;
	conf.flat = FLAT;
	conf.radius = m->radius;
	conf.step = m->step;
	conf.order_min = conf.order_max = m->order;
	return gd_apr_fit(&out, &apr, &conf, report, err);
}

/*
 * Where a half's models go, as gd_halves_add() has them; done: models in them already. Of a gate,
 * mean[1] holds those without a pilot; else all are in mean[0].
 */
struct half {
	const struct gd_plane *mean[2], *square;
	int half, done[2];
};

static int fit_half(struct half *to, struct work *w, const struct gd_crossfit_in *in,
		    const struct model *model, int n, const struct gd_report *report,
		    struct gd_err *err)
{
	int rc = gd_halves_weight(w->weight, w->pilot, err);

	if (rc == GD_OK)
		gd_halves_weigh_count(w->weight, in, to->half);
	for (int i = 0; i < n && rc == GD_OK; i++) {
		const int kind = w->alone[0][0].v && !model[i].pilot;
		/* says once what holds for all */
		const bool first = to->done[0] + to->done[1] + to->half == 0;

		rc = fit_model(w, in, to->half, &model[i], first ? report : NULL, err);
		if (rc == GD_OK)
			gd_halves_add(to->mean[kind], to->square, w->fit, gd_halves_nest(in),
				      ++to->done[kind]);
	}
	return rc;
}

static int run_stage(const struct gd_crossfit_out *out, struct work *w,
		     const struct gd_crossfit_in *in, const struct stage *stage, int n,
		     struct gd_crossfit_result *result, const struct gd_report *report,
		     struct gd_err *err)
{
	int rc = GD_OK;

	for (int half = 0; half < gd_halves_count(in) && rc == GD_OK; half++) {
		struct half to = { { half ? w->sum : out->est, w->alone[half] }, out->mse, half,
				   { result->models } };
		double start = gd_seconds(), pilot;

		rc = gd_pilot_make(w->pilot, in, gd_halves_other(in, half), &w->scaled,
				   n > 1 ? &stage->pilot : &stage->alone, w->fit, w->weight, err);
		pilot = gd_seconds();
		if (w->alone[0][0].v)	/* a stage has as many models of either kind */
			to.done[0] = to.done[1] = result->models / 2;
		if (rc == GD_OK)
			rc = fit_half(&to, w, in, stage->model, n, report, err);
		result->pilot_seconds += pilot - start;
		result->fit_seconds += gd_seconds() - pilot;
	}
	result->models += n;
	return rc;
}

static int run_stages(const struct gd_crossfit_out *out, struct work *w,
		      const struct gd_crossfit_in *in, const struct gd_crossfit_conf *conf,
		      struct gd_crossfit_result *result, const struct gd_report *report,
		      struct gd_err *err)
{
	const struct stage *stage = in->nfeature ? with_feature : without_feature;
	int stages = conf->fast ? 1 : STAGES;
	int rc = gd_halves_scale(w->scaled.at, &w->scaled.n, in->feat, in->nfeat,
				 GD_PILOT_FEATURES, err);

	for (int i = 0; i < stages && rc == GD_OK; i++) {
		gd_progress(report, "fitting", (double)i / stages);
		rc = run_stage(out, w, in, stage + i, conf->fast ? 1 : stage[i].n, result, report,
			       err);
	}
	gd_progress(report, "fitting", 1);
	return rc;
}

/* Takes of the models without a pilot, for both halves alike, what the samples speak for. */
static int run_gate(const struct gd_crossfit_out *out, struct work *w,
		    const struct gd_crossfit_in *in, const struct gd_crossfit_result *result,
		    const struct gd_report *report, struct gd_err *err)
{
	/* both halves together have as many fits with a pilot as either has models */
	const struct gd_gate gate = {
		.in = in, .a = { w->alone[0], w->alone[1] }, .b = { out->est, w->sum },
		.leverage = w->leverage / result->models * gd_apr_correlation(in->y[0], in->y[1])
	};
	double mean;
	int rc = gd_gate_map(w->weight, &mean, &gate, w->pilot, err);

	if (rc != GD_OK)
		return rc;
	gd_note(report, "%.0f %% by models that lean on the gradients' feature without a pilot",
		100 * mean);
	for (int half = 0; half < 2; half++)
		gd_gate_mix(gate.b[half], gate.a[half], gd_halves_nest(in), w->weight, out->mse,
			    result->models);
	return GD_OK;
}

/* What is made of the models of all halves. */
static int finish(const struct gd_crossfit_out *out, struct work *w,
		  const struct gd_crossfit_in *in, struct gd_crossfit_result *result,
		  struct gd_err *err)
{
	if (out->spread.v)
		gd_halves_spread(out->spread, out->mse, in, result->models);
	return gd_halves_finish(out, in->self ? out->est : w->sum, in,
				gd_halves_disagree(in, result->models), w->weight, &result->gain,
				err);
}

static int new_work(struct work *w, const struct gd_crossfit_in *in, bool with_gate,
		    struct gd_err *err)
{
	struct gd_plane like = in->y[0][0];
	int n = gd_halves_nest(in), rc = gd_halves_planes(&w->weight, 1, like, err);

	if (rc == GD_OK)
		rc = gd_halves_planes(w->pilot, 3, like, err);
	if (rc == GD_OK && !in->self)
		rc = gd_halves_planes(w->sum, n, like, err);
	if (rc == GD_OK)
		rc = gd_halves_planes(w->fit, n, like, err);
	for (int half = 0; half < 2 && with_gate && rc == GD_OK; half++)
		rc = gd_halves_planes(w->alone[half], n, like, err);
	return rc;
}

static int run(const struct gd_crossfit_out *out, const struct gd_crossfit_in *in,
	       const struct gd_crossfit_conf *conf, struct gd_crossfit_result *result,
	       const struct gd_report *report, struct gd_err *err)
{
	struct work w = { 0 };
	const bool with_gate = gated(in, conf);
	int rc = new_work(&w, in, with_gate, err);

	if (rc == GD_OK) {
		gd_halves_clear(out->est, gd_halves_nest(in));
		gd_halves_clear(w.sum, in->self ? 0 : gd_halves_nest(in));
		for (int half = 0; half < 2; half++)
			gd_halves_clear(w.alone[half], with_gate ? gd_halves_nest(in) : 0);
		gd_halves_clear(out->mse, 3);
		rc = run_stages(out, &w, in, conf, result, report, err);
	}
	if (rc == GD_OK && with_gate)
		rc = run_gate(out, &w, in, result, report, err);
	if (rc == GD_OK)
		rc = finish(out, &w, in, result, err);
	gd_halves_free(w.pilot, 3);
	gd_halves_free(&w.weight, 1);
	gd_halves_free(w.sum, GD_APR_RHS);
	gd_halves_free(w.alone[0], GD_APR_RHS);
	gd_halves_free(w.alone[1], GD_APR_RHS);
	gd_halves_free(w.fit, GD_APR_RHS);
	return rc;
}

int gd_crossfit_run(const struct gd_crossfit_out *out, struct gd_crossfit_in *in,
		    const struct gd_crossfit_conf *conf, struct gd_crossfit_result *result,
		    const struct gd_report *report, struct gd_err *err)
{
	struct gd_plane count[2] = { { 0 } };
	double start = gd_seconds();
	int rc = gd_halves_check(in, err);

	*result = (struct gd_crossfit_result){ .gain = 1 };
	if (rc == GD_OK)
		rc = gd_halves_cut(in, err);
	if (rc == GD_OK)
		rc = gd_halves_calm(in, err);
	if (rc == GD_OK) {
		struct gd_crossfit_in all = *in;	/* of which the counts are ours */

		rc = gd_gather(&all, count, report, err);
		result->gather_seconds = gd_seconds() - start;
		if (rc == GD_OK)
			rc = run(out, &all, conf, result, report, err);
	}
	gd_halves_free(count, 2);
	return rc;
}
