"""C of an instance with any contents, of what a call must leave, and of the importer's functions."""

LONG_MESSAGE = "for (size_t i = 0; i < size - 1; i++) text[i] = Frama_C_interval(0, 127); text[size - 1] = 0;"
PROGRAM = """
#include "__fc_builtin.h"
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#define EITHER Frama_C_interval_split(0, 1)
#define SOME(pointer) (EITHER ? (pointer) : NULL)
double any_double(void);
static int any_text(char *text, size_t size) {
    MESSAGE
    return 0;
}
/* of the C library: bodies, which are more precise than Frama-C's specifications */
static char *copied(char *to, const char *from) {
    size_t i = 0;
    do to[i] = from[i]; while (from[i++]);
    return to;
}
static size_t span(const char *text, const char *set) {
    size_t i = 0;
    while (text[i] && strchr(set, text[i])) i++;
    return i;
}
#define vsnprintf(text, size, format, arguments) any_text(text, size)
#define snprintf(text, size, ...) any_text(text, size)
#define strtod(text, end) any_double()
#define strspn span
#define strcpy copied
#include "fmiFMI.c"
Data any_data(void);
StepCache any_cache(void);
typedef struct { char bytes[SERIALIZED_SIZE + 1]; } Bytes;
Bytes any_bytes(void);
static const size_t LIMITS[] = {
    0, WORDS_PLACE - 1, WORDS_PLACE, SERIALIZED_SIZE - 1, SERIALIZED_SIZE, SERIALIZED_SIZE + 1,
};
DECLARED
static const char *const names[] = {NULL, "", "a", "b", MODEL_GUID, "logAll"};
#define NAME_OF_INSTANCE names[Frama_C_interval_split(0, 2)]
#define ANY_NAME names[Frama_C_interval(0, 5)]
static Instance *c;
static Data any_valid(void) {
    Data d = any_data();
    d.face = Frama_C_interval(CO_SIMULATION, EXCHANGE);
    d.parameters_are_stale = Frama_C_interval(0, 1);
    d.inputs_have_rates = Frama_C_interval(0, 1);
    return d;
}
static void is_valid(const Data *d) {
    //@ check api: CO_SIMULATION <= d->face <= EXCHANGE;
    //@ check api: 0 <= d->parameters_are_stale <= 1;
    //@ check api: 0 <= d->inputs_have_rates <= 1;
}
/* what calls can change */
static void any_contents(void) {
    c->data = any_valid();
    c->step_cache = any_cache();
    c->step_cache.last = Frama_C_interval(0, N_STEP_SIZES - 1);
    c->stop_time = any_double();
    c->log.enabled = Frama_C_interval(0, LOG_ALL);
}
CALLBACKS
int main(void) {
    FMI(IntermediateUpdateCallback) callback = after_step;
    void *state = NULL;
    c = malloc(sizeof *c + 2);
    if (!c) return 0;
    any_contents();
    c->log.instance = strcpy((char *)(c + 1), "a");
    c->log.environment = NULL;
    c->log.logger = LOGGER;
    c->after_step = callback;
    c->can_return_early = Frama_C_interval(0, 1);
    switch (Frama_C_interval_split(0, LAST)) {
CALLS
    }
    if (!c) return 0;
    //@ check api: \\valid(c);
    //@ check api: 0 <= c->step_cache.last < N_STEP_SIZES;
    //@ check api: c->log.instance == (char *)(c + 1);
    //@ check api: c->log.logger == \\null || \\valid_function(c->log.logger);
    //@ check api: callback == \\null || \\valid_function(callback);
    //@ check api: c->after_step == callback;
    //@ check api: state == \\null || \\valid((Snapshot *)state);
    is_valid(&c->data);
    if (state) is_valid(&((Snapshot *)state)->data);
    return 0;
}
"""
SAVED = """if (EITHER) {
            Snapshot *saved = state = malloc(sizeof *saved);
            if (!saved) return 0;
            strcpy(saved->guid, MODEL_GUID);
            saved->data = any_valid();
        }
        """
# cases that Eva takes one by one: it forgets in the loop which numbers follow from which
STEP = """c->data.inputs_have_rates = EITHER;
        c->data.parameters_are_stale = EITHER;
        if (EITHER) c->after_step = callback = NULL;
        """
CALLBACKS = {
    2: """
static void log_message(void *environment, const char *instance, fmi2Status status, const char *category,
                        const char *message, ...) {}
static void after_step(void *environment, fmi2Status status) {
    any_contents();
    if (EITHER) free(c), c = NULL;
}
static const fmi2CallbackFunctions callbacks = {log_message, calloc, free, after_step, 0};
""",
    3: """
static void log_message(void *environment, fmi3Status status, const char *category, const char *message) {}
static void after_step(void *environment, double t, bool set, bool get, bool finished, bool can_return,
                       bool *early, double *until) {
    fmi3FreeInstance(c); /* refused */
    any_contents();
    *early = Frama_C_interval(0, 1);
    *until = any_double();
}
""",
}
