/* One run of a scenario as a program: the work of initialisation.py and stepping.py around the loop, for FMUs that
   are linked to it. plan.h, which web_program.py writes, has the system and the wiring.

   Each run has a new instance of this module, so that nothing is left of the run before. The caller writes
   `setting_values`, `wiring_points` and `wiring_signal_values`, calls `run`, and reads `wiring_rows`; `message` is
   empty if the run reached its end. */

#include <stdarg.h>

#include "loop.c"

enum { REAL, INTEGER, BOOLEAN, N_TYPES };
enum { MOST_ITERATIONS = 1000 }; /* this and the next as in initialisation.py */
static const double TOLERANCE = 1e-12;

typedef void Logger(void *environment, const char *instance, int status, const char *category, const char *text, ...);
typedef struct {
    Logger *log;
    void *(*allocate)(size_t count, size_t size);
    void (*release)(void *memory);
    void (*finished)(void *environment, int status);
    void *environment;
} Callbacks;

typedef void *Instantiate(const char *name, int kind, const char *guid, const char *resources,
                          const Callbacks *callbacks, int visible, int logging_on);
typedef int SetUp(void *instance, int has_tolerance, double tolerance, double start, int has_stop, double stop);
typedef int Change(void *instance);

typedef struct {
    const char *name, *guid;
    Instantiate *instantiate;
    SetUp *set_up;
    Change *enter_initialization, *exit_initialization;
    ExchangeValues *get[N_TYPES], *set[N_TYPES];
} Component;

/* The functions of an FMU that plan.h names (FMI 2.0.5, 2.1.1: with the prefix of its model identifier). */
#define DECLARE_FMU(prefix)                                                                                      \
    Instantiate prefix##_fmi2Instantiate;                                                                        \
    SetUp prefix##_fmi2SetupExperiment;                                                                          \
    Change prefix##_fmi2EnterInitializationMode, prefix##_fmi2ExitInitializationMode;                            \
    ExchangeValues prefix##_fmi2GetReal, prefix##_fmi2GetInteger, prefix##_fmi2GetBoolean;                       \
    ExchangeValues prefix##_fmi2SetReal, prefix##_fmi2SetInteger, prefix##_fmi2SetBoolean;                       \
    SetDerivatives prefix##_fmi2SetRealInputDerivatives;                                                         \
    DoStep prefix##_fmi2DoStep;                                                                                  \
    GetStatus prefix##_fmi2GetRealStatus, prefix##_fmi2GetBooleanStatus;
