"""Bytes to messages and back, for one partner: frames, sequence numbers, signing."""

from __future__ import annotations

import hashlib
import struct
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ...errors import OrchError
from .dialect import AUTOPILOT, Message, mavlink

MAGIC: int = mavlink.PROTOCOL_MARKER_V2  # frames of MAVLink 1 are skipped like any other junk
HEADER: int = mavlink.HEADER_LEN_V2  # bytes
SIGNATURE: int = mavlink.MAVLINK_SIGNATURE_BLOCK_LEN  # bytes
SIGNED: int = mavlink.MAVLINK_IFLAG_SIGNED  # the one incompatibility flag that is defined
CHECKSUM = 2  # bytes
KEY = 32  # bytes
EPOCH = 1_420_070_400  # s; 1 January 2015, when the time stamps of signatures begin
PER_SECOND = 100_000  # of these time stamps


def read_key(path: str) -> bytes:
    """The secret key in a file: 32 bytes, 64 hexadecimal digits, or a passphrase, whose SHA-256 is the key.

    Raises OrchError if the file cannot be read or is empty.
    """
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise OrchError(f"--mavlink-key {path} cannot be read: {error.strerror}") from None
    if len(content) == KEY:
        return content
    text = content.strip()
    if not text:
        raise OrchError(f"--mavlink-key {path} is empty; put 32 bytes, 64 hexadecimal digits or a passphrase into it")
    try:
        key = bytes.fromhex(text.decode())
    except ValueError:
        key = b""
    return key if len(key) == KEY else hashlib.sha256(text).digest()


class Decoder:
    """Messages from one partner."""

    def __init__(self, counts: Counter[str], key: bytes | None = None):
        """counts: of bad frames and junk bytes.  key: if given, only frames signed with it are decoded."""
        self._mav = mavlink.MAVLink(None)
        self._pending = bytearray()
        self._counts, self._key = counts, key
        if key:
            _sign(self._mav, key, 0)

    def messages(self, data: bytes, whole: bool) -> Iterator[Message]:
        """Messages in bytes that came.  whole: they are a datagram, in which no frame is cut off."""
        pending = self._pending
        pending += data
        at, end = 0, len(pending)
        while True:
            start = pending.find(MAGIC, at)
            if start < 0 or (whole and end - start < HEADER + CHECKSUM):
                self._junk(end - at)
                at = end
                break
            self._junk(start - at)
            at = start
            if end - at < HEADER:
                break
            total = self._length(at)
            if total and end - at < total and not whole:
                break
            message = self._decode(pending[at : at + total]) if total and end - at >= total else None
            if message is None:
                self._junk(1)
                at += 1
                continue
            at += total
            yield message
        del pending[:at]

    def _length(self, at: int) -> int:
        """Length of the frame that may begin at a place; 0 if none can."""
        length, flags, _, _, system, _, low, middle, high = self._pending[at + 1 : at + HEADER]
        if flags & ~SIGNED or not system or (low | middle << 8 | high << 16) not in mavlink.mavlink_map:
            return 0
        if flags & SIGNED and not self._key:
            return 0
        return HEADER + length + CHECKSUM + SIGNATURE * (flags & SIGNED)

    def _decode(self, frame: bytearray) -> Message | None:
        if self._key:
            self._mav.signing.timestamp = max(self._mav.signing.timestamp, _now())
        try:
            return self._mav.decode(frame)
        except (mavlink.MAVError, ValueError, TypeError, struct.error):
            self._counts["bad frames"] += 1
            return None

    def _junk(self, count: int) -> None:
        if count:
            self._counts["junk bytes"] += count


class Encoder:
    """Frames of one vehicle for one partner, with a sequence of their own."""

    def __init__(self, system: int, key: bytes | None = None, link: int = 0):
        """link: number of the link, in signatures."""
        self._mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=AUTOPILOT)
        self._key = key
        if key:
            _sign(self._mav, key, link)

    def frame(self, message: Message) -> bytes:
        if self._key:
            self._mav.signing.timestamp = max(self._mav.signing.timestamp, _now())
        packed = bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        return packed


def _sign(mav: Any, key: bytes, link: int) -> None:
    mav.signing.secret_key = key
    mav.signing.link_id = link % 256
    mav.signing.timestamp = _now()
    mav.signing.sign_outgoing = True


def _now() -> int:
    """The present in the unit of signatures."""
    return int((time.time() - EPOCH) * PER_SECOND)
