"""Commands that a pilot believes: each is done by the vehicle, or refused with a STATUSTEXT that says why.

The run waits while a script talks to it over a socket, so that nothing here depends on how fast the machine is.  The
first part has the exchanges of the vendor's example scripts (ArduSub's documentation on pymavlink).
"""

import math
import random
import re
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.quaternion import QuaternionBase

from experiments import merged
from orchestrator.mavlink.components.manual import MavlinkManual
from orchestrator.mavlink.vehicle.frame import FACTORS
from orchestrator.mavlink.vehicle.modes import REFUSED, FlightMode
from orchestrator.mavlink.vehicle.parameters import EFFECTIVE
from peers.flood import request
from peers.pilot import fly, fly_with_pymavlink
from peers.station import to

ACCEPTED, DENIED, FAILED = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_DENIED, mavlink.MAV_RESULT_FAILED
CUSTOM = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
ARM, DISARM = 1, 0
LEAVE, RELEASE = 65535, 0
DEPTH_ALONE = 0xDFB  # type_mask: everything but z is ignored
POSITION = 0xDF8  # everything but the position
# T1 to T6 of the shipped vehicle are motors 2, 1, 4, 3, 6, 5, with the opposite sign.
SHIPPED = -FACTORS[[1, 0, 3, 2, 5, 4]]
SURGE, SWAY, HEAVE, ROLL, _, YAW = SHIPPED.T


@pytest.fixture
def piloted(spiral):
    """piloted(seconds, **parameters of the pilot): the spiral's vehicle and PID with a pilot in place of the
    reference, at (2, -1, 1) heading north."""

    def table(seconds, **parameters):
        table = merged(spiral, {"components.reference": None, "metrics": {}, "master.stop_time": seconds})
        pilot = {"builtin": "mavlink_manual", "step": 0.02, "parameters": parameters}
        table["components"] = {**table["components"], "pilot": pilot}
        table["connections"]["pilot.eta"] = "vehicle.eta"
        for name in ("eta_d", "eta_d_dot", "eta_d_ddot"):
            table["connections"][f"controller.{name}"] = f"pilot.{name}"
        return table

    return table


@pytest.fixture
def flight(piloted, resolve, tmp_path):
    """flight(script, seconds, **parameters) flies it; script(station) yields the simulated time that is to pass."""
    return lambda script, seconds, **of: fly(resolve(piloted(seconds, **of)), script, tmp_path / "run.h5")


@pytest.fixture
def vendor(piloted, resolve, tmp_path):
    """vendor(script, seconds, **parameters): likewise, script(master) with pymavlink's own connection."""
    return lambda script, seconds, **of: fly_with_pymavlink(
        resolve(piloted(seconds, **of)), script, tmp_path / "run.h5"
    )


@pytest.fixture
def clock(monkeypatch):
    """What the clock of time-outs is ahead of time [s], to be changed: clock.now."""
    clock = SimpleNamespace(now=0.0)
    shifted = SimpleNamespace(monotonic=lambda: time.monotonic() + clock.now, time=time.time, sleep=time.sleep)
    for module in ("bridge", "vehicle.control"):
        monkeypatch.setattr(f"orchestrator.mavlink.{module}.time", shifted)
    return clock


def enter(station, mode):
    return station.command(mavlink.MAV_CMD_DO_SET_MODE, CUSTOM, mode)


def override(station, others=LEAVE, **pulses):
    """RC_CHANNELS_OVERRIDE; the answer to another request shows that it has come."""
    first = {f"chan{n}_raw": others for n in range(1, 9)}
    station.send(mavlink.MAVLink_rc_channels_override_message(**to(), **first | pulses))
    return shown(station, "RC_CHANNELS")


def shown(station, kind):
    """A message on request."""
    number = getattr(mavlink, f"MAVLINK_MSG_ID_{kind}")
    assert station.command(mavlink.MAV_CMD_REQUEST_MESSAGE, number) == ACCEPTED
    return station.expect(kind)


def set_parameter(station, name, value):
    kind = mavlink.MAV_PARAM_TYPE_REAL32
    request = mavlink.MAVLink_param_set_message(**to(), param_id=name.encode(), param_value=value, param_type=kind)
    assert station.ask(request, "PARAM_VALUE", lambda m: m.param_id == name).param_value == value


def refused(station, text):
    """A STATUSTEXT that has come, or comes: a warning."""
    before = [m for m in station.messages if m.get_type() == "STATUSTEXT" and m.text == text]
    message = before[-1] if before else station.expect("STATUSTEXT", lambda m: m.text == text)
    assert message.severity == mavlink.MAV_SEVERITY_WARNING
    return True


def globally(mask, lat=0, lon=0, alt=0.0, frame=mavlink.MAV_FRAME_GLOBAL_INT, **values):
    rest = dict.fromkeys(("vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate"), 0) | values
    return mavlink.MAVLink_set_position_target_global_int_message(
        **to(), time_boot_ms=0, coordinate_frame=frame, type_mask=mask, lat_int=lat, lon_int=lon, alt=alt, **rest
    )


def locally(mask, **values):
    rest = dict.fromkeys(("x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate"), 0) | values
    return mavlink.MAVLink_set_position_target_local_ned_message(
        **to(), time_boot_ms=0, coordinate_frame=mavlink.MAV_FRAME_LOCAL_NED, type_mask=mask, **rest
    )


def attitude(roll=0.0, pitch=0.0, yaw=0.0, mask=mavlink.ATTITUDE_TARGET_TYPEMASK_THROTTLE_IGNORE, thrust=0.0):
    """Angles in degrees."""
    q = QuaternionBase([math.radians(angle) for angle in (roll, pitch, yaw)])
    rates = dict.fromkeys(("body_roll_rate", "body_pitch_rate", "body_yaw_rate"), 0)
    return mavlink.MAVLink_set_attitude_target_message(
        **to(), time_boot_ms=0, type_mask=mask, q=list(q), thrust=thrust, **rates
    )


