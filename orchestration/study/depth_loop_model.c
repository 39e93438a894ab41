/* The equations of depth_loop_model.py by the classical Runge-Kutta method, many runs side by side.

   Every loop over LANES is independent of one lane to the next, so that the compiler makes vector instructions of it. */

#include <math.h>
#include <stdint.h>
#include <string.h>

#define LANES 16
typedef float Lanes[LANES];

#define PROJECTION_TOLERANCE 0.1f
#define SURFACE_STIFFNESS (1000.0f * 9.81f * 0.022192f) /* N/m, rho g A of the vehicle */
#define SAMPLE_AGE 0.02f                               /* s, the mean over a sampling period of 40 ms */

/* in the order of VARIABLES, without the net weight, then what follows from them */
typedef struct {
    Lanes inertia, linear_damping, quadratic_damping, lift, initial_depth;
    Lanes model_inertia, model_damping, depth_gain, rate_gain, bandwidth, adaptation_gain;
    Lanes sigma_bound, theta_bound, proportional_gain, integral_gain;
    Lanes c_1, c_2, pb_1, pb_2;
} Loop;
#define GIVEN 15

enum { DEPTH, RATE, X_TILDE_1, X_TILDE_2, SIGMA, THETA, U_A, INTEGRAL, STATES };

static inline float larger(float a, float b) { return a > b ? a : b; }

static inline float projected(float estimate, float rate, float bound)
{
    float share = estimate / bound;
    float beyond = ((1.0f + PROJECTION_TOLERANCE) * share * share - 1.0f) / PROJECTION_TOLERANCE;
    return estimate * rate > 0.0f ? rate * (1.0f - larger(beyond, 0.0f)) : rate;
}

static void derive(Loop *p)
{
    for (int i = 0; i < LANES; i++) { /* A_m' P + P A_m = -I */
        p->c_1[i] = p->depth_gain[i] / p->model_inertia[i];
        p->c_2[i] = (p->model_damping[i] + p->rate_gain[i]) / p->model_inertia[i];
        p->pb_1[i] = 0.5f / p->c_1[i] / p->model_inertia[i];
        p->pb_2[i] = 0.5f * (1.0f + 1.0f / p->c_1[i]) / p->c_2[i] / p->model_inertia[i];
    }
}

static void slope(const Loop *restrict p, const Lanes *restrict state, float r, Lanes *restrict out)
{
    for (int i = 0; i < LANES; i++) {
        float z = state[DEPTH][i], v = state[RATE][i], x_1 = state[X_TILDE_1][i], x_2 = state[X_TILDE_2][i];
        float y = z - SAMPLE_AGE * v, speed = fabsf(v), e = y - r;
        float phi = larger(fabsf(y), speed);
        float u_ap = state[U_A][i] - p->proportional_gain[i] * e - p->integral_gain[i] * state[INTEGRAL][i];
        float u = u_ap - p->depth_gain[i] * y - p->rate_gain[i] * v;
        float drag = (p->linear_damping[i] + p->quadratic_damping[i] * speed) * v;
        float floating = SURFACE_STIFFNESS * larger(-z, 0.0f);
        float acceleration = (u - p->lift[i] + floating - drag) / p->inertia[i];
        float eta = state[THETA][i] * phi + state[SIGMA][i];
        float rate = -p->adaptation_gain[i] * (x_1 * p->pb_1[i] + x_2 * p->pb_2[i]);
        out[DEPTH][i] = v;
        out[RATE][i] = acceleration;
        out[X_TILDE_1][i] = x_2;
        out[X_TILDE_2][i] =
            (eta + u_ap) / p->model_inertia[i] - p->c_1[i] * (x_1 + y) - p->c_2[i] * (x_2 + v) - acceleration;
        out[SIGMA][i] = projected(state[SIGMA][i], rate, p->sigma_bound[i]);
        out[THETA][i] = projected(state[THETA][i], rate * phi, p->theta_bound[i]);
        out[U_A][i] = -p->bandwidth[i] * (state[U_A][i] + eta - p->depth_gain[i] * r);
        out[INTEGRAL][i] = e;
    }
}

