/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Writing: what comes back is what went in, for every thread count, and failures leave nothing
 * behind.
 */
#include "exr_make.h"

#include <omp.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/wait.h>

static char *temp_dir;

static int setup(void **state)
{
	(void)state;
	signal(SIGPIPE, SIG_IGN);
	signal(SIGXFSZ, SIG_IGN);
	temp_dir = enter_temp();
	return 0;
}

static int teardown(void **state)
{
	(void)state;
	return leave_temp(temp_dir);
}

/* Any bits at all: uints, halves and floats with NaN, Inf and denormals among them. */
static void random_image(struct gd_image *im, int w, int h, uint32_t seed)
{
	static const struct {
		const char *name;
		enum gd_type type;
	} list[] = {
		{"crypto00.R", GD_FLOAT}, {"objectId", GD_UINT}, {"N.X", GD_HALF}, {"A", GD_HALF}};
	uint32_t *v = malloc((size_t)w * (size_t)h * sizeof(*v));

	gd_image_init(im, w, h);
	for (size_t c = 0; c < 4; c++) {
		for (int i = 0; i < w * h; i++)
			v[i] = make_hash(seed + (uint32_t)c * 1000003u +
					 (uint32_t)(i % 5 ? i : i / 64));
		add_raw(im, list[c].name, list[c].type, v);
	}
	free(v);
}

static void assert_same_image(const struct gd_image *a, const struct gd_image *b)
{
	assert_int_equal(a->nchan, b->nchan);
	assert_true(a->w == b->w && a->h == b->h);
	assert_memory_equal(&a->data, &b->data, sizeof a->data);
	assert_memory_equal(&a->display, &b->display, sizeof a->display);
	for (int c = 0; c < a->nchan; c++) {
		int i = gd_image_find(b, a->chan[c].name);
		assert_true(i >= 0);
		assert_int_equal(a->chan[c].type, b->chan[i].type);
		assert_memory_equal(a->chan[c].raw, b->chan[i].raw,
				    (size_t)a->w * (size_t)a->h *
					    (a->chan[c].type == GD_HALF ? 2u : 4u));
	}
}

static void write_ok(const struct gd_image *im, const char *path, enum gd_compression k)
{
	struct gd_write_conf conf = { k };
	struct gd_err err = { 0 };

	if (gd_exr_write(im, path, &conf, &err) != GD_OK)
		fail_msg("%s", err.text);
}

static void test_round_trip(void **state)
{
	static const int size[][2] = { { 1, 1 }, { 1, 100 }, { 100, 1 }, { 61, 67 }, { 1031, 3 } };

	(void)state;
	for (int k = GD_NONE; k <= GD_PIZ; k++)
		for (size_t s = 0; s < 5; s++) {
			struct gd_image im, back;
			random_image(&im, size[s][0], size[s][1], (uint32_t)s);
			im.data = (struct gd_box){ -3, 7, im.w - 4, im.h + 6 };
			im.display = (struct gd_box){ -10, -10, 2000, 30 };
			write_ok(&im, "a.exr", (enum gd_compression)k);
			read_ok(&back, "a.exr", 0, GD_PASS);
			assert_same_image(&im, &back);
			gd_image_free(&back);
			gd_image_free(&im);
		}
}

/* What the tools compute is written as float, whatever type it was read as. */
static void test_computed(void **state)
{
	struct gd_image im, back;
	struct gd_err err = { 0 };
	struct gd_plane p;

	(void)state;
	random_image(&im, 33, 9, 1);
	assert_int_equal(gd_image_add(&im, "A", &p, &err), GD_OK);
	for (int y = 0; y < 9; y++)
		for (int x = 0; x < 33; x++)
			gd_row(p, y)[x] = 1.0f / (float)(1 + x + 33 * y);
	assert_int_equal(gd_image_append(&im, "no pixels", GD_HALF, &err), GD_OK);
	im.chan[0].want = GD_DROP;
	write_ok(&im, "a.exr", GD_ZIP);
	read_ok(&back, "a.exr", 0, GD_READ);
	assert_int_equal(back.nchan, 3);
	int i = gd_image_find(&back, "A");
	assert_int_equal(back.chan[i].type, GD_FLOAT);
	assert_memory_equal(back.chan[i].v, p.v, 9 * p.stride * sizeof(float));
	gd_image_free(&back);
	gd_image_free(&im);
}

