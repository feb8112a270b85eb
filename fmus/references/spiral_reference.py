"""The thesis's spiral."""

import casadi as ca
from uuv import ETA_D, ETA_D_DDOT, ETA_D_DOT, Model, Output, Parameter
from uuv.signals import TURN_A_SECOND


class SpiralReference(Model):
    """A downward spiral with the bow turning along.

    x_d = R cos wt, y_d = R sin wt, z_d = z_dot t (thesis Eqs. 4.14, 4.15) and psi_d = wt, derivatives exact.

    The thesis does not print psi_d; wt follows from twelve cells of its tables.
    """

    eta_d, eta_d_dot, eta_d_ddot = Output(ETA_D), Output(ETA_D_DOT), Output(ETA_D_DDOT)
    R = Parameter(1.0, "m", "radius")
    omega = Parameter(0.5235987755982988, "rad/s", "angular velocity: pi/6", limits=TURN_A_SECOND)
    z_dot = Parameter(1 / 3, "m/s", "rate of descent: 10 m in 30 s")

    def step(self, t, h):
        R, w, angle = self.R, self.omega, self.omega * (t + h)
        c, s = ca.cos(angle), ca.sin(angle)
        return {
            "eta_d": ca.vertcat(R * c, R * s, self.z_dot * (t + h), 0, 0, angle),
            "eta_d_dot": ca.vertcat(-R * w * s, R * w * c, self.z_dot, 0, 0, w),
            "eta_d_ddot": ca.vertcat(-R * w**2 * c, -R * w**2 * s, 0, 0, 0, 0),
        }