static void moved(const Lanes *restrict from, float h, const Lanes *restrict along, Lanes *restrict to)
{
    for (int k = 0; k < STATES; k++)
        for (int i = 0; i < LANES; i++) to[k][i] = from[k][i] + h * along[k][i];
}

static void within(Lanes estimate, const Lanes bound)
{
    for (int i = 0; i < LANES; i++) {
        float low = larger(estimate[i], -bound[i]);
        estimate[i] = low < bound[i] ? low : bound[i];
    }
}

/* r: at the beginning, the middle and the end of the step */
static void step(const Loop *p, Lanes *state, const float *r, float h)
{
    Lanes k_1[STATES], k_2[STATES], k_3[STATES], k_4[STATES], between[STATES];
    slope(p, (const Lanes *)state, r[0], k_1);
    moved((const Lanes *)state, 0.5f * h, (const Lanes *)k_1, between);
    slope(p, (const Lanes *)between, r[1], k_2);
    moved((const Lanes *)state, 0.5f * h, (const Lanes *)k_2, between);
    slope(p, (const Lanes *)between, r[1], k_3);
    moved((const Lanes *)state, h, (const Lanes *)k_3, between);
    slope(p, (const Lanes *)between, r[2], k_4);
    for (int k = 0; k < STATES; k++)
        for (int i = 0; i < LANES; i++)
            state[k][i] += h / 6.0f * (k_1[k][i] + 2.0f * (k_2[k][i] + k_3[k][i]) + k_4[k][i]);
    within(state[SIGMA], p->sigma_bound);
    within(state[THETA], p->theta_bound);
}

typedef struct {
    double step, target, band, window_end; /* s, m, m, s */
    const float *reference;                 /* r at 0, h/2, h, ... [m] */
    int64_t steps;
} Task;

/* settling time [s] (not a number if there is none), RMSE [m], largest depth in the window [m] of LANES runs */
static void run(const Task *task, const Loop *p, double (*figures)[LANES])
{
    Lanes state[STATES];
    double squares[LANES] = {0.0}, before[LANES];
    memset(state, 0, sizeof state);
    for (int i = 0; i < LANES; i++) {
        state[DEPTH][i] = p->initial_depth[i];
        before[i] = fabs(state[DEPTH][i] - task->target);
        figures[0][i] = 0.0;
        figures[2][i] = state[DEPTH][i];
        squares[i] = pow(state[DEPTH][i] - task->reference[0], 2.0);
    }
    int64_t last = (int64_t)floor(task->window_end / task->step + 0.5);
    for (int64_t n = 1; n <= task->steps; n++) {
        step(p, state, task->reference + 2 * (n - 1), (float)task->step);
        for (int i = 0; i < LANES; i++) {
            double depth = state[DEPTH][i], error = depth - task->reference[2 * n];
            squares[i] += error * error;
            if (n > last) continue;
            double far = fabs(depth - task->target);
            if (before[i] > task->band && far <= task->band)
                figures[0][i] = task->step * ((double)(n - 1) + (before[i] - task->band) / (before[i] - far));
            if (n == last && !(far <= task->band)) figures[0][i] = NAN;
            if (!(depth <= figures[2][i])) figures[2][i] = depth;
            before[i] = far;
        }
    }
    for (int i = 0; i < LANES; i++) figures[1][i] = sqrt(squares[i] / (double)(task->steps + 1));
}

/* values: a row of `count` for each of VARIABLES; figures: three rows of `count` */
__attribute__((visibility("default"))) void depth_loop_runs(
    const Task *task, int64_t count, const float *values, double *figures)
{
    for (int64_t begin = 0; begin < count; begin += LANES) {
        Loop loop;
        double measured[3][LANES];
        float *members = (float *)&loop;
        for (int k = 0; k < GIVEN; k++)
            for (int64_t i = 0; i < LANES; i++) { /* the last run again where there are no more */
                int64_t column = begin + i < count ? begin + i : count - 1;
                members[k * LANES + i] = values[k * count + column];
            }
        derive(&loop);
        run(task, &loop, measured);
        for (int k = 0; k < 3; k++)
            for (int64_t i = 0; i < LANES && begin + i < count; i++) figures[k * count + begin + i] = measured[k][i];
    }
}
