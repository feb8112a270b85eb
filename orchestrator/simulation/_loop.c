/* The inner loop of the co-simulation master: gather, set, step, get, publish, record, by the addresses of the FMI
   functions.  loop.py has the same in Python; both give the same rows, bit for bit.  master.py describes what acts when,
   program.py what a Loop is given.

   All arrays belong to numpy and stay where they are: a Loop keeps a reference to the program, which holds them. */

#define Py_LIMITED_API 0x030B0000
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#include <windows.h>
static double now(void) {
    LARGE_INTEGER count, frequency;
    QueryPerformanceCounter(&count);
    QueryPerformanceFrequency(&frequency);
    return (double)count.QuadPart / (double)frequency.QuadPart;
}
#else
#include <time.h>
static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}
#endif

/* Kinds of values, as variables.NUMBERS has them.  LAYOUT, below, lets program.py compare. */
#define EACH_KIND(DO)                                                                                                  \
    DO(REAL, real, double) DO(INTEGER, integer, int32_t) DO(BOOLEAN, boolean, int32_t) DO(FLOAT32, float32, float)     \
    DO(INT8, int8, int8_t) DO(UINT8, uint8, uint8_t) DO(INT16, int16, int16_t) DO(UINT16, uint16, uint16_t)            \
    DO(UINT32, uint32, uint32_t) DO(INT64, int64, int64_t) DO(UINT64, uint64, uint64_t) DO(TRUTH, truth, uint8_t)
/* Passes over whole tables, for the vectors of the machine that runs them: no rounding depends on their width. */
#if defined(__x86_64__) && defined(__gnu_linux__) && defined(__GNUC__) && !defined(__clang__)
#define VECTORIZED __attribute__((target_clones("avx2", "default"), optimize("no-unroll-loops")))
#else
#define VECTORIZED
#endif

#define CONSTANT(constant, name, type) constant,
#define SIZE(constant, name, type) sizeof(type),
#define NAME(constant, name, type) #name " "

enum { EACH_KIND(CONSTANT) KINDS };
static const uint8_t SIZES[KINDS] = {EACH_KIND(SIZE)};

#define MOMENT_NAMES "AT_ONCE TICK_END PERIOD_END"
enum { AT_ONCE, TICK_END, PERIOD_END, MOMENTS };
enum { NOT_FINITE = -1 };
enum { VECTOR = 4 }; /* reals that are passed over at once; arrays of them are padded and aligned, see arrays.py */
enum { FMI_WARNING = 1, FMI_DISCARD, FMI_ERROR };

typedef int Exchange(void *handle, const uint32_t *references, size_t n, void *values);
typedef int Exchange3(void *handle, const uint32_t *references, size_t n, void *values, size_t n_values);
typedef int DoStep(void *handle, double t, double h, int no_going_back);
typedef int DoStep3(void *handle, double t, double h, bool no_going_back, bool *event, bool *terminate, bool *early,
                    double *reached);
typedef void Function(void);

/* Reals that follow one another in the table, or nearly so: whole vectors. */
typedef struct {
    size_t first, n;
} Span;

/* Values that follow one another in the table as they do in a setter's buffer: in bytes. */
typedef struct {
    size_t source, target, size;
} Run;

/* A value on its way into a buffer: factor * value + offset. */
#define CONVERSION_FIELDS "kind source target factor offset"
typedef struct {
    int64_t kind, source, target;
    double factor, offset;
} Conversion;

/* One getter or setter call. */
typedef struct {
    int kind;
    Function *function; /* NULL: the step does it */
    const uint32_t *references;
    size_t n_references, n;
    void *values;
    Run *runs; /* of a setter: where its values come from */
    size_t n_runs;
    const Conversion *conversions;
    size_t n_conversions;
    int staged; /* floats that do not lie in the table: they are checked at once, the table after each tick */
} Call;

typedef struct {
    int kind;
    const void *values;
    const Py_ssize_t *chosen, *targets;
    size_t n;
} Publication;

typedef struct {
    int version; /* of FMI, whose signatures the getters and setters have */
    void *handle;
    Function *step;
    bool *answers; /* of fmi3DoStep: event, terminate, early; NULL: the step is called like fmi2DoStep */
    double *reached;
    double h;
    Py_ssize_t period;
    Call *sets, *gets;
    size_t n_sets, n_gets;
    Publication *published[MOMENTS];
    size_t n_published[MOMENTS];
} Stepper;

/* Outputs that are taken at `ticks`: values[done, :] = those that are chosen. */
typedef struct {
    const int64_t *ticks;
    size_t n_ticks, n;
    const Py_ssize_t *chosen;
    double *values;
    int64_t *done;
} Clock;

/* Outputs that are fed back: see bursts.py. */
typedef struct {
    size_t n, n_others, n_clocks;
    const Py_ssize_t *kinds, *places;
    Span *spans; /* of those that are real */
    size_t n_spans;
    double *squares, *squares_of_others; /* as in the table of reals; of the last n_others, which are not real */
    Clock *clocks;
} Bursts;

