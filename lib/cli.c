/* SPDX-License-Identifier: BSD-3-Clause */
#include "cli.h"

#include <ctype.h>
#include <errno.h>
#include <fcntl.h>
#include <getopt.h>
#include <limits.h>
#include <math.h>
#include <omp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "isa.h"

#define MAX_OPTS	96
#define LONG_KEY	1000	/* long options are numbered from here */
#define HELP_COLUMN	30
#define HELP_WIDTH	96

/* What is parsed: the tool's own options first, then the common ones it does not replace. */
struct table {
	const char *tool;
	int n;
	struct gd_opt opt[MAX_OPTS];
	char fallback[MAX_OPTS][64];	/* defaults as text, taken before anything is parsed */
	bool help, version;
};

static void usage_error(const char *tool, const char *format, ...)
	__attribute__((format(printf, 2, 3), noreturn));

static void usage_error(const char *tool, const char *format, ...)
{
	va_list ap;

	fprintf(stderr, "%s: ", tool);
	va_start(ap, format);
	vfprintf(stderr, format, ap);
	va_end(ap);
	fprintf(stderr, " (%s -h lists the options)\n", tool);
	exit(2);
}

static void *or_leave(const char *tool, void *p)
{
	if (!p) {
		fprintf(stderr, "%s: out of memory\n", tool);
		exit(2);
	}
	return p;
}

/* ---- the table of options ---- */

static void describe_default(char text[64], const struct gd_opt *o)
{
	text[0] = 0;
	switch (o->kind) {
	case GD_OPT_INT:
		snprintf(text, 64, "%d", *(const int *)o->target);
		break;
	case GD_OPT_DOUBLE:
		snprintf(text, 64, "%g", *(const double *)o->target);
		break;
	case GD_OPT_U64:
		snprintf(text, 64, "%llu", (unsigned long long)*(const uint64_t *)o->target);
		break;
	case GD_OPT_STRING:
		if (*(const char *const *)o->target)
			snprintf(text, 64, "%s", *(const char *const *)o->target);
		break;
	case GD_OPT_FLAG:
	case GD_OPT_LIST:
	case GD_OPT_WORDS:
		break;
	}
}

static void add_option(struct table *t, const struct gd_opt *o)
{
	for (int i = 0; i < t->n; i++)
		if ((o->key && o->key == t->opt[i].key) || !strcmp(o->name, t->opt[i].name))
			return;
	if (t->n == MAX_OPTS)
		usage_error(t->tool, "more than %d options", MAX_OPTS);
	describe_default(t->fallback[t->n], o);
	t->opt[t->n++] = *o;
}

static void build_table(struct table *t, struct gd_cli *cli)
{
	const struct gd_cmd *cmd = cli->cmd;
	const struct gd_opt filter[] = {
		GD_OPT('o', "output", "FILE", &cli->output, "write to FILE; - is standard output"),
		GD_OPT(0, "compression", "KIND", &cli->compression,
		       "none, rle, zips, zip or piz (default: none on a pipe, zip in a file)"),
		GD_NUM(0, "part", "N", &cli->part, 0, 1e6,
		       "read part N of a multi-part file, from 0"),
		GD_OPT_END
	};
	const struct gd_opt common[] = {
		GD_NUM('j', "threads", "N", &cli->threads, 1, 1024, "run on N threads"),
		GD_FLAG('v', "verbose", &cli->verbose, "say what is decided, and how long it took"),
		GD_FLAG('q', "quiet", &cli->quiet, "no warnings and no progress"),
		GD_OPT(0, "stats", "FILE", &cli->stats,
		       "write times and figures to FILE, as a JSON object"),
		GD_FLAG('h', "help", &t->help, "print this text and leave"),
		GD_FLAG(0, "version", &t->version, "print the version and leave"),
		GD_OPT_END
	};

	for (const struct gd_opt *o = cmd->opts; o && o->name; o++)
		add_option(t, o);
	for (const struct gd_opt *o = filter; cmd->filter && o->name; o++)
		add_option(t, o);
	for (const struct gd_opt *o = common; o->name; o++)
		add_option(t, o);
}

/* ---- help ---- */

