"""A small ground station for the tests: a socket, MAVLink's messages, and those that have come."""

import math
import socket
import struct
import time
from types import SimpleNamespace

from pymavlink.dialects.v20 import ardupilotmega as mavlink

FTP = struct.Struct("<HBBBBBBI")
GROUND_STATION = 255  # system id


def free_port(kind=socket.SOCK_DGRAM):
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Station:
    """udpin(port): listens there; udpout(port), tcp(port): talks to the bridge."""

    def __init__(self, connection, target=None, system=GROUND_STATION, key=None):
        self.socket, self.target = connection, target
        self.mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=mavlink.MAV_COMP_ID_MISSIONPLANNER)
        self.mav.robust_parsing = True
        if key:
            self.mav.signing.secret_key, self.mav.signing.sign_outgoing = key, True
            self.mav.signing.timestamp = int((time.time() - 1_420_070_400) * 1e5)
            self.mav.signing.allow_unsigned_callback = lambda mav, number: False
        self.messages, self.times, self.lost, self._seq, self._waiting = [], [], 0, {}, []

    @classmethod
    def udpin(cls, port, **options):
        connection = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        connection.bind(("127.0.0.1", port))
        return cls(connection, **options)

    @classmethod
    def udpout(cls, port, **options):
        connection = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        connection.bind(("127.0.0.1", 0))
        station = cls(connection, ("127.0.0.1", port), **options)
        station.heartbeat()
        return station

    @classmethod
    def tcp(cls, port, **options):
        return cls(socket.create_connection(("127.0.0.1", port), timeout=5), **options)

    def close(self):
        self.socket.close()

    def heartbeat(self):
        self.send(
            mavlink.MAVLink_heartbeat_message(
                type=mavlink.MAV_TYPE_GCS,
                autopilot=mavlink.MAV_AUTOPILOT_INVALID,
                base_mode=0,
                custom_mode=0,
                system_status=mavlink.MAV_STATE_UNINIT,
                mavlink_version=3,
            )
        )

    def send(self, message):
        self.send_bytes(message.pack(self.mav))
        self.mav.seq = (self.mav.seq + 1) % 256

    def send_bytes(self, data):
        if self.socket.type == socket.SOCK_DGRAM:
            self.socket.sendto(data, self.target)
        else:
            self.socket.sendall(data)

    def receive(self, seconds):
        """The messages of the next datagram, if one comes within the time."""
        self.socket.settimeout(max(1e-4, seconds))
        try:
            data, sender = self.socket.recvfrom(1 << 16)
        except (TimeoutError, ConnectionRefusedError):
            return []
        if self.socket.type == socket.SOCK_DGRAM:
            self.target = sender
        messages = [m for m in self.mav.parse_buffer(data) or [] if m.get_type() != "BAD_DATA"]
        for message in messages:
            system, seq = message.get_srcSystem(), message.get_seq()
            self.lost += system in self._seq and (self._seq[system] + 1) % 256 != seq
            self._seq[system] = seq
            self.messages.append(message)
            self.times.append(time.monotonic())
        return messages

    def listen(self, seconds):
        """Everything that comes within the time."""
        end, messages = time.monotonic() + seconds, []
        while (left := end - time.monotonic()) > 0:
            messages += self.receive(left)
        return messages

    def expect(self, kind, fits=lambda message: True, seconds=5.0, system=1):
        """The first message of a kind from one vehicle that fits."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self._waiting += self.receive(left)
            while self._waiting:
                message = self._waiting.pop(0)
                if message.get_type() == kind and message.get_srcSystem() == system and fits(message):
                    return message
        raise AssertionError(f"no such {kind} within {seconds} s")

    def ask(self, message, kind, fits=lambda message: True, seconds=0.5, system=1):
        self._waiting.clear()
        self.send(message)
        return self.expect(kind, fits, seconds, system)

    def command(self, number, *parameters, system=1, seconds=0.5):
        """The result of a command."""
        return self.ask(
            command_long(number, *parameters, system=system),
            "COMMAND_ACK",
            lambda ack: ack.command == number,
            seconds,
            system,
        ).result

    def ftp(self, opcode, data=b"", offset=0, size=None, seq=1, session=3):
        body = FTP.pack(seq, session, opcode, len(data) if size is None else size, 0, 0, 0, offset) + data
        return mavlink.MAVLink_file_transfer_protocol_message(
            **to(),
            target_network=0,
            payload=list(body.ljust(251, b"\0")),
        )


def to(system=1, component=mavlink.MAV_COMP_ID_AUTOPILOT1):
    """The fields of a message that say for whom it is."""
    return {"target_system": system, "target_component": component}


def command_long(number, *parameters, **target):
    """COMMAND_LONG; parameters that are not given are 0.  target: as in `to`."""
    values = {f"param{n}": parameters[n - 1] if n <= len(parameters) else 0.0 for n in range(1, 8)}
    return mavlink.MAVLink_command_long_message(**to(**target), command=number, confirmation=0, **values)


def ftp_answer(message):
    body = bytes(message.payload)
    seq, session, opcode, size, asked, complete, _, offset = FTP.unpack_from(body)
    data = body[FTP.size : FTP.size + size]
    return SimpleNamespace(
        seq=seq, session=session, opcode=opcode, asked=asked, complete=complete, offset=offset, data=data
    )


def named(mav_type):
    return lambda messages, system: [m for m in messages if m.get_type() == mav_type and m.get_srcSystem() == system]


def unpacked(content):
    """{name: (type, value)} of a param.pck."""
    magic, n, total = struct.unpack_from("<HHH", content)
    assert magic == 0x671B
    assert n == total
    at, before, parameters = 6, b"", {}
    forms = {1: "<b", 2: "<h", 3: "<i", 4: "<f"}
    while at < len(content):
        kind, lengths = content[at], content[at + 1]
        common, tail = lengths & 15, (lengths >> 4) + 1
        name = before[:common] + content[at + 2 : at + 2 + tail]
        at += 2 + tail
        (value,) = struct.unpack_from(forms[kind], content, at)
        at += struct.calcsize(forms[kind])
        parameters[name.decode()], before = (kind, value), name
    assert len(parameters) == n
    return parameters


def close_to(a, b, tolerance):
    """Whether two angles [rad] agree."""
    return abs(math.remainder(a - b, 2 * math.pi)) <= tolerance
