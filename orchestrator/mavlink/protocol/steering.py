"""MANUAL_CONTROL, RC_CHANNELS_OVERRIDE and set points, as ArduSub understands them.

ArduSub/joystick.cpp and ArduSub/GCS_MAVLink_Sub.cpp.
"""

from __future__ import annotations

import math

from ..vehicle.autopilot import Autopilot, FlightMode
from ..vehicle.control import SetPoint, Stick
from ..vehicle.frame import REST, SPAN
from ..vehicle.parameters import ButtonFunction
from .commands import Announce, change_mode
from .dialect import Message, mavlink

FULL_AXIS = 1000  # of MANUAL_CONTROL: x, y and r in -1000..1000, z in 0..1000
NEUTRAL_Z = 500
BUTTONS = 32
UNCHANGED = (0, 65535)  # us: what RC_CHANNELS_OVERRIDE sends for a channel that it leaves alone
FARTHEST = 1e5  # m, m/s, rad or rad/s: beyond it a set point is nonsense

BUTTON_MODES: dict[int, FlightMode] = {
    ButtonFunction.MODE_MANUAL: FlightMode.MANUAL,
    ButtonFunction.MODE_STABILIZE: FlightMode.STABILIZE,
    ButtonFunction.MODE_DEPTH_HOLD: FlightMode.ALT_HOLD,
    ButtonFunction.MODE_POSHOLD: FlightMode.POSHOLD,
}

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
BODY_FRAMES = (mavlink.MAV_FRAME_BODY_NED, mavlink.MAV_FRAME_BODY_OFFSET_NED, mavlink.MAV_FRAME_BODY_FRD)
FRAMES = (mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_LOCAL_OFFSET_NED, *BODY_FRAMES)


class Pilot:
    """The joystick of one vehicle: its gain, and which buttons are down."""

    def __init__(self, autopilot: Autopilot):
        self._autopilot, self._buttons = autopilot, 0
        self._gain = autopilot.parameters["JS_GAIN_DEFAULT"]

    def manual_control(self, message: Message, now: float, announce: Announce) -> None:
        """MANUAL_CONTROL.  An axis beyond its range is neutral."""
        autopilot, control = self._autopilot, self._autopilot.control
        if control is None:
            return
        self._press((message.buttons & 0xFFFF) | (getattr(message, "buttons2", 0) & 0xFFFF) << 16, announce)
        throttle = self._gain * autopilot.parameters["JS_THR_GAIN"]

        def demand(axis: int) -> float:
            return _limited(axis / FULL_AXIS * self._gain) if abs(axis) <= FULL_AXIS else 0.0

        up = _limited((message.z - NEUTRAL_Z) / NEUTRAL_Z * throttle) if 0 <= message.z <= FULL_AXIS else 0.0
        control.timeout = autopilot.parameters["FS_PILOT_TIMEOUT"]
        control.stick = Stick(surge=demand(message.x), sway=demand(message.y), heave=-up, yaw=demand(message.r), at=now)

    def channels(self, message: Message, now: float) -> None:
        """RC_CHANNELS_OVERRIDE: throttle, yaw, forward and lateral on channels 3 to 6."""
        control = self._autopilot.control
        if control is None:
            return
        before = control.stick
        pulses = message.chan3_raw, message.chan4_raw, message.chan5_raw, message.chan6_raw
        throttle, yaw, forward, lateral = (
            old if pulse in UNCHANGED else _limited((pulse - REST) / SPAN)
            for pulse, old in zip(pulses, (-before.heave, before.yaw, before.surge, before.sway), strict=True)
        )
        control.timeout = self._autopilot.parameters["FS_PILOT_TIMEOUT"]
        control.stick = Stick(surge=forward, sway=lateral, heave=-throttle, yaw=yaw, at=now)

    def _press(self, buttons: int, announce: Announce) -> None:
        """Do what the buttons are for that were up before.  buttons: a bit for each that is down."""
        autopilot = self._autopilot
        new, self._buttons = buttons & ~self._buttons, buttons
        for n in range(BUTTONS):
            if not new >> n & 1:
                continue
            function = int(autopilot.parameters[f"BTN{n}_FUNCTION"])
            if function in BUTTON_MODES:
                change_mode(autopilot, BUTTON_MODES[function], announce)
            elif function in (ButtonFunction.GAIN_INCREASE, ButtonFunction.GAIN_DECREASE):
                low, high = autopilot.parameters["JS_GAIN_MIN"], autopilot.parameters["JS_GAIN_MAX"]
                step = (high - low) / max(1.0, autopilot.parameters["JS_GAIN_STEPS"] - 1)
                change = step if function == ButtonFunction.GAIN_INCREASE else -step
                self._gain = min(high, max(low, self._gain + change))
                announce(autopilot, f"#Gain is {self._gain * 100:.0f}%")
            elif autopilot.control and function in (
                ButtonFunction.ARM,
                ButtonFunction.DISARM,
                ButtonFunction.ARM_TOGGLE,
            ):
                toggled = not autopilot.armed
                armed = toggled if function == ButtonFunction.ARM_TOGGLE else function == ButtonFunction.ARM
                autopilot.armed = autopilot.control.armed = armed


def set_point(autopilot: Autopilot, message: Message) -> None:
    """SET_POSITION_TARGET_LOCAL_NED, in mode GUIDED.  What it ignores stays as it is."""
    control, at = autopilot.control, autopilot.latest
    if control is None or at is None or autopilot.mode != FlightMode.GUIDED:
        return
    values = (message.x, message.y, message.z, message.vx, message.vy, message.vz, message.yaw, message.yaw_rate)
    if not all(map(math.isfinite, values)) or max(map(abs, values)) > FARTHEST:
        return
    mask, frame = message.type_mask, message.coordinate_frame
    if frame not in FRAMES:
        return
    position, velocity, yaw = list(values[:3]), list(values[3:6]), message.yaw
    in_body = frame in BODY_FRAMES
    if in_body:
        psi = float(at.eta[5])
        position, velocity, yaw = _turned(position, psi), _turned(velocity, psi), message.yaw + psi
    if frame != mavlink.MAV_FRAME_LOCAL_NED:
        position = [value + float(here) for value, here in zip(position, at.eta[:3], strict=True)]
    if in_body and any(mask & bit for bit in IGNORE_POSITION[:2]):
        mask |= IGNORE_POSITION[0] | IGNORE_POSITION[1]  # one horizontal component alone cannot be turned
    x, y, z = (None if mask & bit else value for bit, value in zip(IGNORE_POSITION, position, strict=True))
    control.set_point = SetPoint(
        position=(x, y, z),
        velocity=None if mask & IGNORE_VELOCITY else (velocity[0], velocity[1], velocity[2]),
        yaw=None if mask & IGNORE_YAW else yaw,
        yaw_rate=None if mask & IGNORE_YAW_RATE else message.yaw_rate,
    )


def _turned(vector: list[float], psi: float) -> list[float]:
    """A vector in level body axes, in NED."""
    c, s = math.cos(psi), math.sin(psi)
    return [c * vector[0] - s * vector[1], s * vector[0] + c * vector[1], vector[2]]


def _limited(value: float) -> float:
    return max(-1.0, min(1.0, value))
