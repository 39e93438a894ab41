/* A legal FMU of FMI 3.0 for both interfaces that misbehaves in one way, by the name in resources/mutation.txt.
 *
 *   x' = rate (u - x),  y = gains x + offset (where is_on),  z = x - 0.6 (event indicator),  force = gains u
 *
 * n counts time events, each a quarter of a second. The list of mutants stands in slaves.toml.
 */

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "fmi3Functions.h"

enum { INSTANTIATED = 1, INITIALIZATION = 2, EVENT = 4, STEP = 8, CONTINUOUS = 16, TERMINATED = 32 };
enum { ANY = INSTANTIATED | INITIALIZATION | EVENT | STEP | CONTINUOUS | TERMINATED };
enum { FIXED, TUNABLE, INPUT, STATE, START, OTHER };
#define PERIOD 0.25

typedef struct {
    double time, rate, u, gains[2], force[2], x, der_x, z, start, stop, drift, old_x;
    uint64_t size;
    int64_t mode_of_enum;
    int32_t n, first_n;
    int16_t offset;
    bool is_on, is_moved;
    char label[100];
    float y[2];
    int mode;
} Data;
typedef struct {
    Data d;
    bool logging[2], is_exchange, uses_events, may_return;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
    fmi3IntermediateUpdateCallback update;
} Model;
typedef struct {
    unsigned reference;
    char type;
    int kind, count;
    size_t offset, size;
} Variable;
#define V(reference, type, kind, count, member) {reference, type, kind, count, offsetof(Data, member), sizeof((Data *)0)->member / count}
static const Variable VARIABLES[] = {
    V(0, 'd', OTHER, 1, time),   V(1, 'd', TUNABLE, 1, rate), V(2, 'L', OTHER, 1, size),    V(3, 'd', INPUT, 1, u),
    V(4, 's', INPUT, 1, offset), V(5, 'd', FIXED, 2, gains),  V(6, 'd', STATE, 1, x),       V(7, 'd', OTHER, 1, der_x),
    V(8, 'f', OTHER, 2, y),      V(9, 'i', START, 1, n),      V(10, 'd', OTHER, 1, z),      V(11, 'b', INPUT, 1, is_on),
    V(12, 't', FIXED, 1, label), V(13, 'l', FIXED, 1, mode_of_enum), V(17, 'd', OTHER, 2, force),
};

static char mutation[100];
static int alive; /* instances */
#define IS(n) (!strcmp(mutation, n))

static const char *const CATEGORIES[] = {"logStatusError", "logEvents"};
static void say(Model *m, fmi3Status status, const char *text) {
    const char *category = IS("an undeclared category") ? "logAnything" : CATEGORIES[status == fmi3OK];
    if (m->logging[status == fmi3OK] && !IS("silent refusals")) m->log(m->environment, status, category, text);
}
static fmi3Status error(Model *m, const char *text) {
    say(m, fmi3Error, text);
    m->d.mode = TERMINATED;
    return fmi3Error;
}
#define NEED(modes) \
    if (!(((Model *)instance)->d.mode & (modes))) return error(instance, __func__)

static void compute(Data *d) {
    d->der_x = d->rate * (d->u - (d->mode == CONTINUOUS && IS("derivatives of the states before") ? d->old_x : d->x));
    if (IS("a relation follows the state") && d->x > 0.6) d->der_x -= 1;
    for (int i = 0; i < 2; i++) d->y[i] = (float)(d->gains[i] * d->x + (d->is_on ? d->offset : 0));
    for (int i = 0; i < 2; i++) d->force[i] = d->gains[i] * d->u;
    d->z = d->x - 0.6;
    if (IS("a fixed value drifts")) d->gains[0] = d->drift + 1;
    if (IS("a discrete output changes in continuous time")) d->n = d->first_n + (int)((d->time - d->start) / PERIOD);
}
static void initialise(Data *d) {
    *d = (Data){.rate = 2, .u = 0.5, .gains = {1, 0.5}, .x = 1, .old_x = 1, .size = 2, .mode_of_enum = 2, .offset = 1, .is_on = true};
    strcpy(d->label, "a");
    d->mode = INSTANTIATED;
    compute(d);
}

