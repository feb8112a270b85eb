"""Lyapunov-based control: tracking of a virtual reference velocity."""

from uuv import ETA, Parameter
from uuv.controller import ModelBasedController, no_pitch
from uuv.dynamics import mass
from uuv.kinematics import inverse_jacobian, jacobian_dot
from uuv.signals import FORCE_PER_RATE


class Lyapunov(ModelBasedController):
    """Lyapunov-based control: tracking of a virtual reference velocity.

    tau = M nu_r_dot + C(nu) nu_r + D(nu) nu_r + g(eta) - K_d S,  S = nu - nu_r (thesis Eq. 4.26),
    nu_r = J^-1 eta_r_dot,  eta_r_dot = eta_d_dot - alpha e,  nu_r_dot = J^-1 (eta_r_ddot - J_dot nu_r)
    (Eqs. 4.21-4.25; 4.25 misprints eta_r_dot for eta_r_ddot).
    Conditions: V = S^T M S / 2 decreases for K_d + D > 0 with exact coefficients in still water; alpha > 0 then takes e
    to zero exponentially.  Held over the communication step it is stable up to 5 ms on bluerov2_thesis.
    """

    alpha = Parameter(no_pitch(0.8), "1/s", "rate of convergence on S = 0 (Table 5.1)", ETA.axes)
    K_d = Parameter(no_pitch(60.0), FORCE_PER_RATE, "gain of S; fitted to Tables 5.2-5.7, printed 80", ETA.axes)

    def step(self, t, h):
        e, e_dot = self.errors()
        J_inv = inverse_jacobian(self.eta)
        nu_r = J_inv @ (self.eta_d_dot - self.alpha * e)
        eta_r_ddot = self.eta_d_ddot - self.alpha * e_dot
        nu_r_dot = J_inv @ (eta_r_ddot - jacobian_dot(self.eta, self.nu, nu_r))
        S = self.nu - nu_r
        return {"tau": mass(self.model) @ nu_r_dot + self.forces(nu_r) - self.K_d * S}
