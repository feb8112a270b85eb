"""What is known of a vehicle at an instant, and what follows: velocity in NED, place on Earth, what sensors read."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

METRES_PER_DEGREE = 111319.49079327358  # ArduPilot's sphere (LATLON_TO_M): its stations convert back with it
G = 9.81  # m/s2
FIELD = np.array([200.0, 0.0, 450.0])  # mGauss in NED: magnetic north is north here


@dataclass(frozen=True)
class Sample:
    """A vehicle at time t [s] of the simulation.

    eta, nu, eta_d: (6,) as everywhere (eta_d nan where nobody gives one); u: (thrusters,) commands;
    specific_force: (3,) [m/s2] in FRD; origin: latitude and longitude of NED (0, 0, 0) [degrees].
    """

    t: float
    eta: Array
    nu: Array
    u: Array
    specific_force: Array
    eta_d: Array
    origin: tuple[float, float]

    @cached_property
    def rotation(self) -> Array:
        """R of v_NED = R v_body (zyx Euler angles)."""
        return rotation(*map(float, self.eta[3:]))

    @cached_property
    def velocity(self) -> Array:
        """(3,) in NED [m/s]."""
        product: Array = self.rotation @ self.nu[:3]
        return product

    @cached_property
    def place(self) -> tuple[int, int]:
        """Latitude and longitude [1e-7 degrees]."""
        return to_earth(self.origin, float(self.eta[0]), float(self.eta[1]))

    @property
    def milliseconds(self) -> int:
        return round(self.t * 1e3) & 0xFFFFFFFF

    @property
    def microseconds(self) -> int:
        return round(self.t * 1e6)

    @property
    def depth(self) -> float:
        return float(self.eta[2])

    @property
    def heading(self) -> float:
        """Degrees, [0, 360)."""
        degrees = math.degrees(float(self.eta[5])) % 360.0
        return degrees if degrees < 360.0 else 0.0

    @cached_property
    def field(self) -> Array:
        """What a magnetometer reads, (3,) [mGauss] in FRD."""
        product: Array = self.rotation.T @ FIELD
        return product


def rotation(phi: float, theta: float, psi: float) -> Array:
    """R = R_z(psi) R_y(theta) R_x(phi), (3, 3)."""
    (cx, cy, cz), (sx, sy, sz) = (list(map(f, (phi, theta, psi))) for f in (math.cos, math.sin))
    return np.array(
        [
            [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
            [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
            [-sy, cy * sx, cy * cx],
        ]
    )


def gravity_alone(eta: Array) -> Array:
    """The specific force of a body that does not accelerate, (3,) [m/s2]."""
    product: Array = rotation(*map(float, eta[3:])).T @ np.array([0.0, 0.0, -G])
    return product


def to_earth(origin: tuple[float, float], north: float, east: float) -> tuple[int, int]:
    """Latitude and longitude [1e-7 degrees] of a point [m]."""
    latitude = origin[0] + north / METRES_PER_DEGREE
    longitude = origin[1] + east / (METRES_PER_DEGREE * math.cos(math.radians(origin[0])))
    longitude = (longitude + 180.0) % 360.0 - 180.0
    return within(latitude * 1e7, 900_000_000), within(longitude * 1e7, 1_800_000_000)


def to_ned(origin: tuple[float, float], latitude: float, longitude: float) -> tuple[float, float]:
    """North and east [m] of a point [degrees]."""
    east = (longitude - origin[1] + 180.0) % 360.0 - 180.0
    return (latitude - origin[0]) * METRES_PER_DEGREE, east * METRES_PER_DEGREE * math.cos(math.radians(origin[0]))


def wrapped(angle: float) -> float:
    """Into (-pi, pi]."""
    return math.remainder(angle, 2 * math.pi)


def within(value: float, limit: int) -> int:
    """Rounded, and kept within -limit..limit; 0 for what is no number."""
    return max(-limit, min(limit, round(value))) if math.isfinite(value) else 0
