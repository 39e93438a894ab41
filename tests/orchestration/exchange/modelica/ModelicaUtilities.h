/* What a Modelica tool offers to external functions: here messages, and an end with status 3. */

#ifndef MODELICA_UTILITIES_H
#define MODELICA_UTILITIES_H

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

static inline void ModelicaFormatMessage(const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    vfprintf(stderr, format, arguments);
    va_end(arguments);
}

static inline void ModelicaFormatError(const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    vfprintf(stderr, format, arguments);
    va_end(arguments);
    exit(3);
}

static inline void ModelicaError(const char *message) {
    ModelicaFormatError("%s", message);
}

#endif
