/* SPDX-License-Identifier: BSD-3-Clause */
/* Operands that have to be files of their own. */
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "cli.h"

static bool find_file(const char *path, struct stat *st)
{
	return (strcmp(path, "-") ? stat(path, st) : fstat(STDIN_FILENO, st)) == 0 &&
	       S_ISREG(st->st_mode);
}

/* Noise that comes twice is taken for signal, and makes the error estimate too small. */
int gd_cli_check_neighbours(const struct gd_cli *cli, const struct gd_list *list,
			    struct gd_err *err)
{
	struct stat a, b;

	for (int i = 0; i < list->n; i++)
		for (int k = -1; k < i; k++) {
			if (!strcmp(list->v[i], "-") || !find_file(list->v[i], &a) ||
			    !find_file(k < 0 ? cli->input : list->v[k], &b) ||
			    a.st_dev != b.st_dev || a.st_ino != b.st_ino)
				continue;
			return gd_fail(err, GD_EARG, "--neighbours %s: %s", list->v[i],
				       k < 0 ? "the frame itself" : "named twice");
		}
	return GD_OK;
}
