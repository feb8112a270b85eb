"""A run with the bridge, the pacer and the log: its record, its times, and what it refuses."""

import hashlib
import json
import os
import pty
import re
import socket
import subprocess
import time
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from commands import ORCH
from experiments import EXPERIMENTS, merged
from peers.station import Station, close_to, command_long, free_port, named

GRIPPING = str(EXPERIMENTS / "gripping_currents.toml")
VERSION = (mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)


@pytest.fixture
def run(shipped, tmp_path):
    """run(*options) starts `orch run` of two vehicles in the background."""
    started = []

    def start(*options, experiment=GRIPPING):
        command = [ORCH, "run", experiment, *map(str, options)]
        process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.wait()


def datasets(path):
    values = {}
    with h5py.File(path) as file:
        file.visititems(lambda name, item: values.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None)
    return values


def test_the_record_is_the_same_to_the_bit_with_the_bridge_on_and_telemetry_agrees_with_it(run, orch, tmp_path):
    port = free_port()
    listener = Station.udpin(port)
    options = ["--set", "master.stop_time=2", "--set", "record.every=0.001", "--json"]
    process = run(*options, "--output", "on.h5", "--mavlink", f"udpout:127.0.0.1:{port}", "--realtime")
    while process.poll() is None:
        listener.receive(0.1)
    answer = json.loads(process.communicate()[0])
    assert orch("run", GRIPPING, *options, "--output", "off.h5").code == 0
    on, off = datasets(tmp_path / "on.h5"), datasets(tmp_path / "off.h5")
    assert on.keys() == off.keys()
    assert all(np.array_equal(on[name], off[name]) for name in on)

    assert listener.lost == 0
    rows = {round(t * 1000): k for k, t in enumerate(on["time"])}
    for system in (1, 2):

        def value(name, message, system=system):
            return on[f"vehicle{system}/{name}"][rows[message.time_boot_ms]]

        for m in named("LOCAL_POSITION_NED")(listener.messages, system):
            assert (m.x, m.y, m.z) == tuple(np.float32(value(f"eta.{axis}", m)) for axis in "xyz")
        for m in named("ATTITUDE")(listener.messages, system):
            assert all(
                close_to(a, value(f"eta.{axis}", m), 1e-6)
                for a, axis in zip((m.roll, m.pitch, m.yaw), ("phi", "theta", "psi"), strict=True)
            )
            assert (m.rollspeed, m.pitchspeed, m.yawspeed) == tuple(np.float32(value(f"nu.{a}", m)) for a in "pqr")
        assert len(named("ATTITUDE")(listener.messages, system)) >= 15

    # Heavily loaded machines are late for a moment; the end of the run is on time again.
    assert answer["wall_time"] == pytest.approx(2.0, abs=0.05)
    with h5py.File(tmp_path / "on.h5") as file:
        pacing = json.loads(file.attrs["timing"])["pacing"]
    assert pacing["factor"] == 1.0
    assert 0 <= pacing["late_mean"] <= pacing["late_max"]
    beats = [
        (t, m.time_boot_ms)
        for m, t in zip(listener.messages, listener.times, strict=True)
        if m.get_type() == "ATTITUDE" and m.get_srcSystem() == 1
    ]
    drift = [t - ms / 1000 for t, ms in beats]
    assert np.median(np.abs(np.array(drift) - drift[0])) < 0.02
    listener.close()


def test_a_run_that_records_almost_nothing_is_shown_nevertheless(run, tmp_path):
    listener = Station.udpin(port := free_port())
    process = run(
        "--set",
        "master.stop_time=1",
        "--set",
        'record.signals=["current.*"]',
        "--set",
        "metrics={}",
        "--quiet",
        "--output",
        "run.h5",
        "--mavlink",
        f"udpout:127.0.0.1:{port}",
        "--realtime",
    )
    moving = listener.expect("LOCAL_POSITION_NED", lambda m: m.vx != 0 and m.time_boot_ms > 200, seconds=20)
    assert moving.z == pytest.approx(1.0, abs=0.2)
    assert listener.expect("SERVO_OUTPUT_RAW").servo1_raw != 1500
    assert process.wait(timeout=20) == 0
    listener.close()


