/* Functions of FMI for saved states (2.1.8), in every state of the instance. */

#ifndef STATES_H
#define STATES_H

#include "refusals.h"
#include "snapshot.h"

static const Snapshot *own_snapshot(Instance *instance, fmi2FMUstate FMUstate, const char *function) {
    const Snapshot *snapshot = FMUstate;
    if (!instance) return NULL;
    if (snapshot && !strcmp(snapshot->guid, MODEL_GUID)) return snapshot;
    refuse(instance, fmi2Error, snapshot ? "%s: the state is another FMU's" : "%s: FMUstate is NULL", function);
    return NULL;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) {
    Instance *instance = c;
    Snapshot *snapshot;
    if (!instance) return fmi2Error;
    if (!FMUstate) return missing(instance, "fmi2GetFMUstate", "FMUstate");
    if (*FMUstate && !own_snapshot(instance, *FMUstate, "fmi2GetFMUstate")) return fmi2Error;
    snapshot = *FMUstate ? *FMUstate : calloc(1, sizeof *snapshot);
    if (!snapshot) return refuse(instance, fmi2Error, "fmi2GetFMUstate: no memory");
    memcpy(snapshot->guid, MODEL_GUID, sizeof snapshot->guid);
    snapshot->data = instance->data;
    *FMUstate = snapshot;
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate) {
    const Snapshot *snapshot = own_snapshot(c, FMUstate, "fmi2SetFMUstate");
    if (!snapshot) return fmi2Error;
    if (!snapshot->data.face != !((Instance *)c)->data.face)
        return refuse(c, fmi2Error, "fmi2SetFMUstate: the state is of the other interface");
    ((Instance *)c)->data = snapshot->data;
    ((Instance *)c)->step_cache.is_stale = 1;
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) {
    Instance *instance = c;
    if (!instance) return fmi2Error;
    if (!FMUstate || !*FMUstate) return fmi2OK; /* 2.1.8: ignored */
    free(*FMUstate);
    *FMUstate = NULL;
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size) {
    if (!own_snapshot(c, FMUstate, "fmi2SerializedFMUstateSize")) return fmi2Error;
    if (!size) return missing(c, "fmi2SerializedFMUstateSize", "size");
    *size = SERIALIZED_SIZE;
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[], size_t size) {
    const Snapshot *snapshot = own_snapshot(c, FMUstate, "fmi2SerializeFMUstate");
    if (!snapshot) return fmi2Error;
    if (!serializedState) return missing(c, "fmi2SerializeFMUstate", "serializedState");
    if (size < SERIALIZED_SIZE)
        return refuse(c, fmi2Error, "fmi2SerializeFMUstate: size %lu: expected %d", (unsigned long)size,
                      (int)SERIALIZED_SIZE);
    serialize(snapshot, (unsigned char *)serializedState);
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size,
                                   fmi2FMUstate *FMUstate) {
    Instance *instance = c;
    Snapshot restored;
    const char *reason;
    if (!instance) return fmi2Error;
    if (!serializedState) return missing(instance, "fmi2DeSerializeFMUstate", "serializedState");
    if (!FMUstate) return missing(instance, "fmi2DeSerializeFMUstate", "FMUstate");
    if (*FMUstate && !own_snapshot(instance, *FMUstate, "fmi2DeSerializeFMUstate")) return fmi2Error;
    reason = deserialize((const unsigned char *)serializedState, size, &restored);
    if (reason) return refuse(instance, fmi2Error, "fmi2DeSerializeFMUstate: %s", reason);
    if (!*FMUstate) *FMUstate = calloc(1, sizeof restored);
    if (!*FMUstate) return refuse(instance, fmi2Error, "fmi2DeSerializeFMUstate: no memory");
    *(Snapshot *)*FMUstate = restored;
    return fmi2OK;
}

#endif
