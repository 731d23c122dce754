/* SPDX-License-Identifier: BSD-3-Clause */
/* The command line, in a child process for each case: what it says, what it sets, how it leaves. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <sys/wait.h>

#include "../../lib/cli.c"	/* belongs to the tools, not to the library */

#define MAXARG 12

struct outcome {
	int status;
	char out[8192], err[4096];
};

/* A tool that prints what it was told; --fail and --miss end it in the other two ways. */
static int tool(int argc, char **argv)
{
	double alpha = 0.2;
	int cycles = 3;
	uint64_t seed = 7;
	struct gd_list map = { 0 }, words = { 0 };
	bool keep = false, fail = false, miss = false, gone = false;
	const char *method = "l1", *none = NULL;
	const struct gd_opt opts[] = {
		GD_NUM('a', "alpha", "WEIGHT", &alpha, 0, 1e6, "weight of the primal image"),
		GD_NUM(0, "cycles", "N", &cycles, 1, 1000, "cycles"),
		GD_OPT('s', "seed", "N", &seed, "seed"),
		GD_OPT('m', "method", "NAME", &method, "method"),
		GD_OPT(0, "map", "A=B", &map, "map"),
		GD_WORDS('w', "words", "FILE...", &words, "words"),
		GD_OPT(0, "none", "X", &none, "nothing by default"),
		GD_FLAG('k', "keep", &keep, "keep all"),
		GD_FLAG(0, "fail", &fail, "fail"),
		GD_FLAG(0, "miss", &miss, "miss"),
		GD_FLAG(0, "gone", &gone, "gone"),
		GD_OPT_END
	};
	const struct gd_cmd cmd = {
		"gdtest", "[in.exr [out.exr]]", "try the command line", opts, 0, 2, true};
	struct gd_cli cli = { 0 };
	struct gd_err err = { 0 };
	int rc = GD_OK;

	gd_cli_parse(&cli, &cmd, argc, argv);
	printf("%g %d %llu %s %d %d %s %s %d\n", alpha, cycles, (unsigned long long)seed, method,
	       keep, map.n, cli.input, cli.output, cli.threads);
	for (int i = 0; i < words.n; i++)
		printf("%s%s", words.v[i], i + 1 < words.n ? " " : "\n");
	gd_note(&cli.report, "a note of %d words", 4);
	gd_cli_warn(&cli, "a warning");
	gd_cli_stat(&cli, "residual", 0.25);
	cli.limit_missed = miss;
	if (fail)
		rc = gd_fail(&err, GD_ESHAPE, "no channel dx.R");
	if (gone)
		rc = gd_fail(&err, GD_EIO, "%s", "");
	return gd_cli_finish(&cli, rc, &err);
}

static void slurp(FILE *f, char *text, size_t size)
{
	rewind(f);
	text[fread(text, 1, size - 1, f)] = 0;
	fclose(f);
}

static struct outcome run(const char *first, ...)
{
	char *argv[MAXARG + 2] = { "gdtest", NULL };
	struct outcome o = { 0 };
	FILE *out = tmpfile(), *err = tmpfile();
	int argc = 1, status;
	va_list ap;
	pid_t pid;

	va_start(ap, first);
	for (const char *s = first; s && argc <= MAXARG; s = va_arg(ap, const char *))
		argv[argc++] = strdup(s);
	va_end(ap);
	fflush(NULL);
	pid = fork();
	if (!pid) {
		int null = open("/dev/null", O_RDONLY);

		dup2(null, 0);
		dup2(fileno(out), 1);
		dup2(fileno(err), 2);
		status = tool(argc, argv);
		fflush(NULL);
		_exit(status);
	}
	waitpid(pid, &status, 0);
	o.status = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
	slurp(out, o.out, sizeof o.out);
	slurp(err, o.err, sizeof o.err);
	while (argc > 1)
		free(argv[--argc]);
	return o;
}

