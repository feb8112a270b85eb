"""The component `mavlink_manual`: a person at a ground station, or a script, gives a controller its reference.

MANUAL_CONTROL moves the reference as a joystick moves a vehicle that holds its position.  In mode GUIDED the reference
goes to set points (SET_POSITION_TARGET_LOCAL_NED, DO_REPOSITION).  Without input it stays where the vehicle started.
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
from .declare import ETA_UNITS, NU_UNITS, numbered, scalar, vector

if TYPE_CHECKING:
    from ...arrays import Reals

ETA_DOT_UNITS, ETA_DDOT_UNITS = ({axis: unit + per for axis, unit in ETA_UNITS.items()} for per in ("/s", "/s2"))
PARAMETERS = {  # {name: (default, unit, description)}; speeds are those of a full stick with gain 1
    "speed.u": (1.0, "m/s", "fastest surge"),
    "speed.v": (0.7, "m/s", "fastest sway"),
    "speed.w": (0.5, "m/s", "fastest heave"),
    "speed.r": (0.8, "rad/s", "fastest yaw"),
    "lag": (0.5, "s", "time constant with which the reference's velocity follows the demand"),
}


class MavlinkManual:
    """The reference: position and yaw follow the demanded velocity with a lag; roll and pitch stay level."""

    def __init__(self, name: str, parameters: Mapping[str, Any], context: Mapping[str, Any]) -> None:
        """context: {"control": the vehicle's Control}; without it nobody steers.

        Raises OrchError if a parameter is not a positive number.
        """
        chosen = {key: start for key, (start, *_) in PARAMETERS.items()} | dict(parameters)
        for key, value in chosen.items():
            if not math.isfinite(value) or value < 0 or (key == "lag" and value == 0):
                raise OrchError(f"components.{name}.parameters.{key}: is {value!r}; give a positive number")
        self._speed = np.array([chosen[f"speed.{axis}"] for axis in "uvw"])
        self._turn, self._lag = float(chosen["speed.r"]), float(chosen["lag"])
        control = context.get("control")
        self.control: Control = Control() if control is None else control
        # x, y, z [m] and psi [rad] of the reference, and their first and second derivatives.
        self._place = np.zeros(4)
        self._rate = np.zeros(4)
        self._change = np.zeros(4)

    @classmethod
    def variables(cls) -> Sequence[Variable]:
        return numbered(
            [
                *vector("eta", "input", ETA_UNITS, "position in NED and zyx Euler angles, where the reference starts"),
                *vector("eta_d", "output", ETA_UNITS, "desired position in NED and zyx Euler angles"),
                *vector("eta_d_dot", "output", ETA_DOT_UNITS, "its derivative"),
                *vector("eta_d_ddot", "output", ETA_DDOT_UNITS, "its second derivative"),
                *vector("nu_d", "output", NU_UNITS, "desired body velocity"),
                *(
                    scalar(name, "parameter", unit, description, start=start)
                    for name, (start, unit, description) in PARAMETERS.items()
                ),
            ]
        )

    def start(self, inputs: Reals) -> Reals:
        """Outputs (24,) at the vehicle's place.  inputs: (6,) eta."""
        self._place = np.array([*inputs[:3], inputs[5]])
        return self._outputs()

    def listen(self, t: float, inputs: Reals) -> Reals:
        """Requests of the pilot, (13,): four demands, whether a set point counts, the set point (nan: no request)."""
        target = self.control.target()
        if target is None:
            return np.array([*self.control.demands(), 0.0, *[math.nan] * 8])
        values = [*target.position, *(target.velocity or [None] * 3), target.yaw, target.yaw_rate]
        return np.array([0.0] * 4 + [1.0] + [math.nan if value is None else value for value in values])

    def step(self, t: float, h: float, inputs: Reals, heard: Reals) -> Reals:
        """Outputs (24,) after a step of h [s]: eta_d, eta_d_dot, eta_d_ddot, nu_d."""
        demand = self._towards(heard[5:]) if heard[4] else self._driven(heard[:4])
        share = -math.expm1(-h / self._lag)  # of the way to the demand, in a step
        rate = self._rate + share * (demand - self._rate)
        self._change = (rate - self._rate) / h
        self._place = self._place + h * (self._rate + rate) / 2
        self._rate = rate
        return self._outputs()

    def close(self) -> None:
        """Nothing is open: the messages come through the bridge."""

    def _driven(self, demands: Reals) -> Reals:
        """Velocity in NED and yaw rate that a joystick demands, (4,)."""
        surge, sway, heave, yaw = demands
        u, v, w = self._speed * (surge, sway, heave)
        c, s = math.cos(self._place[3]), math.sin(self._place[3])
        return np.array([c * u - s * v, s * u + c * v, w, self._turn * yaw])

    def _towards(self, target: Reals) -> Reals:
        """Velocity in NED and yaw rate to a set point, (4,); with this gain and the lag it is critically damped.

        target: (8,) position, velocity, yaw and yaw rate, nan where nothing is requested.
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

    def _outputs(self) -> Reals:
        x, y, z, psi = self._place
        c, s = math.cos(psi), math.sin(psi)
        vx, vy, vz, r = self._rate
        nu_d = [c * vx + s * vy, c * vy - s * vx, vz, 0.0, 0.0, r]
        vectors = [[x, y, z, 0.0, 0.0, psi], _level(self._rate), _level(self._change), nu_d]
        return np.array([value for vector in vectors for value in vector])


def _level(values: Reals) -> list[float]:
    """x, y, z, phi, theta, psi of x, y, z, psi."""
    return [*map(float, values[:3]), 0.0, 0.0, float(values[3])]
