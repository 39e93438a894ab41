/* A second legal slave for co-simulation that misbehaves in one way, by the name in resources/mutation.txt.
 *
 *   pos' = vel,  m vel' = f + f2 ref - k pos,  power = vel f,  held = ref,  n_out = n_in n_tun, and texts
 *
 * It refuses what 4.2.4 does not allow, has derivatives of both orders and a variable of every kind;
 * the list of mutants stands in slaves.toml.
 */

#define _GNU_SOURCE
#include <fenv.h>
#include <math.h>
#include <sched.h>
#include <signal.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include "fmi2Functions.h"

enum { PAR, CALC, IN, OUT, LOC, IND };
enum { CONST, FIXED, TUN, DISC, CONT };
enum { NONE, EXACT, APPROX, CALCD };
enum { INST = 1, INIT = 2, STEP = 4, TERM = 8, FAIL = 16, PEND = 32, CANC = 64, STEPFAIL = 128 };
enum { L = 2000 };
typedef struct {
    double time, m, k, w0, half_m, gain2, inv_m, f, f2, ref, pos, vel, acc, power, held, guess, g, energy, df,
        df2, f_end, last, h, tend, vel_before, tolerance, first_m, next_sample;
    int n_in, n_tun, n_out, steps, kind, kind_in, kind_out, n_const, on, off, both, yes, n_before, is_read, samples;
    char label[L], text_in[L], text_out[L], s_fixed[L], s_const[L];
    int state, setup, stop_defined;
    double stop;
} Data;
typedef struct {
    unsigned vr;
    char type;
    int ca, va, in, unknown;
    size_t off;
} Var;
#define O(x) offsetof(Data, x)
static const Var vars[] = {
    {10000, 'r', IND, CONT, NONE, 0, O(time)},    {101, 'r', PAR, FIXED, EXACT, 0, O(m)},
    {102, 'r', PAR, TUN, EXACT, 0, O(k)},         {103, 'r', CALC, TUN, CALCD, 1, O(w0)},
    {104, 'r', CALC, FIXED, CALCD, 1, O(half_m)}, {105, 'r', LOC, TUN, CALCD, 0, O(gain2)},
    {106, 'r', LOC, FIXED, CALCD, 0, O(inv_m)},   {201, 'r', IN, CONT, NONE, 0, O(f)},
    {202, 'r', IN, CONT, NONE, 0, O(f2)},         {203, 'r', IN, DISC, NONE, 0, O(ref)},
    {301, 'r', OUT, CONT, EXACT, 0, O(pos)},      {302, 'r', OUT, CONT, EXACT, 0, O(vel)},
    {303, 'r', LOC, CONT, CALCD, 1, O(acc)},      {304, 'r', OUT, CONT, CALCD, 1, O(power)},
    {305, 'r', OUT, DISC, CALCD, 1, O(held)},     {306, 'r', LOC, CONT, APPROX, 0, O(guess)},
    {307, 'r', OUT, CONST, EXACT, 0, O(g)},       {4294967295u, 'r', LOC, CONT, CALCD, 0, O(energy)},
    {1, 'i', IN, DISC, NONE, 0, O(n_in)},         {2, 'i', PAR, TUN, EXACT, 0, O(n_tun)},
    {3, 'i', OUT, DISC, CALCD, 1, O(n_out)},      {4, 'i', LOC, DISC, CALCD, 0, O(steps)},
    {5, 'i', PAR, FIXED, EXACT, 0, O(kind)},      {6, 'i', IN, DISC, NONE, 0, O(kind_in)},
    {7, 'i', OUT, DISC, CALCD, 1, O(kind_out)},   {8, 'i', LOC, CONST, EXACT, 0, O(n_const)},
    {1, 'b', IN, DISC, NONE, 0, O(on)},           {2, 'b', PAR, TUN, EXACT, 0, O(off)},
    {3, 'b', OUT, DISC, CALCD, 1, O(both)},       {4, 'b', LOC, CONST, EXACT, 0, O(yes)},
    {1, 's', PAR, TUN, EXACT, 0, O(label)},       {2, 's', IN, DISC, NONE, 0, O(text_in)},
    {3, 's', OUT, DISC, CALCD, 1, O(text_out)},   {4, 's', PAR, FIXED, EXACT, 0, O(s_fixed)},
    {5, 's', LOC, CONST, EXACT, 0, O(s_const)},
};
enum { NVARS = sizeof vars / sizeof *vars };

typedef struct Slave {
    Data d;
    fmi2CallbackFunctions cb;
    char name[600];
    unsigned enabled;
    const char *kept_category;
    int keeps;
    Data *first_state;
    int flushed, late, states, resets, is_back, sets;
    double first_start;
} Slave;

