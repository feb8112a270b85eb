"""Commands (COMMAND_LONG, COMMAND_INT): every one gets its COMMAND_ACK."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from ..vehicle.autopilot import MODE_NAMES, MODES, Autopilot
from ..vehicle.control import SetPoint
from ..vehicle.sample import to_ned
from . import telemetry
from .dialect import message
from .station import FASTEST, NAMES, SLOWEST, Channel

ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4  # MAV_RESULT
CUSTOM_MODE = 1  # MAV_MODE_FLAG
RELATIVE_FRAMES = (3, 6, 10, 11)  # MAV_FRAME: altitude above home, or terrain


@dataclass(frozen=True)
class Command:
    """parameters: seven, of which 5 and 6 are degrees where they are a place; now: monotonic [s]."""

    parameters: Sequence[float]
    now: float
    wall: float
    tell: Callable[[Autopilot, str], None]  # a STATUSTEXT to all stations

    def whole(self, n: int) -> int | None:
        """Parameter n (from 1) as an integer; None where it is none."""
        value = self.parameters[n - 1]
        return round(value) if math.isfinite(value) and abs(value) < 1 << 31 else None


Answer = tuple[int, Sequence[Any]]  # MAV_RESULT, and the messages that follow the COMMAND_ACK


def carry_out(number: int, command: Command, channel: Channel) -> Answer:
    handler = COMMANDS.get(number)
    return handler(command, channel) if handler else (UNSUPPORTED, [])


def request_message(command: Command, channel: Channel) -> Answer:
    name = NAMES.get(command.whole(1))  # type: ignore[arg-type]  # None is no id of any
    at = channel.autopilot.latest
    if name is None or at is None:
        return FAILED, []
    return ACCEPTED, telemetry.STREAMED[name][1](channel.autopilot, at, command.wall)


def request_capabilities(command: Command, channel: Channel) -> Answer:
    at = channel.autopilot.latest
    return (FAILED, []) if at is None else (ACCEPTED, telemetry.autopilot_version(channel.autopilot, at, command.wall))


def set_interval(command: Command, channel: Channel) -> Answer:
    name, microseconds = NAMES.get(command.whole(1)), command.parameters[1]  # type: ignore[arg-type]
    if name is None or not math.isfinite(microseconds) or (microseconds < 0 and microseconds != -1):
        return FAILED, []
    if name == "HEARTBEAT":  # always once a second: stations would lose the vehicle
        return ACCEPTED, []
    if microseconds == 0:
        channel.reset(name, command.now)
    elif microseconds == -1:
        channel.every(name, None, command.now)
    else:
        channel.every(name, min(max(microseconds * 1e-6, FASTEST), SLOWEST), command.now)
    return ACCEPTED, []


def get_interval(command: Command, channel: Channel) -> Answer:
    number = command.whole(1)
    if number is None or not 0 <= number < 1 << 16:
        return FAILED, []
    if number not in NAMES:
        return FAILED, [message("MESSAGE_INTERVAL", number, 0)]
    interval = 1.0 if NAMES[number] == "HEARTBEAT" else channel.interval(NAMES[number])
    return ACCEPTED, [message("MESSAGE_INTERVAL", number, -1 if interval is None else round(interval * 1e6))]


def arm(command: Command, channel: Channel) -> Answer:
    """What drives the vehicle is a component of the experiment; only one that takes steering can be disarmed."""
    autopilot, wanted = channel.autopilot, command.whole(1)
    if wanted not in (0, 1):
        return FAILED, []
    if not wanted and autopilot.control is None:
        command.tell(autopilot, "Disarm: the experiment drives this vehicle")
        return FAILED, []
    if autopilot.armed != bool(wanted):
        autopilot.armed = bool(wanted)
        command.tell(autopilot, "Arming motors" if wanted else "Disarming motors")
    if autopilot.control:
        autopilot.control.armed = autopilot.armed
    return ACCEPTED, []


def set_mode(command: Command, channel: Channel) -> Answer:
    flags, mode = command.whole(1), command.whole(2)
    if flags is None or not flags & CUSTOM_MODE or mode is None:
        return FAILED, []
    return (ACCEPTED if change_mode(channel.autopilot, mode, command.tell) else FAILED), []


def change_mode(autopilot: Autopilot, mode: int, tell: Callable[[Autopilot, str], None]) -> bool:
    """False where there is no such mode."""
    if mode not in MODE_NAMES:
        return False
    if mode != autopilot.mode:
        autopilot.mode = mode
        tell(autopilot, f"Mode {MODE_NAMES[mode]}")
    if autopilot.control:
        autopilot.control.set_point = None
        autopilot.control.guided = mode == MODES["GUIDED"]
    return True


def get_home(command: Command, channel: Channel) -> Answer:
    at = channel.autopilot.latest
    return (FAILED, []) if at is None else (ACCEPTED, telemetry.home_position(channel.autopilot, at, command.wall))


def cannot(command: Command, channel: Channel) -> Answer:
    """A command that ArduSub knows, and that a simulated vehicle cannot follow: home is the experiment's origin."""
    return FAILED, []


def reposition(command: Command, channel: Channel) -> Answer:
    """DO_REPOSITION: there, and in mode GUIDED from then on."""
    autopilot = channel.autopilot
    latitude, longitude, altitude = command.parameters[4:7]
    if autopilot.control is None or not all(map(math.isfinite, (latitude, longitude))):
        return FAILED, []
    if abs(latitude) > 90 or abs(longitude) > 180:
        return DENIED, []
    change_mode(autopilot, MODES["GUIDED"], command.tell)
    yaw = command.parameters[3]
    position = (*to_ned(autopilot.origin, latitude, longitude), -altitude if math.isfinite(altitude) else None)
    autopilot.control.set_point = SetPoint(position, yaw=yaw if math.isfinite(yaw) else None, at=command.now)
    return ACCEPTED, []


COMMANDS: dict[int, Callable[[Command, Channel], Answer]] = {
    512: request_message,
    520: request_capabilities,
    511: set_interval,
    510: get_interval,
    400: arm,
    176: set_mode,
    410: get_home,
    179: cannot,
    192: reposition,
    246: cannot,
    22: cannot,
    21: cannot,
    300: cannot,
}
