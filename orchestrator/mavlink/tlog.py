"""Telemetry logs: frames as they would have been sent, each after its Unix time in microseconds, big-endian.

https://ardupilot.org/planner/docs/mission-planner-telemetry-logs.html; read by QGroundControl, MAVProxy, MAVExplorer.
"""

from __future__ import annotations

import heapq
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, BinaryIO

from .protocol import telemetry
from .protocol.conversation import parameter_value
from .protocol.station import HOME_EVERY
from .protocol.wire import Encoder
from .vehicle.autopilot import Autopilot
from .vehicle.sample import Sample

EPOCH = 1_577_836_800  # s; a log begins on 1 January 2020, whenever the run was made: same run, same bytes
HEARTBEAT = 1.0  # Hz


@dataclass(frozen=True)
class Track:
    """A vehicle over a run: times (N,) [s] of its samples, and a function from row to sample."""

    autopilot: Autopilot
    times: Any
    sample: Callable[[int], Sample]


def write(tracks: Sequence[Track], file: BinaryIO) -> None:
    """Every message at its default rate; a sample is sent once."""
    encoders = [Encoder(track.autopilot.system) for track in tracks]

    def put(t: float, track: int, message: object) -> None:
        file.write(struct.pack(">Q", round((EPOCH + t) * 1e6)) + encoders[track].frame(message))

    for number, track in enumerate(tracks):
        put(0.0, number, telemetry.heartbeat(track.autopilot))
        for message in telemetry.banner():
            put(0.0, number, message)
        for parameter in track.autopilot.parameters.all:
            put(0.0, number, parameter_value(track.autopilot, parameter))
    sent: dict[tuple[int, str], int] = {}
    rows = [0] * len(tracks)
    for t, number, name in heapq.merge(*(_beats(n, track) for n, track in enumerate(tracks))):
        track = tracks[number]
        while rows[number] + 1 < len(track.times) and track.times[rows[number] + 1] <= t + 1e-9:
            rows[number] += 1
        if name == "HEARTBEAT":
            put(t, number, telemetry.heartbeat(track.autopilot))
        elif sent.get((number, name)) != rows[number]:
            sent[number, name] = rows[number]
            at = track.sample(rows[number])
            for message in telemetry.STREAMED[name][1](track.autopilot, at, EPOCH + at.t):
                put(t, number, message)


def _beats(number: int, track: Track) -> Iterator[tuple[float, int, str]]:
    """When which message is due, in order."""
    rates = {"HEARTBEAT": HEARTBEAT, "HOME_POSITION": 1 / HOME_EVERY}
    for name, (stream, _) in telemetry.STREAMED.items():
        if stream is not None:
            rates[name] = track.autopilot.parameters[f"SR0_{stream}"]
    end = float(track.times[-1])

    def every(name: str, rate: float) -> Iterator[tuple[float, int, str]]:
        beat = 0
        while rate > 0 and (t := beat / rate) <= end:
            if beat or name != "HEARTBEAT":  # the first one is there already
                yield t, number, name
            beat += 1

    yield from heapq.merge(*(every(name, rate) for name, rate in rates.items()))
