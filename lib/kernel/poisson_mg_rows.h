/* SPDX-License-Identifier: BSD-3-Clause */
/* The bodies of poisson_mg.h for one element type: REAL, and TABLE for the name of the table. */
#include <math.h>
#include <string.h>

#include "poisson_mg.h"

#define BLOCK 256	/* even: parities stay */
#define ROW(p, y) ((p) + (ptrdiff_t)(y) * (ptrdiff_t)stride)
#define LOAD(name, l, field) const REAL *name = (const REAL *)(l)->field

static inline REAL positive(REAL v)
{
	return v > 0 ? v : 0;
}

static void diagonal(const struct gd_mg_level *l, int y)
{
	const size_t stride = l->stride;
	const REAL *e = ROW((const REAL *)l->e, y), *s = ROW((const REAL *)l->s, y),
		   *n = s - stride;
	REAL *restrict d = ROW((REAL *)l->invd, y);

	for (int x = 0; x < l->w; x++)
		d[x] = e[x] + e[x - 1] + s[x] + n[x];
	if (l->se) {
		const REAL *se = ROW((const REAL *)l->se, y), *sw = ROW((const REAL *)l->sw, y);
		const REAL *nw = se - stride, *ne = sw - stride;

		for (int x = 0; x < l->w; x++)
			d[x] += (se[x] + nw[x - 1]) + (sw[x] + ne[x + 1]);
	}
	if (l->a) {
		const REAL *a = ROW((const REAL *)l->a, y);

		for (int x = 0; x < l->w; x++)
			d[x] += a[x];
	}
	for (int x = 0; x < l->w; x++)
		d[x] = d[x] > TINY ? 1 / d[x] : 0;
}

/*
 * out where x has the parity, z elsewhere. Written as a product with 1 and 0,
 * which is exact, since the compiler turns a choice into a branch per point.
 */
static void choose(REAL *restrict z, const REAL *restrict out, int odd, int w)
{
	const REAL take[2] = { (REAL)!odd, (REAL)odd };
	REAL yes[16], no[16];
	int x = 0;

	for (int i = 0; i < 16; i++) {
		yes[i] = take[i & 1];
		no[i] = 1 - yes[i];
	}
	for (; x + 16 <= w; x += 16)
		for (int i = 0; i < 16; i++)
			z[x + i] = yes[i] * out[x + i] + no[i] * z[x + i];
	for (; x < w; x++)
		z[x] = yes[x & 1] * out[x] + no[x & 1] * z[x];
}

/*
 * A black point follows its red neighbours at once, so what moves a red point is its diagonal less
 * sum w^2 / d of its black neighbours. Two points that hang together by a weight far above all
 * others would else hardly move at all; no coarse grid helps, where neither is on it. At most 1e5
 * times the step of plain relaxation, which is what float can tell apart.
 */
static void schur(const struct gd_mg_level *l, int y)
{
	const size_t stride = l->stride;
	const REAL *e = ROW((const REAL *)l->e, y), *s = ROW((const REAL *)l->s, y),
		   *t = s - stride;
	REAL *d = ROW((REAL *)l->invd, y);
	const REAL *up = d - stride, *low = d + stride;

	for (int x0 = 0; x0 < l->w; x0 += BLOCK) {
		const int x1 = x0 + BLOCK < l->w ? x0 + BLOCK : l->w;
		REAL out[BLOCK];

		for (int x = x0; x < x1; x++) {
			REAL w = e[x] * e[x] * d[x + 1] + e[x - 1] * e[x - 1] * d[x - 1];
			REAL v = d[x] * (w + s[x] * s[x] * low[x] + t[x] * t[x] * up[x]);

			v = 1 - v;
			v = v > (REAL)1e-5 ? v : (REAL)1e-5;
			out[x - x0] = d[x] / v;
		}
		choose(d + x0, out, y & 1, x1 - x0);
	}
}

/*
 * A fine point (2X+1, 2Y) takes px of coarse (X,Y) and 1 - px of (X+1,Y); (2X, 2Y+1) takes py of
 * (X,Y) and the rest of (X,Y+1). The shares follow the edges towards either side, all three of that
 * side summed: the value a line of zero flux would have (Dendy's black-box multigrid). They sum to
 * 1, so constants are interpolated exactly. Without edges to either side, the first takes all; this
 * is also right at the border.
 */
