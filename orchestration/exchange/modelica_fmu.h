/* An FMU as an external object of Modelica: open, outputs at the start, steps, close.

   Every function may be called again with the same arguments and gives the same, as tools evaluate
   initial equations more than once. Failures end the simulation by ModelicaFormatError. */

#ifndef MODELICA_FMU_H
#define MODELICA_FMU_H

#include <string.h>

#include "ModelicaUtilities.h"
#include "load.h"

#if defined(_WIN32)
#define FMU_LIBRARY "%s/binaries/win64/%s.dll"
#elif defined(__APPLE__)
#define FMU_LIBRARY "%s/binaries/darwin64/%s.dylib"
#elif defined(__aarch64__)
#define FMU_LIBRARY "%s/binaries/aarch64-linux/%s.so"
#else
#define FMU_LIBRARY "%s/binaries/linux64/%s.so"
#endif

enum { FMU_PATH_SIZE = 4096, FMU_GUID_SIZE = 256, FMU_DESCRIPTION_HEAD = 4096 };

typedef struct {
    Fmu fmu;
    fmi2CallbackFunctions callbacks;
    int begun; /* initialisation mode was entered */
    int steps; /* communication steps done */
    const int *inputs, *outputs;
    size_t n_inputs, n_outputs;
    int references[1]; /* of inputs, then of outputs */
} ModelicaFmu;

static void modelica_fmu_log(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status,
                             fmi2String category, fmi2String message, ...) {
    (void)environment, (void)status;
    ModelicaFormatMessage("%s: %s: %s\n", instance, category, message);
}

static void modelica_fmu_require(fmi2Status status, const char *call) {
    if (status > fmi2Warning) ModelicaFormatError("%s: status %d, as the log says", call, (int)status);
}

/* The GUID from the head of the unpacked modelDescription.xml. */
static void modelica_fmu_guid(const char *folder, char guid[FMU_GUID_SIZE]) {
    static const char key[] = " guid=\"";
    char path[FMU_PATH_SIZE], head[FMU_DESCRIPTION_HEAD + 1];
    const char *begin, *end;
    FILE *file;
    snprintf(path, sizeof path, "%s/modelDescription.xml", folder);
    file = fopen(path, "rb");
    if (!file) ModelicaFormatError("cannot read %s", path);
    head[fread(head, 1, FMU_DESCRIPTION_HEAD, file)] = '\0';
    fclose(file);
    begin = strstr(head, key);
    end = begin ? strchr(begin + sizeof key - 1, '"') : NULL;
    if (!end || end - begin - (long)sizeof key + 1 >= FMU_GUID_SIZE) {
        ModelicaFormatError("%s: no guid of fewer than %d characters", path, FMU_GUID_SIZE);
    }
    snprintf(guid, FMU_GUID_SIZE, "%.*s", (int)(end - begin - (long)sizeof key + 1), begin + sizeof key - 1);
}

static void modelica_fmu_parameters(ModelicaFmu *self, const int *real_references, const double *reals,
                                    size_t n_reals, const int *integer_references, const int *integers,
                                    size_t n_integers, const int *boolean_references, const int *booleans,
                                    size_t n_booleans) {
    const fmi2ValueReference *real = (const fmi2ValueReference *)real_references;
    const fmi2ValueReference *integer = (const fmi2ValueReference *)integer_references;
    const fmi2ValueReference *boolean = (const fmi2ValueReference *)boolean_references;
    Fmu *fmu = &self->fmu;
    modelica_fmu_require(fmu->SetReal(fmu->instance, real, n_reals, reals), "fmi2SetReal");
    modelica_fmu_require(fmu->SetInteger(fmu->instance, integer, n_integers, integers), "fmi2SetInteger");
    modelica_fmu_require(fmu->SetBoolean(fmu->instance, boolean, n_booleans, booleans), "fmi2SetBoolean");
}

/* folder: of the unpacked FMU; name: its modelIdentifier; then references and values of its parameters,
   and the references of its Real inputs and outputs in the order of the arrays u and y below. */
