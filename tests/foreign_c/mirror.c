/* Mirror: its outputs are its inputs of the step before; config.h has N_PAIRS, the numbers that go in and come out. */

#include "config.h"

enum { N_VARIABLES = 2 * N_PAIRS };

#include "slave.h"

static fmi2Status model_initialise(Slave *s) {
    memcpy(s->data.value + N_PAIRS, s->data.value, N_PAIRS * sizeof *s->data.value);
    return fmi2OK;
}

static fmi2Status model_step(Slave *s, double h) {
    (void)h;
    return model_initialise(s);
}