static char mutation[100], flags[200];
#define IS(n) (!strcmp(mutation, n))
#define FLAG(n) (strstr(flags, n) != NULL)
static int failed_globally, live;
static unsigned enabled_in_all;
static Slave *latest, *first;
static fmi2ComponentEnvironment freed; /* of an instance that was freed beside others */
static const char *CAT[] = {"logEvents",      "logStatusWarning", "logStatusDiscard",
                            "logStatusError", "logStatusFatal",   "logStatusPending"};
static const char GUID[] = "{f00dcafe-0000-4000-8000-00000000beef}";

static void say(Slave *s, fmi2Status st, int cat, const char *text) {
    const unsigned enabled = IS("debug logging is of all instances") ? enabled_in_all : s->enabled;
    if (!(enabled & (1u << cat)) || !s->cb.logger) return;
    if (s->keeps && strcmp(s->kept_category, CAT[cat])) return;
    const Slave *last = latest ? latest : s, *of = IS("the logger of the last instance") ? last : s;
    const fmi2CallbackLogger logger = of->cb.logger;
    fmi2ComponentEnvironment e = (IS("messages go to the latest instance") ? last : of)->cb.componentEnvironment;
    if (IS("messages go to an instance that was freed") && freed) e = freed;
    const char *name = IS("messages carry the latest name") ? last->name : s->name;
    const char *category = IS("an empty category") ? "" : CAT[cat], *format = "%s";
    if (IS("a misspelt category in initialization mode") && s->d.state == INIT) category = "logStatusErorr";
    char with_name[900];
    if (IS("the instance name is part of the format")) {
        snprintf(with_name, sizeof with_name, "%s: %%s", s->name);
        format = with_name;
    }
    if (IS("errors are information")) st = fmi2OK;
    if (IS("a blank of a text") && st == fmi2Error) format = "an error, 100% sure";
    if (IS("a late blank of a number") && s->d.time > 2) format = "at 100% of it";
    if (IS("a percent sign after many steps") && s->d.time > 3.5) format = "done: 100 %";
    if (IS("a percent sign at the end")) format = "done: 100 %";
    if (IS("a message that is not UTF-8")) format = "Tiefe \xfc";
    if (IS("legal formats, a new string of the version")) logger(e, name, st, category, "100%% done, % d left", 5);
    else logger(e, name, st, category, format, text);
}
static fmi2Status err(Slave *s, const char *text) {
    say(s, fmi2Error, 3, text);
    if (IS("an error ends all instances")) failed_globally = live > 1;
    s->d.state = FAIL;
    return fmi2Error;
}
static const char *unknown(char type, unsigned reference) {
    static char text[50];
    snprintf(text, sizeof text, "no such variable: #%c%u#", type, reference);
    return FLAG("logs its calls") ? text : "no such variable";
}
static fmi2Status discard(Slave *s) {
    say(s, fmi2Discard, 2, "discarded");
    return fmi2Discard;
}
static fmi2Status need(Slave *s, int states, const char *fn) {
    char cell[100];
    if (s->d.state & states) return fmi2OK;
    snprintf(cell, sizeof cell, "%s in %s", fn + 4,
             s->d.state == INST   ? "instantiated"
             : s->d.state == INIT ? "initialization"
             : s->d.state == STEP ? "step"
             : s->d.state == TERM ? "terminated"
             : s->d.state == FAIL ? "failed"
             : s->d.state == PEND ? "pending"
                                  : "cancelled");
    if (IS(cell)) return fmi2OK;
    return err(s, fn);
}
#define NEED(st)                                                                                             \
    do {                                                                                                     \
        if (need(s, st, __func__) != fmi2OK) return fmi2Error;                                               \
        if (failed_globally) return err(s, "global");                                                        \
    } while (0)

static double accel(const Data *d, double pos, double f, double f2) {
    if (FLAG("begins anew where an input is set")) f2 = 0;
    return (f + f2 * d->ref - d->k * pos) / d->m;
}
static void tuned(Data *d) {
    if (!(IS("tunable calculated parameters stay") && d->state == STEP)) d->w0 = sqrt(fabs(d->k / d->m));
    if (!(FLAG("tunable locals stay") && d->state == STEP)) d->gain2 = 2 * d->k;
    if (d->state != STEP) {
        d->half_m = d->m / 2;
        d->inv_m = 1 / d->m;
    } else {
        if (IS("a fixed parameter follows a tunable one")) d->half_m = d->k * 0.1875;
        if (IS("a fixed local follows an input")) d->inv_m = 1 / d->m + d->f - 0.3;
        if (IS("a constant string changes") && d->steps > 1) strcpy(d->s_const, "changed");
    }
}
static void outputs(Data *d) {
    tuned(d);
    double f = d->f_end;
    d->acc = accel(d, d->pos, f, d->f2);
    d->power = d->vel * f;
    if (IS("a declared input does not act in step mode") && d->state == STEP) d->power = d->vel;
    if (IS("a constant factor is none")) d->power = d->vel * f + 3 * f * f;
    d->held = d->ref;
    const double m = IS("a parameter acts from before initialization mode") && d->state == STEP ? d->first_m : d->m;
    d->energy = 0.5 * m * d->vel * d->vel + 0.5 * d->k * d->pos * d->pos;
    if (IS("nothing is computed in initialization mode") && d->state == INIT) d->acc = d->power = 0;
    d->n_out = d->n_in * d->n_tun + d->samples;
    d->kind_out = d->kind_in;
    d->both = d->on && !d->off;
    snprintf(d->text_out, L, "%s/%s", d->label, d->text_in);
}
static void reset(Data *d) {
    memset(d, 0, sizeof *d);
    d->m = 1.5;
    d->k = 4;
    d->f = 0.3;
    d->f2 = -0.2;
    d->ref = 1;
    d->pos = 0.1;
    d->vel = 0;
    d->guess = 1;
    d->g = FLAG("seven digits") ? 9.8100000123 : 9.81;
    d->n_in = 3;
    d->n_tun = 2;
    d->kind = 2;
    d->kind_in = 5;
    d->n_const = 42;
    d->on = 1;
    d->yes = 1;
    strcpy(d->label, "Label \xc3\xa4");
    strcpy(d->text_in, "in");
    strcpy(d->s_fixed, "fix");
    strcpy(d->s_const, "const");
    d->f_end = d->f;
    d->state = INST;
    d->stop = INFINITY;
    outputs(d);
}

