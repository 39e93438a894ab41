/* A legal FMU for model exchange that misbehaves in one way, by the name in resources/mutation.txt.
 *
 *   x' = v,  v' = a = u - k x + 0.1 stairs,  with reflection v := -e v where x falls below -0.3
 *
 * stairs counts time events, above and the reflection are state events, turns counts step events, where v
 * changes its sign and the nominal value of x changes. The list of mutants stands in slaves.toml.
 */

#define _GNU_SOURCE
#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "fmi2Functions.h"

enum { INST = 1, INIT = 2, EVENT = 4, CONT = 8, TERM = 16, FAIL = 32 };
enum { FIXED, TUNABLE, INPUT, DISCRETE_INPUT, STATE, OTHER };
#define PERIOD 0.25
#define ORDER "the order of states is another"

typedef struct {
    double time, shown, k, e, u, x, v, a, nominal, stop, next, last_event, last_step, kept, kept_v, kept_k, kept_time, derived_x, derived_v, before, timed, later_v, first_k, first_x;
    int above_read, set, is_new, is_kept, is_read, is_shown, up, stairs, turns, above, below, rising, stiff, state, set_up, iteration, evaluations, derivatives;
    const void *owner;
} Data;
typedef struct {
    unsigned reference;
    char type;
    int kind;
    size_t offset;
} Variable;
#define O(x) offsetof(Data, x)
static const Variable VARIABLES[] = {
    {0, 'r', OTHER, O(time)},  {1, 'r', TUNABLE, O(k)},        {2, 'r', FIXED, O(e)},
    {3, 'r', INPUT, O(u)},     {10, 'r', STATE, O(x)},         {11, 'r', STATE, O(v)},
    {12, 'r', OTHER, O(a)},    {1, 'b', DISCRETE_INPUT, O(up)}, {2, 'b', OTHER, O(above)},
    {1, 'i', OTHER, O(stairs)}, {2, 'i', OTHER, O(turns)},
};
enum { COUNT = sizeof VARIABLES / sizeof *VARIABLES };

typedef struct {
    Data d;
    fmi2CallbackFunctions callbacks;
    char name[600];
    unsigned enabled;
} Model;

static char mutation[100], flags[200];
static double shared; /* input of all instances */
static double computed;
static int stale;
#define IS(n) (!strcmp(mutation, n))
#define FLAG(n) (strstr(flags, n) != NULL)
static const char *CATEGORIES[] = {"logEvents", "logStatusDiscard", "logStatusError"};

static void say(Model *m, fmi2Status status, int category, const char *text) {
    if (m->enabled & (1u << category))
        m->callbacks.logger(m->callbacks.componentEnvironment, m->name, status, CATEGORIES[category], "%s", text);
}
static fmi2Status error(Model *m, const char *text) {
    say(m, fmi2Error, 2, text);
    m->d.state = FAIL;
    return fmi2Error;
}
static fmi2Status need(Model *m, int states, const char *function) {
    char cell[100];
    if (m->d.state & states) {
        snprintf(cell, sizeof cell, "%s fails in state %d", function + 4, m->d.state);
        return IS(cell) ? error(m, function) : fmi2OK;
    }
    return error(m, function);
}
#define NEED(states)                                                                                         \
    if (need(m, states, __func__) != fmi2OK) return fmi2Error

