/* SPDX-License-Identifier: BSD-3-Clause */
#include "file.h"

#include "output.h"

int gd_file_write(const char *path, const void *data, size_t size, struct gd_err *err)
{
	struct gd_output *out;
	int rc = gd_output_open(&out, path, true, err);

	if (rc == GD_OK)
		rc = gd_output_add(out, data, size, err);
	if (rc == GD_OK)
		rc = gd_output_commit(out, err);
	gd_output_close(out);
	return rc;
}
