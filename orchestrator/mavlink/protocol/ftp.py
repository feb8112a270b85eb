"""MAVLink FTP, as far as ground stations need it: reading the parameters as one file.

https://mavlink.io/en/services/ftp.html; stations drop an answer that does not repeat the session of the request.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

from ..vehicle.parameters import AutopilotParameters
from .dialect import Message, mavlink

LAYOUT = struct.Struct("<HBBBBBBI")  # seq, session, opcode, size, opcode of the request, burst complete, pad, offset
DATA = 239  # bytes in a frame
PAYLOAD = LAYOUT.size + DATA
FILE = "@PARAM/param.pck"


class ParameterFile:
    """The one file that a station may open of one vehicle: its parameters, as they were when it was opened."""

    def __init__(self, parameters: AutopilotParameters):
        self._parameters = parameters
        self._content: bytes | None = None  # None: not open

    def answers(self, station: tuple[int, int], payload: bytes) -> Iterator[Message]:
        """Messages that answer a request.  station: its system and component."""
        system, component = station
        for body in self._bodies(payload):
            yield mavlink.MAVLink_file_transfer_protocol_message(
                target_network=0,
                target_system=system,
                target_component=component,
                payload=list(body.ljust(PAYLOAD, b"\0")),
            )

    def _bodies(self, payload: bytes) -> Iterator[bytes]:
        seq, session, opcode, size, _, _, _, offset = LAYOUT.unpack_from(payload)
        data = payload[LAYOUT.size : LAYOUT.size + size]

        def answer(reply: int, data: bytes, n: int = 1, complete: bool = False, at: int = 0) -> bytes:
            head = LAYOUT.pack((seq + n) % (1 << 16), session, reply, len(data), opcode, complete, 0, at)
            return head + data

        def ack(data: bytes, n: int = 1, complete: bool = False, at: int = 0) -> bytes:
            return answer(mavlink.MAV_FTP_OPCODE_ACK, data, n, complete, at)

        def nak(error: int, n: int = 1) -> bytes:
            return answer(mavlink.MAV_FTP_OPCODE_NAK, bytes([error]), n)

        if size > DATA:
            yield nak(mavlink.MAV_FTP_ERR_INVALIDDATASIZE)
        elif opcode in (mavlink.MAV_FTP_OPCODE_TERMINATESESSION, mavlink.MAV_FTP_OPCODE_RESETSESSION):
            self._content = None
            yield ack(b"")
        elif opcode == mavlink.MAV_FTP_OPCODE_OPENFILERO:
            name = data.split(b"\0")[0].decode(errors="replace").partition("?")[0]
            if name.lstrip("/") != FILE:
                yield nak(mavlink.MAV_FTP_ERR_FILENOTFOUND)
                return
            self._content = self._parameters.packed()
            yield ack(struct.pack("<I", len(self._content)))
        elif opcode == mavlink.MAV_FTP_OPCODE_LISTDIRECTORY:
            yield nak(mavlink.MAV_FTP_ERR_FILENOTFOUND)
        elif opcode not in (mavlink.MAV_FTP_OPCODE_READFILE, mavlink.MAV_FTP_OPCODE_BURSTREADFILE):
            yield nak(mavlink.MAV_FTP_ERR_UNKNOWNCOMMAND)
        elif self._content is None:
            yield nak(mavlink.MAV_FTP_ERR_INVALIDSESSION)
        elif offset >= len(self._content):
            yield nak(mavlink.MAV_FTP_ERR_EOF)
        elif opcode == mavlink.MAV_FTP_OPCODE_READFILE:
            yield ack(self._content[offset : offset + (size or DATA)], at=offset)
        else:
            content, n = self._content, 1
            for at in range(offset, len(content), size or DATA):
                piece = content[at : at + (size or DATA)]
                yield ack(piece, n, at + len(piece) >= len(content), at)
                n += 1
            yield nak(mavlink.MAV_FTP_ERR_EOF, n)