static void evaluate(Data *d) {
    d->is_new = 1;
    if (IS("values stay in event mode once they are read") && d->is_read && d->state == EVENT) return;
    if (IS("values stay in continuous-time mode once they are read") && d->is_read && d->state == CONT) return;
    if (IS("instances share an input")) d->u = shared;
    if (d->state <= INIT) d->first_k = d->k;
    const double k = IS("a tunable parameter acts from initialization mode alone") ? d->first_k : d->k;
    d->a = d->u - k * d->x + 0.1 * d->stairs * (d->up ? 1 : -1);
    if (FLAG("a product with an input")) d->a += d->u * d->x;
    if (FLAG("a hidden value of the start")) d->a += d->first_x;
    if (FLAG("a relation of a parameter") && (d->state == EVENT ? d->k > 4.01 : d->stiff)) d->a += 1;
    if (IS("a relation in a derivative is not frozen")) d->a += d->state == CONT ? d->x > 0.1 : d->above;
    if (IS("a derivative jumps without an event")) d->a += d->time > 1.23;
    if (IS("relations follow states where continuous time begins") && d->state == CONT && d->time == d->last_event)
        d->above = d->x > 0.1;
    if (d->state != CONT) d->timed = d->time;
    if (IS("values stay where time is set alone") || IS("values stay where time is set back")) d->a += 0.05 * d->timed;
    if (IS("derivatives have a history")) d->a += 1e-3 * d->derivatives;
    if (IS("relations are not frozen") && d->state == CONT) d->above = d->x > 0.1;
    if (IS("a relation of an input is not frozen") && d->state == CONT && d->u > 0.5) d->above = 1;
    if (d->state == INIT || d->state == EVENT) d->above = d->x - 0.1 > 0, d->below = d->x + 0.3 < 0;
}
static double acceleration(Data *d);
static void start(Data *d) {
    memset(d, 0, sizeof *d);
    d->k = 4, d->e = 0.8, d->u = 0.2, d->x = 0.5, d->v = -0.5, d->up = 1, d->nominal = 1;
    d->stop = d->next = INFINITY;
    shared = d->u;
    d->last_event = d->last_step = -INFINITY;
    d->state = INST;
    evaluate(d);
    d->above = d->x > 0.1;
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

static void decode(const char *uri, char *path) {
    unsigned character;
    uri += !strncmp(uri, "file:///", 8) ? 7 : !strncmp(uri, "file://", 7) ? 7 : 5;
    if (uri[1] && uri[2] == ':') uri++; /* the slash before the drive of Windows */
    for (; *uri; uri++)
        if (*uri == '%' && sscanf(uri + 1, "%2x", &character) == 1) {
            *path++ = (char)character;
            uri += 2;
        } else *path++ = *uri;
    *path = 0;
}
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String location,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
    char path[3000];
    decode(location, path);
    strcat(path, "/mutation.txt");
    FILE *file = fopen(path, "r");
    if (file) {
        if (fgets(mutation, sizeof mutation, file)) mutation[strcspn(mutation, "\n")] = 0;
        if (fgets(flags, sizeof flags, file)) flags[strcspn(flags, "\n")] = 0;
        fclose(file);
    }
    if (type != fmi2ModelExchange || strcmp(guid, "{0ddba11a-0000-4000-8000-0000000000b7}")) {
        callbacks->logger(callbacks->componentEnvironment, name, fmi2Error, CATEGORIES[2], "wrong type or GUID");
        return NULL;
    }
    Model *m = calloc(1, sizeof *m);
    if (!m) return NULL;
    m->callbacks = *callbacks;
    snprintf(m->name, sizeof m->name, "%s", name);
    m->enabled = logging ? 7 : 0;
    start(&m->d);
    say(m, fmi2OK, 0, "instantiated");
    return m;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    Model *m = c;
    unsigned chosen = n ? 0 : 7;
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < 3; k++)
            if (!strcmp(categories[i], CATEGORIES[k])) chosen |= 1u << k;
    m->enabled = on ? chosen : m->enabled & ~chosen;
    return fmi2OK;
}
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real time,
                               fmi2Boolean stop_defined, fmi2Real stop) {
    Model *m = c;
    NEED(INST);
    m->d.set_up = 1;
    m->d.time = IS("a negative start time is 0") ? fmax(time, 0) : time;
    m->d.stop = stop_defined ? stop : INFINITY;
    return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    Model *m = c;
    NEED(INST);
    if (!m->d.set_up) return error(m, "set-up first");
    m->d.state = INIT;
    m->d.next = m->d.time + PERIOD;
    evaluate(&m->d);
    return fmi2OK;
}
fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    Model *m = c;
    NEED(INIT);
    m->d.rising = m->d.v > 0;
    m->d.first_x = m->d.x;
    m->d.before = m->d.v;
    m->d.state = IS("initialization ends in continuous-time mode") ? CONT : EVENT;
    m->d.last_event = m->d.last_step = m->d.time;
    evaluate(&m->d);
    return fmi2OK;
}
fmi2Status fmi2Terminate(fmi2Component c) {
    Model *m = c;
    NEED(EVENT | CONT);
    m->d.state = TERM;
    if (IS("final values after an event are lost") && m->d.stairs) m->d.v = -0.5;
    return fmi2OK;
}
fmi2Status fmi2Reset(fmi2Component c) {
    Model *m = c;
    const double nominal = m->d.nominal;
    start(&m->d);
    if (IS("reset keeps nominal values")) m->d.nominal = nominal;
    return fmi2OK;
}

