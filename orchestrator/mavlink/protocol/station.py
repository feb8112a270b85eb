"""A ground station as the bridge sees it: what it is sent, how often, and what it is still waiting for."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Any

from ..vehicle.autopilot import Autopilot
from .dialect import id_of
from .ftp import Files
from .links import Peer
from .telemetry import STREAM_IDS, STREAMED
from .wire import Decoder, Encoder

NAMES = {id_of(name): name for name in STREAMED}
HOME_EVERY = 1.0  # s; QGroundControl asks for its streams again where neither home nor battery comes
FASTEST, SLOWEST = 1e-3, 60.0  # s, of an interval that is asked for
RATES = 1, 50  # Hz, of a stream that is asked for
PACE = 5e-3  # s, between two handfuls of a long answer
HANDFUL = 5  # messages
UNSENDABLE = (ValueError, OverflowError, struct.error)


class Channel:
    """One vehicle, for one station: frames in sequence, intervals of messages, answers under way."""

    def __init__(self, autopilot: Autopilot, peer: Peer, encoder: Encoder, now: float, counts: Counter[str]):
        self.autopilot, self.peer, self._encoder, self._counts = autopilot, peer, encoder, counts
        self.files = Files(autopilot.parameters)
        self.heartbeat_due = now
        self._due: dict[str, list[float]] = {}  # {message: [interval, when next]} [s]
        self._jobs: dict[str, Iterator[Any]] = {}
        self._pace_due = now
        self._state = (autopilot.mode, autopilot.armed)
        for name in STREAMED:
            self.reset(name, now)

    def send(self, *messages: Any) -> None:
        for message in messages:
            self.peer.send(self._encoder.frame(message))

    def has_changed(self) -> bool:
        """Whether mode or arming is not what the last call saw."""
        before, self._state = self._state, (self.autopilot.mode, self.autopilot.armed)
        return before != self._state

    def default_interval(self, name: str) -> float | None:
        """s; None: not sent unless asked for."""
        stream = STREAMED[name][0]
        if stream is None:
            return HOME_EVERY if name == "HOME_POSITION" else None
        rate = self.autopilot.parameters[f"SR0_{stream}"]
        return 1 / min(rate, RATES[1]) if rate > 0 else None

    def interval(self, name: str) -> float | None:
        """s; None: not sent."""
        entry = self._due.get(name)
        return entry[0] if entry else None

    def reset(self, name: str, now: float) -> None:
        self.every(name, self.default_interval(name), now)

    def every(self, name: str, interval: float | None, now: float) -> None:
        if interval is None:
            self._due.pop(name, None)
        elif self.interval(name) != interval:  # one that is asked for again keeps its beat
            self._due[name] = [interval, now + interval]

    def set_stream(self, number: int, rate: float | None, now: float) -> None:
        """A stream by its number, 0: all; rate in Hz, None: stop."""
        streams = set(STREAM_IDS.values()) if number == 0 else {STREAM_IDS.get(number)} - {None}
        for name, (stream, _) in STREAMED.items():
            if stream in streams:
                self.every(name, None if rate is None else 1 / min(max(rate, RATES[0]), RATES[1]), now)

    def job(self, name: str, messages: Iterable[Any]) -> None:
        """A long answer, sent a handful at a time; one of that name that is under way begins anew."""
        self._jobs[name] = iter(messages)

    def busy(self, name: str) -> bool:
        return name in self._jobs

    def turn(self, now: float, wall: float) -> None:
        """Send what is due."""
        at = self.autopilot.latest
        if at is not None:
            for name, entry in self._due.items():
                if entry[1] <= now:
                    try:
                        self.send(*STREAMED[name][1](self.autopilot, at, wall))
                    except UNSENDABLE:  # a vehicle that is off to infinity
                        self._counts[f"not sent: {name}"] += 1
                    # What is late is not made up for.
                    entry[1] = entry[1] + entry[0] if now - entry[1] < entry[0] else now + entry[0]
        if self._jobs and now >= self._pace_due:
            self._pace_due = now + PACE
            for name, messages in list(self._jobs.items()):
                for _ in range(HANDFUL):
                    message = next(messages, None)
                    if message is None:
                        self._jobs.pop(name, None)
                        break
                    self.send(message)

    def due(self) -> float:
        """When something has to be sent next."""
        times = [entry[1] for entry in self._due.values()]
        return min([*times, self.heartbeat_due, *([self._pace_due] if self._jobs else [])])


class Station:
    """A partner, with a channel for each vehicle of its link."""

    def __init__(
        self,
        peer: Peer,
        autopilots: Iterable[Autopilot],
        key: bytes | None,
        number: int,
        now: float,
        counts: Counter[str],
    ):
        self.peer = peer
        self.decoder = Decoder(counts, key)
        self.channels = {a.system: Channel(a, peer, Encoder(a.system, key, number), now, counts) for a in autopilots}

    def messages(self, data: bytes) -> Iterator[Any]:
        for message in self.decoder.messages(data, self.peer.link.whole):
            self.peer.valid = True
            yield message
