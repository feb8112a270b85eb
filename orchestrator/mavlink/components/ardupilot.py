"""The component `ardupilot_json`: ArduPilot's own software, run by its SITL, as the controller of a vehicle.

ArduPilot's JSON backend (libraries/SITL/SIM_JSON.cpp) sends the PWM of its outputs, waits for the state of the vehicle
that follows, and sends again.  A step of this component is one such exchange.
"""

from __future__ import annotations

import json
import socket
import struct
import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import OrchError
from ...fmu.variables import Variable
from ...names import ETA_UNITS, NU_UNITS
from ..vehicle.frame import FACTORS, ThrusterFrame
from ..vehicle.sample import rotation, wrapped
from .declare import numbered, scalar, vector

if TYPE_CHECKING:
    from ...arrays import Reals

LAYOUTS = {  # {magic number: layout}: magic number, frames per second, number of the frame, PWM of the outputs [us]
    18458: struct.Struct("<HHI16H"),
    29569: struct.Struct("<HHI32H"),
}
DATAGRAM = 1 << 16  # bytes
FIRST_PORT, PORTS = 9002, 10  # ArduPilot's instance n uses 9002 + 10 n
MOTORS = 6
SYSTEM_IDS = 255  # the largest of MAVLink
LONGEST_STEP = 0.1  # s; ArduPilot ignores longer ones
USUAL_STEP = 0.0025  # s; ArduSub's loop runs at 400 Hz
LOOK = 0.1  # s, between two looks at whether the run was interrupted
FORCE_UNITS = {"x": "m/s2", "y": "m/s2", "z": "m/s2"}
PARAMETERS = {  # {name: (default, unit, description)}
    "port": (float(FIRST_PORT), "1", "UDP port, 9002 + 10 n for ArduPilot's instance n"),
    "patience": (60.0, "s", "wall time to wait for ArduPilot's first packet"),
    "timeout": (10.0, "s", "wall time to wait for a later packet"),
    "all_hosts": (0.0, "1", "1: accept packets from other machines, too"),
    "system_id": (0.0, "1", "ArduPilot's SYSID_THISMAV; 0: as [mavlink] has it for the vehicle"),
}
# The shipped vehicle's thrusters in ArduSub's numbering: T1 = -M2, T2 = -M1, T3 = -M4, T4 = -M3, T5 = -M6, T6 = -M5.
SHIPPED = -FACTORS[[1, 0, 3, 2, 5, 4]].T


