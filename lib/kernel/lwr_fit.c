/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * The models of a batch of centres, one centre per lane, for growing windows: from the sums of
 * each ring follow the error of the model before it, then the next model.
 *
 * With A = sum w z z' = L L' and c = sum w z y the model is b = A^-1 c. On a ring with moments
 * A_r, c_r, s_r its squared error is b'A_r b - 2 b'c_r + s_r; against an independent twin t of y it
 * is b'A_r b - b'(c_r + ct_r) + sum w y t. On the first window, where nothing is left to test on,
 * each pixel is predicted without itself: its misfit e becomes e / (1 - h), h = w |L^-1 z|^2.
 */
#include <math.h>

#include "../lwr_impl.h"
#include "kernel/lwr_batch.h"

#define LANES GD_LWR_LANES
typedef gd_lwr_vec vec;

/*
 * A column is left out where what remains of it, after those before it, is rounding: below RAW of
 * its own square (products of doubles cancel to a few 1e-16 of that) or COLLINEAR of its square
 * about the window's mean (1e-4 of its spread: less cannot be told from float rounding once
 * coefficients multiply it).
 */
#define RAW 1e-12
#define COLLINEAR 1e-8
#define LEFT 1e-6	/* 1 - h below this is no prediction: the pixel alone carries a column */

GD_LWR_INLINE vec splat(double x)
{
	return x - (vec){ 0 };
}

GD_LWR_INLINE vec larger(vec a, vec b)
{
	for (int l = 0; l < LANES; l++)
		a[l] = a[l] > b[l] ? a[l] : b[l];
	return a;
}

GD_LWR_INLINE vec *tri_row(vec *a, int i)
{
	return a + (size_t)i * (i + 1) / 2;
}

/* Noise of column j in the windows, times feature_noise; 0 for exact and other columns. */
static vec column_noise(const struct gd_lwr_plan *p, const vec *s, int j)
{
	for (int a = 0; a < p->nfv; a++)
		if (p->noisy[a] == j - 3)
			return p->noise * s[p->nc + p->nvar + a];
	return (vec){ 0 };
}

/*
 * A = L L', leaving out columns without substance and those beyond the share of the pixels that a
 * model may use; inv: 1 / L_jj, 0 where left out.
 */
static void decompose(const struct gd_lwr_plan *p, struct gd_lwr_batch *t)
{
	vec weight = t->a[0], used = { 0 };

	for (int j = 0; j < p->p; j++) {
		vec *lj = tri_row(t->l, j), *aj = tri_row(t->a, j), d = aj[j], least;

		for (int i = 0; i < j; i++) {
			vec *li = tri_row(t->l, i), x = aj[i];

			for (int k = 0; k < i; k++)
				x -= lj[k] * li[k];
			lj[i] = x * t->inv[i];
		}
		least = RAW * d;
		if (j > 0) {
			vec spread = larger(d - lj[0] * lj[0], (vec){ 0 });

			least = larger(least, COLLINEAR * spread);
			d += p->ridge * spread;
			if (j >= 3) {
				d += p->flat[j - 3] * weight;
				least = larger(least, column_noise(p, t->s, j));
				least = larger(least, p->floor[j - 3] * weight);
			}
		}
		for (int k = 0; k < j; k++)
			d -= lj[k] * lj[k];
		for (int l = 0; l < LANES; l++) {
			int in = d[l] > least[l] && used[l] < GD_LWR_SHARE * t->pixels[l];

			t->inv[j][l] = in ? 1.0 / sqrt(d[l]) : 0.0;
			used[l] += in;
		}
		lj[j] = d * t->inv[j];
	}
	t->used = used;
}

/* b = L'^-1 L^-1 c, n right-hand sides, interleaved by `step` in c and by n in b. */
static void substitute(const struct gd_lwr_plan *p, vec *l, const vec *inv, const vec *c, int step,
		       vec *b, int n)
{
	for (int j = 0; j < p->p; j++) {
		const vec *lj = tri_row(l, j);

		for (int q = 0; q < n; q++) {
			vec x = c[j * step + q];

			for (int k = 0; k < j; k++)
				x -= lj[k] * b[k * n + q];
			b[j * n + q] = x * inv[j];
		}
	}
	for (int j = p->p - 1; j >= 0; j--) {
		const vec *lj = tri_row(l, j);

		for (int q = 0; q < n; q++) {
			vec x = b[j * n + q] * inv[j];

			b[j * n + q] = x;
			for (int k = 0; k < j; k++)
				b[k * n + q] -= lj[k] * x;
		}
	}
}

