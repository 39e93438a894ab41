/* Functions of FMI for model exchange (3.2). Continuous states and time are the importer's; `step` of the model happens
 * at events. */

#ifndef EXCHANGE_H
#define EXCHANGE_H

#include "values.h"

/* Whether a call with an array of `expected` numbers can be carried out; until the initialization ends, states follow
 * parameters and inputs. */
static int is_vector(Instance *instance, int modes, const fmi2Real values[], size_t count, size_t expected,
                     const char *function) {
    int broken = 0;
    if (!is_of(instance, EXCHANGE, function) || !is_allowed(instance, modes, function)) return 0;
    if (count != expected) {
        refuse(instance, fmi2Error, "%s: %lu values: expected %lu", function, (unsigned long)count,
               (unsigned long)expected);
        return 0;
    }
    if (count && !values) return missing(instance, function, "the array"), 0;
    if (instance->data.mode != INITIALIZATION) return 1;
    return report(instance, data_refresh(&instance->data, &broken), &broken, function, 0) == fmi2OK;
}

/* Of no numbers, both arrays may be NULL. */
static void copy(double to[], const double from[], int count) {
    for (int i = 0; i < count; i++) to[i] = from[i];
}

static fmi2Status to_mode(Instance *instance, int modes, Mode mode, const char *function) {
    if (!is_of(instance, EXCHANGE, function) || !is_allowed(instance, modes, function)) return fmi2Error;
    instance->data.mode = mode;
    return fmi2OK;
}

/* 3.2.2; 3.2.3: in continuous-time mode, and without effect in event mode. */
fmi2Status fmi2EnterEventMode(fmi2Component c) {
    return to_mode(c, EVENT | CONTINUOUS_TIME, EVENT, "fmi2EnterEventMode");
}

/* 3.2.2; 3.2.3: in event mode. */
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) {
    const fmi2Status status = to_mode(c, EVENT, CONTINUOUS_TIME, "fmi2EnterContinuousTimeMode");
    if (status == fmi2OK) data_leave_event(&((Instance *)c)->data);
    return status;
}

/* 3.2.2; 3.2.3: in event mode; 2.1.6: past the stop time is an error. An event that fails changes nothing. One
 * iteration is enough: after it the next sample is due later. */
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *fmi2eventInfo) {
    static const char *const function = "fmi2NewDiscreteStates";
    Instance *instance = c;
    double next;
    int jumped, broken = 0;
    if (!is_of(instance, EXCHANGE, function) || !is_allowed(instance, EVENT, function)) return fmi2Error;
    if (!fmi2eventInfo) return missing(instance, function, "fmi2eventInfo");
    const double t = instance->data.time;
    if (!(t <= instance->stop_time + tolerance_at(t, 1)))
        return refuse(instance, fmi2Error, "%s: event at %s s: expected at most the stop time %s s", function,
                      DECIMAL(t), DECIMAL(instance->stop_time));
    const Outcome outcome = data_event(&instance->data, &instance->step_cache, &jumped, &next, &broken);
    if (outcome != DONE) return report(instance, outcome, &broken, function, 0);
    *fmi2eventInfo = (fmi2EventInfo){.valuesOfContinuousStatesChanged = jumped,
                                     .nextEventTimeDefined = isfinite(next),
                                     .nextEventTime = isfinite(next) ? next : 0};
    return fmi2OK;
}

/* 3.2.2; 3.2.3: in continuous-time mode. Without effect: completedIntegratorStepNotNeeded is true. */
fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi2Boolean *enterEventMode, fmi2Boolean *terminateSimulation) {
    static const char *const function = "fmi2CompletedIntegratorStep";
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!is_of(c, EXCHANGE, function) || !is_allowed(c, CONTINUOUS_TIME, function)) return fmi2Error;
    if (!enterEventMode || !terminateSimulation)
        return missing(c, function, enterEventMode ? "terminateSimulation" : "enterEventMode");
    *enterEventMode = *terminateSimulation = fmi2False;
    return fmi2OK;
}

