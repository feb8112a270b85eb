/* FMI 2.0 for co-simulation of a model that is given as generated functions of one flat memory,

       [ t, h | parameters | calculated | inputs | states | outputs ]

   in which a place is a value reference.  model.h tells the layout, equations.h has the functions, each of the head of
   the memory:

       calculate, initial, step   what follows in the memory; step gives states and outputs
       d_step                     the change of what step gives at t + h with h = 0, for a change of the inputs
       d_start                    the change of what all three give at the start, for a change of parameters and inputs

   An instance has no memory but its own. */

#include <math.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "model.h"

/* Private to this file: the C library has a `step` of its own. */
#ifdef __GNUC__
#define CASADI_SYMBOL_EXPORT static __attribute__((unused))
#else
#define CASADI_SYMBOL_EXPORT static
#endif
#include "equations.h"

#ifdef _WIN32
#define FMI __declspec(dllexport)
#else
#define FMI __attribute__((visibility("default")))
#endif

typedef enum { OK, WARNING, DISCARD, ERROR, FATAL, PENDING } Status;
typedef enum { MODEL_EXCHANGE, CO_SIMULATION } Type;
typedef enum { DO_STEP_STATUS, PENDING_STATUS, LAST_SUCCESSFUL_TIME, TERMINATED } StatusKind;
typedef unsigned int Reference;
typedef int Boolean;
typedef const char *String;

typedef struct {
    void (*logger)(void *environment, String instance, Status, String category, String message, ...);
    void *(*allocate)(size_t count, size_t size);
    void (*release)(void *);
    void (*step_finished)(void *environment, Status);
    void *environment;
} Callbacks;

enum { T, H };
enum { N_INPUTS = STATES - INPUTS, N_OUTPUTS = SIZE - OUTPUTS, N_RESULTS = SIZE - STATES }; /* states and outputs */
enum { INSTANTIATED = 1, INITIALIZING = 2, STEPPING = 4, TERMINATED_PHASE = 8, ANY = 15 };

typedef struct {
    double memory[SIZE + 1];
    int phase;
    int stale; /* while initializing: something was set since the memory was last computed */
} State;

typedef struct {
    State now;
    Callbacks callbacks;
    char *name;
    double results[N_RESULTS + 1];
    double work[WORK + 1];
} Instance;

/* --- Words -------------------------------------------------------------------------------------------------------- */

static Status fail(const Instance *self, const char *format, ...) {
    char text[512];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    if (self->callbacks.logger)
        self->callbacks.logger(self->callbacks.environment, self->name, ERROR, "logStatusError", "%s", text);
    return ERROR;
}

static int legal(const Instance *self, int phases, const char *call) {
    if (self->now.phase & phases) return 1;
    fail(self, "%s must not be called %s", call,
         self->now.phase == INSTANTIATED   ? "before initialization mode"
         : self->now.phase == INITIALIZING ? "in initialization mode"
         : self->now.phase == STEPPING     ? "after initialization mode"
                                           : "after fmi2Terminate");
    return 0;
}

static const char *kind_of(size_t place) {
    return place < CALCULATED ? "parameter"
           : place < INPUTS   ? "calculated parameter"
           : place < STATES   ? "input"
           : place < OUTPUTS  ? "state"
                              : "output";
}

/* --- Numbers ------------------------------------------------------------------------------------------------------ */

/* Whether all are finite: adding one to an exponent of nothing but ones runs into the sign. */
static inline int all_finite(const double *values, size_t n) {
    uint64_t met = 0;
    for (size_t i = 0; i < n; i++) {
        uint64_t bits;
        memcpy(&bits, values + i, sizeof bits);
        met |= (bits & UINT64_C(0x7fffffffffffffff)) + UINT64_C(0x0010000000000000);
    }
    return !(met >> 63);
}

/* printf has other words on other platforms: -nan, nan(ind). */
static const char *word_of(double value) { return isnan(value) ? "nan" : value > 0.0 ? "inf" : "-inf"; }

static Status not_finite(const Instance *self) {
    const double *memory = self->now.memory;
    for (size_t place = PARAMETERS; place < STATES; place++)
        if (!isfinite(memory[place]))
            return fail(self, "%s %s is not finite: %s", kind_of(place), NAMES[place], word_of(memory[place]));
    for (size_t i = 0; i < N_RESULTS; i++)
        if (!isfinite(self->results[i]))
            return fail(self, "%s %s is not finite: %s", kind_of(STATES + i), NAMES[STATES + i],
                        word_of(self->results[i]));
    return ERROR;
}

typedef int Function(const double **arguments, double **results, int *integer_work, double *work, int memory);

static void evaluate(Function *function, const double *head, const double *direction, double *result, double *work) {
    const double *arguments[2] = {head, direction};
    double *results[1] = {result};
    function(arguments, results, NULL, work, 0);
}

