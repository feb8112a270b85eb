"""The runs that the thesis's chapter 5 consists of: 12 spirals and 6 grippings, each an experiment file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ....models.catalogue import experiments_folder
from ....plan.plan import Plan
from ....runs.prepare import prepare

LABELS = {
    "pid": "PID",
    "feedback_linearization": "Feedback linearization",
    "lyapunov": "Lyapunov-based",
    "mfsosmc": "MFSOSMC",
    "nstsmc": "NSTSMC",
    "ftsosmc": "FTSOSMC",
}
TIME_BASES = (3, 5, 7)  # s
QUICK_STEP = 4e-5  # s, of the spirals under MFSOSMC with --quick; their files have 0.02 ms


@dataclass(frozen=True, kw_only=True)
class Case:
    """One run: an experiment file, and what is changed in it.

    name: of the file in experiments/thesis, and of the folder in the store.
    """

    name: str
    task: str  # spiral, gripping
    controller: str
    currents: bool
    t_b: int | None = None  # s, of a spiral under MFSOSMC
    sets: Mapping[str, Any] = field(default_factory=dict)

    @property
    def path(self) -> Path:
        return thesis_folder() / f"{self.name}.toml"

    @property
    def key(self) -> str:
        """Name and changes: what tells one run from another."""
        return " ".join([self.name, *(f"{key}={value}" for key, value in self.sets.items())])

    @property
    def label(self) -> str:
        """The controller as a legend names it."""
        return LABELS[self.controller] + (f", $t_b$ = {self.t_b} s" if self.t_b else "")

    def plan(self) -> Plan:
        """The resolved experiment.  Raises ExperimentError."""
        return prepare(self.path, self.sets)

    def quick(self) -> Case:
        """The same at a coarser step, where that saves time."""
        if self.controller != "mfsosmc" or self.task != "spiral":
            return self
        return replace(self, sets={**self.sets, "master.step": QUICK_STEP})


def thesis_folder() -> Path:
    return experiments_folder() / "thesis"


def case_name(task: str, controller: str, currents: bool = False, t_b: int | None = None) -> str:
    return f"thesis_{task}_{controller}" + (f"_{t_b}" if t_b else "") + ("_currents" if currents else "")


def _cases() -> dict[str, Case]:
    spirals: list[tuple[str, int | None]] = [("pid", None), ("feedback_linearization", None), ("lyapunov", None)]
    spirals += [("mfsosmc", t_b) for t_b in TIME_BASES]
    cases = [
        Case(
            name=case_name("spiral", controller, currents, t_b),
            task="spiral",
            controller=controller,
            currents=currents,
            t_b=t_b,
        )
        for currents in (False, True)
        for controller, t_b in spirals
    ]
    cases += [
        Case(
            name=case_name("gripping", controller, currents), task="gripping", controller=controller, currents=currents
        )
        for currents in (False, True)
        for controller in ("mfsosmc", "nstsmc", "ftsosmc")
    ]
    return {case.name: case for case in cases}


CASES = _cases()


def spirals(currents: bool) -> list[Case]:
    """The spirals in the order of the tables' rows."""
    return [case for case in CASES.values() if case.task == "spiral" and case.currents == currents]


def grippings(currents: bool) -> list[Case]:
    return [case for case in CASES.values() if case.task == "gripping" and case.currents == currents]
