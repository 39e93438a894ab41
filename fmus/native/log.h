/* Messages of enabled categories to the importer, formatted and escaped. */

#ifndef LOG_H
#define LOG_H

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "elementary.h"

/* Names of the standard that the including file implements: FMI(Reset) is fmi2Reset where STANDARD is fmi2, and
 * NAME(Reset) is its text. Where names differ, FMI 3.0 gives the name, which fmi2.c translates. */
#define PASTED(prefix, name) prefix##name
#define JOINED(prefix, name) PASTED(prefix, name)
#define QUOTED(name) #name
#define TEXT(name) QUOTED(name)
#define FMI(name) JOINED(STANDARD, name)
#define NAME(name) TEXT(STANDARD) TEXT(name)

typedef FMI(Status) Status;
#define OK FMI(OK)
#define WARNING FMI(Warning)
#define DISCARD FMI(Discard)
#define ERROR FMI(Error)

enum { LOG_WARNING = 1, LOG_DISCARD = 2, LOG_ERROR = 4, LOG_FATAL = 8, LOG_ALL = 15, MESSAGE_SIZE = 1024 };

static const struct {
    const char *name;
    unsigned mask;
} LOG_CATEGORIES[] = {
    {"logStatusWarning", LOG_WARNING}, {"logStatusDiscard", LOG_DISCARD}, {"logStatusError", LOG_ERROR},
    {"logStatusFatal", LOG_FATAL},     {"logAll", LOG_ALL},
};

enum { N_LOG_CATEGORIES = sizeof LOG_CATEGORIES / sizeof LOG_CATEGORIES[0] };

/* What logging needs of the importer's callbacks: a copy, because they need not outlive the call. */
typedef struct {
    FMI(LogMessageCallback) logger;
    void *environment;
    const char *instance;
    unsigned enabled;
} Log;

/* The mask of a category's name, 0 for an unknown name. */
static OUTLINED unsigned log_category(const char *name) {
    for (size_t i = 0; name && i < N_LOG_CATEGORIES; i++)
        if (!strcmp(name, LOG_CATEGORIES[i].name)) return LOG_CATEGORIES[i].mask;
    return 0;
}

/* The importer replaces #1# or #r1# by the name of a variable, in FMI 2.0 also what printf does: such characters are
 * doubled, so the result can be twice as long. */
static void log_escape(const char *text, const char *doubled, char *escaped) {
    size_t length = 0;
    for (; *text; text++) {
        if (strchr(doubled, *text)) escaped[length++] = *text;
        escaped[length++] = *text;
    }
    escaped[length] = '\0';
}

/* Calls the importer's function; `text` is escaped. */
static void log_deliver(const Log *log, Status status, const char *category, const char *text);

static void log_send(const Log *log, Status status, const char *format, va_list arguments) {
    static const int place[] = {0, 0, 1, 2, 3, 0}; /* of a status among the categories */
    char text[MESSAGE_SIZE], escaped[2 * MESSAGE_SIZE];
    int i = place[status];
    if (!log->logger || !(log->enabled & LOG_CATEGORIES[i].mask)) return;
    vsnprintf(text, sizeof text, format, arguments);
    log_escape(text, LOG_ESCAPED, escaped);
    log_deliver(log, status, LOG_CATEGORIES[i].name, escaped);
}

/* The shortest decimal that is this number again, also where the host's locale has a decimal comma. */
static OUTLINED const char *shortest(double number, char *text, size_t size) {
    for (int digits = 1; digits <= 17; digits++) {
        snprintf(text, size, "%.*g", digits, number);
        if (strtod(text, NULL) == number) break;
    }
    for (char *c = text; *c; c++)
        if (*c == ',') *c = '.';
    return text;
}

/* A number as an argument of a message; its characters live until the end of the enclosing block. */
#define DECIMAL(number) shortest(number, (char[32]){0}, 32)

#endif
