"""The messages that a vehicle sends about itself, made from a sample: units, signs and ranges are ArduSub's.

A value that is not simulated is marked as unknown where MAVLink has a value for that (a battery's current: -1);
otherwise it is constant.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from ..vehicle.autopilot import BANNER, HASH, VERSION, Autopilot
from ..vehicle.control import ALWAYS_SHOWN
from ..vehicle.frame import REST
from ..vehicle.modes import MOTIONS, FlightMode
from ..vehicle.sample import E7, Sample, within, wrapped
from .dialect import Message, mavlink

INT16, INT32, UINT32 = 32767, 2147483647, 0xFFFFFFFF  # the largest of each
NOTHING = 65535  # in an uint16: unused, or unknown
UNKNOWN = -1  # in an int: unknown
UNKNOWN_RSSI = 255
MAVLINK_VERSION = 3  # of HEARTBEAT
SURFACE_PRESSURE = 1013.25  # hPa
HPA_PER_METRE = 1025 * 9.80665 / 100  # of sea water, 1025 kg/m3
STANDARD_GRAVITY = 9.80665  # m/s2, of the unit mG
WATER, HULL = 1000, 2500  # cdegC
SUPPLY = 16_000  # mV; the thesis runs its T200 at 16 V
BOARD_SUPPLY = 5000  # mV
FREE_MEMORY = 1 << 20  # bytes
GPS_ERROR = 100  # cm, horizontal and vertical
SATELLITES = 10

SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_GPS
    | mavlink.MAV_SYS_STATUS_SENSOR_ANGULAR_RATE_CONTROL
    | mavlink.MAV_SYS_STATUS_SENSOR_ATTITUDE_STABILIZATION
    | mavlink.MAV_SYS_STATUS_SENSOR_YAW_POSITION
    | mavlink.MAV_SYS_STATUS_SENSOR_Z_ALTITUDE_CONTROL
    | mavlink.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL
    | mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
    | mavlink.MAV_SYS_STATUS_AHRS
    | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
    | mavlink.MAV_SYS_STATUS_PREARM_CHECK
)
CONTROLLERS = {
    "surge": mavlink.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL,
    "heave": mavlink.MAV_SYS_STATUS_SENSOR_Z_ALTITUDE_CONTROL,
    "roll": mavlink.MAV_SYS_STATUS_SENSOR_ANGULAR_RATE_CONTROL | mavlink.MAV_SYS_STATUS_SENSOR_ATTITUDE_STABILIZATION,
    "yaw": mavlink.MAV_SYS_STATUS_SENSOR_YAW_POSITION,
}
EKF_FLAGS = (
    mavlink.EKF_ATTITUDE
    | mavlink.EKF_VELOCITY_HORIZ
    | mavlink.EKF_VELOCITY_VERT
    | mavlink.EKF_POS_HORIZ_REL
    | mavlink.EKF_POS_HORIZ_ABS
    | mavlink.EKF_POS_VERT_ABS
    | mavlink.EKF_PRED_POS_HORIZ_REL
    | mavlink.EKF_PRED_POS_HORIZ_ABS
)
CAPABILITIES = (  # without fence and rally points, which stations would ask for
    mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FLOAT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_FTP
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
)
STEERED_CAPABILITIES = (  # of a vehicle that a component lets be steered
    mavlink.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
)
MODE_FLAGS = (  # of ArduSub in every mode
    mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
    | mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
)
# The modes with MAV_MODE_FLAG_GUIDED_ENABLED, as in ArduSub's base_mode().
GUIDED_MODES = (FlightMode.AUTO, FlightMode.GUIDED, FlightMode.CIRCLE, FlightMode.POSHOLD)

Maker = Callable[[Autopilot, Sample, float], Sequence[Message]]  # of messages; the float is Unix time [s]


def heartbeat(autopilot: Autopilot) -> Message:
    flags = MODE_FLAGS
    if autopilot.armed:
        flags |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    if autopilot.mode in GUIDED_MODES:
        flags |= mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
    return mavlink.MAVLink_heartbeat_message(
        type=mavlink.MAV_TYPE_SUBMARINE,
        autopilot=mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
        base_mode=flags,
        custom_mode=autopilot.mode,
        system_status=mavlink.MAV_STATE_ACTIVE if autopilot.armed else mavlink.MAV_STATE_STANDBY,
        mavlink_version=MAVLINK_VERSION,
    )


def banner() -> list[Message]:
    return [statustext(text) for text in BANNER]


def statustext(text: str, severity: int = mavlink.MAV_SEVERITY_INFO) -> Message:
    return mavlink.MAVLink_statustext_message(
        severity=severity,
        text=text.encode("ascii", "replace")[:50],  # the field is 50 characters long
    )


def attitude(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    roll, pitch, yaw = map(wrapped, at.eta[3:])
    return [
        mavlink.MAVLink_attitude_message(
            time_boot_ms=at.milliseconds, roll=roll, pitch=pitch, yaw=yaw, **_body_rates(at)
        )
    ]


def attitude_quaternion(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    w, x, y, z = _quaternion(*map(float, at.eta[3:]))
    return [
        mavlink.MAVLink_attitude_quaternion_message(
            time_boot_ms=at.milliseconds, q1=w, q2=x, q3=y, q4=z, **_body_rates(at)
        )
    ]


def ahrs2(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    roll, pitch, yaw = map(wrapped, at.eta[3:])
    lat, lng = at.place
    return [mavlink.MAVLink_ahrs2_message(roll=roll, pitch=pitch, yaw=yaw, altitude=-at.depth, lat=lat, lng=lng)]


def ahrs(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    """The errors of an estimator that knows everything."""
    return [
        mavlink.MAVLink_ahrs_message(
            omegaIx=0.0, omegaIy=0.0, omegaIz=0.0, accel_weight=0.0, renorm_val=0.0, error_rp=0.0, error_yaw=0.0
        )
    ]


def vfr_hud(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    """The throttle is the mean command of the thrusters [%]."""
    throttle = round(100 * float(np.mean(np.abs(np.clip(at.u, -1, 1))))) if len(at.u) else 0
    return [
        mavlink.MAVLink_vfr_hud_message(
            airspeed=float(np.linalg.norm(at.nu[:3])),
            groundspeed=math.hypot(*at.velocity[:2]),
            heading=int(at.heading),
            throttle=throttle,
            alt=-at.depth,
            climb=-float(at.velocity[2]),
        )
    ]


def local_position(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    x, y, z = map(float, at.eta[:3])
    vx, vy, vz = map(float, at.velocity)
    return [
        mavlink.MAVLink_local_position_ned_message(time_boot_ms=at.milliseconds, x=x, y=y, z=z, vx=vx, vy=vy, vz=vz)
    ]


def global_position(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    lat, lon = at.place
    vx, vy, vz = (within(100 * v, INT16) for v in at.velocity)
    return [
        mavlink.MAVLink_global_position_int_message(
            time_boot_ms=at.milliseconds,
            lat=lat,
            lon=lon,
            alt=_altitude(at),
            relative_alt=_altitude(at),
            vx=vx,
            vy=vy,
            vz=vz,
            hdg=_centidegrees(at.heading),
        )
    ]


def gps_raw(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    north, east = map(float, at.velocity[:2])
    lat, lon = at.place
    return [
        mavlink.MAVLink_gps_raw_int_message(
            time_usec=at.microseconds,
            fix_type=mavlink.GPS_FIX_TYPE_3D_FIX,
            lat=lat,
            lon=lon,
            alt=_altitude(at),
            eph=GPS_ERROR,
            epv=GPS_ERROR,
            vel=min(NOTHING - 1, round(100 * math.hypot(north, east))),
            cog=_centidegrees(math.degrees(math.atan2(east, north)) % 360),
            satellites_visible=SATELLITES,
        )
    ]


def raw_imu(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    return [mavlink.MAVLink_raw_imu_message(time_usec=at.microseconds, **_imu(at), id=0, temperature=HULL)]


def scaled_imu2(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    return [mavlink.MAVLink_scaled_imu2_message(time_boot_ms=at.milliseconds, **_imu(at), temperature=HULL)]


def scaled_pressure(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    """The barometer inside the hull."""
    return [
        mavlink.MAVLink_scaled_pressure_message(
            time_boot_ms=at.milliseconds, press_abs=SURFACE_PRESSURE, press_diff=0.0, temperature=HULL
        )
    ]


def scaled_pressure2(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    """The depth sensor; above the surface it measures air."""
    return [
        mavlink.MAVLink_scaled_pressure2_message(
            time_boot_ms=at.milliseconds,
            press_abs=SURFACE_PRESSURE + HPA_PER_METRE * max(0.0, at.depth),
            press_diff=0.0,
            temperature=WATER,
        )
    ]


def scaled_pressure3(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    """The thermometer in the water: stations read a temperature alone where both pressures are 0."""
    return [
        mavlink.MAVLink_scaled_pressure3_message(
            time_boot_ms=at.milliseconds, press_abs=0.0, press_diff=0.0, temperature=WATER
        )
    ]


def sys_status(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    """Enabled are the controllers of the motions that the mode holds, and the motors of an armed vehicle."""
    enabled, held = SENSORS, autopilot.control.held() if autopilot.control else MOTIONS
    for motion, controllers in CONTROLLERS.items():
        if motion not in held:
            enabled &= ~controllers
    if not autopilot.armed:
        enabled &= ~mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
    return [
        mavlink.MAVLink_sys_status_message(
            onboard_control_sensors_present=SENSORS,
            onboard_control_sensors_enabled=enabled,
            onboard_control_sensors_health=SENSORS,
            load=0,
            voltage_battery=SUPPLY,
            current_battery=UNKNOWN,
            battery_remaining=UNKNOWN,
            drop_rate_comm=0,
            errors_comm=0,
            errors_count1=0,
            errors_count2=0,
            errors_count3=0,
            errors_count4=0,
        )
    ]


def power_status(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    return [mavlink.MAVLink_power_status_message(Vcc=BOARD_SUPPLY, Vservo=0, flags=0)]


def meminfo(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    return [mavlink.MAVLink_meminfo_message(brkval=0, freemem=NOTHING, freemem32=FREE_MEMORY)]


def mission_current(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    return [mavlink.MAVLink_mission_current_message(seq=0)]


def nav_controller_output(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    """What the controller is to reach; the present heading if the experiment gives it no eta_d."""
    if np.all(np.isfinite(at.eta_d)):
        roll, pitch, yaw = (math.degrees(wrapped(float(angle))) for angle in at.eta_d[3:])
        north, east, down = map(float, at.eta_d[:3] - at.eta[:3])
        up, heading = -down, round(yaw)
    else:
        roll = pitch = north = east = up = 0.0
        heading = int(math.degrees(wrapped(math.radians(at.heading))))
    return [
        mavlink.MAVLink_nav_controller_output_message(
            nav_roll=roll,
            nav_pitch=pitch,
            nav_bearing=heading,
            target_bearing=round(math.degrees(math.atan2(east, north))),
            wp_dist=min(NOTHING, round(math.hypot(north, east))),
            alt_error=up,
            aspd_error=0.0,
            xtrack_error=0.0,
        )
    ]


def named_values(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    """What ArduSub sends by name (its send_info); only the turns of the tether and the gain are more than constants."""
    values = {
        "CamTilt": 0.5,
        "CamPan": 0.5,
        "TetherTrn": float(round(at.eta[5] / (2 * math.pi))),
        "Lights1": 0.0,
        "Lights2": 0.0,
        "PilotGain": autopilot.control.gain if autopilot.control else autopilot.parameters["JS_GAIN_DEFAULT"],
        "InputHold": 0.0,
        "RollPitch": 0.0,
        "RFTarget": 0.0,
    }
    return [
        mavlink.MAVLink_named_value_float_message(time_boot_ms=at.milliseconds, name=name.encode(), value=value)
        for name, value in values.items()
    ]


def servo_output(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    """The commands of the thrusters, in ArduSub's numbering; all unused (0) if the vehicle has no such frame."""
    frame = autopilot.frame
    motors = frame.pwm(at.u, autopilot.directions()) if frame and len(at.u) == len(frame.motors) else []
    pulses = {f"servo{n}_raw": motors[n - 1] if n <= len(motors) else 0 for n in range(1, 17)}
    return [mavlink.MAVLink_servo_output_raw_message(time_usec=at.microseconds & UINT32, port=0, **pulses)]


