/* Forker: y' = u with u held over a step. The first call of one function forks the process. The child returns, too, as
 * it does where it should become a program that is not there; or it ends, or becomes a program. In the child, y is
 * another.
 */

#define _POSIX_C_SOURCE 199309L
#include <time.h>
#include <unistd.h>

enum { U, Y, N_VARIABLES };
enum { RETURNS, EXITS, BECOMES };

static void fork_in(const char *call);
#define MODEL_IS_CALLED(call) fork_in(call)
#define MODEL_CONFIG double call, child_waits, child_does;
#include "slave.h"

static const char *const CALLS[] = {"fmi2Instantiate", "fmi2SetReal", "fmi2GetReal", "fmi2EnterInitializationMode",
                                    "fmi2Reset",       "fmi2DoStep"};

static int has_forked, is_child;

static void fork_in(const char *call) {
    if (has_forked || strcmp(call, CALLS[(int)config.call])) return;
    has_forked = 1;
    is_child = fork() == 0;
    if (is_child == (int)config.child_waits) nanosleep(&(struct timespec){.tv_nsec = 100000000}, NULL);
    if (is_child && config.child_does == EXITS) _exit(0);
    if (is_child && config.child_does == BECOMES) execl("/bin/sh", "sh", "-c", "exit 0", (char *)NULL);
}

static fmi2Status model_initialise(Slave *s) {
    (void)s;
    return fmi2OK;
}

static fmi2Status model_step(Slave *s, double h) {
    nanosleep(&(struct timespec){.tv_nsec = 20000000}, NULL); /* so that parent and child step side by side */
    s->data.value[Y] += h * s->data.value[U] + 1000 * is_child;
    return fmi2OK;
}
