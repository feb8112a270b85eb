"""The bridge while a run goes on: what ground stations see, ask and get.  One run in real time serves all of it."""

import itertools
import math
import signal
import socket
import subprocess
import time
from types import SimpleNamespace

import pytest
from conftest import EXPERIMENTS, ORCH
from peers.station import Station, free_port, ftp_answer, named, unpacked
from pymavlink.dialects.v20 import ardupilotmega as mavlink

ACCEPTED, UNSUPPORTED, FAILED = 0, 3, 4
RATES = {  # Hz: ArduSub's
    "HEARTBEAT": 1,
    "RAW_IMU": 2,
    "SCALED_IMU2": 2,
    "SCALED_PRESSURE": 2,
    "SCALED_PRESSURE2": 2,
    "SCALED_PRESSURE3": 2,
    "SYS_STATUS": 2,
    "POWER_STATUS": 2,
    "MEMINFO": 2,
    "MISSION_CURRENT": 2,
    "NAV_CONTROLLER_OUTPUT": 2,
    "GPS_RAW_INT": 2,
    "NAMED_VALUE_FLOAT": 18,
    "SERVO_OUTPUT_RAW": 2,
    "RC_CHANNELS": 2,
    "GLOBAL_POSITION_INT": 3,
    "LOCAL_POSITION_NED": 3,
    "ATTITUDE": 10,
    "AHRS2": 10,
    "VFR_HUD": 10,
    "AHRS": 3,
    "SYSTEM_TIME": 3,
    "BATTERY_STATUS": 3,
    "EKF_STATUS_REPORT": 3,
    "VIBRATION": 3,
    "HOME_POSITION": 1,
}


@pytest.fixture(scope="module")
def bridge(shipped, tmp_path_factory):
    """A run in real time with one port of each kind; `process` ends with the module."""
    folder = tmp_path_factory.mktemp("bridge")
    ports = SimpleNamespace(udpin=free_port(), tcp=free_port(socket.SOCK_STREAM), one=free_port(), folder=folder)
    command = [
        ORCH,
        "run",
        str(EXPERIMENTS / "gripping_currents.toml"),
        "--realtime",
        "--quiet",
        "--output",
        "run.h5",
        "--mavlink",
        f"udpin:127.0.0.1:{ports.udpin}",
        "--mavlink",
        f"tcpin:127.0.0.1:{ports.tcp}",
        "--mavlink",
        f"2=udpin:127.0.0.1:{ports.one}",
        "--set",
        "master.stop_time=120",
    ]
    ports.process = subprocess.Popen(command, cwd=folder, stderr=subprocess.PIPE, text=True)
    yield ports
    ports.process.send_signal(signal.SIGINT)
    assert "Traceback" not in ports.process.communicate(timeout=30)[1]


@pytest.fixture
def station(bridge):
    """A station that the bridge has noticed."""
    found = Station.udpout(bridge.udpin)
    for _ in range(100):
        found.heartbeat()
        if found.receive(0.2):
            break
    assert found.messages, bridge.process.poll()
    yield found
    found.close()


def test_both_vehicles_are_ardusub_submarines_that_send_at_ardusubs_rates(station):
    station.listen(0.2)
    station.messages.clear()
    messages = station.listen(seconds := 2.0)
    for system in (1, 2):
        beat = named("HEARTBEAT")(messages, system)[0]
        assert (beat.type, beat.autopilot, beat.get_srcComponent(), beat.system_status) == (12, 3, 1, 4)
        assert (beat.base_mode, beat.custom_mode) == (1 | 16 | 64 | 8 | 128, 4)  # armed, GUIDED
        counts = {kind: len(named(kind)(messages, system)) for kind in RATES}
        # A busy machine shifts a message across the border of the window, of nine names nine.
        slack = {kind: 9 if kind == "NAMED_VALUE_FLOAT" else max(1, 0.2 * seconds * hz) for kind, hz in RATES.items()}
        assert {kind: n for kind, n in counts.items() if abs(n - seconds * RATES[kind]) > slack[kind]} == {}
    assert station.lost == 0
    assert {m.get_type() for m in messages} == set(RATES)


