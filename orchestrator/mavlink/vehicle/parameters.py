"""The parameters of a vehicle: those of ArduSub that ground stations read."""

from __future__ import annotations

import fnmatch
import math
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum

from .frame import REST, SPAN


class ParameterType(IntEnum):
    """ArduPilot's `ap_var_type` (libraries/AP_Param/AP_Param.h)."""

    INT8 = 1
    INT16 = 2
    INT32 = 3
    FLOAT = 4


class ButtonFunction(IntEnum):
    """What a button of the gamepad does, BTNn_FUNCTION (libraries/AP_JSButton/AP_JSButton.h)."""

    NONE = 0
    SHIFT = 1
    ARM_TOGGLE = 2
    ARM = 3
    DISARM = 4
    MODE_MANUAL = 5
    MODE_STABILIZE = 6
    MODE_DEPTH_HOLD = 7
    MODE_POSHOLD = 8
    MOUNT_CENTER = 21
    MOUNT_TILT_UP = 22
    MOUNT_TILT_DOWN = 23
    LIGHTS1_BRIGHTER = 32
    LIGHTS1_DIMMER = 33
    GAIN_INCREASE = 42
    GAIN_DECREASE = 43
    INPUT_HOLD_SET = 48


LARGEST = {ParameterType.INT8: 127, ParameterType.INT16: 32767, ParameterType.INT32: 2147483647}
FORMATS = {ParameterType.INT8: "<b", ParameterType.INT16: "<h", ParameterType.INT32: "<i", ParameterType.FLOAT: "<f"}
PCK_MAGIC = 0x671B  # of param.pck without default values (libraries/AP_Filesystem/AP_Filesystem_Param.h)
LONGEST_NAME = 16  # characters

# What ArduSub calls itself and how it is wired is not for a ground station to change: telemetry would say otherwise.
FIXED = ("SYSID_THISMAV", "FRAME_CONFIG", *(f"SERVO{n}_FUNCTION" for n in range(1, 17)))

# Globs of those that change what the simulated vehicle does or is sent; the others are only kept.
EFFECTIVE = (
    "BTN*_FUNCTION",
    "FS_PILOT_TIMEOUT",
    "JS_GAIN_*",
    "JS_THR_GAIN",
    "MOT_?_DIRECTION",
    "RC_OVERRIDE_TIME",
    "SR0_*",
    "SURFACE_DEPTH",
    "SYSID_MYGCS",
    "WPNAV_SPEED_DN",
    "WPNAV_SPEED_UP",
)

