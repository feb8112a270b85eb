/* The inner loop of the co-simulation master: gather, set, step, get, publish, record, by the addresses of the FMI
   functions.  loop.py has the same in Python; both give the same rows, bit for bit.  What acts when is told in
   master.py.

   All arrays belong to numpy and stay where they are: a Loop keeps a reference to every object it was given. */

#define Py_LIMITED_API 0x030B0000
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <math.h>
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

enum { REAL, INTEGER, BOOLEAN, KINDS };
enum { AT_ONCE, TICK_END, PERIOD_END, MOMENTS };
enum { NOT_FINITE = -1 };
enum { FMI_WARNING = 1 };

typedef int Exchange(void *component, const uint32_t *references, size_t n, void *values);
typedef int DoStep(void *component, double t, double h, int no_going_back);

/* Values that follow one another in the table as they do in a setter's buffer. */
typedef struct {
    size_t source, target, n;
} Run;

/* One getter or setter call. */
typedef struct {
    int kind;
    Exchange *function;
    const uint32_t *references;
    size_t n;
    void *values;
    Run *runs; /* of a setter: where its values come from */
    size_t n_runs;
    int staged; /* real values that do not lie in the table: they are checked at once, the table after each tick */
} Call;

typedef struct {
    int kind;
    const void *values;
    const Py_ssize_t *chosen, *targets;
    size_t n;
} Publication;

typedef struct {
    void *component;
    DoStep *step;
    double h;
    Py_ssize_t period;
    Call *sets, *gets;
    size_t n_sets, n_gets;
    Publication *published[MOMENTS];
    size_t n_published[MOMENTS];
} Member;

/* Counts of what changes sign from one look to the next: see chatter.py. */
typedef struct {
    size_t n;
    Py_ssize_t every;
    const double *middle, *threshold;
    double *before, *sum, *sum_abs, *largest;
    int64_t *counts;
} Alternations;

typedef struct {
    PyObject_HEAD
    PyObject *owners; /* of all memory below */
    Member *members;
    const Member **late; /* those that publish something at the end of a tick or period */
    size_t n_members, n_late;
    void *tables[KINDS];
    size_t n_reals; /* of the table, computed by components */
    const Py_ssize_t *recorded[KINDS];
    size_t n_recorded[KINDS];
    Alternations alternations;
    double *seconds; /* (members, 3): of set, step and get in timed steps */
    int64_t *samples;
    Py_ssize_t sample_every, stride;
    double overhead; /* of looking at the clock */
    const int32_t *interrupt;
    int holds_lock;
} Loop;

/* --- The loop ------------------------------------------------------------------------------------------------------- */

static size_t size_of(int kind) { return kind == REAL ? sizeof(double) : sizeof(int32_t); }

static void gather(void *to, const void *table, const Py_ssize_t *sources, size_t n, int kind) {
    if (kind == REAL)
        for (size_t i = 0; i < n; i++) ((double *)to)[i] = ((const double *)table)[sources[i]];
    else
        for (size_t i = 0; i < n; i++) ((int32_t *)to)[i] = ((const int32_t *)table)[sources[i]];
}

static inline void copy(const Call *c, const Run *run, const void *table) {
    size_t size = size_of(c->kind);
    memcpy((char *)c->values + run->target * size, (const char *)table + run->source * size, run->n * size);
}

static void publish(void *table, const Publication *p) {
    if (p->kind == REAL)
        for (size_t i = 0; i < p->n; i++)
            ((double *)table)[p->targets[i]] = ((const double *)p->values)[p->chosen[i]];
    else
        for (size_t i = 0; i < p->n; i++)
            ((int32_t *)table)[p->targets[i]] = ((const int32_t *)p->values)[p->chosen[i]];
}

static void publish_all(const Loop *self, const Member *m, int moment) {
    for (size_t i = 0; i < m->n_published[moment]; i++)
        publish(self->tables[m->published[moment][i].kind], &m->published[moment][i]);
}