static void interpolate(const struct gd_mg_level *fine, const struct gd_mg_level *coarse, int y)
{
	const size_t stride = fine->stride;
	const REAL *e = ROW((const REAL *)fine->e, 2 * y), *s = ROW((const REAL *)fine->s, 2 * y);
	REAL *restrict px = (REAL *)coarse->px + (size_t)y * coarse->stride;
	REAL *restrict py = (REAL *)coarse->py + (size_t)y * coarse->stride;

	if (!fine->se) {
		const REAL *t = s + stride;

		for (int x = 0; x < coarse->w; x++) {
			REAL west = e[2 * x], east = e[2 * x + 1], north = s[2 * x],
			     south = t[2 * x];

			px[x] = west + east > TINY ? west / (west + east) : 1;
			py[x] = north + south > TINY ? north / (north + south) : 1;
		}
		return;
	}

	const REAL *se = ROW((const REAL *)fine->se, 2 * y),
		   *sw = ROW((const REAL *)fine->sw, 2 * y);
	const REAL *nse = se - stride, *nsw = sw - stride, *tse = se + stride, *tsw = sw + stride,
		   *t = s + stride;

	for (int x = 0; x < coarse->w; x++) {
		REAL west = positive(e[2 * x] + sw[2 * x + 1] + nse[2 * x]);
		REAL east = positive(e[2 * x + 1] + se[2 * x + 1] + nsw[2 * x + 2]);
		REAL north = positive(s[2 * x] + se[2 * x - 1] + sw[2 * x + 1]);
		REAL south = positive(t[2 * x] + tse[2 * x] + tsw[2 * x]);

		px[x] = west + east > TINY ? west / (west + east) : 1;
		py[x] = north + south > TINY ? north / (north + south) : 1;
	}
}

/* Adds w (difference)^2, whose difference is sum c_k x_k
 * with sum c_k = 0, as -w c_k c_l (x_k - x_l)^2. */
#define EDGE(w, c00, c10, c01, c11) do {				\
	const REAL k00 = (c00), k10 = (c10), k01 = (c01), k11 = (c11);	\
	const REAL w00 = (w) * k00, w11 = (w) * k11;			\
	top -= w00 * k10;						\
	left -= w00 * k01;						\
	diag -= w00 * k11;						\
	bottom -= w11 * k01;						\
	right -= w11 * k10;						\
	anti -= (w) * k10 * k01;					\
} while (0)

/*
 * The centre (2X+1, 2Y+1) of a coarse cell satisfies its own equation given its eight neighbours:
 * shares m00, m10, m01 of the four corners and m11 the rest. Then every fine edge of the cell is a
 * difference of corner values, and its energy splits over the six pairs of corners: the coarse
 * operator P'AP without any cancelling diagonal. Edges along cell borders belong to the row or
 * column they lie on. The part that belongs to the coarse row below goes to z, for combine().
 */
