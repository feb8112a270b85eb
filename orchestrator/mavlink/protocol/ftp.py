"""MAVLink FTP, as far as ground stations need it: reading the parameters as one file.

https://mavlink.io/en/services/ftp.html; stations drop an answer that does not repeat the session of the request.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any

from ..vehicle.parameters import Parameters
from .dialect import message

LAYOUT = struct.Struct("<HBBBBBBI")  # seq, session, opcode, size, opcode of the request, burst complete, pad, offset
DATA = 239  # bytes in a frame
PAYLOAD = 251
ACK, NAK = 128, 129
TERMINATE, RESET, LIST, OPEN_RO, READ, BURST = 1, 2, 3, 4, 5, 15
FAIL, BAD_SIZE, BAD_SESSION, END_OF_FILE, UNKNOWN, NOT_FOUND = 1, 3, 4, 6, 7, 10
FILE = "@PARAM/param.pck"


class Files:
    """What one station has open of one vehicle: a snapshot of the parameters, or nothing."""

    def __init__(self, parameters: Parameters):
        self._parameters = parameters
        self._content: bytes | None = None

    def answers(self, station: tuple[int, int], payload: bytes) -> Iterator[Any]:
        """Messages that answer a request.  station: its system and component."""
        for body in self._bodies(payload):
            yield message("FILE_TRANSFER_PROTOCOL", 0, *station, list(body.ljust(PAYLOAD, b"\0")))

    def _bodies(self, payload: bytes) -> Iterator[bytes]:
        seq, session, opcode, size, _, _, _, offset = LAYOUT.unpack_from(payload)
        data = payload[LAYOUT.size : LAYOUT.size + size]

        def answer(kind: int, data: bytes, n: int = 1, complete: bool = False, at: int = 0) -> bytes:
            head = LAYOUT.pack((seq + n) % (1 << 16), session, kind, len(data), opcode, complete, 0, at)
            return head + data

        def refuse(code: int, n: int = 1) -> bytes:
            return answer(NAK, bytes([code]), n)

        if size > DATA:
            yield refuse(BAD_SIZE)
        elif opcode in (TERMINATE, RESET):
            self._content = None
            yield answer(ACK, b"")
        elif opcode == OPEN_RO:
            name = data.split(b"\0")[0].decode(errors="replace").partition("?")[0]
            if name.lstrip("/") != FILE:
                yield refuse(NOT_FOUND)
                return
            self._content = self._parameters.packed()
            yield answer(ACK, struct.pack("<I", len(self._content)))
        elif opcode == LIST:
            yield refuse(NOT_FOUND)
        elif opcode not in (READ, BURST):
            yield refuse(UNKNOWN)
        elif self._content is None:
            yield refuse(BAD_SESSION)
        elif offset >= len(self._content):
            yield refuse(END_OF_FILE)
        elif opcode == READ:
            yield answer(ACK, self._content[offset : offset + (size or DATA)], at=offset)
        else:
            content, n = self._content, 1
            for at in range(offset, len(content), size or DATA):
                piece = content[at : at + (size or DATA)]
                yield answer(ACK, piece, n, at + len(piece) >= len(content), at)
                n += 1
            yield refuse(END_OF_FILE, n)
