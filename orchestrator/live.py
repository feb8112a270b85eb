"""What ties a run to the world outside: the clock on the wall, ground stations, a telemetry log of it."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from .master import Observer
from .plan import Plan

LATE = 0.1  # s; a run that was further behind says so


@dataclass
class Live:
    """endpoints: of MAVLink; key: a file; realtime: simulated seconds in a second; tlog: a file to write."""

    endpoints: Sequence[str] = ()
    key: str | None = None
    realtime: float | None = None
    tlog: str | None = None

    @contextlib.contextmanager
    def observing(self, plan: Plan) -> Iterator[tuple[Plan, list[Observer]]]:
        """The plan as the observers need it, and the observers.  Raises OrchError where one cannot begin."""
        observers: list[Observer] = []
        self._notes: list[str] = []
        with contextlib.ExitStack() as opened:
            if self.tlog is not None:
                from .mavlink.settings import settings_of

                settings_of(plan)  # now rather than after the run
            if self.endpoints:
                from .mavlink.bridge import Bridge
                from .mavlink.links import Endpoint
                from .mavlink.wire import read_key

                key = read_key(self.key) if self.key is not None else None
                bridge = Bridge(plan, [Endpoint.parse(text) for text in self.endpoints], key)
                opened.callback(bridge.close)
                plan = bridge.watched(plan)
                observers.append(bridge)
            if self.realtime is not None:
                from .pacer import Pacer

                pacer = Pacer(plan, self.realtime)
                observers.insert(0, pacer)  # the bridge shows what is so now, not what will be
            yield plan, observers
            if self.realtime is not None and pacer.latest > LATE:
                words = f"the run was up to {pacer.latest:.3g} s behind its pace, {pacer.late:.3g} s at the end"
                self._notes.append(f"note: {words}")

    def after(self, file: Path) -> list[str]:
        """Write what is made of the record; returns what there is to say.  Raises OrchError."""
        if self.tlog is not None:
            from .export import export
            from .store import Run

            with Run(file) as record:
                export(record, "tlog", Path(self.tlog))
        return self._notes
