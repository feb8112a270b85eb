"""The messages a vehicle sends of itself, made of a sample: units, signs and ranges as ArduSub's.

What is not simulated says so where MAVLink has a value for that (a battery's current: -1), and else stands still.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..vehicle.autopilot import BANNER, HASH, VERSION, Autopilot
from ..vehicle.sample import Sample, within, wrapped
from .dialect import message

INT16, INT32 = 32767, 2147483647
SURFACE_PRESSURE = 1013.25  # hPa
HPA_PER_METRE = 1025 * 9.80665 / 100  # of sea water
STANDARD_GRAVITY = 9.80665  # m/s2, of the unit mG
WATER, HULL = 1000, 2500  # cdegC
SUPPLY = 16_000  # mV, what the thesis' T200 run at
NOTHING = 65535  # of an uint16: unused, or unknown
EARTH = 1e7  # per degree

# MAV_SYS_STATUS_SENSOR
SENSORS = 1 | 2 | 4 | 8 | 32 | 1 << 10 | 1 << 11 | 1 << 12 | 1 << 13 | 1 << 14 | 1 << 15 | 1 << 21 | 1 << 25 | 1 << 28
# ATTITUDE, VELOCITY_HORIZ, VELOCITY_VERT, POS_HORIZ_REL, POS_HORIZ_ABS, POS_VERT_ABS, PRED_POS_HORIZ_REL and _ABS
EKF_FLAGS = 831
# PARAM_FLOAT, MISSION_FLOAT, MISSION_INT, COMMAND_INT, FTP, SET_ATTITUDE_TARGET, SET_POSITION_TARGET_LOCAL_NED,
# SET_POSITION_TARGET_GLOBAL_INT, FLIGHT_TERMINATION, MAVLINK2, PARAM_ENCODE_C_CAST
CAPABILITIES = 2 | 1 | 4 | 8 | 32 | 64 | 128 | 256 | 2048 | 8192 | 131072

Maker = Callable[[Autopilot, Sample, float], Sequence[Any]]  # wall: Unix time [s]


def heartbeat(autopilot: Autopilot) -> Any:
    return message("HEARTBEAT", 12, 3, autopilot.base_mode, autopilot.mode, autopilot.status, 3)


def banner() -> list[Any]:
    return [statustext(text) for text in BANNER]


def statustext(text: str, severity: int = 6) -> Any:
    return message("STATUSTEXT", severity, text.encode("ascii", "replace")[:50])


def attitude(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    return [message("ATTITUDE", at.milliseconds, *map(wrapped, at.eta[3:]), *map(float, at.nu[3:]))]


def attitude_quaternion(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    w, x, y, z = _quaternion(*map(float, at.eta[3:]))
    return [message("ATTITUDE_QUATERNION", at.milliseconds, w, x, y, z, *map(float, at.nu[3:]))]


def ahrs2(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    return [message("AHRS2", *map(wrapped, at.eta[3:]), -at.depth, *at.place)]


def ahrs(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    return [message("AHRS", *[0.0] * 7)]


def vfr_hud(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    speed, ground = float(np.linalg.norm(at.nu[:3])), math.hypot(*at.velocity[:2])
    throttle = round(100 * float(np.mean(np.abs(np.clip(at.u, -1, 1))))) if len(at.u) else 0
    return [message("VFR_HUD", speed, ground, int(at.heading), throttle, -at.depth, -float(at.velocity[2]))]


def local_position(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    return [message("LOCAL_POSITION_NED", at.milliseconds, *map(float, at.eta[:3]), *map(float, at.velocity))]


def global_position(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    altitude = within(-at.depth * 1e3, INT32)
    return [
        message(
            "GLOBAL_POSITION_INT",
            at.milliseconds,
            *at.place,
            altitude,
            altitude,
            *(within(v * 100, INT16) for v in at.velocity),
            _centidegrees(at.heading),
        )
    ]


def gps_raw(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    north, east = map(float, at.velocity[:2])
    speed = min(NOTHING - 1, round(100 * math.hypot(north, east)))
    course = _centidegrees(math.degrees(math.atan2(east, north)) % 360)
    return [
        message(
            "GPS_RAW_INT", at.microseconds, 3, *at.place, within(-at.depth * 1e3, INT32), 100, 100, speed, course, 10
        )
    ]


def raw_imu(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    return [message("RAW_IMU", at.microseconds, *_imu(at), 0, HULL)]


def scaled_imu2(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    return [message("SCALED_IMU2", at.milliseconds, *_imu(at), HULL)]


def scaled_pressure(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    """The barometer inside the hull."""
    return [message("SCALED_PRESSURE", at.milliseconds, SURFACE_PRESSURE, 0.0, HULL)]


def scaled_pressure2(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    """The depth sensor; above the surface it reads air."""
    pressure = SURFACE_PRESSURE + HPA_PER_METRE * max(0.0, at.depth)
    return [message("SCALED_PRESSURE2", at.milliseconds, pressure, 0.0, WATER)]


def scaled_pressure3(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    """The temperature of the water: no pressure means that there is nothing else in it."""
    return [message("SCALED_PRESSURE3", at.milliseconds, 0.0, 0.0, WATER)]


def sys_status(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    return [message("SYS_STATUS", SENSORS, SENSORS, SENSORS, 0, SUPPLY, -1, -1, 0, 0, 0, 0, 0, 0)]


def power_status(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    return [message("POWER_STATUS", 5000, 0, 0)]


def meminfo(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    return [message("MEMINFO", 0, NOTHING, 1 << 20)]


def mission_current(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    return [message("MISSION_CURRENT", 0)]


def nav_controller_output(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    """What the controller was told to reach, where the experiment tells one."""
    if not np.all(np.isfinite(at.eta_d)):
        return [message("NAV_CONTROLLER_OUTPUT", 0.0, 0.0, int(wrapped_degrees(at.heading)), 0, 0, 0.0, 0.0, 0.0)]
    roll, pitch, yaw = (math.degrees(wrapped(float(angle))) for angle in at.eta_d[3:])
    north, east, down = map(float, at.eta_d[:3] - at.eta[:3])
    bearing = math.degrees(math.atan2(east, north))
    distance = min(NOTHING, round(math.hypot(north, east)))
    return [message("NAV_CONTROLLER_OUTPUT", roll, pitch, round(yaw), round(bearing), distance, -down, 0.0, 0.0)]


def named_values(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    gain = autopilot.parameters["JS_GAIN_DEFAULT"]
    values = {
        "CamTilt": 0.5,
        "CamPan": 0.5,
        "TetherTrn": float(round(at.eta[5] / (2 * math.pi))),
        "Lights1": 0.0,
        "Lights2": 0.0,
        "PilotGain": gain,
        "InputHold": 0.0,
        "RollPitch": 0.0,
        "RFTarget": 0.0,
    }
    return [message("NAMED_VALUE_FLOAT", at.milliseconds, name.encode(), value) for name, value in values.items()]


def servo_output(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    """The commands of the thrusters, in ArduSub's numbering; all unused where the vehicle has no such frame."""
    motors = autopilot.frame.pwm(at.u, autopilot.directions()) if autopilot.frame and len(at.u) == 6 else [0] * 6
    return [message("SERVO_OUTPUT_RAW", at.microseconds & 0xFFFFFFFF, 0, *motors, *[0] * 10)]


