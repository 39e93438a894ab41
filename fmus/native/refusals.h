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
    FMI(IntermediateUpdateCallback) after_step; /* of FMI 2.0 stepFinished; NULL for none */
    int can_return_early; /* never in FMI 2.0 */
} Instance;

enum { OUTSIDE_STEPS = ~INSIDE_STEPS };

static const char *const TYPE_TEXTS[] = {TYPE_NAMES};

/* Refusals. 2.1.3: after ERROR the simulation cannot go on until the instance is restored or reset. */

static Status refuse(Instance *instance, Status status, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    log_send(&instance->log, status, format, arguments);
    va_end(arguments);
    if (status == ERROR) instance->data.mode = instance->data.mode & INSIDE_STEPS ? UPDATE_IN_ERROR : IN_ERROR;
    return status;
}

static const char *mode_name(int mode) {
    if (mode & INSIDE_STEPS)
        return mode == UPDATE_OF_INPUTS    ? "intermediate update mode, to set inputs"
               : mode == UPDATE_OF_OUTPUTS ? "intermediate update mode, to get outputs"
                                           : "intermediate update mode, after an error";
    return mode == INSTANTIATED     ? "instantiated"
           : mode == INITIALIZATION ? "initialization mode"
           : mode == STEPPING       ? "step complete"
           : mode == TERMINATED     ? "terminated"
           : mode == EVENT          ? "event mode"
           : mode == CONTINUOUS_TIME ? "continuous-time mode"
                                    : "error";
}

static OUTLINED int not_allowed(Instance *instance, const char *function) {
    refuse(instance, ERROR, "%s is not allowed in the state '%s'", function, mode_name((int)instance->data.mode));
    return 0;
}

static INLINED int is_allowed(Instance *instance, int modes, const char *function) {
    return instance && ((instance->data.mode & modes) || not_allowed(instance, function));
}

static OUTLINED int not_of(Instance *instance, int face, const char *function) {
    refuse(instance, ERROR, "%s: expected an instance for %s", function, face ? "model exchange" : "co-simulation");
    return 0;
}

/* Whether the instance is one for this interface, whatever its state. */
static INLINED int is_of(Instance *instance, int face, const char *function) {
    return instance && (!instance->data.face == !face || not_of(instance, face, function));
}

static OUTLINED Status missing(Instance *instance, const char *function, const char *argument) {
    return refuse(instance, ERROR, "%s: %s is NULL", function, argument);
}

static OUTLINED Status no_item(Instance *instance, Status status, int reference, const char *function) {
    const Variable *v = VARIABLES + reference;
    return refuse(instance, status, "%s: %s is another number: expected %s", function, v->name, v->expected);
}

static OUTLINED Status contradictory(Instance *instance, int broken, const char *function) {
    if (broken >= N_REQUIREMENTS)
        return no_item(instance, ERROR, FIRST_CALCULATED + broken - N_REQUIREMENTS, function);
    return refuse(instance, ERROR, "%s: parameters of " MODEL_NAME ": expected %s", function, REQUIRED[broken]);
}

/* 4.2.2: a step that cannot begin is an error, one that does not reach its end is discarded.
 * most: of what 2.1.3 lets the function return, DISCARD or ERROR
 * broken: a pointer, because the outcome, which sets it, may be evaluated after the other arguments */
static OUTLINED Status report(Instance *instance, Outcome outcome, const int *broken, const char *function, double h,
                              Status most) {
    const int is_stepping = (instance->data.mode & (STEPPING | EVENT | CONTINUOUS_TIME)) != 0;
    if (outcome == DONE) return OK;
    if (outcome == CONTRADICTORY) return contradictory(instance, *broken, function);
    if (outcome == NO_ITEM) return no_item(instance, is_stepping ? most : ERROR, *broken, function);
    if (outcome == TOO_MANY_STEPS)
        return refuse(instance, ERROR,
                      "%s: communication step size %s s: expected at most %s internal steps", function,
                      DECIMAL(h), DECIMAL(MOST_INTERNAL_STEPS));
    if (!is_stepping)
        return refuse(instance, ERROR,
                      "%s: parameters and inputs of " MODEL_NAME ": state or outputs are not finite at the start",
                      function);
    return refuse(instance, most,
                  "%s at %s s: state or outputs are not finite any more; take shorter steps", function,
                  DECIMAL(instance->data.time));
}

#endif