def rc_channels(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    idle = dict.fromkeys(range(1, ALWAYS_SHOWN + 1), REST)
    inputs = autopilot.control.channels() if autopilot.control else idle
    pulses = {f"chan{n}_raw": inputs.get(n, NOTHING) for n in range(1, 19)}
    return [
        mavlink.MAVLink_rc_channels_message(
            time_boot_ms=at.milliseconds, chancount=max(inputs), **pulses, rssi=UNKNOWN_RSSI
        )
    ]


def system_time(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    return [mavlink.MAVLink_system_time_message(time_unix_usec=round(wall * 1e6), time_boot_ms=at.milliseconds)]


def battery_status(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    return [
        mavlink.MAVLink_battery_status_message(
            id=0,
            battery_function=mavlink.MAV_BATTERY_FUNCTION_UNKNOWN,
            type=mavlink.MAV_BATTERY_TYPE_UNKNOWN,
            temperature=INT16,  # unknown
            voltages=[SUPPLY, *[NOTHING] * 9],
            current_battery=UNKNOWN,
            current_consumed=UNKNOWN,
            energy_consumed=UNKNOWN,
            battery_remaining=UNKNOWN,
            time_remaining=0,
            charge_state=mavlink.MAV_BATTERY_CHARGE_STATE_OK,
        )
    ]


def ekf_status(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    return [
        mavlink.MAVLink_ekf_status_report_message(
            flags=EKF_FLAGS,
            velocity_variance=0.0,
            pos_horiz_variance=0.0,
            pos_vert_variance=0.0,
            compass_variance=0.0,
            terrain_alt_variance=0.0,
        )
    ]


def vibration(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    return [
        mavlink.MAVLink_vibration_message(
            time_usec=at.microseconds,
            vibration_x=0.0,
            vibration_y=0.0,
            vibration_z=0.0,
            clipping_0=0,
            clipping_1=0,
            clipping_2=0,
        )
    ]


def home_position(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    """Home is NED (0, 0, 0)."""
    latitude, longitude = _origin(autopilot)
    return [
        mavlink.MAVLink_home_position_message(
            latitude=latitude,
            longitude=longitude,
            altitude=0,
            x=0.0,
            y=0.0,
            z=0.0,
            q=[1.0, 0.0, 0.0, 0.0],
            approach_x=0.0,
            approach_y=0.0,
            approach_z=0.0,
            time_usec=at.microseconds,
        )
    ]


def global_origin(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    latitude, longitude = _origin(autopilot)
    return [
        mavlink.MAVLink_gps_global_origin_message(
            latitude=latitude, longitude=longitude, altitude=0, time_usec=at.microseconds
        )
    ]


def extended_sys_state(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    landed = mavlink.MAV_LANDED_STATE_IN_AIR if autopilot.armed else mavlink.MAV_LANDED_STATE_ON_GROUND
    return [
        mavlink.MAVLink_extended_sys_state_message(vtol_state=mavlink.MAV_VTOL_STATE_UNDEFINED, landed_state=landed)
    ]


def autopilot_version(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    major, minor, patch = VERSION
    capabilities = CAPABILITIES
    if control := autopilot.control:
        capabilities |= STEERED_CAPABILITIES
        if control.stops:
            capabilities |= mavlink.MAV_PROTOCOL_CAPABILITY_FLIGHT_TERMINATION
    return [
        mavlink.MAVLink_autopilot_version_message(
            capabilities=capabilities,
            flight_sw_version=major << 24 | minor << 16 | patch << 8 | mavlink.FIRMWARE_VERSION_TYPE_OFFICIAL,
            middleware_sw_version=0,
            os_sw_version=0,
            board_version=0,
            flight_custom_version=list(HASH.encode()),
            middleware_custom_version=[0] * 8,
            os_custom_version=[0] * 8,
            vendor_id=0,
            product_id=0,
            uid=autopilot.system,
        )
    ]


def heartbeat_on_request(autopilot: Autopilot, at: Sample, wall: float) -> list[Message]:
    return [heartbeat(autopilot)]


# Every message that a station can have: its stream (None: sent only on request) and its maker, in ArduSub's order.
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
MESSAGE_NAMES: dict[int, str] = {getattr(mavlink, f"MAVLINK_MSG_ID_{name}"): name for name in STREAMED}
STREAM_NAMES = {
    mavlink.MAV_DATA_STREAM_RAW_SENSORS: "RAW_SENS",
    mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: "EXT_STAT",
    mavlink.MAV_DATA_STREAM_RC_CHANNELS: "RC_CHAN",
    mavlink.MAV_DATA_STREAM_POSITION: "POSITION",
    mavlink.MAV_DATA_STREAM_EXTRA1: "EXTRA1",
    mavlink.MAV_DATA_STREAM_EXTRA2: "EXTRA2",
    mavlink.MAV_DATA_STREAM_EXTRA3: "EXTRA3",
}


def _body_rates(at: Sample) -> dict[str, float]:
    """rad/s."""
    p, q, r = map(float, at.nu[3:])
    return {"rollspeed": p, "pitchspeed": q, "yawspeed": r}


def _imu(at: Sample) -> dict[str, int]:
    """Acceleration [mG], rates [mrad/s] and field [mGauss], each of x, y, z."""
    readings = {
        "acc": (within(a * 1e3 / STANDARD_GRAVITY, INT16) for a in at.specific_force),
        "gyro": (within(rate * 1e3, INT16) for rate in at.nu[3:]),
        "mag": (within(b, INT16) for b in at.field),
    }
    return {axis + what: value for what, values in readings.items() for axis, value in zip("xyz", values, strict=True)}


def _altitude(at: Sample) -> int:
    """mm, positive up."""
    return within(-at.depth * 1e3, INT32)


def _origin(autopilot: Autopilot) -> tuple[int, int]:
    """Latitude and longitude [1e-7 degrees]."""
    return round(autopilot.origin[0] * E7), round(autopilot.origin[1] * E7)


def _centidegrees(degrees: float) -> int:
    return round(degrees * 100) % 36000


def _quaternion(phi: float, theta: float, psi: float) -> tuple[float, float, float, float]:
    """w, x, y, z of zyx Euler angles [rad]."""
    c1, s1, c2, s2, c3, s3 = (f(angle / 2) for angle in (phi, theta, psi) for f in (math.cos, math.sin))
    return (
        c1 * c2 * c3 + s1 * s2 * s3,
        s1 * c2 * c3 - c1 * s2 * s3,
        c1 * s2 * c3 + s1 * c2 * s3,
        c1 * c2 * s3 - s1 * s2 * c3,
    )
