from uuv import Input, Output, PythonModel, Signal


class Plus(PythonModel):
    """y = u + 1."""

    u = Input(Signal((), "m", "a number"))
    y = Output(Signal((), "m", "a number"))

    def do_step(self, t, h):
        self.y = self.u + 1.0
