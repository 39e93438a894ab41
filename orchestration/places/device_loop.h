/* The communication loop of an ensemble on a device, as that of ensemble.c: each thread runs one system.
 * The structure is made by `DeviceLoop`; what is an address of lanes in ensemble.c is the place of a word of `System`. */

/* COMPONENTS(X) has an X(i) for each component, whose functions are those of device_component.h in the namespace ci. */
#define MEMBER(i) c##i::Instance m##i;
#define INITIALISE(i) case i: return c##i::initialise(&system->m##i, time);
#define CHANGE(i) case i: return c##i::parameters_changed(&system->m##i);
#define STEP(i) case i: return c##i::step(&system->m##i, start, size);
#define SIZES(i) c##i::write_sizes(sizes + 4 * i);

typedef struct {
    COMPONENTS(MEMBER)
} System;

typedef struct {
    int64_t n_points, n_components, n_signals, n_varied, n_columns, gauss_seidel;
    const double *points;
    int64_t no_steps;
    System *systems;
    const int64_t *first, *source_component, *source, *target;
    const double *minimum, *maximum, *factor, *offset, *signal_values;
    const int64_t *signal;
    const double *const *varied_values;
    const int64_t *varied, *column;
    double *rows;
    int64_t *recorded, *failure, count;
} Batch;

static int initialise_component(System *system, int64_t c, double time) {
    switch (c) { COMPONENTS(INITIALISE) }
    return 0;
}

static void change_component(System *system, int64_t c) {
    switch (c) { COMPONENTS(CHANGE) }
}

static int step_component(System *system, int64_t c, double start, double size) {
    switch (c) { COMPONENTS(STEP) }
    return 0;
}

static double *word(System *system, int64_t place) { return (double *)system + place; }

/* The first failure of an instance ends it: 1 + the component whose step was refused, or -1 - the connection. */
static void note_failure(const Batch *batch, int64_t i, int64_t point, int64_t failure) {
    if (batch->failure[i]) return;
    batch->failure[i] = failure;
    batch->recorded[i] = point + 1;
}

static void transfer(const Batch *batch, System *system, int64_t i, int64_t k, int64_t point, int is_set) {
    const double minimum = is_set ? batch->minimum[k] : -DBL_MAX, maximum = is_set ? batch->maximum[k] : DBL_MAX;
    const double value = *word(system, batch->source[k]) * batch->factor[k] + batch->offset[k];
    *word(system, batch->target[k]) = value;
    if (!(value >= minimum && value <= maximum)) note_failure(batch, i, point, -1 - k);
}

static void exchange(const Batch *batch, System *system, int64_t i, int64_t point) {
    for (int64_t signal = 0; signal < batch->n_signals; signal++)
        *word(system, batch->signal[signal]) = batch->signal_values[signal * batch->n_points + point];
    for (int64_t signal = 0; signal < batch->n_varied; signal++)
        *word(system, batch->varied[signal]) = batch->varied_values[signal][point * batch->count + i];
    for (int64_t k = 0; k < batch->first[batch->n_components]; k++)
        transfer(batch, system, i, k, point, point + 1 < batch->n_points);
    for (int64_t column = 0; column < batch->n_columns; column++)
        batch->rows[(column * batch->n_points + point) * batch->count + i] = *word(system, batch->column[column]);
}

/* Set what signals and connections drive at the communication point `first`, and record it. */
static void ensemble_exchange(Batch *batch, int64_t i, int64_t first, int64_t last) {
    (void)last;
    exchange(batch, batch->systems + i, i, first);
}

/* From one communication point to another; the last one of all is exchanged and recorded, too. */
static void ensemble_run(Batch *batch, int64_t i, int64_t first, int64_t last) {
    System system = batch->systems[i];
    for (int64_t point = first; point < last && !batch->failure[i]; point++) {
        const double start = batch->points[point], size = batch->points[point + 1] - start;
        exchange(batch, &system, i, point);
        for (int64_t c = 0; c < batch->n_components; c++) {
            for (int64_t k = batch->first[c]; batch->gauss_seidel && k < batch->first[c + 1]; k++)
                if (batch->source_component[k] < c) transfer(batch, &system, i, k, point, 1);
            if (step_component(&system, c, start, size)) note_failure(batch, i, point, 1 + c);
        }
    }
    if (last + 1 == batch->n_points) exchange(batch, &system, i, last);
    batch->systems[i] = system;
}

/* Initial values of the component `first` at the first communication point. */
static void ensemble_initialise(Batch *batch, int64_t i, int64_t first, int64_t last) {
    (void)last;
    if (!initialise_component(batch->systems + i, first, batch->points[0]) || batch->failure[i]) return;
    batch->failure[i] = 1 + first;
    batch->recorded[i] = 0;
}

/* The next step begins with what follows from the parameters of the component `first`. */
static void ensemble_change(Batch *batch, int64_t i, int64_t first, int64_t last) {
    (void)last;
    change_component(batch->systems + i, first);
}

/* For Python, of each component: see `DeviceComponent`. */
static void ensemble_sizes(Batch *batch, int64_t i, int64_t first, int64_t last) {
    int64_t *sizes = (int64_t *)batch;
    (void)i, (void)first, (void)last;
    COMPONENTS(SIZES)
}

KERNEL(ensemble_sizes)
KERNEL(ensemble_exchange)
KERNEL(ensemble_run)
KERNEL(ensemble_initialise)
KERNEL(ensemble_change)
