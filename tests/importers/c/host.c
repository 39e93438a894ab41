/* A host that is not Python: loads FMUs, joins them and runs a closed loop (Jacobi) from a plan.
 *
 *   host PLAN RESULT [REPEAT]
 *
 * The plan is text, one statement a line, components and variables by number and value reference:
 *
 *   component NAME GUID LIBRARY          the path may contain spaces
 *   set COMPONENT real|integer|boolean REFERENCE VALUE
 *   connect COMPONENT REFERENCE COMPONENT REFERENCE
 *   signal COMPONENT REFERENCE           one column of the table
 *   record COMPONENT REFERENCE           one column of the result: an output, or a signal above
 *   table ROWS PATH                      doubles, a row a communication point: its time, then the signals
 *
 * Everything is a Real but what is set. RESULT receives ROWS rows of doubles, one column a record. REPEAT runs
 * the loop again from a reset and prints the seconds that each run took. Exit status 1 and one line if anything
 * is refused.
 */

#define _POSIX_C_SOURCE 200809L

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "load.h"

enum { MOST_COMPONENTS = 16, MOST_ITEMS = 256, LINE = 4096 };

typedef struct {
    int component;
    fmi2ValueReference reference;
} Port;

typedef struct {
    Port port;
    char type[16];
    double value;
} Setting;

/* The ports of one component that are read or written together. */
typedef struct {
    size_t count;
    fmi2ValueReference reference[MOST_ITEMS];
    double value[MOST_ITEMS];
} Group;

typedef struct {
    Fmu fmu;
    char name[LINE];
    Group in, out;
} Component;

typedef struct {
    int n_components, n_settings, n_links, n_signals, n_records, n_rows;
    Component component[MOST_COMPONENTS];
    Setting setting[MOST_ITEMS];
    double *source[MOST_ITEMS], *target[MOST_ITEMS], *signal[MOST_ITEMS], *record[MOST_ITEMS];
    double *table; /* of n_signals + 1 columns */
} Plan;

static Plan plan;

static void fail(const char *what, const char *which) {
    fprintf(stderr, "host: %s: %s\n", what, which);
    exit(1);
}

static void check(fmi2Status status, const char *call, const Component *component) {
    if (status != fmi2OK) fail(call, component->name);
}

/* Where the value of a port lies: the same place for the same reference. */
static double *place(Group *group, fmi2ValueReference reference) {
    for (size_t i = 0; i < group->count; i++)
        if (group->reference[i] == reference) return group->value + i;
    if (group->count == MOST_ITEMS) fail("too many variables", "plan");
    group->reference[group->count] = reference;
    return group->value + group->count++;
}

static Component *component(int number) {
    if (number < 0 || number >= plan.n_components) fail("no component of that number", "plan");
    return plan.component + number;
}

/* The place of a signal if it is one, of an output otherwise. */
static double *recorded(Component *c, fmi2ValueReference reference) {
    for (size_t i = 0; i < c->in.count; i++)
        if (c->in.reference[i] == reference) return c->in.value + i;
    return place(&c->out, reference);
}

static double *read_table(const char *path, size_t numbers) {
    double *table = malloc((numbers + 1) * sizeof *table);
    FILE *file = fopen(path, "rb");
    if (!file || !table || fread(table, sizeof *table, numbers, file) != numbers) fail("cannot read the table", path);
    fclose(file);
    return table;
}

static void add_component(Component *c, const char *guid, const char *library) {
    if (!fmu_load(&c->fmu, library)) fail("cannot load", library);
    c->fmu.instance = fmu_instantiate(&c->fmu, c->name, guid);
    if (!c->fmu.instance) fail("cannot instantiate", c->name);
    plan.n_components++;
}

static void check_room(void) {
    const int most[] = {plan.n_settings, plan.n_links, plan.n_signals, plan.n_records};
    if (plan.n_components == MOST_COMPONENTS) fail("too many components", "plan");
    for (size_t i = 0; i < sizeof most / sizeof *most; i++)
        if (most[i] == MOST_ITEMS) fail("too many statements", "plan");
}

static void read_statement(const char *line) {
    static char guid[LINE];
    int a, b, end = 0;
    unsigned ra, rb;
    Setting *s = plan.setting + plan.n_settings;
    Component *c = plan.component + plan.n_components;
    if (sscanf(line, "component %s %s %n", c->name, guid, &end) == 2 && end) {
        add_component(c, guid, line + end);
    } else if (sscanf(line, "set %d %15s %u %lf", &s->port.component, s->type, &s->port.reference, &s->value) == 4) {
        component(s->port.component);
        plan.n_settings++;
    } else if (sscanf(line, "connect %d %u %d %u", &a, &ra, &b, &rb) == 4) {
        plan.source[plan.n_links] = place(&component(a)->out, ra);
        plan.target[plan.n_links++] = place(&component(b)->in, rb);
    } else if (sscanf(line, "signal %d %u", &a, &ra) == 2) {
        plan.signal[plan.n_signals++] = place(&component(a)->in, ra);
    } else if (sscanf(line, "record %d %u", &a, &ra) == 2) {
        plan.record[plan.n_records++] = recorded(component(a), ra);
    } else if (sscanf(line, "table %d %n", &plan.n_rows, &end) == 1 && end && plan.n_rows > 0) {
        plan.table = read_table(line + end, (size_t)plan.n_rows * (size_t)(plan.n_signals + 1));
    } else {
        fail("cannot understand", line);
    }
}

