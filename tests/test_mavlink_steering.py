"""Steering from outside: a joystick, set points, and ArduPilot's own software, as components."""

import math
import os
import re
import socket
import subprocess
import threading
import time

import h5py
import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from commands import ORCH
from experiments import merged
from orchestrator.errors import OrchError
from orchestrator.mavlink.components.ardupilot import ArdupilotJson, reply
from orchestrator.mavlink.components.manual import MavlinkManual
from orchestrator.mavlink.fleet import fleet
from orchestrator.mavlink.protocol import steering
from orchestrator.mavlink.protocol.links import Endpoint
from orchestrator.mavlink.vehicle.autopilot import Autopilot
from orchestrator.mavlink.vehicle.control import FORWARD, LATERAL, THROTTLE, YAW, Control, Override, SetPoint
from orchestrator.mavlink.vehicle.modes import FlightMode
from orchestrator.mavlink.vehicle.parameters import AutopilotParameters
from orchestrator.mavlink.vehicle.sample import Sample
from peers.ardupilot import PACKET, FakeArdupilot, hover, parsed
from peers.station import Station, free_port, to

H = 0.01
POINT = 0x0DF8  # type_mask: everything but the position is ignored


@pytest.fixture
def control():
    return Control(stops=True, mixes=True)


@pytest.fixture
def autopilot(control):
    """A vehicle at (1, 2, 3), heading east."""
    autopilot = Autopilot(
        system=1,
        component="vehicle",
        parameters=AutopilotParameters(1, {}, {}),
        origin=(44.65, -124.05),
        control=control,
    )
    sample = Sample(
        t=0.0,
        eta=np.array([1.0, 2.0, 3.0, 0.0, 0.0, math.pi / 2]),
        nu=np.zeros(6),
        u=np.zeros(6),
        specific_force=np.zeros(3),
        eta_d=np.zeros(6),
        origin=autopilot.origin,
    )
    autopilot.show(sample)
    return autopilot


def announce(autopilot, text, severity=0):
    """To nobody."""


def push(control, **demands):
    """Sticks held in -1..1: surge, sway, heave (down), yaw."""
    channels = {"surge": (FORWARD, 1), "sway": (LATERAL, 1), "heave": (THROTTLE, -1), "yaw": (YAW, 1)}
    now = time.monotonic()
    control.overrides = {
        channels[name][0]: Override(pulse=1500 + 400 * channels[name][1] * value, at=now)
        for name, value in demands.items()
    }


def follow(component, eta, seconds):
    """Outputs (N, 37) of steps."""
    return np.array([component.step(k * H, H, eta, component.listen(k * H, eta)) for k in range(round(seconds / H))])


def manual_control(x=0, y=0, z=500, r=0, buttons=0):
    return mavlink.MAVLink_manual_control_message(target=1, x=x, y=y, z=z, r=r, buttons=buttons)


def set_point(frame, mask, point):
    """SET_POSITION_TARGET_LOCAL_NED of a point alone."""
    x, y, z = point
    rest = dict.fromkeys(("vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate"), 0)
    return mavlink.MAVLink_set_position_target_local_ned_message(
        **to(), time_boot_ms=0, coordinate_frame=frame, type_mask=mask, x=x, y=y, z=z, **rest
    )


def test_a_joystick_moves_the_reference_as_the_vehicle_points(control, autopilot):
    component = MavlinkManual("manual", {}, {"control": control})
    eta = np.array([1.0, 2.0, 3.0, 0.1, 0.1, math.pi / 2])
    assert component.start(eta)[:6] == pytest.approx([1, 2, 3, 0, 0, math.pi / 2])
    steering.Pilot(autopilot).manual_control(manual_control(x=1000, z=1000), time.monotonic(), announce)
    path = follow(component, eta, 2.0)
    # Surge is east; with ArduSub's gain of 0.5 half of 1 m/s, and half of 0.5 m/s up.
    assert path[-1][:3] == pytest.approx([1, 2 + 0.5 * (2 - 0.5), 3 - 0.25 * (2 - 0.5)], abs=0.03)
    assert path[-1][18:24] == pytest.approx([0.5, 0, -0.25, 0, 0, 0], abs=0.02)


