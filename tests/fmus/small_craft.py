import numpy as np
from uuv import Input, Output, PythonModel, Signal, U

POSE = Signal(("x", "y", "z", "phi", "theta", "psi"), ("mm",) * 3 + ("deg",) * 3, "a pose")
RATES = Signal(("u", "v", "w", "p", "q", "r"), ("mm/s",) * 3 + ("deg/s",) * 3, "its rates")


class SmallCraft(PythonModel):
    """A vehicle in mm and deg: 100 mm/s north at 2000 mm depth, turning from 170 degrees at 40 deg/s, in +-180."""

    u = Input(U)
    eta = Output(POSE)
    nu = Output(RATES)

    def do_step(self, t, h):
        psi = np.remainder(170.0 + 40.0 * (t + h) + 180.0, 360.0) - 180.0
        self.eta = np.array([100.0 * (t + h), 0.0, 2000.0, 0.0, 0.0, psi])
        self.nu = np.array([100.0, 0.0, 0.0, 0.0, 0.0, 40.0])