def test_every_field_says_the_same_of_the_vehicle(station):
    """Units, signs and ranges, against LOCAL_POSITION_NED and ATTITUDE of the same stream."""
    messages = station.listen(1.1)
    kinds = ("LOCAL_POSITION_NED", "GLOBAL_POSITION_INT")
    place, ball = (named(kind)(messages, 1)[-1] for kind in kinds)
    assert ball.time_boot_ms == place.time_boot_ms
    assert ball.alt == ball.relative_alt == pytest.approx(-1000 * place.z, abs=1)
    assert (ball.vx, ball.vy, ball.vz) == pytest.approx((100 * place.vx, 100 * place.vy, 100 * place.vz), abs=1)
    assert (ball.lat - 446500000) * 0.0111319 == pytest.approx(place.x, abs=0.02)
    assert (ball.lon + 1240500000) * 0.0111319 * math.cos(math.radians(44.65)) == pytest.approx(place.y, abs=0.02)
    hud = named("VFR_HUD")(messages, 1)[-1]
    assert_heading_between_attitudes(messages)
    assert hud.alt == pytest.approx(-place.z, abs=0.5)
    imu, depth = named("RAW_IMU")(messages, 1)[-1], named("SCALED_PRESSURE2")(messages, 1)[-1]
    assert imu.zacc == pytest.approx(-1000, abs=150)
    assert depth.press_abs == pytest.approx(1013.25 + 100.52 * place.z, abs=30)
    names = {m.name for m in named("NAMED_VALUE_FLOAT")(messages, 1)}
    assert names == {
        "CamTilt",
        "CamPan",
        "TetherTrn",
        "Lights1",
        "Lights2",
        "PilotGain",
        "InputHold",
        "RollPitch",
        "RFTarget",
    }
    servo = named("SERVO_OUTPUT_RAW")(messages, 1)[-1]
    assert all(1100 <= getattr(servo, f"servo{n}_raw") <= 1900 for n in range(1, 7))
    assert all(getattr(servo, f"servo{n}_raw") == 0 for n in range(7, 17))


def assert_heading_between_attitudes(messages):
    """VFR_HUD has no time: its heading, in whole degrees, lies between those of ATTITUDE before and after it."""
    told = [m for m in messages if m.get_srcSystem() == 1 and m.get_type() in ("VFR_HUD", "ATTITUDE")]
    found = 0
    for before, hud, after in zip(told, told[1:], told[2:], strict=False):
        if [m.get_type() for m in (before, hud, after)] == ["ATTITUDE", "VFR_HUD", "ATTITUDE"]:
            start = math.degrees(before.yaw)
            turned, heading = ((x - start + 180) % 360 - 180 for x in (math.degrees(after.yaw), hud.heading))
            assert min(0.0, turned) - 1.0 <= heading <= max(0.0, turned) + 1.0
            found += 1
    assert found


def test_a_message_is_had_for_the_asking_and_an_unknown_one_is_refused(station):
    for number, kind in (
        (148, "AUTOPILOT_VERSION"),
        (242, "HOME_POSITION"),
        (245, "EXTENDED_SYS_STATE"),
        (49, "GPS_GLOBAL_ORIGIN"),
        (31, "ATTITUDE_QUATERNION"),
        (30, "ATTITUDE"),
    ):
        assert station.command(512, number) == ACCEPTED
        station.expect(kind, seconds=0.5)
    for number in (435, 397, 395, 77777, -1, math.nan):
        assert station.command(512, number) == FAILED
    assert station.command(520) == ACCEPTED
    version = station.expect("AUTOPILOT_VERSION", seconds=0.5)
    assert version.capabilities & (2 | 32 | 8192 | 131072) == 2 | 32 | 8192 | 131072
    assert not version.capabilities & (16 | 16384 | 32768)


def test_every_command_is_acknowledged(station):
    assert station.command(519) == UNSUPPORTED
    assert station.command(179) == FAILED
    assert station.command(4711) == UNSUPPORTED
    assert station.command(410) == ACCEPTED
    station.expect("HOME_POSITION", seconds=0.5)
    position = mavlink.MAVLink_command_int_message(1, 1, 0, 512, 0, 0, 30, 0, 0, 0, 0, 0, 0)
    assert station.ask(position, "COMMAND_ACK").result == ACCEPTED
    assert station.command(410, system=2) == ACCEPTED


