/* An instance from its beginning to its end. */

#ifndef LIFECYCLE_H
#define LIFECYCLE_H

#include "refusals.h"

static void *cannot_instantiate(const Log *log, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    log_send(log, ERROR, format, arguments);
    va_end(arguments);
    return NULL;
}

static void instance_reset(Instance *instance) {
    const int64_t face = instance->data.face;
    data_reset(&instance->data);
    instance->data.face = face == CO_SIMULATION ? CO_SIMULATION : INITIAL_EXCHANGE;
    instance->step_cache.is_stale = 1;
    instance->stop_time = DBL_MAX;
}

/* 2.1.5. The resources are not used: the model needs no file. The targets of the pointers are copied: they are valid
 * during the call only. `log` has no name of the instance yet. */
static void *instantiate(Log log, FMI(IntermediateUpdateCallback) after_step, Face face, const char *name,
                         const char *guid, const char *function) {
    Instance *instance;
    log.instance = name ? name : "";
    if (!log.instance[strspn(log.instance, " \t\n\v\f\r")])
        return cannot_instantiate(&log, "%s: expected an instance name", function);
    if (!guid || strcmp(guid, MODEL_GUID))
        return cannot_instantiate(&log, "%s: " GUID_NAME " %s: expected %s", function, guid ? guid : "NULL",
                                  MODEL_GUID);
    instance = calloc(1, sizeof *instance + strlen(name) + 1);
    if (!instance) return cannot_instantiate(&log, "%s: no memory", function);
    log.instance = strcpy((char *)(instance + 1), name);
    instance->log = log;
    instance->after_step = after_step;
    instance->data.face = face;
    instance_reset(instance);
    return instance;
}

/* 2.1.5; 4.2.4: in every state but inside a step. NULL is ignored. */
void FMI(FreeInstance)(void *c) {
    if (is_allowed(c, OUTSIDE_STEPS, NAME(FreeInstance))) free(c);
}

/* 2.1.6; 4.2.4: when instantiated. The stop time must be after the start time, if it is defined. A tolerance is not
 * used: there is no solver with error control inside. */
static Status set_up(Instance *instance, double start, int is_stop_defined, double stop, const char *function) {
    if (!is_allowed(instance, INSTANTIATED, function)) return ERROR;
    if (!isfinite(start))
        return refuse(instance, ERROR, "%s: start time %s s: expected a finite number", function, DECIMAL(start));
    if (is_stop_defined && !(stop > start))
        return refuse(instance, ERROR, "%s: stop time %s s: expected more than the start time %s s", function,
                      DECIMAL(stop), DECIMAL(start));
    instance->data.time = start;
    instance->stop_time = is_stop_defined ? stop : DBL_MAX;
    instance->data.outputs_are_stale = 1;
    return OK;
}

static void begin(Data *d) {
    d->mode = d->face == CO_SIMULATION ? STEPPING : EVENT;
    if (d->face != CO_SIMULATION) d->face = EXCHANGE;
    d->start_time = d->time;
}

/* 2.1.6; 4.2.4: in initialization mode. 4.1.2: the state and outputs of the start are computed here at the latest. */
Status FMI(ExitInitializationMode)(void *c) {
    Instance *instance = c;
    Status status;
    int broken = 0;
    if (!is_allowed(instance, INITIALIZATION, NAME(ExitInitializationMode))) return ERROR;
    status = report(instance, data_refresh(&instance->data, &broken), &broken, NAME(ExitInitializationMode), 0, ERROR);
    if (status == OK) begin(&instance->data);
    return status;
}

/* 2.1.6; 3.2.3, 4.2.4: when a step is complete; in event mode and in continuous-time mode. */
Status FMI(Terminate)(void *c) {
    Instance *instance = c;
    if (!is_allowed(instance, STEPPING | EVENT | CONTINUOUS_TIME, NAME(Terminate))) return ERROR;
    instance->data.mode = TERMINATED;
    return OK;
}

/* 2.1.6; 4.2.4: in every state but inside a step. As after the instantiation, also from an error; the log categories
 * stay. */
Status FMI(Reset)(void *c) {
    Instance *instance = c;
    if (!is_allowed(instance, OUTSIDE_STEPS, NAME(Reset))) return ERROR;
    instance_reset(instance);
    return OK;
}

#endif
