from uuv import Input, Model, Signal, State

NUMBER = Signal((), "1", "a number")


class Plant(Model):
    """An integrator: its output is a state."""

    u, x = Input(NUMBER), State(NUMBER, 1.0, output=True)

    def step(self, t, h):
        return {"x": self.x + h * self.u}
