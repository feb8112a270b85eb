"""A ground station: what it is sent, how often, and which long answers are under way."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from ..vehicle.autopilot import Autopilot
from .dialect import Message, mavlink
from .ftp import ParameterFile
from .links import Peer
from .telemetry import STREAM_NAMES, STREAMED
from .wire import Decoder, Encoder

HEARTBEAT_EVERY = 1.0  # s
HOME_EVERY = 1.0  # s; QGroundControl asks for its streams again if neither home nor battery comes
FASTEST, SLOWEST = 1e-3, 60.0  # s, the limits of a requested interval
LOWEST_RATE, HIGHEST_RATE = 1, 50  # Hz, the limits of a requested stream
PACE = 5e-3  # s, between two parts of a long answer
PART = 5  # messages
UNSENDABLE = (ValueError, OverflowError, struct.error)


@dataclass
class Beat:
    """A message that is sent again and again.  interval: s.  due: when it is sent next (monotonic) [s]."""

    interval: float
    due: float


class VehicleChannel:
    """One vehicle, for one station: frames in sequence, intervals of messages, long answers."""

    def __init__(self, autopilot: Autopilot, peer: Peer, encoder: Encoder, now: float, counts: Counter[str]):
        self.autopilot, self.peer, self._encoder, self._counts = autopilot, peer, encoder, counts
        self.file = ParameterFile(autopilot.parameters)
        self.heartbeat_due = now
        self._beats: dict[str, Beat] = {}  # by message
        self._answers: dict[str, Iterator[Message]] = {}  # long ones, by what they answer
        self._pace_due = now
        self._state = (autopilot.mode, autopilot.armed)
        for name in STREAMED:
            self.reset(name, now)

    def send(self, *messages: Message) -> None:
        for message in messages:
            self.peer.send(self._encoder.frame(message))

    def has_changed(self) -> bool:
        """Whether mode or arming have changed since the last call."""
        before, self._state = self._state, (self.autopilot.mode, self.autopilot.armed)
        return before != self._state

    def default_interval(self, name: str) -> float | None:
        """Default interval of a message [s]; None: sent only on request."""
        stream = STREAMED[name][0]
        if stream is None:
            return HOME_EVERY if name == "HOME_POSITION" else None
        rate = self.autopilot.parameters[f"SR0_{stream}"]
        return 1 / min(rate, HIGHEST_RATE) if rate > 0 else None

    def interval(self, name: str) -> float | None:
        """Interval of a message [s]; None: not sent."""
        beat = self._beats.get(name)
        return beat.interval if beat else None

    def reset(self, name: str, now: float) -> None:
        """Send a message at its default interval."""
        self.every(name, self.default_interval(name), now)

    def every(self, name: str, interval: float | None, now: float) -> None:
        """Send a message at an interval [s]; None: no longer."""
        if interval is None:
            self._beats.pop(name, None)
        elif self.interval(name) != interval:  # if the same interval is requested again, the beat goes on
            self._beats[name] = Beat(interval, now + interval)

    def set_stream(self, number: int, rate: float | None, now: float) -> None:
        """Send a stream at a rate [Hz]; None: no longer.  number: its MAV_DATA_STREAM."""
        every_stream = number == mavlink.MAV_DATA_STREAM_ALL
        streams = set(STREAM_NAMES.values()) if every_stream else {STREAM_NAMES.get(number)} - {None}
        for name, (stream, _) in STREAMED.items():
            if stream in streams:
                interval = None if rate is None else 1 / min(max(rate, LOWEST_RATE), HIGHEST_RATE)
                self.every(name, interval, now)

    def answer_slowly(self, what: str, messages: Iterable[Message]) -> None:
        """Send a long answer part by part, in place of one to the same request that is under way."""
        self._answers[what] = iter(messages)

    def is_answering(self, what: str) -> bool:
        return what in self._answers

    def turn(self, now: float, wall: float) -> None:
        """Send what is due.  now: monotonic [s]; wall: Unix time [s]."""
        at = self.autopilot.latest
        if at is not None:
            for name, beat in self._beats.items():
                if beat.due <= now:
                    try:
                        self.send(*STREAMED[name][1](self.autopilot, at, wall))
                    except UNSENDABLE:  # values that no field can hold, of a vehicle that is off to infinity
                        self._counts[f"not sent: {name}"] += 1
                    # Beats that were missed are left out.
                    beat.due = beat.due + beat.interval if now - beat.due < beat.interval else now + beat.interval
        if self._answers and now >= self._pace_due:
            self._pace_due = now + PACE
            for what, messages in list(self._answers.items()):
                for _ in range(PART):
                    message = next(messages, None)
                    if message is None:
                        self._answers.pop(what, None)
                        break
                    self.send(message)

    def due(self) -> float:
        """When something has to be sent next (monotonic) [s]."""
        times = [beat.due for beat in self._beats.values()]
        return min([*times, self.heartbeat_due, *([self._pace_due] if self._answers else [])])


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
        """number: of the station, in signatures."""
        self.peer = peer
        self.decoder = Decoder(counts, key)
        self.channels = {
            autopilot.system: VehicleChannel(autopilot, peer, Encoder(autopilot.system, key, number), now, counts)
            for autopilot in autopilots
        }

    def messages(self, data: bytes) -> Iterator[Message]:
        """Messages in bytes that came from the station."""
        for message in self.decoder.messages(data, self.peer.link.whole):
            self.peer.valid = True
            yield message
