"""What every master of the benchmark is given: an experiment as plain data, which costs nothing to import."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Variable:
    """One FMI variable of a component.  kind: real, integer or boolean."""

    component: str
    name: str
    reference: int
    kind: str

    @property
    def signal(self) -> str:
        return f"{self.component}.{self.name}"


@dataclass(frozen=True)
class Component:
    """One FMU to be stepped.  `values`: of its parameters and of inputs that nothing drives."""

    name: str
    fmu: str
    values: list[tuple[Variable, Any]]


@dataclass(frozen=True)
class Task:
    """An experiment to be run.

    step: s, as a numerator and a denominator, so that `time` rounds once, as orch does; steps: how many; stride: steps
    from row to row of the record; connections: pairs of input and output; recorded: outputs, a row's columns.
    """

    step: tuple[int, int]
    steps: int
    stride: int
    components: list[Component]
    connections: list[tuple[Variable, Variable]]
    recorded: list[Variable]

    @classmethod
    def of(cls, plan: Any) -> Task:
        """The task that an `orchestrator.plan.plan.Plan` is."""

        def variable(component: str, v: Any) -> Variable:
            return Variable(component, v.name, v.reference, v.kind)

        components = []
        for component in plan.components:
            if component.period != 1:
                raise SystemExit(f"{component.name} has a step of its own, which this benchmark does not compare")
            values = {**component.parameters, **component.start}
            components.append(
                Component(
                    component.name,
                    str(component.fmu.path),
                    [
                        (variable(component.name, component.fmu.variables[name]), value)
                        for name, value in values.items()
                    ],
                )
            )
        step = Fraction(repr(plan.experiment.master.step))
        return cls(
            (step.numerator, step.denominator),
            plan.steps,
            plan.stride,
            components,
            [
                (variable(connection.sink, connection.input), variable(connection.source, connection.output))
                for connection in plan.connections
            ],
            [variable(component, v) for component, v in plan.recorded],
        )

    @property
    def h(self) -> float:
        """The communication step [s]."""
        return self.time(1)

    def time(self, k: int) -> float:
        """Of step k [s]."""
        return k * self.step[0] / self.step[1]

    def of_component(self, variables: list[Variable], name: str) -> list[Variable]:
        return [v for v in variables if v.component == name]

    def save(self, path: Path) -> None:
        path.write_text(json.dumps(asdict(self)))

    @classmethod
    def load(cls, path: Path) -> Task:
        data = json.loads(path.read_text())
        components = [
            Component(c["name"], c["fmu"], [(Variable(**v), value) for v, value in c["values"]])
            for c in data["components"]
        ]
        connections = [(Variable(**sink), Variable(**source)) for sink, source in data["connections"]]
        recorded = [Variable(**v) for v in data["recorded"]]
        return cls(tuple(data["step"]), data["steps"], data["stride"], components, connections, recorded)