/* What metrics need of every tick, and what the envelope of the rows needs: see sampling.py. */
typedef struct {
    size_t n, block, stride; /* signals, ticks of a block, and values from signal to signal in `values` */
    const int64_t *kinds;
    const Py_ssize_t *places;
    double *values; /* (n, stride) */
    Py_ssize_t first;
    size_t n_bounded;
    const Py_ssize_t *bounded; /* places in the table of reals */
    Span *spans;
    size_t n_spans;
    double *least, *largest; /* since the last row, as in the table of reals */
} Samples;

/* A value and what it may be; an angle, and by how much it may jump: see sampling.py. */
#define LIMIT_FIELDS "kind place low high"
typedef struct {
    int64_t kind, place;
    double low, high;
} Limit;

#define ANGLE_FIELDS "place turn before"
typedef struct {
    int64_t place;
    double turn, before;
} Angle;

/* Of a Limit of a real: what lies within these is within. */
typedef struct {
    uint32_t place;
    float low, high;
} Guard;

/* Limits, reals first, then angles. */
typedef struct {
    size_t n_limits, n_reals, n_angles;
    const Limit *limits;
    Guard *guards;
    Angle *angles;
    int64_t *ticks; /* when a value first left its limits, or jumped; -1 before */
    double *first, *farthest;
} Watched;

typedef struct {
    PyObject_HEAD
    PyObject *program; /* owns all memory below that is not freed in loop_dealloc */
    Stepper *steppers;
    const Stepper **late; /* those that publish something at the end of a tick or period */
    size_t n_steppers, n_late;
    void *tables[KINDS];
    size_t n_reals, n_float32; /* of the tables, outputs */
    const Py_ssize_t *recorded[KINDS];
    size_t n_recorded[KINDS];
    Bursts bursts;
    Samples sampled;
    Watched watched;
    double *seconds; /* (steppers, 3): of set, step and get in timed steps */
    int64_t *samples;
    Py_ssize_t sample_every, stride;
    double overhead; /* of looking at the clock */
    const int32_t *interrupt;
    volatile int64_t *place; /* tick * steppers + stepper + 1 */
    int holds_lock, records_inputs;
} Loop;

/* --- The loop ------------------------------------------------------------------------------------------------------- */

static inline size_t size_of(int kind) { return SIZES[kind]; }

/* to[targets[i]] = from[sources[i]]; without targets, in order. */
static void scatter(void *to, const Py_ssize_t *targets, const void *from, const Py_ssize_t *sources, size_t n, int kind) {
#define SCATTER(type)                                                                                                  \
    for (size_t i = 0; i < n; i++) ((type *)to)[targets ? targets[i] : (Py_ssize_t)i] = ((const type *)from)[sources[i]]
    switch (size_of(kind)) {
    case 8: SCATTER(uint64_t); break;
    case 4: SCATTER(uint32_t); break;
    case 2: SCATTER(uint16_t); break;
    default: SCATTER(uint8_t);
    }
#undef SCATTER
}

static double load(const void *table, int64_t place, int64_t kind) {
    switch (kind) {
#define LOAD(constant, name, type) case constant: return (double)((const type *)table)[place];
        EACH_KIND(LOAD)
#undef LOAD
    }
    return NAN;
}

static void store(void *values, int64_t place, int kind, double value) {
    switch (kind) {
#define STORE(constant, name, type) case constant: ((type *)values)[place] = (type)value; break;
        EACH_KIND(STORE)
#undef STORE
    }
}

static void convert(const Call *c, void *const *tables) {
    for (const Conversion *v = c->conversions, *end = v + c->n_conversions; v < end; v++)
        store(c->values, v->target, c->kind, v->factor * load(tables[v->kind], v->source, v->kind) + v->offset);
}

static inline void copy(const Call *c, const Run *run, const void *table) {
    char *to = (char *)c->values + run->target;
    const char *from = (const char *)table + run->source;
    if (run->size == 6 * sizeof(double)) memcpy(to, from, 6 * sizeof(double)); /* a pose, a force: without a call */
    else memcpy(to, from, run->size);
}

static void publish_all(const Loop *self, const Stepper *m, int moment) {
    for (const Publication *p = m->published[moment], *end = p + m->n_published[moment]; p < end; p++)
        scatter(self->tables[p->kind], p->targets, p->values, p->chosen, p->n, p->kind);
}

/* Adding one to an exponent of nothing but ones runs into the sign. */
VECTORIZED static int all_finite(const double *values, size_t n) {
    uint64_t met = 0;
    for (size_t i = 0; i < n; i++) {
        uint64_t bits;
        memcpy(&bits, values + i, sizeof bits);
        met |= (bits & UINT64_C(0x7fffffffffffffff)) + UINT64_C(0x0010000000000000);
    }
    return !(met >> 63);
}

static int all_finite32(const float *values, size_t n) {
    uint32_t met = 0;
    for (size_t i = 0; i < n; i++) {
        uint32_t bits;
        memcpy(&bits, values + i, sizeof bits);
        met |= (bits & UINT32_C(0x7fffffff)) + UINT32_C(0x00800000);
    }
    return !(met >> 31);
}

