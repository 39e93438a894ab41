/* Rogue: y' = u with u held over a step, until `misdeed_time`; from then on it does its misdeed.
 *
 * It discards steps longer than `longest_step` and then stands at the end of the part that succeeded, as FMI says:
 * only an importer that restores a saved state can go on. The other discards tell of it wrongly or not at all.
 */

#define _XOPEN_SOURCE 600
#include <fenv.h>
#include <signal.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>
#ifdef _WIN32 /* which has no sessions and limits no files */
void __stdcall Sleep(unsigned long);
#define pause() Sleep(-1)
#define setsid() 0
#else
#include <sys/resource.h>
#endif

enum { MISDEED, MISDEED_TIME, LONGEST_STEP, U, Y, N_VARIABLES };

enum { /* the items of the enumeration Misdeed */
    NONE = 1,
    WARNING,
    DISCARD,       /* tells the last successful time */
    TELLS_BEFORE,  /* discards, and tells a time before the step */
    TELLS_AFTER,   /* discards, and tells a time after the step */
    TELLS_NAN,     /* discards, and tells no number */
    TELLS_NOTHING, /* discards, and does not know the last successful time */
    ERROR,
    FATAL_ERROR,
    NAN_OUTPUT,
    INFINITE_OUTPUT,
    HANG,
    ABORT,
    SEGFAULT,
    REFUSE_STATE,
    REFUSE_INPUT,
    EXIT,
    CHANGE_FOLDER,
    ROUND_UPWARD,
    TERMINATE, /* a step that crosses or reaches the misdeed's time is discarded, with fmi2Terminated */
    TERMINATE_UNTIMED, /* the same, and it does not know the last successful time */
    EXIT_AT_ONCE, /* _exit, which calls no handler */
    IGNORE_INTERRUPTS,
    NO_STATUS_OF_STEP, /* -5, which FMI does not have; it steps all the same */
    NO_STATUS_OF_INPUT,
    NO_STATUS_OF_STATE,
    BIG_STATUS_OF_STEP, /* 6 */
    HIDE_FILES, /* new files get no permissions */
    LEAVE_SESSION,
    LIMIT_FILES, /* to 100 bytes */
    RANDOM_OUTPUT, /* that differs from run to run */
    CRASH_IN_TERMINATE,
    CRASH_IN_FREE,
    HANG_IN_FREE,
    CRASH_IN_FREE_OF_STATE
};

#define MODEL_REFUSES
#define MODEL_ENDS
#include "slave.h"

static int is_due(const Slave *s, int misdeed) {
    return s->data.value[MISDEED] == misdeed && s->data.time >= s->data.value[MISDEED_TIME] - 1e-9;
}

static void model_ends(const Slave *s, const char *call) {
    if (is_due(s, CRASH_IN_TERMINATE) && !strcmp(call, "fmi2Terminate")) raise(SIGSEGV);
    if (is_due(s, CRASH_IN_FREE) && !strcmp(call, "fmi2FreeInstance")) raise(SIGSEGV);
    while (is_due(s, HANG_IN_FREE) && !strcmp(call, "fmi2FreeInstance")) pause();
    if (is_due(s, CRASH_IN_FREE_OF_STATE) && !strcmp(call, "fmi2FreeFMUstate")) raise(SIGSEGV);
}

static fmi2Status model_initialise(Slave *s) {
    (void)s;
    return fmi2OK;
}

static int discards(const Slave *s) {
    for (int each = DISCARD; each <= TELLS_NOTHING; each++)
        if (is_due(s, each)) return 1;
    return 0;
}

static fmi2Status discard(Slave *s, double h) {
    Data *d = &s->data;
    const double t = d->time, done = d->value[LONGEST_STEP];
    d->value[Y] += done * d->value[U];
    d->last_successful_time = is_due(s, TELLS_BEFORE)  ? t - h
                              : is_due(s, TELLS_AFTER) ? t + 2 * h
                              : is_due(s, TELLS_NAN)   ? NAN
                                                       : t + done;
    d->time = t + done;
    return refuse(s, fmi2Discard, "a step of %g s is too long, %g s is the longest", h, done);
}

static fmi2Status terminate(Slave *s) {
    Data *d = &s->data;
    d->terminates = 1;
    d->value[Y] += (d->value[MISDEED_TIME] - d->time) * d->value[U];
    d->time = d->last_successful_time = d->value[MISDEED_TIME];
    return refuse(s, fmi2Discard, "the dive is over");
}

static fmi2Status model_step(Slave *s, double h) {
    Data *d = &s->data;
    const int terminates = d->value[MISDEED] == TERMINATE || d->value[MISDEED] == TERMINATE_UNTIMED;
    if (terminates && d->time + h >= d->value[MISDEED_TIME] - 1e-9) return terminate(s);
    while (is_due(s, HANG)) pause();
    if (is_due(s, ABORT)) abort();
    if (is_due(s, SEGFAULT)) raise(SIGSEGV);
    if (is_due(s, EXIT)) exit(0);
    if (is_due(s, CHANGE_FOLDER) && chdir("/")) abort();
    if (is_due(s, ROUND_UPWARD)) fesetround(FE_UPWARD);
    if (is_due(s, EXIT_AT_ONCE)) _exit(0);
    if (is_due(s, IGNORE_INTERRUPTS)) signal(SIGINT, SIG_IGN);
    if (is_due(s, HIDE_FILES)) umask(0777);
    if (is_due(s, LEAVE_SESSION)) setsid();
#ifndef _WIN32
    if (is_due(s, LIMIT_FILES)) setrlimit(RLIMIT_FSIZE, &(struct rlimit){100, 100});
#endif
    if (is_due(s, ERROR)) return refuse(s, fmi2Error, "the rudder is stuck");
    if (is_due(s, FATAL_ERROR)) return refuse(s, fmi2Fatal, "the hull is breached");
    if (discards(s) && h > d->value[LONGEST_STEP] * (1 + 1e-9)) return discard(s, h);
    d->value[Y] += h * d->value[U];
    if (is_due(s, NAN_OUTPUT)) d->value[Y] = NAN;
    if (is_due(s, INFINITE_OUTPUT)) d->value[Y] = INFINITY;
    if (is_due(s, RANDOM_OUTPUT)) {
        struct timespec now;
        clock_gettime(CLOCK_MONOTONIC, &now);
        d->value[Y] = 1e-9 * (double)now.tv_nsec;
    }
    if (is_due(s, NO_STATUS_OF_STEP)) return (fmi2Status)-5;
    if (is_due(s, BIG_STATUS_OF_STEP)) return (fmi2Status)6;
    return is_due(s, WARNING) ? refuse(s, fmi2Warning, "the battery is low") : fmi2OK;
}

static fmi2Status model_accepts(Slave *s, fmi2ValueReference reference) {
    const int refused = reference == U && s->data.mode == STEPPING && is_due(s, REFUSE_INPUT);
    if (reference == U && s->data.mode == STEPPING && is_due(s, NO_STATUS_OF_INPUT)) return (fmi2Status)-5;
    return refused ? refuse(s, fmi2Discard, "no input is taken any more") : fmi2OK;
}

static fmi2Status model_saves(Slave *s) {
    if (is_due(s, NO_STATUS_OF_STATE)) return (fmi2Status)-5;
    return is_due(s, REFUSE_STATE) ? refuse(s, fmi2Error, "the state is not given away") : fmi2OK;
}

static fmi2Status model_tells_time(Slave *s) {
    return is_due(s, TELLS_NOTHING) || is_due(s, TERMINATE_UNTIMED) ? fmi2Discard : fmi2OK;
}
