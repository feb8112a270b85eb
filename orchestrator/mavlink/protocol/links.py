"""Endpoints: where frames go and come from.  Nothing here waits: what cannot be sent at once is dropped."""

from __future__ import annotations

import contextlib
import ipaddress
import re
import socket
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from ...errors import OrchError, did_you_mean

FORMS = {
    "udpout": "udpout:HOST:PORT",
    "udpin": "udpin:HOST:PORT",
    "tcpin": "tcpin:HOST:PORT",
    "serial": "serial:DEVICE:BAUD",
}
FORGET = 30.0  # s of silence after which udpin sends no more
MOST_PEERS = 16  # of a link
BACKLOG = 1 << 16  # bytes that a slow reader may leave in our hands
AT_ONCE = 32  # datagrams, or reads, in a turn
DATAGRAM = 1 << 16  # bytes
BUFFER = 1 << 18  # bytes that the system may keep


@dataclass(frozen=True)
class Endpoint:
    """`1=udpout:127.0.0.1:14550`.  system: the one vehicle on it, None: all; number: port, or baud of a serial line."""

    text: str
    kind: str
    host: str
    number: int
    system: int | None = None

    @classmethod
    def parse(cls, text: str) -> Endpoint:
        """Raises OrchError with what would do."""
        match = re.fullmatch(r"(?:(\d+)=)?([^:=]+):(.+):(\d+)", text.strip())
        known = ", ".join(FORMS.values())
        if not match:
            raise OrchError(
                f"--mavlink {text}: write one of {known}; 1=udpout:... shows only the vehicle with system id 1"
            )
        system, kind, host, number = match.groups()
        if kind not in FORMS:
            raise OrchError(f"--mavlink {text}: no {kind!r}{did_you_mean(kind, FORMS)}")
        if kind != "serial" and not 0 < int(number) < 1 << 16:
            raise OrchError(f"--mavlink {text}: no port {number}; ports are 1 to 65535")
        return cls(text, kind, host.strip("[]"), int(number), int(system) if system else None)


class Peer:
    """A partner on a link.  heard: when anything last came from it [s]; valid: whether a frame ever did."""

    def __init__(self, link: Link, address: Any, now: float):
        self.link, self.address, self.heard, self.valid = link, address, now, False
        self.gone = False

    def send(self, frame: bytes) -> None:
        self.link.send(self, frame)


class Link(ABC):
    """An open endpoint.  `whole`: its data are datagrams; `new`: called with each partner that appears."""

    whole = True

    def __init__(self, endpoint: Endpoint, counts: Counter[str]):
        self.endpoint, self.counts = endpoint, counts
        self.peers: list[Peer] = []

    @abstractmethod
    def files(self) -> list[Any]:
        """What to wait for."""

    @abstractmethod
    def receive(self, now: float) -> Iterator[tuple[Peer, bytes]]:
        """What has come, some of it at a time."""

    @abstractmethod
    def send(self, peer: Peer, frame: bytes) -> None:
        """Send a frame now, or drop it."""

    @abstractmethod
    def close(self) -> None: ...

    def dropped(self) -> None:
        self.counts["frames dropped"] += 1


class UdpOut(Link):
    """To a station that listens; it answers to the port that we send from."""

    def __init__(self, endpoint: Endpoint, counts: Counter[str]):
        super().__init__(endpoint, counts)
        self._socket, address = _datagrams(endpoint)
        try:
            # Connected: the system drops what comes from anybody else.
            self._socket.connect(address)
        except OSError as error:
            self._socket.close()
            raise _cannot_open(endpoint, error) from None
        self.peers = [Peer(self, address, 0.0)]

    def files(self) -> list[Any]:
        return [self._socket]

    def receive(self, now: float) -> Iterator[tuple[Peer, bytes]]:
        for _ in range(AT_ONCE):
            try:
                data = self._socket.recv(DATAGRAM)
            except BlockingIOError:
                return
            except OSError:  # nobody listens there yet, or any more
                continue
            yield self.peers[0], data

    def send(self, peer: Peer, frame: bytes) -> None:
        try:
            self._socket.send(frame)
        except ConnectionRefusedError:  # of an earlier frame, which nobody took: this one may find somebody
            with contextlib.suppress(OSError):
                self._socket.send(frame)
        except OSError:
            self.dropped()

    def close(self) -> None:
        self._socket.close()


