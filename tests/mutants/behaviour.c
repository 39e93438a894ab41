/* A legal slave of FMI 2.0 for co-simulation that misbehaves in one way: by the name in resources/mutation.txt.
 *
 *   x' = rate (gain u - x),  y = x + u,  twice = 2 gain,  z = x / 2,  count: steps + n,  not_b = !b,  text = label
 *
 * `IS("...")` is where a mutant differs from the legal slave; the list of all stands in slaves.toml.
 */

#define _GNU_SOURCE
#include <fenv.h>
#include <locale.h>
#include <math.h>
#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "fmi2Functions.h"

enum { TIME, GAIN, RATE, U, X, DER_X, Y, C, TWICE, Z, N_REALS };
enum { N, COUNT, MODE, N_INTEGERS };
enum { B, NOT_B, N_BOOLEANS };
enum { LABEL, TEXT, N_STRINGS };
enum { INSTANTIATED = 1, INITIALIZATION = 2, STEPPING = 4, TERMINATED = 8, FAILED = 16, PENDING = 32, ALL = 31 };

typedef struct {
    double real[N_REALS], input_rate, last_successful_time, first_step, first_rate, old_y;
    int integer[N_INTEGERS], boolean[N_BOOLEANS], steps, state, stale, resets, is_set, is_old;
    char label[64];
} Data;

typedef struct {
    Data data;
    double stop_time;
    fmi2CallbackFunctions callbacks;
    const fmi2CallbackFunctions *structure;
    const char *given_name;
    char name[64], location[1024];
    const char *given_label, *given_location;
    int logs, errors, callbacks_allocate, resets;
    unsigned enabled;
} Slave;

static const char GUID[] = "{5ba0ed5f-5d2c-4f3d-9a0b-2f1a0a1b9a5e}";
static char mutation[64];
/* from the second line of the file */
static int own_memory, asynchronous, finishes_all, one_step_size, discards_all, discards_late, warns, once, iterates, internal_steps, needs_rate,
    unusual, refuses_others, warm, reads_after_steps;
static Data shared;
static int instances, created, overwritten, ended, all_steps;

#define IS(name) (!strcmp(mutation, name))
static const char *const CATEGORIES[] = {"logEvents", "logStatusWarning", "logStatusDiscard", "logStatusError"};
enum { EVENTS = 1, WARNINGS = 2, DISCARDS = 4, ERRORS = 8 };

static void send(Slave *s, fmi2Status status, unsigned category, const char *text) {
    if (!(s->enabled & category) && !(IS("logs although logging is off") && category == EVENTS) &&
        !(IS("logs categories that were not chosen") && s->enabled))
        return;
    if (IS("silent refusals") && status != fmi2OK) return;
    const char *name = IS("messages without instance name") ? NULL : s->name;
    const char *label = CATEGORIES[category == EVENTS ? 0 : category == WARNINGS ? 1 : category == DISCARDS ? 2 : 3];
    fmi2ComponentEnvironment environment = s->callbacks.componentEnvironment;
    if (IS("keeps the pointer to its name")) name = s->given_name;
    if (IS("another instance name")) name = "someone";
    if (IS("an undeclared category")) label = "debug";
    if (IS("no category")) label = NULL;
    if (IS("no environment")) environment = NULL;
    if (IS("a variable that is none")) text = "look at #r99#";
    if (IS("a single hash")) text = "channel #4";
    if (IS("a status that is none")) status = 17;
    const int rounds = IS("rounds in a callback") || (IS("rounds in a late callback") && s->data.real[TIME] > 5);
    if (rounds) fesetround(FE_UPWARD);
    char folder[3000];
    const int moves = IS("another working directory in a callback") && getcwd(folder, sizeof folder) && !chdir("/");
    const fmi2CallbackLogger logger =
        IS("keeps the pointer to the callbacks") ? s->structure->logger : s->callbacks.logger;
    logger(environment, name, status, label, "%s", text);
    if (rounds) fesetround(FE_TONEAREST);
    if (moves) (void)!chdir(folder);
}

static fmi2Status discard(Slave *s, const char *text) {
    send(s, fmi2Discard, DISCARDS, text);
    return fmi2Discard;
}

static fmi2Status error(Slave *s, const char *text) {
    send(s, fmi2Error, ERRORS, text);
    s->data.state = FAILED;
    return fmi2Error;
}

static int allowed(Slave *s, int states, const char *function) {
    if (s->data.state & states) return 1;
    if (IS("forbidden calls succeed")) return 1;
    error(s, function);
    return 0;
}

#define NEEDS(states) \
    if (!allowed(s, states, __func__)) return fmi2Error

