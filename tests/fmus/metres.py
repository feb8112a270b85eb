import numpy as np
from uuv import Output, PythonModel, Signal


class Metres(PythonModel):
    """A pose at rest in m and deg, and headings that no axis declares to be angles."""

    eta = Output(Signal(("x", "y", "z", "phi", "theta", "psi"), ("m",) * 3 + ("deg",) * 3, "a pose"))
    heading = Output(Signal((), "deg", "where it looks"))
    bearing = Output(Signal((), "deg", "where it goes"))

    def do_step(self, t, h):
        self.eta = np.array([0.0, 0.0, 2.0, 0.0, 0.0, 349.99])
        self.heading, self.bearing = 349.99, -10.0
