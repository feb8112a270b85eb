"""BlueROV2 as the thesis models it: five forces, no active pitch, a current that moves the water."""

import math
from dataclasses import replace

import casadi as ca
from uuv import ETA, NU, SPECIFIC_FORCE, TAU, V_C, Calculated, Input, Model, Output, Parameter, State, U
from uuv.bluerov2 import BlueROV2Body, BlueROV2Thrusters, G
from uuv.dynamics import coriolis, damping, mass, pinv_rows, restoring, rk4
from uuv.kinematics import jacobian, rotation
from uuv.signals import HALF_TURN, TURN_A_SECOND, UPRIGHT
from uuv.thrusters import thruster_matrix

SUBMERGED = {
    "z": (-0.01, math.inf)
}  # m; buoyancy is that of a vehicle under water, and the thesis's task ends at z = 0


class BlueROV2Thesis(BlueROV2Body, BlueROV2Thrusters, Model):
    """BlueROV2 as in the thesis, chapter 4.

    eta_dot = J(eta) nu,
    nu_dot = pinv(M) [tau - C(nu_r) nu_r - D(nu_r) nu_r - g(eta)],  nu_r = nu - R(eta)^T v_c.

    M acts on nu_dot alone, without the term of a turning current: with it pitch misses the thesis's by 9.6 degrees.
    pinv(M) makes pitch follow surge (q_dot = 0.0135 u_dot), undamped and without restoring moment: 0.78 degrees
    per metre travelled.  Valid for slow, level motion.  Runge-Kutta of order 4 over the communication step.
    """

    u, v_c = Input(U), Input(V_C)
    eta = State(replace(ETA, limits=UPRIGHT | SUBMERGED), output=True)
    nu = State(NU, output=True)
    tau = Output(TAU)
    specific_force = Output(SPECIFIC_FORCE)
    # The spiral's start: the printed depth of 2 m contradicts the tables.
    eta_0 = Parameter(
        (2.0, -1.0, 1.0, 0.0, 0.0, 0.0),
        ETA.units,
        "initial " + ETA.meaning,
        ETA.axes,
        limits=UPRIGHT | SUBMERGED | {"phi": HALF_TURN},
    )
    nu_0 = Parameter(0.0, NU.units, "initial " + NU.meaning, NU.axes, limits=dict.fromkeys("pqr", TURN_A_SECOND))
    M_inv = Calculated((6, 6), "1", "Moore-Penrose inverse of the mass matrix M, in SI units")

    def calculate(self):
        return {"T": thruster_matrix(self), "M_inv": pinv_rows(mass(self))}

    def initial(self):
        return {"eta": self.eta_0, "nu": self.nu_0}

    def step(self, t, h):
        tau = self.max_thrust * (self.T @ self.u)

        def acceleration(eta, nu):
            nu_r = nu - ca.vertcat(rotation(eta).T @ self.v_c, ca.SX(3, 1))
            forces = tau - coriolis(self, nu_r) @ nu_r - damping(self, nu_r) @ nu_r - restoring(self, eta)
            return self.M_inv @ forces

        def derivative(x):
            eta, nu = x[:6], x[6:]
            return ca.vertcat(jacobian(eta) @ nu, acceleration(eta, nu))

        x = rk4(derivative, ca.vertcat(self.eta, self.nu), h)
        eta, nu = x[:6], x[6:]
        velocity, omega = nu[:3], nu[3:]
        gravity = rotation(eta).T @ ca.vertcat(0, 0, G)
        specific_force = acceleration(eta, nu)[:3] + ca.cross(omega, velocity) - gravity
        return {"eta": eta, "nu": nu, "tau": tau, "specific_force": specific_force}
