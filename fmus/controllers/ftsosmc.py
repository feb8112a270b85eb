"""Finite-time second-order sliding mode control, after Liu et al. (2017) as the thesis gives it."""

import casadi as ca
from uuv import ETA, Parameter, Signal, State
from uuv.controller import ModelBasedController, no_pitch
from uuv.signals import linear_and_angular


class FTSOSMC(ModelBasedController):
    """Finite-time second-order sliding mode control (super-twisting with linear terms).

    s = e_dot + lambda e,  eta_ddot = eta_d_ddot - lambda e_dot - k_1 |s|^b sign s - w,
    w_dot = k_2 |s|^(2b-1) sign s + k_3 s + k_4 |s|^b sign s,
    tau = M J^-1 (eta_ddot - J_dot nu) + C nu + D nu + g (thesis section 4.4.2).
    Conditions: 1/2 < b < 1, positive k and a disturbance with bounded rate bring s and s_dot to zero in finite time; on
    s = 0 the error then decays with lambda.  Held it is stable up to 10 ms on bluerov2_thesis.
    """

    w = State(Signal(ETA.axes, linear_and_angular("m/s2", "rad/s2"), "integral part of the reaching law"))
    lambda_ = Parameter(no_pitch(0.8), "1/s", "slope of the surface (Table 5.8: lambda)", ETA.axes)
    b = Parameter(0.7, "1", "exponent (Table 5.8)", limits=(0.5, 1.0))
    k_1 = Parameter(no_pitch(30.0), "1/s", "gain of |s|^b (Table 5.8)", ETA.axes)
    k_2 = Parameter(no_pitch(20.0), "1/s2", "gain of |s|^(2b-1) in the integral (Table 5.8)", ETA.axes)
    k_3 = Parameter(no_pitch(15.0), "1/s2", "gain of s in the integral (Table 5.8)", ETA.axes)
    k_4 = Parameter(no_pitch(20.0), "1/s2", "gain of |s|^b in the integral (Table 5.8)", ETA.axes)

    def step(self, t, h):
        e, e_dot = self.errors()
        s = e_dot + self.lambda_ * e
        size, sign = ca.fabs(s), ca.sign(s)
        power = size**self.b * sign
        eta_ddot = self.eta_d_ddot - self.lambda_ * e_dot - self.k_1 * power - self.w
        w_dot = self.k_2 * size ** (2 * self.b - 1) * sign + self.k_3 * s + self.k_4 * power
        return {"tau": self.inverse_dynamics(eta_ddot), "w": self.w + h * w_dot}