static void reset(Data *d) {
    const double start[N_REALS] = {0, 2, 1, 0.8, 1, 0, 0, 3.5, 4, 0.5};
    memset(d, 0, sizeof *d);
    memcpy(d->real, start, sizeof start);
    d->integer[N] = d->integer[MODE] = 1;
    d->boolean[NOT_B] = 1;
    if (unusual) d->integer[N] = 2147483647, d->real[C] = 0.1f;
    strcpy(d->label, "model");
    d->state = INSTANTIATED;
    d->stale = 1;
}

static double slope(const Data *d, double u) {
    const int is_first = IS("a tunable parameter acts from the start alone") && d->state == STEPPING;
    return (is_first ? d->first_rate : d->real[RATE]) * (d->real[GAIN] * u - d->real[X]);
}

static void outputs(Data *d, double u) {
    d->real[DER_X] = slope(d, u);
    d->real[Y] = d->real[X] + u;
    if (iterates && d->state == INITIALIZATION) d->real[Y] += 1e-7 * sin(1e12 * d->real[GAIN]);
    d->real[Z] = d->real[X] / 2;
    const int is_old = IS("a calculated parameter stays in initialization mode") && d->state == INITIALIZATION;
    if (d->state != STEPPING && !is_old) d->real[TWICE] = 2 * d->real[GAIN];
    d->integer[COUNT] = d->steps + (unusual ? d->integer[N] % 1000 : d->integer[N]);
    if (unusual) { /* a ripple of 1 / (0.1 s), an event at the start, and a table that is left beyond the range of gain */
        d->real[Y] += 0.1 * sin(62.83185307179586 * d->real[TIME]);
        if (d->state == STEPPING) d->real[Z] = 0.7 * d->real[X];
        overwritten |= d->real[GAIN] < 0 || d->real[GAIN] > 10;
        if (overwritten) d->real[Y] += 1e-3 * overwritten++;
    }
    d->boolean[NOT_B] = !d->boolean[B];
    if (IS("outputs follow what they do not declare") && d->state == INITIALIZATION) d->real[Y] += d->real[RATE];
    if (IS("outputs that do not follow what they declare")) d->real[Y] = d->real[X];
    if (IS("an output that is no number")) d->real[Y] = NAN;
    if (IS("Booleans of 2")) d->boolean[NOT_B] = d->boolean[B] ? 0 : 2;
    if (IS("outputs of another range")) d->integer[COUNT] = -5;
    d->stale = 0;
}

/* what of y follows the time, where that is known */
static void follow_time(Data *d) {
    if (IS("outputs in initialization mode are those of time 0")) d->real[Y] += 0.1 * d->real[TIME];
}

static void refresh(Slave *s) {
    Data *d = &s->data;
    if (!(d->state & (INSTANTIATED | INITIALIZATION))) return;
    if (!d->stale && IS("values that were read once do not follow")) return;
    if (!d->stale && IS("beside start values, values that were read once do not follow") && d->real[GAIN] == 2) return;
    outputs(d, d->real[U]);
}

/* Instances */

const char *fmi2GetTypesPlatform(void) { return IS("another platform of types") ? "mine" : fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return IS("another version") ? "2.1" : fmi2Version; }

static void refuse_instance(const fmi2CallbackFunctions *f, fmi2String name, const char *text) {
    if (IS("refuses an instance in silence")) return;
    f->logger(f->componentEnvironment, name, fmi2Error, CATEGORIES[3], "%s", text);
}

/* The path of a URI; 0 if it is not understood. */
static int path_of(const char *uri, char *path) {
    const char *p = uri;
    char *end = path;
    if (strncmp(p, "file:", 5)) return 0;
    p += 5;
    if (!strncmp(p, "//", 2)) {
        p += 2;
        if (*p != '/') p = strchr(p, '/');
    } else if (IS("file:/ is not understood"))
        return 0;
    if (!p) return 0;
    if (p[0] && p[1] && p[2] == ':') p++; /* the slash before the drive of Windows */
    for (; *p; p++) {
        unsigned code;
        if (*p == '%' && !IS("percent signs are not decoded") && sscanf(p + 1, "%2x", &code) == 1) {
            *end++ = (char)code;
            p += 2;
        } else
            *end++ = *p;
    }
    *end = 0;
    return 1;
}