/* 3.2.1; 3.2.3: in event mode and continuous-time mode. Solvers try times past the stop time. */
fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
    Instance *instance = c;
    if (!is_of(instance, EXCHANGE, "fmi2SetTime")) return fmi2Error;
    if (!is_allowed(instance, EVENT | CONTINUOUS_TIME, "fmi2SetTime")) return fmi2Error;
    if (!isfinite(time))
        return refuse(instance, fmi2Error, "fmi2SetTime: time %s s: expected a finite number", DECIMAL(time));
    instance->data.time = time;
    instance->data.outputs_are_stale = 1;
    return fmi2OK;
}

/* 3.2.1; 3.2.3: in continuous-time mode. States that are not finite are discarded. */
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t nx) {
    static const char *const function = "fmi2SetContinuousStates";
    Instance *instance = c;
    if (!is_vector(instance, CONTINUOUS_TIME, x, nx, N_CONTINUOUS, function)) return fmi2Error;
    if (!are_finite(x, N_CONTINUOUS)) return refuse(instance, fmi2Discard, "%s: a state is not finite", function);
    copy(instance->data.state, x, N_CONTINUOUS);
    instance->data.outputs_are_stale = 1;
    return fmi2OK;
}

/* 3.2.1; 3.2.3: from initialization mode on. */
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t nx) {
    Instance *instance = c;
    if (!is_vector(instance, IS_INITIALIZED, x, nx, N_CONTINUOUS, "fmi2GetContinuousStates")) return fmi2Error;
    copy(x, instance->data.state, N_CONTINUOUS);
    return fmi2OK;
}

/* 3.2.2; 3.2.3: in every state but that of an error, here also there: they are constants. */
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x_nominal[], size_t nx) {
    static const char *const function = "fmi2GetNominalsOfContinuousStates";
    if (!is_vector(c, READABLE, x_nominal, nx, N_CONTINUOUS, function)) return fmi2Error;
    copy(x_nominal, NOMINALS, N_CONTINUOUS);
    return fmi2OK;
}

/* Copies numbers that have been calculated; what is not finite is discarded, so that the solver takes a shorter step. */
static fmi2Status give(Instance *instance, const double numbers[], int count, fmi2Real values[], const char *function) {
    if (!are_finite(numbers, count))
        return refuse(instance, fmi2Discard, "%s at %s s: not finite; take shorter steps", function,
                      DECIMAL(instance->data.time));
    copy(values, numbers, count);
    return fmi2OK;
}

/* 3.2.1; 3.2.3: from initialization mode on. */
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t nx) {
    static const char *const function = "fmi2GetDerivatives";
    Instance *instance = c;
    double fresh[N_CALCULATED + 1], rates[N_CONTINUOUS + 1];
    int broken = 0;
    if (!is_vector(instance, IS_INITIALIZED, derivatives, nx, N_CONTINUOUS, function)) return fmi2Error;
    const double *calculated = data_calculated(&instance->data, fresh, &broken);
    if (!calculated) return contradictory(instance, broken, function);
    data_derivatives(&instance->data, calculated, rates);
    return give(instance, rates, N_CONTINUOUS, derivatives, function);
}

/* 3.2.1; 3.2.3: from initialization mode on. */
fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real eventIndicators[], size_t ni) {
    static const char *const function = "fmi2GetEventIndicators";
    Instance *instance = c;
    double fresh[N_CALCULATED + 1], indicators[N_INDICATORS + 1];
    int broken = 0;
    if (!is_vector(instance, IS_INITIALIZED, eventIndicators, ni, N_INDICATORS, function)) return fmi2Error;
    const double *calculated = data_calculated(&instance->data, fresh, &broken);
    if (!calculated) return contradictory(instance, broken, function);
#if MODEL_HAS_DERIVATIVE
    const Data *d = &instance->data;
    double held[N_STATES];
    data_hold(d, d->state, calculated, held);
    model_crossings(d->time, held, d->value + FIRST_INPUT, d->value, calculated, indicators);
#endif
    return give(instance, indicators, N_INDICATORS, eventIndicators, function);
}

#endif
