"""Real ground stations, unmodified, on loopback: MAVProxy and MAVSDK 4; and forty seconds of real time."""

import importlib.util
import json
import resource
import shutil
import subprocess
import sys
import sysconfig
import threading
import time
import tomllib

import h5py
import numpy as np
import pytest

from commands import ORCH
from experiments import EXPERIMENTS
from orchestrator.mavlink.vehicle.frame import FACTORS
from peers.station import Station, close_to, free_port, named

GRIPPING = str(EXPERIMENTS / "gripping_currents.toml")
MAVPROXY = shutil.which("mavproxy.py", path=sysconfig.get_path("scripts"))
needs_mavproxy = pytest.mark.skipif(MAVPROXY is None, reason='needs MAVProxy: pip install "orch[gcs]"')
needs_mavsdk = pytest.mark.skipif(importlib.util.find_spec("mavsdk") is None, reason='needs mavsdk: "orch[gcs]"')

pytestmark = pytest.mark.slow

MAVSDK_SCRIPT = """
import json, sys, time
from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.info import Info
from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkMessage
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry import Telemetry

sdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
sdk.add_any_connection(sys.argv[1])
end = time.time() + 20
while time.time() < end and sum(s.has_autopilot() for s in sdk.get_systems()) < 2:
    time.sleep(0.1)
seen = {}
for system in sdk.get_systems():
    telemetry, param = Telemetry(system), Param(system)
    for _ in range(50):
        place = telemetry.position_velocity_ned()
        if place.position.down_m == place.position.down_m:
            break
        time.sleep(0.1)
    attitudes, places = [], []
    direct = MavlinkDirect(system)
    def keep(into, wanted=system.get_system_id()):  # a subscription is to the messages of all systems
        return lambda m, _: into.append(json.loads(m.fields_json)) if m.system_id == wanted else None
    direct.subscribe_message("ATTITUDE", keep(attitudes))
    direct.subscribe_message("LOCAL_POSITION_NED", keep(places))
    every = param.get_all_params()
    changed = param.set_param_float("JS_GAIN_DEFAULT", 0.625)
    time.sleep(2)
    health = telemetry.health()
    seen[system.get_system_id()] = {
        "kind": [system.autopilot_type().name, system.vehicle_type().name],
        "parameters": len(every.int_params) + len(every.float_params),
        "gain": param.get_param_float("JS_GAIN_DEFAULT"), "frame": param.get_param_int("FRAME_CONFIG"),
        "version": vars(Info(system).get_version())["flight_sw_major"], "armed": telemetry.armed(),
        "healthy": health.is_global_position_ok and health.is_local_position_ok and health.is_armable,
        "attitudes": attitudes, "places": places,
    }
print("SEEN " + json.dumps(seen))
sys.stdout.flush()
"""


def start(folder, port, stop_time, *options, experiment=GRIPPING):
    command = [
        ORCH,
        "run",
        str(experiment),
        "--realtime",
        "--mavlink",
        f"udpout:127.0.0.1:{port}",
        "--output",
        "run.h5",
        "--json",
        "--set",
        f"master.stop_time={stop_time}",
        "--set",
        "record.every=0.001",
        *options,
    ]
    return subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True)


@pytest.fixture
def steered(write):
    """The gripping experiment with a pilot in place of each reference."""
    with open(GRIPPING, "rb") as file:
        table = tomllib.load(file)
    table["metrics"] = {}
    for n in (1, 2):
        del table["components"][f"reference{n}"]
        table["components"][f"pilot{n}"] = {"builtin": "mavlink_manual", "step": 0.02}
        table["connections"][f"pilot{n}.eta"] = f"vehicle{n}.eta"
        for name in ("eta_d", "eta_d_dot", "eta_d_ddot"):
            table["connections"][f"controller{n}.{name}"] = f"pilot{n}.{name}"
    return write(table)