# {type: {name: value}}; defaults of ArduSub 4.5 on a BlueROV2.
_DEFAULTS: dict[ParameterType, dict[str, float]] = {
    ParameterType.INT8: {
        "FRAME_CONFIG": 1,
        "ARMING_CHECK": 1,
        "ARMING_REQUIRE": 1,
        "AHRS_ORIENTATION": 0,
        "AHRS_EKF_TYPE": 3,
        "AHRS_GPS_USE": 1,
        "BATT_MONITOR": 3,
        "BATT_FS_LOW_ACT": 0,
        "BATT_FS_CRT_ACT": 0,
        "BATT_VOLT_PIN": 2,
        "BATT_CURR_PIN": 3,
        "BRD_TYPE": 0,
        "BRD_SAFETY_DEFLT": 0,
        "BARO_EXT_BUS": 1,
        "COMPASS_USE": 1,
        "COMPASS_USE2": 0,
        "COMPASS_USE3": 0,
        "COMPASS_AUTODEC": 0,
        "COMPASS_LEARN": 0,
        "COMPASS_ORIENT": 0,
        "COMPASS_EXTERNAL": 0,
        "COMPASS_ENABLE": 1,
        "EK3_ENABLE": 1,
        "EK3_SRC1_POSXY": 3,
        "EK3_SRC1_POSZ": 1,
        "EK3_SRC1_VELXY": 3,
        "EK3_SRC1_VELZ": 3,
        "EK3_SRC1_YAW": 1,
        "FLTMODE1": 19,
        "FLTMODE2": 0,
        "FLTMODE3": 2,
        "FLTMODE4": 16,
        "FLTMODE5": 4,
        "FLTMODE6": 19,
        "FS_GCS_ENABLE": 0,
        "FS_LEAK_ENABLE": 0,
        "FS_PILOT_INPUT": 0,
        "FS_PRESS_ENABLE": 0,
        "FS_TEMP_ENABLE": 0,
        "FS_TEMP_MAX": 62,
        "FS_EKF_ACTION": 0,
        "FS_CRASH_CHECK": 0,
        "FS_TERRAIN_ENAB": 0,
        "GPS_TYPE": 14,
        "GPS_TYPE2": 0,
        "JS_GAIN_STEPS": 4,
        "JS_LIGHTS_STEPS": 8,
        "LEAK1_PIN": -1,
        "LEAK1_LOGIC": 0,
        "LOG_BACKEND_TYPE": 0,
        "LOG_DISARMED": 0,
        "NTF_LED_BRIGHT": 3,
        "RCMAP_PITCH": 1,
        "RCMAP_ROLL": 2,
        "RCMAP_THROTTLE": 3,
        "RCMAP_YAW": 4,
        "RCMAP_FORWARD": 5,
        "RCMAP_LATERAL": 6,
        "RNGFND1_TYPE": 0,
        "SYSID_ENFORCE": 0,
        "MNT1_TYPE": 1,
        "SERIAL0_PROTOCOL": 2,
        "FENCE_ENABLE": 0,
        "FENCE_TYPE": 0,
        "FENCE_ACTION": 0,
        "RALLY_INCL_HOME": 0,
        "STAT_BOOTCNT": 1,
    },
    ParameterType.INT16: {
        "SYSID_THISMAV": 1,
        "SYSID_MYGCS": 255,
        "SCHED_LOOP_RATE": 400,
        "SERIAL0_BAUD": 115,
        "PILOT_SPEED_UP": 50,
        "PILOT_SPEED_DN": 50,
        "PILOT_ACCEL_Z": 100,
        "WPNAV_TYPE": 0,
        "TELEM_DELAY": 0,
        "CIRCLE_OPTIONS": 1,
        "SURFACE_MAX_THR": 1,
        "BARO_PROBE_EXT": 768,
        "NTF_LED_TYPES": 199,
    },
    ParameterType.INT32: {
        "BATT_CAPACITY": 15600,
        "BATT_LOW_MAH": 0,
        "BATT_CRT_MAH": 0,
        "COMPASS_DEV_ID": 97539,
        "COMPASS_DEV_ID2": 0,
        "COMPASS_DEV_ID3": 0,
        "INS_ACC_ID": 2753028,
        "INS_GYR_ID": 2752772,
        "BARO1_DEVID": 65540,
        "LOG_BITMASK": 176126,
        "STAT_RUNTIME": 0,
        "STAT_FLTTIME": 0,
        "FS_PRESS_MAX": 105000,
    },
    ParameterType.FLOAT: {
        "ACRO_RP_P": 4.5,
        "ACRO_YAW_P": 3.375,
        "ATC_ANG_RLL_P": 6.0,
        "ATC_ANG_PIT_P": 6.0,
        "ATC_ANG_YAW_P": 6.0,
        "ATC_RAT_RLL_P": 0.135,
        "ATC_RAT_RLL_I": 0.09,
        "ATC_RAT_RLL_D": 0.0036,
        "ATC_RAT_PIT_P": 0.135,
        "ATC_RAT_PIT_I": 0.09,
        "ATC_RAT_PIT_D": 0.0036,
        "ATC_RAT_YAW_P": 0.18,
        "ATC_RAT_YAW_I": 0.018,
        "ATC_RAT_YAW_D": 0.0,
        "PSC_POSXY_P": 1.0,
        "PSC_POSZ_P": 3.0,
        "PSC_VELXY_P": 1.0,
        "PSC_VELXY_I": 0.5,
        "PSC_VELXY_D": 0.0,
        "PSC_VELZ_P": 8.0,
        "PSC_ACCZ_P": 0.5,
        "PSC_ACCZ_I": 0.1,
        "PSC_ACCZ_D": 0.0,
        "AHRS_TRIM_X": 0.0,
        "AHRS_TRIM_Y": 0.0,
        "AHRS_TRIM_Z": 0.0,
        "BATT_LOW_VOLT": 0.0,
        "BATT_CRT_VOLT": 0.0,
        "BATT_LOW_TIMER": 10.0,
        "BATT_VOLT_MULT": 11.0,
        "BATT_AMP_PERVLT": 37.8788,
        "BATT_AMP_OFFSET": 0.33,
        "BARO_SPEC_GRAV": 1.024,
        "BARO_ALT_OFFSET": 0.0,
        "BARO1_GND_PRESS": 101325.0,
        "BARO2_GND_PRESS": 101325.0,
        "COMPASS_DEC": 0.0,
        "COMPASS_OFS_X": 1.0,
        "COMPASS_OFS_Y": 1.0,
        "COMPASS_OFS_Z": 1.0,
        "COMPASS_OFS2_X": 0.0,
        "COMPASS_OFS2_Y": 0.0,
        "COMPASS_OFS2_Z": 0.0,
        "COMPASS_OFS3_X": 0.0,
        "COMPASS_OFS3_Y": 0.0,
        "COMPASS_OFS3_Z": 0.0,
        "INS_ACCOFFS_X": 0.001,
        "INS_ACCOFFS_Y": 0.001,
        "INS_ACCOFFS_Z": 0.001,
        "INS_ACCSCAL_X": 1.0,
        "INS_ACCSCAL_Y": 1.0,
        "INS_ACCSCAL_Z": 1.0,
        "INS_ACC2OFFS_X": 0.0,
        "INS_ACC2OFFS_Y": 0.0,
        "INS_ACC2OFFS_Z": 0.0,
        "INS_GYROFFS_X": 0.0,
        "INS_GYROFFS_Y": 0.0,
        "INS_GYROFFS_Z": 0.0,
        "FS_PILOT_TIMEOUT": 3.0,
        "FS_GCS_TIMEOUT": 5.0,
        "FS_EKF_THRESH": 0.8,
        "JS_GAIN_DEFAULT": 0.5,
        "JS_GAIN_MIN": 0.25,
        "JS_GAIN_MAX": 1.0,
        "JS_THR_GAIN": 1.0,
        "RC_OVERRIDE_TIME": 3.0,
        "SURFACE_DEPTH": -10.0,
        "PILOT_THR_FILT": 0.0,
        "WPNAV_SPEED": 100.0,
        "WPNAV_SPEED_UP": 50.0,
        "WPNAV_SPEED_DN": 50.0,
        "WPNAV_ACCEL": 100.0,
        "WPNAV_RADIUS": 200.0,
        "CIRCLE_RADIUS": 1000.0,
        "CIRCLE_RATE": 20.0,
        "MOT_THST_EXPO": 0.65,
        "MOT_SPIN_MAX": 0.95,
        "FENCE_DEPTH_MAX": 0.0,
    },
}
# ArduSub's buttons on a gamepad, by number; the others do nothing.
_BUTTONS = {
    1: ButtonFunction.MODE_STABILIZE,
    2: ButtonFunction.MODE_POSHOLD,
    3: ButtonFunction.MODE_DEPTH_HOLD,
    4: ButtonFunction.DISARM,
    5: ButtonFunction.SHIFT,
    6: ButtonFunction.ARM,
    7: ButtonFunction.MOUNT_CENTER,
    8: ButtonFunction.INPUT_HOLD_SET,
    9: ButtonFunction.MOUNT_TILT_DOWN,
    10: ButtonFunction.MOUNT_TILT_UP,
    11: ButtonFunction.GAIN_INCREASE,
    12: ButtonFunction.GAIN_DECREASE,
    13: ButtonFunction.LIGHTS1_DIMMER,
    14: ButtonFunction.LIGHTS1_BRIGHTER,
}
_MOTOR_1 = 33  # SERVOn_FUNCTION of motor 1; those of motors 2 to 6 follow (libraries/SRV_Channel/SRV_Channel.h)
_STREAMS = ("RAW_SENS", "EXT_STAT", "RC_CHAN", "RAW_CTRL", "POSITION", "EXTRA1", "EXTRA2", "EXTRA3", "PARAMS")


