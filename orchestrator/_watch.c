/* What `watch` does, where an FMU holds Python's lock and its thread cannot run: reports what hangs, and ends it.

   A thread that needs no lock looks at the same board and, without taking them, at the same signals.  To end the work it
   has the main thread call `halt` from a handler of a signal, in the middle of whatever holds the lock, as nothing else
   can run Python then.  What was interrupted never goes on; where `halt` does not return either, the process ends. */
#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030b0000
#include <Python.h>

#include <errno.h>
#include <math.h>
#include <pthread.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#define NAME 64
#define LOOK 0.1  /* s between two looks */
#define DEAF 1.0  /* s without a sign of Python's thread, after which the lock is taken to be held */
#define STUCK 0.2 /* s in one call after which it is taken not to return */
#define LAST 3.0  /* s that `halt` may take */
#define INTERRUPTED 130

/* BOARD of watch.py */
typedef struct {
    int64_t place, count, components, names, pressed;
    double step, alive, patience;
    char what[512];
} Board;

typedef struct {
    volatile Board *board;
    Py_buffer view;
    PyObject *arguments, *halt; /* the label lies in the arguments */
    int signals, reports; /* descriptors; signals: -1 where none are handled */
    double slow, termination;
    const char *label;
    pthread_t thread, main;
    pthread_mutex_t mutex;
    pthread_cond_t changed;
    int stopping;
} Line;

static Line *last_line;

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void nap(double seconds) {
    struct timespec t = {(time_t)seconds, (long)(1e9 * (seconds - floor(seconds)))};
    while (nanosleep(&t, &t) && errno == EINTR) ;
}

/* What is being done, as _Watch._call says it; returns whether it may hang. */
static int describe(const volatile Board *board, char *text, size_t size) {
    int64_t place = board->place;
    if (place && board->components) {
        int64_t tick = (place - 1) / board->components, component = (place - 1) % board->components;
        const char *name = (const char *)(intptr_t)board->names + component * NAME;
        snprintf(text, size, "'%.*s' is in its step at t = %.10g s", NAME, name, (double)tick * board->step);
    } else {
        snprintf(text, size, "%s", (const char *)board->what);
    }
    return *text != 0;
}

static void report(const Line *self, const char *call, double seconds) {
    char line[1024];
    const char *hint = self->signals < 0 ? "" : "; Ctrl-C, pressed twice, ends it";
    int n = snprintf(line, sizeof line, "%s%s, for %.0f s now%s\n", self->label, call, seconds, hint);
    if (n > 0 && write(self->reports, line, (size_t)n < sizeof line ? (size_t)n : sizeof line - 1) < 0) return;
}

static void halt(int number) {
    (void)number;
    PyGILState_Ensure();
    PyObject_CallNoArgs(last_line->halt);
    _exit(INTERRUPTED);
}

static void end(Line *self) {
    struct sigaction action = {.sa_handler = halt};
    last_line = self;
    sigaction(SIGINT, &action, NULL);
    pthread_kill(self->main, SIGINT);
    nap(LAST);
    _exit(INTERRUPTED);
}

/* Whether the signals that wait ask for an end at once, as watch._is_urgent has it.  first: when one was seen [s], or
   0; earlier: whether Python has seen one. */
static int is_urgent(const Line *self, double *first, int earlier) {
    unsigned char numbers[64];
    ssize_t n = self->signals < 0 ? 0 : recv(self->signals, numbers, sizeof numbers, MSG_PEEK | MSG_DONTWAIT);
    int again = 0, pressed = earlier, politely = 0;
    for (ssize_t i = 0; i < n; i++) {
        again |= pressed && numbers[i] == SIGINT;
        pressed |= numbers[i] == SIGINT || numbers[i] == SIGTERM || numbers[i] == SIGHUP;
        politely |= numbers[i] == SIGTERM || numbers[i] == SIGHUP;
    }
    if (politely && !*first) *first = now();
    return again || (politely && now() - *first >= self->termination);
}

static void *look(void *argument) {
    Line *self = argument;
    volatile Board *board = self->board;
    int64_t place = -1, count = -1;
    double since = 0.0, due = self->slow, first = 0.0;
    char call[576];
    pthread_mutex_lock(&self->mutex);
    while (!self->stopping) {
        struct timespec until;
        clock_gettime(CLOCK_REALTIME, &until);
        until.tv_nsec += (long)(LOOK * 1e9);
        until.tv_sec += until.tv_nsec / 1000000000;
        until.tv_nsec %= 1000000000;
        pthread_cond_timedwait(&self->changed, &self->mutex, &until);
        double t = now();
        if (board->place != place || board->count != count) {
            place = board->place, count = board->count, since = t, due = self->slow;
        }
        if (t - board->alive < DEAF || !describe(board, call, sizeof call)) continue;
        if (t - since >= due) {
            report(self, call, t - since);
            due *= 2;
        }
        if (is_urgent(self, &first, board->pressed > 0) && t - since >= STUCK + board->patience) end(self);
    }
    pthread_mutex_unlock(&self->mutex);
    return NULL;
}

static const char NAME_OF[] = "orchestrator._watch";

static PyObject *start(PyObject *module, PyObject *arguments) {
    (void)module;
    Line *self = calloc(1, sizeof *self);
    PyObject *board;
    if (!self) return PyErr_NoMemory();
    if (!PyArg_ParseTuple(arguments, "OiiddyO", &board, &self->signals, &self->reports, &self->slow, &self->termination,
                          &self->label, &self->halt) ||
        PyObject_GetBuffer(board, &self->view, PyBUF_SIMPLE) < 0) {
        free(self);
        return NULL;
    }
    self->board = self->view.buf;
    self->main = pthread_self();
    self->arguments = Py_NewRef(arguments);
    pthread_mutex_init(&self->mutex, NULL);
    pthread_cond_init(&self->changed, NULL);
    sigset_t all, before; /* signals are for the main thread */
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &before);
    int failed = pthread_create(&self->thread, NULL, look, self);
    pthread_sigmask(SIG_SETMASK, &before, NULL);
    if (failed) {
        PyBuffer_Release(&self->view);
        Py_DECREF(self->arguments);
        free(self);
        errno = failed;
        return PyErr_SetFromErrno(PyExc_OSError);
    }
    return PyCapsule_New(self, NAME_OF, NULL);
}

static PyObject *stop(PyObject *module, PyObject *capsule) {
    (void)module;
    Line *self = PyCapsule_GetPointer(capsule, NAME_OF);
    if (!self) return NULL;
    Py_BEGIN_ALLOW_THREADS
    pthread_mutex_lock(&self->mutex);
    self->stopping = 1;
    pthread_cond_signal(&self->changed);
    pthread_mutex_unlock(&self->mutex);
    pthread_join(self->thread, NULL);
    Py_END_ALLOW_THREADS
    pthread_cond_destroy(&self->changed);
    pthread_mutex_destroy(&self->mutex);
    PyBuffer_Release(&self->view);
    Py_DECREF(self->arguments);
    free(self);
    Py_RETURN_NONE;
}

static PyMethodDef functions[] = {
    {"start", start, METH_VARARGS, "start(board, signals, reports, slow, termination, label, halt) -> what `stop` takes"},
    {"stop", stop, METH_O, "End the thread."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, .m_name = "_watch", .m_size = -1, .m_methods = functions,
                                    .m_doc = "Watches work that holds Python's lock."};

PyMODINIT_FUNC PyInit__watch(void) {
    PyObject *self = PyModule_Create(&module);
    if (self && PyModule_AddIntConstant(self, "SIZE", sizeof(Board)) < 0) Py_CLEAR(self);
    return self;
}