static int is_finite(const Call *c) {
    if (c->kind == FLOAT32) return all_finite32(c->values, c->n);
    return c->kind != REAL || all_finite(c->values, c->n);
}

static inline int exchange(const Stepper *m, const Call *c) {
    if (m->version == 2) return ((Exchange *)c->function)(m->handle, c->references, c->n_references, c->values);
    return ((Exchange3 *)c->function)(m->handle, c->references, c->n_references, c->values, c->n);
}

static inline int do_step(const Stepper *m, double t) {
    if (!m->answers) return ((DoStep *)m->step)(m->handle, t, m->h, 1);
    bool *a = m->answers;
    int status = ((DoStep3 *)m->step)(m->handle, t, m->h, true, &a[0], &a[1], &a[2], m->reached);
    if ((unsigned)status > FMI_WARNING) return status;
    return a[1] ? FMI_DISCARD : a[2] ? FMI_ERROR : status;
}

/* Returns 0, a status of FMI above fmi2Warning or below 0, or NOT_FINITE; marks: the times before set, step, get and
   at the end, or NULL. */
static int step(const Loop *self, const Stepper *m, double t, double *marks) {
    int status;
    if (marks) marks[0] = now();
    for (const Call *c = m->sets, *end = c + m->n_sets; c < end; c++) {
        for (size_t j = 0; j < c->n_runs; j++) copy(c, &c->runs[j], self->tables[c->kind]);
        if (c->n_conversions) convert(c, self->tables);
        if (!c->function) continue;
        status = exchange(m, c);
        if ((unsigned)status > FMI_WARNING) return status;
    }
    if (marks) marks[1] = now();
    status = do_step(m, t);
    if ((unsigned)status > FMI_WARNING) return status;
    if (marks) marks[2] = now();
    for (const Call *c = m->gets, *end = c + m->n_gets; c < end; c++) {
        if (c->function) {
            status = exchange(m, c);
            if ((unsigned)status > FMI_WARNING) return status;
        }
        if (c->staged && !is_finite(c)) return NOT_FINITE;
    }
    if (m->n_published[AT_ONCE]) publish_all(self, m, AT_ONCE);
    if (marks) marks[3] = now();
    return 0;
}

static void add_times(const Loop *self, size_t stepper, const double *marks) {
    for (int phase = 0; phase < 3; phase++) {
        double seconds = marks[phase + 1] - marks[phase] - self->overhead;
        if (seconds > 0.0) self->seconds[3 * stepper + phase] += seconds;
    }
    self->samples[stepper]++;
}

VECTORIZED static void add_squares(double *restrict squares, const double *restrict values, size_t n) {
    for (size_t i = 0; i < n; i++) squares[i] += values[i] * values[i];
}

VECTORIZED static void widen(double *restrict least, double *restrict largest, const double *restrict values, size_t n) {
    for (size_t i = 0; i < n; i++) {
        least[i] = values[i] < least[i] ? values[i] : least[i];
        largest[i] = values[i] > largest[i] ? values[i] : largest[i];
    }
}

/* tick: that has ended. */
static void look(const Bursts *b, void *const *tables, int64_t tick) {
    for (const Span *s = b->spans, *end = s + b->n_spans; s < end; s++)
        add_squares(b->squares + s->first, (const double *)tables[REAL] + s->first, s->n);
    for (size_t i = 0, first = b->n - b->n_others; i < b->n_others; i++) {
        double value = load(tables[b->kinds[first + i]], b->places[first + i], b->kinds[first + i]);
        b->squares_of_others[i] += value * value;
    }
    for (const Clock *c = b->clocks, *end = c + b->n_clocks; c < end; c++) {
        size_t done = (size_t)*c->done;
        if (done == c->n_ticks || c->ticks[done] != tick) continue;
        for (size_t i = 0; i < c->n; i++) {
            Py_ssize_t place = c->chosen[i];
            c->values[done * c->n + i] = load(tables[b->kinds[place]], b->places[place], b->kinds[place]);
        }
        ++*c->done;
    }
}

static inline double value_of(void *const *tables, int64_t kind, Py_ssize_t place) {
    return kind == REAL ? ((const double *)tables[REAL])[place] : load(tables[kind], place, kind);
}

/* The values at the end of a tick, as column `column`. */
static void take(const Samples *s, void *const *tables, size_t column) {
    double *values = s->values + column;
    for (size_t i = 0; i < s->n; i++, values += s->stride)
        *values = value_of(tables, s->kinds[i], s->places[i]);
}

static void note_limits(const Watched *w, void *const *tables, int64_t tick) {
    for (size_t i = 0; i < w->n_limits; i++) {
        const Limit *l = &w->limits[i];
        double value = value_of(tables, l->kind, l->place), farthest = w->farthest[i];
        if (!(value < l->low || value > l->high)) continue;
        if (w->ticks[i] < 0) {
            w->ticks[i] = tick;
            w->first[i] = w->farthest[i] = value;
        } else if (fmax(l->low - value, value - l->high) > fmax(l->low - farthest, farthest - l->high)) {
            w->farthest[i] = value;
        }
    }
}

