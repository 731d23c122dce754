/* SPDX-License-Identifier: BSD-3-Clause */
#include "pilot.h"

#include "halves.h"

/* The variance of a half's colour, as the distances of patches want it: smooth. */
static int pilot_variance(struct gd_plane var[3], struct gd_plane spare,
			  const struct gd_crossfit_in *in, int half, struct gd_err *err)
{
	for (int c = 0; c < 3; c++) {
#pragma omp parallel for schedule(static)
		for (int y = 0; y < var[c].h; y++) {
			const float *known = in->var[c].v ? gd_row(in->var[c], y) : NULL;
			const float *a = gd_row(in->y[0][c], y);
			const float *b = known ? a : gd_row(in->y[1][c], y);
			float *to = gd_row(var[c], y);

			for (int x = 0; x < var[c].w; x++) {
				double d = (double)a[x] - (double)b[x];
				double share = gd_halves_share(in, half, x, y);

				/* a half without samples here holds what all of them say */
				if (known && !(share > 0))
					share = 1;
				to[x] = gd_halves_square(known ? 1 / share * (double)known[x] :
							 (1 - share) * d * d);
			}
		}
	}
	return gd_halves_smooth(var, 3, spare, in->var[0].v ? 3 : 7, err);
}

int gd_pilot_make(const struct gd_plane pilot[3], const struct gd_crossfit_in *in, int half,
		  const struct gd_pilot_features *features, const struct gd_nlr_conf *conf,
		  struct gd_plane var[3], struct gd_plane spare, struct gd_err *err)
{
	struct gd_nlr_in nlr = { .nfeat = features->n, .weight = in->count[half] };
	int rc = pilot_variance(var, spare, in, half, err);

	for (int c = 0; c < 3; c++) {
		nlr.y[c] = nlr.guide[c] = in->y[half][c];
		nlr.guide_var[c] = var[c];
	}
	for (int i = 0; i < features->n; i++)
		nlr.feat[i] = in->feat[features->at[i]];
	return rc == GD_OK ? gd_nlr_run(pilot, &nlr, conf, NULL, err) : rc;
}
