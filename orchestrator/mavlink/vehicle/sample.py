"""The state of a vehicle at one instant, and what follows from it: velocity in NED, place on Earth, sensor readings."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ...arrays import Reals

METRES_PER_DEGREE = 111319.49079327358  # ArduPilot's sphere (LATLON_TO_M); ground stations convert back with it
E7 = 1e7  # MAVLink's unit of latitude and longitude is 1e-7 degrees
G = 9.81  # m/s2, of the vehicle models
FIELD = np.array([200.0, 0.0, 450.0])  # mGauss in NED: without declination


@dataclass(frozen=True, kw_only=True)
class Sample:
    """A vehicle at simulated time t [s].

    eta: (6,) position in NED and zyx Euler angles [m, rad].  nu: (6,) velocity in BODY [m/s, rad/s].  u: (thrusters,)
    commands in -1..1.  specific_force: (3,) [m/s2] in FRD.  eta_d: (6,) desired eta, nan if the vehicle is given none.
    origin: latitude and longitude of NED (0, 0, 0) [degrees].
    """

    t: float
    eta: Reals
    nu: Reals
    u: Reals
    specific_force: Reals
    eta_d: Reals
    origin: tuple[float, float]

    @cached_property
    def rotation(self) -> Reals:
        """R, (3, 3), of v_NED = R v_BODY."""
        return rotation(*map(float, self.eta[3:]))

    @cached_property
    def velocity(self) -> Reals:
        """(3,) in NED [m/s]."""
        velocity: Reals = self.rotation @ self.nu[:3]
        return velocity

    @cached_property
    def place(self) -> tuple[int, int]:
        """Latitude and longitude [1e-7 degrees]."""
        return to_earth(self.origin, float(self.eta[0]), float(self.eta[1]))

    @property
    def milliseconds(self) -> int:
        """t as an uint32."""
        return round(self.t * 1e3) & 0xFFFFFFFF

    @property
    def microseconds(self) -> int:
        return round(self.t * 1e6)

    @property
    def depth(self) -> float:
        """z [m], positive down."""
        return float(self.eta[2])

    @property
    def heading(self) -> float:
        """psi in [0, 360) degrees."""
        degrees = math.degrees(float(self.eta[5])) % 360.0
        return degrees if degrees < 360.0 else 0.0

    @cached_property
    def field(self) -> Reals:
        """Reading of a magnetometer, (3,) [mGauss] in FRD."""
        field: Reals = self.rotation.T @ FIELD
        return field


def rotation(phi: float, theta: float, psi: float) -> Reals:
    """R = R_z(psi) R_y(theta) R_x(phi), (3, 3), BODY to NED.  phi, theta, psi: zyx Euler angles [rad]."""
    (cx, cy, cz), (sx, sy, sz) = (list(map(f, (phi, theta, psi))) for f in (math.cos, math.sin))
    return np.array(
        [
            [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
            [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
            [-sy, cy * sx, cy * cx],
        ]
    )


def gravity_alone(eta: Reals) -> Reals:
    """The specific force of a body that does not accelerate, (3,) [m/s2] in FRD.  eta: (6,) [m, rad]."""
    force: Reals = rotation(*map(float, eta[3:])).T @ np.array([0.0, 0.0, -G])
    return force


def to_earth(origin: tuple[float, float], north: float, east: float) -> tuple[int, int]:
    """Latitude and longitude [1e-7 degrees] of a point north and east of the origin [m].  origin: [degrees]."""
    latitude = origin[0] + north / METRES_PER_DEGREE
    longitude = origin[1] + east / (METRES_PER_DEGREE * math.cos(math.radians(origin[0])))
    longitude = (longitude + 180.0) % 360.0 - 180.0
    return within(latitude * E7, 900_000_000), within(longitude * E7, 1_800_000_000)


def to_ned(origin: tuple[float, float], latitude: float, longitude: float) -> tuple[float, float]:
    """How far north and east of the origin a point lies [m].  origin, latitude, longitude: [degrees]."""
    east = (longitude - origin[1] + 180.0) % 360.0 - 180.0
    return (latitude - origin[0]) * METRES_PER_DEGREE, east * METRES_PER_DEGREE * math.cos(math.radians(origin[0]))


def wrapped(angle: float) -> float:
    """An angle [rad] in [-pi, pi]."""
    return math.remainder(angle, 2 * math.pi)


def within(value: float, limit: int) -> int:
    """A value rounded and limited to -limit..limit; 0 if it is not finite."""
    return max(-limit, min(limit, round(value))) if math.isfinite(value) else 0
