/* The communication loop. orchestration/fmpy_master.py is the algorithm without what this one adds; the twin of
   this file in Python, function by function, is tests/orchestration/python_loop.py. The structures are those of loop_data.py, whose docstrings explain their members.

   Every member of Wiring is eight bytes wide: a count, an address, or a number that Python writes there. But in
   WebAssembly no Python does, and addresses have four (orchestration/exchange/files/web_program.c). */

#define _POSIX_C_SOURCE 200809L

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#include <time.h>
#ifdef _WIN32
__declspec(dllimport) int __stdcall SwitchToThread(void);
__declspec(dllimport) int __stdcall QueryPerformanceCounter(int64_t *count);
__declspec(dllimport) int __stdcall QueryPerformanceFrequency(int64_t *frequency);
#define EXPORT __declspec(dllexport)
#else
#include <sched.h>
#define EXPORT __attribute__((visibility("default")))
#endif
#if defined(__x86_64__)
#include <xmmintrin.h>
#endif

enum { HOLD, FMU_DERIVATIVE, MIDPOINT };
enum { NO_FAILURE, SET_INPUTS, SET_DERIVATIVES, DO_STEP, GET_OUTPUTS, GET_STATE, SET_STATE, NOT_FINITE };
enum { RECORDED, FAILURE, COMPONENT, INDEX, STATUS, BUSY, CALLS, POSITION, TERMINATED, FORKED };
enum { OK, WARNING, DISCARD };
enum { LAST_SUCCESSFUL_TIME = 2, IS_TERMINATED = 3 };

#include "process_guard.h"

#ifndef __wasm__
typedef char sixty_four_bits[sizeof(void *) == 8 ? 1 : -1];
#endif

typedef int ExchangeValues(void *instance, const void *references, size_t count, void *values);
typedef int SetDerivatives(void *instance, const void *references, size_t count, const void *orders,
                           const void *values);
typedef int DoStep(void *instance, double start, double size, int no_return_before_start);
typedef int GetStatus(void *instance, int kind, void *value);
typedef int GetState(void *instance, void **state);
typedef int SetState(void *instance, void *state);

typedef struct {
    const int64_t *first;
    const intptr_t *function, *references, *buffer;
    const int64_t *size, *bus_index, *integer_index;
} Calls;

typedef struct {
    const int64_t *first, *source, *target, *source_component, *fault, *input_mode;
    const double *minimum, *maximum, *slope_validity, *factor, *offset;
    double *value, *slope, *sample_time, *sample, *sample_interval;
} Connections;

typedef struct {
    int64_t terms;
    const int64_t *source;
    const double *weight, *addition;
    double *history;
} Faults;

/* Threads that share the steps of the components between two points; orchestration/run/compiled_loop.py. The low half
   of `ticket` is the next component that nobody has taken, the high half counts the steps: a thread that is late by a
   step takes nothing. */
typedef struct {
    int64_t is_used, is_over;
    uint64_t ticket;
    int64_t done, point;
    double end;
} Team;

typedef struct {
    int64_t n_points, n_components, n_connections, n_signals, n_columns, n_memory;
    int64_t gauss_seidel, full_steps, independent;
    const double *points;
    double *bus, *slopes;
    int32_t *integers;
    const void *orders;
    double *memory;
    const intptr_t *instances, *do_step, *real_status, *boolean_status, *get_state, *set_state;
    const int64_t *periods;
    const double *fixed_step_size;
    double *step_start;
    const volatile int64_t *error_logged; /* written by the logger, in a call of an FMU */
    int64_t *warning;
    double *warning_time;
    Calls input_calls, derivative_calls, output_calls;
    Connections connections;
    Faults faults;
    const double *signal_values;
    const int64_t *signal_index, *record_index;
    double *rows;
    int64_t *report;
    int64_t *step_status;
    Team *team;
    double *step_times;
} Wiring;

/* Of what every step does: as long as a call of it. */
#define INLINED static inline __attribute__((always_inline))