static void expect_out(struct outcome o, const char *out)
{
	if (o.status || strcmp(o.out, out))
		fail_msg("status %d, '%s', '%s'; expected '%s'", o.status, o.out, o.err, out);
}

static void test_values(void **state)
{
	(void)state;
	expect_out(run("-j3", NULL), "0.2 3 7 l1 0 0 - - 3\n");
	expect_out(run("in.exr", "--alpha=1e-3", "out.exr", "-k", "-j", "1", NULL),
		   "0.001 3 7 l1 1 0 in.exr out.exr 1\n");
	expect_out(run("-s", "0xff", "--cyc", "1000", "-j1", "--map", "a=b", "--map=c", "-", "-",
		       NULL),
		   "0.2 1000 255 l1 0 2 - - 1\n");
	expect_out(run("-j1", "-o", "b", "--", "-k", NULL), "0.2 3 7 l1 0 0 -k b 1\n");
	expect_out(run("-a", "0", "-m", "wls", "-j1", NULL), "0 3 7 wls 0 0 - - 1\n");
}

/* A list of words ends at the next option, at "--" or
 * at the end; operands may stand anywhere else. */
static void test_words(void **state)
{
	(void)state;
	expect_out(run("in", "out", "-j1", "--words", "a", "b", "c", NULL),
		   "0.2 3 7 l1 0 0 in out 1\na b c\n");
	expect_out(run("in", "--words", "a", "b", "-j1", "out", NULL),
		   "0.2 3 7 l1 0 0 in out 1\na b\n");
	expect_out(run("--words=a", "b", "-", "-w", "c", "-wd", "e", "-j1", "in", NULL),
		   "0.2 3 7 l1 0 0 in - 1\na b - c d e\n");
	expect_out(run("-j1", "in", "--words", "a", "b", "--", "-out", NULL),
		   "0.2 3 7 l1 0 0 in -out 1\na b\n");
	expect_out(run("in", "-w", "a", "-k", "-j1", "-m", "x", "--words", "b", "--", NULL),
		   "0.2 3 7 x 1 0 in - 1\na b\n");
}

static void test_usage_errors_name_the_option(void **state)
{
	static const struct { const char *a, *b, *c, *message;
	} bad[] = {
		{"-a", "-1", NULL, "option -a: -1 is not in 0 to 1000000"},
		{"--alpha", "nan", NULL, "option --alpha: 'nan' is not a number"},
		{"--alpha", "1x", NULL, "option --alpha: '1x' is not a number"},
		{"--alpha", "", NULL, "option --alpha: '' is not a number"},
		{"--alpha", " 1", NULL, "option --alpha: ' 1' is not a number"},
		{"--alpha", "1e999", NULL, "option --alpha: '1e999' is too large"},
		{"--alpha", NULL, NULL, "option --alpha needs a value: WEIGHT"},
		{"-a", NULL, NULL, "option -a needs a value: WEIGHT"},
		{"--cycles", "2.5", NULL, "option --cycles: '2.5' is not a whole number"},
		{"--cycles=0", NULL, NULL, "option --cycles: 0 is not in 1 to 1000"},
		{"--cycles", "99999999999", NULL, "option --cycles: '99999999999' is too large"},
		{"-s", "-1", NULL, "option -s: '-1' is not a whole number from 0"},
		{"-s", "99999999999999999999", NULL,
		 "option -s: '99999999999999999999' is too large"},
		{"--keep=yes", NULL, NULL, "option --keep takes no value"},
		{"--nosuch", NULL, NULL, "unknown option --nosuch"},
		{"--nosuch=3", NULL, NULL, "unknown option --nosuch"},
		{"-Z", NULL, NULL, "unknown option -Z"},
		{"--m", "x", NULL, "ambiguous option --m"},
		{"a", "b", "c", "one operand too many: c"},
		{"a", "b", "-oc", "two outputs: b and -o c"},
		{"--compression", "dwaa", NULL,
		 "option --compression: 'dwaa' is none of none, rle, zips, zip, piz"},
		{"-j", "0", NULL, "option -j: 0 is not in 1 to 1024"},
	};

	(void)state;
	for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
		struct outcome o = run(bad[i].a, bad[i].b, bad[i].c, NULL);
		char line[300];

		snprintf(line, sizeof line, "gdtest: %s (gdtest -h lists the options)\n",
			 bad[i].message);
		assert_int_equal(o.status, 2);
		assert_string_equal(o.err, line);
		assert_string_equal(o.out, "");
	}
}

