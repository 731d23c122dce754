/* SPDX-License-Identifier: BSD-3-Clause */
#include "pair_rows.h"

#include <math.h>

typedef float quad __attribute__((vector_size(16)));
typedef double dquad __attribute__((vector_size(32)));

#define WIDE(v) __builtin_convertvector(v, dquad)
#define NARROW(v) __builtin_convertvector(v, quad)
#define TINY 1e-30f	/* weights are 1 or around it: a sum below this is no edge at all */

static void diagonal(const struct gd_pair_graph *g, size_t from, size_t to)
{
	for (size_t i = from; i < to; i++) {
		const float *w = g->weight + i * GD_PAIR_LINKS;
		const float d = (w[0] + w[1]) + (w[2] + w[3]) + g->a[i];

		g->invd[i] = d > TINY ? 1 / d : 0;
	}
}

static void residual(double *sum, float *rv, const struct gd_pair_graph *g, const double *xv,
		     size_t from, size_t to)
{
	const dquad *x = (const dquad *)xv;
	const quad *primal = (const quad *)g->primal, *value = (const quad *)g->value;
	quad *r = (quad *)rv;
	dquad s = { 0 };

	for (size_t i = from; i < to; i++) {
		dquad t = (double)g->a[i] * (WIDE(primal[i]) - x[i]);

		for (size_t k = i * GD_PAIR_LINKS; k < (i + 1) * GD_PAIR_LINKS; k++)
			t += (double)g->weight[k] *
			     (x[(ptrdiff_t)i + g->jump[g->link[k]]] - x[i] - WIDE(value[k]));
		r[i] = NARROW(t);
		s += WIDE(r[i]) * WIDE(r[i]) * (double)g->invd[i];
	}
	for (int c = 0; c < 4; c++)
		sum[c] = s[c];
}

/* An edge that weighs 0 (no gradient) stays so, and so does a pixel. */
static void reweight(const struct gd_pair_graph *g, const double *xv, double alpha, double reg,
		     size_t from, size_t to)
{
	const dquad *x = (const dquad *)xv;
	const quad *primal = (const quad *)g->primal, *value = (const quad *)g->value;

	for (size_t i = from; i < to; i++) {
		const dquad p = alpha * (WIDE(primal[i]) - x[i]), pp = p * p;

		for (size_t k = i * GD_PAIR_LINKS; k < (i + 1) * GD_PAIR_LINKS; k++) {
			/* as the other end sees it, it is exactly the negative */
			const dquad e = x[(ptrdiff_t)i + g->jump[g->link[k]]] - x[i] -
					WIDE(value[k]);
			const dquad ee = e * e;
			const double norm = sqrt(ee[0] + ee[1] + ee[2]);

			g->weight[k] = g->weight[k] > 0 ? (float)(1 / (norm + reg)) : 0;
		}
		g->a[i] = g->a[i] > 0 ? (float)(alpha * alpha /
						(sqrt(pp[0] + pp[1] + pp[2]) + reg))
				      : 0;
	}
}

static void direction(float *pv, const struct gd_pair_graph *g, const float *rv,
		      const double *beta, size_t from, size_t to)
{
	const quad b = { (float)beta[0], (float)beta[1], (float)beta[2], 0 };
	const quad *r = (const quad *)rv;
	quad *p = (quad *)pv;

	for (size_t i = from; i < to; i++)
		p[i] = r[i] * g->invd[i] + b * p[i];
}

static void apply(double *sum, float *qv, const struct gd_pair_graph *g, const float *pv,
		  size_t from, size_t to)
{
	const quad *p = (const quad *)pv;
	quad *q = (quad *)qv;
	dquad s = { 0 };

	for (size_t i = from; i < to; i++) {
		const unsigned char *link = g->link + i * GD_PAIR_LINKS;
		const float *w = g->weight + i * GD_PAIR_LINKS;
		const quad here = p[i], *at = p + i;
		quad t = w[0] * (here - at[g->jump[link[0]]]);

		t += w[1] * (here - at[g->jump[link[1]]]);
		t += w[2] * (here - at[g->jump[link[2]]]);
		t += w[3] * (here - at[g->jump[link[3]]]);
		t += g->a[i] * here;
		q[i] = t;
		s += WIDE(here) * WIDE(t);
	}
	for (int c = 0; c < 4; c++)
		sum[c] = s[c];
}

static void step(double *sum, double *xv, float *rv, const struct gd_pair_graph *g,
		 const float *pv, const float *qv, const double *alpha, size_t from, size_t to)
{
	const dquad by = { alpha[0], alpha[1], alpha[2], 0 };
	const quad b = NARROW(by), *p = (const quad *)pv, *q = (const quad *)qv;
	dquad *x = (dquad *)xv, s = { 0 };
	quad *r = (quad *)rv;

	for (size_t i = from; i < to; i++) {
		x[i] += by * WIDE(p[i]);
		r[i] -= b * q[i];
		s += WIDE(r[i]) * WIDE(r[i]) * (double)g->invd[i];
	}
	for (int c = 0; c < 4; c++)
		sum[c] = s[c];
}

const struct gd_pair_kernels GD_KERNEL(gd_pair) = { diagonal,  residual, reweight,
						    direction, apply,	 step };