def test_the_reference_is_smooth_and_its_derivatives_are_its_own(control):
    component = MavlinkManual("manual", {}, {"control": control})
    component.start(np.zeros(6))
    push(control, surge=1.0, sway=-0.5, heave=0.3, yaw=0.7)
    path = follow(component, np.zeros(6), 3.0)
    place, rate, change = path[:, :6], path[:, 6:12], path[:, 12:18]
    assert np.diff(place, axis=0) / H == pytest.approx((rate[1:] + rate[:-1]) / 2, abs=1e-9)
    assert np.diff(rate, axis=0) / H == pytest.approx(change[1:], abs=1e-9)
    assert np.abs(np.diff(rate, axis=0)).max() < 0.05


def test_silence_stops_the_reference_after_ardusubs_timeout(control, autopilot):
    component = MavlinkManual("manual", {}, {"control": control})
    component.start(np.zeros(6))
    pilot = steering.Pilot(autopilot)
    autopilot.parameters.set("FS_PILOT_TIMEOUT", 0.5)
    pilot.manual_control(manual_control(x=500), time.monotonic() - 1.0, announce)
    assert control.demands() == (0, 0, 0, 0, 0)
    pilot.manual_control(manual_control(x=500), time.monotonic(), announce)
    assert control.demands()[0] == pytest.approx(0.25)
    control.armed = False
    assert control.demands() == (0, 0, 0, 0, 0)


def test_axes_beyond_their_range_and_buttons_do_what_ardusub_does(control, autopilot):
    pilot, now = steering.Pilot(autopilot), time.monotonic()
    pilot.manual_control(manual_control(x=32767, y=-32768, z=-5, r=2000), now, announce)
    assert control.demands() == (0, 0, 0, 0, 0)
    pilot.manual_control(manual_control(buttons=1 << 3), now, announce)  # BTN3: depth hold
    assert autopilot.mode == FlightMode.ALT_HOLD
    pilot.manual_control(manual_control(buttons=1 << 3 | 1 << 2), now, announce)  # BTN2: POSHOLD; BTN3 is still down
    assert autopilot.mode == FlightMode.POSHOLD
    pilot.manual_control(manual_control(x=1000, buttons=1 << 11), now, announce)  # BTN11: more gain
    assert control.demands()[0] == pytest.approx(0.75)
    pilot.manual_control(manual_control(buttons=1 << 4), now, announce)
    assert not control.armed


def test_channel_overrides_move_it_too(control, autopilot):
    pulses = {f"chan{n}_raw": 1500 for n in range(1, 9)} | {"chan3_raw": 1300, "chan5_raw": 1700}
    message = mavlink.MAVLink_rc_channels_override_message(**to(), **pulses)
    steering.Pilot(autopilot).channels(message, time.monotonic())
    assert control.demands() == pytest.approx((0.5, 0, 0.5, 0, 0))
    assert [control.channels()[n] for n in range(1, 7)] == [1500, 1500, 1300, 1500, 1700, 1500]


@pytest.mark.parametrize(
    ("frame", "mask", "point", "expected"),
    [
        (mavlink.MAV_FRAME_LOCAL_NED, POINT, (4, 5, 6), (4, 5, 6)),
        (mavlink.MAV_FRAME_LOCAL_OFFSET_NED, POINT, (4, 5, 6), (5, 7, 9)),
        (mavlink.MAV_FRAME_BODY_OFFSET_NED, POINT, (4, 5, 6), (1 - 5, 2 + 4, 9)),  # ahead is east
        (mavlink.MAV_FRAME_LOCAL_NED, POINT | mavlink.POSITION_TARGET_TYPEMASK_Z_IGNORE, (4, 5, 6), (4, 5, None)),
    ],
)
def test_set_points_count_in_mode_guided_in_every_frame(control, autopilot, frame, mask, point, expected):
    message = set_point(frame, mask, point)
    assert steering.local_set_point(autopilot, message, 0.0) == "Set point ignored in mode POSHOLD"
    assert control.set_point is None
    autopilot.enter(FlightMode.GUIDED)
    assert steering.local_set_point(autopilot, message, 0.0) == ""
    assert control.target().position == pytest.approx(expected)