static inline void galerkin_row(const struct gd_mg_level *fine, const struct gd_mg_level *coarse,
				int y, int nine)
{
	size_t stride = fine->stride;
	const REAL *e0 = ROW((const REAL *)fine->e, 2 * y), *e1 = e0 + stride;
	const REAL *s0 = ROW((const REAL *)fine->s, 2 * y), *s1 = s0 + stride;
	const REAL *se0 = nine ? ROW((const REAL *)fine->se, 2 * y) : e0, *se1 = se0 + stride;
	const REAL *sw0 = nine ? ROW((const REAL *)fine->sw, 2 * y) : e0, *sw1 = sw0 + stride;

	stride = coarse->stride;
	const REAL *px = ROW((const REAL *)coarse->px, y), *qx = px + stride,
		   *py = ROW((const REAL *)coarse->py, y);
	REAL *restrict m00 = ROW((REAL *)coarse->m00, y), *restrict m10 =
								  ROW((REAL *)coarse->m10, y);
	REAL *restrict m01 = ROW((REAL *)coarse->m01, y);
	REAL *restrict ce = ROW((REAL *)coarse->e, y), *restrict cs = ROW((REAL *)coarse->s, y);
	REAL *restrict cse = ROW((REAL *)coarse->se, y), *restrict csw = ROW((REAL *)coarse->sw, y);
	REAL *restrict below = ROW((REAL *)coarse->z, y), *restrict side =
								  ROW((REAL *)coarse->r, y);

#pragma omp simd
	for (int x = 0; x < coarse->w; x++) {
		const REAL t = px[x], b = qx[x], l = py[x], r = py[x + 1];
		const REAL t1 = 1 - t, b1 = 1 - b, l1 = 1 - l, r1 = 1 - r;
		const REAL tm = s0[2 * x + 1], mb = s1[2 * x + 1], lm = e1[2 * x],
			   mr = e1[2 * x + 1];
		REAL north = positive(tm), south = positive(mb), west = positive(lm),
		     east = positive(mr);
		REAL v00 = north * t + west * l, v10 = north * t1 + east * r;
		REAL v01 = south * b + west * l1, v11 = south * b1 + east * r1;

		if (nine) {
			v00 += positive(se0[2 * x]);
			v10 += positive(sw0[2 * x + 2]);
			v01 += positive(sw1[2 * x + 1]);
			v11 += positive(se1[2 * x + 1]);
		}

		REAL sum = v00 + v10 + v01 + v11, inv = sum > TINY ? 1 / sum : 0;
		REAL c00 = sum > TINY ? v00 * inv : 1, c10 = v10 * inv, c01 = v01 * inv;
		REAL c11 = 1 - c00 - c10 - c01;
		REAL top = 0, bottom = 0, left = 0, right = 0, diag = 0, anti = 0;

		m00[x] = c00;
		m10[x] = c10;
		m01[x] = c01;
		EDGE(tm, c00 - t, c10 - t1, c01, c11);
		EDGE(mb, c00, c10, c01 - b, c11 - b1);
		EDGE(lm, c00 - l, c10, c01 - l1, c11);
		EDGE(mr, c00, c10 - r, c01, c11 - r1);
		if (nine) {
			EDGE(se0[2 * x], c00 - 1, c10, c01, c11);
			EDGE(sw0[2 * x + 2], c00, c10 - 1, c01, c11);
			EDGE(sw1[2 * x + 1], c00, c10, c01 - 1, c11);
			EDGE(se1[2 * x + 1], c00, c10, c01, c11 - 1);
			EDGE(sw0[2 * x + 1], t - l, t1, -l1, (REAL)0);
			EDGE(se0[2 * x + 1], t, t1 - r, (REAL)0, -r1);
			EDGE(se1[2 * x], l, (REAL)0, l1 - b, -b1);
			EDGE(sw1[2 * x + 2], (REAL)0, r, -b, r1 - b1);
		}
		ce[x] = e0[2 * x] * t1 * t1 + e0[2 * x + 1] * t * t + top;
		cs[x] = s0[2 * x] * l1 * l1 + s1[2 * x] * l * l + left;
		cse[x] = diag;
		csw[x + 1] = anti;
		below[x] = bottom;
		side[x] = right;
	}
	for (int x = 1; x < coarse->w; x++)
		cs[x] += side[x - 1];

	/* Rounding may have left a trace of an edge beyond the border. */
	const int last = coarse->w - 1;

	ce[last] = cse[last] = csw[0] = csw[last + 1] = below[last] = 0;
	if (y == coarse->h - 1)
		for (int x = 0; x < coarse->w; x++)
			cs[x] = cse[x] = csw[x] = 0;
}

static void galerkin(const struct gd_mg_level *fine, const struct gd_mg_level *coarse, int y)
{
	if (fine->se)
		galerkin_row(fine, coarse, y, 1);
	else
		galerkin_row(fine, coarse, y, 0);
}

static void combine(const struct gd_mg_level *coarse, int y)
{
	const size_t stride = coarse->stride;
	REAL *restrict e = ROW((REAL *)coarse->e, y);
	const REAL *above = ROW((const REAL *)coarse->z, y - 1);

	if (y > 0)
		for (int x = 0; x < coarse->w; x++)
			e[x] += above[x];
	diagonal(coarse, y);
}

/* The transpose of the interpolation: up, mid, low
 * are rows 2y - 1, 2y, 2y + 1 of the fine level. */
