"""The component `ardupilot_json`: ArduPilot's own software, run by its SITL, as the controller of a vehicle.

ArduPilot's JSON backend (libraries/SITL/SIM_JSON.cpp): it sends the PWM of its outputs, waits for the state of the
vehicle that follows, and sends again: a step of this component is one such exchange.
"""

from __future__ import annotations

import json
import math
import socket
import struct
import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import OrchError
from ...fmu.variables import Variable
from ..vehicle.frame import FACTORS, Frame

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..vehicle.frame import Array

LAYOUTS = {18458: struct.Struct("<HHI16H"), 29569: struct.Struct("<HHI32H")}  # by magic number
LONGEST_STEP = 0.1  # s; ArduPilot ignores a longer one
LOOK = 0.1  # s, between two looks at whether the run was interrupted
INPUTS = (
    *(
        (f"eta.{a}", u, "position in NED and zyx Euler angles")
        for a, u in zip(("x", "y", "z", "phi", "theta", "psi"), ("m",) * 3 + ("rad",) * 3, strict=True)
    ),
    *((f"nu.{a}", u, "body velocity") for a, u in zip("uvwpqr", ("m/s",) * 3 + ("rad/s",) * 3, strict=True)),
    *((f"specific_force.{a}", "m/s2", "what an accelerometer reads, FRD") for a in "xyz"),
)
PARAMETERS = {
    "port": (9002.0, "1", "UDP port, 9002 + 10 n for ArduPilot's instance n"),
    "patience": (60.0, "s", "of wall time to wait for ArduPilot's first packet"),
    "timeout": (10.0, "s", "of wall time to wait for a later one"),
    "all_hosts": (0.0, "1", "1: take packets from other machines, too"),
}
# The shipped vehicle's thrusters in ArduSub's numbering: T1 = -M2, T2 = -M1, T3 = -M4, T4 = -M3, T5 = -M6, T6 = -M5.
SHIPPED = -FACTORS[[1, 0, 3, 2, 5, 4]].T


class ArdupilotJson:
    """A UDP server for one ArduPilot.  context: {"frame": the vehicle's Frame}, by default the shipped vehicle's;
    {"interrupted": whether the run shall end}.  Raises OrchError where the port cannot be had, or ArduPilot is silent.
    """

    def __init__(self, name: str, parameters: Mapping[str, Any], context: Mapping[str, Any]) -> None:
        chosen = {key: start for key, (start, *_) in PARAMETERS.items()} | dict(parameters)
        self._name, self._key = name, f"components.{name}.parameters"
        port = chosen["port"]
        if port != int(port) or not 0 < port < 1 << 16:
            raise OrchError(f"{self._key}.port: is {port!r}; ports are 1 to 65535")
        self._port, self._patience, self._timeout = int(port), float(chosen["patience"]), float(chosen["timeout"])
        self._frame: Frame = context.get("frame") or Frame(SHIPPED)
        self._interrupted = context.get("interrupted", bool)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind(("" if chosen["all_hosts"] else "127.0.0.1", self._port))
        except OSError as error:
            self._socket.close()
            raise OrchError(
                f"{self._key}.port: {self._port} cannot be had: {error.strerror}; is another program using it?"
            ) from None
        self._socket.settimeout(LOOK)
        self._peer: Any = None
        self._count: int | None = None  # of the packet that is being answered
        self._reply = b""
        self._pwm = np.zeros(6)

    @classmethod
    def variables(cls) -> Sequence[Variable]:
        found = [
            *((name, "input", unit, 0.0, meaning) for name, unit, meaning in INPUTS),
            *((f"u.T{n}", "output", "1", None, "normalized thruster command") for n in range(1, 7)),
            *((name, "parameter", unit, start, meaning) for name, (start, unit, meaning) in PARAMETERS.items()),
        ]
        return tuple(
            Variable(
                name=name,
                reference=reference,
                type="Real",
                kind="real",
                causality=causality,
                unit=unit,
                start=start,
                description=meaning,
                depends=None if causality == "output" else (),
            )
            for reference, (name, causality, unit, start, meaning) in enumerate(found)
        )

    def start(self, inputs: Array) -> Array:
        """At rest until ArduPilot speaks."""
        return np.zeros(6)

    def listen(self, t: float, inputs: NDArray[np.float64]) -> Array:
        """Tell ArduPilot the state at t and wait for the PWM of its motors 1 to 6 [us]."""
        if self._count is not None:
            self._reply = reply(t, inputs)
            self._send()
        pwm = self._receive()
        if pwm is not None:
            self._pwm = np.array(pwm[:6], dtype=np.float64)
        return self._pwm

    def step(self, t: float, h: float, inputs: NDArray[np.float64], heard: Array) -> Array:
        """Put the outputs on the thrusters."""
        if h >= LONGEST_STEP:
            raise OrchError(
                f"components.{self._name}.step: {h} s; ArduPilot ignores steps of {LONGEST_STEP} s or "
                "more: give the component a step of 0.0025 s"
            )
        return self._frame.u(heard.tolist())

    def close(self) -> None:
        self._socket.close()

    def _receive(self) -> tuple[int, ...] | None:
        """The PWM of the next packet; None where the run was interrupted."""
        limit = self._patience if self._count is None else self._timeout
        deadline = time.monotonic() + limit
        while not self._interrupted():
            try:
                data, sender = self._socket.recvfrom(1 << 16)
            except TimeoutError:
                if time.monotonic() > deadline:
                    what = "no packet of ArduPilot" if self._count is None else "no further packet of ArduPilot"
                    raise OrchError(
                        f"{what} at UDP port {self._port} within {limit:g} s; start it with "
                        f"sim_vehicle.py -v ArduSub --model JSON:127.0.0.1 -I {(self._port - 9002) // 10}"
                    ) from None
                continue
            except OSError:  # ArduPilot is gone; the time will tell
                continue
            packet = parse(data)
            if packet is None:
                continue
            count, pwm = packet
            self._peer = sender
            if count == self._count:  # our answer got lost: once more, without another step
                self._send()
                continue
            self._count = count
            return pwm
        return None

    def _send(self) -> None:
        if self._reply and self._peer:
            try:
                self._socket.sendto(self._reply, self._peer)
            except OSError:  # it asks again
                return


def parse(data: bytes) -> tuple[int, tuple[int, ...]] | None:
    """Number and PWM [us] of a packet; None for anything else."""
    if len(data) < 2:
        return None
    layout = LAYOUTS.get(struct.unpack_from("<H", data)[0])
    if layout is None or len(data) != layout.size:
        return None
    _, _, count, *pwm = layout.unpack(data)
    return count, tuple(pwm)


def reply(t: float, inputs: NDArray[np.float64]) -> bytes:
    """The state as ArduPilot reads it: it looks for the keys as text, the rates and forces behind "imu".

    inputs: (15,) eta, nu, specific_force.
    """
    from ..vehicle.sample import rotation

    eta, nu, force = inputs[:6], inputs[6:12], inputs[12:15]
    velocity = rotation(*map(float, eta[3:])) @ nu[:3]
    state = {
        "timestamp": t,
        "imu": {"gyro": nu[3:].tolist(), "accel_body": force.tolist()},
        "position": eta[:3].tolist(),
        "attitude": [math.remainder(float(angle), 2 * math.pi) for angle in eta[3:]],
        "velocity": velocity.tolist(),
    }
    return f"\n{json.dumps(state, separators=(',', ':'))}\n".encode()