/* At first without leaving the processor: other threads are expected within microseconds. */
static void wait_a_moment(int *waits) {
    enum { SHORT_WAITS = 2000 };
    if (*waits < SHORT_WAITS) {
        ++*waits;
#if defined(__x86_64__)
        _mm_pause();
#endif
        return;
    }
#ifdef _WIN32
    SwitchToThread();
#else
    sched_yield();
#endif
}

/* A division takes longer than many a component of period 1. */
INLINED int is_multiple(int64_t point, int64_t period) { return period == 1 || point % period == 0; }

INLINED int is_accepted(Wiring *wiring, int kind, int64_t c, int64_t index, int status) {
    if (!wiring->independent) guard_end_call(wiring->report);
    wiring->report[BUSY] = 0;
    wiring->report[CALLS]++;
    if ((status == OK || status == WARNING) && !wiring->error_logged[c]) {
        if (status != OK && wiring->warning[c] == NO_FAILURE) {
            wiring->warning[c] = kind;
            wiring->warning_time[c] = wiring->step_start[c];
        }
        return 1;
    }
    wiring->report[FAILURE] = kind;
    wiring->report[COMPONENT] = c;
    wiring->report[INDEX] = index;
    wiring->report[STATUS] = status;
    return 0;
}

INLINED int transfer(Wiring *wiring, int64_t k, int64_t point, double time, int is_new) {
    Connections *connections = &wiring->connections;
    Faults *faults = &wiring->faults;
    const int64_t fault = connections->fault[k];
    double value = wiring->bus[connections->source[k]] * connections->factor[k] + connections->offset[k];
    if (fault >= 0) {
        double *history = faults->history + fault * wiring->n_points;
        const int64_t row = fault * wiring->n_points + point;
        history[point] = value;
        value = faults->addition[row];
        for (int64_t term = row * faults->terms; term < (row + 1) * faults->terms; term++)
            if (faults->source[term] >= 0) value += faults->weight[term] * history[faults->source[term]];
    }
    if (connections->input_mode[k] != HOLD && is_new) {
        if (time > connections->sample_time[k]) {
            connections->sample_interval[k] = time - connections->sample_time[k];
            connections->slope[k] = (value - connections->sample[k]) / connections->sample_interval[k];
            connections->sample_time[k] = time;
        }
        connections->sample[k] = value;
    }
    connections->value[k] = value;
    wiring->bus[connections->target[k]] = value;
    if (isfinite(value)) return 1;
    wiring->report[FAILURE] = NOT_FINITE;
    wiring->report[COMPONENT] = -1;
    wiring->report[INDEX] = k;
    return 0;
}

EXPORT int loop_exchange(Wiring *wiring, int64_t point, double time, int on_point) {
    const Connections *connections = &wiring->connections;
    const int is_last = point + 1 == wiring->n_points;
    int is_finite = 1;
    for (int64_t k = 0; k < wiring->n_connections; k++) {
        const int64_t source = connections->source_component[k];
        const int has_fault = connections->fault[k] >= 0;
        const int is_new = source < 0 || is_multiple(point, wiring->periods[source]) || is_last;
        if ((has_fault ? on_point : is_new) && !transfer(wiring, k, point, time, is_new)) is_finite = 0;
    }
    return is_finite;
}

EXPORT int loop_exchange_and_record(Wiring *wiring, int64_t point) {
    double *row = wiring->rows + point * wiring->n_columns;
    int is_finite;
    for (int64_t signal = 0; signal < wiring->n_signals; signal++)
        wiring->bus[wiring->signal_index[signal]] = wiring->signal_values[signal * wiring->n_points + point];
    is_finite = loop_exchange(wiring, point, wiring->points[point], 1);
    for (int64_t column = 0; column < wiring->n_columns; column++)
        row[column] = wiring->bus[wiring->record_index[column]];
    wiring->report[RECORDED] = point + 1;
    return is_finite;
}

INLINED int ends_step(const Wiring *wiring, int64_t c, int64_t point) {
    return is_multiple(point + 1, wiring->periods[c]) || point + 2 == wiring->n_points;
}