# --- The vendor's scripts -------------------------------------------------------------------------------------------


def test_script_that_arms_and_disarms(vendor):
    def script(master):
        master.wait_heartbeat(timeout=5)
        assert not master.motors_armed()
        for wanted in (ARM, DISARM):
            arming = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
            master.mav.command_long_send(
                master.target_system, master.target_component, arming, 0, wanted, 0, 0, 0, 0, 0, 0
            )
            assert master.recv_match(type="COMMAND_ACK", blocking=True, timeout=5).result == ACCEPTED
            (master.motors_armed_wait if wanted else master.motors_disarmed_wait)()
            master.mav.rc_channels_override_send(
                master.target_system, master.target_component, *[1600 if n == 5 else LEAVE for n in range(1, 19)]
            )
            yield 1.0

    flown = vendor(script, 2.1, start_disarmed=1)
    assert flown.thrusters(0.9) == pytest.approx(0.25 * SURGE)
    assert flown.thrusters(1.9) == [0] * 6
    assert list(flown["pilot/armed"][[0, 50, -1]]) == [0, 1, 0]


@pytest.mark.parametrize(("mode", "result"), [("STABILIZE", ACCEPTED), ("AUTO", FAILED)])
def test_script_that_changes_the_flight_mode(vendor, mode, result):
    def script(master):
        master.wait_heartbeat(timeout=5)
        number = master.mode_mapping()[mode]
        master.mav.set_mode_send(master.target_system, CUSTOM, number)
        while (ack := master.recv_match(type="COMMAND_ACK", blocking=True, timeout=5)).command != 11:  # SET_MODE's id
            pass
        assert ack.result == result
        yield 0.1

    flown = vendor(script, 0.2)
    expected = FlightMode.STABILIZE if result == ACCEPTED else FlightMode.POSHOLD
    assert flown["pilot/mode"][-1] == expected


def test_script_that_overrides_channels_rolls_and_turns_the_vehicle_and_learns_what_moves_nothing(vendor):
    def script(master):
        master.wait_heartbeat(timeout=5)

        def set_channel(n, pulse):
            values = [pulse if m == n else LEAVE for m in range(1, 19)]
            master.mav.rc_channels_override_send(master.target_system, master.target_component, *values)

        set_channel(2, 1600)
        set_channel(4, 1600)
        for n, pulse in ((8, 1900), (12, 1600)):
            set_channel(n, pulse)
            while (
                master.recv_match(type="STATUSTEXT", blocking=True, timeout=5).text != f"Channel {n} moves nothing here"
            ):
                pass
        yield 1.0

    flown = vendor(script, 1.1)
    assert flown.at(1.0, "vehicle/eta.phi") > 0.03
    assert flown.at(1.0, "vehicle/eta.psi") > 0.05


def test_script_that_sends_manual_control(vendor):
    def script(master):
        master.wait_heartbeat(timeout=5)
        master.mav.manual_control_send(master.target_system, 500, -500, 250, 500, 0)
        yield 1.0
        master.mav.manual_control_send(master.target_system, 0, 0, 500, 0, 1 << 3)  # BTN3: depth hold
        while master.recv_match(type="STATUSTEXT", blocking=True, timeout=5).text != "Mode ALT_HOLD":
            pass
        master.mav.manual_control_send(master.target_system, 0, 0, 500, 0, 1 << 7)  # BTN7: camera
        while master.recv_match(type="STATUSTEXT", blocking=True, timeout=5).text != "Button 7 does nothing here":
            pass
        yield 0.2

    flown = vendor(script, 1.3)
    u, v, w, r = (flown.at(1.0, f"pilot/nu_d.{axis}") for axis in "uvwr")
    assert (u, v, w, r) > (0.1, -1, 0.05, 0.1)
    assert v < -0.1
    x, y, z, psi = (flown.at(1.0, f"vehicle/eta.{axis}") for axis in ("x", "y", "z", "psi"))
    assert (x > 2.05, y < -1.05, z > 1.01, psi > 0.05) == (True,) * 4
    assert flown["pilot/mode"][-1] == FlightMode.ALT_HOLD


def test_script_that_sets_depth_and_attitude_in_depth_hold(vendor):
    headings = {}

    def script(master):
        master.wait_heartbeat(timeout=5)
        master.arducopter_arm()
        master.motors_armed_wait()
        depth_hold = master.mode_mapping()["ALT_HOLD"]
        master.set_mode("ALT_HOLD")
        while master.wait_heartbeat(timeout=5).custom_mode != depth_hold:
            master.set_mode("ALT_HOLD")
        frame, zero = mavlink.MAV_FRAME_GLOBAL_INT, [0] * 8
        who = master.target_system, master.target_component
        # As in one version of the script, whose mask is 0xdfe: it ignores z, and the vehicle says so.
        master.mav.set_position_target_global_int_send(0, *who, frame, 0xDFE, 0, 0, -0.5, *zero)
        while not master.recv_match(type="STATUSTEXT", blocking=True, timeout=5).text.startswith(
            "Depth target ignored"
        ):
            pass
        master.mav.set_position_target_global_int_send(0, *who, frame, DEPTH_ALONE, 0, 0, -0.5, *zero)
        t = 0.0
        for yaw in [*range(0, 60, 10), *range(60, -30, -30)]:
            q = QuaternionBase([0, 0, math.radians(yaw)])
            master.mav.set_attitude_target_send(0, *who, 1 << 6, q, 0, 0, 0, 0)
            yield 5.0
            t += 5.0
            headings[t] = yaw
        master.arducopter_disarm()
        master.motors_disarmed_wait()
        yield 0.1

    flown = vendor(script, 45.2, start_disarmed=1)
    for t, yaw in headings.items():
        assert math.degrees(flown.at(t, "pilot/eta_d.psi")) == pytest.approx(yaw, abs=2), t
        assert math.degrees(flown.at(t, "vehicle/eta.psi")) == pytest.approx(yaw, abs=4), t
    assert flown.at(44.9, "vehicle/eta.z") == pytest.approx(0.5, abs=0.05)
    assert flown.thrusters(45.2) == [0] * 6


