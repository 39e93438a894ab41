/* The least that two FMUs cost which exchange one signal each way: their functions, called in turn.
 *
 *   pair STEP COUNT ROUNDS INPUT OUTPUT LIBRARY GUID LIBRARY GUID
 *
 * INPUT and OUTPUT are the value references in both. Jacobi, nothing recorded. Prints a line a round: seconds of
 * COUNT communication steps, then the first FMU's output after them.
 */

#define _POSIX_C_SOURCE 200809L

#include <time.h>

#include "load.h"

static double seconds(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static void check(fmi2Status status) {
    if (status != fmi2OK) exit(2);
}

static void begin(Fmu *fmu) {
    check(fmu->Reset(fmu->instance));
    check(fmu->SetupExperiment(fmu->instance, fmi2False, 0, 0, fmi2False, 0));
    check(fmu->EnterInitializationMode(fmu->instance));
    check(fmu->ExitInitializationMode(fmu->instance));
}

int main(int argc, char **argv) {
    Fmu a, b;
    if (argc < 10 || !fmu_load(&a, argv[6]) || !fmu_load(&b, argv[8])) return 1;
    const double h = atof(argv[1]);
    const int count = atoi(argv[2]);
    const fmi2ValueReference in = (fmi2ValueReference)atoi(argv[4]), out = (fmi2ValueReference)atoi(argv[5]);
    a.instance = fmu_instantiate(&a, "first", argv[7]);
    b.instance = fmu_instantiate(&b, "second", argv[9]);
    if (!a.instance || !b.instance) return 1;
    for (int round = 0; round < atoi(argv[3]); round++) {
        double of_a, of_b, begun;
        begin(&a);
        begin(&b);
        check(a.GetReal(a.instance, &out, 1, &of_a));
        check(b.GetReal(b.instance, &out, 1, &of_b));
        begun = seconds();
        for (int i = 0; i < count; i++) {
            check(a.SetReal(a.instance, &in, 1, &of_b));
            check(b.SetReal(b.instance, &in, 1, &of_a));
            check(a.DoStep(a.instance, i * h, h, fmi2True));
            check(b.DoStep(b.instance, i * h, h, fmi2True));
            check(a.GetReal(a.instance, &out, 1, &of_a));
            check(b.GetReal(b.instance, &out, 1, &of_b));
        }
        printf("%.9f %.17g\n", seconds() - begun, of_a);
    }
    fmu_unload(&a);
    fmu_unload(&b);
    return 0;
}
