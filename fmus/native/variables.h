/* Which variables the model has, and which values they accept. */

#ifndef VARIABLES_H
#define VARIABLES_H

#include <math.h>
#include <stdint.h>

/* Types of a variable, as the importer's functions distinguish them. */
typedef enum { REAL, INTEGER, BOOLEAN, ENUMERATION } Type; /* FMI 2.0 has enumerations as integers */

/* States of FMI 2.0.5, one bit each: of co-simulation (figure 11), in which a step is never in progress when the
 * importer calls, and of model exchange (figure 5), which has two in place of STEPPING. Of FMI 3.0.2 (4.2.2), in the
 * callback of a step, the intermediate update mode: in two halves, which allow no call in common, and after an error,
 * where none is allowed. */
typedef enum {
    INSTANTIATED = 1,
    INITIALIZATION = 2,
    STEPPING = 4,
    TERMINATED = 8,
    IN_ERROR = 16,
    EVENT = 32,
    CONTINUOUS_TIME = 64,
    UPDATE_OF_INPUTS = 128,
    UPDATE_OF_OUTPUTS = 256,
    UPDATE_IN_ERROR = 512
} Mode;

/* The modes in which a variable can be set: calculated ones never, fixed parameters until stepping begins, tunable
 * parameters and discrete inputs not in continuous-time mode, nor inside a step. */
enum {
    NEVER = 0,
    BEFORE_STEPPING = INSTANTIATED | INITIALIZATION,
    AT_POINTS = BEFORE_STEPPING | STEPPING | EVENT,
    ALWAYS = AT_POINTS | CONTINUOUS_TIME | UPDATE_OF_INPUTS
};

typedef struct {
    const char *name;
    double start, min, max;
    uint32_t items;       /* of an enumeration: bit i stands for the item i; else 0 */
    int whole;            /* a Real that takes whole numbers alone, in an FMU of Reals only */
    const char *expected; /* of a value, in words */
} Variable;

/* Attributes that each call reads of each variable: a small separate table stays in the processor's cache. */
typedef struct {
    unsigned type : 8, settable : 8; /* NEVER, BEFORE_STEPPING, AT_POINTS or ALWAYS */
    unsigned is_continuous : 16;     /* by its variability: other variables change at events alone (2.2.7) */
} Access;

#include "model.h"

/* Value references: parameters, calculated parameters, inputs, outputs; then, without a value of their own, continuous
 * states and their derivatives. */
enum {
    FIRST_CALCULATED = N_PARAMETERS,
    FIRST_INPUT = FIRST_CALCULATED + N_CALCULATED,
    FIRST_OUTPUT = FIRST_INPUT + N_INPUTS,
    N_VALUES = FIRST_OUTPUT + N_OUTPUTS,
    FIRST_DERIVATIVE = N_VALUES + N_CONTINUOUS,
    TIME = FIRST_DERIVATIVE + N_CONTINUOUS, /* then event indicators */
    N_VARIABLES = TIME + N_OTHERS, /* and first row of the states in VARIABLES */
    N_SEEDS = TIME + 1 + N_STATES /* of derivatives: of the variables, the time, and states that are no variables */
};

/* Read from memory: of a model without states, a compiler would call the comparison below always false. */
static const unsigned STATES_FROM_TO[] = {N_VALUES, FIRST_DERIVATIVE};

static int is_state(unsigned reference) { return reference >= STATES_FROM_TO[0] && reference < STATES_FROM_TO[1]; }

static int is_settable(int reference) { return ACCESS[reference].settable != NEVER; }

/* Whether a value is in the range, which for whole numbers is one of int. False for values that are not finite: a
 * variable without a range has the range of double. */
static int is_acceptable(int reference, double value) {
    const Variable *v = VARIABLES + reference;
    if (!(value >= v->min && value <= v->max) || (v->whole && value != floor(value))) return 0;
    return !v->items || v->items >> (int)value & 1;
}

/* An item of the enumeration, 0 or 1 of a Boolean; true for a variable of another type. */
static int is_item(int reference, double value) {
    const uint32_t items = ACCESS[reference].type == BOOLEAN ? 3 : VARIABLES[reference].items;
    return !items || (value >= 0 && value < 32 && value == (int)value && items >> (int)value & 1);
}

#endif