static void note_jumps(const Watched *w, const double *reals, int64_t tick) {
    for (size_t i = 0; i < w->n_angles; i++) {
        const Angle *a = &w->angles[i];
        int64_t *noted = &w->ticks[w->n_limits + i];
        double jump = reals[a->place] - a->before;
        if (*noted >= 0 || !(fabs(jump) > a->turn)) continue;
        *noted = tick;
        w->first[w->n_limits + i] = jump;
    }
}

/* tick: that has ended.  The guards are small, and there is one branch for all: this is done in every step. */
static void watch(const Watched *w, void *const *tables, int64_t tick) {
    const double *reals = tables[REAL];
    int beyond = 0, jumped = 0;
    for (const Guard *g = w->guards, *end = g + w->n_reals; g < end; g++) {
        double value = reals[g->place];
        beyond |= (value < (double)g->low) | (value > (double)g->high);
    }
    if (beyond || w->n_reals < w->n_limits) note_limits(w, tables, tick);
    for (const Angle *a = w->angles, *end = a + w->n_angles; a < end; a++)
        jumped |= fabs(reals[a->place] - a->before) > a->turn;
    if (jumped) note_jumps(w, reals, tick);
    for (Angle *a = w->angles, *end = a + w->n_angles; a < end; a++) a->before = reals[a->place];
}

/* The bounds since the last row, as a row (2, n_bounded); then those of nothing. */
static void close_bounds(const Samples *s, double *row) {
    for (size_t i = 0; i < s->n_bounded; i++) {
        Py_ssize_t place = s->bounded[i];
        row[i] = s->least[place];
        row[s->n_bounded + i] = s->largest[place];
        s->least[place] = INFINITY;
        s->largest[place] = -INFINITY;
    }
}

/* The first stepper that has given a value that is not finite. */
static Py_ssize_t not_finite(const Loop *self) {
    for (size_t i = 0; i < self->n_steppers; i++)
        for (size_t j = 0; j < self->steppers[i].n_gets; j++)
            if (!is_finite(&self->steppers[i].gets[j])) return (Py_ssize_t)i;
    return 0;
}

/* Steps from tick `first` until `last`.  Returns the ticks done; *failed: the stepper that failed, or -1. */
static Py_ssize_t advance(const Loop *self, Py_ssize_t first, Py_ssize_t last, const double *times, double patience,
                          void *rows[KINDS], double *bounds, Py_ssize_t *failed, int *status) {
    const Samples *samples = &self->sampled;
    double deadline = now() + patience, marks[4];
    size_t row = 0, column = samples->n ? (size_t)(first + 1 - samples->first) % samples->block : 0;
    Py_ssize_t next_row = (first / self->stride + 1) * self->stride;
    Py_ssize_t next_sample = (first + self->sample_every - 1) / self->sample_every * self->sample_every;
    for (Py_ssize_t k = first; k < last; k++) {
        int timed = k == next_sample;
        if (*(volatile const int32_t *)self->interrupt || (timed && now() > deadline)) return k;
        if (timed) next_sample += self->sample_every;
        for (size_t i = 0; i < self->n_steppers; i++) {
            const Stepper *m = &self->steppers[i];
            if (m->period > 1 && k % m->period) continue;
            *self->place = (int64_t)k * (int64_t)self->n_steppers + (int64_t)i + 1;
            *status = step(self, m, times[k - first], timed ? marks : NULL);
            if (*status) {
                *failed = (Py_ssize_t)i;
                return k;
            }
            if (timed) add_times(self, i, marks);
        }
        if (!all_finite(self->tables[REAL], self->n_reals) ||
            !all_finite32(self->tables[FLOAT32], self->n_float32)) {
            *failed = not_finite(self);
            *status = NOT_FINITE;
            return k;
        }
        for (size_t i = 0; i < self->n_late; i++) {
            const Stepper *m = self->late[i];
            if (m->period == 1 || k % m->period == 0) publish_all(self, m, TICK_END);
            if (m->period == 1 || (k + 1) % m->period == 0) publish_all(self, m, PERIOD_END);
        }
        look(&self->bursts, self->tables, k + 1);
        if (samples->n) take(samples, self->tables, column++);
        for (const Span *s = samples->spans, *end = s + samples->n_spans; s < end; s++)
            widen(samples->least + s->first, samples->largest + s->first, (const double *)self->tables[REAL] + s->first, s->n);
        watch(&self->watched, self->tables, k + 1);
        if (k + 1 == next_row) {
            for (int kind = 0; kind < KINDS; kind++) {
                size_t n = self->n_recorded[kind], size = size_of(kind);
                if (n) scatter((char *)rows[kind] + row * n * size, NULL, self->tables[kind], self->recorded[kind], n, kind);
            }
            if (samples->n_bounded) close_bounds(samples, bounds + row * 2 * samples->n_bounded);
            row++;
            next_row += self->stride;
        }
    }
    return last;
}

