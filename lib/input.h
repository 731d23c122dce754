/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * The bytes of an input, at any offset, from a file or a pipe. A regular file is read with pread,
 * so that nothing happens to the process when another one shortens it. Anything else is a stream:
 * as much of it as is asked for is kept in memory, and what follows can be read on or kept as a
 * whole. Pages of what was kept can be given back as they are done with.
 */
#ifndef GD_INPUT_H
#define GD_INPUT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "gd.h"

struct gd_input {
	const char *path;	/* as the caller gave it; "-" is standard input */
	const char *label;	/* for messages: path, or "stdin" */
	int fd;
	uint64_t base;		/* offset of the first byte in fd */
	uint64_t size;		/* bytes; of a stream, those kept so far */
	uint64_t at;		/* where gd_input_next() goes on, at most size */
	bool stream;		/* there may be more in fd than size */
	unsigned char *mem;	/* what is kept of a stream, or NULL */
	size_t mapped;		/* bytes of the mapping behind mem */
	uint64_t *left;		/* per block of mem, bytes still needed; NULL: keep all */
};

/* Opens path, which must stay valid as long as in. */
int gd_input_open(struct gd_input *in, const char *path, struct gd_err *err);
/* Keeps at least n bytes of a stream, or all if there are less; then in->stream is false. */
int gd_input_keep(struct gd_input *in, uint64_t n, struct gd_err *err);
/*
 * Reads the n bytes at in->at and moves it: first what is kept of a stream, then on without keeping
 * it.
 */
int gd_input_next(struct gd_input *in, void *buf, size_t n, struct gd_err *err);
void gd_input_close(struct gd_input *in);	/* takes { .fd = -1 } */

/*
 * Reads n bytes at offset; the number read is smaller only at the end, -1 with errno set on
 * failure.
 */
int64_t gd_input_read(const struct gd_input *in, void *buf, uint64_t n, uint64_t offset);

/*
 * The same without a copy where the bytes are in memory; else through buf. NULL if they are not all
 * there.
 */
const unsigned char *gd_input_view(const struct gd_input *in, void *buf, uint64_t n,
				   uint64_t offset);

/*
 * Announces that n bytes at offset will be needed once, and that they have been. When the last
 * announced byte of a block of memory is done, the block goes back to the system; bytes that nobody
 * announced are not kept. gd_input_done() may be called from several threads.
 */
int gd_input_need(struct gd_input *in, uint64_t n, uint64_t offset, struct gd_err *err);
void gd_input_done(const struct gd_input *in, uint64_t n, uint64_t offset);

#endif
