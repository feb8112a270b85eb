"""Thruster matrix and control allocation of the BlueROV2 (thesis section 4.1.2 and 4.1.3)."""

from __future__ import annotations

from typing import Any

import casadi as ca

from .dynamics import pinv_rows


def thruster_matrix(thrusters: Any) -> Any:
    """T of tau = max_thrust T u; the signs follow the positions of Table 4.5.

    Eq. 4.10 prints a yaw row proportional to its sway row, which would leave yaw uncontrollable.
    thrusters: has gamma [rad], d_y, d_psi [m].  Returns (6, 6), the pitch row empty.
    """
    c, s = ca.cos(thrusters.gamma), ca.sin(thrusters.gamma)
    d_y, d_psi = thrusters.d_y, thrusters.d_psi
    T = ca.SX(6, 6)
    T[0, :4] = ca.horzcat(c, c, -c, -c)
    T[1, :4] = ca.horzcat(s, -s, s, -s)
    T[2, 4:] = ca.horzcat(-1, -1)
    T[3, 4:] = ca.horzcat(d_y, -d_y)
    T[5, :4] = ca.horzcat(d_psi, -d_psi, -d_psi, d_psi)
    return T


def pinv_thruster_matrix(thrusters: Any) -> Any:
    """T+ (Eq. 3.28): thruster commands of a generalized force, per max_thrust.  Returns (6, 6)."""
    return pinv_rows(thruster_matrix(thrusters))


def saturate(u: Any) -> Any:
    """Limits of the commands (Eqs. 4.12, 4.13): T1-T4 shrink together, T5 and T6 are clipped.

    u: (6,) normalized commands.  Returns (6,) within -1..1.
    """
    largest = ca.fmax(ca.fmax(ca.fabs(u[0]), ca.fabs(u[1])), ca.fmax(ca.fabs(u[2]), ca.fabs(u[3])))
    return ca.vertcat(u[:4] / ca.fmax(1, largest), ca.fmin(1, ca.fmax(-1, u[4:])))
