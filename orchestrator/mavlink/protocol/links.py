"""Endpoints and the links that they open: UDP, TCP and serial lines.

Nothing here waits: a frame that cannot be sent at once is dropped.
"""

from __future__ import annotations

import contextlib
import re
import socket
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, TypeAlias

from ...errors import OrchError, did_you_mean

FORMS = {
    "udpout": "udpout:HOST:PORT",
    "udpin": "udpin:HOST:PORT",
    "tcpin": "tcpin:HOST:PORT",
    "serial": "serial:DEVICE:BAUD",
}
Waitable: TypeAlias = Any  # what select.select takes: a socket, or pyserial's port

FORGET = 30.0  # s of silence after which a udpin forgets a partner
MOST_PEERS = 16  # of a link
BACKLOG = 1 << 16  # bytes that wait for a slow reader; further frames are dropped
DATAGRAMS = 32  # that are read in a turn
READS = 8  # of a stream in a turn
READ = 4096  # bytes of a stream at once
DATAGRAM = 1 << 16  # bytes
BROADCAST = "255.255.255.255"
BUFFER = 1 << 18  # bytes, of the system's for each direction


@dataclass(frozen=True)
class Endpoint:
    """An endpoint such as 1=udpout:127.0.0.1:14550.

    host: or the device of a serial line.  number: port, or baud of a serial line.  system: id of the one vehicle that
    is shown there; None: all.
    """

    text: str
    kind: str
    host: str
    number: int
    system: int | None = None

    @classmethod
    def parse(cls, text: str) -> Endpoint:
        """The endpoint of a text of the form [ID=]KIND:HOST:PORT.  Raises OrchError if it has another form."""
        match = re.fullmatch(r"(?:(\d+)=)?([^:=]+):(.+):(\d+)", text.strip())
        known = ", ".join(FORMS.values())
        if not match:
            raise OrchError(
                f"--mavlink {text}: write one of {known}; 1=udpout:... shows only the vehicle with system id 1"
            )
        system, kind, host, number = match.groups()
        if kind not in FORMS:
            raise OrchError(f"--mavlink {text}: no kind of endpoint {kind!r}{did_you_mean(kind, FORMS)}")
        if kind != "serial" and not 0 < int(number) < 1 << 16:
            raise OrchError(f"--mavlink {text}: no port {number}; ports are 1 to 65535")
        return cls(text, kind, host.strip("[]"), int(number), int(system) if system else None)


class Peer:
    """A partner on a link.

    heard: when anything last came from it (monotonic) [s].  valid: whether a frame ever came from it.  gone: it is no
    longer a partner.
    """

    def __init__(self, link: Link, now: float, address: Any = None):
        """address: where datagrams go."""
        self.link, self.address = link, address
        self.heard, self.valid, self.gone = now, False, False

    def send(self, frame: bytes) -> None:
        self.link.send(self, frame)


class Link(ABC):
    """An open endpoint.  peers: its partners.  whole: what it receives are datagrams, in which no frame is cut off."""

    whole = True

    def __init__(self, endpoint: Endpoint, counts: Counter[str]):
        self.endpoint, self.counts = endpoint, counts
        self.peers: list[Peer] = []

    @abstractmethod
    def files(self) -> list[Waitable]:
        """What to wait for until something comes."""

    @abstractmethod
    def receive(self, now: float) -> Iterator[tuple[Peer, bytes]]:
        """What has come and from whom, a limited amount at a time.  now: monotonic [s]."""

    @abstractmethod
    def send(self, peer: Peer, frame: bytes) -> None:
        """Send a frame now, or drop it."""

    @abstractmethod
    def close(self) -> None: ...

    def drop(self) -> None:
        """Count a frame that was not sent."""
        self.counts["frames dropped"] += 1


class UdpOut(Link):
    """Sends to a station that listens; it answers to the port from which we send."""

    def __init__(self, endpoint: Endpoint, counts: Counter[str]):
        super().__init__(endpoint, counts)
        self._socket, address = _datagrams(endpoint)
        try:
            self._socket.connect(address)  # so that the system drops what comes from anybody else
        except OSError as error:
            self._socket.close()
            raise _cannot_open(endpoint, error) from None
        self.peers = [Peer(self, 0.0, address)]

    def files(self) -> list[Waitable]:
        return [self._socket]

    def receive(self, now: float) -> Iterator[tuple[Peer, bytes]]:
        for _ in range(DATAGRAMS):
            try:
                data = self._socket.recv(DATAGRAM)
            except BlockingIOError:
                return
            except OSError:  # nobody listens there
                continue
            yield self.peers[0], data

    def send(self, peer: Peer, frame: bytes) -> None:
        try:
            self._socket.send(frame)
        except ConnectionRefusedError:  # reported of an earlier frame; somebody may listen now
            with contextlib.suppress(OSError):
                self._socket.send(frame)
        except OSError:
            self.drop()

    def close(self) -> None:
        self._socket.close()


