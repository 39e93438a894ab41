/* FMI 3.0.2 for co-simulation and model exchange: checks of calls and arguments around an instance of the model.
 *
 * Statuses (2.2.4): as in FMI 2.0, see fmi2.c; fmi3Discard leaves the instance as it was, and after fmi3Error only to
 * read, restore, reset or free is allowed. Numbers of clauses in shared headers refer to FMI 2.0.5.
 *
 * This is the one file to compile. lifecycle.h, states.h and exchange.h have the functions that FMI 2.0 has, too;
 * absent.h has the functions for features that the model does not have.
 *
 * 2.2.1: an instance is one block of memory, there are no globals, no setting of the process or thread is changed.
 */

#define STANDARD fmi3
#define TYPE_NAMES "Float64", "Int32", "Boolean", "Int64 or Enumeration"
#define GUID_NAME "instantiation token"
#define EVENT_TOO 0
#define INSIDE_STEPS (UPDATE_OF_INPUTS | UPDATE_OF_OUTPUTS | UPDATE_IN_ERROR)
#define LOG_ESCAPED "#" /* 2.3.1: #1# is a variable */

#include "absent.h"
#include "exchange.h"
#include "lifecycle.h"
#include "states.h"
#include "updates.h"
#include "values.h"

enum { N_REFERENCES = sizeof FIRST / sizeof *FIRST - 2 };

static int is_variable(unsigned reference) { return reference > 0 && reference <= N_REFERENCES; }

/* 2.2.5: in every state, also without an instance. */
const char *fmi3GetVersion(void) { return fmi3Version; }

static void log_deliver(const Log *log, fmi3Status status, const char *category, const char *text) {
    log->logger(log->environment, status, category, text);
}

/* 2.3.1: the named categories are switched on, or off; without names all. */
fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean loggingOn, size_t nCategories,
                               const fmi3String categories[]) {
    Instance *instance = c;
    unsigned named = nCategories ? 0 : LOG_ALL;
    if (!instance) return fmi3Error;
    if (nCategories && !categories) return missing(instance, "fmi3SetDebugLogging", "categories");
    for (size_t i = 0; i < nCategories; i++) {
        named |= log_category(categories[i]);
        if (!log_category(categories[i]))
            return refuse(instance, fmi3Error,
                          "fmi3SetDebugLogging: log category '%s': expected one of the model description",
                          categories[i] ? categories[i] : "NULL");
    }
    instance->log.enabled = loggingOn ? instance->log.enabled | named : instance->log.enabled & ~named;
    return fmi3OK;
}

/* 2.3.1: without `loggingOn` no message is sent, not even the reason of a refusal. */
fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken,
                                          fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                          fmi3InstanceEnvironment instanceEnvironment,
                                          fmi3LogMessageCallback logMessage) {
    const Log log = {logMessage, instanceEnvironment, "", loggingOn ? LOG_ALL : 0};
    (void)resourcePath, (void)visible;
    return instantiate(log, NULL, INITIAL_EXCHANGE, instanceName, instantiationToken, "fmi3InstantiateModelExchange");
}

/* 2.3.1: hasEventMode is false, so that `eventModeUsed` is an error. Which variables the importer will get and set in
 * intermediate updates makes no difference, but they must be of those that can be. */
fmi3Instance fmi3InstantiateCoSimulation(fmi3String instanceName, fmi3String instantiationToken,
                                         fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                         fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed,
                                         const fmi3ValueReference requiredIntermediateVariables[],
                                         size_t nRequiredIntermediateVariables,
                                         fmi3InstanceEnvironment instanceEnvironment,
                                         fmi3LogMessageCallback logMessage,
                                         fmi3IntermediateUpdateCallback intermediateUpdate) {
    static const char *const function = "fmi3InstantiateCoSimulation";
    const Log log = {logMessage, instanceEnvironment, "", loggingOn ? LOG_ALL : 0};
    (void)resourcePath, (void)visible;
    if (eventModeUsed) return cannot_instantiate(&log, "%s: eventModeUsed: expected false, there is no event mode", function);
    if (nRequiredIntermediateVariables && !requiredIntermediateVariables)
        return cannot_instantiate(&log, "%s: requiredIntermediateVariables is NULL", function);
    for (size_t i = 0; i < nRequiredIntermediateVariables; i++)
        if (!is_variable(requiredIntermediateVariables[i]) || !is_intermediate(FIRST[requiredIntermediateVariables[i]]))
            return cannot_instantiate(&log, "%s: value reference %u: expected a variable with intermediateUpdate",
                                      function, requiredIntermediateVariables[i]);
    Instance *instance =
        instantiate(log, intermediateUpdate, CO_SIMULATION, instanceName, instantiationToken, function);
    if (instance) instance->can_return_early = earlyReturnAllowed;
    return instance;
}

