/* Functions of FMI 3.0 for features that the model does not have. Functions for a type without variables, and for
 * derivatives of outputs, accept only an empty list. */

#ifndef ABSENT_H
#define ABSENT_H

#include "values.h"

static Status absent(Instance *instance, const char *function, const char *reason) {
    return instance ? refuse(instance, ERROR, "%s: " MODEL_NAME " has no %s", function, reason) : ERROR;
}

static Status no_variables(Instance *instance, int modes, size_t count, const char *function, const char *type) {
    if (!is_allowed(instance, modes, function)) return ERROR;
    return count ? absent(instance, function, type) : OK;
}

/* 2.2.7.2: functions of a type without variables. */
#define ABSENT_TYPE(Name)                                                                                             \
    fmi3Status fmi3Get##Name(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, fmi3##Name values[],          \
                             size_t n) {                                                                              \
        (void)vr, (void)values;                                                                                       \
        return no_variables(c, READABLE, nvr | n, "fmi3Get" #Name, #Name " variables");                               \
    }                                                                                                                 \
    fmi3Status fmi3Set##Name(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, const fmi3##Name values[],    \
                             size_t n) {                                                                              \
        (void)vr, (void)values;                                                                                       \
        return no_variables(c, ALWAYS, nvr | n, "fmi3Set" #Name, #Name " variables");                                 \
    }

ABSENT_TYPE(Float32)
ABSENT_TYPE(Int8)
ABSENT_TYPE(UInt8)
ABSENT_TYPE(Int16)
ABSENT_TYPE(UInt16)
ABSENT_TYPE(UInt32)
ABSENT_TYPE(UInt64)
ABSENT_TYPE(String)

/* 2.2.7.2. */
fmi3Status fmi3GetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, size_t sizes[],
                         fmi3Binary values[], size_t n) {
    (void)vr, (void)sizes, (void)values;
    return no_variables(c, READABLE, nvr | n, "fmi3GetBinary", "Binary variables");
}

/* 2.2.7.2. */
fmi3Status fmi3SetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, const size_t sizes[],
                         const fmi3Binary values[], size_t n) {
    (void)vr, (void)sizes, (void)values;
    return no_variables(c, ALWAYS, nvr | n, "fmi3SetBinary", "Binary variables");
}

/* 4.2.1: maxOutputDerivativeOrder is 0. */
fmi3Status fmi3GetOutputDerivatives(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr,
                                    const fmi3Int32 orders[], fmi3Float64 values[], size_t n) {
    static const char *const function = "fmi3GetOutputDerivatives";
    (void)vr, (void)orders, (void)values;
    if (!is_of(c, CO_SIMULATION, function)) return fmi3Error;
    return no_variables(c, HAS_STEPPED | UPDATE_OF_OUTPUTS, nvr | n, function, "derivatives of outputs");
}

/* A function that the model has no use for. */
#define ABSENT(Name, reason, parameters, unused)                              \
    fmi3Status fmi3##Name parameters {                                        \
        unused;                                                               \
        return absent(c, "fmi3" #Name, reason);                               \
    }
#define OF_CLOCKS fmi3Instance c, const fmi3ValueReference vr[], size_t nvr
#define CLOCK_FUNCTION(Name, Values, More) \
    ABSENT(Name, "clocks", (OF_CLOCKS, Values first[], More second[]), ((void)vr, (void)nvr, (void)first, (void)second))
#define SHORT_CLOCK_FUNCTION(Name, Values) \
    ABSENT(Name, "clocks", (OF_CLOCKS, Values first[]), ((void)vr, (void)nvr, (void)first))

/* 2.2.8: clocks. */
SHORT_CLOCK_FUNCTION(GetClock, fmi3Clock)
SHORT_CLOCK_FUNCTION(SetClock, const fmi3Clock)
SHORT_CLOCK_FUNCTION(GetShiftDecimal, fmi3Float64)
SHORT_CLOCK_FUNCTION(SetShiftDecimal, const fmi3Float64)
SHORT_CLOCK_FUNCTION(SetIntervalDecimal, const fmi3Float64)
CLOCK_FUNCTION(GetShiftFraction, fmi3UInt64, fmi3UInt64)
CLOCK_FUNCTION(SetShiftFraction, const fmi3UInt64, const fmi3UInt64)
CLOCK_FUNCTION(SetIntervalFraction, const fmi3UInt64, const fmi3UInt64)
CLOCK_FUNCTION(GetIntervalDecimal, fmi3Float64, fmi3IntervalQualifier)
ABSENT(GetIntervalFraction, "clocks",
       (OF_CLOCKS, fmi3UInt64 counters[], fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[]),
       ((void)vr, (void)nvr, (void)counters, (void)resolutions, (void)qualifiers))

/* 2.3.5, 2.3.6, 5.2.1: modes and interfaces. */
ABSENT(EnterConfigurationMode, "structural parameters", (fmi3Instance c), (void)0)
ABSENT(ExitConfigurationMode, "structural parameters", (fmi3Instance c), (void)0)
ABSENT(EnterStepMode, "event mode of co-simulation", (fmi3Instance c), (void)0)
ABSENT(EvaluateDiscreteStates, "discrete states to evaluate", (fmi3Instance c), (void)0)
ABSENT(ActivateModelPartition, "model partitions",
       (fmi3Instance c, fmi3ValueReference clockReference, fmi3Float64 activationTime),
       ((void)clockReference, (void)activationTime))

/* 2.2.9: dependencies of elements; the model description has the dependencies of variables. */
ABSENT(GetNumberOfVariableDependencies, "dependencies of elements",
       (fmi3Instance c, fmi3ValueReference reference, size_t *nDependencies), ((void)reference, (void)nDependencies))
ABSENT(GetVariableDependencies, "dependencies of elements",
       (fmi3Instance c, fmi3ValueReference dependent, size_t elementIndicesOfDependent[],
        fmi3ValueReference independents[], size_t elementIndicesOfIndependents[],
        fmi3DependencyKind dependencyKinds[], size_t nDependencies),
       ((void)dependent, (void)elementIndicesOfDependent, (void)independents, (void)elementIndicesOfIndependents,
        (void)dependencyKinds, (void)nDependencies))

#endif