INLINED int exchange_values(Wiring *wiring, const Calls *calls, int kind, int64_t c, int64_t g) {
    void *instance = (void *)wiring->instances[c], *buffer = (void *)calls->buffer[g];
    const void *references = (const void *)calls->references[g];
    const size_t size = (size_t)calls->size[g];
    int status;
    wiring->report[BUSY] = c + 1;
    if (kind == SET_DERIVATIVES)
        status = ((SetDerivatives *)calls->function[g])(instance, references, size, wiring->orders, buffer);
    else
        status = ((ExchangeValues *)calls->function[g])(instance, references, size, buffer);
    return is_accepted(wiring, kind, c, g, status);
}

static void extrapolate(Wiring *wiring, int64_t k, double start, double size) {
    const Connections *connections = &wiring->connections;
    const double longest = connections->slope_validity[k] * connections->sample_interval[k];
    double value = connections->value[k], slope = connections->slope[k];
    if (size > longest) slope *= longest / size;
    value += slope * (start - connections->sample_time[k]);
    if (connections->input_mode[k] == MIDPOINT) {
        value += slope * (0.5 * size);
        if (value < connections->minimum[k]) value = connections->minimum[k];
        if (value > connections->maximum[k]) value = connections->maximum[k];
    }
    wiring->slopes[connections->target[k]] = slope;
    wiring->bus[connections->target[k]] = value;
}

INLINED int write_inputs(Wiring *wiring, int64_t c, double start, double size) {
    const Connections *connections = &wiring->connections;
    const Calls *calls = &wiring->input_calls;
    for (int64_t k = connections->first[c]; k < connections->first[c + 1]; k++)
        if (connections->input_mode[k] != HOLD) extrapolate(wiring, k, start, size); /* else on the bus */
    for (int64_t g = calls->first[c]; g < calls->first[c + 1]; g++) {
        if (calls->integer_index[g] >= 0)
            for (int64_t j = 0; j < calls->size[g]; j++)
                wiring->integers[calls->integer_index[g] + j] = (int32_t)wiring->bus[calls->bus_index[g] + j];
        if (!exchange_values(wiring, calls, SET_INPUTS, c, g)) return 0;
    }
    calls = &wiring->derivative_calls;
    for (int64_t g = calls->first[c]; g < calls->first[c + 1]; g++)
        if (!exchange_values(wiring, calls, SET_DERIVATIVES, c, g)) return 0;
    return 1;
}

static int terminates_at(const Wiring *wiring, int64_t c, double end) {
    void *instance = (void *)wiring->instances[c];
    int32_t terminated = 0;
    double reached;
    if (((GetStatus *)wiring->boolean_status[c])(instance, IS_TERMINATED, &terminated) != OK || !terminated) return 0;
    if (((GetStatus *)wiring->real_status[c])(instance, LAST_SUCCESSFUL_TIME, &reached) != OK) return 0;
    return fabs(reached - end) <= 1e-9 * (end - wiring->step_start[c]);
}

/* Of a clock that never goes back [s]. */
static double wall_time(void) {
#ifdef _WIN32
    int64_t count = 0, frequency = 1;
    QueryPerformanceCounter(&count);
    QueryPerformanceFrequency(&frequency);
    return (double)count / (double)frequency;
#else
    struct timespec time = {0, 0};
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
#endif
}

/* CPU time of this thread [s]; of the clock above where that of a thread lacks, or ticks too seldom for a step. */
static double cpu_time(void) {
#if defined(_WIN32) || defined(__wasi__)
    return wall_time();
#else
    struct timespec time = {0, 0};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
#endif
}

static __attribute__((noinline)) int timed_step(const Wiring *wiring, int64_t c, double start, double size) {
    const double used = cpu_time(), before = wall_time();
    const int status = ((DoStep *)wiring->do_step[c])((void *)wiring->instances[c], start, size, 1);
    wiring->step_times[c] += 1.0;
    wiring->step_times[wiring->n_components + c] += wall_time() - before;
    wiring->step_times[2 * wiring->n_components + c] += cpu_time() - used;
    return status;
}

