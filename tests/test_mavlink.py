"""The bridge during a run: what ground stations see, ask for and get.  One run in real time serves all tests."""

import itertools
import math
import signal
import socket
import subprocess
import time
from types import SimpleNamespace

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from commands import ORCH
from experiments import EXPERIMENTS
from peers.station import GROUND_STATION, Station, command_long, free_port, ftp_answer, named, to, unpacked

ACCEPTED, FAILED = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_FAILED
UNKNOWN_MESSAGE, UNKNOWN_COMMAND = 77777, 4711
ATTITUDE = mavlink.MAVLINK_MSG_ID_ATTITUDE
VERSION = (mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
ACK, NAK = mavlink.MAV_FTP_OPCODE_ACK, mavlink.MAV_FTP_OPCODE_NAK
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
    station = Station.udpout(bridge.udpin)
    for _ in range(100):
        station.heartbeat()
        if station.receive(0.2):
            break
    assert station.messages, bridge.process.poll()
    yield station
    station.close()


def test_both_vehicles_are_ardusub_submarines_that_send_at_ardusubs_rates(station):
    station.listen(0.2)
    station.messages.clear()
    messages = station.listen(seconds := 2.0)
    for system in (1, 2):
        beat = named("HEARTBEAT")(messages, system)[0]
        assert (beat.type, beat.autopilot) == (mavlink.MAV_TYPE_SUBMARINE, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA)
        assert beat.get_srcComponent() == mavlink.MAV_COMP_ID_AUTOPILOT1
        assert beat.system_status == mavlink.MAV_STATE_ACTIVE
        assert beat.custom_mode == mavlink.SUB_MODE_GUIDED
        assert beat.base_mode == (
            mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
            | mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
            | mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
            | mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        )
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
    sent = [m for m in messages if m.get_srcSystem() == 1 and m.get_type() in ("VFR_HUD", "ATTITUDE")]
    compared = 0
    for before, hud, after in zip(sent, sent[1:], sent[2:], strict=False):
        if [m.get_type() for m in (before, hud, after)] == ["ATTITUDE", "VFR_HUD", "ATTITUDE"]:
            start = math.degrees(before.yaw)
            turned, heading = ((x - start + 180) % 360 - 180 for x in (math.degrees(after.yaw), hud.heading))
            assert min(0.0, turned) - 1.0 <= heading <= max(0.0, turned) + 1.0
            compared += 1
    assert compared


def test_a_message_is_sent_on_request_and_an_unknown_one_is_refused(station):
    for kind in (
        "AUTOPILOT_VERSION",
        "HOME_POSITION",
        "EXTENDED_SYS_STATE",
        "GPS_GLOBAL_ORIGIN",
        "ATTITUDE_QUATERNION",
        "ATTITUDE",
    ):
        number = getattr(mavlink, f"MAVLINK_MSG_ID_{kind}")
        assert station.command(mavlink.MAV_CMD_REQUEST_MESSAGE, number) == ACCEPTED
        station.expect(kind, seconds=0.5)
    # QGroundControl asks for these three, which are not of ArduPilot's dialect, and goes on when they are refused.
    available_modes, component_metadata, component_information = 435, 397, 395
    for number in (available_modes, component_metadata, component_information, UNKNOWN_MESSAGE, -1, math.nan):
        assert station.command(mavlink.MAV_CMD_REQUEST_MESSAGE, number) == FAILED
    assert station.command(mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES) == ACCEPTED
    version = station.expect("AUTOPILOT_VERSION", seconds=0.5)
    has = (
        mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
        | mavlink.MAV_PROTOCOL_CAPABILITY_FTP
        | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
        | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
    )
    lacks = (
        mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
        | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
        | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
    )
    assert version.capabilities & has == has
    assert not version.capabilities & lacks


def test_every_command_is_acknowledged(station):
    assert station.command(mavlink.MAV_CMD_REQUEST_PROTOCOL_VERSION) == mavlink.MAV_RESULT_UNSUPPORTED
    assert station.command(UNKNOWN_COMMAND) == mavlink.MAV_RESULT_UNSUPPORTED
    assert station.command(mavlink.MAV_CMD_DO_SET_HOME) == FAILED
    assert station.command(mavlink.MAV_CMD_GET_HOME_POSITION) == ACCEPTED
    station.expect("HOME_POSITION", seconds=0.5)
    request = mavlink.MAVLink_command_int_message(
        **to(),
        frame=mavlink.MAV_FRAME_GLOBAL,
        command=mavlink.MAV_CMD_REQUEST_MESSAGE,
        current=0,
        autocontinue=0,
        param1=ATTITUDE,
        param2=0,
        param3=0,
        param4=0,
        x=0,
        y=0,
        z=0,
    )
    assert station.ask(request, "COMMAND_ACK").result == ACCEPTED
    assert station.command(mavlink.MAV_CMD_GET_HOME_POSITION, system=2) == ACCEPTED


def test_intervals_are_set_reported_and_kept(station):
    set_interval, get_interval = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_GET_MESSAGE_INTERVAL
    default, disabled = 0, -1
    assert station.command(set_interval, ATTITUDE, 20_000) == ACCEPTED
    assert station.command(get_interval, ATTITUDE) == ACCEPTED
    assert station.expect("MESSAGE_INTERVAL", seconds=0.5).interval_us == 20_000
    assert len(named("ATTITUDE")(station.listen(1.0), 1)) == pytest.approx(50, abs=10)
    assert station.command(set_interval, ATTITUDE, disabled) == ACCEPTED
    station.listen(0.1)
    assert named("ATTITUDE")(station.listen(0.5), 1) == []
    assert len(named("ATTITUDE")(station.messages, 2)) > 5  # of the other vehicle, they go on
    assert station.command(set_interval, ATTITUDE, default) == ACCEPTED
    assert station.command(set_interval, UNKNOWN_MESSAGE, 1e5) == FAILED
    assert station.command(set_interval, ATTITUDE, math.nan) == FAILED
    assert station.command(get_interval, -1) == FAILED
    assert station.command(get_interval, 60000) == FAILED


def test_streams_stop_and_start(station):
    for start, rate, expected in ((0, 4, 0), (1, 4, 3)):
        station.send(
            mavlink.MAVLink_request_data_stream_message(
                **to(), req_stream_id=mavlink.MAV_DATA_STREAM_ALL, req_message_rate=rate, start_stop=start
            )
        )
        station.listen(0.1)
        assert len(named("VFR_HUD")(station.listen(0.75), 1)) == pytest.approx(expected, abs=1)


def test_mode_and_arming_show_in_the_heartbeat(station):
    custom = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    guided, armed = mavlink.MAV_MODE_FLAG_GUIDED_ENABLED, mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    arm, disarm, no_mode = 1, 0, 5
    # Nobody steers this vehicle: another mode would be a label only.
    assert station.command(mavlink.MAV_CMD_DO_SET_MODE, custom, mavlink.SUB_MODE_POSHOLD) == FAILED
    assert station.command(mavlink.MAV_CMD_DO_SET_MODE, custom, no_mode) == FAILED
    assert station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, disarm) == FAILED  # the experiment drives the vehicle
    assert station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, arm) == ACCEPTED
    manual = mavlink.MAVLink_set_mode_message(target_system=1, base_mode=custom, custom_mode=mavlink.SUB_MODE_MANUAL)
    assert station.ask(manual, "COMMAND_ACK", lambda m: m.command == manual.get_msgId()).result == FAILED
    assert station.command(mavlink.MAV_CMD_DO_SET_MODE, custom, mavlink.SUB_MODE_GUIDED) == ACCEPTED
    beat = station.expect("HEARTBEAT", seconds=1.5)
    assert beat.custom_mode == mavlink.SUB_MODE_GUIDED
    assert beat.base_mode & (guided | armed) == guided | armed


