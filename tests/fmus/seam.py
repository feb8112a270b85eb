import numpy as np
from uuv import Output, PythonModel, Signal


class Seam(PythonModel):
    """A heading of pi - 0.003 + h / s, in +-pi: on either side of the seam, by the step."""

    eta = Output(Signal(("x", "y", "z", "phi", "theta", "psi"), ("m",) * 3 + ("rad",) * 3, "a pose"))

    def do_step(self, t, h):
        self.eta = np.array([0.0, 0.0, 0.0, 0.0, 0.0, np.remainder(2 * np.pi - 0.003 + h, 2 * np.pi) - np.pi])