static void read_plan(const char *path) {
    char line[LINE];
    FILE *file = fopen(path, "r");
    if (!file) fail("cannot read the plan", path);
    while (fgets(line, sizeof line, file)) {
        line[strcspn(line, "\r\n")] = '\0';
        check_room();
        read_statement(line);
    }
    fclose(file);
    if (!plan.table) fail("expected a table", path);
}

/* The communication point i, followed by the signals there. */
static const double *row(int i) { return plan.table + (size_t)i * (size_t)(plan.n_signals + 1); }

static void write_signals(int i) {
    for (int k = 0; k < plan.n_signals; k++) *plan.signal[k] = row(i)[1 + k];
}

static void exchange(void) {
    for (int i = 0; i < plan.n_links; i++) *plan.target[i] = *plan.source[i];
}

static void write_inputs(Component *c) {
    check(c->fmu.SetReal(c->fmu.instance, c->in.reference, c->in.count, c->in.value), "fmi2SetReal", c);
}

static void read_outputs(Component *c) {
    check(c->fmu.GetReal(c->fmu.instance, c->out.reference, c->out.count, c->out.value), "fmi2GetReal", c);
}

static void apply(const Setting *s) {
    Component *c = component(s->port.component);
    const fmi2ValueReference reference = s->port.reference;
    const int number = (int)s->value;
    fmi2Status status = fmi2Error;
    if (!strcmp(s->type, "real")) status = c->fmu.SetReal(c->fmu.instance, &reference, 1, &s->value);
    if (!strcmp(s->type, "integer")) status = c->fmu.SetInteger(c->fmu.instance, &reference, 1, &number);
    if (!strcmp(s->type, "boolean")) status = c->fmu.SetBoolean(c->fmu.instance, &reference, 1, &number);
    check(status, "setting", c);
}

/* Values flow along the connections until all have arrived: there is no loop in what is initialised here. */
static void initialise(void) {
    const double start = *row(0), stop = *row(plan.n_rows - 1);
    for (int i = 0; i < plan.n_settings; i++) apply(plan.setting + i);
    for (int i = 0; i < plan.n_components; i++) {
        Component *c = plan.component + i;
        check(c->fmu.SetupExperiment(c->fmu.instance, 0, 0.0, start, 1, stop), "fmi2SetupExperiment", c);
        check(c->fmu.EnterInitializationMode(c->fmu.instance), "fmi2EnterInitializationMode", c);
    }
    write_signals(0);
    for (int pass = 0; pass <= plan.n_links; pass++) {
        for (int i = 0; i < plan.n_components; i++) read_outputs(plan.component + i);
        exchange();
        for (int i = 0; i < plan.n_components; i++) write_inputs(plan.component + i);
    }
    for (int i = 0; i < plan.n_components; i++)
        check(plan.component[i].fmu.ExitInitializationMode(plan.component[i].fmu.instance),
              "fmi2ExitInitializationMode", plan.component + i);
    for (int i = 0; i < plan.n_components; i++) read_outputs(plan.component + i);
}

/* Jacobi: everything steps from t_i with the outputs of t_i. */
static void run(double *result) {
    for (int i = 0; i < plan.n_rows; i++) {
        const double t = *row(i);
        write_signals(i);
        for (int k = 0; k < plan.n_records; k++) *result++ = *plan.record[k];
        if (i == plan.n_rows - 1) break;
        exchange();
        for (int k = 0; k < plan.n_components; k++) write_inputs(plan.component + k);
        for (int k = 0; k < plan.n_components; k++) {
            Component *c = plan.component + k;
            check(c->fmu.DoStep(c->fmu.instance, t, *row(i + 1) - t, fmi2True), "fmi2DoStep", c);
        }
        for (int k = 0; k < plan.n_components; k++) read_outputs(plan.component + k);
    }
}

static double seconds(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

int main(int argc, char **argv) {
    const int repeat = argc > 3 ? atoi(argv[3]) : 1;
    size_t numbers;
    double *result;
    FILE *file;
    if (argc < 3) fail("expected", "host PLAN RESULT [REPEAT]");
    read_plan(argv[1]);
    numbers = (size_t)plan.n_rows * (size_t)plan.n_records;
    result = malloc((numbers + 1) * sizeof *result);
    if (!result) fail("no memory", argv[2]);
    for (int i = 0; i < repeat; i++) {
        double begun;
        for (int k = 0; k < plan.n_components; k++)
            check(plan.component[k].fmu.Reset(plan.component[k].fmu.instance), "fmi2Reset", plan.component + k);
        initialise();
        begun = seconds();
        run(result);
        if (argc > 3) printf("%.9f\n", seconds() - begun);
        for (int k = 0; k < plan.n_components; k++)
            check(plan.component[k].fmu.Terminate(plan.component[k].fmu.instance), "fmi2Terminate", plan.component + k);
    }
    file = fopen(argv[2], "wb");
    if (!file || fwrite(result, sizeof *result, numbers, file) != numbers || fclose(file)) fail("cannot write", argv[2]);
    for (int k = 0; k < plan.n_components; k++) fmu_unload(&plan.component[k].fmu);
    free(plan.table);
    free(result);
    return 0;
}
