"""Thrusters in ArduSub's terms: motor numbers, directions and PWM.

ArduSub's SUB_FRAME_VECTORED (libraries/AP_Motors/AP_Motors6DOF.cpp): the command of a motor is the sum of its factors
times the demands; a pulse of 1500 us is rest, 400 us to either side full command.  A vehicle may number its thrusters
in any order: the columns of its thruster matrix say which motor each of them is, and whether it turns the other way.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ...errors import OrchError, did_you_mean
from ...experiment.schema.sections import PWM_MAPS
from ...metrics.thrusters import PowerCurve

if TYPE_CHECKING:
    from ...arrays import Reals

# Of motors 1 to 6: surge, sway, heave (down), roll, pitch, yaw.  ArduSub's own factor of throttle is positive up.
FACTORS = np.array(
    [
        [-1, +1, 0, 0, 0, +1],
        [-1, -1, 0, 0, 0, -1],
        [+1, +1, 0, 0, 0, -1],
        [+1, -1, 0, 0, 0, +1],
        [0, 0, +1, +1, 0, 0],
        [0, 0, +1, -1, 0, 0],
    ],
    dtype=np.float64,
)
AXES = ("X", "Y", "Z", "K", "M", "N")
TOLERANCE = 0.01  # of an entry, relative to the largest of its axis: a matrix measured on a real frame is not exact
REST, SPAN = 1500, 400  # us: the pulse at rest, and how far full command is from it
DEFAULT_MAX_THRUST = 40.0  # N at full command, of a vehicle that has no parameter max_thrust; the thesis's


class ThrusterFrame:
    """Which motor each thruster is: `motors[i]` is the index of thruster i's motor, `signs[i]` 1 or -1."""

    def __init__(self, matrix: Reals, max_thrust: float = DEFAULT_MAX_THRUST, pwm_map: str = PWM_MAPS[0]):
        """matrix: (6, 6) thruster matrix, rows X Y Z K M N.  max_thrust: N at full command.  pwm_map: one of PWM_MAPS.

        Raises OrchError if the matrix is not that of a vectored frame.
        """
        if pwm_map not in PWM_MAPS:
            raise OrchError(f"no pwm_map {pwm_map!r}{did_you_mean(pwm_map, PWM_MAPS)}")
        self.motors, self.signs = _match(np.asarray(matrix, float))
        self._max_thrust, self._pwm_map = max_thrust, pwm_map

    def pwm(self, u: Reals, directions: Sequence[float] = (1,) * 6) -> list[int]:
        """PWM of motors 1 to 6 [us] from the thruster commands u (6,), which are limited to -1..1.

        directions: MOT_1_DIRECTION to MOT_6_DIRECTION.
        """
        pulses = [REST] * len(self.motors)
        for motor, sign, command in zip(self.motors, self.signs, np.clip(np.nan_to_num(u), -1, 1), strict=True):
            turn = sign * directions[motor]
            if self._pwm_map == "linear":
                pulse = REST + SPAN * turn * command
            else:  # above 1500 us the propeller pushes in its stronger direction, however the thruster is mounted
                pulse = t200().pulse(self._max_thrust * turn * command)
            pulses[motor] = round(pulse)
        return pulses

    def u(self, pwm: Sequence[float], directions: Sequence[float] = (1,) * 6) -> Reals:
        """Thruster commands (6,) from the PWM of motors 1 to 6 [us]; 0 us is an output not yet in use, hence at rest.

        directions: MOT_1_DIRECTION to MOT_6_DIRECTION.
        """
        u = np.zeros(len(self.motors))
        for thruster, (motor, sign) in enumerate(zip(self.motors, self.signs, strict=True)):
            turn = sign * directions[motor]
            pulse = min(max(pwm[motor], REST - SPAN), REST + SPAN) if pwm[motor] else REST
            if self._pwm_map == "linear":
                u[thruster] = turn * (pulse - REST) / SPAN
            else:
                u[thruster] = turn * t200().thrust(pulse) / self._max_thrust
        return np.clip(u, -1, 1)


def matrix_of(entries: Mapping[str, float]) -> Reals:
    """The matrix with some entries, {"row,column": value}, numbered from 1; the others are 0."""
    values = {tuple(int(i) - 1 for i in index.split(",")): value for index, value in entries.items()}
    matrix = np.zeros(np.array(list(values)).max(axis=0) + 1)
    for place, value in values.items():
        matrix[place] = value
    return matrix


@functools.cache
def t200() -> PowerCurve:
    """BlueRobotics' T200 at 16 V, by the manufacturer's table."""
    return PowerCurve("t200", 16.0)


def _match(matrix: Reals) -> tuple[list[int], list[int]]:
    """Motor and sign of each column of the (6, 6) thruster matrix.  Raises OrchError."""
    if matrix.shape != FACTORS.shape[::-1]:
        raise OrchError(
            f"its thruster matrix is {matrix.shape[0]} x {matrix.shape[1]}, and ArduSub's vectored frame "
            "has six thrusters"
        )
    scale = np.abs(matrix).max(axis=1, keepdims=True)
    scale[scale < 1e-9 * max(1.0, float(scale.max()))] = 1.0
    columns = (matrix / scale).T
    motors: list[int] = []
    signs: list[int] = []
    for thruster, column in enumerate(columns):
        matches = [
            (motor, sign)
            for motor, factors in enumerate(FACTORS)
            for sign in (1, -1)
            if motor not in motors and np.allclose(column, sign * factors, rtol=0, atol=TOLERANCE)
        ]
        if not matches:
            entries = zip(AXES, matrix[:, thruster], strict=True)
            pushes = ", ".join(f"{axis} {value:+.3g}" for axis, value in entries if value) or "no force"
            raise OrchError(
                f"its thruster matrix is not that of a vectored frame: thruster {thruster + 1} ({pushes}) is none of "
                "the remaining motors of ArduSub's SUB_FRAME_VECTORED"
            )
        motors.append(matches[0][0])
        signs.append(matches[0][1])
    return motors, signs
