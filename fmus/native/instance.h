/* One instance of the model: values, modes, steps. Independent of the importer; nothing is allocated here.
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

#include "model.h"

#include "elementary.h"
#include "model_code.h"

/* Everything that a saved state holds: words of 64 bits, integers and doubles. */
typedef struct {
    int64_t mode, parameters_are_stale, outputs_are_stale, inputs_have_rates;
    double time;
    double value[N_VALUES];
    double input_rate[N_INPUTS + 1];
    double state[N_STATES + 1];
    int64_t face, n_steps; /* Face; steps of a model that has no derivative, as an instance for model exchange makes them */
    double start_time;
    double held[N_INPUTS + 1]; /* its inputs in the present step */
} Data;

/* Of an instance for model exchange, also whether its initialization is over, in whatever mode it is. */
typedef enum { CO_SIMULATION, INITIAL_EXCHANGE, EXCHANGE } Face;

/* Numbers of internal steps that follow from their size h and the parameters alone, and calls that follow from inputs,
 * for `remembered`. Importers compute the size of a communication step as the difference of two times, so rounding
 * makes a few sizes in turn: each has its numbers here. Stale once a parameter changes. */
enum { N_STEP_SIZES = 4 };

typedef struct {
    int is_stale, last; /* index of the numbers that were used last */
    struct {
        double h, number[N_STEP_CONSTANTS + 1];
    } of_size[N_STEP_SIZES];
} StepCache;

typedef enum { DONE, CONTRADICTORY, TOO_MANY_STEPS, NOT_FINITE, NO_ITEM } Outcome;

static const double MOST_INTERNAL_STEPS = 1e9;

static void data_reset(Data *d) {
    memset(d, 0, sizeof *d);
    d->mode = INSTANTIATED;
    d->parameters_are_stale = d->outputs_are_stale = 1;
    for (int i = 0; i < N_VALUES; i++) d->value[i] = VARIABLES[i].start;
    for (int i = 0; i < N_STATES; i++) d->state[i] = VARIABLES[N_VARIABLES + i].start;
}

/* In how many internal steps `data_step` takes a step of size h. */
static INLINED double internal_steps(const Data *d, double h) {
    const double steps = h / d->value[INTERNAL_STEP] * (1 - 1e-9);
    return steps <= 1 ? 1 : ceil(steps);
}

/* Of a model without derivative, for model exchange [s]: the suggested step size, in equal internal steps. */
static double sample_time(const Data *d) { return MODEL_STEP_SIZE / internal_steps(d, MODEL_STEP_SIZE); }

/* Steps of another size begin where the last one ended. */
static void data_begin_steps(Data *d) {
    if (!d->n_steps) return;
    d->start_time += (double)d->n_steps * sample_time(d);
    d->n_steps = 0;
}

/* A continuous state is marked as changed, whatever it was. */
static void data_set(Data *d, StepCache *cache, int reference, double value) {
    if (N_CONTINUOUS > 0 && reference >= N_VALUES) {
        d->state[reference - N_VALUES] = value;
        d->outputs_are_stale = 1;
        return;
    }
    if (is_same(d->value[reference], value)) return;
    if (reference == INTERNAL_STEP) data_begin_steps(d);
    d->value[reference] = value;
    if (reference < FIRST_CALCULATED) d->parameters_are_stale = cache->is_stale = 1;
    if (d->mode != STEPPING) d->outputs_are_stale = 1;
}

/* The calculated parameters, computed into `fresh` after a change. NULL if parameters contradict each other:
 * `broken` is then the first requirement that does not hold; or, counted on from these, the first calculated
 * parameter with a value that is no item. */
static INLINED const double *data_calculated(const Data *d, double *fresh, int *broken) {
    double holds[N_REQUIREMENTS + 1];
    if (!d->parameters_are_stale) return d->value + FIRST_CALCULATED;
    model_calculate(d->value, fresh);
    model_requirements(d->value, fresh, holds);
    for (int i = 0; i < N_REQUIREMENTS; i++) {
        if (holds[i] != 1) {
            *broken = i;
            return NULL;
        }
    }
    for (int i = 0; i < N_CALCULATED; i++) {
        if (!is_item(FIRST_CALCULATED + i, fresh[i])) {
            *broken = N_REQUIREMENTS + i;
            return NULL;
        }
    }
    return fresh;
}

/* The numbers for steps of size h: computed, unless the size is one of the last N_STEP_SIZES. */
static INLINED double *step_numbers(StepCache *cache, double h, const double *p, const double *c) {
    if (cache->is_stale) memset(cache, 0, sizeof *cache); /* no step has the size 0 */
    for (int i = 0; i < N_STEP_SIZES; i++) {
        const int at = (cache->last + i) % N_STEP_SIZES;
        if (cache->of_size[at].h != h) continue;
        cache->last = at;
        return cache->of_size[at].number;
    }
    cache->last = (cache->last + 1) % N_STEP_SIZES;
    cache->of_size[cache->last].h = h;
    model_step_constants(h, p, c, cache->of_size[cache->last].number);
    return cache->of_size[cache->last].number;
}

