from uuv import Output, Parameter, PythonModel, Signal, State


class Alternating(PythonModel):
    """Changes its sign in a share of its steps; or its side, between limits that are both positive."""

    n = State(Signal((), "1", "steps done"))
    y = Output(Signal(("a", "b"), "m", "a changes its sign, b does not and is of size 1"))
    share = Parameter(1.0, "1", "share of the steps in which a changes its sign")
    size = Parameter(1.0, "m", "amplitude")
    end = Parameter(1e9, "s", "when it ends the run")

    def do_step(self, t, h):
        self.n = self.n + (h > 0)
        changes = int(self.n * self.share)
        self.y = [self.size * (-1) ** changes, 1.0]
        return t < self.end