def test_a_set_point_is_reached_without_overshoot_within_the_limits(control):
    component = MavlinkManual("manual", {"lag": 0.4}, {"control": control})
    component.start(np.zeros(6))
    control.enter(FlightMode.GUIDED)
    control.set_point = SetPoint(position=(4.0, -3.0, 1.0), yaw=math.radians(-170))
    path = follow(component, np.zeros(6), 25.0)
    assert path[-1][:3] == pytest.approx([4, -3, 1], abs=0.01)
    assert path[-1][5] == pytest.approx(math.radians(-170), abs=0.01)
    assert path[:, 0].max() <= 4.0 + 1e-3
    assert path[:, 1].min() >= -3.0 - 1e-3
    assert np.hypot(path[:, 6], path[:, 7]).max() <= 1.0 + 1e-6
    assert np.abs(path[:, 8]).max() <= 0.5 + 1e-6


# --- Whole runs -----------------------------------------------------------------------------------------------------


@pytest.fixture
def steered(spiral):
    """The spiral's vehicle and controller, with a pilot in place of the reference."""
    table = merged(spiral, {"components.reference": None, "metrics": {}, "master.stop_time": 3.0})
    pilot = {"builtin": "mavlink_manual", "step": 0.02}
    table["components"] = {"controller": table["components"].pop("controller"), **table["components"], "pilot": pilot}
    table["connections"]["pilot.eta"] = "vehicle.eta"
    for name in ("eta_d", "eta_d_dot", "eta_d_ddot"):
        table["connections"][f"controller.{name}"] = f"pilot.{name}"
    return table


@pytest.mark.parametrize("command", ["converge", "sweep"])
def test_what_is_steered_from_outside_is_not_run_many_times(orch, steered, write, tmp_path, command):
    steered["metrics"] = {"last": {"of": "final", "signal": "vehicle.eta.x"}}
    steered["sweep"] = {"vary": {"components.vehicle.parameters.m": [9.0, 11.5]}}
    answer = orch(command, write(steered))
    assert answer.code == 2
    assert "components.pilot: is steered from outside" in answer.err
    assert not (tmp_path / "results").exists()


def datasets(path):
    values = {}
    with h5py.File(path) as file:
        file.visititems(lambda name, item: values.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None)
    return values


def test_a_joystick_flies_a_vehicle_and_the_run_can_be_repeated_from_its_record(orch, steered, write, tmp_path):
    port = free_port()
    command = [
        ORCH,
        "run",
        str(write(steered)),
        "--realtime",
        "--quiet",
        "--output",
        "run.h5",
        "--mavlink",
        f"udpin:127.0.0.1:{port}",
    ]
    process = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    station = Station.udpout(port)
    while not station.receive(0.1) and process.poll() is None:
        station.heartbeat()
    stranger = Station.udpout(port, system=254)
    while process.poll() is None:
        station.send(manual_control(x=1000, r=-300))
        stranger.send(manual_control(x=-1000, z=0))  # is not the configured ground station
        station.listen(0.05)
    assert process.wait() == 0, process.stderr.read()
    run = datasets(tmp_path / "run.h5")
    forward = np.hypot(run["vehicle/eta.x"] - 2.0, run["vehicle/eta.y"] + 1.0)
    assert forward[-1] > 0.3
    assert run["vehicle/eta.psi"][-1] < -0.1
    assert run["pilot/nu_d.u"].max() == pytest.approx(0.5, abs=0.05)
    assert run["pilot/nu_d.w"].max() == 0
    channels = [m.chan5_raw for m in station.messages if m.get_type() == "RC_CHANNELS"]
    assert max(channels) == 1700
    assert orch("rerun", "run.h5", "--verify").code == 0
    station.close()
    stranger.close()


