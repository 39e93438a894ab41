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
 * session_fmi2.c and session_fmi3.c define the names of a standard and include this file; they have the commands that
 * differ and the tables of all.
 */

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define PASTED(prefix, name) prefix##name
#define JOINED(prefix, name) PASTED(prefix, name)
#define FMI(name) JOINED(STANDARD, name)

enum { SLOTS = 16, LONGEST = 1 << 20, MOST_KEPT = 16, UNTOUCHED = 77 };

static FMI(Instance) instances[SLOTS];
static FMI(FMUState) states[SLOTS];
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

/* In the message # begins a reference to a variable; in FMI 2.0 it is a printf format without arguments, too. */
static int is_safe(const char *format) {
    for (; *format; format++) {
        if (!strchr(ESCAPED, *format)) continue;
        if (format[1] != *format) return 0;
        format++;
    }
    return 1;
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

DEFINE_ARRAY(references, FMI(ValueReference), (FMI(ValueReference))integer)
DEFINE_ARRAY(reals, double, real)
DEFINE_ARRAY(integers, int, (int)integer)
DEFINE_ARRAY(texts, FMI(String), text)
DEFINE_ARRAY(bytes, FMI(Byte), (FMI(Byte))integer)

static FMI(Instance) instance(void) {
    const long slot = integer();
    return slot < 0 ? NULL : instances[slot];
}

/* NULL for `-`, otherwise the place of a saved state. */
static FMI(FMUState) *state_place(void) {
    const char *slot = word();
    return *slot == '-' ? NULL : states + atoi(slot);
}

static FMI(FMUState) state(void) { return states[integer()]; }

static void answer(int status) { printf("= %d", status); }

#define DEFINE_ANSWER(Name, CType)                                   \
    static void Name(int status, const CType *values, size_t count) { \
        answer(status);                                              \
        for (size_t i = 0; values && i < count; i++) {               \
            unsigned char untouched[sizeof *values];                 \
            memset(untouched, UNTOUCHED, sizeof untouched);          \
            if (memcmp(untouched, values + i, sizeof untouched))     \
                printf(" %a", (double)values[i]);                    \
            else                                                     \
                printf(" untouched");                                \
        }                                                            \
    }

DEFINE_ANSWER(answer_reals, double)
DEFINE_ANSWER(answer_integers, int)

/* Commands */

typedef struct {
    const char *name;
    void (*run)(void);
} Command;

static void free_instance(void) {
    const long slot = integer();
    FMI(FreeInstance)(slot < 0 ? NULL : instances[slot]);
    if (slot >= 0) instances[slot] = NULL;
    answer(FMI(OK));
}

static void set_debug_logging(void) {
    const FMI(Instance) it = instance();
    const FMI(Boolean) on = (FMI(Boolean))integer();
    size_t count;
    const FMI(String) *categories = texts(&count);
    answer(FMI(SetDebugLogging)(it, on, count, categories));
}

static void leave(void) { answer(FMI(ExitInitializationMode)(instance())); }
static void terminate(void) { answer(FMI(Terminate)(instance())); }
static void reset(void) { answer(FMI(Reset)(instance())); }

static void get_state(void) {
    const FMI(Instance) it = instance();
    answer(FMI(GetFMUState)(it, state_place()));
}

static void set_state(void) {
    const FMI(Instance) it = instance();
    answer(FMI(SetFMUState)(it, state()));
}

static void free_state(void) {
    const FMI(Instance) it = instance();
    answer(FMI(FreeFMUState)(it, state_place()));
}

static void state_size(void) {
    const FMI(Instance) it = instance();
    const FMI(FMUState) saved = state();
    size_t *size = output(1, sizeof *size);
    const FMI(Status) status = FMI(SerializedFMUStateSize)(it, saved, size);
    answer(status);
    if (status == FMI(OK)) printf(" %lu", (unsigned long)*size);
}

/* SLOT STATE SIZE OUTPUT */
static void serialize_state(void) {
    const FMI(Instance) it = instance();
    const FMI(FMUState) saved = state();
    const size_t size = (size_t)integer();
    FMI(Byte) *place = output(size, 1);
    const FMI(Status) status = FMI(SerializeFMUState)(it, saved, place, size);
    answer(status);
    for (size_t i = 0; status == FMI(OK) && i < size; i++) printf(" %d", (unsigned char)place[i]);
}

static void deserialize_state(void) {
    const FMI(Instance) it = instance();
    size_t size;
    const FMI(Byte) *serialized = bytes(&size);
    answer(FMI(DeserializeFMUState)(it, serialized, size, state_place()));
}

/* 0 or 1: whether the FMU gets memory from now on. */
static void memory(void) {
    out_of_memory = !integer();
    answer(FMI(OK));
}

static void live_blocks(void) {
    answer(FMI(OK));
    printf(" %ld", live);
}

/* Those that both standards have alike. */
#define COMMON_COMMANDS                                                                            \
    {"free", free_instance}, {"set_debug_logging", set_debug_logging}, {"leave", leave},           \
        {"terminate", terminate}, {"reset", reset}, {"get_state", get_state}, {"set_state", set_state}, \
        {"free_state", free_state}, {"state_size", state_size}, {"serialize", serialize_state},    \
        {"deserialize", deserialize_state}, {"memory", memory}, {"live", live_blocks}

/* Carries out the commands on stdin; the last of the table has no name. */
static int serve(const Command commands[]) {
    static char line[LONGEST];
    while (fgets(line, sizeof line, stdin)) {
        const char *name = strtok(line, " \n");
        const Command *it = commands;
        while (it->name && strcmp(name, it->name)) it++;
        if (!it->name) return 3;
        it->run();
        putchar('\n');
        fflush(stdout);
        while (n_kept) free(kept[--n_kept]);
    }
    return 0;
}
