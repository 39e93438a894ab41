/* Steps of co-simulation. */

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

#endif
