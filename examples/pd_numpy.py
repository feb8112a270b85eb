"""A controller of one's own in plain Python: build it with `orch build examples/pd_numpy.py`."""

import numpy as np
from uuv import ETA, ETA_D, ETA_D_DOT, NU, TAU, Input, Output, Parameter, PythonModel


class PDNumpy(PythonModel):
    """PD for position, roll and heading of a nearly level vehicle, with the net buoyancy fed forward."""

    eta, nu, eta_d, eta_d_dot = Input(ETA), Input(NU), Input(ETA_D), Input(ETA_D_DOT)
    tau = Output(TAU)
    K_p = Parameter(140.0, "N/m", "position gain")
    K_d = Parameter(120.0, "N.s/m", "velocity gain")
    K_a = Parameter(40.0, "N.m/rad", "gain of roll and heading")
    buoyancy = Parameter(1.96, "N", "net buoyancy, upward")

    def do_step(self, t, h):
        e = self.eta_d - self.eta
        e[3:] -= 2 * np.pi * np.round(e[3:] / (2 * np.pi))  # angles: the shortest way round
        c, s = np.cos(self.eta[5]), np.sin(self.eta[5])
        R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])  # BODY to NED
        force = R.T @ (self.K_p * e[:3] + self.K_d * self.eta_d_dot[:3]) - self.K_d * self.nu[:3]
        moment = self.K_a * (e[3:] + 0.2 * (self.eta_d_dot[3:] - self.nu[3:]))
        self.tau = np.array([*force[:2], force[2] + self.buoyancy, moment[0], 0, moment[2]])
