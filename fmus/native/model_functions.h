/* The model's functions with plain arguments: p parameters, c calculated parameters, u inputs, x state,
 * y outputs. What they compute is generated (model_code.h) in CasADi's calling convention. */

#ifndef MODEL_FUNCTIONS_H
#define MODEL_FUNCTIONS_H

#include "model.h"

#define CASADI_SYMBOL_EXPORT static
#include "model_code.h"

#define CALL(function, result, ...)                     \
    const double *arguments[] = {__VA_ARGS__};          \
    double *results[] = {result}, work[MODEL_WORK + 1]; \
    MODEL(function)(arguments, results, 0, work, 0)

static void model_calculate(const double *p, double *c) { CALL(calculate, c, p); }

static void model_requirements(const double *p, const double *c, double *holds) { CALL(requirements, holds, p, c); }

static void model_initial_state(double t, const double *u, const double *p, const double *c, double *x) {
    CALL(initial_state, x, &t, u, p, c);
}

static void model_step(double t, double h, const double *x, const double *u, const double *p, const double *c,
                       double *next) {
    CALL(step, next, &t, &h, x, u, p, c);
}

static void model_output(double t, const double *x, const double *p, const double *c, double *y) {
    CALL(output, y, &t, x, p, c);
}

static void model_output_rate(double t, const double *x, const double *u, const double *p, const double *c,
                              double *rate) {
    CALL(output_rate, rate, &t, x, u, p, c);
}

static void model_initial_derivative(double t, const double *p, const double *u, const double *seed, double *along) {
    CALL(initial_derivative, along, &t, p, u, seed);
}

static void model_output_derivative(double t, const double *x, const double *p, const double *seed, double *along) {
    CALL(output_derivative, along, &t, x, p, seed);
}

#endif