const char *fmi2GetTypesPlatform(void) { return IS("types in memory of their own") ? strdup(fmi2TypesPlatform) : fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return IS("legal formats, a new string of the version") ? strdup(fmi2Version) : fmi2Version; }

static void decode(const char *u, char *p) {
    if (!strncmp(u, "file:///", 8)) u += 7;
    else if (!strncmp(u, "file://", 7)) {
        u = strchr(u + 7, '/');
    } else if (!strncmp(u, "file:/", 6)) u += 5;
    unsigned c;
    for (; *u; u++)
        if (*u == '%' && sscanf(u + 1, "%2x", &c) == 1) {
            *p++ = (char)c;
            u += 2;
        } else *p++ = *u;
    *p = 0;
}
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String loc,
                              const fmi2CallbackFunctions *fn, fmi2Boolean visible, fmi2Boolean logging) {
    char path[3000];
    decode(loc, path);
    strcat(path, "/mutation.txt");
    FILE *file = fopen(path, "r");
    if (file) {
        if (fgets(mutation, sizeof mutation, file)) mutation[strcspn(mutation, "\n")] = 0;
        if (fgets(flags, sizeof flags, file)) flags[strcspn(flags, "\n")] = 0;
        fclose(file);
    }
    if (FLAG("events are of logAll")) CAT[0] = "logAll";
    int same = !strcmp(guid, GUID);
    if (IS("GUID without case")) same = !strcasecmp(guid, GUID);
    if (type != fmi2CoSimulation || !same) {
        if (IS("a refusal in silence with logging off") && !logging) return NULL;
        if (IS("another type is refused in silence") && type != fmi2CoSimulation) return NULL;
        if (IS("a refusal without environment")) {
            fn->logger(NULL, name, fmi2Error, CAT[3], "no");
            return NULL;
        }
        fn->logger(fn->componentEnvironment, name, fmi2Error, CAT[3], "wrong type or GUID");
        return NULL;
    }
    if (IS("visible instances fail") && visible) {
        fn->logger(fn->componentEnvironment, name, fmi2Error, CAT[3], "no window");
        return NULL;
    }
    Slave *s = calloc(1, sizeof *s);
    if (!s) return NULL;
    if (!live++) freed = NULL, first = s, failed_globally = 0;
    latest = s;
    s->cb = *fn;
    snprintf(s->name, IS("long names are cut") ? 40 : sizeof s->name, "%s", name);
    if (IS("an alarm")) alarm(1000);
    s->enabled = enabled_in_all = logging ? 63 : 0;
    if (IS("a blocked signal")) {
        sigset_t set;
        sigemptyset(&set);
        sigaddset(&set, SIGTERM);
        pthread_sigmask(SIG_BLOCK, &set, NULL);
    }
    if (IS("one processor alone")) {
        cpu_set_t one;
        CPU_ZERO(&one);
        CPU_SET(0, &one);
        sched_setaffinity(0, sizeof one, &one);
    }
    if (IS("a changed environment variable")) setenv("TZ", "UTC+5", 1);
    if (IS("a removed environment variable")) unsetenv("PATH");
    if (IS("standard output is closed")) close(1);
    reset(&s->d);
    say(s, fmi2OK, 0, "instantiated");
    return s;
}
void fmi2FreeInstance(fmi2Component c) {
    Slave *s = c;
    if (!s) return;
    if (--live) freed = s->cb.componentEnvironment;
    if (latest == s) latest = NULL;
    if (IS("free crashes when terminated") && s->d.state == TERM) abort();
    if (IS("free of one ends the others")) failed_globally = live > 0;
    free(s);
}
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String cats[]) {
    Slave *s = c;
    if (FLAG("logs its calls")) say(s, fmi2OK, 0, "fmi2SetDebugLogging");
    if (IS("debug logging is refused after an error") && s->d.state == FAIL) return err(s, "x");
    unsigned chosen = n ? 0 : 63;
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < 6; k++)
            if (!strcmp(cats[i], CAT[k])) chosen |= 1u << k;
    if (n && IS("the pointer to a category is kept")) {
        s->kept_category = cats[0];
        s->keeps = 1;
    }
    if (on) s->enabled = n ? chosen : 63;
    else if (IS("logging is turned off for the categories alone")) s->enabled &= ~chosen;
    else s->enabled = 0;
    enabled_in_all = s->enabled;
    return fmi2OK;
}
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean td, fmi2Real tol, fmi2Real start, fmi2Boolean sd,
                               fmi2Real stop) {
    Slave *s = c;
    NEED(INST);
    if (IS("a second set-up is refused") && s->d.setup) return err(s, "again");
    if (IS("an undefined tolerance counts") && !td && !(tol > 0)) return err(s, "tolerance");
    if (IS("a tiny tolerance is refused") && td && tol < 1e-10) return err(s, "tolerance");
    s->d.setup = 1;
    if (IS("runs begin at 0")) start = 0;
    s->d.tolerance = td ? tol : 0;
    if (!s->resets || !s->first_start) s->first_start = start;
    if (IS("the first start time stays")) start = s->first_start;
    s->d.time = s->d.last = start;
    s->d.next_sample = start + 0.5;
    s->d.stop_defined = sd;
    s->d.stop = sd ? stop : INFINITY;
    return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    Slave *s = c;
    NEED(INST);
    if (!s->d.setup) return err(s, "set-up first");
    s->d.first_m = s->d.m;
    if (IS("rounds with a tolerance") && s->d.tolerance > 0) fesetround(FE_UPWARD);
    if (IS("another kind is discarded") && s->d.kind != 2) return discard(s);
    s->d.state = INIT;
    return fmi2OK;
}
fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    Slave *s = c;
    NEED(INIT);
    s->d.f_end = s->d.f + s->d.df * 0;
    outputs(&s->d);
    s->d.state = STEP;
    if (IS("nothing is computed in initialization mode")) outputs(&s->d);
    return fmi2OK;
}
fmi2Status fmi2Terminate(fmi2Component c) {
    Slave *s = c;
    NEED(STEP | STEPFAIL);
    s->d.state = TERM;
    if (IS("late final values are those of the start") && s->d.time > 2.8) s->d.pos = 0.1;
    return fmi2OK;
}
fmi2Status fmi2Reset(fmi2Component c) {
    Slave *s = c;
    static Data old;
    memcpy(&old, &s->d, sizeof old);
    if (s->d.state == PEND) return err(s, "pending");
    if (IS("reset leaks a few bytes")) {
        char *volatile p = malloc(80);
        p[0] = 1;
    }
    if (IS("reset leaks")) {
        void *volatile p = malloc(1 << 16);
        memset(p, 1, 1 << 16);
    }
    reset(&s->d);
    s->resets++;
    if (IS("reset turns logging on")) s->enabled = 63;
    if (IS("reset takes the environment of the first instance")) s->cb = first->cb;
    if (IS("reset keeps strings")) strcpy(s->d.label, old.label), strcpy(s->d.s_fixed, old.s_fixed);
    if (IS("a late reset keeps the state") && old.time > 2.8) s->d.vel = old.vel;
    if (IS("no reset after a late error") && old.state == FAIL && old.time > 2.8) return err(s, "too late");
    if (IS("an error spoils the next run") && old.state == FAIL) s->d.k = 4.1;
    if (IS("reset keeps inputs")) s->d.f = s->d.f_end = old.f, s->d.f2 = old.f2, s->d.ref = old.ref;
    if (IS("reset frees states")) {
        if (s->first_state) memset(s->first_state, 0xff, sizeof *s->first_state);
        free(s->first_state);
        s->first_state = NULL;
    }
    return fmi2OK;
}
static const Var *find(char type, unsigned vr) {
    for (int i = 0; i < NVARS; i++)
        if (vars[i].type == type && vars[i].vr == vr) return &vars[i];
    return NULL;
}
#define GETTER(Name, T, ch, expr)                                                                            \
    fmi2Status fmi2Get##Name(fmi2Component c, const fmi2ValueReference vr[], size_t n, T value[]) {          \
        Slave *s = c;                                                                                        \
        Data *d = &s->d;                                                                                     \
        NEED(INIT | STEP | TERM | FAIL | CANC | STEPFAIL);                                                   \
        if (IS("no reading after a discarded step") && d->last < d->time) return err(s, "discarded");        \
        if (d->state == INIT) {                                                                              \
            d->f_end = d->f;                                                                                 \
            outputs(d);                                                                                      \
            d->is_read = 1;                                                                                  \
        }                                                                                                    \
        if (IS("reading counts") && d->state == STEP) d->steps++;                                            \
        for (size_t i = 0; i < n; i++) {                                                                     \
            const Var *v = find(ch, vr[i]);                                                                  \
            if (!v) return err(s, unknown(ch, vr[i]));                                                       \
            if (d->state == INIT && !(v->ca == OUT || v->unknown || v->ca == IND)) return err(s, "not now");                 \
            if (IS("a reference twice in a call") && i && vr[i] == vr[i - 1]) {                              \
                memset(&value[i], 0, sizeof value[i]);                                                       \
                continue;                                                                                    \
            }                                                                                                \
            void *p = (char *)d + v->off;                                                                    \
            if (IS("values are not written") && (p == &d->energy || p == &d->steps)) continue;                 \
            if (IS("values out of order are not written") && n > 1 && vr[0] > vr[n - 1]) continue;             \
            value[i] = expr;                                                                                 \
            if (IS("reading writes references")) ((unsigned *)vr)[i] = 0;                                    \
            if (IS("reading writes one more") && i + 1 == n) memset(&value[n], 0, sizeof value[n]);          \
        }                                                                                                    \
        return fmi2OK;                                                                                       \
    }