/* --- From Python ---------------------------------------------------------------------------------------------------- */

/* The memory of an array, and how many items it has where n is given.  Returns NULL with an exception set where items
   are of another size. */
static void *memory_of(PyObject *array, size_t item, size_t *n) {
    static char nothing[8];
    Py_buffer view;
    if (PyObject_GetBuffer(array, &view, PyBUF_ANY_CONTIGUOUS) < 0) return NULL;
    void *memory = view.len ? view.buf : nothing;
    int fits = (size_t)view.itemsize == item;
    if (n) *n = (size_t)view.len / item;
    PyBuffer_Release(&view);
    if (!fits) PyErr_Format(PyExc_TypeError, "items of %zu bytes are needed", item);
    return fits ? memory : NULL;
}

/* Sources and targets that follow one another are one run. */
static int find_runs(Call *c, PyObject *from, PyObject *to) {
    size_t n;
    const Py_ssize_t *sources = memory_of(from, sizeof(Py_ssize_t), &n);
    const Py_ssize_t *targets = sources ? memory_of(to, sizeof(Py_ssize_t), NULL) : NULL;
    if (!targets) return -1;
    c->runs = calloc(n + 1, sizeof *c->runs);
    if (!c->runs) return PyErr_NoMemory(), -1;
    size_t size = size_of(c->kind);
    for (size_t i = 0; i < n; i++)
        if (i && sources[i] == sources[i - 1] + 1 && targets[i] == targets[i - 1] + 1) c->runs[c->n_runs - 1].size += size;
        else c->runs[c->n_runs++] = (Run){(size_t)sources[i] * size, (size_t)targets[i] * size, size};
    return 0;
}

static int find_spans(const Py_ssize_t *places, size_t n, Span **spans, size_t *n_spans) {
    *spans = calloc(n + 1, sizeof **spans);
    if (!*spans) return PyErr_NoMemory(), -1;
    for (size_t i = 0; i < n; i++) {
        size_t first = (size_t)places[i] / VECTOR * VECTOR;
        Span *last = i ? &(*spans)[*n_spans - 1] : NULL;
        if (last && first >= last->first && first <= last->first + last->n + VECTOR) last->n = first + VECTOR - last->first;
        else (*spans)[(*n_spans)++] = (Span){first, VECTOR};
    }
    return 0;
}

#define CALL_FIELDS "kind address references values sources targets conversions"
#define CALL_FORMAT "iOOOOOO"
static int parse_calls(PyObject *list, Call **calls, size_t *n) {
    *n = (size_t)PyList_Size(list);
    *calls = calloc(*n + 1, sizeof **calls);
    if (!*calls) return PyErr_NoMemory(), -1;
    for (size_t i = 0; i < *n; i++) {
        Call *c = &(*calls)[i];
        PyObject *address, *references, *values, *sources, *targets, *conversions;
        if (!PyArg_ParseTuple(PyList_GetItem(list, (Py_ssize_t)i), CALL_FORMAT, &c->kind, &address, &references,
                              &values, &sources, &targets, &conversions))
            return -1;
        c->function = (Function *)PyLong_AsVoidPtr(address);
        if (PyErr_Occurred()) return -1;
        if (!(c->references = memory_of(references, sizeof(uint32_t), &c->n_references))) return -1;
        if (!(c->values = memory_of(values, size_of(c->kind), &c->n))) return -1;
        if (sources != Py_None && find_runs(c, sources, targets) < 0) return -1;
        if (conversions == Py_None) continue;
        if (!(c->conversions = memory_of(conversions, sizeof(Conversion), &c->n_conversions))) return -1;
    }
    return 0;
}

#define PUBLICATION_FIELDS "kind values chosen targets"
#define PUBLICATION_FORMAT "iOOO"
static int parse_publications(PyObject *list, Publication **publications, size_t *n) {
    *n = (size_t)PyList_Size(list);
    *publications = calloc(*n + 1, sizeof **publications);
    if (!*publications) return PyErr_NoMemory(), -1;
    for (size_t i = 0; i < *n; i++) {
        Publication *p = &(*publications)[i];
        PyObject *values, *chosen, *targets;
        if (!PyArg_ParseTuple(PyList_GetItem(list, (Py_ssize_t)i), PUBLICATION_FORMAT, &p->kind, &values, &chosen,
                              &targets))
            return -1;
        if (!(p->values = memory_of(values, size_of(p->kind), NULL))) return -1;
        if (!(p->chosen = memory_of(chosen, sizeof(Py_ssize_t), &p->n))) return -1;
        if (!(p->targets = memory_of(targets, sizeof(Py_ssize_t), NULL))) return -1;
    }
    return 0;
}

