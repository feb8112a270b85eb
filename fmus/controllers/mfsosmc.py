"""MFSOSMC: the controller that the thesis proposes."""

import casadi as ca
from uuv import ETA, ETA_D_DOT, Parameter, Signal, State
from uuv.controller import Controller, no_pitch
from uuv.kinematics import jacobian
from uuv.signals import FORCE_PER_RATE, POSITIVE, linear_and_angular
from uuv.tbg import convergence_gain


class MFSOSMC(Controller):
    """Model-free second-order sliding mode control with a time base.

    tau = -J^T K_d s_r,  s_r = s_n + K_i int sign(s_n),  s_n = s - s(0) exp(-kappa t),  s = e_dot + alpha(t) e
    (thesis Eqs. 4.44-4.49), e = eta - eta_d.

    The integral is semi-implicit: advanced first, then used.  That takes a delay of one step out of the loop of relay
    and integrator, and with it most of the chatter of a controller held over the communication step.
    Step: with K_i = 5 (the spiral) 0.05 ms or less, with K_i = 1 (gripping) 0.1 ms; above 0.7 ms the rate loop
    K_d/I = 2880 1/s is unstable, and position errors do not show it.
    """

    integral = State(Signal(ETA.axes, ("s",) * 6, "integral of sign(s_n)"))
    s_0 = State(Signal(ETA.axes, ETA_D_DOT.units, "s at the start"))
    K_d = Parameter(no_pitch(800.0), FORCE_PER_RATE, "gain of s_r (Table 5.1)", ETA.axes)
    K_i = Parameter(
        no_pitch(5.0),
        linear_and_angular("m/s2", "rad/s2"),
        "gain of the integral; 5 (Table 5.1), fitted: 1 in a current",
        ETA.axes,
    )
    kappa = Parameter(5.0, "1/s", "decay of s_d (Table 5.1)")
    alpha_0 = Parameter(1.01, "1", "gain of the time base (Table 5.1)")
    alpha_c = Parameter(25.0, "1/s", "gain after the time base (Table 5.1)")
    delta = Parameter(0.001, "1", "keeps alpha finite at t_b (Table 5.1)", limits=POSITIVE)
    t_b = Parameter(5.0, "s", "time base: when the errors have converged", limits=POSITIVE)
    semi_implicit = Parameter(True, "1", "advance the integral before it is used; false: after")

    def _s(self, alpha):
        e, e_dot = self.errors()
        return e_dot + alpha * e

    def _alpha(self, t):
        return convergence_gain(t, self.t_b, self.alpha_0, self.alpha_c, self.delta)

    def initial(self):
        return {"s_0": self._s(self._alpha(0))}

    def step(self, t, h):
        s_n = self._s(self._alpha(t)) - self.s_0 * ca.exp(-self.kappa * t)
        integral = self.integral + h * ca.sign(s_n)
        s_r = s_n + self.K_i * ca.if_else(self.semi_implicit, integral, self.integral)
        return {"tau": -jacobian(self.eta).T @ (self.K_d * s_r), "integral": integral, "s_0": self.s_0}