static double real_of(Slave *s, void *p) {
    double x = *(double *)p;
    if (IS("time of equal steps") && p == &s->d.time) x = s->d.time - s->d.h + 0.05;
    if (IS("time is behind with a stop time") && p == &s->d.time && s->d.stop_defined && s->d.steps) x -= 0.01;
    if (IS("a derivative is twice as large") && p == &s->d.acc && s->d.state != INIT) x *= 2;
    if (IS("out of range for a moment") && p == &s->d.held && s->d.time > 2.42 && s->d.time < 2.53) x = 50;
    if (IS("not a number late in the experiment") && p == &s->d.power && s->d.time > 3.3) x = NAN;
    if (IS("time is 0 in initialization mode") && p == &s->d.time && s->d.state == INIT) x = 0;
    if (IS("not a number later") && p == &s->d.power && s->d.steps > 2) x = NAN;
    return x;
}
static fmi2String str_of(Slave *s, char *p) {
    if (IS("a string of NULL before the first step") && p == s->d.text_out && !s->d.steps) return NULL;
    return p;
}
GETTER(Real, fmi2Real, 'r', real_of(s, p))
GETTER(Integer, fmi2Integer, 'i', *(int *)p)
static int bool_of(Slave *s, int *p) {
    return IS("a Boolean of 2 late in a run") && p == &s->d.both && s->d.time > 3.3 ? 2 * *p : *p;
}
GETTER(Boolean, fmi2Boolean, 'b', bool_of(s, p))
GETTER(String, fmi2String, 's', str_of(s, p))

