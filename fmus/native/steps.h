/* Steps of co-simulation, and the derivatives of outputs by time. */

#ifndef STEPS_H
#define STEPS_H

#include "refusals.h"

/* 4.2.2: the step size h is greater than 0; 2.1.6: past the stop time is an error; 4.2.4: when a step is complete. */
static INLINED Status check_step(Instance *instance, double t, double h) {
    if (!is_allowed(instance, STEPPING, NAME(DoStep))) return ERROR;
    if (!(h > 0 && h <= DBL_MAX))
        return refuse(instance, ERROR,
                      NAME(DoStep) ": communication step size %s s: expected more than 0", DECIMAL(h));
    if (!isfinite(t) || !(fabs(t - instance->data.time) <= tolerance_at(t, h)))
        return refuse(instance, ERROR, NAME(DoStep) ": communication point %s s: expected %s s, the current time",
                      DECIMAL(t), DECIMAL(instance->data.time));
    if (!(t + h <= instance->stop_time + tolerance_at(t, h)))
        return refuse(instance, ERROR, NAME(DoStep) ": step to %s s: expected at most the stop time %s s",
                      DECIMAL(t + h), DECIMAL(instance->stop_time));
    return OK;
}

/* 4.2.2: exactly to the current communication point t plus the step size h. */
static INLINED Status do_step(Instance *instance, double t, double h) {
    int broken = 0;
    if (check_step(instance, t, h) != OK) return ERROR;
    Data *data = &instance->data;
    const Outcome outcome = data_step(data, &instance->step_cache, t, h, data->value + FIRST_INPUT, &broken);
    return outcome == DONE ? OK : report(instance, outcome, &broken, NAME(DoStep), h, DISCARD);
}

/* 4.2.1: order 0 is not allowed. */
static OUTLINED int are_orders(Instance *instance, const unsigned references[], const int order[], size_t count,
                               const char *function) {
    if (count && !order) return missing(instance, function, "order"), 0;
    for (size_t i = 0; i < count; i++) {
        if (order[i] >= 1) continue;
        refuse(instance, ERROR, "%s: %s: order %d: expected at least 1", function, VARIABLES[references[i]].name,
               order[i]);
        return 0;
    }
    return 1;
}

static OUTLINED int are_outputs(Instance *instance, const unsigned references[], size_t count, const char *function) {
    for (size_t i = 0; i < count; i++) {
        if (references[i] >= FIRST_OUTPUT && references[i] < N_VALUES) continue;
        refuse(instance, ERROR, "%s: %s: expected an output", function, VARIABLES[references[i]].name);
        return 0;
    }
    return 1;
}

/* 4.2.1: the first derivatives of all outputs at the current time of the instance. */
static OUTLINED Status output_rates(Instance *instance, double rate[], const char *function) {
    double fresh[N_CALCULATED + 1];
    const double *v = instance->data.value;
    int broken = 0;
    const double *c = data_calculated(&instance->data, fresh, &broken);
    if (!c) return contradictory(instance, broken, function);
    model_output_rate(instance->data.time, instance->data.state, v + FIRST_INPUT, v, c, rate);
    return OK;
}

#endif
