/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * The models as they were published, one centre at a time. The features of the largest window are
 * replaced by those of their principal components that stand out of their noise, each of unit
 * variance; a window's model is b = (A + D I)^-1 c, which pulls it to the value of the centre pixel
 * (to which colour and features are relative here); errors are squares of what is missed, with the
 * noise in them, but the single pixel is offered with its variance.
 * Source: Moon et al. 2015, sections 4.2 and 7. Differs: one radius for all channels.
 */
#include <math.h>
#include <string.h>

#include "../lwr_impl.h"
#include "jacobi.h"
#include "kernel/lwr_batch.h"

#define LANES GD_LWR_LANES
#define PULL 1e-3	/* D: as published */
#define LEFT 1e-3	/* least 1 - h of a pixel left out */
#define WEAK 1e-6	/* of the strongest component's square: weaker ones are left out */
#define SWEEPS 30	/* of rotations; quadratic convergence takes less than ten */
#define P GD_LWR_COLUMNS

/* A symmetric matrix with its right-hand sides, and how far its columns are in use. */
struct system {
	int n, nc;
	double a[P][P], c[P][3];
};

struct centre {
	int n;				/* columns of the model */
	double turn[P][P];		/* [i][k]: column k of the model out of column i */
	double factor[P][P], inverse[P];	/* of A + D I: lower triangle, 1 / diagonal */
};

/* Eigenvalues on the diagonal of a, eigenvectors in the columns of v, by Jacobi's method. */
static void principal(double a[P][P], double v[P][P], int n)
{
	for (int i = 0; i < n; i++)
		for (int j = 0; j < n; j++)
			v[i][j] = i == j;
	for (int sweep = 0, turns = 1; sweep < SWEEPS && turns > 0; sweep++) {
		turns = 0;
		for (int i = 0; i < n; i++)
			for (int j = i + 1; j < n; j++) {
				if (!(fabs(a[i][j]) > 1e-15 * sqrt(fabs(a[i][i] * a[j][j]))))
					continue;
				gd_jacobi_turn(P, a, v, n, i, j);
				turns++;
			}
	}
}

/* The columns of the model from the moments m of the largest window. */
static void choose_columns(const struct gd_lwr_plan *p, const double *m, const double *sums,
			   struct centre *o)
{
	const int pitch = gd_lwr_pitch(p->q);
	double a[P][P], v[P][P], scale[P], noise = 0, most = 0, weight = m[0];

	for (int i = 0; i < p->nf; i++)
		scale[i] = p->range[i] > 0 ? 1 / p->range[i] : 0;
	for (int i = 0; i < p->nf; i++)
		for (int j = i; j < p->nf; j++)
			a[i][j] = a[j][i] = scale[i] * scale[j] *
				(m[(3 + i) * pitch + 3 + j] - m[3 + i] * m[3 + j] / weight);
	for (int k = 0; k < p->nfv; k++)
		noise += p->noise * sums[p->nc + p->nvar + k] * scale[p->noisy[k]] *
			 scale[p->noisy[k]];
	principal(a, v, p->nf);
	for (int i = 0; i < p->nf; i++)
		most = fmax(most, a[i][i]);
	memset(o->turn, 0, sizeof o->turn);
	o->turn[0][0] = 1;
	o->turn[1][1] = o->turn[2][2] = 1.0 / p->radius;
	o->n = 3;
	for (int k = 0; k < p->nf; k++) {
		if (!(a[k][k] > fmax(noise, WEAK * most)))
			continue;
		for (int i = 0; i < p->nf; i++)
			o->turn[3 + i][o->n] = scale[i] * v[i][k] / sqrt(a[k][k] / weight);
		o->n++;
	}
}

/* turn' m turn and turn' c, of the upper triangle m of one ring. */
static void transform(const struct gd_lwr_plan *p, const struct centre *o, const double *m,
		      struct system *to)
{
	const int pitch = gd_lwr_pitch(p->q), n = o->n;
	double half[P][P];

	for (int i = 0; i < p->p; i++)
		for (int k = 0; k < n; k++) {
			half[i][k] = 0;
			for (int j = 0; j < p->p; j++)
				half[i][k] += m[i < j ? i * pitch + j : j * pitch + i] *
					      o->turn[j][k];
		}
	to->n = n;
	to->nc = p->nc;
	for (int l = 0; l < n; l++) {
		for (int k = 0; k < n; k++) {
			to->a[l][k] = 0;
			for (int i = 0; i < p->p; i++)
				to->a[l][k] += o->turn[i][l] * half[i][k];
		}
		for (int c = 0; c < p->nc; c++) {
			to->c[l][c] = 0;
			for (int i = 0; i < p->p; i++)
				to->c[l][c] += o->turn[i][l] * m[i * pitch + p->p + c];
		}
	}
}