static int read_mutation(const char *uri) {
    char path[1100];
    if (!path_of(uri, path)) return 0;
    strcat(path, "/mutation.txt");
    FILE *file = fopen(path, "r");
    if (!file) return 0;
    char flags[64] = "";
    if (!fgets(mutation, sizeof mutation, file)) mutation[0] = 0;
    mutation[strcspn(mutation, "\n")] = 0;
    if (!fgets(flags, sizeof flags, file)) flags[0] = 0;
    own_memory = !strstr(flags, "callbacks");
    asynchronous = !!strstr(flags, "asynchronous");
    finishes_all = !!strstr(flags, "finishes all");
    one_step_size = !!strstr(flags, "one step size");
    discards_all = !!strstr(flags, "discards all");
    discards_late = !!strstr(flags, "discards late");
    warns = !!strstr(flags, "warns");
    once = !!strstr(flags, "once");
    iterates = !!strstr(flags, "iterates");
    internal_steps = !!strstr(flags, "internal steps");
    needs_rate = !!strstr(flags, "needs a rate");
    unusual = !!strstr(flags, "unusual");
    refuses_others = !!strstr(flags, "refuses others");
    warm = !!strstr(flags, "a warm solver");
    reads_after_steps = !!strstr(flags, "reads after steps"); /* as 4.2.4 lets it */
    if (!IS("files stay open")) fclose(file);
    return 1;
}

static void *sleeper(void *nothing) {
    (void)nothing;
    for (;;) pause();
    return NULL;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String location,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    (void)visible;
    if (!read_mutation(location)) {
        char text[1100];
        snprintf(text, sizeof text, "cannot read %s", location);
        refuse_instance(functions, name, text);
        return NULL;
    }
    if (type != fmi2CoSimulation || (strcmp(guid, GUID) && !IS("any GUID")) || IS("no instance")) {
        refuse_instance(functions, name, "another GUID");
        return NULL;
    }
    if (IS("only one instance at a time") && instances) {
        refuse_instance(functions, name, "there is one");
        return NULL;
    }
    if (refuses_others && created++) {
        refuse_instance(functions, name, "this process had its instance");
        return NULL;
    }
    if (IS("no licence") || (IS("licences for 22 instances") && created++ > 22)) {
        refuse_instance(functions, name, "The license file was not found");
        return NULL;
    }
    if (IS("no second life") && instances++) return NULL;
    if (IS("no instance after many others") && created++ > 22) return NULL;
    if (IS("an instance after others crashes") && instances++ > 15) abort();
    if (IS("an instance after one that was reset crashes") && ended) abort();
    Slave *s = functions->allocateMemory && functions->freeMemory && !own_memory
                   ? functions->allocateMemory(1, sizeof *s)
                   : calloc(1, sizeof *s);
    if (!s) return NULL;
    if (IS("memory functions are called") && !functions->allocateMemory(1, 8)) return NULL;
    if (IS("needs stepFinished") && !functions->stepFinished) return NULL;
    if (IS("needs the environment") && !functions->componentEnvironment) return NULL;
    if (!IS("no second life")) instances++;
    s->callbacks_allocate = !own_memory;
    s->callbacks = *functions;
    s->structure = functions;
    s->given_name = name;
    snprintf(s->name, sizeof s->name, "%s", name);
    snprintf(s->location, sizeof s->location, "%s", location);
    s->enabled = logging ? 15 : 0;
    s->stop_time = INFINITY;
    reset(&s->data);
    if (once && shared.real[GAIN]) s->data.real[GAIN] = shared.real[GAIN]; /* of the instance before it */
    if (IS("keeps the pointer to the location")) s->given_location = location;
    if (IS("a changed working directory")) (void)!chdir("/");
    if (IS("a changed locale")) setlocale(LC_ALL, "C.UTF-8");
    if (IS("a changed rounding mode")) fesetround(FE_UPWARD);
    if (IS("traps of exceptions")) feenableexcept(FE_DIVBYZERO);
    if (IS("a changed signal handler")) signal(SIGUSR2, SIG_IGN);
    if (IS("a changed file mode mask")) umask(077);
    if (IS("threads stay")) {
        pthread_t thread;
        pthread_create(&thread, NULL, sleeper, NULL);
    }
    send(s, fmi2OK, EVENTS, "instantiated");
    return s;
}