static inline void gather(REAL *restrict to, const REAL *up, const REAL *mid, const REAL *low,
			  const struct gd_mg_level *coarse, int y, int red)
{
	const size_t stride = coarse->stride;
	const REAL *px = ROW((const REAL *)coarse->px, y), *py = ROW((const REAL *)coarse->py, y),
		   *ny = py - stride;
	const REAL *m00 = ROW((const REAL *)coarse->m00, y),
		   *m10 = ROW((const REAL *)coarse->m10, y);
	const REAL *n00 = m00 - stride, *n10 = m10 - stride,
		   *n01 = ROW((const REAL *)coarse->m01, y - 1);

	/* Column -1 and row -1 hold zeros, whose share is then multiplied by a residual of 0. */
	for (int x = 0; x < coarse->w; x++) {
		REAL v = mid[2 * x];

		if (!red)
			v += px[x] * mid[2 * x + 1] + (1 - px[x - 1]) * mid[2 * x - 1] +
			     py[x] * low[2 * x] + (1 - ny[x]) * up[2 * x];
		v += m00[x] * low[2 * x + 1] + m10[x - 1] * low[2 * x - 1];
		v += n01[x] * up[2 * x + 1] +
		     (1 - n00[x - 1] - n10[x - 1] - n01[x - 1]) * up[2 * x - 1];
		to[x] = v;
	}
}

static void restrict_plane(void *to, const void *from, const struct gd_mg_level *fine,
			   const struct gd_mg_level *coarse, int y)
{
	const size_t stride = fine->stride;
	const REAL *mid = ROW((const REAL *)from, 2 * y);

	gather((REAL *)to + (size_t)y * coarse->stride, mid - stride, mid, mid + stride, coarse, y,
	       0);
}

/* Black points (x + y odd) from the guess 0; red ones get any value, they are relaxed next. */
static void start(const struct gd_mg_level *l, int n, int y)
{
	const size_t stride = l->stride;
	const REAL *invd = ROW((const REAL *)l->invd, y);

	for (int c = 0; c < n; c++) {
		const REAL *r = ROW((const REAL *)l->r + c * l->plane, y);
		REAL *restrict z = ROW((REAL *)l->z + c * l->plane, y);

		for (int x = 0; x < l->w; x++)
			z[x] = invd[x] * r[x];
	}
}

/*
 * Gauss-Seidel on the points of one colour: all points of a stretch are computed, and those of the
 * colour kept. Their neighbours are of the other colour and do not change.
 */
static void relax(const struct gd_mg_level *l, int n, int y, int colour)
{
	const size_t stride = l->stride;
	const int odd = (y + colour) & 1;
	const REAL *e = ROW((const REAL *)l->e, y), *s = ROW((const REAL *)l->s, y),
		   *t = s - stride;
	const REAL *invd = ROW((const REAL *)l->invd, y);

	for (int c = 0; c < n; c++) {
		const REAL *r = ROW((const REAL *)l->r + c * l->plane, y);
		REAL *z = ROW((REAL *)l->z + c * l->plane, y);
		const REAL *up = z - stride, *low = z + stride;

		for (int x0 = 0; x0 < l->w; x0 += BLOCK) {
			const int x1 = x0 + BLOCK < l->w ? x0 + BLOCK : l->w;
			REAL out[BLOCK];

			for (int x = x0; x < x1; x++) {
				REAL v = e[x] * z[x + 1] + e[x - 1] * z[x - 1] + s[x] * low[x] +
					 t[x] * up[x];

				out[x - x0] = invd[x] * (r[x] + v);
			}
			choose(z + x0, out, odd, x1 - x0);
		}
	}
}

