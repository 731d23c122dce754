/* SPDX-License-Identifier: BSD-3-Clause */
/* How long it will take. */
#include <stdio.h>

#include "cli.h"

void gd_cli_time_left(char text[32], double seconds, double done, double rest)
{
	double left;

	text[0] = 0;
	if (!(seconds > 1 && done > 0.01))	/* a guess good to some tens of percent */
		return;
	left = seconds / done * rest;
	if (left < 100)
		snprintf(text, 32, ", %.0f s left", left);
	else if (left < 360000)
		snprintf(text, 32, ", %d:%02d:%02d left", (int)left / 3600, (int)left / 60 % 60,
			 (int)left % 60);
}