def test_intervals_are_set_told_and_kept(station):
    assert station.command(511, 30, 20_000) == ACCEPTED
    assert station.command(510, 30) == ACCEPTED
    assert station.expect("MESSAGE_INTERVAL", seconds=0.5).interval_us == 20_000
    assert len(named("ATTITUDE")(station.listen(1.0), 1)) == pytest.approx(50, abs=10)
    assert station.command(511, 30, -1) == ACCEPTED
    station.listen(0.1)
    assert named("ATTITUDE")(station.listen(0.5), 1) == []
    assert len(named("ATTITUDE")(station.messages, 2)) > 5  # of the other vehicle, they go on
    assert station.command(511, 30, 0) == ACCEPTED
    assert station.command(511, 77777, 1e5) == FAILED
    assert station.command(511, 30, math.nan) == FAILED
    assert station.command(510, -1) == FAILED
    assert station.command(510, 60000) == FAILED


def test_streams_stop_and_start(station):
    for start, rate, expected in ((0, 4, 0), (1, 4, 3)):
        station.send(mavlink.MAVLink_request_data_stream_message(1, 1, 0, rate, start))
        station.listen(0.1)
        assert len(named("VFR_HUD")(station.listen(0.75), 1)) == pytest.approx(expected, abs=1)


def test_mode_and_arming_show_in_the_heartbeat(station):
    assert station.command(176, 1, 16) == ACCEPTED
    station.expect("HEARTBEAT", lambda m: m.custom_mode == 16 and m.base_mode & 8, seconds=0.5)
    assert station.command(176, 1, 5) == FAILED
    assert station.command(400, 0) == FAILED  # the experiment drives the vehicle
    assert station.command(400, 1) == ACCEPTED
    station.send(mavlink.MAVLink_set_mode_message(1, 1, 19))
    beat = station.expect("HEARTBEAT", lambda m: m.custom_mode == 19, seconds=0.5)
    assert beat.base_mode & (8 | 128) == 128
    assert station.command(176, 1, 4) == ACCEPTED


def test_parameters_come_as_a_list_and_as_a_file_alike(station):
    station.send(mavlink.MAVLink_param_request_list_message(1, 1))
    listed, count = {}, 1
    while len(listed) < count:
        message = station.expect("PARAM_VALUE")
        listed[message.param_id], count = message, message.param_count
    texts = [m.text for m in named("STATUSTEXT")(station.messages, 1)]
    assert "Frame: VECTORED" in texts
    assert texts[0].startswith("ArduSub V")
    assert count >= 200
    assert sorted(m.param_index for m in listed.values()) == list(range(count))
    name = b"@PARAM/param.pck?withdefaults=1"
    opened = ftp_answer(station.ask(station.ftp(4, name, seq=7), "FILE_TRANSFER_PROTOCOL"))
    assert (opened.opcode, opened.seq, opened.session, opened.asked) == (128, 8, 3, 4)
    station.send(station.ftp(15, size=239, seq=20))
    answers = []
    while not answers or answers[-1].opcode != 129:
        answers.append(ftp_answer(station.expect("FILE_TRANSFER_PROTOCOL")))
    assert [a.seq for a in answers] == list(range(21, 21 + len(answers)))
    assert [a.complete for a in answers[:-1]] == [0] * (len(answers) - 2) + [1]
    assert answers[-1].data == b"\x06"  # end of file
    content = b"".join(a.data for a in answers[:-1])
    assert len(content) == int.from_bytes(opened.data, "little")
    types = {2: 1, 4: 2, 6: 3, 9: 4}  # MAV_PARAM_TYPE to param.pck's
    packed = unpacked(content)
    assert packed == {n: (types[m.param_type], pytest.approx(m.param_value)) for n, m in listed.items()}
    assert packed["FRAME_CONFIG"][1] == packed["SYSID_THISMAV"][1] == 1
    refused = [station.ftp(4, b"@SYS/uptime"), station.ftp(3, b"/"), station.ftp(99), station.ftp(1), station.ftp(2)]
    answers = [ftp_answer(station.ask(m, "FILE_TRANSFER_PROTOCOL")) for m in refused]
    codes = [(129, b"\x0a"), (129, b"\x0a"), (129, b"\x07"), (128, b""), (128, b"")]
    assert [(a.opcode, a.data) for a in answers] == codes


