from uuv import Input, Output, PythonModel, Signal

WITHIN = Signal((), "m", "a distance", limits=(-1.0, 2.0))


class Bounded(PythonModel):
    """x is valid between -1 and 2 m; y = x, valid in the same."""

    x, y = Input(WITHIN), Output(WITHIN)
    psi = Input(Signal((), "rad", "a heading"))

    def do_step(self, t, h):
        self.y = self.x