/* Adding one to an exponent of nothing but ones runs into the sign. */
static int all_finite(const double *values, size_t n) {
    uint64_t met = 0;
    for (size_t i = 0; i < n; i++) {
        uint64_t bits;
        memcpy(&bits, values + i, sizeof bits);
        met |= (bits & UINT64_C(0x7fffffffffffffff)) + UINT64_C(0x0010000000000000);
    }
    return !(met >> 63);
}

/* Returns 0, a status of FMI above fmi2Warning or below 0, or NOT_FINITE; marks: the times before set, step, get and
   at the end, or NULL. */
static int step(const Loop *self, const Member *m, double t, double *marks) {
    int status;
    if (marks) marks[0] = now();
    for (const Call *c = m->sets, *end = c + m->n_sets; c < end; c++) {
        for (size_t j = 0; j < c->n_runs; j++) copy(c, &c->runs[j], self->tables[c->kind]);
        status = c->function(m->component, c->references, c->n, c->values);
        if ((unsigned)status > FMI_WARNING) return status;
    }
    if (marks) marks[1] = now();
    status = m->step(m->component, t, m->h, 1);
    if ((unsigned)status > FMI_WARNING) return status;
    if (marks) marks[2] = now();
    for (const Call *c = m->gets, *end = c + m->n_gets; c < end; c++) {
        status = c->function(m->component, c->references, c->n, c->values);
        if ((unsigned)status > FMI_WARNING) return status;
        if (c->staged && !all_finite(c->values, c->n)) return NOT_FINITE;
    }
    if (m->n_published[AT_ONCE]) publish_all(self, m, AT_ONCE);
    if (marks) marks[3] = now();
    return 0;
}

static void add_times(const Loop *self, size_t member, const double *marks) {
    for (int phase = 0; phase < 3; phase++) {
        double seconds = marks[phase + 1] - marks[phase] - self->overhead;
        if (seconds > 0.0) self->seconds[3 * member + phase] += seconds;
    }
    self->samples[member]++;
}

static void compare(const Alternations *a, const double *table) {
    for (size_t i = 0; i < a->n; i++) {
        double value = a->middle ? table[i] - a->middle[i] : table[i];
        double product = value * a->before[i], size = fabs(product);
        a->counts[i] += product < a->threshold[i];
        a->sum[i] += product;
        a->sum_abs[i] += size;
        a->largest[i] = size > a->largest[i] ? size : a->largest[i];
    }
}

/* phase: of the tick that has ended, 1 to `every`. */
static void look(const Alternations *a, const double *table, Py_ssize_t phase) {
    if (phase == 1) compare(a, table);
    if (phase == a->every)
        for (size_t i = 0; i < a->n; i++) a->before[i] = a->middle ? table[i] - a->middle[i] : table[i];
}

/* The first member that has given a value that is not finite. */
static Py_ssize_t not_finite(const Loop *self) {
    for (size_t i = 0; i < self->n_members; i++)
        for (size_t j = 0; j < self->members[i].n_gets; j++) {
            const Call *c = &self->members[i].gets[j];
            if (c->kind == REAL && !all_finite(c->values, c->n)) return (Py_ssize_t)i;
        }
    return 0;
}