def test_a_parameter_is_set_as_its_own_type_and_nonsense_is_not(station):
    def put(name, value):
        return station.ask(mavlink.MAVLink_param_set_message(1, 1, name, value, 9), "PARAM_VALUE")

    assert put(b"JS_GAIN_DEFAULT", 0.75).param_value == 0.75
    assert put(b"JS_GAIN_DEFAULT", math.nan).param_value == 0.75
    assert put(b"JS_GAIN_DEFAULT", math.inf).param_value == 0.75
    assert (answer := put(b"FS_GCS_ENABLE", 1.7)).param_value == 2
    assert answer.param_type == 2
    assert put(b"FS_GCS_ENABLE", 1e30).param_value == 127
    assert put(b"SYSID_THISMAV", 9).param_value == 1
    read = mavlink.MAVLink_param_request_read_message(1, 1, b"FS_PILOT_TIMEOUT", -1)
    assert station.ask(read, "PARAM_VALUE").param_value == 3
    other = mavlink.MAVLink_param_request_read_message(2, 1, b"FS_GCS_ENABLE", -1)
    assert station.ask(other, "PARAM_VALUE", system=2).param_value == 0  # the other vehicle's


def test_missions_logs_pings_and_clocks_are_answered(station):
    for kind in (0, 1, 2):
        count = station.ask(mavlink.MAVLink_mission_request_list_message(1, 1, kind), "MISSION_COUNT")
        assert (count.count, count.mission_type, count.target_system, count.target_component) == (0, kind, 255, 190)
    for message, result in (
        (mavlink.MAVLink_mission_clear_all_message(1, 1, 0), 0),
        (mavlink.MAVLink_mission_count_message(1, 1, 3, 0), 3),
        (mavlink.MAVLink_mission_request_int_message(1, 1, 0, 0), 13),
    ):
        assert station.ask(message, "MISSION_ACK").type == result
    assert station.ask(mavlink.MAVLink_log_request_list_message(1, 1, 0, 65535), "LOG_ENTRY").num_logs == 0
    assert station.ask(mavlink.MAVLink_timesync_message(0, 4242), "TIMESYNC", lambda m: m.ts1 == 4242).tc1 > 0
    assert station.ask(mavlink.MAVLink_ping_message(5, 6, 0, 0), "PING").target_system == 255


def test_what_is_for_somebody_else_is_not_answered(station):
    station.listen(0.1)
    for system, component in ((3, 1), (1, 100)):
        station.send(mavlink.MAVLink_command_long_message(system, component, 512, 0, 30, 0, 0, 0, 0, 0, 0))
    assert named("COMMAND_ACK")(station.listen(0.5), 1) == []


def test_signed_frames_are_dropped_where_nobody_knows_the_key(bridge, station):
    signing = Station.udpout(bridge.udpin, key=b"k" * 32)
    signing.send(mavlink.MAVLink_command_long_message(1, 1, 512, 0, 148, 0, 0, 0, 0, 0, 0))
    signing.socket.settimeout(0.3)
    parser, end = mavlink.MAVLink(None), time.monotonic() + 0.5
    kinds = set()
    while time.monotonic() < end:
        kinds |= {m.get_type() for m in parser.parse_buffer(signing.socket.recv(4096)) or []}
    assert "ATTITUDE" in kinds
    assert "COMMAND_ACK" not in kinds
    signing.close()


def test_an_endpoint_can_be_for_one_vehicle(bridge, station):
    alone = Station.udpout(bridge.one)
    alone.expect("HEARTBEAT", system=2)
    assert {m.get_srcSystem() for m in alone.listen(1.0)} == {2}
    alone.close()


def test_a_tcp_client_that_never_reads_holds_up_nobody(bridge, station):
    deaf = socket.create_connection(("127.0.0.1", bridge.tcp))
    deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    reader = Station.tcp(bridge.tcp)
    assert reader.command(511, 30, 1000) == ACCEPTED
    assert named("HEARTBEAT")(reader.listen(1.5), 1)
    assert reader.command(512, 148) == ACCEPTED
    assert reader.lost == 0
    deaf.close()
    reader.close()


@pytest.mark.parametrize("seconds", [1.0, pytest.param(10.0, marks=pytest.mark.slow)])
def test_junk_and_a_flood_of_requests_do_not_stop_the_heartbeat(bridge, station, seconds):
    from peers.flood import flood

    resident = flood(bridge.udpin, bridge.process.pid, seconds, station)
    beats = [
        t
        for m, t in zip(station.messages, station.times, strict=True)
        if m.get_type() == "HEARTBEAT" and m.get_srcSystem() == 2
    ]
    gaps = [b - a for a, b in itertools.pairwise([*beats, time.monotonic()])]
    assert max(gaps) < 1.5
    assert len(named("ATTITUDE")(station.listen(1.0), 2)) >= 8
    assert resident[-1] - resident[0] < 20_000  # kB
    assert station.command(512, 148, system=2) == ACCEPTED
