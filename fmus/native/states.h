/* Functions of FMI for saved states (2.1.8), in every state of the instance but inside a step. */

#ifndef STATES_H
#define STATES_H

#include "refusals.h"
#include "snapshot.h"

static OUTLINED const Snapshot *own_snapshot(Instance *instance, void *FMUState, const char *function) {
    const Snapshot *snapshot = FMUState;
    if (!is_allowed(instance, OUTSIDE_STEPS, function)) return NULL;
    if (snapshot && !strcmp(snapshot->guid, MODEL_GUID)) return snapshot;
    refuse(instance, ERROR, snapshot ? "%s: the state is another FMU's" : "%s: " TEXT(FMUState) " is NULL", function);
    return NULL;
}

/* 2.1.8. Whether every state is in its range; the message names the first that is not. */
static OUTLINED int are_in_range(Instance *instance, const double *state, const char *function) {
    for (int i = 0; i < N_STATES; i++) {
        const Variable *v = VARIABLES + N_VARIABLES + i;
        if (is_acceptable(N_VARIABLES + i, state[i])) continue;
        refuse(instance, ERROR, "%s: %s = %s: expected %s", function, v->name, DECIMAL(state[i]), v->expected);
        return 0;
    }
    return 1;
}

Status FMI(GetFMUState)(void *c, void **FMUState) {
    Instance *instance = c;
    Snapshot *snapshot;
    if (!is_allowed(instance, OUTSIDE_STEPS, NAME(GetFMUState))) return ERROR;
    if (!FMUState) return missing(instance, NAME(GetFMUState), TEXT(FMUState));
    if (*FMUState && !own_snapshot(instance, *FMUState, NAME(GetFMUState))) return ERROR;
    snapshot = *FMUState ? *FMUState : calloc(1, sizeof *snapshot);
    if (!snapshot) return refuse(instance, ERROR, NAME(GetFMUState) ": no memory");
    memcpy(snapshot->guid, MODEL_GUID, sizeof snapshot->guid);
    snapshot->data = instance->data;
    *FMUState = snapshot;
    return OK;
}

Status FMI(SetFMUState)(void *c, void *FMUState) {
    const Snapshot *snapshot = own_snapshot(c, FMUState, NAME(SetFMUState));
    if (!snapshot) return ERROR;
    if (!snapshot->data.face != !((Instance *)c)->data.face)
        return refuse(c, ERROR, NAME(SetFMUState) ": the state is of the other interface");
    if (!are_in_range(c, snapshot->data.state, NAME(SetFMUState))) return ERROR;
    ((Instance *)c)->data = snapshot->data;
    ((Instance *)c)->step_cache.is_stale = 1;
    return OK;
}

Status FMI(FreeFMUState)(void *c, void **FMUState) {
    Instance *instance = c;
    if (!is_allowed(instance, OUTSIDE_STEPS, NAME(FreeFMUState))) return ERROR;
    if (!FMUState || !*FMUState) return OK; /* 2.1.8: ignored */
    free(*FMUState);
    *FMUState = NULL;
    return OK;
}

Status FMI(SerializedFMUStateSize)(void *c, void *FMUState, size_t *size) {
    if (!own_snapshot(c, FMUState, NAME(SerializedFMUStateSize))) return ERROR;
    if (!size) return missing(c, NAME(SerializedFMUStateSize), "size");
    *size = SERIALIZED_SIZE;
    return OK;
}

Status FMI(SerializeFMUState)(void *c, void *FMUState, FMI(Byte) serializedState[], size_t size) {
    const Snapshot *snapshot = own_snapshot(c, FMUState, NAME(SerializeFMUState));
    if (!snapshot) return ERROR;
    if (!serializedState) return missing(c, NAME(SerializeFMUState), "serializedState");
    if (size < SERIALIZED_SIZE)
        return refuse(c, ERROR, NAME(SerializeFMUState) ": size %lu: expected %d", (unsigned long)size,
                      (int)SERIALIZED_SIZE);
    serialize(snapshot, (unsigned char *)serializedState);
    return OK;
}

Status FMI(DeserializeFMUState)(void *c, const FMI(Byte) serializedState[], size_t size,
                                   void **FMUState) {
    Instance *instance = c;
    Snapshot restored;
    const char *reason;
    if (!is_allowed(instance, OUTSIDE_STEPS, NAME(DeserializeFMUState))) return ERROR;
    if (!serializedState) return missing(instance, NAME(DeserializeFMUState), "serializedState");
    if (!FMUState) return missing(instance, NAME(DeserializeFMUState), TEXT(FMUState));
    if (*FMUState && !own_snapshot(instance, *FMUState, NAME(DeserializeFMUState))) return ERROR;
    reason = deserialize((const unsigned char *)serializedState, size, &restored);
    if (reason) return refuse(instance, ERROR, NAME(DeserializeFMUState) ": %s", reason);
    if (!are_in_range(instance, restored.data.state, NAME(DeserializeFMUState))) return ERROR;
    if (!*FMUState) *FMUState = calloc(1, sizeof restored);
    if (!*FMUState) return refuse(instance, ERROR, NAME(DeserializeFMUState) ": no memory");
    *(Snapshot *)*FMUState = restored;
    return OK;
}

#endif
