/* The importer of session.h for FMI 3.0. Of what a call writes, `=+N` gives the number of values that it announces. */

#include "fmi3Functions.h"

#define STANDARD fmi3
#define ESCAPED "#"

#include "session.h"

DEFINE_ARRAY(booleans, fmi3Boolean, 0 != integer)
DEFINE_ARRAY(longs, fmi3Int64, (fmi3Int64)integer)
DEFINE_ANSWER(answer_booleans, fmi3Boolean)
DEFINE_ANSWER(answer_longs, fmi3Int64)

/* FMI 3.0 names no instance. */
static void logger(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category, fmi3String message) {
    printf("log %d %d %d\t%s\t\t%s\n", status, (int)((FMI(Instance) *)environment - instances), is_safe(message),
           category, message);
}

/* Inputs stay as they are, and the step is to go on. */
static void nothing_new(fmi3InstanceEnvironment environment, fmi3Float64 time, fmi3Boolean can_set, fmi3Boolean can_get,
                        fmi3Boolean is_finished, fmi3Boolean can_return, fmi3Boolean *return_early, fmi3Float64 *when) {
    (void)environment, (void)can_set, (void)can_get, (void)is_finished, (void)can_return;
    *return_early = fmi3False;
    *when = time;
}

/* SLOT NAME TOKEN CALLBACKS LOGGING */
static void instantiate(void) {
    const long slot = integer();
    const char *name = text(), *token = text(), *kind = text();
    const fmi3Boolean logging = integer() != 0, has_updates = !strcmp(kind, "updates");
    instances[slot] = fmi3InstantiateCoSimulation(name, token, NULL, fmi3False, logging, fmi3False, has_updates, NULL,
                                                  0, instances, logger, has_updates ? nothing_new : NULL);
    answer(instances[slot] ? fmi3OK : fmi3Error);
}

static void enter(void) {
    const fmi3Instance it = instance();
    const double start = real();
    const fmi3Boolean has_stop = integer() != 0;
    answer(fmi3EnterInitializationMode(it, fmi3False, 0, start, has_stop, real()));
}

static void step(void) {
    const fmi3Instance it = instance();
    const double t = real(), h = real();
    fmi3Boolean *flags = keep(3, sizeof *flags);
    double *reached = keep(1, sizeof *reached);
    memset(reached, UNTOUCHED, sizeof *reached);
    answer_reals(fmi3DoStep(it, t, h, fmi3True, flags, flags + 1, flags + 2, reached), reached, 1);
}

/* Place for the values that a call writes, NULL for `!N`. */
static void *values_of(size_t *count, size_t size) {
    const char *it = word();
    *count = strtoul(it + 1 + (*it != '!'), NULL, 0);
    if (*it == '!') return NULL;
    void *place = keep(*count, size);
    memset(place, UNTOUCHED, *count * size);
    return place;
}

#define GET(Name, answered)                                           \
    {                                                                 \
        fmi3##Name *values = values_of(&n, sizeof *values);           \
        answered(fmi3Get##Name(it, vr, count, values, n), values, n); \
    }
#define SET(Name, given)                                   \
    {                                                      \
        const fmi3##Name *values = given(&n);              \
        answer(fmi3Set##Name(it, vr, count, values, n));   \
    }

static void get(void) {
    const fmi3Instance it = instance();
    const char type = *text();
    size_t count, n;
    const fmi3ValueReference *vr = references(&count);
    if (type == 'R') GET(Float64, answer_reals)
    if (type == 'I') GET(Int32, answer_integers)
    if (type == 'B') GET(Boolean, answer_booleans)
    if (type == 'E') GET(Int64, answer_longs)
}

static void set(void) {
    const fmi3Instance it = instance();
    const char type = *text();
    size_t count, n;
    const fmi3ValueReference *vr = references(&count);
    if (type == 'R') SET(Float64, reals)
    if (type == 'I') SET(Int32, integers)
    if (type == 'B') SET(Boolean, booleans)
    if (type == 'E') SET(Int64, longs)
}

static void get_output_derivatives(void) {
    const fmi3Instance it = instance();
    size_t count, ignored, n;
    const fmi3ValueReference *vr = references(&count);
    const fmi3Int32 *order = integers(&ignored);
    double *values = values_of(&n, sizeof *values);
    answer_reals(fmi3GetOutputDerivatives(it, vr, count, order, values, n), values, n);
}

/* SLOT UNKNOWNS KNOWNS SEED OUTPUT */
static void derive(fmi3GetDirectionalDerivativeTYPE *function) {
    const fmi3Instance it = instance();
    size_t n_unknown, n_known, n_seed, n;
    const fmi3ValueReference *unknown = references(&n_unknown), *known = references(&n_known);
    const double *seed = reals(&n_seed);
    double *values = values_of(&n, sizeof *values);
    answer_reals(function(it, unknown, n_unknown, known, n_known, seed, n_seed, values, n), values, n);
}

static void directional_derivative(void) { derive(fmi3GetDirectionalDerivative); }
static void adjoint_derivative(void) { derive(fmi3GetAdjointDerivative); }

static const Command COMMANDS[] = {
    COMMON_COMMANDS,
    {"instantiate", instantiate},
    {"enter", enter},
    {"step", step},
    {"get", get},
    {"set", set},
    {"get_output_derivatives", get_output_derivatives},
    {"directional_derivative", directional_derivative},
    {"adjoint_derivative", adjoint_derivative},
    {NULL, NULL},
};

int main(void) { return serve(COMMANDS); }
