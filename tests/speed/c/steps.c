/* The communication steps of two builds of an FMU, in turn, so that both see the same machine.
 *
 *   steps STEP COUNT ROUNDS FIRST_INPUT INPUTS FIRST_OUTPUT OUTPUTS LIBRARY GUID LIBRARY GUID
 *
 * Inputs and outputs are all Real, with consecutive value references. A step is: all inputs set, of which the first
 * changes, one communication step, all outputs read. Prints a line a round: nanoseconds of CPU of a step of the first
 * and of the second library, and 1 if all outputs of all steps were the same bit for bit.
 */

#define _POSIX_C_SOURCE 200809L

#include <stdint.h>
#include <string.h>
#include <time.h>

#include "load.h"

enum { MOST = 256, PERIOD = 1000 };

static fmi2ValueReference in[MOST], out[MOST];
static size_t inputs, outputs;

static double seconds(void) {
    struct timespec now;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static void check(fmi2Status status, const char *call) {
    if (status == fmi2OK) return;
    fprintf(stderr, "%s: status %d\n", call, (int)status);
    exit(1);
}

static void start(const Fmu *fmu) {
    check(fmu->Reset(fmu->instance), "fmi2Reset");
    check(fmu->SetupExperiment(fmu->instance, fmi2False, 0, 0, fmi2False, 0), "fmi2SetupExperiment");
    check(fmu->EnterInitializationMode(fmu->instance), "fmi2EnterInitializationMode");
    check(fmu->ExitInitializationMode(fmu->instance), "fmi2ExitInitializationMode");
}

/* Seconds of the steps; `y` gets the outputs of each, if it is given. */
static double run(const Fmu *fmu, double h, int count, double *y) {
    double u[MOST], last[MOST];
    start(fmu);
    check(fmu->GetReal(fmu->instance, in, inputs, u), "fmi2GetReal");
    const double begun = seconds();
    for (int i = 0; i < count; i++) {
        u[0] = 1e-3 * (i % PERIOD);
        check(fmu->SetReal(fmu->instance, in, inputs, u), "fmi2SetReal");
        check(fmu->DoStep(fmu->instance, i * h, h, fmi2True), "fmi2DoStep");
        check(fmu->GetReal(fmu->instance, out, outputs, y ? y + (size_t)i * outputs : last), "fmi2GetReal");
    }
    return seconds() - begun;
}

static int are_equal(const Fmu *fmus, double h, int count) {
    const size_t size = (size_t)count * outputs * sizeof(double);
    double *y = malloc(2 * size);
    if (!y) exit(1);
    for (size_t i = 0; i < 2; i++) run(fmus + i, h, count, y + i * outputs * (size_t)count);
    const int equal = !memcmp(y, y + outputs * (size_t)count, size);
    free(y);
    return equal;
}

int main(int argc, char **argv) {
    Fmu fmus[2];
    if (argc != 12) return 1;
    const double h = atof(argv[1]);
    const int count = atoi(argv[2]), rounds = atoi(argv[3]);
    inputs = (size_t)atoi(argv[5]), outputs = (size_t)atoi(argv[7]);
    if (inputs > MOST || outputs > MOST) return 1;
    for (size_t i = 0; i < inputs; i++) in[i] = (fmi2ValueReference)(atoi(argv[4]) + (int)i);
    for (size_t i = 0; i < outputs; i++) out[i] = (fmi2ValueReference)(atoi(argv[6]) + (int)i);
    for (int i = 0; i < 2; i++) {
        if (!fmu_load(fmus + i, argv[8 + 2 * i])) return 1;
        fmus[i].instance = fmu_instantiate(fmus + i, "it", argv[9 + 2 * i]);
        if (!fmus[i].instance) return 1;
    }
    const int equal = are_equal(fmus, h, count);
    for (int round = 0; round < rounds; round++) {
        const double first = run(fmus, h, count, NULL), second = run(fmus + 1, h, count, NULL);
        printf("%.3f %.3f %d\n", 1e9 * first / count, 1e9 * second / count, equal);
    }
    fmu_unload(fmus);
    fmu_unload(fmus + 1);
    return 0;
}
