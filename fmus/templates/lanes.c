/* Groups of instances of a native FMU that step together, each in a lane of its own.
 *
 * Compiled with variables.h and model.h of the FMU and with its equations for vectors, model_lanes.h. This is
 * data_step of instance.h for a group of LANES: what is refused there is a bit of the result here, and the values of that
 * lane have no meaning from then on. The other lanes do not notice.
 */

#include <float.h>
#include <limits.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

#include "variables.h"

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

enum { N_STEP_SIZES = 4 };

typedef double Lanes __attribute__((vector_size(8 * LANES)));
typedef int64_t Mask __attribute__((vector_size(8 * LANES))); /* of each lane all bits, or none */

#define EACH_LANE for (int lane = 0; lane < LANES; lane++)
#define INLINE static inline __attribute__((always_inline, unused))

/* Of a variable that a branch sets: it is chosen in the lanes that need the branch, and in these it was set. */
#define ANY(type) __builtin_nondeterministic_value((type){0})

INLINE Lanes all(double number) { return number - (Lanes){0}; } /* -0 stays -0 */
INLINE int any(Mask mask) { return __builtin_reduce_or(mask) != 0; }
INLINE Mask is_true(Lanes numbers) { return (Mask)(numbers != 0); }
INLINE Lanes choice(Mask mask, Lanes first, Lanes second) {
    return (Lanes)(((Mask)first & mask) | ((Mask)second & ~mask));
}
INLINE Lanes number(Mask mask) { return choice(mask, all(1), all(0)); }
INLINE Lanes sign(Lanes x) { return choice((Mask)(x < 0), all(-1), choice((Mask)(x > 0), all(1), x)); }

INLINE Lanes lanes_fabs(Lanes x) { return __builtin_elementwise_abs(x); }
INLINE Lanes lanes_sqrt(Lanes x) { return __builtin_elementwise_sqrt(x); }
INLINE Lanes lanes_floor(Lanes x) { return __builtin_elementwise_floor(x); }
INLINE Lanes lanes_ceil(Lanes x) { return __builtin_elementwise_ceil(x); }
INLINE Lanes lanes_copysign(Lanes x, Lanes y) { return __builtin_elementwise_copysign(x, y); }
INLINE Lanes lanes_fmin(Lanes x, Lanes y) { return __builtin_elementwise_min(x, y); }
INLINE Lanes lanes_fmax(Lanes x, Lanes y) { return __builtin_elementwise_max(x, y); }

/* Other functions are those of the C library, which the FMU calls. A call remembers its arguments and results, and
 * what has the same bits again is not computed again: an angle that stays, or a time constant. A compiler that sees the
 * argument would compute the result without that condition; constants it may see, as in the FMU. */
#define HIDE(x) \
    if (!__builtin_constant_p(x[0])) __asm__ volatile("" : "+m"(x))
#define DEFINE_FUNCTION(name)                           \
    INLINE Lanes lanes_##name(Lanes x, Lanes *memory) { \
        if (any((Mask)x != (Mask)memory[0])) {          \
            memory[0] = x;                              \
            HIDE(x);                                    \
            EACH_LANE x[lane] = name(x[lane]);          \
            memory[1] = x;                              \
        }                                               \
        return memory[1];                               \
    }
#define DEFINE_FUNCTION_OF_TWO(name)                                            \
    INLINE Lanes lanes_##name(Lanes x, Lanes y, Lanes *memory) {                \
        if (any(((Mask)x != (Mask)memory[0]) | ((Mask)y != (Mask)memory[1]))) { \
            memory[0] = x, memory[1] = y;                                       \
            HIDE(x);                                                            \
            HIDE(y);                                                            \
            EACH_LANE x[lane] = name(x[lane], y[lane]);                         \
            memory[2] = x;                                                      \
        }                                                                       \
        return memory[2];                                                       \
    }

