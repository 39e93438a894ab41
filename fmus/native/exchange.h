/* Functions of FMI for model exchange (3.2). Continuous states and time are the importer's; `step` of the model happens
 * at events. */

#ifndef EXCHANGE_H
#define EXCHANGE_H

#include "values.h"

/* Whether a call with an array of `expected` numbers can be carried out; until the initialization ends, states follow
 * parameters and inputs, but nominal values, which are there before it, do not. */
static OUTLINED int is_vector(Instance *instance, int modes, const double values[], size_t count, size_t expected,
                              const char *function) {
    int broken = 0;
    if (!is_of(instance, EXCHANGE, function) || !is_allowed(instance, modes, function)) return 0;
    if (count != expected) {
        refuse(instance, ERROR, "%s: %lu values: expected %lu", function, (unsigned long)count,
               (unsigned long)expected);
        return 0;
    }
    if (count && !values) return missing(instance, function, "the array"), 0;
    if (instance->data.mode != INITIALIZATION || modes == READABLE) return 1;
    return report(instance, data_refresh(&instance->data, &broken), &broken, function, 0, DISCARD) == OK;
}

/* Of no numbers, both arrays may be NULL. */
static void copy(double to[], const double from[], int count) {
    for (int i = 0; i < count; i++) to[i] = from[i];
}

static OUTLINED Status to_mode(Instance *instance, int modes, Mode mode, const char *function) {
    if (!is_of(instance, EXCHANGE, function) || !is_allowed(instance, modes, function)) return ERROR;
    instance->data.mode = mode;
    return OK;
}

/* 3.2.2; 3.2.3: in continuous-time mode, and without effect in event mode of FMI 2.0. Discrete outputs may change. */
Status FMI(EnterEventMode)(void *c) {
    const Status status = to_mode(c, EVENT_TOO | CONTINUOUS_TIME, EVENT, NAME(EnterEventMode));
    if (status == OK) ((Instance *)c)->data.outputs_are_stale = 1;
    return status;
}

/* 3.2.2; 3.2.3: in event mode. Discrete outputs follow what was set in it, whether or not they were read there. */
Status FMI(EnterContinuousTimeMode)(void *c) {
    Instance *instance = c;
    int broken = 0;
    if (to_mode(instance, EVENT, EVENT, NAME(EnterContinuousTimeMode)) != OK) return ERROR;
    const Outcome outcome = data_refresh(&instance->data, &broken);
    if (outcome != DONE) return report(instance, outcome, &broken, NAME(EnterContinuousTimeMode), 0, ERROR);
    data_leave_event(&instance->data);
    return to_mode(instance, EVENT, CONTINUOUS_TIME, NAME(EnterContinuousTimeMode));
}

/* 3.2.2; 3.2.3: in event mode; 2.1.6: past the stop time is an error. An event that fails changes nothing. One
 * iteration is enough: after it the next sample is due later. */
static Status update_discrete_states(Instance *instance, const char *null_argument, int *jumped, double *next,
                                     const char *function) {
    int broken = 0;
    if (!is_of(instance, EXCHANGE, function) || !is_allowed(instance, EVENT, function)) return ERROR;
    if (null_argument) return missing(instance, function, null_argument);
    const double t = instance->data.time;
    if (!(t <= instance->stop_time + tolerance_at(t, 1)))
        return refuse(instance, ERROR, "%s: event at %s s: expected at most the stop time %s s", function,
                      DECIMAL(t), DECIMAL(instance->stop_time));
    const Outcome outcome = data_event(&instance->data, &instance->step_cache, jumped, next, &broken);
    return report(instance, outcome, &broken, function, t - instance->data.start_time, ERROR);
}

/* 3.2.2; 3.2.3: in continuous-time mode. Without effect: completedIntegratorStepNotNeeded is true. */
Status FMI(CompletedIntegratorStep)(void *c, FMI(Boolean) noSetFMUStatePriorToCurrentPoint,
                                    FMI(Boolean) *enterEventMode, FMI(Boolean) *terminateSimulation) {
    static const char *const function = NAME(CompletedIntegratorStep);
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!is_of(c, EXCHANGE, function) || !is_allowed(c, CONTINUOUS_TIME, function)) return ERROR;
    if (!enterEventMode || !terminateSimulation)
        return missing(c, function, enterEventMode ? "terminateSimulation" : "enterEventMode");
    *enterEventMode = *terminateSimulation = FMI(False);
    return OK;
}

