import numpy as np
from uuv import Output, Parameter, PythonModel, Signal

POSE = Signal(("x", "psi"), ("mm", "rad"), "a distance and a heading")


class Spike(PythonModel):
    """y.x is `height` in the steps that end in [at, until], y.psi `turn`; else both are 0."""

    y = Output(POSE)
    height = Parameter(0.0, "mm", "of y.x")
    turn = Parameter(0.0, "rad", "of y.psi")
    at = Parameter(0.5, "s", "when they come")
    until = Parameter(0.5, "s", "when they go")

    def do_step(self, t, h):
        there = self.at - 1e-9 <= t + h <= self.until + 1e-9
        self.y = np.array([self.height, self.turn]) * there
