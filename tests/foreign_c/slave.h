/* What the test FMUs share: a slave of FMI 2.0 for co-simulation whose variables are numbers by value reference.
 *
 * A model lists its value references up to N_VARIABLES, includes this file and defines the functions `model_...`.
 * What differs between FMUs of one model, `config`, is written into its compiled library: `tests/foreign_fmus.py`.
 *
 * It is strict with the master: a call in the wrong mode, a communication point that is not its own time or a
 * capability that it does not claim is an error, and what FMI forbids after fmi2Error or fmi2Fatal ends the process.
 */

#ifndef SLAVE_H
#define SLAVE_H

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

#ifndef MODEL_CONFIG
#define MODEL_CONFIG
#endif

#ifndef MODEL_IS_CALLED
#define MODEL_IS_CALLED(call)
#endif

typedef struct {
    char guid[64];
    double interpolates_inputs, output_derivative_order, saves_state, serialises_state, varies_step_size;
    double start[N_VARIABLES];
    MODEL_CONFIG
} Config;

/* Weak, so that the compiler takes no value of it for granted. */
__attribute__((weak)) const Config config = {"the configuration goes here"};

enum Mode {
    INSTANTIATED = 1,
    INITIALIZATION = 2,
    STEPPING = 4,
    TERMINATED = 8,
    STEP_FAILED = 16, /* discarded */
    IN_ERROR = 32,
    FATAL = 64
};

typedef struct {
    double value[N_VARIABLES];
    double input_rate[N_VARIABLES];  /* for the coming step alone */
    double output_rate[N_VARIABLES]; /* at `time` */
    double before[N_VARIABLES];      /* values of the last step, where a model needs them */
    double state;
    double time;
    double last_successful_time; /* as it is told */
    double step_size;            /* of the first step */
    int terminates; /* the reason of a discard */
    int mode;
} Data;

typedef struct {
    Data data;
    fmi2CallbackLogger logger;
    fmi2ComponentEnvironment environment;
    fmi2CallbackFreeMemory release;
    fmi2CallbackAllocateMemory allocate;
    double stop_time;
    double tolerance; /* 0 if it is not defined */
    char *name;
} Slave;

static fmi2Status model_initialise(Slave *s);     /* state and outputs that follow from what was set */
static fmi2Status model_step(Slave *s, double h); /* from data.time; also what a discard leaves behind */

#ifdef MODEL_REFUSES
static fmi2Status model_accepts(Slave *s, fmi2ValueReference reference); /* of a value that is being set */
static fmi2Status model_saves(Slave *s);
static fmi2Status model_tells_time(Slave *s);
#else
#define model_accepts(s, reference) fmi2OK
#define model_saves(s) fmi2OK
#define model_tells_time(s) fmi2OK
#endif

#ifdef MODEL_ENDS
static void model_ends(const Slave *s, const char *call);
#else
#define model_ends(s, call) (void)0
#endif

static const char *const CATEGORIES[] = {"logStatusOk",    "logStatusWarning", "logStatusDiscard",
                                         "logStatusError", "logStatusFatal",   "logStatusPending"};

/* Says why, and returns the status; what is worse than a discard ends the stepping. */
static fmi2Status refuse(Slave *s, fmi2Status status, const char *format, ...) {
    char text[256];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    if (s->logger) s->logger(s->environment, s->name, status, CATEGORIES[status], text);
    if (status == fmi2Error) s->data.mode = IN_ERROR;
    if (status == fmi2Fatal) s->data.mode = FATAL;
    return status;
}

static int is_allowed(Slave *s, int modes, const char *call) {
    if (s->data.mode & modes) return 1;
    if (s->data.mode & (IN_ERROR | FATAL)) {
        fprintf(stderr, "%s of %s after fmi2%s\n", call, s->name, s->data.mode == FATAL ? "Fatal" : "Error");
        abort();
    }
    refuse(s, fmi2Error, "%s is not allowed in mode %d", call, s->data.mode);
    return 0;
}

#define MUST_BE(modes, call) \
    if (!is_allowed(s, modes, call)) return fmi2Error

/* Values */

enum { READABLE = INSTANTIATED | INITIALIZATION | STEPPING | TERMINATED | STEP_FAILED | IN_ERROR };
enum { WRITABLE = INSTANTIATED | INITIALIZATION | STEPPING };

#define MUST_EXIST(call)          \
    for (size_t i = 0; i < n; i++) \
        if (vr[i] >= N_VARIABLES) return refuse(s, fmi2Error, "%s: value reference %u", call, vr[i])

