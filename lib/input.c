/* SPDX-License-Identifier: BSD-3-Clause */
#include "input.h"

#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#define BLOCK		((uint64_t)2 << 20)	/* a huge page: given back at a time */
#define PIPE_BYTES	(1 << 20)	/* the most an unprivileged process may ask for */
#define FIRST_MAP	((size_t)1 << 36)	/* address space to ask for at first */
#define READ_BYTES	(8 << 20)		/* the most that one read takes */
#define MAX_SLURP	((uint64_t)1 << 38)

static int fail_errno(const struct gd_input *in, struct gd_err *err)
{
	return gd_fail(err, GD_EIO, "%s: %s", in->label, strerror(errno));
}

static int64_t read_some(int fd, void *buf, size_t n)
{
	ssize_t got;

	do
		got = read(fd, buf, n);
	while (got < 0 && errno == EINTR);
	return got;
}

static void *reserve(size_t size)
{
	return mmap(NULL, size, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE,
		    -1, 0);
}

/*
 * Makes room for at least want bytes. Address space costs nothing, so the first try takes plenty
 * and the mapping hardly ever has to move; where little is allowed it doubles.
 */
static int slurp_grow(struct gd_input *in, uint64_t want, bool huge, struct gd_err *err)
{
	size_t size = in->mem ? 2 * in->mapped : FIRST_MAP;
	void *mem = MAP_FAILED;

	if (want > MAX_SLURP)
		return gd_fail(err, GD_ENOMEM, "%s: more than %llu GiB of data", in->label,
			       (unsigned long long)(MAX_SLURP >> 30));
	if (in->mem)
		mem = mremap(in->mem, in->mapped, size, MREMAP_MAYMOVE);
	else
		while (mem == MAP_FAILED && size >= want) {
			mem = reserve(size);
			if (mem == MAP_FAILED)
				size /= 2;
		}
	if (mem == MAP_FAILED)
		return gd_fail(err, GD_ENOMEM, "%s: out of memory after %llu bytes", in->label,
			       (unsigned long long)in->size);
	in->mem = mem;
	in->mapped = size;
	if (huge)	/* a header does not need them */
		madvise(mem, size, MADV_HUGEPAGE);
	return GD_OK;
}

/* Gives the address space behind the last byte back. */
static void slurp_trim(struct gd_input *in)
{
	size_t page = (size_t)sysconf(_SC_PAGESIZE), used = (in->size + page) / page * page;

	if (used < in->mapped && munmap(in->mem + used, in->mapped - used) == 0)
		in->mapped = used;
}

int gd_input_keep(struct gd_input *in, uint64_t n, struct gd_err *err)
{
	int rc = GD_OK;

	while (in->stream && in->size < n && rc == GD_OK) {
		if (in->size + READ_BYTES > in->mapped)
			rc = slurp_grow(in, in->size + READ_BYTES, n > READ_BYTES, err);
		if (rc != GD_OK)
			break;
		int64_t got = read_some(in->fd, in->mem + in->size,
					n - in->size < READ_BYTES ? n - in->size : READ_BYTES);
		if (got < 0)
			return fail_errno(in, err);
		in->size += (uint64_t)got;
		in->stream = got > 0;
	}
	if (!in->stream && in->mem)
		slurp_trim(in);
	return rc;
}

int gd_input_next(struct gd_input *in, void *buf, size_t n, struct gd_err *err)
{
	size_t done = in->size - in->at < n ? (size_t)(in->size - in->at) : n;

	memcpy(buf, in->mem + in->at, done);
	in->at += done;
	while (done < n) {
		int64_t got = read_some(in->fd, (char *)buf + done, n - done);
		if (got < 0)
			return fail_errno(in, err);
		if (got == 0)
			return gd_fail(err, GD_EFORMAT, "%s: truncated", in->label);
		done += (size_t)got;
	}
	return GD_OK;
}

