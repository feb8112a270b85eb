"""Work that takes long: how it is interrupted, what is reported while it hangs, and how it ends where it never returns.

A thread beside the work sees signals at once, also while the code of an FMU does not return, and looks at what the work
is doing:

    first Ctrl-C, SIGTERM, SIGHUP   set the `Interrupt`; the work ends in order when it looks there
    second Ctrl-C                   what never returns is ended: by a KeyboardInterrupt in it, where it is Python; else
                                    the ends that `at_halt` names are brought about, and the process ends.  After
                                    SIGTERM and SIGHUP nobody presses again: TERMINATION later counts as a second one.
    SLOW without any progress       is reported, with the component's name

Where the code of an FMU does not return and holds Python's lock, that thread cannot run: `_watch.c`, where it is built,
does the same with a thread that needs no lock.
"""

from __future__ import annotations

import contextlib
import importlib
import itertools
import math
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from types import FrameType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .arrays import Table

try:  # by name: import-linter takes what is compiled for the package that it lies in
    _watch: Any = importlib.import_module("._watch", __package__)
except ImportError:  # no compiler, or Windows
    _watch = None

SLOW = float(os.environ.get("ORCH_SLOW", "60"))  # s without progress, which are reported
LOOK = min(0.25, SLOW / 4)  # s between two looks
SOON = 0.05  # s between two looks once it is to end
STUCK = 0.2  # s in one call after which it is taken not to return
TERMINATION = 5.0  # s after SIGTERM and SIGHUP; `docker stop` kills after 10 s
LAST = 3.0  # s that what brings about the end may take
INTERRUPTED = 130  # exit code
# Where reports go, and what they begin with: of a process whose stderr is kept, those of the process that began it.
_descriptor, _, LABEL = os.environ.get("ORCH_REPORTS", "2:").partition(":")
REPORTS = int(_descriptor)
SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
NAME, WHAT = 64, 512  # bytes
BOARD = [  # what the work is doing, as `_watch.c` reads it
    ("place", "i8"),  # tick * components + component + 1 in a step of the loop, else 0
    ("count", "i8"),  # of changes of `what`
    ("components", "i8"),
    ("names", "i8"),  # address of their names, of NAME bytes each
    ("pressed", "i8"),  # signals that the thread of Python has seen
    ("step", "f8"),  # s
    ("alive", "f8"),  # s, monotonic: when it last ran
    ("patience", "f8"),  # s that `what` has to end in order
    ("what", f"S{WHAT}"),  # UTF-8, like the names; "" where it waits for nothing that can hang
]

End = Callable[[], str]  # returns what to report, or ""


class Interrupt:
    """A flag that both loops look at in every step.  `urgent`: whether there is no time to end in order."""

    def __init__(self) -> None:
        import numpy as np

        self.flag = np.zeros(1, dtype=np.int32)
        self.urgent = False

    def set(self) -> None:
        self.flag[0] = 1

    def is_set(self) -> bool:
        return bool(self.flag[0])


_here = threading.local()  # `watch`: of the work that this thread does


@contextlib.contextmanager
def interruptible(interrupt: Interrupt | None = None, label: str = LABEL) -> Iterator[Interrupt]:
    """Watch the body: signals set a flag, and what hangs is reported.  label: what reports begin with.

    Python takes signals in its main thread only; in others the body is watched, and nothing but `interrupt` ends it.
    A KeyboardInterrupt raised inside a Python FMU would be a fatal error of that FMU.
    """
    watch, before = _Watch(interrupt or Interrupt(), label), getattr(_here, "watch", None)
    _here.watch = watch
    try:
        with watch.running():
            yield watch.interrupt
    finally:
        _here.watch = before


def doing(what: str, patience: float = 0.0) -> None:
    """Say what this thread does from now on, such as "'vehicle' is loaded"; "" is nothing that can hang.

    patience: s that it has to end in order, without an exception in it, also at a second Ctrl-C.
    """
    if watch := getattr(_here, "watch", None):
        watch.doing(what, patience)


