/* The communication loop of an ensemble: that of loop.c for groups of instances that step together, without FMI.
   The structure is `EnsembleData` of ensemble_loop.py, whose docstring explains its members.

   Every member is eight bytes wide: a count, an address, or a number that Python writes there. */

#include <float.h>
#include <stdint.h>

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

typedef int64_t StepGroup(void *group, double start, double size);

typedef struct {
    int64_t n_points, n_components, n_signals, n_columns, n_groups;
    int64_t lanes, gauss_seidel;
    const double *points;
    const intptr_t *step, *memory;
    const int64_t *size, *first, *source_component, *source, *target;
    const double *minimum, *maximum, *factor, *offset;
    const double *signal_values;
    const int64_t *signal_component, *signal;
    const int64_t *column_component, *column;
    double *rows;
    int64_t *recorded, *failure;
} Ensemble;

/* A variable of a component in all lanes of a group. */
static double *lanes_of(const Ensemble *ensemble, int64_t group, int64_t component, int64_t variable) {
    double *memory = (double *)ensemble->memory[component];
    return memory + group * ensemble->size[component] + variable * ensemble->lanes;
}

/* The first failure of an instance ends it: 1 + the component whose step was refused, or -1 - the connection. */
static void note_failure(Ensemble *ensemble, int64_t group, int64_t lane, int64_t point, int64_t failure) {
    const int64_t instance = group * ensemble->lanes + lane;
    if (ensemble->failure[instance]) return;
    ensemble->failure[instance] = failure;
    ensemble->recorded[instance] = point + 1;
}

static void transfer(Ensemble *ensemble, int64_t group, int64_t component, int64_t k, int64_t point, int is_set) {
    const double *source = lanes_of(ensemble, group, ensemble->source_component[k], ensemble->source[k]);
    double *target = lanes_of(ensemble, group, component, ensemble->target[k]);
    const double factor = ensemble->factor[k], offset = ensemble->offset[k];
    const double minimum = is_set ? ensemble->minimum[k] : -DBL_MAX, maximum = is_set ? ensemble->maximum[k] : DBL_MAX;
    int bad = 0;
    for (int64_t lane = 0; lane < ensemble->lanes; lane++) {
        target[lane] = source[lane] * factor + offset;
        bad |= !(target[lane] >= minimum) | !(target[lane] <= maximum);
    }
    if (!bad) return;
    for (int64_t lane = 0; lane < ensemble->lanes; lane++)
        if (!(target[lane] >= minimum && target[lane] <= maximum)) note_failure(ensemble, group, lane, point, -1 - k);
}

static void exchange_and_record(Ensemble *ensemble, int64_t group, int64_t point) {
    const int64_t lanes = ensemble->lanes;
    for (int64_t signal = 0; signal < ensemble->n_signals; signal++) {
        double *target = lanes_of(ensemble, group, ensemble->signal_component[signal], ensemble->signal[signal]);
        const double value = ensemble->signal_values[signal * ensemble->n_points + point];
        for (int64_t lane = 0; lane < lanes; lane++) target[lane] = value;
    }
    for (int64_t c = 0; c < ensemble->n_components; c++)
        for (int64_t k = ensemble->first[c]; k < ensemble->first[c + 1]; k++)
            transfer(ensemble, group, c, k, point, point + 1 < ensemble->n_points);
    for (int64_t column = 0; column < ensemble->n_columns; column++) {
        const double *value = lanes_of(ensemble, group, ensemble->column_component[column], ensemble->column[column]);
        double *row = ensemble->rows + ((group * ensemble->n_columns + column) * ensemble->n_points + point) * lanes;
        for (int64_t lane = 0; lane < lanes; lane++) row[lane] = value[lane];
    }
}

static void step_component(Ensemble *ensemble, int64_t group, int64_t c, int64_t point) {
    const double start = ensemble->points[point], end = ensemble->points[point + 1];
    int64_t refused = ((StepGroup *)ensemble->step[c])(lanes_of(ensemble, group, c, 0), start, end - start);
    for (int64_t lane = 0; refused && lane < ensemble->lanes; lane++, refused >>= 1)
        if (refused & 1) note_failure(ensemble, group, lane, point, 1 + c);
}

/* A group from one communication point to another; the last one of all is exchanged and recorded, too. */
EXPORT void ensemble_run(Ensemble *ensemble, int64_t group, int64_t first, int64_t last) {
    for (int64_t point = first; point < last; point++) {
        exchange_and_record(ensemble, group, point);
        for (int64_t c = 0; c < ensemble->n_components; c++) {
            for (int64_t k = ensemble->first[c]; ensemble->gauss_seidel && k < ensemble->first[c + 1]; k++)
                if (ensemble->source_component[k] < c) transfer(ensemble, group, c, k, point, 1);
            step_component(ensemble, group, c, point);
        }
    }
    if (last + 1 == ensemble->n_points) exchange_and_record(ensemble, group, last);
}