/* Red points: a step along the residual, in differences. */
static void correct(const struct gd_mg_level *l, int n, int y)
{
	const size_t stride = l->stride;
	const REAL *e = ROW((const REAL *)l->e, y), *s = ROW((const REAL *)l->s, y),
		   *t = s - stride;
	const REAL *invd = ROW((const REAL *)l->invd, y),
		   *a = l->a ? ROW((const REAL *)l->a, y) : NULL;

	for (int c = 0; c < n; c++) {
		const REAL *r = ROW((const REAL *)l->r + c * l->plane, y);
		REAL *z = ROW((REAL *)l->z + c * l->plane, y);
		const REAL *up = z - stride, *low = z + stride;

		for (int x0 = 0; x0 < l->w; x0 += BLOCK) {
			const int x1 = x0 + BLOCK < l->w ? x0 + BLOCK : l->w;
			REAL out[BLOCK];

			for (int x = x0; x < x1; x++) {
				REAL v = e[x] * (z[x + 1] - z[x]) + e[x - 1] * (z[x - 1] - z[x]);

				v += s[x] * (low[x] - z[x]) + t[x] * (up[x] - z[x]);
				out[x - x0] = r[x] + v;
			}
			if (a)
				for (int x = x0; x < x1; x++)
					out[x - x0] -= a[x] * z[x];
			for (int x = x0; x < x1; x++)
				out[x - x0] = z[x] + invd[x] * out[x - x0];
			choose(z + x0, out, y & 1, x1 - x0);
		}
	}
}

/* The residual after black points have been relaxed last: 0
 * there, this at red ones. Rows of work are w + 4 wide. */
static void residual5(REAL *restrict out, const struct gd_mg_level *l, int c, int y)
{
	const size_t stride = l->stride;
	const REAL *e = ROW((const REAL *)l->e, y), *s = ROW((const REAL *)l->s, y),
		   *t = s - stride;
	const REAL *z = ROW((const REAL *)l->z + c * l->plane, y), *up = z - stride,
		   *low = z + stride;
	const REAL *r = ROW((const REAL *)l->r + c * l->plane, y);

	for (int x = 0; x < l->w; x++) {
		REAL v = e[x] * (z[x + 1] - z[x]) + e[x - 1] * (z[x - 1] - z[x]);

		v += s[x] * (low[x] - z[x]) + t[x] * (up[x] - z[x]);
		out[x] = r[x] + v;
	}
	if (l->a) {
		const REAL *a = ROW((const REAL *)l->a, y);

		for (int x = 0; x < l->w; x++)
			out[x] -= a[x] * z[x];
	}
}

/* Zeros around three rows of w, stride apart: levels of other widths have used the same memory. */
static void close_rows(REAL *v, size_t stride, int w)
{
	for (int i = 0; i < 3; i++)
		v[i * stride - 1] = v[i * stride + (size_t)w] = v[i * stride + (size_t)w + 1] = 0;
}

typedef void residual_of(REAL *restrict out, const struct gd_mg_level *l, int c, int y);

static inline __attribute__((always_inline)) void
restrict_by(residual_of *residual_row, const struct gd_mg_level *fine,
	    const struct gd_mg_level *coarse, int n, int y, REAL *up, int red)
{
	REAL *mid = up + fine->stride, *low = mid + fine->stride;

	close_rows(up, fine->stride, fine->w);
	for (int c = 0; c < n; c++) {
		if (y > 0)
			residual_row(up, fine, c, 2 * y - 1);
		else
			for (int x = 0; x < fine->w; x++)
				up[x] = 0;
		residual_row(mid, fine, c, 2 * y);
		if (2 * y + 1 < fine->h)
			residual_row(low, fine, c, 2 * y + 1);
		else
			for (int x = 0; x < fine->w; x++)
				low[x] = 0;
		gather((REAL *)coarse->r + c * coarse->plane + (size_t)y * coarse->stride, up, mid,
		       low, coarse, y, red);
	}
}

static void restrict_red(const struct gd_mg_level *fine, const struct gd_mg_level *coarse, int n,
			 int y, void *work)
{
	restrict_by(residual5, fine, coarse, n, y, (REAL *)work + 16, 1);
}

