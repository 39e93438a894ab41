/* Ten faults that the survey met, each in its shortest form, in a slave with y = gain * u.
 *
 * REPRODUCTION chooses one; with 0 the slave is legal. It is our own code: the cause in an FMU of the survey may
 * be another. The comment beside a fault names the rule that finds it.
 */

#include <stdlib.h>
#include <string.h>
#include "fmi2Functions.h"

#ifndef REPRODUCTION
#define REPRODUCTION 0
#endif
#define IS(n) (REPRODUCTION == n)

enum { GAIN, U, Y, COUNT };
enum { INSTANTIATED = 1, INITIALIZATION = 2, STEPPING = 4, TERMINATED = 8, FAILED = 16 };

typedef struct {
    double reals[COUNT], time, stop;
    int state, stop_is_defined, logging;
    fmi2CallbackFunctions callbacks;
    char *name;
} Model;

static void initial_values(Model *m) {
    memset(m->reals, 0, sizeof m->reals);
    m->reals[GAIN] = 2.0;
    if (!IS(1)) m->reals[U] = 1.0; /* 1: start-values-are-as-declared, an input begins at 0 */
    m->state = INSTANTIATED;
    m->stop_is_defined = 0;
}

static fmi2Status tell(Model *m, fmi2Status status, const char *text) {
    if (m->logging || IS(2)) /* 2: no-messages-with-logging-off */
        m->callbacks.logger(m->callbacks.componentEnvironment, m->name, status,
                            IS(3) ? "logStatus" : NULL, "%s", text); /* 3: log-categories-are-declared */
    return status;
}

static fmi2Status error(Model *m, const char *text) {
    m->state = FAILED;
    return tell(m, fmi2Error, text);
}

#define NEED(states)                                                                                     \
    Model *m = c;                                                                                        \
    if (!(m->state & (states))) return error(m, __func__)

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String location,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
    Model *m;
    if (type != fmi2CoSimulation || strcmp(guid, "{reproductions}")) {
        const char *by = IS(5) ? NULL : name; /* 5: messages-of-a-refusal-are-complete */
        callbacks->logger(callbacks->componentEnvironment, by, fmi2Error, NULL, "another GUID or type");
        return NULL;
    }
    m = calloc(1, sizeof *m);
    m->callbacks = *callbacks;
    m->name = strcpy(malloc(strlen(name) + 1), name);
    m->logging = logging;
    initial_values(m);
    return m;
}
void fmi2FreeInstance(fmi2Component c) {
    Model *m = c;
    if (m || IS(4)) free(m->name); /* 4: free-of-null-is-ignored */
    free(m);
}
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    ((Model *)c)->logging = on;
    return fmi2OK;
}
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_is_defined, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stop_is_defined, fmi2Real stop) {
    NEED(INSTANTIATED);
    m->time = start;
    m->stop = stop;
    m->stop_is_defined = stop_is_defined;
    return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    NEED(INSTANTIATED);
    if (IS(6)) m->reals[GAIN] = 2.0; /* 6: values-that-are-set-are-read, what was set before is lost */
    m->state = INITIALIZATION;
    return fmi2OK;
}
fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    NEED(INITIALIZATION);
    m->state = STEPPING;
    return tell(m, fmi2OK, "initialised");
}
fmi2Status fmi2Terminate(fmi2Component c) {
    NEED(STEPPING);
    m->state = TERMINATED;
    return fmi2OK;
}
fmi2Status fmi2Reset(fmi2Component c) {
    Model *m = c;
    const double u = m->reals[U];
    initial_values(m);
    if (IS(7)) m->reals[U] = u; /* 7: reset-gives-the-start-values, an input keeps its last value */
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    NEED(INITIALIZATION | STEPPING | FAILED | (IS(8) ? 0 : TERMINATED)); /* 8: allowed-calls-succeed */
    m->reals[Y] = m->reals[GAIN] * m->reals[U];
    for (size_t i = 0; i < n; i++) {
        if (vr[i] >= COUNT && !IS(9)) return error(m, "no such variable"); /* 9: wrong-references-are-refused */
        value[i] = m->reals[vr[i]];
    }
    return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    NEED(INSTANTIATED | INITIALIZATION | STEPPING);
    for (size_t i = 0; i < n; i++) {
        const int settable = vr[i] == GAIN ? m->state != STEPPING : vr[i] == U;
        if (!settable) return error(m, "not settable");
        m->reals[vr[i]] = value[i];
    }
    return fmi2OK;
}
#define OF_NONE(Name, Type)                                                                              \
    fmi2Status fmi2Get##Name(fmi2Component c, const fmi2ValueReference vr[], size_t n, Type value[]) {   \
        return n ? error(c, "no such variable") : fmi2OK;                                                \
    }                                                                                                    \
    fmi2Status fmi2Set##Name(fmi2Component c, const fmi2ValueReference vr[], size_t n, const Type value[]) { \
        return n ? error(c, "no such variable") : fmi2OK;                                                \
    }
OF_NONE(Integer, fmi2Integer)
OF_NONE(Boolean, fmi2Boolean)
OF_NONE(String, fmi2String)

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real size, fmi2Boolean no_set_state) {
    NEED(STEPPING);
    if (m->stop_is_defined && time + size > m->stop * (1.0 + 1e-9)) return error(m, "beyond the stop time");
    m->time = time + size;
    return fmi2OK;
}
fmi2Status fmi2CancelStep(fmi2Component c) { return error(c, "no step is pending"); }

#define NO_STATUS(Name, Type)                                                                            \
    fmi2Status fmi2Get##Name(fmi2Component c, const fmi2StatusKind kind, Type *value) {                  \
        return tell(c, fmi2Discard, "no such status");                                                   \
    }
NO_STATUS(Status, fmi2Status)
NO_STATUS(RealStatus, fmi2Real)
NO_STATUS(IntegerStatus, fmi2Integer)
NO_STATUS(BooleanStatus, fmi2Boolean)
fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) {
    if (IS(10) && kind == fmi2PendingStatus) return fmi2OK; /* 10: values-are-written */
    return tell(c, fmi2Discard, "no such status");
}

/* Capabilities that the description does not claim */
#define NONE(name, ...)                                                                                  \
    fmi2Status name(fmi2Component c, __VA_ARGS__) { return error(c, "not supported"); }
NONE(fmi2GetFMUstate, fmi2FMUstate *state)
NONE(fmi2SetFMUstate, fmi2FMUstate state)
NONE(fmi2FreeFMUstate, fmi2FMUstate *state)
NONE(fmi2SerializedFMUstateSize, fmi2FMUstate state, size_t *size)
NONE(fmi2SerializeFMUstate, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
NONE(fmi2DeSerializeFMUstate, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
NONE(fmi2GetDirectionalDerivative, const fmi2ValueReference of[], size_t n, const fmi2ValueReference by[], size_t k,
     const fmi2Real seed[], fmi2Real value[])
NONE(fmi2SetRealInputDerivatives, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],
     const fmi2Real value[])
NONE(fmi2GetRealOutputDerivatives, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],
     fmi2Real value[])
