/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Runs a command several times with its output thrown away, and prints a line
 *	LABEL <TAB> median wall seconds <TAB> median CPU seconds <TAB> peak memory in MB
 *	measure LABEL RUNS COMMAND...
 */
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "gd.h"

static int by_value(const void *a, const void *b)
{
	const double x = *(const double *)a, y = *(const double *)b;

	return (x > y) - (x < y);
}

static double seconds(struct timeval t)
{
	return (double)t.tv_sec + 1e-6 * (double)t.tv_usec;
}

int main(int argc, char **argv)
{
	const int runs = argc > 3 ? atoi(argv[2]) : 0;
	double *wall, *cpu, peak = 0;

	if (runs < 1)
		return fprintf(stderr, "usage: measure LABEL RUNS COMMAND...\n"), 2;
	wall = calloc((size_t)runs, sizeof *wall);
	cpu = calloc((size_t)runs, sizeof *cpu);
	for (int i = 0; i < runs && wall && cpu; i++) {
		const double start = gd_seconds();
		struct rusage use;
		int status;
		pid_t pid = fork();

		if (!pid) {
			dup2(open("/dev/null", O_WRONLY), 1);
			execvp(argv[3], argv + 3);
			perror(argv[3]);
			_exit(127);
		}
		if (pid < 0 || wait4(pid, &status, 0, &use) != pid || !WIFEXITED(status) ||
		    WEXITSTATUS(status) > 1)
			return fprintf(stderr, "measure: %s: failed\n", argv[1]), 2;
		wall[i] = gd_seconds() - start;
		cpu[i] = seconds(use.ru_utime) + seconds(use.ru_stime);
		peak = (double)use.ru_maxrss > peak ? (double)use.ru_maxrss : peak;
	}
	qsort(wall, (size_t)runs, sizeof *wall, by_value);
	qsort(cpu, (size_t)runs, sizeof *cpu, by_value);
	printf("%s\t%.4f\t%.4f\t%.1f\n", argv[1], wall[runs / 2], cpu[runs / 2], peak / 1024);
	free(wall);
	free(cpu);
	return 0;
}