static void print_wrapped(const char *text, int column)
{
	while (*text) {
		int word = (int)strcspn(text, " ");

		if (column + word > HELP_WIDTH && column > HELP_COLUMN) {
			printf("\n%*s", HELP_COLUMN, "");
			column = HELP_COLUMN;
		}
		printf("%.*s", word, text);
		column += word;
		text += word;
		if (*text == ' ') {
			putchar(' ');
			column++;
			text++;
		}
	}
	putchar('\n');
}

static void print_option(const struct gd_opt *o, const char *fallback)
{
	char left[128], right[1024], range[128] = "";
	int n;

	if (o->key)
		n = snprintf(left, sizeof left, "  -%c, --%s%s%s", o->key, o->name,
			     o->arg ? " " : "", o->arg ? o->arg : "");
	else
		n = snprintf(left, sizeof left, "      --%s%s%s", o->name, o->arg ? " " : "",
			     o->arg ? o->arg : "");
	if (o->min != 0 || o->max != 0)
		snprintf(range, sizeof range, "%.10g to %.10g", o->min, o->max);
	snprintf(right, sizeof right, "%s%s%s%s%s%s%s", o->help, *range || *fallback ? " (" : "",
		 range, *range && *fallback ? ", " : "", *fallback ? "default " : "", fallback,
		 *range || *fallback ? ")" : "");
	if (n >= HELP_COLUMN)
		printf("%s\n%*s", left, HELP_COLUMN, "");
	else
		printf("%-*s", HELP_COLUMN, left);
	print_wrapped(right, HELP_COLUMN);
}

static int close_stdout(const char *tool)
{
	if (!fflush(stdout) && !ferror(stdout))
		return 0;
	if (errno != EPIPE)
		fprintf(stderr, "%s: standard output: %s\n", tool, strerror(errno));
	return 2;
}

static void print_help(const struct table *t, const struct gd_cmd *cmd)
{
	printf("usage: %s [options] %s\n%s\n\n", cmd->name, cmd->operands, cmd->summary);
	for (int i = 0; i < t->n; i++)
		print_option(&t->opt[i], t->fallback[i]);
	exit(close_stdout(cmd->name));
}

/* ---- arguments ---- */

static const char *option_name(const struct gd_opt *o, bool by_letter, char text[80])
{
	if (by_letter)
		snprintf(text, 80, "-%c", o->key);
	else
		snprintf(text, 80, "--%s", o->name);
	return text;
}

static void check_range(const struct table *t, const struct gd_opt *o, const char *shown, double v,
			const char *arg)
{
	if ((o->min != 0 || o->max != 0) && (v < o->min || v > o->max))
		usage_error(t->tool, "option %s: %s is not in %.10g to %.10g", shown, arg, o->min,
			    o->max);
}

static double parse_double(const struct table *t, const struct gd_opt *o, const char *shown,
			   const char *arg)
{
	char *end;
	double v;

	errno = 0;
	v = strtod(arg, &end);
	if (end == arg || *end || isspace((unsigned char)*arg) || isnan(v))
		usage_error(t->tool, "option %s: '%s' is not a number", shown, arg);
	if (isinf(v) || (errno == ERANGE && fabs(v) > 1))
		usage_error(t->tool, "option %s: '%s' is too large", shown, arg);
	check_range(t, o, shown, v, arg);
	return v;
}

static int parse_int(const struct table *t, const struct gd_opt *o, const char *shown,
		     const char *arg)
{
	char *end;
	long v;

	errno = 0;
	v = strtol(arg, &end, 10);
	if (end == arg || *end || isspace((unsigned char)*arg))
		usage_error(t->tool, "option %s: '%s' is not a whole number", shown, arg);
	if (errno == ERANGE || v < INT_MIN || v > INT_MAX)
		usage_error(t->tool, "option %s: '%s' is too large", shown, arg);
	check_range(t, o, shown, (double)v, arg);
	return (int)v;
}

/* Seeds: decimal, or hexadecimal behind 0x. */
static uint64_t parse_u64(const struct table *t, const struct gd_opt *o, const char *shown,
			  const char *arg)
{
	bool hex = arg[0] == '0' && (arg[1] == 'x' || arg[1] == 'X');
	unsigned long long v;
	char *end;

	errno = 0;
	v = strtoull(arg, &end, hex ? 16 : 10);
	if (!isdigit((unsigned char)*arg) || *end)
		usage_error(t->tool, "option %s: '%s' is not a whole number from 0", shown, arg);
	if (errno == ERANGE)
		usage_error(t->tool, "option %s: '%s' is too large", shown, arg);
	check_range(t, o, shown, (double)v, arg);
	return v;
}

