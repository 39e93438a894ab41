/* An instance of an FMI 3.0 FMU behind the functions of FMI 2.0 that the master calls, from its loop and from Python. Clauses refer to FMI 3.0.2.

   FMI 3.0 transfers whole arrays. For the master, their elements are scalars, row by row (2.2.7.1), each with an index
   in place of a value reference. Scalars of neighbouring whole arrays of one type are one call, and so are those of a
   part of an array, which is set by reading the array first, or before initialization, where FMUs refuse to be read,
   from its start. */

#include <float.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3FunctionTypes.h"

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

/* Of the master: a value of `kind` is a double, an int (also for Booleans) or a string. */
enum { REAL, INTEGER, TEXT };
enum { LAST_SUCCESSFUL_TIME = 2, TERMINATED = 3 }; /* of FMI 2.0 */
/* Uses of an instance: a check of the FMU, event mode in co-simulation, early return of a step, adjoint derivatives. */
enum { EXAMINED = 1, EVENT_MODE = 2, EARLY_RETURN = 4, ADJOINT = 8 };
enum { MOST_RETURNS = 1000, MOST_UPDATES = 100 }; /* of one step, of one event */

/* Types with the least and the largest of the master's numbers that they hold, but for infinity. */
#define NUMBERS(X)                                                                         \
    X(Float64, -DBL_MAX, DBL_MAX) X(Float32, -FLT_MAX, FLT_MAX)                            \
    X(Int8, INT8_MIN, INT8_MAX) X(UInt8, 0, UINT8_MAX) X(Int16, INT16_MIN, INT16_MAX)      \
    X(UInt16, 0, UINT16_MAX) X(Int32, INT32_MIN, INT32_MAX) X(UInt32, 0, INT32_MAX)        \
    X(Int64, INT32_MIN, INT32_MAX) X(UInt64, 0, INT32_MAX) X(Boolean, INT32_MIN, INT32_MAX)
#define TYPE_OF(Name, low, high) Name,
enum { NUMBERS(TYPE_OF) String };

#define NAMES_OF(Name, low, high) {"fmi3Get" #Name, "fmi3Set" #Name, low, high},
static const struct {
    const char *function[2];
    double low, high;
} TYPES[] = {NUMBERS(NAMES_OF){{"fmi3GetString", "fmi3SetString"}, 0, 0}};

typedef fmi3Status Transfer(fmi3Instance instance, const fmi3ValueReference *references, size_t n_references,
                            void *values, size_t n_values);

/* In the order of `_FUNCTIONS` of fmi3.py. */
#define FUNCTIONS(X)                                                                                            \
    X(FreeInstance) X(EnterInitializationMode) X(ExitInitializationMode) X(Terminate) X(Reset) X(GetFMUState)   \
    X(SetFMUState) X(FreeFMUState) X(SerializedFMUStateSize) X(SerializeFMUState) X(DeserializeFMUState)        \
    X(SetDebugLogging) X(EnterEventMode) X(UpdateDiscreteStates) X(GetDirectionalDerivative)                    \
    X(GetAdjointDerivative) X(DoStep) X(EnterStepMode) X(EnterContinuousTimeMode) X(SetTime)                    \
    X(CompletedIntegratorStep) X(GetContinuousStates) X(SetContinuousStates) X(GetContinuousStateDerivatives)   \
    X(GetEventIndicators) X(GetNominalsOfContinuousStates) X(GetNumberOfContinuousStates)                       \
    X(GetNumberOfEventIndicators)
#define MEMBER(Name) fmi3##Name##TYPE *Name;
typedef struct {
    FUNCTIONS(MEMBER) /* NULL for functions of the other interface */
    Transfer *transfer[String + 1][2]; /* get, set */
} Functions;

typedef struct {
    int64_t type, reference;
    int64_t first, size; /* scalars of its array */
    double start;        /* NAN: none is stated, or it is no double */
} Element;