static const Variable *variable(char type, unsigned reference) {
    for (int i = 0; i < COUNT; i++)
        if (VARIABLES[i].type == type && VARIABLES[i].reference == reference) return VARIABLES + i;
    return NULL;
}
static int settable(const Model *m, const Variable *v) {
    switch (m->d.state) {
        case INST: return v->kind == FIXED || v->kind == TUNABLE || v->kind == STATE;
        case INIT: return v->kind != OTHER;
        case EVENT: return v->kind == TUNABLE || v->kind == INPUT || v->kind == DISCRETE_INPUT;
        default: return v->kind == INPUT || (v->kind == STATE && !IS("states cannot be set by reference"));
    }
}
#define ACCESS(Name, type, letter)                                                                           \
    fmi2Status fmi2Get##Name(fmi2Component c, const fmi2ValueReference r[], size_t n, type values[]) {       \
        Model *m = c;                                                                                        \
        NEED(INIT | EVENT | CONT | TERM | FAIL);                                                             \
        if (IS("an Integer is discarded before a Real") && letter == 'i' && m->d.state == CONT && !m->d.is_read) \
            return say(m, fmi2Discard, 1, "nothing is computed"), fmi2Discard;                               \
        m->d.is_read = 1;                                                                                    \
        if (IS("one instance computes for all") && stale) evaluate(&m->d);                                   \
        stale = 0;                                                                                           \
        for (size_t i = 0; i < n; i++) {                                                                     \
            const Variable *v = variable(letter, r[i]);                                                      \
            if (!v) return error(m, "no such variable");                                                     \
            if (IS("a variable cannot be read") && v->offset == O(a)) return error(m, "is not computed");    \
            values[i] = *(type *)((char *)&m->d + v->offset);                                                \
            if (IS("a value is that before the evaluation") && v->offset == O(v) && m->d.state == CONT)       \
                values[i] = (type)m->d.derived_v;                                                            \
            if (v->offset == O(a) && !IS("one instance computes for all"))                                   \
                values[i] = (type)acceleration(&m->d);                                                       \
            if (IS("memory of the importer is taken for a moment") && m->callbacks.allocateMemory)           \
                m->callbacks.freeMemory(m->callbacks.allocateMemory(1, 1));                                  \
            if (IS("a variable stays where time is set alone") && v->offset == O(a))                         \
                values[i] += (type)(0.05 * m->d.timed);                                                      \
            if (IS("a state by reference is that before an event") && v->offset == O(v) && m->d.state == EVENT) \
                values[i] = (type)m->d.before;                                                               \
            if (IS("a derivative by reference is wrong after an event") && v->offset == O(a) && m->d.stairs > 5) \
                values[i] += (type)(m->d.time > m->d.last_event);                                                \
            if (v->offset == O(a) && !m->d.is_shown++) m->d.shown = m->d.a;                                  \
            if (IS("a variable stays where states are set alone") && v->offset == O(a) && m->d.state == CONT) \
                values[i] = (type)m->d.shown;                                                                \
            if (IS("time is read from 0 on") && v->offset == O(time)) values[i] -= (type)0.5;                \
            if (IS("time in multiples of 1 ms") && v->offset == O(time))                                     \
                values[i] = (type)(1e-3 * floor(1e3 * m->d.time + 0.5));                                                \
            if (IS("out of range for a moment") && v->offset == O(stairs) && fabs(m->d.time - 2.3) < 0.05)   \
                values[i] = (type)-5;                                                                        \
        }                                                                                                    \
        return fmi2OK;                                                                                       \
    }                                                                                                        \
    fmi2Status fmi2Set##Name(fmi2Component c, const fmi2ValueReference r[], size_t n, const type values[]) { \
        Model *m = c;                                                                                        \
        NEED(INST | INIT | EVENT | CONT);                                                                    \
        for (size_t i = 0; i < n; i++) {                                                                     \
            const Variable *v = variable(letter, r[i]);                                                      \
            if (!v) return error(m, "no such variable");                                                     \
            if (!settable(m, v)) return error(m, "not settable");                                            \
            if (IS("inputs in continuous-time mode are lost") && m->d.state == CONT && m->d.stairs) continue; \
            if (IS("the second set in continuous-time mode is lost") && m->d.state == CONT && m->d.set++)    \
                continue;                                                                                    \
            *(type *)((char *)&m->d + v->offset) = values[i];                                                \
            if (v->offset == O(u)) shared = m->d.u;                                                          \
            if (IS("a discarded value is an error") && v->offset == O(u) && m->d.u > 0.7) {                  \
                m->d.u = 0.2;                                                                                \
                m->d.state = FAIL;                                                                           \
                return say(m, fmi2Discard, 1, "u above 0.7"), fmi2Discard;                                   \
            }                                                                                                \
        }                                                                                                    \
        stale = 1;                                                                                           \
        m->d.is_shown = 0;                                                                                   \
        if (!IS("one instance computes for all")) evaluate(&m->d);                                           \
        return fmi2OK;                                                                                       \
    }