#define COMPONENT(name, prefix, guid)                                                                            \
    {name, guid, prefix##_fmi2Instantiate, prefix##_fmi2SetupExperiment, prefix##_fmi2EnterInitializationMode,   \
     prefix##_fmi2ExitInitializationMode,                                                                        \
     {prefix##_fmi2GetReal, prefix##_fmi2GetInteger, prefix##_fmi2GetBoolean},                                   \
     {prefix##_fmi2SetReal, prefix##_fmi2SetInteger, prefix##_fmi2SetBoolean}}

typedef struct {
    int component, type;
    uint32_t reference;
} Port;

/* Of the initial values; connections of one group follow each other. */
typedef struct {
    int group, is_loop;
    Port source, target;
    double factor, offset, nominal;
} InitialConnection;

/* A value that an event sets; bus_index: of a recorded value, or -1. */
typedef struct {
    int64_t point, bus_index;
    Port port;
    double value;
} Event;

#include "plan.h"

char message[1024];

/* The first message stays. */
static int fail(const char *text, int64_t component, double time) {
    const size_t length = strlen(message);
    if (component >= 0)
        snprintf(message + length, sizeof message - length, "%s%s: %s at t = %.9g s", length ? "; " : "",
                 COMPONENTS[component].name, text, time);
    else
        snprintf(message + length, sizeof message - length, "%s%s at t = %.9g s", length ? "; " : "", text, time);
    return 0;
}

static void log_message(void *environment, const char *instance, int status, const char *category, const char *text,
                        ...) {
    va_list arguments;
    (void)instance, (void)category;
    if (status < DISCARD) return;
    if (status > DISCARD) *(int64_t *)environment = 1;
    va_start(arguments, text);
    vsnprintf(message, sizeof message, text, arguments);
    va_end(arguments);
}

static int set(Port port, double value) {
    const Component *component = COMPONENTS + port.component;
    int32_t whole = port.type == REAL ? 0 : (int32_t)value;
    const int status = component->set[port.type]((void *)wiring_instances[port.component], &port.reference, 1,
                                                 port.type == REAL ? (void *)&value : (void *)&whole);
    if (status <= WARNING && !wiring_error_logged[port.component]) return 1;
    return fail("a value is refused", port.component, wiring_step_start[port.component]);
}

static int get(Port port, double *value) {
    const Component *component = COMPONENTS + port.component;
    int32_t whole;
    const int status = component->get[port.type]((void *)wiring_instances[port.component], &port.reference, 1,
                                                 port.type == REAL ? (void *)value : (void *)&whole);
    if (port.type != REAL) *value = whole;
    if (status <= WARNING && !wiring_error_logged[port.component]) return 1;
    return fail("a value cannot be read", port.component, wiring_step_start[port.component]);
}

static int set_settings(int are_inputs) {
    for (int i = 0; i < N_SETTINGS; i++)
        if (SETTING_IS_INPUT[i] == are_inputs && !set(SETTINGS[i], setting_values[i])) return 0;
    return 1;
}

static int solve_initial_values(void) {
    static double before[N_INITIAL_CONNECTIONS + 1];
    for (int i = 0; i < N_INITIAL_CONNECTIONS; i++) before[i] = INFINITY;
    for (int first = 0, last = 0; first < N_INITIAL_CONNECTIONS; first = last) {
        double change = INFINITY;
        for (int iteration = 0; change > TOLERANCE; iteration++) {
            if (iteration == MOST_ITERATIONS) return fail("initial values: a loop has no fixed point", -1, START_TIME);
            change = 0;
            for (last = first; last < N_INITIAL_CONNECTIONS; last++) {
                const InitialConnection *c = INITIAL_CONNECTIONS + last;
                double value;
                if (c->group != INITIAL_CONNECTIONS[first].group) break;
                if (!get(c->source, &value)) return 0;
                value = c->factor * value + c->offset;
                if (!isfinite(value)) return fail("an initial value is not finite", c->source.component, START_TIME);
                if (!set(c->target, value)) return 0;
                if (c->is_loop) change = fmax(change, fabs(value - before[last]) / fmax(fabs(value), c->nominal));
                before[last] = value;
            }
        }
    }
    return 1;
}

static int initialise(void) {
    static Callbacks callbacks[N_COMPONENTS];
    for (int c = 0; c < N_COMPONENTS; c++) {
        callbacks[c] = (Callbacks){log_message, calloc, free, NULL, wiring_error_logged + c};
        wiring_instances[c] = (intptr_t)COMPONENTS[c].instantiate(COMPONENTS[c].name, 1, COMPONENTS[c].guid, "file:///",
                                                             callbacks + c, 0, 1);
        if (!wiring_instances[c]) return fail("no instance", c, START_TIME);
    }
    if (!set_settings(0)) return 0;
    for (int c = 0; c < N_COMPONENTS; c++) {
        void *instance = (void *)wiring_instances[c];
        if (COMPONENTS[c].set_up(instance, FMU_TOLERANCE > 0, FMU_TOLERANCE, START_TIME, 1, STOP_TIME) > WARNING ||
            COMPONENTS[c].enter_initialization(instance) > WARNING)
            return fail("initialization is refused", c, START_TIME);
    }
    if (!set_settings(1) || !solve_initial_values()) return 0;
    for (int c = 0; c < N_COMPONENTS; c++)
        if (COMPONENTS[c].exit_initialization((void *)wiring_instances[c]) > WARNING)
            return fail("initialization is refused", c, START_TIME);
    for (int c = 0; c < N_COMPONENTS; c++)
        if (!loop_read_outputs(&wiring, c)) return fail("outputs cannot be read", c, START_TIME);
    return 1;
}

/* Makes the changes of a communication point; returns the point up to which there are no others, 0 if one failed. */
static int64_t make_changes(int64_t point) {
    for (int i = 0; i < N_EVENTS; i++) {
        if (EVENTS[i].point > point) return EVENTS[i].point;
        if (EVENTS[i].point < point) continue;
        if (!set(EVENTS[i].port, EVENTS[i].value)) return 0;
        if (EVENTS[i].bus_index >= 0) wiring_bus[EVENTS[i].bus_index] = EVENTS[i].value;
    }
    return wiring.n_points - 1;
}

/* Makes one run; returns how many rows were recorded. */
__attribute__((export_name("run"))) int run(void) {
    static const char *const FAILURES[] = {"", "an input is refused", "an input derivative is refused",
                                           "the step is refused", "outputs cannot be read", "", "",
                                           "a value that is exchanged is not finite"};
    int64_t *report = wiring.report, point = 0;
    if (!initialise()) return 0;
    while (point < wiring.n_points - 1 && !report[TERMINATED]) {
        const int64_t end = make_changes(point);
        if (end <= point) return (int)report[RECORDED];
        point = loop_run(&wiring, point, end);
        if (report[FAILURE]) break;
    }
    if (!report[FAILURE]) {
        if (!report[TERMINATED] && !make_changes(point)) return (int)report[RECORDED];
        loop_exchange_and_record(&wiring, point);
    }
    if (report[FAILURE])
        fail(FAILURES[report[FAILURE]], report[COMPONENT], wiring.points[point]);
    else
        message[0] = '\0'; /* an FMU may have logged a message without a failure */
    return (int)report[RECORDED];
}