static fmi3Instance create(fmi3String name, fmi3String token, fmi3String path, bool logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log) {
    char file[1000];
    FILE *stream;
    Model *m = calloc(1, sizeof *m);
    (void)name;
    snprintf(file, sizeof file, "%smutation.txt", path ? path : "");
    stream = fopen(file, "r");
    if (stream) {
        if (!fgets(mutation, sizeof mutation, stream)) mutation[0] = 0;
        mutation[strcspn(mutation, "\n")] = 0;
        fclose(stream);
    }
    m->logging[0] = m->logging[1] = logging || IS("logs although logging is off");
    m->environment = environment;
    m->log = log;
    initialise(&m->d);
    if ((strcmp(token, "{fmi3}") && !IS("any token")) || (alive && IS("only one instance at a time"))) {
        say(m, fmi3Error, "no instance for this instantiationToken, or no other instance");
        free(m);
        return NULL;
    }
    alive++;
    return m;
}
fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible, fmi3Boolean logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log) {
    Model *m = create(name, token, path, logging, environment, log);
    (void)visible;
    if (m) m->is_exchange = true;
    return m;
}
fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference required[], size_t n, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update) {
    Model *m = create(name, token, path, logging, environment, log);
    (void)visible, (void)required, (void)n;
    if (!m) return NULL;
    m->uses_events = events;
    m->may_return = early;
    m->update = update;
    return m;
}
fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible, fmi3Boolean logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3ClockUpdateCallback clock, fmi3LockPreemptionCallback lock, fmi3UnlockPreemptionCallback unlock) {
    (void)name, (void)token, (void)path, (void)visible, (void)logging, (void)environment, (void)log, (void)clock, (void)lock, (void)unlock;
    return NULL;
}
void fmi3FreeInstance(fmi3Instance instance) {
    if (instance ? IS("a crash where it is freed") : IS("free of NULL crashes")) abort();
    alive -= instance != NULL;
    free(instance);
}
const char *fmi3GetVersion(void) { return "3.0"; }
fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean on, size_t n, const fmi3String categories[]) {
    bool *logging = ((Model *)instance)->logging;
    if (IS("logs although logging is off")) return fmi3OK;
    if (n && IS("all categories are chosen together")) n = 0;
    if (IS("one category ends all others") && !on) n = 0;
    for (int i = 0; i < 2; i++) {
        if (!n) logging[i] = on;
        for (size_t k = 0; k < n; k++)
            if (!strcmp(categories[k], CATEGORIES[i])) logging[i] = on;
    }
    return fmi3OK;
}

/* Values */

static bool may_be_set(const Data *d, int kind) {
    if (d->mode == INSTANTIATED) return kind != OTHER;
    if (d->mode == INITIALIZATION) return kind != OTHER;
    return d->mode != TERMINATED && (kind == INPUT || kind == TUNABLE);
}
static fmi3Status transfer(Model *m, char type, const fmi3ValueReference refs[], size_t n, void *values, size_t n_values, bool is_set) {
    size_t place = 0;
    for (size_t i = 0; i < n; i++) {
        const Variable *v = NULL;
        for (size_t j = 0; j < sizeof VARIABLES / sizeof *VARIABLES; j++)
            if (VARIABLES[j].reference == refs[i] && VARIABLES[j].type == type) v = &VARIABLES[j];
        if (!v && IS("unknown references are ignored")) return fmi3OK;
        if (!v) return error(m, "no variable has this reference");
        if (place + (size_t)v->count > n_values) return error(m, "another number of values");
        if (is_set && !may_be_set(&m->d, v->kind)) return error(m, "the variable cannot be set");
        for (int k = 0; k < v->count; k++, place++) {
            char *own = (char *)&m->d + v->offset + k * v->size;
            if (type == 't') {
                if (is_set) snprintf(m->d.label, sizeof m->d.label, "%s", ((fmi3String *)values)[place]);
                else ((fmi3String *)values)[place] = m->d.label;
                continue;
            }
            if (is_set && k == 1 && IS("the second element of an array is lost")) continue;
            if (is_set) memcpy(own, (char *)values + place * v->size, v->size);
            else memcpy((char *)values + place * v->size, own, v->size);
        }
        if (is_set && v->kind == START) m->d.first_n = m->d.n;
        if (is_set && v->reference == 5) m->d.drift = m->d.gains[0] - 1;
    }
    if (is_set) compute(&m->d);
    return fmi3OK;
}
#define ACCESS(Name, letter)                                                                                                  \
    fmi3Status fmi3Get##Name(fmi3Instance m, const fmi3ValueReference r[], size_t n, fmi3##Name x[], size_t k) {              \
        return transfer(m, letter, r, n, x, k, false);                                                                        \
    }                                                                                                                         \
    fmi3Status fmi3Set##Name(fmi3Instance m, const fmi3ValueReference r[], size_t n, const fmi3##Name x[], size_t k) {        \
        return transfer(m, letter, r, n, (void *)x, k, true);                                                                 \
    }
