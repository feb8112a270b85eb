"""What the shipped controllers share: the socket, and the force that a model of the vehicle predicts."""

from __future__ import annotations

from typing import Any

from .bluerov2 import BlueROV2Body
from .dynamics import coriolis, damping, mass, restoring
from .kinematics import inverse_jacobian, jacobian, jacobian_dot, pose_error
from .modelling.declare import Group, Input, Output
from .modelling.equations import Model
from .signals import ETA, ETA_D, ETA_D_DDOT, ETA_D_DOT, NU, TAU


def no_pitch(gain: float) -> list[float]:
    """The gain in every axis but pitch, which the vehicle cannot drive."""
    return [gain, gain, gain, gain, 0.0, gain]


class Controller(Model):
    """The controller's socket: pose, velocity and what is desired in, generalized force out."""

    eta, nu = Input(ETA), Input(NU)
    eta_d, eta_d_dot, eta_d_ddot = Input(ETA_D), Input(ETA_D_DOT), Input(ETA_D_DDOT)
    tau = Output(TAU)

    def errors(self) -> tuple[Any, Any]:
        """e = eta - eta_d, its angles in [-pi, pi], and e_dot = J(eta) nu - eta_d_dot.

        (6,) each [m, rad; m/s, rad/s].
        """
        return pose_error(self.eta, self.eta_d), jacobian(self.eta) @ self.nu - self.eta_d_dot


class ModelBasedController(Controller):
    """A controller that knows the vehicle's coefficients: its parameters `model.m`, `model.X_u`, ..."""

    model = Group(BlueROV2Body)

    def inverse_dynamics(self, eta_ddot: Any) -> Any:
        """The force for a wanted acceleration of the pose: M J^-1 (eta_ddot - J_dot nu) + C nu + D nu + g, still water.

        eta_ddot: (6,) in NED and of the Euler angles [m/s2, rad/s2].  Returns (6,) in BODY [N, N.m].
        """
        eta, nu = self.eta, self.nu
        nu_dot = inverse_jacobian(eta) @ (eta_ddot - jacobian_dot(eta, nu, nu))
        return mass(self.model) @ nu_dot + self.forces(nu)

    def forces(self, velocity: Any) -> Any:
        """C(nu) v + D(nu) v + g(eta), nu over ground.  velocity: v, (6,) in BODY.  Returns (6,) [N, N.m]."""
        C, D = coriolis(self.model, self.nu), damping(self.model, self.nu)
        return C @ velocity + D @ velocity + restoring(self.model, self.eta)
