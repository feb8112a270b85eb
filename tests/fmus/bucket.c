/* A slave that fills a bucket, of FMI 2.0, or with -DFMI3 of FMI 3.0.  Its state can be saved: more than its outputs.
   With -DADDRESSES the state holds addresses of its process, as that of some FMUs does. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int getpid(void); /* unistd.h has a write, too */

enum { OK, WARNING, DISCARD, ERROR };
enum { U, Y, BEGAN, REFUSES, TOLERANCE, REALS };

typedef struct {
    double real[REALS], water;
    int32_t steps, process;
    char words[64];
} State;

typedef struct {
    State now;
    int stepping;
    double h; /* of its steps, which must all be of one length */
} Bucket;

static int step(Bucket *b, double t, double h) {
    if (b->h != 0.0 && b->h != h) return ERROR;
    b->h = h;
    b->now.water += h * (1.0 + b->now.real[U]) * (0.5 - b->now.water);
    b->now.real[Y] = b->now.water / 3.0 + t;
    b->now.steps += 1;
    snprintf(b->now.words, sizeof b->now.words, "step %d", (int)b->now.steps);
    return OK;
}

static int copy(Bucket *b, State **saved) {
    if (b->now.real[REFUSES] != 0.0) return ERROR;
    if (!*saved) *saved = malloc(sizeof **saved);
    **saved = b->now;
    (*saved)->process = (int32_t)getpid();
    return OK;
}

static int size_of(Bucket *b, State *saved, size_t *size) {
    *size = sizeof *saved;
    return OK;
}

static int write(Bucket *b, State *saved, char bytes[], size_t size) {
    if (size != sizeof *saved) return ERROR;
    memcpy(bytes, saved, size);
    return OK;
}

static int parse(Bucket *b, const char bytes[], size_t size, State **saved) {
    if (size != sizeof **saved) return ERROR;
    *saved = malloc(size);
    memcpy(*saved, bytes, size);
    return OK;
}

static int set(Bucket *b, State *saved) {
    if (!b->stepping) return ERROR;
#ifdef ADDRESSES
    if (saved->process != (int32_t)getpid()) *(volatile int *)8 = 0;
#endif
    b->now = *saved;
    b->now.real[Y] = -1.0; /* some FMUs compute their outputs anew only when they step */
    return OK;
}

static int release(Bucket *b, State **saved) {
    free(*saved);
    *saved = NULL;
    return OK;
}

static int begin(Bucket *b) {
    b->stepping = 1;
    return OK;
}

#ifndef FMI3

void *fmi2Instantiate(const char *name, int type, const char *guid, const char *where, const void *callbacks,
                      int visible, int logging) {
    Bucket *b = calloc(1, sizeof *b);
    return b;
}
void fmi2FreeInstance(Bucket *b) { free(b); }
int fmi2SetupExperiment(Bucket *b, int tolerant, double tolerance, double start, int d, double e) {
    b->now.real[BEGAN] = start;
    b->now.real[TOLERANCE] = tolerant ? tolerance : -1.0;
    return OK;
}
int fmi2EnterInitializationMode(Bucket *b) { return OK; }
int fmi2ExitInitializationMode(Bucket *b) { return begin(b); }
int fmi2Terminate(Bucket *b) { return OK; }
int fmi2DoStep(Bucket *b, double t, double h, int keep) { return step(b, t, h); }
int fmi2GetReal(Bucket *b, const unsigned r[], size_t n, double v[]) {
    for (size_t i = 0; i < n; i++) v[i] = b->now.real[r[i]];
    return OK;
}
int fmi2SetReal(Bucket *b, const unsigned r[], size_t n, const double v[]) {
    for (size_t i = 0; i < n; i++) b->now.real[r[i]] = v[i];
    return OK;
}
int fmi2GetInteger(Bucket *b, const unsigned r[], size_t n, int v[]) {
    for (size_t i = 0; i < n; i++) v[i] = b->now.steps;
    return OK;
}
int fmi2GetString(Bucket *b, const unsigned r[], size_t n, const char *v[]) {
    for (size_t i = 0; i < n; i++) v[i] = b->now.words;
    return OK;
}
int fmi2GetFMUstate(Bucket *b, State **s) { return copy(b, s); }
int fmi2SerializedFMUstateSize(Bucket *b, State *s, size_t *n) { return size_of(b, s, n); }
int fmi2SerializeFMUstate(Bucket *b, State *s, char bytes[], size_t n) { return write(b, s, bytes, n); }
int fmi2DeSerializeFMUstate(Bucket *b, const char bytes[], size_t n, State **s) { return parse(b, bytes, n, s); }
int fmi2SetFMUstate(Bucket *b, State *s) { return set(b, s); }
int fmi2FreeFMUstate(Bucket *b, State **s) { return release(b, s); }

#else

#include <stdbool.h>

void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *where, bool visible, bool logging,
                                  bool events, bool early, const unsigned required[], size_t n, void *environment,
                                  void *log, void *update) {
    return calloc(1, sizeof(Bucket));
}
void fmi3FreeInstance(Bucket *b) { free(b); }
int fmi3EnterInitializationMode(Bucket *b, bool tolerant, double tolerance, double start, bool d, double e) {
    b->now.real[BEGAN] = start;
    b->now.real[TOLERANCE] = tolerant ? tolerance : -1.0;
    return OK;
}
int fmi3ExitInitializationMode(Bucket *b) { return begin(b); }
int fmi3Terminate(Bucket *b) { return OK; }
int fmi3DoStep(Bucket *b, double t, double h, bool keep, bool *event, bool *end, bool *early, double *reached) {
    *event = *end = *early = false;
    *reached = t + h;
    return step(b, t, h);
}
int fmi3GetFloat64(Bucket *b, const unsigned r[], size_t n, double v[], size_t m) {
    for (size_t i = 0; i < n; i++) v[i] = b->now.real[r[i]];
    return m == n ? OK : ERROR;
}
int fmi3SetFloat64(Bucket *b, const unsigned r[], size_t n, const double v[], size_t m) {
    for (size_t i = 0; i < n; i++) b->now.real[r[i]] = v[i];
    return m == n ? OK : ERROR;
}
int fmi3GetInt32(Bucket *b, const unsigned r[], size_t n, int32_t v[], size_t m) {
    for (size_t i = 0; i < n; i++) v[i] = b->now.steps;
    return m == n ? OK : ERROR;
}
int fmi3GetFMUState(Bucket *b, State **s) { return copy(b, s); }
int fmi3SerializedFMUStateSize(Bucket *b, State *s, size_t *n) { return size_of(b, s, n); }
int fmi3SerializeFMUState(Bucket *b, State *s, unsigned char bytes[], size_t n) { return write(b, s, (char *)bytes, n); }
int fmi3DeserializeFMUState(Bucket *b, const unsigned char bytes[], size_t n, State **s) {
    return parse(b, (const char *)bytes, n, s);
}
int fmi3SetFMUState(Bucket *b, State *s) { return set(b, s); }
int fmi3FreeFMUState(Bucket *b, State **s) { return release(b, s); }

#endif
