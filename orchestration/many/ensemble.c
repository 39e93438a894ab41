/* The communication loop of an ensemble: that of loop.c for a group of LANES instances that step together, without FMI.
   The structure is made by `EnsembleLoop._group` of ensemble_loop.py, whose docstring explains its members.

   Every member is eight bytes wide: a count, an address, or a number that Python writes there. */

#include <float.h>
#include <stdint.h>

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

typedef double Lanes __attribute__((vector_size(8 * LANES)));
typedef int64_t Mask __attribute__((vector_size(8 * LANES)));
typedef int64_t StepGroup(void *memory, double start, double size);

typedef struct {
    int64_t n_points, n_components, n_signals, n_varied, n_columns, gauss_seidel;
    const double *points;
    StepGroup *const *step;
    void *const *memory;
    const int64_t *first, *source_component;
    const Lanes *const *source;
    Lanes *const *target;
    const double *minimum, *maximum, *factor, *offset, *signal_values;
    Lanes *const *signal;
    const Lanes *const *varied_values;
    Lanes *const *varied;
    const Lanes *const *column;
    Lanes *rows;
    int64_t *recorded, *failure;
} Group;

/* The first failure of an instance ends it: 1 + the component whose step was refused, or -1 - the connection. */
static void note_failure(Group *group, int lane, int64_t point, int64_t failure) {
    if (group->failure[lane]) return;
    group->failure[lane] = failure;
    group->recorded[lane] = point + 1;
}

static void transfer(Group *group, int64_t k, int64_t point, int is_set) {
    const double minimum = is_set ? group->minimum[k] : -DBL_MAX, maximum = is_set ? group->maximum[k] : DBL_MAX;
    const Lanes value = *group->source[k] * group->factor[k] + group->offset[k];
    const Mask good = (Mask)(value >= minimum) & (Mask)(value <= maximum);
    *group->target[k] = value;
    if (__builtin_reduce_and(good)) return;
    for (int lane = 0; lane < LANES; lane++)
        if (!good[lane]) note_failure(group, lane, point, -1 - k);
}

/* Set what signals and connections drive at a communication point, and record it. */
EXPORT void ensemble_exchange(Group *group, int64_t point) {
    Lanes *row = group->rows + point;
    for (int64_t signal = 0; signal < group->n_signals; signal++)
        *group->signal[signal] = group->signal_values[signal * group->n_points + point] - (Lanes){0};
    for (int64_t signal = 0; signal < group->n_varied; signal++)
        *group->varied[signal] = group->varied_values[signal][point];
    for (int64_t k = 0; k < group->first[group->n_components]; k++)
        transfer(group, k, point, point + 1 < group->n_points);
    for (int64_t column = 0; column < group->n_columns; column++, row += group->n_points)
        *row = *group->column[column];
}

static void step_component(Group *group, int64_t c, int64_t point) {
    const double start = group->points[point], end = group->points[point + 1];
    const int64_t refused = group->step[c](group->memory[c], start, end - start);
    for (int lane = 0; refused && lane < LANES; lane++)
        if (refused >> lane & 1) note_failure(group, lane, point, 1 + c);
}

/* From one communication point to another; the last one of all is exchanged and recorded, too. */
EXPORT void ensemble_run(Group *group, int64_t first, int64_t last) {
    for (int64_t point = first; point < last; point++) {
        ensemble_exchange(group, point);
        for (int64_t c = 0; c < group->n_components; c++) {
            for (int64_t k = group->first[c]; group->gauss_seidel && k < group->first[c + 1]; k++)
                if (group->source_component[k] < c) transfer(group, k, point, 1);
            step_component(group, c, point);
        }
    }
    if (last + 1 == group->n_points) ensemble_exchange(group, last);
}