/* Red points only; black ones get any value, they are relaxed next without looking at it. */
static void prolong_red(const struct gd_mg_level *fine, const struct gd_mg_level *coarse, int n,
			int y)
{
	const size_t stride = coarse->stride;
	const int half = fine->w / 2;
	const REAL *m00 = ROW((const REAL *)coarse->m00, y / 2),
		   *m10 = ROW((const REAL *)coarse->m10, y / 2);
	const REAL *m01 = ROW((const REAL *)coarse->m01, y / 2);

	for (int c = 0; c < n; c++) {
		REAL *restrict z = (REAL *)fine->z + c * fine->plane + (size_t)y * fine->stride;
		const REAL *u = ROW((const REAL *)coarse->z + c * coarse->plane, y / 2),
			   *v = u + stride;

		if (y & 1) {
			for (int x = 0; x < half; x++) {
				REAL d = m00[x] * u[x] + m10[x] * u[x + 1] + m01[x] * v[x] +
					 (1 - m00[x] - m10[x] - m01[x]) * v[x + 1];

				z[2 * x] = 0;
				z[2 * x + 1] += d;
			}
			continue;
		}
		for (int x = 0; x < half; x++) {
			z[2 * x] += u[x];
			z[2 * x + 1] = 0;
		}
		if (fine->w & 1)
			z[2 * half] += u[half];
	}
}

/* Row y, points of x parity first, then the others.
 * With the rows by parity this makes four colours. */
static void relax9(const struct gd_mg_level *l, int n, int y, int first)
{
	const size_t stride = l->stride;
	const REAL *e = ROW((const REAL *)l->e, y), *s = ROW((const REAL *)l->s, y),
		   *t = s - stride;
	const REAL *se = ROW((const REAL *)l->se, y), *sw = ROW((const REAL *)l->sw, y);
	const REAL *nw = se - stride, *ne = sw - stride, *invd = ROW((const REAL *)l->invd, y);

	for (int c = 0; c < n; c++) {
		const REAL *r = ROW((const REAL *)l->r + c * l->plane, y);
		REAL *z = ROW((REAL *)l->z + c * l->plane, y);
		const REAL *up = z - stride, *low = z + stride;

		for (int k = 0; k < 2; k++)
			for (int x0 = 0; x0 < l->w; x0 += BLOCK) {
				const int x1 = x0 + BLOCK < l->w ? x0 + BLOCK : l->w;
				REAL out[BLOCK];

				for (int x = x0; x < x1; x++) {
					REAL v = e[x] * z[x + 1] + e[x - 1] * z[x - 1] +
						 s[x] * low[x] + t[x] * up[x];

					v += se[x] * low[x + 1] + nw[x - 1] * up[x - 1];
					v += sw[x] * low[x - 1] + ne[x + 1] * up[x + 1];
					out[x - x0] = invd[x] * (r[x] + v);
				}
				choose(z + x0, out, first ^ k, x1 - x0);
			}
	}
}

static void residual9(REAL *restrict o, const struct gd_mg_level *l, int c, int y)
{
	const size_t stride = l->stride;
	const REAL *e = ROW((const REAL *)l->e, y), *s = ROW((const REAL *)l->s, y),
		   *t = s - stride;
	const REAL *se = ROW((const REAL *)l->se, y), *sw = ROW((const REAL *)l->sw, y);
	const REAL *nw = se - stride, *ne = sw - stride;
	const REAL *r = ROW((const REAL *)l->r + c * l->plane, y);
	const REAL *z = ROW((const REAL *)l->z + c * l->plane, y), *up = z - stride,
		   *low = z + stride;

	for (int x = 0; x < l->w; x++) {
		REAL v = e[x] * (z[x + 1] - z[x]) + e[x - 1] * (z[x - 1] - z[x]);

		v += s[x] * (low[x] - z[x]) + t[x] * (up[x] - z[x]);
		v += se[x] * (low[x + 1] - z[x]) + nw[x - 1] * (up[x - 1] - z[x]);
		v += sw[x] * (low[x - 1] - z[x]) + ne[x + 1] * (up[x + 1] - z[x]);
		o[x] = r[x] + v;
	}
	if (l->a) {
		const REAL *a = ROW((const REAL *)l->a, y);

		for (int x = 0; x < l->w; x++)
			o[x] -= a[x] * z[x];
	}
}

static void restrict_full(const struct gd_mg_level *fine, const struct gd_mg_level *coarse, int n,
			  int y, void *work)
{
	restrict_by(residual9, fine, coarse, n, y, (REAL *)work + 16, 0);
}

