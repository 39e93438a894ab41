/* One FMU's step and the same equations called without FMI, in turn, so that both see the same machine.
 *
 *   bare LIBRARY STEP COUNT ROUNDS
 *
 * Compiled together with equations.c against the sources inside the FMU. A step is: all inputs written, one
 * communication step, all outputs read. Prints a line a round: seconds of COUNT steps through FMI, seconds of
 * COUNT bare steps.
 */

#define _POSIX_C_SOURCE 200809L

#include <string.h>
#include <time.h>

#include "load.h"
#include "variables.h"

double *PART(values)(void);
void PART(reset)(void);
int PART(refresh)(double t);
void PART(begin)(double h);
void PART(advance)(double t, double h);

static double u[N_INPUTS + 1], y[N_OUTPUTS + 1];

static double seconds(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static double through_fmi(Fmu *fmu, double h, int count) {
    fmi2ValueReference in[N_INPUTS + 1], out[N_OUTPUTS + 1];
    double begun;
    for (unsigned i = 0; i < N_INPUTS; i++) in[i] = FIRST_INPUT + i;
    for (unsigned i = 0; i < N_OUTPUTS; i++) out[i] = FIRST_OUTPUT + i;
    fmu->Reset(fmu->instance);
    fmu->SetupExperiment(fmu->instance, fmi2False, 0, 0, fmi2False, 0);
    fmu->EnterInitializationMode(fmu->instance);
    fmu->ExitInitializationMode(fmu->instance);
    begun = seconds();
    for (int i = 0; i < count; i++) {
        u[0] = 1e-3 * (i % 1000);
        fmu->SetReal(fmu->instance, in, N_INPUTS, u);
        if (fmu->DoStep(fmu->instance, i * h, h, fmi2True) != fmi2OK) exit(1);
        fmu->GetReal(fmu->instance, out, N_OUTPUTS, y);
    }
    return seconds() - begun;
}

static double bare(double h, int count) {
    double *values = PART(values)(), begun;
    PART(reset)();
    if (!PART(refresh)(0)) exit(1);
    PART(begin)(h);
    begun = seconds();
    for (int i = 0; i < count; i++) {
        u[0] = 1e-3 * (i % 1000);
        memcpy(values + FIRST_INPUT, u, N_INPUTS * sizeof *u);
        PART(advance)(i * h, h);
        memcpy(y, values + FIRST_OUTPUT, N_OUTPUTS * sizeof *y);
    }
    return seconds() - begun;
}

int main(int argc, char **argv) {
    Fmu fmu;
    if (argc < 5 || !fmu_load(&fmu, argv[1])) return 1;
    fmu.instance = fmu_instantiate(&fmu, "it", MODEL_GUID);
    for (int i = 0; i < N_INPUTS; i++) u[i] = VARIABLES[FIRST_INPUT + i].start;
    for (int i = 0; i < atoi(argv[4]); i++) {
        const double by_fmi = through_fmi(&fmu, atof(argv[2]), atoi(argv[3])), last = y[0];
        const double by_equations = bare(atof(argv[2]), atoi(argv[3]));
        if (y[0] != last) return 2; /* not the same work */
        printf("%.9f %.9f\n", by_fmi, by_equations);
    }
    fmu_unload(&fmu);
    return 0;
}
