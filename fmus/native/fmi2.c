/* FMI 2.0.5 for co-simulation and model exchange: checks of calls and arguments around an instance of the model.
 *
 * Statuses (2.1.3):
 *   ok        done
 *   warning   done but for a part that the message names: an unknown log category, a derivative of higher order
 *   discard   fmi2SetXXX with a value out of range that is no start value, fmi2DoStep that reaches no finite end
 *             (4.2.2: a shorter step can be tried), fmi2GetXXXStatus without that status (4.2.3); nothing has
 *             changed. No other function of co-simulation may return it
 *   error     every other refusal; nothing has changed, but only to read, restore, reset or free is allowed then
 *   fatal     never: no call can damage an instance
 *   pending   never: steps are synchronous (4.3.1, canRunAsynchronuously is false)
 *
 * States (4.2.4, table of allowed calls): each function names those in which it is allowed. Two are wider than the
 * table, which binds the importer: values can be read and inputs set also in 'instantiated', as some importers do;
 * and 'step failed' is 'step complete', because a step that is discarded has changed nothing.
 *
 * This is the one file to compile. Functions that FMI 3.0 has too stand in lifecycle.h, states.h and exchange.h.
 *
 * 2.1: an instance is one block of memory, there are no globals, no setting of the process or thread is changed.
 */

#define STANDARD fmi2
#define TYPE_NAMES "Real", "Integer or Enumeration", "Boolean"
#define GUID_NAME "GUID"
#define EVENT_TOO EVENT /* functions of continuous-time mode that event mode allows too */
#define INSIDE_STEPS 0 /* modes of callbacks in a step */
#define LOG_ESCAPED "%#" /* 2.1.5: the message is a format of printf, in which #r1# is a variable */
/* Names of FMI 3.0 that are others in FMI 2.0. */
#define FMUState FMUstate
#define GetFMUState GetFMUstate
#define SetFMUState SetFMUstate
#define FreeFMUState FreeFMUstate
#define SerializedFMUStateSize SerializedFMUstateSize
#define SerializeFMUState SerializeFMUstate
#define DeserializeFMUState DeSerializeFMUstate
#define GetContinuousStateDerivatives GetDerivatives
#define LogMessageCallback CallbackLogger
#define IntermediateUpdateCallback StepFinished /* called after a step */

#include "derivatives.h"
#include "exchange.h"
#include "lifecycle.h"
#include "states.h"
#include "steps.h"
#include "values.h"

/* 2.1.4; 4.2.4: in every state, also without an instance. */
const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

/* 2.1.3: errors are always for the user; discards are shown in debug mode. */
static unsigned log_mask(fmi2Boolean logging_on) { return logging_on ? LOG_ALL : LOG_ALL & ~LOG_DISCARD; }

static void log_deliver(const Log *log, fmi2Status status, const char *category, const char *text) {
    log->logger(log->environment, log->instance, status, category, text);
}

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

/* 2.1.5. canNotUseMemoryManagementFunctions is true: the importer's memory functions are not used. */
fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn) {
    (void)fmuResourceLocation, (void)visible;
    if (!functions) return NULL;
    const Log log = {functions->logger, functions->componentEnvironment, instanceName ? instanceName : "", LOG_ALL};
    if (fmuType != fmi2CoSimulation && fmuType != fmi2ModelExchange)
        return cannot_instantiate(
            &log, "fmi2Instantiate: fmuType %d: expected fmi2CoSimulation or fmi2ModelExchange", fmuType);
    Instance *instance = instantiate(log, functions->stepFinished,
                                     fmuType == fmi2CoSimulation ? CO_SIMULATION : INITIAL_EXCHANGE, instanceName,
                                     fmuGUID, "fmi2Instantiate");
    if (instance) instance->log.enabled = log_mask(loggingOn);
    return instance;
}

/* 2.1.6; 4.2.4: when instantiated. */
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
                               fmi2Boolean stopTimeDefined, fmi2Real stopTime) {
    (void)toleranceDefined, (void)tolerance;
    return set_up(c, startTime, stopTimeDefined, stopTime, "fmi2SetupExperiment");
}

/* 2.1.6; 4.2.4: when instantiated. Without a setup before, the start time is 0. */
fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    Instance *instance = c;
    if (!is_allowed(instance, INSTANTIATED, "fmi2EnterInitializationMode")) return fmi2Error;
    instance->data.mode = INITIALIZATION;
    return fmi2OK;
}

/* Whether it has this type and a value that is held. */
static int is_value(unsigned reference, Type type) { return reference < N_VALUES && ACCESS[reference].type == type; }

/* Also continuous states and their derivatives, which are Reals and calculated when they are read. */
static fmi2Status get_with_locals(Instance *instance, Type type, const fmi2ValueReference vr[], size_t nvr,
                                  fmi2Real value[], const char *function) {
    double locals[N_VARIABLES - N_VALUES + 1] = {0};
    if (!are_of_type(instance, type, vr, nvr, function)) return fmi2Error;
    const fmi2Status status = get_locals(instance, locals, function);
    if (status != fmi2OK) return status;
    for (size_t i = 0; i < nvr; i++)
        value[i] = vr[i] < N_VALUES ? instance->data.value[vr[i]] : locals[vr[i] - N_VALUES];
    return fmi2OK;
}