static void add_system(struct system *to, const struct system *s)
{
	for (int i = 0; i < s->n; i++) {
		for (int j = 0; j < s->n; j++)
			to->a[i][j] += s->a[i][j];
		for (int c = 0; c < s->nc; c++)
			to->c[i][c] += s->c[i][c];
	}
}

/* A + D I = L L'; a pivot that is rounding leaves its column out. */
static void decompose(struct centre *o, const struct system *s)
{
	for (int j = 0; j < o->n; j++) {
		double d = s->a[j][j] + PULL;

		for (int i = 0; i < j; i++) {
			double x = s->a[j][i];

			for (int k = 0; k < i; k++)
				x -= o->factor[j][k] * o->factor[i][k];
			o->factor[j][i] = x * o->inverse[i];
			d -= o->factor[j][i] * o->factor[j][i];
		}
		o->inverse[j] = d > 1e-15 * s->a[j][j] ? 1 / sqrt(d) : 0;
	}
}

/* x = L^-1 x */
static void forward(const struct centre *o, double *x)
{
	for (int j = 0; j < o->n; j++) {
		for (int k = 0; k < j; k++)
			x[j] -= o->factor[j][k] * x[k];
		x[j] *= o->inverse[j];
	}
}

/* x = (A + D I)^-1 x */
static void solve(const struct centre *o, double *x)
{
	forward(o, x);
	for (int j = o->n - 1; j >= 0; j--) {
		for (int k = j + 1; k < o->n; k++)
			x[j] -= o->factor[k][j] * x[k];
		x[j] *= o->inverse[j];
	}
}

static double ring_error(const struct system *s, const double b[P][3], int c, double square)
{
	for (int i = 0; i < s->n; i++) {
		double x = 0;

		for (int j = 0; j < s->n; j++)
			x += s->a[i][j] * b[j][c];
		square += b[i][c] * (x - 2 * s->c[i][c]);
	}
	return square;
}

/* Each of the first pixels predicted by the others. */
static void first_error(const struct gd_lwr_plan *p, const struct centre *o, const double *z, int n,
			const double b[P][3], double *acc)
{
	const int pitch = gd_lwr_pitch(p->q);

	for (int k = 0; k < n; k++, z += pitch) {
		double x[P] = { 0 }, h = 0, e[3];

		for (int i = 0; i < p->p; i++)
			for (int j = 0; j < o->n; j++)
				x[j] += o->turn[i][j] * z[i];
		for (int c = 0; c < p->nc; c++) {
			e[c] = -z[p->p + c];
			for (int j = 0; j < o->n; j++)
				e[c] += b[j][c] * x[j];
		}
		forward(o, x);
		for (int j = 0; j < o->n; j++)
			h += x[j] * x[j];
		for (int c = 0; c < p->nc; c++) {
			e[c] /= fmax(1 - h, LEFT);
			acc[c] += e[c] * e[c];
		}
	}
}

/* Lane l of the batch takes the model b of columns of `turn`, or with o = NULL the pixel itself. */
static void keep(const struct gd_lwr_plan *p, struct gd_lwr_batch *t, int l, const struct centre *o,
		 const double b[P][3], int radius, const double *xi, double cost)
{
	for (int i = 0; i < p->p; i++)
		for (int c = 0; c < p->nc; c++) {
			double sum = 0;

			for (int k = 0; o && k < o->n; k++)
				sum += o->turn[i][k] * b[k][c];
			t->best[i * p->nc + c][l] = sum;
		}
	for (int c = 0; c < p->nc; c++)
		t->xi[c][l] = xi[c];
	t->least[l] = cost;
	t->radius[l] = radius;
	t->features[l] = o ? o->n - 3 : 0;
}

/* Moments of the rings 1 .. R, one after the other from t->rings on; returns how many there are. */
static int measure(const struct gd_lwr_plan *p, struct gd_lwr_batch *t, int l, int *first)
{
	const int pitch = gd_lwr_pitch(p->q), size = p->p * pitch, sums = p->nc + p->nvar + p->nfv;
	int r;

	memset(t->m[l], 0, (size_t)size * sizeof *t->m[l]);
	memset(t->sums[l], 0, (size_t)sums * sizeof *t->sums[l]);
	for (r = 1; r <= p->radius; r++) {
		double *m = t->rings + (size_t)(r - 1) * gd_lwr_ring_size(p);
		struct gd_lwr_ring ring = { .z = t->z, .m = m, .s = m + size };

		gd_lwr_ring_pixels(p, t->x[l], t->y[l], r, t->ref[l], &ring);
		if (ring.n == 0)
			break;
		gd_lwr_ring_sums(p, &ring);
		if (r == 1) {
			*first = ring.n;
			memcpy(t->start, t->z, (size_t)ring.n * (size_t)pitch * sizeof *t->z);
		}
		for (int i = 0; i < p->p; i++)
			for (int j = i; j < p->q; j++)
				t->m[l][i * pitch + j] += m[i * pitch + j];
		for (int k = 0; k < sums; k++)
			t->sums[l][k] += ring.s[k];
	}
	return r - 1;
}