@pytest.mark.slow
def test_a_script_sends_a_vehicle_to_a_point_and_disarms_it(steered, write, tmp_path):
    port = free_port()
    command = [
        ORCH,
        "run",
        str(write(merged(steered, {"master.stop_time": 9.0, "components.pilot.parameters": {"hold_disarmed": 1}}))),
        "--realtime",
        "3",
        "--quiet",
        "--output",
        "run.h5",
        "--mavlink",
        f"udpin:127.0.0.1:{port}",
    ]
    process = subprocess.Popen(command, cwd=tmp_path)
    station = Station.udpout(port)
    while not station.receive(0.1) and process.poll() is None:
        station.heartbeat()
    custom, accepted = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, mavlink.MAV_RESULT_ACCEPTED
    assert station.command(mavlink.MAV_CMD_DO_SET_MODE, custom, FlightMode.GUIDED) == accepted
    station.send(set_point(mavlink.MAV_FRAME_LOCAL_NED, POINT, (2.5, -1.2, 1.3)))
    station.listen(2.0)
    disarm = 0
    assert station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, disarm) == accepted
    station.expect("HEARTBEAT", lambda m: not m.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED, seconds=0.5)
    assert process.wait(timeout=30) == 0
    run = datasets(tmp_path / "run.h5")
    assert [run[f"pilot/eta_d.{axis}"][-1] for axis in "xyz"] == pytest.approx([2.5, -1.2, 1.3], abs=0.05)
    assert [run[f"vehicle/eta.{axis}"][-1] for axis in "xyz"] == pytest.approx([2.5, -1.2, 1.3], abs=0.3)
    station.close()


def test_ardupilot_flies_the_vehicle_of_an_experiment(orch, spiral, write, without_pymavlink, tmp_path):
    """It speaks JSON: pymavlink is not needed."""
    port, h = free_port(), 0.0025
    ardusub = {"builtin": "ardupilot_json", "parameters": {"port": port}}
    connections = {f"ardusub.{name}": f"vehicle.{name}" for name in ("eta", "nu", "specific_force")}
    table = {
        "master": {"stop_time": 4.0, "step": h},
        "components": {"ardusub": ardusub, "vehicle": spiral["components"]["vehicle"]},
        "connections": {**connections, "vehicle.u": "ardusub.u"},
    }
    table["components"]["vehicle"]["start"] = "fmu"
    pilot = FakeArdupilot(port, hover(1.4, 0.4))
    thread = threading.Thread(target=pilot.fly, args=(3000,), daemon=True)
    thread.start()
    environment = {**os.environ, "PYTHONPATH": str(without_pymavlink)}
    answer = orch("run", write(table), "--output", "run.h5", env=environment)
    assert answer.code == 0, answer.err
    run = datasets(tmp_path / "run.h5")
    assert run["vehicle/eta.z"][-1] == pytest.approx(1.4, abs=0.1)
    assert run["vehicle/eta.psi"][-1] == pytest.approx(0.4, abs=0.1)
    assert np.diff([state["timestamp"] for state in pilot.states]) == pytest.approx(h)
    assert pilot.states[0]["imu"]["accel_body"][2] == pytest.approx(-9.81, abs=1.0)
    timing = orch("show", "run.h5", "--json").json["timing"]
    spent = [of[phase] for of in timing["components"].values() for phase in ("set", "step", "get")]
    waited = timing["components"]["ardusub"]["waited"]
    assert 0 < waited < timing["stepping"]
    assert sum(spent) + waited <= timing["stepping"] * (1 + 1e-12)
    text = orch("show", "run.h5").out
    assert "ardusub, waiting" in text
    assert sum(map(float, re.findall(r"([\d.]+)%", text))) == pytest.approx(100, abs=0.3)  # each is rounded
    assert orch("rerun", "run.h5", "--verify").code == 0  # without ArduPilot


