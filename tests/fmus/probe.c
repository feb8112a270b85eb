/* An FMI 2.0 slave that echoes its inputs and has the trouble that its parameters ask for.
   With -DTRAP also that which its name asks for.  -DSIZE=n: room for n variables of each type. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

typedef void *Logger(void *, const char *, int, const char *, const char *, ...);
typedef struct { Logger *logger; void *(*allocate)(size_t, size_t); void (*release)(void *); void *done;
                 void *environment; } Callbacks;
enum { OK, WARNING, DISCARD, ERROR, FATAL };
enum { MADE, INITIALIZING, STEPPING, ENDED, FAILED };
enum { U, Y, COUNT, STEPS, FLAG, ODD, TEXT, WORDS, LEVEL, HIDDEN, AT, MODE, VARIABLES };
#ifndef SIZE
#define SIZE VARIABLES
#endif

typedef struct {
    const Callbacks *callbacks;
    char name[64], text[64], words[64];
    double real[SIZE];
    int whole[SIZE], state;
} Probe;

static void expect(Probe *p, const char *call, int legal) {
    if (!legal) fprintf(stderr, "illegal call of %s in state %d\n", call, p->state);
}

static int say(Probe *p, int status, const char *words) {
    if (words) p->callbacks->logger(p->callbacks->environment, p->name, status, "logStatusError", words);
    if (status >= ERROR) p->state = FAILED;
    return status;
}

const char *fmi2GetVersion(void) { return "2.0"; }
const char *fmi2GetTypesPlatform(void) { return "default"; }
int fmi2SetDebugLogging(void *p, int on, size_t n, const char *const c[]) { return OK; }

void *fmi2Instantiate(const char *name, int type, const char *guid, const char *where, const Callbacks *callbacks,
                      int visible, int logging) {
    Probe *p;
    if (!strcmp(name, "stillborn")) {
        callbacks->logger(callbacks->environment, name, ERROR, "logStatusError", "no licence for a probe");
        return NULL;
    }
#ifdef TRAP
    if (!strcmp(name, "falls")) *(volatile int *)0 = 1;
    if (!strcmp(name, "never_loads")) for (;;) ;
#endif
    p = calloc(1, sizeof *p);
    p->callbacks = callbacks;
    snprintf(p->name, sizeof p->name, "%s", name);
    snprintf(p->text, sizeof p->text, "hallo");
    snprintf(p->words, sizeof p->words, "hallo 0");
    p->whole[COUNT] = 3;
    p->whole[FLAG] = 1;
    p->whole[LEVEL] = 1;
    p->real[AT] = 0.02;
    return p;
}

int fmi2SetupExperiment(Probe *p, int a, double b, double c, int d, double e) {
    expect(p, "fmi2SetupExperiment", p->state == MADE);
    return OK;
}

int fmi2EnterInitializationMode(Probe *p) {
    expect(p, "fmi2EnterInitializationMode", p->state == MADE);
    p->state = INITIALIZING;
#ifdef TRAP
    if (!strcmp(p->name, "aborts")) abort();
    if (!strcmp(p->name, "leaves")) exit(3);
    if (!strcmp(p->name, "sleeps")) for (;;) ;
#endif
    if (p->whole[MODE] == 8) p->real[Y] = NAN;
    return p->whole[MODE] == 7 ? say(p, ERROR, "the probe will not wake") : OK;
}

int fmi2ExitInitializationMode(Probe *p) {
    expect(p, "fmi2ExitInitializationMode", p->state == INITIALIZING);
    p->state = STEPPING;
    return OK;
}

int fmi2Terminate(Probe *p) {
    expect(p, "fmi2Terminate", p->state == STEPPING || p->state == ENDED);
    return OK;
}

int fmi2Reset(Probe *p) { return OK; }

void fmi2FreeInstance(Probe *p) {
    expect(p, "fmi2FreeInstance", p->state != FAILED);
#ifdef TRAP
    if (!strcmp(p->name, "never_freed")) for (;;) ;
#endif
    free(p);
}

int fmi2DoStep(Probe *p, double t, double h, int keep) {
    expect(p, "fmi2DoStep", p->state == STEPPING);
    p->real[Y] = t + h;
    p->real[HIDDEN] = -t;
    p->whole[STEPS] = p->whole[STEPS] + p->whole[COUNT];
    p->whole[ODD] = !p->whole[ODD] == p->whole[FLAG];
    p->whole[LEVEL] = p->whole[ODD] ? 7 : 1;
    snprintf(p->words, sizeof p->words, "%s %d", p->text, p->whole[STEPS]);
    if (t < p->real[AT] - 1e-9) return OK;
    switch (p->whole[MODE]) {
        case 1: return say(p, ERROR, "the probe lost its mind: 100 %% sure");
        case 2: p->real[Y] = NAN; return OK;
        case 3: p->real[Y] = -INFINITY; return OK;
        case 4: p->state = ENDED; return say(p, DISCARD, "the probe has seen enough");
        case 5: return say(p, DISCARD, "the step is too large");
        case 6: return say(p, FATAL, NULL);
        case 9: return say(p, WARNING, "the probe feels warm");
        case 10: p->real[HIDDEN] = NAN; return OK;
        case 11: p->state = FAILED; return ERROR;
        case 12: *(volatile int *)NULL = 1; break;
        case 13: abort();
        case 14: exit(3);
        case 16: return 5; /* fmi2Pending */
        case 15: for (;;) sleep(1);
    }
    return OK;
}