/* The squared error of the models on the ring, channel c, with the noise taken off. */
static vec ring_error(const struct gd_lwr_plan *p, const struct gd_lwr_batch *t, int c)
{
	const int nc = p->nc, step = p->q - p->p;
	vec sum = t->rs[c];

	for (int i = 0; i < p->p; i++) {
		const vec *ai = t->ra + (size_t)i * (i + 1) / 2, *ci = t->rc + i * step + c;
		vec cross = p->twin ? ci[0] + ci[nc] : 2.0 * ci[0], x = { 0 };

		for (int j = 0; j < i; j++)
			x += ai[j] * t->b[j * nc + c];
		sum += t->b[i * nc + c] * (2.0 * x + ai[i] * t->b[i * nc + c] - cross);
	}
	return p->nvar ? sum - t->rs[nc + c] : sum;
}

/* The same on the first window, each pixel predicted by the others. */
static void first_error(const struct gd_lwr_plan *p, struct gd_lwr_batch *t)
{
	const int nc = p->nc;
	vec x[GD_LWR_COLUMNS];

	for (int c = 0; c < nc; c++)
		t->acc[c] = p->nvar ? -t->s[nc + c] : (vec){ 0 };
	for (int k = 0; k < 9; k++) {
		const vec *z = t->first + (size_t)k * p->q;
		vec h = { 0 };

		for (int j = 0; j < p->p; j++) {
			const vec *lj = tri_row(t->l, j);
			vec sum = z[j];

			for (int i = 0; i < j; i++)
				sum -= lj[i] * x[i];
			x[j] = sum * t->inv[j];
			h += x[j] * x[j];
		}
		for (int c = 0; c < nc; c++) {
			vec y = z[p->p + c], e = -y, other;

			for (int j = 0; j < p->p; j++)
				e += t->b[j * nc + c] * z[j];
			for (int l = 0; l < LANES; l++)
				e[l] = 1 - h[l] > LEFT ? e[l] / (1 - h[l]) : -y[l];
			other = p->twin ? e + y - z[p->p + nc + c] : e;
			t->acc[c] += e * other;
		}
	}
}

/* Lanes in which the error is the least so far take the model. */
static void compare(const struct gd_lwr_plan *p, struct gd_lwr_batch *t, int r)
{
	const int n = p->p * p->nc;
	vec cost = { 0 }, over = 1.0 / larger(t->a[0], splat(1e-300));
	int better[LANES], any = 0;

	for (int c = 0; c < p->nc; c++)
		cost += t->scale[c] * t->acc[c];
	cost *= over;
	for (int l = 0; l < LANES; l++) {
		better[l] = !t->done[l] && (r == 1 || r <= p->radius_min || cost[l] < t->least[l]);
		any |= better[l];
	}
	if (!any)
		return;
	for (int l = 0; l < LANES; l++) {
		if (!better[l])
			continue;
		t->least[l] = cost[l];
		t->radius[l] = r;
		t->features[l] = (int)t->used[l];
		for (int c = 0; c < p->nc; c++)
			t->xi[c][l] = t->acc[c][l] * over[l];
	}
	for (int i = 0; i < n; i++)
		for (int l = 0; l < LANES; l++)
			t->best[i][l] = better[l] ? t->b[i][l] : t->best[i][l];
	if (p->ny == p->nc)
		return;
	for (int i = 0; i < p->p * (p->p + 1) / 2; i++)
		for (int l = 0; l < LANES; l++)
			t->best_l[i][l] = better[l] ? t->l[i][l] : t->best_l[i][l];
	for (int i = 0; i < p->p; i++)
		for (int l = 0; l < LANES; l++)
			t->best_inv[i][l] = better[l] ? t->inv[i][l] : t->best_inv[i][l];
}

/* Weights of the channels in the choice: by their squared mean in the first window. */
static void weigh(const struct gd_lwr_plan *p, struct gd_lwr_batch *t)
{
	vec over = 1.0 / larger(t->a[0], splat(1e-300));

	for (int c = 0; c < p->nc; c++) {
		vec mean = t->c[c] * over;

		for (int l = 0; l < LANES; l++)
			mean[l] += t->ref[l][p->p + c];
		t->scale[c] = 1.0 / (mean * mean + p->level2);
	}
}