@pytest.fixture
def flown(spiral):
    """flown(port, **parameters): a vehicle that ArduPilot flies, and one that nobody steers."""

    def table(port, **parameters):
        vehicle = {**spiral["components"]["vehicle"], "start": "fmu"}
        ardusub = {"builtin": "ardupilot_json", "parameters": {"port": port, **parameters}}
        connections = {f"ardusub.{name}": f"vehicle.{name}" for name in ("eta", "nu", "specific_force")}
        return {
            "master": {"stop_time": 2.0, "step": 0.0025},
            "components": {"ardusub": ardusub, "vehicle": vehicle, "other": vehicle},
            "connections": {**connections, "vehicle.u": "ardusub.u"},
        }

    return table


def test_the_bridge_leaves_the_vehicle_that_ardupilot_flies_to_ardupilot(flown, write, tmp_path):
    port, bridge = free_port(), free_port()
    pilot = FakeArdupilot(port, hover(1.4))
    threading.Thread(target=pilot.fly, args=(2000,), daemon=True).start()
    run = [ORCH, "run", str(write(flown(port))), "--realtime", "--output", "run.h5"]
    command = [*run, "--mavlink", f"udpin:127.0.0.1:{bridge}"]
    process = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    station = Station.udpout(bridge)
    while process.poll() is None:
        station.heartbeat()
        station.listen(0.1)
    error = process.communicate()[1]
    station.close()
    assert process.returncode == 0, error
    assert {m.get_srcSystem() for m in station.messages if m.get_type() == "HEARTBEAT"} == {2}
    assert {m.get_srcSystem() for m in station.messages} == {2}
    note = "vehicle is not shown: ArduPilot, which flies it, speaks for system id 1; connect stations to it"
    assert note in " ".join(error.split())


def test_a_vehicle_is_shown_beside_its_ardupilot_by_another_system_id_and_no_two_have_the_same(flown, resolve):
    def shown(system_id, **vehicles):
        table = merged(flown(9002, system_id=system_id), {"mavlink": {"vehicles": vehicles}})
        return {autopilot.component: autopilot.system for autopilot in fleet(resolve(table), {})}

    assert shown(0, vehicle=1, other=2) == {"other": 2}
    assert shown(7, vehicle=1, other=2) == {"vehicle": 1, "other": 2}
    assert shown(7, vehicle=7, other=2) == {"other": 2}
    with pytest.raises(OrchError, match="ArduPilot speaks for the system id 1"):
        fleet(resolve(flown(9002)), {}, [Endpoint.parse("1=udpin:127.0.0.1:14550")])
    with pytest.raises(OrchError, match=r"mavlink\.vehicles\.other: ArduPilot, .* has the system id 7"):
        shown(7, vehicle=1, other=7)


def test_a_run_without_a_bridge_says_that_nobody_steers(orch, steered, write):
    answer = orch("run", write(merged(steered, {"master.stop_time": 0.1})), "--output", "run.h5")
    assert answer.code == 0
    assert "nobody steers 'pilot'" in answer.err


# --- ArduPilot ------------------------------------------------------------------------------------------------------


def fly(component, seconds, h=0.0025):
    """A body of 10 kg and no drag but for heave and yaw; returns eta over time."""
    eta, nu, path = np.array([0, 0, 1.0, 0, 0, 0.3]), np.zeros(6), []
    u = component.start(np.zeros(15))
    for k in range(round(seconds / h)):
        inputs = np.array([*eta, *nu, 0, 0, -9.81])
        u = component.step(k * h, h, inputs, component.listen(k * h, inputs))
        heave, yaw = -40 * (u[4] + u[5]), 14 * (u[0] - u[1] - u[2] + u[3])
        nu = nu + h * np.array([0, 0, (heave - 20 * nu[2]) / 25, 0, 0, (yaw - nu[5]) / 0.3])
        eta = eta + h * nu
        path.append(eta)
    return np.array(path)