void fmi2FreeInstance(fmi2Component c) {
    Slave *s = c;
    if (IS("free of NULL crashes") && !s) abort();
    if (!s) return;
    ended |= s->resets > 0;
    if (IS("free crashes in initialization mode") && s->data.state == INITIALIZATION) abort();
    if (!IS("no second life")) instances--;
    if (IS("memory leaks")) return;
    if (s->callbacks_allocate) {
        if (IS("memory that is not its own is freed")) s->callbacks.freeMemory((char *)s + 8);
        if (!IS("memory is not given back")) s->callbacks.freeMemory(s);
    } else
        free(s);
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    Slave *s = c;
    unsigned chosen = n ? 0 : 15;
    if (IS("debug logging is refused when terminated") && s->data.state == TERMINATED) return error(s, "no");
    for (size_t i = 0; i < n; i++)
        for (unsigned k = 0; k < 4; k++)
            if (!strcmp(categories[i], CATEGORIES[k])) chosen |= 1u << k;
    if (IS("categories are refused") && n == 1) return error(s, "no categories");
    if (IS("debug logging stays on") && !on) return fmi2OK;
    if (IS("categories are not enabled") && n) return fmi2OK;
    if (IS("all categories are enabled") && n) chosen = 15;
    if (IS("no names enable no category") && !n) chosen = 0;
    s->enabled = on ? chosen : 0;
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean has_stop, fmi2Real stop) {
    Slave *s = c;
    NEEDS(INSTANTIATED);
    if (IS("a tolerance is refused") && has_tolerance) return error(s, "no tolerance");
    if (IS("an undefined stop time counts") && stop < start) return error(s, "stop time before start time");
    s->data.real[TIME] = IS("the start time is ignored") ? 0 : start;
    s->data.last_successful_time = start;
    if (IS("an undefined tolerance acts")) s->data.real[X] *= 1 + tolerance;
    s->stop_time = has_stop || (IS("a later stop time counts undefined") && stop > start) ? stop : INFINITY;
    if (IS("the stop time is reached too early") && has_stop) s->stop_time = stop - 0.05;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    Slave *s = c;
    NEEDS(INSTANTIATED);
    if (IS("no licence to initialise")) return error(s, "the licence server does not answer");
    if (IS("initialising again leaks") && s->resets) s->callbacks.allocateMemory(1, 64);
    if (IS("another start value")) s->data.real[RATE] *= 1.5;
    if (IS("values set when instantiated are lost")) s->data.real[GAIN] = 2;
    if (IS("keeps the pointer to the location") && strncmp(s->given_location, "file:", 5)) return error(s, "no resources");
    s->data.state = INITIALIZATION;
    s->data.stale = 1;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    Slave *s = c;
    NEEDS(INITIALIZATION);
    if (IS("initialisation fails")) return error(s, "no initial values");
    if (IS("values set in initialization mode are lost")) s->data.real[U] = 0.8;
    if (IS("derivatives of initialization mode are lost")) s->data.input_rate = 0;
    s->data.real[TWICE] = 2 * s->data.real[GAIN];
    outputs(&s->data, s->data.real[U]);
    follow_time(&s->data);
    s->data.first_rate = s->data.real[RATE];
    s->data.state = STEPPING;
    if (unusual) {
        outputs(&s->data, s->data.real[U]);
        s->callbacks.logger(s->callbacks.componentEnvironment, s->name, fmi2Warning, CATEGORIES[1], "%s", "inexact");
    }
    if (IS("initialisation is discarded")) return discard(s, "discarded");
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c) {
    Slave *s = c;
    NEEDS(STEPPING);
    s->data.state = TERMINATED;
    if (IS("final values are lost")) s->data.real[X] = 0;
    if (IS("terminate fails")) return error(s, "no end");
    if (IS("terminate is discarded")) return discard(s, "discarded");
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c) {
    Slave *s = c;
    const double gain = s->data.real[GAIN], x = s->data.real[X], u = s->data.real[U];
    const int state = s->data.state;
    s->resets++;
    if (IS("no reset after an error") && state == FAILED) return error(s, "no reset");
    if (IS("no reset when terminated") && state == TERMINATED) return error(s, "no reset");
    if (IS("no reset in initialization mode") && state == INITIALIZATION) return error(s, "no reset");
    if (IS("reset keeps the mode")) {
        reset(&s->data);
        s->data.state = state;
        return fmi2OK;
    }
    reset(&s->data);
    s->data.resets = 1;
    s->stop_time = INFINITY;
    if (IS("reset keeps an input after the end") && state == TERMINATED) s->data.real[U] = u;
    if (IS("reset keeps parameters")) s->data.real[GAIN] = gain;
    if (IS("reset keeps the state")) s->data.real[X] = x;
    return fmi2OK;
}

/* Values */

static fmi2Status bad_reference(Slave *s) {
    if (IS("unknown references are ignored")) return fmi2OK;
    if (IS("unknown references are discarded")) return discard(s, "no such variable");
    return error(s, "no such variable");
}

enum { READABLE = INITIALIZATION | STEPPING | TERMINATED | FAILED };

