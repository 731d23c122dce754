/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * One binary for any processor. Files in lib/kernel/ are compiled once for each instruction set,
 * with GD_ISA set to its suffix; GD_KERNEL(name) gives name_base, name_v3 or name_v4. Each such
 * file exports one constant table of function pointers; GD_PICK(table) takes the best one that
 * this processor runs (environment variable GD_ISA=base|v3|v4 takes a lesser one, for tests).
 *	base: SSE2 on x86-64, NEON on 64-bit Arm (the only one there)
 *	v3:   AVX2 and FMA		v4: AVX-512 (F, BW, CD, DQ, VL)
 */
#ifndef GD_ISA_H
#define GD_ISA_H

#define GD_CAT2(a, b) a##b
#define GD_CAT(a, b) GD_CAT2(a, b)
#ifndef GD_ISA
#define GD_ISA _base
#endif
#define GD_KERNEL(name) GD_CAT(name, GD_ISA)

enum gd_isa { GD_ISA_BASE, GD_ISA_V3, GD_ISA_V4 };
enum gd_isa gd_isa(void);
const char *gd_isa_name(void);

#if defined(__x86_64__)
#define GD_KERNEL_TABLE(type, name) extern const type name##_base, name##_v3, name##_v4
#define GD_PICK(name) \
	(gd_isa() == GD_ISA_V4 ? &name##_v4 : gd_isa() == GD_ISA_V3 ? &name##_v3 : &name##_base)
#else
#define GD_KERNEL_TABLE(type, name) extern const type name##_base
#define GD_PICK(name) (&name##_base)
#endif

#endif
