/* The importer of session.h for FMI 2.0. */

#include "fmi2Functions.h"

#define STANDARD fmi2
#define ESCAPED "%#"
/* Names of FMI 3.0 that are others in FMI 2.0. */
#define Instance Component
#define FMUState FMUstate
#define GetFMUState GetFMUstate
#define SetFMUState SetFMUstate
#define FreeFMUState FreeFMUstate
#define SerializedFMUStateSize SerializedFMUstateSize
#define SerializeFMUState SerializeFMUstate
#define DeserializeFMUState DeSerializeFMUstate

#include "session.h"

static fmi2CallbackFunctions callbacks[SLOTS];

static void *refused(size_t count, size_t size) {
    (void)count, (void)size;
    abort();
}

static void released(void *block) {
    (void)block;
    abort();
}

static void step_finished(fmi2ComponentEnvironment environment, fmi2Status status) {
    printf("log %d %d 1\tstepFinished\t\t\n", status, (int)(callbacks - (fmi2CallbackFunctions *)environment));
}

static void render(char *text, size_t size, const char *format, ...) {
    va_list none;
    va_start(none, format);
    vsnprintf(text, size, format, none);
    va_end(none);
}

static void logger(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status, fmi2String category,
                   fmi2String message, ...) {
    char text[8192];
    const int safe = is_safe(message);
    if (safe)
        render(text, sizeof text, message);
    else
        snprintf(text, sizeof text, "%s", message);
    printf("log %d %d %d\t%s\t%s\t%s\n", status, (int)(callbacks - (fmi2CallbackFunctions *)environment), safe, category,
           instance, text);
}

/* SLOT NAME TYPE GUID CALLBACKS LOGGING; a slot that is taken is not used again: the new instance is freed. */
static void instantiate(void) {
    const long slot = integer();
    const char *name = text();
    const fmi2Type type = (fmi2Type)integer();
    const char *guid = text(), *kind = text();
    const fmi2Boolean logging = (fmi2Boolean)integer();
    fmi2CallbackFunctions given = {logger, refused, released, NULL, callbacks};
    if (!strcmp(kind, "no_logger")) given.logger = NULL;
    if (!strcmp(kind, "no_memory")) given.allocateMemory = NULL, given.freeMemory = NULL;
    if (!strcmp(kind, "step_finished")) given.stepFinished = step_finished;
    out_of_memory = !strcmp(kind, "out_of_memory");
    instances[slot] = fmi2Instantiate(name, type, guid, NULL, strcmp(kind, "none") ? &given : NULL, fmi2False, logging);
    memset(&given, 0xff, sizeof given); /* the FMU may not rely on the structure after the call */
    out_of_memory = 0;
    answer(instances[slot] ? fmi2OK : fmi2Error);
}

static void setup(void) {
    const fmi2Component it = instance();
    const fmi2Real start = real();
    const fmi2Boolean has_stop = (fmi2Boolean)integer();
    answer(fmi2SetupExperiment(it, fmi2False, 0, start, has_stop, real()));
}

static void enter(void) { answer(fmi2EnterInitializationMode(instance())); }
static void cancel(void) { answer(fmi2CancelStep(instance())); }

static void step(void) {
    const fmi2Component it = instance();
    const fmi2Real t = real();
    answer(fmi2DoStep(it, t, real(), fmi2True));
}

static void get(void) {
    const fmi2Component it = instance();
    const char type = *text();
    size_t count;
    const fmi2ValueReference *vr = references(&count);
    if (type == 'R') {
        fmi2Real *values = output(count, sizeof *values);
        answer_reals(fmi2GetReal(it, vr, count, values), values, count);
    } else if (type == 'S') {
        fmi2String *values = output(count, sizeof *values);
        answer(fmi2GetString(it, vr, count, values));
    } else {
        fmi2Integer *values = output(count, sizeof *values);
        answer_integers((type == 'I' ? fmi2GetInteger : fmi2GetBoolean)(it, vr, count, values), values, count);
    }
}

static void set(void) {
    const fmi2Component it = instance();
    const char type = *text();
    size_t count, ignored;
    const fmi2ValueReference *vr = references(&count);
    if (type == 'R')
        answer(fmi2SetReal(it, vr, count, reals(&ignored)));
    else if (type == 'S')
        answer(fmi2SetString(it, vr, count, texts(&ignored)));
    else
        answer((type == 'I' ? fmi2SetInteger : fmi2SetBoolean)(it, vr, count, integers(&ignored)));
}

static void set_input_derivatives(void) {
    const fmi2Component it = instance();
    size_t count, ignored;
    const fmi2ValueReference *vr = references(&count);
    const fmi2Integer *order = integers(&ignored);
    answer(fmi2SetRealInputDerivatives(it, vr, count, order, reals(&ignored)));
}

static void get_output_derivatives(void) {
    const fmi2Component it = instance();
    size_t count, ignored;
    const fmi2ValueReference *vr = references(&count);
    const fmi2Integer *order = integers(&ignored);
    fmi2Real *values = output(count, sizeof *values);
    answer_reals(fmi2GetRealOutputDerivatives(it, vr, count, order, values), values, count);
}

static void directional_derivative(void) {
    const fmi2Component it = instance();
    size_t n_unknown, n_known, ignored;
    const fmi2ValueReference *unknown = references(&n_unknown), *known = references(&n_known);
    const fmi2Real *seed = reals(&ignored);
    fmi2Real *values = output(n_unknown, sizeof *values);
    answer_reals(fmi2GetDirectionalDerivative(it, unknown, n_unknown, known, n_known, seed, values), values, n_unknown);
}

/* SLOT KIND_OF_VALUE KIND_OF_STATUS OUTPUT */
static void get_status(void) {
    const fmi2Component it = instance();
    const char type = *text();
    const fmi2StatusKind kind = (fmi2StatusKind)integer();
    void *value = output(1, sizeof(fmi2Real));
    if (type == 'R') answer_reals(fmi2GetRealStatus(it, kind, value), value, 1);
    if (type == 'B') answer_integers(fmi2GetBooleanStatus(it, kind, value), value, 1);
    if (type == 'I') answer_integers(fmi2GetIntegerStatus(it, kind, value), value, 1);
    if (type == 'N') answer_integers(fmi2GetStatus(it, kind, value), value, 1);
    if (type == 'S') answer(fmi2GetStringStatus(it, kind, value));
}

static void inquire(void) {
    answer(fmi2OK);
    printf(" %s %s", fmi2GetTypesPlatform(), fmi2GetVersion());
}

static const Command COMMANDS[] = {
    COMMON_COMMANDS,
    {"instantiate", instantiate},
    {"setup", setup},
    {"enter", enter},
    {"cancel", cancel},
    {"step", step},
    {"get", get},
    {"set", set},
    {"set_input_derivatives", set_input_derivatives},
    {"get_output_derivatives", get_output_derivatives},
    {"directional_derivative", directional_derivative},
    {"get_status", get_status},
    {"inquire", inquire},
    {NULL, NULL},
};

int main(void) { return serve(COMMANDS); }