/* While initializing, what has been computed follows what was set last. */
static void refresh(Instance *self) {
    double *memory = self->now.memory;
    if (!self->now.stale) return;
    memory[H] = 0.0;
    evaluate(calculate, memory, NULL, memory + CALCULATED, self->work);
    evaluate(initial, memory, NULL, memory + STATES, self->work);
    evaluate(step, memory, NULL, self->results, self->work);
    memcpy(memory + OUTPUTS, self->results + (OUTPUTS - STATES), (SIZE - OUTPUTS) * sizeof(double));
    self->now.stale = 0;
}

static int known(const Instance *self, const char *call, Reference place, char type) {
    if (place >= PARAMETERS && place < SIZE && TYPES[place] == type) return 1;
    fail(self, "%s: no variable of that type has value reference %u", call, place);
    return 0;
}

static int settable(const Instance *self, const char *call, Reference place, char type) {
    if (!known(self, call, place, type)) return 0;
    if (place >= INPUTS && place < STATES) return 1;
    if (place < CALCULATED && self->now.phase != STEPPING) return 1;
    fail(self, "%s: %s %s cannot be set%s", call, kind_of(place), NAMES[place],
         place < CALCULATED ? " after initialization mode" : "");
    return 0;
}

/* Whether the places follow one another from `first` on, before `end`: then they are copied at once. */
static inline int is_block(const Reference places[], size_t n, size_t first, size_t end) {
    return n > 0 && n <= end - first && places[0] >= first && places[0] <= end - n &&
           memcmp(places, PLACES + places[0], n * sizeof *places) == 0;
}

/* Copies of a size that is known when compiling take no call. */
static inline void copy(double *to, const double *from, size_t n) {
    if (n == N_INPUTS) memcpy(to, from, N_INPUTS * sizeof *to);
    else if (n == N_OUTPUTS) memcpy(to, from, N_OUTPUTS * sizeof *to);
    else if (n == N_RESULTS) memcpy(to, from, N_RESULTS * sizeof *to);
    else memcpy(to, from, n * sizeof *to);
}

#define GET(function, call, type, sort)                                                          \
    Status function(Instance *self, const Reference places[], size_t n, type values[]) {         \
        if (self->now.phase <= INITIALIZING) refresh(self);                                      \
        for (size_t i = 0; i < n; i++) {                                                         \
            if (!known(self, call, places[i], sort)) return ERROR;                              \
            values[i] = (type)self->now.memory[places[i]];                                       \
        }                                                                                        \
        return OK;                                                                               \
    }

#define SET(function, call, type, sort)                                                          \
    Status function(Instance *self, const Reference places[], size_t n, const type values[]) {   \
        if (!legal(self, INSTANTIATED | INITIALIZING | STEPPING, call)) return ERROR;           \
        self->now.stale = 1;                                                                     \
        for (size_t i = 0; i < n; i++) {                                                         \
            if (!settable(self, call, places[i], sort)) return ERROR;                           \
            self->now.memory[places[i]] = values[i];                                             \
        }                                                                                        \
        return OK;                                                                               \
    }

static GET(get_reals, "fmi2GetReal", double, 'R')
static SET(set_reals, "fmi2SetReal", double, 'R')
FMI GET(fmi2GetInteger, "fmi2GetInteger", int, 'I')
FMI SET(fmi2SetInteger, "fmi2SetInteger", int, 'I')
FMI GET(fmi2GetBoolean, "fmi2GetBoolean", Boolean, 'B')
FMI SET(fmi2SetBoolean, "fmi2SetBoolean", Boolean, 'B')

FMI Status fmi2GetReal(Instance *self, const Reference places[], size_t n, double values[]) {
    if (self->now.phase <= INITIALIZING || !ALL_REAL || !is_block(places, n, STATES, SIZE))
        return get_reals(self, places, n, values);
    copy(values, self->now.memory + places[0], n);
    return OK;
}

FMI Status fmi2SetReal(Instance *self, const Reference places[], size_t n, const double values[]) {
    if (self->now.phase != STEPPING || !ALL_REAL || !is_block(places, n, INPUTS, STATES))
        return set_reals(self, places, n, values);
    copy(self->now.memory + places[0], values, n);
    self->now.stale = 1;
    return OK;
}

FMI Status fmi2GetString(Instance *self, const Reference places[], size_t n, String values[]) {
    (void)values;
    return n == 0 || known(self, "fmi2GetString", places[0], 'S') ? OK : ERROR;
}

FMI Status fmi2SetString(Instance *self, const Reference places[], size_t n, const String values[]) {
    (void)values;
    return n == 0 || known(self, "fmi2SetString", places[0], 'S') ? OK : ERROR;
}

/* --- Life --------------------------------------------------------------------------------------------------------- */