ACCESS(Float64, 'd') ACCESS(Float32, 'f') ACCESS(Int8, '?') ACCESS(UInt8, '?') ACCESS(Int16, 's') ACCESS(UInt16, '?')
ACCESS(Int32, 'i') ACCESS(UInt32, '?') ACCESS(Int64, 'l') ACCESS(UInt64, 'L') ACCESS(Boolean, 'b') ACCESS(String, 't')

/* Modes */

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean has_tolerance, fmi3Float64 tolerance, fmi3Float64 start, fmi3Boolean has_stop, fmi3Float64 stop) {
    Data *d = &((Model *)instance)->d;
    NEED(INSTANTIATED);
    (void)has_tolerance, (void)tolerance;
    d->stop = has_stop ? stop + 1e-9 * fabs(stop) : INFINITY;
    say(instance, fmi3OK, "initialised");
    d->time = d->start = start;
    d->mode = INITIALIZATION;
    return fmi3OK;
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance instance) {
    Model *m = instance;
    NEED(INITIALIZATION);
    m->d.mode = m->is_exchange || m->uses_events ? EVENT : STEP;
    return fmi3OK;
}
static fmi3Status move(fmi3Instance instance, int from, int to) {
    NEED(from);
    ((Model *)instance)->d.mode = to;
    return fmi3OK;
}
fmi3Status fmi3EnterEventMode(fmi3Instance m) { return move(m, STEP | CONTINUOUS, EVENT); }
fmi3Status fmi3EnterStepMode(fmi3Instance m) { return move(m, IS("step mode is not entered") ? 0 : EVENT, STEP); }
fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance m) { return move(m, EVENT, CONTINUOUS); }
fmi3Status fmi3Terminate(fmi3Instance m) { return move(m, EVENT | STEP | CONTINUOUS, TERMINATED); }
fmi3Status fmi3EnterConfigurationMode(fmi3Instance m) { return move(m, INSTANTIATED, INSTANTIATED); }
fmi3Status fmi3ExitConfigurationMode(fmi3Instance m) { return move(m, INSTANTIATED, INSTANTIATED); }
fmi3Status fmi3Reset(fmi3Instance instance) {
    if (!IS("a reset that does nothing")) initialise(&((Model *)instance)->d);
    ((Model *)instance)->d.mode = INSTANTIATED;
    return fmi3OK;
}
static int events_until(const Data *d, double t) { return (int)floor((t - d->start) / PERIOD + 1e-9); }
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *again, fmi3Boolean *ends, fmi3Boolean *nominals, fmi3Boolean *states, fmi3Boolean *has_next, fmi3Float64 *next) {
    Data *d = &((Model *)instance)->d;
    NEED(EVENT);
    d->n = d->first_n + events_until(d, d->time);
    compute(d);
    *again = IS("events without end");
    *ends = *nominals = *states = false;
    *has_next = true;
    *next = d->start + (events_until(d, d->time) + !IS("the next event is the present")) * PERIOD;
    return fmi3OK;
}
fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance m) { return move(m, EVENT | INITIALIZATION, ((Model *)m)->d.mode); }

/* Co-simulation: the solution is exact. */

static void go_to(Data *d, double t) {
    d->x = d->u + (d->x - d->u) * exp(-d->rate * (t - d->time));
    d->time = t;
    d->drift += 0.001;
    compute(d);
}
fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 t, fmi3Float64 h, fmi3Boolean no_return, fmi3Boolean *event, fmi3Boolean *ends, fmi3Boolean *early, fmi3Float64 *reached) {
    Model *m = instance;
    Data *d = &m->d;
    double end = t + h;
    bool requested = false;
    double when = 0;
    NEED(STEP);
    (void)no_return;
    if (end > d->stop && !IS("steps past the stop time")) return error(m, "the step ends beyond the stop time");
    *event = false;
    if (!IS("terminateSimulation is not written")) *ends = false;
    if (!IS("earlyReturn is not written")) *early = false;
    if (m->update && h > 0) {
        double middle = IS("an intermediate update before the step") ? t - h : t + h / 2;
        m->update(m->environment, middle, false, true, true, m->may_return, &requested, &when);
        if (requested && m->may_return && middle > t) end = middle, *early = true;
    }
    if (m->uses_events && m->may_return) {
        const double next = d->start + (events_until(d, d->time) + 1) * PERIOD;
        if (next < end - 1e-9) end = next, *early = true;
    }
    *event = m->uses_events && events_until(d, end) > d->n - d->first_n;
    if (IS("an event is needed without event mode")) *event = true;
    if (IS("returns early without permission")) *early = true, end = t + h / 2;
    go_to(d, end);
    if (!m->uses_events) d->n = d->first_n + events_until(d, end);
    if (!IS("lastSuccessfulTime is not written")) *reached = end;
    return fmi3OK;
}