class UdpIn(Link):
    """Listens; whoever sends something is a partner until he has been silent for a while."""

    def __init__(self, endpoint: Endpoint, counts: Counter[str]):
        super().__init__(endpoint, counts)
        self._socket, address = _datagrams(endpoint)
        try:
            self._socket.bind(address)
        except OSError as error:
            self._socket.close()
            raise _cannot_open(endpoint, error) from None

    def files(self) -> list[Any]:
        return [self._socket]

    def receive(self, now: float) -> Iterator[tuple[Peer, bytes]]:
        for peer in [peer for peer in self.peers if now - peer.heard > FORGET]:
            self._forget(peer)
        for _ in range(AT_ONCE):
            try:
                data, address = self._socket.recvfrom(DATAGRAM)
            except BlockingIOError:
                return
            except OSError:  # a partner is gone
                continue
            if (known := self._peer(address, now)) is not None:
                known.heard = now
                yield known, data

    def _peer(self, address: Any, now: float) -> Peer | None:
        for peer in self.peers:
            if peer.address == address:
                return peer
        if len(self.peers) >= MOST_PEERS:
            strangers = [peer for peer in self.peers if not peer.valid]  # who never sent a frame makes room
            if not strangers:
                self.counts["partners refused"] += 1
                return None
            self._forget(min(strangers, key=lambda peer: peer.heard))
        self.peers.append(Peer(self, address, now))
        return self.peers[-1]

    def _forget(self, peer: Peer) -> None:
        peer.gone = True
        self.peers.remove(peer)

    def send(self, peer: Peer, frame: bytes) -> None:
        try:
            self._socket.sendto(frame, peer.address)
        except OSError:
            self.dropped()

    def close(self) -> None:
        self._socket.close()


class Stream(Link):
    """Bytes in a row: a frame is sent as a whole or not at all, and one that is begun is finished."""

    whole = False

    def __init__(self, endpoint: Endpoint, counts: Counter[str]):
        super().__init__(endpoint, counts)
        self._waiting: dict[Peer, bytearray] = {}

    def send(self, peer: Peer, frame: bytes) -> None:
        if peer.gone:
            return
        waiting = self._waiting.setdefault(peer, bytearray())
        if len(waiting) + len(frame) > BACKLOG:
            self.dropped()
        else:
            waiting += frame
        self.push(peer)

    def push(self, peer: Peer) -> None:
        """Write what the system takes now."""
        waiting = self._waiting.get(peer)
        if waiting:
            try:
                del waiting[: self.write(peer, bytes(waiting))]
            except (BlockingIOError, InterruptedError):
                pass
            except OSError:
                self.lose(peer)

    @abstractmethod
    def write(self, peer: Peer, data: bytes) -> int:
        """How many bytes were taken."""

    def lose(self, peer: Peer) -> None:
        peer.gone = True
        self._waiting.pop(peer, None)
        if peer in self.peers:
            self.peers.remove(peer)