def test_a_factor_paces_and_a_run_without_it_is_not_held_up(run, tmp_path):
    walls = {}
    for name, options in {"fast": ["--realtime", "4"], "free": []}.items():
        process = run("--set", "master.stop_time=2", "--json", "--output", f"{name}.h5", *options)
        walls[name] = json.loads(process.communicate(timeout=60)[0])["wall_time"]
    assert walls["fast"] == pytest.approx(0.5, abs=0.08)
    assert walls["free"] < 0.4
    text = subprocess.run([ORCH, "show", str(tmp_path / "fast.h5")], capture_output=True, text=True, check=True).stdout
    assert float(re.search(r"waiting for the clock .*?([\d.]+)%", text)[1]) > 30
    assert float(re.search(r"loop and recording .*?([\d.]+)%", text)[1]) < 60


def test_paced_runs_are_never_taken_from_the_store(orch):
    options = ["--set", "master.stop_time=0.1", "--set", "metrics={}"]
    assert "already" not in orch("run", GRIPPING, *options).out
    assert "already" in orch("run", GRIPPING, *options).out
    assert "already" not in orch("run", "--realtime", GRIPPING, *options).out


def test_what_cannot_be_shown_is_reported_before_anything_starts(orch, tmp_path):
    taken = Station.udpin(port := free_port())
    (tmp_path / "empty").write_text("")
    for options, words in {
        ("--mavlink", "udpot:127.0.0.1:1"): "did you mean 'udpout'?",
        ("--mavlink", "14550"): "udpout:HOST:PORT",
        ("--mavlink", "udpout:127.0.0.1:70000"): "no port 70000",
        ("--mavlink", f"udpin:127.0.0.1:{port}"): "cannot be opened",
        ("--mavlink", "3=udpin:127.0.0.1:9"): "no vehicle has the system id 3",
        ("--mavlink", "serial:nowhere:57600"): "cannot be opened",
        ("--mavlink", "udpin:127.0.0.1:9", "--mavlink-key", "missing"): "cannot be read",
        ("--mavlink", "udpin:127.0.0.1:9", "--mavlink-key", "empty"): "is empty",
        ("--realtime", "fast"): "--realtime fast",
        ("--realtime", "0"): "0.001",
    }.items():
        answer = orch("run", GRIPPING, *options, "--results", "none")
        assert answer.code == 2, options
        assert words in answer.err, answer.err
        assert not (tmp_path / "none").exists()
    taken.close()


@pytest.mark.parametrize("release", ["none", "without FTP"])
def test_a_missing_or_old_pymavlink_is_reported_before_anything_starts(orch, without_pymavlink, release, tmp_path):
    if release == "without FTP":  # before 2.4.50
        (without_pymavlink / "pymavlink" / "__init__.py").write_text("")
        (without_pymavlink / "pymavlink" / "dialects" / "v20").mkdir(parents=True)
        dialect = without_pymavlink / "pymavlink" / "dialects" / "v20" / "ardupilotmega.py"
        dialect.write_text("class MAVLink_message: pass")
    environment = {**os.environ, "PYTHONPATH": str(without_pymavlink)}
    answer = orch("run", GRIPPING, "--mavlink", "udpin:127.0.0.1:9", "--results", "none", env=environment)
    assert answer.code == 2
    assert "needs pymavlink 2.4.50 or later" in answer.err
    assert 'pip install --upgrade "orch[mavlink]"' in answer.err
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    ("changes", "key", "words"),
    [
        ({"mavlink.vehicle": {}}, "mavlink.vehicle", "did you mean 'vehicles'?"),
        ({"mavlink.vehicles": {"vehicel": 1}}, "mavlink.vehicles.vehicel", "did you mean 'vehicle'?"),
        ({"mavlink.vehicles": {"controller": 1}}, "mavlink.vehicles.controller", "is not a vehicle"),
        ({"mavlink.vehicles": {"vehicle": 255}}, "mavlink.vehicles.vehicle", "from 1 to 250"),
        ({"mavlink.origin": {"lat": 95, "lon": 0}}, "mavlink.origin.lat", "from -89 to 89"),
        ({"mavlink.origin": {"lat": 5, "lng": 0}}, "mavlink.origin.lng", "did you mean"),
        ({"mavlink.vehicles": {"vehicle": 1, "controller": 1}}, "mavlink.vehicles.controller", "1 already"),
        ({"mavlink.vehicles": 1}, "mavlink.vehicles", "not a table"),
        ({"mavlink": 1}, "mavlink", "not a table"),
        ({"mavlink.pwm_map": "t200"}, "mavlink.pwm_map", "did you mean 't200_16V'?"),
        ({"mavlink.rates": {"EXTRA1": 900}}, "mavlink.rates.EXTRA1", "0 to 50 Hz"),
    ],
)
def test_problems_of_the_section_are_reported_with_what_was_meant(problems, spiral, changes, key, words):
    assert any(words in what for where, what in problems(merged(spiral, changes)) if where == key)


