/* The communication loop, as orchestration/master/loop.py has it, function by function; read it there.

   Every member of Wiring is eight bytes wide: a count, an address, or a number that Python writes there. */

#include <math.h>
#include <stddef.h>
#include <stdint.h>

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

enum { HELD, BY_THE_FMU, AT_THE_MIDDLE };
enum { NOTHING, WRITE, SLOPES, STEP, READ, CONNECTION };
enum { RECORDED, FAILURE, WHO, WHICH, STATUS, BUSY, CALLS };
enum { OK, WARNING };

typedef char sixty_four_bits[sizeof(void *) == 8 ? 1 : -1];

typedef int ExchangeValues(void *instance, const void *references, size_t count, void *values);
typedef int SetDerivatives(void *instance, const void *references, size_t count, const void *orders,
                           const void *values);
typedef int DoStep(void *instance, double t, double h, int no_return_before_t);

typedef struct {
    const int64_t *first;
    const intptr_t *function, *references, *buffer;
    const int64_t *size, *place, *whole;
} Calls;

typedef struct {
    const int64_t *first, *source, *target, *giver, *fault, *carried;
    const double *low, *high;
    double *value, *slope, *stamp, *given, *interval;
    const double *reach;
} Links;

typedef struct {
    const int64_t *source;
    const double *addition;
    double *history;
} Faults;

typedef struct {
    int64_t n_points, n_components, n_links, n_signals, n_columns;
    int64_t gauss_seidel, whole_steps;
    const double *points;
    double *bus, *slopes;
    int32_t *whole;
    const void *orders;
    const intptr_t *instance, *do_step;
    const int64_t *period;
    const double *only_step;
    double *begun;
    const volatile int64_t *heard; /* written by the logger, in a call of an FMU */
    int64_t *warned;
    double *warned_at;
    Calls writes, derivatives, reads;
    Links links;
    Faults faults;
    const double *signals;
    const int64_t *signal_places, *record;
    double *rows;
    int64_t *report;
} Wiring;

/* A division takes longer than many a component of period 1. */
static int is_multiple(int64_t i, int64_t period) { return period == 1 || i % period == 0; }

static int accepted(Wiring *w, int call, int64_t c, int64_t which, int status) {
    w->report[BUSY] = 0;
    w->report[CALLS]++;
    if (status == OK && !w->heard[c]) return 1;
    if (status <= WARNING && !w->heard[c]) {
        if (w->warned[c] == NOTHING) {
            w->warned[c] = call;
            w->warned_at[c] = w->begun[c];
        }
        return 1;
    }
    w->report[FAILURE] = call;
    w->report[WHO] = c;
    w->report[WHICH] = which;
    w->report[STATUS] = status;
    return 0;
}

static int take(Wiring *w, int64_t k, int64_t i, double t, int given) {
    Links *links = &w->links;
    const int64_t fault = links->fault[k];
    double value = w->bus[links->source[k]];
    if (fault >= 0) {
        double *history = w->faults.history + fault * w->n_points;
        const int64_t origin = w->faults.source[fault * w->n_points + i];
        history[i] = value;
        value = w->faults.addition[fault * w->n_points + i];
        if (origin >= 0) value += history[origin];
    }
    if (links->carried[k] != HELD && given) {
        if (t > links->stamp[k]) {
            links->interval[k] = t - links->stamp[k];
            links->slope[k] = (value - links->given[k]) / links->interval[k];
            links->stamp[k] = t;
        }
        links->given[k] = value;
    }
    links->value[k] = value;
    w->bus[links->target[k]] = value;
    if (isfinite(value)) return 1;
    w->report[FAILURE] = CONNECTION;
    w->report[WHO] = -1;
    w->report[WHICH] = k;
    return 0;
}

EXPORT int loop_exchange(Wiring *w, int64_t i, double t, int on_point) {
    int fine = 1;
    const int last = i + 1 == w->n_points;
    for (int64_t k = 0; k < w->n_links; k++) {
        const int64_t giver = w->links.giver[k];
        const int faulty = w->links.fault[k] >= 0;
        const int given = giver < 0 || last || is_multiple(i, w->period[giver]);
        if ((faulty ? on_point : given) && !take(w, k, i, t, given)) fine = 0;
    }
    return fine;
}

EXPORT int loop_arrive(Wiring *w, int64_t i) {
    double *row = w->rows + i * w->n_columns;
    int fine;
    for (int64_t s = 0; s < w->n_signals; s++) w->bus[w->signal_places[s]] = w->signals[s * w->n_points + i];
    fine = loop_exchange(w, i, w->points[i], 1);
    for (int64_t column = 0; column < w->n_columns; column++) row[column] = w->bus[w->record[column]];
    w->report[RECORDED] = i + 1;
    return fine;
}

static int is_due(const Wiring *w, int64_t c, int64_t i) {
    return is_multiple(i + 1, w->period[c]) || i + 2 == w->n_points;
}

