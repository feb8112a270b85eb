"""FMUs loaded and initialized for a trial, each in a process of its own: a crash there is reported as a message here.

python -m orchestrator.runs.trial FILE     the child: a pickled Plan of one component on
                                           stdin, the outcome into FILE
"""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

from ..errors import OrchError, Problem
from ..plan.plan import Component, Plan
from ..watch import communicate

TIMEOUT = 60.0  # s, for what takes one
# What the child writes before each phase, and how to say that it is or ended there.
PHASES = {
    "begin": ("is about to be loaded", "before it was loaded"),
    "load": ("is loaded", "while it was loaded and instantiated"),
    "initialize": ("is initialized", "while it was initialized"),
    "free": ("is freed", "while it was freed"),
}
DONE, FAILED = "done", "failed"


def problems(plan: Plan, timeout: float = TIMEOUT) -> list[Problem]:
    """What goes wrong when each component is instantiated and initialized alone, its inputs at their start values.

    timeout: s, for each.  Components of the same FMU and the same values are tried once.
    """
    first: dict[tuple[str, ...], Component] = {}
    for component in (component for component in plan.components if not component.live):
        values = (repr(sorted(component.parameters.items())), repr(sorted(component.start.items())))
        first.setdefault((component.fmu.sha256, str(component.period), *values), component)
    children: list[subprocess.Popen[bytes]] = []
    with ThreadPoolExecutor(max_workers=os.cpu_count()) as pool:
        try:
            futures = {
                pool.submit(_try, plan, component, timeout, children): component.name for component in first.values()
            }
            results = {name: future.result() for future, name in futures.items()}
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in children:
                child.kill()
            raise
    return [Problem(f"components.{name}.fmu", sentence) for name, sentence in results.items() if sentence]


def _try(plan: Plan, component: Component, timeout: float, children: list[subprocess.Popen[bytes]]) -> str:
    """What goes wrong with one component, "" for nothing.  children: of this process, to which its own is added."""
    recorded = tuple((name, variable) for name, variable in plan.recorded if name == component.name)
    alone = replace(plan, components=(component,), connections=(), recorded=recorded)
    # What a child that is killed leaves behind goes with the folder.
    with tempfile.TemporaryDirectory(prefix="orch-", ignore_cleanup_errors=True) as folder:
        outcome = Path(folder) / "outcome"
        outcome.write_text("begin\n", encoding="utf-8")
        child = subprocess.Popen(
            [sys.executable, "-m", "orchestrator.runs.trial", str(outcome)],
            env={**os.environ, "TMPDIR": folder},
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        children.append(child)
        ended = ""
        try:
            communicate(
                child,
                pickle.dumps(alone),
                lambda _: f"{component.name!r} {PHASES.get(_last(outcome)[0], PHASES['begin'])[0]}",
                timeout,
            )
        except subprocess.TimeoutExpired:
            ended = f"was not ready within {timeout:g} s and was killed"
        finally:
            child.kill()
            child.wait()
        phase, words = _last(outcome)
    if phase == DONE and child.returncode == 0:
        return ""
    if phase == FAILED:
        return words
    ended = ended or f"ended the process ({_ending(child.returncode)})"
    return f"{component.fmu.path} {ended} {PHASES[phase][1] if phase in PHASES else 'when it was done'}"


def _last(outcome: Path) -> tuple[str, str]:
    """What a child has written last: the phase, and words."""
    phase, _, words = outcome.read_text(encoding="utf-8").rstrip("\n").rpartition("\n")[2].partition(" ")
    return phase, words


def _ending(code: int) -> str:
    with contextlib.suppress(ValueError):
        return signal.Signals(-code).name
    return f"exit code {code}"


def main(arguments: Sequence[str]) -> None:
    """The child."""
    from ..simulation.initialization import AlgebraicLoop, initialize
    from ..simulation.stepper import ComponentFailed
    from ..simulation.system import System

    with open(arguments[0], "a", encoding="utf-8") as outcome:

        def tell(phase: str, words: str = "") -> None:
            outcome.write(f"{phase} {' '.join(words.split())}\n")
            outcome.flush()

        try:
            plan = pickle.load(sys.stdin.buffer)
            tell("load")
            with System.open(plan) as system:
                tell("initialize")
                initialize(system)
                tell("free")
            tell(DONE)
        except ComponentFailed as error:
            tell(FAILED, f"{plan.components[0].fmu.path} fails to initialize: {error}")
        except (OrchError, AlgebraicLoop) as error:
            tell(FAILED, str(error))
    os._exit(0)  # an FMU that has failed may crash at exit


if __name__ == "__main__":
    main(sys.argv[1:])
