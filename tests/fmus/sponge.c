/* An FMI 3.0 FMU for co-simulation: it gives back what it takes, of every type, multiplies a matrix, and has the trouble
   that its parameter `mode` asks for.  An instance named "eventful" insists on event mode. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3Functions.h"

enum { N = 1, MODE = 2, X = 3, A = 4, Y = 5, TIME = 6, EVENTS = 7, LEVEL = 8, IN = 100, OUT = 200, MOST = 8 };
enum { PLAIN, TERMINATE, FAIL, EARLY, NOT_A_NUMBER, WARN };
enum { BYTES = 64 };

typedef struct {
    fmi3LogMessageCallback log;
    fmi3InstanceEnvironment environment;
    size_t n;
    int mode, events, event_mode, in_event_mode;
    double x[MOST], a[MOST * MOST], time, level, next_event;
    fmi3Float64 Float64; fmi3Float32 Float32; fmi3Int8 Int8; fmi3UInt8 UInt8; fmi3Int16 Int16; fmi3UInt16 UInt16;
    fmi3Int32 Int32; fmi3UInt32 UInt32; fmi3Int64 Int64; fmi3UInt64 UInt64; fmi3Boolean Boolean; fmi3Int64 choice;
    char text[BYTES];
    fmi3Byte bytes[BYTES];
    size_t n_bytes;
} Sponge;

const char *fmi3GetVersion(void) { return "3.0"; }
fmi3Status fmi3SetDebugLogging(fmi3Instance i, fmi3Boolean on, size_t n, const fmi3String c[]) { return fmi3OK; }

static fmi3Status say(Sponge *s, fmi3Status status, const char *words) {
    s->log(s->environment, status, "log", words);
    return status;
}

fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3Boolean event_mode, fmi3Boolean early_return, const fmi3ValueReference required[], size_t n_required,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update) {
    if (!strcmp(name, "eventful") && !event_mode) {
        log(environment, fmi3Error, "log", "it wants event mode");
        return NULL;
    }
    if (strcmp(token, "{sponge}")) return NULL;
    char path[4096];
    snprintf(path, sizeof path, "%sword.txt", resources);
    FILE *file = fopen(path, "r");
    Sponge *s = calloc(1, sizeof *s);
    if (!file || !fgets(s->text, BYTES, file)) {
        log(environment, fmi3Error, "log", "its resource is missing");
        return free(s), NULL;
    }
    fclose(file);
    s->log = log;
    s->environment = environment;
    s->n = 2;
    s->event_mode = event_mode;
    s->next_event = 0.025;
    s->a[0] = s->a[3] = s->x[0] = 1.0;
    s->x[1] = 2.0;
    return s;
}

fmi3Status fmi3EnterConfigurationMode(fmi3Instance i) { return fmi3OK; }
fmi3Status fmi3ExitConfigurationMode(fmi3Instance i) { return fmi3OK; }
fmi3Status fmi3EnterInitializationMode(fmi3Instance i, fmi3Boolean a, fmi3Float64 b, fmi3Float64 t, fmi3Boolean c,
                                       fmi3Float64 d) {
    ((Sponge *)i)->time = t;
    return fmi3OK;
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance i) {
    ((Sponge *)i)->in_event_mode = ((Sponge *)i)->event_mode;
    return fmi3OK;
}
fmi3Status fmi3EnterEventMode(fmi3Instance i) {
    ((Sponge *)i)->in_event_mode = 1;
    return fmi3OK;
}
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance i, fmi3Boolean *more, fmi3Boolean *terminate, fmi3Boolean *a,
                                    fmi3Boolean *b, fmi3Boolean *defined, fmi3Float64 *next) {
    Sponge *s = i;
    *more = *terminate = *a = *b = *defined = 0;
    if (!s->in_event_mode) return say(s, fmi3Error, "no event mode");
    if (s->time >= s->next_event - 1e-12) {
        s->events++;
        s->next_event += 0.025;
        *more = 1;
    }
    return fmi3OK;
}
fmi3Status fmi3EnterStepMode(fmi3Instance i) {
    ((Sponge *)i)->in_event_mode = 0;
    return fmi3OK;
}
fmi3Status fmi3Terminate(fmi3Instance i) { return fmi3OK; }
fmi3Status fmi3Reset(fmi3Instance i) { return fmi3OK; }
void fmi3FreeInstance(fmi3Instance i) { free(i); }

fmi3Status fmi3DoStep(fmi3Instance i, fmi3Float64 t, fmi3Float64 h, fmi3Boolean keep, fmi3Boolean *event,
                      fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last) {
    Sponge *s = i;
    *event = *terminate = *early = 0;
    if (s->in_event_mode || fabs(t - s->time) > 1e-9) return say(s, fmi3Error, "a step out of place");
    s->time = *last = t + h;
    if (s->event_mode && s->next_event < s->time - 1e-12) {
        s->time = *last = s->next_event;
        *event = *early = 1;
    }
    s->level = s->events + s->time;
    if (t < 0.02 - 1e-9) return fmi3OK;
    switch (s->mode) {
        case TERMINATE: *terminate = 1; break;
        case FAIL: return say(s, fmi3Error, "the sponge is full: 100 % wet");
        case EARLY: *early = 1; *last = t; break;
        case NOT_A_NUMBER: s->Float32 = NAN; break;
        case WARN: return say(s, fmi3Warning, "the sponge is damp");
    }
    return fmi3OK;
}

#define MISCOUNTED "nValues is not the number of values of these variables"
#define EXCHANGE(Type, extra_get, extra_set)                                                                           \
    fmi3Status fmi3Get##Type(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3##Type v[], size_t n_v) {      \
        Sponge *s = i;                                                                                                 \
        size_t j = 0;                                                                                                  \
        for (size_t k = 0; k < n; k++) {                                                                               \
            extra_get                                                                                                  \
            if (r[k] < IN) return say(s, fmi3Error, "no such variable");                                                \
            v[j++] = s->Type;                                                                                          \
        }                                                                                                              \
        return j == n_v ? fmi3OK : say(s, fmi3Error, MISCOUNTED);                                                      \
    }                                                                                                                  \
    fmi3Status fmi3Set##Type(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3##Type v[], size_t n_v) {\
        Sponge *s = i;                                                                                                 \
        size_t j = 0;                                                                                                  \
        for (size_t k = 0; k < n; k++) {                                                                               \
            extra_set                                                                                                  \
            if (r[k] < IN || r[k] >= OUT) return say(s, fmi3Error, "no such input");                                    \
            s->Type = v[j++];                                                                                          \
        }                                                                                                              \
        return j == n_v ? fmi3OK : say(s, fmi3Error, MISCOUNTED);                                                      \
    }

static void multiply(const Sponge *s, double *y) {
    for (size_t i = 0; i < s->n; i++) {
        y[i] = 0.0;
        for (size_t j = 0; j < s->n; j++) y[i] += s->a[i * s->n + j] * s->x[j];
    }
}

#define GET_ARRAY(reference, values, count)                                                                            \
    if (r[k] == reference) {                                                                                           \
        if (n_v < j + (count)) return say(s, fmi3Error, "too few values");                                             \
        memcpy(v + j, values, (count) * sizeof *v);                                                                    \
        j += count;                                                                                                    \
        continue;                                                                                                      \
    }
#define SET_ARRAY(reference, values, count)                                                                            \
    if (r[k] == reference) {                                                                                           \
        if (n_v < j + (count)) return say(s, fmi3Error, "too few values");                                             \
        memcpy(values, v + j, (count) * sizeof *v);                                                                    \
        j += count;                                                                                                    \
        continue;                                                                                                      \
    }

EXCHANGE(Float64,
         double y[MOST]; multiply(s, y);
         GET_ARRAY(X, s->x, s->n) GET_ARRAY(A, s->a, s->n * s->n) GET_ARRAY(Y, y, s->n) GET_ARRAY(TIME, &s->time, 1)
         GET_ARRAY(LEVEL, &s->level, 1),
         SET_ARRAY(X, s->x, s->n) SET_ARRAY(A, s->a, s->n * s->n))
EXCHANGE(Float32, , )
EXCHANGE(Int8, , )
EXCHANGE(UInt8, , )
EXCHANGE(Int16, , )
EXCHANGE(UInt16, , )
EXCHANGE(Int32, GET_ARRAY(MODE, &s->mode, 1) GET_ARRAY(EVENTS, &s->events, 1), SET_ARRAY(MODE, &s->mode, 1))
EXCHANGE(UInt32, , )
EXCHANGE(Int64, if (r[k] == OUT + 30) { v[j++] = s->choice; continue; }, if (r[k] == IN + 30) { s->choice = v[j++]; continue; })
EXCHANGE(UInt64, GET_ARRAY(N, &s->n, 1), SET_ARRAY(N, &s->n, 1))
EXCHANGE(Boolean, , )

fmi3Status fmi3GetString(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3String v[], size_t n_v) {
    for (size_t k = 0; k < n; k++) v[k] = ((Sponge *)i)->text;
    return n_v == n ? fmi3OK : say(i, fmi3Error, MISCOUNTED);
}
fmi3Status fmi3SetString(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3String v[], size_t n_v) {
    for (size_t k = 0; k < n; k++) snprintf(((Sponge *)i)->text, BYTES, "%s", v[k]);
    return n_v == n ? fmi3OK : say(i, fmi3Error, MISCOUNTED);
}
fmi3Status fmi3GetBinary(fmi3Instance i, const fmi3ValueReference r[], size_t n, size_t sizes[], fmi3Binary v[],
                         size_t n_v) {
    for (size_t k = 0; k < n; k++) v[k] = ((Sponge *)i)->bytes, sizes[k] = ((Sponge *)i)->n_bytes;
    return n_v == n ? fmi3OK : say(i, fmi3Error, MISCOUNTED);
}
fmi3Status fmi3SetBinary(fmi3Instance i, const fmi3ValueReference r[], size_t n, const size_t sizes[],
                         const fmi3Binary v[], size_t n_v) {
    Sponge *s = i;
    for (size_t k = 0; k < n; k++) memcpy(s->bytes, v[k], sizes[k] < BYTES ? sizes[k] : BYTES), s->n_bytes = sizes[k];
    return n_v == n ? fmi3OK : say(i, fmi3Error, MISCOUNTED);
}
