"""MANUAL_CONTROL and set points, as ArduSub understands them (ArduSub/joystick.cpp, GCS_MAVLink_Sub.cpp)."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from ..vehicle.autopilot import MODES, Autopilot
from ..vehicle.control import SetPoint, Stick
from .commands import change_mode

# Functions of buttons
DISARM, ARM, ARM_TOGGLE, MANUAL, STABILIZE, DEPTH_HOLD, POSHOLD, GAIN_UP, GAIN_DOWN = 4, 3, 2, 5, 6, 7, 8, 42, 43
BUTTON_MODES = {MANUAL: "MANUAL", STABILIZE: "STABILIZE", DEPTH_HOLD: "ALT_HOLD", POSHOLD: "POSHOLD"}

# Bits of a set point's type_mask that say "do not look at this"
IGNORE_POSITION = (1, 2, 4)
IGNORE_VELOCITY, IGNORE_YAW, IGNORE_YAW_RATE = 8 | 16 | 32, 1 << 10, 1 << 11
LOCAL_NED, LOCAL_OFFSET_NED, BODY_NED, BODY_OFFSET_NED, BODY_FRD = 1, 7, 8, 9, 12  # MAV_FRAME

Tell = Callable[[Autopilot, str], None]


class Pilot:
    """The joystick of one vehicle: its gain, and which buttons are down."""

    def __init__(self, autopilot: Autopilot):
        self._autopilot, self._buttons = autopilot, 0
        self._gain = autopilot.parameters["JS_GAIN_DEFAULT"]

    def manual_control(self, message: Any, now: float, tell: Tell) -> None:
        autopilot, control = self._autopilot, self._autopilot.control
        if control is None:
            return
        self._press((message.buttons & 0xFFFF) | (getattr(message, "buttons2", 0) & 0xFFFF) << 16, tell)
        throttle = self._gain * autopilot.parameters["JS_THR_GAIN"]

        def axis(value: int) -> float:
            return _limited(value / 1000 * self._gain) if abs(value) <= 1000 else 0.0

        # z: 0..1000 with 500 neutral, up positive
        up = _limited((message.z - 500) / 500 * throttle) if 0 <= message.z <= 1000 else 0.0
        control.timeout = autopilot.parameters["FS_PILOT_TIMEOUT"]
        control.stick = Stick(axis(message.x), axis(message.y), -up, axis(message.r), now)

    def channels(self, message: Any, now: float) -> None:
        """RC_CHANNELS_OVERRIDE: throttle, yaw, forward and lateral on channels 3 to 6; 0 and 65535: as before."""
        control = self._autopilot.control
        if control is None:
            return
        before = control.stick
        pulses = message.chan3_raw, message.chan4_raw, message.chan5_raw, message.chan6_raw
        values = [
            _limited((pulse - 1500) / 400) if 0 < pulse < 65535 else old
            for pulse, old in zip(pulses, (-before.heave, before.yaw, before.surge, before.sway), strict=True)
        ]
        control.timeout = self._autopilot.parameters["FS_PILOT_TIMEOUT"]
        control.stick = Stick(values[2], values[3], -values[0], values[1], now)

    def _press(self, buttons: int, tell: Tell) -> None:
        autopilot = self._autopilot
        new, self._buttons = buttons & ~self._buttons, buttons
        for n in range(32):
            if not new >> n & 1:
                continue
            function = int(autopilot.parameters[f"BTN{n}_FUNCTION"])
            if function in BUTTON_MODES:
                change_mode(autopilot, MODES[BUTTON_MODES[function]], tell)
            elif function in (ARM, DISARM, ARM_TOGGLE) and autopilot.control:
                armed = not autopilot.armed if function == ARM_TOGGLE else function == ARM
                autopilot.armed = autopilot.control.armed = armed
            elif function in (GAIN_UP, GAIN_DOWN):
                low, high = autopilot.parameters["JS_GAIN_MIN"], autopilot.parameters["JS_GAIN_MAX"]
                step = (high - low) / max(1.0, autopilot.parameters["JS_GAIN_STEPS"] - 1)
                self._gain = min(high, max(low, self._gain + (step if function == GAIN_UP else -step)))
                tell(autopilot, f"#Gain is {self._gain * 100:.0f}%")


def set_point(autopilot: Autopilot, message: Any, now: float) -> None:
    """SET_POSITION_TARGET_LOCAL_NED, in mode GUIDED.  What it does not ask for stays as it is."""
    control, at = autopilot.control, autopilot.latest
    if control is None or at is None or autopilot.mode != MODES["GUIDED"]:
        return
    values = (message.x, message.y, message.z, message.vx, message.vy, message.vz, message.yaw, message.yaw_rate)
    if not all(map(math.isfinite, values)) or max(map(abs, values)) > 1e5:
        return
    mask, frame = message.type_mask, message.coordinate_frame
    if frame not in (LOCAL_NED, LOCAL_OFFSET_NED, BODY_NED, BODY_OFFSET_NED, BODY_FRD):
        return
    position, velocity, yaw = list(values[:3]), list(values[3:6]), message.yaw
    turned = frame in (BODY_NED, BODY_OFFSET_NED, BODY_FRD)
    if turned:
        psi = float(at.eta[5])
        position, velocity, yaw = _turned(position, psi), _turned(velocity, psi), message.yaw + psi
    if frame != LOCAL_NED:
        position = [value + float(here) for value, here in zip(position, at.eta[:3], strict=True)]
    if turned and any(mask & bit for bit in IGNORE_POSITION[:2]):
        mask |= IGNORE_POSITION[0] | IGNORE_POSITION[1]  # half a turned vector is none
    x, y, z = (None if mask & bit else value for bit, value in zip(IGNORE_POSITION, position, strict=True))
    control.set_point = SetPoint(
        (x, y, z),
        None if mask & IGNORE_VELOCITY else (velocity[0], velocity[1], velocity[2]),
        None if mask & IGNORE_YAW else yaw,
        None if mask & IGNORE_YAW_RATE else message.yaw_rate,
        now,
    )


def _turned(vector: list[float], psi: float) -> list[float]:
    c, s = math.cos(psi), math.sin(psi)
    return [c * vector[0] - s * vector[1], s * vector[0] + c * vector[1], vector[2]]


def _limited(value: float) -> float:
    return max(-1.0, min(1.0, value))