static uint32_t version_of(const char *path)
{
	uint32_t head[2];
	int fd = open(path, O_RDONLY);

	assert_int_equal(read(fd, head, sizeof head), sizeof head);
	close(fd);
	return head[1];
}

static void test_names(void **state)
{
	static const char *const name[] = {
		"ViewLayer.Denoising Albedo.R",
		"ViewLayer.a layer with spaces, and more than thirty-one bytes.G", "",
		"\xc3\xa9t\xc3\xa9.B"};
	char longest[258];
	struct gd_image im, back;
	struct gd_err err = { 0 };
	float pixel = 2;

	(void)state;
	memset(longest, 'x', sizeof longest);
	longest[255] = '\0';
	gd_image_init(&im, 1, 1);
	add_raw(&im, name[0], GD_FLOAT, &pixel);
	add_raw(&im, name[3], GD_FLOAT, &pixel);
	write_ok(&im, "short.exr", GD_NONE);
	assert_int_equal(version_of("short.exr"), 2);
	add_raw(&im, name[1], GD_FLOAT, &pixel);
	add_raw(&im, longest, GD_FLOAT, &pixel);
	write_ok(&im, "long.exr", GD_NONE);
	assert_int_equal(version_of("long.exr"), 0x402);
	read_ok(&back, "long.exr", 0, GD_PASS);
	assert_same_image(&im, &back);
	gd_image_free(&back);
	longest[255] = 'x';
	longest[256] = '\0';
	add_raw(&im, longest, GD_FLOAT, &pixel);
	assert_int_equal(gd_exr_write(&im, "toolong.exr", NULL, &err), GD_ESHAPE);
	assert_int_not_equal(access("toolong.exr", F_OK), 0);
	gd_image_free(&im);
}

static void test_many_channels(void **state)
{
	struct gd_image im, back;
	uint16_t pixel[6];
	char name[32];

	(void)state;
	gd_image_init(&im, 3, 2);
	for (int c = 0; c < 1000; c++) {
		snprintf(name, sizeof name, "layer%d.R", c);	/* not in the order of the file */
		for (int i = 0; i < 6; i++)
			pixel[i] = (uint16_t)(c * 6 + i);
		add_raw(&im, name, GD_HALF, pixel);
	}
	write_ok(&im, "many.exr", GD_ZIP);
	read_ok(&back, "many.exr", 0, GD_PASS);
	assert_same_image(&im, &back);
	gd_image_free(&back);
	gd_image_free(&im);
}

/*
 * A deflated chunk that happens to be exactly as long as the raw one: the library's writer stores
 * it deflated, and every reader takes it as it is. Rows that compress by a hair (noise after some
 * zeros) are where that happens.
 */
static void test_equal_size(void **state)
{
	(void)state;
	for (int w = 12; w < 44; w++) {
		struct gd_image im, back;
		int h = 400;
		uint32_t *v = malloc((size_t)w * (size_t)h * sizeof(*v));
		for (int i = 0; i < w * h; i++)
			v[i] = i % w < i / w % w ? 0 : make_hash((uint32_t)(i + 977 * w));
		gd_image_init(&im, w, h);
		add_raw(&im, "id", GD_UINT, v);
		write_ok(&im, "equal.exr", GD_ZIPS);
		read_ok(&back, "equal.exr", 0, GD_PASS);
		assert_same_image(&im, &back);
		gd_image_free(&back);
		write_ok(&im, "equal.exr", GD_ZIP);
		read_ok(&back, "equal.exr", 0, GD_PASS);
		assert_same_image(&im, &back);
		gd_image_free(&back);
		gd_image_free(&im);
		free(v);
	}
}

