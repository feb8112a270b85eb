"""What the compiled loop is given: a system as numbers, addresses and arrays.

`_loop.c` reads these tuples field by field and exports, as LAYOUT, which fields, kinds and moments it was compiled for.
`layout` is the same of this side: where the two differ, the library was built from other sources.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..arrays import Places, Reals, References, Table, Truths
from ..fmu.variables import FLOATS, NUMBERS
from ..instances.instance import Verb, references_of
from ..watch import Interrupt
from .bursts import Bursts, BurstsProgram, ClockProgram
from .sampling import ANGLE, LIMIT, Limits, Samples, SamplesProgram, WatchedProgram
from .stepper import EVERY, Getter, Moment, Setter, Stepper, Timing
from .system import System

NOT_FINITE = -1  # a status beside those of FMI
CONVERSION = np.dtype([("kind", "i8"), ("source", "i8"), ("target", "i8"), ("factor", "f8"), ("offset", "f8")])


class CallProgram(NamedTuple):
    """One getter or setter of numbers."""

    kind: int  # its place in NUMBERS, here and below
    address: int  # of the FMI function; 0: the step does it
    references: References
    values: Table
    sources: Places | None  # of a setter: values[targets] = table[sources]
    targets: Places | None
    conversions: Table | None  # (n,) of CONVERSION


class PublicationProgram(NamedTuple):
    """table[targets] = values[chosen]."""

    kind: int
    values: Table
    chosen: Places
    targets: Places


class StepperProgram(NamedTuple):
    """A component."""

    version: int  # of FMI
    handle: int
    address: int  # of doStep
    answers: tuple[Truths, Reals] | None  # as StepFunction has them
    h: float  # s
    period: int  # ticks
    sets: list[CallProgram]
    gets: list[CallProgram]
    published: tuple[list[PublicationProgram], ...]  # by Moment


class Program(NamedTuple):
    """A system."""

    steppers: list[StepperProgram]
    tables: tuple[Table, ...]  # of each kind
    computed: tuple[int, ...]  # how many values of the tables of FLOATS are outputs
    recorded: tuple[Places, ...]  # of each kind
    bursts: BurstsProgram
    sampled: SamplesProgram
    watched: WatchedProgram
    seconds: Reals  # (steppers, 3), see Timing
    samples: Table  # (steppers,) int64
    sample_every: int  # ticks
    interrupt: Table  # (1,) int32
    place: Table  # (1,) int64, see `watch.stepping`
    stride: int  # ticks from row to row
    holds_lock: bool  # Python's, while it steps
    records_inputs: bool


def program_of(
    system: System, bursts: Bursts, samples: Samples, limits: Limits, timing: Timing, interrupt: Interrupt, place: Table
) -> Program:
    """The program of an opened system.  The system must stay open while it is used."""
    plan = system.plan
    return Program(
        steppers=[_stepper(stepper) for stepper in system.steppers],
        tables=tuple(system.tables[kind] for kind in NUMBERS),
        computed=tuple(system.computed[kind] for kind in FLOATS),
        recorded=tuple(system.recorded[kind] for kind in NUMBERS),
        bursts=bursts.program(),
        sampled=samples.program(),
        watched=limits.program(),
        seconds=timing.seconds,
        samples=timing.samples,
        sample_every=EVERY,
        interrupt=interrupt.flag,
        place=place,
        stride=plan.stride,
        # Python FMUs take the interpreter's lock at each call: that costs more than holding it.
        holds_lock=any(s.instance.batched or s.component.fmu.packaging == "python" for s in system.steppers),
        records_inputs=plan.reads_inputs,
    )


def _stepper(stepper: Stepper) -> StepperProgram:
    step = stepper.instance.step_function()
    return StepperProgram(
        version=step.version,
        handle=step.handle,
        address=step.address,
        answers=step.answers,
        h=stepper.h,
        period=stepper.component.period,
        sets=[_call(stepper, "Set", setter) for setter in stepper.setters],
        gets=[_call(stepper, "Get", getter) for getter in stepper.getters],
        published=tuple(
            [
                PublicationProgram(NUMBERS.index(p.kind), p.buffer, p.chosen, p.targets)
                for p in stepper.publications
                if p.moment == moment
            ]
            for moment in Moment
        ),
    )


def _call(stepper: Stepper, verb: Verb, call: Setter | Getter) -> CallProgram:
    sources = targets = conversions = None
    if isinstance(call, Setter):
        sources, targets = call.sources, call.targets
        rows = [(NUMBERS.index(c.kind), c.source, c.target, c.factor, c.offset) for c in call.conversions]
        conversions = np.array(rows, CONVERSION) if rows else None
    return CallProgram(
        kind=NUMBERS.index(call.kind),
        address=stepper.instance.address(verb, call.kind),
        references=references_of(call.variables),
        values=call.buffer,
        sources=sources,
        targets=targets,
        conversions=conversions,
    )


def layout() -> dict[str, str]:
    """Fields, kinds and moments in the order of this side, as LAYOUT of `_loop.c`."""
    records = (
        Program,
        StepperProgram,
        CallProgram,
        PublicationProgram,
        BurstsProgram,
        ClockProgram,
        SamplesProgram,
        WatchedProgram,
    )
    return {
        **{record.__name__: " ".join(record._fields) for record in records},
        "Conversion": " ".join(CONVERSION.names or ()),
        "Limit": " ".join(LIMIT.names or ()),
        "Angle": " ".join(ANGLE.names or ()),
        "kinds": "".join(f"{kind} " for kind in NUMBERS),
        "moments": " ".join(Moment.__members__),
        "NOT_FINITE": str(NOT_FINITE),
    }
