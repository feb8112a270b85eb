/* A master that makes every call of a native FMU, and every mistake.  It includes the wrapper, and thereby knows the
   layout. */
#include "fmi2.c"

enum { STEPS = 20, INPUT_COUNT = STATES - INPUTS };

static int sentences, living;

static void hear(void *environment, String instance, Status status, String category, String message, ...) {
    char text[600];
    va_list arguments;
    (void)environment, (void)instance, (void)category;
    va_start(arguments, message);
    sentences += status == ERROR && vsnprintf(text, sizeof text, message, arguments) > 0;
    va_end(arguments);
}

static void *counted_allocate(size_t count, size_t size) { living++; return calloc(count, size); }
static void counted_release(void *block) { living--; free(block); }
static void *no_memory(size_t count, size_t size) { (void)count, (void)size; return NULL; }

#define EXPECT(condition) \
    do { if (!(condition)) { fprintf(stderr, "line %d: %s\n", __LINE__, #condition); exit(1); } } while (0)
#define REFUSED(call) do { int before = sentences; EXPECT((call) == ERROR && sentences == before + 1); } while (0)

static Callbacks callbacks = {hear, counted_allocate, counted_release, NULL, NULL};
static Reference all[SIZE + 1], directed[STATES + 1];
static double values[SIZE + 1], ones[SIZE + 1];

static Instance *make(void) {
    Instance *self = fmi2Instantiate("one", CO_SIMULATION, GUID, NULL, &callbacks, 0, 0);
    EXPECT(self);
    return self;
}

static void begin_run(Instance *self) {
    EXPECT(fmi2SetupExperiment(self, 0, 0.0, 0.0, 0, 0.0) == OK);
    EXPECT(fmi2EnterInitializationMode(self) == OK);
    EXPECT(fmi2ExitInitializationMode(self) == OK);
}

static size_t reals(size_t from, size_t to, Reference found[]) {
    size_t n = 0;
    for (size_t place = from; place < to; place++)
        if (TYPES[place] == 'R') found[n++] = (Reference)place;
    return n;
}

static void derivatives(Instance *self) {
    size_t n_unknowns = reals(OUTPUTS, SIZE, all), n_knowns = reals(INPUTS, STATES, directed);
    if (self->now.phase == INITIALIZING) n_knowns += reals(PARAMETERS, CALCULATED, directed + n_knowns);
    EXPECT(fmi2GetDirectionalDerivative(self, all, n_unknowns, directed, n_knowns, ones, values) == OK);
    EXPECT(fmi2GetDirectionalDerivative(self, NULL, 0, NULL, 0, NULL, NULL) == OK);
}

static void refused_references(Instance *self) {
    const Reference bad[] = {0, 1, SIZE, SIZE + 1, 0x7fffffff, 0x80000000u, 0xffffffffu};
    int integer;
    String string = "text";
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        REFUSED(fmi2GetReal(self, bad + i, 1, values));
        REFUSED(fmi2GetInteger(self, bad + i, 1, &integer));
        REFUSED(fmi2GetBoolean(self, bad + i, 1, &integer));
        REFUSED(fmi2GetString(self, bad + i, 1, &string));
        REFUSED(fmi2SetReal(self, bad + i, 1, values));
        REFUSED(fmi2SetString(self, bad + i, 1, &string));
        if (self->now.phase != INSTANTIATED) {
            REFUSED(fmi2GetDirectionalDerivative(self, bad + i, 1, NULL, 0, NULL, values));
            REFUSED(fmi2GetDirectionalDerivative(self, NULL, 0, bad + i, 1, ones, values));
        }
    }
    const Reference running[] = {SIZE - 2, SIZE - 1, SIZE, STATES - 1, STATES};
    REFUSED(fmi2GetReal(self, running, 3, values));
    REFUSED(fmi2SetReal(self, running + 3, 2, values));
}

static void empty_arrays(Instance *self) {
    EXPECT(fmi2GetReal(self, NULL, 0, NULL) == OK && fmi2SetReal(self, NULL, 0, NULL) == OK);
    EXPECT(fmi2GetInteger(self, NULL, 0, NULL) == OK && fmi2SetInteger(self, NULL, 0, NULL) == OK);
    EXPECT(fmi2GetBoolean(self, NULL, 0, NULL) == OK && fmi2SetBoolean(self, NULL, 0, NULL) == OK);
    EXPECT(fmi2GetString(self, NULL, 0, NULL) == OK && fmi2SetString(self, NULL, 0, NULL) == OK);
    EXPECT(fmi2SetDebugLogging(self, 1, 0, NULL) == OK);
}

static void every_value(Instance *self) {
    size_t n = reals(PARAMETERS, SIZE, all);
    EXPECT(fmi2GetReal(self, all, n, values) == OK);
    EXPECT(fmi2GetReal(self, all + n - 1, 1, values) == OK);
    for (Reference place = PARAMETERS; place < SIZE; place++) {
        int integer = 0;
        if (TYPES[place] == 'I') EXPECT(fmi2GetInteger(self, &place, 1, &integer) == OK);
        if (TYPES[place] == 'B') EXPECT(fmi2GetBoolean(self, &place, 1, &integer) == OK);
        if (place < CALCULATED && self->now.phase <= INITIALIZING) {
            if (TYPES[place] == 'I') EXPECT(fmi2SetInteger(self, &place, 1, &integer) == OK);
            if (TYPES[place] == 'B') EXPECT(fmi2SetBoolean(self, &place, 1, &integer) == OK);
        }
    }
}

static void states(Instance *self) {
    State *saved = NULL, *copy = NULL;
    size_t size = 0;
    EXPECT(fmi2GetFMUstate(self, &saved) == OK && fmi2GetFMUstate(self, &saved) == OK);
    EXPECT(fmi2SerializedFMUstateSize(self, saved, &size) == OK);
    char *bytes = malloc(size);
    REFUSED(fmi2SerializeFMUstate(self, saved, bytes, size - 1));
    EXPECT(fmi2SerializeFMUstate(self, saved, bytes, size) == OK);
    REFUSED(fmi2DeSerializeFMUstate(self, bytes, size - 1, &copy));
    REFUSED(fmi2DeSerializeFMUstate(self, bytes, 0, &copy));
    EXPECT(fmi2DeSerializeFMUstate(self, bytes, size, &copy) == OK);
    EXPECT(fmi2DeSerializeFMUstate(self, bytes, size, &copy) == OK);
    bytes[0] ^= 1;
    REFUSED(fmi2DeSerializeFMUstate(self, bytes, size, &copy));
    EXPECT(memcmp(&copy->memory, &saved->memory, sizeof saved->memory) == 0);
    EXPECT(fmi2SetFMUstate(self, copy) == OK);
    REFUSED(fmi2SetFMUstate(self, NULL));
    EXPECT(fmi2FreeFMUstate(self, &saved) == OK && fmi2FreeFMUstate(self, &saved) == OK && !saved);
    EXPECT(fmi2FreeFMUstate(self, &copy) == OK);
    free(bytes);
}

static void answers_of_few_words(Instance *self) {
    Status status;
    double real;
    int integer;
    String string;
    REFUSED(fmi2SetRealInputDerivatives(self, NULL, 0, NULL, NULL));
    REFUSED(fmi2GetRealOutputDerivatives(self, NULL, 0, NULL, NULL));
    REFUSED(fmi2CancelStep(self));
    for (int kind = DO_STEP_STATUS; kind <= TERMINATED; kind++) {
        EXPECT(fmi2GetStatus(self, kind, &status) == DISCARD && fmi2GetIntegerStatus(self, kind, &integer) == DISCARD);
        EXPECT(fmi2GetStringStatus(self, kind, &string) == DISCARD);
        EXPECT(fmi2GetRealStatus(self, kind, &real) == (kind == LAST_SUCCESSFUL_TIME ? OK : DISCARD));
        EXPECT(fmi2GetBooleanStatus(self, kind, &integer) == (kind == TERMINATED ? OK : DISCARD));
    }
}

static void steps(Instance *self) {
    Reference places[INPUT_COUNT + 1];
    double at[INPUT_COUNT + 1];
    for (Reference i = 0; i < INPUT_COUNT; i++) places[i] = INPUTS + i;
    for (int k = 0; k < STEPS; k++) {
        for (int i = 0; i < INPUT_COUNT; i++) at[i] = 0.1 * sin(k + i);
        EXPECT(fmi2SetReal(self, places, INPUT_COUNT, at) == OK);
        EXPECT(fmi2DoStep(self, 0.01 * k, 0.01, 1) == OK);
        every_value(self);
        derivatives(self);
    }
    EXPECT(fmi2DoStep(self, 0.2, 0.0, 1) == OK && fmi2DoStep(self, 0.2, 1e-300, 1) == OK);
    REFUSED(fmi2DoStep(self, NAN, 0.01, 1));
    REFUSED(fmi2DoStep(self, 0.2, INFINITY, 1));
    REFUSED(fmi2DoStep(self, 0.2, -0.01, 1));
    if (INPUT_COUNT > 0) {
        at[0] = NAN;
        EXPECT(fmi2SetReal(self, places, 1, at) == OK);
        REFUSED(fmi2DoStep(self, 0.2, 0.01, 1));
        derivatives(self);
    }
}

static void refused_instances(void) {
    Callbacks mute = {NULL, no_memory, NULL, NULL, NULL}, forgetful = {hear, no_memory, free, NULL, NULL};
    int before = sentences;
    EXPECT(!fmi2Instantiate("one", MODEL_EXCHANGE, GUID, NULL, &callbacks, 0, 0));
    EXPECT(!fmi2Instantiate("one", CO_SIMULATION, NULL, NULL, &callbacks, 0, 0));
    EXPECT(!fmi2Instantiate("one", CO_SIMULATION, "", NULL, &callbacks, 0, 0));
    EXPECT(!fmi2Instantiate(NULL, CO_SIMULATION, "{other}", NULL, &callbacks, 0, 0));
    EXPECT(!fmi2Instantiate("one", CO_SIMULATION, GUID, NULL, &forgetful, 0, 0));
    EXPECT(sentences == before + 5);
    EXPECT(!fmi2Instantiate("one", CO_SIMULATION, GUID, NULL, &mute, 0, 0));
    fmi2FreeInstance(NULL);
}

int main(void) {
    for (int i = 0; i <= SIZE; i++) ones[i] = 1.0;
    EXPECT(!strcmp(fmi2GetVersion(), "2.0") && !strcmp(fmi2GetTypesPlatform(), "default"));
    refused_instances();
    Instance *self = make(), *other = make();
    REFUSED(fmi2DoStep(self, 0.0, 0.01, 1));
    REFUSED(fmi2GetDirectionalDerivative(self, NULL, 0, NULL, 0, NULL, NULL));
    empty_arrays(self), every_value(self), states(self), refused_references(self), answers_of_few_words(self);
    EXPECT(fmi2EnterInitializationMode(self) == OK);
    REFUSED(fmi2SetupExperiment(self, 0, 0.0, 0.0, 0, 0.0));
    empty_arrays(self), every_value(self), derivatives(self), states(self), refused_references(self);
    EXPECT(fmi2ExitInitializationMode(self) == OK);
    REFUSED(fmi2ExitInitializationMode(self));
    empty_arrays(self), refused_references(self), steps(self), states(self), answers_of_few_words(self);
    if (CALCULATED > PARAMETERS) REFUSED(fmi2SetReal(self, (Reference[]){PARAMETERS}, 1, values));
    REFUSED(fmi2SetReal(self, (Reference[]){SIZE - 1}, 1, values));
    EXPECT(fmi2Terminate(self) == OK);
    REFUSED(fmi2Terminate(self));
    REFUSED(fmi2SetReal(self, NULL, 0, NULL));
    every_value(self);
    EXPECT(fmi2Reset(self) == OK);
    begin_run(self), begin_run(other);
    steps(self), steps(other);
    State *saved = NULL;
    EXPECT(fmi2GetFMUstate(self, &saved) == OK && fmi2SetFMUstate(other, saved) == OK);
    EXPECT(fmi2FreeFMUstate(other, &saved) == OK);
    fmi2FreeInstance(self), fmi2FreeInstance(other);
    EXPECT(living == 0);

    callbacks.allocate = NULL, callbacks.release = NULL, callbacks.logger = NULL;
    self = make();
    EXPECT(fmi2DoStep(self, 0.0, 0.01, 1) == ERROR);
    begin_run(self), every_value(self), fmi2FreeInstance(self);
    puts("through");
    return 0;
}