#define STEPPER_FIELDS "version handle address answers h period sets gets published"
#define STEPPER_FORMAT "iOOOdnO!O!(O!O!O!)"
static int parse_stepper(PyObject *tuple, Stepper *m) {
    PyObject *handle, *address, *answers, *sets, *gets, *published[MOMENTS];
    if (!PyArg_ParseTuple(tuple, STEPPER_FORMAT, &m->version, &handle, &address, &answers, &m->h, &m->period,
                          &PyList_Type, &sets, &PyList_Type, &gets, &PyList_Type, &published[0], &PyList_Type,
                          &published[1], &PyList_Type, &published[2]))
        return -1;
    m->handle = PyLong_AsVoidPtr(handle);
    m->step = (Function *)PyLong_AsVoidPtr(address);
    if (PyErr_Occurred()) return -1;
    if (answers != Py_None) {
        PyObject *flags, *reached;
        if (!PyArg_ParseTuple(answers, "OO", &flags, &reached)) return -1;
        if (!(m->answers = memory_of(flags, sizeof(bool), NULL))) return -1;
        if (!(m->reached = memory_of(reached, sizeof(double), NULL))) return -1;
    }
    if (parse_calls(sets, &m->sets, &m->n_sets) < 0 || parse_calls(gets, &m->gets, &m->n_gets) < 0) return -1;
    for (int moment = 0; moment < MOMENTS; moment++)
        if (parse_publications(published[moment], &m->published[moment], &m->n_published[moment]) < 0) return -1;
    return 0;
}

/* The memory of one array of each kind. */
static int memories_of(PyObject *tuple, int positions, void *memory[KINDS], size_t n[KINDS]) {
    for (int kind = 0; kind < KINDS; kind++) {
        PyObject *array = PyTuple_GetItem(tuple, kind);
        if (!array) return -1;
        size_t item = positions ? sizeof(Py_ssize_t) : size_of(kind);
        if (!(memory[kind] = memory_of(array, item, n ? &n[kind] : NULL))) return -1;
    }
    return 0;
}

#define CLOCK_FIELDS "ticks chosen values done"
#define CLOCK_FORMAT "OOOO"
static int parse_clock(PyObject *tuple, Clock *c) {
    PyObject *ticks, *chosen, *values, *done;
    if (!PyArg_ParseTuple(tuple, CLOCK_FORMAT, &ticks, &chosen, &values, &done)) return -1;
    if (!(c->ticks = memory_of(ticks, sizeof(int64_t), &c->n_ticks))) return -1;
    if (!(c->chosen = memory_of(chosen, sizeof(Py_ssize_t), &c->n))) return -1;
    if (!(c->values = memory_of(values, sizeof(double), NULL))) return -1;
    if (!(c->done = memory_of(done, sizeof(int64_t), NULL))) return -1;
    return 0;
}

#define BURSTS_FIELDS "kinds places squares squares_of_others clocks"
#define BURSTS_FORMAT "OOOOO!"
static int parse_bursts(PyObject *tuple, Bursts *b) {
    PyObject *kinds, *places, *squares, *others, *clocks;
    if (!PyArg_ParseTuple(tuple, BURSTS_FORMAT, &kinds, &places, &squares, &others, &PyList_Type, &clocks)) return -1;
    if (!(b->kinds = memory_of(kinds, sizeof(Py_ssize_t), &b->n))) return -1;
    if (!(b->places = memory_of(places, sizeof(Py_ssize_t), NULL))) return -1;
    if (!(b->squares = memory_of(squares, sizeof(double), NULL))) return -1;
    if (!(b->squares_of_others = memory_of(others, sizeof(double), &b->n_others))) return -1;
    if (find_spans(b->places, b->n - b->n_others, &b->spans, &b->n_spans) < 0) return -1;
    b->n_clocks = (size_t)PyList_Size(clocks);
    b->clocks = calloc(b->n_clocks + 1, sizeof *b->clocks);
    if (!b->clocks) return PyErr_NoMemory(), -1;
    for (size_t i = 0; i < b->n_clocks; i++)
        if (parse_clock(PyList_GetItem(clocks, (Py_ssize_t)i), &b->clocks[i]) < 0) return -1;
    return 0;
}

#define SAMPLES_FIELDS "kinds places values stride block first bounded least largest"
#define SAMPLES_FORMAT "OOOnnnOOO"
static int parse_samples(PyObject *tuple, Samples *s) {
    PyObject *kinds, *places, *values, *bounded, *least, *largest;
    Py_ssize_t stride, block;
    if (!PyArg_ParseTuple(tuple, SAMPLES_FORMAT, &kinds, &places, &values, &stride, &block, &s->first, &bounded, &least,
                          &largest))
        return -1;
    s->stride = (size_t)stride;
    s->block = (size_t)block;
    if (!(s->kinds = memory_of(kinds, sizeof(int64_t), &s->n))) return -1;
    if (!(s->places = memory_of(places, sizeof(Py_ssize_t), NULL))) return -1;
    if (!(s->values = memory_of(values, sizeof(double), NULL))) return -1;
    if (!(s->bounded = memory_of(bounded, sizeof(Py_ssize_t), &s->n_bounded))) return -1;
    if (!(s->least = memory_of(least, sizeof(double), NULL))) return -1;
    if (!(s->largest = memory_of(largest, sizeof(double), NULL))) return -1;
    if (find_spans(s->bounded, s->n_bounded, &s->spans, &s->n_spans) < 0) return -1;
    return 0;
}