def test_ardupilot_flies_two_vehicles_in_lock_step():
    ports = [free_port(), free_port()]
    components = [ArdupilotJson(f"ardusub{n}", {"port": float(port)}, {}) for n, port in enumerate(ports, 1)]
    pilots = [FakeArdupilot(ports[0], hover(2.0, -0.2)), FakeArdupilot(ports[1], hover(0.5, 1.0))]
    paths = {}
    threads = [threading.Thread(target=pilot.fly, args=(2400,), kwargs={"resend": True}) for pilot in pilots]
    threads += [threading.Thread(target=lambda n=n: paths.update({n: fly(components[n], 5.0)})) for n in (0, 1)]
    for thread in threads:
        thread.start()
    for thread in threads[2:]:
        thread.join(timeout=60)
    for component in components:
        component.close()
    assert paths[0][-1][[2, 5]] == pytest.approx([2.0, -0.2], abs=0.05)
    assert paths[1][-1][[2, 5]] == pytest.approx([0.5, 1.0], abs=0.05)
    for pilot in pilots:
        times = [state["timestamp"] for state in pilot.states]
        assert np.diff(times) == pytest.approx(0.0025)  # one packet a step, none lost, none twice


def test_junk_at_the_port_is_ignored_and_an_output_not_in_use_rests():
    component = ArdupilotJson("ardusub", {"port": float(port := free_port())}, {})
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    for data in (b"", b"x", b"\x1a\x48", PACKET.pack(1, 400, 1, *[1900] * 16)):
        sender.sendto(data, ("127.0.0.1", port))
    sender.sendto(PACKET.pack(18458, 400, 1, 1900, 1100, *[0] * 14), ("127.0.0.1", port))
    heard = component.listen(0.0, np.zeros(15))
    u = component.step(0.0, 0.0025, np.zeros(15), heard)
    assert u == pytest.approx([1, -1, 0, 0, 0, 0])  # T1 = -M2, T2 = -M1
    component.close()
    sender.close()


def test_a_packet_that_comes_again_gets_the_same_answer_and_no_step():
    component = ArdupilotJson("ardusub", {"port": float(port := free_port())}, {})
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sender.settimeout(5)

    def send(count):
        sender.sendto(PACKET.pack(18458, 400, count, *[1500 + count] * 16), ("127.0.0.1", port))

    send(1)
    assert component.listen(0.0, np.zeros(15))[0] == 1501
    heard = []
    thread = threading.Thread(target=lambda: heard.append(component.listen(0.0025, np.ones(15))))
    thread.start()
    answer = sender.recv(1 << 16)
    send(1)
    assert sender.recv(1 << 16) == answer
    assert not heard
    send(2)
    thread.join(timeout=10)
    assert heard[0][0] == 1502
    component.close()
    sender.close()


def test_the_reply_is_what_ardupilots_parser_wants():
    state = parsed(reply(1.25, np.array([1, 2, 3, 0.1, 0.2, 7.0, 0.5, 0, 0, 0.01, 0.02, 0.03, 1e-7, 0.2, -9.81])))
    assert state["timestamp"] == 1.25
    assert state["position"] == [1, 2, 3]
    assert state["attitude"][2] == pytest.approx(7.0 - 2 * math.pi)
    assert state["imu"]["accel_body"][2] == -9.81
    assert np.hypot(*state["velocity"][:2]) == pytest.approx(0.5 * math.cos(0.2))


def test_a_port_that_is_taken_and_an_ardupilot_that_is_silent_are_reported():
    component = ArdupilotJson("ardusub", {"port": float(port := free_port()), "patience": 0.2}, {})
    with pytest.raises(OrchError, match=rf"components\.ardusub2\.parameters\.port: {port} cannot be opened"):
        ArdupilotJson("ardusub2", {"port": port}, {})
    with pytest.raises(OrchError, match="no packet from ArduPilot"):
        component.listen(0.0, np.zeros(15))
    with pytest.raises(OrchError, match=r"components\.ardusub\.step"):
        component.step(0.0, 0.1, np.zeros(15), np.zeros(6))
    component.close()