# --- Overrides ------------------------------------------------------------------------------------------------------


def test_channels_are_overridden_released_and_left_alone_each_by_its_own_value(flight):
    def script(station):
        assert override(station, chan5_raw=1700, chan3_raw=1300, chan9_raw=1600, chan10_raw=1700).chan5_raw == 1700
        yield 0.5
        rc = override(station, chan5_raw=LEAVE, chan3_raw=RELEASE, chan9_raw=0, chan10_raw=65535)
        assert (rc.chan5_raw, rc.chan3_raw, rc.chan9_raw, rc.chan10_raw) == (1700, 1500, 1600, 1700)
        rc = override(station, chan9_raw=65534, chan10_raw=0)
        assert (rc.chan9_raw, rc.chan10_raw, rc.chancount) == (65535, 1700, 10)
        yield 0.5
        assert override(station, others=RELEASE, chan10_raw=65534).chancount == 8  # "rc all 0": the pilot lets go
        yield 2.0

    flown = flight(script, 3.1)
    assert flown.at(0.4, "pilot/stick.surge") == flown.at(0.9, "pilot/stick.surge") == 0.5
    assert flown.at(0.4, "pilot/stick.heave") == 0.5
    assert flown.at(0.9, "pilot/stick.heave") == 0
    assert flown.at(1.1, "pilot/stick.surge") == 0
    assert abs(flown.at(3.0, "pilot/nu_d.u")) < 0.02


def test_each_channel_times_out_by_itself(flight, clock):
    def script(station):
        override(station, chan5_raw=1700, chan6_raw=1700)
        clock.now += 2.0
        rc = override(station, chan6_raw=1600)
        assert (rc.chan5_raw, rc.chan6_raw) == (1700, 1600)
        clock.now += 1.5  # channel 5 is 3.5 s old, channel 6 1.5 s
        rc = shown(station, "RC_CHANNELS")
        assert (rc.chan5_raw, rc.chan6_raw) == (1500, 1600)
        yield 0.1
        clock.now += 2.0
        assert shown(station, "RC_CHANNELS").chan6_raw == 1500
        set_parameter(station, "RC_OVERRIDE_TIME", 0.5)
        override(station, chan5_raw=1700)
        clock.now += 0.6
        assert shown(station, "RC_CHANNELS").chan5_raw == 1500
        set_parameter(station, "RC_OVERRIDE_TIME", -1)  # never
        override(station, chan5_raw=1700)
        clock.now += 20
        assert shown(station, "RC_CHANNELS").chan5_raw == 1700
        set_parameter(station, "RC_OVERRIDE_TIME", 0)  # no overrides
        assert shown(station, "RC_CHANNELS").chan5_raw == 1500
        yield 0.1

    flown = flight(script, 0.3)
    assert flown.at(0.1, "pilot/stick.sway") == 0.25
    assert flown["pilot/stick.surge"].max() == 0


def test_a_joystick_that_falls_silent_is_neutral_while_an_override_lasts(flight, clock):
    def script(station):
        set_parameter(station, "RC_OVERRIDE_TIME", -1)
        override(station, chan6_raw=1700)
        station.send(mavlink.MAVLink_manual_control_message(target=1, x=1000, y=0, z=500, r=0, buttons=0))
        assert shown(station, "RC_CHANNELS").chan5_raw == 1700
        override(station, chan6_raw=1600)
        clock.now += 3.5  # FS_PILOT_TIMEOUT is 3 s
        rc = shown(station, "RC_CHANNELS")
        assert (rc.chan5_raw, rc.chan6_raw) == (1500, 1600)
        yield 0.1

    flight(script, 0.2)


def test_sticks_that_move_in_guided_are_said_not_to_count(flight):
    def script(station):
        assert enter(station, FlightMode.GUIDED) == ACCEPTED
        assert override(station, chan5_raw=1700).chan5_raw == 1700
        assert refused(station, "Sticks do not count in mode GUIDED")
        yield 1.0

    assert np.ptp(flight(script, 1.1)["pilot/eta_d.x"]) == 0


def test_a_station_that_does_not_steer_learns_why_its_sticks_do_nothing(flight):
    def script(station):
        station.mav.srcSystem = 200
        assert override(station, chan5_raw=1700).chan5_raw == 1500
        assert refused(station, "Sticks of system 200 ignored: SYSID_MYGCS is 255")
        set_parameter(station, "SYSID_MYGCS", 200)
        assert override(station, chan5_raw=1700).chan5_raw == 1700
        yield 0.1

    flight(script, 0.2)


# --- Modes ----------------------------------------------------------------------------------------------------------


