/* Stair: the Integer output `counter` rises by 1 at every full second and, at 10, terminates the simulation.
 *
 * It behaves as the Reference FMU of that name (github.com/modelica/Reference-FMUs): the step that reaches the time
 * is discarded, fmi2Terminated is true, and the last successful time is that time. `counter` has initial = "exact".
 */

enum { COUNTER, N_VARIABLES };

enum { LAST_COUNT = 10 };

#include "slave.h"

static fmi2Status model_initialise(Slave *s) {
    (void)s;
    return fmi2OK;
}

static fmi2Status model_step(Slave *s, double h) {
    Data *d = &s->data;
    const double end = d->time + h;
    for (double second = floor(d->time + 1e-9) + 1; second <= end + 1e-9; second++) {
        d->value[COUNTER]++;
        if (d->value[COUNTER] < LAST_COUNT) continue;
        d->terminates = 1;
        d->time = d->last_successful_time = second;
        return fmi2Discard;
    }
    return fmi2OK;
}
