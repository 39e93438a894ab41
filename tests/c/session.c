/* An importer that does what it is told: one FMI call a line on stdin, its answer on stdout.
 *
 *   NAME ARGUMENT...      for example `get 0 =R 2 4 5 +`
 *
 * Arguments: an integer; a real, also nan, inf and hexadecimal; `=text`, or `-` for NULL; an array as its size
 * and items, or `!size` for a NULL of that size; where the call writes, `+`, or `!` for NULL. Instances and
 * saved states are numbered; those that do not exist are NULL. Bytes are an array of integers.
 *
 * Answer: a line for each message of the FMU, `log STATUS ENVIRONMENT SAFE`, tab, category, tab, instance,
 * tab, message; then `= STATUS VALUE...`, of which nothing is written by a call that refuses stays UNTOUCHED.
 * Linked with the FMU under sanitizers: what the FMU must not touch is allocated exactly, block by block.
 */

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

enum { SLOTS = 16, LONGEST = 1 << 20, MOST_KEPT = 16, UNTOUCHED = 77 };

static fmi2Component instances[SLOTS];
static fmi2FMUstate states[SLOTS];
static fmi2CallbackFunctions callbacks[SLOTS];
static long live;        /* blocks of the FMU */
static int out_of_memory; /* the next allocations fail */

/* What the FMU calls for calloc and free: it does not use the importer's callbacks. */
void *counted_calloc(size_t count, size_t size) {
    if (out_of_memory) return NULL;
    live++;
    return calloc(count, size);
}

void counted_free(void *block) {
    if (block) live--;
    free(block);
}

static void *refused(size_t count, size_t size) {
    (void)count, (void)size;
    abort();
}

static void released(void *block) {
    (void)block;
    abort();
}

static void step_finished(fmi2ComponentEnvironment environment, fmi2Status status) {
    printf("log %d %d 1\tstepFinished\t\t\n", status, (int)(callbacks - (fmi2CallbackFunctions *)environment));
}

/* The message is a printf format without arguments, in which # begins a reference to a variable. */
static int is_safe(const char *format) {
    for (; *format; format++) {
        if (*format != '%' && *format != '#') continue;
        if (format[1] != *format) return 0;
        format++;
    }
    return 1;
}

static void render(char *text, size_t size, const char *format, ...) {
    va_list none;
    va_start(none, format);
    vsnprintf(text, size, format, none);
    va_end(none);
}

static void logger(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status, fmi2String category,
                   fmi2String message, ...) {
    char text[8192];
    const int safe = is_safe(message);
    if (safe)
        render(text, sizeof text, message);
    else
        snprintf(text, sizeof text, "%s", message);
    printf("log %d %d %d\t%s\t%s\t%s\n", status, (int)(callbacks - (fmi2CallbackFunctions *)environment), safe, category,
           instance, text);
}

/* Arguments. What they need lives until the command has been answered. */

static void *kept[MOST_KEPT];
static int n_kept;

static void *keep(size_t count, size_t size) {
    if (n_kept == MOST_KEPT) exit(3);
    return kept[n_kept++] = malloc(count * size);
}

static char *word(void) {
    char *it = strtok(NULL, " \n");
    if (!it) exit(3);
    return it;
}

static long integer(void) { return strtol(word(), NULL, 0); }

static double real(void) { return strtod(word(), NULL); }

static const char *text(void) {
    const char *it = word();
    return *it == '=' ? it + 1 : NULL;
}

static void *output(size_t count, size_t size) {
    void *it = *word() == '!' ? NULL : keep(count, size);
    if (it) memset(it, UNTOUCHED, count * size);
    return it;
}

#define DEFINE_ARRAY(Name, CType, read)                      \
    static CType *Name(size_t *count) {                      \
        const char *size = word();                           \
        CType *it;                                           \
        *count = strtoul(size + (*size == '!'), NULL, 0);    \
        if (*size == '!') return NULL;                       \
        it = keep(*count, sizeof *it);                       \
        for (size_t i = 0; i < *count; i++) it[i] = read(); \
        return it;                                           \
    }

DEFINE_ARRAY(references, fmi2ValueReference, (fmi2ValueReference)integer)
DEFINE_ARRAY(reals, fmi2Real, real)
DEFINE_ARRAY(integers, fmi2Integer, (fmi2Integer)integer)
DEFINE_ARRAY(texts, fmi2String, text)
DEFINE_ARRAY(bytes, fmi2Byte, (fmi2Byte)integer)

static fmi2Component instance(void) {
    const long slot = integer();
    return slot < 0 ? NULL : instances[slot];
}

/* NULL for `-`, otherwise the place of a saved state. */
static fmi2FMUstate *state_place(void) {
    const char *slot = word();
    return *slot == '-' ? NULL : states + atoi(slot);
}

