"""What a hostile, or broken, partner sends: junk, damaged frames and a thousand requests a second."""

import math
import os
import random
import socket
import time

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from .station import FTP, command_long, to

RATE = 1000  # datagrams a second


def flood(port, process, seconds, station):
    """Send for a while; meanwhile the station listens.  Returns the resident memory of the process over time [kB]."""
    chance, resident = random.Random(1), []
    encoder = mavlink.MAVLink(None, srcSystem=255, srcComponent=7)
    connection = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    connection.connect(("127.0.0.1", port))
    connection.setblocking(False)
    began, sent = time.monotonic(), 0
    while (now := time.monotonic() - began) < seconds:
        while sent < now * RATE:
            sent += 1
            try:
                connection.send(datagram(chance, encoder))
                connection.recv(1 << 16)
            except OSError:
                continue
        if sent % (RATE // 10) < 10:
            resident.append(resident_memory(process))
        station.receive(1e-3)
    connection.close()
    return resident


def datagram(chance, encoder):
    data = bytearray(request(chance).pack(encoder))
    encoder.seq = (encoder.seq + 1) % 256
    kind = chance.random()
    if kind < 0.1:
        data[chance.randrange(len(data))] ^= 0xFF
    elif kind < 0.15:
        data = bytearray(chance.randbytes(chance.randrange(1, 1400)))
    elif kind < 0.16:
        data = bytearray(chance.randbytes(60_000))
    elif kind < 0.17:
        data = bytearray(b"\xfd" * chance.randrange(60_000))
    elif kind < 0.18:
        data = bytearray(b"\xfd\x09\x00\x00\x01\x01\x01\x00\x00\x00" * chance.randrange(500))
    elif kind < 0.19:
        data[1] = 255
    return data


def request(chance):
    """One of many requests, with fields that make no sense."""
    odd = [math.nan, math.inf, -1.0, 1e30, 30.0, 148.0]
    commands = [
        mavlink.MAV_CMD_REQUEST_MESSAGE,
        mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
        mavlink.MAV_CMD_GET_MESSAGE_INTERVAL,
        mavlink.MAV_CMD_DO_SET_MODE,
        mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
        mavlink.MAV_CMD_DO_REPOSITION,
        mavlink.MAV_CMD_CONDITION_YAW,
        mavlink.MAV_CMD_DO_CHANGE_SPEED,
        mavlink.MAV_CMD_DO_FLIGHTTERMINATION,
        mavlink.MAV_CMD_NAV_LAND,
        mavlink.MAV_CMD_NAV_LOITER_UNLIM,
    ]
    places = dict.fromkeys(("vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate"), 0)
    rates = dict.fromkeys(("body_roll_rate", "body_pitch_rate", "body_yaw_rate"), 0)
    return chance.choice(
        [
            lambda: command_long(chance.choice(commands), *(chance.choice(odd) for _ in range(7))),
            lambda: mavlink.MAVLink_command_int_message(
                **to(0, 0),
                frame=99,
                command=chance.randrange(1 << 16),
                current=1,
                autocontinue=1,
                param1=math.inf,
                param2=math.nan,
                param3=3,
                param4=4,
                x=2**31 - 1,
                y=-(2**31),
                z=math.nan,
            ),
            lambda: mavlink.MAVLink_param_request_list_message(**to()),
            lambda: mavlink.MAVLink_param_request_read_message(
                **to(0, 0), param_id=b"", param_index=chance.randrange(-1, 400)
            ),
            lambda: mavlink.MAVLink_param_set_message(
                **to(), param_id=chance.randbytes(16), param_value=math.nan, param_type=chance.randrange(256)
            ),
            lambda: ftp(chance.randbytes(251)),
            lambda: ftp(FTP.pack(1, 1, mavlink.MAV_FTP_OPCODE_OPENFILERO, 16, 0, 0, 0, 0) + b"@PARAM/param.pck"),
            lambda: ftp(FTP.pack(1, 1, mavlink.MAV_FTP_OPCODE_BURSTREADFILE, 239, 0, 0, 0, 0)),
            lambda: mavlink.MAVLink_set_mode_message(
                target_system=1, base_mode=chance.randrange(256), custom_mode=chance.randrange(100)
            ),
            lambda: mavlink.MAVLink_request_data_stream_message(
                **to(), req_stream_id=chance.randrange(20), req_message_rate=60_000, start_stop=chance.randrange(2)
            ),
            lambda: mavlink.MAVLink_mission_count_message(**to(), count=65535, mission_type=chance.randrange(256)),
            lambda: mavlink.MAVLink_timesync_message(tc1=0, ts1=chance.randrange(2**62)),
            lambda: mavlink.MAVLink_set_attitude_target_message(
                **to(),
                time_boot_ms=0,
                type_mask=chance.randrange(256),
                q=[chance.choice(odd) for _ in range(4)],
                thrust=chance.choice(odd),
                **rates,
            ),
            lambda: mavlink.MAVLink_set_position_target_global_int_message(
                **to(),
                time_boot_ms=0,
                coordinate_frame=chance.randrange(256),
                type_mask=chance.randrange(1 << 16),
                lat_int=-(2**31),
                lon_int=2**31 - 1,
                alt=chance.choice(odd),
                **places,
            ),
            lambda: mavlink.MAVLink_rc_channels_override_message(
                **to(), **{f"chan{n}_raw": chance.randrange(1 << 16) for n in range(1, 9)}
            ),
            lambda: mavlink.MAVLink_manual_control_message(
                target=1, x=32767, y=-32768, z=32767, r=-32768, buttons=65535
            ),
        ]
    )()


def ftp(payload):
    return mavlink.MAVLink_file_transfer_protocol_message(
        **to(), target_network=0, payload=list(payload.ljust(251, b"\0"))
    )


def resident_memory(process):
    with open(f"/proc/{process}/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") // 1024
