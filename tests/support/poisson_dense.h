/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * A slow, plain oracle for gradient problems: normal equations in long double, solved by banded
 * Cholesky. It shares no code with the library. Images are w x h arrays, row after row.
 */
#ifndef POISSON_DENSE_H
#define POISSON_DENSE_H

#include <math.h>
#include <stdlib.h>
#include <string.h>

struct dense {
	int w, h;
	long double *wx, *wy, *a;	/* weights of the edges right and down, of the pixels */
};

static inline struct dense dense_new(int w, int h)
{
	const size_t n = (size_t)w * (size_t)h;
	struct dense d = { w, h, calloc(n, sizeof(long double)), calloc(n, sizeof(long double)),
			   calloc(n, sizeof(long double)) };

	return d;
}

static inline void dense_free(struct dense *d)
{
	free(d->wx);
	free(d->wy);
	free(d->a);
}

/* Marks the part that holds pixel i, by edges with weight. */
static inline void dense_flood(const struct dense *d, int *part, int i, int mark)
{
	int *stack = malloc((size_t)d->w * (size_t)d->h * 4 * sizeof(int)), top = 0;

	stack[top++] = i;
	while (top > 0) {
		int p = stack[--top], x = p % d->w, y = p / d->w;

		if (part[p] >= 0)
			continue;
		part[p] = mark;
		if (x + 1 < d->w && d->wx[p] > 0)
			stack[top++] = p + 1;
		if (x > 0 && d->wx[p - 1] > 0)
			stack[top++] = p - 1;
		if (y + 1 < d->h && d->wy[p] > 0)
			stack[top++] = p + d->w;
		if (y > 0 && d->wy[p - d->w] > 0)
			stack[top++] = p - d->w;
	}
	free(stack);
}

/* f: the minimiser; parts without any a_i get the mean of y. Returns the number of parts. */
static inline int dense_solve(const struct dense *d, const double *vx, const double *vy,
			      const double *y, double *f)
{
	const int n = d->w * d->h, band = d->w;
	const size_t row = (size_t)band + 1;
	long double *m = calloc((size_t)n * row, sizeof(*m)), *b = calloc((size_t)n, sizeof(*b));
	int *part = malloc((size_t)n * sizeof(int)), parts = 0;

#define AT(i, j) m[(size_t)(i) * row + (size_t)((j) - (i) + band)]	/* j <= i */
	for (int i = 0; i < n; i++)
		part[i] = -1;
	for (int i = 0; i < n; i++) {
		if (part[i] < 0)
			dense_flood(d, part, i, parts++);
		AT(i, i) += d->a[i];
		b[i] += d->a[i] * (d->a[i] > 0 ? y[i] : 0);
		if (i % d->w + 1 < d->w && d->wx[i] > 0) {
			AT(i, i) += d->wx[i];
			AT(i + 1, i + 1) += d->wx[i];
			AT(i + 1, i) -= d->wx[i];
			b[i] -= d->wx[i] * vx[i];
			b[i + 1] += d->wx[i] * vx[i];
		}
		if (i / d->w + 1 < d->h && d->wy[i] > 0) {
			AT(i, i) += d->wy[i];
			AT(i + d->w, i + d->w) += d->wy[i];
			AT(i + d->w, i) -= d->wy[i];
			b[i] -= d->wy[i] * vy[i];
			b[i + d->w] += d->wy[i] * vy[i];
		}
	}
	for (int k = 0; k < parts; k++) {	/* tie down the first pixel of each free part */
		int first = -1, tied = 0;

		for (int i = 0; i < n; i++)
			if (part[i] == k) {
				first = first < 0 ? i : first;
				tied |= d->a[i] > 0;
			}
		if (!tied)
			AT(first, first) = AT(first, first) > 0 ? 2 * AT(first, first) : 1;
	}
	for (int i = 0; i < n; i++) {		/* Cholesky, row by row, and forward substitution */
		int lo = i > band ? i - band : 0;

		for (int j = lo; j <= i; j++) {
			long double s = AT(i, j);

			for (int k = lo > j - band ? lo : j - band; k < j; k++)
				s -= AT(i, k) * AT(j, k);
			AT(i, j) = j < i ? s / AT(j, j) : sqrtl(s);
		}
		for (int k = lo; k < i; k++)
			b[i] -= AT(i, k) * b[k];
		b[i] /= AT(i, i);
	}
	for (int i = n - 1; i >= 0; i--) {
		int hi = i + band < n - 1 ? i + band : n - 1;

		for (int k = i + 1; k <= hi; k++)
			b[i] -= AT(k, i) * b[k];
		b[i] /= AT(i, i);
	}
	for (int k = 0; k < parts; k++) {
		long double gap = 0, count = 0;
		int tied = 0;

		for (int i = 0; i < n; i++)
			if (part[i] == k) {
				gap += (y ? y[i] : 0) - b[i];
				count++;
				tied |= d->a[i] > 0;
			}
		for (int i = 0; i < n && !tied; i++)
			if (part[i] == k)
				b[i] += gap / count;
	}
#undef AT
	for (int i = 0; i < n; i++)
		f[i] = (double)b[i];
	free(part);
	free(m);
	free(b);
	return parts;
}

#endif