def test_parameters_come_as_a_list_and_as_a_file_alike(station):
    station.send(mavlink.MAVLink_param_request_list_message(**to()))
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
    request = station.ftp(mavlink.MAV_FTP_OPCODE_OPENFILERO, name, seq=7, session=3)
    opened = ftp_answer(station.ask(request, "FILE_TRANSFER_PROTOCOL"))
    assert (opened.opcode, opened.asked) == (ACK, mavlink.MAV_FTP_OPCODE_OPENFILERO)
    assert (opened.seq, opened.session) == (8, 3)
    station.send(station.ftp(mavlink.MAV_FTP_OPCODE_BURSTREADFILE, size=239, seq=20))
    answers = []
    while not answers or answers[-1].opcode != NAK:
        answers.append(ftp_answer(station.expect("FILE_TRANSFER_PROTOCOL")))
    assert [a.seq for a in answers] == list(range(21, 21 + len(answers)))
    assert [a.complete for a in answers[:-1]] == [0] * (len(answers) - 2) + [1]
    assert answers[-1].data == bytes([mavlink.MAV_FTP_ERR_EOF])
    content = b"".join(a.data for a in answers[:-1])
    assert len(content) == int.from_bytes(opened.data, "little")
    types = {  # of param.pck
        mavlink.MAV_PARAM_TYPE_INT8: 1,
        mavlink.MAV_PARAM_TYPE_INT16: 2,
        mavlink.MAV_PARAM_TYPE_INT32: 3,
        mavlink.MAV_PARAM_TYPE_REAL32: 4,
    }
    packed = unpacked(content)
    assert packed == {n: (types[m.param_type], pytest.approx(m.param_value)) for n, m in listed.items()}
    assert packed["FRAME_CONFIG"][1] == packed["SYSID_THISMAV"][1] == 1
    not_found, unknown = mavlink.MAV_FTP_ERR_FILENOTFOUND, mavlink.MAV_FTP_ERR_UNKNOWNCOMMAND
    for request, opcode, data in (
        (station.ftp(mavlink.MAV_FTP_OPCODE_OPENFILERO, b"@SYS/uptime"), NAK, [not_found]),
        (station.ftp(mavlink.MAV_FTP_OPCODE_LISTDIRECTORY, b"/"), NAK, [not_found]),
        (station.ftp(99), NAK, [unknown]),
        (station.ftp(mavlink.MAV_FTP_OPCODE_TERMINATESESSION), ACK, []),
        (station.ftp(mavlink.MAV_FTP_OPCODE_RESETSESSION), ACK, []),
    ):
        answer = ftp_answer(station.ask(request, "FILE_TRANSFER_PROTOCOL"))
        assert (answer.opcode, answer.data) == (opcode, bytes(data))


