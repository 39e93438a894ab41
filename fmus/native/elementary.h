/* Functions of math.h as the equations call them: the same numbers bit for bit, in less time. */

#ifndef ELEMENTARY_H
#define ELEMENTARY_H

#include <math.h>
#include <stdint.h>
#include <string.h>

/* INLINED wherever it is called: expressions that its caller computes, too, are computed once. OUTLINED: never, because
 * steps of co-simulation do not call it, and each copy takes time to compile. */
#ifdef __GNUC__
#define INLINED inline __attribute__((always_inline))
#define OUTLINED __attribute__((noinline))
#else
#define INLINED inline
#define OUTLINED
#endif

static inline uint64_t bits_of(double x) {
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}

/* Whether two numbers are the same bit for bit: 0 and -0 differ. */
static inline int is_same(double x, double y) { return bits_of(x) == bits_of(y); }

/* fmin(x, y), but of 0 and -0 the second: C leaves that to the compiler, which decides anew for each call and for vectors. */
static inline double smaller(double x, double y) {
    const double number = x < y ? x : y;
    return y != y ? x : number;
}

/* fmax(x, y), likewise. */
static inline double larger(double x, double y) {
    const double number = x > y ? x : y;
    return y != y ? x : number;
}

/* fmod(x, m) of a constant m, a whole number from 1 to 2^53: whole numbers x are divided as such. */
static inline double fmod_by_whole(double x, double m) {
    if (x > 0 && x < 9007199254740992.0 && x == (double)(int64_t)x) return (double)((int64_t)x % (int64_t)m);
    return fmod(x, m);
}

/* function(x), computed again if a bit of x has changed: `last` holds the last x and its result, then 1; at first 0. */
static inline double remembered(double (*function)(double), double x, double *last) {
    if (last[2] == 0 || !is_same(*last, x)) last[0] = x, last[1] = function(x), last[2] = 1;
    return last[1];
}

#endif