/* Steps from tick `first` until `last`.  Returns the ticks done; *failed: the member that failed, or -1. */
static Py_ssize_t advance(const Loop *self, Py_ssize_t first, Py_ssize_t last, const double *times, double patience,
                          void *rows[KINDS], Py_ssize_t *failed, int *status) {
    double deadline = now() + patience, marks[4];
    size_t row = 0;
    Py_ssize_t phase = first % self->alternations.every;
    Py_ssize_t next_row = (first / self->stride + 1) * self->stride;
    Py_ssize_t next_sample = (first + self->sample_every - 1) / self->sample_every * self->sample_every;
    for (Py_ssize_t k = first; k < last; k++) {
        int timed = k == next_sample;
        if (*(volatile const int32_t *)self->interrupt || (timed && now() > deadline)) return k;
        if (timed) next_sample += self->sample_every;
        for (size_t i = 0; i < self->n_members; i++) {
            const Member *m = &self->members[i];
            if (m->period > 1 && k % m->period) continue;
            *status = step(self, m, times[k - first], timed ? marks : NULL);
            if (*status) {
                *failed = (Py_ssize_t)i;
                return k;
            }
            if (timed) add_times(self, i, marks);
        }
        if (!all_finite(self->tables[REAL], self->n_reals)) {
            *failed = not_finite(self);
            *status = NOT_FINITE;
            return k;
        }
        for (size_t i = 0; i < self->n_late; i++) {
            const Member *m = self->late[i];
            if (m->period == 1 || k % m->period == 0) publish_all(self, m, TICK_END);
            if (m->period == 1 || (k + 1) % m->period == 0) publish_all(self, m, PERIOD_END);
        }
        phase = phase == self->alternations.every ? 1 : phase + 1;
        look(&self->alternations, self->tables[REAL], phase);
        if (k + 1 == next_row) {
            for (int kind = 0; kind < KINDS; kind++) {
                size_t n = self->n_recorded[kind], size = size_of(kind);
                gather((char *)rows[kind] + row * n * size, self->tables[kind], self->recorded[kind], n, kind);
            }
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

static int find_runs(Call *c, PyObject *array) {
    const Py_ssize_t *sources = memory_of(array, sizeof(Py_ssize_t), NULL);
    if (!sources) return -1;
    c->runs = calloc(c->n + 1, sizeof *c->runs);
    if (!c->runs) return PyErr_NoMemory(), -1;
    for (size_t i = 0; i < c->n; i++)
        if (i && sources[i] == sources[i - 1] + 1) c->runs[c->n_runs - 1].n++;
        else c->runs[c->n_runs++] = (Run){(size_t)sources[i], i, 1};
    return 0;
}

/* {(kind, address, references, values, sources or None)} */
static int parse_calls(PyObject *list, Call **calls, size_t *n) {
    *n = (size_t)PyList_Size(list);
    *calls = calloc(*n + 1, sizeof **calls);
    if (!*calls) return PyErr_NoMemory(), -1;
    for (size_t i = 0; i < *n; i++) {
        Call *c = &(*calls)[i];
        PyObject *address, *references, *values, *sources;
        if (!PyArg_ParseTuple(PyList_GetItem(list, (Py_ssize_t)i), "iOOOO", &c->kind, &address, &references, &values,
                              &sources))
            return -1;
        c->function = (Exchange *)PyLong_AsVoidPtr(address);
        if (!(c->references = memory_of(references, sizeof(uint32_t), &c->n))) return -1;
        if (!(c->values = memory_of(values, size_of(c->kind), NULL))) return -1;
        if (sources != Py_None && find_runs(c, sources) < 0) return -1;
        if (PyErr_Occurred()) return -1;
    }
    return 0;
}

/* {(kind, values, chosen, targets)} */
static int parse_publications(PyObject *list, Publication **publications, size_t *n) {
    *n = (size_t)PyList_Size(list);
    *publications = calloc(*n + 1, sizeof **publications);
    if (!*publications) return PyErr_NoMemory(), -1;
    for (size_t i = 0; i < *n; i++) {
        Publication *p = &(*publications)[i];
        PyObject *values, *chosen, *targets;
        if (!PyArg_ParseTuple(PyList_GetItem(list, (Py_ssize_t)i), "iOOO", &p->kind, &values, &chosen, &targets))
            return -1;
        if (!(p->values = memory_of(values, size_of(p->kind), NULL))) return -1;
        if (!(p->chosen = memory_of(chosen, sizeof(Py_ssize_t), &p->n))) return -1;
        if (!(p->targets = memory_of(targets, sizeof(Py_ssize_t), NULL))) return -1;
    }
    return 0;
}

static int parse_member(PyObject *tuple, Member *m) {
    PyObject *component, *function, *sets, *gets, *published[MOMENTS];
    if (!PyArg_ParseTuple(tuple, "OOdnO!O!(O!O!O!)", &component, &function, &m->h, &m->period, &PyList_Type, &sets,
                          &PyList_Type, &gets, &PyList_Type, &published[0], &PyList_Type, &published[1], &PyList_Type,
                          &published[2]))
        return -1;
    m->component = PyLong_AsVoidPtr(component);
    m->step = (DoStep *)PyLong_AsVoidPtr(function);
    if (PyErr_Occurred()) return -1;
    if (parse_calls(sets, &m->sets, &m->n_sets) < 0 || parse_calls(gets, &m->gets, &m->n_gets) < 0) return -1;
    for (int moment = 0; moment < MOMENTS; moment++)
        if (parse_publications(published[moment], &m->published[moment], &m->n_published[moment]) < 0) return -1;
    return 0;
}

static int parse_alternations(PyObject *tuple, Alternations *a) {
    PyObject *before, *middle, *threshold, *counts, *sum, *sum_abs, *largest;
    if (!PyArg_ParseTuple(tuple, "nOOOOOOO", &a->every, &before, &middle, &threshold, &counts, &sum, &sum_abs,
                          &largest))
        return -1;
    if (!(a->before = memory_of(before, sizeof(double), &a->n))) return -1;
    if (middle != Py_None && !(a->middle = memory_of(middle, sizeof(double), NULL))) return -1;
    if (!(a->threshold = memory_of(threshold, sizeof(double), NULL))) return -1;
    if (!(a->counts = memory_of(counts, sizeof(int64_t), NULL))) return -1;
    if (!(a->sum = memory_of(sum, sizeof(double), NULL))) return -1;
    if (!(a->sum_abs = memory_of(sum_abs, sizeof(double), NULL))) return -1;
    if (!(a->largest = memory_of(largest, sizeof(double), NULL))) return -1;
    return 0;
}

static void loop_dealloc(Loop *self) {
    PyTypeObject *type = Py_TYPE((PyObject *)self);
    for (size_t i = 0; self->members && i < self->n_members; i++) {
        for (size_t j = 0; self->members[i].sets && j < self->members[i].n_sets; j++) free(self->members[i].sets[j].runs);
        free(self->members[i].sets);
        free(self->members[i].gets);
        for (int moment = 0; moment < MOMENTS; moment++) free(self->members[i].published[moment]);
    }
    free(self->members);
    free(self->late);
    Py_XDECREF(self->owners);
    ((freefunc)PyType_GetSlot(type, Py_tp_free))(self);
    Py_DECREF(type);
}

/* Values that lie in the table as the setter wants them need no copy. */
static void use_in_place(const Loop *self, Call *c) {
    if (c->n_runs != 1) return;
    c->values = (char *)self->tables[c->kind] + c->runs[0].source * size_of(c->kind);
    c->n_runs = 0;
}

static int is_staged(const Loop *self, const Call *c) {
    const double *table = self->tables[REAL], *values = c->values;
    return values < table || values >= table + self->n_reals;
}

static int loop_init(Loop *self, PyObject *arguments, PyObject *keywords) {
    PyObject *members, *tables[KINDS], *recorded[KINDS], *alternations, *seconds, *samples, *interrupt;
    if (self->owners) return PyErr_SetString(PyExc_RuntimeError, "a Loop is made once"), -1;
    if (keywords) return PyErr_SetString(PyExc_TypeError, "no keywords"), -1;
    if (!PyArg_ParseTuple(arguments, "O!(OOO)(OOO)O!(OOn)Onp", &PyList_Type, &members, &tables[0], &tables[1],
                          &tables[2], &recorded[0], &recorded[1], &recorded[2], &PyTuple_Type, &alternations, &seconds,
                          &samples, &self->sample_every, &interrupt, &self->stride, &self->holds_lock))
        return -1;
    self->owners = Py_NewRef(arguments);
    for (int kind = 0; kind < KINDS; kind++) {
        if (!(self->tables[kind] = memory_of(tables[kind], size_of(kind), NULL))) return -1;
        self->recorded[kind] = memory_of(recorded[kind], sizeof(Py_ssize_t), &self->n_recorded[kind]);
        if (!self->recorded[kind]) return -1;
    }
    if (parse_alternations(alternations, &self->alternations) < 0) return -1;
    self->n_reals = self->alternations.n;
    if (!(self->seconds = memory_of(seconds, sizeof(double), NULL))) return -1;
    if (!(self->samples = memory_of(samples, sizeof(int64_t), NULL))) return -1;
    if (!(self->interrupt = memory_of(interrupt, sizeof(int32_t), NULL))) return -1;
    self->members = calloc((size_t)PyList_Size(members) + 1, sizeof *self->members);
    self->late = calloc((size_t)PyList_Size(members) + 1, sizeof *self->late);
    if (!self->members || !self->late) return PyErr_NoMemory(), -1;
    for (Py_ssize_t i = 0; i < PyList_Size(members); i++) {
        self->n_members++;
        Member *m = &self->members[i];
        if (parse_member(PyList_GetItem(members, i), m) < 0) return -1;
        for (size_t j = 0; j < m->n_sets; j++) use_in_place(self, &m->sets[j]);
        for (size_t j = 0; j < m->n_gets; j++) m->gets[j].staged = m->gets[j].kind == REAL && is_staged(self, &m->gets[j]);
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
    PyObject *times, *rows[KINDS];
    Py_ssize_t first, last, done, failed = -1;
    double patience;
    void *memory[KINDS], *start;
    int status = 0;
    if (!PyArg_ParseTuple(arguments, "nnOd(OOO)", &first, &last, &times, &patience, &rows[0], &rows[1], &rows[2]))
        return NULL;
    if (!(start = memory_of(times, sizeof(double), NULL))) return NULL;
    for (int kind = 0; kind < KINDS; kind++)
        if (!(memory[kind] = memory_of(rows[kind], size_of(kind), NULL))) return NULL;
    if (self->holds_lock) {
        done = advance(self, first, last, start, patience, memory, &failed, &status);
    } else {
        Py_BEGIN_ALLOW_THREADS
        done = advance(self, first, last, start, patience, memory, &failed, &status);
        Py_END_ALLOW_THREADS
    }
    return Py_BuildValue("nni", done, failed, status);
}

static PyMethodDef loop_methods[] = {
    {"advance", (PyCFunction)loop_advance, METH_VARARGS,
     "advance(first, last, times, patience, (reals, integers, booleans)) -> (ticks done, failed member or -1, status)\n\n"
     "times: (last - first,) of the ticks [s]; patience: s, after which it returns early; the arrays take the rows."},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot loop_slots[] = {
    {Py_tp_doc, "Loop(members, tables, recorded, alternations, (seconds, samples, every), interrupt, stride, "
                "holds_lock); see loop.py"},
    {Py_tp_init, loop_init},
    {Py_tp_new, PyType_GenericNew},
    {Py_tp_dealloc, loop_dealloc},
    {Py_tp_methods, loop_methods},
    {0, NULL},
};

static PyType_Spec loop_spec = {"orchestrator._loop.Loop", sizeof(Loop), 0, Py_TPFLAGS_DEFAULT, loop_slots};

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, .m_name = "_loop", .m_doc = "The inner loop, compiled.",
                                    .m_size = -1};

PyMODINIT_FUNC PyInit__loop(void) {
    PyObject *self = PyModule_Create(&module), *type = self ? PyType_FromSpec(&loop_spec) : NULL;
    if (!type || PyModule_AddObjectRef(self, "Loop", type) < 0) {
        Py_XDECREF(type);
        Py_XDECREF(self);
        return NULL;
    }
    Py_DECREF(type);
    return self;
}
