"""PID: the baseline that every other controller is measured against."""

import casadi as ca
from uuv import ETA, TAU, Parameter, Signal, State
from uuv.controller import Controller, no_pitch
from uuv.kinematics import jacobian
from uuv.signals import FORCE_PER_INTEGRAL, FORCE_PER_POSE, FORCE_PER_RATE, linear_and_angular


class PID(Controller):
    """PID in NED, mapped to BODY: the baseline.

    tau = -J(eta)^T [K_p e + K_i int e + K_d e_dot],  e = eta - eta_d (thesis Eqs. 4.16, 4.17).

    The gains are those of Table 5.1 with K_i and K_d exchanged, which two controllers' results confirm.
    Held over the communication step it is stable up to 2 ms on bluerov2_thesis.
    """

    integral = State(Signal(ETA.axes, linear_and_angular("m.s", "rad.s"), "integral of the error"))
    K_p = Parameter(no_pitch(140.0), FORCE_PER_POSE, "proportional gain", ETA.axes)
    K_i = Parameter(no_pitch(180.0), FORCE_PER_INTEGRAL, "integral gain", ETA.axes)
    K_d = Parameter(no_pitch(120.0), FORCE_PER_RATE, "derivative gain", ETA.axes)
    anti_windup = Parameter(False, "1", "limit the integral's share of the force to `integral_limit`")
    integral_limit = Parameter(40.0, TAU.units, "largest K_i int e when anti_windup is on", ETA.axes)

    def step(self, t, h):
        e, e_dot = self.errors()
        tau = -jacobian(self.eta).T @ (self.K_p * e + self.K_i * self.integral + self.K_d * e_dot)
        integral = self.integral + h * e
        limit = self.integral_limit / ca.if_else(self.K_i == 0, 1, ca.fabs(self.K_i))
        limited = ca.fmin(limit, ca.fmax(-limit, integral))
        return {"tau": tau, "integral": ca.if_else(self.anti_windup, limited, integral)}
