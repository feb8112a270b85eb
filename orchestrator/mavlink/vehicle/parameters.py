"""The parameters of a vehicle: those of ArduSub that ground stations read.

As ArduPilot sends them: every value as a float, whatever its type ("C-cast").
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

INT8, INT16, INT32, REAL32 = 2, 4, 6, 9  # MAV_PARAM_TYPE
RANGES = {INT8: 127, INT16: 32767, INT32: 2147483647}
PACKED = {INT8: (1, "<b"), INT16: (2, "<h"), INT32: (3, "<i"), REAL32: (4, "<f")}  # type and format in param.pck
PCK_MAGIC = 0x671B

# What ArduSub calls itself and how it is wired is not for a ground station to change: telemetry would say otherwise.
FIXED = ("SYSID_THISMAV", "FRAME_CONFIG", *(f"SERVO{n}_FUNCTION" for n in range(1, 17)))

# {name: value}; a float is REAL32, else the type below.  Defaults of ArduSub 4.5 on a BlueROV2.
_BYTES: dict[str, int] = {
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
    "BARO_PROBE_EXT": 768,
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
    "NTF_LED_TYPES": 199,
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
}
_WORDS: dict[str, int] = {
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
}
_LONGS: dict[str, int] = {
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
}
_REALS: dict[str, float] = {
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
}
# ArduSub's buttons on a gamepad: disarm, arm, modes, gain and lights.
_BUTTONS = {0: 0, 1: 6, 2: 8, 3: 7, 4: 4, 5: 1, 6: 3, 7: 21, 8: 48, 9: 23, 10: 22, 11: 42, 12: 43, 13: 33, 14: 32}
_VECTORED_SERVOS = {n: 32 + n for n in range(1, 7)}  # SERVOn_FUNCTION: motor n
ARDUPILOT_STREAMS = ("RAW_SENS", "EXT_STAT", "RC_CHAN", "RAW_CTRL", "POSITION", "EXTRA1", "EXTRA2", "EXTRA3", "PARAMS")


@dataclass
class Parameter:
    """index: in the list; type: MAV_PARAM_TYPE."""

    name: str
    type: int
    value: float
    index: int = 0


class Parameters:
    """A vehicle's parameters, by name and by index."""

    def __init__(self, system: int, rates: Mapping[str, float], own: Mapping[str, float]):
        """rates: {stream: Hz}; own: {name: value} of the simulation, shown beside ArduSub's."""
        found = {parameter.name: parameter for parameter in _ardusub(rates)}
        found["SYSID_THISMAV"].value = system
        found |= {name: Parameter(name, REAL32, value) for name, value in own.items()}
        self._read_only = {*FIXED, *own}
        self.all = [found[name] for name in sorted(found)]
        for index, parameter in enumerate(self.all):
            parameter.index = index
        self._by_name = found

    def __getitem__(self, name: str) -> float:
        return self._by_name[name].value

    def __len__(self) -> int:
        return len(self.all)

    def find(self, name: str, index: int = -1) -> Parameter | None:
        """By index where that is not negative, else by name."""
        if index >= 0:
            return self.all[index] if index < len(self.all) else None
        return self._by_name.get(name)

    def set(self, name: str, value: float) -> bool:
        """Store a value as ArduPilot does, cast to the parameter's own type.  False: it stays what it was."""
        parameter = self._by_name.get(name)
        if parameter is None or name in self._read_only or not math.isfinite(value):
            return False
        if parameter.type == REAL32:
            parameter.value = value
        else:
            limit = RANGES[parameter.type]
            parameter.value = round(max(-limit - 1, min(limit, value)))
        return True

    def packed(self) -> bytes:
        """All of them as the file @PARAM/param.pck: names share their beginnings with the one before."""
        entries, before = [], ""
        for parameter in self.all:
            kind, form = PACKED[parameter.type]
            common = 0
            while common < min(15, len(before), len(parameter.name) - 1) and before[common] == parameter.name[common]:
                common += 1
            tail = parameter.name[common:].encode()
            value = parameter.value if parameter.type == REAL32 else int(parameter.value)
            entries.append(bytes([kind, common | (len(tail) - 1) << 4]) + tail + struct.pack(form, value))
            before = parameter.name
        return struct.pack("<HHH", PCK_MAGIC, len(entries), len(entries)) + b"".join(entries)


def _ardusub(rates: Mapping[str, float]) -> Iterator[Parameter]:
    yield from _typed(INT8, _BYTES)
    yield from _typed(INT16, _WORDS)
    yield from _typed(INT32, _LONGS)
    yield from _typed(REAL32, _REALS)
    for stream in ARDUPILOT_STREAMS:
        yield Parameter(f"SR0_{stream}", INT16, round(rates.get(stream, 0)))
    for n in range(1, 9):
        yield Parameter(f"MOT_{n}_DIRECTION", INT8, 1)
    for n in range(1, 17):
        yield Parameter(f"SERVO{n}_FUNCTION", INT16, _VECTORED_SERVOS.get(n, 0))
        for name, value in (("MIN", 1100), ("MAX", 1900), ("TRIM", 1500)):
            yield Parameter(f"SERVO{n}_{name}", INT16, value)
        yield Parameter(f"SERVO{n}_REVERSED", INT8, 0)
    for n in range(32):
        yield Parameter(f"BTN{n}_FUNCTION", INT8, _BUTTONS.get(n, 0))
        yield Parameter(f"BTN{n}_SFUNCTION", INT8, 0)


def _typed(kind: int, values: Mapping[str, Any]) -> Iterator[Parameter]:
    for name, value in values.items():
        yield Parameter(name, INT16 if kind == INT8 and abs(value) > RANGES[INT8] else kind, value)
