import math

from uuv import Input, Output, Parameter, PythonModel, Signal


class Curve(PythonModel):
    """y = gain u + bias + wave cos(3 u)."""

    u = Input(Signal((), "m", "a number"))
    y = Output(Signal((), "m", "a number"))
    gain = Parameter(1.0, "1", "slope")
    bias = Parameter(0.0, "m", "offset")
    wave = Parameter(0.0, "m", "amplitude")

    def do_step(self, t, h):
        self.y = self.gain * self.u + self.bias + self.wave * math.cos(3 * self.u)