/* 3.2.1; 3.2.3: in continuous-time mode, and event mode of FMI 2.0. Solvers try times past the stop time. */
Status FMI(SetTime)(void *c, double time) {
    Instance *instance = c;
    if (!is_of(instance, EXCHANGE, NAME(SetTime))) return ERROR;
    if (!is_allowed(instance, EVENT_TOO | CONTINUOUS_TIME, NAME(SetTime))) return ERROR;
    if (!isfinite(time))
        return refuse(instance, ERROR, NAME(SetTime) ": time %s s: expected a finite number", DECIMAL(time));
    instance->data.time = time;
    instance->data.outputs_are_stale = 1;
    return OK;
}

/* 3.2.1; 3.2.3: in continuous-time mode. States that are not finite are discarded. */
Status FMI(SetContinuousStates)(void *c, const double x[], size_t nx) {
    static const char *const function = NAME(SetContinuousStates);
    Instance *instance = c;
    if (!is_vector(instance, CONTINUOUS_TIME, x, nx, N_CONTINUOUS, function)) return ERROR;
    if (!are_finite(x, N_CONTINUOUS)) return refuse(instance, DISCARD, "%s: a state is not finite", function);
    copy(instance->data.state, x, N_CONTINUOUS);
    instance->data.outputs_are_stale = 1;
    return OK;
}

/* 3.2.1; 3.2.3: from initialization mode on. */
Status FMI(GetContinuousStates)(void *c, double x[], size_t nx) {
    Instance *instance = c;
    if (!is_vector(instance, IS_INITIALIZED, x, nx, N_CONTINUOUS, NAME(GetContinuousStates))) return ERROR;
    copy(x, instance->data.state, N_CONTINUOUS);
    return OK;
}

/* 3.2.2; 3.2.3: in every state except after an error; here also after an error: they are constants. */
Status FMI(GetNominalsOfContinuousStates)(void *c, double x_nominal[], size_t nx) {
    static const char *const function = NAME(GetNominalsOfContinuousStates);
    if (!is_vector(c, READABLE, x_nominal, nx, N_CONTINUOUS, function)) return ERROR;
    copy(x_nominal, NOMINALS, N_CONTINUOUS);
    return OK;
}

/* Copies calculated numbers. Numbers that are not finite are discarded, so that the solver takes a shorter step. */
static OUTLINED Status give(Instance *instance, const double numbers[], int count, double values[],
                            const char *function) {
    if (!are_finite(numbers, count))
        return refuse(instance, DISCARD, "%s at %s s: not finite; take shorter steps", function,
                      DECIMAL(instance->data.time));
    copy(values, numbers, count);
    return OK;
}

/* 3.2.1; 3.2.3: from initialization mode on. */
Status FMI(GetContinuousStateDerivatives)(void *c, double derivatives[], size_t nx) {
    static const char *const function = NAME(GetContinuousStateDerivatives);
    Instance *instance = c;
    double fresh[N_CALCULATED + 1], rates[N_CONTINUOUS + 1];
    int broken = 0;
    if (!is_vector(instance, IS_INITIALIZED, derivatives, nx, N_CONTINUOUS, function)) return ERROR;
    const double *calculated = data_calculated(&instance->data, fresh, &broken);
    if (!calculated) return contradictory(instance, broken, function);
    data_derivatives(&instance->data, calculated, rates);
    return give(instance, rates, N_CONTINUOUS, derivatives, function);
}

/* 3.2.1; 3.2.3: from initialization mode on. */
Status FMI(GetEventIndicators)(void *c, double eventIndicators[], size_t ni) {
    static const char *const function = NAME(GetEventIndicators);
    Instance *instance = c;
    double fresh[N_CALCULATED + 1], indicators[N_INDICATORS + 1] = {0};
    int broken = 0;
    if (!is_vector(instance, IS_INITIALIZED, eventIndicators, ni, N_INDICATORS, function)) return ERROR;
    const double *calculated = data_calculated(&instance->data, fresh, &broken);
    if (!calculated) return contradictory(instance, broken, function);
    data_indicators(&instance->data, calculated, indicators);
    return give(instance, indicators, N_INDICATORS, eventIndicators, function);
}

#endif
