/* The illustrative example once more: plant and law as one continuous system, classical Runge-Kutta.

   Written from the equations of second_example.py; nothing of the blocks is used. The piecewise-constant law alone
   has samples; its estimates are constant between them. */
#include <math.h>

enum { X1, X2, P1, P2, TH1, TH2, OM, UA, INT, STATES };

typedef struct {
    double amplitude, frequency, theta1, theta2, gain, bound, eps, omega_box, bandwidth, rate, period;
    double kp, ki, a1, a2, alpha, ratio, floor;
    int augmentation;  /* 0 none, 1 PI, 2 nonlinear P */
    int feedforward;   /* 0 none, 1 inside, 2 outside the filter */
    int piecewise, learns_from_both;
} Case;

static const double A1 = -1.0, A2 = -1.4, PB1 = 0.5, PB2 = 0.5 * (1.0 + 1.0) / 1.4; /* P b of A_m' P + P A_m = -I */

static double projected(double estimate, double rate, double bound, double eps) {
    if (bound <= 0.0) return 0.0;
    double f = ((1.0 + eps) * estimate * estimate - bound * bound) / (eps * bound * bound);
    return f > 0.0 && estimate * rate > 0.0 ? rate * (1.0 - f) : rate;
}

static double reference(const Case *c, double t) { return c->amplitude * cos(c->frequency * t); }

static double extension(const Case *c, double e, double integral, double r) {
    if (c->augmentation == 0) return 0.0;
    if (c->augmentation == 1) return -c->kp * e - c->ki * integral;
    double delta = fmax(c->ratio * fabs(r), c->floor);
    if (fabs(e) > delta) return -c->a1 * copysign(pow(fabs(e), c->alpha), e);
    return -c->a2 * e / pow(delta, 1.0 - c->alpha);
}

static double control(const Case *c, double t, const double *x, double *u_p, double *f) {
    double r = reference(c, t), w = c->frequency;
    *f = c->feedforward ? -w * w * r - A2 * -w * c->amplitude * sin(w * t) - A1 * r : 0.0;
    *u_p = extension(c, x[X1] - r, x[INT], r);
    return x[UA] + *u_p + (c->feedforward == 2 ? *f : 0.0);
}

static void rates(const Case *c, double t, const double *x, const double *s, double *d) {
    double u_p, f, u = control(c, t, x, &u_p, &f), r = reference(c, t);
    double e1 = x[P1] - x[X1], e2 = x[P2] - x[X2], error = e1 * PB1 + e2 * PB2;
    double v = c->feedforward == 0 ? r : c->feedforward == 1 ? f : 0.0, known;
    d[X1] = x[X2];
    d[X2] = A1 * x[X1] + A2 * x[X2] + u + c->theta1 * x[X1] + c->theta2 * x[X2];
    d[TH1] = d[TH2] = d[OM] = 0.0;
    if (c->piecewise) {
        known = s[1];
        d[P1] = x[X2] + c->rate * e1 + s[0];
        d[P2] = A1 * x[X1] + A2 * x[X2] + c->rate * e2 + u + s[1];
    } else {
        known = x[TH1] * x[X1] + x[TH2] * x[X2];
        d[P1] = x[P2];
        d[P2] = A1 * x[P1] + A2 * x[P2] + x[OM] * u + known;
        d[TH1] = c->gain * projected(x[TH1], -error * x[X1], c->bound, c->eps);
        d[TH2] = c->gain * projected(x[TH2], -error * x[X2], c->bound, c->eps);
        double learnt = u - (c->learns_from_both ? 0.0 : u_p);
        d[OM] = c->gain * projected(x[OM] - 1.0, -error * learnt, c->omega_box, c->eps);
        if (c->feedforward == 2) v = (1.0 - x[OM]) * f;
    }
    d[UA] = -c->bandwidth * (x[OM] * x[UA] + known - v);
    d[INT] = x[X1] - r;
}

static void advance(const Case *c, double t, double h, const double *s, double *x) {
    double k[4][STATES], y[STATES];
    for (int stage = 0; stage < 4; stage++) {
        double part = stage == 0 ? 0.0 : stage == 3 ? h : 0.5 * h;
        for (int i = 0; i < STATES; i++) y[i] = stage ? x[i] + part * k[stage - 1][i] : x[i];
        rates(c, t + part, y, s, k[stage]);
    }
    for (int i = 0; i < STATES; i++) x[i] += h / 6.0 * (k[0][i] + 2.0 * k[1][i] + 2.0 * k[2][i] + k[3][i]);
}

/* Rows of y and u, `steps` steps of h apart. Returns max |x_tilde| over all steps. */
__attribute__((visibility("default"))) double second_example(
    const Case *c, double h, long long rows, long long steps, double *out) {
    double x[STATES] = {0.0}, s[2] = {0.0, 0.0}, largest = 0.0, u_p, f;
    double grown = exp(c->rate * c->period), gain = grown * c->rate / (grown - 1.0);
    long long sampling = c->piecewise ? llround(c->period / h) : 0;
    x[OM] = 1.0;
    for (long long i = 0; i <= rows * steps; i++) {
        double t = i * h, e1 = x[P1] - x[X1], e2 = x[P2] - x[X2];
        if (sampling && i && i % sampling == 0) { s[0] = -gain * e1; s[1] = -gain * e2; }
        largest = fmax(largest, fmax(fabs(e1), fabs(e2)));
        if (i % steps == 0) {
            double *row = out + 2 * (i / steps);
            row[0] = x[X1];
            row[1] = control(c, t, x, &u_p, &f);
        }
        advance(c, t, h, s, x);
    }
    return largest;
}
