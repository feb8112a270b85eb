import casadi as ca
from uuv import ETA_D, ETA_D_DDOT, ETA_D_DOT, Model, Output, Parameter


class Turning(Model):
    """A heading that turns at a constant rate in one place, given as it is or in [-180, 180] degrees."""

    eta_d, eta_d_dot, eta_d_ddot = Output(ETA_D), Output(ETA_D_DOT), Output(ETA_D_DDOT)
    psi_0 = Parameter(0.0, "rad", "heading at t = 0")
    rate = Parameter(0.0, "rad/s", "of the heading")
    wraps = Parameter(True, "1", "whether the heading jumps at +-180 degrees")

    def step(self, t, h):
        psi = self.psi_0 + self.rate * (t + h)
        psi = ca.if_else(self.wraps, ca.remainder(psi, 2 * ca.pi), psi)
        return {
            "eta_d": ca.vertcat(0, 0, 2, 0, 0, psi),
            "eta_d_dot": ca.vertcat(0, 0, 0, 0, 0, self.rate),
            "eta_d_ddot": ca.SX.zeros(6),
        }
