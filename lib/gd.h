/* SPDX-License-Identifier: BSD-3-Clause */
/* Status codes, error text and reports: the bottom layer, included by every other header. */
#ifndef GD_H
#define GD_H

#include <stddef.h>

#define GD_VERSION "0.1.0"

enum gd_status {
	GD_OK = 0,
	GD_EARG,	/* an argument or option is out of its range */
	GD_EIO,		/* reading, writing or opening failed */
	GD_EFORMAT,	/* the file is damaged or of a kind that is not supported */
	GD_ESHAPE,	/* sizes or channels do not fit together, or a channel is missing */
	GD_ENOMEM,	/* out of memory, or a size beyond the limits */
	GD_ENUMERIC	/* no usable number came out */
};

/* The caller's; { 0 } is "no error". The first failure wins, later ones leave the text alone. */
struct gd_err {
	int code;
	char text[512];
};

/* Records code and text in err (which may be NULL) and returns code. */
int gd_fail(struct gd_err *err, int code, const char *format, ...)
	__attribute__((format(printf, 3, 4)));

/*
 * How library routines tell what they decide. Any pointer may be NULL, and so may a
 * struct gd_report pointer itself: use gd_note(), gd_warn() and gd_progress().
 * A warning is of what makes the result other than expected; without warn it is a note.
 * All are called from the thread that called the routine, never from inside a parallel loop.
 */
struct gd_report {
	void (*note)(void *user, const char *text);	/* one line, no newline */
	void (*progress)(void *user, const char *stage, double done);	/* done in 0 .. 1 */
	void *user;
	void (*warn)(void *user, const char *text);	/* one line, no newline */
};

void gd_note(const struct gd_report *report, const char *format, ...)
	__attribute__((format(printf, 2, 3)));
void gd_warn(const struct gd_report *report, const char *format, ...)
	__attribute__((format(printf, 2, 3)));
void gd_progress(const struct gd_report *report, const char *stage, double done);

/* Seconds on a monotonic clock; differences only. */
double gd_seconds(void);

/*
 * 64-byte aligned memory, freed by free(); NULL if n*size overflows or there is none. Not zeroed.
 */
void *gd_alloc(size_t n, size_t size);
void *gd_calloc(size_t n, size_t size);

#endif
