"""From a generalized force to six thruster commands."""

from uuv import TAU, Calculated, Input, Model, Output, U
from uuv.bluerov2 import BlueROV2Thrusters
from uuv.thrusters import pinv_thruster_matrix, saturate, thruster_matrix


class BlueROV2Allocation(BlueROV2Thrusters, Model):
    """Thruster commands of a generalized force, saturated.

    u = pinv(T) tau / max_thrust (thesis Eq. 3.28), T1-T4 scaled together and T5, T6 clipped (Eqs. 4.12, 4.13).
    """

    tau = Input(TAU)
    u = Output(U)
    T_inv = Calculated((6, 6), "1", "Moore-Penrose inverse of T")

    def calculate(self):
        return {"T": thruster_matrix(self), "T_inv": pinv_thruster_matrix(self)}

    def step(self, t, h):
        return {"u": saturate(self.T_inv @ self.tau / self.max_thrust)}