/* The exponent of a number that is infinite or NaN is all ones, so one more overflows to the sign. Without branches,
 * compilers check several at a time. */
static INLINED int are_finite(const double *numbers, int count) {
    const uint64_t exponent = 0x7ffull << 52, one = 1ull << 52;
    uint64_t bad = 0;
    for (int i = 0; i < count; i++) bad |= (bits_of(numbers[i]) & exponent) + one;
    return !(bad >> 63);
}

static int can_be_read(const double *outputs) {
    for (int i = 0; i < N_WHOLE_OUTPUTS; i++)
        if (outputs[WHOLE_OUTPUTS[i]] < INT_MIN || outputs[WHOLE_OUTPUTS[i]] > INT_MAX) return 0;
    return are_finite(outputs, N_OUTPUTS);
}

/* Whether state and outputs are finite, and outputs are items where they must be; `broken`: the first that is not. */
static INLINED Outcome checked(const double *state, const double *outputs, int *broken) {
    if (!are_finite(state, N_STATES) || !can_be_read(outputs)) return NOT_FINITE;
    for (int i = 0; i < N_WHOLE_OUTPUTS; i++) {
        *broken = FIRST_OUTPUT + WHOLE_OUTPUTS[i];
        if (!is_item(*broken, outputs[WHOLE_OUTPUTS[i]])) return NO_ITEM;
    }
    return DONE;
}

/* The state at time t with its outputs, and the calculated parameters that they were made with. */
static INLINED void data_become(Data *d, double t, const double *state, const double *outputs, const double *calculated) {
    memcpy(d->state, state, N_STATES * sizeof *state);
    memcpy(d->value + FIRST_OUTPUT, outputs, N_OUTPUTS * sizeof *outputs);
    if (d->parameters_are_stale) memcpy(d->value + FIRST_CALCULATED, calculated, N_CALCULATED * sizeof *calculated);
    d->parameters_are_stale = d->outputs_are_stale = 0;
    d->time = t;
}

/* The tolerance of a point in time: far less than a step, but more than the rounding of the importer. */
static INLINED double tolerance_at(double t, double h) {
    return fmin(1e-9 * fmax(1, fabs(t)), 1e-3 * h) + 8 * DBL_EPSILON * fabs(t);
}

/* A state between events of model exchange, with up-to-date copies of inputs. */
static void data_hold(const Data *d, const double *state, const double *c, double *held) {
#if MODEL_HAS_DERIVATIVE
    model_held(d->time, state, d->value + FIRST_INPUT, d->value, c, held);
#else
    (void)d, (void)c;
    memcpy(held, state, N_STATES * sizeof *held);
#endif
}

/* Outputs, and until stepping begins the initial state, which follow parameters and inputs. In continuous-time mode
 * discrete ones rest (2.2.7). */
static OUTLINED Outcome data_refresh(Data *d, int *broken) {
    double fresh[N_CALCULATED + 1], state[N_STATES + 1], outputs[N_OUTPUTS + 1];
    const double *p = d->value, *c;
    Outcome outcome;
    if (!d->outputs_are_stale) return DONE;
    c = data_calculated(d, fresh, broken);
    if (!c) return CONTRADICTORY;
    if (d->face == EXCHANGE) {
        data_hold(d, d->state, c, state);
    } else {
        model_initial_state(d->time, p + FIRST_INPUT, p, c, state);
    }
    model_output(d->time, state, p, c, outputs);
    for (int i = 0; i < N_OUTPUTS && d->mode == CONTINUOUS_TIME; i++)
        if (!ACCESS[FIRST_OUTPUT + i].is_continuous) outputs[i] = d->value[FIRST_OUTPUT + i];
    outcome = checked(state, outputs, broken);
    if (outcome == DONE) data_become(d, d->time, state, outputs, c);
    return outcome;
}

/* Inputs at `elapsed` seconds after the communication point, within their ranges. */
static void data_inputs_at(const Data *d, double elapsed, double *inputs) {
    for (int i = 0; i < N_INPUTS; i++) {
        const Variable *v = VARIABLES + FIRST_INPUT + i;
        double u = d->value[FIRST_INPUT + i] + elapsed * d->input_rate[i];
        inputs[i] = d->input_rate[i] == 0 ? d->value[FIRST_INPUT + i] : fmin(fmax(u, v->min), v->max);
    }
}

/* From t to t + h in equal internal steps with the inputs u. They are held over an internal step; inputs with a rate
 * at their value in its middle. Outputs follow the last step at once, so that a compiler computes shared
 * expressions once. */
