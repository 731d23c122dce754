/* SPDX-License-Identifier: BSD-3-Clause */
/* The 16-bit floats of OpenEXR. */
#ifndef GD_HALF_H
#define GD_HALF_H

#include <stdint.h>
#include <string.h>

/*
 * Half to float, exact: the exponent is rebased by a multiplication, which takes denormals along.
 */
static inline float gd_half_float(uint16_t h)
{
	uint32_t m = (uint32_t)(h & 0x7fff) << 13;
	float f;

	memcpy(&f, &m, sizeof(f));
	f *= 0x1p112f;
	memcpy(&m, &f, sizeof(m));
	if ((h & 0x7c00) == 0x7c00)
		m |= 0x7f800000;
	m |= (uint32_t)(h & 0x8000) << 16;
	memcpy(&f, &m, sizeof(f));
	return f;
}

#endif
