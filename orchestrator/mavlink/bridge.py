"""The bridge: an observer that looks at the vehicles between chunks of the run, and a thread that talks to stations.

The run hands over the latest sample of each vehicle and goes on; it never waits.  The thread sends at its own times by
the clock on the wall: a heartbeat a second whatever the simulation does, telemetry of the latest sample.
"""

from __future__ import annotations

import contextlib
import select
import struct
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ..plan.plan import Plan
from ..simulation.observer import Observer, SystemView
from .protocol import telemetry
from .protocol.conversation import Conversation
from .protocol.links import Endpoint, Link, Peer, open_link
from .protocol.station import Station
from .vehicle.autopilot import Autopilot
from .vehicle.control import Control
from .view import View, fleet

HEARTBEAT = 1.0  # s
# What a message with absurd contents may raise on its way.
NONSENSE = (ValueError, TypeError, ArithmeticError, LookupError, AttributeError, struct.error)
NAP = 0.05  # s, at most
SHORTEST_NAP = 1e-3  # s
SWITCH = 1e-3  # s that one thread may keep the other from Python: the run's pace suffers from more
TURN = 0.02  # s, at most, of one link's messages in a turn: the others and the heartbeat have theirs, too


def at_once(tick: int) -> float:
    """Of a run that keeps no pace."""
    return 0.0


class Bridge(Observer):
    """Shows the vehicles of a plan at endpoints.

    controls: {component of a vehicle: where its steering goes}; due: when it is time for a tick (monotonic) [s].
    Raises OrchError where an endpoint cannot be opened or a vehicle cannot be shown.
    """

    def __init__(
        self,
        plan: Plan,
        endpoints: Sequence[Endpoint],
        key: bytes | None = None,
        controls: Mapping[str, Control] | None = None,
        due: Callable[[int], float] = at_once,
    ):
        self.counts: Counter[str] = Counter()
        self._key = key
        self.autopilots: list[Autopilot] = fleet(plan, controls or {}, [e for e in endpoints if e.system is not None])
        self._view = View(plan, self.autopilots, due)
        self._stations: dict[Peer, Station] = {}
        self._conversation = Conversation(self.tell, self._echo)
        self._numbers = 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="mavlink", daemon=True)
        self._links: list[Link] = []
        try:
            for endpoint in endpoints:
                self._links.append(open_link(endpoint, self.counts))
        except BaseException:
            self._close_links()
            raise

    def watched(self, plan: Plan) -> Plan:
        return self._view.watched(plan)

    def opened(self, view: SystemView) -> None:
        self._view.opened(view)
        self.progress(0)
        self._interval = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH)
        self._thread.start()

    def limit(self, tick: int, last: int) -> int:
        return self._view.limit(tick, last)

    def progress(self, tick: int) -> None:
        self._view.look(tick)

    def facts(self) -> dict[str, Any]:
        return {"mavlink": dict(sorted(self.counts.items()))}

    def close(self) -> None:
        """Stop talking."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(timeout=2.0)
            sys.setswitchinterval(self._interval)
        self._close_links()

    def tell(self, autopilot: Autopilot, text: str) -> None:
        """A STATUSTEXT to all stations that see the vehicle."""
        self._echo(autopilot, telemetry.statustext(text))

    def _echo(self, autopilot: Autopilot, message: Any) -> None:
        for station in self._stations.values():
            if channel := station.channels.get(autopilot.system):
                channel.send(message)

    def _serve(self) -> None:
        while not self._stop.is_set():
            now = time.monotonic()
            for link in self._links:
                self._listen(link, now)
            self._send(now)
            self._wait()

    def _listen(self, link: Link, now: float) -> None:
        deadline = now + TURN
        for peer, data in link.receive(now):
            self.counts["bytes received"] += len(data)
            station = self._station(peer, now)
            for message in station.messages(data):
                self.counts["messages received"] += 1
                self._answer(station, message, now)
            if time.monotonic() > deadline:  # a flood: the rest waits, and what the system cannot keep is lost
                break

    def _answer(self, station: Station, message: Any, now: float) -> None:
        for channel in station.channels.values():
            try:
                self._conversation.handle(channel, message, now)
            except NONSENSE as error:
                # What a station sends must not end the conversation with the others.
                self.counts[f"not understood: {message.get_type()} ({type(error).__name__})"] += 1

    def _station(self, peer: Peer, now: float) -> Station:
        station = self._stations.get(peer)
        if station is None:
            self._numbers += 1
            only = peer.link.endpoint.system
            autopilots = [a for a in self.autopilots if only in (None, a.system)]
            station = Station(peer, autopilots, self._key, self._numbers, now, self.counts)
            self._stations[peer] = station
        return station

    def _send(self, now: float) -> None:
        for peer in [peer for peer in self._stations if peer.gone]:
            del self._stations[peer]
        for link in self._links:
            for peer in list(link.peers):
                self._station(peer, now)
        wall = time.time()
        for station in list(self._stations.values()):
            for channel in station.channels.values():
                if channel.has_changed():  # of mode, or armed: at once
                    channel.send(telemetry.heartbeat(channel.autopilot))
                elif channel.heartbeat_due <= now:
                    channel.send(telemetry.heartbeat(channel.autopilot))
                    late = now - channel.heartbeat_due
                    channel.heartbeat_due = channel.heartbeat_due + HEARTBEAT if late < HEARTBEAT else now + HEARTBEAT
                channel.turn(now, wall)

    def _wait(self) -> None:
        """Until something comes or is due."""
        due = min((c.due() for s in self._stations.values() for c in s.channels.values()), default=float("inf"))
        nap = min(NAP, max(SHORTEST_NAP, due - time.monotonic()))
        files = [file for link in self._links for file in link.files()]
        with contextlib.suppress(OSError, ValueError):  # one of them was closed meanwhile
            select.select(files, [], [], nap)
            return
        time.sleep(nap)

    def _close_links(self) -> None:
        for link in self._links:
            link.close()