def test_sticks_drive_the_thrusters_where_the_mode_holds_nothing_and_the_reference_elsewhere(flight):
    modes = (FlightMode.MANUAL, FlightMode.STABILIZE, FlightMode.ALT_HOLD, FlightMode.POSHOLD)

    def script(station):
        for mode in modes:
            assert enter(station, mode) == ACCEPTED
            beat = station.expect("HEARTBEAT", lambda m, mode=mode: m.custom_mode == mode)
            guided = bool(beat.base_mode & mavlink.MAV_MODE_FLAG_GUIDED_ENABLED)
            assert guided == (mode == FlightMode.POSHOLD)
            override(station, chan2_raw=1540, chan3_raw=1580, chan4_raw=1420, chan5_raw=1620, chan6_raw=1460)
            yield 0.5

    flown = flight(script, 2.1)
    sticks = {"surge": 0.3, "sway": -0.1, "heave": -0.2, "roll": 0.1, "yaw": -0.2}
    columns = {"surge": SURGE, "sway": SWAY, "heave": HEAVE, "roll": ROLL, "yaw": YAW}
    shares = np.linalg.pinv(np.column_stack(list(columns.values())))
    direct = {
        FlightMode.MANUAL: {"surge", "sway", "heave", "roll", "yaw"},
        FlightMode.STABILIZE: {"surge", "sway", "heave"},
        FlightMode.ALT_HOLD: {"surge", "sway"},
        FlightMode.POSHOLD: set(),
    }
    for number, mode in enumerate(modes):
        t = 0.5 * number + 0.45
        assert flown.at(t, "pilot/mode") == mode
        demand = dict(zip(columns, shares @ flown.thrusters(t), strict=True))
        passed = {name for name in columns if demand[name] == pytest.approx(sticks[name], abs=1e-9)}
        assert passed == direct[mode]
    assert flown.thrusters(0.45) == pytest.approx(sum(sticks[name] * columns[name] for name in columns))
    poshold = [flown.at(1.95, f"allocation/u.T{n}") for n in range(1, 7)]
    assert flown.thrusters(1.95) == poshold  # to the bit: nothing is mixed


@pytest.mark.parametrize(("algorithm", "delay"), [("gauss-seidel", 0), ("jacobi", 1)])
def test_commands_that_are_passed_on_are_the_controllers_own(piloted, resolve, tmp_path, algorithm, delay):
    """To the bit, in the same step where components step one after the other, and in the next one under Jacobi."""
    table = merged(piloted(0.5), {"master.algorithm": algorithm, "record.every": 0.001})

    def script(station):
        override(station, chan5_raw=1700)
        yield 0.4

    flown = fly(resolve(table), script, tmp_path / "run.h5")
    for n in range(1, 7):
        asked, given = flown[f"allocation/u.T{n}"], flown[f"pilot_motors/u.T{n}"]
        assert np.array_equal(given[delay + 1 :], asked[1 : len(asked) - delay])
    assert np.ptp(flown["pilot_motors/u.T1"]) > 0.01


def test_only_poshold_holds_against_a_current_and_only_manual_and_stabilize_lose_the_depth(piloted, resolve, tmp_path):
    """The vehicle floats up and is carried north by 0.3 m/s, the sticks neutral."""
    lost = {}
    for mode in (FlightMode.MANUAL, FlightMode.STABILIZE, FlightMode.ALT_HOLD, FlightMode.POSHOLD):

        def script(station, mode=mode):
            assert enter(station, mode) == ACCEPTED
            override(station, chan4_raw=1700)
            yield 0.5
            override(station, others=RELEASE)
            yield 9.0

        table = merged(piloted(9.6), {"components.current.parameters": {"velocity": [0.3, 0, 0]}})
        flown = fly(resolve(table), script, tmp_path / f"{mode.name}.h5")
        turned = flown.at(9.5, "vehicle/eta.psi") - flown.at(9.5, "pilot/eta_d.psi")
        held = np.abs([flown.at(9.5, f"pilot_motors/u.T{n}") for n in range(1, 7)]).max() > 0
        north, depth = (flown.at(9.5, f"vehicle/eta.{axis}") - start for axis, start in (("x", 2), ("z", 1)))
        lost[mode] = (abs(north) > 1, abs(depth) > 0.3, held)
        assert abs(turned) < 0.03
    assert lost == {
        FlightMode.MANUAL: (True, True, False),
        FlightMode.STABILIZE: (True, True, True),
        FlightMode.ALT_HOLD: (True, False, True),
        FlightMode.POSHOLD: (False, False, True),
    }


def test_modes_that_are_not_simulated_are_refused_and_the_mode_stays(flight):
    def script(station):
        for mode, reason in REFUSED.items():
            assert enter(station, mode) == FAILED
            assert refused(station, f"{mode.name} refused: {reason}")
        assert station.command(mavlink.MAV_CMD_DO_SET_MODE, 0, FlightMode.MANUAL) == FAILED
        assert refused(station, "Mode refused: its flag for custom modes is missing")
        assert enter(station, 5) == FAILED
        assert refused(station, "Mode 5 refused: no such mode")
        assert shown(station, "HEARTBEAT").custom_mode == FlightMode.POSHOLD
        yield 0.1

    flight(script, 0.2)
    assert {mode.name for mode in REFUSED} == {"ACRO", "AUTO", "CIRCLE", "MOTOR_DETECT", "SURFTRAK"}


@pytest.mark.parametrize("command", ["NAV_LAND", "DO_SET_MODE"])
def test_surface_rises_and_stays_there(flight, command):
    def script(station):
        yield 0.1
        if command == "NAV_LAND":
            assert station.command(mavlink.MAV_CMD_NAV_LAND) == ACCEPTED
        else:
            assert enter(station, FlightMode.SURFACE) == ACCEPTED
        assert shown(station, "HEARTBEAT").custom_mode == FlightMode.SURFACE
        override(station, chan3_raw=1100, chan5_raw=1600)  # down, which does not count here, and ahead, which does
        yield 1.0
        override(station, others=RELEASE)
        yield 11.0

    flown = flight(script, 12.2)
    assert flown.at(12.1, "vehicle/eta.z") == pytest.approx(0.1, abs=0.03)  # SURFACE_DEPTH
    assert flown["vehicle/eta.z"].min() > 0
    assert flown.at(1.0, "vehicle/eta.x") > 2.1