static int call(Wiring *w, const Calls *calls, int kind, int64_t c, int64_t g) {
    ExchangeValues *function = (ExchangeValues *)calls->function[g];
    int status;
    w->report[BUSY] = c + 1;
    status = function((void *)w->instance[c], (const void *)calls->references[g], (size_t)calls->size[g],
                      (void *)calls->buffer[g]);
    return accepted(w, kind, c, g, status);
}

static int write_inputs(Wiring *w, int64_t c, double t, double h) {
    const Links *links = &w->links;
    const Calls *calls = &w->writes;
    for (int64_t k = links->first[c]; k < links->first[c + 1]; k++) {
        double value = links->value[k], slope = links->slope[k], reach;
        if (links->carried[k] == HELD) continue; /* `take` has put it on the bus */
        reach = links->reach[k] * links->interval[k];
        if (h > reach) slope *= reach / h;
        value += slope * (t - links->stamp[k]);
        if (links->carried[k] == AT_THE_MIDDLE) {
            value += slope * (0.5 * h);
            if (value < links->low[k]) value = links->low[k];
            if (value > links->high[k]) value = links->high[k];
        }
        w->slopes[links->target[k]] = slope;
        w->bus[links->target[k]] = value;
    }
    for (int64_t g = calls->first[c]; g < calls->first[c + 1]; g++) {
        if (calls->whole[g] >= 0)
            for (int64_t j = 0; j < calls->size[g]; j++)
                w->whole[calls->whole[g] + j] = (int32_t)w->bus[calls->place[g] + j];
        if (!call(w, calls, WRITE, c, g)) return 0;
    }
    calls = &w->derivatives;
    for (int64_t g = calls->first[c]; g < calls->first[c + 1]; g++) {
        SetDerivatives *function = (SetDerivatives *)calls->function[g];
        int status;
        w->report[BUSY] = c + 1;
        status = function((void *)w->instance[c], (const void *)calls->references[g], (size_t)calls->size[g],
                          w->orders, (const void *)calls->buffer[g]);
        if (!accepted(w, SLOPES, c, g, status)) return 0;
    }
    return 1;
}

static int advance(Wiring *w, int64_t c, double end) {
    DoStep *function = (DoStep *)w->do_step[c];
    const double begun = w->begun[c];
    const double h = w->only_step[c] > 0.0 ? w->only_step[c] : end - begun;
    w->report[BUSY] = c + 1;
    return accepted(w, STEP, c, 0, function((void *)w->instance[c], begun, h, 1));
}

EXPORT int loop_read_outputs(Wiring *w, int64_t c) {
    const Calls *calls = &w->reads;
    for (int64_t g = calls->first[c]; g < calls->first[c + 1]; g++) {
        if (!call(w, calls, READ, c, g)) return 0;
        if (calls->whole[g] >= 0)
            for (int64_t j = 0; j < calls->size[g]; j++)
                w->bus[calls->place[g] + j] = w->whole[calls->whole[g] + j];
    }
    return 1;
}

static int begin(Wiring *w, int64_t c, int64_t i, double t, double end) {
    w->begun[c] = t;
    if (w->period[c] > 1) {
        const int64_t until = i + w->period[c], last = w->n_points - 1;
        end = w->points[until < last ? until : last];
    }
    return write_inputs(w, c, t, end - t);
}

static int jacobi(Wiring *w, int64_t i, double t, double end) {
    for (int64_t c = 0; c < w->n_components; c++)
        if (is_multiple(i, w->period[c]) && !begin(w, c, i, t, end)) return 0;
    for (int64_t c = 0; c < w->n_components; c++)
        if (is_due(w, c, i) && !advance(w, c, end)) return 0;
    for (int64_t c = 0; c < w->n_components; c++)
        if (is_due(w, c, i) && !loop_read_outputs(w, c)) return 0;
    return 1;
}

static int gauss_seidel(Wiring *w, int64_t i, double t, double end) {
    const int whole = w->whole_steps && t == w->points[i] && end == w->points[i + 1];
    for (int64_t c = 0; c < w->n_components; c++) {
        if (is_multiple(i, w->period[c])) w->begun[c] = t;
        if (!is_due(w, c, i)) continue;
        for (int64_t k = w->links.first[c]; k < w->links.first[c + 1]; k++) {
            const int64_t giver = w->links.giver[k];
            const int is_newer = 0 <= giver && giver < c && is_due(w, giver, i);
            if (is_newer && (whole || w->links.fault[k] < 0) && !take(w, k, i + 1, end, 1)) return 0;
        }
        if (!(write_inputs(w, c, w->begun[c], end - w->begun[c]) && advance(w, c, end) && loop_read_outputs(w, c)))
            return 0;
    }
    return 1;
}

EXPORT int loop_step(Wiring *w, int64_t i, double t, double end) {
    return w->gauss_seidel ? gauss_seidel(w, i, t, end) : jacobi(w, i, t, end);
}

EXPORT int64_t loop_run(Wiring *w, int64_t first, int64_t last) {
    for (int64_t i = first; i < last; i++)
        if (!(loop_arrive(w, i) && loop_step(w, i, w->points[i], w->points[i + 1]))) return i;
    return last;
}