static void test_threads(void **state)
{
	static const int count[] = { 2, 7 };
	struct gd_image im, back;
	char path[32];

	(void)state;
	random_image(&im, 301, 203, 5);
	for (int k = GD_NONE; k <= GD_PIZ; k++) {
		omp_set_num_threads(1);
		write_ok(&im, "1.exr", (enum gd_compression)k);
		for (int t = 0; t < 2; t++) {
			omp_set_num_threads(count[t]);
			snprintf(path, sizeof path, "%d.exr", count[t]);
			write_ok(&im, path, (enum gd_compression)k);
			assert_true(same_files("1.exr", path));
			read_ok(&back, path, 0, GD_PASS);
			assert_same_image(&im, &back);
			gd_image_free(&back);
		}
	}
	omp_set_num_threads(2);
	gd_image_free(&im);
}

/* Standard output gets the bytes that a file gets, through a pipe or into a file. */
static void test_stdout(void **state)
{
	struct gd_image im;

	(void)state;
	random_image(&im, 201, 103, 6);
	for (int k = GD_NONE; k <= GD_PIZ; k++) {
		int keep = dup(1);
		write_ok(&im, "file.exr", (enum gd_compression)k);
		FILE *p = popen("cat > piped.exr", "w");
		dup2(fileno(p), 1);
		write_ok(&im, "-", (enum gd_compression)k);
		dup2(keep, 1);
		pclose(p);
		int fd = open("direct.exr", O_WRONLY | O_CREAT | O_TRUNC, 0666);
		dup2(fd, 1);
		write_ok(&im, "-", (enum gd_compression)k);
		dup2(keep, 1);
		close(fd);
		close(keep);
		assert_true(same_files("file.exr", "piped.exr"));
		assert_true(same_files("file.exr", "direct.exr"));
	}
	gd_image_free(&im);
}

static void test_output_is_input(void **state)
{
	struct gd_image im, back;
	struct stat st;

	(void)state;
	random_image(&im, 64, 64, 7);
	write_ok(&im, "same.exr", GD_ZIP);
	assert_int_equal(chmod("same.exr", 0640), 0);
	assert_int_equal(symlink("same.exr", "link.exr"), 0);
	read_ok(&back, "link.exr", 0, GD_PASS);
	write_ok(&back, "link.exr", GD_NONE);
	gd_image_free(&back);
	assert_int_equal(lstat("link.exr", &st), 0);
	assert_true(S_ISLNK(st.st_mode));
	assert_int_equal(stat("same.exr", &st), 0);
	assert_int_equal(st.st_mode & 0777, 0640);
	read_ok(&back, "same.exr", 0, GD_PASS);
	assert_same_image(&im, &back);
	gd_image_free(&back);
	gd_image_free(&im);
}

static void expect_failure(const struct gd_image *im, const char *path, enum gd_compression k,
			   const char *text)
{
	struct gd_write_conf conf = { k };
	struct gd_err err = { 0 };

	assert_int_equal(gd_exr_write(im, path, &conf, &err), GD_EIO);
	assert_int_equal(err.code, GD_EIO);
	assert_string_equal(err.text, text);
}

/* A write that fails half way leaves the old file and nothing else. */
static void test_full_disk(void **state)
{
	struct rlimit limit, small;
	struct gd_image im;

	(void)state;
	random_image(&im, 128, 128, 8);
	spill_file("old.exr", "old", 3);
	int before = count_files();
	getrlimit(RLIMIT_FSIZE, &limit);
	small = limit;
	small.rlim_cur = 20000;
	for (int k = GD_NONE; k <= GD_PIZ; k++) {
		setrlimit(RLIMIT_FSIZE, &small);
		expect_failure(&im, "old.exr", (enum gd_compression)k, "old.exr: File too large");
		expect_failure(&im, "new.exr", (enum gd_compression)k, "new.exr: File too large");
		setrlimit(RLIMIT_FSIZE, &limit);
		assert_int_equal(count_files(), before);
		size_t n;
		unsigned char *v = slurp_file("old.exr", &n);
		assert_true(n == 3 && memcmp(v, "old", 3) == 0);
		free(v);
	}
	gd_image_free(&im);
}