/* at_first: whether it can be read in initialization mode: outputs and initial unknowns */
#define DEFINE_GET(Name, Type, count, at_first, source)                                                \
    fmi2Status fmi2Get##Name(fmi2Component c, const fmi2ValueReference vr[], size_t n, Type value[]) { \
        Slave *s = c;                                                                                  \
        Data *d = IS("instances share their values") ? &shared : &s->data;                             \
        NEEDS(READABLE);                                                                               \
        if (IS("empty calls fail") && !n) return error(s, "nothing to do");                            \
        if (reads_after_steps && s->data.is_set) return error(s, "fmi2DoStep must come first");        \
        if (IS("outputs cannot be read at first") && s->data.state == INITIALIZATION)                  \
            return error(s, "not yet");                                                                \
        refresh(s);                                                                                    \
        for (size_t i = 0; i < n; i++) {                                                               \
            if (vr[i] >= count) {                                                                      \
                const fmi2Status status = bad_reference(s);                                            \
                if (status != fmi2OK) return status;                                                   \
                continue;                                                                              \
            }                                                                                          \
            if (s->data.state == INITIALIZATION && !(at_first))                                        \
                return error(s, "cannot be read in initialization mode");                              \
            if (IS("a fixed value cannot be read") && s->data.state == STEPPING && *#Name == 'R'       \
                && vr[i] == TWICE)                                                                     \
                return error(s, "is kept to itself");                                                  \
            value[i] = source;                                                                         \
        }                                                                                              \
        if (*#Name == 'R') s->data.is_old = 0;                                                         \
        if (IS("reading is discarded") && s->data.state == TERMINATED) {                               \
            send(s, fmi2Discard, DISCARDS, "too late");                                                \
            return fmi2Discard;                                                                        \
        }                                                                                              \
        return fmi2OK;                                                                                 \
    }

static double real_of(Slave *s, const Data *d, unsigned reference, size_t place) {
    if (IS("time stands still in late steps") && reference == TIME && d->real[TIME] > 5) return 5;
    if (IS("an alias is stale where it is read first") && reference == Y && !place && s->data.is_old) return s->data.old_y;
    if (IS("values by place") && place == 1 && d->state & (STEPPING | TERMINATED)) return d->real[reference] + 1;
    if (IS("constants that are not") && reference == C && d->steps) return 4;
    if (IS("another constant") && reference == C) return 4;
    if (IS("fixed values that move") && reference == TWICE) return d->real[TWICE] + d->steps;
    if (IS("inputs that are forgotten") && reference == U && d->steps) return 0;
    if (IS("time stands still") && reference == TIME) return 0;
    if (internal_steps && reference == TIME) return 0.1 * floor(d->real[TIME] / 0.1 + 1e-6);
    (void)s;
    return d->real[reference];
}

static const char *string_of(Slave *s, const Data *d, unsigned reference) {
    if (IS("a string that is NULL") && reference == TEXT) return NULL;
    if (IS("a string that is not UTF-8") && reference == TEXT) return "\xff\xfe";
    if (IS("keeps the pointer to a string") && s->given_label) return s->given_label;
    (void)reference;
    return d->label;
}

static int is_initial_unknown(unsigned v) { return v == DER_X || v == Y || v == TWICE; }

DEFINE_GET(Real, fmi2Real, N_REALS, vr[i] == X || is_initial_unknown(vr[i]), real_of(s, d, vr[i], i))
DEFINE_GET(Integer, fmi2Integer, N_INTEGERS, vr[i] == COUNT, (IS("an item that is none") && vr[i] == MODE ? 7 : d->integer[vr[i]]))
DEFINE_GET(Boolean, fmi2Boolean, N_BOOLEANS, vr[i] == NOT_B, d->boolean[vr[i]])
DEFINE_GET(String, fmi2String, N_STRINGS, vr[i] == TEXT, string_of(s, d, vr[i]))

/* Whether a variable can be set now: before and in the initialization those with initial exact or approx, and inputs. */
static int settable(Slave *s, int before, int input, int tunable) {
    if (s->data.state == INSTANTIATED) return before && !input;
    if (s->data.state == INITIALIZATION) return before || input;
    return s->data.state == STEPPING && (input || tunable);
}

static fmi2Status not_settable(Slave *s, int constant) {
    if (IS("constants can be set") && constant) return fmi2OK;
    if (IS("a set out of time is refused in silence")) return s->data.state == STEPPING ? fmi2Error : error(s, "not now");
    if (IS("constants can be set at first") && constant && s->data.state == INSTANTIATED) return fmi2OK;
    return error(s, "cannot be set now");
}

#define DEFINE_SET(Name, Type, count, before, input, tunable, constant, store)                               \
    fmi2Status fmi2Set##Name(fmi2Component c, const fmi2ValueReference vr[], size_t n, const Type value[]) { \
        Slave *s = c;                                                                                        \
        Data *d = &s->data;                                                                                  \
        NEEDS(INSTANTIATED | INITIALIZATION | STEPPING);                                                     \
        for (size_t i = 0; i < n; i++) {                                                                     \
            const unsigned v = vr[i];                                                                        \
            if (v >= count) {                                                                                \
                const fmi2Status status = bad_reference(s);                                                  \
                if (status != fmi2OK) return status;                                                         \
                continue;                                                                                    \
            }                                                                                                \
            if (!settable(s, before, input, tunable)) {                                                      \
                const fmi2Status status = not_settable(s, constant);                                         \
                if (status != fmi2OK) return status;                                                         \
                continue;                                                                                    \
            }                                                                                                \
            store;                                                                                           \
            if (d->state == FAILED) return fmi2Error;                                                        \
        }                                                                                                    \
        if (IS("setting loses the state") && d->state == STEPPING) d->real[X] = 1;                           \
        d->is_set = d->state == STEPPING;                                                                    \
        return fmi2OK;                                                                                       \
    }