def test_a_parameter_is_set_as_its_own_type_and_nonsense_is_not(station):
    def put(name, value):
        request = mavlink.MAVLink_param_set_message(
            **to(), param_id=name, param_value=value, param_type=mavlink.MAV_PARAM_TYPE_REAL32
        )
        return station.ask(request, "PARAM_VALUE")

    def get(name, system):
        by_name = -1
        request = mavlink.MAVLink_param_request_read_message(**to(system), param_id=name, param_index=by_name)
        return station.ask(request, "PARAM_VALUE", system=system).param_value

    assert put(b"JS_GAIN_DEFAULT", 0.75).param_value == 0.75
    assert put(b"JS_GAIN_DEFAULT", math.nan).param_value == 0.75
    assert put(b"JS_GAIN_DEFAULT", math.inf).param_value == 0.75
    assert (answer := put(b"FS_GCS_ENABLE", 1.7)).param_value == 2
    assert answer.param_type == mavlink.MAV_PARAM_TYPE_INT8
    assert put(b"FS_GCS_ENABLE", 1e30).param_value == 127
    assert put(b"SYSID_THISMAV", 9).param_value == 1
    assert get(b"FS_PILOT_TIMEOUT", 1) == 3
    assert get(b"FS_GCS_ENABLE", 2) == 0  # the other vehicle's


def test_missions_logs_pings_and_clocks_are_answered(station):
    mission, fence, rally = (getattr(mavlink, f"MAV_MISSION_TYPE_{name}") for name in ("MISSION", "FENCE", "RALLY"))
    for kind in (mission, fence, rally):
        request = mavlink.MAVLink_mission_request_list_message(**to(), mission_type=kind)
        count = station.ask(request, "MISSION_COUNT")
        assert (count.count, count.mission_type) == (0, kind)
        assert (count.target_system, count.target_component) == (GROUND_STATION, station.mav.srcComponent)
    for request, result in (
        (mavlink.MAVLink_mission_clear_all_message(**to(), mission_type=mission), mavlink.MAV_MISSION_ACCEPTED),
        (
            mavlink.MAVLink_mission_count_message(**to(), count=3, mission_type=mission),
            mavlink.MAV_MISSION_UNSUPPORTED,
        ),
        (
            mavlink.MAVLink_mission_request_int_message(**to(), seq=0, mission_type=mission),
            mavlink.MAV_MISSION_INVALID_SEQUENCE,
        ),
    ):
        assert station.ask(request, "MISSION_ACK").type == result
    logs = mavlink.MAVLink_log_request_list_message(**to(), start=0, end=65535)
    assert station.ask(logs, "LOG_ENTRY").num_logs == 0
    clock = mavlink.MAVLink_timesync_message(tc1=0, ts1=4242)
    assert station.ask(clock, "TIMESYNC", lambda m: m.ts1 == 4242).tc1 > 0
    ping = mavlink.MAVLink_ping_message(time_usec=5, seq=6, **to(system=0, component=0))
    assert station.ask(ping, "PING").target_system == GROUND_STATION


def test_what_is_for_somebody_else_is_not_answered(station):
    station.listen(0.1)
    for system, component in ((3, mavlink.MAV_COMP_ID_AUTOPILOT1), (1, mavlink.MAV_COMP_ID_CAMERA)):
        request = command_long(mavlink.MAV_CMD_REQUEST_MESSAGE, ATTITUDE, system=system, component=component)
        station.send(request)
    assert named("COMMAND_ACK")(station.listen(0.5), 1) == []


def test_signed_frames_are_dropped_where_nobody_knows_the_key(bridge, station):
    signing = Station.udpout(bridge.udpin, key=b"k" * 32)
    signing.send(command_long(*VERSION))
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
    assert reader.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, ATTITUDE, 1000) == ACCEPTED
    assert named("HEARTBEAT")(reader.listen(1.5), 1)
    assert reader.command(*VERSION) == ACCEPTED
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
    assert station.command(*VERSION, system=2) == ACCEPTED