def stepping(names: Sequence[str], step: float) -> Table:
    """Where a loop says in which step it is, (1,) int64: tick * components + component + 1, or 0.  step: s."""
    import numpy as np

    watch = getattr(_here, "watch", None)
    return np.zeros(1, dtype=np.int64) if watch is None else watch.stepping(names, step)


def waits(seconds: float) -> None:
    """Sleep, but not beyond an interruption."""
    until, watch = time.monotonic() + seconds, getattr(_here, "watch", None)
    while (left := until - time.monotonic()) > 0 and not (watch and watch.interrupt.is_set()):
        time.sleep(min(left, LOOK))


@contextlib.contextmanager
def at_halt(end: End) -> Iterator[None]:
    """Where the body is ended although it never returns, `end` is called first, in another thread; last ones first."""
    watch = getattr(_here, "watch", None)
    if watch is None:
        yield
        return
    watch.ends.append(end)
    try:
        yield
    finally:
        watch.ends.remove(end)


@contextlib.contextmanager
def terminable() -> Iterator[None]:
    """SIGTERM and SIGHUP are KeyboardInterrupts, as Ctrl-C is: what the body has begun is ended in order."""
    with _handling(_raise, [number for number in SIGNALS if number != signal.SIGINT]):
        yield


def communicate(
    process: subprocess.Popen[bytes], text: bytes, what: Callable[[bytes], str], seconds: float = math.inf
) -> tuple[bytes, bytes]:
    """As Popen.communicate, and what takes long is reported.  what: says it, given the output so far.

    seconds: that it may take.  Raises subprocess.TimeoutExpired.
    """
    began, given = time.monotonic(), {"input": text}
    for n in itertools.count():
        last = min(seconds, SLOW * 2**n)
        try:
            return process.communicate(timeout=max(0.0, began + last - time.monotonic()), **given)
        except subprocess.TimeoutExpired as late:
            if last == seconds:
                raise
            report(f"{LABEL}{what(late.output or b'')}, for {last:.0f} s now")
            given = {}
    raise AssertionError  # not reached


def _raise(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


@contextlib.contextmanager
def _handling(handler: Callable[[int, FrameType | None], None], numbers: Sequence[int]) -> Iterator[bool]:
    """Whether this thread can handle signals.  What ignores them (nohup), or handles them itself, still does."""
    if threading.current_thread() is not threading.main_thread():
        yield False
        return
    ours = (signal.SIG_DFL, _raise)
    chosen = [n for n in numbers if n == signal.SIGINT or signal.getsignal(n) in ours]
    before = {number: signal.signal(number, handler) for number in chosen}
    try:
        yield True
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)


