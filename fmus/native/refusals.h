/* An instance as the importer has it, and how its calls are refused. */

#ifndef REFUSALS_H
#define REFUSALS_H

#include "instance.h"
#include "log.h"

typedef struct {
    Data data;
    StepCache step_cache;
    double stop_time; /* of the setup: no saved state changes it */
    Log log;
    fmi2StepFinished step_finished;
} Instance;

static const char *const TYPE_NAMES[] = {"Real", "Integer or Enumeration", "Boolean"};

/* Refusals. 2.1.3: after fmi2Error the simulation cannot go on until the instance is restored or reset. */

static fmi2Status refuse(Instance *instance, fmi2Status status, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    log_send(&instance->log, status, format, arguments);
    va_end(arguments);
    if (status == fmi2Error) instance->data.mode = IN_ERROR;
    return status;
}

static const char *mode_name(int mode) {
    return mode == INSTANTIATED     ? "instantiated"
           : mode == INITIALIZATION ? "initialization mode"
           : mode == STEPPING       ? "step complete"
           : mode == TERMINATED     ? "terminated"
           : mode == EVENT          ? "event mode"
           : mode == CONTINUOUS_TIME ? "continuous-time mode"
                                    : "error";
}

static int not_allowed(Instance *instance, const char *function) {
    refuse(instance, fmi2Error, "%s is not allowed in the state '%s'", function, mode_name((int)instance->data.mode));
    return 0;
}

static INLINED int is_allowed(Instance *instance, int modes, const char *function) {
    return instance && ((instance->data.mode & modes) || not_allowed(instance, function));
}

/* Whether the instance is one for this interface, whatever its state. */
static int is_of(Instance *instance, int face, const char *function) {
    if (!instance || !instance->data.face == !face) return instance != NULL;
    refuse(instance, fmi2Error, "%s: expected an instance for %s", function, face ? "model exchange" : "co-simulation");
    return 0;
}

static fmi2Status missing(Instance *instance, const char *function, const char *argument) {
    return refuse(instance, fmi2Error, "%s: %s is NULL", function, argument);
}

static fmi2Status no_item(Instance *instance, fmi2Status status, int reference, const char *function) {
    const Variable *v = VARIABLES + reference;
    return refuse(instance, status, "%s: %s is another number: expected %s", function, v->name, v->expected);
}

static fmi2Status contradictory(Instance *instance, int broken, const char *function) {
    if (broken >= N_REQUIREMENTS)
        return no_item(instance, fmi2Error, FIRST_CALCULATED + broken - N_REQUIREMENTS, function);
    return refuse(instance, fmi2Error, "%s: parameters of " MODEL_NAME ": expected %s", function, REQUIRED[broken]);
}

/* 4.2.2: a step that cannot begin is an error, one that does not reach its end is discarded.
 * broken: a pointer, because the outcome, which sets it, may be evaluated after the other arguments. */
static fmi2Status report(Instance *instance, Outcome outcome, const int *broken, const char *function, double h) {
    const int is_stepping = (instance->data.mode & (STEPPING | EVENT | CONTINUOUS_TIME)) != 0;
    if (outcome == DONE) return fmi2OK;
    if (outcome == CONTRADICTORY) return contradictory(instance, *broken, function);
    if (outcome == NO_ITEM) return no_item(instance, is_stepping ? fmi2Discard : fmi2Error, *broken, function);
    if (outcome == TOO_MANY_STEPS)
        return refuse(instance, fmi2Error,
                      "%s: communication step size %s s: expected at most %s internal steps", function,
                      DECIMAL(h), DECIMAL(MOST_INTERNAL_STEPS));
    if (!is_stepping)
        return refuse(instance, fmi2Error,
                      "%s: parameters and inputs of " MODEL_NAME ": state or outputs are not finite at the start",
                      function);
    return refuse(instance, fmi2Discard,
                  "%s at %s s: state or outputs are not finite any more; take shorter steps", function,
                  DECIMAL(instance->data.time));
}

#endif
