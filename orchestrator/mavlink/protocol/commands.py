"""Commands (COMMAND_LONG, COMMAND_INT): each is answered by a COMMAND_ACK."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from ..vehicle.autopilot import Autopilot
from ..vehicle.control import SetPoint
from ..vehicle.modes import FlightMode
from ..vehicle.sample import to_ned
from . import telemetry
from .dialect import Message, mavlink
from .station import FASTEST, HEARTBEAT_EVERY, SLOWEST, VehicleChannel

ACCEPTED, DENIED = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_DENIED
FAILED, UNSUPPORTED = mavlink.MAV_RESULT_FAILED, mavlink.MAV_RESULT_UNSUPPORTED
DEFAULT, DISABLED = 0, -1  # us, in SET_MESSAGE_INTERVAL
UNAVAILABLE = 0  # us, in MESSAGE_INTERVAL; DISABLED likewise

WARNING = mavlink.MAV_SEVERITY_WARNING
SLOWEST_TURN = 1.0  # degrees/s, in CONDITION_YAW
HOME_STAYS = "Home stays the origin of the experiment"
NO_CUSTOM_MODE = "Mode refused: its flag for custom modes is missing"
GLOBAL_FRAMES = (  # home and sea level are both at the origin
    mavlink.MAV_FRAME_GLOBAL,
    mavlink.MAV_FRAME_GLOBAL_INT,
    mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT,
    mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
)
NOT_STEERED = "the experiment drives this"  # vehicle; a STATUSTEXT has 50 characters

Answer = tuple[int, Sequence[Message]]  # MAV_RESULT, and the messages that follow the COMMAND_ACK


class Announce(Protocol):
    """Sends a STATUSTEXT to all stations that see a vehicle."""

    def __call__(self, autopilot: Autopilot, text: str, severity: int = ..., /) -> None: ...


@dataclass(frozen=True, kw_only=True)
class Command:
    """parameters: seven, 5 and 6 in degrees if they are a place.  frame: MAV_FRAME of the place, None if it has none.

    now: monotonic [s].  wall: Unix time [s].
    """

    parameters: Sequence[float]
    frame: int | None
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
    wanted = command.whole(1)
    done = wanted in (0, 1) and arm_or_disarm(channel.autopilot, bool(wanted), command.announce)
    return (ACCEPTED if done else FAILED), []


def terminate(command: Command, channel: VehicleChannel) -> Answer:
    """DO_FLIGHTTERMINATION disarms, as ArduSub's does."""
    done = command.parameters[0] > 0.5 and arm_or_disarm(channel.autopilot, False, command.announce)
    return (ACCEPTED if done else FAILED), []


def arm_or_disarm(autopilot: Autopilot, armed: bool, announce: Announce) -> bool:
    """Arm or disarm; False: a vehicle whose thrusters go on turning is not disarmed."""
    control = autopilot.control
    if not armed and (control is None or not (control.stops or control.holds_disarmed)):
        reason = NOT_STEERED if control is None else "no access to its thrusters"
        announce(autopilot, f"Disarm refused: {reason}", WARNING)
        return False
    if autopilot.armed != armed:
        autopilot.arm(armed)
        announce(autopilot, "Arming motors" if armed else "Disarming motors")
    return True


def set_mode(command: Command, channel: VehicleChannel) -> Answer:
    flags, mode = command.whole(1), command.whole(2)
    if flags is None or not flags & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED or mode is None:
        command.announce(channel.autopilot, NO_CUSTOM_MODE, WARNING)
        return FAILED, []
    return _entered(command, channel, mode)


def change_mode(autopilot: Autopilot, number: int, announce: Announce) -> bool:
    """Enter a mode by its number; False: the vehicle cannot, which is announced."""
    try:
        mode = FlightMode(number)
    except ValueError:
        announce(autopilot, f"Mode {number} refused: no such mode", WARNING)
        return False
    if autopilot.control is None:
        if mode == autopilot.mode:
            return True
        reason = NOT_STEERED
    else:
        reason = autopilot.control.refusal(mode)
    if reason:
        announce(autopilot, f"{mode.name} refused: {reason}", WARNING)
        return False
    changed = mode != autopilot.mode
    autopilot.enter(mode)
    if changed:
        announce(autopilot, f"Mode {mode.name}")
    return True


def surface(command: Command, channel: VehicleChannel) -> Answer:
    """NAV_LAND rises, as ArduSub's does."""
    return _entered(command, channel, FlightMode.SURFACE)


def loiter(command: Command, channel: VehicleChannel) -> Answer:
    return _entered(command, channel, FlightMode.POSHOLD)


