/* The equations of one FMU without FMI, as a part of a program that has several.
 *
 * Compiled against the sources inside the FMU with -DPART(function)=..., which tells the parts apart.
 */

#include "instance.h"

static Data data;
static StepCache cache;
static int internal_steps;

double *PART(values)(void) { return data.value; }

void PART(reset)(void) { data_reset(&data); }

/* Initial state and outputs; 0 if the parameters contradict each other. */
int PART(refresh)(double t) {
    int broken;
    data.time = t;
    data.outputs_are_stale = 1;
    return data_refresh(&data, &broken) == DONE;
}

/* Communication steps are of h seconds from now on. */
void PART(begin)(double h) {
    internal_steps = (int)fmax(1, ceil(h / data.value[INTERNAL_STEP] * (1 - 1e-9)));
    cache.is_stale = 1;
}

void PART(advance)(double t, double h) {
    const double *p = data.value, *c = data.value + FIRST_CALCULATED, *u = data.value + FIRST_INPUT;
    const double internal = h / internal_steps;
    double next[N_STATES + 1];
    double *numbers = step_numbers(&cache, internal, p, c);
    for (int i = 0;; i++) {
        model_step(t + i * internal, internal, data.state, u, p, c, numbers, next);
        memcpy(data.state, next, N_STATES * sizeof *next);
        if (i + 1 == internal_steps) break;
    }
    model_output(t + h, next, p, c, data.value + FIRST_OUTPUT);
}
