/* FMI 2.0.5 for co-simulation and model exchange: checks of calls and arguments around an instance of the model.
 *
 * Statuses (2.1.3):
 *   ok        done
 *   warning   done but for a part that the message names: an unknown log category, a derivative of higher order
 *   discard   fmi2SetXXX with a value out of range, fmi2DoStep that reaches no finite end (4.2.2: a shorter step
 *             can be tried), fmi2GetXXXStatus without that status (4.2.3); nothing has changed. No other function
 *             of co-simulation may return it
 *   error     every other refusal; nothing has changed, but only to read, restore, reset or free is allowed then
 *   fatal     never: no call can damage an instance
 *   pending   never: steps are synchronous (4.3.1, canRunAsynchronuously is false)
 *
 * States (4.2.4, table of allowed calls): each function names those in which it is allowed. Two are wider than the
 * table, which binds the importer: values can be read and inputs set also in 'instantiated', as some importers do;
 * and 'step failed' is 'step complete', because a step that is discarded has changed nothing.
 *
 * This is the one file to compile: functions of FMI stand here and in values.h, steps.h, exchange.h, derivatives.h and states.h.
 *
 * 2.1: an instance is one block of memory, there are no globals, no setting of the process or thread is changed.
 */

#include "derivatives.h"
#include "exchange.h"
#include "refusals.h"
#include "states.h"
#include "steps.h"
#include "values.h"

/* 2.1.4; 4.2.4: in every state, also without an instance. */
const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

/* 2.1.5: the named categories are switched on, and no others; or off; without names all. The warning of an unknown
 * one is sent before that. */
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories,
                               const fmi2String categories[]) {
    Instance *instance = c;
    fmi2Status status = fmi2OK;
    unsigned named = 0;
    if (!instance) return fmi2Error;
    if (nCategories && !categories) return missing(instance, "fmi2SetDebugLogging", "categories");
    for (size_t i = 0; i < nCategories; i++) {
        named |= log_category(categories[i]);
        if (!log_category(categories[i]))
            status = refuse(instance, fmi2Warning,
                            "fmi2SetDebugLogging: log category '%s': expected one of the model description",
                            categories[i] ? categories[i] : "NULL");
    }
    instance->log.enabled = !nCategories ? log_mask(loggingOn) : loggingOn ? named : instance->log.enabled & ~named;
    return status;
}

static void cannot_instantiate(const fmi2CallbackFunctions *functions, fmi2String name, const char *format, ...) {
    const Log log = {functions->logger, functions->componentEnvironment, name ? name : "", LOG_ALL};
    va_list arguments;
    va_start(arguments, format);
    log_send(&log, fmi2Error, format, arguments);
    va_end(arguments);
}

static void instance_reset(Instance *instance) {
    const int64_t face = instance->data.face;
    data_reset(&instance->data);
    instance->data.face = face == CO_SIMULATION ? CO_SIMULATION : INITIAL_EXCHANGE;
    instance->step_cache.is_stale = 1;
    instance->stop_time = DBL_MAX;
}

/* 2.1.5. The resource location is not used: the model needs no file. What the pointers point to is copied: it is valid
 * during the call only. canNotUseMemoryManagementFunctions is true: the importer's memory functions are not used. */
fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn) {
    Instance *instance;
    char *name;
    (void)fmuResourceLocation, (void)visible;
    if (!functions) return NULL;
    if (!instanceName || !instanceName[strspn(instanceName, " \t\n\v\f\r")]) {
        cannot_instantiate(functions, instanceName, "fmi2Instantiate: expected an instance name");
        return NULL;
    }
    if (fmuType != fmi2CoSimulation && fmuType != fmi2ModelExchange) {
        cannot_instantiate(functions, instanceName,
                           "fmi2Instantiate: fmuType %d: expected fmi2CoSimulation or fmi2ModelExchange", fmuType);
        return NULL;
    }
    if (!fmuGUID || strcmp(fmuGUID, MODEL_GUID)) {
        cannot_instantiate(functions, instanceName, "fmi2Instantiate: GUID %s: expected %s", fmuGUID ? fmuGUID : "NULL",
                           MODEL_GUID);
        return NULL;
    }
    instance = calloc(1, sizeof *instance + strlen(instanceName) + 1);
    if (!instance) {
        cannot_instantiate(functions, instanceName, "fmi2Instantiate: no memory");
        return NULL;
    }
    name = strcpy((char *)(instance + 1), instanceName);
    instance->log = (Log){functions->logger, functions->componentEnvironment, name, log_mask(loggingOn)};
    instance->step_finished = functions->stepFinished;
    instance->data.face = fmuType == fmi2CoSimulation ? CO_SIMULATION : INITIAL_EXCHANGE;
    instance_reset(instance);
    return instance;
}

/* 2.1.5; 4.2.4: in every state. NULL is ignored. */
void fmi2FreeInstance(fmi2Component c) { free(c); }

/* 2.1.6; 4.2.4: when instantiated. The stop time must be after the start time, if it is defined. */
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
                               fmi2Boolean stopTimeDefined, fmi2Real stopTime) {
    Instance *instance = c;
    (void)toleranceDefined, (void)tolerance; /* may be ignored: no solver with error control inside */
    if (!is_allowed(instance, INSTANTIATED, "fmi2SetupExperiment")) return fmi2Error;
    if (!isfinite(startTime))
        return refuse(instance, fmi2Error, "fmi2SetupExperiment: start time %s s: expected a finite number",
                      DECIMAL(startTime));
    if (stopTimeDefined && !(stopTime > startTime))
        return refuse(instance, fmi2Error,
                      "fmi2SetupExperiment: stop time %s s: expected more than the start time %s s",
                      DECIMAL(stopTime), DECIMAL(startTime));
    instance->data.time = startTime;
    instance->stop_time = stopTimeDefined ? stopTime : DBL_MAX;
    instance->data.outputs_are_stale = 1;
    return fmi2OK;
}

/* 2.1.6; 4.2.4: when instantiated. Without a setup before, the start time is 0. */
fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    Instance *instance = c;
    if (!is_allowed(instance, INSTANTIATED, "fmi2EnterInitializationMode")) return fmi2Error;
    instance->data.mode = INITIALIZATION;
    return fmi2OK;
}

static void begin(Data *d) {
    d->mode = d->face == CO_SIMULATION ? STEPPING : EVENT;
    if (d->face != CO_SIMULATION) d->face = EXCHANGE;
    d->start_time = d->time;
}

/* 2.1.6; 4.2.4: in initialization mode. 4.1.2: the state and outputs of the start are computed here at the latest. */
fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    Instance *instance = c;
    fmi2Status status;
    int broken = 0;
    if (!is_allowed(instance, INITIALIZATION, "fmi2ExitInitializationMode")) return fmi2Error;
    status = report(instance, data_refresh(&instance->data, &broken), &broken, "fmi2ExitInitializationMode", 0);
    if (status == fmi2OK) begin(&instance->data);
    return status;
}

/* 2.1.6; 3.2.3, 4.2.4: when a step is complete; in event mode and in continuous-time mode. */
fmi2Status fmi2Terminate(fmi2Component c) {
    Instance *instance = c;
    if (!is_allowed(instance, STEPPING | EVENT | CONTINUOUS_TIME, "fmi2Terminate")) return fmi2Error;
    instance->data.mode = TERMINATED;
    return fmi2OK;
}

/* 2.1.6; 4.2.4: in every state. As after fmi2Instantiate, also from an error; the log categories stay. */
fmi2Status fmi2Reset(fmi2Component c) {
    Instance *instance = c;
    if (!instance) return fmi2Error;
    instance_reset(instance);
    return fmi2OK;
}