static int settable(Slave *s, const Var *v) {
    const int st = s->d.state;
    if (v->va == CONST) return 0;
    if (st == INST) return v->in == EXACT || v->in == APPROX;
    if (st == INIT) return v->in == EXACT || v->ca == IN;
    return v->ca == IN || (v->ca == PAR && v->va == TUN);
}
static int refused(const Var *v, char *p) {
    static Data start;
    reset(&start);
    const char *value = (char *)&start + v->off;
    const size_t size = v->type == 'r' ? sizeof(double) : v->type == 's' ? strlen(p) + 1 : sizeof(int);
    if (!FLAG("other values are refused") || v->ca != PAR || v->va != TUN || !memcmp(p, value, size)) return 0;
    memcpy(p, value, v->type == 's' ? strlen(value) + 1 : size);
    return 1;
}
static int is_far(double f) { return IS("a warning ends in an error") && fabs(f - 0.3) > 0.5; }
static fmi2Status spoil(Slave *s) {
    say(s, fmi2Warning, 1, "far from the start value");
    s->d.state = FAIL;
    return fmi2Warning;
}
#define SETTER(Name, T, ch, store)                                                                           \
    fmi2Status fmi2Set##Name(fmi2Component c, const fmi2ValueReference vr[], size_t n, const T value[]) {    \
        Slave *s = c;                                                                                        \
        Data *d = &s->d;                                                                                     \
        fmi2Status st = fmi2OK;                                                                              \
        NEED(INST | INIT | STEP);                                                                            \
        for (size_t i = 0; i < n; i++) {                                                                     \
            const Var *v = find(ch, vr[i]);                                                                  \
            if (!v) return err(s, unknown(ch, vr[i]));                                                       \
            if (!settable(s, v)) return err(s, "not settable");                                              \
            if (IS("only the first value of a call is set") && i) continue;                                  \
            void *p = (char *)d + v->off;                                                                    \
            store;                                                                                           \
            if (d->state == FAIL) return fmi2Error;                                                          \
            if (refused(v, p)) st = discard(s);                                                              \
            if (p == &d->f && d->state == STEP && is_far(d->f)) st = spoil(s);                               \
        }                                                                                                    \
        return st;                                                                                           \
    }