static fmi2FMUstate state(void) { return states[integer()]; }

static void answer(int status) { printf("= %d", status); }

static void answer_reals(int status, const fmi2Real *values, size_t count) {
    answer(status);
    for (size_t i = 0; values && i < count; i++) {
        unsigned char untouched[sizeof *values];
        memset(untouched, UNTOUCHED, sizeof untouched);
        if (memcmp(untouched, values + i, sizeof untouched))
            printf(" %a", values[i]);
        else
            printf(" untouched");
    }
}

static void answer_integers(int status, const fmi2Integer *values, size_t count) {
    const int untouched = UNTOUCHED * 0x01010101;
    answer(status);
    for (size_t i = 0; values && i < count; i++) {
        if (values[i] == untouched)
            printf(" untouched");
        else
            printf(" %a", (double)values[i]);
    }
}

/* Commands */

/* SLOT NAME TYPE GUID CALLBACKS LOGGING; a slot that is taken is not used again: the new instance is freed. */
static void instantiate(void) {
    const long slot = integer();
    const char *name = text();
    const fmi2Type type = (fmi2Type)integer();
    const char *guid = text(), *kind = text();
    const fmi2Boolean logging = (fmi2Boolean)integer();
    fmi2CallbackFunctions given = {logger, refused, released, NULL, callbacks};
    if (!strcmp(kind, "no_logger")) given.logger = NULL;
    if (!strcmp(kind, "no_memory")) given.allocateMemory = NULL, given.freeMemory = NULL;
    if (!strcmp(kind, "step_finished")) given.stepFinished = step_finished;
    out_of_memory = !strcmp(kind, "out_of_memory");
    instances[slot] = fmi2Instantiate(name, type, guid, NULL, strcmp(kind, "none") ? &given : NULL, fmi2False, logging);
    memset(&given, 0xff, sizeof given); /* the FMU may not rely on the structure after the call */
    out_of_memory = 0;
    answer(instances[slot] ? fmi2OK : fmi2Error);
}

static void free_instance(void) {
    const long slot = integer();
    fmi2FreeInstance(slot < 0 ? NULL : instances[slot]);
    if (slot >= 0) instances[slot] = NULL;
    answer(fmi2OK);
}

static void set_debug_logging(void) {
    const fmi2Component it = instance();
    const fmi2Boolean on = (fmi2Boolean)integer();
    size_t count;
    const fmi2String *categories = texts(&count);
    answer(fmi2SetDebugLogging(it, on, count, categories));
}

static void setup(void) {
    const fmi2Component it = instance();
    const fmi2Real start = real();
    const fmi2Boolean has_stop = (fmi2Boolean)integer();
    answer(fmi2SetupExperiment(it, fmi2False, 0, start, has_stop, real()));
}

static void enter(void) { answer(fmi2EnterInitializationMode(instance())); }
static void leave(void) { answer(fmi2ExitInitializationMode(instance())); }
static void terminate(void) { answer(fmi2Terminate(instance())); }
static void reset(void) { answer(fmi2Reset(instance())); }
static void cancel(void) { answer(fmi2CancelStep(instance())); }

static void step(void) {
    const fmi2Component it = instance();
    const fmi2Real t = real();
    answer(fmi2DoStep(it, t, real(), fmi2True));
}

static void get(void) {
    const fmi2Component it = instance();
    const char type = *text();
    size_t count;
    const fmi2ValueReference *vr = references(&count);
    if (type == 'R') {
        fmi2Real *values = output(count, sizeof *values);
        answer_reals(fmi2GetReal(it, vr, count, values), values, count);
    } else if (type == 'S') {
        fmi2String *values = output(count, sizeof *values);
        answer(fmi2GetString(it, vr, count, values));
    } else {
        fmi2Integer *values = output(count, sizeof *values);
        answer_integers((type == 'I' ? fmi2GetInteger : fmi2GetBoolean)(it, vr, count, values), values, count);
    }
}

static void set(void) {
    const fmi2Component it = instance();
    const char type = *text();
    size_t count, ignored;
    const fmi2ValueReference *vr = references(&count);
    if (type == 'R')
        answer(fmi2SetReal(it, vr, count, reals(&ignored)));
    else if (type == 'S')
        answer(fmi2SetString(it, vr, count, texts(&ignored)));
    else
        answer((type == 'I' ? fmi2SetInteger : fmi2SetBoolean)(it, vr, count, integers(&ignored)));
}

static void set_input_derivatives(void) {
    const fmi2Component it = instance();
    size_t count, ignored;
    const fmi2ValueReference *vr = references(&count);
    const fmi2Integer *order = integers(&ignored);
    answer(fmi2SetRealInputDerivatives(it, vr, count, order, reals(&ignored)));
}

