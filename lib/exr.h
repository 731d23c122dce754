/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * OpenEXR files in and out, through OpenEXR's C library.
 *
 * Reading takes two steps, so that a tool sees the channel list before it pays for pixels:
 *	gd_exr_open(&file, &im, "in.exr", &conf, err)	sizes, attributes, channels (GD_PASS)
 *	im.chan[i].want = GD_READ or GD_DROP ...
 *	gd_exr_load(file, &im, err)			pixels, on all threads
 *	gd_exr_close(file)
 * "-" is standard input. A regular file is read with pread, on standard input from its offset on.
 * Of a pipe, uncompressed rows are decoded as they come; anything else is kept whole and its pages
 * are given back as they are decoded: the memory needed is that of the decoded channels either way.
 * Rows and tiles (level 0), HALF, FLOAT and UINT, all codecs of the C library; DWA-compressed EXR
 * and, from files, other formats go through the OpenImageIO plug-in if it is installed. Deep and
 * sub-sampled images are refused, and so are incomplete ones and those whose header claims more
 * pixels than the bytes behind it can hold: GD_EFORMAT and one line that names the file.
 */
#ifndef GD_EXR_H
#define GD_EXR_H

#include "image.h"

#define GD_MAX_SIDE	65536	/* pixels; a header that asks for more is refused */
#define GD_MAX_BYTES	((size_t)1 << 37)	/* of decoded pixels in one image */

struct gd_exr;		/* an open file */

struct gd_read_conf {	/* NULL: the first part */
	int part;	/* part of a multi-part file, from 0 */
};

/* Fills im (which must be empty) with all but pixels. On failure *file is NULL and im is empty. */
int gd_exr_open(struct gd_exr **file, struct gd_image *im, const char *path,
		const struct gd_read_conf *conf, struct gd_err *err);
/* Decodes each channel as its want says; drops GD_DROP channels from im. Incomplete files fail. */
int gd_exr_load(struct gd_exr *file, struct gd_image *im, struct gd_err *err);
void gd_exr_close(struct gd_exr *file);		/* takes NULL */

enum gd_compression { GD_NONE, GD_RLE, GD_ZIPS, GD_ZIP, GD_PIZ };

struct gd_write_conf {
	enum gd_compression compression;
};

/*
 * Writes all channels that have pixels as one scanline part, with all attributes but those that
 * describe a file's layout. conf may be NULL: no compression. The bytes do not depend on the number
 * of threads. A file appears whole or not at all: no name or a temporary one beside it, fsync,
 * rename; it may be the file that was read. "-" is standard output; that, and a path that is no
 * regular file (/dev/full, a fifo), is written as a stream: uncompressed rows as they are packed,
 * else from memory at the end. Returns GD_EIO with errno's text; a broken pipe sets err->text to ""
 * (end quietly).
 */
int gd_exr_write(const struct gd_image *im, const char *path,
		 const struct gd_write_conf *conf, struct gd_err *err);

#endif