DEFINE_FUNCTION(exp)
DEFINE_FUNCTION(expm1)
DEFINE_FUNCTION(log)
DEFINE_FUNCTION(log1p)
DEFINE_FUNCTION(sin)
DEFINE_FUNCTION(cos)
DEFINE_FUNCTION(tan)
DEFINE_FUNCTION(asin)
DEFINE_FUNCTION(acos)
DEFINE_FUNCTION(atan)
DEFINE_FUNCTION(sinh)
DEFINE_FUNCTION(cosh)
DEFINE_FUNCTION(tanh)
DEFINE_FUNCTION(asinh)
DEFINE_FUNCTION(acosh)
DEFINE_FUNCTION(atanh)
DEFINE_FUNCTION(erf)
DEFINE_FUNCTION_OF_TWO(pow)
DEFINE_FUNCTION_OF_TWO(atan2)
DEFINE_FUNCTION_OF_TWO(hypot)
DEFINE_FUNCTION_OF_TWO(remainder)

/* Exact, as fmod is. For whole numbers below 2^53 the rounded quotient is at most one too large, and the product and
 * the difference are whole numbers below 2^53, too. */
INLINE Lanes lanes_fmod(Lanes x, Lanes y, Lanes *memory) {
    const Mask is_whole = (Mask)(x == lanes_floor(x)) & (Mask)(y == lanes_floor(y));
    const Mask is_positive = (Mask)((Mask)x >= 0); /* -0 is not */
    const Mask is_quick = is_whole & is_positive & (Mask)(x < 0x1p53) & (Mask)(y >= 1) & (Mask)(y < 0x1p53);
    (void)memory;
    if (any(~is_quick)) {
        Lanes results;
        EACH_LANE results[lane] = fmod(x[lane], y[lane]);
        return results;
    }
    const Lanes rest = x - lanes_floor(x / y) * y;
    return choice((Mask)(rest < 0), rest + y, rest);
}

#define lanes_fmod_by_whole lanes_fmod

#include "model_lanes.h"

/* value: by value reference, as in `Data` of instance.h; state: the present one and the next, by turns;
 * constants: what steps of some sizes need of the parameters, since the sizes of a time grid differ by rounding. */
typedef struct {
    Lanes value[N_VARIABLES];
    Lanes state[2][N_STATES + 1];
    Lanes constants[N_STEP_SIZES][N_STEP_CONSTANTS + 1];
    Lanes memory[N_MEMORY + 1];
    double size_of_constants[N_STEP_SIZES]; /* s; NaN: of none */
    int64_t present, oldest_constants, parameters_are_stale;
} Group;

static const double MOST_INTERNAL_STEPS = 1e9;

static int64_t bits(Mask mask) {
    int64_t result = 0;
    if (any(mask)) EACH_LANE result |= (mask[lane] & 1) << lane;
    return result;
}

/* What the caller has to know: how many variables, states, and bytes of a group; its internal step; how many Reals take
 * whole numbers alone. */
EXPORT void lanes_sizes(int64_t sizes[5]) {
    int64_t known[] = {N_VARIABLES, N_STATES, sizeof(Group), INTERNAL_STEP, 0};
    for (int i = 0; i < N_VARIABLES; i++) known[4] += VARIABLES[i].whole;
    memcpy(sizes, known, sizeof known);
}

/* Of the FMU whose equations these are. */
EXPORT const char *lanes_guid(void) { return MODEL_GUID; }

/* Of new memory, before anything else: nothing is remembered yet. */
EXPORT void lanes_clear(Group *group) { memset(group->memory, 0xff, sizeof group->memory); } /* NaN of NaN */