class TcpIn(Stream):
    """A server: every client is a partner."""

    def __init__(self, endpoint: Endpoint, counts: Counter[str]):
        super().__init__(endpoint, counts)
        family, address = _address(endpoint, socket.SOCK_STREAM)
        self._server = socket.socket(family, socket.SOCK_STREAM)
        try:
            self._server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._server.bind(address)
            self._server.listen(MOST_PEERS)
            self._server.setblocking(False)
        except OSError as error:
            self._server.close()
            raise _cannot_open(endpoint, error) from None

    def files(self) -> list[Any]:
        return [self._server, *(peer.address for peer in self.peers)]

    def receive(self, now: float) -> Iterator[tuple[Peer, bytes]]:
        self._accept(now)
        for peer in list(self.peers):
            self.push(peer)
            for _ in range(AT_ONCE // 4):
                try:
                    data = peer.address.recv(4096)
                except (BlockingIOError, InterruptedError):
                    break
                except OSError:
                    data = b""
                if not data:
                    self.lose(peer)
                    break
                peer.heard = now
                yield peer, data

    def _accept(self, now: float) -> None:
        with contextlib.suppress(OSError):
            connection, _ = self._server.accept()
            if len(self.peers) >= MOST_PEERS:
                self.counts["partners refused"] += 1
                connection.close()
                return
            connection.setblocking(False)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self.peers.append(Peer(self, connection, now))

    def write(self, peer: Peer, data: bytes) -> int:
        return int(peer.address.send(data))

    def lose(self, peer: Peer) -> None:
        super().lose(peer)
        peer.address.close()

    def close(self) -> None:
        for peer in list(self.peers):
            self.lose(peer)
        self._server.close()


class Serial(Stream):
    """A serial line, through pyserial."""

    def __init__(self, endpoint: Endpoint, counts: Counter[str]):
        super().__init__(endpoint, counts)
        try:
            import serial
        except ImportError:
            words = '--mavlink serial needs pyserial, not installed here: pip install "orch[mavlink]"'
            raise OrchError(words) from None
        try:
            self._port = serial.Serial(endpoint.host, endpoint.number, timeout=0, write_timeout=0)
        except (OSError, ValueError) as error:
            raise OrchError(f"--mavlink {endpoint.text} cannot be opened: {error}") from None
        self._timeout = serial.SerialTimeoutException
        self.peers = [Peer(self, None, 0.0)]

    def files(self) -> list[Any]:
        return [self._port]

    def receive(self, now: float) -> Iterator[tuple[Peer, bytes]]:
        for peer in list(self.peers):
            self.push(peer)
            try:
                data = self._port.read(4096)
            except OSError:  # unplugged
                self.lose(peer)
                return
            if data:
                yield peer, data

    def write(self, peer: Peer, data: bytes) -> int:
        try:
            return int(self._port.write(data) or 0)
        except self._timeout:
            return 0

    def close(self) -> None:
        self._port.close()


KINDS: dict[str, Callable[[Endpoint, Counter[str]], Link]] = {
    "udpout": UdpOut,
    "udpin": UdpIn,
    "tcpin": TcpIn,
    "serial": Serial,
}


def open_link(endpoint: Endpoint, counts: Counter[str]) -> Link:
    """Raises OrchError where it cannot be opened."""
    return KINDS[endpoint.kind](endpoint, counts)


def _datagrams(endpoint: Endpoint) -> tuple[socket.socket, Any]:
    family, address = _address(endpoint, socket.SOCK_DGRAM)
    opened = socket.socket(family, socket.SOCK_DGRAM)
    opened.setblocking(False)
    for option in (socket.SO_RCVBUF, socket.SO_SNDBUF):
        opened.setsockopt(socket.SOL_SOCKET, option, BUFFER)
    with contextlib.suppress(ValueError):
        if ipaddress.ip_address(address[0]) == ipaddress.ip_address("255.255.255.255"):
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
    return opened, address


def _address(endpoint: Endpoint, kind: socket.SocketKind) -> tuple[Any, Any]:
    try:
        found = socket.getaddrinfo(endpoint.host, endpoint.number, type=kind)
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OrchError(f"--mavlink {endpoint.text}: no host {endpoint.host!r}: {reason}") from None
    family, _, _, _, address = min(found, key=lambda f: f[0] != socket.AF_INET)  # stations listen on IPv4
    return family, address


def _cannot_open(endpoint: Endpoint, error: OSError) -> OrchError:
    return OrchError(f"--mavlink {endpoint.text} cannot be opened: {error.strerror}; is another program using it?")
