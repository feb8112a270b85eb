"""What will run: an experiment with every name resolved and every value checked, and the digest that identifies it."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

from .. import metrics
from ..experiment.experiment import Experiment
from ..fmu.builtin import DEAF
from ..fmu.fmu import Fmu
from ..fmu.units import symbol
from ..fmu.variables import ANGLE, NUMBERS, Variable
from ..names import ETA_AXES, NU_AXES, matches
from ..warning import Kind, Warned


class Origin(Protocol):
    """Where a run goes on from, in place of its beginning.  Its text is shown."""

    @property
    def tick(self) -> int:
        """Of the master, at which the run goes on."""

    @property
    def summary(self) -> dict[str, Any]:
        """What of it decides the numbers of the run, as JSON can hold it."""

    @property
    def attributes(self) -> dict[str, Any]:
        """What the record of the run says of it."""


@dataclass(frozen=True, kw_only=True)
class Component:
    """A component ready to be instantiated."""

    name: str
    fmu_name: str  # as the experiment names it
    fmu: Fmu
    period: int  # ticks of the master
    parameters: Mapping[str, Any]  # {FMI variable: value}
    start: Mapping[str, Any]
    isolated: bool = False  # runs in a process of its own
    live: bool = False  # a builtin, which only runs inside orch
    timeout: float | None = None  # s of wall time that one of its steps may take, when isolated
    tolerance: float | None = None  # of the solver inside its FMU

    @property
    def is_vehicle(self) -> bool:
        """Whether it puts out a whole `eta` and `nu`."""
        return self.puts_out("eta", ETA_AXES) and self.puts_out("nu", NU_AXES)

    @property
    def hears(self) -> bool:
        """Whether what it does depends on the world outside."""
        return self.live and self.fmu_name not in DEAF

    def puts_out(self, vector: str, axes: Iterable[str]) -> bool:
        """Whether real outputs of the FMU make up the axes of a vector."""
        variables = self.fmu.lookup(vector)
        outputs = {axis for axis, v in variables.items() if v.causality == "output" and v.kind == "real"}
        return outputs.issuperset(axes)


@dataclass(frozen=True)
class Connection:
    """One scalar connection: input = factor * output + offset."""

    sink: str
    input: Variable
    source: str
    output: Variable
    factor: float = 1.0
    offset: float = 0.0

    @property
    def direct(self) -> bool:
        """Whether the value is copied as it is."""
        return self.input.kind == self.output.kind and self.factor == 1.0 and self.offset == 0.0

    @property
    def ends(self) -> list[Any]:
        """Input and output by name, and what lies between them where it is not direct."""
        names: list[Any] = [f"{self.sink}.{self.input.name}", f"{self.source}.{self.output.name}"]
        return names if self.factor == 1.0 and self.offset == 0.0 else [*names, self.factor, self.offset]


def readable(fmus: Mapping[str, Fmu]) -> dict[str, tuple[str, Variable]]:
    """{signal: its component, and the variable} of every number that can be read while a run goes on."""
    return {
        f"{component}.{variable.name}": (component, variable)
        for component, fmu in fmus.items()
        for variable in fmu.variables.values()
        if variable.causality in ("output", "input", "local") and variable.kind in NUMBERS
    }


def units_of(fmus: Mapping[str, Fmu]) -> dict[str, str]:
    """{signal: unit} of what is `readable`, "" where it has none."""
    return {name: symbol(v.unit, fmus[component].units) for name, (component, v) in readable(fmus).items()}


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What will run.  `recorded`: component and variable of each signal; `watched`: of those that have a place in the
    table of values, too, for an observer."""

    experiment: Experiment
    components: tuple[Component, ...]
    connections: tuple[Connection, ...]
    recorded: tuple[tuple[str, Variable], ...]
    notes: tuple[str, ...]
    created: str = ""  # when, where a component is live: each such run is one of its kind
    watched: tuple[tuple[str, Variable], ...] = ()
    origin: Origin | None = None  # where it goes on from; None: from the beginning

    @property
    def warnings(self) -> list[Warned]:
        """Sentences on what goes against an FMU's min, max or internal step, and on angles that look like degrees."""
        limits = [
            f"{component.name}: {name} = {value} is {side} {limit:g}, the {which} that its FMU declares"
            for component in self.components
            for name, value in [*component.parameters.items(), *component.start.items()]
            for low, high in [component.fmu.variables[name].limits]
            for side, limit, which in [("below", low, "min"), ("above", high, "max")]
            if isinstance(value, (int, float)) and (value < low if which == "min" else value > high)
        ]
        degrees = [
            f"{component.name}: {name} = {value:g} rad is more than a full turn; {value:g} degrees are "
            f"{math.radians(value):.4g} rad"
            for component in self.components
            for name, value in [*component.parameters.items(), *component.start.items()]
            if component.fmu.variables[name].unit == "rad" and abs(value) > 2 * math.pi
        ]
        steps = [
            f"{component.name}: steps every {step:g} s, no multiple of the {inner:g} s in which its FMU steps inside "
            "(fixedInternalStepSize): what it gives may be late"
            for component in self.components
            for step, inner in [(component.period * self.experiment.master.step, component.fmu.internal_step)]
            if inner and abs(step / inner - max(1, round(step / inner))) > 1e-6
        ]
        return [*(Warned(text, Kind.LIMIT) for text in (*limits, *degrees)), *map(Warned, steps)]

    @property
    def cautions(self) -> list[str]:
        """Sentences on what is allowed and hardly meant: its warnings, and metrics that would stay empty."""
        begin, end = self.first * self.experiment.master.step, self.experiment.master.stop_time
        outside = [name for name in self.experiment.metrics if not self.has_sample(name)]
        empty = f"no sample falls into the window of {', '.join(outside)}: the run goes from {begin:g} to {end:g} s"
        return [*self.warnings, *([empty] if outside else [])]

    def has_sample(self, metric: str, last: int | None = None) -> bool:
        """Whether a sample falls into the window of a metric.  last: the tick at which the run ended, if early."""
        last = self.steps if last is None else last
        return self.experiment.grid.has_sample(self.experiment.metrics[metric], self.first, last)

    @property
    def first(self) -> int:
        """The tick at which the run begins."""
        return self.origin.tick if self.origin else 0

    @property
    def steps(self) -> int:
        """The tick at which the run ends."""
        ticks = self.experiment.grid.ticks(self.experiment.master.stop_time)
        assert ticks is not None  # checked by the reader
        return ticks

    @cached_property
    def readable(self) -> dict[str, tuple[str, Variable]]:
        """{signal: its component, and the variable} of every number that can be read while the run goes on."""
        return readable({component.name: component.fmu for component in self.components})

    @cached_property
    def units(self) -> dict[str, str]:
        """{signal: unit} of what is readable, "1" where it has none; see `fmu.units.symbol`."""
        return {name: unit or "1" for name, unit in units_of({c.name: c.fmu for c in self.components}).items()}

    @cached_property
    def angles(self) -> set[str]:
        """The readable signals whose differences are differences on the circle."""
        return {name for name, (_, variable) in self.readable.items() if variable.quantity == ANGLE}

    @cached_property
    def measured(self) -> tuple[tuple[str, Variable], ...]:
        """The signals that the metrics need, recorded or not."""
        names = (n for spec in self.experiment.metrics.values() for n in metrics.signals_of(spec, self.readable))
        return tuple(self.readable[name] for name in dict.fromkeys(names) if name in self.readable)

    @cached_property
    def bounded(self) -> tuple[tuple[str, Variable], ...]:
        """The recorded signals whose least and largest value between rows are recorded, too: `record.envelope`."""
        wanted = self.experiment.record.envelope
        if wanted is False or self.stride == 1:
            return ()
        return tuple(
            (component, v)
            for component, v in self.recorded
            if v.kind == "real" and not v.shape
            if (
                v.causality == "output" and v.feedthrough
                if wanted is True
                else any(matches(f"{component}.{v.name}", pattern) for pattern in wanted)
            )
        )

    @property
    def reads_inputs(self) -> bool:
        """Whether inputs are recorded or measured: then the values that were set stay readable."""
        return self.experiment.record.inputs or any(v.causality == "input" for _, v in self.measured)

    @property
    def stride(self) -> int:
        """Ticks from row to row."""
        ticks = self.experiment.grid.ticks(self.experiment.record.every)
        assert ticks is not None
        return ticks

    @cached_property
    def resolved(self) -> dict[str, Any]:
        """The whole of it, as JSON can hold it."""
        master, record = self.experiment.master, self.experiment.record
        resolved: dict[str, Any] = {
            "title": self.experiment.title,
            "master": {
                "stop_time": master.stop_time,
                "step": master.step,
                "algorithm": master.algorithm,
                "seed": master.seed,
            },
            "components": [
                {
                    "name": p.name,
                    "fmu": p.fmu_name,
                    "fmu_sha256": p.fmu.sha256,
                    "period": p.period,
                    "parameters": dict(sorted(p.parameters.items())),
                    "start": dict(sorted(p.start.items())),
                    **({} if p.tolerance is None else {"tolerance": p.tolerance}),
                }
                for p in self.components
            ],
            "connections": sorted(connection.ends for connection in self.connections),
            "record": {"every": record.every, "signals": [f"{c}.{v.name}" for c, v in self.recorded]},
            "metrics": {name: dict(spec) for name, spec in self.experiment.metrics.items()},
        }
        if record.envelope is not True:
            resolved["record"]["envelope"] = record.envelope and list(record.envelope)
        if self.created:
            resolved["created"] = self.created
        if self.origin:
            resolved["from"] = self.origin.summary
        return resolved

    @property
    def live(self) -> bool:
        """Whether something steers from outside."""
        return any(component.live for component in self.components)

    @cached_property
    def digest(self) -> str:
        """The SHA-256 of what decides the numbers: not titles, not metrics, and of an FMU its content, not its name."""
        components = [{k: v for k, v in c.items() if k != "fmu"} for c in self.resolved["components"]]
        keys = [key for key in ("master", "connections", "record", "created", "from") if key in self.resolved]
        deciding: dict[str, Any] = {**{key: self.resolved[key] for key in keys}, "components": components}
        text = json.dumps(deciding, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()