def turn(command: Command, channel: VehicleChannel) -> Answer:
    """CONDITION_YAW: an angle in 0..360 degrees, how fast in degrees/s, which way, whether from the present heading."""
    autopilot, control = channel.autopilot, channel.autopilot.control
    angle, speed, way, relative = command.parameters[:4]
    at = autopilot.latest
    if not 0 <= angle <= 360 or relative not in (0, 1) or not 0 <= speed < math.inf:
        return DENIED, []
    if control is None or at is None or "yaw" not in control.held():
        reason = NOT_STEERED if control is None else f"{autopilot.mode.name} holds no heading"
        command.announce(autopilot, f"Heading refused: {reason}", WARNING)
        return FAILED, []
    if math.radians(speed) > control.quickest:
        command.announce(autopilot, f"Heading refused: at most {math.degrees(control.quickest):.3g} deg/s", WARNING)
        return DENIED, []
    yaw = math.radians(angle)
    if relative:
        yaw = float(at.eta[5]) + (-yaw if way < 0 else yaw)
    control.set_point = replace(
        control.set_point or SetPoint(),
        yaw=yaw,
        yaw_rate=None,
        turn=math.radians(max(speed, SLOWEST_TURN)) if speed else None,
    )
    return ACCEPTED, []


def change_speed(command: Command, channel: VehicleChannel) -> Answer:
    """DO_CHANGE_SPEED: the horizontal speed to set points [m/s]; ArduSub denies climb and descent likewise."""
    control, (kind, speed) = channel.autopilot.control, command.parameters[:2]
    if control is None:
        command.announce(channel.autopilot, f"Speed refused: {NOT_STEERED}", WARNING)
        return FAILED, []
    if kind not in (mavlink.SPEED_TYPE_AIRSPEED, mavlink.SPEED_TYPE_GROUNDSPEED):
        command.announce(channel.autopilot, "Speed refused: only the horizontal speed changes", WARNING)
        return DENIED, []
    if not speed > 0 or _is_too_fast(command, channel, speed):
        return DENIED, []
    control.speed = speed
    return ACCEPTED, []


def get_home(command: Command, channel: VehicleChannel) -> Answer:
    at = channel.autopilot.latest
    return (FAILED, []) if at is None else (ACCEPTED, telemetry.home_position(channel.autopilot, at, command.wall))


def cannot(reason: str) -> Callable[[Command, VehicleChannel], Answer]:
    """A command that ArduSub knows and a simulated vehicle cannot follow."""

    def refuse(command: Command, channel: VehicleChannel) -> Answer:
        command.announce(channel.autopilot, reason, WARNING)
        return FAILED, []

    return refuse


def reposition(command: Command, channel: VehicleChannel) -> Answer:
    """Go to a place, in mode GUIDED from then on, at a speed if that is positive."""
    autopilot, speed = channel.autopilot, command.parameters[0]
    latitude, longitude, altitude = command.parameters[4:7]
    if autopilot.control is None:
        command.announce(autopilot, f"Position refused: {NOT_STEERED}", WARNING)
        return FAILED, []
    if not all(map(math.isfinite, (latitude, longitude))):
        return FAILED, []
    if abs(latitude) > 90 or abs(longitude) > 180:
        return DENIED, []
    if command.frame not in (None, *GLOBAL_FRAMES):
        command.announce(autopilot, "Position refused: unknown coordinate frame", WARNING)
        return DENIED, []
    if speed > 0 and _is_too_fast(command, channel, speed):
        return DENIED, []
    change_mode(autopilot, FlightMode.GUIDED, command.announce)
    if speed > 0:
        autopilot.control.speed = speed
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
    mavlink.MAV_CMD_NAV_LAND: surface,
    mavlink.MAV_CMD_NAV_LOITER_UNLIM: loiter,
    mavlink.MAV_CMD_CONDITION_YAW: turn,
    mavlink.MAV_CMD_DO_CHANGE_SPEED: change_speed,
    mavlink.MAV_CMD_DO_FLIGHTTERMINATION: terminate,
    mavlink.MAV_CMD_DO_MOTOR_TEST: cannot("Motor test refused: not simulated"),
    mavlink.MAV_CMD_DO_SET_HOME: cannot(HOME_STAYS),
    mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: cannot("A simulated vehicle is not rebooted"),
    mavlink.MAV_CMD_NAV_TAKEOFF: cannot("A submarine does not take off"),
    mavlink.MAV_CMD_MISSION_START: cannot("Mission refused: no missions yet"),
    mavlink.MAV_CMD_DO_SET_MISSION_CURRENT: cannot("Mission refused: no missions yet"),
}


def _is_too_fast(command: Command, channel: VehicleChannel, speed: float) -> bool:
    """Whether a horizontal speed [m/s] is more than the reference goes, which is announced."""
    autopilot = channel.autopilot
    if autopilot.control is None or speed <= autopilot.control.fastest:
        return False
    command.announce(autopilot, f"Speed refused: at most {autopilot.control.fastest:.3g} m/s", WARNING)
    return True


def _entered(command: Command, channel: VehicleChannel, mode: int) -> Answer:
    return (ACCEPTED if change_mode(channel.autopilot, mode, command.announce) else FAILED), []


def _message_name(command: Command) -> str | None:
    """The message whose id is parameter 1; None if it cannot be had."""
    number = command.whole(1)
    return None if number is None else telemetry.MESSAGE_NAMES.get(number)


def _message_interval(number: int, microseconds: int) -> Message:
    return mavlink.MAVLink_message_interval_message(message_id=number, interval_us=microseconds)
