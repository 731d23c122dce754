/* SPDX-License-Identifier: BSD-3-Clause */
#include "gd.h"

#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define ALIGN 64

int gd_fail(struct gd_err *err, int code, const char *format, ...)
{
	va_list ap;

	if (!err || err->code != GD_OK)
		return code;
	err->code = code;
	va_start(ap, format);
	vsnprintf(err->text, sizeof err->text, format, ap);
	va_end(ap);
	/* A text may quote a file: it stays one line and sends nothing to the terminal but text. */
	for (char *t = err->text; *t; t++)
		if ((unsigned char)*t < ' ' || *t == 127)
			*t = '?';
	return code;
}

void gd_note(const struct gd_report *report, const char *format, ...)
{
	char text[1024];
	va_list ap;

	if (!report || !report->note)
		return;
	va_start(ap, format);
	vsnprintf(text, sizeof text, format, ap);
	va_end(ap);
	report->note(report->user, text);
}

void gd_warn(const struct gd_report *report, const char *format, ...)
{
	char text[1024];
	va_list ap;

	if (!report || !(report->warn || report->note))
		return;
	va_start(ap, format);
	vsnprintf(text, sizeof text, format, ap);
	va_end(ap);
	(report->warn ? report->warn : report->note)(report->user, text);
}

void gd_progress(const struct gd_report *report, const char *stage, double done)
{
	if (report && report->progress)
		report->progress(report->user, stage, done < 0 ? 0 : done > 1 ? 1 : done);
}

double gd_seconds(void)
{
	struct timespec t;

	clock_gettime(CLOCK_MONOTONIC, &t);
	return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

void *gd_alloc(size_t n, size_t size)
{
	size_t bytes;

	if (__builtin_mul_overflow(n, size, &bytes) || bytes > PTRDIFF_MAX - ALIGN)
		return NULL;
	bytes = (bytes + ALIGN - 1) / ALIGN * ALIGN;
	return aligned_alloc(ALIGN, bytes ? bytes : ALIGN);
}

void *gd_calloc(size_t n, size_t size)
{
	void *p = gd_alloc(n, size);

	if (p)
		memset(p, 0, n * size);
	return p;
}