#define WATCHED_FIELDS "limits angles ticks first farthest"
#define WATCHED_FORMAT "OOOOO"
static int parse_watched(PyObject *tuple, Watched *w) {
    PyObject *limits, *angles, *ticks, *first, *farthest;
    if (!PyArg_ParseTuple(tuple, WATCHED_FORMAT, &limits, &angles, &ticks, &first, &farthest)) return -1;
    if (!(w->limits = memory_of(limits, sizeof(Limit), &w->n_limits))) return -1;
    if (!(w->angles = memory_of(angles, sizeof(Angle), &w->n_angles))) return -1;
    if (!(w->ticks = memory_of(ticks, sizeof(int64_t), NULL))) return -1;
    if (!(w->first = memory_of(first, sizeof(double), NULL))) return -1;
    if (!(w->farthest = memory_of(farthest, sizeof(double), NULL))) return -1;
    while (w->n_reals < w->n_limits && w->limits[w->n_reals].kind == REAL) w->n_reals++;
    w->guards = calloc(w->n_reals + 1, sizeof *w->guards);
    if (!w->guards) return PyErr_NoMemory(), -1;
    for (size_t i = 0; i < w->n_reals; i++) {
        const Limit *l = &w->limits[i];
        Guard *g = &w->guards[i];
        *g = (Guard){(uint32_t)l->place, (float)l->low, (float)l->high};
        if ((double)g->low < l->low) g->low = nextafterf(g->low, INFINITY);
        if ((double)g->high > l->high) g->high = nextafterf(g->high, -INFINITY);
    }
    return 0;
}

static void loop_dealloc(Loop *self) {
    PyTypeObject *type = Py_TYPE((PyObject *)self);
    for (size_t i = 0; self->steppers && i < self->n_steppers; i++) {
        for (size_t j = 0; self->steppers[i].sets && j < self->steppers[i].n_sets; j++) free(self->steppers[i].sets[j].runs);
        free(self->steppers[i].sets);
        free(self->steppers[i].gets);
        for (int moment = 0; moment < MOMENTS; moment++) free(self->steppers[i].published[moment]);
    }
    free(self->steppers);
    free(self->late);
    free(self->bursts.clocks);
    free(self->watched.guards);
    free(self->bursts.spans);
    free(self->sampled.spans);
    Py_XDECREF(self->program);
    ((freefunc)PyType_GetSlot(type, Py_tp_free))(self);
    Py_DECREF(type);
}

/* Values that lie in the table as the setter wants them need no copy. */
static void use_in_place(const Loop *self, Call *c) {
    if (self->records_inputs || c->n_runs != 1 || c->runs[0].size != c->n * size_of(c->kind) || !c->function) return;
    c->values = (char *)self->tables[c->kind] + c->runs[0].source;
    c->n_runs = 0;
}

static int is_staged(const Loop *self, const Call *c) {
    if (c->kind != REAL && c->kind != FLOAT32) return 0;
    const char *table = self->tables[c->kind], *values = c->values;
    return values < table || values >= table + (c->kind == REAL ? self->n_reals : self->n_float32) * size_of(c->kind);
}

#define PROGRAM_FIELDS                                                                                                 \
    "steppers tables computed recorded bursts sampled watched seconds samples sample_every interrupt place "           \
    "stride holds_lock records_inputs"
#define PROGRAM_FORMAT "O!O!(nn)O!O!O!O!OOnOOnpp"
static int loop_init(Loop *self, PyObject *arguments, PyObject *keywords) {
    PyObject *program, *steppers, *tables, *recorded, *bursts, *sampled, *watched, *seconds, *samples;
    PyObject *interrupt, *place;
    void *places[KINDS];
    if (self->program) return PyErr_SetString(PyExc_RuntimeError, "a Loop is made once"), -1;
    if (keywords) return PyErr_SetString(PyExc_TypeError, "no keywords"), -1;
    if (!PyArg_ParseTuple(arguments, "O!", &PyTuple_Type, &program)) return -1;
    if (!PyArg_ParseTuple(program, PROGRAM_FORMAT, &PyList_Type, &steppers, &PyTuple_Type, &tables, &self->n_reals,
                          &self->n_float32, &PyTuple_Type, &recorded, &PyTuple_Type, &bursts, &PyTuple_Type, &sampled,
                          &PyTuple_Type, &watched, &seconds, &samples, &self->sample_every, &interrupt, &place,
                          &self->stride, &self->holds_lock, &self->records_inputs))
        return -1;
    self->program = Py_NewRef(program);
    if (memories_of(tables, 0, self->tables, NULL) < 0 || memories_of(recorded, 1, places, self->n_recorded) < 0)
        return -1;
    for (int kind = 0; kind < KINDS; kind++) self->recorded[kind] = places[kind];
    if (parse_bursts(bursts, &self->bursts) < 0) return -1;
    if (parse_samples(sampled, &self->sampled) < 0 || parse_watched(watched, &self->watched) < 0) return -1;
    if (!(self->seconds = memory_of(seconds, sizeof(double), NULL))) return -1;
    if (!(self->samples = memory_of(samples, sizeof(int64_t), NULL))) return -1;
    if (!(self->interrupt = memory_of(interrupt, sizeof(int32_t), NULL))) return -1;
    if (!(self->place = memory_of(place, sizeof(int64_t), NULL))) return -1;
    self->steppers = calloc((size_t)PyList_Size(steppers) + 1, sizeof *self->steppers);
    self->late = calloc((size_t)PyList_Size(steppers) + 1, sizeof *self->late);
    if (!self->steppers || !self->late) return PyErr_NoMemory(), -1;
    for (Py_ssize_t i = 0; i < PyList_Size(steppers); i++) {
        self->n_steppers++;
        Stepper *m = &self->steppers[i];
        if (parse_stepper(PyList_GetItem(steppers, i), m) < 0) return -1;
        for (size_t j = 0; j < m->n_sets; j++) use_in_place(self, &m->sets[j]);
        for (size_t j = 0; j < m->n_gets; j++) m->gets[j].staged = is_staged(self, &m->gets[j]);
        if (m->n_published[TICK_END] || m->n_published[PERIOD_END]) self->late[self->n_late++] = m;
    }
    self->overhead = 1.0;
    for (int i = 0; i < 100; i++) {
        double began = now(), took = now() - began;
        if (took < self->overhead) self->overhead = took;
    }
    return 0;
}