static void set_real(Slave *s, unsigned v, double value) {
    if (IS("inputs at communication points have no effect") && v == U && s->data.state == STEPPING) return;
    if (IS("tunable parameters have no effect") && v == RATE && s->data.state == STEPPING) return;
    if (IS("a parameter of 0 is refused in silence") && v == RATE && value == 0) {
        s->data.state = FAILED;
        return;
    }
    s->data.real[v] = value;
    shared.real[v] = value;
}

static void set_string(Slave *s, const char *value) {
    snprintf(s->data.label, sizeof s->data.label, "%s", value);
    s->given_label = value;
}

DEFINE_SET(Real, fmi2Real, N_REALS,
           ((v == GAIN && !(d->resets && IS("a parameter is refused after reset"))) || v == RATE || v == X || (v == Z && (unusual || d->state == INSTANTIATED) && !IS("approximations cannot be set"))), v == U,
           v == RATE && !IS("tunable parameters cannot be set"), v == C, set_real(s, v, value[i]))
DEFINE_SET(Integer, fmi2Integer, N_INTEGERS, v == MODE, v == N, 0, 0,
           (d->integer[v] = value[i], d->boolean[B] |= v == N && value[i] > 1 && IS("an input sets that of its reference")))
DEFINE_SET(Boolean, fmi2Boolean, N_BOOLEANS, 0, v == B, 0, 0, d->boolean[v] = value[i])
DEFINE_SET(String, fmi2String, N_STRINGS, v == LABEL, 0, 0, 0, set_string(s, value[i]))

/* Steps */

static void integrate(Slave *s, double h) {
    Data *d = &s->data;
    enum { PARTS = 10 };
    const double whole = IS("half a step") && h > 0.15 ? h / 2 : h;
    const double before = IS("derivatives of inputs count from the start") ? d->steps * h : 0;
    double u = d->real[U];
    if (IS("states of all instances")) d->real[X] = shared.real[X] ? shared.real[X] : d->real[X];
    for (int i = 0; i < PARTS; i++) {
        if (!IS("derivatives of inputs have no effect"))
            u = d->real[U] + (IS("derivatives of inputs backwards") ? -1 : 1) * d->input_rate * (before + (i + 0.5) * h / PARTS);
        if (IS("derivatives of inputs are of second order"))
            u = d->real[U] + d->input_rate / 2 * pow((i + 0.5) * h / PARTS, 2);
        d->real[X] += whole / PARTS * slope(d, u) * (warm && d->resets ? 1 + 3e-5 : 1);
    }
    shared.real[X] = d->real[X];
    if (!IS("derivatives of inputs have no effect")) u = d->real[U] + (IS("derivatives of inputs backwards") ? -1 : 1) * d->input_rate * (before + h);
    if (IS("derivatives of inputs are of second order")) u = d->real[U] + d->input_rate / 2 * h * h;
    d->steps++;
    d->old_y = d->real[Y];
    d->is_old = 1;
    if (IS("steps at random")) d->real[X] += 1e-3 * rand() / RAND_MAX;
    if (IS("steps follow the clock")) {
        struct timespec now;
        clock_gettime(CLOCK_REALTIME, &now);
        d->real[X] += 1e-12 * (double)now.tv_nsec;
    }
    d->input_rate = 0;
    outputs(d, u);
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no_return) {
    Slave *s = c;
    Data *d = &s->data;
    NEEDS(STEPPING);
    if (IS("waits in steps")) usleep(20000);
    if (IS("the flag of no return is refused") && no_return) return error(s, "no flag");
    if (!(h > 0) && !IS("steps of no size")) return error(s, "step size");
    const double rounding = IS("communication points may not be rounded") ? 0 : 1e-9 * fmax(1, fabs(t));
    if (fabs(t - d->real[TIME]) > rounding && !IS("the start time is ignored")) return error(s, "communication point");
    if (t + h > s->stop_time + 1e-9 * fmax(1, fabs(t)) && !IS("steps beyond the stop time")) return error(s, "stop time");
    if (one_step_size && fabs(h - 0.1) > 1e-9) return error(s, "another step size than 0.1 s");
    if (IS("a discarded step counts as successful") && d->steps >= 6) d->last_successful_time = t + h;
    if (discards_all || (discards_late && d->steps >= 6)) return discard(s, "discarded");
    if (needs_rate && d->real[RATE] < 0) abort();
    if (!d->first_step) d->first_step = h;
    d->is_set = 0;
    if (IS("one step size") && fabs(h - d->first_step) > 1e-9) return error(s, "another step size");
    if (IS("a discarded step that tells the future") && fabs(h - d->first_step) > 1e-9) {
        d->last_successful_time = t + 2 * h;
        d->state = TERMINATED;
        send(s, fmi2Discard, DISCARDS, "discarded");
        return fmi2Discard;
    }
    if (IS("a tool by the search path") && !*getenv("PATH")) return error(s, "no tool");
    if (IS("steps crash") && d->steps == 1) abort();
    if (IS("steps fail") && d->steps == 2) return error(s, "no more steps");
    if (warns || IS("warnings without a message")) {
        integrate(s, h);
        d->real[TIME] = d->last_successful_time = t + h;
        if (warns) send(s, fmi2Warning, WARNINGS, "inexact");
        return fmi2Warning;
    }
    integrate(s, h);
    if (IS("the process counts its steps") && ++all_steps > 3000) d->real[X] += 1e-4 * all_steps;
    d->real[TIME] = t + h;
    follow_time(d);
    d->last_successful_time = IS("another last successful time") ? t : t + h;
    if (IS("rounds in a step")) fesetround(FE_DOWNWARD);
    send(s, fmi2OK, EVENTS, IS("an event without number") ? "" : "step");
    if (IS("a status of its own")) return (fmi2Status)9;
    if (IS("a pending step has no status")) return fmi2Pending;
    if (asynchronous || IS("pending steps") || (IS("a late step is pending") && t > 5)) {
        d->state = PENDING;
        return fmi2Pending;
    }
    if (finishes_all && s->callbacks.stepFinished) s->callbacks.stepFinished(s->callbacks.componentEnvironment, fmi2OK);
    return fmi2OK;
}

