/* SPDX-License-Identifier: BSD-3-Clause */
#include "output.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#define MAX_WRITE	((size_t)1 << 30)	/* one write(2) takes less than 2 GiB */
#define NAME_TRIES	1000

struct gd_output {
	const char *label;
	int fd;
	bool file;		/* a regular file of ours: seekable, gets its name at the end */
	bool hold;		/* a stream that is kept in memory until it is complete */
	uint64_t size;
	unsigned char *mem;	/* of a held stream */
	size_t room;
	char *target;		/* name that the file shall have */
	char *temp;		/* name that it has, or NULL */
};

static int fail_errno(const struct gd_output *out, struct gd_err *err)
{
	if (errno == EPIPE)
		return gd_fail(err, GD_EIO, "%s", "");
	return gd_fail(err, GD_EIO, "%s: %s", out->label, strerror(errno));
}

/* A new name in the directory of target. */
static char *temp_name(const char *target, int serial)
{
	const char *slash = strrchr(target, '/');
	int dir = slash ? (int)(slash - target) + 1 : 0;
	char *name;

	if (asprintf(&name, "%.*s.gd-%ld-%d.tmp", dir, target, (long)getpid(), serial) < 0)
		return NULL;
	return name;
}

/* Opens a file under a temporary name: out->temp. */
static int open_named(struct gd_output *out, mode_t mode)
{
	int fd = -1;

	for (int i = 0; i < NAME_TRIES && fd < 0; i++) {
		free(out->temp);
		out->temp = temp_name(out->target, i);
		if (!out->temp)
			return -1;
		fd = open(out->temp, O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, mode);
		if (fd < 0 && errno != EEXIST)
			break;
	}
	if (fd < 0) {
		free(out->temp);
		out->temp = NULL;
	}
	return fd;
}

/*
 * Opens a file that has no name, and so leaves nothing even if we are killed. -1 where the file
 * system does not know such files, or where there is no /proc to name it later.
 */
static int open_nameless(const struct gd_output *out, mode_t mode)
{
	char *dir = access("/proc/self/fd", X_OK) == 0 ? strdup(out->target) : NULL;
	char *slash = dir ? strrchr(dir, '/') : NULL;
	int fd;

	if (slash)
		slash[slash == dir] = '\0';
	fd = dir ? open(slash ? dir : ".", O_TMPFILE | O_RDWR | O_CLOEXEC, mode) : -1;
	free(dir);
	return fd;
}

static int open_file(struct gd_output *out, const char *path, const struct stat *old,
		     struct gd_err *err)
{
	out->file = true;
	out->target = old ? realpath(path, NULL) : strdup(path);
	if (!out->target)
		return fail_errno(out, err);
	if (old && access(path, W_OK) != 0)
		return fail_errno(out, err);
	out->fd = open_nameless(out, 0666);
	if (out->fd < 0)
		out->fd = open_named(out, 0666);
	if (out->fd < 0)
		return fail_errno(out, err);
	if (old)
		(void)!fchmod(out->fd, old->st_mode & 07777);	/* a matter of courtesy */
	return GD_OK;
}

int gd_output_open(struct gd_output **result, const char *path, bool stream, struct gd_err *err)
{
	struct gd_output *out = calloc(1, sizeof(*out));
	bool standard = strcmp(path, "-") == 0;
	struct stat st;
	int rc = GD_OK;

	*result = NULL;
	if (!out)
		return gd_fail(err, GD_ENOMEM, "%s: out of memory", path);
	if (!*path) {
		free(out);
		return gd_fail(err, GD_EARG, "the output has an empty name");
	}
	out->label = standard ? "stdout" : path;
	out->fd = -1;
	out->hold = !stream;
	if (standard) {
		out->fd = fcntl(STDOUT_FILENO, F_DUPFD_CLOEXEC, 3);
		fcntl(out->fd, F_SETPIPE_SZ, 1 << 20);	/* no pipe: no matter */
	} else if (stat(path, &st) != 0) {
		if (errno == ENOENT)
			rc = open_file(out, path, NULL, err);
	} else if (S_ISREG(st.st_mode)) {
		rc = open_file(out, path, &st, err);
	} else {
		out->fd = open(path, O_WRONLY | O_CLOEXEC);
	}
	if (rc == GD_OK && out->fd < 0)
		rc = fail_errno(out, err);
	if (rc != GD_OK)
		gd_output_close(out);
	else
		*result = out;
	return rc;
}

