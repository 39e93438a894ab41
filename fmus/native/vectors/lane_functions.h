/* Vectors of doubles, a lane for each instance, and functions of them with the bits of the C library. */

typedef double Lanes __attribute__((vector_size(8 * LANES)));
typedef int64_t Mask __attribute__((vector_size(8 * LANES))); /* of each lane all bits, or none */

#define EACH_LANE for (int lane = 0; lane < LANES; lane++)
#define INLINE static inline __attribute__((always_inline, unused))

/* Of a variable that a branch sets: it is chosen in the lanes that need the branch, and in these it was set. */
#define ANY __builtin_nondeterministic_value((Lanes){0})

INLINE Lanes all(double number) { return number - (Lanes){0}; } /* -0 stays -0 */
INLINE int any(Mask mask) { return __builtin_reduce_or(mask) != 0; }
INLINE unsigned bits(Mask mask) {
    typedef _Bool Bits __attribute__((ext_vector_type(LANES)));
    unsigned result = 0;
    const Bits lanes = __builtin_convertvector(mask, Bits);
    memcpy(&result, &lanes, sizeof lanes);
    return result;
}
INLINE Mask is_true(Lanes numbers) { return (Mask)(numbers != 0); }
INLINE Mask is_false(Lanes numbers) { return (Mask)(numbers == 0); }
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
INLINE Lanes lanes_smaller(Lanes x, Lanes y) { return choice((Mask)(y != y), x, choice((Mask)(x < y), x, y)); }
INLINE Lanes lanes_larger(Lanes x, Lanes y) { return choice((Mask)(y != y), x, choice((Mask)(x > y), x, y)); }

/* For other functions, the C library is called lane by lane, as in the FMU; sin and cos follow below. A call stores its
 * arguments and results: equal bits, such as a constant angle or a time constant, are not computed again. A compiler
 * that sees the argument would compute the result without that condition; constants it may see, as in the FMU. */
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
#include "lane_sine.h"

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
