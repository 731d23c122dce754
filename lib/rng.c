/* SPDX-License-Identifier: BSD-3-Clause */
#include "rng.h"

/* One step of a 64-bit mixer (xor-shift and odd multiplications by the constants of splitmix64). */
static uint64_t mix64(uint64_t x)
{
	x += 0x9e3779b97f4a7c15U;
	x = (x ^ x >> 30) * 0xbf58476d1ce4e5b9U;
	x = (x ^ x >> 27) * 0x94d049bb133111ebU;
	return x ^ x >> 31;
}

struct gd_rng_key gd_rng_key(uint64_t seed, uint64_t stream)
{
	uint64_t k = mix64(mix64(seed) + stream * 0xd1342543de82ef95U);

	return (struct gd_rng_key){ (uint32_t)k, (uint32_t)(k >> 32) };
}
