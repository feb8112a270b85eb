"""MANUAL_CONTROL, RC_CHANNELS_OVERRIDE and set points, as ArduSub understands them.

ArduSub/joystick.cpp and ArduSub/GCS_MAVLink_Sub.cpp; overrides: GCS_MAVLINK::handle_rc_channels_override.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from ..vehicle.autopilot import Autopilot
from ..vehicle.control import CHANNELS, FORWARD, LATERAL, PITCH, ROLL, THROTTLE, YAW, Control, Override, SetPoint
from ..vehicle.frame import REST, SPAN
from ..vehicle.modes import FlightMode
from ..vehicle.parameters import ButtonFunction
from ..vehicle.sample import E7, to_ned
from .commands import GLOBAL_FRAMES, NOT_STEERED, Announce, arm_or_disarm, change_mode
from .dialect import Message, mavlink

FULL_AXIS = 1000  # of MANUAL_CONTROL: x, y, r, s and t in -1000..1000, z in 0..1000
NEUTRAL_Z = 500
HAS_PITCH, HAS_ROLL = 1, 2  # bits of enabled_extensions: s and t count
BUTTONS = 32
FIRST_CHANNELS = 8  # whose RC_CHANNELS_OVERRIDE has other values for "release" and "leave alone"
LEAVE = 65535  # us: the channel stays as it is
RELEASE_LATER = 65534  # us: releases one of channels 9 to 18, which 0 leaves alone
MOVED = 0.01  # of a full stick; what moves further ends a set point
FARTHEST = 1e5  # m, m/s, rad or rad/s: beyond it a set point is nonsense
LEVEL = math.radians(1.0)  # a pitch beyond it is more than rounding
NEUTRAL_THRUST = 0.5

BUTTON_MODES: dict[int, FlightMode] = {
    ButtonFunction.MODE_MANUAL: FlightMode.MANUAL,
    ButtonFunction.MODE_STABILIZE: FlightMode.STABILIZE,
    ButtonFunction.MODE_DEPTH_HOLD: FlightMode.ALT_HOLD,
    ButtonFunction.MODE_POSHOLD: FlightMode.POSHOLD,
}
BUTTON_ARMING = (ButtonFunction.ARM, ButtonFunction.DISARM, ButtonFunction.ARM_TOGGLE)
BUTTON_GAIN = (ButtonFunction.GAIN_INCREASE, ButtonFunction.GAIN_DECREASE)

IGNORE_POSITION = (
    mavlink.POSITION_TARGET_TYPEMASK_X_IGNORE,
    mavlink.POSITION_TARGET_TYPEMASK_Y_IGNORE,
    mavlink.POSITION_TARGET_TYPEMASK_Z_IGNORE,
)
IGNORE_VELOCITY = (
    mavlink.POSITION_TARGET_TYPEMASK_VX_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_VY_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_VZ_IGNORE
)
IGNORE_YAW = mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE
IGNORE_YAW_RATE = mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
IGNORE_ATTITUDE = mavlink.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE
IGNORE_THROTTLE = mavlink.ATTITUDE_TARGET_TYPEMASK_THROTTLE_IGNORE
BODY_FRAMES = (mavlink.MAV_FRAME_BODY_NED, mavlink.MAV_FRAME_BODY_OFFSET_NED, mavlink.MAV_FRAME_BODY_FRD)
FRAMES = (mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_LOCAL_OFFSET_NED, *BODY_FRAMES)
ATTITUDE_MODES = (FlightMode.ALT_HOLD, FlightMode.STABILIZE, FlightMode.GUIDED)

# Why a set point is not followed; a STATUSTEXT has 50 characters.
NO_SET_POINTS = f"Set point ignored: {NOT_STEERED}"
NO_STICKS = f"Sticks ignored: {NOT_STEERED}"
NONSENSE = "Set point ignored: its values make no sense"
NO_FRAME = "Set point ignored: unknown coordinate frame"
NOTHING = "Set point ignored: its type_mask leaves nothing"
ACCELERATION = "Set point ignored: accelerations alone"


class Pilot:
    """The joystick of one vehicle: which buttons are down."""

    def __init__(self, autopilot: Autopilot):
        self._autopilot, self._buttons = autopilot, 0

    def manual_control(self, message: Message, now: float, announce: Announce) -> str:
        """MANUAL_CONTROL; returns why it does not count, or "".  An axis beyond its range is neutral."""
        autopilot, control = self._autopilot, self._autopilot.control
        if control is None:
            neutral = (message.x, message.y, message.z, message.r, message.buttons) == (0, 0, NEUTRAL_Z, 0, 0)
            return "" if neutral else NO_STICKS
        self._press((message.buttons & 0xFFFF) | (getattr(message, "buttons2", 0) & 0xFFFF) << 16, announce)
        throttle = control.gain * autopilot.parameters["JS_THR_GAIN"]

        def demand(axis: int) -> float:
            return _limited(axis / FULL_AXIS * control.gain) if abs(axis) <= FULL_AXIS else 0.0

        up = _limited((message.z - NEUTRAL_Z) / NEUTRAL_Z * throttle) if 0 <= message.z <= FULL_AXIS else 0.0
        demands = {
            THROTTLE: up,
            YAW: demand(message.r),
            FORWARD: demand(message.x),
            LATERAL: demand(message.y),
        }
        extensions = getattr(message, "enabled_extensions", 0)
        if extensions & HAS_PITCH:
            demands[PITCH] = demand(message.s)
        if extensions & HAS_ROLL:
            demands[ROLL] = demand(message.t)
        pulses = {n: Override(pulse=REST + SPAN * value, at=now, joystick=True) for n, value in demands.items()}
        control.overrides = {**control.overrides, **pulses}
        return _end_set_points(control)

    def channels(self, message: Message, now: float) -> str:
        """RC_CHANNELS_OVERRIDE: each channel is overridden, released or left alone; returns what does not count, or "".

        Pitch, roll, throttle, yaw, forward and lateral are channels 1 to 6.
        """
        control = self._autopilot.control
        if control is None:
            return NO_STICKS
        overrides, idle = dict(control.overrides), ""
        for n in range(1, CHANNELS + 1):
            pulse = getattr(message, f"chan{n}_raw", 0)
            first = n <= FIRST_CHANNELS
            if pulse == LEAVE or (not first and pulse == 0):
                continue
            if pulse == (0 if first else RELEASE_LATER):
                overrides.pop(n, None)
                continue
            overrides[n] = Override(pulse=pulse, at=now)
            if pulse != REST and (n == PITCH or n > LATERAL):
                idle = idle or f"Channel {n} moves nothing here"
        control.overrides = overrides
        return _end_set_points(control) or idle

    def _press(self, buttons: int, announce: Announce) -> None:
        """Do what the buttons are for that were up before.  buttons: a bit for each that is down."""
        autopilot, control = self._autopilot, self._autopilot.control
        assert control is not None
        new, self._buttons = buttons & ~self._buttons, buttons
        for n in range(BUTTONS):
            if not new >> n & 1:
                continue
            function = int(autopilot.parameters[f"BTN{n}_FUNCTION"])
            if function in BUTTON_MODES:
                change_mode(autopilot, BUTTON_MODES[function], announce)
            elif function in BUTTON_GAIN:
                low, high = autopilot.parameters["JS_GAIN_MIN"], autopilot.parameters["JS_GAIN_MAX"]
                step = (high - low) / max(1.0, autopilot.parameters["JS_GAIN_STEPS"] - 1)
                change = step if function == ButtonFunction.GAIN_INCREASE else -step
                control.gain = min(high, max(low, control.gain + change))
                announce(autopilot, f"#Gain is {control.gain * 100:.0f}%")
            elif function in BUTTON_ARMING:
                toggled = not autopilot.armed
                armed = toggled if function == ButtonFunction.ARM_TOGGLE else function == ButtonFunction.ARM
                arm_or_disarm(autopilot, armed, announce)
            elif function != ButtonFunction.NONE:
                announce(autopilot, f"Button {n} does nothing here", mavlink.MAV_SEVERITY_WARNING)


def local_set_point(autopilot: Autopilot, message: Message, now: float) -> str:
    """SET_POSITION_TARGET_LOCAL_NED, in mode GUIDED; returns why it is not followed, or "".

    What it ignores stays as it is.
    """
    control, at = autopilot.control, autopilot.latest
    if control is None or at is None:
        return NO_SET_POINTS
    if autopilot.mode != FlightMode.GUIDED:
        return _wrong_mode(autopilot)
    values = (message.x, message.y, message.z, message.vx, message.vy, message.vz, message.yaw, message.yaw_rate)
    if not _sensible(*values):
        return NONSENSE
    mask, frame = message.type_mask, message.coordinate_frame
    if frame not in FRAMES:
        return NO_FRAME
    position, velocity, yaw = list(values[:3]), list(values[3:6]), message.yaw
    in_body = frame in BODY_FRAMES
    if in_body:
        psi = float(at.eta[5])
        position, velocity, yaw = _turned(position, psi), _turned(velocity, psi), message.yaw + psi
    if frame != mavlink.MAV_FRAME_LOCAL_NED:
        position = [value + float(here) for value, here in zip(position, at.eta[:3], strict=True)]
    if in_body and any(mask & bit for bit in IGNORE_POSITION[:2]):
        mask |= IGNORE_POSITION[0] | IGNORE_POSITION[1]  # one horizontal component alone cannot be turned
    return _go(control, mask, position, velocity, yaw, message.yaw_rate, now)


def global_set_point(autopilot: Autopilot, message: Message, now: float) -> str:
    """SET_POSITION_TARGET_GLOBAL_INT, in mode GUIDED, and in mode ALT_HOLD its altitude; returns why it is not
    followed, or ""."""
    control, mask = autopilot.control, message.type_mask
    if control is None:
        return NO_SET_POINTS
    if autopilot.mode not in (FlightMode.GUIDED, FlightMode.ALT_HOLD):
        return _wrong_mode(autopilot)
    values = (message.alt, message.vx, message.vy, message.vz, message.yaw, message.yaw_rate)
    latitude, longitude = message.lat_int / E7, message.lon_int / E7
    if not _sensible(*values) or abs(latitude) > 90 or abs(longitude) > 180:
        return NONSENSE
    if message.coordinate_frame not in GLOBAL_FRAMES:
        return NO_FRAME
    if autopilot.mode == FlightMode.ALT_HOLD:
        if mask & IGNORE_POSITION[2]:
            return "Depth target ignored: its type_mask ignores z"
        before = control.set_point or SetPoint()
        control.set_point = replace(before, position=(None, None, -message.alt), velocity=None)
        return ""
    north, east = to_ned(autopilot.origin, latitude, longitude)
    velocity = [message.vx, message.vy, message.vz]
    return _go(control, mask, [north, east, -message.alt], velocity, message.yaw, message.yaw_rate, now)


def attitude_target(autopilot: Autopilot, message: Message, now: float) -> str:
    """SET_ATTITUDE_TARGET: roll and yaw, and the climb rate that its thrust stands for, unless that is ignored.

    Returns what of it is not followed, or "".
    """
    control, mode = autopilot.control, autopilot.mode
    if control is None:
        return NO_SET_POINTS
    if mode not in ATTITUDE_MODES:
        return f"Attitude ignored in mode {mode.name}"
    if message.type_mask & IGNORE_ATTITUDE:
        return "Attitude target ignored: rates alone"
    size = math.hypot(*message.q)
    if not math.isfinite(size) or not 0.5 < size < 2.0 or not math.isfinite(message.thrust):
        return NONSENSE
    roll, pitch, yaw = _euler(*(component / size for component in message.q))
    climbs = not message.type_mask & IGNORE_THROTTLE
    refused = "Attitude target: pitch stays level" if abs(pitch) > LEVEL else ""
    if climbs and mode == FlightMode.STABILIZE:
        refused, climbs = "Thrust ignored in mode STABILIZE", False
    velocity = (0.0, 0.0, -_climb(autopilot, message.thrust)) if climbs else None
    before = control.set_point if mode != FlightMode.GUIDED else None
    position = before.position if before and not climbs else (None, None, None)
    control.set_point = SetPoint(position=position, velocity=velocity, roll=roll, yaw=yaw, at=now)
    return refused


def _go(
    control: Control, mask: int, position: list[float], velocity: list[float], yaw: float, yaw_rate: float, now: float
) -> str:
    """Take over a set point of mode GUIDED, in NED; returns why it is not followed, or ""."""
    x, y, z = (None if mask & bit else value for bit, value in zip(IGNORE_POSITION, position, strict=True))
    point = SetPoint(
        position=(x, y, z),
        velocity=None if mask & IGNORE_VELOCITY else (velocity[0], velocity[1], velocity[2]),
        yaw=None if mask & IGNORE_YAW else yaw,
        yaw_rate=None if mask & IGNORE_YAW_RATE else yaw_rate,
        at=now,
    )
    if point == SetPoint(at=now):
        accelerations = (
            mavlink.POSITION_TARGET_TYPEMASK_AX_IGNORE
            | mavlink.POSITION_TARGET_TYPEMASK_AY_IGNORE
            | mavlink.POSITION_TARGET_TYPEMASK_AZ_IGNORE
        )
        return NOTHING if mask & accelerations == accelerations else ACCELERATION
    control.set_point = point
    return ""


def _end_set_points(control: Control) -> str:
    """A stick that moves ends the set point of its motion; returns why it does not, or ""."""
    point = control.set_point
    if control.mode == FlightMode.GUIDED:
        return "Sticks do not count in mode GUIDED" if max(map(abs, control.sticks())) > MOVED else ""
    if point is None:
        return ""
    _, _, heave, roll, yaw = map(abs, control.demands())
    if heave > MOVED:
        point = replace(point, position=(None, None, None), velocity=None)
    if roll > MOVED:
        point = replace(point, roll=None)
    if yaw > MOVED:
        point = replace(point, yaw=None, yaw_rate=None)
    control.set_point = point
    return ""


def _climb(autopilot: Autopilot, thrust: float) -> float:
    """Climb rate [m/s] that a thrust in 0..1 stands for."""
    share = 2 * (max(0.0, min(1.0, thrust)) - NEUTRAL_THRUST)
    return share * autopilot.parameters["WPNAV_SPEED_UP" if share > 0 else "WPNAV_SPEED_DN"] / 100


def _euler(w: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Roll, pitch and yaw [rad], zyx, of a unit quaternion."""
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(_limited(2 * (w * y - z * x)))
    return roll, pitch, math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def _wrong_mode(autopilot: Autopilot) -> str:
    return f"Set point ignored in mode {autopilot.mode.name}"


def _sensible(*values: float) -> bool:
    return all(map(math.isfinite, values)) and max(map(abs, values)) <= FARTHEST


def _turned(vector: list[float], psi: float) -> list[float]:
    """A vector in level body axes, in NED."""
    c, s = math.cos(psi), math.sin(psi)
    return [c * vector[0] - s * vector[1], s * vector[0] + c * vector[1], vector[2]]


def _limited(value: float) -> float:
    return max(-1.0, min(1.0, value))


SET_POINTS: dict[str, Callable[[Autopilot, Message, float], str]] = {
    "SET_POSITION_TARGET_LOCAL_NED": local_set_point,
    "SET_POSITION_TARGET_GLOBAL_INT": global_set_point,
    "SET_ATTITUDE_TARGET": attitude_target,
}
