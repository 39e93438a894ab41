/* The process guard, a part of loop.c, which defines EXPORT and the members of the report: what an FMU changes in the
   process that it runs in, beside its own state. Read process_guard.py first. */

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#if !defined(_WIN32) && !defined(__wasm__)
#define CAN_FORK
#include <pthread.h>
#endif
#if defined(__x86_64__)
#include <xmmintrin.h>
#endif

enum { TEXT_SIZE = 256, EXIT_STATUS = 70, MOST_RUNS = 256 };

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
   that both processes share. It ends as soon as it returns, and is counted where both can read it. */

static volatile int64_t *forks;
static volatile int is_fork;

#ifdef CAN_FORK
static void note_fork(void) { is_fork = busy_run() < MOST_RUNS; }
#endif

/* Called before each run: a process that others than FMUs have forked makes runs of its own. */
EXPORT void guard_count_forks(int64_t *count) {
#ifdef CAN_FORK
    if (!forks) pthread_atfork(NULL, NULL, note_fork);
#endif
    forks = count;
    is_fork = 0;
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

EXPORT int guard_restore_float_mode(void) {
    if (is_fork) {
        ++*forks;
        _Exit(EXIT_STATUS);
    }
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
    return runs[0];
}