def test_loiter_holds_the_position(flight):
    def script(station):
        assert enter(station, FlightMode.MANUAL) == ACCEPTED
        override(station, chan5_raw=1800)
        yield 2.0
        override(station, others=RELEASE)
        assert station.command(mavlink.MAV_CMD_NAV_LOITER_UNLIM) == ACCEPTED
        assert shown(station, "HEARTBEAT").custom_mode == FlightMode.POSHOLD
        yield 10.0

    flown = flight(script, 12.1)
    here = flown.at(2.0, "vehicle/eta.xy")
    assert here[0] > 3
    assert flown.at(12.0, "vehicle/eta.xy") == pytest.approx(here, abs=0.15)


# --- Set points -----------------------------------------------------------------------------------------------------


def test_a_global_set_point_leads_in_guided_and_in_depth_hold_only_down(flight):
    metres = 111319.49079327358

    def script(station):
        point = {"lat": round((44.65 + 3.0 / metres) * 1e7), "lon": round(-124.05 * 1e7), "alt": -1.5}
        station.send(globally(POSITION, **point))
        assert refused(station, "Set point ignored in mode POSHOLD")
        assert enter(station, FlightMode.GUIDED) == ACCEPTED
        station.send(globally(POSITION, **point, frame=mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT))
        assert refused(station, "Set point ignored: unknown coordinate frame")
        station.send(globally(POSITION, **point, frame=mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT))
        yield 14.0
        assert enter(station, FlightMode.ALT_HOLD) == ACCEPTED
        station.send(globally(DEPTH_ALONE, alt=-2.0))
        yield 10.0

    flown = flight(script, 24.1)
    assert flown.at(13.9, "vehicle/eta.xyz") == pytest.approx([3.0, 0.0, 1.5], abs=0.1)
    assert flown.at(24.0, "vehicle/eta.z") == pytest.approx(2.0, abs=0.05)


def test_a_stick_ends_the_depth_target_of_its_motion(flight):
    def script(station):
        assert enter(station, FlightMode.ALT_HOLD) == ACCEPTED
        station.send(globally(DEPTH_ALONE, alt=-2.0))
        yield 1.0
        override(station, chan3_raw=1600)
        yield 0.5
        override(station, others=RELEASE)
        yield 5.0

    flown = flight(script, 6.6)
    assert flown.at(1.0, "pilot/nu_d.w") > 0.1
    assert flown.at(6.5, "pilot/eta_d.z") < 1.5
    assert abs(flown.at(6.5, "pilot/nu_d.w")) < 1e-3


@pytest.mark.parametrize("mode", [FlightMode.ALT_HOLD, FlightMode.STABILIZE, FlightMode.GUIDED])
def test_an_attitude_target_turns_and_leans_the_vehicle(flight, mode):
    def script(station):
        station.send(attitude(yaw=40))
        assert refused(station, "Attitude ignored in mode POSHOLD")
        assert enter(station, mode) == ACCEPTED
        station.send(attitude(roll=10, yaw=40))
        yield 6.0
        station.send(attitude(pitch=20, yaw=40))
        assert refused(station, "Attitude target: pitch stays level")
        station.send(attitude(mask=mavlink.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE))
        assert refused(station, "Attitude target ignored: rates alone")
        yield 0.1

    flown = flight(script, 6.2)
    assert math.degrees(flown.at(6.0, "vehicle/eta.psi")) == pytest.approx(40, abs=4)
    assert math.degrees(flown.at(6.0, "vehicle/eta.phi")) == pytest.approx(10, abs=3)


def test_thrust_climbs_in_guided_for_three_seconds_and_is_refused_in_stabilize(flight, clock):
    def script(station):
        assert enter(station, FlightMode.STABILIZE) == ACCEPTED
        station.send(attitude(mask=0, thrust=0.2))
        assert refused(station, "Thrust ignored in mode STABILIZE")
        assert enter(station, FlightMode.GUIDED) == ACCEPTED
        station.send(attitude(mask=0, thrust=0.2))  # 0.6 of WPNAV_SPEED_DN, 50 cm/s
        shown(station, "RC_CHANNELS")
        yield 2.5
        clock.now += 3.1  # nobody has sent anything since
        yield 4.0

    flown = flight(script, 6.6)
    assert flown.at(2.4, "pilot/nu_d.w") == pytest.approx(0.3, abs=0.01)
    assert abs(flown.at(6.5, "pilot/nu_d.w")) < 0.01


def test_a_velocity_set_point_that_is_not_repeated_ends(flight, clock):
    """ArduSub's guided mode stops after 3 s: a script that has died leaves no vehicle driving."""
    velocity_alone = 0xDC7

    def script(station):
        assert enter(station, FlightMode.GUIDED) == ACCEPTED
        station.send(locally(velocity_alone, vx=0.4))
        shown(station, "RC_CHANNELS")
        yield 2.5
        clock.now += 3.1
        yield 4.0

    flown = flight(script, 6.6)
    assert flown.at(2.4, "pilot/nu_d.u") == pytest.approx(0.4, abs=0.01)
    assert abs(flown.at(6.5, "pilot/nu_d.u")) < 0.01


