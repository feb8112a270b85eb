"""The time base generator: a smooth 0 to 1 in a time that one may choose (thesis Eqs. 3.33-3.36)."""

from __future__ import annotations

from typing import Any

import casadi as ca


def time_base(s: Any) -> tuple[Any, Any, Any]:
    """The quintic xi(s) = 10 s^3 - 15 s^4 + 6 s^5 and its first two derivatives with respect to s in [0, 1]."""
    xi = s**3 * (10 - 15 * s + 6 * s**2)
    xi_s = 30 * s**2 * (1 - s) ** 2
    xi_ss = 60 * s * (1 - s) * (1 - 2 * s)
    return xi, xi_s, xi_ss


def convergence_gain(t: Any, t_b: Any, alpha_0: Any, alpha_c: Any, delta: Any) -> Any:
    """alpha(t) = alpha_0 xi_dot / (1 - xi + delta) up to t_b, alpha_c after (Eq. 4.49) [1/s].

    xi_dot is the derivative in time: Eq. 3.34 lacks its 1/t_b, Eq. 4.49 prints xi in its place.
    t, t_b: time and time base [s].
    """
    xi, xi_s, _ = time_base(ca.fmin(t / t_b, 1))
    return ca.if_else(t <= t_b, alpha_0 * xi_s / t_b / (1 - xi + delta), alpha_c)
