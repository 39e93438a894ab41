/* Functions of FMI that step, and that tell how far a step came (4.2.2, 4.2.3). */

#ifndef STEPS_H
#define STEPS_H

#include "refusals.h"

/* Exactly to the current communication point plus the step size, which is greater than 0; 2.1.6: past the stop time is
 * an error; 2.1.5: stepFinished, if it is given, is called after a completed step; 4.2.4: when a step is complete. */
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint) {
    Instance *instance = c;
    const double t = currentCommunicationPoint, h = communicationStepSize;
    int broken = 0;
    (void)noSetFMUStatePriorToCurrentPoint; /* a state is never kept by the FMU itself */
    if (!is_allowed(instance, STEPPING, "fmi2DoStep")) return fmi2Error;
    if (!(h > 0 && h <= DBL_MAX))
        return refuse(instance, fmi2Error,
                      "fmi2DoStep: communication step size %s s: expected more than 0", DECIMAL(h));
    if (!isfinite(t) || !(fabs(t - instance->data.time) <= tolerance_at(t, h)))
        return refuse(instance, fmi2Error, "fmi2DoStep: communication point %s s: expected %s s, the current time",
                      DECIMAL(t), DECIMAL(instance->data.time));
    if (!(t + h <= instance->stop_time + tolerance_at(t, h)))
        return refuse(instance, fmi2Error, "fmi2DoStep: step to %s s: expected at most the stop time %s s",
                      DECIMAL(t + h), DECIMAL(instance->stop_time));
    Data *data = &instance->data;
    const Outcome outcome = data_step(data, &instance->step_cache, t, h, data->value + FIRST_INPUT, &broken);
    if (outcome != DONE) return report(instance, outcome, &broken, "fmi2DoStep", h);
    if (instance->step_finished) instance->step_finished(instance->log.environment, fmi2OK);
    return fmi2OK;
}

/* 4.2.2; 4.2.4: never, as no step is in progress when the importer calls. */
fmi2Status fmi2CancelStep(fmi2Component c) {
    return c ? refuse(c, fmi2Error, "fmi2CancelStep: expected a step in progress; steps are never asynchronous")
             : fmi2Error;
}

/* 4.2.3; 4.2.4: when a step is complete, and after the end. No step is ever pending: only the last successful time
 * and the end are available; a status that cannot be given is discarded. */

static fmi2Status no_status(Instance *instance, fmi2StatusKind kind, const char *function) {
    if (!is_of(instance, CO_SIMULATION, function)) return fmi2Error;
    if (!is_allowed(instance, STEPPING | TERMINATED, function)) return fmi2Error;
    return refuse(instance, fmi2Discard,
                  "%s: status kind %d: not available, steps are never asynchronous", function, kind);
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind s, fmi2Status *value) {
    (void)value;
    return no_status(c, s, "fmi2GetStatus");
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value) {
    Instance *instance = c;
    if (s != fmi2LastSuccessfulTime) return no_status(instance, s, "fmi2GetRealStatus");
    if (!is_allowed(instance, STEPPING | TERMINATED, "fmi2GetRealStatus")) return fmi2Error;
    if (!value) return missing(instance, "fmi2GetRealStatus", "value");
    *value = instance->data.time;
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind s, fmi2Integer *value) {
    (void)value;
    return no_status(c, s, "fmi2GetIntegerStatus");
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value) {
    Instance *instance = c;
    if (s != fmi2Terminated) return no_status(instance, s, "fmi2GetBooleanStatus");
    if (!is_allowed(instance, STEPPING | TERMINATED, "fmi2GetBooleanStatus")) return fmi2Error;
    if (!value) return missing(instance, "fmi2GetBooleanStatus", "value");
    *value = fmi2False; /* the model never wants the simulation to end */
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind s, fmi2String *value) {
    (void)value;
    return no_status(c, s, "fmi2GetStringStatus");
}

#endif