def test_a_set_point_that_asks_for_nothing_is_refused(flight):
    def script(station):
        station.send(locally(POSITION))
        assert refused(station, "Set point ignored in mode POSHOLD")
        assert enter(station, FlightMode.GUIDED) == ACCEPTED
        for mask, text in ((0xFFF, "its type_mask leaves nothing"), (0xC3F, "accelerations alone")):
            station.send(locally(mask))
            assert refused(station, f"Set point ignored: {text}")
        station.send(locally(POSITION, x=1e30))
        assert refused(station, "Set point ignored: its values make no sense")
        yield 0.1

    flown = flight(script, 0.2)
    assert np.ptp(flown["pilot/eta_d.x"]) == 0


def test_a_heading_is_taken_as_asked_for_and_at_the_speed_asked_for(flight):
    yaw = mavlink.MAV_CMD_CONDITION_YAW

    def script(station):
        assert station.command(yaw, 90, 10, 1, 0) == ACCEPTED  # 10 degrees/s
        yield 4.0
        assert station.command(yaw, 30, 0, -1, 1) == ACCEPTED  # 30 degrees to port from here
        yield 8.0
        assert station.command(yaw, 400, 0, 1, 0) == station.command(yaw, 90, 0, 1, 7) == DENIED
        assert station.command(yaw, 90, 60, 1, 0) == DENIED
        assert refused(station, "Heading refused: at most 45.8 deg/s")
        assert enter(station, FlightMode.MANUAL) == ACCEPTED
        assert station.command(yaw, 90, 0, 1, 0) == FAILED
        assert refused(station, "Heading refused: MANUAL holds no heading")
        yield 0.1

    flown = flight(script, 12.2)
    assert math.degrees(np.abs(flown["pilot/eta_d_dot.psi"][:200]).max()) == pytest.approx(10, abs=0.3)
    expected = math.degrees(flown.at(4.0, "vehicle/eta.psi")) - 30
    assert math.degrees(flown.at(12.0, "vehicle/eta.psi")) == pytest.approx(expected, abs=3)


def test_the_speed_to_set_points_changes(flight):
    def script(station):
        speed = mavlink.MAV_CMD_DO_CHANGE_SPEED
        assert station.command(speed, mavlink.SPEED_TYPE_GROUNDSPEED, 0.3) == ACCEPTED
        assert station.command(speed, mavlink.SPEED_TYPE_GROUNDSPEED, -1) == DENIED
        assert station.command(speed, mavlink.SPEED_TYPE_GROUNDSPEED, 2.5) == DENIED
        assert refused(station, "Speed refused: at most 1 m/s")
        assert station.command(speed, mavlink.SPEED_TYPE_CLIMB_SPEED, 0.3) == DENIED
        assert refused(station, "Speed refused: only the horizontal speed changes")
        assert enter(station, FlightMode.GUIDED) == ACCEPTED
        station.send(locally(POSITION, x=9.0, y=-1.0, z=1.0))
        yield 6.0

    flown = flight(script, 6.1)
    assert flown["pilot/eta_d_dot.x"].max() == pytest.approx(0.3, abs=1e-3)


def test_go_to_takes_its_speed_and_refuses_a_height_above_the_ground(flight):
    def go(frame, speed):
        return mavlink.MAVLink_command_int_message(
            **to(),
            frame=frame,
            command=mavlink.MAV_CMD_DO_REPOSITION,
            current=0,
            autocontinue=0,
            param1=speed,
            param2=1,
            param3=0,
            param4=math.nan,
            x=round(44.6502 * 1e7),
            y=round(-124.05 * 1e7),
            z=-1.0,
        )

    def script(station):
        above_ground = go(mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT, 0.2)
        assert station.ask(above_ground, "COMMAND_ACK").result == DENIED
        assert refused(station, "Position refused: unknown coordinate frame")
        assert shown(station, "HEARTBEAT").custom_mode == FlightMode.POSHOLD
        assert station.ask(go(mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, 0.2), "COMMAND_ACK").result == ACCEPTED
        yield 5.0

    flown = flight(script, 5.1)
    assert flown.at(5.0, "pilot/mode") == FlightMode.GUIDED
    assert flown["pilot/eta_d_dot.x"].max() == pytest.approx(0.2, abs=0.005)


def test_the_origin_stays_and_is_the_answer_to_who_would_move_it(flight):
    def script(station):
        place = {"latitude": 10**7, "longitude": 2 * 10**7, "altitude": 0}
        request = mavlink.MAVLink_set_gps_global_origin_message(target_system=1, **place)
        answer = station.ask(request, "GPS_GLOBAL_ORIGIN")
        assert (answer.latitude, answer.longitude) == (446500000, -1240500000)
        assert refused(station, "Home stays the origin of the experiment")
        yield 0.1

    flight(script, 0.2)


def test_missions_are_refused(flight):
    def script(station):
        text = "Mission refused: no missions yet"
        for kind in ("count", "item", "item_int"):
            place = dict.fromkeys(("param1", "param2", "param3", "param4", "x", "y", "z"), 0)
            item = {"seq": 0, "frame": 0, "command": 16, "current": 2, "autocontinue": 1, **place}
            fields = {"count": 3} if kind == "count" else item
            message = getattr(mavlink, f"MAVLink_mission_{kind}_message")(**to(), **fields)
            assert station.ask(message, "MISSION_ACK").type == mavlink.MAV_MISSION_UNSUPPORTED
        assert refused(station, text)
        assert station.command(mavlink.MAV_CMD_MISSION_START) == FAILED
        assert refused(station, text)
        yield 0.1

    flight(script, 0.2)


# --- Armed means armed ----------------------------------------------------------------------------------------------


def outputs(station):
    message = shown(station, "SERVO_OUTPUT_RAW")
    return [getattr(message, f"servo{n}_raw") for n in range(1, 7)]


