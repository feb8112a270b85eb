"""Commands (COMMAND_LONG, COMMAND_INT): each is answered by a COMMAND_ACK."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ..vehicle.autopilot import Autopilot, FlightMode
from ..vehicle.control import SetPoint
from ..vehicle.sample import to_ned
from . import telemetry
from .dialect import Message, mavlink
from .station import FASTEST, HEARTBEAT_EVERY, SLOWEST, VehicleChannel

ACCEPTED, DENIED = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_DENIED
FAILED, UNSUPPORTED = mavlink.MAV_RESULT_FAILED, mavlink.MAV_RESULT_UNSUPPORTED
DEFAULT, DISABLED = 0, -1  # us, in SET_MESSAGE_INTERVAL
UNAVAILABLE = 0  # us, in MESSAGE_INTERVAL; DISABLED likewise

Announce = Callable[[Autopilot, str], None]  # sends a STATUSTEXT to all stations
Answer = tuple[int, Sequence[Message]]  # MAV_RESULT, and the messages that follow the COMMAND_ACK


@dataclass(frozen=True, kw_only=True)
class Command:
    """parameters: seven, 5 and 6 in degrees if they are a place.  now: monotonic [s].  wall: Unix time [s]."""

    parameters: Sequence[float]
    now: float
    wall: float
    announce: Announce

    def whole(self, n: int) -> int | None:
        """Parameter n (from 1) as an integer; None if it is not finite or beyond 32 bits."""
        value = self.parameters[n - 1]
        return round(value) if math.isfinite(value) and abs(value) < 1 << 31 else None


def carry_out(number: int, command: Command, channel: VehicleChannel) -> Answer:
    """Carry out a command.  number: its MAV_CMD."""
    handler = COMMANDS.get(number)
    return handler(command, channel) if handler else (UNSUPPORTED, [])


def request_message(command: Command, channel: VehicleChannel) -> Answer:
    name, at = _message_name(command), channel.autopilot.latest
    if name is None or at is None:
        return FAILED, []
    return ACCEPTED, telemetry.STREAMED[name][1](channel.autopilot, at, command.wall)


def request_capabilities(command: Command, channel: VehicleChannel) -> Answer:
    at = channel.autopilot.latest
    return (FAILED, []) if at is None else (ACCEPTED, telemetry.autopilot_version(channel.autopilot, at, command.wall))


def set_interval(command: Command, channel: VehicleChannel) -> Answer:
    name, microseconds = _message_name(command), command.parameters[1]
    if name is None or not math.isfinite(microseconds) or (microseconds < 0 and microseconds != DISABLED):
        return FAILED, []
    if name == "HEARTBEAT":  # its interval is fixed: stations would lose the vehicle
        return ACCEPTED, []
    if microseconds == DEFAULT:
        channel.reset(name, command.now)
    elif microseconds == DISABLED:
        channel.every(name, None, command.now)
    else:
        channel.every(name, min(max(microseconds * 1e-6, FASTEST), SLOWEST), command.now)
    return ACCEPTED, []


def get_interval(command: Command, channel: VehicleChannel) -> Answer:
    number, name = command.whole(1), _message_name(command)
    if number is None or not 0 <= number < 1 << 16:  # MESSAGE_INTERVAL has 16 bits for it
        return FAILED, []
    if name is None:
        return FAILED, [_message_interval(number, UNAVAILABLE)]
    interval = HEARTBEAT_EVERY if name == "HEARTBEAT" else channel.interval(name)
    return ACCEPTED, [_message_interval(number, DISABLED if interval is None else round(interval * 1e6))]


def arm(command: Command, channel: VehicleChannel) -> Answer:
    """A component of the experiment drives the vehicle: it can be disarmed only if that component takes steering."""
    autopilot, wanted = channel.autopilot, command.whole(1)
    if wanted not in (0, 1):
        return FAILED, []
    if not wanted and autopilot.control is None:
        command.announce(autopilot, "Disarm: the experiment drives this vehicle")
        return FAILED, []
    if autopilot.armed != bool(wanted):
        autopilot.armed = bool(wanted)
        command.announce(autopilot, "Arming motors" if wanted else "Disarming motors")
    if autopilot.control:
        autopilot.control.armed = autopilot.armed
    return ACCEPTED, []


def set_mode(command: Command, channel: VehicleChannel) -> Answer:
    flags, mode = command.whole(1), command.whole(2)
    if flags is None or not flags & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED or mode is None:
        return FAILED, []
    return (ACCEPTED if change_mode(channel.autopilot, mode, command.announce) else FAILED), []


def change_mode(autopilot: Autopilot, number: int, announce: Announce) -> bool:
    """Enter a mode by its number.  False: there is none with that number."""
    try:
        mode = FlightMode(number)
    except ValueError:
        return False
    if mode != autopilot.mode:
        autopilot.mode = mode
        announce(autopilot, f"Mode {mode.name}")
    if autopilot.control:
        autopilot.control.set_point = None
        autopilot.control.guided = mode == FlightMode.GUIDED
    return True


def get_home(command: Command, channel: VehicleChannel) -> Answer:
    at = channel.autopilot.latest
    return (FAILED, []) if at is None else (ACCEPTED, telemetry.home_position(channel.autopilot, at, command.wall))


def cannot(command: Command, channel: VehicleChannel) -> Answer:
    """A command that ArduSub knows and a simulated vehicle cannot follow: home, for one, is the experiment's origin."""
    return FAILED, []


def reposition(command: Command, channel: VehicleChannel) -> Answer:
    """Go to a place, in mode GUIDED from then on."""
    autopilot = channel.autopilot
    latitude, longitude, altitude = command.parameters[4:7]
    if autopilot.control is None or not all(map(math.isfinite, (latitude, longitude))):
        return FAILED, []
    if abs(latitude) > 90 or abs(longitude) > 180:
        return DENIED, []
    change_mode(autopilot, FlightMode.GUIDED, command.announce)
    yaw = command.parameters[3]
    north, east = to_ned(autopilot.origin, latitude, longitude)
    autopilot.control.set_point = SetPoint(
        position=(north, east, -altitude if math.isfinite(altitude) else None),
        yaw=yaw if math.isfinite(yaw) else None,
    )
    return ACCEPTED, []


COMMANDS: dict[int, Callable[[Command, VehicleChannel], Answer]] = {
    mavlink.MAV_CMD_REQUEST_MESSAGE: request_message,
    mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: request_capabilities,
    mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: set_interval,
    mavlink.MAV_CMD_GET_MESSAGE_INTERVAL: get_interval,
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM: arm,
    mavlink.MAV_CMD_DO_SET_MODE: set_mode,
    mavlink.MAV_CMD_GET_HOME_POSITION: get_home,
    mavlink.MAV_CMD_DO_REPOSITION: reposition,
    mavlink.MAV_CMD_DO_SET_HOME: cannot,
    mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: cannot,
    mavlink.MAV_CMD_NAV_TAKEOFF: cannot,
    mavlink.MAV_CMD_NAV_LAND: cannot,
    mavlink.MAV_CMD_MISSION_START: cannot,
}


def _message_name(command: Command) -> str | None:
    """The message whose id is parameter 1; None if it cannot be had."""
    number = command.whole(1)
    return None if number is None else telemetry.MESSAGE_NAMES.get(number)


def _message_interval(number: int, microseconds: int) -> Message:
    return mavlink.MAVLink_message_interval_message(message_id=number, interval_us=microseconds)
