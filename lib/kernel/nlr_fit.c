/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Moments and solution of the regressions of one row of centres, a vector of neighbouring centres
 * at a time. The sums over the window are taken in blocks of a few rows and columns of the matrix
 * of moments [z | y]' W [z | y] that fit into registers; columns are read again for each block.
 */
#include "kernel/nlr_tile.h"

typedef gd_nlr_vec vec;

#define PITCH GD_NLR_PITCH
#define STEP (GD_NLR_TERMS + 3)		/* from one row of moments to the next */

/* One group of centres. */
struct group {
	const float *col, *fit;		/* at the centres; of the first shift */
	ptrdiff_t row;			/* floats between rows of col */
	int window;
	vec centre[STEP];		/* of the features; 0 for the other columns */
	vec m[GD_NLR_TERMS * STEP];	/* moments, those right of the diagonal */
};

/* Moments of the columns a .. a+na-1 with b .. b+nb-1. */
GD_NLR_INLINE void block(struct group *g, int a, int b, const int na, const int nb)
{
	const int side = 2 * g->window + 1;
	const float *w = g->fit;
	vec sum[8][8], ca[8], cb[8];

	for (int i = 0; i < na; i++) {
		ca[i] = g->centre[a + i];
		for (int j = 0; j < nb; j++)
			sum[i][j] = (vec){ 0 };
	}
	for (int j = 0; j < nb; j++)
		cb[j] = g->centre[b + j];
	for (int dy = -g->window; dy <= g->window; dy++) {
		const float *pa = g->col + dy * g->row - g->window + a * PITCH;
		const float *pb = g->col + dy * g->row - g->window + b * PITCH;

		for (int i = 0; i < side; i++, pa++, pb++, w += GD_NLR_WPITCH) {
			vec v = gd_nlr_load(w), wa[8];

			for (int k = 0; k < na; k++)
				wa[k] = v * (gd_nlr_load(pa + k * PITCH) - ca[k]);
			for (int j = 0; j < nb; j++) {
				vec z = gd_nlr_load(pb + j * PITCH) - cb[j];

				for (int k = 0; k < na; k++)
					sum[k][j] += wa[k] * z;
			}
		}
	}
	for (int i = 0; i < na; i++)
		for (int j = 0; j < nb; j++)
			g->m[(a + i) * STEP + b + j] = sum[i][j];
}

#define BLOCK(na, nb) \
	__attribute__((noinline)) static void block_##na##_##nb(struct group *g, int a, int b) \
	{ \
		block(g, a, b, na, nb); \
	}
BLOCK(1, 1) BLOCK(1, 2) BLOCK(1, 3) BLOCK(1, 4) BLOCK(1, 5) BLOCK(1, 6)
BLOCK(2, 1) BLOCK(2, 2) BLOCK(2, 3) BLOCK(2, 4) BLOCK(2, 5) BLOCK(2, 6)
BLOCK(3, 1) BLOCK(3, 2) BLOCK(3, 3) BLOCK(3, 4)

static void (*const blocks[3][6])(struct group *g, int a, int b) = {
	{ block_1_1, block_1_2, block_1_3, block_1_4, block_1_5, block_1_6 },
	{ block_2_1, block_2_2, block_2_3, block_2_4, block_2_5, block_2_6 },
	{ block_3_1, block_3_2, block_3_3, block_3_4 },
};

static void moments(struct group *g, int terms)
{
	const int cols = terms + 3;

	for (int a = 0, na; a < terms; a += na) {
		na = terms - a < 3 ? terms - a : 3;

		const int most = na == 3 ? 4 : 6, parts = (cols - a + most - 1) / most;

		for (int i = 0, b = a; i < parts; i++) {
			int nb = (cols - b + parts - i - 1) / (parts - i);

			blocks[na - 1][nb - 1](g, a, b);
			b += nb;
		}
	}
}

GD_NLR_INLINE vec larger(vec x, vec y)
{
	vec r;

	for (int i = 0; i < GD_NLR_LANES; i++)
		r[i] = x[i] > y[i] ? x[i] : y[i];
	return r;
}

/*
 * From the moments to the coefficients, in place. The constant is eliminated first (weighted
 * means), which leaves the covariances of the features; ridge and the share of the mean square go
 * to their diagonal, and keep it away from 0 far beyond the rounding of the sums. Then L D L'.
 */
static void solve(struct group *g, int terms, float ridge)
{
	const int cols = terms + 3;
	const vec none = (vec){ 0 }, least = none + 0.1f * ridge;
	vec *m = g->m, over = 1.0f / larger(m[0], none + 1e-20f);

	for (int i = 0; i < terms; i++)
		for (int j = i; j < cols; j++)
			m[i * STEP + j] *= over;
	for (int i = 1; i < terms; i++) {
		vec square = m[i * STEP + i];

		for (int j = i; j < cols; j++)
			m[i * STEP + j] -= m[i] * m[j];
		m[i * STEP + i] += ridge + 1e-4f * square;
	}
	for (int k = 1; k < terms; k++) {
		vec inverse = 1.0f / larger(m[k * STEP + k], least);

		for (int i = k + 1; i < terms; i++) {
			vec l = m[k * STEP + i] * inverse;

			for (int j = i; j < cols; j++)
				m[i * STEP + j] -= l * m[k * STEP + j];
		}
		for (int j = k + 1; j < cols; j++)
			m[k * STEP + j] *= inverse;
	}
	for (int c = terms; c < cols; c++)
		for (int i = terms - 1; i >= 0; i--)
			for (int j = i + 1; j < terms; j++)
				m[i * STEP + c] -= m[i * STEP + j] * m[j * STEP + c];
}

/* Coefficients for features as they are, not relative to the centre. */
static void store(const struct gd_nlr_tile *t, const struct group *g, int x)
{
	for (int c = 0; c < 3; c++) {
		float *to = t->slope + (size_t)(c * t->terms) * GD_NLR_WPITCH + x;
		vec constant = g->m[t->terms + c];

		for (int j = 1; j < t->terms; j++) {
			vec b = g->m[j * STEP + t->terms + c];

			constant -= b * g->centre[j];
			gd_nlr_store(to + (size_t)j * GD_NLR_WPITCH, b);
		}
		gd_nlr_store(to, constant);
	}
}

static void drop(const struct gd_nlr_tile *t, int x)
{
	const int side = 2 * t->window + 1;

	for (int s = 0; s < side * side; s++)
		t->weight[(size_t)s * GD_NLR_WPITCH + x] = 0.0f;
}

void gd_nlr_fit_row(const struct gd_nlr_tile *t, int y)
{
	struct group g = { .row = (ptrdiff_t)t->ncol * PITCH, .window = t->window };

	for (int x = 0; x < t->w; x += GD_NLR_LANES) {
		g.col = t->col + y * g.row + x;
		g.fit = t->fit + x;
		for (int j = 1; j < t->terms; j++)
			g.centre[j] = gd_nlr_load(g.col + j * PITCH);
		moments(&g, t->terms);
		for (int i = 0; i < GD_NLR_LANES; i++)
			if (!(g.m[0][i] > 1e-20f))
				drop(t, x + i);
		solve(&g, t->terms, t->ridge);
		store(t, &g, x);
	}
}
