/* One instance of the model: values, modes, steps. Knows no importer; nothing is allocated here.
 *
 * Every function leaves the instance as it was unless it returns DONE.
 */

#ifndef INSTANCE_H
#define INSTANCE_H

#include <float.h>
#include <limits.h>
#include <math.h>
#include <string.h>

#include "variables.h"

#include "model_functions.h"

/* States of FMI 2.0.5, figure 11; one bit each. A step is never in progress when the importer calls. */
typedef enum { INSTANTIATED = 1, INITIALIZATION = 2, STEPPING = 4, TERMINATED = 8, IN_ERROR = 16 } Mode;

/* Everything that a saved state holds: words of 64 bits, integers and doubles. */
typedef struct {
    int64_t mode, parameters_are_stale, outputs_are_stale, inputs_have_rates;
    double time, stop_time;
    double value[N_VARIABLES];
    double input_rate[N_INPUTS + 1];
    double state[N_STATES + 1];
} Data;

typedef enum { DONE, CONTRADICTORY, TOO_MANY_STEPS, NOT_FINITE } Outcome;

static const double MOST_INTERNAL_STEPS = 1e9;

static void data_reset(Data *d) {
    memset(d, 0, sizeof *d);
    d->mode = INSTANTIATED;
    d->stop_time = DBL_MAX;
    d->parameters_are_stale = d->outputs_are_stale = 1;
    for (int i = 0; i < N_VARIABLES; i++) d->value[i] = VARIABLES[i].start;
}

static void data_set(Data *d, int reference, double value) {
    if (d->value[reference] == value) return;
    d->value[reference] = value;
    if (reference < FIRST_CALCULATED) d->parameters_are_stale = 1;
    if (d->mode != STEPPING) d->outputs_are_stale = 1;
}

/* Calculated parameters, computed once per change. `broken` is the first requirement that does not hold. */
static Outcome data_calculate(const Data *d, double *calculated, int *broken) {
    double holds[N_REQUIREMENTS + 1];
    memcpy(calculated, d->value + FIRST_CALCULATED, N_CALCULATED * sizeof *calculated);
    if (!d->parameters_are_stale) return DONE;
    model_calculate(d->value, calculated);
    model_requirements(d->value, calculated, holds);
    for (int i = 0; i < N_REQUIREMENTS; i++) {
        if (holds[i] != 1) {
            *broken = i;
            return CONTRADICTORY;
        }
    }
    return DONE;
}

/* Zero times a number is not zero if that is infinite or no number at all. */
static int are_finite(const double *numbers, int count) {
    double zero = 0;
    for (int i = 0; i < count; i++) zero += 0 * numbers[i];
    return zero == 0;
}

static int can_be_read(const double *outputs) {
    for (int i = 0; i < N_OUTPUTS; i++)
        if (VARIABLES[FIRST_OUTPUT + i].type != REAL && fabs(outputs[i]) > INT_MAX) return 0;
    return are_finite(outputs, N_OUTPUTS);
}

/* The state at time t, if it is one, with its outputs and the calculated parameters that it was made with. */
static Outcome data_become(Data *d, double t, const double *state, const double *calculated) {
    double outputs[N_OUTPUTS + 1];
    if (!are_finite(state, N_STATES)) return NOT_FINITE;
    model_output(t, state, d->value, calculated, outputs);
    if (!can_be_read(outputs)) return NOT_FINITE;
    memcpy(d->state, state, N_STATES * sizeof *state);
    memcpy(d->value + FIRST_CALCULATED, calculated, N_CALCULATED * sizeof *calculated);
    memcpy(d->value + FIRST_OUTPUT, outputs, N_OUTPUTS * sizeof *outputs);
    d->parameters_are_stale = d->outputs_are_stale = 0;
    d->time = t;
    return DONE;
}

/* Initial state and outputs, which follow parameters and inputs until stepping begins. */
static Outcome data_refresh(Data *d, int *broken) {
    double calculated[N_CALCULATED + 1], state[N_STATES + 1];
    Outcome outcome;
    if (!d->outputs_are_stale) return DONE;
    outcome = data_calculate(d, calculated, broken);
    if (outcome != DONE) return outcome;
    model_initial_state(d->time, d->value + FIRST_INPUT, d->value, calculated, state);
    return data_become(d, d->time, state, calculated);
}

/* Inputs at `elapsed` seconds after the communication point, within their ranges. */
static void data_inputs_at(const Data *d, double elapsed, double *inputs) {
    for (int i = 0; i < N_INPUTS; i++) {
        const Variable *v = VARIABLES + FIRST_INPUT + i;
        double u = d->value[FIRST_INPUT + i] + elapsed * d->input_rate[i];
        inputs[i] = d->input_rate[i] == 0 ? d->value[FIRST_INPUT + i] : fmin(fmax(u, v->min), v->max);
    }
}

/* From t to t + h in equal internal steps. Inputs are held over an internal step; those with a rate
 * at what they are in its middle. */
static Outcome data_step(Data *d, double t, double h, int *broken) {
    double places[2][N_STATES + 1], moving[N_INPUTS + 1], calculated[N_CALCULATED + 1];
    const double *p = d->value, *u = d->value + FIRST_INPUT, *x = d->state;
    const double steps = ceil(h / p[INTERNAL_STEP] * (1 - 1e-9));
    Outcome outcome = data_calculate(d, calculated, broken);
    if (outcome != DONE) return outcome;
    if (!(steps <= MOST_INTERNAL_STEPS)) return TOO_MANY_STEPS;
    const int count = steps < 1 ? 1 : (int)steps;
    const double internal = h / count;
    for (int i = 0; i < count; i++) {
        double *next = places[i % 2];
        if (d->inputs_have_rates) {
            data_inputs_at(d, (i + 0.5) * internal, moving);
            u = moving;
        }
        model_step(t + i * internal, internal, x, u, p, calculated, next);
        x = next;
    }
    outcome = data_become(d, t + h, x, calculated);
    if (outcome != DONE) return outcome;
    if (d->inputs_have_rates) memset(d->input_rate, 0, sizeof d->input_rate);
    d->inputs_have_rates = 0;
    return DONE;
}

#endif