static void set_option(const struct table *t, const struct gd_opt *o, bool by_letter,
		       const char *arg)
{
	char shown[80];
	struct gd_list *list;

	option_name(o, by_letter, shown);
	switch (o->kind) {
	case GD_OPT_FLAG:
		*(bool *)o->target = true;
		break;
	case GD_OPT_INT:
		*(int *)o->target = parse_int(t, o, shown, arg);
		break;
	case GD_OPT_DOUBLE:
		*(double *)o->target = parse_double(t, o, shown, arg);
		break;
	case GD_OPT_U64:
		*(uint64_t *)o->target = parse_u64(t, o, shown, arg);
		break;
	case GD_OPT_STRING:
		*(const char **)o->target = arg;
		break;
	case GD_OPT_LIST:
	case GD_OPT_WORDS:
		list = o->target;
		list->v = or_leave(t->tool,
				   realloc(list->v, (size_t)(list->n + 1) * sizeof *list->v));
		list->v[list->n++] = arg;
		break;
	}
}

/* getopt_long() answers '?' for three different mistakes; each gets its own words. */
static void bad_option(const struct table *t, char *const *argv, int answer)
{
	char shown[80];
	const char *word = argv[optind - 1];
	size_t len = strcspn(word, "=");
	int alike = 0;

	if (optopt >= LONG_KEY && answer == ':')
		usage_error(t->tool, "option --%s needs a value: %s",
			    t->opt[optopt - LONG_KEY].name, t->opt[optopt - LONG_KEY].arg);
	if (optopt >= LONG_KEY)
		usage_error(t->tool, "option --%s takes no value", t->opt[optopt - LONG_KEY].name);
	if (optopt) {
		for (int i = 0; answer == ':' && i < t->n; i++)
			if (t->opt[i].key == optopt)
				usage_error(t->tool, "option %s needs a value: %s",
					    option_name(&t->opt[i], true, shown), t->opt[i].arg);
		usage_error(t->tool, "unknown option -%c", optopt);
	}
	for (int i = 0; len > 2 && i < t->n; i++)
		alike += !strncmp(t->opt[i].name, word + 2, len - 2);
	usage_error(t->tool, "%s option %.*s", alike > 1 ? "ambiguous" : "unknown", (int)len, word);
}

static void parse_options(struct table *t, int argc, char **argv)
{
	struct option longs[MAX_OPTS + 1] = { { 0 } };
	char letters[2 * MAX_OPTS + 2] = ":";
	size_t n = 1;
	int c;

	for (int i = 0; i < t->n; i++) {
		longs[i].name = t->opt[i].name;
		longs[i].has_arg = t->opt[i].kind == GD_OPT_FLAG ? no_argument : required_argument;
		longs[i].val = LONG_KEY + i;
		if (t->opt[i].key) {
			letters[n++] = (char)t->opt[i].key;
			if (t->opt[i].kind != GD_OPT_FLAG)
				letters[n++] = ':';
		}
	}
	opterr = 0;
	while ((c = getopt_long(argc, argv, letters, longs, NULL)) != -1) {
		int i = c - LONG_KEY;

		if (c == '?' || c == ':')
			bad_option(t, argv, c);
		if (c < LONG_KEY)
			for (i = 0; t->opt[i].key != c; i++)
				;
		set_option(t, &t->opt[i], c < LONG_KEY, optarg);
		/* a lone "-" is a word: standard input */
		while (t->opt[i].kind == GD_OPT_WORDS && optind < argc &&
		       (argv[optind][0] != '-' || !argv[optind][1]))
			set_option(t, &t->opt[i], c < LONG_KEY, argv[optind++]);
	}
}

static const char *const kinds[] = { "none", "rle", "zips", "zip", "piz" };

static int find_compression(const char *name)
{
	for (int i = 0; i < (int)(sizeof kinds / sizeof *kinds); i++)
		if (!strcmp(name, kinds[i]))
			return i;
	return -1;
}