static void prolong(const struct gd_mg_level *fine, const struct gd_mg_level *coarse, int n, int y)
{
	const size_t stride = coarse->stride;
	const int half = fine->w / 2;
	const REAL *px = ROW((const REAL *)coarse->px, y / 2),
		   *py = ROW((const REAL *)coarse->py, y / 2);
	const REAL *m00 = ROW((const REAL *)coarse->m00, y / 2),
		   *m10 = ROW((const REAL *)coarse->m10, y / 2);
	const REAL *m01 = ROW((const REAL *)coarse->m01, y / 2);

	for (int c = 0; c < n; c++) {
		REAL *restrict z = (REAL *)fine->z + c * fine->plane + (size_t)y * fine->stride;
		const REAL *u = ROW((const REAL *)coarse->z + c * coarse->plane, y / 2),
			   *v = u + stride;

		if (y & 1) {
			for (int x = 0; x < half; x++) {
				REAL d = m00[x] * u[x] + m10[x] * u[x + 1] + m01[x] * v[x] +
					 (1 - m00[x] - m10[x] - m01[x]) * v[x + 1];

				z[2 * x] += py[x] * u[x] + (1 - py[x]) * v[x];
				z[2 * x + 1] += d;
			}
			if (fine->w & 1)
				z[2 * half] += py[half] * u[half] + (1 - py[half]) * v[half];
			continue;
		}
		for (int x = 0; x < half; x++) {
			z[2 * x] += u[x];
			z[2 * x + 1] += px[x] * u[x] + (1 - px[x]) * u[x + 1];
		}
		if (fine->w & 1)
			z[2 * half] += u[half];
	}
}

static void dot(double *sum, const void *u, const void *v, const struct gd_mg_level *l, int n,
		int y)
{
	const size_t stride = l->stride;

	for (int c = 0; c < n; c++) {
		const REAL *a = ROW((const REAL *)u + c * l->plane, y),
			   *b = ROW((const REAL *)v + c * l->plane, y);
		double t = 0;

#pragma omp simd reduction(+:t)
		for (int x = 0; x < l->w; x++)
			t += (double)a[x] * (double)b[x];
		sum[c] = t;
	}
}

static void direction(void *p, const struct gd_mg_level *l, int n, const double *beta, int y)
{
	const size_t stride = l->stride;

	for (int c = 0; c < n; c++) {
		const REAL *z = ROW((const REAL *)l->z + c * l->plane, y), k = (REAL)beta[c];
		REAL *restrict q = ROW((REAL *)p + c * l->plane, y);

		if (k == 0)		/* then p may hold anything */
			memcpy(q, z, (size_t)l->w * sizeof(REAL));
		else
			for (int x = 0; x < l->w; x++)
				q[x] = z[x] + k * q[x];
	}
}

static void apply(double *sum, const void *p, const struct gd_mg_level *l, int n, int y)
{
	const size_t stride = l->stride;
	const REAL *e = ROW((const REAL *)l->e, y), *s = ROW((const REAL *)l->s, y),
		   *t = s - stride;

	for (int c = 0; c < n; c++) {
		const REAL *q = ROW((const REAL *)p + c * l->plane, y), *up = q - stride,
			   *low = q + stride;
		REAL *restrict z = ROW((REAL *)l->z + c * l->plane, y);
		double d = 0;

		for (int x = 0; x < l->w; x++) {
			REAL v = e[x] * (q[x] - q[x + 1]) + e[x - 1] * (q[x] - q[x - 1]);

			z[x] = v + (s[x] * (q[x] - low[x]) + t[x] * (q[x] - up[x]));
		}
		if (l->a) {
			const REAL *a = ROW((const REAL *)l->a, y);

			for (int x = 0; x < l->w; x++)
				z[x] += a[x] * q[x];
		}
#pragma omp simd reduction(+:d)
		for (int x = 0; x < l->w; x++)
			d += (double)z[x] * (double)q[x];
		sum[c] = d;
	}
}

static void step(void *xv, const void *p, const struct gd_mg_level *l, int n, const double *alpha,
		 int y)
{
	const size_t stride = l->stride;

	for (int c = 0; c < n; c++) {
		const REAL k = (REAL)alpha[c], *q = ROW((const REAL *)p + c * l->plane, y);
		const REAL *z = ROW((const REAL *)l->z + c * l->plane, y);
		REAL *restrict u = ROW((REAL *)xv + c * l->plane, y), *restrict r = ROW(
									      (REAL *)l->r +
										      c * l->plane,
									      y);

		for (int x = 0; x < l->w; x++) {
			u[x] += k * q[x];
			r[x] -= k * z[x];
		}
	}
}