typedef struct {
    fmi3Instance instance;
    const Functions *call;
    const Element *elements;
    size_t n_elements;
    fmi3LogMessageCallback log;
    fmi3InstanceEnvironment environment;
    fmi3ValueReference *references; /* of one call */
    void *values;
    char **texts;   /* what was read last */
    double *before; /* values of the elements, while the state is Instantiated */
    int is_instantiated;
    fmi3FMUState saved; /* the last state of the state Instantiated */
    fmi3Boolean has_tolerance, has_stop;
    double tolerance, start, stop;
    double reached;
    int has_reached, terminates; /* of the last step */
    int uses;
    double point, end, finished; /* of a step with intermediate updates: its begin and end, time of the last update */
    char wrong[160];             /* what an update did wrong */
    const char *refused;   /* the last function that returned another status than ok */
    const char *unwritten; /* a result that the last step did not write */
} Instance;

static int noted(Instance *a, fmi3Status status, const char *function) {
    if (status != fmi3OK) a->refused = function;
    return status;
}

static int is_done(int status) { return status == fmi3OK || status == fmi3Warning; }

static int refuse(Instance *a, const char *function, const char *text) {
    char marked[300]; /* what a check finds although the call returned ok */
    snprintf(marked, sizeof marked, "check: %s", text);
    a->log(a->environment, fmi3Error, "logStatusError", a->uses & EXAMINED ? marked : text);
    return noted(a, fmi3Error, function);
}

/* Values */