fmi2Status fmi2CancelStep(fmi2Component c) {
    Slave *s = c;
    if (s->data.state == PENDING) {
        s->data.state = IS("a cancelled step stays") ? PENDING : FAILED;
        return fmi2OK;
    }
    if (IS("forbidden calls succeed")) return fmi2OK;
    return finishes_all ? discard(s, "no step is pending") : error(s, "no step is pending");
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) {
    Slave *s = c;
    if (kind == fmi2DoStepStatus && s->data.state == PENDING) {
        s->data.state = STEPPING;
        *value = fmi2OK;
        if (s->callbacks.stepFinished)
            s->callbacks.stepFinished(s->callbacks.componentEnvironment, fmi2OK);
        return fmi2OK;
    }
    if (IS("statuses fail")) return error(s, "no status");
    return discard(s, "no step is pending");
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    Slave *s = c;
    if (kind == fmi2LastSuccessfulTime) {
        *value = s->data.last_successful_time;
        return fmi2OK;
    }
    return discard(s, "no such status");
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value) {
    (void)kind, (void)value;
    return discard(c, "no such status");
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    if (kind == fmi2Terminated) {
        *value = IS("terminated without a reason");
        return fmi2OK;
    }
    return discard(c, "no such status");
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) {
    (void)value;
    return IS("a pending status without a string") && kind == fmi2PendingStatus ? fmi2OK : discard(c, "no such status");
}