/* 2.1.7; 4.2.4: from initialization mode on; here also when instantiated. */
#define DEFINE_GET(Name, CType, TYPE)                                                                           \
    fmi2Status fmi2Get##Name(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, CType value[]) {       \
        Instance *instance = c;                                                                                 \
        if (!is_allowed(instance, READABLE, "fmi2Get" #Name)) return fmi2Error;                                 \
        if (!are_given(instance, vr, nvr, value, "fmi2Get" #Name)) return fmi2Error;                            \
        if (instance->data.outputs_are_stale) {                                                                 \
            const fmi2Status status = refreshed(instance, TYPE, vr, nvr, "fmi2Get" #Name);                      \
            if (status != fmi2OK) return status;                                                                \
        }                                                                                                       \
        for (size_t i = 0; i < nvr; i++)                                                                        \
            if (!is_value(vr[i], TYPE))                                                                         \
                return get_with_locals(instance, TYPE, vr, nvr, (fmi2Real *)value, "fmi2Get" #Name);            \
        for (size_t i = 0; i < nvr; i++) value[i] = (CType)instance->data.value[vr[i]];                         \
        return fmi2OK;                                                                                          \
    }

/* 2.1.7. Sets all values or none: a refused value leaves every variable as it was. 4.2.4: until the end of the
 * initialization, and in 'step complete' only inputs and tunable parameters: `settable` of a variable. */
#define DEFINE_SET(Name, CType, TYPE)                                                                           \
    fmi2Status fmi2Set##Name(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const CType value[]) { \
        Instance *instance = c;                                                                                 \
        if (!is_allowed(instance, ALWAYS, "fmi2Set" #Name)) return fmi2Error;                                   \
        if (!are_given(instance, vr, nvr, value, "fmi2Set" #Name)) return fmi2Error;                            \
        for (size_t i = 0; i < nvr; i++)                                                                        \
            if (!can_be_set(&instance->data, vr[i], TYPE, (double)value[i]))                                    \
                return cannot_be_set(instance, TYPE, vr, nvr, i, (double)value[i], "fmi2Set" #Name);            \
        for (size_t i = 0; i < nvr; i++)                                                                        \
            data_set(&instance->data, &instance->step_cache, (int)vr[i], (double)value[i]);                     \
        return fmi2OK;                                                                                          \
    }

DEFINE_GET(Real, fmi2Real, REAL)
DEFINE_GET(Integer, fmi2Integer, INTEGER)
DEFINE_GET(Boolean, fmi2Boolean, BOOLEAN)
DEFINE_SET(Real, fmi2Real, REAL)
DEFINE_SET(Integer, fmi2Integer, INTEGER)
DEFINE_SET(Boolean, fmi2Boolean, BOOLEAN)

/* 2.1.7: there are no variables of this type, so that only an empty list is accepted. */
static fmi2Status no_strings(Instance *instance, int modes, size_t count, const char *function) {
    if (!is_allowed(instance, modes, function)) return fmi2Error;
    return count ? refuse(instance, fmi2Error, "%s: " MODEL_NAME " has no String variables", function) : fmi2OK;
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2String value[]) {
    (void)vr, (void)value;
    return no_strings(c, READABLE, nvr, "fmi2GetString");
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2String value[]) {
    (void)vr, (void)value;
    return no_strings(c, ALWAYS, nvr, "fmi2SetString");
}

/* 4.2.2. 2.1.5: stepFinished, if it is given, is called after a completed step. */
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint) {
    Instance *instance = c;
    (void)noSetFMUStatePriorToCurrentPoint; /* a state is never kept by the FMU itself */
    const fmi2Status status = do_step(instance, currentCommunicationPoint, communicationStepSize);
    if (status == fmi2OK && instance->after_step) instance->after_step(instance->log.environment, fmi2OK);
    return status;
}

/* 4.2.2; 4.2.4: never, as no step is in progress when the importer calls. */
fmi2Status fmi2CancelStep(fmi2Component c) {
    return c ? refuse(c, fmi2Error, "fmi2CancelStep: expected a step in progress; steps are never asynchronous")
             : fmi2Error;
}

/* 4.2.3; 4.2.4: when a step is complete, and after the end. No step is ever pending: only the last successful time
 * and the end, which is never the model's, are available; a status that cannot be given is discarded. */
#define DEFINE_STATUS(Name, CType, is_available, status)                                                        \
    fmi2Status fmi2Get##Name(fmi2Component c, const fmi2StatusKind s, CType *value) {                           \
        Instance *instance = c;                                                                                 \
        if (!is_of(instance, CO_SIMULATION, "fmi2Get" #Name)) return fmi2Error;                                 \
        if (!is_allowed(instance, STEPPING | TERMINATED, "fmi2Get" #Name)) return fmi2Error;                    \
        if (!(is_available))                                                                                    \
            return refuse(instance, fmi2Discard,                                                                \
                          "fmi2Get" #Name ": status kind %d: not available, steps are never asynchronous", s);  \
        if (!value) return missing(instance, "fmi2Get" #Name, "value");                                         \
        *value = status;                                                                                        \
        return fmi2OK;                                                                                          \
    }

DEFINE_STATUS(Status, fmi2Status, 0, fmi2OK)
DEFINE_STATUS(RealStatus, fmi2Real, s == fmi2LastSuccessfulTime, instance->data.time)
DEFINE_STATUS(IntegerStatus, fmi2Integer, 0, 0)
DEFINE_STATUS(BooleanStatus, fmi2Boolean, s == fmi2Terminated, fmi2False)
DEFINE_STATUS(StringStatus, fmi2String, 0, NULL)

/* 3.2.2; 3.2.3: in event mode. */
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *fmi2eventInfo) {
    double next = 0;
    int jumped = 0;
    const fmi2Status status =
        update_discrete_states(c, fmi2eventInfo ? NULL : "fmi2eventInfo", &jumped, &next, "fmi2NewDiscreteStates");
    if (status != fmi2OK) return status;
    *fmi2eventInfo = (fmi2EventInfo){.valuesOfContinuousStatesChanged = jumped,
                                     .nextEventTimeDefined = isfinite(next),
                                     .nextEventTime = isfinite(next) ? next : 0};
    return fmi2OK;
}