static void check_operands(struct gd_cli *cli)
{
	const struct gd_cmd *cmd = cli->cmd;

	if (cli->noperand < cmd->min_operands)
		usage_error(cmd->name, "missing operand: %s", cmd->operands);
	if (cmd->max_operands >= 0 && cli->noperand > cmd->max_operands)
		usage_error(cmd->name, "one operand too many: %s", cli->operand[cmd->max_operands]);
	if (!cmd->filter)
		return;
	cli->input = cli->noperand ? cli->operand[0] : "-";
	if (cmd->max_operands >= 0 && cli->noperand > 1) {
		if (cli->output)
			usage_error(cmd->name, "two outputs: %s and -o %s", cli->operand[1],
				    cli->output);
		cli->output = cli->operand[1];
	}
	if (!cli->output)
		cli->output = "-";
	if (cli->compression && find_compression(cli->compression) < 0)
		usage_error(cmd->name,
			    "option --compression: '%s' is none of none, rle, zips, zip, piz",
			    cli->compression);
	if (!strcmp(cli->input, "-") && isatty(STDIN_FILENO))
		usage_error(cmd->name, "no input: standard input is a terminal");
	if (cli->stats && !strcmp(cli->stats, "-") && !strcmp(cli->output, "-"))
		usage_error(cmd->name, "option --stats: standard output is taken by the image");
	if (cli->stats && !strcmp(cli->stats, cli->output) && strcmp(cli->stats, "/dev/null"))
		usage_error(cmd->name, "option --stats: %s is the image", cli->stats);
	if (!strcmp(cli->output, "-") && isatty(STDOUT_FILENO))
		usage_error(cmd->name,
			    "no output: standard output is a terminal; use -o FILE or a pipe");
}

/* The command as it could be typed again; getopt_long() will reorder argv, so this comes first. */
static char *quote_command(const struct gd_cmd *cmd, int argc, char **argv)
{
	static const char plain[] =
		"abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-+=./,:@%";
	size_t size = strlen(cmd->name) + 1;
	char *text, *p;

	for (int i = 1; i < argc; i++)
		size += 4 * strlen(argv[i]) + 3;
	p = text = or_leave(cmd->name, malloc(size));
	p = stpcpy(p, cmd->name);
	for (int i = 1; i < argc; i++) {
		const char *s = argv[i];

		*p++ = ' ';
		if (*s && !s[strspn(s, plain)]) {
			p = stpcpy(p, s);
			continue;
		}
		*p++ = '\'';
		for (; *s; s++) {
			if (*s == '\'')
				p = stpcpy(p, "'\\''");
			else	/* one line a command */
				*p++ = *s == '\n' || *s == '\r' ? ' ' : *s;
		}
		*p++ = '\'';
	}
	*p = 0;
	return text;
}

/* ---- notes and progress ---- */

static void clear_progress(struct gd_cli *cli)
{
	if (cli->progress_shown)
		fprintf(stderr, "\r%*s\r", 70, "");
	cli->progress_shown = false;
}

static void on_note(void *user, const char *text)
{
	struct gd_cli *cli = user;

	if (!cli->verbose)
		return;
	clear_progress(cli);
	fprintf(stderr, "%s: %s\n", cli->cmd->name, text);
}

static void on_warning(void *user, const char *text)
{
	gd_cli_warn(user, "%s", text);
}

static void on_progress(void *user, const char *stage, double done)
{
	struct gd_cli *cli = user;
	double now = gd_seconds();
	char left[32];

	if (!cli->stage || strcmp(stage, cli->stage) || done < cli->stage_done) {
		cli->stage = stage;
		cli->stage_time = now;
		cli->stage_done = done;
	}
	/* only for work of over a second, and ten times a second at most */
	if (cli->quiet || now - cli->start < 1 || now - cli->progress_time < 0.1 ||
	    !isatty(STDERR_FILENO))
		return;
	gd_cli_time_left(left, now - cli->stage_time, done - cli->stage_done, 1 - done);
	fprintf(stderr, "\r%s: %.30s %3.0f %%%-20s", cli->cmd->name, stage, 100 * done, left);
	cli->progress_time = now;
	cli->progress_shown = true;
}

void gd_cli_warn(struct gd_cli *cli, const char *format, ...)
{
	va_list ap;

	if (cli->quiet)
		return;
	clear_progress(cli);
	fprintf(stderr, "%s: warning: ", cli->cmd->name);
	va_start(ap, format);
	vfprintf(stderr, format, ap);
	va_end(ap);
	fputc('\n', stderr);
}