static void get_output_derivatives(void) {
    const fmi2Component it = instance();
    size_t count, ignored;
    const fmi2ValueReference *vr = references(&count);
    const fmi2Integer *order = integers(&ignored);
    fmi2Real *values = output(count, sizeof *values);
    answer_reals(fmi2GetRealOutputDerivatives(it, vr, count, order, values), values, count);
}

static void directional_derivative(void) {
    const fmi2Component it = instance();
    size_t n_unknown, n_known, ignored;
    const fmi2ValueReference *unknown = references(&n_unknown), *known = references(&n_known);
    const fmi2Real *seed = reals(&ignored);
    fmi2Real *values = output(n_unknown, sizeof *values);
    answer_reals(fmi2GetDirectionalDerivative(it, unknown, n_unknown, known, n_known, seed, values), values, n_unknown);
}

/* SLOT KIND_OF_VALUE KIND_OF_STATUS OUTPUT */
static void get_status(void) {
    const fmi2Component it = instance();
    const char type = *text();
    const fmi2StatusKind kind = (fmi2StatusKind)integer();
    void *value = output(1, sizeof(fmi2Real));
    if (type == 'R') answer_reals(fmi2GetRealStatus(it, kind, value), value, 1);
    if (type == 'B') answer_integers(fmi2GetBooleanStatus(it, kind, value), value, 1);
    if (type == 'I') answer_integers(fmi2GetIntegerStatus(it, kind, value), value, 1);
    if (type == 'N') answer_integers(fmi2GetStatus(it, kind, value), value, 1);
    if (type == 'S') answer(fmi2GetStringStatus(it, kind, value));
}

static void get_state(void) {
    const fmi2Component it = instance();
    answer(fmi2GetFMUstate(it, state_place()));
}

static void set_state(void) {
    const fmi2Component it = instance();
    answer(fmi2SetFMUstate(it, state()));
}

static void free_state(void) {
    const fmi2Component it = instance();
    answer(fmi2FreeFMUstate(it, state_place()));
}

static void state_size(void) {
    const fmi2Component it = instance();
    const fmi2FMUstate saved = state();
    size_t *size = output(1, sizeof *size);
    const fmi2Status status = fmi2SerializedFMUstateSize(it, saved, size);
    answer(status);
    if (status == fmi2OK) printf(" %lu", (unsigned long)*size);
}

/* SLOT STATE SIZE OUTPUT */
static void serialize_state(void) {
    const fmi2Component it = instance();
    const fmi2FMUstate saved = state();
    const size_t size = (size_t)integer();
    fmi2Byte *place = output(size, 1);
    const fmi2Status status = fmi2SerializeFMUstate(it, saved, place, size);
    answer(status);
    for (size_t i = 0; status == fmi2OK && i < size; i++) printf(" %d", (unsigned char)place[i]);
}

static void deserialize_state(void) {
    const fmi2Component it = instance();
    size_t size;
    const fmi2Byte *serialized = bytes(&size);
    answer(fmi2DeSerializeFMUstate(it, serialized, size, state_place()));
}

/* 0 or 1: whether the FMU gets memory from now on. */
static void memory(void) {
    out_of_memory = !integer();
    answer(fmi2OK);
}

static void live_blocks(void) {
    answer(fmi2OK);
    printf(" %ld", live);
}

static void inquire(void) {
    answer(fmi2OK);
    printf(" %s %s", fmi2GetTypesPlatform(), fmi2GetVersion());
}

static const struct {
    const char *name;
    void (*run)(void);
} COMMANDS[] = {
    {"instantiate", instantiate},
    {"free", free_instance},
    {"set_debug_logging", set_debug_logging},
    {"setup", setup},
    {"enter", enter},
    {"leave", leave},
    {"terminate", terminate},
    {"reset", reset},
    {"cancel", cancel},
    {"step", step},
    {"get", get},
    {"set", set},
    {"set_input_derivatives", set_input_derivatives},
    {"get_output_derivatives", get_output_derivatives},
    {"directional_derivative", directional_derivative},
    {"get_status", get_status},
    {"get_state", get_state},
    {"set_state", set_state},
    {"free_state", free_state},
    {"state_size", state_size},
    {"serialize", serialize_state},
    {"deserialize", deserialize_state},
    {"memory", memory},
    {"live", live_blocks},
    {"inquire", inquire},
};

int main(void) {
    static char line[LONGEST];
    while (fgets(line, sizeof line, stdin)) {
        const char *name = strtok(line, " \n");
        size_t i = 0;
        while (i < sizeof COMMANDS / sizeof *COMMANDS && strcmp(name, COMMANDS[i].name)) i++;
        if (i == sizeof COMMANDS / sizeof *COMMANDS) return 3;
        COMMANDS[i].run();
        putchar('\n');
        fflush(stdout);
        while (n_kept) free(kept[--n_kept]);
    }
    return 0;
}
