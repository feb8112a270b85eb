"""The co-simulation master.

At tick k, time t = k * step, every component that is due steps from t to the end of its own period, in the order of the
experiment.  When its results become visible to the others:

    gauss-seidel, period of one tick     at once: components listed later use them in the same tick
    jacobi, period of one tick           when all components have stepped
    a longer period                      what depends on an input at once (a control law): as above, and it is held;
                                         the rest (a state, a reference) belongs to the end of the period and is
                                         visible from then on

So a command computed from the state at t acts from t, and no value is visible before its time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial

from ..instances.instance import DISCARD
from ..instances.live import LiveInstance
from ..watch import Interrupt, at_halt, doing
from .bursts import Bursts
from .initialization import AlgebraicLoop, initialize
from .loop import Loop, choose, out_of_date
from .observer import Observer, Outcome
from .sampling import Limits, Samples
from .stepper import ComponentFailed, Timing
from .system import System

CHUNK_SECONDS = 0.02  # of wall time between two calls of the observers
CHUNK_BYTES = 1 << 23  # of rows


def run(
    system: System,
    observers: Sequence[Observer],
    interrupt: Interrupt | None = None,
    begin: Callable[[System], list[str]] = initialize,
    bursts: Bursts | None = None,
    outcome: Outcome | None = None,
) -> Outcome:
    """Run the opened system to its end, to a failure, or until `interrupt` is set.

    begin: brings the system to the values of its first row and returns warnings; it may raise what `initialize` does.
    bursts: of the system, filled on the way.  outcome: a new one, filled on the way, and by `watch.at_halt` where a
    component never returns.
    """
    outcome, interrupt = outcome or Outcome(ticks=system.plan.first), interrupt or Interrupt()
    try:
        with at_halt(partial(_halt, system, outcome)):
            _run(system, observers, outcome, interrupt, begin, bursts or Bursts(system))
    except KeyboardInterrupt:
        if not interrupt.urgent:
            raise
        _interrupted(system, outcome)
    except ComponentFailed as failure:
        _fail(system, outcome, _cause(system, failure), interrupt)
    except AlgebraicLoop as loop:
        outcome.status, outcome.error = "failed", str(loop)
        outcome.failed_at = system.plan.experiment.grid.time(outcome.ticks)
    for stepper in system.steppers:
        name, instance = stepper.component.name, stepper.instance
        if isinstance(instance, LiveInstance):
            outcome.heard[name] = instance.heard
        outcome.warnings += [f"{name}: {message}" for message in instance.take_messages()]
    outcome.warnings += system.opened_files()
    if outcome.status == "running":
        outcome.status = "completed"
    return outcome


def _run(
    system: System,
    observers: Sequence[Observer],
    outcome: Outcome,
    interrupt: Interrupt,
    begin: Callable[[System], list[str]],
    bursts: Bursts,
) -> None:
    outcome.warnings += system.plan.warnings
    outcome.warnings += begin(system)
    outcome.calculated = system.calculated()
    doing("")
    for observer in observers:
        observer.opened(system.view)
    _step_all(system, observers, outcome, interrupt, bursts)


def _interrupted(system: System, outcome: Outcome, words: str = "") -> None:
    outcome.status = "interrupted"
    outcome.error = f"interrupted at t = {system.plan.experiment.grid.time(outcome.ticks):.10g} s{words}"


def _halt(system: System, outcome: Outcome) -> str:
    """The end of a run of which a component never returns."""
    _interrupted(system, outcome, ", by force")
    return ""


def _cause(system: System, failure: ComponentFailed) -> ComponentFailed:
    """A component that gave a value that is not finite failed before the one that refused it in the same step."""
    for stepper in system.steppers:
        if stepper is not failure.stepper and (message := stepper.not_finite()):
            return ComponentFailed(stepper, message)
    return failure


def _fail(system: System, outcome: Outcome, failure: ComponentFailed, interrupt: Interrupt) -> None:
    grid = system.plan.experiment.grid
    if interrupt.urgent or (interrupt.is_set() and failure.stepper.instance.batched):
        # It did not answer after the interruption, or a KeyboardInterrupt has ended what it did.
        _interrupted(system, outcome, f"; {failure.name!r}: {failure}")
        return
    if failure.status == DISCARD and failure.stepper.instance.wants_to_end():
        outcome.stopped_at = grid.time(outcome.ticks)
        return
    outcome.status = "failed"
    outcome.failed_at = grid.time(outcome.ticks)
    outcome.error = f"{failure.name!r} failed at t = {outcome.failed_at:.10g} s: {failure}"
    outcome.last_inputs = failure.stepper.last_inputs()
    outcome.traceback = failure.traceback


def _step_all(
    system: System, observers: Sequence[Observer], outcome: Outcome, interrupt: Interrupt, bursts: Bursts
) -> None:
    timing = Timing([component.period for component in system.plan.components])
    samples, limits = Samples(system), Limits(system)
    loop = choose(system, bursts, samples, limits, timing, interrupt)
    if message := out_of_date():
        outcome.warnings.append(message)
    _hand_over(loop, observers)
    first, steps, chunk, largest = loop.ticks, system.plan.steps, 1, _largest_chunk(system)
    began = time.perf_counter()

    def reached() -> None:
        outcome.ticks = loop.ticks
        samples.evaluate(loop.ticks)
        _hand_over(loop, observers)

    def halt() -> str:
        loop.halt()
        reached()
        outcome.metrics = samples.results()
        return ""

    try:
        with at_halt(halt):
            while loop.ticks < steps and not interrupt.is_set() and outcome.stopped_at is None:
                since = time.perf_counter()
                try:
                    last = samples.limit(loop.ticks, min(steps, loop.ticks + chunk))
                    for observer in observers:
                        last = observer.limit(loop.ticks, last)
                    loop.advance(last, CHUNK_SECONDS)
                except ComponentFailed as failure:
                    if not _ends_with_its_step(system, loop.ticks, failure):
                        raise
                    loop.complete(system.steppers.index(failure.stepper))
                    outcome.stopped_at = system.plan.experiment.grid.time(loop.ticks)
                finally:
                    reached()
                elapsed = time.perf_counter() - since
                chunk = max(1, min(2 * chunk, int(chunk * CHUNK_SECONDS / max(elapsed, 1e-6)), largest))
                for observer in observers:
                    observer.progress(loop.ticks)
    finally:  # also of a run that fails, or that an FMU ends
        outcome.metrics = samples.results()
        timing.stepping = time.perf_counter() - began
        bursts.last = loop.ticks
        live = {
            stepper.component.name: (stepper.instance.seconds, stepper.instance.waited)
            for stepper in system.steppers
            if isinstance(stepper.instance, LiveInstance)
        }
        names = [component.name for component in system.plan.components]
        outcome.timing = timing.summary(names, loop.ticks - first, loop.name, live)
        for observer in observers:
            outcome.timing |= observer.facts()
        outcome.warnings += limits.warnings()
        outcome.warnings += samples.warnings()
    if loop.ticks < steps and outcome.stopped_at is None:
        _interrupted(system, outcome)


def _ends_with_its_step(system: System, tick: int, failure: ComponentFailed) -> bool:
    """Whether an FMU asks to end the simulation at the end of the step that it has just done."""
    if failure.status != DISCARD or not failure.stepper.instance.wants_to_end():
        return False
    end = system.plan.experiment.grid.time(tick + failure.stepper.component.period)
    return failure.stepper.instance.has_reached(end)


def _hand_over(loop: Loop, observers: Sequence[Observer]) -> None:
    for block in loop.take():
        for observer in observers:
            observer.rows(block)


def _largest_chunk(system: System) -> int:
    """Ticks whose rows take CHUNK_BYTES."""
    row = sum(8 * len(places) for places in system.recorded.values()) + 16 * len(system.plan.bounded)
    return system.plan.stride * max(1, CHUNK_BYTES // max(1, row))
