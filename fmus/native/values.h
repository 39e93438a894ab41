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

static int has_type(fmi2ValueReference reference, Type type) {
    return reference < N_VARIABLES && ACCESS[reference].type == type;
}

static fmi2Status not_of_type(Instance *instance, Type type, fmi2ValueReference reference, const char *function) {
    if (reference >= N_VARIABLES)
        return refuse(instance, fmi2Error, "%s: value reference %u: expected 0..%d of " MODEL_NAME, function, reference,
                      N_VARIABLES - 1);
    return refuse(instance, fmi2Error, "%s: %s is %s: expected %s", function, VARIABLES[reference].name,
                  TYPE_NAMES[ACCESS[reference].type], TYPE_NAMES[type]);
}

static int are_given(Instance *instance, const fmi2ValueReference references[], size_t count, const void *values,
                     const char *function) {
    if (!count || (references && values)) return 1;
    missing(instance, function, references ? "value" : "vr");
    return 0;
}

static int are_of_type(Instance *instance, Type type, const fmi2ValueReference references[], size_t count,
                       const char *function) {
    for (size_t i = 0; i < count; i++) {
        if (has_type(references[i], type)) continue;
        not_of_type(instance, type, references[i], function);
        return 0;
    }
    return 1;
}

static int are_allowed(Instance *instance, int modes, Type type, const fmi2ValueReference references[], size_t count,
                       const void *values, const char *function) {
    return is_allowed(instance, modes, function) && are_given(instance, references, count, values, function) &&
           are_of_type(instance, type, references, count, function);
}

/* 2.1.7: until stepping begins, calculated values follow the values that are set, also after an error; later they
 * are those of the last step, and nothing is stale (4.2.4: no fmi2GetXXX after fmi2SetXXX without a step). Called
 * when something is stale. */
static fmi2Status refreshed(Instance *instance, Type type, const fmi2ValueReference references[], size_t count,
                            const char *function) {
    int broken = 0;
    if (!are_of_type(instance, type, references, count, function)) return fmi2Error;
    for (size_t i = 0; i < count; i++)
        if (!is_settable((int)references[i]))
            return report(instance, data_refresh(&instance->data, &broken), &broken, function, 0);
    return fmi2OK;
}

/* What a variable has already, it can have. */
static int can_be_set(const Data *d, fmi2ValueReference reference, Type type, double value) {
    return has_type(reference, type) && (d->mode & ACCESS[reference].settable) &&
           (is_same(d->value[reference], value) || is_acceptable((int)reference, value));
}

/* Refuses the first wrong type, or else the value at `index`, which is the first refused value.
 * 2.1.2: a value reference that cannot be set is an error; 2.1.7: a value out of range may be discarded. */
static fmi2Status cannot_be_set(Instance *instance, Type type, const fmi2ValueReference references[], size_t count,
                                size_t index, double value, const char *function) {
    if (!are_of_type(instance, type, references, count, function)) return fmi2Error;
    const Variable *v = VARIABLES + references[index];
    if (!is_settable((int)references[index]))
        return refuse(instance, fmi2Error, "%s: %s can not be set, it is calculated", function, v->name);
    if (instance->data.mode == CONTINUOUS_TIME && ACCESS[references[index]].settable == AT_POINTS)
        return refuse(instance, fmi2Error, "%s: %s can not be set in continuous-time mode", function, v->name);
    if (!(instance->data.mode & ACCESS[references[index]].settable))
        return refuse(instance, fmi2Error, "%s: %s is fixed, set it before the initialization ends", function, v->name);
    return refuse(instance, fmi2Discard, "%s: %s = %s: expected %s", function, v->name, DECIMAL(value), v->expected);
}

/* Whether the variable has this type and a value of its own. */
static int is_value(fmi2ValueReference reference, Type type) {
    return reference < N_VALUES && ACCESS[reference].type == type;
}

