/* Linear: x' = a x + b u, y = c x + d u with one state, N_U inputs and N_Y outputs; x(start) = initial_state.
 *
 * Exact over a step for inputs that are held or change linearly (FMI's input derivatives of order 1):
 *     x(t + h) = exp(a h) x + h phi_1(a h) b u + h^2 phi_2(a h) b u'
 *     phi_1(z) = (exp(z) - 1) / z,  phi_2(z) = (exp(z) - 1 - z) / z^2
 * The outputs are those at the end of the step, with the inputs that the step ends with.
 * `solver_error` is what a solver of its own would leave in the state in each step of at least `solver_step`, of either
 * sign, since it starts anew where an input has changed; in a shorter one less, of order 2.
 * With N_DISCRETE = 1, an Integer and a Boolean are passed through as well; the Boolean until `refuses_boolean_from`.
 * config.h has N_U, N_Y and N_DISCRETE.
 */

#include "config.h"

enum {
    A,
    INITIAL_STATE,
    U,
    Y = U + N_U,
    INTEGER_IN = Y + N_Y,
    BOOLEAN_IN = INTEGER_IN + N_DISCRETE,
    INTEGER_OUT = BOOLEAN_IN + N_DISCRETE,
    BOOLEAN_OUT = INTEGER_OUT + N_DISCRETE,
    N_VARIABLES = BOOLEAN_OUT + N_DISCRETE
};

#define MODEL_CONFIG double refuses_boolean_from, solver_error, solver_step, b[N_U], c[N_Y], d[N_Y][N_U];
#define MODEL_REFUSES
#include "slave.h"

static fmi2Status model_accepts(Slave *s, fmi2ValueReference reference) {
    const int is_boolean = N_DISCRETE && reference == BOOLEAN_IN && s->data.mode == STEPPING;
    return is_boolean && s->data.time >= config.refuses_boolean_from ? refuse(s, fmi2Discard, "no Boolean is taken any more")
                                                              : fmi2OK;
}

static fmi2Status model_saves(Slave *s) {
    (void)s;
    return fmi2OK;
}

static fmi2Status model_tells_time(Slave *s) {
    (void)s;
    return fmi2OK;
}

static double phi_1(double z) { return fabs(z) < 1e-8 ? 1 + z / 2 : expm1(z) / z; }

static double phi_2(double z) {
    double sum = 0, term = 0.5; /* z^n / (n + 2)!, to rounding for |z| < 0.5 */
    if (fabs(z) >= 0.5) return (expm1(z) - z) / (z * z);
    for (int n = 1; n < 20; n++) {
        sum += term;
        term *= z / (n + 2);
    }
    return sum;
}

static double driven(const double u[]) {
    double sum = 0;
    for (int j = 0; j < N_U; j++) sum += config.b[j] * u[j];
    return sum;
}

static double output(int i, double x, const double u[]) {
    double sum = config.c[i] * x;
    for (int j = 0; j < N_U; j++) sum += config.d[i][j] * u[j];
    return sum;
}

static void set_outputs(Data *d, const double u[], const double rate[]) {
    const double slope = d->value[A] * d->state + driven(u);
    for (int i = 0; i < N_Y; i++) {
        d->value[Y + i] = output(i, d->state, u);
        d->output_rate[Y + i] = output(i, slope, rate);
    }
    if (N_DISCRETE) {
        d->value[INTEGER_OUT] = d->value[INTEGER_IN];
        d->value[BOOLEAN_OUT] = d->value[BOOLEAN_IN];
    }
}

static fmi2Status model_initialise(Slave *s) {
    s->data.state = s->data.value[INITIAL_STATE];
    set_outputs(&s->data, s->data.value + U, s->data.input_rate + U);
    return fmi2OK;
}

static fmi2Status model_step(Slave *s, double h) {
    Data *d = &s->data;
    const double z = d->value[A] * h, *u = d->value + U, *rate = d->input_rate + U;
    double end[N_U + 1];
    for (int j = 0; j < N_U; j++) end[j] = u[j] + h * rate[j];
    d->state = exp(z) * d->state + h * phi_1(z) * driven(u) + h * h * phi_2(z) * driven(rate);
    if (config.solver_error > 0 && memcmp(d->before + U, u, N_U * sizeof *u)) {
        const double part = fmin(h / config.solver_step, 1);
        memcpy(d->before + U, u, N_U * sizeof *u);
        d->state += config.solver_error * part * part * sin(1e7 * (d->time + h));
    }
    set_outputs(d, end, rate);
    return fmi2OK;
}