ACCESS(Real, fmi2Real, 'r')
ACCESS(Integer, fmi2Integer, 'i')
ACCESS(Boolean, fmi2Boolean, 'b')
fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2String values[]) {
    return n ? error(c, "no such variable") : fmi2OK;
}
fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2String values[]) {
    return n ? error(c, "no such variable") : fmi2OK;
}

/* Model exchange */

fmi2Status fmi2EnterEventMode(fmi2Component c) {
    Model *m = c;
    NEED(EVENT | CONT);
    m->d.state = EVENT;
    m->d.last_event = m->d.time;
    m->d.before = m->d.v;
    m->d.iteration = m->d.is_read = 0;
    evaluate(&m->d);
    return fmi2OK;
}
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
    Model *m = c;
    Data *d = &m->d;
    NEED(EVENT);
    d->is_read = 0;
    const fmi2EventInfo given = *info;
    d->stiff = d->k > 4.01; /* frozen in continuous-time mode */
    memset(info, 0, sizeof *info);
    if (IS("a flag of an event is not written"))
        info->nominalsOfContinuousStatesChanged = given.nominalsOfContinuousStatesChanged;
    if (d->time >= d->next) {
        d->stairs++;
        d->next += PERIOD;
        info->newDiscreteStatesNeeded = fmi2True;
    }
    if (IS("a Boolean input ends the run") && !d->up) return error(m, "not up");
    if (IS("events never end for another input") && !d->up) info->newDiscreteStatesNeeded = fmi2True;
    if (IS("late events never end for another input") && !d->up && d->stairs > 9)
        info->newDiscreteStatesNeeded = fmi2True;
    if (IS("events never end") && d->stairs > 1) info->newDiscreteStatesNeeded = fmi2True;
    if (IS("an event ends too early") && d->stairs > 1 && ++d->iteration == 2) d->turns++;
    d->before = d->v;
    if (d->x < -0.3 && d->v < 0) {
        if (IS("states change where continuous time begins")) d->later_v = -d->e * d->v;
        else d->v *= -d->e;
        info->valuesOfContinuousStatesChanged = !IS("a change of states is not announced");
    }
    if (IS("states that stay are announced") && d->stairs) info->valuesOfContinuousStatesChanged = fmi2True;
    if (d->rising != (d->v > 0) && !FLAG("completed steps are not needed")) {
        d->rising = d->v > 0;
        d->turns++;
        d->nominal = d->rising ? 0.5 : 1;
        info->nominalsOfContinuousStatesChanged =
            !IS("a change of nominals is not announced") && (d->up || !IS("a change of nominals for another input is not"));
    }
    if (IS("a nominal of 0") && d->turns) d->nominal = 0;
    info->nextEventTimeDefined = !IS("time events are not announced");
    info->nextEventTime = d->next;
    if (IS("the next event is lost at another one") && d->time > d->next - PERIOD + 1e-9)
        info->nextEventTimeDefined = fmi2False;
    if (IS("the next event is in the past") && d->stairs > 1) info->nextEventTime = d->time - 0.1;
    if (IS("ends without a message") && d->stairs > 2) info->terminateSimulation = fmi2True;
    evaluate(d);
    return fmi2OK;
}
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) {
    Model *m = c;
    NEED(EVENT);
    m->d.state = CONT;
    if (m->d.later_v) m->d.v = m->d.later_v, m->d.later_v = 0;
    m->d.set = 0;
    m->d.derived_x = m->d.x;
    m->d.derived_v = m->d.v;
    m->d.is_kept = m->d.is_read = m->d.is_shown = 0;
    return fmi2OK;
}
fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_set_state, fmi2Boolean *enter,
                                       fmi2Boolean *terminate) {
    Model *m = c;
    NEED(CONT);
    m->d.last_step = m->d.time;
    m->d.derived_v = m->d.v;
    if (!IS("enterEventMode is not written")) *enter = m->d.rising != (m->d.v > 0);
    if (IS("enterEventMode is 7")) *enter = 7;
    *terminate = fmi2False;
    if (IS("a completed step ends continuous-time mode")) m->d.state = EVENT;
    if (IS("a completed step that is not needed acts")) m->d.x += 1e-3;
    if (IS("a completed step that is not needed acts at a later event") && m->d.x < 0) m->d.e = 0.5;
    if (IS("a completed step changes a state") && m->d.x < 0) m->d.v *= 0.99;
    if (IS("a completed step counts where no event comes") && m->d.x < 0) m->d.stairs++;
    if (FLAG("completed steps are not needed")) *enter = IS("a step event where no call is needed") && m->d.time > 3;
    if (IS("a late event comes by a completed step alone") && m->d.time > 3.6 && !m->d.turns) *enter = m->d.turns = 1;
    return fmi2OK;
}
fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
    Model *m = c;
    NEED(CONT);
    if (time > m->d.stop * (1 + 1e-9)) return error(m, "beyond the stop time");
    if (time < m->d.last_event) return error(m, "before the last event");
    if (IS("no way back in time") && time < m->d.last_step) return error(m, "back in time");
    if (IS("the time of the event is refused") && time == m->d.last_event && m->d.time > time)
        return error(m, "back at the event");
    if (IS("values stay where time is set back") && time > m->d.time) m->d.timed = time;
    if (IS("time is not set back to an event") && time == m->d.last_event) return fmi2OK;
    m->d.time = time;
    m->d.is_kept = m->d.is_read = m->d.is_shown = 0;
    evaluate(&m->d);
    return fmi2OK;
}
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
    Model *m = c;
    NEED(CONT);
    if (n != 2) return error(m, "two states");
    if (x[0] < -5 || x[0] > 1e3) {
        say(m, fmi2Discard, 1, "too far");
        if (IS("a discarded state ends the run") && x[0] > 1e3) m->d.state = FAIL;
        return fmi2Discard;
    }
    const int first = IS(ORDER);
    m->d.x = IS("states are limited") ? fmin(x[0], 0.5) : x[first];
    m->d.v = x[1 - first];
    m->d.timed = m->d.time;
    if (IS("derivatives stay where an input is set alone")) m->d.is_kept = 0;
    evaluate(&m->d);
    return fmi2OK;
}
#define VECTOR(Name, states, count, first, second)                                                           \
    fmi2Status fmi2Get##Name(fmi2Component c, fmi2Real values[], size_t n) {                                 \
        Model *m = c;                                                                                        \
        Data *d = &m->d;                                                                                     \
        NEED(states);                                                                                        \
        if (n != count) return error(m, "wrong number");                                                     \
        const int other = IS(ORDER) && strstr("Derivatives ContinuousStates", #Name);                        \
        values[other] = first;                                                                               \
        if (!IS(#Name " are not all written")) values[1 - other] = second;                                   \
        if (IS(#Name " are too many")) values[2] = 7;                                                        \
        return fmi2OK;                                                                                       \
    }
enum { READ = INIT | EVENT | CONT | TERM | FAIL };
static double acceleration(Data *d) {
    const int is_new = d->is_new;
    evaluate(d);
    d->is_new = 0;
    if (is_new) computed = d->a;
    if (IS("instances compute into the same memory")) return computed;
    if (IS("derivatives follow a tunable parameter late")) {
        if (d->kept_time != d->time || d->state < EVENT) d->kept_k = d->k;
        d->kept_time = d->time;
        return d->a + (d->k - d->kept_k) * d->x;
    }
    if (!d->is_kept || d->state != CONT) d->kept = d->a;
    d->is_kept = 1;
    if (IS("derivatives stay until the second state is set") && d->state == CONT) {
        if (d->kept_v != d->v) d->kept = d->a;
        d->kept_v = d->v;
        return d->kept;
    }
    d->derived_x = d->x;
    d->derived_v = d->v;
    const int stay = IS("derivatives stay until the time is set") || IS("derivatives stay where an input is set alone");
    return stay ? d->kept : d->a;
}
VECTOR(Derivatives, READ, 2, (d->derivatives++, d->v), acceleration(d))
static double velocity(Data *d) {
    return IS("a state is given as it was before an event") && d->state == EVENT ? d->before : d->v;
}
VECTOR(ContinuousStates, READ, 2, d->x, velocity(d))
VECTOR(NominalsOfContinuousStates, READ | INST, 2, IS("nominals of other states") ? 3 : d->nominal, IS("nominals change with time") ? 1 + d->time : 1)
static double level(Data *d) {
    if (IS("an indicator of a distance")) return fabs(d->x - 0.1) + 1e-9;
    if (IS("an indicator near 0 changes with each call") && fabs(d->x - 0.1) < 1e-4) d->above_read = !d->above_read;
    if (d->above_read) return d->x - 0.1 + 2e-5;
    const double x = IS("indicators are those of the last derivatives") && d->state == CONT ? d->derived_x : d->x;
    const double z = x - 0.1 + (d->above ? 1e-9 : -1e-9);
    if (IS("an indicator is no number") && d->stairs > 1) return NAN;
    if (IS("an indicator of two values")) return z > 0 ? 1 : -1;
    if (FLAG("an indicator grows with an input")) return z * (1 + 1e8 * fabs(d->u - 0.2));
    return z;
}
static double floor_level(Data *d) {
    const int time_event = d->stairs && fabs(d->next - PERIOD - d->time) < 1e-9;
    if (IS("an indicator is 0 after a time event") && d->state == CONT && time_event) return 0;
    if (IS("an indicator is 0 after an event") && d->state == CONT && d->time == d->last_event) return 0;
    if (IS("an indicator without hysteresis")) return d->x + 0.3;
    return d->x + 0.3 + (d->below ? -1e-9 : 1e-9);
}
VECTOR(EventIndicators, READ, 2, level(d), floor_level(d))

/* States and derivatives */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
    if (!*state) *state = calloc(1, sizeof(Data));
    memcpy(*state, &((Model *)c)->d, sizeof(Data));
    if (IS("bytes of another instance are refused")) ((Data *)*state)->owner = c;
    return fmi2OK;
}
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
    Model *m = c;
    const Data before = m->d;
    if (IS("a state of long before is refused") && before.stairs > ((Data *)state)->stairs + 6)
        return error(m, "too old");
    m->d = *(Data *)state;
    if (IS("states without the next event")) m->d.next = before.next;
    return fmi2OK;
}
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    free(*state);
    *state = NULL;
    return fmi2OK;
}
fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *n) {
    *n = sizeof(Data) - 8 * IS("the size of a state is too small");
    return fmi2OK;
}
fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t n) {
    if (n < sizeof(Data)) return error(c, "no room");
    memcpy(bytes, IS("bytes are those of the present") ? &((Model *)c)->d : (Data *)state, sizeof(Data));
    return fmi2OK;
}
fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t n, fmi2FMUstate *state) {
    if (((const Data *)bytes)->owner && ((const Data *)bytes)->owner != c) return error(c, "another instance");
    if (!*state) *state = calloc(1, sizeof(Data));
    memcpy(*state, bytes, sizeof(Data));
    return fmi2OK;
}
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknowns[], size_t n,
                                        const fmi2ValueReference knowns[], size_t count, const fmi2Real seed[],
                                        fmi2Real result[]) {
    Model *m = c;
    NEED(READ);
    for (size_t i = 0; i < n; i++) {
        result[i] = 0;
        for (size_t j = 0; j < count; j++) {
            const unsigned u = unknowns[i], k = knowns[j];
            double factor = u == k;
            if (u == 12) factor = k == 3 ? 1 : k == 10 ? -m->d.k : k == 1 ? -m->d.x : factor;
            if (FLAG("a product with an input") && u == 12) factor += k == 3 ? m->d.x : k == 10 ? m->d.u : 0;
            if (IS("late directional derivatives are wrong") && u == 12 && k == 10 && m->d.time > 2) factor *= 2;
            if (IS("directional derivatives of event mode") && u == 12 && k == 10 && m->d.state == EVENT) factor = 0;
            result[i] += factor * seed[j];
        }
    }
    return fmi2OK;
}