static void test_help_tells_the_defaults(void **state)
{
	struct outcome o = run("--alpha=5", "-h", NULL);

	(void)state;
	assert_int_equal(o.status, 0);
	assert_string_equal(o.err, "");
	assert_non_null(strstr(
		o.out, "usage: gdtest [options] [in.exr [out.exr]]\ntry the command line\n"));
	assert_non_null(strstr(o.out, "  -a, --alpha WEIGHT          weight of the primal image (0 "
				      "to 1000000, default 0.2)\n"));
	assert_non_null(strstr(o.out, "  -m, --method NAME           method (default l1)\n"));
	assert_non_null(strstr(o.out, "      --none X                nothing by default\n"));
	assert_non_null(strstr(o.out, "      --version "));
	o = run("--version", NULL);
	assert_int_equal(o.status, 0);
	assert_string_equal(o.out, "gdtest " GD_VERSION "\n");
}

static void test_how_it_ends(void **state)
{
	struct outcome o = run("--fail", "in.exr", "out.exr", NULL);

	(void)state;
	assert_int_equal(o.status, 2);
	assert_string_equal(o.err, "gdtest: warning: a warning\ngdtest: in.exr: no channel dx.R\n");
	o = run("--fail", "-q", NULL);
	assert_string_equal(o.err, "gdtest: stdin: no channel dx.R\n");
	o = run("--miss", "-q", NULL);
	assert_int_equal(o.status, 1);
	assert_string_equal(o.err, "");
	o = run("--gone", "-q", NULL);	/* a reader that has left is no news */
	assert_int_equal(o.status, 2);
	assert_string_equal(o.err, "");
	o = run("-v", NULL);
	assert_int_equal(o.status, 0);
	assert_non_null(strstr(o.err, "gdtest: a note of 4 words\n"));
}

static void test_stats(void **state)
{
	char path[] = "/tmp/gd-stats-XXXXXX", text[2000];
	int fd = mkstemp(path);
	struct outcome o = run("-q", "-j2", "--fail", "it's", "out", "--stats", path, NULL);

	(void)state;
	close(fd);
	assert_int_equal(o.status, 2);
	slurp(fopen(path, "r"), text, sizeof text);
	unlink(path);
	assert_non_null(strstr(text, "{\"tool\": \"gdtest\", \"version\": \"" GD_VERSION "\", "));
	assert_non_null(strstr(
		text,
		"\"command\": \"gdtest -q -j2 --fail 'it'\\\\''s' out --stats /tmp/gd-stats-"));
	assert_non_null(strstr(text, "\"threads\": 2, "));
	assert_non_null(strstr(text, "\"residual\": 0.25, \"status\": 2, \"error\": \"it's: no "
				     "channel dx.R\", \"seconds\": "));
	o = run("-q", "--stats", "/nowhere/x.json", NULL);
	assert_int_equal(o.status, 2);
	assert_string_equal(o.err, "gdtest: /nowhere/x.json: No such file or directory\n");
}

int main(void)
{
	setenv("OMP_WAIT_POLICY", "passive", 0); /* or the command line starts this program again */
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_values), cmocka_unit_test(test_words),
		cmocka_unit_test(test_usage_errors_name_the_option),
		cmocka_unit_test(test_help_tells_the_defaults), cmocka_unit_test(test_how_it_ends),
		cmocka_unit_test(test_stats),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
