/* FMI 3.0 for co-simulation around a slave of slave.h: its variables as arrays, with value references of their own.
 *
 * config.h lists ARRAYS: {value reference, type, first variable, count} of each. Strings are no variables of the slave:
 * the first half of N_TEXTS are inputs, which the other half repeats; TEXT_STARTS are their start values.
 * It is as strict as slave.h. A discarded step leaves the instance as it was (3.0.2, 2.2.3), and one that terminates
 * the simulation is done. No string that it returned outlives its next call.
 */

#ifndef FMI3_H
#define FMI3_H

#include "fmi3Functions.h"

#ifndef N_TEXTS
#define N_TEXTS 0
#define TEXT_STARTS ""
#endif

/* The status of a call that sets or gets numbers. */
#ifndef AFTER_SET
#define AFTER_SET(status) (status)
#endif
#ifndef AFTER_GET
#define AFTER_GET(status) (status)
#endif

enum Type { Float64, Float32, Int8, UInt8, Int16, UInt16, Int32, UInt32, Int64, UInt64, Boolean, String };

static const struct {
    fmi3ValueReference reference;
    int type, first;
    size_t count;
} arrays[] = {ARRAYS};

enum { N_ARRAYS = sizeof arrays / sizeof *arrays, TEXT_SIZE = 64 };

typedef struct {
    Slave *slave;
    fmi3LogMessageCallback log;
    fmi3InstanceEnvironment environment;
    char text[N_TEXTS + 1][TEXT_SIZE];
    char returned[N_TEXTS + 1][TEXT_SIZE];
} Face;

static void log_to_fmi3(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                        fmi2String format, ...) {
    Face *f = environment;
    char text[256];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    (void)name;
    f->log(f->environment, (fmi3Status)status, category, text);
}

static fmi3Status called(Face *f, fmi2Status status) {
    memset(f->returned, '?', sizeof f->returned - 1);
    return (fmi3Status)status;
}

/* Of the arrays: NULL after a refusal. `values` are those of the slave, by variable. */
static const unsigned *variables_of(Face *f, int type, const fmi3ValueReference vr[], size_t n, size_t n_values,
                                    const char *call, unsigned into[], size_t *count) {
    *count = 0;
    for (size_t i = 0; i < n; i++) {
        size_t k = 0;
        while (k < N_ARRAYS && !(arrays[k].reference == vr[i] && arrays[k].type == type)) k++;
        if (k == N_ARRAYS || *count + arrays[k].count > n_values) {
            refuse(f->slave, fmi2Error, "%s: value reference %u, %lu values", call, vr[i], (unsigned long)n_values);
            return NULL;
        }
        for (size_t j = 0; j < arrays[k].count; j++) into[(*count)++] = (unsigned)(arrays[k].first + (int)j);
    }
    if (*count == n_values) return into;
    refuse(f->slave, fmi2Error, "%s: %lu values: expected %lu", call, (unsigned long)n_values, (unsigned long)*count);
    return NULL;
}