int fmi2GetBooleanStatus(Probe *p, int kind, int *value) {
    *value = kind == 3 && p->state == ENDED;
    return OK;
}

#define UNUSED(name) int name(void) { return ERROR; }
UNUSED(fmi2GetFMUstate) UNUSED(fmi2SetFMUstate) UNUSED(fmi2FreeFMUstate) UNUSED(fmi2SerializedFMUstateSize)
UNUSED(fmi2SerializeFMUstate) UNUSED(fmi2DeSerializeFMUstate) UNUSED(fmi2GetDirectionalDerivative)
UNUSED(fmi2SetRealInputDerivatives) UNUSED(fmi2GetRealOutputDerivatives) UNUSED(fmi2CancelStep)
UNUSED(fmi2GetStatus) UNUSED(fmi2GetRealStatus) UNUSED(fmi2GetIntegerStatus) UNUSED(fmi2GetStringStatus)

int fmi2GetReal(Probe *p, const unsigned r[], size_t n, double v[]) {
    for (size_t i = 0; i < n; i++) v[i] = p->real[r[i]];
    return OK;
}
int fmi2SetReal(Probe *p, const unsigned r[], size_t n, const double v[]) {
    for (size_t i = 0; i < n; i++) p->real[r[i]] = v[i];
    return OK;
}
int fmi2GetInteger(Probe *p, const unsigned r[], size_t n, int v[]) {
    for (size_t i = 0; i < n; i++) v[i] = p->whole[r[i]];
    return OK;
}
int fmi2SetInteger(Probe *p, const unsigned r[], size_t n, const int v[]) {
    for (size_t i = 0; i < n; i++) p->whole[r[i]] = v[i];
    return OK;
}
int fmi2GetBoolean(Probe *p, const unsigned r[], size_t n, int v[]) { return fmi2GetInteger(p, r, n, v); }
int fmi2SetBoolean(Probe *p, const unsigned r[], size_t n, const int v[]) { return fmi2SetInteger(p, r, n, v); }
int fmi2GetString(Probe *p, const unsigned r[], size_t n, const char *v[]) {
    for (size_t i = 0; i < n; i++) v[i] = r[i] == TEXT ? p->text : p->words;
    return OK;
}
int fmi2SetString(Probe *p, const unsigned r[], size_t n, const char *const v[]) {
    for (size_t i = 0; i < n; i++) snprintf(p->text, sizeof p->text, "%s", v[i]);
    return OK;
}

#ifdef TRAP
__attribute__((constructor)) static void wake(void) { if (getenv("AWAKE")) fclose(fopen(getenv("AWAKE"), "w")); }
#endif
