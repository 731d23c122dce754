/* SPDX-License-Identifier: BSD-3-Clause */
#include "file.h"

#include <errno.h>
#include <fcntl.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static int fail(const char *path, struct gd_err *err)
{
	int no = errno, rc;

	rc = gd_fail(err, GD_EIO, "%s: %s", path, strerror(no));
	if (no == EPIPE && err)
		err->text[0] = '\0';
	return rc;
}

/* 0, or -1 with errno. */
static int write_all(int fd, const unsigned char *p, size_t size)
{
	while (size) {
		ssize_t n = write(fd, p, size);

		if (n < 0 && errno == EINTR)
			continue;
		if (n < 0)
			return -1;
		p += n;
		size -= (size_t)n;
	}
	return 0;
}

static int write_stream(const char *path, const void *data, size_t size, struct gd_err *err)
{
	bool out = !strcmp(path, "-");
	int fd = out ? STDOUT_FILENO : open(path, O_WRONLY | O_CLOEXEC), bad, no;

	if (fd < 0)
		return fail(path, err);
	bad = write_all(fd, data, size);
	no = errno;
	if (!out && close(fd) && !bad) {
		bad = -1;
		no = errno;
	}
	errno = no;
	return bad ? fail(out ? "standard output" : path, err) : GD_OK;
}

/* The temporary name: beside the file, so that rename() stays within one file system. */
static int open_beside(const char *path, char **temp)
{
	size_t size = strlen(path) + 32;

	*temp = malloc(size);
	if (!*temp)
		return -1;
	for (int i = 0; i < 1000; i++) {
		int fd;

		snprintf(*temp, size, "%s.tmp.%ld.%d", path, (long)getpid(), i);
		fd = open(*temp, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
		if (fd >= 0 || errno != EEXIST)
			return fd;
	}
	return -1;
}

static int write_whole(const char *path, const void *data, size_t size, struct gd_err *err)
{
	char *temp = NULL;
	int fd = open_beside(path, &temp), bad, rc = GD_OK;

	if (fd < 0) {
		rc = fail(path, err);
		free(temp);
		return rc;
	}
	bad = write_all(fd, data, size) || fsync(fd);
	if (bad) {
		rc = fail(path, err);
		close(fd);
	} else if (close(fd) || rename(temp, path)) {
		rc = fail(path, err);
	}
	if (rc != GD_OK)
		unlink(temp);
	free(temp);
	return rc;
}

int gd_file_write(const char *path, const void *data, size_t size, struct gd_err *err)
{
	struct stat st;
	char *target;
	int rc;

	if (!strcmp(path, "-") || (!stat(path, &st) && !S_ISREG(st.st_mode)))
		return write_stream(path, data, size, err);
	target = realpath(path, NULL);		/* a link's target is replaced, not the link */
	rc = write_whole(target ? target : path, data, size, err);
	free(target);
	return rc;
}
