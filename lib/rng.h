/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Counter-based random numbers: a function of (seed, stream, index, draw) without state, so that
 * results depend neither on the number of threads nor on the order of work.
 * Two words are folded with the seed through a 32-bit mixer of xor-shifts and odd multiplications.
 */
#ifndef GD_RNG_H
#define GD_RNG_H

#include <stdint.h>

/* A bijection of 32-bit words in which every input
 * bit flips every output bit about half the time. */
static inline uint32_t gd_rng_mix(uint32_t x)
{
	x ^= x >> 16;
	x *= 0x7feb352dU;
	x ^= x >> 15;
	x *= 0x846ca68bU;
	return x ^ x >> 16;
}

/* Key of one stream (e.g. one replicate) under a seed; two words. */
struct gd_rng_key {
	uint32_t a, b;
};
struct gd_rng_key gd_rng_key(uint64_t seed, uint64_t stream);

/* 32 uniform bits for element index (e.g. a pixel), word number draw. Cheap and vectorisable. */
static inline uint32_t gd_rng_u32(struct gd_rng_key key, uint32_t index, uint32_t draw)
{
	return gd_rng_mix(gd_rng_mix(index ^ key.a) + key.b + draw * 0x9e3779b9U);
}

/* Uniform in [0, 1), 24 bits. */
static inline float gd_rng_float(struct gd_rng_key key, uint32_t index, uint32_t draw)
{
	return (float)(gd_rng_u32(key, index, draw) >> 8) * 0x1p-24f;
}

#endif
