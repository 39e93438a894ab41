/* Derivatives: of inputs by time (4.2.1), and directional ones (2.1.9). */

#ifndef DERIVATIVES_H
#define DERIVATIVES_H

#include "steps.h"
#include "values.h"

/* Read from memory: of a model without inputs, a compiler would call the comparison below always false. */
static const int INPUTS_FROM_TO[] = {FIRST_INPUT, FIRST_OUTPUT};

static int is_input(int64_t reference) { return reference >= INPUTS_FROM_TO[0] && reference < INPUTS_FROM_TO[1]; }

static OUTLINED int are_allowed(Instance *instance, int modes, Type type, const fmi2ValueReference references[],
                                size_t count, const void *values, const char *function) {
    return is_allowed(instance, modes, function) && are_given(instance, references, count, values, function) &&
           are_of_type(instance, type, references, count, function);
}

/* 4.2.1: order 0 is not allowed. */
static OUTLINED int are_orders(Instance *instance, const unsigned references[], const int order[], size_t count,
                               const char *function) {
    if (count && !order) return missing(instance, function, "order"), 0;
    for (size_t i = 0; i < count; i++) {
        if (order[i] >= 1) continue;
        refuse(instance, ERROR, "%s: %s: order %d: expected at least 1", function, VARIABLES[references[i]].name,
               order[i]);
        return 0;
    }
    return 1;
}

/* 4.2.1: allowed when fmi2SetReal is, valid for the next step. Inputs move in straight lines: a derivative of higher
 * order is left out, with a warning. */
fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                       const fmi2Integer order[], const fmi2Real value[]) {
    static const char *const function = "fmi2SetRealInputDerivatives";
    Instance *instance = c;
    fmi2Status status = fmi2OK;
    if (!is_of(instance, CO_SIMULATION, function)) return fmi2Error;
    if (!are_allowed(instance, AT_POINTS, REAL, vr, nvr, value, function)) return fmi2Error;
    if (!are_orders(instance, vr, order, nvr, function)) return fmi2Error;
    for (size_t i = 0; i < nvr; i++) {
        const char *name = VARIABLES[vr[i]].name;
        if (!is_input(vr[i])) return refuse(instance, fmi2Error, "%s: %s: expected an input", function, name);
        if (!ACCESS[vr[i]].is_continuous)
            return refuse(instance, fmi2Error, "%s: %s: expected a continuous input", function, name);
        if (!isfinite(value[i]))
            return refuse(instance, fmi2Error, "%s: %s: derivative %s: expected a finite number", function, name,
                          DECIMAL(value[i]));
    }
    for (size_t i = 0; i < nvr; i++) {
        if (order[i] == 1)
            instance->data.input_rate[vr[i] - FIRST_INPUT] = value[i], instance->data.inputs_have_rates = 1;
        else
            status = refuse(instance, fmi2Warning, "%s: %s: order %d is left out: expected 1", function,
                            VARIABLES[vr[i]].name, order[i]);
    }
    return status;
}

/* 4.2.1: maxOutputDerivativeOrder is 0, so that only an empty list is accepted. */
fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                        const fmi2Integer order[], fmi2Real value[]) {
    static const char *const function = "fmi2GetRealOutputDerivatives";
    (void)vr, (void)order, (void)value;
    if (!is_of(c, CO_SIMULATION, function)) return fmi2Error;
    if (!is_allowed(c, HAS_STEPPED, function)) return fmi2Error;
    return nvr ? refuse(c, fmi2Error, "%s: " MODEL_NAME " has no derivatives of outputs", function) : fmi2OK;
}

/* 2.1.9. In initialization mode of what is calculated by parameters and inputs. Later, the rest of the state held, by
 * parameters and continuous states; and of outputs of model exchange, and of derivatives, by inputs too: at a
 * communication point no output depends directly on an input. */
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[], size_t nUnknown,
                                        const fmi2ValueReference vKnown_ref[], size_t nKnown, const fmi2Real dvKnown[],
                                        fmi2Real dvUnknown[]) {
    static const char *const function = "fmi2GetDirectionalDerivative";
    static Derivatives *const functions[] = {model_initial_forward, model_step_forward, model_exchange_forward};
    Instance *instance = c;
    double along[N_SEEDS] = {0}, result[N_SEEDS];
    if (!are_allowed(instance, IS_INITIALIZED, REAL, vUnknown_ref, nUnknown, dvUnknown, function)) return fmi2Error;
    if (!are_allowed(instance, IS_INITIALIZED, REAL, vKnown_ref, nKnown, dvKnown, function)) return fmi2Error;
    const int is_initial = instance->data.mode == INITIALIZATION;
    for (size_t i = 0; i < nUnknown; i++)
        if (is_settable((int)vUnknown_ref[i]) || (is_state(vUnknown_ref[i]) && !is_initial))
            return refuse(instance, fmi2Error, "%s: unknown %s: expected what is calculated in this mode", function,
                          VARIABLES[vUnknown_ref[i]].name);
    for (size_t i = 0; i < nKnown; i++) {
        if (!is_settable((int)vKnown_ref[i]) && !(is_state(vKnown_ref[i]) && !is_initial))
            return refuse(instance, fmi2Error, "%s: known %s: expected a parameter, an input or, later, a state", function,
                          VARIABLES[vKnown_ref[i]].name);
        along[vKnown_ref[i]] += dvKnown[i];
    }
    const Data *d = &instance->data;
    if (is_initial) {
        int broken = 0;
        const fmi2Status status = report(instance, data_refresh(&instance->data, &broken), &broken, function, 0, DISCARD);
        if (status != fmi2OK) return status;
    }
    functions[data_derived_in(d)](d->time, d->state, d->value + FIRST_INPUT, d->value, along, result);
    for (size_t i = 0; i < nUnknown; i++) dvUnknown[i] = result[vUnknown_ref[i]];
    return fmi2OK;
}

#endif
