/* Derivatives: of inputs and outputs by time (4.2.1), and directional ones (2.1.9). */

#ifndef DERIVATIVES_H
#define DERIVATIVES_H

#include "values.h"

/* 4.2.1: order 0 is not allowed. */
static int are_orders(Instance *instance, const fmi2ValueReference references[], const fmi2Integer order[],
                      size_t count, const char *function) {
    if (count && !order) return missing(instance, function, "order"), 0;
    for (size_t i = 0; i < count; i++) {
        if (order[i] >= 1) continue;
        refuse(instance, fmi2Error, "%s: %s: order %d: expected at least 1", function, VARIABLES[references[i]].name,
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
    if (!are_allowed(instance, ALWAYS, REAL, vr, nvr, value, function)) return fmi2Error;
    if (!are_orders(instance, vr, order, nvr, function)) return fmi2Error;
    for (size_t i = 0; i < nvr; i++) {
        const char *name = VARIABLES[vr[i]].name;
        if (!is_input(vr[i])) return refuse(instance, fmi2Error, "%s: %s: expected an input", function, name);
        if (VARIABLES[vr[i]].whole || VARIABLES[vr[i]].items)
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

/* 4.2.1: at the current time of the instance; a derivative of an order above maxOutputDerivativeOrder is 0. */
fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                        const fmi2Integer order[], fmi2Real value[]) {
    static const char *const function = "fmi2GetRealOutputDerivatives";
    Instance *instance = c;
    const double *v, *calculated;
    double fresh[N_CALCULATED + 1], rate[N_OUTPUTS + 1];
    int broken = 0;
    if (!are_allowed(instance, HAS_STEPPED, REAL, vr, nvr, value, function)) return fmi2Error;
    if (!are_orders(instance, vr, order, nvr, function)) return fmi2Error;
    for (size_t i = 0; i < nvr; i++)
        if (vr[i] < FIRST_OUTPUT)
            return refuse(instance, fmi2Error, "%s: %s: expected an output", function, VARIABLES[vr[i]].name);
    v = instance->data.value;
    calculated = data_calculated(&instance->data, fresh, &broken);
    if (!calculated) return contradictory(instance, broken, function);
    model_output_rate(instance->data.time, instance->data.state, v + FIRST_INPUT, v, calculated, rate);
    for (size_t i = 0; i < nvr; i++) value[i] = order[i] == 1 ? rate[vr[i] - FIRST_OUTPUT] : 0;
    return fmi2OK;
}

/* 2.1.9. In initialization mode of what is calculated by parameters and inputs; later, the state held, by
 * parameters alone: at a communication point no output depends directly on an input. */
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[], size_t nUnknown,
                                        const fmi2ValueReference vKnown_ref[], size_t nKnown, const fmi2Real dvKnown[],
                                        fmi2Real dvUnknown[]) {
    static const char *const function = "fmi2GetDirectionalDerivative";
    Instance *instance = c;
    double along[N_VARIABLES] = {0}, calculated[N_CALCULATED + 1];
    if (!are_allowed(instance, IS_INITIALIZED, REAL, vUnknown_ref, nUnknown, dvUnknown, function)) return fmi2Error;
    if (!are_allowed(instance, IS_INITIALIZED, REAL, vKnown_ref, nKnown, dvKnown, function)) return fmi2Error;
    for (size_t i = 0; i < nUnknown; i++)
        if (is_settable((int)vUnknown_ref[i]))
            return refuse(instance, fmi2Error, "%s: unknown %s: expected an output or a calculated parameter", function,
                          VARIABLES[vUnknown_ref[i]].name);
    for (size_t i = 0; i < nKnown; i++) {
        if (!is_settable((int)vKnown_ref[i]))
            return refuse(instance, fmi2Error, "%s: known %s: expected a parameter or an input", function,
                          VARIABLES[vKnown_ref[i]].name);
        along[vKnown_ref[i]] += dvKnown[i];
    }
    const Data *d = &instance->data;
    if (d->mode == INITIALIZATION) {
        int broken = 0;
        const fmi2Status status = report(instance, data_refresh(&instance->data, &broken), &broken, function, 0);
        if (status != fmi2OK) return status;
    }
    model_calculate(d->value, calculated);
    model_calculate_derivative(d->value, along, along + FIRST_CALCULATED);
    if (d->mode == INITIALIZATION)
        model_initial_derivative(d->time, d->value + FIRST_INPUT, d->value, calculated, along, along + FIRST_OUTPUT);
    else
        model_output_derivative(d->time, d->state, d->value, calculated, along, along + FIRST_OUTPUT);
    for (size_t i = 0; i < nUnknown; i++) dvUnknown[i] = along[vUnknown_ref[i]];
    return fmi2OK;
}

#endif
