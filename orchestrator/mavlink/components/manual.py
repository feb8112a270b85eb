"""The component `mavlink_manual`: a person at a ground station, or a script, gives a controller its reference.

MANUAL_CONTROL moves the reference as a joystick moves a vehicle that holds its position; in mode GUIDED it goes to set
points (SET_POSITION_TARGET_LOCAL_NED, DO_REPOSITION).  Without input it stays where the vehicle began.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import OrchError
from ...fmu.variables import Variable
from ..vehicle.control import Control
from ..vehicle.sample import wrapped

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

AXES = ("x", "y", "z", "phi", "theta", "psi")
METRES = ("m", "m", "m", "rad", "rad", "rad")
SPEEDS = {  # full stick with gain 1
    "speed.u": (1.0, "m/s", "fastest surge"),
    "speed.v": (0.7, "m/s", "fastest sway"),
    "speed.w": (0.5, "m/s", "fastest heave"),
    "speed.r": (0.8, "rad/s", "fastest yaw"),
}
LAG = ("lag", 0.5, "s", "how slowly the reference's velocity follows what is asked")


def _variables() -> tuple[Variable, ...]:
    def vector(name: str, causality: str, per: str, meaning: str) -> list[tuple[str, str, str, float | None, str]]:
        start = 0.0 if causality == "input" else None
        units = zip(AXES, METRES, strict=True)
        return [(f"{name}.{axis}", causality, unit + per, start, meaning) for axis, unit in units]

    found = [
        *vector("eta", "input", "", "position in NED and zyx Euler angles of the vehicle, where the reference begins"),
        *vector("eta_d", "output", "", "desired position in NED and zyx Euler angles"),
        *vector("eta_d_dot", "output", "/s", "its derivative"),
        *vector("eta_d_ddot", "output", "/s2", "its second derivative"),
        *(
            (f"nu_d.{axis}", "output", unit, None, "desired body velocity")
            for axis, unit in zip("uvwpqr", ("m/s",) * 3 + ("rad/s",) * 3, strict=True)
        ),
        *((name, "parameter", unit, start, meaning) for name, (start, unit, meaning) in SPEEDS.items()),
        (LAG[0], "parameter", *LAG[2:3], LAG[1], LAG[3]),
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
        )
        for reference, (name, causality, unit, start, meaning) in enumerate(found)
    )


class MavlinkManual:
    """The reference: position and yaw follow the velocity asked for with a lag; roll and pitch stay level.

    context: {"control": the vehicle's Control}, without which nobody steers.  Raises OrchError where a parameter makes
    no sense.
    """

    def __init__(self, name: str, parameters: Mapping[str, Any], context: Mapping[str, Any]) -> None:
        chosen = {key: start for key, (start, *_) in SPEEDS.items()} | {LAG[0]: LAG[1]} | dict(parameters)
        for key, value in chosen.items():
            if not math.isfinite(value) or value < 0 or (key == LAG[0] and value == 0):
                raise OrchError(f"components.{name}.parameters.{key}: is {value!r}; give a positive number")
        self._speed = np.array([chosen[f"speed.{axis}"] for axis in "uvw"])
        self._turn, self._lag = float(chosen["speed.r"]), float(chosen["lag"])
        found = context.get("control")
        self.control: Control = found if found is not None else Control()
        self._place = np.zeros(4)  # x, y, z, psi
        self._rate = np.zeros(4)
        self._change = np.zeros(4)

    @classmethod
    def variables(cls) -> Sequence[Variable]:
        return _variables()

    def start(self, inputs: Array) -> Array:
        self._place = np.array([*inputs[:3], inputs[5]])
        return self._outputs()

    def listen(self, t: float, inputs: Array) -> Array:
        """What the pilot asks: four demands, whether set points count, and the set point (nan: not asked), (13,)."""
        nothing = math.nan
        target = self.control.target()
        if target is None:
            return np.array([*self.control.demands(), 0.0, *[nothing] * 8])
        values = [*target.position, *(target.velocity or [None] * 3), target.yaw, target.yaw_rate]
        return np.array([0.0] * 4 + [1.0] + [nothing if value is None else value for value in values])

    def step(self, t: float, h: float, inputs: Array, heard: Array) -> Array:
        wanted = self._towards(heard[5:]) if heard[4] else self._driven(heard[:4])
        share = -math.expm1(-h / self._lag)  # of the way to what is wanted, in a step
        rate = self._rate + share * (wanted - self._rate)
        self._change = (rate - self._rate) / h
        self._place = self._place + h * (self._rate + rate) / 2
        self._rate = rate
        return self._outputs()

    def close(self) -> None:
        """Nothing is open: the messages come through the bridge."""

    def _driven(self, demands: Array) -> Array:
        """Velocity in NED and yaw rate that a joystick asks for, (4,)."""
        surge, sway, heave, yaw = demands
        u, v, w = self._speed * (surge, sway, heave)
        c, s = math.cos(self._place[3]), math.sin(self._place[3])
        return np.array([c * u - s * v, s * u + c * v, w, self._turn * yaw])

    def _towards(self, target: Array) -> Array:
        """To the set point without overshoot, (4,): with this gain the lag makes it critically damped.

        target: (8,) position, velocity, yaw and yaw rate, nan where nothing is asked.
        """
        gain = 1 / (4 * self._lag)
        velocity = gain * np.nan_to_num(target[:3] - self._place[:3])
        horizontal = float(np.hypot(*velocity[:2]))
        fastest = float(self._speed[0])
        if horizontal > fastest:
            velocity[:2] *= fastest / horizontal
        velocity += np.nan_to_num(target[3:6])
        limit = np.array([fastest, fastest, self._speed[2]])
        yaw, yaw_rate = map(float, target[6:])
        turn = 0.0 if math.isnan(yaw) else gain * wrapped(yaw - float(self._place[3]))
        turn += 0.0 if math.isnan(yaw_rate) else yaw_rate
        return np.array([*np.clip(velocity, -limit, limit), min(self._turn, max(-self._turn, turn))])

    def _outputs(self) -> Array:
        x, y, z, psi = self._place
        c, s = math.cos(psi), math.sin(psi)
        vx, vy, vz, r = self._rate
        nu = [c * vx + s * vy, c * vy - s * vx, vz, 0.0, 0.0, r]
        vectors = [[x, y, z, 0.0, 0.0, psi], _level(self._rate), _level(self._change), nu]
        return np.array([value for vector in vectors for value in vector])


def _level(values: Array) -> list[float]:
    return [*map(float, values[:3]), 0.0, 0.0, float(values[3])]
