"""The second look at feedback loops that move fast: the same experiment at half the step, or less.

`simulation.stability` says what is looked for.  The run itself is not touched: it has ended, and what it is compared
with has instances of its own.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

from ..errors import FmuError
from ..names import split_axis
from ..plan.plan import Plan
from ..simulation import stability
from ..simulation.bursts import Bursts
from ..simulation.initialization import initialize
from ..simulation.master import run as run_master
from ..simulation.observer import Observer, Outcome
from ..simulation.stability import StabilityVerdict, Suspect
from ..simulation.system import FmuSource, System
from ..warning import Kind, Warned
from ..watch import Interrupt
from .checkpoint.file import Checkpoint
from .checkpoint.resume import resume

PARTS = {2: "half the step", 4: "a quarter of the step", 8: "an eighth of the step", 16: "a sixteenth of the step"}
INTERRUPTED = "the comparison was interrupted"

Loops = Mapping[int, Sequence[Suspect]]  # the outputs that move fast, by loop


def judge(plan: Plan, outcome: Outcome, bursts: Bursts, interrupt: Interrupt, source: FmuSource | None = None) -> None:
    """Judge the feedback loops of a run that has ended: `outcome` gets the warnings, and what the judging cost.

    bursts: of the run.  interrupt: ends the judging.  source: where unpacked FMUs come from.
    """
    began = time.perf_counter()
    loops: dict[int, list[Suspect]] = {}
    for suspect in stability.suspects(bursts):
        loops.setdefault(bursts.outputs[suspect.output].loop, []).append(suspect)
    if not loops:
        return
    found: dict[int, Warned] = {}
    obstacle, steps = _obstacle(plan, outcome), 0
    for factor in () if obstacle else PARTS:
        shorter = Shorter(plan, bursts, loops, factor)
        obstacle = shorter.run(interrupt, source)
        steps += shorter.steps
        if obstacle:
            break
        unstable = {loop: fast for loop, fast in loops.items() if shorter.verdicts[loop] is StabilityVerdict.UNSTABLE}
        sampled, cost = _by_their_periods(plan, bursts, unstable, factor, interrupt, source)
        steps += cost
        found |= {loop: _unstable(plan, shorter, fast, sampled=loop in sampled) for loop, fast in unstable.items()}
        loops = {loop: fast for loop, fast in loops.items() if shorter.verdicts[loop] is StabilityVerdict.LOCKED}
        if not loops:
            break
    if obstacle == INTERRUPTED:  # then the record is none of a completed run: the same command makes the comparison
        outcome.status = "interrupted"
        outcome.error = "every row is there, but the comparison with shorter steps was interrupted"
    for loop, fast in loops.items():  # nothing has decided
        if not obstacle:
            found[loop] = _switching(plan, bursts, fast)
        elif any(suspect.share > 0.5 and suspect.rhythm > stability.RHYTHM for suspect in fast):
            found[loop] = _unchecked(plan, bursts, fast, obstacle)
    outcome.warnings += [found[loop] for loop in sorted(found)]
    if steps:
        outcome.timing["comparison"] = {"steps": steps, "seconds": time.perf_counter() - began}


class Shorter(Observer):
    """A run with shorter steps, as far as the verdicts on `loops` need it."""

    def __init__(self, plan: Plan, bursts: Bursts, loops: Loops, factor: int, kept: bool = False):
        """plan, bursts: of the run to compare with.  factor: how many steps there are for one.

        kept: periods that components have of their own stay as they are.
        """
        self.plan, self.factor, self._kept = _shorter(plan, factor, kept), factor, kept
        self.coarse, self._loops = bursts, loops
        fast = [suspect for suspects in loops.values() for suspect in suspects]
        self._ends = factor * stability.first_end(bursts, fast), factor * bursts.last
        self._enough = Interrupt()
        self.verdicts: dict[int, StabilityVerdict] = {}
        self.whole = self._exact = False  # whether all of the run was needed, and has been done
        self.steps = 0

    def run(self, interrupt: Interrupt, source: FmuSource | None) -> str:
        """Returns why there are no verdicts, or ""."""
        self._outside = interrupt
        origin = self.plan.origin
        begin = partial(resume, origin) if isinstance(origin, Checkpoint) else initialize
        try:
            with System.open(self.plan, interrupt.is_set, source=source) as system:
                self.fine = Bursts(system, self.coarse, self.factor, self._kept)
                outcome = run_master(system, [self], self._enough, begin, self.fine)
        except FmuError as error:
            return f"an FMU cannot be run again: {error}"
        except KeyboardInterrupt:
            return INTERRUPTED
        self.steps = outcome.ticks - self.plan.first
        if interrupt.is_set():
            return INTERRUPTED
        if not self.verdicts:
            self.whole = True
            self._exact = outcome.ticks >= self._ends[1]
            for loop, fast in self._loops.items():
                if not (changes := self.changes(fast)):
                    return f"that ended too early: {outcome.error or 'an FMU ended it'}"
                self.verdicts[loop] = stability.judge_whole(fast, self.coarse, self.fine, changes)
        return ""

    def limit(self, tick: int, last: int) -> int:
        return min([last, *(end for end in self._ends if end > tick)])

    def progress(self, tick: int) -> None:
        if tick == self._ends[0] < self._ends[1]:
            verdicts = {loop: stability.judge_first(fast, self.coarse, self.fine) for loop, fast in self._loops.items()}
            if StabilityVerdict.OPEN not in verdicts.values():
                self.verdicts = verdicts
        if self.verdicts or tick >= self._ends[1] or self._outside.is_set():
            self._enough.set()

    def changes(self, fast: Sequence[Suspect]) -> dict[int, float]:
        """{output: change of its rms, by what it was}, as far as it is known.  fast: of a loop."""
        return stability.changes_of(fast, self.coarse, self.fine, self.whole, self._exact)


def _shorter(plan: Plan, factor: int, kept: bool) -> Plan:
    """The plan with shorter steps; nothing is recorded or measured."""
    master = replace(plan.experiment.master, step=plan.experiment.master.step / factor)
    components = tuple(
        replace(
            component,
            period=component.period * factor if kept and component.period > 1 else component.period,
            isolated=component.isolated or component.fmu.once_per_process,
        )
        for component in plan.components
    )
    origin = plan.origin
    if isinstance(origin, Checkpoint):
        origin = replace(origin, about={**origin.about, "tick": origin.tick * factor})
    experiment = replace(plan.experiment, master=master, metrics={})
    return replace(plan, experiment=experiment, components=components, recorded=(), watched=(), origin=origin)


def _obstacle(plan: Plan, outcome: Outcome) -> str:
    """Why a run cannot be compared, or ""."""
    if plan.live:
        return "it was steered from outside and cannot be repeated"
    if outcome.status == "interrupted":
        return "it was interrupted"
    if any(plan.first % component.period for component in plan.components):
        return "it began within a step of a component"
    return ""


def _by_their_periods(
    plan: Plan, bursts: Bursts, unstable: Loops, factor: int, interrupt: Interrupt, source: FmuSource | None
) -> tuple[set[int], int]:
    """Those of the loops that are unstable because of periods that components have of their own, and steps to tell."""
    slow = {output.loop for output in bursts.outputs if output.period > 1}
    asked = {loop: fast for loop, fast in unstable.items() if loop in slow}
    if not asked:
        return set(), 0
    shorter = Shorter(plan, bursts, asked, factor, kept=True)
    if shorter.run(interrupt, source):
        return set(), shorter.steps
    return {loop for loop in asked if shorter.verdicts[loop] is not StabilityVerdict.UNSTABLE}, shorter.steps


def _unstable(plan: Plan, shorter: Shorter, fast: Sequence[Suspect], sampled: bool) -> Warned:
    bursts, step = shorter.coarse, plan.experiment.master.step
    output, change = _headline(bursts, fast, shorter.changes(fast))
    by = f"{'' if shorter.whole else 'about '}{abs(change):.0%} {'less' if change < 0 else 'more'}"
    head = (
        f"{_oscillation(plan, bursts, fast, output)}; at {PARTS[shorter.factor]} the rms of "
        f"{bursts.outputs[output].name} is {by}: the feedback loop is unstable"
    )
    if not sampled:
        text = (
            f"{head} at this step, and the numbers of the run are wrong even where they look right; "
            "take a smaller step (orch converge shows which)"
        )
        return Warned(text, Kind.UNSTABLE)
    loop = bursts.outputs[output].loop
    slowest = max((o for o in bursts.outputs if o.loop == loop), key=lambda o: (o.period, o.command))
    period, name = slowest.period, slowest.component
    text = (
        f"{head} because {name} steps every {period * step:g} s, and a smaller master.step would not change that; "
        f"where {name} is not meant to be sampled so slowly, shorten components.{name}.step"
    )
    return Warned(text, Kind.SAMPLING)


def _headline(bursts: Bursts, fast: Sequence[Suspect], changes: Mapping[int, float]) -> tuple[int, float]:
    """The output to name, and its change: of those that change most, one that moves fast, rather a command."""
    shares = {suspect.output: suspect.share for suspect in fast}
    most = max(map(abs, changes.values()))
    candidates = [output for output, change in changes.items() if abs(change) >= 0.8 * most]
    output = max(candidates, key=lambda o: (o in shares, bursts.outputs[o].command, shares.get(o, 0.0)))
    return output, changes[output]


def _switching(plan: Plan, bursts: Bursts, fast: Sequence[Suspect]) -> Warned:
    text = (
        f"{_oscillation(plan, bursts, fast)}, and takes as many steps down to {PARTS[max(PARTS)]}: its frequency is "
        "that of the steps, and what counts changes (total_variation) depends on the step"
    )
    return Warned(text, Kind.SWITCHING)


def _unchecked(plan: Plan, bursts: Bursts, fast: Sequence[Suspect], obstacle: str) -> Warned:
    text = (
        f"{_oscillation(plan, bursts, fast)}. Whether the step causes that is not known: the run could not be compared "
        f"with one at half the step, because {obstacle}"
    )
    return Warned(text, Kind.UNCHECKED)


def _oscillation(plan: Plan, bursts: Bursts, fast: Sequence[Suspect], output: int | None = None) -> str:
    """What oscillates: the vector of the output, or the one with the largest share."""
    head = next((s for s in fast if s.output == output), max(fast, key=lambda s: s.share))
    component, vector = _vector(bursts, head)
    same = [s for s in fast if s.clock == head.clock and _vector(bursts, s) == (component, vector)]
    axes = " ".join(axis for s in same if (axis := split_axis(bursts.outputs[s.output].variable.name)[1]))
    signal = f"{component}.{vector} ({axes})" if axes else f"{component}.{vector}"
    step = bursts.clocks[head.clock].period * plan.experiment.master.step
    rhythmic = head.rhythm > stability.RHYTHM
    how = (
        f"with a period of about {head.steps:.2g} steps of {step:g} s"
        if rhythmic
        else f"at periods of {stability.LONGEST} steps of {step:g} s or less"
    )
    return f"{signal} oscillates {how}, {min(1.0, max(s.share for s in same)):.0%} of its mean square"


def _vector(bursts: Bursts, suspect: Suspect) -> tuple[str, str]:
    output = bursts.outputs[suspect.output]
    return output.component, split_axis(output.variable.name)[0]
