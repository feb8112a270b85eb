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
from .dialect import AUTOPILOT, known_ids, mavlink

MAGIC = 0xFD  # MAVLink 2; frames of MAVLink 1 are skipped like any other junk
HEADER, CHECKSUM, SIGNATURE = 10, 2, 13  # bytes
SIGNED = 1  # the one incompatibility flag that is defined
EPOCH = 1_420_070_400  # s; 1 January 2015, from where signatures count
PER_SECOND = 100_000  # of a signature's time stamps


def read_key(path: str) -> bytes:
    """The secret key in a file: 32 bytes, 64 hexadecimal digits, or a passphrase, of which it is the SHA-256.

    Raises OrchError where there is none.
    """
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise OrchError(f"--mavlink-key {path} cannot be read: {error.strerror}") from None
    if len(content) == 32:
        return content
    text = content.strip()
    if not text:
        raise OrchError(f"--mavlink-key {path} is empty; put 32 bytes, 64 hexadecimal digits or a passphrase into it")
    try:
        key = bytes.fromhex(text.decode())
    except ValueError:
        key = b""
    return key if len(key) == 32 else hashlib.sha256(text).digest()


class Decoder:
    """Messages of one partner.  key: then only frames signed with it count."""

    def __init__(self, counts: Counter[str], key: bytes | None = None):
        self._mav = mavlink().MAVLink(None)
        self._pending = bytearray()
        self._counts, self._key = counts, key
        if key:
            _sign(self._mav, key, 0)

    def messages(self, data: bytes, whole: bool) -> Iterator[Any]:
        """whole: the data are a datagram, in which no frame is cut off."""
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
            found = self._decode(pending[at : at + total]) if total and end - at >= total else None
            if found is None:
                self._junk(1)
                at += 1
                continue
            at += total
            yield found
        del pending[:at]

    def _length(self, at: int) -> int:
        """Of the frame that may begin there; 0 where none can."""
        length, flags, _, _, system, _, low, middle, high = self._pending[at + 1 : at + HEADER]
        if flags & ~SIGNED or not system or (low | middle << 8 | high << 16) not in known_ids():
            return 0
        if flags & SIGNED and not self._key:
            return 0
        return HEADER + length + CHECKSUM + SIGNATURE * (flags & SIGNED)

    def _decode(self, frame: bytearray) -> Any:
        if self._key:
            self._mav.signing.timestamp = max(self._mav.signing.timestamp, _now())
        try:
            return self._mav.decode(frame)
        except (mavlink().MAVError, ValueError, TypeError, struct.error):
            self._counts["bad frames"] += 1
            return None

    def _junk(self, count: int) -> None:
        if count:
            self._counts["junk bytes"] += count


class Encoder:
    """Frames of one vehicle for one partner, with a sequence of their own."""

    def __init__(self, system: int, key: bytes | None = None, link: int = 0):
        self._mav = mavlink().MAVLink(None, srcSystem=system, srcComponent=AUTOPILOT)
        self._key = key
        if key:
            _sign(self._mav, key, link)

    def frame(self, message: Any) -> bytes:
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
    """The present as signatures count it."""
    return int((time.time() - EPOCH) * PER_SECOND)
