"""Rigid-body and hydrodynamic terms of an underwater vehicle without active pitch (thesis Eqs. 4.2-4.7).

`body` is anything that has the coefficients of `uuv.bluerov2.BlueROV2Body` as attributes: numbers or symbols.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import casadi as ca


def mass(body: Any) -> Any:
    """M = M_RB + M_A (Eqs. 4.2, 4.3): the pitch row is zero, but M(1,5) = m z_g stays.  Returns (6, 6), rank 5."""
    M = ca.SX(6, 6)
    M[0, 0] = body.m - body.X_udot
    M[1, 1] = body.m - body.Y_vdot
    M[2, 2] = body.m - body.Z_wdot
    M[3, 3] = body.I_x - body.K_pdot
    M[5, 5] = body.I_z - body.N_rdot
    M[0, 4] = body.m * body.z_g
    M[1, 3] = M[3, 1] = -body.m * body.z_g
    return M


def coriolis(body: Any, nu: Any) -> Any:
    """C(nu) = C_RB + C_A (Eqs. 4.4, 4.5), with the sign of C_A(6,1) repaired and C_A(1,6), C_A(2,6) as parameters.

    nu: (6,) velocity in BODY, relative to the water where there is a current [m/s, rad/s].
    Returns (6, 6); it is not skew-symmetric: the textbook's C misses the thesis's tables by 22 % instead of 4 %.
    """
    u, v, w, p, q, r = ca.vertsplit(nu)
    C = ca.SX(6, 6)
    C[0, 4] = (body.m - body.Z_wdot) * w
    C[0, 5] = body.C_16 * v
    C[1, 3] = -(body.m - body.Z_wdot) * w
    C[1, 5] = body.C_26 * u
    C[2, 3] = (body.m - body.Y_vdot) * v
    C[2, 4] = -(body.m - body.X_udot) * u
    C[3, 1] = (body.m - body.Z_wdot) * w
    C[3, 2] = -(body.m - body.Y_vdot) * v
    C[3, 4] = (body.I_z - body.N_rdot) * r
    C[3, 5] = -(body.I_y - body.M_qdot) * q
    C[5, 0] = (body.m - body.Y_vdot) * v
    C[5, 1] = -(body.m - body.X_udot) * u
    C[5, 3] = (body.I_y - body.M_qdot) * q
    C[5, 4] = -(body.I_x - body.K_pdot) * p
    return C


def damping(body: Any, nu: Any) -> Any:
    """D(nu), linear and quadratic (Eq. 4.6).  nu: (6,) relative velocity in BODY [m/s, rad/s].  Returns (6, 6)."""
    linear = ca.vertcat(body.X_u, body.Y_v, body.Z_w, body.K_p, 0, body.N_r)
    quadratic = ca.vertcat(body.X_uu, body.Y_vv, body.Z_ww, body.K_pp, 0, body.N_rr)
    return ca.diag(ca.sparsify(-linear - quadratic * ca.fabs(nu)))


def restoring(body: Any, eta: Any) -> Any:
    """Gravity and buoyancy g(eta) in BODY (Eq. 4.7); pitch is left out, as in the thesis.

    eta: (6,) NED position and zyx Euler angles [m, rad].  Returns (6,) [N, N.m].
    """
    phi, theta = eta[3], eta[4]
    net = body.W - body.B
    return ca.vertcat(
        net * ca.sin(theta),
        -net * ca.cos(theta) * ca.sin(phi),
        -net * ca.cos(theta) * ca.cos(phi),
        body.z_g * body.W * ca.cos(theta) * ca.sin(phi),
        0,
        0,
    )


def pinv_rows(A: Any) -> Any:
    """Moore-Penrose inverse of a matrix whose non-zero rows are independent: A+ = A^T (A A^T)^-1 on those rows.

    A: (n, m).  Returns (m, n), with structural zeros where A has them.
    """
    rows = sorted(set(A.sparsity().row()))
    kept = A[rows, :]
    inverse = ca.SX(A.shape[1], A.shape[0])
    inverse[:, rows] = kept.T @ _inverse(kept @ kept.T)
    return ca.sparsify(inverse)


def _inverse(A: Any) -> Any:
    """Inverse by cofactors of each diagonal block, so that blocks that do not mix stay apart."""
    groups = A.sparsity().scc()  # strongly connected components: permutation and block offsets
    order, offsets = groups[1], groups[2]
    inverse = ca.SX(*A.shape)
    for first, last in itertools.pairwise(offsets):
        block = sorted(order[first:last])
        inverse[block, block] = ca.inv_minor(A[block, block])
    return inverse


def rk4(f: Callable[[Any], Any], x: Any, h: Any) -> Any:
    """One step of the classical Runge-Kutta method of order 4 for x_dot = f(x), inputs held over h [s]."""
    k1 = f(x)
    k2 = f(x + h / 2 * k1)
    k3 = f(x + h / 2 * k2)
    k4 = f(x + h * k3)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
