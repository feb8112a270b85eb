from uuv import Output, PythonModel, Signal, State


class Clock(PythonModel):
    """Counts its own steps; knows the time at their end."""

    n = State(Signal((), "m", "steps done"), output=True)
    y = Output(Signal((), "m", "time"))

    def do_step(self, t, h):
        self.n = self.n + (h > 0)
        self.y = round(t + h, 9)
