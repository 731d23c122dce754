/* SPDX-License-Identifier: BSD-3-Clause */
#include "plane.h"

/* Rows 4096 bytes apart would all fall into the same few sets of a first-level cache. */
size_t gd_stride(int w)
{
	size_t stride = ((size_t)(w > 0 ? w : 0) + 15) / 16 * 16;

	return stride % 1024 ? stride : stride + 16;
}
