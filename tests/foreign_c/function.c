/* Function: y = EXPRESSION(u) of one input, at once; a result that is not finite is discarded. */

#include "config.h"

enum { U, Y, N_VARIABLES };

#include "slave.h"

static fmi2Status evaluate(Slave *s) {
    const double u = s->data.value[U], y = EXPRESSION(u);
    if (!isfinite(y)) return refuse(s, fmi2Discard, "u = %g: the function has no value", u);
    s->data.value[Y] = y;
    return fmi2OK;
}

static fmi2Status model_initialise(Slave *s) { return evaluate(s); }

static fmi2Status model_step(Slave *s, double h) {
    (void)h;
    return evaluate(s);
}
