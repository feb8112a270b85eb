"""Rotation between BODY and NED with zyx Euler angles (Fossen 2011, chapter 2; thesis Eqs. 3.4-3.7)."""

from __future__ import annotations

import math
from typing import Any

import casadi as ca

# To round e/(2 pi) to whole turns: 0 up to pi itself, where with 1/(2 pi) and a half what is just below it would be 1.
PER_TURN, HALF = math.nextafter(1 / (2 * math.pi), 0.0), math.nextafter(0.5, 0.0)


def rotation(eta: Any) -> Any:
    """R(eta), BODY to NED (Fossen 2011, Eq. 2.18; the thesis's Eq. 3.6 misprints two entries).

    eta: (6,) NED position and zyx Euler angles [m, rad].  Returns (3, 3).
    """
    phi, theta, psi = eta[3], eta[4], eta[5]
    c_phi, c_theta, c_psi = ca.cos(phi), ca.cos(theta), ca.cos(psi)
    s_phi, s_theta, s_psi = ca.sin(phi), ca.sin(theta), ca.sin(psi)
    return _matrix(
        [c_psi * c_theta, -s_psi * c_phi + c_psi * s_theta * s_phi, s_psi * s_phi + c_psi * c_phi * s_theta],
        [s_psi * c_theta, c_psi * c_phi + s_phi * s_theta * s_psi, -c_psi * s_phi + s_theta * s_psi * c_phi],
        [-s_theta, c_theta * s_phi, c_theta * c_phi],
    )


def euler_rates(eta: Any) -> Any:
    """T(eta), angular velocity in BODY to Euler rates (thesis Eq. 3.7); singular at theta = +-90 degrees.

    eta: (6,) [m, rad].  Returns (3, 3).
    """
    phi, theta = eta[3], eta[4]
    s_phi, c_phi = ca.sin(phi), ca.cos(phi)
    return _matrix(
        [1, s_phi * ca.tan(theta), c_phi * ca.tan(theta)],
        [0, c_phi, -s_phi],
        [0, s_phi / ca.cos(theta), c_phi / ca.cos(theta)],
    )


def jacobian(eta: Any) -> Any:
    """J(eta) of eta_dot = J(eta) nu (thesis Eq. 3.5).  eta: (6,) [m, rad].  Returns (6, 6)."""
    return ca.diagcat(rotation(eta), euler_rates(eta))


def jacobian_dot(eta: Any, nu: Any, v: Any) -> Any:
    """J_dot(eta, nu) v: how J(eta) v turns while v is held.  eta, nu: pose and velocity.  v: (6,).  Returns (6,)."""
    held = ca.SX.sym("v", 6)
    turning = ca.jtimes(jacobian(eta) @ held, eta, jacobian(eta) @ nu)
    return ca.substitute(turning, held, v)


def inverse_jacobian(eta: Any) -> Any:
    """J(eta)^-1: the transposed rotation, and Euler rates to angular velocity.  eta: (6,) [m, rad].  Returns (6, 6)."""
    phi, theta = eta[3], eta[4]
    s_phi, c_phi = ca.sin(phi), ca.cos(phi)
    rates = _matrix(
        [1, 0, -ca.sin(theta)],
        [0, c_phi, ca.cos(theta) * s_phi],
        [0, -s_phi, ca.cos(theta) * c_phi],
    )
    return ca.diagcat(rotation(eta).T, rates)


def pose_error(eta: Any, eta_d: Any) -> Any:
    """e = eta - eta_d, the angles on the circle: e - 2 pi round(e/(2 pi)), in [-pi, pi].

    The shortest way round, and no jump where eta_d is given modulo 2 pi.  |e| < pi keeps every bit.
    eta, eta_d: (6,) NED position and zyx Euler angles [m, rad].  Returns (6,) [m, rad].
    """
    e = eta - eta_d
    return ca.vertcat(e[:3], *(e[i] - 2 * math.pi * ca.floor(PER_TURN * e[i] + HALF) for i in (3, 4, 5)))


def _matrix(*rows: list[Any]) -> Any:
    return ca.vertcat(*(ca.horzcat(*row) for row in rows))