static void residual(const struct gd_mg_level *l, int n, const void *xv,
		     const struct gd_mg_rows *rows, int y)
{
	const size_t stride = l->stride;
	const REAL *e = ROW((const REAL *)l->e, y), *s = ROW((const REAL *)l->s, y),
		   *t = s - stride;

	for (int c = 0; c < n; c++) {
		const REAL *f = ROW((const REAL *)xv + c * l->plane, y), *up = f - stride,
			   *low = f + stride;
		const float *dx = rows->dx[c], *dy = rows->dy[c], *ny = rows->up[c];
		REAL *restrict r = ROW((REAL *)l->r + c * l->plane, y);

		for (int x = 0; x < l->w; x++) {
			REAL east = e[x] * ((REAL)dx[x] - (f[x + 1] - f[x]));
			REAL west = e[x - 1] * ((REAL)dx[x - 1] - (f[x] - f[x - 1]));
			REAL south = s[x] * ((REAL)dy[x] - (low[x] - f[x]));
			REAL north = t[x] * ((REAL)ny[x] - (f[x] - up[x]));

			r[x] = (west - east) + (north - south);
		}
		if (l->a) {
			const REAL *a = ROW((const REAL *)l->a, y);
			const float *p = rows->primal[c];

			for (int x = 0; x < l->w; x++)
				r[x] += a[x] * ((REAL)p[x] - f[x]);
		}
	}
}

/* Squares of scaled radiance must not overflow; beyond 1e18 all residuals weigh nothing alike. */
static inline REAL tame(REAL v)
{
	v = v < (REAL)1e18 ? v : (REAL)1e18;
	return v > (REAL)-1e18 ? v : (REAL)-1e18;
}

/* An edge that weighs 0 (no gradient, or beyond the border) stays so. */
static void reweight(const struct gd_mg_level *l, int n, const void *xv,
		     const struct gd_mg_rows *rows, double alpha, double reg, int y)
{
	const size_t stride = l->stride;
	REAL *restrict e = ROW((REAL *)l->e, y), *restrict s = ROW((REAL *)l->s, y),
		       *restrict a = ROW((REAL *)l->a, y);
	const REAL floor = (REAL)reg, row = (REAL)alpha;

	for (int x0 = 0; x0 < l->w; x0 += BLOCK) {
		const int count = l->w - x0 < BLOCK ? l->w - x0 : BLOCK;
		REAL qx[BLOCK] = { 0 }, qy[BLOCK] = { 0 }, qp[BLOCK] = { 0 };

		for (int c = 0; c < n; c++) {
			const REAL *f = ROW((const REAL *)xv + c * l->plane, y) + x0,
				   *low = f + stride;
			const float *dx = rows->dx[c] + x0, *dy = rows->dy[c] + x0,
				    *p = rows->primal[c] + x0;

			for (int x = 0; x < count; x++) {
				REAL rx = tame((REAL)dx[x] - (f[x + 1] - f[x]));
				REAL ry = tame((REAL)dy[x] - (low[x] - f[x])),
				     rp = tame(row * ((REAL)p[x] - f[x]));

				qx[x] += rx * rx;
				qy[x] += ry * ry;
				qp[x] += rp * rp;
			}
		}
		for (int x = 0; x < count; x++) {
			REAL wx = 1 / (SQRT(qx[x]) + floor), wy = 1 / (SQRT(qy[x]) + floor);
			REAL wp = row * row / (SQRT(qp[x]) + floor);

			e[x0 + x] = e[x0 + x] > 0 ? wx : 0;
			s[x0 + x] = s[x0 + x] > 0 ? wy : 0;
			a[x0 + x] = a[x0 + x] > 0 ? wp : 0;
		}
	}
}

const struct gd_mg_kernels TABLE = {
	sizeof(REAL), diagonal, schur,	   interpolate,	 galerkin,    combine,	restrict_plane,
	start,	      relax,	correct,   restrict_red, prolong_red, relax9,	restrict_full,
	prolong,      dot,	direction, apply,	 residual,    reweight, step};
