/* A saved state, in memory and as bytes.
 *
 * Bytes: magic, format, GUID, the words of `Data` and a checksum, little-endian on every platform, so that
 * a state saved on one host can be restored on another. Damaged bytes and bytes of another FMU are refused.
 * The stop time is no part of a state: the importer sets it once for each instance.
 */

#ifndef SNAPSHOT_H
#define SNAPSHOT_H

#include "instance.h"

typedef struct {
    char guid[sizeof MODEL_GUID];
    Data data;
} Snapshot;

enum {
    FORMAT = 3,
    N_WORDS = sizeof(Data) / 8,
    MAGIC_SIZE = 8,
    GUID_PLACE = MAGIC_SIZE + 8,
    GUID_SIZE = sizeof MODEL_GUID - 1,
    WORDS_PLACE = GUID_PLACE + GUID_SIZE,
    CHECKSUM_PLACE = WORDS_PLACE + 8 * N_WORDS,
    SERIALIZED_SIZE = CHECKSUM_PLACE + 8
};

static const char MAGIC[MAGIC_SIZE + 1] = "L1-STATE";

static void put_u64(unsigned char *bytes, uint64_t number) {
    for (int i = 0; i < 8; i++) bytes[i] = (unsigned char)(number >> (8 * i));
}

static uint64_t get_u64(const unsigned char *bytes) {
    uint64_t number = 0;
    for (int i = 0; i < 8; i++) number |= (uint64_t)bytes[i] << (8 * i);
    return number;
}

/* FNV-1a over everything before the checksum. */
static uint64_t checksum(const unsigned char *bytes) {
    uint64_t hash = 14695981039346656037u;
    for (size_t i = 0; i < CHECKSUM_PLACE; i++) hash = (hash ^ bytes[i]) * 1099511628211u;
    return hash;
}

static void serialize(const Snapshot *snapshot, unsigned char *bytes) {
    const unsigned char *words = (const unsigned char *)&snapshot->data;
    memcpy(bytes, MAGIC, MAGIC_SIZE);
    put_u64(bytes + MAGIC_SIZE, FORMAT);
    memcpy(bytes + GUID_PLACE, snapshot->guid, GUID_SIZE);
    for (int i = 0; i < N_WORDS; i++) {
        uint64_t word;
        memcpy(&word, words + 8 * i, sizeof word);
        put_u64(bytes + WORDS_PLACE + 8 * i, word);
    }
    put_u64(bytes + CHECKSUM_PLACE, checksum(bytes));
}

static int is_flag(int64_t word) { return word == 0 || word == 1; }

/* Whether an instance could have this state. */
static OUTLINED int is_consistent(const Data *d) {
    int good = d->mode >= INSTANTIATED && d->mode <= CONTINUOUS_TIME && (d->mode & (d->mode - 1)) == 0;
    good = good && d->face >= CO_SIMULATION && d->face <= EXCHANGE;
    good = good && (d->mode & (EVENT | CONTINUOUS_TIME) ? d->face == EXCHANGE
                    : d->mode == STEPPING                        ? d->face == CO_SIMULATION
                    : d->mode & (INSTANTIATED | INITIALIZATION) ? d->face != EXCHANGE
                                                                 : 1);
    good = good && d->n_steps >= 0 && d->n_steps < 1LL << 53 && isfinite(d->start_time); /* steps are counted as doubles too */
    for (int i = 0; i < N_INPUTS; i++)
        good = good && (d->held[i] == 0 || is_acceptable(FIRST_INPUT + i, d->held[i]));
    good = good && isfinite(d->time);
    good = good && is_flag(d->parameters_are_stale) && is_flag(d->outputs_are_stale);
    good = good && is_flag(d->inputs_have_rates);
    good = good && are_finite(d->input_rate, N_INPUTS);
    good = good && can_be_read(d->value + FIRST_OUTPUT);
    for (int i = 0; i < N_VALUES; i++)
        good = good && (is_settable(i) ? is_acceptable(i, d->value[i]) : is_item(i, d->value[i]));
    return good;
}

/* The error in the bytes; or NULL, and `snapshot` holds their state. */
static const char *deserialize(const unsigned char *bytes, size_t size, Snapshot *snapshot) {
    unsigned char *words = (unsigned char *)&snapshot->data;
    if (size < WORDS_PLACE || memcmp(bytes, MAGIC, MAGIC_SIZE)) return "these bytes are not a serialized state";
    if (get_u64(bytes + MAGIC_SIZE) != FORMAT) return "the state has another version's format";
    if (memcmp(bytes + GUID_PLACE, MODEL_GUID, GUID_SIZE)) return "the state is another FMU's";
    if (size != SERIALIZED_SIZE) return "the state has the wrong size";
    if (get_u64(bytes + CHECKSUM_PLACE) != checksum(bytes)) return "the state is damaged";
    memcpy(snapshot->guid, MODEL_GUID, sizeof snapshot->guid);
    for (int i = 0; i < N_WORDS; i++) {
        const uint64_t word = get_u64(bytes + WORDS_PLACE + 8 * i);
        memcpy(words + 8 * i, &word, sizeof word);
    }
    return is_consistent(&snapshot->data) ? NULL : "this FMU cannot have such a state";
}

#endif