#define DEFINE_VALUES(Name, Type)                                                                               \
    fmi2Status fmi2Get##Name(fmi2Component c, const fmi2ValueReference vr[], size_t n, Type value[]) {          \
        Slave *s = c;                                                                                           \
        MUST_BE(READABLE, "fmi2Get" #Name);                                                                     \
        MODEL_IS_CALLED("fmi2Get" #Name);                                                                       \
        const int follows = s->data.mode & (INSTANTIATED | INITIALIZATION);                                     \
        const fmi2Status status = follows ? model_initialise(s) : fmi2OK;                                       \
        MUST_EXIST("fmi2Get" #Name);                                                                            \
        for (size_t i = 0; i < n && status == fmi2OK; i++) value[i] = (Type)s->data.value[vr[i]];               \
        return status;                                                                                          \
    }                                                                                                           \
    fmi2Status fmi2Set##Name(fmi2Component c, const fmi2ValueReference vr[], size_t n, const Type value[]) {    \
        Slave *s = c;                                                                                           \
        MUST_BE(WRITABLE, "fmi2Set" #Name);                                                                     \
        MODEL_IS_CALLED("fmi2Set" #Name);                                                                       \
        fmi2Status result = fmi2OK;                                                                             \
        MUST_EXIST("fmi2Set" #Name);                                                                            \
        for (size_t i = 0; i < n; i++) {                                                                        \
            const fmi2Status status = model_accepts(s, vr[i]);                                                  \
            if (status >= fmi2Discard && status <= fmi2Pending) return status;                                  \
            result = status == fmi2OK ? result : status;                                                        \
        }                                                                                                       \
        for (size_t i = 0; i < n; i++) s->data.value[vr[i]] = (double)value[i];                                 \
        return result;                                                                                          \
    }

DEFINE_VALUES(Real, fmi2Real)
DEFINE_VALUES(Integer, fmi2Integer)
DEFINE_VALUES(Boolean, fmi2Boolean)

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[]) {
    (void)vr, (void)value;
    return n ? refuse(c, fmi2Error, "fmi2GetString: there are no Strings") : fmi2OK;
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[]) {
    (void)vr, (void)value;
    return n ? refuse(c, fmi2Error, "fmi2SetString: there are no Strings") : fmi2OK;
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[]) {
    Slave *s = c;
    MUST_BE(WRITABLE, "fmi2SetRealInputDerivatives");
    if (!config.interpolates_inputs) return refuse(s, fmi2Error, "fmi2SetRealInputDerivatives: not claimed");
    MUST_EXIST("fmi2SetRealInputDerivatives");
    for (size_t i = 0; i < n; i++) {
        if (order[i] != 1) return refuse(s, fmi2Error, "fmi2SetRealInputDerivatives: order %d: expected 1", order[i]);
        s->data.input_rate[vr[i]] = value[i];
    }
    return fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[]) {
    Slave *s = c;
    MUST_BE(STEPPING | TERMINATED, "fmi2GetRealOutputDerivatives");
    MUST_EXIST("fmi2GetRealOutputDerivatives");
    for (size_t i = 0; i < n; i++) {
        if (order[i] < 1 || order[i] > config.output_derivative_order)
            return refuse(s, fmi2Error, "fmi2GetRealOutputDerivatives: order %d: not claimed", order[i]);
        value[i] = s->data.output_rate[vr[i]];
    }
    return fmi2OK;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference u[], size_t nu,
                                        const fmi2ValueReference k[], size_t nk, const fmi2Real dk[], fmi2Real du[]) {
    (void)u, (void)nu, (void)k, (void)nk, (void)dk, (void)du;
    return refuse(c, fmi2Error, "fmi2GetDirectionalDerivative: not claimed");
}

/* Creation and modes */

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

static void reset(Data *d) {
    memset(d, 0, sizeof *d);
    memcpy(d->value, config.start, sizeof config.start);
    d->mode = INSTANTIATED;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    (void)resources, (void)visible, (void)logging;
    MODEL_IS_CALLED("fmi2Instantiate");
    if (type != fmi2CoSimulation || strcmp(guid, config.guid)) {
        functions->logger(functions->componentEnvironment, name, fmi2Error, CATEGORIES[fmi2Error], "GUID %s", guid);
        return NULL;
    }
    Slave *s = functions->allocateMemory(1, sizeof *s + strlen(name) + 1);
    if (!s) return NULL;
    s->name = strcpy((char *)(s + 1), name);
    s->logger = functions->logger;
    s->environment = functions->componentEnvironment;
    s->allocate = functions->allocateMemory;
    s->release = functions->freeMemory;
    reset(&s->data);
    return s;
}

void fmi2FreeInstance(fmi2Component c) {
    Slave *s = c;
    if (!s || !is_allowed(s, ~FATAL, "fmi2FreeInstance")) return;
    model_ends(s, "fmi2FreeInstance");
    s->release(s);
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    (void)c, (void)on, (void)n, (void)categories;
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean has_stop, fmi2Real stop) {
    Slave *s = c;
    s->tolerance = has_tolerance ? tolerance : 0;
    MUST_BE(INSTANTIATED, "fmi2SetupExperiment");
    s->data.time = s->data.last_successful_time = start;
    s->stop_time = has_stop ? stop : INFINITY;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    Slave *s = c;
    MUST_BE(INSTANTIATED, "fmi2EnterInitializationMode");
    MODEL_IS_CALLED("fmi2EnterInitializationMode");
    s->data.mode = INITIALIZATION;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    Slave *s = c;
    MUST_BE(INITIALIZATION, "fmi2ExitInitializationMode");
    const fmi2Status status = model_initialise(s);
    if (status == fmi2OK) s->data.mode = STEPPING;
    return status;
}

fmi2Status fmi2Terminate(fmi2Component c) {
    Slave *s = c;
    MUST_BE(STEPPING | STEP_FAILED, "fmi2Terminate");
    model_ends(s, "fmi2Terminate");
    s->data.mode = TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c) {
    Slave *s = c;
    MUST_BE(~FATAL, "fmi2Reset");
    MODEL_IS_CALLED("fmi2Reset");
    reset(&s->data);
    return fmi2OK;
}

/* Steps */

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no_earlier_state) {
    Slave *s = c;
    Data *d = &s->data;
    (void)no_earlier_state;
    MUST_BE(STEPPING, "fmi2DoStep");
    MODEL_IS_CALLED("fmi2DoStep");
    if (!(h > 0)) return refuse(s, fmi2Error, "fmi2DoStep: step of %.17g s: expected more than 0", h);
    if (!(fabs(t - d->time) <= 1e-9 * fmax(1, fabs(t))))
        return refuse(s, fmi2Error, "fmi2DoStep: communication point %.17g s: expected %.17g s", t, d->time);
    if (!config.varies_step_size && d->step_size && fabs(h - d->step_size) > 1e-9 * h)
        return refuse(s, fmi2Error, "fmi2DoStep: step of %.17g s: expected %.17g s, always", h, d->step_size);
    if (t + h > s->stop_time + 1e-9 * fmax(1, fabs(t)))
        return refuse(s, fmi2Error, "fmi2DoStep: step to %.17g s: expected at most %.17g s", t + h, s->stop_time);
    d->step_size = h;
    const fmi2Status status = model_step(s, h);
    memset(d->input_rate, 0, sizeof d->input_rate);
    if (status >= fmi2Discard && status <= fmi2Pending) {
        if (status == fmi2Discard) d->mode = STEP_FAILED;
        return status;
    }
    d->time = d->last_successful_time = t + h;
    return status;
}

fmi2Status fmi2CancelStep(fmi2Component c) { return refuse(c, fmi2Error, "fmi2CancelStep: no step is pending"); }

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    Slave *s = c;
    MUST_BE(STEPPING | TERMINATED | STEP_FAILED, "fmi2GetRealStatus");
    if (kind != fmi2LastSuccessfulTime) return refuse(s, fmi2Discard, "fmi2GetRealStatus: no such status");
    *value = s->data.last_successful_time;
    return model_tells_time(s);
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) {
    (void)kind, (void)value;
    return refuse(c, fmi2Discard, "fmi2GetStatus: no such status");
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value) {
    (void)kind, (void)value;
    return refuse(c, fmi2Discard, "fmi2GetIntegerStatus: no such status");
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    if (kind != fmi2Terminated) return refuse(c, fmi2Discard, "fmi2GetBooleanStatus: no such status");
    *value = ((Slave *)c)->data.terminates;
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) {
    (void)kind, (void)value;
    return refuse(c, fmi2Discard, "fmi2GetStringStatus: no such status");
}

/* Saved states: copies of the data */

#define MUST_CLAIM(capability, call) \
    if (!(capability)) return refuse(s, fmi2Error, "%s: not claimed", call)

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
    Slave *s = c;
    MUST_BE(~FATAL, "fmi2GetFMUstate");
    MUST_CLAIM(config.saves_state, "fmi2GetFMUstate");
    const fmi2Status status = model_saves(s);
    if (status != fmi2OK) return status;
    if (!*state) *state = s->allocate(1, sizeof(Data));
    memcpy(*state, &s->data, sizeof(Data));
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
    Slave *s = c;
    MUST_BE(~FATAL, "fmi2SetFMUstate");
    MUST_CLAIM(config.saves_state, "fmi2SetFMUstate");
    memcpy(&s->data, state, sizeof(Data));
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    Slave *s = c;
    MUST_BE(~FATAL, "fmi2FreeFMUstate");
    MUST_CLAIM(config.saves_state, "fmi2FreeFMUstate");
    model_ends(s, "fmi2FreeFMUstate");
    if (*state) s->release(*state);
    *state = NULL;
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) {
    Slave *s = c;
    (void)state;
    MUST_CLAIM(config.serialises_state, "fmi2SerializedFMUstateSize");
    *size = sizeof(Data);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
    Slave *s = c;
    MUST_CLAIM(config.serialises_state, "fmi2SerializeFMUstate");
    if (size != sizeof(Data)) return refuse(s, fmi2Error, "fmi2SerializeFMUstate: %zu bytes", size);
    memcpy(bytes, state, size);
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
    Slave *s = c;
    MUST_CLAIM(config.serialises_state, "fmi2DeSerializeFMUstate");
    if (size != sizeof(Data)) return refuse(s, fmi2Error, "fmi2DeSerializeFMUstate: %zu bytes", size);
    if (!*state) *state = s->allocate(1, sizeof(Data));
    memcpy(*state, bytes, size);
    return fmi2OK;
}

#endif