#define EXCHANGES(Name)                                                                                            \
    fmi3Status fmi3Get##Name(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3##Name values[],         \
                             size_t n_values) {                                                                    \
        unsigned variables[N_VARIABLES + 1];                                                                       \
        double numbers[N_VARIABLES + 1];                                                                           \
        size_t count;                                                                                              \
        Face *f = c;                                                                                               \
        if (!variables_of(f, Name, vr, n, n_values, "fmi3Get" #Name, variables, &count)) return fmi3Error;         \
        const fmi2Status status = fmi2GetReal(f->slave, variables, count, numbers);                                \
        for (size_t i = 0; i < count; i++) values[i] = (fmi3##Name)numbers[i];                                     \
        return called(f, AFTER_GET(status));                                                                       \
    }                                                                                                              \
    fmi3Status fmi3Set##Name(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3##Name values[],   \
                             size_t n_values) {                                                                    \
        unsigned variables[N_VARIABLES + 1];                                                                       \
        double numbers[N_VARIABLES + 1];                                                                           \
        size_t count;                                                                                              \
        Face *f = c;                                                                                               \
        if (!variables_of(f, Name, vr, n, n_values, "fmi3Set" #Name, variables, &count)) return fmi3Error;         \
        for (size_t i = 0; i < count; i++) numbers[i] = (double)values[i];                                         \
        return called(f, AFTER_SET(fmi2SetReal(f->slave, variables, count, numbers)));                             \
    }

EXCHANGES(Float64)
EXCHANGES(Float32)
EXCHANGES(Int8)
EXCHANGES(UInt8)
EXCHANGES(Int16)
EXCHANGES(UInt16)
EXCHANGES(Int32)
EXCHANGES(UInt32)
EXCHANGES(Int64)
EXCHANGES(UInt64)
EXCHANGES(Boolean)

static void repeat_texts(Face *f) {
    for (int i = 0; i + N_TEXTS / 2 < N_TEXTS; i++) strcpy(f->text[N_TEXTS / 2 + i], f->text[i]);
}

fmi3Status fmi3GetString(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3String values[],
                         size_t n_values) {
    unsigned texts[N_TEXTS + 1];
    size_t count;
    Face *f = c;
    if (!variables_of(f, String, vr, n, n_values, "fmi3GetString", texts, &count)) return fmi3Error;
    called(f, fmi2OK);
    if (f->slave->data.mode & (INSTANTIATED | INITIALIZATION)) repeat_texts(f);
    for (size_t i = 0; i < count; i++) values[i] = strcpy(f->returned[texts[i]], f->text[texts[i]]);
    return fmi3OK;
}

fmi3Status fmi3SetString(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3String values[],
                         size_t n_values) {
    unsigned texts[N_TEXTS + 1];
    size_t count;
    Face *f = c;
    called(f, fmi2OK);
    if (!variables_of(f, String, vr, n, n_values, "fmi3SetString", texts, &count)) return fmi3Error;
    for (size_t i = 0; i < count; i++) snprintf(f->text[texts[i]], TEXT_SIZE, "%s", values[i]);
    return fmi3OK;
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean event_mode, fmi3Boolean early_return,
                                         const fmi3ValueReference required[], size_t n_required,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update) {
    Face *f = calloc(1, sizeof *f);
    const fmi2CallbackFunctions functions = {log_to_fmi3, calloc, free, NULL, f};
    static const char *const starts[N_TEXTS + 1] = {TEXT_STARTS};
    (void)required, (void)update;
    f->log = log;
    f->environment = environment;
    for (int i = 0; i < N_TEXTS; i++) strcpy(f->text[i], starts[i]);
    if (!event_mode && !early_return && !n_required && !resources) /* there is no folder of resources */
        f->slave = fmi2Instantiate(name, fmi2CoSimulation, token, resources, &functions, visible, logging);
    if (f->slave) return f;
    free(f);
    return NULL;
}

void fmi3FreeInstance(fmi3Instance c) {
    Face *f = c;
    fmi2FreeInstance(f->slave);
    free(f);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean has_tolerance, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean has_stop, fmi3Float64 stop) {
    Face *f = c;
    const fmi2Status status = fmi2SetupExperiment(f->slave, has_tolerance, tolerance, start, has_stop, stop);
    return called(f, status == fmi2OK ? fmi2EnterInitializationMode(f->slave) : status);
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c) {
    Face *f = c;
    repeat_texts(f);
    return called(f, fmi2ExitInitializationMode(f->slave));
}

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean no_earlier_state,
                      fmi3Boolean *needs_event, fmi3Boolean *terminates, fmi3Boolean *is_early, fmi3Float64 *reached) {
    Face *f = c;
    Data *d = &f->slave->data;
    const Data before = *d;
    fmi2Status status = fmi2DoStep(f->slave, t, h, no_earlier_state);
    *needs_event = *is_early = fmi3False;
    *terminates = status == fmi2Discard && d->terminates;
    *reached = d->last_successful_time;
#ifdef REACHED
    *reached = REACHED;
#endif
#ifdef RETURNS_EARLY
    *is_early = t >= RETURNS_EARLY;
#endif
#ifdef NEEDS_EVENT
    *needs_event = t >= NEEDS_EVENT;
#endif
    if (status == fmi2Discard) {
        if (*terminates) status = fmi2OK;
        else *d = before;
        d->mode = STEPPING;
    }
    repeat_texts(f);
    return called(f, status);
}

#define SAME(Name, Old, declared, passed) \
    fmi3Status fmi3##Name declared { return called(c, fmi2##Old passed); }
#define SLAVE ((Face *)c)->slave

SAME(Terminate, Terminate, (fmi3Instance c), (SLAVE))
SAME(Reset, Reset, (fmi3Instance c), (SLAVE))
SAME(GetFMUState, GetFMUstate, (fmi3Instance c, fmi3FMUState *state), (SLAVE, state))
SAME(SetFMUState, SetFMUstate, (fmi3Instance c, fmi3FMUState state), (SLAVE, state))
SAME(FreeFMUState, FreeFMUstate, (fmi3Instance c, fmi3FMUState *state), (SLAVE, state))
SAME(SerializedFMUStateSize, SerializedFMUstateSize, (fmi3Instance c, fmi3FMUState state, size_t *size),
     (SLAVE, state, size))
SAME(SerializeFMUState, SerializeFMUstate, (fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size),
     (SLAVE, state, (fmi2Byte *)bytes, size))
SAME(DeserializeFMUState, DeSerializeFMUstate,
     (fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state),
     (SLAVE, (const fmi2Byte *)bytes, size, state))

#endif