def test_a_component_whose_fmu_cannot_be_read_may_be_a_vehicle(problems, spiral):
    """Its FMU is the one problem."""
    changes = {"mavlink.vehicles": {"vehicle": 1}, "components.vehicle.fmu": "missing.fmu", "metrics": {}}
    assert [key for key, _ in problems(merged(spiral, changes))] == ["components.vehicle.fmu"]


def test_system_ids_origin_and_pwm_come_from_the_experiment(run, spiral, write):
    table = merged(
        spiral,
        {
            "mavlink": {
                "vehicles": {"vehicle": 7},
                "origin": {"lat": -10, "lon": 20},
                "pwm_map": "t200_16V",
                "rates": {"EXTRA1": 25},
            },
            "master.stop_time": 1.5,
        },
    )
    listener = Station.udpin(port := free_port())
    run("--mavlink", f"udpout:127.0.0.1:{port}", "--realtime", "--quiet", experiment=str(write(table)))
    servo = listener.expect("SERVO_OUTPUT_RAW", system=7, seconds=20)
    pulses = [getattr(servo, f"servo{n}_raw") for n in range(1, 7)]
    assert all(pulse == 1500 or not 1472 < pulse < 1528 for pulse in pulses)
    home = listener.expect("HOME_POSITION", system=7)
    assert (home.latitude, home.longitude) == (-100_000_000, 200_000_000)
    assert len(named("ATTITUDE")(listener.messages, 7)) >= 15
    listener.close()


def test_a_matrix_that_is_no_vectored_frame_does_not_start(orch):
    answer = orch("run", GRIPPING, "--mavlink", "udpin:127.0.0.1:9", "--set", "components.vehicle1.parameters.d_psi=0")
    assert answer.code == 2
    assert "mavlink.vehicles.vehicle1: its thruster matrix is not that of a vectored frame" in answer.err


def test_signed_frames_go_out_and_only_signed_ones_count(run, tmp_path):
    (tmp_path / "key").write_text("open sesame\n")
    key = hashlib.sha256(b"open sesame").digest()
    port = free_port()
    run(
        "--set",
        "master.stop_time=5",
        "--quiet",
        "--mavlink",
        f"udpin:127.0.0.1:{port}",
        "--mavlink-key",
        "key",
        "--realtime",
    )
    friend = _noticed(port, key=key)
    beat = friend.expect("HEARTBEAT")
    assert beat.get_signed()
    assert friend.command(*VERSION) == mavlink.MAV_RESULT_ACCEPTED
    stranger = _noticed(port)
    stranger.send(command_long(*VERSION))
    assert named("COMMAND_ACK")(stranger.listen(0.5), 1) == []
    friend.close()
    stranger.close()


def _noticed(port, **options):
    station = Station.udpout(port, **options)
    for _ in range(100):
        if station.receive(0.2):
            return station
        station.heartbeat()
    raise AssertionError("nobody answers")


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="no pseudo-terminals")
def test_a_serial_line_carries_the_same_frames(run):
    ours, theirs = pty.openpty()
    run("--set", "master.stop_time=2", "--quiet", "--realtime", "--mavlink", f"serial:{os.ttyname(theirs)}:115200")
    parser, kinds, end = mavlink.MAVLink(None), set(), time.monotonic() + 20
    parser.robust_parsing = True
    while len(kinds) < 10 and time.monotonic() < end:
        kinds |= {(m.get_srcSystem(), m.get_type()) for m in parser.parse_buffer(os.read(ours, 4096)) or []}
    assert {(1, "HEARTBEAT"), (2, "HEARTBEAT")} <= kinds
    os.close(ours)
    os.close(theirs)


