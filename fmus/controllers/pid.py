"""PID in NED, mapped to BODY: the baseline every other controller is measured against."""

import casadi as ca
from uuv import ETA, ETA_D, ETA_D_DDOT, ETA_D_DOT, NU, TAU, Input, Model, Output, Parameter, Signal, State
from uuv.kinematics import jacobian
from uuv.signals import FORCE_PER_INTEGRAL, FORCE_PER_POSE, FORCE_PER_RATE

NO_PITCH = (1.0, 1.0, 1.0, 1.0, 0.0, 1.0)


class PID(Model):
    """tau = -J(eta)^T [K_p e + K_i int e + K_d e_dot],  e = eta - eta_d (thesis Eqs. 4.16, 4.17).

    The gains are those of Table 5.1 with K_i and K_d exchanged, which two controllers' results confirm.
    Held over the communication step it is stable up to 2 ms on bluerov2_thesis.
    """

    eta, nu = Input(ETA), Input(NU)
    eta_d, eta_d_dot, eta_d_ddot = Input(ETA_D), Input(ETA_D_DOT), Input(ETA_D_DDOT)
    tau = Output(TAU)
    integral = State(Signal(ETA.axes, ("m.s",) * 3 + ("rad.s",) * 3, "integral of the error"))
    K_p = Parameter([140.0 * k for k in NO_PITCH], FORCE_PER_POSE, "proportional gain", ETA.axes)
    K_i = Parameter([180.0 * k for k in NO_PITCH], FORCE_PER_INTEGRAL, "integral gain", ETA.axes)
    K_d = Parameter([120.0 * k for k in NO_PITCH], FORCE_PER_RATE, "derivative gain", ETA.axes)
    anti_windup = Parameter(False, "1", "limit the integral's share of the force to `integral_limit`")
    integral_limit = Parameter(40.0, TAU.units, "largest K_i int e when anti_windup is on", ETA.axes)

    def step(self, t, h):
        J = jacobian(self.eta)
        e = self.eta - self.eta_d
        e_dot = J @ self.nu - self.eta_d_dot
        tau = -J.T @ (self.K_p * e + self.K_i * self.integral + self.K_d * e_dot)
        integral = self.integral + h * e
        limit = self.integral_limit / ca.if_else(self.K_i == 0, 1, ca.fabs(self.K_i))
        limited = ca.fmin(limit, ca.fmax(-limit, integral))
        return {"tau": tau, "integral": ca.if_else(self.anti_windup, limited, integral)}