static PyObject *loop_advance(Loop *self, PyObject *arguments) {
    PyObject *times, *rows, *bounds;
    Py_ssize_t first, last, done, failed = -1;
    double patience;
    void *memory[KINDS], *start, *bounding;
    int status = 0;
    if (!PyArg_ParseTuple(arguments, "nnOdO!O", &first, &last, &times, &patience, &PyTuple_Type, &rows, &bounds))
        return NULL;
    if (!(start = memory_of(times, sizeof(double), NULL))) return NULL;
    if (memories_of(rows, 0, memory, NULL) < 0) return NULL;
    if (!(bounding = memory_of(bounds, sizeof(double), NULL))) return NULL;
    if (self->holds_lock) {
        done = advance(self, first, last, start, patience, memory, bounding, &failed, &status);
    } else {
        Py_BEGIN_ALLOW_THREADS
        done = advance(self, first, last, start, patience, memory, bounding, &failed, &status);
        Py_END_ALLOW_THREADS
    }
    return Py_BuildValue("nni", done, failed, status);
}

static PyMethodDef loop_methods[] = {
    {"advance", (PyCFunction)loop_advance, METH_VARARGS,
     "advance(first, last, times, patience, rows, bounds) -> (ticks done, failed stepper or -1, status)\n\n"
     "times: (last - first,) of the ticks [s]; patience: s, after which it returns early; rows: an array of each kind; "
     "bounds: (rows, 2, bounded), the least and the largest values since the row before."},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot loop_slots[] = {
    {Py_tp_doc, "Loop(program); see program.py"},
    {Py_tp_init, loop_init},
    {Py_tp_new, PyType_GenericNew},
    {Py_tp_dealloc, loop_dealloc},
    {Py_tp_methods, loop_methods},
    {0, NULL},
};

static PyType_Spec loop_spec = {"orchestrator.simulation._loop.Loop", sizeof(Loop), 0, Py_TPFLAGS_DEFAULT, loop_slots};

/* What program.layout() must agree with. */
static PyObject *layout_of(void) {
    return Py_BuildValue("{s:s, s:s, s:s, s:s, s:s, s:s, s:s, s:s, s:s, s:s, s:s, s:s, s:s, s:N}", "Program", PROGRAM_FIELDS,
                         "StepperProgram", STEPPER_FIELDS, "CallProgram", CALL_FIELDS, "PublicationProgram", PUBLICATION_FIELDS,
                         "BurstsProgram", BURSTS_FIELDS, "ClockProgram", CLOCK_FIELDS, "SamplesProgram", SAMPLES_FIELDS,
                         "WatchedProgram", WATCHED_FIELDS, "Conversion", CONVERSION_FIELDS, "Limit", LIMIT_FIELDS,
                         "Angle", ANGLE_FIELDS, "kinds", EACH_KIND(NAME), "moments", MOMENT_NAMES, "NOT_FINITE",
                         PyUnicode_FromFormat("%d", NOT_FINITE));
}

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, .m_name = "_loop", .m_doc = "The inner loop, compiled.",
                                    .m_size = -1};

PyMODINIT_FUNC PyInit__loop(void) {
    PyObject *self = PyModule_Create(&module);
    PyObject *type = self ? PyType_FromSpec(&loop_spec) : NULL;
    PyObject *layout = type ? layout_of() : NULL;
    int failed = !layout || PyModule_AddObjectRef(self, "Loop", type) || PyModule_AddObjectRef(self, "LAYOUT", layout);
    Py_XDECREF(layout);
    Py_XDECREF(type);
    if (failed) Py_CLEAR(self);
    return self;
}