@pytest.mark.parametrize("command", ["COMPONENT_ARM_DISARM", "DO_FLIGHTTERMINATION", "button"])
def test_the_thrusters_of_a_disarmed_vehicle_rest_and_an_armed_one_holds_where_it_is_then(flight, command):
    def script(station):
        yield 1.0
        assert outputs(station) != [1500] * 6
        if command == "button":
            station.send(mavlink.MAVLink_manual_control_message(target=1, x=0, y=0, z=500, r=0, buttons=1 << 4))
        else:
            number, wanted = getattr(mavlink, f"MAV_CMD_{command}"), int(command == "DO_FLIGHTTERMINATION")
            assert station.command(number, wanted) == ACCEPTED
        assert not shown(station, "HEARTBEAT").base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        override(station, chan5_raw=1900)  # does nothing now, and is shown nevertheless
        yield 0.1
        assert outputs(station) == [1500] * 6
        assert shown(station, "RC_CHANNELS").chan5_raw == 1900
        yield 4.0
        override(station, others=RELEASE)
        assert station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, ARM) == ACCEPTED
        yield 6.0

    flown = flight(script, 11.2)
    resting = (flown["time"] > 1.05) & (flown["time"] < 5.05)
    assert all(np.all(flown[f"pilot_motors/u.T{n}"][resting] == 0) for n in range(1, 7))
    risen = flown.at(5.1, "vehicle/eta.z")
    assert risen < 0.7  # it floats
    assert flown.at(11.1, "vehicle/eta.z") == pytest.approx(risen, abs=0.3)
    assert flown.at(11.1, "pilot/nu_d.w") == 0


def test_a_vehicle_can_be_held_while_it_is_disarmed(flight):
    def script(station):
        assert station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, DISARM) == ACCEPTED
        override(station, chan5_raw=1900)
        yield 5.0
        assert outputs(station) != [1500] * 6

    flown = flight(script, 5.1, hold_disarmed=1)
    assert flown.at(5.0, "vehicle/eta.xyz") == pytest.approx([2, -1, 1], abs=0.05)
    assert flown["pilot/armed"][-1] == 0


def test_a_vehicle_can_start_disarmed_in_manual(flight):
    def script(station):
        beat = shown(station, "HEARTBEAT")
        assert not beat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        assert (beat.custom_mode, beat.system_status) == (FlightMode.MANUAL, mavlink.MAV_STATE_STANDBY)
        yield 0.5
        assert outputs(station) == [1500] * 6

    flown = flight(script, 0.6, start_disarmed=1)
    assert (flown["pilot/mode"][0], flown["pilot/armed"][0]) == (FlightMode.MANUAL, 0)
    assert np.all(flown["pilot_motors/u.T5"] == 0)


def test_the_gain_that_a_button_changes_is_the_one_that_is_shown(flight):
    def script(station):
        def gain():
            assert (
                station.command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT) == ACCEPTED
            )
            return station.expect("NAMED_VALUE_FLOAT", lambda m: m.name == "PilotGain").value

        assert gain() == 0.5
        station.send(mavlink.MAVLink_manual_control_message(target=1, x=0, y=0, z=500, r=0, buttons=1 << 11))
        assert gain() == 0.75
        yield 0.1

    flight(script, 0.2)


def test_a_parameter_that_changes_nothing_is_kept_and_announced(flight):
    def script(station):
        set_parameter(station, "FS_GCS_ENABLE", 2)
        assert refused(station, "FS_GCS_ENABLE has no effect here")
        set_parameter(station, "JS_GAIN_DEFAULT", 0.25)
        station.send(mavlink.MAVLink_manual_control_message(target=1, x=1000, y=0, z=500, r=0, buttons=0))
        assert shown(station, "RC_CHANNELS").chan5_raw == 1600
        fixed = mavlink.MAVLink_param_set_message(
            **to(), param_id=b"FRAME_CONFIG", param_value=2, param_type=mavlink.MAV_PARAM_TYPE_REAL32
        )
        assert station.ask(fixed, "PARAM_VALUE", lambda m: m.param_id == "FRAME_CONFIG").param_value == 1
        assert refused(station, "FRAME_CONFIG cannot be set to this")
        assert not any("JS_GAIN" in m.text for m in station.messages if m.get_type() == "STATUSTEXT")
        yield 0.1

    flight(script, 0.2)


def test_docs_name_the_parameters_that_have_an_effect():
    text = (Path(__file__).parent.parent / "docs" / "mavlink.md").read_text()
    named = text.partition("with an effect are")[2].partition("; of the others")[0]
    assert tuple(re.findall(r"`([^`]+)`", named)) == EFFECTIVE


def test_the_status_names_the_controllers_that_are_at_work(flight):
    bits = {
        "XY": mavlink.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL,
        "Z": mavlink.MAV_SYS_STATUS_SENSOR_Z_ALTITUDE_CONTROL,
        "YAW": mavlink.MAV_SYS_STATUS_SENSOR_YAW_POSITION,
        "MOTORS": mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS,
    }

    def enabled(station):
        status = shown(station, "SYS_STATUS").onboard_control_sensors_enabled
        return {name for name, bit in bits.items() if status & bit}

    def script(station):
        assert enabled(station) == {"XY", "Z", "YAW", "MOTORS"}
        enter(station, FlightMode.ALT_HOLD)
        assert enabled(station) == {"Z", "YAW", "MOTORS"}
        enter(station, FlightMode.MANUAL)
        station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, DISARM)
        assert enabled(station) == set()
        yield 0.1

    flight(script, 0.2)


# --- What cannot be done --------------------------------------------------------------------------------------------


