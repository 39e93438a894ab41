/* Many instances one beside the other, and in threads,.
 *
 *   lifecycle instances|threads LIBRARY GUID COUNT STEPS STEP INPUT OUTPUT...
 *
 * INPUT is the value reference of a Real input that is moved, OUTPUT those of Real outputs. Exit status 1 and one line if anything is not as it should be.
 */

#define _POSIX_C_SOURCE 200809L

#include <math.h>
#include <pthread.h>
#include <string.h>

#include "load.h"

enum { MOST_INSTANCES = 1000, MOST_OUTPUTS = 64, MOST_BYTES = 1 << 16, MOST_MESSAGES = 2 };

typedef struct {
    double value[MOST_OUTPUTS];
} Outputs;

typedef struct {
    fmi2Component instance;
    Outputs sum; /* of all steps: the same only if every step gave the same */
    int messages;
} Run;

static Fmu fmu;
static const char *guid;
static int steps, n_outputs;
static double h;
static fmi2ValueReference input, output[MOST_OUTPUTS];
static Run runs[MOST_INSTANCES];


static void fail(const char *what) {
    fprintf(stderr, "lifecycle: %s\n", what);
    exit(1);
}

static void expect(int holds, const char *what) {
    if (!holds) fail(what);
}

static void keep_message(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status,
                         fmi2String category, fmi2String message, ...) {
    Run *run = environment;
    (void)instance, (void)category;
    expect(status == fmi2Discard && strstr(message, "nan") != NULL, "another message than the one provoked");
    run->messages++;
}

static void create(Run *run) {
    /* the importer's callbacks must outlive the instance: one for each, as the environment differs */
    static fmi2CallbackFunctions callbacks[MOST_INSTANCES];
    fmi2CallbackFunctions *own = callbacks + (run - runs);
    *own = (fmi2CallbackFunctions){keep_message, NULL, NULL, NULL, run};
    memset(run, 0, sizeof *run);
    run->instance = fmu.Instantiate("it", fmi2CoSimulation, guid, "file:///", own, fmi2False, fmi2True);
    expect(run->instance != NULL, "no instance");
    expect(fmu.SetupExperiment(run->instance, fmi2False, 0, 0, fmi2False, 0) == fmi2OK, "fmi2SetupExperiment");
    expect(fmu.EnterInitializationMode(run->instance) == fmi2OK, "fmi2EnterInitializationMode");
    expect(fmu.ExitInitializationMode(run->instance) == fmi2OK, "fmi2ExitInitializationMode");
}

static Outputs step(Run *run, int i) {
    Outputs y = {{0}};
    const double u = 0.01 * (i % 50);
    expect(fmu.SetReal(run->instance, &input, 1, &u) == fmi2OK, "fmi2SetReal");
    expect(fmu.DoStep(run->instance, i * h, h, fmi2False) == fmi2OK, "fmi2DoStep");
    expect(fmu.GetReal(run->instance, output, (size_t)n_outputs, y.value) == fmi2OK, "fmi2GetReal");
    for (int k = 0; k < n_outputs; k++) run->sum.value[k] += y.value[k];
    return y;
}

static int are_equal(const Outputs *a, const Outputs *b) { return !memcmp(a, b, sizeof *a); }

/* One step more, and the same again from the saved state and from the one that went through bytes. */
static void restore(Run *run, int i) {
    fmi2Byte bytes[MOST_BYTES];
    fmi2FMUstate saved = NULL, read = NULL;
    const double refused = NAN;
    size_t size;
    Outputs y, again;
    expect(fmu.GetFMUstate(run->instance, &saved) == fmi2OK, "fmi2GetFMUstate");
    expect(fmu.SerializedFMUstateSize(run->instance, saved, &size) == fmi2OK, "fmi2SerializedFMUstateSize");
    expect(size <= sizeof bytes, "a state of another size");
    expect(fmu.SerializeFMUstate(run->instance, saved, bytes, size) == fmi2OK, "fmi2SerializeFMUstate");
    y = step(run, i);
    expect(fmu.DeSerializeFMUstate(run->instance, bytes, size, &read) == fmi2OK, "fmi2DeSerializeFMUstate");
    expect(fmu.SetFMUstate(run->instance, saved) == fmi2OK, "fmi2SetFMUstate");
    again = step(run, i);
    expect(are_equal(&y, &again), "other outputs from the saved state");
    expect(fmu.SetFMUstate(run->instance, read) == fmi2OK, "fmi2SetFMUstate");
    again = step(run, i);
    expect(are_equal(&y, &again), "other outputs from the serialised state");
    expect(fmu.SetReal(run->instance, &input, 1, &refused) == fmi2Discard && run->messages == 1, "NaN was not refused");
    expect(fmu.FreeFMUstate(run->instance, &saved) == fmi2OK && !saved, "fmi2FreeFMUstate");
    expect(fmu.FreeFMUstate(run->instance, &read) == fmi2OK && !read, "fmi2FreeFMUstate");
}

static void finish(Run *run) {
    expect(fmu.Terminate(run->instance) == fmi2OK, "fmi2Terminate");
    fmu.FreeInstance(run->instance);
}

static void *whole_life(void *argument) {
    Run *run = argument;
    create(run);
    for (int i = 0; i < steps; i++) step(run, i);
    restore(run, steps);
    finish(run);
    return NULL;
}

/* All are alive at the same time. */
static void in_turn(int number) {
    for (int k = 0; k < number; k++) create(runs + k);
    for (int i = 0; i < steps; i++)
        for (int k = 0; k < number; k++) step(runs + k, i);
    for (int k = 0; k < number; k++) restore(runs + k, steps);
    for (int k = 0; k < number; k++) finish(runs + k);
}

static void in_threads(int number) {
    static pthread_t threads[MOST_INSTANCES];
    for (int k = 0; k < number; k++) expect(!pthread_create(threads + k, NULL, whole_life, runs + k), "no thread");
    for (int k = 0; k < number; k++) expect(!pthread_join(threads[k], NULL), "a thread that does not end");
}

int main(int argc, char **argv) {
    int number;
    expect(argc > 8 && argc - 8 <= MOST_OUTPUTS, "expected the arguments that its first lines tell");
    expect(fmu_load(&fmu, argv[2]), "cannot load");
    guid = argv[3], number = atoi(argv[4]), steps = atoi(argv[5]), h = atof(argv[6]);
    input = (fmi2ValueReference)atoi(argv[7]);
    for (int k = 8; k < argc; k++) output[n_outputs++] = (fmi2ValueReference)atoi(argv[k]);
    expect(number > 0 && number <= MOST_INSTANCES, "another number of instances");
    if (!strcmp(argv[1], "threads")) in_threads(number);
    else in_turn(number);
    for (int k = 1; k < number; k++) expect(are_equal(&runs->sum, &runs[k].sum), "two instances differ");
    expect(runs->sum.value[0] != 0, "outputs that say nothing");
    fmu_unload(&fmu);
    return 0;
}
