"""What a hostile, or broken, partner sends: junk, damaged frames and a thousand requests a second."""

import math
import os
import random
import socket
import struct
import time

from pymavlink.dialects.v20 import ardupilotmega as mavlink

RATE = 1000  # datagrams a second


def flood(port, process, seconds, station):
    """Send for a while; meanwhile the station listens.  Returns the resident memory of the process [kB] over time."""
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
    odd = [math.nan, math.inf, -1.0, 1e30, 30.0, 148.0]
    ftp = struct.Struct("<HBBBBBBI").pack
    return chance.choice(
        [
            lambda: mavlink.MAVLink_command_long_message(
                1, 1, chance.choice([512, 511, 510, 176, 400, 192]), 0, *(chance.choice(odd) for _ in range(7))
            ),
            lambda: mavlink.MAVLink_command_int_message(
                0, 0, 99, chance.randrange(1 << 16), 1, 1, math.inf, math.nan, 3, 4, 2**31 - 1, -(2**31), math.nan
            ),
            lambda: mavlink.MAVLink_param_request_list_message(1, 1),
            lambda: mavlink.MAVLink_param_request_read_message(0, 0, b"", chance.randrange(-1, 400)),
            lambda: mavlink.MAVLink_param_set_message(1, 1, chance.randbytes(16), math.nan, chance.randrange(256)),
            lambda: mavlink.MAVLink_file_transfer_protocol_message(0, 1, 1, list(chance.randbytes(251))),
            lambda: mavlink.MAVLink_file_transfer_protocol_message(
                0, 1, 1, list((ftp(1, 1, 4, 16, 0, 0, 0, 0) + b"@PARAM/param.pck").ljust(251, b"\0"))
            ),
            lambda: mavlink.MAVLink_file_transfer_protocol_message(
                0, 1, 1, list(ftp(1, 1, 15, 239, 0, 0, 0, 0).ljust(251, b"\0"))
            ),
            lambda: mavlink.MAVLink_set_mode_message(1, chance.randrange(256), chance.randrange(100)),
            lambda: mavlink.MAVLink_request_data_stream_message(
                1, 1, chance.randrange(20), 60_000, chance.randrange(2)
            ),
            lambda: mavlink.MAVLink_mission_count_message(1, 1, 65535, chance.randrange(256)),
            lambda: mavlink.MAVLink_timesync_message(0, chance.randrange(2**62)),
            lambda: mavlink.MAVLink_manual_control_message(1, 32767, -32768, 32767, -32768, 65535),
        ]
    )()


def resident_memory(process):
    with open(f"/proc/{process}/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") // 1024
