/* sin and cos of all lanes at once, with the bits of the C library.
 *
 * A result of glibc differs from the exact number by less than 0.55 of its last place, one of cos by less than 0.52
 * (sysdeps/ieee754/dbl-64/s_sin.c). Here that number is high + low to 0.006 of the last place of `high`, the double next
 * to it. Where `low` is below 0.44 of that place, 0.47 for cos, the doubles on both sides of it are farther away than
 * that, and `high` is the result of glibc. A power of two has the double below at half the distance, and is left out.
 * In the other lanes, every eighth or sixteenth, glibc is called. The arithmetic uses pairs of doubles (Dekker 1971),
 * which needs the instruction of a fused product. */

#if defined(__GLIBC__) && defined(__FMA__)

INLINE Lanes lanes_fma(Lanes x, Lanes y, Lanes z) { return __builtin_elementwise_fma(x, y, z); }

/* first + second = result + rest, where the first one is the larger. */
INLINE Lanes two_sum(Lanes first, Lanes second, Lanes *rest) {
    const Lanes result = first + second;
    *rest = first - result + second;
    return result;
}

/* first * second = result + rest */
INLINE Lanes two_product(Lanes first, Lanes second, Lanes *rest) {
    const Lanes result = first * second;
    *rest = lanes_fma(first, second, -result);
    return result;
}

enum { N_TERMS = 7, N_SMALL_TERMS = 4 };

INLINE Lanes polynomial(Lanes x, const double *coefficients, int count) {
    Lanes result = all(coefficients[0]);
    for (int i = 1; i < count; i++) result = lanes_fma(result, x, all(coefficients[i]));
    return result;
}

/* sin(x + rest) = result + low, |x| <= pi / 4, by Taylor's series; square + square_rest = (x + rest)^2. */
INLINE Lanes sin_kernel(Lanes x, Lanes rest, Lanes square, Lanes square_rest, Lanes *low) {
    static const double coefficients[N_TERMS] = {1 / 355687428096000., -1 / 1307674368000., 1 / 6227020800.,
                                                 -1 / 39916800.,       1 / 362880.,         -1 / 5040.,
                                                 1 / 120.};
    Lanes inner_rest, outer_rest, last;
    const Lanes more_terms = square * polynomial(square, coefficients, N_TERMS);
    const Lanes inner = two_sum(all(-0x1.5555555555555p-3), more_terms, &inner_rest);
    const Lanes outer = two_product(square, inner, &outer_rest);
    const Lanes more = two_product(x, outer, &last);
    const Lanes result = two_sum(x, more, low);
    inner_rest += -0x1.5555555555555p-57; /* of -1/6 */
    outer_rest += square * inner_rest + square_rest * inner;
    *low += last + (x * outer_rest + (rest + rest * outer));
    return result;
}

/* cos of the same */
INLINE Lanes cos_kernel(Lanes square, Lanes square_rest, Lanes *low) {
    static const double coefficients[N_TERMS] = {1 / 6402373705728000., -1 / 20922789888000., 1 / 87178291200.,
                                                 -1 / 479001600.,       1 / 3628800.,         -1 / 40320.,
                                                 1 / 720.};
    Lanes inner_rest, outer_rest, last, first_rest;
    const Lanes more_terms = -(square * polynomial(square, coefficients, N_TERMS));
    const Lanes inner = two_sum(all(0x1.5555555555555p-5), more_terms, &inner_rest);
    const Lanes outer = two_product(square, inner, &outer_rest);
    const Lanes more = two_product(square, outer, &last);
    const Lanes first = two_sum(all(1), square * -0.5, &first_rest);
    const Lanes result = two_sum(first, more, low);
    inner_rest += 0x1.5555555555555p-59; /* of 1/24 */
    outer_rest += square * inner_rest + square_rest * inner;
    *low += first_rest + (last + (square * outer_rest + square_rest * (outer - 0.5)));
    return result;
}

/* Where `low`, made larger by a factor, is below half of the last place of `high`. */
INLINE Mask is_certain(Lanes high, Lanes low, double factor) {
    const Mask is_power_of_two = (Mask)(((Mask)high << 12) == 0);
    return (Mask)(high + low * factor == high) & ~is_power_of_two;
}

/* sin(x), |x| < 2^-4, and the lanes where it is certain. The terms after x are below 2^-10 of it, so their roundings, four
 * here and four in glibc, are together below 0.007 of the last place of the result. */
INLINE Mask small_sin(Lanes x, Lanes *result) {
    static const double coefficients[N_SMALL_TERMS] = {1 / 362880., -1 / 5040., 1 / 120., -1 / 6.};
    const Lanes square = x * x;
    Lanes low;
    *result = two_sum(x, x * (square * polynomial(square, coefficients, N_SMALL_TERMS)), &low);
    return is_certain(*result, low, 1.015625);
}

/* sin(x + quarters pi / 2), and the lanes where it is certain. Of pi / 2 there are two doubles. x less a multiple of the
 * first one is exact; what lacks in the second one is below 2^-66 of the difference, for the x and differences that are
 * let through. */
INLINE Mask turned_sin(Lanes x, int quarters, Lanes *result) {
    static const double half_pi = 0x1.921fb54442d18p+0, half_pi_rest = 0x1.1a62633145c07p-54, to_integer = 0x1.8p52;
    Lanes rest, square_rest, high = {0}, low = {0};
    if (!quarters && !any(~(Mask)(lanes_fabs(x) < 0x1p-4))) return small_sin(x, result);
    const Lanes shifted = x * 0x1.45f306dc9c883p-1 + to_integer, multiple = shifted - to_integer;
    const Lanes difference = lanes_fma(multiple, all(-half_pi), x);
    const Lanes y = two_sum(difference, multiple * -half_pi_rest, &rest);
    const Lanes square = two_product(y, y, &square_rest);
    const Mask quadrant = (Mask)shifted + quarters, is_cosine = (quadrant & 1) != 0;
    square_rest += 2 * y * rest;
    if (any(~is_cosine)) high = sin_kernel(y, rest, square, square_rest, &low);
    if (any(is_cosine)) {
        Lanes cos_low;
        const Lanes cos_high = cos_kernel(square, square_rest, &cos_low);
        high = choice(is_cosine, cos_high, high);
        low = choice(is_cosine, cos_low, low);
    }
    high = two_sum(high, low, &low);
    *result = (Lanes)((Mask)high ^ ((quadrant & 2) << 62)); /* the sign */
    const Mask is_reduced = (Mask)(lanes_fabs(x) < 0x1p20) & (Mask)(lanes_fabs(difference) > 0x1p-20);
    return is_certain(high, low, quarters ? 1.0625 : 1.140625) & is_reduced;
}

#define DEFINE_SINE(name, quarters)                                                     \
    INLINE Lanes lanes_##name(Lanes x, Lanes *memory) {                                 \
        if (any((Mask)x != (Mask)memory[0])) {                                          \
            Lanes results = {0};                                                        \
            Mask known = {0};                                                           \
            memory[0] = x;                                                              \
            HIDE(x);                                                                    \
            if (!__builtin_constant_p(x[0])) known = turned_sin(x, quarters, &results); \
            for (unsigned other = bits(~known); other; other &= other - 1)              \
                results[__builtin_ctz(other)] = name(x[__builtin_ctz(other)]);          \
            memory[1] = results;                                                        \
        }                                                                               \
        return memory[1];                                                               \
    }

DEFINE_SINE(sin, 0)
DEFINE_SINE(cos, 1)

#else

DEFINE_FUNCTION(sin)
DEFINE_FUNCTION(cos)

#endif
