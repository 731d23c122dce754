/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * The command line: the only code that reads argv, prints or exits. Linked to the tools, not to
 * libgd.a. One letter means one thing in all tools: -o output, -j threads, -s seed, -v verbose,
 * -q quiet, -h help.
 */
#ifndef GD_CLI_H
#define GD_CLI_H

#include <stdbool.h>
#include <stdint.h>

#include "exr.h"
#include "json.h"

enum gd_opt_kind {
	GD_OPT_FLAG, GD_OPT_INT, GD_OPT_DOUBLE, GD_OPT_STRING, GD_OPT_LIST, GD_OPT_U64, GD_OPT_WORDS
};

/*
 * A growing list of the arguments of an option that may be given several times; one of kind
 * GD_OPT_WORDS takes all words up to the next option, or up to "--", each time.
 */
struct gd_list {
	int n;
	const char **v;
};

struct gd_opt {
	int key;		/* letter, or 0 for a long name only */
	const char *name;	/* long name */
	const char *arg;	/* what the argument is called in the help, NULL for a flag */
	enum gd_opt_kind kind;
	void *target;	/* bool, int, double, const char *, struct gd_list or uint64_t */
	double min, max;	/* range of numbers, inclusive */
	const char *help;
};

#define GD_KIND(t) _Generic((t), bool *: GD_OPT_FLAG, int *: GD_OPT_INT, double *: GD_OPT_DOUBLE, \
	const char **: GD_OPT_STRING, struct gd_list *: GD_OPT_LIST, uint64_t *: GD_OPT_U64)
#define GD_FLAG(key, name, t, help) \
	{ key, name, NULL, _Generic((t), bool *: GD_OPT_FLAG), t, 0, 0, help }
#define GD_OPT(key, name, arg, t, help)		{ key, name, arg, GD_KIND(t), t, 0, 0, help }
#define GD_NUM(key, name, arg, t, lo, hi, help) \
	{ key, name, arg, GD_KIND(t), t, lo, hi, help }
#define GD_WORDS(key, name, arg, t, help) \
	{ key, name, arg, _Generic((t), struct gd_list *: GD_OPT_WORDS), t, 0, 0, help }
#define GD_OPT_END				{ 0, NULL, NULL, GD_OPT_FLAG, NULL, 0, 0, NULL }

struct gd_cmd {
	const char *name;		/* "gdsolve" */
	const char *operands;		/* "[input.exr [output.exr]]" */
	const char *summary;		/* one line, lower case, no full stop */
	const struct gd_opt *opts;	/* ended by GD_OPT_END; the common ones are added */
	int min_operands, max_operands;	/* max < 0: any number */
	/* An EXR filter: [input [output]] with -o, --compression, --part. With max_operands < 0 all
	 * operands are inputs, and only -o names the output. */
	bool filter;
};

/* One run of a tool: the common options, and what becomes of it. { 0 } before gd_cli_parse(). */
struct gd_cli {
	const struct gd_cmd *cmd;
	int argc;
	char **argv;
	char **operand;
	int noperand;
	const char *input, *output;	/* filters: "-" where none is given */
	const char *about;		/* another input that an error is about, or NULL */
	const char *stats, *compression;
	int threads, part;
	bool verbose, quiet;
	double start;			/* gd_seconds() at the start */
	double io_seconds;		/* of that, reading and writing */
	struct gd_report report;	/* hand this to the library */
	struct gd_json figures;		/* collected for --stats */
	char *command;			/* the command line, quoted for a shell */
	bool progress_shown;		/* a progress line stands on the terminal */
	double progress_time;		/* when it was drawn */
	const char *stage;		/* going on, since when and how much was done then */
	double stage_time, stage_done;
	bool limit_missed;		/* set it: exit status 1 */
};

/*
 * Parses options and operands (in any order), sets the threads. Leaves on -h, --version and usage
 * errors; a filter that would write to a terminal is one. An option of the tool's own takes the
 * place of a common one with the same letter or name. cmd and its targets must outlive cli.
 */
void gd_cli_parse(struct gd_cli *cli, const struct gd_cmd *cmd, int argc, char **argv);

/*
 * Opens an EXR operand ("-": standard input, refused from a terminal), taking --part into account.
 */
int gd_cli_open(struct gd_cli *cli, struct gd_exr **file, struct gd_image *im, const char *path,
		struct gd_err *err);
/* Loads the pixels and closes the file in every case. */
int gd_cli_load(struct gd_cli *cli, struct gd_exr *file, struct gd_image *im, struct gd_err *err);

/* Other frames beside the input, of --neighbours:
 * refuses the input itself, and a file named twice. */
int gd_cli_check_neighbours(const struct gd_cli *cli, const struct gd_list *list,
			    struct gd_err *err);

/* ", 12 s left": what rest of a stage takes, of which so much was done in so many seconds; "" where
 * that is not known yet. For the progress line. */
void gd_cli_time_left(char text[32], double seconds, double done, double rest);

/*
 * Signs the image and writes it to cli->output: a line with the command is added to gd:history, the
 * wall seconds of this run without I/O to gd:seconds.<tool>. With the environment variable
 * SOURCE_DATE_EPOCH set no seconds are written, so that the same input gives the same file.
 */
int gd_cli_write(struct gd_cli *cli, struct gd_image *im, struct gd_err *err);

/* Numbers and texts for --stats; names are JSON keys. */
void gd_cli_stat(struct gd_cli *cli, const char *name, double value);
void gd_cli_stat_text(struct gd_cli *cli, const char *name, const char *value);

/* A warning line on stderr unless -q. */
void gd_cli_warn(struct gd_cli *cli, const char *format, ...) __attribute__((format(printf, 2, 3)));

/*
 * Prints the error (if any), checks standard output, writes --stats, frees cli's memory and returns
 * the exit status: 0 done, 1 done but cli->limit_missed, 2 not done (without a word if the reader
 * of our output has gone). A filter's GD_ESHAPE and GD_ENUMERIC texts get in front the name of the
 * input, or of cli->about.
 */
int gd_cli_finish(struct gd_cli *cli, int rc, const struct gd_err *err);

#endif
