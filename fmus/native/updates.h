/* Steps of co-simulation with intermediate updates (FMI 3.0.2, 4.2.2): callbacks that set inputs and get outputs. */

#ifndef UPDATES_H
#define UPDATES_H

#include "steps.h"

/* The variables with the attribute intermediateUpdate: continuous inputs and outputs. */
static int is_intermediate(unsigned reference) {
    return reference >= FIRST_INPUT && reference < N_VALUES && ACCESS[reference].is_continuous;
}

/* One internal step of `data_step`, with the outputs at its end. */
static Outcome internal_step(Data *d, StepCache *cache, double t, double h, double end, int *broken) {
    double fresh[N_CALCULATED + 1], next[N_STATES + 1], outputs[N_OUTPUTS + 1];
    const double *p = d->value, *c = data_calculated(d, fresh, broken);
    if (!c) return CONTRADICTORY;
    model_step(t, h, d->state, p + FIRST_INPUT, p, c, step_numbers(cache, h, p, c), next);
    model_output(end, next, p, c, outputs);
    const Outcome outcome = checked(next, outputs, broken);
    if (outcome == DONE) data_become(d, end, next, outputs, c);
    return outcome;
}

/* Makes the callback at time t: whether no call in it was an error. `until`: the end that the importer asks for. */
static int update(Instance *instance, Mode mode, double t, int can_return_early, double *until) {
    const int is_get = mode == UPDATE_OF_OUTPUTS;
    fmi3Boolean is_requested = fmi3False;
    double requested = t;
    instance->data.mode = mode;
    instance->after_step(instance->log.environment, t, !is_get, is_get, is_get, can_return_early, &is_requested,
                         &requested);
    if (instance->data.mode != mode) return 0;
    instance->data.mode = STEPPING;
    if (can_return_early && is_requested) *until = requested;
    return 1;
}

/* As `do_step`, in the same internal steps. Each holds the inputs that the importer has for its middle, which are
 * asked for before it; after it outputs can be got. It ends early at the last internal time that is not later than
 * the importer's. */
static Status do_step_with_updates(Instance *instance, double t, double h, fmi3Boolean *is_early) {
    if (check_step(instance, t, h) != OK) return ERROR;
    Data *d = &instance->data;
    const Data before = *d;
    const double count = internal_steps(d, h), internal = h / count;
    double until = t + h;
    int broken = 0, is_good = 1;
    Outcome outcome = count <= MOST_INTERNAL_STEPS ? DONE : TOO_MANY_STEPS;
    for (double i = 0; is_good && outcome == DONE && i < count && !*is_early; i++) {
        const int is_last = i + 1 == count;
        const double end = is_last ? t + h : t + (i + 1) * internal;
        is_good = update(instance, UPDATE_OF_INPUTS, t + (i + 0.5) * internal, 0, &until);
        if (is_good) outcome = internal_step(d, &instance->step_cache, t + i * internal, internal, end, &broken);
        if (is_good && outcome == DONE)
            is_good = update(instance, UPDATE_OF_OUTPUTS, end, !is_last && instance->can_return_early, &until);
        *is_early = !is_last && end + internal > until + tolerance_at(t, internal);
    }
    if (is_good && outcome == DONE) return OK;
    *d = before;
    return is_good ? report(instance, outcome, &broken, NAME(DoStep), h, DISCARD)
                   : refuse(instance, ERROR, NAME(DoStep) ": a call in the intermediate update was an error");
}

/* 4.2.1: a step ends exactly at its end, unless the importer ends it early; no event is needed there, and the
 * simulation goes on. */
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 currentCommunicationPoint, fmi3Float64 communicationStepSize,
                      fmi3Boolean noSetFMUStatePriorToCurrentPoint, fmi3Boolean *eventHandlingNeeded,
                      fmi3Boolean *terminateSimulation, fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime) {
    Instance *instance = c;
    (void)noSetFMUStatePriorToCurrentPoint; /* a state is never kept by the FMU itself */
    if (!instance) return fmi3Error;
    if (!eventHandlingNeeded || !terminateSimulation || !earlyReturn || !lastSuccessfulTime)
        return missing(instance, "fmi3DoStep", "a result");
    const double t = currentCommunicationPoint, h = communicationStepSize;
    *eventHandlingNeeded = *terminateSimulation = *earlyReturn = fmi3False;
    const fmi3Status status =
        instance->after_step ? do_step_with_updates(instance, t, h, earlyReturn) : do_step(instance, t, h);
    if (status == fmi3OK) *lastSuccessfulTime = instance->data.time;
    return status;
}

#endif
