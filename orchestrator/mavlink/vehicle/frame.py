"""Thrusters as ArduSub sees them: motor numbers, directions and PWM.

ArduSub's SUB_FRAME_VECTORED (AP_Motors6DOF.cpp): each motor adds its factors times the demands; 1500 us is rest, 400 us
to either side full command.  A vehicle numbers its thrusters as it likes: the columns of its thruster matrix say which
motor each of them is, and whether it turns the other way.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ...errors import OrchError, did_you_mean
from ...experiment.mavlink import PWM_MAPS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

# Of motors 1 to 6: surge, sway, heave (down), roll, pitch, yaw.  ArduSub's own factor of throttle is up-positive.
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
TOLERANCE = 0.01  # of an entry, of the largest of its axis: a matrix measured on a real frame is not exact
REST, SPAN = 1500, 400  # us

# BlueRobotics' T200 at 16 V, from the figures of its public performance data (September 2019): dead band, and thrust at
# either end of the range.  Between them a quadratic curve with this share of its linear part, fitted to the largest
# distance from a straight line in that data, 12.2 N.
T200_DEAD_BAND = (1472.0, 1528.0)  # us
T200_LIMITS = (-39.9, 51.4)  # N, at 1100 and 1900 us
T200_LINEAR = 0.2


class Frame:
    """Which motor each thruster is: `motors[i]` is the index of thruster i's motor, `signs[i]` 1 or -1.

    max_thrust: N at full command; pwm_map: a name of PWM_MAPS.
    """

    def __init__(self, matrix: Array, max_thrust: float = 40.0, pwm_map: str = "linear"):
        """matrix: (6, 6) thruster matrix, rows X Y Z K M N.  Raises OrchError where it is no vectored frame."""
        if pwm_map not in PWM_MAPS:
            raise OrchError(f"no pwm_map {pwm_map!r}{did_you_mean(pwm_map, PWM_MAPS)}")
        self.motors, self.signs = _match(np.asarray(matrix, float))
        self._max_thrust, self._pwm_map = max_thrust, pwm_map

    def pwm(self, u: Array, directions: Sequence[float] = (1,) * 6) -> list[int]:
        """PWM of motors 1 to 6 [us] of the thruster commands u (6,), which are limited to -1..1.

        directions: MOT_1_DIRECTION to MOT_6_DIRECTION.
        """
        pulses = [REST] * len(self.motors)
        for motor, sign, command in zip(self.motors, self.signs, np.clip(np.nan_to_num(u), -1, 1), strict=True):
            turn = sign * directions[motor]
            if self._pwm_map == "linear":
                pulse = REST + SPAN * turn * command
            else:  # pulses above 1500 us are the propeller's better way, whatever it is mounted to push
                pulse = t200_pwm(self._max_thrust * turn * command)
            pulses[motor] = round(pulse)
        return pulses

    def u(self, pwm: Sequence[float], directions: Sequence[float] = (1,) * 6) -> Array:
        """Thruster commands (6,) of the PWM of motors 1 to 6 [us]; 0 us is an output not yet in use, hence at rest."""
        u = np.zeros(len(self.motors))
        for thruster, (motor, sign) in enumerate(zip(self.motors, self.signs, strict=True)):
            turn = sign * directions[motor]
            pulse = min(max(pwm[motor], REST - SPAN), REST + SPAN) if pwm[motor] else REST
            if self._pwm_map == "linear":
                u[thruster] = turn * (pulse - REST) / SPAN
            else:
                u[thruster] = turn * t200_thrust(pulse) / self._max_thrust
        return np.clip(u, -1, 1)


def t200_thrust(pwm: float) -> float:
    """Thrust [N] of a T200 at 16 V."""
    low, high = T200_DEAD_BAND
    if low <= pwm <= high:
        return 0.0
    edge, full = (high, T200_LIMITS[1]) if pwm > high else (low, T200_LIMITS[0])
    x = min(1.0, (pwm - edge) / ((REST + SPAN if pwm > high else REST - SPAN) - edge))
    return full * (T200_LINEAR * x + (1 - T200_LINEAR) * x * x)


def t200_pwm(thrust: float) -> float:
    """The inverse of `t200_thrust`: jumps over the dead band, and ends where the thruster does."""
    if thrust == 0:
        return float(REST)
    side = int(thrust > 0)
    edge, full, end = T200_DEAD_BAND[side], T200_LIMITS[side], REST + (SPAN if side else -SPAN)
    a, b = 1 - T200_LINEAR, T200_LINEAR
    x = (-b + np.sqrt(b * b + 4 * a * min(1.0, thrust / full))) / (2 * a)
    return float(edge + x * (end - edge))


def _match(matrix: Array) -> tuple[list[int], list[int]]:
    """Motor and sign of each column.  Raises OrchError."""
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
        found = [
            (motor, sign)
            for motor, factors in enumerate(FACTORS)
            for sign in (1, -1)
            if motor not in motors and np.allclose(column, sign * factors, rtol=0, atol=TOLERANCE)
        ]
        if not found:
            entries = zip(AXES, matrix[:, thruster], strict=True)
            pushes = ", ".join(f"{axis} {value:+.3g}" for axis, value in entries if value) or "no force"
            raise OrchError(
                f"its thruster matrix is no vectored frame: thruster {thruster + 1} ({pushes}) is none of "
                "the motors that ArduSub's SUB_FRAME_VECTORED has left"
            )
        motors.append(found[0][0])
        signs.append(found[0][1])
    return motors, signs