def test_a_telemetry_log_is_the_same_whether_written_with_the_run_or_of_its_record(orch, tmp_path):
    options = ["--set", "master.stop_time=3", "--output", "run.h5"]
    assert orch("run", GRIPPING, *options, "--tlog", "with.tlog").code == 0
    assert orch("export", "run.h5", "--format", "tlog", "-o", "of.tlog").code == 0
    content = (tmp_path / "with.tlog").read_bytes()
    assert content == (tmp_path / "of.tlog").read_bytes()
    log = mavutil.mavlink_connection(str(tmp_path / "with.tlog"), dialect="ardupilotmega")
    messages = []
    while (message := log.recv_match()) is not None:
        messages.append(message)
    assert "BAD_DATA" not in {m.get_type() for m in messages}
    record = datasets(tmp_path / "run.h5")
    for system in (1, 2):
        attitude = named("ATTITUDE")(messages, system)
        assert len(attitude) == 31
        yaw = record[f"vehicle{system}/eta.psi"][[round(m.time_boot_ms / 10) for m in attitude]]
        assert [m.yaw for m in attitude] == pytest.approx(np.angle(np.exp(1j * yaw)).tolist(), abs=1e-6)
        assert len(named("PARAM_VALUE")(messages, system)) > 200
        assert any(getattr(m, "servo1_raw", 1500) != 1500 for m in named("SERVO_OUTPUT_RAW")(messages, system))
    assert messages[-1]._timestamp - messages[0]._timestamp == pytest.approx(3.0, abs=0.01)


def test_a_record_without_velocities_gives_no_telemetry_log_and_says_why(orch):
    options = ["--set", "master.stop_time=0.1", "--set", 'record.signals=["*.eta.*"]', "--set", "metrics={}"]
    assert orch("run", GRIPPING, *options, "--output", "run.h5").code == 0
    answer = orch("export", "run.h5", "--format", "tlog")
    assert answer.code == 2
    assert "does not record vehicle1.nu" in answer.err


def test_samples_are_at_whole_milliseconds_where_the_step_is_none(run, spiral, write, tmp_path):
    table = merged(spiral, {"master.step": 3e-4, "record.every": 3e-4, "master.stop_time": 0.9, "metrics": {}})
    listener = Station.udpin(port := free_port())
    process = run(
        "--mavlink",
        f"udpout:127.0.0.1:{port}",
        "--realtime",
        "--quiet",
        "--output",
        "run.h5",
        experiment=str(write(table)),
    )
    while process.poll() is None:
        listener.receive(0.1)
    record, messages = datasets(tmp_path / "run.h5"), named("ATTITUDE")(listener.messages, 1)
    assert len(messages) >= 6
    assert {m.time_boot_ms % 3 for m in messages} == {0}
    assert [m.yawspeed for m in messages] == [
        np.float32(record["vehicle/nu.r"][round(m.time_boot_ms / 0.3)]) for m in messages
    ]
    listener.close()


def test_what_a_deaf_client_leaves_is_dropped_as_whole_frames():
    from collections import Counter

    from orchestrator.mavlink.protocol import links

    endpoint = links.Endpoint.parse(f"tcpin:127.0.0.1:{free_port(socket.SOCK_STREAM)}")
    counts = Counter()
    link = links.open_link(endpoint, counts)
    client = socket.create_connection(("127.0.0.1", endpoint.number))
    while not link.peers:
        list(link.receive(0.0))
    frames = [bytes([n % 251]) * 1000 for n in range(20_000)]
    began = time.monotonic()
    for frame in frames:
        link.send(link.peers[0], frame)
    assert time.monotonic() - began < 5
    assert 0 < counts["frames dropped"] < len(frames)
    client.settimeout(1)
    received = b""
    while True:
        list(link.receive(0.0))
        try:
            received += client.recv(1 << 20)
        except TimeoutError:
            break
    assert len(received) == 1000 * (len(frames) - counts["frames dropped"])
    assert all(len(set(received[i : i + 1000])) == 1 for i in range(0, len(received), 1000))
    client.close()
    link.close()


def test_partners_are_heard_up_to_a_number_and_forgotten_when_silent():
    from collections import Counter

    from orchestrator.mavlink.protocol import links

    endpoint = links.Endpoint.parse(f"udpin:127.0.0.1:{free_port()}")
    counts = Counter()
    link = links.open_link(endpoint, counts)
    crowd = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(links.MOST_PEERS + 4)]
    for stranger in crowd:
        stranger.sendto(b"hello", ("127.0.0.1", endpoint.number))
    heard = SimpleNamespace(all=[])
    for now in (0.0, 0.1, 0.2):
        heard.all += [peer for peer, _ in link.receive(now)]
    assert len(heard.all) == len(crowd)
    assert len(link.peers) == links.MOST_PEERS
    list(link.receive(links.FORGET + 1))
    assert link.peers == []
    link.close()
    for stranger in crowd:
        stranger.close()
