/* FMI 2.0.5 for co-simulation: checks of calls and arguments around an instance of the model.
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
 * 2.1: an instance is one block of memory, there are no globals, no setting of the process or thread is changed.
 */

#include "instance.h"
#include "log.h"
#include "snapshot.h"

typedef struct {
    Data data;
    StepConstants step_constants;
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
                                    : "error";
}

static int is_allowed(Instance *instance, int modes, const char *function) {
    if (!instance) return 0;
    if (instance->data.mode & modes) return 1;
    refuse(instance, fmi2Error, "%s is not allowed in the state '%s'", function, mode_name((int)instance->data.mode));
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
    const int is_stepping = instance->data.mode == STEPPING;
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

/* Values */

/* 4.2.4: what can be inquired; after an error for debugging only. */
enum {
    HAS_STEPPED = STEPPING | TERMINATED | IN_ERROR,
    IS_INITIALIZED = INITIALIZATION | HAS_STEPPED,
    READABLE = INSTANTIATED | IS_INITIALIZED
};

static int has_type(fmi2ValueReference reference, Type type) {
    return reference < N_VARIABLES && VARIABLES[reference].type == type;
}

static fmi2Status not_of_type(Instance *instance, Type type, fmi2ValueReference reference, const char *function) {
    if (reference >= N_VARIABLES)
        return refuse(instance, fmi2Error, "%s: value reference %u: expected 0..%d of " MODEL_NAME, function, reference,
                      N_VARIABLES - 1);
    return refuse(instance, fmi2Error, "%s: %s is %s: expected %s", function, VARIABLES[reference].name,
                  TYPE_NAMES[VARIABLES[reference].type], TYPE_NAMES[type]);
}

static int are_given(Instance *instance, const fmi2ValueReference references[], size_t count, const void *values,
                     const char *function) {
    if (!count || (references && values)) return 1;
    missing(instance, function, references ? "value" : "vr");
    return 0;
}

static int are_of_type(Instance *instance, Type type, const fmi2ValueReference references[], size_t count,
                       const char *function) {
    for (size_t i = 0; i < count; i++) {
        if (has_type(references[i], type)) continue;
        not_of_type(instance, type, references[i], function);
        return 0;
    }
    return 1;
}

static int are_allowed(Instance *instance, int modes, Type type, const fmi2ValueReference references[], size_t count,
                       const void *values, const char *function) {
    return is_allowed(instance, modes, function) && are_given(instance, references, count, values, function) &&
           are_of_type(instance, type, references, count, function);
}

/* 2.1.7: until stepping begins, calculated values follow the values that are set, also after an error; later they
 * are those of the last step, and nothing is stale (4.2.4: no fmi2GetXXX after fmi2SetXXX without a step). */
static fmi2Status refreshed(Instance *instance, const fmi2ValueReference references[], size_t count,
                            const char *function) {
    int broken = 0;
    if (!instance->data.outputs_are_stale) return fmi2OK;
    for (size_t i = 0; i < count; i++)
        if (!is_settable((int)references[i]))
            return report(instance, data_refresh(&instance->data, &broken), &broken, function, 0);
    return fmi2OK;
}

static int can_be_set(const Data *d, fmi2ValueReference reference, Type type, double value) {
    return has_type(reference, type) && (d->mode & VARIABLES[reference].settable) &&
           is_acceptable((int)reference, value);
}

/* Refuses the first wrong type, or else the value at `place`, which is the first refused value.
 * 2.1.2: a value reference that cannot be set is an error; 2.1.7: a value out of range may be discarded. */
static fmi2Status cannot_be_set(Instance *instance, Type type, const fmi2ValueReference references[], size_t count,
                                size_t place, double value, const char *function) {
    if (!are_of_type(instance, type, references, count, function)) return fmi2Error;
    const Variable *v = VARIABLES + references[place];
    if (v->settable == NEVER)
        return refuse(instance, fmi2Error, "%s: %s can not be set, it is calculated", function, v->name);
    if (!(instance->data.mode & v->settable))
        return refuse(instance, fmi2Error, "%s: %s is fixed, set it before the initialization ends", function, v->name);
    return refuse(instance, fmi2Discard, "%s: %s = %s: expected %s", function, v->name, DECIMAL(value), v->expected);
}

#define DEFINE_GET(Name, CType, TYPE)                                                                            \
    fmi2Status fmi2Get##Name(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, CType value[]) {        \
        Instance *instance = c;                                                                                        \
        fmi2Status status;                                                                                       \
        if (!are_allowed(instance, READABLE, TYPE, vr, nvr, value, "fmi2Get" #Name)) return fmi2Error;                 \
        status = refreshed(instance, vr, nvr, "fmi2Get" #Name);                                                        \
        if (status != fmi2OK) return status;                                                                     \
        for (size_t i = 0; i < nvr; i++) value[i] = (CType)instance->data.value[vr[i]];                                \
        return fmi2OK;                                                                                           \
    }

/* Sets all values or none: a refused value leaves every variable as it was. 4.2.4: in 'step complete' only inputs
 * and tunable parameters, which `settable` of a variable says. */
#define DEFINE_SET(Name, CType, TYPE)                                                                            \
    fmi2Status fmi2Set##Name(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const CType value[]) {  \
        Instance *instance = c;                                                                                        \
        if (!is_allowed(instance, ALWAYS, "fmi2Set" #Name)) return fmi2Error;                                          \
        if (!are_given(instance, vr, nvr, value, "fmi2Set" #Name)) return fmi2Error;                                   \
        for (size_t i = 0; i < nvr; i++)                                                                         \
            if (!can_be_set(&instance->data, vr[i], TYPE, (double)value[i]))                                           \
                return cannot_be_set(instance, TYPE, vr, nvr, i, (double)value[i], "fmi2Set" #Name);                   \
        for (size_t i = 0; i < nvr; i++)                                                                         \
            data_set(&instance->data, &instance->step_constants, (int)vr[i], (double)value[i]);                  \
        return fmi2OK;                                                                                           \
    }

DEFINE_GET(Real, fmi2Real, REAL)
DEFINE_GET(Integer, fmi2Integer, INTEGER)
DEFINE_GET(Boolean, fmi2Boolean, BOOLEAN)
DEFINE_SET(Real, fmi2Real, REAL)
DEFINE_SET(Integer, fmi2Integer, INTEGER)
DEFINE_SET(Boolean, fmi2Boolean, BOOLEAN)

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

/* Inquiry, creation, destruction */

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
    data_reset(&instance->data);
    instance->step_constants.are_stale = 1;
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
    if (fmuType != fmi2CoSimulation) {
        cannot_instantiate(functions, instanceName, "fmi2Instantiate: fmuType %d: expected fmi2CoSimulation", fmuType);
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
    instance_reset(instance);
    return instance;
}

/* 2.1.5: NULL is ignored. */
void fmi2FreeInstance(fmi2Component c) { free(c); }

/* Modes (2.1.6) */

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

/* Without a setup before, the start time is 0. */
fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    Instance *instance = c;
    if (!is_allowed(instance, INSTANTIATED, "fmi2EnterInitializationMode")) return fmi2Error;
    instance->data.mode = INITIALIZATION;
    return fmi2OK;
}

/* 4.1.2: the state and outputs of the start are computed here at the latest. */
fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    Instance *instance = c;
    fmi2Status status;
    int broken = 0;
    if (!is_allowed(instance, INITIALIZATION, "fmi2ExitInitializationMode")) return fmi2Error;
    status = report(instance, data_refresh(&instance->data, &broken), &broken, "fmi2ExitInitializationMode", 0);
    if (status == fmi2OK) instance->data.mode = STEPPING;
    return status;
}

fmi2Status fmi2Terminate(fmi2Component c) {
    Instance *instance = c;
    if (!is_allowed(instance, STEPPING, "fmi2Terminate")) return fmi2Error;
    instance->data.mode = TERMINATED;
    return fmi2OK;
}

/* As after fmi2Instantiate, also from an error; the log categories stay. */
fmi2Status fmi2Reset(fmi2Component c) {
    Instance *instance = c;
    if (!instance) return fmi2Error;
    instance_reset(instance);
    return fmi2OK;
}

/* Steps (4.2.1, 4.2.2) */

/* The tolerance of a communication point: far less than a step, but more than the rounding of the importer. */
static double tolerance_at(double t, double h) {
    return fmin(1e-9 * fmax(1, fabs(t)), 1e-3 * h) + 8 * DBL_EPSILON * fabs(t);
}

/* Exactly to the current communication point plus the step size, which is greater than 0; 2.1.6: past the stop time is
 * an error; 2.1.5: stepFinished, if it is given, is called after a completed step. */
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
    const Outcome outcome = data_step(&instance->data, &instance->step_constants, t, h, &broken);
    if (outcome != DONE) return report(instance, outcome, &broken, "fmi2DoStep", h);
    if (instance->step_finished) instance->step_finished(instance->log.environment, fmi2OK);
    return fmi2OK;
}

fmi2Status fmi2CancelStep(fmi2Component c) {
    return c ? refuse(c, fmi2Error, "fmi2CancelStep: expected a step in progress; steps are never asynchronous")
             : fmi2Error;
}

/* 4.2.1: order 0 is not allowed. */
static int are_orders(Instance *instance, const fmi2ValueReference references[], const fmi2Integer order[],
                      size_t count, const char *function) {
    if (count && !order) return missing(instance, function, "order"), 0;
    for (size_t i = 0; i < count; i++) {
        if (order[i] >= 1) continue;
        refuse(instance, fmi2Error, "%s: %s: order %d: expected at least 1", function, VARIABLES[references[i]].name,
               order[i]);
        return 0;
    }
    return 1;
}

/* 4.2.1: allowed when fmi2SetReal is, valid for the next step. Inputs move in straight lines: a derivative of higher
 * order is left out, with a warning. */
fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                       const fmi2Integer order[], const fmi2Real value[]) {
    static const char *const function = "fmi2SetRealInputDerivatives";
    Instance *instance = c;
    fmi2Status status = fmi2OK;
    if (!are_allowed(instance, ALWAYS, REAL, vr, nvr, value, function)) return fmi2Error;
    if (!are_orders(instance, vr, order, nvr, function)) return fmi2Error;
    for (size_t i = 0; i < nvr; i++) {
        const char *name = VARIABLES[vr[i]].name;
        if (!is_input(vr[i])) return refuse(instance, fmi2Error, "%s: %s: expected an input", function, name);
        if (VARIABLES[vr[i]].whole || VARIABLES[vr[i]].items)
            return refuse(instance, fmi2Error, "%s: %s: expected a continuous input", function, name);
        if (!isfinite(value[i]))
            return refuse(instance, fmi2Error, "%s: %s: derivative %s: expected a finite number", function, name,
                          DECIMAL(value[i]));
    }
    for (size_t i = 0; i < nvr; i++) {
        if (order[i] == 1)
            instance->data.input_rate[vr[i] - FIRST_INPUT] = value[i], instance->data.inputs_have_rates = 1;
        else
            status = refuse(instance, fmi2Warning, "%s: %s: order %d is left out: expected 1", function,
                            VARIABLES[vr[i]].name, order[i]);
    }
    return status;
}

/* 4.2.1: at the current time of the instance; a derivative of an order above maxOutputDerivativeOrder is 0. */
fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                        const fmi2Integer order[], fmi2Real value[]) {
    static const char *const function = "fmi2GetRealOutputDerivatives";
    Instance *instance = c;
    const double *v, *calculated;
    double fresh[N_CALCULATED + 1], rate[N_OUTPUTS + 1];
    int broken = 0;
    if (!are_allowed(instance, HAS_STEPPED, REAL, vr, nvr, value, function)) return fmi2Error;
    if (!are_orders(instance, vr, order, nvr, function)) return fmi2Error;
    for (size_t i = 0; i < nvr; i++)
        if (vr[i] < FIRST_OUTPUT)
            return refuse(instance, fmi2Error, "%s: %s: expected an output", function, VARIABLES[vr[i]].name);
    v = instance->data.value;
    calculated = data_calculated(&instance->data, fresh, &broken);
    if (!calculated) return contradictory(instance, broken, function);
    model_output_rate(instance->data.time, instance->data.state, v + FIRST_INPUT, v, calculated, rate);
    for (size_t i = 0; i < nvr; i++) value[i] = order[i] == 1 ? rate[vr[i] - FIRST_OUTPUT] : 0;
    return fmi2OK;
}

/* 2.1.9. In initialization mode of what is calculated by parameters and inputs; later, the state held, by
 * parameters alone: at a communication point no output depends directly on an input. */
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[], size_t nUnknown,
                                        const fmi2ValueReference vKnown_ref[], size_t nKnown, const fmi2Real dvKnown[],
                                        fmi2Real dvUnknown[]) {
    static const char *const function = "fmi2GetDirectionalDerivative";
    Instance *instance = c;
    double seed[N_PARAMETERS + N_INPUTS + 1] = {0}, along[N_CALCULATED + N_OUTPUTS + 1];
    if (!are_allowed(instance, IS_INITIALIZED, REAL, vUnknown_ref, nUnknown, dvUnknown, function)) return fmi2Error;
    if (!are_allowed(instance, IS_INITIALIZED, REAL, vKnown_ref, nKnown, dvKnown, function)) return fmi2Error;
    for (size_t i = 0; i < nUnknown; i++)
        if (is_settable((int)vUnknown_ref[i]))
            return refuse(instance, fmi2Error, "%s: unknown %s: expected an output or a calculated parameter", function,
                          VARIABLES[vUnknown_ref[i]].name);
    for (size_t i = 0; i < nKnown; i++) {
        const int reference = (int)vKnown_ref[i];
        if (!is_settable(reference))
            return refuse(instance, fmi2Error, "%s: known %s: expected a parameter or an input", function,
                          VARIABLES[reference].name);
        seed[reference < FIRST_CALCULATED ? reference : reference - N_CALCULATED] += dvKnown[i];
    }
    if (instance->data.mode == INITIALIZATION) {
        int broken = 0;
        const fmi2Status status = report(instance, data_refresh(&instance->data, &broken), &broken, function, 0);
        if (status != fmi2OK) return status;
        model_initial_derivative(instance->data.time, instance->data.value, instance->data.value + FIRST_INPUT,
                                 seed, along);
    } else {
        model_output_derivative(instance->data.time, instance->data.state, instance->data.value, seed, along);
    }
    for (size_t i = 0; i < nUnknown; i++) {
        const int reference = (int)vUnknown_ref[i];
        const int output = reference - FIRST_OUTPUT;
        dvUnknown[i] = along[output < 0 ? reference - FIRST_CALCULATED : output + N_CALCULATED];
    }
    return fmi2OK;
}

/* 4.2.3. No step is ever pending: only the last successful time and the end are available; a status that cannot be
 * given is discarded. */

static fmi2Status no_status(Instance *instance, fmi2StatusKind kind, const char *function) {
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

/* Saved states (2.1.8), in every state of the instance */

static const Snapshot *own_snapshot(Instance *instance, fmi2FMUstate FMUstate, const char *function) {
    const Snapshot *snapshot = FMUstate;
    if (!instance) return NULL;
    if (snapshot && !strcmp(snapshot->guid, MODEL_GUID)) return snapshot;
    refuse(instance, fmi2Error, snapshot ? "%s: the state is another FMU's" : "%s: FMUstate is NULL", function);
    return NULL;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) {
    Instance *instance = c;
    Snapshot *snapshot;
    if (!instance) return fmi2Error;
    if (!FMUstate) return missing(instance, "fmi2GetFMUstate", "FMUstate");
    if (*FMUstate && !own_snapshot(instance, *FMUstate, "fmi2GetFMUstate")) return fmi2Error;
    snapshot = *FMUstate ? *FMUstate : calloc(1, sizeof *snapshot);
    if (!snapshot) return refuse(instance, fmi2Error, "fmi2GetFMUstate: no memory");
    memcpy(snapshot->guid, MODEL_GUID, sizeof snapshot->guid);
    snapshot->data = instance->data;
    *FMUstate = snapshot;
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate) {
    const Snapshot *snapshot = own_snapshot(c, FMUstate, "fmi2SetFMUstate");
    if (!snapshot) return fmi2Error;
    ((Instance *)c)->data = snapshot->data;
    ((Instance *)c)->step_constants.are_stale = 1;
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) {
    Instance *instance = c;
    if (!instance) return fmi2Error;
    if (!FMUstate || !*FMUstate) return fmi2OK; /* 2.1.8: ignored */
    free(*FMUstate);
    *FMUstate = NULL;
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size) {
    if (!own_snapshot(c, FMUstate, "fmi2SerializedFMUstateSize")) return fmi2Error;
    if (!size) return missing(c, "fmi2SerializedFMUstateSize", "size");
    *size = SERIALIZED_SIZE;
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[], size_t size) {
    const Snapshot *snapshot = own_snapshot(c, FMUstate, "fmi2SerializeFMUstate");
    if (!snapshot) return fmi2Error;
    if (!serializedState) return missing(c, "fmi2SerializeFMUstate", "serializedState");
    if (size < SERIALIZED_SIZE)
        return refuse(c, fmi2Error, "fmi2SerializeFMUstate: size %lu: expected %d", (unsigned long)size,
                      (int)SERIALIZED_SIZE);
    serialize(snapshot, (unsigned char *)serializedState);
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size,
                                   fmi2FMUstate *FMUstate) {
    Instance *instance = c;
    Snapshot restored;
    const char *reason;
    if (!instance) return fmi2Error;
    if (!serializedState) return missing(instance, "fmi2DeSerializeFMUstate", "serializedState");
    if (!FMUstate) return missing(instance, "fmi2DeSerializeFMUstate", "FMUstate");
    if (*FMUstate && !own_snapshot(instance, *FMUstate, "fmi2DeSerializeFMUstate")) return fmi2Error;
    reason = deserialize((const unsigned char *)serializedState, size, &restored);
    if (reason) return refuse(instance, fmi2Error, "fmi2DeSerializeFMUstate: %s", reason);
    if (!*FMUstate) *FMUstate = calloc(1, sizeof restored);
    if (!*FMUstate) return refuse(instance, fmi2Error, "fmi2DeSerializeFMUstate: no memory");
    *(Snapshot *)*FMUstate = restored;
    return fmi2OK;
}