static void set_real(Slave *s, void *p, double x) {
    const int closed = IS("a parameter cannot be changed once a value was read") && s->d.is_read;
    if (closed && p == &s->d.m && x != s->d.m) {
        err(s, "m was used");
        return;
    }
    if (IS("inputs are clipped") && p == &s->d.f) x = fmin(x, 0.5);
    if (IS("the second of two sets is lost") && p == &s->d.f && s->d.state == STEP && s->sets++) return;
    if (IS("late inputs are lost") && p == &s->d.f && s->d.time > 2.8) return;
    if (IS("inputs are lost once a state was set back") && p == &s->d.f && s->is_back) return;
    if (IS("tunable parameters are clipped") && p == &s->d.k) x = fmin(x, 6);
    if (FLAG("begins anew where an input is set") && p == &s->d.f2 && s->d.state == STEP && x != s->d.f2)
        s->d.pos += 1e-10;
    *(double *)p = x;
    if (p == &s->d.f) s->d.f_end = x;
}
static void set_str(Slave *s, char *p, const char *x) {
    if (IS("long strings are cut")) {
        snprintf(p, 32, "%s", x);
        return;
    }
    snprintf(p, L, "%s", x);
}
static void set_int(Slave *s, int *p, int x) { *p = IS("Integers of a byte") ? (signed char)x : x; }
SETTER(Real, fmi2Real, 'r', set_real(s, p, value[i]))
SETTER(Integer, fmi2Integer, 'i', set_int(s, p, value[i]))
SETTER(Boolean, fmi2Boolean, 'b', *(int *)p = value[i] != 0)
SETTER(String, fmi2String, 's', set_str(s, p, value[i]))

