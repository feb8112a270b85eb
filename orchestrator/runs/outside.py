"""What ties a run to the world outside: the clock on the wall, ground stations, what steers."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ..plan.plan import Plan
from ..simulation.observer import Observer

LATE = 0.1  # s; a run that was further behind says so


@dataclass(frozen=True)
class Ties:
    """The plan as the observers need it, the observers, and {component: what a builtin needs}."""

    plan: Plan
    observers: Sequence[Observer]
    context: Mapping[str, Mapping[str, Any]]


@dataclass
class Outside:
    """endpoints: of MAVLink; key: a file; realtime: simulated seconds in a second."""

    endpoints: Sequence[str] = ()
    key: str | None = None
    realtime: float | None = None
    notes: list[str] = field(default_factory=list)  # for the user

    @contextlib.contextmanager
    def tied(self, plan: Plan) -> Iterator[Ties]:
        """Raises OrchError where something cannot begin."""
        observers: list[Observer] = []
        context: dict[str, dict[str, Any]] = {}
        with contextlib.ExitStack() as opened:
            pacer = None
            if self.realtime is not None:
                from .pacer import Pacer

                pacer = Pacer(plan, self.realtime)
                observers.append(pacer)  # first: the bridge shows what is so now, not what will be
            if plan.live:
                from ..mavlink import steered

                context = steered.context_of(plan)
                if not self.endpoints:
                    self.notes += steered.unheard(plan)
            if self.endpoints:
                from ..mavlink import steered
                from ..mavlink.bridge import Bridge, at_once
                from ..mavlink.protocol.links import Endpoint
                from ..mavlink.protocol.wire import read_key

                key = read_key(self.key) if self.key is not None else None
                endpoints = [Endpoint.parse(text) for text in self.endpoints]
                due = pacer.due if pacer else at_once
                bridge = Bridge(plan, endpoints, key, steered.controls_of(plan, context), due)
                opened.callback(bridge.close)
                self.notes += steered.speaking_themselves(plan)
                plan = bridge.watched(plan)
                observers.append(bridge)
            yield Ties(plan, observers, context)
            if pacer and pacer.latest > LATE:
                behind = f"{pacer.latest:.3g} s behind its pace, {pacer.late:.3g} s at the end"
                self.notes.append(f"the run was up to {behind}")