/* 2.3.1. */
fmi3Instance fmi3InstantiateScheduledExecution(fmi3String instanceName, fmi3String instantiationToken,
                                               fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                               fmi3InstanceEnvironment instanceEnvironment,
                                               fmi3LogMessageCallback logMessage, fmi3ClockUpdateCallback clockUpdate,
                                               fmi3LockPreemptionCallback lockPreemption,
                                               fmi3UnlockPreemptionCallback unlockPreemption) {
    const Log log = {logMessage, instanceEnvironment, "", loggingOn ? LOG_ALL : 0};
    (void)instanceName, (void)instantiationToken, (void)resourcePath, (void)visible;
    (void)clockUpdate, (void)lockPreemption, (void)unlockPreemption;
    return cannot_instantiate(&log, "fmi3InstantiateScheduledExecution: expected co-simulation or model exchange");
}

/* 2.3.2: when instantiated. */
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                       fmi3Float64 startTime, fmi3Boolean stopTimeDefined, fmi3Float64 stopTime) {
    (void)toleranceDefined, (void)tolerance;
    const fmi3Status status = set_up(c, startTime, stopTimeDefined, stopTime, "fmi3EnterInitializationMode");
    if (status == fmi3OK) ((Instance *)c)->data.mode = INITIALIZATION;
    return status;
}

/* Whether these are variables of a type, `n` numbers in all. */
static int are_elements(Instance *instance, int modes, Type type, const fmi3ValueReference vr[], size_t nvr,
                        const void *values, size_t n, const char *function) {
    size_t expected = 0;
    if (!is_allowed(instance, modes, function)) return 0;
    if (!are_given(instance, vr, nvr, values, function)) return 0;
    for (size_t i = 0; i < nvr; i++) {
        if (!is_variable(vr[i]))
            return refuse(instance, fmi3Error, "%s: value reference %u: expected 1..%d of " MODEL_NAME, function, vr[i],
                          N_REFERENCES), 0;
        const fmi3ValueReference first = FIRST[vr[i]];
        if (!are_of_type(instance, type, &first, 1, function)) return 0;
        if (instance->data.mode & INSIDE_STEPS && !is_intermediate(first))
            return refuse(instance, fmi3Error, "%s: %s: expected a variable with intermediateUpdate", function,
                          VARIABLES[first].name), 0;
        expected += FIRST[vr[i] + 1] - first;
    }
    if (n == expected) return 1;
    refuse(instance, fmi3Error, "%s: %lu values: expected %lu", function, (unsigned long)n, (unsigned long)expected);
    return 0;
}

static fmi3Status check_get(Instance *instance, Type type, const fmi3ValueReference vr[], size_t nvr,
                            const void *values, size_t n, const char *function) {
    if (!are_elements(instance, READABLE | UPDATE_OF_OUTPUTS, type, vr, nvr, values, n, function)) return fmi3Error;
    fmi3Status status = fmi3OK;
    for (size_t i = 0; i < nvr && status == fmi3OK && instance->data.outputs_are_stale; i++)
        status = refreshed(instance, type, FIRST + vr[i], 1, function);
    return status;
}

