"""The masters that are compared.  Each run is a process of its own, from its start to its exit."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from limit import compile_limit
from task import Task

from orchestrator import experiment
from orchestrator.grid import Grid
from orchestrator.plan import Plan
from orchestrator.store import Run
from orchestrator.wiring import prepare

HERE = Path(__file__).resolve().parent
EXPERIMENT = HERE.parent / "experiments" / "gripping_currents.toml"
HOW = {
    "fmpy": "pip install fmpy",
    "libcosim": "pip install libcosimpy",
    "ecos": "pip install ecospy, and apt install libtbb12",
    "limit": "install gcc or clang",
    "orch": "pip install -e .",
}


class Unusable(Exception):
    """A contender that does not run here, and what would help."""


@dataclass(frozen=True)
class Contender:
    """master: orch, limit or one of peers.py; packaging: of the FMUs, native or python; loop: of orch, compiled or
    python; share: of the steps asked for, which slower ones need less of."""

    master: str
    packaging: str
    loop: str = ""
    share: float = 0.1

    @property
    def name(self) -> str:
        if self.master == "limit":
            return "the same C in one function"
        return {"compiled": "orch", "python": "orch, ORCH_LOOP=python", "": self.master}[self.loop]

    @property
    def fmus(self) -> str:
        return "none" if self.master == "limit" else self.packaging


LIMIT = Contender("limit", "native", share=1)
ORCH = Contender("orch", "native", "compiled", share=1)
ORCH_INTERPRETED = Contender("orch", "native", "python")
ORCH_PYTHON = Contender("orch", "python", "compiled")
ORCH_PYTHON_INTERPRETED = Contender("orch", "python", "python")
PEERS = [Contender(master, "native") for master in ("libcosim", "ecos", "fmpy")]
PEERS_PYTHON = [Contender(master, "python", share=0.025) for master in ("libcosim", "ecos", "fmpy")]
ALL = [LIMIT, ORCH, ORCH_INTERPRETED, *PEERS, ORCH_PYTHON, ORCH_PYTHON_INTERPRETED, *PEERS_PYTHON]


@dataclass(frozen=True)
class Measured:
    """steps: of the run; stepping: s of the loop, with recording; whole: s of the process; final: {signal: value}."""

    steps: int
    stepping: float
    whole: float
    final: Mapping[str, float]

    @property
    def step(self) -> float:
        """The cost of one communication step [us]."""
        return self.stepping / self.steps * 1e6

    def process(self, steps: int) -> float:
        """The whole process with that many steps [s]."""
        return self.whole - self.stepping + steps * self.stepping / self.steps


class Bench:
    """Runs contenders; `folder` keeps what they need."""

    def __init__(self, folder: Path, experiment_file: Path = EXPERIMENT):
        self._folder, self._experiment = folder, experiment_file
        self._limits: dict[float, Path] = {}  # by communication step

    def run(self, contender: Contender, h: float, steps: int, algorithm: str = "gauss-seidel") -> Measured:
        """`steps` steps of h [s], or as many as fill the last row.  algorithm: of orch.  Raises Unusable."""
        task = self._task(contender.packaging, h, steps)
        if contender.master == "orch":
            return self._run_orch(contender, task, algorithm)
        if contender.master == "limit":
            command = [str(self._limit(task)), str(task.steps)]
        else:
            file = self._folder / "task.json"
            task.save(file)
            command = [sys.executable, str(HERE / "peers.py"), contender.master, str(file)]
        whole, output = _timed(contender, command)
        answer = json.loads(output)
        return Measured(task.steps, answer["stepping"], whole, answer["final"])

    def _plan(self, packaging: str, h: float, stop_time: float) -> Plan:
        changes = {"master.step": h, "master.stop_time": stop_time}
        return prepare(experiment.load(self._experiment, changes), _tell, packaging)

    def _task(self, packaging: str, h: float, steps: int) -> Task:
        stride = self._plan(packaging, h, 1.0).stride
        steps = -(-steps // stride) * stride
        return Task.of(self._plan(packaging, h, Grid(h).time(steps)))

    def _limit(self, task: Task) -> Path:
        if task.h not in self._limits:
            folder = self._folder / f"limit{len(self._limits)}"
            folder.mkdir()
            try:
                self._limits[task.h] = compile_limit(task, folder)
            except LookupError as error:
                raise Unusable(f"{error}; {HOW['limit']}") from None
        return self._limits[task.h]

    def _run_orch(self, contender: Contender, task: Task, algorithm: str) -> Measured:
        record = self._folder / "record.h5"
        record.unlink(missing_ok=True)
        command = [sys.executable, "-m", "orchestrator.cli", "run", str(self._experiment), "--quiet"]
        command += ["--packaging", contender.packaging, "--output", str(record)]
        for key, value in (("step", task.h), ("stop_time", task.time(task.steps)), ("algorithm", algorithm)):
            command += ["--set", f"master.{key}={json.dumps(value)}"]
        whole, _ = _timed(contender, command)
        with Run(record) as run:
            timing = run.attributes["timing"]
            if timing["loop"] != contender.loop:
                raise Unusable("the compiled loop is not built: pip install -e .")
            final = {v.signal: float(run[v.signal][-1]) for v in task.recorded}
        return Measured(task.steps, timing["stepping"], whole, final)


def _timed(contender: Contender, command: Sequence[str]) -> tuple[float, str]:
    """Seconds of a process, and the last line that it printed.  Raises Unusable where it fails."""
    environment = {name: value for name, value in os.environ.items() if name != "ORCH_LOOP"}
    if contender.loop == "python":
        environment["ORCH_LOOP"] = "python"
    began = time.perf_counter()
    process = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    whole = time.perf_counter() - began
    if process.returncode:
        words = process.stderr.strip().splitlines()[-1:] or [f"exit code {process.returncode}"]
        raise Unusable(f"{words[0]}; {HOW[contender.master]}")
    return whole, "".join(process.stdout.strip().splitlines()[-1:])


def _tell(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
