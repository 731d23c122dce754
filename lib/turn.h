/* SPDX-License-Identifier: BSD-3-Clause */
/*
 * Threads of one parallel loop that take turns in the order of its iterations, for the part that
 * must be serial (reading from or writing to a stream). It sleeps where "omp ordered" would spin:
 * the other end of a pipe needs that processor. The loop must hand its iterations out in increasing
 * order, one at a time: schedule(monotonic : dynamic, 1).
 */
#ifndef GD_TURN_H
#define GD_TURN_H

#include <pthread.h>

struct gd_turn {
	pthread_mutex_t lock;
	pthread_cond_t moved;
	int next;
};

#define GD_TURN_START { PTHREAD_MUTEX_INITIALIZER, PTHREAD_COND_INITIALIZER, 0 }

/* Waits until all iterations before i have passed. */
static inline void gd_turn_wait(struct gd_turn *t, int i)
{
	pthread_mutex_lock(&t->lock);
	while (t->next != i)
		pthread_cond_wait(&t->moved, &t->lock);
	pthread_mutex_unlock(&t->lock);
}

/* Every iteration passes exactly once, whether it failed or not. */
static inline void gd_turn_pass(struct gd_turn *t)
{
	pthread_mutex_lock(&t->lock);
	t->next++;
	pthread_cond_broadcast(&t->moved);
	pthread_mutex_unlock(&t->lock);
}

#endif