class ArdupilotJson:
    """A UDP server for one ArduPilot."""

    def __init__(self, name: str, parameters: Mapping[str, Any], context: Mapping[str, Any]) -> None:
        """context: {"frame": the vehicle's ThrusterFrame; "interrupted": whether the run shall end}, both optional.

        Without a frame, it is the shipped vehicle's.  Raises OrchError if the port cannot be opened.
        """
        chosen = {key: start for key, (start, *_) in PARAMETERS.items()} | dict(parameters)
        self._name, self._key = name, f"components.{name}.parameters"
        port = chosen["port"]
        if port != int(port) or not 0 < port < 1 << 16:
            raise OrchError(f"{self._key}.port: is {port!r}; ports are 1 to 65535")
        system = chosen["system_id"]
        if system != int(system) or not 0 <= system <= SYSTEM_IDS:
            raise OrchError(f"{self._key}.system_id: is {system!r}; give one of 1 to {SYSTEM_IDS}, or 0")
        self._port, self._patience, self._timeout = int(port), float(chosen["patience"]), float(chosen["timeout"])
        self._frame: ThrusterFrame = context.get("frame") or ThrusterFrame(SHIPPED)
        self._interrupted = context.get("interrupted", bool)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind(("" if chosen["all_hosts"] else "127.0.0.1", self._port))
        except OSError as error:
            self._socket.close()
            raise OrchError(
                f"{self._key}.port: {self._port} cannot be opened: {error.strerror}; is another program using it?"
            ) from None
        self._socket.settimeout(LOOK)
        self._peer: Any = None  # address
        self._count: int | None = None  # of the packet that is being answered
        self._reply = b""
        self._pwm = np.zeros(MOTORS)

    @classmethod
    def variables(cls) -> Sequence[Variable]:
        return numbered(
            [
                *vector("eta", "input", ETA_UNITS, "position in NED and zyx Euler angles"),
                *vector("nu", "input", NU_UNITS, "body velocity"),
                *vector("specific_force", "input", FORCE_UNITS, "reading of an accelerometer, FRD"),
                *(
                    scalar(f"u.T{n}", "output", "1", "normalized thruster command", depends=None)
                    for n in range(1, MOTORS + 1)
                ),
                *(
                    scalar(name, "parameter", unit, description, start=start)
                    for name, (start, unit, description) in PARAMETERS.items()
                ),
            ]
        )

    def start(self, inputs: Reals) -> Reals:
        """Commands (6,) before the first packet: at rest."""
        return np.zeros(MOTORS)

    def listen(self, t: float, inputs: Reals) -> Reals:
        """Send ArduPilot the state at t and wait for the PWM of its motors 1 to 6 [us], (6,)."""
        if self._count is not None:
            self._reply = reply(t, inputs)
            self._send()
        pwm = self._receive()
        if pwm is not None:
            self._pwm = np.array(pwm[:MOTORS], dtype=np.float64)
        return self._pwm

    def step(self, t: float, h: float, inputs: Reals, heard: Reals) -> Reals:
        """Thruster commands (6,) from the PWM.  Raises OrchError if the step is longer than ArduPilot takes."""
        if h >= LONGEST_STEP:
            raise OrchError(
                f"components.{self._name}.step: {h} s; ArduPilot ignores steps of {LONGEST_STEP} s or "
                f"more: give the component a step of {USUAL_STEP} s"
            )
        return self._frame.u(heard.tolist())

    def close(self) -> None:
        self._socket.close()

    def _receive(self) -> tuple[int, ...] | None:
        """The PWM of the next packet; None if the run was interrupted.  Raises OrchError if none comes in time."""
        limit = self._patience if self._count is None else self._timeout
        deadline = time.monotonic() + limit
        while not self._interrupted():
            try:
                data, sender = self._socket.recvfrom(DATAGRAM)
            except TimeoutError:
                if time.monotonic() > deadline:
                    what = "no packet from ArduPilot" if self._count is None else "no further packet from ArduPilot"
                    instance = (self._port - FIRST_PORT) // PORTS
                    raise OrchError(
                        f"{what} at UDP port {self._port} within {limit:g} s; start it with "
                        f"sim_vehicle.py -v ArduSub --model JSON:127.0.0.1 -I {instance}"
                    ) from None
                continue
            except OSError:  # ArduPilot has ended; the deadline decides
                continue
            packet = parse(data)
            if packet is None:
                continue
            count, pwm = packet
            self._peer = sender
            if count == self._count:  # our answer was lost: send it again, without another step
                self._send()
                continue
            self._count = count
            return pwm
        return None

    def _send(self) -> None:
        if self._reply and self._peer:
            try:
                self._socket.sendto(self._reply, self._peer)
            except OSError:  # ArduPilot asks again
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


def reply(t: float, inputs: Reals) -> bytes:
    """The state at t [s] for ArduPilot, which searches the text for the keys; gyro and accel_body stand behind "imu".

    inputs: (15,) eta, nu, specific_force.
    """
    eta, nu, force = inputs[:6], inputs[6:12], inputs[12:15]
    velocity = rotation(*map(float, eta[3:])) @ nu[:3]
    state = {
        "timestamp": t,
        "imu": {"gyro": nu[3:].tolist(), "accel_body": force.tolist()},
        "position": eta[:3].tolist(),
        "attitude": [wrapped(float(angle)) for angle in eta[3:]],
        "velocity": velocity.tolist(),
    }
    return f"\n{json.dumps(state, separators=(',', ':'))}\n".encode()
