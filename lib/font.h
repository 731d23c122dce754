/* SPDX-License-Identifier: BSD-3-Clause */
/* A small fixed font of our own for labels: no font files to look for. */
#ifndef GD_FONT_H
#define GD_FONT_H

#include <stdbool.h>

#define GD_FONT_WIDTH 6		/* pixels from one letter to the next, the gap included */
#define GD_FONT_HEIGHT 9	/* two of them below the base line */

/* Is pixel (x, y) of a letter inked? x 0 .. 5, y 0 .. 8. What else comes shows as '?'. */
bool gd_font_pixel(char letter, int x, int y);

#endif