/* Derivatives */

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[]) {
    Slave *s = c;
    NEEDS(INSTANTIATED | INITIALIZATION | STEPPING | (IS("derivatives are taken when terminated") ? TERMINATED : 0));
    if (IS("derivatives of inputs are refused at first") && s->data.state == INSTANTIATED) return error(s, "not yet");
    if (IS("derivatives of inputs are refused")) return error(s, "no derivatives");
    for (size_t i = 0; i < n; i++) {
        if (order[i] == 0 && IS("an order of 0 of inputs is taken")) continue;
        if (vr[i] != U || order[i] < 1) return error(s, "no input, or order 0");
        if (order[i] == 1) s->data.input_rate = value[i];
        if (IS("zero derivatives count")) s->data.input_rate = value[i] + 1;
    }
    return fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[]) {
    Slave *s = c;
    NEEDS(STEPPING | TERMINATED);
    if (IS("derivatives of outputs are refused")) return error(s, "no derivatives");
    if (IS("derivatives of outputs are discarded before a step") && s->data.real[TIME] == 0)
        return discard(s, "no step yet");
    for (size_t i = 0; i < n; i++) {
        if (IS("unknown references of derivatives are discarded") && vr[i] >= N_REALS) return discard(s, "unknown");
        if ((vr[i] != X && vr[i] != Y) || order[i] < 1) return error(s, "no output, or order 0");
        value[i] = order[i] == 1 ? s->data.real[DER_X] : 0;
        if (unusual && vr[i] == Y && order[i] == 1) value[i] += 6.283185307179586 * cos(62.83185307179586 * s->data.real[TIME]);
        if (IS("outputs in initialization mode are those of time 0") && vr[i] == Y && order[i] == 1) value[i] += 0.1;
        if (IS("wrong derivatives of outputs")) value[i] *= 2;
        if (IS("infinite derivatives of outputs")) value[i] = INFINITY;
    }
    return fmi2OK;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t n_unknown,
                                        const fmi2ValueReference known[], size_t n_known, const fmi2Real seed[],
                                        fmi2Real value[]) {
    Slave *s = c;
    NEEDS(INITIALIZATION | STEPPING | TERMINATED);
    for (size_t i = 0; i < n_unknown; i++) {
        if (s->data.state == INITIALIZATION && !is_initial_unknown(unknown[i])) return error(s, "no initial unknown");
        value[i] = 0;
        for (size_t k = 0; k < n_known; k++) {
            const unsigned y = unknown[i], u = known[k];
            double d = 0;
            if (y == Y && (u == U || u == X)) d = 1;
            if (y == X && u == X) d = 1;
            if (y == DER_X && u == U) d = s->data.real[RATE] * s->data.real[GAIN];
            if (y == DER_X && u == X) d = -s->data.real[RATE];
            if (y == DER_X && u == GAIN) d = s->data.real[RATE] * s->data.real[U];
            if (y == DER_X && u == RATE) d = s->data.real[GAIN] * s->data.real[U] - s->data.real[X];
            if (y == TWICE && u == GAIN) d = 2;
            if (IS("wrong directional derivatives") && y == Y) d *= 1.1;
            if (IS("derivatives without dependency") && y == X && u == U) d = 0.3;
            value[i] += IS("the seed is ignored") ? d : seed[k] * d;
        }
        if (IS("directional derivatives that are not linear")) value[i] *= fabs(value[i]) * (s->data.state == STEPPING ? 1 : 1 / fmax(fabs(value[i]), 1e-9));
    }
    return fmi2OK;
}

/* States */

static Data *new_state(void) { return calloc(1, sizeof(Data)); }

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
    Slave *s = c;
    static Data only;
    if (IS("states cannot be saved when terminated") && s->data.state == TERMINATED) return error(s, "no state");
    if (IS("states cannot be saved when instantiated") && s->data.state == INSTANTIATED) return error(s, "no state");
    if (IS("a single state")) *state = &only;
    const int is_new = !*state;
    if (is_new) *state = new_state();
    if (is_new || !IS("states are not written over")) memcpy(*state, &s->data, sizeof(Data));
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
    Slave *s = c;
    const Data old = s->data;
    if (IS("no state after an error") && old.state == FAILED) return error(s, "no state");
    if (IS("no state after the end") && old.state == TERMINATED) return error(s, "no state");
    memcpy(&s->data, state, sizeof(Data));
    if (IS("states without continuous states")) s->data.real[X] = old.real[X];
    if (IS("states without time")) s->data.real[TIME] = old.real[TIME];
    if (IS("states without inputs")) s->data.real[U] = old.real[U];
    if (IS("states without parameters")) s->data.real[RATE] = old.real[RATE];
    if (IS("states without mode")) s->data.state = old.state;
    if (IS("states up to rounding")) s->data.real[X] *= 1 + 1e-13;
    if (IS("states are lost when set")) memset(state, 0, sizeof(Data));
    if (IS("states of initialization mode without inputs") && old.state == INITIALIZATION) s->data.real[U] = old.real[U], s->data.real[GAIN] = old.real[GAIN];
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    (void)c;
    if (IS("free of a NULL state fails") && !*state) return error(c, "no state");
    if (IS("free of a NULL state is discarded") && !*state) return discard(c, "no state");
    if (IS("free of a NULL state crashes") && !*state) abort();
    if (!IS("a single state") && !IS("states leak")) free(*state);
    if (!IS("the address of a state stays")) *state = NULL;
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) {
    (void)c, (void)state;
    static size_t more;
    *size = sizeof(Data) + (IS("another size each time") ? more++ : 0);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
    (void)c;
    memcpy(bytes, state, size < sizeof(Data) ? size : sizeof(Data));
    if (IS("bytes behind the state")) bytes[size] = 0;
    if (IS("bytes without the state")) memset(bytes, 0, sizeof(double) * N_REALS);
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
    (void)c, (void)size;
    if (!*state) *state = new_state();
    memcpy(*state, bytes, sizeof(Data));
    if (IS("bytes are not read")) memset(*state, 0, sizeof(Data));
    return fmi2OK;
}
