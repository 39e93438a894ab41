/* Functions of FMI that read and set values (2.1.7). */

#ifndef VALUES_H
#define VALUES_H

#include "refusals.h"

/* 4.2.4: what can be inquired; after an error for debugging only. */
enum {
    HAS_STEPPED = STEPPING | EVENT | CONTINUOUS_TIME | TERMINATED | IN_ERROR,
    IS_INITIALIZED = INITIALIZATION | HAS_STEPPED,
    READABLE = INSTANTIATED | IS_INITIALIZED
};

static int has_type(unsigned reference, Type type) {
    return reference < N_VARIABLES && ACCESS[reference].type == type;
}

static OUTLINED Status not_of_type(Instance *instance, Type type, unsigned reference, const char *function) {
    if (reference >= N_VARIABLES)
        return refuse(instance, ERROR, "%s: value reference %u: expected 0..%d of " MODEL_NAME, function, reference,
                      N_VARIABLES - 1);
    return refuse(instance, ERROR, "%s: %s is %s: expected %s", function, VARIABLES[reference].name,
                  TYPE_TEXTS[ACCESS[reference].type], TYPE_TEXTS[type]);
}

static int are_given(Instance *instance, const FMI(ValueReference) references[], size_t count, const void *values,
                     const char *function) {
    if (!count || (references && values)) return 1;
    missing(instance, function, references ? "value" : "vr");
    return 0;
}

static int are_of_type(Instance *instance, Type type, const FMI(ValueReference) references[], size_t count,
                       const char *function) {
    for (size_t i = 0; i < count; i++) {
        if (has_type(references[i], type)) continue;
        not_of_type(instance, type, references[i], function);
        return 0;
    }
    return 1;
}

/* 2.1.7: until stepping begins, calculated values follow the values that are set, also after an error; later the last
 * step gives them, and nothing is stale (4.2.4: no fmi2GetXXX after fmi2SetXXX without a step). Called when something
 * is stale. */
static Status refreshed(Instance *instance, Type type, const FMI(ValueReference) references[], size_t count,
                            const char *function) {
    int broken = 0;
    if (!are_of_type(instance, type, references, count, function)) return ERROR;
    for (size_t i = 0; i < count; i++)
        if (!is_settable((int)references[i]))
            return report(instance, data_refresh(&instance->data, &broken), &broken, function, 0, DISCARD);
    return OK;
}

/* A present value can be set again. Continuous states can be set in the solver's mode, as FMI 3.0.2 allows (3.2.1) and
 * importers of FMI 2.0 do too. */
static int can_be_set(const Data *d, unsigned reference, Type type, double value) {
    if (!has_type(reference, type)) return 0;
    if (d->mode & ACCESS[reference].settable)
        return is_same(d->value[reference], value) || is_acceptable((int)reference, value);
    return is_state(reference) && d->mode == CONTINUOUS_TIME && isfinite(value);
}

/* Refuses the first wrong type, or else the value at `index`, which is the first refused value.
 * 2.1.2: a value reference that cannot be set is an error; 2.1.7: a value out of range may be discarded. Of a start
 * value it is an error, because errors reach the user without logging; inputs in initialization mode are tried. */
static OUTLINED Status cannot_be_set(Instance *instance, Type type, const FMI(ValueReference) references[],
                                     size_t count, size_t index, double value, const char *function) {
    if (!are_of_type(instance, type, references, count, function)) return ERROR;
    const Variable *v = VARIABLES + references[index];
    if (is_state(references[index]) && instance->data.mode == CONTINUOUS_TIME)
        return refuse(instance, DISCARD, "%s: %s = %s: expected a finite number", function, v->name, DECIMAL(value));
    if (!is_settable((int)references[index]))
        return refuse(instance, ERROR, "%s: %s can not be set, it is calculated", function, v->name);
    if (instance->data.mode == CONTINUOUS_TIME && ACCESS[references[index]].settable == AT_POINTS)
        return refuse(instance, ERROR, "%s: %s can not be set in continuous-time mode", function, v->name);
    if (!(instance->data.mode & ACCESS[references[index]].settable))
        return refuse(instance, ERROR, "%s: %s is fixed, set it before the initialization ends", function, v->name);
    const int is_start = instance->data.mode & (references[index] < FIRST_INPUT ? BEFORE_STEPPING : INSTANTIATED);
    return refuse(instance, is_start ? ERROR : DISCARD, "%s: %s = %s: expected %s", function, v->name, DECIMAL(value),
                  v->expected);
}

/* What no table holds: continuous states, their derivatives and, in FMI 3.0, time and event indicators, which are
 * calculated when they are read. */
static OUTLINED Status get_locals(Instance *instance, double locals[], const char *function) {
    double fresh[N_CALCULATED + 1];
    const Data *d = &instance->data;
    int broken = 0;
    const double *c = data_calculated(d, fresh, &broken);
    if (!c) return contradictory(instance, broken, function);
    memcpy(locals, d->state, N_CONTINUOUS * sizeof *locals);
    data_derivatives(d, c, locals + N_CONTINUOUS);
    if (N_VARIABLES == TIME) return OK;
    locals[TIME - N_VALUES] = d->time;
    data_indicators(d, c, locals + TIME - N_VALUES + 1);
    return OK;
}

#endif