def test_capabilities_are_those_of_the_vehicle(flight, spiral, resolve, tmp_path):
    steered = (
        mavlink.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
        | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
        | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_FLIGHT_TERMINATION
    )
    claimed = []

    def script(station):
        claimed.append(shown(station, "AUTOPILOT_VERSION").capabilities & steered)
        yield 0.01

    flight(script, 0.1)
    fly(resolve(spiral), script, tmp_path / "alone.h5")
    assert claimed == [steered, 0]


def test_a_vehicle_that_the_experiment_drives_refuses_to_be_steered(spiral, resolve, tmp_path):
    def script(station):
        who = "the experiment drives this"
        assert enter(station, FlightMode.GUIDED) == ACCEPTED  # it is in this mode
        assert enter(station, FlightMode.ALT_HOLD) == FAILED
        assert refused(station, f"ALT_HOLD refused: {who}")
        assert station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, DISARM) == FAILED
        assert refused(station, f"Disarm refused: {who}")
        assert station.command(mavlink.MAV_CMD_DO_FLIGHTTERMINATION, 1) == FAILED
        assert station.command(mavlink.MAV_CMD_NAV_LAND) == FAILED
        assert refused(station, f"SURFACE refused: {who}")
        assert station.command(mavlink.MAV_CMD_CONDITION_YAW, 90) == FAILED
        assert refused(station, f"Heading refused: {who}")
        assert station.command(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1, 0.5) == FAILED
        assert refused(station, f"Speed refused: {who}")
        assert station.command(mavlink.MAV_CMD_DO_REPOSITION) == FAILED
        assert refused(station, f"Position refused: {who}")
        station.send(attitude())
        assert refused(station, f"Set point ignored: {who}")
        override(station, chan5_raw=1600)
        assert refused(station, f"Sticks ignored: {who}")
        beat = shown(station, "HEARTBEAT")
        assert beat.custom_mode == FlightMode.GUIDED
        assert beat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        yield 0.01

    fly(resolve(spiral), script, tmp_path / "run.h5")


def test_a_vehicle_whose_thrusters_are_out_of_reach_is_not_disarmed_nor_driven_by_hand(piloted, resolve, tmp_path):
    table = piloted(0.2)
    del table["connections"]["vehicle.u"]
    table["components"]["vehicle"]["start"] = "fmu"

    def script(station):
        assert station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, DISARM) == FAILED
        assert refused(station, "Disarm refused: no access to its thrusters")
        assert enter(station, FlightMode.MANUAL) == FAILED
        assert refused(station, "MANUAL refused: no access to its thrusters")
        assert enter(station, FlightMode.GUIDED) == ACCEPTED
        version = shown(station, "AUTOPILOT_VERSION").capabilities
        assert not version & mavlink.MAV_PROTOCOL_CAPABILITY_FLIGHT_TERMINATION
        yield 0.1

    fly(resolve(table), script, tmp_path / "run.h5")


def test_requests_that_make_no_sense_leave_the_reference_finite(flight):
    chance = random.Random(7)

    def script(station):
        for mode in (FlightMode.GUIDED, FlightMode.ALT_HOLD, FlightMode.STABILIZE, FlightMode.POSHOLD) * 5:
            enter(station, mode)
            station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, ARM)
            for _ in range(20):
                station.send(request(chance))
            yield 0.1
        assert enter(station, FlightMode.POSHOLD) == ACCEPTED

    flown = flight(script, 2.1)
    assert all(np.isfinite(values).all() for values in flown.values() if values.dtype.kind == "f")
    assert np.abs(flown["pilot/nu_d.u"]).max() <= 2.0


# --- Records --------------------------------------------------------------------------------------------------------


def test_what_a_pilot_did_is_repeated_from_the_record(orch, flight):
    def script(station):
        override(station, chan4_raw=1600, chan5_raw=1600)
        yield 0.5
        enter(station, FlightMode.MANUAL)
        yield 0.5
        station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, DISARM)
        yield 0.5
        station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, ARM)
        enter(station, FlightMode.GUIDED)
        station.send(locally(POSITION, x=1.0, y=1.0, z=1.0))
        yield 0.5

    flown = flight(script, 2.1)
    assert set(flown["pilot/mode"]) == {16, 19, 4}
    answer = orch("rerun", "run.h5", "--verify")
    assert answer.code == 0, answer.out + answer.err


def test_a_telemetry_log_has_the_modes_and_the_arming_of_the_pilot(orch, flight, tmp_path):
    def script(station):
        yield 1.0
        station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, DISARM)
        yield 1.0
        enter(station, FlightMode.MANUAL)
        yield 1.5

    flight(script, 3.6)
    assert orch("export", "run.h5", "--format", "tlog", "-o", "run.tlog").code == 0
    log = mavutil.mavlink_connection(str(tmp_path / "run.tlog"), dialect="ardupilotmega")
    beats = [log.recv_match(type="HEARTBEAT") for _ in range(4)]
    armed = [bool(beat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED) for beat in beats]
    assert armed == [True, True, False, False]
    assert [beat.custom_mode for beat in beats] == [16, 16, 16, 19]


def test_a_record_that_heard_less_replays_as_it_did(clock):
    """Records of orch 0.1.0 hold 13 numbers a step: armed, every motion held."""
    old = np.array([0.4, 0.0, -0.2, 0.3, 0.0, *[math.nan] * 8])
    new = np.array([*old, 0.0, math.nan, 1.0, 16.0, *[1.0] * 5, math.nan, math.nan])
    paths = []
    for heard in (old, new):
        component = MavlinkManual("pilot", {}, {})
        component.start(np.zeros(6))
        paths.append([component.step(0.02 * k, 0.02, np.ones(6), heard) for k in range(50)])
    assert np.array_equal(*paths)
    assert paths[0][-1][0] > 0.05
