/* SPDX-License-Identifier: BSD-3-Clause */
#include "isa.h"

#include <stdlib.h>
#include <string.h>

static const char *const names[] = { "base", "v3", "v4" };

/*
 * What processor and operating system allow together: __builtin_cpu_supports() also asks xgetbv
 * whether the wide registers are saved at a context switch.
 */
static enum gd_isa best(void)
{
#if defined(__x86_64__)
	__builtin_cpu_init();
	if (!__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("fma") ||
	    !__builtin_cpu_supports("bmi") || !__builtin_cpu_supports("bmi2"))
		return GD_ISA_BASE;
	if (!__builtin_cpu_supports("avx512f") || !__builtin_cpu_supports("avx512bw") ||
	    !__builtin_cpu_supports("avx512cd") || !__builtin_cpu_supports("avx512dq") ||
	    !__builtin_cpu_supports("avx512vl"))
		return GD_ISA_V3;
	return GD_ISA_V4;
#else
	return GD_ISA_BASE;
#endif
}

/* The answer never changes, so threads that race to store it store the same. */
enum gd_isa gd_isa(void)
{
	static int known;
	int isa = __atomic_load_n(&known, __ATOMIC_RELAXED) - 1;
	const char *wish;

	if (isa >= 0)
		return (enum gd_isa)isa;
	isa = (int)best();
	wish = getenv("GD_ISA");
	for (int i = 0; wish && i < isa; i++)
		if (!strcmp(wish, names[i]))
			isa = i;
	__atomic_store_n(&known, isa + 1, __ATOMIC_RELAXED);
	return (enum gd_isa)isa;
}

const char *gd_isa_name(void)
{
	return names[gd_isa()];
}