/* 2.2.7.2; 2.3, 4.2: from instantiation on. */
#define DEFINE_GET(Name, TYPE)                                                                                 \
    fmi3Status fmi3Get##Name(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, fmi3##Name values[],   \
                             size_t nValues) {                                                                 \
        const fmi3Status status = check_get(c, TYPE, vr, nvr, values, nValues, "fmi3Get" #Name);               \
        if (status != fmi3OK) return status;                                                                   \
        for (size_t i = 0; i < nvr; i++)                                                                       \
            for (unsigned r = FIRST[vr[i]]; r < FIRST[vr[i] + 1]; r++)                                         \
                *values++ = (fmi3##Name)((Instance *)c)->data.value[r];                                        \
        return fmi3OK;                                                                                         \
    }

/* 2.2.7.2. Sets all values or none: a refused value leaves every variable as it was. 2.3, 4.2.1: until the end of the
 * initialization, and in step mode only inputs and tunable parameters: `settable` of a variable. */
#define DEFINE_SET(Name, TYPE)                                                                                 \
    fmi3Status fmi3Set##Name(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr,                        \
                             const fmi3##Name values[], size_t nValues) {                                      \
        static const char *const function = "fmi3Set" #Name;                                                   \
        Instance *instance = c;                                                                                \
        const fmi3##Name *value = values;                                                                      \
        if (!are_elements(instance, ALWAYS, TYPE, vr, nvr, values, nValues, function)) return fmi3Error;       \
        for (size_t i = 0; i < nvr; i++)                                                                       \
            for (fmi3ValueReference r = FIRST[vr[i]]; r < FIRST[vr[i] + 1]; r++, value++)                      \
                if (!can_be_set(&instance->data, r, TYPE, (double)*value))                                     \
                    return cannot_be_set(instance, TYPE, &r, 1, 0, (double)*value, function);                  \
        for (size_t i = 0; i < nvr; i++)                                                                       \
            for (unsigned r = FIRST[vr[i]]; r < FIRST[vr[i] + 1]; r++)                                         \
                data_set(&instance->data, &instance->step_cache, (int)r, (double)*values++);                   \
        return fmi3OK;                                                                                         \
    }

DEFINE_GET(Int32, INTEGER)
DEFINE_GET(Boolean, BOOLEAN)
DEFINE_GET(Int64, ENUMERATION)
DEFINE_SET(Float64, REAL)
DEFINE_SET(Int32, INTEGER)
DEFINE_SET(Boolean, BOOLEAN)
DEFINE_SET(Int64, ENUMERATION)

/* 2.2.7.2; 2.3, 4.2: from instantiation on; also the time, continuous states, their derivatives, event indicators. */
fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, fmi3Float64 values[],
                          size_t nValues) {
    static const char *const function = "fmi3GetFloat64";
    double locals[N_VARIABLES - N_VALUES];
    int are_local = 0;
    fmi3Status status = check_get(c, REAL, vr, nvr, values, nValues, function);
    for (size_t i = 0; status == fmi3OK && i < nvr; i++) are_local |= FIRST[vr[i]] >= N_VALUES;
    if (are_local) status = get_locals(c, locals, function);
    if (status != fmi3OK) return status;
    for (size_t i = 0; i < nvr; i++) {
        const unsigned first = FIRST[vr[i]];
        const double *from = first < N_VALUES ? ((Instance *)c)->data.value + first : locals + (first - N_VALUES);
        for (unsigned j = first; j < FIRST[vr[i] + 1]; j++) *values++ = *from++;
    }
    return fmi3OK;
}

/* 2.2.12. In initialization mode, derivatives of all calculated variables by parameters, inputs and time; later, with
 * the rest of the state held, derivatives of outputs and state derivatives, by continuous states, too. */

#if !MODEL_HAS_DERIVATIVE /* outputs are the same at all times */
#define model_exchange_adjoint model_step_adjoint
#endif

static int is_known(unsigned reference, int is_initial) {
    return is_settable((int)reference) || reference == TIME || (is_state(reference) && !is_initial);
}

static int is_unknown(unsigned reference, int is_initial) {
    const int is_calculated = reference < TIME && !is_settable((int)reference);
    return is_calculated && (is_initial || (reference >= FIRST_OUTPUT && !is_state(reference)));
}

static int are_roles(Instance *instance, const fmi3ValueReference vr[], size_t nvr, int (*has_role)(unsigned, int),
                     const char *role, const char *function) {
    for (size_t i = 0; i < nvr; i++) {
        if (has_role(FIRST[vr[i]], instance->data.mode == INITIALIZATION)) continue;
        refuse(instance, fmi3Error, "%s: %s is no %s in this mode", function, VARIABLES[FIRST[vr[i]]].name, role);
        return 0;
    }
    return 1;
}