/* Model exchange */

fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 t) {
    NEED(CONTINUOUS);
    if (t > ((Model *)instance)->d.stop) return error(instance, "the time is beyond the stop time");
    ((Model *)instance)->d.time = t;
    compute(&((Model *)instance)->d);
    return fmi3OK;
}
fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 x[], size_t n) {
    Data *d = &((Model *)instance)->d;
    NEED(CONTINUOUS);
    (void)n;
    d->old_x = d->x;
    d->x = x[0];
    compute(d);
    return fmi3OK;
}
#define VECTOR(Name, value)                                                            \
    fmi3Status fmi3Get##Name(fmi3Instance instance, fmi3Float64 x[], size_t n) {       \
        NEED(INITIALIZATION | EVENT | CONTINUOUS | TERMINATED);                        \
        (void)n;                                                                       \
        x[0] = value;                                                                  \
        return fmi3OK;                                                                 \
    }
VECTOR(ContinuousStates, ((Model *)instance)->d.x)
VECTOR(ContinuousStateDerivatives, ((Model *)instance)->d.der_x)
VECTOR(EventIndicators, ((Model *)instance)->d.z)
VECTOR(NominalsOfContinuousStates, 10)
#define NUMBER(Name, wrong)                                                 \
    fmi3Status fmi3GetNumberOf##Name(fmi3Instance instance, size_t *n) {    \
        NEED(ANY);                                                          \
        *n = wrong ? 2 : 1;                                                 \
        return fmi3OK;                                                      \
    }
NUMBER(ContinuousStates, IS("one more state is counted"))
NUMBER(EventIndicators, IS("one more event indicator is counted late") && ((Data *)instance)->mode == EVENT)
fmi3Status fmi3CompletedIntegratorStep(fmi3Instance instance, fmi3Boolean no_return, fmi3Boolean *event, fmi3Boolean *ends) {
    NEED(CONTINUOUS);
    (void)no_return;
    *event = *ends = false;
    return fmi3OK;
}

/* Derivatives: of x, der(x), y and force by rate, u, gains and x */

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t n, const fmi3ValueReference knowns[], size_t m, const fmi3Float64 seed[], size_t n_seed, fmi3Float64 results[], size_t n_results) {
    const Data *d = &((Model *)instance)->d;
    const double sign = IS("a derivative has the other sign") ? -1 : 1;
    double rate = 0, u = 0, gains[2] = {0}, x = 0;
    const double *end = results + n_results;
    NEED(INITIALIZATION | EVENT | STEP | CONTINUOUS | TERMINATED);
    for (size_t i = 0, k = 0; i < m && k < n_seed; i++) {
        if (knowns[i] == 1) rate = seed[k++];
        else if (knowns[i] == 3) u = seed[k++];
        else if (knowns[i] == 5) gains[0] = seed[k++], gains[1] = seed[k++];
        else if (knowns[i] == 6) x = seed[k++];
        else return error(instance, "no known has this reference");
    }
    for (size_t i = 0; i < n && results < end; i++) {
        if (unknowns[i] == 6) *results++ = x;
        else if (unknowns[i] == 7) *results++ = rate * (d->u - d->x) + d->rate * (sign * u - x);
        else if (unknowns[i] != 8 && unknowns[i] != 17) return error(instance, "no unknown has this reference");
        else for (int j = 0; j < 2; j++) {
            const double by_gain = gains[IS("seeds of an array are taken for its first element") ? 0 : j];
            *results++ = unknowns[i] == 8 ? by_gain * d->x + d->gains[j] * x : by_gain * d->u + d->gains[j] * u;
        }
    }
    if (d->mode == STEP && !d->is_moved && IS("a directional derivative moves the state")) {
        go_to(&((Model *)instance)->d, d->time + 0.001);
        ((Model *)instance)->d.is_moved = true;
    }
    return results == end ? fmi3OK : error(instance, "another number of values");
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t n, const fmi3ValueReference knowns[], size_t m, const fmi3Float64 seed[], size_t n_seed, fmi3Float64 results[], size_t n_results) {
    for (size_t k = 0; k < n_results; k++) {
        double unit[10] = {0}, derivatives[10] = {0};
        unit[k] = IS("adjoint derivatives have the other sign") ? -1 : 1;
        if (fmi3GetDirectionalDerivative(instance, unknowns, n, knowns, m, unit, n_results, derivatives, n_seed)) return fmi3Error;
        for (size_t i = results[k] = 0; i < n_seed; i++) results[k] += seed[i] * derivatives[i];
    }
    return fmi3OK;
}

