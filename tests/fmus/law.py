from uuv import Input, Output, PythonModel, Signal

NUMBER = Signal((), "1", "a number")


class Law(PythonModel):
    """A control law in plain Python: its output depends on its inputs at once."""

    x, r, u = Input(NUMBER), Input(NUMBER), Output(NUMBER)

    def do_step(self, t, h):
        self.u = 0.5 * (self.r - self.x)
