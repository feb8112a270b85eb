from uuv import Output, PythonModel, Signal

SLOPE = 1


class Slope(PythonModel):
    """y = SLOPE t."""

    y = Output(Signal((), "m", "a number"))

    def do_step(self, t, h):
        self.y = SLOPE * t