def rc_channels(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    channels = autopilot.control.channels() if autopilot.control else [1500] * 8
    return [message("RC_CHANNELS", at.milliseconds, 8, *channels, *[NOTHING] * 10, 255)]


def system_time(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    return [message("SYSTEM_TIME", round(wall * 1e6), at.milliseconds)]


def battery_status(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    return [message("BATTERY_STATUS", 0, 0, 0, INT16, [SUPPLY, *[NOTHING] * 9], -1, -1, -1, -1, 0, 1)]


def ekf_status(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    return [message("EKF_STATUS_REPORT", EKF_FLAGS, *[0.0] * 5)]


def vibration(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    return [message("VIBRATION", at.microseconds, 0.0, 0.0, 0.0, 0, 0, 0)]


def home_position(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    return [
        message(
            "HOME_POSITION", *_origin(autopilot), 0, 0.0, 0.0, 0.0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, at.microseconds
        )
    ]


def global_origin(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    return [message("GPS_GLOBAL_ORIGIN", *_origin(autopilot), 0, at.microseconds)]


def extended_sys_state(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    return [message("EXTENDED_SYS_STATE", 0, 2 if autopilot.armed else 1)]


def autopilot_version(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    major, minor, patch = VERSION
    version = major << 24 | minor << 16 | patch << 8 | 255  # 255: an official release
    return [
        message(
            "AUTOPILOT_VERSION",
            CAPABILITIES,
            version,
            0,
            0,
            0,
            list(HASH.encode()),
            [0] * 8,
            [0] * 8,
            0,
            0,
            autopilot.system,
        )
    ]


def heartbeat_on_request(autopilot: Autopilot, at: Sample, wall: float) -> list[Any]:
    return [heartbeat(autopilot)]


# Of every message that can be had: the stream it belongs to (None: sent when asked for), in ArduSub's order.
STREAMED: dict[str, tuple[str | None, Maker]] = {
    "HEARTBEAT": (None, heartbeat_on_request),
    "RAW_IMU": ("RAW_SENS", raw_imu),
    "SCALED_IMU2": ("RAW_SENS", scaled_imu2),
    "SCALED_PRESSURE": ("RAW_SENS", scaled_pressure),
    "SCALED_PRESSURE2": ("RAW_SENS", scaled_pressure2),
    "SCALED_PRESSURE3": ("RAW_SENS", scaled_pressure3),
    "SYS_STATUS": ("EXT_STAT", sys_status),
    "POWER_STATUS": ("EXT_STAT", power_status),
    "MEMINFO": ("EXT_STAT", meminfo),
    "MISSION_CURRENT": ("EXT_STAT", mission_current),
    "NAV_CONTROLLER_OUTPUT": ("EXT_STAT", nav_controller_output),
    "GPS_RAW_INT": ("EXT_STAT", gps_raw),
    "NAMED_VALUE_FLOAT": ("EXT_STAT", named_values),
    "SERVO_OUTPUT_RAW": ("RC_CHAN", servo_output),
    "RC_CHANNELS": ("RC_CHAN", rc_channels),
    "GLOBAL_POSITION_INT": ("POSITION", global_position),
    "LOCAL_POSITION_NED": ("POSITION", local_position),
    "ATTITUDE": ("EXTRA1", attitude),
    "AHRS2": ("EXTRA1", ahrs2),
    "VFR_HUD": ("EXTRA2", vfr_hud),
    "AHRS": ("EXTRA3", ahrs),
    "SYSTEM_TIME": ("EXTRA3", system_time),
    "BATTERY_STATUS": ("EXTRA3", battery_status),
    "EKF_STATUS_REPORT": ("EXTRA3", ekf_status),
    "VIBRATION": ("EXTRA3", vibration),
    "HOME_POSITION": (None, home_position),
    "GPS_GLOBAL_ORIGIN": (None, global_origin),
    "EXTENDED_SYS_STATE": (None, extended_sys_state),
    "AUTOPILOT_VERSION": (None, autopilot_version),
    "ATTITUDE_QUATERNION": (None, attitude_quaternion),
}
STREAM_IDS = {1: "RAW_SENS", 2: "EXT_STAT", 3: "RC_CHAN", 6: "POSITION", 10: "EXTRA1", 11: "EXTRA2", 12: "EXTRA3"}


def _imu(at: Sample) -> list[int]:
    """Acceleration [mG], rates [mrad/s], field [mGauss], each of x, y, z."""
    return [
        *(within(a * 1e3 / STANDARD_GRAVITY, INT16) for a in at.specific_force),
        *(within(rate * 1e3, INT16) for rate in at.nu[3:]),
        *(within(b, INT16) for b in at.field),
    ]


def _origin(autopilot: Autopilot) -> tuple[int, int]:
    return round(autopilot.origin[0] * EARTH), round(autopilot.origin[1] * EARTH)


def _centidegrees(degrees: float) -> int:
    return round(degrees * 100) % 36000


def wrapped_degrees(degrees: float) -> float:
    return math.degrees(wrapped(math.radians(degrees)))


def _quaternion(phi: float, theta: float, psi: float) -> tuple[float, float, float, float]:
    """w, x, y, z of zyx Euler angles."""
    c1, s1, c2, s2, c3, s3 = (f(angle / 2) for angle in (phi, theta, psi) for f in (math.cos, math.sin))
    return (
        c1 * c2 * c3 + s1 * s2 * s3,
        s1 * c2 * c3 - c1 * s2 * s3,
        c1 * s2 * c3 + s1 * c2 * s3,
        c1 * c2 * s3 - s1 * s2 * c3,
    )