static void integrate(Slave *s, double h) {
    Data *d = &s->d;
    if (IS("the first step size stays")) {
        if (!d->h) d->h = h;
        h = d->h;
    }
    if (IS("stops short with a tolerance")) h -= fmin(h / 10, 10 * d->tolerance);
    if (IS("whole internal steps alone")) h = 0.01 * floor(h / 0.01 + 1e-9);
    if (IS("steps of a grid")) h = 0.03 * floor(h / 0.03 + 1e-9) + 0.03;
    const int N = 20;
    double dt = h / N, x = d->pos, v = d->vel;
    double a = d->df, b = d->df2;
    if (IS("only the first input has derivatives")) b = 0;
    for (int i = 0; i < N; i++) {
        double t0 = i * dt;
#define A(pp, tt) accel(d, pp, d->f + a * (tt), d->f2 + b * (tt))
        double k1x = v, k1v = A(x, t0), k2x = v + dt / 2 * k1v, k2v = A(x + dt / 2 * k1x, t0 + dt / 2);
        double k3x = v + dt / 2 * k2v, k3v = A(x + dt / 2 * k2x, t0 + dt / 2), k4x = v + dt * k3v,
               k4v = A(x + dt * k3x, t0 + dt);
        x += dt / 6 * (k1x + 2 * k2x + 2 * k3x + k4x);
        v += dt / 6 * (k1v + 2 * k2v + 2 * k3v + k4v);
    }
    s->sets = 0;
    d->vel_before = d->vel;
    d->pos = x;
    d->vel = v;
    d->f_end = d->f + a * h;
    d->steps++;
    if (IS("a parameter drifts late in a run") && d->time > 3.87) d->m += 1e-3 * h;
    if (IS("states without the next sample") && d->time + h > d->next_sample - 1e-9) {
        d->samples++;
        d->next_sample += 0.8;
    }
    outputs(d);
    if (IS("Integer inputs act a step late")) d->n_out = (d->steps > 1 ? d->n_before : d->n_in) * d->n_tun;
    d->n_before = d->n_in;
    d->df = d->df2 = 0;
}
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no) {
    Slave *s = c;
    Data *d = &s->d;
    NEED(STEP);
    if (!(h > 0)) return err(s, "step size");
    const int wrong = fabs(t - d->time) > 1e-9 * fmax(1, fabs(t));
    const int short_of = IS("stops short with a tolerance") && d->tolerance > 0;
    if (wrong && !short_of && !(IS("any first communication point") && !d->steps)) return err(s, "communication point");
    if (t + h > d->stop * (1 + 1e-9) + 1e-9) {
        s->late = 1;
        return err(s, "stop time");
    }
    if (IS("fails before its own stop time") && t > 3.2) return err(s, "broken");
    if (IS("needs stepFinished late in a run") && t > 3.2 && !s->cb.stepFinished) return err(s, "no stepFinished");
    if (no) s->flushed = 1;
    if (FLAG("discards") && d->steps == 3) {
        integrate(s, h / 2);
        d->time = d->last = t + h / 2;
        if (IS("half a step without a last time")) d->last = t - 1;
        if (IS("no reading after a discarded step")) d->last = t;
        if (IS("values of the end of a discarded step")) d->time = t + h;
        return discard(s);
    }
    if (FLAG("asynchronous")) {
        d->h = h;
        d->tend = t + h;
        d->state = PEND;
        return fmi2Pending;
    }
    if (IS("warns in each step"))
        s->cb.logger(s->cb.componentEnvironment, s->name, fmi2Warning, CAT[1], "a step");
    integrate(s, h);
    if (IS("time of equal steps")) d->h = h;
    d->time = t + h;
    if (short_of) d->time -= fmin(h / 10, 10 * d->tolerance);
    d->last = t + h;
    if (IS("a late event is logged whatever is enabled") && s->enabled && t > 2.8)
        s->cb.logger(s->cb.componentEnvironment, s->name, fmi2OK, CAT[0], "late");
    say(s, fmi2OK, 0, "stepped");
    return fmi2OK;
}
static void finish(Slave *s) {
    Data *d = &s->d;
    integrate(s, d->h);
    d->time = d->last = d->tend;
    d->state = STEP;
    fmi2ComponentEnvironment e = s->cb.componentEnvironment;
    if (s->cb.stepFinished) { s->cb.stepFinished(e, fmi2OK); }
}
fmi2Status fmi2CancelStep(fmi2Component c) {
    Slave *s = c;
    NEED(PEND);
    s->d.state = CANC;
    return fmi2OK;
}
fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind k, fmi2Status *v) {
    Slave *s = c;
    if (k == fmi2DoStepStatus && s->d.state == PEND) {
        finish(s);
        *v = fmi2OK;
        return fmi2OK;
    }
    return discard(s);
}
fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind k, fmi2Real *v) {
    Slave *s = c;
    if (k == fmi2LastSuccessfulTime) {
        *v = s->d.last;
        return fmi2OK;
    }
    return discard(s);
}
fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind k, fmi2Integer *v) {
    if (IS("an Integer status")) {
        *v = 0;
        return fmi2OK;
    }
    return discard(c);
}
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind k, fmi2Boolean *v) {
    Slave *s = c;
    if (IS("a Boolean status of 3") && k == fmi2Terminated && s->d.steps > 3) {
        *v = 3;
        return fmi2OK;
    }
    return discard(s);
}
fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind k, fmi2String *v) {
    return discard(c);
}
fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                       const fmi2Integer o[], const fmi2Real v[]) {
    Slave *s = c;
    NEED(INST | INIT | STEP);
    for (size_t i = 0; i < n; i++) {
        if (o[i] < 1) return err(s, "order");
        if (o[i] > 1 && FLAG("first order alone, or a warning")) {
            say(s, fmi2Warning, 1, "order");
            return fmi2Warning;
        }
        if (o[i] > 1 && FLAG("first order alone")) return err(s, "order");
        const int order = IS("the order of the first input counts") ? o[0] : o[i];
        if (IS("only the first derivative of a call is set") && i) continue;
        if (IS("derivatives of an output are taken") && vr[i] / 100 == 3) continue;
        if (vr[i] == 201) {
            if (order == 1) s->d.df = v[i];
        } else if (vr[i] == 202) {
            if (order == 1) s->d.df2 = v[i];
        } else return err(s, "no input");
    }
    return fmi2OK;
}
fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                        const fmi2Integer o[], fmi2Real v[]) {
    Slave *s = c;
    Data *d = &s->d;
    NEED(STEP | TERM | FAIL | CANC | STEPFAIL);
    if (IS("derivatives of outputs are refused late") && d->time > 2.8) return err(s, "no");
    for (size_t i = 0; i < n; i++) {
        if (o[i] < 1 && !IS("an order of 0 of outputs is taken")) return err(s, "order");
        double first, second;
        const double f = d->f_end;
        const double a = accel(d, d->pos, f, d->f2), j = -d->k * d->vel / d->m;
        if (vr[i] == 305 && IS("derivatives of discrete outputs are not written")) continue;
        if (vr[i] == 301) first = d->vel, second = a;
        else if (vr[i] == 302) first = a, second = j;
        else if (vr[i] == 304) first = a * f, second = j * f;
        else if (vr[i] == 305 || vr[i] == 307) first = second = 0;
        else if (IS("derivatives of any variable")) first = second = 0;
        else return err(s, "no output");
        if (IS("derivatives of outputs of the step's begin")) first = vr[i] == 301 ? d->vel_before : first;
        if (IS("late second derivatives of outputs are wrong") && d->time > 2.8) second *= -1;
        if (IS("second derivatives of outputs are wrong")) second *= -1;
        if (IS("second derivatives of outputs are their values") && vr[i] == 301) second = d->pos;
        if (FLAG("backward differences") && vr[i] == 301) first = (d->vel + d->vel_before) / 2;
        const int order = IS("the order of the first output counts") ? o[0] : o[i];
        v[i] = order == 1 ? first : order == 2 ? second : 0;
    }
    return fmi2OK;
}
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference y[], size_t ny,
                                        const fmi2ValueReference u[], size_t nu, const fmi2Real seed[],
                                        fmi2Real out[]) {
    Slave *s = c;
    Data *d = &s->d;
    NEED(INIT | STEP | TERM | FAIL | CANC | STEPFAIL);
    if (IS("directional derivatives move the state")) d->pos += 1e-3;
    for (size_t i = 0; i < ny; i++) {
        if (IS("only the first directional derivative") && i) break;
        double sum = 0;
        for (size_t k = 0; k < nu; k++) {
            double J = 0;
            double kk = d->k, mm = d->m, vel = d->vel, f = d->f_end;
            if (IS("directional derivatives at the start") && d->state != INIT) vel = 0, f = 0.3;
            unsigned a = y[i], b = u[k];
            if (a == b) J = 1;
            if (a == 303)
                J = b == 201   ? 1 / mm
                    : b == 202 ? d->ref / mm
                    : b == 203 ? d->f2 / mm
                    : b == 301 ? -kk / mm
                    : b == 102 ? -d->pos / mm
                    : b == 101 ? -d->acc / mm
                               : J;
            if (IS("no derivatives of state derivatives by parameters") && a == 303 && b < 200) J = 0;
            if (FLAG("begins anew where an input is set") && a == 303 && b / 2 == 101) J = 0;
            if (a == 304) J = b == 201 ? vel : b == 302 ? f : J;
            if (a == 305) J = b == 203;
            if (a == 103) J = b == 102 ? 0.5 / sqrt(d->k * mm) : b == 101 ? -0.5 * sqrt(d->k / mm) / mm : J;
            if (a == 104) J = b == 101 ? 0.5 : J;
            if (IS("no derivatives of calculated parameters") && (a == 104 || a == 103)) J = 0;
            if (IS("the last parameter alone has a derivative") && a == 103) sum = 0;
            sum += J * seed[k];
        }
        out[i] = sum;
    }
    return fmi2OK;
}
/* serialised and saved states */
fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *st) {
    Slave *s = c;
    if (s->d.state == PEND) return err(s, "pending");
    if (IS("a second state crashes") && !*st && s->states++) abort();
    if (!*st) *st = calloc(1, sizeof(Data));
    memcpy(*st, &s->d, sizeof(Data));
    if (!s->first_state) s->first_state = *st;
    return fmi2OK;
}
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate st) {
    Slave *s = c;
    static Data old;
    memcpy(&old, &s->d, sizeof old);
    if (s->d.state == PEND) return err(s, "pending");
    if (!st) return err(s, "no state");
    if (IS("a late step ends all states") && s->late) return err(s, "too late");
    if (IS("the flag ends all states") && s->flushed) return err(s, "flushed");
    s->is_back = 1;
    memcpy(&s->d, st, sizeof(Data));
    if (IS("late states keep time alone") && s->d.time > 2.6) {
        const double time = s->d.time;
        memcpy(&s->d, &old, sizeof old);
        s->d.time = time;
    }
    if (IS("states without Strings")) strcpy(s->d.label, old.label), strcpy(s->d.text_in, old.text_in);
    if (IS("states with the start value of a parameter")) s->d.k = 4;
    if (IS("states without the stop time")) s->d.stop = INFINITY;
    if (IS("states without the next sample") && old.next_sample) s->d.next_sample = old.next_sample;
    if (IS("states without derivatives of inputs")) s->d.df = old.df, s->d.df2 = old.df2;
    return fmi2OK;
}
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *st) {
    Slave *s = c;
    if (!*st) return fmi2OK;
    if (s->first_state == *st) s->first_state = NULL;
    s->states--;
    free(*st);
    *st = NULL;
    return fmi2OK;
}
static int forgets(const Data *d) { return IS("a size of the start value of a String") && strlen(d->text_in) > 2; }
fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate st, size_t *n) {
    Slave *s = c;
    *n = sizeof(Data) - (forgets(st) ? 8 : 0);
    if (IS("a size of a String of the present")) *n += strlen(s->d.text_in);
    return fmi2OK;
}
fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate st, fmi2Byte b[], size_t n) {
    memcpy(b, IS("bytes of the present") ? (void *)&((Slave *)c)->d : st,
           n < sizeof(Data) && !forgets(st) ? n : sizeof(Data));
    if (IS("bytes of another time beside another instance") && c != first) ((Data *)b)->time += 0.01;
    return fmi2OK;
}
fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte b[], size_t n, fmi2FMUstate *st) {
    Slave *s = c;
    if (IS("reading bytes acts at once")) memcpy(&s->d, b, sizeof(Data));
    if (!*st) *st = calloc(1, sizeof(Data));
    memcpy(*st, b, n < sizeof(Data) ? n : sizeof(Data));
    if (IS("late bytes are of the present") && ((Data *)*st)->time > 2.6) memcpy(*st, &s->d, sizeof(Data));
    if (IS("bytes without a fixed parameter")) ((Data *)*st)->m = 1.5;
    return fmi2OK;
}