/* Also continuous states and their derivatives, which are Reals and calculated when they are read. */
static fmi2Status get_with_locals(Instance *instance, Type type, const fmi2ValueReference vr[], size_t nvr,
                                  fmi2Real value[], const char *function) {
    if (!are_of_type(instance, type, vr, nvr, function)) return fmi2Error;
    double fresh[N_CALCULATED + 1], rates[N_CONTINUOUS + 1];
    const Data *d = &instance->data;
    int broken = 0;
    const double *c = data_calculated(d, fresh, &broken);
    if (!c) return contradictory(instance, broken, function);
    data_derivatives(d, c, rates);
    for (size_t i = 0; i < nvr; i++)
        value[i] = vr[i] >= FIRST_DERIVATIVE ? rates[vr[i] - FIRST_DERIVATIVE]
                   : vr[i] >= N_VALUES       ? d->state[vr[i] - N_VALUES]
                                             : d->value[vr[i]];
    return fmi2OK;
}

/* 2.1.7; 4.2.4: from initialization mode on; here also when instantiated. */
#define DEFINE_GET(Name, CType, TYPE)                                                                           \
    fmi2Status fmi2Get##Name(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, CType value[]) {       \
        Instance *instance = c;                                                                                 \
        if (!is_allowed(instance, READABLE, "fmi2Get" #Name)) return fmi2Error;                                 \
        if (!are_given(instance, vr, nvr, value, "fmi2Get" #Name)) return fmi2Error;                            \
        if (instance->data.outputs_are_stale) {                                                                 \
            const fmi2Status status = refreshed(instance, TYPE, vr, nvr, "fmi2Get" #Name);                      \
            if (status != fmi2OK) return status;                                                                \
        }                                                                                                       \
        for (size_t i = 0; i < nvr; i++)                                                                        \
            if (!is_value(vr[i], TYPE))                                                                         \
                return get_with_locals(instance, TYPE, vr, nvr, (fmi2Real *)value, "fmi2Get" #Name);            \
        for (size_t i = 0; i < nvr; i++) value[i] = (CType)instance->data.value[vr[i]];                         \
        return fmi2OK;                                                                                          \
    }

/* 2.1.7. Sets all values or none: a refused value leaves every variable as it was. 4.2.4: until the end of the
 * initialization, and in 'step complete' only inputs and tunable parameters, which `settable` of a variable says. */
#define DEFINE_SET(Name, CType, TYPE)                                                                           \
    fmi2Status fmi2Set##Name(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const CType value[]) { \
        Instance *instance = c;                                                                                 \
        if (!is_allowed(instance, ALWAYS, "fmi2Set" #Name)) return fmi2Error;                                   \
        if (!are_given(instance, vr, nvr, value, "fmi2Set" #Name)) return fmi2Error;                            \
        for (size_t i = 0; i < nvr; i++)                                                                        \
            if (!can_be_set(&instance->data, vr[i], TYPE, (double)value[i]))                                    \
                return cannot_be_set(instance, TYPE, vr, nvr, i, (double)value[i], "fmi2Set" #Name);            \
        for (size_t i = 0; i < nvr; i++)                                                                        \
            data_set(&instance->data, &instance->step_cache, (int)vr[i], (double)value[i]);                     \
        return fmi2OK;                                                                                          \
    }

DEFINE_GET(Real, fmi2Real, REAL)
DEFINE_GET(Integer, fmi2Integer, INTEGER)
DEFINE_GET(Boolean, fmi2Boolean, BOOLEAN)
DEFINE_SET(Real, fmi2Real, REAL)
DEFINE_SET(Integer, fmi2Integer, INTEGER)
DEFINE_SET(Boolean, fmi2Boolean, BOOLEAN)

/* 2.1.7: there are no variables of this type, so that only an empty list is accepted. */
static fmi2Status no_strings(Instance *instance, int modes, size_t count, const char *function) {
    if (!is_allowed(instance, modes, function)) return fmi2Error;
    return count ? refuse(instance, fmi2Error, "%s: " MODEL_NAME " has no String variables", function) : fmi2OK;
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2String value[]) {
    (void)vr, (void)value;
    return no_strings(c, READABLE, nvr, "fmi2GetString");
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2String value[]) {
    (void)vr, (void)value;
    return no_strings(c, ALWAYS, nvr, "fmi2SetString");
}

#endif