static void test_bad_paths(void **state)
{
	struct gd_image im, none = { 0 };
	struct gd_err err = { 0 };

	(void)state;
	random_image(&im, 128, 128, 9);
	int before = count_files();
	for (int k = GD_NONE; k <= GD_ZIP; k += GD_ZIP) {
		expect_failure(&im, "/dev/full", (enum gd_compression)k,
			       "/dev/full: No space left on device");
		expect_failure(&im, "no/such/a.exr", (enum gd_compression)k,
			       "no/such/a.exr: No such file or directory");
		expect_failure(&im, ".", (enum gd_compression)k, ".: Is a directory");
		write_ok(&im, "/dev/null", (enum gd_compression)k);
	}
	gd_image_init(&none, 4, 4);
	assert_int_equal(gd_exr_write(&none, "none.exr", NULL, &err), GD_ESHAPE);
	assert_string_equal(err.text, "none.exr: no channel to write");
	assert_int_equal(count_files(), before);
	gd_image_free(&im);
}

/* A reader that goes away ends the writing without a word. */
static void test_broken_pipe(void **state)
{
	struct gd_image im;

	(void)state;
	random_image(&im, 700, 700, 10);
	for (int k = GD_NONE; k <= GD_RLE; k++) {
		int keep = dup(1), end[2];
		assert_int_equal(pipe(end), 0);
		close(end[0]);
		dup2(end[1], 1);
		struct gd_write_conf conf = { (enum gd_compression)k };
		struct gd_err err = { 0 };
		int rc = gd_exr_write(&im, "-", &conf, &err);
		dup2(keep, 1);
		close(keep);
		close(end[1]);
		assert_int_equal(rc, GD_EIO);
		assert_int_equal(err.code, GD_EIO);
		assert_string_equal(err.text, "");
	}
	gd_image_free(&im);
}

static void test_fifo(void **state)
{
	struct gd_image im;

	(void)state;
	random_image(&im, 300, 100, 11);
	write_ok(&im, "plain.exr", GD_NONE);
	assert_int_equal(mkfifo("fifo", 0600), 0);
	pid_t child = fork();
	if (child == 0)
		_exit(system("cat fifo > through.exr") ? 1 : 0);
	write_ok(&im, "fifo", GD_NONE);
	int status;
	waitpid(child, &status, 0);
	assert_true(same_files("plain.exr", "through.exr"));
	gd_image_free(&im);
}

/* Killed at any moment: the old file or the new one, and nothing else. */
static void test_killed(void **state)
{
	struct gd_image im, old, back;

	(void)state;
	random_image(&im, 900, 700, 12);
	random_image(&old, 90, 70, 13);
	for (int i = 0; i < 12; i++) {
		write_ok(&old, "kill.exr", GD_NONE);
		int before = count_files();
		pid_t child = fork();
		if (child == 0) {
			omp_set_num_threads(1);	/* the pool of threads is not there after fork */
			struct gd_write_conf conf = { GD_NONE };
			gd_exr_write(&im, "kill.exr", &conf, NULL);
			_exit(0);
		}
		usleep((useconds_t)(i * 1000));
		kill(child, SIGKILL);
		waitpid(child, NULL, 0);
		read_ok(&back, "kill.exr", 0, GD_PASS);
		assert_same_image(&back, back.w == im.w ? &im : &old);
		gd_image_free(&back);
		assert_in_range(count_files(), before, before + 1);
		(void)!system("rm -f .gd-*.tmp");
	}
	gd_image_free(&im);
	gd_image_free(&old);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_round_trip),    cmocka_unit_test(test_computed),
		cmocka_unit_test(test_names),	      cmocka_unit_test(test_many_channels),
		cmocka_unit_test(test_equal_size),    cmocka_unit_test(test_threads),
		cmocka_unit_test(test_stdout),	      cmocka_unit_test(test_output_is_input),
		cmocka_unit_test(test_full_disk),     cmocka_unit_test(test_bad_paths),
		cmocka_unit_test(test_broken_pipe),   cmocka_unit_test(test_fifo),
		cmocka_unit_test(test_killed),
	};

	return cmocka_run_group_tests(tests, setup, teardown);
}