@dataclass(kw_only=True)
class AutopilotParameter:
    """One parameter of ArduSub.  index: its place in the list of all."""

    name: str
    type: ParameterType
    value: float
    index: int = 0


class AutopilotParameters:
    """A vehicle's parameters, by name and by index."""

    def __init__(self, system: int, rates: Mapping[str, float], own: Mapping[str, float]):
        """rates: {stream: Hz}.  own: {name: value} of the simulation, shown beside ArduSub's."""
        parameters = {parameter.name: parameter for parameter in _ardusub(rates)}
        parameters["SYSID_THISMAV"].value = system
        for name, value in own.items():
            parameters[name] = AutopilotParameter(name=name, type=ParameterType.FLOAT, value=value)
        self._read_only = {*FIXED, *own}
        self.all = [parameters[name] for name in sorted(parameters)]
        for index, parameter in enumerate(self.all):
            parameter.index = index
        self._by_name = parameters

    def __getitem__(self, name: str) -> float:
        return self._by_name[name].value

    def __len__(self) -> int:
        return len(self.all)

    def find(self, name: str, index: int = -1) -> AutopilotParameter | None:
        """By index if that is not negative, else by name."""
        if index >= 0:
            return self.all[index] if index < len(self.all) else None
        return self._by_name.get(name)

    def set(self, name: str, value: float) -> bool:
        """Store a value as ArduPilot does, cast to the parameter's own type.  False: nothing was stored."""
        parameter = self._by_name.get(name)
        if parameter is None or name in self._read_only or not math.isfinite(value):
            return False
        if parameter.type == ParameterType.FLOAT:
            parameter.value = value
        else:
            largest = LARGEST[parameter.type]
            parameter.value = round(max(-largest - 1, min(largest, value)))
        return True

    def packed(self) -> bytes:
        """All of them as the file @PARAM/param.pck: a name is stored without the beginning that it shares with the
        name before."""
        entries, before = [], ""
        for parameter in self.all:
            name, common = parameter.name, 0
            while common < min(LONGEST_NAME - 1, len(before), len(name) - 1) and before[common] == name[common]:
                common += 1
            tail = name[common:].encode()
            value = parameter.value if parameter.type == ParameterType.FLOAT else int(parameter.value)
            lengths = common | (len(tail) - 1) << 4
            entries.append(bytes([parameter.type, lengths]) + tail + struct.pack(FORMATS[parameter.type], value))
            before = name
        return struct.pack("<HHH", PCK_MAGIC, len(entries), len(entries)) + b"".join(entries)


