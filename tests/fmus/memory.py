from uuv import Input, PythonModel, Signal, State


class Memory(PythonModel):
    """n is what u was at the start of the step, and nothing else."""

    u = Input(Signal((), "m", "a number"))
    n = State(Signal((), "m", "a number"), output=True)

    def do_step(self, t, h):
        if h > 0:
            self.n = self.u + 1.0