static INLINED Outcome data_step(Data *d, StepCache *cache, double t, double h, const double *u, int *broken) {
    double fresh[N_CALCULATED + 1], moving[N_INPUTS + 1], reached[N_STATES + 1], next[N_STATES + 1];
    double outputs[N_OUTPUTS + 1];
    const double *p = d->value, *x = d->state;
    const double *c = data_calculated(d, fresh, broken);
    const double count = internal_steps(d, h), internal = h / count;
    if (!c) return CONTRADICTORY;
    if (!(count <= MOST_INTERNAL_STEPS)) return TOO_MANY_STEPS;
    double *numbers = step_numbers(cache, internal, p, c);
    for (double i = 0;; i++) {
        if (d->inputs_have_rates) {
            data_inputs_at(d, (i + 0.5) * internal, moving);
            u = moving;
        }
        model_step(t + i * internal, internal, x, u, p, c, numbers, next);
        if (i + 1 == count) break;
        memcpy(reached, next, N_STATES * sizeof *next);
        x = reached;
    }
    model_output(t + h, next, p, c, outputs);
    const Outcome outcome = checked(next, outputs, broken);
    if (outcome != DONE) return outcome;
    data_become(d, t + h, next, outputs, c);
    if (!d->inputs_have_rates) return DONE;
    memset(d->input_rate, 0, sizeof d->input_rate);
    d->inputs_have_rates = 0;
    return DONE;
}

/* An event of model exchange: takes the samples that are due. `next`: the time of the next sample [s], infinite without
 * one; `jumped`: whether continuous states have changed. A model without derivative steps: each internal step, with
 * the inputs that were there at its beginning, is one sample. */
static OUTLINED Outcome data_event(Data *d, StepCache *cache, int *jumped, double *next, int *broken) {
    const Data before = *d;
    Outcome outcome = DONE;
    *jumped = 0;
#if MODEL_HAS_DERIVATIVE
    double fresh[N_CALCULATED + 1], held[N_STATES + 1];
    const double *p = d->value, *u = d->value + FIRST_INPUT, *c = data_calculated(d, fresh, broken);
    (void)cache;
    if (!c) return CONTRADICTORY;
    data_hold(d, d->state, c, held);
    model_event(d->time, held, u, p, c, d->state);
    model_next_event(d->time, d->state, u, p, c, next);
    for (int i = 0; i < N_CONTINUOUS; i++) *jumped |= !is_same(d->state[i], before.state[i]);
#else
    const double h = sample_time(d), reached = (d->time - d->start_time + tolerance_at(d->time, h)) / h;
    if (!(reached - (double)d->n_steps <= MOST_INTERNAL_STEPS)) return TOO_MANY_STEPS;
    for (; outcome == DONE && (double)(d->n_steps + 1) <= reached; d->n_steps++)
        outcome = data_step(d, cache, d->start_time + (double)d->n_steps * h, h, d->held, broken);
    *next = d->start_time + (double)(d->n_steps + 1) * h;
    d->time = before.time;
#endif
    d->outputs_are_stale = 1;
    if (outcome == DONE) outcome = data_refresh(d, broken);
    if (outcome != DONE) *d = before;
    return outcome;
}

/* The end of an event: a step that begins now takes the present inputs. */
static void data_leave_event(Data *d) {
    const double h = sample_time(d), begins = d->start_time + (double)d->n_steps * h;
    if (fabs(d->time - begins) <= tolerance_at(d->time, h))
        memcpy(d->held, d->value + FIRST_INPUT, N_INPUTS * sizeof *d->held);
}

/* Derivatives of the continuous states. */
static void data_derivatives(const Data *d, const double *c, double *rates) {
#if MODEL_HAS_DERIVATIVE
    double held[N_STATES];
    data_hold(d, d->state, c, held);
    model_derivative(d->time, held, d->value + FIRST_INPUT, d->value, c, rates);
#else
    (void)d, (void)c, (void)rates;
#endif
}

/* Event indicators: their signs change where a derivative has a corner or a jump. */
static void data_indicators(const Data *d, const double *c, double *indicators) {
#if MODEL_HAS_DERIVATIVE
    double held[N_STATES];
    data_hold(d, d->state, c, held);
    model_crossings(d->time, held, d->value + FIRST_INPUT, d->value, c, indicators);
#else
    (void)d, (void)c, (void)indicators;
#endif
}

/* Derivatives of the unknowns of a mode along a seed v of its knowns, by value reference: t, x, u, p, v -> along. */
typedef void Derivatives(double t, const double *x, const double *u, const double *p, const double *v, double *along);

#if !MODEL_HAS_DERIVATIVE /* outputs are the same at all times */
#define model_exchange_forward model_step_forward
#endif

/* Place of the function of the present mode among model_initial_forward, model_step_forward, model_exchange_forward. */
static int data_derived_in(const Data *d) {
    return d->mode == INITIALIZATION ? 0 : d->face == CO_SIMULATION ? 1 : 2;
}

#endif