class UdpIn(Link):
    """Listens; a sender is a partner until nothing has come from it for a while."""

    def __init__(self, endpoint: Endpoint, counts: Counter[str]):
        super().__init__(endpoint, counts)
        self._socket, address = _datagrams(endpoint)
        try:
            self._socket.bind(address)
        except OSError as error:
            self._socket.close()
            raise _cannot_open(endpoint, error) from None

    def files(self) -> list[Waitable]:
        return [self._socket]

    def receive(self, now: float) -> Iterator[tuple[Peer, bytes]]:
        for silent in [peer for peer in self.peers if now - peer.heard > FORGET]:
            self._forget(silent)
        for _ in range(DATAGRAMS):
            try:
                data, address = self._socket.recvfrom(DATAGRAM)
            except BlockingIOError:
                return
            except OSError:  # reported of a partner that no longer listens
                continue
            if (peer := self._peer(address, now)) is not None:
                peer.heard = now
                yield peer, data

    def _peer(self, address: Any, now: float) -> Peer | None:
        """The partner at an address, a new one if there is room; one that never sent a frame makes room for it."""
        for peer in self.peers:
            if peer.address == address:
                return peer
        if len(self.peers) >= MOST_PEERS:
            strangers = [peer for peer in self.peers if not peer.valid]
            if not strangers:
                self.counts["partners refused"] += 1
                return None
            self._forget(min(strangers, key=lambda peer: peer.heard))
        self.peers.append(Peer(self, now, address))
        return self.peers[-1]

    def _forget(self, peer: Peer) -> None:
        peer.gone = True
        self.peers.remove(peer)

    def send(self, peer: Peer, frame: bytes) -> None:
        try:
            self._socket.sendto(frame, peer.address)
        except OSError:
            self.drop()

    def close(self) -> None:
        self._socket.close()


class StreamLink(Link):
    """A link without datagrams: a frame is sent as a whole or not at all."""

    whole = False

    def __init__(self, endpoint: Endpoint, counts: Counter[str]):
        super().__init__(endpoint, counts)
        self._waiting: dict[Peer, bytearray] = {}  # whole frames but for the first, of which a part may have been sent

    def send(self, peer: Peer, frame: bytes) -> None:
        if peer.gone:
            return
        waiting = self._waiting.setdefault(peer, bytearray())
        if len(waiting) + len(frame) > BACKLOG:
            self.drop()
        else:
            waiting += frame
        self.push(peer)

    def push(self, peer: Peer) -> None:
        """Write as much as the system takes now."""
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
        """Write some bytes; returns how many the system took."""

    def lose(self, peer: Peer) -> None:
        """Forget a partner that closed the connection."""
        peer.gone = True
        self._waiting.pop(peer, None)
        if peer in self.peers:
            self.peers.remove(peer)


class TcpIn(StreamLink):
    """A server: every client is a partner."""

    def __init__(self, endpoint: Endpoint, counts: Counter[str]):
        super().__init__(endpoint, counts)
        self._connections: dict[Peer, socket.socket] = {}
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

    def files(self) -> list[Waitable]:
        return [self._server, *self._connections.values()]

    def receive(self, now: float) -> Iterator[tuple[Peer, bytes]]:
        self._accept(now)
        for peer in list(self.peers):
            self.push(peer)
            for _ in range(READS):
                if peer.gone:
                    break
                try:
                    data = self._connections[peer].recv(READ)
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
            self.peers.append(peer := Peer(self, now))
            self._connections[peer] = connection

    def write(self, peer: Peer, data: bytes) -> int:
        return self._connections[peer].send(data)

    def lose(self, peer: Peer) -> None:
        super().lose(peer)
        self._connections.pop(peer).close()

    def close(self) -> None:
        for peer in list(self.peers):
            self.lose(peer)
        self._server.close()


class SerialLine(StreamLink):
    """A serial line, through pyserial."""

    def __init__(self, endpoint: Endpoint, counts: Counter[str]):
        super().__init__(endpoint, counts)
        try:
            import serial
        except ImportError:
            remedy = 'pip install "orch[mavlink]"'
            raise OrchError(f"--mavlink serial needs pyserial, not installed here: {remedy}") from None
        try:
            self._port = serial.Serial(endpoint.host, endpoint.number, timeout=0, write_timeout=0)
        except (OSError, ValueError) as error:
            raise OrchError(f"--mavlink {endpoint.text} cannot be opened: {error}") from None
        self._timeout = serial.SerialTimeoutException
        self.peers = [Peer(self, 0.0)]

    def files(self) -> list[Waitable]:
        return [self._port]

    def receive(self, now: float) -> Iterator[tuple[Peer, bytes]]:
        for peer in list(self.peers):
            self.push(peer)
            try:
                data = self._port.read(READ)
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
    "serial": SerialLine,
}


def open_link(endpoint: Endpoint, counts: Counter[str]) -> Link:
    """Open an endpoint.  counts: of dropped frames and refused partners.  Raises OrchError if it cannot be opened."""
    return KINDS[endpoint.kind](endpoint, counts)


def _datagrams(endpoint: Endpoint) -> tuple[socket.socket, Any]:
    family, address = _address(endpoint, socket.SOCK_DGRAM)
    """A socket that does not block, and the endpoint's address."""
    opened = socket.socket(family, socket.SOCK_DGRAM)
    opened.setblocking(False)
    for option in (socket.SO_RCVBUF, socket.SO_SNDBUF):
        opened.setsockopt(socket.SOL_SOCKET, option, BUFFER)
    if address[0] == BROADCAST:
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
    return opened, address


def _address(endpoint: Endpoint, kind: socket.SocketKind) -> tuple[Any, Any]:
    """Family and address of an endpoint.  Raises OrchError if there is no such host."""
    try:
        addresses = socket.getaddrinfo(endpoint.host, endpoint.number, type=kind)
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OrchError(f"--mavlink {endpoint.text}: no host {endpoint.host!r}: {reason}") from None
    family, _, _, _, address = min(addresses, key=lambda entry: entry[0] != socket.AF_INET)  # stations listen on IPv4
    return family, address


def _cannot_open(endpoint: Endpoint, error: OSError) -> OrchError:
    return OrchError(f"--mavlink {endpoint.text} cannot be opened: {error.strerror}; is another program using it?")
