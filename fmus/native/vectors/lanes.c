/* Groups of instances of a native FMU that step together, a lane for each.
 *
 * Compiled with variables.h and model.h of the FMU and with its equations for vectors, model_lanes.h. This is
 * data_step of instance.h for a group of LANES: a refusal there is a bit of the result here. The values of that lane
 * have no meaning from then on; the other lanes are not affected.
 */

#include <float.h>
#include <limits.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

#include "variables.h"

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

enum { N_STEP_SIZES = 4 };

#include "lane_functions.h"
#include "model_lanes.h"

/* size: of a communication step, NaN: of none; internal: of its `count` internal steps [s];
 * constants: their numbers that follow from the parameters. */
typedef struct {
    Lanes constants[N_STEP_CONSTANTS + 1];
    double size, internal;
    int64_t count;
} Steps;

/* value: by value reference, as in `Data` of instance.h; state: the present one and the next, by turns;
 * steps: of some sizes, since the steps of a time grid differ by rounding. */
typedef struct {
    Lanes value[N_VALUES];
    Lanes state[2][N_STATES + 1];
    Lanes memory[N_MEMORY + 1];
    Steps steps[N_STEP_SIZES];
    int64_t present, oldest_steps, parameters_are_stale;
} Group;

static const double MOST_INTERNAL_STEPS = 1e9;

/* Sizes for the caller: numbers of variables, states, and bytes of a group; the value reference of its internal step;
 * the number of Reals that take whole numbers alone. */
EXPORT void lanes_sizes(int64_t sizes[5]) {
    int64_t known[] = {N_VALUES, N_STATES, sizeof(Group), INTERNAL_STEP, 0};
    for (int i = 0; i < N_VALUES; i++) known[4] += VARIABLES[i].whole;
    memcpy(sizes, known, sizeof known);
}

/* Of the FMU whose equations these are. */
EXPORT const char *lanes_guid(void) { return MODEL_GUID; }

/* Of new memory, before anything else: nothing is remembered yet. */
EXPORT void lanes_clear(Group *group) { memset(group->memory, 0xff, sizeof group->memory); } /* NaN of NaN */

/* Computes the calculated parameters. Returns the lanes whose parameters contradict each other. */
static Mask calculate(Group *group) {
    Lanes holds[N_REQUIREMENTS + 1], *p = group->value, *c = p + FIRST_CALCULATED;
    Mask broken = {0};
    group->parameters_are_stale = 0;
    for (int i = 0; i < N_STEP_SIZES; i++) group->steps[i].size = NAN;
    model_calculate(p, c, group->memory);
    model_requirements(p, c, holds, group->memory);
    for (int i = 0; i < N_REQUIREMENTS; i++) broken |= (Mask)(holds[i] != 1);
    for (int i = 0; i < N_CALCULATED; i++)
        if (VARIABLES[FIRST_CALCULATED + i].items || ACCESS[FIRST_CALCULATED + i].type == BOOLEAN)
            EACH_LANE broken[lane] |= -(int64_t)!is_item(FIRST_CALCULATED + i, c[i][lane]);
    return broken;
}

/* The next step begins by computing the calculated parameters, as a step of the FMU does. */
EXPORT void lanes_parameters_changed(Group *group) { group->parameters_are_stale = 1; }

/* The internal steps of a communication step of a size [s]; NULL if they are too many. */
static const Steps *steps_of(Group *group, double size) {
    const Lanes *p = group->value;
    for (int i = 0; i < N_STEP_SIZES; i++)
        if (group->steps[i].size == size) return group->steps + i;
    const double number = size / p[INTERNAL_STEP][0] * (1 - 1e-9);
    if (!(number <= MOST_INTERNAL_STEPS)) return NULL;
    Steps *steps = group->steps + group->oldest_steps;
    group->oldest_steps = (group->oldest_steps + 1) % N_STEP_SIZES;
    steps->size = size;
    steps->count = number <= 1 ? 1 : (int64_t)ceil(number);
    steps->internal = size / steps->count;
    model_step_constants(steps->internal, p, p + FIRST_CALCULATED, steps->constants, group->memory);
    return steps;
}

/* Lanes of which a number is not finite, or an output none of its items. */
static Mask refused(const Lanes *state, const Lanes *outputs) {
    Lanes sum = {0};
    Mask bad = {0};
    for (int i = 0; i < N_STATES; i++) sum += state[i];
    for (int i = 0; i < N_OUTPUTS; i++) sum += outputs[i];
    if (any((Mask)(sum - sum != 0))) { /* a number may not be finite */
        for (int i = 0; i < N_STATES; i++) bad |= (Mask)(state[i] - state[i] != 0);
        for (int i = 0; i < N_OUTPUTS; i++) bad |= (Mask)(outputs[i] - outputs[i] != 0);
    }
    for (int i = 0; i < N_WHOLE_OUTPUTS; i++) {
        const int output = WHOLE_OUTPUTS[i];
        bad |= (Mask)((outputs[output] < INT_MIN) | (outputs[output] > INT_MAX));
        EACH_LANE bad[lane] |= -(int64_t)!is_item(FIRST_OUTPUT + output, outputs[output][lane]);
    }
    return bad;
}

/* Initial states and outputs at a time [s], from parameters and inputs. The lanes that are refused, as bits. */
EXPORT int64_t lanes_initialize(Group *group, double time) {
    const Lanes *p = group->value, *c = p + FIRST_CALCULATED, *u = p + FIRST_INPUT;
    Lanes *outputs = group->value + FIRST_OUTPUT;
    const Mask broken = calculate(group);
    group->present = 0;
    model_initial_state(time, u, p, c, group->state[0], group->memory);
    model_output(time, group->state[0], p, c, outputs, group->memory);
    return bits(broken | refused(group->state[0], outputs));
}

/* From start to start + size [s], in equal internal steps; inputs are held. The lanes that are refused, as bits. */
EXPORT int64_t lanes_step(Group *group, double start, double size) {
    const Lanes *p = group->value, *c = p + FIRST_CALCULATED, *u = p + FIRST_INPUT;
    Lanes *outputs = group->value + FIRST_OUTPUT;
    const Mask broken = group->parameters_are_stale ? calculate(group) : (Mask){0};
    const Steps *steps = steps_of(group, size);
    const Lanes *k, *next;
    if (!steps) return -1;
    k = steps->constants;
    for (int i = 0; i < steps->count; i++) {
        const Lanes *x = group->state[group->present];
        const double time = start + i * steps->internal;
        group->present = !group->present;
        model_step(time, steps->internal, x, u, p, c, k, group->state[group->present], group->memory);
    }
    next = group->state[group->present];
    model_output(start + size, next, p, c, outputs, group->memory);
    return bits(broken | refused(next, outputs));
}
