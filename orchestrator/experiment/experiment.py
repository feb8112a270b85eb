"""What an experiment file says, as data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import Problem
from . import mavlink
from .mavlink import MavlinkSpec
from .timegrid import TimeGrid


@dataclass(frozen=True, kw_only=True)
class MasterSpec:
    stop_time: float  # s
    step: float  # s, communication step
    algorithm: str = "gauss-seidel"
    seed: int | None = None


@dataclass(frozen=True, kw_only=True)
class ComponentSpec:
    name: str
    fmu: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    start: Mapping[str, Any] | str = field(default_factory=dict)  # or "fmu": the FMU's own values
    step: float | None = None  # s, its own period; None: the master's
    isolation: str = "auto"  # one of ISOLATION
    timeout: float | None = None  # s of wall time for a step, in a process of its own
    tolerance: float | None = None  # of the solver inside its FMU; None: what the FMU declares
    builtin: str = ""  # what runs inside orch in place of an FMU
    swapped: bool = False  # by --swap: may lack inputs that its predecessor had


@dataclass(frozen=True, kw_only=True)
class ConnectionSpec:
    """input = gain * output + offset, after the conversion of units."""

    source: str  # component.output
    gain: float | None = None
    offset: float | None = None
    unit_check: bool = True


@dataclass(frozen=True, kw_only=True)
class RecordSpec:
    every: float  # s
    signals: tuple[str, ...] = ("*",)
    inputs: bool = False
    envelope: bool | tuple[str, ...] = True  # or globs: whose least and largest values between rows are recorded


@dataclass(frozen=True, kw_only=True)
class Experiment:
    path: Path
    text: str
    title: str
    master: MasterSpec
    components: tuple[ComponentSpec, ...]
    connections: Mapping[str, ConnectionSpec]  # {"component.input": where from}
    record: RecordSpec
    metrics: Mapping[str, Mapping[str, Any]]
    mavlink: Mapping[str, Any]
    sweep: Mapping[str, Any]
    problems: tuple[Problem, ...] = ()
    notes: tuple[str, ...] = ()  # what --swap dropped
    changes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # {"set": ..., "swap": ...} laid over it

    @property
    def grid(self) -> TimeGrid:
        return TimeGrid(self.master.step)

    @property
    def mavlink_spec(self) -> MavlinkSpec:
        """What [mavlink] says."""
        return mavlink.read(self.mavlink, [component.name for component in self.components])[0]