@needs_mavproxy
def test_mavproxy_finds_both_vehicles_loads_all_parameters_both_ways_and_changes_modes(shipped, steered, tmp_path):
    run = start(tmp_path, port := free_port(), 40, experiment=steered)
    proxy = subprocess.Popen(
        [MAVPROXY, "--master", f"udpin:127.0.0.1:{port}"],
        cwd=tmp_path,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    said = []
    reader = threading.Thread(target=lambda: said.extend(iter(lambda: proxy.stdout.read(1), "")), daemon=True)
    reader.start()

    def wait(words, times=1):
        end = time.monotonic() + 15
        while "".join(said).count(words) < times:
            assert time.monotonic() < end, f"no {words!r} in:\n{''.join(said)}"
            time.sleep(0.1)

    def enter(words):
        proxy.stdin.write(words + "\n")
        proxy.stdin.flush()

    wait("Received 333 parameters (ftp)")
    wait("Detected vehicle 2:1")
    enter("mode MANUAL")
    wait("Mode MANUAL", times=2)  # what the vehicle says, and what its heartbeat says
    enter("mode CIRCLE")
    wait("CIRCLE refused: not simulated")
    enter("disarm")
    wait("Disarming motors")
    enter("arm throttle")
    wait("Arming motors")
    enter("vehicle 2")
    wait("Received 333 parameters (ftp)", times=2)
    enter("mode ALT_HOLD")
    wait("Mode ALT_HOLD", times=2)
    enter("set param_ftp False")
    enter("param fetch")
    wait("Received 333 parameters\n")
    enter("status")
    enter("link list")
    wait("MAV Errors: 0")
    proxy.stdin.close()
    proxy.kill()
    run.kill()
    run.communicate()
    assert "no link" not in "".join(said)


@needs_mavsdk
def test_mavsdk_sees_two_submarines_where_the_record_has_them(shipped, tmp_path):
    run = start(tmp_path, port := free_port(), 20)
    (tmp_path / "sdk.py").write_text(MAVSDK_SCRIPT)
    done = subprocess.run(
        [sys.executable, "sdk.py", f"udpin://127.0.0.1:{port}"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
    )
    seen = json.loads(next(line for line in done.stdout.splitlines() if line.startswith("SEEN "))[5:])
    assert json.loads(run.communicate(timeout=60)[0])["status"] == "completed"
    assert seen.keys() == {"1", "2"}
    with h5py.File(tmp_path / "run.h5") as record:
        for system, vehicle in seen.items():
            assert vehicle["kind"] == ["ARDUPILOT", "SUBMARINE"]
            assert (vehicle["parameters"], vehicle["gain"], vehicle["frame"], vehicle["version"]) == (333, 0.625, 1, 4)
            assert vehicle["armed"]
            assert vehicle["healthy"]
            assert len(vehicle["attitudes"]) >= 15
            signals = record[f"vehicle{system}"]
            for message in vehicle["attitudes"]:
                row = message["time_boot_ms"]
                for angle, axis in (("roll", "phi"), ("pitch", "theta"), ("yaw", "psi")):
                    assert close_to(message[angle], signals[f"eta.{axis}"][row], 1e-5)
            for message in vehicle["places"]:
                row = message["time_boot_ms"]
                assert [message[axis] for axis in "xyz"] == pytest.approx(
                    [signals[f"eta.{axis}"][row] for axis in "xyz"], abs=1e-5
                )


def test_forty_seconds_lose_no_frame_keep_the_pace_and_push_the_right_way(shipped, tmp_path):
    listener = Station.udpin(port := free_port())
    run = start(tmp_path, port, 40, "--set", "mavlink.rates.RC_CHAN=25", "--set", "mavlink.rates.EXTRA1=25")
    while run.poll() is None:
        listener.receive(0.1)
    assert json.loads(run.communicate()[0])["status"] == "completed"
    assert listener.lost == 0
    assert len(named("HEARTBEAT")(listener.messages, 2)) >= 40

    # What a message shows is up to 2 ms old when it is sent, and this process may be asleep when it comes.
    late = [
        t - m.time_boot_ms / 1000
        for m, t in zip(listener.messages, listener.times, strict=True)
        if m.get_type() == "ATTITUDE" and m.get_srcSystem() == 1
    ]
    assert abs(np.median(late[-50:]) - np.median(late[:50])) < 0.005
    with h5py.File(tmp_path / "run.h5") as record:
        # The mean, for a busy machine may wake it late at any one moment, the last one too.
        assert json.loads(record.attrs["timing"])["pacing"]["late_mean"] < 0.005
        assert record.attrs["wall_time"] == pytest.approx(40.0, abs=0.1)
        for system in (1, 2):
            check_directions(named("SERVO_OUTPUT_RAW")(listener.messages, system), record[f"vehicle{system}"])


def check_directions(outputs, signals):
    """The force that ArduSub's own mixer makes of the PWM is the one that moves the vehicle, on every axis."""
    pulses = np.array([[getattr(m, f"servo{n}_raw") for n in range(1, 7)] for m in outputs])
    rows = [round(m.time_usec / 1000) for m in outputs]
    forces = (pulses - 1500) / 400 @ FACTORS
    for k, axis in enumerate(("X", "Y", "Z", "K", "M", "N")):
        tau = signals[f"tau.{axis}"][:][rows]
        if np.ptp(tau) > 1e-3:
            assert np.corrcoef(forces[:, k], tau)[0, 1] > 0.99, axis


def test_two_vehicles_at_default_rates_cost_less_than_a_quarter_of_a_core(shipped, tmp_path):
    listener = Station.udpin(port := free_port())
    threading.Thread(target=lambda: listener.listen(30), daemon=True).start()
    seconds, spent = 10, {}
    for name, options in {"alone": [], "shown": ["--realtime", "--mavlink", f"udpout:127.0.0.1:{port}"]}.items():
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        command = [ORCH, "run", GRIPPING, "--set", f"master.stop_time={seconds}", "--output", f"{name}.h5", "--quiet"]
        subprocess.run([*command, *options], cwd=tmp_path, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent[name] = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    assert 0 < (share := (spent["shown"] - spent["alone"]) / seconds) < 0.25, share