static int write_all(const struct gd_output *out, const unsigned char *data, size_t n,
		     struct gd_err *err)
{
	while (n > 0) {
		ssize_t done = write(out->fd, data, n < MAX_WRITE ? n : MAX_WRITE);
		if (done < 0 && errno == EINTR)
			continue;
		if (done < 0)
			return fail_errno(out, err);
		data += done;
		n -= (size_t)done;
	}
	return GD_OK;
}

static int hold(struct gd_output *out, const void *data, size_t n, struct gd_err *err)
{
	if (n > out->room - out->size) {
		size_t room = out->room + out->room / 2 + n + 65536;
		unsigned char *mem = realloc(out->mem, room);
		if (!mem)
			return gd_fail(err, GD_ENOMEM, "%s: out of memory for %zu bytes",
				       out->label, room);
		out->mem = mem;
		out->room = room;
	}
	memcpy(out->mem + out->size, data, n);
	return GD_OK;
}

int gd_output_add(struct gd_output *out, const void *data, size_t n, struct gd_err *err)
{
	int rc = !out->file && out->hold ? hold(out, data, n, err) : write_all(out, data, n, err);

	if (rc == GD_OK)
		out->size += n;
	return rc;
}

uint64_t gd_output_size(const struct gd_output *out)
{
	return out->size;
}

int gd_output_patch(struct gd_output *out, const void *data, size_t n, uint64_t offset,
		    struct gd_err *err)
{
	const unsigned char *v = data;

	if (!out->file) {
		memcpy(out->mem + offset, data, n);
		return GD_OK;
	}
	while (n > 0) {
		ssize_t done = pwrite(out->fd, v, n, (off_t)offset);
		if (done < 0 && errno == EINTR)
			continue;
		if (done < 0)
			return fail_errno(out, err);
		v += done;
		n -= (size_t)done;
		offset += (uint64_t)done;
	}
	return GD_OK;
}

/* Gives a file without a name a temporary one: only rename() replaces an existing file at once. */
static int link_temp(struct gd_output *out, struct gd_err *err)
{
	char self[64];

	snprintf(self, sizeof self, "/proc/self/fd/%d", out->fd);
	for (int i = 0; i < NAME_TRIES; i++) {
		char *name = temp_name(out->target, i);
		if (!name)
			return gd_fail(err, GD_ENOMEM, "%s: out of memory", out->label);
		if (linkat(AT_FDCWD, self, AT_FDCWD, name, AT_SYMLINK_FOLLOW) == 0) {
			out->temp = name;
			return GD_OK;
		}
		free(name);
		if (errno != EEXIST)
			break;
	}
	return fail_errno(out, err);
}

static int commit_file(struct gd_output *out, struct gd_err *err)
{
	int rc = GD_OK;

	if (fsync(out->fd) != 0 && errno != EINVAL && errno != EROFS)
		return fail_errno(out, err);
	if (!out->temp)
		rc = link_temp(out, err);
	if (rc == GD_OK && rename(out->temp, out->target) != 0)
		return fail_errno(out, err);
	if (rc == GD_OK) {
		free(out->temp);
		out->temp = NULL;
	}
	return rc;
}

int gd_output_commit(struct gd_output *out, struct gd_err *err)
{
	int rc = GD_OK, fd = out->fd;

	if (out->file)
		rc = commit_file(out, err);
	else if (out->hold)
		rc = write_all(out, out->mem, out->size, err);
	if (rc != GD_OK)
		return rc;
	out->fd = -1;
	return close(fd) == 0 ? GD_OK : fail_errno(out, err);	/* some tell only now */
}

void gd_output_close(struct gd_output *out)
{
	if (!out)
		return;
	if (out->fd >= 0)
		close(out->fd);
	if (out->temp)
		unlink(out->temp);
	free(out->temp);
	free(out->target);
	free(out->mem);
	free(out);
}
