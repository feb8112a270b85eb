"""The bridge: an observer that samples the vehicles between chunks of the run, and a thread that talks to stations.

The run hands over the latest sample of each vehicle and goes on; it never waits.  The thread sends by the wall clock: a
heartbeat every second whatever the simulation does, and telemetry of the latest sample.
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
from .fleet import fleet
from .protocol import telemetry
from .protocol.conversation import Conversation
from .protocol.dialect import Message, mavlink
from .protocol.links import Endpoint, Link, Peer, open_link
from .protocol.station import HEARTBEAT_EVERY, Station
from .vehicle.autopilot import Autopilot
from .vehicle.control import Control
from .view import VehicleView

# What the handling of a message with absurd contents may raise.
NONSENSE = (ValueError, TypeError, ArithmeticError, LookupError, AttributeError, struct.error)
INFO: int = mavlink.MAV_SEVERITY_INFO
SHORTEST_NAP, LONGEST_NAP = 1e-3, 0.05  # s
SWITCH = 1e-3  # s that one thread may keep the other from Python; more disturbs the pace of the run
TURN = 0.02  # s that the messages of one link may take before the other links and the heartbeat get their turn
JOIN = 2.0  # s to wait for the end of the thread


def at_once(tick: int) -> float:
    """When it is time for a tick of a run without pace."""
    return 0.0


class Bridge(Observer):
    """Shows the vehicles of a plan at endpoints.

    key: signs every frame.  controls: {component of a vehicle: where its steering goes}.  due: when it is time for a
    tick (monotonic) [s].  Raises OrchError if an endpoint cannot be opened or a vehicle cannot be shown.
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
        self.autopilots = fleet(plan, controls or {}, [e for e in endpoints if e.system is not None])
        self._view = VehicleView(plan, self.autopilots, due)
        self._stations: dict[Peer, Station] = {}
        self._conversation = Conversation(self.announce, self._echo)
        self._count = 0  # of stations so far
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
        """The plan whose system has a place for every value that is shown."""
        return self._view.watched(plan)

    def opened(self, view: SystemView) -> None:
        self._view.opened(view)
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
        """End the thread and close the endpoints."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(timeout=JOIN)
            sys.setswitchinterval(self._interval)
        self._close_links()

    def announce(self, autopilot: Autopilot, text: str, severity: int = INFO) -> None:
        """Send a STATUSTEXT to all stations that see the vehicle."""
        self._echo(autopilot, telemetry.statustext(text, severity))

    def _echo(self, autopilot: Autopilot, message: Message) -> None:
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
            if time.monotonic() > deadline:  # a flood: the rest waits; what exceeds the system's buffer is lost
                break

    def _answer(self, station: Station, message: Message, now: float) -> None:
        for channel in station.channels.values():
            try:
                self._conversation.handle(channel, message, now)
            except NONSENSE as error:
                # No message of one station may end the conversation with the others.
                self.counts[f"not understood: {message.get_type()} ({type(error).__name__})"] += 1

    def _station(self, peer: Peer, now: float) -> Station:
        station = self._stations.get(peer)
        if station is None:
            self._count += 1
            only = peer.link.endpoint.system
            autopilots = [a for a in self.autopilots if only in (None, a.system)]
            station = Station(peer, autopilots, self._key, self._count, now, self.counts)
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
                if channel.has_changed():  # mode or arming: stations learn of it at once
                    channel.send(telemetry.heartbeat(channel.autopilot))
                elif channel.heartbeat_due <= now:
                    channel.send(telemetry.heartbeat(channel.autopilot))
                    late = now - channel.heartbeat_due >= HEARTBEAT_EVERY
                    channel.heartbeat_due = (now if late else channel.heartbeat_due) + HEARTBEAT_EVERY
                channel.turn(now, wall)

    def _wait(self) -> None:
        """Wait until something comes or is due."""
        due = min((c.due() for s in self._stations.values() for c in s.channels.values()), default=float("inf"))
        nap = min(LONGEST_NAP, max(SHORTEST_NAP, due - time.monotonic()))
        files = [file for link in self._links for file in link.files()]
        with contextlib.suppress(OSError, ValueError):  # one of them has just been closed
            select.select(files, [], [], nap)
            return
        time.sleep(nap)

    def _close_links(self) -> None:
        for link in self._links:
            link.close()