def has_effect(name: str) -> bool:
    """Whether a parameter changes anything."""
    return any(fnmatch.fnmatchcase(name, pattern) for pattern in EFFECTIVE)


def _ardusub(rates: Mapping[str, float]) -> Iterator[AutopilotParameter]:
    for type, values in _DEFAULTS.items():
        for name, value in values.items():
            yield AutopilotParameter(name=name, type=type, value=value)
    for stream in _STREAMS:
        yield _int16(f"SR0_{stream}", round(rates.get(stream, 0)))
    for n in range(1, 9):
        yield _int8(f"MOT_{n}_DIRECTION", 1)
    for n in range(1, 17):
        yield _int16(f"SERVO{n}_FUNCTION", _MOTOR_1 + n - 1 if n <= 6 else 0)
        yield _int16(f"SERVO{n}_MIN", REST - SPAN)
        yield _int16(f"SERVO{n}_MAX", REST + SPAN)
        yield _int16(f"SERVO{n}_TRIM", REST)
        yield _int8(f"SERVO{n}_REVERSED", 0)
    for n in range(32):
        yield _int8(f"BTN{n}_FUNCTION", _BUTTONS.get(n, ButtonFunction.NONE))
        yield _int8(f"BTN{n}_SFUNCTION", ButtonFunction.NONE)


def _int8(name: str, value: int) -> AutopilotParameter:
    return AutopilotParameter(name=name, type=ParameterType.INT8, value=value)


def _int16(name: str, value: int) -> AutopilotParameter:
    return AutopilotParameter(name=name, type=ParameterType.INT16, value=value)
