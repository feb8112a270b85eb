"""The component `mavlink_manual`: a person at a ground station, or a script, gives a controller its reference.

Along the motions that the flight mode holds, the sticks move the reference, or it goes to set points; without input it
stays where it is.  Along the others it stays with the vehicle, and `mavlink_motors` passes the sticks to the thrusters.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import OrchError
from ...fmu.variables import Variable
from ...names import ETA_UNITS, NU_UNITS
from ..vehicle.control import Control
from ..vehicle.modes import MOTIONS, FlightMode
from ..vehicle.sample import wrapped
from .declare import numbered, scalar, vector

if TYPE_CHECKING:
    from ...arrays import Reals

ETA_DOT_UNITS, ETA_DDOT_UNITS = ({axis: unit + per for axis, unit in ETA_UNITS.items()} for per in ("/s", "/s2"))
PARAMETERS = {  # {name: (default, unit, description)}; speeds are those of a full stick with gain 1
    "speed.u": (1.0, "m/s", "fastest surge"),
    "speed.v": (0.7, "m/s", "fastest sway"),
    "speed.w": (0.5, "m/s", "fastest heave"),
    "speed.r": (0.8, "rad/s", "fastest yaw"),
    "lag": (0.5, "s", "time constant with which the reference's velocity follows the demand"),
    "start_disarmed": (0.0, "1", "1: starts disarmed in mode MANUAL, as ArduSub does; 0: armed in mode POSHOLD"),
    "hold_disarmed": (0.0, "1", "1: the controller goes on when the vehicle is disarmed; 0: its thrusters rest"),
}
SWITCHES = ("start_disarmed", "hold_disarmed")
LEAN = math.radians(45)  # of a full stick; ArduSub's ANGLE_MAX
X, Y, Z, PHI, PSI = range(5)  # places in the reference
FREED = {"surge": (X, Y), "sway": (X, Y), "heave": (Z,), "roll": (PHI,), "yaw": (PSI,)}  # {motion: what it moves}

# What is heard: sticks, whether a set point counts and where it is; then what records of orch 0.1.0 lack, with the
# values that stand for it there.
FIRST = 13
LATER = np.array([0.0, math.nan, 1.0, FlightMode.POSHOLD, *[1.0] * len(MOTIONS), math.nan, math.nan])


class MavlinkManual:
    """The reference: position, roll and yaw follow what is demanded with a lag; pitch stays level."""

    def __init__(self, name: str, parameters: Mapping[str, Any], context: Mapping[str, Any]) -> None:
        """context: {"control": the vehicle's Control}; without it nobody steers.

        Raises OrchError if a parameter is not a positive number, or a switch not 0 or 1.
        """
        chosen = {key: start for key, (start, *_) in PARAMETERS.items()} | dict(parameters)
        for key, value in chosen.items():
            if key in SWITCHES and value not in (0, 1):
                raise OrchError(f"components.{name}.parameters.{key}: is {value!r}; give 0 or 1")
            if not math.isfinite(value) or value < 0 or (key == "lag" and value == 0):
                raise OrchError(f"components.{name}.parameters.{key}: is {value!r}; give a positive number")
        self._speed = np.array([chosen[f"speed.{axis}"] for axis in "uvw"])
        self._turn, self._lag = float(chosen["speed.r"]), float(chosen["lag"])
        self._holds_disarmed = bool(chosen["hold_disarmed"])
        control = context.get("control")
        self.control: Control = control_of(chosen) if control is None else control
        # x, y, z [m], phi and psi [rad] of the reference, and their first and second derivatives.
        self._place = np.zeros(5)
        self._rate = np.zeros(5)
        self._change = np.zeros(5)
        self._state = (bool(not chosen["start_disarmed"]), self.control.mode, self.control.held())
        self._sticks = np.zeros(len(MOTIONS))

    @classmethod
    def variables(cls) -> Sequence[Variable]:
        return numbered(
            [
                *vector("eta", "input", ETA_UNITS, "position in NED and zyx Euler angles of the vehicle"),
                *vector("eta_d", "output", ETA_UNITS, "desired position in NED and zyx Euler angles"),
                *vector("eta_d_dot", "output", ETA_DOT_UNITS, "its derivative"),
                *vector("eta_d_ddot", "output", ETA_DDOT_UNITS, "its second derivative"),
                *vector("nu_d", "output", NU_UNITS, "desired body velocity"),
                scalar("mode", "output", "1", "ArduSub's number of the flight mode"),
                scalar("armed", "output", "1", "1: the vehicle is armed"),
                scalar("driven", "output", "1", "1: the thrusters are driven; 0: they rest"),
                *vector("held", "output", dict.fromkeys(MOTIONS, "1"), "1: the controller holds this motion"),
                *vector("stick", "output", dict.fromkeys(MOTIONS, "1"), "demand of the pilot's stick, -1 to 1"),
                *(
                    scalar(name, "parameter", unit, description, start=start)
                    for name, (start, unit, description) in PARAMETERS.items()
                ),
            ]
        )

    def start(self, inputs: Reals) -> Reals:
        """Outputs (37,) at the vehicle's place.  inputs: (6,) eta."""
        self._place = np.array([*inputs[:3], 0.0, inputs[5]])
        return self._outputs()

    def listen(self, t: float, inputs: Reals) -> Reals:
        """What the pilot asks for, (24,); nan: nothing.

        Surge, sway, heave and yaw of the sticks; whether a set point counts, its position, velocity, yaw and yaw rate;
        roll of the stick and of the set point; armed; mode; which of MOTIONS are held; how fast to go, and to turn.
        """
        control = self.control
        surge, sway, heave, roll, yaw = control.demands()
        target = control.target()
        point: list[float | None] = [None] * 8
        if target is not None:
            point = [*target.position, *(target.velocity or [None] * 3), target.yaw, target.yaw_rate]
        held = control.held()
        asked = [
            *(surge, sway, heave, yaw, target is not None, *point),
            *(roll, target and target.roll, control.armed, control.mode),
            *(motion in held for motion in MOTIONS),
            *(control.speed, target and target.turn),
        ]
        return np.array([math.nan if value is None else value for value in asked], dtype=np.float64)

    def step(self, t: float, h: float, inputs: Reals, heard: Reals) -> Reals:
        """Outputs (37,) after a step of h [s]: eta_d, eta_d_dot, eta_d_ddot, nu_d, mode, armed, driven, held, stick."""
        heard = np.concatenate([heard, LATER[len(heard) - FIRST :]])
        sticks, point = heard[[0, 1, 2, 13, 3]], heard[5:13]
        armed, mode = bool(heard[15]), FlightMode(int(heard[16]))
        self._state = armed, mode, tuple(m for m, held in zip(MOTIONS, heard[17:22], strict=True) if held)
        self._sticks = sticks
        demand = self._driven(sticks)
        roll = LEAN * float(sticks[3]) if math.isnan(heard[14]) else float(heard[14])
        demand[PHI] = self._turning((roll - float(self._place[PHI])) / (4 * self._lag), self._turn)
        if heard[4]:
            demand += self._towards(point, *heard[22:24])
        share = -math.expm1(-h / self._lag)  # of the way to the demand, in a step
        rate = self._rate + share * (demand - self._rate)
        self._change = (rate - self._rate) / h
        self._place = self._place + h * (self._rate + rate) / 2
        self._rate = rate
        self._stay_with(inputs)
        return self._outputs()

    def close(self) -> None:
        """Nothing is open: the messages come through the bridge."""

    def _stay_with(self, eta: Reals) -> None:
        """Move the reference to the vehicle, along the motions that are not held.  eta: (6,)."""
        armed, _, held = self._state
        if not armed and not self._holds_disarmed:
            held = ()
        for motion, places in FREED.items():
            if motion not in held:
                for place in places:
                    self._place[place] = eta[place if place < PSI else 5]
                    self._rate[place] = self._change[place] = 0.0

    def _driven(self, sticks: Reals) -> Reals:
        """Velocity in NED and rates of roll and yaw that a joystick demands, (5,); roll is not among them."""
        surge, sway, heave, _, yaw = sticks
        u, v, w = self._speed * (surge, sway, heave)
        c, s = math.cos(self._place[PSI]), math.sin(self._place[PSI])
        return np.array([c * u - s * v, s * u + c * v, w, 0.0, self._turn * yaw])

    def _towards(self, point: Reals, speed: float, turn: float) -> Reals:
        """Velocity in NED and rates of roll and yaw to a set point, (5,); with this gain and the lag it is critically
        damped.

        point: (8,) position, velocity, yaw and yaw rate, nan where nothing is requested.  speed: horizontal [m/s];
        turn: [rad/s]; nan: as the parameters have them.
        """
        gain = 1 / (4 * self._lag)
        velocity = gain * np.nan_to_num(point[:3] - self._place[:3])
        horizontal = float(np.hypot(*velocity[:2]))
        fastest = float(self._speed[0]) if math.isnan(speed) else speed
        if horizontal > fastest:
            velocity[:2] *= fastest / horizontal
        velocity += np.nan_to_num(point[3:6])
        limit = np.array([fastest, fastest, self._speed[2]])
        yaw, yaw_rate = map(float, point[6:])
        rate = 0.0 if math.isnan(yaw) else gain * wrapped(yaw - float(self._place[PSI]))
        rate += 0.0 if math.isnan(yaw_rate) else yaw_rate
        rate = self._turning(rate, self._turn if math.isnan(turn) else turn)
        return np.array([*np.clip(velocity, -limit, limit), 0.0, rate])

    @staticmethod
    def _turning(rate: float, quickest: float) -> float:
        return min(quickest, max(-quickest, rate))

    def _outputs(self) -> Reals:
        x, y, z, phi, psi = self._place
        (c, s), (cp, sp) = ((math.cos(angle), math.sin(angle)) for angle in (psi, phi))
        vx, vy, vz, p, r = self._rate
        ahead, right = c * vx + s * vy, c * vy - s * vx
        nu_d = [ahead, cp * right + sp * vz, cp * vz - sp * right, p, sp * r + 0.0, cp * r]  # 0.0: no -0.0
        armed, mode, held = self._state
        driven = armed or self._holds_disarmed
        state = np.array([mode, armed, driven, *(motion in held for motion in MOTIONS)], dtype=np.float64)
        eta_d = [x, y, z, phi, 0.0, psi]
        return np.concatenate([eta_d, _level(self._rate), _level(self._change), nu_d, state, self._sticks])


def control_of(parameters: Mapping[str, Any], *, stops: bool = False, mixes: bool = False) -> Control:
    """The Control with which a component of these parameters begins."""
    chosen = {key: start for key, (start, *_) in PARAMETERS.items()} | dict(parameters)
    disarmed = bool(chosen["start_disarmed"])
    return Control(
        armed=not disarmed,
        mode=FlightMode.MANUAL if disarmed else FlightMode.POSHOLD,
        holds_disarmed=bool(chosen["hold_disarmed"]),
        fastest=float(chosen["speed.u"]),
        quickest=float(chosen["speed.r"]),
        stops=stops,
        mixes=mixes,
    )


def _level(values: Reals) -> list[float]:
    """x, y, z, phi, theta, psi of x, y, z, phi, psi."""
    return [*map(float, values[:4]), 0.0, float(values[4])]