/* The planes beyond the colour, with the radius that this chose. */
static void fit_others(const struct gd_lwr_plan *p, struct gd_lwr_batch *t, int l, struct centre *o)
{
	const int others = p->ny - p->nc, radius = (int)t->radius[l];
	struct system all, ring;

	if (radius > 0)
		gd_lwr_other_sums(p, t, l);
	for (int r = 1; r <= radius; r++) {
		const double *m = t->rings + (size_t)(r - 1) * gd_lwr_ring_size(p);

		transform(p, o, m, r == 1 ? &all : &ring);
		if (r > 1)
			add_system(&all, &ring);
	}
	if (radius > 0)
		decompose(o, &all);
	for (int c = 0; c < others; c++) {
		double here = (double)gd_row(p->y[p->nc + c], t->y[l])[t->x[l]], x[P] = { 0 };

		for (int k = 0; radius > 0 && k < o->n; k++) {
			for (int i = 0; i < p->p; i++)
				x[k] += o->turn[i][k] * t->other[i * others + c][l];
			x[k] -= here * all.a[k][0];
		}
		if (radius > 0)
			solve(o, x);
		for (int i = 0; i < p->p; i++) {
			double sum = i == 0 ? here : 0;

			for (int k = 0; k < o->n; k++)
				sum += o->turn[i][k] * x[k];
			t->other_b[i * others + c][l] = sum;
		}
	}
}

static void fit_lane(const struct gd_lwr_plan *p, struct gd_lwr_batch *t, int l)
{
	const int size = p->p * gd_lwr_pitch(p->q);
	const float *px = p->pixel + ((size_t)t->y[l] * (size_t)p->w + (size_t)t->x[l]) * p->pitch;
	struct centre o;
	struct system all, ring;
	double b[P][3] = {{ 0 }}, acc[3] = { 0 }, xi[3], scale[3], cost = 0, weight = 0;
	int first = 0, rings;

	gd_lwr_reference(p, t->x[l], t->y[l], t->ref[l]);
	rings = measure(p, t, l, &first);
	choose_columns(p, t->m[l], t->sums[l], &o);
	for (int c = 0; c < p->nc; c++) {
		double mean = t->ref[l][p->p + c] + t->rings[p->p + c] / t->rings[0];

		scale[c] = 1 / (mean * mean + p->level2);
	}
	for (int c = 0; c < p->nvar; c++) {
		xi[c] = (double)px[p->q - 3 + c];
		cost += scale[c] * xi[c];
	}
	if (p->nvar)
		keep(p, t, l, NULL, b, 0, xi, cost);
	if (p->nvar && first == 1)
		rings = 0;	/* an image of one pixel */
	for (int r = 1; r <= rings; r++) {
		const double *m = t->rings + (size_t)(r - 1) * gd_lwr_ring_size(p);

		transform(p, &o, m, &ring);
		for (int c = 0; r > 1 && c < p->nc; c++)
			acc[c] += ring_error(&ring, b, c, m[size + c]);
		if (r == 1)
			all = ring;
		else
			add_system(&all, &ring);
		weight += m[0];
		decompose(&o, &all);
		for (int c = 0; c < p->nc; c++) {
			double x[P];

			for (int k = 0; k < o.n; k++)
				x[k] = all.c[k][c];
			solve(&o, x);
			for (int k = 0; k < o.n; k++)
				b[k][c] = x[k];
		}
		if (r == 1)
			first_error(p, &o, t->start, first, b, acc);
		cost = 0;
		for (int c = 0; c < p->nc; c++) {
			xi[c] = acc[c] / weight;
			cost += scale[c] * xi[c];
		}
		if ((r == 1 && !p->nvar) || (r > 1 && r <= p->radius_min) ||
		    cost < t->least[l])
			keep(p, t, l, &o, b, r, xi, cost);
	}
	if (p->ny > p->nc)
		fit_others(p, t, l, &o);
}

void gd_lwr_fit_paper(const struct gd_lwr_plan *p, struct gd_lwr_batch *t)
{
	for (int l = 0; l < t->n; l++)
		fit_lane(p, t, l);
}