/* From the moments of each lane's ring to one vector per number. */
static void gather(const struct gd_lwr_plan *p, struct gd_lwr_batch *t)
{
	const int pitch = gd_lwr_pitch(p->q), step = p->q - p->p;
	const int sums = p->nc + p->nvar + p->nfv;

	for (int l = 0; l < LANES; l++) {
		const double *m = t->m[l];

		for (int i = 0; i < p->p; i++, m += pitch) {
			for (int j = i; j < p->p; j++)
				tri_row(t->ra, j)[i][l] = m[j];
			for (int c = 0; c < step; c++)
				t->rc[i * step + c][l] = m[p->p + c];
		}
		for (int k = 0; k < sums; k++)
			t->rs[k][l] = t->sums[l][k];
	}
}

/* Sums of the ring r of every lane that still grows; returns how many have any pixels. */
static int measure(const struct gd_lwr_plan *p, struct gd_lwr_batch *t, int r)
{
	const int pitch = gd_lwr_pitch(p->q);
	int growing = 0;

	for (int l = 0; l < LANES; l++) {
		struct gd_lwr_ring ring = { .z = t->z, .m = t->m[l], .s = t->sums[l] };

		if (t->done[l])
			continue;
		gd_lwr_ring_pixels(p, t->x[l], t->y[l], r, t->ref[l], &ring);
		gd_lwr_ring_sums(p, &ring);
		t->pixels[l] += ring.n;
		growing += ring.n > 0;
		for (int k = 0; r == 1 && k < 9; k++)
			for (int j = 0; j < p->q; j++)
				t->first[k * p->q + j][l] = k < ring.n ? ring.z[k * pitch + j] : 0;
	}
	if (growing)
		gather(p, t);
	return growing;
}

static void total(const struct gd_lwr_plan *p, struct gd_lwr_batch *t, int first)
{
	const int tri = p->p * (p->p + 1) / 2, n = p->p * (p->q - p->p);
	const int sums = p->nc + p->nvar + p->nfv;

	for (int i = 0; i < tri; i++)
		t->a[i] = first ? t->ra[i] : t->a[i] + t->ra[i];
	for (int i = 0; i < n; i++)
		t->c[i] = first ? t->rc[i] : t->c[i] + t->rc[i];
	for (int i = 0; i < sums; i++)
		t->s[i] = first ? t->rs[i] : t->s[i] + t->rs[i];
}

void gd_lwr_fit_batch(const struct gd_lwr_plan *p, struct gd_lwr_batch *t)
{
	for (int l = 0; l < LANES; l++) {
		t->done[l] = l >= t->n;
		t->pixels[l] = 0;
		if (l < t->n)
			gd_lwr_reference(p, t->x[l], t->y[l], t->ref[l]);
	}
	for (int r = 1; r <= p->radius && measure(p, t, r); r++) {
		if (r > 1)
			for (int c = 0; c < p->nc; c++)
				t->acc[c] += ring_error(p, t, c);
		total(p, t, r == 1);
		decompose(p, t);
		substitute(p, t->l, t->inv, t->c, p->q - p->p, t->b, p->nc);
		if (r == 1) {
			weigh(p, t);
			first_error(p, t);
		}
		compare(p, t, r);
	}
}

/* Sums of the columns with the planes beyond the colour, over the window of the lane's model. */
static void other_sums(const struct gd_lwr_plan *p, struct gd_lwr_batch *t, int l)
{
	const int others = p->ny - p->nc, r = t->radius[l];
	struct gd_lwr_ring ring = { .z = t->z, .s = t->sums[l] };

	for (int i = 0; i < p->p * others; i++)
		t->other[i][l] = 0;
	for (int y = t->y[l] - r; y <= t->y[l] + r; y++) {
		if (y < 0 || y >= p->h)
			continue;
		for (int x = t->x[l] - r; x <= t->x[l] + r; x++) {
			double root = 1;

			if (x < 0 || x >= p->w)
				continue;
			ring.n = 0;
			gd_lwr_ring_pixel(p, x, y, x - t->x[l], y - t->y[l], t->ref[l], &ring);
			root = ring.z[0];
			for (int j = 0; j < p->p; j++)
				for (int c = 0; c < others; c++)
					t->other[j * others + c][l] +=
						ring.z[j] * root *
						(double)gd_row(p->y[p->nc + c], y)[x];
		}
	}
}

void gd_lwr_fit_others(const struct gd_lwr_plan *p, struct gd_lwr_batch *t)
{
	const int others = p->ny - p->nc;

	for (int l = 0; l < t->n; l++)
		other_sums(p, t, l);
	substitute(p, t->best_l, t->best_inv, t->other, others, t->other_b, others);
}
