/* SPDX-License-Identifier: BSD-3-Clause */
/* Jacobi's rotations, for the eigenvalues and eigenvectors of small symmetric matrices. */
#ifndef GD_JACOBI_H
#define GD_JACOBI_H

#include <math.h>

/*
 * Turns axes i and j of the symmetric n x n matrix a, in rows of `pitch` numbers, so that a_ij
 * vanishes (it must not be 0 before), and columns i and j of v with them. Over and over, for all
 * pairs i < j, from v = I: the eigenvalues stay on a's diagonal, the eigenvectors in v's columns.
 */
static inline void gd_jacobi_turn(int pitch, double a[][pitch], double v[][pitch], int n, int i,
				  int j)
{
	const double theta = (a[j][j] - a[i][i]) / (2 * a[i][j]);
	const double t = (theta < 0 ? -1 : 1) / (fabs(theta) + sqrt(theta * theta + 1));
	const double c = 1 / sqrt(t * t + 1), s = t * c;

	for (int k = 0; k < n; k++) {
		const double x = a[k][i], y = a[k][j];

		a[k][i] = c * x - s * y;
		a[k][j] = s * x + c * y;
	}
	for (int k = 0; k < n; k++) {
		const double x = a[i][k], y = a[j][k];

		a[i][k] = c * x - s * y;
		a[j][k] = s * x + c * y;
	}
	for (int k = 0; k < n; k++) {
		const double x = v[k][i], y = v[k][j];

		v[k][i] = c * x - s * y;
		v[k][j] = s * x + c * y;
	}
}

#endif
