/* Loading an FMU's library and binding its functions, on Windows and elsewhere. */

#ifndef LOAD_H
#define LOAD_H

#include <stdio.h>
#include <stdlib.h>

#ifdef _WIN32
#include <windows.h>
#else
#include <dlfcn.h>
#endif

#include "fmi2Functions.h"

#define FMU_FUNCTIONS(X)                                                                                      \
    X(Instantiate) X(FreeInstance) X(SetupExperiment) X(EnterInitializationMode) X(ExitInitializationMode)    \
    X(Terminate) X(Reset) X(GetReal) X(SetReal) X(SetInteger) X(SetBoolean) X(DoStep) X(GetFMUstate)          \
    X(SetFMUstate) X(FreeFMUstate) X(SerializedFMUstateSize) X(SerializeFMUstate) X(DeSerializeFMUstate)

typedef struct {
    void *library;
    fmi2Component instance;
#define DECLARE(name) fmi2##name##TYPE *name;
    FMU_FUNCTIONS(DECLARE)
#undef DECLARE
} Fmu;

static void *library_open(const char *path) {
#ifdef _WIN32
    return (void *)LoadLibraryA(path);
#else
    return dlopen(path, RTLD_NOW | RTLD_LOCAL);
#endif
}

static void *library_symbol(void *library, const char *name) {
#ifdef _WIN32
    return (void *)GetProcAddress((HMODULE)library, name);
#else
    return dlsym(library, name);
#endif
}

static void library_close(void *library) {
#ifdef _WIN32
    FreeLibrary((HMODULE)library);
#else
    dlclose(library);
#endif
}

/* 1 if the library was loaded and has every function. */
static int fmu_load(Fmu *fmu, const char *path) {
    int found = 1;
    fmu->instance = NULL;
    fmu->library = library_open(path);
    if (!fmu->library) return 0;
#define BIND(name) found &= (*(void **)&fmu->name = library_symbol(fmu->library, "fmi2" #name)) != NULL;
    FMU_FUNCTIONS(BIND)
#undef BIND
    return found;
}

static void print_message(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status,
                          fmi2String category, fmi2String message, ...) {
    (void)environment;
    fprintf(stderr, "%s: status %d, %s: %s\n", instance, (int)status, category, message);
}

/* The importer's callbacks must outlive the instance. */
static const fmi2CallbackFunctions CALLBACKS = {print_message, calloc, free, NULL, NULL};

static inline fmi2Component fmu_instantiate(const Fmu *fmu, const char *name, const char *guid) {
    return fmu->Instantiate(name, fmi2CoSimulation, guid, "file:///", &CALLBACKS, fmi2False, fmi2True);
}

static void fmu_unload(Fmu *fmu) {
    if (fmu->instance) fmu->FreeInstance(fmu->instance);
    library_close(fmu->library);
}

#endif
