/* Motor: a DC motor with a solver of its own, which chooses its steps as those of exported FMUs do.
 *
 *     L i' = u - R i - K w,   J w' = K i - C tanh(w / W)
 *
 * Heun's method; the difference from Euler's is the error of an inner step, permitted up to `solver_tolerance` of
 * 1 + |x|. It takes up its last step size in the next communication step, whose length decides where steps end.
 */

enum { VOLTAGE, CURRENT, SPEED, N_VARIABLES };

#define MODEL_CONFIG double solver_tolerance;
#include "slave.h"

static const double L = 1e-3, R = 1, K = 0.05, J = 1e-4, C = 5e-3, W = 1; /* SI units */

static void slopes(const double x[2], double u, double slope[2]) {
    slope[0] = (u - R * x[0] - K * x[1]) / L;
    slope[1] = (K * x[0] - C * tanh(x[1] / W)) / J;
}

static fmi2Status model_initialise(Slave *s) {
    s->data.value[CURRENT] = s->data.value[SPEED] = 0;
    s->data.state = 1e-4; /* step size of the solver [s] */
    return fmi2OK;
}

/* One try of h s; the largest error over the permitted one. */
static double inner_step(const double x[2], double u, double h, double tolerance, double next[2]) {
    double first[2], second[2], predicted[2], largest = 0;
    slopes(x, u, first);
    for (int i = 0; i < 2; i++) predicted[i] = x[i] + h * first[i];
    slopes(predicted, u, second);
    for (int i = 0; i < 2; i++) {
        next[i] = x[i] + 0.5 * h * (first[i] + second[i]);
        largest = fmax(largest, fabs(next[i] - predicted[i]) / (tolerance * (1 + fabs(next[i]))));
    }
    return largest;
}

static fmi2Status model_step(Slave *s, double h) {
    Data *d = &s->data;
    const double tolerance = s->tolerance ? s->tolerance : config.solver_tolerance;
    double x[2] = {d->value[CURRENT], d->value[SPEED]}, next[2], done = 0;
    while (done < h) {
        const int is_last = done + d->state >= h;
        const double size = is_last ? h - done : d->state;
        const double error = inner_step(x, d->value[VOLTAGE], size, tolerance, next);
        const double factor = fmax(0.2, fmin(0.9 / sqrt(error + 1e-12), 5));
        if (error <= 1) {
            memcpy(x, next, sizeof x);
            done = is_last ? h : done + size;
        }
        if (error > 1 || !is_last) d->state = size * factor;
    }
    d->value[CURRENT] = x[0];
    d->value[SPEED] = x[1];
    return fmi2OK;
}