/* From the seeds of some variables to the sensitivities of others. */
static fmi3Status derive(Instance *instance, int is_adjoint, const fmi3ValueReference from[], size_t nFrom,
                         const fmi3Float64 seed[], size_t nSeed, const fmi3ValueReference to[], size_t nTo,
                         fmi3Float64 sensitivity[], size_t nSensitivity, const char *function) {
    static Derivatives *const functions[][2] = {{model_initial_forward, model_initial_adjoint},
                                                {model_step_forward, model_step_adjoint},
                                                {model_exchange_forward, model_exchange_adjoint}};
    double along[N_SEEDS] = {0}, result[N_SEEDS];
    if (!are_elements(instance, IS_INITIALIZED, REAL, from, nFrom, seed, nSeed, function)) return fmi3Error;
    if (!are_elements(instance, IS_INITIALIZED, REAL, to, nTo, sensitivity, nSensitivity, function)) return fmi3Error;
    if (!are_roles(instance, is_adjoint ? from : to, is_adjoint ? nFrom : nTo, is_unknown, "unknown", function))
        return fmi3Error;
    if (!are_roles(instance, is_adjoint ? to : from, is_adjoint ? nTo : nFrom, is_known, "known", function))
        return fmi3Error;
    Data *d = &instance->data;
    const int is_initial = d->mode == INITIALIZATION;
    if (is_initial) {
        int broken = 0;
        const fmi3Status status = report(instance, data_refresh(d, &broken), &broken, function, 0, DISCARD);
        if (status != fmi3OK) return status;
    }
    for (size_t i = 0; i < nFrom; i++)
        for (unsigned r = FIRST[from[i]]; r < FIRST[from[i] + 1]; r++) along[r] += *seed++;
    functions[data_derived_in(d)][is_adjoint](d->time, d->state, d->value + FIRST_INPUT, d->value, along, result);
    for (size_t i = 0; i < nTo; i++)
        for (unsigned r = FIRST[to[i]]; r < FIRST[to[i] + 1]; r++) *sensitivity++ = result[r];
    return fmi3OK;
}

/* 2.2.12.1. */
fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference unknowns[], size_t nUnknowns,
                                        const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[],
                                        size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity) {
    return derive(c, 0, knowns, nKnowns, seed, nSeed, unknowns, nUnknowns, sensitivity, nSensitivity,
                  "fmi3GetDirectionalDerivative");
}

/* 2.2.12.2. */
fmi3Status fmi3GetAdjointDerivative(fmi3Instance c, const fmi3ValueReference unknowns[], size_t nUnknowns,
                                    const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[],
                                    size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity) {
    return derive(c, 1, unknowns, nUnknowns, seed, nSeed, knowns, nKnowns, sensitivity, nSensitivity,
                  "fmi3GetAdjointDerivative");
}

/* 2.3.5: in event mode. One iteration is enough, see `update_discrete_states`. */
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *discreteStatesNeedUpdate,
                                    fmi3Boolean *terminateSimulation, fmi3Boolean *nominalsOfContinuousStatesChanged,
                                    fmi3Boolean *valuesOfContinuousStatesChanged, fmi3Boolean *nextEventTimeDefined,
                                    fmi3Float64 *nextEventTime) {
    double next = 0;
    int jumped = 0;
    const int are_given = discreteStatesNeedUpdate && terminateSimulation && nominalsOfContinuousStatesChanged &&
                          valuesOfContinuousStatesChanged && nextEventTimeDefined && nextEventTime;
    const fmi3Status status =
        update_discrete_states(c, are_given ? NULL : "a result", &jumped, &next, "fmi3UpdateDiscreteStates");
    if (status != fmi3OK) return status;
    *discreteStatesNeedUpdate = *terminateSimulation = *nominalsOfContinuousStatesChanged = fmi3False;
    *valuesOfContinuousStatesChanged = jumped != 0;
    *nextEventTimeDefined = isfinite(next) != 0;
    *nextEventTime = isfinite(next) ? next : 0;
    return fmi3OK;
}

static fmi3Status get_number(Instance *instance, size_t *result, size_t number, const char *function) {
    if (!is_of(instance, EXCHANGE, function) || !is_allowed(instance, READABLE, function)) return fmi3Error;
    if (!result) return missing(instance, function, "the number");
    *result = number;
    return fmi3OK;
}

/* 2.3.2. There are no structural parameters: the model description states the number. */
fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *nContinuousStates) {
    return get_number(c, nContinuousStates, N_CONTINUOUS, "fmi3GetNumberOfContinuousStates");
}

/* 2.3.2, likewise. */
fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *nEventIndicators) {
    return get_number(c, nEventIndicators, N_INDICATORS, "fmi3GetNumberOfEventIndicators");
}