/* ---- the run ---- */

/*
 * Were one of the three standard files closed, the next file opened would take its number and get
 * what is meant for the standard file. A place holder that fails on use keeps the number.
 */
static void hold_standard_files(void)
{
	for (int fd = 0; fd < 3; fd++)
		if (fcntl(fd, F_GETFD) < 0 && errno == EBADF)
			(void)!open("/dev/null", fd == 0 ? O_WRONLY : O_RDONLY);
}

/*
 * Threads that wait for each other sleep rather than spin, unless the user wants it otherwise: on a
 * machine with other work, spinning takes from the very thread that is waited for (measured: a
 * solve of 0.4 s took 11 s). The OpenMP library reads that wish once, before main: so the program
 * starts itself again, in a millisecond.
 */
static void wait_asleep(char **argv)
{
	char path[4096];
	ssize_t n;

	if (getenv("OMP_WAIT_POLICY") || getenv("GOMP_SPINCOUNT"))
		return;
	n = readlink("/proc/self/exe", path, sizeof path - 1);
	if (n <= 0 || setenv("OMP_WAIT_POLICY", "passive", 1) != 0)
		return;
	path[n] = 0;
	execv(path, argv);	/* where that cannot be, threads spin */
}

void gd_cli_parse(struct gd_cli *cli, const struct gd_cmd *cmd, int argc, char **argv)
{
	struct table table = { .tool = cmd->name };

	wait_asleep(argv);
	hold_standard_files();
	signal(SIGPIPE, SIG_IGN);
	cli->cmd = cmd;
	cli->start = gd_seconds();
	cli->argc = argc;
	cli->argv = argv;
	cli->threads = omp_get_max_threads();
	cli->command = quote_command(cmd, argc, argv);
	build_table(&table, cli);
	parse_options(&table, argc, argv);
	if (table.help)
		print_help(&table, cmd);
	if (table.version) {
		printf("%s %s\n", cmd->name, GD_VERSION);
		exit(close_stdout(cmd->name));
	}
	cli->operand = argv + optind;
	cli->noperand = argc - optind;
	check_operands(cli);
	omp_set_dynamic(0);
	omp_set_num_threads(cli->threads);
	cli->report = (struct gd_report){ on_note, on_progress, cli, on_warning };
	gd_cli_stat_text(cli, "tool", cmd->name);
	gd_cli_stat_text(cli, "version", GD_VERSION);
	gd_cli_stat_text(cli, "command", cli->command);
	gd_cli_stat(cli, "threads", cli->threads);
	gd_cli_stat_text(cli, "isa", gd_isa_name());
}

int gd_cli_open(struct gd_cli *cli, struct gd_exr **file, struct gd_image *im, const char *path,
		struct gd_err *err)
{
	const struct gd_read_conf conf = { .part = cli->part };
	double start = gd_seconds();
	int rc;

	*file = NULL;
	if (!strcmp(path, "-") && isatty(STDIN_FILENO))
		return gd_fail(err, GD_EARG, "standard input is a terminal");
	rc = gd_exr_open(file, im, path, &conf, err);
	cli->io_seconds += gd_seconds() - start;
	if (rc == GD_OK)
		gd_note(&cli->report, "%s: %d x %d pixels, %d channels",
			strcmp(path, "-") ? path : "stdin", im->w, im->h, im->nchan);
	return rc;
}

int gd_cli_load(struct gd_cli *cli, struct gd_exr *file, struct gd_image *im, struct gd_err *err)
{
	double start = gd_seconds();
	int rc = gd_exr_load(file, im, err);

	gd_exr_close(file);
	cli->io_seconds += gd_seconds() - start;
	return rc;
}

