import numpy as np
from uuv import Output, Parameter, PythonModel, Signal


class Waves(PythonModel):
    """Signals with known metrics."""

    sine = Output(Signal(("a", "b"), ("m", "rad"), "a sine of amplitude 1"))
    ramp = Output(Signal((), "m", "2 t"))
    rate = Output(Signal((), "rad/s", "3 t"))
    decay = Output(Signal((), "m", "exp(-t / 0.02)"))
    eta = Output(Signal(("x", "y", "z", "phi", "theta", "psi"), ("m",) * 3 + ("rad",) * 3, "a place"))
    place = Parameter((0.0, 0.0, 0.0), "m", "where it is")
    heading = Parameter(0.0, "rad", "where it looks")

    def do_step(self, t, h):
        t = t + h
        self.sine = np.full(2, np.sin(2 * np.pi * t / 0.1))
        self.ramp = 2 * t
        self.rate = 3 * t
        self.decay = np.exp(-t / 0.02)
        self.eta = np.r_[self.place, 0, 0, self.heading]
