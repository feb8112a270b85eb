"""Feedback linearization: computed torque with a PID as commanded acceleration."""

from uuv import ETA, Parameter, Signal, State
from uuv.controller import ModelBasedController, no_pitch
from uuv.dynamics import mass
from uuv.kinematics import inverse_jacobian
from uuv.signals import linear_and_angular


class FeedbackLinearization(ModelBasedController):
    """Feedback linearization with a PID as commanded acceleration.

    tau = M a + C(nu) nu + D(nu) nu + g(eta),
    a = J^-1 (eta_d_ddot - K_p e - K_d e_dot - K_i int e), without a J_dot term (thesis Eqs. 4.18-4.20).
    Conditions: exact coefficients, still water and no saturation give e_ddot + K_d e_dot + K_p e + K_i int e = 0,
    stable for K_d K_p > K_i.  Held over the communication step it is stable up to 10 ms on bluerov2_thesis.
    Saturated vertical thrusters decide its attitude.
    """

    integral = State(Signal(ETA.axes, linear_and_angular("m.s", "rad.s"), "integral of the error"))
    K_p = Parameter(no_pitch(140.0), "1/s2", "proportional gain (Table 5.1)", ETA.axes)
    K_i = Parameter(no_pitch(180.0), "1/s3", "integral gain (Table 5.1 has K_i and K_d exchanged)", ETA.axes)
    K_d = Parameter(no_pitch(120.0), "1/s", "derivative gain (Table 5.1 has K_i and K_d exchanged)", ETA.axes)

    def step(self, t, h):
        e, e_dot = self.errors()
        eta_ddot = self.eta_d_ddot - self.K_p * e - self.K_d * e_dot - self.K_i * self.integral
        tau = mass(self.model) @ (inverse_jacobian(self.eta) @ eta_ddot) + self.forces(self.nu)
        return {"tau": tau, "integral": self.integral + h * e}