INLINED int call_step(const Wiring *wiring, int64_t c, double end) {
    const double start = wiring->step_start[c];
    const double size = wiring->fixed_step_size[c] > 0.0 ? wiring->fixed_step_size[c] : end - start;
    if (wiring->step_times) return timed_step(wiring, c, start, size);
    return ((DoStep *)wiring->do_step[c])((void *)wiring->instances[c], start, size, 1);
}

INLINED int finish_step(Wiring *wiring, int64_t c, double end, int status) {
    if (status == DISCARD && !wiring->error_logged[c] && terminates_at(wiring, c, end)) {
        wiring->report[TERMINATED] = c + 1;
        status = OK;
    }
    return is_accepted(wiring, DO_STEP, c, 0, status);
}

INLINED int do_step(Wiring *wiring, int64_t c, double end) {
    wiring->report[BUSY] = c + 1;
    return finish_step(wiring, c, end, call_step(wiring, c, end));
}

EXPORT int loop_read_outputs(Wiring *wiring, int64_t c) {
    const Calls *calls = &wiring->output_calls;
    for (int64_t g = calls->first[c]; g < calls->first[c + 1]; g++) {
        if (!exchange_values(wiring, calls, GET_OUTPUTS, c, g)) return 0;
        if (calls->integer_index[g] >= 0)
            for (int64_t j = 0; j < calls->size[g]; j++)
                wiring->bus[calls->bus_index[g] + j] = wiring->integers[calls->integer_index[g] + j];
    }
    return 1;
}

INLINED int start_step(Wiring *wiring, int64_t c, int64_t point, double start, double end) {
    wiring->step_start[c] = start;
    if (wiring->periods[c] > 1) {
        const int64_t until = point + wiring->periods[c], last = wiring->n_points - 1;
        end = wiring->points[until < last ? until : last];
    }
    return write_inputs(wiring, c, start, end - start);
}

/* The steps of the components that nobody has taken. */
static void take_steps(Wiring *wiring) {
    Team *team = wiring->team;
    uint64_t ticket = __atomic_load_n(&team->ticket, __ATOMIC_ACQUIRE);
    while ((int64_t)(uint32_t)ticket < wiring->n_components) {
        if (!__atomic_compare_exchange_n(&team->ticket, &ticket, ticket + 1, 0, __ATOMIC_ACQ_REL, __ATOMIC_ACQUIRE))
            continue;
        const int64_t c = (uint32_t)ticket;
        if (ends_step(wiring, c, team->point)) {
            wiring->step_status[c] = call_step(wiring, c, team->end);
            if (!wiring->independent) guard_end_call(wiring->report);
        }
        __atomic_add_fetch(&team->done, 1, __ATOMIC_RELEASE);
        ticket = __atomic_load_n(&team->ticket, __ATOMIC_ACQUIRE);
    }
}

/* All steps, on all threads, then their statuses in the order of the components. */
static int step_together(Wiring *wiring, int64_t point, double end) {
    Team *team = wiring->team;
    const int64_t count = wiring->n_components;
    wiring->report[BUSY] = count + 1;
    team->point = point;
    team->end = end;
    team->done = 0;
    __atomic_store_n(&team->ticket, ((team->ticket >> 32) + 1) << 32, __ATOMIC_RELEASE);
    take_steps(wiring);
    for (int waits = 0; __atomic_load_n(&team->done, __ATOMIC_ACQUIRE) < count;) wait_a_moment(&waits);
    wiring->report[BUSY] = 0;
    for (int64_t c = 0; c < count; c++)
        if (ends_step(wiring, c, point) && !finish_step(wiring, c, end, (int)wiring->step_status[c])) return 0;
    return 1;
}

