/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * What renderers call their channels, in terms of gd-buffers(5). A file's channels are sorted into
 * layers of one to four channels, each with its role and its names in a gd buffer.
 */
#ifndef GD_NAMES_H
#define GD_NAMES_H

#include "image.h"

enum gd_preset {
	GD_NAMES_AUTO,		/* look at the names and attributes */
	GD_NAMES_GD,		/* the names of gd-buffers(5) */
	GD_NAMES_PBRT,		/* pbrt-v4, "gbuffer" film */
	GD_NAMES_MITSUBA,	/* Mitsuba 3, "aov" and "moment" integrators */
	GD_NAMES_CYCLES,	/* Blender, multilayer EXR */
	GD_NAMES_TUNGSTEN,
	GD_NAMES_ARNOLD,	/* as for noice */
	GD_NAMES_RENDERMAN
};

/* What a file's variance channels hold, m being the mean of n samples. */
enum gd_variance {
	GD_VARIANCE_AUTO,   /* as the renderer of that preset writes it */
	GD_VARIANCE_NONE,   /* nothing: they are dropped */
	GD_VARIANCE_MEAN,   /* the variance of m */
	GD_VARIANCE_SAMPLE, /* the variance of one sample: n times that of m */
	GD_VARIANCE_M2	    /* mean of the squared samples: (m2 - m^2) / (n - 1) is that of m */
};

enum gd_role {
	GD_ROLE_MEAN,	  /* a mean over samples */
	GD_ROLE_VARIANCE, /* the variance (see enum gd_variance) of the layer named by layer */
	GD_ROLE_SAMPLES,  /* samples per pixel */
	GD_ROLE_PASS,	  /* cannot be averaged: identifiers, cryptomattes, UINT */
	GD_ROLE_DROP	  /* known, and without a meaning in a merged buffer */
};

#define GD_NAMED_MAX 4

struct gd_named {
	enum gd_role role;
	char layer[256]; /* "" is the colour; else "dx", "albedo", "bin3.dx", "half0" ... */
	int n;				/* channels in the gd buffer */
	int chan[GD_NAMED_MAX]; /* index in the image, more than once where grey becomes R G B */
	char name[GD_NAMED_MAX][256];	/* full name in the gd buffer */
	bool renamed;			/* by a preset or by map */
};

struct gd_names {
	enum gd_preset preset;		/* the one in force */
	enum gd_variance variance;	/* never AUTO */
	int n;
	struct gd_named *layer;
};

struct gd_names_conf {
	enum gd_preset preset;
	enum gd_variance variance;
	int nmap;	/* "albedo=Denoising Albedo.{R,G,B}", "Z=depth", "variance=a,b,c" */
	const char *const *map;
	int npass;		/* patterns as in a shell; channels that match pass unchanged */
	const char *const *pass;
};

/* From "pbrt" etc.; false if there is no such name. */
bool gd_preset_parse(const char *name, enum gd_preset *preset);
const char *gd_preset_name(enum gd_preset preset);
bool gd_variance_parse(const char *name, enum gd_variance *variance);
const char *gd_variance_name(enum gd_variance variance);

/*
 * Gives every channel of im exactly one layer. names must be empty ({ 0 }).
 * Returns GD_OK, GD_EARG (a map that cannot be read), GD_ESHAPE (a channel in map that im does not
 * have), GD_ENOMEM.
 */
int gd_names_resolve(struct gd_names *names, const struct gd_image *im,
		     const struct gd_names_conf *conf, struct gd_err *err);
void gd_names_free(struct gd_names *names);

/* The channels behind a layer, for a reader: "Combined.{R,G,B}". */
void gd_named_describe(const struct gd_named *l, const struct gd_image *im, char *text,
		       size_t size);

/* The layer of that role and name, or NULL. */
const struct gd_named *gd_names_find(const struct gd_names *names, enum gd_role role,
				     const char *layer);

/*
 * Samples per pixel as the attributes tell them: gd:samplesPerPixel, gd:samples, samplesPerPixel,
 * cycles.<layer>.samples; false if none does.
 */
bool gd_names_spp(const struct gd_image *im, double *spp);

#endif