static void *modelica_fmu_open(const char *folder, const char *name, const char *instance,
                               const int *real_references, const double *reals, size_t n_reals,
                               const int *integer_references, const int *integers, size_t n_integers,
                               const int *boolean_references, const int *booleans, size_t n_booleans,
                               const int *inputs, size_t n_inputs, const int *outputs, size_t n_outputs) {
    char path[FMU_PATH_SIZE], guid[FMU_GUID_SIZE];
    ModelicaFmu *self = calloc(1, sizeof *self + (n_inputs + n_outputs) * sizeof(int));
    if (!self) ModelicaError("no memory for an FMU");
    snprintf(path, sizeof path, FMU_LIBRARY, folder, name);
    modelica_fmu_guid(folder, guid);
    if (!fmu_load(&self->fmu, path)) ModelicaFormatError("cannot load %s", path);
    self->callbacks = (fmi2CallbackFunctions){modelica_fmu_log, calloc, free, NULL, NULL};
    self->fmu.instance = self->fmu.Instantiate(instance, fmi2CoSimulation, guid, "file:///",
                                               &self->callbacks, fmi2False, fmi2True);
    if (!self->fmu.instance) ModelicaFormatError("%s was not instantiated, for a reason in the log", path);
    self->n_inputs = n_inputs, self->n_outputs = n_outputs;
    memcpy(self->references, inputs, n_inputs * sizeof(int));
    memcpy(self->references + n_inputs, outputs, n_outputs * sizeof(int));
    self->inputs = self->references, self->outputs = self->references + n_inputs;
    modelica_fmu_parameters(self, real_references, reals, n_reals, integer_references, integers, n_integers,
                            boolean_references, booleans, n_booleans);
    return self;
}

static void modelica_fmu_set(ModelicaFmu *self, const double *u) {
    modelica_fmu_require(self->fmu.SetReal(self->fmu.instance, (const fmi2ValueReference *)self->inputs,
                                           self->n_inputs, u),
                         "fmi2SetReal");
}

static void modelica_fmu_get(ModelicaFmu *self, double *y) {
    modelica_fmu_require(self->fmu.GetReal(self->fmu.instance, (const fmi2ValueReference *)self->outputs,
                                           self->n_outputs, y),
                         "fmi2GetReal");
}

/* Outputs y at the start time (s), in initialisation mode, where they follow the inputs u. */
static void modelica_fmu_start(void *object, double start, const double *u, double *y) {
    ModelicaFmu *self = object;
    if (self->steps) ModelicaError("outputs at the start: expected no step before");
    if (!self->begun) {
        modelica_fmu_require(
            self->fmu.SetupExperiment(self->fmu.instance, fmi2False, 0.0, start, fmi2False, 0.0),
            "fmi2SetupExperiment");
        modelica_fmu_require(self->fmu.EnterInitializationMode(self->fmu.instance),
                             "fmi2EnterInitializationMode");
        self->begun = 1;
    }
    modelica_fmu_set(self, u);
    modelica_fmu_get(self, y);
}

/* Outputs y after step number `step` (1, 2, ...) of h (s), over which the inputs u are held. */
static void modelica_fmu_step(void *object, double start, double h, int step, const double *u, double *y) {
    ModelicaFmu *self = object;
    double from = start + (step - 1) * h, to = start + step * h;
    if (step == self->steps + 1) {
        modelica_fmu_set(self, u);
        if (step == 1) {
            modelica_fmu_require(self->fmu.ExitInitializationMode(self->fmu.instance),
                                 "fmi2ExitInitializationMode");
        }
        modelica_fmu_require(self->fmu.DoStep(self->fmu.instance, from, to - from, fmi2True), "fmi2DoStep");
        self->steps = step;
    } else if (step != self->steps) {
        ModelicaFormatError("step %d after step %d: expected the same or the next", step, self->steps);
    }
    modelica_fmu_get(self, y);
}

static void modelica_fmu_close(void *object) {
    ModelicaFmu *self = object;
    if (!self) return;
    if (self->steps) self->fmu.Terminate(self->fmu.instance);
    fmu_unload(&self->fmu);
    free(self);
}

#endif