int gd_input_open(struct gd_input *in, const char *path, struct gd_err *err)
{
	bool standard = strcmp(path, "-") == 0;
	struct stat st;
	int rc = GD_OK;

	*in = (struct gd_input){ .path = path, .label = standard ? "stdin" : path };
	in->fd = standard ? fcntl(STDIN_FILENO, F_DUPFD_CLOEXEC, 3)
			  : open(path, O_RDONLY | O_CLOEXEC);
	if (in->fd < 0)
		return fail_errno(in, err);
	if (fstat(in->fd, &st) != 0) {
		rc = fail_errno(in, err);
	} else if (S_ISDIR(st.st_mode)) {
		errno = EISDIR;
		rc = fail_errno(in, err);
	} else if (S_ISREG(st.st_mode)) {
		off_t at = standard ? lseek(in->fd, 0, SEEK_CUR) : 0;
		in->base = at > 0 ? (uint64_t)at : 0;
		in->size = (uint64_t)st.st_size > in->base ? (uint64_t)st.st_size - in->base : 0;
	} else {
		in->stream = true;
		fcntl(in->fd, F_SETPIPE_SZ, PIPE_BYTES);	/* does nothing to others */
		rc = gd_input_keep(in, 1, err);
	}
	if (rc == GD_OK && in->size == 0)
		rc = gd_fail(err, GD_EFORMAT, "%s: empty", in->label);
	if (rc != GD_OK)
		gd_input_close(in);
	return rc;
}

void gd_input_close(struct gd_input *in)
{
	if (in->fd >= 0)
		close(in->fd);
	if (in->mem)
		munmap(in->mem, in->mapped);
	free(in->left);
	*in = (struct gd_input){ .fd = -1 };
}

int64_t gd_input_read(const struct gd_input *in, void *buf, uint64_t n, uint64_t offset)
{
	uint64_t done = 0;

	if (offset >= in->size)
		return 0;
	if (n > in->size - offset)
		n = in->size - offset;
	if (in->mem) {
		memcpy(buf, in->mem + offset, n);
		return (int64_t)n;
	}
	while (done < n) {
		ssize_t got = pread(in->fd, (char *)buf + done, n - done,
				    (off_t)(in->base + offset + done));
		if (got < 0 && errno == EINTR)
			continue;
		if (got < 0)
			return -1;
		if (got == 0)
			break;
		done += (uint64_t)got;
	}
	return (int64_t)done;
}

const unsigned char *gd_input_view(const struct gd_input *in, void *buf, uint64_t n,
				   uint64_t offset)
{
	if (offset > in->size || n > in->size - offset)
		return NULL;
	if (in->mem)
		return in->mem + offset;
	return gd_input_read(in, buf, n, offset) == (int64_t)n ? buf : NULL;
}

/*
 * Blocks lie at multiples of BLOCK in the address space: number and end (an offset) of the one at
 * offset.
 */
static size_t block_at(const struct gd_input *in, uint64_t offset, uint64_t *end)
{
	uint64_t skew = (uintptr_t)in->mem % BLOCK, b = (offset + skew) / BLOCK;

	*end = (b + 1) * BLOCK - skew;
	return (size_t)b;
}

static void block_release(const struct gd_input *in, uint64_t end)
{
	uint64_t start = end > BLOCK ? end - BLOCK : 0, stop = end < in->mapped ? end : in->mapped;

	madvise(in->mem + start, stop - start, MADV_DONTNEED);
}

int gd_input_need(struct gd_input *in, uint64_t n, uint64_t offset, struct gd_err *err)
{
	uint64_t end;

	if (!in->mem || n == 0 || offset >= in->size || n > in->size - offset)
		return GD_OK;
	if (!in->left)
		in->left = calloc(in->size / BLOCK + 2, sizeof(*in->left));
	if (!in->left)
		return gd_fail(err, GD_ENOMEM, "%s: out of memory", in->label);
	for (uint64_t at = offset; at < offset + n; at = end) {
		size_t b = block_at(in, at, &end);
		in->left[b] += (end < offset + n ? end : offset + n) - at;
	}
	return GD_OK;
}

void gd_input_done(const struct gd_input *in, uint64_t n, uint64_t offset)
{
	uint64_t end;

	if (!in->left || n == 0 || offset >= in->size || n > in->size - offset)
		return;
	for (uint64_t at = offset; at < offset + n; at = end) {
		size_t b = block_at(in, at, &end);
		uint64_t bytes = (end < offset + n ? end : offset + n) - at;
		if (__atomic_sub_fetch(&in->left[b], bytes, __ATOMIC_ACQ_REL) == 0)
			block_release(in, end);
	}
}