static double number(int64_t type, const void *values, size_t i) {
    switch (type) {
#define READ(Name, low, high) \
    case Name: return (double)((const fmi3##Name *)values)[i];
        NUMBERS(READ)
    default: return 0;
    }
}

static void put(int64_t type, void *values, size_t i, double x) {
    switch (type) {
#define WRITE(Name, low, high) \
    case Name: ((fmi3##Name *)values)[i] = (fmi3##Name)x; break;
        NUMBERS(WRITE)
    default: break;
    }
}

/* Copies one scalar between the values of the master and the values of a call. */
static int move(Instance *a, int kind, int is_set, const Element *e, size_t slot, void *values, size_t i) {
    const double low = is_set ? TYPES[e->type].low : INT32_MIN, high = is_set ? TYPES[e->type].high : INT32_MAX;
    double *reals = values, x;
    fmi3String *own = values, *texts = a->values;
    int *integers = values;
    char text[128];
    if (kind == TEXT) {
        *(is_set ? texts + slot : own + i) = is_set ? own[i] : texts[slot];
        return fmi3OK;
    }
    x = !is_set ? number(e->type, a->values, slot) : kind == REAL ? reals[i] : integers[i];
    if (kind == INTEGER && !is_set && a->uses & EXAMINED) x = x < low ? low : x > high ? high : x;
    if ((kind == INTEGER || is_set) && (x < low || x > high) && !isinf(x)) {
        snprintf(text, sizeof text, "value reference %lu: %.17g: expected %.17g..%.17g", (unsigned long)e->reference, x,
                 low, high);
        return refuse(a, TYPES[e->type].function[is_set], text);
    }
    if (is_set)
        put(e->type, a->values, slot, x);
    else if (kind == REAL)
        reals[i] = x;
    else
        integers[i] = (int)x;
    return fmi3OK;
}

/* 2.2.7.2: strings that an FMU returns are only valid until its next call. Those that are kept stay while they are the
   same: a call may read a scalar twice. */
static void keep_texts(Instance *a, size_t first, size_t count) {
    fmi3String *values = a->values;
    for (size_t k = 0; k < count; k++) {
        char **kept = a->texts + first + k;
        const char *text = values[k] ? values[k] : "";
        if (!*kept || strcmp(*kept, text)) {
            free(*kept);
            *kept = malloc(strlen(text) + 1);
            if (*kept) strcpy(*kept, text);
        }
        values[k] = *kept;
    }
}

/* A reference that no variable has, as rules of a check ask for. */
static int refer_to_none(Instance *a, int kind, int is_set, fmi3ValueReference reference) {
    static const int64_t types[] = {Float64, Int32, String};
    double value[2] = {0, 0};
    const fmi3Status status = a->call->transfer[types[kind]][is_set](a->instance, &reference, 1, value, 1);
    return noted(a, status, TYPES[types[kind]].function[is_set]);
}

static int exchange(Instance *a, const Element *e, size_t n, size_t size, int is_set) {
    const fmi3Status status = a->call->transfer[e->type][is_set](a->instance, a->references, n, a->values, size);
    return noted(a, status, TYPES[e->type].function[is_set]);
}

/* How many of `n` scalars are a whole array, in order. */
static size_t whole(const Instance *a, const uint32_t numbers[], size_t n) {
    const Element *e = a->elements + numbers[0];
    size_t count = 0;
    while (count < n && count < (size_t)e->size && numbers[count] == e->first + count) count++;
    return count == (size_t)e->size ? count : 0;
}

/* Whether the values of an array follow from its start and from what was set: the table of 2.3.3 has fmi3Get in the
   state Instantiated, the list of allowed calls below it does not. */
static int is_known(Instance *a, const Element *e) {
    if (!a->is_instantiated || e->type == String) return 0;
    for (int64_t i = 0; i < e->size; i++) {
        const double x = a->before[e->first + i];
        if (isnan(x)) return 0;
        put(e->type, a->values, (size_t)i, x);
    }
    return 1;
}

static int transfer(Instance *a, int kind, int is_set, const uint32_t numbers[], size_t n, void *values) {
    int worst = fmi3OK;
    for (size_t i = 0; i < n; i++)
        if (numbers[i] >= a->n_elements) return refer_to_none(a, kind, is_set, numbers[i]);
    for (size_t i = 0, taken; i < n; i += taken) {
        const Element *e = a->elements + numbers[i];
        size_t n_arrays = 0, count, size = 0;
        int is_part = 0;
        int status = fmi3OK;
        for (taken = 0; i + taken < n; taken += count) {
            const Element *next = a->elements + numbers[i + taken];
            count = whole(a, numbers + i + taken, n - i - taken);
            if (next->type != e->type || !count || taken + count > a->n_elements) break;
            if (kind == TEXT && n_arrays) break;
            a->references[n_arrays++] = (fmi3ValueReference)next->reference;
        }
        size = taken;
        if (!n_arrays) {
            a->references[n_arrays++] = (fmi3ValueReference)e->reference;
            size = (size_t)e->size;
            for (taken = 1; i + taken < n && a->elements[numbers[i + taken]].first == e->first; taken++) continue;
            is_part = 1; /* or a whole array in another order */
        }
        if (!is_set || (is_part && !is_known(a, e))) {
            status = exchange(a, e, n_arrays, size, 0);
            if (!is_done(status)) return status;
            if (kind == TEXT) keep_texts(a, (size_t)e->first, size);
        }
        for (size_t k = i; k < i + taken; k++) {
            const size_t slot = is_part ? numbers[k] - (size_t)e->first : k - i;
            if (move(a, kind, is_set, a->elements + numbers[k], slot, values, k) != fmi3OK) return fmi3Error;
        }
        if (is_set) {
            const int set = exchange(a, e, n_arrays, size, 1);
            if (!is_done(set)) return set;
            status = set > status ? set : status;
            for (size_t k = i; a->is_instantiated && k < i + taken; k++)
                a->before[numbers[k]] = number(e->type, a->values, is_part ? numbers[k] - (size_t)e->first : k - i);
        }
        worst = status > worst ? status : worst;
    }
    return worst;
}

#define EXCHANGES(Name, kind, type)                                                          \
    EXPORT int fmi2Get##Name(Instance *a, const uint32_t numbers[], size_t n, type *values) { \
        return transfer(a, kind, 0, numbers, n, (void *)values);                             \
    }                                                                                        \
    EXPORT int fmi2Set##Name(Instance *a, const uint32_t numbers[], size_t n, type *values) { \
        return transfer(a, kind, 1, numbers, n, (void *)values);                             \
    }
EXCHANGES(Real, REAL, double)
EXCHANGES(Integer, INTEGER, int)
EXCHANGES(Boolean, INTEGER, int)
EXCHANGES(String, TEXT, fmi3String)

/* Returns the number of arrays that hold some scalars, each once; `places`: of the scalars among their values. */
static size_t arrays_of(const Instance *a, const uint32_t numbers[], size_t n, fmi3ValueReference references[],
                        size_t places[], size_t *size) {
    size_t count = 0;
    *size = 0;
    for (size_t i = 0, j; i < n; i++) {
        const Element *e = a->elements + numbers[i];
        /* mostly of the array of the scalar before */
        j = i && a->elements[numbers[i - 1]].first == e->first ? i - 1 : 0;
        for (; a->elements[numbers[j]].first != e->first; j++) continue;
        if (j == i) {
            references[count++] = (fmi3ValueReference)e->reference;
            places[i] = *size + numbers[i] - (size_t)e->first;
            *size += (size_t)e->size;
        } else
            places[i] = places[j] + numbers[i] - numbers[j];
    }
    return count;
}

/* 2.2.11: seeds and results are those of whole arrays. Adjoint derivatives are of the same matrix, by its rows. */
EXPORT int fmi2GetDirectionalDerivative(Instance *a, const uint32_t unknowns[], size_t n, const uint32_t knowns[],
                                        size_t m, const double seed[], double derivatives[]) {
    static const char *const function = "fmi3GetDirectionalDerivative";
    fmi3ValueReference *references = calloc(n + m + 1, sizeof *references), *known_references = references + n;
    size_t *places = calloc(n + m + 1, sizeof *places), size, n_seeds, n_unknowns, n_knowns;
    double *seeds = calloc(2 * a->n_elements + 1, sizeof *seeds), *rows = seeds + a->n_elements, *results = a->values;
    char text[120];
    int status = fmi3Error;
    if (references && places && seeds) {
        n_unknowns = arrays_of(a, unknowns, n, references, places, &size);
        n_knowns = arrays_of(a, knowns, m, known_references, places + n, &n_seeds);
        for (size_t i = 0; i < m; i++) seeds[places[n + i]] = seed[i];
        for (size_t i = 0; i < size; i++) results[i] = NAN;
        status = a->call->GetDirectionalDerivative(a->instance, references, n_unknowns, known_references, n_knowns,
                                                   seeds, n_seeds, results, size);
        noted(a, status, function);
        for (size_t i = 0; i < n; i++) derivatives[i] = results[places[i]];
        for (size_t i = 0; i < n && a->uses & ADJOINT && is_done(status); i++) {
            double sum = 0, most = fabs(derivatives[i]);
            memset(results, 0, size * sizeof *results);
            results[places[i]] = 1;
            for (size_t k = 0; k < n_seeds; k++) rows[k] = NAN;
            status = a->call->GetAdjointDerivative(a->instance, references, n_unknowns, known_references, n_knowns,
                                                   results, size, rows, n_seeds);
            for (size_t k = 0; k < m; k++) {
                sum += seed[k] * rows[places[n + k]];
                most = fmax(most, fabs(seed[k] * rows[places[n + k]]));
            }
            snprintf(text, sizeof text, "%.9g, and %.9g by fmi3GetAdjointDerivative", derivatives[i], sum);
            if (!is_done(noted(a, status, "fmi3GetAdjointDerivative"))) continue;
            /* An FMU may compute either by differences. */
            if (!(fabs(derivatives[i] - sum) <= 1e-3 * most + 1e-9)) status = refuse(a, function, text);
        }
    }
    free(references);
    free(places);
    free(seeds);
    return status;
}

/* Modes and steps */

EXPORT int fmi2SetupExperiment(Instance *a, int has_tolerance, double tolerance, double start, int has_stop,
                               double stop) {
    a->has_tolerance = has_tolerance != 0;
    a->has_stop = has_stop != 0;
    a->tolerance = tolerance;
    a->start = start;
    a->stop = stop;
    return fmi3OK;
}

EXPORT int fmi2EnterInitializationMode(Instance *a) {
    const fmi3Status status = a->call->EnterInitializationMode(a->instance, a->has_tolerance, a->tolerance, a->start,
                                                               a->has_stop, a->stop);
    a->is_instantiated = 0;
    return noted(a, status, "fmi3EnterInitializationMode");
}

static int update_discrete_states(Instance *a, fmi3Boolean flags[5], double *next) {
    const fmi3Status status = a->call->UpdateDiscreteStates(a->instance, flags, flags + 1, flags + 2, flags + 3,
                                                            flags + 4, next);
    return noted(a, status, "fmi3UpdateDiscreteStates");
}

/* 2.3.5: from event mode to step mode, as the importer does it. */
static int handle_event(Instance *a) {
    fmi3Boolean flags[5] = {fmi3True};
    double next = 0;
    int status = fmi3OK;
    for (int i = 0; is_done(status) && flags[0]; i++) {
        flags[0] = fmi3False;
        if (i == MOST_UPDATES) return refuse(a, "fmi3UpdateDiscreteStates", "discreteStatesNeedUpdate stays true");
        status = update_discrete_states(a, flags, &next);
    }
    return is_done(status) ? noted(a, a->call->EnterStepMode(a->instance), "fmi3EnterStepMode") : status;
}

static Instance *stepping; /* with intermediate updates; a check makes one step at a time */

/* 4.2.2: the time is in the step, and not before an update that finished one of the FMU's own steps. */
EXPORT void fmi3_update(fmi3InstanceEnvironment environment, double t, bool set_requested, bool get_allowed,
                        bool step_finished, bool can_return, bool *return_requested, double *return_time) {
    Instance *a = stepping;
    /* An FMU may take a time of its own that is close to a communication point as the point. */
    const double slack = a ? 1e-2 * (a->end - a->point) + 1e-5 * (1 + fabs(a->end)) : 0;
    (void)set_requested, (void)get_allowed;
    *return_requested = can_return && a && t > a->point + slack;
    *return_time = t;
    if (!a) return;
    if (a->environment != environment)
        snprintf(a->wrong, sizeof a->wrong, "an intermediate update has the environment of another instance");
    else if (!(t >= a->finished - slack && t <= a->end + slack))
        snprintf(a->wrong, sizeof a->wrong, "the time of an intermediate update is %.9g s: expected %.9g..%.9g s", t,
                 a->finished, a->end);
    if (step_finished) a->finished = t;
}

/* 4.2.1: one call of fmi3DoStep of an FMU under examination. */
static int part_of_step(Instance *a, double t, double end, int no_return_before, int *needs_event, int *is_early) {
    static const char *const function = "fmi3DoStep";
    static const char *const names[] = {"eventHandlingNeeded", "terminateSimulation", "earlyReturn"};
    unsigned char written[3] = {2, 2, 2};
    bool flags[3];
    const double slack = 1e-9 * (fabs(t) + fabs(end));
    double reached = NAN;
    fmi3Status status;
    memcpy(flags, written, sizeof flags);
    /* An FMU that is late, as its own steps have another size, begins where it is. */
    a->point = a->finished = a->has_reached && a->reached < t ? a->reached : t;
    a->end = end;
    a->wrong[0] = 0;
    stepping = a;
    status = a->call->DoStep(a->instance, t, end - t, no_return_before, flags, flags + 1, flags + 2, &reached);
    stepping = NULL;
    a->has_reached = a->terminates = 0;
    if (!is_done(status)) return noted(a, status, function);
    memcpy(written, flags, sizeof flags);
    if (a->wrong[0]) return refuse(a, "fmi3IntermediateUpdateCallback", a->wrong);
    /* `values-are-written` reports it; other rules are judged with what importers begin with. */
    for (int i = 0; i < 3; i++)
        if (written[i] > 1) a->unwritten = names[i], written[i] = 0;
    if (isnan(reached)) a->unwritten = "lastSuccessfulTime", reached = end;
    *needs_event = written[0];
    *is_early = written[2];
    a->terminates = written[1];
    a->has_reached = 1;
    a->reached = reached;
    if (*is_early && !(a->uses & EARLY_RETURN))
        return refuse(a, function, "earlyReturn is true: expected false, as it is not allowed");
    if (*needs_event && !(a->uses & EVENT_MODE))
        return refuse(a, function, "eventHandlingNeeded is true: expected false, as no event mode is used");
    /* An FMU may be late, as its own steps have another size. */
    if (*is_early && reached < t - (end - t)) return refuse(a, function, "lastSuccessfulTime lies before the step");
    if (reached > end - slack) *is_early = 0; /* nothing is left of the step */
    return a->terminates ? noted(a, fmi3Discard, function) : (int)status;
}

static int examined_step(Instance *a, double start, double size, int no_return_before) {
    double t = start;
    int status = fmi3OK, needs_event = 0, is_early = 0;
    for (int i = 0; i < MOST_RETURNS; i++) {
        status = part_of_step(a, t, start + size, no_return_before, &needs_event, &is_early);
        if (!is_done(status)) return status;
        if (needs_event) {
            status = noted(a, a->call->EnterEventMode(a->instance), "fmi3EnterEventMode");
            status = is_done(status) ? handle_event(a) : status;
        }
        if (!is_done(status) || !is_early) return status;
        t = a->reached;
    }
    return refuse(a, "fmi3DoStep", "earlyReturn is true again and again in one step");
}

/* 4.2.1. A step that ends the simulation is discarded in FMI 2.0 (2.0.5, 4.2.3). */
EXPORT int fmi2DoStep(Instance *a, double start, double size, int no_return_before_start) {
    static const char *const function = "fmi3DoStep";
    fmi3Boolean needs_event = fmi3False, terminates = fmi3False, is_early = fmi3False;
    const double end = start + size, slack = 1e-3 * size; /* an FMU may add up its internal steps */
    fmi3Float64 reached = end, least = end;
    char text[160];
    fmi3Status status;
    if (a->uses & EXAMINED) return examined_step(a, start, size, no_return_before_start != 0);
    status = a->call->DoStep(a->instance, start, size, no_return_before_start != 0, &needs_event,
                                              &terminates, &is_early, &reached);
    a->terminates = is_done(status) && terminates;
    a->has_reached = is_done(status);
    a->reached = reached;
    if (a->terminates || is_early) least = start;
    if (is_done(status) && !(reached >= least - slack && reached <= end + slack)) {
        snprintf(text, sizeof text, "lastSuccessfulTime is %.9g s: expected %s, %.9g..%.9g s", reached,
                 least < end ? "a time in the step" : "the end of the step, as earlyReturn is false", start, end);
        return refuse(a, function, text);
    }
    if (a->terminates) return noted(a, fmi3Discard, function);
    if (is_done(status) && is_early)
        return refuse(a, function, "earlyReturn is true: expected false, as it is not allowed");
    if (is_done(status) && needs_event)
        return refuse(a, function, "eventHandlingNeeded is true: expected false, as no event mode is used");
    return noted(a, status, function);
}

EXPORT int fmi2GetRealStatus(Instance *a, int kind, double *value) {
    if (kind != LAST_SUCCESSFUL_TIME || !a->has_reached) return fmi3Discard;
    *value = a->reached;
    return fmi3OK;
}

EXPORT int fmi2GetBooleanStatus(Instance *a, int kind, int *value) {
    if (kind != TERMINATED) return fmi3Discard;
    *value = a->terminates;
    return fmi3OK;
}

EXPORT int fmi2ExitInitializationMode(Instance *a) {
    const fmi3Status status = a->call->ExitInitializationMode(a->instance);
    noted(a, status, "fmi3ExitInitializationMode");
    return a->uses & EVENT_MODE && is_done(status) ? handle_event(a) : (int)status;
}

EXPORT int fmi2SetDebugLogging(Instance *a, int is_on, size_t n, const fmi3String categories[]) {
    return noted(a, a->call->SetDebugLogging(a->instance, is_on != 0, n, categories), "fmi3SetDebugLogging");
}

static void begin_anew(Instance *a) {
    a->is_instantiated = 1;
    for (size_t i = 0; i < a->n_elements; i++) a->before[i] = a->elements[i].start;
}

EXPORT int fmi2Reset(Instance *a) {
    const fmi3Status status = a->call->Reset(a->instance);
    if (is_done(status)) begin_anew(a);
    return noted(a, status, "fmi3Reset");
}

EXPORT int fmi2GetFMUstate(Instance *a, fmi3FMUState *state) {
    const fmi3Status status = a->call->GetFMUState(a->instance, state);
    if (is_done(status) && (a->is_instantiated || *state == a->saved)) a->saved = a->is_instantiated ? *state : NULL;
    return noted(a, status, "fmi3GetFMUState");
}

EXPORT int fmi2SetFMUstate(Instance *a, fmi3FMUState state) {
    a->is_instantiated = a->saved && state == a->saved;
    for (size_t i = 0; i < a->n_elements; i++) /* it may hold another value than was set since */
        if (a->before[i] != a->elements[i].start) a->before[i] = NAN;
    return noted(a, a->call->SetFMUState(a->instance, state), "fmi3SetFMUState");
}

EXPORT int fmi2FreeFMUstate(Instance *a, fmi3FMUState *state) {
    if (*state == a->saved) a->saved = NULL; /* another state may get the address */
    return noted(a, a->call->FreeFMUState(a->instance, state), "fmi3FreeFMUState");
}

/* Functions that differ in their names alone. */
#define SAME(Old, Name, declared, passed) \
    EXPORT int fmi2##Old declared { return noted(a, a->call->Name passed, "fmi3" #Name); }
SAME(Terminate, Terminate, (Instance * a), (a->instance))
SAME(SerializedFMUstateSize, SerializedFMUStateSize, (Instance * a, fmi3FMUState state, size_t *size),
     (a->instance, state, size))
SAME(SerializeFMUstate, SerializeFMUState, (Instance * a, fmi3FMUState state, fmi3Byte bytes[], size_t size),
     (a->instance, state, bytes, size))
SAME(DeSerializeFMUstate, DeserializeFMUState, (Instance * a, fmi3Byte bytes[], size_t size, fmi3FMUState *state),
     (a->instance, bytes, size, state))

SAME(EnterEventMode, EnterEventMode, (Instance * a), (a->instance))
SAME(EnterContinuousTimeMode, EnterContinuousTimeMode, (Instance * a), (a->instance))
SAME(SetTime, SetTime, (Instance * a, double time), (a->instance, time))
SAME(SetContinuousStates, SetContinuousStates, (Instance * a, const double x[], size_t n), (a->instance, x, n))
#define VECTOR(Old, Name) SAME(Old, Name, (Instance * a, double values[], size_t n), (a->instance, values, n))
VECTOR(GetContinuousStates, GetContinuousStates)
VECTOR(GetDerivatives, GetContinuousStateDerivatives)
VECTOR(GetEventIndicators, GetEventIndicators)
VECTOR(GetNominalsOfContinuousStates, GetNominalsOfContinuousStates)
SAME(GetNumberOfContinuousStates, GetNumberOfContinuousStates, (Instance * a, size_t *n), (a->instance, n))
SAME(GetNumberOfEventIndicators, GetNumberOfEventIndicators, (Instance * a, size_t *n), (a->instance, n))

EXPORT int fmi2CompletedIntegratorStep(Instance *a, int is_final, int *enters_event_mode, int *terminates) {
    fmi3Boolean enters = fmi3False, ends = fmi3False;
    const fmi3Status status = a->call->CompletedIntegratorStep(a->instance, is_final != 0, &enters, &ends);
    *enters_event_mode = enters;
    *terminates = ends;
    return noted(a, status, "fmi3CompletedIntegratorStep");
}

typedef struct {
    int is_needed, terminates, nominals_changed, states_changed, has_next;
    double next;
} EventInfo; /* as fmi2EventInfo */

EXPORT int fmi2NewDiscreteStates(Instance *a, EventInfo *info) {
    fmi3Boolean flags[5] = {fmi3False};
    double next = 0;
    const int status = update_discrete_states(a, flags, &next);
    *info = (EventInfo){flags[0], flags[1], flags[2], flags[3], flags[4], next};
    return status;
}

/* Of this file */

static void release(Instance *a) {
    for (size_t i = 0; a->texts && i < a->n_elements; i++) free(a->texts[i]);
    free(a->texts);
    free(a->before);
    free(a->values);
    free(a->references);
    free(a);
}

EXPORT void fmi2FreeInstance(Instance *a) {
    a->call->FreeInstance(a->instance);
    release(a);
}

/* NULL without memory, and then `instance` is not freed. */
EXPORT Instance *fmi3_behind(fmi3Instance instance, const Functions *call, const Element *elements, size_t n_elements,
                             fmi3LogMessageCallback log, fmi3InstanceEnvironment environment, int uses) {
    Instance *a = malloc(sizeof *a);
    if (!a) return NULL;
    *a = (Instance){instance, call, elements, n_elements, log, environment};
    a->uses = uses;
    a->references = calloc(n_elements + 1, sizeof *a->references);
    a->values = calloc(n_elements + 1, sizeof(double));
    a->texts = calloc(n_elements + 1, sizeof *a->texts);
    a->before = calloc(n_elements + 1, sizeof *a->before);
    if (a->references && a->values && a->texts && a->before) {
        begin_anew(a);
        return a;
    }
    release(a);
    return NULL;
}

/* A result that the last step did not write, once; NULL if it wrote all. */
EXPORT const char *fmi3_unwritten(Instance *a) {
    const char *name = a->unwritten;
    a->unwritten = NULL;
    return name;
}

/* The last function that returned another status than ok, once; NULL if there was none. */
EXPORT const char *fmi3_refused(Instance *a) {
    const char *function = a->refused;
    a->refused = NULL;
    return function;
}