class _Watch:
    """The thread, and what it looks at."""

    def __init__(self, interrupt: Interrupt, label: str):
        import numpy as np  # not above: `orch --help` needs this module, and is fast

        self.interrupt, self._label = interrupt, label
        self.ends: list[End] = []
        self._board = np.zeros(1, dtype=np.dtype(BOARD, align=True))
        self._what, self._patience, self._step = "", 0.0, 0.0
        self._names: tuple[str, ...] = ()
        self._signals, self._signalled = socket.socketpair()
        self._signalled.setblocking(False)
        self._stopping = self._handled = self._raising = False
        self._halting = threading.Lock()
        self._main = threading.get_ident()

    def doing(self, what: str, patience: float) -> None:
        self._what, self._patience = what, patience
        self._board["patience"] = patience
        self._board["what"] = what.encode()[: WHAT - 1]
        self._board["count"] += 1

    def stepping(self, names: Sequence[str], step: float) -> Table:
        self._names, self._step = tuple(names), step
        import numpy as np

        self._bytes = np.array([name.encode()[:NAME] for name in names], dtype=f"S{NAME}")
        self._board["names"], self._board["components"] = self._bytes.ctypes.data, len(names)
        self._board["step"] = step
        return self._board["place"]

    @contextlib.contextmanager
    def running(self) -> Iterator[None]:
        thread = threading.Thread(target=self._run, name="orch-watch", daemon=True)
        with self._signals, self._signalled, _handling(self._handle, SIGNALS) as self._handled:
            earlier = signal.set_wakeup_fd(self._signalled.fileno(), warn_on_full_buffer=False) if self._handled else -1
            self._earlier = earlier
            thread.start()
            line = self._second_line()
            try:
                yield
            finally:
                if line is not None:
                    _watch.stop(line)
                if self._handled:
                    signal.set_wakeup_fd(earlier)
                self._stopping = True
                with contextlib.suppress(BlockingIOError):  # many signals wait
                    self._signalled.send(b"\0")
                thread.join()

    def _second_line(self) -> object:
        if _watch is None or self._board.nbytes != _watch.SIZE:
            return None
        signals = self._signals.fileno() if self._handled else -1
        return _watch.start(self._board, signals, REPORTS, SLOW, TERMINATION, self._label.encode(), self.halt)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self.interrupt.set()
        if self._raising and self._call() and not self._patience:
            self._raising = False
            raise KeyboardInterrupt

    def _call(self) -> str:
        """What is being done that may never return, or ""."""
        if place := int(self._board["place"][0]):
            tick, component = divmod(place - 1, len(self._names))
            return f"{self._names[component]!r} is in its step at t = {tick * self._step:.10g} s"
        return self._what

    def _run(self) -> None:
        state, since, due = (-1, -1), 0.0, SLOW
        pressed: list[tuple[float, int]] = []
        urgent = raised = 0.0
        while not self._stopping:
            pressed += [(time.monotonic(), number) for number in self._wait(SOON if pressed else LOOK)]
            now = time.monotonic()
            self._board["alive"], self._board["pressed"] = now, len(pressed)
            if (seen := (int(self._board["place"][0]), int(self._board["count"][0]))) != state:
                state, since, due = seen, now, SLOW
            if now - since >= due and (call := self._call()):
                hint = "; Ctrl-C, pressed twice, ends it" if self._handled else ""
                report(f"{self._label}{call}, for {now - since:.0f} s now{hint}")
                due *= 2
            if not urgent and _is_urgent(pressed, now):
                self.interrupt.urgent, urgent = True, now
            if urgent and now - max(urgent, since) >= STUCK + self._patience and self._call():
                if not raised and not self._patience:
                    self._raising, raised = True, now
                    self._wake()
                elif now - raised >= 2 * STUCK:
                    self.halt()

    def _wait(self, seconds: float) -> list[int]:
        """Signals that come within so many seconds."""
        self._signals.settimeout(seconds)
        try:
            numbers = self._signals.recv(64)
        except TimeoutError:
            return []
        others = bytes(number for number in numbers if number and number not in SIGNALS)
        if others and self._earlier >= 0:
            with contextlib.suppress(OSError):
                os.write(self._earlier, others)
        return [number for number in numbers if number in SIGNALS]

    def _wake(self) -> None:
        """Have the handler called in the main thread, also where that sleeps."""
        if hasattr(signal, "pthread_kill"):
            signal.pthread_kill(self._main, signal.SIGINT)
        else:
            signal.raise_signal(signal.SIGINT)

    def halt(self) -> None:
        """Bring about the ends, and end the process."""
        if not self._halting.acquire(blocking=False):
            return
        self._board["alive"] = math.inf
        threading.Timer(LAST, os._exit, [INTERRUPTED]).start()
        texts = [f"{self._label}ended by force: {self._call()}"]
        for end in reversed(self.ends):
            try:
                texts.append(end())
            except Exception as error:
                texts.append(f"{type(error).__name__}: {error}")
        report("\n".join(filter(None, texts)))
        os._exit(INTERRUPTED)


def _is_urgent(pressed: Sequence[tuple[float, int]], now: float) -> bool:
    """pressed: when [s] which signal came."""
    if not pressed:
        return False
    again = any(number == signal.SIGINT for _, number in pressed[1:])
    return again or any(number != signal.SIGINT and now - when >= TERMINATION for when, number in pressed)


def report(text: str) -> None:
    """Write it to stderr, or where reports of this process go."""
    with contextlib.suppress(OSError):
        sys.stderr.flush()
        os.write(REPORTS, f"{text}\n".encode(errors="replace"))