/* Called by each other thread, until the loop ends. */
EXPORT void loop_help(Wiring *wiring) {
    const Team *team = wiring->team;
    uint64_t step = 0;
    guard_forget_forks();
    guard_end_call(wiring->report);
    for (int waits = 0; !__atomic_load_n(&team->is_over, __ATOMIC_ACQUIRE);) {
        take_steps(wiring);
        const uint64_t now = __atomic_load_n(&team->ticket, __ATOMIC_ACQUIRE) >> 32;
        waits = now == step ? waits : 0;
        step = now;
        wait_a_moment(&waits);
    }
}

static int jacobi_step(Wiring *wiring, int64_t point, double start, double end) {
    const int64_t count = wiring->n_components;
    for (int64_t c = 0; c < count; c++)
        if (is_multiple(point, wiring->periods[c]) && !start_step(wiring, c, point, start, end)) return 0;
    if (wiring->team->is_used) {
        if (!step_together(wiring, point, end)) return 0;
    } else {
        for (int64_t c = 0; c < count; c++)
            if (ends_step(wiring, c, point) && !do_step(wiring, c, end)) return 0;
    }
    for (int64_t c = 0; c < count; c++)
        if (ends_step(wiring, c, point) && !loop_read_outputs(wiring, c)) return 0;
    return 1;
}

static int gauss_seidel_step(Wiring *wiring, int64_t point, double start, double end) {
    const Connections *connections = &wiring->connections;
    const int is_full_step =
        wiring->full_steps && start == wiring->points[point] && end == wiring->points[point + 1];
    for (int64_t c = 0; c < wiring->n_components; c++) {
        if (is_multiple(point, wiring->periods[c])) wiring->step_start[c] = start;
        if (!ends_step(wiring, c, point)) continue;
        for (int64_t k = connections->first[c]; k < connections->first[c + 1]; k++) {
            const int64_t source = connections->source_component[k];
            const int is_newer = 0 <= source && source < c && ends_step(wiring, source, point);
            const int may_transfer = is_full_step || connections->fault[k] < 0;
            if (is_newer && may_transfer && !transfer(wiring, k, point + 1, end, 1)) return 0;
        }
        if (!(write_inputs(wiring, c, wiring->step_start[c], end - wiring->step_start[c]) &&
              do_step(wiring, c, end) && loop_read_outputs(wiring, c)))
            return 0;
    }
    return 1;
}

EXPORT int loop_step(Wiring *wiring, int64_t point, double start, double end) {
    return wiring->gauss_seidel ? gauss_seidel_step(wiring, point, start, end)
                                : jacobi_step(wiring, point, start, end);
}

EXPORT int loop_save(Wiring *wiring, void **saved) {
    memcpy(saved + wiring->n_components, wiring->memory, (size_t)wiring->n_memory * sizeof(double));
    for (int64_t c = 0; c < wiring->n_components; c++) {
        GetState *function = (GetState *)wiring->get_state[c];
        wiring->report[BUSY] = c + 1;
        if (!is_accepted(wiring, GET_STATE, c, 0, function((void *)wiring->instances[c], saved + c))) return 0;
    }
    return 1;
}

EXPORT int loop_restore(Wiring *wiring, void **saved) {
    memcpy(wiring->memory, saved + wiring->n_components, (size_t)wiring->n_memory * sizeof(double));
    for (int64_t c = 0; c < wiring->n_components; c++) {
        SetState *function = (SetState *)wiring->set_state[c];
        wiring->report[BUSY] = c + 1;
        if (!is_accepted(wiring, SET_STATE, c, 0, function((void *)wiring->instances[c], saved[c]))) return 0;
    }
    return 1;
}

EXPORT int64_t loop_run(Wiring *wiring, int64_t first, int64_t last) {
    for (int64_t point = first; point < last; point++) {
        if (!(loop_exchange_and_record(wiring, point) &&
              loop_step(wiring, point, wiring->points[point], wiring->points[point + 1])))
            return point;
        wiring->report[POSITION] = point + 1;
        if (wiring->report[TERMINATED]) return point + 1;
    }
    return last;
}
