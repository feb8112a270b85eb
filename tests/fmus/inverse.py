from uuv import Output, PythonModel, Signal, State


class Inverse(PythonModel):
    """y doubles with each halving of the step; z.a does, too, and is a billionth of z.b; n alternates."""

    y = Output(Signal((), "m", "1e-9 m s / h"))
    z = Output(Signal(("a", "b"), "rad", "1e-12 rad s / h, and 1 rad"))
    n = State(Signal((), "m", "1, -1, 1, ..."), start=1.0, output=True)

    def do_step(self, t, h):
        if h:
            self.y, self.z, self.n = 1e-9 / h, [1e-12 / h, 1.0], -self.n
