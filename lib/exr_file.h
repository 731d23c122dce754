/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * An EXR file that is being read: what the header's reader and the decoder share, and nobody else.
 */
#ifndef GD_EXR_FILE_H
#define GD_EXR_FILE_H

#include <openexr.h>

#include "exr.h"
#include "input.h"

struct gd_exr {
	struct gd_input in;
	exr_context_t ctx;
	int part;
	exr_storage_t storage;
	exr_compression_t compression;
	struct gd_plugin_file *plugin;	/* pixels come from here if set */
	uint64_t head_end;		/* of a stream: offset behind the header */
	int nfile;			/* channels in the file, */
	char **name;			/* in the order of the file, */
	enum gd_type *type;		/* and their types */
	bool quiet;			/* opened: threads complain to nobody */
	char message[200];		/* first complaint of the library */
};

/* For messages, by number. */
extern const char *const gd_exr_codec[];

/* Records a failure of the library: its first complaint if there was one, else what code means. */
int gd_exr_fail_library(struct gd_exr *file, exr_result_t code, struct gd_err *err);
/* Keeps all of a stream; the library is told how long it is. */
int gd_exr_keep_stream(struct gd_exr *file, struct gd_err *err);
/* Decodes the channels of im that are not dropped. */
int gd_exr_decode(struct gd_exr *file, struct gd_image *im, struct gd_err *err);

#endif