FMI String fmi2GetTypesPlatform(void) { return "default"; }
FMI String fmi2GetVersion(void) { return "2.0"; }

static void *allocate(const Callbacks *callbacks, size_t size) {
    return callbacks->allocate ? callbacks->allocate(1, size) : calloc(1, size);
}

static void release(const Callbacks *callbacks, void *block) {
    if (callbacks->release) callbacks->release(block);
    else free(block);
}

static void begin(State *state) {
    memcpy(state->memory, START, sizeof START);
    state->phase = INSTANTIATED;
    state->stale = 1;
}

FMI void *fmi2Instantiate(String name, Type type, String guid, String resources, const Callbacks *callbacks,
                          Boolean visible, Boolean logging) {
    Instance nobody = {.callbacks = *callbacks, .name = (char *)(name ? name : "")};
    (void)resources, (void)visible, (void)logging;
    if (type != CO_SIMULATION) {
        fail(&nobody, "the model is for co-simulation, not for model exchange");
        return NULL;
    }
    if (!guid || strcmp(guid, GUID) != 0) {
        fail(&nobody, "the GUID %s is of another build of the model; this one's is " GUID, guid ? guid : "(none)");
        return NULL;
    }
    Instance *self = allocate(callbacks, sizeof *self);
    char *copy = allocate(callbacks, strlen(nobody.name) + 1);
    if (!self || !copy) {
        fail(&nobody, "out of memory");
        if (self) release(callbacks, self);
        if (copy) release(callbacks, copy);
        return NULL;
    }
    self->callbacks = *callbacks;
    self->name = strcpy(copy, nobody.name);
    begin(&self->now);
    return self;
}

FMI void fmi2FreeInstance(Instance *self) {
    if (!self) return;
    Callbacks callbacks = self->callbacks;
    release(&callbacks, self->name);
    release(&callbacks, self);
}

FMI Status fmi2SetDebugLogging(Instance *self, Boolean on, size_t n, const String categories[]) {
    (void)self, (void)on, (void)n, (void)categories;
    return OK;
}

FMI Status fmi2SetupExperiment(Instance *self, Boolean has_tolerance, double tolerance, double start_time,
                               Boolean has_stop_time, double stop_time) {
    (void)has_tolerance, (void)tolerance, (void)has_stop_time, (void)stop_time;
    if (!legal(self, INSTANTIATED, "fmi2SetupExperiment")) return ERROR;
    self->now.memory[T] = start_time;
    self->now.stale = 1;
    return OK;
}

FMI Status fmi2EnterInitializationMode(Instance *self) {
    if (!legal(self, INSTANTIATED, "fmi2EnterInitializationMode")) return ERROR;
    self->now.phase = INITIALIZING;
    return OK;
}

FMI Status fmi2ExitInitializationMode(Instance *self) {
    if (!legal(self, INITIALIZING, "fmi2ExitInitializationMode")) return ERROR;
    refresh(self);
    self->now.phase = STEPPING;
    return OK;
}

FMI Status fmi2Terminate(Instance *self) {
    if (!legal(self, STEPPING, "fmi2Terminate")) return ERROR;
    self->now.phase = TERMINATED_PHASE;
    return OK;
}

FMI Status fmi2Reset(Instance *self) {
    begin(&self->now);
    return OK;
}

/* A step that fails leaves time, states and outputs as they were. */
FMI Status fmi2DoStep(Instance *self, double t, double h, Boolean no_going_back) {
    double *memory = self->now.memory, t_before = memory[T], h_before = memory[H];
    (void)no_going_back;
    if (!legal(self, STEPPING, "fmi2DoStep")) return ERROR;
    if (!(isfinite(t) && isfinite(h) && h >= 0.0)) return fail(self, "a step from %g over %g s cannot be taken", t, h);
    memory[T] = t;
    memory[H] = h;
    evaluate(step, memory, NULL, self->results, self->work);
    if (!all_finite(memory + INPUTS, N_INPUTS) || !all_finite(self->results, N_RESULTS)) {
        memory[T] = t_before;
        memory[H] = h_before;
        return not_finite(self);
    }
    memcpy(memory + STATES, self->results, N_RESULTS * sizeof(double));
    return OK;
}

/* --- Saved states ------------------------------------------------------------------------------------------------- */

FMI Status fmi2GetFMUstate(Instance *self, State **saved) {
    if (!*saved) *saved = allocate(&self->callbacks, sizeof **saved);
    if (!*saved) return fail(self, "out of memory");
    **saved = self->now;
    return OK;
}

FMI Status fmi2SetFMUstate(Instance *self, const State *saved) {
    if (!saved) return fail(self, "fmi2SetFMUstate: no state");
    self->now = *saved;
    return OK;
}