/* States */

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *state) {
    if (!*state) *state = malloc(sizeof(Data));
    memcpy(*state, &((Model *)instance)->d, sizeof(Data));
    return fmi3OK;
}
fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState state) {
    Data *d = &((Model *)instance)->d;
    const double x = d->x;
    memcpy(d, state, sizeof *d);
    if (IS("a state that is not restored")) d->x = x;
    return fmi3OK;
}
fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *state) {
    (void)instance;
    free(*state);
    *state = NULL;
    return fmi3OK;
}
fmi3Status fmi3SerializedFMUStateSize(fmi3Instance m, fmi3FMUState state, size_t *size) {
    (void)m, (void)state;
    *size = sizeof(Data);
    return fmi3OK;
}
fmi3Status fmi3SerializeFMUState(fmi3Instance m, fmi3FMUState state, fmi3Byte bytes[], size_t size) {
    memcpy(bytes, IS("bytes are those of the present") ? (void *)&((Model *)m)->d : state, size);
    return fmi3OK;
}
fmi3Status fmi3DeserializeFMUState(fmi3Instance m, const fmi3Byte bytes[], size_t size, fmi3FMUState *state) {
    (void)m;
    *state = malloc(sizeof(Data));
    memcpy(*state, bytes, size);
    return fmi3OK;
}

/* Functions of features that the description does not claim */

#define STUB(Name, arguments) \
    fmi3Status fmi3##Name arguments { return error(instance, "not supported"); }
STUB(GetBinary, (fmi3Instance instance, const fmi3ValueReference r[], size_t n, size_t sizes[], fmi3Binary x[], size_t k))
STUB(SetBinary, (fmi3Instance instance, const fmi3ValueReference r[], size_t n, const size_t sizes[], const fmi3Binary x[], size_t k))
STUB(GetClock, (fmi3Instance instance, const fmi3ValueReference r[], size_t n, fmi3Clock x[]))
STUB(SetClock, (fmi3Instance instance, const fmi3ValueReference r[], size_t n, const fmi3Clock x[]))
STUB(GetNumberOfVariableDependencies, (fmi3Instance instance, fmi3ValueReference r, size_t *n))
STUB(GetVariableDependencies, (fmi3Instance instance, fmi3ValueReference r, size_t a[], fmi3ValueReference b[], size_t c[], fmi3DependencyKind k[], size_t n))
STUB(GetIntervalDecimal, (fmi3Instance instance, const fmi3ValueReference r[], size_t n, fmi3Float64 x[], fmi3IntervalQualifier q[]))
STUB(GetIntervalFraction, (fmi3Instance instance, const fmi3ValueReference r[], size_t n, fmi3UInt64 c[], fmi3UInt64 s[], fmi3IntervalQualifier q[]))
STUB(GetShiftDecimal, (fmi3Instance instance, const fmi3ValueReference r[], size_t n, fmi3Float64 x[]))
STUB(GetShiftFraction, (fmi3Instance instance, const fmi3ValueReference r[], size_t n, fmi3UInt64 c[], fmi3UInt64 s[]))
STUB(SetIntervalDecimal, (fmi3Instance instance, const fmi3ValueReference r[], size_t n, const fmi3Float64 x[]))
STUB(SetIntervalFraction, (fmi3Instance instance, const fmi3ValueReference r[], size_t n, const fmi3UInt64 c[], const fmi3UInt64 s[]))
STUB(SetShiftDecimal, (fmi3Instance instance, const fmi3ValueReference r[], size_t n, const fmi3Float64 x[]))
STUB(SetShiftFraction, (fmi3Instance instance, const fmi3ValueReference r[], size_t n, const fmi3UInt64 c[], const fmi3UInt64 s[]))
STUB(GetOutputDerivatives, (fmi3Instance instance, const fmi3ValueReference r[], size_t n, const fmi3Int32 o[], fmi3Float64 x[], size_t k))
STUB(ActivateModelPartition, (fmi3Instance instance, fmi3ValueReference clock, fmi3Float64 t))