static int sign(struct gd_cli *cli, struct gd_image *im, struct gd_err *err)
{
	const struct gd_attr *old = gd_attr_find(im, "gd:history");
	size_t n = old && !strcmp(old->type, "string") ? old->size : 0;
	char *text = malloc(n + strlen(cli->command) + 2), key[80];
	double seconds = gd_seconds() - cli->start - cli->io_seconds, before = 0;
	int rc;

	if (!text)
		return gd_fail(err, GD_ENOMEM, "out of memory");
	if (n)
		memcpy(text, old->data, n);
	if (n && text[n - 1] != '\n')
		text[n++] = '\n';
	strcpy(text + n, cli->command);
	rc = gd_attr_set_string(im, "gd:history", text, err);
	free(text);
	if (rc != GD_OK || getenv("SOURCE_DATE_EPOCH"))
		return rc;
	snprintf(key, sizeof key, "gd:seconds.%s", cli->cmd->name);
	if (!gd_attr_number(im, key, &before) || !(before >= 0))
		before = 0;
	return gd_attr_set_number(im, key, before + seconds, err);
}

int gd_cli_write(struct gd_cli *cli, struct gd_image *im, struct gd_err *err)
{
	bool pipe = !strcmp(cli->output, "-");
	int kind = cli->compression ? find_compression(cli->compression) : pipe ? GD_NONE : GD_ZIP;
	const struct gd_write_conf conf = { .compression = (enum gd_compression)kind };
	int rc = sign(cli, im, err);
	double start = gd_seconds();

	clear_progress(cli);
	if (rc == GD_OK)
		rc = gd_exr_write(im, cli->output, &conf, err);
	cli->io_seconds += gd_seconds() - start;
	return rc;
}

/* ---- the end ---- */

void gd_cli_stat(struct gd_cli *cli, const char *name, double value)
{
	if (gd_json_add_number(&cli->figures, name, value) != GD_OK)
		or_leave(cli->cmd->name, NULL);
}

void gd_cli_stat_text(struct gd_cli *cli, const char *name, const char *value)
{
	if (gd_json_add_text(&cli->figures, name, value) != GD_OK)
		or_leave(cli->cmd->name, NULL);
}

static int save_stats(struct gd_cli *cli, int status, const char *message)
{
	struct gd_err err = { 0 };

	gd_cli_stat(cli, "status", status);
	if (*message)
		gd_cli_stat_text(cli, "error", message);
	gd_cli_stat(cli, "seconds", gd_seconds() - cli->start);
	gd_cli_stat(cli, "io_seconds", cli->io_seconds);
	if (gd_json_save(&cli->figures, cli->stats, &err) == GD_OK)
		return status;
	if (status != 2)	/* else its one line has been told */
		fprintf(stderr, "%s: %s\n", cli->cmd->name, err.text);
	return 2;
}

static void release(struct gd_cli *cli)
{
	for (const struct gd_opt *o = cli->cmd->opts; o && o->name; o++)
		if (o->kind == GD_OPT_LIST || o->kind == GD_OPT_WORDS) {
			struct gd_list *list = o->target;

			free(list->v);
			*list = (struct gd_list){ 0 };
		}
	gd_json_free(&cli->figures);
	free(cli->command);
	cli->command = NULL;
}

/* "in.exr: no channel dx.R": the library knows the channel, the command line knows the file. */
static void full_message(const struct gd_cli *cli, int rc, const struct gd_err *err, char *text,
			 size_t size)
{
	const char *input = cli->about ? cli->about : cli->input;
	const char *name = input && strcmp(input, "-") ? input : "stdin";
	bool prefix = cli->cmd->filter && cli->cmd->max_operands >= 0 &&
		(rc == GD_ESHAPE || rc == GD_ENUMERIC) && strncmp(err->text, name, strlen(name));

	snprintf(text, size, "%s%s%s", prefix ? name : "", prefix ? ": " : "", err->text);
}

int gd_cli_finish(struct gd_cli *cli, int rc, const struct gd_err *err)
{
	const char *tool = cli->cmd->name;
	char text[1024] = "";
	int status = rc != GD_OK ? 2 : cli->limit_missed ? 1 : 0;

	clear_progress(cli);
	if (rc != GD_OK && err)
		full_message(cli, rc, err, text, sizeof text);
	if (rc != GD_OK && !(err && err->code != GD_OK && !*err->text))
		fprintf(stderr, "%s: %s\n", tool, *text ? text : "failed");
	if (close_stdout(tool))
		status = 2;
	gd_note(&cli->report, "%.3f s in all, %.3f s of it reading and writing; %d threads, %s",
		gd_seconds() - cli->start, cli->io_seconds, cli->threads, gd_isa_name());
	if (cli->stats)
		status = save_stats(cli, status, text);
	release(cli);
	return status;
}
