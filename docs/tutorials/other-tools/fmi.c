/* The layer between Pid.c and FMI 2.0: a value reference is the index in the structure. */
#include <float.h>
#include <stdlib.h>
#include <string.h>

#include "Pid.h"
#include "fmi2Functions.h"

#define GUID "{a PID controller in C}"

enum { VARIABLES_OF_PID = 6 };

typedef struct { PidState pid; double start, stop; long count; } Instance;

static double *values(fmi2Component c) { return (double *)&((Instance *)c)->pid; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    Instance *instance = strcmp(guid, GUID) ? NULL : calloc(1, sizeof(Instance));
    if (instance)
        instance->stop = DBL_MAX, Pid_startup(&instance->pid);
    else
        functions->logger(functions->componentEnvironment, name, fmi2Error, "error", "no memory, or another GUID");
    return instance;
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2Reset(fmi2Component c) {
    memset(c, 0, sizeof(Instance));
    ((Instance *)c)->stop = DBL_MAX;
    Pid_startup(&((Instance *)c)->pid);
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean has_stop, fmi2Real stop) {
    ((Instance *)c)->start = start;
    ((Instance *)c)->stop = has_stop ? stop : DBL_MAX;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }

static int are_known(const fmi2ValueReference vr[], size_t n) {
    for (size_t i = 0; i < n; i++)
        if (vr[i] >= VARIABLES_OF_PID) return 0;
    return 1;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    if (!are_known(vr, n)) return fmi2Error;
    for (size_t i = 0; i < n; i++) value[i] = values(c)[vr[i]];
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    if (!are_known(vr, n)) return fmi2Error;
    for (size_t i = 0; i < n; i++) values(c)[vr[i]] = value[i];
    Pid_recalibrate(&((Instance *)c)->pid);
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no_return_before_t) {
    Instance *x = c;
    const double period = x->pid.period;
    if (t + h > x->stop + 1e-6 * h) return fmi2Error;
    for (; x->start + x->count * period < t + h - 1e-6 * period; x->count++) Pid_dostep(&x->pid);
    return fmi2OK;
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) { return fmi2OK; }

/* There are only Real variables, and the other functions belong to capabilities that are not declared. */
#define NONE(NAME, ...) fmi2Status fmi2##NAME(fmi2Component c, __VA_ARGS__) { return fmi2Error; }
#define UNKNOWN(NAME, ...) fmi2Status fmi2##NAME(fmi2Component c, __VA_ARGS__) { return fmi2Discard; }
#define VARIABLES const fmi2ValueReference vr[], size_t n
#define EMPTY(NAME, TYPE) fmi2Status fmi2##NAME(fmi2Component c, VARIABLES, TYPE value[]) { return n ? fmi2Error : fmi2OK; }
EMPTY(GetInteger, fmi2Integer)
EMPTY(SetInteger, const fmi2Integer)
EMPTY(GetBoolean, fmi2Boolean)
EMPTY(SetBoolean, const fmi2Boolean)
EMPTY(GetString, fmi2String)
EMPTY(SetString, const fmi2String)
NONE(GetFMUstate, fmi2FMUstate *state)
NONE(SetFMUstate, fmi2FMUstate state)
NONE(FreeFMUstate, fmi2FMUstate *state)
NONE(SerializedFMUstateSize, fmi2FMUstate state, size_t *size)
NONE(SerializeFMUstate, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
NONE(DeSerializeFMUstate, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
NONE(GetDirectionalDerivative, VARIABLES, const fmi2ValueReference known[], size_t m, const fmi2Real dv[], fmi2Real dz[])
NONE(SetRealInputDerivatives, VARIABLES, const fmi2Integer order[], const fmi2Real value[])
NONE(GetRealOutputDerivatives, VARIABLES, const fmi2Integer order[], fmi2Real value[])
UNKNOWN(GetStatus, const fmi2StatusKind kind, fmi2Status *value)
UNKNOWN(GetRealStatus, const fmi2StatusKind kind, fmi2Real *value)
UNKNOWN(GetIntegerStatus, const fmi2StatusKind kind, fmi2Integer *value)
UNKNOWN(GetBooleanStatus, const fmi2StatusKind kind, fmi2Boolean *value)
UNKNOWN(GetStringStatus, const fmi2StatusKind kind, fmi2String *value)
fmi2Status fmi2CancelStep(fmi2Component c) { return fmi2Error; }
