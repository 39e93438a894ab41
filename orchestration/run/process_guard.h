/* The process guard, a part of loop.c, which defines EXPORT and the members of the report: what an FMU changes in the
   process that it runs in, beside its own state. Read process_guard.py first. */

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#if !defined(_WIN32) && !defined(__wasm__)
#define CAN_FORK
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <pthread.h>
#include <unistd.h>
#endif
#if defined(__x86_64__)
#include <xmmintrin.h>
#endif

enum { TEXT_SIZE = 256, EXIT_STATUS = 70, MOST_RUNS = 256, LONGEST_WAIT_MS = 5000 };

/* Runs stand in a table: the address of the report, 0 if there is none, and that of a text for each component. It is
   here, since it is read when Python's memory is gone. */

static volatile intptr_t runs[MOST_RUNS][2];

/* A run in which an FMU is busy; MOST_RUNS if there is none. */
static int64_t busy_run(void) {
    int64_t i = 0;
    while (i < MOST_RUNS && !(runs[i][0] && ((const int64_t *)runs[i][0])[BUSY])) i++;
    return i;
}

/* A child that an FMU forks in a call, and that returns from it, would go on with the run, and write into the memory
   that both processes share. It ends as soon as it returns. Before the fork a pipe is made, for the present call of this
   thread: a child that returns writes into it, and one that calls _exit or exec closes it. So the parent, at the end of
   its call, learns which of both each child does; one that does neither for a while goes on without harm. */

#ifdef CAN_FORK
static __thread int calls_fmus, has_pipe, is_fork, ends[2];

static void note_fork(void) {
    if (!calls_fmus || has_pipe || busy_run() == MOST_RUNS || pipe(ends)) return;
    for (int i = 0; i < 2; i++) fcntl(ends[i], F_SETFD, FD_CLOEXEC);
    has_pipe = 1;
}

static void note_child(void) { is_fork = calls_fmus && busy_run() < MOST_RUNS; }

/* Ends a child; whether one has returned from the call of the parent. */
static int child_returned(void) {
    struct pollfd end = {ends[0], POLLIN, 0};
    char byte;
    int status;
    if (is_fork) _Exit(write(ends[1], "", 1) == 1 ? EXIT_STATUS : EXIT_FAILURE);
    close(ends[1]);
    do status = poll(&end, 1, LONGEST_WAIT_MS);
    while (status < 0 && errno == EINTR);
    status = status > 0 && read(ends[0], &byte, 1) == 1;
    close(ends[0]);
    has_pipe = 0;
    return status;
}
#endif

/* Called by each thread before it calls FMUs: a process that others than FMUs have forked makes runs of its own. */
EXPORT void guard_forget_forks(void) {
#ifdef CAN_FORK
    if (has_pipe) close(ends[0]), close(ends[1]);
    calls_fmus = 1;
    is_fork = has_pipe = 0;
#endif
}

/* The floating-point mode, rounding and denormals, is that of before the first FMU. On x86-64 there are two: of SSE,
   and of the older unit, which computes in long double and by which the C library rounds the numbers that it prints.
   Processors that are not named keep theirs. */

static uint64_t float_mode;

static uint64_t get_float_mode(void) {
#if defined(__x86_64__)
    uint16_t older;
    __asm__ volatile("fnstcw %0" : "=m"(older));
    return (uint64_t)older << 32 | (_mm_getcsr() & ~(uint32_t)_MM_EXCEPT_MASK);
#elif defined(__aarch64__)
    uint64_t mode;
    __asm__ volatile("mrs %0, fpcr" : "=r"(mode));
    return mode;
#else
    return 0;
#endif
}

/* Called after each call of an FMU: whether it changed the mode; notes in the report whether it forked. */
EXPORT int guard_end_call(int64_t *report) {
#ifdef CAN_FORK
    if (is_fork || has_pipe) report[FORKED] |= child_returned();
#endif
    if (get_float_mode() == float_mode) return 0;
#if defined(__x86_64__)
    const uint16_t older = (uint16_t)(float_mode >> 32);
    __asm__ volatile("fldcw %0" : : "m"(older));
    _mm_setcsr((uint32_t)float_mode);
#elif defined(__aarch64__)
    __asm__ volatile("msr fpcr, %0" : : "r"(float_mode));
#endif
    return 1;
}

/* An FMU that calls exit ends the process with status 70 and its text. */

static void report_exit(void) {
    const int64_t run = busy_run();
    if (run == MOST_RUNS) return;
    fputs((const char *)runs[run][1] + TEXT_SIZE * (llabs(((const int64_t *)runs[run][0])[BUSY]) - 1), stderr);
    fflush(stderr);
    _Exit(EXIT_STATUS);
}

/* The table, of MOST_RUNS rows; called once, before the first FMU is loaded. */
EXPORT volatile intptr_t *guard_runs(void) {
    float_mode = get_float_mode();
    atexit(report_exit);
#ifdef CAN_FORK
    pthread_atfork(note_fork, NULL, note_child);
#endif
    return runs[0];
}
