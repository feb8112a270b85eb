"""Telemetry logs: the frames that would have been sent, each after its Unix time in microseconds, big-endian.

https://ardupilot.org/planner/docs/mission-planner-telemetry-logs.html; read by QGroundControl, MAVProxy, MAVExplorer.
"""

from __future__ import annotations

import heapq
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, BinaryIO

from .protocol import telemetry
from .protocol.conversation import parameter_value
from .protocol.dialect import Message
from .protocol.station import HEARTBEAT_EVERY, HOME_EVERY
from .protocol.wire import Encoder
from .vehicle.autopilot import Autopilot
from .vehicle.modes import FlightMode
from .vehicle.sample import Sample

if TYPE_CHECKING:
    from ..arrays import Reals

EPOCH = 1_577_836_800  # s; every log begins on 1 January 2020, so that the same record gives the same bytes
TOLERANCE = 1e-9  # s, when a time of the record is compared with one of a message


@dataclass(frozen=True, kw_only=True)
class LoggedVehicle:
    """A vehicle over a run.

    times: (N,) of its samples [s].  sample: the sample of a row.  states: N modes, and whether it was armed; (): as the
    autopilot has it all the time.
    """

    autopilot: Autopilot
    times: Reals
    sample: Callable[[int], Sample]
    states: Sequence[tuple[FlightMode, bool]] = ()

    def go_to(self, row: int) -> None:
        """Bring the autopilot to the state of a row."""
        if self.states:
            self.autopilot.mode, self.autopilot.armed = self.states[row]


def write(vehicles: Sequence[LoggedVehicle], file: BinaryIO) -> None:
    """Write every message at its default rate, but none twice from the same sample."""
    encoders = [Encoder(vehicle.autopilot.system) for vehicle in vehicles]

    def put(t: float, number: int, message: Message) -> None:
        file.write(struct.pack(">Q", round((EPOCH + t) * 1e6)) + encoders[number].frame(message))

    for number, vehicle in enumerate(vehicles):
        vehicle.go_to(0)
        put(0.0, number, telemetry.heartbeat(vehicle.autopilot))
        for message in telemetry.banner():
            put(0.0, number, message)
        for parameter in vehicle.autopilot.parameters.all:
            put(0.0, number, parameter_value(vehicle.autopilot, parameter))
    sent: dict[tuple[int, str], int] = {}  # row of the sample that a message was last made from
    rows = [0] * len(vehicles)
    for t, number, name in heapq.merge(*(_beats(n, vehicle) for n, vehicle in enumerate(vehicles))):
        vehicle = vehicles[number]
        while rows[number] + 1 < len(vehicle.times) and vehicle.times[rows[number] + 1] <= t + TOLERANCE:
            rows[number] += 1
        vehicle.go_to(rows[number])
        if name == "HEARTBEAT":
            put(t, number, telemetry.heartbeat(vehicle.autopilot))
        elif sent.get((number, name)) != rows[number]:
            sent[number, name] = rows[number]
            at = vehicle.sample(rows[number])
            for message in telemetry.STREAMED[name][1](vehicle.autopilot, at, EPOCH + at.t):
                put(t, number, message)


def _beats(number: int, vehicle: LoggedVehicle) -> Iterator[tuple[float, int, str]]:
    """When which message is due, in order: time [s], number of the vehicle, name of the message."""
    rates = {"HEARTBEAT": 1 / HEARTBEAT_EVERY, "HOME_POSITION": 1 / HOME_EVERY}
    for name, (stream, _) in telemetry.STREAMED.items():
        if stream is not None:
            rates[name] = vehicle.autopilot.parameters[f"SR0_{stream}"]
    end = float(vehicle.times[-1])

    def every(name: str, rate: float) -> Iterator[tuple[float, int, str]]:
        beat = 0
        while rate > 0 and (t := beat / rate) <= end:
            if beat or name != "HEARTBEAT":  # the first one is at the beginning of the log
                yield t, number, name
            beat += 1

    yield from heapq.merge(*(every(name, rate) for name, rate in rates.items()))