/* What follows from the parameters. Lanes whose parameters contradict each other. */
static Mask calculate(Group *group) {
    Lanes holds[N_REQUIREMENTS + 1], *p = group->value, *c = p + FIRST_CALCULATED;
    Mask broken = {0};
    group->parameters_are_stale = 0;
    for (int i = 0; i < N_STEP_SIZES; i++) group->size_of_constants[i] = NAN;
    model_calculate(p, c, group->memory);
    model_requirements(p, c, holds, group->memory);
    for (int i = 0; i < N_REQUIREMENTS; i++) broken |= (Mask)(holds[i] != 1);
    for (int i = 0; i < N_CALCULATED; i++)
        if (VARIABLES[FIRST_CALCULATED + i].items || ACCESS[FIRST_CALCULATED + i].type == BOOLEAN)
            EACH_LANE broken[lane] |= -(int64_t)!is_item(FIRST_CALCULATED + i, c[i][lane]);
    return broken;
}

/* The next step begins with what follows from them, as that of the FMU. */
EXPORT void lanes_parameters_changed(Group *group) { group->parameters_are_stale = 1; }

static const Lanes *constants_of(Group *group, double internal) {
    for (int i = 0; i < N_STEP_SIZES; i++)
        if (group->size_of_constants[i] == internal) return group->constants[i];
    const int64_t i = group->oldest_constants;
    group->oldest_constants = (i + 1) % N_STEP_SIZES;
    group->size_of_constants[i] = internal;
    model_step_constants(internal, group->value, group->value + FIRST_CALCULATED, group->constants[i], group->memory);
    return group->constants[i];
}

/* Lanes of which a number is not finite, or an output none of its items. */
static Mask refused(const Lanes *state, const Lanes *outputs) {
    Lanes sum = {0};
    Mask bad = {0};
    for (int i = 0; i < N_STATES; i++) sum += state[i];
    for (int i = 0; i < N_OUTPUTS; i++) sum += outputs[i];
    if (any((Mask)(sum - sum != 0))) { /* a number may not be finite */
        for (int i = 0; i < N_STATES; i++) bad |= (Mask)(state[i] - state[i] != 0);
        for (int i = 0; i < N_OUTPUTS; i++) bad |= (Mask)(outputs[i] - outputs[i] != 0);
    }
    for (int i = 0; i < N_WHOLE_OUTPUTS; i++) {
        const int output = WHOLE_OUTPUTS[i];
        bad |= (Mask)(lanes_fabs(outputs[output]) > INT_MAX);
        EACH_LANE bad[lane] |= -(int64_t)!is_item(FIRST_OUTPUT + output, outputs[output][lane]);
    }
    return bad;
}

/* Initial states and outputs at a time [s], from parameters and inputs. The lanes that are refused, as bits. */
EXPORT int64_t lanes_initialize(Group *group, double time) {
    const Lanes *p = group->value, *c = p + FIRST_CALCULATED, *u = p + FIRST_INPUT;
    Lanes *outputs = group->value + FIRST_OUTPUT;
    const Mask broken = calculate(group);
    group->present = 0;
    model_initial_state(time, u, p, c, group->state[0], group->memory);
    model_output(time, group->state[0], p, c, outputs, group->memory);
    return bits(broken | refused(group->state[0], outputs));
}

/* From start to start + size [s], in equal internal steps; inputs are held. The lanes that are refused, as bits. */
EXPORT int64_t lanes_step(Group *group, double start, double size) {
    const Lanes *p = group->value, *c = p + FIRST_CALCULATED, *u = p + FIRST_INPUT;
    Lanes *outputs = group->value + FIRST_OUTPUT;
    const Mask broken = group->parameters_are_stale ? calculate(group) : (Mask){0};
    const double steps = size / p[INTERNAL_STEP][0] * (1 - 1e-9);
    if (!(steps <= MOST_INTERNAL_STEPS)) return -1;
    const int count = steps <= 1 ? 1 : (int)ceil(steps);
    const double internal = size / count;
    const Lanes *k = constants_of(group, internal), *next = NULL;
    for (int i = 0; i < count; i++) {
        const Lanes *x = group->state[group->present];
        group->present = !group->present;
        model_step(start + i * internal, internal, x, u, p, c, k, group->state[group->present], group->memory);
    }
    next = group->state[group->present];
    model_output(start + size, next, p, c, outputs, group->memory);
    return bits(broken | refused(next, outputs));
}