FMI Status fmi2FreeFMUstate(Instance *self, State **saved) {
    if (*saved) release(&self->callbacks, *saved);
    *saved = NULL;
    return OK;
}

/* The bytes: the GUID, then the state. */
enum { PREFIX = sizeof GUID };

FMI Status fmi2SerializedFMUstateSize(Instance *self, const State *saved, size_t *size) {
    (void)self, (void)saved;
    *size = PREFIX + sizeof(State);
    return OK;
}

FMI Status fmi2SerializeFMUstate(Instance *self, const State *saved, char bytes[], size_t size) {
    if (size < PREFIX + sizeof(State)) return fail(self, "%zu bytes do not hold a state", size);
    memcpy(bytes, GUID, PREFIX);
    memcpy(bytes + PREFIX, saved, sizeof(State));
    return OK;
}

FMI Status fmi2DeSerializeFMUstate(Instance *self, const char bytes[], size_t size, State **saved) {
    if (size < PREFIX + sizeof(State) || memcmp(bytes, GUID, PREFIX) != 0)
        return fail(self, "the bytes are not of a state of this model");
    if (!*saved) *saved = allocate(&self->callbacks, sizeof **saved);
    if (!*saved) return fail(self, "out of memory");
    memcpy(*saved, bytes + PREFIX, sizeof(State));
    return OK;
}

/* --- Derivatives -------------------------------------------------------------------------------------------------- */

/* Of outputs, and while initializing of calculated parameters; by inputs, and while initializing by parameters. */
FMI Status fmi2GetDirectionalDerivative(Instance *self, const Reference unknowns[], size_t n_unknowns,
                                        const Reference knowns[], size_t n_knowns, const double directions[],
                                        double changes[]) {
    static const char call[] = "fmi2GetDirectionalDerivative";
    double direction[STATES + 1] = {0}, change[SIZE] = {0};
    if (!legal(self, INITIALIZING | STEPPING, call)) return ERROR;
    for (size_t i = 0; i < n_knowns; i++) {
        if (!settable(self, call, knowns[i], 'R')) return ERROR;
        direction[knowns[i]] += directions[i];
    }
    if (self->now.phase == INITIALIZING) {
        double calculated_and_results[INPUTS - CALCULATED + N_RESULTS + 1];
        evaluate(d_start, self->now.memory, direction, calculated_and_results, self->work);
        memcpy(change + CALCULATED, calculated_and_results, (INPUTS - CALCULATED) * sizeof(double));
        memcpy(change + STATES, calculated_and_results + (INPUTS - CALCULATED), N_RESULTS * sizeof(double));
    } else {
        evaluate(d_step, self->now.memory, direction + INPUTS, change + STATES, self->work);
    }
    for (size_t i = 0; i < n_unknowns; i++) {
        Reference place = unknowns[i];
        if (!known(self, call, place, 'R')) return ERROR;
        if (place < CALCULATED || (place >= INPUTS && place < STATES))
            return fail(self, "%s: %s %s is not an unknown", call, kind_of(place), NAMES[place]);
        changes[i] = change[place];
    }
    return OK;
}

/* --- What a model of fixed steps without waiting has nothing to say to ---------------------------------------------- */

FMI Status fmi2SetRealInputDerivatives(Instance *self, const Reference places[], size_t n, const int order[],
                                       const double values[]) {
    (void)places, (void)n, (void)order, (void)values;
    return fail(self, "inputs are held over a step; their derivatives cannot be set");
}

FMI Status fmi2GetRealOutputDerivatives(Instance *self, const Reference places[], size_t n, const int order[],
                                        double values[]) {
    (void)places, (void)n, (void)order, (void)values;
    return fail(self, "derivatives of outputs by time are not known");
}

FMI Status fmi2CancelStep(Instance *self) { return fail(self, "steps are done when fmi2DoStep returns"); }

FMI Status fmi2GetStatus(Instance *self, StatusKind kind, Status *value) {
    (void)self, (void)kind, (void)value;
    return DISCARD;
}

FMI Status fmi2GetRealStatus(Instance *self, StatusKind kind, double *value) {
    if (kind != LAST_SUCCESSFUL_TIME) return DISCARD;
    *value = self->now.memory[T] + self->now.memory[H];
    return OK;
}

FMI Status fmi2GetIntegerStatus(Instance *self, StatusKind kind, int *value) {
    (void)self, (void)kind, (void)value;
    return DISCARD;
}

FMI Status fmi2GetBooleanStatus(Instance *self, StatusKind kind, Boolean *value) {
    (void)self;
    if (kind != TERMINATED) return DISCARD;
    *value = 0;
    return OK;
}

FMI Status fmi2GetStringStatus(Instance *self, StatusKind kind, String *value) {
    (void)self, (void)kind, (void)value;
    return DISCARD;
}
