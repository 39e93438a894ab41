/* A plan as one C program: what a closed loop costs when there is nothing between its equations.
 *
 *   monolith TABLE RESULT REPEAT
 *
 * The same equations as in the FMUs (equations.c, compiled once for each component), joined by assignments. plan.h
 * is written from the plan: the sizes, COMPONENTS, and the assignments, in which v0[3] is a variable of component 0
 * by its value reference and row[1] the first signal. Prints the seconds that each of REPEAT runs took.
 */

#define _POSIX_C_SOURCE 200809L
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "plan.h"

#define DECLARE(i)                                                                                            \
    double *part##i##_values(void);                                                                           \
    void part##i##_reset(void);                                                                               \
    int part##i##_refresh(double);                                                                            \
    void part##i##_begin(double);                                                                             \
    void part##i##_advance(double, double);
COMPONENTS(DECLARE)

static double table[ROWS][COLUMNS], result[ROWS][RECORDS];

static double seconds(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

#define RESET(i) part##i##_reset();
#define REFRESH(i)                                                                                            \
    if (!part##i##_refresh(table[0][0])) exit(1);
#define BEGIN(i) part##i##_begin(table[1][0] - table[0][0]);
#define ADVANCE(i) part##i##_advance(t, h);
#define VALUES(i) double *v##i = part##i##_values();

static void initialise(POINTERS) {
    const double *row = table[0];
    COMPONENTS(RESET)
    SETTINGS
    SIGNALS
    for (int pass = 0; pass <= N_COMPONENTS; pass++) {
        COMPONENTS(REFRESH)
        LINKS
    }
    COMPONENTS(REFRESH)
    COMPONENTS(BEGIN)
}

static void run(POINTERS) {
    for (int i = 0; i < ROWS; i++) {
        const double *row = table[i];
        const double t = row[0];
        SIGNALS
        RECORDINGS
        if (i == ROWS - 1) break;
        const double h = table[i + 1][0] - t;
        LINKS
        COMPONENTS(ADVANCE)
    }
}

int main(int argc, char **argv) {
    COMPONENTS(VALUES)
    FILE *file = argc == 4 ? fopen(argv[1], "rb") : NULL;
    if (!file || fread(table, sizeof table, 1, file) != 1) return 1;
    fclose(file);
    for (int i = 0; i < atoi(argv[3]); i++) {
        initialise(ARGUMENTS);
        const double start = seconds();
        run(ARGUMENTS);
        printf("%.9f\n", seconds() - start);
    }
    file = fopen(argv[2], "wb");
    return !file || fwrite(result, sizeof result, 1, file) != 1 || fclose(file) != 0;
}
