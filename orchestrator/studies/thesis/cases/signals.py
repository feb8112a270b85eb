"""The signals of a thesis run that its figures show: poses, velocities and what was desired, angles in degrees."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
DEGREES = np.array([1.0, 1.0, 1.0, 180 / math.pi, 180 / math.pi, 180 / math.pi])
AXES = ("x", "y", "z", "phi", "theta", "psi")


class Vectors(Protocol):
    """A record, or rows that are still in memory."""

    @property
    def time(self) -> Array:
        """(N,) [s]."""

    def __getitem__(self, name: str) -> Any:
        """(N, 6) of a vector such as "vehicle1.eta"."""


@dataclass(frozen=True, kw_only=True)
class Track:
    """What one vehicle did.  time: (N,) [s]; every other array (N, 6), but for `bounds`."""

    time: Array
    eta: Array  # NED position and Euler angles [m, deg]
    eta_d: Array  # desired
    nu: Array  # BODY velocity [m/s, deg/s]
    nu_d: Array  # the one that keeps to eta_d at the actual attitude
    tau: Array  # generalized force of the thrusters, after saturation, BODY [N, N.m]
    u: Array  # normalized thruster commands T1 .. T6
    bounds: Mapping[str, Array] = field(default_factory=dict)  # least and greatest since the row before, {"T1": (N, 2)}

    @property
    def error(self) -> Array:
        """eta - eta_d, (N, 6) [m, deg]."""
        return self.eta - self.eta_d

    def of(self, axis: str) -> Array:
        """One column of the error, (N,)."""
        column: Array = self.error[:, AXES.index(axis)]
        return column


def track(run: Vectors, number: str = "") -> Track:
    """The signals of the vehicle with that number; "" is the spiral's only one."""
    eta, eta_d_dot = run[f"vehicle{number}.eta"], run[f"reference{number}.eta_d_dot"]
    return Track(
        time=run.time,
        eta=eta * DEGREES,
        eta_d=run[f"reference{number}.eta_d"] * DEGREES,
        nu=run[f"vehicle{number}.nu"] * DEGREES,
        nu_d=body_velocity(eta, eta_d_dot) * DEGREES,
        tau=run[f"vehicle{number}.tau"],
        u=run[f"allocation{number}.u"],
    )


def body_velocity(eta: Array, eta_dot: Array) -> Array:
    """nu = J(eta)^-1 eta_dot with the standard zyx J.  eta, eta_dot: (N, 6) [m, rad; m/s, rad/s].  Returns (N, 6)."""
    R = rotation(eta)
    c_phi, s_phi, c_theta, s_theta = np.cos(eta[:, 3]), np.sin(eta[:, 3]), np.cos(eta[:, 4]), np.sin(eta[:, 4])
    phi_dot, theta_dot, psi_dot = eta_dot[:, 3:].T
    p = phi_dot - s_theta * psi_dot
    q = c_phi * theta_dot + s_phi * c_theta * psi_dot
    r = -s_phi * theta_dot + c_phi * c_theta * psi_dot
    return np.column_stack([np.einsum("nji,nj->ni", R, eta_dot[:, :3]), p, q, r])


def rotation(eta: Array) -> Array:
    """R(eta) of each row, BODY to NED: its columns are the body's axes.  eta: (N, 6) [m, rad].  Returns (N, 3, 3)."""
    (c_phi, c_theta, c_psi), (s_phi, s_theta, s_psi) = np.cos(eta[:, 3:]).T, np.sin(eta[:, 3:]).T
    rows = [
        [c_psi * c_theta, -s_psi * c_phi + c_psi * s_theta * s_phi, s_psi * s_phi + c_psi * c_phi * s_theta],
        [s_psi * c_theta, c_psi * c_phi + s_phi * s_theta * s_psi, -c_psi * s_phi + s_theta * s_psi * c_phi],
        [-s_theta, c_theta * s_phi, c_theta * c_phi],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=1)


def distance(one: Track, two: Track) -> Array:
    """Between the vehicles, (N,) [m]."""
    difference = two.eta[:, :3] - one.eta[:, :3]
    result: Array = np.sqrt((difference * difference).sum(axis=1))
    return result


def heading_difference(one: Track, two: Track) -> Array:
    """psi_2 - psi_1, (N,) [deg], not wrapped."""
    result: Array = two.eta[:, 5] - one.eta[:, 5]
    return result
