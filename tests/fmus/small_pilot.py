import numpy as np
from uuv import Input, Output, PythonModel, Signal, U

POSE = Signal(("x", "y", "z", "phi", "theta", "psi"), ("mm",) * 3 + ("deg",) * 3, "a pose")


class SmallPilot(PythonModel):
    """A controller in mm and deg, which commands nothing."""

    eta_d = Input(POSE)
    u = Output(U)

    def do_step(self, t, h):
        self.u = np.zeros(6)
