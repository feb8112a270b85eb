from uuv import Input, Output, PythonModel, Signal


class Relay(PythonModel):
    """y is what u was at the start of the step."""

    u = Input(Signal((), "m", "a number"))
    y = Output(Signal((), "m", "a number"))

    def do_step(self, t, h):
        self.y = self.u
